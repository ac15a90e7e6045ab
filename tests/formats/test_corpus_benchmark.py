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


def test_what_only_looks_the_same_is_not(part):
    """Another side, other loops, a curve that agrees at the places that are looked at; and what shapes nothing is told."""
    compare = part("corpus_compare").difference
    a = patch()
    assert compare(a, replace(a, outward=False)).causes() == ["side"]
    assert compare(a, replace(a, outward=False), sides=False).same
    hole = TrimLoop(a.trims[0].curves, False)
    assert compare(a, replace(a, trims=(hole,))).causes() == ["trim loops"]
    spans = 32
    # a wave that is nought at every place in 33
    x = np.linspace(0.2, 0.8, 2 * spans + 1)
    line, wave = (np.stack([x, 0.2 + high * (np.arange(len(x)) % 2)], axis=1) for high in (0.0, 1e-5))
    knots = np.concatenate([[0.0], np.repeat(np.linspace(0.0, 1.0, spans + 1), 2), [1.0]])
    back = TrimCurve(np.array([(0.8, 0.2), (0.5, 0.8), (0.2, 0.2)]), np.array([0.0, 0, 1, 2, 2]), 1)
    first, second = (replace(a, trims=(TrimLoop((TrimCurve(p, knots, 2), back)),)) for p in (line, wave))
    assert compare(first, second).causes() == ["trims"]
    ends_off = a.knots_u.copy()
    ends_off[0] -= 0.5
    assert compare(a, replace(a, knots_u=ends_off)).causes() == ["knots"]
    told = compare(a, replace(a, knots_u=ends_off), outermost=False)
    assert told.same
    assert told.outermost_knots > 0.1
    assert compare(a, replace(a, weights=3.0 * a.weights)).weight_factor == pytest.approx(2.0)


def test_totals_hide_no_face(part):
    """Lost faces, other loops, files that were refused or not done at all: each is in the totals, with an error of 1."""
    totals = part("corpus_totals").totals
    figures = dict.fromkeys(("control_points", "knots", "weights", "trims"), 0.0)
    good = {"faces": 3, "same": 3, "causes": {}, "error": 0.0, "turned": 0, "worst_face": "a", **figures}
    names = {"more": 0, "renamed": 0, "compared": "all", "copied": False}

    def row(file, **found):
        return {"file": file, "roundtrip": {"format": "step", **found}}

    kept = {"spline": good, "lost": 0, "lost_splines": 0, **names}
    lost = {"spline": good, "lost": 1, "lost_splines": 1, **names}
    gone = {"lost": 2, "lost_splines": 2, **names}
    loops = {**kept, "spline": {**good, "same": 2, "causes": {"trim loops": 1}, "error": 1.0}}
    rows = [
        row("a", iges=kept, g2=lost, json=gone, step=loops),
        row("b", iges=kept, g2=kept, json=kept, step={"refused": "no"}),
        {"file": "c", "roundtrip": {"crashed": "died"}},
    ]
    found = totals(rows)
    assert found["roundtrip_max_error"] == {"step->g2": 1.0, "step->iges": 0.0, "step->json": 1.0, "step->step": 1.0}
    assert found["roundtrip_not_done"] == {"c": "crashed: died"}
    assert found["roundtrip"]["step->json"]["faces"] == 5
    assert found["roundtrip_not_same"] == {
        "step->g2": "1 of 7 spline faces, 0 files refused: lost 1",
        "step->json": "2 of 5 spline faces, 0 files refused: lost 2",
        "step->step": "1 of 3 spline faces, 1 files refused: trim loops 1",
    }


@pytest.mark.parametrize("axis", [0, 1])
def test_a_surface_run_the_other_way_is_turned_back(axis, part):
    m = part("corpus_compare")
    a = patch()
    found = m.difference(a, replace(m._reversed(a, axis), outward=False))
    assert found.turned
    assert found.same
    assert m.difference(a, m._reversed(a, axis)).flipped
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


# ----------------------------------------------------------- what the totals could hide


def test_a_foreign_readers_second_look_sees_what_is_worse(part):
    check = part("corpus_check")
    before = check.Foreign(4, 1, (10.0, 20.0, 20.0, 30.0))
    assert check.faults(before, check.Foreign(4, 1, (30.0, 20.0, 10.0, 20.1)), sculpted_area=20.0) == []
    assert "3 faces" in check.faults(before, check.Foreign(3, 0, (10.0, 20.0, 30.0)), sculpted_area=20.0)[0]
    assert "faulty" in check.faults(before, check.Foreign(4, 2, before.areas), sculpted_area=20.0)[0]
    # another face than the sculpted one has changed
    (told,) = check.faults(before, check.Foreign(4, 1, (10.0, 20.0, 20.0, 30.1)), sculpted_area=20.0)
    assert "30 mm2" in told
    # the kernel's area of the sculpted face is 2 % off; both places of it have changed, and another face
    (told,) = check.faults(before, check.Foreign(4, 1, (10.1, 20.2, 20.2, 30.0)), sculpted_area=20.4)
    assert told.startswith("1 other faces")
    assert "10 mm2" in told


def test_the_gap_of_a_seam_that_opens_is_seen(part):
    """A tube whose two sides are pulled apart, and two strips of which one edge is lifted; neither file names neighbours."""
    seams = part("corpus_seams")
    from cadsculpt.formats.patch_part import PatchPart

    turn = np.linspace(0.0, 2.0 * np.pi, 9)
    net = np.stack(np.broadcast_arrays(np.cos(turn)[:, None], np.sin(turn)[:, None], np.array([0.0, 3.0])), axis=2)
    tube = BSplineSurface(net, np.array([0.0, *range(9), 8.0]), np.array([0.0, 0, 1, 1]), 1, 1)
    opened = net.copy()
    opened[-1, :, 0] += 0.25
    for surface, gap in ((tube, 0.0), (tube.with_control_points(opened), 0.25)):
        whole = PatchPart(Path("tube"), "json", "mm", [surface])
        found = seams.seam_gap(whole, whole.faces.number(1), (True, False))
        assert found.edges >= 1
        assert found.largest == pytest.approx(gap, abs=1e-12)
    x, y = np.meshgrid(np.linspace(0.0, 4.0, 5), [0.0, 1.0, 2.0], indexing="ij")
    knots = np.array([0.0, 0, 0, 0, 1, 2, 2, 2, 2]), np.array([0.0, 0, 0, 1, 1, 1])
    left = BSplineSurface(np.stack([x, y, 0 * x], axis=2), *knots, 3, 2)
    right = BSplineSurface(np.stack([x, y + 2.0, 0 * x], axis=2), *knots, 3, 2)
    lifted = right.control_points.copy()
    lifted[2, 0, 2] = 3e-5  # less than what still counts as one edge
    strips = [PatchPart(Path("strips"), "json", "mm", [left, r]) for r in (right, right.with_control_points(lifted))]
    gaps = [seams.seam_gap(strip, strip.faces.number(1), (False, False)) for strip in strips]
    assert [gap.edges for gap in gaps] == [1, 1]
    assert gaps[0].largest < 1e-12
    assert 1e-5 < gaps[1].largest < 3e-5


def test_totals_say_what_was_not_pressed_or_failed(part):
    good = {
        "sculpted": True, "seam_gap": 0.0, "seam_gap_before": 0.0, "seam_allowed": 1.0, "seam_tolerance": 1.0, "valid": True,
        "valid_before": True, "checked_by": "x", "new_faults": [], "untouched": 3, "untouched_changed": 0, "changed_faces": [],
        "seam_edges": 2, "seam_edges_before": 2, "same_bytes": True, "refit_within": True, "refit_ok": True,
        "refit_strays": False, "export_within": True, "touched": True, "dent_over_tolerance": 20.0, "ball_over_size": 0.02,
        "larger_refused": [], "refit_error": 0.0, "refit_tolerance": 1.0, "export_error": 0.0, "units": "mm",
    }  # fmt: skip
    rows = {
        "good": good,
        "never met": {**good, "touched": False, "dent_over_tolerance": 0.0},
        "other bytes": {**good, "same_bytes": False},
        "off": {**good, "export_within": False, "export_error": 2.0},
        "open": {**good, "seam_gap": 3.0},
        "lost edge": {**good, "seam_edges": 1},
        "worse": {**good, "valid": False, "new_faults": ["face 1: it"]},
        "stopped": {"failed": "the run: unstable"},
        "no place": {"refused": "no room"},
        "nothing": {"skipped": "no spline faces"},
    }
    found = part("corpus_totals").totals([{"file": name, "sculpt": row} for name, row in rows.items()])
    assert (found["sculpt_files"], found["sculpted"]) == (9, 7)
    assert found["sculpt_failed"] == {"stopped": "the run: unstable"}
    assert found["sculpt_refused"] == {"no place": "no room"}
    assert found["sculpt_skipped"] == {"nothing": "no spline faces"}
    assert found["not_touched"] == list(found["shallow_dents"]) == ["never met"]
    assert found["written_twice_exceptions"] == ["other bytes"]
    assert list(found["export_exceptions"]) == ["off"]
    assert list(found["seam_exceptions"]) == ["open"]
    assert list(found["seam_edges_lost"]) == ["lost edge"]
    assert list(found["sculpted_invalid"]) == ["worse"]
    for share in ("written_twice_equal", "export_within_tolerance", "sculpted_valid"):
        assert found[share] == pytest.approx(6 / 7)
