"""The documentation says what the program does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

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

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    "table",
    [Scene, ModelSpec, MaterialSpec, ToolSpec, PartSpec, PathRow, SolverSpec, RefitSpec, OutputSpec, ExpectSpec],
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
        r"`((?:cadsculpt|spline|collide|tools|physics)/\w+\.py)`", (ROOT / "docs/paper.md").read_text()
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
