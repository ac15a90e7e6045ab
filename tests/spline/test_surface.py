"""Evaluation against scipy and exact rational arithmetic (paper eq. 1 and 2)."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy.interpolate import NdBSpline

from cadsculpt.errors import GeometryError
from cadsculpt.spline.matrices import TransformationMatrices, breakpoints, cells_per_span, design_matrix
from cadsculpt.spline.surface import BSplineSurface


def random_surface(degree_u: int, degree_v: int, seed: int, *, rational: bool, clamped: bool = True) -> BSplineSurface:
    rng = np.random.default_rng(seed)

    def knots(degree: int, count: int) -> np.ndarray:
        if not clamped:
            return np.cumsum(rng.uniform(0.3, 1.4, count + degree + 1)) - 7.0
        inner = np.sort(rng.uniform(-3.0, 11.0, count - degree - 1))
        return np.concatenate([np.full(degree + 1, -3.0), inner, np.full(degree + 1, 11.0)])

    r, s = degree_u + 5, degree_v + 3
    points = rng.normal(size=(r, s, 3)) * 10
    weights = rng.uniform(0.3, 3.0, (r, s)) if rational else None
    return BSplineSurface(points, knots(degree_u, r), knots(degree_v, s), degree_u, degree_v, weights)


@pytest.mark.parametrize("degree", range(1, 12))
@pytest.mark.parametrize("rational", [False, True])
@pytest.mark.parametrize("clamped", [True, False])
def test_points_and_derivatives_agree_with_scipy(degree, rational, clamped):
    surface = random_surface(degree, max(1, 12 - degree), degree, rational=rational, clamped=clamped)
    (u0, u1), (v0, v1) = surface.domain
    rng = np.random.default_rng(99)
    u, v = rng.uniform(u0, u1, 200), rng.uniform(v0, v1, 200)
    w = np.ones(surface.shape) if surface.weights is None else surface.weights
    homogeneous = np.concatenate([surface.control_points * w[..., None], w[..., None]], axis=2)
    reference = NdBSpline((surface.knots_u, surface.knots_v), homogeneous, (surface.degree_u, surface.degree_v))
    h = reference(np.stack([u, v], axis=1))
    points = h[:, :3] / h[:, 3:]
    d = surface.derivatives(u, v, 2)
    scale = np.abs(surface.control_points).max()
    np.testing.assert_allclose(d[0, 0], points, atol=1e-12 * scale, rtol=0)
    np.testing.assert_array_equal(surface.evaluate(u, v), d[0, 0])
    h_u = reference(np.stack([u, v], axis=1), nu=(1, 0))
    s_u = (h_u[:, :3] - h_u[:, 3:] * points) / h[:, 3:]
    np.testing.assert_allclose(d[1, 0], s_u, atol=1e-11 * np.abs(s_u).max(), rtol=0)
    h_v, h_uv = reference(np.stack([u, v], axis=1), nu=(0, 1)), reference(np.stack([u, v], axis=1), nu=(1, 1))
    s_v = (h_v[:, :3] - h_v[:, 3:] * points) / h[:, 3:]
    s_uv = (h_uv[:, :3] - h_uv[:, 3:] * points - h_u[:, 3:] * s_v - h_v[:, 3:] * s_u) / h[:, 3:]
    np.testing.assert_allclose(d[1, 1], s_uv, atol=1e-10 * max(1.0, np.abs(s_uv).max()), rtol=0)


def test_basis_functions_against_rational_arithmetic():
    knots = [Fraction(x) for x in (0, 0, 0, 0, 1, 2, 2, 3, 5, 5, 5, 5)]
    degree, count = 3, 8

    def basis(i: int, k: int, t: Fraction) -> Fraction:
        if k == 0:
            return Fraction(int(knots[i] <= t < knots[i + 1]))
        value = Fraction(0)
        if knots[i + k] > knots[i]:
            value += (t - knots[i]) / (knots[i + k] - knots[i]) * basis(i, k - 1, t)
        if knots[i + k + 1] > knots[i + 1]:
            value += (knots[i + k + 1] - t) / (knots[i + k + 1] - knots[i + 1]) * basis(i + 1, k - 1, t)
        return value

    parameters = [Fraction(n, 16) for n in range(80)]
    exact = np.array([[float(basis(i, degree, t)) for i in range(count)] for t in parameters])
    ours = design_matrix(np.array([float(k) for k in knots]), degree, np.array([float(t) for t in parameters]))
    np.testing.assert_allclose(ours, exact, atol=4e-16, rtol=0)


@pytest.mark.parametrize("rational", [False, True])
def test_matrices_make_the_same_points_as_evaluation(rational):
    surface = random_surface(3, 2, 5, rational=rational)
    matrices = TransformationMatrices.of(surface, 4, 3)
    points, s_u, s_v = matrices.tangents(surface.control_points, surface.weights)
    d = surface.derivatives(matrices.u[:, None], matrices.v, 1)
    scale = np.abs(surface.control_points).max()
    np.testing.assert_allclose(points, d[0, 0], atol=1e-12 * scale)
    np.testing.assert_allclose(matrices.points(surface.control_points, surface.weights), d[0, 0], atol=1e-12 * scale)
    np.testing.assert_allclose(s_u, d[1, 0], atol=1e-11 * np.abs(s_u).max())
    np.testing.assert_allclose(s_v, d[0, 1], atol=1e-11 * np.abs(s_v).max())
    assert set(breakpoints(surface.knots_u, 3)) <= set(matrices.u)
    np.testing.assert_allclose(matrices.A_u.sum(axis=1), 1.0, atol=1e-14)
    assert (matrices.A_u >= 0).all()


def test_no_cell_straddles_a_knot_and_cells_follow_the_length():
    surface = random_surface(3, 3, 8, rational=False)
    cells = cells_per_span(surface, 0, 60)
    matrices = TransformationMatrices.of(surface, cells, 2)
    for knot in breakpoints(surface.knots_u, 3):
        assert knot in matrices.u
    np.testing.assert_array_equal(np.diff(matrices.span_start_u), cells)


def test_normals_are_unit_and_point_out():
    surface = random_surface(3, 3, 2, rational=True)
    n = surface.normal(1.0, 2.0)
    d = surface.derivatives(1.0, 2.0)
    assert np.linalg.norm(n) == pytest.approx(1.0, rel=1e-14)
    assert n @ d[1, 0] == pytest.approx(0, abs=1e-10)
    assert n @ np.cross(d[1, 0], d[0, 1]) > 0


def test_outside_and_nan_parameters():
    surface = random_surface(2, 2, 2, rational=False)
    assert np.isnan(surface.evaluate(np.nan, 0.0)).all()
    (u0, u1), (v0, v1) = surface.domain
    corner = surface.evaluate(u1, v1)
    np.testing.assert_allclose(corner, surface.control_points[-1, -1], atol=1e-12)
    np.testing.assert_allclose(surface.evaluate(u0, v0), surface.control_points[0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"knots_u": np.array([0.0, 0, 1])}, "knots in u"),
        ({"knots_u": np.array([0.0, 0, 1, 0.5, 2, 2])}, "non-decreasing"),
        ({"weights": np.array([[1.0, 1, 1]] * 3) * 0}, "not positive"),
        ({"control_points": np.full((3, 3, 3), np.nan)}, "not finite"),
        ({"knots_u": np.array([0.0, 0, 0, 0, 0, 0])}, "empty"),
        ({"degree_u": 0}, "degree 0"),
    ],
)
def test_what_is_no_surface_is_named(change, message):
    base = {
        "control_points": np.random.default_rng(0).normal(size=(3, 3, 3)),
        "knots_u": np.array([0.0, 0, 0, 1, 1, 1]),
        "knots_v": np.array([0.0, 0, 0, 1, 1, 1]),
        "degree_u": 2,
        "degree_v": 2,
    }
    with pytest.raises(GeometryError, match=message):
        BSplineSurface(**{**base, **change}).validate()


def test_closed_directions_are_seen():
    angle = np.linspace(0, 2 * np.pi, 9)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    ring[-1] = ring[0]
    points = np.stack([ring, ring + [0, 0, 1]], axis=1)
    knots = np.concatenate([np.zeros(3), np.arange(1, 7), np.full(3, 7.0)])
    surface = BSplineSurface(points, knots, np.array([0.0, 0, 1, 1]), 2, 1)
    assert surface.closed_u
    assert not surface.closed_v
