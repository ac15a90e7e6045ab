"""One line of RS274/NGC: words, parameters and expressions (Kramer, Proctor and Messina, NIST IR 6556, 2000).

Letters are the same in both cases and blanks mean nothing. A value is a number, a parameter (#5, #<name>), an expression in
brackets or a function of one; operators of one rank go from left to right, ** before * / MOD before + - before EQ NE GT GE
LT LE before AND OR XOR.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field

DEEPEST = 60
"""Brackets within brackets: more are no program but a fault of whoever wrote it."""
EQUAL = 1e-5
"""EQ and NE take numbers nearer than this for the same, as machines do."""

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")
_PLAIN = re.compile(r"(?:[a-z][+-]?(?:\d+\.?\d*|\.\d+))*")
_WORD = re.compile(r"([a-z])([+-]?(?:\d+\.?\d*|\.\d+))")


class LineError(Exception):
    """What is wrong in one line, and the mend; whoever knows the line names it."""

    def __init__(self, what: str, mend: str = "") -> None:
        super().__init__(what)
        self.what = what
        self.mend = mend


@dataclass(slots=True)
class Parameters:
    """numbered : #1 and on, 0 where never set. local : #<name> of the sub that runs. shared : #<_name>."""

    numbered: dict[int, float] = field(default_factory=dict)
    local: dict[str, float] = field(default_factory=dict)
    shared: dict[str, float] = field(default_factory=dict)

    def get(self, key: int | str) -> float:
        """The value of a parameter. Raises LineError for a name that was never set."""
        if isinstance(key, int):
            return self.numbered.get(key, 0.0)
        found = (self.shared if key.startswith("_") else self.local).get(key)
        if found is None:
            raise LineError(f"the parameter #<{key}> is used before it is set")
        return found

    def has(self, key: int | str) -> bool:
        """Whether a parameter was set."""
        return key in (self.numbered if isinstance(key, int) else self.shared | self.local)

    def set(self, key: int | str, value: float) -> None:
        """Raises LineError for numbers that no parameter has."""
        if isinstance(key, str):
            (self.shared if key.startswith("_") else self.local)[key] = value
        elif 1 <= key <= 5602:
            self.numbered[key] = value
        else:
            raise LineError(f"there is no parameter #{key}", "parameters run from #1 to #5602")


def code_of(text: str) -> str:
    """A line without its comments and blanks, in small letters."""
    if "(" in text or ";" in text or ")" in text:
        kept, at = [], 0
        while at < len(text):
            sign = text[at]
            if sign == ";":
                break
            if sign == ")":
                raise LineError("a ) closes no comment")
            if sign == "(":
                end = text.find(")", at)
                if end < 0:
                    raise LineError("the comment does not end", "close it with )")
                at = end
            else:
                kept.append(sign)
            at += 1
        text = "".join(kept)
    return "".join(text.lower().split())


def words_of(code: str, parameters: Parameters) -> list[tuple[str, float]]:
    """The words of a line, letters with their values; assignments are done once all of it has been read.

    Raises LineError for what is none.
    """
    if _PLAIN.fullmatch(code):
        return [(letter, float(number)) for letter, number in _WORD.findall(code)]
    reader = Reader(code, parameters)
    words: list[tuple[str, float]] = []
    settings: list[tuple[int | str, float]] = []
    while not reader.done:
        if reader.take("#"):
            key = reader.parameter()
            reader.need("=")
            settings.append((key, reader.value()))
        else:
            letter = reader.letter()
            words.append((letter, reader.value()))
    for key, value in settings:
        parameters.set(key, value)
    return words


class Reader:
    """A place in a line, moving on."""

    def __init__(self, code: str, parameters: Parameters) -> None:
        self.code = code
        self.at = 0
        self.parameters = parameters
        self.depth = 0

    @property
    def done(self) -> bool:
        return self.at >= len(self.code)

    def take(self, text: str) -> bool:
        """Step over this text where it stands here."""
        here = self.code.startswith(text, self.at)
        self.at += len(text) if here else 0
        return here

    def need(self, text: str) -> None:
        if not self.take(text):
            raise LineError(f"{text} is missing {self._before()}")

    def letter(self) -> str:
        sign = self.code[self.at]
        if not ("a" <= sign <= "z"):
            raise LineError(f"no word begins with {sign!r} {self._before()}")
        self.at += 1
        return sign

    def parameter(self) -> int | str:
        """The number or name behind a #."""
        if self.take("<"):
            end = self.code.find(">", self.at)
            if end < 0:
                raise LineError("the name of a parameter does not end", "close it with >")
            name, self.at = self.code[self.at : end], end + 1
            return name
        number = self.value()
        if abs(number - round(number)) > 1e-4:
            raise LineError(f"no parameter has the number {number:g}")
        return round(number)

    def value(self) -> float:
        """A number, parameter, expression or function. Raises LineError for none, and for a result that is not finite."""
        self.depth += 1
        if self.depth > DEEPEST:
            raise LineError(f"more than {DEEPEST} brackets in each other")
        result = self._value()
        self.depth -= 1
        if not math.isfinite(result):
            raise LineError(f"a value is not a finite number {self._before()}")
        return result

    def _value(self) -> float:
        match = _NUMBER.match(self.code, self.at)
        if match:
            self.at = match.end()
            return float(match[0])
        if self.take("["):
            return self.expression()
        if self.take("#"):
            return self.parameters.get(self.parameter())
        if self.take("-"):
            return -self.value()
        if self.take("+"):
            return self.value()
        for name, function in _FUNCTIONS.items():
            if self.code.startswith(f"{name}[", self.at):
                self.at += len(name) + 1
                return self._function(name, function)
        raise LineError(f"a number is missing {self._before()}")

    def _function(self, name: str, function: Callable[[float], float]) -> float:
        if name == "exists":
            self.need("#")
            self.need("<")
            end = self.code.find(">]", self.at)
            if end < 0:
                raise LineError("EXISTS[#<name>] does not end")
            known = self.parameters.has(self.code[self.at : end])
            self.at = end + 2
            return float(known)
        argument = self.expression()
        if name == "atan":
            self.need("/")
            self.need("[")
            return math.degrees(math.atan2(argument, self.expression()))
        try:
            return function(argument)
        except (ValueError, OverflowError):
            raise LineError(f"{name.upper()}[{argument:g}] has no value") from None

    def expression(self) -> float:
        """The value of what stands in brackets, behind the opening one."""
        self.depth += 1
        if self.depth > DEEPEST:
            raise LineError(f"more than {DEEPEST} brackets in each other")
        values, pending = [self.value()], list[str]()
        while not self.take("]"):
            if self.done:
                raise LineError("a bracket does not close", "close it with ]")
            sign = next((sign for sign in _OPERATORS if self.code.startswith(sign, self.at)), None)
            if sign is None:
                raise LineError(f"an operator is missing {self._before()}")
            self.at += len(sign)
            while pending and _RANK[pending[-1]] >= _RANK[sign]:
                self._apply(values, pending.pop())
            pending.append(sign)
            values.append(self.value())
        while pending:
            self._apply(values, pending.pop())
        self.depth -= 1
        return values[0]

    def _apply(self, values: list[float], sign: str) -> None:
        right, left = values.pop(), values.pop()
        try:
            result = _OPERATORS[sign](left, right)
        except (ZeroDivisionError, OverflowError, ValueError):
            raise LineError(f"{left:g} {sign.upper()} {right:g} has no value") from None
        if not math.isfinite(result):
            raise LineError(f"{left:g} {sign.upper()} {right:g} has no finite value")
        values.append(result)

    def _before(self) -> str:
        rest = self.code[self.at : self.at + 12]
        return f'before "{rest}"' if rest else "at the end of the line"


_OPERATORS: dict[str, Callable[[float, float], float]] = {
    "**": math.pow,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "mod": lambda a, b: math.fmod(a, b) + abs(b) if math.fmod(a, b) < 0.0 else math.fmod(a, b),
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "eq": lambda a, b: float(abs(a - b) < EQUAL),
    "ne": lambda a, b: float(abs(a - b) >= EQUAL),
    "gt": lambda a, b: float(a > b),
    "ge": lambda a, b: float(a >= b),
    "lt": lambda a, b: float(a < b),
    "le": lambda a, b: float(a <= b),
    "and": lambda a, b: float(a != 0.0 and b != 0.0),
    "or": lambda a, b: float(a != 0.0 or b != 0.0),
    "xor": lambda a, b: float((a != 0.0) != (b != 0.0)),
}
_RANK = {"**": 4, "*": 3, "/": 3, "mod": 3, "+": 2, "-": 2, "and": 0, "or": 0, "xor": 0} | dict.fromkeys(
    ("eq", "ne", "gt", "ge", "lt", "le"), 1
)


def _rounded(value: float) -> float:
    return math.copysign(math.floor(abs(value) + 0.5), value)


_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "abs": abs,
    "acos": lambda x: math.degrees(math.acos(x)),
    "asin": lambda x: math.degrees(math.asin(x)),
    "atan": math.atan,
    "cos": lambda x: math.cos(math.radians(x)),
    "exists": float,
    "exp": math.exp,
    "fix": lambda x: float(math.floor(x)),
    "fup": lambda x: float(math.ceil(x)),
    "ln": math.log,
    "round": _rounded,
    "sin": lambda x: math.sin(math.radians(x)),
    "sqrt": math.sqrt,
    "tan": lambda x: math.tan(math.radians(x)),
}
