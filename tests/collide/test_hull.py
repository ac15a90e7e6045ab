"""Hulls and windows: against scipy, linear programming and each other."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from cadsculpt.collide.grid import PatchGrid
from cadsculpt.collide.hull import apart, convex_hull, greville, paper_window, span_pairs
from cadsculpt.collide.workspace import Workspace


def _in_hull(point, points):
    """point is a convex combination of points (linear programming)."""
    a = np.vstack([points.T, np.ones(len(points))])
    return linprog(np.zeros(len(points)), A_eq=a, b_eq=np.append(point, 1.0)).status == 0


def _meet(p, q):
    """The hulls of p and q have a common point (linear programming)."""
    a = np.block([[p.T, -q.T], [np.ones(len(p)), np.zeros(len(q))], [np.zeros(len(p)), np.ones(len(q))]])
    b = np.array([0, 0, 0, 1.0, 1.0])
    return linprog(np.zeros(len(p) + len(q)), A_eq=a, b_eq=b).status == 0


def test_every_point_lies_in_the_hull_of_its_vertices():
    points = np.random.default_rng(0).normal(size=(40, 3))
    hull = convex_hull(points)
    assert hull.dimension == 3
    assert len(hull.vertices) < 40
    for x in points:
        assert _in_hull(x, points[hull.vertices])
    # all points behind all facets
    for a, b, c in points[hull.facets]:
        side = (points - a) @ np.cross(b - a, c - a)
        assert side.max() < 1e-9 or side.min() > -1e-9


def test_flat_collinear_and_single_nets_are_normal_cases():
    rng = np.random.default_rng(1)
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    flat = rng.normal(size=(30, 2)) @ frame[:2] + 7.0
    hull = convex_hull(flat)
    assert hull.dimension == 2
    for x in flat:
        assert _in_hull((x - 7.0) @ frame[:2].T, (flat[hull.vertices] - 7.0) @ frame[:2].T)
    area = sum(np.linalg.norm(np.cross(b - a, c - a)) / 2 for a, b, c in flat[hull.facets])
    from scipy.spatial import ConvexHull

    assert area == pytest.approx(ConvexHull((flat - 7.0) @ frame[:2].T).volume)
    line = np.linspace(0, 1, 9)[:, None] * frame[0] + 3.0
    assert sorted(convex_hull(line).vertices) == [0, 8]
    assert convex_hull(line).dimension == 1
    assert convex_hull(np.ones((4, 3))).dimension == 0


def test_apart_agrees_with_linear_programming():
    rng = np.random.default_rng(2)
    counts = [0, 0]
    for k in range(120):
        p = rng.normal(size=(rng.integers(1, 20), 3))
        q = rng.normal(size=(rng.integers(1, 20), 3))
        if k % 3 == 0:
            p[:, 2] = 0.0
        q += rng.normal(size=3) * rng.uniform(0, 3)
        truth = _meet(p, q)
        counts[truth] += 1
        axis = np.zeros(3)
        found = apart(p, q, axis, 0.0)
        assert found == (not truth)
        if found:
            # the direction that it gives is the proof, and it is tried first the next time
            assert (p @ axis).min() > (q @ axis).max()
            assert apart(p, q, axis, 0.0)
    assert min(counts) > 20


def test_apart_by_more_than_a_gap():
    p = np.random.default_rng(3).normal(size=(12, 3))
    p[0], p[1:, 0] = [5.0, 0, 0], np.minimum(p[1:, 0], 0)
    q = np.array([[7.0, -1, -1], [7.0, 1, -1], [7.0, 0, 2.0]])
    assert apart(p, q, np.zeros(3), 1.999)
    assert not apart(p, q, np.zeros(3), 2.001)


def test_a_doubt_is_never_apart():
    """Hulls that touch in a point, an edge or a face, by construction."""
    rng = np.random.default_rng(4)
    for _ in range(60):
        p, q = rng.normal(size=(2, 8, 3))
        p[:, 0], q[:, 0] = -np.abs(p[:, 0]), np.abs(q[:, 0])
        q[0] = p[0] = rng.normal(size=3) * [0, 1, 1]
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        assert not apart(np.ascontiguousarray(p @ turn), np.ascontiguousarray(q @ turn), np.zeros(3), 0.0)


@pytest.mark.parametrize("seed", range(4))
def test_no_contact_lies_outside_the_window(shapes, seed):
    """Every pair of surface points closer than the margin lies in a pair of spans of the window."""
    rng = np.random.default_rng(seed)
    a = shapes.random_surface(rng, rational=bool(seed % 2))
    b = shapes.random_surface(rng)
    other = b.control_points + [2.0, 1.0, rng.uniform(-0.5, 0.5)]
    grids = [PatchGrid.of(s, 9) for s in (a, b)]
    patches = [
        Workspace(grid, np.zeros(9, np.int64)).load(net, paper=False, delta=0.0)
        for grid, net in zip(grids, (a.control_points, other), strict=True)
    ]
    pairs = np.empty((10000, 2), np.int64)
    margin = 0.05
    count = span_pairs(patches[0].box, patches[0].covers, patches[1].box, patches[1].covers, margin, pairs)
    window = {tuple(x) for x in pairs[:count]}
    samples = []
    for surface, net, grid in zip((a, b), (a.control_points, other), grids, strict=True):
        (u0, u1), (v0, v1) = surface.domain
        u, v = np.meshgrid(np.linspace(u0, u1, 120), np.linspace(v0, v1, 120), indexing="ij")
        starts = grid.matrices.u[grid.matrices.span_start_u], grid.matrices.v[grid.matrices.span_start_v]
        span = [
            np.clip(np.searchsorted(s, t.ravel(), side="right") - 1, 0, len(s) - 2)
            for s, t in zip(starts, (u, v), strict=True)
        ]
        samples.append(
            (surface.with_control_points(net).evaluate(u, v).reshape(-1, 3), span[0] * (len(starts[1]) - 1) + span[1])
        )
    from scipy.spatial import cKDTree

    (x, span_x), (y, span_y) = samples
    near = cKDTree(x).query_ball_tree(cKDTree(y), margin)
    found = {(span_x[i], span_y[j]) for i, js in enumerate(near) for j in js}
    assert found
    assert found <= window


def test_greville_abscissae_reproduce_the_parameter():
    knots = np.array([0.0, 0, 0, 0, 1, 2.5, 4, 4, 4, 4])
    from cadsculpt.spline.matrices import design_matrix

    t = np.linspace(0, 4, 33)
    assert design_matrix(knots, 3, t) @ greville(knots, 3) == pytest.approx(t)


def test_the_papers_window_is_a_rectangle_around_the_facets_that_meet(shapes):
    surface = shapes.plate(10.0, 8, 3, height=lambda x, y: 0.2 * (x - 5) ** 2)
    grid = PatchGrid.of(surface, 33)
    g = Workspace(grid, np.zeros(9, np.int64)).load(surface.control_points, paper=True, delta=0.01)
    low = paper_window(surface, g, lambda facets: facets[:, :, 0].max(axis=1) < 3.0, False).reshape(g.tally[0])
    assert low.any()
    assert not low.all()
    rows, columns = np.flatnonzero(low.any(axis=1)), np.flatnonzero(low.any(axis=0))
    assert low[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].all()
    none = paper_window(surface, g, lambda facets: np.zeros(len(facets), bool), True)
    assert none.all()
