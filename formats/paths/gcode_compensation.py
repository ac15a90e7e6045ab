"""Cutter radius compensation with a diameter that stands in the program (G41.1, G42.1).

Each programmed line or arc is moved sideways by the radius. Where the tool turns around a corner from outside, it rolls around
the corner on an arc; in an inner corner both moves end where their shifted curves cross. So a move is known once the next
has come. The first move runs from the uncompensated place, and that after G40 goes back to one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from .gcode_moves import PLANES, Move, Place, arc_sweep
from .gcode_words import LineError

TANGENT = 0.01
"""rad; moves that meet at less than this meet smoothly."""

Point = tuple[float, float]


class Compensation:
    """The moves of one plane, shifted to the left of the way (side 1) or to the right (-1) by a radius."""

    def __init__(self, plane: int, side: int, radius: float) -> None:
        self.plane = plane
        self.shift = side * radius
        self.axes = PLANES[plane]
        self.place: Place | None = None
        """Where the tool is after the last move that is known; None while none is."""
        self._move: Move | None = None  # the programmed move whose end is not known yet
        self._start: Point | None = None  # where its shifted twin begins
        self._entry = True
        self._waiting: list[Move] = []  # moves across the plane behind it, and dwells

    def add(self, move: Move) -> Iterator[Move]:
        """The shifted moves that are known now that `move` has come. Raises LineError where the cutter does not fit."""
        if move.kind == "dwell" or (move.kind != "arc" and self._point(move.start) == self._point(move.end)):
            if self._move is None:
                yield move
            else:
                self._waiting.append(move)
            return
        if move.kind == "arc" and move.plane != self.plane:
            raise LineError("an arc in another plane than its cutter compensation")
        if self._move is None:
            if move.kind == "arc":
                raise LineError("an arc begins the cutter compensation", "enter on a straight move")
            self._move, self._start = move, self._point(move.start)
            return
        before = self._move
        corner = self._point(before.end)
        one, two = self._direction(before, False), self._direction(move, True)
        cross, dot = one[0] * two[1] - one[1] * two[0], one[0] * two[0] + one[1] * two[1]
        angle = math.atan2(math.copysign(1.0, self.shift) * cross, dot)  # positive into an inner corner
        end, start = self._shifted(corner, one), self._shifted(corner, two)
        crossing = None
        if angle > TANGENT or abs(abs(angle) - math.pi) < 1e-6:
            crossing = self._crossing(before, move, corner)
            if crossing is None and abs(angle) < math.pi - 1e-6:
                raise LineError("the cutter does not fit into the corner before this move", "take a smaller one")
        if crossing is not None:
            yield from self._emit(crossing)
            self._start = crossing
        else:
            yield from self._emit(end)
            if angle < -TANGENT or abs(abs(angle) - math.pi) < 1e-6:
                at = self._place(before.end, end)
                turns = -1 if self.shift > 0.0 else 1
                yield replace(
                    move, kind="arc", start=at, end=self._place(before.end, start), plane=self.plane,
                    centre=corner, turns=turns,
                )  # fmt: skip
                self._start = start
            else:
                self._start = end
        self._move, self._entry = move, False

    def flush(self) -> Iterator[Move]:
        """The last move, which ends beside its programmed end."""
        if self._move is not None:
            yield from self._emit(self._shifted(self._point(self._move.end), self._direction(self._move, False)))
        self._move = None

    def _emit(self, end: Point) -> Iterator[Move]:
        """The move that waits, up to `end`, and what waits behind it."""
        move, start = self._move, self._start
        assert move is not None
        assert start is not None
        shifted = replace(move, start=self._place(move.start, start), end=self._place(move.end, end))
        programmed, made = (
            self._reach(move, self._point(move.start), self._point(move.end)),
            self._reach(move, start, end),
        )
        limit = programmed + 0.5 * math.pi if move.kind == "arc" else math.inf  # an arc that goes round has turned back
        if not (0.0 < made < limit) and not (self._entry and made != 0.0):
            raise LineError("the cutter does not fit between this move's neighbours", "take a smaller one")
        if move.kind == "arc":
            self._radius(move)
        yield shifted
        for other in self._waiting:
            yield replace(other, start=self._place(other.start, end), end=self._place(other.end, end))
        self.place = self._place((self._waiting or [move])[-1].end, end)
        self._waiting = []

    def _reach(self, move: Move, start: Point, end: Point) -> float:
        """How far a move gets from one point to another along its own way: a length, or rad of an arc."""
        if move.kind != "arc":
            way = self._direction(move, True)
            return (end[0] - start[0]) * way[0] + (end[1] - start[1]) * way[1]
        first, last = (math.atan2(p[1] - move.centre[1], p[0] - move.centre[0]) for p in (start, end))
        return abs(arc_sweep(first, last, move.turns))

    def _radius(self, move: Move) -> float:
        """Of a move's shifted arc. Raises LineError where nothing is left of it."""
        x, y = self._point(move.end)
        radius = math.hypot(x - move.centre[0], y - move.centre[1])
        radius -= self.shift if move.turns > 0 else -self.shift
        if radius <= 0.0:
            raise LineError("the cutter is larger than the arc that it runs inside", "take a smaller one")
        return radius

    def _crossing(self, before: Move, after: Move, corner: Point) -> Point | None:
        """Where the shifted curves of two moves cross, nearest to the corner: before the first ends and the second begins."""
        curves: list[tuple[Point, float | None]] = []
        for move in (before, after):
            if move.kind == "arc":
                curves.append((move.centre, self._radius(move)))
            else:
                curves.append((self._shifted(self._point(move.end), self._direction(move, True)), None))
        found: list[Point]
        (p, r), (q, s) = curves
        if r is None and s is None:
            found = _line_line(p, self._direction(before, True), q, self._direction(after, True))
        elif r is None and s is not None:
            found = _line_circle(p, self._direction(before, True), q, s)
        elif s is None and r is not None:
            found = _line_circle(q, self._direction(after, True), p, r)
        else:
            assert r is not None
            assert s is not None
            found = _circle_circle(p, r, q, s)
        end, start = (
            self._shifted(corner, self._direction(before, False)),
            self._shifted(corner, self._direction(after, True)),
        )
        met = [x for x in found if self._leads(before, x, end) and self._leads(after, start, x)]
        return min(met, key=lambda x: math.hypot(x[0] - corner[0], x[1] - corner[1]), default=None)

    def _leads(self, move: Move, start: Point, end: Point) -> bool:
        """Whether a shifted move comes from one point to the other, by less than half a turn of an arc."""
        return 0.0 <= self._reach(move, start, end) < (math.pi if move.kind == "arc" else math.inf)

    def _direction(self, move: Move, at_start: bool) -> Point:
        """The unit vector along a programmed move, where it begins or ends."""
        start, end = self._point(move.start), self._point(move.end)
        if move.kind == "arc":
            x, y = start if at_start else end
            sign = 1.0 if move.turns > 0 else -1.0
            way = (-sign * (y - move.centre[1]), sign * (x - move.centre[0]))
        else:
            way = (end[0] - start[0], end[1] - start[1])
        length = math.hypot(*way)
        return way[0] / length, way[1] / length

    def _shifted(self, point: Point, way: Point) -> Point:
        return point[0] - self.shift * way[1], point[1] + self.shift * way[0]

    def _point(self, place: Place) -> Point:
        return place[self.axes[0]], place[self.axes[1]]

    def _place(self, place: Place, point: Point) -> Place:
        changed = list(place)
        changed[self.axes[0]], changed[self.axes[1]] = point
        return tuple(changed)  # type: ignore[return-value]


def _line_line(p: Point, d: Point, q: Point, e: Point) -> list[Point]:
    area = d[0] * e[1] - d[1] * e[0]
    if abs(area) < 1e-12:
        return []
    t = ((q[0] - p[0]) * e[1] - (q[1] - p[1]) * e[0]) / area
    return [(p[0] + t * d[0], p[1] + t * d[1])]


def _line_circle(p: Point, d: Point, centre: Point, radius: float) -> list[Point]:
    along = (centre[0] - p[0]) * d[0] + (centre[1] - p[1]) * d[1]
    foot = (p[0] + along * d[0], p[1] + along * d[1])
    rest = radius * radius - (foot[0] - centre[0]) ** 2 - (foot[1] - centre[1]) ** 2
    if rest < 0.0:
        return []
    half = math.sqrt(rest)
    return [(foot[0] + t * d[0], foot[1] + t * d[1]) for t in (-half, half)]


def _circle_circle(p: Point, r: float, q: Point, s: float) -> list[Point]:
    x, y = q[0] - p[0], q[1] - p[1]
    apart = math.hypot(x, y)
    if apart == 0.0:
        return []
    along = (apart * apart + r * r - s * s) / (2.0 * apart)
    rest = r * r - along * along
    if rest < 0.0:
        return []
    half = math.sqrt(rest)
    x, y = x / apart, y / apart
    foot = (p[0] + along * x, p[1] + along * y)
    return [(foot[0] - t * y, foot[1] + t * x) for t in (-half, half)]
