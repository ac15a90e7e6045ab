"""Tool paths in files of any kind that is read: CSV, G-code, APT; the suffix decides."""

from __future__ import annotations

import os
from pathlib import Path

from ...errors import InputError
from ...scene_tool import PathOptions
from . import apt, gcode, path_csv
from .path_rows import ReadPath

SUFFIXES = path_csv.SUFFIXES + gcode.SUFFIXES + apt.SUFFIXES


def read(path: str | os.PathLike[str], units: str = "mm", options: PathOptions | None = None) -> ReadPath:
    """The tool path of a file, lengths in `units` (those of a CSV file are in it already).

    Raises SceneError with one "file:line: what" for every fault found, InputError for a file that cannot be read, holds no
    path or is of another kind.
    """
    suffix = Path(path).suffix.lower()
    if suffix in gcode.SUFFIXES:
        return gcode.read(path, units, options)
    if suffix in apt.SUFFIXES:
        return apt.read(path, units, options)
    if suffix in path_csv.SUFFIXES:
        return ReadPath(path_csv.read(path), _cut_off(Path(path)))
    raise InputError(
        f"tool paths of kind {suffix or 'without suffix'!r} are not read",
        where=str(path),
        mend=f"the kinds that are read: {', '.join(SUFFIXES)}",
    )


def _cut_off(path: Path) -> tuple[str, ...]:
    """A warning where a table's last line has no end: nothing else tells that a file was cut off."""
    with open(path, "rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(max(file.tell() - 1, 0))
        last = file.read(1)
    return () if last in (b"\n", b"\r") else ("its last line has no end: the file may have been cut off",)
