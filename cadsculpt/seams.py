"""Edges that two faces of one body share, so that their nodes there move as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .patch import Patch, SourceEdge
from .spline.surface import BSplineSurface

Array = NDArray[np.float64]

POINTS = 257
"""Points along a seam: far more than nodes."""

NEAR = 1e-3
"""Two edges are one where they are nowhere farther apart than this share of their length: CAD's own gaps, and the chords of
their polylines."""


@dataclass(frozen=True, slots=True, eq=False)
class Seam:
    """A common edge of two patches, by their numbers in the model: uv_first, uv_second (POINTS, 2) are the same points."""

    first: int
    second: int
    uv_first: Array
    uv_second: Array


def seams_between(patches: Sequence[Patch]) -> list[Seam]:
    """All edges that patches of one body share, in the order of the patches."""
    found = []
    for i, a in enumerate(patches):
        for j, b in enumerate(patches[i + 1 :], start=i + 1):
            if a.body != b.body:
                continue
            mine = [edge for edge in a.source.edges if b.name in edge.neighbours and not edge.degenerate]
            its = [edge for edge in b.source.edges if a.name in edge.neighbours and not edge.degenerate]
            curves = [_curve(a.surface, edge) for edge in mine], [_curve(b.surface, edge) for edge in its]
            for uv_a, points_a in curves[0]:
                for uv_b, points_b in curves[1]:
                    length = float(np.linalg.norm(np.diff(points_a, axis=0), axis=1).sum())
                    for way in (1, -1):
                        if np.linalg.norm(points_a - points_b[::way], axis=1).max() <= NEAR * length:
                            found.append(Seam(i, j, uv_a, uv_b[::way].copy()))
                            break
    return found


def _curve(surface: BSplineSurface, edge: SourceEdge) -> tuple[Array, Array]:
    """Parameters (POINTS, 2) and points (POINTS, 3) at equal lengths along an edge."""
    knots = np.linspace(0.0, 1.0, len(edge.uv))
    t = np.union1d(knots, np.linspace(0.0, 1.0, 4 * POINTS))
    uv = np.stack([np.interp(t, knots, edge.uv[:, k]) for k in (0, 1)], axis=1)
    (u0, u1), (v0, v1) = surface.domain
    points = surface.evaluate(np.clip(uv[:, 0], u0, u1), np.clip(uv[:, 1], v0, v1))
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    even = np.linspace(0.0, way[-1], POINTS)
    return (
        np.stack([np.interp(even, way, uv[:, k]) for k in (0, 1)], axis=1),
        np.stack([np.interp(even, way, points[:, k]) for k in (0, 1, 2)], axis=1),
    )
