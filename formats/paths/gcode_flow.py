"""The order in which the lines of a G-code program run: subs, branches and loops written with O-words.

o<name> sub ... o<name> return ... o<name> endsub         o<name> call [1] [2]: #1 and #2 in the sub
o1 if [...] / o1 elseif [...] / o1 else / o1 endif        o2 while [...] ... o2 endwhile
o3 do ... o3 while [...]                                  o4 repeat [n] ... o4 endrepeat
o2 break, o2 continue
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from .gcode_words import LineError, Parameters, Reader, code_of

STEPS = 200_000
"""Lines that may run beyond those of the file, each once: a loop that never ends is found within seconds."""
DEEPEST_CALL = 50
DEEPEST_NEST = 50
ARGUMENTS = 30
_KEYWORDS = (
    "sub", "endsub", "return", "call", "if", "elseif", "else", "endif", "while", "endwhile", "do", "repeat",
    "endrepeat", "break", "continue",
)  # fmt: skip
_ENDS = {"sub": "endsub", "if": "endif", "while": "endwhile", "do": "while", "repeat": "endrepeat"}


@dataclass(slots=True)
class Line:
    """code : without comments and blanks. label, keyword : of an O-word, "" for any other line; `code` is then the rest."""

    number: int
    code: str
    label: str = ""
    keyword: str = ""


@dataclass(slots=True)
class Nest:
    """An O-word with the lines up to its end. parts : of an if, each branch behind its own line; of others one."""

    head: Line
    parts: list[tuple[Line, list[Line | Nest]]] = field(default_factory=list)


class ProgramError(Exception):
    """A LineError with the number of its line."""

    def __init__(self, number: int, fault: LineError) -> None:
        super().__init__(fault.what)
        self.number = number
        self.fault = fault


class _LeaveError(Exception):
    """return, break or continue on its way to where it belongs."""

    def __init__(self, line: Line) -> None:
        self.line = line


class Program:
    """A program's lines, nested by their O-words, and the parameters that they share with whoever runs it.

    ended : whether the file has the end that a program has, a second % (M2 and M30 are the machine's to see).
    Raises ProgramError for O-words that do not match.
    """

    def __init__(self, text: str, block_delete: bool = False) -> None:
        self.parameters = Parameters()
        self.subs: dict[str, Nest] = {}
        self.ended = False
        self.lines = self._lines(text, block_delete)
        self._at = 0
        self._calls = 0
        self._steps = len(self.lines) + STEPS
        self.main = self._nested(None, 0)

    def run(self) -> Iterator[Line]:
        """The lines without O-words, in the order in which they run. Raises ProgramError."""
        try:
            yield from self._run(self.main)
        except _LeaveError as leave:
            if leave.line.keyword != "return":  # a return outside any sub ends the program
                raise _no_loop(leave.line) from None

    # ------------------------------------------------------------------ reading

    def _lines(self, text: str, block_delete: bool) -> list[Line]:
        lines: list[Line] = []
        marks = 0
        for number, raw in enumerate(text.splitlines(), start=1):
            if raw.strip() == "%":
                marks += 1
                if marks == 2 or lines:
                    self.ended = True
                    break
                continue
            try:
                line = _line(number, code_of(raw), block_delete)
            except LineError as fault:
                raise ProgramError(number, fault) from None
            if line is not None:
                lines.append(line)
        return lines

    def _nested(self, head: Line | None, depth: int) -> list[Line | Nest]:
        """The lines from here up to the end of `head`, or of the file; `_at` is then at that end."""
        found: list[Line | Nest] = []
        while self._at < len(self.lines):
            line = self.lines[self._at]
            word = line.keyword
            if head is not None and line.label == head.label:
                ends = (
                    ("elseif", "else", "endif") if head.keyword in ("if", "elseif", "else") else (_ENDS[head.keyword],)
                )
                if word in ends:
                    return found
            if word in ("sub", "if", "while", "do", "repeat"):
                if depth >= DEEPEST_NEST:
                    raise ProgramError(line.number, LineError(f"more than {DEEPEST_NEST} O-words in each other"))
                nest = self._nest(line, depth + 1)
                if word == "sub":
                    if line.label in self.subs:
                        raise ProgramError(line.number, LineError(f"the sub {line.label} stands twice"))
                    self.subs[line.label] = nest
                else:
                    found.append(nest)
                continue
            if word.startswith("end") or word in ("elseif", "else"):
                raise ProgramError(line.number, LineError(f"{line.label} {word} ends nothing that has begun"))
            found.append(line)
            self._at += 1
        if head is not None:
            end = _ENDS.get(head.keyword, "endif")
            raise ProgramError(head.number, LineError(f"{head.label} {head.keyword} has no {end}"))
        return found

    def _nest(self, head: Line, depth: int) -> Nest:
        nest, part = Nest(head), head
        while True:
            self._at += 1
            nest.parts.append((part, self._nested(part, depth)))
            end = self.lines[self._at]
            if part.keyword == "else" and end.keyword != "endif":
                raise ProgramError(end.number, LineError(f"{end.label} {end.keyword} behind its else"))
            if end.keyword not in ("elseif", "else"):
                break
            part = end
        if head.keyword == "do":
            nest.head = end  # its condition stands there
        self._at += 1
        return nest

    # ------------------------------------------------------------------ running

    def _run(self, lines: list[Line | Nest]) -> Iterator[Line]:
        for line in lines:
            if isinstance(line, Nest):
                yield from self._run_nest(line)
            elif line.keyword == "call":
                self._step(line)
                yield from self._call(line)
            elif line.keyword:
                raise _LeaveError(line)
            else:
                self._step(line)
                yield line

    def _run_nest(self, nest: Nest) -> Iterator[Line]:
        head, (first, lines) = nest.head, nest.parts[0]
        if first.keyword == "if":
            for part, branch in nest.parts:
                if part.keyword == "else" or self._value(part):
                    yield from self._run(branch)
                    return
            return
        turns = self._value(head) if first.keyword == "repeat" else 0.0
        while True:
            if first.keyword == "while" and not self._value(head):
                return
            if first.keyword == "repeat":
                turns -= 1.0
                if turns < -1e-9:
                    return
            self._step(head)
            try:
                yield from self._run(lines)
            except _LeaveError as leave:
                if leave.line.label != head.label or leave.line.keyword == "return":
                    raise
                if leave.line.keyword == "break":
                    return
            if first.keyword == "do" and not self._value(head):
                return

    def _call(self, line: Line) -> Iterator[Line]:
        sub = self.subs.get(line.label)
        if sub is None:
            raise ProgramError(
                line.number, LineError(f"there is no sub {line.label} in this file", "put the sub into the same file")
            )
        values = self._values(line, line.code)
        if len(values) > ARGUMENTS:
            raise ProgramError(line.number, LineError(f"{len(values)} values for a sub, which takes {ARGUMENTS}"))
        if self._calls >= DEEPEST_CALL:
            raise ProgramError(line.number, LineError(f"more than {DEEPEST_CALL} calls in each other"))
        own = self.parameters.local, [self.parameters.numbered.get(i) for i in range(1, ARGUMENTS + 1)]
        self.parameters.local = {}
        for i in range(1, ARGUMENTS + 1):
            self.parameters.numbered[i] = values[i - 1] if i <= len(values) else 0.0
        self._calls += 1
        try:
            yield from self._run(sub.parts[0][1])
        except _LeaveError as leave:
            if leave.line.keyword != "return":
                raise _no_loop(leave.line) from None
            if leave.line.code:
                self.parameters.shared["_value"] = self._value(leave.line)
        finally:
            self._calls -= 1
            self.parameters.local = own[0]
            for i, value in enumerate(own[1], start=1):
                if value is None:
                    self.parameters.numbered.pop(i, None)
                else:
                    self.parameters.numbered[i] = value

    def _step(self, line: Line) -> None:
        self._steps -= 1
        if self._steps < 0:
            raise ProgramError(
                line.number,
                LineError(
                    f"the program runs more than {STEPS} lines in its loops", "write the path out, or end the loop"
                ),
            )

    def _value(self, line: Line) -> float:
        values = self._values(line, line.code)
        if len(values) != 1:
            raise ProgramError(line.number, LineError(f"{line.label} {line.keyword} needs one value in brackets"))
        return values[0]

    def _values(self, line: Line, code: str) -> list[float]:
        reader, values = Reader(code, self.parameters), list[float]()
        try:
            while not reader.done:
                reader.need("[")
                values.append(reader.expression())
        except LineError as fault:
            raise ProgramError(line.number, fault) from None
        return values


def _no_loop(line: Line) -> ProgramError:
    return ProgramError(line.number, LineError(f"{line.label} {line.keyword} leaves no loop"))


def _line(number: int, code: str, block_delete: bool) -> Line | None:
    """The line of a code; None where there is nothing to do. Raises LineError for an O-word that is none."""
    if code.startswith("/"):
        if block_delete:
            return None
        code = code.lstrip("/0123456789") if code[1:2].isdigit() else code[1:]
    if code.startswith("n"):
        code = code[1:].lstrip("0123456789.")
    if not code or code.startswith(":"):
        return None
    if not code.startswith("o"):
        return Line(number, code)
    rest = code[1:]
    if rest.startswith("<"):
        name, closed, rest = rest[1:].partition(">")
        if not closed:
            raise LineError("the name of an O-word does not end", "close it with >")
        label = f"o<{name}>"
    else:
        digits = rest[: len(rest) - len(rest.lstrip("0123456789"))]
        if not digits:
            raise LineError("an O-word needs a number or a <name>")
        label, rest = f"o{int(digits)}", rest[len(digits) :]
        if not rest:
            return None  # the number of a program
    keyword = max((word for word in _KEYWORDS if rest.startswith(word)), key=len, default="")
    if not keyword:
        raise LineError(f'the O-word "{rest[:12]}" is not known', f"known are {', '.join(_KEYWORDS)}")
    return Line(number, rest[len(keyword) :], label, keyword)
