"""Tool paths: poses at times, and the motion between them.

Between two rows the position moves on a straight line and the orientation turns at a constant rate about one axis,
the shorter way (spherical linear interpolation, Shoemake 1985). It is written R(t) = exp(f w) R_i with w the rotation
vector from one row to the next: the same motion as with quaternions, and each row's own rotation comes back bit for
bit. More than half a turn needs a row in between. Before its first row a tool waits there; after its last it stays.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .pose import Pose, rotation_matrix

Array = NDArray[np.float64]


class Row(Protocol):
    """A row of a path as a scene writes it: time in s, place, and [axis x, axis y, axis z, degrees]."""

    @property
    def t(self) -> float: ...
    @property
    def at(self) -> Sequence[float]: ...
    @property
    def turn(self) -> Sequence[float]: ...


@dataclass(frozen=True, slots=True, eq=False)
class ToolPath:
    """Where a tool is at every time.

    t (n,) : s, strictly increasing, not before the scene's zero. at (n, 3) : the tool's origin, in the scene's length
    unit. rotation (n, 3, 3) : orthonormal, right-handed; x_world = rotation @ x_tool + at. spin (n - 1, 3) : the
    rotation vectors from each row to the next, in the world's axes, rad, at most pi long.

    Raises InputError, naming the row counted from 1, when times do not increase or a number is not finite.
    """

    t: Array
    at: Array
    rotation: Array
    spin: Array = field(init=False)

    def __post_init__(self) -> None:
        t = np.array(self.t, dtype=np.float64)
        at = np.array(self.at, dtype=np.float64)
        rotation = np.array(self.rotation, dtype=np.float64)
        if t.ndim != 1 or len(t) == 0 or at.shape != (len(t), 3) or rotation.shape != (len(t), 3, 3):
            raise InputError(
                f"a path with {t.shape} times, {at.shape} places and {rotation.shape} rotations",
                mend="one row or more: t (n,), at (n, 3), rotation (n, 3, 3)",
            )
        finite = np.isfinite(t) & np.isfinite(at).all(axis=1) & np.isfinite(rotation).all(axis=(1, 2))
        if not finite.all():
            raise InputError(f"path row {_first(~finite)} holds a number that is not finite")
        if t[0] < 0.0:
            raise InputError(f"path row 1 is before time 0: t = {t[0]!r}")
        if not (np.diff(t) > 0.0).all():
            row = _first(np.diff(t) <= 0.0) + 1
            raise InputError(f"path row {row} goes back in time: t = {float(t[row - 1])!r} after {float(t[row - 2])!r}")
        proper = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) < 1e-9
        proper &= np.linalg.det(rotation) > 0.0
        if not proper.all():
            raise InputError(f"path row {_first(~proper)} has no rotation", mend="a right-handed orthonormal matrix")
        spin = np.zeros((len(t) - 1, 3))
        for i in np.flatnonzero((rotation[1:] != rotation[:-1]).any(axis=(1, 2))):
            spin[i] = rotation_vector(rotation[i + 1] @ rotation[i].T)
        for name, value in (("t", t), ("at", at), ("rotation", rotation), ("spin", spin)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @classmethod
    def of_rows(cls, rows: Iterable[Row]) -> ToolPath:
        """From the rows of a scene. Raises InputError as the class does."""
        listed = list(rows)
        turns = [rotation_matrix(np.array(row.turn[:3], dtype=np.float64), float(row.turn[3])) for row in listed]
        return cls(
            np.array([row.t for row in listed], dtype=np.float64),
            np.array([row.at for row in listed], dtype=np.float64).reshape(-1, 3),
            np.array(turns, dtype=np.float64).reshape(-1, 3, 3),
        )

    @classmethod
    def resting(cls, pose: Pose) -> ToolPath:
        """A tool that never moves by itself."""
        return cls(np.zeros(1), np.asarray(pose.at)[None], np.asarray(pose.rotation)[None])

    # ------------------------------------------------------------------ as a whole

    @property
    def duration(self) -> float:
        """The time at which the path ends, s from the scene's zero."""
        return float(self.t[-1])

    @property
    def length(self) -> float:
        """How far the tool's origin travels, in the scene's length unit."""
        return float(np.linalg.norm(np.diff(self.at, axis=0), axis=1).sum())

    @property
    def at_rest(self) -> bool:
        """True when the tool neither moves nor turns, ever."""
        return not np.diff(self.at, axis=0).any() and not self.spin.any()

    def scaled(self, factor: float) -> ToolPath:
        """The same motion with all lengths times `factor`. Raises InputError unless it is positive and finite."""
        if not (np.isfinite(factor) and factor > 0.0):
            raise InputError(f"a path scaled by {factor!r}", mend="a positive number")
        return ToolPath(self.t, self.at * factor, self.rotation)

    # ------------------------------------------------------------------ at a time

    def pose(self, t: float) -> Pose:
        """The tool's pose at t, s."""
        i, f = self._segment(t)
        if f == 0.0:
            return Pose(self.at[i], self.rotation[i])
        at = self.at[i] + f * (self.at[i + 1] - self.at[i])
        turning = self.spin[i].any()
        return Pose(at, rotation_of(f * self.spin[i]) @ self.rotation[i] if turning else self.rotation[i])

    def velocity(self, t: float) -> tuple[Array, Array]:
        """The velocity with which the tool leaves t: of its origin (3,), length unit per s, and angular (3,), rad/s.

        Both in the world's axes. At a row it is that of the motion after it; before the first row and from the last row
        on it is zero.
        """
        if not self.t[0] <= t < self.t[-1]:
            return np.zeros(3), np.zeros(3)
        i, _ = self._segment(t)
        dt = self.t[i + 1] - self.t[i]
        return (self.at[i + 1] - self.at[i]) / dt, self.spin[i] / dt

    def twist(self, t0: float, t1: float) -> tuple[Array, Array]:
        """The displacement (3,) and rotation vector (3,), rad, that take the pose at t0 to the one at t1.

        pose(t1).at = pose(t0).at + displacement, pose(t1).rotation = rotation_of(rotation vector) @ pose(t0).rotation.
        Within one segment the motion in between is this twist at a constant rate; `rows_between` says where segments
        meet.
        """
        start, end = self.pose(t0), self.pose(t1)
        (i, f), (j, g) = self._segment(t0), self._segment(t1)
        if j == i + 1 and g == 0.0:
            j, g = i, 1.0  # a row ends its segment
        if i == j:
            return end.at - start.at, (g - f) * self.spin[i] if g != f else np.zeros(3)
        return end.at - start.at, rotation_vector(end.rotation @ start.rotation.T)

    def rows_between(self, t0: float, t1: float) -> Array:
        """The times of the rows strictly between t0 and t1, where the velocity jumps."""
        return self.t[(self.t > t0) & (self.t < t1)]

    def _segment(self, t: float) -> tuple[int, float]:
        """The row at or before t, and how much of the way to the next is done: 0 at a row and outside the path."""
        if t != t:
            raise InputError("a tool's pose is asked for at a time that is no number")
        if t <= self.t[0]:
            return 0, 0.0
        if t >= self.t[-1]:
            return len(self.t) - 1, 0.0
        i = int(np.searchsorted(self.t, t, side="right")) - 1
        return i, float((t - self.t[i]) / (self.t[i + 1] - self.t[i]))


def rotation_of(vector: Array) -> Array:
    """exp of a rotation vector (3,), rad: the rotation matrix (3, 3) about it by its length (Rodrigues)."""
    angle = float(np.sqrt(vector @ vector))
    x, y, z = vector
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, half = 1.0, 0.5
    if angle > 1e-8:  # below, the next terms of both series are smaller than rounding
        sine, half = np.sin(angle) / angle, np.sin(0.5 * angle) / angle
    # 1 - cos(angle) = 2 sin(angle / 2)^2, without cancellation
    matrix: Array = np.eye(3) + sine * k + (2.0 * half * half) * (k @ k)
    return matrix


def rotation_vector(rotation: Array) -> Array:
    """log of a rotation matrix (3, 3): its rotation vector (3,), rad, at most pi long.

    Half a turn has two; the one whose largest component is positive is taken.
    """
    w, x, y, z = quaternion(rotation)
    sine = float(np.sqrt(x * x + y * y + z * z))
    if sine == 0.0:
        return np.zeros(3)
    vector: Array = np.array([x, y, z]) / sine * (2.0 * np.arctan2(sine, w))
    return vector


def quaternion(rotation: Array) -> Array:
    """The unit quaternion (w, x, y, z) of a rotation matrix (3, 3), w >= 0 (Shepperd 1978: divides by the largest)."""
    r = rotation
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    i = int(np.argmax([trace, r[0, 0], r[1, 1], r[2, 2]]))
    q = np.empty(4)
    if i == 0:
        q[:] = 1.0 + trace, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    else:
        a, b, c = i - 1, i % 3, (i + 1) % 3
        q[0] = r[c, b] - r[b, c]
        q[1 + a] = 1.0 + r[a, a] - r[b, b] - r[c, c]
        q[1 + b] = r[a, b] + r[b, a]
        q[1 + c] = r[a, c] + r[c, a]
    q /= np.sqrt(q @ q)
    return -q if q[0] < 0.0 else q


def rotation_of_quaternion(q: Array) -> Array:
    """The rotation matrix (3, 3) of a quaternion (w, x, y, z) of any length but zero."""
    w, x, y, z = q / np.sqrt(q @ q)
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def rotation_to_axis(axis: Array) -> Array:
    """The smallest rotation (3, 3) that turns z to `axis` (3,); about x where the axis is -z."""
    x, y, z = axis / np.linalg.norm(axis)
    across = float(np.hypot(x, y))
    if across < 1e-150:  # and its square is no number any more
        return np.eye(3) if z > 0.0 else np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    return rotation_of(np.array([-y, x, 0.0]) / across * np.arctan2(across, z))


def _first(wrong: NDArray[np.bool_]) -> int:
    """The number, from 1, of the first True."""
    return int(np.argmax(wrong)) + 1
