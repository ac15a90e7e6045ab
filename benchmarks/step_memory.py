"""What a step allocates of numpy's array memory, at most at once: `array_bytes`."""

from __future__ import annotations

import sys
import tracemalloc
from collections.abc import Callable
from types import FrameType
from typing import Any

import numpy as np

ARRAYS = tracemalloc.DomainFilter(True, np.lib.tracemalloc_domain)
"""The data of arrays alone: not the array objects, which a view has too, nor any other object of Python's."""


def array_bytes(step: Callable[[], object]) -> int:
    """The most array data [bytes] allocated within one call of `step` that was alive at once.

    It is looked at between every two instructions of Python's within the call, so that what lives only from one expression to
    the next counts as well. What kernels work in while they run is not seen: numba has an allocator of its own.
    """
    most = 0

    def look(frame: FrameType, event: str, arg: Any) -> Any:
        nonlocal most
        frame.f_trace_opcodes = True
        traces = tracemalloc.take_snapshot().filter_traces([ARRAYS]).traces
        most = max(most, sum(trace.size for trace in traces))
        return look

    step()  # (what is allocated here was there before, and is not seen)
    tracemalloc.start()
    sys.settrace(look)
    try:
        step()
    finally:
        sys.settrace(None)
        tracemalloc.stop()
    return most


def object_bytes(step: Callable[[], object]) -> int:
    """The most of all memory of Python's, small objects among them, that one call of `step` holds at once [bytes]."""
    step()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        step()
        return tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
