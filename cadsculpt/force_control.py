"""Tools that are pushed with a force (control = "force") and find their own depth.

Such a tool goes to where its path is, but pushes along one direction with no more than its force F: along that of its way
there, or along a direction that the scene gives, while in all others it follows its path. Within a step of dt seconds it moves
s along the direction d,

    s = min(s_path, L) where the reaction R(s) = -f . d stays below F,     else R(s) = F,

with s_path the way to the path's pose and L the way at the path's top speed. The tool has no mass: f is the mean reaction of
the step, so R grows with s and the root is bracketed. It is found by regula falsi in the Illinois form (Dowell, Jarratt 1971,
A modified regula falsi method), one bracket a tool, all tools at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .errors import InputError, SimulationError
from .motion.path import ToolPath
from .motion.pose import Pose

Array = NDArray[np.float64]

FORCE_TOLERANCE = 2e-3
"""Share of the force within which it is met: less than what the lattice's own resolution changes."""

NARROWEST = 1e-7
"""A bracket narrower than this share of the longest way in a step holds a jump of the reaction, and is met at the jump."""

TRIALS = 60
"""Steps tried for one: contact that comes and goes takes five to ten, contact that stays two or three."""


@dataclass(frozen=True, slots=True, eq=False)
class Push:
    """One tool under force control: force [N], the unit `direction` (3,) it acts along, None for that of its way to the path,
    and the `speed` [L/s] it moves with at most."""

    force: float
    direction: Array | None
    speed: float

    @classmethod
    def of(cls, force: float, direction: Sequence[float] | None, path: ToolPath) -> Push:
        """Raises InputError for a path that does not lead anywhere along the direction."""
        ways = np.diff(path.at, axis=0)
        speed = float(np.max(np.linalg.norm(ways, axis=1) / np.diff(path.t), initial=0.0))
        if direction is None:
            if not speed > 0.0:
                raise InputError(
                    'control = "force", and its path does not move', mend="lead the path to where it is to be pushed"
                )
            return cls(force, None, speed)
        along = np.array(direction, dtype=np.float64)
        length = float(np.linalg.norm(along))
        if not length > 0.0:
            raise InputError("its direction has no length", mend="write where the force points, [0, 0, -1] say")
        along /= length
        if not (ways @ along > 0.0).any():
            raise InputError(
                "its path never moves along its direction", mend="lead the path deeper than the tool is to go"
            )
        return cls(force, along, speed)


@dataclass(slots=True, eq=False)
class PushMemory:
    """What pushed tools keep from step to step, to guess the next: `rate` (tools,) [L/s], how fast each last went along its
    direction, and `slope` (tools,) [N/L], how fast its reaction grew; `direction` (tools, 3), the last."""

    rate: Array
    slope: Array
    direction: Array

    @classmethod
    def of(cls, tools: int) -> PushMemory:
        return cls(np.zeros(tools), np.zeros(tools), np.zeros((tools, 3)))

    def arrays(self) -> dict[str, Array]:
        """For a checkpoint."""
        return {"push_rate": self.rate, "push_slope": self.slope, "push_direction": self.direction}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, Array]) -> PushMemory:
        return cls(*(np.array(arrays[f"push_{name}"]) for name in ("rate", "slope", "direction")))


@dataclass(slots=True, eq=False)
class _Way:
    """One tool's way within a step: from `start` along `direction` by s in [least, full], beside that by `across` (3,), and
    turned as the `target` is, which `ahead` reaches. low, high : ends of the bracket with their lacks of force F - R."""

    start: Array
    across: Array
    target: Pose
    direction: Array
    least: float
    full: float
    ahead: float
    s: float
    low: tuple[float, float] | None = None
    high: tuple[float, float] | None = None
    met: bool = False
    _kept: int = field(default=0)

    @classmethod
    def between(cls, push: Push, before: Pose, target: Pose, dt: float, rate: float, latest: Array) -> _Way:
        way = np.asarray(target.at) - before.at
        length = float(np.linalg.norm(way))
        direction = push.direction
        if direction is None:
            direction = way / length if length > 0.0 else latest
        ahead = float(way @ direction)
        most = push.speed * dt * (1.0 + 1e-9)  # what keeps up with its path arrives
        full = min(ahead, most)
        across = way - ahead * direction if push.direction is not None else np.zeros(3)
        s = float(np.clip(rate * dt, -most, full)) if 0.0 != rate < 0.999 * full / dt else full
        return cls(np.asarray(before.at), across, target, direction, min(-most, full), full, ahead, s)

    def pose(self) -> Pose:
        if self.s == self.ahead:
            return self.target
        return Pose(self.start + self.across + self.s * self.direction, self.target.rotation)

    def learn(self, lack: float, push: Push, slope: float, longest: float) -> float:
        """Take in how much force is lacking, F - R, at s; sets `met`, or the s to try next. Returns the slope dR/ds."""
        self.met = (
            abs(lack) <= FORCE_TOLERANCE * push.force
            or (lack > 0.0 and self.s >= self.full)
            or (lack < 0.0 and self.s <= self.least)
        )
        side = self.low if lack > 0.0 else self.high
        other = self.high if lack > 0.0 else self.low
        for seen in (side, other):
            if seen is not None and seen[0] != self.s and (seen[1] - lack) / (self.s - seen[0]) > 0.0:
                slope = (seen[1] - lack) / (self.s - seen[0])
                break
        self._narrow(lack)
        if self.met:
            return slope
        if self.low is None or self.high is None:
            # twice the way that the slope asks for, to have the root between, and ever longer; without a slope half the longest
            step = 2.0 * abs(lack) / slope * 4.0 ** (abs(self._kept) - 1) if slope > 0.0 else 0.5 * longest
            step = min(step, longest)
            if lack >= push.force:
                step = 2.0 * longest  # nothing resists
            self.s = min(self.s + step, self.full) if lack > 0.0 else max(self.s - step, self.least)
            return slope
        (a, lack_a), (b, lack_b) = self.low, self.high
        if b - a <= NARROWEST * longest:
            self.met = self.s == a  # the reaction jumps there: less than the force, not more
            self.s = a
            return slope
        if abs(self._kept) > 3:
            self.s = 0.5 * (a + b)  # a kink or a jump, which no secant finds
            return slope
        # Illinois: an end that stayed twice counts half
        if self._kept > 1:
            lack_b *= 0.5 ** (self._kept - 1)
        elif self._kept < -1:
            lack_a *= 0.5 ** (-self._kept - 1)
        self.s = a + (b - a) * lack_a / (lack_a - lack_b)
        return slope

    def _narrow(self, lack: float) -> None:
        """Move one end of the bracket to s. Other tools move too: an end that they have made wrong is forgotten."""
        if lack > 0.0:
            self.low, self._kept = (self.s, lack), self._kept + 1 if self._kept > 0 else 1
            if self.high is not None and self.high[0] <= self.s:
                self.high = None
        else:
            self.high, self._kept = (self.s, lack), self._kept - 1 if self._kept < 0 else -1
            if self.low is not None and self.low[0] >= self.s:
                self.low = None


def find_poses(
    pushes: Mapping[int, Push],
    memory: PushMemory,
    before: Sequence[Pose],
    targets: Sequence[Pose],
    dt: float,
    trial: Callable[[list[Pose]], Array],
) -> None:
    """Step the tools to where their forces are met within dt seconds.

    pushes : by tool. trial : makes the step, from the same state each time, with the tools going to the poses it is given
    (all of them) and returns their mean reactions (tools, 3) [N]; the last one counts. Raises SimulationError when a force is
    not met after TRIALS.
    """
    ways = {
        i: _Way.between(push, before[i], targets[i], dt, float(memory.rate[i]), memory.direction[i])
        for i, push in pushes.items()
    }
    for _ in range(TRIALS):
        poses = [ways[i].pose() if i in ways else pose for i, pose in enumerate(targets)]
        reaction = trial(poses)
        tried = {i: way.s for i, way in ways.items()}
        for i, way in ways.items():
            lack = pushes[i].force + float(reaction[i] @ way.direction)
            memory.slope[i] = way.learn(lack, pushes[i], float(memory.slope[i]), pushes[i].speed * dt)
        if all(way.met for way in ways.values()):
            for i, way in ways.items():
                memory.rate[i], memory.direction[i] = tried[i] / dt, way.direction
            return
    worst = max(pushes, key=lambda i: abs(pushes[i].force + float(reaction[i] @ ways[i].direction)) / pushes[i].force)
    raise SimulationError(
        f"tool {worst + 1} does not find where {pushes[worst].force:g} N hold it", mend="reduce the step or its speed"
    )
