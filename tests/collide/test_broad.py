"""The broad phase: what it leaves out is apart, what it keeps comes near; boxes of nets are never stale."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cadsculpt.collide.broad import SWEEP_FROM, Extents, boxes_of, candidate_pairs, near_box
from cadsculpt.collide.detect import DetectCache, DetectOptions, FieldTool, SurfaceTool, detect
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.errors import GeometryError

# few distinct values, so that boxes touch, coincide and are flat; and infinite ones
COORDINATE = st.sampled_from([-np.inf, -2.0, -1.0, -0.5, 0.0, 0.1, 0.5, 1.0, 2.0, np.inf])


@st.composite
def boxes(draw, most):
    count = draw(st.integers(0, most))
    ends = draw(arrays(np.float64, (count, 2, 3), elements=COORDINATE))
    return np.sort(ends, axis=1)


def _brute(a, b, margin):
    meets = (a[:, None, 0] <= b[None, :, 1] + margin) & (b[None, :, 0] <= a[:, None, 1] + margin)
    return np.argwhere(meets.all(axis=2))


@given(boxes(60), boxes(60), st.sampled_from([0.0, 0.1, 0.5]))
def test_pairs_are_those_of_all_against_all(a, b, margin):
    assert np.array_equal(candidate_pairs(a, b, margin), _brute(a, b, margin))


@pytest.mark.parametrize("stretch", [(1, 1, 1), (100, 1, 1), (0, 1, 50), (0, 0, 0)])
@pytest.mark.parametrize("sizes", [(3, 900), (900, 3), (200, 300), (1, 1), (0, 50)])
def test_the_sweep_finds_what_brute_force_finds(sizes, stretch):
    rng = np.random.default_rng(sum(sizes))
    a, b = (
        np.sort(rng.uniform(-1, 1, (n, 1, 3)) * stretch + rng.exponential(0.1, (n, 2, 3)) * [[-1], [1]], axis=1)
        for n in sizes
    )
    for margin in (0.0, 0.05):
        found = candidate_pairs(a, b, margin)
        assert np.array_equal(found, _brute(a, b, margin))
        # what is left out is apart by more than the margin along an axis
        left_out = np.ones((len(a), len(b)), dtype=bool)
        left_out[tuple(found.T)] = False
        i, k = np.nonzero(left_out)
        gap = np.maximum(a[i, 0] - b[k, 1], b[k, 0] - a[i, 1]).max(axis=1, initial=-np.inf)
        assert (gap > margin * (1 - 1e-12) - 1e-12).all()


def test_coincident_boxes_all_pair():
    n = int(np.sqrt(SWEEP_FROM)) + 5
    one = np.tile(np.array([[[0.0, 0, 0], [1, 1, 0]]]), (n, 1, 1))
    assert len(candidate_pairs(one, one)) == n * n
    assert len(candidate_pairs(one, one + 1.0)) == 0 or (one[0, 1, 2] == 0.0)
    point = np.zeros((n, 2, 3))
    assert len(candidate_pairs(point, one)) == n * n


@pytest.mark.parametrize("bad", [np.nan, -1.0, np.inf])
def test_a_bad_margin_and_nan_are_errors(bad):
    box = np.zeros((1, 2, 3))
    with pytest.raises(GeometryError):
        candidate_pairs(box, box, bad)
    with pytest.raises(GeometryError):
        candidate_pairs(box, np.full((1, 2, 3), np.nan))


@given(boxes(40), st.sampled_from([0.0, 0.25]))
def test_near_box_is_brute_force(many, margin):
    low, high = np.array([-0.5, -0.5, 0.0]), np.array([0.5, 1.0, 0.0])
    meets = ((many[:, 0] <= high + margin) & (many[:, 1] >= low - margin)).all(axis=1)
    assert np.array_equal(near_box(many, low, high, margin, 0.0), np.flatnonzero(meets))
    assert set(np.flatnonzero(meets)) <= set(near_box(many, low, high, margin, 0.1))


def _nets(rng, count):
    return [rng.normal(size=(int(rng.integers(2, 6)), int(rng.integers(2, 6)), 3)) for _ in range(count)]


def _frozen(net):
    net = np.array(net)
    net.flags.writeable = False
    return net


def test_boxes_follow_nets_that_change_in_place_or_are_replaced():
    rng = np.random.default_rng(4)
    nets = _nets(rng, 30)
    extents = Extents()

    def right():
        truth = np.stack([[n.min(axis=(0, 1)), n.max(axis=(0, 1))] for n in nets])
        return np.array_equal(extents.of(nets, "model"), truth)

    assert right()
    nets[3][0, 0] += 50.0  # in place
    assert right()
    nets = [_frozen(n) for n in nets]
    assert right()
    nets[7] = _frozen(nets[7] * 3.0)
    assert right()
    owner = np.array(nets[5])
    view = owner[:]
    view.flags.writeable = False  # read-only, but the array behind it is not
    nets[5] = view
    assert right()
    owner += 9.0
    assert right()
    nets = nets[:20]
    assert right()
    nets = nets[::-1]
    assert right()


def test_a_net_that_is_not_finite_is_named_and_stays_an_error():
    rng = np.random.default_rng(5)
    nets = [_frozen(n) for n in _nets(rng, 6)]
    extents = Extents()
    extents.of(nets, "model")
    for bad in (np.nan, np.inf):
        spoilt = np.array(nets[4])
        spoilt[-1, -1, 2] = bad
        mixed = [*nets[:4], _frozen(spoilt), nets[5]]
        for _ in range(2):
            with pytest.raises(GeometryError, match="finite") as caught:
                extents.of(mixed, "model")
            assert "patch 4 of the model" in str(caught.value)
    assert np.isfinite(extents.of(nets, "model")).all()


def test_boxes_of_nets_in_a_row():
    rng = np.random.default_rng(6)
    nets = _nets(rng, 9)
    starts = np.concatenate([[0], np.cumsum([n.size for n in nets])])
    out = boxes_of(np.concatenate(nets, axis=None), starts)
    assert np.array_equal(out[:, 0], [n.min(axis=(0, 1)) for n in nets])
    assert np.array_equal(out[:, 1], [n.max(axis=(0, 1)) for n in nets])


def test_idle_patches_change_nothing(shapes):
    """One patch in contact among many that are not: the same contacts, from the same work in the narrow phase."""
    sheet = shapes.plate(10.0)
    grid = PatchGrid.of(sheet, 31)
    tools = [
        FieldTool(shapes.Sphere([5.0, 5.0, 1.4], 1.5)),
        SurfaceTool(
            (PatchGrid.of(shapes.ball(2.0, [5.0, 5.0, 1.8]), (17, 9)),), (shapes.ball(2.0, [5, 5, 1.8]).control_points,)
        ),
    ]
    alone = detect([grid], [sheet.control_points], tools, DetectOptions())
    idle = [_frozen(sheet.control_points + [20.0 * (k + 1), 0.0, 0.0]) for k in range(200)]
    cache = DetectCache()
    for _ in range(2):
        both = detect([grid] * 201, [*idle[:77], sheet.control_points, *idle[77:]], tools, DetectOptions(), cache=cache)
        assert len(both.contacts) == len(alone.contacts) > 20
        assert set(both.contacts.face) == {77}
        assert both.contacts.depth.tobytes() == alone.contacts.depth.tobytes()
        assert both.contacts.u.tobytes() == alone.contacts.u.tobytes()
        for name in ("spans", "sphere_tests", "triangles", "triangle_tests", "crossing_pairs", "levels"):
            assert getattr(both.counters, name) == getattr(alone.counters, name)
        assert set(cache.workspaces) == {(-1, 77), (1, 0)}
        assert both.counters.hull_tests == alone.counters.hull_tests + 2 * 200


def test_a_tool_of_many_patches_loads_only_those_near(shapes):
    """A wall of 100 small sheets as one tool: the contacts are those of the one sheet that it amounts to."""
    part = replace(shapes.plate(1.0, 4, 3), outward=False)
    nets = [part.control_points + [i, j, -0.2] for i in range(10) for j in range(10)]
    grids = (PatchGrid.of(part, 9),) * 100
    ball = shapes.ball(2.0, [4.6, 5.3, -2.0])  # the model, from below through the sheets
    grid = PatchGrid.of(ball, (33, 17))
    cache = DetectCache()
    tool = SurfaceTool(grids, tuple(nets), reach=0.5)
    contacts = detect([grid], [ball.control_points], [tool], DetectOptions(), cache=cache).contacts
    points = grid.matrices.points(ball.control_points, ball.weights).reshape(-1, 3)
    assert len(contacts) == len(np.unique(points[points[:, 2] >= -0.2].round(9), axis=0)) > 3
    assert contacts.tool_point[:, 2] == pytest.approx(-0.2, abs=1e-9)
    assert contacts.depth == pytest.approx(contacts.point[:, 2] + 0.2, abs=1e-9)
    loaded = {k for tool_index, k in cache.workspaces if tool_index == 0}
    assert len(loaded) < 60
