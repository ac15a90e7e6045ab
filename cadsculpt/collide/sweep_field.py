"""First contact of moving patches with a rigid tool that has a signed distance: the waves of `sweep`.

A cell is held by a sphere around its corners, grown by its sag. Its distance from the tool, less the radius, falls no faster
than the corners move against the tool, than the tool's own points turn, and than the sag grows: that gives the time until
which it is clear (sphere tracing in time; J. C. Hart, The Visual Computer 12 (1996)). Where the tool is convex, the plane
that touches it where it is nearest to the cell gives another one, which motion along that plane does not shorten. The
earliest cells are looked at first, many at once, since the tool's distance is one call for all of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..spline.region import MIXED, OFF
from .advance import Span, first_overlaps
from .cells import make_cells, quarters
from .moving import Cover, MovingField

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BATCH = 128
"""Cells looked at in one wave."""

NEAR = 0.5
"""A cell clear by less than this part of its radius is refined, others are advanced."""

ROUND_OFF = 64 * 2.0**-52
"""Rounding of a place in the tool's frame, relative to the largest coordinate."""

Found = tuple[float, float, int, float, float, Array, bool]
"""low, high, face, u, v, point, exhausted."""


class _Wave:
    """Cells that wait: face, rectangle (n, 4), corners at both ends of the step (n, 2, 4, 3), sag at both (n, 2), whether
    the face's border may cross them, the time until which each is clear, and its size."""

    __slots__ = ("corners", "face", "mixed", "rectangle", "sag", "size", "until")

    def __init__(
        self, face: Index, rectangle: Array, corners: Array, sag: Array, mixed: NDArray[np.bool_], until: Array
    ) -> None:
        self.face, self.rectangle, self.corners, self.sag, self.mixed, self.until = (
            face, rectangle, corners, sag, mixed, until,
        )  # fmt: skip
        self.size = np.ptp(corners, axis=2).max(axis=(1, 2)) if len(face) else np.zeros(0)

    def __len__(self) -> int:
        return len(self.face)

    def __getitem__(self, which: NDArray[np.generic]) -> _Wave:
        return _Wave(
            self.face[which], self.rectangle[which], self.corners[which], self.sag[which], self.mixed[which],
            self.until[which],
        )  # fmt: skip

    @staticmethod
    def joined(parts: list[_Wave]) -> _Wave:
        names = ("face", "rectangle", "corners", "sag", "mixed", "until")
        return _Wave(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _cells(face: int, cover: Cover, rectangle: Array, until: Array) -> _Wave:
    """The cells over rectangles, but for those off the face."""
    on = np.ones(len(rectangle), np.int64) if cover.region is None else cover.region.classify(rectangle)
    keep = on != OFF
    rectangle, on, until = np.ascontiguousarray(rectangle[keep]), on[keep], until[keep]
    n = len(rectangle)
    corners, sag = np.empty((2, n, 4, 3)), np.empty((2, n))
    centre, radius = np.empty((n, 3)), np.empty(n)
    make_cells(cover.first, rectangle, corners[0], sag[0], centre, radius)
    if cover.still:
        corners[1], sag[1] = corners[0], sag[0]
    else:
        make_cells(cover.last, rectangle, corners[1], sag[1], centre, radius)
    return _Wave(np.full(n, face), rectangle, corners.transpose(1, 0, 2, 3), sag.T, on == MIXED, until)


def against_field(
    covers: list[tuple[int, Cover]], tool: MovingField, radius: float, swept: tuple[Array, Array, float],
    near: float, start: float, budget: int,
) -> Found | None:  # fmt: skip
    """The first contact of loaded patches with a tool, from `start` to 1.

    radius : of the tool around its origin. swept : its boxes at start and end, and their pad. near : the distance that is a
    contact.
    """
    motion = tool.motion
    whole, span = Span(0.0, 1.0), Span(start, 1.0)
    parts = []
    for face, cover in covers:
        times = first_overlaps(
            cover.first.box, cover.last.box, whole, swept[0], swept[1], span, swept[2] + near, start, 1.0
        )[:, 0]
        meets = np.flatnonzero(times < 1.0)
        spans = cover.side.rectangle[: len(times)]
        parts.append(_cells(face, cover, spans[meets], times[meets]))
    waiting = _Wave.joined(parts)
    by_face = dict(covers)
    size = float(np.abs(motion.start.at).max() + np.abs(motion.displacement).max())
    size += radius if radius < np.inf else max(float(np.abs(cover.first.box).max()) for _, cover in covers)
    slack = ROUND_OFF * size + max(cover.slack for _, cover in covers)
    speed = max(cover.speed for _, cover in covers) + motion.speed(min(radius, size))
    step = near / (8.0 * speed) if speed > 0.0 else 1.0
    limit = 1.0
    best: Found | None = None
    while True:
        waiting = waiting[waiting.until < limit]
        if not len(waiting):
            return best
        order = np.lexsort((waiting.size, np.floor(waiting.until / step)))
        if budget <= 0:
            k = order[0]
            return _found(waiting, k, float(waiting.until.min()), np.inf if best is None else best[1], True)
        looked, rest = waiting[order[:BATCH]], order[BATCH:]
        budget -= len(looked)
        touch, until, again, finer = _look(looked, tool, radius, slack, near)
        if touch.any():
            k = int(np.flatnonzero(touch)[np.argmin(looked.until[touch])])
            if looked.until[k] < limit:
                limit = float(looked.until[k])
                best = _found(looked, k, limit, limit, False)
        looked.until = until
        parts = [waiting[rest], looked[again]]
        split = looked[finer]
        for face in np.unique(split.face).tolist():
            mine = split[split.face == face]
            parts.append(_cells(face, by_face[face], quarters(mine.rectangle), np.repeat(mine.until, 4)))
        waiting = _Wave.joined(parts)


def _look(
    w: _Wave, tool: MovingField, radius: float, slack: float, near: float
) -> tuple[NDArray[np.bool_], Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """Every cell at its own time: whether it touches, until when it is clear, whether it is to wait, or to be refined."""
    motion, s = tool.motion, w.until
    f = s[:, None]
    corners = (1.0 - f)[..., None] * w.corners[:, 0] + f[..., None] * w.corners[:, 1]
    sag = (1.0 - s) * w.sag[:, 0] + s * w.sag[:, 1] + slack
    swelling = np.maximum(0.0, w.sag[:, 1] - w.sag[:, 0])
    centre = 0.5 * (corners.min(axis=1) + corners.max(axis=1))
    arms = corners - centre[:, None]
    reach = np.sqrt((arms * arms).sum(axis=2)).max(axis=1) + sag
    local = motion.to_tool(centre, s)
    distance, normal = tool.shape.field(local)
    if np.isnan(distance).any():
        raise InputError("a distance to the tool is not a number")
    # how fast the corners come against the tool's origin, and its points against them
    relative = w.corners[:, 1] - w.corners[:, 0] - motion.displacement
    fastest = np.sqrt((relative * relative).sum(axis=2)).max(axis=1)
    left = 1.0 - s
    out = np.sqrt((local * local).sum(axis=1)) + reach + fastest * left
    turning = motion.angle * np.minimum(radius, out)
    gap = distance - reach
    part = _part(gap, fastest + turning + swelling)
    if tool.convex:
        n = motion.to_world(normal, s)[:, None]
        height = distance[:, None] + (n * arms).sum(axis=2) - sag[:, None]
        sinking = (turning + swelling)[:, None] - (n * relative).sum(axis=2)
        sinking = np.maximum(sinking, 0.0)
        outside = (height > 0.0).all(axis=1) & (distance > 0.0)
        beyond = np.where(outside, _part(height, sinking).min(axis=1), 0.0)
        part = np.maximum(part, beyond)
        gap = np.where(outside, np.maximum(gap, height.min(axis=1)), gap)
    until = np.where(part > 0.0, s + part, s)
    small = (reach <= 0.25 * near) | ~_divisible(w.rectangle)
    # a corner within reach is a contact whatever the cell's size
    touch = small & (gap <= 0.25 * near)
    may = np.flatnonzero((gap <= near) & ~w.mixed & ~touch)
    if len(may):
        places = motion.to_tool(corners[may].reshape(-1, 3), np.repeat(s[may], 4))
        touch[may] = (tool.shape.field(places)[0].reshape(-1, 4) <= near).any(axis=1)
    clear = until >= 1.0
    again = ~touch & ~clear & (until > s) & (small | (gap > NEAR * reach))
    finer = ~touch & ~clear & ~again
    return touch & ~clear, until, again, finer & ~small


def _part(gap: Array, speed: Array) -> Array:
    """For how long a gap lasts, 0 where there is none; infinite at rest."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(gap > 0.0, np.where(speed > 0.0, gap / speed, np.inf), 0.0)


def _divisible(rectangle: Array) -> NDArray[np.bool_]:
    u0, u1, v0, v1 = rectangle.T
    mu, mv = 0.5 * (u0 + u1), 0.5 * (v0 + v1)
    return np.asarray((u0 < mu) & (mu < u1) & (v0 < mv) & (mv < v1))


def _found(w: _Wave, k: int, low: float, high: float, exhausted: bool) -> Found:
    """The middle of cell k as the place of contact."""
    s = high if high < np.inf else low
    u0, u1, v0, v1 = w.rectangle[k]
    point = ((1.0 - s) * w.corners[k, 0] + s * w.corners[k, 1]).mean(axis=0)
    return low, high, int(w.face[k]), float(0.5 * (u0 + u1)), float(0.5 * (v0 + v1)), point, exhausted
