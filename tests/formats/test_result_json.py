"""result.json: the promised keys, exact numbers, and the same bytes twice."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.expect import Expectation
from cadsculpt.formats.result_json import (
    Case,
    FaceFit,
    FileHash,
    Result,
    Timing,
    cases_object,
    hashed,
    read_result,
    result_object,
    result_schema,
    write_result,
)
from cadsculpt.history import Summary
from cadsculpt.seam_fit import ExportedSeam

RESULT = Result(
    scene="thumb press",
    units="mm",
    steps=120,
    time=1.0 / 3.0,
    converged=True,
    summary=Summary(0.1, 2.0 / 3.0, 0.01, 12.5, 33.3, 0.66, 1e-3, 1e-4, 2e-8),
    expectations=(
        Expectation("first_contact", {"between": [0.05, 0.2]}, 0.1, True, ("thumb", "panel")),
        Expectation("verdict", {"never": "piercing"}, "contact", True),
        Expectation("max_depth", {"at_most": 0.5}, 2.0 / 3.0, False),
    ),
    timing=Timing.of_steps([1.0, 2.0, 9.0], compile_s=3.0, total_s=9.5, phases_ms={"cull": 1.5}),
    inputs=(FileHash("panel.step", "0" * 64),),
    outputs=(FileHash("series.pvd", "2" * 64), FileHash("contacts.csv", "1" * 64)),
    seams=(ExportedSeam(("top", "side"), 2e-8, 1e-9, 1e-7, 0.02, 0.01),),
    faces=(FaceFit("top", (19, 15), (8, 6), (36, 26), 1e-3, 1e-4, 1.1e-3, 1e-5, "within"),),
)


def test_the_promised_keys() -> None:
    data = result_object(RESULT)
    promised = [
        "cadsculpt", "scene", "units", "steps", "time", "converged", "summary", "expectations", "timing", "inputs",
        "outputs",
    ]  # fmt: skip
    assert list(data)[: len(promised)] == promised
    assert list(data["summary"]) == [
        "first_contact", "max_depth", "max_penetration", "max_force", "max_contact_area", "max_displacement",
        "refit_max_error", "refit_rms_error", "seam_max_gap",
    ]  # fmt: skip
    assert {"what", "expected", "measured", "ok"} <= set(data["expectations"][0])
    assert list(data["timing"]) == ["compile_s", "total_s", "step_ms", "phases_ms"]
    assert {"median": 2.0, "max": 9.0}.items() <= data["timing"]["step_ms"].items()
    assert data["timing"]["step_ms"]["p99"] == pytest.approx(np.percentile([1.0, 2.0, 9.0], 99))
    assert [entry["file"] for entry in data["outputs"]] == ["contacts.csv", "series.pvd"]


def test_it_comes_back_as_it_was(tmp_path: Path) -> None:
    write_result(tmp_path / "result.json", RESULT)
    back = read_result(tmp_path / "result.json")
    assert replace(back, outputs=(), inputs=()) == replace(RESULT, outputs=(), inputs=())
    assert set(back.outputs) == set(RESULT.outputs)


def test_everything_but_timing_is_the_same_in_two_runs(tmp_path: Path) -> None:
    other = replace(RESULT, timing=Timing.of_steps([7.0]), outputs=RESULT.outputs[::-1])
    write_result(tmp_path / "a.json", RESULT)
    write_result(tmp_path / "b.json", other)
    a, b = (json.loads((tmp_path / name).read_text()) for name in ("a.json", "b.json"))
    assert a.pop("timing") != b.pop("timing")
    assert json.dumps(a) == json.dumps(b)
    write_result(tmp_path / "c.json", RESULT)
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "c.json").read_bytes()


def test_numbers_that_json_has_no_word_for() -> None:
    result = replace(
        RESULT,
        summary=replace(RESULT.summary, first_contact=float("nan"), max_force=float("inf"), max_depth=np.float64(0.5)),
        expectations=(Expectation("max_force", {"at_most": np.float64(1.0)}, float("nan"), np.bool_(False)),),  # type: ignore[arg-type]
    )
    data = json.loads(json.dumps(result_object(result), allow_nan=False))
    assert data["summary"]["first_contact"] is None
    assert data["summary"]["max_force"] is None
    assert data["summary"]["max_depth"] == 0.5
    assert data["expectations"][0] == {"what": "max_force", "expected": {"at_most": 1.0}, "measured": None, "ok": False}


def test_long_runs_keep_their_slowest_steps() -> None:
    steps = np.full(100_000, 1.0)
    steps[77_777] = 50.0
    timing = Timing.of_steps(steps)
    assert len(timing.each) <= 2000
    assert max(timing.each) == timing.max == 50.0
    assert Timing.of_steps([]).median is None


def test_the_schema_names_what_is_written() -> None:
    schema, data = result_schema(), result_object(RESULT)
    assert set(schema["properties"]) == set(data)
    assert set(schema["required"]) <= set(data)
    assert set(schema["properties"]["summary"]["properties"]) == set(data["summary"])
    assert set(schema["properties"]["faces"]["items"]["properties"]) == set(data["faces"][0])
    assert set(schema["properties"]["seams"]["items"]["properties"]) == set(data["seams"][0])
    assert set(schema["properties"]["timing"]["properties"]) == set(data["timing"])
    json.dumps(schema)


def test_hashes(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "f.vtp").write_bytes(b"abc")
    (tmp_path / "a.csv").write_bytes(b"")
    (tmp_path / "report.html").write_text("has the timings")
    files = hashed(tmp_path, [tmp_path / "frames" / "f.vtp", "a.csv", "report.html", "a.csv"])
    assert files == (
        FileHash("a.csv", hashlib.sha256(b"").hexdigest()),
        FileHash("frames/f.vtp", hashlib.sha256(b"abc").hexdigest()),
    )
    with pytest.raises(InputError):
        hashed(tmp_path, ["none.csv"])


def test_the_object_of_a_check() -> None:
    cases = [
        Case("a.toml", "a", "passed", RESULT.expectations[:1]),
        Case("b.toml", "b", "failed", RESULT.expectations),
        Case("c.toml", "c", "error", message="c.toml: no such face"),
    ]
    data = cases_object(cases)
    assert (data["passed"], data["failed"], data["errors"]) == (1, 1, 1)
    assert [case["outcome"] for case in data["cases"]] == ["passed", "failed", "error"]
    assert data["cases"][2]["message"] == "c.toml: no such face"
    assert len(data["cases"][1]["expectations"]) == 3


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"scene": "a"}', "\x00"])
def test_results_that_are_none(tmp_path: Path, text: str) -> None:
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(InputError, match="not a result"):
        read_result(tmp_path / "result.json")
    with pytest.raises(InputError, match="cannot be read"):
        read_result(tmp_path / "none.json")
