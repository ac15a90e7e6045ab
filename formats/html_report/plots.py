"""Line plots as plain data for the report's SVG macro: pixels, ticks and labels worked out here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..axis import round_ticks, tick_label

Array = NDArray[np.float64]

WIDTH, HEIGHT = 520, 260
LEFT, RIGHT, TOP, BOTTOM = 64, 14, 34, 46
MOST_POINTS = 800
COLOURS = 6
"""Curves have the colours .c0 to .c5 of report.css."""


@dataclass(frozen=True, slots=True)
class Line:
    """One curve: its name, the SVG points of its polylines (several where the data has gaps), and its colour."""

    name: str
    paths: tuple[str, ...]
    colour: int
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Plot:
    """A plot in a box of WIDTH x HEIGHT pixels; ticks are (pixel, label)."""

    title: str
    x_title: str
    y_title: str
    x_ticks: tuple[tuple[float, str], ...]
    y_ticks: tuple[tuple[float, str], ...]
    lines: tuple[Line, ...]
    left: int = LEFT
    right: int = WIDTH - RIGHT
    top: int = TOP
    bottom: int = HEIGHT - BOTTOM
    width: int = WIDTH
    height: int = HEIGHT


def line_plot(
    title: str, x_title: str, y_title: str, curves: Sequence[tuple[str, Array, Array]], dashed: Sequence[str] = ()
) -> Plot | None:
    """A plot of curves (name, x, y), y from zero up; None when there is no finite point.

    Curves named in `dashed` are dashed, and have the colours of the others in turn.
    """
    xs = np.concatenate([np.zeros(0), *(x[np.isfinite(y)] for _, x, y in curves)])
    ys = np.concatenate([np.zeros(0), *(y[np.isfinite(y)] for _, _, y in curves)])
    if not len(xs):
        return None
    x_low, x_high = float(xs.min()), float(xs.max())
    y_low, y_high = min(0.0, float(ys.min())), max(0.0, float(ys.max()))
    x_high = x_high if x_high > x_low else x_low + 1.0
    y_high = y_high if y_high > y_low else 1.0
    y_high += 0.04 * (y_high - y_low)

    def x_at(value: Array | float) -> Array:
        return LEFT + (np.asarray(value) - x_low) / (x_high - x_low) * (WIDTH - LEFT - RIGHT)

    def y_at(value: Array | float) -> Array:
        return HEIGHT - BOTTOM - (np.asarray(value) - y_low) / (y_high - y_low) * (HEIGHT - TOP - BOTTOM)

    lines: list[Line] = []
    for name, x, y in curves:
        paths = []
        for piece in _pieces(*_thinned(x, y)):
            pixels = np.column_stack([x_at(piece[0]), y_at(piece[1])])
            paths.append(" ".join(f"{a:.1f},{b:.1f}" for a, b in pixels.tolist()))
        colour = sum((line.name in dashed) == (name in dashed) for line in lines) % COLOURS
        lines.append(Line(name, tuple(paths), colour, name in dashed))
    return Plot(
        title,
        x_title,
        y_title,
        tuple((float(x_at(t)), tick_label(t)) for t in round_ticks(x_low, x_high, 8)),
        tuple((float(y_at(t)), tick_label(t)) for t in round_ticks(y_low, y_high, 6)),
        tuple(lines),
    )


def _thinned(x: Array, y: Array) -> tuple[Array, Array]:
    """The lowest and highest point of each stretch, in their order, when there are more points than pixels."""
    if len(x) <= MOST_POINTS:
        return x, y
    kept: list[int] = []
    for stretch in np.array_split(np.arange(len(x)), MOST_POINTS // 2):
        values = np.where(np.isfinite(y[stretch]), y[stretch], 0.0)
        kept += sorted({int(stretch[np.argmin(values)]), int(stretch[np.argmax(values)])})
    return x[kept], y[kept]


def _pieces(x: Array, y: Array) -> list[tuple[Array, Array]]:
    """Runs of finite points; a lone point becomes a short stroke by standing twice."""
    finite = np.isfinite(x) & np.isfinite(y)
    ends = np.flatnonzero(np.diff(finite.astype(np.int8))) + 1
    runs = [run for run in np.split(np.arange(len(x)), ends) if len(run) and finite[run[0]]]
    return [(x[run], y[run]) if len(run) > 1 else (np.repeat(x[run], 2), np.repeat(y[run], 2)) for run in runs]
