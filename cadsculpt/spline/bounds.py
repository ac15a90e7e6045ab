"""Bounds on a surface's derivatives, and on how far it leaves the flat pieces that stand for it.

The second derivatives over one knot span lie in the hull of the derivative nets' control points of that span (Piegl and
Tiller, eq. 3.24 in both directions), so their largest lengths cost a few differences of control points and follow the
deformation. From them, for a cell of parameter size hu x hv inside one span:

- the surface lies within  (hu^2 max|S_uu| + hv^2 max|S_vv|) / 8  of the bilinear patch of the cell's corners, which
  lies in the hull of the corners (linear interpolation along u, then along v);
- it lies within  (hu^2 max|S_uu| + 2 hu hv max|S_uv| + hv^2 max|S_vv|) / 8  of any flat triangle whose three vertices
  are points of the surface inside the cell (Filip, Magedson and Markot, CAGD 3 (1986), for the two halves of the
  cell). For any triangle: with barycentric weights l_i and offsets d_i from the point to the vertices, sum l_i S(v_i)
  - S differs from zero by at most sum l_i |D2 S(d_i, d_i)| / 2, and sum l_i du_i^2 is a variance on an interval of
  length hu, at most hu^2 / 4; likewise hv^2 / 4 and, by Cauchy and Schwarz, hu hv / 4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit_in_place
from .matrices import breakpoints
from .surface import BSplineSurface

Array = NDArray[np.float64]

S_U, S_V, S_UU, S_UV, S_VV = range(5)
"""Places of the five bounds in the last axis of `derivative_bounds`."""


def derivative_bounds(surface: BSplineSurface, control_points: Array | None = None) -> Array:
    """Upper bounds of |S_u|, |S_v|, |S_uu|, |S_uv|, |S_vv| over every knot span: (spans_u, spans_v, 5).

    `control_points` (r, s, 3) stand in for the surface's own where the surface has deformed. Units: length per
    parameter (squared). Across a span's border only one side's derivatives are bounded by each span.
    """
    points = surface.control_points if control_points is None else control_points
    weights = np.ones(surface.shape) if surface.weights is None else surface.weights
    net = np.concatenate([points * weights[..., None], weights[..., None]], axis=2)
    firsts = []
    for knots, degree in ((surface.knots_u, surface.degree_u), (surface.knots_v, surface.degree_v)):
        firsts.append(np.searchsorted(knots, breakpoints(knots, degree)[:-1], side="right") - 1 - degree)
    out = np.empty((len(firsts[0]), len(firsts[1]), 5))
    knots_u, knots_v = np.array(surface.knots_u), np.array(surface.knots_v)
    for a, i in enumerate(firsts[0]):
        for b, j in enumerate(firsts[1]):
            span_bounds(
                net, knots_u, knots_v, surface.degree_u, surface.degree_v, int(i), int(j), surface.rational, out[a, b]
            )
    return out


def sag_bilinear(bounds: Array, hu: float, hv: float) -> Array:
    """How far the surface can leave the bilinear patch of a cell's corners; bounds (..., 5), cell size hu x hv."""
    return np.asarray((hu * hu * bounds[..., S_UU] + hv * hv * bounds[..., S_VV]) / 8.0)


def sag_triangles(bounds: Array, hu: float, hv: float) -> Array:
    """How far the surface can leave flat triangles between its points in a cell; bounds (..., 5), cell size hu x hv."""
    return sag_bilinear(bounds, hu, hv) + hu * hv * np.asarray(bounds[..., S_UV]) / 4.0


@njit_in_place
def span_bounds(
    net: Array, knots_u: Array, knots_v: Array, p: int, q: int, i0: int, j0: int, rational: bool, out: Array
) -> None:
    """The five bounds over the span whose first control point is (i0, j0), into `out` (5,).

    net (r, s, 4) holds (w x, w y, w z, w). Rational surfaces: with A = w S relative to a point c of the span's hull,
    S_u = (A_u - w_u S) / w and S_uu = (A_uu - 2 w_u S_u - w_uu S) / w, so that bounds on A's and w's derivatives, on
    |S - c| and the least weight bound the quotient's.
    """
    cx, cy, cz = 0.0, 0.0, 0.0
    least, reach, steepest_u, steepest_v = 1.0, 0.0, 0.0, 0.0
    if rational:
        least = np.inf
        for a in range(p + 1):
            for b in range(q + 1):
                w = net[i0 + a, j0 + b, 3]
                least = min(least, w)
                cx += net[i0 + a, j0 + b, 0] / w
                cy += net[i0 + a, j0 + b, 1] / w
                cz += net[i0 + a, j0 + b, 2] / w
        count = (p + 1) * (q + 1)
        cx, cy, cz = cx / count, cy / count, cz / count
        for a in range(p + 1):
            for b in range(q + 1):
                w = net[i0 + a, j0 + b, 3]
                x, y, z = (
                    net[i0 + a, j0 + b, 0] / w - cx,
                    net[i0 + a, j0 + b, 1] / w - cy,
                    net[i0 + a, j0 + b, 2] / w - cz,
                )
                reach = max(reach, x * x + y * y + z * z)
        reach = np.sqrt(reach)
    for k in range(5):
        longest, steepest = longest_difference(net, knots_u, knots_v, p, q, i0, j0, rational, k, cx, cy, cz)
        if not rational:
            out[k] = longest
            continue
        value = longest + steepest * reach
        if k == S_U:
            steepest_u = steepest
        elif k == S_V:
            steepest_v = steepest
        elif k == S_UU:
            value += 2.0 * steepest_u * out[S_U]
        elif k == S_UV:
            value += steepest_u * out[S_V] + steepest_v * out[S_U]
        else:
            value += 2.0 * steepest_v * out[S_V]
        out[k] = value / least
        if k == S_U or k == S_V or k == S_UV:
            out[k] = min(out[k], separable_bound(net, knots_u, knots_v, p, q, i0, j0, k))


@njit_in_place
def longest_difference(
    net: Array, knots_u: Array, knots_v: Array, p: int, q: int, i0: int, j0: int, rational: bool, k: int,
    cx: float, cy: float, cz: float,
) -> tuple[float, float]:  # fmt: skip
    """The largest length in derivative net number k (S_U to S_VV) of A = w (S - c), and the largest value in w's, over
    a span."""
    order_u, order_v = (1, 0, 2, 1, 0)[k], (0, 1, 0, 1, 2)[k]
    longest, steepest = 0.0, 0.0
    for a in range(p + 1 - order_u):
        u0, u1, u2 = difference(knots_u, p, i0 + a, order_u)
        for b in range(q + 1 - order_v):
            v0, v1, v2 = difference(knots_v, q, j0 + b, order_v)
            x, y, z, w = 0.0, 0.0, 0.0, 0.0
            for e in range(order_u + 1):
                fu = u0 if e == 0 else (u1 if e == 1 else u2)
                for f in range(order_v + 1):
                    factor = fu * (v0 if f == 0 else (v1 if f == 1 else v2))
                    x += factor * net[i0 + a + e, j0 + b + f, 0]
                    y += factor * net[i0 + a + e, j0 + b + f, 1]
                    z += factor * net[i0 + a + e, j0 + b + f, 2]
                    w += factor * net[i0 + a + e, j0 + b + f, 3]
            if rational:
                x, y, z = x - cx * w, y - cy * w, z - cz * w
                steepest = max(steepest, abs(w))
            longest = max(longest, x * x + y * y + z * z)
    return np.sqrt(longest), steepest


@njit_in_place
def separable_bound(net: Array, knots_u: Array, knots_v: Array, p: int, q: int, i0: int, j0: int, k: int) -> float:
    """A bound on S_u, S_v or S_uv (k) where the span's weights are products a_i b_j, as in every surface of revolution,
    extrusion and quadric; infinite elsewhere.

    Then S = sum R_i(u) R_j(v) P_ij with rational functions R of one variable. In R_i' = sum_j a_i a_j (N_i' N_j - N_i
    N_j') / W^2 the terms that multiply P_m+1 - P_m after summation by parts are not negative (B-splines are totally
    positive), so they are at most (max a / min a)^2 times those of equal weights: the polynomial bound times that.
    """
    low_u, high_u, low_v, high_v = np.inf, 0.0, np.inf, 0.0
    corner = net[i0, j0, 3]
    for a in range(p + 1):
        for b in range(q + 1):
            product = net[i0 + a, j0, 3] * net[i0, j0 + b, 3]
            if abs(net[i0 + a, j0 + b, 3] * corner - product) > 1e-12 * product:
                return np.inf
            low_v, high_v = min(low_v, net[i0, j0 + b, 3]), max(high_v, net[i0, j0 + b, 3])
        low_u, high_u = min(low_u, net[i0 + a, j0, 3]), max(high_u, net[i0 + a, j0, 3])
    order_u, order_v = (1, 0, 2, 1)[k], (0, 1, 0, 1)[k]
    longest = 0.0
    for a in range(p + 1 - order_u):
        u0, u1, _ = difference(knots_u, p, i0 + a, order_u)
        for b in range(q + 1 - order_v):
            v0, v1, _ = difference(knots_v, q, j0 + b, order_v)
            d = 0.0
            for c in range(3):
                x = 0.0
                for e in range(order_u + 1):
                    for f in range(order_v + 1):
                        factor = (u0 if e == 0 else u1) * (v0 if f == 0 else v1)
                        x += factor * net[i0 + a + e, j0 + b + f, c] / net[i0 + a + e, j0 + b + f, 3]
                d += x * x
            longest = max(longest, d)
    ratio = (high_u / low_u if order_u else 1.0) * (high_v / low_v if order_v else 1.0)
    return float(ratio * ratio * np.sqrt(longest))


@njit_in_place
def difference(knots: Array, p: int, i: int, order: int) -> tuple[float, float, float]:
    """The factors of control points i, i+1, i+2 in control point i of the derivative net of that order (0, 1, 2)."""
    if order == 0:
        return 1.0, 0.0, 0.0
    first = p / (knots[i + p + 1] - knots[i + 1])
    if order == 1:
        return -first, first, 0.0
    second = p / (knots[i + p + 2] - knots[i + 2])
    outer = (p - 1) / (knots[i + p + 1] - knots[i + 2])
    return outer * first, -outer * (first + second), outer * second
