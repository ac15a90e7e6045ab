"""Which triangles of two surfaces meet (paper section 4.7): only those of cells whose spheres intersect are tested.

Before a pair of triangles comes to the exact test, the boxes of their cells, and then the plane of either, part nearly
all pairs that do not meet; both do so with a margin for rounding, so that they never overrule the exact test.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit
from .broad import candidate_pairs
from .finest import finest_crossings
from .hull import apart, span_pairs
from .levels import traverse
from .query import Crossings, DetectCache, SurfaceTool
from .tri_tri import WORK, culled_tri_tri
from .triangulate import triangulate
from .workspace import Patch, grown, longer

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


def crossings(a: SurfaceTool, b: SurfaceTool, cache: DetectCache | None = None) -> Crossings:
    """All pairs of triangles of the finest meshes of two bodies that meet, by patch of a (`face`), patch of b
    (`tool_face`), and cells of either; `tool` is 0.

    They are those of the whole meshes (`whole_mesh`), whatever the levels of detail, but only what is near the other body is
    made. Give the same cache from step to step: what belongs to nets that stay the same is kept in it. Raises
    GeometryError for control points that are not finite.
    """
    cache = DetectCache() if cache is None else cache
    cache.counters[:] = 0
    extents = cache.boxes(-1, a.nets, "first body"), cache.boxes(0, b.nets, "second body")
    parts = []
    for i, k in candidate_pairs(*extents).tolist():
        mine, its = cache.workspace((-1, i), a.grids[i]), cache.workspace((0, k), b.grids[k])
        g = mine.load(a.nets[i], paper=False, delta=0.0)
        h = its.load(b.nets[k], paper=False, delta=0.0)
        triangles, relation, rank, segments = finest_crossings(g, *mine.boxes, h, *its.boxes)
        if len(rank):
            order = np.argsort(rank)
            parts.append(Crossings.of((i, 0, k), triangles[order], relation[order], segments[order]))
    return parts[0] if len(parts) == 1 else Crossings.joined(parts)


@njit
def meet(
    g: Patch, h: Patch, axis: Array, reach: float, tolerance: float, mark_a: int, mark_b: int
) -> tuple[bool, Index, Index, Index, Array]:
    """Sections 4.3 to 4.7 over two patches: whether their hulls are apart (nothing else is looked at then), and what
    `cross` finds in the window of all pairs of spans within `reach` of each other."""
    g.counters[0] += 1
    if apart(positions(g.net), positions(h.net), axis, reach):
        nothing = np.empty((0, 3), np.int64)
        return True, nothing, np.empty((0, 6), np.int64), np.empty(0, np.int64), np.empty((0, 6))
    for own in (g, h):
        for k in range(len(own.box)):
            own.counters[1] += own.covers[k]
    spans = np.empty((256, 2), np.int64)
    count = span_pairs(g.box, g.covers, h.box, h.covers, reach, spans)
    if count > len(spans):
        spans = np.empty((count, 2), np.int64)
        span_pairs(g.box, g.covers, h.box, h.covers, reach, spans)
    left, triangles, relation, segments = cross(g, h, spans[:count], reach, tolerance, mark_a, mark_b)
    return False, left, triangles, relation, segments


@njit
def positions(net: Array) -> Array:
    """The control points (n, 3) of a homogeneous net (r, s, 4)."""
    out = np.empty((net.shape[0] * net.shape[1], 3))
    for i in range(net.shape[0]):
        for j in range(net.shape[1]):
            for c in range(3):
                out[i * net.shape[1] + j, c] = net[i, j, c] / net[i, j, 3]
    return out


@njit
def cross(
    g: Patch, h: Patch, spans: Index, reach: float, tolerance: float, mark_a: int, mark_b: int
) -> tuple[Index, Index, Index, Array]:
    """Sections 4.5 to 4.7 over pairs of spans (k, 2): spheres of both refined together, triangulation, triangle tests.

    Returns the cells (n, 3) of g whose box, and the sag of the surface over it, comes within `reach` of h's, and the
    triangles that meet: vertices (m, 6) of g's and h's, relation (m,), segments (m, 6). mark_a, mark_b : numbers new to
    the marks of g and h, as are those that follow them.
    """
    mine, its, pairs = traverse(g, h, spans, reach, tolerance, mark_a, mark_b)
    if len(pairs) == 0:
        return mine, np.empty((0, 6), np.int64), np.empty(0, np.int64), np.empty((0, 6))
    tri_a, first_a = triangulate(g, mine, len(mine), mark_a)
    tri_b, first_b = triangulate(h, its, len(its), mark_b)
    box_a, box_b = cell_boxes(g.points, tri_a, first_a), cell_boxes(h.points, tri_b, first_b)
    sag_a, sag_b = sags(g, mine), sags(h, its)
    stays = np.zeros(len(mine), np.bool_)
    kept = 0
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        if near(box_a, a, box_b, b, sag_a[a] + sag_b[b] + reach):
            stays[a] = True
            pairs[kept, 0], pairs[kept, 1] = a, b
            kept += 1
    found, segments, tests = crossing_triangles(
        g.points, tri_a, first_a, box_a, h.points, tri_b, first_b, box_b, pairs[:kept]
    )
    g.counters[5] += len(tri_a) + len(tri_b)
    g.counters[6] += tests
    g.counters[7] += len(found)
    left = 0
    for a in range(len(mine)):
        if stays[a] or g.paper:
            for c in range(3):
                mine[left, c] = mine[a, c]
            left += 1
    triangles, relation = np.empty((len(found), 6), np.int64), np.empty(len(found), np.int64)
    for k in range(len(found)):
        for v in range(3):
            triangles[k, v], triangles[k, 3 + v] = tri_a[found[k, 0], v], tri_b[found[k, 1], v]
        relation[k] = found[k, 2]
    return mine[:left], triangles, relation, segments


@njit
def sags(g: Patch, cells: Index) -> Array:
    """How far the surface may leave the triangles of each cell (n, 3)."""
    out = np.empty(len(cells))
    for t in range(len(cells)):
        at = g.offset[cells[t, 0]] + cells[t, 1] * g.tally[cells[t, 0], 1] + cells[t, 2]
        out[t] = g.spheres[at, 5] + g.slack
    return out


@njit
def cell_boxes(points: Array, triangles: Index, first: Index) -> Array:
    """Boxes (cells, 6) of the triangles first[c] to first[c + 1] of each cell; empty cells get an empty box."""
    out = np.empty((len(first) - 1, 6))
    for c in range(len(out)):
        for k in range(3):
            out[c, k], out[c, 3 + k] = np.inf, -np.inf
        for t in range(first[c], first[c + 1]):
            for v in range(3):
                for k in range(3):
                    out[c, k] = min(out[c, k], points[triangles[t, v], k])
                    out[c, 3 + k] = max(out[c, 3 + k], points[triangles[t, v], k])
    return out


@njit
def near(box_a: Array, a: int, box_b: Array, b: int, pad: float) -> bool:
    """Box a of (n, 6) comes within `pad` of box b along each axis."""
    return bool(
        box_a[a, 0] <= box_b[b, 3] + pad and box_b[b, 0] <= box_a[a, 3] + pad
        and box_a[a, 1] <= box_b[b, 4] + pad and box_b[b, 1] <= box_a[a, 4] + pad
        and box_a[a, 2] <= box_b[b, 5] + pad and box_b[b, 2] <= box_a[a, 5] + pad
    )  # fmt: skip


@njit
def crossing_triangles(
    points_a: Array, tri_a: Index, first_a: Index, box_a: Array,
    points_b: Array, tri_b: Index, first_b: Index, box_b: Array, pairs: Index,
) -> tuple[Index, Array, int]:  # fmt: skip
    """The triangles that meet, over the pairs (k, 2) of cells: (n, 3) triangle of a, of b, relation; segments
    (n, 6); and the number of pairs of triangles tested."""
    found = np.empty((64, 3), np.int64)
    segments = np.empty((64, 6))
    count, tests = 0, 0
    both, segment, work = np.empty((6, 3)), np.empty(6), np.empty(WORK)
    for k in range(len(pairs)):
        c, d = pairs[k, 0], pairs[k, 1]
        if (
            box_a[c, 0] > box_b[d, 3] or box_a[c, 3] < box_b[d, 0]
            or box_a[c, 1] > box_b[d, 4] or box_a[c, 4] < box_b[d, 1]
            or box_a[c, 2] > box_b[d, 5] or box_a[c, 5] < box_b[d, 2]
        ):  # fmt: skip
            continue
        for s in range(first_a[c], first_a[c + 1]):
            for t in range(first_b[d], first_b[d + 1]):
                tests += 1
                for v in range(3):
                    for x in range(3):
                        both[v, x] = points_a[tri_a[s, v], x]
                        both[3 + v, x] = points_b[tri_b[t, v], x]
                relation = culled_tri_tri(both, segment, work)
                if relation == 0:
                    continue
                if count == len(found):
                    found = grown(found)
                    segments = longer(segments)
                found[count, 0], found[count, 1], found[count, 2] = s, t, relation
                for x in range(6):
                    segments[count, x] = segment[x]
                count += 1
    return found[:count], segments[:count], tests
