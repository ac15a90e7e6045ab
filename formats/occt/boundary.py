"""The loops of a face of the CAD kernel as trim curves on its B-spline surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from OCP.BRep import BRep_Tool
from OCP.BRepTools import BRepTools
from OCP.Geom2d import Geom2d_Curve
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Face, TopoDS_Iterator

from ...spline.matrices import breakpoints
from ...spline.surface import BSplineSurface, TrimCurve, TrimLoop
from .tolerance import FORWARD, REVERSED
from .trim import evaluate_trim, signed_area, trim_domain

Array = NDArray[np.float64]

ON_BORDER = 1e-6
"""A trim curve nearer than this to the border of the domain, as a fraction of its range, runs along it."""


@dataclass(frozen=True, slots=True, eq=False)
class BoundaryEdge:
    """An edge in a loop of a face; `curve` runs along the loop, on the face's B-spline surface."""

    edge: TopoDS_Edge
    curve: TrimCurve
    seam: bool
    degenerate: bool


@dataclass(frozen=True, slots=True, eq=False)
class Boundary:
    """The loops of a face, and how many edges had no trim curve."""

    loops: tuple[tuple[BoundaryEdge, ...], ...]
    outer: int
    lost: int

    def trims(self) -> tuple[TrimLoop, ...]:
        """The outer loop first."""
        order = sorted(range(len(self.loops)), key=lambda i: i != self.outer)
        return tuple(TrimLoop(tuple(e.curve for e in self.loops[i]), i == self.outer) for i in order)


def pcurve(edge: TopoDS_Edge, face: TopoDS_Face) -> tuple[Geom2d_Curve | None, float, float]:
    """The kernel's 2D curve of an edge on a face, with its range; on a seam the side that the edge's orientation says."""
    curve = BRep_Tool.CurveOnSurface_s(edge, face, 0.0, 0.0)
    first, last = BRep_Tool.Range_s(edge, face)
    return curve, first, last


def boundary_of_face(face: TopoDS_Face, carry: Callable[[Geom2d_Curve, float, float, bool], TrimCurve]) -> Boundary:
    """All loops of a face, as they run on the face taken forward: anticlockwise around the material in (u, v).

    carry(curve, first, last, backward) gives the trim curve of a 2D curve.
    """
    forward = TopoDS.Face(face.Oriented(FORWARD))
    outer_wire = BRepTools.OuterWire_s(forward)
    loops: list[tuple[BoundaryEdge, ...]] = []
    outer = lost = 0
    wires = TopoDS_Iterator(forward)
    while wires.More():
        wire = wires.Value()
        wires.Next()
        if wire.ShapeType() != TopAbs_ShapeEnum.TopAbs_WIRE:
            continue
        found: list[BoundaryEdge] = []
        edges = TopoDS_Iterator(wire)
        while edges.More():
            edge = TopoDS.Edge(edges.Value())
            edges.Next()
            if edge.Orientation() not in (FORWARD, REVERSED):
                continue
            curve, first, last = pcurve(edge, forward)
            if curve is None:
                lost += 1
                continue
            trim = carry(curve, first, last, edge.Orientation() == REVERSED)
            found.append(
                BoundaryEdge(edge, trim, bool(BRep_Tool.IsClosed_s(edge, forward)), BRep_Tool.Degenerated_s(edge))
            )
        if found:
            if wire.IsSame(outer_wire):
                outer = len(loops)
            loops.append(tuple(_chained(found)))
    return Boundary(tuple(loops), outer, lost)


def _chained(edges: list[BoundaryEdge]) -> list[BoundaryEdge]:
    """The edges of one loop in the order in which their trim curves follow one another."""
    ends = [evaluate_trim(e.curve, np.array(trim_domain(e.curve))) for e in edges]
    order, left = [0], set(range(1, len(edges)))
    while left:
        here = ends[order[-1]][1]
        following = (order[-1] + 1) % len(edges)
        best = min(left, key=lambda i: (float(np.hypot(*(ends[i][0] - here))), i != following))
        order.append(best)
        left.remove(best)
    return [edges[i] for i in order]


def is_whole_domain(surface: BSplineSurface, loops: Sequence[TrimLoop]) -> bool:
    """True when the only loop runs around the border of the surface's domain."""
    if not loops:
        return True
    if len(loops) > 1:
        return False
    low = np.array([bound[0] for bound in surface.domain])
    span = np.array([bound[1] for bound in surface.domain]) - low
    for curve in loops[0].curves:
        t = np.union1d(np.linspace(*trim_domain(curve), 9), breakpoints(curve.knots, curve.degree))
        place = (evaluate_trim(curve, t) - low) / span
        away = np.minimum(np.abs(place), np.abs(1.0 - place)).max(axis=0)
        if away.min() > ON_BORDER:
            return False
    return bool(abs(abs(signed_area(loops[0])) / (span[0] * span[1]) - 1.0) <= 1e-5)


def sample_edge(surface: BSplineSurface, curve: TrimCurve, fewest: int = 64, most: int = 1024) -> tuple[Array, Array]:
    """(uv (n, 2), points (n, 3)) along a trim curve, dense enough that the points turn by less than 5 degrees a step."""
    count = fewest
    while True:
        t = np.union1d(np.linspace(*trim_domain(curve), count), breakpoints(curve.knots, curve.degree))
        uv = evaluate_trim(curve, t)
        points = surface.evaluate(uv[:, 0], uv[:, 1])
        steps = np.diff(points, axis=0)
        length = np.linalg.norm(steps, axis=1)
        product = length[:-1] * length[1:]
        sine = np.linalg.norm(np.cross(steps[:-1], steps[1:]), axis=1)
        seen = product > (1e-9 * max(float(length.sum()), 1e-300)) ** 2
        if count >= most or not (sine[seen] > np.sin(np.radians(5.0)) * product[seen]).any():
            return uv, points
        count *= 2


def placement(face: TopoDS_Face) -> tuple[object, TopLoc_Location]:
    """The surface of a face in its own frame, and where it is placed."""
    location = TopLoc_Location()
    return BRep_Tool.Surface_s(face, location), location
