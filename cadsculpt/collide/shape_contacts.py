"""Implicit Surface Tool (paper section 4.9.1) whose equation is a formula that kernels know: `field_contacts` in one piece.

What `field_contacts` does level by level is done here by one kernel per patch, in room that is kept from step to step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..jit import njit_in_place
from .contacts import Columns
from .field_contacts import below_vertices
from .levels import in_order, mark_vertices, nearby, split_cells
from .quadrature import unresolved_cells, vertex_areas
from .query import FieldTool, Run
from .shapes import PosedShape, world_box, world_field
from .spheres import fill_spheres
from .workspace import Patch, Room, make_points

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NOT_A_NUMBER = -1
"""What `shape_rows` returns instead of a number of rows where a distance is not a number."""


def shape_contacts(run: Run, index: int, tool: FieldTool, shape: PosedShape) -> None:
    """Contacts of a tool that is a shape, as of `field_contacts`."""
    kind, sizes, rounding, at, turn = shape.kind, shape.parameters, shape.rounding, shape.at, shape.rotation
    if not world_box(shape.corners, at, turn, run.cache.box):
        raise InputError("the tool's box is not a number", where=f"tool {index}")
    margin, out = run.options.margin, run.out
    for place in range(run.near_posed(margin)):
        face = int(run.cache.near[place])
        work, g = run.model(face)
        rows = out.reserve(len(g.visit))
        room = work.room
        found, left = shape_rows(
            g, work.grid.spans, kind, sizes, rounding, at, turn, margin, work.new_mark(), work.new_mark(), room, rows,
            out.count, run.body, run.others[index], run.faces[face],
        )  # fmt: skip
        if found == NOT_A_NUMBER:
            raise InputError("a distance to the tool is not a number", where=f"tool {index}")
        out.count += found
        if left:
            below_vertices(run, index, face, tool.field, room.maybe[:left, :2].copy())


@njit_in_place
def shape_rows(
    g: Patch, spans: Index, kind: int, sizes: Array, rounding: float, at: Array, turn: Array, margin: float,
    mark: int, mark_again: int, room: Room, rows: Columns, row: int, body: int, tool: int, face: int,
) -> tuple[int, int]:  # fmt: skip
    """The loop of 4.5 against a shape, and contacts at the finest vertices in what is left, into `rows` from `row` on.

    Returns how many contacts, and how many finest cells the shape may reach between their vertices (room.maybe).
    """
    cells, children, names, distance, x, normal = (
        room.cells, room.children, room.names, room.distance, room.points, room.normals,
    )  # fmt: skip
    spheres, points, offset, tally, u, v = g.spheres, g.points, g.offset, g.tally, g.u, g.v
    a, b, faces, out_u, out_v, point, out_normal, depths, area, tool_point, tool_face, tool_u, tool_v = rows
    count = len(spans)
    for t in range(count):
        for c in range(3):
            cells[t, c] = spans[t, c]
    g.counters[1] += count
    while count > 0:
        fill_spheres(g, cells, count)
        level = cells[0, 0]
        for t in range(count):
            s = offset[level] + cells[t, 1] * tally[level, 1] + cells[t, 2]
            for c in range(3):
                x[t, c] = spheres[s, c]
        world_field(kind, sizes, rounding, at, turn, x[:count], distance[:count], normal[:count])
        count, most = nearby(g, cells, count, distance, margin)
        if count == 0 or most == 0:
            break
        count = split_cells(g, cells, count, children)
        cells, children = children, cells
    if count == 0:
        return 0, 0
    known = mark_vertices(g, cells, count, mark, names)
    in_order(g, names, known, mark)
    make_points(g, names, known)
    for t in range(known):
        for c in range(3):
            x[t, c] = points[names[t], c]
    world_field(kind, sizes, rounding, at, turn, x[:known], distance[:known], normal[:known])
    found, n = 0, len(v)
    for t in range(known):
        k, d = names[t], distance[t]
        distance[t] = -d
        if np.isnan(d):
            return NOT_A_NUMBER, 0
        if d > margin:
            continue
        to = row + found
        a[to], b[to], faces[to] = body, tool, face
        out_u[to], out_v[to], depths[to] = u[k // n], v[k % n], -d
        for c in range(3):
            point[to, c], out_normal[to, c] = points[k, c], -normal[t, c]
            tool_point[to, c] = points[k, c] - d * normal[t, c]
        tool_face[to], tool_u[to], tool_v[to] = -1, np.nan, np.nan
        room.hits[found] = k
        found += 1
    vertex_areas(g, room.hits, found, area[row:])
    return found, unresolved_cells(g, cells, count, margin, names, distance, known, mark_again, room.maybe)
