"""Nodes: evenly apart, knots among them, and always enough to determine the net (Schoenberg and Whitney)."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.errors import GeometryError, InputError
from cadsculpt.physics.node_grid import node_grid
from cadsculpt.spline.matrices import design_matrix
from cadsculpt.spline.refit import Refit
from cadsculpt.spline.surface import BSplineSurface


def plate(degree: int, inner: int, length: float = 60.0, *, bent: float = 0.0) -> BSplineSurface:
    rng = np.random.default_rng(degree + inner)
    knots = np.concatenate([np.zeros(degree + 1), np.sort(rng.uniform(0, 1, inner)), np.ones(degree + 1)])
    n = inner + degree + 1
    x = np.array([knots[i + 1 : i + degree + 1].mean() for i in range(n)])
    x = x**1.5  # parameters that do not run evenly in space
    X, Y = np.meshgrid(length * x, 0.5 * length * x, indexing="ij")
    return BSplineSurface(np.stack([X, Y, bent * np.sin(X)], axis=-1), knots, knots, degree, degree)


@pytest.mark.parametrize("degree", [1, 2, 3, 5, 8, 11])
@pytest.mark.parametrize("inner", [0, 1, 7])
@pytest.mark.parametrize("refine", [None, ((0.3, 0.6), (0.2, 0.5)), ((0.0, 1.0), (0.0, 1.0))])
def test_every_net_is_determined_by_its_nodes(degree, inner, refine):
    surface = plate(degree, inner)
    nodes = node_grid(surface, (2.0, 2.0), refine=refine)
    Refit.of(nodes.surface, nodes.u, nodes.v)  # raises when it is not
    u = np.linspace(0, 1, 40)
    np.testing.assert_allclose(
        nodes.surface.evaluate(u[:, None], u), surface.evaluate(u[:, None], u), atol=1e-11, rtol=0
    )
    for t, knots in ((nodes.u, nodes.surface.knots_u), (nodes.v, nodes.surface.knots_v)):
        assert (np.diff(t) > 0).all()
        if degree % 2:  # between the nodes for an even degree
            assert set(np.unique(knots)) <= set(t)


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_a_refined_net_follows_any_motion_of_the_nodes(degree):
    nodes = node_grid(plate(degree, 3), (3.0, 3.0), refine=((0.0, 1.0), (0.0, 1.0)))
    refit = Refit.of(nodes.surface, nodes.u, nodes.v)
    zigzag = np.zeros((len(nodes.u), len(nodes.v), 3))
    zigzag[..., 2] = (-1.0) ** (np.arange(len(nodes.u))[:, None] + np.arange(len(nodes.v)))
    error = refit.error(zigzag, refit.fit(zigzag))
    assert error.maximum < 1e-7


def test_nodes_are_evenly_apart_in_space():
    nodes = node_grid(plate(3, 0), (2.0, 2.0))
    points = nodes.surface.evaluate(nodes.u[:, None], nodes.v)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=2)
    assert steps.max() <= 2.0 * 1.02
    assert steps.min() >= 2.0 * 0.9


def test_a_window_keeps_the_rest_of_the_surface_out():
    surface = plate(3, 2)
    window = ((0.4, 0.6), (0.3, 0.5))
    nodes = node_grid(surface, (1.0, 1.0), window=window)
    assert nodes.u[0] == 0.4
    assert nodes.u[-1] == 0.6
    inside = design_matrix(nodes.surface.knots_u, 3, np.array([0.4, 0.6])) > 0
    free = np.flatnonzero(~inside.any(axis=0))
    assert ((nodes.surface.knots_u[free] >= 0.4) & (nodes.surface.knots_u[free + 4] <= 0.6)).sum() >= 3


def test_a_closed_direction_leaves_its_last_node_out():
    angle = np.linspace(0, 2 * np.pi, 13)
    ring = 10 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    ring[-1] = ring[0]
    points = np.stack([ring, ring + [0, 0, 20]], axis=1)
    knots = np.concatenate([np.zeros(3), np.arange(1, 11), np.full(3, 11.0)])
    nodes = node_grid(BSplineSurface(points, knots, np.array([0.0, 0, 1, 1]), 2, 1), (2.0, 2.0))
    assert nodes.wrap_u
    assert not nodes.wrap_v
    assert nodes.u[-1] < 11.0
    assert nodes.v[-1] == 1.0


def test_a_slip_in_the_spacing_is_caught():
    with pytest.raises(InputError, match="choose a node spacing of"):
        node_grid(plate(3, 2), (0.01, 0.01))


def test_a_limit_on_the_net_widens_the_knots_and_then_refuses():
    surface = plate(3, 0)
    everywhere = ((0.0, 1.0), (0.0, 1.0))
    fine = node_grid(surface, (1.0, 1.0), refine=everywhere)
    coarse = node_grid(surface, (1.0, 1.0), refine=everywhere, most_control_points=300)
    assert np.prod(coarse.surface.shape) <= 300 < np.prod(fine.surface.shape)
    with pytest.raises(GeometryError, match="more than 20"):
        node_grid(surface, (1.0, 1.0), refine=everywhere, most_control_points=20)


def test_knots_by_the_hundred_within_a_cell_are_named():
    """Spans of all lengths, most far narrower than the nodes stand apart: no halving ever puts a node into each."""
    spans = 10.0 ** np.random.default_rng(1).uniform(-6.0, 0.0, 500)
    middle = (np.cumsum(spans) / spans.sum())[:-1]
    knots = np.concatenate([np.zeros(4), middle, np.ones(4)])
    x = np.array([knots[i + 1 : i + 4].mean() for i in range(len(knots) - 4)])
    ends = np.array([0.0, 1.0])
    X, Y = np.meshgrid(60.0 * x, 30.0 * ends, indexing="ij")
    strip = BSplineSurface(np.stack([X, Y, 0 * X], axis=-1), knots, np.array([0.0, 0, 1, 1]), 3, 1)
    with pytest.raises(GeometryError, match=r"so uneven, the longest \d"):
        node_grid(strip, (2.0, 2.0))
