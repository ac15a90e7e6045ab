"""Implicit integration: closed formulas, the order of the rule, the tangent by differences, contact, and its honest end."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse.linalg as spl
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from cadsculpt.errors import InputError, SimulationError
from cadsculpt.physics import implicit, tangent
from cadsculpt.physics.explicit import ContactLoad, LatticeState, advance, stable_substep
from cadsculpt.physics.forces import contact_damping, contact_stiffness, node_weights
from cadsculpt.physics.implicit import advance_implicit
from cadsculpt.physics.lattice import Lattice, build_lattice
from cadsculpt.physics.material import PRESETS, Material
from cadsculpt.physics.measures import elastic_energy, kinetic_energy, nodal_plastic_set
from cadsculpt.physics.numbering import Numbering
from cadsculpt.physics.tangent import Tangent, solve

Array = NDArray[np.float64]


def tube(**options: Any) -> Lattice:
    """A closed tube on a held core."""
    nu, nv = 14, 4
    angle = 2 * math.pi * np.arange(nu) / nu
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)[:, None, :] * np.ones((1, nv, 1))
    points = 6 * out
    points[..., 2] = 2.5 * np.arange(nv)
    anchored = np.zeros((nu, nv, 3), dtype=bool)
    anchored[:, :, -1] = True
    return build_lattice(
        points, -out, angle, np.arange(nv, dtype=float), thickness=3.0, layers=2, material=Material(1e6, 1000.0),
        wrap=(True, False), period=(2 * math.pi, 0.0), anchored=anchored, metres_per_unit=1e-3, **options,
    )  # fmt: skip


def test_a_quasi_static_step_is_the_linear_solution(slab: Callable[..., Lattice], tangent: Any) -> None:
    """Small loads, one step: K^-1 f with K assembled spring by spring."""
    rng = np.random.default_rng(1)
    lattice = slab(6, 5, 3, base=True, move=lambda p: p + 0.2 * rng.uniform(-1, 1, p.shape))
    state = LatticeState.at_rest(lattice)
    force = 1e-7 * rng.normal(size=lattice.nodes.shape)
    result = advance_implicit(lattice, state, None, 1.0, quasi_static=True, external=force)
    assert result.substeps == 1
    free = np.flatnonzero(np.repeat(lattice.inverse_mass > 0.0, 3))
    expected = np.zeros(force.size)
    expected[free] = spl.spsolve(tangent(lattice)[free][:, free], force.ravel()[free])
    assert (state.x - lattice.nodes).ravel() == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())
    assert state.velocity == pytest.approx((state.x - lattice.nodes) / 1.0)


def test_one_mass_follows_backward_euler(chain: Callable[..., Lattice]) -> None:
    """(m / h^2 + gamma / h + k) x' = m (x / h^2 + v / h) + gamma x / h, step by step."""
    m, k, gamma, h = 0.02, 50.0, 8.0 * 0.02, 1e-3
    lattice = chain([1.0, m], [k], gamma=8.0)
    state = LatticeState.at_rest(lattice)
    state.x[1, 0] += 0.1
    x, v = 0.1, 0.0
    for _ in range(50):
        new = (m * (x / h**2 + v / h) + gamma * x / h) / (m / h**2 + gamma / h + k)
        x, v = new, (new - x) / h
        advance_implicit(lattice, state, None, h)
        assert state.x[1, 0] - 1.0 == pytest.approx(x, abs=1e-7)
        assert state.velocity[1, 0] == pytest.approx(v, abs=1e-4)


def test_it_converges_with_the_step_in_first_order(slab: Callable[..., Lattice]) -> None:
    """A slab that springs back, against the explicit rule in far smaller steps: half the step, half the error."""
    lattice = slab(4, 4, 2, base=True, material=Material(1e6, 1000.0, damping=0.3))
    push = 0.05 * (lattice.nodes[:, 2] + 2.0) / 2.0

    def at_the_end(step: Callable[[LatticeState], object]) -> Array:
        state = LatticeState.at_rest(lattice)
        state.x[:, 0] += push
        step(state)
        return state.x

    time = 20 * stable_substep(lattice)
    truth = at_the_end(lambda s: advance(lattice, s, None, time, substep=time / 40000))
    errors = []
    for count in (640, 1280, 2560):
        found = at_the_end(lambda s, n=count: advance_implicit(lattice, s, None, time, substep=time / n))  # type: ignore[misc]
        errors.append(float(np.abs(found - truth).max()))
    assert 1.7 < errors[0] / errors[1] < 2.3
    assert 1.7 < errors[1] / errors[2] < 2.3


@pytest.mark.parametrize("name", ["sheet steel", "aluminium", "clay"])
def test_long_steps_are_stable_and_lose_energy(slab: Callable[..., Lattice], name: str) -> None:
    """Steps a thousand times the explicit one: what was strained comes to rest, and never has more energy than before."""
    lattice = slab(6, 5, 2, base=True, material=PRESETS[name])
    state = LatticeState.at_rest(lattice)
    state.x[:, 0] += 0.3 * PRESETS[name].yield_strain * (lattice.nodes[:, 2] + 2.0)
    energies = [elastic_energy(lattice, state)]
    for _ in range(5):
        advance_implicit(lattice, state, None, 1000 * stable_substep(lattice))
        energies.append(elastic_energy(lattice, state) + kinetic_energy(lattice, state))
    assert energies == sorted(energies, reverse=True)
    assert energies[-1] < 1e-6 * energies[0]


@pytest.mark.parametrize("cut", [math.inf, 0.0], ids=["band", "gradients"])
@pytest.mark.parametrize("wrapped", [False, True])
def test_the_tangent_is_the_derivative_of_the_forces(
    slab: Callable[..., Lattice],
    contact: Callable[..., ContactLoad],
    residual_along: Callable[..., Array],
    monkeypatch: pytest.MonkeyPatch,
    wrapped: bool,
    cut: float,
) -> None:
    """K d = r solved, then the residual along d by differences: -r. Stretched lattices, pressing contacts, inertia."""
    monkeypatch.setattr(tangent, "LARGEST_BAND", cut)
    monkeypatch.setattr(tangent, "CG_TOLERANCE", 1e-10)
    rng = np.random.default_rng(2)
    lattice = tube() if wrapped else slab(5, 6, 2, base=True, move=lambda p: p + 0.2 * rng.uniform(-1, 1, p.shape))
    span = (lattice.u[-1], lattice.v[-1])
    nodes, weights = node_weights(lattice, rng.uniform(0, 1.1 * span[0], 20), rng.uniform(0, span[1], 20))
    load = contact(nodes, weights, depth=0.3, stiffness=2.0, damping=0.1, velocity=(1.0, 2.0, 0.5))
    load.normal[:] = rng.normal(size=load.normal.shape)
    load.normal[:] /= np.linalg.norm(load.normal, axis=1)[:, None]
    state = LatticeState.at_rest(lattice)
    state.x[lattice.inverse_mass > 0] *= 1.02
    problem = implicit._Problem.at(lattice, state, load, load.depth, 1e-2, quasi_static=False, external=None)
    duals = implicit._Duals(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros_like(load.normal))
    here = implicit._balance(problem, state.x + 1e-3 * rng.normal(size=state.x.shape), duals)
    right = np.where(problem.moves[:, None], rng.normal(size=state.x.shape), 0.0)
    d = solve(lattice, Numbering.of(lattice, nodes), here.tangent, right)
    assert d is not None
    assert -residual_along(problem, here.x, d, duals) == pytest.approx(right, abs=2e-5 * np.abs(right).max())


def test_a_matrix_that_is_not_definite_is_refused(
    slab: Callable[..., Lattice], monkeypatch: pytest.MonkeyPatch
) -> None:
    lattice = slab(4, 4, 2)  # nothing holds it, nothing has mass
    numbering = Numbering.of(lattice, np.zeros((0, 4), dtype=np.int64))
    none = np.zeros((0, 4), dtype=np.int64), np.zeros((0, 4)), np.zeros((0, 3, 3))
    blocks = np.zeros((13, len(lattice.nodes), 6))
    blocks[:, :, :3] = lattice.stiffness[:, :, None]
    right = np.random.default_rng(0).normal(size=lattice.nodes.shape)
    for cut in (math.inf, 0.0):
        monkeypatch.setattr(tangent, "LARGEST_BAND", cut)
        assert solve(lattice, numbering, Tangent(-blocks, np.zeros(len(right)), *none), right) is None
        assert solve(lattice, numbering, Tangent(blocks, np.ones(len(right)), *none), right) is not None


def test_contact_law_at_rest(slab: Callable[..., Lattice], contact: Callable[..., ContactLoad]) -> None:
    """As the explicit step: area * k_n * depth on a held surface; a plane that comes nearer presses deeper; none pulls."""
    lattice = slab(4, 4, 1, anchored=np.ones((4, 4, 2), dtype=bool))
    nodes, weights = node_weights(lattice, [0.3, 1.7, 2.2], [0.9, 1.1, 2.6])
    for velocity in (0.0, -50.0, 150.0):
        depth = np.array([0.1, 0.2, -0.1])
        load = contact(
            nodes, weights, depth=depth, area=2.0, stiffness=3.0, damping=0.01, velocity=(0.0, 0.0, velocity)
        )
        result = advance_implicit(lattice, LatticeState.at_rest(lattice), load, 1e-3)
        after = depth - 1e-3 * velocity
        expected = np.zeros((3, 3))
        expected[:, 2] = -2.0 * np.maximum(3.0 * after - 0.01 * velocity, 0.0)
        assert result.depth == pytest.approx(after)
        assert result.end_force == pytest.approx(expected, rel=1e-12)
        assert result.mean_force == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("quasi_static", [False, True])
def test_a_plane_drags_with_mu_times_its_pressure(
    slab: Callable[..., Lattice], contact: Callable[..., ContactLoad], quasi_static: bool
) -> None:
    lattice = slab(6, 6, 2, base=True)
    state = LatticeState.at_rest(lattice)
    u, v = (x.ravel() for x in np.meshgrid(np.arange(5) + 0.5, np.arange(5) + 0.5))
    nodes, weights = node_weights(lattice, u, v)
    depth = np.full(25, 0.01)
    for _ in range(6):
        load = contact(
            nodes, weights, depth=depth, stiffness=100.0, friction=0.3, velocity=(40.0, 30.0, 0.0), damping=1e-4
        )
        result = advance_implicit(lattice, state, load, 1e-2, quasi_static=quasi_static)
        depth = result.depth
    total = result.end_force.sum(axis=0)
    assert total[2] < 0
    assert math.hypot(total[0], total[1]) == pytest.approx(0.3 * -total[2], rel=1e-3)
    assert total[0] / total[1] == pytest.approx(4 / 3, rel=1e-3)


def pressed(
    slab: Callable[..., Lattice],
    contact: Callable[..., ContactLoad],
    material: Material,
    step: Callable[..., Any],
    **how: Any,
) -> tuple[Lattice, LatticeState, list[int]]:
    """A ball pressed half a millimetre into a slab of 2 mm and taken away again; the state at the end."""
    lattice = slab(11, 11, 2, base=True, material=material)
    state = LatticeState.at_rest(lattice)
    u, v = (x.ravel() for x in np.meshgrid(*[(np.arange(30) + 0.5) / 3] * 2))
    nodes, weights = node_weights(lattice, u, v)
    stiffness = contact_stiffness(material, 2.0, 1.0, 1e-3)
    height, cuts, dt, parts = 5.0, [], how.pop("dt", 4e-3), how.pop("parts", 1)
    dt /= parts
    for speed in np.repeat([-0.1, -0.1, -0.1, -0.1, -0.1, 0.4, 0.4, 0.4, 0.0, 0.0], parts) / parts:
        out = np.array([5.0, 5.0, height]) - np.einsum("nk,nkc->nc", weights, state.x[nodes])
        distance = np.linalg.norm(out, axis=1)
        load = contact(
            nodes, weights, depth=5.0 - distance, area=1 / 9, velocity=(0.0, 0.0, speed / dt), stiffness=stiffness,
            damping=contact_damping(material, stiffness, lattice), friction=material.friction,
        )  # fmt: skip
        load.normal[:] = out / distance[:, None]
        cuts.append(step(lattice, state, load, dt, **how).substeps)
        height += speed
    return lattice, state, cuts


@pytest.mark.parametrize(("friction", "share"), [(0.0, 0.01), (0.4, 0.02)])
def test_the_final_shape_of_clay_is_that_of_the_explicit_rule(
    slab: Callable[..., Lattice], contact: Callable[..., ContactLoad], friction: float, share: float
) -> None:
    """Pressed slowly: at 25 mm/s the clay's own waves leave their mark, 3 % of the dent."""
    clay = replace(PRESETS["clay"], friction=friction)
    _, explicit, _ = pressed(slab, contact, clay, advance, dt=0.04, parts=4)
    for quasi_static in (False, True):
        how = {"quasi_static": quasi_static, "dt": 0.04, "parts": 4}
        lattice, state, _ = pressed(slab, contact, clay, advance_implicit, **how)
        dent = np.linalg.norm(explicit.x - lattice.nodes, axis=1).max()
        assert dent > 0.2
        assert np.linalg.norm(state.x - explicit.x, axis=1).max() < share * dent


def test_sheet_steel_takes_long_steps(slab: Callable[..., Lattice], contact: Callable[..., ContactLoad]) -> None:
    """Half a millimetre in five steps, far beyond yield, where the explicit rule would need 1e5: it keeps the dent."""
    lattice, state, cuts = pressed(slab, contact, PRESETS["sheet steel"], advance_implicit, dt=0.05)
    assert 0.05 * len(cuts) / stable_substep(lattice) > 1e5
    assert sum(cuts) < 100
    assert (lattice.nodes - state.x)[:, 2].max() > 0.3
    assert nodal_plastic_set(lattice, state).max() > 0.05


def test_a_compressed_column_buckles(slab: Callable[..., Lattice]) -> None:
    """Held at both ends and shortened by three times the Euler strain, with a slight push: it bows out as it must."""
    ends = np.zeros((37, 7, 4), dtype=bool)
    ends[[0, -1]] = True
    lattice = slab(37, 7, 3, steps=(2 / 3, 1 / 3, 1 / 3), anchored=ends)
    state = LatticeState.at_rest(lattice)
    force = np.zeros((37, 7, 4, 3))
    force[18, :, :, 2] = 1e-6
    shortened = 0.4
    for _ in range(4):
        state.velocity[:] = 0.0
        state.velocity[-28:, 0] = -shortened / 4
        advance_implicit(lattice, state, None, 1.0, quasi_static=True, external=force.reshape(-1, 3))
    bow = (state.x - lattice.nodes).reshape(37, 7, 4, 3)[18, ..., 2].mean()
    # the shape (1 - cos) / 2 of amplitude A shortens by (pi A)^2 / 4 L; Euler's strain 4 pi^2 / 12 (t / L)^2 stays
    euler = 4 * math.pi**2 / 12 / 24**2 * 24
    assert bow == pytest.approx(2 / math.pi * math.sqrt((shortened - euler) * 24), rel=0.1)


def test_what_does_not_converge_says_so_and_leaves_the_state(slab: Callable[..., Lattice]) -> None:
    lattice = slab(5, 5, 2, base=True)
    state = LatticeState.at_rest(lattice)
    force = np.zeros_like(lattice.nodes)
    force[12 * 3, 2] = -1e6
    before = state.copy()
    with pytest.raises(SimulationError, match=r"step of 1 s did not converge: .* residual was .* after \d+ iter"):
        advance_implicit(lattice, state, None, 1.0, quasi_static=True, external=force)
    force[12 * 3, 2] = math.nan
    with pytest.raises(SimulationError, match="did not converge"):
        advance_implicit(lattice, state, None, 1.0, external=force)
    for name in ("x", "velocity", "rest_length"):
        assert (getattr(state, name) == getattr(before, name)).all()
    state.x[3] = math.nan
    with pytest.raises(SimulationError, match="no longer finite"):
        advance_implicit(lattice, state, None, 1.0)


def test_a_step_that_fails_is_tried_in_halves(slab: Callable[..., Lattice], monkeypatch: pytest.MonkeyPatch) -> None:
    """With few iterations allowed the step is cut; the held nodes end where they should."""
    lattice = slab(8, 3, 2, anchored=np.repeat([True] + [False] * 6 + [True], 9).reshape(8, 3, 3))
    whole, cut = LatticeState.at_rest(lattice), LatticeState.at_rest(lattice)
    for state in (whole, cut):
        state.velocity[-9:] = (-0.3, 0.0, 2.0)
    assert advance_implicit(lattice, whole, None, 1.0, quasi_static=True).substeps == 1
    monkeypatch.setattr(implicit, "ITERATIONS", 5)
    assert advance_implicit(lattice, cut, None, 1.0, quasi_static=True).substeps > 1
    assert cut.x == pytest.approx(whole.x, abs=1e-4)


def test_bad_input_is_named(slab: Callable[..., Lattice]) -> None:
    lattice = slab(4, 4, 1)
    state = LatticeState.at_rest(lattice)
    with pytest.raises(InputError, match="quasi-static body that nothing holds"):
        advance_implicit(lattice, state, None, 1.0, quasi_static=True)
    with pytest.raises(InputError, match="sub-step of -1 s"):
        advance_implicit(lattice, state, None, 1.0, substep=-1.0)
    for dt in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="positive time"):
            advance_implicit(lattice, state, None, dt)


def test_any_number_of_threads_gives_the_same_bytes(
    slab: Callable[..., Lattice], contact: Callable[..., ContactLoad]
) -> None:
    ends = []
    for threads in (1, 1, 2):
        with threadpool_limits(limits=threads, user_api="blas"):
            ends.append(pressed(slab, contact, PRESETS["clay"], advance_implicit)[1])
            # large enough for BLAS to share the work out
            lattice = slab(31, 31, 3, base=True)
            state = LatticeState.at_rest(lattice)
            force = np.zeros_like(lattice.nodes)
            force[::7, 2] = -1e-3
            advance_implicit(lattice, state, None, 1.0, quasi_static=True, external=force)
            ends[-1].velocity = state.x
    for name in ("x", "velocity", "rest_length"):
        assert len({getattr(end, name).tobytes() for end in ends}) == 1
