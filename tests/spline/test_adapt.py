"""The refit to tolerance: few knots, where they are needed; what did not move keeps its bits; what is said is measured."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadsculpt.errors import GeometryError
from cadsculpt.spline.adapt import Goal, ToleranceFit, fit_to_tolerance
from cadsculpt.spline.between import between_nodes, denser
from cadsculpt.spline.hold import Hold
from cadsculpt.spline.net_fit import Given, NodeField, fit_net
from cadsculpt.spline.refine import insert_knots
from cadsculpt.spline.surface import BSplineSurface

Array = np.ndarray


def surface_of(degree: int, count: int, seed: int = 0, *, rational: bool = False) -> BSplineSurface:
    """An uneven clamped net of count x count control points over the unit square."""
    rng = np.random.default_rng(seed)
    inner = count - degree - 1
    knots = np.concatenate([np.zeros(degree + 1), (np.arange(inner) + 1) / (inner + 1), np.ones(degree + 1)])
    x = np.array([knots[i + 1 : i + degree + 1].mean() for i in range(count)])
    points = np.stack([*np.meshgrid(x, x, indexing="ij"), rng.normal(scale=0.05, size=(count, count))], axis=-1)
    weights = rng.uniform(0.7, 1.4, (count, count)) if rational else None
    return BSplineSurface(points, knots, knots, degree, degree, weights)


def dent(u: Array, v: Array, *, at=(0.5, 0.5), width=0.07, depth=0.1) -> Array:
    """A Gaussian dent (m, n, 3), exactly zero where it is below a thousandth of its depth."""
    g = np.exp(-((u[:, None] - at[0]) ** 2 + (v - at[1]) ** 2) / (2 * width**2))
    field = np.zeros((len(u), len(v), 3))
    field[..., 2] = -depth * np.where(g > 1e-3, g, 0.0)
    return field


def fitted(
    surface: BSplineSurface, field: NodeField, tolerance: float, *, max_control_points=10000, refine=True, **more
) -> ToleranceFit:
    goal = Goal(tolerance, 0.05 * tolerance, max_control_points, refine)
    return fit_to_tolerance(surface, field, goal, **more)


def measured(surface: BSplineSurface, fit: ToleranceFit, field: NodeField) -> Array:
    """Distance (m, n) of the moved nodes from the refit surface, by evaluating both."""
    moved = fit.surface.evaluate(field.u[:, None], field.v)
    return np.linalg.norm(surface.evaluate(field.u[:, None], field.v) + field.displacement - moved, axis=2)


NODES = np.linspace(0, 1, 61)


@pytest.mark.parametrize("degree", range(1, 12))
@pytest.mark.parametrize("rational", [False, True])
def test_a_surface_gets_its_own_net_back_without_a_knot(degree, rational):
    surface = surface_of(degree, degree + 5, rational=rational)
    true = np.random.default_rng(degree).normal(scale=0.05, size=surface.control_points.shape)
    moved = surface.with_control_points(surface.control_points + true)
    field = NodeField.of(
        surface, NODES, NODES, moved.evaluate(NODES[:, None], NODES) - surface.evaluate(NODES[:, None], NODES)
    )
    fit = fitted(surface, field, 1e-6)
    assert fit.surface.shape == surface.shape
    # the basis' condition number (2^degree a direction) amplifies the rounding of the data
    assert np.abs(fit.fit.displacement - true).max() <= 1e-12 * max(1.0, 4.0 ** (degree - 7))
    assert fit.error.maximum <= 1e-13


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5, 7])
@pytest.mark.parametrize("rational", [False, True])
def test_the_tolerance_is_met_and_the_error_is_what_is_measured(degree, rational):
    surface = surface_of(degree, 10, rational=rational)
    field = NodeField.of(surface, NODES, NODES, dent(NODES, NODES))
    fit = fitted(surface, field, 1e-3)
    distance = measured(surface, fit, field)
    assert fit.outcome == "within"
    assert distance.max() <= 1e-3
    assert fit.error.maximum == pytest.approx(distance.max(), abs=1e-14)
    assert fit.error.rms == pytest.approx(np.sqrt((distance**2).mean()), abs=1e-14)
    # between the nodes the dent itself is known
    fine = np.linspace(0, 1, 241)
    moved = fit.surface.evaluate(fine[:, None], fine) - surface.evaluate(fine[:, None], fine)
    assert np.linalg.norm(moved - dent(fine, fine), axis=2).max() <= (1.5e-3 if degree > 1 else 2e-3)
    for knots, new in ((surface.knots_u, fit.knots[0]), (surface.knots_v, fit.knots[1])):
        assert len(new) > 0
        assert (np.diff(np.sort(np.concatenate([knots, new]))) >= 0).all()


@pytest.mark.parametrize("rational", [False, True])
def test_what_no_moved_node_reaches_keeps_its_bits(rational):
    surface = surface_of(3, 16, rational=rational)
    field = NodeField.of(surface, NODES, NODES, dent(NODES, NODES, width=0.03))
    fit = fitted(surface, field, 1e-4)
    hit = NODES[(field.displacement != 0).any(axis=(1, 2))]
    reached = []
    for axis, knots in enumerate((fit.surface.knots_u, fit.surface.knots_v)):
        first, last = knots[: fit.surface.shape[axis]], knots[4:]
        reached.append((first <= hit[-1]) & (last >= hit[0]))
    free = reached[0][:, None] & reached[1][None, :]
    assert 0 < free.sum() < free.size
    fine = insert_knots(surface, *fit.knots)
    np.testing.assert_array_equal(fit.surface.control_points[~free], fine.control_points[~free])
    # and rows that no new knot reaches are those of the file
    rows = [i for i in range(surface.shape[0]) if surface.knots_u[i + 4] <= fit.knots[0][0]]
    columns = [j for j in range(surface.shape[1]) if surface.knots_v[j + 4] <= fit.knots[1][0]]
    assert rows
    assert columns
    corner = np.ix_(rows, columns)
    np.testing.assert_array_equal(fit.surface.control_points[corner], surface.control_points[corner])
    assert (fit.surface.weights is None) == (surface.weights is None)


@pytest.mark.parametrize("degree", [2, 3, 5])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 2e-4])
def test_the_net_is_about_as_small_as_one_chosen_by_hand(degree, tolerance):
    """By hand: k knots at equal steps across the dent, in both directions, and the smallest k that does it."""
    surface = surface_of(degree, 10)
    field = NodeField.of(surface, NODES, NODES, dent(NODES, NODES))
    for k in range(60):
        knots = np.linspace(0.27, 0.73, k + 2)[1:-1] if k > 1 else np.full(k, 0.5001)
        net = insert_knots(surface, knots, knots)
        if np.linalg.norm(fit_net(net, field, 0.0, None).residual, axis=2).max() <= tolerance:
            break
    fit = fitted(surface, field, tolerance)
    assert fit.outcome == "within"
    # a knot more in each direction, at most
    assert np.prod(fit.surface.shape) <= (net.shape[0] + 1) * (net.shape[1] + 1)


def test_a_net_that_was_refined_by_hand_is_found_or_beaten():
    surface = surface_of(3, 8)
    by_hand = insert_knots(surface, [0.31, 0.42, 0.47], [0.55])
    true = np.zeros((*by_hand.shape, 3))
    true[3:7, 4:8, 2] = np.random.default_rng(1).normal(scale=0.1, size=(4, 4))
    moved = by_hand.with_control_points(by_hand.control_points + true)
    u, v = np.linspace(0, 1, 81), np.linspace(0, 1, 71)
    field = NodeField.of(surface, u, v, moved.evaluate(u[:, None], v) - surface.evaluate(u[:, None], v))
    fit = fitted(surface, field, 2e-3)
    assert fit.outcome == "within"
    assert np.prod(fit.surface.shape) <= 1.5 * np.prod(by_hand.shape)
    assert len(fit.knots[0]) > len(fit.knots[1])  # where it is rougher


def test_knots_go_into_the_direction_that_lacks_them():
    surface = surface_of(3, 8)
    ridge = np.zeros((61, 61, 3))
    ridge[..., 0] = 0.1 * np.exp(-((NODES - 0.4) ** 2) / (2 * 0.05**2))  # changes along v alone
    fit = fitted(surface, NodeField.of(surface, NODES, NODES, ridge), 1e-3)
    assert fit.outcome == "within"
    assert len(fit.knots[0]) == 0
    assert 0 < len(fit.knots[1]) <= 8


def test_thinning_takes_out_what_is_not_needed():
    surface = surface_of(3, 10)
    field = NodeField.of(surface, NODES, NODES, dent(NODES, NODES))
    many = np.linspace(0.11, 0.89, 31)
    fit = fitted(surface, field, 1e-3, start=(many, many))
    assert fit.outcome == "within"
    assert set(fit.knots[0]) <= set(many)
    assert max(len(k) for k in fit.knots) <= 7
    # none of them can go
    for axis in (0, 1):
        for i in range(len(fit.knots[axis])):
            fewer = [np.delete(k, i) if axis == a else k for a, k in enumerate(fit.knots)]
            left = fit_net(insert_knots(surface, *fewer), field, 5e-5, None).residual
            assert np.linalg.norm(left, axis=2).max() > 1e-3


def test_knots_that_are_kept_stay():
    surface = surface_of(3, 10)
    field = NodeField.of(surface, NODES, NODES, dent(NODES, NODES))
    kept = np.array([0.05, 0.5]), np.array([0.93])
    fit = fitted(surface, field, 1e-3, kept=kept)
    assert fit.outcome == "within"
    assert set(kept[0]) <= set(fit.knots[0])
    assert set(kept[1]) <= set(fit.knots[1])


def test_no_two_knots_are_one_to_rounding():
    """Nodes and knots that are kept stand at the same places to rounding, as parameters of another face do."""
    surface = surface_of(3, 6)
    field = NodeField.of(surface, NODES, NODES, dent(NODES, NODES))
    kept = np.nextafter(NODES[9:-9:2], 0.0), np.nextafter(NODES[9:-9:2], 1.0)
    fit = fitted(surface, field, 1e-7, kept=kept)
    for knots in (fit.surface.knots_u, fit.surface.knots_v):
        steps = np.diff(np.unique(knots))
        assert steps.min() > 1e-9
        assert len(np.unique(knots)) == len(knots) - 6


def test_the_limit_of_control_points_is_kept_and_said():
    surface = surface_of(3, 10)
    field = NodeField.of(surface, NODES, NODES, dent(NODES, NODES))
    fit = fitted(surface, field, 1e-4, max_control_points=150)
    assert fit.outcome == "limit"
    assert np.prod(fit.surface.shape) <= 150
    assert fit.error.maximum == pytest.approx(measured(surface, fit, field).max(), abs=1e-14)
    assert fit.error.maximum > 1e-4
    # as good as the limit allows: far better than without a knot
    alone = fitted(surface, field, 1e-4, refine=False)
    assert fit.error.maximum < 0.5 * alone.error.maximum


def test_nodes_that_allow_no_finer_net_are_said():
    surface = surface_of(3, 6)
    few = np.linspace(0, 1, 9)
    rough = np.random.default_rng(3).normal(scale=0.1, size=(9, 9, 3))
    fit = fitted(surface, NodeField.of(surface, few, few, rough), 1e-9)
    assert fit.outcome in ("within", "nodes")
    assert max(fit.surface.shape) <= 9
    with pytest.raises(GeometryError, match="5 nodes along u do not determine 6 control points"):
        fitted(surface, NodeField.of(surface, few[::2], few, rough[::2]), 1e-9)


@pytest.mark.parametrize("rational", [False, True])
def test_without_refinement_it_is_the_least_squares_solution_on_the_net_as_read(rational):
    surface = surface_of(3, 8, rational=rational)
    u = np.linspace(0, 1, 25)
    rough = np.random.default_rng(1).normal(scale=0.01, size=(25, 25, 3))
    fit = fitted(surface, NodeField.of(surface, u, u, rough), 1e-9, refine=False)
    assert fit.surface.shape == surface.shape
    # the displacement of the surface for each control point by itself, from evaluations
    w = np.ones(surface.shape) if surface.weights is None else surface.weights
    columns = []
    for k in range(64):
        net = surface.control_points.copy()
        net.reshape(-1, 3)[k, 0] += 1.0
        moved = surface.with_control_points(net).evaluate(u[:, None], u) - surface.evaluate(u[:, None], u)
        columns.append(moved[..., 0].ravel())
    full = np.stack(columns, axis=1)
    W = np.ones(625) if surface.weights is None else (full @ np.diag(1 / w.ravel())).sum(axis=1) ** -1
    W = W if surface.weights is None else 1.0 / (full / w.ravel()).sum(axis=1)
    expected = np.linalg.lstsq(full * W[:, None], rough.reshape(-1, 3) * W[:, None], rcond=None)[0]
    np.testing.assert_allclose(fit.fit.displacement.reshape(-1, 3), expected, atol=1e-10)
    assert fit.outcome == "nodes"


def test_nodes_that_are_no_material_ask_for_no_knot():
    surface = surface_of(3, 10)
    here = np.broadcast_to((NODES < 0.5)[:, None], (61, 61))
    both = dent(NODES, NODES, at=(0.25, 0.5)) + dent(NODES, NODES, at=(0.85, 0.5), width=0.02)
    fit = fitted(surface, NodeField.of(surface, NODES, NODES, both, counted=here), 1e-3)
    assert fit.outcome == "within"
    assert measured(surface, fit, fit_field := NodeField.of(surface, NODES, NODES, both))[here].max() <= 1e-3
    assert not (fit.knots[0] > 0.7).any()
    assert np.isfinite(fit_field.displacement).all()


def test_beyond_the_nodes_the_surface_stays():
    """Nodes over a piece of one large Bezier patch: knots come until the dent is there, and nothing moves elsewhere."""
    surface = surface_of(3, 4)
    u = np.linspace(0.6, 0.7, 41)
    field = NodeField.of(surface, u, u, dent(u, u, at=(0.65, 0.65), width=0.012, depth=0.02))
    fit = fitted(surface, field, 2e-4)
    assert fit.outcome == "within"
    assert measured(surface, fit, field).max() <= 2e-4
    t = np.linspace(0, 1, 400)
    moved = np.linalg.norm(fit.surface.evaluate(t[:, None], t) - surface.evaluate(t[:, None], t), axis=2)
    beyond = (t < 0.55) | (t > 0.75)
    assert moved[beyond].max() <= 2e-4
    assert moved[:, beyond].max() <= 2e-4
    assert max(fit.surface.shape) < 30


def test_held_curves_stay_and_knots_come_beside_them():
    surface = surface_of(3, 8)
    line = np.stack([np.full(50, 0.6), np.linspace(0, 1, 50)], axis=1)
    hold = Hold(curves=(line,))
    field = dent(NODES, NODES, at=(0.45, 0.5))
    field[NODES >= 0.59] = 0.0  # the lattice is anchored there
    field *= np.clip((0.59 - NODES) / 0.1, 0, 1)[:, None, None]
    nodes = NodeField.of(surface, NODES, NODES, field)
    fit = fitted(surface, nodes, 1e-3, constraint=lambda net: Given(hold.control_points(net)))
    assert fit.outcome == "within"
    t = np.linspace(0, 1, 301)
    held = np.full(301, 0.6)
    fine = insert_knots(surface, *fit.knots)
    np.testing.assert_array_equal(fit.surface.evaluate(held, t), fine.evaluate(held, t))
    np.testing.assert_allclose(fit.surface.evaluate(held, t), surface.evaluate(held, t), atol=1e-14)


def test_given_displacements_are_taken_exactly_and_the_rest_fits_around_them():
    surface = surface_of(3, 8, rational=True)
    row = np.random.default_rng(0).normal(scale=0.02, size=(8, 3))

    def edge(net: BSplineSurface) -> Given:
        mask = np.zeros(net.shape, dtype=bool)
        asked = np.zeros((*net.shape, 3))
        mask[0], asked[0] = True, row
        return Given(mask, asked)

    true = surface.with_control_points(surface.control_points + np.pad(row[None], ((0, 7), (0, 0), (0, 0))))
    field = true.evaluate(NODES[:, None], NODES) - surface.evaluate(NODES[:, None], NODES)
    fit = fitted(surface, NodeField.of(surface, NODES, NODES, field), 1e-9, constraint=edge)
    np.testing.assert_array_equal(fit.fit.displacement[0], row)
    assert fit.outcome == "within"
    assert np.abs(fit.fit.displacement[1:]).max() < 1e-12


def test_between_the_nodes_only_what_is_known_is_held_against_the_surface():
    surface = surface_of(3, 20)
    u = np.linspace(0, 1, 20)
    # a parabola is known exactly, and so is what the surface does with it
    bowl = np.zeros((20, 20, 3))
    bowl[..., 2] = (u[:, None] ** 2 - u[:, None]) * (u**2 + 0.3)
    field = NodeField.of(surface, u, u, bowl)
    fit = fit_net(surface, field, 0.0, None)
    assert np.linalg.norm(fit.residual, axis=2).max() < 1e-12
    assert between_nodes(fit, field) <= 1e-12
    # a surface that swings between nodes at rest
    still = NodeField.of(surface, u, u, np.zeros((20, 20, 3)))
    swing = np.zeros((*surface.shape, 3))
    swing[10, 10, 2] = 0.5
    away = fit_net(surface, still, 0.0, lambda net: Given(np.ones(net.shape, dtype=bool), swing))
    assert between_nodes(away, still) > 0.05


def test_nodes_between_nodes_are_on_the_interpolation_and_count_for_nothing():
    surface = surface_of(3, 8)
    u = np.unique(np.concatenate([NODES[::3], [0.11, 0.43]]))
    bowl = np.zeros((len(u), len(u), 3))
    bowl[..., 1] = (u[:, None] ** 2 + 0.2) * (u - u**2)
    field = NodeField.of(surface, u, u, bowl, counted=np.broadcast_to(u < 0.5, (len(u), len(u))))
    more = denser(field, surface.domain)
    assert len(more.u) == 2 * len(field.u) - 1
    np.testing.assert_allclose(
        more.displacement[..., 1], (more.u[:, None] ** 2 + 0.2) * (more.v - more.v**2), atol=1e-14
    )
    np.testing.assert_array_equal(more.u[::2], field.u)
    np.testing.assert_array_equal(more.displacement[::2, ::2], field.displacement)
    np.testing.assert_array_equal(more.counted[::2, ::2], field.counted)
    assert more.counted.sum() == field.counted.sum()
    # swings that the nodes alone allow are damped by those between
    rough = np.random.default_rng(5).normal(scale=0.02, size=(25, 25, 3))
    coarse = np.linspace(0, 1, 25)
    knots = np.linspace(0.05, 0.95, 15)
    net = insert_knots(surface, knots, knots)
    field = NodeField.of(net, coarse, coarse, rough)
    swing, damped = (between_nodes(fit_net(net, f, 0.0, None), field) for f in (field, denser(field, net.domain)))
    assert damped < swing


def test_displacements_that_are_not_numbers_are_refused():
    surface = surface_of(3, 8)
    bad = np.zeros((61, 61, 3))
    bad[3, 4, 1] = np.nan
    with pytest.raises(GeometryError, match="not finite"):
        NodeField.of(surface, NODES, NODES, bad)


@settings(max_examples=25, deadline=None)
@given(
    degrees=st.tuples(st.integers(1, 5), st.integers(1, 5)),
    counts=st.tuples(st.integers(0, 6), st.integers(0, 6)),
    rational=st.booleans(),
    seed=st.integers(0, 2**31),
    tolerance=st.sampled_from([0.03, 3e-3, 5e-4]),
    most=st.sampled_from([60, 400, 10000]),
)
def test_any_net_and_any_field(degrees, counts, rational, seed, tolerance, most):
    """What a fit says of itself is true: the tolerance, the error, the limit, the bits."""
    rng = np.random.default_rng(seed)
    knots = [
        np.concatenate([np.full(p + 1, 2.0), 2.0 + 3.0 * np.sort(rng.uniform(size=n)), np.full(p + 1, 5.0)])
        for p, n in zip(degrees, counts, strict=True)
    ]
    shape = [len(k) - p - 1 for k, p in zip(knots, degrees, strict=True)]
    net = rng.normal(size=(*shape, 3))
    surface = BSplineSurface(
        net, *knots, *degrees, rng.uniform(0.5, 2.0, shape) if rational else None
    )  # fmt: skip
    u, v = (np.unique(np.concatenate([np.linspace(2, 5, 45), k])) for k in knots)
    waves = rng.normal(size=(3, 5))
    field = np.stack(
        [a * np.sin(b * u[:, None] + c) * np.cos(d * v + e) * 0.1 for a, b, c, d, e in waves], axis=-1
    ) * np.exp(-((u[:, None] - 3.5) ** 2 + (v - 3.5) ** 2))[..., None]  # fmt: skip
    nodes = NodeField.of(surface, u, v, field)
    try:
        fit = fitted(surface, nodes, tolerance, max_control_points=most)
    except GeometryError as error:  # spans narrower than the nodes
        assert "do not determine" in error.what
        return
    fit.surface.validate()
    distance = measured(surface, fit, nodes)
    assert distance.max() == pytest.approx(fit.error.maximum, abs=1e-12)
    assert (fit.outcome == "within") == (fit.error.maximum <= tolerance)
    assert np.prod(fit.surface.shape) <= max(most, np.prod(shape))
    if fit.outcome == "limit":
        r, s = fit.surface.shape
        assert min((r + 1) * s, r * (s + 1)) > 0.5 * most
    again = fitted(surface, nodes, tolerance, max_control_points=most)
    np.testing.assert_array_equal(again.surface.control_points, fit.surface.control_points)
