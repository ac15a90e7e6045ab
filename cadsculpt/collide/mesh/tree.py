"""Nearest points of a triangle mesh, by a bounding tree of boxes over its triangles.

Each triangle is kept in a frame of its own (M. W. Jones, "3D distance from a point to a triangle", 1995): origin at one
end of its longest edge, x along that edge, y towards its third corner, z its normal. There a distance is one of a flat
problem and a height, and stays accurate for slivers of any shape. Both angles at the longest edge are acute, so that a
point below it is nearest to that edge.

The answer is the smallest of all triangles' computed distances, of equal ones that of the first triangle; boxes are
dropped with a margin for rounding only, so that neither the tree nor the order of the points has a say in it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...jit import njit, njit_inline
from ..predicates import minor_value

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DEEPEST = 40
"""Below this depth `build` halves a range as it stands: no tree is deeper than this and log2 of its triangles."""

ROUNDING = 2.0**-48
"""Error of a computed distance against the true one, relative to the farthest coordinate from the point."""

FARTHEST = 1e70
"""The fourth power of a coordinate up to this is finite."""

FACE, AB, BC, CA, A, B, C = range(7)
"""Where the nearest point lies on a triangle A, B, C, its longest edge A B first."""


class MeshTree(NamedTuple):
    """What kernels see of a mesh. Triangles stand in the order of the tree's leaves.

    box (m, 12) : low and high corner of both children of a node. child (m, 2) : a node, or the leaf -1 - (8 start +
    count). frame (f, 16) : A, x, y, z axis, |AB|, and C in the frame. corner (f, 3) : vertices A, B, C. edge (f, 3) :
    edges AB, BC, CA. name (f,) : the triangle's own number. vertices (n, 3). edge_normal (e, 3), vertex_normal (n, 3) :
    pseudo-normals. centre (3,), size : of the mesh's box and its diagonal. signed : whether negative inside.
    """

    box: Array
    child: Index
    frame: Array
    corner: Index
    edge: Index
    name: Index
    vertices: Array
    edge_normal: Array
    vertex_normal: Array
    centre: Array
    size: float
    signed: bool


@njit
def gap2(vertices: Array, i: int, j: int) -> float:
    """Squared distance of two vertices."""
    x, y, z = vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1], vertices[j, 2] - vertices[i, 2]
    return float(x * x + y * y + z * z)


@njit
def frame_of(vertices: Array, i: int, j: int, k: int, row: Array) -> int:
    """The frame of triangle i, j, k into row (16,): the number (0, 1, 2) of the corner that is its A.

    The normal comes from the two shorter edges: it is as accurate as they are, for needles too.
    """
    ij, jk, ki = gap2(vertices, i, j), gap2(vertices, j, k), gap2(vertices, k, i)
    start, a, b, c = 0, i, j, k
    if jk > ij and jk >= ki:
        start, a, b, c = 1, j, k, i
    elif ki > ij:
        start, a, b, c = 2, k, i, j
    ux, uy, uz = vertices[a, 0] - vertices[c, 0], vertices[a, 1] - vertices[c, 1], vertices[a, 2] - vertices[c, 2]
    vx, vy, vz = vertices[b, 0] - vertices[c, 0], vertices[b, 1] - vertices[c, 1], vertices[b, 2] - vertices[c, 2]
    lx, ly, lz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    nx, ny, nz = minor_value(uy, uz, vy, vz), minor_value(uz, ux, vz, vx), minor_value(ux, uy, vx, vy)
    largest = max(abs(nx), abs(ny), abs(nz))
    length = np.sqrt(lx * lx + ly * ly + lz * lz)
    if length > 0.0:
        lx, ly, lz = lx / length, ly / length, lz / length
    else:
        lx, ly, lz = 1.0, 0.0, 0.0
    if largest > 0.0:
        nx, ny, nz = nx / largest, ny / largest, nz / largest
    elif abs(lx) < 0.5:  # no area: any normal of the edge
        nx, ny, nz = 0.0, lz, -ly
    else:
        nx, ny, nz = lz, 0.0, -lx
    norm = np.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / norm, ny / norm, nz / norm
    yx, yy, yz = ny * lz - nz * ly, nz * lx - nx * lz, nx * ly - ny * lx
    for s in range(3):
        row[s] = vertices[a, s]
    row[3], row[4], row[5] = lx, ly, lz
    row[6], row[7], row[8] = yx, yy, yz
    row[9], row[10], row[11] = nx, ny, nz
    row[12] = length
    row[13] = -(ux * lx + uy * ly + uz * lz)
    row[14] = max(-(ux * yx + uy * yy + uz * yz), 0.0)
    row[15] = row[13] * row[13] + row[14] * row[14]
    return start


@njit_inline
def box_distance2(box: Array, node: int, side: int, x: float, y: float, z: float) -> float:
    """Squared distance of a point from a child's box."""
    k = 6 * side
    dx = max(max(box[node, k] - x, x - box[node, k + 3]), 0.0)
    dy = max(max(box[node, k + 1] - y, y - box[node, k + 4]), 0.0)
    dz = max(max(box[node, k + 2] - z, z - box[node, k + 5]), 0.0)
    return dx * dx + dy * dy + dz * dz


@njit_inline
def triangle_distance2(frame: Array, k: int, px: float, py: float, pz: float) -> tuple[float, int]:
    """Squared distance of a point from triangle k, and on which part of it the nearest point lies."""
    wx, wy, wz = px - frame[k, 0], py - frame[k, 1], pz - frame[k, 2]
    x = wx * frame[k, 3] + wy * frame[k, 4] + wz * frame[k, 5]
    y = wx * frame[k, 6] + wy * frame[k, 7] + wz * frame[k, 8]
    z = wx * frame[k, 9] + wy * frame[k, 10] + wz * frame[k, 11]
    length, cx, cy = frame[k, 12], frame[k, 13], frame[k, 14]
    z2 = z * z
    if y <= 0.0:
        if x <= 0.0:
            return x * x + y * y + z2, A
        if x >= length:
            return (x - length) * (x - length) + y * y + z2, B
        return y * y + z2, AB
    best, part = np.inf, FACE
    left = cx * y - cy * x  # beyond A C
    if left > 0.0:
        t, ac = x * cx + y * cy, frame[k, 15]
        if t <= 0.0:
            best, part = x * x + y * y, A
        elif t >= ac:
            best, part = (x - cx) * (x - cx) + (y - cy) * (y - cy), C
        else:
            best, part = left * left / ac, CA
    bx, ex = x - length, cx - length
    beyond = cy * bx - ex * y  # beyond B C
    if beyond > 0.0:
        t, bc = bx * ex + y * cy, ex * ex + cy * cy
        if t <= 0.0:
            d, p = bx * bx + y * y, B
        elif t >= bc:
            d, p = (x - cx) * (x - cx) + (y - cy) * (y - cy), C
        else:
            d, p = beyond * beyond / bc, BC
        if d < best:
            best, part = d, p
    if part == FACE:
        return z2, FACE
    return best + z2, part


@njit
def nearest_triangle(
    tree: MeshTree, x: float, y: float, z: float, guess: int, stack: Index, bound: Array
) -> tuple[int, int]:
    """The nearest triangle (in the tree's order) to a point, and the part of it that is nearest.

    guess : a triangle that may be near, or -1. It changes the time, never the answer.
    """
    frame, box, child, name = tree.frame, tree.box, tree.child, tree.name
    cx, cy, cz = x - tree.centre[0], y - tree.centre[1], z - tree.centre[2]
    margin = ROUNDING * (abs(cx) + abs(cy) + abs(cz) + tree.size)
    best, found, part = np.inf, -1, FACE
    limit = np.inf
    if guess >= 0:
        best, part = triangle_distance2(frame, guess, x, y, z)
        found = guess
        limit = (np.sqrt(best) + margin) ** 2
    top = 1
    stack[0], bound[0] = 0, 0.0
    while top > 0:
        top -= 1
        if bound[top] > limit:
            continue
        node = stack[top]
        while node >= 0:
            d0 = box_distance2(box, node, 0, x, y, z)
            d1 = box_distance2(box, node, 1, x, y, z)
            c0, c1 = child[node, 0], child[node, 1]
            if d1 < d0:
                d0, d1, c0, c1 = d1, d0, c1, c0
            if d1 <= limit:
                stack[top], bound[top] = c1, d1
                top += 1
            if d0 > limit:
                node = -1  # an empty leaf
                break
            node = c0
        code = -1 - node
        start = code >> 3
        for k in range(start, start + (code & 7)):
            d, p = triangle_distance2(frame, k, x, y, z)
            if d < best or (d == best and name[k] < name[found]):
                best, found, part = d, k, p
                limit = (np.sqrt(best) + margin) ** 2
    return found, part


@njit
def nearest_points(tree: MeshTree, points: Array, distance: Array, normal: Array, foot: Array) -> None:
    """For points (n, 3) the distance (n,), the unit normal (n, 3) and the nearest point (n, 3) of the mesh.

    With tree.signed, distances are negative inside: the sign is that against the pseudo-normal of the face, edge or
    vertex that is nearest (J. A. Baerentzen and H. Aanaes, "Signed distance computation using the angle weighted
    pseudonormal", 2005). A point that is not finite, or beyond FARTHEST, gets NaN.
    """
    frame, vertices, corner, edge = tree.frame, tree.vertices, tree.corner, tree.edge
    stack, bound = np.empty(DEEPEST + 128, np.int64), np.empty(DEEPEST + 128)
    guess = -1
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not (abs(x) < FARTHEST and abs(y) < FARTHEST and abs(z) < FARTHEST):
            distance[i] = np.nan
            for c in range(3):
                normal[i, c], foot[i, c] = np.nan, np.nan
            continue
        k, part = nearest_triangle(tree, x, y, z, guess, stack, bound)
        guess = k
        if part == FACE:
            h = 0.0
            for c in range(3):
                h += (points[i, c] - frame[k, c]) * frame[k, 9 + c]
            turn = -1.0 if h < 0.0 and not tree.signed else 1.0
            distance[i] = turn * h
            for c in range(3):
                foot[i, c] = points[i, c] - h * frame[k, 9 + c]
                normal[i, c] = turn * frame[k, 9 + c]
            continue
        if part >= A:
            v = corner[k, part - A]
            for c in range(3):
                foot[i, c] = vertices[v, c]
        else:
            a, b = corner[k, part - AB], corner[k, (part - AB + 1) % 3]
            along, length = 0.0, 0.0
            for c in range(3):
                e = vertices[b, c] - vertices[a, c]
                along += (points[i, c] - vertices[a, c]) * e
                length += e * e
            t = min(max(along / length, 0.0), 1.0)
            for c in range(3):
                foot[i, c] = vertices[a, c] + t * (vertices[b, c] - vertices[a, c])
        d2, side, pseudo2 = 0.0, 0.0, 0.0
        for c in range(3):
            w = points[i, c] - foot[i, c]
            m = tree.vertex_normal[corner[k, part - A], c] if part >= A else tree.edge_normal[edge[k, part - AB], c]
            normal[i, c] = m
            d2 += w * w
            side += w * m
            pseudo2 += m * m
        d = np.sqrt(d2)
        sign = -1.0 if tree.signed and side < 0.0 else 1.0
        distance[i] = sign * d
        if d > 2.0**-40 * tree.size:
            for c in range(3):
                normal[i, c] = sign * (points[i, c] - foot[i, c]) / d
        elif pseudo2 > 0.0:
            pseudo = np.sqrt(pseudo2)
            for c in range(3):
                normal[i, c] /= pseudo
        else:
            for c in range(3):
                normal[i, c] = frame[k, 9 + c]


@njit
def pseudo_normals(tree: MeshTree) -> None:
    """Fill the normals of edges (sum of the faces' normals) and of vertices (that sum weighed by the faces' angles)."""
    tree.edge_normal[:] = 0.0
    tree.vertex_normal[:] = 0.0
    at = np.empty(len(tree.name), np.int64)
    for k in range(len(tree.name)):
        at[tree.name[k]] = k
    for t in range(len(at)):  # in the triangles' own order: sums do not depend on the tree
        k = at[t]
        f = tree.frame[k]
        length, cx, cy = f[12], f[13], f[14]
        alpha, beta = np.arctan2(cy, cx), np.arctan2(cy, length - cx)
        angles = (alpha, beta, max(np.pi - alpha - beta, 0.0))
        for s in range(3):
            for c in range(3):
                tree.edge_normal[tree.edge[k, s], c] += f[9 + c]
                tree.vertex_normal[tree.corner[k, s], c] += angles[s] * f[9 + c]
