"""The linear systems of an implicit step: K d = r with K the tangent of springs, contacts and inertia.

K is symmetric and couples a node with its 26 neighbours, so that in the lattice's own order it is a band of half width
b = 3 (rows across x layers): it is factored as a band (LAPACK's blocked Cholesky), which also says whether K is
positive definite. Its n b^2 operations run at the speed of a matrix product: 0.1 s for 30 x 30 x 4 nodes. Beyond
LARGEST_BAND operations, conjugate gradients on K spring by spring, preconditioned with the exact inverse of every column of
nodes through the thickness. They are the faster on an elastic plate from 20 x 20 nodes on, but several times slower where
contacts press and metal flows.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..jit import njit
from .lattice import Lattice

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LARGEST_BAND = 2e10
"""Operations n b^2 above which the band is no longer factored: about 1.5 s on one core."""

CG_TOLERANCE = 1e-4
"""Residual over right-hand side at which conjugate gradients stop: Newton's method corrects the rest."""

CG_ITERATIONS = 5000


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
    def banded(self) -> bool:
        """The band is small enough to be factored."""
        return 3.0 * self.count * (3.0 * self.width + 3.0) ** 2 <= LARGEST_BAND

    @classmethod
    def of(cls, lattice: Lattice, nodes: Index) -> Numbering:
        """The order of the free nodes with the narrower band: rows across u or rows across v. nodes (c, 4) : of contacts.

        Rows around a closed direction are taken from both ends in turn, so that the last stands near the first.
        """
        free = (lattice.inverse_mass > 0.0).reshape(lattice.shape)
        best = None
        for axis in (0, 1):
            rows = np.arange(lattice.shape[axis])
            if lattice.wrap[axis]:
                rows = np.stack([rows, rows[::-1]], axis=1).ravel()[: len(rows)]
            inside = np.take(free, rows, axis=axis)
            index = np.take(np.arange(free.size).reshape(free.shape), rows, axis=axis)
            order = np.swapaxes(index, 0, axis).ravel()[np.swapaxes(inside, 0, axis).ravel()]
            place = np.full(free.size, -1, dtype=np.int64)
            place[order] = np.arange(len(order))
            width = _width(lattice.segments, lattice.stiffness, place, nodes)
            if best is None or width < best.width:
                best = cls(place, len(order), width)
        assert best is not None
        return best


@njit
def _width(segments: Index, stiffness: Array, place: Index, nodes: Index) -> int:
    width = 0
    for row in range(len(segments)):
        d, start, stop, shift = segments[row]
        for n in range(start, stop):
            if stiffness[d, n] > 0.0 and place[n] >= 0 and place[n + shift] >= 0:
                width = max(width, abs(place[n] - place[n + shift]))
    for c in range(len(nodes)):
        for k in range(4):
            for m in range(k):
                p, q = place[nodes[c, k]], place[nodes[c, m]]
                if p >= 0 and q >= 0:
                    width = max(width, abs(p - q))
    return width


@dataclass(frozen=True, slots=True, eq=False)
class Tangent:
    """K by its parts.

    blocks (13, N, 6) : of `spring_tangents`. diagonal (N,) : inertia and drag [N/L]. nodes, weights (c, 4) and contact
    (c, 3, 3) [N/L] : w_k w_l contact between nodes k and l.
    """

    blocks: Array
    diagonal: Array
    nodes: Index
    weights: Array
    contact: Array


@cache
def _blas() -> Any:
    import scipy.linalg.lapack  # noqa: F401  (scipy brings a BLAS of its own, which has to be loaded to be found)
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[Any]:
    """A block in which BLAS works on one thread: sums in another order would give other bytes."""
    limited: AbstractContextManager[Any] = _blas().limit(limits=1, user_api="blas")
    return limited


def solve(lattice: Lattice, numbering: Numbering, tangent: Tangent, right: Array) -> Array | None:
    """d (N, 3) with K d = right (N, 3) at the free nodes, 0 elsewhere; None where K is not positive definite."""
    return (_solve_band if numbering.banded else _solve_cg)(lattice, numbering, tangent, right)


def _solve_band(lattice: Lattice, numbering: Numbering, tangent: Tangent, right: Array) -> Array | None:
    from scipy.linalg.lapack import dpbtrf, dpbtrs

    band = np.zeros((3 * numbering.count, 3 * numbering.width + 3))
    _fill_band(
        lattice.segments,
        lattice.stiffness,
        numbering.place,
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
    ordered = np.empty((numbering.count, 3))
    ordered[numbering.place[free]] = right[free]
    solution, info = dpbtrs(factor, ordered.reshape(-1), lower=1)
    if info != 0 or not np.isfinite(solution).all():
        return None
    d = np.zeros_like(right)
    d[free] = solution.reshape(-1, 3)[numbering.place[free]]
    return d


@njit
def _add_block(band: Array, p: int, q: int, block: Array, scale: float) -> None:
    """Add scale * block (3, 3) at places p >= q of the lower band."""
    for r in range(3):
        for c in range(3 if p > q else r + 1):
            band[3 * q + c, 3 * (p - q) + r - c] += scale * block[r, c]


@njit
def _fill_band(
    segments: Index,
    stiffness: Array,
    place: Index,
    blocks: Array,
    diagonal: Array,
    nodes: Index,
    weights: Array,
    contact: Array,
    band: Array,
) -> None:
    """K in LAPACK's lower band storage, transposed: band[j, i - j] = K_ij."""
    h = np.empty((3, 3))
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
            if p >= 0:
                _add_block(band, p, p, h, 1.0)
            if q >= 0:
                _add_block(band, q, q, h, 1.0)
            if p >= 0 and q >= 0:
                _add_block(band, max(p, q), min(p, q), h, -1.0)
    for c in range(len(nodes)):
        for k in range(4):
            for m in range(4):
                p, q = place[nodes[c, k]], place[nodes[c, m]]
                w = weights[c, k] * weights[c, m]
                if w != 0.0 and p >= q >= 0:
                    _add_block(band, p, q, contact[c], w)


def _solve_cg(lattice: Lattice, numbering: Numbering, tangent: Tangent, right: Array) -> Array | None:
    """Conjugate gradients; None as soon as a direction of negative curvature shows."""
    free = numbering.place >= 0
    nodes, layers = len(free), lattice.shape[2]
    inverse = _column_inverses(lattice, tangent, free)
    r = np.where(free[:, None], right, 0.0)
    target = CG_TOLERANCE * np.linalg.norm(r)
    acting = tangent.contact.any(axis=(1, 2))
    touched, weights, contact = tangent.nodes[acting], tangent.weights[acting], tangent.contact[acting]
    d = np.zeros_like(r)
    direction, along = np.zeros_like(r), 0.0
    for _ in range(CG_ITERATIONS):
        if np.linalg.norm(r) <= target:
            return d
        z = np.matmul(inverse, r.reshape(-1, 3 * layers, 1)).reshape(nodes, 3)
        before, along = along, float(np.vdot(r, z))
        direction = z if before == 0.0 else z + along / before * direction
        product = tangent.diagonal[:, None] * direction
        _multiply(lattice.segments, lattice.stiffness, tangent.blocks, direction, product)
        moved = np.einsum("ck,cka->ca", weights, direction[touched])
        pushed = np.einsum("cab,cb->ca", contact, moved)
        np.add.at(product, touched, weights[:, :, None] * pushed[:, None, :])
        product[~free] = 0.0
        curvature = float(np.vdot(direction, product))
        if not (along > 0.0 and curvature > 0.0):
            return None
        step = along / curvature
        d += step * direction
        r -= step * product
    return None


def _column_inverses(lattice: Lattice, tangent: Tangent, free: NDArray[np.bool_]) -> Array:
    """The inverses (columns, 3 layers, 3 layers) of K within every column of nodes; nodes that are held have a unit block."""
    nl = lattice.shape[2]
    diagonal = np.zeros((len(free), 3, 3))
    diagonal[:, [0, 1, 2], [0, 1, 2]] = tangent.diagonal[:, None]
    _add_diagonals(lattice.segments, lattice.stiffness, tangent.blocks, diagonal)
    square = tangent.weights[:, :, None, None] ** 2 * tangent.contact[:, None]
    np.add.at(diagonal, tangent.nodes, square)
    columns = np.zeros((len(free) // nl, nl, 3, nl, 3))
    down = tangent.blocks[2][:, [0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(-1, nl, 3, 3)
    exists = (lattice.stiffness[2] > 0.0).reshape(-1, nl) & free.reshape(-1, nl)
    exists[:, :-1] &= free.reshape(-1, nl)[:, 1:]
    of_column = np.where(free[:, None, None], diagonal, np.eye(3)).reshape(-1, nl, 3, 3)
    for k in range(nl):
        columns[:, k, :, k] = of_column[:, k]
        if k + 1 < nl:
            block = np.where(exists[:, k, None, None], down[:, k], 0.0)
            columns[:, k, :, k + 1] = -block
            columns[:, k + 1, :, k] = -block
    return np.asarray(np.linalg.inv(columns.reshape(-1, 3 * nl, 3 * nl)), dtype=np.float64)


@njit
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


@njit
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
