"""Edges and vertices follow the surfaces of sculpted faces; tolerances rise only where they must."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.collections import (
    IndexedDataMap_TopoDS_Shape_List_TopoDS_Shape_TopTools_ShapeMapHasher,
    IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher,
)
from OCP.gp import gp_Pnt
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Shape, TopoDS_Vertex

from .boundary import placement
from .curve import curve_on_surface
from .face import OcctFace
from .shape import basis_of_geom
from .tolerance import (
    CONFUSION,
    FORWARD,
    curve_of_edge,
    curves_on_faces,
    edge_gap,
    edges_of,
    settle_edge,
    vertices_of_edge,
)

if TYPE_CHECKING:
    from .part import OcctPart

Array = NDArray[np.float64]

CURVE_TOLERANCE = 2e-8
"""Distance, mm, within which a rebuilt edge runs on its surface."""


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """The edges that got another curve and the vertices that got another point."""

    edges: tuple[TopoDS_Edge, ...] = ()
    vertices: tuple[TopoDS_Vertex, ...] = ()

    def __add__(self, other: Moved) -> Moved:
        return Moved(self.edges + other.edges, self.vertices + other.vertices)


class Gaps:
    """How far the curves of edges lie apart, by edge, wherever it is placed."""

    def __init__(self, faces: Sequence[OcctFace]) -> None:
        self._edges = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
        self._gaps: list[float] = []
        for face in faces:
            for edge in edges_of(face.shape):
                bare = edge.Located(TopLoc_Location())
                if not self._edges.Contains(bare):
                    self._edges.Add(bare)
                    self._gaps.append(edge_gap(edge))

    def of(self, edge: TopoDS_Edge) -> float:
        """The gap of an edge, 0 when it is not known."""
        place = self._edges.FindIndex(edge.Located(TopLoc_Location()))
        return self._gaps[place - 1] if place else 0.0


def follow(part: OcctPart, faces: Sequence[OcctFace], before: Gaps) -> Moved:
    """Rebuild the edges that the surfaces of these faces have left, move their vertices, raise tolerances where needed.

    before : the gaps as they were; an edge whose curves are no farther apart than that did not move. An edge that a face
    outside `faces` holds as well stays on that face; its tolerance covers the gap and the part's warnings say so.
    """
    surfaces = [placement(face.shape)[0] for face in faces]
    numbers = {face.number for face in faces}
    seen = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
    moved = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
    edges: list[TopoDS_Edge] = []
    for face in faces:
        for edge in edges_of(face.shape):
            bare = edge.Located(TopLoc_Location())
            if seen.Contains(bare):
                continue
            seen.Add(bare)
            edges.append(edge)
            gap = edge_gap(edge)
            if gap <= max(CONFUSION, BRep_Tool.Tolerance_s(edge), before.of(edge) + CONFUSION):
                continue
            held = [n for n in part.faces_on(edge) if n not in numbers and not _twin(part, n, faces)]
            if held:
                part.warnings.append(
                    f"face {face.number} leaves face {held[0]} by {gap:.3g} mm along a shared edge, which stays on face"
                    f" {held[0]}"
                )
            elif _rebuild(edge, surfaces):
                moved.Add(edge)
    touched, vertices = _move_vertices(part.shape, moved)
    for edge in [*edges, *touched]:
        settle_edge(edge)
    return Moved(tuple(TopoDS.Edge(moved.FindKey(i)) for i in range(1, moved.Extent() + 1)), tuple(vertices))


def _twin(part: OcctPart, number: int, faces: Sequence[OcctFace]) -> bool:
    """The face of this number is one of `faces` in another place."""
    shape = part.face(number).shape
    return any(face.shape.IsPartner(shape) for face in faces)


def _rebuild(edge: TopoDS_Edge, surfaces: Sequence[object]) -> bool:
    """Give an edge a 3D curve along its trim curve on the first of the sculpted surfaces that it bounds."""
    if BRep_Tool.Degenerated_s(edge):
        return False
    item = next((c for c in curves_on_faces(edge) if any(c.surface is s for s in surfaces)), None)
    if item is None:
        return False
    builder = BRep_Builder()
    bare = TopoDS.Edge(edge.Located(TopLoc_Location()).Oriented(FORWARD))
    curve, _ = curve_on_surface(basis_of_geom(item.surface), item.curve, item.first, item.last, CURVE_TOLERANCE)
    if not item.location.IsIdentity():
        curve = curve.Transformed(item.location.Transformation())
    builder.UpdateEdge(bare, curve, TopLoc_Location(), 0.0)
    builder.Range(bare, item.first, item.last, True)
    return True


def _move_vertices(
    shape: TopoDS_Shape, moved: IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher
) -> tuple[list[TopoDS_Edge], list[TopoDS_Vertex]]:
    """Put vertices where the moved edges end, unless an edge that stays ends there.

    Returns the other edges concerned, and the vertices that were moved.
    """
    if moved.Extent() == 0:
        return [], []
    around = IndexedDataMap_TopoDS_Shape_List_TopoDS_Shape_TopTools_ShapeMapHasher()
    TopExp.MapShapesAndAncestors_s(shape, TopAbs_ShapeEnum.TopAbs_VERTEX, TopAbs_ShapeEnum.TopAbs_EDGE, around)
    builder = BRep_Builder()
    vertices = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
    for i in range(1, moved.Extent() + 1):
        TopExp.MapShapes_s(moved.FindKey(i), TopAbs_ShapeEnum.TopAbs_VERTEX, vertices)
    others: list[TopoDS_Edge] = []
    changed: list[TopoDS_Vertex] = []
    for i in range(1, vertices.Extent() + 1):
        vertex = TopoDS.Vertex(vertices.FindKey(i))
        beside = [TopoDS.Edge(e) for e in around.FindFromKey(vertex)] if around.Contains(vertex) else []
        others += beside
        staying = [e for e in beside if not moved.Contains(e) and not BRep_Tool.Degenerated_s(e)]
        ends = [_end(e, vertex) for e in (staying or [e for e in beside if moved.Contains(e)])]
        places = [end for end in ends if end is not None]
        if not places or staying:
            continue
        point = np.mean(places, axis=0)
        builder.UpdateVertex(vertex, gp_Pnt(*point.tolist()), 0.0)
        changed.append(vertex)
    return others, changed


def _end(edge: TopoDS_Edge, vertex: TopoDS_Shape) -> Array | None:
    """Where the 3D curve of an edge is at one of its vertices, in the part's frame."""
    curve, location = curve_of_edge(edge)
    if curve is None:
        return None
    here = edge.Location()
    for own, parameter in vertices_of_edge(edge):
        if own.Moved(here).IsSame(vertex):
            p = curve.Value(parameter).Transformed(location.Transformation()).Transformed(here.Transformation())
            return np.array([p.X(), p.Y(), p.Z()])
    return None
