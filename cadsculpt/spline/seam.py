"""The common edge of two faces, point by point, and how well two surfaces meet along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .surface import BSplineSurface

Array = NDArray[np.float64]

POINTS = 1024
"""Places along a seam where its two sides are compared, at least."""

MEETING = 1e-4
"""Two edges are one when they run within this part of the faces' size of each other."""

POLE = 1e-6
"""A direction in which the whole domain would be shorter than this part of the surface's size is none."""

RELATIVE = 1e-7
"""How far apart two faces may be along their common edge when their file says nothing, as a part of their size."""


Source = Literal["file", "edge", "size", "scene"]
"""Who says how far apart two faces may be: the file of all its geometry, an edge of its own, nobody (a part of the faces'
size), or the scene."""


@dataclass(frozen=True, slots=True)
class Bound:
    """How far apart two faces may be along their common edge, and who says so."""

    tolerance: float
    source: Source = "size"


@dataclass(frozen=True, slots=True, eq=False)
class Seam:
    """The common edge of faces a and b (of one face with itself: a == b).

    uv_a, uv_b (n, 2) : the same points in space on either face, in order along the edge. tolerance : how far apart they may
    be. source : who says so. rest_gap : how far apart they are as read. rest_angle : largest angle of the normals there,
    degrees.
    """

    a: int
    b: int
    uv_a: Array
    uv_b: Array
    tolerance: float
    rest_gap: float
    rest_angle: float
    source: Source = "size"

    def swapped(self) -> Seam:
        """The same seam seen from face b."""
        return replace(self, a=self.b, b=self.a, uv_a=self.uv_b, uv_b=self.uv_a)

    @property
    def allowed(self) -> float:
        """The gap that it has as read or may have."""
        return max(self.tolerance, self.rest_gap)


def seam_of(
    a: int,
    surface_a: BSplineSurface,
    edge_a: Array,
    b: int,
    surface_b: BSplineSurface,
    edges_b: Sequence[Array],
    bound: Bound | None = None,
) -> Seam | None:
    """The seam along edge_a (n, 2) of face a and the one of the edges of face b that it runs along; None if none does."""
    size = max(surface_a.size, surface_b.size)
    edge, own = _subdivided(edge_a)
    points = surface_a.evaluate(edge[:, 0], edge[:, 1])
    best: tuple[float, Array, Array] | None = None
    for candidate in edges_b:
        start = _nearest_on(points, surface_b, _subdivided(candidate)[0])
        uv = closest(surface_b, points, start)
        away = np.linalg.norm(surface_b.evaluate(uv[:, 0], uv[:, 1]) - points, axis=1)
        # chords of a curved edge leave it: only the file's own places must be there
        off = float(np.linalg.norm(surface_b.evaluate(*start.T) - points, axis=1).max())
        if away[own].max() <= MEETING * size and off <= 0.05 * size and (best is None or off < best[0]):
            near = away <= max(2.0 * float(away[own].max()), RELATIVE * size, bound.tolerance if bound else 0.0)
            best = off, edge[near], uv[near]
    if best is None:
        return None
    bound = bound or Bound(RELATIVE * size)
    seam = Seam(a, b, best[1], best[2], bound.tolerance, 0.0, 0.0, bound.source)
    return replace(seam, rest_gap=gap(seam, surface_a, surface_b), rest_angle=angle(seam, surface_a, surface_b))


def own_seam(number: int, surface: BSplineSurface, axis: int, bound: Bound | None = None) -> Seam:
    """The seam of a surface that is closed along `axis`."""
    low, high = surface.domain[axis]
    along = np.linspace(*surface.domain[1 - axis], POINTS + 1)
    sides = [np.stack([np.full(len(along), t), along], axis=1) for t in (low, high)]
    a, b = sides if axis == 0 else [side[:, ::-1] for side in sides]
    bound = bound or Bound(RELATIVE * surface.size)
    seam = Seam(number, number, a, b, bound.tolerance, 0.0, 0.0, bound.source)
    return replace(seam, rest_gap=gap(seam, surface, surface), rest_angle=angle(seam, surface, surface))


def gap(seam: Seam, surface_a: BSplineSurface, surface_b: BSplineSurface) -> float:
    """Largest distance of the two sides at the seam's points: no smaller than how far the edges are apart."""
    return float(np.linalg.norm(surface_a.evaluate(*seam.uv_a.T) - surface_b.evaluate(*seam.uv_b.T), axis=1).max())


def angle(seam: Seam, surface_a: BSplineSurface, surface_b: BSplineSurface) -> float:
    """Largest angle, in degrees, between the two sides' tangent planes at the seam's points; poles left out."""
    plain = _plain(surface_a, seam.uv_a) & _plain(surface_b, seam.uv_b)
    a, b = surface_a.normal(*seam.uv_a[plain].T), surface_b.normal(*seam.uv_b[plain].T)
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    turned = np.degrees(np.arctan2(sine, np.abs(np.einsum("nc,nc->n", a, b))))
    turned = turned[np.isfinite(turned)]
    return float(turned.max(initial=0.0))


def _plain(surface: BSplineSurface, uv: Array) -> NDArray[np.bool_]:
    """Where a surface has two directions: not at a pole, where the normal is one of rounding."""
    jet = surface.derivatives(uv[:, 0], uv[:, 1], 1)
    reach = np.diff(np.array(surface.domain), axis=1)[:, 0]
    lengths = [np.linalg.norm(slope, axis=1) * r for slope, r in zip((jet[1, 0], jet[0, 1]), reach, strict=True)]
    return np.asarray(np.minimum(*lengths) > POLE * surface.size)


def closest(surface: BSplineSurface, points: Array, start: Array, rounds: int = 20) -> Array:
    """Parameters (n, 2) of the points of the surface nearest to points (n, 3), from a start (n, 2) nearby (Gauss-Newton)."""
    low, high = np.array(surface.domain).T
    uv = np.clip(start, low, high)
    for _ in range(rounds):
        jet = surface.derivatives(uv[:, 0], uv[:, 1], 1)
        a, b, r = jet[1, 0], jet[0, 1], points - jet[0, 0]
        aa, ab, bb = (np.einsum("nc,nc->n", *pair) for pair in ((a, a), (a, b), (b, b)))
        ra, rb = np.einsum("nc,nc->n", r, a), np.einsum("nc,nc->n", r, b)
        # a pole has no direction along its collapsed side
        det = aa * bb - ab * ab + 1e-14 * (aa + bb) ** 2 + 1e-300
        step = np.stack([bb * ra - ab * rb, aa * rb - ab * ra], axis=1) / det[:, None]
        after = np.clip(uv + step, low, high)
        if np.abs(after - uv).max() <= 1e-15 * np.abs(high - low).max():
            return after
        uv = after
    return uv


def _subdivided(uv: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The polyline with its steps cut evenly, so that it has POINTS or more, and which of the points are its own."""
    pieces = max(1, -(-POINTS // (len(uv) - 1)))
    share = np.arange(pieces) / pieces
    inner = uv[:-1, None] + share[:, None] * np.diff(uv, axis=0)[:, None]
    points = np.concatenate([inner.reshape(-1, 2), uv[-1:]])
    return points, np.arange(len(points)) % pieces == 0


def _nearest_on(points: Array, surface: BSplineSurface, uv: Array) -> Array:
    """For each point (n, 3) the parameters of the nearest place on the chain of chords through the surface at uv (m, 2)."""
    chain = surface.evaluate(uv[:, 0], uv[:, 1])
    start, way = chain[:-1], np.diff(chain, axis=0)
    length = np.maximum(np.einsum("ij,ij->i", way, way), 1e-300)
    found = np.empty((len(points), 2))
    for first in range(0, len(points), 256):
        offset = points[first : first + 256, None] - start
        share = np.clip(np.einsum("nij,ij->ni", offset, way) / length, 0.0, 1.0)
        away = np.linalg.norm(offset - share[..., None] * way, axis=2)
        k = away.argmin(axis=1)
        s = share[np.arange(len(k)), k][:, None]
        found[first : first + 256] = uv[k] + s * (uv[k + 1] - uv[k])
    return found
