"""Which reader and which writer a CAD file belongs to."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ..errors import InputError
from ..spline.surface import BSplineSurface
from ..units import conversion, unit_name
from .part import Part
from .unit_doubt import unit_doubt

Reader = Callable[..., Part]

SUFFIXES = {
    ".step": "step", ".stp": "step", ".p21": "step",
    ".iges": "iges", ".igs": "iges",
    ".3dm": "3dm",
    ".json": "json",
    ".g2": "g2",
    ".xml": "gismo",
}  # fmt: skip
"""File name extensions and the formats that they stand for."""

NAMES = {
    "step": "STEP",
    "iges": "IGES",
    "3dm": "Rhino 3DM",
    "json": "patch JSON",
    "g2": "GoTools g2",
    "gismo": "G+Smo XML",
}


CAD_SYSTEMS = ("step", "iges", "3dm")
"""Formats whose files name their unit without their author having chosen it."""


def read(path: str | os.PathLike[str], *, units: str | None = None) -> Part:
    """Read a CAD file of any known format.

    The content decides; where the extension says something else, the part's warnings say so. units : length unit to take
    the file's numbers in, whatever the file says. Raises InputError naming what is wrong with the file.
    """
    path = Path(path)
    if units is not None:
        units = unit_name(units)
    said, found = SUFFIXES.get(path.suffix.lower()), _sniffed(path)
    format = found or said
    if format is None:
        raise InputError(
            "this is no CAD file that cadsculpt reads",
            where=str(path),
            mend=f"it reads {', '.join(NAMES.values())}: {' '.join(SUFFIXES)}",
        )
    part = _reader(format)(path, units=units)
    if units is None and part.units and part.format in CAD_SYSTEMS:
        doubt = unit_doubt(part.extent, part.units, part.tolerance, part.recorded_area)
        part.warnings += [doubt] if doubt else []
    if found and said and found != said:
        part.warnings.append(f"its name says {NAMES[said]}, but it is a {NAMES[found]} file")
    return part


def write_part(part: Part, path: str | os.PathLike[str], format: str) -> None:
    """Write a whole part as step, iges, 3dm, json, g2 or gismo, whole or not at all, the same bytes every time.

    What the format cannot hold is named in the part's warnings. Raises InputError when it cannot be written.
    """
    path = Path(path)
    if format not in NAMES:
        raise InputError(f"no format {format!r}", where=str(path), mend=f"use one of {', '.join(NAMES)}")
    if format == "3dm":
        from .rhino.part import write_part as write_rhino

        write_rhino(part, path)
    elif format == "json" and part.format != "json":
        from .patch_json import write_surfaces

        left_out = [face.name for face in part.faces if face.warning]
        if left_out:
            part.warnings.append(f"faces without an exact surface are left out: {_listed(left_out)}")
        write_surfaces(path, [face.surface for face in part.faces if not face.warning], "mm")
    elif format in ("g2", "gismo"):
        _write_spline_library(part, path, format)
    else:
        part.write(path, format)


def surfaces_in_file_units(part: Part) -> list[BSplineSurface]:
    """The faces' surfaces with their names, in the unit of the file that they come from; of a face without one, none."""
    from .patch_part import PatchPart

    if isinstance(part, PatchPart):
        return part.in_units()  # with the file's own bits
    factor = conversion("mm", part.units or "mm")
    faces = [face for face in part.faces if not face.warning]
    return [replace(face.surface.scaled(factor), name=face.name) for face in faces]


def _write_spline_library(part: Part, path: Path, format: str) -> None:
    from . import gismo, gotools

    surfaces = surfaces_in_file_units(part)
    left_out = [face.name for face in part.faces if face.warning]
    if left_out:
        part.warnings.append(f"faces without an exact surface are left out: {_listed(left_out)}")
    if not surfaces:
        raise InputError("the part has no surfaces to write", where=str(path))
    if part.units:
        part.warnings.append(f"{NAMES[format]} has no length unit: the numbers are in {part.units}")
    trimmed = [surface.name for surface in surfaces if surface.trims is not None]
    if format == "gismo" and trimmed:
        part.warnings.append(f"G+Smo XML has no trims: written as whole surfaces are {_listed(trimmed)}")
    (gotools if format == "g2" else gismo).write_surfaces(path, surfaces)


def _listed(names: list[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def _reader(format: str) -> Reader:
    if format == "step":
        from . import step

        return step.read
    if format == "iges":
        from . import iges

        return iges.read
    if format == "3dm":
        from .rhino import part as rhino

        return rhino.read
    if format == "g2":
        from . import gotools

        return gotools.read
    if format == "gismo":
        from . import gismo

        return gismo.read
    from . import patch_json

    return patch_json.read


def _sniffed(path: Path) -> str | None:
    """The format that the first bytes show; None when they show none, or the file cannot be read."""
    try:
        with open(path, "rb") as file:
            head = file.read(512)
    except OSError:
        return None
    if head.startswith(b"3D Geometry File Format"):
        return "3dm"
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if text.startswith(b"ISO-10303-21"):
        return "step"
    if text.startswith(b"{"):
        return "json"
    if text.startswith(b"<") and b"<xml" in text:
        return "gismo"
    if re.match(rb"(?:100|200|210|2[5-9]0|700)[ \t]+1[ \t]+\d+[ \t]+\d+\s", text):
        return "g2"
    lines = head.splitlines()
    if lines and len(lines[0]) >= 73 and lines[0][72:73] == b"S":
        return "iges"
    return None
