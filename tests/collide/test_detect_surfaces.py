"""Surface tools (paper 4.3 to 4.7): contacts on the true surfaces, crossing triangles, containment, open borders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadsculpt.collide.contacts import Contacts
from cadsculpt.collide.detect import DetectCache, DetectOptions, SurfaceTool, detect
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.collide.tri_tri import Relation, triangle_relation
from cadsculpt.collide.triangulate import whole_mesh
from cadsculpt.spline.surface import TrimCurve, TrimLoop


def _tool(surfaces, resolution, reach=0.0):
    grids = tuple(PatchGrid.of(s, resolution) for s in surfaces)
    return SurfaceTool(grids, tuple(np.array(s.control_points) for s in surfaces), reach)


def _detect(grid, tool, options=None, **more):
    return detect([grid], [grid.surface.control_points], [tool], options or DetectOptions(), **more)


def _bytes(contacts):
    return b"".join(np.ascontiguousarray(getattr(contacts, name)).tobytes() for name in Contacts.__dataclass_fields__)


def _on_grid(contacts, grid):
    return np.isin(contacts.u, grid.matrices.u) & np.isin(contacts.v, grid.matrices.v)


def _box_distance(points, centre, half):
    q = np.abs(points - centre) - half
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


@pytest.mark.parametrize("margin", [0.0, 0.4])
@pytest.mark.parametrize("depth", [0.05, 1.0, 4.9])
def test_a_b_spline_ball_touches_like_the_ball_itself(shapes, depth, margin):
    """From a light touch to a cut through the middle: the depth at every vertex is that of the exact ball."""
    R = 3.0
    grid = PatchGrid.of(shapes.plate(14.0, 7, 3, height=lambda x, y: 0.3 * np.sin(x)), 57)
    top = grid.surface.evaluate(0.5, 0.5)
    centre = top + [0.02, -0.013, R - depth]
    exact = shapes.Sphere(centre, R)
    contacts = _detect(grid, _tool([shapes.ball(R, centre)], (33, 17)), DetectOptions(margin=margin)).contacts
    points = grid.matrices.points(grid.surface.control_points).reshape(-1, 3)
    truth = -exact.distance(points)
    assert _on_grid(contacts, grid).all()
    assert len(contacts) == (truth >= -margin).sum() > 3
    assert contacts.depth == pytest.approx(-exact.distance(contacts.point), abs=1e-9)
    deep = np.linalg.norm(contacts.point - centre, axis=1) > 0.5
    assert contacts.normal[deep] == pytest.approx(-exact.gradient(contacts.point)[deep], abs=1e-6)
    assert contacts.tool_point[deep] == pytest.approx(exact.nearest(contacts.point)[deep], abs=1e-6)


def test_forces_of_a_surface_tool_do_not_depend_on_the_resolution(shapes):
    R, d = 3.0, 0.4
    a = np.sqrt(R * R - (R - d) ** 2)
    exact = 2 * np.pi * ((R**3 - (R * R - a * a) ** 1.5) / 3 - (R - d) * a * a / 2)
    error = []
    for resolution in (26, 51, 101):
        grid = PatchGrid.of(shapes.plate(10.0), resolution)
        contacts = _detect(grid, _tool([shapes.ball(R, [5.1, 4.87, R - d])], (25, 13))).contacts
        depth = np.sqrt(R * R - ((contacts.point - [5.1, 4.87, 0])[:, :2] ** 2).sum(axis=1)) - (R - d)
        error.append(abs((contacts.area * depth).sum() / exact - 1))
    assert error[0] < 0.05
    assert error[-1] < 5e-3


@pytest.mark.parametrize("height", [1.9, 1.0, 0.0, -1.3])
def test_a_cube_of_six_patches_is_one_solid(shapes, height):
    """Edges and corners between patches: the side of the nearest patches' common edge is told by both."""
    grid = PatchGrid.of(shapes.plate(10.0, 5, 3, z=-height), 61)
    centre, half = np.array([5.03, 4.96, 0.0]), 2.0
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    for rotation in (np.eye(3), turn):
        faces = [
            s.with_control_points((s.control_points - centre) @ rotation.T + centre) for s in shapes.box(4.0, centre)
        ]
        contacts = _detect(grid, _tool(faces, 9)).contacts
        points = grid.matrices.points(grid.surface.control_points).reshape(-1, 3)
        truth = -_box_distance((points - centre) @ rotation + centre, centre, half)
        assert len(contacts) == (truth >= 0).sum() > 0
        assert contacts.depth == pytest.approx(
            -_box_distance((contacts.point - centre) @ rotation + centre, centre, half), abs=1e-9
        )


def test_both_sides_parameters_lead_to_the_contact(shapes):
    """(u, v) on the model gives the point, (u, v) on the tool's patch the tool's point, the same to rounding."""
    grid = PatchGrid.of(shapes.plate(14.0, 7, 3, height=lambda x, y: 0.3 * np.sin(x)), 41)
    centre = grid.surface.evaluate(0.5, 0.5) + [0.02, -0.013, 2.0]
    balls = [shapes.ball(3.0, centre), shapes.ball(1.5, centre + [3.5, 0.0, -1.0])]
    contacts = _detect(grid, _tool(balls, 21), DetectOptions(margin=0.1)).contacts
    assert set(contacts.tool_face) == {0, 1}
    assert grid.surface.evaluate(contacts.u, contacts.v) == pytest.approx(contacts.point, abs=1e-12)
    for k, ball in enumerate(balls):
        mine = contacts.chosen(contacts.tool_face == k)
        assert ball.evaluate(mine.tool_u, mine.tool_v) == pytest.approx(mine.tool_point, abs=1e-12)


def test_a_model_wholly_inside_is_in_contact_everywhere(shapes):
    grid = PatchGrid.of(shapes.plate(1.0), 9)
    for tool in (_tool([shapes.ball(5.0, [0.3, 0.2, 1.0])], (17, 9)), _tool(shapes.box(9.0, [1, 1, 1]), 5)):
        found = _detect(grid, tool)
        assert len(found.contacts) == grid.shape[0] * grid.shape[1]
        assert found.contacts.depth.min() > 2.0
        assert len(found.crossings) == 0
    outside = _tool([shapes.ball(5.0, [0.3, 0.2, 9.0])], (17, 9))
    assert len(_detect(grid, outside).contacts) == 0


def test_inside_the_hull_is_not_inside_the_tool(shapes):
    """A plate in the bowl of a dish: within the dish's hull, in front of its inner side."""
    dish = shapes.plate(10.0, 7, 3, height=lambda x, y: 0.4 * ((x - 5) ** 2 + (y - 5) ** 2))
    grid = PatchGrid.of(shapes.plate(1.0).with_control_points(shapes.plate(1.0).control_points + [4.5, 4.5, 3.0]), 9)
    assert len(_detect(grid, _tool([dish], 33)).contacts) == 0
    turned = replace(dish, outward=False)
    assert len(_detect(grid, _tool([turned], 33)).contacts) == grid.shape[0] * grid.shape[1]


def test_an_open_tool_says_nothing_beyond_its_border(shapes):
    """A small plate facing down, pressed into a large one: only what lies under it is in contact."""
    small = shapes.plate(4.0)
    small = replace(small.with_control_points(small.control_points + [3, 3, -0.25]), outward=False)
    grid = PatchGrid.of(shapes.plate(10.0, 6, 3, height=lambda x, y: 0.02 * (x - 5)), 81)
    contacts = _detect(grid, _tool([small], 17, reach=0.5)).contacts
    assert len(contacts)
    # (the model is tilted a little, so that a plumb line's foot may leave the border by its slope)
    assert contacts.point[:, :2].min() > 3.0 - 1e-9
    assert contacts.point[:, :2].max() < 7.0 + 1e-9
    inside = np.abs(contacts.point[:, :2] - 5).max(axis=1) < 2
    assert contacts.depth[inside] == pytest.approx(contacts.point[inside, 2] + 0.25, abs=1e-9)
    assert contacts.area.sum() == pytest.approx(16.0, rel=0.1)


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e4])
@pytest.mark.parametrize("seed", range(3))
def test_crossing_triangles_are_those_of_all_pairs(shapes, seed, scale):
    """tolerance 0: the same pairs as testing every triangle of the two finest meshes against every other."""
    rng = np.random.default_rng(seed)
    a, b = (shapes.random_surface(rng, rational=k == seed % 2) for k in range(2))
    a = a.scaled(scale)
    b = b.with_control_points((b.control_points + [1.0, 0.5, 0.2]) * scale)
    grids = [PatchGrid.of(s, 14) for s in (a, b)]
    tool = SurfaceTool((grids[1],), (b.control_points,))
    found = _detect(grids[0], tool).crossings
    (p, s), (q, t) = (whole_mesh(grid, grid.surface.control_points) for grid in grids)
    low_p, high_p, low_q, high_q = p[s].min(axis=1), p[s].max(axis=1), q[t].min(axis=1), q[t].max(axis=1)
    near = (low_p[:, None] <= high_q).all(axis=2) & (high_p[:, None] >= low_q).all(axis=2)
    expected = {}
    for i, j in np.argwhere(near):
        relation, _ = triangle_relation(p[s[i]], q[t[j]])
        if relation is not Relation.DISJOINT:
            expected[(*sorted(s[i]), *sorted(t[j]))] = relation
    mine = {
        (*sorted(x), *sorted(y)): Relation(r)
        for x, y, r in zip(found.model_triangle, found.tool_triangle, found.relation, strict=True)
    }
    assert len(expected) > 10
    assert mine == expected
    assert len(found) == len(expected)
    # the segments lie in both triangles' boxes
    crossing = found.relation == Relation.CROSSING
    for triangle, points in ((found.model_triangle, p), (found.tool_triangle, q)):
        corners = points[triangle[crossing]]
        slack = 1e-9 * scale
        assert (found.segment[crossing] >= corners.min(axis=1)[:, None] - slack).all()
        assert (found.segment[crossing] <= corners.max(axis=1)[:, None] + slack).all()


def test_coplanar_sheets_overlap(shapes):
    grid = PatchGrid.of(shapes.plate(4.0, 4, 3), 5)
    other = shapes.plate(4.0, 4, 3)
    tool = _tool([other.with_control_points(other.control_points + [2.0, 0.0, 0.0])], 5)
    found = _detect(grid, tool)
    assert set(found.crossings.relation) == {int(Relation.TOUCHING), int(Relation.COPLANAR_OVERLAP)}
    assert found.contacts.depth == pytest.approx(0.0, abs=1e-12)
    assert len(found.contacts) == 5 * 3


def test_flat_cells_are_not_refined(shapes):
    """4.5.1: two nearly flat sheets over a large area. The tolerance keeps the triangles few, the contacts stay as
    they are."""
    grid = PatchGrid.of(shapes.plate(10.0, 6, 3, height=lambda x, y: 0.001 * np.sin(x)), 97)
    under = replace(shapes.plate(10.0, 6, 3, height=lambda x, y: 0.001 * np.cos(y)), outward=False)
    tool = _tool([under], 49)
    fine, coarse = (_detect(grid, tool, DetectOptions(tolerance=t)) for t in (0.0, 0.01))
    assert coarse.counters.triangles < 0.02 * fine.counters.triangles
    assert len(coarse.contacts) == len(fine.contacts) > 1000
    assert coarse.contacts.depth == pytest.approx(fine.contacts.depth, abs=1e-9)
    paper = _detect(grid, tool, DetectOptions(mode="paper"))
    assert paper.counters.triangles < 0.02 * fine.counters.triangles
    assert paper.counters.levels < fine.counters.levels


def test_a_tool_smaller_than_a_cell_is_found(shapes):
    grid = PatchGrid.of(shapes.plate(10.0), 11)
    contacts = _detect(
        grid, _tool([shapes.ball(0.1, [4.6, 5.45, 0.05])], (17, 9)), DetectOptions(tolerance=1e-3)
    ).contacts
    assert contacts.area.sum() == pytest.approx(np.pi * (0.1**2 - 0.05**2), rel=0.25)
    assert contacts.depth.max() == pytest.approx(0.05, rel=0.05)


def test_nothing_is_missed_between_random_surfaces(shapes):
    """Closed tools against random sheets: dense samples of the sheet inside the exact ball."""
    rng = np.random.default_rng(9)
    hits = 0
    for k in range(25):
        surface = shapes.random_surface(rng, rational=bool(k % 2))
        grid = PatchGrid.of(surface, int(rng.integers(6, 30)))
        (u0, u1), (v0, v1) = surface.domain
        dense = surface.evaluate(np.linspace(u0, u1, 150)[:, None], np.linspace(v0, v1, 150)).reshape(-1, 3)
        radius = 10.0 ** rng.uniform(-0.7, 0.5)
        centre = dense[rng.integers(len(dense))] + rng.normal(size=3) * radius * 0.8
        contacts = _detect(grid, _tool([shapes.ball(radius, centre)], (17, 9)), DetectOptions(tolerance=0.01)).contacts
        truth = shapes.Sphere(centre, radius)
        if -truth.distance(dense).min() > 0.01:
            hits += 1
            assert len(contacts)
        assert contacts.depth == pytest.approx(-truth.distance(contacts.point), abs=1e-8)
        points = grid.matrices.points(surface.control_points, surface.weights).reshape(-1, 3)
        assert _on_grid(contacts, grid).sum() == (truth.distance(points) <= 0).sum()
    assert hits > 8


def test_a_trimmed_tool_touches_only_where_its_face_is(shapes):
    line = np.array([0.0, 0, 1, 1])

    def side(a, b):
        return TrimCurve(np.array([a, b], dtype=float), line, 1)

    corners = [(0.3, 0.3), (0.7, 0.3), (0.7, 0.7), (0.3, 0.7)]
    loop = TrimLoop(tuple(side(a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)))
    sheet = shapes.plate(10.0)
    sheet = replace(sheet.with_control_points(sheet.control_points - [0, 0, 0.2]), outward=False, trims=(loop,))
    grid = PatchGrid.of(shapes.plate(10.0), 101)
    contacts = _detect(grid, _tool([sheet], 41, reach=0.5)).contacts
    assert contacts.point[:, :2].min() == pytest.approx(3.0, abs=0.2)
    assert contacts.point[:, :2].min() >= 3.0 - 1e-6
    assert contacts.point[:, :2].max() <= 7.0 + 1e-6
    assert contacts.area.sum() == pytest.approx(16.0, rel=0.06)


def test_two_runs_and_a_cache_give_the_same_bytes(shapes):
    grid = PatchGrid.of(shapes.plate(10.0, 8, 3, height=lambda x, y: 0.5 * np.sin(x + y)), 41)
    tool = _tool(shapes.box(3.0, [5, 5, 1.0]), 9)
    cache = DetectCache()
    for step in range(3):
        net = grid.surface.control_points + [0, 0, 0.1 * step]
        runs = [
            detect([grid], [net], [tool], DetectOptions(margin=0.1), cache=c)
            for c in (cache, cache, DetectCache(), None)
        ]
        assert len(runs[0].contacts) > 0
        assert len({_bytes(run.contacts) for run in runs}) == 1
        assert len({run.crossings.segment.tobytes() + run.crossings.model_triangle.tobytes() for run in runs}) == 1
        assert runs[2].counters == runs[3].counters


def test_several_tools_and_faces_come_in_order(shapes):
    grids = [PatchGrid.of(shapes.plate(10.0), 31), PatchGrid.of(shapes.plate(10.0), 21)]
    nets = [grids[0].surface.control_points, grids[1].surface.control_points + [12.0, 0, 0]]
    tools = [_tool([shapes.ball(2.0, [11.0, 5.0, 0.0])], (17, 9)), _tool([shapes.ball(2.0, [5.0, 5.0, 1.5])], (17, 9))]
    contacts = detect(grids, nets, tools, DetectOptions(), body=3).contacts
    assert set(contacts.a) == {3}
    assert {(b, f) for b, f in zip(contacts.b, contacts.face, strict=True)} == {(0, 0), (0, 1), (1, 0)}
    keys = np.column_stack([contacts.a, contacts.b, contacts.face, contacts.u, contacts.v])
    assert np.array_equal(keys, keys[np.lexsort(keys.T[::-1])])


@pytest.mark.parametrize("clamped", [True, False])
def test_an_open_tube_touches_with_its_side_only(shapes, clamped):
    """A cylinder without lids, across its seam: depth is radius minus distance from the axis; beyond its ends,
    nothing."""
    # the periodic cubic runs inside its control points, a circle to a tenth of a percent
    radius = 2.0 if clamped else 6.0 / (2.0 + np.cos(np.pi / 6))
    tube = shapes.cylinder(radius, 6.0, closed_clamped=clamped)
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # its axis along x, its seam downwards
    net = tube.control_points @ turn.T + [2.0, 5.0, 1.5]
    grid = PatchGrid.of(shapes.plate(10.0), 81)
    tool = SurfaceTool((PatchGrid.of(tube, (65, 17)),), (np.ascontiguousarray(net),))
    contacts = _detect(grid, tool, DetectOptions(margin=0.1)).contacts
    points = grid.matrices.points(grid.surface.control_points).reshape(-1, 3)
    radius = np.hypot(points[:, 1] - 5.0, points[:, 2] - 1.5)
    along = (points[:, 0] >= 2.0 - 1e-9) & (points[:, 0] <= 8.0 + 1e-9)
    tolerance = 1e-9 if clamped else 3e-3
    assert len(contacts) == pytest.approx(((radius <= 2.1) & along).sum(), abs=0 if clamped else 40)
    assert contacts.depth == pytest.approx(2.0 - np.hypot(contacts.point[:, 1] - 5.0, 1.5), abs=tolerance)
    assert contacts.point[:, 0].min() >= 2.0 - 1e-9
    assert contacts.point[:, 0].max() <= 8.0 + 1e-9


def test_paper_mode_finds_no_contact_that_is_not_there(shapes):
    rng = np.random.default_rng(12)
    for _ in range(8):
        surface = shapes.random_surface(rng)
        grid = PatchGrid.of(surface, 25)
        tool = _tool([shapes.ball(2.0, rng.uniform([2, 2, -1], [8, 8, 2]))], (17, 9))
        ours, paper = (_detect(grid, tool, DetectOptions(mode=mode)).contacts for mode in ("certified", "paper"))
        assert set(zip(paper.u, paper.v, strict=True)) <= set(zip(ours.u, ours.v, strict=True))


def test_flat_pressed_on_flat_keeps_its_contact(shapes):
    """An open sheet parallel to the model, which it never crosses: felt to a cell's depth, or as deep as it says."""
    sheet = shapes.plate(4.0)
    grid = PatchGrid.of(shapes.plate(10.0), 41)
    for depth, reach, touches in ((1e-3, 0.0, True), (0.1, 0.0, True), (1.5, 0.0, False), (1.5, 2.0, True)):
        down = replace(sheet.with_control_points(sheet.control_points + [3, 3, -depth]), outward=False)
        contacts = _detect(grid, _tool([down], 17, reach)).contacts
        assert (len(contacts) > 0) == touches
        assert contacts.depth == pytest.approx(depth, abs=1e-9)
