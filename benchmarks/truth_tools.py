"""Meshes, superquadrics, composed solids and formulas, with closed formulas for how deep points lie in them."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from truth_solids import BRACKET, Solid, in_bracket, random_turn, rounded

from cadsculpt.collide.mesh.triangle_mesh import TriangleMesh
from cadsculpt.motion.pose import Pose
from cadsculpt.tools.composed import ComposedTool
from cadsculpt.tools.implicit import ImplicitTool
from cadsculpt.tools.mesh import MeshTool
from cadsculpt.tools.superquadric import SuperquadricTool

Array = NDArray[np.float64]

MESHES = ("hull", "mesh bracket")
COMPOSED = ("union", "difference", "formula")

STOCK = (0.05, 0.4, 2.0)
"""Sizes of composed solids: each is made once, for that takes longer than a scene."""


def random_superquadric(rng: np.random.Generator, size: float) -> Solid:
    radii = size * 10.0 ** rng.uniform(-0.7, 0.0, 3)
    e = rng.uniform(0.1, 2.0, 2)
    p, q = 2.0 / e
    # for exponents up to 2 N is a norm, and the solid holds an octahedron
    inner = 1.0 / float(np.linalg.norm(1.0 / radii))

    def depth(x: Array) -> Array:
        y = np.abs(x) / radii
        across = np.maximum(y[:, 0], y[:, 1])
        ratio = np.minimum(y[:, 0], y[:, 1]) / np.maximum(across, 1e-300)
        around = across * (1.0 + ratio**q) ** (1.0 / q)
        most = np.maximum(around, y[:, 2])
        ratio = np.minimum(around, y[:, 2]) / np.maximum(most, 1e-300)
        return inner * (1.0 - most * (1.0 + ratio**p) ** (1.0 / p))

    tool = SuperquadricTool.of(tuple(radii.tolist()), tuple(e.tolist()))
    return Solid("superquadric", depth, np.zeros(3), size, tool.placed)


def random_mesh(rng: np.random.Generator, name: str, size: float) -> Solid:
    """A convex hull of random points, or an angle bracket of 20 triangles; corners in any order, faces turned any way."""
    if name == "hull":
        points = rng.normal(size=(int(rng.integers(5, 120)), 3))
        points *= 0.5 * size * 10.0 ** rng.uniform(-0.7, 0.0, 3) / np.linalg.norm(points, axis=1, keepdims=True)
        points -= points.mean(axis=0)
        hull = ConvexHull(points)
        planes = hull.equations
        vertices, triangles = points, hull.simplices.astype(np.int64)

        def depth(x: Array) -> Array:
            return -(x @ planes[:, :3].T + planes[:, 3]).max(axis=1)

        anchor = np.zeros(3)
    else:
        n = len(BRACKET)
        vertices = size * np.concatenate([np.column_stack([BRACKET, np.full(n, z)]) for z in (0.0, 0.5)])
        fan = [(0, k, k + 1) for k in range(1, n - 1)]
        # (the profile starts at the corner that sees all others)
        triangles = np.array(
            [(a, c, b) for a, b, c in fan]
            + [(n + a, n + b, n + c) for a, b, c in fan]
            + [t for k in range(n) for t in ((k, (k + 1) % n, n + k), (n + k, (k + 1) % n, n + (k + 1) % n))]
        )
        anchor = np.array([0.25, 0.25, 0.25]) * size

        def depth(x: Array) -> Array:
            return in_bracket(x, size)

    flip = rng.random(len(triangles)) < 0.5
    triangles = np.where(flip[:, None], triangles[:, ::-1], triangles)[rng.permutation(len(triangles))]
    tool = MeshTool.of(TriangleMesh.of(vertices, triangles))
    return Solid(name, depth, anchor, size, tool.placed)


def random_composed(rng: np.random.Generator, name: str) -> Solid:
    return composed(name, float(rng.choice(STOCK)), int(rng.integers(2)))


@cache
def composed(name: str, size: float, which: int) -> Solid:
    """One of a few joined solids and formulas of about this size."""
    rng = np.random.default_rng([which, len(name)])
    a = size * rng.uniform(0.3, 0.6, 3)
    r, away = 0.4 * size, size * rng.uniform(0.2, 0.4, 3)
    at = Pose(away, random_turn(rng)), Pose(np.zeros(3), np.eye(3))
    box = ImplicitTool.box(tuple((2 * a).tolist()))

    def in_box(x: Array) -> Array:
        return rounded(x, a, 0.0)

    def in_ball(x: Array) -> Array:
        return r - np.linalg.norm(x - away, axis=1)

    if name == "union":
        tool = ComposedTool.union([(box, at[1]), (ImplicitTool.sphere(r), at[0])])
        return Solid(name, lambda x: np.maximum(in_box(x), in_ball(x)), np.zeros(3), size, tool.placed)
    if name == "difference":
        tool = ComposedTool.difference([(box, at[1]), (ImplicitTool.sphere(r), at[0])])
        return Solid(name, lambda x: np.minimum(in_box(x), -in_ball(x)), -0.5 * a, size, tool.placed)
    # a norm again: the solid holds the octahedron of its radii
    k = (2, 4)[which]
    text = f"(x/{a[0]!r})**{k} + (y/{a[1]!r})**{k} + (z/{a[2]!r})**{k} - 1".replace("np.float64", "")
    inner = 1.0 / float(np.linalg.norm(1.0 / a))
    tool = ComposedTool.formula(text, ((-1.1 * a).tolist(), (1.1 * a).tolist()))
    return Solid(
        name, lambda x: inner * (1.0 - ((x / a) ** k).sum(axis=1) ** (1.0 / k)), np.zeros(3), size, tool.placed
    )
