"""`cadsculpt new`: a scene to start from, for the user's own file."""

from __future__ import annotations

from pathlib import Path

import click

from ..errors import InputError
from .console import ProgressDisplay, print_pairs, warn

SHAPES = ("sphere", "ellipsoid", "capsule", "cylinder", "cone", "box", "torus", "point")


@click.command("new")
@click.argument("part", type=click.Path(path_type=Path))
@click.option(
    "--tool", "shape", type=click.Choice(SHAPES), default="sphere", show_default=True, help="The tool's shape."
)
@click.option(
    "--face", metavar="NAME", help="Name or number of the face to press; the most suitable one when left out."
)
@click.option("--size", type=click.FloatRange(min=0.0, min_open=True, max=1.0), metavar="X",
              help="Radius of the tool over the face's size, at most; as large as fits when left out.")  # fmt: skip
@click.option("--quick", is_flag=True, help="A coarse lattice and few steps: a look in seconds.")
@click.option("--units", metavar="U", help="Length unit of a file that names none or the wrong one: mm, in, m, ...")
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("scene.toml"), show_default=True,
              metavar="FILE", help="The scene to write.")  # fmt: skip
@click.option("--force", is_flag=True, help="Overwrite the scene if it exists.")
@click.option("--quiet", is_flag=True, help="No progress.")
def command(
    part: Path,
    shape: str,
    face: str | None,
    size: float | None,
    quick: bool,
    units: str | None,
    output: Path,
    force: bool,
    quiet: bool,
) -> int:
    """Write a scene for your own PART (STEP, IGES, 3DM or patch JSON).

    Picks a face, puts a tool above it and presses 5 % of the face's size. Every key of the scene is explained in it:
    change what you like and run it.

    \b
    cadsculpt new part.step -o press.toml
    cadsculpt new part.step --tool ellipsoid --face top
    cadsculpt new part.igs --units in --quick
    cadsculpt run press.toml
    """
    from ..formats.atomic import write_whole
    from ..formats.new_scene import new_scene
    from ..formats.press import Wish

    if output.exists() and not force:
        raise InputError(
            "it exists", where=str(output), mend="choose another name with -o, or overwrite it with --force"
        )
    with ProgressDisplay(quiet=quiet) as progress:
        wish = Wish.quick(size) if quick else Wish(size)
        made = new_scene(part, output, shape=shape, face=face, wish=wish, units=units, on_progress=progress.update)
    write_whole(output, made.text)
    model, tool = made.scene.model[0], made.scene.tool[0]
    unit = made.scene.units
    rows = tool.path if isinstance(tool.path, tuple) else ()
    print_pairs(
        [
            ("scene", str(output)),
            ("face", f"{made.face.name} (number {made.face.number}, {made.face.kind})"),
            ("tool", f"{shape}, {made.depth:.4g} {unit} into the face"),
            ("lattice", f"{made.nodes} nodes on the face, {model.thickness:.4g} {unit} thick"),
            ("run", f"{made.steps} steps, {rows[-1].t:.3g} s" if rows else f"{made.steps} steps"),
            ("next", f"cadsculpt run {output}"),
        ]
    )
    for line in made.warnings:
        warn(line)
    return 0
