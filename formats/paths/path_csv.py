"""Tool paths as text: t, x, y, z a line, with or without an orientation.

    t, x, y, z                              s and the unit of the scene that names the file
    t, x, y, z, ax, ay, az, deg             turned about an axis by degrees
    t, x, y, z, i, j, k                     the direction of the tool's own z axis
    t, x, y, z, qw, qx, qy, qz              a unit quaternion (needs the header line)

Columns are separated by commas, semicolons, tabs or blanks, one of them throughout the file. A header line names the
columns in any order; without one they stand as above. From a # to the end of the line is comment.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError, SceneError
from ...motion.path import ToolPath, quaternion, rotation_of_quaternion, rotation_to_axis
from ...motion.pose import rotation_matrix
from ...spec import one_line, shown
from ..atomic import write_whole

Array = NDArray[np.float64]

SUFFIXES = (".csv", ".txt", ".tsv")
PLACE = ("t", "x", "y", "z")
ORIENTATIONS = {"turn": ("ax", "ay", "az", "deg"), "axis": ("i", "j", "k"), "quaternion": ("qw", "qx", "qy", "qz")}
COLUMNS = PLACE + tuple(name for names in ORIENTATIONS.values() for name in names)
LISTED_FAULTS = 20
"""A file of another kind has a fault on every line: more than this many are counted, not listed."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where in a line each column stands, and how the orientation is written ("" for none)."""

    place: tuple[int, ...]
    turned: tuple[int, ...]
    orientation: str
    count: int


class _LineError(Exception):
    """A fault of one line."""


def read(path: str | os.PathLike[str]) -> ToolPath:
    """The tool path of a file; lengths as they stand there.

    Raises SceneError with one "file:line: what" for every faulty line, InputError for a file that cannot be read or is
    of another kind.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        kinds = ", ".join(SUFFIXES)
        raise InputError(
            f"tool paths of kind {path.suffix or 'without suffix'!r} are not read",
            where=str(path),
            mend=f"the kinds that are read: {kinds}",
        )
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", where=str(path)) from error
    except UnicodeDecodeError as error:
        raise InputError(f"is no UTF-8 text: byte {error.start}", where=str(path)) from error
    return parse(text, str(path))


def parse(text: str, where: str) -> ToolPath:
    """The tool path of a text; `where` names it in errors. Raises SceneError, InputError as `read` does."""
    faults: list[str] = []
    layout: _Layout | None = None
    rows: list[tuple[float, Array, Array]] = []
    separator: str | None = None
    latest = -1.0
    for number, line in _lines(text):
        try:
            if layout is None:
                separator = next((mark for mark in "\t;," if mark in line), None)
            fields = [field.strip() for field in line.split(separator)]
            if layout is None:
                layout = _layout(fields)
                if not any(_is_number(field) for field in fields):
                    continue
            row = _row(fields, layout)
            before, latest = latest, row[0]
            if latest <= before:
                how = "goes back in time" if latest < before else "does not move on in time"
                raise _LineError(f"t {how}: {latest!r} after {before!r}")
            rows.append(row)
        except _LineError as error:
            faults.append(f"{where}:{number}: {one_line(str(error))}")
            if layout is None:
                break  # without its columns nothing below can be read
    if not rows and not faults:
        raise InputError("holds no path", where=where, mend="one line of t, x, y, z or more")
    if faults:
        more = len(faults) - LISTED_FAULTS
        raise SceneError(faults[:LISTED_FAULTS] + ([f"{where}: and {more} faults more"] if more > 0 else []))
    return ToolPath(np.array([r[0] for r in rows]), np.array([r[1] for r in rows]), np.array([r[2] for r in rows]))


def write(path: str | os.PathLike[str], tool_path: ToolPath) -> None:
    """Write a path with its header, 17 digits, whole or not at all. Raises InputError when the disk refuses."""
    write_whole(path, text_of(tool_path))


def text_of(tool_path: ToolPath) -> str:
    """The text that `read` reads back: t, x, y, z, and the quaternion of each row where the tool turns at all."""
    turned = bool((tool_path.rotation != np.eye(3)).any())
    lines = [",".join(PLACE + (ORIENTATIONS["quaternion"] if turned else ()))]
    for t, at, rotation in zip(tool_path.t, tool_path.at, tool_path.rotation, strict=True):
        values = [t, *at, *(quaternion(rotation) if turned else ())]
        lines.append(",".join(repr(float(value)) for value in values))
    return "\n".join(lines) + "\n"


def _lines(text: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(text.split("\n"), start=1):
        content = line.split("#", 1)[0].strip(" \r")
        if content.strip():
            yield number, content


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return "_" not in field


def _layout(fields: list[str]) -> _Layout:
    """The columns, from the header or, where a line of numbers comes first, from their count."""
    if any(_is_number(field) for field in fields):
        for kind in ("", "turn", "axis"):
            count = len(PLACE) + len(ORIENTATIONS.get(kind, ()))
            if len(fields) == count:
                return _Layout(tuple(range(4)), tuple(range(4, count)), kind, count)
        raise _LineError(f"has {len(fields)} columns, not 4 (t,x,y,z), 7 (and i,j,k) or 8 (and ax,ay,az,deg)")
    names = [field.lower() for field in fields]
    for name in names:
        if name not in COLUMNS:
            close = get_close_matches(name, COLUMNS, n=1, cutoff=0.5)
            raise _LineError(f"unknown column {shown(name)} " + (f"(did you mean {close[0]}?)" if close else _known()))
        if names.count(name) > 1:
            raise _LineError(f"column {name} stands twice")
    missing = [name for name in PLACE if name not in names]
    if missing:
        raise _LineError(f"column {missing[0]} is missing {_known()}")
    kinds = [kind for kind, group in ORIENTATIONS.items() if set(group) & set(names)]
    if len(kinds) > 1:
        both = " and by ".join(",".join(ORIENTATIONS[kind]) for kind in kinds)
        raise _LineError(f"the orientation is given twice: by {both}")
    kind = kinds[0] if kinds else ""
    group = ORIENTATIONS.get(kind, ())
    missing = [name for name in group if name not in names]
    if missing:
        raise _LineError(f"column {missing[0]} is missing (the orientation is {','.join(group)})")
    places = {name: names.index(name) for name in names}
    return _Layout(tuple(places[n] for n in PLACE), tuple(places[n] for n in group), kind, len(names))


def _known() -> str:
    choices = " or ".join(",".join(names) for names in ORIENTATIONS.values())
    return f"(columns are {','.join(PLACE)} and {choices})"


def _row(fields: list[str], layout: _Layout) -> tuple[float, Array, Array]:
    if len(fields) != layout.count:
        raise _LineError(f"has {len(fields)} columns where {layout.count} are expected")
    values: list[float] = []
    for field in fields:
        if not _is_number(field):
            comma = f" (write {field.replace(',', '.')})" if _is_number(field.replace(",", ".")) else ""
            raise _LineError(f"{shown(field)} is not a number{comma}")
        values.append(float(field))
        if not isfinite(values[-1]):
            raise _LineError(f"{field} is not a finite number")
    t, x, y, z = (values[i] for i in layout.place)
    if t < 0.0:
        raise _LineError(f"t is before time 0: {t!r}")
    turned = np.array([values[i] for i in layout.turned])
    return t, np.array([x, y, z]), _rotation(layout.orientation, turned)


def _rotation(kind: str, values: Array) -> Array:
    if kind == "turn":
        if values[3] != 0.0 and not values[:3].any():
            raise _LineError("the turn has no axis: ax, ay and az are 0")
        return rotation_matrix(values[:3], float(values[3]))
    if kind == "axis":
        if not values.any():
            raise _LineError("the tool's axis i, j, k has no length")
        return rotation_to_axis(values)
    if kind == "quaternion":
        length = float(np.sqrt(values @ values))
        if abs(length - 1.0) > 1e-3:
            raise _LineError(f"the quaternion's length is {length:.6g}, not 1")
        return rotation_of_quaternion(values)
    return np.eye(3)
