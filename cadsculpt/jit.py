"""The one way into numba: cached, GIL-free kernels, compiled once per machine and version.

The cache lies in the user's cache folder, so that a read-only install works. `NUMBA_CACHE_DIR`, when set,
wins. `first_compilation()` tells whether this machine has never compiled these kernels, so that a run can say so;
`on_compilation()` tells the moment when one must be compiled, so that others can.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numba
import platformdirs
from numba.core import event, types

from ._version import __version__

F = TypeVar("F", bound=Callable[..., Any])


def _fingerprint() -> str:
    """A hash of the engine's sources: numba does not see that a kernel has changed which another one calls."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    if "NUMBA_CACHE_DIR" in os.environ:
        return Path(os.environ["NUMBA_CACHE_DIR"])
    folder = Path(platformdirs.user_cache_dir("cadsculpt")) / f"kernels-{__version__}-{_fingerprint()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"cadsculpt-{folder.name}"
        folder.mkdir(parents=True, exist_ok=True)
    return folder


CACHE_FOLDER = _cache_folder()
numba.config.CACHE_DIR = str(CACHE_FOLDER)


def first_compilation() -> bool:
    """True when no compiled kernel of this version lies in the cache yet."""
    return next(CACHE_FOLDER.rglob("*.nbi"), None) is None


class _First(event.Listener):  # type: ignore[misc]
    """Calls back at the first kernel that is compiled; those that the cache holds are not."""

    def __init__(self, tell: Callable[[], object]) -> None:
        self.tell, self.told = tell, False

    def on_start(self, event: Any) -> None:
        if not self.told:
            self.told = True
            self.tell()

    def on_end(self, event: Any) -> None:
        pass


@contextmanager
def on_compilation(tell: Callable[[], object]) -> Iterator[None]:
    """Within the context, call `tell` once, when a kernel must be compiled that the cache does not hold."""
    with event.install_listener("numba:compile", _First(tell)):
        yield


def _once(dispatcher: Any) -> Any:
    """The same kernel for all constants: numba would compile it again for each integer that a kernel calls it with."""
    template, plain = dispatcher.get_call_template, types.unliteral  # type: ignore[attr-defined]
    dispatcher.get_call_template = lambda args, kws: template(
        tuple(map(plain, args)), {name: plain(value) for name, value in kws.items()}
    )
    return dispatcher


def njit(function: F) -> F:
    """Compile with `cache=True, nogil=True` and no fastmath: signs that decide geometry must be IEEE's."""
    return _once(numba.njit(cache=True, nogil=True, fastmath=False)(function))  # type: ignore[no-any-return]


def njit_in_place(function: F) -> F:
    """As `njit`, for kernels that allocate nothing, call none that does, and return numbers alone: numba then counts no
    references, which costs an atomic operation for every array that a call, a slice or a field of a tuple hands on."""
    return _once(numba.njit(cache=True, nogil=True, fastmath=False, _nrt=False)(function))  # type: ignore[no-any-return]


def njit_inline(function: F) -> F:
    """As `njit`, always inlined by LLVM's caller: for the scalar pieces of a kernel."""
    return _once(numba.njit(cache=True, nogil=True, fastmath=False, forceinline=True)(function))  # type: ignore[no-any-return]


def njit_inline_in_place(function: F) -> F:
    """As `njit_in_place`, always inlined."""
    return _once(numba.njit(cache=True, nogil=True, fastmath=False, forceinline=True, _nrt=False)(function))  # type: ignore[no-any-return]
