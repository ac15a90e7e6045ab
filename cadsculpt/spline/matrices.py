"""Transformation matrices (paper section 4.2): made once per surface and resolution, whatever the control points do.

M = A_u P A_v^T with A_u (m, r) and A_v (n, s) (paper eq. 2). The finest parameters run span by span, each knot span cut
evenly, so that no cell straddles a knot; every level of detail takes strided rows of the same matrices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError
from .basis import design_rows
from .surface import BSplineSurface

Array = NDArray[np.float64]


def design_matrix(knots: Array, degree: int, parameters: Array, derivative: int = 0) -> Array:
    """Dense basis matrix (m, count): row i holds the `derivative`-th derivative of all basis functions at parameters[i]."""
    count = len(knots) - degree - 1
    parameters = np.ascontiguousarray(parameters, dtype=np.float64)
    first = np.empty(len(parameters), dtype=np.int64)
    rows = np.empty((derivative + 1, len(parameters), degree + 1))
    # read-only as a surface's are: one type of array for the kernel
    knots = np.ascontiguousarray(knots).view()
    knots.flags.writeable = False
    design_rows(knots, degree, count, parameters, derivative, first, rows)
    matrix = np.zeros((len(parameters), count))
    np.put_along_axis(matrix, first[:, None] + np.arange(degree + 1), rows[derivative], axis=1)
    return matrix


def breakpoints(knots: Array, degree: int) -> Array:
    """The distinct knots inside the domain, ends included: the borders of the knot spans."""
    low, high = knots[degree], knots[-degree - 1]
    return np.unique(knots[(knots >= low) & (knots <= high)])


def span_parameters(knots: Array, degree: int, cells: NDArray[np.int64] | int) -> tuple[Array, NDArray[np.int64]]:
    """Parameters that cut knot span i evenly into cells[i] pieces, the breakpoints themselves exact.

    Returns (parameters (sum(cells) + 1,), span_start (spans + 1,)): span i owns the cells span_start[i] to span_start[i+1].
    """
    b = breakpoints(knots, degree)
    per_span = np.broadcast_to(np.asarray(cells, dtype=np.int64), (len(b) - 1,))
    start = np.concatenate([[0], np.cumsum(per_span)])
    parameters = np.empty(start[-1] + 1)
    for i, c in enumerate(per_span):
        parameters[start[i] : start[i + 1]] = b[i] + (b[i + 1] - b[i]) * (np.arange(c) / c)
    parameters[start] = b
    return parameters, start


@dataclass(frozen=True, slots=True, eq=False)
class TransformationMatrices:
    """A_u, A_v and the tangent matrices dA_u, dA_v at the finest resolution (paper section 4.2).

    Attributes
    ----------
    u (m,), v (n,) : parameters, span by span.
    A_u, dA_u (m, r); A_v, dA_v (n, s) : dense, for BLAS products over whole grids.
    first_u (m,), rows_u (3, m, degree_u + 1) : first nonzero basis index and the nonzero values of each row with its first
        and second derivative, for windows; likewise first_v, rows_v.
    span_start_u (spans_u + 1,) : span i owns grid rows span_start_u[i] .. span_start_u[i+1] (both ends); likewise v.
    """

    u: Array
    v: Array
    A_u: Array
    A_v: Array
    dA_u: Array
    dA_v: Array
    first_u: NDArray[np.int64]
    first_v: NDArray[np.int64]
    rows_u: Array
    rows_v: Array
    span_start_u: NDArray[np.int64]
    span_start_v: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        surface: BSplineSurface,
        cells_u: NDArray[np.int64] | int,
        cells_v: NDArray[np.int64] | int,
    ) -> TransformationMatrices:
        """Matrices with cells_u[i] cells in knot span i of u (a scalar: in every span), likewise v."""
        parts = []
        for knots, degree, cells in (
            (surface.knots_u, surface.degree_u, cells_u),
            (surface.knots_v, surface.degree_v, cells_v),
        ):
            t, start = span_parameters(knots, degree, cells)
            count = len(knots) - degree - 1
            first = np.empty(len(t), dtype=np.int64)
            rows = np.empty((3, len(t), degree + 1))
            design_rows(knots, degree, count, t, 2, first, rows)
            dense = np.zeros((2, len(t), count))
            for k in range(2):
                np.put_along_axis(dense[k], first[:, None] + np.arange(degree + 1), rows[k], axis=1)
            parts.append((t, start, first, rows, dense))
        (u, su, fu, ru, du), (v, sv, fv, rv, dv) = parts
        return cls(u, v, du[0], dv[0], du[1], dv[1], fu, fv, ru, rv, su, sv)

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n): rows and columns of the finest grid."""
        return len(self.u), len(self.v)

    def points(self, control_points: Array, weights: Array | None = None) -> Array:
        """M = A_u P A_v^T (eq. 2), or (A_u (wP) A_v^T) / (A_u w A_v^T): (m, n, 3)."""
        if weights is None:
            return _sandwich(self.A_u, control_points, self.A_v)
        w = self.A_u @ weights @ self.A_v.T
        return _sandwich(self.A_u, control_points * weights[..., None], self.A_v) / w[..., None]

    def tangents(self, control_points: Array, weights: Array | None = None) -> tuple[Array, Array, Array]:
        """Points, S_u and S_v on the whole grid, each (m, n, 3)."""
        if weights is None:
            return (
                _sandwich(self.A_u, control_points, self.A_v),
                _sandwich(self.dA_u, control_points, self.A_v),
                _sandwich(self.A_u, control_points, self.dA_v),
            )
        q = control_points * weights[..., None]
        w = (self.A_u @ weights @ self.A_v.T)[..., None]
        w_u = (self.dA_u @ weights @ self.A_v.T)[..., None]
        w_v = (self.A_u @ weights @ self.dA_v.T)[..., None]
        m = _sandwich(self.A_u, q, self.A_v) / w
        return (
            m,
            (_sandwich(self.dA_u, q, self.A_v) - w_u * m) / w,
            (_sandwich(self.A_u, q, self.dA_v) - w_v * m) / w,
        )


def _sandwich(left: Array, tensor: Array, right: Array) -> Array:
    """left (m, r) . tensor (r, s, c) . right^T (s, n) -> (m, n, c)."""
    r, s, c = tensor.shape
    half = (left @ tensor.reshape(r, s * c)).reshape(-1, s, c)
    return np.matmul(right, half)


def cells_per_span(surface: BSplineSurface, axis: int, total: int) -> NDArray[np.int64]:
    """Distribute about `total` cells over the knot spans by the spans' mean length in space, at least one each.

    axis 0 is u, 1 is v. Raises GeometryError when total is below 1.
    """
    if total < 1:
        raise GeometryError(f"a resolution of {total} cells", mend="at least one cell is needed")
    length = span_lengths(surface, axis)
    share = length / length.sum() if length.sum() > 0 else np.full(len(length), 1.0 / len(length))
    return np.maximum(1, np.rint(share * total).astype(np.int64))


def span_lengths(surface: BSplineSurface, axis: int) -> Array:
    """Length in space of each knot span along `axis`, the largest over a few iso-curves: (spans,)."""
    knots = (surface.knots_u, surface.knots_v)[axis]
    degree = (surface.degree_u, surface.degree_v)[axis]
    t, start = span_parameters(knots, degree, 8)
    low, high = surface.domain[1 - axis]
    cross = np.linspace(low, high, 9)
    points = surface.evaluate(t[:, None], cross) if axis == 0 else surface.evaluate(cross[None, :], t[:, None])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=2)
    return np.add.reduceat(steps, start[:-1], axis=0).max(axis=1)
