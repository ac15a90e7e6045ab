"""What a CAD or mesh file holds: the object of `inspect --json`, in mm and mm2 whatever the file's unit."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from ..errors import CadsculptError
from ..units import conversion, unit_name
from .part import Face, Part

T = TypeVar("T")

LARGEST = 1e50
"""mm; readers give numbers like 1e100 to surfaces that have no end."""


def inspect_object(part: Part, on_face: Callable[[int, int], None] | None = None) -> dict[str, Any]:
    """The object: `format`, `units` (the file's), `faces`, `area`, `bbox` and `warnings`.

    A number that a face does not have is None, and a warning says why; the other faces are listed all the same.
    on_face : told the number of faces done and of all faces.
    """
    warnings = list(part.warnings)
    faces = []
    instance_of = {number: instance.name for instance in part.instances for number in instance.faces}
    for done, face in enumerate(part.faces, 1):
        named = {"instance": instance_of[face.number]} if face.number in instance_of else {}
        faces.append({**_face_object(face, warnings), **named})
        if on_face:
            on_face(done, len(part.faces))
    warnings += part.warnings  # looking at the faces may have added some
    areas = [face["area"] for face in faces if face["area"] is not None]
    boxes = [face["bbox"] for face in faces if face["bbox"] is not None]
    return {
        "format": part.format,
        "units": part.units,
        "faces": faces,
        "area": math.fsum(areas),
        "bbox": [*(min(b[k] for b in boxes) for k in range(3)), *(max(b[k] for b in boxes) for k in range(3, 6))]
        if boxes
        else None,
        "warnings": list(dict.fromkeys(warnings)),
    }


def mesh_object(path: Path, units: str | None = None) -> dict[str, Any]:
    """The object of a mesh file: no faces, and what is known of its triangles.

    units : of the file's numbers, which name none; mm, with a warning, when left out. `volume` is None where the mesh
    is open. Raises InputError or GeometryError when the file cannot be read or holds no surface.
    """
    from .mesh import read_mesh

    unit = "mm" if units is None else unit_name(units)
    mesh = read_mesh(path, conversion(unit, "mm"))
    warnings = list(mesh.warnings)
    if units is None:
        warnings.insert(0, "a mesh file names no unit: its numbers are taken as mm")
    if mesh.fault:
        warnings.append(f"{mesh.fault}: it cannot be a tool")
    return {
        "format": path.suffix.lower().lstrip("."),
        "units": None if units is None else unit,
        "faces": [],
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.triangles),
        "shells": mesh.shells,
        "closed": mesh.closed,
        "open_edges": len(mesh.open_edges),
        "area": mesh.area,
        "volume": mesh.volume if mesh.closed else None,
        "bbox": [float(x) for x in mesh.box.ravel()],
        "warnings": warnings,
    }


def _face_object(face: Face, warnings: list[str]) -> dict[str, Any]:
    where = f"face {face.number} {face.name!r}"
    surface = _tried(lambda: face.surface, where, warnings)
    area = _tried(lambda: face.area, where, warnings)
    bbox = _tried(lambda: face.bbox, where, warnings)
    if area is not None and not (math.isfinite(area) and area < LARGEST):
        warnings.append(f"{where}: it has no finite area")
        area = None
    if bbox is not None and not all(math.isfinite(x) and abs(x) < LARGEST for x in bbox):
        warnings.append(f"{where}: it has no finite size")
        bbox = None
    if face.warning:
        warnings.append(f"{where}: {face.warning}")
    return {
        "name": face.name,
        "number": face.number,
        "kind": face.kind,
        "degree": [surface.degree_u, surface.degree_v] if surface is not None else None,
        "control_points": list(surface.shape) if surface is not None else None,
        "rational": surface.rational if surface is not None else None,
        "closed": [bool(surface.closed_u), bool(surface.closed_v)] if surface is not None else None,
        "trimmed": bool(face.trimmed),
        "area": float(area) if area is not None else None,
        "bbox": [float(x) for x in bbox] if bbox is not None else None,
    }


def _tried(read: Callable[[], T], where: str, warnings: list[str]) -> T | None:
    """What `read` gives; None and a warning when the face does not have it."""
    try:
        return read()
    except CadsculptError as error:
        warnings.append(f"{where}: {error}")
        return None
