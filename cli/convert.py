"""`cadsculpt convert`: a CAD file in another format."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import InputError
from ..units import conversion
from .console import ProgressDisplay, note, warn

if TYPE_CHECKING:
    from ..formats.part import Face, Part
    from ..spline.surface import BSplineSurface

MESHES = (".stl", ".obj", ".ply")
"""Extensions that stand for triangles."""


@click.command("convert")
@click.argument("source", type=click.Path(path_type=Path), metavar="IN")
@click.argument("target", type=click.Path(path_type=Path), metavar="OUT")
@click.option(
    "--face", "faces", multiple=True, metavar="NAME", help="Only this face (name or number); may be repeated."
)
@click.option("--units", metavar="U", help="Length unit of a file that names none or the wrong one: mm, in, m, ...")
@click.option(
    "--tolerance",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="MM",
    help="Of a mesh: mm between faces and triangles; 1/1000 of the part's size when left out.",
)
@click.option(
    "--displacements",
    "field",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Move the part along these displacements first: X,Y,Z,DX,DY,DZ a line.",
)
@click.option("--displace", "displaced", multiple=True, metavar="NAME", help="Move only this face; may be repeated.")
@click.option("--displacement-units", "field_units", metavar="U", help="Of the displacements; IN's own when left out.")
@click.option(
    "--reach",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="MM",
    help="Farther from every point nothing moves; 3 times the points' spacing when left out.",
)
@click.option(
    "--refit",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="MM",
    help="Tolerance of the moved faces; 1/10000 of a face's size when left out.",
)
@click.option("--force", is_flag=True, help="Overwrite OUT if it exists.")
@click.option("--quiet", is_flag=True, help="No progress.")
def command(
    source: Path,
    target: Path,
    faces: tuple[str, ...],
    units: str | None,
    tolerance: float | None,
    field: Path | None,
    displaced: tuple[str, ...],
    field_units: str | None,
    reach: float | None,
    refit: float | None,
    force: bool,
    quiet: bool,
) -> int:
    """Write a CAD file IN as OUT, in the format of OUT's extension: .step .stp .igs .iges .3dm .json
    .geomdl.json .g2 .xml, or as triangles: .stl .obj .ply

    With --face only the surfaces of these faces are written. With --displacements the faces near its points follow
    them, as after a run that wrote such a file; all other faces stay as they are.

    \b
    cadsculpt convert part.igs part.step
    cadsculpt convert part.step top.json --face top
    cadsculpt convert part.step moved.step --displacements press.run/displacements.csv
    """
    from ..formats import registry
    from ..formats.geomdl_json import write_surfaces as write_geomdl

    format = format_of(target)
    if tolerance is not None and format != "mesh":
        raise InputError(
            "--tolerance is for meshes", where=str(target), mend="write .stl, .obj or .ply, or leave it out"
        )
    if field is None and (displaced or field_units or reach or refit):
        raise InputError(
            "--displace, --displacement-units, --reach and --refit go with --displacements", mend="name the file"
        )
    if target.exists() and not force:
        raise InputError("it exists", where=str(target), mend="choose another name, or overwrite it with --force")
    with ProgressDisplay(quiet=quiet) as progress:
        progress.update("reading", remark=source.name)
        part = registry.read(source, units=units)
        if field is not None:
            progress.update("moving", remark=field.name)
            told = moved(part, field, displaced, field_units, reach, refit)
        progress.update("writing", remark=target.name)
        if faces:
            part = part_of_faces(part, chosen_faces(part, faces))
        if format == "geomdl":
            write_geomdl(target, registry.surfaces_in_file_units(part))
        elif format == "mesh":
            from ..formats.part_mesh import write_part as write_mesh

            write_mesh(part, target, tolerance)
        else:
            registry.write_part(part, target, format)
    for line in part.warnings:
        warn(line)
    if field is not None and not quiet:
        for line in told:
            note(line)
    return 0


def moved(
    part: Part, file: Path, names: tuple[str, ...], units: str | None, reach: float | None, tolerance: float | None
) -> list[str]:
    """Move a part along the displacements of a file; returns what to say of each face that moved."""
    from ..formats import displacements
    from ..formats.displace import displace

    field = displacements.read(file, units or part.units or "mm", reach=reach)
    part.warnings += [f"{file.name}: {line}" for line in field.warnings]
    chosen = chosen_faces(part, names) if names else None
    return [
        f"{face.name}: moved by up to {face.moved:.4g} mm, refit within {face.error.maximum:.3g} mm (rms {face.error.rms:.2g})"
        for face in displace(part, field, chosen, tolerance=tolerance)
    ]


def format_of(target: Path) -> str:
    """The format that a file's name asks for, "mesh" for triangles. Raises InputError for a name that asks for none.

    NAME.geomdl.json is the JSON of NURBS-Python.
    """
    from ..formats.registry import SUFFIXES

    if target.name.lower().endswith(".geomdl.json"):
        return "geomdl"
    suffix = target.suffix.lower()
    if suffix in MESHES:
        return "mesh"
    if suffix not in SUFFIXES:
        known = ", ".join([*SUFFIXES, ".geomdl.json", *MESHES])
        raise InputError(f"no format is known by {suffix or 'no extension'!r}", where=str(target), mend=f"use {known}")
    return SUFFIXES[suffix]


def chosen_faces(part: Part, names: tuple[str, ...]) -> list[Face]:
    """The faces of these names or numbers, each once, in the part's order."""
    known = {face.name for face in part.faces}
    return part.faces.select([int(name) if name.isdecimal() and name not in known else name for name in names])


def part_of_faces(part: Part, faces: list[Face]) -> Part:
    """A part of these faces' surfaces alone, in the unit of the file that they come from."""
    from ..formats.patch_part import PatchPart

    only = PatchPart(part.path, "json", part.units or "mm", [in_file_units(part, face) for face in faces])
    only.warnings += part.warnings
    return only


def in_file_units(part: Part, face: Face) -> BSplineSurface:
    """The face's surface in the unit of its file."""
    surface = face.surface.scaled(conversion("mm", part.units or "mm"))
    return replace(surface, name=face.name)
