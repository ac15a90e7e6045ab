"""The documentation says what the program does."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cadsculpt.cli.convert import command
from cadsculpt.formats import patch_json, registry
from cadsculpt.scene import (
    ExpectSpec,
    MaterialSpec,
    ModelSpec,
    OutputSpec,
    PartSpec,
    PathRow,
    RefitSpec,
    Scene,
    SolverSpec,
    ToolSpec,
)
from cadsculpt.scene_tool import PathOptions
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    "table",
    [
        Scene,
        ModelSpec,
        MaterialSpec,
        ToolSpec,
        PartSpec,
        PathRow,
        PathOptions,
        SolverSpec,
        RefitSpec,
        OutputSpec,
        ExpectSpec,
    ],
    ids=lambda table: table.__name__,
)
def test_every_key_of_a_scene_is_documented(table):
    text = (ROOT / "docs" / "scene.md").read_text(encoding="utf-8")
    missing = [
        name for name, field in table.model_fields.items() if f"`{field.alias or name}" not in text.replace("[", "`")
    ]
    assert missing == []


def test_every_file_that_the_docs_name_exists():
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        text = page.read_text(encoding="utf-8")
        for target in re.findall(r"\]\(([^)#]+)\)", text):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name} links to {target}"
    for path in re.findall(
        r"`((?:cadsculpt|spline|collide|tools|physics)/[\w/]+\.py)`", (ROOT / "docs/paper.md").read_text()
    ):
        found = ROOT / path if path.startswith("cadsculpt/") else ROOT / "cadsculpt" / path
        assert found.exists(), path


def test_the_python_of_the_readme_runs(monkeypatch):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    section = text.split("## From Python")[1].split("\n## ")[0]
    code = "\n".join(line[4:] for line in section.splitlines() if line.startswith("    "))
    monkeypatch.chdir(ROOT)
    space: dict[str, object] = {}
    exec(code, space)
    assert space["reaction"]["thumb"].force.shape == (3,)  # type: ignore[index]
    assert space["surface"].shape == (8, 6)  # type: ignore[attr-defined]


FORMATS = {
    "STEP": "a.step",
    "IGES": "a.igs",
    "Rhino 3DM": "a.3dm",
    "patch JSON": "a.json",
    "NURBS-Python JSON": "a.geomdl.json",
    "GoTools": "a.g2",
    "G+Smo XML": "a.xml",
}


@pytest.mark.parametrize("name", FORMATS)
def test_what_the_table_of_formats_promises(name, tmp_path):
    """Units, names, trims, weights and orientation, of a bent rational patch and one with a hole that faces down."""
    text = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    (row,) = re.findall(rf"^\| {re.escape(name)} \|.*$", text, re.MULTILINE)
    (head,) = re.findall(r"^\| format \| extensions \|.*$", text, re.MULTILINE)
    columns = [[cell.strip() for cell in line.split("|")] for line in (head, row)]
    wanted = ("units", "names", "trims", "weights", "orientation")
    said = {key: cell for key, cell in zip(*columns, strict=True) if key in wanted}
    assert f"`{'.geomdl.json' if 'geomdl' in FORMATS[name] else Path(FORMATS[name]).suffix}`" in row
    flat, turn = np.array([0.0, 0, 1, 1]), np.array([0.0, 0, 0, 1, 1, 1])
    quarter = np.array([[1.0, 0, 0], [1, 1, 0], [0, 1, 0]])
    bent = BSplineSurface(
        np.stack([quarter, quarter + [0, 0, 2.0]], axis=1), turn, flat, 2, 1, np.array([[1, 1], [0.7, 0.7], [1, 1]]),
        name="bent",
    )  # fmt: skip
    rim, hole = (np.array(p, dtype=float) for p in ([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)],
                                                    [(0.3, 0.3), (0.3, 0.6), (0.6, 0.6), (0.6, 0.3), (0.3, 0.3)]))  # fmt: skip
    loops = (TrimLoop((TrimCurve(p, np.array([0.0, 0, 1, 2, 3, 4, 4]), 1),), p is rim) for p in (rim, hole))
    net = np.array([[[5.0, 0, 0], [5, 1, 0]], [[6, 0, 0], [6, 1, 0]]])
    holed = BSplineSurface(net, flat, flat, 1, 1, outward=False, trims=tuple(loops), name="holed")
    patch_json.write_surfaces(tmp_path / "in.json", [bent, holed], "in")
    assert (
        command.main([str(tmp_path / "in.json"), str(tmp_path / FORMATS[name]), "--quiet"], standalone_mode=False) == 0
    )
    part = registry.read(tmp_path / FORMATS[name])
    one, two = (face.surface for face in part.faces)
    scale = 25.4 if part.units else 1.0
    found = {
        "units": part.units != "",
        "names": [face.name for face in part.faces] == ["bent", "holed"],
        "trims": part.faces[1].area == pytest.approx((1 - 0.09) * scale**2, rel=1e-6),
        "weights": one.rational and one.control_points[1, 0] == pytest.approx(np.array([1, 1, 0]) * scale),
        "orientation": bool(two.normal(0.1, 0.1)[2] < 0.0 < one.normal(0.5, 0.5) @ [1, 1, 0]),
    }
    # (what holds of some surfaces only is for the tests of the table's cells)
    kept = {key: "yes" if value else "no" for key, value in found.items() if said[key] in ("yes", "no")}
    assert kept == {key: cell for key, cell in said.items() if cell in ("yes", "no")}
    assert set(said) == set(wanted)
    assert one.evaluate(0.3, 0.6) == pytest.approx(bent.evaluate(0.3, 0.6) * scale, abs=1e-12 * scale)
