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
from ..spline.matrices import span_lengths
from ..spline.surface import BSplineSurface

Array = NDArray[np.float64]

FEWEST = 13
"""Rows and columns of a tool's patch that is small beside the model's cells."""


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
    def of(cls, surfaces: list[BSplineSurface], resolution: int | tuple[int, int], cell: float = 0.0) -> SurfaceTool:
        """Prepare the matrices of all patches at a resolution of about this many rows and columns each, or fewer: none that
        make cells smaller than `cell`, the model's, whose vertices are where contacts are."""
        if not surfaces:
            raise InputError("a surface tool without a surface", mend="name a file with at least one face")
        most = (resolution, resolution) if isinstance(resolution, int) else resolution
        return cls(tuple(PatchGrid.of(surface, _rows(surface, most, cell)) for surface in surfaces))

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


def _rows(surface: BSplineSurface, most: tuple[int, int], cell: float) -> tuple[int, int]:
    """Rows and columns whose cells are about `cell` wide, FEWEST at least and `most` at most."""
    if cell == 0.0:
        return most
    lengths = [float(span_lengths(surface, axis).sum()) for axis in (0, 1)]
    u, v = (min(n, max(FEWEST, int(np.ceil(length / cell)) + 1)) for n, length in zip(most, lengths, strict=True))
    return u, v
