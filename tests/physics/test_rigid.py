"""Damping belongs to deformation: what flies flies on, what spins spins on, what is carried is not dragged."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cadsculpt.physics.assembly import assemble
from cadsculpt.physics.explicit import LatticeState, StepForces, advance
from cadsculpt.physics.implicit import advance_implicit
from cadsculpt.physics.lattice import Lattice
from cadsculpt.physics.material import PRESETS, Material
from cadsculpt.physics.measures import elastic_energy, kinetic_energy, nodal_strain
from cadsculpt.physics.rigid import body_modes, rigid_motion

Array = NDArray[np.float64]
Step = Callable[..., StepForces]
BOTH = pytest.mark.parametrize("step", [advance, advance_implicit])
DAMPED = Material(1e6, 1000.0, damping=0.5)


def angular_momentum(lattice: Lattice, state: LatticeState) -> Array:
    return lattice.mass @ np.cross(state.x, state.velocity)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6))
def test_rigid_motion_of_a_rigid_body(seed: int) -> None:
    """Any weights, any place: V and omega come back; in a line, whatever gives the same velocities."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(12, 3)) * 10.0 ** rng.uniform(-3, 3) + 100.0 * rng.normal(size=3)
    if seed % 3 == 0:
        x[:] = x[0] + np.outer(rng.normal(size=12), [1.0, 2.0, -2.0])
    weights, v, spin = rng.uniform(0.1, 2.0, 12), rng.normal(size=3), rng.normal(size=3)
    velocity = v + np.cross(spin, x - x[3])
    centre, mean, found = rigid_motion(weights, x, velocity)
    assert centre == pytest.approx(weights @ x / weights.sum())
    scale = np.abs(velocity).max()
    assert mean + np.cross(found, x - centre) == pytest.approx(velocity, abs=1e-8 * scale)
    if seed % 3:
        assert found == pytest.approx(spin, abs=1e-7)


def test_modes_are_the_rigid_motions_nearest_to_the_velocities(slab: Callable[..., Lattice]) -> None:
    """modes^T core modes v = gamma times `rigid_motion` with gamma as weights, body by body; a single line of nodes too."""
    rng = np.random.default_rng(0)
    pair = assemble([slab(4, 3, 2, material=DAMPED), slab(3, 5, 1, material=PRESETS["foam"])]).lattice
    x = pair.nodes + 0.1 * rng.normal(size=pair.nodes.shape)
    velocity = rng.normal(size=x.shape)
    modes, core = body_modes(pair.free, pair.gamma, x)
    found = np.einsum("rnc,rs,s->nc", modes, core, np.einsum("snc,nc->s", modes, velocity))
    for _, start, stop in pair.free:
        mine = slice(start, stop)
        centre, mean, spin = rigid_motion(pair.gamma[mine], x[mine], velocity[mine])
        expected = pair.gamma[mine, None] * (mean + np.cross(spin, x[mine] - centre))
        assert found[mine] == pytest.approx(expected, rel=1e-9, abs=1e-12 * np.abs(expected).max())


@BOTH
def test_a_thrown_block_does_not_slow_down(slab: Callable[..., Lattice], step: Step) -> None:
    """Damped by half of critical, two materials (two ratios of gamma to m), for many times m / gamma: as fast as at first."""
    cells = np.zeros((4, 3, 2), dtype=np.int64)
    cells[:2] = 1
    lattice = slab(5, 4, 2, material=[DAMPED, Material(3e6, 2000.0, damping=0.9)], cell_material=cells)
    state = LatticeState.at_rest(lattice)
    state.velocity[:] = (300.0, -200.0, 50.0)
    before = lattice.mass @ state.velocity
    dt = 20.0 * float((lattice.mass / lattice.gamma).max())
    for _ in range(5):
        step(lattice, state, None, dt / 5)
    assert lattice.mass @ state.velocity == pytest.approx(before, rel=1e-9)
    assert nodal_strain(lattice, state).max() < 1e-9
    assert state.x - lattice.nodes == pytest.approx(
        np.tile(dt * np.array([300.0, -200.0, 50.0]), (len(state.x), 1)), rel=1e-9
    )


@BOTH
def test_what_vibrates_in_flight_comes_to_rest_in_it(slab: Callable[..., Lattice], step: Step) -> None:
    """Two free bodies spin and fly; one vibrates. Momentum within 1e-9 of each; its vibration dies, the spin does not."""
    pair = assemble([slab(5, 4, 2, material=DAMPED), slab(4, 4, 3, material=DAMPED)])
    lattice = pair.lattice
    state = LatticeState.at_rest(lattice)
    for k, spin in enumerate(([0.0, 3.0, 4.0], [2.0, 0.0, 0.0])):
        mine = pair.part_state(state, k)
        mine.velocity[:] = np.cross(spin, mine.x - mine.x.mean(axis=0)) + [20.0, 0.0, -10.0 * k]
    state.velocity[: pair.starts[1]] += 20.0 * np.random.default_rng(0).normal(size=(pair.starts[1], 3))
    momenta = [pair.parts[k].mass @ pair.part_state(state, k).velocity for k in (0, 1)]
    spins = [angular_momentum(pair.parts[k], pair.part_state(state, k)) for k in (0, 1)]
    for _ in range(200):
        step(lattice, state, None, 1e-4)
    for k in (0, 1):
        part, mine = pair.parts[k], pair.part_state(state, k)
        assert part.mass @ mine.velocity == pytest.approx(momenta[k], rel=1e-9, abs=1e-9 * np.abs(momenta[k]).max())
        # backward Euler turns in chords: it loses (omega h)^2 of the spin in every step
        exact = 1e-6 if step is advance else 200 * 25.0 * 1e-4**2 * 1.1
        assert angular_momentum(part, mine) == pytest.approx(spins[k], rel=exact, abs=exact * np.abs(spins[k]).max())
        centre, velocity, spin = rigid_motion(part.mass, mine.x, mine.velocity)
        left = mine.velocity - velocity - np.cross(spin, mine.x - centre)
        assert np.abs(left).max() < 0.02
        assert nodal_strain(part, mine).max() < 1e-4


@BOTH
def test_vibration_in_flight_is_damped_as_at_rest(slab: Callable[..., Lattice], step: Step) -> None:
    """The energy of deformation is the same whether the body flies or not."""
    lattice = slab(5, 4, 3, material=Material(1e6, 1000.0, damping=0.1))
    energies = []
    for speed in (0.0, 500.0):
        state = LatticeState.at_rest(lattice)
        state.x[:, 0] *= 1.02
        state.velocity[:, 1] = speed
        for _ in range(10):
            step(lattice, state, None, 1e-4)
        state.velocity -= lattice.mass @ state.velocity / lattice.mass.sum()
        energies.append(elastic_energy(lattice, state) + kinetic_energy(lattice, state))
    # Newton's iterations end at 1e-6 of the forces at work, inertia's among them
    assert energies[1] == pytest.approx(energies[0], rel=1e-9 if step is advance else 1e-3)


@BOTH
def test_force_on_a_free_damped_body_is_mass_times_acceleration(slab: Callable[..., Lattice], step: Step) -> None:
    lattice = slab(4, 5, 2, material=DAMPED)
    state = LatticeState.at_rest(lattice)
    force = np.zeros_like(lattice.nodes)
    force[3], force[17] = (1e-4, 2e-4, 0.0), (0.0, 1e-4, -4e-4)
    for _ in range(5):
        step(lattice, state, None, 1e-3, external=force)
    assert lattice.mass @ state.velocity == pytest.approx(force.sum(axis=0) * 5e-3, rel=1e-9)


@BOTH
def test_a_carried_body_is_not_dragged(slab: Callable[..., Lattice], step: Step) -> None:
    """Held by its base, moved and turned: with the frame's velocity it stays as it is; without, gamma holds it back."""
    lattice = slab(5, 5, 3, base=True, material=DAMPED)
    centre, spin = lattice.nodes.mean(axis=0), np.array([0.0, 0.0, 0.5])
    strains = []
    for framed in (True, False):
        state = LatticeState.at_rest(lattice)
        for k in range(40):
            frame = np.array([200.0, 0.0, -100.0]) + np.cross(
                spin, state.x - centre - np.array([200.0, 0.0, -100.0]) * 1e-4 * k
            )
            if k == 0:
                state.velocity[:] = frame
            state.velocity[lattice.anchored] = frame[lattice.anchored]
            step(lattice, state, None, 1e-4, frame_velocity=frame if framed else None)
        strains.append(float(nodal_strain(lattice, state).max()))
    assert strains[0] < 1e-5
    # gamma v = 2 damping (pi / 2) c / t rho v A t over the layer's stiffness
    assert strains[1] > 1e-3


@BOTH
def test_a_frame_does_not_move_what_is_free(slab: Callable[..., Lattice], step: Step) -> None:
    pair = assemble([slab(4, 4, 2, base=True, material=DAMPED), slab(3, 3, 1, material=DAMPED)])
    state = LatticeState.at_rest(pair.lattice)
    frame = np.full_like(pair.lattice.nodes, 50.0)
    step(pair.lattice, state, None, 1e-3, frame_velocity=frame)
    assert pair.part_state(state, 1).x == pytest.approx(pair.parts[1].nodes, abs=1e-12)
    assert np.abs(pair.part_state(state, 0).x - pair.parts[0].nodes).max() > 1e-4


def test_the_damped_sub_step_is_still_stable(slab: Callable[..., Lattice]) -> None:
    """Free, heavily damped, at the bound of a body held still: what the rigid motion takes away only damps less."""
    lattice = slab(5, 5, 2, material=Material(1e6, 1000.0, damping=20.0))
    state = LatticeState.at_rest(lattice)
    state.velocity[:] = 100.0 * np.random.default_rng(0).normal(size=state.velocity.shape)
    start = kinetic_energy(lattice, state)
    for _ in range(20):
        advance(lattice, state, None, 1e-4)
    assert math.isfinite(start)
    centre, velocity, spin = rigid_motion(lattice.mass, state.x, state.velocity)
    left = state.velocity - velocity - np.cross(spin, state.x - centre)
    assert np.abs(left).max() < 5.0
