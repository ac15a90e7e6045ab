"""The heart: one `Session` steps a model under moving tools (paper section 4.1, run-time phase).

Each step: collide with the tools where they are, let the contact forces and the lattice act for dt while the tools move,
refit the control points to the moved nodes. Nothing here prints, reads a clock or touches a file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .collide.contacts import Contacts
from .collide.detect import Counters, DetectCache, Detection, DetectOptions, Undecided, detect
from .errors import InputError, SimulationError
from .force_control import PushMemory, find_poses
from .lookahead import Lookahead
from .model import Model
from .motion.motion import Motion
from .motion.pose import Pose
from .physics.explicit import ContactLoad, LatticeState, StepForces, advance
from .physics.forces import node_weights
from .physics.implicit import advance_implicit
from .physics.lattice import Lattice
from .reaction import Reaction, StepActs
from .spline.refit import RefitError
from .spline.surface import BSplineSurface

Array = NDArray[np.float64]


MOST_PIECES = 10000
"""A step in which tools in contact move so far that it would take more pieces is refused: it is a mistake in the scene."""

_LATTICE_STATE = ("x", "velocity", "rest_length")


@dataclass(slots=True, eq=False)
class State:
    """Everything that changes: time [s], tool poses, and per patch the lattice and the control points.

    touched (bodies, tools) : when each pair touched first [s]; NaN where it has not. pushes : of tools under force control.
    """

    time: float
    step: int
    poses: list[Pose]
    lattices: list[LatticeState]
    control_points: list[Array]
    touched: Array
    pushes: PushMemory

    def copy(self) -> State:
        """A state of its own with the same values. (Control points are not written to, only replaced.)"""
        return replace(
            self,
            poses=list(self.poses),
            lattices=[lattice.copy() for lattice in self.lattices],
            control_points=list(self.control_points),
            touched=self.touched.copy(),
        )


class Buildable(Protocol):
    """A scene that can read its own files."""

    def build(self) -> Model: ...


@dataclass(slots=True, eq=False)
class Session:
    """A simulation in progress.

    source : a `Model`, or a scene that builds one. After `step`, `contacts` and `forces` (n, 3) [N, on the model] hold
    the contacts that acted during it, `depths` (n,) how deep they are at its end (in the deepest piece of a step that
    continuous collision cuts). `clock`, a timer in seconds, fills `timing` with the seconds that each phase of each step
    took. `undecided` : per body and tool, how deep a contact may have been that was not found (see `query.Undecided`); empty as
    a rule.
    """

    source: Model | Buildable
    clock: Callable[[], float] | None = None
    model: Model = field(init=False)
    state: State = field(init=False)
    contacts: Contacts = field(init=False)
    forces: Array = field(init=False)
    depths: Array = field(init=False)
    counters: Counters = field(init=False)
    undecided: dict[tuple[int, int], float] = field(init=False)
    timing: dict[str, list[float]] = field(init=False)
    lookahead: Lookahead = field(init=False)
    _caches: list[DetectCache] = field(init=False)

    def __post_init__(self) -> None:
        self.model = self.source if isinstance(self.source, Model) else self.source.build()
        model = self.model
        self.state = State(
            time=0.0,
            step=0,
            poses=[tool.path.pose(0.0) for tool in model.tools],
            lattices=[LatticeState.at_rest(patch.lattice) for patch in model.patches],
            control_points=[patch.surface.control_points.copy() for patch in model.patches],
            touched=np.full((len(model.bodies), len(model.tools)), np.nan),
            pushes=PushMemory.of(len(model.tools)),
        )
        self.lookahead = Lookahead(model)
        self._caches = [DetectCache() for _ in model.bodies]
        self.contacts, self.forces, self.depths = Contacts.none(), np.zeros((0, 3)), np.zeros(0)
        self.counters = Counters()
        self.undecided = {}
        self.timing = {"collide": [], "lattice": [], "refit": []}

    # ------------------------------------------------------------------ step

    def step(self, poses: Mapping[str, Pose] | None = None, dt: float | None = None) -> dict[str, Reaction]:
        """Move the tools to `poses` (by name; those not named follow their paths) within dt seconds.

        Raises SimulationError when the lattice becomes unstable, InputError for a tool that does not exist.
        """
        model, state = self.model, self.state
        dt = model.step if dt is None else dt
        if not (np.isfinite(dt) and dt > 0):
            raise InputError(f"a step of {dt} s", mend="a step takes a positive time")
        given, start, before = dict(poses or {}), state.time, state.poses
        self._refuse_unknown(given)
        acts = StepActs(len(model.tools), dt)
        for time in self._stops(given, start, dt):
            after = [
                given[tool.name] if time == start + dt and tool.name in given
                else Motion.between(before[i], given[tool.name]).pose((time - start) / dt) if tool.name in given
                else tool.path.pose(time)
                for i, tool in enumerate(model.tools)
            ]  # fmt: skip
            if model.pushes:
                acts = self._push(after, time, acts)
            else:
                self._follow(after, time, acts)
        state = self.state
        state.time, state.step = start + dt, state.step + 1
        for phase, seconds in acts.seconds.items():
            self.timing[phase].append(seconds)
        self.contacts, self.forces, self.depths = acts.contacts, acts.forces, acts.depths
        return {tool.name: acts.reaction(i) for i, tool in enumerate(model.tools)}

    def _stops(self, given: Mapping[str, Pose], start: float, dt: float) -> list[float]:
        """The times until which the tools move steadily: the step's end, and where their paths turn within a step so
        long that a tool could pass through a part in it."""
        end = start + dt
        turns = {
            float(t) for tool in self.model.tools if tool.name not in given for t in tool.path.rows_between(start, end)
        }
        if not turns:
            return [end]
        stops = [*sorted(turns), end]
        travel, here = 0.0, self.state.poses
        for time in stops:
            there = [given.get(tool.name, tool.path.pose(time)) for tool in self.model.tools]
            travel, here = travel + self._margin(here, there), there
        return stops if travel > self.model.stride else [end]

    def _push(self, targets: list[Pose], end: float, acts: StepActs) -> StepActs:
        """Move the tools towards `targets`, those under force control as far as their force takes them. Returns `acts` with
        what acted meanwhile."""
        start, undecided, share = self.state, dict(self.undecided), acts.dt / (end - self.state.time)
        done = acts

        def trial(poses: list[Pose]) -> Array:
            nonlocal done
            self.state, self.undecided, done = start.copy(), dict(undecided), acts.copy()
            self._follow(poses, end, done)
            return (done.force - acts.force) * share

        try:
            find_poses(self.model.pushes, start.pushes, start.poses, targets, end - start.time, trial)
        except SimulationError:
            self.state = start
            raise
        return done

    def _follow(self, after: list[Pose], end: float, acts: StepActs) -> None:
        """Move the tools to `after`, in one piece where that is no farther than `Model.stride`.

        Else by continuous collision: freely up to the first contact, and in pieces of one stride while in contact.
        Raises SimulationError when that takes more pieces than MOST_PIECES.
        """
        state = self.state
        for _ in range(MOST_PIECES):
            travel = self._margin(state.poses, after)
            if travel <= self.model.stride:
                self._piece(after, end, acts)
                return
            tick = self._tick()
            motions = [Motion.between(a, b) for a, b in zip(state.poses, after, strict=True)]
            stride = self.model.stride / travel
            # inside the material there is no surface to meet: what is in contact is watched
            touching = len(self.detect(state.poses).contacts) > 0
            free = 0.0 if touching else self.lookahead.free(state.control_points, state.control_points, motions)
            acts.seconds["collide"] += self._tick() - tick
            if free > stride and self._free_piece(motions, free, after, end, acts):
                if free == 1.0:
                    return
                continue
            self._piece([motion.pose(stride) for motion in motions], state.time + stride * (end - state.time), acts)
        raise SimulationError(
            f"a tool moves {self._margin(state.poses, after):.4g} {self.model.scene.units} within one step while in contact",
            where=f"step {state.step + 1}",
            mend=f"take a step of at most {self.model.step * MOST_PIECES * stride:.3g} s",
        )

    def _free_piece(self, motions: list[Motion], share: float, after: list[Pose], end: float, acts: StepActs) -> bool:
        """Move the tools by a share of their motions, without contact; or nothing, and False, when the material comes to
        meet one of them meanwhile."""
        state = self.state
        kept = [lattice.copy() for lattice in state.lattices], list(state.control_points), state.time, state.poses
        time = end if share == 1.0 else state.time + share * (end - state.time)
        poses = after if share == 1.0 else [motion.pose(share) for motion in motions]
        self._piece(poses, time, acts, watched=False)
        moved = [Motion.between(a, b) for a, b in zip(kept[3], poses, strict=True)]
        nets = state.control_points
        if (
            any(a is not b for a, b in zip(nets, kept[1], strict=True))
            and self.lookahead.free(kept[1], nets, moved) < 1.0
        ):
            state.lattices, state.control_points, state.time, state.poses = kept
            return False
        return True

    def _piece(self, after: list[Pose], end: float, acts: StepActs, *, watched: bool = True) -> None:
        """Collide with the tools where they are, let contact forces and lattices act until they are at `after`, refit."""
        state, before, dt = self.state, self.state.poses, end - self.state.time
        tick = self._tick()
        contacts = self.detect(before, self._margin(before, after)).contacts if watched else Contacts.none()
        collided = self._tick()
        try:
            forces, depths = self._advance(contacts, _tool_velocities(contacts, before, after, dt), dt)
        except SimulationError:
            self._note_touched(contacts, before, after, dt, certain=False)
            raise
        advanced = self._tick()
        acting = acts.add(contacts, forces, depths, before, after, dt, self.model.metres_per_unit)
        self._note_touched(contacts.chosen(acting), before, after, dt)
        for index in range(len(self.model.patches)):
            self._refit(index)
        refitted = self._tick()
        for phase, seconds in (
            ("collide", collided - tick),
            ("lattice", advanced - collided),
            ("refit", refitted - advanced),
        ):
            acts.seconds[phase] += seconds
        state.poses, state.time = after, end

    def _note_touched(
        self, contacts: Contacts, before: list[Pose], after: list[Pose], dt: float, *, certain: bool = True
    ) -> None:
        """When the pairs of these contacts met that had not touched before; the nets are still those of the start. Where
        the tools alone do not meet a body at rest, they met at the end, if they are certain to have met at all."""
        state = self.state
        for body, tool in sorted({(int(a), int(b)) for a, b in zip(contacts.a, contacts.b, strict=True)}):
            if np.isnan(state.touched[body, tool]):
                motion = Motion.between(before[tool], after[tool])
                share = self.lookahead.meeting(state.control_points, motion, body, tool)
                if share is not None or certain:
                    state.touched[body, tool] = state.time + dt * (1.0 if share is None else share)

    def detect(self, poses: list[Pose] | None = None, margin: float = 0.0) -> Detection:
        """Contacts of all models with all tools at these poses (default: where they are), depth >= -margin."""
        model, state = self.model, self.state
        placed = [tool.tool.placed(pose) for tool, pose in zip(model.tools, poses or state.poses, strict=True)]
        options = model.options
        options = DetectOptions(mode=options.mode, tolerance=options.tolerance, delta=options.delta, margin=margin)
        parts, undecided = [], list[Undecided]()
        for body in range(len(model.bodies)):
            index = [i for i, patch in enumerate(model.patches) if patch.body == body]
            found = detect(
                [model.patches[i].grid for i in index],
                [state.control_points[i] for i in index],
                placed,
                options,
                body=body,
                cache=self._caches[body],
            )
            self.counters.add(found.counters)
            for lack in found.undecided:
                pair = body, lack.tool
                self.undecided[pair] = max(self.undecided.get(pair, 0.0), lack.depth)
            undecided += found.undecided
            parts.append((found.contacts.with_faces(np.array(index, dtype=np.int64)), found))
        if len(parts) == 1:
            return Detection(parts[0][0], parts[0][1].counters, undecided=tuple(undecided))
        joined = Contacts.joined([contacts for contacts, _ in parts])
        return Detection(joined, parts[-1][1].counters, undecided=tuple(undecided))

    # ----------------------------------------------------------------- read

    def surface(self, patch: int) -> BSplineSurface:
        """The patch as it is now, over its refined net."""
        return self.model.patches[patch].surface.with_control_points(self.state.control_points[patch])

    def displacement(self, patch: int) -> Array:
        """How far the surface nodes of a patch have moved: (nu, nv, 3)."""
        lattice = self.model.patches[patch].lattice
        nu, nv, nl = lattice.shape
        return (self.state.lattices[patch].x - lattice.nodes).reshape(nu, nv, nl, 3)[:, :, 0]

    def refit_error(self, patch: int) -> RefitError:
        """Distance between the surface nodes that are material and the refit surface."""
        prepared = self.model.patches[patch]
        delta = self.state.control_points[patch] - prepared.surface.control_points
        return prepared.refit.error(self.displacement(patch), delta, prepared.material_nodes)

    # ----------------------------------------------------------- checkpoint

    def arrays(self) -> dict[str, Array]:
        """The whole state as arrays: what `restore` needs to go on as if nothing had happened."""
        state = self.state
        arrays: dict[str, Array] = {
            "time": np.array(state.time),
            "step": np.array(state.step),
            "touched": state.touched,
            "undecided": np.array([(*pair, depth) for pair, depth in sorted(self.undecided.items())]).reshape(-1, 3),
            "pose_at": np.array([pose.at for pose in state.poses]),
            "pose_rotation": np.array([pose.rotation for pose in state.poses]),
            **state.pushes.arrays(),
        }
        for i, (lattice, net) in enumerate(zip(state.lattices, state.control_points, strict=True)):
            arrays[f"net_{i}"] = net
            for name in _LATTICE_STATE:
                arrays[f"lattice_{i}_{name}"] = np.asarray(getattr(lattice, name))
        return arrays

    def restore(self, arrays: Mapping[str, Array]) -> None:
        """Go back to a state that `arrays` gave. Raises InputError when it is not one of this model."""
        try:
            state = State(
                time=float(arrays["time"]),
                step=int(arrays["step"]),
                poses=[Pose(a, r) for a, r in zip(arrays["pose_at"], arrays["pose_rotation"], strict=True)],
                lattices=[
                    replace(
                        LatticeState.at_rest(patch.lattice),
                        **{name: np.array(arrays[f"lattice_{i}_{name}"]) for name in _LATTICE_STATE},
                    )
                    for i, patch in enumerate(self.model.patches)
                ],
                control_points=[np.array(arrays[f"net_{i}"]) for i in range(len(self.model.patches))],
                touched=np.array(arrays["touched"]),
                pushes=PushMemory.of_arrays(arrays),
            )
        except KeyError as error:
            raise InputError(f"the checkpoint lacks {error}", mend="start the run again with --force") from None
        shapes = [net.shape for net in state.control_points], [lattice.x.shape for lattice in state.lattices]
        mine = (
            [p.surface.control_points.shape for p in self.model.patches],
            [p.lattice.nodes.shape for p in self.model.patches],
        )
        if shapes != mine or len(state.poses) != len(self.model.tools):
            raise InputError("the checkpoint belongs to another scene", mend="start the run again with --force")
        self.undecided = {(int(a), int(b)): float(depth) for a, b, depth in arrays.get("undecided", ())}
        self.state = state

    # -------------------------------------------------------------- internals

    def _tick(self) -> float:
        return self.clock() if self.clock is not None else 0.0

    def _advance(self, contacts: Contacts, velocity: Array, dt: float) -> tuple[Array, Array]:
        """Lattices under the contact forces for dt: mean forces (n, 3) on the model and depths (n,) at the end."""
        model, state = self.model, self.state
        forces = np.zeros((len(contacts), 3))
        depths = np.array(contacts.depth)
        # a lattice that fails is left as it was; those before it are put back
        before = [
            (lattice.x.copy(), lattice.velocity.copy(), lattice.rest_length.copy()) for lattice in state.lattices[:-1]
        ]
        for index, patch in enumerate(model.patches):
            mine = np.flatnonzero(contacts.face == index)
            load = None
            if not len(mine) and self._at_rest(index):
                continue  # nothing to integrate, however long the step
            if len(mine):
                nodes, weights = node_weights(patch.lattice, contacts.u[mine], contacts.v[mine])
                load = ContactLoad(
                    nodes=nodes,
                    weights=weights,
                    normal=contacts.normal[mine],
                    depth=contacts.depth[mine],
                    area=contacts.area[mine],
                    velocity=velocity[mine],
                    stiffness=np.full(len(mine), patch.contact_stiffness),
                    damping=np.full(len(mine), patch.contact_damping),
                    friction=np.full(len(mine), patch.material.friction),
                )
            try:
                result = self._integrate(patch.lattice, state.lattices[index], load, dt)
            except SimulationError as error:
                for lattice, kept in zip(state.lattices, before, strict=False):
                    lattice.x, lattice.velocity, lattice.rest_length = kept
                where = f"step {state.step + 1}, face {patch.name!r}"
                raise SimulationError(error.what, where=where, mend=error.mend) from None
            forces[mine], depths[mine] = result.mean_force, result.depth
        return forces, depths

    def _at_rest(self, index: int) -> bool:
        """A lattice as it was built, on which nothing acts: it stays as it is. (A sub-step that the scene forces is not
        left unchecked until something acts.)"""
        lattice, state = self.model.patches[index].lattice, self.state.lattices[index]
        return (
            self.model.scene.solver.substep is None
            and not state.velocity.any()
            and np.array_equal(state.x, lattice.nodes)
            and np.array_equal(state.rest_length, lattice.rest_length)
        )

    def _integrate(self, lattice: Lattice, state: LatticeState, load: ContactLoad | None, dt: float) -> StepForces:
        solver = self.model.scene.solver
        if solver.integrator == "explicit":
            return advance(lattice, state, load, dt, substep=solver.substep)
        return advance_implicit(lattice, state, load, dt, quasi_static=solver.quasi_static, substep=solver.substep)

    def _refuse_unknown(self, poses: Mapping[str, Pose]) -> None:
        names = [tool.name for tool in self.model.tools]
        for name in poses:
            if name not in names:
                raise InputError(f"no tool named {name!r}", mend=f"the scene's tools are {', '.join(names)}")

    def _margin(self, before: list[Pose], after: list[Pose]) -> float:
        """How far any point of a tool can come nearer within the step: contacts to be are watched as well."""
        margin = 0.0
        for tool, a, b in zip(self.model.tools, before, after, strict=True):
            corners = tool.tool.box_corners
            reach = float(np.linalg.norm(corners, axis=1).max())
            if not np.isfinite(reach):
                # of a tool without an end, what is near the model
                middle, half = self.model.ball
                reach = float(max(np.linalg.norm(middle - pose.at) for pose in (a, b))) + half
            turn = float(np.linalg.norm(b.rotation - a.rotation))
            margin = max(margin, float(np.linalg.norm(b.at - a.at)) + reach * turn)
        return margin

    def _refit(self, index: int) -> None:
        """Control points from the moved nodes (paper eq. 3)."""
        patch = self.model.patches[index]
        delta = patch.refit.fit(self.displacement(index), self.model.refit_threshold)
        rest = patch.surface.control_points
        net = np.where(delta == 0.0, rest, rest + delta)
        if not np.array_equal(net, self.state.control_points[index]):
            # read-only: the broad phase takes the same array for the same net
            net.flags.writeable = False
            self.state.control_points[index] = net


def _tool_velocities(contacts: Contacts, before: list[Pose], after: list[Pose], dt: float) -> Array:
    """Mean velocity (n, 3) over the step of the tool's material at each contact."""
    velocity = np.zeros((len(contacts), 3))
    for index, (a, b) in enumerate(zip(before, after, strict=True)):
        mine = contacts.b == index
        velocity[mine] = (b.to_world(a.to_tool(contacts.point[mine])) - contacts.point[mine]) / dt
    return velocity
