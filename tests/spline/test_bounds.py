"""Bounds on derivatives and on the sag of cells, against dense samples."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.spline.bounds import derivative_bounds, sag_bilinear, sag_triangles
from cadsculpt.spline.matrices import breakpoints
from cadsculpt.spline.surface import BSplineSurface


def _random_surface(rng, rational):
    p, q = (int(x) for x in rng.integers(1, 6, 2))
    r, s = p + 1 + int(rng.integers(0, 5)), q + 1 + int(rng.integers(0, 5))
    knots = []
    for degree, count in ((p, r), (q, s)):
        inner = np.sort(rng.uniform(2.0, 5.0, count - degree - 1))
        if len(inner) > 1 and rng.random() < 0.3:
            inner[1] = inner[0] if degree > 1 else inner[1]
        knots.append(np.concatenate([np.full(degree + 1, 2.0), inner, np.full(degree + 1, 5.0)]))
    net = np.stack(np.meshgrid(np.arange(r), np.arange(s), indexing="ij"), axis=-1).astype(float)
    net = np.concatenate([net, np.zeros((r, s, 1))], axis=2) + rng.normal(scale=0.6, size=(r, s, 3))
    weights = rng.uniform(0.3, 3.0, (r, s)) if rational else None
    return BSplineSurface(net + 50.0, knots[0], knots[1], p, q, weights)


def _spans(surface):
    u, v = breakpoints(surface.knots_u, surface.degree_u), breakpoints(surface.knots_v, surface.degree_v)
    for a in range(len(u) - 1):
        for b in range(len(v) - 1):
            yield a, b, (u[a], u[a + 1]), (v[b], v[b + 1])


@pytest.mark.parametrize("rational", [False, True])
def test_no_derivative_is_longer_than_its_bound(rational):
    rng = np.random.default_rng(int(rational))
    for _ in range(25):
        surface = _random_surface(rng, rational)
        bounds = derivative_bounds(surface)
        for a, b, (u0, u1), (v0, v1) in _spans(surface):
            # inside the span: at its ends another span's derivatives may be meant
            u = u0 + (u1 - u0) * rng.uniform(1e-6, 1 - 1e-6, 60)
            v = v0 + (v1 - v0) * rng.uniform(1e-6, 1 - 1e-6, 60)
            d = surface.derivatives(u, v, 2)
            for k, value in enumerate((d[1, 0], d[0, 1], d[2, 0], d[1, 1], d[0, 2])):
                assert np.linalg.norm(value, axis=1).max() <= bounds[a, b, k] * (1 + 1e-9) + 1e-9


@pytest.mark.parametrize("rational", [False, True])
def test_the_surface_stays_within_the_sag_of_its_cells(rational):
    rng = np.random.default_rng(10 + int(rational))
    for _ in range(25):
        surface = _random_surface(rng, rational)
        bounds = derivative_bounds(surface)
        for a, b, (u0, u1), (v0, v1) in _spans(surface):
            hu, hv = (u1 - u0) * rng.uniform(0.2, 1.0), (v1 - v0) * rng.uniform(0.2, 1.0)
            cu, cv = rng.uniform(u0, u1 - hu), rng.uniform(v0, v1 - hv)
            s, t = rng.random((2, 80))
            true = surface.evaluate(cu + s * hu, cv + t * hv)
            corner = surface.evaluate(cu + np.array([0, hu, 0, hu]), cv + np.array([0, 0, hv, hv]))
            bilinear = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], axis=1) @ corner
            slack = 1e-12
            assert np.linalg.norm(true - bilinear, axis=1).max() <= sag_bilinear(bounds[a, b], hu, hv) + slack
            # any flat triangle between three points of the cell, not the cell's halves alone
            p, q = rng.random((2, 3))
            w = rng.dirichlet(np.ones(3), 80)
            flat = w @ surface.evaluate(cu + p * hu, cv + q * hv)
            true = surface.evaluate(cu + (w @ p) * hu, cv + (w @ q) * hv)
            assert np.linalg.norm(true - flat, axis=1).max() <= sag_triangles(bounds[a, b], hu, hv) + slack


def test_a_parabola_reaches_its_bound():
    # z = x^2: S_uu = (0, 0, 2) everywhere, and a chord of length h leaves it by h^2 / 4
    net = np.array([[[0.0, y, 0.0], [0.5, y, 0.0], [1.0, y, 1.0]] for y in (0.0, 1.0)]).transpose(1, 0, 2)
    surface = BSplineSurface(net, np.array([0.0, 0, 0, 1, 1, 1]), np.array([0.0, 0, 1, 1]), 2, 1)
    bounds = derivative_bounds(surface)
    assert bounds[0, 0, 2:] == pytest.approx([2.0, 0.0, 0.0], abs=1e-15)
    assert sag_bilinear(bounds[0, 0], 0.5, 1.0) == pytest.approx(0.5**2 / 4)
    middle = surface.evaluate(0.5, 0.0)
    chord = 0.5 * (surface.evaluate(0.25, 0.0) + surface.evaluate(0.75, 0.0))
    assert np.linalg.norm(middle - chord) == pytest.approx(0.5**2 / 4)


def test_bounds_follow_a_deformation_and_ignore_a_translation():
    surface = _random_surface(np.random.default_rng(3), True)
    moved = derivative_bounds(surface, surface.control_points + [1000.0, -500.0, 200.0])
    assert moved == pytest.approx(derivative_bounds(surface), rel=1e-7, abs=1e-7)
    doubled = derivative_bounds(surface, 2.0 * surface.control_points)
    assert doubled == pytest.approx(2.0 * derivative_bounds(surface), rel=1e-9)


def test_a_cylinder_has_no_twist():
    """Weights that are products: the mixed derivative of an extruded arc is bounded by zero, not by its weights'
    slope."""
    c = np.sqrt(0.5)
    net = np.array([[[x, y, z] for z in (0.0, 30.0)] for x, y in ((5.0, 0.0), (5.0, 5.0), (0.0, 5.0))])
    weights = np.array([[1.0, 2.0], [c, 2 * c], [1.0, 2.0]])
    surface = BSplineSurface(net, np.array([0.0, 0, 0, 1, 1, 1]), np.array([0.0, 0, 1, 1]), 2, 1, weights)
    bounds = derivative_bounds(surface)[0, 0]
    assert bounds[3] == pytest.approx(0.0, abs=1e-9)
    d = surface.derivatives(np.linspace(0, 1, 50)[:, None], np.linspace(0, 1, 50), 1)
    for k, value in enumerate((d[1, 0], d[0, 1])):
        longest = np.linalg.norm(value, axis=-1).max()
        assert longest <= bounds[k] <= 4.01 * longest


def test_separable_weights_are_bounded_too():
    rng = np.random.default_rng(21)
    for _ in range(15):
        surface = _random_surface(rng, True)
        r, s = surface.shape
        from dataclasses import replace

        surface = replace(surface, weights=rng.uniform(0.3, 3, (r, 1)) * rng.uniform(0.3, 3, (1, s)))
        bounds = derivative_bounds(surface)
        for a, b, (u0, u1), (v0, v1) in _spans(surface):
            u = u0 + (u1 - u0) * rng.uniform(1e-6, 1 - 1e-6, 60)
            v = v0 + (v1 - v0) * rng.uniform(1e-6, 1 - 1e-6, 60)
            d = surface.derivatives(u, v, 2)
            for k, value in enumerate((d[1, 0], d[0, 1], d[2, 0], d[1, 1], d[0, 2])):
                assert np.linalg.norm(value, axis=1).max() <= bounds[a, b, k] * (1 + 1e-9) + 1e-9
