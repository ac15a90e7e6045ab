"""The distance of two triangle meshes, open or closed: triangles have no sag, so that it is exact to rounding.

Both trees are descended together, from an upper bound that a few vertices give; a pair of boxes that is no nearer than what
is found is dropped, and what is left ends in pairs of triangles. It is the distance of the surfaces: of a mesh inside
another one too, which the sign of the outer one's distance tells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...jit import njit
from ..certified.interval import DistanceInterval, Goal, Search, Witness
from ..tri_tri import WORK
from .field import MeshField
from .tree import DEEPEST, ROUNDING, MeshTree
from .tri_distance import tri_distance2

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PROBES = 64
"""Vertices that give the first upper bound."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshDistance:
    """low, high : the true distance of the surfaces lies between; both 0 where they meet, which is decided exactly. points
    (2, 3) : one of each that have it. triangles (2,) : whose they are."""

    low: float
    high: float
    points: Array
    triangles: Index


def mesh_distance(a: MeshField, b: MeshField) -> MeshDistance:
    """The smallest distance of the surfaces of two meshes that stand in the same frame."""
    corners = np.linspace(0, len(a.mesh.vertices) - 1, min(PROBES, len(a.mesh.vertices))).astype(np.int64)
    bound = float(np.abs(b.distance(a.mesh.vertices[corners])).min())
    rounding = ROUNDING * float(
        a.tree.size + b.tree.size + np.abs(a.tree.centre).max() + np.abs(b.tree.centre).max() + bound
    )
    points, triangles = np.empty(6), np.zeros(2, np.int64)
    distance = float(np.sqrt(nearest_pair(a.tree, b.tree, (bound + rounding) ** 2, points, triangles)))
    low, high = (distance - rounding, distance + rounding) if distance > 0.0 else (0.0, 0.0)
    return MeshDistance(max(low, 0.0), high, points.reshape(2, 3), triangles)


def meshes_distance(a: MeshField, b: MeshField, goal: Goal) -> DistanceInterval:
    """The distance of the bodies of two meshes: a closed one is its inside too, an open one its triangles."""
    found, search = mesh_distance(a, b), Search(goal)
    search.lower_high(found.high, Witness(found.points[0]), Witness(found.points[1]))
    search.bound(found.low)
    if found.low > 0.0:
        for outer, inner in ((a, b), (b, a)):
            # every lump's vertices lie on one side
            low, high = outer.box()
            vertices = inner.mesh.vertices
            vertices = vertices[((vertices > low) & (vertices < high)).all(axis=1)] if outer.closed else vertices[:0]
            held = np.flatnonzero(outer.distance(vertices) < 0.0)
            if len(held):
                point = Witness(vertices[held[0]].copy())
                return DistanceInterval(0.0, 0.0, point, point, True, False, 0)
    return DistanceInterval(search.low, search.high, search.a, search.b, search.decided, False, 0)


@njit
def nearest_pair(a: MeshTree, b: MeshTree, bound: float, points: Array, triangles: Index) -> float:
    """The smallest squared distance of two meshes, given one above it; its points (6,) and triangles (2,)."""
    best = bound
    # a pair of children: node and side in both trees, and the distance of their boxes
    stack, gap = np.empty((4 * DEEPEST + 512, 4), np.int64), np.empty(4 * DEEPEST + 512)
    t, pair, work = np.empty((6, 3)), np.empty(6), np.empty(WORK + 6)
    top = 0
    for k in range(4):
        top = put(a, b, 0, k >> 1, 0, k & 1, best, stack, gap, top)
    while top > 0:
        top -= 1
        if gap[top] > best:
            continue
        na, sa, nb, sb = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        ca, cb = a.child[na, sa], b.child[nb, sb]
        if ca < 0 and cb < 0:
            start_a, count_a, start_b, count_b = (-1 - ca) >> 3, (-1 - ca) & 7, (-1 - cb) >> 3, (-1 - cb) & 7
            for i in range(start_a, start_a + count_a):
                for j in range(start_b, start_b + count_b):
                    for k in range(3):
                        for c in range(3):
                            t[k, c], t[3 + k, c] = a.vertices[a.corner[i, k], c], b.vertices[b.corner[j, k], c]
                    if corners_gap2(t) > best:
                        continue
                    d = tri_distance2(t, a.frame, i, b.frame, j, pair, work)
                    if d < best:
                        best = d
                        triangles[0], triangles[1] = a.name[i], b.name[j]
                        for c in range(6):
                            points[c] = pair[c]
                        if best == 0.0:
                            return best
        elif cb < 0 or (ca >= 0 and extent2(a.box, na, sa) >= extent2(b.box, nb, sb)):
            first = nearer(a, ca, b, nb, sb)
            top = put(a, b, ca, 1 - first, nb, sb, best, stack, gap, top)
            top = put(a, b, ca, first, nb, sb, best, stack, gap, top)
        else:
            first = nearer(b, cb, a, na, sa)
            top = put(a, b, na, sa, cb, 1 - first, best, stack, gap, top)
            top = put(a, b, na, sa, cb, first, best, stack, gap, top)
    return best


@njit
def put(
    a: MeshTree, b: MeshTree, na: int, sa: int, nb: int, sb: int, best: float, stack: Index, gap: Array, top: int
) -> int:
    """A pair of children onto the stack, where its boxes are no farther than the best distance."""
    d = boxes_gap2(a.box, na, sa, b.box, nb, sb)
    if d > best:
        return top
    stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3], gap[top] = na, sa, nb, sb, d
    return top + 1


@njit
def nearer(a: MeshTree, node: int, b: MeshTree, nb: int, sb: int) -> int:
    """Which of a node's children is nearer to a box."""
    left, right = boxes_gap2(a.box, node, 0, b.box, nb, sb), boxes_gap2(a.box, node, 1, b.box, nb, sb)
    if left == right:  # both reach in: the one with its middle nearer
        left, right = middles2(a.box, node, 0, b.box, nb, sb), middles2(a.box, node, 1, b.box, nb, sb)
    return 0 if left <= right else 1


@njit
def boxes_gap2(p: Array, i: int, s: int, q: Array, j: int, r: int) -> float:
    """Squared distance of two boxes."""
    d = 0.0
    for c in range(3):
        x = max(q[j, 6 * r + c] - p[i, 6 * s + 3 + c], p[i, 6 * s + c] - q[j, 6 * r + 3 + c], 0.0)
        d += x * x
    return d


@njit
def middles2(p: Array, i: int, s: int, q: Array, j: int, r: int) -> float:
    """Squared distance of the middles of two boxes, times four."""
    d = 0.0
    for c in range(3):
        x = q[j, 6 * r + c] + q[j, 6 * r + 3 + c] - p[i, 6 * s + c] - p[i, 6 * s + 3 + c]
        d += x * x
    return d


@njit
def extent2(p: Array, i: int, s: int) -> float:
    """Squared diagonal of a box."""
    d = 0.0
    for c in range(3):
        d += (p[i, 6 * s + 3 + c] - p[i, 6 * s + c]) ** 2
    return d


@njit
def corners_gap2(t: Array) -> float:
    """Squared distance of the boxes of the triangles t[0:3] and t[3:6]."""
    d = 0.0
    for c in range(3):
        x = max(
            min(t[3, c], t[4, c], t[5, c]) - max(t[0, c], t[1, c], t[2, c]),
            min(t[0, c], t[1, c], t[2, c]) - max(t[3, c], t[4, c], t[5, c]),
            0.0,
        )
        d += x * x
    return d
