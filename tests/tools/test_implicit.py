"""Signed distances against brute force over sampled surfaces, and what a distance must satisfy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from cadsculpt.errors import InputError
from cadsculpt.motion.pose import Pose
from cadsculpt.tools.implicit import ImplicitTool

SHAPES = {
    "sphere": ImplicitTool.sphere(1.3),
    "ellipsoid": ImplicitTool.ellipsoid((0.7, 2.0, 1.1)),
    "flat ellipsoid": ImplicitTool.ellipsoid((2.0, 1.5, 0.05)),
    "capsule": ImplicitTool.capsule(0.5, 1.4),
    "cylinder": ImplicitTool.cylinder(0.8, 1.5),
    "rounded cylinder": ImplicitTool.cylinder(0.8, 1.5, 0.3),
    "cone": ImplicitTool.cone(0.8, 1.5),
    "box": ImplicitTool.box((1.0, 2.0, 0.6)),
    "rounded box": ImplicitTool.box((1.0, 2.0, 0.6), 0.2),
    "torus": ImplicitTool.torus(1.2, 0.4),
    "half space": ImplicitTool.half_space(),
}


@pytest.fixture(params=SHAPES.values(), ids=SHAPES.keys())
def tool(request) -> ImplicitTool:
    return request.param


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(5).uniform(-3, 3, (4000, 3))


def test_the_nearest_point_lies_on_the_surface(tool, points):
    d, n = tool.field(points)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, rtol=1e-12)
    foot = points - d[:, None] * n
    np.testing.assert_allclose(tool.field(foot)[0], 0.0, atol=2e-9)


def test_a_distance_is_lipschitz(tool, points):
    other = points + np.random.default_rng(6).normal(scale=0.3, size=points.shape)
    change = np.abs(tool.field(points)[0] - tool.field(other)[0])
    assert (change <= np.linalg.norm(points - other, axis=1) * (1 + 1e-9) + 1e-12).all()


def test_the_normal_is_the_gradient(tool, points):
    h = 1e-6
    _, n = tool.field(points)
    gradient = np.stack(
        [(tool.field(points + h * e)[0] - tool.field(points - h * e)[0]) / (2 * h) for e in np.eye(3)], axis=1
    )
    smooth = np.abs(np.linalg.norm(gradient, axis=1) - 1) < 1e-6  # not on the medial axis
    assert smooth.mean() > 0.98
    np.testing.assert_allclose(gradient[smooth], n[smooth], atol=2e-5)


def test_inside_is_negative():
    assert SHAPES["ellipsoid"].field(np.array([[0.6, 0.0, 0.0], [0.75, 0.0, 0.0]]))[0].tolist() == pytest.approx(
        [-0.1, 0.05], abs=1e-9
    )
    assert SHAPES["cone"].field(np.array([[0.0, 0.0, 0.5], [0.0, 0.0, -0.1], [0.0, 0.0, 1.6]]))[0][0] < 0
    assert SHAPES["half space"].field(np.array([[3.0, 4.0, 0.5]]))[0][0] == -0.5


def test_ellipsoid_against_constrained_minimisation():
    e = np.array([0.7, 2.0, 1.1])
    rng = np.random.default_rng(0)
    for x in rng.uniform(-2.5, 2.5, (25, 3)):
        best = np.inf
        for start in rng.normal(size=(8, 3)):
            angles = minimize(
                lambda a, x=x: np.sum(
                    (e * [np.cos(a[0]) * np.cos(a[1]), np.sin(a[0]) * np.cos(a[1]), np.sin(a[1])] - x) ** 2
                ),
                start[:2],
                options={"gtol": 1e-12},
            )
            best = min(best, np.sqrt(angles.fun))
        assert abs(ImplicitTool.ellipsoid(tuple(e)).field(x[None])[0][0]) == pytest.approx(best, abs=1e-7)


@pytest.mark.parametrize("name", ["ellipsoid", "flat ellipsoid"])
def test_ellipsoid_on_its_planes_of_symmetry(name):
    tool = SHAPES[name]
    flat = np.random.default_rng(3).uniform(-2, 2, (500, 3))
    flat[:, 2] = 0.0
    off = flat + [0, 0, 1e-9]
    np.testing.assert_allclose(tool.field(flat)[0], tool.field(off)[0], atol=1e-8)


def test_a_placed_tool_moves_with_its_pose(tool, points):
    pose = Pose.turned([0.3, -1.0, 2.0], [1, 2, 3], 40)
    placed = tool.placed(pose).field
    world = pose.to_world(points)
    d, n = tool.field(points)
    np.testing.assert_allclose(placed.distance(world), d, atol=1e-9)
    np.testing.assert_allclose(placed.gradient(world), pose.direction_to_world(n), atol=1e-6)
    np.testing.assert_allclose(tool.field(pose.to_tool(placed.nearest(world)))[0], 0.0, atol=2e-9)
    low, high = placed.box()
    solid = world[d <= 0]
    assert (solid >= low - 1e-9).all()
    assert (solid <= high + 1e-9).all()


@pytest.mark.parametrize("size", [0.0, -1.0, float("nan"), float("inf")])
def test_a_size_must_be_positive(size):
    with pytest.raises(InputError, match="positive"):
        ImplicitTool.sphere(size)


def test_rounding_must_fit():
    with pytest.raises(InputError, match="rounding"):
        ImplicitTool.box((1, 1, 1), 0.6)
