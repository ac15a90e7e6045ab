"""`cadsculpt check`: cases, each a scene that says what must come out."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from .console import ProgressDisplay, note, print_json

if TYPE_CHECKING:
    from ..formats.result_json import Case


@click.command("check")
@click.argument("paths", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="PATH...")
@click.option("--junit", type=click.Path(path_type=Path), metavar="FILE", help="Write JUnit XML as well.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout and nothing else there.")
@click.option(
    "-k", "select", default="", metavar="SUBSTRING", help="Only cases with this in their file's or scene's name."
)
@click.option("--quiet", is_flag=True, help="No progress.")
def command(paths: tuple[Path, ...], junit: Path | None, as_json: bool, select: str, quiet: bool) -> int:
    """Run cases and compare what is measured with what they expect.

    A case is a scene with [[expect]] tables. Each PATH is such a file, or a folder that is searched for them. Cases run
    in memory: no folder is written, and one bad case does not stop the others.

    \b
    cadsculpt check tests/cases
    cadsculpt check press.toml --json
    cadsculpt check cases -k thumb --junit report.xml

    Exit codes: 0 all passed, 1 a case failed or could not be run, 2 a PATH is missing or holds no case.
    """
    from ..formats.cases import collect, run_case
    from ..formats.junit import write_junit
    from ..formats.result_json import cases_object

    collection = collect(paths, select)
    if not quiet:
        for path, reason in collection.skipped:
            note(f"skipped {path}: {reason}")
    cases: list[Case] = []
    for file in collection.cases:
        stage = f"running {len(cases) + 1} of {len(collection.cases)}, {file.path.name}"
        with ProgressDisplay(quiet=quiet) as progress:
            progress.update(stage)
            case = run_case(file, partial(progress.update, stage))
        cases.append(case)
        if not as_json:
            print_case(case)
    if junit is not None:
        write_junit(junit, cases)
    summary = cases_object(cases)
    if as_json:
        print_json(summary)
    else:
        click.echo(f"{summary['passed']} passed, {summary['failed']} failed, {summary['errors']} errors")
    return 0 if summary["passed"] == len(cases) else 1


def print_case(case: Case) -> None:
    """One line a case, and below it every expectation that did not hold."""
    outcome = {"passed": "passed", "failed": "FAILED", "error": "error "}[case.outcome]
    click.echo(f"{outcome}  {case.name}  ({case.file}, {case.seconds:.1f} s)")
    for line in case.message.splitlines() if case.outcome == "error" else ():
        click.echo(f"        {line}")
    for expectation in case.expectations:
        if not expectation.ok:
            of = f" of {' and '.join(expectation.pair)}" if expectation.pair else ""
            found = expectation.measured
            value = "nothing" if found is None else f"{found:.6g}" if isinstance(found, float) else str(found)
            click.echo(f"        {expectation.what}{of}: measured {value}, expected {expectation.condition}")
