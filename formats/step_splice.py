"""Sculpted faces put into the text of the STEP file that they came from: all else keeps its bytes.

A B-spline face's surface record gets the new net in its place, so that trim curves on it stay true; a face of another kind,
or one that shares its surface, gets a record of its own. Edges that moved get new curves, their vertices new points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.Geom import Geom_BSplineCurve, Geom_BSplineSurface
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Vertex

from .occt.tolerance import FORWARD, curve_of_edge
from .step_entities import StepEntities
from .step_geometry import PointPool, closed_flags, curve_body, own_points, surface_body
from .step_records import StepRecords
from .step_units import coordinates, millimetres_at

if TYPE_CHECKING:
    from .occt.face import OcctFace

_FACES = ("ADVANCED_FACE", "FACE_SURFACE")
_SURFACE_CURVES = ("SURFACE_CURVE", "SEAM_CURVE", "INTERSECTION_CURVE")


class CannotSpliceError(Exception):
    """Why the file's text cannot take the sculpted part; the kernel writes it anew then."""


def splice(
    entities: StepEntities,
    faces: Sequence[OcctFace],
    edges: Sequence[TopoDS_Edge],
    vertices: Sequence[TopoDS_Vertex],
    scale: float | None = None,
) -> StepRecords:
    """The file's records with the surfaces of sculpted `faces`, the curves of moved `edges` and the points of moved
    `vertices`.

    scale : mm per unit of the file's numbers; what the file says when None. Raises CannotSpliceError.
    """
    records = StepRecords.of(entities.records.data)
    kept: set[int] = set()
    done: set[int] = set()
    for face in faces:
        number = entities.of_shape(face.shape)
        if number == 0:
            raise CannotSpliceError(f"face {face.number} is none of the file's records, but a piece of one")
        if number not in done:  # one face may be placed several times
            done.add(number)
            _put_surface(records, number, face, _scale(records, number, scale), kept)
    for edge in edges:
        number = entities.of_shape(edge)
        if number == 0:  # the border of a loose surface is curves alone: how they read back is for the caller to see
            continue
        if records.type(number) != "EDGE_CURVE":
            raise CannotSpliceError("an edge that moved is no EDGE_CURVE of the file")
        _put_curve(records, number, edge, _scale(records, number, scale), kept)
    for vertex in vertices:
        number = entities.of_shape(vertex)
        if number == 0:
            continue
        if records.type(number) != "VERTEX_POINT":
            raise CannotSpliceError("a vertex that moved is no VERTEX_POINT of the file")
        p = BRep_Tool.Pnt_s(TopoDS.Vertex(vertex.Located(TopLoc_Location())))
        pool = PointPool(records, _scale(records, number, scale))
        point = pool.number(np.array([p.X(), p.Y(), p.Z()]))
        records.change(number, b"VERTEX_POINT(%s,#%d)" % (records.arguments(number)[0], point))
    return records


def _scale(records: StepRecords, number: int, given: float | None) -> float:
    found = given if given is not None else millimetres_at(records, number)
    if found is None:
        raise CannotSpliceError(f"the length unit of #{number} is not known")
    return found


# ---------------------------------------------------------------------- surfaces


def _put_surface(records: StepRecords, number: int, face: OcctFace, scale: float, kept: set[int]) -> None:
    geom = face.geom
    if not isinstance(geom, Geom_BSplineSurface):
        raise CannotSpliceError(f"face {face.number} is no B-spline surface")
    kind = records.type(number)
    if kind in _FACES:
        arguments, place = records.arguments(number), 2
    elif kind == "CURVE_BOUNDED_SURFACE":
        arguments, place = records.arguments(number), 1
    elif closed_flags(records, number):
        arguments, place = [], 0  # a surface that stands by itself
    else:
        raise CannotSpliceError(f"#{number} is a {kind}")
    own = int(arguments[place].lstrip(b"#")) if arguments else number
    flags = closed_flags(records, own)
    closed = (_flag(geom.IsUClosed()), _flag(geom.IsVClosed()))
    pool = PointPool(records, scale, own_points(records, own) if flags else ())
    body = surface_body(geom, pool, _name(records, own), flags or closed)
    if flags and _only_here(records, own, number):
        records.change(own, body)
        kept.add(own)
        return
    if not arguments:
        raise CannotSpliceError(f"the surface #{own} is used by others")
    arguments[place] = b"#%d" % records.add(body)
    records.change(number, b"%s(%s)" % (kind.encode(), b",".join(arguments)))


def _only_here(records: StepRecords, surface: int, face: int) -> bool:
    """No other face has this surface; trim curves on it and styles do not count."""
    others = [user for user in records.users(surface) if user != face]
    return not any(records.type(user) in (*_FACES, "CURVE_BOUNDED_SURFACE", "RECTANGULAR_TRIMMED_SURFACE",
                                          "OFFSET_SURFACE", "ORIENTED_SURFACE") for user in others)  # fmt: skip


def _name(records: StepRecords, number: int) -> bytes:
    """The name that a record carries, quoted."""
    for type in (None, "REPRESENTATION_ITEM"):
        arguments = records.arguments(number, type)
        if arguments and arguments[0].startswith(b"'"):
            return arguments[0]
    return b"''"


def _flag(value: bool) -> bytes:
    return b".T." if value else b".F."


# ------------------------------------------------------------------------- edges


def _put_curve(records: StepRecords, number: int, edge: TopoDS_Edge, scale: float, kept: set[int]) -> None:
    """A new curve for an EDGE_CURVE; its trim curves stay where the surface that they lie on kept its parameters."""
    curve, location = curve_of_edge(edge)
    if not isinstance(curve, Geom_BSplineCurve) or not location.IsIdentity():
        raise CannotSpliceError("the curve of a moved edge is no B-spline in the frame of its part")
    arguments = records.arguments(number)
    new = records.add(curve_body(curve, PointPool(records, scale)))
    sense = _runs_forward(records, arguments, edge, scale)
    old = int(arguments[3].lstrip(b"#"))
    if records.type(old) in _SURFACE_CURVES and not records.body(old).lstrip().startswith(b"("):
        inner = records.arguments(old)
        basis = [records.references(pcurve)[0] for pcurve in _listed(inner[2]) if records.type(pcurve) == "PCURVE"]
        if sense == arguments[4] == b".T." and basis and all(surface in kept for surface in basis):
            inner[1] = b"#%d" % new
            records.change(old, b"%s(%s)" % (records.type(old).encode(), b",".join(inner)))
            return
    arguments[3], arguments[4] = b"#%d" % new, sense
    records.change(number, b"EDGE_CURVE(%s)" % b",".join(arguments))


def _runs_forward(records: StepRecords, arguments: list[bytes], edge: TopoDS_Edge, scale: float) -> bytes:
    """Whether the kernel's curve runs from the record's first vertex to its second."""
    ends = [np.array(_vertex(records, int(argument.lstrip(b"#")))) * scale for argument in arguments[1:3]]
    if arguments[1] == arguments[2] or np.abs(ends[0] - ends[1]).max() == 0.0:
        return _flag(edge.Orientation() == FORWARD)
    curve, _ = curve_of_edge(edge)
    first, last = BRep_Tool.Range_s(edge)
    p, q = curve.Value(first), curve.Value(last)  # type: ignore[union-attr]
    start, end = np.array([p.X(), p.Y(), p.Z()]), np.array([q.X(), q.Y(), q.Z()])
    straight = np.linalg.norm(start - ends[0]) + np.linalg.norm(end - ends[1])
    crossed = np.linalg.norm(start - ends[1]) + np.linalg.norm(end - ends[0])
    return _flag(bool(straight <= crossed))


def _vertex(records: StepRecords, number: int) -> list[float]:
    point = next((n for n in records.references(number) if records.type(n) == "CARTESIAN_POINT"), 0)
    if not point:
        raise CannotSpliceError(f"the vertex #{number} has no point")
    return coordinates(records, point)


def _listed(argument: bytes) -> list[int]:
    return [int(item.strip().lstrip(b"#")) for item in argument.strip(b"() \r\n\t").split(b",") if b"#" in item]
