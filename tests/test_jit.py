"""The way into numba: how often kernels are compiled, and that others can tell."""

from __future__ import annotations

import ast
import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

import cadsculpt
from cadsculpt.jit import on_compilation

KERNELS = """
from cadsculpt.jit import njit, njit_inline

@njit
def entry(x, k):
    return x[k] + k

@njit_inline
def inline(x, k):
    return x[k] - k

@njit
def total(x):
    return entry(x, 0) + entry(x, 1) + entry(x, len(x) - 1) + inline(x, 0) + inline(x, 2)
"""


def kernels(path: Path) -> ModuleType:
    """The module, as a new process would see it."""
    spec = importlib.util.spec_from_file_location("cadsculpt_test_kernels", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_a_kernel_is_compiled_once_whatever_constants_it_is_called_with(tmp_path):
    path = tmp_path / "kernels.py"
    path.write_text(KERNELS)
    module = kernels(path)
    x = np.array([1.0, 20.0, 300.0])
    assert module.total(x) == 1.0 + 21.0 + 302.0 + 1.0 + 298.0
    assert len(module.entry.signatures) == 1
    assert len(module.inline.signatures) == 1


def test_a_compilation_is_told_once_and_a_cached_kernel_is_none(tmp_path):
    path = tmp_path / "kernels.py"
    path.write_text(KERNELS)
    told: list[str] = []
    with on_compilation(lambda: told.append("compiling")):
        kernels(path).total(np.ones(3))
    assert told == ["compiling"]
    with on_compilation(lambda: told.append("again")):
        assert kernels(path).total(np.ones(3)) == 6.0
    assert told == ["compiling"]
    kernels(path).total(np.ones(3, dtype=np.float32))
    assert told == ["compiling"]


def test_kernels_that_count_no_references_return_numbers_alone():
    """An array that one of them returned would be freed by its caller, which believes that it owns a reference."""
    plain, found = {"None", "int", "float", "bool", "tuple"}, 0
    for path in Path(cadsculpt.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.FunctionDef):
                continue
            if any("in_place" in ast.unparse(decorator) for decorator in node.decorator_list):
                returns = ast.unparse(node.returns) if node.returns is not None else "nothing"
                assert set(re.findall(r"\w+", returns)) <= plain, f"{path.name}: {node.name} returns {returns}"
                found += 1
    assert found > 50
