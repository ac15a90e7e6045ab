"""B-spline tools (paper sections 4.3 to 4.7): both surfaces are discretized and refined together, triangulated where their
spheres meet, and the contacts found on the true surfaces."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from . import hull, levels, quadrature
from .closest import project
from .contacts import Contacts
from .crossing import crossing_triangles
from .newton import DISTANCE, NORMAL, POINT, PROPER, U, V
from .query import Crossings, Run, SurfaceTool, extents_of, finest_size, on_face
from .triangulate import triangulate
from .workspace import Patch, Workspace, make_points

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

EDGE = 1e-5
"""Two tool patches share an edge where their closest points agree to this fraction of the tool's size (CAD's own gaps)."""


def surface_contacts(run: Run, index: int, tool: SurfaceTool) -> tuple[list[Contacts], list[Crossings]]:
    """B-spline tools (4.3 to 4.7): both sides are discretized and refined together."""
    extents = extents_of(tool.nets, f"tool {index}")
    low, high = extents[:, 0].min(axis=0), extents[:, 1].max(axis=0)
    size = float(np.linalg.norm(high - low))
    contacts: list[Contacts] = []
    crossings: list[Crossings] = []
    reach = max(run.options.margin, tool.reach)
    # an open tool's sheet is felt to the depth of a cell at least: as far as spheres reach, so must the culls before them
    holds = reach + run.cell_sizes()
    for face in run.near(low, high, holds[:, None]):
        work, g = run.model(int(face))
        hold = float(holds[face])
        model_low, model_high = run.extents[face] + np.array([[-1.0], [1.0]]) * hold
        meets = ((extents[:, 0] <= model_high) & (extents[:, 1] >= model_low)).all(axis=1)
        cells: list[Index] = []
        culled = True
        for k in np.flatnonzero(meets):
            other, h = run.load((index, int(k)), tool.grids[k], tool.nets[k])
            spans = _span_pairs(run, (int(face), index, int(k)), work, g, other, h, hold)
            if spans is None:
                continue
            culled = False
            if not len(spans):
                continue
            tolerance = 0.0 if run.paper else run.options.tolerance
            mine, its, pairs = levels.traverse(work, other, spans, reach, tolerance)
            if not len(pairs):
                continue
            cells.append(mine)
            crossings += _crossings(int(face), index, int(k), work, g, mine, other, h, its, pairs)
        if culled and (len(tool.nets) == 1 or _whole_hull_apart(run, int(face), index, g, tool)):
            continue
        patches = [run.load((index, k), grid, net)[1] for k, (grid, net) in enumerate(zip(tool.grids, tool.nets, strict=True))]
        contacts += _closest_contacts(run, index, int(face), tool, work, g, patches, cells, EDGE * size)
    return contacts, crossings


def _span_pairs(
    run: Run, key: tuple[int, int, int], work: Workspace, g: Patch, other: Workspace, h: Patch, hold: float
) -> Index | None:
    """Hull against hull (4.3), then the window (4.4) as pairs of spans; None when the hulls are apart."""
    run.cache.counters[0] += 1
    axis = run.cache.axes.setdefault(key, np.zeros(3))
    mine, its = (np.ascontiguousarray(p.net[..., :3] / p.net[..., 3:]).reshape(-1, 3) for p in (g, h))
    if hull.apart(mine, its, axis, hold):
        return None
    if run.paper:
        windows = []
        for own, patch, away in ((work, g, its), (other, h, mine)):

            def meets(facets: Array, away: Array = away) -> Mask:
                return np.array([not hull.apart(np.ascontiguousarray(f), away, np.zeros(3), 0.0) for f in facets])

            windows.append(np.flatnonzero(hull.paper_window(own.grid.surface, patch, meets, True) & own.grid.covers[: len(patch.box)]))
        for own in (work, other):
            levels.window_cells(own)
        return np.stack(np.meshgrid(*windows, indexing="ij"), axis=-1).reshape(-1, 2)
    for own in (work, other):
        levels.window_cells(own)
    pairs = np.empty((1024, 2), np.int64)
    count = hull.span_pairs(g.box, g.covers, h.box, h.covers, hold, pairs)
    if count > len(pairs):
        pairs = np.empty((count, 2), np.int64)
        hull.span_pairs(g.box, g.covers, h.box, h.covers, hold, pairs)
    return pairs[:count]


def _whole_hull_apart(run: Run, face: int, index: int, g: Patch, tool: SurfaceTool) -> bool:
    """Whether a model patch stays out of the hull of all the tool's patches together; else it may lie inside the tool, apart
    from each of them."""
    mine = np.ascontiguousarray(g.net[..., :3] / g.net[..., 3:]).reshape(-1, 3)
    its = np.concatenate([np.asarray(net, dtype=np.float64).reshape(-1, 3) for net in tool.nets])
    run.cache.counters[0] += 1
    return hull.apart(mine, its, run.cache.axes.setdefault((face, index, -1), np.zeros(3)), 0.0)


def _crossings(
    face: int, index: int, k: int, work: Workspace, g: Patch, mine: Index, other: Workspace, h: Patch, its: Index, pairs: Index
) -> list[Crossings]:
    """Triangulation (4.6) and triangle tests (4.7) over the cells left."""
    tri_a, first_a = triangulate(g, mine, len(mine), work.new_mark())
    tri_b, first_b = triangulate(h, its, len(its), other.new_mark())
    found, segments, tests = crossing_triangles(
        g.points, g.inside, tri_a, first_a, h.points, h.inside, tri_b, first_b, pairs
    )
    g.counters[5:8] += np.array([len(tri_a) + len(tri_b), tests, len(found)])
    if not len(found):
        return []
    full = lambda value: np.full(len(found), value, dtype=np.int64)  # noqa: E731
    return [
        Crossings(
            full(face), full(index), full(k), tri_a[found[:, 0]], tri_b[found[:, 1]], found[:, 2], segments.reshape(-1, 2, 3)
        )
    ]


def _closest_contacts(
    run: Run, index: int, face: int, tool: SurfaceTool, work: Workspace, g: Patch, patches: list[Patch],
    cells: list[Index], tie: float,
) -> list[Contacts]:  # fmt: skip
    """Contacts at the model's finest vertices: their closest points on the tool's true surface, from the cells left outwards
    as long as there are contacts, so that the inside of a deep overlap is not lost."""
    known = work.new_mark()
    margin = run.options.margin
    columns = len(g.v)
    wave = np.concatenate([*(levels.vertices_of(g, part, known) for part in cells), np.zeros(0, np.int64)])
    found: list[tuple[Index, _Nearest]] = []
    tested: list[tuple[Index, Array]] = []
    if not run.paper:
        # where no sphere meets another, the patch may lie wholly inside the tool; any one vertex of it tells
        inner = np.flatnonzero(g.inside)[:1]
        if len(inner) and not len(wave):
            wave = inner
            g.visit[inner] = known
            make_points(g, inner, 1)
    while len(wave):
        names, group = quadrature.in_blocks(wave, columns)
        nearest = _nearest(tool, patches, g.points[names], group, tie, 1.1 * margin + 1e-300)
        hit = ~(nearest.depth < -margin)
        tested.append((names, nearest.depth))
        wave = wave[:0]
        if hit.any():
            found.append((names[hit], nearest.chosen(hit)))
            wave = quadrature.spread(g, names[hit], known)
    parts = []
    if found:
        names = np.concatenate([n for n, _ in found])
        order = np.argsort(names)
        nearest = _Nearest.joined([n for _, n in found]).chosen(order)
        uv, points, area = quadrature.vertex_rows(g, names[order])
        parts.append(run.rows(index, face, uv, points, -nearest.normal, nearest.depth, area, nearest.point))
    if run.paper or not cells:
        return parts
    names, depths = np.concatenate([n for n, _ in tested]), np.concatenate([d for _, d in tested])
    left = quadrature.unresolved(g, np.concatenate(cells), margin, names, depths, work.new_mark())
    if len(left):

        def distance(points: Array) -> Array:
            return -_nearest(tool, patches, points, np.arange(len(points) + 1), tie).depth

        uv, points, area = quadrature.below_grid(g, left, distance, margin, finest_size(run, g))
        on = on_face(run.grids[face], uv)
        if on.any():
            uv, points, area = uv[on], points[on], area[on]
            nearest = _nearest(tool, patches, points, np.arange(len(points) + 1), tie)
            parts.append(run.rows(index, face, uv, points, -nearest.normal, nearest.depth, area, nearest.point))
    return parts


@dataclass(frozen=True, slots=True, eq=False)
class _Nearest:
    """Closest points of a tool to n points: depth (n,), positive inside, -inf where the tool is open there and says nothing;
    unit outward normal (n, 3) and the point (n, 3)."""

    depth: Array
    normal: Array
    point: Array

    def chosen(self, which: Mask | Index) -> _Nearest:
        return _Nearest(self.depth[which], self.normal[which], self.point[which])

    @classmethod
    def joined(cls, parts: list[_Nearest]) -> _Nearest:
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))


def _nearest(
    tool: SurfaceTool, patches: list[Patch], points: Array, group: Index, tie: float, beyond: float = np.inf
) -> _Nearest:
    """The closest points of all patches of a tool, and on which side of it the points lie.

    At the common edge of two patches the sum of their normals tells the sides apart (Baerentzen and Aanaes 2005). A point
    beyond an open border, or whose closest point has been trimmed away, is on no side.
    """
    best = np.full((len(points), 9), np.inf)
    state, owner = np.zeros(len(points), np.int64), np.full(len(points), -1, dtype=np.int64)
    for k, patch in enumerate(patches):
        project(patch, points, group, tie, beyond, k, best, state, owner)
    arm = points - best[:, POINT : POINT + 3]
    total = best[:, NORMAL : NORMAL + 3]
    length = np.linalg.norm(total, axis=1)
    distance = best[:, DISTANCE]
    side = np.where((arm * total).sum(axis=1) > 0, 1.0, -1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal = total / length[:, None]
        # over an edge the normal is the way to it
        over_edge = (np.abs(length - 1.0) > 1e-9) & (distance > 1e-6 * tie)
        normal[over_edge] = (side[:, None] * arm / distance[:, None])[over_edge]
    depth = np.where(state == PROPER, -side * distance, -np.inf)
    for k, grid in enumerate(tool.grids):
        if grid.inside is not None:
            mine = np.flatnonzero((owner == k) & (state == PROPER))
            away = ~on_face(grid, best[mine][:, [U, V]])
            depth[mine[away]] = -np.inf
    return _Nearest(depth, normal, best[:, POINT : POINT + 3])
