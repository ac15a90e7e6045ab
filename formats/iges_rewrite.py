"""An IGES file with some entities changed: all other lines stay as they are but for the line numbers that move on.

A changed entity keeps its place in the directory, its status, level, colour and label. Where it takes more lines than before,
those behind it get new numbers, and the directory says where their parameters stand now.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from dataclasses import dataclass

from ..errors import InputError
from .iges_lines import COLUMNS, DATA, WIDTH
from .iges_records import Entity, IgesFile, parse, text_of, wrapped

_LINES = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")


@dataclass(frozen=True, slots=True)
class Change:
    """What an entity becomes: its type and form, its parameters (the type first), and whether its matrix is dropped."""

    type: int
    form: int
    parameters: list[str]
    placed: bool = False


def changed_text(text: str, file: IgesFile, changes: Mapping[int, Change]) -> str:
    """The text of a file with the entities at these places changed. `file` is the text taken apart.

    A file that is not as the standard wants it comes out in the standard's form. Raises InputError when what comes out is
    not what went in but for the changes.
    """
    out = _in_place(text, file, changes) if file.conforms else text_of(_changed(file, changes))
    _compare(file, parse(out), changes)
    return out


def _changed(file: IgesFile, changes: Mapping[int, Change]) -> IgesFile:
    made = copy.copy(file)
    made.entities = []
    for entity in file.entities:
        change = changes.get(entity.pointer)
        fields = entity.fields if change is None else _fields(entity, change)
        made.entities.append(Entity(entity.pointer, fields, change.parameters if change else entity.parameters))
    return made


def _fields(entity: Entity, change: Change) -> list[str]:
    fields = list(entity.fields)
    if entity.type != change.type:
        fields[0] = fields[10] = f"{change.type:>8}"
    if entity.type != change.type or change.form != _whole(fields[14]):
        fields[14] = f"{change.form:>8}"
    if change.placed:
        fields[6] = f"{0:>8}"
    return fields


def _compare(file: IgesFile, made: IgesFile, changes: Mapping[int, Change]) -> None:
    wanted = _changed(file, changes).entities
    same = len(made.entities) == len(wanted) and made.header == file.header and made.conforms
    for one, other in zip(wanted, made.entities, strict=False):
        same = same and one.parameters == other.parameters and _kept(one) == _kept(other)
    if not same:
        raise InputError("the file cannot be changed in one place alone")


def _kept(entity: Entity) -> list[str]:
    """The directory fields that tell no line."""
    return [text.strip() for place, text in enumerate(entity.fields) if place not in (1, 13)]


def _whole(text: str) -> int:
    return int(text) if text.strip() else 0


def _in_place(text: str, file: IgesFile, changes: Mapping[int, Change]) -> str:
    lines: list[str] = _LINES.findall(text)
    places: dict[str, list[int]] = {letter: [] for letter in "DPT"}
    for n, line in enumerate(lines):
        if (
            len(line) > DATA
            and line[DATA] in places
            and re.fullmatch(r"[ ]*\d+[ ]*", line[DATA + 1 : COLUMNS].rstrip("\r\n"))
        ):
            places[line[DATA]].append(n)
    if len(places["D"]) != 2 * len(file.entities):
        raise InputError("the file's lines cannot be told apart")
    parameters = [lines[n] for n in places["P"]]
    end = re.sub(r"^[^\r\n]*", "", parameters[0])
    begins = {_whole(entity.fields[1]): entity for entity in file.entities if entity.pointer in changes}
    out: list[str] = []
    moved: dict[int, int] = {}
    n = 1
    while n <= len(parameters):
        moved[n] = len(out) + 1
        entity = begins.get(n)
        if entity is None:
            out.append(_numbered(parameters[n - 1], len(out) + 1))
            n += 1
            continue
        pointer = parameters[n - 1][WIDTH:DATA]
        own = wrapped(changes[entity.pointer].parameters, WIDTH, file.separator, file.terminator)
        for line in own:
            out.append(_numbered(f"{line:<{WIDTH}}{pointer}P{0:>7}{end}", len(out) + 1))
        n += max(_whole(entity.fields[13]), 1)
    for entity in file.entities:
        first, second = (places["D"][entity.pointer - 1 + row] for row in (0, 1))
        begin = _whole(entity.fields[1])
        lines[first] = _field(lines[first], 1, begin, moved.get(begin, begin))
        change = changes.get(entity.pointer)
        if change is None:
            continue
        own = wrapped(change.parameters, WIDTH, file.separator, file.terminator)
        lines[second] = _field(lines[second], 3, _whole(entity.fields[13]), len(own))
        for k, (old, new) in enumerate(zip(entity.fields, _fields(entity, change), strict=True)):
            if old != new:
                row, column = (first, k) if k < 10 else (second, k - 10)
                lines[row] = _field(lines[row], column, _whole(old), _whole(new))
    for n in places["T"][:1]:
        count = lines[n][24:32]
        if count[:1] == "P" and count[1:].strip().isdigit():
            lines[n] = lines[n][:24] + "P" + _padded(len(out), count[1:]) + lines[n][32:]
    first = places["P"][0]
    taken = set(places["P"])
    return "".join(
        ["".join(out) if n == first else line for n, line in enumerate(lines) if n == first or n not in taken]
    )


def _numbered(line: str, number: int) -> str:
    """The line with that number in columns 74 to 80; untouched when it has it."""
    old = line[DATA + 1 : COLUMNS].rstrip("\r\n")
    if _whole(old) == number:
        return line
    return line[: DATA + 1] + _padded(number, old) + line[DATA + 1 + len(old) :]


def _field(line: str, column: int, old: int, new: int) -> str:
    """The line with another whole number in one of its fields of eight columns; untouched when it is the same."""
    if old == new:
        return line
    return line[: 8 * column] + _padded(new, line[8 * column : 8 * column + 8]) + line[8 * column + 8 :]


def _padded(number: int, like: str) -> str:
    """A number as wide as another text, with zeros in front where that has them."""
    return (
        f"{number:0{len(like)}d}" if like.strip().startswith("0") and like.strip() != "0" else f"{number:>{len(like)}}"
    )
