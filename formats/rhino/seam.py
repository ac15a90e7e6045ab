"""Periodic surfaces with multiple knots at their seam: openNURBS' form of them, and back.

`spline.surface` unrolls a periodic direction over [knots[p], knots[n]], both the last copies of a knot. openNURBS wants
the end to be the first copy of its knot. Where the seam's knot is multiple, the last control points, which repeat the
first, are left out; where that was done must be told to the reader, who puts them back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...spline.surface import BSplineSurface

Array = NDArray[np.float64]


def without_copies(surface: BSplineSurface) -> tuple[Array, tuple[Array, Array]]:
    """(points, knots): the control points (r, s, 3), or (r, s, 4) with the weights, and the knots of both directions.

    Periodic directions end at the first copy of their last knot.
    """
    points = surface.control_points
    if surface.weights is not None:
        points = np.concatenate([points, surface.weights[..., None]], axis=2)
    r, s = surface.shape
    left_u, left_v = copies(surface)
    r, s = r - left_u, s - left_v
    knots_u, knots_v = surface.knots_u, surface.knots_v
    return points[:r, :s], (knots_u[: len(knots_u) - left_u], knots_v[: len(knots_v) - left_v])


def copies(surface: BSplineSurface) -> tuple[int, int]:
    """How many control points of each direction `without_copies` leaves out."""
    found = [
        int((knots[:count] == knots[count]).sum()) if periodic else 0
        for knots, count, periodic in (
            (surface.knots_u, surface.shape[0], surface.periodic_u),
            (surface.knots_v, surface.shape[1], surface.periodic_v),
        )
    ]
    return found[0], found[1]


def with_copies(points: Array, knots: Array, degree: int) -> tuple[Array, Array]:
    """The control points (n, ...) and knots (n + degree + 1,) of a periodic direction with the copies put back.

    As they are when they are not what `without_copies` leaves: points or knots that do not repeat.
    """
    count = len(points)
    low, high = knots[degree], knots[count]
    left_out = int((knots[1:degree] == low).sum())
    turn = count + left_out - degree
    if turn < 1 or degree < 1:
        return points, knots
    rows = np.concatenate([points, points[count - turn : count - turn + left_out]])
    inner = knots[1:-1]
    inner = np.concatenate([inner, inner[len(inner) - turn : len(inner) - turn + left_out] + (high - low)])
    whole = np.concatenate([[inner[turn - 1] - (high - low)], inner, [inner[len(inner) - turn] + (high - low)]])
    steps = np.diff(whole)
    repeats = np.abs(steps[turn:] - steps[: len(steps) - turn]).max(initial=0.0) <= 1e-9 * (high - low)
    if not repeats or not np.array_equal(rows[:degree], rows[turn : turn + degree]):
        return points, knots
    return rows, whole
