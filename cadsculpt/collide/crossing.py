"""Which triangles of two surfaces meet (paper section 4.7): only those of cells whose spheres intersect are tested.

Before a pair of triangles comes to the exact test, the boxes of their cells, and then the plane of either, part nearly
all pairs that do not meet; both do so with a margin for rounding, so that they never overrule the exact test.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit
from .tri_tri import WORK, tri_tri
from .workspace import grown

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

PLANE_ROUNDING = 64 * 2.0**-53
"""Bound on the error of n . (p - q), n = e1 x e2, relative to max(|e1|, |e2|)^2 |p - q|_1: a few dozen roundings."""


@njit
def cell_boxes(points: Array, triangles: Index, first: Index) -> Array:
    """Boxes (cells, 6) of the triangles first[c] to first[c + 1] of each cell; empty cells get an empty box."""
    out = np.empty((len(first) - 1, 6))
    for c in range(len(out)):
        for k in range(3):
            out[c, k], out[c, 3 + k] = np.inf, -np.inf
        for t in range(first[c], first[c + 1]):
            for v in range(3):
                for k in range(3):
                    out[c, k] = min(out[c, k], points[triangles[t, v], k])
                    out[c, 3 + k] = max(out[c, 3 + k], points[triangles[t, v], k])
    return out


@njit
def overlapping(box_a: Array, sag_a: Array, box_b: Array, sag_b: Array, pairs: Index, margin: float) -> Mask:
    """Which pairs (k, 2) of cells can come within `margin`: their triangles' boxes (n, 6), grown by the sags (n,),
    do."""
    out = np.empty(len(pairs), np.bool_)
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        pad = sag_a[a] + sag_b[b] + margin
        out[k] = (
            box_a[a, 0] <= box_b[b, 3] + pad and box_b[b, 0] <= box_a[a, 3] + pad
            and box_a[a, 1] <= box_b[b, 4] + pad and box_b[b, 1] <= box_a[a, 4] + pad
            and box_a[a, 2] <= box_b[b, 5] + pad and box_b[b, 2] <= box_a[a, 5] + pad
        )  # fmt: skip
    return out


@njit
def planes(points: Array, triangles: Index) -> Array:
    """Per triangle (t, 4): its normal e1 x e2, and the squared length of its longer edge times PLANE_ROUNDING."""
    out = np.empty((len(triangles), 4))
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
        vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
        out[t, 0], out[t, 1], out[t, 2] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        out[t, 3] = PLANE_ROUNDING * max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz)
    return out


@njit
def parted(points_p: Array, tri_p: Index, plane: Array, p: int, points_q: Array, tri_q: Index, q: int) -> bool:
    """All vertices of triangle q lie clearly on one side of the plane of triangle p."""
    above, below = 0, 0
    o = tri_p[p, 0]
    for v in range(3):
        k = tri_q[q, v]
        x, y, z = points_q[k, 0] - points_p[o, 0], points_q[k, 1] - points_p[o, 1], points_q[k, 2] - points_p[o, 2]
        side = plane[p, 0] * x + plane[p, 1] * y + plane[p, 2] * z
        doubt = plane[p, 3] * (abs(x) + abs(y) + abs(z))
        above += side > doubt
        below += side < -doubt
    return above == 3 or below == 3


@njit
def crossing_triangles(
    points_a: Array, tri_a: Index, first_a: Index, box_a: Array,
    points_b: Array, tri_b: Index, first_b: Index, box_b: Array, pairs: Index,
) -> tuple[Index, Array, int]:  # fmt: skip
    """The triangles that meet, over the pairs (k, 2) of cells: (n, 3) triangle of a, of b, relation; segments
    (n, 6); and the number of pairs of triangles tested."""
    plane_a, plane_b = planes(points_a, tri_a), planes(points_b, tri_b)
    found = np.empty((64, 3), np.int64)
    segments = np.empty((64, 6))
    count, tests = 0, 0
    both, segment, work = np.empty((6, 3)), np.empty(6), np.empty(WORK)
    for k in range(len(pairs)):
        c, d = pairs[k, 0], pairs[k, 1]
        if (
            box_a[c, 0] > box_b[d, 3] or box_a[c, 3] < box_b[d, 0]
            or box_a[c, 1] > box_b[d, 4] or box_a[c, 4] < box_b[d, 1]
            or box_a[c, 2] > box_b[d, 5] or box_a[c, 5] < box_b[d, 2]
        ):  # fmt: skip
            continue
        for s in range(first_a[c], first_a[c + 1]):
            for t in range(first_b[d], first_b[d + 1]):
                tests += 1
                if parted(points_b, tri_b, plane_b, t, points_a, tri_a, s):
                    continue
                if parted(points_a, tri_a, plane_a, s, points_b, tri_b, t):
                    continue
                for v in range(3):
                    for x in range(3):
                        both[v, x] = points_a[tri_a[s, v], x]
                        both[3 + v, x] = points_b[tri_b[t, v], x]
                relation = tri_tri(both, segment, work)
                if relation == 0:
                    continue
                if count == len(found):
                    found = grown(found)
                    segments = longer(segments)
                found[count, 0], found[count, 1], found[count, 2] = s, t, relation
                for x in range(6):
                    segments[count, x] = segment[x]
                count += 1
    return found[:count], segments[:count], tests


@njit
def longer(rows: Array) -> Array:
    """The same rows in an array twice as long."""
    out = np.empty((2 * len(rows), rows.shape[1]))
    for i in range(len(rows)):
        for c in range(rows.shape[1]):
            out[i, c] = rows[i, c]
    return out
