"""Nodes that follow others: a plate cut in two is the whole plate; momentum, bounds, creases, corners and chains."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cadsculpt.errors import InputError
from cadsculpt.physics import implicit, tangent
from cadsculpt.physics.assembly import Assembly, assemble
from cadsculpt.physics.explicit import ContactLoad, LatticeState, StepForces, advance, stable_substep
from cadsculpt.physics.forces import node_weights
from cadsculpt.physics.implicit import advance_implicit
from cadsculpt.physics.lattice import Lattice, build_lattice
from cadsculpt.physics.material import PRESETS, Material
from cadsculpt.physics.measures import elastic_energy, kinetic_energy
from cadsculpt.physics.numbering import Numbering
from cadsculpt.physics.seams import locate, seam_ties
from cadsculpt.physics.tangent import solve
from cadsculpt.physics.ties import Ties, condensed, resolve

Array = NDArray[np.float64]
Step = Callable[..., StepForces]
BOTH = pytest.mark.parametrize("step", [advance, advance_implicit])
ELASTIC = Material(1e6, 1000.0, damping=0.1)
CLAY = PRESETS["clay"]


def face(
    corner: tuple[float, float, float],
    along: tuple[tuple[float, float, float], tuple[float, float, float]],
    inward: tuple[float, float, float],
    counts: tuple[int, int],
    *,
    layers: int = 3,
    thickness: float = 3.0,
    material: Material = ELASTIC,
    held: Callable[[Array], Any] | None = None,
    move: Callable[[Array], Array] = lambda p: p,
) -> Lattice:
    """A flat face from a corner along two vectors, with so many nodes, u and v from 0 to 1; held where `held` says of nodes."""
    u, v = np.linspace(0, 1, counts[0]), np.linspace(0, 1, counts[1])
    points = np.array(corner) + u[:, None, None] * np.array(along[0]) + v[None, :, None] * np.array(along[1])
    points = move(points)
    depth = thickness * np.arange(layers + 1) / layers
    nodes = points[:, :, None] + depth[:, None] * np.array(inward)
    anchored = np.zeros(nodes.shape[:3], dtype=bool) if held is None else np.asarray(held(nodes), dtype=bool)
    return build_lattice(
        points, np.broadcast_to(np.array(inward), points.shape), u, v, thickness=thickness, layers=layers,
        material=material, anchored=anchored, metres_per_unit=1e-3,
    )  # fmt: skip


def start_held(nodes: Array) -> Any:
    return nodes[..., 0] < 0.01


def plate(counts: tuple[int, int], span: tuple[float, float], **options: Any) -> Lattice:
    return face((span[0], 0.0, 0.0), ((span[1] - span[0], 0, 0), (0, 6.0, 0)), (0, 0, -1.0), counts, **options)


EDGE = np.linspace(0, 1, 9)
END, BEGIN = np.stack([1 + 0 * EDGE, EDGE], axis=1), np.stack([0 * EDGE, EDGE], axis=1)


def cut(counts: tuple[int, int] = (5, 7), others: tuple[int, int] = (7, 7), **options: Any) -> Assembly:
    """A plate of 10 x 6 x 3 in two faces that meet at x = 4."""
    parts = [plate(counts, (0.0, 4.0), **options), plate(others, (4.0, 10.0), **options)]
    return assemble(parts, seam_ties(parts, 0, END, 1, BEGIN))


def of_whole(pair: Assembly, whole: Lattice) -> NDArray[np.int64]:
    """The node of the whole plate at each of the cut one's."""
    gap = np.linalg.norm(pair.lattice.nodes[:, None] - whole.nodes, axis=2)
    assert gap.min(axis=1).max() < 1e-9
    return gap.argmin(axis=1)


@pytest.mark.parametrize("material", [ELASTIC, CLAY], ids=["elastic", "clay"])
@pytest.mark.parametrize("free", [False, True])
@BOTH
def test_a_plate_cut_in_two_is_the_whole_plate(step: Step, material: Material, free: bool) -> None:
    held = None if free else start_held
    pair, whole = cut(material=material, held=held), plate((11, 7), (0.0, 10.0), material=material, held=held)
    same = of_whole(pair, whole)
    assert len(pair.ties.nodes) == 7 * 4
    assert pair.lattice.mass.sum() == pytest.approx(whole.mass.sum(), rel=1e-12)
    one, two = LatticeState.at_rest(whole), LatticeState.at_rest(pair.lattice)
    one.velocity[:] = 300.0 * np.stack(
        [np.sin(whole.nodes[:, 1]), np.cos(whole.nodes[:, 0]), whole.nodes[:, 0] / 9], axis=1
    )
    one.velocity[whole.anchored] = 0.0
    two.velocity[:] = one.velocity[same]
    force = np.zeros_like(whole.nodes)
    force[[200, 100, 33], 2] = -0.3
    mine = np.zeros_like(pair.lattice.nodes)
    for node in (200, 100, 33):
        shared = np.flatnonzero(same == node)
        mine[shared] = force[node] / len(shared)
    how = {"substep": 0.5 * stable_substep(whole)} if step is advance else {}
    for _ in range(5):
        step(whole, one, None, 2e-4, external=force, **how)
        step(pair.lattice, two, None, 2e-4, external=mine, **how)
    moved = np.abs(one.x - whole.nodes).max()
    assert moved > 0.05
    assert material is ELASTIC or np.abs(one.rest_length - whole.rest_length).max() > 1e-3
    close = 1e-9 if step is advance else 1e-6
    assert two.x == pytest.approx(one.x[same], abs=close * moved)
    assert two.velocity == pytest.approx(one.velocity[same], abs=10 * close * np.abs(one.velocity).max())


@pytest.mark.parametrize("material", [ELASTIC, CLAY], ids=["elastic", "clay"])
def test_the_implicit_solution_itself_is_that_of_the_whole_plate(
    monkeypatch: pytest.MonkeyPatch, material: Material
) -> None:
    """With Newton's criterion tightened: 1e-9."""
    monkeypatch.setattr(implicit, "RESIDUAL", 1e-12)
    monkeypatch.setattr(implicit, "CORRECTION", 1e-10)
    pair, whole = (
        cut(material=material, held=start_held),
        plate((11, 7), (0.0, 10.0), material=material, held=start_held),
    )
    same = of_whole(pair, whole)
    one, two = LatticeState.at_rest(whole), LatticeState.at_rest(pair.lattice)
    force = np.where(whole.nodes[:, :1] > 9.9, [[0.0, 0.002, -0.004]], 0.0)
    mine = force[same]
    advance_implicit(whole, one, None, 1e-2, external=force)
    advance_implicit(pair.lattice, two, None, 1e-2, external=mine)
    assert np.abs(one.x - whole.nodes).max() > 0.05
    assert two.x == pytest.approx(one.x[same], abs=1e-9)


@pytest.mark.parametrize("others", [(7, 10), (9, 4), (7, 8)])
def test_unlike_nodes_bend_as_the_whole_plate(others: tuple[int, int]) -> None:
    """No gap at the ties, and the deflection of a cantilever within the discretisation: that of the coarse and the fine."""
    pair = cut(others=others, held=start_held, material=ELASTIC)
    found = []
    for lattice, parts in ((pair.lattice, pair), (plate((11, 7), (0.0, 10.0), held=start_held), None)):
        state = LatticeState.at_rest(lattice)
        end = lattice.nodes[:, 0] > 9.99
        share = np.zeros(len(end))
        share[end] = condensed(lattice.volume, lattice.ties)[end]
        force = np.zeros_like(lattice.nodes)
        force[:, 2] = -0.05 * share / share.sum()
        advance_implicit(lattice, state, None, 1.0, quasi_static=True, external=force)
        found.append((state.x - lattice.nodes)[end, 2] @ share[end] / share[end].sum())
        if parts is not None:
            ties = parts.ties
            assert len(ties.nodes) == 4 * max(7, others[1])
            for s, node in enumerate(ties.nodes):
                entries = slice(ties.start[s], ties.start[s + 1])
                masters, weights = ties.masters[entries], ties.weights[entries]
                assert weights @ lattice.nodes[masters] == pytest.approx(lattice.nodes[node], abs=1e-12)
                assert weights @ state.x[masters] == pytest.approx(state.x[node], abs=1e-12)
    assert found[0] == pytest.approx(found[1], rel=0.05)


@pytest.mark.parametrize("others", [(7, 7), (7, 10)])
@BOTH
def test_a_free_tied_pair_keeps_its_momenta(step: Step, others: tuple[int, int]) -> None:
    """Vibrating, spinning, flying, damped: momentum and angular momentum stay, tied nodes stay on each other."""
    pair = cut(others=others, material=replace(ELASTIC, damping=0.5))
    lattice = pair.lattice
    assert lattice.free.tolist() == [[0, 0, pair.starts[1]], [0, pair.starts[1], len(lattice.nodes)]]
    state = LatticeState.at_rest(lattice)
    state.velocity[:] = [20.0, 0.0, -10.0] + np.cross([3.0, 0.0, 4.0], lattice.nodes)
    state.velocity += 10.0 * np.random.default_rng(0).normal(size=state.velocity.shape)
    momenta = []
    for _ in range(20):
        step(lattice, state, None, 2e-4)
        momenta.append([lattice.mass @ state.velocity, lattice.mass @ np.cross(state.x, state.velocity)])
    for k, exact in ((0, 1e-9), (1, 1e-6 if step is advance else 1e-3)):
        assert momenta[-1][k] == pytest.approx(momenta[0][k], rel=exact, abs=exact * np.abs(momenta[0][k]).max())


def test_an_undamped_tied_pair_keeps_its_energy() -> None:
    """Unlike nodes, 4000 sub-steps of free vibration: within 1 %, with the masses shared out as the ties do."""
    pair = cut(others=(7, 10), material=replace(ELASTIC, damping=0.0))
    lattice, state = pair.lattice, LatticeState.at_rest(pair.lattice)
    state.x += 0.01 * np.stack([np.sin(state.x[:, 1]), np.cos(state.x[:, 0]), np.sin(state.x[:, 0])], axis=1)
    for s, node in enumerate(pair.ties.nodes):
        entries = slice(pair.ties.start[s], pair.ties.start[s + 1])
        masters, weights = pair.ties.masters[entries], pair.ties.weights[entries]
        state.x[node] = lattice.nodes[node] + weights @ (state.x[masters] - lattice.nodes[masters])
    energies = []
    for _ in range(400):
        result = advance(lattice, state, None, 10 * stable_substep(lattice))
        together = state.copy()
        together.x -= 0.5 * result.substep * state.velocity
        energies.append(elastic_energy(lattice, together) + kinetic_energy(lattice, together))
    assert np.mean(energies[-100:]) == pytest.approx(np.mean(energies[:100]), rel=0.01)
    assert np.ptp(energies) < 0.1 * np.mean(energies)


@BOTH
def test_a_bar_of_two_faces_stretches_as_the_formula_says(step: Step) -> None:
    """F L / E A, away from the clamp."""
    pair = cut(others=(10, 10), held=start_held, material=replace(ELASTIC, damping=1.5))
    lattice, state = pair.lattice, LatticeState.at_rest(pair.lattice)
    end = lattice.nodes[:, 0] > 9.99
    area = np.zeros(len(end))
    j, k = np.divmod(np.arange(40), 4)
    area[end] = np.where((j == 0) | (j == 9), 0.5, 1.0) * np.where((k == 0) | (k == 3), 0.5, 1.0) / 27.0
    force = np.zeros_like(lattice.nodes)
    force[:, 0] = 0.01 * 18.0 * area
    for _ in range(40 if step is advance else 1):
        step(lattice, state, None, 1e-3 if step is advance else 1e3, external=force)
    sections = []
    for x, part in ((2.0, 0), (8.0, 1)):
        mine = np.abs(pair.parts[part].nodes[:, 0] - x) < 1e-9
        weight = pair.parts[part].volume[mine]
        sections.append((pair.part_state(state, part).x - pair.parts[part].nodes)[mine, 0] @ weight / weight.sum())
    # stress 0.01 N/mm^2, E = 1 N/mm^2: 1 % of 6 mm
    assert sections[1] - sections[0] == pytest.approx(0.06, rel=0.02)


@pytest.mark.parametrize("seed", range(6))
def test_the_bound_holds_with_ties(tangent: Any, seed: int) -> None:
    """Against the largest eigenvalue of T^T K T over the shared out masses; held masters too."""
    rng = np.random.default_rng(seed)

    def move(p: Array) -> Array:
        # seams stay straight
        wobble = 0.15 * rng.uniform(-1, 1, p.shape) * (p[..., :1] > 4.01) * (p[..., :1] < 9.9)
        return p + wobble

    pair = cut(others=(7, (7, 10, 4)[seed % 3]), held=start_held if seed % 2 else None, move=move)
    if seed == 5:
        parts = [replace(part, anchored=part.anchored | (part.nodes[:, 1] < 0.01)) for part in pair.parts]
        pair = assemble(parts, seam_ties(parts, 0, END, 1, BEGIN))
    lattice = pair.lattice
    size = len(lattice.nodes)
    K = np.zeros((3 * size, 3 * size))
    for part, start in zip(pair.parts, pair.starts, strict=True):
        mine = slice(3 * start, 3 * (start + len(part.nodes)))
        K[mine, mine] = tangent(part).toarray()
    T = np.eye(size)
    for s, node in enumerate(pair.ties.nodes):
        entries = slice(pair.ties.start[s], pair.ties.start[s + 1])
        T[node] = 0.0
        T[node, pair.ties.masters[entries]] = pair.ties.weights[entries]
    T = np.kron(T[:, lattice.inverse_mass > 0], np.eye(3))
    root = np.repeat(np.sqrt(lattice.inverse_mass[lattice.inverse_mass > 0]), 3)
    square = np.linalg.eigvalsh(root[:, None] * (T.T @ K @ T) * root)[-1]
    assert 0.6 * lattice.highest_frequency < square <= lattice.highest_frequency * (1 + 1e-12)


@pytest.mark.parametrize("how", [math.inf, 0.0], ids=["band", "gradients"])
def test_the_tangent_with_ties_is_the_derivative_of_the_forces(
    contact: Callable[..., ContactLoad],
    residual_along: Callable[..., Array],
    monkeypatch: pytest.MonkeyPatch,
    how: float,
) -> None:
    """Contacts on tied nodes, masters shared by two tied nodes, held ones, drag that leaves rigid motion alone."""
    monkeypatch.setattr(tangent, "LARGEST_BAND", how)
    monkeypatch.setattr(tangent, "CG_TOLERANCE", 1e-10)
    rng = np.random.default_rng(2)
    for held in (None, lambda nodes: nodes[..., 1] < 0.01):
        pair = cut(others=(7, 10), held=held)
        lattice, state = pair.lattice, LatticeState.at_rest(pair.lattice)
        nodes, weights = node_weights(pair.parts[1], rng.uniform(0, 0.3, 20), rng.uniform(0, 1, 20))
        load = contact(nodes + pair.starts[1], weights, depth=0.3, stiffness=2.0, damping=0.1, velocity=(1.0, 2.0, 0.5))
        problem = implicit._Problem.at(lattice, state, load, load.depth, 1e-2, quasi_static=False)
        assert not np.isin(problem.nodes, pair.ties.nodes).any()
        duals = implicit._Duals(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros_like(load.normal))

        moves = problem.moves[:, None]
        here = np.where(moves, 0.02 * state.x + 1e-3 * rng.normal(size=state.x.shape), 0.0)
        moved = implicit.carried(here, pair.ties)
        balance = implicit._balance(problem, state.x + moved, duals)
        right = np.where(moves, rng.normal(size=state.x.shape), 0.0)
        d = solve(lattice, Numbering.of(lattice, problem.nodes, state.x), balance.tangent, right)
        assert d is not None
        # d holds what follows at the tied nodes
        change = residual_along(problem, state.x + moved, d, duals)
        assert -change == pytest.approx(right, abs=5e-5 * np.abs(right).max())


@BOTH
def test_contact_across_a_seam_is_that_of_the_whole_plate(contact: Callable[..., ContactLoad], step: Step) -> None:
    """Contacts on both faces and on the seam. (Explicit: contacts at tied nodes are not lumped, and slip otherwise.)"""
    pair, whole = cut(held=lambda n: n[..., 2] < -2.99), plate((11, 7), (0.0, 10.0), held=lambda n: n[..., 2] < -2.99)
    rng = np.random.default_rng(3)
    x, y = rng.uniform(2.5, 6.0, 40), rng.uniform(1.0, 5.0, 40)
    x[:5] = 4.0
    totals = []
    for lattice in (whole, pair.lattice):
        state = LatticeState.at_rest(lattice)
        if lattice is whole:
            nodes, weights = node_weights(whole, x / 10.0, y / 6.0)
        else:
            nodes, weights = node_weights(pair.parts[0], x / 4.0, y / 6.0)
            right = x >= 4.0
            nodes[right], weights[right] = node_weights(pair.parts[1], (x[right] - 4.0) / 6.0, y[right] / 6.0)
            nodes[right] += pair.starts[1]
        for _ in range(20):
            depth = np.einsum("nk,nk->n", weights, state.x[nodes][..., 2]) + 0.1
            load = contact(nodes, weights, depth=depth, area=0.3, stiffness=5.0, damping=1e-3, friction=0.2)
            result = step(lattice, state, load, 1e-3)
        totals.append(result.mean_force.copy())
    if step is advance_implicit:
        assert totals[1] == pytest.approx(totals[0], abs=1e-5 * np.abs(totals[0]).max())
    assert totals[1][:, 2] == pytest.approx(totals[0][:, 2], abs=0.02 * np.abs(totals[0]).max())
    assert totals[1].sum(axis=0) == pytest.approx(totals[0].sum(axis=0), abs=0.01 * np.abs(totals[0].sum(axis=0)).max())


def box_edge() -> Assembly:
    """Two faces of a box at right angles, unlike nodes along their common edge x = 4, z = 0, along y."""
    top = face((0.0, 0.0, 0.0), ((4.0, 0, 0), (0, 6.0, 0)), (0, 0, -1.0), (5, 7), layers=2, thickness=2.0)
    side = face((4.0, 0.0, 0.0), ((0, 0, -5.0), (0, 6.0, 0)), (-1.0, 0, 0), (7, 10), layers=3, thickness=2.0)
    parts = [top, side]
    return assemble(parts, seam_ties(parts, 0, END, 1, BEGIN))


@BOTH
def test_an_edge_of_a_box_turns_with_it(step: Step) -> None:
    """Free, spinning and flying, elastic and damped: ties resist no rigid motion; what is tied is where its masters say."""
    pair = box_edge()
    lattice, ties = pair.lattice, pair.ties
    # the column of the side's edge lies in the surface of the top
    assert len(ties.nodes) == 10 * 4
    for s, node in enumerate(ties.nodes):
        entries = slice(ties.start[s], ties.start[s + 1])
        assert ties.weights[entries] @ lattice.nodes[ties.masters[entries]] == pytest.approx(
            lattice.nodes[node], abs=1e-9
        )
    state = LatticeState.at_rest(lattice)
    centre = lattice.mass @ lattice.nodes / lattice.mass.sum()
    state.velocity[:] = [10.0, 0.0, -20.0] + np.cross([2.0, 5.0, 1.0], lattice.nodes - centre)
    before = lattice.mass @ np.cross(state.x - centre, state.velocity)
    angle = 0.0
    for _ in range(20):
        step(lattice, state, None, 2e-3)
        angle += 2e-3 * math.sqrt(30.0)
    assert angle > 0.2
    moved = lattice.mass @ state.x / lattice.mass.sum()
    assert moved == pytest.approx(centre + 0.04 * np.array([10.0, 0.0, -20.0]), abs=1e-6)
    # backward Euler loses (omega h)^2 in every step
    exact = 1e-6 if step is advance else 20 * 30.0 * 2e-3**2 * 1.1
    after = lattice.mass @ np.cross(state.x - moved, state.velocity)
    assert after == pytest.approx(before, abs=exact * np.abs(before).max())
    for part, mine in ((pair.parts[k], pair.part_state(state, k)) for k in (0, 1)):
        assert elastic_energy(part, mine) < 1e-4 * kinetic_energy(lattice, state)


def test_a_column_outside_the_other_lattice_is_left_free() -> None:
    """At a reentrant edge only the surface is tied: the seam is closed, and the faces may turn about it."""
    floor = face((0.0, 0.0, 0.0), ((4.0, 0, 0), (0, 6.0, 0)), (0, 0, -1.0), (5, 7), layers=2, thickness=2.0)
    wall = face((4.0, 0.0, 0.0), ((0, 0, 5.0), (0, 6.0, 0)), (1.0, 0, 0), (6, 7), layers=2, thickness=2.0)
    pair = assemble([floor, wall], seam_ties([floor, wall], 0, END, 1, BEGIN))
    assert len(pair.ties.nodes) == 7
    assert (pair.lattice.nodes[pair.ties.nodes, 2] == 0.0).all()


def test_three_faces_meet_in_a_corner() -> None:
    """Whatever the order of the seams: all nodes of the corner follow one, none follows a tied node, edges stay closed."""
    faces = [
        face((0.0, 0.0, 0.0), ((4.0, 0, 0), (0, 4.0, 0)), (0, 0, -1.0), (5, 5), layers=2, thickness=2.0),
        face((0.0, 0.0, 0.0), ((0, 4.0, 0), (0, 0, -4.0)), (1.0, 0, 0), (6, 5), layers=2, thickness=2.0),
        face((0.0, 0.0, 0.0), ((0, 0, -4.0), (4.0, 0, 0)), (0, 1.0, 0), (5, 7), layers=2, thickness=2.0),
    ]
    first, second = np.stack([EDGE, 0 * EDGE], axis=1), np.stack([0 * EDGE, EDGE], axis=1)
    seams = [
        seam_ties(faces, 0, second, 1, first),
        seam_ties(faces, 1, second, 2, first),
        seam_ties(faces, 2, second, 0, first),
    ]
    for order in ((0, 1, 2), (2, 1, 0), (1, 2, 0)):
        whole = assemble(faces, Ties.joined([seams[k] for k in order]))
        ties, lattice = whole.ties, whole.lattice
        assert not np.isin(ties.masters, ties.nodes).any()
        at_corner = np.flatnonzero(np.linalg.norm(lattice.nodes, axis=1) == 0.0)
        assert len(at_corner) == 3
        tied = [node for node in at_corner if node in ties.nodes]
        assert len(tied) == 2
        leads = set(at_corner) - set(tied)
        for node in tied:
            s = ties.row[node]
            assert set(ties.masters[ties.start[s] : ties.start[s + 1]]) == leads
        state = LatticeState.at_rest(lattice)
        state.velocity[:] = 50.0 * np.random.default_rng(0).normal(size=state.velocity.shape)
        for _ in range(3):
            advance(lattice, state, None, 1e-3)
        assert np.ptp(state.x[at_corner], axis=0) == pytest.approx(0.0, abs=1e-12)
        again = assemble(faces, Ties.joined([seams[k] for k in order]))
        assert again.ties.masters.tobytes() == ties.masters.tobytes()
        assert again.ties.weights.tobytes() == ties.weights.tobytes()


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**9))
def test_any_ties_are_resolved(seed: int) -> None:
    """Random ties, chains and circles: what comes out ties to free nodes alone, with weights of sum 1, and honours every tie
    that is not in another's way; coinciding nodes alone become one."""
    rng = np.random.default_rng(seed)
    count, size = 12, int(rng.integers(1, 20))
    nodes = rng.integers(0, count, size)
    width = 1 if seed % 2 else 3
    masters, weights = rng.integers(0, count, (size, width)), rng.uniform(0.1, 1, (size, width))
    weights /= weights.sum(axis=1)[:, None]
    tied = resolve(Ties(nodes, masters, weights), np.ones(count, dtype=bool))
    if not len(tied.nodes):
        assert (masters == nodes[:, None]).all()
        return
    assert not np.isin(tied.masters, tied.nodes).any()
    assert np.add.reduceat(tied.weights, tied.start[:-1]) == pytest.approx(1.0, rel=1e-9)
    assert (tied.weights > 0).all()
    values = rng.normal(size=count)
    for s, node in enumerate(tied.nodes):
        entries = slice(tied.start[s], tied.start[s + 1])
        values[node] = tied.weights[entries] @ values[tied.masters[entries]]
    if width == 1:
        assert values[masters[:, 0]] == pytest.approx(values[nodes])
    else:
        once = [k for k in range(size) if (nodes == nodes[k]).sum() == 1 and np.flatnonzero(nodes == nodes[k])[0] == k]
        for k in once[:1] if nodes[0] in nodes[once] else []:
            if k == 0:
                assert weights[0] @ values[masters[0]] == pytest.approx(values[nodes[0]])
    total = rng.uniform(size=count)
    assert condensed(total, tied).sum() == pytest.approx(total.sum())


def test_an_anchor_holds_both_sides_of_a_seam() -> None:
    parts = list(cut().parts)
    held = parts[1].anchored.copy()
    held[:4] = True  # the first column of the side that follows
    parts[1] = replace(parts[1], anchored=held)
    pair = assemble(parts, seam_ties(parts, 0, END, 1, BEGIN))
    masters = np.unique(
        pair.ties.masters[np.isin(np.repeat(pair.ties.nodes, np.diff(pair.ties.start)), pair.starts[1] + np.arange(4))]
    )
    assert len(masters) == 4
    assert pair.lattice.anchored[masters].all()
    assert (pair.lattice.inverse_mass[masters] == 0.0).all()
    assert not len(pair.lattice.free)
    for step in (advance, advance_implicit):
        state = LatticeState.at_rest(pair.lattice)
        state.velocity[:] = 10.0
        state.velocity[pair.lattice.anchored] = (1.0, 0.0, 2.0)
        step(pair.lattice, state, None, 1e-3)
        for column in (masters, pair.starts[1] + np.arange(4)):
            assert state.x[column] - pair.lattice.nodes[column] == pytest.approx(
                np.tile([1e-3, 0.0, 2e-3], (4, 1)), abs=1e-12
            )


def test_points_are_found_in_cells() -> None:
    """Random points of distorted cells: the trilinear weights give them back; points far away are in no cell."""
    rng = np.random.default_rng(0)
    lattice = plate((6, 7), (0.0, 10.0), move=lambda p: p + 0.3 * rng.uniform(-1, 1, p.shape) * [1, 1, 0.3])
    points = rng.uniform([0.6, 0.6, -2.7], [9.4, 5.4, -0.4], (60, 3))
    held, nodes, weights = locate(lattice, points[:, :2] / [10.0, 6.0], points)
    assert held.all()
    assert np.einsum("nk,nkc->nc", weights, lattice.nodes[nodes]) == pytest.approx(points, abs=1e-9)
    assert (weights >= 0).all()
    assert not locate(lattice, points[:5, :2] / [10.0, 6.0], points[:5] + [0.0, 0.0, 8.0])[0].any()


def test_bad_ties_are_named() -> None:
    parts = [plate((5, 7), (0.0, 4.0)), plate((7, 7), (4.0, 10.0))]
    one = np.array([0]), np.array([[4]]), np.array([[1.0]])
    for ties, match in (
        (Ties(one[0], one[1], np.array([[0.5]])), "do not sum to 1"),
        (Ties(one[0], np.array([[10**6]]), one[2]), "masters of ties are not among"),
        (Ties(one[0], one[1], np.array([[math.nan]])), "finite"),
        (Ties(one[0], np.array([[4, 5]]), np.array([[1.5, -0.5]])), "not negative"),
        (Ties(one[0], one[1], np.array([[0.5, 0.5]])), "ties of 1 nodes"),
    ):
        with pytest.raises(InputError, match=match):
            assemble(parts, ties)
    with pytest.raises(InputError, match="neither lattice has a node near the seam"):
        seam_ties(parts, 0, END + [1.0, 0.0], 1, BEGIN - [1.0, 0.0])
    with pytest.raises(InputError, match="must be"):
        seam_ties(parts, 0, END, 1, BEGIN[:4])
    with pytest.raises(InputError, match="not finite"):
        seam_ties(parts, 0, END * math.nan, 1, BEGIN)
