"""`cadsculpt demo`: an example that needs no file."""

from __future__ import annotations

from pathlib import Path

import click

from ..errors import InputError
from .console import print_json, print_table
from .run import exit_code, print_summary, run_file


@click.command("demo")
@click.argument("name", required=False)
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="DIR",
              help="Folder for the example and its result; demo-NAME in the current folder when left out.")  # fmt: skip
@click.option("--list", "listing", is_flag=True, help="List the examples and leave.")
@click.option("--json", "as_json", is_flag=True, help="Print result.json on stdout and nothing else there.")
@click.option("--quiet", is_flag=True, help="No progress.")
@click.option("--force", is_flag=True, help="Overwrite the folder if it exists.")
def command(name: str | None, output: Path | None, listing: bool, as_json: bool, quiet: bool, force: bool) -> int:
    """Make an example part and its scene, and run it.

    The folder then holds the part (panel.json), the scene (scene.toml, to play with) and the result.

    \b
    cadsculpt demo
    cadsculpt demo stroke -o somewhere
    cadsculpt demo --list
    """
    from ..formats.demo_parts import DEMOS, demo_named, write_demo

    if listing:
        print_table(("name", "what it shows"), [(demo.name, demo.about) for demo in DEMOS.values()])
        return 0
    demo = demo_named(name or next(iter(DEMOS)))
    folder = output or Path(f"demo-{demo.name}")
    if folder.exists() and not force:
        raise InputError(
            "it exists", where=str(folder), mend="choose another folder with -o, or overwrite it with --force"
        )
    folder.mkdir(parents=True, exist_ok=True)
    scene = write_demo(demo, folder)
    result, outcome = run_file(scene, folder / "result", quiet=quiet, force=force)
    if as_json:
        print_json(outcome.document)
    else:
        print_summary(outcome.document, result)
    return exit_code(outcome)
