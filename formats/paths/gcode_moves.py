"""The canonical moves that a G-code program makes, as machines' interpreters name them (NIST IR 6556, section 4)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Place = tuple[float, float, float, float, float, float]
"""x, y, z in the unit of the moment, a, b, c in degrees."""

PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
"""Of G17 to G19: the first and second axis of the plane, and the axis across it."""


@dataclass(frozen=True, slots=True)
class Move:
    """One straight or curved move, or a wait.

    kind : traverse (G0), feed (G1), arc (G2, G3) or dwell (G4). line : from 1. unit : "mm", "in", or "" while the program has
    not said. start, end : the programmed places, to which `offset` is added for the machine's own. plane : key of PLANES;
    centre (2,) : in the plane's two axes; turns : of an arc, how many times it may pass its start, 1 for less than a turn,
    counted negative when clockwise. feed : as programmed; inverse : G93, so that the move takes 1 / feed minutes.
    seconds : of a dwell. unnamed : the axes whose place the program has not said so far; they stand at 0.
    """

    kind: Literal["traverse", "feed", "arc", "dwell"]
    line: int
    unit: str
    start: Place
    end: Place
    offset: Place = (0.0,) * 6
    plane: int = 17
    centre: tuple[float, float] = (0.0, 0.0)
    turns: int = 0
    feed: float = 0.0
    inverse: bool = False
    seconds: float = 0.0
    unnamed: frozenset[int] = frozenset()

    @property
    def sweep(self) -> float:
        """The angle of an arc, rad, anticlockwise positive; a whole turn where it ends at its start."""
        first, second, _ = PLANES[self.plane]
        begin, end = (math.atan2(p[second] - self.centre[1], p[first] - self.centre[0]) for p in (self.start, self.end))
        return arc_sweep(begin, end, self.turns)

    def canonical(self) -> str:
        """The call of the canonical machine, numbers with four decimals."""
        x, y, z, *turned = self.end
        if self.kind == "dwell":
            return f"DWELL({self.seconds:.4f})"
        if self.kind == "arc":
            first, second, third = PLANES[self.plane]
            numbers = [self.end[first], self.end[second], *self.centre]
            shown = ", ".join(f"{value:.4f}" for value in numbers)
            rest = ", ".join(f"{value:.4f}" for value in (self.end[third], *turned))
            return f"ARC_FEED({shown}, {self.turns}, {rest})"
        name = "STRAIGHT_TRAVERSE" if self.kind == "traverse" else "STRAIGHT_FEED"
        return f"{name}({', '.join(f'{value:.4f}' for value in (x, y, z, *turned))})"


def arc_sweep(start: float, end: float, turns: int) -> float:
    """From one angle to another, rad, by way of `turns` (its sign is the direction); a whole turn between equal ones."""
    sign = 1.0 if turns > 0 else -1.0
    part = math.fmod(sign * (end - start), math.tau)
    if part <= 1e-12:
        part += math.tau
    if part <= 1e-12:
        part += math.tau
    return sign * (part + math.tau * (abs(turns) - 1))
