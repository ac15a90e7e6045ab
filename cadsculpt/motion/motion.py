"""One rigid motion within a step: straight, and turning at a constant rate about one axis."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .path import ToolPath, rotation_of, rotation_vector
from .pose import Pose

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Where a body is at s from 0 to 1 within a step, and bounds on how fast.

    start : the pose at s = 0. displacement (3,) : of the origin over the step. rotation (3,) : rotation vector over the
    step in the world's axes, rad, of any length. x_world(s) = rotation_of(s rotation) @ start.rotation @ x + start.at + s
    displacement.

    Raises InputError for a number that is not finite.
    """

    start: Pose
    displacement: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        for name in ("displacement", "rotation"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64).reshape(3))
        object.__setattr__(self, "start", Pose(np.array(self.start.at, dtype=np.float64), self.start.rotation))
        numbers = np.concatenate([self.displacement, self.rotation, self.start.at, self.start.rotation.ravel()])
        if not np.isfinite(numbers).all():
            raise InputError("a motion with a number that is not finite")

    @classmethod
    def of_path(cls, path: ToolPath, t0: float, t1: float) -> Motion:
        """A path's motion from t0 to t1, s, within one of its segments (`ToolPath.rows_between`)."""
        return cls(path.pose(t0), *path.twist(t0, t1))

    @classmethod
    def between(cls, start: Pose, end: Pose) -> Motion:
        """From one pose to another, turning the shorter way."""
        return cls(start, np.asarray(end.at) - start.at, rotation_vector(end.rotation @ start.rotation.T))

    @property
    def angle(self) -> float:
        """How far it turns over the step, rad."""
        return float(np.sqrt(self.rotation @ self.rotation))

    def pose(self, s: float) -> Pose:
        """The pose at s."""
        turned = rotation_of(s * self.rotation) @ self.start.rotation if self.rotation.any() else self.start.rotation
        return Pose(self.start.at + s * self.displacement, turned)

    def to_tool(self, points: Array, s: Array) -> Array:
        """Points (n, 3) of the world, each at its own s (n,), in the body's frame."""
        x = points - self.start.at - s[:, None] * self.displacement
        return np.asarray(_turned(x, self.rotation, -s) @ self.start.rotation)

    def to_world(self, vectors: Array, s: Array) -> Array:
        """Directions (n, 3) in the body's frame, each at its own s (n,), in the world."""
        return _turned(vectors @ self.start.rotation.T, self.rotation, s)

    def speed(self, radius: float) -> float:
        """Bound on the speed, per step, of any point within `radius` of the origin."""
        return float(np.sqrt(self.displacement @ self.displacement)) + self.angle * radius

    def arc(self, radius: float, s0: float, s1: float) -> float:
        """How far any point within `radius` of the axis leaves the straight line between its places at s0 and s1, run at
        a constant rate: max |x''| (s1 - s0)^2 / 8 with |x''| = radius angle^2."""
        turn = self.angle * (s1 - s0)
        return radius * turn * turn / 8.0 if turn > 0.0 else 0.0


def _turned(x: Array, rotation: Array, s: Array) -> Array:
    """Vectors (n, 3), each turned by s (n,) times a rotation vector (Rodrigues)."""
    angle = float(np.sqrt(rotation @ rotation))
    if angle == 0.0:
        return x
    k = rotation / angle
    cosine, sine = np.cos(s * angle)[:, None], np.sin(s * angle)[:, None]
    return np.asarray(cosine * x + sine * np.cross(k, x) + (1.0 - cosine) * (x @ k)[:, None] * k)
