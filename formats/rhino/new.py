"""Any part as a new 3DM file: faces that meet become Breps with shared edges, lone untrimmed ones surfaces."""

from __future__ import annotations

import base64
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import CadsculptError, InputError
from ...spline.surface import BSplineSurface
from ..occt.part import OcctPart
from ..occt.quiet import quiet
from ..part import Part
from .archive import BUFFER_VERSION, HEADER_SIZE, Writer, chunks, length_size
from .brep import brep_chunk
from .geometry import clamped_surface, decoded, library
from .new_brep import BrepBuilder
from .new_trims import own_curves
from .nurbs import Nurbs, nurbs_chunk
from .seam import copies, without_copies
from .user_text import describe_faces

Array = NDArray[np.float64]

ARCHIVE = 8
"""The 3DM version of new files."""

PROPERTIES_TABLE = 0x10000014
REVISION_HISTORY = 0x20008021


def new_file(part: Part) -> bytes:
    """The bytes of a 3DM file, in mm, with all faces of a part; the same part gives the same bytes.

    Faces that openNURBS does not take as a trimmed Brep are written untrimmed, and the part's warnings say which.
    Raises InputError when the part has no faces.
    """
    rhino3dm = library()
    model = rhino3dm.File3dm()
    model.Settings.ModelUnitSystem = rhino3dm.UnitSystem.Millimeters
    root = uuid.uuid5(uuid.NAMESPACE_OID, "cadsculpt")
    layer = rhino3dm.Layer()
    layer.Name = "Default"
    layer.Id = uuid.uuid5(root, "layer")  # one that openNURBS makes up has another identity in every run
    model.Layers.Add(layer)
    count = 0
    for entry in _things(part):
        attributes = rhino3dm.ObjectAttributes()
        attributes.Name = entry.name
        describe_faces(attributes, entry.names, entry.periodic)
        attributes.LayerIndex = 0
        if isinstance(entry.thing, rhino3dm.Brep):
            model.Objects.AddBrep(entry.thing, attributes)
        else:
            model.Objects.AddSurface(entry.thing, attributes)
        count += 1
    if not count:
        raise InputError("there is nothing to write", where=str(part.path), mend="the part has no faces")
    for i, thing in enumerate(model.Objects):
        thing.Attributes.Id = uuid.uuid5(root, f"object {i}")
    options = rhino3dm.File3dmWriteOptions()
    options.Version = ARCHIVE
    return _without_dates(base64.b64decode(model.Encode(options)))


def _without_dates(data: bytes) -> bytes:
    """The file without its revision history, which is a clock time."""
    version = int(data[24:HEADER_SIZE])
    out = bytearray(data[:HEADER_SIZE])
    for table in chunks(data, HEADER_SIZE, len(data), version):
        if table.typecode == PROPERTIES_TABLE:
            writer = Writer(version)
            writer.begin(PROPERTIES_TABLE)
            for entry in chunks(data, table.body, table.end, version):
                if entry.typecode != REVISION_HISTORY:
                    writer.whole(data[entry.start : entry.end])
            writer.end()
            out += writer.finished()
        else:
            out += data[table.start : table.end]
    size = length_size(version)
    out[-size:] = len(out).to_bytes(size, "little")
    return bytes(out)


@dataclass(frozen=True, slots=True, eq=False)
class _Entry:
    """An object of the new file: its name, those of its faces where they need their own, rhino3dm's Brep or surface.

    periodic : per face, the directions that are written `without_copies`; moved : `BrepBuilder.moved`.
    """

    name: str
    thing: Any
    names: Sequence[str] = ()
    periodic: Sequence[str] = ()
    moved: Mapping[str, float] = field(default_factory=dict)


def _things(part: Part) -> Iterator[_Entry]:
    """All objects of the new file; what it cannot hold goes into the part's warnings."""
    given: list[BSplineSurface] = []
    if isinstance(part, OcctPart):
        kernel = part
    else:
        given = [face.surface for face in part.faces if not face.warning]
        with quiet():
            kernel = _in_kernel(given, part.path)
    untrimmed: list[str] = []
    moved: dict[str, float] = {}
    for group in _groups(kernel):
        surfaces: list[tuple[int, BSplineSurface]] = []
        for number in group:
            try:
                surfaces.append((number, given[number - 1] if given else kernel.faces.number(number).surface))
            except CadsculptError as error:
                part.warnings.append(f"face {kernel.faces.number(number).name} is not in the 3DM file: {error.what}")
        whole = _valid_brep(kernel, surfaces) if len(surfaces) > 1 else None
        if whole is not None:
            moved |= whole.moved
            names = [surface.name for _, surface in surfaces]
            yield replace(whole, name=f"{names[0]} and {len(names) - 1} more", names=names)
            continue
        for item in surfaces:
            surface = item[1]
            # a surface that stands alone has no other side than its own
            alone = None if surface.trims is None and surface.outward else _valid_brep(kernel, [item])
            if alone is None:
                alone = _valid_surface(surface)
                if alone is None:
                    part.warnings.append(f"face {surface.name} is not in the 3DM file: openNURBS refuses its surface")
                    continue
                if surface.trims is not None:
                    untrimmed.append(surface.name)
            moved |= alone.moved
            yield alone
    far = f"with trims moved by up to {max(moved.values(), default=0.0):.2g} of the range"
    for names, what in ((untrimmed, "without their trims"), (list(moved), far)):
        if names:
            shown = ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
            part.warnings.append(f"in the 3DM file {what} ({len(names)}): {shown}")


def _valid_surface(surface: BSplineSurface) -> _Entry | None:
    """rhino3dm's surface, its ends clamped where openNURBS insists; None when it refuses both."""
    for form in (_nurbs, _clamped):
        thing = decoded(nurbs_chunk(form(surface), BUFFER_VERSION))
        if thing is not None and thing.IsValid:
            return _Entry(surface.name, thing, periodic=[_periodic(surface)] if form is _nurbs else ())
    return None


def _in_kernel(surfaces: Sequence[BSplineSurface], path: Path) -> OcctPart:
    """Surfaces as faces in the CAD kernel, each by itself."""
    from ..occt.part import document_of_shapes
    from ..occt.shape import shape_of_surface

    return document_of_shapes([(surface.name, shape_of_surface(surface)) for surface in surfaces], path=path)


def _groups(part: OcctPart) -> list[list[int]]:
    """Face numbers, those that hang together by edges in one list."""
    root = {face.number: face.number for face in part.faces}

    def find(number: int) -> int:
        while root[number] != number:
            root[number] = number = root[root[number]]
        return number

    for face in part.faces:
        try:
            loops = part.face(face.number).boundary.loops
        except CadsculptError:
            continue
        for item in (item for loop in loops for item in loop):
            for other in part.faces_on(item.edge):
                a, b = find(face.number), find(other)
                root[max(a, b)] = min(a, b)
    groups: dict[int, list[int]] = {}
    for number in root:
        groups.setdefault(find(number), []).append(number)
    return list(groups.values())


# ------------------------------------------------------------------------- Brep


def _valid_brep(part: OcctPart, surfaces: Sequence[tuple[int, BSplineSurface]]) -> _Entry | None:
    """rhino3dm's Brep of these faces; None when openNURBS refuses it.

    Closed ends are clamped only where openNURBS insists, and trim curves moved only on the faces that it does not take
    with them as they are.
    """
    with quiet():
        for form in (_nurbs, _clamped):
            found = _brep(part, surfaces, form, set())
            if found is not None:
                return found
        bad = {item[0] for item in surfaces if len(surfaces) == 1 or _brep(part, [item], _clamped, set()) is None}
        for form in (_nurbs, _clamped):
            found = _brep(part, surfaces, form, bad or {number for number, _ in surfaces})
            if found is not None:
                return found
    return None


def _brep(
    part: OcctPart,
    surfaces: Sequence[tuple[int, BSplineSurface]],
    form: Callable[[BSplineSurface], Nurbs],
    inexact: set[int],
) -> _Entry | None:
    """rhino3dm's Brep, None when it is not valid. inexact : faces whose trim curves may be moved a little."""
    builder = BrepBuilder(form)
    try:
        for number, surface in surfaces:
            boundary = part.face(number).boundary
            if boundary.lost or not boundary.loops:
                return None
            loops = own_curves(boundary.loops, surface)
            builder.add(surface, loops, boundary.outer, exact=number not in inexact)
    except CadsculptError:
        return None
    thing = decoded(brep_chunk(builder.brep()))
    if thing is None or not thing.IsValid:
        return None
    periodic = [_periodic(surface) for _, surface in surfaces] if form is _nurbs else ()
    return _Entry(surfaces[0][1].name, thing, periodic=periodic, moved=builder.moved)


def _nurbs(surface: BSplineSurface) -> Nurbs:
    points, (knots_u, knots_v) = without_copies(surface)
    if surface.weights is not None:
        points = np.concatenate([points[..., :3] * points[..., 3:], points[..., 3:]], axis=2)
    return Nurbs(3, surface.rational, (surface.degree_u, surface.degree_v), (knots_u[1:-1], knots_v[1:-1]), points)


def _clamped(surface: BSplineSurface) -> Nurbs:
    return clamped_surface(_nurbs(surface))


def _periodic(surface: BSplineSurface) -> str:
    """The directions that are written `without_copies`."""
    return "".join(direction for direction, left_out in zip("uv", copies(surface), strict=True) if left_out)
