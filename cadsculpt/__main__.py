"""`python -m cadsculpt`: the command line, found by name because the engine knows nothing of the rooms above it."""

from __future__ import annotations

import importlib

if __name__ == "__main__":
    importlib.import_module("cadsculpt.cli.main").main()
