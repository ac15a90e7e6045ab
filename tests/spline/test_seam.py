"""Common edges: matched point by point, measured on the surfaces; what is asked along a curve, as equations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadsculpt.spline.adapt import Goal, fit_to_tolerance
from cadsculpt.spline.equations import Asked, displacement_along
from cadsculpt.spline.follow import Following, Lead, Side, boundary_rows, edge_knots, follows, side_of
from cadsculpt.spline.hold import Hold
from cadsculpt.spline.net_fit import Given, NodeField, fit_net
from cadsculpt.spline.refine import insert_knots
from cadsculpt.spline.seam import angle, closest, gap, own_seam, seam_of
from cadsculpt.spline.surface import BSplineSurface

Array = np.ndarray


def net(seed: int, degrees=(3, 2), counts=(7, 6), *, rational: bool = True, low: float = 0.0) -> BSplineSurface:
    rng = np.random.default_rng(seed)
    knots = [
        np.concatenate(
            [np.full(p + 1, low), low + np.sort(rng.uniform(0.1, 0.9, n - p - 1)), np.full(p + 1, low + 1.0)]
        )
        for p, n in zip(degrees, counts, strict=True)
    ]
    greville = [
        np.array([k[i + 1 : i + p + 1].mean() for i in range(n)])
        for k, p, n in zip(knots, degrees, counts, strict=True)
    ]
    x, y = np.meshgrid(*greville, indexing="ij")
    points = np.stack([x, y, 0.1 * rng.normal(size=counts)], axis=-1)
    return BSplineSurface(points, *knots, *degrees, rng.uniform(0.6, 1.5, counts) if rational else None)


@pytest.mark.parametrize("rational", [False, True])
def test_displacements_and_their_derivatives_along_a_curve(rational):
    surface = net(0, rational=rational)
    rng = np.random.default_rng(1)
    delta = rng.normal(size=(*surface.shape, 3))
    moved = surface.with_control_points(surface.control_points + delta)
    uv = rng.uniform(0, 1, (50, 2))
    truth = moved.derivatives(*uv.T, 1) - surface.derivatives(*uv.T, 1)
    np.testing.assert_allclose(displacement_along(surface, delta, uv), truth[0, 0], atol=1e-13)
    direction = rng.normal(size=(50, 2))
    along = direction[:, :1] * truth[1, 0] + direction[:, 1:] * truth[0, 1]
    np.testing.assert_allclose(displacement_along(surface, delta, uv, direction), along, atol=1e-12)


def test_what_is_asked_comes_before_the_nodes():
    surface = net(0, counts=(9, 9))
    u = np.linspace(0, 1, 25)
    t = np.linspace(0, 1, 100)
    curve = np.stack([0.2 + 0.5 * t, 0.3 + 0.3 * np.sin(2 * t)], axis=1)
    delta = np.zeros((*surface.shape, 3))
    delta[3:6, 3:6] = np.random.default_rng(0).normal(scale=0.1, size=(3, 3, 3))
    value = displacement_along(surface, delta, curve)
    nodes = NodeField.of(surface, u, u, np.zeros((25, 25, 3)))
    for tolerance in (1e-3, 1e-6):
        asked = Asked(curve, value, np.full(100, tolerance))
        fit = fit_net(
            surface,
            nodes,
            0.0,
            lambda net, asked=asked: Given(np.zeros(net.shape, bool), None, (asked,)),
            tolerance=1e-3,
        )
        off = np.linalg.norm(fit.along(curve) - value, axis=1).max()
        assert off == pytest.approx(fit.lacking().max() * tolerance)
        moved = np.linalg.norm(fit.residual, axis=2).max()
        assert moved > 0.01  # the nodes give way
        if tolerance == 1e-6:
            assert off < 1e-3 * moved


def test_the_nearest_point_is_found():
    surface = net(2)
    uv = np.random.default_rng(3).uniform(0.05, 0.95, (40, 2))
    jet = surface.derivatives(*uv.T, 1)
    normal = surface.normal(*uv.T)
    points = jet[0, 0] + 0.01 * normal
    found = closest(surface, points, uv + 0.02)
    np.testing.assert_allclose(found, uv, atol=1e-9)


def halves(seed: int = 4) -> tuple[BSplineSurface, BSplineSurface]:
    """Two nets with one boundary curve, the second running along it backwards and twice as fast."""
    a = net(seed, (3, 3), (6, 8))
    weights = a.weights.copy()
    row, w = a.control_points[-1], weights[-1]
    rng = np.random.default_rng(seed + 1)
    points = np.concatenate([row[None, ::-1], row[None, ::-1] + [[[0.3, 0, 0]]], row[None, ::-1] + [[[0.7, 0, 0.1]]]])
    b = BSplineSurface(
        points,
        np.array([5.0, 5, 5, 6, 6, 6]),
        (2.0 - 2.0 * a.knots_v)[::-1].copy(),
        2,
        3,
        np.concatenate([w[None, ::-1], rng.uniform(0.6, 1.5, (2, 8))]),
    )
    return a, b


def test_a_seam_is_matched_however_its_sides_run():
    a, b = halves()
    t = np.linspace(0, 1, 70)
    edge_a = np.stack([np.ones(70), t], axis=1)
    others = [np.stack([np.linspace(5, 6, 9), np.full(9, v)], axis=1) for v in (0.0, 2.0)]
    edge_b = np.stack([np.full(70, 5.0), 2 * t], axis=1)
    seam = seam_of(0, a, edge_a, 1, b, [*others, edge_b])
    assert seam is not None
    np.testing.assert_allclose(seam.uv_b[:, 1], 2.0 - 2.0 * seam.uv_a[:, 1], atol=1e-9)
    assert gap(seam, a, b) <= 1e-12
    assert seam.allowed == seam.tolerance == pytest.approx(1e-7 * max(a.size, b.size))
    assert seam_of(0, a, edge_a, 1, b, others) is None
    # measured: one side moved by a known amount
    lifted = b.with_control_points(b.control_points + [0, 0, 0.25])
    assert gap(seam, a, lifted) == pytest.approx(0.25)
    turned = angle(seam, a, b)
    n_a, n_b = a.normal(*seam.uv_a.T), b.normal(*seam.uv_b.T)
    by_hand = np.degrees(np.arccos(np.clip(np.abs(np.einsum("nc,nc->n", n_a, n_b)), 0, 1))).max()
    assert turned == pytest.approx(by_hand, abs=1e-5)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), rational=st.booleans(), tangent=st.booleans())
def test_a_side_takes_any_curve_of_its_own_net(seed, rational, tangent):
    """Rows that are known come back, from the curve and the slope across it that they make."""
    surface = net(seed, (3, 3), (7, 9), rational=rational)
    rng = np.random.default_rng(seed)
    delta = np.zeros((*surface.shape, 3))
    delta[:2] = rng.normal(scale=0.1, size=(2, 9, 3))
    t = np.linspace(0, 1, 300)
    uv = np.stack([np.zeros(300), t], axis=1)
    direction = np.stack([np.full(300, 0.8), np.full(300, 0.3)], axis=1)
    across = displacement_along(surface, delta, uv, direction) if tangent else None
    lead = Lead(uv, displacement_along(surface, delta, uv), 1e-6, across, direction, np.full(300, 1e-6))
    assert side_of(surface, uv) == Side(0, 0)
    rows = boundary_rows(surface, Side(0, 0), lead)
    assert len(rows) == (2 if tangent else 1)
    for row, true in zip(rows, delta, strict=False):
        np.testing.assert_allclose(row, true, atol=1e-9)
    given_ = Following(Hold(), (lead,)).given(surface)
    np.testing.assert_array_equal(given_.mask.any(axis=1), np.arange(7) < len(rows))
    field = NodeField.of(surface, np.linspace(0, 1, 41), np.linspace(0, 1, 41), np.zeros((41, 41, 3)))
    for knots in edge_knots(surface, field, (lead,), 1000):
        assert len(knots) == 0


def test_knots_are_added_until_the_side_follows():
    surface = net(5, (3, 3), (6, 5), rational=False)
    t = np.linspace(0, 1, 400)
    uv = np.stack([np.ones(400), t], axis=1)
    wave = np.zeros((400, 3))
    wave[:, 2] = 0.1 * np.sin(9 * t)
    u = np.linspace(0, 1, 81)
    nodes = np.zeros((81, 81, 3))
    field = NodeField.of(surface, u, u, nodes)
    counts = []
    for tolerance in (1e-3, 1e-5):
        lead = Lead(uv, wave, tolerance)
        knots = edge_knots(surface, field, (lead,), 5000)
        assert len(knots[0]) == 0
        counts.append(len(knots[1]))
        following = Following(Hold(), (lead,))
        fit = fit_to_tolerance(surface, field, Goal(1.0, 1e-9, 5000), constraint=following.given, kept=knots)
        assert np.linalg.norm(fit.fit.along(uv) - wave, axis=1).max() <= tolerance
    assert 2 <= counts[0] < counts[1] <= 60


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7])
@pytest.mark.parametrize("width", [0.05, 0.2])
def test_a_side_follows_with_about_as_few_knots_as_can_be(width, tolerance):
    """Against evenly spread knots, the fewest of which follow, and what the order of convergence asks for at the least."""
    surface = net(5, (3, 3), (6, 5), rational=False)
    t = np.linspace(0, 1, 1200)
    dent = np.zeros((1200, 3))
    dent[:, 2] = np.exp(-(((t - 0.4) / width) ** 2) / 2)
    lead = Lead(np.stack([np.ones(1200), t], axis=1), dent, tolerance)
    nodes = np.linspace(0, 1, 801)
    field = NodeField.of(surface, np.linspace(0, 1, 9), nodes, np.zeros((9, 801, 3)))
    _, found = edge_knots(surface, field, (lead,), 10**6)
    assert follows(insert_knots(surface, [], found), (lead,))
    inner = np.unique(surface.knots_v)[1:-1]

    def even(n: int) -> bool:
        return follows(insert_knots(surface, [], np.setdiff1d(np.arange(1, n) / n, inner)), (lead,))

    few = next(n for n in (int(6 * 1.08**k) for k in range(99)) if even(n))
    assert len(found) <= (0.6 if width == 0.05 else 1.0) * few + 3
    # equal errors h^4 |d4 f| / 384 in every span (de Boor 1978): 1 / h summed up over the curve
    x = (t - 0.4) / width
    fourth = np.abs((x**4 - 6 * x**2 + 3) * dent[:, 2]) / width**4
    least = np.trapezoid((fourth / (384 * tolerance)) ** 0.25, t)
    assert len(found) <= 1.6 * least + 5


def test_the_seam_of_a_closed_surface():
    angle_ = np.linspace(0, 2 * np.pi, 9)
    points = np.stack(
        [np.outer(f(angle_), np.ones(2)) for f in (np.cos, np.sin)] + [np.outer(np.ones(9), [0, 1])], axis=-1
    )
    points[-1] = points[0]
    knots = np.concatenate([np.zeros(4), np.arange(1, 6), np.full(4, 6.0)])
    tube = BSplineSurface(points, knots, np.array([0.0, 0, 1, 1]), 3, 1)
    seam = own_seam(3, tube, 0)
    assert (seam.a, seam.b) == (3, 3)
    assert seam.rest_gap == 0.0
    torn = points.copy()
    torn[-1, :, 2] += 0.1
    assert gap(seam, tube.with_control_points(torn), tube.with_control_points(torn)) == pytest.approx(0.1)
