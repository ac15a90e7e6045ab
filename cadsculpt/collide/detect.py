"""The collision pipeline in the paper's order (sections 4.1 to 4.7, 4.9): cull, window, spheres, triangles, contacts.

| tool | pipeline |
|---|---|
| surface (4.3 to 4.7) | hulls, window on both sides, spheres of both refined together, triangles, triangle tests, contacts |
| implicit (4.9.1) | hull against the tool, window, spheres against its distance, contacts at the vertices |
| point (4.9.2) | hull, spheres of the model that the point is nearest to, the closest point in what is left |

`mode="paper"` leaves out what goes beyond the paper: the sag in the spheres' radii, the conservative window, contacts of
tools smaller than a cell, containment. Conventions: see `contacts`. Depth is positive inside; the normal points out of the
model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError, InputError
from . import hull, levels, quadrature
from .closest import BORDER, DISTANCE, NORMAL, NOTHING, POINT, PROPER, U, V, project
from .contacts import Contacts
from .crossing import crossing_triangles
from .grid import Patch, PatchGrid, Workspace, extent_of, make_points
from .triangulate import triangulate

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Mode = Literal["certified", "paper"]

EDGE = 1e-5
"""Two tool patches share an edge where their closest points agree to this fraction of the tool's size (CAD's own gaps)."""


class DistanceField(Protocol):
    """An implicit tool, posed in the world."""

    def distance(self, points: Array) -> Array:
        """Signed distance (n,) at points (n, 3), negative inside, 1-Lipschitz."""
        ...

    def gradient(self, points: Array) -> Array:
        """Unit normal (n, 3) of the tool, outward, at the point of its surface nearest to each of (n, 3)."""
        ...

    def nearest(self, points: Array) -> Array:
        """The nearest points (n, 3) of the tool's surface to points (n, 3)."""
        ...

    def box(self) -> Array:
        """Low and high corner (2, 3) of the tool in the world; may hold infinities."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class FieldTool:
    """A tool given by its signed distance."""

    field: DistanceField


@dataclass(frozen=True, slots=True, eq=False)
class PointTool:
    """A point at position (3,). area : the piece of surface that its contact stands for. reach : how far behind the nearest
    face the point may lie and still be in contact with it; give the thickness of a sheet, leave it for a solid."""

    position: Array
    area: float
    reach: float = np.inf


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceTool:
    """B-spline patches with their control points (r, s, 3) in the world; each patch's `outward` is out of the tool."""

    grids: tuple[PatchGrid, ...]
    nets: tuple[Array, ...]


@dataclass(frozen=True, slots=True)
class DetectOptions:
    """mode : see the module. tolerance : cells whose triangles lie within it of the surface are not refined (certified), and
    prints of tools below it are not looked for, in the scene's unit. delta : angle between normals below which the paper mode
    does not refine, in radians. margin : contacts with depth >= -margin are reported, so that what comes near can be watched.
    """

    mode: Mode = "certified"
    tolerance: float = 0.0
    delta: float = float(np.radians(0.5))
    margin: float = 0.0

    def __post_init__(self) -> None:
        if self.mode not in ("certified", "paper"):
            raise InputError(f"collision mode {self.mode!r}", mend="use certified or paper")
        for name in ("tolerance", "delta", "margin"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"a collision {name} of {value}", mend="give a number that is not negative")


@dataclass(slots=True)
class Counters:
    """What the pipeline did, counted: the operations of the paper's figures 8 and 9."""

    hull_tests: int = 0
    spans: int = 0
    points: int = 0
    spheres: int = 0
    sphere_tests: int = 0
    triangles: int = 0
    triangle_tests: int = 0
    crossing_pairs: int = 0
    levels: int = 0

    def add(self, other: Counters) -> None:
        """Add another count to this one."""
        for f in fields(self):
            setattr(self, f.name, getattr(self, f.name) + getattr(other, f.name))


@dataclass(frozen=True, slots=True, eq=False)
class Crossings:
    """n pairs of triangles that meet, in a fixed order.

    face (n,) : model patch. tool, tool_face (n,) : tool and its patch. model_triangle, tool_triangle (n, 3) : vertices of the
    finest grids, i n + j. relation (n,) : `tri_tri.Relation`. segment (n, 2, 3) : where they meet; NaN for coplanar ones.
    """

    face: Index
    tool: Index
    tool_face: Index
    model_triangle: Index
    tool_triangle: Index
    relation: Index
    segment: Array

    def __len__(self) -> int:
        return len(self.face)

    @classmethod
    def joined(cls, parts: Sequence[Crossings]) -> Crossings:
        """All crossings of several sets, sorted."""
        i, t = np.zeros(0, np.int64), np.zeros((0, 3), np.int64)
        parts = [part for part in parts if len(part)] or [cls(i, i, i, t, t, i, np.zeros((0, 2, 3)))]
        columns = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)}
        keys = [columns[name] for name in ("face", "tool", "tool_face")]
        keys += [*columns["model_triangle"].T, *columns["tool_triangle"].T]
        order = np.lexsort(keys[::-1])
        return cls(**{name: np.ascontiguousarray(value[order]) for name, value in columns.items()})


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """contacts : with all tools. counters : work done. crossings : triangles that meet, of surface tools."""

    contacts: Contacts
    counters: Counters
    crossings: Crossings = field(default_factory=lambda: Crossings.joined([]))


@dataclass(slots=True, eq=False)
class DetectCache:
    """What one body's detections reuse from call to call: workspaces, and the last separating axes. Not for two threads.

    It changes how long a detection takes and what it counts, never its contacts.
    """

    counters: Index = field(default_factory=lambda: np.zeros(len(fields(Counters)), dtype=np.int64))
    workspaces: dict[tuple[int, int], Workspace] = field(default_factory=dict)
    axes: dict[tuple[int, int, int], Array] = field(default_factory=dict)

    def workspace(self, key: tuple[int, int], grid: PatchGrid) -> Workspace:
        """The workspace of one patch: key is (-1, face) for the model's, (tool, patch) for a tool's."""
        work = self.workspaces.get(key)
        if work is None or work.grid is not grid:
            work = self.workspaces[key] = Workspace(grid, self.counters)
        return work


def detect(
    grids: Sequence[PatchGrid],
    nets: Sequence[Array],
    tools: Sequence[FieldTool | PointTool | SurfaceTool],
    options: DetectOptions,
    *,
    body: int = 0,
    cache: DetectCache | None = None,
) -> Detection:
    """Contacts of one body's patches, over control points nets[i] (r, s, 3), with tools.

    In the result a is `body`, b the tool's place in `tools`, face the patch's in `grids`. Raises GeometryError for control
    points, InputError for a tool, that are not finite.
    """
    cache = DetectCache() if cache is None else cache
    cache.counters[:] = 0
    run = _Run(grids, nets, options, cache, body, _extents(nets, "model"))
    contacts, crossings = [], []
    for index, tool in enumerate(tools):
        if isinstance(tool, FieldTool):
            contacts += _field_contacts(run, index, tool)
        elif isinstance(tool, PointTool):
            contacts += _point_contacts(run, index, tool)
        else:
            found, crossed = _surface_contacts(run, index, tool)
            contacts += found
            crossings += crossed
    # parts come in the order of tools and faces, each in that of (u, v): one alone needs no sorting
    joined = contacts[0] if len(contacts) == 1 else Contacts.joined(contacts)
    return Detection(
        joined, Counters(*(int(c) for c in cache.counters)), Crossings.joined(crossings)
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """One call of `detect`."""

    grids: Sequence[PatchGrid]
    nets: Sequence[Array]
    options: DetectOptions
    cache: DetectCache
    body: int
    extents: Array

    @property
    def paper(self) -> bool:
        return self.options.mode == "paper"

    def load(self, key: tuple[int, int], grid: PatchGrid, net: Array) -> tuple[Workspace, Patch]:
        work = self.cache.workspace(key, grid)
        return work, work.load(net, paper=self.paper, delta=self.options.delta if self.paper else 0.0)

    def model(self, face: int) -> tuple[Workspace, Patch]:
        return self.load((-1, face), self.grids[face], self.nets[face])

    def near(self, low: Array, high: Array) -> Index:
        """The model's patches whose boxes come within the margin of a box."""
        self.cache.counters[0] += len(self.extents)
        margin = self.options.margin
        meets = (self.extents[:, 0] <= high + margin) & (self.extents[:, 1] >= low - margin)
        return np.flatnonzero(meets.all(axis=1))

    def rows(
        self, tool: int, face: int, uv: Array, point: Array, normal: Array, depth: Array, area: Array, tool_point: Array
    ) -> Contacts:
        """Contacts of one patch with one tool: those with depth >= -margin. NaN is an error, not "clear"."""
        if np.isnan(depth).any():
            raise InputError("a distance to the tool is not a number", where=f"tool {tool}")
        keep = depth >= -self.options.margin
        if not keep.all():
            uv, point, normal, tool_point = uv[keep], point[keep], normal[keep], tool_point[keep]
            depth, area = depth[keep], area[keep]
        a, b, c = (np.full(len(depth), value, dtype=np.int64) for value in (self.body, tool, face))
        u, v = np.ascontiguousarray(uv[:, 0]), np.ascontiguousarray(uv[:, 1])
        return Contacts(a, b, c, u, v, point, normal, depth, area, tool_point)


def _extents(nets: Sequence[Array], whose: str) -> Array:
    """Boxes (n, 2, 3) of nets. Raises GeometryError for one that is not finite."""
    out = np.empty((len(nets), 2, 3))
    for k, net in enumerate(nets):
        extent_of(net if net.flags.writeable and net.flags.c_contiguous else np.array(net, dtype=np.float64), out[k])
    if not np.isfinite(out).all():
        k = int(np.flatnonzero(~np.isfinite(out).all(axis=(1, 2)))[0])
        raise GeometryError("a control point is not finite", where=f"patch {k} of the {whose}")
    return out


def _on_face(grid: PatchGrid, uv: Array) -> Mask:
    """Which of the points uv (n, 2) lie on the trimmed face: by the grid inside whole cells, by the trim curves elsewhere."""
    if grid.inside is None:
        return np.ones(len(uv), dtype=np.bool_)
    from ..spline.trim import inside

    i = np.clip(np.searchsorted(grid.matrices.u, uv[:, 0], side="right") - 1, 0, grid.shape[0] - 2)
    j = np.clip(np.searchsorted(grid.matrices.v, uv[:, 1], side="right") - 1, 0, grid.shape[1] - 2)
    corners = np.stack([grid.inside[i + a, j + b] for a in (0, 1) for b in (0, 1)])
    out = corners.all(axis=0)
    for k in np.flatnonzero(corners.any(axis=0) & ~out):
        out[k] = inside(grid.surface, uv[k, :1], uv[k, 1:])[0, 0]
    return out


# ------------------------------------------------------------------ 4.9.1


def _field_contacts(run: _Run, index: int, tool: FieldTool) -> list[Contacts]:
    """Implicit Surface Tool (4.9.1): the points generated in the window go into the tool's equation."""
    box = np.asarray(tool.field.box(), dtype=np.float64)
    if np.isnan(box).any():
        raise InputError("the tool's box is not a number", where=f"tool {index}")
    parts = []
    for face in run.near(box[0], box[1]):
        work, g = run.model(int(face))
        cells = _field_cells(run, g, work, tool.field)
        if not len(cells):
            continue
        margin = run.options.margin
        names = np.sort(levels.vertices_of(g, cells, work.new_mark()))
        depth = -tool.field.distance(g.points[names])
        hit = ~(depth < -margin)
        if hit.any():
            uv, points, area = quadrature.vertex_rows(g, names[hit])
            parts.append(_field_rows(run, index, int(face), tool.field, uv, points, depth[hit], area))
        if run.paper:
            continue
        # cells that the tool may reach between the vertices, away from those it is known to touch
        left = quadrature.unresolved(g, cells, margin, names, depth, work.new_mark())
        if len(left):
            uv, points, area = quadrature.below_grid(g, left, tool.field.distance, margin, _finest(run, g))
            on = _on_face(run.grids[face], uv)
            if on.any():
                uv, points, area = uv[on], points[on], area[on]
                depth = -tool.field.distance(points)
                parts.append(_field_rows(run, index, int(face), tool.field, uv, points, depth, area))
    return parts


def _field_cells(run: _Run, g: Patch, work: Workspace, tool: DistanceField) -> Index:
    """The cells left by the loop of 4.5, starting from the window of 4.4."""
    if run.paper:

        def meets(facets: Array) -> Mask:
            centre = facets.mean(axis=1)
            return tool.distance(centre) <= np.linalg.norm(facets - centre[:, None], axis=2).max(axis=1)

        centre = 0.5 * (work.extent[0] + work.extent[1])
        within = bool(tool.distance(centre[None])[0] <= 0.5 * np.linalg.norm(work.extent[1] - work.extent[0]))
        window = hull.paper_window(work.grid.surface, g, meets, within)
    else:
        window = levels.ALL_SPANS
    cells, centre, radius = levels.covered_spans(g, window)
    ended = len(cells) == 0
    while not ended:
        cells, centre, radius, ended = levels.refine(g, cells, tool.distance(centre), run.options.margin)
    return cells


def _field_rows(
    run: _Run, index: int, face: int, tool: DistanceField, uv: Array, points: Array, depth: Array, area: Array
) -> Contacts:
    return run.rows(index, face, uv, points, -tool.gradient(points), depth, area, tool.nearest(points))


def _finest(run: _Run, g: Patch) -> float:
    """The size below which nothing is looked for: the tolerance, or a thousandth of a mean cell where there is none."""
    if run.options.tolerance > 0:
        return run.options.tolerance
    size = float(np.linalg.norm(g.box[:, 3:] - g.box[:, :3], axis=1).mean())
    return max(1e-3 * size * (g.count[0, 0] / g.count[-1, 0]), 16.0 * g.slack)


# ---------------------------------------------------------------- surfaces


def _surface_contacts(run: _Run, index: int, tool: SurfaceTool) -> tuple[list[Contacts], list[Crossings]]:
    """B-spline tools (4.3 to 4.7): both sides are discretized and refined together."""
    extents = _extents(tool.nets, f"tool {index}")
    low, high = extents[:, 0].min(axis=0), extents[:, 1].max(axis=0)
    size = float(np.linalg.norm(high - low))
    contacts: list[Contacts] = []
    crossings: list[Crossings] = []
    for face in run.near(low, high):
        work, g = run.model(int(face))
        model_low, model_high = run.extents[face] + np.array([[-1.0], [1.0]]) * run.options.margin
        meets = ((extents[:, 0] <= model_high) & (extents[:, 1] >= model_low)).all(axis=1)
        cells: list[Index] = []
        culled = True
        for k in np.flatnonzero(meets):
            other, h = run.load((index, int(k)), tool.grids[k], tool.nets[k])
            spans = _span_pairs(run, (int(face), index, int(k)), work, g, other, h)
            if spans is None:
                continue
            culled = False
            if not len(spans):
                continue
            tolerance = 0.0 if run.paper else run.options.tolerance
            mine, its, pairs = levels.traverse(
                g, h, spans, run.options.margin, tolerance, work.new_mark(), other.new_mark()
            )
            if not len(pairs):
                continue
            cells.append(mine)
            crossings += _crossings(int(face), index, int(k), work, g, mine, other, h, its, pairs)
        if culled:
            continue
        patches = [run.load((index, k), grid, net)[1] for k, (grid, net) in enumerate(zip(tool.grids, tool.nets, strict=True))]
        contacts += _closest_contacts(run, index, int(face), tool, work, g, patches, cells, EDGE * size)
    return contacts, crossings


def _span_pairs(
    run: _Run, key: tuple[int, int, int], work: Workspace, g: Patch, other: Workspace, h: Patch
) -> Index | None:
    """Hull against hull (4.3), then the window (4.4) as pairs of spans; None when the hulls are apart."""
    run.cache.counters[0] += 1
    axis = run.cache.axes.setdefault(key, np.zeros(3))
    mine, its = (np.ascontiguousarray(p.net[..., :3] / p.net[..., 3:]).reshape(-1, 3) for p in (g, h))
    if hull.apart(mine, its, axis, run.options.margin):
        return None
    if run.paper:
        windows = []
        for own, patch, away in ((work, g, its), (other, h, mine)):

            def meets(facets: Array, away: Array = away) -> Mask:
                return np.array([not hull.apart(np.ascontiguousarray(f), away, np.zeros(3), 0.0) for f in facets])

            windows.append(np.flatnonzero(hull.paper_window(own.grid.surface, patch, meets, True) & own.grid.covers[: len(patch.box)]))
        for patch in (g, h):
            levels.covered_spans(patch, levels.ALL_SPANS)
        return np.stack(np.meshgrid(*windows, indexing="ij"), axis=-1).reshape(-1, 2)
    for patch in (g, h):
        levels.covered_spans(patch, levels.ALL_SPANS)
    pairs = np.empty((1024, 2), np.int64)
    count = hull.span_pairs(g, h, run.options.margin, pairs)
    if count > len(pairs):
        pairs = np.empty((count, 2), np.int64)
        hull.span_pairs(g, h, run.options.margin, pairs)
    return pairs[:count]


def _crossings(
    face: int, index: int, k: int, work: Workspace, g: Patch, mine: Index, other: Workspace, h: Patch, its: Index, pairs: Index
) -> list[Crossings]:
    """Triangulation (4.6) and triangle tests (4.7) over the cells left."""
    tri_a, first_a = triangulate(g, mine, len(mine), work.new_mark())
    tri_b, first_b = triangulate(h, its, len(its), other.new_mark())
    found, segments = crossing_triangles(g, tri_a, first_a, h, tri_b, first_b, pairs)
    if not len(found):
        return []
    full = lambda value: np.full(len(found), value, dtype=np.int64)  # noqa: E731
    return [
        Crossings(
            full(face), full(index), full(k), tri_a[found[:, 0]], tri_b[found[:, 1]], found[:, 2], segments.reshape(-1, 2, 3)
        )
    ]


def _closest_contacts(
    run: _Run, index: int, face: int, tool: SurfaceTool, work: Workspace, g: Patch, patches: list[Patch],
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

        uv, points, area = quadrature.below_grid(g, left, distance, margin, _finest(run, g))
        on = _on_face(run.grids[face], uv)
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
            away = ~_on_face(grid, best[mine][:, [U, V]])
            depth[mine[away]] = -np.inf
    return _Nearest(depth, normal, best[:, POINT : POINT + 3])


# ------------------------------------------------------------------ 4.9.2


def _point_contacts(run: _Run, index: int, tool: PointTool) -> list[Contacts]:
    """Point-based Tool (4.9.2): the model's cells nearest to the point, and there its closest point on the surface."""
    position = np.asarray(tool.position, dtype=np.float64).reshape(3)
    if not np.isfinite(position).all():
        raise InputError(f"a point tool at {position}", where=f"tool {index}")
    reach = max(tool.reach, run.options.margin)
    gaps = np.maximum(0.0, np.maximum(run.extents[:, 0] - position, position - run.extents[:, 1]))
    near = np.flatnonzero(np.linalg.norm(gaps, axis=1) <= reach)
    run.cache.counters[0] += len(run.extents)
    best = np.full((1, 9), np.inf)
    state, owner = np.zeros(1, np.int64), np.full(1, -1, dtype=np.int64)
    size = float(np.linalg.norm(run.extents[:, 1].max(axis=0) - run.extents[:, 0].min(axis=0))) if len(near) else 0.0
    group = np.array([0, 1])
    for face in near:
        work, g = run.model(int(face))
        before = best.copy(), state.copy(), owner.copy()
        project(g, position[None], group, EDGE * size, np.inf, int(face), best, state, owner)
        if owner[0] == face and not _on_face(run.grids[face], best[:, [U, V]])[0]:
            best, state, owner = before  # trimmed away there
    if state[0] in (NOTHING, BORDER):
        return []
    point, total = best[:, POINT : POINT + 3], best[:, NORMAL : NORMAL + 3]
    normal = total / np.linalg.norm(total)
    depth = -np.sign(((position - point) * normal).sum(axis=1)) * best[:, DISTANCE]
    if depth[0] > tool.reach:
        return []
    if run.paper and not _in_sphere(run, int(owner[0]), position):
        return []
    return [
        run.rows(
            index, int(owner[0]), best[:, [U, V]], point, normal, depth, np.array([float(tool.area)]), position[None]
        )
    ]


def _in_sphere(run: _Run, face: int, position: Array) -> bool:
    """The paper's own condition: the point lies in a sphere of every level, down to the finest."""
    _, g = run.model(face)
    cells, centre, _ = levels.covered_spans(g, levels.ALL_SPANS)
    ended = False
    while not ended and len(cells):
        distance = np.linalg.norm(centre - position, axis=1)
        cells, centre, _, ended = levels.refine(g, cells, distance, run.options.margin)
    return len(cells) > 0


