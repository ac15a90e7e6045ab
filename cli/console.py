"""What a user sees: results on stdout, everything else on stderr, rich only where there is a terminal."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, Self

import click

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID


def note(text: str) -> None:
    """A line on stderr."""
    click.echo(text, err=True)


def warn(text: str) -> None:
    """A warning: one line on stderr."""
    note(f"warning: {' '.join(text.split())}")


def print_json(value: Mapping[str, Any]) -> None:
    """The one JSON object of --json. ASCII only, so that no terminal's encoding can spoil it."""
    click.echo(json.dumps(value, indent=2, allow_nan=False))


def print_pairs(pairs: Sequence[tuple[str, str]]) -> None:
    """Name and value, one pair a line, values aligned."""
    width = max((len(name) for name, _ in pairs), default=0)
    for name, value in pairs:
        click.echo(f"{name:<{width}}  {value}".rstrip())


def print_table(columns: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[str] = ()) -> None:
    """A table on stdout: ruled on a terminal, aligned plain text elsewhere. Columns named in `right` are numbers."""
    if sys.stdout.isatty():
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        table = Table(box=None, header_style="bold", pad_edge=False)
        for column in columns:
            table.add_column(column, justify="right" if column in right else "left", overflow="fold")
        for row in rows:
            table.add_row(*(Text(cell) for cell in row))
        Console().print(table)
        return
    for line in aligned(columns, rows, right):
        click.echo(line)


def aligned(columns: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[str] = ()) -> list[str]:
    """The lines of a plain table, header first, two blanks between columns."""
    widths = [max(len(cell) for cell in cells) for cells in zip(columns, *rows, strict=True)]
    return [
        "  ".join(
            cell.rjust(width) if column in right else cell.ljust(width)
            for column, cell, width in zip(columns, row, widths, strict=True)
        ).rstrip()
        for row in (columns, *rows)
    ]


def number(value: float | None, unit: str = "", digits: int = 4) -> str:
    """A number for people: `digits` significant ones and the unit, "-" for none."""
    if value is None:
        return "-"
    return f"{value:.{digits}g}" + (f" {unit}" if unit else "")


class Stage(Protocol):
    """What a long job tells of itself: what it does now, and how much of that is done (0 of 0 where it cannot say)."""

    @property
    def stage(self) -> str: ...
    @property
    def done(self) -> int: ...
    @property
    def total(self) -> int: ...
    @property
    def note(self) -> str: ...


LINE_EVERY = 1.0
"""Seconds between two plain lines of one stage, at least."""


class ProgressDisplay:
    """Progress on stderr: a bar on a terminal, plain lines elsewhere, nothing when quiet.

    A plain line comes when the stage changes, and within a stage with each tenth of it, at most one a second.
    """

    def __init__(self, *, quiet: bool = False, clock: Callable[[], float] = time.monotonic) -> None:
        self._quiet = quiet
        self._clock = clock
        self._stage = ""
        self._note = ""
        self._printed_at = 0.0
        self._printed_tenth = 0
        self._bar: Bar | None = None
        self._task: TaskID | None = None

    def __enter__(self) -> Self:
        if not self._quiet and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

            columns = (
                SpinnerColumn(),
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TextColumn("{task.fields[count]}", markup=False),
                TimeElapsedColumn(),
            )
            # results on stdout stay there: rich would send them to its own console, which is stderr
            self._bar = Progress(
                *columns, console=Console(stderr=True), transient=True, redirect_stdout=False, redirect_stderr=False
            )
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def __call__(self, now: Stage) -> None:
        self.update(now.stage, now.done, now.total, now.note)

    def update(self, stage: str, done: int = 0, total: int = 0, remark: str = "") -> None:
        """Tell what is being done; `remark` is added to the stage's name, such as the file that is read."""
        if self._quiet:
            return
        if self._bar is not None:
            self._on_bar(stage, done, total, remark)
        else:
            self._as_line(stage, done, total, remark)

    def _on_bar(self, stage: str, done: int, total: int, remark: str) -> None:
        assert self._bar is not None
        words = f"{stage} {remark}".strip()
        count = f"{done}/{total}" if total else ""
        if self._task is None or stage != self._stage:
            if self._task is not None:
                self._bar.remove_task(self._task)
            self._task = self._bar.add_task(words, total=total or None, count=count)
        self._bar.update(self._task, description=words, completed=done, total=total or None, count=count)
        self._stage = stage

    def _as_line(self, stage: str, done: int, total: int, remark: str) -> None:
        now, tenth = self._clock(), 10 * done // total if total else 0
        new = stage != self._stage or (remark != self._note and not total)
        due = tenth > self._printed_tenth and now >= self._printed_at + LINE_EVERY
        if not (new or due):
            return
        count = f"step {done}/{total}  {100 * done // total}%" if total and done else ""
        words = f"{stage} {remark}".strip()
        note(f"{words}  {count}".rstrip() if new else count)
        self._stage, self._note, self._printed_at, self._printed_tenth = stage, remark, now, tenth
