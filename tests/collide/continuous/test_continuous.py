"""Continuous collision of vertices, faces and edges: planted contacts, planted misses, and the symbolic benchmark."""

from __future__ import annotations

import csv
import os
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadsculpt.collide.continuous.algebraic import roots
from cadsculpt.collide.continuous.primitives import edge_edge, exact_time, may_meet, vertex_face
from cadsculpt.errors import InputError

BOTH = pytest.mark.parametrize("edges", [False, True])


def _solve(start, end, edges):
    return (edge_edge if edges else vertex_face)(start, end)


def _apart(points, edges):
    """Distance of the two features, points (4, 3), by quadratic minimisation on all their parts."""

    def segment(p, a, b):
        d = b - a
        t = np.clip((p - a) @ d / max(d @ d, 1e-300), 0, 1)
        return np.linalg.norm(p - a - t * d)

    p, a, b, c = points
    if not edges:
        best = min(segment(p, a, b), segment(p, b, c), segment(p, c, a))
        w = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), p - a, rcond=None)[0]
        if (w >= 0).all() and w.sum() <= 1:
            best = min(best, np.linalg.norm(a + w[0] * (b - a) + w[1] * (c - a) - p))
        return best
    best = min(segment(p, b, c), segment(a, b, c), segment(b, p, a), segment(c, p, a))
    w = np.linalg.lstsq(np.stack([a - p, b - c], axis=1), b - p, rcond=None)[0]
    if ((w >= 0) & (w <= 1)).all():
        best = min(best, np.linalg.norm(p + w[0] * (a - p) - b - w[1] * (c - b)))
    return best


def _planted(rng, edges, n):
    """Queries of integers whose features meet at a time that is a multiple of 1/8: (n, 4, 3) twice, and those times."""
    start, end = rng.integers(-999, 1000, (2, n, 4, 3)).astype(float) * 64
    time = rng.integers(0, 9, n) / 8
    u, v = (x / 8 for x in (rng.integers(0, 9, n), rng.integers(0, 9, n)))
    if not edges:
        v = np.minimum(v, 1 - u)
    at = start + time[:, None, None] * (end - start)
    if edges:
        w = np.stack([np.zeros(n), 1 - u, 1 - v, v], axis=1)
        w[:, 1] = 0
        goal = (
            (1 - v)[:, None] * at[:, 2] + v[:, None] * at[:, 3] - ((1 - u)[:, None] * at[:, 0] + u[:, None] * at[:, 1])
        )
    else:
        goal = (1 - u - v)[:, None] * at[:, 1] + u[:, None] * at[:, 2] + v[:, None] * at[:, 3] - at[:, 0]
    # the first feature is moved there as a whole
    moved = slice(0, 2) if edges else slice(0, 1)
    start[:, moved] += goal[:, None]
    end[:, moved] += goal[:, None]
    return start, end, time


@BOTH
def test_what_meets_in_exact_numbers_is_found_and_not_late(edges):
    start, end, time = _planted(np.random.default_rng(1), edges, 400)
    found = _solve(start, end, edges)
    assert found.hit.all()
    assert (found.time <= time).all()
    assert (found.time >= 0).all()
    # and never early: at the time that is named the two are together, as far as doubles can show it
    for k in range(len(time)):
        t = found.time[k]
        assert _apart((1 - t) * start[k] + t * end[k], edges) < 1e-7 * np.abs(start[k]).max()


@BOTH
def test_the_order_of_corners_and_the_scale_change_nothing(edges):
    rng = np.random.default_rng(2)
    start, end, _ = _planted(rng, edges, 60)
    # half of them nudged by a last digit: some then miss by that much
    nudged = start.copy()
    nudged[::2, 0, 2] = np.nextafter(start[::2, 0, 2], np.inf)
    first = _solve(nudged, end, edges)
    orders = [[2, 3, 0, 1], [1, 0, 2, 3], [0, 1, 3, 2]] if edges else [[0, 2, 3, 1], [0, 3, 2, 1]]
    for order in orders:
        again = _solve(nudged[:, order], end[:, order], edges)
        np.testing.assert_array_equal(again.hit, first.hit)
        np.testing.assert_array_equal(again.time, first.time)
    for power in (-200, 200):
        np.testing.assert_array_equal(_solve(nudged * 2.0**power, end * 2.0**power, edges).time, first.time)
    np.testing.assert_array_equal(_solve(end, nudged, edges).hit, first.hit)
    assert 20 < first.hit.sum() <= 60


@BOTH
@pytest.mark.parametrize("hair", [2.0**-20, 2.0**-45, 2.0**-52])
def test_a_miss_by_a_hair_is_a_miss_and_a_touch_is_a_contact(edges, hair):
    # a vertex falls past the edge y = 0 of a face in z = 0; an edge past the end of another
    face = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]])
    edge = np.array([[1.0, 0, 0], [1, 3, 0]])
    shear = np.array([[1.0, 0.5, 0.25], [0, 1, 0.5], [0, 0, 1]])
    for offset, expected in ((-hair, False), (0.0, True), (hair, True)):
        if edges:
            falling = np.array([[-1.0, offset, 2], [3, offset, 2]])
            start = np.concatenate([falling, edge])
        else:
            start = np.concatenate([[[1.0, offset, 2]], face])
        end = start.copy()
        end[: 2 if edges else 1, 2] = -6.0
        for matrix in (np.eye(3), shear):
            found = _solve(start @ matrix, end @ matrix, edges)
            assert found.hit[0] == expected
            if expected:
                assert 0.25 - 2**-50 <= found.time[0] <= 0.25


@BOTH
def test_motions_in_one_plane(edges):
    """Every time is one of coplanarity: against exact tests at seventeen times, in the plane."""
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(40):
        start, end = rng.integers(-4, 5, (2, 1, 4, 3)).astype(float)
        start[..., 2], end[..., 2] = 0.0, 3.0  # the plane moves as well
        found = _solve(start, end, edges)
        touching = [
            k / 16
            for k in range(17)
            if exact_time((start[0] * 16 + k * (end[0] - start[0])).tolist(),
                          (start[0] * 16 + k * (end[0] - start[0])).tolist(), edges=edges) is not None
        ]  # fmt: skip
        seen = [t for t in np.arange(0, 1.0001, 1 / 16) if _apart(start[0] + t * (end[0] - start[0]), edges) < 1e-12]
        np.testing.assert_array_equal(touching, seen)
        if seen:
            assert found.hit[0]
            assert found.time[0] <= seen[0]
        if found.hit[0]:
            hits += 1
            t = found.time[0]
            assert _apart((1 - t) * start[0] + t * end[0], edges) < 1e-9
    assert 10 < hits < 40


@BOTH
def test_features_without_extent(edges):
    point = np.zeros((1, 4, 3))
    assert _solve(point, point, edges).time[0] == 0.0
    # two points that meet in the middle, and two that cross at other times
    start, end = np.zeros((1, 4, 3)), np.zeros((1, 4, 3))
    one = slice(0, 2) if edges else slice(0, 1)
    start[0, one], end[0, one] = [-1.0, -1, 0], [1.0, 1, 0]
    assert _solve(start, end, edges).time[0] == 0.5
    end[0, one] = [1.0, 1.25, 0]
    assert not _solve(start, end, edges).hit[0]
    # a point onto a segment
    start[0, 3] = end[0, 3] = [0.0, 3.0, 0.0]
    assert _solve(start, end, edges).hit[0]


def test_a_graze_within_the_step_touches():
    # det [p - a, b - a, c - a] = s^2 with s = 2t - 1: the vertex comes to the turning face, and does not pass
    def face(s, lift):
        return [[0.25 - s, 0.25, 0.25 * s + lift], [0, 0, 0], [1, 0, s], [0, 1, 0]]

    assert vertex_face(face(-1.0, 0.0), face(1.0, 0.0)).time[0] == 0.5
    assert not vertex_face(face(-1.0, 2.0**-50), face(1.0, 2.0**-50)).hit[0]
    found = vertex_face(face(-1.0, -(2.0**-40)), face(1.0, -(2.0**-40)))  # s^2 = 2^-40
    assert 0.5 - 2.0**-21 - 2.0**-51 <= found.time[0] <= 0.5 - 2.0**-21


@settings(max_examples=150, deadline=None)
@given(st.lists(st.integers(-3, 3), min_size=24, max_size=24), st.booleans())
def test_small_integers(numbers, edges):
    points = np.array(numbers, dtype=float).reshape(2, 1, 4, 3)
    found = _solve(points[0], points[1], edges)
    times = np.linspace(0, 1, 33)
    gaps = np.array([_apart((1 - t) * points[0, 0] + t * points[1, 0], edges) for t in times])
    if found.hit[0]:
        t = found.time[0]
        assert _apart((1 - t) * points[0, 0] + t * points[1, 0], edges) < 1e-6
        assert (gaps[times < t - 1e-9] > 0).all()
    else:
        assert (gaps > 1e-9).all()


def test_the_boxes_clear_what_is_clear_by_themselves():
    rng = np.random.default_rng(4)
    start = rng.normal(size=(500, 4, 3))
    start[:, 0] += [0, 0, 20.0]
    out = np.ones(500, dtype=bool)
    may_meet(start, start + rng.normal(size=(500, 4, 3)), False, out)
    assert not out.any()


def test_roots_are_isolated_exactly():
    # (8t - 3)^2 (2t - 1), then t (t - 1) (2 t^2 - 1)
    double = roots([-9, 18 + 48, -64 - 96, 128])
    assert [float(r.low) for r in double if r.exact] == [0.5] or len(double) == 2
    for root in double:
        for _ in range(60):
            if not root.exact:
                root.refine()
    assert [root.low for root in double] == [Fraction(3, 8), Fraction(1, 2)]
    found = roots([0, 1, -1, -2, 2])
    assert len(found) == 3
    assert [r.exact for r in found] == [True, False, True]
    assert found[1].sign([-1, 0, 2]) == 0
    assert found[1].sign([-(2**200), 0, 2**201 + 1]) == 1
    assert found[1].sign([-(2**200), 0, 2**201 - 1]) == -1


def test_numbers_that_are_not_finite_are_an_error():
    good = np.zeros((1, 4, 3))
    for bad in (np.nan, np.inf):
        points = good.copy()
        points[0, 1, 2] = bad
        for args in ((points, good), (good, points)):
            with pytest.raises(InputError, match="not finite"):
                vertex_face(*args)
    with pytest.raises(InputError, match="shape"):
        edge_edge(np.zeros((2, 3, 3)), np.zeros((2, 3, 3)))
    with pytest.raises(InputError, match="queries"):
        edge_edge(good, np.zeros((2, 4, 3)))


@pytest.mark.corpus
@pytest.mark.parametrize("name", ["erleben-cube-cliff-edges", "erleben-spikes"])
@BOTH
def test_symbolic_truth(edges, name):
    if "CADSCULPT_CORPUS" not in os.environ:
        pytest.skip("CADSCULPT_CORPUS is not set")
    kind = "edge-edge" if edges else "vertex-face"
    path = Path(os.environ["CADSCULPT_CORPUS"]) / "ccd" / f"{name}_{kind}_0_0.csv"
    with path.open(newline="") as file:
        rows = [[int(x) for x in row] for row in csv.reader(file)]
    exact = [[Fraction(*row[2 * c : 2 * c + 2]) for c in range(3)] for row in rows]
    truth = np.array([row[6] for row in rows[::8]], dtype=bool)
    points = np.array([[float(x) for x in row] for row in exact]).reshape(-1, 8, 3)
    found = _solve(points[:, :4], points[:, 4:], edges)
    np.testing.assert_array_equal(found.hit, truth)
    # the exact stage alone, on the rationals as they stand, says the same
    for k in range(0, len(truth), 5):
        time = exact_time(exact[8 * k : 8 * k + 4], exact[8 * k + 4 : 8 * k + 8], edges=edges)
        assert (time is not None) == truth[k]
        assert time is None or 0 <= time - Fraction(found.time[k]) < Fraction(1, 2**52)
