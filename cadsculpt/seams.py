"""Edges that two faces of one body share, so that their nodes there move as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .patch import Patch, SourceEdge
from .spline.surface import BSplineSurface

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

POINTS = 257
"""Points along a seam: far more than nodes."""

NEAR = 1e-3
"""Two edges are one where they are nowhere farther apart than this share of their length: CAD's own gaps, and the chords of
their polylines."""

SMOOTH = 0.85
"""Cosine of the angle between two faces' normals above which an edge is no crease: 30 degrees."""

SKIN = 0.75
"""What is held below a face and lies in the outer part of the skin of its neighbour, this share of its thickness, is let go."""


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


def with_free_creases(patches: Sequence[Patch]) -> list[Patch]:
    """The patches, less what is held in the wrong place: beside a convex crease the base of one face lies in the skin, and at
    the edge itself on the surface, of the other. The edge could not give way if it were held there."""
    loose = [np.zeros(patch.lattice.anchored.shape, np.bool_) for patch in patches]
    for seam in seams_between(patches):
        for i, uv, j, other in (
            (seam.first, seam.uv_first, seam.second, seam.uv_second),
            (seam.second, seam.uv_second, seam.first, seam.uv_first),
        ):
            loose[i] |= _in_skin(patches[i], uv, patches[j], other)
    return [
        _loosened(patch, nodes & patch.lattice.anchored) if (nodes & patch.lattice.anchored).any() else patch
        for patch, nodes in zip(patches, loose, strict=True)
    ]


def _in_skin(patch: Patch, uv: Array, other: Patch, uv_other: Array) -> Mask:
    """The base nodes (N,) of a patch that lie in the skin of another with which it has a convex crease along uv, of columns
    whose surface nodes are not held."""
    lattice = patch.lattice
    found = np.zeros(lattice.anchored.shape, np.bool_)
    edge = patch.surface.evaluate(uv[:, 0], uv[:, 1])
    mine, its = (p.surface.normal(at[:, 0], at[:, 1]) for p, at in ((patch, uv), (other, uv_other)))
    columns = lattice.nodes.reshape(-1, lattice.shape[2], 3)
    away, nearest = cKDTree(edge).query(columns[:, 0])
    normal = its[nearest]
    # a face falls away below its neighbour's plane at a convex crease, and rises above it at a concave one
    if not np.nanmean(np.einsum("nc,nc->n", columns[:, 0] - edge[nearest], normal)) < 0.0:
        return found
    sharp = np.einsum("nc,nc->n", mine, its)[nearest] < SMOOTH
    # columns beside the edge, which are tied to it, count as on it
    origin = np.where((away <= patch.law.spacing)[:, None], columns[:, 0], edge[nearest])
    depth = -np.einsum("nc,nc->n", columns[:, -1] - origin, normal)
    held = lattice.anchored.reshape(-1, lattice.shape[2])
    inside = sharp & (depth < SKIN * other.lattice.thickness) & ~held[:, 0] & held[:, -1]
    found.reshape(-1, lattice.shape[2])[:, -1] = inside
    return found


def _loosened(patch: Patch, nodes: Mask) -> Patch:
    """A patch some of whose nodes (N,) are not held any more."""
    lattice = patch.lattice
    anchored = lattice.anchored & ~nodes
    inverse = np.where(nodes & lattice.active & (lattice.mass > 0.0), 1.0 / np.maximum(lattice.mass, 1e-300), 0.0)
    freed = replace(lattice, anchored=anchored, inverse_mass=np.where(nodes, inverse, lattice.inverse_mass))
    # (its highest frequency is that of its group's lattice, which is made from it)
    return replace(patch, lattice=freed, law=replace(patch.law, lattice=freed))


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
