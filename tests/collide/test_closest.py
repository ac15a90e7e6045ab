"""Closest points: against dense samples, scipy, and closed formulas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from cadsculpt.collide.closest import closest_points
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.collide.newton import DISTANCE, POINT, U, V, approach, basis_2, newton
from cadsculpt.collide.workspace import Workspace
from cadsculpt.spline.surface import BSplineSurface


def _dense(surface, count=160):
    (u0, u1), (v0, v1) = surface.domain
    u, v = np.meshgrid(np.linspace(u0, u1, count), np.linspace(v0, v1, count), indexing="ij")
    return surface.evaluate(u, v).reshape(-1, 3), u.ravel(), v.ravel()


@pytest.mark.parametrize("seed", range(6))
def test_no_sample_and_no_descent_from_it_is_closer(shapes, seed):
    rng = np.random.default_rng(seed)
    surface = shapes.random_surface(rng, rational=bool(seed % 2))
    grid = PatchGrid.of(surface, 33)
    points = rng.uniform([-2, -2, -4], [12, 12, 4], (60, 3))
    found = closest_points(grid, surface.control_points, points)
    dense, u, v = _dense(surface)
    nearest = np.linalg.norm(points[:, None] - dense, axis=2)
    assert (found.distance <= nearest.min(axis=1) + 1e-12).all()
    assert np.linalg.norm(points - found.point, axis=1) == pytest.approx(found.distance, rel=1e-9)
    assert surface.evaluate(found.u, found.v) == pytest.approx(found.point, abs=1e-9)
    bounds = surface.domain
    for k in range(0, 60, 6):
        start = nearest[k].argmin()

        def goal(t, x=points[k]):
            return np.sum((surface.evaluate(t[0], t[1]) - x) ** 2)

        best = minimize(goal, [u[start], v[start]], bounds=bounds, method="L-BFGS-B", tol=1e-14)
        assert found.distance[k] <= np.sqrt(best.fun) + 1e-7


def test_interior_closest_points_are_orthogonal(shapes):
    rng = np.random.default_rng(3)
    surface = shapes.plate(10.0, 8, 3, height=lambda x, y: np.sin(x) * np.cos(0.7 * y))
    grid = PatchGrid.of(surface, 33)
    uv = rng.uniform(0.2, 0.8, (200, 2))
    offset = rng.normal(scale=0.2, size=200)
    points = surface.evaluate(*uv.T) + offset[:, None] * surface.normal(*uv.T)
    found = closest_points(grid, surface.control_points, points)
    assert found.proper.all()
    d = surface.derivatives(found.u, found.v, 1)
    for tangent in (d[1, 0], d[0, 1]):
        along = ((points - found.point) * tangent).sum(axis=1) / np.linalg.norm(tangent, axis=1)
        assert np.abs(along).max() < 1e-9
    assert found.normal == pytest.approx(surface.normal(found.u, found.v), abs=1e-9)
    # lifted off along the normal by less than the radius of curvature: that is where they come back to
    assert found.distance == pytest.approx(np.abs(offset), abs=1e-9)


@pytest.mark.parametrize("name", ["ball", "cylinder"])
def test_closed_surfaces_wrap_and_poles_are_normal(shapes, name):
    rng = np.random.default_rng(4)
    surface = getattr(shapes, name)(5.0)
    grid = PatchGrid.of(surface, (33, 17))
    points = rng.uniform(-8, 8, (300, 3)) + ([0, 0, 5.0] if name == "cylinder" else 0.0)
    # along the seam (y = 0, x > 0), and on the axis through the poles
    points[:40, 1] = rng.normal(scale=1e-3, size=40)
    points[:40, 0] = np.abs(points[:40, 0]) + 1.0
    if name == "ball":
        points[40:60, :2] = 0.0
        points[60:64] = [[0, 0, 9], [0, 0, -9], [1e-9, 0, 9], [0, 1e-7, 2]]
        arm = points
        expected = np.abs(np.linalg.norm(arm, axis=1) - 5.0)
    else:
        points[:, 2] = np.clip(points[:, 2], 0.2, 9.8)
        arm = points * [1, 1, 0]
        expected = np.abs(np.linalg.norm(arm, axis=1) - 5.0)
    found = closest_points(grid, surface.control_points, points)
    assert found.distance == pytest.approx(expected, abs=1e-9)
    assert found.proper.all()
    far = np.linalg.norm(arm, axis=1) > 0.5
    assert found.normal[far] == pytest.approx((arm / np.linalg.norm(arm, axis=1, keepdims=True))[far], abs=1e-5)


def test_the_other_sheet_of_a_thin_tool_is_found(shapes):
    """A blade, one patch folded over: points near one side have a close second sheet behind."""
    surface = shapes.plate(10.0, 12, 3)
    net = surface.control_points.copy()
    x = net[..., 0].copy()
    net[..., 0] = np.where(x < 5, x, 10 - x)
    net[..., 2] = np.where(x < 5, 0.15, -0.15)
    blade = surface.with_control_points(net)
    grid = PatchGrid.of(blade, 33)
    rng = np.random.default_rng(5)
    points = rng.uniform([0.5, 1, -0.5], [3.5, 9, 0.5], (150, 3))
    found = closest_points(grid, net, points)
    dense, _, _ = _dense(blade, 300)
    assert (found.distance <= np.linalg.norm(points[:, None] - dense, axis=2).min(axis=1) + 1e-12).all()


def test_borders_are_told_from_faces(shapes):
    surface = shapes.plate(10.0)
    grid = PatchGrid.of(surface, 17)
    points = np.array([[5.0, 5, 3], [-1, 5, 0], [-1, 5, 2], [12, 13, -1], [0, 0, 2], [10, 5, -2.0]])
    found = closest_points(grid, surface.control_points, points)
    assert found.point == pytest.approx(np.clip(points, [0, 0, 0], [10, 10, 0]), abs=1e-9)
    assert list(found.proper) == [True, False, False, False, True, True]
    assert found.normal == pytest.approx(np.tile([0, 0, 1.0], (6, 1)))
    inside_out = BSplineSurface(surface.control_points, surface.knots_u, surface.knots_v, 3, 3, outward=False)
    assert closest_points(PatchGrid.of(inside_out, 9), surface.control_points, points).normal[0] == pytest.approx(
        [0, 0, -1]
    )


def test_creases_do_not_stop_the_descent(shapes):
    """A roof: a cubic with a knot of multiplicity three, so that S_u jumps."""
    knots = np.array([0, 0, 0, 0, 0.5, 0.5, 0.5, 1, 1, 1, 1])
    x = np.linspace(0, 6, 7)
    net = np.stack([*np.meshgrid(x, np.linspace(0, 4, 4), indexing="ij"), np.zeros((7, 4))], axis=-1)
    net[..., 2] = 3.0 - np.abs(net[..., 0] - 3.0)
    roof = BSplineSurface(net, knots, np.array([0, 0, 0, 0, 1, 1, 1, 1.0]), 3, 3)
    grid = PatchGrid.of(roof, 17)
    rng = np.random.default_rng(6)
    points = np.column_stack([rng.uniform(2.5, 3.5, 50), rng.uniform(0.5, 3.5, 50), rng.uniform(3.2, 6, 50)])
    found = closest_points(grid, net, points)
    # above the ridge's wedge the ridge is closest
    wedge = np.abs(points[:, 0] - 3.0) < points[:, 2] - 3.0
    assert wedge.any()
    expected = np.hypot(points[:, 0] - 3.0, points[:, 2] - 3.0)
    assert found.distance[wedge] == pytest.approx(expected[wedge], abs=1e-7)
    assert found.proper.all()


def test_derivatives_are_those_of_the_reference(shapes):
    rng = np.random.default_rng(7)
    for rational in (False, True):
        for _ in range(10):
            surface = shapes.random_surface(rng, rational=rational)
            w = np.ones(surface.shape) if surface.weights is None else surface.weights
            net = np.concatenate([surface.control_points * w[..., None], w[..., None]], axis=2)
            (u0, u1), (v0, v1) = surface.domain
            for u, v in [(u0, v1), (u1, v0), *zip(rng.uniform(u0, u1, 5), rng.uniform(v0, v1, 5), strict=True)]:
                h, scratch = np.empty((6, 4)), np.empty((9, 12))
                knots = np.array(surface.knots_u), np.array(surface.knots_v)
                f = approach(net, *knots, surface.degree_u, surface.degree_v, rational, u, v, 1.0, 2.0, 3.0, h, scratch)
                d = surface.derivatives(u, v, 2)
                expected = [d[0, 0], d[1, 0], d[0, 1], d[2, 0], d[1, 1], d[0, 2]]
                assert h[:, :3] == pytest.approx(np.array(expected), rel=1e-9, abs=1e-9)
                assert f == pytest.approx(np.sum((d[0, 0] - [1, 2, 3]) ** 2))


def test_basis_of_every_degree_sums_to_one_and_its_derivatives_to_zero():
    for p in range(1, 12):
        knots = np.concatenate([np.zeros(p + 1), [0.3, 0.5, 0.8], np.ones(p + 1)])
        scratch = np.empty((9, p + 4))
        basis_2(knots, p, p + 1, 0.42, scratch, 0)
        assert scratch[0, : p + 1].sum() == pytest.approx(1.0)
        assert scratch[1, : p + 1].sum() == pytest.approx(0.0, abs=1e-9)
        assert scratch[2, : p + 1].sum() == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("turned", [False, True])
def test_a_pole_is_no_trap_for_points_beside_it(shapes, turned):
    """Starts on the pole, or across it from the point: the closest point lies on the other side."""
    surface = shapes.ball(5.0)
    if turned:  # the poles along the other parameter
        surface = BSplineSurface(
            surface.control_points.transpose(1, 0, 2), surface.knots_v, surface.knots_u, surface.degree_v,
            surface.degree_u, surface.weights.T,
        )  # fmt: skip
    grid = PatchGrid.of(surface, (9, 9))
    g = Workspace(grid, np.zeros(16, np.int64)).load(surface.control_points, paper=False, delta=0.0)
    rng = np.random.default_rng(9)
    h, scratch, found = np.empty((6, 4)), np.empty((9, 9)), np.zeros(9)
    (u0, u1), (v0, v1) = surface.domain
    for _ in range(300):
        angle, aside = rng.uniform(0, 2 * np.pi), 10.0 ** rng.uniform(-4, 0.3)
        x = np.array([aside * np.cos(angle), aside * np.sin(angle), rng.choice([-1, 1]) * rng.uniform(3.0, 8.0)])
        high = rng.choice([0.0, 1.0])
        start = [rng.random(), abs(high - rng.choice([0.0, 1e-9, 1e-3]))]
        start = start[::-1] if turned else start
        found[U], found[V] = u0 + start[0] * (u1 - u0), v0 + start[1] * (v1 - v0)
        before = np.linalg.norm(surface.evaluate(found[U], found[V]) - x)
        newton(
            g.net, g.knots_u, g.knots_v, g.degree_u, g.degree_v, g.rational, g.wrap_u, g.wrap_v, g.poles, g.slack, 0.0,
            *x, found, h, scratch, g.frames, g.terms, g.terms_stamp, g.tick,
        )  # fmt: skip
        assert found[DISTANCE] <= before + 1e-12
        if before < np.linalg.norm(x):  # the start is on the nearer half
            assert found[DISTANCE] == pytest.approx(abs(np.linalg.norm(x) - 5.0), abs=1e-9)
            assert found[POINT : POINT + 3] == pytest.approx(5.0 * x / np.linalg.norm(x), abs=1e-5)
