"""Generation of Lower Levels of Detail (paper section 4.5) and Interaction of Flat Surfaces (4.5.1).

A sphere stands for a cell between four neighbouring points. The paper draws it through the two ends of the longer
diagonal and one of the other two points; `sphere_of` does so and mends two faults of it. Where the diagonal's own
sphere already holds the other two points, that smaller one is taken, and where the points are nearly collinear or no
such circle holds the fourth point, the smallest sphere of the four. And in certified mode the radius grows by the sag
of the surface over the cell (`spline.bounds`), so that the sphere holds all of the surface between the points, not the
points alone. Level 0 of a patch is its knot spans, each with a sphere around the box of its own control points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit, njit_in_place, njit_inline_in_place
from ..spline.bounds import S_UU, S_UV, S_VV, span_bounds
from .workspace import Patch, canonical, make_points

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CONTAINS = 1.0 + 1e-9
"""A sphere holds a point that lies this close to it, relative to its radius: the four corners of a square are on a
circle."""

COLLINEAR = 1e-6
"""Sine squared of the angle under which three points count as collinear: their circle would be a thousand times the
cell."""


@njit_inline_in_place
def distance2(points: Array, a: int, b: int) -> float:
    """Squared distance of two points."""
    x, y, z = points[a, 0] - points[b, 0], points[a, 1] - points[b, 1], points[a, 2] - points[b, 2]
    return float(x * x + y * y + z * z)


@njit_in_place
def circle(points: Array, a: int, b: int, c: int, out: Array) -> bool:
    """Centre of the circle through three points into out[0:3], its squared radius into out[3]; False when collinear."""
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    u2, v2, n2 = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, nx * nx + ny * ny + nz * nz
    if not n2 > COLLINEAR * u2 * v2:
        return False
    # centre - a = (v2 n x u - u2 n x v) / (2 n2)
    x = v2 * (ny * uz - nz * uy) - u2 * (ny * vz - nz * vy)
    y = v2 * (nz * ux - nx * uz) - u2 * (nz * vx - nx * vz)
    z = v2 * (nx * uy - ny * ux) - u2 * (nx * vy - ny * vx)
    x, y, z = 0.5 * x / n2, 0.5 * y / n2, 0.5 * z / n2
    out[0], out[1], out[2] = points[a, 0] + x, points[a, 1] + y, points[a, 2] + z
    out[3] = x * x + y * y + z * z
    return True


@njit_inline_in_place
def away2(points: Array, a: int, centre: Array) -> float:
    """Squared distance of a point from a centre."""
    x, y, z = points[a, 0] - centre[0], points[a, 1] - centre[1], points[a, 2] - centre[2]
    return float(x * x + y * y + z * z)


@njit_in_place
def smallest_sphere(points: Array, ids: Index, out: Array, trial: Array) -> None:
    """The smallest sphere that holds four points: of two, three or four of them. Centre and squared radius into out
    (4,)."""
    best = np.inf
    for i in range(4):
        for j in range(i + 1, 4):
            for k in range(j, 4):
                # two points (k == j) span a diameter, three a circle
                if k == j:
                    for c in range(3):
                        trial[c] = 0.5 * (points[ids[i], c] + points[ids[j], c])
                    trial[3] = 0.25 * distance2(points, ids[i], ids[j])
                elif not circle(points, ids[i], ids[j], ids[k], trial):
                    continue
                holds = trial[3] < best
                for m in range(4):
                    holds = holds and away2(points, ids[m], trial) <= CONTAINS * trial[3]
                if holds:
                    best = trial[3]
                    for c in range(4):
                        out[c] = trial[c]
    if best < np.inf:
        return
    # all four on the sphere, or a rounding of it: the mean point serves, and cannot fail
    for c in range(3):
        out[c] = 0.25 * (points[ids[0], c] + points[ids[1], c] + points[ids[2], c] + points[ids[3], c])


@njit_in_place
def paper_sphere(points: Array, ids: Index, held: bool, out: Array, trial: Array) -> None:
    """The circle through the longer diagonal's ends and the one of the other two points whose circle holds the last.

    ids: diagonal, diagonal, other, other. Where there is none, `out` stays if it is already `held` (the diagonal's own
    sphere), else it becomes the smallest sphere.
    """
    for k in range(2):
        if circle(points, ids[0], ids[1], ids[2 + k], trial) and (
            away2(points, ids[3 - k], trial) <= CONTAINS * trial[3]
        ):
            for c in range(4):
                out[c] = trial[c]
            return
    if not held:
        smallest_sphere(points, ids, out, trial)


@njit_in_place
def sphere_of(points: Array, p00: int, p10: int, p01: int, p11: int, paper: bool, ids: Index, out: Array) -> None:
    """The sphere of four neighbouring points: centre into out[0:3], radius into out[3]. ids (4,), out[4:8] :
    scratch."""
    first, second = distance2(points, p00, p11), distance2(points, p10, p01)
    ids[0], ids[1], ids[2], ids[3] = (p00, p11, p10, p01) if first >= second else (p10, p01, p00, p11)
    for k in range(3):
        out[k] = 0.5 * (points[ids[0], k] + points[ids[1], k])
    limit = CONTAINS * 0.25 * max(first, second)
    held = away2(points, ids[2], out) <= limit and away2(points, ids[3], out) <= limit
    if paper or not held:
        paper_sphere(points, ids, held, out[0:4], out[4:8])
    radius2 = 0.0
    for k in range(4):
        radius2 = max(radius2, away2(points, ids[k], out))
    out[3] = np.sqrt(radius2)


@njit
def make_spheres(g: Patch, cells: Index, count: int) -> tuple[Array, Array]:
    """The spheres of `fill_spheres`: their centres (count, 3) and radii (count,)."""
    fill_spheres(g, cells, count)
    spheres, offset, tally = g.spheres, g.offset, g.tally
    centre, size = np.empty((count, 3)), np.empty(count)
    for t in range(count):
        at = offset[cells[t, 0]] + cells[t, 1] * tally[cells[t, 0], 1] + cells[t, 2]
        for c in range(3):
            centre[t, c] = spheres[at, c]
        size[t] = spheres[at, 3]
    return centre, size


@njit_in_place
def fill_spheres(g: Patch, cells: Index, count: int) -> None:
    """Spheres of cells[:count] (level, ku, kv), each made once per net.

    g.spheres: centre, radius, and in column 4 what refinement is worth: certified mode, the sag of the cell's two
    triangles; paper mode, 0 where the normals of the points that refinement would make agree within delta (4.5.1,
    "comparing the normals of the points generated"), else infinite; -1 where nothing is left to refine. Column 5 is
    that sag (0 in paper mode).
    """
    tick, paper, slack, m, n = g.tick, g.paper, g.slack, len(g.u), len(g.v)
    spheres, stamp, offset, tally, box = g.spheres, g.sphere_stamp, g.offset, g.tally, g.box
    row_u, row_v, points, u, v = g.row_u, g.row_v, g.points, g.u, g.v
    bounds, bounds_stamp, span_u, span_v = g.bounds, g.bounds_stamp, g.span_u, g.span_v
    wrap_u, wrap_v, poles, last = g.wrap_u, g.wrap_v, g.poles, len(offset) - 2
    # corners of the cells to be made, and which these are
    names, wanted, ids, scratch = g.corners, g.wanted, g.ids, g.work[0]
    made = 0
    for t in range(count):
        level, ku, kv = cells[t, 0], cells[t, 1], cells[t, 2]
        at = offset[level] + ku * tally[level, 1] + kv
        if stamp[at] == tick:
            continue
        stamp[at] = tick
        if level == 0:
            radius2 = 0.0
            for c in range(3):
                spheres[at, c] = 0.5 * (box[at, c] + box[at, 3 + c])
                h = 0.5 * (box[at, 3 + c] - box[at, c])
                radius2 += h * h
            spheres[at, 3] = np.sqrt(radius2) + slack
            spheres[at, 4] = np.inf
            continue
        i0, i1 = row_u[level, ku], row_u[level, ku + 1]
        j0, j1 = row_v[level, kv], row_v[level, kv + 1]
        for c in range(4):
            i, j = i1 if c & 1 else i0, j1 if c & 2 else j0
            names[4 * made + c] = canonical(i, j, m, n, wrap_u, wrap_v, poles)
        wanted[made] = t
        made += 1
    if made == 0:
        return
    make_points(g, names, 4 * made)
    for k in range(made):
        level, ku, kv = cells[wanted[k], 0], cells[wanted[k], 1], cells[wanted[k], 2]
        at = offset[level] + ku * tally[level, 1] + kv
        sphere_of(points, names[4 * k], names[4 * k + 1], names[4 * k + 2], names[4 * k + 3], paper, ids, scratch)
        i0, i1 = row_u[level, ku], row_u[level, ku + 1]
        j0, j1 = row_v[level, kv], row_v[level, kv + 1]
        radius, worth, bulge = scratch[3], 0.0, 0.0
        finest = level == last or (i1 - i0 == 1 and j1 - j0 == 1)
        if not paper:
            a, b = span_u[i0], span_v[j0]
            if bounds_stamp[a, b] != tick:
                bounds_stamp[a, b] = tick
                span_bounds(
                    g.net, g.knots_u, g.knots_v, g.degree_u, g.degree_v, g.first_u[i0], g.first_v[j0], g.rational,
                    bounds[a, b],
                )  # fmt: skip
            hu, hv = u[i1] - u[i0], v[j1] - v[j0]
            sag = (hu * hu * bounds[a, b, S_UU] + hv * hv * bounds[a, b, S_VV]) / 8.0
            bulge = sag + hu * hv * bounds[a, b, S_UV] / 4.0
            worth = bulge
            radius += sag + slack
        for c in range(3):
            spheres[at, c] = scratch[c]
        if paper and not finest:
            worth = 0.0 if normals_agree(g, level, ku, kv) else np.inf
        spheres[at, 3] = radius
        spheres[at, 4] = -1.0 if finest else worth
        spheres[at, 5] = bulge
    g.counters[3] += made


@njit_in_place
def normals_agree(g: Patch, level: int, ku: int, kv: int) -> bool:
    """The normals at the points that the next level would make, and at the corners, agree within delta (paper
    4.5.1)."""
    finer = min(level + 1, len(g.offset) - 2)
    k0, k1, l0, l1 = ku, ku + 1, kv, kv + 1
    if finer > level:
        k0, k1 = g.child_u[level, ku], g.child_u[level, ku + 1]
        l0, l1 = g.child_v[level, kv], g.child_v[level, kv + 1]
    least = np.cos(g.delta)
    t = g.work[2:]
    x0, y0, z0 = 0.0, 0.0, 0.0
    for k in range(k0, k1 + 1):
        for l in range(l0, l1 + 1):
            i, j = g.row_u[finer, k], g.row_v[finer, l]
            grid_tangents(g.net, g.rows_u, g.rows_v, g.first_u, g.first_v, i, j, t)
            x = t[1, 1] * t[2, 2] - t[1, 2] * t[2, 1]
            y = t[1, 2] * t[2, 0] - t[1, 0] * t[2, 2]
            z = t[1, 0] * t[2, 1] - t[1, 1] * t[2, 0]
            length = np.sqrt(x * x + y * y + z * z)
            if not length > 0.0:
                return False  # a pole has no normal
            x, y, z = x / length, y / length, z / length
            if k == k0 and l == l0:
                x0, y0, z0 = x, y, z
            if not x * x0 + y * y0 + z * z0 >= least:
                return False
    return True


@njit_in_place
def grid_tangents(
    net: Array, rows_u: Array, rows_v: Array, first_u: Index, first_v: Index, i: int, j: int, t: Array
) -> None:
    """w S, and up to the factor 1 / w the tangents S_u, S_v at a grid vertex by the tangent matrices (4.2), into t (3,
    4)."""
    for k in range(3):
        for c in range(4):
            t[k, c] = 0.0
    for a in range(rows_u.shape[2]):
        for b in range(rows_v.shape[2]):
            f = rows_u[0, i, a] * rows_v[0, j, b]
            fu = rows_u[1, i, a] * rows_v[0, j, b]
            fv = rows_u[0, i, a] * rows_v[1, j, b]
            for c in range(4):
                p = net[first_u[i] + a, first_v[j] + b, c]
                t[0, c] += f * p
                t[1, c] += fu * p
                t[2, c] += fv * p
    for k in range(1, 3):
        for c in range(3):
            t[k, c] -= t[k, 3] / t[0, 3] * t[0, c]
