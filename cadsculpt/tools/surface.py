"""A tool made of B-spline patches (paper section 4: the same pipeline on both sides)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..collide import detect
from ..collide.detect import PatchGrid
from ..errors import InputError
from ..motion.pose import Pose
from ..spline.surface import BSplineSurface

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceTool:
    """A tool of one or more patches, in the tool's frame and the scene's unit; `outward` is out of the tool.

    reach : how deep behind an open tool a model is still in contact: a deformable one's thickness. rest : its control points,
    per patch.
    """

    grids: tuple[PatchGrid, ...]
    reach: float = 0.0
    rest: tuple[Array, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "rest", tuple(grid.surface.control_points for grid in self.grids))

    @classmethod
    def of(cls, surfaces: list[BSplineSurface], resolution: int | tuple[int, int]) -> SurfaceTool:
        """Prepare the matrices of all patches at a resolution of about this many rows and columns each."""
        if not surfaces:
            raise InputError("a surface tool without a surface", mend="name a file with at least one face")
        return cls(tuple(PatchGrid.of(surface, resolution) for surface in surfaces))

    @property
    def box_corners(self) -> Array:
        """(2, 3): box of all control points in the tool's frame."""
        points = np.concatenate([grid.surface.control_points.reshape(-1, 3) for grid in self.grids])
        return np.array([points.min(axis=0), points.max(axis=0)])

    def placed(self, pose: Pose, nets: Sequence[Array] | None = None) -> detect.SurfaceTool:
        """The tool in the world, as the collision pipeline takes it. nets : its control points in the tool's frame, where it
        has deformed."""
        nets = [grid.surface.control_points for grid in self.grids] if nets is None else nets
        return detect.SurfaceTool(
            self.grids, tuple(np.ascontiguousarray(pose.to_world(net)) for net in nets), self.reach
        )

    def rigid(self, pose: Pose) -> detect.RigidSurfaceTool:
        """The tool as it was made, in its own frame: faster, where only contacts are asked for."""
        return detect.RigidSurfaceTool(self.grids, self.rest, pose.at, pose.rotation, self.reach)
