"""Which way the material lies below each node.

Below a smooth surface that is against the normal. Where the surface turns sharper than the material is thick, the normals
cross inside it and the lattice would fold; and at a cusp there is no normal. There the directions are smoothed: diffused
along the surface over a reach that grows until the lattice stands. On a crease the normal is that of one side alone; where
several creases meet in a corner, as of a box, the mean of all sides is where the smoothing starts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .fold import check_folds

Array = NDArray[np.float64]

MARGIN = 1.3
"""Directions are smoothed until a lattice this much thicker would stand: it must not fold when it is pressed either."""

ATTEMPTS = 7


def inward_directions(
    points: Array, normals: Array, u: Array, v: Array, *, thickness: float, wrap: tuple[bool, bool]
) -> Array:
    """Unit directions into the material (nu, nv, 3) for surface nodes (nu, nv, 3) with outward normals, NaN where none.

    The normals themselves where the lattice stands on them, and where no smoothing helps: building the lattice then says
    where it folds, and which thickness would do.
    """
    inward = -_filled(points, normals, wrap)
    columns = np.ones((len(u) - (not wrap[0]), len(v) - (not wrap[1])), dtype=np.bool_)
    for start in (inward, _of_all_sides(points, inward, wrap)):
        smooth = start
        for attempt in range(ATTEMPTS):
            try:
                check_folds(points, smooth, u, v, (MARGIN if attempt else 1.0) * thickness, wrap, columns)
            except InputError:
                smooth = _smoothed(points, start, 0.5 * thickness * 2.0**attempt, wrap)
            else:
                return smooth
    return inward


def _of_all_sides(points: Array, inward: Array, wrap: tuple[bool, bool]) -> Array:
    """The mean of the normals of the four cells around each node, on the side of the directions that are known."""
    total = np.zeros_like(points)
    for i, j in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        du, there = _to_neighbour(points, 0, i, wrap=wrap[0])
        dv, here = _to_neighbour(points, 1, j, wrap=wrap[1])
        normal = i * j * np.cross(du, dv)
        length = np.linalg.norm(normal, axis=2, keepdims=True)
        counts = (there & here)[..., None] & (length > 0.0)
        total += np.where(counts, normal / np.where(length > 0.0, length, 1.0), 0.0)
    total *= np.sign(np.einsum("ijc,ijc->", total, inward))
    length = np.linalg.norm(total, axis=2, keepdims=True)
    return np.where(length > 0.0, total / np.where(length > 0.0, length, 1.0), inward)


def _to_neighbour(points: Array, axis: int, step: int, *, wrap: bool) -> tuple[Array, NDArray[np.bool_]]:
    """From each node to the next along an axis, or the one before (`step` -1); and which nodes have such a neighbour."""
    way = np.roll(points, -step, axis=axis) - points
    known = np.ones(points.shape[:2], dtype=np.bool_)
    if not wrap:
        last = [slice(None), slice(None)]
        last[axis] = slice(-1, None) if step == 1 else slice(0, 1)
        known[tuple(last)] = False
    return way, known


def _filled(points: Array, normals: Array, wrap: tuple[bool, bool]) -> Array:
    """The normals, with those that are missing taken from their neighbours."""
    missing = np.asarray(~np.isfinite(normals).all(axis=2))
    if not missing.any():
        return normals
    known = np.where(missing[..., None], 0.0, normals)
    span = float(np.linalg.norm(points.reshape(-1, 3).max(axis=0) - points.reshape(-1, 3).min(axis=0)))
    spread = _smoothed(points, known, 0.05 * span, wrap)
    return np.where(missing[..., None], spread, normals)


def _smoothed(points: Array, field: Array, reach: float, wrap: tuple[bool, bool]) -> Array:
    smooth = field
    for axis in (0, 1):
        smooth = _diffused(points, smooth, axis, reach, wrap=wrap[axis])
    length = np.linalg.norm(smooth, axis=2, keepdims=True)
    return smooth / np.where(length > 0.0, length, 1.0)


def _diffused(points: Array, field: Array, axis: int, reach: float, *, wrap: bool) -> Array:
    """One implicit step of diffusion along the grid lines of `axis`, over about `reach` [L]: f - reach^2 f'' = field.

    Finite volumes on the true distances, solved by elimination (Thomas) line by line; a closed direction is unrolled
    three times.
    """
    p, f = np.moveaxis(points, axis, 0), np.moveaxis(field, axis, 0)
    count = len(p)
    if wrap:
        p, f = np.concatenate([p, p, p]), np.concatenate([f, f, f])
    gap = np.linalg.norm(np.diff(p, axis=0), axis=2)
    gap = np.maximum(gap, 1e-9 * max(float(gap.max()), 1e-300))
    cell = 0.5 * np.concatenate([gap[:1], gap[1:] + gap[:-1], gap[-1:]])
    above, below = np.zeros(p.shape[:2]), np.zeros(p.shape[:2])
    below[1:] = -(reach**2) / (gap * cell[1:])
    above[:-1] = -(reach**2) / (gap * cell[:-1])
    diagonal, right = 1.0 - above - below, f.copy()
    for i in range(1, len(p)):
        factor = below[i] / diagonal[i - 1]
        diagonal[i] -= factor * above[i - 1]
        right[i] -= factor[:, None] * right[i - 1]
    result = np.empty_like(right)
    result[-1] = right[-1] / diagonal[-1][:, None]
    for i in range(len(p) - 2, -1, -1):
        result[i] = (right[i] - above[i][:, None] * result[i + 1]) / diagonal[i][:, None]
    if wrap:
        result = result[count : 2 * count]
    return np.moveaxis(result, 0, axis)
