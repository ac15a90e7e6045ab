"""cadsculpt: push tools into B-spline CAD parts and get the same part back."""

from __future__ import annotations

from ._version import __version__

__all__ = ["__version__"]
