"""The loop of paper section 4.5: spheres that intersect are refined, the others discarded, level by level.

`refine` takes one step of it for a patch alone (against an implicit tool, 4.9.1); `traverse` takes all steps for two patches.
The loop ends where all rows and columns are used, where a cell is flat (4.5.1: in paper mode its normals agree within delta;
in certified mode its triangles lie within the tolerance of the surface), and early where all spheres of a level intersect
(4.5.1). Taken literally, that last rule stops at the first level of any pair that begins with one sphere each, however
coarse; so in certified mode it only ends the loop where nothing is given up by it: against an implicit tool, whose contacts
are found on the finest vertices in any case, as soon as these cost less than more levels; between two patches, where every
cell is flat.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit
from .spheres import make_spheres
from .workspace import Patch, canonical, grown, make_points

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

ALL_SPANS = np.zeros(0, dtype=np.bool_)
"""No window: every span."""

LAST_ROWS = 4
"""Against an implicit tool, cells of up to this many rows and columns give up their vertices at once: a vertex costs a third of
a sphere, so that finer spheres would cost more than they save."""

ALL_MET_ROWS = 16
"""The same where all spheres of a level intersect the tool: finer ones could discard little."""

SIZES = 2.0
"""Of two intersecting spheres only the larger is refined when it is this many times larger (certified mode)."""


@njit
def spheres_of(g: Patch, cells: Index) -> tuple[Array, Array]:
    """Centres (n, 3) and radii (n,) of cells whose spheres are made."""
    offset, tally, spheres = g.offset, g.count, g.spheres
    centre, radius = np.empty((len(cells), 3)), np.empty(len(cells))
    for t in range(len(cells)):
        at = offset[cells[t, 0]] + cells[t, 1] * tally[cells[t, 0], 1] + cells[t, 2]
        for c in range(3):
            centre[t, c] = spheres[at, c]
        radius[t] = spheres[at, 3]
    return centre, radius


@njit
def covered_spans(g: Patch, window: Mask) -> tuple[Index, Array, Array]:
    """Level 0: the cells (0, ku, kv) of the knot spans that the face reaches, with their spheres' centres and radii.

    window (spans,) : those to take; empty for all.
    """
    cells = np.empty((g.count[0, 0] * g.count[0, 1], 3), np.int64)
    count = 0
    for k in range(len(cells)):
        if g.covers[k] and (len(window) == 0 or window[k]):
            cells[count, 0], cells[count, 1], cells[count, 2] = 0, k // g.count[0, 1], k % g.count[0, 1]
            count += 1
    make_spheres(g, cells, count)
    g.counters[1] += count
    centre, radius = spheres_of(g, cells[:count])
    return cells[:count], centre, radius


@njit
def refine(g: Patch, cells: Index, distance: Array, margin: float) -> tuple[Index, Array, Array, bool]:
    """One level (4.5): cells (n, 3) of one level whose spheres come within `margin` of the tool, split; the others discarded.

    distance (n,) : signed distance of each sphere's centre from the tool; what is deep inside is kept as well, and so is a
    NaN. Returns the children with their spheres' centres and radii, and False; or, when the loop ends here, the cells kept
    themselves, and True.
    """
    level, last = cells[0, 0], len(g.offset) - 2
    offset, across, spheres, covers = g.offset[level], g.count[level, 1], g.spheres, g.covers
    row_u, row_v, child_u, child_v = g.row_u, g.row_v, g.child_u, g.child_v
    g.counters[8] += 1
    g.counters[4] += len(cells)
    kept, most = 0, 0
    for t in range(len(cells)):
        ku, kv = cells[t, 1], cells[t, 2]
        at = offset + ku * across + kv
        if not distance[t] > spheres[at, 3] + margin:
            cells[kept, 0], cells[kept, 1], cells[kept, 2] = level, ku, kv
            kept += 1
            most = max(most, row_u[level, ku + 1] - row_u[level, ku], row_v[level, kv + 1] - row_v[level, kv])
    all_met = level > 0 and kept == len(cells)
    if g.paper:
        ended = level == last or all_met
    else:
        ended = most <= (ALL_MET_ROWS if all_met else LAST_ROWS)
    if ended or kept == 0:
        none = np.empty((0, 3))
        return cells[:kept], none, none[:, 0].copy(), True
    most = 1
    for t in range(kept):
        ku, kv = cells[t, 1], cells[t, 2]
        most = max(most, (child_u[level, ku + 1] - child_u[level, ku]) * (child_v[level, kv + 1] - child_v[level, kv]))
    children = np.empty((most * kept, 3), np.int64)
    count = 0
    offset, across = g.offset[level + 1], g.count[level + 1, 1]
    for t in range(kept):
        for ku in range(child_u[level, cells[t, 1]], child_u[level, cells[t, 1] + 1]):
            for kv in range(child_v[level, cells[t, 2]], child_v[level, cells[t, 2] + 1]):
                if not covers[offset + ku * across + kv]:
                    continue
                children[count, 0], children[count, 1], children[count, 2] = level + 1, ku, kv
                count += 1
    make_spheres(g, children, count)
    centre, radius = spheres_of(g, children[:count])
    return children[:count], centre, radius, False


@njit
def vertices_of(g: Patch, cells: Index, mark: int) -> Index:
    """Flat names of all finest vertices on the face that the cells hold and that do not carry `mark` in g.visit yet; they get
    it, and their points are made."""
    m, n = len(g.u), len(g.v)
    visit, on_face = g.visit, g.inside
    row_u, row_v, wrap_u, wrap_v, poles = g.row_u, g.row_v, g.wrap_u, g.wrap_v, g.poles
    names = np.empty((256, 1), np.int64)
    count = 0
    for t in range(len(cells)):
        level, ku, kv = cells[t, 0], cells[t, 1], cells[t, 2]
        i0, i1, j0, j1 = row_u[level, ku], row_u[level, ku + 1], row_v[level, kv], row_v[level, kv + 1]
        while count + (i1 - i0 + 1) * (j1 - j0 + 1) > len(names):
            names = grown(names)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                k = canonical(i, j, m, n, wrap_u, wrap_v, poles)
                if visit[k] != mark and on_face[k]:
                    visit[k] = mark
                    names[count, 0] = k
                    count += 1
    found = names[:count, 0].copy()
    make_points(g, found, count)
    return found


@njit
def plan(
    a: Patch, b: Patch, pairs: Index, count: int, tolerance: float, mark_a: int, mark_b: int, split: Mask, fresh: Index
) -> tuple[Index, int]:
    """Which cells of pairs[:count] to split, into split (count, 2), and the spheres of their children.

    A cell is split unless nothing is left to refine in it; of two unequal ones (certified mode), the larger first. Returns
    an array (`fresh`, or a longer one) and the number of children; these carry the mark, and slot 0.
    """
    off_a, tally_a, ball_a, child_ua, child_va = a.offset, a.count, a.spheres, a.child_u, a.child_v
    off_b, tally_b, ball_b, child_ub, child_vb = b.offset, b.count, b.spheres, b.child_u, b.child_v
    for t in range(count):
        at = off_a[pairs[t, 0]] + pairs[t, 1] * tally_a[pairs[t, 0], 1] + pairs[t, 2]
        to = off_b[pairs[t, 3]] + pairs[t, 4] * tally_b[pairs[t, 3], 1] + pairs[t, 5]
        mine, its = ball_a[at, 4] > tolerance, ball_b[to, 4] > tolerance
        if mine and its and not a.paper and pairs[t, 0] > 0 and pairs[t, 3] > 0:
            mine, its = SIZES * ball_a[at, 3] >= ball_b[to, 3], SIZES * ball_b[to, 3] >= ball_a[at, 3]
        split[t, 0], split[t, 1] = mine, its
    generated = 0
    for body in range(2):
        g = a if body == 0 else b
        o, mark = (0, mark_a) if body == 0 else (3, mark_b)
        offset, tally = (off_a, tally_a) if body == 0 else (off_b, tally_b)
        child_u, child_v = (child_ua, child_va) if body == 0 else (child_ub, child_vb)
        marks, slot, covers = g.mark, g.slot, g.covers
        wanted = 0
        while 4 * count > len(fresh):
            fresh = grown(fresh)
        for t in range(count):
            if not split[t, body]:
                continue
            level, ku, kv = pairs[t, o], pairs[t, o + 1], pairs[t, o + 2]
            # a cell whose first child carries the mark has been here
            first = offset[level + 1] + child_u[level, ku] * tally[level + 1, 1] + child_v[level, kv]
            if marks[first] == mark:
                continue
            for c in range(child_u[level, ku], child_u[level, ku + 1]):
                for d in range(child_v[level, kv], child_v[level, kv + 1]):
                    at = offset[level + 1] + c * tally[level + 1, 1] + d
                    marks[at] = mark
                    slot[at] = 0
                    if not covers[at]:
                        continue
                    fresh[wanted, 0], fresh[wanted, 1], fresh[wanted, 2] = level + 1, c, d
                    wanted += 1
        make_spheres(g, fresh, wanted)
        generated += wanted
    return fresh, generated


@njit
def traverse(
    a: Patch, b: Patch, spans: Index, margin: float, tolerance: float, mark_a: int, mark_b: int
) -> tuple[Index, Index, Index]:
    """The loop of 4.5 over two patches, from pairs of spans (n, 2) to pairs of cells that nothing is left to refine in.

    Only children of intersecting spheres are tested against each other. Returns the cells of a (na, 3), of b (nb, 3) and the
    pairs (k, 2) of their places in these whose spheres come within `margin` of each other. mark_a, mark_b : numbers new to
    a.mark and b.mark.
    """
    count = len(spans)
    pairs, survivors = np.empty((max(256, count), 6), np.int64), np.empty((256, 6), np.int64)
    for t in range(count):
        pairs[t, 0], pairs[t, 3] = 0, 0
        pairs[t, 1], pairs[t, 2] = spans[t, 0] // a.count[0, 1], spans[t, 0] % a.count[0, 1]
        pairs[t, 4], pairs[t, 5] = spans[t, 1] // b.count[0, 1], spans[t, 1] % b.count[0, 1]
    split = np.empty((max(256, count), 2), np.bool_)
    fresh = np.empty((256, 3), np.int64)
    done = np.empty((256, 6), np.int64)
    finished, tests, ended = 0, 0, False
    off_a, tally_a, child_ua, child_va, covers_a, ball_a, slot_a = (
        a.offset, a.count, a.child_u, a.child_v, a.covers, a.spheres, a.slot,
    )  # fmt: skip
    off_b, tally_b, child_ub, child_vb, covers_b, ball_b, slot_b = (
        b.offset, b.count, b.child_u, b.child_v, b.covers, b.spheres, b.slot,
    )  # fmt: skip
    while count > 0:
        if len(split) < count:
            split = np.empty((2 * count, 2), np.bool_)
        generated = 0
        if not ended:
            a.counters[8] += 1
            fresh, generated = plan(a, b, pairs, count, tolerance, mark_a, mark_b, split, fresh)
        surviving, met = 0, 0
        while finished + count > len(done):
            done = grown(done)
        for t in range(count):
            if ended or not (split[t, 0] or split[t, 1]):
                for c in range(6):
                    done[finished, c] = pairs[t, c]
                finished += 1
                continue
            la, ca0, da0, lb, cb0, db0 = pairs[t, 0], pairs[t, 1], pairs[t, 2], pairs[t, 3], pairs[t, 4], pairs[t, 5]
            ca1, da1, cb1, db1 = ca0 + 1, da0 + 1, cb0 + 1, db0 + 1
            if split[t, 0]:
                ca0, ca1, da0, da1 = child_ua[la, ca0], child_ua[la, ca1], child_va[la, da0], child_va[la, da1]
                la += 1
            if split[t, 1]:
                cb0, cb1, db0, db1 = child_ub[lb, cb0], child_ub[lb, cb1], child_vb[lb, db0], child_vb[lb, db1]
                lb += 1
            while surviving + (ca1 - ca0) * (da1 - da0) * (cb1 - cb0) * (db1 - db0) > len(survivors):
                survivors = grown(survivors)
            for ca in range(ca0, ca1):
                for da in range(da0, da1):
                    at = off_a[la] + ca * tally_a[la, 1] + da
                    if not covers_a[at]:
                        continue
                    x, y, z, r = ball_a[at, 0], ball_a[at, 1], ball_a[at, 2], ball_a[at, 3] + margin
                    for cb in range(cb0, cb1):
                        for db in range(db0, db1):
                            to = off_b[lb] + cb * tally_b[lb, 1] + db
                            if not covers_b[to]:
                                continue
                            tests += 1
                            p, q, s = x - ball_b[to, 0], y - ball_b[to, 1], z - ball_b[to, 2]
                            reach = r + ball_b[to, 3]
                            if p * p + q * q + s * s > reach * reach:
                                continue
                            survivors[surviving, 0], survivors[surviving, 1], survivors[surviving, 2] = la, ca, da
                            survivors[surviving, 3], survivors[surviving, 4], survivors[surviving, 5] = lb, cb, db
                            surviving += 1
                            if slot_a[at] == 0:
                                slot_a[at] = 1
                                met += split[t, 0]
                            if slot_b[to] == 0:
                                slot_b[to] = 1
                                met += split[t, 1]
        pairs, survivors = survivors, pairs
        count = surviving
        # 4.5.1: all spheres generated at this level, on both bodies, intersect
        ended = a.paper and generated > 0 and met == generated
    a.counters[4] += tests
    return numbered(a, b, done, finished, mark_a + 1, mark_b + 1)


@njit
def numbered(a: Patch, b: Patch, pairs: Index, count: int, mark_a: int, mark_b: int) -> tuple[Index, Index, Index]:
    """The distinct cells of a and of b in pairs[:count], in the order they come, and the pairs in these numbers."""
    cells_a, cells_b = np.empty((count, 3), np.int64), np.empty((count, 3), np.int64)
    out = np.empty((count, 2), np.int64)
    totals = np.zeros(2, np.int64)
    for body in range(2):
        g = a if body == 0 else b
        mark = mark_a if body == 0 else mark_b
        cells = cells_a if body == 0 else cells_b
        o = 3 * body
        total = 0
        for t in range(count):
            at = g.offset[pairs[t, o]] + pairs[t, o + 1] * g.count[pairs[t, o], 1] + pairs[t, o + 2]
            if g.mark[at] != mark:
                g.mark[at] = mark
                g.slot[at] = total
                for c in range(3):
                    cells[total, c] = pairs[t, o + c]
                total += 1
            out[t, body] = g.slot[at]
        totals[body] = total
    return cells_a[: totals[0]], cells_b[: totals[1]], out
