"""`cadsculpt collide`: files, faces and meshes on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cadsculpt.cli.main import run as cadsculpt
from cadsculpt.formats.mesh import write_triangles
from cadsculpt.formats.patch_json import write_surfaces
from cadsculpt.spline.surface import BSplineSurface

PANEL = Path(__file__).parents[2] / "examples" / "thumb_press" / "panel.step"


def plate(path: Path, height: float, name: str = "plate", units: str = "mm") -> Path:
    knots = np.array([0.0, 0, 1, 1])
    X, Y = np.meshgrid([0.0, 20.0], [0.0, 20.0], indexing="ij")
    net = np.stack([X, Y, np.full_like(X, height)], axis=-1)
    write_surfaces(path, [BSplineSurface(net, knots, knots, 1, 1, name=name)], units)
    return path


@pytest.fixture
def plates(tmp_path: Path) -> tuple[str, str]:
    return str(plate(tmp_path / "low.json", 0.0)), str(plate(tmp_path / "high.json", 3.0, "upper"))


def test_two_files_apart_and_nearer_than_the_clearance(plates, capsys):
    assert cadsculpt(["collide", *plates, "--json", "--quiet"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["verdict"], found["kind"], found["contacts"]) == ("clear", "clear", [])
    low, high = found["distance"]
    assert low <= 3.0 <= high
    assert high - low < 1e-4
    assert cadsculpt(["collide", *plates, "--clearance", "3.5", "--json", "--quiet"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert (found["verdict"], found["kind"], found["clearance"]) == ("contact", "clear", 3.5)
    assert found["contacts"][0]["b"]["face"] == "upper"
    assert found["contacts"][0]["depth"] == pytest.approx(-3.0, abs=1e-4)


def test_people_read_a_table(plates, capsys):
    assert cadsculpt(["collide", *plates, "--clearance", "4"]) == 1
    said = capsys.readouterr()
    for word in ("verdict", "contact", "distance", "clearance", "4 mm", "plate (", "upper ("):
        assert word in said.out, word
    assert "reading" in said.err


def test_a_face_of_a_file_by_name_and_by_number(capsys):
    assert cadsculpt(["collide", f"{PANEL}#top", f"{PANEL}#1", "--quiet", "--json"]) in (0, 1)
    json.loads(capsys.readouterr().out)
    assert cadsculpt(["collide", f"{PANEL}#topp", f"{PANEL}#1", "--quiet"]) == 2
    said = capsys.readouterr().err
    assert "topp" in said
    assert "top" in said
    assert said.count("\n") == 1


def test_a_mesh_against_a_part(plates, tmp_path, capsys):
    mesh = tmp_path / "tetra.stl"
    points = np.array([[5.0, 5, 1], [9, 5, 1], [5, 9, 1], [5, 5, 2]])
    write_triangles(mesh, points, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    assert cadsculpt(["collide", plates[0], str(mesh), "--json", "--quiet"]) == 0
    said = capsys.readouterr()
    low, high = json.loads(said.out)["distance"]
    assert low <= 1.0 <= high
    assert high == pytest.approx(1.0, abs=1e-3)
    assert "taken as mm" in said.err
    assert cadsculpt(["collide", plates[1], str(mesh), "--json", "--quiet", "--clearance", "1.2"]) == 1
    low, high = json.loads(capsys.readouterr().out)["distance"]
    assert low <= 1.0 <= high


def test_units_are_those_of_each_file(tmp_path, capsys):
    a, b = plate(tmp_path / "a.json", 0.0), plate(tmp_path / "b.json", 1.0, units="in")
    assert cadsculpt(["collide", str(a), str(b), "--json", "--quiet"]) == 0
    low, high = json.loads(capsys.readouterr().out)["distance"]
    assert low <= 25.4 <= high
    assert cadsculpt(["collide", str(a), str(b), "--units-b", "cm", "--json", "--quiet"]) == 0
    low, high = json.loads(capsys.readouterr().out)["distance"]
    assert low <= 10.0 <= high


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["missing.step", "{0}"], "missing.step"),
        (["{0}", "{0}", "--clearance", "-1"], "clearance"),
        (["{0}", "{0}", "--clearance", "nan"], "clearance"),
        (["{0}"], "B"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(plates, arguments, says, capsys):
    assert cadsculpt(["collide", *(text.format(*plates) for text in arguments)]) == 2
    error = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error")]
    assert len(error) == 1
    assert says in error[0]
