"""Superquadrics: against ellipsoids, octahedra, dense points of their surface, and what a distance must satisfy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from cadsculpt.errors import InputError
from cadsculpt.motion.pose import Pose
from cadsculpt.tools.implicit import ImplicitTool
from cadsculpt.tools.superquadric import SuperquadricTool

KINDS = [
    ((1.0, 2.0, 0.5), (0.1, 0.1)), ((1.0, 2.0, 0.5), (2.0, 1.0)), ((1.0, 1.3, 2.0), (0.3, 1.7)),
    ((1.0, 1.3, 2.0), (1.7, 0.3)), ((1.0, 1.0, 1.0), (0.1, 2.0)), ((3.0, 1.0, 0.2), (0.7, 0.4)),
]  # fmt: skip


def level(radii, exponents, points):
    """The textbook's inside-outside function, to the power e1 / 2: 1 on the surface."""
    s = np.abs(points) / radii
    p, q = 2.0 / exponents[0], 2.0 / exponents[1]
    return ((s[:, 0] ** q + s[:, 1] ** q) ** (p / q) + s[:, 2] ** p) ** (1.0 / p)


def cloud(radii, exponents, count=320):
    """Points of the surface in the first octant, crowded where the parameters jump, and the largest gap between them."""
    t = np.linspace(0, 1, count)
    angle = 0.5 * np.pi * np.where(t < 0.5, 0.5 * (2 * t) ** 6, 1 - 0.5 * (2 - 2 * t) ** 6)
    c, s = np.cos(angle), np.sin(angle)
    c[-1] = 0.0
    (e1, e2), (a, b, h) = exponents, radii
    x, y = c[:, None] ** e1 * c**e2 * a, c[:, None] ** e1 * s**e2 * b
    net = np.stack([x, y, h * s[:, None] ** e1 + 0 * c], axis=-1)
    gap = max(np.linalg.norm(np.diff(net, axis=k), axis=-1).max() for k in (0, 1))
    return net.reshape(-1, 3), gap


@pytest.mark.parametrize(("radii", "exponents"), KINDS)
def test_distance_and_nearest_point_against_dense_points(radii, exponents):
    rng = np.random.default_rng(1)
    radii, exponents = np.array(radii), np.array(exponents)
    tool = SuperquadricTool.of(tuple(radii), tuple(exponents))
    x = np.concatenate([rng.uniform(-1, 1, (700, 3)) * radii, rng.uniform(-1.6, 1.6, (500, 3)) * radii.max()])
    d, n = tool.field(x)
    dense, gap = cloud(radii, exponents)
    sampled = cKDTree(dense).query(np.abs(x))[0]
    # a sample is never nearer than the nearest point, and one is not much farther
    assert (sampled >= np.abs(d) - 1e-12).all()
    assert (sampled <= np.hypot(np.abs(d), gap) + 0.05 * gap).all()
    assert np.array_equal(d < 0, level(radii, exponents, x) < 1)
    np.testing.assert_allclose(level(radii, exponents, x - d[:, None] * n), 1.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, rtol=1e-12)


@pytest.mark.parametrize("radii", [(1.0, 2.0, 1.5), (3.0, 0.4, 1.0)])
def test_exponents_of_one_are_an_ellipsoid(radii):
    x = np.random.default_rng(0).uniform(-3, 3, (1000, 3))
    d, n = SuperquadricTool.of(radii, (1.0, 1.0)).field(x)
    truth, normal = ImplicitTool.ellipsoid(radii).field(x)
    np.testing.assert_allclose(d, truth, atol=1e-12)
    np.testing.assert_allclose(n, normal, atol=1e-5)


def test_exponents_of_two_are_an_octahedron():
    x = np.random.default_rng(0).uniform(-1, 1, (1000, 3))
    tool = SuperquadricTool.of((1.0, 1.0, 1.0), (2.0, 2.0))
    inside = np.abs(x).sum(axis=1) < 1
    d = tool.field(x)[0]
    np.testing.assert_allclose(d[inside], (np.abs(x[inside]).sum(axis=1) - 1) / np.sqrt(3), atol=1e-12)
    tip, normal = tool.field(np.array([[0.1, 0.05, 2.0], [0.0, 0.0, 1.5]]))
    np.testing.assert_allclose(tip, [np.sqrt(0.1**2 + 0.05**2 + 1), 0.5], atol=1e-12)
    np.testing.assert_allclose(normal[1], [0, 0, 1], atol=1e-12)


exponent = st.floats(0.1, 2.0)
size = st.floats(0.3, 3.0)
place = st.tuples(*[st.floats(-4, 4)] * 3)


@settings(max_examples=150, deadline=None)
@given(st.tuples(size, size, size), st.tuples(exponent, exponent), place, place)
def test_it_never_changes_faster_than_the_place(radii, exponents, p, q):
    tool = SuperquadricTool.of(radii, exponents)
    x = np.array([p, q])
    # towards the surface too, where the nearest point jumps
    x = np.concatenate([x, 0.1 * x, x / np.maximum(level(np.array(radii), exponents, x), 1e-3)[:, None]])
    d, n = tool.field(x)
    gap = np.linalg.norm(x[:, None] - x, axis=2)
    assert (np.abs(d[:, None] - d) <= gap + 1e-9).all()
    np.testing.assert_allclose(level(np.array(radii), exponents, x - d[:, None] * n), 1.0, atol=1e-8)


def test_a_placed_one_moves_with_its_pose():
    tool = SuperquadricTool.of((1.0, 2.0, 0.5), (0.3, 1.2))
    pose = Pose.turned([0.3, -1.0, 2.0], [1, 2, 3], 40)
    x = np.random.default_rng(5).uniform(-3, 3, (500, 3))
    field = tool.placed(pose).field
    d, n = tool.field(x)
    np.testing.assert_allclose(field.distance(pose.to_world(x)), d, atol=1e-9)
    np.testing.assert_allclose(field.nearest(pose.to_world(x)), pose.to_world(x - d[:, None] * n), atol=1e-6)
    low, high = field.box()
    assert ((pose.to_world(x[d <= 0]) >= low) & (pose.to_world(x[d <= 0]) <= high)).all()


def test_what_is_no_number_has_no_distance():
    tool = SuperquadricTool.of((1.0, 2.0, 0.5), (0.3, 1.2))
    assert np.isnan(tool.field(np.array([[np.nan, 0, 0]]))[0]).all()


@pytest.mark.parametrize(
    ("radii", "exponents", "words"),
    [
        ((1, 1, 1), (2.1, 1), "not convex"),
        ((1, 1, 1), (1, 0.05), "0.1 to 2"),
        ((1, 1, 1), (1, float("nan")), "0.1 to 2"),
        ((1, 0, 1), (1, 1), "positive"),
        ((1, float("inf"), 1), (1, 1), "positive"),
    ],
)
def test_what_is_refused(radii, exponents, words):
    with pytest.raises(InputError, match=words):
        SuperquadricTool.of(radii, exponents)
