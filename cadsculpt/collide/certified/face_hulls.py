"""The hull of a trimmed face's part in a cell that its border runs through.

The hull of the cell's corners would be loose by the cell's size; here it is cut along the border, so that it is loose by
the square only, as inside the face. In the cell's own coordinates, the unit square, the border runs between two parallel
lines. What lies beyond one of them has no border in it: it is all face or none of it, as one corner tells.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...jit import njit
from ...spline.region import LEAF, Region, odd
from ..cells import span_holding, to_bezier
from ..workspace import Patch

Array = NDArray[np.float64]
Index = NDArray[np.int64]

POINTS = 6
"""Corners of a unit square cut along two parallel lines, at most."""


def face_hulls(g: Patch, region: Region, rectangle: Array, corners: Array, sag: Array) -> tuple[Array, Array, Array]:
    """For cells (n,) that a border meets: points (n, POINTS, 3), some of them twice, how far (n,) the face over the cell
    may lie from their hull, and how wide (n,), as a part of the cell, the strip is that the border runs in."""
    n = len(rectangle)
    hull, grown, beside = np.empty((n, POINTS, 3)), np.empty(n), np.empty(n)
    clip_cells(
        g, region.chords, region.deviation, region.box, region.shifts, region.low, region.size,
        np.ascontiguousarray(rectangle), np.ascontiguousarray(corners), np.ascontiguousarray(sag), hull, grown, beside,
    )  # fmt: skip
    return hull, grown, beside


@njit
def clip_cells(
    g: Patch, chords: Array, deviation: Array, box: Array, shifts: Array, low: Array, size: Array, rectangle: Array,
    corners: Array, sag: Array, hull: Array, grown: Array, beside: Array,
) -> None:  # fmt: skip
    """`face_hulls` into hull, grown and beside."""
    stack = np.empty(128, np.int64)
    border, where = np.empty(4), np.empty((len(shifts), 4))
    polygon, other = np.empty((POINTS + 2, 2)), np.empty((POINTS + 2, 2))
    for k in range(len(rectangle)):
        for m in range(len(shifts)):
            for c in range(2):
                for end in range(2):
                    where[m, 2 * c + end] = (rectangle[k, 2 * c + end] - low[c]) / size[c] + shifts[m, c]
        for i in range(4):
            polygon[i, 0], polygon[i, 1] = 1.0 if i == 1 or i == 2 else 0.0, 1.0 if i >= 2 else 0.0
        count, cut = 4, False
        grown[k], beside[k] = sag[k], 1.0
        border[0], border[1] = 0.0, 0.0
        for m in range(len(shifts)):
            border_between(chords, deviation, box, where[m], 0.0, 0.0, stack, border)
        if border[0] != 0.0 or border[1] != 0.0:
            # the border's mean direction, by its doubled angle, and its normal
            turn = 0.5 * np.arctan2(border[1], border[0])
            nx, ny = -np.sin(turn), np.cos(turn)
            border[2], border[3] = np.inf, -np.inf
            for m in range(len(shifts)):
                border_between(chords, deviation, box, where[m], nx, ny, stack, border)
            for sign in (1.0, -1.0):
                # beyond the line on this side: the corner that is farthest there tells
                ax, ay = sign * nx, sign * ny
                line = border[2] if sign > 0.0 else -border[3]
                x, y = 1.0 if ax < 0.0 else 0.0, 1.0 if ay < 0.0 else 0.0
                if ax * x + ay * y >= line:
                    continue
                off = True
                for m in range(len(shifts)):
                    s = where[m, 1] if x > 0.0 else where[m, 0]
                    t = where[m, 3] if y > 0.0 else where[m, 2]
                    if odd(chords, box, s, t, stack):
                        off = False
                        break
                if off:
                    left = clip(polygon, count, ax, ay, line, other)
                    if left > 0:
                        count = left
                        polygon[:count] = other[:count]
                        cut = True
            # what is not cut off beside the border is face
            least, most = min(nx, 0.0) + min(ny, 0.0), max(nx, 0.0) + max(ny, 0.0)
            beside[k] = min(1.0, max(0.0, min(most, border[3]) - max(least, border[2])))
        for i in range(POINTS):
            s, t = polygon[min(i, count - 1), 0], polygon[min(i, count - 1), 1]
            for c in range(3):
                hull[k, i, c] = (1.0 - t) * ((1.0 - s) * corners[k, 0, c] + s * corners[k, 1, c]) + t * (
                    (1.0 - s) * corners[k, 2, c] + s * corners[k, 3, c]
                )
        if cut:
            grown[k] += g.slack + twisted(corners[k], polygon, count)
            if g.rational:
                grown[k] += skewed(g, rectangle[k], corners[k])


@njit
def border_between(
    chords: Array, deviation: Array, box: Array, where: Array, nx: float, ny: float, stack: Index, border: Array
) -> None:
    """Take the chords that come into a rectangle (`where`, in the region's coordinates) into `border` (4,): the length of
    each times cosine and sine of its doubled angle are added to the first two, the last two are the least and the largest
    of nx x + ny y over the border; all in the rectangle's own coordinates x, y."""
    leaves = (len(box) + 1) // 2
    s0, s1, t0, t1 = where[0], where[1], where[2], where[3]
    stack[0] = 0
    top = 1
    while top > 0:
        top -= 1
        k = stack[top]
        if box[k, 0] > s1 or box[k, 2] < s0 or box[k, 1] > t1 or box[k, 3] < t0:
            continue
        if k < leaves - 1:
            stack[top], stack[top + 1] = 2 * k + 1, 2 * k + 2
            top += 2
            continue
        first = (k - leaves + 1) * LEAF
        for i in range(first, min(first + LEAF, len(chords))):
            d = deviation[i]
            gx, gy = d / (s1 - s0), d / (t1 - t0)
            x0, y0 = (chords[i, 0] - s0) / (s1 - s0), (chords[i, 1] - t0) / (t1 - t0)
            dx, dy = (chords[i, 2] - chords[i, 0]) / (s1 - s0), (chords[i, 3] - chords[i, 1]) / (t1 - t0)
            # from where to where the chord runs through the square grown by its deviation
            a, b = 0.0, 1.0
            for c in range(2):
                at, way, more = (x0, dx, gx) if c == 0 else (y0, dy, gy)
                if way == 0.0:
                    if at < -more or at > 1.0 + more:
                        b = -1.0
                else:
                    e, f = (-more - at) / way, (1.0 + more - at) / way
                    a, b = max(a, min(e, f)), min(b, max(e, f))
            if a > b:
                continue
            length = np.sqrt(dx * dx + dy * dy)
            if length > 0.0:
                border[0] += (b - a) * (dx * dx - dy * dy) / length
                border[1] += (b - a) * 2.0 * dx * dy / length
            off = abs(nx) * gx + abs(ny) * gy + 1e-14 * length
            e, f = nx * (x0 + a * dx) + ny * (y0 + a * dy), nx * (x0 + b * dx) + ny * (y0 + b * dy)
            border[2] = min(border[2], min(e, f) - off)
            border[3] = max(border[3], max(e, f) + off)


@njit
def clip(polygon: Array, count: int, nx: float, ny: float, line: float, out: Array) -> int:
    """The part of a convex polygon with nx x + ny y >= line into `out`; how many corners it has."""
    found = 0
    for i in range(count):
        j = (i + 1) % count
        e = nx * polygon[i, 0] + ny * polygon[i, 1] - line
        f = nx * polygon[j, 0] + ny * polygon[j, 1] - line
        if e >= 0.0:
            out[found, 0], out[found, 1] = polygon[i, 0], polygon[i, 1]
            found += 1
        if (e > 0.0 and f < 0.0) or (e < 0.0 and f > 0.0):
            w = e / (e - f)
            for c in range(2):
                out[found, c] = polygon[i, c] + w * (polygon[j, c] - polygon[i, c])
            found += 1
    return found


@njit
def twisted(corners: Array, polygon: Array, count: int) -> float:
    """How far the corners' bilinear patch over a polygon may leave the hull of its corners there.

    By the twist alone: |sum w (s_k - s) (t_k - t)| is at most a quarter of both extents for a mean (s, t) of the (s_k,
    t_k).
    """
    wide = 0.25
    for c in range(2):
        least, most = 1.0, 0.0
        for i in range(count):
            least, most = min(least, polygon[i, c]), max(most, polygon[i, c])
        wide *= max(0.0, most - least)
    d = 0.0
    for c in range(3):
        d += (corners[0, c] - corners[1, c] - corners[2, c] + corners[3, c]) ** 2
    return float(wide * np.sqrt(d))


@njit
def skewed(g: Patch, rectangle: Array, corners: Array) -> float:
    """How far the weights may draw a rational surface along itself: S(u, v) is a mean of points near the bilinear patch
    with weights that are off by the weights' ratio over the cell at most."""
    p, q = g.degree_u, g.degree_v
    to_u, to_v = np.empty((p + 1, p + 1)), np.empty((q + 1, q + 1))
    row = np.empty((max(p, q) + 1, max(p, q) + 1))
    a = span_holding(g.u, g.row_u, g.tally[0, 0], 0.5 * (rectangle[0] + rectangle[1]))
    b = span_holding(g.v, g.row_v, g.tally[0, 1], 0.5 * (rectangle[2] + rectangle[3]))
    i0, j0 = g.first_u[g.row_u[0, a]], g.first_v[g.row_v[0, b]]
    to_bezier(g.knots_u, p, i0 + p, rectangle[0], rectangle[1], to_u, row)
    to_bezier(g.knots_v, q, j0 + q, rectangle[2], rectangle[3], to_v, row)
    least, most = np.inf, 0.0
    for i in range(p + 1):
        for j in range(q + 1):
            w = 0.0
            for e in range(p + 1):
                for f in range(q + 1):
                    w += to_u[i, e] * to_v[j, f] * g.net[i0 + e, j0 + f, 3]
            least, most = min(least, w), max(most, w)
    reach = 0.0
    for k in range(4):
        d = 0.0
        for c in range(3):
            d += (corners[k, c] - 0.25 * (corners[0, c] + corners[1, c] + corners[2, c] + corners[3, c])) ** 2
        reach = max(reach, d)
    return float((most / least - 1.0) * np.sqrt(reach) * (1.0 + 1e-9))
