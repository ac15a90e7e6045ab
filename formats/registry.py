"""Which reader and writer a file belongs to."""

from __future__ import annotations

from pathlib import Path

from ..errors import InputError
from .part import Part


def read(path: Path | str, *, units: str | None = None) -> Part:
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in (".step", ".stp", ".p21"):
        from . import step
        return step.read(path, units=units)
    if suffix in (".iges", ".igs"):
        from . import iges
        return iges.read(path, units=units)
    if suffix == ".3dm":
        from . import rhino
        return rhino.read(path)
    if suffix == ".json":
        from . import patch_json
        return patch_json.read(path)
    raise InputError("not a CAD file that is read", where=str(path))


def write_part(part: Part, path: Path, format: str) -> None:
    part.write(Path(path), format)
