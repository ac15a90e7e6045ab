"""Tool paths in files of any kind that is read: CSV, G-code, APT; the suffix decides."""

from __future__ import annotations

import os
from pathlib import Path

from ...errors import InputError
from ...scene_tool import PathOptions
from ..cut_off import unended
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
        return ReadPath(path_csv.read(path), unended(Path(path).read_bytes()))
    raise InputError(
        f"tool paths of kind {suffix or 'without suffix'!r} are not read",
        where=str(path),
        mend=f"the kinds that are read: {', '.join(SUFFIXES)}",
    )
