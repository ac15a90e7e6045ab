"""Degree elevation: the same points, normals and smoothness, and a net of the degree asked for."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.spline.elevate import elevated
from cadsculpt.spline.surface import BSplineSurface


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("rational", [False, True])
def test_the_surface_is_the_same(degree, rational):
    rng = np.random.default_rng(degree)
    knots_u = np.concatenate([np.full(degree + 1, 2.0), [3.0, 3.5, 5.0], np.full(degree + 1, 7.0)])
    knots_v = np.concatenate([np.full(2, -1.0), [0.0], np.full(2, 1.0)])
    shape = degree + 4, 3
    weights = rng.uniform(0.5, 2.0, shape) if rational else None
    surface = BSplineSurface(rng.normal(size=(*shape, 3)), knots_u, knots_v, degree, 1, weights)
    raised = elevated(surface, 4, 3)
    raised.validate()
    assert (raised.degree_u, raised.degree_v) == (4, 3)
    assert raised.domain == surface.domain
    u, v = np.linspace(2, 7, 51)[:, None], np.linspace(-1, 1, 41)
    np.testing.assert_allclose(raised.derivatives(u, v, 1), surface.derivatives(u, v, 1), atol=1e-12)
    # a knot repeats by the degree's rise more often: no smoother and no rougher than it was
    assert np.count_nonzero(raised.knots_u == 3.5) == 1 + 4 - degree
    assert elevated(surface, 1, 1) is surface


def test_a_plane_becomes_its_net_at_thirds():
    net = np.array([[[0, 0, 0], [0, 3, 0]], [[6, 0, 3], [6, 3, 3]]], dtype=float)
    flat = BSplineSurface(net, np.array([0.0, 0, 1, 1]), np.array([0.0, 0, 1, 1]), 1, 1)
    raised = elevated(flat, 3, 3)
    x, y = np.meshgrid([0, 2, 4, 6], [0, 1, 2, 3], indexing="ij")
    np.testing.assert_allclose(raised.control_points, np.stack([x, y, x / 2], axis=-1), atol=1e-14)
    np.testing.assert_array_equal(raised.control_points[[0, -1]][:, [0, -1]], net)


def test_a_circle_stays_one():
    """Rational arcs, unrolled as periodic nets are, with double knots: cubic with triple ones."""
    corners = np.array(
        [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1)], dtype=float
    )
    weight = np.where(np.arange(10) % 2, np.sqrt(0.5), 1.0)
    net = np.zeros((10, 2, 3))
    net[..., :2] = corners[:, None]
    net[:, 1, 2] = 4.0
    knots = np.array([-1.0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5])
    tube = BSplineSurface(
        net, knots, np.array([0.0, 0, 1, 1]), 2, 1, np.repeat(weight[:, None], 2, axis=1), periodic_u=True
    )
    raised = elevated(tube, 3, 3)
    raised.validate()
    assert raised.domain == tube.domain
    assert raised.periodic_u
    np.testing.assert_array_equal(raised.control_points[-3:], raised.control_points[:3])
    u, v = np.linspace(0, 4, 101)[:, None], np.linspace(0, 1, 11)
    np.testing.assert_allclose(raised.evaluate(u, v), tube.evaluate(u, v), atol=1e-13)
    np.testing.assert_allclose(np.hypot(*raised.evaluate(u, v)[..., :2].transpose(2, 0, 1)), 1.0, atol=1e-13)
    plain = BSplineSurface(net[:5], np.arange(-1, 6.0), np.array([0.0, 0, 1, 1]), 1, 1, periodic_u=True)
    assert elevated(plain, 1, 2).degree_v == 2
