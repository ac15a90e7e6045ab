"""Whether the CAD kernel survives a damaged file, tried out in a process of its own.

The kernel's translators can crash, beyond what Python can catch, or run for ever on files whose entities refer to the
wrong things. A file that looks damaged is therefore read by a child first; the child's end costs nothing.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

from ...errors import InputError

SECONDS = 10.0
"""Time given to a child once it is ready. The kernel takes a second for 200 kB of a sound file on a busy machine, and the file
is read a second time when the child has survived: together a truncated one is answered in half a minute."""

BYTES_PER_SECOND = 5e4
"""A file that is whole but for some faults gets a second for so many bytes, where that is more: a large one needs it."""

START = 60.0
"""Seconds until a child is ready; they go into loading the kernel, not into the file."""

CHILD = """
import json, os, sys
sys.path[:] = json.loads(sys.argv[1])
from cadsculpt.formats.occt.probe import main
main(*sys.argv[2:])
os._exit(0)
"""
"""The program of a child: it finds modules where its parent does. The kernel's own tidying up is none of the question."""


def ensure_survives(path: Path, format: str, *, complete: bool) -> None:
    """Raise InputError when reading the file as `format` ("step" or "iges") kills the kernel or does not end.

    complete : the file has its end, and may be as large as it is for good reason.
    """
    limit = max(SECONDS, path.stat().st_size / BYTES_PER_SECOND) if complete else SECONDS
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, json.dumps(sys.path), format, str(path)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    with child:
        try:
            ready = _await_ready(child)
            code = child.wait(limit)
        except subprocess.TimeoutExpired as error:
            raise InputError(
                f"the file is damaged: the CAD kernel does not finish reading it in {limit:.0f} s",
                where=str(path),
                mend="export it again",
            ) from error
        finally:
            child.kill()
    if not ready:
        raise InputError(
            f"the file is damaged, and the process that should try it first does not start (it ended with {code})",
            where=str(path),
            mend="export or copy it again",
        )
    if code != 0:
        raise InputError(
            "the file is damaged: the CAD kernel crashes on it", where=str(path), mend="export or copy it again"
        )


def _await_ready(child: subprocess.Popen[bytes]) -> bool:
    """Wait for the child's first byte, or its end; whether the byte came."""
    said: list[bytes] = []
    waiting = threading.Thread(target=lambda: said.append(child.stdout.read(1) if child.stdout else b""), daemon=True)
    waiting.start()
    waiting.join(START)
    if waiting.is_alive():
        raise subprocess.TimeoutExpired(CHILD, START)
    return said == [b"\n"]


def main(format: str, path: str) -> None:
    """Read and transfer a file as the readers do; what goes wrong in an orderly way is theirs to say."""
    if format == "step":
        from ..step import load
    else:
        from ..iges import load  # type: ignore[assignment]
    os.write(1, b"\n")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # nobody reads on
    with suppress(InputError):
        load(Path(path), probing=True)
