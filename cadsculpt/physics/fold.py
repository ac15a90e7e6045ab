"""Does a lattice fold? Layers offset inward cross each other where the thickness exceeds the radius of curvature."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

Array = NDArray[np.float64]

LEAST_SHRINK = 0.02
"""A cell's corner must keep this share of its area on the surface down to the base; less makes cells that need endless
sub-steps."""


def check_folds(
    points: Array,
    inward: Array,
    u: Array,
    v: Array,
    thickness: float,
    wrap: tuple[bool, bool],
    columns: NDArray[np.bool_],
) -> bool:
    """Make sure that every corner of every hexahedron has a positive Jacobian. Returns whether (u, v, inward) is
    right-handed.

    points, inward (nu, nv, 3); columns (cu, cv) : which columns of cells exist. At depth t below a corner of a column
    the edges along u and v are du + t nu and dv + t nv (n the difference of the normals), so that the Jacobian there
    is a quadratic in t; its first root, over all corners, is the largest thickness that works. Corners on an edge
    that has no length (a pole) have no area to lose.

    Raises InputError where the thickness is too large, naming (u, v) and a thickness that does, and where the surface
    itself turns over.
    """
    shape = columns.shape
    after = [(np.arange(shape[axis]) + 1) % points.shape[axis] for axis in (0, 1)]
    before = [np.arange(shape[axis]) for axis in (0, 1)]
    corners = [(a, b) for a in (0, 1) for b in (0, 1)]
    area, slope, bend = np.empty((4, *shape)), np.empty((4, *shape)), np.empty((4, *shape))
    degenerate = np.zeros((4, *shape), dtype=np.bool_)
    for c, (a, b) in enumerate(corners):
        i = after[0] if a else before[0]
        j = after[1] if b else before[1]
        du, nu = (x[np.ix_(after[0], j)] - x[np.ix_(before[0], j)] for x in (points, inward))
        dv, nv = (x[np.ix_(i, after[1])] - x[np.ix_(i, before[1])] for x in (points, inward))
        normal = inward[np.ix_(i, j)]
        area[c] = np.einsum("ijc,ijc->ij", np.cross(du, dv), normal)
        slope[c] = np.einsum("ijc,ijc->ij", np.cross(du, nv) + np.cross(nu, dv), normal)
        bend[c] = np.einsum("ijc,ijc->ij", np.cross(nu, nv), normal)
        long = np.linalg.norm(du, axis=2), np.linalg.norm(dv, axis=2)
        degenerate[c] = np.minimum(*long) <= 1e-9 * np.maximum(long[0].max(), long[1].max())
    counts = columns & ~degenerate
    right_handed = bool(area[counts].sum() > 0.0)
    if not right_handed:
        area, slope, bend = -area, -slope, -bend
    turned = counts & (area <= 0.0)
    if turned.any():
        raise InputError(
            "the surface turns over between its nodes",
            where=_place(turned, corners, u, v),
            mend="use smaller node spacings, or repair the surface",
        )
    reach = np.where(counts, _first_root((1.0 - LEAST_SHRINK) * area, slope, bend), np.inf)
    if reach.min() <= thickness:
        largest = float(reach.min())
        raise InputError(
            f"a thickness of {thickness:g} folds the lattice: it exceeds the radius of curvature",
            where=_place(reach == reach.min(), corners, u, v),
            mend=f"use a thickness of {_rounded_down(0.98 * largest)} or less",
        )
    return right_handed


def _first_root(c0: Array, c1: Array, c2: Array) -> Array:
    """Smallest t > 0 with c0 + c1 t + c2 t^2 = 0, c0 > 0; inf where there is none."""
    discriminant = c1 * c1 - 4.0 * c0 * c2
    # 2 c0 / (-c1 + sqrt(d)) is the smaller positive root of either sign of c2, and c0 / -c1 when c2 = 0
    denominator = -c1 + np.sqrt(np.maximum(discriminant, 0.0))
    with np.errstate(divide="ignore"):
        root = np.where(denominator > 0.0, 2.0 * c0 / np.where(denominator > 0.0, denominator, 1.0), np.inf)
    return np.where(discriminant >= 0.0, root, np.inf)


def _place(which: NDArray[np.bool_], corners: list[tuple[int, int]], u: Array, v: Array) -> str:
    c, i, j = np.argwhere(which)[0]
    a, b = corners[c]
    return f"at u = {u[(i + a) % len(u)]:g}, v = {v[(j + b) % len(v)]:g}"


def _rounded_down(value: float) -> str:
    """Three significant digits, never more than the value."""
    digits = 2 - int(np.floor(np.log10(value)))
    return f"{np.floor(value * 10.0**digits) / 10.0**digits:.3g}"
