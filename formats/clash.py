"""Two bodies of `cadsculpt collide`: files, single faces of files, or meshes; and the object that it prints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..collide.certified.proximity import Proximity
from ..errors import InputError
from ..units import conversion
from . import registry
from .mesh import TRIANGLE_FORMATS, read_mesh


@dataclass(frozen=True, slots=True, eq=False)
class NamedBody:
    """What `collision.collide` takes, in mm. label : its file's name and face. faces : the names of its faces, by place.
    left_out : of those without an exact surface."""

    label: str
    body: Any
    faces: tuple[str, ...]
    left_out: tuple[str, ...] = ()


def body_named(text: str, units: str | None, on_file: Callable[[str], None], warnings: list[str]) -> NamedBody:
    """The body that "FILE", "FILE#FACE" (a name or a number) or "MESH" names. Lengths come out in mm.

    Raises InputError for a file that cannot be read or has no such face.
    """
    path, face = Path(text), ""
    if not path.exists() and "#" in text:
        name, _, face = text.rpartition("#")
        path = Path(name)
    on_file(path.name)
    if path.suffix.lower() in TRIANGLE_FORMATS:
        if face:
            raise InputError("a mesh has no faces to choose from", where=text, mend=f"write {path}")
        mesh = read_mesh(path, conversion(units or "mm", "mm"))
        warnings += [f"{path.name}: {line}" for line in mesh.warnings]
        if not mesh.closed:
            warnings.append(f"{path.name}: the mesh is open: it counts as a sheet, without an inside")
        if units is None:
            warnings.append(
                f"{path.name}: a mesh names no unit; its numbers are taken as mm (--units-a, --units-b say otherwise)"
            )
        return NamedBody(path.name, mesh, ())
    part = registry.read(path, units=units)
    chosen = list(part.faces)
    if face:
        known = {f.name for f in part.faces}
        chosen = [part.faces.number(int(face)) if face.isdigit() and face not in known else part.faces.named(face)]
    surfaces = [f.surface for f in chosen if not f.warning]
    warnings += [f"{path.name}: {line}" for line in part.warnings]
    left_out = [f.name for f in chosen if f.warning]
    if left_out:
        warnings.append(f"{path.name}: faces without an exact surface are left out: {', '.join(left_out[:5])}")
    if not surfaces:
        raise InputError("it has no face to collide", where=text, mend="cadsculpt inspect lists what a file holds")
    label = f"{path.name}#{face}" if face else path.name
    return NamedBody(label, surfaces, tuple(f.name for f in chosen if not f.warning), tuple(left_out))


def clash_object(result: Proximity, a: NamedBody, b: NamedBody) -> dict[str, Any]:
    """The object of `collide --json`, lengths in mm."""
    found = result.distance
    pairs = result.contacts
    left_out = [*a.left_out, *b.left_out]
    # nobody knows of what was not looked at
    verdict = "undecided" if left_out and result.verdict == "clear" else result.verdict
    return {
        "verdict": verdict,
        "kind": result.kind,
        "distance": [found.low, found.high],
        "clearance": result.clearance,
        "touch": result.touch,
        "left_out": left_out,
        "contacts": [
            {
                "point": pairs.point[i].tolist(),
                "normal": pairs.normal[i].tolist() if np.isfinite(pairs.normal[i]).all() else None,
                "depth": float(pairs.depth[i]),
                "a": _side(a, int(pairs.face_a[i]), pairs.u_a[i], pairs.v_a[i], pairs.point[i]),
                "b": _side(b, int(pairs.face_b[i]), pairs.u_b[i], pairs.v_b[i], pairs.other[i]),
            }
            for i in range(len(pairs))
        ],
    }


def _side(body: NamedBody, face: int, u: float, v: float, point: Any) -> dict[str, Any]:
    """A contact's place on one body: the face's name and (u, v), null on a mesh."""
    on_face = face >= 0 and bool(body.faces)
    return {
        "face": body.faces[face] if on_face else None,
        "u": float(u) if on_face else None,
        "v": float(v) if on_face else None,
        "point": [float(x) for x in point],
    }
