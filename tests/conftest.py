"""Fixtures that every test may use."""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

# the same examples every time: a change is blamed for what it breaks, and for nothing else
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("random", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


@pytest.fixture(scope="session")
def corpus() -> Path:
    """The folder of real CAD files named by CADSCULPT_CORPUS; tests that need it skip, saying so, where it is unset."""
    folder = os.environ.get("CADSCULPT_CORPUS")
    if not folder:
        pytest.skip("CADSCULPT_CORPUS is not set: the tests on real CAD files did not run")
    path = Path(folder)
    if not path.is_dir():
        pytest.fail(f"CADSCULPT_CORPUS names no folder: {path}")
    return path


@pytest.fixture(scope="module")
def part():
    """A module of benchmarks/ by its name."""
    benchmarks = Path(__file__).parents[1] / "benchmarks"
    sys.path.insert(0, str(benchmarks))
    try:
        yield importlib.import_module
    finally:
        sys.path.remove(str(benchmarks))
