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
from .joins import Piece
from .nurbs import Nurbs

Array = NDArray[np.float64]

NOT_ISO, SIDES = 0, ((3, 5), (4, 6))
"""ISO of a curve along no parameter line; along the low and the high side of u, and of v. 1 and 2: u or v held inside."""

ZERO = 2.0**-32
"""ON_ZERO_TOLERANCE"""


def iso_of(pieces: Sequence[Piece], surface: BSplineSurface) -> int:
    """The ISO of a clamped 2D curve with the pieces before and after it (`joined_chunk`)."""
    domain = surface.domain
    if any(not isinstance(piece, Nurbs) and len(piece) > 2 for piece in pieces):
        return NOT_ISO
    points = np.concatenate([_net(piece) for piece in pieces])
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
    return found if _linear(pieces, tolerance) else NOT_ISO


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


def _linear(pieces: Sequence[Piece], tolerance: float) -> bool:
    """openNURBS' IsLinear: of the control points, and for more than one piece of places along the whole."""
    curves = [piece for piece in pieces if isinstance(piece, Nurbs)]
    if not all(_straight(curve.control_points(), tolerance) for curve in curves):
        return False
    if len(pieces) == 1:
        return True
    steps = 2 * max(curve.degrees[0] for curve in curves) + 1
    share = np.arange(steps) / steps
    found: list[Array] = []
    for piece in pieces:
        if isinstance(piece, Nurbs):
            knots = breakpoints(piece.padded_knots(0), piece.degrees[0])
            t = np.concatenate([low + share * (high - low) for low, high in zip(knots[:-1], knots[1:], strict=True)])
            found.append(curve_points(piece, t))
        else:
            found.append(piece[0] + share[:, None] * (piece[1] - piece[0]))
    places = np.concatenate(found)[1:]
    start, end = _net(pieces[0])[0], _net(pieces[-1])[-1]
    along = end - start
    if float(np.hypot(*along)) <= (tolerance or ZERO):
        return False
    t = (places - start) @ along / (along @ along)
    away = np.hypot(*(places - start - t[:, None] * along).T)
    rising = (np.diff(np.concatenate([[0.0], t])) >= 0.0).all()
    return bool(rising and t.max() <= 1.0 + 2.0**-26 and away.max() <= (tolerance or ZERO))


def _net(piece: Piece) -> Array:
    """(n, 2) control points."""
    return piece.control_points() if isinstance(piece, Nurbs) else piece


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
