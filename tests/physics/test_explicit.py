"""Explicit integration: periods, energy, momentum, plasticity, the stable sub-step and what lies beyond it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cadsculpt.errors import InputError, SimulationError
from cadsculpt.physics.explicit import SAFETY, ContactLoad, LatticeState, advance, stable_substep
from cadsculpt.physics.forces import contact_damping, contact_stiffness, node_weights
from cadsculpt.physics.lattice import Lattice, build_lattice
from cadsculpt.physics.material import PRESETS, Material
from cadsculpt.physics.measures import elastic_energy, kinetic_energy, nodal_plastic_set, nodal_strain, nodal_stress

Array = NDArray[np.float64]


def test_period_of_an_oscillator(chain: Callable[..., Lattice]) -> None:
    """One mass on one spring: T = 2 pi sqrt(m / k), within 0.1 %, also far from the rest length (Hooke's springs are
    linear).
    """
    lattice = chain([1.0, 0.02], [50.0])
    period = 2 * math.pi * math.sqrt(0.02 / 50.0)
    for amplitude in (1e-6, 0.3):
        state = LatticeState.at_rest(lattice)
        state.x[1, 0] += amplitude
        substep = period / 200
        crossings, before, time = [], amplitude, 0.0
        while len(crossings) < 21:
            advance(lattice, state, None, substep, substep=substep)
            time += substep
            now = state.x[1, 0] - 2.0 + 1.0
            if now * before < 0:
                crossings.append(time - substep * now / (now - before))
            before = now
        assert (crossings[20] - crossings[0]) / 10 == pytest.approx(period, rel=1e-3)


def test_damped_oscillator(chain: Callable[..., Lattice]) -> None:
    """x decays as exp(-gamma t / 2 m)."""
    lattice = chain([1.0, 0.02], [50.0], gamma=8.0)
    state = LatticeState.at_rest(lattice)
    state.x[1, 0] += 0.1
    frequency = math.sqrt(50.0 / 0.02 - 16.0)
    period = 2 * math.pi / frequency
    advance(lattice, state, None, 5 * period, substep=period / 2000)
    assert state.x[1, 0] - 1.0 == pytest.approx(0.1 * math.exp(-4.0 * 5 * period), rel=0.01)


def test_energy_of_an_undamped_lattice_does_not_drift(slab: Callable[..., Lattice]) -> None:
    """1e4 sub-steps of a vibrating, twisted slab: energy at the end as at the start within 1 %, and near it all the
    time.
    """
    lattice = slab(5, 4, 3, base=True)
    state = LatticeState.at_rest(lattice)
    nu, nv, nl = lattice.shape
    height = 1.0 - np.arange(nl) / (nl - 1)
    push = np.zeros((nu, nv, nl, 3))
    push[..., 0] = 2e-3 * height
    push[..., 2] = 1e-3 * height * np.arange(nu)[:, None, None] / nu
    state.x += push.reshape(-1, 3)
    energies = []
    for _ in range(1000):
        result = advance(lattice, state, None, 10 * stable_substep(lattice))
        assert result.substep == pytest.approx(stable_substep(lattice))
        # (6) and (7) leave the velocity half a sub-step behind the position
        together = state.copy()
        together.x -= 0.5 * result.substep * state.velocity
        energies.append(elastic_energy(lattice, together) + kinetic_energy(lattice, together))
    assert np.mean(energies[-200:]) == pytest.approx(np.mean(energies[:200]), rel=0.01)
    assert np.ptp(energies) < 0.1 * np.mean(energies)


def test_damped_energy_falls(slab: Callable[..., Lattice]) -> None:
    lattice = slab(5, 4, 3, base=True, material=Material(1e6, 1000.0, damping=0.3))
    state = LatticeState.at_rest(lattice)
    state.x[:, 0] += 0.05 * (lattice.nodes[:, 2] + 3.0) / 3.0
    energies = []
    for _ in range(40):
        advance(lattice, state, None, 2e-4)
        energies.append(elastic_energy(lattice, state) + kinetic_energy(lattice, state))
    assert energies[:20] == sorted(energies[:20], reverse=True)
    assert energies[-1] < 1e-6 * energies[0]


def test_critical_damping_of_the_thickness_mode(slab: Callable[..., Lattice]) -> None:
    """A layer on a fixed base, stretched along its normal: damping 0.2 rings down as 20 % of critical damping does."""
    lattice = slab(3, 3, 12, steps=(0.5, 0.5, 0.5), material=Material(1e6, 1000.0, damping=0.2), base=True)
    state = LatticeState.at_rest(lattice)
    state.x[:, 2] += 1e-3 * np.sin(math.pi / 2 * (lattice.nodes[:, 2] + 6.0) / 6.0)
    speed = math.sqrt(1.2e6 / 1000.0) * 1e3
    omega = math.pi / 2 * speed / 6.0
    tick = 2 * math.pi / omega / 200
    top = []
    for _ in range(500):
        advance(lattice, state, None, tick)
        # an infinite layer: nothing moves sideways
        state.x[:, :2] = lattice.nodes[:, :2]
        state.velocity[:, :2] = 0.0
        top.append(state.x[lattice.nodes[:, 2] == 0.0, 2].mean())
    peaks = [n for n in range(1, len(top) - 1) if top[n - 1] < top[n] > top[n + 1] and top[n] > 0]
    assert (peaks[1] - peaks[0]) * tick == pytest.approx(2 * math.pi / omega / math.sqrt(1 - 0.04), rel=0.02)
    assert math.log(top[peaks[0]] / top[peaks[1]]) == pytest.approx(2 * math.pi * 0.2 / math.sqrt(1 - 0.04), rel=0.03)


def test_free_body_accelerates_as_force_over_mass(slab: Callable[..., Lattice]) -> None:
    """1 N on 1 kg gives 1 m/s^2, whatever the unit: the mean acceleration of a free lattice under forces on some
    nodes.
    """
    lattice = slab(4, 5, 2)
    state = LatticeState.at_rest(lattice)
    force = np.zeros_like(lattice.nodes)
    force[3], force[17] = (1e-3, 2e-3, 0.0), (0.0, 1e-3, -4e-3)
    kilograms = 1000.0 * lattice.volume.sum() * 1e-9
    dt = 1e-3
    advance(lattice, state, None, dt, external=force)
    velocity = lattice.mass @ state.velocity / lattice.mass.sum()
    assert velocity * 1e-3 == pytest.approx(force.sum(axis=0) / kilograms * dt, rel=1e-10)


def test_turning_free_body_keeps_its_shape(slab: Callable[..., Lattice]) -> None:
    """Springs feel no rotation: a slab that spins slowly keeps its angular momentum and stays unstrained."""
    lattice = slab(4, 4, 2)
    state = LatticeState.at_rest(lattice)
    centre = lattice.mass @ lattice.nodes / lattice.mass.sum()
    state.velocity[:] = np.cross([0.0, 3.0, 4.0], lattice.nodes - centre)
    before = lattice.mass @ np.cross(lattice.nodes - centre, state.velocity)
    for _ in range(10):
        advance(lattice, state, None, 0.02)
    after = lattice.mass @ np.cross(state.x - centre, state.velocity)
    assert after == pytest.approx(before, rel=1e-9, abs=1e-9 * np.abs(before).max())
    assert nodal_strain(lattice, state).max() < 1e-4


@pytest.mark.parametrize("hardening", [0.0, 0.05, 0.3])
def test_bar_of_springs_yields_hardens_and_keeps_its_set(chain: Callable[..., Lattice], hardening: float) -> None:
    """A row of springs drawn far beyond yield, let go and drawn again, against the bilinear law with kinematic
    hardening.
    """
    stiffness, yield_strain = 100.0, 0.01
    lattice = chain(
        [1e-3] * 11, [stiffness] * 10, yield_strain=yield_strain, hardening=hardening, gamma=20.0, held=(0, 10)
    )
    state = LatticeState.at_rest(lattice)

    def draw(strain: float) -> float:
        """Move the end to a total strain, slowly; returns the pull."""
        state.velocity[10, 0] = (10.0 * (1.0 + strain) - state.x[10, 0]) / 10.0
        advance(lattice, state, None, 10.0)
        state.velocity[10, 0] = 0.0
        advance(lattice, state, None, 3.0)
        lengths = np.diff(state.x[:, 0])
        return float((stiffness * (lengths - state.rest_length[0, :10])).mean())

    flow = stiffness * (yield_strain + hardening * 0.04)
    assert draw(0.008) == pytest.approx(stiffness * 0.008, rel=1e-3)
    assert draw(0.05) == pytest.approx(flow, rel=0.02)
    # without hardening the first spring to flow takes all of it; the bar's set is the same
    assert (state.rest_length[0, :10] - 1.0).mean() == pytest.approx(0.04 * (1 - hardening), rel=0.02)
    if hardening:
        assert nodal_plastic_set(lattice, state) == pytest.approx(0.04 * (1 - hardening), rel=0.02)
    # unloading is elastic, so is loading again up to where it flowed
    assert draw(0.045) == pytest.approx(flow - stiffness * 0.005, rel=0.02)
    assert draw(0.05) == pytest.approx(flow, rel=0.02)
    # the elastic range stays twice the yield strain wide; then the bar flows back
    assert draw(0.02) == pytest.approx(flow - stiffness * (0.02 + hardening * 0.01), abs=0.02 * flow)


def test_solid_bar_flows_at_its_yield_stress(slab: Callable[..., Lattice]) -> None:
    """A bar of cubes beyond its knee follows sigma = E (yield + hardening (e - yield)) within 2 % of strain."""
    yield_strain, hardening = 1e-3, 0.05
    material = Material(1e6, 1000.0, damping=0.5, yield_strain=yield_strain, hardening=hardening)
    lattice = slab(9, 4, 3, material=material)
    state = LatticeState.at_rest(lattice)
    index = np.stack(np.unravel_index(np.arange(len(lattice.nodes)), lattice.shape), axis=1)
    share = np.where(index[:, 1] % 3 == 0, 0.5, 1.0) * np.where(index[:, 2] % 3 == 0, 0.5, 1.0)
    for stress in (1.1, 1.2):
        force = np.zeros_like(lattice.nodes)
        force[:, 0] = share * ((index[:, 0] == 8).astype(float) - (index[:, 0] == 0)) * stress * yield_strain
        for _ in range(40):
            advance(lattice, state, None, 2e-3, external=force)
        drawn = state.x[index[:, 0] == 7, 0].mean() - state.x[index[:, 0] == 1, 0].mean()
        assert drawn / 6.0 - 1.0 == pytest.approx(yield_strain * (1 + (stress - 1) / hardening), rel=0.02)
        # the middle of the bar carries the stress: von Mises of uniaxial tension is the tension
        middle = nodal_stress(lattice, state).reshape(lattice.shape)[4, 1:3, 1:3]
        assert middle == pytest.approx(stress * yield_strain * 1e6, rel=0.05)


@pytest.mark.parametrize("seed", range(6))
def test_stable_substep_is_safe_and_not_timid(slab: Callable[..., Lattice], tangent: Any, seed: int) -> None:
    """Random distorted, strained lattices: the bound lies between 0.8 and 1 of the true limit 2 / omega_max."""
    rng = np.random.default_rng(seed)
    steps = tuple(rng.uniform(0.5, 1.5, 3))
    lattice = slab(
        4, 5, 3, steps=steps, base=bool(seed % 2), move=lambda p: p + 0.2 * min(steps) * rng.uniform(-1, 1, p.shape)
    )
    state = LatticeState.at_rest(lattice)
    state.x += 0.15 * (seed % 3) * min(steps) * rng.uniform(-1, 1, state.x.shape)
    root = np.repeat(np.sqrt(lattice.inverse_mass), 3)
    square = np.linalg.eigvalsh(root[:, None] * tangent(lattice, state.x).toarray() * root)[-1]
    limit = 2.0 / math.sqrt(square)
    assert 0.8 * limit < stable_substep(lattice, state, safety=1.0) <= limit * (1 + 1e-12)
    assert stable_substep(lattice, state) == pytest.approx(SAFETY * stable_substep(lattice, state, safety=1.0))


@pytest.mark.parametrize("damping", [0.0, 0.5, 20.0])
def test_just_below_the_limit_is_stable_and_above_is_refused(slab: Callable[..., Lattice], damping: float) -> None:
    rng = np.random.default_rng(5)
    lattice = slab(
        5,
        5,
        3,
        base=True,
        material=Material(1e6, 1000.0, damping=damping),
        move=lambda p: p + 0.25 * rng.uniform(-1, 1, p.shape),
    )
    state = LatticeState.at_rest(lattice)
    state.x += 1e-4 * rng.normal(size=state.x.shape) * ~lattice.anchored[:, None]
    largest = stable_substep(lattice, state, safety=1.0)
    before = elastic_energy(lattice, state)
    for _ in range(4):
        result = advance(lattice, state, None, 1000 * 0.99 * largest, substep=0.99001 * largest)
        assert result.substeps == 1000
    # the semi-implicit rule's own invariant is far from the energy near the limit, but stays in proportion to it
    assert elastic_energy(lattice, state) < 100 * before
    with pytest.raises(
        InputError, match=rf"largest that is stable here is {stable_substep(lattice, state, safety=1.0):.4g} s"
    ):
        advance(lattice, state, None, 1.0, substep=1.2 * largest)


@pytest.mark.parametrize("stiffer", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("mu", [0.0, 0.8])
@pytest.mark.parametrize("points", [6, 14, 40])
def test_contact_never_makes_it_unstable(
    slab: Callable[..., Lattice], contact: Callable[..., ContactLoad], points: int, mu: float, stiffer: float
) -> None:
    """A ball pressed into light, hardly damped foam of distorted cells, few and many contacts, stiff ones, friction:
    no jitter.
    """
    rng = np.random.default_rng(points)
    material = Material(1e5, 30.0, damping=0.05)
    lattice = slab(
        9, 9, 3, base=True, material=material, move=lambda p: p + 0.15 * rng.uniform(-1, 1, p.shape) * [1.0, 1.0, 0.0]
    )
    state = LatticeState.at_rest(lattice)
    u, v = (x.ravel() for x in np.meshgrid(*[(np.arange(points) + 0.5) / points * 8] * 2))
    nodes, weights = node_weights(lattice, u, v)
    stiffness = stiffer * contact_stiffness(material, 3.0, 1.0, 1e-3)
    for step in range(70):
        bottom = -0.02 * min(step, 40)
        x = np.einsum("nk,nkc->nc", weights, state.x[nodes])
        out = np.array([4.1, 3.8, bottom + 4.0]) - x
        distance = np.linalg.norm(out, axis=1)
        near = distance < 4.2
        load = contact(
            nodes[near],
            weights[near],
            depth=4.0 - distance[near],
            area=64.0 / points**2,
            velocity=(0.0, 0.0, -20.0 if step < 40 else 0.0),
            stiffness=stiffness,
            damping=contact_damping(material, stiffness, lattice),
            friction=mu,
        )
        load.normal[:] = out[near] / distance[near, None]
        result = advance(lattice, state, load, 1e-3)
        # the tool moves at 20 mm/s and stops dead; sound travels at 60 m/s
        assert result.max_speed < 400.0
    assert result.max_speed < 2.0


def test_pressed_tube_stays_symmetric(contact: Callable[..., ContactLoad]) -> None:
    """A closed tube pressed all around: every section moves alike, across the seam too."""
    nu, nv = 24, 4
    angle = 2 * math.pi * np.arange(nu) / nu
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)[:, None, :] * np.ones((1, nv, 1))
    points = 10 * out
    points[..., 2] = 2.5 * np.arange(nv)
    anchored = np.zeros((nu, nv, 4), dtype=bool)
    anchored[:, :, -1] = True
    lattice = build_lattice(
        points,
        -out,
        angle,
        np.arange(nv, dtype=float),
        thickness=3.0,
        layers=3,
        material=Material(1e6, 1000.0, damping=0.5),
        wrap=(True, False),
        period=(2 * math.pi, 0.0),
        anchored=anchored,
        metres_per_unit=1e-3,
    )
    state = LatticeState.at_rest(lattice)
    u, v = (x.ravel() for x in np.meshgrid(angle, np.arange(nv), indexing="ij"))
    nodes, weights = node_weights(lattice, u, v)
    for _ in range(30):
        x = np.einsum("nk,nkc->nc", weights, state.x[nodes])
        radius = np.linalg.norm(x[:, :2], axis=1)
        load = contact(nodes, weights, depth=radius - 9.9, area=2.5**2, stiffness=20.0, damping=1e-3, friction=0.3)
        load.normal[:] = x * np.array([1.0, 1.0, 0.0]) / radius[:, None]
        result = advance(lattice, state, load, 1e-3)
    moved = np.linalg.norm(state.x.reshape(nu, nv, 4, 3)[..., :2], axis=3)
    assert moved == pytest.approx(np.broadcast_to(moved[:1], moved.shape), rel=1e-9)
    assert result.mean_force.sum(axis=0)[:2] == pytest.approx(0.0, abs=1e-9 * np.abs(result.mean_force).sum())
    assert moved[0, 1, 0] < 9.92


def test_held_nodes_keep_the_velocity_they_are_given(slab: Callable[..., Lattice]) -> None:
    """A lattice carried by its base at constant speed follows it, unstrained in the end."""
    lattice = slab(4, 4, 2, base=True, material=Material(1e6, 1000.0, damping=0.0))
    state = LatticeState.at_rest(lattice)
    state.velocity[:] = (3.0, 0.0, 1.0)
    advance(lattice, state, None, 0.5)
    assert state.x - lattice.nodes == pytest.approx(np.tile([1.5, 0.0, 0.5], (len(state.x), 1)), abs=1e-9)


def test_two_runs_give_the_same_bytes(slab: Callable[..., Lattice], contact: Callable[..., ContactLoad]) -> None:
    results = []
    for _ in range(2):
        lattice = slab(6, 6, 2, material=PRESETS["clay"], base=True)
        state = LatticeState.at_rest(lattice)
        nodes, weights = node_weights(lattice, np.linspace(1, 4, 40), np.linspace(1, 4, 40) ** 2 / 4)
        load = contact(
            nodes, weights, depth=0.2, area=0.1, stiffness=5.0, damping=1e-4, friction=0.4, velocity=(5.0, 0, -9.0)
        )
        result = advance(lattice, state, load, 2e-3)
        results.append(
            [a.tobytes() for a in (state.x, state.velocity, state.rest_length, result.mean_force, result.depth)]
        )
    assert results[0] == results[1]


def test_an_unstable_step_is_an_error_and_leaves_the_state(
    slab: Callable[..., Lattice], contact: Callable[..., ContactLoad]
) -> None:
    lattice = slab(5, 5, 2, material=Material(1e6, 1000.0, yield_strain=0.01), base=True)
    state = LatticeState.at_rest(lattice)
    force = np.zeros_like(lattice.nodes)
    force[12 * 3, 2] = -1e6
    before = state.copy()
    with pytest.raises(SimulationError, match="faster than sound"):
        advance(lattice, state, None, 1e-3, external=force)
    for name in ("x", "velocity", "rest_length"):
        assert (getattr(state, name) == getattr(before, name)).all()
    force[12 * 3, 2] = math.nan
    with pytest.raises(SimulationError, match="no longer finite"):
        advance(lattice, state, None, 1e-3, external=force)
    for value in (math.nan, math.inf, 1e200):
        state.x[3] = value
        with pytest.raises(SimulationError):
            advance(lattice, state, None, 1e-3)


@pytest.mark.parametrize("dt", [0.0, -1.0, math.nan, math.inf])
def test_bad_steps_are_refused(chain: Callable[..., Lattice], dt: float) -> None:
    lattice = chain([1.0, 1.0], [1.0])
    with pytest.raises(InputError, match="positive time"):
        advance(lattice, LatticeState.at_rest(lattice), None, dt)


def test_the_bound_is_evaluated_again_before_it_is_wrong(
    slab: Callable[..., Lattice], contact: Callable[..., ContactLoad], tangent: Any
) -> None:
    """While a slab of clay is crushed, what the sub-step is taken from stays within a percent of a bound that is evaluated at
    every step, which never lies below the true frequency nor far above it."""
    lattice = slab(7, 7, 3, base=True, material=PRESETS["clay"])
    state = LatticeState.at_rest(lattice)
    u, v = (x.ravel() for x in np.meshgrid(*[np.linspace(1.5, 4.5, 9)] * 2))
    nodes, weights = node_weights(lattice, u, v)
    stiffness = contact_stiffness(PRESETS["clay"], 3.0, 1.0, 1e-3)
    calls = 0
    for k in range(200):
        depth = np.einsum("nk,nk->n", weights, state.x[nodes][..., 2]) + 0.005 * k
        load = contact(
            nodes, weights, depth=depth, area=0.14, velocity=(2.0, 0.0, -5.0), stiffness=stiffness, friction=0.4
        )
        seen = state.bound.seen.copy()
        advance(lattice, state, load, 1e-3)
        calls += not np.array_equal(seen, state.bound.seen)
        fresh = state.bound.copy()
        fresh.seen[:] = np.inf
        used, state.bound = state.bound, fresh
        now = stable_substep(lattice, state, safety=1.0)
        state.bound = used
        assert stable_substep(lattice, state, safety=1.0) <= 1.01 * now
        if k % 50 == 49:
            root = np.repeat(np.sqrt(lattice.inverse_mass), 3)
            matrix = tangent(replace(lattice, rest_length=state.rest_length), state.x).toarray()
            square = float(np.linalg.eigvalsh(root[:, None] * matrix * root)[-1])
            limit = 4.0 / (lattice.highest_drag + math.sqrt(lattice.highest_drag**2 + 4.0 * square))
            assert 0.9 * limit < now <= limit * (1 + 1e-12)
    assert 5 < calls < 150
    assert np.abs(state.x - lattice.nodes).max() > 0.3
