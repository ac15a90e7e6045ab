"""Cells of a patch below any grid: the pieces of surface that certified distance and continuous collision refine.

A cell is a rectangle in (u, v) inside one knot span. The surface over it lies within `sag` of the hull of its four
corners (`spline.bounds`: of their bilinear patch, which the hull holds), rational surfaces too, so what is proved of
four points, grown by the sag, is proved of the surface; the sag falls with the square of the cell's size.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..jit import njit
from ..spline.basis import basis_functions
from ..spline.bounds import S_UU, S_VV, span_bounds
from ..spline.region import OFF, Region
from .workspace import Patch

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SAG_ROUNDING = 1.0 + 1e-9
"""Outward rounding of a sag, on top of the rounding of its corners."""

ACROSS_U, ACROSS_V, WHOLE = 0, 1, 2
"""A cell is cut at its middle u or its middle v; or it is so narrow that rounding is all that cutting would find."""

NARROW = 2.0**-46
"""A cell narrower than this part of the domain is not cut."""


class Cells(NamedTuple):
    """n cells of one patch.

    rectangle (n, 4) : u0, u1, v0, v1. corners (n, 4, 3) : S(u0, v0), S(u1, v0), S(u0, v1), S(u1, v1). sag (n,) : the
    surface over the rectangle lies within it of the hull of the corners, rounding included. centre (n, 3), radius
    (n,) : a sphere that holds the surface over the rectangle. cut (n,) : how `halves` cuts it, ACROSS_U, ACROSS_V or
    WHOLE. on (n,) : `region.ON` or `region.MIXED` on a trimmed face; ON everywhere on a whole one.
    """

    rectangle: Array
    corners: Array
    sag: Array
    centre: Array
    radius: Array
    cut: Index
    on: Index


def cells_of(g: Patch, region: Region | None, rectangle: Array) -> Cells:
    """The cells over rectangles (n, 4), each inside one knot span; those wholly off the face are left out."""
    rectangle = np.ascontiguousarray(rectangle, dtype=np.float64)
    on = np.ones(len(rectangle), np.int64)
    if region is not None:
        on = region.classify(rectangle)
        if (on == OFF).any():
            rectangle, on = rectangle[on != OFF], on[on != OFF]
    n = len(rectangle)
    out = Cells(rectangle, np.empty((n, 4, 3)), np.empty(n), np.empty((n, 3)), np.empty(n), np.empty(n, np.int64), on)
    make_cells(g, rectangle, out.corners, out.sag, out.centre, out.radius, out.cut)
    return out


def span_rectangles(g: Patch) -> Array:
    """The rectangles (n, 4) of all knot spans, u slowest: those of the rows of `g.box`."""
    u, v = g.u[g.row_u[0, : g.tally[0, 0] + 1]], g.v[g.row_v[0, : g.tally[0, 1] + 1]]
    i, j = (k.ravel() for k in np.meshgrid(np.arange(len(u) - 1), np.arange(len(v) - 1), indexing="ij"))
    return np.stack([u[i], u[i + 1], v[j], v[j + 1]], axis=1)


def halves(cells: Cells) -> tuple[Array, Index]:
    """Both halves (m, 4) of every cell across its longer side in space, and the cell (m,) that each is of.

    A cell too narrow to be cut is its own only child.
    """
    r = cells.rectangle
    first, second = r.copy(), r.copy()
    for cut, low, high in ((ACROSS_U, 0, 1), (ACROSS_V, 2, 3)):
        here = cells.cut == cut
        middle = 0.5 * (r[here, low] + r[here, high])
        first[here, high], second[here, low] = middle, middle
    both = np.stack([first, second], axis=1).reshape(-1, 4)
    owner = np.repeat(np.arange(len(r)), 2)
    keep = np.ones(len(both), dtype=np.bool_)
    keep[1::2] = cells.cut != WHOLE
    return both[keep], owner[keep]


def quarters(rectangle: Array) -> Array:
    """The four quarters (4 n, 4) of rectangles (n, 4), those of each together."""
    u0, u1, v0, v1 = rectangle.T
    mu, mv = 0.5 * (u0 + u1), 0.5 * (v0 + v1)
    parts = [(u0, mu, v0, mv), (mu, u1, v0, mv), (u0, mu, mv, v1), (mu, u1, mv, v1)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 4)


@njit
def make_cells(
    g: Patch, rectangle: Array, corners: Array, sag: Array, centre: Array, radius: Array, cut: Index
) -> None:
    """Corners, sag, sphere and cut of the cells over rectangles (n, 4); the fields are those of `Cells`."""
    order_u, order_v = g.degree_u + 1, g.degree_v + 1
    basis_u, basis_v = np.empty((2, order_u)), np.empty((2, order_v))
    half = np.empty((2, order_v, 4))
    # corners and derivative nets are both rounded: the second differences carry the square of the degree
    rounding = 2.0 * g.slack * (1.0 + (g.degree_u * g.degree_u + g.degree_v * g.degree_v) / 256.0)
    least_u = NARROW * (g.u[len(g.u) - 1] - g.u[0])
    least_v = NARROW * (g.v[len(g.v) - 1] - g.v[0])
    for t in range(len(rectangle)):
        u0, u1, v0, v1 = rectangle[t, 0], rectangle[t, 1], rectangle[t, 2], rectangle[t, 3]
        a = span_holding(g.u, g.row_u, g.tally[0, 0], 0.5 * (u0 + u1))
        b = span_holding(g.v, g.row_v, g.tally[0, 1], 0.5 * (v0 + v1))
        i0, j0 = g.first_u[g.row_u[0, a]], g.first_v[g.row_v[0, b]]
        if g.bounds_stamp[a, b] != g.tick:
            g.bounds_stamp[a, b] = g.tick
            span_bounds(
                g.net, g.knots_u, g.knots_v, g.degree_u, g.degree_v, i0, j0, g.rational, g.bounds[a, b]
            )  # fmt: skip
        for k in range(2):
            basis_functions(g.knots_u, g.degree_u, i0 + g.degree_u, u1 if k else u0, basis_u[k])
            basis_functions(g.knots_v, g.degree_v, j0 + g.degree_v, v1 if k else v0, basis_v[k])
            for f in range(order_v):
                for c in range(4):
                    x = 0.0
                    for e in range(order_u):
                        x += basis_u[k, e] * g.net[i0 + e, j0 + f, c]
                    half[k, f, c] = x
        for k in range(4):
            x, y, z, w = 0.0, 0.0, 0.0, 0.0
            for f in range(order_v):
                e = basis_v[k >> 1, f]
                x += e * half[k & 1, f, 0]
                y += e * half[k & 1, f, 1]
                z += e * half[k & 1, f, 2]
                w += e * half[k & 1, f, 3]
            if g.rational:
                x, y, z = x / w, y / w, z / w
            corners[t, k, 0], corners[t, k, 1], corners[t, k, 2] = x, y, z
        hu, hv = u1 - u0, v1 - v0
        sag_u, sag_v = hu * hu * g.bounds[a, b, S_UU] / 8.0, hv * hv * g.bounds[a, b, S_VV] / 8.0
        sag[t] = (sag_u + sag_v) * SAG_ROUNDING + rounding
        # the longer way: over the longer of two opposite edges, and the bulge, all there is of a closed or polar edge
        way_u = max(edge(corners, t, 0, 1), edge(corners, t, 2, 3)) + sag_u
        way_v = max(edge(corners, t, 0, 2), edge(corners, t, 1, 3)) + sag_v
        if hu > least_u and (way_u >= way_v or hv <= least_v):
            cut[t] = ACROSS_U
        else:
            cut[t] = ACROSS_V if hv > least_v else WHOLE
        # the sphere around the middle of the corners' box; never larger than the one around the span's own hull
        far = 0.0
        for c in range(3):
            low = min(corners[t, 0, c], corners[t, 1, c], corners[t, 2, c], corners[t, 3, c])
            high = max(corners[t, 0, c], corners[t, 1, c], corners[t, 2, c], corners[t, 3, c])
            centre[t, c] = 0.5 * (low + high)
        for k in range(4):
            d = 0.0
            for c in range(3):
                d += (corners[t, k, c] - centre[t, c]) ** 2
            far = max(far, d)
        radius[t] = np.sqrt(far) * SAG_ROUNDING + sag[t]
        at, d = a * g.tally[0, 1] + b, 0.0
        for c in range(3):
            d += (0.5 * (g.box[at, 3 + c] - g.box[at, c])) ** 2
        if np.sqrt(d) + rounding < radius[t]:
            radius[t] = np.sqrt(d) + rounding
            for c in range(3):
                centre[t, c] = 0.5 * (g.box[at, c] + g.box[at, 3 + c])


@njit
def edge(corners: Array, t: int, i: int, j: int) -> float:
    """Length between two corners of a cell."""
    x, y, z = (
        corners[t, i, 0] - corners[t, j, 0],
        corners[t, i, 1] - corners[t, j, 1],
        corners[t, i, 2] - corners[t, j, 2],
    )
    return float(np.sqrt(x * x + y * y + z * z))


@njit
def span_holding(parameter: Array, row: Index, spans: int, t: float) -> int:
    """The knot span (of `spans`, whose borders are parameter[row[0]]) that holds t."""
    low, high = 0, spans
    while high - low > 1:
        middle = (low + high) // 2
        if t < parameter[row[0, middle]]:
            high = middle
        else:
            low = middle
    return low
