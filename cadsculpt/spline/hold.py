"""What of a surface must stay where it is: curves, with their tangent planes if asked, and rectangles of parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .matrices import breakpoints, design_matrix
from .surface import BSplineSurface

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Span = tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Hold:
    """curves : polylines uv (n, 2) along which the surface stays. smooth : some of them, along which its tangent plane stays
    as well. boxes : rectangles (u range, v range) inside which it stays; None is the whole range."""

    curves: tuple[Array, ...] = ()
    smooth: tuple[Array, ...] = ()
    boxes: tuple[tuple[Span | None, Span | None], ...] = ()

    def control_points(self, surface: BSplineSurface) -> Mask:
        """The control points (r, s) of a net that must not move."""
        held = np.zeros(surface.shape, dtype=np.bool_)
        for uv in self.curves:
            held |= _meeting(surface, dense(uv, surface), tangents=False)
        for uv in self.smooth:
            held |= _meeting(surface, dense(uv, surface), tangents=True)
        for ranges in self.boxes:
            rows, columns = (_reaches(surface, axis, ranges[axis]) for axis in (0, 1))
            held |= rows[:, None] & columns[None, :]
        return held

    def inside(self, u: Array, v: Array) -> Mask:
        """The grid points (u[i], v[j]) that lie in one of the boxes."""
        result = np.zeros((len(u), len(v)), dtype=np.bool_)
        for ranges in self.boxes:
            result |= in_range(u, ranges[0])[:, None] & in_range(v, ranges[1])[None, :]
        return result


def in_range(t: Array, limits: Span | None) -> Mask:
    """Which parameters lie between the limits, both included."""
    return np.ones(len(t), dtype=np.bool_) if limits is None else (t >= limits[0]) & (t <= limits[1])


def dense(uv: Array, surface: BSplineSurface) -> Array:
    """The polyline uv with steps so short that no knot span is jumped over."""
    spans = [
        np.diff(breakpoints(knots, degree)).min()
        for knots, degree in ((surface.knots_u, surface.degree_u), (surface.knots_v, surface.degree_v))
    ]
    steps = np.abs(np.diff(uv, axis=0)) / np.array(spans)
    pieces = np.clip(np.ceil(4.0 * steps.max(axis=1)), 1, 1000).astype(np.int64)
    parts = [a + (b - a) * (np.arange(n) / n)[:, None] for a, b, n in zip(uv[:-1], uv[1:], pieces, strict=True)]
    return np.concatenate([*parts, uv[-1:]])


def _reaches(surface: BSplineSurface, axis: int, limits: Span | None) -> Mask:
    """Rows of control points whose support meets the inside of a range."""
    count = surface.shape[axis]
    if limits is None:
        return np.ones(count, dtype=np.bool_)
    knots = (surface.knots_u, surface.knots_v)[axis]
    degree = (surface.degree_u, surface.degree_v)[axis]
    return (knots[:count] < limits[1]) & (knots[degree + 1 : degree + 1 + count] > limits[0])


def _meeting(surface: BSplineSurface, uv: Array, *, tangents: bool, clearance: float = 1e-13) -> Mask:
    """Control points that the surface depends on somewhere along uv (n, 2); with tangents, or a first derivative of it."""
    parts = []
    for axis, (knots, degree) in enumerate(((surface.knots_u, surface.degree_u), (surface.knots_v, surface.degree_v))):
        low, high = surface.domain[axis]
        t = np.clip(uv[:, axis], low, high)
        jets = [design_matrix(knots, degree, t, k) * (high - low) ** k for k in range(2 if tangents else 1)]
        parts.append([(np.abs(jet) > clearance).astype(np.float64) for jet in jets])
    held = parts[0][0].T @ parts[1][0] > 0.0
    if tangents:
        held |= (parts[0][1].T @ parts[1][0] > 0.0) | (parts[0][0].T @ parts[1][1] > 0.0)
    return held
