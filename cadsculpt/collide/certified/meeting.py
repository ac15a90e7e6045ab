"""Points in which two bodies meet, on their true surfaces: from the triangles of the finest grids that meet, by Newton."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...spline.region import OFF
from ..detect import detect
from ..query import Crossings, DetectOptions, DistanceField
from ..tri_tri import CROSSING
from ..workspace import Patch, make_points, spans_of
from .body import SurfaceBody
from .field_distance import signed_distance
from .interval import Witness
from .nearest_pair import nearest_pair
from .pairs import SurfacePairs

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Side = SurfaceBody | DistanceField

SAME = 1e-3
"""Two points nearer than this part of a grid's cell are one."""

SPREAD = 0.5
"""The same where the surfaces lie on each other: there is no curve to follow, and every point is as good."""

BISECTIONS = 60
"""Halvings of a grid's edge until the point where a field changes its sign is found to rounding."""

NUDGE = 1e-6
"""Part of the way to the middle of a patch that is gone from a pole for a normal."""

FREE = np.full((2, 2), np.nan)
"""No chord: a point of `nearest_pair` that may lie anywhere on its patch."""


def witness_pair(a: Side, b: Side, one: Witness, two: Witness, depth: float) -> SurfacePairs:
    """A pair of points as contacts, with a's normal."""
    normal = normals(a, np.array([one.face]), np.array([one.u]), np.array([one.v]), one.point[None], two.point[None])
    faces, u, v = (np.array([[getattr(w, name)] for w in (one, two)]) for name in ("face", "u", "v"))
    return SurfacePairs(
        faces[0], u[0], v[0], faces[1], u[1], v[1], one.point[None], two.point[None], normal, np.array([depth])
    )


def normals(side: Side, face: Index, u: Array, v: Array, point: Array, other: Array) -> Array:
    """Unit normals (n, 3) out of a body's material at points (n, 3) of its surface; at a pole, on a point, the way to the
    other body's point."""
    way = other - point
    length = np.linalg.norm(way, axis=1, keepdims=True)
    out = np.where(length > 0, way / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
    if not isinstance(side, SurfaceBody):
        return np.asarray(side.gradient(point)) if np.ptp(np.asarray(side.box()), axis=0).max() > 0 else out
    for k in np.unique(face).tolist():
        mine = face == k
        surface = side.tool.grids[k].surface.with_control_points(side.tool.nets[k])
        found = surface.normal(u[mine], v[mine])
        # at a pole, that of a point a little inside
        (u0, u1), (v0, v1) = surface.domain
        inner = surface.normal(
            u[mine] + NUDGE * (0.5 * (u0 + u1) - u[mine]), v[mine] + NUDGE * (0.5 * (v0 + v1) - v[mine])
        )
        found = np.where(np.isfinite(found), found, inner)
        out[mine] = np.where(np.isfinite(found), found, out[mine])
    return out


def surfaces_meet(a: SurfaceBody, b: SurfaceBody, touch: float) -> SurfacePairs:
    """Where the triangles of two B-spline bodies' finest grids meet, the points in which their surfaces do: at most
    `touch` apart and on both faces."""
    options = DetectOptions(tolerance=0.0)
    crossings = detect(a.tool.grids, a.tool.nets, [b.tool], options).crossings
    rows, points, along = [], [], []
    for n in _worth(crossings).tolist():
        k, l = int(crossings.face[n]), int(crossings.tool_face[n])
        g, h = a.patch(k), b.patch(l)
        middle = crossings.segment[n].mean(axis=0)
        x = np.concatenate([_start(g, a.tool.grids[k].shape, crossings.model_triangle[n], middle),
                            _start(h, b.tool.grids[l].shape, crossings.tool_triangle[n], middle)])  # fmt: skip
        found = np.empty((4, 3))
        if not nearest_pair(spans_of(g), spans_of(h), x, FREE, FREE, found) <= touch:
            continue
        if _off(a, k, x[:2]) or _off(b, l, x[2:]):
            continue
        rows.append((k, *x[:2], l, *x[2:]))
        points.append(found[:2])
        along.append(crossings.relation[n] == CROSSING)
    if not rows:
        return SurfacePairs.none()
    table, both = np.array(rows), np.array(points)
    face_a, face_b = table[:, 0].astype(np.int64), table[:, 3].astype(np.int64)
    normal = normals(a, face_a, table[:, 1], table[:, 2], both[:, 0], both[:, 1])
    pairs = SurfacePairs(
        face_a, table[:, 1], table[:, 2], face_b, table[:, 4], table[:, 5], both[:, 0], both[:, 1], normal,
        np.zeros(len(table)),
    )  # fmt: skip
    cell, curve = min(_cell(a), _cell(b)), np.array(along)
    flat = pairs.chosen(np.flatnonzero(~curve)).ordered().apart(SPREAD * cell)
    return SurfacePairs.joined([pairs.chosen(np.flatnonzero(curve)), flat]).ordered().apart(SAME * cell)


def _worth(crossings: Crossings) -> Index:
    """Which crossings lead to points of their own: all that cross; of those that only touch or lie in one plane, one for
    each of the model's triangles."""
    curve = crossings.relation == CROSSING
    flat = np.flatnonzero(~curve)
    names = np.column_stack([crossings.face[flat], crossings.tool_face[flat], crossings.model_triangle[flat]])
    first = np.unique(names, axis=0, return_index=True)[1]
    return np.sort(np.concatenate([np.flatnonzero(curve), flat[first]]))


def _off(body: SurfaceBody, face: int, uv: Array) -> bool:
    region = body.region(face)
    return region is not None and int(region.locate(uv)[0]) == OFF


def _cell(body: SurfaceBody) -> float:
    """About the size of a finest cell: of the smallest patch's."""
    sizes = np.linalg.norm(body.extents[:, 1] - body.extents[:, 0], axis=1)
    return float(min(size / max(grid.shape) for size, grid in zip(sizes, body.tool.grids, strict=True)))


def _start(g: Patch, shape: tuple[int, int], triangle: Index, point: Array) -> Array:
    """(u, v) of a point (3,) of a triangle of grid vertices i n + j; its middle where the point is NaN.

    Vertices on a seam have the name of its first side, those of a pole one name for all.
    """
    i, j = triangle // shape[1], triangle % shape[1]
    u, v = g.u[i].copy(), g.v[j].copy()
    for t, row, along, wrap, first, last in (
        (u, i, g.u, g.wrap_u, g.poles & 4, g.poles & 8),
        (v, j, g.v, g.wrap_v, g.poles & 1, g.poles & 2),
    ):
        across, count = (j, shape[1]) if t is u else (i, shape[0])
        pole = ((across == 0) & bool(first)) | ((across == count - 1) & bool(last))
        span = along[-1] - along[0]
        if wrap and not pole.all():
            known = t[~pole]
            if np.ptp(known) > 0.5 * span:
                t[~pole & (t < along[0] + 0.5 * span)] += span
        if pole.any() and not pole.all():
            t[pole] = t[~pole].mean()
        del row
    weights = np.full(3, 1.0 / 3.0)
    if np.isfinite(point).all():
        make_points(g, triangle, 3)
        corners = g.points[triangle]
        edges = (corners[1:] - corners[0]).T
        w = np.linalg.lstsq(edges, point - corners[0], rcond=None)[0]
        weights = np.clip(np.array([1.0 - w.sum(), *w]), 0.0, 1.0)
        weights /= weights.sum()
    at = np.array([weights @ u, weights @ v])
    for c, (along, wrap) in enumerate(((g.u, g.wrap_u), (g.v, g.wrap_v))):
        if wrap and at[c] > along[-1]:
            at[c] -= along[-1] - along[0]
        at[c] = min(max(at[c], along[0]), along[-1])
    return at


def field_meets(body: SurfaceBody, field: DistanceField) -> SurfacePairs:
    """Points of a B-spline body's faces where a field changes its sign along the edges of the finest grids: on the true
    surface and, to rounding, on the field's."""
    box = np.asarray(field.box())
    parts = []
    near = ((body.extents[:, 0] <= box[1]) & (body.extents[:, 1] >= box[0])).all(axis=1)
    for k in np.flatnonzero(near).tolist():
        grid = body.tool.grids[k]
        surface = grid.surface.with_control_points(body.tool.nets[k])
        m, n = grid.shape
        value = signed_distance(field, grid.matrices.points(body.tool.nets[k], surface.weights).reshape(-1, 3))
        value = value.reshape(m, n)
        u, v = grid.matrices.u, grid.matrices.v
        for axis in (0, 1):
            before, after = (value[:-1], value[1:]) if axis == 0 else (value[:, :-1], value[:, 1:])
            i, j = np.nonzero((before <= 0.0) != (after <= 0.0))
            if not len(i):
                continue
            low, high = (u[i], u[i + 1]) if axis == 0 else (v[j], v[j + 1])
            inside = before[i, j] <= 0.0
            for _ in range(BISECTIONS):
                middle = 0.5 * (low + high)
                at = surface.evaluate(middle, v[j]) if axis == 0 else surface.evaluate(u[i], middle)
                same = (signed_distance(field, at) <= 0.0) == inside
                low, high = np.where(same, middle, low), np.where(same, high, middle)
            uv = np.stack([low, v[j]] if axis == 0 else [u[i], low], axis=1)
            region = body.region(k)
            if region is not None:
                uv = uv[region.locate(uv) != OFF]
            parts.append((np.full(len(uv), k), uv, surface.evaluate(uv[:, 0], uv[:, 1])))
    if not sum(len(part[0]) for part in parts):
        return SurfacePairs.none()
    face, uv, point = (np.concatenate([part[c] for part in parts]) for c in range(3))
    other = np.asarray(field.nearest(point))
    nowhere = np.full(len(face), np.nan)
    normal = normals(body, face, uv[:, 0], uv[:, 1], point, other)
    pairs = SurfacePairs(
        face, uv[:, 0].copy(), uv[:, 1].copy(), np.full(len(face), -1), nowhere, nowhere, point, other, normal,
        np.zeros(len(face)),
    )  # fmt: skip
    return pairs.ordered().apart(SAME * _cell(body))
