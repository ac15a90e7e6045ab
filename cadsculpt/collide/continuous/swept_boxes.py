"""Broad phase of continuous collision: boxes whose corners move in straight lines, and when two of them first meet.

The box of a net holds the surface; the boxes at both ends of a stretch of time, run at a constant rate, hold it between
them, because control points move in straight lines. Along each axis the gap of two such boxes is linear in time, so that
the time at which they overlap is an interval, as for a ray and a box (Kay and Kajiya, SIGGRAPH 1986).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...jit import njit

Array = NDArray[np.float64]


class Span(NamedTuple):
    """The stretch of time [low, high] over which a side's motion from `first` to `last` runs."""

    low: float
    high: float


@njit
def overlap(
    a0: Array, a1: Array, at: Span, b0: Array, b1: Array, bt: Span, i: int, j: int, pad: float, s0: float, s1: float
) -> float:
    """When, from s0 to s1, the moving boxes a[i] and b[j] (rows of low and high corner) first come within pad;
    infinite if never."""
    enter, leave = s0, s1
    fa0, fa1 = (s0 - at.low) / (at.high - at.low), (s1 - at.low) / (at.high - at.low)
    fb0, fb1 = (s0 - bt.low) / (bt.high - bt.low), (s1 - bt.low) / (bt.high - bt.low)
    for c in range(3):
        for way in range(2):
            # where the low side of one lies beyond the high side of the other
            p, q = (c, 3 + c) if way == 0 else (3 + c, c)
            x0, x1 = (1.0 - fa0) * a0[i, p] + fa0 * a1[i, p], (1.0 - fa1) * a0[i, p] + fa1 * a1[i, p]
            y0, y1 = (1.0 - fb0) * b0[j, q] + fb0 * b1[j, q], (1.0 - fb1) * b0[j, q] + fb1 * b1[j, q]
            g0, g1 = (y0 - x0, y1 - x1) if way == 0 else (x0 - y0, x1 - y1)
            g0, g1 = g0 + pad, g1 + pad
            if g0 < 0.0 and g1 < 0.0:
                return np.inf
            if g0 < 0.0:
                enter = max(enter, s0 + (s1 - s0) * (g0 / (g0 - g1)))
            elif g1 < 0.0:
                leave = min(leave, s0 + (s1 - s0) * (g0 / (g0 - g1)))
    # the ends are rounded: what just touches counts
    return enter if enter <= leave + 1e-12 * (s1 - s0) else np.inf


@njit
def first_overlaps(
    a0: Array, a1: Array, at: Span, b0: Array, b1: Array, bt: Span, pad: float, s0: float, s1: float
) -> Array:
    """`overlap` of every box of a (n, 6) with every one of b (m, 6): (n, m)."""
    out = np.empty((len(a0), len(b0)))
    for i in range(len(a0)):
        for j in range(len(b0)):
            t = overlap(a0, a1, at, b0, b1, bt, i, j, pad, s0, s1)
            out[i, j] = max(s0, t - 1e-12 * (s1 - s0))
    return out


@njit
def ball_overlap(
    a0: Array, a1: Array, origin: Array, displacement: Array, radius: float, pad: float, s0: float
) -> float:
    """When, from s0 to 1, any box of a first comes within pad of the box around a ball that moves from origin at 0."""
    b0, b1 = np.empty((1, 6)), np.empty((1, 6))
    for c in range(3):
        b0[0, c], b0[0, 3 + c] = origin[c] - radius, origin[c] + radius
        b1[0, c], b1[0, 3 + c] = b0[0, c] + displacement[c], b0[0, 3 + c] + displacement[c]
    whole, first = Span(0.0, 1.0), np.inf
    for i in range(len(a0)):
        first = min(first, overlap(a0, a1, whole, b0, b1, whole, i, 0, pad, s0, 1.0))
    return first
