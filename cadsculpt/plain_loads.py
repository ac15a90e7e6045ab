"""Contacts of rigid tools on bodies with lattices, the plain case of `loads`, in room that is kept from step to step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .collide.contacts import Contacts
from .groups import Group
from .jit import njit_in_place
from .model import Model
from .motion.pose import Pose
from .physics.contact_law import contact_numbers
from .physics.explicit import ContactLoad, LatticeState
from .physics.forces import fill_cells, fill_node_weights

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(slots=True, eq=False)
class LoadRoom:
    """Room for contacts that load one lattice: the fields of `ContactLoad`, and which contacts of all they are (mine)."""

    mine: Index
    nodes: Index
    weights: Array
    u: Array
    v: Array
    i: Index
    j: Index
    normal: Array
    depth: Array
    area: Array
    velocity: Array
    stiffness: Array
    damping: Array
    friction: Array

    @classmethod
    def of(cls, n: int) -> LoadRoom:
        mine, i, j = (np.empty(n, np.int64) for _ in range(3))
        u, v, depth, area, stiffness, damping, friction = (np.empty(n) for _ in range(7))
        normal, velocity = np.empty((n, 3)), np.empty((n, 3))
        nodes, weights = np.empty((n, 4), np.int64), np.empty((n, 4))
        return cls(mine, nodes, weights, u, v, i, j, normal, depth, area, velocity, stiffness, damping, friction)


@dataclass(slots=True, eq=False)
class PlainLoads:
    """Makes loads where all that meets a lattice is rigid.

    numbers : per patch k_n, c_n and friction (kinds, 3) by the material under the contact. forces (n, 3), depths (n,) : room
    for what comes of the contacts.
    """

    model: Model
    numbers: list[Array] = field(init=False)
    velocity: Array = field(default_factory=lambda: np.empty((0, 3)))
    forces: Array = field(default_factory=lambda: np.empty((0, 3)))
    depths: Array = field(default_factory=lambda: np.empty(0))
    room: LoadRoom = field(default_factory=lambda: LoadRoom.of(0))
    kept: list[LatticeState] = field(default_factory=list)
    rest: dict[tuple[int, ...], Array] = field(default_factory=dict)
    _rigid: NDArray[np.bool_] = field(init=False)
    _at: Array = field(init=False)
    _turn: Array = field(init=False)

    def __post_init__(self) -> None:
        model, tools = self.model, len(self.model.tools)
        self.numbers = [
            np.array([contact_numbers(patch.law, kind) for kind in range(len(patch.law.materials))]).reshape(-1, 3)
            for patch in model.patches
        ]
        deformable = {patch.body for patch in model.patches}
        self._rigid = np.array([k not in deformable for k in range(len(model.bodies))], dtype=np.bool_)
        self._at, self._turn = np.empty((2, tools, 3)), np.empty((2, tools, 3, 3))

    def all_plain(self, contacts: Contacts) -> bool:
        """Every contact is of something rigid on a patch that has a lattice, and no tool has one."""
        if any(tool.patches for tool in self.model.tools):
            return False
        return bool(all_rigid(contacts.face, contacts.b, len(self.model.patches), self._rigid))

    def begin(
        self, contacts: Contacts, before: Sequence[Pose], after: Sequence[Pose], dt: float
    ) -> tuple[Array, Array, Array]:
        """Room for what comes of contacts while tools move for dt seconds: forces (n, 3), zero, depths (n,), as they are now,
        and the mean velocity (n, 3) of the tools' material at each."""
        count = len(contacts)
        if count > len(self.depths):
            self.velocity, self.forces, self.depths = (
                np.empty((2 * count, 3)),
                np.empty((2 * count, 3)),
                np.empty(2 * count),
            )
            self.room = LoadRoom.of(2 * count)
        forces, depths, velocity = self.forces[:count], self.depths[:count], self.velocity[:count]
        forces[...], depths[...] = 0.0, contacts.depth
        for k, poses in enumerate((before, after)):
            for tool, pose in enumerate(poses):
                self._at[k, tool], self._turn[k, tool] = pose.at, pose.rotation
        carried(contacts.b, self.model.models, contacts.point, self._at, self._turn, dt, velocity)
        return forces, depths, velocity

    def load(self, group: Group, contacts: Contacts, velocity: Array) -> tuple[Index, ContactLoad | None]:
        """The contacts on a group, as places among all, and as a load of its lattice: None where there are none."""
        room, c, found = self.room, contacts, 0
        for k in group.patches:
            start = found
            found = gather(
                c.face, c.u, c.v, c.normal, c.depth, c.area, velocity, k, start, room.mine, room.u, room.v, room.normal,
                room.depth, room.area, room.velocity,
            )  # fmt: skip
            if found > start:
                lattice, own = self.model.patches[k].lattice, slice(start, found)
                nodes, u, v, i, j = room.nodes[own], room.u[own], room.v[own], room.i[own], room.j[own]
                fill_node_weights(lattice, u, v, nodes, room.weights[own])
                nodes += group.nodes_of(k).start
                fill_cells(lattice.u, lattice.v, lattice.period, u, v, i, j)
                by_material(
                    self.numbers[k],
                    lattice.cell_material,
                    i,
                    j,
                    room.stiffness[own],
                    room.damping[own],
                    room.friction[own],
                )
        load = ContactLoad(
            nodes=room.nodes[:found],
            weights=room.weights[:found],
            normal=room.normal[:found],
            depth=room.depth[:found],
            area=room.area[:found],
            velocity=room.velocity[:found],
            stiffness=room.stiffness[:found],
            damping=room.damping[:found],
            friction=room.friction[:found],
        )
        return room.mine[:found], load if found else None

    def keep(self, states: Sequence[LatticeState]) -> None:
        """Remember these as they are, for `put_back`."""
        if len(self.kept) != len(states):
            self.kept = [state.copy() for state in states]
        for kept, state in zip(self.kept, states, strict=True):
            _overwrite(kept, state)

    def put_back(self, states: Sequence[LatticeState]) -> None:
        """Make the states what they were."""
        for kept, state in zip(self.kept, states, strict=True):
            _overwrite(state, kept)

    def rests(self, group: Group, state: LatticeState) -> bool:
        """A group as it was built."""
        rest = self.rest.get(group.patches)
        if rest is None:
            rest = self.rest[group.patches] = np.concatenate(
                [self.model.patches[i].lattice.nodes for i in group.patches]
            )
        return bool(at_rest(state.x, rest, state.velocity, state.rest_length, group.lattice.rest_length))


def _overwrite(target: LatticeState, source: LatticeState) -> None:
    target.x[...], target.velocity[...], target.rest_length[...] = source.x, source.velocity, source.rest_length
    target.bound.square = source.bound.square
    target.bound.scale[...], target.bound.seen[...] = source.bound.scale, source.bound.seen


@njit_in_place
def all_rigid(face: Index, b: Index, patches: int, rigid: NDArray[np.bool_]) -> bool:
    """Every face is one of the first `patches`, and every b rigid."""
    plain = True
    for c in range(len(face)):
        plain = plain and face[c] < patches and rigid[b[c]]
    return plain


@njit_in_place
def at_rest(x: Array, nodes: Array, velocity: Array, rest_length: Array, initial_length: Array) -> bool:
    """Nodes where they were, without velocity, and springs of their initial lengths."""
    for n in range(len(x)):
        for c in range(3):
            if x[n, c] != nodes[n, c] or velocity[n, c] != 0.0:
                return False
    for d in range(len(rest_length)):
        for n in range(rest_length.shape[1]):
            if rest_length[d, n] != initial_length[d, n]:
                return False
    return True


@njit_in_place
def carried(b: Index, first: int, point: Array, at: Array, turn: Array, dt: float, velocity: Array) -> None:
    """Mean velocity (n, 3) of points (n, 3) that each move with the tool b - first (n,), from the poses at[0] (tools, 3),
    turn[0] (tools, 3, 3) to at[1], turn[1]; 0 where that is none."""
    for c in range(len(b)):
        tool = b[c] - first
        if tool < 0:
            velocity[c, 0], velocity[c, 1], velocity[c, 2] = 0.0, 0.0, 0.0
            continue
        px, py, pz = point[c, 0] - at[0, tool, 0], point[c, 1] - at[0, tool, 1], point[c, 2] - at[0, tool, 2]
        x = px * turn[0, tool, 0, 0] + py * turn[0, tool, 1, 0] + pz * turn[0, tool, 2, 0]
        y = px * turn[0, tool, 0, 1] + py * turn[0, tool, 1, 1] + pz * turn[0, tool, 2, 1]
        z = px * turn[0, tool, 0, 2] + py * turn[0, tool, 1, 2] + pz * turn[0, tool, 2, 2]
        for i in range(3):
            end = x * turn[1, tool, i, 0] + y * turn[1, tool, i, 1] + z * turn[1, tool, i, 2] + at[1, tool, i]
            velocity[c, i] = (end - point[c, i]) / dt


@njit_in_place
def gather(
    face: Index, u: Array, v: Array, normal: Array, depth: Array, area: Array, velocity: Array, wanted: int, count: int,
    mine: Index, out_u: Array, out_v: Array, out_normal: Array, out_depth: Array, out_area: Array, out_velocity: Array,
) -> int:  # fmt: skip
    """The contacts on the face `wanted` behind `count` others: their places into `mine`, and what a load takes of them; how
    many they are then."""
    for c in range(len(face)):
        if face[c] != wanted:
            continue
        mine[count] = c
        out_u[count], out_v[count], out_depth[count], out_area[count] = u[c], v[c], depth[c], area[c]
        for x in range(3):
            out_normal[count, x], out_velocity[count, x] = normal[c, x], velocity[c, x]
        count += 1
    return count


@njit_in_place
def by_material(
    numbers: Array, material: Index, i: Index, j: Index, stiffness: Array, damping: Array, friction: Array
) -> None:
    """The numbers (kinds, 3) of the materials (cu, cv, layers) under the cells (i, j) (n,)."""
    for c in range(len(i)):
        kind = material[i[c], j[c], 0]
        stiffness[c], damping[c], friction[c] = numbers[kind, 0], numbers[kind, 1], numbers[kind, 2]


@njit_in_place
def scatter(mine: Index, force: Array, depth: Array, forces: Array, depths: Array) -> None:
    """What came of the contacts `mine`, to their places among all."""
    for t in range(len(mine)):
        depths[mine[t]] = depth[t]
        for x in range(3):
            forces[mine[t], x] = force[t, x]
