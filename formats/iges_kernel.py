"""What of a sound IGES file the CAD kernel misreads without a word, put into words that it understands.

Matrices that refer to matrices (124, section 4.21) it takes without the outer ones; a flag or name of the length unit that it
does not know (section 2.2.4.3) it takes as nothing or as mm; splines whose last parameters were left out (126 and 128) it
drops.
"""

from __future__ import annotations

import copy
import math
import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..units import conversion, unit_name
from .iges_entities import number, spline_counts
from .iges_records import Entity, IgesFile
from .step_text import step_real

Array = NDArray[np.float64]

UNIT_OF_FLAG = {1: "in", 2: "mm", 4: "ft", 5: "mi", 6: "m", 7: "km", 8: "mil", 9: "um", 10: "cm", 11: "uin"}
"""Length units by the global section's unit flag; flag 3 goes by the name."""

_FLAG_OF_UNIT = {unit: flag for flag, unit in UNIT_OF_FLAG.items()}
_NAMED = 3
_FLAG, _NAME, _RESOLUTION = 13, 14, 18
"""Places of the unit's flag and name, and of the resolution, in the global section."""


@dataclass(frozen=True, slots=True)
class Unit:
    """A file's length unit: its name, the kernel's units that one of it is, and what to say about it."""

    name: str
    kernel_factor: float
    flag: int
    said: tuple[str, ...] = ()


def unit_of(file: IgesFile) -> Unit:
    """The file's length unit from its global section: by its flag, else by its name, else inches as the standard has it."""
    flag, name = (*file.header[_FLAG : _NAME + 1], "", "")[:2]
    text = re.sub(r"^\d+H", "", name).strip()
    number = int(flag) if flag.strip().isdigit() else (0 if flag.strip() else 1)
    if not flag.strip() and text:
        number = _NAMED
    if number in UNIT_OF_FLAG:
        unit = UNIT_OF_FLAG[number]
        said: tuple[str, ...] = ()
        if text and _named(text) not in (None, unit):
            said = (f"its unit flag {number} says {unit}, its unit name {text!r}: the flag was believed",)
        return Unit(unit, 1.0, number, said)
    named = _named(text)
    if named is None:
        what = f"the file's length unit {text!r} (flag {flag!r}) is not known; its numbers are taken as mm"
        return Unit("mm", 1.0, _FLAG_OF_UNIT["mm"], (what,))
    said = () if number == _NAMED else (f"its unit flag {flag!r} is not known: its unit name {text!r} was believed",)
    if named in _FLAG_OF_UNIT:
        return Unit(named, 1.0, _FLAG_OF_UNIT[named], said)
    return Unit(named, conversion(named, "mm"), _FLAG_OF_UNIT["mm"], said)


def resolution_of(file: IgesFile) -> float | None:
    """The smallest distance that the sender meant, in the file's unit (global parameter 19); None when it does not say."""
    text = file.header[_RESOLUTION].strip() if len(file.header) > _RESOLUTION else ""
    return number(text) if text else None


def _named(text: str) -> str | None:
    try:
        return unit_name(text)
    except InputError:
        return None


def for_kernel(file: IgesFile, unit: Unit) -> tuple[IgesFile, list[str]] | None:
    """The file as the kernel reads it rightly, and what was done; None when it does so as it is."""
    header = _header(file, unit)
    chained = [e for e in file.entities if e.type == 124 and matrix_pointer(e) and file.at(matrix_pointer(e))]
    short = {e.pointer: whole for e in file.entities if e.type in (126, 128) and (whole := completed(e.parameters))}
    if header is None and not chained and not short:
        return None
    made = copy.copy(file)
    made.header = header or file.header
    said = []
    if chained:
        said.append(
            f"{len(chained)} of its transformation matrices refer to others, which the CAD kernel overlooks: they were"
            " multiplied"
        )
    if short:
        said.append(f"{len(short)} of its splines lack their last parameters, which follow from their knots")
    made.entities = []
    for entity in file.entities:
        if entity in chained:
            fields = list(entity.fields)
            fields[6] = "0"
            matrix = matrix_of(file, entity.pointer)
            values = [step_real(float(x)) for x in matrix[:3].ravel()]
            entity = Entity(entity.pointer, fields, ["124", *values, *entity.parameters[13:]])
        elif entity.pointer in short:
            entity = Entity(entity.pointer, entity.fields, short[entity.pointer])
        made.entities.append(entity)
    return made, said


def _header(file: IgesFile, unit: Unit) -> list[str] | None:
    """The global section with a unit flag that the kernel knows; None when it has one."""
    flag = file.header[_FLAG].strip() if len(file.header) > _FLAG else ""
    if flag == str(unit.flag):
        return None
    header = [*file.header, *[""] * (_NAME + 1 - len(file.header))]
    header[_FLAG], header[_NAME] = str(unit.flag), ""
    return header


def matrix_pointer(entity: Entity) -> int:
    """The place of the transformation matrix that an entity's directory entry names; 0 for none."""
    text = entity.fields[6].strip()
    return int(text) if text.isdigit() else 0


def matrix_of(file: IgesFile, pointer: int) -> Array:
    """(4, 4) of the transformation matrix at `pointer` and of all that it refers to; the identity for 0.

    Raises InputError for what is no matrix, and for matrices that refer to each other in a ring.
    """
    matrix, seen = np.eye(4), set()
    while pointer:
        entity = file.at(pointer)
        if entity is None or entity.type != 124 or pointer in seen:
            raise InputError(f"entity {pointer} is no transformation matrix, or refers to itself")
        seen.add(pointer)
        values = [number(token) for token in entity.parameters[1:13]]
        if len(values) < 12 or any(value is None for value in values):
            raise InputError(f"the transformation matrix of entity {pointer} is damaged")
        here = np.eye(4)
        here[:3] = np.array(values, dtype=np.float64).reshape(3, 4)
        matrix = here @ matrix
        pointer = matrix_pointer(entity)
    return matrix


def completed(parameters: list[str]) -> list[str] | None:
    """The parameters of a spline (126, 128) whose parameter range was left out, with that of its knots; None when whole."""
    counts = spline_counts(parameters)
    if counts is None:
        return None
    upper, degree = counts
    at = 10 if len(upper) == 2 else 7
    lengths = [k + m + 2 for k, m in zip(upper, degree, strict=True)]
    end = at + sum(lengths) + 4 * math.prod(k + 1 for k in upper)
    needed = end + 2 * len(upper)
    if not end <= len(parameters) < needed:
        return None
    ends, begin = [], at
    for length, m in zip(lengths, degree, strict=True):
        ends += [parameters[begin + m], parameters[begin + length - m - 1]]
        begin += length
    return [*parameters[:end], *ends]
