"""Hulls of a trimmed face's part in a cell hold all of it, and are loose by the square of the cell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from cadsculpt.collide.cells import cells_of, halves, span_rectangles
from cadsculpt.collide.certified.face_hulls import face_hulls
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.collide.workspace import Workspace
from cadsculpt.spline.region import MIXED, Region
from cadsculpt.spline.surface import TrimCurve, TrimLoop

ARC = np.array([0.0, 0, 0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75, 1, 1, 1])
ROUND = np.array([[1.0, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]])
WEIGHTS = np.array([1, np.sqrt(0.5), 1, np.sqrt(0.5), 1, np.sqrt(0.5), 1, np.sqrt(0.5), 1])
CENTRE = np.array([0.45, 0.5])
OUTER, INNER = 0.37, 0.21


def ring(surface):
    """A surface trimmed to the part between two circles of its domain's unit square."""
    (u0, u1), (v0, v1) = surface.domain
    size = np.array([u1 - u0, v1 - v0])
    loops = [
        TrimLoop((TrimCurve(np.array([u0, v0]) + (CENTRE + r * ROUND) * size, ARC, 2, WEIGHTS),))
        for r in (OUTER, INNER)
    ]
    return replace(surface, trims=tuple(loops))


def on_ring(surface, u, v):
    (u0, u1), (v0, v1) = surface.domain
    r = np.hypot((u - u0) / (u1 - u0) - CENTRE[0], (v - v0) / (v1 - v0) - CENTRE[1])
    return (r <= OUTER) & (r >= INNER)


def load(surface):
    grid = PatchGrid.of(surface, 5)
    return Workspace(grid, np.zeros(16, np.int64)).load(surface.control_points, paper=False, delta=0.0)


def to_hull(point, points):
    stiff = 1e4
    return nnls(np.vstack([points.T, np.full(len(points), stiff)]), np.append(point, stiff))[1]


@pytest.mark.parametrize("rational", [False, True])
def test_they_hold_the_face(shapes, rational):
    rng = np.random.default_rng(3 + rational)
    cut = looked = 0
    for _ in range(6):
        surface = ring(shapes.random_surface(rng, rational=rational))
        g, region = load(surface), Region.of(surface)
        cells = cells_of(g, region, span_rectangles(g))
        for _ in range(9):
            mixed = np.flatnonzero(cells.on == MIXED)
            mixed = rng.permutation(mixed)[:30]
            rectangle, corners = cells.rectangle[mixed], cells.corners[mixed]
            hull, grown, beside = face_hulls(g, region, rectangle, corners, cells.sag[mixed])
            cut += int((beside < 1).sum())
            for k in range(len(mixed)):
                r = rectangle[k]
                u, v = rng.uniform(r[0], r[1], 40), rng.uniform(r[2], r[3], 40)
                on = np.flatnonzero(on_ring(surface, u, v))[:4]
                for point in surface.evaluate(u[on], v[on]):
                    looked += 1
                    assert to_hull(point, hull[k]) <= grown[k] * (1 + 1e-6) + 1e-8
            chosen = cells_of(g, region, rectangle)
            cells = cells_of(g, region, halves(chosen)[0])
    assert cut > 300
    assert looked > 3000


def test_they_are_loose_by_the_square_of_the_cell(shapes):
    rng = np.random.default_rng(8)
    surface = ring(shapes.random_surface(rng, rational=True))
    g, region = load(surface), Region.of(surface)
    cells = cells_of(g, region, span_rectangles(g))
    for _ in range(8):
        cells = cells_of(g, region, halves(cells)[0])
    loose = []
    for _ in range(3):
        mixed = cells.on == MIXED
        parts = cells.rectangle[mixed]
        _, grown, beside = face_hulls(g, region, parts, cells.corners[mixed], cells.sag[mixed])
        loose.append(float(np.median(grown + beside * cells.radius[mixed])))
        for _ in range(2):
            cells = cells_of(g, region, halves(cells)[0])
    # two cuts halve a cell both ways
    assert loose[1] < 0.35 * loose[0]
    assert loose[2] < 0.35 * loose[1]


def test_a_sliver_is_cut_on_both_sides(shapes):
    line = np.array([0.0, 0, 1, 1])
    for side in (1.0, -1.0):
        corners = np.array([[0.2, 0.3], [0.8, 0.6], [0.8, 0.61], [0.2, 0.31], [0.2, 0.3]])[:: int(side)]
        loop = TrimLoop(tuple(TrimCurve(corners[k : k + 2], line, 1) for k in range(4)))
        surface = replace(shapes.plate(count=4), trims=(loop,))
        g, region = load(surface), Region.of(surface)
        rectangle = np.array([[0.4, 0.6, 0.4, 0.52]])
        cells = cells_of(g, region, rectangle)
        hull, _, beside = face_hulls(g, region, rectangle, cells.corners, cells.sag)
        assert beside[0] < 0.2
        (u0, u1), (v0, v1) = surface.domain
        low, high = surface.evaluate(u0, v0), surface.evaluate(u1, v1)
        uv = (hull[0, :, :2] - low[:2]) / (high[:2] - low[:2])
        gap = uv[:, 1] - (0.3 + 0.5 * (uv[:, 0] - 0.2))
        assert gap.min() == pytest.approx(0.0, abs=1e-6)
        assert gap.max() == pytest.approx(0.01, abs=1e-6)
