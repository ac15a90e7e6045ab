"""The linear systems of an implicit step: K d = r with K the tangent of springs, contacts and inertia.

K is symmetric and couples a node with its 26 neighbours, so that in the lattice's own order it is a band of half width
b = 3 (rows across x layers): it is factored as a band (LAPACK's blocked Cholesky), which also says whether K is
positive definite. Its n b^2 operations run at the speed of a matrix product: 0.1 s for 30 x 30 x 4 nodes. Beyond
LARGEST_BAND operations, conjugate gradients on K spring by spring, preconditioned with the exact inverse of every column of
nodes through the thickness and with that of a coarse grid (coarse.py).
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..jit import njit, njit_in_place
from .coarse import CoarseSpace, add_block
from .lattice import Lattice
from .numbering import Numbering
from .ties import carried, condensed

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LARGEST_BAND = 1e10
"""Operations n b^2 above which the band is no longer factored: about 0.8 s on one core. Where contacts press and metal flows,
conjugate gradients take as long there; on an elastic plate they are the faster from 20 x 20 nodes on."""

CG_TOLERANCE = 1e-4
"""Residual over right-hand side at which conjugate gradients stop: Newton's method corrects the rest."""

CG_ITERATIONS = 5000


@dataclass(frozen=True, slots=True, eq=False)
class Tangent:
    """K by its parts.

    blocks (13, N, 6) : of `spring_tangents`. diagonal (N,) : inertia and drag [N/L]. nodes, weights (c, w) and contact
    (c, 3, 3) [N/L] : w_k w_l contact between nodes k and l, none of them tied. modes (r, N, 3), core (r, r) : modes^T core
    modes is taken away, the drag that bodies do not feel as a whole (rigid.py).
    """

    blocks: Array
    diagonal: Array
    nodes: Index
    weights: Array
    contact: Array
    modes: Array = field(default_factory=lambda: np.zeros((0, 0, 3)))
    core: Array = field(default_factory=lambda: np.zeros((0, 0)))


@cache
def _blas() -> Any:
    import scipy.linalg.lapack  # noqa: F401  (scipy brings a BLAS of its own, which has to be loaded to be found)
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[Any]:
    """A block in which BLAS works on one thread: sums in another order would give other bytes."""
    limited: AbstractContextManager[Any] = _blas().limit(limits=1, user_api="blas")
    return limited


def banded(numbering: Numbering) -> bool:
    """The band is small enough to be factored."""
    return numbering.operations <= LARGEST_BAND


def solve(
    lattice: Lattice, numbering: Numbering, tangent: Tangent, right: Array, coarse: CoarseSpace | None = None
) -> Array | None:
    """d (N, 3) with K d = right (N, 3) at the free nodes, what follows from it at tied ones, 0 elsewhere; None where K is not
    positive definite. `right` is 0 at tied nodes: what acts there acts on their masters. coarse : of this numbering, if it has
    been made before; it is needed where that is not `banded`.
    """
    if banded(numbering):
        d = _solve_band(lattice, numbering, tangent, right)
    else:
        coarse = CoarseSpace.of(lattice, numbering.place, tangent.nodes) if coarse is None else coarse
        d = _solve_cg(lattice, numbering, tangent, right, coarse)
    return None if d is None else carried(d, lattice.ties)


def _solve_band(lattice: Lattice, numbering: Numbering, tangent: Tangent, right: Array) -> Array | None:
    from scipy.linalg.lapack import dpbtrf, dpbtrs

    band = np.zeros((3 * numbering.count, 3 * numbering.width + 3))
    ties = lattice.ties
    _fill_band(
        lattice.segments,
        lattice.stiffness,
        numbering.place,
        ties.row,
        ties.start,
        ties.masters,
        ties.weights,
        tangent.blocks,
        tangent.diagonal,
        tangent.nodes,
        tangent.weights,
        tangent.contact,
        band,
    )
    factor, info = dpbtrf(band.T, lower=1, overwrite_ab=1)
    if info != 0:
        return None
    free = numbering.place >= 0
    rank = len(tangent.modes)
    ordered = np.empty((1 + rank, numbering.count, 3))
    ordered[0, numbering.place[free]] = right[free]
    if rank:
        ordered[1:, numbering.place[free]] = tangent.modes[:, free]
    solution, info = dpbtrs(factor, ordered.reshape(1 + rank, -1).T, lower=1)
    if info != 0 or not np.isfinite(solution).all():
        return None
    y = solution[:, 0]
    if rank:
        # (A - B C B^T)^-1 r = y + Z (1 - C B^T Z)^-1 C B^T y, y = A^-1 r, Z = A^-1 B (Woodbury)
        modes, spread = ordered[1:].reshape(rank, -1), solution[:, 1:]
        small = np.eye(rank) - tangent.core @ (modes @ spread)
        y = y + spread @ np.linalg.solve(small, tangent.core @ (modes @ y))
    d = np.zeros_like(right)
    d[free] = y.reshape(-1, 3)[numbering.place[free]]
    return d


@njit
def _fill_band(
    segments: Index,
    stiffness: Array,
    place: Index,
    row_of: Index,
    tie_start: Index,
    masters: Index,
    tie_weights: Array,
    blocks: Array,
    diagonal: Array,
    nodes: Index,
    weights: Array,
    contact: Array,
    band: Array,
) -> None:
    """K in LAPACK's lower band storage, transposed: band[j, i - j] = K_ij.

    A spring at a tied node couples all its masters: u_a - u_b is a sum over them.
    """
    h = np.empty((3, 3))
    most = 1
    for s in range(len(tie_start) - 1):
        most = max(most, tie_start[s + 1] - tie_start[s])
    among, share = np.empty(2 * most, dtype=np.int64), np.empty(2 * most)
    for n in range(len(place)):
        if place[n] >= 0:
            for c in range(3):
                band[3 * place[n] + c, 0] += diagonal[n]
    for row in range(len(segments)):
        d, start, stop, shift = segments[row]
        for n in range(start, stop):
            if stiffness[d, n] == 0.0:
                continue
            p, q = place[n], place[n + shift]
            xx, yy, zz, xy, yz, zx = blocks[d, n]
            h[0, 0], h[1, 1], h[2, 2] = xx, yy, zz
            h[0, 1] = h[1, 0] = xy
            h[1, 2] = h[2, 1] = yz
            h[0, 2] = h[2, 0] = zx
            if len(row_of) and (row_of[n] >= 0 or row_of[n + shift] >= 0):
                count = 0
                for node, sign in ((n, 1.0), (n + shift, -1.0)):
                    s = row_of[node]
                    for e in range(tie_start[s] if s >= 0 else 0, tie_start[s + 1] if s >= 0 else 1):
                        among[count] = place[masters[e]] if s >= 0 else place[node]
                        share[count] = sign * tie_weights[e] if s >= 0 else sign
                        count += 1
                for k in range(count):
                    for m in range(count):
                        if among[k] >= among[m] >= 0 and (among[k] > among[m] or k >= m):
                            # two shares of one place stand on both sides of the diagonal
                            twice = 2.0 if among[k] == among[m] and k > m else 1.0
                            add_block(band, among[k], among[m], h, twice * share[k] * share[m])
                continue
            if p >= 0:
                add_block(band, p, p, h, 1.0)
            if q >= 0:
                add_block(band, q, q, h, 1.0)
            if p >= 0 and q >= 0:
                add_block(band, max(p, q), min(p, q), h, -1.0)
    for c in range(len(nodes)):
        for k in range(nodes.shape[1]):
            for m in range(nodes.shape[1]):
                p, q = place[nodes[c, k]], place[nodes[c, m]]
                w = weights[c, k] * weights[c, m]
                if w != 0.0 and p >= q >= 0:
                    add_block(band, p, q, contact[c], w)


def _solve_cg(
    lattice: Lattice, numbering: Numbering, tangent: Tangent, right: Array, coarse: CoarseSpace
) -> Array | None:
    """Conjugate gradients; None as soon as a direction of negative curvature shows."""
    free = numbering.place >= 0
    columns = _column_inverses(lattice, tangent, free)
    smooth = coarse.inverse(lattice, tangent.blocks, tangent.diagonal, tangent.nodes, tangent.weights, tangent.contact)
    if smooth is None:
        return None
    r = np.where(free[:, None], right, 0.0)
    target = CG_TOLERANCE * np.linalg.norm(r)
    acting = tangent.contact.any(axis=(1, 2))
    touched, weights, contact = tangent.nodes[acting], tangent.weights[acting], tangent.contact[acting]
    rank = len(tangent.modes)
    modes = tangent.modes.reshape(rank, right.size if rank else 0)
    d = np.zeros_like(r)
    direction, along = np.zeros_like(r), 0.0
    for _ in range(CG_ITERATIONS):
        if np.linalg.norm(r) <= target:
            return d
        z = columns(r) + smooth(r)
        before, along = along, float(np.vdot(r, z))
        direction = z if before == 0.0 else z + along / before * direction
        product = tangent.diagonal[:, None] * direction
        _multiply(lattice.segments, lattice.stiffness, tangent.blocks, carried(direction, lattice.ties), product)
        product = condensed(product, lattice.ties) if len(lattice.ties.nodes) else product
        moved = np.einsum("ck,cka->ca", weights, direction[touched])
        pushed = np.einsum("cab,cb->ca", contact, moved)
        np.add.at(product, touched, weights[:, :, None] * pushed[:, None, :])
        if rank:
            product -= (modes.T @ (tangent.core @ (modes @ direction.ravel()))).reshape(-1, 3)
        product[~free] = 0.0
        curvature = float(np.vdot(direction, product))
        if not (along > 0.0 and curvature > 0.0):
            return None
        step = along / curvature
        d += step * direction
        r -= step * product
    return None


def _column_inverses(lattice: Lattice, tangent: Tangent, free: NDArray[np.bool_]) -> Callable[[Array], Array]:
    """The inverses of K within every column of nodes through the thickness, as a function of r (N, 3); nodes that are held
    have a unit block.

    A column is a run of nodes that springs of direction 2 join; those of one length are inverted together.
    """
    count = len(free)
    diagonal = np.zeros((count, 3, 3))
    diagonal[:, [0, 1, 2], [0, 1, 2]] = tangent.diagonal[:, None]
    _add_diagonals(lattice.segments, lattice.stiffness, tangent.blocks, diagonal)
    square = tangent.weights[:, :, None, None] ** 2 * tangent.contact[:, None]
    np.add.at(diagonal, tangent.nodes, square)
    ties = lattice.ties
    if len(ties.nodes):
        of_tied = diagonal[np.repeat(ties.nodes, np.diff(ties.start))]
        np.add.at(diagonal, ties.masters, ties.weights[:, None, None] ** 2 * of_tied)
    down = tangent.blocks[2][:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, 3, 3)
    linked = lattice.stiffness[2] > 0.0
    linked[-1:] = False
    ends = np.flatnonzero(~linked) + 1
    starts = np.concatenate([[0], ends[:-1]])
    exists = linked & free & np.roll(free, -1)
    of_column = np.where(free[:, None, None], diagonal, np.eye(3))
    groups = []
    for nl in np.unique(ends - starts):
        nodes = starts[ends - starts == nl][:, None] + np.arange(nl)
        columns = np.zeros((len(nodes), nl, 3, nl, 3))
        for k in range(nl):
            columns[:, k, :, k] = of_column[nodes[:, k]]
            if k + 1 < nl:
                block = np.where(exists[nodes[:, k], None, None], down[nodes[:, k]], 0.0)
                columns[:, k, :, k + 1] = -block
                columns[:, k + 1, :, k] = -block
        groups.append((nodes, np.linalg.inv(columns.reshape(-1, 3 * nl, 3 * nl))))

    def precondition(r: Array) -> Array:
        z = np.empty_like(r)
        for nodes, inverse in groups:
            _apply_columns(nodes, inverse, r, z)
        return z

    return precondition


@njit_in_place
def _apply_columns(nodes: Index, inverse: Array, r: Array, z: Array) -> None:
    """z (N, 3) = inverse (c, 3 l, 3 l) of r (N, 3) in columns of nodes (c, l)."""
    for c in range(len(nodes)):
        for k in range(nodes.shape[1]):
            for a in range(3):
                total = 0.0
                for m in range(nodes.shape[1]):
                    n = nodes[c, m]
                    for b in range(3):
                        total += inverse[c, 3 * k + a, 3 * m + b] * r[n, b]
                z[nodes[c, k], a] = total


@njit_in_place
def _add_diagonals(segments: Index, stiffness: Array, blocks: Array, diagonal: Array) -> None:
    for row in range(len(segments)):
        d, start, stop, shift = segments[row]
        for n in range(start, stop):
            if stiffness[d, n] == 0.0:
                continue
            xx, yy, zz, xy, yz, zx = blocks[d, n]
            for end in (n, n + shift):
                h = diagonal[end]
                h[0, 0] += xx
                h[1, 1] += yy
                h[2, 2] += zz
                h[0, 1] += xy
                h[1, 0] += xy
                h[1, 2] += yz
                h[2, 1] += yz
                h[0, 2] += zx
                h[2, 0] += zx


@njit_in_place
def _multiply(segments: Index, stiffness: Array, blocks: Array, x: Array, product: Array) -> None:
    """Add the springs' part of K x to product (N, 3)."""
    for row in range(len(segments)):
        d, start, stop, shift = segments[row]
        for n in range(start, stop):
            if stiffness[d, n] == 0.0:
                continue
            e = n + shift
            xx, yy, zz, xy, yz, zx = blocks[d, n]
            ux, uy, uz = x[n, 0] - x[e, 0], x[n, 1] - x[e, 1], x[n, 2] - x[e, 2]
            fx = xx * ux + xy * uy + zx * uz
            fy = xy * ux + yy * uy + yz * uz
            fz = zx * ux + yz * uy + zz * uz
            product[n, 0] += fx
            product[n, 1] += fy
            product[n, 2] += fz
            product[e, 0] -= fx
            product[e, 1] -= fy
            product[e, 2] -= fz
