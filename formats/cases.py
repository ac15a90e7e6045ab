"""Cases: scenes with expectations, found in files and folders, each run in memory and compared with what it expects."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..errors import CadsculptError, InputError, SceneError
from ..expect import Expectation
from .result_json import Case
from .toml_file import read as read_toml


@dataclass(frozen=True, slots=True)
class CaseFile:
    """A file to be run as a case. name : the scene's. fault : why it cannot be run, "" when it looks like a case."""

    path: Path
    name: str
    fault: str = ""


@dataclass(frozen=True, slots=True)
class Collection:
    """The cases found, and the files of folders that were passed over, each with the reason."""

    cases: tuple[CaseFile, ...]
    skipped: tuple[tuple[Path, str], ...]


def collect(paths: Sequence[str | os.PathLike[str]], select: str = "") -> Collection:
    """Cases among files and, recursively, folders: TOML files that hold a scene with [[expect]] tables.

    Of a folder, scenes that expect nothing are passed over, and so are hidden folders, tool definitions and TOML files
    that are no scene at all. A file that is named itself must be a case. A file that cannot be read or is no TOML is a
    case with a fault: it must not get lost. select : a part of the file's name or of the scene's, in any case.

    Raises InputError when a path does not exist or no case is found.
    """
    found: dict[Path, CaseFile] = {}
    skipped: dict[Path, str] = {}
    for given in paths:
        path = Path(given)
        if not path.exists():
            raise InputError("there is no such file or folder", where=str(path))
        for file in [path] if not path.is_dir() else _toml_files(path):
            case, reason = _look(file)
            if not reason:
                found.setdefault(file.resolve(), case)
            elif file is path:
                found.setdefault(file.resolve(), CaseFile(file, case.name, f"{reason} (write [[expect]] tables)"))
            elif reason == NOTHING:
                skipped.setdefault(file, reason)
    cases = [case for case in found.values() if select.lower() in f"{case.path} {case.name}".lower()]
    if not cases:
        where = ", ".join(str(path) for path in paths)
        chosen = f" that has {select!r} in its name" if select and found else ""
        raise InputError(f"no case found{chosen}", where=where, mend="a case is a scene with [[expect]] tables")
    return Collection(tuple(cases), tuple(skipped.items()))


def run_case(case: CaseFile, on_progress: Callable[[int, int], None] | None = None) -> Case:
    """Run a case in memory. Whatever is wrong with it becomes its outcome: nothing is raised for bad input.

    on_progress : (step, steps).
    """
    started = time.perf_counter()
    name, message = case.name, case.fault
    expectations: tuple[Expectation, ...] = ()
    outcome: Literal["passed", "failed", "error"] = "error"
    if not message:
        try:
            name, expectations, message = _run(case.path, on_progress)
            outcome = "error" if message else "passed" if all(e.ok for e in expectations) else "failed"
        except (CadsculptError, OSError, MemoryError) as error:
            message = str(error) or "not enough memory"
    return Case(str(case.path), name, outcome, expectations, message, time.perf_counter() - started)


def _run(path: Path, on_progress: Callable[[int, int], None] | None) -> tuple[str, tuple[Expectation, ...], str]:
    """The scene's name, its expectations, and why the simulation failed, "" when it did not."""
    from ..run import Hooks, run
    from .load import load
    from .scene_toml import SceneFile

    scene = SceneFile.load(path)
    result = run(load(scene).model, hooks=Hooks(on_progress=on_progress))
    return scene.name, result.expectations, result.failure


NOTHING = "it expects nothing"


def _look(path: Path) -> tuple[CaseFile, str]:
    """What a file is, without checking the scene: a case, or the reason why it is none."""
    try:
        data = read_toml(path).data
    except SceneError as error:
        return CaseFile(path, path.stem, str(error)), ""
    name = data.get("name")
    case = CaseFile(path, name if isinstance(name, str) and name else path.stem)
    if data.get("expect"):
        return case, ""
    return case, NOTHING if "model" in data else "it is no scene"


def _toml_files(folder: Path) -> Iterator[Path]:
    for root, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        yield from (Path(root) / name for name in sorted(files) if name.endswith(".toml") and not name.startswith("."))
