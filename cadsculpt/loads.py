"""Contacts as loads on the lattices of a group: which nodes carry them on both sides, and how stiff they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .collide.contacts import Contacts
from .groups import Group
from .patch import Patch
from .physics.contact_law import contact_numbers
from .physics.explicit import ContactLoad
from .physics.forces import node_weights

Array = NDArray[np.float64]
Index = NDArray[np.int64]

RIGID = -1
"""Stands for the patch of a side that has no lattice."""


@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """What the two sides of n contacts are: the patches (n,) of a and b, RIGID where a side has no lattice.

    A contact acts on the nodes of `main`, a's patch, or b's where a is rigid; `sign` (n,) is then -1: the load is that on b.
    """

    a: Index
    b: Index

    @property
    def main(self) -> Index:
        return np.where(self.a == RIGID, self.b, self.a)

    @property
    def sign(self) -> Array:
        return np.where(self.a == RIGID, -1.0, 1.0)


@dataclass(slots=True, eq=False)
class LoadMaker:
    """Makes loads for the patches of a model, in metres_per_unit m; keeps the numbers of pairs of materials."""

    patches: Sequence[Patch]
    metres_per_unit: float
    _numbers: dict[tuple[int, int, int, int], tuple[float, float, float]] = field(default_factory=dict)

    def numbers(self, main: Index, kinds: Index, other: Index, others: Index) -> Array:
        """k_n [N/L^3], c_n [N s/L^3] and the coefficient of friction (n, 3) of contacts on materials `kinds` of the patches
        `main`, with materials `others` of the patches `other`, which may be RIGID."""
        keys, place = np.unique(np.stack([main, kinds, other, others], axis=1), axis=0, return_inverse=True)
        rows = np.empty((len(keys), 3))
        for row, (a, i, b, j) in zip(rows, keys.tolist(), strict=True):
            key = a, i, b, j
            if key not in self._numbers:
                second = None if b == RIGID else self.patches[b].law
                self._numbers[key] = contact_numbers(self.patches[a].law, i, second, j)
            row[:] = self._numbers[key]
        return rows[place.reshape(-1)]

    def load(self, group: Group, contacts: Contacts, sides: Sides, velocity: Array) -> ContactLoad:
        """The contacts (n), all of them with `main` in the group, as a load on its lattice. velocity (n, 3) : of the side that
        has no lattice [L/s], 0 where both have one."""
        count = len(contacts)
        main, sign = sides.main, sides.sign
        swapped = sides.a == RIGID
        nodes, weights = np.zeros((count, 4), np.int64), np.zeros((count, 4))
        kinds, others = np.zeros(count, np.int64), np.zeros(count, np.int64)
        u, v = np.where(swapped, contacts.tool_u, contacts.u), np.where(swapped, contacts.tool_v, contacts.v)
        self._carriers(group, main, u, v, nodes, weights, kinds)
        other = np.where(swapped, RIGID, sides.b)
        other_nodes = other_weights = None
        if (other != RIGID).any():
            other_nodes, other_weights = np.zeros((count, 4), np.int64), np.zeros((count, 4))
            self._carriers(group, other, contacts.tool_u, contacts.tool_v, other_nodes, other_weights, others)
        numbers = self.numbers(main, kinds, other, others)
        return ContactLoad(
            nodes=nodes,
            weights=weights,
            normal=sign[:, None] * contacts.normal,
            depth=contacts.depth,
            area=contacts.area,
            velocity=velocity,
            stiffness=np.ascontiguousarray(numbers[:, 0]),
            damping=np.ascontiguousarray(numbers[:, 1]),
            friction=np.ascontiguousarray(numbers[:, 2]),
            other_nodes=other_nodes,
            other_weights=other_weights,
        )

    def _carriers(
        self, group: Group, patch: Index, u: Array, v: Array, nodes: Index, weights: Array, kinds: Index
    ) -> None:
        """Fill in the nodes (n, 4) of the group, their weights around (u, v) of the patches (n,), and what material it is."""
        for k in np.unique(patch).tolist():
            if k == RIGID:
                continue
            mine = np.flatnonzero(patch == k)
            found, share = node_weights(self.patches[k].lattice, u[mine], v[mine])
            nodes[mine], weights[mine] = found + group.nodes_of(k).start, share
            kinds[mine] = self.patches[k].law.kinds(u[mine], v[mine])
