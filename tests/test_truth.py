"""The benchmark of the collision's claims, run small; and its own truth against another one."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture(scope="module")
def part():
    """A module of benchmarks/ by its name."""
    sys.path.insert(0, str(BENCHMARKS))
    try:
        yield importlib.import_module
    finally:
        sys.path.remove(str(BENCHMARKS))


def test_spheres_hold_their_cells(part):
    result = part("truth_spheres").spheres_truth(3000)
    assert result["spheres_tested"] >= 3000
    assert result["spheres_outside"] == 0
    # the samples are dense enough to leave spheres that do not hold their cells
    assert result["spheres_outside_paper"] > 300
    assert min(result[f"spheres_{kind}"] for kind in ("rational", "periodic", "deformed")) > 300


def test_triangles_are_told_apart(part):
    result = part("truth_triangles").tri_tri_truth(4000)
    assert result["tri_tri_tested"] >= 4000
    assert result["tri_tri_wrong"] == 0
    assert result["tri_tri_segment_wrong"] == 0
    assert min(result["tri_tri_kinds"].values()) > 50


def test_the_truth_of_triangles_is_one_in_all_its_arithmetics(part):
    """64-bit integers, doubles where they are sure, and Python's integers; and known answers."""
    m = part("truth_triangles")
    rng = np.random.default_rng(0)
    for shape in m.SHAPES + ("random",):
        t = m.random_pairs(rng, shape, 60)
        exact = np.array([m.relation_of_integers(m.as_integers(pair)) for pair in t])
        floats = m.axes_of_doubles(t)
        sure = floats != m.UNSURE
        assert np.array_equal(floats[sure], exact[sure])
        if shape not in m.ROUNDED:
            assert np.array_equal(m.axes_of_integers(t.astype(np.int64)), exact)
    flat = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0]])
    upright = np.array([[1, 1, -1], [1, 1, 1], [1, -1, 0]])
    for other, expected in (
        (upright, 2), (upright + [0, 0, 1], 1), (upright + [0, 0, 2], 0), (flat + [1, 1, 0], 3), (flat + [4, 0, 0], 1),
        (flat + [5, 0, 0], 0), (flat + [0, 0, 1], 0),
    ):  # fmt: skip
        assert m.relation_of_integers(np.concatenate([flat, other]).tolist()) == expected


def test_nothing_is_missed_or_made_up(part):
    result = part("truth_scenes").scenes_truth(60, seed=5)
    assert result["scenes_tested"] == 60
    assert result["scenes_touching"] > 20
    assert result["missed"] == result["false_contacts"] == result["duplicate_contacts"] == 0
    assert result["missed_paper_mode"] > 5


def test_crossing_pairs_are_those_of_cgal(part):
    pytest.importorskip("igl.copyleft.cgal", reason="libigl (extra bench) is not installed: pairs were not compared")
    result = part("truth_pairs").pairs_truth()
    assert result["pairs_equal_exact"] is True
    assert len(result["pairs_scenes"]) == 10


def test_one_object_comes_out_and_what_is_not_there_is_said(part, monkeypatch, capsys):
    truth = part("truth")
    monkeypatch.setitem(truth.PARTS, "spheres", lambda: {"spheres_tested": 1})
    monkeypatch.setattr(truth, "MISSING", [*truth.MISSING, "moons"])
    monkeypatch.setattr(sys, "argv", ["truth.py", "--json", "--only", "spheres", "--only", "moons"])
    truth.main()
    out, err = capsys.readouterr()
    assert json.loads(out) == {"spheres_tested": 1, "moons_missing": True}
    assert "moons: NOT THERE" in err
