"""Whether the CAD kernel survives a damaged file, tried out in a process of its own.

The kernel's translators can crash, beyond what Python can catch, or run for ever on files whose entities refer to the
wrong things. A file that looks damaged is therefore read by a child first; the child's end costs nothing.
"""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from ...errors import InputError

LEAST_SECONDS = 20.0
"""Time given to a child, plus one second for every 50 kB: ten times what sound files take."""


def ensure_survives(path: Path, format: str) -> None:
    """Raise InputError when reading the file as `format` ("step" or "iges") kills the kernel or does not end."""
    limit = LEAST_SECONDS + path.stat().st_size / 5e4
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(entry for entry in sys.path if entry))
    command = [sys.executable, "-m", "cadsculpt.formats.occt.probe", format, str(path)]
    try:
        done = subprocess.run(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=limit,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise InputError(
            f"the file is damaged: the CAD kernel does not finish reading it in {limit:.0f} s",
            where=str(path),
            mend="export it again",
        ) from error
    if done.returncode != 0:
        raise InputError(
            "the file is damaged: the CAD kernel crashes on it", where=str(path), mend="export or copy it again"
        )


def main(format: str, path: str) -> None:
    """Read and transfer a file as the readers do; what goes wrong in an orderly way is theirs to say."""
    if format == "step":
        from .. import step

        step.load(Path(path), probing=True)
    else:
        from .. import iges

        iges.load(Path(path), probing=True)


if __name__ == "__main__":
    with suppress(InputError):
        main(sys.argv[1], sys.argv[2])
    # the kernel's own tidying up is none of the question
    os._exit(0)
