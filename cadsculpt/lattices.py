"""The lattices of a session: how they start, what carries them, and what the contacts do to them in a piece of a step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .collide.contacts import Contacts
from .errors import InputError, SimulationError
from .groups import Group, placed_nodes
from .loads import RIGID, LoadMaker, Sides
from .model import Model
from .motion.pose import Pose
from .physics.explicit import ContactLoad, LatticeState, StepForces, advance
from .physics.implicit import advance_implicit
from .plain_loads import PlainLoads, scatter

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(slots=True, eq=False)
class Lattices:
    """The groups of a model's patches under contact."""

    model: Model
    groups: tuple[Group, ...]
    _loads: LoadMaker = field(init=False)
    _plain: PlainLoads = field(init=False)

    def __post_init__(self) -> None:
        self._plain = PlainLoads(self.model)
        self._loads = LoadMaker(self.model.patches, self.model.metres_per_unit)

    def at_rest(self) -> list[LatticeState]:
        """A state for each group: models as they are, deformable tools where their paths begin, moving with them."""
        poses = [tool.path.pose(0.0) for tool in self.model.tools]
        frames = self.frames(poses)
        states = []
        for group in self.groups:
            state = LatticeState.at_rest(group.lattice)
            state.x[:] = placed_nodes(group, self.model.patches, frames)
            for i in group.patches:
                tool = self.model.tool_of(self.model.patches[i].body)
                if tool is not None:
                    mine = group.nodes_of(i)
                    linear, angular = self.model.tools[tool].path.velocity(0.0)
                    state.velocity[mine] = linear + np.cross(angular, state.x[mine] - poses[tool].at)
            states.append(state)
        return states

    def frames(self, poses: Sequence[Pose]) -> dict[int, Pose]:
        """The frames of the bodies that tools' poses carry, by their numbers."""
        return {
            k: pose
            for k, (tool, pose) in enumerate(zip(self.model.tools, poses, strict=True), start=self.model.models)
            if tool.patches
        }

    def regrouped(self, states: Sequence[LatticeState], groups: tuple[Group, ...]) -> list[LatticeState]:
        """The states of other groups of the same patches."""
        of_patch = self.of_patches(states)
        self.groups = groups
        states = self.joined(of_patch)
        for state in states:
            state.bound.seen[...] = np.inf  # of a lattice that is another one now
        return states

    def of_patches(self, states: Sequence[LatticeState]) -> list[LatticeState]:
        """The state of every patch: views."""
        found = {
            i: group.state_of(state, i) for group, state in zip(self.groups, states, strict=True) for i in group.patches
        }
        return [found[i] for i in range(len(self.model.patches))]

    def joined(self, of_patch: Sequence[LatticeState]) -> list[LatticeState]:
        """The states of the groups from those of the patches."""
        states = []
        for group in self.groups:
            state = LatticeState.at_rest(group.lattice)
            for i in group.patches:
                mine = group.nodes_of(i)
                state.x[mine], state.velocity[mine] = of_patch[i].x, of_patch[i].velocity
                state.rest_length[:, mine] = of_patch[i].rest_length
                bound = of_patch[i].bound
                state.bound.scale[mine], state.bound.seen[mine] = bound.scale, bound.seen
            state.bound.square = max(of_patch[i].bound.square for i in group.patches)
            states.append(state)
        return states

    def own_speed(
        self, states: Sequence[LatticeState], before: Sequence[Pose], after: Sequence[Pose], dt: float
    ) -> float:
        """The highest speed [L/s] of any node that moves by itself and may meet something that does not watch it: of a body
        that nothing holds, of a deformable tool beside the motion of its pose, and of patches that are integrated together.
        (A face alone under rigid tools is watched by how far these move.)"""
        speed = 0.0
        for group, state in zip(self.groups, states, strict=True):
            body = self.model.patches[group.patches[0]].body
            if len(group.patches) == 1 and body not in self.model.free and body < self.model.models:
                continue
            field = self._frame_velocity(group, state, before, after, dt)
            rate = state.velocity if field is None else state.velocity - field
            speed = max(speed, float(np.sqrt(np.einsum("nc,nc->n", rate, rate).max())))
        return speed

    def advance(
        self,
        states: Sequence[LatticeState],
        contacts: Contacts,
        before: Sequence[Pose],
        after: Sequence[Pose],
        dt: float,
        step: int,
    ) -> tuple[Array, Array]:
        """Let contacts act on all lattices for dt seconds while the tools move from poses `before` to `after`: mean forces (n,
        3) [N] on the bodies a and depths (n,) at the end. step : its number from 1, for messages.

        Raises SimulationError where a lattice becomes unstable; all states are then as they were.
        """
        if self._plain.all_plain(contacts):
            return self._advance_plain(states, contacts, before, after, dt, step)
        forces, depths = np.zeros((len(contacts), 3)), np.array(contacts.depth)
        sides = self._sides(contacts)
        velocity = self._velocities(contacts, sides, before, after, dt)
        kept = [(state.x.copy(), state.velocity.copy(), state.rest_length.copy()) for state in states[:-1]]
        for place, (group, state) in enumerate(zip(self.groups, states, strict=True)):
            mine = np.flatnonzero(np.isin(sides.main, group.patches))
            if not len(mine) and self._rests(group, state, before, after):
                continue  # nothing to integrate, however long the step
            load = None
            if len(mine):
                own = Sides(sides.a[mine], sides.b[mine])
                load = self._loads.load(group, contacts.chosen(mine), own, velocity[mine])
            start = state.velocity.copy()
            field = self._frame_velocity(group, state, before, after, dt)
            if field is not None:
                held = group.lattice.inverse_mass == 0.0
                state.velocity[held] = field[held]
            try:
                result = self._integrate(group, state, load, dt, field)
            except SimulationError as error:
                state.velocity[:] = start
                for lattice, (x, v, rest) in zip(states, kept[:place], strict=False):
                    lattice.x[:], lattice.velocity[:], lattice.rest_length[:] = x, v, rest
                raise SimulationError(error.what, where=f"step {step}, {self._named(group)}", mend=error.mend) from None
            forces[mine] = sides.sign[mine, None] * result.mean_force
            depths[mine] = result.depth
        return forces, depths

    # -------------------------------------------------------------- internals

    def _advance_plain(
        self,
        states: Sequence[LatticeState],
        contacts: Contacts,
        before: Sequence[Pose],
        after: Sequence[Pose],
        dt: float,
        step: int,
    ) -> tuple[Array, Array]:
        """The same where rigid tools meet lattices that no tool carries, without allocating: the results hold until the next
        call."""
        plain = self._plain
        forces, depths, velocity = plain.begin(contacts, before, after, dt)
        plain.keep(states[:-1])
        for group, state in zip(self.groups, states, strict=True):
            mine, load = plain.load(group, contacts, velocity)
            if load is None and self.model.scene.solver.substep is None and plain.rests(group, state):
                continue  # nothing to integrate, however long the step
            try:
                result = self._integrate(group, state, load, dt, None)
            except SimulationError as error:
                plain.put_back(states[:-1])
                raise SimulationError(error.what, where=f"step {step}, {self._named(group)}", mend=error.mend) from None
            scatter(mine, result.mean_force, result.depth, forces, depths)
        return forces, depths

    def _named(self, group: Group) -> str:
        """A group in words: its face, or its bodies."""
        patches = [self.model.patches[i] for i in group.patches]
        if len(patches) == 1 and patches[0].body < self.model.models:
            return f"face {patches[0].name!r}"
        words = {
            p.body: f"{'model' if p.body < self.model.models else 'tool'} {self.model.bodies[p.body]!r}"
            for p in patches
        }
        return " with ".join(words.values())

    def _sides(self, contacts: Contacts) -> Sides:
        """Which patches carry the contacts on both sides."""
        count = len(self.model.patches)
        a = np.where(contacts.face < count, contacts.face, RIGID)
        b = np.full(len(contacts), RIGID)
        for body in np.unique(contacts.b).tolist():
            faces = self.model.faces_of[body]
            if faces and faces[0] < count:
                mine = np.flatnonzero(contacts.b == body)
                b[mine] = np.array(faces)[contacts.tool_face[mine]]
        return Sides(a, b)

    def _velocities(
        self, contacts: Contacts, sides: Sides, before: Sequence[Pose], after: Sequence[Pose], dt: float
    ) -> Array:
        """Mean velocity (n, 3) of the side that has no lattice, at each contact: that of a rigid tool's material."""
        velocity = np.zeros((len(contacts), 3))
        for tool, (a, b) in enumerate(zip(before, after, strict=True)):
            mine = (contacts.b == self.model.models + tool) & (sides.b == RIGID)
            velocity[mine] = (b.to_world(a.to_tool(contacts.point[mine])) - contacts.point[mine]) / dt
        return velocity

    def _frame_velocity(
        self, group: Group, state: LatticeState, before: Sequence[Pose], after: Sequence[Pose], dt: float
    ) -> Array | None:
        """The velocity (N, 3) with which tools' poses carry the nodes of a group; None where there is no tool in it."""
        velocity: Array | None = None
        for i in group.patches:
            tool = self.model.tool_of(self.model.patches[i].body)
            if tool is not None:
                velocity = np.zeros_like(state.x) if velocity is None else velocity
                mine = group.nodes_of(i)
                # held nodes are where the pose puts them, but for rounding, which must not pile up
                x = state.x[mine]
                end = after[tool].to_world(before[tool].to_tool(x))
                held = group.lattice.anchored[mine]
                end[held] = after[tool].to_world(self.model.patches[i].lattice.nodes[held])
                velocity[mine] = (end - x) / dt
        return velocity

    def _rests(self, group: Group, state: LatticeState, before: Sequence[Pose], after: Sequence[Pose]) -> bool:
        """A group as it was built, on which nothing acts: it stays as it is. (A sub-step that the scene forces is not
        left unchecked until something acts.)"""
        if self.model.scene.solver.substep is not None or state.velocity.any():
            return False
        frames, ends = self.frames(before), self.frames(after)
        for i in group.patches:
            k = self.model.patches[i].body
            if k in frames and not (
                np.array_equal(frames[k].at, ends[k].at) and np.array_equal(frames[k].rotation, ends[k].rotation)
            ):
                return False
        return np.array_equal(state.x, placed_nodes(group, self.model.patches, frames)) and np.array_equal(
            state.rest_length, group.lattice.rest_length
        )

    def _integrate(
        self, group: Group, state: LatticeState, load: ContactLoad | None, dt: float, frame_velocity: Array | None
    ) -> StepForces:
        solver = self.model.scene.solver
        if solver.integrator == "explicit":
            try:
                return advance(group.lattice, state, load, dt, substep=solver.substep, frame_velocity=frame_velocity)
            except InputError as error:
                raise InputError(error.what, where="solver.substep", mend=error.mend) from None
        return advance_implicit(
            group.lattice,
            state,
            load,
            dt,
            quasi_static=solver.quasi_static,
            substep=solver.substep,
            frame_velocity=frame_velocity,
        )
