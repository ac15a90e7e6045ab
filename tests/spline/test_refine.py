"""Knot insertion changes the net and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadsculpt.errors import GeometryError
from cadsculpt.spline.refine import insert_knots, missing_knots
from cadsculpt.spline.surface import BSplineSurface


def random_surface(seed: int, degree: int, inner: int, *, rational: bool, periodic: bool) -> BSplineSurface:
    rng = np.random.default_rng(seed)
    inside = np.sort(rng.uniform(2.0, 5.0, inner))
    clamped = np.concatenate([np.full(degree + 1, 2.0), inside, np.full(degree + 1, 5.0)])
    count = inner + degree + 1
    if periodic:
        unique = degree + 2 + inner
        steps = rng.uniform(0.5, 1.5, unique)
        one = np.concatenate([[0.0], np.cumsum(steps)])
        index = np.arange(-degree, unique + degree + 1)
        knots_u = one[index % unique] + one[-1] * (index // unique)
        points = rng.normal(size=(unique, count, 3))[np.arange(unique + degree) % unique]
        weights = rng.uniform(0.5, 2.0, (unique, count))[np.arange(unique + degree) % unique]
    else:
        knots_u = clamped
        points = rng.normal(size=(count, count, 3))
        weights = rng.uniform(0.5, 2.0, (count, count))
    return BSplineSurface(points, knots_u, clamped, degree, degree, weights if rational else None, periodic_u=periodic)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    degree=st.integers(1, 7),
    inner=st.integers(0, 5),
    rational=st.booleans(),
    periodic=st.booleans(),
    fractions=st.lists(st.floats(0.01, 0.99), min_size=1, max_size=6, unique=True),
)
def test_shape_and_parameters_do_not_move(seed, degree, inner, rational, periodic, fractions):
    surface = random_surface(seed, degree, inner, rational=rational, periodic=periodic)
    (u0, u1), (v0, v1) = surface.domain
    new_u = u0 + (u1 - u0) * np.array(fractions)
    new_v = v0 + (v1 - v0) * np.array(fractions)
    fine = insert_knots(surface, new_u, new_v)
    fine.validate()
    assert fine.shape == (surface.shape[0] + len(new_u), surface.shape[1] + len(new_v))
    assert fine.domain == surface.domain
    u = np.linspace(u0, u1, 23)
    v = np.linspace(v0, v1, 19)
    scale = np.abs(surface.control_points).max()
    difference = np.abs(fine.evaluate(u[:, None], v) - surface.evaluate(u[:, None], v)).max()
    assert difference <= 1e-12 * scale
    if periodic:
        p = degree
        np.testing.assert_array_equal(fine.control_points[:p], fine.control_points[-p:])
        period = u1 - u0
        n = fine.shape[0] - p
        np.testing.assert_allclose(fine.knots_u[n:], fine.knots_u[: 2 * p + 1] + period, rtol=0, atol=1e-12 * period)


def test_control_points_out_of_reach_keep_their_bits():
    surface = random_surface(3, 3, 9, rational=True, periodic=False)
    t = 0.5 * (surface.knots_u[5] + surface.knots_u[6])
    fine = insert_knots(surface, [t])
    np.testing.assert_array_equal(fine.control_points[:3], surface.control_points[:3])
    np.testing.assert_array_equal(fine.control_points[6:], surface.control_points[5:])


def test_missing_knots_counts_multiplicity():
    surface = random_surface(4, 3, 2, rational=False, periodic=False)
    fine = insert_knots(surface, [3.3, 3.3, 4.1], [2.5])
    new_u, new_v = missing_knots(surface, fine)
    np.testing.assert_array_equal(new_u, [3.3, 3.3, 4.1])
    np.testing.assert_array_equal(new_v, [2.5])
    assert insert_knots(surface, new_u, new_v).shape == fine.shape


@pytest.mark.parametrize("knot", [2.0, 5.0, 7.5])
def test_a_knot_outside_the_domain_is_refused(knot):
    with pytest.raises(GeometryError, match="cannot insert"):
        insert_knots(random_surface(1, 3, 2, rational=False, periodic=False), [knot])


def test_a_knot_too_often_is_refused():
    with pytest.raises(GeometryError, match="more than 2 times"):
        insert_knots(random_surface(1, 2, 2, rational=False, periodic=False), [3.0, 3.0, 3.0])
