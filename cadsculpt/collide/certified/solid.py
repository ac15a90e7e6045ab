"""Which bodies are solids, and on which side of one a point lies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ...spline.matrices import span_parameters
from ...spline.region import ON
from ...spline.trim import curve_points
from ..query import DistanceField
from ..surface_contacts import EDGE
from .body import SurfaceBody
from .classify import UPRIGHT, depths
from .field_distance import PointField, signed_distance, surface_field_distance
from .interval import Goal

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SAMPLES = 24
"""Points on each knot span of an edge, to find its partner by."""

NEIGHBOURS = (4, 16, 64)
"""Among so many nearest points of all edges the partner of an edge's point is looked for, most having it among the first."""


def is_solid(side: SurfaceBody | DistanceField) -> bool:
    """Whether a body bounds a volume: fields do, but for open meshes; B-spline patches that close on themselves, or whose
    open edges all lie on one another (to `surface_contacts.EDGE` of the body's size); points do not."""
    if isinstance(side, PointField):
        return False
    if not isinstance(side, SurfaceBody):
        return bool(getattr(side, "closed", True))  # an open mesh has no inside
    edges = [edge for k in range(len(side.tool.grids)) for edge in _open_edges(side, k)]
    if not edges:
        return True
    points = np.concatenate(edges)
    owner = np.repeat(np.arange(len(edges)), [len(edge) for edge in edges])
    last = np.cumsum([len(edge) for edge in edges]) - 1
    # how far a chord of each edge may leave it
    bend = np.repeat([_bend(edge) for edge in edges], [len(edge) for edge in edges])
    ends = np.zeros(len(points), dtype=np.bool_)
    ends[last] = True
    tree, alone = cKDTree(points), np.arange(len(points))
    for count in NEIGHBOURS:
        _, near = tree.query(points[alone], k=min(count, len(points)))
        best = np.full(len(alone), np.inf)
        for column in near.reshape(len(alone), -1).T:
            other = owner[column] != owner[alone]
            for start in (column, np.maximum(column - 1, 0)):
                usable = np.flatnonzero(other & (owner[start] == owner[column]) & ~ends[start])
                a, b = points[start[usable]], points[np.minimum(start[usable] + 1, len(points) - 1)]
                gap = _to_segment(points[alone[usable]], a, b) - bend[column[usable]]
                best[usable] = np.minimum(best[usable], gap)
        alone = alone[best > EDGE * side.size]
        if not len(alone):
            return True
    return False


def _open_edges(body: SurfaceBody, k: int) -> list[Array]:
    """Points (n, 3) along every edge of patch k that is neither a seam nor a pole."""
    work, grid = body.workspace(k), body.tool.grids[k]
    g, surface = work.patch, grid.surface.with_control_points(body.tool.nets[k])
    if surface.trims is not None:
        edges = []
        for loop in surface.trims:
            for curve in loop.curves:
                t, _ = span_parameters(curve.knots, curve.degree, SAMPLES)
                uv = curve_points(curve, t)
                edge = surface.evaluate(uv[:, 0], uv[:, 1])
                if np.ptp(edge, axis=0).max() > EDGE * body.size:
                    edges.append(edge)
        return edges
    u, _ = span_parameters(surface.knots_u, surface.degree_u, SAMPLES)
    v, _ = span_parameters(surface.knots_v, surface.degree_v, SAMPLES)
    edges = []
    if not g.wrap_u:
        edges += [surface.evaluate(u[end], v) for end in (0, -1) if not g.poles & (1 if end == 0 else 2)]
    if not g.wrap_v:
        edges += [surface.evaluate(u, v[end]) for end in (0, -1) if not g.poles & (4 if end == 0 else 8)]
    return edges


def _bend(edge: Array) -> float:
    """About how far the chords of an edge leave it."""
    second = edge[2:] - 2.0 * edge[1:-1] + edge[:-2]
    return float(np.linalg.norm(second, axis=1).max(initial=0.0)) / 4.0


def _to_segment(p: Array, a: Array, b: Array) -> Array:
    """Distances of points from segments, (n,)."""
    d = b - a
    length = np.einsum("ij,ij->i", d, d)
    t = np.clip(np.einsum("ij,ij->i", p - a, d) / np.where(length > 0, length, 1.0), 0.0, 1.0)
    return np.asarray(np.linalg.norm(p - a - t[:, None] * d, axis=1))


def depth_inside(side: SurfaceBody | DistanceField, point: Array, tolerance: float) -> float:
    """How deep a point lies inside a solid, negative outside, to the tolerance; NaN where that cannot be told: on an
    edge, or so near that the side is rounding."""
    if not isinstance(side, SurfaceBody):
        return -float(signed_distance(side, point[None])[0])
    low, high = side.box
    if (point < low - tolerance).any() or (point > high + tolerance).any():
        return -float(np.linalg.norm(np.maximum(np.maximum(low - point, point - high), 0.0)))
    search = surface_field_distance(side, PointField(point), Goal(tolerance, budget=20_000))
    if search.a is None or search.high <= tolerance or not search.decided:
        return np.nan
    grid, w = side.tool.grids[search.a.face], search.a
    region = side.region(w.face)
    if region is not None and int(region.locate(np.array([[w.u, w.v]]))[0]) != ON:
        return np.nan
    g = side.patch(w.face)
    if not g.wrap_u and w.u in (g.u[0], g.u[-1]):
        return np.nan
    if not g.wrap_v and w.v in (g.v[0], g.v[-1]):
        return np.nan
    normal = grid.surface.with_control_points(side.tool.nets[w.face]).normal(w.u, w.v)
    cosine = float((point - w.point) @ normal) / search.high
    if not abs(cosine) > UPRIGHT:
        return np.nan
    return -search.high if cosine > 0 else search.high


def contains(outer: SurfaceBody | DistanceField, inner: SurfaceBody | DistanceField, tolerance: float) -> bool | None:
    """Whether a body is a solid and holds another one, or a lump of it, that does not touch its boundary; None where that
    cannot be told. Their boxes are asked first, which costs nothing."""
    if not (_may_hold(outer, inner) and is_solid(outer)):
        return False
    return holds(outer, inner, tolerance)


def _may_hold(outer: SurfaceBody | DistanceField, inner: SurfaceBody | DistanceField) -> bool:
    """Whether, by their boxes, a piece of one body could lie inside another. (Nets reach beyond their surfaces, so that
    boxes need not hold each other.)"""
    box = np.asarray(outer.box if isinstance(outer, SurfaceBody) else outer.box())
    own = inner.extents if isinstance(inner, SurfaceBody) else np.asarray(inner.box())[None]
    return bool(((own[:, 0] <= box[1]) & (own[:, 1] >= box[0])).all(axis=1).any())


def holds(outer: SurfaceBody | DistanceField, inner: SurfaceBody | DistanceField, tolerance: float) -> bool | None:
    """Whether one body that does not touch a solid's boundary lies inside it, or a lump of it does; None where the side of
    none of its points can be told."""
    box = np.asarray(outer.box if isinstance(outer, SurfaceBody) else outer.box())
    points = _probes(inner, box)
    told = not points
    for point in points:
        depth = depth_inside(outer, point, tolerance)
        if np.isnan(depth) and isinstance(outer, SurfaceBody):
            # nearest to an edge: there the faces' normals together tell the side
            depth = float(depths(outer, point[None], tolerance)[0])
        if not np.isnan(depth):
            told = True
            if depth > 0.0:
                return True
            if not isinstance(inner, SurfaceBody) or len(inner.tool.grids) == 1:
                return False
    return False if told else None


def _probes(inner: SurfaceBody | DistanceField, box: Array) -> list[Array]:
    """Points of a body in a box, some of every patch that reaches into it."""
    if not isinstance(inner, SurfaceBody):
        own = np.asarray(inner.box())
        if not np.isfinite(own).all():
            return []
        # a point of the body: down from a corner of its box
        points = []
        for start in (own.mean(axis=0), own[0], own[1]):
            at = np.asarray(inner.nearest(start[None]))[0]
            if np.isfinite(at).all():
                points.append(at)
        return points
    points = []
    meets = ((inner.extents[:, 0] <= box[1]) & (inner.extents[:, 1] >= box[0])).all(axis=1)
    for k in np.flatnonzero(meets).tolist():
        grid = inner.tool.grids[k]
        names = np.arange(grid.shape[0] * grid.shape[1]) if grid.inside is None else np.flatnonzero(grid.inside.ravel())
        some = names[np.unique(np.linspace(0, len(names) - 1, 7).astype(np.int64)[1:-1])]
        u, v = grid.matrices.u[some // grid.shape[1]], grid.matrices.v[some % grid.shape[1]]
        found = grid.surface.with_control_points(inner.tool.nets[k]).evaluate(u, v)
        points += list(found[((found >= box[0]) & (found <= box[1])).all(axis=1)])
    return points
