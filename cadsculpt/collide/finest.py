"""All pairs of triangles of two patches' finest meshes that meet (paper sections 4.4 to 4.7), and nothing else.

Where contacts are not asked for, boxes and slabs do what the spheres of 4.5 do, and part two sheets that run side by side
long before spheres would. A cell's box holds its corners, grown by the sag of the surface between them (`spline.bounds`),
so that it holds every finer vertex of the cell and with them the triangles between these; so does its slab, between two
planes across the normal in the cell's middle. Of two cells that neither part the larger is cut, down to the finest, whose
sag is nothing. Cells are made only where the other body is near, and those of a net that has not changed are kept.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit, njit_inline
from ..spline.bounds import S_UU, S_VV, longest_difference, span_bounds
from .hull import near, whole
from .spheres import distance2
from .tri_tri import WORK, culled_tri_tri
from .workspace import Patch, canonical, grown, longer, make_points

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@njit
def finest_crossings(
    g: Patch,
    boxes_a: Array,
    corners_a: Index,
    stamp_a: Index,
    h: Patch,
    boxes_b: Array,
    corners_b: Index,
    stamp_b: Index,
) -> tuple[Index, Index, Index, Array]:
    """The triangles of the finest meshes of g and h that meet: vertices (n, 6) of g's and h's, relation (n,), their
    rank (n,) in the fixed order (by cell and half of g's, then of h's), segments (n, 6).

    boxes_a (cells, BOX), corners_a (cells, 4), stamp_a (cells,) : boxes and slabs of g's cells, the vertices at their
    corners, and the tick at which each was made (`Workspace.boxes`). The triangles are those of `whole_mesh`; those
    of cells that hold no piece of the face are left out.
    """
    stack = np.empty((1024, 6), np.int64)
    top = first_pairs(g, boxes_a, corners_a, stamp_a, h, boxes_b, corners_b, stamp_b, stack)
    if top > len(stack):
        stack = np.empty((2 * top, 6), np.int64)
        top = first_pairs(g, boxes_a, corners_a, stamp_a, h, boxes_b, corners_b, stamp_b, stack)
    off_a, tally_a, row_ua, row_va, child_ua, child_va, covers_a = (
        g.offset, g.tally, g.row_u, g.row_v, g.child_u, g.child_v, g.covers,
    )  # fmt: skip
    off_b, tally_b, row_ub, row_vb, child_ub, child_vb, covers_b = (
        h.offset, h.tally, h.row_u, h.row_v, h.child_u, h.child_v, h.covers,
    )  # fmt: skip
    tick_a, tick_b, points_a, points_b = g.tick, h.tick, g.points, h.points
    rows_a, columns_a, rows_b, columns_b = len(g.u), len(g.v), len(h.u), len(h.v)
    wrap_ua, wrap_va, poles_a, wrap_ub, wrap_vb, poles_b = g.wrap_u, g.wrap_v, g.poles, h.wrap_u, h.wrap_v, h.poles
    triangles, relations, segments = np.empty((256, 6), np.int64), np.empty((256, 2), np.int64), np.empty((256, 6))
    tri_a, tri_b = np.empty((2, 3), np.int64), np.empty((2, 3), np.int64)
    both, segment, work = np.empty((6, 3)), np.empty(6), np.empty(WORK)
    count, boxes_tested, tests = 0, 0, 0
    while top > 0:
        top -= 1
        la, ca, da, lb, cb, db = (
            stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3], stack[top, 4], stack[top, 5],
        )  # fmt: skip
        at, to = off_a[la] + ca * tally_a[la, 1] + da, off_b[lb] + cb * tally_b[lb, 1] + db
        ia, ja, ib, jb = row_ua[la, ca], row_va[la, da], row_ub[lb, cb], row_vb[lb, db]
        last_a = row_ua[la, ca + 1] - ia == 1 and row_va[la, da + 1] - ja == 1
        last_b = row_ub[lb, cb + 1] - ib == 1 and row_vb[lb, db + 1] - jb == 1
        if not last_a and (last_b or boxes_a[at, 6] >= boxes_b[to, 6]):
            c0, c1, d0, d1 = child_ua[la, ca], child_ua[la, ca + 1], child_va[la, da], child_va[la, da + 1]
            la += 1
            if stamp_a[off_a[la] + c0 * tally_a[la, 1] + d0] != tick_a:
                fill_boxes(g, boxes_a, corners_a, stamp_a, la, c0, c1, d0, d1)
            if top + (c1 - c0) * (d1 - d0) > len(stack):
                stack = grown(stack)
            for c in range(c0, c1):
                for d in range(d0, d1):
                    at = off_a[la] + c * tally_a[la, 1] + d
                    boxes_tested += 1
                    if covers_a[at] and may_meet(boxes_a, corners_a, at, points_a, boxes_b, corners_b, to, points_b):
                        stack[top, 0], stack[top, 1], stack[top, 2] = la, c, d
                        stack[top, 3], stack[top, 4], stack[top, 5] = lb, cb, db
                        top += 1
            continue
        if not last_b:
            c0, c1, d0, d1 = child_ub[lb, cb], child_ub[lb, cb + 1], child_vb[lb, db], child_vb[lb, db + 1]
            lb += 1
            if stamp_b[off_b[lb] + c0 * tally_b[lb, 1] + d0] != tick_b:
                fill_boxes(h, boxes_b, corners_b, stamp_b, lb, c0, c1, d0, d1)
            if top + (c1 - c0) * (d1 - d0) > len(stack):
                stack = grown(stack)
            for c in range(c0, c1):
                for d in range(d0, d1):
                    to = off_b[lb] + c * tally_b[lb, 1] + d
                    boxes_tested += 1
                    if covers_b[to] and may_meet(boxes_a, corners_a, at, points_a, boxes_b, corners_b, to, points_b):
                        stack[top, 0], stack[top, 1], stack[top, 2] = la, ca, da
                        stack[top, 3], stack[top, 4], stack[top, 5] = lb, c, d
                        top += 1
            continue
        halves(points_a, ia, ja, rows_a, columns_a, wrap_ua, wrap_va, poles_a, tri_a)
        halves(points_b, ib, jb, rows_b, columns_b, wrap_ub, wrap_vb, poles_b, tri_b)
        for s in range(2):
            if not real(tri_a, s):
                continue
            take(points_a, tri_a, s, both, 0)
            for t in range(2):
                if not real(tri_b, t):
                    continue
                tests += 1
                take(points_b, tri_b, t, both, 3)
                relation = culled_tri_tri(both, segment, work)
                if relation == 0:
                    continue
                if count == len(triangles):
                    triangles, relations, segments = grown(triangles), grown(relations), longer(segments)
                for v in range(3):
                    triangles[count, v], triangles[count, 3 + v] = tri_a[s, v], tri_b[t, v]
                relations[count, 0] = relation
                relations[count, 1] = (2 * (ia * columns_a + ja) + s) * (2 * rows_b * columns_b)
                relations[count, 1] += 2 * (ib * columns_b + jb) + t
                for x in range(6):
                    segments[count, x] = segment[x]
                count += 1
    g.counters[4] += boxes_tested
    g.counters[6] += tests
    g.counters[7] += count
    return triangles[:count], relations[:count, 0].copy(), relations[:count, 1].copy(), segments[:count]


@njit
def first_pairs(
    g: Patch, boxes_a: Array, corners_a: Index, stamp_a: Index,
    h: Patch, boxes_b: Array, corners_b: Index, stamp_b: Index, stack: Index,
) -> int:  # fmt: skip
    """The window (4.4): pairs of spans whose boxes meet, into stack (n, 6); how many they are, only as many as fit are
    written."""
    near_spans(g, boxes_a, corners_a, stamp_a, h.box)
    near_spans(h, boxes_b, corners_b, stamp_b, g.box)
    across_a, across_b, points_a, points_b = g.tally[0, 1], h.tally[0, 1], g.points, h.points
    count = 0
    for k in range(len(g.box)):
        if not (stamp_a[k] == g.tick and g.covers[k]):
            continue
        for l in range(len(h.box)):
            if not (stamp_b[l] == h.tick and h.covers[l]):
                continue
            if may_meet(boxes_a, corners_a, k, points_a, boxes_b, corners_b, l, points_b):
                if count < len(stack):
                    stack[count, 0], stack[count, 1], stack[count, 2] = 0, k // across_a, k % across_a
                    stack[count, 3], stack[count, 4], stack[count, 5] = 0, l // across_b, l % across_b
                count += 1
    return count


@njit
def near_spans(g: Patch, boxes: Array, corners: Index, stamp: Index, other: Array) -> None:
    """Boxes of the spans whose own control points come near the whole box of the other's spans (n, 6)."""
    low, high = whole(other)
    across = g.tally[0, 1]
    for k in range(len(g.box)):
        if stamp[k] != g.tick and g.covers[k] and near(g.box, k, low, high, 0.0):
            fill_boxes(g, boxes, corners, stamp, 0, k // across, k // across + 1, k % across, k % across + 1)


@njit
def fill_boxes(
    g: Patch, boxes: Array, corners: Index, stamp: Index, level: int, c0: int, c1: int, d0: int, d1: int
) -> None:
    """Boxes and slabs of the cells (level, c0 to c1 - 1, d0 to d1 - 1): those of the corners, grown by the sag of the
    surface over the cell. A span's box lies within that of its own control points as well.

    boxes: low corner, high corner, longest side, sag, unit normal, and the lowest and highest place along it.
    """
    row_u, row_v, points, u, v, tick = g.row_u, g.row_v, g.points, g.u, g.v, g.tick
    m, n, wrap_u, wrap_v, poles = len(u), len(v), g.wrap_u, g.wrap_v, g.poles
    offset, across = g.offset[level], g.tally[level, 1]
    wide = d1 - d0 + 1
    names = np.empty((c1 - c0 + 1) * wide, np.int64)
    for c in range(c0, c1 + 1):
        for d in range(d0, d1 + 1):
            names[(c - c0) * wide + d - d0] = canonical(
                row_u[level, c], row_v[level, d], m, n, wrap_u, wrap_v, poles
            )  # fmt: skip
    make_points(g, names, len(names))
    for c in range(c0, c1):
        for d in range(d0, d1):
            at = offset + c * across + d
            stamp[at] = tick
            i, j = row_u[level, c], row_v[level, d]
            rows, columns = row_u[level, c + 1] - i, row_v[level, d + 1] - j
            sag = 0.0
            if rows > 1 or columns > 1:
                a, b = g.span_u[i], g.span_v[j]
                if abs(g.bounds_stamp[a, b]) != tick:
                    if g.rational:
                        g.bounds_stamp[a, b] = tick
                        span_bounds(
                            g.net, g.knots_u, g.knots_v, g.degree_u, g.degree_v, g.first_u[i], g.first_v[j], True,
                            g.bounds[a, b],
                        )  # fmt: skip
                    else:
                        # these two alone
                        g.bounds_stamp[a, b] = -tick
                        for k in (S_UU, S_VV):
                            g.bounds[a, b, k] = longest_difference(
                                g.net, g.knots_u, g.knots_v, g.degree_u, g.degree_v, g.first_u[i], g.first_v[j], False,
                                k, 0.0, 0.0, 0.0,
                            )[0]  # fmt: skip
                hu, hv = u[i + rows] - u[i], v[j + columns] - v[j]
                sag = (hu * hu * g.bounds[a, b, S_UU] + hv * hv * g.bounds[a, b, S_VV]) / 8.0 + g.slack
            longest = 0.0
            corner = (c - c0) * wide + d - d0
            p, q, r, s = names[corner], names[corner + 1], names[corner + wide], names[corner + wide + 1]
            corners[at, 0], corners[at, 1], corners[at, 2], corners[at, 3] = p, q, r, s
            for x in range(3):
                low = min(points[p, x], points[q, x], points[r, x], points[s, x]) - sag
                high = max(points[p, x], points[q, x], points[r, x], points[s, x]) + sag
                if level == 0 and (rows > 1 or columns > 1):
                    low, high = max(low, g.box[at, x] - g.slack), min(high, g.box[at, 3 + x] + g.slack)
                boxes[at, x], boxes[at, 3 + x] = low, high
                longest = max(longest, high - low)
            boxes[at, 6], boxes[at, 7] = longest, sag + g.slack
            # across the diagonals; any direction would be right
            ex, ey, ez = points[s, 0] - points[p, 0], points[s, 1] - points[p, 1], points[s, 2] - points[p, 2]
            fx, fy, fz = points[r, 0] - points[q, 0], points[r, 1] - points[q, 1], points[r, 2] - points[q, 2]
            nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            if length > 0.0:
                nx, ny, nz = nx / length, ny / length, nz / length
            boxes[at, 8], boxes[at, 9], boxes[at, 10] = nx, ny, nz
            low, high = reach_along(points, corners, at, nx, ny, nz)
            boxes[at, 11], boxes[at, 12] = low - boxes[at, 7], high + boxes[at, 7]


@njit_inline
def reach_along(points: Array, corners: Index, k: int, x: float, y: float, z: float) -> tuple[float, float]:
    """The lowest and the highest place of a cell's corners along a direction."""
    p, q, r, s = corners[k, 0], corners[k, 1], corners[k, 2], corners[k, 3]
    a = points[p, 0] * x + points[p, 1] * y + points[p, 2] * z
    b = points[q, 0] * x + points[q, 1] * y + points[q, 2] * z
    c = points[r, 0] * x + points[r, 1] * y + points[r, 2] * z
    d = points[s, 0] * x + points[s, 1] * y + points[s, 2] * z
    return min(a, b, c, d), max(a, b, c, d)


@njit_inline
def may_meet(
    boxes_a: Array, corners_a: Index, a: int, points_a: Array, boxes_b: Array, corners_b: Index, b: int, points_b: Array
) -> bool:
    """Neither the boxes nor the slab of either part two cells. A place along a normal is a sum of three products, whose
    rounding is far below the slack that the sags hold."""
    if not overlap(boxes_a, a, boxes_b, b):
        return False
    low, high = reach_along(points_b, corners_b, b, boxes_a[a, 8], boxes_a[a, 9], boxes_a[a, 10])
    if low - boxes_b[b, 7] > boxes_a[a, 12] or high + boxes_b[b, 7] < boxes_a[a, 11]:
        return False
    low, high = reach_along(points_a, corners_a, a, boxes_b[b, 8], boxes_b[b, 9], boxes_b[b, 10])
    return bool(low - boxes_a[a, 7] <= boxes_b[b, 12] and high + boxes_a[a, 7] >= boxes_b[b, 11])


@njit_inline
def overlap(boxes_a: Array, a: int, boxes_b: Array, b: int) -> bool:
    """Two boxes have a common point."""
    return bool(
        boxes_a[a, 0] <= boxes_b[b, 3] and boxes_b[b, 0] <= boxes_a[a, 3]
        and boxes_a[a, 1] <= boxes_b[b, 4] and boxes_b[b, 1] <= boxes_a[a, 4]
        and boxes_a[a, 2] <= boxes_b[b, 5] and boxes_b[b, 2] <= boxes_a[a, 5]
    )  # fmt: skip


@njit_inline
def halves(
    points: Array, i: int, j: int, m: int, n: int, wrap_u: bool, wrap_v: bool, poles: int, triangles: Index
) -> None:
    """The two triangles of a finest cell (`triangulate`), into triangles (2, 3)."""
    a = canonical(i, j, m, n, wrap_u, wrap_v, poles)
    c = canonical(i + 1, j, m, n, wrap_u, wrap_v, poles)
    b = canonical(i + 1, j + 1, m, n, wrap_u, wrap_v, poles)
    d = canonical(i, j + 1, m, n, wrap_u, wrap_v, poles)
    if distance2(points, a, b) <= distance2(points, c, d):
        triangles[0, 0], triangles[0, 1], triangles[0, 2] = a, c, b
        triangles[1, 0], triangles[1, 1], triangles[1, 2] = a, b, d
    else:
        triangles[0, 0], triangles[0, 1], triangles[0, 2] = a, c, d
        triangles[1, 0], triangles[1, 1], triangles[1, 2] = c, b, d


@njit_inline
def real(triangles: Index, t: int) -> bool:
    """A triangle with three vertices of its own: not one that a seam or a pole has closed up."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    return bool(a != b and b != c and c != a)


@njit_inline
def take(points: Array, triangles: Index, t: int, both: Array, to: int) -> None:
    """The vertices of a triangle into rows `to` to `to` + 2."""
    for v in range(3):
        for x in range(3):
            both[to + v, x] = points[triangles[t, v], x]
