"""Contact between two deformable bodies: shared displacement, bars in series, balance, energy, stick and slip, stability."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cadsculpt.physics import implicit, tangent
from cadsculpt.physics.assembly import Assembly, assemble
from cadsculpt.physics.explicit import ContactLoad, LatticeState, StepForces, advance
from cadsculpt.physics.forces import contact_damping, contact_stiffness, node_weights
from cadsculpt.physics.implicit import advance_implicit
from cadsculpt.physics.lattice import Lattice, build_lattice
from cadsculpt.physics.material import Material
from cadsculpt.physics.measures import elastic_energy, kinetic_energy
from cadsculpt.physics.numbering import Numbering
from cadsculpt.physics.tangent import solve

Array = NDArray[np.float64]
Step = Callable[..., StepForces]

SOFT = Material(1e6, 1000.0, damping=0.5)
BOTH = pytest.mark.parametrize("step", [advance, advance_implicit])


def block(
    nu: int,
    nv: int,
    layers: int,
    *,
    material: Material = SOFT,
    down: bool = False,
    at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    step: float = 1.0,
    base: bool = True,
) -> Lattice:
    """A block of cubes below its surface at z = 0, or above it, looking `down`; moved by `at`."""
    x, y = np.meshgrid(np.arange(nu) * step, np.arange(nv) * step, indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=-1) + np.array(at)
    anchored = np.zeros((nu, nv, layers + 1), dtype=bool)
    anchored[:, :, -1] = base
    return build_lattice(
        points, np.broadcast_to([0.0, 0.0, 1.0 if down else -1.0], points.shape), np.arange(nu) * step, np.arange(nv) * step,
        thickness=layers * step, layers=layers, material=material, anchored=anchored, metres_per_unit=1e-3,
    )  # fmt: skip


def meeting(
    pair: Assembly,
    state: LatticeState,
    across: tuple[int, int],
    *,
    stiffness: float,
    damping: float = 0.0,
    friction: float = 0.0,
) -> ContactLoad:
    """Contacts of part 0's surface (looking up) with part 1's above it, in a grid of `across` points over part 0's."""
    lower, upper = pair.parts
    grid = [lower.u[-1] * (np.arange(n) + 0.5) / n for n in across]
    u, v = (t.ravel() for t in np.meshgrid(*grid, indexing="ij"))
    area = lower.u[-1] * lower.v[-1] / len(u)
    nodes, weights = node_weights(lower, u, v)
    below = np.einsum("nk,nkc->nc", weights, state.x[nodes])
    # bodies of like material bulge alike: a point meets the one that it stood below, but for how far the base has gone
    shift = (pair.part_state(state, 1).x - upper.nodes)[upper.inverse_mass == 0.0]
    at = (
        np.einsum("nk,nkc->nc", weights, lower.nodes[nodes])
        - upper.nodes[0]
        - (shift.mean(axis=0) if len(shift) else 0.0)
    )
    others, other_weights = node_weights(upper, at[:, 0], at[:, 1])
    others = others + pair.starts[1]
    above = np.einsum("nk,nkc->nc", other_weights, state.x[others])
    one = np.ones(len(u))
    return ContactLoad(
        nodes, weights, np.tile([0.0, 0.0, 1.0], (len(u), 1)), (below - above)[:, 2], area * one, np.zeros((len(u), 3)),
        stiffness * one, damping * one, friction * one, others, other_weights,
    )  # fmt: skip


def pressed(
    pair: Assembly, step: Step, depth: float, *, steps: int = 30, dt: float = 1e-3, drag: float = 0.0, **law: Any
) -> tuple[LatticeState, list[StepForces]]:
    """The upper body's base goes down by `depth` in the first half of the steps, and along x by `drag` in the second."""
    state = LatticeState.at_rest(pair.lattice)
    upper = np.flatnonzero(pair.lattice.anchored)
    upper = upper[upper >= pair.starts[1]]
    results = []
    for k in range(steps):
        first = k < steps // 2
        state.velocity[upper] = (0.0 if first else drag, 0.0, -depth if first else 0.0)
        state.velocity[upper] /= dt * (steps // 2)
        load = meeting(pair, state, (9, 9), **law)
        result = step(pair.lattice, state, load, dt)
        results.append(replace(result, mean_force=result.mean_force.copy(), depth=result.depth.copy()))
    return state, results


def law(material: Material = SOFT, friction: float = 0.0) -> dict[str, float]:
    lattice = block(2, 2, 1, material=material)
    stiffness = contact_stiffness([material, material], 3.0, 1.0, 1e-3)
    return {"stiffness": stiffness, "damping": contact_damping(material, stiffness, lattice), "friction": friction}


@BOTH
def test_two_like_blocks_share_the_displacement(step: Step) -> None:
    pair = assemble([block(4, 4, 3), block(4, 4, 3, down=True)])
    state, results = pressed(pair, step, 0.2, steps=60, **law())
    middle = [pair.part_state(state, k).x.reshape(4, 4, 4, 3)[:, :, 0, 2] for k in (0, 1)]
    assert middle[0].mean() == pytest.approx(-0.1, abs=2e-3)
    assert middle[1].mean() == pytest.approx(-0.1, abs=2e-3)
    # alike to the last digit that the impulses settle to: the mirror image
    assert middle[0] + 0.1 == pytest.approx(-(middle[1] + 0.1), abs=2e-6)
    assert results[-1].depth.max() < 0.01 * 0.2


@BOTH
def test_bars_in_series(step: Step) -> None:
    """Moduli 1 and 3, lengths 6 and 6: the same as one bar of two materials, and F = A D / (L1 / E1 + L2 / E2)."""
    stiff = replace(SOFT, youngs_modulus=3e6)
    pair = assemble([block(3, 3, 6, material=stiff), block(3, 3, 6, down=True)])
    state, results = pressed(pair, step, 0.1, steps=60, dt=2e-3, **law())
    force = -results[-1].mean_force[:, 2].sum()
    assert force == pytest.approx(4.0 * 0.1 / (6.0 / 3.0 + 6.0), rel=0.05)
    both_ends = np.zeros((3, 3, 13), dtype=bool)
    both_ends[:, :, [0, -1]] = True
    grid = np.stack([*np.meshgrid(np.arange(3.0), np.arange(3.0), indexing="ij"), np.full((3, 3), 6.0)], axis=-1)
    cells = np.zeros((2, 2, 12), dtype=np.int64)
    cells[:, :, 6:] = 1
    bar = build_lattice(
        grid, np.broadcast_to([0.0, 0.0, -1.0], grid.shape), np.arange(3.0), np.arange(3.0), thickness=12.0, layers=12,
        material=[SOFT, stiff], cell_material=cells, anchored=both_ends, metres_per_unit=1e-3,
    )  # fmt: skip
    one = LatticeState.at_rest(bar)
    one.velocity[bar.anchored & (bar.nodes[:, 2] > 5.0), 2] = -0.1
    advance_implicit(bar, one, None, 1.0, quasi_static=True)
    meets = one.x.reshape(3, 3, 13, 3)[:, :, 6, 2].mean()
    assert pair.part_state(state, 0).x.reshape(3, 3, 7, 3)[:, :, 0, 2].mean() == pytest.approx(meets, rel=0.04)
    assert force == pytest.approx(2 * elastic_energy(bar, one) / 0.1, rel=0.04)


def test_two_caps_press_as_hertz_says(on_a_bonded_layer: Callable[[float], float]) -> None:
    """Two like spherical caps on rigid backs: by symmetry each is pressed by a plane, half the way; within 5 %."""
    radius, layers, across, way = 40.0, 8, 23, 0.5
    middle = (across - 1) / 2
    x, y = np.meshgrid(np.arange(float(across)), np.arange(float(across)), indexing="ij")
    height = -((x - middle) ** 2 + (y - middle) ** 2) / (2 * radius)
    anchored = np.zeros((across, across, layers + 1), dtype=bool)
    anchored[:, :, -1] = True
    caps = [
        build_lattice(
            np.stack([x, y, sign * height], axis=-1), np.broadcast_to([0.0, 0.0, -sign], (across, across, 3)), x[:, 0], y[0],
            thickness=float(layers), layers=layers, material=SOFT, anchored=anchored, metres_per_unit=1e-3,
        )
        for sign in (1.0, -1.0)
    ]  # fmt: skip
    pair = assemble(caps)
    state = LatticeState.at_rest(pair.lattice)
    grid = middle + (np.arange(-15, 15) + 0.5) / 3
    u, v = (t.ravel() for t in np.meshgrid(grid, grid, indexing="ij"))
    nodes, weights = node_weights(caps[0], u, v)
    others = nodes + pair.starts[1]
    one, stiffness = np.ones(len(u)), contact_stiffness([SOFT, SOFT], layers, 1.0, 1e-3)
    upper = pair.lattice.anchored & (np.arange(len(state.x)) >= pair.starts[1])
    for _ in range(3):
        state.velocity[:] = 0.0
        state.velocity[upper, 2] = -way / 3
        below, above = (np.einsum("nk,nkc->nc", weights, state.x[side]) for side in (nodes, others))
        load = ContactLoad(
            nodes, weights, np.tile([0.0, 0.0, 1.0], (len(u), 1)), (below - above)[:, 2], one / 9, np.zeros((len(u), 3)),
            stiffness * one, 0 * one, 0 * one, others, weights,
        )  # fmt: skip
        result = advance_implicit(pair.lattice, state, load, 1.0, quasi_static=True)
    half = (way - result.depth.max()) / 2
    hertz = 4 / 3 / (1 - 0.25**2) * math.sqrt(radius) * half**1.5
    expected = hertz * on_a_bonded_layer(math.sqrt(radius * half) / layers)
    assert -result.end_force[:, 2].sum() == pytest.approx(expected, rel=0.05)


def thrown(seed: int, *, friction: float, damping: float = 0.0) -> tuple[Assembly, LatticeState]:
    material = Material(1e6, 1000.0, damping=damping)
    pair = assemble(
        [
            block(5, 5, 3, material=material, base=False),
            block(4, 4, 3, material=material, base=False, down=True, at=(0.6, 0.4, 0.05)),
        ]
    )
    state = LatticeState.at_rest(pair.lattice)
    rng = np.random.default_rng(seed)
    pair.part_state(state, 0).velocity[:] = (30.0, -20.0, 200.0)
    pair.part_state(state, 1).velocity[:] = (-10.0, 40.0, -300.0)
    state.velocity += 5.0 * rng.normal(size=state.velocity.shape)
    return pair, state


@pytest.mark.parametrize("friction", [0.0, 0.5])
@BOTH
def test_two_free_bodies_collide(step: Step, friction: float) -> None:
    """Momentum stays, energy does not grow, each body's momentum changes by the forces; they part again."""
    pair, state = thrown(1, friction=friction)
    mass = pair.lattice.mass
    before = mass @ state.velocity
    scale = float(mass @ np.linalg.norm(state.velocity, axis=1))
    start = energy = kinetic_energy(pair.lattice, state)
    acted = 0.0
    for _ in range(40):
        load = meeting(pair, state, (11, 11), **law(friction=friction))
        lower = pair.parts[0].mass @ pair.part_state(state, 0).velocity
        dt = 5e-5
        result = step(pair.lattice, state, load, dt)
        given = result.mean_force.sum(axis=0) * dt
        acted = max(acted, float(np.abs(given).max()))
        exact = 1e-12 if step is advance else 1e-7
        assert mass @ state.velocity == pytest.approx(before, abs=exact * scale)
        change = pair.parts[0].mass @ pair.part_state(state, 0).velocity - lower
        assert change == pytest.approx(given, abs=exact * scale)
        energy = kinetic_energy(pair.lattice, state) + elastic_energy(pair.lattice, state)
        # eq. 6 and 7 hold the energy within the share of the sub-step, not to the digit
        assert energy < 1.02 * start
    assert acted > 1e-2 * scale
    assert energy < start
    speeds = [
        float(part.mass @ pair.part_state(state, k).velocity[:, 2] / part.mass.sum())
        for k, part in enumerate(pair.parts)
    ]
    assert 0.0 < speeds[1] - speeds[0] < 500.0


@pytest.mark.parametrize("mu", [0.1, 0.4])
@BOTH
def test_slip_at_mu(step: Step, mu: float) -> None:
    pair = assemble([block(6, 6, 2), block(8, 6, 2, down=True, at=(-1.0, 0.0, 0.0))])
    _, results = pressed(pair, step, 0.04, steps=40, drag=0.4, **law(friction=mu))
    half, end = (results[k].mean_force.sum(axis=0) for k in (19, -1))
    assert abs(half[0]) < 1e-2 * abs(half[2])
    assert end[0] / -end[2] == pytest.approx(mu, rel=0.02)
    sideways = np.linalg.norm(results[-1].mean_force[:, :2], axis=1)
    assert (sideways <= mu * -results[-1].mean_force[:, 2] * (1 + 1e-6) + 1e-12).all()


@BOTH
def test_stick_below_mu(step: Step) -> None:
    """Sheared a little, two blocks that stick are one block of both heights: half the force of one block alone."""
    pair = assemble([block(6, 6, 3), block(6, 6, 3, down=True)])
    _, results = pressed(pair, step, 0.06, steps=80, dt=5e-4, drag=0.01, **law(friction=0.8))
    whole = block(6, 6, 6, at=(0.0, 0.0, 3.0))
    top = whole.nodes[:, 2] > 2.99
    held = replace(whole, anchored=whole.anchored | top, inverse_mass=np.where(top, 0.0, whole.inverse_mass))
    state = LatticeState.at_rest(held)
    forces = []
    for shear in (0.0, 0.01):
        state.velocity[:] = 0.0
        state.velocity[top] = (shear, 0.0, 0.0 if shear else -0.06)
        advance_implicit(held, state, None, 1.0, quasi_static=True)
        forces.append(elastic_energy(held, state))
    shear = 2 * (forces[1] - forces[0]) / 0.01
    sideways = results[-1].mean_force.sum(axis=0)[0]
    assert sideways == pytest.approx(shear, rel=0.05)
    assert sideways < 0.8 * -results[-1].mean_force[:, 2].sum()


@BOTH
def test_a_held_other_side_is_as_good_as_a_rigid_one(step: Step) -> None:
    """The upper body anchored throughout, against the same plane given as rigid: forces but for the lumping."""
    totals = []
    for rigid in (False, True):
        upper = block(6, 6, 1, down=True)
        upper = replace(upper, anchored=np.ones_like(upper.anchored), inverse_mass=np.zeros_like(upper.mass))
        pair = assemble([block(6, 6, 3), upper])
        state = LatticeState.at_rest(pair.lattice)
        mine = pair.nodes_of(1)
        for k in range(60):
            state.velocity[mine] = (0.0, 0.0, -5.0 if k < 30 else 0.0)
            load = meeting(pair, state, (11, 11), **law())
            if rigid:
                load = replace(
                    load, other_nodes=None, other_weights=None, velocity=np.tile(state.velocity[mine][0], (121, 1))
                )
            result = step(pair.lattice, state, load, 1e-3)
        totals.append(result.mean_force.sum(axis=0)[2])
    assert totals[0] == pytest.approx(totals[1], rel=2e-3)


@BOTH
def test_rigid_and_deformable_contacts_in_one_step(step: Step) -> None:
    """Half the contacts meet a rigid plane where the other body would be: as if all met it, or as if all met the body."""
    upper = block(5, 5, 1, down=True)
    upper = replace(upper, anchored=np.ones_like(upper.anchored), inverse_mass=np.zeros_like(upper.mass))
    pair = assemble([block(5, 5, 3), upper])
    ends = []
    for share in (1, 2):
        state = LatticeState.at_rest(pair.lattice)
        for _ in range(20):
            state.velocity[pair.nodes_of(1)] = (1.0, 0.0, -5.0)
            load = meeting(pair, state, (8, 8), **law(friction=0.3))
            assert load.other_weights is not None
            load.other_weights[::share] *= share == 1
            load.velocity[::share] = (1.0, 0.0, -5.0) if share > 1 else 0.0
            step(pair.lattice, state, load, 1e-3)
        ends.append(state.x.copy())
    assert ends[1] == pytest.approx(ends[0], abs=1e-8)


@pytest.mark.parametrize("factor", [1e-2, 1.0, 1e2, 1e6])
def test_no_stiffness_makes_the_impulses_unstable(factor: float) -> None:
    pair = assemble([block(5, 5, 3, material=replace(SOFT, damping=0.02)), block(5, 5, 3, down=True)])
    how = law(friction=0.6)
    for name in ("stiffness", "damping"):
        how[name] *= factor
    state, results = pressed(pair, advance, 0.1, steps=40, drag=0.2, **how)
    # the base moves at 10 mm/s; sound travels at 34 m/s
    assert max(result.max_speed for result in results) < 100.0
    assert -results[19].mean_force[:, 2].sum() < 1.5 * 16.0 * 0.1 / 6.0 * 1.2
    assert np.abs(state.x - pair.lattice.nodes).max() < 0.4


@pytest.mark.parametrize("cut", [math.inf, 0.0], ids=["band", "gradients"])
def test_the_tangent_of_pairs_is_the_derivative_of_their_forces(
    residual_along: Callable[..., Array], monkeypatch: pytest.MonkeyPatch, cut: float
) -> None:
    """Two free, damped bodies that press and stick: contact in 8 nodes, and drag that does not feel rigid motion."""
    monkeypatch.setattr(tangent, "LARGEST_BAND", cut)
    monkeypatch.setattr(tangent, "CG_TOLERANCE", 1e-10)
    rng = np.random.default_rng(4)
    pair, state = thrown(2, friction=0.0, damping=0.4)
    load = meeting(pair, state, (7, 7), stiffness=2.0, damping=0.01)
    load.depth[:] = 0.3
    problem = implicit._Problem.at(pair.lattice, state, load, load.depth, 1e-2, quasi_static=False)
    assert problem.nodes.shape[1] == 8
    assert problem.modes.any()
    duals = implicit._Duals(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros_like(load.normal))
    here = implicit._balance(problem, 1.02 * state.x + 1e-3 * rng.normal(size=state.x.shape), duals)
    right = rng.normal(size=state.x.shape)
    d = solve(pair.lattice, Numbering.of(pair.lattice, problem.nodes, state.x), here.tangent, right)
    assert d is not None
    assert -residual_along(problem, here.x, d, duals) == pytest.approx(right, abs=5e-5 * np.abs(right).max())


def test_two_blocks_that_meet_stay_a_narrow_band() -> None:
    """Above one another they are numbered together: the band is not as wide as a body."""
    pair = assemble([block(30, 6, 3), block(30, 6, 3, down=True)])
    load = meeting(pair, LatticeState.at_rest(pair.lattice), (60, 12), stiffness=1.0)
    nodes = implicit._both_sides(pair.lattice, load)[0]
    assert Numbering.of(pair.lattice, nodes).width < 4 * 2 * 6 * 3


def test_two_runs_of_a_pair_give_the_same_bytes() -> None:
    ends = []
    for _ in range(2):
        pair = assemble([block(5, 5, 3), block(5, 5, 3, down=True)])
        for step in (advance, advance_implicit):
            state, results = pressed(pair, step, 0.1, steps=6, drag=0.2, **law(friction=0.6))
            ends.append((state.x.tobytes(), results[-1].mean_force.tobytes()))
    assert ends[:2] == ends[2:]
