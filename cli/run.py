"""`cadsculpt run`: a scene, its folder, and what came out."""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import SimulationError
from .console import ProgressDisplay, note, number, print_json, print_pairs, warn
from .main import Interrupted

if TYPE_CHECKING:
    from ..formats.run_folder import RunOutcome


@click.command("run")
@click.argument("scene", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="DIR",
              help="Folder for the results; NAME.run in the current folder when left out.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print result.json on stdout and nothing else there.")
@click.option("--quiet", is_flag=True, help="No progress.")
@click.option("--resume", is_flag=True, help="Go on with a run that was interrupted.")
@click.option("--force", is_flag=True, help="Overwrite the folder if it exists.")
def command(scene: Path, output: Path | None, as_json: bool, quiet: bool, resume: bool, force: bool) -> int:
    """Run a SCENE (TOML) and write the sculpted part, the series over time and the contact report.

    \b
    cadsculpt run press.toml
    cadsculpt run press.toml -o results/press --force
    cadsculpt run press.toml --json | jq .summary.max_force

    Exit codes: 0 done, 1 an expectation failed, 2 bad input, 3 the simulation did not converge.
    """
    if resume and force:
        raise click.UsageError("--resume goes on with a run and --force starts it again: use one of them")
    folder, outcome = run_file(scene, output, quiet=quiet, resume=resume, force=force)
    if as_json:
        print_json(outcome.document)
    else:
        print_summary(outcome.document, folder)
    return exit_code(outcome)


def run_file(
    path: Path, output: Path | None, *, quiet: bool = False, resume: bool = False, force: bool = False
) -> tuple[Path, RunOutcome]:
    """Run a scene's file with progress on stderr. Returns its folder and what came out."""
    from ..formats.run_folder import run_scene
    from ..formats.scene_toml import SceneFile

    scene = SceneFile.load(path)
    folder = output or Path(f"{slug(scene.name)}.run")
    try:
        with ProgressDisplay(quiet=quiet) as progress:
            outcome = run_scene(scene, folder, force=force, resume=resume, on_progress=progress)
    except KeyboardInterrupt:
        kept = folder.with_name(folder.name + ".partial")
        left = f"; what was computed is kept in {kept}, --resume goes on with it" if kept.is_dir() else ""
        raise Interrupted(f"interrupted{left}") from None
    return folder, outcome


def exit_code(outcome: RunOutcome) -> int:
    """3 when the simulation failed, 1 when an expectation did not hold, else 0."""
    if not outcome.document["converged"]:
        reason = outcome.result.failure or "the simulation did not converge"
        note(f"error: {reason}")
        return SimulationError.exit_code
    return 0 if all(entry["ok"] for entry in outcome.document["expectations"]) else 1


def print_summary(document: dict[str, Any], folder: Path) -> None:
    """The run on stdout, warnings on stderr."""
    unit, summary = document["units"], document["summary"]
    first = summary["first_contact"]
    print_pairs(
        [
            ("result", str(folder)),
            ("steps", f"{document['steps']} to t = {document['time']:.4g} s"),
            ("first contact", "never" if first is None else f"t = {first:.4g} s"),
            ("largest force", number(summary["max_force"], "N")),
            ("largest depth", number(summary["max_depth"], unit)),
            ("left at the end of a step", number(summary["max_penetration"], unit)),
            ("largest contact area", number(summary["max_contact_area"], f"{unit}2")),
            ("largest displacement", number(summary["max_displacement"], unit)),
            ("refit error", number(summary["refit_max_error"], unit)),
            *((f"expected {words(entry)}", "ok" if entry["ok"] else f"FAILED, measured {measured(entry)}")
              for entry in document["expectations"]),
            ("seconds", f"{document['timing']['total_s']:.1f}"),
        ]
    )  # fmt: skip
    for warning in document["warnings"]:
        warn(warning)


def words(entry: dict[str, Any]) -> str:
    """An expectation of result.json in words: "max_force of thumb and panel: at most 3"."""
    from ..expect import condition_in_words

    of = f" of {' and '.join(entry['pair'])}" if entry.get("pair") else ""
    return f"{entry['what']}{of}: {condition_in_words(entry['expected'])}"


def measured(entry: dict[str, Any]) -> str:
    """What was measured: a number, a verdict, or that there was nothing."""
    value = entry["measured"]
    return "nothing" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def slug(name: str) -> str:
    """A name as a folder can be called: letters, digits, dots, dashes and underscores."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9._-]+", "-", plain).strip("-.") or "scene"
