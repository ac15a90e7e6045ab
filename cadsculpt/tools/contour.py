"""Triangles of the surface f = 0, watertight and facing out: surface nets (Gibson 1998) with the vertices drawn onto it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CELLS = 64
"""Cells along the longest side."""


def contour(
    value: Callable[[Array], Array], field: Callable[[Array], tuple[Array, Array]], corners: Array, cells: int = CELLS
) -> tuple[Array, Index]:
    """Points (k, 3) and triangles (f, 3) of what is negative in a box (2, 3), counter-clockwise seen from outside.

    value : f at points (n, 3). field : signed distance and normal, which draw each vertex onto the surface. Each cell
    that f changes sign in has one vertex; each edge of the grid along which it does, a quadrangle of the four around it.
    """
    size = corners[1] - corners[0]
    h = float(size.max()) / cells
    count = np.ceil(size / h).astype(int) + 5
    start = 0.5 * (corners[0] + corners[1]) - 0.5 * h * (count - 1)
    axes = [start[k] + h * np.arange(count[k]) for k in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    f = value(grid.reshape(-1, 3)).reshape(grid.shape[:3])
    inside = f < 0
    inside[[0, -1]] = inside[:, [0, -1]] = inside[:, :, [0, -1]] = False  # a half-space ends with the picture
    f = np.where(inside, f, np.abs(f))
    total = np.zeros((*(count - 1), 3))
    crossings = np.zeros(count - 1)
    quads = []
    for axis in range(3):
        ahead = tuple(slice(1, None) if k == axis else slice(None) for k in range(3))
        behind = tuple(slice(None, -1) if k == axis else slice(None) for k in range(3))
        at = np.argwhere(inside[ahead] != inside[behind])
        a, b = f[behind][tuple(at.T)], f[ahead][tuple(at.T)]
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.clip(np.nan_to_num(np.abs(a) / (np.abs(a) + np.abs(b)), nan=0.5), 0.0, 1.0)
        point = start + h * at
        point[:, axis] += h * share
        i, j = (axis + 1) % 3, (axis + 2) % 3
        around = []
        for di, dj in ((0, 0), (-1, 0), (-1, -1), (0, -1)):
            cell = at.copy()
            cell[:, i] += di
            cell[:, j] += dj
            np.add.at(total, tuple(cell.T), point)
            np.add.at(crossings, tuple(cell.T), 1.0)
            around.append(np.ravel_multi_index(tuple(cell.T), tuple(count - 1)))
        quad = np.stack(around, axis=1)
        outwards = inside[behind][tuple(at.T)]  # from solid to air along the axis
        quads.append(np.where(outwards[:, None], quad, quad[:, ::-1]))
    full = np.concatenate(quads)
    used, names = np.unique(full, return_inverse=True)
    names = names.reshape(full.shape)
    points = total.reshape(-1, 3)[used] / crossings.reshape(-1)[used, None]
    distance, normal = field(points)
    drawn = points - distance[:, None] * normal
    near = np.linalg.norm(drawn - points, axis=1) <= h
    points = np.where(near[:, None], drawn, points)
    triangles = np.concatenate([names[:, [0, 1, 2]], names[:, [0, 2, 3]]]).astype(np.int64)
    return points, triangles
