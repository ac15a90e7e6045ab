"""Sculpted faces back into the 3DM file they were read from: their objects change, every other byte of the file stays.

Breps since Rhino 3 and surfaces are changed in place, in the file's own archive version. Objects that have no such form
(the Breps of Rhino 2, extrusions) are written anew as Breps of that archive version by openNURBS. A version 1 file,
which nothing can write any more, becomes a version 3 file first.
"""

from __future__ import annotations

import base64
import hashlib
import struct
import uuid
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from .archive import (
    BREP_OBJECT_TYPE,
    SURFACE_OBJECT_TYPE,
    ObjectRecord,
    archive_version,
    chunks,
    object_records,
    replace_objects,
)
from .body import Body
from .brep import Brep, brep_chunk, read_brep
from .follow import Followed, follow
from .geometry import decoded, inverse, library, moved, nurbs_of_surface, nurbs_of_trim
from .nurbs import Nurbs, nurbs_chunk

Array = NDArray[np.float64]

WRITTEN_VERSIONS = {2: 2, 3: 3, 4: 4, 50: 5, 60: 6, 70: 7, 80: 8}
"""Archive versions that openNURBS writes, and what it calls them."""

MESH_CACHE = uuid.UUID("A8130A3E-E4F3-4CB0-BB8A-F10A473912D0")
"""User data of Rhino 5's extrusions: a display mesh, of no use to the Brep that takes the extrusion's place."""


def sculpted_file(data: bytes, bodies: Sequence[Body]) -> bytes:
    """The file `data` with the sculpted faces of `bodies`. Raises InputError when an object cannot be written."""
    changed = [body for body in bodies if body.sculpted]
    if not changed:
        return data
    if archive_version(data) == 1:
        data = _as_version_3(data)
    version = archive_version(data)
    records = object_records(data)
    new: dict[int, tuple[int | None, bytes]] = {}
    for body in changed:
        record = records[body.place.record]
        new[body.place.record] = _object(data, record, body, version)
    return replace_objects(data, new)


def sculpted_brep(body: Body) -> Any:
    """rhino3dm's Brep of a body as it is now, in the object's own coordinates; None when openNURBS refuses it."""
    if not body.sculpted:
        return body.thing
    return decoded(brep_chunk(changed_brep(body.brep, body, follow(body))))


def _object(data: bytes, record: ObjectRecord, body: Body, version: int) -> tuple[int | None, bytes]:
    """The new object type (None: as before) and TCODE_OPENNURBS_CLASS chunk of a record."""
    after = data[record.record.data.end : record.record.chunk.end]
    if body.place.kind == "surface":
        return SURFACE_OBJECT_TYPE, nurbs_chunk(_net(body, 0), version, after)
    followed = follow(body)
    if body.place.kind == "brep":
        try:
            own = read_brep(data, record.record.chunk.start, record.record.chunk.end, version)
        except InputError:
            pass
        else:
            return None, brep_chunk(changed_brep(own, body, followed), after, record.record.class_id)
    kept = b"".join(
        data[c.start : c.end]
        for c in chunks(data, record.record.data.end, record.record.chunk.end, version)
        if MESH_CACHE.bytes_le not in data[c.start : c.end]
    )
    return BREP_OBJECT_TYPE, _translated(brep_chunk(changed_brep(body.brep, body, followed)), version, body, kept)


# -------------------------------------------------------------------- the Brep


def changed_brep(brep: Brep, body: Body, followed: Followed) -> Brep:
    """A Brep with the sculpted surfaces of `body`, the edges and vertices that followed, and without their stale
    meshes.

    `brep` is the body's own, or the same Brep in another archive version: places in its arrays are the same.
    """
    version, scale = brep.version, body.place.scale
    surfaces, faces = list(brep.surfaces), list(brep.faces)
    for face in sorted(body.sculpted):
        chunk = nurbs_chunk(_net(body, face), version)
        place = _place(surfaces, [f.surface for f in faces], faces[face].surface, chunk)
        faces[face] = replace(faces[face], surface=place)

    curves2, trims = list(brep.curves2), list(brep.trims)
    for face in sorted(body.sculpted):
        if body.form(face).parameters is None:
            continue
        for own in body.trims_of_face(face):
            trim = trims[own.index]
            curve = nurbs_of_trim(body.trim(own.index))
            place = _place(curves2, [t.curve2 for t in trims], trim.curve2, nurbs_chunk(curve, version))
            rest = trim.rest[:16] + bytes(32) + trim.rest[48:]
            domain = float(curve.knots[0][0]), float(curve.knots[0][-1])
            trims[own.index] = replace(trim, curve2=place, proxy=domain, rest=rest)

    curves3, edges = list(brep.curves3), list(brep.edges)
    for index, curve in sorted(followed.edges.items()):
        chunk = nurbs_chunk(_in_file(curve, body), version)
        place = _place(curves3, [e.curve3 for e in edges], edges[index].curve3, chunk)
        domain = float(curve.knots[0][0]), float(curve.knots[0][-1])
        edges[index] = replace(edges[index], curve3=place, backward=0, proxy=domain)
    for index, gap in sorted(followed.gaps.items()):
        edges[index] = replace(edges[index], tolerance=max(edges[index].tolerance, gap / scale))

    vertices = list(brep.vertices)
    for index, gap in sorted(followed.vertex_gaps.items()):
        tolerance = max(vertices[index].tolerance, gap / scale)
        point = vertices[index].point
        if index in followed.points:
            x, y, z = _local(followed.points[index], body).tolist()
            point = (x, y, z)
        vertices[index] = replace(vertices[index], point=point, tolerance=tolerance)

    stale = set(body.sculpted)
    return replace(
        brep,
        curves2=tuple(curves2),
        curves3=tuple(curves3),
        surfaces=tuple(surfaces),
        vertices=tuple(vertices),
        edges=tuple(edges),
        trims=tuple(trims),
        faces=tuple(faces),
        box=_box(brep, body),
        render_meshes=tuple(None if i in stale else mesh for i, mesh in enumerate(brep.render_meshes)),
        analysis_meshes=tuple(None if i in stale else mesh for i, mesh in enumerate(brep.analysis_meshes)),
    )


def _place(items: list[bytes | None], users: list[int], place: int, chunk: bytes) -> int:
    """Put `chunk` at `place`, or at the end when others use that place too; returns where it went."""
    if users.count(place) == 1:
        items[place] = chunk
        return place
    items.append(chunk)
    return len(items) - 1


def _net(body: Body, face: int) -> Nurbs:
    """The sculpted surface of a face in the object's own coordinates and unit."""
    return nurbs_of_surface(
        body.sculpted[face], body.place.scale, body.place.placement, body.form(face).nurbs, body.read_surface(face)
    )


def _local(points: Array, body: Body) -> Array:
    """Points in mm to the object's own coordinates and unit."""
    return moved(points / body.place.scale, inverse(body.place.placement))


def _in_file(curve: Nurbs, body: Body) -> Nurbs:
    points = _local(curve.control_points(), body)
    weights = curve.weights()
    if weights is not None:
        points = np.concatenate([points * weights[:, None], weights[:, None]], axis=1)
    return replace(curve, points=points)


def _box(brep: Brep, body: Body) -> tuple[float, ...]:
    """A box around the Brep as it is now: the control nets of the sculpted faces, and the old box for the others."""
    nets: list[Array] = [_local(s.control_points.reshape(-1, 3), body) for s in body.sculpted.values()]
    box = np.array(brep.box).reshape(2, 3)
    if len(body.sculpted) < len(brep.faces) and (box[0] <= box[1]).all():
        nets.append(box)
    points = np.concatenate(nets)
    return (*points.min(axis=0).tolist(), *points.max(axis=0).tolist())


# ------------------------------------------------------------ through openNURBS


def _translated(chunk: bytes, version: int, body: Body, after: bytes) -> bytes:
    """A Brep of a version 60 archive in the layout of another archive version, written by openNURBS."""
    rhino3dm = library()
    thing = decoded(chunk)
    if thing is None or version not in WRITTEN_VERSIONS:
        raise InputError(
            f"openNURBS cannot write this object in a version {version} file",
            where=body.place.name,
            mend="save the file as a newer 3DM version in Rhino first",
        )
    model = rhino3dm.File3dm()
    model.Objects.AddBrep(thing)
    options = rhino3dm.File3dmWriteOptions()
    options.Version = WRITTEN_VERSIONS[version]
    data = base64.b64decode(model.Encode(options))
    record = object_records(data)[0].record
    if not after:
        return data[record.chunk.start : record.chunk.end]
    whole = data[record.chunk.start : record.data.end]
    size = len(whole) - (record.chunk.body - record.chunk.start) + len(after)
    length = struct.pack("<i" if version < 50 else "<q", size)
    return whole[:4] + length + whole[4 + len(length) :] + after


def _as_version_3(data: bytes) -> bytes:
    """A version 1 file as version 3, the oldest that holds its curves and Breps as they are.

    Identities, which version 1 has not, are derived from the file's content, so that two runs give the same bytes. The
    dimension style that openNURBS makes up with a random identity goes too, unless a dimension or text may need it.
    """
    rhino3dm = library()
    model = rhino3dm.File3dm.FromByteArray(data)
    root = uuid.uuid5(uuid.NAMESPACE_OID, hashlib.sha256(data).hexdigest())
    for kind, table in (("layer", model.Layers), ("material", model.Materials), ("line type", model.Linetypes)):
        for i, entry in enumerate(table):
            entry.Id = uuid.uuid5(root, f"{kind} {i}")
    for i, thing in enumerate(model.Objects):
        thing.Attributes.Id = uuid.uuid5(root, f"object {i}")
    if not any(isinstance(thing.Geometry, rhino3dm.AnnotationBase) for thing in model.Objects):
        for identity in [style.Id for style in model.DimStyles]:
            model.DimStyles.Delete(identity)
    options = rhino3dm.File3dmWriteOptions()
    options.Version = 3
    return base64.b64decode(model.Encode(options))
