"""Piecewise quintic Hermite B-splines through curves that have no exact spline form.

Used where a curve must keep its parameter: the image of a trim curve on a surface, a trim curve carried to another
parametrisation. Values and two derivatives are met at every break, so the spline is C2 inside each smooth piece and its
error falls with the sixth power of the step (Piegl and Tiller, section 9.3 for the Bezier form of Hermite data).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DEGREE = 5
MAX_PIECES = 2000
_CHECKS = np.array([0.06, 0.2, 0.35, 0.5, 0.65, 0.8, 0.94])
"""Where, inside a piece, the spline is compared with the curve."""

Curve = Callable[[Array, int], Array]
"""curve(t (n,), side) -> (n, 3, d): value, first and second derivative, taken from the left (-1) or right (+1) of a break.
With side 0 only the values are asked for."""


def _bezier(left: Array, right: Array, step: Array) -> Array:
    """(n, 6, d) Bezier points of the quintics with value and two derivatives `left` and `right` (n, 3, d) over `step`."""
    h = step[:, None]
    p, dp, ddp = left[:, 0], left[:, 1] * h, left[:, 2] * h * h
    q, dq, ddq = right[:, 0], right[:, 1] * h, right[:, 2] * h * h
    return np.stack(
        [p, p + dp / 5, p + 2 * dp / 5 + ddp / 20, q - 2 * dq / 5 + ddq / 20, q - dq / 5, q],
        axis=1,
    )


def _bernstein(t: Array) -> Array:
    """(n, 6) Bernstein polynomials of degree 5."""
    s = 1.0 - t
    return np.stack([s**5, 5 * t * s**4, 10 * t**2 * s**3, 10 * t**3 * s**2, 5 * t**4 * s, t**5], axis=1)


def fit_curve(curve: Curve, breaks: Array, tolerance: float) -> tuple[Array, Array, float]:
    """A C0-joined, piecewise C2 quintic B-spline within `tolerance` of `curve`, at the same parameters.

    breaks (n,) ascending: both ends and the places where the curve is not C2. Pieces are halved until the spline is near
    enough at seven places inside each, or MAX_PIECES are reached.

    Returns (control points (m, d), knots (m + 6,), largest distance found).
    """
    start, stop = np.asarray(breaks[:-1], dtype=np.float64), np.asarray(breaks[1:], dtype=np.float64)
    keep = stop > start
    start, stop = start[keep], stop[keep]
    blend = _bernstein(_CHECKS)
    done: list[tuple[float, float, Array]] = []
    worst = 0.0
    while len(start):
        step = stop - start
        pieces = _bezier(curve(start, 1), curve(stop, -1), step)
        places = start[:, None] + step[:, None] * _CHECKS
        truth = curve(places.ravel(), 0)[:, 0].reshape(len(start), len(_CHECKS), -1)
        error = np.linalg.norm(np.einsum("cb,nbd->ncd", blend, pieces) - truth, axis=2).max(axis=1)
        fine = error <= tolerance
        if len(done) + 2 * len(start) > MAX_PIECES or not (step > 1e-9 * (breaks[-1] - breaks[0])).all():
            fine[:] = True
        worst = max(worst, float(error[fine].max(initial=0.0)))
        done += [(float(a), float(b), piece) for a, b, piece in zip(start[fine], stop[fine], pieces[fine], strict=True)]
        a, b = start[~fine], stop[~fine]
        middle = 0.5 * (a + b)
        start, stop = np.concatenate([a, middle]), np.concatenate([middle, b])
    done.sort(key=lambda piece: piece[0])
    borders = np.array([piece[0] for piece in done] + [done[-1][1]])
    points = np.concatenate([piece[2][: (None if i == len(done) - 1 else DEGREE)] for i, piece in enumerate(done)])
    knots = np.concatenate([borders[:1], np.repeat(borders, DEGREE), borders[-1:]])
    return points, knots, worst
