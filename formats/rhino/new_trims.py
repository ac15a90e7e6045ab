"""The trim curves of a loop as a new 3DM file has them: as they are, and how openNURBS is brought to take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...spline.surface import BSplineSurface, TrimCurve
from ..occt.boundary import ON_BORDER, BoundaryEdge
from ..occt.trim import evaluate_trim, reversed_trim, trim_domain
from .brep import BOUNDARY_ISO
from .geometry import clamped, nurbs_of_trim
from .iso import iso_of
from .nurbs import Nurbs

Array = NDArray[np.float64]

MEETING = 0.01
"""Ends of trim curves further apart than this fraction of the range do not make a loop."""

TOUCHING = 2.0**-32, 1e-10
"""Ends nearer than the first, or than the second times their sum, meet (openNURBS' own bounds)."""


NEAR = 1e-6
"""The kernel's form of a trim curve is within this fraction of the range of the curve that it was made of."""


def own_curves(loops: Sequence[Sequence[BoundaryEdge]], surface: BSplineSurface) -> list[list[BoundaryEdge]]:
    """The kernel's loops with the surface's own trim curves on their edges, where they are the same."""
    left = [curve for loop in surface.trims or () for curve in loop.curves]
    found = []
    for loop in loops:
        items = []
        for item in loop:
            k = _own(item.curve, left, surface)
            items.append(item if k is None else replace(item, curve=left.pop(k)))
        found.append(items)
    return found


def _own(curve: TrimCurve, left: list[TrimCurve], surface: BSplineSurface) -> int | None:
    """Which of `left` is the curve, or None. One that runs the other way is turned in the list."""
    size = np.array([high - low for low, high in surface.domain])
    here = _shares(curve)
    for k, other in enumerate(left):
        if other is curve:
            return k
        there = _shares(other)
        if (np.abs(here - there) <= NEAR * size).all():
            return k
        if (np.abs(here - there[::-1]) <= NEAR * size).all():
            left[k] = reversed_trim(other)
            return k
    return None


def _shares(curve: TrimCurve) -> Array:
    """(9, 2): places at equal shares of a curve's range."""
    return evaluate_trim(curve, np.linspace(*trim_domain(curve), 9))


BACK = 1.1
"""How far a bent join steps back, in its length: more than 1, so that it does so whatever its direction."""


@dataclass(frozen=True, slots=True, eq=False)
class DrawnTrim:
    """A trim curve as the archive gets it. ends (2, 2): where it starts and ends, joins and all.

    before, after : (m, 2) Bezier points of what joins it to its neighbours (`joined_chunk`), or None; iso : its
    ON_Surface::ISO;
    explicit : marked as one of a loop along the sides of the domain; moved : how far it is from the curve that was given, as a
    fraction of the range.
    """

    curve: Nurbs
    ends: Array
    before: Array | None
    after: Array | None
    iso: int
    explicit: bool
    moved: float


def drawn_loop(
    items: Sequence[BoundaryEdge], surface: BSplineSurface, *, only: bool, exact: bool = True
) -> list[DrawnTrim]:
    """The trim curves of one loop. only : it is the face's one loop.

    A surface without trims is its whole domain: its loop is made of the domain's sides. Every other curve stays as it is,
    joined by short curves to those that it does not meet, but for seams and poles a little off their side of the domain, where
    openNURBS wants them. exact=False : ends are moved together, and curves along parameter lines made straight.
    Raises InputError when ends lie further apart than MEETING of the range.
    """
    given = [item.curve for item in items]
    size = np.array([high - low for low, high in surface.domain])
    _check_closes(given, size)
    whole = surface.trims is None
    curves = _sides(given, surface) if whole or not exact else given
    nets = [clamped(nurbs_of_trim(curve)) for curve in curves]
    iso = [iso_of(net, (None, None), surface) for net in nets]
    kept = [item.seam or item.degenerate for item in items]
    for k in range(len(items)):
        if kept[k] and iso[k] not in BOUNDARY_ISO:
            curves = [*curves[:k], _straight(curves[k], surface), *curves[k + 1 :]]
            nets[k] = clamped(nurbs_of_trim(curves[k]))
            iso[k] = iso_of(nets[k], (None, None), surface)
    ends = np.array([evaluate_trim(curve, np.array(trim_domain(curve))) for curve in curves])  # (n, 2 ends, 2)
    before: list[Array | None] = [None] * len(curves)
    after: list[Array | None] = [None] * len(curves)
    for k in range(len(curves)):
        arriving, leaving = ends[k - 1, 1], ends[k, 0]
        apart = np.abs(arriving - leaving)
        if (apart <= np.maximum(TOUCHING[0], TOUCHING[1] * (np.abs(arriving) + np.abs(leaving)))).all():
            continue
        # a line along a side is better bent at its other end; seams and poles must not be bent at all
        straight = kept[k - 1] and kept[k]
        if (kept[k - 1], iso[k - 1] > 0) > (kept[k], iso[k] > 0):
            before[k] = _join(nets[k], arriving, leaving, at_start=True, straight=straight)
        else:
            after[k - 1] = _join(nets[k - 1], arriving, leaving, at_start=False, straight=straight)
    joins = list(zip(before, after, strict=True))
    iso = [iso_of(net, join, surface) for net, join in zip(nets, joins, strict=True)]
    explicit = only and not whole and all(side in BOUNDARY_ISO for side in iso)
    return [
        DrawnTrim(
            nets[k],
            np.array([ends[k, 0] if first is None else first[0], ends[k, 1] if last is None else last[-1]]),
            first,
            last,
            iso[k],
            explicit and k == 0,
            0.0
            if whole or curves[k] is given[k]
            else float((np.abs(_shares(curves[k]) - _shares(given[k])) / size).max()),
        )
        for k, (first, last) in enumerate(joins)
    ]


def twin_sides(items: Sequence[BoundaryEdge], drawn: Sequence[DrawnTrim], surface: BSplineSurface) -> dict[int, int]:
    """Trims along one side of a closed surface that lie on edges of their own -> those that they meet across the seam.

    openNURBS wants both on one edge.
    """
    found: dict[int, int] = {}
    size = np.array([high - low for low, high in surface.domain])
    for axis, closed in enumerate((surface.closed_u, surface.closed_v)):
        sides = [
            [k for k, form in enumerate(drawn) if form.iso == side and not (items[k].seam or items[k].degenerate)]
            for side in (BOUNDARY_ISO[axis], BOUNDARY_ISO[axis + 2])
        ]
        for k in sides[1] if closed else ():
            for other in sides[0]:
                apart = np.abs(drawn[k].ends[::-1] - drawn[other].ends)[:, 1 - axis].max()
                if other not in found.values() and apart <= NEAR * size[1 - axis]:
                    found[k] = other
                    break
    return found


def _join(net: Nurbs, start: Array, end: Array, *, at_start: bool, straight: bool) -> Array:
    """(m, 2): Bezier points from `start` to `end`, which leads to the start of a curve or away from its end.

    A straight line, or a bent one that leaves and arrives in the curve's direction and steps back on its way. Whether
    openNURBS takes a curve with a straight line at its end for a parameter line would hang on the last bit of its
    arithmetic; with a bent one it never does.
    """
    if straight:
        return np.array([start, end])
    points = net.control_points()
    along = points[-1] - points[0]
    if np.hypot(*along) < 0.5 * np.hypot(*np.ptp(points, axis=0)):
        side = points if at_start else points[::-1]
        step = next((p - side[0] for p in side[1:] if (p != side[0]).any()), along)
        along = step if at_start else -step
    back = BACK * np.hypot(*(end - start)) * along / np.hypot(*along)
    return np.array([start, start + back if at_start else end - back, end])


def _check_closes(curves: Sequence[TrimCurve], size: Array) -> None:
    ends = np.array([evaluate_trim(curve, np.array(trim_domain(curve))) for curve in curves])
    if (np.abs(np.roll(ends[:, 1], 1, axis=0) - ends[:, 0]) > MEETING * size).any():
        raise InputError("a trim loop does not close")


def _sides(curves: Sequence[TrimCurve], surface: BSplineSurface) -> list[TrimCurve]:
    """The curves, those along a side of the domain made straight, with their ends moved together.

    A corner takes the coordinate of a curve that runs along a parameter line, else the middle.
    """
    straight = [_straight(curve, surface) for curve in curves]
    points = [np.array(curve.control_points) for curve in straight]
    held = [np.ptp(p, axis=0) == 0.0 for p in points]
    for k in range(len(points)):
        arriving, leaving = points[k - 1], points[k]
        a, b = arriving[-1].copy(), leaving[0].copy()
        corner = np.where(held[k - 1] & ~held[k], a, np.where(held[k] & ~held[k - 1], b, 0.5 * (a + b)))
        arriving[-1] = leaving[0] = corner
    return [replace(curve, control_points=p) for curve, p in zip(straight, points, strict=True)]


def _straight(curve: TrimCurve, surface: BSplineSurface) -> TrimCurve:
    """The straight line between the ends of a curve along a parameter line, on that line."""
    ends = evaluate_trim(curve, np.array(trim_domain(curve)))
    width = np.ptp(curve.control_points, axis=0)
    for axis, (low, high) in enumerate(surface.domain):
        near = ON_BORDER * (high - low)
        if width[axis] <= 2 * near < width[1 - axis]:
            ends[:, axis] = next((side for side in (low, high) if abs(ends[0, axis] - side) <= near), ends[0, axis])
            first, last = trim_domain(curve)
            return TrimCurve(ends, np.array([first, first, last, last]), 1)
    return curve
