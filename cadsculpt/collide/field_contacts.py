"""Implicit Surface Tool (paper section 4.9.1): the points generated in the window go into the tool's equation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from . import hull, levels, quadrature
from .contacts import Contacts
from .query import DistanceField, FieldTool, Run, finest_size
from .workspace import Patch, Workspace

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


def field_contacts(run: Run, index: int, tool: FieldTool) -> list[Contacts]:
    """Implicit Surface Tool (4.9.1): the points generated in the window go into the tool's equation."""
    box = np.asarray(tool.field.box(), dtype=np.float64)
    if np.isnan(box).any():
        raise InputError("the tool's box is not a number", where=f"tool {index}")
    parts = []
    for face in run.near(box[0], box[1], run.options.margin):
        work, g = run.model(int(face))
        cells = _field_cells(run, g, work, tool.field)
        if not len(cells):
            continue
        margin = run.options.margin
        names = np.sort(levels.vertices_of(g, cells, work.new_mark()))
        depth = -tool.field.distance(g.points[names])
        hit = ~(depth < -margin)
        if hit.any():
            uv, points, area = quadrature.vertex_rows(g, names[hit])
            parts.append(_field_rows(run, index, int(face), tool.field, uv, points, depth[hit], area))
        if run.paper:
            continue
        # cells that the tool may reach between the vertices, away from those it is known to touch
        left = quadrature.unresolved(g, cells, margin, names, depth, work.new_mark())
        if len(left):
            region = run.grids[face].region
            uv, points, area = quadrature.below_grid(g, left, tool.field.distance, margin, finest_size(run, g), region)
            if len(uv):
                depth = -tool.field.distance(points)
                parts.append(_field_rows(run, index, int(face), tool.field, uv, points, depth, area))
    return parts


def _field_cells(run: Run, g: Patch, work: Workspace, tool: DistanceField) -> Index:
    """The cells left by the loop of 4.5, starting from the window of 4.4."""
    window = None
    if run.paper:

        def meets(facets: Array) -> Mask:
            centre = facets.mean(axis=1)
            return np.asarray(tool.distance(centre) <= np.linalg.norm(facets - centre[:, None], axis=2).max(axis=1))

        centre = 0.5 * (work.extent[0] + work.extent[1])
        within = bool(tool.distance(centre[None])[0] <= 0.5 * np.linalg.norm(work.extent[1] - work.extent[0]))
        window = hull.paper_window(work.grid.surface, g, meets, within)
    cells, centre, _ = levels.window_cells(work, window)
    ended = len(cells) == 0
    while not ended:
        cells, centre, ended = levels.refine(work, cells, tool.distance(centre), run.options.margin)
    return cells


def _field_rows(
    run: Run, index: int, face: int, tool: DistanceField, uv: Array, points: Array, depth: Array, area: Array
) -> Contacts:
    return run.rows(index, face, uv, points, -tool.gradient(points), depth, area, tool.nearest(points))
