"""A model's patch against a tool that is one whole B-spline patch: contacts at its finest vertices, in one kernel.

Small cells of the model that come near the tool are found by their spheres at growing levels of detail (paper section 4.5) and
the tool's voxels, which know the spheres of the tool. Their vertices look for their closest points on the tool's true surface,
and then those around the contacts, block by block, so that the inside of a deep overlap is not lost. Nothing is kept from step
to step but memory: the contacts are those of the net and of the tool as they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit_in_place
from .contacts import Columns
from .hull import near
from .levels import in_order
from .newton import DISTANCE, NORMAL, POINT, PROPER, U, V
from .quadrature import BLOCK, in_grid, ring_of, unresolved_cells, vertex_areas
from .spheres import fill_spheres
from .voxels import Voxels, feet, least_distance
from .workspace import Patch, Room, Search, Waves, canonical, make_points

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SMALL = 2
"""Cells of the model of up to this many rows and columns give up their vertices: near the rim of a shallow contact most of what
larger ones hold would look for its closest point in vain."""


TURNS = 16
"""How often cells that wait for voxels are looked at again: once for each level, and no more where the voxels cannot hold all
that is asked."""


@njit_in_place
def near_cells(
    g: Patch, voxels: Voxels, its: Array, reach: float, sure: bool, room: Room, stack: Index
) -> tuple[int, int]:
    """The small cells of g whose spheres come within `reach` of the tool's surface, into room.cells; how many they are, and how
    many cells wait for voxels that know nothing yet: their spheres' middles are in room.normals.

    its (2, 3) : the box of the tool's net. sure : none is to wait, but to count as near.
    """
    cells, children, waiting = room.cells, room.children, room.normals
    offset, tally, row_u, row_v, child_u, child_v, covers, ball, box = (
        g.offset, g.tally, g.row_u, g.row_v, g.child_u, g.child_v, g.covers, g.spheres, g.box,
    )  # fmt: skip
    stamp, tick, last, across = g.sphere_stamp, g.tick, len(g.offset) - 2, g.tally[0, 1]
    count, tests, unknown = 0, 0, 0
    for k in range(len(box)):
        if not (covers[k] and near(box, k, its[0], its[1], reach)):
            continue
        children[0, 0], children[0, 1], children[0, 2] = 0, k // across, k % across
        fill_spheres(g, children, 1)
        stack[0, 0], stack[0, 1], stack[0, 2] = 0, k // across, k % across
        top = 1
        while top > 0:
            top -= 1
            level, c, d = stack[top, 0], stack[top, 1], stack[top, 2]
            at = offset[level] + c * tally[level, 1] + d
            tests += 1
            away = least_distance(voxels, its, ball[at, 0], ball[at, 1], ball[at, 2])
            if away > ball[at, 3] + reach:
                continue
            if away < 0.0 and not sure:
                for a in range(3):
                    waiting[unknown, a] = ball[at, a]
                unknown += 1
                continue
            if level == last or (
                row_u[level, c + 1] - row_u[level, c] <= SMALL and row_v[level, d + 1] - row_v[level, d] <= SMALL
            ):
                cells[count, 0], cells[count, 1], cells[count, 2] = level, c, d
                count += 1
                continue
            found, missing = 0, 0
            for i in range(child_u[level, c], child_u[level, c + 1]):
                for j in range(child_v[level, d], child_v[level, d + 1]):
                    at = offset[level + 1] + i * tally[level + 1, 1] + j
                    if covers[at]:
                        missing += stamp[at] != tick
                        children[found, 0], children[found, 1], children[found, 2] = level + 1, i, j
                        stack[top, 0], stack[top, 1], stack[top, 2] = level + 1, i, j
                        found += 1
                        top += 1
            if missing > 0:
                fill_spheres(g, children, found)
    if unknown == 0:  # what is found does not depend on what the voxels knew, nor is what is counted to
        g.counters[4] += tests
    return count, unknown


@njit_in_place
def surface_rows(
    g: Patch, h: Patch, voxels: Voxels, its: Array, seed: int, reach: float, felt: float, margin: float, tie: float,
    at: Array, turn: Array, mark: int, mark_again: int, mark_last: int, room: Room, waves: Waves, search: Search,
    rows: Columns, row: int, body: int, tool: int, face: int,
) -> tuple[int, int, int]:  # fmt: skip
    """Contacts of g's patch with the tool h, both in the tool's frame, into `rows` from `row` on, in the world: x_world =
    turn x + at.

    voxels : the tool's. seed : a vertex to begin with instead of the cells that come within `reach`,
    or -1. felt : cells of the model that are deeper than this behind the tool, at all their vertices, do not begin a contact.
    mark... : numbers new to g's marks.

    Returns how many contacts; how many cells of the model came near; and how many finest cells the tool may reach between
    their vertices (room.maybe).
    """
    names, group, best, state = room.names, waves.group, waves.best, waves.state
    depth, points, visit, m, n = room.distance, room.points, g.visit, len(g.u), len(g.v)
    place, kept, queue, all_cells, on_face = waves.place, waves.kept, waves.queue, room.cells, g.inside
    row_u, row_v, wrap_u, wrap_v, poles, u, v, mine = g.row_u, g.row_v, g.wrap_u, g.wrap_v, g.poles, g.u, g.v, g.points
    near_by, count = 0, 0
    if seed >= 0:
        visit[seed], names[0], place[seed], count = mark + 1, seed, 0, 1
    else:
        near_by, unknown = near_cells(g, voxels, its, reach, False, room, search.stack)
        for attempt in range(TURNS):
            if unknown == 0:
                break
            feet(h, voxels, search, room.normals[:unknown], np.inf, best[:unknown], state[:unknown])
            near_by, unknown = near_cells(g, voxels, its, reach, attempt == TURNS - 1, room, search.stack)
        count = list_vertices(g, all_cells, near_by, mark, names, place)
    # (from here on, those that are listed carry the number behind the mark)
    mark += 1
    make_points(g, names, count)
    look(g, h, voxels, search, names, 0, count, margin, tie, points, waves, depth)
    # where contacts begin
    head, tail, cells = 0, 0, 0
    for t in range(count):
        kept[t] = 0
    if seed >= 0 and not depth[0] < -margin:
        kept[0], queue[0], tail = 1, 0, 1
    for t in range(near_by):
        shallow = False
        level, ku, kv = all_cells[t, 0], all_cells[t, 1], all_cells[t, 2]
        i0, i1, j0, j1 = row_u[level, ku], row_u[level, ku + 1], row_v[level, kv], row_v[level, kv + 1]
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                k = canonical(i, j, m, n, wrap_u, wrap_v, poles)
                shallow = shallow or not on_face[k] or not depth[place[k]] > felt
        if not shallow:
            continue
        for c in range(3):
            all_cells[cells, c] = all_cells[t, c]
        cells += 1
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                k = canonical(i, j, m, n, wrap_u, wrap_v, poles)
                s = place[k]
                if on_face[k] and kept[s] == 0 and not depth[s] < -margin:
                    kept[s], queue[tail] = 1, s
                    tail += 1
    known = count
    while True:
        while head < tail:
            low_i, high_i, low_j, high_j, _ = ring_of(names[queue[head]], m, n, poles)
            head += 1
            for a in range(low_i, high_i + 1):
                c = in_grid(a, m - 1, wrap_u)
                for b in range(low_j, high_j + 1):
                    d = in_grid(b, n - 1, wrap_v)
                    if c < 0 or d < 0:
                        continue
                    for corner in range(4):
                        i, j = c + (corner & 1), d + (corner >> 1)
                        k = canonical(i, j, m, n, wrap_u, wrap_v, poles)
                        if not on_face[k]:
                            continue
                        if visit[k] != mark:
                            i, j = i // BLOCK * BLOCK, j // BLOCK * BLOCK
                            for e in range(i, min(i + BLOCK, m)):
                                for f in range(j, min(j + BLOCK, n)):
                                    k = canonical(e, f, m, n, wrap_u, wrap_v, poles)
                                    if visit[k] != mark and on_face[k]:
                                        visit[k], names[count], place[k] = mark, k, count
                                        count += 1
                        elif place[k] < known:
                            s = place[k]
                            if kept[s] == 0 and not depth[s] < -margin:
                                kept[s], queue[tail] = 1, s
                                tail += 1
        if count == known:
            break
        make_points(g, names[known:count], count - known)
        look(g, h, voxels, search, names, known, count, margin, tie, points, waves, depth)
        for s in range(known, count):
            kept[s] = 0 if depth[s] < -margin else 1
            if kept[s] == 1:
                queue[tail] = s
                tail += 1
        known = count
    # the contacts in their order
    for s in range(tail):
        group[s] = names[queue[s]]
        visit[group[s]] = mark_again
    in_order(g, group, tail, mark_again)
    to_a, to_b, faces, out_u, out_v, point, normal, depths, area, tool_point, tool_face, tool_u, tool_v = rows
    vertex_areas(g, group, tail, area[row:])
    for t in range(tail):
        k, to = group[t], row + t
        s = place[k]
        if np.isnan(depth[s]):
            return -1, near_by, 0
        to_a[to], to_b[to], faces[to] = body, tool, face
        out_u[to], out_v[to], depths[to] = u[k // n], v[k % n], depth[s]
        tool_face[to], tool_u[to], tool_v[to] = 0, best[s, U], best[s, V]
        for x in range(3):
            p, q, r = at[x], at[x], 0.0
            for c in range(3):
                p += turn[x, c] * mine[k, c]
                q += turn[x, c] * best[s, POINT + c]
                r -= turn[x, c] * best[s, NORMAL + c]
            point[to, x], tool_point[to, x], normal[to, x] = p, q, r
    # from here on, where the tool says nothing, a distance
    for s in range(known):
        if state[s] != PROPER:
            depth[s] = -max(best[s, DISTANCE], (1 + 1e-9) * margin + 1e-300)
    left = unresolved_cells(g, all_cells, cells, margin, names, depth, known, mark_last, room.maybe) if cells else 0
    return tail, cells, left


@njit_in_place
def list_vertices(g: Patch, cells: Index, count: int, mark: int, names: Index, place: Index) -> int:
    """The vertices on the face of cells[:count], block by block of neighbours, into names; how many they are. They carry mark +
    1 then."""
    row_u, row_v, visit, on_face, m, n = g.row_u, g.row_v, g.visit, g.inside, len(g.u), len(g.v)
    wrap_u, wrap_v, poles = g.wrap_u, g.wrap_v, g.poles
    found = 0
    for listing in range(2):
        for t in range(count):
            level, ku, kv = cells[t, 0], cells[t, 1], cells[t, 2]
            for i in range(row_u[level, ku], row_u[level, ku + 1] + 1):
                for j in range(row_v[level, kv], row_v[level, kv + 1] + 1):
                    k = canonical(i, j, m, n, wrap_u, wrap_v, poles)
                    if listing == 0:
                        visit[k] = mark if on_face[k] else visit[k]
                    elif visit[k] == mark:
                        i0, j0 = k // n // BLOCK * BLOCK, k % n // BLOCK * BLOCK
                        for e in range(i0, min(i0 + BLOCK, m)):
                            for f in range(j0, min(j0 + BLOCK, n)):
                                if visit[e * n + f] == mark:
                                    visit[e * n + f], names[found], place[e * n + f] = mark + 1, e * n + f, found
                                    found += 1
    return found


@njit_in_place
def look(
    g: Patch, h: Patch, voxels: Voxels, search: Search, names: Index, start: int, stop: int, margin: float,
    tie: float, points: Array, waves: Waves, depth: Array,
) -> None:  # fmt: skip
    """The closest points of h to the vertices names[start:stop] of g, and how deep they are: -inf where the tool is open
    there and says nothing. The normals in waves.best are then the tool's, outward, or over an edge the way to it."""
    best, state, mine = waves.best, waves.state, g.points
    for s in range(start, stop):
        state[s], best[s, DISTANCE] = 0, np.inf
        for c in range(3):
            points[s, c] = mine[names[s], c]
    beyond = 1.1 * margin + 1e-300
    feet(h, voxels, search, points[start:stop], beyond, best[start:stop], state[start:stop])
    for s in range(start, stop):
        along, length2 = 0.0, 0.0
        for c in range(3):
            along += (points[s, c] - best[s, POINT + c]) * best[s, NORMAL + c]
            length2 += best[s, NORMAL + c] * best[s, NORMAL + c]
        side, distance, length = 1.0 if along > 0.0 else -1.0, best[s, DISTANCE], np.sqrt(length2)
        for c in range(3):
            if abs(length - 1.0) > 1e-9 and distance > 1e-6 * tie:
                best[s, NORMAL + c] = side * (points[s, c] - best[s, POINT + c]) / distance
        depth[s] = -side * distance if state[s] == PROPER else -np.inf
