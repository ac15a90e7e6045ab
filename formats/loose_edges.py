"""Edges of surfaces that come without topology: along their trims or their domain's sides, and which of them meet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..spline.matrices import breakpoints
from ..spline.surface import BSplineSurface, TrimCurve
from .part import FaceEdge

Array = NDArray[np.float64]

MEETING = 1e-5
"""Two edges are one when they run within this fraction of the part's size of each other."""


def edges_of_surface(surface: BSplineSurface) -> list[FaceEdge]:
    """The edges of one face, loop by loop and in their direction; an untrimmed surface has its domain's four sides."""
    from .occt.boundary import sample_edge

    edges = []
    for curve in boundary_curves(surface):
        uv, points = sample_edge(surface, curve)
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
        edges.append(FaceEdge(uv, points, degenerate=size <= 1e-9 * surface.size))
    return edges


def boundary_curves(surface: BSplineSurface) -> list[TrimCurve]:
    """The trim curves of all loops; of an untrimmed surface the sides of its domain, anticlockwise."""
    if surface.trims is not None:
        return [curve for loop in surface.trims for curve in loop.curves]
    (u0, u1), (v0, v1) = surface.domain
    corners = np.array([(u0, v0), (u1, v0), (u1, v1), (u0, v1), (u0, v0)])
    inner = (breakpoints(surface.knots_u, surface.degree_u), breakpoints(surface.knots_v, surface.degree_v))
    sides = []
    for k, (axis, backward) in enumerate(((0, False), (1, False), (0, True), (1, True))):
        low, high = surface.domain[axis]
        knots = low + high - inner[axis][::-1] if backward else inner[axis]
        knots[[0, -1]] = low, high
        share = ((knots - low) / (high - low))[:, None]
        points = (1.0 - share) * corners[k] + share * corners[k + 1]
        sides.append(TrimCurve(points, np.concatenate([knots[:1], knots, knots[-1:]]), 1))
    return sides


def join(faces: Sequence[Sequence[FaceEdge]]) -> list[list[FaceEdge]]:
    """The same edges with the numbers (from 1) of the other faces that have them too; one twice in a face is a seam."""
    flat = [(number, edge) for number, edges in enumerate(faces, 1) for edge in edges]
    points = [edge.points for _, edge in flat if len(edge.points)]
    if not points:
        return [list(edges) for edges in faces]
    whole = np.concatenate(points)
    tolerance = MEETING * float(np.linalg.norm(np.ptp(whole, axis=0)))
    boxes = np.array([(e.points.min(axis=0), e.points.max(axis=0)) for _, e in flat])
    shared: list[set[int]] = [set() for _ in flat]
    seams = [False] * len(flat)
    slack = np.array([tolerance + _sag(edge.points) for _, edge in flat])
    for i, (face, edge) in enumerate(flat):
        if edge.degenerate:
            continue
        reach = np.maximum(slack, slack[i])[:, None, None]
        near = (np.abs(boxes - boxes[i]) <= reach).all(axis=(1, 2))
        for j in np.flatnonzero(near[i + 1 :]) + i + 1:
            other_face, other = flat[j]
            if other.degenerate or not _same(edge.points, other.points, slack[i], slack[j]):
                continue
            if other_face == face:
                seams[i] = seams[j] = True
            else:
                shared[i].add(other_face)
                shared[j].add(face)
    done = iter(replace(edge, neighbours=tuple(sorted(shared[k])), seam=seams[k]) for k, (_, edge) in enumerate(flat))
    return [[next(done) for _ in edges] for edges in faces]


def _sag(points: Array) -> float:
    """How far a chain's chords may run from its curve: an eighth of the second differences."""
    if len(points) < 3:
        return 0.0
    return float(np.linalg.norm(points[2:] - 2 * points[1:-1] + points[:-2], axis=1).max() / 8)


def _same(a: Array, b: Array, slack_a: float, slack_b: float) -> bool:
    return distance_to_chain(a, b) <= slack_b and distance_to_chain(b, a) <= slack_a


def distance_to_chain(points: Array, chain: Array) -> float:
    """The largest distance of points (n, 3) from a chain of chords through (m, 3)."""
    start, way = chain[:-1], np.diff(chain, axis=0)
    length = np.maximum(np.einsum("ij,ij->i", way, way), 1e-300)
    offset = points[:, None] - start
    share = np.clip(np.einsum("nij,ij->ni", offset, way) / length, 0.0, 1.0)
    return float(np.linalg.norm(offset - share[..., None] * way, axis=2).min(axis=1).max())
