"""Whether openNURBS survives a 3DM file, tried out in a process of its own.

A few changed bytes can make it run for ever or crash, beyond what Python can catch. Its archives have checksums, but which
bytes they are of only the reader of each object knows. The child costs a fifth of a second and loads nothing else.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys

from ...errors import InputError

SECONDS = 5.0
"""Least time for the child, plus one second a megabyte: ten times what sound files take."""

CHILD = """
import sys
import rhino3dm
model = rhino3dm.File3dm.FromByteArray(sys.stdin.buffer.read())
for thing in model.Objects if model is not None else ():
    if type(thing.Geometry).__name__ == "Extrusion":
        thing.Geometry.ToBrep(True)
"""

_survived: set[bytes] = set()


def ensure_survives(data: bytes) -> None:
    """Raise InputError when reading these bytes kills openNURBS or does not end. The same bytes are tried once."""
    digest = hashlib.sha256(data).digest()
    if digest in _survived:
        return
    try:
        done = subprocess.run(
            [sys.executable, "-c", CHILD],
            input=data,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=SECONDS + len(data) / 1e6,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise InputError("openNURBS does not finish reading it", mend="the file is damaged: export it again") from error
    if done.returncode < 0 or done.returncode > 2:
        raise InputError("openNURBS crashes on it", mend="the file is damaged: export it again")
    _survived.add(digest)
