"""Which parameter line of a surface openNURBS takes a trim curve to run along (ON_Surface::ISO).

openNURBS computes it when it checks a Brep, and finds one invalid that says something else: so its rule is followed to the
letter. After the public openNURBS sources (opennurbs_surface.cpp, opennurbs_nurbscurve.cpp, opennurbs_curve.cpp).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...spline.matrices import breakpoints
from ...spline.surface import BSplineSurface
from .geometry import curve_points
from .nurbs import Nurbs

Array = NDArray[np.float64]

NOT_ISO, SIDES = 0, ((3, 5), (4, 6))
"""ISO of a curve along no parameter line; along the low and the high side of u, and of v. 1 and 2: u or v held inside."""

ZERO = 2.0**-32
"""ON_ZERO_TOLERANCE"""


def iso_of(curve: Nurbs, joins: tuple[Array | None, Array | None], surface: BSplineSurface) -> int:
    """The ISO of a clamped 2D curve with what joins it to its neighbours (`DrawnTrim`)."""
    domain = surface.domain
    control = curve.control_points()
    if any(join is not None and len(join) > 2 for join in joins):
        return NOT_ISO
    points = np.concatenate([control, *(join for join in joins if join is not None)])
    before, after = (None if joins[0] is None else joins[0][0], None if joins[1] is None else joins[1][1])
    low, high = points.min(axis=0), points.max(axis=0)
    width, size = high - low, np.array([b - a for a, b in domain])
    if not (width <= size / 32.0).any():
        return NOT_ISO
    axis = 0 if width[0] * size[1] <= width[1] * size[0] else 1
    knots = (surface.knots_u, surface.knots_v)[axis]
    found = _held(
        axis, float(low[axis]), float(high[axis]), knots[(knots >= domain[axis][0]) & (knots <= domain[axis][1])]
    )
    if not found:
        return NOT_ISO
    tolerance = float(width[axis])
    if tolerance < ZERO and width[1 - axis] >= ZERO * 1024.0:
        tolerance = ZERO
    return found if _linear(curve, control, before, after, tolerance) else NOT_ISO


def _held(axis: int, low: float, high: float, knots: Array) -> int:
    """The ISO of a box that reaches from `low` to `high` in one direction, whose domain these knots divide."""
    first, last = float(knots[0]), float(knots[-1])
    near = (last - first) / 32.0
    second, before_last = float(knots[knots > first][0]), float(knots[knots < last][-1])

    def within(place: float) -> bool:
        place = min(max(place, first), last)
        # in the first span and in the last openNURBS' tolerance is that of the span
        start, end = (first, second) if place < second else (before_last if place > before_last else first, last)
        slack = (end - start) * 8.0 * 2.0**-26 + (abs(start) + abs(end)) * 2.0**-52
        return (place - slack <= low if axis == 0 else place - slack < low) and high <= place + slack

    if high <= first + near:
        if within(first):
            return SIDES[axis][0]
    elif low >= last - near and within(last):
        return SIDES[axis][1]
    return axis + 1 if within(0.5 * (low + high)) else NOT_ISO


def _linear(curve: Nurbs, control: Array, before: Array | None, after: Array | None, tolerance: float) -> bool:
    """openNURBS' IsLinear: of the control points, and with lines joined to the curve of places along the whole."""
    if not _straight(control, tolerance):
        return False
    if before is None and after is None:
        return True
    ends = control[[0, -1]]
    steps = 2 * curve.degrees[0] + 1
    knots = breakpoints(curve.padded_knots(0), curve.degrees[0])
    pieces: list[Array] = []
    if before is not None:
        pieces.append(before + np.linspace(0.0, 1.0, steps + 1)[:-1, None] * (ends[0] - before))
    share = np.arange(steps) / steps
    t = np.concatenate([low + share * (high - low) for low, high in zip(knots[:-1], knots[1:], strict=True)])
    pieces.append(curve_points(curve, t))
    if after is not None:
        pieces.append(ends[1] + np.linspace(0.0, 1.0, steps + 1)[:-1, None] * (after - ends[1]))
    places = np.concatenate(pieces)[1:]
    start, end = ends[0] if before is None else before, ends[1] if after is None else after
    along = end - start
    if float(np.hypot(*along)) <= (tolerance or ZERO):
        return False
    t = (places - start) @ along / (along @ along)
    away = np.hypot(*(places - start - t[:, None] * along).T)
    rising = (np.diff(np.concatenate([[0.0], t])) >= 0.0).all()
    return bool(rising and t.max() <= 1.0 + 2.0**-26 and away.max() <= (tolerance or ZERO))


def _straight(control: Array, tolerance: float) -> bool:
    """ON_NurbsCurve::IsLinear of clamped control points (n, 2)."""
    start, end = control[0], control[-1]
    along = end - start
    square = float(along @ along)
    if not square > 0.0:
        return False
    inner: Sequence[Array] = list(control[1:-1])
    bound = tolerance if tolerance > 0.0 else ZERO
    reached = 0.0
    for p in inner:
        near_start = (p - start) @ (p - start) <= (p - end) @ (p - end)
        t = float((p - start) @ along) / square if near_start else 1.0 + float((p - end) @ along) / square
        if (near_start and t < -0.01) or (not near_start and t > 1.01):
            return False
        q = (1.0 - t) * start + t * end
        if np.hypot(*(p - q)) > bound:
            return False
        if t > reached and reached < 1.0:
            reached = min(t, 1.0)
        if not reached <= t <= 1.0 and np.hypot(*(q - (start + reached * along))) > bound:
            return False
    return True
