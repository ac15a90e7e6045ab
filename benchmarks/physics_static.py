"""Static truths: a bar in tension, a clamped plate, Hertz's sphere, a bar's plastic set; by the quasi-static integrator."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from physics_lattices import MPA, contacts, edge_shares, slab

from cadsculpt.physics.explicit import LatticeState
from cadsculpt.physics.forces import node_weights
from cadsculpt.physics.implicit import advance_implicit


def bar_strain(state: LatticeState, shape: tuple[int, int, int], step: float) -> float:
    """Strain along x of the middle of a bar, away from its ends by its width."""
    x = state.x.reshape(*shape, 3)[..., 0].mean(axis=(1, 2))
    away = shape[1]
    return float((x[-1 - away] - x[away]) / ((shape[0] - 1 - 2 * away) * step) - 1.0)


def pull(shape: tuple[int, int, int], force: float) -> np.ndarray:
    """Nodal forces (N, 3) that pull the end of a bar evenly along x."""
    nodal = np.zeros((*shape, 3))
    nodal[-1, :, :, 0] = force * edge_shares(shape[1])[:, None] * edge_shares(shape[2])
    return nodal.reshape(-1, 3)


def bar_modulus(steps: tuple[float, float, float], cells: int = 4, length: int = 20, stress: float = 1e-4) -> float:
    """Young's modulus of a bar, over that of its material: one step, held at one end, pulled at the other."""
    lattice = slab(np.arange(length + 1) * steps[0], np.arange(cells + 1) * steps[1], cells, steps[2], "start")
    state = LatticeState.at_rest(lattice)
    section = cells * steps[1] * cells * steps[2]
    advance_implicit(lattice, state, None, 1.0, quasi_static=True, external=pull(lattice.shape, stress * section))
    return stress / bar_strain(state, lattice.shape, steps[0])


def bar_truth(cells: int = 4, length: int = 20) -> dict[str, object]:
    """Young's modulus: bar_error of cubes, bar_error_aspect3 the worst of all cells of 1:3."""
    flat = [(3.0, 1.0, 1.0), (1.0, 3.0, 1.0), (1.0, 1.0, 3.0), (3.0, 3.0, 1.0), (3.0, 1.0, 3.0), (1.0, 3.0, 3.0)]
    return {
        "bar_error": abs(bar_modulus((1.0, 1.0, 1.0), cells, length) - 1.0),
        "bar_error_aspect3": max(abs(bar_modulus(steps, cells, length) - 1.0) for steps in flat),
    }


def shear_deflection(width: float, spread: float, modes: int = 2000) -> float:
    """Deflection by shear alone, in P / E, of the middle of a square plate of thickness 1 under a load in its middle.

    kappa G laplace w = -load, as a sine series; kappa = 5/6, G = 0.4 E. The load is the hat of half width `spread`, which is
    how a node's load acts on the cells around it (on a point the deflection is infinite).
    """
    k = math.pi / width * np.arange(1, 2 * modes, 2)
    hat = np.sinc(k * spread / (2.0 * math.pi)) ** 2
    series = (hat[:, None] * hat / (k[:, None] ** 2 + k**2)).sum()
    return float(4.0 / width**2 * series / (5.0 / 6.0 * 0.4))


def plate_deflection(layers: int, width: float = 30.0, load: float = 1e-6) -> float:
    """Deflection of a clamped square plate of thickness 1 under a load in its middle, over the formulas' for E = 1.

    Bending 0.00560 P a^2 / D (Timoshenko and Woinowsky-Krieger 1959, Theory of plates and shells, table 37), and shear.
    Cells are twice as wide as high.
    """
    cells = 2 * round(0.25 * width * layers)
    side = np.linspace(0.0, width, cells + 1)
    lattice = slab(side, side, layers, 1.0 / layers, "sides")
    state = LatticeState.at_rest(lattice)
    force = np.zeros((*lattice.shape, 3))
    force[cells // 2, cells // 2, :, 2] = -load * edge_shares(layers + 1)
    advance_implicit(lattice, state, None, 1.0, quasi_static=True, external=force.reshape(-1, 3))
    middle = (lattice.nodes - state.x).reshape(force.shape)[cells // 2, cells // 2, :, 2].mean()
    rigidity = 1.0 / 12.0 / (1.0 - 0.25**2)
    return float(middle / load / (0.00560 * width**2 / rigidity + shear_deflection(width, width / cells)))


def plate_truth(layers: tuple[int, ...] = (2, 3, 4, 6), width: float = 30.0) -> dict[str, object]:
    """plate_error by layers."""
    return {"plate_error": {str(n): abs(plate_deflection(n, width) - 1.0) for n in layers}}


def hertz_force(per_radius: int = 3, radii: float = 8.0, wide: float = 8.0) -> tuple[float, float]:
    """Force of a rigid sphere on a block over Hertz's, 4/3 E / (1 - nu^2) sqrt(R) d^1.5, and what the block's base adds.

    per_radius : cells to the contact's radius a = sqrt(R d). The block is `radii` a thick and 2 `wide` a across, its base
    held. The second is Dimitriadis et al.'s factor for a bonded layer (2002, Biophys. J. 82), infinitely wide.
    """
    a = float(per_radius)
    depth = 0.02 * a
    radius = a * a / depth
    steps = [1.0] * math.ceil(1.5 * a)
    while sum(steps) < wide * a:
        steps.append(min(1.35 * steps[-1], 2.5))  # flatter cells lack shear stiffness
    half = np.concatenate([[0.0], np.cumsum(steps)])
    side = np.concatenate([-half[:0:-1], half])
    lattice = slab(side, side, round(radii * a), 1.0, "base")
    state = LatticeState.at_rest(lattice)
    fine = (np.arange(-14 * per_radius, 14 * per_radius) + 0.5) / 10.0
    u, v = (t.ravel() for t in np.meshgrid(fine, fine, indexing="ij"))
    nodes, weights = node_weights(lattice, u, v)
    centre = np.array([0.0, 0.0, radius - depth])
    force = 0.0
    for _ in range(12):
        out = centre - np.einsum("nk,nkc->nc", weights, state.x[nodes])
        distance = np.linalg.norm(out, axis=1)
        load = contacts(
            lattice, MPA, nodes, weights, normal=out / distance[:, None], depth=radius - distance, area=0.01
        )
        before = force
        force = -float(advance_implicit(lattice, state, load, 1.0, quasi_static=True).end_force[:, 2].sum())
        if abs(force - before) < 1e-4 * force:
            break
    hertz = 4.0 / 3.0 / (1.0 - 0.25**2) * math.sqrt(radius) * depth**1.5
    c = 2.0 / math.pi * (1.2876 - 1.4678 * 0.25 + 1.3442 * 0.25**2) / 0.75 / radii
    return force / hertz, 1.0 + c + c * c


def hertz_truth(per_radius: int = 4, radii: float = 8.0) -> dict[str, object]:
    """hertz_error against the half-space; hertz_layer_error against a bonded layer as thick as the block."""
    force, layer = hertz_force(per_radius, radii)
    return {"hertz_error": abs(force - 1.0), "hertz_layer_error": abs(force / layer - 1.0)}


def plastic_truth(cells: int = 3, length: int = 15) -> dict[str, object]:
    """A bar drawn beyond its yield and let go, against the bilinear law's set; the worst of three pulls.

    plastic_set_error : a bar of springs in a row, one dimension. plastic_set_error_solid, plastic_load_error_solid : a bar of
    cubes, its set and its strain under load. There, springs of several directions flow one after the other, and on
    unloading those along the bar flow back a little, so that the set falls short of the law's.
    """
    errors = {"plastic_set_error": 0.0, "plastic_set_error_solid": 0.0, "plastic_load_error_solid": 0.0}
    yield_strain, hardening = 1e-5, 0.05
    material = replace(MPA, yield_strain=yield_strain, hardening=hardening)
    solid = slab(np.arange(length + 1.0), np.arange(cells + 1.0), cells, 1.0, "start", material)
    row = replace(
        solid,
        stiffness=np.where(np.arange(13)[:, None] == 0, solid.stiffness, 0.0),
        yield_strain=np.full_like(solid.stiffness, yield_strain),
        hardening=np.full_like(solid.stiffness, hardening),
    )
    for pulled in (1.1, 1.2, 1.4):
        law = yield_strain * (1.0 + (pulled - 1.0) / hardening)
        for lattice in (solid, row):
            state = LatticeState.at_rest(lattice)
            strains = []
            # nothing holds the nodes of a row sideways but their inertia
            for stress in (pulled, 0.0):
                if lattice is row:
                    force = np.zeros_like(row.nodes)
                    end = np.arange(len(force)) // (solid.shape[1] * solid.shape[2]) == length
                    last = row.stiffness[0].reshape(solid.shape)[length - 1].ravel()
                    force[end, 0] = stress * yield_strain * last
                    for _ in range(3):
                        advance_implicit(lattice, state, None, 100.0, external=force)
                else:
                    force = pull(lattice.shape, stress * yield_strain * cells**2)
                    advance_implicit(lattice, state, None, 1.0, quasi_static=True, external=force)
                strains.append(bar_strain(state, lattice.shape, 1.0))
            kept = abs(strains[1] / (law - pulled * yield_strain) - 1.0)
            if lattice is row:
                errors["plastic_set_error"] = max(errors["plastic_set_error"], kept)
            else:
                errors["plastic_set_error_solid"] = max(errors["plastic_set_error_solid"], kept)
                loaded = abs(strains[0] / law - 1.0)
                errors["plastic_load_error_solid"] = max(errors["plastic_load_error_solid"], loaded)
    return dict(errors)
