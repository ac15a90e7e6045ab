"""Exact orientation of points: a floating-point filter, and expansion arithmetic where it cannot decide.

Source: J. R. Shewchuk, "Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates", Discrete &
Computational Geometry 18 (1997). The signs are exact for all coordinates whose products of three neither overflow nor
underflow (magnitudes between about 1e-90 and 1e90, and zero). Nothing here relies on fused multiply-add.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit, njit_inline

Array = NDArray[np.float64]

EPSILON = 2.0**-53
SPLITTER = 2.0**27 + 1.0
ORIENT2D_BOUND = (3.0 + 16.0 * EPSILON) * EPSILON
ORIENT3D_BOUND = (7.0 + 56.0 * EPSILON) * EPSILON


@njit_inline
def two_sum(a: float, b: float) -> tuple[float, float]:
    """x + y = a + b exactly, x the rounded sum (Knuth)."""
    x = a + b
    b_virtual = x - a
    return x, (a - (x - b_virtual)) + (b - b_virtual)


@njit_inline
def two_product(a: float, b: float) -> tuple[float, float]:
    """x + y = a b exactly, x the rounded product (Dekker)."""
    x = a * b
    c = SPLITTER * a
    a_high = c - (c - a)
    a_low = a - a_high
    c = SPLITTER * b
    b_high = c - (c - b)
    b_low = b - b_high
    return x, a_low * b_low - (((x - a_high * b_high) - a_low * b_high) - a_high * b_low)


@njit_inline
def minor_value(ax: float, ay: float, bx: float, by: float) -> float:
    """ax by - bx ay to the last place or two, whatever cancels (Kahan)."""
    p, e = two_product(ax, by)
    q, f = two_product(bx, ay)
    return (p - q) + (e - f)


@njit
def minor(ax: float, ay: float, bx: float, by: float, h: Array) -> int:
    """The expansion of ax by - bx ay into h (up to 4 components, zeros left out); returns its length."""
    p1, p0 = two_product(ax, by)
    q1, q0 = two_product(bx, ay)
    # Two_Two_Diff: (p1 + p0) - (q1 + q0)
    i, x0 = two_sum(p0, -q0)
    j, k = two_sum(p1, i)
    i, x1 = two_sum(k, -q1)
    x3, x2 = two_sum(j, i)
    n = 0
    for x in (x0, x1, x2, x3):
        if x != 0.0:
            h[n] = x
            n += 1
    return n


@njit
def expansion_sum(e: Array, ne: int, f: Array, nf: int, h: Array) -> int:
    """h = e + f (fast expansion sum, zeros left out); returns the length of h, at most ne + nf."""
    if ne == 0 or nf == 0:
        for k in range(ne):
            h[k] = e[k]
        for k in range(nf):
            h[k] = f[k]
        return ne + nf
    i = 0
    j = 0
    n = 0
    q = 0.0
    for step in range(ne + nf):
        # the components of both, by increasing magnitude
        if j == nf or (i < ne and (f[j] > e[i]) == (f[j] > -e[i])):
            x = e[i]
            i += 1
        else:
            x = f[j]
            j += 1
        if step == 0:
            q = x
            continue
        q, low = two_sum(q, x)
        if low != 0.0:
            h[n] = low
            n += 1
    if q != 0.0:
        h[n] = q
        n += 1
    return n


@njit
def expansion_scale(e: Array, ne: int, b: float, h: Array) -> int:
    """h = b e (zeros left out); returns the length of h, at most 2 ne."""
    n = 0
    q = 0.0
    for i in range(ne):
        high, low = two_product(e[i], b)
        s, error = two_sum(q, low)
        if error != 0.0:
            h[n] = error
            n += 1
        q, error = two_sum(high, s)
        if error != 0.0:
            h[n] = error
            n += 1
    if q != 0.0:
        h[n] = q
        n += 1
    return n


@njit
def estimate(e: Array, n: int) -> float:
    """The value of an expansion to nearly all digits, with its exact sign. (Its largest component has that sign, but the
    next one may be as large as half of it.)"""
    if n == 0:
        return 0.0
    total = 0.0
    for k in range(n):
        total += e[k]
    return total if (total > 0.0) == (e[n - 1] > 0.0) and total != 0.0 else e[n - 1]


@njit
def orient2d_exact(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """The orientation of a, b, c by expansions."""
    w = np.empty(32)
    ab, bc, ca = w[0:4], w[4:8], w[8:12]
    n_ab = minor(ax, ay, bx, by, ab)
    n_bc = minor(bx, by, cx, cy, bc)
    n_ca = minor(cx, cy, ax, ay, ca)
    n = expansion_sum(ab, n_ab, bc, n_bc, w[12:20])
    n = expansion_sum(w[12:20], n, ca, n_ca, w[20:32])
    return estimate(w[20:32], n)


@njit
def orient2d(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Positive when a, b, c turn counterclockwise, zero when collinear: the sign is exact."""
    left = (ax - cx) * (by - cy)
    right = (ay - cy) * (bx - cx)
    value = left - right
    if abs(value) > ORIENT2D_BOUND * (abs(left) + abs(right)):
        return value
    return orient2d_exact(ax, ay, bx, by, cx, cy)


@njit
def orient3d_exact(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float,
    cx: float, cy: float, cz: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """The orientation of four points by expansions."""
    w = np.empty(340)
    ab, bc, cd, da, ac, bd = w[0:4], w[4:8], w[8:12], w[12:16], w[16:20], w[20:24]
    n_ab = minor(ax, ay, bx, by, ab)
    n_bc = minor(bx, by, cx, cy, bc)
    n_cd = minor(cx, cy, dx, dy, cd)
    n_da = minor(dx, dy, ax, ay, da)
    n_ac = minor(ax, ay, cx, cy, ac)
    n_bd = minor(bx, by, dx, dy, bd)
    t, cda, dab, abc, bcd = w[24:36], w[36:48], w[48:60], w[60:72], w[72:84]
    n = expansion_sum(cd, n_cd, da, n_da, t)
    n_cda = expansion_sum(t, n, ac, n_ac, cda)
    n = expansion_sum(da, n_da, ab, n_ab, t)
    n_dab = expansion_sum(t, n, bd, n_bd, dab)
    for k in range(n_bd):
        bd[k] = -bd[k]
    for k in range(n_ac):
        ac[k] = -ac[k]
    n = expansion_sum(ab, n_ab, bc, n_bc, t)
    n_abc = expansion_sum(t, n, ac, n_ac, abc)
    n = expansion_sum(bc, n_bc, cd, n_cd, t)
    n_bcd = expansion_sum(t, n, bd, n_bd, bcd)
    # four scaled minors of at most 24 components, their two sums of 48, and the whole of 96
    x, y, ab_sum, cd_sum, whole = w[84:108], w[108:132], w[132:180], w[180:228], w[228:324]
    n_x = expansion_scale(bcd, n_bcd, az, x)
    n_y = expansion_scale(cda, n_cda, -bz, y)
    n_left = expansion_sum(x, n_x, y, n_y, ab_sum)
    n_x = expansion_scale(dab, n_dab, cz, x)
    n_y = expansion_scale(abc, n_abc, -dz, y)
    n_right = expansion_sum(x, n_x, y, n_y, cd_sum)
    n = expansion_sum(ab_sum, n_left, cd_sum, n_right, whole)
    return estimate(whole, n)


@njit_inline
def orient3d(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float,
    cx: float, cy: float, cz: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """det [a - d, b - d, c - d]: positive when d lies below the plane through a, b, c (counterclockwise from above).

    Zero exactly when the four points are coplanar; the sign is exact, the value approximate.
    """
    adx, ady, adz = ax - dx, ay - dy, az - dz
    bdx, bdy, bdz = bx - dx, by - dy, bz - dz
    cdx, cdy, cdz = cx - dx, cy - dy, cz - dz
    bdxcdy, cdxbdy = bdx * cdy, cdx * bdy
    cdxady, adxcdy = cdx * ady, adx * cdy
    adxbdy, bdxady = adx * bdy, bdx * ady
    value = adz * (bdxcdy - cdxbdy) + bdz * (cdxady - adxcdy) + cdz * (adxbdy - bdxady)
    permanent = (
        (abs(bdxcdy) + abs(cdxbdy)) * abs(adz)
        + (abs(cdxady) + abs(adxcdy)) * abs(bdz)
        + (abs(adxbdy) + abs(bdxady)) * abs(cdz)
    )
    if abs(value) > ORIENT3D_BOUND * permanent:
        return value
    return orient3d_exact(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz)
