"""Formulas in x, y, z: read safely, evaluated with their gradient, and bounded over boxes by interval arithmetic.

The text is parsed by Python's own `ast` and never run: only numbers, x, y, z, the constants and functions below, and
+ - * / ** are taken. Equal sub-expressions are computed once. Bounds are those of Moore (1966), rounded outwards.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import dataclass
from math import e, pi, tau

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..spec import mend

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CONSTANTS = {"pi": pi, "e": e, "tau": tau}
VARIABLES = ("x", "y", "z")
ONE, TWO, SEVERAL = (1, 1), (2, 2), (2, 64)
FUNCTIONS: dict[str, tuple[int, int]] = {
    "abs": ONE, "sqrt": ONE, "exp": ONE, "log": ONE, "sin": ONE, "cos": ONE, "tan": ONE, "sinh": ONE, "cosh": ONE,
    "tanh": ONE, "asin": ONE, "acos": ONE, "atan": ONE, "atan2": TWO, "pow": TWO, "hypot": SEVERAL, "min": SEVERAL,
    "max": SEVERAL,
}  # fmt: skip
"""The functions with the least and most number of arguments."""

MOST_NODES = 2000
MOST_BOXES = 20000
"""Boxes in which a pole is looked for at once."""

_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}


@dataclass(frozen=True, slots=True)
class Node:
    """One operation: its name, the numbers of its arguments, and its value where it is a constant."""

    operation: str
    arguments: tuple[int, ...] = ()
    value: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Expression:
    """A formula as a list of operations, each after its arguments; the last is the formula."""

    text: str
    nodes: tuple[Node, ...]

    @classmethod
    def parse(cls, text: str) -> Expression:
        """Raises InputError: what is wrong and at which column."""
        return cls(text, tuple(_Reader(text).nodes))

    def value(self, points: Array) -> Array:
        """f (n,) at points (n, 3)."""
        with np.errstate(all="ignore"):
            out: list[Array] = []
            for node in self.nodes:
                out.append(_value(node, [out[k] for k in node.arguments], points))
        return np.broadcast_to(out[-1], len(points)).astype(np.float64)

    def gradient(self, points: Array) -> tuple[Array, Array]:
        """f (n,) and its gradient (n, 3) at points (n, 3), by automatic differentiation; 0 where a root has none."""
        with np.errstate(all="ignore"):
            value: list[Array] = []
            slope: list[Array | None] = []
            for node in self.nodes:
                value.append(_value(node, [value[k] for k in node.arguments], points))
                slope.append(_slope(node, value, slope, points))
        g = slope[-1]
        zero = np.zeros((3, len(points)))
        return (
            np.broadcast_to(value[-1], len(points)).astype(np.float64),
            np.ascontiguousarray((zero if g is None else zero + np.nan_to_num(g, posinf=0.0, neginf=0.0)).T),
        )

    def bounds(self, low: Array, high: Array) -> tuple[Array, Array, Mask, NDArray[np.int64]]:
        """Bounds (n,), (n,) of f over boxes low, high (n, 3); which of the boxes may hold a point where f is undefined
        (n,), and the number of the operation to blame."""
        fault = np.zeros(len(low), dtype=np.bool_)
        blame = np.zeros(len(low), dtype=np.int64)
        spans: list[tuple[Array, Array]] = []
        with np.errstate(all="ignore"):
            for k, node in enumerate(self.nodes):
                a, b, bad = _bounds(node, [spans[i] for i in node.arguments], low, high)
                if bad is not None:
                    blame[bad & ~fault] = k
                    fault |= bad
                # NaN of infinities that meet: nothing is known
                a, b = np.where(np.isnan(a), -np.inf, a), np.where(np.isnan(b), np.inf, b)
                spans.append((a, b))
        a, b = spans[-1]
        return np.broadcast_to(a, len(low)) + 0.0, np.broadcast_to(b, len(low)) + 0.0, fault, blame

    def undefined(self, box: Array) -> str:
        """Where in the box (2, 3) the formula has a pole or is not a number, in words; empty when it is shown to have
        none."""
        low, high = box[:1].copy(), box[1:].copy()
        doubt = ""
        for _ in range(40):
            _, _, fault, blame = self.bounds(low, high)
            if not fault.any():
                return doubt
            low, high, blame = low[fault], high[fault], blame[fault]
            centre = 0.5 * (low + high)
            wrong = np.flatnonzero(~np.isfinite(self.value(centre)))
            if len(wrong):
                return self._told(int(blame[wrong[0]]), centre[wrong[0]], certain=True)
            if len(low) > MOST_BOXES or doubt:  # as many as a surface of poles has: one place is followed to its end
                low, high, centre = low[:8], high[:8], centre[:8]
                doubt = self._told(int(blame[0]), centre[0], certain=False)
            if (high - low <= 1e-6 * (box[1] - box[0])).all():
                return self._told(int(blame[0]), centre[0], certain=False)
            low, high = _halved(low, high)
        return doubt

    def _told(self, node: int, at: Array, *, certain: bool) -> str:
        what = {
            "/": "division by zero", "**": "a power", "pow": "a power", "log": "the log of zero or less",
            "sqrt": "the root of a negative number", "tan": "a pole of tan", "asin": "asin beyond 1",
            "acos": "acos beyond 1", "hypot": "hypot", "exp": "exp",
        }.get(self.nodes[node].operation, self.nodes[node].operation)  # fmt: skip
        place = ", ".join(f"{c + 0.0:.4g}" for c in at)
        told = "is not a number everywhere" if certain else "is not shown to be a number everywhere"
        return f"{told} in its box: {what} near ({place})"

    def branches(self) -> tuple[str, tuple[Expression, ...]] | None:
        """The arguments of a min or max that stands outermost, each a formula of its own; None for another formula."""
        top = self.nodes[-1]
        if top.operation not in ("min", "max"):
            return None
        return top.operation, tuple(Expression(self.text, self.nodes[: k + 1]) for k in top.arguments)


class _Reader(ast.NodeVisitor):
    """From the text to the list of operations."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.nodes: list[Node] = []
        self.known: dict[tuple[str, tuple[int, ...], float], int] = {}
        if "^" in text:
            raise self.fault("^ is no operator here", text.index("^"), "write ** for a power")
        try:
            tree = ast.parse(text.strip(), mode="eval")
        except SyntaxError as error:
            at = max((error.offset or 1) - 1, 0)
            raise self.fault(f"{error.msg[:1].lower() + error.msg[1:]}", at, "") from None
        except (ValueError, RecursionError, MemoryError, OverflowError):
            raise self.fault("cannot be read", 0, "is it too long or too deep?") from None
        try:
            last = self.read(tree.body)
        except RecursionError:
            raise self.fault("is nested too deeply", 0, "") from None
        if last != len(self.nodes) - 1:  # a constant or variable that stands elsewhere too
            self.nodes.append(self.nodes[last])

    def fault(self, what: str, column: int, how: str) -> InputError:
        return InputError(f"expression: {what} at column {column + 1}", mend=how)

    def at(self, node: ast.AST) -> int:
        return getattr(node, "col_offset", 0) + len(self.text) - len(self.text.lstrip())

    def add(self, operation: str, arguments: tuple[int, ...] = (), value: float = 0.0) -> int:
        key = (operation, arguments, value)
        if key not in self.known:
            # what is made of constants alone is one
            if arguments and all(self.nodes[k].operation == "constant" for k in arguments):
                with np.errstate(all="ignore"):
                    inner = [np.array([self.nodes[k].value]) for k in arguments]
                    known = float(_value(Node(operation, arguments), inner, np.zeros((1, 3)))[0])
                if np.isfinite(known):
                    self.known[key] = self.add("constant", (), known)
                    return self.known[key]
            self.known[key] = len(self.nodes)
            self.nodes.append(Node(operation, arguments, value))
            if len(self.nodes) > MOST_NODES:
                raise InputError(f"expression: more than {MOST_NODES} operations", mend="write it shorter")
        return self.known[key]

    def read(self, node: ast.expr) -> int:
        if isinstance(node, ast.Constant):
            if isinstance(node.value, (int, float)) and not isinstance(node.value, bool):
                if abs(node.value) > 1e300:
                    raise self.fault("the number is too large", self.at(node), "")
                return self.add("constant", (), float(node.value))
            raise self.fault(
                f"{node.value!r} is no number", self.at(node), "use numbers, x, y, z and functions of them"
            )
        if isinstance(node, ast.Name):
            if node.id in VARIABLES:
                return self.add(node.id)
            if node.id in CONSTANTS:
                return self.add("constant", (), CONSTANTS[node.id])
            if node.id in FUNCTIONS:
                raise self.fault(f"{node.id} is a function", self.at(node), f"write {node.id}(...)")
            raise self.fault(
                f"unknown name {node.id}",
                self.at(node),
                mend(node.id, (*VARIABLES, *CONSTANTS, *FUNCTIONS)).strip("()"),
            )
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.UAdd)):
            inner = self.read(node.operand)
            return self.add("neg", (inner,)) if isinstance(node.op, ast.USub) else inner
        if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            operation = _OPERATORS[type(node.op)]
            return self.add(operation, (self.read(node.left), self.read(node.right)))
        if isinstance(node, ast.Call):
            return self.call(node)
        raise self.fault(
            f"{ast.unparse(node)[:30]!r} is not allowed",
            self.at(node),
            "use numbers, x, y, z, + - * / ** and functions",
        )

    def call(self, node: ast.Call) -> int:
        if not isinstance(node.func, ast.Name):
            raise self.fault("only named functions are allowed", self.at(node), "use " + ", ".join(FUNCTIONS))
        name = node.func.id
        if name not in FUNCTIONS:
            how = mend(name, FUNCTIONS).strip("()") if name not in (*VARIABLES, *CONSTANTS) else f"{name} * (...) ?"
            raise self.fault(f"unknown function {name}", self.at(node), how)
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            raise self.fault(f"{name} takes plain arguments", self.at(node), "")
        least, most = FUNCTIONS[name]
        if not least <= len(node.args) <= most:
            takes = f"{least} argument{'s' if least > 1 else ''}" if least == most else f"{least} arguments or more"
            raise self.fault(f"{name} takes {takes}, not {len(node.args)}", self.at(node), "")
        return self.add("**" if name == "pow" else name, tuple(self.read(argument) for argument in node.args))


# ---------------------------------------------------------------- values

_PLAIN: dict[str, Callable[..., Array]] = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "**": np.power, "neg": np.negative,
    "abs": np.abs, "sqrt": np.sqrt, "exp": np.exp, "log": np.log, "sin": np.sin, "cos": np.cos, "tan": np.tan,
    "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "atan2": np.arctan2,
}  # fmt: skip


def _value(node: Node, inner: list[Array], points: Array) -> Array:
    if node.operation == "constant":
        return np.array([node.value])
    if node.operation in VARIABLES:
        return points[:, VARIABLES.index(node.operation)]
    if node.operation in ("min", "max", "hypot"):
        pairwise = {"min": np.minimum, "max": np.maximum, "hypot": np.hypot}[node.operation]
        out = inner[0]
        for other in inner[1:]:
            out = pairwise(out, other)
        return out
    return _PLAIN[node.operation](*inner)


def _slope(node: Node, value: list[Array], slope: list[Array | None], points: Array) -> Array | None:
    """Gradient (3, n) of the operation that was computed last; None where it is a constant."""
    o = node.operation
    if o == "constant":
        return None
    if o in VARIABLES:
        unit = np.zeros((3, 1))
        unit[VARIABLES.index(o)] = 1.0
        return unit
    a = [value[k] for k in node.arguments]
    d = [slope[k] for k in node.arguments]
    v = value[-1]
    if o in ("min", "max"):
        out = 0.0 if d[0] is None else d[0]
        best = a[0]
        for other, its in zip(a[1:], d[1:], strict=True):
            wins = other < best if o == "min" else other > best
            out = np.where(wins, 0.0 if its is None else its, out)
            best = np.where(wins, other, best)
        return np.asarray(out) + np.zeros((3, 1))
    if o == "hypot":
        return _sum([_times(w / v, its) for w, its in zip(a, d, strict=True)])
    if o == "+":
        return _sum(d)
    if o == "-":
        return _sum([d[0], _times(-1.0, d[1])])
    if o == "*":
        return _sum([_times(a[1], d[0]), _times(a[0], d[1])])
    if o == "/":
        return _sum([_times(1.0 / a[1], d[0]), _times(-v / a[1], d[1])])
    if o == "**":
        base = _times(a[1] * np.power(a[0], a[1] - 1.0), d[0])
        return base if d[1] is None else _sum([base, _times(v * np.log(a[0]), d[1])])
    if o == "atan2":
        square = a[0] * a[0] + a[1] * a[1]
        return _sum([_times(a[1] / square, d[0]), _times(-a[0] / square, d[1])])
    rates: dict[str, Callable[[], Array]] = {
        "neg": lambda: -np.ones(1), "abs": lambda: np.sign(a[0]), "sqrt": lambda: 0.5 / v, "exp": lambda: v,
        "log": lambda: 1.0 / a[0], "sin": lambda: np.cos(a[0]), "cos": lambda: -np.sin(a[0]), "tan": lambda: 1.0 + v * v,
        "sinh": lambda: np.cosh(a[0]), "cosh": lambda: np.sinh(a[0]), "tanh": lambda: 1.0 - v * v,
        "asin": lambda: 1.0 / np.sqrt(1.0 - a[0] * a[0]), "acos": lambda: -1.0 / np.sqrt(1.0 - a[0] * a[0]),
        "atan": lambda: 1.0 / (1.0 + a[0] * a[0]),
    }  # fmt: skip
    return _times(rates[o](), d[0])


def _times(factor: Array | float, slope: Array | None) -> Array | None:
    return None if slope is None else factor * slope


def _sum(parts: list[Array | None]) -> Array | None:
    some = [part for part in parts if part is not None]
    return None if not some else sum(some[1:], some[0])


# ---------------------------------------------------------------- bounds

Span = tuple[Array, Array]


def _bounds(node: Node, spans: list[Span], low: Array, high: Array) -> tuple[Array, Array, Mask | None]:
    """Bounds of one operation from those of its arguments, and where it may be undefined."""
    o = node.operation
    if o == "constant":
        return np.array([node.value]), np.array([node.value]), None
    if o in VARIABLES:
        k = VARIABLES.index(o)
        return low[:, k], high[:, k], None
    (a, b), (c, d) = spans[0], spans[-1]
    if o == "+":
        return *_out(a + c, b + d), None
    if o == "-":
        return *_out(a - d, b - c), None
    if o == "neg":
        return -b, -a, None
    if o == "*":
        return *(_power(a, b, 2) if node.arguments[0] == node.arguments[1] else _product(spans[0], spans[1])), None
    if o == "/":
        return _quotient(spans[0], spans[1])
    if o == "**":
        return _raised(node, spans)
    if o in ("min", "max"):
        pick = np.minimum if o == "min" else np.maximum
        for c, d in spans[1:]:
            a, b = pick(a, c), pick(b, d)
        return a, b, None
    if o == "hypot":
        total_low, total_high = np.zeros(1), np.zeros(1)
        for span in spans:
            square = _power(*span, 2)
            total_low, total_high = total_low + square[0], total_high + square[1]
        return *_out(np.sqrt(np.maximum(total_low, 0.0)) * (1 - 1e-15), np.sqrt(total_high)), None
    if o == "abs":
        return (
            np.where((a <= 0) & (b >= 0), 0.0, np.minimum(np.abs(a), np.abs(b))),
            np.maximum(np.abs(a), np.abs(b)),
            None,
        )
    if o == "sqrt":
        small = 1e-12 * np.maximum(np.abs(a), np.abs(b))  # rounding of what is 0
        return *_out(np.sqrt(np.maximum(a, 0.0)), np.sqrt(np.maximum(b, 0.0))), a < -small
    if o == "log":
        return *_out(np.log(np.maximum(a, 0.0)), np.log(np.maximum(b, 0.0))), ~(a > 0)
    if o in ("sin", "cos"):
        shift = 0.0 if o == "cos" else -0.5 * pi
        return *_cosine(a + shift, b + shift), None
    if o == "tan":
        pole = np.floor((b + 0.5 * pi) / pi) != np.floor((a + 0.5 * pi) / pi)
        return *_out(np.where(pole, -np.inf, np.tan(a)), np.where(pole, np.inf, np.tan(b))), pole
    if o in ("asin", "acos"):
        bad = (a < -1 - 1e-12) | (b > 1 + 1e-12)
        a, b = np.clip(a, -1, 1), np.clip(b, -1, 1)
        return *_out(*((np.arcsin(a), np.arcsin(b)) if o == "asin" else (np.arccos(b), np.arccos(a)))), bad
    if o == "cosh":
        inner = np.where((a <= 0) & (b >= 0), 0.0, np.minimum(np.abs(a), np.abs(b)))
        return *_out(np.cosh(inner), np.cosh(np.maximum(np.abs(a), np.abs(b)))), None
    if o == "atan2":
        return *_angle(spans[0], spans[1]), None
    rising = _PLAIN[o]  # exp, sinh, tanh, atan
    upper = rising(b)
    return *_out(rising(a), upper), (np.isinf(upper) & np.isfinite(b) if o in ("exp", "sinh") else None)


def _out(a: Array, b: Array) -> Span:
    """Rounded outwards by four units in the last place."""
    return a - np.abs(a) * 9e-16 - 1e-300, b + np.abs(b) * 9e-16 + 1e-300


def _product(s: Span, t: Span) -> Span:
    corners = [np.nan_to_num(p * q, nan=0.0, posinf=np.inf, neginf=-np.inf) for p in s for q in t]
    return _out(np.minimum.reduce(np.broadcast_arrays(*corners)), np.maximum.reduce(np.broadcast_arrays(*corners)))


def _quotient(s: Span, t: Span) -> tuple[Array, Array, Mask]:
    zero = (t[0] <= 0) & (t[1] >= 0)
    safe = np.where(zero, 1.0, t[0]), np.where(zero, 1.0, t[1])
    a, b = _product(s, _out(1.0 / safe[1], 1.0 / safe[0]))
    return np.where(zero, -np.inf, a), np.where(zero, np.inf, b), zero


def _power(a: Array, b: Array, n: int) -> Span:
    """Whole powers n >= 0."""
    if n == 0:
        return np.ones_like(a), np.ones_like(b)
    p, q = a**n, b**n
    if n % 2:
        return _out(p, q)
    return _out(np.where((a <= 0) & (b >= 0), 0.0, np.minimum(p, q)), np.maximum(p, q))


def _raised(node: Node, spans: list[Span]) -> tuple[Array, Array, Mask | None]:
    (a, b), (c, d) = spans
    if c.shape == (1,) and c[0] == d[0]:  # a constant exponent
        k = float(c[0])
        if k == int(k) and abs(k) < 1000:
            if k >= 0:
                return *_power(a, b, int(k)), None
            p, q = _power(a, b, int(-k))
            return _quotient((np.ones(1), np.ones(1)), (np.where((a > 0) | (b < 0), p, np.minimum(p, 0.0)), q))
        small = 1e-12 * np.maximum(np.abs(a), np.abs(b))
        low, high = np.maximum(a, 0.0) ** k, np.maximum(b, 0.0) ** k
        return (*_out(low, high), a < -small) if k > 0 else (*_out(high, low), ~(a > 0))
    bad = ~(a > 0)
    p, q = _out(np.log(np.maximum(a, 1e-300)), np.log(np.maximum(b, 1e-300)))
    p, q = _product((p, q), (c, d))
    return *_out(np.where(bad, -np.inf, np.exp(p)), np.where(bad, np.inf, np.exp(q))), bad


def _cosine(a: Array, b: Array) -> Span:
    """Bounds of cos over [a, b]: 1 where a multiple of 2 pi lies in it, -1 half a turn on."""
    slack = 1e-15 * (1.0 + np.maximum(np.abs(a), np.abs(b)))
    p, q = np.cos(a), np.cos(b)
    top = np.floor((b + slack) / (2 * pi)) >= np.ceil((a - slack) / (2 * pi))
    foot = np.floor((b + slack - pi) / (2 * pi)) >= np.ceil((a - slack - pi) / (2 * pi))
    low, high = np.minimum(p, q) - slack, np.maximum(p, q) + slack
    unknown = ~np.isfinite(a) | ~np.isfinite(b)
    return np.where(foot | unknown, -1.0, np.maximum(low, -1.0)), np.where(top | unknown, 1.0, np.minimum(high, 1.0))


def _angle(s: Span, t: Span) -> Span:
    """Bounds of atan2 over a rectangle of (y, x): its corners', or all of it where the cut or the origin is touched."""
    cut = (s[0] <= 0) & (s[1] >= 0) & (t[0] <= 0)
    corners = np.broadcast_arrays(*[np.arctan2(p, q) for p in s for q in t])
    low, high = _out(np.minimum.reduce(corners), np.maximum.reduce(corners))
    return np.where(cut, -pi, low), np.where(cut, pi, high)


def _halved(low: Array, high: Array) -> tuple[Array, Array]:
    """Each box cut in eight."""
    middle = 0.5 * (low + high)
    parts = [np.array([k & 1, k >> 1 & 1, k >> 2], dtype=bool) for k in range(8)]
    return (
        np.concatenate([np.where(part, middle, low) for part in parts]),
        np.concatenate([np.where(part, high, middle) for part in parts]),
    )
