"""Triangulation of Surface (paper section 4.6): a mesh without holes over cells of any levels of detail.

The construction of a cell's sphere compares its two diagonals; the circle through the longer one holds the fourth
point, so by the Delaunay definition that the paper quotes it is the shorter diagonal that makes the two optimal
triangles. A cell beside finer ones takes their vertices on its border into a fan around the middle one of its grid
vertices (or, when it is one row wide, into a strip), so that no neighbour's vertex lies on an edge that passes it by:
there is no crack. Vertices at a closed seam or at a pole have one name on both sides, so there is none there either.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit
from .grid import PatchGrid
from .spheres import distance2
from .workspace import Patch, Workspace, canonical, grown, make_points

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def whole_mesh(grid: PatchGrid, net: Array, level: int = -1) -> tuple[Array, Index]:
    """All triangles of a patch at one level of detail (default: the finest): vertices (m n, 3) and triangles (t, 3).

    Vertex i n + j is the grid's (i, j); those that no triangle uses (coarser levels, seams, poles) are NaN. Triangles
    are oriented as S_u x S_v and cover the trimmed face's cells.
    """
    work = Workspace(grid, np.zeros(16, np.int64))
    g = work.load(net, paper=False, delta=0.0)
    level %= len(grid.tally)
    cells = np.array([(level, a, b) for a in range(grid.tally[level, 0]) for b in range(grid.tally[level, 1])])
    cells = cells[grid.covers[grid.offset[level] : grid.offset[level + 1]]].astype(np.int64).reshape(-1, 3)
    triangles, _ = triangulate(g, cells, len(cells), work.new_mark())
    points = g.points.copy()
    unused = np.ones(len(points), dtype=np.bool_)
    unused[triangles] = False
    points[unused] = np.nan
    return points, triangles


@njit
def triangulate(g: Patch, cells: Index, count: int, mark: int) -> tuple[Index, Index]:
    """Triangles (t, 3) over cells[:count] (level, ku, kv), which do not overlap, and first (count + 1,): cell c owns
    triangles first[c] to first[c + 1]. Vertices are flat names; the orientation is that of S_u x S_v.

    mark : a number new to g.visit.
    """
    m, n, wrap_u, wrap_v, poles = len(g.u), len(g.v), g.wrap_u, g.wrap_v, g.poles
    row_u, row_v, visit, points = g.row_u, g.row_v, g.visit, g.points
    # the corners of all cells, the only vertices that a border may have; and the hubs of fans
    names = np.empty(5 * count, np.int64)
    mixed = False
    for t in range(count):
        mixed = mixed or cells[t, 0] != cells[0, 0]
    for t in range(count):
        level, ku, kv = cells[t, 0], cells[t, 1], cells[t, 2]
        i0, i1, j0, j1 = row_u[level, ku], row_u[level, ku + 1], row_v[level, kv], row_v[level, kv + 1]
        for c in range(4):
            names[5 * t + c] = canonical(i1 if c & 1 else i0, j1 if c & 2 else j0, m, n, wrap_u, wrap_v, poles)
            visit[names[5 * t + c]] = mark
        names[5 * t + 4] = (
            canonical((i0 + i1) // 2, (j0 + j1) // 2, m, n, wrap_u, wrap_v, poles) if mixed else names[5 * t]
        )
    make_points(g, names, 5 * count)
    first = np.empty(count + 1, np.int64)
    triangles = np.empty((2 * count + 64, 3), np.int64)
    ring = np.empty(2 * (len(g.u) + len(g.v)), np.int64)
    sides = np.empty(4, np.int64)
    total = 0
    for t in range(count):
        first[t] = total
        level, ku, kv = cells[t, 0], cells[t, 1], cells[t, 2]
        i0, i1, j0, j1 = row_u[level, ku], row_u[level, ku + 1], row_v[level, kv], row_v[level, kv + 1]
        # the border, counterclockwise in (u, v) from (i0, j0): its corners and what finer neighbours have there
        length = 0
        perimeter = 2 * (i1 - i0) + 2 * (j1 - j0)
        for k in range(4):
            sides[k] = 0
        for k in range(perimeter):
            if k < i1 - i0:
                side, i, j = 0, i0 + k, j0
            elif k < i1 - i0 + j1 - j0:
                side, i, j = 1, i1, j0 + k - (i1 - i0)
            elif k < 2 * (i1 - i0) + j1 - j0:
                side, i, j = 2, i1 - (k - (i1 - i0) - (j1 - j0)), j1
            else:
                side, i, j = 3, i0, j1 - (k - 2 * (i1 - i0) - (j1 - j0))
            name = canonical(i, j, m, n, wrap_u, wrap_v, poles)
            corner = (i == i0 or i == i1) and (j == j0 or j == j1)
            if corner or (mixed and visit[name] == mark):
                ring[length] = name
                length += 1
                sides[side] += 1
        while total + length > len(triangles):
            triangles = grown(triangles)
        if length == 4:
            a, c, b, d = ring[0], ring[1], ring[2], ring[3]
            if distance2(points, a, b) <= distance2(points, c, d):
                total = put(triangles, total, a, c, b)
                total = put(triangles, total, a, b, d)
            else:
                total = put(triangles, total, a, c, d)
                total = put(triangles, total, c, b, d)
        elif i1 - i0 > 1 and j1 - j0 > 1:
            hub = canonical((i0 + i1) // 2, (j0 + j1) // 2, m, n, wrap_u, wrap_v, poles)
            for k in range(length):
                total = put(triangles, total, hub, ring[k], ring[(k + 1) % length])
        else:
            total = strip(ring, length, sides, i1 - i0 > 1, triangles, total)
    first[count] = total
    return triangles[:total], first


@njit
def put(triangles: Index, total: int, a: int, b: int, c: int) -> int:
    """Append a triangle, unless a pole or a seam has made two of its vertices one."""
    if a == b or b == c or c == a:
        return total
    triangles[total, 0], triangles[total, 1], triangles[total, 2] = a, b, c
    return total + 1


@njit
def strip(ring: Index, length: int, sides: Index, along_u: bool, triangles: Index, total: int) -> int:
    """A cell one row wide: triangles between the chains of its two long sides, always from the chain that lags
    behind."""
    # both chains by growing u (or v): one runs with the ring from `low`, the other against it from `high`
    if along_u:
        low, steps_low, high, steps_high = 0, sides[0], sides[0] + sides[1] + sides[2], sides[2]
    else:
        low, steps_low, high, steps_high = sides[0], sides[1], length, sides[3]
    a, b = 0, 0
    while a < steps_low or b < steps_high:
        here, there = ring[(low + a) % length], ring[(high - b) % length]
        if b == steps_high or (a < steps_low and a * steps_high <= b * steps_low):
            a += 1
            ahead = ring[(low + a) % length]
        else:
            b += 1
            ahead = ring[(high - b) % length]
        total = put(triangles, total, here, ahead, there)
    return total
