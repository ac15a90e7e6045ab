"""Children that are forked instead of started, so that a sweep over many files loads the CAD kernel once and not each time.

What a child does, how long it may take and what its end means stay what they are in `cadsculpt.formats.occt.probe`.
"""

from __future__ import annotations

import os
import subprocess
import time
from types import TracebackType
from typing import Any, Self

from cadsculpt.formats import iges, step  # noqa: F401  loaded before the first fork
from cadsculpt.formats.occt import probe


class Forked:
    """As much of `subprocess.Popen` as the trial of a damaged file uses."""

    def __init__(self, command: list[str], **streams: Any) -> None:
        reading, writing = os.pipe()
        self._code: int | None = None
        self._pid = os.fork()
        if self._pid == 0:
            null = os.open(os.devnull, os.O_RDWR)
            for number, file in ((0, null), (1, writing), (2, null)):
                os.dup2(file, number)
            try:
                probe.main(*command[-2:])
            except BaseException:
                os._exit(1)
            os._exit(0)
        os.close(writing)
        self.stdout = os.fdopen(reading, "rb")

    def wait(self, timeout: float | None = None) -> int:
        end = None if timeout is None else time.monotonic() + timeout
        while self._code is None:
            pid, status = os.waitpid(self._pid, os.WNOHANG)
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
            elif end is not None and time.monotonic() > end:
                raise subprocess.TimeoutExpired("forked", timeout or 0.0)
            else:
                time.sleep(0.01)
        return self._code

    def kill(self) -> None:
        if self._code is None:
            os.kill(self._pid, 9)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.stdout.close()
        self.wait()


def fork_from_now_on() -> None:
    """Let the trial of damaged files fork."""

    class Forking:
        Popen = Forked
        PIPE, DEVNULL, TimeoutExpired = subprocess.PIPE, subprocess.DEVNULL, subprocess.TimeoutExpired

    probe.subprocess = Forking  # type: ignore[attr-defined]
