"""A second process that compiles kernels beside this one; what it has compiled comes through the shared cache."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from ..jit import on_compilation


class Beside:
    """The second process, if there is one yet."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, function: Callable[..., object], *arguments: Any) -> None:
        """Call a function of the engine in a new process. Where there can be none, this process does all the work."""
        code = f"from {function.__module__} import {function.__name__} as f; f(*{arguments!r})"
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            )  # fmt: skip
        except OSError:
            self._process = None

    def wait(self) -> None:
        """Until it has ended."""
        if self._process is not None:
            self._process.wait()

    def stop(self) -> None:
        """End it. The cache stays whole: its files are written under other names first."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait()


@contextmanager
def compile_beside(
    function: Callable[..., object], *arguments: Any, tell: Callable[[], object] = lambda: None
) -> Iterator[Beside]:
    """Within the context, when this process must compile a kernel, `tell` so and call the function in a second process.

    arguments : lists, numbers and strings. The second process ends with the context.
    """
    beside = Beside()

    def compiling() -> None:
        tell()
        beside.start(function, *arguments)

    try:
        with on_compilation(compiling):
            yield beside
    finally:
        beside.stop()
