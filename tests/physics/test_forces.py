"""Contact: the four nodes around (u, v), contact stiffness, the law of pressure and friction, balance of forces."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadsculpt.errors import InputError
from cadsculpt.physics.explicit import ContactLoad, LatticeState, advance
from cadsculpt.physics.forces import STIFFNESS_RATIO, contact_damping, contact_stiffness, node_weights
from cadsculpt.physics.lattice import Lattice, build_lattice
from cadsculpt.physics.material import PRESETS, Material

MM = 1e-3


def uneven(wrap: tuple[bool, bool] = (False, False), **options: object) -> Lattice:
    """A flat slab whose points are its parameters, unevenly spaced; a closed direction is closed in parameters
    alone.
    """
    u, v = np.array([0.0, 1.0, 1.5, 3.0, 4.0]), np.array([-1.0, 0.0, 2.0, 2.5])
    points = np.stack([*np.meshgrid(u, v, indexing="ij"), np.zeros((5, 4))], axis=-1)
    if wrap[0]:
        turn = 2 * math.pi * u / 5.0
        points = np.stack(np.broadcast_arrays(np.cos(turn)[:, None], np.sin(turn)[:, None], v), axis=-1)
        inward = -points * np.array([1.0, 1.0, 0.0])
    else:
        inward = np.broadcast_to([0.0, 0.0, -1.0], points.shape)
    return build_lattice(
        points,
        inward,
        u,
        v,
        thickness=0.2,
        layers=2,
        material=Material(1e6, 1000.0, damping=0.0),
        wrap=wrap,
        period=(5.0, 0.0) if wrap[0] else None,
        metres_per_unit=MM,
        **options,  # type: ignore[arg-type]
    )


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 4), st.floats(-1, 2.5)), min_size=1, max_size=20))
def test_weights_reproduce_every_bilinear_function(where: list[tuple[float, float]]) -> None:
    lattice = uneven()
    u, v = np.array(where).T
    nodes, weights = node_weights(lattice, u, v)
    assert (nodes % 3 == 0).all()  # of the surface layer
    assert (weights >= 0).all()
    assert weights.sum(axis=1) == pytest.approx(1.0, rel=1e-14)
    x = lattice.nodes[nodes]
    assert np.einsum("nk,nkc->nc", weights, x)[:, :2] == pytest.approx(np.stack([u, v], axis=1), abs=1e-12)


def test_weights_around_the_seam() -> None:
    lattice = uneven(wrap=(True, False))
    # between the last node at u = 4 and the first at u = 0 = 5
    for u in (4.25, -0.75, 9.25):
        nodes, weights = node_weights(lattice, [u], [0.0])
        share = np.zeros(len(lattice.nodes))
        np.add.at(share, nodes[0], weights[0])
        share = share.reshape(lattice.shape)
        assert share[4, 1, 0] == pytest.approx(0.75)
        assert share[0, 1, 0] == pytest.approx(0.25)


def test_weights_beside_a_hole() -> None:
    columns = np.ones((4, 3), dtype=bool)
    columns[0] = columns[1] = False
    lattice = uneven(cell_active=columns)
    active = lattice.active.reshape(lattice.shape)[:, 0, 0]
    assert active.tolist() == [False, False, True, True, True]
    nodes, weights = node_weights(lattice, [1.2, 0.2], [0.0, 0.4])
    # between an inactive and an active row: the active one takes all; far inside the hole: the nearest active node
    assert (weights[~lattice.active[nodes]] == 0.0).all()
    assert weights.sum(axis=1) == pytest.approx(1.0)
    assert nodes[1, 0] == (2 * 4 + 1) * 3


def test_parameters_that_are_not_finite_are_refused() -> None:
    with pytest.raises(InputError, match="not finite"):
        node_weights(uneven(), [math.nan], [0.0])


def test_contact_stiffness() -> None:
    clay, foam = PRESETS["clay"], PRESETS["foam"]
    k = contact_stiffness(clay, 3.0, 1.5, MM)
    # STIFFNESS_RATIO E / spacing, and the same physical stiffness in metres: 1 N/mm^3 = 1e9 N/m^3
    assert k == pytest.approx(STIFFNESS_RATIO * 3e5 * 1e-6 / 1.5)
    assert contact_stiffness(clay, 3e-3, 1.5e-3, 1.0) == pytest.approx(k * 1e9)
    both = contact_stiffness([clay, foam], 3.0, 1.5, MM)
    assert 1 / both == pytest.approx(1 / k + 1 / contact_stiffness(foam, 3.0, 1.5, MM))


def test_contact_law_at_rest(slab: Callable[..., Lattice], contact: Callable[..., ContactLoad]) -> None:
    """A held surface pressed by a still tool: force = area * k_n * depth, on all nodes by their weights."""
    lattice = slab(4, 4, 1, anchored=np.ones((4, 4, 2), dtype=bool))
    state = LatticeState.at_rest(lattice)
    nodes, weights = node_weights(lattice, [0.3, 1.7, 2.2], [0.9, 1.1, 2.6])
    depth = np.array([0.1, 0.2, -0.1])
    load = contact(nodes, weights, depth=depth, area=2.0, stiffness=3.0, damping=0.5, friction=0.4)
    result = advance(lattice, state, load, 1e-4)
    expected = np.zeros((3, 3))
    expected[:, 2] = -2.0 * 3.0 * np.maximum(depth, 0.0)
    assert result.mean_force == pytest.approx(expected, rel=1e-12)
    assert result.end_force == pytest.approx(expected, rel=1e-12)
    assert result.depth == pytest.approx(depth)


def test_a_moving_plane_presses_deeper(slab: Callable[..., Lattice], contact: Callable[..., ContactLoad]) -> None:
    """Against a held surface: depth grows by -n . v_tool dt, damping adds c_n times the rate, and never pulls."""
    lattice = slab(4, 4, 1, anchored=np.ones((4, 4, 2), dtype=bool))
    nodes, weights = node_weights(lattice, [1.2], [1.3])
    down = contact(nodes, weights, depth=0.1, velocity=(0.0, 0.0, -50.0), stiffness=3.0, damping=0.01)
    result = advance(lattice, LatticeState.at_rest(lattice), down, 1e-3)
    assert result.depth == pytest.approx(0.15)
    assert result.end_force[0, 2] == pytest.approx(-(3.0 * 0.15 + 0.01 * 50.0))
    up = contact(nodes, weights, depth=0.01, velocity=(0.0, 0.0, 50.0), stiffness=3.0, damping=0.01)
    result = advance(lattice, LatticeState.at_rest(lattice), up, 1e-3)
    assert result.depth == pytest.approx(-0.04)
    assert (result.mean_force[:, 2] == 0.0).all()


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_impulses_balance_momentum(
    slab: Callable[..., Lattice], contact: Callable[..., ContactLoad], mu: float
) -> None:
    """A free lattice: its momentum grows by exactly the contact forces times the time, in many dense, skew, moving
    contacts.
    """
    rng = np.random.default_rng(3)
    lattice = slab(7, 6, 2, move=lambda p: p + 0.15 * rng.uniform(-1, 1, p.shape))
    state = LatticeState.at_rest(lattice)
    state.velocity[:] = rng.normal(size=state.velocity.shape) * 5.0
    n = 200
    nodes, weights = node_weights(lattice, rng.uniform(0, 6, n), rng.uniform(0, 5, n))
    load = contact(
        nodes, weights, depth=0.05 * rng.uniform(-1, 1, n), area=0.2, stiffness=20.0, damping=1e-3, friction=mu
    )
    load.normal[:] = rng.normal(size=(n, 3)) * 0.3 + np.array([0.0, 0.0, 1.0])
    load.normal[:] /= np.linalg.norm(load.normal, axis=1)[:, None]
    load.velocity[:] = rng.normal(size=(n, 3)) * 20.0
    before = lattice.mass @ state.velocity
    scale = lattice.mass @ np.abs(state.velocity)
    dt = 2e-4
    result = advance(lattice, state, load, dt)
    change = lattice.mass @ state.velocity - before
    given = result.mean_force.sum(axis=0) * dt
    assert np.abs(given).max() > 1e-2 * scale.max()
    assert change == pytest.approx(given, abs=1e-12 * scale.max())


def sliding(
    slab: Callable[..., Lattice], contact: Callable[..., ContactLoad], speed: float, mu: float, steps: int, dt: float
) -> list[np.ndarray]:
    """A flat plate pressed 2 % into a slab on its base, then drawn along x: total force of every step."""
    lattice = slab(6, 6, 3, material=Material(1e6, 1000.0, damping=0.5), base=True)
    state = LatticeState.at_rest(lattice)
    u, v = (x.ravel() for x in np.meshgrid(np.linspace(0.1, 4.9, 13), np.linspace(0.1, 4.9, 13)))
    nodes, weights = node_weights(lattice, u, v)
    forces = []
    for step in range(steps):
        x = np.einsum("nk,nkc->nc", weights, state.x[nodes])
        load = contact(
            nodes,
            weights,
            depth=x[:, 2] + 0.06,
            area=25.0 / 169.0,
            velocity=(speed if step >= 20 else 0.0, 0.0, 0.0),
            stiffness=20.0,
            damping=1e-3,
            friction=mu,
        )
        forces.append(advance(lattice, state, load, dt).mean_force.sum(axis=0))
    return forces


@pytest.mark.parametrize("mu", [0.1, 0.4])
def test_slip_at_mu(slab: Callable[..., Lattice], contact: Callable[..., ContactLoad], mu: float) -> None:
    """Drawn far enough, every contact slips and friction is mu times the normal force."""
    forces = sliding(slab, contact, 100.0, mu, 60, 1e-3)
    assert forces[19][0] == pytest.approx(0.0, abs=1e-6 * abs(forces[19][2]))
    assert forces[-1][0] / -forces[-1][2] == pytest.approx(mu, rel=0.02)


def test_stick_below_mu(slab: Callable[..., Lattice], contact: Callable[..., ContactLoad]) -> None:
    """Drawn a little and stopped, the contact sticks: the force is elastic, below mu N, and does not creep away."""
    lattice = slab(6, 6, 3, material=Material(1e6, 1000.0, damping=0.5), base=True)
    state = LatticeState.at_rest(lattice)
    u, v = (x.ravel() for x in np.meshgrid(np.linspace(0.1, 4.9, 13), np.linspace(0.1, 4.9, 13)))
    nodes, weights = node_weights(lattice, u, v)
    held = []
    for step in range(140):
        x = np.einsum("nk,nkc->nc", weights, state.x[nodes])
        load = contact(
            nodes,
            weights,
            depth=x[:, 2] + 0.06,
            area=25.0 / 169.0,
            velocity=(1.0 if 20 <= step < 25 else 0.0, 0.0, 0.0),
            stiffness=20.0,
            damping=1e-3,
            friction=0.5,
        )
        result = advance(lattice, state, load, 1e-3)
        force = result.mean_force.sum(axis=0)
        tangential = np.linalg.norm(result.mean_force[:, :2], axis=1)
        assert (tangential <= 0.5 * -result.mean_force[:, 2] + 1e-9).all()
        held.append(force[0])
    # 0.005 mm over 3 mm of height in shear, G = 0.4 E: tau = 0.4 * 0.005 / 3 N/mm^2 on 25 mm^2, softer at the free
    # edges
    assert 0.5 < held[60] / (0.4 * 0.005 / 3.0 * 25.0) < 1.0
    assert held[-1] == pytest.approx(held[60], rel=0.02)


def test_force_does_not_depend_on_how_finely_the_contact_is_sampled(
    slab: Callable[..., Lattice], contact: Callable[..., ContactLoad]
) -> None:
    """A cylinder pressed into clay: twice the points along each direction change the force by less than 5 %, three
    times.
    """
    totals = []
    for points in (15, 30, 60, 120):
        lattice = slab(11, 6, 3, material=PRESETS["clay"], base=True)
        state = LatticeState.at_rest(lattice)
        u, v = (
            x.ravel()
            for x in np.meshgrid((np.arange(points) + 0.5) / points * 10, (np.arange(points) + 0.5) / points * 5)
        )
        nodes, weights = node_weights(lattice, u, v)
        stiffness = contact_stiffness(PRESETS["clay"], 3.0, 1.0, MM)
        force = np.zeros(3)
        for step in range(25):
            bottom = -0.02 * step
            x = np.einsum("nk,nkc->nc", weights, state.x[nodes])
            out = np.array([5.0, 0.0, bottom + 6.0]) - x * np.array([1.0, 0.0, 1.0])
            distance = np.linalg.norm(out, axis=1)
            near = distance < 6.2
            load = contact(
                nodes[near],
                weights[near],
                depth=6.0 - distance[near],
                area=50.0 / points**2,
                velocity=(0.0, 0.0, -20.0),
                stiffness=stiffness,
                damping=contact_damping(PRESETS["clay"], stiffness, lattice),
                friction=0.4,
            )
            load.normal[:] = out[near] / distance[near, None]
            force = advance(lattice, state, load, 1e-3).mean_force.sum(axis=0)
        totals.append(force[2])
    assert np.abs(np.diff(totals) / np.array(totals[1:])).max() < 0.05


def test_sphere_on_a_layer(
    slab: Callable[..., Lattice],
    contact: Callable[..., ContactLoad],
    on_a_bonded_layer: Callable[[float], float],
) -> None:
    """Hertz, with the correction for a layer bonded to a rigid base (Dimitriadis et al. 2002, eq. 11): within 6 %."""
    material = Material(1e6, 1000.0, damping=0.15)
    nodes_across, layers, radius, press = 25, 10, 40.0, 0.25
    lattice = slab(nodes_across, nodes_across, layers, material=material, base=True)
    state = LatticeState.at_rest(lattice)
    middle, reach = (nodes_across - 1) / 2, math.sqrt(radius * press)
    grid = middle + (np.arange(-18, 18) + 0.5) / 3
    u, v = (x.ravel() for x in np.meshgrid(grid, grid, indexing="ij"))
    nodes, weights = node_weights(lattice, u, v)
    stiffness = contact_stiffness(material, layers, 1.0, MM)
    dt = 2 * layers / (math.sqrt(1.2e6 / 1000.0) * 1e3)
    for step in range(40):
        bottom = -press * min(1.0, step / 25)
        out = np.array([middle, middle, bottom + radius]) - np.einsum("nk,nkc->nc", weights, state.x[nodes])
        distance = np.linalg.norm(out, axis=1)
        load = contact(
            nodes,
            weights,
            depth=radius - distance,
            area=1 / 9,
            velocity=(0.0, 0.0, -press / 25 / dt if step < 25 else 0.0),
            stiffness=stiffness,
            damping=contact_damping(material, stiffness, lattice),
        )
        load.normal[:] = out / distance[:, None]
        result = advance(lattice, state, load, dt)
    hertz = 4 / 3 / (1 - 0.25**2) * math.sqrt(radius) * press**1.5
    layer = on_a_bonded_layer(reach / layers)
    assert -result.mean_force[:, 2].sum() == pytest.approx(hertz * layer, rel=0.06)
    # nothing is left of the ball inside the surface
    assert result.depth.max() < 0.02 * press
