"""Tool paths as G-code (RS274/NGC): G0 to G3, dwells, planes, units, offsets, feeds, O-words, five axes.

The lengths are those of G20 or G21, else of the scene. A path begins where the first moves lead, an axis that the rapid moves
at the beginning have not named yet standing where they first send it. Places are the machine's own: work offsets count where
the program sets them (G10, G92). Tool length offsets (G43) change nothing, because the path is the tool's tip. Cutter
compensation is followed where the diameter stands in the program (G41.1 D, G42.1 D).
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError, SceneError
from ...motion.path import ToolPath
from ...scene_tool import PathOptions
from ...spec import one_line
from ...units import conversion
from .gcode_flow import Program, ProgramError
from .gcode_machine import Machine
from .gcode_moves import PLANES, Move
from .gcode_words import LineError, words_of
from .machine_axes import MachineAxes
from .path_rows import RAPID_TURN, PathRows, ReadPath, arc_length, arc_points
from .path_text import text_of_file

Array = NDArray[np.float64]

SUFFIXES = (".ngc", ".nc", ".gcode", ".tap", ".cnc")
TURN_PIECE = 3.0
"""Degrees that rotary axes turn in one piece of a move: between rows a path turns about one axis."""
MOST_MOVES = 1_000_000


def read(path: str | os.PathLike[str], units: str = "mm", options: PathOptions | None = None) -> ReadPath:
    """The tool path of a G-code file, lengths in `units`.

    Raises SceneError with one "file:line: what" for the first fault of the program, InputError for a file that cannot be
    read or moves nothing.
    """
    return parse(text_of_file(Path(path)), str(path), units, options)


def parse(text: str, where: str, units: str = "mm", options: PathOptions | None = None) -> ReadPath:
    """The tool path of a text; `where` names it in errors. Raises as `read` does."""
    options = options or PathOptions()
    moves, warnings = canonical_moves(text, where, options, units)
    if any(move.unit == "" for move in moves) and options.units is None:
        warnings.append(f"names no unit (G20, G21): its lengths are taken in {units}")
    return ReadPath(_path(moves, where, units, options), tuple(f"{where}: {line}" for line in warnings))


def canonical_moves(
    text: str, where: str, options: PathOptions | None = None, units: str = "mm"
) -> tuple[list[Move], list[str]]:
    """The moves that a program makes, and warnings. Raises SceneError for the first fault, with its line."""
    options = options or PathOptions()
    moves: list[Move] = []
    number = 1
    try:
        program = Program(text, options.block_delete)
        machine = Machine(program.parameters, options.units or units)
        for line in program.run():
            number = line.number
            moves += machine.run(words_of(line.code, program.parameters), number)
            if machine.ended:
                break
            if len(moves) > MOST_MOVES:
                raise LineError(f"the program makes more than {MOST_MOVES} moves")
        moves += machine.finish()
    except ProgramError as error:
        raise _fault(where, error.number, error.fault) from None
    except LineError as fault:
        raise _fault(where, number, fault) from None
    except RecursionError:
        raise _fault(where, number, LineError("subs and loops stand too deep in each other")) from None
    warnings = [f"line {line}: {what}" for what, line in machine.warnings.items()]
    if not (machine.ended or program.ended):
        warnings.append("ends without M2, M30 or %: it may have been cut off")
    return moves, warnings


def _fault(where: str, number: int, fault: LineError) -> SceneError:
    mend = f" ({fault.mend})" if fault.mend else ""
    return SceneError([f"{where}:{number}: {one_line(fault.what + mend)}"])


# ---------------------------------------------------------------------- from moves to rows


def _path(moves: Sequence[Move], where: str, units: str, options: PathOptions) -> ToolPath:
    """The rows of the moves. Raises SceneError naming the line that cannot be followed."""
    axes = MachineAxes.of(options)
    rows = PathRows(units, options)
    line = 1
    try:
        for move in _from_somewhere(moves):
            line = move.line
            if move.kind == "dwell":
                rows.wait(move.seconds)
                continue
            _check_axes(move, axes)
            factor = conversion(move.unit or options.units or units, units)
            start, end = (_placed(place, move, factor) for place in (move.start, move.end))
            if not rows.begun:
                rows.begin(*_pose(end if move.kind == "traverse" else start, axes))
                if move.kind == "traverse":
                    continue
            if move.kind == "arc":
                places, length = _arc(move, start, end, factor, rows.tolerance)
            else:
                places, length = [end], float(np.linalg.norm(end[:3] - start[:3]))
            turned = float(np.abs(end[3:] - start[3:]).max())
            if turned and axes is not None:
                places = _turning(start, places, _pieces(turned, start, end, axes, rows.tolerance))
            seconds = _seconds(move, length, turned, factor, rows.rapid) / len(places)
            for place in places:
                rows.move(*_pose(place, axes), seconds)
        return rows.path(where)
    except LineError as fault:
        raise _fault(where, line, fault) from None
    except InputError as error:
        if error.where:
            raise
        raise _fault(where, line, LineError(error.what, error.mend)) from None


def _from_somewhere(moves: Sequence[Move]) -> list[Move]:
    """The moves with the rapid ones at the beginning sent to where their unnamed axes go first.

    Whoever writes "G0 X10 Y20" and then "G0 Z5" does not mean that the tool begins at Z0, in the part.
    """
    lead = list(takewhile(lambda move: move.kind in ("traverse", "dwell"), moves))
    first: dict[int, float] = {}
    changed: list[Move] = []
    for move in reversed(lead):
        first |= {i: move.end[i] for i in range(6) if i not in move.unnamed}
        x, y, z, a, b, c = (first.get(i, move.end[i]) if i in move.unnamed else move.end[i] for i in range(6))
        changed.append(replace(move, end=(x, y, z, a, b, c)))
    changed.reverse()
    for i in range(1, len(changed)):
        changed[i] = replace(changed[i], start=changed[i - 1].end)
    return changed + list(moves[len(lead) :])


def _check_axes(move: Move, axes: MachineAxes | None) -> None:
    for i, name in enumerate("ABC", start=3):
        if not (move.start[i] + move.offset[i] or move.end[i] + move.offset[i]):
            continue
        if axes is None:
            raise LineError(
                f"the axis {name} turns, and no kinematics is given",
                'write path_options = { kinematics = "xyzac-trt" } or the machine\'s own: xyzbc-trt, xyzac-head, xyzbc-head',
            )
        if not axes.allows(i):
            raise LineError(f"the axis {name} turns, which the kinematics does not have", "choose another kinematics")


def _placed(place: Sequence[float], move: Move, factor: float) -> Array:
    """A place (6,) of a move in the machine's frame and the scene's unit."""
    result = np.array(place) + np.array(move.offset)
    result[:3] *= factor
    return result


def _pose(place: Array, axes: MachineAxes | None) -> tuple[Array, Array]:
    return (place[:3], np.eye(3)) if axes is None else axes.pose(place)


def _arc(move: Move, start: Array, end: Array, factor: float, tolerance: float) -> tuple[list[Array], float]:
    """The places (6,) of an arc behind its start, and its length; other axes go along evenly."""
    first, second, third = PLANES[move.plane]
    centre, axis = np.array(start[:3]), np.zeros(3)
    axis[third] = 1.0
    for i, value in zip((first, second), move.centre, strict=True):
        centre[i] = (value + move.offset[i]) * factor
    points = list(arc_points(start[:3], end[:3], centre, axis, move.sweep, tolerance))
    shares = np.arange(1, len(points) + 1) / len(points)
    turned = start[3:] + shares[:, None] * (end[3:] - start[3:])
    length = arc_length(start[:3], end[:3], centre, axis, move.sweep)
    return list(np.concatenate([np.array(points), turned], axis=1)), length


def _pieces(turned: float, start: Array, end: Array, axes: MachineAxes, tolerance: float) -> int:
    """In how many pieces a move goes whose rotary axes turn by that many degrees."""
    piece = TURN_PIECE
    if not axes.tip:  # the tip swings around the rotary axes
        pivot = np.array(axes.pivot)
        arm = axes.reach + max(float(np.linalg.norm(place[:3] - pivot)) for place in (start, end))
        if arm > tolerance:
            piece = min(piece, math.degrees(2.0 * math.acos(1.0 - 0.25 * tolerance / arm)))
    return max(math.ceil(turned / piece), 1)


def _turning(start: Array, places: list[Array], pieces: int) -> list[Array]:
    """The places with so many more in between that rotary axes turn in pieces."""
    each = math.ceil(pieces / len(places))
    if each * len(places) > MOST_MOVES:
        raise LineError(f"the move turns in more than {MOST_MOVES} pieces", "turn less in one line")
    found: list[Array] = []
    for place in places:
        found += [start + k / each * (place - start) for k in range(1, each)]
        found.append(place)
        start = place
    return found


def _seconds(move: Move, length: float, turned: float, factor: float, rapid: float) -> float:
    """How long a move takes, s."""
    if not (length or turned):
        return 0.0
    if move.kind == "traverse":
        return max(length / rapid, turned / RAPID_TURN)
    if move.inverse:
        return 60.0 / move.feed
    return 60.0 * (length / (move.feed * factor) if length else turned / move.feed)
