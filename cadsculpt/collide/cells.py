"""Cells of a patch below any grid: the pieces of surface that certified distance and continuous collision refine.

A cell is a rectangle in (u, v) inside one knot span. The surface over it lies within `sag` of the hull of its four
corners, rational surfaces too, so what is proved of four points, grown by the sag, is proved of the surface; the sag
falls with the square of the cell's size. It comes from the cell's own Bezier net, not from bounds over the whole knot
span as in `spheres`: below the grid the surface bends as it does here, not as it does at its worst.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..jit import njit, njit_in_place
from ..spline.region import OFF, ON, Region
from .workspace import Patch, Spans, spans_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROUNDED_UP = 1.0 + 1e-9
"""Outward rounding of a length, on top of the rounding of the points it is between."""

STRAIGHT = 0.02
"""What the length of a cell counts against its bulge where it is decided which way to cut it."""

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
    return kept_cells(g, region, rectangle)[0]


def kept_cells(g: Patch, region: Region | None, rectangle: Array) -> tuple[Cells, Index]:
    """As `cells_of`, with the places (m,) of the rectangles that hold a piece of the face."""
    rectangle = np.ascontiguousarray(rectangle, dtype=np.float64)
    kept, on = np.arange(len(rectangle)), np.full(len(rectangle), ON)
    if region is not None:
        on = region.classify(rectangle)
        kept = np.flatnonzero(on != OFF)
        rectangle, on = rectangle[kept], on[kept]
    n = len(rectangle)
    corners, sag, centre, radius = np.empty((n, 4, 3)), np.empty(n), np.empty((n, 3)), np.empty(n)
    cut = np.empty(n, np.int64)
    make_cells(spans_of(g), rectangle, on, corners, sag, centre, radius, cut)
    return Cells(rectangle, corners, sag, centre, radius, cut, on), kept


def span_rectangles(g: Patch) -> Array:
    """The rectangles (n, 4) of all knot spans, u slowest: those of the rows of `g.box`."""
    u, v = g.u[g.row_u[0, : g.tally[0, 0] + 1]], g.v[g.row_v[0, : g.tally[0, 1] + 1]]
    i, j = (k.ravel() for k in np.meshgrid(np.arange(len(u) - 1), np.arange(len(v) - 1), indexing="ij"))
    return np.stack([u[i], u[i + 1], v[j], v[j + 1]], axis=1)


def halves(cells: Cells) -> tuple[Array, Index]:
    """Both halves (m, 4) of every cell, across the way that bends most, and the cell (m,) that each is of.

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
    g: Spans, rectangle: Array, on: Index, corners: Array, sag: Array, centre: Array, radius: Array, cut: Index
) -> None:
    """Corners, sag, sphere and cut of the cells over rectangles (n, 4); the fields are those of `Cells`.

    All from the Bezier net of the surface over the rectangle: the surface lies in the hull of its points, and each of
    them lies near the corners' bilinear patch at (i / p, j / q), where it would be if nothing were bent.
    """
    p, q = g.degree_u, g.degree_v
    to_u, to_v = np.empty((p + 1, p + 1)), np.empty((q + 1, q + 1))
    row = np.empty((max(p, q) + 1, max(p, q) + 1))
    half, net = np.empty((p + 1, q + 1, 4)), np.empty((p + 1, q + 1, 4))
    rounding = g.slack * (2.0 + 0.125 * (p + q))
    least_u = NARROW * (g.u[len(g.u) - 1] - g.u[0])
    least_v = NARROW * (g.v[len(g.v) - 1] - g.v[0])
    for t in range(len(rectangle)):
        u0, u1, v0, v1 = rectangle[t, 0], rectangle[t, 1], rectangle[t, 2], rectangle[t, 3]
        a = span_holding(g.u, g.row_u, g.tally[0, 0], 0.5 * (u0 + u1))
        b = span_holding(g.v, g.row_v, g.tally[0, 1], 0.5 * (v0 + v1))
        i0, j0 = g.first_u[g.row_u[0, a]], g.first_v[g.row_v[0, b]]
        to_bezier(g.knots_u, p, i0 + p, u0, u1, to_u, row)
        to_bezier(g.knots_v, q, j0 + q, v0, v1, to_v, row)
        for i in range(p + 1):
            for f in range(q + 1):
                for c in range(4):
                    x = 0.0
                    for e in range(p + 1):
                        x += to_u[i, e] * g.net[i0 + e, j0 + f, c]
                    half[i, f, c] = x
        for i in range(p + 1):
            for j in range(q + 1):
                for c in range(4):
                    x = 0.0
                    for f in range(q + 1):
                        x += to_v[j, f] * half[i, f, c]
                    net[i, j, c] = x
                if g.rational:
                    for c in range(3):
                        net[i, j, c] /= net[i, j, 3]
        for c in range(3):
            for k in range(4):
                corners[t, k, c] = net[p * (k & 1), q * (k >> 1), c]
            low, high = net[0, 0, c], net[0, 0, c]
            for i in range(p + 1):
                for j in range(q + 1):
                    low, high = min(low, net[i, j, c]), max(high, net[i, j, c])
            centre[t, c] = 0.5 * (low + high)
        away, bulge, way_u, way_v, bent_u, bent_v = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(p + 1):
            for j in range(q + 1):
                s, r = i / p, j / q
                d, off, du, dv, uu, vv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                for c in range(3):
                    x = net[i, j, c]
                    d += (x - centre[t, c]) ** 2
                    flat = (1.0 - r) * ((1.0 - s) * corners[t, 0, c] + s * corners[t, 1, c]) + r * (
                        (1.0 - s) * corners[t, 2, c] + s * corners[t, 3, c]
                    )
                    off += (x - flat) ** 2
                    if i < p:
                        du += (net[i + 1, j, c] - x) ** 2
                    if j < q:
                        dv += (net[i, j + 1, c] - x) ** 2
                    if 0 < i < p:
                        uu += (net[i + 1, j, c] - 2.0 * x + net[i - 1, j, c]) ** 2
                    if 0 < j < q:
                        vv += (net[i, j + 1, c] - 2.0 * x + net[i, j - 1, c]) ** 2
                away, bulge = max(away, d), max(bulge, off)
                way_u, way_v = max(way_u, du), max(way_v, dv)
                bent_u, bent_v = max(bent_u, uu), max(bent_v, vv)
        sag[t] = np.sqrt(bulge) * ROUNDED_UP + rounding
        radius[t] = np.sqrt(away) * ROUNDED_UP + rounding
        way_u, way_v = p * np.sqrt(way_u), q * np.sqrt(way_v)
        if on[t] == ON:
            # what bends is worth cutting; what is straight only where it is all there is
            way_u = 0.125 * p * (p - 1) * np.sqrt(bent_u) + STRAIGHT * way_u
            way_v = 0.125 * q * (q - 1) * np.sqrt(bent_v) + STRAIGHT * way_v
        if u1 - u0 > least_u and (way_u >= way_v or v1 - v0 <= least_v):
            cut[t] = ACROSS_U
        else:
            cut[t] = ACROSS_V if v1 - v0 > least_v else WHOLE


@njit_in_place
def to_bezier(knots: Array, p: int, span: int, low: float, high: float, out: Array, row: Array) -> None:
    """The matrix (p + 1, p + 1) from the control points of a knot span to the Bezier points over [low, high] inside it.

    Row k is the blossom at p - k times low, k times high (Ramshaw 1989), by de Boor's recurrence over rows of unit
    vectors: convex combinations, so nothing is lost in it. row (>= p + 1, >= p + 1) : scratch.
    """
    for k in range(p + 1):
        for i in range(p + 1):
            for c in range(p + 1):
                row[i, c] = 1.0 if i == c else 0.0
        for r in range(1, p + 1):
            t = high if r > p - k else low
            for i in range(p, r - 1, -1):
                left = knots[span - p + i]
                f = (t - left) / (knots[span + 1 + i - r] - left)
                for c in range(p + 1):
                    row[i, c] = (1.0 - f) * row[i - 1, c] + f * row[i, c]
        for c in range(p + 1):
            out[k, c] = row[p, c]


@njit_in_place
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
