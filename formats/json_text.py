"""JSON from a file and numbers from JSON, with a clear line for everything that is not what it should be."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError


def load(path: Path) -> Any:
    """The value in a JSON file.

    Raises InputError, with line and column where there are any, when the file is missing, empty, no text, or no JSON;
    NaN, Infinity and keys that stand twice are faults too.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(error.strerror or "cannot be read", where=str(path), mend="check the name") from error
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"byte {error.start + 1} is no UTF-8 text", where=str(path)) from None
    if not text.strip():
        raise InputError("the file is empty", where=str(path))
    try:
        return json.loads(text, parse_constant=_constant, object_pairs_hook=_once)
    except json.JSONDecodeError as error:
        raise InputError(f"no JSON: {error.msg}", where=f"{path}, line {error.lineno}, column {error.colno}") from None
    except RecursionError:
        raise InputError("no JSON that can be read: it is nested too deeply", where=str(path)) from None
    except ValueError as error:
        raise InputError(str(error), where=str(path)) from None


def _constant(word: str) -> float:
    raise ValueError(f"the number {word} is not finite")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key {key!r} stands twice in one object")
        found[key] = value
    return found


def numbers(value: object, where: str, dimensions: int, last: int = 0) -> NDArray[np.float64]:
    """Nested lists of numbers as an array of this many dimensions, the last of length `last` when that is given.

    Raises InputError saying what is needed at `where`, and for a number that is not finite in which place.
    """
    try:
        array = np.array(value)
    except (ValueError, OverflowError):
        array = np.empty(0, dtype=object)
    if (
        array.ndim != dimensions
        or array.dtype.kind not in "iuf"
        or (last and array.shape[-1] != last)
        or not array.size
    ):
        inner = f"points of {last} numbers" if last else "numbers"
        outer = dimensions - 1 if last else dimensions
        rows = ", every row as long as the others," if outer > 1 else ""
        raise InputError(f"{'a list of lists of ' if outer > 1 else 'a list of '}{inner}{rows} is needed", where=where)
    result = array.astype(np.float64)
    if not np.isfinite(result).all():
        place = "".join(f"[{k}]" for k in np.argwhere(~np.isfinite(result))[0])
        raise InputError("a number is not finite", where=where + place)
    return result
