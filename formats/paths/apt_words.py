"""The statements of an APT file, and the numbers and words in them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .gcode_words import LineError

Array = NDArray[np.float64]

LONGEST = 100_000
"""Signs of one statement with all its continuation lines."""

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")


def statements(text: str) -> Iterator[tuple[int, str]]:
    """Each statement with the number of its first line, comments and continuation marks taken out. Raises LineError."""
    held, first = "", 0
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.split("$$", 1)[0].rstrip()
        first = first or number
        if line.endswith("$"):
            held += line[:-1]
            if len(held) > LONGEST:
                raise LineError(f"a statement of more than {LONGEST} signs")
            continue
        held += line
        if held.strip():
            yield first, held.strip()
        held, first = "", 0
    if held.strip():
        yield first, held.strip()


def numbers_and_words(rest: str) -> tuple[list[float], list[str]]:
    """What stands behind a slash: the numbers, and the other fields in capitals. Raises LineError for no finite number."""
    values: list[float] = []
    words: list[str] = []
    for field in (field.strip() for field in rest.split(",")):
        if _NUMBER.fullmatch(field):
            values.append(float(field.upper().replace("D", "E")))
            if not math.isfinite(values[-1]):
                raise LineError(f"{field} is not a finite number")
        elif field:
            words.append(field.upper())
    return values, words


def number_behind(fields: list[str], name: str) -> float | None:
    """The number in the field behind a name; None where there is none."""
    if name not in fields[:-1]:
        return None
    values, _ = numbers_and_words(fields[fields.index(name) + 1])
    return values[0] if values else None


def unit_vector(values: list[float], what: str) -> Array:
    """A direction (3,) of unit length; `what` names it in the fault. Raises LineError where it has none."""
    vector = np.array(values, dtype=np.float64)
    length = float(np.linalg.norm(vector))
    if not (length > 1e-9 and math.isfinite(length)):
        raise LineError(f"{what} has no length")
    return vector / length
