"""Implicit tools (paper 4.9.1): nothing missed, areas right, forces independent of the resolution."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.collide.contacts import Contacts
from cadsculpt.collide.detect import Counters, DetectCache, DetectOptions, FieldTool, detect
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.errors import GeometryError, InputError
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop


def _detect(grid, tool, options=None, **more):
    return detect([grid], [grid.surface.control_points], [FieldTool(tool)], options or DetectOptions(), **more)


def _bytes(contacts):
    return b"".join(np.ascontiguousarray(getattr(contacts, name)).tobytes() for name in Contacts.__dataclass_fields__)


def _dense(surface, count):
    (u0, u1), (v0, v1) = surface.domain
    return surface.evaluate(np.linspace(u0, u1, count)[:, None], np.linspace(v0, v1, count)).reshape(-1, 3)


def test_every_vertex_inside_the_tool_is_a_contact_and_no_other(shapes):
    rng = np.random.default_rng(0)
    touched = 0
    for k in range(40):
        surface = shapes.random_surface(rng, rational=bool(k % 2))
        grid = PatchGrid.of(surface, (int(rng.integers(8, 50)), int(rng.integers(8, 50))))
        tool = shapes.Sphere(rng.uniform([0, 0, -3], [10, 10, 3]), rng.uniform(0.5, 4))
        margin = 0.0 if k % 3 else 0.3
        contacts = _detect(grid, tool, DetectOptions(margin=margin)).contacts
        points = grid.matrices.points(surface.control_points, surface.weights)
        depth = -tool.distance(points.reshape(-1, 3)).reshape(grid.shape)
        expected = {(grid.matrices.u[i], grid.matrices.v[j]) for i, j in np.argwhere(depth >= -margin + 1e-9)}
        found = set(zip(contacts.u, contacts.v, strict=True))
        on_grid = {(u, v) for u, v in found if u in grid.matrices.u and v in grid.matrices.v}
        assert expected <= found
        assert len(on_grid - expected) <= (np.abs(depth + margin) < 1e-9).sum()
        assert contacts.depth == pytest.approx(-tool.distance(contacts.point), abs=1e-12)
        assert contacts.point == pytest.approx(surface.evaluate(contacts.u, contacts.v), abs=1e-9)
        assert np.array_equal(contacts.normal, -tool.gradient(contacts.point))
        assert np.linalg.norm(contacts.tool_point - tool.centre, axis=1) == pytest.approx(tool.radius)
        touched += len(expected) > 0
    assert touched > 15


@pytest.mark.parametrize("resolution", [3, 7, 20])
def test_nothing_is_missed_however_small_the_tool(shapes, resolution):
    """Tools much smaller than a cell reach the surface between the vertices; dense samples tell the truth."""
    rng = np.random.default_rng(resolution)
    hits = 0
    for k in range(60):
        surface = shapes.random_surface(rng, rational=bool(k % 2))
        grid = PatchGrid.of(surface, resolution)
        dense = _dense(surface, 240)
        radius = 10.0 ** rng.uniform(-1.3, 0.5)
        centre = dense[rng.integers(len(dense))] + rng.normal(size=3) * radius * 0.8
        tool = shapes.Sphere(centre, radius)
        tolerance = 0.01
        contacts = _detect(grid, tool, DetectOptions(tolerance=tolerance)).contacts
        deepest = -tool.distance(dense).min()
        if deepest > tolerance:
            hits += 1
            assert len(contacts)
            assert contacts.depth.max() > 0
        if len(contacts):
            # and what is reported is really there
            assert contacts.depth == pytest.approx(-tool.distance(surface.evaluate(contacts.u, contacts.v)), abs=1e-9)
            assert (contacts.area > 0).all()
    assert hits > 15


def test_a_small_tool_is_found_where_the_spans_bounds_say_nothing(shapes):
    """Rational, of high degree, over narrow spans: bounds over a span are a thousand times the surface's size."""
    rng = np.random.default_rng(3)
    for _ in range(6):
        steps = rng.uniform(0.3, 1.0, 6) * [1, 1, 0.05, 1, 0.05, 1]
        breaks = np.cumsum(steps)
        knots = np.concatenate([np.zeros(6), breaks[:-1], np.full(6, breaks[-1])])
        x, y = np.meshgrid(np.linspace(0, 10, 11), np.linspace(0, 10, 6), indexing="ij")
        net = np.stack([x, y, 0 * x], axis=-1) + rng.normal(scale=6.0, size=(11, 6, 3))
        surface = BSplineSurface(net, knots, np.repeat([0.0, 1.0], 6), 5, 5, rng.uniform(0.1, 3, (11, 6)))
        grid = PatchGrid.of(surface, (13, 4))
        i, j = rng.integers(0, grid.shape[0] - 1), rng.integers(0, 3)
        at = surface.evaluate(
            *(t[k] + 0.45 * (t[k + 1] - t[k]) for t, k in ((grid.matrices.u, i), (grid.matrices.v, j)))
        )
        contacts = _detect(grid, shapes.Sphere(at, 0.02), DetectOptions(tolerance=1e-2)).contacts
        assert len(contacts)
        assert np.linalg.norm(contacts.point - at, axis=1).max() <= 0.02


def test_the_paper_misses_some_of_them(shapes):
    rng = np.random.default_rng(20)
    missed = 0
    for _ in range(60):
        # few spans, deep folds: the surface bulges out of the spheres through its samples
        surface = shapes.random_surface(rng, bumps=6.0, most=2)
        grid = PatchGrid.of(surface, 60)
        centre = surface.evaluate(rng.uniform(-1, 4), rng.uniform(0, 0.5)) + [0, 0, 0.3]
        tool = shapes.Sphere(centre, 0.5)
        ours = _detect(grid, tool).contacts
        paper = _detect(grid, tool, DetectOptions(mode="paper")).contacts
        mine = set(zip(ours.u, ours.v, strict=True))
        its = set(zip(paper.u, paper.v, strict=True))
        assert its <= mine
        missed += len(its) < len(mine)
    assert missed > 0


def test_a_sphere_pressed_into_a_plane_weighs_the_same_at_every_resolution(shapes):
    """sum area depth over the cap, against its integral: 2 pi int_0^a (sqrt(R^2 - r^2) - (R - d)) r dr."""
    R, d = 3.0, 0.4
    a = np.sqrt(R * R - (R - d) ** 2)
    exact = 2 * np.pi * ((R**3 - (R * R - a * a) ** 1.5) / 3 - (R - d) * a * a / 2)
    error = []
    for resolution in (26, 51, 101, 201):
        surface = shapes.plate(10.0)
        contacts = _detect(PatchGrid.of(surface, resolution), shapes.Sphere([5.1, 4.87, R - d], R)).contacts
        # depth along the plane's normal, as in the closed formula
        depth = np.sqrt(R * R - ((contacts.point - [5.1, 4.87, 0])[:, :2] ** 2).sum(axis=1)) - (R - d)
        error.append(abs((contacts.area * depth).sum() / exact - 1))
        assert contacts.area.sum() == pytest.approx(np.pi * a * a, rel=0.25 * 26 / resolution)
    assert error[0] < 0.05
    assert error[-1] < 1e-3


def test_areas_do_not_depend_on_the_parametrisation(shapes):
    """A plate whose parameter lines crowd on one side, and one with knots far from 0 and 1."""
    sheet = shapes.plate(10.0, 9, 3, height=lambda x, y: 0 * x)
    crowded = sheet.control_points.copy()
    crowded[..., 0] = 10 * (crowded[..., 0] / 10) ** 2
    for net in (sheet.control_points, crowded):
        grid = PatchGrid.of(sheet.with_control_points(net), 101)
        contacts = _detect(grid, shapes.Sphere([5.01, 5.02, 0.1], 20.0)).contacts
        assert contacts.area.sum() == pytest.approx(100.0, rel=1e-9)
        assert len(contacts) == grid.shape[0] * grid.shape[1]


@pytest.mark.parametrize("name", ["cylinder", "ball", "periodic"])
def test_seams_and_poles_count_once(shapes, name):
    surface = shapes.cylinder(5.0, 10.0, closed_clamped=False) if name == "periodic" else getattr(shapes, name)(5.0)
    grid = PatchGrid.of(surface, (65, 41))
    contacts = _detect(grid, shapes.Sphere([0, 0, 3], 30.0)).contacts
    m, n = grid.shape
    assert len(contacts) == ((m - 1) * (n - 2) + 2 if name == "ball" else (m - 1) * n)
    exact = 4 * np.pi * 25 if name == "ball" else 2 * np.pi * 5 * 10
    if name == "periodic":
        from cadsculpt.collide.triangulate import whole_mesh

        points, t = whole_mesh(grid, surface.control_points)
        exact = (
            0.5
            * np.linalg.norm(
                np.cross(points[t[:, 1]] - points[t[:, 0]], points[t[:, 2]] - points[t[:, 0]]), axis=1
            ).sum()
        )
    assert contacts.area.sum() == pytest.approx(exact, rel=5e-3)
    distinct = {tuple(np.round(p, 9)) for p in contacts.point}
    assert len(distinct) == len(contacts)


def test_a_contact_across_the_seam_is_whole(shapes):
    surface = shapes.cylinder(5.0, 10.0)
    grid = PatchGrid.of(surface, (101, 41))
    seam = _detect(grid, shapes.Sphere([6.0, 0, 5.0], 2.0)).contacts
    angle = np.pi / 2
    away = _detect(grid, shapes.Sphere([6.0 * np.cos(angle), 6.0 * np.sin(angle), 5.0], 2.0)).contacts
    assert len(seam) == len(away)
    assert (seam.area * seam.depth).sum() == pytest.approx((away.area * away.depth).sum(), rel=1e-9)


def test_a_patch_deep_inside_is_found(shapes):
    surface = shapes.plate(2.0)
    grid = PatchGrid.of(surface, 21)
    contacts = _detect(grid, shapes.Sphere([1, 1, 1], 50.0)).contacts
    assert len(contacts) == grid.shape[0] * grid.shape[1]
    assert contacts.depth.min() > 45.0


def test_a_print_below_the_grid_has_its_area(shapes):
    surface = shapes.plate(10.0)
    grid = PatchGrid.of(surface, 11)
    # a needle's tip in the middle of a cell of 1 x 1
    R, d = 0.1, 0.05
    contacts = _detect(grid, shapes.Sphere([4.6, 5.45, R - d], R), DetectOptions(tolerance=1e-3)).contacts
    a2 = R * R - (R - d) ** 2
    assert contacts.area.sum() == pytest.approx(np.pi * a2, rel=0.25)
    assert contacts.depth.max() == pytest.approx(d, rel=0.05)
    # nothing, where the needle stays above
    assert len(_detect(grid, shapes.Sphere([4.6, 5.45, R + 1e-4], R), DetectOptions(tolerance=1e-3)).contacts) == 0


def test_a_spike_beside_a_large_contact_is_not_lost(shapes):
    class Both:
        def __init__(self, *parts):
            self.parts = parts

        def distance(self, x):
            return np.min([p.distance(x) for p in self.parts], axis=0)

        def _each(self, name, x):
            which = np.argmin([p.distance(x) for p in self.parts], axis=0)
            return np.choose(which[:, None], [getattr(p, name)(x) for p in self.parts])

        def gradient(self, x):
            return self._each("gradient", x)

        def nearest(self, x):
            return self._each("nearest", x)

        def box(self):
            boxes = np.array([p.box() for p in self.parts])
            return np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])

    grid = PatchGrid.of(shapes.plate(10.0), 21)
    tool = Both(shapes.Sphere([2.5, 2.5, 1.5], 2.0), shapes.Sphere([7.7, 7.3, 0.05], 0.1))
    contacts = _detect(grid, tool, DetectOptions(tolerance=1e-3)).contacts
    near = np.linalg.norm(contacts.point - [7.7, 7.3, 0], axis=1) < 0.2
    assert near.any()
    assert (~near).sum() > 10


def test_half_spaces_reach_to_infinity(shapes):
    class Above:
        def distance(self, x):
            return 0.5 - x[:, 2]

        def gradient(self, x):
            return np.tile([0, 0, -1.0], (len(x), 1))

        def nearest(self, x):
            return x * [1, 1, 0] + [0, 0, 0.5]

        def box(self):
            return np.array([[-np.inf, -np.inf, 0.5], [np.inf] * 3])

    surface = shapes.plate(10.0, height=lambda x, y: x / 10)
    contacts = _detect(PatchGrid.of(surface, 41), Above()).contacts
    assert contacts.depth == pytest.approx(contacts.point[:, 2] - 0.5)
    assert contacts.area.sum() == pytest.approx(50 * np.sqrt(1.01), rel=0.06)


def test_trimmed_away_material_does_not_touch(shapes):
    surface = shapes.plate(10.0)
    circle = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]])
    c = np.sqrt(0.5)
    knots = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4.0])

    def loop(radius, outer):
        return TrimLoop((TrimCurve(0.5 + radius * circle, knots, 2, np.array([1, c, 1, c, 1, c, 1, c, 1])),), outer)

    from dataclasses import replace

    ring = replace(surface, trims=(loop(0.4, True), loop(0.2, False)))
    grid = PatchGrid.of(ring, 201)
    contacts = _detect(grid, shapes.Sphere([5, 5, 0], 30.0)).contacts
    radius = np.linalg.norm(contacts.point[:, :2] - 5, axis=1)
    assert radius.min() > 2.0 - 1e-3
    assert radius.max() < 4.0 + 1e-3
    assert contacts.area.sum() == pytest.approx(np.pi * (16 - 4), rel=0.01)
    # a needle in the hole, and one on the ring, both below the grid
    coarse = PatchGrid.of(ring, 15)
    hole, land = (
        _detect(coarse, shapes.Sphere([x, 5.03, 0.05], 0.1), DetectOptions(tolerance=1e-3)).contacts
        for x in (5.6, 8.05)
    )
    assert len(hole) == 0
    assert len(land) > 0


def test_two_runs_and_a_cache_give_the_same_bytes(shapes):
    surface = shapes.random_surface(np.random.default_rng(5), rational=True)
    grid = PatchGrid.of(surface, 60)
    cache = DetectCache()
    options = DetectOptions(tolerance=0.01, margin=0.2)
    for step in range(4):
        tool = shapes.Sphere([5.0 + 0.3 * step, 5.0, 1.5 - 0.2 * step], 2.0)
        net = surface.control_points + [0, 0, 0.05 * step]
        runs = [detect([grid], [net], [FieldTool(tool)], options, cache=c) for c in (cache, cache, DetectCache(), None)]
        assert len(runs[0].contacts) > 0
        assert len({_bytes(run.contacts) for run in runs}) == 1
        fresh = [run.counters for run in runs[2:]]
        assert fresh[0] == fresh[1]
        assert runs[1].counters.points <= runs[0].counters.points


def test_only_the_window_is_touched(shapes):
    surface = shapes.plate(100.0, 20, 3)
    grid = PatchGrid.of(surface, 401)
    found = _detect(grid, shapes.Sphere([50, 50, 9.0], 10.0))
    assert 0 < found.contacts.area.sum() < 0.02 * 1e4
    assert found.counters.points < 0.06 * grid.shape[0] * grid.shape[1]
    far = _detect(grid, shapes.Sphere([50, 50, 50.0], 10.0))
    assert len(far.contacts) == 0
    assert far.counters.points == 0
    total = Counters()
    total.add(found.counters)
    total.add(found.counters)
    assert total.points == 2 * found.counters.points


def test_many_idle_patches_are_left_alone(shapes):
    grid = PatchGrid.of(shapes.plate(1.0, 4, 3), 9)
    nets = [grid.surface.control_points + [2.0 * (k % 20), 2.0 * (k // 20), 0] for k in range(400)]
    cache = DetectCache()
    found = detect([grid] * 400, nets, [FieldTool(shapes.Sphere([4.5, 6.5, 0.4], 0.6))], DetectOptions(), cache=cache)
    assert set(found.contacts.face) == {62}
    assert len(cache.workspaces) == 1


def test_what_is_not_a_number_is_an_error_and_never_clear(shapes):
    surface = shapes.plate()
    grid = PatchGrid.of(surface, 9)
    net = surface.control_points.copy()
    net[0, 0, 0] = np.nan
    tool = shapes.Sphere([5, 5, 0], 1.0)
    with pytest.raises(GeometryError, match="finite"):
        detect([grid], [net], [FieldTool(tool)], DetectOptions())
    bad = shapes.Sphere([5, 5, 0], np.nan)
    with pytest.raises(InputError):
        _detect(grid, bad)
    bad.box = lambda: np.array([[0.0] * 3, [10.0] * 3])
    with pytest.raises(InputError, match="not a number"):
        _detect(grid, bad)
    for wrong in ({"margin": np.nan}, {"tolerance": -1.0}, {"mode": "fast"}, {"delta": np.inf}):
        with pytest.raises(InputError):
            DetectOptions(**wrong)


def test_a_small_face_on_a_huge_surface_gets_its_rows(shapes):
    """A face of 2 x 2 cut out of one span of 4000 x 10: the rows lie where the face is."""
    line = np.array([0.0, 0, 1, 1])
    net = np.array([[[x, y, 0.0] for y in (0.0, 10.0)] for x in (-2000.0, 2000.0)])
    corners = [(0.5 + x / 4000, y / 10) for x, y in ((1, 4), (3, 4), (3, 6), (1, 6))]
    loop = TrimLoop(
        tuple(TrimCurve(np.array([a, b]), line, 1) for a, b in zip(corners, corners[1:] + corners[:1], strict=True))
    )
    sheet = BSplineSurface(net, line, line, 1, 1, trims=(loop,))
    grid = PatchGrid.of(sheet, 41)
    contacts = _detect(grid, shapes.Sphere([2, 5, 0.01], 50.0)).contacts
    assert contacts.area.sum() == pytest.approx(4.0, rel=0.1)
    assert 41**2 * 0.8 < len(contacts) < 41**2 * 1.3
    assert len(_detect(grid, shapes.Sphere([4.0, 5, 0.01], 0.5)).contacts) == 0


def test_rows_are_spread_over_the_spans_by_their_length(shapes):
    sheet = shapes.plate(10.0, 9, 3)
    grid = PatchGrid.of(sheet, (61, 31))
    from cadsculpt.spline.matrices import TransformationMatrices, cells_per_span

    plain = TransformationMatrices.of(sheet, cells_per_span(sheet, 0, 60), cells_per_span(sheet, 1, 30))
    for name in ("u", "v", "A_u", "A_v", "dA_u", "rows_v", "first_u", "span_start_u", "span_start_v"):
        assert np.array_equal(getattr(grid.matrices, name), getattr(plain, name))
