"""The records of an IGES file (version 5.3, section 2.2): global section, directory entries and parameters, and back.

Nothing here knows what an entity means; numbers stay the text they are, so that a file passes through unchanged where
nobody changes it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

_WIDTH = 64
"""Columns of a parameter line that hold data."""

_GLOBAL_WIDTH = 72
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


def parse(text: str) -> IgesFile:
    """Take a file apart. Lines that belong to no section (comments after the data) are left out."""
    sections: dict[str, list[str]] = {letter: [] for letter in "SGDPT"}
    for line in text.splitlines():
        if len(line) > _GLOBAL_WIDTH and line[_GLOBAL_WIDTH] in sections:
            sections[line[_GLOBAL_WIDTH]].append(line)
    disordered = sum(
        _integer(line[_GLOBAL_WIDTH + 1 : 80]) != n for letter in "SGDP" for n, line in enumerate(sections[letter], 1)
    )
    file = IgesFile(disordered=disordered, start=[line[:_GLOBAL_WIDTH].rstrip() for line in sections["S"]])
    header = "".join(line[:_GLOBAL_WIDTH] for line in sections["G"])
    file.separator, file.terminator = _delimiters(header)
    file.header = tokens(header, file.separator, file.terminator)
    file.complete = bool(sections["T"])
    directory, lines = sections["D"], [_data(line, file) for line in sections["P"]]
    for i in range(0, len(directory) - 1, 2):
        first, second = directory[i].ljust(80), directory[i + 1].ljust(80)
        fields = [row[8 * k : 8 * k + 8] for row in (first, second) for k in range(9)]
        fields.insert(9, "")
        fields.append("")
        begin, count = _integer(fields[1]), _integer(fields[13])
        own = lines[begin - 1 : begin - 1 + count] if begin > 0 else []
        parameters = tokens("".join(own), file.separator, file.terminator)
        backs = sections["P"][begin - 1 : begin - 1 + count] if begin > 0 else []
        file.disordered += sum(_integer(line[_WIDTH + 1 : _GLOBAL_WIDTH].strip(" ,;")) != i + 1 for line in backs)
        if not parameters or _integer(parameters[0]) != _integer(fields[0]):
            file.broken += 1
        file.entities.append(Entity(i + 1, fields, parameters))
    return file


def _data(line: str, file: IgesFile) -> str:
    """The data of a parameter line; some exporters put the last delimiter into the column that should be blank."""
    if line[_WIDTH] not in (file.separator, file.terminator):
        return line[:_WIDTH]
    file.crowded += 1
    return line[: _WIDTH + 1]


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


def tokens(text: str, separator: str = ",", terminator: str = ";") -> list[str]:
    """Free-format parameters up to the record delimiter; strings (5Hhello) may hold delimiters."""
    if "H" not in text:
        return [token.strip() for token in text.split(terminator, 1)[0].split(separator)] if text.strip() else []
    found: list[str] = []
    at = 0
    while at < len(text):
        while at < len(text) and text[at] == " ":
            at += 1
        match = _HOLLERITH.match(text, at)
        if match:
            end = match.end() + int(match[1])
            token = text[at:end]
            at = end
            while at < len(text) and text[at] not in (separator, terminator):
                at += 1
        else:
            begin = at
            while at < len(text) and text[at] not in (separator, terminator):
                at += 1
            token = text[begin:at].strip()
        found.append(token)
        if at >= len(text) or text[at] == terminator:
            break
        at += 1
    return found


# ---------------------------------------------------------------------- back to text


def _wrapped(parameters: list[str], width: int, separator: str, terminator: str) -> list[str]:
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
    header = _wrapped(file.header, _GLOBAL_WIDTH, file.separator, file.terminator)
    for n, line in enumerate(header, 1):
        put(line, "G", n)
    parameter_lines: list[tuple[str, int]] = []
    for entity in file.entities:
        own = _wrapped(entity.parameters, _WIDTH, file.separator, file.terminator)
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
