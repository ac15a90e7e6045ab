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
    from ..formats.displace import Displaced
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
@click.option(
    "--instance",
    "instances",
    multiple=True,
    metavar="NAME",
    help="Move an assembly's part in this place only; may be repeated. Without it all places of a component change alike.",
)
@click.option("--displacement-units", "field_units", metavar="U", help="Of the displacements; IN's own when left out.")
@click.option(
    "--reach",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="MM",
    help="Farther from every point nothing moves; 4 times the points' spacing when left out.",
)
@click.option(
    "--refit",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="MM",
    help="Tolerance of the moved faces; 1/10000 of a face's size when left out.",
)
@click.option(
    "--continuity",
    type=click.Choice(["G0", "G1"]),
    default="G0",
    help="G1: faces that are tangent along a common edge stay so.",
)
@click.option(
    "--seam-tolerance",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="MM",
    help="How far moved faces may be apart along a common edge; what IN states when left out.",
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
    instances: tuple[str, ...],
    field_units: str | None,
    reach: float | None,
    refit: float | None,
    continuity: str,
    seam_tolerance: float | None,
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
    if field is None and (
        displaced or instances or field_units or reach or refit or seam_tolerance or continuity != "G0"
    ):
        raise InputError(
            "--displace, --instance, --displacement-units, --reach, --refit, --continuity and --seam-tolerance go with"
            " --displacements",
            mend="name the file",
        )
    if target.exists() and not force:
        raise InputError("it exists", where=str(target), mend="choose another name, or overwrite it with --force")
    with ProgressDisplay(quiet=quiet) as progress:
        progress.update("reading", remark=source.name)
        part = registry.read(source, units=units)
        if field is not None:
            from ..formats import displacements
            from ..formats.displace import displace

            progress.update("moving", remark=field.name)
            if instances:
                part = part.separated(instances)
            motion = displacements.read(field, field_units or part.units or "mm", reach=reach)
            part.warnings += [f"{field.name}: {line}" for line in motion.warnings]
            result = displace(
                part,
                motion,
                named_faces(part, displaced, instances) if displaced else None,
                among=named_faces(part, (), instances) if instances else None,
                tolerance=refit,
                continuity=continuity,
                seam_tolerance=seam_tolerance,
            )
        progress.update("writing", remark=target.name)
        if faces:
            part = part_of_faces(part, named_faces(part, faces))
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
        for line in lines_of(result):
            note(line)
    return 0


def lines_of(result: Displaced) -> list[str]:
    """What to say of each face that moved, and of the edges between them."""
    lines = [
        f"{face.name}: moved by up to {face.moved:.4g} mm, refit within {face.error.maximum:.3g} mm (rms {face.error.rms:.2g})"
        for face in result.faces
    ]
    if result.seams:
        worst = max(result.seams, key=lambda seam: seam.gap)
        a, b = worst.faces
        count = "its edge" if len(result.seams) == 1 else f"their {len(result.seams)} edges"
        lines.append(
            f"along {count} the faces are at most {worst.gap:.3g} mm apart ({a}, {b}; {worst.gap_as_read:.3g} before, "
            f"{worst.tolerance:.3g} allowed)"
        )
    return lines


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


def named_faces(part: Part, names: tuple[str, ...], instances: tuple[str, ...] = ()) -> list[Face]:
    """The faces of these names or numbers, each once, in the part's order; none are all. instances : of these alone."""
    from ..formats.instances import chosen_faces

    known = {face.name for face in part.faces}
    which = [int(name) if name.isdecimal() and name not in known else name for name in names]
    return chosen_faces(part, which or "all", instances or "all")


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
