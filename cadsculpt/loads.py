"""Contacts as loads on the lattices of a group: which nodes carry them on both sides, and how stiff they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .collide.contacts import Contacts
from .groups import Group
from .patch import Patch
from .physics.explicit import ContactLoad
from .physics.forces import contact_stiffness, node_weights

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
    """Makes loads for the patches of a model, in metres_per_unit m; keeps the numbers of pairs of patches."""

    patches: Sequence[Patch]
    metres_per_unit: float
    _pairs: dict[tuple[int, int], tuple[float, float, float]] = field(default_factory=dict)

    def numbers(self, first: int, second: int) -> tuple[float, float, float]:
        """k_n [N/L^3], c_n [N s/L^3] and the coefficient of friction between two patches, the second of which may be RIGID.

        Of two materials the springs stand one behind the other, the masses likewise, and the more slippery one decides.
        """
        key = first, second
        if key not in self._pairs:
            self._pairs[key] = self._numbers(first, second)
        return self._pairs[key]

    def _numbers(self, first: int, second: int) -> tuple[float, float, float]:
        a = self.patches[first]
        if second == RIGID:
            return a.contact_stiffness, a.contact_damping, a.material.friction
        b = self.patches[second]
        # (k_n of a patch alone belongs to the smaller of its spacing and thickness)
        reach = min(a.contact_reach, b.contact_reach)
        stiffness = contact_stiffness([a.material, b.material], reach, reach, self.metres_per_unit)
        # c^2 / k is what it damps: the masses of half a cell, that of both moving against each other
        masses = [p.contact_damping**2 / p.contact_stiffness for p in (a, b)]
        damping = float(np.sqrt(stiffness / sum(1.0 / mass for mass in masses))) if min(masses) > 0.0 else 0.0
        return stiffness, damping, min(a.material.friction, b.material.friction)

    def load(self, group: Group, contacts: Contacts, sides: Sides, velocity: Array) -> ContactLoad:
        """The contacts (n), all of them with `main` in the group, as a load on its lattice. velocity (n, 3) : of the side that
        has no lattice [L/s], 0 where both have one."""
        count = len(contacts)
        main, sign = sides.main, sides.sign
        swapped = sides.a == RIGID
        nodes, weights = np.zeros((count, 4), np.int64), np.zeros((count, 4))
        u, v = np.where(swapped, contacts.tool_u, contacts.u), np.where(swapped, contacts.tool_v, contacts.v)
        self._carriers(group, main, u, v, nodes, weights)
        other = np.where(swapped, RIGID, sides.b)
        other_nodes = other_weights = None
        if (other != RIGID).any():
            other_nodes, other_weights = np.zeros((count, 4), np.int64), np.zeros((count, 4))
            self._carriers(group, other, contacts.tool_u, contacts.tool_v, other_nodes, other_weights)
        numbers = np.array([self.numbers(a, b) for a, b in zip(main.tolist(), other.tolist(), strict=True)]).reshape(
            -1, 3
        )
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

    def _carriers(self, group: Group, patch: Index, u: Array, v: Array, nodes: Index, weights: Array) -> None:
        """Fill in the nodes (n, 4) of the group and their weights around (u, v) of the patches (n,)."""
        for k in np.unique(patch).tolist():
            if k == RIGID:
                continue
            mine = np.flatnonzero(patch == k)
            found, share = node_weights(self.patches[k].lattice, u[mine], v[mine])
            nodes[mine], weights[mine] = found + group.nodes_of(k).start, share
