"""What follows when faces of a Brep are sculpted: the 3D curves of the edges that moved, and their vertices.

An edge follows when all its faces were sculpted: the surface carries its trim curve along. An edge shared with a face
that stays is left where it is; how far the sculpted face leaves it is said.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...spline.matrices import span_parameters
from ...spline.surface import TrimCurve
from ..loose_edges import distance_to_chain
from ..occt.trim import evaluate_trim, trim_domain
from .body import Body
from .brep import SINGULAR
from .geometry import curve_points
from .nurbs import Nurbs

Array = NDArray[np.float64]

STILL = 1e-10
"""An edge whose points move less than this fraction of the surface's size has not moved."""

FIT = 1e-6
"""mm: how far the 3D curve of an edge that followed may run from the surface (parameter lines are exact)."""


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """edges : new 3D curves (mm, over the edge's domain) of those that moved; points : new vertices (3,), mm.

    gaps, vertex_gaps : the distance that an edge's or vertex's tolerance must now cover, mm, where there is one.
    torn : edges that a sculpted face left although another face holds them there, with the distance.
    """

    edges: dict[int, Nurbs]
    points: dict[int, Array]
    gaps: dict[int, float]
    vertex_gaps: dict[int, float]
    torn: dict[int, float]


def follow(body: Body) -> Followed:
    """The edges and vertices that moved with the sculpted faces of a body."""
    brep = body.brep
    shifted: dict[int, float] = {}
    for face in sorted(body.sculpted):
        old, new = body.read_surface(face), body.sculpted[face]
        for trim in body.trims_of_face(face):
            if trim.kind == SINGULAR or trim.edge < 0:
                continue
            uv = _samples(body.trim(trim.index))
            move = float(np.linalg.norm(new.evaluate(*uv.T) - old.evaluate(*uv.T), axis=1).max())
            if move > STILL * old.size:
                shifted[trim.edge] = max(move, shifted.get(trim.edge, 0.0))
    edges: dict[int, Nurbs] = {}
    gaps: dict[int, float] = {}
    torn: dict[int, float] = {}
    for index, move in sorted(shifted.items()):
        trims = brep.edges[index].trims
        if not all(body.face_of_trim(brep.trims[t]) in body.sculpted for t in trims):
            torn[index] = gaps[index] = move
            continue
        edges[index], gap = _edge_on(body, index, trims[0])
        chain = curve_points(edges[index], _dense(edges[index]))
        for other in trims[1:]:
            surface = body.surface(body.face_of_trim(brep.trims[other]))
            gap = max(gap, distance_to_chain(surface.evaluate(*_samples(body.trim(other)).T), chain))
        gaps[index] = gap
    points, vertex_gaps = _vertices(body, edges)
    return Followed(edges, points, gaps, vertex_gaps, torn)


def _samples(trim: TrimCurve) -> Array:
    """(n, 2) places along a trim curve, ends included."""
    return evaluate_trim(trim, span_parameters(trim.knots, trim.degree, 32 if len(trim.control_points) == 2 else 8)[0])


def _dense(curve: Nurbs) -> Array:
    parameters, _ = span_parameters(curve.padded_knots(0), curve.degrees[0], 64)
    return parameters


def _edge_on(body: Body, edge: int, trim: int) -> tuple[Nurbs, float]:
    """The 3D curve of an edge over one of its trims, in the edge's direction and domain, and its gap."""
    from ..occt.curve import curve_net, curve_on_surface
    from ..occt.shape import geom_of_surface
    from ..occt.trim import geom_of_trim

    surface = body.surface(body.face_of_trim(body.brep.trims[trim]))
    curve = body.trim_toward_edge(trim)
    first, last = trim_domain(curve)
    made, gap = curve_on_surface(geom_of_surface(surface), geom_of_trim(curve), first, last, FIT)
    made.Segment(first, last)
    points, knots = curve_net(made)
    weights = None
    if made.IsRational():
        weights = np.array([made.Weight(i) for i in range(1, made.NbPoles() + 1)])
        points = np.concatenate([points * weights[:, None], weights[:, None]], axis=1)
    low, high = body.brep.edges[edge].domain or body.brep.edges[edge].proxy
    return Nurbs(3, weights is not None, (made.Degree(),), (stretched(knots, low, high)[1:-1],), points), gap


def stretched(knots: Array, low: float, high: float) -> Array:
    """A clamped knot vector run over [low, high], its ends exact."""
    first, last = knots[0], knots[-1]
    out: Array = low + (knots - first) * ((high - low) / (last - first))
    out[knots == first], out[knots == last] = low, high
    return out


def _vertices(body: Body, edges: dict[int, Nurbs]) -> tuple[dict[int, Array], dict[int, float]]:
    """New places of the vertices whose edges all followed; one that another edge holds stays and gets a gap."""
    ends: dict[int, list[Array]] = {}
    for index, curve in edges.items():
        knots = curve.knots[0]
        spots = curve_points(curve, np.array([knots[0], knots[-1]]))
        for vertex, spot in zip(body.brep.edges[index].vertices, spots, strict=True):
            ends.setdefault(vertex, []).append(spot)
    points: dict[int, Array] = {}
    gaps: dict[int, float] = {}
    for vertex, spots_here in ends.items():
        here = np.array(spots_here)
        place = body.vertex_point(vertex)
        if all(edge in edges for edge in body.brep.vertices[vertex].edges):
            place = points[vertex] = here.mean(axis=0)
        gaps[vertex] = float(np.linalg.norm(here - place, axis=1).max())
    return points, gaps
