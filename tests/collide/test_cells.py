"""Cells below the grid: their hulls, grown by the sag, and their spheres hold the surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from cadsculpt.collide.cells import cells_of, halves, quarters, span_rectangles
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.collide.workspace import Workspace
from cadsculpt.spline.region import MIXED, ON, Region
from cadsculpt.spline.surface import TrimCurve, TrimLoop


def load(surface):
    grid = PatchGrid.of(surface, 5)
    return Workspace(grid, np.zeros(16, np.int64)).load(surface.control_points, paper=False, delta=0.0)


def random_rectangles(g, rng, n):
    """Rectangles of all sizes inside the knot spans, whole spans among them."""
    spans = span_rectangles(g)[rng.integers(0, g.tally[0, 0] * g.tally[0, 1], n)]
    shrink = rng.choice([1.0, 0.3, 1e-2, 1e-5], n)
    out = np.empty((n, 4))
    for k in (0, 2):
        size = shrink * (spans[:, k + 1] - spans[:, k])
        out[:, k] = spans[:, k] + rng.random(n) * (spans[:, k + 1] - spans[:, k] - size)
        out[:, k + 1] = np.minimum(out[:, k] + size, spans[:, k + 1])
    return out


def to_hull(point, corners):
    """Distance of a point from the hull of four: non-negative least squares, the sum of the weights held by a stiff row."""
    stiff = 1e4
    left = np.vstack([corners.T, np.full(4, stiff)])
    return nnls(left, np.append(point, stiff))[1]


@pytest.mark.parametrize("rational", [False, True])
def test_hull_and_sphere_hold_the_surface(shapes, rational):
    rng = np.random.default_rng(5 + rational)
    for _ in range(30):
        surface = shapes.random_surface(rng, rational=rational)
        g = load(surface)
        cells = cells_of(g, None, random_rectangles(g, rng, 40))
        s, t = rng.random((2, 20))
        r = cells.rectangle[:, :, None]
        points = surface.evaluate(r[:, 0] + s * (r[:, 1] - r[:, 0]), r[:, 2] + t * (r[:, 3] - r[:, 2]))
        if not rational:
            weights = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], 1)
            bilinear = np.einsum("ka,nad->nkd", weights, cells.corners)
            assert (np.linalg.norm(points - bilinear, axis=2) <= cells.sag[:, None]).all()
        for k in range(40):
            for point in points[k, :5]:
                assert to_hull(point, cells.corners[k]) <= cells.sag[k] * (1 + 1e-6) + 1e-8
        assert (np.linalg.norm(points - cells.centre[:, None], axis=2) <= cells.radius[:, None]).all()
        for k, (a, b) in enumerate(((0, 2), (1, 2), (0, 3), (1, 3))):
            corner = surface.evaluate(cells.rectangle[:, a], cells.rectangle[:, b])
            assert np.abs(cells.corners[:, k] - corner).max() <= g.slack


def test_the_sag_falls_with_the_square_of_the_size(shapes):
    rng = np.random.default_rng(9)
    surface = shapes.random_surface(rng, rational=True)
    g = load(surface)
    cells = cells_of(g, None, span_rectangles(g))
    largest = [cells.sag.max()]
    for _ in range(6):
        cells = cells_of(g, None, quarters(cells.rectangle))
        largest.append(cells.sag.max())
    # a quarter in the end; the weights still change a little over the cell
    assert 0.2 < largest[-1] / largest[-2] < 0.32
    assert len(cells.sag) == 4**6 * g.tally[0, 0] * g.tally[0, 1]


def test_halves_cover_the_cell_and_end_at_rounding(shapes):
    rng = np.random.default_rng(2)
    g = load(shapes.random_surface(rng))
    cells = cells_of(g, None, random_rectangles(g, rng, 30))
    rectangle, owner = halves(cells)
    assert np.bincount(owner).tolist() == [2] * 30
    area = (rectangle[:, 1] - rectangle[:, 0]) * (rectangle[:, 3] - rectangle[:, 2])
    whole = (cells.rectangle[:, 1] - cells.rectangle[:, 0]) * (cells.rectangle[:, 3] - cells.rectangle[:, 2])
    assert np.bincount(owner, area) == pytest.approx(whole, rel=1e-9)
    cells = cells_of(g, None, span_rectangles(g)[:1])
    for _ in range(200):
        rectangle, _ = halves(cells)
        cells = cells_of(g, None, rectangle[:1])
    assert len(halves(cells)[0]) == 1
    assert np.isfinite(cells.sag).all()


def test_poles_and_seams_are_cells_like_others(shapes):
    g = load(shapes.ball(5.0))
    cells = cells_of(g, None, span_rectangles(g))
    for _ in range(8):
        rectangle, _ = halves(cells)
        cells = cells_of(g, None, rectangle)
    assert len(cells.sag) == 8 * 256
    distance = np.linalg.norm(cells.corners, axis=2)
    assert distance == pytest.approx(np.full_like(distance, 5.0), abs=1e-12)
    # every direction is cut: no cell is left long
    assert cells.radius.max() < 1.6


def test_a_trimmed_face_leaves_out_what_is_not_there(shapes):
    line = np.array([0.0, 0, 1, 1])
    corners = np.array([[0.41, 0.42], [0.43, 0.42], [0.43, 0.44], [0.41, 0.44], [0.41, 0.42]])
    loop = TrimLoop(tuple(TrimCurve(corners[k : k + 2], line, 1) for k in range(4)))
    surface = replace(shapes.plate(count=4), trims=(loop,))
    g = load(surface)
    cells = cells_of(g, Region.of(surface), span_rectangles(g))
    assert cells.on.tolist() == [MIXED]
    kept = 0.0
    for _ in range(16):
        rectangle, _ = halves(cells)
        cells = cells_of(g, Region.of(surface), rectangle)
        kept = ((cells.rectangle[:, 1] - cells.rectangle[:, 0]) * (cells.rectangle[:, 3] - cells.rectangle[:, 2])).sum()
        assert kept >= 0.02**2
    assert kept <= 0.02**2 * 1.8
    assert ON in cells.on
