"""Collision, in the paper's order (sections 4.3 to 4.7), certified distance, and collision in time.

The package can be called, for it bears the name of the public function: `cs.collide(a, b, clearance=0.0)` is
`cadsculpt.collision.collide`, which documents its arguments.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any


class _CallablePackage(ModuleType):
    def __call__(self, *bodies: Any, **options: Any) -> Any:
        # what is called lies above this package, and is loaded late, by name
        return importlib.import_module("cadsculpt.collision").collide(*bodies, **options)


sys.modules[__name__].__class__ = _CallablePackage
