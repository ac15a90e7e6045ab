"""Area of a trimmed B-spline surface.

By Green's theorem the area of a face is a line integral around its loops, the integral of G dv with
G(u, v) = integral of |S_u x S_v| du. The area element is expanded in Legendre polynomials on every cell of the knot grid
once; G then costs a few products at any point of a loop. Exact to the degree of the expansion: about 1e-7 of the area on
the parts that CAD systems make.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from ..spline.matrices import breakpoints, design_matrix
from ..spline.surface import BSplineSurface, TrimCurve

Array = NDArray[np.float64]

ORDER = 10
"""Gauss-Legendre points along one side of a cell, and along one piece of a loop."""

FEWEST_CELLS = 4
"""Cells along a direction that has fewer knot spans."""


@dataclass(frozen=True, slots=True, eq=False)
class _AreaElement:
    """|S_u x S_v| on the cells (m, n) between u (m + 1,) and v (n + 1,) as Legendre coefficients (m, n, ORDER, ORDER).

    before (m, n, ORDER): its integral over u from the domain's start to each cell, as Legendre coefficients in v.
    """

    u: Array
    v: Array
    coefficients: Array
    before: Array

    def primitive(self, u: Array, v: Array) -> Array:
        """(k,): the integral of the area element over u, from the domain's start to u at fixed v."""
        i, x, half = _local(self.u, u)
        j, y, _ = _local(self.v, v)
        up_to = (_primitives(x) * half[:, None])[:, :, None] * self.coefficients[i, j]
        values: Array = ((self.before[i, j] + up_to.sum(axis=1)) * legendre.legvander(y, ORDER - 1)).sum(axis=1)
        return values


def _local(borders: Array, t: Array) -> tuple[NDArray[np.int64], Array, Array]:
    """Cell, place in it on [-1, 1], and half its width."""
    cell = np.clip(np.searchsorted(borders, t, side="right") - 1, 0, len(borders) - 2)
    half = 0.5 * (borders[cell + 1] - borders[cell])
    return cell, np.clip((t - borders[cell]) / half - 1.0, -1.0, 1.0), half


def _primitives(x: Array) -> Array:
    """(k, ORDER): integrals of the Legendre polynomials from -1 to x."""
    p = legendre.legvander(x, ORDER)
    degree = np.arange(1, ORDER)
    return np.column_stack([x + 1.0, (p[:, 2:] - p[:, :-2]) / (2 * degree + 1)])


def _cells(knots: Array, degree: int) -> Array:
    """Borders of the knot spans, each cut so that there are cells enough."""
    borders = breakpoints(knots, degree)
    pieces = -(-FEWEST_CELLS // (len(borders) - 1))
    cuts = borders[:-1, None] + np.diff(borders)[:, None] * np.arange(pieces) / pieces
    return np.append(cuts.ravel(), borders[-1])


def _area_element(surface: BSplineSurface) -> _AreaElement:
    nodes, weights = legendre.leggauss(ORDER)
    to_coefficients = (legendre.legvander(nodes, ORDER - 1) * weights[:, None]).T * (np.arange(ORDER) + 0.5)[:, None]
    u = _cells(surface.knots_u, surface.degree_u)
    v = _cells(surface.knots_v, surface.degree_v)
    at_u = 0.5 * (u[:-1, None] + u[1:, None]) + 0.5 * np.diff(u)[:, None] * nodes
    at_v = 0.5 * (v[:-1, None] + v[1:, None]) + 0.5 * np.diff(v)[:, None] * nodes
    d = surface.derivatives(at_u.ravel()[:, None], at_v.ravel()[None, :], 1)
    element = np.linalg.norm(np.cross(d[1, 0], d[0, 1]), axis=-1)
    element = element.reshape(len(u) - 1, ORDER, len(v) - 1, ORDER).transpose(0, 2, 1, 3)
    coefficients = np.einsum("ka,ijab,lb->ijkl", to_coefficients, element, to_coefficients)
    across = coefficients[:, :, 0, :] * np.diff(u)[:, None, None]
    before = np.concatenate([np.zeros_like(across[:1]), np.cumsum(across, axis=0)[:-1]])
    return _AreaElement(u, v, coefficients, before)


def trimmed_area(surface: BSplineSurface) -> float:
    """Area of the face: inside its trims, or of the whole domain when it has none. In the surface's unit squared."""
    element = _area_element(surface)
    if surface.trims is None:
        du, dv = np.diff(element.u), np.diff(element.v)
        return float(np.einsum("ij,i,j->", element.coefficients[:, :, 0, 0], du, dv))
    total = 0.0
    for loop in surface.trims:
        inside = abs(sum(_along(curve, element) for curve in loop.curves))  # whichever way the loop runs
        total += inside if loop.outer else -inside
    return abs(total)


def _along(curve: TrimCurve, element: _AreaElement) -> float:
    """The integral of G dv along a trim curve, Gauss-Legendre between its knots and where it passes from cell to cell."""
    nodes, weights = legendre.leggauss(ORDER)
    borders = breakpoints(curve.knots, curve.degree)
    cuts = np.union1d(borders, _crossings(curve, borders, (element.u, element.v)))
    half = 0.5 * np.diff(cuts)
    t = (0.5 * (cuts[:-1] + cuts[1:])[:, None] + half[:, None] * nodes).ravel()
    value, rate = _point_and_rate(curve, t)
    inside = element.primitive(value[:, 0], value[:, 1])
    return float(np.sum((half[:, None] * weights).ravel() * inside * rate[:, 1]))


def _crossings(curve: TrimCurve, borders: Array, grid: tuple[Array, Array]) -> Array:
    """Parameters where a trim curve crosses a line of the grid: bracketed by samples, then Newton inside the bracket."""
    steps = np.arange(8) / 8.0
    t = np.append((borders[:-1, None] + np.diff(borders)[:, None] * steps).ravel(), borders[-1])
    value, _ = _point_and_rate(curve, t)
    found = [np.empty(0)]
    for axis in (0, 1):
        lines, x = grid[axis][1:-1], value[:, axis]
        low, high = np.minimum(x[:-1], x[1:]), np.maximum(x[:-1], x[1:])
        line, at = np.nonzero((low < high) & (low <= lines[:, None]) & (lines[:, None] <= high))
        if len(at) == 0:
            continue
        target = lines[line]
        guess = t[at] + (t[at + 1] - t[at]) * (target - x[at]) / (x[at + 1] - x[at])
        for _ in range(6):
            there, rate = _point_and_rate(curve, guess)
            slope = np.where(rate[:, axis] == 0.0, np.inf, rate[:, axis])
            guess = np.clip(guess - (there[:, axis] - target) / slope, t[at], t[at + 1])
        found.append(guess)
    return np.concatenate(found)


def _point_and_rate(curve: TrimCurve, t: Array) -> tuple[Array, Array]:
    """(k, 2) points and derivatives of a trim curve."""
    weights = np.ones(len(curve.control_points)) if curve.weights is None else curve.weights
    net = np.column_stack([curve.control_points * weights[:, None], weights])
    h = design_matrix(curve.knots, curve.degree, t) @ net
    d = design_matrix(curve.knots, curve.degree, t, 1) @ net
    point = h[:, :2] / h[:, 2:]
    return point, (d[:, :2] - point * d[:, 2:]) / h[:, 2:]
