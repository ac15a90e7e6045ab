"""The records of an IGES file (version 5.3, section 2.2): global section, directory entries and parameters, and back.

Nothing here knows what an entity means; numbers stay the text they are, so that a file passes through unchanged where
nobody changes it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from .iges_lines import DATA, WIDTH, in_order, sections_of

_HOLLERITH = re.compile(r"(\d+)H")


@dataclass(slots=True)
class Entity:
    """One entity: its place in the directory (1, 3, 5, ...), the 20 directory fields as text, its parameters as text."""

    pointer: int
    fields: list[str]
    parameters: list[str]

    @property
    def type(self) -> int:
        """Entity type number."""
        return _integer(self.fields[0])

    @property
    def independent(self) -> bool:
        """False when another entity owns this one (status digits 3 and 4)."""
        status = self.fields[8].strip().rjust(8, "0")
        return status[2:4] == "00"

    @property
    def blanked(self) -> bool:
        """The entity is not to be shown (status digits 1 and 2)."""
        return self.fields[8].strip().rjust(8, "0")[:2] == "01"


@dataclass(slots=True)
class IgesFile:
    """An IGES file taken apart. complete: it ends with its terminate section."""

    start: list[str] = field(default_factory=list)
    header: list[str] = field(default_factory=list)
    entities: list[Entity] = field(default_factory=list)
    complete: bool = False
    separator: str = ","
    terminator: str = ";"
    broken: int = 0
    """Directory entries whose parameters are not there or do not match."""
    crowded: int = 0
    """Parameter lines with a delimiter in column 65, which should be blank; readers that keep to the standard lose it."""
    disordered: int = 0
    """Lines whose own number, or whose entity's number, is not the one of their place."""
    mended: list[str] = field(default_factory=list)
    """What else had to be set right to read the file."""

    def at(self, pointer: int) -> Entity | None:
        """The entity at a place in the directory; None when there is none."""
        place = (pointer - 1) // 2
        return self.entities[place] if pointer % 2 == 1 and 0 <= place < len(self.entities) else None

    @property
    def conforms(self) -> bool:
        """The file is as the standard wants it, so that other readers understand it as it is."""
        return not (self.mended or self.crowded or self.disordered)


def parse(text: str) -> IgesFile:
    """Take a file apart. Lines that belong to no section (comments after the data) are left out.

    Raises InputError for the forms of IGES that are not in lines of text.
    """
    sections, mended = sections_of(text)
    disordered = sum(_integer(line[DATA + 1 :]) != n for letter in "SGDP" for n, line in enumerate(sections[letter], 1))
    if disordered:
        sections = {letter: in_order(lines) for letter, lines in sections.items()}
    file = IgesFile(disordered=disordered, mended=mended, start=[line[:DATA].rstrip() for line in sections["S"]])
    header = "".join(line[:DATA] for line in sections["G"])
    file.separator, file.terminator = _delimiters(header)
    file.header, wrong = header_of(header, file.separator, file.terminator)
    if wrong:
        mended.append(f"{wrong} texts in its head have another length than they say")
    file.complete = bool(sections["T"])
    parameters = _Parameters(sections["P"], file)
    directory = sections["D"]
    for i in range(0, len(directory) - 1, 2):
        fields = [row[8 * k : 8 * k + 8] for row in directory[i : i + 2] for k in range(9)]
        fields.insert(9, "")
        fields.append("")
        values = parameters.of(i + 1, fields)
        if not values or _integer(values[0]) != _integer(fields[0]):
            file.broken += 1
        file.entities.append(Entity(i + 1, fields, values))
    if parameters.astray:
        mended.append(f"the directory says wrong of {parameters.astray} of its entities where their parameters stand")
    return file


class _Parameters:
    """The parameter section: which of its lines are an entity's."""

    def __init__(self, lines: list[str], file: IgesFile) -> None:
        self.astray = 0
        self._file = file
        self._lines = [_data(line, file) for line in lines]
        self._owners = [_integer(line[WIDTH + 1 : DATA].strip(" ,;")) for line in lines]
        self._first: dict[int, int] = {}
        for place, owner in enumerate(self._owners):
            self._first.setdefault(owner, place)

    def of(self, pointer: int, fields: list[str]) -> list[str]:
        """The parameters of the entity at `pointer`, from where its directory entry says, or from the lines that name it."""
        begin, count = _integer(fields[1]) - 1, _integer(fields[13])
        own = range(begin, min(begin + count, len(self._lines))) if begin >= 0 else range(0)
        self._file.disordered += sum(self._owners[n] != pointer for n in own)
        values, ended = self._read(own)
        sound = bool(values) and ended and _integer(values[0]) == _integer(fields[0])
        if not sound and pointer in self._first:
            first = self._first[pointer]
            named = range(
                first, next((n for n in range(first, len(self._lines)) if self._owners[n] != pointer), len(self._lines))
            )
            others, ended = self._read(named)
            if named != own and ended and others and _integer(others[0]) == _integer(fields[0]):
                self.astray += 1
                return others
        return values

    def _read(self, places: range) -> tuple[list[str], bool]:
        """The parameters on these lines, and whether the record delimiter ends them."""
        text = "".join(self._lines[n] for n in places)
        return tokens(text, self._file.separator, self._file.terminator), self._file.terminator in text


def _data(line: str, file: IgesFile) -> str:
    """The data of a parameter line; some exporters put the last delimiter into the column that should be blank."""
    if line[WIDTH] not in (file.separator, file.terminator):
        return line[:WIDTH]
    file.crowded += 1
    return line[: WIDTH + 1]


def _integer(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        return 0


def _delimiters(header: str) -> tuple[str, str]:
    """The parameter and record delimiters that the global section names; comma and semicolon by default."""
    separator = header[2] if header.startswith("1H") and len(header) > 2 else ","
    rest = header[3:] if header.startswith("1H") else header
    rest = rest[1:] if rest.startswith(separator) else rest
    terminator = rest[2] if rest.startswith("1H") and len(rest) > 2 else ";"
    return separator, terminator


_TEXTS = {0, 1, 2, 3, 4, 5, 11, 14, 17, 20, 21, 24}
"""Places of the global section's parameters that are texts; all others are numbers (section 2.2.4.3)."""


def header_of(text: str, separator: str, terminator: str) -> tuple[list[str], int]:
    """The global section's parameters, and how many of its texts have another length than they say.

    Such a text ends at the next delimiter.
    """
    counted = _tokens(text, separator, terminator, believed=True)
    if not counted[1] and _is_header(counted[0]):
        return counted
    bounded = _tokens(text, separator, terminator, believed=False)
    return bounded if _is_header(bounded[0]) else counted


def _is_header(found: list[str]) -> bool:
    """Numbers where the global section has numbers, texts where it has texts."""
    return all(
        token == "" or bool(_HOLLERITH.match(token)) == (place in _TEXTS) for place, token in enumerate(found[:25])
    )


def tokens(text: str, separator: str = ",", terminator: str = ";") -> list[str]:
    """Free-format parameters up to the record delimiter; strings (5Hhello) may hold delimiters."""
    if "H" not in text:
        return [token.strip() for token in text.split(terminator, 1)[0].split(separator)] if text.strip() else []
    return _tokens(text, separator, terminator, believed=True)[0]


def _tokens(text: str, separator: str, terminator: str, *, believed: bool) -> tuple[list[str], int]:
    """The parameters, and how many strings are not as long as they say.

    A string that no delimiter follows, and every one where the lengths are not to be believed, ends at the next delimiter.
    """
    found: list[str] = []
    at = wrong = 0
    while at < len(text):
        while at < len(text) and text[at] == " ":
            at += 1
        match = _HOLLERITH.match(text, at)
        if match:
            end = match.end() + int(match[1])
            behind = text[end:].lstrip(" ")[:1]
            delimiter = text[match.end() : match.end() + 1] if len(found) < 2 else ""
            if delimiter == "" and not (believed and end <= len(text) and behind in ("", separator, terminator)):
                stop = _delimited(text, match.end(), separator, terminator)
                string = text[match.end() : stop].rstrip(" ")
                if len(string) != int(match[1]) and text[match.end() : end].rstrip(" ") != string:
                    wrong += 1
                    token, at = f"{len(string)}H{string}", stop
                else:
                    token, at = text[at:end], stop
            else:
                token, at = text[at:end], end
            at = _delimited(text, at, separator, terminator)
        else:
            begin = at
            at = _delimited(text, at, separator, terminator)
            token = text[begin:at].strip()
        found.append(token)
        if at >= len(text) or text[at] == terminator:
            break
        at += 1
    return found, wrong


def _delimited(text: str, at: int, separator: str, terminator: str) -> int:
    """Where the next delimiter stands, or the end of the text."""
    while at < len(text) and text[at] not in (separator, terminator):
        at += 1
    return at


# ---------------------------------------------------------------------- back to text


def wrapped(parameters: list[str], width: int, separator: str, terminator: str) -> list[str]:
    """Parameters on lines of `width` columns; only strings longer than a line run over its end."""
    lines, line = [], ""
    for i, parameter in enumerate(parameters):
        piece = parameter + (terminator if i == len(parameters) - 1 else separator)
        if len(line) + len(piece) > width and line:
            lines.append(line)
            line = ""
        while len(piece) > width:
            lines.append(piece[:width])
            piece = piece[width:]
        line += piece
    return [*lines, line] if line else lines


def text_of(file: IgesFile) -> str:
    """The file as text of 80 columns, its counters and the directory's line numbers set anew."""
    out: list[str] = []

    def put(content: str, letter: str, number: int) -> None:
        out.append(f"{content:<72}{letter}{number:>7}")

    for n, line in enumerate(file.start or [""], 1):
        put(line, "S", n)
    header = wrapped(file.header, DATA, file.separator, file.terminator)
    for n, line in enumerate(header, 1):
        put(line, "G", n)
    parameter_lines: list[tuple[str, int]] = []
    for entity in file.entities:
        own = wrapped(entity.parameters, WIDTH, file.separator, file.terminator)
        fields = list(entity.fields)
        fields[1], fields[13] = str(len(parameter_lines) + 1), str(len(own))
        parameter_lines += [(line, entity.pointer) for line in own]
        for row, letters in enumerate((fields[:9], fields[10:19])):
            put("".join(f"{text.strip():>8}"[:8] for text in letters), "D", entity.pointer + row)
    for n, (line, pointer) in enumerate(parameter_lines, 1):
        put(f"{line:<64}{pointer:>8}", "P", n)
    counts = (max(len(file.start), 1), len(header), 2 * len(file.entities), len(parameter_lines))
    put("".join(f"{letter}{count:>7}" for letter, count in zip("SGDP", counts, strict=True)), "T", 1)
    return "\n".join(out) + "\n"


def order_properties(file: IgesFile) -> None:
    """Put the properties (406) in the order of the entities that own them, and point the owners at their new places.

    An owner's parameters end with the count of its properties and their places in the directory (section 2.2.4.5.2).
    """
    slots = [i for i, entity in enumerate(file.entities) if entity.type == 406]
    pointers = {str(file.entities[i].pointer) for i in slots}
    owned: dict[str, None] = {}
    tails = []
    for entity in file.entities:
        count = _owned_properties(entity.parameters, pointers)
        tails.append(count)
        for token in entity.parameters[len(entity.parameters) - count :]:
            owned.setdefault(token)
    order = [*owned, *(str(file.entities[i].pointer) for i in slots if str(file.entities[i].pointer) not in owned)]
    by_pointer = {str(file.entities[i].pointer): file.entities[i] for i in slots}
    places = {token: str(file.entities[slot].pointer) for token, slot in zip(order, slots, strict=True)}
    for entity, count in zip(file.entities, tails, strict=True):
        first = len(entity.parameters) - count
        entity.parameters[first:] = [places[token] for token in entity.parameters[first:]]
    for token, slot in zip(order, slots, strict=True):
        file.entities[slot] = by_pointer[token]
    for token in order:
        by_pointer[token].pointer = int(places[token])


def _owned_properties(parameters: list[str], pointers: set[str]) -> int:
    """How many of the last parameters are the owner's properties."""
    count = 0
    while count < len(parameters) - 1 and parameters[-count - 1] in pointers:
        count += 1
        if parameters[-count - 1] == str(count):
            return count
    return 0
