"""A cover of a solid's surface by small boxes that provably hold all of it.

Boxes over which the solid's function has one sign, by its bounds, are dropped; the others are cut in eight, level by level.
The distance to the middles of those left, less their radius, is a lower bound of the distance to the surface, and as a
minimum of distances it is 1-Lipschitz.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

ENOUGH = 5000
"""Boxes of the surface at which no finer level is made; it has up to four times as many."""

MOST_LEVELS = 20
"""A solid of a 1e-5 th of its box is still found."""


@dataclass(frozen=True, slots=True, eq=False)
class Cover:
    """centres (n, 3) and half (3,) : the boxes that may hold surface. corners (2, 3) : of all that may be solid; NaN
    where nothing is. known : a point of the solid, where a whole box of it was found."""

    centres: Array
    half: Array
    corners: Array
    known: Array | None
    tree: cKDTree

    @property
    def radius(self) -> float:
        """Of a sphere around a box."""
        return float(np.linalg.norm(self.half)) * (1 + 1e-12)

    @property
    def empty(self) -> bool:
        """Whether nothing of the box can be solid."""
        return bool(np.isnan(self.corners).any())

    def clearance(self, points: Array) -> Array:
        """A lower bound (n,) of the distance from points (n, 3) to the surface; NaN for what is no point."""
        out = np.full(len(points), np.nan)
        known = np.isfinite(points).all(axis=1)
        out[known] = np.maximum(self.tree.query(points[known])[0] * (1 - 1e-12) - self.radius, 0.0)
        return out


def make_cover(span: Callable[[Array, Array], tuple[Array, Array]], corners: Array, enough: int = ENOUGH) -> Cover:
    """The cover of what lies in a box (2, 3). span : bounds of the solid's function over boxes (centres, half sizes)."""
    size = corners[1] - corners[0]
    count = np.maximum(1, np.round(8.0 * size / size.max())).astype(int)
    half = 0.5 * size / count
    axes = [corners[0, k] + half[k] * (2 * np.arange(count[k]) + 1) for k in range(3)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    low_corner, high_corner = np.full(3, np.inf), np.full(3, -np.inf)
    known: Array | None = None
    for level in range(MOST_LEVELS):
        low, high = span(centres, np.broadcast_to(half, centres.shape))
        full = centres[high < 0]
        if len(full):
            known = full[0] if known is None else known
            low_corner = np.minimum(low_corner, full.min(axis=0) - half)
            high_corner = np.maximum(high_corner, full.max(axis=0) + half)
        centres = centres[(low <= 0) & ~(high < 0)]
        if len(centres) == 0 or len(centres) >= enough or level == MOST_LEVELS - 1:
            break
        cut = half > 0.6 * half.max()  # boxes come near to cubes
        half = np.where(cut, 0.5 * half, half)
        sides = [(-1, 1) if c else (0,) for c in cut]
        shift = np.array([[i, j, k] for i in sides[0] for j in sides[1] for k in sides[2]]) * half
        centres = (centres[:, None] + shift).reshape(-1, 3)
    if len(centres):
        low_corner = np.minimum(low_corner, centres.min(axis=0) - half)
        high_corner = np.maximum(high_corner, centres.max(axis=0) + half)
    box = np.array([low_corner, high_corner])
    box[~np.isfinite(box)] = np.nan
    return Cover(centres, half, box, known, cKDTree(centres if len(centres) else np.zeros((1, 3))))
