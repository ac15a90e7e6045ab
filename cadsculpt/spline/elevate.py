"""Degree elevation: the very same surface over a net of higher degree, that can bend more smoothly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .matrices import breakpoints, design_matrix
from .surface import BSplineSurface

Array = NDArray[np.float64]


def elevated(surface: BSplineSurface, degree_u: int, degree_v: int) -> BSplineSurface:
    """The same surface, to rounding, with at least these degrees; parametrisation and smoothness stay.

    Every knot repeats as often more as the degree rises (Piegl and Tiller, section 5.5); the control points follow from the
    surface's values.
    """
    for axis, degree in ((0, degree_u), (1, degree_v)):
        if (surface.degree_u, surface.degree_v)[axis] < degree:
            surface = _along(surface, axis, degree)
    return surface


def _along(surface: BSplineSurface, axis: int, degree: int) -> BSplineSurface:
    old = (surface.degree_u, surface.degree_v)[axis]
    knots = (surface.knots_u, surface.knots_v)[axis]
    periodic = (surface.periodic_u, surface.periodic_v)[axis]
    new = _periodic_knots(knots, old, degree) if periodic else _open_knots(knots, old, degree)
    count = len(new) - degree - 1
    low, high = surface.domain[axis]
    # as many places in each span as a polynomial has coefficients
    borders = breakpoints(knots, old)
    share = (np.arange(degree + 1) + 0.5) / (degree + 1)
    t = (borders[:-1, None] + np.diff(borders)[:, None] * share).ravel()
    if not periodic:
        t = np.concatenate([[low], t, [high]])
    weights = np.ones(surface.shape) if surface.weights is None else surface.weights
    net = np.concatenate([surface.control_points * weights[..., None], weights[..., None]], axis=2)
    net = np.moveaxis(net, axis, 0)
    values = np.tensordot(design_matrix(knots, old, t), net, axes=1)
    row = np.arange(count) % (count - degree) if periodic else np.arange(count)
    basis = np.zeros((len(t), int(row.max()) + 1))
    np.add.at(basis.T, row, design_matrix(new, degree, t).T)
    solved = np.asarray(np.linalg.lstsq(basis, values.reshape(len(t), -1), rcond=None)[0], dtype=np.float64)
    rows: Array = solved.reshape(-1, *values.shape[1:])
    if not periodic and knots[0] == knots[old] and knots[-1] == knots[-old - 1]:
        rows[0], rows[-1] = net[0], net[-1]
    raised: Array = np.moveaxis(rows[row], 0, axis)
    w: Array | None = None if surface.weights is None else raised[..., 3]
    points: Array = raised[..., :3] if w is None else raised[..., :3] / raised[..., 3:]
    changed = replace(surface, control_points=points, weights=w)
    return (
        replace(changed, knots_u=new, degree_u=degree) if axis == 0 else replace(changed, knots_v=new, degree_v=degree)
    )


def _open_knots(knots: Array, old: int, degree: int) -> Array:
    low, high = knots[old], knots[-old - 1]
    values, times = np.unique(knots[(knots > low) & (knots < high)], return_counts=True)
    return np.concatenate(
        [np.full(degree + 1, low), np.repeat(values, times + degree - old), np.full(degree + 1, high)]
    )


def _periodic_knots(knots: Array, old: int, degree: int) -> Array:
    """The knots of an unrolled periodic net: one period's, repeated to both sides; the domain starts at the last of those that
    are equal to its start, as it ends at the first of those equal to its end."""
    low, high = knots[old], knots[-old - 1]
    values, times = np.unique(knots[(knots >= low) & (knots < high)], return_counts=True)
    times[0] = np.count_nonzero(knots == low)
    once = np.repeat(values, times + degree - old)
    period = high - low
    laps = np.concatenate([once + lap * period for lap in range(-degree, degree + 2)])
    laps[np.abs(laps - high) <= 1e-12 * period] = high
    start = int(np.searchsorted(laps, low, side="right")) - 1
    return laps[start - degree : start + len(once) + degree + 1]
