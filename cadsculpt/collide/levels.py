"""The loop of paper section 4.5: spheres that intersect are refined, the others discarded, level by level.

`refine` takes one step of it for a patch alone (against an implicit tool, 4.9.1); `traverse` takes all steps for two
patches. The loop ends where all rows and columns are used, where a cell is flat (4.5.1: in paper mode its normals
agree within delta; in certified mode its triangles lie within the tolerance of the surface), and early where all
spheres of a level intersect (4.5.1). Taken literally, that last rule stops at the first level of any pair that begins
with one sphere each, however coarse; so in certified mode it only ends the loop where nothing is given up by it:
against an implicit tool, whose contacts are found on the finest vertices in any case, as soon as these cost less than
more levels; between two patches, where every cell is flat.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit, njit_in_place
from .spheres import fill_spheres, make_spheres
from .workspace import Patch, Tree, Workspace, canonical, grown, make_points, tree_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

LAST_ROWS = 4
"""Against an implicit tool, cells of up to this many rows and columns give up their vertices at once: a vertex costs a
third of a sphere, so that finer spheres would cost more than they save."""

ALL_MET_ROWS = 16
"""The same where all spheres of a level intersect the tool: finer ones could discard little."""

SIZES = 2.0
"""Of two intersecting spheres only the larger is refined when it is this many times larger (certified mode)."""


def window_cells(work: Workspace, window: Mask | None = None) -> tuple[Index, Array, Array]:
    """Level 0: the cells (n, 3) of the knot spans that the face reaches (and a window (spans,) takes), their spheres'
    centres (n, 3) and radii (n,)."""
    g, cells = work.patch, work.grid.spans
    if window is not None:
        cells = cells[window[cells[:, 1] * g.tally[0, 1] + cells[:, 2]]]
    g.counters[1] += len(cells)
    centre, radius = make_spheres(g, cells, len(cells))
    return cells, centre, radius


@njit
def refine(g: Patch, cells: Index, distance: Array, margin: float) -> tuple[Index, Array, bool]:
    """One level (4.5): cells (n, 3) of one level whose spheres come within `margin` of the tool, split; the others
    discarded.

    distance (n,) : signed distance of each sphere's centre from the tool; what is deep inside is kept as well, and so
    is a NaN. Returns the children with their spheres' centres, and False; or, when the loop ends here, the cells kept
    themselves, and True.
    """
    near = cells.copy()
    kept, children = nearby(g, near, len(near), distance, margin)
    if children == 0:
        return near[:kept], np.zeros((0, 3)), True
    out = np.empty((children, 3), np.int64)
    count = split_cells(g, near, kept, out)
    return out[:count], make_spheres(g, out, count)[0], False


@njit_in_place
def nearby(g: Patch, cells: Index, count: int, distance: Array, margin: float) -> tuple[int, int]:
    """Drop those of cells[:count], of one level, whose spheres stay away from the tool; how many are left, in front, and
    at most how many children they have: 0 where the loop of 4.5 ends with them."""
    g.counters[8] += 1
    g.counters[4] += count
    level, last = cells[0, 0], len(g.offset) - 2
    offset, across, spheres = g.offset[level], g.tally[level, 1], g.spheres
    row_u, row_v, child_u, child_v = g.row_u, g.row_v, g.child_u, g.child_v
    kept, most, children = 0, 0, 1
    for t in range(count):
        ku, kv = cells[t, 1], cells[t, 2]
        at = offset + ku * across + kv
        if not distance[t] > spheres[at, 3] + margin:
            cells[kept, 0], cells[kept, 1], cells[kept, 2] = level, ku, kv
            kept += 1
            most = max(most, row_u[level, ku + 1] - row_u[level, ku], row_v[level, kv + 1] - row_v[level, kv])
            children = max(
                children, (child_u[level, ku + 1] - child_u[level, ku]) * (child_v[level, kv + 1] - child_v[level, kv])
            )
    all_met = level > 0 and kept == count
    if g.paper:
        ended = level == last or all_met
    else:
        ended = most <= (ALL_MET_ROWS if all_met else LAST_ROWS)
    return kept, 0 if ended else children * kept


@njit_in_place
def split_cells(g: Patch, cells: Index, count: int, out: Index) -> int:
    """The children of cells[:count], of one level, into out (n, 3); how many they are."""
    level = cells[0, 0]
    offset, across, covers = g.offset[level + 1], g.tally[level + 1, 1], g.covers
    child_u, child_v = g.child_u, g.child_v
    found = 0
    for t in range(count):
        for ku in range(child_u[level, cells[t, 1]], child_u[level, cells[t, 1] + 1]):
            for kv in range(child_v[level, cells[t, 2]], child_v[level, cells[t, 2] + 1]):
                if covers[offset + ku * across + kv]:
                    out[found, 0], out[found, 1], out[found, 2] = level + 1, ku, kv
                    found += 1
    return found


@njit
def vertices_of(g: Patch, cells: Index, mark: int) -> Index:
    """Flat names of all finest vertices on the face that the cells hold and that do not carry `mark` in g.visit yet;
    they get it, and their points are made."""
    row_u, row_v = g.row_u, g.row_v
    most = 0
    for t in range(len(cells)):
        level, ku, kv = cells[t, 0], cells[t, 1], cells[t, 2]
        most += (row_u[level, ku + 1] - row_u[level, ku] + 1) * (row_v[level, kv + 1] - row_v[level, kv] + 1)
    names = np.empty(min(most, len(g.visit)), np.int64)
    count = mark_vertices(g, cells, len(cells), mark, names)
    make_points(g, names, count)
    return names[:count].copy()


@njit_in_place
def mark_vertices(g: Patch, cells: Index, cells_count: int, mark: int, names: Index) -> int:
    """Mark the finest vertices on the face that cells[:cells_count] hold in g.visit; those that did not carry the mark
    into `names`, and how many they are."""
    row_u, row_v, visit, on_face, m, n = g.row_u, g.row_v, g.visit, g.inside, len(g.u), len(g.v)
    wrap_u, wrap_v, poles = g.wrap_u, g.wrap_v, g.poles
    count = 0
    for t in range(cells_count):
        level, ku, kv = cells[t, 0], cells[t, 1], cells[t, 2]
        for i in range(row_u[level, ku], row_u[level, ku + 1] + 1):
            for j in range(row_v[level, kv], row_v[level, kv + 1] + 1):
                k = canonical(i, j, m, n, wrap_u, wrap_v, poles)
                if visit[k] != mark and on_face[k]:
                    visit[k] = mark
                    names[count] = k
                    count += 1
    return count


@njit_in_place
def in_order(g: Patch, names: Index, count: int, mark: int) -> None:
    """Sort names[:count], all of which carry `mark` in g.visit and no other vertex does."""
    n, visit = len(g.v), g.visit
    i0, i1, j0, j1 = len(g.u), -1, n, -1
    for t in range(count):
        i, j = names[t] // n, names[t] % n
        i0, i1, j0, j1 = min(i0, i), max(i1, i), min(j0, j), max(j1, j)
    found = 0
    for i in range(i0, i1 + 1):
        for k in range(i * n + j0, i * n + j1 + 1):
            if visit[k] == mark:
                names[found] = k
                found += 1


@njit
def traverse(
    g: Patch, h: Patch, spans: Index, margin: float, tolerance: float, mark_a: int, mark_b: int
) -> tuple[Index, Index, Index]:
    """The loop of 4.5 over two patches a and b, from pairs of spans (n, 2) to pairs of cells with nothing left to
    refine.

    Only children of intersecting spheres are tested against each other. Returns the cells of a (na, 3), of b (nb, 3)
    and the pairs (k, 2) of their places in these whose spheres come within `margin` of each other. mark_a, mark_b :
    numbers new to g.mark and h.mark, as are those that follow them.
    """
    a, b = tree_of(g), tree_of(h)
    pairs, split = np.zeros((len(spans), 6), np.int64), np.ones((len(spans), 2), np.bool_)
    for t in range(len(spans)):
        pairs[t, 1], pairs[t, 2] = spans[t, 0] // a.tally[0, 1], spans[t, 0] % a.tally[0, 1]
        pairs[t, 4], pairs[t, 5] = spans[t, 1] // b.tally[0, 1], spans[t, 1] % b.tally[0, 1]
    fresh_a, fresh_b = children(a, pairs, 0, split, mark_a), children(b, pairs, 3, split, mark_b)
    done = np.empty((64, 6), np.int64)
    total = 0
    while len(pairs):
        g.counters[8] += 1
        fill_spheres(g, fresh_a, len(fresh_a))
        fill_spheres(h, fresh_b, len(fresh_b))
        pairs, finished, met, tests = meet(a, b, pairs, split, margin)
        g.counters[4] += tests
        done = appended(done, total, finished)
        total += len(finished)
        # 4.5.1: all spheres generated at this level, on both bodies, intersect
        if g.paper and met == len(fresh_a) + len(fresh_b):
            done = appended(done, total, pairs)
            total += len(pairs)
            break
        split, fresh_a, fresh_b = plan(a, b, pairs, tolerance, g.paper, mark_a, mark_b)
    cells_a, place_a = distinct(a, done[:total], 0, mark_a + 1)
    cells_b, place_b = distinct(b, done[:total], 3, mark_b + 1)
    both = np.empty((total, 2), np.int64)
    for t in range(total):
        both[t, 0], both[t, 1] = place_a[t], place_b[t]
    return cells_a, cells_b, both


@njit
def appended(rows: Index, count: int, more: Index) -> Index:
    """rows[:count] and behind them `more`, in an array that may be longer."""
    while count + len(more) > len(rows):
        rows = grown(rows)
    for t in range(len(more)):
        for c in range(rows.shape[1]):
            rows[count + t, c] = more[t, c]
    return rows


@njit
def plan(
    a: Tree, b: Tree, pairs: Index, tolerance: float, paper: bool, mark_a: int, mark_b: int
) -> tuple[Mask, Index, Index]:
    """Which cells of pairs (n, 6) (level, ku, kv of either) to split, (n, 2), and the children of either body's, each
    once.

    A cell is split unless nothing is left to refine in it; of two unequal ones (certified mode), the larger first.
    """
    off_a, tally_a, ball_a, off_b, tally_b, ball_b = a.offset, a.tally, a.spheres, b.offset, b.tally, b.spheres
    split = np.empty((len(pairs), 2), np.bool_)
    for t in range(len(pairs)):
        at = off_a[pairs[t, 0]] + pairs[t, 1] * tally_a[pairs[t, 0], 1] + pairs[t, 2]
        to = off_b[pairs[t, 3]] + pairs[t, 4] * tally_b[pairs[t, 3], 1] + pairs[t, 5]
        mine, its = ball_a[at, 4] > tolerance, ball_b[to, 4] > tolerance
        if mine and its and not paper and pairs[t, 0] > 0 and pairs[t, 3] > 0:
            mine, its = SIZES * ball_a[at, 3] >= ball_b[to, 3], SIZES * ball_b[to, 3] >= ball_a[at, 3]
        split[t, 0], split[t, 1] = mine, its
    return split, children(a, pairs, 0, split, mark_a), children(b, pairs, 3, split, mark_b)


@njit
def children(g: Tree, pairs: Index, o: int, split: Mask, mark: int) -> Index:
    """The children (k, 3) of one body's cells that are to be split, each once; they carry `mark`, and slot 0."""
    offset, tally, child_u, child_v = g.offset, g.tally, g.child_u, g.child_v
    marks, slot, covers = g.mark, g.slot, g.covers
    fresh = np.empty((256, 3), np.int64)
    count = 0
    for t in range(len(pairs)):
        if not split[t, o // 3]:
            continue
        level, ku, kv = pairs[t, o], pairs[t, o + 1], pairs[t, o + 2]
        # a cell whose first child carries the mark has been here
        if marks[offset[level + 1] + child_u[level, ku] * tally[level + 1, 1] + child_v[level, kv]] == mark:
            continue
        across_u, across_v = child_u[level, ku + 1] - child_u[level, ku], child_v[level, kv + 1] - child_v[level, kv]
        while count + across_u * across_v > len(fresh):
            fresh = grown(fresh)
        for c in range(child_u[level, ku], child_u[level, ku + 1]):
            for d in range(child_v[level, kv], child_v[level, kv + 1]):
                at = offset[level + 1] + c * tally[level + 1, 1] + d
                marks[at] = mark
                slot[at] = 0
                if covers[at]:
                    fresh[count, 0], fresh[count, 1], fresh[count, 2] = level + 1, c, d
                    count += 1
    return fresh[:count]


@njit
def meet(a: Tree, b: Tree, pairs: Index, split: Mask, margin: float) -> tuple[Index, Index, int, int]:
    """The pairs of children (or of cells not split) whose spheres intersect, and the pairs with nothing left to split;
    how many of the children have met another sphere, and how many tests that took."""
    off_a, tally_a, child_ua, child_va, covers_a, ball_a, slot_a = (
        a.offset, a.tally, a.child_u, a.child_v, a.covers, a.spheres, a.slot,
    )  # fmt: skip
    off_b, tally_b, child_ub, child_vb, covers_b, ball_b, slot_b = (
        b.offset, b.tally, b.child_u, b.child_v, b.covers, b.spheres, b.slot,
    )  # fmt: skip
    done = np.empty((len(pairs), 6), np.int64)
    survivors = np.empty((256, 6), np.int64)
    finished, surviving, met, tests = 0, 0, 0, 0
    for t in range(len(pairs)):
        if not (split[t, 0] or split[t, 1]):
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
    return survivors[:surviving], done[:finished], met, tests


@njit
def distinct(g: Tree, pairs: Index, o: int, mark: int) -> tuple[Index, Index]:
    """The distinct cells (k, 3) of one body in the order they come in pairs, and the place (n,) of each pair's among
    them."""
    offset, tally, marks, slot = g.offset, g.tally, g.mark, g.slot
    cells, place = np.empty((len(pairs), 3), np.int64), np.empty(len(pairs), np.int64)
    total = 0
    for t in range(len(pairs)):
        at = offset[pairs[t, o]] + pairs[t, o + 1] * tally[pairs[t, o], 1] + pairs[t, o + 2]
        if marks[at] != mark:
            marks[at] = mark
            slot[at] = total
            for c in range(3):
                cells[total, c] = pairs[t, o + c]
            total += 1
        place[t] = slot[at]
    return cells[:total], place
