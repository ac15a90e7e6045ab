"""Lower bounds for the distance of two pieces of surface: spheres first, then hulls.

Any direction proves a gap: the distance of two sets is at least that of their shadows on a line. GJK (Gilbert, Johnson,
Keerthi 1988; `hull.nearest_in_simplex`) finds a good direction; the bound is the shadows' gap along the best one, less
the rounding, so an iteration that stops early costs sharpness and never truth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...jit import njit
from ..hull import GJK_STEPS, farthest, nearest_in_simplex

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SHARP = 1e-9
"""A gap found to this part of itself is not sharpened further."""


@njit
def hull_gap(a: Array, b: Array, worth: float, enough: float) -> float:
    """A lower bound, sharp where GJK converges, of the distance of the hulls of a (n, 3) and b (m, 3); at most 0 where
    they meet.

    A gap above `enough` ends the search, and so does the certainty that it is below `worth`, of which a twentieth is no
    loss either.
    """
    simplex = np.empty((4, 3))
    weights = np.empty(4)
    size = 0
    largest = 0.0
    x, y, z = 0.0, 0.0, 0.0
    for i in range(len(a)):
        largest = max(largest, abs(a[i, 0]), abs(a[i, 1]), abs(a[i, 2]))
        x, y, z = x + a[i, 0] / len(a), y + a[i, 1] / len(a), z + a[i, 2] / len(a)
    for i in range(len(b)):
        largest = max(largest, abs(b[i, 0]), abs(b[i, 1]), abs(b[i, 2]))
        x, y, z = x - b[i, 0] / len(b), y - b[i, 1] / len(b), z - b[i, 2] / len(b)
    noise = 1e-14 * largest
    best = -np.inf
    for _ in range(GJK_STEPS):
        length = np.sqrt(x * x + y * y + z * z)
        if not length > max(noise, worth):
            break
        x, y, z = x / length, y / length, z / length
        i, j = farthest(a, -x, -y, -z), farthest(b, x, y, z)
        dx, dy, dz = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]
        reach = dx * x + dy * y + dz * z
        best = max(best, reach)
        if best > enough or (size > 0 and reach >= length - SHARP * length - 0.05 * worth - noise):
            break
        simplex[size, 0], simplex[size, 1], simplex[size, 2] = dx, dy, dz
        size = nearest_in_simplex(simplex, size + 1, weights)
        if size == 4:
            break
        x, y, z = 0.0, 0.0, 0.0
        for k in range(size):
            x += weights[k] * simplex[k, 0]
            y += weights[k] * simplex[k, 1]
            z += weights[k] * simplex[k, 2]
    return best - noise


@njit
def pair_bounds(
    hull_a: Array, grown_a: Array, ball_a: Array, hull_b: Array, grown_b: Array, ball_b: Array, pairs: Index,
    known: Array, enough: float, lower: Array,
) -> None:  # fmt: skip
    """Lower bounds, into lower (k,), of the distance over pairs (k, 2) of cells of two bodies; never below `known` (k,),
    what is proved of the cells that they are parts of.

    hull (n, k, 3), grown (n,), ball (n, 4) : as in `body.CellStore`. A bound above `enough` need not be sharp.
    """
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        d, largest = 0.0, 0.0
        for c in range(3):
            x = ball_a[a, c] - ball_b[b, c]
            largest = max(largest, abs(ball_a[a, c]), abs(ball_b[b, c]))
            d += x * x
        lower[k] = max(known[k], np.sqrt(d) * (1.0 - 1e-15) - ball_a[a, 3] - ball_b[b, 3] - 1e-14 * largest)
        if lower[k] <= enough:
            sag = grown_a[a] + grown_b[b]
            lower[k] = max(lower[k], hull_gap(hull_a[a], hull_b[b], sag, enough + sag) - sag)
