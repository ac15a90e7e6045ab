"""Formulas and composed solids: against closed formulas, brute force over points of their surface, and each other."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cadsculpt.collide.detect import BoundedField, DetectOptions, PatchGrid, detect
from cadsculpt.errors import InputError
from cadsculpt.motion.pose import Pose
from cadsculpt.spline.surface import BSplineSurface
from cadsculpt.tools.composed import ComposedTool
from cadsculpt.tools.implicit import ImplicitTool
from cadsculpt.tools.superquadric import SuperquadricTool

BALL = ImplicitTool.sphere(1.0)
GYROID = "sin(3*x)*cos(3*y) + sin(3*y)*cos(3*z) + sin(3*z)*cos(3*x)"
HEART = "(x**2 + 9/4*y**2 + z**2 - 1)**3 - x**2*z**3 - 9/80*y**2*z**3"
UNIT = ([-1.5] * 3, [1.5] * 3)


def at(*place, turn=(0, 0, 1, 0)):
    return Pose.turned(place, turn[:3], turn[3])


def solids():
    """name: tool, and its value (sign) by hand."""

    def ball(x, c=(0, 0, 0), r=1.0):
        return np.linalg.norm(x - c, axis=1) - r

    def block(x, half=(1, 1, 1)):
        return (np.abs(x) - half).max(axis=1)

    box = ImplicitTool.box((2.0, 2.0, 2.0))
    pipe = ImplicitTool.cylinder(0.5, 4.0)
    return {
        "union": (
            ComposedTool.union([(BALL, at(0, 0, 0)), (ImplicitTool.sphere(0.7), at(1.2, 0, 0.2))]),
            lambda x: np.minimum(ball(x), ball(x, (1.2, 0, 0.2), 0.7)),
        ),
        "lens": (
            ComposedTool.intersection([(BALL, at(0, 0, 0)), (BALL, at(1.2, 0, 0))]),
            lambda x: np.maximum(ball(x), ball(x, (1.2, 0, 0))),
        ),
        "box less ball": (
            ComposedTool.difference([(box, at(0, 0, 0)), (ImplicitTool.sphere(0.8), at(0.3, 0, 1.0))]),
            lambda x: np.maximum(block(x), -ball(x, (0.3, 0, 1.0), 0.8)),
        ),
        "box less two pipes": (
            ComposedTool.difference([(box, at(0, 0, 0)), (pipe, at(0, 0, 0)), (pipe, at(0, 0, 0, turn=(1, 0, 0, 90)))]),
            lambda x: np.maximum.reduce(
                [block(x), 0.5 - np.hypot(x[:, 0], x[:, 1]), 0.5 - np.hypot(x[:, 0], x[:, 2])]
            ),
        ),
        "nested": (
            ComposedTool.union(
                [
                    (ComposedTool.intersection([(BALL, at(0, 0, 0)), (ImplicitTool.half_space(), at(0, 0, 0))]), at(0, 0, 0.5)),
                    (SuperquadricTool.of((1.0, 0.5, 0.4), (0.4, 0.4)), at(0, 0, 0)),
                ]
            ),
            lambda x: np.minimum(
                np.maximum(ball(x, (0, 0, 0.5)), 0.5 - x[:, 2]),
                (((np.abs(x) / (1.0, 0.5, 0.4)) ** 5).sum(axis=1)) - 1,
            ),
        ),
        "gyroid": (
            ComposedTool.formula(GYROID, ([-1.0] * 3, [1.0] * 3)),
            lambda x: np.maximum(
                sum(np.sin(3 * x[:, k]) * np.cos(3 * x[:, (k + 1) % 3]) for k in range(3)), block(x)
            ),
        ),
        "heart": (
            ComposedTool.formula(HEART, UNIT),
            lambda x: (
                (x[:, 0] ** 2 + 9 / 4 * x[:, 1] ** 2 + x[:, 2] ** 2 - 1) ** 3
                - x[:, 0] ** 2 * x[:, 2] ** 3
                - 9 / 80 * x[:, 1] ** 2 * x[:, 2] ** 3
            ),
        ),
        "formula and capsule": (
            ComposedTool.difference(
                [
                    (ComposedTool.formula("x**2 + y**2 + z**2 - 1", UNIT), at(0, 0, 0)),
                    (ImplicitTool.capsule(0.3, 1.0), at(0.8, 0, 0)),
                ]
            ),
            lambda x: np.maximum(
                ball(x), 0.3 - np.sqrt((x[:, 0] - 0.8) ** 2 + x[:, 1] ** 2 + np.maximum(np.abs(x[:, 2]) - 0.5, 0) ** 2)
            ),
        ),
    }  # fmt: skip


SOLIDS = solids()


@pytest.fixture(params=SOLIDS, ids=list(SOLIDS))
def solid(request):
    return SOLIDS[request.param]


def places(tool, count, seed=0):
    low, high = tool.box_corners
    return np.random.default_rng(seed).uniform(low - 0.4, high + 0.4, (count, 3))


def crossings(value, corners, cells=60):
    """Points of the surface, by bisection along the edges of a grid: independent of the search."""
    axes = [np.linspace(corners[0, k] - 0.06, corners[1, k] + 0.06, cells) for k in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = value(grid.reshape(-1, 3)).reshape(grid.shape[:3]) < 0
    found = []
    for axis in range(3):
        a, b = np.moveaxis(grid, axis, 0)[:-1], np.moveaxis(grid, axis, 0)[1:]
        i, j = np.moveaxis(inside, axis, 0)[:-1], np.moveaxis(inside, axis, 0)[1:]
        p, q = a[i & ~j], b[i & ~j]
        p, q = np.concatenate([p, b[j & ~i]]), np.concatenate([q, a[j & ~i]])
        for _ in range(40):
            m = 0.5 * (p + q)
            solid = (value(m) < 0)[:, None]
            p, q = np.where(solid, m, p), np.where(solid, q, m)
        found.append(0.5 * (p + q))
    return np.concatenate(found), max(axis[1] - axis[0] for axis in axes)


def test_the_sign_is_that_of_the_formula_by_hand(solid):
    tool, value = solid
    x = places(tool, 1500)
    assert np.array_equal(tool.field(x)[0] < 0, value(x) < 0)
    assert np.array_equal(tool.bound(x) < 0, value(x) < 0)


def test_no_point_of_the_surface_is_nearer_and_one_is_as_near(solid):
    """Against points of the surface found by bisection of the formula by hand."""
    tool, value = solid
    x = places(tool, 600, seed=1)
    d, n = tool.field(x)
    points, h = crossings(value, tool.box_corners)
    near = cKDTree(points).query(x)[0]
    assert (near >= np.abs(d) - 1e-9).all()
    # the nearest crossing lies within a cell's diagonal of the nearest point
    assert (near <= np.abs(d) + np.sqrt(3) * h).all()
    # and the foot is on the surface
    np.testing.assert_allclose(value(x - d[:, None] * n), 0.0, atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, rtol=1e-9)


def test_the_bound_never_exceeds_the_distance_and_is_lipschitz(solid):
    tool, value = solid
    x = places(tool, 2000, seed=2)
    points, _ = crossings(value, tool.box_corners, cells=40)
    assert (np.abs(tool.bound(x)) <= cKDTree(points).query(x)[0] + 1e-9).all()
    assert (np.abs(tool.bound(x)) <= np.abs(tool.field(x)[0]) + 1e-12).all()
    y = x + np.random.default_rng(3).normal(scale=0.05, size=x.shape)
    assert (np.abs(tool.bound(x) - tool.bound(y)) <= np.linalg.norm(x - y, axis=1) * (1 + 1e-9) + 1e-12).all()


def test_near_the_surface_the_distance_is_lipschitz(solid):
    tool, _ = solid
    rng = np.random.default_rng(4)
    x = tool.seeds.points[rng.integers(len(tool.seeds.points), size=300)] + rng.normal(scale=0.05, size=(300, 3))
    y = x + rng.normal(scale=0.02, size=x.shape)
    change = np.abs(tool.field(x)[0] - tool.field(y)[0])
    assert (change <= np.linalg.norm(x - y, axis=1) + 1e-9).all()


def test_the_box_holds_the_solid(solid):
    tool, value = solid
    x = places(tool, 4000, seed=5)
    low, high = tool.box_corners
    assert ((x >= low) & (x <= high)).all(axis=1)[value(x) < 0].all()


def test_lens_in_closed_form():
    """Two unit balls 1.2 apart share a lens whose edge is a circle of radius 0.8."""
    tool = SOLIDS["lens"][0]
    x = np.random.default_rng(6).uniform([-0.6, -1.2, -1.2], [1.8, 1.2, 1.2], (1500, 3))
    across, r = np.abs(x[:, 0] - 0.6), np.hypot(x[:, 1], x[:, 2])
    to_centre = np.hypot(across + 0.6, r)
    on_cap = across + 0.6 >= 0.6 * to_centre
    edge = np.hypot(across, r - 0.8)
    truth = np.where(on_cap, to_centre - 1, np.where(to_centre < 1, -edge, edge))
    np.testing.assert_allclose(tool.field(x)[0], truth, atol=1e-12)


def test_a_formula_that_is_a_box_or_a_ball_is_that_box_or_ball():
    x = np.random.default_rng(7).uniform(-1.6, 1.6, (800, 3))
    ball, box = (
        ComposedTool.formula("x*x + y*y + z*z - 1", UNIT),
        ComposedTool.formula("max(abs(x) - 1, abs(y) - 0.7, abs(z) - 0.5)", UNIT),
    )
    np.testing.assert_allclose(ball.field(x)[0], np.linalg.norm(x, axis=1) - 1, atol=1e-9)
    np.testing.assert_allclose(box.field(x)[0], ImplicitTool.box((2, 1.4, 1)).field(x)[0], atol=1e-9)
    # steep or flat, the tool is the same
    steep = ComposedTool.formula("1e6*(x*x + y*y + z*z - 1)**3", UNIT)
    np.testing.assert_allclose(steep.field(x)[0], np.linalg.norm(x, axis=1) - 1, atol=1e-6)


def test_a_body_is_cut_by_its_box():
    tool = ComposedTool.formula("x*x + y*y + z*z - 1", ([-1.5, -1.5, -0.25], [1.5, 1.5, 1.5]))
    d, n = tool.field(np.array([[0.1, 0.2, -0.2], [0.1, 0.0, -0.75], [0.0, 0.0, 1.2], [2.0, 0.0, -1.25]]))
    rim = np.sqrt(1 - 0.25**2)
    np.testing.assert_allclose(d, [-0.05, 0.5, 0.2, np.hypot(2 - rim, 1.0)], atol=1e-9)
    np.testing.assert_allclose(n[:2], [[0, 0, -1], [0, 0, -1]], atol=1e-6)


def test_half_spaces_keep_their_infinite_boxes():
    wedge = ComposedTool.intersection(
        [(ImplicitTool.half_space(), at(0, 0, 0)), (ImplicitTool.half_space(), at(0, 0, 0, turn=(1, 0, 0, 90)))]
    )
    assert not np.isfinite(wedge.box_corners).all()
    x = np.random.default_rng(8).uniform(-0.9, 0.9, (500, 3))
    q = np.column_stack([x[:, 1], -x[:, 2]])  # inside: y < 0 < z
    outside = np.linalg.norm(np.maximum(q, 0), axis=1)
    np.testing.assert_allclose(wedge.field(x)[0], np.where(outside > 0, outside, q.max(axis=1)), atol=1e-9)
    assert np.isinf(wedge.placed(Pose()).field.box()).all()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ComposedTool.intersection([(BALL, at(0, 0, 0)), (BALL, at(2.2, 0, 0))]), "nothing in common"),
        (lambda: ComposedTool.intersection([(BALL, at(0, 0, 0)), (BALL, at(1.5, 1.5, 0))]), "nothing in common"),
        (lambda: ComposedTool.intersection([(BALL, at(0, 0, 0)), (BALL, at(2, 0, 0))]), "nothing in common"),
        (
            lambda: ComposedTool.difference([(BALL, at(0, 0, 0)), (ImplicitTool.sphere(1.1), at(0, 0, 0))]),
            "nothing is left",
        ),
        (lambda: ComposedTool.union([(BALL, at(0, 0, 0))]), "two or more"),
        (lambda: ComposedTool.formula("x*x + 1", UNIT), "nowhere negative"),
        (lambda: ComposedTool.formula("x*x", UNIT), "nowhere negative"),
        (lambda: ComposedTool.formula("1/z", UNIT), "division by zero"),
        (lambda: ComposedTool.formula("x", ([0, 0, 0], [1, 0, 1])), "lower corner first"),
    ],
)
def test_what_is_empty_or_undefined_is_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_a_sliver_is_found():
    """A lens 2e-5 thick, and a ball of a thousandth of its box."""
    thin = ComposedTool.intersection([(BALL, at(0, 0, 0)), (BALL, at(2 - 2e-5, 0, 0))])
    assert thin.field(np.array([[1 - 1e-5, 0, 0]]))[0] == pytest.approx([-1e-5], rel=1e-6)
    small = ComposedTool.formula("(x - 0.3)**2 + y**2 + z**2 - 1e-6", UNIT)
    assert small.field(np.array([[0.3, 0, 0.002]]))[0] == pytest.approx([1e-3], rel=1e-6)
    assert np.ptp(small.box_corners, axis=0) == pytest.approx([2e-3] * 3, rel=0.2)


def test_contacts_of_a_formula_are_those_of_the_same_ball():
    """Through the whole pipeline: the same vertices, depths, points and normals as with an exact distance."""
    t = np.linspace(0.0, 10.0, 5)
    X, Y = np.meshgrid(t, t, indexing="ij")
    knots = np.array([0.0, 0, 0, 0, 0.5, 1, 1, 1, 1])
    plate = BSplineSurface(np.stack([X, Y, 0.1 * np.sin(X)], axis=-1), knots, knots, 3, 3)
    grid = PatchGrid.of(plate, 41)
    pose = Pose.turned([5.2, 4.9, 1.2], [1, 1, 0], 25)
    ball = ImplicitTool.sphere(1.5).placed(pose)
    formula = ComposedTool.formula("x**2 + y**2 + z**2 - 2.25", ([-2] * 3, [2] * 3)).placed(pose)
    assert isinstance(formula.field, BoundedField)
    assert not isinstance(ball.field, BoundedField)
    for margin in (0.0, 0.2):
        one, other = (
            detect([grid], [plate.control_points], [tool], DetectOptions(margin=margin)).contacts
            for tool in (ball, formula)
        )
        assert len(one) == len(other) > 20
        assert np.array_equal(one.u, other.u)
        for name in ("depth", "tool_point", "area"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-8)
        np.testing.assert_allclose(one.normal, other.normal, atol=1e-6)
        again = detect([grid], [plate.control_points], [formula], DetectOptions(margin=margin)).contacts
        assert other.depth.tobytes() == again.depth.tobytes()


def test_a_small_formula_between_the_vertices_is_not_missed():
    t = np.linspace(0.0, 10.0, 5)
    X, Y = np.meshgrid(t, t, indexing="ij")
    knots = np.array([0.0, 0, 0, 0, 0.5, 1, 1, 1, 1])
    plate = BSplineSurface(np.stack([X, Y, 0 * X], axis=-1), knots, knots, 3, 3)
    grid = PatchGrid.of(plate, 8)
    spot = Pose(np.array([3.1, 4.4, 0.15]))
    tool = ComposedTool.formula("x**2 + y**2 + z**2 - 0.04", ([-0.3] * 3, [0.3] * 3)).placed(spot)
    contacts = detect([grid], [plate.control_points], [tool], DetectOptions(tolerance=0.01)).contacts
    assert len(contacts)
    assert contacts.depth.max() == pytest.approx(0.05, abs=0.02)
    np.testing.assert_allclose(contacts.depth, 0.2 - np.linalg.norm(contacts.point - spot.at, axis=1), atol=1e-9)
