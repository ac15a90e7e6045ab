"""The nearest point where one, two or three pieces of surface vanish: Newton's method for |y - x|^2 under constraints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .pieces import Piece

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

STEPS = 40
DONE = 1e-9
"""A step of this share of the size is the last one: the next would be of the order of its square."""


def nearest_on(
    pieces: Sequence[Piece], x: Array, start: Array, active: Index, reach: float, size: float
) -> tuple[Array, Mask]:
    """Points (n, 3) where the pieces active (n, k), k of 1 to 3, vanish, nearest to x (n, 3) around start (n, 3), and which
    of them converged (n,).

    reach : no step is longer. Second derivatives are differences of gradients, which bounds how fast it converges, not
    how exactly.
    """
    y = start.copy()
    left = np.arange(len(y))
    for _ in range(STEPS):
        if not len(left):
            break
        step = _step(pieces, x[left], y[left], active[left], 1e-5 * size)
        length = np.linalg.norm(step, axis=1)
        step *= np.minimum(1.0, reach / np.maximum(length, 1e-300))[:, None]
        y[left] += step
        left = left[length > DONE * size]
    settled = np.ones(len(y), dtype=np.bool_)
    settled[left] = False
    return y, settled


def _step(pieces: Sequence[Piece], x: Array, y: Array, active: Index, h: float) -> Array:
    count = active.shape[1]
    value, normal = _levels(pieces, y, active)
    # solved in double precision even where the pieces touch: a trace of the identity
    gram = normal @ normal.transpose(0, 2, 1)
    scale = np.maximum(np.trace(gram, axis1=1, axis2=2), 1e-300)
    gram += (1e-14 * scale)[:, None, None] * np.eye(count)
    ray = x - y
    down = np.linalg.solve(gram, value[..., None])[..., 0]
    step = -np.einsum("nk,nkc->nc", down, normal)
    if count == 3:
        return np.asarray(step)
    multiplier = np.linalg.solve(gram, np.einsum("nkc,nc->nk", normal, ray)[..., None])[..., 0]
    tangents = _tangents(normal)
    bend = np.empty((len(y), 3 - count, 3))
    for t in range(3 - count):
        along = h * tangents[:, t]
        ahead, behind = _levels(pieces, y + along, active)[1], _levels(pieces, y - along, active)[1]
        bend[:, t] = np.einsum("nk,nkc->nc", multiplier, (ahead - behind) / (2.0 * h))
    slope = np.einsum("ntc,nc->nt", tangents, ray)
    if count == 2:
        curve = 1.0 + (bend[:, 0] * tangents[:, 0]).sum(axis=1)
        move = slope / np.where(curve > 1e-2, curve, 1.0)[:, None]
    else:
        a = 1.0 + (bend[:, 0] * tangents[:, 0]).sum(axis=1)
        c = 1.0 + (bend[:, 1] * tangents[:, 1]).sum(axis=1)
        b = 0.5 * ((bend[:, 0] * tangents[:, 1]).sum(axis=1) + (bend[:, 1] * tangents[:, 0]).sum(axis=1))
        det = a * c - b * b
        bowl = (a > 1e-2) & (det > 1e-2 * a)
        a, b, c, det = np.where(bowl, a, 1.0), np.where(bowl, b, 0.0), np.where(bowl, c, 1.0), np.where(bowl, det, 1.0)
        move = np.column_stack([c * slope[:, 0] - b * slope[:, 1], a * slope[:, 1] - b * slope[:, 0]]) / det[:, None]
    return np.asarray(step + np.einsum("nt,ntc->nc", move, tangents))


def _levels(pieces: Sequence[Piece], y: Array, active: Index) -> tuple[Array, Array]:
    """Values (n, k) and gradients (n, k, 3) of the active pieces at y (n, 3)."""
    value, gradient = np.empty(active.shape), np.empty((*active.shape, 3))
    for slot in range(active.shape[1]):
        for k in np.unique(active[:, slot]):
            rows = np.flatnonzero(active[:, slot] == k)
            value[rows, slot], gradient[rows, slot] = pieces[k].level(y[rows])
    return value, gradient


def _tangents(normal: Array) -> Array:
    """Unit vectors (n, 3 - k, 3) square to the normals (n, k, 3) and to each other."""
    first = normal[:, 0] / np.maximum(np.linalg.norm(normal[:, 0], axis=1), 1e-300)[:, None]
    if normal.shape[1] == 2:
        along = np.cross(first, normal[:, 1])
        length = np.linalg.norm(along, axis=1)
        return (along / np.where(length > 0, length, 1.0)[:, None])[:, None]
    axis = np.eye(3)[np.abs(first).argmin(axis=1)]
    t = np.cross(first, axis)
    t /= np.maximum(np.linalg.norm(t, axis=1), 1e-300)[:, None]
    return np.stack([t, np.cross(first, t)], axis=1)
