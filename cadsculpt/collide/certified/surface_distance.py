"""Certified distance of two B-spline bodies: branch and bound over pairs of cells.

Lower bounds come from the cells (`pair_bounds`), upper bounds from pairs of real points (`nearest_pair`). Pairs are cut in
waves, the more doubtful cell of each in two. A lower bound is short by the square of the cells' size, so around a closest
pair only a bounded number of pairs survives each wave; where the surfaces run along each other (coaxial, concentric) it is
many, and the budget may end first: what is proved until then is the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...spline.region import MIXED, OFF, Region
from ..cells import WHOLE
from ..workspace import spans_of
from .body import CellStore, SurfaceBody
from .interval import Goal, Search, Witness
from .nearest_pair import nearest_pair
from .pair_bounds import pair_bounds

Array = NDArray[np.float64]
Index = NDArray[np.int64]

WAVE = 20000
"""Most pairs cut in one wave; those with the lowest bounds come first."""

TRIES = 3
"""Pairs of a wave from which a closest pair of points is sought."""

GROUP = 32
"""Pairs of patches opened at once, nearest boxes first: the first ones' points spare most of the others."""


@dataclass(slots=True, eq=False)
class _Frontier:
    """Pairs of cells (places in the two stores) not settled yet, with their lower bounds."""

    a: Index = field(default_factory=lambda: np.zeros(0, np.int64))
    b: Index = field(default_factory=lambda: np.zeros(0, np.int64))
    lower: Array = field(default_factory=lambda: np.zeros(0))

    def take(self, which: Index | NDArray[np.bool_]) -> _Frontier:
        return _Frontier(self.a[which], self.b[which], self.lower[which])

    def join(self, other: _Frontier) -> _Frontier:
        return _Frontier(*(np.concatenate([getattr(self, n), getattr(other, n)]) for n in ("a", "b", "lower")))


def surface_distance(a: SurfaceBody, b: SurfaceBody, goal: Goal) -> Search:
    """The distance of two B-spline bodies' faces."""
    search = Search(goal)
    stores = CellStore(a), CellStore(b)
    waiting_a, waiting_b, waiting = _patch_pairs(a, b, search)
    tried: set[tuple[float, ...]] = set()
    front, opened = _Frontier(), 0
    while True:
        # open the pairs of patches that may still hold something nearer, a few at a time
        if (
            opened < len(waiting)
            and waiting[opened] < search.cutoff
            and (len(front.a) == 0 or waiting[opened] <= front.lower.min())
        ):
            stop = min(opened + GROUP, len(waiting))
            front = _opened(stores, waiting_a[opened:stop], waiting_b[opened:stop], front, search)
            opened = stop
        front = _pruned(front, search)
        rest = waiting[opened] if opened < len(waiting) else np.inf
        if rest >= search.cutoff:
            search.settle(float(rest))
            opened = len(waiting)
        search.bound(min(float(front.lower.min(initial=np.inf)), float(rest)))
        if search.ended or (len(front.a) == 0 and opened == len(waiting)):
            return search
        if len(front.a) == 0:
            continue
        _improve(stores, front, search, tried)
        front = _pruned(front, search)
        if len(front.a):
            front = _cut(stores, front, search)


def _patch_pairs(a: SurfaceBody, b: SurfaceBody, search: Search) -> tuple[Index, Index, Array]:
    """Pairs of patches by the distance of their boxes, nearest first; those that cannot hold the distance are left out."""
    apart = np.maximum(a.extents[:, None, 0] - b.extents[None, :, 1], b.extents[None, :, 0] - a.extents[:, None, 1])
    lower = np.linalg.norm(np.maximum(apart, 0.0), axis=2)
    across = np.maximum(
        np.abs(a.extents[:, None, 0] - b.extents[None, :, 1]), np.abs(a.extents[:, None, 1] - b.extents[None, :, 0])
    )
    upper = np.linalg.norm(across, axis=2)
    scale = max(float(np.abs(a.extents).max()), float(np.abs(b.extents).max()))
    # there is a point of a face in every box: no pair is farther apart than the boxes' farthest corners
    search.lower_high(float(upper.min()) + 1e-14 * scale, None, None)
    lower = np.maximum(lower - 1e-14 * scale, 0.0)
    i, j = np.nonzero(lower <= search.high)
    search.settle(float(lower[lower > search.high].min(initial=np.inf)))
    order = np.argsort(lower[i, j], kind="stable")
    return i[order], j[order], lower[i, j][order]


def _opened(stores: tuple[CellStore, CellStore], i: Index, j: Index, front: _Frontier, search: Search) -> _Frontier:
    """The frontier with the pairs of spans of these pairs of patches."""
    places: tuple[dict[int, Index], dict[int, Index]] = ({}, {})
    for store, patches, known in zip(stores, (i, j), places, strict=True):
        for k in np.unique(patches).tolist():
            known[k] = store.spans(k)
    pairs = [np.zeros((0, 2), np.int64)]
    for k, l in zip(i.tolist(), j.tolist(), strict=True):
        mine, its = places[0][k], places[1][l]
        pairs.append(np.stack([np.repeat(mine, len(its)), np.tile(its, len(mine))], axis=1))
    both = np.concatenate(pairs)
    return front.join(_bounded(stores, both, np.zeros(len(both)), search))


def _bounded(stores: tuple[CellStore, CellStore], pairs: Index, known: Array, search: Search) -> _Frontier:
    a, b = stores
    lower = np.empty(len(pairs))
    pair_bounds(a.hull, a.grown, a.ball, b.hull, b.grown, b.ball, pairs, known, search.cutoff, lower)
    search.pairs += len(pairs)
    return _Frontier(np.ascontiguousarray(pairs[:, 0]), np.ascontiguousarray(pairs[:, 1]), lower)


def _pruned(front: _Frontier, search: Search) -> _Frontier:
    """Without the pairs that cannot hold a distance below what is looked for."""
    keep = front.lower < search.cutoff
    if keep.all():
        return front
    search.settle(float(front.lower[~keep].min()))
    return front.take(keep)


def _cut(stores: tuple[CellStore, CellStore], front: _Frontier, search: Search) -> _Frontier:
    """Cut the more doubtful cell of each pair, of the pairs with the lowest bounds where there are many."""
    a, b = stores
    front = _renumbered(stores, front)
    wave = min(WAVE, max(1, search.left // 2))
    rest = _Frontier()
    if len(front.a) > wave:
        order = np.argsort(front.lower, kind="stable")
        rest, front = front.take(np.sort(order[wave:])), front.take(np.sort(order[:wave]))
    # flat cells are cut too where nothing else is left, by their size
    worth_a = np.where(a.cut == WHOLE, -1.0, a.doubt + 1e-6 * a.ball[:, 3])[front.a]
    worth_b = np.where(b.cut == WHOLE, -1.0, b.doubt + 1e-6 * b.ball[:, 3])[front.b]
    final = (worth_a < 0.0) & (worth_b < 0.0)
    if final.any():
        search.settle(float(front.lower[final].min()))
    parts = []
    for side, chosen in ((0, ~final & (worth_a >= worth_b)), (1, ~final & (worth_a < worth_b))):
        if not chosen.any():
            continue
        mine, other, known = (front.a, front.b)[side][chosen], (front.b, front.a)[side][chosen], front.lower[chosen]
        cells, which = np.unique(mine, return_inverse=True)
        first, places = stores[side].halve(cells)
        count = (first[1:] - first[:-1])[which]
        owner = np.repeat(np.arange(len(mine)), count)
        inner = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
        child = places[first[which][owner] + inner]
        columns = (child, other[owner]) if side == 0 else (other[owner], child)
        parts.append((np.stack(columns, axis=1), known[owner]))
    for pairs, known in parts:
        rest = rest.join(_bounded(stores, pairs, known, search))
    return rest


def _renumbered(stores: tuple[CellStore, CellStore], front: _Frontier) -> _Frontier:
    """Forget the cells that no pair of the frontier needs."""
    columns = []
    for store, column in zip(stores, (front.a, front.b), strict=True):
        used, places = np.unique(column, return_inverse=True)
        store.only(used)
        columns.append(places)
    return _Frontier(columns[0], columns[1], front.lower)


def _improve(
    stores: tuple[CellStore, CellStore], front: _Frontier, search: Search, tried: set[tuple[float, ...]]
) -> None:
    """Real points: from the pairs with the lowest bounds, the local closest pair of points of the two faces."""
    order = np.argsort(front.lower, kind="stable")[: 4 * TRIES]
    done = 0
    for k in order.tolist():
        at = front.a[k], front.b[k]
        key = (
            *(float(x) for x in stores[0].rectangle[at[0]]), *(float(x) for x in stores[1].rectangle[at[1]]),
            float(stores[0].patch[at[0]]), float(stores[1].patch[at[1]]),
        )  # fmt: skip
        if key in tried or _holds(stores, at, search):
            continue
        tried.add(key)
        _from_poles(stores, at, search, tried)
        _closest(stores, at, search)
        done += 1
        if done == TRIES or search.high <= search.goal.enough:
            return


def _holds(stores: tuple[CellStore, CellStore], at: tuple[int, int], search: Search) -> bool:
    """Whether the pair of cells holds the closest points found, both free: Newton would only find them again."""
    for store, k, w in zip(stores, at, (search.a, search.b), strict=True):
        if w is None or store.patch[k] != w.face or store.on[k] == MIXED:
            return False
        r = store.rectangle[k]
        if not (r[0] <= w.u <= r[1] and r[2] <= w.v <= r[3]):
            return False
    return True


_FREE = [(np.full((2, 2), np.nan), 0.0, 0.0)]
"""No chord: the point is free."""


def _closest(stores: tuple[CellStore, CellStore], at: tuple[int, int], search: Search) -> None:
    """Newton from the middle of a pair of cells; where that leaves a trimmed face, along the pieces of its border that
    the cell holds."""
    if _from_chords(stores, at, search, _FREE, _FREE) is None:
        return
    borders = [_FREE, _FREE]
    for side in range(2):
        k = at[side]
        region = stores[side].body.region(int(stores[side].patch[k]))
        if region is not None and stores[side].on[k] == MIXED:
            borders[side] = region.border_in(stores[side].rectangle[k]) or _FREE
    off = _from_chords(stores, at, search, borders[0], _FREE) if borders[0] is not _FREE else (False, True)
    if borders[1] is not _FREE and off is not None:
        _from_chords(stores, at, search, _FREE, borders[1])
        if borders[0] is not _FREE:
            _from_chords(stores, at, search, borders[0], borders[1])


def _from_poles(
    stores: tuple[CellStore, CellStore], at: tuple[int, int], search: Search, tried: set[tuple[float, ...]]
) -> None:
    """Once for a pair of patches: the closest pairs near their poles, which Newton reaches slowly from beside them."""
    faces = tuple(int(store.patch[k]) for store, k in zip(stores, at, strict=True))
    if tuple(map(float, faces)) in tried:
        return
    tried.add(tuple(map(float, faces)))
    for side in range(2):
        g = stores[side].body.patch(faces[side])
        for bit, u, v in ((1, g.u[0], None), (2, g.u[-1], None), (4, None, g.v[0]), (8, None, g.v[-1])):
            if g.poles & bit:
                r, other = stores[side].rectangle[at[side]], stores[1 - side].rectangle[at[1 - side]]
                u, v = 0.5 * (r[0] + r[1]) if u is None else u, 0.5 * (r[2] + r[3]) if v is None else v
                # the other surface's point nearest to the pole, then both free
                held, free = np.array([[u, v], [u, v]]), np.full((2, 2), np.nan)
                its = 0.5 * (other[0] + other[1]), 0.5 * (other[2] + other[3])
                one, two = stores[0].body.patch(faces[0]), stores[1].body.patch(faces[1])
                x = np.array([0.0, 0.0, *its] if side == 0 else [*its, 0.0, 0.0])
                chords = (held, free) if side == 0 else (free, held)
                nearest_pair(spans_of(one), spans_of(two), x, chords[0], chords[1], np.empty((4, 3)))
                _from_chords(stores, at, search, _FREE, _FREE, x)


def _from_chords(
    stores: tuple[CellStore, CellStore], at: tuple[int, int], search: Search,
    chords_a: list[tuple[Array, float, float]], chords_b: list[tuple[Array, float, float]],
    start: Array | None = None,
) -> tuple[bool, bool] | None:  # fmt: skip
    """Closest pairs with either point on one of the chords, or free. None where all were on both faces, else whether
    one was off the first, the second face."""
    bodies = stores[0].body, stores[1].body
    k, l = int(stores[0].patch[at[0]]), int(stores[1].patch[at[1]])
    one, two = spans_of(bodies[0].patch(k)), spans_of(bodies[1].patch(l))
    r, s = stores[0].rectangle[at[0]], stores[1].rectangle[at[1]]
    off_a, off_b = False, False
    middle = np.array([0.5 * (r[0] + r[1]), 0.5 * (r[2] + r[3]), 0.5 * (s[0] + s[1]), 0.5 * (s[2] + s[3])])
    for chord_a, start_a, width_a in chords_a:
        for chord_b, start_b, width_b in chords_b:
            x = (middle if start is None else start).copy()
            held_a, held_b = bool(np.isfinite(chord_a[0, 0])), bool(np.isfinite(chord_b[0, 0]))
            x[0], x[2] = start_a if held_a else x[0], start_b if held_b else x[2]
            found = np.empty((4, 3))
            d = nearest_pair(one, two, x, chord_a, chord_b, found) + one.slack + two.slack
            wide_a = _border(bodies[0].region(k), x[:2], found[2], held_a, width_a)
            wide_b = _border(bodies[1].region(l), x[2:], found[3], held_b, width_b)
            off_a, off_b = off_a or wide_a is None, off_b or wide_b is None
            if wide_a is not None and wide_b is not None:
                search.lower_high(
                    d + wide_a + wide_b, Witness(found[0], k, float(x[0]), float(x[1])),
                    Witness(found[1], l, float(x[2]), float(x[3])),
                )  # fmt: skip
    return (off_a, off_b) if off_a or off_b else None


def _border(region: Region | None, uv: Array, speed: Array, held: bool, width: float) -> float | None:
    """How far a point of the face may be from S(u, v), because the border is known to a width only; None off the face."""
    if region is None:
        return 0.0
    if not held:
        place = int(region.locate(uv)[0])
        if place == OFF:
            return None
        width = region.width if place == MIXED else 0.0
    return width * float(speed[0] * region.size[0] + speed[1] * region.size[1])
