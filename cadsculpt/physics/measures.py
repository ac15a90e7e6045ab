"""What a lattice's state means: energy, strain, plastic set and stress, for checks and pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit_in_place
from .explicit import LatticeState
from .lattice import Lattice
from .springs import spring_energy

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def elastic_energy(lattice: Lattice, state: LatticeState) -> float:
    """Energy stored in the springs [N L]."""
    return float(spring_energy(lattice.segments, lattice.stiffness, state.x, state.rest_length))


def kinetic_energy(lattice: Lattice, state: LatticeState) -> float:
    """Energy of motion [N L]."""
    return 0.5 * float(lattice.mass @ np.einsum("nc,nc->n", state.velocity, state.velocity))


def nodal_strain(lattice: Lattice, state: LatticeState) -> Array:
    """(N,) the largest |strain| against the shape at rest of any spring at the node."""
    return _measures(lattice, state)[0]


def nodal_plastic_set(lattice: Lattice, state: LatticeState) -> Array:
    """(N,) the largest |plastic strain| of any spring at the node."""
    return _measures(lattice, state)[1]


def nodal_stress(lattice: Lattice, state: LatticeState) -> Array:
    """(N,) von Mises stress [Pa] of the virial stress at the node, sigma = sum_s f_s L_s n n / (2 V), V the node's
    volume.
    """
    s = _measures(lattice, state)[2]
    shear = s[3] ** 2 + s[4] ** 2 + s[5] ** 2
    square = 0.5 * ((s[0] - s[1]) ** 2 + (s[1] - s[2]) ** 2 + (s[2] - s[0]) ** 2) + 3.0 * shear
    result: Array = np.sqrt(square) / lattice.metres_per_unit**2
    return result


def _measures(lattice: Lattice, state: LatticeState) -> tuple[Array, Array, Array]:
    """Strain (N,), plastic set (N,) and virial stress (6, N) [N/L^2]: xx, yy, zz, xy, yz, zx."""
    count = len(lattice.nodes)
    strain, plastic, stress = np.zeros(count), np.zeros(count), np.zeros((6, count))
    _gather(
        lattice.segments,
        lattice.stiffness,
        lattice.rest_length,
        state.rest_length,
        state.x,
        strain,
        plastic,
        stress,
    )
    stress[:, lattice.active] /= 2.0 * lattice.volume[lattice.active]
    return strain, plastic, stress


@njit_in_place
def _gather(
    segments: Index,
    stiffness: Array,
    initial_length: Array,
    rest_length: Array,
    x: Array,
    strain: Array,
    plastic: Array,
    stress: Array,
) -> None:
    for row in range(len(segments)):
        d, start, stop, shift = segments[row]
        for a in range(start, stop):
            initial = initial_length[d, a]
            if stiffness[d, a] == 0.0 or initial == 0.0:
                continue
            b = a + shift
            dx, dy, dz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
            length = (dx * dx + dy * dy + dz * dz) ** 0.5
            if length == 0.0:
                continue
            q = stiffness[d, a] * (length - rest_length[d, a]) / length
            stretched, flowed = abs(length / initial - 1.0), abs(rest_length[d, a] / initial - 1.0)
            for end in (a, b):
                strain[end] = max(strain[end], stretched)
                plastic[end] = max(plastic[end], flowed)
                stress[0, end] += q * dx * dx
                stress[1, end] += q * dy * dy
                stress[2, end] += q * dz * dz
                stress[3, end] += q * dx * dy
                stress[4, end] += q * dy * dz
                stress[5, end] += q * dz * dx
