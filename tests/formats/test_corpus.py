"""Every real CAD file: read without a crash, faces and area as an independent reading has them, or a warning that says why."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

QUICK = {
    "iges/BUC50025.igs", "iges/PRO20359-L1.igs", "iges/c172.igs", "iges/bug22566_test_Bad.igs", "iges/cube_10x10mm.igs",
    "rhino/v1_Terrain.3dm", "rhino/v2_Terrain.3dm", "rhino/v5_extrusions.3dm", "rhino/v7_my_trimmed_surface.3dm",
    "step/as1_pe_203.stp", "step/bug32314_corrupted.stp", "step/cube-m.step", "step/trj6_c1-id-214.stp",
    "step/trj7_c2-al-214.stp", "step/trj7_c2-db-214.stp", "step/trj8_c2-db-214.stp",
}  # fmt: skip


def rows(corpus: Path) -> dict[str, tuple[int | None, float | None]]:
    """File -> faces and area (mm2) of the index's reading; for 3DM files the number of surfaces, no area."""
    found: dict[str, tuple[int | None, float | None]] = {}
    for line in (corpus / "INDEX.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) < 6 or not re.match(r"(step|iges|rhino)/", cells[1]):
            continue
        reading = re.match(r"(\d+); ([0-9.eE+-]+);", cells[5])
        surfaces = re.match(r"(\d+) surfaces", cells[4])
        if reading:
            found[cells[1]] = int(reading[1]), float(reading[2])
        elif surfaces:
            found[cells[1]] = int(surfaces[1]), None
    return found


def check(corpus: Path, name: str) -> None:
    faces, area = rows(corpus)[name]
    done = subprocess.run(
        [sys.executable, "-m", "cadsculpt", "inspect", "--json", str(corpus / name)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        cwd="/",
    )
    assert done.returncode in (0, 2), done.stderr
    if done.returncode == 2:
        # refused in one line: only files without any surface may be
        assert done.stdout == ""
        assert len(done.stderr.strip().splitlines()) <= 2
        assert not faces
        return
    document = json.loads(done.stdout)
    same = len(document["faces"]) == faces and (area is None or abs(document["area"] - area) <= 1e-3 * max(area, 1e-9))
    assert same or document["warnings"], (len(document["faces"]), faces, document["area"], area)


@pytest.mark.corpus
@pytest.mark.parametrize("name", sorted(QUICK))
def test_inspect_agrees_with_the_index(corpus, name):
    check(corpus, name)


@pytest.mark.corpus
@pytest.mark.nightly
def test_inspect_agrees_with_the_index_on_everything(corpus):
    failed = {}
    for name in sorted(rows(corpus)):
        try:
            check(corpus, name)
        except AssertionError as error:
            failed[name] = str(error)[:300]
    assert failed == {}
