"""Cases: which files are cases, which are passed over, and that one bad case does not stop the others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cadsculpt.cli.main import run as cadsculpt
from cadsculpt.errors import InputError
from cadsculpt.formats.cases import CaseFile, collect, run_case
from cadsculpt.formats.demo_parts import DEMOS, write_demo

EXPECTING = 'name = "{name}"\nunits = "mm"\n[[model]]\n[[expect]]\nwhat = "verdict"\nequals = "contact"\n'
SCENE = 'units = "mm"\n[[model]]\n'


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A folder with two cases, a scene that expects nothing, a broken file, and others that are no cases."""
    files = {
        "a.toml": EXPECTING.format(name="Thumb press"),
        "deeper/b.toml": EXPECTING.format(name="other"),
        "deeper/plain.toml": SCENE,
        "broken.toml": "units = \n",
        "thumb.tool.toml": 'shape = "sphere"\nradius = 1.0\n',
        "pyproject.toml": "[project]\n",
        ".hidden/c.toml": EXPECTING.format(name="hidden"),
        "notes.txt": "expect",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def names(cases: tuple[CaseFile, ...], root: Path) -> list[str]:
    return [case.path.relative_to(root).as_posix() for case in cases]


def test_a_folder_gives_its_cases_and_says_what_it_passes_over(tree: Path) -> None:
    found = collect([tree])
    assert names(found.cases, tree) == ["a.toml", "broken.toml", "deeper/b.toml"]
    assert [case.name for case in found.cases] == ["Thumb press", "broken", "other"]
    assert "broken.toml:1" in found.cases[1].fault
    assert [(path.name, reason) for path, reason in found.skipped] == [("plain.toml", "it expects nothing")]


def test_a_named_file_must_be_a_case(tree: Path) -> None:
    found = collect([tree / "deeper" / "plain.toml", tree / "a.toml"])
    assert "expects nothing" in found.cases[0].fault
    assert run_case(found.cases[0]).outcome == "error"
    assert found.cases[1].fault == ""


def test_a_file_named_twice_runs_once(tree: Path) -> None:
    assert names(collect([tree / "a.toml", tree, tree / "deeper" / ".." / "a.toml"]).cases, tree) == [
        "a.toml", "broken.toml", "deeper/b.toml",
    ]  # fmt: skip


def test_select_looks_at_file_and_scene_names(tree: Path) -> None:
    assert names(collect([tree], "THUMB").cases, tree) == ["a.toml"]
    assert names(collect([tree], "b.toml").cases, tree) == ["deeper/b.toml"]
    with pytest.raises(InputError, match="no case found that has 'nothing like this'"):
        collect([tree], "nothing like this")


def test_a_missing_path_and_an_empty_folder_are_errors(tree: Path) -> None:
    with pytest.raises(InputError, match="no such file or folder"):
        collect([tree, tree / "missing"])
    (tree / "empty").mkdir()
    with pytest.raises(InputError, match="no case found"):
        collect([tree / "empty"])


def test_a_case_with_bad_input_is_an_error_and_names_every_fault(tree: Path) -> None:
    case = run_case(collect([tree / "a.toml"]).cases[0])
    assert (case.outcome, case.name) == ("error", "Thumb press")
    assert "name is missing" in case.message
    assert len(case.message.splitlines()) > 1


@pytest.fixture
def demo_cases(tmp_path: Path) -> Path:
    """The press of the demo three times: as it is, with an expectation that cannot hold, and without its part."""
    for name in ("good", "wrong", "broken"):
        (tmp_path / name).mkdir()
        path = write_demo(DEMOS["press"], tmp_path / name)
        text = path.read_text()
        # coarser, so that the test is quick
        text = text.replace("nodes = 2.5", "nodes = 6.0")
        if name == "wrong":
            text += '\n[[expect]]\nwhat = "max_force"\npair = ["panel", "ball"]\nat_most = 1e-6\n'
        if name == "broken":
            text = text.replace('"panel.json"', '"missing.json"')
        path.write_text(text)
    return tmp_path


def test_check_runs_all_cases_and_says_what_was_measured(
    demo_cases: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / "report.xml"
    assert cadsculpt(["check", str(demo_cases), "--quiet", "--junit", str(report)]) == 1
    out = capsys.readouterr().out
    assert out.splitlines()[-1] == "1 passed, 1 failed, 1 errors"
    assert "max_force of panel and ball: measured" in out
    assert "expected at most 1e-06" in out
    assert 'file "missing.json" is not there' in out
    text = report.read_text()
    assert text.count("<testcase") == 3
    assert text.count("<failure") == 1
    assert text.count("<error") == 1


def test_check_json_is_as_promised(demo_cases: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cadsculpt(["check", str(demo_cases / "wrong"), str(demo_cases / "broken"), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert (found["passed"], found["failed"], found["errors"]) == (0, 1, 1)
    wrong, broken = found["cases"]
    assert set(wrong) >= {"file", "name", "outcome", "expectations"}
    assert (wrong["outcome"], broken["outcome"]) == ("failed", "error")
    failed = [entry for entry in wrong["expectations"] if not entry["ok"]]
    assert [entry["what"] for entry in failed] == ["max_force"]
    assert failed[0]["expected"] == {"at_most": 1e-6}
    assert failed[0]["measured"] > 1e-6
    assert broken["expectations"] == []


def test_check_leaves_nothing_behind(demo_cases: Path) -> None:
    before = sorted(demo_cases.rglob("*"))
    assert cadsculpt(["check", str(demo_cases / "good"), "--quiet"]) == 0
    assert sorted(demo_cases.rglob("*")) == before


def test_check_of_nothing_is_bad_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cadsculpt(["check", str(tmp_path)]) == 2
    assert cadsculpt(["check", str(tmp_path / "missing")]) == 2
    assert capsys.readouterr().out == ""
