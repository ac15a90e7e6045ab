"""B-spline bodies as certified distance and proximity take them: patches loaded when something comes near them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...spline.region import MIXED, Region
from ..broad import extents_of
from ..cells import Cells, halves, kept_cells, span_rectangles
from ..grid import PatchGrid
from ..query import SurfaceTool
from ..workspace import Patch, Workspace
from .face_hulls import POINTS, face_hulls

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(slots=True, eq=False)
class GridCache:
    """What does not change with the control points, and what may not: regions of trimmed faces, and workspaces. Give the
    same one to calls about the same grids; not for two threads. It changes how long a call takes, never its result."""

    _regions: dict[int, tuple[PatchGrid, Region | None]] = field(default_factory=dict)
    _workspaces: dict[tuple[str, int, int], tuple[PatchGrid, Workspace]] = field(default_factory=dict)

    def region(self, grid: PatchGrid) -> Region | None:
        """Where the face of a grid's surface lies in (u, v)."""
        held = self._regions.get(id(grid))
        if held is None or held[0] is not grid:
            held = self._regions[id(grid)] = (grid, Region.of(grid.surface))
        return held[1]

    def workspace(self, whose: str, place: int, grid: PatchGrid) -> Workspace:
        """The workspace of a body's patch at its place."""
        key = (whose, place, id(grid))
        held = self._workspaces.get(key)
        if held is None or held[0] is not grid:
            held = self._workspaces[key] = (grid, Workspace(grid, np.zeros(16, np.int64)))
        return held[1]


@dataclass(slots=True, eq=False)
class SurfaceBody:
    """The patches of one B-spline body. extents (n, 2, 3) : the boxes of their nets."""

    tool: SurfaceTool
    whose: str
    cache: GridCache
    extents: Array = field(init=False)
    _loaded: dict[int, Workspace] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.extents = extents_of(self.tool.nets, self.whose)

    def workspace(self, k: int) -> Workspace:
        """The loaded workspace of patch k."""
        work = self._loaded.get(k)
        if work is None:
            work = self.cache.workspace(self.whose, k, self.tool.grids[k])
            work.load(self.tool.nets[k], paper=False, delta=0.0)
            self._loaded[k] = work
        return work

    def patch(self, k: int) -> Patch:
        """Patch k over its net."""
        return self.workspace(k).patch

    def region(self, k: int) -> Region | None:
        """Where the face of patch k lies in (u, v); None where it is the whole domain."""
        grid = self.tool.grids[k]
        return None if grid.surface.trims is None else self.cache.region(grid)

    @property
    def box(self) -> Array:
        """(2, 3): low and high corner of all nets."""
        return np.stack([self.extents[:, 0].min(axis=0), self.extents[:, 1].max(axis=0)])

    @property
    def size(self) -> float:
        """Diagonal of the box."""
        low, high = self.box
        return float(np.linalg.norm(high - low))


@dataclass(slots=True, eq=False)
class CellStore:
    """Cells of a body's patches, as they are made. patch (n,) : whose; hull (n, 4 or POINTS, 3) : the corners, or points
    about the face where its border runs through the cell; grown (n,) : the face lies within it of the hull; ball (n, 4) :
    centre and radius in one; doubt (n,) : how far the hull may lie from a point of the face, the part of a pair's error
    that cutting the cell makes smaller."""

    body: SurfaceBody
    patch: Index = field(default_factory=lambda: np.zeros(0, np.int64))
    rectangle: Array = field(default_factory=lambda: np.zeros((0, 4)))
    corners: Array = field(default_factory=lambda: np.zeros((0, 4, 3)))
    sag: Array = field(default_factory=lambda: np.zeros(0))
    hull: Array = field(init=False)
    grown: Array = field(default_factory=lambda: np.zeros(0))
    ball: Array = field(default_factory=lambda: np.zeros((0, 4)))
    cut: Index = field(default_factory=lambda: np.zeros(0, np.int64))
    on: Index = field(default_factory=lambda: np.zeros(0, np.int64))
    doubt: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        trimmed = any(grid.surface.trims is not None for grid in self.body.tool.grids)
        self.hull = np.zeros((0, POINTS if trimmed else 4, 3))

    def spans(self, k: int) -> Index:
        """The places of the cells of all spans of patch k, made now; none where the face lies in no span."""
        return self._add(k, span_rectangles(self.body.patch(k)))[0]

    def _add(self, k: int, rectangle: Array) -> tuple[Index, Index]:
        """New cells of patch k: their places, and which of the rectangles (n, 4) they are over."""
        region = self.body.region(k)
        cells, kept = kept_cells(self.body.patch(k), region, rectangle)
        c = cells.corners
        twist = 0.25 * np.linalg.norm(c[:, 0] - c[:, 1] - c[:, 2] + c[:, 3], axis=1)
        doubt = cells.sag + twist
        # a corner more than once is the same hull
        hull, grown = np.concatenate([c, c[:, : self.hull.shape[1] - 4]], axis=1), cells.sag.copy()
        mixed = np.flatnonzero(cells.on == MIXED)
        if region is not None and len(mixed):
            hull[mixed], grown[mixed], beside = face_hulls(
                self.body.patch(k), region, cells.rectangle[mixed], c[mixed], cells.sag[mixed]
            )
            doubt[mixed] = grown[mixed] + twist[mixed] + np.minimum(1.0, 2.0 * beside) * cells.radius[mixed]
        ball = np.concatenate([cells.centre, cells.radius[:, None]], axis=1)
        first = len(self.sag)
        for name, value in (
            ("patch", np.full(len(kept), k)), ("rectangle", cells.rectangle), ("corners", c), ("sag", cells.sag),
            ("hull", hull), ("grown", grown), ("ball", ball), ("cut", cells.cut), ("on", cells.on), ("doubt", doubt),
        ):  # fmt: skip
            setattr(self, name, np.concatenate([getattr(self, name), value]))
        return np.arange(first, first + len(kept)), kept

    def cells(self, at: Index) -> Cells:
        """The cells at these places."""
        return Cells(
            self.rectangle[at], self.corners[at], self.sag[at], self.ball[at, :3], self.ball[at, 3], self.cut[at],
            self.on[at],
        )  # fmt: skip

    def only(self, at: Index) -> None:
        """Forget all cells but these, which take the places 0, 1, ..."""
        for name in ("patch", "rectangle", "corners", "sag", "hull", "grown", "ball", "cut", "on", "doubt"):
            setattr(self, name, np.ascontiguousarray(getattr(self, name)[at]))

    def halve(self, at: Index) -> tuple[Index, Index]:
        """Cut the cells at these places (m,) in halves. The children of the k-th are places[first[k] : first[k + 1]]."""
        places, owners = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for k in np.unique(self.patch[at]).tolist():
            mine = np.flatnonzero(self.patch[at] == k)
            rectangle, owner = halves(self.cells(at[mine]))
            place, kept = self._add(k, rectangle)
            places.append(place)
            owners.append(mine[owner[kept]])
        place, owner = np.concatenate(places), np.concatenate(owners)
        order = np.argsort(owner, kind="stable")
        return np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=len(at)))]), place[order]
