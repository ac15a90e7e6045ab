"""What OCCT asks of edges and vertices: every representation of an edge within its tolerance, every vertex within its own.

Tolerances are only ever raised, and only to what the measured distances need.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from OCP.BRep import BRep_Builder, BRep_CurveOnClosedSurface, BRep_CurveOnSurface, BRep_Tool
from OCP.BRepLib import BRepLib
from OCP.collections import IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher
from OCP.Geom import Geom_Curve, Geom_Surface
from OCP.Geom2d import Geom2d_Curve
from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
from OCP.TopExp import TopExp
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Iterator, TopoDS_Shape, TopoDS_Vertex

from .curve import sample_curve, sample_surface, sample_trim

Array = NDArray[np.float64]

CONFUSION = 1e-7
"""OCCT's Precision::Confusion, mm: points nearer than this are one point."""

FORWARD = TopAbs_Orientation.TopAbs_FORWARD
REVERSED = TopAbs_Orientation.TopAbs_REVERSED

_MARGIN = 1.02
"""A raised tolerance exceeds the measured distance by this: the checker samples at other places than we do."""

_SAMPLES = 67
"""Places along an edge where its representations are compared (OCCT's checker takes 23)."""


@dataclass(frozen=True, slots=True, eq=False)
class CurveOnFace:
    """One trim curve of an edge: the 2D curve over [first, last] on a surface placed at `location` (in the edge's frame)."""

    curve: Geom2d_Curve
    surface: Geom_Surface
    location: TopLoc_Location
    first: float
    last: float

    def points(self, parameters: Array) -> Array:
        """(n, 3) points in the edge's frame."""
        return placed(sample_surface(self.surface, sample_trim(self.curve, parameters)), self.location)


def placed(points: Array, location: TopLoc_Location) -> Array:
    """Points (n, 3) moved by a location."""
    if location.IsIdentity():
        return points
    t = location.Transformation()
    matrix = np.array([[t.Value(i, j) for j in (1, 2, 3, 4)] for i in (1, 2, 3)])
    return np.asarray(points @ matrix[:, :3].T + matrix[:, 3], dtype=np.float64)


def curves_on_faces(edge: TopoDS_Edge) -> Iterator[CurveOnFace]:
    """All trim curves of an edge, both of a seam."""
    for item in edge.TShape().Curves():
        if isinstance(item, BRep_CurveOnSurface):
            first, last, location = item.First(), item.Last(), item.Location()
            yield CurveOnFace(item.PCurve(), item.Surface(), location, first, last)
            if isinstance(item, BRep_CurveOnClosedSurface):
                yield CurveOnFace(item.PCurve2(), item.Surface(), location, first, last)


def curve_of_edge(edge: TopoDS_Edge) -> tuple[Geom_Curve | None, TopLoc_Location]:
    """The 3D curve of an edge, None for a degenerate one, and its location in the edge's frame."""
    location = TopLoc_Location()
    curve = BRep_Tool.Curve_s(TopoDS.Edge(edge.Located(TopLoc_Location())), location, 0.0, 0.0)
    return curve, location


def vertices_of_edge(edge: TopoDS_Edge) -> list[tuple[TopoDS_Vertex, float]]:
    """The vertices of an edge, in its own frame, with their parameters."""
    bare = TopoDS.Edge(edge.Located(TopLoc_Location()).Oriented(FORWARD))
    first, last = BRep_Tool.Range_s(bare)
    found = []
    iterator = TopoDS_Iterator(bare)
    while iterator.More():
        vertex = TopoDS.Vertex(iterator.Value())
        side = vertex.Orientation()
        if side == FORWARD:
            found.append((vertex, first))
        elif side == REVERSED:
            found.append((vertex, last))
        else:
            found.append((vertex, BRep_Tool.Parameter_s(vertex, bare)))
        iterator.Next()
    return found


def edge_gap(edge: TopoDS_Edge) -> float:
    """Largest distance found between the 3D curve of an edge and its trim curves, at equal shares of their ranges."""
    curve, location = curve_of_edge(edge)
    if curve is None:
        return 0.0
    share = np.linspace(0.0, 1.0, _SAMPLES)
    first, last = BRep_Tool.Range_s(edge)
    truth = placed(sample_curve(curve, first + share * (last - first)), location)
    gaps = [
        np.linalg.norm(item.points(item.first + share * (item.last - item.first)) - truth, axis=1).max()
        for item in curves_on_faces(edge)
    ]
    return float(max(gaps, default=0.0))


def vertex_gaps(edge: TopoDS_Edge) -> list[tuple[float, float]]:
    """Per vertex of an edge: its largest distance from the edge's curves at its parameter, and its tolerance."""
    curve, location = curve_of_edge(edge)
    first, last = BRep_Tool.Range_s(edge)
    found = []
    for vertex, parameter in vertices_of_edge(edge):
        p = BRep_Tool.Pnt_s(vertex)
        point = np.array([p.X(), p.Y(), p.Z()])
        share = 0.0 if last == first else (parameter - first) / (last - first)
        places = [
            item.points(np.array([item.first + share * (item.last - item.first)])) for item in curves_on_faces(edge)
        ]
        if curve is not None:
            places.append(placed(sample_curve(curve, np.array([parameter])), location))
        gap = max((float(np.linalg.norm(place[0] - point)) for place in places), default=0.0)
        found.append((gap, float(BRep_Tool.Tolerance_s(vertex))))
    return found


def settle_edge(edge: TopoDS_Edge) -> None:
    """Raise the tolerance of an edge and of its vertices to what its 3D curve and trim curves need."""
    builder = BRep_Builder()
    gap = edge_gap(edge)
    if gap > BRep_Tool.Tolerance_s(edge):
        builder.UpdateEdge(edge, _MARGIN * gap)
    least = BRep_Tool.Tolerance_s(edge)
    for (vertex, _), (gap, tolerance) in zip(vertices_of_edge(edge), vertex_gaps(edge), strict=True):
        needed = max(_MARGIN * gap if gap > tolerance else 0.0, least)
        if needed > tolerance:
            builder.UpdateVertex(vertex, needed)


def edges_of(shape: TopoDS_Shape) -> list[TopoDS_Edge]:
    """The distinct edges of a shape, in order of appearance (two placements of one edge are two)."""
    found = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
    TopExp.MapShapes_s(shape, TopAbs_ShapeEnum.TopAbs_EDGE, found)
    return [TopoDS.Edge(found.FindKey(i)) for i in range(1, found.Extent() + 1)]


def settle_tolerances(shape: TopoDS_Shape) -> None:
    """`settle_edge` for every edge of a shape."""
    for edge in edges_of(shape):
        settle_edge(edge)


def unify_parameters(shape: TopoDS_Shape) -> None:
    """Reparametrise the trim curves of edges that were marked as running at another pace than their 3D curve."""
    BRepLib.SameParameter_s(shape, CONFUSION, False)
    settle_tolerances(shape)
