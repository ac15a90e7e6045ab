"""A point tool (paper 4.9.2): the tip of a stylus."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..collide import detect
from ..errors import InputError
from ..motion.pose import Pose

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PointTool:
    """One point at the origin of the tool's frame.

    area : the piece of surface that its contact stands for, in the scene's unit squared: a point has none of its own, and
    without one the force would depend on the resolution. reach : how deep below a surface it is still in the material, the
    thickness of a sheet.
    """

    area: float
    reach: float = np.inf

    def __post_init__(self) -> None:
        if not (np.isfinite(self.area) and self.area > 0):
            raise InputError(f"a point tool with an area of {self.area}", mend="give a positive area")
        if not self.reach > 0:
            raise InputError(f"a point tool with a reach of {self.reach}", mend="give the material's thickness")

    @property
    def box_corners(self) -> Array:
        """(2, 3): the point itself."""
        return np.zeros((2, 3))

    def placed(self, pose: Pose) -> detect.PointTool:
        """The tool in the world, as the collision pipeline takes it."""
        return detect.PointTool(np.asarray(pose.at, dtype=np.float64), self.area, self.reach)
