"""Fixtures that every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


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
