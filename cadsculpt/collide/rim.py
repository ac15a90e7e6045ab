"""Closest points of trimmed faces: where the foot on the surface has been trimmed away, the face's rim is nearest.

Faces of CAD solids are cut out of larger surfaces, which run on through the body behind a reentrant edge. A foot there is
no part of the body: neither its distance nor its side says anything. The rim itself is then the nearest part of the
face, and at an edge of the body the rims of two faces meet; the sum of their normals tells the sides apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..jit import njit_in_place
from .closest import NOTHING, merge, project
from .grid import PatchGrid
from .newton import BORDER, DISTANCE, NORMAL, POINT, U, V
from .query import on_face
from .spheres import make_spheres
from .workspace import Patch

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PIECES = 2.0
"""Pieces of a rim for each cell that it passes: near enough for the steps along it to begin."""

STEPS = 12
"""Steps of Gauss and Newton along the rim, each to the foot on its tangent: a straight edge takes one, a smooth one a few."""


def closest_on_faces(
    grids: Sequence[PatchGrid], patches: Sequence[Patch], points: Array, tie: float
) -> tuple[Array, Index, Index]:
    """Closest points of trimmed faces to points (n, 3): rows (n, 9), state and owner (n,) as of `closest.project`.

    A closest point on a rim that is not another face's as well is a BORDER.
    """
    n = len(points)
    best, state, owner = np.full((n, 9), np.inf), np.zeros(n, np.int64), np.full(n, -1, dtype=np.int64)
    each = np.arange(n + 1)
    for k, (grid, g) in enumerate(zip(grids, patches, strict=True)):
        mine, kind, own = np.full((n, 9), np.inf), np.zeros(n, np.int64), np.full(n, -1, dtype=np.int64)
        project(g, points, each, 0.0, np.inf, k, mine, kind, own)
        if grid.region is not None:
            off = np.flatnonzero((kind == NOTHING) | ~on_face(grid, mine[:, [U, V]]))
            if len(off):
                mine[off], kind[off] = closest_on_rim(grid, g, points[off]), BORDER
        merge_all(mine, kind, k, tie, best, state, owner)
    return best, state, owner


def faces_box(grids: Sequence[PatchGrid], patches: Sequence[Patch]) -> Array:
    """A box (2, 3) that holds all faces: their finest cells' spheres."""
    box = np.array([[np.inf] * 3, [-np.inf] * 3])
    for grid, g in zip(grids, patches, strict=True):
        last = len(grid.tally) - 1
        at = np.flatnonzero(grid.covers[grid.offset[last] :])
        cells = np.stack([np.full(len(at), last), *np.divmod(at, grid.tally[last, 1])], axis=1)
        centre, radius = make_spheres(g, cells, len(cells))
        box[0] = np.minimum(box[0], (centre - radius[:, None]).min(axis=0))
        box[1] = np.maximum(box[1], (centre + radius[:, None]).max(axis=0))
    return box


def outside_box(box: Array, points: Array) -> Array:
    """Distance (n,) of points (n, 3) from a box (2, 3), 0 inside."""
    return np.asarray(np.linalg.norm(np.maximum(0.0, np.maximum(box[0] - points, points - box[1])), axis=1))


@njit_in_place
def merge_all(mine: Array, kind: Index, patch: int, tie: float, best: Array, state: Index, owner: Index) -> None:
    """`closest.merge` of every row (n, 9) that holds anything."""
    for i in range(len(mine)):
        if kind[i] != NOTHING:
            merge(mine[i], kind[i], patch, tie, i, best, state, owner)


@njit_in_place
def nearest_piece(points: Array, a: Array, b: Array, chosen: Index, part: Array) -> None:
    """For each point (n, 3) the nearest of the segments from a to b (k, 3), and the place on it, 0 to 1."""
    for i in range(len(points)):
        best = np.inf
        for k in range(len(a)):
            dd, dx = 0.0, 0.0
            for c in range(3):
                d = b[k, c] - a[k, c]
                dd += d * d
                dx += d * (points[i, c] - a[k, c])
            t = min(max(dx / dd, 0.0), 1.0) if dd > 0.0 else 0.0
            away = 0.0
            for c in range(3):
                away += (a[k, c] + t * (b[k, c] - a[k, c]) - points[i, c]) ** 2
            if away < best:
                best, chosen[i], part[i] = away, k, t


def closest_on_rim(grid: PatchGrid, g: Patch, points: Array) -> Array:
    """Closest points of the trim curves of a face, on the surface over g's net, to points (n, 3): rows (n, 9) of
    `newton`."""
    surface = grid.surface.with_control_points(g.net[..., :3] / g.net[..., 3:])
    start, end = _rim(grid, g)
    a, b = surface.evaluate(start[:, 0], start[:, 1]), surface.evaluate(end[:, 0], end[:, 1])
    chosen, part = np.zeros(len(points), np.int64), np.zeros(len(points))
    nearest_piece(np.ascontiguousarray(points), a, b, chosen, part)
    uv, step = start[chosen], end[chosen] - start[chosen]
    for _ in range(STEPS):
        at = uv + part[:, None] * step
        s = surface.derivatives(at[:, 0], at[:, 1], 1)
        tangent = s[1, 0] * step[:, :1] + s[0, 1] * step[:, 1:]
        along = ((points - s[0, 0]) * tangent).sum(axis=1) / np.maximum((tangent * tangent).sum(axis=1), 1e-300)
        renewed = np.clip(part + along, 0.0, 1.0)
        settled = bool((np.abs(renewed - part) <= 1e-12).all())
        part = renewed
        if settled:
            break
    at = uv + part[:, None] * step
    s = surface.derivatives(at[:, 0], at[:, 1], 1)
    normal = np.cross(s[1, 0], s[0, 1])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    rows = np.empty((len(points), 9))
    rows[:, DISTANCE] = np.linalg.norm(points - s[0, 0], axis=1)
    rows[:, POINT : POINT + 3] = s[0, 0]
    rows[:, NORMAL : NORMAL + 3] = g.flip * normal / np.where(length > 0, length, 1.0)
    rows[:, U], rows[:, V] = at.T
    return rows


def _rim(grid: PatchGrid, g: Patch) -> tuple[Array, Array]:
    """The trim curves as pieces from (u, v) to (u, v), (k, 2) each, none much longer than a cell."""
    region = grid.region
    assert region is not None
    corner, size = np.array([g.u[0], g.v[0]]), np.array([g.u[-1] - g.u[0], g.v[-1] - g.v[0]])
    starts, ends = (
        (region.low - corner + region.size * x) / size for x in (region.chords[:, :2], region.chords[:, 2:])
    )
    # a trim that runs over the seam of a closed surface, brought back by whole periods
    period = np.array([g.wrap_u, g.wrap_v], dtype=np.float64)
    turn = np.floor(0.5 * (starts + ends)) * period
    starts, ends = starts - turn, ends - turn
    cells = np.array([len(g.u) - 1, len(g.v) - 1])
    count = np.maximum(1, np.ceil(PIECES * (np.abs(ends - starts) * cells).max(axis=1))).astype(np.int64)
    which = np.repeat(np.arange(len(starts)), count)
    place = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    across = (ends - starts)[which]
    low = starts[which] + across * (place / count[which])[:, None]
    high = starts[which] + across * ((place + 1) / count[which])[:, None]
    return corner + size * np.clip(low, 0.0, 1.0), corner + size * np.clip(high, 0.0, 1.0)
