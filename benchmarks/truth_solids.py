"""Tools as plain formulas: how deep points lie in a solid, without the engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cadsculpt.collide.detect import FieldTool, PatchGrid, SurfaceTool
from cadsculpt.motion.pose import Pose
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop
from cadsculpt.tools.implicit import ImplicitTool

Array = NDArray[np.float64]

SHAPES = ("sphere", "ellipsoid", "capsule", "cylinder", "cone", "box", "torus", "half_space")
SURFACES = ("ball", "cube", "ring", "bracket")


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
    """The same from B-spline patches: an exact ball (poles), a cube (six faces), an exact torus (closed both ways), an
    angle bracket (trimmed faces of planes that run on through it)."""
    radius, minor = 0.5 * size, 0.15 * size
    patches = {"ball": lambda: [ball(radius)], "cube": lambda: cube(size), "ring": lambda: [ring(radius, minor)]}
    patches["bracket"] = lambda: bracket(size)
    patches = patches[name]()
    resolution = {"ball": (25, 13), "cube": (5, 5), "ring": (33, 17), "bracket": (9, 9)}[name]
    grids = tuple(PatchGrid.of(patch, resolution) for patch in patches)
    depth: Callable[[Array], Array] = {
        "ball": lambda x: radius - np.linalg.norm(x, axis=1),
        "cube": lambda x: radius - np.abs(x).max(axis=1),
        "ring": lambda x: minor - np.hypot(np.hypot(x[:, 0], x[:, 1]) - radius, x[:, 2]),
        "bracket": lambda x: in_bracket(x, size),
    }[name]

    def placed(pose: Pose) -> SurfaceTool:
        return SurfaceTool(
            grids, tuple(np.ascontiguousarray(pose.to_world(grid.surface.control_points)) for grid in grids)
        )

    anchor = {"ring": np.array([radius, 0, 0]), "bracket": np.array([0.25, 0.25, 0.25]) * size}.get(name, np.zeros(3))
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


BRACKET = np.array([[0, 0], [1, 0], [1, 0.5], [0.5, 0.5], [0.5, 1], [0, 1.0]])
"""Profile of the bracket of size 1; its height is a half."""


def bracket(size: float) -> list[BSplineSurface]:
    """An L of eight planar faces. Each is cut out of a larger plane, and two of these planes run on through the body."""
    knots, faces = np.array([0.0, 0, 1, 1]), []
    wide, long = np.array([-0.4, 1.5]), np.array([-0.7, 1.9])

    def planar(origin: Array, a: Array, b: Array, corners: Array) -> BSplineSurface:
        """The part within corners (k, 2), in a and b from the origin."""
        net = np.array([[origin + x * a + y * b for y in long] for x in wide])
        uv = (corners - [wide[0], long[0]]) / [np.ptp(wide), np.ptp(long)]
        loop = tuple(TrimCurve(np.array([p, q]), knots, 1) for p, q in zip(uv, np.roll(uv, -1, axis=0), strict=True))
        return BSplineSurface(size * net, knots, knots, 1, 1, trims=(TrimLoop(loop),))

    x, y, z = np.eye(3)
    faces.append(planar(np.zeros(3), y, x, BRACKET[:, ::-1]))
    faces.append(planar(0.5 * z, x, y, BRACKET))
    for p, q in zip(BRACKET, np.roll(BRACKET, -1, axis=0), strict=True):
        along = np.array([*(q - p), 0.0])
        corners = np.array([[0, 0], [1, 0], [1, 0.5], [0, 0.5]])
        faces.append(planar(np.array([*p, 0.0]), along, z, corners))
    return faces


def in_bracket(x: Array, size: float) -> Array:
    """Depth in one of the two boxes whose union it is."""

    def box(low: list[float], high: list[float]) -> Array:
        return np.minimum(x - size * np.array(low), size * np.array(high) - x).min(axis=1)

    return np.maximum(box([0, 0, 0], [1, 0.5, 0.5]), box([0, 0, 0], [0.5, 1, 0.5]))


def random_turn(rng: np.random.Generator) -> Array:
    """A rotation; one in five along the axes, where things line up."""
    if rng.random() < 0.2:
        turn = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    else:
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return np.ascontiguousarray(turn * np.sign(np.linalg.det(turn)))
