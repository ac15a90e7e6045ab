"""What is asked of a collision detection, and what it answers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from operator import is_
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..spline.region import OFF, ON
from .broad import Extents, fill_near, near_box
from .contacts import ContactBuffer, Contacts
from .grid import PatchGrid
from .shapes import PosedShape, into_frame
from .voxels import Voxels, voxels_about
from .workspace import Patch, Workspace

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Mode = Literal["certified", "paper"]


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


@runtime_checkable
class BoundedField(DistanceField, Protocol):
    """A tool whose exact distance costs a search: `bound` prunes in its stead."""

    def bound(self, points: Array) -> Array:
        """Signed (n,), 1-Lipschitz, nowhere farther from 0 than `distance`, and of the same sign."""
        ...


def lower_bound(field: DistanceField, points: Array) -> Array:
    """What may be relied on to discard: the field's `bound` where it has one, else its distance."""
    return field.bound(points) if isinstance(field, BoundedField) else field.distance(points)


@dataclass(frozen=True, slots=True, eq=False)
class FieldTool:
    """A tool given by its signed distance. shape : the same as a formula that kernels know, where there is one; the
    pipeline then runs in one piece."""

    field: DistanceField
    shape: PosedShape | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PointTool:
    """A point at position (3,). area : the piece of surface that its contact stands for. reach : how far behind the
    nearest face the point may lie and still be in contact with it; give the thickness of a sheet, leave it for a
    solid."""

    position: Array
    area: float
    reach: float = np.inf


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceTool:
    """B-spline patches with their control points (r, s, 3) in the world; each patch's `outward` is out of the tool.

    reach : how deep behind an open tool (a sheet, a cap) a model is still in contact where the two do not cross, as
    when flat is pressed on flat; a sheet of one patch is felt to the depth of a cell in any case. What crosses the
    tool, or lies inside a closed one, is found at any depth.
    """

    grids: tuple[PatchGrid, ...]
    nets: tuple[Array, ...]
    reach: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class RigidSurfaceTool:
    """B-spline patches over their own nets, where they stand: x_world = rotation @ x + at. Otherwise as `SurfaceTool`.

    What is made of the patches is kept as long as the nets stay the same. Triangles that cross are not looked for.
    """

    grids: tuple[PatchGrid, ...]
    rest: tuple[Array, ...]
    at: Array
    rotation: Array
    reach: float = 0.0

    def in_world(self) -> SurfaceTool:
        """The same with its nets in the world."""
        return SurfaceTool(self.grids, tuple(net @ self.rotation.T + self.at for net in self.rest), self.reach)


@dataclass(frozen=True, slots=True)
class DetectOptions:
    """mode : see the module. tolerance : cells whose triangles lie within it of the surface are not refined
    (certified), and prints of tools below it are not looked for, in the scene's unit. delta : angle between normals
    below which the paper mode does not refine, in radians. margin : contacts with depth >= -margin are reported, so
    that what comes near can be watched.
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
            if not 0.0 <= value < math.inf:
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
    """n pairs of triangles that meet, by face, tool and patch of the tool, each in the order of the traversal.

    face (n,) : model patch. tool, tool_face (n,) : tool and its patch. model_triangle, tool_triangle (n, 3) : vertices
    of the finest grids, i n + j. relation (n,) : `tri_tri.Relation`. segment (n, 2, 3) : where they meet; NaN for
    coplanar ones.
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
    def of(cls, key: tuple[int, int, int], triangles: Index, relation: Index, segments: Array) -> Crossings:
        """Those of one pair of patches (face, tool, patch of the tool): vertices (n, 6) of both triangles, segments (n,
        6)."""
        face, tool, patch = (np.full(len(relation), value, dtype=np.int64) for value in key)
        return cls(face, tool, patch, triangles[:, :3], triangles[:, 3:], relation, segments.reshape(-1, 2, 3))

    @classmethod
    def joined(cls, parts: Sequence[Crossings]) -> Crossings:
        """All crossings of several sets."""
        i, t = np.zeros(0, np.int64), np.zeros((0, 3), np.int64)
        parts = [part for part in parts if len(part)] or [cls(i, i, i, t, t, i, np.zeros((0, 2, 3)))]
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))


NO_CROSSINGS = Crossings.joined([])


@dataclass(frozen=True, slots=True)
class Undecided:
    """A tool so near a face between the grid's vertices, over so wide a piece of it, that the search was given up: a
    contact up to `depth` deep may not be among those found."""

    body: int
    tool: int
    face: int
    depth: float


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """contacts : with all tools. counters : work done. crossings : triangles that meet, of surface tools. undecided :
    where contacts may lack; empty where nothing deeper than the tolerance can have been missed."""

    contacts: Contacts
    counters: Counters
    crossings: Crossings = field(default_factory=lambda: NO_CROSSINGS)
    undecided: tuple[Undecided, ...] = ()


@dataclass(slots=True, eq=False)
class DetectCache:
    """What one body's detections reuse from call to call: workspaces, and the last separating axes. Not for two
    threads.

    It changes how long a detection takes and what it counts, never its contacts.
    """

    counters: Index = field(default_factory=lambda: np.zeros(len(fields(Counters)), dtype=np.int64))
    workspaces: dict[tuple[int, int], Workspace] = field(default_factory=dict)
    axes: dict[tuple[int, int, int], Array] = field(default_factory=dict)
    extents: dict[int, Extents] = field(default_factory=dict)
    grids: tuple[PatchGrid, ...] = ()
    fewest: int = 1
    local: dict[tuple[int, int], Array] = field(default_factory=dict)
    near: Index = field(default_factory=lambda: np.empty(0, np.int64))
    box: Array = field(default_factory=lambda: np.empty((2, 3)))
    voxels: dict[int, tuple[Workspace, int, Voxels]] = field(default_factory=dict)

    def boxes(self, key: int, nets: Sequence[Array], whose: str) -> Array:
        """Boxes (n, 2, 3) of nets: key is -1 for the model's, else the tool. Raises GeometryError for one that is not
        finite."""
        if key not in self.extents:
            self.extents[key] = Extents()
        return self.extents[key].of(nets, whose)

    def fewest_cells(self, grids: Sequence[PatchGrid]) -> int:
        """The fewest cells along a side of any of the grids."""
        if len(grids) != len(self.grids) or not all(map(is_, grids, self.grids)):
            self.grids = tuple(grids)
            self.fewest = min((max(min(grid.shape) - 1, 1) for grid in grids), default=1)
        return self.fewest

    def workspace(self, key: tuple[int, int], grid: PatchGrid) -> Workspace:
        """The workspace of one patch: key is (-1, face) for the model's, (tool, patch) for a tool's."""
        work = self.workspaces.get(key)
        if work is None or work.grid is not grid:
            work = self.workspaces[key] = Workspace(grid, self.counters)
        return work

    def voxels_of(self, tool: int, work: Workspace) -> Voxels:
        """The voxels about a tool of one patch, of the size of its finest cells."""
        kept = self.voxels.get(tool)
        if kept is None or kept[0] is not work or kept[1] != work.patch.tick:
            edge = max(math.dist(*work.extent.tolist()), 1e-300) / max(min(work.grid.shape) - 1, 1)
            same = kept[2] if kept is not None and kept[0] is work else None
            kept = work, work.patch.tick, voxels_about(work.extent, edge, int(work.grid.offset[-1]), same)
            self.voxels[tool] = kept
        return kept[2]


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One call of `detect`: what its parts share. extents (n, 2, 3) : boxes of the model's nets. out, undecided : filled by
    them. faces, others : what the contacts call the patches and the tools."""

    grids: Sequence[PatchGrid]
    nets: Sequence[Array]
    options: DetectOptions
    cache: DetectCache
    body: int
    extents: Array
    out: ContactBuffer
    faces: Sequence[int]
    others: Sequence[int]
    undecided: list[Undecided] = field(default_factory=list)

    @property
    def paper(self) -> bool:
        return self.options.mode == "paper"

    def load(self, key: tuple[int, int], grid: PatchGrid, net: Array) -> tuple[Workspace, Patch]:
        work = self.cache.workspace(key, grid)
        return work, work.load(net, paper=self.paper, delta=self.options.delta if self.paper else 0.0)

    def model(self, face: int) -> tuple[Workspace, Patch]:
        return self.load((-1, face), self.grids[face], self.nets[face])

    def cell_size(self, face: int) -> float:
        """About the diagonal of a finest cell of one of the model's patches."""
        return math.dist(*self.extents[face].tolist()) / max(min(self.grids[face].shape) - 1, 1)

    def model_in_frame(self, face: int, tool: int, at: Array, turn: Array) -> tuple[Workspace, Patch]:
        """A model's patch in the frame of a tool, x_world = turn x + at."""
        net = self.nets[face]
        local = self.cache.local.get((tool, face))
        if local is None or local.shape != net.shape:
            local = self.cache.local[tool, face] = np.empty(net.shape)
        local[...] = net
        into_frame(local, at, turn)
        return self.load((-2 - tool, face), self.grids[face], local)

    def near(self, low: Array, high: Array, margin: float, *, felt: bool = False) -> Index:
        """The model's patches whose boxes come within the margin of a box; felt : and within the size of their cells."""
        self.cache.counters[0] += len(self.extents)
        return near_box(self.extents, low, high, margin, 1.0 / self.cache.fewest_cells(self.grids) if felt else 0.0)

    def near_posed(self, margin: float, *, felt: bool = False) -> int:
        """How many of the model's patches have boxes that come within the margin of `cache.box`, or with `felt` within the
        size of their cells beside: the first in `cache.near`."""
        cache = self.cache
        if len(cache.near) < len(self.extents):
            cache.near = np.empty(len(self.extents), np.int64)
        cache.counters[0] += len(self.extents)
        diagonals = 1.0 / cache.fewest_cells(self.grids) if felt else 0.0
        return int(fill_near(self.extents, cache.box[0], cache.box[1], margin, diagonals, cache.near))

    def give_up(self, tool: int, face: int, depth: float) -> None:
        """Note that a contact up to `depth` deep may be missed; nothing where it is 0."""
        if depth > 0:
            self.undecided.append(Undecided(self.body, tool, face, depth))

    def rows(
        self,
        tool: int,
        face: int,
        uv: Array,
        point: Array,
        normal: Array,
        depth: Array,
        area: Array,
        tool_point: Array,
        on_tool: tuple[Index, Array] | None = None,
    ) -> Contacts:
        """Contacts of one patch with one tool: those with depth >= -margin. NaN is an error, not "clear".

        on_tool : for a tool of patches, the patch (n,) and the parameters (n, 2) of each tool_point.
        """
        if on_tool is None:
            on_tool = np.full(len(depth), -1, dtype=np.int64), np.full((len(depth), 2), np.nan)
        tool_face, tool_uv = on_tool
        if np.isnan(depth).any():
            raise InputError("a distance to the tool is not a number", where=f"tool {tool}")
        keep = depth >= -self.options.margin
        if not keep.all():
            uv, point, normal, tool_point = uv[keep], point[keep], normal[keep], tool_point[keep]
            depth, area, tool_face, tool_uv = depth[keep], area[keep], tool_face[keep], tool_uv[keep]
        a, b, c = (
            np.full(len(depth), value, dtype=np.int64) for value in (self.body, self.others[tool], self.faces[face])
        )
        u, v, tool_u, tool_v = (np.ascontiguousarray(x) for x in (uv[:, 0], uv[:, 1], tool_uv[:, 0], tool_uv[:, 1]))
        return Contacts(a, b, c, u, v, point, normal, depth, area, tool_point, tool_face, tool_u, tool_v)


def on_face(grid: PatchGrid, uv: Array) -> Mask:
    """Which of the points uv (n, 2) lie on the trimmed face or its border: by the grid inside whole cells, by the trim
    curves elsewhere."""
    if grid.region is None or grid.pieces is None:
        return np.ones(len(uv), dtype=np.bool_)
    i = np.clip(np.searchsorted(grid.matrices.u, uv[:, 0], side="right") - 1, 0, grid.shape[0] - 2)
    j = np.clip(np.searchsorted(grid.matrices.v, uv[:, 1], side="right") - 1, 0, grid.shape[1] - 2)
    out: Mask = grid.pieces[i, j] == ON
    # (a point on the border between two cells may be on the face although the cell taken is off it)
    rest = np.flatnonzero(~out)
    out[rest] = grid.region.locate(uv[rest]) != OFF
    return out


def finest_size(run: Run, g: Patch) -> float:
    """The size below which nothing is looked for: the tolerance, or a thousandth of a mean cell where there is none."""
    if run.options.tolerance > 0:
        return run.options.tolerance
    size = float(np.linalg.norm(g.box[:, 3:] - g.box[:, :3], axis=1).mean())
    return float(max(1e-3 * size * g.tally[0, 0] / g.tally[-1, 0], 16.0 * g.slack))
