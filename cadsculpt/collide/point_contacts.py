"""Point-based Tool (paper section 4.9.2): the model's cells nearest to the point, and there its closest point on the
surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from . import levels
from .closest import NOTHING, project
from .newton import BORDER, DISTANCE, NORMAL, POINT, U, V
from .query import PointTool, Run, on_face
from .rim import closest_on_faces
from .surface_contacts import EDGE

Array = NDArray[np.float64]


def point_contacts(run: Run, index: int, tool: PointTool) -> None:
    """Point-based Tool (4.9.2): the model's cells nearest to the point, and there its closest point on the surface."""
    position = np.asarray(tool.position, dtype=np.float64).reshape(3)
    if not np.isfinite(position).all():
        raise InputError(f"a point tool at {position}", where=f"tool {index}")
    reach = max(tool.reach, run.options.margin)
    gaps = np.maximum(0.0, np.maximum(run.extents[:, 0] - position, position - run.extents[:, 1]))
    near = np.flatnonzero(np.linalg.norm(gaps, axis=1) <= reach)
    run.cache.counters[0] += len(run.extents)
    best = np.full((1, 9), np.inf)
    state, owner = np.zeros(1, np.int64), np.full(1, -1, dtype=np.int64)
    size = float(np.linalg.norm(run.extents[:, 1].max(axis=0) - run.extents[:, 0].min(axis=0))) if len(near) else 0.0
    group = np.array([0, 1])
    for face in near.tolist():
        project(run.model(face)[1], position[None], group, EDGE * size, np.inf, face, best, state, owner)
    if state[0] != NOTHING and not on_face(run.grids[owner[0]], best[:, [U, V]])[0]:
        grids, patches = zip(*((run.grids[face], run.model(face)[1]) for face in near.tolist()), strict=True)
        best, state, owner = closest_on_faces(grids, patches, position[None], EDGE * size)
        owner = near[owner]
    if state[0] in (NOTHING, BORDER):
        return
    point, total = best[:, POINT : POINT + 3], best[:, NORMAL : NORMAL + 3]
    normal = total / np.linalg.norm(total)
    depth = -np.sign(((position - point) * normal).sum(axis=1)) * best[:, DISTANCE]
    if depth[0] > tool.reach:
        return
    if run.paper and not _in_sphere(run, int(owner[0]), position):
        return
    face = int(owner[0])
    area = np.array([float(tool.area)])
    run.out.append(run.rows(index, face, best[:, [U, V]], point, normal, depth, area, position[None]))


def _in_sphere(run: Run, face: int, position: Array) -> bool:
    """The paper's own condition: the point lies in a sphere of every level, down to the finest."""
    work, g = run.model(face)
    cells, centre, _ = levels.window_cells(work)
    ended = False
    while not ended and len(cells):
        distance = np.linalg.norm(centre - position, axis=1)
        cells, centre, ended = levels.refine(g, cells, distance, run.options.margin)
    return len(cells) > 0
