"""The command line as a whole: what it loads, how it leaves, what it says."""

from __future__ import annotations

import ast
import errno
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import click
import pytest

import cadsculpt
from cadsculpt.cli import main as cli_main
from cadsculpt.cli.main import COMMANDS, explain, run
from cadsculpt.errors import InputError, SceneError, SimulationError

ROOT = Path(__file__).parents[2]
HEAVY = {"numba", "numpy", "scipy", "vtk", "vtkmodules", "pyvista", "OCP", "rhino3dm", "pydantic", "rich", "jinja2"}

LOADED = """
import sys
from cadsculpt.cli.main import run
code = run({arguments!r})
print(sorted({{name.split(".")[0] for name in sys.modules}}), file=sys.stderr)
sys.exit(code)
"""


def commands() -> dict[str, click.Command]:
    context = click.Context(cli_main.cli)
    found = {}
    for name in COMMANDS:
        command = cli_main.cli.get_command(context, name)
        assert command is not None
        found[name] = command
    return found


def shell(*arguments: str, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "cadsculpt", *arguments], capture_output=True, text=True, check=False, **options
    )  # type: ignore[call-overload,no-any-return]


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], *([name, "--help"] for name in COMMANDS)])
def test_help_loads_nothing_heavy(arguments: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOADED.format(arguments=arguments)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    loaded = set(ast.literal_eval(done.stderr.splitlines()[-1]))
    assert not loaded & HEAVY


def test_help_of_the_group_imports_no_command() -> None:
    code = LOADED.format(arguments=["--help"]).replace('.split(".")[0]', "")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = [name for name in ast.literal_eval(done.stderr) if name.startswith("cadsculpt.cli")]
    assert loaded == ["cadsculpt.cli", "cadsculpt.cli.main"]
    for name, text in COMMANDS.items():
        assert re.search(rf"^  {name} +{re.escape(text)}$", done.stdout, re.M)


def test_the_module_runs_and_the_engine_does_not_import_the_command_line() -> None:
    done = shell("--version")
    assert (done.returncode, done.stdout.strip(), done.stderr) == (0, f"cadsculpt {cadsculpt.__version__}", "")
    tree = ast.parse((Path(cadsculpt.__file__).parent / "__main__.py").read_text())
    imported = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    imported |= {str(n.module) for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    assert imported == {"__future__", "importlib"}


# ------------------------------------------------------------------- documented


def test_every_command_and_option_is_documented_and_has_help() -> None:
    text = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    common, *rest = re.split(r"^## ", text, flags=re.M)
    sections = {part.split("\n", 1)[0]: part for part in rest}
    assert set(COMMANDS) <= set(sections)
    everywhere = common + sections["What holds for all of them"]
    for name, command in commands().items():
        assert command.name == name
        assert f"[`{name}`](#{name})" in everywhere
        assert command.help, name
        assert f"cadsculpt {name}" in command.help, f"{name} has no example in its help"
        assert f"cadsculpt {name}" in sections[name]
        for parameter in command.params:
            if isinstance(parameter, click.Option):
                assert parameter.help, f"{name} {parameter.opts}"
                for spelling in parameter.opts:
                    assert f"`{spelling}" in sections[name] + everywhere, f"{name} {spelling} is not documented"
    documented = {option for part in sections.values() for option in re.findall(r"^\| `(--?[a-z-]+)", part, re.M)}
    known = {
        spelling for c in commands().values() for p in c.params if isinstance(p, click.Option) for spelling in p.opts
    }
    assert documented <= known | {"-h"}


def test_help_fits_the_terminal_and_names_the_exit_codes(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "0 done, 1 a check or expectation failed, 2 bad input or usage, 3 the simulation did not converge" in text


# ----------------------------------------------------------------------- errors


def test_errors_are_one_line_each_with_their_exit_code() -> None:
    assert explain(InputError("no such face", where="a.step", mend="choose another")) == (
        ["error: a.step: no such face (choose another)"],
        2,
    )
    assert explain(SceneError(["s.toml:1: a", "s.toml:2: b"])) == (["error: s.toml:1: a", "error: s.toml:2: b"], 2)
    assert explain(SimulationError("unstable")) == (["error: unstable"], 3)
    assert explain(PermissionError(errno.EACCES, "Permission denied", "x.json")) == (
        ["error: x.json: Permission denied"],
        2,
    )
    assert explain(OSError(errno.ENOSPC, "No space left on device")) == (["error: No space left on device"], 2)
    assert explain(BrokenPipeError(errno.EPIPE, "Broken pipe")) == ([], 141)
    lines, code = explain(RuntimeError("two\nlines"))
    assert code == 70
    assert len(lines) == 1
    assert lines[0].startswith("internal error: RuntimeError: two lines (run with --debug")
    lines, code = explain(MemoryError())
    assert (len(lines), code) == (1, 2)


@pytest.mark.parametrize(
    "arguments", [["chekc"], ["--nonsense"], ["schema", "nonsense"], ["run"], ["tools", "--nonsense"]]
)
def test_usage_errors_are_one_line_and_exit_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1


def test_a_misspelt_command_is_suggested(capsys: pytest.CaptureFixture[str]) -> None:
    run(["inspcet"])
    assert "did you mean inspect?" in capsys.readouterr().err


def test_no_command_shows_the_help_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    assert run([]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "Commands:" in said.err


@pytest.mark.parametrize("arguments", [["--debug", "tools"], ["tools", "--debug"]])
def test_debug_shows_the_traceback_wherever_it_stands(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken() -> dict[str, Path]:
        raise RuntimeError("broken on purpose")

    monkeypatch.setattr("cadsculpt.formats.tool_toml.library", broken)
    assert run(arguments) == 70
    assert "Traceback (most recent call last)" in capsys.readouterr().err
    assert run(["tools"]) == 70
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    assert (said.out, said.err.count("\n")) == ("", 1)


def test_an_interrupt_is_one_line_and_130(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted() -> dict[str, Path]:
        raise KeyboardInterrupt

    monkeypatch.setattr("cadsculpt.formats.tool_toml.library", interrupted)
    assert run(["tools"]) == 130
    assert capsys.readouterr().err == "error: interrupted\n"


@pytest.mark.skipif(os.name != "posix", reason="pipes as on POSIX")
def test_a_reader_that_goes_away_is_no_error() -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as gone:
        done = subprocess.run(
            [sys.executable, "-m", "cadsculpt", "schema"], stdout=gone, stderr=subprocess.PIPE, check=False
        )
    assert done.stderr == b""
    assert done.returncode == 141


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_behind_stdout_is_one_line_and_2() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "cadsculpt", "schema"], stdout=full, stderr=subprocess.PIPE, check=False
        )
    assert done.returncode == 2
    assert done.stderr.decode().splitlines() == ["error: No space left on device"]


def test_a_name_that_the_terminal_cannot_show_is_no_crash(tmp_path: Path) -> None:
    done = shell("inspect", str(tmp_path / "Gehäuse→.step"), env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("error: ")
    assert "Traceback" not in done.stderr


def test_schema_prints_one_json_object() -> None:
    done = shell("schema", "scene")
    assert json.loads(done.stdout)["type"] == "object"
    assert done.stderr == ""
