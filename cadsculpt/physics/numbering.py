"""The order in which the free nodes of a lattice stand in a linear system, so that it is a narrow band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..jit import njit
from .lattice import Lattice, grids
from .ties import TiedNodes

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Numbering:
    """Where the free nodes of a lattice stand in the linear system.

    place (N,) : a node's place, -1 for one that does not move freely. count : of free nodes. width : the largest
    distance between the places of two neighbours.
    """

    place: Index
    count: int
    width: int

    @property
    def operations(self) -> float:
        """What it takes to factor the band of 3 x 3 blocks."""
        return 3.0 * self.count * (3.0 * self.width + 3.0) ** 2

    @classmethod
    def of(cls, lattice: Lattice, nodes: Index, x: Array | None = None) -> Numbering:
        """The order of the free nodes with the narrowest band. nodes (c, w) : of contacts. x (N, 3) : where the nodes are.

        A lattice's own grid gives rows across u or rows across v; rows around a closed direction are taken from both ends
        in turn, so that the last stands near the first. An assembly is cut into what hangs together by ties and contacts,
        and each piece swept along one of its axes.
        """
        orders = _grid_orders(lattice) if len(lattice.u) else _swept_orders(lattice, nodes, x)
        return min((cls._ordered(lattice, nodes, order) for order in orders), key=lambda numbering: numbering.width)

    @classmethod
    def _ordered(cls, lattice: Lattice, nodes: Index, order: Index) -> Numbering:
        place = np.full(len(lattice.nodes), -1, dtype=np.int64)
        place[order] = np.arange(len(order))
        low, high = spread_over_masters(place, place, lattice.ties)
        return cls(place, len(order), band_width(lattice.segments, lattice.stiffness, low, high, nodes))


def spread_over_masters(low: Index, high: Index, ties: TiedNodes) -> tuple[Index, Index]:
    """The first and last place (N,) that a node takes part in, -1 for none; of a tied node those of its masters."""
    if not len(ties.nodes):
        return low, high
    low, high = low.copy(), high.copy()
    first, last = low[ties.masters], high[ties.masters]
    high[ties.nodes] = np.maximum.reduceat(last, ties.start[:-1])
    # masters without a place do not count
    first[first < 0] = np.iinfo(np.int64).max
    low[ties.nodes] = np.minimum.reduceat(first, ties.start[:-1])
    low[high < 0] = -1
    return low, high


def _grid_orders(lattice: Lattice) -> list[Index]:
    """The free nodes of one lattice, rows across u and rows across v."""
    free = (lattice.inverse_mass > 0.0).reshape(lattice.shape)
    orders = []
    for axis in (0, 1):
        rows = np.arange(lattice.shape[axis])
        if lattice.wrap[axis]:
            rows = np.stack([rows, rows[::-1]], axis=1).ravel()[: len(rows)]
        inside = np.take(free, rows, axis=axis)
        index = np.take(np.arange(free.size).reshape(free.shape), rows, axis=axis)
        orders.append(np.swapaxes(index, 0, axis).ravel()[np.swapaxes(inside, 0, axis).ravel()])
    return orders


def _swept_orders(lattice: Lattice, nodes: Index, x: Array | None) -> list[Index]:
    """The free nodes of an assembly, piece by piece, swept along the axes of the frame and along each piece's own."""
    x = lattice.nodes if x is None else x
    piece = pieces(lattice, nodes)
    free = np.flatnonzero(lattice.inverse_mass > 0.0)
    return [free[order] for order in sweeps(x[free], piece[free])]


def sweeps(x: Array, piece: Index) -> list[Index]:
    """Orders of points (n, 3), piece by piece, along the axes of the frame and along each piece's own."""
    turned = np.empty_like(x)
    for k in np.unique(piece):
        mine = piece == k
        centred = x[mine] - x[mine].mean(axis=0)
        turned[mine] = centred @ np.linalg.eigh(centred.T @ centred)[1]
    return [np.lexsort((np.arange(len(x)), t[:, axis], piece)) for t in (x, turned) for axis in range(3)]


def pieces(lattice: Lattice, nodes: Index) -> Index:
    """Which piece each node (N,) belongs to: the parts that ties and contacts (c, w) join."""
    starts = [start for start, _, _ in grids(lattice)]
    count = len(starts)
    part = np.repeat(np.arange(count), np.diff([*starts, len(lattice.nodes)]))
    pairs = [(part[nodes[:, :1]], part[nodes])]
    ties = lattice.ties
    if len(ties.nodes):
        pairs.append((part[np.repeat(ties.nodes, np.diff(ties.start))][:, None], part[ties.masters][:, None]))
    piece = np.arange(count)
    met = np.unique(
        np.concatenate([np.stack(np.broadcast_arrays(a, b), axis=-1).reshape(-1, 2) for a, b in pairs]), axis=0
    )
    for a, b in met:
        if piece[a] != piece[b]:
            piece[piece == piece[b]] = piece[a]
    return piece[part]


@njit
def band_width(segments: Index, stiffness: Array, low: Index, high: Index, nodes: Index) -> int:
    """low, high (N,) : places of a node; the first and last of its masters' where it is tied; -1 where it is held."""
    width = 0
    for row in range(len(segments)):
        d, start, stop, shift = segments[row]
        for n in range(start, stop):
            if stiffness[d, n] > 0.0 and low[n] >= 0 and low[n + shift] >= 0:
                width = max(width, max(high[n], high[n + shift]) - min(low[n], low[n + shift]))
    for c in range(len(nodes)):
        first, last = -1, -1
        for k in range(nodes.shape[1]):
            p = low[nodes[c, k]]
            if p >= 0:
                first = p if first < 0 else min(first, p)
                last = max(last, high[nodes[c, k]])
        width = max(width, last - first)
    return width
