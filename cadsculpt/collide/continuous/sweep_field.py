"""First contact of moving patches with a rigid tool that has a signed distance: the waves of `sweep`.

A cell is held by a sphere around its corners, grown by its sag. Its distance from the tool, less the radius, falls no faster
than the corners move against the tool, than the tool's own points turn, and than the sag grows: that gives the time until
which it is clear (sphere tracing in time; J. C. Hart, The Visual Computer 12 (1996)). Where the tool is convex, the plane
that touches it where it is nearest to the cell gives another one, which motion along that plane does not shorten, nor a
turn that leaves it in place. The earliest cells are looked at first, many at once, since the tool's distance is one call
for all of them.

Close to a tool that is not known to be convex, cells have to be as small as the gap: a tool of radius R costs about 30 R /
tolerance cells where it comes to rest on something flat.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as dataclass_field

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...spline.region import MIXED, OFF
from ..cells import make_cells, quarters
from .moving import Cover, MovingField
from .swept_boxes import Span, first_overlaps

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

BATCH = 128
"""Cells looked at in the first wave; later waves are larger by a quarter each, up to MOST."""

MOST = 8192

NEAR = 0.5
"""A cell clear by less than this part of its radius is refined, others are advanced."""

ROUND_OFF = 64 * 2.0**-52
"""Rounding of a place in the tool's frame, relative to the largest coordinate."""

Found = tuple[float, float, int, float, float, Array, bool]
"""low, high, face, u, v, point, exhausted."""


@dataclass(slots=True, eq=False)
class _Cells:
    """Cells made so far, n of them: face (n,), rectangle (n, 4), corners (n, 2, 4, 3) and sag (n, 2) at both ends of the
    step, mixed (n,) : whether the face's border may cross it, size (n,)."""

    count: int = 0
    face: Index = dataclass_field(default_factory=lambda: np.zeros(0, np.int64))
    rectangle: Array = dataclass_field(default_factory=lambda: np.zeros((0, 4)))
    corners: Array = dataclass_field(default_factory=lambda: np.zeros((0, 2, 4, 3)))
    sag: Array = dataclass_field(default_factory=lambda: np.zeros((0, 2)))
    mixed: Mask = dataclass_field(default_factory=lambda: np.zeros(0, np.bool_))
    size: Array = dataclass_field(default_factory=lambda: np.zeros(0))

    def add(self, face: int, cover: Cover, rectangle: Array) -> tuple[Index, Mask]:
        """Cells over rectangles: the places of those that hold a piece of the face, and which these are."""
        on = np.ones(len(rectangle), np.int64) if cover.region is None else cover.region.classify(rectangle)
        keep = on != OFF
        rectangle, on = np.ascontiguousarray(rectangle[keep]), on[keep]
        n = len(rectangle)
        places = np.arange(self.count, self.count + n)
        self.count += n
        if self.count > len(self.size):
            for name in ("face", "rectangle", "corners", "sag", "mixed", "size"):
                old = getattr(self, name)
                new = np.empty((2 * self.count + 256, *old.shape[1:]), old.dtype)
                new[: len(old)] = old
                setattr(self, name, new)
        corners, sag = np.empty((2, n, 4, 3)), np.empty((2, n))
        centre, radius, cut = np.empty((n, 3)), np.empty(n), np.empty(n, np.int64)
        make_cells(cover.spans[0], rectangle, on, corners[0], sag[0], centre, radius, cut)
        if cover.still:
            corners[1], sag[1] = corners[0], sag[0]
        else:
            make_cells(cover.spans[1], rectangle, on, corners[1], sag[1], centre, radius, cut)
        self.face[places], self.rectangle[places], self.mixed[places] = face, rectangle, on == MIXED
        self.corners[places], self.sag[places] = corners.transpose(1, 0, 2, 3), sag.T
        self.size[places] = np.ptp(corners[0], axis=1).max(axis=1)
        return places, keep


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
    cells = _Cells()
    parts = []
    for face, cover in covers:
        times = first_overlaps(
            cover.first.box, cover.last.box, whole, swept[0], swept[1], span, swept[2] + cover.slack, start, 1.0
        )[:, 0]
        meets = np.flatnonzero(times < 1.0)
        places, keep = cells.add(face, cover, cover.side.rectangle[meets])
        parts.append((places, times[meets][keep]))
    waiting, until = (np.concatenate(part) for part in zip(*parts, strict=True))
    by_face = dict(covers)
    size = float(np.abs(motion.start.at).max() + np.abs(motion.displacement).max())
    size += radius if radius < np.inf else max(float(np.abs(cover.first.box).max()) for _, cover in covers)
    slack = ROUND_OFF * size + max(cover.slack for _, cover in covers)
    speed = max(cover.speed for _, cover in covers) + motion.speed(min(radius, size))
    step = near / (8.0 * speed) if speed > 0.0 else 1.0
    limit, batch = 1.0, BATCH
    best: Found | None = None
    while True:
        waiting, until = waiting[until < limit], until[until < limit]
        if not len(waiting):
            return best
        # the earliest first, and among those of nearly one time the smallest
        key = np.floor((until - start) / step)
        key += cells.size[waiting] * (0.5 / max(float(cells.size[: cells.count].max()), 1e-300))
        order = np.argpartition(key, batch) if batch < len(key) else np.arange(len(key))
        if budget <= 0:
            k = int(np.argmin(until))
            found = _found(cells, int(waiting[k]), tool, float(until[k]))
            return (float(until[k]), np.inf if best is None else best[1], *(found if best is None else best[2:6]), True)
        looked, rest = order[:batch], order[batch:]
        batch = min(MOST, batch + batch // 4)
        budget -= len(looked)
        here, now = waiting[looked], until[looked]
        touch, later, again, finer = _look(cells, here, now, tool, radius, slack, near)
        if touch.any():
            k = int(np.flatnonzero(touch)[np.argmin(now[touch])])
            limit = float(now[k])
            best = (limit, limit, *_found(cells, int(here[k]), tool, limit), False)
        parts = [(waiting[rest], until[rest]), (here[again], later[again])]
        split, since = here[finer], later[finer]
        for face in np.unique(cells.face[split]).tolist():
            mine = cells.face[split] == face
            places, keep = cells.add(face, by_face[face], quarters(cells.rectangle[split[mine]]))
            parts.append((places, np.repeat(since[mine], 4)[keep]))
        waiting, until = (np.concatenate(part) for part in zip(*parts, strict=True))


def _look(
    cells: _Cells, here: Index, s: Array, tool: MovingField, radius: float, slack: float, near: float
) -> tuple[Mask, Array, Mask, Mask]:
    """Every cell at its own time: whether it touches, until when it is clear, whether it is to wait, or to be refined."""
    motion, f = tool.motion, s[:, None, None]
    ends, sags = cells.corners[here], cells.sag[here]
    corners = (1.0 - f) * ends[:, 0] + f * ends[:, 1]
    sag = (1.0 - s) * sags[:, 0] + s * sags[:, 1] + slack
    swelling = np.maximum(0.0, sags[:, 1] - sags[:, 0])
    centre = 0.5 * (corners.min(axis=1) + corners.max(axis=1))
    arms = corners - centre[:, None]
    reach = np.sqrt((arms * arms).sum(axis=2)).max(axis=1) + sag
    local = motion.to_tool(centre, s)
    distance, normal = tool.shape.field(local)
    if np.isnan(distance).any():
        raise InputError("a distance to the tool is not a number")
    # how fast the corners come against the tool's origin, and its points against them
    relative = ends[:, 1] - ends[:, 0] - motion.displacement
    fastest = np.sqrt((relative * relative).sum(axis=2)).max(axis=1)
    left = 1.0 - s
    out = np.sqrt((local * local).sum(axis=1)) + reach + fastest * left
    turning = motion.angle * np.minimum(radius, out)
    gap = distance - reach
    part = _part(gap, fastest + turning + swelling)
    if tool.convex:
        n = motion.to_world(normal, s)[:, None]
        height = distance[:, None] + (n * arms).sum(axis=2) - sag[:, None]
        outside = (height > 0.0).all(axis=1) & (distance > 0.0)
        # in the tool's frame the plane stands still, and the corners run past it on curves
        from_origin = corners - motion.start.at - s[:, None, None] * motion.displacement
        rise = (n * (relative - np.cross(motion.rotation, from_origin))).sum(axis=2) - swelling[:, None]
        # until they are twice as far from the tool's origin, they bend by no more than this
        size = np.sqrt((from_origin * from_origin).sum(axis=2)).max(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            horizon = np.where(fastest * left > size, size / fastest, left) if motion.angle > 0.0 else left
        bend = motion.angle * (motion.angle * (size + fastest * horizon) + 2.0 * fastest)
        beyond = np.where(outside, _fall(height, rise, bend[:, None]).min(axis=1), 0.0)
        if motion.angle > 0.0:
            beyond = np.where(horizon < left, np.minimum(beyond, horizon), beyond)
        part = np.maximum(part, beyond)
        gap = np.where(outside, np.maximum(gap, height.min(axis=1)), gap)
    until = np.where(part > 0.0, s + part, s)
    small = (reach <= 0.25 * near) | ~_divisible(cells.rectangle[here])
    # a corner within reach is a contact whatever the cell's size
    touch = small & (gap <= 0.25 * near)
    may = np.flatnonzero((gap <= near) & ~cells.mixed[here] & ~touch)
    if len(may):
        places = motion.to_tool(corners[may].reshape(-1, 3), np.repeat(s[may], 4))
        touch[may] = (tool.shape.field(places)[0].reshape(-1, 4) <= near).any(axis=1)
    clear = until >= 1.0
    again = ~touch & ~clear & (until > s) & (small | (gap > NEAR * reach))
    # no finer, and clear for less than a time can tell: as good as touching
    touch |= ~again & ~clear & small
    return touch & ~clear, until, again, ~touch & ~clear & ~again


def _part(gap: Array, speed: Array) -> Array:
    """For how long a gap lasts, 0 where there is none; infinite at rest."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(gap > 0.0, np.where(speed > 0.0, gap / speed, np.inf), 0.0)


def _fall(height: Array, rise: Array, bend: Array) -> Array:
    """When height + rise t - bend t^2 / 2 comes down to 0; infinite if never."""
    root = np.sqrt(rise * rise + 2.0 * bend * np.maximum(height, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        # the two forms of the root: neither cancels
        return np.where(rise < 0.0, 2.0 * height / (root - rise), np.where(bend > 0.0, (rise + root) / bend, np.inf))


def _divisible(rectangle: Array) -> Mask:
    u0, u1, v0, v1 = rectangle.T
    mu, mv = 0.5 * (u0 + u1), 0.5 * (v0 + v1)
    return np.asarray((u0 < mu) & (mu < u1) & (v0 < mv) & (mv < v1))


def _found(cells: _Cells, k: int, tool: MovingField, s: float) -> tuple[int, float, float, Array]:
    """Face, u, v and place of the corner of cell k that is nearest to the tool at s."""
    corners = (1.0 - s) * cells.corners[k, 0] + s * cells.corners[k, 1]
    e = int(np.argmin(tool.shape.field(tool.motion.to_tool(corners, np.full(4, s)))[0]))
    u, v = cells.rectangle[k, e & 1], cells.rectangle[k, 2 + (e >> 1)]
    return int(cells.face[k]), float(u), float(v), corners[e]
