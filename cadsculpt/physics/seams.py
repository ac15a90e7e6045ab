"""Ties along the common edge of two faces, so that their lattices move as one (ties.py).

Along a seam the finer of two lattices follows the coarser. Its surface nodes on the seam follow the point of the other face
that they coincide with, by the bilinear weights of the four nodes there. The nodes below them follow the cell of the other
lattice that they lie in, by its trilinear weights: a smooth seam is tied layer by layer, and at an edge between two faces the
one column lies in the other face's surface. Where a node stands at the very mean of its masters, X_s = sum w X_k, the tie
gives way to every rigid motion and keeps the angular momentum; where it does not, it is tied in displacement all the same.
What lies in no cell of the other lattice (below a reentrant edge, or deeper than the other one is thick) is left free: a tie
to something far away would hold the body against turning.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .forces import node_weights
from .lattice import Lattice, grid_shape, hexahedra
from .ties import Ties

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NEAR = 0.5
"""Of a node step: how far from the seam a surface node may lie to be one of the seam's. With nodes on the edge these are the
nodes on it; where the edge runs across the cells, those next to it, which then move as the nearest point of the edge does."""

OUTSIDE = 0.25
"""Of a cell: how far outside the other lattice a node below the seam may lie and still be tied, to the nearest point of the
cell. Curved seams of unlike nodes have gaps, far smaller than this."""

SNAP = 1e-6
"""Of a cell: a node this near to another coincides with it."""


def seam_ties(parts: Sequence[Lattice], a: int, uv_a: Array, b: int, uv_b: Array) -> Ties:
    """Ties between parts a and b along a common curve, for `assemble(parts, ties)`.

    uv_a, uv_b (n, 2) : the curve in the parameters of each face, point by point the same points, so many that both are
    straight from one to the next. Of the two lattices that with fewer nodes on the curve leads (a, where they have as many).
    The ties of several seams are joined by `Ties.joined`; where three faces meet, or ties form chains, `assemble` resolves
    them.

    Raises InputError for curves that do not match, and where neither lattice has a node near the curve.
    """
    uv_a, uv_b = np.asarray(uv_a, dtype=np.float64), np.asarray(uv_b, dtype=np.float64)
    if uv_a.shape != uv_b.shape or uv_a.ndim != 2 or uv_a.shape[1] != 2 or len(uv_a) < 2:
        raise InputError(f"a seam along {uv_a.shape} and {uv_b.shape} points: both must be (n, 2), of two or more")
    if not (np.isfinite(uv_a).all() and np.isfinite(uv_b).all()):
        raise InputError("a seam along points that are not finite")
    on_a, on_b = nodes_along(parts[a], uv_a), nodes_along(parts[b], uv_b)
    if not len(on_a[0]) and not len(on_b[0]):
        raise InputError("neither lattice has a node near the seam", mend="choose a smaller node spacing")
    follows, leader, curve, (nodes, at) = (a, b, uv_b, on_a) if len(on_a[0]) > len(on_b[0]) else (b, a, uv_a, on_b)
    segment = np.minimum(at.astype(np.int64), len(curve) - 2)
    share = (at - segment)[:, None]
    uv = curve[segment] + share * (curve[segment + 1] - curve[segment])
    return tie_columns(parts, follows, nodes, leader, uv)


def tie_columns(parts: Sequence[Lattice], follows: int, nodes: Index, leads: int, uv: Array) -> Ties:
    """Ties of whole columns of part `follows`, below its surface nodes (n,), to part `leads`, where uv (n, 2) are the points of
    its face that the surface nodes go with.
    """
    slave, master = parts[follows], parts[leads]
    starts = np.concatenate([[0], np.cumsum([len(part.nodes) for part in parts])])
    layers = grid_shape(slave)[2]
    on, weights = node_weights(master, uv[:, 0], uv[:, 1])
    # below a surface node that is not quite on the other face, the column is tied as if it were
    gap = np.einsum("nk,nkc->nc", weights, master.nodes[on]) - slave.nodes[nodes]
    found = [Ties(nodes + starts[follows], on + starts[leads], weights)]
    for k in range(1, layers):
        inside, cells, shares = locate(master, uv, slave.nodes[nodes + k] + gap)
        found.append(Ties((nodes + k)[inside] + starts[follows], cells + starts[leads], shares))
    return Ties.joined(found)


def nodes_along(lattice: Lattice, uv: Array) -> tuple[Index, Array]:
    """The surface nodes (m,) within NEAR of a curve uv (n, 2), and where along it each is nearest: point i at i (m,)."""
    nu, nv, nl = grid_shape(lattice)
    best: dict[int, tuple[float, float]] = {}
    ends = [
        np.append(t, t[0] + p) if p > 0.0 else t for t, p in zip((lattice.u, lattice.v), lattice.period, strict=True)
    ]
    turns = [(-p, 0.0, p) if p > 0.0 else (0.0,) for p in lattice.period]
    for du in turns[0]:
        for dv in turns[1]:
            curve = np.stack([_steps(uv[:, 0] + du, ends[0]), _steps(uv[:, 1] + dv, ends[1])], axis=1)
            for s, (p, q) in enumerate(zip(curve[:-1], curve[1:], strict=True)):
                low, high = np.minimum(p, q) - NEAR, np.maximum(p, q) + NEAR
                i = np.arange(max(0, math.ceil(low[0])), min(len(ends[0]) - 1, math.floor(high[0])) + 1)
                j = np.arange(max(0, math.ceil(low[1])), min(len(ends[1]) - 1, math.floor(high[1])) + 1)
                if not (len(i) and len(j)):
                    continue
                grid = np.stack(np.meshgrid(i, j, indexing="ij"), axis=-1).reshape(-1, 2)
                along = q - p
                size = float(along @ along)
                t = np.clip((grid - p) @ along / size, 0.0, 1.0) if size > 0.0 else np.zeros(len(grid))
                distance = np.linalg.norm(grid - p - t[:, None] * along, axis=1)
                for (gi, gj), gap, share in zip(grid, distance, t, strict=True):
                    node = int(((gi % nu) * nv + gj % nv) * nl)
                    # of two that are as near, rounding apart, the first
                    if gap <= NEAR and gap < best.get(node, (math.inf, 0.0))[0] - SNAP:
                        best[node] = float(gap), s + float(share)
    nodes = sorted(node for node in best if lattice.active[node])
    return np.array(nodes, dtype=np.int64), np.array([best[node][1] for node in nodes])


def _steps(t: Array, ends: Array) -> Array:
    """Parameters measured in node steps, beyond the ends by the last step."""
    i = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, len(ends) - 2)
    return i + (t - ends[i]) / (ends[i + 1] - ends[i])


def locate(lattice: Lattice, uv: Array, points: Array) -> tuple[NDArray[np.bool_], Index, Array]:
    """The cells that hold points (n, 3): which of them are held (n,), and of those the nodes and trilinear weights (m, 8).

    uv (n, 2) : a point of the face no farther away than the lattice is thick. A point up to OUTSIDE of a cell beside the
    lattice counts as the nearest one in it.
    """
    shape = lattice.cell_material.shape
    corners = hexahedra(lattice).reshape(*shape, 8)
    order = [0, 4, 3, 7, 1, 5, 2, 6] if lattice.right_handed else [0, 4, 1, 5, 3, 7, 2, 6]
    reach = math.ceil(1.5 * lattice.thickness / lattice.spacing) + 2
    held, nodes, weights = np.zeros(len(points), dtype=np.bool_), [], []
    for n, (here, point) in enumerate(zip(uv, points, strict=True)):
        ranges = []
        for axis, (t, period) in enumerate(zip((lattice.u, lattice.v), lattice.period, strict=True)):
            ends = np.append(t, t[0] + period) if period > 0.0 else t
            middle = here[axis] if period == 0.0 else t[0] + (here[axis] - t[0]) % period
            cell = int(np.clip(_steps(np.array([middle]), ends)[0], 0, shape[axis] - 1))
            near = np.arange(cell - reach, cell + reach + 1)
            ranges.append(np.unique(near % shape[axis]) if period > 0.0 else near[(near >= 0) & (near < shape[axis])])
        block = corners[np.ix_(*ranges)][lattice.cell_active[np.ix_(*ranges)]].reshape(-1, 8)
        if not len(block):
            continue
        block = block[:, order]
        at = lattice.nodes[block]
        middle_of = at.mean(axis=1)
        near_enough = np.linalg.norm(point - middle_of, axis=1) <= 0.8 * np.linalg.norm(at[:, 7] - at[:, 0], axis=1)
        block, at = block[near_enough], at[near_enough]
        if not len(block):
            continue
        natural = _natural(at, point)
        outside = np.maximum(np.abs(natural - 0.5).max(axis=1) - 0.5, 0.0)
        # of cells that share the point, rounding apart, the first
        best = int(np.flatnonzero(outside <= outside.min() + SNAP)[0])
        if not outside[best] <= OUTSIDE:
            continue
        c = np.clip(natural[best], 0.0, 1.0)
        c = np.where(c < SNAP, 0.0, np.where(c > 1.0 - SNAP, 1.0, c))
        held[n] = True
        nodes.append(block[best])
        weights.append(_trilinear(c))
    if not nodes:
        return held, np.zeros((0, 8), dtype=np.int64), np.zeros((0, 8))
    return held, np.array(nodes), np.array(weights)


def _trilinear(c: Array) -> Array:
    """Weights (..., 8) of corner (i, j, k) at 4 i + 2 j + k, for natural coordinates (..., 3)."""
    one = np.stack([1.0 - c, c], axis=-1)
    return (one[..., 0, :, None, None] * one[..., 1, None, :, None] * one[..., 2, None, None, :]).reshape(
        *c.shape[:-1], 8
    )


def _natural(corners: Array, point: Array) -> Array:
    """Natural coordinates (m, 3) of a point in cells of corners (m, 8, 3), by Newton's method; inf in cells without volume."""
    c = np.full((len(corners), 3), 0.5)
    size = np.linalg.norm(corners[:, 7] - corners[:, 0], axis=1)
    flat = np.zeros(len(corners), dtype=np.bool_)
    for _ in range(12):
        one = np.stack([1.0 - c, c], axis=-1)
        gap = np.einsum("mk,mkc->mc", _trilinear(c), corners) - point
        slope = np.empty((len(corners), 3, 3))
        for axis in range(3):
            factors = [one[:, other] for other in range(3)]
            factors[axis] = np.broadcast_to([-1.0, 1.0], factors[axis].shape)
            along = factors[0][:, :, None, None] * factors[1][:, None, :, None] * factors[2][:, None, None, :]
            slope[:, :, axis] = np.einsum("mk,mkc->mc", along.reshape(-1, 8), corners)
        flat |= ~(np.abs(np.linalg.det(slope)) > 1e-9 * size**3)
        slope[flat] = np.eye(3)
        c = c - np.clip(np.linalg.solve(slope, gap[:, :, None])[:, :, 0], -1.0, 1.0)
    c[flat] = math.inf
    return c
