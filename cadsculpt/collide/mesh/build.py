"""The bounding tree of a triangle mesh, split by the surface area heuristic over sixteen bins.

Source: I. Wald, "On fast construction of SAH-based bounding volume hierarchies", IEEE Symposium on Interactive Ray Tracing
(2007).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...jit import njit, njit_inline
from .tree import DEEPEST, frame_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LEAF = 4
"""Triangles in a leaf, at most."""

BINS = 16


@njit
def build(
    vertices: Array, triangles: Index, order: Index, box: Array, child: Index, frame: Array, corner: Index
) -> int:
    """Fill a tree over triangles (f, 3): order (f,) becomes the triangles in the leaves' order. Returns the number of nodes.

    box (m, 12) and child (m, 2) need room for max(1, f - 1) nodes.
    """
    f = len(triangles)
    bounds = np.empty((f, 6))
    for t in range(f):
        order[t] = t
        for c in range(3):
            x, y, z = vertices[triangles[t, 0], c], vertices[triangles[t, 1], c], vertices[triangles[t, 2], c]
            bounds[t, c], bounds[t, 3 + c] = min(x, y, z), max(x, y, z)
    stack = np.empty((2 * DEEPEST + 256, 5), np.int64)
    push(stack, 0, 0, f, 0, -1, 0)
    top, nodes = 1, 0
    count = np.empty(BINS, np.int64)
    bins = np.empty((BINS, 6))
    right = np.empty(BINS)
    whole, middle = np.empty(6), np.empty(6)
    while top > 0:
        top -= 1
        start, end, depth = stack[top, 0], stack[top, 1], stack[top, 2]
        parent, side = stack[top, 3], stack[top, 4]
        for c in range(3):
            whole[c], whole[3 + c], middle[c], middle[3 + c] = np.inf, -np.inf, np.inf, -np.inf
        for k in range(start, end):
            t = order[k]
            for c in range(3):
                m = 0.5 * (bounds[t, c] + bounds[t, 3 + c])
                whole[c], whole[3 + c] = min(whole[c], bounds[t, c]), max(whole[3 + c], bounds[t, 3 + c])
                middle[c], middle[3 + c] = min(middle[c], m), max(middle[3 + c], m)
        if parent >= 0:
            for c in range(6):
                box[parent, 6 * side + c] = whole[c]
        if end - start <= LEAF:
            if parent < 0:
                parent, nodes = 0, 1
                for c in range(6):
                    box[0, c] = whole[c]
                    box[0, 6 + c] = np.inf if c < 3 else -np.inf
                child[0, 1] = -1
            child[parent, side] = -1 - (8 * start + end - start)
            continue
        node = nodes
        nodes += 1
        if parent >= 0:
            child[parent, side] = node
        axis = 0
        for c in range(1, 3):
            if middle[3 + c] - middle[c] > middle[3 + axis] - middle[axis]:
                axis = c
        extent = middle[3 + axis] - middle[axis]
        split = (start + end) // 2
        if extent > 0.0 and depth < DEEPEST:
            scale, low = BINS / extent, middle[axis]
            cut = best_cut(order, start, end, bounds, axis, low, scale, count, bins, right)
            i, j = start, end - 1
            while i <= j:
                t = order[i]
                if bin_of(0.5 * (bounds[t, axis] + bounds[t, 3 + axis]), low, scale) < cut:
                    i += 1
                else:
                    order[i], order[j] = order[j], t
                    j -= 1
            if start < i < end:
                split = i
        push(stack, top, split, end, depth + 1, node, 1)
        push(stack, top + 1, start, split, depth + 1, node, 0)
        top += 2
    for k in range(f):
        t = order[k]
        i, j, m = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        first = frame_of(vertices, i, j, m, frame[k])
        for s in range(3):
            corner[k, s] = triangles[t, (first + s) % 3]
    return nodes


@njit
def push(stack: Index, top: int, start: int, end: int, depth: int, parent: int, side: int) -> None:
    """A range of triangles to be split, and the node's child that it is."""
    stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3], stack[top, 4] = start, end, depth, parent, side


@njit_inline
def bin_of(x: float, low: float, scale: float) -> int:
    """The bin of a coordinate."""
    return min(int((x - low) * scale), BINS - 1)


@njit
def best_cut(
    order: Index,
    start: int,
    end: int,
    bounds: Array,
    axis: int,
    low: float,
    scale: float,
    count: Index,
    bins: Array,
    right: Array,
) -> int:
    """The first bin of the right part, by the least sum of area times number."""
    for b in range(BINS):
        count[b] = 0
        for c in range(3):
            bins[b, c], bins[b, 3 + c] = np.inf, -np.inf
    for k in range(start, end):
        t = order[k]
        b = bin_of(0.5 * (bounds[t, axis] + bounds[t, 3 + axis]), low, scale)
        count[b] += 1
        for c in range(3):
            bins[b, c], bins[b, 3 + c] = min(bins[b, c], bounds[t, c]), max(bins[b, 3 + c], bounds[t, 3 + c])
    part = np.empty(6)
    for direction in range(2):
        number = 0
        for c in range(3):
            part[c], part[3 + c] = np.inf, -np.inf
        best, cut = np.inf, 1
        for s in range(BINS - 1):
            b = s if direction == 1 else BINS - 1 - s
            number += count[b]
            for c in range(3):
                part[c], part[3 + c] = min(part[c], bins[b, c]), max(part[3 + c], bins[b, 3 + c])
            x, y, z = max(part[3] - part[0], 0.0), max(part[4] - part[1], 0.0), max(part[5] - part[2], 0.0)
            cost = number * (x * y + y * z + z * x)
            if direction == 0:
                right[b] = cost
            elif cost + right[b + 1] < best and 0 < number < end - start:
                best, cut = cost + right[b + 1], b + 1
    return cut
