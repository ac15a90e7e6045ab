"""A coarse space for conjugate gradients: the lattice's smooth motions, solved for exactly in every iteration.

Conjugate gradients with the inverses of columns take as many iterations as a lattice has nodes across, and more where it
bends. A coarse grid of every COARSENING-th node, with trilinear functions in between and at least linear ones through the
thickness, holds the motions that they find slowly. Its matrix A = P^T K P is factored as a band; P A^-1 P^T is added to the
columns' inverses (additive two-level method: Toselli, Widlund 2005, Domain Decomposition Methods, chapter 3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..jit import njit, njit_in_place
from .lattice import Lattice, grids
from .numbering import band_width, pieces, spread_over_masters, sweeps

Array = NDArray[np.float64]
Index = NDArray[np.int64]

COARSENING = 4
"""Nodes per coarse node and direction: fewer make the coarse band the dearer part, more the iterations."""

MOST_COARSE = 4e9
"""Operations n b^2 of the coarse band; the grid is made coarser until it takes no more: 0.3 s on one core."""

LEAST_PIVOT = 1e-9
"""Of the diagonal, added to it: beside held nodes coarse functions may be the same."""


@njit_in_place
def add_block(band: Array, p: int, q: int, block: Array, scale: float) -> None:
    """Add scale * block (3, 3) at places p >= q of the lower band in LAPACK's storage, transposed: band[j, i - j] = K_ij."""
    for r in range(3):
        for c in range(3 if p > q else r + 1):
            band[3 * q + c, 3 * (p - q) + r - c] += scale * block[r, c]


@dataclass(frozen=True, slots=True, eq=False)
class CoarseSpace:
    """The coarse functions of a lattice.

    at (N, 3) : a node's indices in its grid, of_grid (N,) : which that is. grid (g, 8) : nodes along the three directions, 1
    where u and v are closed, the first coarse node, and coarse nodes along the last two directions. ids, shares (N, 8) : the
    coarse nodes that each node takes part in, by how much; 0 where it is held or tied. place (C,) : of the coarse nodes in the
    coarse band, -1 of those of which nothing is free. width : of that band. step : nodes per coarse node. spread (N, C) : P,
    sparse.
    """

    at: Index
    of_grid: Index
    grid: Index
    ids: Index
    shares: Array
    place: Index
    width: int
    step: int
    spread: Any

    @classmethod
    def of(cls, lattice: Lattice, place: Index, nodes: Index) -> CoarseSpace:
        """The functions on the nodes that have a place (N,); nodes (c, w) : of contacts."""
        piece = pieces(lattice, nodes)
        longest = max(max(shape) for _, shape, _ in grids(lattice))
        step = COARSENING
        space = cls.stepping(lattice, place, nodes, piece, step)
        while space.operations > MOST_COARSE and step < longest:
            step *= 2
            space = cls.stepping(lattice, place, nodes, piece, step)
        return space

    @property
    def operations(self) -> float:
        """What it takes to factor the coarse band."""
        return 3.0 * len(self.place) * (3.0 * self.width + 3.0) ** 2

    @classmethod
    def stepping(cls, lattice: Lattice, place: Index, nodes: Index, piece: Index, step: int) -> CoarseSpace:
        """Those on every step-th node; piece (N,) : of `numbering.pieces`."""
        import scipy.sparse as sp

        count, free = len(lattice.nodes), place >= 0
        at, of_grid = np.zeros((count, 3), dtype=np.int64), np.zeros(count, dtype=np.int64)
        ids, shares = np.zeros((count, 8), dtype=np.int64), np.zeros((count, 8))
        rows, total = [], 0
        for g, (start, shape, wrap) in enumerate(grids(lattice)):
            mine = slice(start, start + shape[0] * shape[1] * shape[2])
            at[mine] = np.stack(np.unravel_index(np.arange(mine.stop - start), shape), axis=1)
            of_grid[mine] = g
            closed = (wrap[0], wrap[1], False)
            sizes = [
                max(1, -(-(n if c else n - 1) // step)) + (0 if c else 1) for n, c in zip(shape, closed, strict=True)
            ]
            rows.append((*shape, *closed[:2], total, *sizes[1:]))
            ids[mine], shares[mine] = _trilinear(at[mine], shape, closed, sizes, step)
            ids[mine] += total
            total += sizes[0] * sizes[1] * sizes[2]
        shares[~free] = 0.0
        # a matrix of its own: scipy puts rows in order in place
        spread = sp.csr_matrix((shares.flatten(), ids.flatten(), np.arange(0, 8 * count + 1, 8)), shape=(count, total))
        weight = np.asarray(spread.sum(axis=0)).ravel()
        used = np.flatnonzero(weight > 0.0)
        x = (spread.T @ lattice.nodes)[used] / weight[used, None]
        of_piece = np.zeros(total, dtype=np.int64)
        of_piece[ids.ravel()] = np.repeat(piece, 8)
        best = None
        for order in sweeps(x, of_piece[used]):
            places = np.full(total, -1, dtype=np.int64)
            places[used[order]] = np.arange(len(used))
            of_node = np.where(shares > 0.0, places[ids], -1)
            high = of_node.max(axis=1)
            low = np.where(of_node < 0, total, of_node).min(axis=1)
            low[high < 0] = -1
            width = band_width(
                lattice.segments, lattice.stiffness, *spread_over_masters(low, high, lattice.ties), nodes
            )
            if best is None or width < best[1]:
                best = places, width
        assert best is not None
        grid = np.array(rows, dtype=np.int64)
        return cls(at, of_grid, grid, ids, shares, best[0], int(best[1]), step, spread)

    def inverse(
        self, lattice: Lattice, blocks: Array, diagonal: Array, nodes: Index, weights: Array, contact: Array
    ) -> Callable[[Array], Array] | None:
        """P (P^T K P)^-1 P^T as a function of r (N, 3), for K by its parts (`tangent.Tangent`); None where it is not positive
        definite.
        """
        from scipy.linalg.lapack import dpbtrf, dpbtrs

        size = int(self.place.max()) + 1
        band = np.zeros((3 * size, 3 * self.width + 3))
        ties = lattice.ties
        most = 8 * max(2 * ties.most, nodes.shape[1])
        _fill_coarse(
            lattice.segments, lattice.stiffness, self.at, self.of_grid, self.grid, self.ids, self.shares, self.place,
            self.step, ties.row, ties.start, ties.masters, ties.weights, blocks, diagonal, nodes, weights, contact,
            np.zeros((len(self.place), 36, 6)), np.zeros(most, dtype=np.int64), np.zeros(most), band,
        )  # fmt: skip
        band[:, 0] *= 1.0 + LEAST_PIVOT
        factor, info = dpbtrf(band.T, lower=1, overwrite_ab=1)
        if info != 0:
            return None
        used = self.place >= 0
        to = self.place[used]

        def smooth(r: Array) -> Array:
            gathered = np.empty((size, 3))
            gathered[to] = (self.spread.T @ r)[used]
            solution = np.zeros((len(used), 3))
            solution[used] = dpbtrs(factor, gathered.reshape(-1), lower=1)[0].reshape(-1, 3)[to]
            return np.asarray(self.spread @ solution)

        return smooth


def _trilinear(
    at: Index, shape: tuple[int, int, int], closed: tuple[bool, bool, bool], sizes: list[int], step: int
) -> tuple[Index, Array]:
    """Coarse nodes (N, 8) around nodes at indices (N, 3) of a grid, and their shares (N, 8) of sum 1."""
    ids, shares = np.zeros((len(at), 8), dtype=np.int64), np.ones((len(at), 8))
    for axis in range(3):
        last = shape[axis] if closed[axis] else max(1, shape[axis] - 1)
        low = np.minimum(at[:, axis] // step, (last - 1) // step)
        t = (at[:, axis] - low * step) / np.minimum(step, last - low * step)
        for corner in range(8):
            up = corner >> (2 - axis) & 1
            ids[:, corner] = ids[:, corner] * sizes[axis] + (low + up) % sizes[axis]
            shares[:, corner] *= t if up else 1.0 - t
    return ids, shares


@njit
def _fill_coarse(
    segments: Index, stiffness: Array, at: Index, of_grid: Index, grid: Index, ids: Index, shares: Array, place: Index,
    step: int, tie_row: Index, tie_start: Index, masters: Index, tie_weights: Array, blocks: Array, diagonal: Array,
    nodes: Index, weights: Array, contact: Array, cells: Array, among: Index, share: Array, band: Array,
) -> None:  # fmt: skip
    """P^T K P as a band. A spring lies in one coarse cell: what it adds is summed up cell by cell, cells (C, 36, 6), cell c
    being that of its first corner. among, share : workspace.
    """
    d, corner = np.zeros(8), np.zeros(8, dtype=np.int64)
    h = np.zeros((3, 3))
    for row in range(len(segments)):
        direction, start, stop, shift = segments[row]
        for n in range(start, stop):
            if stiffness[direction, n] == 0.0:
                continue
            e = n + shift
            if len(tie_row) and (tie_row[n] >= 0 or tie_row[e] >= 0):
                count = _along(n, 1.0, 0, ids, shares, tie_row, tie_start, masters, tie_weights, among, share)
                count = _along(e, -1.0, count, ids, shares, tie_row, tie_start, masters, tie_weights, among, share)
                _unpack(blocks[direction, n], h)
                _add_all(count, among, share, place, h, band)
                continue
            cell = _in_cell(n, e, at, grid[of_grid[n]], step, shares, d)
            for r in range(8):
                if d[r] != 0.0:
                    for s in range(r + 1):
                        w = d[r] * d[s]
                        if w != 0.0:
                            for b in range(6):
                                cells[cell, r * (r + 1) // 2 + s, b] += w * blocks[direction, n, b]
    for n in range(len(diagonal)):
        if diagonal[n] != 0.0:
            cell = _in_cell(n, n, at, grid[of_grid[n]], step, shares, d)
            for r in range(8):
                for s in range(r + 1):
                    for b in range(3):
                        cells[cell, r * (r + 1) // 2 + s, b] += d[r] * d[s] * diagonal[n]
    for g in range(len(grid)):
        _add_cells(grid[g], step, cells, corner, place, h, band)
    for c in range(len(nodes)):
        count = 0
        for k in range(nodes.shape[1]):
            if weights[c, k] != 0.0:
                count = _along(
                    nodes[c, k],
                    weights[c, k],
                    count,
                    ids,
                    shares,
                    tie_row,
                    tie_start,
                    masters,
                    tie_weights,
                    among,
                    share,
                )
        for a in range(3):
            for b in range(3):
                h[a, b] = contact[c, a, b]
        _add_all(count, among, share, place, h, band)


@njit_in_place
def _in_cell(n: int, e: int, at: Index, grid: Index, step: int, shares: Array, d: Array) -> int:
    """The coarse cell that holds nodes n and e, and d (8,), what its corners share in u_n - u_e; in u_n where they are one."""
    # a held node has no shares at all
    here = there = 0.0
    for r in range(8):
        here += shares[n, r]
        there += shares[e, r]
    a = 1.0 if here > 0.0 else 0.0
    b = 1.0 if there > 0.0 and e != n else 0.0
    cell = 0
    tn0 = te0 = tn1 = te1 = tn2 = te2 = 0.0
    for axis in range(3):
        p, q = at[n, axis], at[e, axis]
        closed = axis < 2 and grid[3 + axis] == 1
        last = grid[axis] if closed else max(1, grid[axis] - 1)
        if closed and abs(p - q) > 1:
            # across the seam of a closed direction
            if p < q:
                p += grid[axis]
            else:
                q += grid[axis]
        low = min(min(p, q) // step, (last - 1) // step)
        length = min(step, last - low * step)
        tn, te = (p - low * step) / length, (q - low * step) / length
        if axis == 0:
            tn0, te0, cell = tn, te, low
        elif axis == 1:
            tn1, te1, cell = tn, te, cell * grid[6] + low
        else:
            tn2, te2, cell = tn, te, cell * grid[7] + low
    for r in range(8):
        wn = (tn0 if r & 4 else 1.0 - tn0) * (tn1 if r & 2 else 1.0 - tn1) * (tn2 if r & 1 else 1.0 - tn2)
        we = (te0 if r & 4 else 1.0 - te0) * (te1 if r & 2 else 1.0 - te1) * (te2 if r & 1 else 1.0 - te2)
        d[r] = a * wn - b * we
    return grid[5] + cell


@njit_in_place
def _add_cells(grid: Index, step: int, cells: Array, corner: Index, place: Index, h: Array, band: Array) -> None:
    last0 = grid[0] if grid[3] == 1 else max(1, grid[0] - 1)
    last1 = grid[1] if grid[4] == 1 else max(1, grid[1] - 1)
    last2 = max(1, grid[2] - 1)
    size0 = (last0 - 1) // step + (1 if grid[3] == 1 else 2)
    for i in range((last0 - 1) // step + 1):
        for j in range((last1 - 1) // step + 1):
            for k in range((last2 - 1) // step + 1):
                for r in range(8):
                    ci, cj = (i + (r >> 2)) % size0, (j + (r >> 1 & 1)) % grid[6]
                    corner[r] = place[grid[5] + (ci * grid[6] + cj) * grid[7] + k + (r & 1)]
                cell = grid[5] + (i * grid[6] + j) * grid[7] + k
                for r in range(8):
                    for s in range(r + 1):
                        p, q = corner[r], corner[s]
                        block = cells[cell, r * (r + 1) // 2 + s]
                        # without any spring between them two corners may be farther apart than the band is wide
                        if p < 0 or q < 0 or block[0] + block[1] + block[2] == 0.0:
                            continue
                        _unpack(block, h)
                        add_block(band, max(p, q), min(p, q), h, 2.0 if p == q and r > s else 1.0)


@njit_in_place
def _unpack(block: Array, h: Array) -> None:
    h[0, 0], h[1, 1], h[2, 2] = block[0], block[1], block[2]
    h[0, 1] = h[1, 0] = block[3]
    h[1, 2] = h[2, 1] = block[4]
    h[0, 2] = h[2, 0] = block[5]


@njit_in_place
def _along(
    n: int, w: float, count: int, ids: Index, shares: Array, tie_row: Index, tie_start: Index, masters: Index,
    tie_weights: Array, among: Index, share: Array,
) -> int:  # fmt: skip
    """Add w times what coarse nodes share in node n, or in its masters, to a list of so many."""
    s = tie_row[n] if len(tie_row) else -1
    for e in range(tie_start[s] if s >= 0 else 0, tie_start[s + 1] if s >= 0 else 1):
        m = masters[e] if s >= 0 else n
        for r in range(8):
            part = w * shares[m, r] * (tie_weights[e] if s >= 0 else 1.0)
            if part != 0.0:
                found = 0
                while found < count and among[found] != ids[m, r]:
                    found += 1
                if found == count:
                    among[count], share[count] = ids[m, r], 0.0
                    count += 1
                share[found] += part
    return count


@njit_in_place
def _add_all(count: int, among: Index, share: Array, place: Index, h: Array, band: Array) -> None:
    for r in range(count):
        for s in range(count):
            p, q = place[among[r]], place[among[s]]
            if p >= q >= 0:
                add_block(band, p, q, h, share[r] * share[s])
