"""Triangles of a tool's outer surface, for pictures only: collision never looks at them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..collide import shapes
from .composed import ComposedTool
from .contour import contour
from .implicit import ImplicitTool
from .mesh import MeshTool
from .point import PointTool
from .superquadric import SuperquadricTool
from .surface import SurfaceTool

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def outline(
    tool: ImplicitTool | SuperquadricTool | ComposedTool | MeshTool | PointTool | SurfaceTool, *, scene_size: float
) -> tuple[Array, Index]:
    """Points (k, 3) in the tool's frame and triangles (f, 3), counter-clockwise seen from outside.

    scene_size : a length of the scene, for what has no size of its own (a point, a half-space).
    """
    if isinstance(tool, PointTool):
        return _revolve(np.array([[0.0, 0.0], [0.02, 0.08], [0.02, 0.4], [0.0, 0.4]]) * scene_size, 24)
    if isinstance(tool, SurfaceTool):
        return _patches(tool)
    if isinstance(tool, MeshTool):
        return tool.mesh.vertices, tool.mesh.triangles
    if isinstance(tool, SuperquadricTool):
        return contour(lambda x: tool.field(x)[0], tool.field, tool.box_corners)
    if isinstance(tool, ComposedTool):
        corners = tool.box_corners
        clipped = np.clip(corners, -0.6 * scene_size, 0.6 * scene_size)
        return contour(tool.value, tool.field, np.where(np.isfinite(corners), corners, clipped))
    p, rounding = tool.parameters, tool.rounding
    if tool.kind == shapes.HALF_SPACE:
        x = scene_size * np.array([-0.6, 0.6])
        corners = np.array([[a, b, 0.0] for a in x for b in x])
        return corners, np.array([[0, 2, 1], [1, 2, 3]], dtype=np.int64)[:, ::-1]
    if tool.kind == shapes.BOX:
        return _box(p, rounding)
    quarter = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 33)
    if tool.kind == shapes.SPHERE:
        return _revolve(p[0] * np.stack([np.cos(quarter), np.sin(quarter)], axis=1), 64)
    if tool.kind == shapes.ELLIPSOID:
        points, triangles = _revolve(np.stack([np.cos(quarter), np.sin(quarter)], axis=1), 64)
        return points * p, triangles
    if tool.kind == shapes.CAPSULE:
        arc = p[0] * np.stack([np.cos(quarter), np.sin(quarter)], axis=1)
        lower, upper = arc[:17] - [0, 0.5 * p[1]], arc[16:] + [0, 0.5 * p[1]]
        return _revolve(np.concatenate([lower, upper]), 64)
    if tool.kind == shapes.CYLINDER:
        return _revolve(_rounded_profile(p[0], 0.5 * p[1], rounding), 64)
    if tool.kind == shapes.CONE:
        return _revolve(np.array([[0.0, 0.0], [p[0], p[1]], [0.0, p[1]]]), 64)
    around = np.linspace(-np.pi, np.pi, 49)
    ring = np.stack([p[0] + p[1] * np.cos(around), p[1] * np.sin(around)], axis=1)
    return _revolve(ring, 96)


def _revolve(profile: Array, sides: int) -> tuple[Array, Index]:
    """Turn a profile (k, 2) of (radius, z), listed upwards, about the z axis."""
    angle = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)
    radius, z = profile.T
    points = np.stack(
        [radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle), np.repeat(z[:, None], sides, axis=1)], axis=2
    )
    return points.reshape(-1, 3), _grid_triangles(len(profile), sides, wrap=True)


def _grid_triangles(rows: int, columns: int, *, wrap: bool) -> Index:
    mesh = np.meshgrid(np.arange(rows - 1), np.arange(columns if wrap else columns - 1), indexing="ij")
    i, j = (index.ravel() for index in mesh)
    a, b = i * columns + j, i * columns + (j + 1) % columns
    c, d = a + columns, b + columns
    return np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])


def _rounded_profile(radius: float, half: float, rounding: float) -> Array:
    angle = np.linspace(0.0, 0.5 * np.pi, 9)
    arc = rounding * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    lower = arc + [radius - rounding, -half + rounding]
    upper = lower[::-1] * [1, -1]
    return np.concatenate([[[0.0, -half]], lower, upper, [[0.0, half]]])


def _box(size: Array, rounding: float) -> tuple[Array, Index]:
    """Six faces; rounded edges by pushing a finely divided box onto the rounded surface."""
    cuts = np.linspace(-1, 1, 2 if rounding == 0 else 25)
    u, v = (x.ravel() for x in np.meshgrid(cuts, cuts, indexing="ij"))
    one = np.ones_like(u)
    triangles = _grid_triangles(len(cuts), len(cuts), wrap=False)
    sides: list[Callable[[], Array]] = [
        lambda: np.stack([u, v, -one], axis=1),
        lambda: np.stack([v, u, one], axis=1),
        lambda: np.stack([-one, u, v], axis=1),
        lambda: np.stack([one, v, u], axis=1),
        lambda: np.stack([v, -one, u], axis=1),
        lambda: np.stack([u, one, v], axis=1),
    ]
    points = np.concatenate([side() for side in sides]) * 0.5 * size
    faces = np.concatenate([triangles[:, ::-1] + k * len(u) for k in range(6)])
    if rounding > 0:
        core = np.clip(points, -(0.5 * size - rounding), 0.5 * size - rounding)
        out = points - core
        length = np.linalg.norm(out, axis=1, keepdims=True)
        points = core + rounding * out / np.where(length > 0, length, 1.0)
    return points, faces


def outline_points(tool: SurfaceTool, nets: Sequence[Array]) -> Array:
    """The points (k, 3) of `outline` in the tool's frame, of a tool whose control points are now nets[i] (r, s, 3)."""
    parts = [
        grid.matrices.points(net, grid.surface.weights).reshape(-1, 3)
        for grid, net in zip(tool.grids, nets, strict=True)
    ]
    return np.concatenate(parts)


def _patches(tool: SurfaceTool) -> tuple[Array, Index]:
    triangles, start = [], 0
    for grid in tool.grids:
        matrices = grid.matrices
        faces = _grid_triangles(*matrices.shape, wrap=False)
        if grid.inside is not None:
            faces = faces[grid.inside.ravel()[faces].all(axis=1)]
        # _grid_triangles runs against S_u x S_v
        triangles.append((faces[:, ::-1] if not grid.surface.outward else faces) + start)
        start += matrices.shape[0] * matrices.shape[1]
    rest = outline_points(tool, [grid.surface.control_points for grid in tool.grids])
    return rest, np.concatenate(triangles)
