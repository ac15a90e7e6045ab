"""Slabs of cubes and other boxes for the benchmark of the physics: surface at z = 0, material below it, lengths in mm."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cadsculpt.physics.explicit import ContactLoad
from cadsculpt.physics.forces import contact_damping, contact_stiffness
from cadsculpt.physics.lattice import Lattice, build_lattice
from cadsculpt.physics.material import Material

Array = NDArray[np.float64]

MPA = Material(1.0e6, 1000.0, damping=0.0, name="1 MPa")
"""Young's modulus 1 N/mm^2."""


def slab(x: ArrayLike, y: ArrayLike, layers: int, layer: float, held: str = "", material: Material = MPA) -> Lattice:
    """A slab with nodes at x (nu,) and y (nv,), `layers` of thickness `layer`. held : any of base, sides, start (x[0])."""
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    points = np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros((len(x), len(y)))], axis=-1)
    anchored = np.zeros((len(x), len(y), layers + 1), dtype=np.bool_)
    anchored[:, :, -1] |= "base" in held
    anchored[0] |= "start" in held
    if "sides" in held:
        anchored[[0, -1]] = anchored[:, [0, -1]] = True
    inward = np.broadcast_to([0.0, 0.0, -1.0], points.shape)
    return build_lattice(
        points, inward, x, y, thickness=layers * layer, layers=layers, material=material, anchored=anchored,
        metres_per_unit=1e-3,
    )  # fmt: skip


def contacts(
    lattice: Lattice,
    material: Material,
    nodes: NDArray[np.int64],
    weights: Array,
    *,
    normal: Array,
    depth: Array,
    area: Array | float,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    layer: float = 1.0,
) -> ContactLoad:
    """A load of contacts with the stiffness, damping and friction that the program gives to this material."""
    one = np.ones(len(nodes))
    stiffness = contact_stiffness(material, lattice.thickness, layer, lattice.metres_per_unit)
    return ContactLoad(
        nodes, weights, normal, depth, area * one, np.tile(velocity, (len(nodes), 1)), stiffness * one,
        contact_damping(material, stiffness, lattice) * one, material.friction * one,
    )  # fmt: skip


def edge_shares(count: int) -> Array:
    """Shares (count,) of a uniform load: half at either end."""
    shares = np.ones(count)
    shares[[0, -1]] = 0.5
    return shares / shares.sum()
