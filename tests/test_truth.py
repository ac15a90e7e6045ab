"""The benchmark of the collision's claims, run small; and its own truth against another one."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from cadsculpt.motion.pose import Pose


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
    result = part("truth_scenes").scenes_truth(80, seed=5)
    assert result["scenes_tested"] == 80
    assert result["scenes_touching"] > 30
    assert result["scenes_several_tools"] > 2
    assert result["missed"] == result["false_contacts"] == result["duplicate_contacts"] == 0
    assert result["scenes_wrong"] == []
    assert result["missed_paper_mode"] > 5


def test_the_tools_of_the_scenes_are_as_deep_as_said(part):
    """Positive in the solid and nowhere else, and no deeper than its surface is near: against the engine's distances."""
    solids, tools = part("truth_solids"), part("truth_tools")
    rng = np.random.default_rng(1)
    made = [solids.random_implicit(rng, name, 2.0) for name in solids.SHAPES]
    made += [tools.random_superquadric(rng, 2.0) for _ in range(4)] + [
        tools.random_mesh(rng, m, 2.0) for m in tools.MESHES
    ]
    made += [tools.composed(name, 2.0, which) for name in tools.COMPOSED for which in range(2)]
    for solid in made:
        x = rng.normal(size=(150, 3)) * rng.choice([0.3, 1.0, 2.0], (150, 1)) + solid.anchor
        pose = Pose(rng.normal(size=3), solids.random_turn(rng))
        distance, depth = solid.placed(pose).field.distance(pose.to_world(x)), solid.depth(x)
        sure = np.abs(distance) > 1e-9
        assert np.array_equal((distance < 0)[sure], (depth > 0)[sure]), solid.name
        assert (depth <= -distance + 1e-9)[distance < 0].all(), solid.name
        assert (distance < 0).any(), solid.name


def test_continuous_collision_is_never_late(part, corpus):
    result = part("truth_ccd").ccd_truth()
    assert result["ccd_queries"] > result["ccd_negatives"] > 100
    assert result["ccd_false_negative"] == 0
    assert 15 * result["ccd_false_positive"] < result["ccd_negatives"]


def test_crossing_pairs_are_those_of_cgal(part):
    pytest.importorskip("igl.copyleft.cgal", reason="libigl (extra bench) is not installed: pairs were not compared")
    result = part("truth_pairs").pairs_truth()
    assert result["pairs_equal_exact"] is True
    empty = [scene["scene"] for scene in result["pairs_scenes"] if scene["pairs"] == 0]
    assert (len(result["pairs_scenes"]), empty) == (10, ["no contact"])


def test_one_object_comes_out(part, monkeypatch, capsys):
    truth = part("truth")
    monkeypatch.setitem(truth.PARTS, "spheres", spheres)
    monkeypatch.setitem(truth.PARTS, "moons", moons)
    monkeypatch.setattr(sys, "argv", ["truth.py", "--json", "--only", "moons", "--only", "spheres"])
    truth.main()
    out, err = capsys.readouterr()
    assert json.loads(out) == {"spheres_tested": 1, "moons_tested": 2}
    assert "moons: " in err


def spheres():
    return {"spheres_tested": 1}


def moons():
    return {"moons_tested": 2}
