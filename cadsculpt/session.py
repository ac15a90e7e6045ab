"""The heart: one `Session` steps a model under moving tools (paper section 4.1, run-time phase).

Each step: collide the bodies where they are, let the contact forces and the lattices act for dt while the tools move,
refit the control points to the moved nodes. Nothing here prints, reads a clock or touches a file.

Lattices live in the world's frame. The net of a deformable tool is kept in the tool's own frame, and fitted there; that of a
body that nothing holds is fitted in the frame of its nearest rigid motion, so that moving as a whole deforms nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .collide.contacts import Contacts
from .collide.detect import Counters, DetectCache, Detection, RigidSurfaceTool, SurfaceTool, Undecided, detect
from .collide.query import FieldTool, PointTool
from .encounters import Pairs
from .errors import InputError, SimulationError
from .force_control import PushMemory, find_poses
from .groups import Group, group_patches
from .lattices import Lattices
from .lookahead import Lookahead
from .model import Model
from .motion.motion import Motion
from .motion.pose import Pose
from .motion.rigid_fit import nearest_pose
from .patch import Patch
from .physics.explicit import LatticeState
from .reaction import Reaction, StepActs
from .spline.refit import RefitError
from .spline.surface import BSplineSurface
from .step_workspace import StepWorkspace
from .tools import surface as tools

Array = NDArray[np.float64]


MOST_PIECES = 10000
"""A step in which tools in contact move so far that it would take more pieces is refused: it is a mistake in the scene."""

TURN = 0.05
"""Radians that a deformable tool turns in one piece of a step: what is held moves along chords, which shortens it meanwhile by
an eighth of the square, 3e-4."""

QUIET = 0.1
"""Share of the stride that bodies may move by themselves where the way ahead of the tools is looked at, which takes their
shapes as they are."""


@dataclass(slots=True, eq=False)
class State:
    """Everything that changes: time [s], tool poses, per group of patches its lattice, and per patch the control points.

    lattices : in the world. control_points : in the world, of a deformable tool in its own frame.
    touched (pairs,) : when each of the model's pairs touched first [s]; NaN where it has not.
    pushes : of tools under force control.
    """

    time: float
    step: int
    poses: list[Pose]
    lattices: list[LatticeState]
    control_points: list[Array]
    touched: Array
    pushes: PushMemory

    def copy(self) -> State:
        """A state of its own with the same values."""
        return replace(
            self,
            poses=list(self.poses),
            lattices=[lattice.copy() for lattice in self.lattices],
            control_points=[net.copy() for net in self.control_points],
            touched=self.touched.copy(),
        )


class Buildable(Protocol):
    """A scene that can read its own files."""

    def build(self) -> Model: ...


@dataclass(slots=True, eq=False)
class Session:
    """A simulation in progress.

    source : a `Model`, or a scene that builds one. After `step`, `contacts` and `forces` (n, 3) [N, on the bodies a] hold
    the contacts that acted during it, `depths` (n,) how deep they are at its end (in the deepest piece of a step that
    continuous collision cuts). `clock`, a timer in seconds, fills `timing` with the seconds that each phase of each step
    took. `undecided` : per pair of bodies, how deep a contact may have been that was not found (see `query.Undecided`); empty
    as a rule.

    A warm step of rigid tools allocates no array (`step_workspace`): contacts, forces, depths, the reactions' arrays and the
    control points of `state` are overwritten by the next steps, so that whoever keeps them copies them.
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
    _pairs: Pairs = field(init=False)
    _lattices: Lattices = field(init=False)
    _caches: list[DetectCache] = field(init=False)
    _others: list[list[int]] = field(init=False)
    _found: Counters = field(init=False)
    _work: StepWorkspace = field(init=False)

    def __post_init__(self) -> None:
        self.model = self.source if isinstance(self.source, Model) else self.source.build()
        model = self.model
        self._pairs, self._lattices = model.pairs, Lattices(model, model.groups)
        self.state = State(
            time=0.0,
            step=0,
            poses=[tool.path.pose(0.0) for tool in model.tools],
            lattices=self._lattices.at_rest(),
            control_points=[patch.surface.control_points.copy() for patch in model.patches],
            touched=np.full(len(model.pairs), np.nan),
            pushes=PushMemory.of(len(model.tools)),
        )
        self.lookahead = Lookahead(model)
        self.contacts, self.forces, self.depths = Contacts.none(), np.zeros((0, 3)), np.zeros(0)
        self.counters, self._found = Counters(), Counters()
        self._work = StepWorkspace(model)
        self._others = [self._pairs.others(body) for body in range(len(model.bodies))]
        self._caches = [DetectCache() for _ in model.bodies]
        self.undecided = {}
        self.timing = {"collide": [], "lattice": [], "refit": []}

    # ------------------------------------------------------------------ step

    def step(self, poses: Mapping[str, Pose] | None = None, dt: float | None = None) -> dict[str, Reaction]:
        """Move the tools to `poses` (by name; those not named follow their paths) within dt seconds.

        Raises SimulationError when the lattice becomes unstable, InputError for a tool that does not exist.
        """
        model, state = self.model, self.state
        dt = model.step if dt is None else dt
        if not 0.0 < dt < math.inf:
            raise InputError(f"a step of {dt} s", mend="a step takes a positive time")
        given, start, before = dict(poses or {}), state.time, state.poses
        self._refuse_unknown(given)
        self._let_roam(given)
        acts = self._work.acts
        acts.start(dt)
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
        # (a copy, for the trials write to the workspace's nets)
        start, undecided, share = self.state.copy(), dict(self.undecided), acts.dt / (end - self.state.time)
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
            own = self._own_way(state.poses, after, end - state.time)
            travel = max(self._margin(state.poses, after) + own, self._turned(state.poses, after))
            if travel <= self.model.stride:
                self._piece(after, end, acts)
                return
            tick = self._tick()
            motions = [Motion.between(a, b) for a, b in zip(state.poses, after, strict=True)]
            stride = self.model.stride / travel
            # inside the material there is no surface to meet: what is in contact is watched
            watched = own > QUIET * self.model.stride or len(self._contacts(state.poses, 0.0)) > 0
            nets = state.control_points
            free = 0.0 if watched else self.lookahead.free(nets, nets, motions)
            acts.seconds["collide"] += self._tick() - tick
            if (
                free > stride
                and not self._turned(state.poses, after)
                and self._free_piece(motions, free, after, end, acts)
            ):
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
        """Collide the bodies where they are, let contact forces and lattices act until the tools are at `after`, refit."""
        state, before, dt = self.state, self.state.poses, end - self.state.time
        tick = self._tick()
        margin = self._margin(before, after) + self._own_way(before, after, dt)
        contacts = self._contacts(before, margin) if watched else Contacts.none()
        collided = self._tick()
        try:
            forces, depths = self._lattices.advance(state.lattices, contacts, before, after, dt, state.step + 1)
        except SimulationError:
            self._note_touched(contacts, before, after, dt, certain=False)
            raise
        advanced = self._tick()
        acting = acts.add(contacts, forces, depths, before, after, dt, self.model.metres_per_unit)
        self._note_touched(acting, before, after, dt)
        self._refit(after)
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
        state, pairs = self.state, self.model.pairs
        if not self._work.untouched(contacts.a, contacts.b, state.touched):
            return
        for pair in np.unique(pairs.places(contacts.a, contacts.b)).tolist():
            if np.isnan(state.touched[pair]):
                motions = [Motion.between(a, b) for a, b in zip(before, after, strict=True)]
                share = self.lookahead.meeting(state.control_points, motions, int(pairs.a[pair]), int(pairs.b[pair]))
                if share is not None or certain:
                    state.touched[pair] = state.time + dt * (1.0 if share is None else share)

    def detect(self, poses: list[Pose] | None = None, margin: float = 0.0) -> Detection:
        """Contacts of all bodies that may meet, with the tools at these poses (default: where they are), depth >= -margin."""
        undecided = list[Undecided]()
        contacts = self._contacts(self.state.poses if poses is None else poses, margin, undecided).copy()
        return Detection(contacts, self._found, undecided=tuple(undecided))

    def _contacts(self, poses: list[Pose], margin: float, undecided: list[Undecided] | None = None) -> Contacts:
        """The contacts of `detect`, in the workspace: they hold until the next detection."""
        model, out = self.model, self._work.contacts
        options = replace(model.options, margin=margin)
        placed: dict[int, FieldTool | PointTool | SurfaceTool | RigidSurfaceTool] = {}
        out.count = 0
        for body, others in enumerate(self._others):
            if not others:
                continue
            for other in others:
                if other not in placed:
                    placed[other] = self._placed(other, poses)
            faces = model.faces_of[body]
            found = detect(
                [model.face(i).grid for i in faces],
                self.nets(body, poses),
                [placed[other] for other in others],
                options,
                body=body,
                cache=self._caches[body],
                faces=faces,
                others=others,
                into=out,
            )
            self._found = found.counters
            self.counters.add(found.counters)
            for lack in found.undecided:
                pair = body, others[lack.tool]
                self.undecided[pair] = max(self.undecided.get(pair, 0.0), lack.depth)
                if undecided is not None:
                    undecided.append(replace(lack, tool=pair[1]))
        return out.view()

    def _placed(self, body: int, poses: list[Pose]) -> FieldTool | PointTool | SurfaceTool | RigidSurfaceTool:
        """As `placed`, in arrays of the workspace, and in its own frame what does not deform."""
        index = self.model.tool_of(body)
        if index is None or self.model.tools[index].patches:
            return self.placed(body, poses)
        tool, pose = self.model.tools[index].tool, self._work.pose(index, poses[index])
        return tool.rigid(pose) if isinstance(tool, tools.SurfaceTool) else tool.placed(pose)

    def nets(self, body: int, poses: list[Pose] | None = None) -> list[Array]:
        """The control points in the world of a body's faces, with the tools at these poses."""
        model, tool = self.model, self.model.tool_of(body)
        count = len(model.patches)
        if tool is not None:
            pose = (self.state.poses if poses is None else poses)[tool]
            return [pose.to_world(self.state.control_points[i]) for i in model.faces_of[body]]
        return [
            self.state.control_points[i] if i < count else model.face(i).grid.surface.control_points
            for i in model.faces_of[body]
        ]

    def placed(self, body: int, poses: list[Pose] | None = None) -> FieldTool | PointTool | SurfaceTool:
        """A body in the world as the other side of contacts, with the tools at these poses."""
        model, index = self.model, self.model.tool_of(body)
        if index is None:
            faces = [model.face(i) for i in model.faces_of[body]]
            reach = max((face.lattice.thickness for face in faces if isinstance(face, Patch)), default=0.0)
            return SurfaceTool(tuple(face.grid for face in faces), tuple(self.nets(body, poses)), reach)
        tool, pose = model.tools[index], (self.state.poses if poses is None else poses)[index]
        if isinstance(tool.tool, tools.SurfaceTool):
            return tool.tool.placed(pose, [self.state.control_points[i] for i in tool.patches] or None)
        return tool.tool.placed(pose)

    # ----------------------------------------------------------------- read

    def surface(self, patch: int) -> BSplineSurface:
        """The patch as it is now, over its refined net; that of a tool in the tool's frame."""
        return self.model.patches[patch].surface.with_control_points(self.state.control_points[patch])

    def lattice(self, patch: int) -> LatticeState:
        """The lattice of a patch as it is now, in the world: views into that of its group."""
        group, state = self._of(patch)
        return group.state_of(state, patch)

    def displacement(self, patch: int) -> Array:
        """How far the surface nodes of a patch have moved, a tool's in the tool's frame: (nu, nv, 3)."""
        body = self.model.patches[patch].body
        return self._moved(patch, self._lattices.frames(self.state.poses).get(body))

    def refit_error(self, patch: int) -> RefitError:
        """Distance between the surface nodes that are material and the refit surface."""
        prepared = self.model.patches[patch]
        frame = self._frames(self.state.poses).get(prepared.body)
        net = self.state.control_points[patch]
        if frame is not None and prepared.body in self.model.free:
            net = frame.to_tool(net)
        return prepared.refit.error(
            self._moved(patch, frame), net - prepared.surface.control_points, prepared.material_nodes
        )

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
        of_patch = self._lattices.of_patches(state.lattices)
        for i, (lattice, net) in enumerate(zip(of_patch, state.control_points, strict=True)):
            arrays[f"net_{i}"] = np.array(net)
            arrays |= {f"lattice_{i}_{name}": values for name, values in lattice.arrays().items()}
        return arrays

    def restore(self, arrays: Mapping[str, Array]) -> None:
        """Go back to a state that `arrays` gave. Raises InputError when it is not one of this model."""
        patches = self.model.patches
        try:
            lattices = [
                LatticeState.of_arrays({name: arrays[f"lattice_{i}_{name}"] for name in lattice.arrays()})
                for i, lattice in enumerate(self._lattices.of_patches(self.state.lattices))
            ]
            nets = [np.array(arrays[f"net_{i}"]) for i in range(len(patches))]
            touched = np.array(arrays["touched"])
            poses = [Pose(a, r) for a, r in zip(arrays["pose_at"], arrays["pose_rotation"], strict=True)]
            time, step, pushes = float(arrays["time"]), int(arrays["step"]), PushMemory.of_arrays(arrays)
        except KeyError as error:
            raise InputError(f"the checkpoint lacks {error}", mend="start the run again with --force") from None
        shapes = [net.shape for net in nets], [lattice.x.shape for lattice in lattices]
        mine = [p.surface.control_points.shape for p in patches], [p.lattice.nodes.shape for p in patches]
        if shapes != mine or len(poses) != len(self.model.tools) or touched.shape != self.state.touched.shape:
            raise InputError("the checkpoint belongs to another scene", mend="start the run again with --force")
        self.undecided = {(int(a), int(b)): float(depth) for a, b, depth in arrays.get("undecided", ())}
        self.state = State(time, step, poses, self._lattices.joined(lattices), nets, touched, pushes)

    # -------------------------------------------------------------- internals

    def _tick(self) -> float:
        return self.clock() if self.clock is not None else 0.0

    def _of(self, patch: int) -> tuple[Group, LatticeState]:
        """The group of a patch, and its state."""
        return next(
            (group, state)
            for group, state in zip(self._lattices.groups, self.state.lattices, strict=True)
            if patch in group.patches
        )

    def _let_roam(self, given: Mapping[str, Pose]) -> None:
        """A deformable tool that a program moves may go anywhere, not only where its path does: what it may meet is integrated
        together with it."""
        for body, tool in enumerate(self.model.tools, start=self.model.models):
            if not tool.patches or tool.name not in given:
                continue
            pairs = self._pairs.roaming(body)
            if (pairs.meet != self._pairs.meet).any():
                self._pairs = pairs
                self._others = [pairs.others(k) for k in range(len(self.model.bodies))]
                groups = group_patches(self.model.patches, pairs)
                self.state.lattices = self._lattices.regrouped(self.state.lattices, groups)

    def _refuse_unknown(self, poses: Mapping[str, Pose]) -> None:
        names = [tool.name for tool in self.model.tools]
        for name in poses:
            if name not in names:
                raise InputError(f"no tool named {name!r}", mend=f"the scene's tools are {', '.join(names)}")

    def _margin(self, before: list[Pose], after: list[Pose]) -> float:
        """How far any point of a tool can come nearer within the step: contacts to be are watched as well."""
        return self._work.travel(before, after)

    def _own_way(self, before: list[Pose], after: list[Pose], dt: float) -> float:
        """How far bodies move by themselves in dt seconds at twice the speed they have now: what pushes them faster within the
        time is not in it."""
        return 2.0 * dt * self._lattices.own_speed(self.state.lattices, before, after, dt)

    def _turned(self, before: list[Pose], after: list[Pose]) -> float:
        """How far that of the deformable tools has to go that turns the most, when TURN is a stride; 0 for less than that."""
        turns = [
            Motion.between(a, b).angle
            for tool, a, b in zip(self.model.tools, before, after, strict=True)
            if tool.patches
        ]
        most = max(turns, default=0.0)
        return most / TURN * self.model.stride if most > TURN else 0.0

    def _moved(self, patch: int, frame: Pose | None) -> Array:
        """The displacements (nu, nv, 3) of the surface nodes of a patch, in a frame where there is one."""
        lattice = self.model.patches[patch].lattice
        nu, nv, nl = lattice.shape
        x, rest = (nodes.reshape(nu, nv, nl, 3)[:, :, 0] for nodes in (self.lattice(patch).x, lattice.nodes))
        return (x if frame is None else frame.to_tool(x)) - rest

    def _frames(self, poses: list[Pose]) -> dict[int, Pose]:
        """The frames of the bodies that have their own: a tool's pose, and the nearest rigid motion of a body that nothing
        holds, once it has moved."""
        frames = self._lattices.frames(poses)
        for body in sorted(self.model.free):
            mine = self.model.faces_of[body]
            rest = np.concatenate([self.model.patches[i].lattice.nodes for i in mine])
            x = np.concatenate([self.lattice(i).x for i in mine])
            if np.abs(x - rest).max() > self.model.refit_threshold:
                mass = np.concatenate([self.model.patches[i].lattice.mass for i in mine])
                frames[body] = nearest_pose(rest, x, mass)
        return frames

    def _refit(self, poses: list[Pose]) -> None:
        """Control points from the moved nodes (paper eq. 3)."""
        frames = self._frames(poses)
        for index, patch in enumerate(self.model.patches):
            frame = frames.get(patch.body)
            if frame is None:
                group, state = self._of(index)
                net = self.state.control_points[index]
                self.state.control_points[index] = self._work.refit(index, state.x[group.nodes_of(index)], net)
                continue
            delta = patch.refit.fit(self._moved(index, frame), self.model.refit_threshold)
            rest = patch.surface.control_points
            net = np.where(delta == 0.0, rest, rest + delta)
            if patch.body in self.model.free:
                net = frame.to_world(net)
            if not np.array_equal(net, self.state.control_points[index]):
                # read-only: the broad phase takes the same array for the same net
                net.flags.writeable = False
                self.state.control_points[index] = net
