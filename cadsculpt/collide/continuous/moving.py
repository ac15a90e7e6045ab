"""Bodies that move within one step, s from 0 to 1, as continuous collision takes them; and what it keeps of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...errors import GeometryError, InputError
from ...motion.motion import Motion
from ...spline.region import Region
from ..broad import extents_of
from ..cells import span_rectangles
from ..grid import PatchGrid
from ..workspace import Patch, Spans, Workspace, spans_of
from .advance import Queue, Side, Trim, fill
from .swept_boxes import Span

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class SignedDistance(Protocol):
    """An implicit or mesh tool in its own frame."""

    def field(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (n,), negative inside, 1-Lipschitz, and unit outward normal (n, 3) at points (n, 3)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class MovingPatches:
    """B-spline patches whose control points (r, s, 3) go from start[i] to end[i] in straight lines, weights unchanged. The
    same arrays in both places: at rest."""

    grids: tuple[PatchGrid, ...]
    start: tuple[Array, ...]
    end: tuple[Array, ...]

    def __post_init__(self) -> None:
        if not len(self.grids) == len(self.start) == len(self.end):
            raise InputError(f"{len(self.grids)} patches with {len(self.start)} and {len(self.end)} nets")


@dataclass(frozen=True, slots=True, eq=False)
class RigidPatches:
    """A rigid tool of B-spline patches, control points nets[i] (r, s, 3) in its own frame."""

    grids: tuple[PatchGrid, ...]
    nets: tuple[Array, ...]
    motion: Motion

    def __post_init__(self) -> None:
        if len(self.grids) != len(self.nets):
            raise InputError(f"{len(self.grids)} patches with {len(self.nets)} nets")


@dataclass(frozen=True, slots=True, eq=False)
class MovingField:
    """A rigid tool with a signed distance. box (2, 3) : its low and high corner in its own frame; may hold infinities.
    convex : the tool is, so that what lies beyond its nearest point's tangent plane is clear of it."""

    shape: SignedDistance
    box: Array
    motion: Motion
    convex: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class MovingPoint:
    """A point at the origin of a moving frame."""

    motion: Motion


_WHOLE = Trim(False, np.zeros((0, 4)), np.zeros(0), np.zeros((0, 4)), np.zeros((0, 2)), np.zeros(2), np.zeros(2))


def _side(room: int) -> Side:
    def integers(n: int) -> Index:
        return np.zeros(n, np.int64)

    return Side(
        rectangle=np.empty((room, 4)), first=np.empty((room, 4, 3)), last=np.empty((room, 4, 3)),
        sag_first=np.empty(room), sag_last=np.empty(room), child=integers(room), on=integers(room), cut=integers(room),
        centre=np.empty((room, 3)), radius=np.empty(room), made=integers(1),
    )  # fmt: skip


def _queue(room: int) -> Queue:
    a, b = np.zeros(room, np.int64), np.zeros(room, np.int64)
    return Queue(np.empty(room), np.empty(room), np.empty(room), a, b, np.zeros(2, np.int64))


@dataclass(slots=True, eq=False)
class Cover:
    """The cells of one patch, over the nets at both ends of a stretch of time; arrays are kept from step to step."""

    grid: PatchGrid
    region: Region | None = field(init=False)
    trim: Trim = field(init=False)
    side: Side = field(init=False)
    first: Patch = field(init=False)
    last: Patch = field(init=False)
    spans: tuple[Spans, Spans] = field(init=False)
    still: bool = field(init=False, default=False)
    time: Span = field(init=False, default=Span(0.0, 1.0))
    speed: float = field(init=False, default=0.0)
    _ends: tuple[Workspace, Workspace] = field(init=False)

    def __post_init__(self) -> None:
        counters = np.zeros(16, np.int64)
        self._ends = Workspace(self.grid, counters), Workspace(self.grid, counters)
        self.region = r = Region.of(self.grid.surface)
        if r is None:
            self.trim = _WHOLE
        else:
            self.trim = Trim(True, r.chords, r.deviation, r.box, r.shifts, r.low, r.size)
        self.side = _side(2 * int(self.grid.tally[0].prod()) + 1024)

    def load(self, start: Array, end: Array, time: Span) -> None:
        """Take in the nets at both ends of a stretch of time. Raises GeometryError as `Workspace.load` does."""
        self.first = self._ends[0].load(start, paper=False, delta=0.0)
        self.still = start is end or np.array_equal(start, end)
        self.last = self.first if self.still else self._ends[1].load(end, paper=False, delta=0.0)
        self.spans = spans_of(self.first), spans_of(self.last)
        self.time = time
        self.speed = 0.0
        if not self.still:
            step = (end - start).reshape(-1, 3)
            self.speed = float(np.sqrt(np.einsum("ij,ij->i", step, step).max())) / (time.high - time.low)
        spans = span_rectangles(self.first)
        self.side.rectangle[: len(spans)] = spans
        fill(*self.spans, self.still, self.trim, self.side, 0, len(spans))

    @property
    def slack(self) -> float:
        """Rounding of evaluated points, in the scene's unit."""
        return self.first.slack + self.last.slack

    def grow(self) -> None:
        """Twice the room for cells."""
        side = _side(2 * len(self.side.child))
        for new, old in zip(side, self.side, strict=True):
            new[: len(old)] = old
        self.side = side


@dataclass(slots=True, eq=False)
class SweepCache:
    """What continuous collision between two bodies reuses from step to step. Not for two threads.

    It changes how long an answer takes, never the answer.
    """

    covers: dict[tuple[int, int], Cover] = field(default_factory=dict)
    queue: Queue = field(default_factory=lambda: _queue(1024))
    _frame: tuple[tuple[Array, ...], Array, float] | None = None

    def cover(self, body: int, face: int, grid: PatchGrid) -> Cover:
        """The cells of one patch: body 0 is the first, 1 the second."""
        cover = self.covers.get((body, face))
        if cover is None or cover.grid is not grid:
            cover = self.covers[body, face] = Cover(grid)
        return cover

    def grow_queue(self, room: int) -> None:
        """Room for this many pairs at least."""
        queue = _queue(max(room, 2 * len(self.queue.key)))
        for new, old in zip(queue, self.queue, strict=True):
            new[: len(old)] = old
        self.queue = queue

    def frame_box(self, body: RigidPatches) -> tuple[Array, float]:
        """Low and high corner (2, 3) of a rigid tool in its own frame, and the radius around its origin that holds it."""
        known = self._frame
        # only what nobody can change is taken as known
        if known is None or known[0] is not body.nets or any(net.flags.writeable for net in body.nets):
            for grid, net in zip(body.grids, body.nets, strict=True):
                check_net(grid, net, "tool")
            boxes = extents_of(body.nets, "tool")
            radius = max(float(np.sqrt((net * net).sum(axis=2).max())) for net in body.nets)
            known = (body.nets, np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)]), radius)
            self._frame = known
        return known[1], known[2]


def flat_boxes(nets: tuple[Array, ...], whose: str) -> Array:
    """Boxes (n, 6), low and high corner, of nets. Raises GeometryError for one that is not finite."""
    return extents_of(nets, whose).reshape(-1, 6)


def posed_box(motion: Motion, s: float, box: Array) -> Array:
    """The box (1, 6) in the world of a box (2, 3) in a moving frame, at s."""
    return motion.pose(s).box(box).reshape(1, 6)


def swept_box(motion: Motion, box: Array, radius: float, s0: float, s1: float) -> tuple[Array, Array, float]:
    """Boxes (1, 6) at s0 and s1, and a pad: a box in a moving frame stays within the pad of the box between them.

    radius : around the frame's origin, of what is in the box.
    """
    if not np.isfinite(box).all():
        everywhere = np.array([[-1e100] * 3 + [1e100] * 3])
        return everywhere, everywhere, 0.0
    pad = motion.arc(radius, s0, s1)
    if pad < radius:
        return posed_box(motion, s0, box), posed_box(motion, s1, box), pad
    # a long turn: the ball around the origin
    ball = np.array([[-radius] * 3 + [radius] * 3])
    at = [np.tile(motion.start.at + s * motion.displacement, 2) for s in (s0, s1)]
    return ball + at[0], ball + at[1], 0.0


def check_net(grid: PatchGrid, net: Array, whose: str) -> None:
    """Raises GeometryError where a net is not one of the patch."""
    if np.shape(net) != (*grid.surface.shape, 3):
        raise GeometryError(
            f"a net of shape {np.shape(net)} for a surface of {grid.surface.shape} control points", where=f"the {whose}"
        )
