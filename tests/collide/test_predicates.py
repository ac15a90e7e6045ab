"""Orientation signs against rational arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadsculpt.collide.predicates import (
    expansion_scale,
    expansion_sum,
    minor,
    orient2d,
    orient2d_exact,
    orient3d,
    orient3d_exact,
)


def _sign(x):
    return (x > 0) - (x < 0)


def _exact(points):
    rows = [[Fraction(float(x)) for x in point] for point in points]
    m = [[x - y for x, y in zip(row, rows[-1], strict=True)] for row in rows[:-1]]
    if len(m) == 2:
        return _sign(m[0][0] * m[1][1] - m[0][1] * m[1][0])
    return _sign(
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
        - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    )


def _cases(rng, count):
    for k in range(count):
        if k % 4 == 0:
            yield rng.integers(-3, 4, (4, 3)) * 0.1
        elif k % 4 == 1:
            yield rng.normal(size=(4, 3)) * 10.0 ** rng.integers(-6, 7)
        else:
            # the fourth point in the plane of the others, up to its rounding
            p = rng.normal(size=(3, 3)) + (1e3 if k % 4 == 3 else 0.0)
            w = rng.normal(size=3)
            yield np.vstack([p, w @ p / w.sum()])


def test_signs_in_space_and_in_the_plane():
    rng = np.random.default_rng(0)
    zeros = 0
    for points in _cases(rng, 2000):
        truth = _exact(points)
        zeros += truth == 0
        assert _sign(orient3d(*points.ravel())) == truth
        assert _sign(orient3d_exact(*points.ravel())) == truth
        flat = points[[0, 1, 3], :2]
        truth = _exact(flat)
        zeros += truth == 0
        assert _sign(orient2d(*flat.ravel())) == truth
        assert _sign(orient2d_exact(*flat.ravel())) == truth
    assert zeros > 50


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(-1e6, 1e6).filter(lambda x: x == 0 or abs(x) > 1e-60), min_size=12, max_size=12))
def test_any_coordinates(numbers):
    points = np.array(numbers).reshape(4, 3)
    assert _sign(orient3d(*points.ravel())) == _exact(points)


def test_exchanging_points_turns_the_sign_and_a_unit_tetrahedron_is_positive():
    a, b, c, d = np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0, 0, 1.0]), np.zeros(3)
    value = orient3d(*a, *b, *c, *d)
    assert value == 1.0
    assert orient3d(*b, *a, *c, *d) == -1.0
    assert orient3d(*c, *d, *a, *b) == 1.0
    # d below the plane through a, b, c, which run counterclockwise from above
    assert orient3d(0, 0, 0, 1, 0, 0, 0, 1, 0, 0.2, 0.2, -1) > 0


@pytest.mark.parametrize("seed", range(3))
def test_expansions_are_exact(seed):
    rng = np.random.default_rng(seed)

    def number():
        return float(rng.normal() * 2.0 ** rng.integers(-40, 40))

    for _ in range(200):
        a, b, c, d, f = (number() for _ in range(5))
        e, g = np.zeros(4), np.zeros(4)
        n_e, n_g = minor(a, b, c, d, e), minor(b, c, d, f, g)
        value_e = sum(map(Fraction, e[:n_e]), Fraction(0))
        assert value_e == Fraction(a) * Fraction(d) - Fraction(c) * Fraction(b)
        out = np.zeros(8)
        n = expansion_sum(e, n_e, g, n_g, out)
        assert sum(map(Fraction, out[:n]), Fraction(0)) == value_e + sum(map(Fraction, g[:n_g]), Fraction(0))
        n = expansion_scale(e, n_e, f, out)
        assert sum(map(Fraction, out[:n]), Fraction(0)) == value_e * Fraction(f)
        assert n == 0 or out[n - 1] != 0.0
