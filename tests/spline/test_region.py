"""Rectangles on a trimmed face: never called off or on where the face says otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.spline.region import MIXED, OFF, ON, Region
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

ROOT = np.sqrt(0.5)
QUARTERS = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]], dtype=float)
CIRCLE_WEIGHTS = np.array([1, ROOT, 1, ROOT, 1, ROOT, 1, ROOT, 1])
CIRCLE_KNOTS = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4.0])


def circle(centre, radius):
    return TrimLoop((TrimCurve(np.array(centre) + radius * QUARTERS, CIRCLE_KNOTS, 2, CIRCLE_WEIGHTS),))


def polygon(points):
    points = np.array([*points, points[0]], dtype=float)
    line = np.array([0.0, 0, 1, 1])
    return TrimLoop(tuple(TrimCurve(points[k : k + 2], line, 1) for k in range(len(points) - 1)))


def sheet(*loops, size=(10.0, 4.0)):
    net = np.array([[[x, y, 0.0] for y in (0.0, size[1])] for x in (0.0, size[0])])
    knots = [np.array([0.0, 0, s, s]) for s in size]
    return BSplineSurface(net, knots[0], knots[1], 1, 1, trims=loops or None)


def test_a_disc_by_its_own_formula():
    region = Region.of(sheet(circle((5.0, 2.0), 1.5)))
    rng = np.random.default_rng(1)
    low = rng.uniform([0, 0], [9, 3.5], (20000, 2))
    high = low + rng.choice([1e-7, 1e-3, 0.05, 0.4], (20000, 1)) * rng.uniform(0.1, 1, (20000, 2))
    got = region.classify(np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1))
    near = np.clip([5.0, 2.0], low, high) - [5.0, 2.0]
    far = np.maximum(np.abs(low - [5.0, 2.0]), np.abs(high - [5.0, 2.0]))
    nearest, farthest = np.hypot(*near.T), np.hypot(*far.T)
    assert (nearest[got == OFF] > 1.5).all()
    assert (farthest[got == ON] < 1.5).all()
    # and nothing is called mixed that is clearly not: the border is as thin as it says
    wide = 2 * region.width * 10.0
    assert ((nearest[got == MIXED] <= 1.5 + wide) & (farthest[got == MIXED] >= 1.5 - wide)).all()
    assert {OFF, ON, MIXED} == set(got.tolist())


def test_a_piece_of_the_face_between_all_corners_is_not_given_away():
    region = Region.of(sheet(circle((5.3, 2.1), 1e-4)))
    assert region.classify(np.array([[0.0, 10.0, 0.0, 4.0]])) == [MIXED]
    assert region.classify(np.array([[5.29995, 5.30005, 2.09995, 2.10005]])) == [ON]


def test_holes_and_corners():
    region = Region.of(sheet(polygon([(1, 1), (9, 1), (9, 3), (1, 3)]), circle((5.0, 2.0), 0.5)))
    rectangles = {
        (1.1, 4.0, 1.1, 2.9): ON,
        (4.9, 5.1, 1.9, 2.1): OFF,
        (0.1, 0.9, 0.5, 3.5): OFF,
        (0.9, 1.1, 0.9, 1.1): MIXED,
        (4.4, 4.6, 1.9, 2.1): MIXED,
    }
    assert region.classify(np.array(list(rectangles))).tolist() == list(rectangles.values())
    points = np.array([[2.0, 2.0], [5.0, 2.0], [1.0, 2.0], [5.0, 1.5], [9.5, 2.0]])
    assert region.locate(points).tolist() == [ON, OFF, MIXED, MIXED, OFF]


def test_trims_that_run_over_a_seam():
    net = np.repeat(np.concatenate([QUARTERS, np.zeros((9, 1))], axis=1)[:, None], 2, axis=1)
    net[:, 1, 2] = 1.0
    line = np.array([0.0, 0, 1, 1])
    loop = polygon([(0.9, 0.2), (1.2, 0.2), (1.2, 0.8), (0.9, 0.8)])
    weights = np.repeat(CIRCLE_WEIGHTS[:, None], 2, axis=1)
    tube = BSplineSurface(net, CIRCLE_KNOTS * 0.25, line, 2, 1, weights, trims=(loop,))
    region = Region.of(tube)
    rectangles = np.array([[0.92, 0.99, 0.3, 0.5], [0.01, 0.15, 0.3, 0.5], [0.3, 0.6, 0.3, 0.5], [0.15, 0.3, 0.3, 0.5]])
    assert region.classify(rectangles).tolist() == [ON, ON, OFF, MIXED]


@pytest.mark.parametrize("seed", range(4))
def test_random_trims_against_points(seed):
    """Random curved loops: every point that the point test of `trim` puts on the face lies in no rectangle called off."""
    from cadsculpt.spline.trim import inside

    rng = np.random.default_rng(seed)
    n = 9
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    ring = np.array([5.0, 2.0]) + (rng.uniform(0.4, 1.6, n) * np.array([np.cos(angle), np.sin(angle)])).T
    points = np.concatenate([ring, ring[:1]])
    knots = np.concatenate([np.zeros(4), np.linspace(0, 1, n + 1 - 3 + 1)[1:-1], np.ones(4)])
    weights = rng.uniform(0.3, 3, n + 1) if seed % 2 else None
    surface = sheet(TrimLoop((TrimCurve(points, knots, 3, weights),)))
    region = Region.of(surface)
    u, v = np.linspace(0, 10, 101), np.linspace(0, 4, 81)
    cells = np.array([[u[i], u[i + 1], v[j], v[j + 1]] for i in range(100) for j in range(80)])
    got = region.classify(cells).reshape(100, 80)
    fine_u, fine_v = np.linspace(0, 10, 1001), np.linspace(0, 4, 801)
    on = inside(surface, fine_u, fine_v)
    for i in range(11):
        for j in range(11):
            part = on[i : 1000 + i - 9 : 10, j : 800 + j - 9 : 10][:100, :80]
            edge = i in (0, 10) or j in (0, 10)
            assert not (part & (got == OFF)).any()
            assert edge or not (~part & (got == ON)).any()


@pytest.mark.parametrize(
    ("size", "middle"), [((10.0, 4.0), (5.0, 2.0)), ((4e4, 4.0), (2e4, 2.0)), ((1e4, 1e4), (3e3, 3e3))]
)
def test_the_border_is_as_sharp_on_a_surface_far_larger_than_the_face(size, middle):
    region = Region.of(sheet(circle(middle, 1.5), size=size))
    angle = np.linspace(0, 2 * np.pi, 500)
    for off in (-1e-6, 1e-6):
        at = np.array(middle) + (1.5 + off) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        assert (region.locate(at) == (ON if off < 0 else OFF)).all()


def test_curves_of_high_degree_are_known_as_sharply():
    """Eleven degrees and a net that swings: the bound over the whole curve is far above what it bends anywhere."""
    from cadsculpt.spline.trim import curve_points

    rng = np.random.default_rng(6)
    angle = np.linspace(0, 2 * np.pi, 12)
    net = np.array([5.0, 2.0]) + 1.4 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    net[1:-1] += rng.normal(scale=0.3, size=(10, 2))
    curve = TrimCurve(net, np.concatenate([np.zeros(12), np.ones(12)]), 11)
    region = Region.of(sheet(TrimLoop((curve,))))
    assert region.deviation.max() <= 2.1e-8
    points = (curve_points(curve, np.linspace(0, 1, 3000)) - region.low) / region.size
    starts, ways = region.chords[:-1, :2], (region.chords[:, 2:] - region.chords[:, :2])[:-1]
    length = np.einsum("ij,ij->i", ways, ways)
    for x in points:
        w = np.clip(np.einsum("ij,ij->i", x - starts, ways) / length, 0, 1)
        assert np.linalg.norm(starts + w[:, None] * ways - x, axis=1).min() <= region.deviation.max()


def test_the_border_on_a_seam_is_found_from_both_sides():
    net = np.repeat(np.concatenate([QUARTERS, np.zeros((9, 1))], axis=1)[:, None], 2, axis=1)
    net[:, 1, 2] = 1.0
    weights = np.repeat(CIRCLE_WEIGHTS[:, None], 2, axis=1)
    loop = polygon([(0.7, 0.21), (1.0, 0.21), (1.0, 0.83), (0.7, 0.83)])
    tube = BSplineSurface(net, CIRCLE_KNOTS * 0.25, np.array([0.0, 0, 1, 1]), 2, 1, weights, trims=(loop,))
    region = Region.of(tube)
    for rectangle in ([0.99, 1.0, 0.3, 0.31], [0.0, 0.01, 0.3, 0.31]):
        assert region.classify(np.array([rectangle])) == [MIXED]
        chords = region.border_in(np.array(rectangle))
        assert chords
        for chord, part, _ in chords:
            at = chord[0] + part * (chord[1] - chord[0])
            assert rectangle[0] - 1e-12 <= at[0] <= rectangle[1] + 1e-12
            assert rectangle[2] <= at[1] <= rectangle[3]
