"""Tool paths as APT cutter location data (ISO 4343): GOTO, GODLTA, FROM, RAPID, FEDRAT, circles, drilling cycles.

    GOTO/x,y,z[,i,j,k]      a straight move; i, j, k point from the tip up the tool and become a rotation
    CIRCLE/x,y,z,i,j,k,...  the next GOTO is reached on this circle, right-handed about i, j, k; a whole turn to its own start
    INDIRV/..., TLON,GOFWD/(CIRCLE/x,y,z,r),ON,(LINE/x,y,z,x,y,z)      the same as CATIA writes it
    CYCLE/DRILL,FEDTO,d,...,RAPTO,r,RTRCTO,t      each GOTO up to CYCLE/OFF is a hole: down by d, in one stroke
    UNITS/MM, FEDRAT/f,MMPM, TLAXIS/i,j,k, MULTAX, FINI

$$ begins a comment, $ at the end of a line goes on in the next. What does not move the tool is passed over; words that are not
known are passed over with a warning. The path is the tool's tip as the file gives it: CUTCOM is left to the machine.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError, SceneError
from ...motion.path import rotation_to_axis
from ...scene_tool import PathOptions
from ...spec import one_line
from ...units import conversion
from .apt_words import number_behind, numbers_and_words, statements, unit_vector
from .gcode_moves import arc_sweep
from .gcode_words import LineError
from .path_rows import RAPID_TURN, PathRows, ReadPath, arc_length, arc_points, turn_between
from .path_text import text_of_file

Array = NDArray[np.float64]

SUFFIXES = (".apt", ".cls", ".ncl", ".aptsource")

_SILENT = {
    "PARTNO", "PPRINT", "REMARK", "INSERT", "MACHIN", "COOLNT", "SPINDL", "SELECT", "SELCTL", "DISPLY", "PAINT", "AUXFUN",
    "PREFUN", "OPSTOP", "STOP", "LEADER", "CLRSRF", "INTOL", "OUTTOL", "TOLER", "CUTTER", "FINI", "END", "TPRINT",
    "PRINT", "SEQNO", "OPSKIP", "THICK", "PLUNGE", "CLAMP", "VERIFY", "CHECK", "MODE", "GOHOME", "TRNTYP", "LETTER",
    "MSYS", "TOOL", "TOOLNO", "TOOL PATH", "END-OF-PATH", "REWIND", "RESET", "HEAD", "ARCSLP", "ISTOP", "RAPTO",
}  # fmt: skip
_STROKES = {
    "DRILL",
    "DEEP",
    "DEEP2",
    "DEEPCL",
    "BRKCHP",
    "BRKCHP2",
    "FACE",
    "CSINK",
    "REAM",
    "BORE",
    "TAP",
    "CENTER",
    "CTRDRL",
}
_PER_MINUTE = {"MMPM": "mm", "IPM": "in", "PERMIN": "", "MPM": "m", "UPM": ""}
_PER_TURN = {"MMPR": "mm", "IPR": "in", "PERREV": "", "UPR": ""}
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class _Circle:
    """centre (3,) in the scene's unit, axis (3,) of unit length; the way is right-handed about it."""

    centre: Array
    axis: Array


@dataclass(frozen=True, slots=True)
class _Cycle:
    """Heights over a hole's place along the tool, in the scene's unit; feed in the scene's unit per minute."""

    depth: float
    near: float
    away: float
    feed: float


def read(path: str | os.PathLike[str], units: str = "mm", options: PathOptions | None = None) -> ReadPath:
    """The tool path of an APT file, lengths in `units`.

    Raises SceneError with one "file:line: what" for the first fault, InputError for a file that cannot be read or moves
    nothing.
    """
    return parse(text_of_file(Path(path)), str(path), units, options)


def parse(text: str, where: str, units: str = "mm", options: PathOptions | None = None) -> ReadPath:
    """The tool path of a text; `where` names it in errors. Raises as `read` does."""
    reader = _Reader(units, options or PathOptions())
    line = 1
    try:
        for line, statement in statements(text):
            reader.run(statement, line)
            if reader.ended:
                break
        if not reader.ended:
            reader.warn("ends without FINI: it may have been cut off", 0)
        if reader.own_units is None:
            reader.warn(f"names no unit (UNITS): its lengths are taken in {units}", 0)
        path = reader.rows.path(where)
    except LineError as fault:
        mend = f" ({fault.mend})" if fault.mend else ""
        raise SceneError([f"{where}:{line}: {one_line(fault.what + mend)}"]) from None
    except InputError as error:
        if error.where:
            raise
        raise SceneError([f"{where}:{line}: {one_line(str(error))}"]) from None
    rows = (f"{where}: " + (f"line {number}: {what}" if number else what) for what, number in reader.warnings.items())
    return ReadPath(path, tuple(rows))


class _Reader:
    """Modes, and the rows so far."""

    def __init__(self, units: str, options: PathOptions) -> None:
        self.rows = PathRows(units, options)
        self.warnings: dict[str, int] = {}
        self.ended = False
        self._units = units
        self.own_units: str | None = options.units
        self._factor = conversion(options.units or units, units)
        self._axis = _UP
        self._rapid = False
        self._feed = 0.0  # of the scene's unit per minute
        self._per_turn = False
        self._speed = 0.0
        self._circle: _Circle | None = None
        self._toward: Array | None = None
        self._cycle: _Cycle | None = None
        self._skips = False
        self._tools = 0

    def warn(self, text: str, line: int) -> None:
        """Keep a warning with the first line that earns it."""
        self.warnings.setdefault(text, line)

    def run(self, statement: str, line: int) -> None:
        """One statement. Raises LineError."""
        head, _, rest = statement.partition("/")
        word = head.split(",")[0].strip().upper()
        if word == "TOOL PATH":  # NX: TOOL PATH/NAME,TOOL,NAME
            return
        known = _STATEMENTS.get(word)
        if known is not None:
            known(self, rest.strip(), line)
        elif word in ("MM", "INCHES", "CM"):
            self._unit(word, line)
        elif word in ("TLON", "TLLFT", "TLRGT", "GOFWD"):
            self._forward(statement, line)
        elif word not in _SILENT and not word.startswith("CSI_"):
            self.warn(f"{one_line(word[:30])} is not known and passed over", line)

    # ------------------------------------------------------------------ modes

    def _unit(self, rest: str, line: int) -> None:
        word = rest.split(",")[0].strip().upper()
        units = {"MM": "mm", "INCH": "in", "INCHES": "in", "CM": "cm", "M": "m", "FEET": "ft"}
        if word not in units:
            raise LineError(f'the unit "{word[:20]}" is not known', f"known are {', '.join(units)}")
        self.own_units = units[word]
        self._factor = conversion(self.own_units, self._units)

    def _rapid_next(self, rest: str, line: int) -> None:
        self._rapid = True

    def _feed_rate(self, rest: str, line: int) -> None:
        values, words = numbers_and_words(rest)
        if not values:
            if "RAPID" in words:
                self._rapid = True
                return
            raise LineError("FEDRAT without a number")
        if values[0] <= 0.0:
            raise LineError(f"the feed is {values[0]:g}", "a positive number")
        unit = ""
        self._per_turn = False
        for name in words:
            if name in _PER_MINUTE or name in _PER_TURN:
                unit = _PER_MINUTE.get(name) or _PER_TURN.get(name) or ""
                self._per_turn = name in _PER_TURN
        self._feed = values[0] * (conversion(unit, self._units) if unit else self._factor)
        self._rapid = False

    def _spindle(self, rest: str, line: int) -> None:
        values, _ = numbers_and_words(rest)
        if values:
            self._speed = values[0]

    def _tool_axis(self, rest: str, line: int) -> None:
        values, words = numbers_and_words(rest)
        if len(values) != 3:
            if words:
                raise LineError(f"TLAXIS/{rest[:30]} is not read", "write the axis as three numbers")
            raise LineError("TLAXIS needs three numbers")
        self._axis = unit_vector(values, "the tool's axis")

    def _load_tool(self, rest: str, line: int) -> None:
        self._tools += 1
        if self._tools > 1:
            self.warn("more than one tool is used: the path goes on with the scene's", line)

    def _compensation(self, rest: str, line: int) -> None:
        if rest.strip().upper() not in ("OFF", ""):
            self.warn("CUTCOM is left to the machine: the path is the tool's as the file gives it", line)

    def _system(self, rest: str, line: int) -> None:
        values, _ = numbers_and_words(rest)
        identity = [1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0, 0]
        if len(values) != 12 or values != identity:
            self.warn("CSYS is another coordinate system than the file's own: places are taken as they stand", line)

    def _placed_otherwise(self, rest: str, line: int) -> None:
        values, _ = numbers_and_words(rest)
        if any(values):
            raise LineError("a statement that moves the coordinates is not read", "write the path in one system")

    def _end(self, rest: str, line: int) -> None:
        self.ended = True

    def _dwell(self, rest: str, line: int) -> None:
        values, words = numbers_and_words(rest)
        if values and not words:
            if values[0] < 0.0:
                raise LineError("DELAY waits a negative time")
            self.rows.wait(values[0])

    def _begin_cycle(self, rest: str, line: int) -> None:
        """CYCLE/kind,FEDTO,d,...: for `_hole`. Kinds that are not known are left out, their holes with them."""
        fields = [field.strip().upper() for field in rest.split(",")]
        kind = fields[0] if fields else ""
        if kind in ("OFF", "INIT", "NOMORE", "ON"):
            if kind != "ON":
                self._cycle, self._skips = None, False
            return
        self._cycle, self._skips = None, True
        values = {name: number_behind(fields, name) for name in ("FEDTO", "DEPTH", "RAPTO", "CLEAR", "RTRCTO")}
        depth = values["FEDTO"] if values["FEDTO"] is not None else values["DEPTH"]
        if kind not in _STROKES or depth is None:
            self.warn(f"CYCLE/{one_line(kind[:20])} is not read: its holes are left out", line)
            return
        near = values["RAPTO"] if values["RAPTO"] is not None else values["CLEAR"] or 0.0
        away = values["RTRCTO"] if values["RTRCTO"] is not None else near
        feed = 0.0
        for name, unit in _PER_MINUTE.items():
            found = number_behind(fields, name)
            if found:
                feed = found * (conversion(unit, self._units) if unit else self._factor)
        if kind not in ("DRILL", "FACE", "CSINK"):
            self.warn(f"CYCLE/{kind} is followed as one stroke a hole", line)
        factor = self._factor
        self._cycle = _Cycle(abs(depth) * factor, near * factor, max(away, near) * factor, feed or self._feed)

    # ------------------------------------------------------------------ motion

    def _from(self, rest: str, line: int) -> None:
        at, axis = self._place(rest, "FROM")
        if not self.rows.begun:
            self.rows.begin(at, rotation_to_axis(axis))

    def _goto(self, rest: str, line: int) -> None:
        at, axis = self._place(rest, "GOTO")
        if self._skips:
            if self._cycle is not None:
                self._hole(at, axis)
            return
        self._go(at, axis)

    def _go_delta(self, rest: str, line: int) -> None:
        values, words = numbers_and_words(rest)
        if len(values) not in (1, 3) or words:
            raise LineError("GODLTA needs a length along the tool, or three")
        if not self.rows.begun:
            raise LineError("GODLTA before any place is known", "write FROM or GOTO first")
        step = values[0] * self._axis if len(values) == 1 else np.array(values)
        self._go(self.rows.at + step * self._factor, self._axis)

    def _place(self, rest: str, word: str) -> tuple[Array, Array]:
        """The place, scene's unit, and tool axis of a GOTO; the axis holds from now on."""
        values, words = numbers_and_words(rest)
        if words or len(values) not in (3, 6):
            raise LineError(f"{word} needs 3 numbers, or 6 with the tool's axis, not {one_line(rest[:40])!r}")
        if len(values) == 6:
            self._axis = unit_vector(values[3:], "the tool's axis")
        return np.array(values[:3]) * self._factor, self._axis

    def _go(self, at: Array, axis: Array) -> None:
        rotation = rotation_to_axis(axis)
        circle, self._circle = self._circle, None
        rapid, self._rapid = self._rapid, False
        if not self.rows.begun:
            self.rows.begin(at, rotation)
            return
        start = self.rows.at
        if circle is not None and not rapid:
            self._around(circle, start, at, rotation)
            return
        length = float(np.linalg.norm(at - start))
        seconds = self._seconds(length, rapid) if length else turn_between(self.rows.rotation, rotation) / RAPID_TURN
        self.rows.move(at, rotation, seconds)

    def _around(self, circle: _Circle, start: Array, at: Array, rotation: Array) -> None:
        first = start - circle.centre
        first -= (first @ circle.axis) * circle.axis
        last = at - circle.centre
        last -= (last @ circle.axis) * circle.axis
        radii = float(np.linalg.norm(first)), float(np.linalg.norm(last))
        if min(radii) == 0.0 or abs(radii[1] - radii[0]) > 0.01 * max(radii):
            raise LineError(
                f"the circle's centre is {radii[0]:.6g} from where it begins and {radii[1]:.6g} from its end"
            )
        across = np.cross(circle.axis, first)
        end = math.atan2(float(last @ across) / radii[0], float(last @ first) / radii[0])
        sweep = arc_sweep(0.0, end, 1) if np.linalg.norm(at - start) > 1e-9 * radii[0] else math.tau
        points = list(arc_points(start, at, circle.centre, circle.axis, sweep, self.rows.tolerance))
        length = arc_length(start, at, circle.centre, circle.axis, sweep)
        seconds = self._seconds(length, False) / len(points)
        for point in points:
            self.rows.move(point, rotation, seconds)

    def _hole(self, at: Array, axis: Array) -> None:
        """Above the hole, down to it, through it at the cycle's feed, and out again."""
        cycle = self._cycle
        assert cycle is not None
        rotation = rotation_to_axis(axis)
        above = at + cycle.away * axis
        if not self.rows.begun:
            self.rows.begin(above, rotation)
        for height, rapid in ((cycle.away, True), (cycle.near, True), (-cycle.depth, False), (cycle.away, True)):
            to = at + height * axis
            length = float(np.linalg.norm(to - self.rows.at))
            seconds = length / self.rows.rapid if rapid else 60.0 * length / self._positive(cycle.feed)
            self.rows.move(to, rotation, seconds)

    def _seconds(self, length: float, rapid: bool) -> float:
        if rapid:
            return length / self.rows.rapid
        feed = self._positive(self._feed)
        if self._per_turn:
            feed *= self._positive(self._speed, "a feed per revolution and no spindle speed", "write SPINDL")
        return 60.0 * length / feed

    @staticmethod
    def _positive(value: float, what: str = "a move at a feed that is not set", mend: str = "write FEDRAT") -> float:
        if value <= 0.0:
            raise LineError(what, mend)
        return value

    def _begin_circle(self, rest: str, line: int) -> None:
        values, _ = numbers_and_words(rest)
        if len(values) < 6:
            raise LineError("CIRCLE needs its centre and axis, six numbers")
        self._circle = _Circle(np.array(values[:3]) * self._factor, unit_vector(values[3:6], "the circle's axis"))

    def _direction(self, rest: str, line: int) -> None:
        values, _ = numbers_and_words(rest)
        if len(values) != 3:
            raise LineError("INDIRV needs three numbers")
        self._toward = unit_vector(values, "the direction")

    def _forward(self, statement: str, line: int) -> None:
        """TLON,GOFWD/(CIRCLE/centre,r),ON,(LINE/centre,end): about whatever axis the direction of INDIRV asks for."""
        circle = re.search(r"CIRCLE\s*/([^)]*)\)", statement, re.IGNORECASE)
        ends = re.search(r"LINE\s*/([^)]*)\)", statement, re.IGNORECASE)
        if circle is None or ends is None:
            raise LineError("GOFWD is only read along a CIRCLE up to a LINE", "export circles as CIRCLE, or as points")
        centre, _ = numbers_and_words(circle[1])
        through, _ = numbers_and_words(ends[1])
        if len(centre) < 4 or len(through) != 6:
            raise LineError("GOFWD needs CIRCLE/x,y,z,r and LINE/x,y,z,x,y,z")
        if self._toward is None or not self.rows.begun:
            raise LineError("GOFWD without a start and a direction", "write GOTO and INDIRV before it")
        middle, end = np.array(centre[:3]) * self._factor, np.array(through[3:]) * self._factor
        axis = np.cross(self.rows.at - middle, self._toward)
        self._circle = _Circle(middle, unit_vector(axis.tolist(), "the circle's axis"))
        self._go(end, self._axis)


_STATEMENTS: dict[str, Callable[[_Reader, str, int], None]] = {
    "UNIT": _Reader._unit,
    "UNITS": _Reader._unit,
    "RAPID": _Reader._rapid_next,
    "FEDRAT": _Reader._feed_rate,
    "SPINDL": _Reader._spindle,
    "TLAXIS": _Reader._tool_axis,
    "LOAD": _Reader._load_tool,
    "LOADTL": _Reader._load_tool,
    "TURRET": _Reader._load_tool,
    "CUTCOM": _Reader._compensation,
    "CSYS": _Reader._system,
    "TRANS": _Reader._placed_otherwise,
    "ORIGIN": _Reader._placed_otherwise,
    "ROTATE": _Reader._placed_otherwise,
    "ROTABL": _Reader._placed_otherwise,
    "ROTHED": _Reader._placed_otherwise,
    "COPY": _Reader._placed_otherwise,
    "TRACUT": _Reader._placed_otherwise,
    "MULTAX": lambda reader, rest, line: None,
    "DELAY": _Reader._dwell,
    "DWELL": _Reader._dwell,
    "CYCLE": _Reader._begin_cycle,
    "FROM": _Reader._from,
    "GOTO": _Reader._goto,
    "GODLTA": _Reader._go_delta,
    "CIRCLE": _Reader._begin_circle,
    "MOVARC": _Reader._begin_circle,
    "INDIRV": _Reader._direction,
    "FINI": _Reader._end,
}
