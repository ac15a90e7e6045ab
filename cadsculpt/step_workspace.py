"""What a session works in from step to step, so that a warm step allocates no array.

Everything here is overwritten by the next step: whoever keeps contacts, forces or nets beyond it copies them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .collide.contacts import ContactBuffer
from .jit import njit_in_place
from .model import Model
from .motion.pose import Pose
from .reaction import StepActs
from .spline.refit import RefitRoom

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(slots=True, eq=False)
class StepWorkspace:
    """The memory of one session's steps.

    contacts : of the piece of the step at hand. acts : what acted in the step. here : poses of the tools in arrays of one kind.
    nets : two for each patch, written to by turns: the one before stays as it was for one step.
    """

    model: Model
    contacts: ContactBuffer = field(default_factory=ContactBuffer)
    acts: StepActs = field(init=False)
    here: list[Pose] = field(init=False)
    reach: Array = field(init=False)
    refits: list[RefitRoom] = field(init=False)
    rest: list[Array] = field(init=False)
    now: list[Array] = field(init=False)
    moved: list[Array] = field(init=False)
    nets: list[tuple[Array, Array]] = field(init=False)
    _at: Array = field(init=False)
    _turn: Array = field(init=False)
    _place: Index = field(init=False)

    def __post_init__(self) -> None:
        model = self.model
        tools, bodies = len(model.tools), len(model.bodies)
        self.acts = StepActs(tools, first=model.models)
        self.here = [Pose() for _ in model.tools]
        self.reach = np.array([np.linalg.norm(tool.tool.box_corners, axis=1).max() for tool in model.tools])
        self.refits = [RefitRoom.of(patch.refit) for patch in model.patches]
        self.rest = [patch.surface.control_points.copy() for patch in model.patches]
        self.now = [rest.copy() for rest in self.rest]
        self.moved = [np.empty((*patch.lattice.shape[:2], 3)) for patch in model.patches]
        self.nets = [(np.empty_like(rest), np.empty_like(rest)) for rest in self.rest]
        self._at, self._turn = np.empty((2, tools, 3)), np.empty((2, tools, 3, 3))
        self._place = np.full((bodies, bodies), -1, dtype=np.int64)
        self._place[model.pairs.a, model.pairs.b] = np.arange(len(model.pairs))

    def pose(self, tool: int, pose: Pose) -> Pose:
        """The pose of a tool in arrays of the workspace: whatever the caller's are like, kernels see one kind."""
        here = self.here[tool]
        here.at[...], here.rotation[...] = pose.at, pose.rotation
        return here

    def travel(self, before: Sequence[Pose], after: Sequence[Pose]) -> float:
        """How far any point of a tool moves, at most, between these poses."""
        for k, poses in enumerate((before, after)):
            for tool, pose in enumerate(poses):
                self._at[k, tool], self._turn[k, tool] = pose.at, pose.rotation
        middle, half = self.model.ball
        return float(farthest(self._at, self._turn, self.reach, middle, half))

    def refit(self, index: int, x: Array, net: Array) -> Array:
        """The control points of a patch that go with its nodes x (N, 3) in its frame: `net`, where they are the same."""
        patch = self.model.patches[index]
        shape, moved, rest, now = patch.lattice.shape, self.moved[index], self.rest[index], self.now[index]
        np.subtract(x.reshape(*shape, 3)[:, :, 0], patch.lattice.nodes.reshape(*shape, 3)[:, :, 0], out=moved)
        delta = patch.refit.fit(moved, self.model.refit_threshold, self.refits[index])
        one, two = self.nets[index]
        fresh = two if net.base is one else one
        np.copyto(now, net)
        if not moved_net(rest, delta, now, fresh):
            return net
        # a view of its own: whoever asks whether it is the same array is told no
        fresh = fresh.view()
        fresh.flags.writeable = False
        return fresh

    def untouched(self, a: Index, b: Index, touched: Array) -> bool:
        """Some pair of these contacts (n,) of bodies has not touched before. touched : per pair of the model, NaN where not."""
        return bool(any_untouched(a, b, self._place, touched))


@njit_in_place
def farthest(at: Array, turn: Array, reach: Array, middle: Array, half: float) -> float:
    """The longest way of any point of the tools from the poses at[0] (tools, 3), turn[0] (tools, 3, 3) to at[1], turn[1].

    reach (tools,) : from a tool's origin to its farthest point; of a tool without an end, what is near the ball around
    `middle` counts.
    """
    longest = 0.0
    for tool in range(len(reach)):
        way2, turned2, far = 0.0, 0.0, reach[tool]
        for i in range(3):
            way2 += (at[1, tool, i] - at[0, tool, i]) ** 2
            for j in range(3):
                turned2 += (turn[1, tool, i, j] - turn[0, tool, i, j]) ** 2
        if not np.isfinite(far):
            far = 0.0
            for k in range(2):
                away2 = 0.0
                for i in range(3):
                    away2 += (middle[i] - at[k, tool, i]) ** 2
                far = max(far, np.sqrt(away2))
            far += half
        longest = max(longest, np.sqrt(way2) + far * np.sqrt(turned2))
    return longest


@njit_in_place
def moved_net(rest: Array, delta: Array, before: Array, net: Array) -> bool:
    """rest + delta (r, s, 3) into `net`, rest where delta is 0; whether it is another net than `before`."""
    changed = False
    for i in range(rest.shape[0]):
        for j in range(rest.shape[1]):
            for c in range(3):
                x = rest[i, j, c] if delta[i, j, c] == 0.0 else rest[i, j, c] + delta[i, j, c]
                changed = changed or x != before[i, j, c]
                net[i, j, c] = x
    return changed


@njit_in_place
def any_untouched(a: Index, b: Index, place: Index, touched: Array) -> bool:
    """Some contact is of a pair whose `touched` is NaN."""
    found = False
    for c in range(len(a)):
        found = found or np.isnan(touched[place[a[c], b[c]]])
    return bool(found)
