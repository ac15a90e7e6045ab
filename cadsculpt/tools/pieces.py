"""What a composed solid is made of: smooth pieces of surface, and a tree of min and max that joins them.

A piece is a function that is negative inside, with its gradient; its zero set holds a part of the solid's surface. A shape
with edges (a box, a cylinder, a cone, a formula in its box) is an intersection of pieces, so that every edge of a composed
solid, its parts' own ones too, is where two pieces vanish.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..collide import shapes
from ..motion.pose import Pose
from .expression import Expression
from .implicit import ImplicitTool, Solid

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Level = Callable[[Array], tuple[Array, Array]]
"""Values (n,) and gradients (n, 3) at points (n, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """min (union) or max (intersection) of trees and pieces; a number is a piece. sign : -1 turns the solid inside out."""

    how: Literal["min", "max"]
    items: tuple[Tree | int, ...]
    sign: float = 1.0

    def value(self, values: Sequence[Array]) -> tuple[Array, Index, Array]:
        """Value (n,) of the whole from those of the pieces, and the piece (n,) that decides it, with its sign (n,)."""
        best: Array | None = None
        for item in self.items:
            if isinstance(item, Tree):
                v, k, s = item.value(values)
            else:
                v = values[item]
                k, s = np.full(len(v), item, dtype=np.int64), np.ones(len(v))
            if best is None:
                best, which, sign = v, k, s
                continue
            wins = v < best if self.how == "min" else v > best
            best = np.where(wins | np.isnan(v), v, best)
            which, sign = np.where(wins, k, which), np.where(wins, s, sign)
        assert best is not None
        return self.sign * best, which, self.sign * sign

    def bounds(self, spans: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
        """Bounds of the whole from those of the pieces."""
        both = [item.bounds(spans) if isinstance(item, Tree) else spans[item] for item in self.items]
        pick = np.minimum if self.how == "min" else np.maximum
        low, high = pick.reduce([span[0] for span in both]), pick.reduce([span[1] for span in both])
        return (low, high) if self.sign > 0 else (-high, -low)

    def moved(self, by: int) -> Tree:
        """The same over pieces numbered from `by`."""
        return Tree(
            self.how,
            tuple(item.moved(by) if isinstance(item, Tree) else item + by for item in self.items),
            self.sign,
        )

    def turned(self) -> Tree:
        """Inside out."""
        return Tree(self.how, self.items, -self.sign)


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """level : as above. span : bounds (n,), (n,) of the level over boxes given by centres and half sizes (n, 3).

    distance : whether |level| never exceeds the distance to the zero set.
    """

    level: Level
    span: Callable[[Array, Array], tuple[Array, Array]]
    distance: bool = True

    def placed(self, pose: Pose) -> Piece:
        """The piece at a pose."""
        reach = np.abs(pose.rotation)

        def level(points: Array) -> tuple[Array, Array]:
            value, gradient = self.level(pose.to_tool(points))
            return value, pose.direction_to_world(gradient)

        def span(centre: Array, half: Array) -> tuple[Array, Array]:
            return self.span(pose.to_tool(centre), half @ reach)

        return Piece(level, span, self.distance)


def lipschitz_piece(level: Level) -> Piece:
    """A piece whose level never changes faster than the place."""

    def span(centre: Array, half: Array) -> tuple[Array, Array]:
        value, reach = level(centre)[0], np.linalg.norm(half, axis=1) * (1 + 1e-12)
        return value - reach, value + reach

    return Piece(level, span)


def plane(normal: Sequence[float], offset: float) -> Piece:
    """The half-space normal . x <= offset; the normal has unit length."""
    n = np.array(normal, dtype=np.float64)

    def level(points: Array) -> tuple[Array, Array]:
        return points @ n - offset, np.tile(n, (len(points), 1))

    def span(centre: Array, half: Array) -> tuple[Array, Array]:
        value, reach = centre @ n - offset, half @ np.abs(n)
        return value - reach, value + reach

    return Piece(level, span)


def box_pieces(corners: Array) -> list[Piece]:
    """Six planes around a box (2, 3)."""
    unit = np.eye(3)
    return [plane(-unit[k], -corners[0, k]) for k in range(3)] + [plane(unit[k], corners[1, k]) for k in range(3)]


def all_of(pieces: Sequence[Piece]) -> Tree:
    """Their intersection."""
    return Tree("max", tuple(range(len(pieces))))


def solid_pieces(tool: Solid) -> tuple[list[Piece], Tree]:
    """The pieces of a tool with an exact distance, and how they are joined."""
    if isinstance(tool, ImplicitTool) and tool.rounding == 0.0:
        p = tool.parameters
        pieces: list[Piece] = []
        if tool.kind == shapes.BOX:
            pieces = box_pieces(tool.box_corners)
        elif tool.kind == shapes.CYLINDER:
            pieces = [_round(p[0], 1.0, 0.0), plane([0, 0, -1], 0.5 * p[1]), plane([0, 0, 1], 0.5 * p[1])]
        elif tool.kind == shapes.CONE:
            slant = float(np.hypot(p[0], p[1]))
            pieces = [_round(0.0, p[1] / slant, -p[0] / slant), plane([0, 0, 1], p[1])]
        if pieces:
            return pieces, all_of(pieces)
    pieces = [lipschitz_piece(tool.field)]
    return pieces, all_of(pieces)


def _round(radius: float, across: float, along: float) -> Piece:
    """across r + along z - radius: a cylinder or cone about the z axis without end."""

    def level(points: Array) -> tuple[Array, Array]:
        r = np.hypot(points[:, 0], points[:, 1])
        out = points[:, :2] / np.where(r > 0, r, 1.0)[:, None]
        gradient = np.column_stack([across * out, np.full(len(points), along)])
        return across * r + along * points[:, 2] - radius, gradient

    return lipschitz_piece(level)


def expression_piece(expression: Expression) -> Piece:
    """The zero set of a formula, bounded by interval arithmetic."""

    def span(centre: Array, half: Array) -> tuple[Array, Array]:
        low, high, _, _ = expression.bounds(centre - half, centre + half)
        return low, high

    return Piece(expression.gradient, span, distance=False)


def formula_pieces(expression: Expression, corners: Array) -> tuple[list[Piece], Tree]:
    """A formula within its box: what a min or max joins at the outermost places are pieces of their own."""
    pieces: list[Piece] = []

    def add(part: Expression) -> Tree | int:
        split = part.branches()
        if split is None or len(pieces) > 40:
            pieces.append(expression_piece(part))
            return len(pieces) - 1
        how: Literal["min", "max"] = "min" if split[0] == "min" else "max"
        return Tree(how, tuple(add(inner) for inner in split[1]))

    inner = add(expression)
    sides = tuple(range(len(pieces), len(pieces) + 6))
    return pieces + box_pieces(corners), Tree("max", (inner, *sides))
