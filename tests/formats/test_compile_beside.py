"""A second process that compiles beside this one."""

from __future__ import annotations

import os
import time
from pathlib import Path

from numba.core import event

from cadsculpt.formats.compile_beside import compile_beside


def a_kernel_is_compiled() -> None:
    with event.trigger_event("numba:compile", data={}):
        pass


def test_nothing_starts_where_nothing_is_compiled(tmp_path):
    told: list[str] = []
    with compile_beside(os.mkdir, str(tmp_path / "made"), tell=lambda: told.append("compiling")) as beside:
        beside.wait()
    assert told == []
    assert not (tmp_path / "made").exists()


def test_the_function_is_called_once_in_another_process(tmp_path):
    told: list[str] = []
    with compile_beside(os.mkdir, str(tmp_path / "made"), tell=lambda: told.append("compiling")) as beside:
        a_kernel_is_compiled()
        a_kernel_is_compiled()
        beside.wait()
        assert (tmp_path / "made").is_dir()
    assert told == ["compiling"]


def test_it_ends_with_the_context(tmp_path: Path):
    start = time.monotonic()
    with compile_beside(time.sleep, 600):
        a_kernel_is_compiled()
    assert time.monotonic() - start < 60.0


def test_a_second_process_that_fails_does_no_harm():
    with compile_beside(os.mkdir, "/nowhere/at/all") as beside:
        a_kernel_is_compiled()
        beside.wait()
