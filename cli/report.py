"""`cadsculpt report`: the report of a finished run, written again."""

from __future__ import annotations

from pathlib import Path

import click

from ..errors import InputError
from .console import ProgressDisplay


@click.command("report")
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--quiet", is_flag=True, help="No progress.")
def command(run: Path, quiet: bool) -> int:
    """Write report.html of a finished RUN's folder again, from the files in it.

    \b
    cadsculpt report press.run
    """
    from ..formats.html_report.report import write_report

    if not run.is_dir():
        raise InputError("there is no such folder", where=str(run), mend="name the folder that cadsculpt run wrote")
    with ProgressDisplay(quiet=quiet) as progress:
        progress.update("writing", remark="report.html")
        path = write_report(run)
    click.echo(str(path))
    return 0
