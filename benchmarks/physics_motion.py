"""Truths of motion: an oscillator's period, the energy of an undamped lattice, the balance of forces, stick and slip."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from physics_lattices import MPA, contacts, edge_shares, slab

from cadsculpt.physics.explicit import ContactLoad, LatticeState, StepForces, advance, stable_substep
from cadsculpt.physics.forces import node_weights
from cadsculpt.physics.implicit import advance_implicit
from cadsculpt.physics.lattice import Lattice
from cadsculpt.physics.measures import elastic_energy, kinetic_energy

Advance = Callable[[Lattice, LatticeState, ContactLoad | None, float, np.ndarray | None], StepForces]


def explicit(
    lattice: Lattice, state: LatticeState, load: ContactLoad | None, dt: float, external: np.ndarray | None
) -> StepForces:
    return advance(lattice, state, load, dt, external=external)


def implicit(
    lattice: Lattice, state: LatticeState, load: ContactLoad | None, dt: float, external: np.ndarray | None
) -> StepForces:
    return advance_implicit(lattice, state, load, dt, external=external)


def period_truth(periods: int = 20) -> dict[str, object]:
    """period_error: one node of a slab swings along the normal while all others are held, against 2 pi sqrt(m / k)."""
    lattice = slab(np.arange(3.0), np.arange(3.0), 2, 1.0)
    node = (1 * 3 + 1) * 3
    held = np.arange(len(lattice.nodes)) != node
    lattice = replace(lattice, anchored=held, inverse_mass=np.where(held, 0.0, lattice.inverse_mass))
    # k = sum of k_s n_z^2 over the springs at the node, found from the offsets alone
    stiffness = 0.0
    for d, offset in enumerate(lattice.offsets):
        along = (float(offset[2]) / np.linalg.norm(offset)) ** 2
        before = node - ((offset[0] * 3 + offset[1]) * 3 + offset[2])
        stiffness += along * (lattice.stiffness[d, node] + (lattice.stiffness[d, before] if offset[2] <= 0 else 0.0))
    period = 2.0 * math.pi * math.sqrt(lattice.mass[node] / stiffness)
    state = LatticeState.at_rest(lattice)
    state.x[node, 2] += 1e-6
    tick = period / 400.0
    crossings: list[float] = []
    before, time = 1e-6, 0.0
    while len(crossings) < 2 * periods + 1:
        advance(lattice, state, None, tick)
        time += tick
        now = float(state.x[node, 2])
        if now * before < 0.0:
            crossings.append(time - tick * now / (now - before))
        before = now
    measured = (crossings[-1] - crossings[0]) / periods
    return {"period_error": abs(measured / period - 1.0)}


def energy_truth(steps: int = 10_000, size: int = 5) -> dict[str, object]:
    """energy_drift: the mean energy of a vibrating undamped slab over the last fifth of the steps against the first fifth.

    energy_falls_implicit : backward Euler only ever loses some.
    """
    lattice = slab(np.arange(float(size)), np.arange(size - 1.0), 3, 1.0, "base")
    height = (lattice.nodes[:, 2] + 3.0) / 3.0
    push = np.stack([2e-3 * height, 0.0 * height, 1e-3 * height * lattice.nodes[:, 0] / size], axis=1)
    state = LatticeState.at_rest(lattice)
    state.x += push
    substep = stable_substep(lattice)
    energies = []
    for _ in range(steps // 10):
        result = advance(lattice, state, None, 10.0 * substep)
        # velocities stand half a sub-step behind positions
        together = state.copy()
        together.x -= 0.5 * result.substep * state.velocity
        energies.append(elastic_energy(lattice, together) + kinetic_energy(lattice, together))
    fifth = max(1, len(energies) // 5)
    drift = abs(np.mean(energies[-fifth:]) / np.mean(energies[:fifth]) - 1.0)
    state = LatticeState.at_rest(lattice)
    state.x += push
    lossy = [elastic_energy(lattice, state)]
    for _ in range(20):
        advance_implicit(lattice, state, None, 5.0 * substep)
        lossy.append(elastic_energy(lattice, state) + kinetic_energy(lattice, state))
    falls = all(after <= before * (1.0 + 1e-12) for before, after in zip(lossy[:-1], lossy[1:], strict=True))
    return {"energy_drift": float(drift), "energy_falls_implicit": falls}


def balance_truth(count: int = 200, seed: int = 3) -> dict[str, object]:
    """What contacts push a free body with, by its momentum, less what they push the tool back with, over their sum.

    balance_error : of the explicit integrator, whose steps are exact. balance_error_implicit : of the implicit one, whose
    residual stays below a millionth of the forces at work. Skew contacts that press and rub at random.
    """
    rng = np.random.default_rng(seed)
    material = replace(MPA, friction=0.4)
    lattice = slab(np.arange(7.0), np.arange(6.0), 2, 1.0, material=material)
    nodes, weights = node_weights(lattice, rng.uniform(0, 6, count), rng.uniform(0, 5, count))
    normal = rng.normal(size=(count, 3)) * 0.3 + np.array([0.0, 0.0, 1.0])
    load = contacts(
        lattice, material, nodes, weights, normal=normal / np.linalg.norm(normal, axis=1)[:, None],
        depth=0.01 * rng.uniform(-1, 1, count), area=0.15, velocity=(3.0, 1.0, -2.0),
    )  # fmt: skip
    errors = {}
    for name, step in (("explicit", explicit), ("implicit", implicit)):
        state = LatticeState.at_rest(lattice)
        dt = 1e-4
        result = step(lattice, state, load, dt, None)
        impulse = result.mean_force.sum(axis=0) * dt
        momentum = lattice.mass @ state.velocity
        errors[name] = float(np.abs(momentum - impulse).max() / (np.abs(result.mean_force).sum() * dt))
    return {"balance_error": errors["explicit"], "balance_error_implicit": errors["implicit"]}


def slides(step: Advance, share: float, size: int = 4, time: float = 0.4) -> bool:
    """Does a free block, pressed against a still plane with N, slide under `share` of mu N along it?"""
    material = replace(MPA, damping=0.5, friction=0.3)
    lattice = slab(np.arange(float(size)), np.arange(float(size)), 2, 1.0, material=material)
    middles = np.arange(size - 1) + 0.5
    u, v = (t.ravel() for t in np.meshgrid(middles, middles, indexing="ij"))
    nodes, weights = node_weights(lattice, u, v)
    state = LatticeState.at_rest(lattice)
    press = 5e-3 * (size - 1) ** 2
    even = np.zeros((*lattice.shape, 3))
    even[:, :, 0, :] = (edge_shares(size)[:, None] * edge_shares(size))[..., None]
    depth = np.zeros(len(u))
    for tangential in (0.0, share):
        # pressed on, then pushed: both at the plane, so that nothing tips over
        force = even * np.array([tangential * material.friction * press, 0.0, press])
        for _ in range(20):
            load = contacts(
                lattice, material, nodes, weights, normal=np.tile([0.0, 0.0, 1.0], (len(u), 1)), depth=depth, area=1.0
            )
            result = step(lattice, state, load, time / 40, force.reshape(-1, 3))
            depth = result.depth
    speed = lattice.mass @ state.velocity[:, 0] / lattice.mass.sum()
    # a block that nothing holds reaches the speed at which its damping takes the whole push
    return bool(speed > 5e-3 * material.friction * press / lattice.gamma.sum())


def stick_slip_error(step: Advance, bisections: int = 8) -> float:
    """How far from mu N the push is at which the block begins to slide, over mu N."""
    low, high = 0.5, 1.5
    if slides(step, low) or not slides(step, high):
        return math.inf
    for _ in range(bisections):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if slides(step, middle) else (middle, high)
    return max(abs(low - 1.0), abs(high - 1.0))


def stick_slip_truth(bisections: int = 8) -> dict[str, object]:
    """stick_slip_error of the explicit integrator, and of the implicit one."""
    return {
        "stick_slip_error": stick_slip_error(explicit, bisections),
        "stick_slip_error_implicit": stick_slip_error(implicit, bisections),
    }
