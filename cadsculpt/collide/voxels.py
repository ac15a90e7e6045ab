"""Voxels about a surface: how far it is from each, and which of its cells can be nearest there.

What a voxel tells is found when a point first comes into it, by the search that `closest` makes for a group of points: the
descent through the levels of detail is then spared to all that come later. In its own frame nothing of a rigid tool changes,
and its voxels stay from step to step; those of a tool that changes its shape are forgotten with it. A voxel tells the same
whenever it is found, so that results do not depend on what came before.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..jit import njit_in_place, njit_inline_in_place
from .closest import approach, candidates, nearest_candidates
from .newton import NORMAL, U, V, polynomial
from .workspace import Patch, Search

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_VOXELS, MOST_KNOWN = 1 << 20, 1 << 14
"""Voxels of a tool, and how many of them are known at a time: when there are more, all are forgotten."""

PAD = 3
"""Voxels beyond the tool's box on all sides."""

HALF_DIAGONAL = 0.8660254037844387
"""Of a unit cube."""


class Voxels(NamedTuple):
    """low (3,), edge : where the grid of counts (3,) cubes begins, and their size. slot : the row of each cube, plus 1; 0 where
    it is not known.

    Of each row: names, the cube; foot (n, 9), its middle's distance from the surface, and u, v, S_u, S_v of the closest
    point; its candidates table[first[k] : first[k + 1]] and final[...], as in `closest.candidates`. used (1,) : rows.
    """

    low: Array
    edge: float
    counts: Index
    slot: NDArray[np.int32]
    names: Index
    foot: Array
    first: Index
    table: Array
    final: Index
    used: Index


def voxels_about(extent: Array, edge: float, cells: int, kept: Voxels | None = None) -> Voxels:
    """Voxels of about this edge about a box (2, 3), no more than MOST_VOXELS, of which nothing is known yet.

    cells : of the surface, at all levels. kept : of the same surface in another shape, whose memory they take over.
    """
    size = extent[1] - extent[0]
    if kept is not None:
        kept.slot[kept.names[: kept.used[0]]] = 0
        kept.used[0] = 0
    most = MOST_VOXELS if kept is None else len(kept.slot)
    while np.prod(np.ceil(size / edge) + 2.0 * PAD) > most:
        edge *= 1.1
    counts = np.ceil(size / edge).astype(np.int64) + 2 * PAD
    low = 0.5 * (extent[0] + extent[1]) - 0.5 * edge * counts
    if kept is not None:
        return kept._replace(low=low, edge=edge, counts=counts)
    # half as many again: a tool that changes its shape may grow
    slots, rows = min(int(1.5 * counts.prod()), MOST_VOXELS), max(64 * MOST_KNOWN, cells)
    return Voxels(
        low, edge, counts, np.zeros(slots, np.int32), np.zeros(MOST_KNOWN, np.int64),
        np.empty((MOST_KNOWN, 9)), np.zeros(MOST_KNOWN + 1, np.int64), np.empty((rows, 5)), np.empty((rows, 3), np.int64),
        np.zeros(1, np.int64),
    )  # fmt: skip


@njit_inline_in_place
def voxel_at(voxels: Voxels, x: float, y: float, z: float) -> int:
    """The number of the voxel that holds a point; -1 where none does."""
    low, edge, counts = voxels.low, voxels.edge, voxels.counts
    a, b, c = (x - low[0]) / edge, (y - low[1]) / edge, (z - low[2]) / edge
    if not (a >= 0.0 and a < counts[0] and b >= 0.0 and b < counts[1] and c >= 0.0 and c < counts[2]):
        return -1
    return (int(a) * counts[1] + int(b)) * counts[2] + int(c)


@njit_inline_in_place
def middle(voxels: Voxels, number: int) -> tuple[float, float, float]:
    """Of a voxel."""
    low, edge, counts = voxels.low, voxels.edge, voxels.counts
    return (
        low[0] + (number // (counts[1] * counts[2]) + 0.5) * edge,
        low[1] + (number // counts[2] % counts[1] + 0.5) * edge,
        low[2] + (number % counts[2] + 0.5) * edge,
    )


@njit_in_place
def feet(h: Patch, voxels: Voxels, search: Search, points: Array, beyond: float, best: Array, state: Index) -> None:
    """`closest.project_in` for points (n, 3); best (n, 9), state (n,) receive what it finds.

    A point that comes into a voxel of which nothing is known waits until its middle has been asked for: there is one place
    that asks, because kernels are compiled anew wherever they are called.
    """
    found, mine, tangents, c, slot, foot, first = (
        search.found, search.mine, search.h, search.centre, voxels.slot, voxels.foot, voxels.first,
    )  # fmt: skip
    rho, s = HALF_DIAGONAL * voxels.edge, 0
    while s < len(points):
        x, y, z = points[s, 0], points[s, 1], points[s, 2]
        number = voxel_at(voxels, x, y, z)
        known = number >= 0 and slot[number] > 0
        table, final, start, count = search.table, search.final, 0, 0
        px, py, pz = x, y, z
        if known:
            # from the closest point of the voxel's middle, by its tangents
            row = slot[number] - 1
            px, py, pz = middle(voxels, number)
            found[U], found[V] = foot[row, 1], foot[row, 2]
            for a in range(3):
                tangents[1, a], tangents[2, a] = foot[row, 3 + a], foot[row, 6 + a]
            table, final, start, count = voxels.table, voxels.final, first[row], first[row + 1] - first[row]
        else:
            if number >= 0:
                x, y, z = middle(voxels, number)
            c[0], c[1], c[2] = x, y, z
            count = candidates(h, search, rho if number >= 0 else 0.0, np.inf)
        distance, kind = approach(
            h, search, table, final, start, count, x, y, z, px, py, pz, known, beyond if known or number < 0 else np.inf
        )
        if number >= 0 and not known:
            keep(h, search, voxels, number, nearest_candidates(table, final, count, c, rho, distance), distance)
            continue
        if distance < np.inf:
            for a in range(9):
                best[s, a] = mine[a]
            for a in range(3):
                best[s, NORMAL + a] *= h.flip
            state[s] = kind
        s += 1


@njit_in_place
def keep(h: Patch, search: Search, voxels: Voxels, number: int, count: int, distance: float) -> None:
    """Keep what has been found for the middle of a voxel: its closest point in search.mine, the first `count` candidates of
    search.table. All others are forgotten where there is no room."""
    slot, names, foot, first, used, c = (
        voxels.slot, voxels.names, voxels.foot, voxels.first, voxels.used, search.centre,
    )  # fmt: skip
    if used[0] == len(names) or first[used[0]] + count > len(voxels.table):
        for k in range(used[0]):
            slot[names[k]] = 0
        used[0] = 0
    row = used[0]
    start, u, v, tangents = first[row], search.mine[U], search.mine[V], search.h
    for t in range(count):
        for a in range(5):
            voxels.table[start + t, a] = search.table[t, a]
        for a in range(3):
            voxels.final[start + t, a] = search.final[t, a]
    polynomial(
        h.net, h.knots_u, h.knots_v, h.degree_u, h.degree_v, h.rational, search.scratch, h.frames, h.terms, h.terms_stamp,
        h.tick, u, v, c[0], c[1], c[2], tangents,
    )  # fmt: skip
    foot[row, 0], foot[row, 1], foot[row, 2] = distance, u, v
    for a in range(3):
        foot[row, 3 + a], foot[row, 6 + a] = tangents[1, a], tangents[2, a]
    first[row + 1], names[row], slot[number], used[0] = start + count, number, row + 1, row + 1


@njit_inline_in_place
def least_distance(voxels: Voxels, its: Array, x: float, y: float, z: float) -> float:
    """No more than the distance of the surface from a point; -1 where its voxel does not know yet. its (2, 3) : a box about the
    surface."""
    number = voxel_at(voxels, x, y, z)
    if number < 0:
        a, b = max(0.0, its[0, 0] - x, x - its[1, 0]), max(0.0, its[0, 1] - y, y - its[1, 1])
        c = max(0.0, its[0, 2] - z, z - its[1, 2])
        return math.sqrt(a * a + b * b + c * c)
    row = voxels.slot[number] - 1
    if row < 0:
        return -1.0
    a, b, c = middle(voxels, number)
    return max(0.0, voxels.foot[row, 0] - math.sqrt((a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2))
