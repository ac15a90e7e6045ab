"""B-spline basis functions and their derivatives (paper section 3; Piegl and Tiller, algorithms A2.1 to A2.3, A4.4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit, njit_in_place

Array = NDArray[np.float64]

MAX_DEGREE = 32
"""Highest degree that the kernels' stack buffers take; CAD systems stop at 25."""


@njit_in_place
def find_span(knots: Array, degree: int, count: int, t: float) -> int:
    """Index i with knots[i] <= t < knots[i+1], clamped to the domain; a t outside uses the end span (A2.1)."""
    if not t < knots[count]:
        i = count - 1
        while i > degree and knots[i] >= knots[count]:
            i -= 1
        return i
    if t < knots[degree]:
        t = knots[degree]
    low = degree
    high = count
    while high - low > 1:
        mid = (low + high) // 2
        if t < knots[mid]:
            high = mid
        else:
            low = mid
    while low > degree and knots[low + 1] <= knots[low]:
        low -= 1
    return low


@njit
def basis_functions(knots: Array, degree: int, span: int, t: float, out: Array) -> None:
    """The degree + 1 nonzero B_{span-degree..span}(t) into `out` (A2.2)."""
    left = np.empty(degree + 1)
    right = np.empty(degree + 1)
    out[0] = 1.0
    for j in range(1, degree + 1):
        left[j] = t - knots[span + 1 - j]
        right[j] = knots[span + j] - t
        saved = 0.0
        for r in range(j):
            temp = out[r] / (right[r + 1] + left[j - r])
            out[r] = saved + right[r + 1] * temp
            saved = left[j - r] * temp
        out[j] = saved


@njit
def basis_derivatives(knots: Array, degree: int, span: int, t: float, order: int, out: Array) -> None:
    """Derivatives 0..order of the nonzero basis functions into `out` (order + 1, degree + 1) (A2.3)."""
    p = degree
    ndu = np.empty((p + 1, p + 1))
    left = np.empty(p + 1)
    right = np.empty(p + 1)
    ndu[0, 0] = 1.0
    for j in range(1, p + 1):
        left[j] = t - knots[span + 1 - j]
        right[j] = knots[span + j] - t
        saved = 0.0
        for r in range(j):
            ndu[j, r] = right[r + 1] + left[j - r]
            temp = ndu[r, j - 1] / ndu[j, r]
            ndu[r, j] = saved + right[r + 1] * temp
            saved = left[j - r] * temp
        ndu[j, j] = saved
    for j in range(p + 1):
        out[0, j] = ndu[j, p]
    for k in range(1, order + 1):
        for j in range(p + 1):
            out[k, j] = 0.0
    a = np.zeros((2, p + 1))
    for r in range(p + 1):
        s1 = 0
        s2 = 1
        a[0, 0] = 1.0
        for k in range(1, min(order, p) + 1):
            d = 0.0
            rk = r - k
            pk = p - k
            if r >= k:
                a[s2, 0] = a[s1, 0] / ndu[pk + 1, rk]
                d = a[s2, 0] * ndu[rk, pk]
            j1 = 1 if rk >= -1 else -rk
            j2 = k - 1 if r - 1 <= pk else p - r
            for j in range(j1, j2 + 1):
                a[s2, j] = (a[s1, j] - a[s1, j - 1]) / ndu[pk + 1, rk + j]
                d += a[s2, j] * ndu[rk + j, pk]
            if r <= pk:
                a[s2, k] = -a[s1, k - 1] / ndu[pk + 1, r]
                d += a[s2, k] * ndu[r, pk]
            out[k, r] = d
            s1, s2 = s2, s1
    factor = float(p)
    for k in range(1, min(order, p) + 1):
        for j in range(p + 1):
            out[k, j] *= factor
        factor *= p - k


@njit
def design_rows(
    knots: Array, degree: int, count: int, t: Array, order: int, first: NDArray[np.int64], rows: Array
) -> None:
    """For each parameter: the first nonzero basis index into `first` (m,), derivatives into `rows` (order+1, m, degree+1)."""
    buffer = np.empty((order + 1, degree + 1))
    for i in range(len(t)):
        span = find_span(knots, degree, count, t[i])
        basis_derivatives(knots, degree, span, t[i], order, buffer)
        first[i] = span - degree
        for k in range(order + 1):
            for j in range(degree + 1):
                rows[k, i, j] = buffer[k, j]


@njit
def surface_derivatives(
    control_points: Array,
    weights: Array,
    rational: bool,
    knots_u: Array,
    knots_v: Array,
    degree_u: int,
    degree_v: int,
    u: Array,
    v: Array,
    order: int,
) -> Array:
    """Partial derivatives up to `order` at scattered (u, v): (n, order + 1, order + 1, 3) (A3.6, and A4.4 if rational)."""
    r, s = control_points.shape[0], control_points.shape[1]
    n = len(u)
    out = np.zeros((n, order + 1, order + 1, 3))
    bu = np.empty((order + 1, degree_u + 1))
    bv = np.empty((order + 1, degree_v + 1))
    h = np.empty((order + 1, order + 1, 4))
    binomial = np.zeros((order + 1, order + 1))
    for i in range(order + 1):
        binomial[i, 0] = 1.0
        for j in range(1, i + 1):
            binomial[i, j] = binomial[i - 1, j - 1] + binomial[i - 1, j]
    for m in range(n):
        su = find_span(knots_u, degree_u, r, u[m])
        sv = find_span(knots_v, degree_v, s, v[m])
        basis_derivatives(knots_u, degree_u, su, u[m], order, bu)
        basis_derivatives(knots_v, degree_v, sv, v[m], order, bv)
        h[:] = 0.0
        for a in range(order + 1):
            for b in range(order + 1 - a):
                for i in range(degree_u + 1):
                    for j in range(degree_v + 1):
                        f = bu[a, i] * bv[b, j]
                        p = control_points[su - degree_u + i, sv - degree_v + j]
                        if rational:
                            f *= weights[su - degree_u + i, sv - degree_v + j]
                            h[a, b, 3] += f
                        h[a, b, 0] += f * p[0]
                        h[a, b, 1] += f * p[1]
                        h[a, b, 2] += f * p[2]
        for a in range(order + 1):
            for b in range(order + 1 - a):
                if not rational:
                    for c in range(3):
                        out[m, a, b, c] = h[a, b, c]
                    continue
                for c in range(3):
                    value = h[a, b, c]
                    for j in range(1, b + 1):
                        value -= binomial[b, j] * h[0, j, 3] * out[m, a, b - j, c]
                    for i in range(1, a + 1):
                        value -= binomial[a, i] * h[i, 0, 3] * out[m, a - i, b, c]
                        for j in range(1, b + 1):
                            value -= binomial[a, i] * binomial[b, j] * h[i, j, 3] * out[m, a - i, b - j, c]
                    out[m, a, b, c] = value / h[0, 0, 3]
    return out
