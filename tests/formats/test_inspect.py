"""`inspect`: the promised object, and that one bad face does not hide the others."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadsculpt.cli.main import run as cadsculpt
from cadsculpt.errors import GeometryError
from cadsculpt.formats.demo_parts import PART, panel
from cadsculpt.formats.inspect import inspect_object
from cadsculpt.formats.part import Face, FaceEdge, Faces
from cadsculpt.spline.surface import BSplineSurface

KEYS = {"name", "number", "kind", "degree", "control_points", "rational", "closed", "trimmed", "area", "bbox"}


class Plate(Face):
    """A flat face of 10 mm x 20 mm at height z, or one without a surface, an area or a size."""

    kind = "plane"
    trimmed = False

    def __init__(self, number: int, z: float, broken: bool = False) -> None:
        self.number, self.name, self.z, self.broken = number, f"plate {number}", z, broken

    @property
    def surface(self) -> BSplineSurface:
        if self.broken:
            raise GeometryError("the surface is torn", where=self.name)
        x, y = np.meshgrid([0.0, 10.0], [0.0, 20.0], indexing="ij")
        knots = np.array([0.0, 0.0, 1.0, 1.0])
        return BSplineSurface(np.stack([x, y, np.full_like(x, self.z)], axis=2), knots, knots, 1, 1)

    @property
    def area(self) -> float:
        return float("nan") if self.broken else 200.0

    @property
    def bbox(self) -> tuple[float, float, float, float, float, float]:
        return (0.0, 0.0, self.z, 10.0, 20.0, 1e100) if self.broken else (0.0, 0.0, self.z, 10.0, 20.0, self.z)

    @property
    def edges(self) -> Sequence[FaceEdge]:
        return ()


class Plates:
    """As much of a part as `inspect` looks at."""

    format, units, instances = "step", "in", ()

    def __init__(self, faces: list[Plate]) -> None:
        self.faces, self.warnings = Faces(faces, "plates.step"), ["the file says so"]


def look(faces: list[Plate]) -> dict[str, Any]:
    return json.loads(json.dumps(inspect_object(Plates(faces)), allow_nan=False))  # type: ignore[arg-type]


def test_the_object_is_as_promised() -> None:
    found = look([Plate(1, 0.0), Plate(2, 5.0)])
    assert set(found) == {"format", "units", "faces", "area", "bbox", "warnings"}
    assert (found["format"], found["units"], found["area"]) == ("step", "in", 400.0)
    assert found["bbox"] == [0.0, 0.0, 0.0, 10.0, 20.0, 5.0]
    assert found["warnings"] == ["the file says so"]
    assert [set(face) for face in found["faces"]] == [KEYS, KEYS]
    first = found["faces"][0]
    assert first["degree"] == [1, 1]
    assert first["control_points"] == [2, 2]
    assert (first["closed"], first["rational"], first["trimmed"]) == ([False, False], False, False)


def test_a_face_that_cannot_be_read_does_not_stop_the_rest() -> None:
    found = look([Plate(1, 0.0), Plate(2, 5.0, broken=True), Plate(3, 7.0)])
    torn = found["faces"][1]
    assert torn["degree"] is None
    assert torn["area"] is None
    assert torn["bbox"] is None
    assert found["area"] == 400.0
    assert found["bbox"] == [0.0, 0.0, 0.0, 10.0, 20.0, 7.0]
    assert sum("plate 2" in line for line in found["warnings"]) == 3
    assert any("the surface is torn" in line for line in found["warnings"])


def test_a_file_without_faces() -> None:
    found = look([])
    assert (found["faces"], found["area"], found["bbox"]) == ([], 0.0, None)


@pytest.fixture
def panel_file(tmp_path: Path) -> Path:
    from cadsculpt.formats.patch_json import write_surfaces

    write_surfaces(tmp_path / PART, [panel()], "mm")
    return tmp_path / PART


def test_inspect_on_the_command_line(panel_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cadsculpt(["inspect", str(panel_file), "--json"]) == 0
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert found["faces"][0]["control_points"] == [10, 8]
    # area of a graph over a rectangle, by the trapezoidal rule
    u, v = np.linspace(0.0, 120.0, 801), np.linspace(0.0, 80.0, 801)
    d = panel().derivatives(u[:, None], v, 1)
    area = np.trapezoid(np.trapezoid(np.linalg.norm(np.cross(d[1, 0], d[0, 1]), axis=2), v, axis=1), u)
    assert found["area"] == pytest.approx(area, rel=1e-5)
    assert cadsculpt(["inspect", str(panel_file)]) == 0
    said = capsys.readouterr()
    assert "10 x 8" in said.out
    assert "number" in said.out


def test_inspect_of_a_missing_file_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("missing.step", "missing.igs", "missing.3dm", "missing.json"):
        assert cadsculpt(["inspect", str(tmp_path / name), "--json", "--quiet"]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith("error: ")
        assert said.err.count("\n") == 1
        assert name in said.err


def test_inspect_of_a_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from cadsculpt.formats.mesh import write_triangles

    corners = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    write_triangles(tmp_path / "a.stl", corners, triangles)
    assert cadsculpt(["inspect", str(tmp_path / "a.stl"), "--json", "--quiet", "--units", "in"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"format", "units", "faces", "area", "bbox", "warnings"} < set(found)
    assert (found["format"], found["units"], found["faces"]) == ("stl", "in", [])
    assert (found["vertices"], found["triangles"], found["shells"]) == (4, 4, 1)
    assert (found["closed"], found["open_edges"], found["warnings"]) == (True, 0, [])
    assert found["volume"] == pytest.approx(25.4**3)
    assert found["area"] == pytest.approx((3.0 + 1.0 + 1.5 + 3.5) * 25.4**2)
    assert found["bbox"] == pytest.approx([0, 0, 0, 76.2, 50.8, 25.4])
    write_triangles(tmp_path / "b.obj", corners, triangles[1:])
    assert cadsculpt(["inspect", str(tmp_path / "b.obj"), "--json", "--quiet"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["closed"], found["open_edges"], found["volume"], found["units"]) == (False, 3, None, None)
    assert any("3 open edges" in line for line in found["warnings"])
    assert any("taken as mm" in line for line in found["warnings"])
    assert cadsculpt(["inspect", str(tmp_path / "b.obj")]) == 0
    assert "no, 3 open edges" in capsys.readouterr().out
    (tmp_path / "c.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 3\n")
    assert cadsculpt(["inspect", str(tmp_path / "c.ply"), "--quiet"]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)


@pytest.mark.corpus
@pytest.mark.parametrize(("name", "unit"), [("cube-mm.step", "mm"), ("cube-m.step", "m")])
def test_lengths_are_mm_whatever_the_files_unit(
    corpus: Path, name: str, unit: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cadsculpt(["inspect", str(corpus / "step" / name), "--json", "--quiet"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["units"] == unit
    assert len(found["faces"]) == 6
    assert found["area"] == pytest.approx(6.0e6, rel=1e-9)  # a cube with edges of 1 m
    size = np.ptp(np.array(found["bbox"]).reshape(2, 3), axis=0)
    assert size == pytest.approx([1000.0] * 3, rel=1e-9)
