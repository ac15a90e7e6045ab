"""Contact points as a quadrature over the model's surface: what makes forces independent of the resolution.

The points are the vertices of the finest grid, whatever the levels of detail did before. Each stands for a quarter of
its cells' areas (for smooth surfaces |S_u x S_v| times the trapezoid weight to second order; right at creases too). A
seam's vertices count once, a pole's once with all the cells that end there. Where a tool is so small that it reaches
the surface between the vertices, the cells there are cut further until its print is resolved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ..jit import njit, njit_in_place, njit_inline_in_place
from ..spline.bounds import S_UU, S_UV, S_VV, span_bounds
from ..spline.region import OFF, Region
from .cells import cells_of
from .newton import approach
from .spheres import distance2
from .workspace import Patch, canonical, grown, make_points

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

BLOCK = 4
"""Vertices of one block (this many rows and columns) look for their closest points together."""

ENOUGH_POINTS = 24
"""A print that is below the grid is resolved when this many sub-cells lie in it: its area is then right to some ten
percent."""

LOOSE = 512
"""Where more parts than this come near the tool, their bounds are loose: a print is a few dozen parts wide."""

ROUND = 65536
"""Parts cut at a time: where more of them come near the tool, those that may lie deepest in it go first."""

MOST_SUBCELLS = 8 * ROUND
"""Parts of one patch that are looked at for one tool, about a second: what is then left is said to be undecided."""

THIN = 1.0 / 64.0
"""Where a part's middle is off the face, the face in it may be a strip: it is cut down to this share of the tolerance."""


@njit_inline_in_place
def quad_area(points: Array, p00: int, p10: int, p01: int, p11: int) -> float:
    """Area of the quadrilateral of four vertices: half the cross product of its diagonals."""
    ux, uy, uz = points[p11, 0] - points[p00, 0], points[p11, 1] - points[p00, 1], points[p11, 2] - points[p00, 2]
    vx, vy, vz = points[p01, 0] - points[p10, 0], points[p01, 1] - points[p10, 1], points[p01, 2] - points[p10, 2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return float(0.5 * np.sqrt(x * x + y * y + z * z))


@njit_inline_in_place
def ring_of(k: int, m: int, n: int, poles: int) -> tuple[int, int, int, int, float]:
    """The finest cells (i from, to, j from, to; ends included, not yet brought into the grid) around the vertex k, and
    its share of each: a quarter, or a half at a pole, which is two corners of its cells."""
    i, j = k // n, k % n
    low_i, high_i, low_j, high_j, share = i - 1, i, j - 1, j, 0.25
    if (poles & 1 and i == 0) or (poles & 2 and i == m - 1):
        low_j, high_j, share = 0, n - 2, 0.5
    if (poles & 4 and j == 0) or (poles & 8 and j == n - 1):
        low_i, high_i, share = 0, m - 2, 0.5
    return low_i, high_i, low_j, high_j, share


@njit_inline_in_place
def in_grid(c: int, cells: int, wrap: bool) -> int:
    """A cell's row brought into the grid over a closed seam, or -1 beyond the border."""
    if c >= 0 and c < cells:
        return c
    if wrap:
        return c % cells
    return -1


@njit
def vertex_rows(g: Patch, names: Index) -> tuple[Array, Array, Array]:
    """Parameters (n, 2), points (n, 3) and areas (n,) of vertices."""
    n, points, u, v = len(g.v), g.points, g.u, g.v
    uv, out, area = np.empty((len(names), 2)), np.empty((len(names), 3)), np.empty(len(names))
    make_points(g, names, len(names))
    vertex_areas(g, names, len(names), area)
    for t in range(len(names)):
        k = names[t]
        uv[t, 0], uv[t, 1] = u[k // n], v[k % n]
        for x in range(3):
            out[t, x] = points[k, x]
    return uv, out, area


@njit_in_place
def vertex_areas(g: Patch, names: Index, count: int, area: Array) -> None:
    """The areas that the vertices names[:count] stand for; those of the cells around are each made once per net."""
    tick, m, n = g.tick, len(g.u), len(g.v)
    wrap_u, wrap_v, poles = g.wrap_u, g.wrap_v, g.poles
    points, cell_area, stamp, corners, wanted = g.points, g.cell_area, g.area_stamp, g.corners, g.wanted
    made = 0
    for t in range(count):
        low_i, high_i, low_j, high_j, share = ring_of(names[t], m, n, poles)
        for a in range(low_i, high_i + 1):
            c = in_grid(a, m - 1, wrap_u)
            for b in range(low_j, high_j + 1):
                d = in_grid(b, n - 1, wrap_v)
                if c < 0 or d < 0 or stamp[c * n + d] == tick:
                    continue
                stamp[c * n + d] = tick
                for corner in range(4):
                    corners[4 * made + corner] = canonical(
                        c + (corner & 1), d + (corner >> 1), m, n, wrap_u, wrap_v, poles
                    )  # fmt: skip
                wanted[made] = c * n + d
                made += 1
    make_points(g, corners, 4 * made)
    for s in range(made):
        cell_area[wanted[s]] = quad_area(
            points, corners[4 * s], corners[4 * s + 1], corners[4 * s + 2], corners[4 * s + 3]
        )  # fmt: skip
    for t in range(count):
        low_i, high_i, low_j, high_j, share = ring_of(names[t], m, n, poles)
        total = 0.0
        for a in range(low_i, high_i + 1):
            c = in_grid(a, m - 1, wrap_u)
            for b in range(low_j, high_j + 1):
                d = in_grid(b, n - 1, wrap_v)
                if c >= 0 and d >= 0:
                    total += cell_area[c * n + d]
        area[t] = share * total


@njit
def spread(g: Patch, names: Index, mark: int) -> Index:
    """The vertices on the face, a block of neighbours at a time, around `names` that do not carry `mark` in g.visit
    yet; they get it, and their points are made."""
    visit, on_face, m, n, wrap_u, wrap_v, poles = g.visit, g.inside, len(g.u), len(g.v), g.wrap_u, g.wrap_v, g.poles
    out = np.empty((256, 1), np.int64)
    found = 0
    for t in range(len(names)):
        low_i, high_i, low_j, high_j, _ = ring_of(names[t], m, n, poles)
        for a in range(low_i, high_i + 1):
            c = in_grid(a, m - 1, wrap_u)
            for b in range(low_j, high_j + 1):
                d = in_grid(b, n - 1, wrap_v)
                if c < 0 or d < 0:
                    continue
                for corner in range(4):
                    i, j = c + (corner & 1), d + (corner >> 1)
                    k = canonical(i, j, m, n, wrap_u, wrap_v, poles)
                    if visit[k] == mark or not on_face[k]:
                        continue
                    while found + BLOCK * BLOCK > len(out):
                        out = grown(out)
                    i, j = i // BLOCK * BLOCK, j // BLOCK * BLOCK
                    for e in range(i, min(i + BLOCK, m)):
                        for f in range(j, min(j + BLOCK, n)):
                            k = canonical(e, f, m, n, wrap_u, wrap_v, poles)
                            if visit[k] != mark and on_face[k]:
                                visit[k] = mark
                                out[found, 0] = k
                                found += 1
    fresh = out[:found, 0].copy()
    make_points(g, fresh, found)
    return fresh


def in_blocks(names: Index, columns: int) -> tuple[Index, Index]:
    """The names ordered by blocks of neighbours, and where each block starts (blocks + 1,)."""
    key = (names // columns // BLOCK) * (columns // BLOCK + 1) + names % columns // BLOCK
    order = np.argsort(key, kind="stable")
    key = key[order]
    return names[order], np.concatenate([[0], np.flatnonzero(key[1:] != key[:-1]) + 1, [len(names)]])


@njit
def unresolved(g: Patch, cells: Index, margin: float, names: Index, depths: Array, mark: int) -> Index:
    """The finest cells (i, j) of `cells` (level, ku, kv) that the tool may reach between their vertices, without a
    contact in any cell connected to them by such cells.

    names, depths (n,) : vertices of known depth, -inf where the tool is on no side. A cell is out of reach when one of
    its vertices is farther from the tool than from any point of the cell (its longest chord and its sag). mark : a
    number new to g.visit.
    """
    row_u, row_v = g.row_u, g.row_v
    most = 0
    for t in range(len(cells)):
        level, ku, kv = cells[t, 0], cells[t, 1], cells[t, 2]
        most += (row_u[level, ku + 1] - row_u[level, ku]) * (row_v[level, kv + 1] - row_v[level, kv])
    maybe = np.empty((most, 6), np.int64)
    left = unresolved_cells(g, cells, len(cells), margin, names, depths, len(names), mark, maybe)
    return maybe[:left, :2].copy()


@njit_in_place
def unresolved_cells(
    g: Patch,
    cells: Index,
    cells_count: int,
    margin: float,
    names: Index,
    depths: Array,
    known: int,
    mark: int,
    maybe: Index,
) -> int:
    """The same of cells[:cells_count] with names[:known], into maybe (n, 6) columns 0 and 1; how many they are."""
    m, n, tick = len(g.u), len(g.v), g.tick
    wrap_u, wrap_v, poles = g.wrap_u, g.wrap_v, g.poles
    visit, depth, points, row_u, row_v = g.visit, g.depth, g.points, g.row_u, g.row_v
    stamp, span_u, span_v, bounds, bounds_stamp = g.point_stamp, g.span_u, g.span_v, g.bounds, g.bounds_stamp
    ids = g.ids
    count = 0
    for t in range(known):
        depth[names[t]] = depths[t]
        visit[names[t]] = mark
    # vertices of touched cells get mark + 1, and so do those of all cells that are connected to these
    for t in range(cells_count):
        level, ku, kv = cells[t, 0], cells[t, 1], cells[t, 2]
        i0, i1, j0, j1 = row_u[level, ku], row_u[level, ku + 1], row_v[level, kv], row_v[level, kv + 1]
        for i in range(i0, i1):
            for j in range(j0, j1):
                reach2, farthest, touched, complete = 0.0, -np.inf, False, True
                for c in range(4):
                    ids[c] = canonical(i + (c & 1), j + (c >> 1), m, n, wrap_u, wrap_v, poles)
                    complete = complete and stamp[ids[c]] == tick
                    if visit[ids[c]] >= mark:
                        touched = touched or not depth[ids[c]] < -margin
                        farthest = max(farthest, -depth[ids[c]])
                if complete and not touched:
                    for c in range(4):
                        for d in range(c):
                            reach2 = max(reach2, distance2(points, ids[c], ids[d]))
                    a, b = span_u[i], span_v[j]
                    hu, hv = g.u[i + 1] - g.u[i], g.v[j + 1] - g.v[j]
                    if bounds_stamp[a, b] != tick:
                        bounds_stamp[a, b] = tick
                        span_bounds(
                            g.net, g.knots_u, g.knots_v, g.degree_u, g.degree_v, g.first_u[i], g.first_v[j], g.rational,
                            bounds[a, b],
                        )  # fmt: skip
                    sag = (hu * hu * bounds[a, b, S_UU] + hv * hv * bounds[a, b, S_VV]) / 8.0
                    if farthest > np.sqrt(reach2) + sag + margin:
                        continue
                maybe[count, 0], maybe[count, 1] = i, j
                for c in range(4):
                    maybe[count, 2 + c] = ids[c]
                    if touched:
                        visit[ids[c]] = mark + 1
                count += 1
    changed, forward, left = True, True, count
    while changed and left > 0:
        changed = False
        for s in range(count):
            t = s if forward else count - 1 - s
            if maybe[t, 0] < 0:
                continue
            met = False
            for c in range(4):
                met = met or visit[maybe[t, 2 + c]] == mark + 1
            if met:
                maybe[t, 0] = -1
                left -= 1
                changed = True
                for c in range(4):
                    visit[maybe[t, 2 + c]] = mark + 1
        forward = not forward
    total = 0
    for t in range(count):
        if maybe[t, 0] >= 0:
            maybe[total, 0], maybe[total, 1] = maybe[t, 0], maybe[t, 1]
            total += 1
    return total


@njit
def subcells(g: Patch, cells: Index, place: Array) -> tuple[Array, Array, Array, Array]:
    """Parts of the finest cells (i, j) of `cells` (n, 2): place (n, 3) is the part's corner and size in the cell, 0 to
    1.

    Returns the middle's parameters (n, 2) and points (n, 3), a radius (n,) around it that holds the part, and areas
    (n,). The radius is the tangents' reach and Taylor's remainder with the span's bounds on the second derivatives.
    """
    scratch = np.empty((9, max(g.degree_u, g.degree_v) + 4))
    h = np.empty((6, 4))
    uv, points = np.empty((len(cells), 2)), np.empty((len(cells), 3))
    radius, area = np.empty(len(cells)), np.empty(len(cells))
    for t in range(len(cells)):
        i, j = cells[t, 0], cells[t, 1]
        a, b = g.span_u[i], g.span_v[j]
        if g.bounds_stamp[a, b] != g.tick:
            g.bounds_stamp[a, b] = g.tick
            span_bounds(
                g.net, g.knots_u, g.knots_v, g.degree_u, g.degree_v, g.first_u[i], g.first_v[j], g.rational,
                g.bounds[a, b],
            )  # fmt: skip
        hu, hv = g.u[i + 1] - g.u[i], g.v[j + 1] - g.v[j]
        du, dv = 0.5 * hu * place[t, 2], 0.5 * hv * place[t, 2]
        uv[t, 0], uv[t, 1] = g.u[i] + hu * place[t, 0] + du, g.v[j] + hv * place[t, 1] + dv
        approach(
            g.net,
            g.knots_u,
            g.knots_v,
            g.degree_u,
            g.degree_v,
            g.rational,
            uv[t, 0],
            uv[t, 1],
            0.0,
            0.0,
            0.0,
            h,
            scratch,
        )
        plus, minus = 0.0, 0.0
        for c in range(3):
            points[t, c] = h[0, c]
            plus += (h[1, c] * du + h[2, c] * dv) ** 2
            minus += (h[1, c] * du - h[2, c] * dv) ** 2
        second = du * du * g.bounds[a, b, S_UU] + 2.0 * du * dv * g.bounds[a, b, S_UV] + dv * dv * g.bounds[a, b, S_VV]
        radius[t] = np.sqrt(max(plus, minus)) + 0.5 * second + g.slack
        x, y = h[1, 1] * h[2, 2] - h[1, 2] * h[2, 1], h[1, 2] * h[2, 0] - h[1, 0] * h[2, 2]
        z = h[1, 0] * h[2, 1] - h[1, 1] * h[2, 0]
        area[t] = 4.0 * du * dv * np.sqrt(x * x + y * y + z * z)
    return uv, points, radius, area


def below_grid(
    g: Patch,
    cells: Index,
    bound: Callable[[Array], Array],
    distance: Callable[[Array], Array],
    margin: float,
    tolerance: float,
    region: Region | None = None,
) -> tuple[Array, Array, Array, float]:
    """Contacts of a tool that reaches the surface between the vertices of the finest cells (i, j) of `cells` (n, 2).

    The cells are cut in four, and those whose sphere stays away from the tool, or that hold no piece of the face
    (`region`), dropped, until ENOUGH_POINTS middles lie in the tool (distance <= margin) and on the face, or what is left
    is smaller than `tolerance`: a print no deeper than that is not found. bound : what discards, nowhere farther from 0
    than the distance. Returns parameters (k, 2), points (k, 3), areas (k,), and how deep a print may be that was not
    found before MOST_SUBCELLS parts were made: 0 where the search came to its end.
    """
    pool = _parts(g, cells, np.tile([0.0, 0.0, 1.0], (len(cells), 1)), bound, distance, margin, region)
    made = len(cells)
    while True:
        may_be = margin + pool.radius - pool.low
        open_ = pool.near & (pool.radius > np.where(pool.beside, THIN * tolerance, tolerance))
        hits = int(pool.hit.sum())
        cut = np.flatnonzero(open_)
        if 4 * len(cut) > ROUND:
            cut = np.flatnonzero(open_ & ~(may_be <= tolerance))
        if hits >= ENOUGH_POINTS or not len(cut) or made >= MOST_SUBCELLS:
            undecided = float(may_be[cut].max()) if len(cut) and hits < ENOUGH_POINTS else 0.0
            return pool.uv[pool.hit], pool.points[pool.hit], pool.area[pool.hit], undecided
        if 4 * len(cut) > ROUND:
            # what may lie deepest first: so much shallower is what may be left at the end
            cut = np.sort(cut[np.argsort(-may_be[cut], kind="stable")[: ROUND // 4]])
        stays = pool.near | pool.hit
        stays[cut] = False
        corner = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.5, 0.5]])
        place = pool.place[cut]
        start = (place[:, None, :2] + place[:, None, 2:] * corner).reshape(-1, 2)
        children = np.column_stack([start, 0.5 * np.repeat(place[:, 2], 4)])
        fresh = _parts(g, np.repeat(pool.cells[cut], 4, axis=0), children, bound, distance, margin, region)
        made += len(children)
        pool = _Parts(*(np.concatenate([getattr(pool, f.name)[stays], getattr(fresh, f.name)]) for f in fields(_Parts)))


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """n parts of finest cells: cell (n, 2), place in it (n, 3), the middle's parameters (n, 2) and point (n, 3), a radius
    around it and an area (n,); low (n,), what the tool's distance is at least in the middle, or outside of it. hit : the
    middle is in the tool and on the face. near : the tool may reach the part. beside : the middle is in the tool but not
    on the face.
    """

    cells: Index
    place: Array
    uv: Array
    points: Array
    radius: Array
    area: Array
    low: Array
    hit: Mask
    near: Mask
    beside: Mask


def _parts(
    g: Patch,
    cells: Index,
    place: Array,
    bound: Callable[[Array], Array],
    distance: Callable[[Array], Array],
    margin: float,
    region: Region | None,
) -> _Parts:
    """Parts that hold a piece of the face, against the tool."""
    if region is not None:
        held = region.classify(rectangles(g, cells, place)) != OFF
        cells, place = cells[held], place[held]
    uv, points, radius, area = subcells(g, cells, place)
    low = bound(points)
    # (what is not a number is a contact, and so an error)
    hit = ~(low > margin)
    if distance is not bound:
        unsure = np.flatnonzero(hit & ~(low < 0))
        hit[unsure] = ~(distance(points[unsure]) > margin)
    beside = np.zeros(len(hit), np.bool_)
    if region is not None:
        beside[hit] = region.locate(uv[hit]) == OFF
        hit &= ~beside
    near = ~(low > radius + margin)
    if near.sum() > LOOSE:
        # the span's bounds say little here: the parts' own Bezier nets, which cost more
        held = np.flatnonzero(near)
        parts = cells_of(g, None, rectangles(g, cells[held], place[held]))
        near[held] = ~(bound(parts.centre) > parts.radius + margin)
        # (both the middle and what is deepest lie in that sphere)
        radius[held] = np.minimum(radius[held], 2.0 * parts.radius)
    return _Parts(cells, place, uv, points, radius, area, low, hit, near, beside)


def rectangles(g: Patch, cells: Index, place: Array) -> Array:
    """The parts of `subcells` in (u, v): (n, 4), u from, to, v from, to."""
    out = np.empty((len(cells), 4))
    for axis, t in enumerate((g.u, g.v)):
        low, size = t[cells[:, axis]], t[cells[:, axis] + 1] - t[cells[:, axis]]
        out[:, 2 * axis] = low + size * place[:, axis]
        out[:, 2 * axis + 1] = low + size * (place[:, axis] + place[:, 2])
    return out
