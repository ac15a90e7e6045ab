"""The time of first contact: closed formulas, signed gaps at many times, grazing, speed, turning, deforming, trims."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadsculpt.collide.continuous.sweep import (
    MovingField,
    MovingPatches,
    MovingPoint,
    RigidPatches,
    SweepCache,
    first_contact,
)
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.errors import GeometryError, InputError
from cadsculpt.motion.motion import Motion
from cadsculpt.motion.pose import Pose
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop
from cadsculpt.tools.implicit import ImplicitTool

TOLERANCE = 1e-3


def _motion(at, displacement, rotation=(0, 0, 0), pose=None):
    return Motion(Pose(np.array(at, float), np.eye(3) if pose is None else pose), displacement, rotation)


def _resting(*surfaces, resolution=9):
    nets = tuple(np.array(s.control_points) for s in surfaces)
    return MovingPatches(tuple(PatchGrid.of(s, resolution) for s in surfaces), nets, nets)


def _rigid(motion, *surfaces, resolution=9):
    grids = tuple(PatchGrid.of(s, resolution) for s in surfaces)
    return RigidPatches(grids, tuple(s.control_points for s in surfaces), motion)


def _field(shape, motion, convex=False):
    return MovingField(shape, shape.box_corners, motion, convex)


class _Bumpy:
    """A mesh-like tool: a distance by brute force over many points of a ring, each with a small ball around it."""

    def __init__(self):
        angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
        self.points = np.stack([np.cos(angle), np.sin(angle), 0.2 * np.cos(3 * angle)], axis=1)
        self.box_corners = np.array([[-1.2, -1.2, -0.4], [1.2, 1.2, 0.4]])

    def field(self, points):
        away = points[:, None] - self.points
        distance = np.linalg.norm(away, axis=2)
        k = distance.argmin(axis=1)
        rows = np.arange(len(k))
        return distance[rows, k] - 0.2, away[rows, k] / np.maximum(distance[rows, k], 1e-300)[:, None]


@pytest.mark.parametrize("reach", [2.0, 200.0, 1e7])
def test_a_tool_that_crosses_the_part_in_one_step_is_caught(shapes, reach):
    """Down through a plate of size 10 at up to a million times its size per step: the time is (height - size) / way."""
    plate = _resting(shapes.plate())
    motion = _motion((5.1, 4.3, reach), (0, 0, -2 * reach))
    tools = {
        "point": (MovingPoint(motion), 0.0),
        "ball": (_field(ImplicitTool.sphere(1.0), motion), 1.0),
        "convex ball": (_field(ImplicitTool.sphere(1.0), motion, True), 1.0),
        "box": (_field(ImplicitTool.box((1, 2, 1)), motion, True), 0.5),
        "torus": (_field(ImplicitTool.torus(1.0, 0.25), motion), 0.25),
        "mesh": (_field(_Bumpy(), motion), 0.4),
        "patches": (_rigid(motion, shapes.ball(1.0)), 1.0),
        "faces": (_rigid(motion, *shapes.box(1.0)), 0.5),
    }
    for name, (tool, below) in tools.items():
        found = first_contact(plate, tool, tolerance=TOLERANCE)
        assert found is not None, name
        assert not found.exhausted
        time = (reach - below) / (2 * reach)
        assert found.low <= time + 1e-12, name
        assert found.low <= found.high
        # within the tolerance, which takes so long to cross
        assert found.low >= time - 1.01 * TOLERANCE / (2 * reach) - 1e-12, name
        assert abs(found.point[2]) < 1e-9
        assert (found.b_u is None) == (name not in ("patches", "faces"))


@pytest.mark.parametrize("spin", [(0, 0, 0), (0.4, -0.2, 0.3), (3.0, 2.0, -9.0)])
@pytest.mark.parametrize("speed", [20.0, 2e6])
def test_a_ball_past_a_ball_by_a_hair(shapes, speed, spin):
    model = _resting(shapes.ball(3.0))
    for hair, meets in ((5 * TOLERANCE, False), (-5 * TOLERANCE, True)):
        offset = 4.0 + hair
        motion = _motion((-0.5 * speed, 0, offset), (speed, 0, 0), spin)
        for tool in (_field(ImplicitTool.sphere(1.0), motion, True), _rigid(motion, shapes.ball(1.0))):
            found = first_contact(model, tool, tolerance=TOLERANCE)
            if not meets:
                assert found is None
                continue
            time = 0.5 - np.sqrt(16.0 - offset**2) / speed
            late = 0.5 - np.sqrt((4.0 + TOLERANCE) ** 2 - offset**2) / speed
            assert found is not None
            assert late - 1e-9 <= found.low <= time + 1e-9
            assert found.high <= time + 1e-9


def test_a_turning_box_meets_a_plane_with_its_edge(shapes):
    # the lowest edge of a cube of half size 1 turned by s about y lies at -(sin s + cos s)
    plane = _resting(shapes.plate(z=-1.2, size=10.0))
    motion = _motion((5, 5, 0), (0, 0, 0), (0, 1.0, 0))
    time = np.arcsin(1.2 / np.sqrt(2)) - np.pi / 4
    cube = ImplicitTool.box((2, 2, 2))
    for tool in (_field(cube, motion), _field(cube, motion, True), _rigid(motion, *shapes.box(2.0))):
        found = first_contact(plane, tool, tolerance=TOLERANCE)
        assert found is not None
        assert time - 2.5 * TOLERANCE <= found.low <= found.high <= time + 2.5 * TOLERANCE
        assert found.low <= time + 1e-9
    # many whole turns, above what the corners reach
    above = _motion((5, 5, 0.3), (0, 0, 0), (0, 40.0, 0))
    assert first_contact(plane, _field(cube, above, True), tolerance=TOLERANCE) is None
    assert first_contact(plane, _rigid(above, *shapes.box(2.0)), tolerance=TOLERANCE) is None


def test_a_point_on_an_arc_is_a_segment_of_its_origin(shapes):
    plate = _resting(shapes.plate())
    found = first_contact(plate, MovingPoint(_motion((2, 3, 1), (4, 4, -4), (9, 9, 9))), tolerance=TOLERANCE)
    assert 0.25 - TOLERANCE <= found.low <= 0.25
    np.testing.assert_allclose(found.point, [3, 4, 0], atol=2 * TOLERANCE)
    # past the border, and ending above
    for at, way in (((11, 5, 1), (0, 0, -2)), ((5, 5, 1), (0, 0, -0.99))):
        assert first_contact(plate, MovingPoint(_motion(at, way)), tolerance=TOLERANCE) is None


def test_nets_that_deform(shapes):
    plate = shapes.plate()
    grid = PatchGrid.of(plate, 9)
    low = np.array(plate.control_points)
    up = low + [0, 0, 4.0]
    rising = MovingPatches((grid,), (low,), (up,))
    motion = _motion((5, 5, 3), (0, 0, 0))
    for tool in (_field(ImplicitTool.sphere(1.0), motion), _rigid(motion, shapes.ball(1.0))):
        assert abs(first_contact(rising, tool, tolerance=TOLERANCE).low - 0.5) < TOLERANCE
    assert abs(first_contact(rising, MovingPoint(motion), tolerance=TOLERANCE).low - 0.75) < TOLERANCE
    # two that come towards each other: 4 s = 5 - 4 s
    falling = MovingPatches((grid,), (low + [3, 2, 5.0],), (low + [3, 2, 1.0],))
    found = first_contact(rising, falling, tolerance=TOLERANCE)
    assert abs(found.low - 0.625) < TOLERANCE
    # from a later start, and from one after the two have passed
    assert first_contact(rising, falling, tolerance=TOLERANCE, start=0.5).low == pytest.approx(0.625, abs=TOLERANCE)
    assert first_contact(rising, falling, tolerance=TOLERANCE, start=0.7) is None
    # one control point alone rises: a cubic's bump of 4/9 of it in the middle of six
    bump = low.copy()
    bump[2:4, 2:4, 2] += 8.0
    top = float(plate.with_control_points(bump).evaluate(0.5, 0.5)[2])
    probe = MovingPoint(_motion((5, 5, 1), (0, 0, 0)))
    found = first_contact(MovingPatches((grid,), (low,), (bump,)), probe, tolerance=1e-5)
    assert found.low == pytest.approx(1.0 / top, abs=1e-5)


def _sheet(shapes, rng, z, rational):
    """A sheet that is a graph over its own plane: x and y are linear in u and v."""
    degree = int(rng.integers(1, 5))
    count = degree + 1 + int(rng.integers(0, 5))
    s = shapes.plate(count=count, degree=degree, z=z, height=lambda x, y: rng.normal(scale=0.8, size=x.shape))
    if not rational:
        return s
    # x and y stay linear where all weights are one number: rational code, the same surface
    return BSplineSurface(s.control_points, s.knots_u, s.knots_v, degree, degree, np.full(s.shape, 0.7))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.booleans(), st.sampled_from([1.0, 30.0, 1e4]))
def test_sheets_never_cross_before(shapes, seed, rational, speed):
    """Two random sheets, both deforming: above each other until the contact, by their signed gap at many times."""
    rng = np.random.default_rng(seed)
    a, b = _sheet(shapes, rng, 0.0, rational), _sheet(shapes, rng, 4.0, False)
    nets = [np.array(s.control_points) for s in (a, b)]
    ends = [net + [0, 0, 1] * rng.normal(scale=0.5, size=net.shape) for net in nets]
    ends[1] = ends[1] - [0, 0, speed * rng.uniform(0.5, 6.0)]
    grids = [PatchGrid.of(s, 7) for s in (a, b)]
    bodies = [MovingPatches((grid,), (n0,), (n1,)) for grid, n0, n1 in zip(grids, nets, ends, strict=True)]
    found = first_contact(bodies[0], bodies[1], tolerance=TOLERANCE)
    u = np.linspace(0, 1, 61)

    def heights(k, s):
        return (a, b)[k].with_control_points((1 - s) * nets[k] + s * ends[k]).evaluate(u[:, None], u)[..., 2]

    low = 1.0 if found is None else found.low
    times = np.concatenate([np.linspace(0, low, 60), low - np.logspace(-9, 0, 10) * low])
    for s in times[(times >= 0) & (times < low)]:
        assert (heights(1, s) - heights(0, s)).min() > 0.0
    if found is None:
        assert (heights(1, 1.0) - heights(0, 1.0)).min() > -1e-9
        return
    s = found.high
    pa = a.with_control_points((1 - s) * nets[0] + s * ends[0]).evaluate(found.a_u, found.a_v)
    pb = b.with_control_points((1 - s) * nets[1] + s * ends[1]).evaluate(found.b_u, found.b_v)
    assert np.linalg.norm(pa - pb) <= TOLERANCE
    np.testing.assert_allclose(found.point, pa, atol=1e-9)
    assert found.high - found.low <= TOLERANCE / speed


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_random_patches_and_motions_of_tools(shapes, seed, rational):
    """Turning capsules and balls of patches against deforming patches of all kinds: by the signed distance at samples."""
    rng = np.random.default_rng(seed)
    surface = shapes.random_surface(rng, rational=rational)
    net = np.array(surface.control_points)
    end = net + rng.normal(scale=0.3, size=net.shape)
    body = MovingPatches((PatchGrid.of(surface, 9),), (net,), (end,))
    at = np.array([5, 5, 6.0]) + rng.normal(scale=2.0, size=3)
    motion = _motion(at, np.array([5, 5, -4]) + rng.normal(scale=3.0, size=3) - at, rng.normal(scale=1.5, size=3))
    capsule = ImplicitTool.capsule(0.4, 2.0)
    ball = ImplicitTool.sphere(0.7)
    cases = [
        (_field(capsule, motion, True), capsule),
        (_field(ball, motion), ball),
        (_rigid(motion, shapes.ball(0.7)), ball),
    ]
    (u0, u1), (v0, v1) = surface.domain
    u, v = np.linspace(u0, u1, 60), np.linspace(v0, v1, 60)
    for tool, shape in cases:
        found = first_contact(body, tool, tolerance=0.01)
        low = 1.0 if found is None else found.low

        def gap(s, shape=shape):
            points = surface.with_control_points((1 - s) * net + s * end).evaluate(u[:, None], v).reshape(-1, 3)
            return shape.field(motion.pose(s).to_tool(points))[0]

        for s in np.linspace(0, low, 50):
            if s < low and not (s == 0 and found is not None and found.high == 0):
                # a surface has no inside: where the tool starts around it, patches are apart
                d = gap(s)
                assert np.abs(d).min() > 0 if isinstance(tool, RigidPatches) else d.min() > 0
        if found is None or found.exhausted:
            continue
        s = found.high
        place = surface.with_control_points((1 - s) * net + s * end).evaluate(found.a_u, found.a_v)
        np.testing.assert_allclose(place, found.point, atol=1e-9)
        assert shape.field(motion.pose(s).to_tool(place[None]))[0][0] <= 0.01 + 1e-9


def _holed(shapes):
    """A plate over [0, 10]^2 with a square hole over [4, 6]^2."""

    def loop(low, high, outer):
        corners = np.array([[low, low], [high, low], [high, high], [low, high], [low, low]])
        knots = np.array([0, 0, 1, 2, 3, 4, 4.0])
        return TrimLoop((TrimCurve(corners, knots, 1),), outer)

    s = shapes.plate()
    return BSplineSurface(
        s.control_points, s.knots_u, s.knots_v, s.degree_u, s.degree_v,
        trims=(loop(0.0, 1.0, True), loop(0.4, 0.6, False)),
    )  # fmt: skip


def test_trimmed_faces_touch_only_where_the_face_is(shapes):
    holed = _resting(_holed(shapes), resolution=21)
    ball, large = ImplicitTool.sphere(0.9), ImplicitTool.sphere(1.25)
    through = _motion((5, 5, 5), (0, 0, -10))
    for tool in (MovingPoint(through), _field(ball, through), _rigid(through, shapes.ball(0.9))):
        assert first_contact(holed, tool, tolerance=TOLERANCE) is None
    aside = _motion((5, 3.99, 5), (0, 0, -10))
    assert first_contact(holed, MovingPoint(aside), tolerance=TOLERANCE).low == pytest.approx(0.5, abs=TOLERANCE)
    # a larger ball sits on the edges of the hole: its centre is sqrt(1.25^2 - 1) above
    time = (5 - 0.75) / 10
    for tool in (_field(large, through, True), _rigid(through, shapes.ball(1.25))):
        found = first_contact(holed, tool, tolerance=TOLERANCE)
        assert time - 2 * TOLERANCE <= found.low <= time + 1e-9
        assert not (4.01 < found.point[0] < 5.99 and 4.01 < found.point[1] < 5.99)


def test_touching_at_the_start_and_coming_apart(shapes):
    plate = _resting(shapes.plate())
    away = _motion((5, 5, 0.9), (0, 0, 20))
    for tool in (_field(ImplicitTool.sphere(1.0), away), _rigid(away, shapes.ball(1.0))):
        found = first_contact(plate, tool, tolerance=TOLERANCE)
        assert (found.low, found.high) == (0.0, 0.0)
        assert first_contact(plate, tool, tolerance=TOLERANCE, start=0.5) is None
    on = MovingPoint(_motion((5, 5, 0), (0, 0, 0)))
    assert first_contact(plate, on, tolerance=TOLERANCE).high == 0.0
    # flat on flat, over a large area
    flat = _rigid(_motion((2, 2, 3), (0, 0, -4)), shapes.plate(size=5.0))
    found = first_contact(plate, flat, tolerance=1e-5)
    assert found.low == pytest.approx(0.75, abs=1e-5)
    assert not found.exhausted


def test_a_cache_changes_nothing(shapes):
    plate = _resting(shapes.plate(height=lambda x, y: np.sin(x) * np.cos(y)))
    cache = SweepCache()
    for k in range(4):
        motion = _motion((2 + k, 5, 3), (k, 1, -4), (0.1 * k, 0.2, 0))
        tool = _rigid(motion, shapes.ball(1.0))
        one, two = (first_contact(plate, tool, tolerance=TOLERANCE, cache=c) for c in (cache, None))
        assert (one.low, one.high, one.a_u, one.a_v, one.b_u, one.b_v) == (
            two.low, two.high, two.a_u, two.a_v, two.b_u, two.b_v,
        )  # fmt: skip


def test_a_spent_budget_is_said_and_what_is_proved_holds(shapes):
    plate = _resting(shapes.plate())
    motion = _motion((5.3, 4.8, 11), (0, 0, -20), (1, 2, 3))
    for tool in (_field(ImplicitTool.torus(1.0, 0.4), motion), _rigid(motion, shapes.ball(1.0))):
        found = first_contact(plate, tool, tolerance=1e-9, budget=20)
        assert found.exhausted
        assert 0.0 <= found.low <= 0.56
        assert found.high == np.inf


def test_bad_numbers_are_errors(shapes):
    surface = shapes.plate()
    plate = _resting(surface)
    motion = _motion((5, 5, 5), (0, 0, -10))
    point = MovingPoint(motion)
    bad = np.array(surface.control_points)
    bad[1, 1, 1] = np.nan
    with pytest.raises(GeometryError, match="not finite"):
        first_contact(MovingPatches(plate.grids, plate.start, (bad,)), point, tolerance=1.0)
    with pytest.raises(GeometryError, match="not finite"):
        first_contact(plate, RigidPatches(plate.grids, (bad,), motion), tolerance=1.0)
    with pytest.raises(GeometryError, match="shape"):
        first_contact(plate, RigidPatches(plate.grids, (bad[1:],), motion), tolerance=1.0)
    with pytest.raises(InputError, match="nets"):
        MovingPatches(plate.grids, plate.start, ())
    with pytest.raises(InputError, match="not finite"):
        _motion((5, 5, np.inf), (0, 0, 0))
    for tolerance in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="tolerance"):
            first_contact(plate, point, tolerance=tolerance)
    for start in (-0.1, 1.0, np.nan):
        with pytest.raises(InputError, match="sweep from"):
            first_contact(plate, point, tolerance=1.0, start=start)

    class Broken:
        box_corners = np.array([[-1.0] * 3, [1.0] * 3])

        def field(self, points):
            return np.full(len(points), np.nan), np.zeros((len(points), 3))

    with pytest.raises(InputError, match="not a number"):
        first_contact(plate, _field(Broken(), motion), tolerance=1.0)
    with pytest.raises(InputError, match="box"):
        first_contact(plate, MovingField(Broken(), np.full((2, 3), np.nan), motion), tolerance=1.0)


def test_a_half_space_and_many_patches(shapes):
    half = ImplicitTool.half_space()
    plate = _resting(shapes.plate())
    found = first_contact(plate, _field(half, _motion((0, 0, 3), (0, 0, -4)), True), tolerance=TOLERANCE)
    assert found.low == pytest.approx(0.75, abs=TOLERANCE)
    # turned about the edge x = 0 of its plane z = 1: it comes down to x = 10 at tan s = 0.1
    tilt = _motion((0, 0, 1), (0, 0, 0), (0, 0.5, 0))
    found = first_contact(plate, _field(half, tilt, True), tolerance=TOLERANCE)
    assert found.low == pytest.approx(np.arctan(0.1) / 0.5, abs=TOLERANCE)
    # the nearest of a row of plates is the one that is met, whatever its place in the list
    row = [shapes.plate(z=z) for z in (-3.0, -1.0, -2.0, -7.0)]
    found = first_contact(_resting(*row), MovingPoint(_motion((5, 5, 1), (0, 0, -10))), tolerance=TOLERANCE)
    assert found.a_face == 1
    assert found.low == pytest.approx(0.2, abs=TOLERANCE)
