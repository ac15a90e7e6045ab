"""The index of the folder of real files: which files there are, what another reader found, and which traps are known."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

CAD = ("step", "iges", "rhino", "spline")
"""Folders of files with surfaces."""

BALL = 0.02
"""Radius of the ball that is pressed into a file's largest face, over the face's size."""

TRAPS = {
    "step/trj4_k1_geo-ac-214.stp": "inch numbers labelled as mm",
    "step/trj5_k1-sh-203.stp": "inch numbers labelled as mm",
    "step/trj6_k1-ec-214.stp": "inch numbers labelled as mm",
    "iges/hammer.iges": "says mm and reads 13 m long",
    "step/bug32314_corrupted.stp": "a vandalised DATA section",
    "iges/bug22566_test_Bad.igs": "bad trim curves",
}
"""Files that are known to be odd, and how."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One file. faces, area (mm2): of the index's reading, None where there is none."""

    name: str
    path: Path
    faces: int | None
    area: float | None

    @property
    def kind(self) -> str:
        """The folder that it lies in: step, iges, rhino, spline, mesh, toolpath or ccd."""
        return self.name.split("/", 1)[0]


def entries(folder: Path) -> list[Entry]:
    """Every file of the folder, in the order of their names; what the index does not name as well."""
    text = (folder / "INDEX.md").read_text(encoding="utf-8")
    found = []
    for path in sorted(p for p in folder.rglob("*") if p.is_file() and p.name != "INDEX.md"):
        name = path.relative_to(folder).as_posix()
        row = re.search(rf"^\| {re.escape(name)} \|.*$", text, flags=re.MULTILINE)
        cells = [cell.strip() for cell in row[0].split("|")] if row else []
        reading = re.match(r"(\d+); ([0-9.eE+-]+);", cells[5]) if len(cells) > 5 else None
        surfaces = re.match(r"(\d+) surfaces", cells[4]) if len(cells) > 4 else None
        if reading:
            found.append(Entry(name, path, int(reading[1]), float(reading[2])))
        else:
            found.append(Entry(name, path, int(surfaces[1]) if surfaces else None, None))
    return found
