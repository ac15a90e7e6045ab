"""Continuous collision (method: conservative advancement): the time of first contact between two bodies within a step.

Control points move in straight lines, tools along a rigid motion, s from 0 to 1. What comes out is certified on one side:
before `low` nothing touches, however fast anything moves; at `high` the two are within the tolerance. `advance` has the
method for patches against patches, `sweep_field` for tools with a signed distance; a point is a patch without extent.

Distances are those between surfaces: a body that lies wholly inside another one is clear of its surface, but not of a
signed distance. Points of rigid patches run on arcs; time is cut so that these stay within a quarter of the tolerance
of their chords where it matters, and coarser where it does not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache as once

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...motion.motion import Motion
from ...spline.surface import BSplineSurface
from ..grid import PatchGrid
from .advance import CLEAR, CONTACT, ROOM, SPENT, advance, seed
from .moving import (
    Cover,
    MovingField,
    MovingPatches,
    MovingPoint,
    RigidPatches,
    SweepCache,
    check_net,
    flat_boxes,
    swept_box,
)
from .sweep_field import against_field
from .swept_boxes import Span, ball_overlap, first_overlaps

__all__ = [
    "MovingField",
    "MovingPatches",
    "MovingPoint",
    "RigidPatches",
    "SweepCache",
    "TimeOfContact",
    "first_contact",
]

Array = NDArray[np.float64]

BUDGET = 200_000
"""Pairs of cells looked at before an answer is given as it stands: about a second."""

FINE_PART = 0.25
"""Arcs within this part of the tolerance of their chords are fine."""

WHOLE_STEP = Span(0.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class TimeOfContact:
    """low : nothing touches before it. high : the bodies are within the tolerance there; infinite where that was not
    reached. a_face, a_u, a_v, b_face, b_u, b_v : patches and parameters of the place (None for a point or a field).
    point (3,) : on a, at high (at low where there is none). exhausted : the budget ran out; low holds all the same, and
    the place is the one that was being looked at."""

    low: float
    high: float
    a_face: int
    a_u: float
    a_v: float
    b_face: int | None
    b_u: float | None
    b_v: float | None
    point: Array
    exhausted: bool


def first_contact(
    a: MovingPatches,
    b: MovingPatches | RigidPatches | MovingField | MovingPoint,
    *,
    tolerance: float,
    start: float = 0.0,
    budget: int = BUDGET,
    cache: SweepCache | None = None,
) -> TimeOfContact | None:
    """When, from `start` on, a and b first come within `tolerance` of each other; None when they stay apart.

    A gap that is never below the tolerance is never a contact; bodies that touch are always one. Trimmed faces touch only
    where the face is. Touching at the start gives low = high = start. `cache` is kept by the caller from step to step, one
    for each pair of bodies.

    Raises InputError for a tolerance that is not positive, a start outside [0, 1), a distance that is not a number;
    GeometryError for a net that is not finite.
    """
    if not (np.isfinite(tolerance) and tolerance > 0.0):
        raise InputError(f"a tolerance of {tolerance!r} for the time of contact", mend="a positive length")
    if not 0.0 <= start < 1.0:
        raise InputError(f"a sweep from {start!r}", mend="a part of the step, from 0 to below 1")
    cache = SweepCache() if cache is None else cache
    for grid, net0, net1 in zip(a.grids, a.start, a.end, strict=True):
        check_net(grid, net0, "model")
        check_net(grid, net1, "model")
    first = flat_boxes(a.start, "model")
    boxes = first, first if a.start is a.end else flat_boxes(a.end, "model")
    if isinstance(b, MovingField):
        return _of_field(a, boxes, b, tolerance, start, budget, cache)
    if isinstance(b, MovingPoint):
        point = RigidPatches((_point(),), (_point().surface.control_points,), b.motion)
        found = _of_rigid(a, boxes, point, tolerance, start, budget, cache)
        return None if found is None else replace(found, b_face=None, b_u=None, b_v=None)
    if isinstance(b, RigidPatches):
        return _of_rigid(a, boxes, b, tolerance, start, budget, cache)
    for grid, net0, net1 in zip(b.grids, b.start, b.end, strict=True):
        check_net(grid, net0, "tool")
        check_net(grid, net1, "tool")
    search = _Search(a, boxes, b.grids, cache, budget)
    ends = flat_boxes(b.start, "tool"), flat_boxes(b.end, "tool")
    return search.run(b.start, b.end, ends, WHOLE_STEP, start, 1.0, 0.0, tolerance)


@once
def _point() -> PatchGrid:
    """A patch without extent."""
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    return PatchGrid.of(BSplineSurface(np.zeros((2, 2, 3)), knots, knots, 1, 1), 2)


def _of_rigid(
    a: MovingPatches, boxes: tuple[Array, Array], b: RigidPatches, tolerance: float, start: float, budget: int,
    cache: SweepCache,
) -> TimeOfContact | None:  # fmt: skip
    """Against a rigid tool, piece by piece of its turning."""
    box, radius = cache.frame_box(b)
    if _far(boxes, b.motion, radius, tolerance, start):
        return None
    search = _Search(a, boxes, b.grids, cache, budget)
    nets: dict[float, tuple[Array, ...]] = {}
    t, length, angle = start, 1.0 - start, b.motion.angle
    if angle > 0.0 and radius > 0.0:
        # no longer than a radian, where arcs are an eighth of the radius off; and the longest whose arcs are fine
        length, finest = min(length, 1.0 / angle), float(np.sqrt(8.0 * FINE_PART * tolerance / radius)) / angle
    while t < 1.0:
        # far away all the time that is left?
        low, high, pad = swept_box(b.motion, box, radius, t, 1.0)
        near = first_overlaps(*boxes, WHOLE_STEP, low, high, Span(t, 1.0), pad + tolerance, t, 1.0).min()
        if not near < np.inf:
            return None
        # else nothing happens before the boxes meet
        t = min(max(t, float(near)), np.nextafter(1.0, 0.0))
        end = 1.0 if t + length > 1.0 - 1e-9 else t + length
        pad = b.motion.arc(radius, t, end)
        fine = pad <= FINE_PART * tolerance
        for s in (t, end):
            if s not in nets:
                pose = b.motion.pose(s)
                nets[s] = tuple(np.ascontiguousarray(pose.to_world(net)) for net in b.nets)
        nets = {s: nets[s] for s in (t, end)}
        ends = flat_boxes(nets[t], "tool"), flat_boxes(nets[end], "tool")
        reach = tolerance - pad if fine else pad / FINE_PART
        found = search.run(nets[t], nets[end], ends, Span(t, end), t, end, pad, reach)
        if found is None:
            t, length = end, 2.0 * (end - t)
            continue
        if fine or found.exhausted:
            return found
        # something may be there: on from what is proved, in shorter pieces
        length = 0.25 * (end - t) if found.low > t else 0.99 * finest
        t = max(t, found.low)
    return None


def _far(boxes: tuple[Array, Array], motion: Motion, radius: float, pad: float, start: float) -> bool:
    """Whether the ball around a tool's origin stays away: nearly all steps end here."""
    if not radius < np.inf:
        return False
    return not ball_overlap(*boxes, motion.start.at, motion.displacement, radius, pad, start) < np.inf


def _of_field(
    a: MovingPatches, boxes: tuple[Array, Array], b: MovingField, tolerance: float, start: float, budget: int,
    cache: SweepCache,
) -> TimeOfContact | None:  # fmt: skip
    """Against a tool with a signed distance."""
    box = np.asarray(b.box, dtype=np.float64)
    if box.shape != (2, 3) or np.isnan(box).any():
        raise InputError("the tool's box is not a number", mend="low and high corner, (2, 3)")
    far = np.maximum(-box[0], box[1])
    radius = float(np.sqrt(far @ far))
    if _far(boxes, b.motion, radius, tolerance, start):
        return None
    low, high, pad = swept_box(b.motion, box, radius, start, 1.0)
    span = Span(start, 1.0)
    times = first_overlaps(*boxes, WHOLE_STEP, low, high, span, pad + tolerance, start, 1.0)[:, 0]
    near = np.flatnonzero(times < np.inf)
    if not len(near):
        return None
    covers = []
    for face in near.tolist():
        cover = cache.cover(0, face, a.grids[face])
        cover.load(a.start[face], a.end[face], WHOLE_STEP)
        covers.append((face, cover))
    found = against_field(covers, b, radius, (low, high, pad), tolerance, start, budget)
    return None if found is None else TimeOfContact(*found[:5], None, None, None, *found[5:])


class _Search:
    """Patches of a against patches of b, over stretches of time; cells of a serve for all of them."""

    def __init__(
        self, a: MovingPatches, boxes: tuple[Array, Array], grids: tuple[PatchGrid, ...], cache: SweepCache, budget: int
    ) -> None:
        self.a, self.boxes, self.grids, self.cache, self.budget = a, boxes, grids, cache, budget
        self.loaded: dict[int, Cover] = {}

    def run(
        self, start: tuple[Array, ...], end: tuple[Array, ...], boxes: tuple[Array, Array], time: Span,
        s0: float, s1: float, pad: float, near: float,
    ) -> TimeOfContact | None:  # fmt: skip
        """The first contact from s0 to s1, when b's nets go from start to end over `time`, each point within pad of
        that; near : the distance that counts as one."""
        times = first_overlaps(*self.boxes, WHOLE_STEP, *boxes, time, pad + near, s0, s1)
        pairs = np.argwhere(times < np.inf)
        when = times[pairs[:, 0], pairs[:, 1]]
        best: TimeOfContact | None = None
        low, limit, exhausted = np.inf, s1, False
        covers: dict[int, Cover] = {}
        for k in np.argsort(when, kind="stable"):
            i, j = int(pairs[k, 0]), int(pairs[k, 1])
            if when[k] >= limit:
                break
            if exhausted:
                low = min(low, float(when[k]))  # not looked at: apart until the boxes meet
                break
            if i not in self.loaded:
                self.loaded[i] = self.cache.cover(0, i, self.a.grids[i])
                self.loaded[i].load(self.a.start[i], self.a.end[i], WHOLE_STEP)
            if j not in covers:
                covers[j] = self.cache.cover(1, j, self.grids[j])
                covers[j].load(start[j], end[j], time)
            found = self._pair(i, self.loaded[i], j, covers[j], max(s0, float(when[k])), limit, pad, near)
            if found is None:
                continue
            low, exhausted = min(low, found.low), found.exhausted
            if best is None or not exhausted:
                best, limit = found, min(limit, found.high)
        return None if best is None else replace(best, low=min(low, best.high), exhausted=exhausted)

    def _pair(
        self, i: int, a: Cover, j: int, b: Cover, s0: float, s1: float, pad: float, near: float
    ) -> TimeOfContact | None:
        """Face i of a against face j of b."""
        cache = self.cache
        pad += a.slack + b.slack
        speed = a.speed + b.speed
        step = near / (8.0 * speed) if speed > 0.0 else 1.0
        while True:
            count = seed(
                a.first.box, a.last.box, a.side.on, a.time, b.first.box, b.last.box, b.side.on, b.time,
                pad, s0, s1, step, cache.queue,
            )  # fmt: skip
            if count <= len(cache.queue.key):
                break
            cache.grow_queue(2 * count)
        cache.queue.tally[1] = 0
        found, where = np.empty(2), np.zeros(2, np.int64)
        while True:
            answer = advance(
                *a.spans, a.still, a.trim, a.side, a.time, *b.spans, b.still, b.trim, b.side, b.time,
                pad, near, s1, step, self.budget, cache.queue, found, where,
            )  # fmt: skip
            if answer != ROOM:
                break
            if cache.queue.tally[0] + 2 > len(cache.queue.key):
                cache.grow_queue(0)
            for cover in (a, b):
                if cover.side.made[0] + 2 > len(cover.side.child):
                    cover.grow()
        self.budget -= int(cache.queue.tally[1])
        if answer == CLEAR:
            return None
        low, high = float(found[0]), float(found[1])
        s = high if answer == CONTACT else low
        p, q = _corners(a, int(where[0]), s), _corners(b, int(where[1]), s)
        apart = ((p[:, None] - q[None]) ** 2).sum(axis=2)
        k, m = divmod(int(np.argmin(apart)), 4)
        ra, rb = a.side.rectangle[where[0]], b.side.rectangle[where[1]]
        return TimeOfContact(
            min(low, high), high, i, float(ra[k & 1]), float(ra[2 + (k >> 1)]), j, float(rb[m & 1]),
            float(rb[2 + (m >> 1)]), p[k], answer == SPENT,
        )  # fmt: skip


def _corners(cover: Cover, k: int, s: float) -> Array:
    """The corners (4, 3) of cell k at s."""
    f = (s - cover.time.low) / (cover.time.high - cover.time.low)
    return np.asarray((1.0 - f) * cover.side.first[k] + f * cover.side.last[k])
