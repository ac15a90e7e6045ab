"""Triangle-Triangle Intersection Test (paper section 4.7), with exact signs.

The paper uses a test similar to Guigue and Devillers' ("Fast and robust triangle-triangle overlap test using orientation
predicates", Graphics Tools 8(1), 2003) and says that it cannot tackle degenerate cases. This one asks the same kind of
question, signs of `orient3d` on the given vertices alone, but decides from a table of fifteen signs that is symmetric in
the two triangles, so that swapping them or turning their vertices cannot change the answer:

    s1[i] = orient3d(q0, q1, q2, p_i)    s2[j] = orient3d(p0, p1, p2, q_j)    e[i, j] = orient3d(p_i, p_i+1, q_j, q_j+1)

Two triangles in different planes meet in an interval of the line that the planes share; its ends are points where an edge
of one goes through the plane of the other, and whether such a point lies in the other triangle is read off a row (or
column) of e.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import GeometryError
from ..jit import njit, njit_inline
from .predicates import orient2d, orient3d

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

WORK = 32
"""Length of the scratch array that `tri_tri` wants."""


def triangle_relation(p: ArrayLike, q: ArrayLike) -> tuple[Relation, Array | None]:
    """How the triangles p and q, (3, 3) each, lie to each other, and the segment (2, 3) in which they meet.

    The segment is None when they are disjoint or lie in one plane; its two ends are equal when they meet in a point.
    A triangle without area (a segment or a point) can touch, but neither cross nor overlap. Raises GeometryError for
    coordinates that are not finite.
    """
    a, b = np.array(p, dtype=np.float64), np.array(q, dtype=np.float64)
    if a.shape != (3, 3) or b.shape != (3, 3) or not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise GeometryError("a triangle needs three finite points", where="triangle test")
    segment = np.empty((2, 3))
    relation = Relation(tri_tri(a, b, segment, np.empty(WORK)))
    return relation, None if np.isnan(segment[0, 0]) else segment


@njit
def tri_tri(p: Array, q: Array, segment: Array, work: Array) -> int:
    """The relation of the triangles p and q (3, 3); `segment` (2, 3) takes the common segment, or NaN where there is none.

    work (WORK,) is scratch.
    """
    segment[:] = np.nan
    s1, s2, e = work[0:3], work[3:6], work[6:15]
    plane_signs(q, p, s1)
    if one_sided(s1):
        return DISJOINT
    plane_signs(p, q, s2)
    if one_sided(s2):
        return DISJOINT
    for k in range(9):
        i, j = k // 3, k % 3
        e[k] = side(p, i, p, (i + 1) % 3, q, j, q, (j + 1) % 3)
    coplanar = True
    for k in range(6):
        coplanar = coplanar and work[k] == 0.0
    if coplanar:
        for k in range(9):
            if e[k] != 0.0:
                return DISJOINT  # two triangles without area, on lines that pass each other
        return flat_relation(p, q)
    # the ends of each triangle's interval on the common line, those that lie in the other triangle
    first, first_strict = interval_ends(p, s1, e, 3, 1, work[15:21])
    second, second_strict = interval_ends(q, s2, e, 1, 3, work[21:27])
    if first + second == 0:
        return DISJOINT
    first_ends, second_ends = work[15:21], work[21:27]
    for k in range(3):
        if first == 2:
            segment[0, k], segment[1, k] = first_ends[k], first_ends[3 + k]
        elif second == 2:
            segment[0, k], segment[1, k] = second_ends[k], second_ends[3 + k]
        else:
            segment[0, k] = first_ends[k] if first > 0 else second_ends[k]
            segment[1, k] = second_ends[k] if second > 0 else first_ends[k]
    if not (mixed(s1[0], s1[1], s1[2]) and mixed(s2[0], s2[1], s2[2])):
        return TOUCHING
    if first == 1 and second == 1 and not first_strict and not second_strict:
        for k in range(3):  # one point, an end of both intervals
            segment[1, k] = segment[0, k]
        return TOUCHING
    return CROSSING


@njit_inline
def side(a: Array, i: int, b: Array, j: int, c: Array, k: int, d: Array, m: int) -> float:
    """orient3d of the vertices a[i], b[j], c[k], d[m]: the one place where the test asks for a sign in space."""
    return orient3d(
        a[i, 0], a[i, 1], a[i, 2], b[j, 0], b[j, 1], b[j, 2], c[k, 0], c[k, 1], c[k, 2], d[m, 0], d[m, 1], d[m, 2]
    )


@njit
def plane_signs(p: Array, q: Array, s: Array) -> None:
    """s[i] = orient3d(p0, p1, p2, q_i)."""
    for i in range(len(s)):
        s[i] = side(p, 0, p, 1, p, 2, q, i)


@njit
def one_sided(s: Array) -> bool:
    """All three signs are strictly the same."""
    return (s[0] > 0.0 and s[1] > 0.0 and s[2] > 0.0) or (s[0] < 0.0 and s[1] < 0.0 and s[2] < 0.0)


@njit_inline
def mixed(x: float, y: float, z: float) -> bool:
    """Two of the three signs are strictly opposite."""
    return (x < 0.0 or y < 0.0 or z < 0.0) and (x > 0.0 or y > 0.0 or z > 0.0)


@njit
def interval_ends(p: Array, s: Array, e: Array, edge: int, other: int, ends: Array) -> tuple[int, bool]:
    """The points where the outline of p goes through the other triangle's plane and lies in the other triangle.

    s: signs of p's vertices against that plane. Row i of e, seen from p, is e[i edge + j other]. Returns how many points
    (0, 1, 2; each into `ends` (6,)) and whether one of them lies strictly inside.
    """
    count = 0
    strict = False
    for i in range(3):
        j = (i + 1) % 3
        h = (i + 2) % 3
        at_vertex = s[i] == 0.0
        if at_vertex and s[j] != 0.0:
            row = i
        elif at_vertex and s[h] != 0.0:
            row = h
        elif (s[i] < 0.0 and s[j] > 0.0) or (s[i] > 0.0 and s[j] < 0.0):
            row = i
        else:
            continue
        x, y, z = e[row * edge], e[row * edge + other], e[row * edge + 2 * other]
        if mixed(x, y, z):
            continue
        strict = strict or (x != 0.0 and y != 0.0 and z != 0.0)
        t = 0.0 if at_vertex else s[i] / (s[i] - s[j])
        for k in range(3):
            ends[3 * count + k] = p[i, k] + t * (p[j, k] - p[i, k])
        count += 1
        if count == 2:
            break
    return count, strict


@njit
def turn(a: Array, b: Array, c: Array, axis: int) -> float:
    """orient2d of a, b, c (3,) with the coordinate `axis` dropped."""
    x = (axis + 1) % 3
    y = (axis + 2) % 3
    return orient2d(a[x], a[y], b[x], b[y], c[x], c[y])


@njit
def area_sign(p: Array, axis: int) -> float:
    """Orientation of the triangle p (3, 3) with the coordinate `axis` dropped."""
    return turn(p[0], p[1], p[2], axis)


@njit
def flat_relation(p: Array, q: Array) -> int:
    """The relation of two triangles in one plane, with or without area: separating lines along their edges."""
    # a projection in which the plane (or, of two triangles without area, the plane that holds both) does not collapse
    axis = -1
    largest = 0.0
    for k in range(3):
        size = abs(area_sign(p, k)) + abs(area_sign(q, k))
        if size > largest:
            axis, largest = k, size
    if axis < 0:
        for k in range(3):
            for i in range(3):
                for j in range(3):
                    if turn(p[i], p[(i + 1) % 3], q[j], k) != 0.0 or turn(q[i], q[(i + 1) % 3], p[j], k) != 0.0:
                        axis = k
    if axis < 0:
        return collinear_relation(p, q)
    interiors_meet = area_sign(p, axis) != 0.0 and area_sign(q, axis) != 0.0
    for which in range(2):
        a, b = (p, q) if which == 0 else (q, p)
        for i in range(len(a)):
            own = turn(a[i], a[(i + 1) % 3], a[(i + 2) % 3], axis)
            left, right = 0, 0
            for j in range(3):
                place = turn(a[i], a[(i + 1) % 3], b[j], axis)
                left += place > 0.0
                right += place < 0.0
            if (own >= 0.0 and right == 3) or (own <= 0.0 and left == 3):
                return DISJOINT
            if (own > 0.0 and left == 0) or (own < 0.0 and right == 0):
                interiors_meet = False
    return COPLANAR_OVERLAP if interiors_meet else TOUCHING


@njit
def precedes(a: Array, b: Array) -> bool:
    """a comes before b in lexicographic order, the order along any line."""
    for k in range(3):
        if a[k] != b[k]:
            return bool(a[k] < b[k])
    return False


@njit
def collinear_relation(p: Array, q: Array) -> int:
    """Six points on one line: do the two stretches of three meet?"""
    p_low, p_high, q_low, q_high = 0, 0, 0, 0
    for i in range(1, 3):
        p_low = i if precedes(p[i], p[p_low]) else p_low
        p_high = i if precedes(p[p_high], p[i]) else p_high
        q_low = i if precedes(q[i], q[q_low]) else q_low
        q_high = i if precedes(q[q_high], q[i]) else q_high
    if precedes(p[p_high], q[q_low]) or precedes(q[q_high], p[p_low]):
        return DISJOINT
    return TOUCHING
