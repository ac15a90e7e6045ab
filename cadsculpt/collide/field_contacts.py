"""Implicit Surface Tool (paper section 4.9.1): the points generated in the window go into the tool's equation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from . import hull, levels, quadrature
from .query import BoundedField, DistanceField, FieldTool, Run, finest_size, lower_bound
from .workspace import Patch, Workspace

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


def field_contacts(run: Run, index: int, tool: FieldTool) -> None:
    """Implicit Surface Tool (4.9.1): the points generated in the window go into the tool's equation."""
    box = np.asarray(tool.field.box(), dtype=np.float64)
    if np.isnan(box).any():
        raise InputError("the tool's box is not a number", where=f"tool {index}")
    margin = run.options.margin
    for face in run.near(box[0], box[1], margin).tolist():
        work, g = run.model(face)
        cells = _field_cells(run, g, work, tool.field)
        if not len(cells):
            continue
        names = np.sort(levels.vertices_of(g, cells, work.new_mark()))
        depth, hit = _depths(tool.field, g.points[names], margin)
        if hit.any():
            uv, points, area = quadrature.vertex_rows(g, names[hit])
            _put_rows(run, index, face, tool.field, uv, points, depth[hit], area)
        if run.paper:
            continue
        # cells that the tool may reach between the vertices, away from those it is known to touch
        below_vertices(
            run, index, face, tool.field, quadrature.unresolved(g, cells, margin, names, depth, work.new_mark())
        )


def below_vertices(run: Run, index: int, face: int, field: DistanceField, cells: Index) -> None:
    """Contacts between the vertices of finest cells (n, 2) that the tool may reach."""
    if not len(cells):
        return
    _, g = run.model(face)
    distance = field.distance
    bound = field.bound if isinstance(field, BoundedField) else distance
    uv, points, area, undecided = quadrature.below_grid(
        g, cells, bound, distance, run.options.margin, finest_size(run, g), run.grids[face].region
    )
    run.give_up(index, face, undecided)
    if len(uv):
        _put_rows(run, index, face, field, uv, points, -distance(points), area)


def _field_cells(run: Run, g: Patch, work: Workspace, tool: DistanceField) -> Index:
    """The cells left by the loop of 4.5, starting from the window of 4.4."""
    window = None
    if run.paper:

        def meets(facets: Array) -> Mask:
            centre = facets.mean(axis=1)
            return np.asarray(lower_bound(tool, centre) <= np.linalg.norm(facets - centre[:, None], axis=2).max(axis=1))

        centre = 0.5 * (work.extent[0] + work.extent[1])
        within = bool(lower_bound(tool, centre[None])[0] <= 0.5 * np.linalg.norm(work.extent[1] - work.extent[0]))
        window = hull.paper_window(work.grid.surface, g, meets, within)
    cells, centre, _ = levels.window_cells(work, window)
    ended = len(cells) == 0
    while not ended:
        cells, centre, ended = levels.refine(g, cells, lower_bound(tool, centre), run.options.margin)
    return cells


def _depths(field: DistanceField, points: Array, margin: float) -> tuple[Array, Mask]:
    """Depths (n,) of points, and which of them are contacts; the others' are only as low as the field's bound, so that
    what is discarded by them is discarded for certain. NaN stays, and counts as a contact."""
    if not isinstance(field, BoundedField):
        depth = -field.distance(points)
        return depth, ~(depth < -margin)
    depth = -field.bound(points)
    hit = ~(depth < -margin)
    near = np.flatnonzero(hit)
    exact = -field.distance(points[near])
    hit[near] = ~(exact < -margin)
    depth[near] = np.where(hit[near], exact, np.nextafter(-margin, -np.inf))
    return depth, hit


def _put_rows(
    run: Run, index: int, face: int, tool: DistanceField, uv: Array, points: Array, depth: Array, area: Array
) -> None:
    run.out.append(run.rows(index, face, uv, points, -tool.gradient(points), depth, area, tool.nearest(points)))
