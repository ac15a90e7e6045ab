"""What the single commands print, refuse and write."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from cadsculpt.cli.convert import format_of
from cadsculpt.cli.main import run as cadsculpt
from cadsculpt.cli.run import print_summary, slug
from cadsculpt.errors import InputError
from cadsculpt.formats.demo_parts import DEMOS, PART, SCENE, panel, write_demo

DOCUMENT: dict[str, Any] = {
    "units": "mm",
    "steps": 120,
    "time": 0.5,
    "converged": True,
    "summary": {
        "first_contact": 0.125, "max_depth": 1.5, "max_penetration": 0.0125, "max_force": 12.5,
        "max_contact_area": 99.0, "max_displacement": 4.25, "refit_max_error": 0.001, "refit_rms_error": 0.0001,
    },
    "expectations": [
        {"what": "max_force", "pair": ["panel", "ball"], "expected": {"at_most": 3.0}, "measured": 12.5, "ok": False},
        {"what": "verdict", "expected": {"equals": "contact"}, "measured": "piercing", "ok": True},
        {"what": "first_contact", "expected": {"at_most": 3.0}, "measured": None, "ok": False},
    ],
    "timing": {"total_s": 3.25},
    "warnings": ["something to know"],
}  # fmt: skip


@pytest.fixture
def quick_demo(tmp_path: Path) -> Path:
    """The press of the demo on a coarse lattice, without pictures."""
    path = write_demo(DEMOS["press"], tmp_path)
    text = path.read_text().replace("nodes = 2.5", "nodes = 6.0")
    path.write_text(re.sub(r"pictures = true", "pictures = false", text))
    return path


# ------------------------------------------------------------------------- run


def test_the_summary_names_every_number_and_every_failure(capsys: pytest.CaptureFixture[str]) -> None:
    print_summary(DOCUMENT, Path("press.run"))
    said = capsys.readouterr()
    for text in ("press.run", "t = 0.125 s", "12.5 N", "1.5 mm", "4.25 mm", "0.001 mm", "99 mm2", "3.2"):
        assert text in said.out, text
    lines = {re.sub(r"\s+", " ", line) for line in said.out.splitlines()}
    assert "expected max_force of panel and ball: at most 3 FAILED, measured 12.5" in lines
    assert "expected verdict: equals contact ok" in lines
    assert "expected first_contact: at most 3 FAILED, measured nothing" in lines
    assert said.err == "warning: something to know\n"


def test_a_run_without_contact_says_never(capsys: pytest.CaptureFixture[str]) -> None:
    print_summary({**DOCUMENT, "summary": {**DOCUMENT["summary"], "first_contact": None}}, Path("x"))
    assert re.search(r"first contact\s+never", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ("thumb press", "thumb-press"),
        ("Gehäuse/1", "Gehause-1"),
        ("..", "scene"),
        ("日本", "scene"),
        ("a.b_c-1", "a.b_c-1"),
    ],
)
def test_a_scenes_name_becomes_a_folders(name: str, folder: str) -> None:
    assert slug(name) == folder


def test_run_writes_its_folder_and_prints_the_same_object(
    quick_demo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "out"
    assert cadsculpt(["run", str(quick_demo), "-o", str(folder), "--json", "--quiet"]) == 0
    said = capsys.readouterr()
    document = json.loads(said.out)
    assert document == json.loads((folder / "result.json").read_text())
    assert document["converged"] is True
    assert document["summary"]["first_contact"] > 0
    assert said.err == ""
    assert cadsculpt(["run", str(quick_demo), "-o", str(folder)]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert "--force" in said.err
    assert cadsculpt(["run", str(quick_demo), "-o", str(folder), "--force"]) == 0
    said = capsys.readouterr()
    assert str(folder) in said.out
    assert "running" in said.err
    assert cadsculpt(["report", str(folder)]) == 0
    assert (folder / "report.html").is_file()


def test_an_expectation_that_fails_is_exit_1(quick_demo: Path, tmp_path: Path) -> None:
    quick_demo.write_text(quick_demo.read_text() + '\n[[expect]]\nwhat = "max_force"\nat_most = 1e-6\n')
    assert cadsculpt(["run", str(quick_demo), "-o", str(tmp_path / "out"), "--quiet"]) == 1


def test_a_simulation_that_blows_up_is_exit_3_and_keeps_what_it_has(
    quick_demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from cadsculpt.errors import SimulationError
    from cadsculpt.session import Session

    stepped = Session.step

    def unstable(self: Session, *arguments: Any, **options: Any) -> Any:
        if self.state.step == 5:
            raise SimulationError("the lattice became unstable", where="step 6")
        return stepped(self, *arguments, **options)

    monkeypatch.setattr(Session, "step", unstable)
    folder = tmp_path / "out"
    assert cadsculpt(["run", str(quick_demo), "-o", str(folder), "--quiet", "--json"]) == 3
    said = capsys.readouterr()
    assert json.loads(said.out)["converged"] is False
    assert "error: step 6: the lattice became unstable" in said.err
    assert json.loads((folder / "result.json").read_text())["steps"] == 5


def test_resume_of_nothing_and_resume_with_force(quick_demo: Path, tmp_path: Path) -> None:
    assert cadsculpt(["run", str(quick_demo), "-o", str(tmp_path / "out"), "--resume"]) == 2
    assert cadsculpt(["run", str(quick_demo), "--resume", "--force"]) == 2


def test_all_faults_of_a_scene_come_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.toml").write_text('units = "parsec"\nnonsense = 1\n')
    assert cadsculpt(["run", str(tmp_path / "bad.toml")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) >= 3
    assert all(line.startswith(f"error: {tmp_path / 'bad.toml'}:") for line in lines)


def test_an_interrupt_says_where_the_work_lies(
    quick_demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from cadsculpt.session import Session

    def interrupted(self: Session, *arguments: Any, **options: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(Session, "step", interrupted)
    assert cadsculpt(["run", str(quick_demo), "-o", str(tmp_path / "out"), "--quiet"]) == 130
    said = capsys.readouterr().err
    assert said.startswith("error: interrupted")
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


# --------------------------------------------------------------------- convert


def test_the_format_follows_the_name() -> None:
    for name, format in (
        ("a.step", "step"), ("a.STP", "step"), ("a.igs", "iges"), ("a.iges", "iges"), ("a.3dm", "3dm"),
        ("a.json", "json"), ("a.geomdl.json", "geomdl"), ("a.g2", "g2"), ("a.xml", "gismo"), ("a.stl", "mesh"),
    ):  # fmt: skip
        assert format_of(Path(name)) == format
    with pytest.raises(InputError, match=r"use \.step"):
        format_of(Path("a.dxf"))
    with pytest.raises(InputError, match="no extension"):
        format_of(Path("a"))


@pytest.fixture
def panel_file(tmp_path: Path) -> Path:
    from cadsculpt.formats.patch_json import write_surfaces

    write_surfaces(tmp_path / PART, [panel()], "mm")
    return tmp_path / PART


def test_convert_keeps_the_surface_and_refuses_to_overwrite(
    panel_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import cadsculpt as cs

    rest = panel()
    for name in ("out.json", "out.geomdl.json", "out.step", "out.igs", "out.3dm"):
        target = tmp_path / name
        assert cadsculpt(["convert", str(panel_file), str(target), "--quiet"]) == 0, capsys.readouterr().err
        surface = cs.read(target).faces[0].surface
        assert surface.control_points == pytest.approx(rest.control_points, abs=1e-9), name
        before = target.read_bytes()
        assert cadsculpt(["convert", str(panel_file), str(target)]) == 2
        assert "--force" in capsys.readouterr().err
        assert target.read_bytes() == before
        assert cadsculpt(["convert", str(panel_file), str(target), "--force", "--quiet"]) == 0


def test_convert_to_triangles(panel_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sizes = []
    for tolerance in ("2", "0.1"):
        target = tmp_path / f"t{tolerance}.stl"
        assert cadsculpt(["convert", str(panel_file), str(target), "--tolerance", tolerance, "--quiet"]) == 0
        assert "STL has no length unit: the numbers are in mm" in capsys.readouterr().err
        sizes.append(target.stat().st_size)
    assert sizes[0] < sizes[1]
    assert cadsculpt(["convert", str(panel_file), str(tmp_path / "a.step"), "--tolerance", "1"]) == 2
    assert "--tolerance is for meshes" in capsys.readouterr().err


def test_convert_of_chosen_faces(panel_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import cadsculpt as cs

    name = cs.read(panel_file).faces[0].name
    for face in (name, "1"):
        assert (
            cadsculpt(["convert", str(panel_file), str(tmp_path / f"only-{face}.json"), "--face", face, "--quiet"]) == 0
        )
        assert len(cs.read(tmp_path / f"only-{face}.json").faces) == 1
    assert cadsculpt(["convert", str(panel_file), str(tmp_path / "no.json"), "--face", "nose"]) == 2
    assert "no face named 'nose'" in capsys.readouterr().err
    assert not (tmp_path / "no.json").exists()


# ---------------------------------------------------------------------- others


def test_tools_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert cadsculpt(["tools"]) == 0
    text = capsys.readouterr().out
    assert cadsculpt(["tools", "--json"]) == 0
    tools = json.loads(capsys.readouterr().out)["tools"]
    assert {"ball", "stylus", "thumb"} <= {tool["name"] for tool in tools}
    for tool in tools:
        assert tool["name"] in text
        assert tool["description"] in text


def test_tools_are_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    from cadsculpt.formats import tool_toml

    shipped = {"finger": tool_toml.library()["finger"]}
    monkeypatch.setattr(tool_toml, "library", lambda: shipped)
    assert cadsculpt(["tools", "--pictures", str(tmp_path / "new" / "folder"), "--json"]) == 0
    (tool,) = json.loads(capsys.readouterr().out)["tools"]
    picture = Path(tool["picture"])
    assert picture == tmp_path / "new" / "folder" / "finger.png"
    assert picture.read_bytes()[:4] == b"\x89PNG"
    (tmp_path / "file").touch()
    assert cadsculpt(["tools", "--pictures", str(tmp_path / "file")]) == 2


@pytest.mark.parametrize("what", ["scene", "patches", "result", "tool"])
def test_schemas_are_json_schemas(what: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cadsculpt(["schema", what]) == 0
    assert json.loads(capsys.readouterr().out)["$schema"].startswith("https://json-schema.org/")


def test_demos_are_listed_and_unknown_ones_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cadsculpt(["demo", "--list"]) == 0
    out = capsys.readouterr().out
    assert all(name in out and demo.about in out for name, demo in DEMOS.items())
    assert cadsculpt(["demo", "nonsense", "-o", str(tmp_path / "d")]) == 2
    assert "press" in capsys.readouterr().err
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize("name", list(DEMOS))
def test_a_demos_scene_starts_outside_and_can_be_built(name: str, tmp_path: Path) -> None:
    from cadsculpt.formats.load import load
    from cadsculpt.formats.scene_toml import SceneFile
    from cadsculpt.session import Session

    scene = SceneFile.load(write_demo(DEMOS[name], tmp_path))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([PART, SCENE])
    assert len(Session(load(scene).model).detect().contacts) == 0


def test_report_of_a_folder_that_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cadsculpt(["report", str(tmp_path / "missing")]) == 2
    assert cadsculpt(["report", str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert all(line.startswith(("error: ", "writing")) for line in said.err.splitlines())
