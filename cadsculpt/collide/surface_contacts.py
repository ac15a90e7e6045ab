"""B-spline tools (paper sections 4.3 to 4.7): both surfaces are discretized and refined together, triangulated where
their spheres meet, and the contacts found on the true surfaces."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from . import hull, levels, quadrature
from .broad import near_box
from .closest import project
from .contacts import Columns
from .crossing import cross, meet, positions
from .grid import PatchGrid
from .newton import BORDER, DISTANCE, NORMAL, POINT, PROPER, U, V
from .query import Crossings, RigidSurfaceTool, Run, SurfaceTool, finest_size, on_face
from .rim import closest_on_faces, faces_box, outside_box
from .shapes import world_box
from .surface_rows import surface_rows
from .workspace import Patch, Workspace, make_points

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

ORIGIN, UNTURNED = np.zeros(3), np.eye(3)

EDGE = 1e-5
"""Two tool patches share an edge where their closest points agree to this fraction of the tool's size (CAD's own
gaps)."""

FARTHER = 0.9
"""Patches whose boxes are farther than what has been found, by more than the percent to which distances beyond the margin
are found, hold nothing nearer."""


def surface_contacts(run: Run, index: int, tool: SurfaceTool | RigidSurfaceTool) -> list[Crossings]:
    """B-spline tools (4.3 to 4.7): both sides are discretized and refined together."""
    if len(tool.grids) == 1 and tool.grids[0].region is None and not run.paper:
        return _one_patch_contacts(run, index, tool)
    if isinstance(tool, RigidSurfaceTool):
        tool = tool.in_world()
    extents = run.cache.boxes(index, tool.nets, f"tool {index}")
    low, high = extents[:, 0].min(axis=0), extents[:, 1].max(axis=0)
    size = float(np.linalg.norm(high - low))
    crossings: list[Crossings] = []
    reach, alone = max(run.options.margin, tool.reach), len(tool.nets) == 1
    for face in run.near(low, high, reach, felt=alone).tolist():
        # an open sheet is felt to the depth of a cell at least, or flat pressed on flat would lose its contact as it
        # begins
        hold = reach + run.cell_size(face) if alone else reach
        model_low, model_high = run.extents[face] + np.array([[-1.0], [1.0]]) * hold
        meets = near_box(extents, model_low, model_high, 0.0, 0.0)
        if alone and not len(meets):
            continue
        work, g = run.model(face)
        cells: list[Index] = []
        culled = True
        for k in meets.tolist():
            other, _ = run.load((index, k), tool.grids[k], tool.nets[k])
            for felt in (reach,) if other.closed or run.paper else (reach, hold):
                left, found = _near_cells(run, (face, index, k), work, other, felt)
                culled = culled and left is None
                if left is not None and len(left):
                    cells.append(left)
                    crossings += found
                    break
        if culled and (alone or _whole_hull_apart(run, face, index, g, tool)):
            continue

        def patch(k: int) -> Patch:
            return run.load((index, k), tool.grids[k], tool.nets[k])[1]

        solid = _Solid(tool.grids, patch, extents, EDGE * size, run.options.margin)
        _closest_contacts(run, index, face, solid, work, cells)
    return crossings


def _one_patch_contacts(run: Run, index: int, tool: SurfaceTool | RigidSurfaceTool) -> list[Crossings]:
    """A tool of one whole patch, in its own frame where it has one, so that what is made of it need not be made again."""
    if isinstance(tool, RigidSurfaceTool):
        net, at, turn = tool.rest[0], tool.at, tool.rotation
    else:
        net, at, turn = tool.nets[0], ORIGIN, UNTURNED
        run.cache.boxes(index, tool.nets, f"tool {index}")
    other, h = run.load((index, 0), tool.grids[0], net)
    voxels = run.cache.voxels_of(index, other)
    if not world_box(other.extent, at, turn, run.cache.box):
        raise InputError("the tool's box is not a number", where=f"tool {index}")
    margin, out, reach = run.options.margin, run.out, max(run.options.margin, tool.reach)
    tie = EDGE * math.dist(*other.extent.tolist())
    crossings: list[Crossings] = []
    for place in range(run.near_posed(reach, felt=True)):
        face = int(run.cache.near[place])
        work, g = run.model(face) if isinstance(tool, SurfaceTool) else run.model_in_frame(face, index, at, turn)
        rows, key = out.reserve(len(g.visit)), (face, index, 0)
        # an open sheet is felt to the depth of a cell at least, or flat pressed on flat would lose its contact as it
        # begins
        felts = (reach,) if other.closed else (reach, reach + run.cell_size(face))

        def look(
            seed: int, felt: float, work: Workspace = work, rows: Columns = rows, face: int = face
        ) -> tuple[int, int, int]:
            found, cells, left = surface_rows(
                work.patch, h, voxels, other.extent, seed, felt, np.inf if other.closed else felt, margin, tie, at, turn,
                work.new_mark(), work.new_mark(), work.new_mark(), work.room, work.waves, other.search, rows,
                out.count, run.body, run.others[index], run.faces[face],
            )  # fmt: skip
            if found < 0:
                raise InputError("a distance to the tool is not a number", where=f"tool {index}")
            return found, cells, left

        found = cells = left = 0
        for felt in felts:
            found, cells, left = look(-1, felt)
            if cells:
                break
        if not cells:
            # where no sphere meets another, the patch may lie wholly inside the tool; any one vertex of it tells
            run.cache.counters[0] += 1
            axis = run.cache.axes.setdefault(key, np.zeros(3))
            if not hull.apart(positions(g.net), positions(h.net), axis, felts[-1]):
                found, _, _ = look(int(g.inside.argmax()), np.inf)
        out.count += found
        if left:
            _below_vertices(run, index, face, tool, other, tie, np.unique(work.room.maybe[:left, :2], axis=0), work)
        if isinstance(tool, SurfaceTool):
            for felt in felts:
                near, crossed = _near_cells(run, key, work, other, felt)
                crossings += crossed
                if near is not None and len(near):
                    break
    return crossings


def _below_vertices(
    run: Run,
    index: int,
    face: int,
    tool: SurfaceTool | RigidSurfaceTool,
    other: Workspace,
    tie: float,
    cells: Index,
    work: Workspace,
) -> None:
    """Contacts between the vertices of finest cells (n, 2) that a tool of one patch may reach, in its frame."""
    solid = _Solid(tool.grids, lambda _: other.patch, other.extent[None], tie, run.options.margin)

    def distance(points: Array) -> Array:
        return _nearest(solid, points, np.arange(len(points) + 1)).gap

    g = work.patch
    uv, points, area, undecided = quadrature.below_grid(
        g, cells, distance, distance, run.options.margin, finest_size(run, g), run.grids[face].region
    )
    run.give_up(index, face, undecided)
    if not len(uv):
        return
    touch = _nearest(solid, points, np.arange(len(points) + 1))
    if isinstance(tool, RigidSurfaceTool):
        turn = tool.rotation.T
        points = points @ turn + tool.at
        touch = replace(touch, normal=touch.normal @ turn, point=touch.point @ turn + tool.at)
    _put_rows(run, index, face, uv, points, area, touch)


def _near_cells(
    run: Run, key: tuple[int, int, int], work: Workspace, other: Workspace, reach: float
) -> tuple[Index | None, list[Crossings]]:
    """The model's cells that come within `reach` of one patch of the tool, and the triangles that cross; None for the
    cells when the hulls are apart."""
    axis = run.cache.axes.setdefault(key, np.zeros(3))
    if run.paper:
        spans = _paper_spans(run, axis, work, other, reach)
        if spans is None:
            return None, []
        left, triangles, relation, segments = cross(
            work.patch, other.patch, spans, reach, 0.0, work.new_mark(), other.new_mark()
        )
    else:
        apart, left, triangles, relation, segments = meet(
            work.patch, other.patch, axis, reach, run.options.tolerance, work.new_mark(), other.new_mark()
        )
        if apart:
            return None, []
    if not len(relation):
        return left, []
    return left, [Crossings.of(key, triangles, relation, segments)]


def _paper_spans(run: Run, axis: Array, work: Workspace, other: Workspace, reach: float) -> Index | None:
    """Hull against hull (4.3), then the paper's window (4.4) as pairs of spans; None when the hulls are apart."""
    run.cache.counters[0] += 1
    mine, its = positions(work.patch.net), positions(other.patch.net)
    if hull.apart(mine, its, axis, reach):
        return None
    windows = []
    for own, away in ((work, its), (other, mine)):

        def meets(facets: Array, away: Array = away) -> Mask:
            return np.array([not hull.apart(np.ascontiguousarray(f), away, np.zeros(3), 0.0) for f in facets])

        window = hull.paper_window(own.grid.surface, own.patch, meets, True)
        windows.append(np.flatnonzero(window & own.grid.covers[: len(window)]))
        levels.window_cells(own)
    return np.stack(np.meshgrid(*windows, indexing="ij"), axis=-1).reshape(-1, 2)


def _whole_hull_apart(run: Run, face: int, index: int, g: Patch, tool: SurfaceTool) -> bool:
    """Whether a model patch stays out of the hull of all the tool's patches together; else it may lie inside the tool,
    apart from each of them."""
    mine = np.ascontiguousarray(g.net[..., :3] / g.net[..., 3:]).reshape(-1, 3)
    its = np.concatenate([np.asarray(net, dtype=np.float64).reshape(-1, 3) for net in tool.nets])
    run.cache.counters[0] += 1
    return hull.apart(mine, its, run.cache.axes.setdefault((face, index, -1), np.zeros(3)), 0.0)


def _closest_contacts(run: Run, index: int, face: int, solid: _Solid, work: Workspace, cells: list[Index]) -> None:
    """Contacts at the model's finest vertices: their closest points on the tool's true surface, from the cells left
    outwards as long as there are contacts, so that the inside of a deep overlap is not lost."""
    g, known, margin = work.patch, work.new_mark(), run.options.margin
    wave = np.concatenate([*(levels.vertices_of(g, part, known) for part in cells), np.zeros(0, np.int64)])
    if not len(wave) and not run.paper:
        # where no sphere meets another, the patch may lie wholly inside the tool; any one vertex of it tells
        wave = np.flatnonzero(g.inside)[:1]
        g.visit[wave] = known
        make_points(g, wave, len(wave))
    waves: list[tuple[Index, _Nearest]] = []
    while len(wave):
        names, group = quadrature.in_blocks(wave, len(g.v))
        nearest = _nearest(solid, g.points[names], group, rough=True)
        waves.append((names, nearest))
        hit = ~(nearest.depth < -margin)
        wave = quadrature.spread(g, names[hit], known) if hit.any() else wave[:0]
    if not waves:
        return
    names, nearest = np.concatenate([n for n, _ in waves]), _Nearest.joined([n for _, n in waves])
    touching = np.flatnonzero(~(nearest.depth < -margin))
    touching = touching[np.argsort(names[touching])]
    if len(touching):
        uv, points, area = quadrature.vertex_rows(g, names[touching])
        touch = nearest.chosen(touching)
        _put_rows(run, index, face, uv, points, area, touch)
    if run.paper or not cells:
        return
    left = quadrature.unresolved(g, np.concatenate(cells), margin, names, -nearest.gap, work.new_mark())
    # a cell near several patches of the tool comes once from each
    left = np.unique(left, axis=0)
    if len(left):

        def distance(points: Array) -> Array:
            return _nearest(solid, points, np.arange(len(points) + 1)).gap

        region = run.grids[face].region
        uv, points, area, undecided = quadrature.below_grid(
            g, left, distance, distance, margin, finest_size(run, g), region
        )
        run.give_up(index, face, undecided)
        if len(uv):
            touch = _nearest(solid, points, np.arange(len(points) + 1))
            _put_rows(run, index, face, uv, points, area, touch)


def _put_rows(run: Run, index: int, face: int, uv: Array, points: Array, area: Array, touch: _Nearest) -> None:
    on_tool = touch.patch, touch.parameters
    run.out.append(run.rows(index, face, uv, points, -touch.normal, touch.depth, area, touch.point, on_tool))


@dataclass(frozen=True, slots=True, eq=False)
class _Solid:
    """A surface tool as `_nearest` sees it: its grids, its patches, loaded when one is asked for by its place, their boxes
    (k, 2, 3), how near two closest points are one (on a common edge), and the margin within which distances matter."""

    grids: tuple[PatchGrid, ...]
    patch: Callable[[int], Patch]
    extents: Array
    tie: float
    margin: float


@dataclass(frozen=True, slots=True, eq=False)
class _Nearest:
    """Closest points of a tool to n points: depth (n,), positive inside, -inf where the tool is open there and says
    nothing; gap (n,), the signed distance, and where it says nothing the distance, above the margin; unit outward
    normal (n, 3); the point (n, 3), its patch (n,) and its parameters (n, 2) there."""

    depth: Array
    gap: Array
    normal: Array
    point: Array
    patch: Index
    parameters: Array

    def chosen(self, which: Mask | Index) -> _Nearest:
        return _Nearest(*(getattr(self, f.name)[which] for f in fields(self)))

    @classmethod
    def joined(cls, parts: list[_Nearest]) -> _Nearest:
        return (
            parts[0]
            if len(parts) == 1
            else cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))
        )


def _nearest(solid: _Solid, points: Array, group: Index, *, rough: bool = False) -> _Nearest:
    """The closest points of all patches of a tool, and on which side of it the points lie.

    At the common edge of two patches the sum of their normals tells the sides apart (Baerentzen and Aanaes 2005). A
    point beyond an open border is on no side. rough : points outside by more than the margin need no exact distance.
    """
    # (what has been trimmed away tells no side, and only an exact foot tells what has)
    trimmed = any(grid.region is not None for grid in solid.grids)
    rough = rough and not trimmed
    best = np.full((len(points), 9), np.inf)
    state, owner = np.zeros(len(points), np.int64), np.full(len(points), -1, dtype=np.int64)
    beyond = 1.1 * solid.margin + 1e-300 if rough else np.inf
    order, away = np.zeros(1, np.int64), np.zeros(1)
    if len(solid.extents) > 1:
        # the nearest patches first: what they find spares the others the search
        away = np.maximum(solid.extents[:, 0] - points.max(axis=0), points.min(axis=0) - solid.extents[:, 1])
        away = np.maximum(away, 0.0).max(axis=1)
        order = np.argsort(away, kind="stable")
    for k in order.tolist():
        if FARTHER * away[k] > best[:, DISTANCE].max() + solid.tie:
            break  # and so are all that follow
        project(solid.patch(k), points, group, solid.tie, beyond, k, best, state, owner)
    if trimmed:
        off = np.flatnonzero(~_on_faces(solid, best, owner))
        # what is outside the box of the faces is outside of them
        patches = [solid.patch(k) for k in range(len(solid.grids))] if len(off) else []
        beside = outside_box(faces_box(solid.grids, patches), points[off]) if len(off) else np.zeros(0)
        clear = beside > solid.margin
        best[off[clear], DISTANCE] = np.maximum(best[off[clear], DISTANCE], beside[clear])
        state[off[clear]] = BORDER
        off = off[~clear]
        if len(off):
            best[off], state[off], owner[off] = closest_on_faces(solid.grids, patches, points[off], solid.tie)
    arm = points - best[:, POINT : POINT + 3]
    total = best[:, NORMAL : NORMAL + 3]
    length = np.sqrt(np.einsum("ij,ij->i", total, total))
    distance = best[:, DISTANCE]
    side = np.where(np.einsum("ij,ij->i", arm, total) > 0, 1.0, -1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal = total / length[:, None]
        # over an edge the normal is the way to it
        over_edge = (np.abs(length - 1.0) > 1e-9) & (distance > 1e-6 * solid.tie)
        if over_edge.any():
            normal[over_edge] = side[over_edge, None] * arm[over_edge] / distance[over_edge, None]
    sided = state == PROPER
    depth = np.where(sided, -side * distance, -np.inf)
    gap = np.where(sided, side * distance, np.maximum(distance, (1 + 1e-9) * solid.margin + 1e-300))
    return _Nearest(depth, gap, normal, best[:, POINT : POINT + 3], owner, best[:, [U, V]])


def _on_faces(solid: _Solid, best: Array, owner: Index) -> Mask:
    """Which closest points lie on their patches' trimmed faces."""
    out = np.ones(len(best), np.bool_)
    for k, grid in enumerate(solid.grids):
        if grid.region is not None:
            mine = np.flatnonzero(owner == k)
            out[mine] = on_face(grid, best[mine][:, [U, V]])
    return out
