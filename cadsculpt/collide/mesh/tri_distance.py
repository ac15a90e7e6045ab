"""The smallest distance of two triangles, and where they have it; triangles without area are segments and points.

Candidates are the corners of each against the whole of the other, and the edges of each against those of the other where
they pass each other within both: no smallest distance is anywhere else, unless the triangles meet. Whether they do is
decided exactly by `tri_tri`. Each candidate is the distance of two points that the triangles have, so that a corner or
an edge that rounding puts on the wrong side costs no more than rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import GeometryError
from ...jit import njit
from ..predicates import minor_value
from ..tri_tri import DISJOINT, WORK, tri_tri
from .tree import AB, BC, CA, FACE, A, B, frame_of, triangle_distance2

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class TriangleDistance:
    """distance : exact to rounding, and 0 exactly where the triangles meet. points (2, 3) : one of each that have it."""

    distance: float
    points: Array


def triangle_distance(p: ArrayLike, q: ArrayLike) -> TriangleDistance:
    """The smallest distance of the triangles p and q, (3, 3) each. Raises GeometryError for coordinates that are not
    finite."""
    a, b = np.array(p, dtype=np.float64), np.array(q, dtype=np.float64)
    if a.shape != (3, 3) or b.shape != (3, 3) or not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise GeometryError("a triangle needs three finite points", where="triangle distance")
    t, frames, pair = np.concatenate([a, b]), np.empty((2, 16)), np.empty(6)
    frame_of(t, 0, 1, 2, frames[0])
    frame_of(t, 3, 4, 5, frames[1])
    squared = tri_distance2(t, frames, 0, frames, 1, pair, np.empty(WORK + 6))
    return TriangleDistance(float(np.sqrt(squared)), pair.reshape(2, 3))


@njit
def tri_distance2(t: Array, p_frames: Array, p: int, q_frames: Array, q: int, pair: Array, work: Array) -> float:
    """Squared distance of the triangles t[0:3] and t[3:6], with frames p_frames[p] and q_frames[q] (see `tree`).

    pair (6,) : the two points, on each. work (WORK + 6,) is scratch.
    """
    best = np.inf
    for k in range(6):
        if k < 3:
            d = closest_on(q_frames, q, t, k, work)
        else:
            d = closest_on(p_frames, p, t, k, work)
        if d < best:
            best = d
            mine = 0 if k < 3 else 3
            for c in range(3):
                pair[mine + c], pair[3 - mine + c] = t[k, c], work[c]
    for i in range(3):
        for j in range(3):
            d = passing(t, i, (i + 1) % 3, 3 + j, 3 + (j + 1) % 3, work)
            if d < best:
                best = d
                for c in range(6):
                    pair[c] = work[c]
    if best == 0.0:
        return best
    for c in range(3):
        low = max(min(t[0, c], t[1, c], t[2, c]), min(t[3, c], t[4, c], t[5, c]))
        if low > min(max(t[0, c], t[1, c], t[2, c]), max(t[3, c], t[4, c], t[5, c])):
            return best
    if tri_tri(t, work[:6], work[6:]) == DISJOINT:
        return best
    if work[0] == work[0]:  # in different planes: they meet in a segment
        for c in range(3):
            pair[c] = pair[3 + c] = 0.5 * (work[c] + work[3 + c])
    else:
        for c in range(3):
            pair[3 + c] = pair[c]
    return 0.0


@njit
def closest_on(frames: Array, k: int, points: Array, i: int, out: Array) -> float:
    """Squared distance of points[i] from triangle k; the nearest point into out[:3]."""
    f = frames[k]
    x, y, z = points[i, 0] - f[0], points[i, 1] - f[1], points[i, 2] - f[2]
    if f[12] == 0.0:  # all corners are one
        out[0], out[1], out[2] = f[0], f[1], f[2]
        return float(x * x + y * y + z * z)
    d, part = triangle_distance2(frames, k, points[i, 0], points[i, 1], points[i, 2])
    fx, fy = x * f[3] + y * f[4] + z * f[5], x * f[6] + y * f[7] + z * f[8]
    length, cx, cy = f[12], f[13], f[14]
    if part == AB:
        fy = 0.0
    elif part == A:
        fx, fy = 0.0, 0.0
    elif part == B:
        fx, fy = length, 0.0
    elif part == CA:
        s = (fx * cx + fy * cy) / f[15]
        fx, fy = s * cx, s * cy
    elif part == BC:
        ex = cx - length
        s = ((fx - length) * ex + fy * cy) / (ex * ex + cy * cy)
        fx, fy = length + s * ex, s * cy
    elif part != FACE:
        fx, fy = cx, cy
    for c in range(3):
        out[c] = f[c] + fx * f[3 + c] + fy * f[6 + c]
    return d


@njit
def passing(t: Array, a: int, b: int, c: int, d: int, out: Array) -> float:
    """Squared distance of the lines through t[a], t[b] and t[c], t[d] where it is between these points, else infinity.

    The two points go into out[:6]. Cross products are kept from cancelling: nearly parallel lines lose nothing.
    """
    ux, uy, uz = t[b, 0] - t[a, 0], t[b, 1] - t[a, 1], t[b, 2] - t[a, 2]
    vx, vy, vz = t[d, 0] - t[c, 0], t[d, 1] - t[c, 1], t[d, 2] - t[c, 2]
    wx, wy, wz = t[c, 0] - t[a, 0], t[c, 1] - t[a, 1], t[c, 2] - t[a, 2]
    nx, ny, nz = minor_value(uy, uz, vy, vz), minor_value(uz, ux, vz, vx), minor_value(ux, uy, vx, vy)
    n2 = nx * nx + ny * ny + nz * nz
    if not n2 > 0.0:
        return np.inf
    r = minor_value(wy, wz, vy, vz) * nx + minor_value(wz, wx, vz, vx) * ny + minor_value(wx, wy, vx, vy) * nz
    if not 0.0 < r < n2:
        return np.inf
    s = minor_value(wy, wz, uy, uz) * nx + minor_value(wz, wx, uz, ux) * ny + minor_value(wx, wy, ux, uy) * nz
    if not 0.0 < s < n2:
        return np.inf
    r, s = r / n2, s / n2
    out[0], out[1], out[2] = t[a, 0] + r * ux, t[a, 1] + r * uy, t[a, 2] + r * uz
    out[3], out[4], out[5] = t[c, 0] + s * vx, t[c, 1] + s * vy, t[c, 2] + s * vz
    return float((out[0] - out[3]) ** 2 + (out[1] - out[4]) ** 2 + (out[2] - out[5]) ** 2)
