"""Rigid poses: a rotation and a translation."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """x_world = rotation @ x_tool + at.

    at (3,) in the scene's length unit; rotation (3, 3) orthonormal, right-handed.
    """

    at: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))

    @classmethod
    def turned(cls, at: ArrayLike, axis: ArrayLike = (0.0, 0.0, 1.0), degrees: float = 0.0) -> Pose:
        """At a place, turned about an axis (Rodrigues). A zero axis turns nothing."""
        return cls(np.asarray(at, dtype=np.float64), rotation_matrix(np.asarray(axis, dtype=np.float64), degrees))

    def to_world(self, points: Array) -> Array:
        """(..., 3) tool coordinates to world."""
        return points @ self.rotation.T + self.at

    def to_tool(self, points: Array) -> Array:
        """(..., 3) world coordinates to the tool's own."""
        return (points - self.at) @ self.rotation

    def direction_to_world(self, vectors: Array) -> Array:
        """Rotate (..., 3) without translating."""
        return vectors @ self.rotation.T

    def box(self, corners: Array) -> Array:
        """The box (2, 3) in the world, low and high corner, of a finite box (2, 3) in the tool's frame."""
        middle, half = self.to_world(0.5 * (corners[0] + corners[1])), np.abs(self.rotation) @ (corners[1] - corners[0])
        return np.array([middle - 0.5 * half, middle + 0.5 * half])

    def then(self, other: Pose) -> Pose:
        """This pose followed by `other`: x -> other(self(x))."""
        return Pose(other.rotation @ self.at + other.at, other.rotation @ self.rotation)


def rotation_matrix(axis: Array, degrees: float) -> Array:
    """Rotation by `degrees` about `axis` (3,), right-handed; exact for multiples of 90 degrees."""
    length = float(np.linalg.norm(axis))
    if length == 0.0 or degrees == 0.0:
        return np.eye(3)
    x, y, z = axis / length
    quarter, rest = divmod(degrees, 90.0)
    if rest == 0.0:
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarter) % 4]
    else:
        c, s = float(np.cos(np.radians(degrees))), float(np.sin(np.radians(degrees)))
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + s * k + (1.0 - c) * (k @ k)
