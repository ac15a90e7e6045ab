"""What tools feel during a step: forces and torques averaged over it, and the contacts that acted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from .collide.contacts import KEYS, Contacts
from .motion.pose import Pose

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Reaction:
    """What a tool feels, averaged over the step: force (3,) [N] and torque (3,) [N m] about the origin of its frame.

    contact_area [L^2], max_depth [L] : of the contacts at the start of the step (of any of its pieces, where continuous
    collision cuts it). max_penetration [L] : at its end.
    """

    force: Array
    torque: Array
    contact_area: float
    max_depth: float
    max_penetration: float


@dataclass(slots=True, eq=False)
class StepActs:
    """What acts during one step of dt seconds: the tools' impulses over its pieces, and of each pair of bodies the contacts
    of the piece in which the overlap was deepest. first : the number of the first tool among the bodies."""

    tools: int
    dt: float
    first: int = 0
    contacts: Contacts = field(default_factory=Contacts.none)
    forces: Array = field(default_factory=lambda: np.zeros((0, 3)))
    depths: Array = field(default_factory=lambda: np.zeros(0))
    seconds: dict[str, float] = field(default_factory=lambda: {"collide": 0.0, "lattice": 0.0, "refit": 0.0})
    force: Array = field(init=False)
    torque: Array = field(init=False)
    greatest: Array = field(init=False)
    _deepest: dict[tuple[int, int], float] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.force, self.torque, self.greatest = (np.zeros((self.tools, 3)) for _ in range(3))

    def copy(self) -> StepActs:
        """The same, to go on from apart."""
        other = replace(self, seconds=dict(self.seconds))
        other.force, other.torque, other.greatest = self.force.copy(), self.torque.copy(), self.greatest.copy()
        other._deepest = dict(self._deepest)
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
    ) -> Mask:
        """A piece of dt seconds: mean forces (n, 3) on the bodies a at its contacts, and depths (n,) at its end. Returns which
        contacts act: those that press, or are overlapped at the end."""
        self.greatest[:, 2] = 0.0
        for index in range(self.tools):
            mine = contacts.b == self.first + index
            self._push(index, contacts.point[mine], -forces[mine], before[index], after[index], dt, metre)
            if len(own := np.flatnonzero(contacts.a == self.first + index)) and self.first:
                self._push(index, contacts.point[own], forces[own], before[index], after[index], dt, metre)
                mine[own] = True
            touching = mine & (contacts.depth > 0)
            area, depth = float(contacts.area[touching].sum()), float(contacts.depth[touching].max(initial=0.0))
            self.greatest[index, :2] = np.maximum(self.greatest[index, :2], (area, depth))
            self.greatest[index, 2] = depths[mine].max(initial=0.0)
        acting = (depths > 0) | (forces != 0).any(axis=1)
        self._keep(contacts.chosen(acting), forces[acting], depths[acting])
        return acting

    def _push(self, tool: int, point: Array, force: Array, before: Pose, after: Pose, dt: float, metre: float) -> None:
        """Forces (n, 3) on a tool at points (n, 3), for dt seconds."""
        arm = point - 0.5 * (before.at + after.at)
        self.force[tool] += force.sum(axis=0) * (dt / self.dt)
        self.torque[tool] += np.cross(arm, force).sum(axis=0) * metre * (dt / self.dt)

    def _keep(self, contacts: Contacts, forces: Array, depths: Array) -> None:
        """Of each pair of bodies, the piece in which the overlap was deepest."""
        fresh, kept = np.zeros(len(contacts), np.bool_), np.ones(len(self.contacts), np.bool_)
        for pair in {(int(a), int(b)) for a, b in zip(contacts.a, contacts.b, strict=True)}:
            mine = (contacts.a == pair[0]) & (contacts.b == pair[1])
            deepest = float(np.maximum(contacts.depth, depths)[mine].max())
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
