"""Distance between a patch and a tool.

`sampled_distance` looks at the vertices of the finest grid: never below the true distance, and above it by no more than a
cell can hide (its sag and half its diagonal's share of the slope). It is what `clearance` expectations of a run compare.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .detect import FieldTool, PatchGrid, PointTool, SurfaceTool

Array = NDArray[np.float64]


def sampled_distance(grid: PatchGrid, net: Array, tool: FieldTool | PointTool | SurfaceTool) -> float:
    """Smallest distance from the grid vertices on the trimmed face to the tool; 0 where one lies inside it."""
    points = _vertices(grid, net)
    if isinstance(tool, FieldTool):
        distance = float(tool.field.distance(points).min(initial=np.inf))
    elif isinstance(tool, PointTool):
        distance = float(np.linalg.norm(points - tool.position, axis=1).min(initial=np.inf))
    else:
        others = [_vertices(g, n) for g, n in zip(tool.grids, tool.nets, strict=True)]
        distance = float(cKDTree(np.concatenate(others)).query(points)[0].min(initial=np.inf))
    return max(0.0, distance)


def _vertices(grid: PatchGrid, net: Array) -> Array:
    points = grid.matrices.points(net, grid.surface.weights)
    return points.reshape(-1, 3) if grid.inside is None else points[grid.inside]
