"""What a session asks of continuous collision: how far the tools may move before one of them touches a part.

Between two looks at the contacts, nets move in straight lines and tools along their motions (`collide.continuous.sweep`).
What is said to be free is certified, however fast anything moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .collide.continuous.sweep import (
    MovingField,
    MovingPatches,
    MovingPoint,
    RigidPatches,
    SweepCache,
    TimeOfContact,
    first_contact,
)
from .collide.detect import DistanceField, PatchGrid
from .collide.query import BoundedField, lower_bound
from .model import Model
from .motion.motion import Motion
from .motion.pose import Pose
from .tools.point import PointTool
from .tools.surface import SurfaceTool

Array = NDArray[np.float64]

NEAR = 1e-5
"""Two bodies touch, in time, where they are within this share of the stride."""


@dataclass(slots=True, eq=False)
class Lookahead:
    """Continuous collision of a model's bodies and tools; keeps what can be reused from step to step."""

    model: Model
    _patches: list[list[int]] = field(init=False)
    _rest: list[tuple[Array, ...]] = field(init=False)
    _caches: dict[tuple[int, int], SweepCache] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        bodies = range(len(self.model.bodies))
        self._patches = [[i for i, patch in enumerate(self.model.patches) if patch.body == body] for body in bodies]
        tools = [tool.tool for tool in self.model.tools]
        self._rest = [
            tuple(grid.surface.control_points for grid in tool.grids) if isinstance(tool, SurfaceTool) else ()
            for tool in tools
        ]

    def free(self, before: Sequence[Array], after: Sequence[Array], motions: Sequence[Motion]) -> float:
        """The share of all motions, 0 to 1, in which nothing touches while the nets go from `before` to `after`."""
        share = 1.0
        for body in range(len(self.model.bodies)):
            for tool, motion in enumerate(motions):
                found = self._contact(before, after, motion, body, tool)
                share = share if found is None else min(share, found.low)
        return share

    def meeting(self, nets: Sequence[Array], motion: Motion, body: int, tool: int) -> float | None:
        """The share of a motion at which a tool reaches a body at rest; None where it does not."""
        found = self._contact(nets, nets, motion, body, tool)
        return None if found is None else min(1.0, max(found.low, found.high))

    def _contact(
        self, before: Sequence[Array], after: Sequence[Array], motion: Motion, body: int, tool: int
    ) -> TimeOfContact | None:
        still = before is after
        start = self._nets(before, body)
        moving = MovingPatches(self._grids(body), start, start if still else self._nets(after, body))
        cache = self._caches.setdefault((body, tool), SweepCache())
        return first_contact(moving, self._moving(tool, motion), tolerance=NEAR * self.model.stride, cache=cache)

    def _grids(self, body: int) -> tuple[PatchGrid, ...]:
        return tuple(self.model.patches[i].grid for i in self._patches[body])

    def _nets(self, nets: Sequence[Array], body: int) -> tuple[Array, ...]:
        return tuple(nets[i] for i in self._patches[body])

    def _moving(self, tool: int, motion: Motion) -> RigidPatches | MovingField | MovingPoint:
        body = self.model.tools[tool].tool
        if isinstance(body, PointTool):
            return MovingPoint(motion)
        if isinstance(body, SurfaceTool):
            return RigidPatches(body.grids, self._rest[tool], motion)
        return MovingField(_InFrame(body.placed(Pose()).field), body.box_corners, motion, convex=body.convex)


@dataclass(frozen=True, slots=True, eq=False)
class _InFrame:
    """A tool's signed distance in its own frame: what is certain of it, and the distance itself only where the bound says
    nothing, beside the tool's surface."""

    rest: DistanceField

    def field(self, points: Array) -> tuple[Array, Array]:
        value = np.array(lower_bound(self.rest, points))
        beside = value == 0.0
        if isinstance(self.rest, BoundedField) and beside.any():
            value[beside] = self.rest.distance(points[beside])
        return value, self.rest.gradient(points)
