"""Knot insertion: a finer net for the very same surface (Boehm 1980; Piegl and Tiller, algorithm A5.3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import GeometryError
from .surface import BSplineSurface

Array = NDArray[np.float64]

SAME_KNOT = 1e-9
"""Knots this near, as a part of the domain, are one knot: what passing through another face's parameters costs."""


def insert_knots(surface: BSplineSurface, knots_u: ArrayLike = (), knots_v: ArrayLike = ()) -> BSplineSurface:
    """The same surface with these knots added; parametrisation and shape stay, to rounding.

    A knot may be given several times, or exist already: multiplicities add up. Control points whose support does not
    meet a new knot keep their bits. Raises GeometryError for a knot outside the domain, on the seam of a periodic
    direction, or one that would repeat more than `degree` times.
    """
    result = surface
    for axis, new in ((0, knots_u), (1, knots_v)):
        values = np.sort(np.atleast_1d(np.asarray(new, dtype=np.float64)))
        if values.size:
            result = _insert_along(result, axis, values)
    return result


def missing_knots(surface: BSplineSurface, other: BSplineSurface) -> tuple[Array, Array]:
    """The knots (u, v), with multiplicity, that `other` has inside the domain and `surface` lacks."""
    found = []
    for low_high, have, want in (
        (surface.domain[0], surface.knots_u, other.knots_u),
        (surface.domain[1], surface.knots_v, other.knots_v),
    ):
        values, counts = np.unique(want[(want > low_high[0]) & (want < low_high[1])], return_counts=True)
        lacking = counts - np.array([np.count_nonzero(have == x) for x in values], dtype=np.int64)
        found.append(np.repeat(values, np.maximum(lacking, 0)))
    return found[0], found[1]


def _insert_along(surface: BSplineSurface, axis: int, values: Array) -> BSplineSurface:
    label = "uv"[axis]
    degree = (surface.degree_u, surface.degree_v)[axis]
    knots = (surface.knots_u, surface.knots_v)[axis]
    periodic = (surface.periodic_u, surface.periodic_v)[axis]
    low, high = surface.domain[axis]
    if values[0] <= low or values[-1] >= high:
        bad = values[0] if values[0] <= low else values[-1]
        raise GeometryError(f"cannot insert the knot {bad:g}", mend=f"{label} runs inside ({low:g}, {high:g})")
    for x, count in zip(*np.unique(values, return_counts=True), strict=True):
        if count + np.count_nonzero(knots == x) > degree:
            raise GeometryError(f"the knot {x:g} in {label} would repeat more than {degree} times")

    points = np.moveaxis(surface.control_points, axis, 0)
    weights = None if surface.weights is None else np.moveaxis(surface.weights, axis, 0)
    if periodic:
        points, weights, knots = _insert_periodic(points, weights, knots, degree, values, high - low)
    else:
        points, weights, knots = _insert_open(points, weights, knots, degree, values)
    changed = replace(
        surface,
        control_points=np.moveaxis(points, 0, axis),
        weights=None if weights is None else np.moveaxis(weights, 0, axis),
    )
    return replace(changed, knots_u=knots) if axis == 0 else replace(changed, knots_v=knots)


def _insert_open(
    points: Array, weights: Array | None, knots: Array, degree: int, values: Array
) -> tuple[Array, Array | None, Array]:
    """Boehm's algorithm along axis 0, one knot after the other; rows outside each knot's reach are copied."""
    for t in values:
        span = int(np.searchsorted(knots, t, side="right")) - 1
        first, last = span - degree + 1, span
        i = np.arange(first, last + 1)
        alpha = (t - knots[i]) / (knots[i + degree] - knots[i])
        a = alpha.reshape(-1, *([1] * (points.ndim - 1)))
        upper, lower = points[i], points[i - 1]
        if weights is None:
            middle = lower + a * (upper - lower)
            new_weights = None
        else:
            w_upper, w_lower = a[..., 0] * weights[i], (1.0 - a[..., 0]) * weights[i - 1]
            w = w_upper + w_lower
            middle = (w_upper[..., None] * upper + w_lower[..., None] * lower) / w[..., None]
            new_weights = np.concatenate([weights[:first], w, weights[last:]])
        points = np.concatenate([points[:first], middle, points[last:]])
        weights = new_weights
        knots = np.concatenate([knots[: span + 1], [t], knots[span + 1 :]])
    return points, weights, knots


def _insert_periodic(
    points: Array, weights: Array | None, knots: Array, degree: int, values: Array, period: float
) -> tuple[Array, Array | None, Array]:
    """Unroll three periods, insert every image of the new knots, and cut the middle period out again."""
    unique = len(points) - degree
    laps = 3
    rows = np.arange(laps * unique + degree) % unique
    index = np.arange(laps * unique + 2 * degree + 1)
    long_knots = knots[index % unique] + period * (index // unique)
    long_points, long_weights = points[rows], None if weights is None else weights[rows]
    images = np.concatenate([values + lap * period for lap in range(laps)])
    images = images[(images > long_knots[degree]) & (images < long_knots[-degree - 1])]
    long_points, long_weights, long_knots = _insert_open(long_points, long_weights, long_knots, degree, images)
    grown = unique + len(values)
    start = grown  # one lap further on: every lap has taken the same number of new knots
    shift = long_knots[start + degree] - knots[degree]
    new_knots = long_knots[start : start + grown + 2 * degree + 1] - shift
    # the knots that were there keep their bits
    inner = np.sort(np.concatenate([knots[degree : unique + degree + 1], values]))
    new_knots[degree : grown + degree + 1] = inner
    left = inner[-degree - 1 : -1] - period
    right = inner[1 : degree + 1] + period
    if grown >= degree:
        new_knots[:degree], new_knots[-degree:] = left, right
    keep = np.arange(grown + degree) % grown + start
    return long_points[keep], None if long_weights is None else long_weights[keep], new_knots
