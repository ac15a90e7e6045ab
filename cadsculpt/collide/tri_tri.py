"""Triangle-Triangle Intersection Test (paper section 4.7), with exact signs.

The paper uses a test similar to Guigue and Devillers' ("Fast and robust triangle-triangle overlap test using
orientation predicates", Graphics Tools 8(1), 2003) and says that it cannot tackle degenerate cases. This one asks the
same kind of question, signs of `orient3d` on the given vertices alone, but decides from a table of fifteen signs that
is symmetric in the two triangles, so that swapping them or turning their vertices cannot change the answer:

    s1[i] = orient3d(q0, q1, q2, p_i)    s2[j] = orient3d(p0, p1, p2, q_j)    e[i, j] = orient3d(p_i, p_i+1, q_j, q_j+1)

Two triangles in different planes meet in an interval of the line that the planes share; its ends are points where an
edge of one goes through the plane of the other, and whether such a point lies in the other triangle is read off a row
(or column) of e.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import GeometryError
from ..jit import njit, njit_inline
from .predicates import orient2d, orient3d, orient3d_exact

Array = NDArray[np.float64]


class Relation(IntEnum):
    """How two closed triangles lie to each other."""

    DISJOINT = 0
    """No common point."""
    TOUCHING = 1
    """Common points, but no interior of one meets the interior of the other: a vertex or an edge on the other."""
    CROSSING = 2
    """In different planes, and their interiors meet, in a segment."""
    COPLANAR_OVERLAP = 3
    """In one plane, and their interiors meet, in an area."""


DISJOINT, TOUCHING, CROSSING, COPLANAR_OVERLAP = (int(r) for r in Relation)

FLAT = 1e-4
"""Heights of an edge's ends over the other plane, times that triangle's extent, that differ by less than this part of the
pair's extent cubed leave the place between them to expansions: a height from the filter has its sign, but need not have
one right digit."""

WORK = 27
"""Length of the scratch array that `tri_tri` wants."""

PLANE_ROUNDING = 64 * 2.0**-53
"""Bound on the error of n . (p - q), n = e1 x e2, relative to max(|e1|, |e2|)^2 |p - q|_1: a few dozen roundings."""


def triangle_relation(p: ArrayLike, q: ArrayLike) -> tuple[Relation, Array | None]:
    """How the triangles p and q, (3, 3) each, lie to each other, and the segment (2, 3) in which they meet.

    The segment is None when they are disjoint or lie in one plane; its two ends are equal when they meet in a point.
    A triangle without area (a segment or a point) can touch, but neither cross nor overlap. Raises GeometryError for
    coordinates that are not finite.
    """
    a, b = np.array(p, dtype=np.float64), np.array(q, dtype=np.float64)
    if a.shape != (3, 3) or b.shape != (3, 3) or not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise GeometryError("a triangle needs three finite points", where="triangle test")
    segment = np.empty(6)
    relation = Relation(tri_tri(np.concatenate([a, b]), segment, np.empty(WORK)))
    return relation, None if np.isnan(segment[0]) else segment.reshape(2, 3)


@njit
def tri_tri(t: Array, segment: Array, work: Array) -> int:
    """The relation of the triangles p = t[0:3] and q = t[3:6], t (6, 3); `segment` (6,) takes the two ends of the
    common segment, or NaN where there is none.

    work (WORK,) is scratch: s1 (3,), s2 (3,), e (9,), and the ends that lie in the other triangle, of p (6,) and of q
    (6,).
    """
    for k in range(6):
        segment[k] = np.nan
    for k in range(15):
        if k < 3:
            work[k] = side(t, 3, 4, 5, k)
        elif k < 6:
            work[k] = side(t, 0, 1, 2, k)
        else:
            i, j = (k - 6) // 3, (k - 6) % 3
            work[k] = side(t, i, (i + 1) % 3, 3 + j, 3 + (j + 1) % 3)
        if (k == 2 or k == 5) and (
            (work[k - 2] > 0.0 and work[k - 1] > 0.0 and work[k] > 0.0)
            or (work[k - 2] < 0.0 and work[k - 1] < 0.0 and work[k] < 0.0)
        ):
            return DISJOINT
    coplanar, parallel = True, True
    for k in range(15):
        if work[k] != 0.0:
            coplanar = coplanar and k >= 6
            parallel = False
    if coplanar:
        # or two triangles without area, on lines that pass each other
        return flat_relation(t) if parallel else DISJOINT
    # the ends of each triangle's interval on the common line, those that lie in the other triangle
    first, first_strict = interval_ends(t, work, 0)
    second, second_strict = interval_ends(t, work, 1)
    if first + second == 0:
        return DISJOINT
    for k in range(3):
        if first == 2 or second == 0:
            segment[k], segment[3 + k] = work[15 + k], work[15 + 3 * (first - 1) + k]
        elif second == 2 or first == 0:
            segment[k], segment[3 + k] = work[21 + k], work[21 + 3 * (second - 1) + k]
        else:
            segment[k], segment[3 + k] = work[15 + k], work[21 + k]
    if not (mixed(work[0], work[1], work[2]) and mixed(work[3], work[4], work[5])):
        return TOUCHING
    if first == 1 and second == 1 and not first_strict and not second_strict:
        for k in range(3):  # one point, an end of both intervals
            segment[3 + k] = segment[k]
        return TOUCHING
    return CROSSING


@njit
def culled_tri_tri(t: Array, segment: Array, work: Array) -> int:
    """As `tri_tri`, but what their boxes or the plane of either part clearly never comes to the exact test; `segment`
    is left as it was then."""
    for x in range(3):
        if (
            max(t[0, x], t[1, x], t[2, x]) < min(t[3, x], t[4, x], t[5, x])
            or max(t[3, x], t[4, x], t[5, x]) < min(t[0, x], t[1, x], t[2, x])
        ):  # fmt: skip
            return DISJOINT
    if parted(t, 3, 0) or parted(t, 0, 3):
        return DISJOINT
    return tri_tri(t, segment, work)


@njit_inline
def parted(t: Array, p: int, q: int) -> bool:
    """All three rows of t from q on lie clearly, beyond rounding, on one side of the plane of the three from p on."""
    ux, uy, uz = t[p + 1, 0] - t[p, 0], t[p + 1, 1] - t[p, 1], t[p + 1, 2] - t[p, 2]
    vx, vy, vz = t[p + 2, 0] - t[p, 0], t[p + 2, 1] - t[p, 1], t[p + 2, 2] - t[p, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    rounding = PLANE_ROUNDING * max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz)
    above, below = 0, 0
    for k in range(3):
        x, y, z = t[q + k, 0] - t[p, 0], t[q + k, 1] - t[p, 1], t[q + k, 2] - t[p, 2]
        place, doubt = nx * x + ny * y + nz * z, rounding * (abs(x) + abs(y) + abs(z))
        above += place > doubt
        below += place < -doubt
    return above == 3 or below == 3


@njit_inline
def side(t: Array, a: int, b: int, c: int, d: int) -> float:
    """orient3d of the rows a, b, c, d of t: the one place where the test asks for a sign in space."""
    return orient3d(
        t[a, 0], t[a, 1], t[a, 2], t[b, 0], t[b, 1], t[b, 2], t[c, 0], t[c, 1], t[c, 2], t[d, 0], t[d, 1], t[d, 2]
    )


@njit_inline
def mixed(x: float, y: float, z: float) -> bool:
    """Two of the three signs are strictly opposite."""
    return (x < 0.0 or y < 0.0 or z < 0.0) and (x > 0.0 or y > 0.0 or z > 0.0)


@njit
def interval_ends(t: Array, work: Array, which: int) -> tuple[int, bool]:
    """The points where the outline of one triangle (0: p, 1: q) goes through the other's plane and lies in the other.

    Returns how many points (0, 1, 2; each into work[15:21] or work[21:27]) and whether one of them lies strictly
    inside.
    """
    s, o, r, ends = 3 * which, 3 * which, 3 - 3 * which, 15 + 6 * which
    # row i of e, seen from the triangle
    edge, other = (3, 1) if which == 0 else (1, 3)
    count = 0
    strict = False
    for i in range(3):
        j, h = (i + 1) % 3, (i + 2) % 3
        here, ahead, behind = work[s + i], work[s + j], work[s + h]
        if here == 0.0 and ahead != 0.0:
            row = i
        elif here == 0.0 and behind != 0.0:
            row = h
        elif (here < 0.0 and ahead > 0.0) or (here > 0.0 and ahead < 0.0):
            row = i
        else:
            continue
        k = 6 + row * edge
        x, y, z = work[k], work[k + other], work[k + 2 * other]
        if mixed(x, y, z) or count == 2:
            continue
        strict = strict or (x != 0.0 and y != 0.0 and z != 0.0)
        if here != 0.0 and abs(here - ahead) < FLAT * extent3(t):
            here, ahead = exact_side(t, r, o + i), exact_side(t, r, o + j)
        f = 0.0 if here == 0.0 else here / (here - ahead)
        for c in range(3):
            work[ends + 3 * count + c] = t[o + i, c] + f * (t[o + j, c] - t[o + i, c])
        count += 1
    return count, strict


@njit
def exact_side(t: Array, r: int, d: int) -> float:
    """`side` of the rows r, r + 1, r + 2 of t and the row d to all its digits."""
    return orient3d_exact(
        t[r, 0], t[r, 1], t[r, 2], t[r + 1, 0], t[r + 1, 1], t[r + 1, 2],
        t[r + 2, 0], t[r + 2, 1], t[r + 2, 2], t[d, 0], t[d, 1], t[d, 2],
    )  # fmt: skip


@njit
def extent3(t: Array) -> float:
    """The cube of the longest side of the box of all rows of t."""
    extent = 0.0
    for k in range(3):
        low, high = t[0, k], t[0, k]
        for i in range(1, len(t)):
            low, high = min(low, t[i, k]), max(high, t[i, k])
        extent = max(extent, high - low)
    return float(extent * extent * extent)


@njit
def turn(t: Array, a: int, b: int, c: int, axis: int) -> float:
    """orient2d of the rows a, b, c of t with the coordinate `axis` dropped."""
    x, y = (axis + 1) % 3, (axis + 2) % 3
    return orient2d(t[a, x], t[a, y], t[b, x], t[b, y], t[c, x], t[c, y])


@njit
def flat_relation(t: Array) -> int:
    """The relation of two triangles in one plane, with or without area: separating lines along their edges."""
    # a projection in which the plane (or, of two triangles without area, the plane that holds both) does not collapse
    axis = -1
    largest = 0.0
    for k in range(3):
        size = abs(turn(t, 0, 1, 2, k)) + abs(turn(t, 3, 4, 5, k))
        if size > largest:
            axis, largest = k, size
    for k in range(27):
        if axis < 0 and (
            turn(t, k % 3, (k + 1) % 3, 3 + k // 3 % 3, k // 9) != 0.0
            or turn(t, 3 + k % 3, 3 + (k + 1) % 3, k // 3 % 3, k // 9) != 0.0
        ):
            axis = k // 9
    if axis < 0:
        return collinear_relation(t)
    interiors_meet = turn(t, 0, 1, 2, axis) != 0.0 and turn(t, 3, 4, 5, axis) != 0.0
    for k in range(6):
        mine, its = k // 3 * 3, 3 - k // 3 * 3
        a, b = mine + k % 3, mine + (k + 1) % 3
        own = turn(t, a, b, mine + (k + 2) % 3, axis)
        left, right = 0, 0
        for j in range(3):
            place = turn(t, a, b, its + j, axis)
            left += place > 0.0
            right += place < 0.0
        if (own >= 0.0 and right == 3) or (own <= 0.0 and left == 3):
            return DISJOINT
        if (own > 0.0 and left == 0) or (own < 0.0 and right == 0):
            interiors_meet = False
    return COPLANAR_OVERLAP if interiors_meet else TOUCHING


@njit
def precedes(t: Array, a: int, b: int) -> bool:
    """Row a of t comes before row b in lexicographic order, the order along any line."""
    for k in range(3):
        if t[a, k] != t[b, k]:
            return bool(t[a, k] < t[b, k])
    return False


@njit
def collinear_relation(t: Array) -> int:
    """Six points on one line: do the two stretches of three meet?"""
    p_low, p_high, q_low, q_high = 0, 0, 3, 3
    for i in range(1, 3):
        p_low = i if precedes(t, i, p_low) else p_low
        p_high = i if precedes(t, p_high, i) else p_high
        q_low = 3 + i if precedes(t, 3 + i, q_low) else q_low
        q_high = 3 + i if precedes(t, q_high, 3 + i) else q_high
    return DISJOINT if precedes(t, p_high, q_low) or precedes(t, q_high, p_low) else TOUCHING
