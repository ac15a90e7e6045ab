"""What each line of G-code does: modes, offsets and the canonical moves that follow from them.

What moves the tool is done; what does not (spindle, coolant, tool change, overrides) is passed over; what would move it in a
way that the file does not tell (canned cycles, tool tables, probes) is refused by its name.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from ...units import conversion
from .gcode_codes import FLOW, GROUP, REFUSED
from .gcode_compensation import Compensation
from .gcode_moves import PLANES, Move, Place
from .gcode_words import LineError, Parameters

AXES = "xyzabc"
ZERO: Place = (0.0,) * 6
NEAR = 5e-4
"""Inches that the two radii of an arc may differ; beyond it, by SPIRAL of the radius."""
SPIRAL = 1e-3
_LETTERS = "abcdfhijklmnpqrstxyz"


class Machine:
    """The state of the machine. `run` a line's words, take the moves; `finish` at the end of the program."""

    def __init__(self, parameters: Parameters, units: str = "mm") -> None:
        """units : of the lengths before G20 or G21."""
        self.parameters = parameters
        self._default = units
        self.position: Place = ZERO
        self._unnamed = frozenset(range(6))
        self.ended = False
        self.unit = ""
        self.warnings: dict[str, int] = {}
        self._motion: float = 80
        self._plane = 17
        self._incremental = False
        self._arc_incremental = True
        self._feed_mode = 94
        self._feed = 0.0
        self._spindle = 0.0
        self._coordinates: float = 54
        self._tables: dict[int, Place] = {}
        self._g92: Place = ZERO
        self._g92_kept: Place = ZERO
        self._compensation: Compensation | None = None
        self._tools: set[float] = set()

    def run(self, words: list[tuple[str, float]], line: int) -> Iterator[Move]:
        """The moves of one line. Raises LineError for what cannot be done."""
        given: dict[str, float] = {}
        codes: dict[str, float] = {}
        ends = False
        for letter, value in words:
            if letter == "g":
                code = round(value, 4)
                group = self._group(code)
                if group in codes:
                    raise LineError(f"G{codes[group]:g} and G{code:g} in one line")
                codes[group] = code
            elif letter == "m":
                ends |= self._miscellaneous(value, line)
            elif letter in given:
                raise LineError(f"the word {letter.upper()} stands twice in one line")
            elif letter in "uvw":
                raise LineError(f"the axis {letter.upper()} is not known", "the axes are X, Y, Z, A, B, C")
            elif letter in _LETTERS:
                given[letter] = value
            else:
                raise LineError(f"the word {letter.upper()} is not known")
        yield from self._settings(given, codes, line)
        yield from self._motions(given, codes, line)
        if ends:
            yield from self.finish()
            self.ended = True

    def finish(self) -> Iterator[Move]:
        """What still waits for its next move."""
        if self._compensation is not None:
            yield from self._compensation.flush()
            self._compensation = None

    def warn(self, text: str, line: int) -> None:
        """Keep a warning with the first line that earns it."""
        self.warnings.setdefault(text, line)

    # ------------------------------------------------------------------ words

    def _group(self, code: float) -> str:
        if code in GROUP:
            return GROUP[code]
        if code in REFUSED:
            what, mend = REFUSED[code]
            raise LineError(f"G{code:g} is not read: {what}", mend)
        raise LineError(f"G{code:g} is not known")

    def _miscellaneous(self, value: float, line: int) -> bool:
        """An M word; True when it ends the program."""
        code = round(value, 4)
        if code in FLOW:
            raise LineError(f"M{code:g} is not read: it {FLOW[code]}", "write the moves out, or use O-words")
        if 100 <= code <= 199 or code > 199:
            self.warn(f"M{code:g} is the machine's own and passed over", line)
        return code in (2, 30)

    def _settings(self, given: dict[str, float], codes: dict[str, float], line: int) -> Iterator[Move]:
        if "feed" in codes:
            mode = int(codes["feed"])
            if mode != self._feed_mode:
                self._feed = 0.0  # the number meant something else
            self._feed_mode = mode
        if "f" in given:
            if given["f"] < 0.0:
                raise LineError(f"the feed F{given['f']:g} is negative")
            self._feed = given["f"]
        elif self._feed_mode == 93:
            self._feed = 0.0  # G93 says it anew for every move
        if "s" in given:
            self._spindle = given["s"]
        if "t" in given:
            self._tools.add(given["t"])
            if len(self._tools) > 1:
                self.warn("more than one tool is used: the path goes on with the scene's", line)
        if codes.get("once") == 4:
            seconds = given.get("p", given.get("x", 0.0))
            if seconds < 0.0:
                raise LineError("G4 waits a negative time")
            yield from self._send(Move("dwell", line, self.unit, self.position, self.position, seconds=seconds))
        if "plane" in codes and codes["plane"] != self._plane:
            if self._compensation is not None:
                raise LineError("the plane changes under cutter compensation", "write G40 before it")
            self._plane = int(codes["plane"])
        if "unit" in codes:
            self._change_unit("in" if codes["unit"] == 20 else "mm")
        yield from self._compensate(given, codes)
        if "coordinates" in codes:
            yield from self._choose_coordinates(codes["coordinates"], line)
        if "distance" in codes:
            self._incremental = codes["distance"] == 91
        if "arc distance" in codes:
            self._arc_incremental = codes["arc distance"] == 91.1

    def _change_unit(self, unit: str) -> None:
        factor = conversion(self.unit or self._default, unit)
        self.unit = unit
        if factor == 1.0:
            return

        def turned(p: Place) -> Place:
            return p[0] * factor, p[1] * factor, p[2] * factor, p[3], p[4], p[5]

        if self._compensation is not None:
            raise LineError("the unit changes under cutter compensation", "write G40 before it")
        self.position, self._g92, self._g92_kept = turned(self.position), turned(self._g92), turned(self._g92_kept)
        self._tables = {number: turned(table) for number, table in self._tables.items()}

    def _compensate(self, given: dict[str, float], codes: dict[str, float]) -> Iterator[Move]:
        code = codes.get("compensation")
        if code is None:
            return
        if self._compensation is not None:
            if code != 40:
                raise LineError("cutter compensation begins twice", "write G40 before it")
            yield from self._compensation.flush()
            if self._compensation.place is not None:
                self.position = self._compensation.place
            self._compensation = None
        if code == 40:
            return
        if "d" not in given:
            raise LineError(f"G{code:g} has no diameter", "write it as D")
        if self._plane == 19:
            raise LineError("cutter compensation in the YZ plane")
        side = 1 if code == 41.1 else -1
        if given["d"] != 0.0:
            side = side if given["d"] > 0.0 else -side
            self._compensation = Compensation(self._plane, side, 0.5 * abs(given["d"]))

    # ------------------------------------------------------------------ offsets

    @property
    def offset(self) -> Place:
        """From the programmed place to the machine's own."""
        table = self._tables.get(_table(self._coordinates), ZERO)
        return tuple(a + b for a, b in zip(table, self._g92, strict=True))  # type: ignore[return-value]

    def _choose_coordinates(self, code: float, line: int) -> Iterator[Move]:
        if code != 54 and _table(code) not in self._tables:
            self.warn(f"G{code:g} has no offset in this file and is taken as G54's place", line)
        if code != self._coordinates and self._compensation is not None:
            raise LineError("the coordinates change under cutter compensation", "write G40 before it")
        before = self.offset
        self._coordinates = code
        self._moved_offset(before)
        return iter(())

    def _moved_offset(self, before: Place) -> None:
        """Keep the machine where it is when the offset has changed."""
        rows = zip(self.position, before, self.offset, strict=True)
        self.position = tuple(p + old - new for p, old, new in rows)  # type: ignore[assignment]

    def _set_table(self, given: dict[str, float]) -> None:
        kind = given.get("l", 0.0)
        if kind not in (2, 20):
            raise LineError(f"G10 L{kind:g} is not read: it changes a tool table", "leave it out")
        if given.get("r", 0.0):
            raise LineError("G10 with R turns the coordinates", "write the moves out")
        number = int(given.get("p", 0.0)) or _table(self._coordinates)
        if not 1 <= number <= 9:
            raise LineError(f"G10 P{number}: there are coordinate systems 1 to 9")
        before = self.offset
        table = list(self._tables.get(number, ZERO))
        for i, axis in enumerate(AXES):
            if axis in given:
                here = self.position[i] + before[i] - self._g92[i]
                table[i] = given[axis] if kind == 2 else here - given[axis]
        self._tables[number] = tuple(table)  # type: ignore[assignment]
        self._moved_offset(before)

    def _shift(self, code: float, given: dict[str, float]) -> None:
        """G92 and its kin."""
        before = self.offset
        if code == 92:
            if not any(axis in given for axis in AXES):
                raise LineError("G92 names no axis")
            rows = enumerate(zip(self._g92, self.position, strict=True))
            shifted = [g + p - given[AXES[i]] if AXES[i] in given else g for i, (g, p) in rows]
            self._g92 = self._g92_kept = tuple(shifted)  # type: ignore[assignment]
        elif code == 92.3:
            self._g92 = self._g92_kept
        else:
            self._g92_kept = ZERO if code == 92.1 else self._g92_kept
            self._g92 = ZERO
        self._moved_offset(before)

    # ------------------------------------------------------------------ motion

    def _motions(self, given: dict[str, float], codes: dict[str, float], line: int) -> Iterator[Move]:
        once = codes.get("once")
        axes = any(axis in given for axis in AXES)
        if "motion" in codes:
            self._motion = codes["motion"]
        if once in (10, 92, 92.1, 92.2, 92.3):
            if self._compensation is not None:
                raise LineError(f"G{once:g} under cutter compensation", "write G40 before it")
            if once == 10:
                self._set_table(given)
            else:
                self._shift(float(once), given)
            return
        if once in (28, 30):
            # the way to the home position is the machine's; that by way of the named axes is the program's
            self.warn(f"G{once:g} goes home, which the file does not say where it is: left out", line)
            if axes and not self._incremental:
                yield from self._straight("traverse", self._target(given, machine=False), line)
            return
        if once in (28.1, 30.1) or (once == 4 and "motion" not in codes):
            return
        arc = self._motion in (2, 3)
        if not axes and not (arc and any(letter in given for letter in "ijkr")):
            return
        if self._motion == 80:
            raise LineError("an axis moves, but no motion is chosen", "write G0, G1, G2 or G3")
        target = self._target(given, machine=once == 53)
        if arc:
            if once == 53:
                raise LineError("G53 with an arc", "use G0 or G1")
            yield from self._arc(given, target, line)
        else:
            yield from self._straight("traverse" if self._motion == 0 else "feed", target, line)

    def _target(self, given: dict[str, float], machine: bool) -> Place:
        place = list(self.position)
        offset = self.offset
        for i, axis in enumerate(AXES):
            if axis in given:
                self._unnamed -= {i}
                if machine:
                    place[i] = given[axis] - offset[i]
                else:
                    place[i] = given[axis] + (place[i] if self._incremental else 0.0)
        return tuple(place)  # type: ignore[return-value]

    def _straight(self, kind: str, target: Place, line: int) -> Iterator[Move]:
        feed = self._feed_per_minute() if kind == "feed" else 0.0
        move = Move(
            "feed" if kind == "feed" else "traverse", line, self.unit, self.position, target, self.offset,
            plane=self._plane, feed=feed, inverse=self._feed_mode == 93, unnamed=self._unnamed,
        )  # fmt: skip
        yield from self._send(move)

    def _arc(self, given: dict[str, float], target: Place, line: int) -> Iterator[Move]:
        first, second, _ = PLANES[self._plane]
        letters = ("ijk"[first], "ijk"[second])
        across = "ijk"[3 - first - second]
        start = (self.position[first], self.position[second])
        end = (target[first], target[second])
        sign = -1 if self._motion == 2 else 1
        if across in given:
            raise LineError(f"{across.upper()} is no centre in the plane G{self._plane}")
        if "r" in given:
            if any(letter in given for letter in letters):
                raise LineError("an arc with a radius R and a centre")
            centre = _centre_of_radius(start, end, given["r"], sign)
        else:
            if not any(letter in given for letter in letters):
                raise LineError(
                    "an arc without a centre or radius", f"write {letters[0].upper()} and {letters[1].upper()}, or R"
                )
            if not self._arc_incremental and not all(letter in given for letter in letters):
                raise LineError("an absolute centre (G90.1) needs both its numbers")
            base = start if self._arc_incremental else (0.0, 0.0)
            centre = (base[0] + given.get(letters[0], 0.0), base[1] + given.get(letters[1], 0.0))
            radii = [math.hypot(p[0] - centre[0], p[1] - centre[1]) for p in (start, end)]
            apart = abs(radii[1] - radii[0])
            if min(radii) <= 0.0:
                raise LineError("the arc has no radius")
            if apart > NEAR * conversion("in", self.unit or self._default) and apart > SPIRAL * max(radii):
                raise LineError(f"the arc begins {radii[0]:.6g} from its centre and ends {radii[1]:.6g} from it")
        turns = given.get("p", 1.0)
        if turns < 1 or turns != int(turns):
            raise LineError(f"an arc of P{turns:g} turns", "write a whole number from 1 on")
        move = Move(
            "arc", line, self.unit, self.position, target, self.offset, plane=self._plane, centre=centre,
            turns=sign * int(turns), feed=self._feed_per_minute(), inverse=self._feed_mode == 93,
        )  # fmt: skip
        yield from self._send(move)

    def _feed_per_minute(self) -> float:
        if self._feed <= 0.0:
            raise LineError(
                "the feed is not set", "write F" + (" in every line with G93" if self._feed_mode == 93 else "")
            )
        if self._feed_mode != 95:
            return self._feed
        if self._spindle <= 0.0:
            raise LineError("a feed per revolution (G95) and no spindle speed", "write S")
        return self._feed * self._spindle

    def _send(self, move: Move) -> Iterator[Move]:
        self.position = move.end
        if not all(map(math.isfinite, move.end)):
            raise LineError("a place is not finite")
        for i, value in enumerate(move.end):
            self.parameters.numbered[5420 + i] = value
        if self._compensation is None:
            yield move
        else:
            yield from self._compensation.add(move)


def _table(code: float) -> int:
    """The number, from 1, of a coordinate system G54 to G59.3."""
    return int(code) - 53 if code <= 59 else 6 + round((code - 59) * 10)


def _centre_of_radius(
    start: tuple[float, float], end: tuple[float, float], radius: float, sign: int
) -> tuple[float, float]:
    """The centre of an arc of that radius, the shorter way for a positive one; sign 1 is anticlockwise."""
    x, y = end[0] - start[0], end[1] - start[1]
    chord = math.hypot(x, y)
    if chord == 0.0:
        raise LineError("an arc with R ends where it begins", "write a whole circle with its centre")
    half = 0.5 * chord
    if radius == 0.0 or half > abs(radius) * (1.0 + SPIRAL):
        raise LineError(f"an arc of radius {radius:g} cannot reach over {chord:.6g}")
    height = math.sqrt(max(0.0, radius * radius - half * half))
    side = sign * math.copysign(height, radius) / chord
    return start[0] + 0.5 * x - side * y, start[1] + 0.5 * y + side * x
