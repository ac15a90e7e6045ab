"""Tool definitions: the shipped ones, units that come over right, overrides, and faults at their lines."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadsculpt.errors import SceneError
from cadsculpt.formats import patch_json, registry, tool_toml
from cadsculpt.scene import ToolSpec


def test_the_shipped_tools_are_all_there_and_right() -> None:
    names = set(tool_toml.library())
    assert {"ball", "stylus", "thumb", "finger", "hand", "palm", "roller", "punch", "scraper", "half_space"} <= names
    for name in names:
        definition = tool_toml.load(name, Path("nowhere"))
        assert definition.shipped
        assert definition.name == name
        assert definition.description
        for units in ("mm", "m", "in"):
            ToolSpec.model_validate(definition.keys_in(units))


@pytest.mark.parametrize("name", ["finger", "hand"])
def test_the_shipped_surfaces_are_what_their_script_makes(name: str, tmp_path: Path) -> None:
    """Closed, outward, and to the last digit; the hand is a palm and five fingers."""
    script = tool_toml.LIBRARY / "make_tools.py"
    spec = importlib.util.spec_from_file_location("make_tools", script)
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    surfaces = [made.finger("finger", 40.0, 16.0, 14.0, 2.4)] if name == "finger" else made.hand()
    patch_json.write_surfaces(tmp_path / "again.json", surfaces, "mm")
    kept = tool_toml.LIBRARY / f"{name}.json"
    faces, again = registry.read(kept).faces, registry.read(tmp_path / "again.json").faces
    assert [face.name for face in faces] == [face.name for face in again]
    assert [face.name for face in faces] == (
        ["finger"] if name == "finger" else ["palm", "index", "middle", "ring", "little", "thumb"]
    )
    for face, other in zip(faces, again, strict=True):
        np.testing.assert_allclose(face.surface.control_points, other.surface.control_points, atol=1e-9)
        surface = face.surface
        u, v = np.linspace(0, 1, 65)[:, None], np.linspace(0.01, 0.99, 65)
        points, normals = surface.evaluate(u, v), surface.normal(u, v)
        # around and at both poles it is closed, and its normals point away from the middle
        assert np.abs(points[0] - points[-1]).max() < 1e-9
        middle = points.mean(axis=(0, 1))
        assert (np.einsum("ijk,ijk->ij", points - middle, normals) > 0).mean() > 0.97
        for end in (0.0, 1.0):
            pole = surface.evaluate(np.linspace(0, 1, 9), end)
            assert np.abs(pole - pole[0]).max() < 1e-9


def definition(folder: Path, text: str, name: str = "my.tool.toml") -> tool_toml.ToolDefinition:
    (folder / name).write_text(text)
    return tool_toml.load(f"./{name}", folder)


def test_lengths_come_over_in_the_scenes_unit(tmp_path: Path) -> None:
    text = 'units = "in"\nshape = "superquadric"\nradii = [1, 2, 3]\nexponents = [0.5, 1]\n'
    keys = definition(tmp_path, text).keys_in("mm")
    assert keys["radii"] == [25.4, 50.8, pytest.approx(76.2)]
    assert keys["exponents"] == [0.5, 1]
    assert keys["name"] == "my"
    assert definition(tmp_path, 'shape = "point"\narea = 2').keys_in("cm")["area"] == pytest.approx(0.02)
    (tmp_path / "finger.step").touch()
    text = 'shape = "surface"\nfile = "finger.step"\nmaterial = "foam"\nthickness = 2\nnodes = '
    assert definition(tmp_path, text + "4").keys_in("cm")["nodes"] == pytest.approx(0.4)
    assert definition(tmp_path, text + "[4, 5]").keys_in("cm")["nodes"] == [4, 5]
    assert definition(tmp_path, text + "4").keys_in("cm")["thickness"] == pytest.approx(0.2)


def test_nothing_changes_where_units_are_the_same(tmp_path: Path) -> None:
    keys = definition(tmp_path, 'units = "mm"\nshape = "sphere"\nradius = 0.1').keys_in("mm")
    assert keys["radius"] == 0.1


def test_a_formula_means_the_same_body_in_another_unit(tmp_path: Path) -> None:
    text = 'units = "in"\nshape = "formula"\nexpression = "max(sqrt(x*x + y*y) - 1, exp(z) - 2)"\n'
    keys = definition(tmp_path, text + "box = [[-1, -1, -1], [1, 1, 1]]").keys_in("mm")
    assert keys["box"] == [[-25.4] * 3, [25.4] * 3]

    def field(expression: str, x: float, y: float, z: float) -> float:
        return float(eval(expression, {"x": x, "y": y, "z": z, "sqrt": math.sqrt, "exp": math.exp, "max": max}))

    for point in ((0.0, 0.5, 0.1), (2.0, 1.0, -3.0), (0.1, 0.1, 1.0)):
        inches = field("max(sqrt(x*x + y*y) - 1, exp(z) - 2)", *point)
        x, y, z = (25.4 * c for c in point)
        assert field(keys["expression"], x, y, z) == pytest.approx(25.4 * inches)


def test_parts_come_over_in_the_scenes_unit_all_the_way_down(tmp_path: Path) -> None:
    text = (
        'units = "in"\nshape = "union"\n[[part]]\nshape = "sphere"\nradius = 1\nat = [1, 2, 3]\n'
        '[[part]]\nshape = "difference"\n[[part.part]]\nshape = "half_space"\n'
        '[[part.part]]\nshape = "formula"\nexpression = "x - 1"\nbox = [[0, 0, 0], [2, 2, 2]]\nturn = [0, 0, 1, 90]\n'
    )
    keys = definition(tmp_path, text).keys_in("mm")
    ball, rest = keys["part"]
    assert (ball["radius"], ball["at"]) == (25.4, pytest.approx([25.4, 50.8, 76.2]))
    formula = rest["part"][1]
    assert formula["box"][1] == [50.8] * 3
    assert formula["turn"] == [0, 0, 1, 90]
    assert eval(formula["expression"], {"x": 25.4 * 3}) == pytest.approx(25.4 * 2)
    ToolSpec.model_validate(keys)


def test_files_are_seen_from_the_definition(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "bone.stl").touch()
    made = definition(tmp_path, 'units = "in"\nshape = "mesh"\nfile = "bone.stl"', "sub/bone.tool.toml")
    assert Path(made.keys_in("mm")["file"]) == tmp_path / "sub" / "bone.stl"
    assert made.keys_in("mm")["file_units"] == "in"


def test_the_scene_overrides(tmp_path: Path) -> None:
    punch = tool_toml.load("punch", tmp_path)
    assert punch.merged({"use": "punch", "radius": 7}, "mm")["radius"] == 7
    assert punch.merged({"use": "punch", "radius": 7}, "m")["height"] == pytest.approx(0.04)
    another: dict[str, Any] = punch.merged({"use": "punch", "shape": "sphere", "radius": 1}, "mm")
    assert another == {"use": "punch", "name": "punch", "shape": "sphere", "radius": 1}


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ('shape = "spere"\n', 1, 'shape "spere" is not known (did you mean sphere?)'),
        ('shape = "sphere"\n\nradius = -1\n', 3, "radius must be above 0, not -1"),
        ('shape = "sphere"\nradius = nan\n', 2, "radius must be a finite number, not nan"),
        ('shape = "sphere"\n', 1, "radius is missing"),
        ('shape = "point"\nunits = "mn"\n', 2, 'units "mn" is not known'),
        ('shape = "point"\nunit = "mm"\n', 2, "unknown key unit (did you mean units?)"),
        ('shape = "point"\npath = "a.csv"\n', 2, "path does not belong to a tool's definition"),
        ('shape = "point"\n[[path]]\nt = 0\nat = [0, 0, 0]\n', 2, "path does not belong to a tool's definition"),
        ('use = "ball"\nshape = "point"\n', 1, "use does not belong to a tool's definition"),
        ('shape = "mesh"\nfile = "none.stl"\n', 2, 'file "none.stl" is not there'),
        ('shape = "point"\nshape = "point"\n', 2, "not TOML: a key or table is given twice"),
    ],
)
def test_faults_are_told_at_their_lines(tmp_path: Path, text: str, line: int, words: str) -> None:
    with pytest.raises(SceneError) as caught:
        definition(tmp_path, text)
    (fault,) = caught.value.faults
    assert fault.startswith(f"{tmp_path / 'my.tool.toml'}:{line}: ")
    assert words in fault


def test_a_tool_that_is_not_there() -> None:
    with pytest.raises(SceneError, match=r'use "thum" is no shipped tool \(did you mean thumb\?\)'):
        tool_toml.load("thum", Path())
    with pytest.raises(SceneError, match=r'use "my/x.tool.toml" names no file'):
        tool_toml.load("my/x.tool.toml", Path())
    assert tool_toml.load("Half-Space", Path()).name == "half_space"
