"""Tools as plain formulas: how deep points lie in a solid, without the engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cadsculpt.collide.detect import FieldTool, PatchGrid, SurfaceTool
from cadsculpt.motion.pose import Pose
from cadsculpt.spline.surface import BSplineSurface
from cadsculpt.tools.implicit import ImplicitTool

Array = NDArray[np.float64]

SHAPES = ("sphere", "ellipsoid", "capsule", "cylinder", "cone", "box", "torus", "half_space")
SURFACES = ("ball", "cube", "ring")


@dataclass(frozen=True, slots=True)
class Solid:
    """A solid in its own frame. depth (points) -> (n,) : a lower bound of the depth where positive; its sign is the
    truth. anchor (3,) : a point well inside. size : about its extent. placed (pose) : the engine's tool there.
    """

    name: str
    depth: Callable[[Array], Array]
    anchor: Array
    size: float
    placed: Callable[[Pose], FieldTool | SurfaceTool]


def random_implicit(rng: np.random.Generator, name: str, size: float) -> Solid:
    """An implicit shape of about this size: stout, slender or flat."""
    a, b, c = size * 10.0 ** rng.uniform(-0.7, 0.0, 3)
    rounding = float(rng.uniform(0, 0.4)) * float(rng.random() < 0.5)
    anchor = np.zeros(3)
    match name:
        case "sphere":
            tool, depth = ImplicitTool.sphere(a), lambda x: a - np.linalg.norm(x, axis=1)
        case "ellipsoid":
            e = np.array([a, b, c])
            tool, depth = ImplicitTool.ellipsoid((a, b, c)), lambda x: e.min() * (1 - np.linalg.norm(x / e, axis=1))
        case "capsule":
            tool = ImplicitTool.capsule(a, b)

            def depth(x: Array) -> Array:
                z = x[:, 2] - np.clip(x[:, 2], -0.5 * b, 0.5 * b)
                return a - np.sqrt(x[:, 0] ** 2 + x[:, 1] ** 2 + z**2)

        case "cylinder":
            rho = rounding * min(a, 0.5 * b)
            tool = ImplicitTool.cylinder(a, b, rho)

            def depth(x: Array) -> Array:
                return rounded(np.stack([np.hypot(x[:, 0], x[:, 1]), x[:, 2]], axis=1), np.array([a, 0.5 * b]), rho)

        case "cone":
            tool, anchor = ImplicitTool.cone(a, b), np.array([0, 0, 0.7 * b])
            side = b / np.hypot(a, b)

            def depth(x: Array) -> Array:
                return np.minimum(b - x[:, 2], side * (a * x[:, 2] / b - np.hypot(x[:, 0], x[:, 1])))

        case "box":
            rho = rounding * 0.5 * min(a, b, c)
            tool, half = ImplicitTool.box((a, b, c), rho), 0.5 * np.array([a, b, c])

            def depth(x: Array) -> Array:
                return rounded(x, half, rho)

        case "torus":
            minor = b * (0.9 if rng.random() < 0.5 else 0.2)
            tool, anchor = ImplicitTool.torus(a, minor), np.array([a, 0, 0])

            def depth(x: Array) -> Array:
                return minor - np.hypot(np.hypot(x[:, 0], x[:, 1]) - a, x[:, 2])

        case _:
            tool, depth, anchor = ImplicitTool.half_space(), lambda x: x[:, 2], np.array([0, 0, size])
    return Solid(name, depth, anchor, size, tool.placed)


def rounded(x: Array, half: Array, rho: float) -> Array:
    """Depth in a box with rounded edges: (n, k) against half sizes (k,)."""
    q = np.abs(x) - (half - rho)
    return rho - np.linalg.norm(np.maximum(q, 0), axis=1) - np.minimum(q.max(axis=1), 0)


def random_closed(rng: np.random.Generator, name: str, size: float) -> Solid:
    """The same from B-spline patches: an exact ball (poles), a cube (six faces), an exact torus (closed both ways)."""
    radius, minor = 0.5 * size, 0.15 * size
    patches = {"ball": lambda: [ball(radius)], "cube": lambda: cube(size), "ring": lambda: [ring(radius, minor)]}[name]()
    resolution = {"ball": (25, 13), "cube": (5, 5), "ring": (33, 17)}[name]
    grids = tuple(PatchGrid.of(patch, resolution) for patch in patches)
    depth: Callable[[Array], Array] = {
        "ball": lambda x: radius - np.linalg.norm(x, axis=1),
        "cube": lambda x: radius - np.abs(x).max(axis=1),
        "ring": lambda x: minor - np.hypot(np.hypot(x[:, 0], x[:, 1]) - radius, x[:, 2]),
    }[name]

    def placed(pose: Pose) -> SurfaceTool:
        return SurfaceTool(
            grids, tuple(np.ascontiguousarray(pose.to_world(grid.surface.control_points)) for grid in grids)
        )

    anchor = np.array([radius, 0, 0]) if name == "ring" else np.zeros(3)
    return Solid(name, depth, anchor, size, placed)


CIRCLE = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]], dtype=float)
CIRCLE_WEIGHTS = np.array([1, np.sqrt(0.5)] * 4 + [1])
CIRCLE_KNOTS = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4.0])


def revolved(profile: Array, weights: Array, knots: Array) -> BSplineSurface:
    """A profile (k, 2) of (radius, z), quadratic, turned about z (Piegl and Tiller, section 8.5); outward is S_u x S_v
    where the profile runs upwards."""
    net = np.empty((9, len(profile), 3))
    net[..., :2] = CIRCLE[:, None] * profile[None, :, :1]
    net[..., 2] = profile[None, :, 1]
    return BSplineSurface(net, CIRCLE_KNOTS, knots, 2, 2, CIRCLE_WEIGHTS[:, None] * weights)


def ball(radius: float) -> BSplineSurface:
    half = np.array([[0, -1], [1, -1], [1, 0], [1, 1], [0, 1.0]])
    return revolved(radius * half, CIRCLE_WEIGHTS[:5], np.array([0, 0, 0, 1, 1, 2, 2, 2.0]))


def ring(major: float, minor: float) -> BSplineSurface:
    return revolved([major, 0] + minor * CIRCLE, CIRCLE_WEIGHTS, CIRCLE_KNOTS)


def cube(size: float) -> list[BSplineSurface]:
    faces, knots = [], np.array([0.0, 0, 1, 1])
    for axis in range(3):
        for side in (-1.0, 1.0):
            n, u, v = (np.eye(3)[(axis + k) % 3] * 0.5 * size for k in range(3))
            u, v = (u, v) if side > 0 else (v, u)
            net = np.array([[side * n - u - v, side * n - u + v], [side * n + u - v, side * n + u + v]])
            faces.append(BSplineSurface(net, knots, knots, 1, 1))
    return faces


def random_turn(rng: np.random.Generator) -> Array:
    """A rotation; one in five along the axes, where things line up."""
    if rng.random() < 0.2:
        turn = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    else:
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return np.ascontiguousarray(turn * np.sign(np.linalg.det(turn)))
