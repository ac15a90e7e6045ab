"""Certified distance, verdict and kind of pairs whose truth is a closed formula."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadsculpt.collide.certified.distance import distance
from cadsculpt.collide.certified.pair_bounds import hull_gap
from cadsculpt.collide.certified.proximity import proximity, separation
from cadsculpt.collide.detect import FieldTool, PatchGrid, PointTool, SurfaceTool
from cadsculpt.errors import GeometryError, InputError
from cadsculpt.motion.pose import Pose
from cadsculpt.spline.surface import TrimCurve, TrimLoop
from cadsculpt.tools.implicit import ImplicitTool


def tool(*surfaces, resolution=9):
    return SurfaceTool(
        tuple(PatchGrid.of(s, resolution) for s in surfaces), tuple(np.array(s.control_points) for s in surfaces)
    )


def ball_field(radius, centre):
    return ImplicitTool.sphere(radius).placed(Pose(np.array(centre, dtype=float)))


def point(*at):
    return PointTool(np.array(at, dtype=float), 1.0)


def test_the_gap_of_hulls_is_a_lower_bound_and_sharp():
    from scipy.optimize import minimize

    rng = np.random.default_rng(4)
    for _ in range(60):
        a, b = rng.normal(size=(4, 3)), rng.normal(size=(4, 3)) + rng.normal(size=3) * 3
        if rng.random() < 0.3:
            a[3] = a[2]
        gap = hull_gap(a, b, 0.0, np.inf)

        def apart(w, a=a, b=b):
            r = w[:4] @ a - w[4:] @ b
            return r @ r

        ones = [{"type": "eq", "fun": lambda w, s=s: w[s].sum() - 1} for s in (slice(0, 4), slice(4, 8))]
        best = minimize(apart, np.full(8, 0.25), bounds=[(0, 1)] * 8, constraints=ones, tol=1e-14)
        assert gap <= np.sqrt(best.fun) + 1e-7
        if gap > 0.05:
            assert gap == pytest.approx(np.sqrt(best.fun), rel=1e-4)


BODIES = {"spline": lambda s, r, c: tool(s.ball(r, c)), "field": lambda s, r, c: ball_field(r, c)}


@pytest.mark.parametrize("first", BODIES)
@pytest.mark.parametrize("second", BODIES)
@pytest.mark.parametrize(
    ("centre", "verdict", "kind"),
    [
        ((10.0, 1.0, 2.0), "clear", "clear"),
        ((5.0, 4.0, -4.9), "clear", "clear"),
        ((8.0001, 0.0, 0.0), "clear", "clear"),
        ((8.0, 0.0, 0.0), "contact", "touching"),
        ((0.0, 0.0, 8.0), "contact", "touching"),
        ((6.0, 1.0, 0.3), "contact", "piercing"),
        ((1.0, 0.5, 0.0), "contact", "contained"),
    ],
)
def test_two_balls(shapes, first, second, centre, verdict, kind):
    a, b = BODIES[first](shapes, 5.0, (0.0, 0.0, 0.0)), BODIES[second](shapes, 3.0, centre)
    truth = max(0.0, float(np.linalg.norm(centre)) - 8.0)
    for one, two, flip in ((a, b, False), (b, a, True)):
        found = proximity(one, two)
        assert (found.verdict, found.kind) == (verdict, kind)
        assert found.distance.low <= truth + 1e-12
        assert found.distance.high >= truth - 1e-12
        assert found.distance.high - found.distance.low <= 1.2e-5
        assert not found.distance.exhausted
        if truth > 0:
            w = found.distance.a, found.distance.b
            assert np.linalg.norm(w[0].point - w[1].point) <= found.distance.high + 1e-12
            radii = (3.0, 5.0) if flip else (5.0, 3.0)
            centres = (centre, (0, 0, 0)) if flip else ((0, 0, 0), centre)
            for witness, radius, middle in zip(w, radii, centres, strict=True):
                assert np.linalg.norm(witness.point - middle) == pytest.approx(radius, abs=1e-9)


def test_the_contacts_of_two_balls_lie_on_their_circle(shapes):
    a, b = shapes.ball(5.0), shapes.ball(3.0, (6.0, 0.0, 0.0))
    found = proximity(tool(a, resolution=17), tool(b, resolution=17)).contacts
    x = (36.0 + 25.0 - 9.0) / 12.0
    assert len(found) > 20
    assert found.point[:, 0] == pytest.approx(np.full(len(found), x), abs=1e-7)
    for pairs, surface, point_of in ((found, a, found.point), (found, b, found.other)):
        u, v = (pairs.u_a, pairs.v_a) if surface is a else (pairs.u_b, pairs.v_b)
        assert surface.evaluate(u, v) == pytest.approx(point_of, abs=1e-9)
    assert np.einsum("ij,ij->i", found.normal, found.point / 5.0) == pytest.approx(np.ones(len(found)), abs=1e-7)
    # no point twice, all around, and the same again
    gaps = np.linalg.norm(found.point[:, None] - found.point[None], axis=2) + np.eye(len(found))
    assert gaps.min() > 1e-5
    angle = np.sort(np.arctan2(found.point[:, 2], found.point[:, 1]))
    assert np.diff(np.append(angle, angle[0] + 2 * np.pi)).max() < 0.8
    again = proximity(tool(a, resolution=17), tool(b, resolution=17)).contacts
    assert again.point.tobytes() == found.point.tobytes()


@pytest.mark.parametrize(
    ("centre", "kind", "gap"),
    [
        ((5.0, 0.0, 0.0), "clear", 1.0),
        ((4.0, 1.0, 1.0), "touching", 0.0),
        ((4.0, 4.0, 1.0), "touching", 0.0),
        ((1.0, 0.0, 0.0), "piercing", 0.0),
        ((3.99, 1.0, 1.0), "piercing", 0.0),
        ((0.0, 0.0, 0.0), "contained", 0.0),
    ],
)
def test_boxes_of_six_patches(shapes, centre, kind, gap):
    found = proximity(tool(*shapes.box(), resolution=3), tool(*shapes.box(centre=centre), resolution=3))
    assert found.kind == kind
    assert found.distance.low <= gap <= found.distance.high
    assert found.distance.high - found.distance.low < 1e-5


def test_a_small_box_inside_a_large_one(shapes):
    inner, outer = tool(*shapes.box(2.0), resolution=3), tool(*shapes.box(6.0), resolution=3)
    for a, b in ((inner, outer), (outer, inner)):
        found = proximity(a, b)
        assert (found.verdict, found.kind) == ("contact", "contained")
        assert (found.distance.low, found.distance.high) == (0.0, 0.0)
        assert separation(a, b).high == 0.0
        # the shells themselves are apart
        assert distance(a, b).low == pytest.approx(2.0, abs=1e-5)
    # without its lid the outer one holds nothing
    open_box = tool(*shapes.box(6.0)[:5], resolution=3)
    assert proximity(inner, open_box).kind == "clear"


@pytest.mark.parametrize(("height", "kind"), [(3.0, "touching"), (2.9999, "piercing"), (3.001, "clear")])
@pytest.mark.parametrize("body", BODIES)
def test_a_ball_on_a_sheet(shapes, height, kind, body):
    found = proximity(tool(shapes.plate()), BODIES[body](shapes, 3.0, (4.4, 5.2, height)))
    assert found.kind == kind


def test_sheets_that_cross_and_sheets_that_coincide(shapes):
    plate = tool(shapes.plate(), resolution=5)
    tilted = tool(shapes.plate(height=lambda x, y: 0.3 * (x - 4)), resolution=5)
    assert proximity(plate, tilted).kind == "piercing"
    assert proximity(plate, plate).kind == "touching"
    # one edge standing on the other's middle goes to one side only
    standing = tool(shapes.plate(height=lambda x, y: 0.3 * x), resolution=5)
    assert proximity(plate, standing).kind == "touching"


def test_sheets_that_lie_on_each_other_meet_in_a_few_points_all_over(shapes):
    """One for a cell or so, and none far from all; where sheets cross, the whole curve."""
    bumpy = shapes.plate(height=lambda x, y: 0.4 * np.sin(x) * np.cos(y))
    found = proximity(tool(bumpy), tool(bumpy))
    assert found.kind == "touching"
    points = found.contacts.point
    assert 30 <= len(points) <= 2 * 8 * 8
    assert np.abs(points - found.contacts.other).max() < 1e-9
    apart = np.linalg.norm(points[:, None] - points, axis=2) + 1e9 * np.eye(len(points))
    assert apart.min() > 0.3
    vertices = PatchGrid.of(bumpy, 9).matrices.points(bumpy.control_points, None).reshape(-1, 3)
    assert np.linalg.norm(vertices[:, None] - points, axis=2).min(axis=1).max() < 2.0
    tilted = tool(shapes.plate(height=lambda x, y: 0.3 * (x - 4.1)))
    curve = proximity(tool(shapes.plate()), tilted).contacts.point
    assert np.abs(curve[:, 0] - 4.1).max() < 1e-8
    assert np.diff(np.sort(curve[:, 1])).max() < 1.3


def test_points(shapes):
    ball = tool(shapes.ball())
    found = proximity(ball, point(7, 1, 2))
    assert found.verdict == "clear"
    assert found.distance.low <= np.sqrt(54) - 5 <= found.distance.high
    assert proximity(ball, point(1, 1, 1)).kind == "contained"
    assert proximity(ball, point(5, 0, 0)).kind == "touching"
    apart = distance(point(1, 2, 3), point(1, 2, 5))
    assert apart.low <= 2.0 <= apart.high + 1e-12


def test_the_clearance(shapes):
    a, b = tool(shapes.ball()), tool(shapes.ball(3.0, (8.5, 0.0, 0.0)))
    assert proximity(a, b, clearance=0.49).verdict == "clear"
    near = proximity(a, b, clearance=0.51)
    assert (near.verdict, near.kind) == ("contact", "clear")
    assert near.contacts.depth == pytest.approx([-0.5], abs=1e-5)


def test_a_budget_that_is_too_small_is_said_and_true(shapes):
    a, b = tool(shapes.ball()), tool(shapes.ball(3.0))
    found = distance(a, b, budget=3000)
    assert found.exhausted
    assert not found.decided
    assert 0.0 <= found.low <= 2.0 <= found.high
    assert distance(a, b, threshold=1.0).decided
    assert proximity(tool(shapes.ball()), tool(shapes.ball(3.0, (8.001, 0.0, 0.0))), budget=70).verdict == "undecided"


def disc(centre, radius):
    c = np.sqrt(0.5)
    around = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]], dtype=float)
    knots = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4.0])
    weights = np.array([1, c, 1, c, 1, c, 1, c, 1])
    return (TrimLoop((TrimCurve(np.array(centre) + radius * around, knots, 2, weights),)),)


def test_a_trimmed_face_counts_only_where_it_is(shapes):
    """Two plates at right angles to the line between their discs' rims: the truth is that of two circles."""
    one = replace(shapes.plate(), trims=disc((0.4, 0.5), 0.1))
    other = replace(shapes.plate(), trims=disc((0.9, 0.5), 0.05))
    found = distance(tool(one, resolution=33), tool(other, resolution=33), budget=40_000)
    # circles of radius 1 and 0.5 about x = 4 and x = 9
    assert found.low <= 3.5 <= found.high + 1e-12
    assert found.high - found.low < 1e-3
    assert found.a.point == pytest.approx([5.0, 5.0, 0.0], abs=2e-3)
    field = distance(tool(one, resolution=33), ball_field(1.0, (8.0, 5.0, 0.0)))
    assert field.low <= 2.0 <= field.high + 1e-12
    assert field.high - field.low < 2e-5


def test_many_idle_patches_are_not_looked_at(shapes):
    idle = [shapes.box(0.1, (20.0 + k, 3.0 * i, j)) for k in range(6) for i in range(4) for j in range(4)]
    many = tool(*(s for box in idle for s in box), *shapes.box(), resolution=2)
    found = distance(many, tool(shapes.ball(1.0, (-4.0, 0.0, 0.0))))
    assert found.low <= 1.0 <= found.high + 1e-12
    assert found.pairs < 3000


@pytest.mark.parametrize("seed", range(4))
def test_random_surfaces_against_dense_samples(shapes, seed):
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(seed)
    for k in range(6):
        a = shapes.random_surface(rng, rational=k % 2 == 0)
        b = shapes.random_surface(rng, rational=k % 3 == 0)
        b = b.with_control_points(b.control_points + [*rng.uniform(-6, 6, 2), rng.uniform(0, 9)])
        found = distance(tool(a), tool(b))
        clouds = []
        for s in (a, b):
            (u0, u1), (v0, v1) = s.domain
            clouds.append(s.evaluate(np.linspace(u0, u1, 90)[:, None], np.linspace(v0, v1, 90)).reshape(-1, 3))
        sampled = cKDTree(clouds[0]).query(clouds[1])[0].min()
        assert found.low <= sampled
        assert found.high <= sampled + 1e-9
        w = found.a, found.b
        apart = np.linalg.norm(a.evaluate(w[0].u, w[0].v) - b.evaluate(w[1].u, w[1].v))
        assert apart <= found.high + 1e-9
        assert found.high - found.low <= 3e-5


def test_random_tools_against_dense_samples(shapes):
    rng = np.random.default_rng(8)
    tools = [
        ImplicitTool.torus(2.0, 0.5), ImplicitTool.box((2.0, 1.0, 3.0)), ImplicitTool.cone(1.0, 2.0),
        ImplicitTool.ellipsoid((1.0, 2.0, 0.5)), ImplicitTool.cylinder(1.0, 2.0), ImplicitTool.half_space(),
    ]  # fmt: skip
    for shape in tools:
        surface = shapes.random_surface(rng, rational=True)
        pose = Pose.turned((*rng.uniform(2, 8, 2), 7.0), rng.normal(size=3), 40.0)
        field = shape.placed(pose)
        found = distance(tool(surface), field)
        (u0, u1), (v0, v1) = surface.domain
        points = surface.evaluate(np.linspace(u0, u1, 150)[:, None], np.linspace(v0, v1, 150)).reshape(-1, 3)
        sampled = max(0.0, float(field.field.distance(points).min()))
        assert found.low <= sampled + 1e-12
        assert found.high <= sampled + 1e-9
        assert not found.exhausted
    a, b = ImplicitTool.torus(2.0, 0.5), ImplicitTool.box((2.0, 1.0, 3.0))
    found = distance(a.placed(Pose()), b.placed(Pose(np.array([4.0, 0.0, 0.0]))))
    assert found.low <= 0.5 <= found.high + 1e-12
    assert found.high - found.low < 1e-4


class NotANumber:
    def distance(self, points):
        return np.full(len(points), np.nan)

    def gradient(self, points):
        return np.full(points.shape, np.nan)

    nearest = gradient

    def box(self):
        return np.array([[0.0, 0, 0], [1, 1, 1]])


def test_nan_is_an_error_never_clear(shapes):
    ball = tool(shapes.ball())
    bad = SurfaceTool(ball.grids, (np.where(np.arange(3) == 1, np.nan, ball.nets[0]),))
    for call in (distance, proximity):
        with pytest.raises(GeometryError, match="not finite"):
            call(ball, bad)
        with pytest.raises(InputError, match="not a number"):
            call(ball, FieldTool(NotANumber()))
        with pytest.raises(InputError, match="not a number"):
            call(FieldTool(NotANumber()), ball_field(1.0, (0, 0, 0)))
        with pytest.raises(InputError, match="not finite"):
            call(ball, point(np.nan, 0, 0))
    with pytest.raises(InputError, match="without end"):
        distance(ImplicitTool.half_space().placed(Pose()), ImplicitTool.half_space().placed(Pose()))
    with pytest.raises(InputError, match="clearance"):
        proximity(ball, ball, clearance=np.nan)
