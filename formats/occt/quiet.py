"""Keep OCCT off the terminal.

OCCT and its translators write to the process's own standard output from C++, where redirecting `sys.stdout` does not
reach. `quiet()` sends file descriptors 1 and 2 to nowhere while a call of OCCT runs.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_lock = threading.RLock()
_depth = 0


def _flush() -> None:
    """Empty the buffers of Python and of the C library, so that text goes where it was written to."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):
            stream.flush()
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None if os.name != "nt" else "ucrtbase").fflush(None)


@contextmanager
def quiet() -> Iterator[None]:
    """Nothing that OCCT prints inside reaches the terminal; may be nested; closed descriptors are left closed."""
    global _depth
    with _lock:
        if _depth:
            _depth += 1
            try:
                yield
            finally:
                _depth -= 1
            return
        from OCP.Message import Message

        for printer in list(Message.DefaultMessenger_s().Printers()):
            Message.DefaultMessenger_s().RemovePrinter(printer)
        _flush()
        saved: list[tuple[int, int]] = []
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for descriptor in (1, 2):
            with suppress(OSError):
                saved.append((descriptor, os.dup(descriptor)))
                os.dup2(nowhere, descriptor)
        os.close(nowhere)
        _depth = 1
        try:
            yield
        finally:
            _depth = 0
            _flush()
            for descriptor, copy in saved:
                os.dup2(copy, descriptor)
                os.close(copy)
