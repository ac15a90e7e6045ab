"""Trimmed faces whose inside is a closed formula: what a random face is, and which points are surely on or off it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from truth_solids import CIRCLE, CIRCLE_KNOTS, CIRCLE_WEIGHTS

from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

Array = NDArray[np.float64]

KINDS = ("disc", "hole", "triangle", "strip", "small hole", "comb")

CHORD = 5e-3
"""The engine follows a curved trim by chords, which leave a quarter circle by less than this part of its radius."""


@dataclass(frozen=True, slots=True)
class Face:
    """A surface and its face. value (u, v) -> (n,) : positive on the face; points between -doubt and doubt may be
    either."""

    surface: BSplineSurface
    value: Callable[[Array, Array], Array]
    doubt: float


def whole(surface: BSplineSurface) -> Face:
    return Face(surface, lambda u, v: np.ones(np.broadcast_shapes(u.shape, v.shape)), 0.0)


def trimmed(rng: np.random.Generator, surface: BSplineSurface, kind: str) -> Face:
    """The surface's face of that kind, in the middle of its domain or at its rim; thin ones thinner than a cell."""
    (u0, u1), (v0, v1) = surface.domain
    span = np.array([u1 - u0, v1 - v0])
    corner = np.array([u0, v0])

    def part(u: Array, v: Array) -> tuple[Array, Array]:
        return (u - u0) / span[0], (v - v0) / span[1]

    rim = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    if kind in ("disc", "hole", "small hole"):
        centre = rng.uniform(0.3, 0.7, 2)
        radii = rng.uniform(0.002, 0.02, 2) if kind == "small hole" else rng.uniform(0.05, 0.28, 2)
        curve = TrimCurve(corner + span * (centre + radii * CIRCLE), CIRCLE_KNOTS, 2, CIRCLE_WEIGHTS)
        sign = 1.0 if kind == "disc" else -1.0

        def round_value(u: Array, v: Array) -> Array:
            a, b = part(u, v)
            return sign * (1.0 - np.hypot((a - centre[0]) / radii[0], (b - centre[1]) / radii[1]))

        loops = (TrimLoop((curve,), sign > 0),)
        if sign < 0:
            loops = (polygon(rim, corner, span), *loops)
        return Face(replace(surface, trims=loops), round_value, CHORD)
    if kind == "comb":
        # a plate with thin teeth: most of the face is rough, some of it thinner than any cell
        width = rng.uniform(0.002, 0.03)
        teeth = np.sort(rng.uniform(0.1, 0.85, 3))
        teeth = teeth[np.concatenate([[True], np.diff(teeth) > 2 * width])]
        pieces = [np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 1.0], [0.0, 1.0]])]
        chain = [(0.0, 0.0), (0.4, 0.0)]
        for t in teeth:
            chain += [(0.4, t), (0.95, t), (0.95, t + width), (0.4, t + width)]
            pieces.append(np.array([[0.3, t], [0.95, t], [0.95, t + width], [0.3, t + width]]))
        chain += [(0.4, 1.0), (0.0, 1.0)]
        return Face(replace(surface, trims=(polygon(chain, corner, span),)), union_value(pieces, part), 1e-6)
    if kind == "triangle":
        corners = rng.uniform(0.02, 0.98, (3, 2))
        a, b = corners[1] - corners[0], corners[2] - corners[0]
        corners = corners if a[0] * b[1] - a[1] * b[0] > 0 else corners[::-1]
    else:
        # a strip across, at any angle, often between the rows of any grid
        middle, angle = rng.uniform(0.3, 0.7, 2), rng.choice([0.0, 0.5 * np.pi, rng.uniform(0, np.pi)])
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        long, thin = rng.uniform(0.1, 0.3), 10.0 ** rng.uniform(-2.5, -1)
        corners = middle + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ np.stack([long * along, thin * across])
    loop = polygon([tuple(c) for c in corners], corner, span)
    return Face(replace(surface, trims=(loop,)), union_value([corners], part), 1e-6)


def polygon(corners: list[tuple[float, float]], corner: Array, span: Array) -> TrimLoop:
    """A loop of straight lines through points given as parts of the domain."""
    line = np.array([0.0, 0, 1, 1])
    ends = [corner + span * np.array(c) for c in corners]
    return TrimLoop(tuple(TrimCurve(np.array([a, b]), line, 1) for a, b in zip(ends, ends[1:] + ends[:1], strict=True)))


def union_value(
    pieces: list[Array], part: Callable[[Array, Array], tuple[Array, Array]]
) -> Callable[[Array, Array], Array]:
    """Distance inside convex counterclockwise polygons: positive in one of them."""

    def value(u: Array, v: Array) -> Array:
        a, b = part(u, v)
        best = np.full(np.broadcast_shapes(a.shape, b.shape), -np.inf)
        for piece in pieces:
            inside = np.full(best.shape, np.inf)
            for p, q in zip(piece, np.roll(piece, -1, axis=0), strict=True):
                d = (q - p) / np.linalg.norm(q - p)
                inside = np.minimum(inside, d[0] * (b - p[1]) - d[1] * (a - p[0]))
            best = np.maximum(best, inside)
        return best

    return value
