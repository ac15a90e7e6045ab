"""The wheel holds what the tree holds, and importing costs nothing."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MAPPED = {"cadsculpt": "cadsculpt", "cli": "cadsculpt/cli", "formats": "cadsculpt/formats"}


def source_files() -> set[str]:
    """Names in the wheel of every source and data file of the tree."""
    names = set()
    for folder, inside in MAPPED.items():
        for path in (ROOT / folder).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".pyc":
                names.add(f"{inside}/{path.relative_to(ROOT / folder).as_posix()}")
    return names


def test_the_wheel_holds_every_file(tmp_path):
    build = pytest.importorskip("build", reason="the wheel's content was not compared: `build` is not installed")
    del build
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--outdir", str(tmp_path), str(ROOT)],
        check=True,
        capture_output=True,
    )
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        inside = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert source_files() - inside == set(), "missing from the wheel: name the package or its data in pyproject.toml"
    assert inside - source_files() == set(), "in the wheel but not in the tree"


def loaded_by(code: str) -> set[str]:
    output = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print(' '.join(sys.modules))"],
        check=True,
        capture_output=True,
        text=True,
        cwd="/",
    ).stdout
    return set(output.split())


def test_importing_cadsculpt_loads_nothing_heavy():
    heavy = {"numpy", "scipy", "numba", "OCP", "rhino3dm", "pyvista", "vtkmodules", "pydantic", "click"}
    assert heavy & loaded_by("import cadsculpt") == set()


def test_every_public_name_is_there():
    code = "import cadsculpt; [getattr(cadsculpt, name) for name in cadsculpt.__all__]"
    assert "cadsculpt.session" in loaded_by(code)
