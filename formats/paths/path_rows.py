"""From the moves of a CAM file to a `ToolPath`: times from feeds, arcs as straight pieces within a chord error."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...motion.path import ToolPath, quaternion
from ...scene_tool import PathOptions
from ...units import conversion

Array = NDArray[np.float64]

TOLERANCE = 0.01
"""mm between an arc and its chords when a scene names none."""
RAPID = 100.0
"""mm per s of rapid moves when a scene names no speed."""
RAPID_TURN = 60.0
"""Degrees per s of rapid moves that only turn."""
MOST_ROWS = 500_000


@dataclass(frozen=True, slots=True)
class ReadPath:
    """A path from a file, in the scene's unit, and what its reader had to say."""

    path: ToolPath
    warnings: tuple[str, ...] = ()


class PathRows:
    """Rows as they come, in the scene's unit.

    The path begins where the first move ends: the file does not say where the tool comes from. Raises InputError for more
    rows than MOST_ROWS, and for times and places that are not finite.
    """

    def __init__(self, units: str, options: PathOptions) -> None:
        self.tolerance = options.tolerance or TOLERANCE * conversion("mm", units)
        self.rapid = options.rapid or RAPID * conversion("mm", units)
        self._t: list[float] = []
        self._at: list[Array] = []
        self._rotation: list[Array] = []
        self._clock = 0.0

    @property
    def begun(self) -> bool:
        return bool(self._at)

    @property
    def at(self) -> Array:
        """Where the tool is now (3,)."""
        return self._at[-1]

    @property
    def rotation(self) -> Array:
        """How the tool stands now (3, 3)."""
        return self._rotation[-1]

    def begin(self, at: Array, rotation: Array) -> None:
        """The first row, at time 0."""
        self._append(0.0, at, rotation)

    def wait(self, seconds: float) -> None:
        """Stay where the tool is."""
        if seconds > 0.0 and self.begun:
            self._append(self._clock + seconds, self._at[-1], self._rotation[-1])

    def move(self, at: Array, rotation: Array, seconds: float) -> None:
        """A straight move to `at` that turns evenly to `rotation`; one that changes nothing takes no time and no row."""
        if np.array_equal(at, self._at[-1]) and np.array_equal(rotation, self._rotation[-1]):
            return
        clock = self._clock + seconds
        if not clock > self._clock:  # too short for the clock: the place is that of the next row
            self._at[-1], self._rotation[-1] = at, rotation
            return
        self._append(clock, at, rotation)

    def path(self, where: str) -> ToolPath:
        """The whole. Raises InputError where there is none."""
        if not self._t:
            raise InputError("holds no path", where=where, mend="one move or more")
        rotation = np.array(self._rotation)
        return ToolPath(np.array(self._t), np.array(self._at), rotation)

    def _append(self, t: float, at: Array, rotation: Array) -> None:
        if not (math.isfinite(t) and np.isfinite(at).all()):
            raise InputError("a move whose time or place is not a finite number")
        if len(self._t) >= MOST_ROWS:
            raise InputError(f"the path has more than {MOST_ROWS} rows", mend="use a larger tolerance")
        self._clock = t
        self._t.append(t)
        self._at.append(at)
        self._rotation.append(rotation)


def arc_points(start: Array, end: Array, centre: Array, axis: Array, sweep: float, tolerance: float) -> Iterator[Array]:
    """Points (3,) on an arc or helix behind its start, whose chords stay within `tolerance` of it, the last being `end`.

    sweep : rad about `axis` (3,), a unit vector. The radius and the rise change evenly from start to end.
    """
    radial, last = start - centre, end - centre
    rise = last @ axis - radial @ axis
    base = radial - (radial @ axis) * axis
    tip = last - (last @ axis) * axis
    r0, r1 = float(np.linalg.norm(base)), float(np.linalg.norm(tip))
    if r0 == 0.0:
        raise InputError("an arc begins at its own centre")
    first = base / r0
    second = np.cross(axis, first)
    height = centre + (radial @ axis) * axis
    largest = max(r0, r1)
    half = math.acos(max(-1.0, 1.0 - tolerance / largest)) if tolerance < largest else 0.5 * math.pi
    count = max(math.ceil(abs(sweep) / (2.0 * min(half, 0.25 * math.pi))), 1) if half > 0.0 else MOST_ROWS
    if count > MOST_ROWS:
        raise InputError(f"an arc of more than {MOST_ROWS} pieces", mend="use a larger tolerance")
    for k in range(1, count):
        share = k / count
        angle = sweep * share
        radius = r0 + share * (r1 - r0)
        yield height + share * rise * axis + radius * (math.cos(angle) * first + math.sin(angle) * second)
    yield end


def arc_length(start: Array, end: Array, centre: Array, axis: Array, sweep: float) -> float:
    """Length of an arc or helix (of its mean radius where that changes)."""
    radial, last = start - centre, end - centre
    rise = float(last @ axis - radial @ axis)
    radii = [float(np.linalg.norm(r - (r @ axis) * axis)) for r in (radial, last)]
    return math.hypot(0.5 * sum(radii) * sweep, rise, radii[1] - radii[0])


def turn_between(a: Array, b: Array) -> float:
    """Degrees from one rotation (3, 3) to another."""
    return math.degrees(2.0 * math.acos(min(1.0, quaternion(b @ a.T)[0])))
