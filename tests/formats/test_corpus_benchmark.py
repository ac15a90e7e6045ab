"""The benchmark of real files: what it compares it sees, and one file goes through all of it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

ROOT = Path(__file__).parents[2]


def patch(periodic: bool = False) -> BSplineSurface:
    rng = np.random.default_rng(2)
    x, y = np.meshgrid(np.arange(6.0), np.arange(5.0), indexing="ij")
    net = np.stack([x, y, rng.random((6, 5))], axis=2) * 10.0
    knots = np.array([0.0, 0, 0, 0, 0.4, 0.7, 1, 1, 1, 1])
    ring = 0.5 + 0.3 * np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1], [1, 0]])
    loop = TrimLoop((TrimCurve(ring, np.array([0.0, 0, 1, 2, 3, 4, 4]), 1),), True)
    return BSplineSurface(
        net, knots, np.array([0.0, 0, 0, 1, 2, 3, 3, 3]) / 3, 3, 2, weights=0.5 + rng.random((6, 5)), trims=(loop,)
    )


def test_every_difference_is_seen(part):
    compare = part("corpus_compare").difference
    a = patch()
    assert compare(a, a).largest == 0.0
    net = a.control_points.copy()
    net[3, 2, 1] += 1e-7 * a.size
    assert compare(a, a.with_control_points(net)).control_points == pytest.approx(1e-7, rel=1e-6)
    knots = a.knots_u.copy()
    knots[4] += 1e-8
    assert compare(a, replace(a, knots_u=knots)).knots == pytest.approx(1e-8, rel=1e-6)
    weights = a.weights.copy()
    weights[1, 1] *= 1.0 + 1e-8
    assert compare(a, replace(a, weights=weights)).weights > 1e-9
    assert compare(a, replace(a, weights=3.0 * a.weights)).largest < 1e-15
    curve = a.trims[0].curves[0]
    off = curve.control_points.copy()
    off[1] += [1e-6, 0.0]
    moved = replace(a, trims=(TrimLoop((replace(curve, control_points=off),), True),))
    assert 1e-8 < compare(a, moved).trims < 1e-5
    assert compare(a, replace(a, trims=None)).trims > 1.0


def test_the_same_curve_at_another_pace_or_cut_elsewhere_is_the_same(part):
    compare = part("corpus_compare").difference
    a = patch()
    curve = a.trims[0].curves[0]
    pace = replace(a, trims=(TrimLoop((replace(curve, knots=np.array([0.0, 0, 3, 4, 5, 9, 9])),), True),))
    assert compare(a, pace).trims < 1e-12
    cut = tuple(TrimCurve(curve.control_points[k : k + 2], np.array([0.0, 0, 1, 1]), 1) for k in range(4))
    assert compare(a, replace(a, trims=(TrimLoop(cut, True),))).trims < 1e-12


@pytest.mark.parametrize("axis", [0, 1])
def test_a_surface_run_the_other_way_is_turned_back(axis, part):
    m = part("corpus_compare")
    a = patch()
    found = m.difference(a, m._reversed(a, axis))
    assert found.turned
    assert found.largest < 1e-14


@pytest.mark.corpus
def test_one_file_goes_through_all_of_it(corpus, tmp_path):
    command = [sys.executable, str(ROOT / "benchmarks" / "corpus.py"), "--json", "--only", "step/splinecage.stp",
               "--only", "toolpath/expected/good-arc.big.metric.ngc.expected", "--cache", str(tmp_path)]  # fmt: skip
    for _ in range(2):
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ, timeout=900)
        totals = json.loads(done.stdout)["totals"]
        assert totals["files"] == totals["read_ok"] == 2
        assert totals["crashed"] == 0
        assert totals["toolpath_expected_match"]
        assert totals["area_agrees"] == 1
        assert totals["roundtrip_max_error"]["step->step"] == 0.0
        assert max(totals["roundtrip_max_error"].values()) <= 1e-9
        assert totals["sculpted"] == 1
        assert totals["sculpted_valid"] == 1.0
        assert totals["untouched_changed"] == 0
    assert done.stderr == ""  # the second time all rows come from the cache
