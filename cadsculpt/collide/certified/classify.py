"""How two bodies that meet lie to each other: touching, piercing, or one contained in the other.

Told from points of either boundary, by how deep they lie inside the other body: some deeper inside than the touch
tolerance and some farther outside, and the boundaries cross; all that are off the boundary inside, and the body is
contained; none inside, and the two touch. The points: the grids' vertices, and steps from where the two meet, a little
way at first and then farther, so that a shallow overlap between the vertices shows. An open sheet has sides near itself
only: it is pierced by what lies on either side of it beside one point where they meet.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..query import DistanceField, on_face
from ..surface_contacts import EDGE, _nearest, _Solid
from .body import SurfaceBody
from .field_distance import PointField, signed_distance
from .pairs import SurfacePairs

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Side = SurfaceBody | DistanceField
Kind = Literal["clear", "touching", "piercing", "contained"]

UPRIGHT = 0.5
"""Cosine between the way to a body's nearest point and the normal there, from which on the normal tells the side."""

PROBES = 400
"""Vertices of one body's grids that are looked at."""

PLACES = 24
"""Points where the two meet from which steps are taken."""

STEPS = 26
"""Steps each way from such a point, each twice as long as the one before."""


def kind_of_meeting(a: Side, b: Side, solid: tuple[bool, bool], pairs: SurfacePairs, touch: float) -> Kind:
    """touching, piercing or contained, for bodies whose boundaries come within `touch` of each other at `pairs`."""
    if isinstance(a, PointField) or isinstance(b, PointField):
        point, other, closed = (a, b, solid[1]) if isinstance(a, PointField) else (b, a, solid[0])
        assert isinstance(point, PointField)
        return "contained" if closed and (depths(other, point.position[None], touch) > touch).any() else "touching"
    places = pairs.chosen(np.unique(np.linspace(0, len(pairs) - 1, PLACES).astype(np.int64))) if len(pairs) else pairs
    sides = ((a, b, solid[1], places), (b, a, solid[0], places.swapped(np.zeros_like(places.normal))))
    within = False
    for mine, other, closed, at in sides:
        local = _steps(mine, other, at, touch)
        depth = depths(other, local.reshape(-1, 3), touch).reshape(local.shape[:2])
        if closed:
            depth = np.concatenate([depth.ravel(), depths(other, _boundary(mine, other), touch)])
            inner, outer = bool((depth > touch).any()), bool((depth < -touch).any())
            if inner and outer:
                return "piercing"
            within = within or inner
        elif ((depth > touch).any(axis=1) & (depth < -touch).any(axis=1)).any():
            return "piercing"
    if not within and all(solid):
        within = _aligned(a, b, places)
    return "contained" if within else "touching"


def depths(side: Side, points: Array, tie: float) -> Array:
    """How deep points (n, 3) lie inside a body, negative outside; NaN where it has no sides."""
    if not len(points):
        return np.zeros(0)
    if not isinstance(side, SurfaceBody):
        return -signed_distance(side, points)
    out = np.empty(len(points))
    solid = _Solid(side.tool.grids, side.patch, side.extents, max(EDGE * side.size, tie), np.inf)
    for start in range(0, len(points), 256):
        part = np.ascontiguousarray(points[start : start + 256])
        found = _nearest(solid, part, np.arange(len(part) + 1))
        arm = part - found.point
        along = np.abs(np.einsum("ij,ij->i", arm, found.normal))
        # beside a pole the closest point may be the pole itself, and the way to it no normal: that tells no side
        upright = along >= UPRIGHT * np.linalg.norm(arm, axis=1)
        out[start : start + 256] = np.where(np.isfinite(found.depth) & upright, found.depth, np.nan)
    return out


def _boundary(side: Side, other: Side) -> Array:
    """Points of a body's boundary, in and about the other's box."""
    if isinstance(side, SurfaceBody):
        parts = []
        most = max(16, PROBES // len(side.tool.grids))
        for grid, net in zip(side.tool.grids, side.tool.nets, strict=True):
            points = grid.matrices.points(net, grid.surface.weights)
            points = points.reshape(-1, 3) if grid.inside is None else points[grid.inside]
            parts.append(points[np.unique(np.linspace(0, len(points) - 1, most).astype(np.int64))])
        return np.concatenate(parts)
    parts = []
    boxes = [np.asarray(side.box()), np.asarray(other.box if isinstance(other, SurfaceBody) else other.box())]
    boxes.append(np.stack([np.maximum(boxes[0][0], boxes[1][0]), np.minimum(boxes[0][1], boxes[1][1])]))
    for box in boxes:
        if np.isfinite(box).all() and (box[1] >= box[0]).all():
            along = [np.linspace(box[0, c], box[1, c], 7) for c in range(3)]
            parts.append(np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 3))
    if not parts:
        return np.zeros((0, 3))
    near = np.asarray(side.nearest(np.concatenate(parts)))
    near = near[np.isfinite(near).all(axis=1)]  # at a centre every direction is as near
    scale = float(np.abs(near).max(initial=1.0))
    return near[np.abs(signed_distance(side, near)) <= 1e-9 * scale]


def _steps(side: Side, other: Side, at: SurfacePairs, touch: float) -> Array:
    """Points (places, 2 STEPS, 3) of a body's surface beside where it meets the other, across the curve in which they
    do."""
    if not len(at):
        return np.zeros((0, 2 * STEPS, 3))
    reach = touch * 2.0 ** np.arange(1, STEPS + 1)
    reach = np.concatenate([-reach[::-1], reach])
    mine = _normal_at(side, at.face_a, at.u_a, at.v_a, at.point)
    its = _normal_at(other, at.face_b, at.u_b, at.v_b, at.other)
    across = its - np.einsum("ij,ij->i", its, mine)[:, None] * mine
    length = np.linalg.norm(across, axis=1)
    # where the two are tangent every way is as good
    axis = np.eye(3)[np.argmin(np.abs(mine), axis=1)]
    across = np.where((length > 1e-12)[:, None], across, np.cross(mine, axis))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    aim = at.point[:, None] + reach[None, :, None] * across[:, None]
    if not isinstance(side, SurfaceBody):
        near = np.asarray(side.nearest(aim.reshape(-1, 3))).reshape(aim.shape)
        return np.where(np.isfinite(near), near, at.point[:, None])
    out = np.repeat(at.point[:, None], len(reach), axis=1)
    for n in range(len(at)):
        k = int(at.face_a[n])
        grid = side.tool.grids[k]
        surface = grid.surface.with_control_points(side.tool.nets[k])
        d = surface.derivatives(at.u_a[n], at.v_a[n], 1)
        step = np.linalg.lstsq(np.stack([d[1, 0], d[0, 1]], axis=1), across[n], rcond=None)[0]
        uv = np.array([at.u_a[n], at.v_a[n]]) + reach[:, None] * step
        g, keep = side.patch(k), np.ones(len(reach), dtype=np.bool_)
        for c, (along, wrap) in enumerate(((g.u, g.wrap_u), (g.v, g.wrap_v))):
            if wrap:
                uv[:, c] = along[0] + (uv[:, c] - along[0]) % (along[-1] - along[0])
            else:
                keep &= (uv[:, c] >= along[0]) & (uv[:, c] <= along[-1])
        if keep.any():
            keep[keep] = on_face(grid, uv[keep])
            out[n, keep] = surface.evaluate(uv[keep, 0], uv[keep, 1])
    return out


def _normal_at(side: Side, face: Index, u: Array, v: Array, point: Array) -> Array:
    from .meeting import normals

    found = normals(side, face, u, v, point, point)
    return np.where(np.isfinite(found), found, [0.0, 0.0, 1.0])


def _aligned(a: Side, b: Side, places: SurfacePairs) -> bool:
    """Two solids with nothing off each other's boundary on either side: the same solid where their normals agree, flush
    against each other where they are opposite."""
    if not len(places):
        return False
    mine = _normal_at(a, places.face_a, places.u_a, places.v_a, places.point)
    its = _normal_at(b, places.face_b, places.u_b, places.v_b, places.other)
    return bool((np.einsum("ij,ij->i", mine, its) > 0.9).all())
