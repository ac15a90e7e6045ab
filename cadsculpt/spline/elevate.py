"""Degree elevation: the very same surface over a net of higher degree, that can bend more smoothly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError
from .matrices import design_matrix
from .surface import BSplineSurface

Array = NDArray[np.float64]


def elevated(surface: BSplineSurface, degree_u: int, degree_v: int) -> BSplineSurface:
    """The same surface, to rounding, with at least these degrees; parametrisation and smoothness stay.

    Every knot repeats as often more as the degree rises (Piegl and Tiller, section 5.5); the control points follow from the
    surface's values at the new net's Greville abscissae. Raises GeometryError for a periodic direction.
    """
    for axis, degree in ((0, degree_u), (1, degree_v)):
        if (surface.degree_u, surface.degree_v)[axis] < degree:
            surface = _along(surface, axis, degree)
    return surface


def _along(surface: BSplineSurface, axis: int, degree: int) -> BSplineSurface:
    if (surface.periodic_u, surface.periodic_v)[axis]:
        raise GeometryError("a periodic direction keeps its degree", where=surface.name or "surface")
    old = (surface.degree_u, surface.degree_v)[axis]
    knots = (surface.knots_u, surface.knots_v)[axis]
    low, high = surface.domain[axis]
    values, times = np.unique(knots[(knots > low) & (knots < high)], return_counts=True)
    ends = np.full(degree + 1, low), np.full(degree + 1, high)
    new = np.concatenate([ends[0], np.repeat(values, times + degree - old), ends[1]])
    greville = np.array([new[i + 1 : i + degree + 1].mean() for i in range(len(new) - degree - 1)])
    weights = np.ones(surface.shape) if surface.weights is None else surface.weights
    net = np.concatenate([surface.control_points * weights[..., None], weights[..., None]], axis=2)
    at = np.tensordot(design_matrix(knots, old, greville), np.moveaxis(net, axis, 0), axes=1)
    count = len(greville)
    solved: Array = np.linalg.solve(design_matrix(new, degree, greville), at.reshape(count, -1)).reshape(at.shape)
    solved[0], solved[-1] = at[0], at[-1]
    raised: Array = np.moveaxis(solved, 0, axis)
    w: Array | None = None if surface.weights is None else raised[..., 3]
    points: Array = raised[..., :3] if w is None else raised[..., :3] / raised[..., 3:]
    changed = replace(surface, control_points=points, weights=w)
    return (
        replace(changed, knots_u=new, degree_u=degree) if axis == 0 else replace(changed, knots_v=new, degree_v=degree)
    )
