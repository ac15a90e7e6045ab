"""What tools feel during a step: forces and torques averaged over it, and the contacts that acted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from .collide.contacts import KEYS, Columns, ContactBuffer, Contacts
from .jit import njit_in_place
from .motion.pose import Pose

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

NO_FORCES: Array = np.zeros((0, 3))
NO_DEPTHS: Array = np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class Reaction:
    """What a tool feels, averaged over the step: force (3,) [N] and torque (3,) [N m] about the origin of its frame.

    The arrays hold until the next step of the session: copy what is to be kept.

    contact_area [L^2], max_depth [L] : of the contacts at the start of the step (of any of its pieces, where continuous
    collision cuts it). max_penetration [L] : at its end.
    """

    force: Array
    torque: Array
    contact_area: float
    max_depth: float
    max_penetration: float


@dataclass(slots=True, eq=False)
class ActsRoom:
    """Where the contacts that act in a step's first piece are put: kept from step to step, and only growing."""

    contacts: ContactBuffer = field(default_factory=ContactBuffer)
    forces: Array = field(default_factory=lambda: np.empty((0, 3)))
    depths: Array = field(default_factory=lambda: np.empty(0))
    acting: Mask = field(default_factory=lambda: np.empty(0, np.bool_))
    middle: Array = field(default_factory=lambda: np.empty((0, 3)))

    def reserve(self, count: int, tools: int) -> None:
        """Room for so many contacts and tools."""
        self.contacts.count = 0
        self.contacts.reserve(count)
        if count > len(self.depths):
            self.forces, self.depths = np.empty((2 * count, 3)), np.empty(2 * count)
            self.acting = np.empty(2 * count, np.bool_)
        if tools != len(self.middle):
            self.middle = np.empty((tools, 3))


@dataclass(slots=True, eq=False)
class StepActs:
    """What acts during one step of dt seconds: the tools' impulses over its pieces, and of each pair of bodies the contacts
    of the piece in which the overlap was deepest. first : the number of the first tool among the bodies.

    `start` begins another step in the same arrays; those of the step before are then overwritten.
    """

    tools: int
    dt: float = 1.0
    first: int = 0
    contacts: Contacts = field(default_factory=Contacts.none)
    forces: Array = field(default_factory=lambda: np.zeros((0, 3)))
    depths: Array = field(default_factory=lambda: np.zeros(0))
    seconds: dict[str, float] = field(default_factory=lambda: {"collide": 0.0, "lattice": 0.0, "refit": 0.0})
    force: Array = field(init=False)
    torque: Array = field(init=False)
    greatest: Array = field(init=False)
    _deepest: dict[tuple[int, int], float] = field(init=False, default_factory=dict)
    _pieces: int = field(init=False, default=0)
    _room: ActsRoom = field(init=False, default_factory=ActsRoom)

    def __post_init__(self) -> None:
        self.force, self.torque, self.greatest = (np.zeros((self.tools, 3)) for _ in range(3))

    def start(self, dt: float) -> None:
        """Nothing has acted yet in a step of dt seconds."""
        self.dt, self._pieces = dt, 0
        self.contacts, self.forces, self.depths = (
            self._room.contacts.view(self._room.contacts.count),
            NO_FORCES,
            NO_DEPTHS,
        )
        self.force[:], self.torque[:], self.greatest[:] = 0.0, 0.0, 0.0
        self.seconds = dict.fromkeys(self.seconds, 0.0)
        self._deepest.clear()

    def copy(self) -> StepActs:
        """The same, to go on from apart."""
        other = replace(self, seconds=dict(self.seconds))
        other.force, other.torque, other.greatest = self.force.copy(), self.torque.copy(), self.greatest.copy()
        other._deepest, other._pieces = dict(self._deepest), self._pieces
        return other

    def add(
        self,
        contacts: Contacts,
        forces: Array,
        depths: Array,
        before: Sequence[Pose],
        after: Sequence[Pose],
        dt: float,
        metre: float,
    ) -> Contacts:
        """A piece of dt seconds: mean forces (n, 3) on the bodies a at its contacts, and depths (n,) at its end. Returns
        the contacts that act: those that press, or are overlapped at the end."""
        room, c = self._room, contacts
        room.reserve(len(c), self.tools)
        for index in range(self.tools):
            np.add(before[index].at, after[index].at, out=room.middle[index])
        count = sum_acts(
            c.a, c.b, self.first, c.point, c.depth, c.area, forces, depths, room.middle, dt / self.dt, metre,
            self.force, self.torque, self.greatest, room.acting,
        )  # fmt: skip
        if self._pieces == 0:
            keep_acting(c.columns, forces, depths, room.acting, room.contacts.columns, room.forces, room.depths)
            room.contacts.count = count
            self.contacts, self.forces, self.depths = room.contacts.view(), room.forces[:count], room.depths[:count]
            self._pieces = 1
            return self.contacts
        if self._pieces == 1:
            self.contacts, self.forces, self.depths = self.contacts.copy(), self.forces.copy(), self.depths.copy()
            self._deepest = {pair: deepest for pair, deepest, _ in _pairs(self.contacts, self.depths)}
        self._pieces += 1
        acting = room.acting[: len(c)].copy()
        fresh = contacts.chosen(acting)
        self._keep(fresh, forces[acting], depths[acting])
        return fresh

    def _keep(self, contacts: Contacts, forces: Array, depths: Array) -> None:
        """Of each pair of bodies, the piece in which the overlap was deepest."""
        fresh, kept = np.zeros(len(contacts), np.bool_), np.ones(len(self.contacts), np.bool_)
        for pair, deepest, mine in _pairs(contacts, depths):
            if deepest >= self._deepest.get(pair, -np.inf):
                self._deepest[pair] = deepest
                fresh |= mine
                kept &= ~((self.contacts.a == pair[0]) & (self.contacts.b == pair[1]))
        if not kept.any():
            self.contacts, self.forces, self.depths = contacts.chosen(fresh), forces[fresh], depths[fresh]
            return
        both = Contacts.joined([self.contacts.chosen(kept), contacts.chosen(fresh)])
        order = [np.concatenate([getattr(self.contacts, key)[kept], getattr(contacts, key)[fresh]]) for key in KEYS]
        place = np.lexsort(order)
        self.forces = np.concatenate([self.forces[kept], forces[fresh]])[place]
        self.depths = np.concatenate([self.depths[kept], depths[fresh]])[place]
        self.contacts = both

    def reaction(self, index: int) -> Reaction:
        return Reaction(self.force[index], self.torque[index], *(float(x) for x in self.greatest[index]))


def _pairs(contacts: Contacts, depths: Array) -> Iterator[tuple[tuple[int, int], float, Mask]]:
    """Each pair of a body and a tool: its deepest overlap at the start or the end, and which contacts are its."""
    for pair in {(int(a), int(b)) for a, b in zip(contacts.a, contacts.b, strict=True)}:
        mine = (contacts.a == pair[0]) & (contacts.b == pair[1])
        yield pair, float(np.maximum(contacts.depth, depths)[mine].max()), mine


@njit_in_place
def sum_acts(
    a: Index, b: Index, first: int, point: Array, depth: Array, area: Array, forces: Array, depths: Array, middle: Array,
    share: float, metre: float, force: Array, torque: Array, greatest: Array, acting: Mask,
) -> int:  # fmt: skip
    """Add a piece's forces and torques (tools, 3) on the tools, which last this share of the step, and raise `greatest`
    (tools, 3): area, depth, depth at the end. middle (tools, 3) : twice the place about which the torque is.

    acting (n,) : which contacts act; returns how many they are.
    """
    for tool in range(len(force)):
        greatest[tool, 2] = 0.0
        touched, deepest = 0.0, 0.0
        fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for c in range(len(b)):
            if b[c] == first + tool:
                sign = -1.0
            elif a[c] == first + tool and first > 0:
                sign = 1.0
            else:
                continue
            px, py, pz = sign * forces[c, 0], sign * forces[c, 1], sign * forces[c, 2]
            x, y, z = (
                point[c, 0] - 0.5 * middle[tool, 0], point[c, 1] - 0.5 * middle[tool, 1], point[c, 2] - 0.5 * middle[tool, 2],
            )  # fmt: skip
            fx, fy, fz = fx + px, fy + py, fz + pz
            tx, ty, tz = tx + (y * pz - z * py), ty + (z * px - x * pz), tz + (x * py - y * px)
            if depth[c] > 0.0:
                touched += area[c]
                deepest = max(deepest, depth[c])
            greatest[tool, 2] = max(greatest[tool, 2], depths[c])
        greatest[tool, 0], greatest[tool, 1] = max(greatest[tool, 0], touched), max(greatest[tool, 1], deepest)
        force[tool, 0] += fx * share
        force[tool, 1] += fy * share
        force[tool, 2] += fz * share
        torque[tool, 0] += tx * metre * share
        torque[tool, 1] += ty * metre * share
        torque[tool, 2] += tz * metre * share
    count = 0
    for c in range(len(b)):
        acting[c] = depths[c] > 0.0 or forces[c, 0] != 0.0 or forces[c, 1] != 0.0 or forces[c, 2] != 0.0
        count += acting[c]
    return count


@njit_in_place
def keep_acting(
    rows: Columns, forces: Array, depths: Array, acting: Mask, out: Columns, out_forces: Array, out_depths: Array
) -> None:
    """The rows that act, in their order, into `out`."""
    a, b, face, u, v, point, normal, depth, area, tool_point, tool_face, tool_u, tool_v = rows
    to_a, to_b, to_face, to_u, to_v, to_point, to_normal, to_depth, to_area, to_tool, to_patch, to_tool_u, to_tool_v = (
        out
    )
    to = 0
    for c in range(len(a)):
        if not acting[c]:
            continue
        to_a[to], to_b[to], to_face[to], to_u[to], to_v[to] = a[c], b[c], face[c], u[c], v[c]
        to_depth[to], to_area[to], out_depths[to] = depth[c], area[c], depths[c]
        to_patch[to], to_tool_u[to], to_tool_v[to] = tool_face[c], tool_u[c], tool_v[c]
        for x in range(3):
            to_point[to, x], to_normal[to, x] = point[c, x], normal[c, x]
            to_tool[to, x], out_forces[to, x] = tool_point[c, x], forces[c, x]
        to += 1
