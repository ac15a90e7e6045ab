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
from .collide.detect import DistanceField
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
    """Continuous collision of a model's bodies; keeps what can be reused from step to step.

    Nets are those of `State.control_points`: of a deformable tool in the tool's frame, else in the world. What is not in it is
    how the shape of a turning tool changes on the way, and what bodies that nothing holds do of themselves.
    """

    model: Model
    _rest: dict[int, tuple[Array, ...]] = field(init=False)
    _caches: dict[tuple[int, int], SweepCache] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        model = self.model
        self._rest = {
            k: tuple(grid.surface.control_points for grid in tool.tool.grids)
            for k, tool in enumerate(model.tools, start=model.models)
            if isinstance(tool.tool, SurfaceTool)
        }

    def free(self, before: Sequence[Array], after: Sequence[Array], motions: Sequence[Motion]) -> float:
        """The share of all motions, 0 to 1, in which nothing touches while the nets go from `before` to `after`."""
        share, pairs = 1.0, self.model.pairs
        for a, b, meet in zip(pairs.a.tolist(), pairs.b.tolist(), pairs.meet.tolist(), strict=True):
            # (two models at rest do not come any nearer)
            if meet and (b >= self.model.models or before is not after):
                found = self._contact(before, after, motions, a, b)
                share = share if found is None else min(share, found.low)
        return share

    def meeting(self, nets: Sequence[Array], motions: Sequence[Motion], a: int, b: int) -> float | None:
        """The share of the tools' motions at which the bodies of a pair come to touch, all shapes at rest; None where they do
        not, or no tool is one of them."""
        if b < self.model.models:
            return None
        found = self._contact(nets, nets, motions, a, b)
        return None if found is None else min(1.0, max(found.low, found.high))

    def _contact(
        self, before: Sequence[Array], after: Sequence[Array], motions: Sequence[Motion], a: int, b: int
    ) -> TimeOfContact | None:
        cache = self._caches.setdefault((a, b), SweepCache())
        first, second = self._patches(before, after, motions, a), self._body(before, after, motions, b)
        return first_contact(first, second, tolerance=NEAR * self.model.stride, cache=cache)

    def _patches(
        self, before: Sequence[Array], after: Sequence[Array], motions: Sequence[Motion], body: int
    ) -> MovingPatches:
        """A body of patches, on straight lines between its places."""
        model, tool = self.model, self.model.tool_of(body)
        faces = model.faces_of[body]
        grids = tuple(model.face(i).grid for i in faces)
        start = tuple(self._net(before, i) for i in faces)
        end = start if before is after else tuple(self._net(after, i) for i in faces)
        if tool is not None:
            first, last = motions[tool].start, motions[tool].pose(1.0)
            start, end = (
                tuple(np.ascontiguousarray(pose.to_world(net)) for net in nets)
                for pose, nets in ((first, start), (last, end))
            )
        return MovingPatches(grids, start, end)

    def _net(self, nets: Sequence[Array], face: int) -> Array:
        return nets[face] if face < len(nets) else self.model.face(face).grid.surface.control_points

    def _body(
        self, before: Sequence[Array], after: Sequence[Array], motions: Sequence[Motion], body: int
    ) -> MovingPatches | RigidPatches | MovingField | MovingPoint:
        index = self.model.tool_of(body)
        if index is None:
            return self._patches(before, after, motions, body)
        tool, motion = self.model.tools[index], motions[index]
        if isinstance(tool.tool, PointTool):
            return MovingPoint(motion)
        if isinstance(tool.tool, SurfaceTool):
            if tool.patches and any(before[i] is not after[i] for i in tool.patches):
                return self._patches(before, after, motions, body)
            nets = tuple(before[i] for i in tool.patches) or self._rest[body]
            return RigidPatches(tool.tool.grids, nets, motion)
        return MovingField(
            _InFrame(tool.tool.placed(Pose()).field), tool.tool.box_corners, motion, convex=tool.tool.convex
        )


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
