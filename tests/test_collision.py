"""cs.collide: any two bodies, the verdict, how they lie, how far apart, and where."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cadsculpt as cs
from cadsculpt.errors import GeometryError, InputError
from cadsculpt.motion.pose import Pose
from cadsculpt.spline.surface import BSplineSurface
from cadsculpt.tools.implicit import ImplicitTool
from cadsculpt.tools.point import PointTool

PANEL = Path(__file__).parents[1] / "examples" / "thumb_press" / "panel.step"


def sheet(size: float = 10.0, height: float = 0.0, bump: float = 0.0, **changes: object) -> BSplineSurface:
    """A bicubic sheet over [0, size]^2; `bump` lifts its middle control point."""
    knots = np.array([0.0, 0, 0, 0, 0.5, 1, 1, 1, 1])
    x = size * np.array([knots[i + 1 : i + 4].mean() for i in range(5)])
    X, Y = np.meshgrid(x, x, indexing="ij")
    Z = np.full_like(X, height)
    Z[2, 2] += bump
    return BSplineSurface(np.stack([X, Y, Z], axis=-1), knots, knots, 3, 3, **changes)  # type: ignore[arg-type]


def test_parallel_sheets_are_as_far_apart_as_they_are_high():
    result = cs.collide(sheet(), sheet(height=1.75))
    assert (result.verdict, result.kind) == ("clear", "clear")
    assert result.distance.low <= 1.75 <= result.distance.high
    assert result.distance.high - result.distance.low <= 1e-5
    assert len(result.contacts) == 0


@pytest.mark.parametrize(("clearance", "verdict"), [(0.0, "clear"), (1.7, "clear"), (1.8, "contact")])
def test_nearer_than_the_clearance_is_a_contact_of_bodies_apart(clearance, verdict):
    result = cs.collide(sheet(), sheet(height=1.75), clearance=clearance)
    assert (result.verdict, result.kind) == (verdict, "clear")
    if verdict == "contact":
        assert result.contacts.depth == pytest.approx(-1.75, abs=1e-5)


def test_a_ball_that_just_touches_a_sheet_and_one_that_pierces_it():
    ball = ImplicitTool.sphere(2.0)
    for height, kind in ((2.0, "touching"), (1.9, "piercing"), (2.1, "clear")):
        result = cs.collide(sheet(), (ball, Pose(np.array([5.0, 5.0, height]))))
        assert result.kind == kind, height
        assert result.distance.low <= max(0.0, height - 2.0) <= result.distance.high + 1e-9
        if kind != "clear":
            away = np.linalg.norm(result.contacts.point - [5, 5, height], axis=1)
            assert away == pytest.approx(2.0, abs=1e-6)
            assert (result.contacts.face_a == 0).all()
            assert (result.contacts.face_b == -1).all()


def test_a_point_on_a_sheet_and_off_it():
    point = PointTool(1.0)
    at = sheet(bump=3.0).evaluate(0.4, 0.6)
    assert cs.collide(sheet(bump=3.0), (point, Pose(at))).verdict == "contact"
    away = cs.collide(sheet(), (point, Pose(np.array([5.0, 5.0, -3.0]))))
    assert away.verdict == "clear"
    assert away.distance.low <= 3.0 <= away.distance.high
    assert away.distance.high == pytest.approx(3.0, abs=1e-6)


def test_one_solid_inside_another_is_contained():
    small = (ImplicitTool.sphere(1.0), Pose(np.array([0.5, 0.0, 0.0])))
    result = cs.collide(ImplicitTool.box((10, 10, 10)), small)
    assert (result.verdict, result.kind) == ("contact", "contained")
    assert (result.distance.low, result.distance.high) == (0.0, 0.0)


def test_parts_faces_and_lists_of_surfaces_are_bodies():
    part = cs.read(PANEL)
    top = part.faces["top"]
    over = cs.collide(part, sheet(height=60.0))
    assert over.verdict == "clear"
    same = cs.collide(top, top.surface)
    assert same.verdict == "contact"
    assert same.distance.low == 0.0
    assert cs.collide([sheet(), sheet(height=5.0)], sheet(height=4.0)).distance.high == pytest.approx(1.0, abs=1e-5)


def test_a_pose_moves_any_body():
    moved = cs.collide(sheet(), (sheet(), Pose.turned([0.0, 0.0, 2.5], (0, 0, 1), 30.0)))
    assert moved.distance.low <= 2.5 <= moved.distance.high
    assert moved.distance.high == pytest.approx(2.5, abs=1e-5)


@pytest.mark.parametrize(
    ("thing", "says"),
    [
        (sheet().control_points, "is no body"),
        ("part.step", "cs.read"),
        ([], "no surface"),
        (3.0, "is no body"),
    ],
)
def test_what_is_no_body_is_refused_in_one_line(thing, says):
    with pytest.raises(InputError, match=says) as caught:
        cs.collide(sheet(), thing)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("b")


def test_numbers_that_are_no_numbers_are_never_clear():
    net = sheet(height=50.0).control_points.copy()
    net[2, 3, 1] = np.nan
    broken = sheet().with_control_points(net)
    with pytest.raises(GeometryError):
        cs.collide(sheet(), broken)
    for clearance in (np.nan, np.inf, -1.0):
        with pytest.raises(InputError, match="clearance"):
            cs.collide(sheet(), sheet(height=1.0), clearance=clearance)
    with pytest.raises(InputError):
        cs.collide(sheet(), (ImplicitTool.sphere(1.0), Pose(np.array([np.nan, 0.0, 0.0]))))


def test_the_package_is_still_a_package():
    import cadsculpt.collide.detect as module

    assert cs.collide.detect is module
    assert callable(cs.collide)


def prism(corners: list[tuple[float, float]], depth: float = 1.0) -> list[BSplineSurface]:
    """The walls of a prism over a polygon (x, z)."""
    walls = []
    knots = np.array([0.0, 0, 1, 1])
    for (x0, z0), (x1, z1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        net = np.array([[[x0, 0, z0], [x0, depth, z0]], [[x1, 0, z1], [x1, depth, z1]]])
        walls.append(BSplineSurface(net, knots, knots, 1, 1))
    return walls


def quad(points: list[list[float]]) -> BSplineSurface:
    knots = np.array([0.0, 0, 1, 1])
    a, b, c, d = np.array(points, dtype=float)
    return BSplineSurface(np.array([[a, d], [b, c]]), knots, knots, 1, 1)


@pytest.mark.parametrize("at", [(0.8, 0.5, 0.8), (0.4, 0.5, 0.4), (1.5, 0.5, 0.5)])
def test_a_body_beside_a_reentrant_edge_is_contained(at):
    """All of the ball is nearest to the edge itself, where no single face tells the side."""
    outline = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0)]
    walls = prism(outline[::-1])
    ends = []
    for y, order in ((0.0, 1), (1.0, -1)):
        for x0, x1, z0, z1 in ((0, 1, 0, 1), (1, 2, 0, 1), (0, 1, 1, 2)):
            ends.append(quad([[x0, y, z0], [x1, y, z0], [x1, y, z1], [x0, y, z1]][::order]))
    # the walls along the ends' inner borders are cut there, too
    solid = [w for w in walls if np.ptp(w.control_points[..., 0]) < 1.5 and np.ptp(w.control_points[..., 2]) < 1.5]
    solid += [quad([[x, 0, 0], [x, 1, 0], [x + 1, 1, 0], [x + 1, 0, 0]]) for x in (0.0, 1.0)] + [
        quad([[0, 0, z], [0, 0, z + 1], [0, 1, z + 1], [0, 1, z]]) for z in (0.0, 1.0)
    ]
    result = cs.collide([*solid, *ends], (ImplicitTool.sphere(0.05), Pose(np.array(at))))
    assert (result.verdict, result.kind) == ("contact", "contained")


def test_a_sheet_whose_net_reaches_out_of_a_solid_is_contained():
    cube = ImplicitTool.box((2.0, 2.0, 2.0))
    inner = sheet(size=1.0, height=-0.3, bump=1.6)
    assert inner.control_points[..., 2].max() > 1.0
    assert inner.evaluate(0.5, 0.5)[2] < 0.9
    result = cs.collide(cube, (inner, Pose(np.array([-0.5, -0.5, 0.0]))))
    assert (result.verdict, result.kind) == ("contact", "contained")
