"""How contacts on a face press and rub, by the material that lies under them (zones)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .forces import cells_around, contact_damping, contact_stiffness
from .lattice import Lattice
from .material import Material

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_STRAIN = 0.3
"""What material is compressed by at most: beyond, springs turn over. Its pressure is E times this."""

INDENTATION = 3.0
"""Pressure under an indenter over yield stress (Tabor 1951, The hardness of metals)."""


@dataclass(frozen=True, slots=True, eq=False)
class ContactLaw:
    """The contact law of one face.

    lattice : below it. materials : by the index that the lattice's cells have. spacing : of its nodes [L]. penetration : what
    may be left of an overlap [L].
    """

    lattice: Lattice
    materials: tuple[Material, ...]
    spacing: float
    penetration: float = math.inf

    def kinds(self, u: Array, v: Array) -> Index:
        """The index (n,) of the material under each (u, v) (n,)."""
        i, j = cells_around(self.lattice, u, v)
        kinds: Index = self.lattice.cell_material[i, j, 0]
        return kinds


def contact_numbers(a: ContactLaw, i: int, b: ContactLaw | None = None, j: int = 0) -> tuple[float, float, float]:
    """k_n [N/L^3], c_n [N s/L^3] and mu of a contact on material i of a face, with material j of another, or rigid.

    Of two materials the springs stand one behind the other, the masses likewise, and the more slippery one decides. k_n is
    that of `contact_stiffness`, or as much more as leaves no deeper an overlap than `penetration` under the pressure that the
    softer material bears.
    """
    sides = [(a, a.materials[i])] if b is None else [(a, a.materials[i]), (b, b.materials[j])]
    metre = a.lattice.metres_per_unit
    thickness, spacing = min(law.lattice.thickness for law, _ in sides), min(law.spacing for law, _ in sides)
    stiffness = contact_stiffness([material for _, material in sides], thickness, spacing, metre)
    pressure = min(_pressure(material) for _, material in sides) * metre**2
    stiffness = max(stiffness, pressure / min(law.penetration for law, _ in sides))
    dampings = [contact_damping(material, stiffness, law.lattice) for law, material in sides]
    damping = 1.0 / math.sqrt(sum(c**-2 for c in dampings))
    return stiffness, damping, min(material.friction for _, material in sides)


def _pressure(material: Material) -> float:
    """What a contact on this material may come to, in Pa."""
    strain = min(MOST_STRAIN, INDENTATION * material.yield_strain + material.hardening * MOST_STRAIN)
    return material.youngs_modulus * strain
