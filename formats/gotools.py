"""GoTools' .g2 files, both ways: spline surfaces (class 200) and bounded ones (class 210, trims).

    200 1 0 0           class, version, and how many numbers about its colour follow
    3 0                 dimension, rational
    n k / knots         along u: control points and order (degree + 1); then along v
    x y z [w]           control points, u fastest; of a rational surface w x, w y, w z, w

The format has no units, no names and no orientation. Digits beyond a double's 17 are written where w x, rounded, would not
give back x: read with all of them it does, bit for bit.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from decimal import Context, Decimal
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import CadsculptError, InputError
from ..spline.surface import BSplineSurface, Provenance, TrimCurve, TrimLoop
from .part import Part
from .paths.path_text import text_of_file
from .u_fastest import rows_of_surface, surface_of_rows

Array = NDArray[np.float64]

SURFACE, BOUNDED, CURVE = 200, 210, 100
CLASSES = {
    100: "spline curve", 110: "curve on a surface", 120: "line", 130: "circle", 200: "spline surface", 210: "bounded surface",
    250: "plane", 260: "cylinder", 270: "sphere", 280: "cone", 290: "torus", 400: "point cloud", 410: "line cloud",
    700: "spline volume",
}  # fmt: skip
MOST = 10_000_000
"""Numbers of one net: a count above it is no count."""
EPSILON = 1e-4
"""Of the loops, as GoTools writes them: how far its curves may miss each other."""

_EXACT = Context(prec=40)


# ---------------------------------------------------------------------- reading


def read(path: Path, *, units: str | None = None) -> Part:
    """Read a .g2 file; its numbers are in `units`, or taken as mm with a warning.

    Raises InputError naming the file, the line and the fault; classes other than surfaces by their name.
    """
    from .patch_part import PatchPart

    path = Path(path)
    surfaces = surfaces_of_text(text_of_file(path), str(path))
    part = PatchPart(path, "g2", units or "", surfaces)
    if units is None:
        part.warnings.append("a GoTools file has no length unit: its numbers are taken as mm")
    return part


def surfaces_of_text(text: str, where: str) -> list[BSplineSurface]:
    """The surfaces of a text, named "surface 1" and on; `where` names it in errors. Raises InputError."""
    words = _Words(text, where)
    surfaces: list[BSplineSurface] = []
    while not words.done:
        kind = words.whole("the class of an object", 1)
        here = words.where
        for _ in range(2):
            words.whole("a version", 0)
        for _ in range(words.whole("how many numbers follow", 0)):
            words.number("a number about the object's colour")
        name = f"surface {len(surfaces) + 1}"
        if kind == BOUNDED:
            inner = words.whole("the class of the surface", 1)
            if inner != SURFACE:
                raise words.fault(
                    f"a bounded {CLASSES.get(inner, f'class {inner}')} is not read", "bound spline surfaces"
                )
            surface = _surface(words, name, here)
            surface = _with_trims(surface, _loops(words))
        elif kind == SURFACE:
            surface = _surface(words, name, here)
        else:
            raise words.fault(f"a {CLASSES.get(kind, f'class {kind}')} is not read", "write spline surfaces alone")
        surfaces.append(surface)
    if not surfaces:
        raise InputError("there are no surfaces", where=where)
    return surfaces


class _Words:
    """The numbers of a text one after the other, with their lines."""

    def __init__(self, text: str, where: str) -> None:
        self._file = where
        self._words = [(word, n) for n, line in enumerate(text.splitlines(), 1) for word in line.split()]
        self._at = 0

    @property
    def done(self) -> bool:
        return self._at >= len(self._words)

    @property
    def where(self) -> str:
        """File and line of the word that was taken last."""
        return f"{self._file}:{self._words[self._at - 1][1]}" if self._words else self._file

    def fault(self, what: str, mend: str = "") -> InputError:
        return InputError(what, where=self.where, mend=mend)

    def word(self, what: str) -> str:
        if self.done:
            raise self.fault(f"the file ends where {what} should stand", "it may have been cut off")
        self._at += 1
        return self._words[self._at - 1][0]

    def number(self, what: str) -> float:
        word = self.word(what)
        try:
            value = float(word) if "_" not in word else float("nan")
        except ValueError:
            value = float("nan")
        if not isfinite(value):
            raise self.fault(f"{word[:30]!r} is not a finite number where {what} should stand")
        return value

    def whole(self, what: str, least: int, most: int = MOST) -> int:
        value = self.number(what)
        if value != int(value) or not least <= value <= most:
            raise self.fault(f"{value:g} cannot be {what}")
        return int(value)

    def numbers(self, count: int, what: str) -> Array:
        return np.array([self.number(what) for _ in range(count)])

    def points(self, count: int, size: int, rational: bool) -> tuple[Array, Array | None]:
        """(count, size) points and their weights, of w x, w y, ..., w where rational."""
        if not rational:
            return self.numbers(count * size, "a control point").reshape(count, size), None
        points, weights = np.empty((count, size)), np.empty(count)
        for i in range(count):
            products = [(self.number("a control point"), self._words[self._at - 1][0]) for _ in range(size)]
            weights[i] = self.number("a weight")
            if weights[i] <= 0.0:
                raise self.fault(f"the weight {weights[i]:g} is not positive")
            points[i] = [_quotient(value, word, float(weights[i])) for value, word in products]
        return points, weights


def _quotient(product: float, written: str, weight: float) -> float:
    """x of w x; with all digits where there are more than a double has."""
    if len(re.sub(r"[eE].*|[^0-9]", "", written).lstrip("0")) <= 17:
        return product / weight
    return float(_EXACT.divide(Decimal(written), Decimal(weight)))


def _head(words: _Words, dimension: int, what: str) -> bool:
    """Whether the object is rational. Raises InputError for another dimension."""
    found = words.whole("the dimension", 1)
    if found != dimension:
        raise words.fault(f"a {what} in {found} dimensions, not {dimension}")
    return bool(words.whole("whether it is rational", 0, 1))


def _direction(words: _Words) -> tuple[int, int, Array]:
    """Number of control points, degree and knots of one direction."""
    count = words.whole("the number of control points", 1)
    order = words.whole("the order", 2, 100)
    if order > count:
        raise words.fault(f"{count} control points for order {order}", "at least as many as the order")
    return count, order - 1, words.numbers(count + order, "a knot")


def _surface(words: _Words, name: str, where: str) -> BSplineSurface:
    rational = _head(words, 3, "surface")
    (r, p, knots_u), (s, q, knots_v) = _direction(words), _direction(words)
    if r * s > MOST:
        raise words.fault(f"a net of {r} x {s} control points")
    points, weights = words.points(r * s, 3, rational)
    return surface_of_rows(
        points,
        weights,
        (knots_u, knots_v),
        (p, q),
        name=name,
        provenance=Provenance(Path(where.rsplit(":", 1)[0]).name, f"line {where.rsplit(':', 1)[1]}", ""),
        where=where,
    )


def _curve(words: _Words, dimension: int) -> TrimCurve:
    rational = _head(words, dimension, "curve")
    count, degree, knots = _direction(words)
    points, weights = words.points(count, dimension, rational)
    return TrimCurve(points, knots, degree, weights)


def _loops(words: _Words) -> list[list[TrimCurve]]:
    """The parameter curves of a bounded surface, loop by loop; curves in space are read over."""
    from .patch_json import check_curve

    loops = []
    for _ in range(words.whole("the number of loops", 1)):
        curves = []
        count = words.whole("the number of curves", 1)
        words.number("a tolerance")
        for _ in range(count):
            words.whole("which curve is preferred", 0, 1)
            flat, space = (words.whole("the class of a curve", 0) for _ in range(2))
            if flat == 0:
                raise words.fault("a loop has no curve in the parameter plane", "write parameter curves")
            for kind in (flat, space):
                if kind not in (0, CURVE):
                    raise words.fault(
                        f"a loop along a {CLASSES.get(kind, f'class {kind}')} is not read", "write spline curves"
                    )
            curve = _curve(words, 2)
            try:
                check_curve(curve, words.where)
            except CadsculptError as error:
                raise words.fault(error.what, error.mend) from None
            curves.append(curve)
            if space:
                _curve(words, 3)
        loops.append(curves)
    return loops


def _with_trims(surface: BSplineSurface, loops: Iterable[list[TrimCurve]]) -> BSplineSurface:
    """The surface within its loops: anticlockwise ones keep what they hold, clockwise ones cut it out."""
    from dataclasses import replace

    from .occt.trim import signed_area

    made = [TrimLoop(tuple(curves), True) for curves in loops]
    return replace(surface, trims=tuple(TrimLoop(loop.curves, signed_area(loop) > 0.0) for loop in made))


# ---------------------------------------------------------------------- writing


def write_surfaces(path: Path, surfaces: Sequence[BSplineSurface]) -> None:
    """Write surfaces as GoTools reads them, whole or not at all; trimmed ones with their parameter curves."""
    from .atomic import write_whole

    write_whole(path, text_of_surfaces(surfaces))


def text_of_surfaces(surfaces: Sequence[BSplineSurface]) -> str:
    """The text of a .g2 file."""
    lines: list[str] = []
    for surface in surfaces:
        surface.validate()
        lines.append(f"{BOUNDED if surface.trims else SURFACE} 1 0 0")
        if surface.trims:
            lines.append(str(SURFACE))
        r, s = surface.shape
        lines += [f"3 {int(surface.rational)}"]
        lines += _direction_lines(r, surface.degree_u, surface.knots_u)
        lines += _direction_lines(s, surface.degree_v, surface.knots_v)
        lines += _point_lines(*rows_of_surface(surface))
        if surface.trims:
            lines += ["", str(len(surface.trims))]
            for loop in surface.trims:
                lines.append(f"{len(loop.curves)} {EPSILON!r}")
                for curve in loop.curves:
                    lines.append(f"1 {CURVE} 0")
                    lines.append(f"2 {int(curve.weights is not None)}")
                    lines += _direction_lines(len(curve.control_points), curve.degree, curve.knots)
                    lines += [*_point_lines(curve.control_points, curve.weights), ""]
        lines.append("")
    return "\n".join(lines)


def _direction_lines(count: int, degree: int, knots: Array) -> list[str]:
    return [f"{count} {degree + 1}", " ".join(map(repr, knots.tolist()))]


def _point_lines(points: Array, weights: Array | None) -> Iterator[str]:
    if weights is None:
        for point in points.tolist():
            yield " ".join(map(repr, point))
        return
    for point, weight in zip(points.tolist(), weights.tolist(), strict=True):
        yield " ".join([*(_product(x, weight) for x in point), repr(weight)])


def _product(x: float, weight: float) -> str:
    """w x in as many digits as bring x back."""
    product = x * weight
    short = repr(product)
    if product / weight == x and (product != 0.0 or x == 0.0):
        return short
    return str(_EXACT.multiply(Decimal(x), Decimal(weight)))
