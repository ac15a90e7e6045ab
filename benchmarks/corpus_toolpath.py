"""Our canonical moves of a G-code program beside those that a reference interpreter made of it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from cadsculpt.formats.paths import gcode

PRINTED = 1.0001e-4
"""The reference prints four decimals; ours may round the other way."""


def matches(path: Path) -> dict[str, Any]:
    """toolpath_expected_match, the number of moves, and where the first difference is. `path` ends in .ngc.expected."""
    wanted = expected_moves(path.read_text())
    moves, warnings = gcode.canonical_moves(path.with_suffix("").read_text(), path.stem)
    fault = "" if len(moves) == len(wanted) else f"{len(moves)} moves, {len(wanted)} expected"
    for number, (move, (call, numbers, feed, unit)) in enumerate(zip(moves, wanted, strict=False), 1):
        ours, _, rest = move.canonical().rstrip(")").partition("(")
        mine = [float(n) for n in rest.split(",")]
        same = ours == call and len(mine) == len(numbers) and np.abs(np.subtract(mine, numbers)).max() <= PRINTED
        same = same and (move.unit or "mm") == unit and (move.kind not in ("feed", "arc") or move.feed == feed)
        if not same:
            fault = fault or f"move {number}: {move.canonical()}, expected {call}{numbers}"
            break
    return {
        "toolpath_expected_match": not fault and len(moves) > 1,
        "moves": len(moves),
        **({"first_difference": fault} if fault else {}),
        "warnings": list(warnings),
    }


def expected_moves(text: str) -> list[tuple[str, list[float], float, str]]:
    """(call, numbers, feed, unit) of every move that the reference printed."""
    found: list[tuple[str, list[float], float, str]] = []
    feed, unit = 0.0, "mm"
    for line in text.splitlines():
        call = re.search(r"([A-Z_0-9]+)\((.*)\)", line)
        if not call:
            continue
        if call[1] == "SET_FEED_RATE":
            feed = float(call[2])
        elif call[1] == "USE_LENGTH_UNITS" and not found:
            unit = {"CANON_UNITS_MM": "mm", "CANON_UNITS_INCHES": "in"}[call[2]]
        elif call[1] in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED", "ARC_FEED", "DWELL"):
            found.append((call[1], [float(n) for n in call[2].split(",")], feed, unit))
    return found
