"""Continuous collision of linearly moving vertices, faces and edges: do they meet within a step, and when first.

Two stages, so that the answer is exact. First boxes of (t, u, v): the difference of the two points is linear in each of
the three, so over a box it lies in the hull of its eight corner values, and a box whose hull misses zero by more than
rounding holds no contact (Wang, Ferguson, Schneider, Jiang, Attene and Panozzo, "A large-scale benchmark and an
inclusion-based algorithm for continuous collision detection", ACM Trans. Graphics 40 (2021)). Where boxes alone do not
clear a query, the coplanarity polynomial of degree three is taken in integers: coordinates are binary fractions, its
roots are isolated, and signs at them say whether the feature is hit. Nothing is missed, and nothing that only comes near is
called a contact. Touching is a contact; features without extent (a face that is a segment or a point) are features too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import lcm

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import InputError
from ...jit import njit
from .algebraic import Polynomial, Root, add, multiply, roots

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Points = Sequence[Sequence[Fraction | int | float]]
Vector = list[Polynomial]

BOXES = 400
"""Boxes after which a query goes to the exact stage: clear ones need about ten."""

MARGIN = 64.0 * 2.0**-53
"""Rounding of a corner value relative to the largest coordinate. Points at t: three roundings each; their sum with weights
of at most 1 (sum of sizes at most 3): less than twenty in all."""

TINY = 1e-300
"""Absolute part of that margin: what underflow can hide."""

FINE = 60
"""Halvings of [0, 1] to which a time of impact is known: below the spacing of numbers near 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Impacts:
    """For n queries: hit (n,), and time (n,): a lower bound of the first contact within 2^-52, 1 being the step's end;
    infinite where there is none."""

    hit: Mask
    time: Array


def vertex_face(start: ArrayLike, end: ArrayLike) -> Impacts:
    """A vertex against a face: start, end (n, 4, 3) hold the vertex and the face's three, at the step's start and end.

    Raises InputError for another shape or a number that is not finite.
    """
    return _impacts(start, end, False)


def edge_edge(start: ArrayLike, end: ArrayLike) -> Impacts:
    """An edge against an edge: start, end (n, 4, 3) hold the ends of one and the ends of the other.

    Raises InputError for another shape or a number that is not finite.
    """
    return _impacts(start, end, True)


def _impacts(start: ArrayLike, end: ArrayLike, edges: bool) -> Impacts:
    both = []
    for value in (start, end):
        points = np.array(value, dtype=np.float64)
        if points.ndim == 2:
            points = points[None]
        if points.ndim != 3 or points.shape[1:] != (4, 3):
            raise InputError(f"points of shape {points.shape}", mend="continuous collision takes (n, 4, 3)")
        if not np.isfinite(points).all():
            raise InputError("a moving point is not finite")
        both.append(points)
    if len(both[0]) != len(both[1]):
        raise InputError(f"{len(both[0])} queries at the start of the step and {len(both[1])} at its end")
    hit, time = np.zeros(len(both[0]), np.bool_), np.full(len(both[0]), np.inf)
    may_meet(both[0], both[1], edges, hit)
    for k in np.flatnonzero(hit):
        found = exact_time(both[0][k].tolist(), both[1][k].tolist(), edges=edges)
        hit[k] = found is not None
        if found is not None:
            time[k] = _rounded_down(found)
    return Impacts(hit, time)


def _rounded_down(time: Fraction) -> float:
    value = float(time)
    return value if value <= time else float(np.nextafter(value, -np.inf))


# ---------------------------------------------------------------- boxes


@njit
def may_meet(start: Array, end: Array, edges: bool, out: Mask) -> None:
    """out (n,): False where boxes prove that a query of start, end (n, 4, 3) has no contact."""
    # a box: lower corner and number of halvings in t, u, v
    stack = np.empty((3 * 64 + BOXES, 6))
    at, value = np.empty((2, 4, 3)), np.empty(8)
    low, high = np.empty(3), np.empty(3)
    for k in range(len(start)):
        margin = 0.0
        for i in range(4):
            for c in range(3):
                margin = max(margin, abs(start[k, i, c]), abs(end[k, i, c]))
        margin = MARGIN * margin + TINY
        stack[0, :] = 0.0
        height, boxes, undecided = 1, 0, False
        while height > 0 and not undecided:
            height -= 1
            boxes += 1
            for c in range(3):
                low[c] = stack[height, c]
                high[c] = low[c] + 0.5 ** stack[height, 3 + c]
            for e in range(2):
                t = low[0] if e == 0 else high[0]
                for i in range(4):
                    for c in range(3):
                        at[e, i, c] = (1.0 - t) * start[k, i, c] + t * end[k, i, c]
            clear = False
            spread_t, spread_u, spread_v = 0.0, 0.0, 0.0
            for c in range(3):
                least, most = np.inf, -np.inf
                for e in range(8):
                    u = low[1] if e & 2 == 0 else high[1]
                    v = low[2] if e & 4 == 0 else high[2]
                    p = at[e & 1]
                    if edges:
                        x = (1.0 - u) * p[0, c] + u * p[1, c] - ((1.0 - v) * p[2, c] + v * p[3, c])
                    else:
                        x = p[0, c] - ((1.0 - u - v) * p[1, c] + u * p[2, c] + v * p[3, c])
                    value[e] = x
                    least, most = min(least, x), max(most, x)
                if least > margin or most < -margin:
                    clear = True
                    break
                for e in range(8):
                    if e & 1 == 0:
                        spread_t = max(spread_t, abs(value[e | 1] - value[e]))
                    if e & 2 == 0:
                        spread_u = max(spread_u, abs(value[e | 2] - value[e]))
                    if e & 4 == 0:
                        spread_v = max(spread_v, abs(value[e | 4] - value[e]))
            if clear:
                continue
            widest = max(spread_t, spread_u, spread_v)
            # with less than this between its corners a box is all rounding; with it, never more than 50 halvings
            if not widest > 4.0 * margin or boxes >= BOXES:
                undecided = True
                continue
            axis = 0 if widest == spread_t else (1 if widest == spread_u else 2)
            if stack[height, 3 + axis] >= 50.0:
                undecided = True
                continue
            stack[height, 3 + axis] += 1.0
            for c in range(6):
                stack[height + 1, c] = stack[height, c]
            stack[height + 1, axis] += 0.5 ** stack[height, 3 + axis]
            # beyond u + v = 1 there is no face
            height += 1 if not edges and stack[height + 1, 1] + stack[height + 1, 2] > 1.0 else 2
        out[k] = undecided


# ---------------------------------------------------------------- exact


def exact_time(start: Points, end: Points, *, edges: bool) -> Fraction | None:
    """The first contact of one query in rational numbers: exact, or below it by less than 2^-60; None without one.

    start, end : four points each, of Fractions, integers or floats, which are taken as they are.
    """
    points = _moving(start, end)
    plane, meets, others = (_edges_meet if edges else _on_face)(points)
    if plane:
        candidates = roots(plane)  # whatever meets is coplanar
    else:
        # always in one plane: meeting begins with the step, or where the sign of one of the conditions changes
        candidates = [Root([0, 1], 0, 0, True, [])]
        candidates += [root for p in others if p for root in roots(p)]
    first = None
    for root in candidates:
        if first is not None and root.low > first:
            continue
        if meets(root.sign):
            while not root.exact and root.depth < FINE:
                root.refine()
            first = root.low if first is None else min(first, root.low)
            if plane:
                break
    return first


Condition = tuple[Polynomial, Callable[[Callable[[Polynomial], int]], bool], list[Polynomial]]


def _on_face(points: list[Vector]) -> Condition:
    """The coplanarity of a vertex with a face; whether it is on it, given signs at a time at which that vanishes; the
    other polynomials on whose signs this depends."""
    p, a, b, c = points
    normal = _cross(_difference(b, a), _difference(c, a))
    turns = [_cross(_difference(y, x), _difference(p, x)) for x, y in ((a, b), (b, c), (c, a))]
    segments = [_on_segment(p, x, y) for x, y in ((a, b), (b, c), (c, a))]

    def meets(sign: Callable[[Polynomial], int]) -> bool:
        for axis in range(3):
            side = sign(normal[axis])
            if side:
                return all(sign(turn[axis]) * side >= 0 for turn in turns)
        return any(_holds(segment, sign) for segment in segments)

    others = normal + [x for turn in turns for x in turn] + [x for segment in segments for x in segment]
    return _dot(_difference(p, a), normal), meets, others


def _edges_meet(points: list[Vector]) -> Condition:
    """The same of two edges."""
    a, b, c, d = points
    normal = _cross(_difference(b, a), _difference(d, c))
    # the ends of each seen from the other's line
    turns = [
        [_cross(_difference(y, x), _difference(end, x)) for end in ends]
        for (x, y), ends in (((a, b), (c, d)), ((c, d), (a, b)))
    ]
    segments = [_on_segment(*three) for three in ((a, c, d), (b, c, d), (c, a, b), (d, a, b))]

    def meets(sign: Callable[[Polynomial], int]) -> bool:
        for axis in range(3):
            if sign(normal[axis]):
                return all(sign(one[axis]) * sign(two[axis]) <= 0 for one, two in turns)
        return any(_holds(segment, sign) for segment in segments)

    others = normal + [x for pair in turns for turn in pair for x in turn] + [x for s in segments for x in s]
    return _dot(_difference(c, a), normal), meets, others


def _on_segment(p: Vector, a: Vector, b: Vector) -> list[Polynomial]:
    """Three polynomials that vanish where p, a, b are collinear, and one that is then not positive where p is between."""
    return [*_cross(_difference(p, a), _difference(b, a)), _dot(_difference(p, a), _difference(p, b))]


def _holds(segment: list[Polynomial], sign: Callable[[Polynomial], int]) -> bool:
    return all(sign(x) == 0 for x in segment[:3]) and sign(segment[3]) <= 0


def _moving(start: Points, end: Points) -> list[Vector]:
    """The points as vectors of polynomials of degree one in t, in integers, relative to the first one at the start."""
    exact = [[[Fraction(x) for x in point] for point in points] for points in (start, end)]
    origin = exact[0][0]
    # near each other, their differences are short integers
    exact = [[[x - o for x, o in zip(p, origin, strict=True)] for p in points] for points in exact]
    scale = lcm(*(x.denominator for points in exact for p in points for x in p))
    first, last = ([[int(x * scale) for x in p] for p in points] for points in exact)
    return [
        [add([x], [0, y - x]) for x, y in zip(p, q, strict=True)]  # x + (y - x) t
        for p, q in zip(first, last, strict=True)
    ]


def _difference(a: Vector, b: Vector) -> Vector:
    return [add(x, y, -1) for x, y in zip(a, b, strict=True)]


def _cross(a: Vector, b: Vector) -> Vector:
    return [add(multiply(a[i - 2], b[i - 1]), multiply(a[i - 1], b[i - 2]), -1) for i in range(3)]


def _dot(a: Vector, b: Vector) -> Polynomial:
    return add(add(multiply(a[0], b[0]), multiply(a[1], b[1])), multiply(a[2], b[2]))
