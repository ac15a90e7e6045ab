"""The refit (paper eq. 3): its own surface comes back, what is held stays, what did not move keeps its bits."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.errors import GeometryError
from cadsculpt.spline.matrices import span_parameters
from cadsculpt.spline.refit import Refit, held_control_points
from cadsculpt.spline.surface import BSplineSurface


def surface_of(degree: int, inner: int, seed: int = 0, *, rational: bool = False) -> BSplineSurface:
    rng = np.random.default_rng(seed)
    knots = np.concatenate([np.zeros(degree + 1), (np.arange(inner) + 1) / (inner + 1), np.ones(degree + 1)])
    n = inner + degree + 1
    x = np.array([knots[i + 1 : i + degree + 1].mean() for i in range(n)])
    points = np.stack([*np.meshgrid(x, x, indexing="ij"), rng.normal(scale=0.1, size=(n, n))], axis=-1)
    weights = rng.uniform(0.6, 1.6, (n, n)) if rational else None
    return BSplineSurface(points, knots, knots, degree, degree, weights)


def nodes_of(surface: BSplineSurface, cells: int) -> tuple[np.ndarray, np.ndarray]:
    return (
        span_parameters(surface.knots_u, surface.degree_u, cells)[0],
        span_parameters(surface.knots_v, surface.degree_v, cells)[0],
    )


@pytest.mark.parametrize("degree", range(1, 12))
@pytest.mark.parametrize("rational", [False, True])
def test_a_surface_gets_its_own_net_back(degree, rational):
    surface = surface_of(degree, 4, rational=rational)
    u, v = nodes_of(surface, max(3, degree))
    refit = Refit.of(surface, u, v)
    rng = np.random.default_rng(degree)
    true = rng.normal(scale=0.05, size=surface.control_points.shape)
    moved = surface.with_control_points(surface.control_points + true)
    displacement = moved.evaluate(u[:, None], v) - surface.evaluate(u[:, None], v)
    delta = refit.fit(displacement)
    # the data carry rounding of 1e-16; the basis' condition number (2^degree a direction) is what may amplify it
    assert np.abs(delta - true).max() <= 1e-12 * max(1.0, 4.0 ** (degree - 7))
    assert refit.error(displacement, delta).maximum <= 1e-13
    np.testing.assert_array_equal(refit.fit(np.zeros_like(displacement)), 0.0)


def test_only_the_support_of_moved_nodes_is_free():
    surface = surface_of(3, 20)
    u, v = nodes_of(surface, 2)
    refit = Refit.of(surface, u, v)
    displacement = np.zeros((len(u), len(v), 3))
    bump = np.exp(-200 * ((u[:, None] - 0.5) ** 2 + (v - 0.5) ** 2))
    displacement[..., 2] = np.where(bump > 1e-3, bump, 0.0)
    delta = refit.fit(displacement)
    moved = np.abs(delta).max(axis=2) > 0
    for axis, t in ((0, u), (1, v)):
        hit = t[(bump > 1e-3).any(axis=1 - axis)]
        knots = surface.knots_u
        for i in np.flatnonzero(moved.any(axis=1 - axis)):
            assert knots[i] <= hit[-1]
            assert knots[i + 4] >= hit[0]
    assert 0 < moved.sum() < moved.size
    np.testing.assert_array_equal(delta[~moved], 0.0)


@pytest.mark.parametrize("rational", [False, True])
def test_held_curves_do_not_move_and_the_rest_is_the_least_squares_solution(rational):
    surface = surface_of(3, 8, rational=rational)
    u, v = nodes_of(surface, 3)
    t = np.linspace(0, 2 * np.pi, 400)
    circle = np.stack([0.5 + 0.2 * np.cos(t), 0.5 + 0.2 * np.sin(t)], axis=1)
    held = held_control_points(surface, circle)
    assert 0 < held.sum() < held.size
    refit = Refit.of(surface, u, v, held)
    rng = np.random.default_rng(1)
    displacement = rng.normal(size=(len(u), len(v), 3)) * 0.01
    delta = refit.fit(displacement)
    np.testing.assert_array_equal(delta[held], 0.0)
    moved = surface.with_control_points(surface.control_points + delta)
    np.testing.assert_array_equal(moved.evaluate(*circle.T), surface.evaluate(*circle.T))
    # dense least squares over the free control points, weighted as the rational fit is
    full = np.kron(refit.A_u, refit.A_v) * refit.weights.ravel() / 1.0
    data = (displacement * refit.W[..., None]).reshape(-1, 3)
    free = ~held.ravel()
    expected = np.linalg.lstsq(full[:, free], data, rcond=None)[0]
    np.testing.assert_allclose(delta.reshape(-1, 3)[free], expected, atol=1e-11)


def test_a_closed_surface_stays_closed():
    degree, n = 3, 12
    angle = np.linspace(0, 2 * np.pi, n)
    z = np.linspace(0, 1, 5)
    points = np.stack(
        [np.broadcast_to(f(angle)[:, None], (n, 5)) for f in (np.cos, np.sin)] + [np.broadcast_to(z, (n, 5))], axis=-1
    )
    points[-1] = points[0]
    knots_u = np.concatenate([np.zeros(4), np.arange(1, n - degree), np.full(4, n - degree)])
    knots_v = np.array([0, 0, 0, 0, 1, 2, 2, 2, 2], dtype=float)
    surface = BSplineSurface(points, knots_u, knots_v, 3, 3)
    assert surface.closed_u
    u, v = nodes_of(surface, 3)
    refit = Refit.of(surface, u[:-1], v)
    rng = np.random.default_rng(2)
    delta = refit.fit(rng.normal(size=(len(u) - 1, len(v), 3)) * 0.1)
    np.testing.assert_array_equal(delta[0], delta[-1])
    assert np.abs(delta).max() > 0


def test_too_few_nodes_are_named():
    surface = surface_of(3, 8)
    with pytest.raises(GeometryError, match="nodes along u do not determine"):
        Refit.of(surface, np.linspace(0, 1, 7), np.linspace(0, 1, 40))


def test_the_error_is_the_distance_to_the_nodes():
    surface = surface_of(3, 2)
    u, v = nodes_of(surface, 6)
    refit = Refit.of(surface, u, v)
    displacement = np.zeros((len(u), len(v), 3))
    displacement[7, 9, 2] = 1.0
    delta = refit.fit(displacement)
    moved = surface.with_control_points(surface.control_points + delta)
    nodes = surface.evaluate(u[:, None], v) + displacement
    distance = np.linalg.norm(moved.evaluate(u[:, None], v) - nodes, axis=2)
    error = refit.error(displacement, delta)
    assert error.maximum == pytest.approx(distance.max(), rel=1e-12)
    assert error.rms == pytest.approx(np.sqrt(np.mean(distance**2)), rel=1e-12)
