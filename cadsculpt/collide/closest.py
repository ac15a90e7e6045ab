"""Closest points on the true surface: candidates by the spheres, then Newton in (u, v).

`closest_points` is for anyone; `project` is the kernel. Points come in groups of neighbours: the cells that can hold
the closest point of any of a group are found once, by descending the levels of detail and dropping every cell whose
sphere is farther than the group's nearest one allows. Each point then starts Newton from its neighbour's closest
point, and again from the nearest of those cells when that is not where Newton came out: another sheet of the surface
may be nearer. On a closed direction the parameters wrap; elsewhere they stop at the border.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..jit import njit, njit_in_place, njit_inline_in_place
from .grid import PatchGrid
from .newton import DISTANCE, NORMAL, POINT, PROPER, U, V, inside, newton
from .spheres import fill_spheres
from .workspace import Patch, Search, Workspace, canonical, new_search

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NOTHING = 0
"""The state of a point for which no patch has been projected on; else `newton.PROPER` or `newton.BORDER`."""

NEAR_ENOUGH = 0.1
"""A cell this small against its distance, or smaller than the group, is not refined: it is start enough for Newton."""

SHEET = 1.5
"""A cell's middle is no farther than the closest point that it holds by more than its radius, at right angles: cells
beyond (with this margin for their bulge) hold nothing nearer than what is found. On a border there need be no right angle."""

ATTEMPTS = 10
"""Newton starts at most this often for one point: nearly always once, from the point before; often only near a centre of
curvature, where much of the surface is equally near."""


@dataclass(frozen=True, slots=True, eq=False)
class Closest:
    """The closest points of a patch to n points: parameters u, v (n,), point (n, 3), distance (n,), unit normal (n, 3)
    out of the material. proper (n,) : False where the closest point lies on an open border, seen at an oblique angle."""

    u: Array
    v: Array
    point: Array
    normal: Array
    distance: Array
    proper: NDArray[np.bool_]


def closest_points(grid: PatchGrid, net: Array, points: Array) -> Closest:
    """The closest points of the patch over control points net (r, s, 3) to points (n, 3).

    The whole surface counts, trimmed away or not, but for cells of the grid without any vertex of the trimmed face.
    """
    g = Workspace(grid, np.zeros(16, np.int64)).load(net, paper=False, delta=0.0)
    points = np.array(points, dtype=np.float64).reshape(-1, 3)
    best = np.full((len(points), 9), np.inf)
    state, owner = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    project(g, points, np.arange(len(points) + 1), 0.0, np.inf, 0, best, state, owner)
    return Closest(
        best[:, U],
        best[:, V],
        best[:, POINT : POINT + 3],
        best[:, NORMAL : NORMAL + 3],
        best[:, DISTANCE],
        state == PROPER,
    )


@njit
def project(
    g: Patch,
    points: Array,
    group: Index,
    tie: float,
    beyond: float,
    patch: int,
    best: Array,
    state: Index,
    owner: Index,
) -> None:
    """Closest points of one patch to points (n, 3), where they are nearer than what `best` (n, 9) holds already.

    group (k + 1,) : points group[i] to group[i + 1] are neighbours. beyond : points outside and farther than this
    (infinite: none) get their distance to a percent only (`newton.ROUGH`). owner (n,) becomes `patch` where it wins. A point as
    near (to `tie`) as the one of a patch before, and in the same place, is on their common edge: the normals are added
    (the pseudo-normal of that edge) and the state becomes PROPER, for the edge is no border then.
    """
    project_in(g, new_search(g), points, group, len(group) - 1, tie, beyond, patch, best, state, owner)


@njit_in_place
def project_in(
    g: Patch, search: Search, points: Array, group: Index, groups: int, tie: float, beyond: float, patch: int, best: Array,
    state: Index, owner: Index,
) -> None:  # fmt: skip
    """The same for the first `groups` groups, in room that is given."""
    final, table, mine, c = search.final, search.table, search.mine, search.centre
    px, py, pz = 0.0, 0.0, 0.0
    for gi in range(groups):
        lo, hi = group[gi], group[gi + 1]
        # the group's sphere
        cap = 0.0
        for a in range(3):
            low, high = np.inf, -np.inf
            for i in range(lo, hi):
                low, high = min(low, points[i, a]), max(high, points[i, a])
            c[a] = 0.5 * (low + high)
        rho = 0.0
        for i in range(lo, hi):
            rho = max(rho, gap(points, i, c))
            cap = max(cap, best[i, DISTANCE])
        cap += rho
        finals = candidates(g, search, rho, cap)
        if finals == 0:
            continue
        warm = False
        # the middle of a group first: how near it is leaves fewer candidates to its points
        for i in range(lo - 1 if hi - lo > 1 else lo, hi):
            x, y, z = (points[i, 0], points[i, 1], points[i, 2]) if i >= lo else (c[0], c[1], c[2])
            reached, kind = approach(
                g, search, table, final, 0, finals, x, y, z, px, py, pz, warm, beyond if i >= lo else np.inf
            )
            if reached < np.inf:
                warm, px, py, pz = True, x, y, z
            if i < lo:
                finals = nearest_candidates(table, final, finals, c, rho, reached)
            elif reached < np.inf:
                # once for this patch, however often Newton came to the same point
                for a in range(3):
                    mine[NORMAL + a] *= g.flip
                merge(mine, kind, patch, tie, i, best, state, owner)


@njit_in_place
def candidates(g: Patch, search: Search, rho: float, cap: float) -> int:
    """The cells that can hold the closest point, no farther than `cap`, of any point within `rho` of search.centre: found by
    descending the levels, into search.final, their middles, radii and whether they lie on a border into search.table; how
    many they are."""
    tick, last = g.tick, len(g.offset) - 2
    spheres, stamp, offset, tally, covers = g.spheres, g.sphere_stamp, g.offset, g.tally, g.covers
    row_u, row_v, child_u, child_v, box = g.row_u, g.row_v, g.child_u, g.child_v, g.box
    here, there, final, table, c = search.here, search.there, search.final, search.table, search.centre
    spans, across, wrap_u, wrap_v = tally[0, 0] * tally[0, 1], tally[0, 1], g.wrap_u, g.wrap_v
    for k in range(spans):
        here[k, 0], here[k, 1], here[k, 2] = 0, k // across, k % across
    fill_spheres(g, here, spans)
    # spans, by their boxes; `upper`: no farther than this is some point of the surface from c
    upper = np.inf
    for k in range(spans):
        if covers[k]:
            upper = min(upper, gap(spheres, k, c) + spheres[k, 3])
    count = 0
    for k in range(spans):
        if covers[k] and box_gap(box, k, c) <= min(upper + 2.0 * rho, cap):
            here[count, 0], here[count, 1], here[count, 2] = 0, k // across, k % across
            count += 1
    finals = 0
    for level in range(1, last + 1):
        fresh, missing = 0, 0
        for t in range(count):
            for ku in range(child_u[level - 1, here[t, 1]], child_u[level - 1, here[t, 1] + 1]):
                for kv in range(child_v[level - 1, here[t, 2]], child_v[level - 1, here[t, 2] + 1]):
                    at = offset[level] + ku * tally[level, 1] + kv
                    if not covers[at]:
                        continue
                    there[fresh, 0], there[fresh, 1], there[fresh, 2] = level, ku, kv
                    fresh += 1
                    missing += stamp[at] != tick
        if missing > 0:
            fill_spheres(g, there, fresh)
        for t in range(fresh):
            at = offset[level] + there[t, 1] * tally[level, 1] + there[t, 2]
            upper = min(upper, gap(spheres, at, c) + spheres[at, 3])
        count = 0
        for t in range(fresh):
            ku, kv = there[t, 1], there[t, 2]
            at = offset[level] + ku * tally[level, 1] + kv
            if gap(spheres, at, c) - spheres[at, 3] > min(upper + 2.0 * rho, cap):
                continue
            one = row_u[level, ku + 1] - row_u[level, ku] == 1 and row_v[level, kv + 1] - row_v[level, kv] == 1
            if level == last or one or spheres[at, 3] <= max(rho, NEAR_ENOUGH * upper):
                final[finals, 0], final[finals, 1], final[finals, 2] = level, ku, kv
                finals += 1
            else:
                here[count, 0], here[count, 1], here[count, 2] = level, ku, kv
                count += 1
    # the candidates' middles and radii, and whether they lie on a border
    for t in range(finals):
        level, ku, kv = final[t, 0], final[t, 1], final[t, 2]
        at = offset[level] + ku * tally[level, 1] + kv
        for a in range(4):
            table[t, a] = spheres[at, a]
        border_u = not wrap_u and (ku == 0 or ku == tally[level, 0] - 1)
        border_v = not wrap_v and (kv == 0 or kv == tally[level, 1] - 1)
        table[t, 4] = border_u or border_v
    return finals


@njit_in_place
def nearest_candidates(table: Array, final: Index, count: int, c: Array, rho: float, reached: float) -> int:
    """Those of the candidates that still count once the distance `reached` of the middle c is known; how many they are."""
    left = 0
    for t in range(count):
        away = max(gap(table, t, c) - rho, 0.0)
        least, r = reached + rho, table[t, 3]
        if away * away <= (least * least + SHEET * r * r if table[t, 4] == 0.0 else (least + r) ** 2):
            for a in range(5):
                table[left, a] = table[t, a]
            for a in range(3):
                final[left, a] = final[t, a]
            left += 1
    return left


@njit_inline_in_place
def approach(
    g: Patch, search: Search, table: Array, final: Index, first: int, count: int, x: float, y: float, z: float,
    px: float, py: float, pz: float, warm: bool, beyond: float,
) -> tuple[float, int]:  # fmt: skip
    """The closest point to (x, y, z) into search.mine, the normal S_u x S_v; its distance, infinite where there is none, and
    its kind.

    table, final : candidates, the rows [first, first + count). warm : search.found and search.h hold the closest point of
    (px, py, pz), a neighbour.
    """
    row_u, row_v, u, v, grid_points, m, n = g.row_u, g.row_v, g.u, g.v, g.points, len(g.u), len(g.v)
    net, knots_u, knots_v, degree_u, degree_v, rational, wrap_u, wrap_v, poles, slack = (
        g.net, g.knots_u, g.knots_v, g.degree_u, g.degree_v, g.rational, g.wrap_u, g.wrap_v, g.poles, g.slack,
    )  # fmt: skip
    frames, terms, terms_stamp, tick = g.frames, g.terms, g.terms_stamp, g.tick
    found, mine, h, scratch, starts = search.found, search.mine, search.h, search.scratch, search.starts
    last_u, last_v, best_kind = 0.0, 0.0, PROPER
    reached = np.inf
    for attempt in range(ATTEMPTS):
        chosen = -1
        if attempt == 0:
            # from the closest point of the one before in the group, by its tangents
            if not warm:
                continue
            du, dv = along(h, x - px, y - py, z - pz)
            found[U] = inside(found[U] + du, u[0], u[len(u) - 1], wrap_u)
            found[V] = inside(found[V] + dv, v[0], v[len(v) - 1], wrap_v)
        else:
            # from the nearest cell that may hold something nearer; of cells tried already, or beside the one in
            # which Newton came out, only from a corner that is nearer
            nearest = np.inf
            for t in range(first, first + count):
                dx, dy, dz = table[t, 0] - x, table[t, 1] - y, table[t, 2] - z
                d2 = dx * dx + dy * dy + dz * dz
                r2, border = table[t, 3] * table[t, 3], table[t, 4] != 0.0
                if d2 > (reached * reached + SHEET * r2 if not border else (reached + table[t, 3]) ** 2):
                    continue
                level, ku, kv = final[t, 0], final[t, 1], final[t, 2]
                i0, i1, j0, j1 = row_u[level, ku], row_u[level, ku + 1], row_v[level, kv], row_v[level, kv + 1]
                ua, ub, va, vb = u[i0], u[i1], v[j0], v[j1]
                out_u, out_v = max(ua - last_u, last_u - ub), max(va - last_v, last_v - vb)
                known = reached < np.inf and out_u <= ub - ua and out_v <= vb - va
                for a in range(1, attempt):
                    known = known or starts[a] == t
                start_u, start_v = 0.5 * (ua + ub), 0.5 * (va + vb)
                if known or border:
                    d2 = np.inf
                    for e in range(4):
                        k = canonical(i1 if e & 1 else i0, j1 if e & 2 else j0, m, n, wrap_u, wrap_v, poles)
                        dx, dy, dz = grid_points[k, 0] - x, grid_points[k, 1] - y, grid_points[k, 2] - z
                        if dx * dx + dy * dy + dz * dz < d2:
                            d2 = dx * dx + dy * dy + dz * dz
                            start_u, start_v = ub if e & 1 else ua, vb if e & 2 else va
                    if d2 >= reached * reached + (0.0 if known else r2):
                        continue
                if d2 < nearest:
                    nearest, chosen = d2, t
                    found[U], found[V] = start_u, start_v
            if chosen < 0:
                break
        starts[attempt] = chosen
        kind = newton(
            net, knots_u, knots_v, degree_u, degree_v, rational, wrap_u, wrap_v, poles, slack,
            g.flip * beyond, x, y, z, found, h, scratch, frames, terms, terms_stamp, tick,
        )  # fmt: skip
        warm, px, py, pz = True, x, y, z
        if found[DISTANCE] < reached:
            reached, last_u, last_v, best_kind = found[DISTANCE], found[U], found[V], kind
            for a in range(9):
                mine[a] = found[a]
    return reached, best_kind


@njit_in_place
def along(h: Array, x: float, y: float, z: float) -> tuple[float, float]:
    """(du, dv) of the step along the tangents h[1], h[2] that comes nearest to (x, y, z); nothing where they are
    dependent."""
    uu = h[1, 0] * h[1, 0] + h[1, 1] * h[1, 1] + h[1, 2] * h[1, 2]
    uv = h[1, 0] * h[2, 0] + h[1, 1] * h[2, 1] + h[1, 2] * h[2, 2]
    vv = h[2, 0] * h[2, 0] + h[2, 1] * h[2, 1] + h[2, 2] * h[2, 2]
    a, b = x * h[1, 0] + y * h[1, 1] + z * h[1, 2], x * h[2, 0] + y * h[2, 1] + z * h[2, 2]
    det = uu * vv - uv * uv
    if not det > 1e-6 * uu * vv:
        return 0.0, 0.0
    return (vv * a - uv * b) / det, (uu * b - uv * a) / det


@njit_in_place
def gap(rows: Array, k: int, c: Array) -> float:
    """Distance of rows[k, 0:3] from c."""
    x, y, z = rows[k, 0] - c[0], rows[k, 1] - c[1], rows[k, 2] - c[2]
    return float(np.sqrt(x * x + y * y + z * z))


@njit_in_place
def box_gap(box: Array, k: int, c: Array) -> float:
    """Distance of c from the box k of (n, 6)."""
    d = 0.0
    for a in range(3):
        x = max(0.0, box[k, a] - c[a], c[a] - box[k, 3 + a])
        d += x * x
    return float(np.sqrt(d))


@njit_in_place
def merge(found: Array, kind: int, patch: int, tie: float, i: int, best: Array, state: Index, owner: Index) -> None:
    """Take a result into row i where it is nearer, or join it to one on the common edge with another patch."""
    if state[i] != NOTHING and owner[i] != patch and abs(found[DISTANCE] - best[i, DISTANCE]) <= tie:
        apart = 0.0
        for a in range(3):
            apart = max(apart, abs(found[POINT + a] - best[i, POINT + a]))
        if apart <= tie:
            for a in range(3):
                best[i, NORMAL + a] += found[NORMAL + a]
            state[i] = PROPER
            return
    if state[i] == NOTHING or found[DISTANCE] < best[i, DISTANCE]:
        for a in range(9):
            best[i, a] = found[a]
        state[i] = kind
        owner[i] = patch
