"""A model's patch against a tool that is one whole B-spline patch: contacts at its finest vertices, in one kernel.

Small cells of the model that come near the tool are found by the spheres of both (paper section 4.5). Their vertices look for
their closest points on the tool's true surface, cell by cell, and then those around the contacts, block by block, so that the
inside of a deep overlap is not lost. Nothing is kept from step to step but memory: the contacts are those of the net and of
the tool as they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit_in_place, njit_inline
from .closest import project_in
from .contacts import Columns
from .hull import near
from .levels import in_order
from .newton import DISTANCE, NORMAL, POINT, PROPER, U, V
from .quadrature import BLOCK, in_grid, ring_of, unresolved_cells, vertex_areas
from .spheres import fill_spheres
from .voxels import Voxels, feet, near_surface
from .workspace import Patch, Room, Search, Waves, canonical, make_points

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SMALL = 2
"""Cells of the model of up to this many rows and columns give up their vertices: near the rim of a shallow contact most of what
larger ones hold would look for its closest point in vain."""

FINE = 0.5
"""A cell of the tool whose sphere is smaller than this share of a small cell's tells well enough that it is near."""


@njit_in_place
def near_cells(g: Patch, h: Patch, its: Array, reach: float, mark: int, room: Room, search: Search) -> int:
    """The small cells of g whose spheres come within `reach` of spheres of h, into room.cells; how many they are.

    its (2, 3) : the box of h's net. mark : a number new to g.mark.
    """
    cells, children, stack, its_children = room.cells, room.children, search.stack, search.there
    off_a, tally_a, row_u, row_v, child_ua, child_va, covers_a, ball_a, marks, box_a = (
        g.offset, g.tally, g.row_u, g.row_v, g.child_u, g.child_v, g.covers, g.spheres, g.mark, g.box,
    )  # fmt: skip
    off_b, tally_b, child_ub, child_vb, covers_b, ball_b, box_b = (
        h.offset, h.tally, h.child_u, h.child_v, h.covers, h.spheres, h.box,
    )  # fmt: skip
    stamp_a, tick_a, stamp_b, tick_b = g.sphere_stamp, g.tick, h.sphere_stamp, h.tick
    points_a, points_b, row_ub, row_vb, boxes, slack = (
        g.points,
        h.points,
        h.row_u,
        h.row_v,
        search.boxes,
        g.slack + h.slack,
    )
    m_a, n_a, m_b, n_b = len(g.u), len(g.v), len(h.u), len(h.v)
    wraps_a, wraps_b = (g.wrap_u, g.wrap_v, g.poles), (h.wrap_u, h.wrap_v, h.poles)
    count, tests, boxed = 0, 0, -1
    across_a, across_b, last_a, last_b = tally_a[0, 1], tally_b[0, 1], len(off_a) - 2, len(off_b) - 2
    for l in range(len(box_b)):
        its_children[l, 0], its_children[l, 1], its_children[l, 2] = 0, l // across_b, l % across_b
    fill_spheres(h, its_children, len(box_b))
    for k in range(len(box_a)):
        if not (covers_a[k] and near(box_a, k, its[0], its[1], reach)):
            continue
        children[0, 0], children[0, 1], children[0, 2] = 0, k // across_a, k % across_a
        fill_spheres(g, children, 1)
        top = 0
        for l in range(len(box_b)):
            if covers_b[l] and near_pair(box_a, k, box_b, l, reach):
                stack[top, 0], stack[top, 1], stack[top, 2] = 0, k // across_a, k % across_a
                stack[top, 3], stack[top, 4], stack[top, 5] = 0, l // across_b, l % across_b
                top += 1
        while top > 0:
            top -= 1
            la, ca, da, lb, cb, db = (
                stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3], stack[top, 4], stack[top, 5],
            )  # fmt: skip
            at, to = off_a[la] + ca * tally_a[la, 1] + da, off_b[lb] + cb * tally_b[lb, 1] + db
            if marks[at] == mark:
                continue  # known to be near
            tests += 1
            x, y, z = ball_a[at, 0] - ball_b[to, 0], ball_a[at, 1] - ball_b[to, 1], ball_a[at, 2] - ball_b[to, 2]
            mine, its_own = ball_a[at, 3], ball_b[to, 3]
            hold = mine + its_own + reach
            if x * x + y * y + z * z > hold * hold:
                continue
            small = la == last_a or (
                row_u[la, ca + 1] - row_u[la, ca] <= SMALL and row_v[la, da + 1] - row_v[la, da] <= SMALL
            )
            if small and la > 0 and lb > 0:
                # where spheres say little, the boxes of the corners, grown by the sags of the surfaces
                if at != boxed:
                    boxed = at
                    corner_box(points_a, row_u, row_v, m_a, n_a, wraps_a, la, ca, da, boxes, 0)
                corner_box(points_b, row_ub, row_vb, m_b, n_b, wraps_b, lb, cb, db, boxes, 1)
                if not near_pair(boxes, 0, boxes, 1, reach + ball_a[at, 5] + ball_b[to, 5] + slack):
                    continue
            if small and (lb == last_b or its_own <= FINE * mine):
                marks[at] = mark
                cells[count, 0], cells[count, 1], cells[count, 2] = la, ca, da
                count += 1
            elif not small and (lb == last_b or mine >= its_own):
                found, missing = 0, 0
                for c in range(child_ua[la, ca], child_ua[la, ca + 1]):
                    for d in range(child_va[la, da], child_va[la, da + 1]):
                        at = off_a[la + 1] + c * tally_a[la + 1, 1] + d
                        if covers_a[at]:
                            missing += stamp_a[at] != tick_a
                            children[found, 0], children[found, 1], children[found, 2] = la + 1, c, d
                            stack[top, 0], stack[top, 1], stack[top, 2] = la + 1, c, d
                            stack[top, 3], stack[top, 4], stack[top, 5] = lb, cb, db
                            found += 1
                            top += 1
                if missing > 0:
                    fill_spheres(g, children, found)
            else:
                found, missing = 0, 0
                for c in range(child_ub[lb, cb], child_ub[lb, cb + 1]):
                    for d in range(child_vb[lb, db], child_vb[lb, db + 1]):
                        to = off_b[lb + 1] + c * tally_b[lb + 1, 1] + d
                        if covers_b[to]:
                            missing += stamp_b[to] != tick_b
                            its_children[found, 0], its_children[found, 1], its_children[found, 2] = lb + 1, c, d
                            stack[top, 0], stack[top, 1], stack[top, 2] = la, ca, da
                            stack[top, 3], stack[top, 4], stack[top, 5] = lb + 1, c, d
                            found += 1
                            top += 1
                if missing > 0:
                    fill_spheres(h, its_children, found)
    g.counters[4] += tests
    return count


@njit_inline
def corner_box(
    points: Array, row_u: Index, row_v: Index, m: int, n: int, wraps: tuple[bool, bool, int], level: int, c: int, d: int,
    boxes: Array, to: int,
) -> None:  # fmt: skip
    """The box of a cell's four corners into boxes[to]."""
    for corner in range(4):
        i, j = row_u[level, c + (corner & 1)], row_v[level, d + (corner >> 1)]
        k = canonical(i, j, m, n, wraps[0], wraps[1], wraps[2])
        for x in range(3):
            low, high = points[k, x], points[k, x]
            if corner > 0:
                low, high = min(low, boxes[to, x]), max(high, boxes[to, 3 + x])
            boxes[to, x], boxes[to, 3 + x] = low, high


@njit_inline
def near_pair(a: Array, k: int, b: Array, l: int, pad: float) -> bool:
    """Box k of a (n, 6) comes within `pad` of box l of b along each axis."""
    return bool(
        a[k, 0] <= b[l, 3] + pad and b[l, 0] <= a[k, 3] + pad
        and a[k, 1] <= b[l, 4] + pad and b[l, 1] <= a[k, 4] + pad
        and a[k, 2] <= b[l, 5] + pad and b[l, 2] <= a[k, 5] + pad
    )  # fmt: skip


@njit_in_place
def cells_near(
    g: Patch, h: Patch, its: Array, reach: float, mark: int, room: Room, search: Search, voxels: Voxels
) -> int:
    """The same as `near_cells` for a tool that keeps its shape, whose voxels stand for its spheres."""
    cells, children, stack = room.cells, room.children, search.stack
    offset, tally, row_u, row_v, child_u, child_v, covers, ball, box = (
        g.offset, g.tally, g.row_u, g.row_v, g.child_u, g.child_v, g.covers, g.spheres, g.box,
    )  # fmt: skip
    stamp, tick, last, across = g.sphere_stamp, g.tick, len(g.offset) - 2, g.tally[0, 1]
    count, tests = 0, 0
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
            if not near_surface(h, search, voxels, its, ball[at, 0], ball[at, 1], ball[at, 2], ball[at, 3] + reach):
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
    g.counters[4] += tests
    return count


@njit_in_place
def surface_rows(
    g: Patch, h: Patch, voxels: Voxels, its: Array, seed: int, reach: float, felt: float, margin: float, tie: float,
    at: Array, turn: Array, mark: int, mark_again: int, mark_last: int, room: Room, waves: Waves, search: Search, rows: Columns, row: int,
    body: int, tool: int, face: int,
) -> tuple[int, int, int]:  # fmt: skip
    """Contacts of g's patch with the tool h, both in the tool's frame, into `rows` from `row` on, in the world: x_world =
    turn x + at.

    voxels : the tool's, where it keeps its shape. seed : a vertex to begin with instead of the cells that come within `reach`,
    or -1. felt : cells of the model that are deeper than this behind the tool, at all their vertices, do not begin a contact.
    mark... : numbers new to g's marks.

    Returns how many contacts; how many cells of the model came near; and how many finest cells the tool may reach between
    their vertices (room.maybe).
    """
    names, group, best, state = room.names, waves.group, waves.best, waves.state
    depth, points, visit, m, n = room.distance, room.points, g.visit, len(g.u), len(g.v)
    place, kept, queue, all_cells, on_face = waves.place, waves.kept, waves.queue, room.cells, g.inside
    row_u, row_v, wrap_u, wrap_v, poles, u, v, mine = g.row_u, g.row_v, g.wrap_u, g.wrap_v, g.poles, g.u, g.v, g.points
    near_by, count, groups = 0, 0, 0
    group[0] = 0
    if seed >= 0:
        visit[seed], names[0], place[seed], count, groups, group[1] = mark + 1, seed, 0, 1, 1, 1
    else:
        if len(voxels.slot):
            near_by = cells_near(g, h, its, reach, mark, room, search, voxels)
        else:
            near_by = near_cells(g, h, its, reach, mark, room, search)
        count, groups = list_vertices(g, all_cells, near_by, mark, names, place, group)
    # (from here on, those that are listed carry the number behind the mark)
    mark += 1
    make_points(g, names, count)
    look(g, h, voxels, search, names, 0, count, group, groups, margin, tie, points, waves, depth)
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
        groups = 0
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
                            groups += 1
                            group[groups] = count - known
                        elif place[k] < known:
                            s = place[k]
                            if kept[s] == 0 and not depth[s] < -margin:
                                kept[s], queue[tail] = 1, s
                                tail += 1
        if groups == 0:
            break
        make_points(g, names[known:count], count - known)
        look(g, h, voxels, search, names, known, count, group, groups, margin, tie, points, waves, depth)
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
def list_vertices(
    g: Patch, cells: Index, count: int, mark: int, names: Index, place: Index, group: Index
) -> tuple[int, int]:
    """The vertices on the face of cells[:count], block by block of neighbours, into names; how many they are, and how many
    blocks, which begin at group (blocks + 1,). They carry mark + 1 then."""
    row_u, row_v, visit, on_face, m, n = g.row_u, g.row_v, g.visit, g.inside, len(g.u), len(g.v)
    wrap_u, wrap_v, poles = g.wrap_u, g.wrap_v, g.poles
    found, groups = 0, 0
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
                        groups += 1
                        group[groups] = found
    return found, groups


@njit_in_place
def look(
    g: Patch, h: Patch, voxels: Voxels, search: Search, names: Index, start: int, stop: int, group: Index, groups: int,
    margin: float, tie: float, points: Array, waves: Waves, depth: Array,
) -> None:  # fmt: skip
    """The closest points of h to the vertices names[start:stop] of g, and how deep they are: -inf where the tool is open
    there and says nothing. The normals in waves.best are then the tool's, outward, or over an edge the way to it."""
    best, state, owner, mine = waves.best, waves.state, waves.owner, g.points
    for s in range(start, stop):
        state[s], owner[s], best[s, DISTANCE] = 0, -1, np.inf
        for c in range(3):
            points[s, c] = mine[names[s], c]
    beyond = 1.1 * margin + 1e-300
    if len(voxels.slot):
        feet(h, voxels, search, points[start:stop], beyond, best[start:stop], state[start:stop])
    else:
        project_in(
            h, search, points[start:stop], group, groups, tie, beyond, 0, best[start:stop], state[start:stop],
            owner[start:stop],
        )  # fmt: skip
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
