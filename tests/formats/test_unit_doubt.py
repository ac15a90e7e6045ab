"""Which length units are doubted, and what is said: by size, by tolerance, by the area that the file records."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("OCP")

from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox

from cadsculpt.cli.main import run as cadsculpt
from cadsculpt.formats import patch_json, registry
from cadsculpt.formats.load import load
from cadsculpt.formats.occt.part import document_of_shapes
from cadsculpt.formats.scene_toml import SceneFile
from cadsculpt.formats.unit_doubt import LARGEST, SMALLEST, likely_unit, unit_doubt
from cadsculpt.spline.surface import BSplineSurface
from cadsculpt.units import METRES_PER_UNIT, conversion


@given(st.floats(SMALLEST, LARGEST), st.sampled_from(sorted(METRES_PER_UNIT)))
def test_parts_of_usual_size_are_not_doubted(size, units):
    assert unit_doubt(size, units) == ""


@given(st.floats(1e-6, 1e9), st.sampled_from(sorted(METRES_PER_UNIT)))
def test_the_likely_unit_makes_a_usual_part(number, units):
    guess = likely_unit(number, units)
    assert guess != units
    if guess:
        assert 20.0 <= number * conversion(guess, "mm") <= 3000.0


@pytest.mark.parametrize(
    ("size", "units", "guess"),
    [
        (5.0, "mm", "in"),
        (0.127, "mm", "m"),
        (13_000.0, "mm", "mil"),
        (38_900.0, "mm", "um"),
        (127_000.0, "m", "mm"),
        (127.0 * 25.4, "in", ""),
    ],
)
def test_sizes_that_are_wrong(size, units, guess):
    said = unit_doubt(size, units)
    assert (f"likely in {guess}:" in said and f"--units {guess} " in said) if guess else said == ""


def test_the_files_tolerance_decides_between_units_that_fit():
    assert likely_unit(40_000.0, "mm") == "um"
    assert likely_unit(40_000.0, "mm", 5e-4) == "mil"  # 5e-7 mm would be no tolerance


def test_a_recorded_area_tells_the_unit():
    assert "likely in" in (said := unit_doubt(127.0, "mm", None, (9.0546, 9.0546 * 645.16)))
    assert "are likely in;" in said
    assert unit_doubt(127.0, "mm", None, (100.0, 100.5)) == ""
    assert unit_doubt(127.0, "mm", None, (100.0, 170.0)) == ""


def small_box(path: Path) -> Path:
    """A box of 5 x 2 x 1 that says mm."""
    document_of_shapes([("box", BRepPrimAPI_MakeBox(5, 2, 1).Shape())]).write(path, "step")
    return path


def test_inspect_and_convert_say_it_and_units_silences_it(tmp_path, capsys):
    path = small_box(tmp_path / "a.step")
    assert cadsculpt(["inspect", str(path), "--quiet"]) == 0
    assert "they are likely in in: --units in" in capsys.readouterr().err
    assert cadsculpt(["convert", str(path), str(tmp_path / "b.igs"), "--quiet"]) == 0
    assert "likely" in capsys.readouterr().err
    assert cadsculpt(["inspect", str(path), "--quiet", "--units", "in"]) == 0
    captured = capsys.readouterr()
    assert "likely" not in captured.err
    assert "127" in captured.out


SCENE = """
units = "mm"
[[model]]
name = "box"
file = "a.step"
{units}
faces = [6]
thickness = {thickness}
nodes = [9, 9]
material = "clay"
[[tool]]
name = "ball"
shape = "sphere"
radius = 1.0
path = [{{ t = 0.0, at = [0, 0, 200] }}, {{ t = 0.01, at = [0, 0, 190] }}]
"""


def test_a_scene_can_say_the_files_unit(tmp_path):
    small_box(tmp_path / "a.step")
    found = []
    for units, thickness in (("", 0.1), ('file_units = "in"', 2.0)):
        (tmp_path / "s.toml").write_text(SCENE.format(units=units, thickness=thickness))
        loaded = load(SceneFile.load(tmp_path / "s.toml"))
        found.append(
            (loaded.model.patches[0].surface.control_points.max(), any("likely" in w for w in loaded.warnings))
        )
    assert found == [(pytest.approx(5.0), True), (pytest.approx(127.0), False)]


def test_units_that_a_user_wrote_are_not_doubted(tmp_path):
    net = np.array([[[0.0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]])
    knots = np.array([0.0, 0, 1, 1])
    patch_json.write_surfaces(tmp_path / "a.json", [BSplineSurface(net, knots, knots, 1, 1)], "mm")
    assert registry.read(tmp_path / "a.json").warnings == []


@pytest.mark.corpus
@pytest.mark.parametrize(
    ("name", "guess"),
    [
        ("step/trj4_k1_geo-ac-214.stp", "in"), ("step/trj5_k1-sh-203.stp", "in"), ("step/trj6_k1-ec-214.stp", "in"),
        ("iges/hammer.iges", "um"), ("step/trj5_k1-al-214.stp", ""), ("step/trj8_k1-pe-214.stp", ""),
        ("step/trj8_k1-hc-214.stp", ""),
    ],
)  # fmt: skip
def test_real_files_with_wrong_labels(name, guess, corpus):
    said = [line for line in registry.read(corpus / name).warnings if "likely" in line]
    assert (len(said) == 1 and f"likely in {guess}:" in said[0]) if guess else said == []
