"""`cadsculpt inspect`: the faces of a CAD file, or the triangles of a mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .console import ProgressDisplay, number, print_json, print_pairs, print_table, warn


@click.command("inspect")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout and nothing else there.")
@click.option("--units", metavar="U", help="Length unit of a file that names none or the wrong one: mm, in, m, ...")
@click.option("--quiet", is_flag=True, help="No progress.")
def command(file: Path, as_json: bool, units: str | None, quiet: bool) -> int:
    """List the faces of a CAD FILE (STEP, IGES, 3DM, patch JSON, GoTools or G+Smo): name, kind, net, area, size.

    Of a mesh (STL, OBJ, PLY, OFF), say whether it is watertight, its area and volume.
    Lengths are in mm and areas in mm2, whatever the file's unit.

    \b
    cadsculpt inspect part.step
    cadsculpt inspect part.3dm --units in
    cadsculpt inspect part.igs --json | jq '.faces[].name'
    """
    from ..formats import registry
    from ..formats.inspect import inspect_object, mesh_object
    from ..formats.mesh import TRIANGLE_FORMATS

    with ProgressDisplay(quiet=quiet) as progress:
        progress.update("reading", remark=file.name)
        if file.suffix.lower() in TRIANGLE_FORMATS:
            found = mesh_object(file, units)
        else:
            part = registry.read(file, units=units)
            found = inspect_object(part, lambda done, total: progress.update("looking at faces", done, total))
    if as_json:
        print_json(found)
        return 0
    print_pairs(
        [
            ("format", found["format"]),
            ("units", found["units"] or "none"),
            *(_mesh_pairs(found) if "triangles" in found else [("faces", str(len(found["faces"])))]),
            ("area", number(found["area"], "mm2", 8)),
            ("size", _size(found["bbox"], " mm")),
        ]
    )
    if found["faces"]:
        click.echo()
        columns = ["number", "name", "kind", "degree", "net", "flags", "area mm2", "size mm"]
        rows = [_row(face) for face in found["faces"]]
        if any("instance" in face for face in found["faces"]):
            columns.insert(1, "instance")
            rows = [
                [row[0], face.get("instance", ""), *row[1:]] for row, face in zip(rows, found["faces"], strict=True)
            ]
        print_table(columns, rows, right=("number", "area mm2"))
    for warning in found["warnings"]:
        warn(warning)
    return 0


def _mesh_pairs(found: dict[str, Any]) -> list[tuple[str, str]]:
    open_edges = f"no, {found['open_edges']} open edges" if found["open_edges"] else "no"
    return [
        ("triangles", str(found["triangles"])),
        ("watertight", "yes" if found["closed"] else open_edges),
        ("shells", str(found["shells"])),
        ("volume", number(found["volume"], "mm3", 8)),
    ]


def _row(face: dict[str, Any]) -> list[str]:
    closed = face["closed"] or [False, False]
    flags = [
        *(["rational"] if face["rational"] else []),
        *(
            ["closed " + "".join(axis for axis, is_closed in zip("uv", closed, strict=True) if is_closed)]
            if any(closed)
            else []
        ),
        *(["trimmed"] if face["trimmed"] else []),
    ]
    return [
        str(face["number"]),
        face["name"],
        face["kind"],
        " x ".join(map(str, face["degree"])) if face["degree"] else "-",
        " x ".join(map(str, face["control_points"])) if face["control_points"] else "-",
        ", ".join(flags),
        number(face["area"], digits=6),
        _size(face["bbox"]),
    ]


def _size(box: list[float] | None, unit: str = "") -> str:
    if box is None:
        return "-"
    return " x ".join(f"{high - low:.4g}" for low, high in zip(box[:3], box[3:], strict=True)) + unit
