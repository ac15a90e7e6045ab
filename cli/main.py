"""The command line: a group whose commands are imported only when they are called, and every error in one place."""

from __future__ import annotations

import contextlib
import errno
import importlib
import os
import sys
import traceback
import warnings
from collections.abc import Sequence
from itertools import takewhile
from typing import NoReturn

import click

from .._version import __version__
from ..errors import CadsculptError

COMMANDS: dict[str, str] = {
    "new": "Write a scene for a CAD file of yours.",
    "run": "Run a scene and write the sculpted part.",
    "check": "Run cases and compare them with what they expect.",
    "collide": "Tell whether two bodies touch, and how far apart they are.",
    "inspect": "List the faces of a CAD file, or look at a mesh.",
    "convert": "Write a CAD file in another format.",
    "report": "Write the report of a finished run again.",
    "demo": "Run an example that needs no file.",
    "tools": "List the tools that come with cadsculpt.",
    "schema": "Print the JSON Schema of a file format.",
}
"""Commands and their one-line helps; each is the function `command` of the module of its name."""

EXIT_INTERRUPTED = 130
EXIT_BROKEN_PIPE = 141
EXIT_INTERNAL = 70


class Interrupted(click.ClickException):
    """Ctrl-C. The message says what is left of the work."""

    exit_code = EXIT_INTERRUPTED


def debug_option(command: click.Command) -> click.Command:
    """Let a command take --debug, which `main` looks for in the arguments themselves."""
    option = click.Option(["--debug"], is_flag=True, expose_value=False, help="Show the traceback of an error.")
    command.params.append(option)
    return command


class LazyGroup(click.Group):
    """Lists its commands from the table above and imports one only when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"..{cmd_name}", __name__)
        command: click.Command = module.command
        if not any(parameter.name == "debug" for parameter in command.params):
            debug_option(command)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if name not in COMMANDS and name[:1] not in ("-", ""):
            from difflib import get_close_matches

            close = get_close_matches(name, COMMANDS, n=1)
            raise click.UsageError(f"no command {name!r}" + (f", did you mean {close[0]}?" if close else ""), ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=LazyGroup,
    invoke_without_command=True,
    params=[click.Option(["--debug"], is_flag=True, expose_value=False, help="Show the traceback of an error.")],
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, message="cadsculpt %(version)s")
@click.pass_context
def cli(ctx: click.Context) -> None:
    """Push tools into B-spline CAD parts and get the same part back.

    \b
    cadsculpt demo                        see it work
    cadsculpt new part.step -o press.toml a scene for your own part
    cadsculpt run press.toml              run it
    cadsculpt COMMAND --help              more about a command

    Exit codes: 0 done, 1 a check or expectation failed, 2 bad input or usage, 3 the simulation did not converge.
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help(), err=True)
        ctx.exit(2)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave with its exit code."""
    sys.exit(run(sys.argv[1:] if arguments is None else list(arguments)))


def run(arguments: Sequence[str]) -> int:
    """Run the command line; returns the exit code. Errors become one line on stderr each."""
    debug = "--debug" in takewhile(lambda argument: argument != "--", arguments)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a name that the terminal's encoding lacks is no reason to stop
            stream.reconfigure(errors="replace")
    with warnings.catch_warnings():
        if not (debug or sys.warnoptions):
            warnings.simplefilter("ignore")
        try:
            code = _invoke(list(arguments))
            sys.stdout.flush()
            return code
        except (Exception, KeyboardInterrupt) as error:
            if debug:
                traceback.print_exc()
            lines, code = explain(error)
            with contextlib.suppress(OSError):
                for line in lines:
                    click.echo(line, err=True)
            return code
        finally:
            _settle_stdout()


def _invoke(arguments: list[str]) -> int:
    """What `click.Command.main` does, less its own handling of errors: it leaves with 1 where a pipe is closed."""
    if "_CADSCULPT_COMPLETE" in os.environ:  # a shell asks for completions
        cli.main(arguments, prog_name="cadsculpt")
    try:
        with cli.make_context("cadsculpt", arguments) as context:
            code = cli.invoke(context)
    except click.exceptions.Exit as leave:
        code = leave.exit_code
    return code if isinstance(code, int) else 0


def explain(error: BaseException) -> tuple[list[str], int]:
    """What a user reads of an error, line by line, and the exit code."""
    match error:
        case CadsculptError():
            return [f"error: {line}" for line in str(error).splitlines()], error.exit_code
        case click.UsageError():
            path = error.ctx.command_path if error.ctx else "cadsculpt"
            return [f"error: {error.format_message()} (see {path} --help)"], error.exit_code
        case click.ClickException():
            return [f"error: {error.format_message()}"], 2 if error.exit_code == 1 else error.exit_code
        case click.exceptions.Abort() | KeyboardInterrupt():
            return ["error: interrupted"], EXIT_INTERRUPTED
        case MemoryError():
            return ["error: not enough memory (choose a larger node spacing or a lower resolution)"], 2
        case OSError(errno=errno.EPIPE):  # whoever read our output has gone
            return [], EXIT_BROKEN_PIPE
        case OSError():
            reason = error.strerror or str(error) or type(error).__name__
            place = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, (str, bytes)) else ""
            return [f"error: {place}{reason}"], 2
    what = " ".join(str(error).split()) or "no message"
    hint = "run with --debug for the traceback, and please report it"
    return [f"internal error: {type(error).__name__}: {what} ({hint})"], EXIT_INTERNAL


def _settle_stdout() -> None:
    """Where stdout cannot be written any more, let Python's own flush at the end go nowhere instead of complaining."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
