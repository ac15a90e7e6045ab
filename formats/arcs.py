"""Circular arcs as rational quadratic B-splines (Piegl and Tiller, section 7.3), and what becomes of the angle.

An arc over [a, b] has a knot every quarter turn at most, at the angle itself, so that angle and spline parameter share
their range; between the knots they differ slightly, and `ArcParameter` carries one to the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, pi

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FULL_TURN = 2.0 * pi


@dataclass(frozen=True, slots=True, eq=False)
class ArcParameter:
    """The spline parameter of a point at an angle: the borders of the arc's pieces stay, the inside follows tan(angle / 2).

    angles (n + 1,) ascending, evenly spaced: the distinct knots.
    """

    angles: Array

    def __call__(self, angle: Array) -> Array:
        """(n, 3): parameter, and its first and second derivative by the angle."""
        piece = np.clip(np.searchsorted(self.angles, angle, side="right") - 1, 0, len(self.angles) - 2)
        a, b = self.angles[piece], self.angles[piece + 1]
        half = 0.25 * (b - a)
        x = 0.5 * (angle - 0.5 * (a + b))
        rate = (b - a) / (4.0 * np.tan(half))
        tangent = np.tan(x)
        square = 1.0 + tangent * tangent
        parameter = 0.5 * (a + b) + 2.0 * rate * tangent
        parameter = np.where(angle == a, a, np.where(angle == b, b, parameter))
        return np.stack([parameter, rate * square, rate * square * tangent], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class UnitArc:
    """A unit circle's arc: control points (n, 2) as (cosine, sine), weights (n,), knots (n + 3,), degree 2."""

    points: Array
    weights: Array
    knots: Array
    parameter: ArcParameter


def unit_arc(start: float, stop: float) -> UnitArc:
    """The arc from angle `start` to angle `stop` > `start`, at most one turn; a full turn closes bit for bit."""
    pieces = max(1, ceil((stop - start) / (0.5 * pi) - 1e-9))
    angles = np.linspace(start, stop, pieces + 1)
    middle = 0.5 * (angles[:-1] + angles[1:])
    shrink = np.cos(0.5 * (stop - start) / pieces)
    points = np.empty((2 * pieces + 1, 2))
    points[::2] = np.column_stack([np.cos(angles), np.sin(angles)])
    points[1::2] = np.column_stack([np.cos(middle), np.sin(middle)]) / shrink
    points[np.abs(points) < 1e-15] = 0.0
    if abs(stop - start - FULL_TURN) < 1e-12:
        points[-1] = points[0]
    weights = np.ones(2 * pieces + 1)
    weights[1::2] = shrink
    knots = np.concatenate([[start], np.repeat(angles, 2), [stop]])
    return UnitArc(points, weights, knots, ArcParameter(angles))
