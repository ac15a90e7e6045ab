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
from .iso import NOT_ISO, iso_of
from .joins import Piece
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
    """A trim curve as the archive gets it. ends (2, 2): where it starts and ends, pieces and all.

    item : the edge that it lies on; absorbed : the poles among its pieces;
    before, after : the pieces around it (`joined_chunk`); iso : its ON_Surface::ISO;
    explicit : marked as one of a loop along the sides of the domain; moved : how far it is from the curve that was given, as a
    fraction of the range.
    """

    item: BoundaryEdge
    absorbed: tuple[BoundaryEdge, ...]
    curve: Nurbs
    ends: Array
    before: tuple[Piece, ...]
    after: tuple[Piece, ...]
    iso: int
    explicit: bool
    moved: float


def drawn_loop(
    items: Sequence[BoundaryEdge], surface: BSplineSurface, *, only: bool, exact: bool = True
) -> list[DrawnTrim]:
    """The trim curves of one loop. only : it is the face's one loop.

    A surface without trims is its whole domain: its loop is made of the domain's sides. Every other curve stays as it is,
    joined by short curves to those that it does not meet, but for seams and poles a little off their side of the domain, where
    openNURBS wants them. A pole along no side goes into a neighbour's polycurve. exact=False : ends are moved together, and
    curves along parameter lines made straight.
    Raises InputError when ends lie further apart than MEETING of the range, or there are but poles.
    """
    given = [item.curve for item in items]
    size = np.array([high - low for low, high in surface.domain])
    _check_closes(given, size)
    whole = surface.trims is None
    curves = _sides(given, surface) if whole or not exact else given
    nets = [clamped(nurbs_of_trim(curve)) for curve in curves]
    iso = [iso_of([net], surface) for net in nets]
    kept = [item.seam or item.degenerate for item in items]
    for k in range(len(items)):
        if kept[k] and iso[k] not in BOUNDARY_ISO:
            line = _straight(curves[k], surface)
            net = clamped(nurbs_of_trim(line))
            side = iso_of([net], surface)
            if side in BOUNDARY_ISO:
                curves = [*curves[:k], line, *curves[k + 1 :]]
                nets[k], iso[k] = net, side
    inside = [item.degenerate and side not in BOUNDARY_ISO for item, side in zip(items, iso, strict=True)]
    kept = [keep and not pole for keep, pole in zip(kept, inside, strict=True)]
    iso = [NOT_ISO if pole else side for side, pole in zip(iso, inside, strict=True)]
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
    strings = [[*_present(before[k]), nets[k], *_present(after[k])] for k in range(len(nets))]

    def moved(k: int) -> float:
        if whole or curves[k] is given[k]:
            return 0.0
        return float((np.abs(_shares(curves[k]) - _shares(given[k])) / size).max())

    found = []
    for k, (earlier, later) in _absorbing(inside, kept, iso).items():
        first = [piece for i in earlier for piece in strings[i]] + _present(before[k])
        last = _present(after[k]) + [piece for i in later for piece in strings[i]]
        pieces = [*first, nets[k], *last]
        found.append(
            DrawnTrim(
                items[k],
                tuple(items[i] for i in (*earlier, *later)),
                nets[k],
                np.array([_end(pieces[0], 0), _end(pieces[-1], -1)]),
                tuple(first),
                tuple(last),
                iso_of(pieces, surface),
                False,
                max(moved(i) for i in (*earlier, k, *later)),
            )
        )
    if only and not whole and all(form.iso in BOUNDARY_ISO for form in found):
        found[0] = replace(found[0], explicit=True)
    return found


def _absorbing(
    inside: Sequence[bool], kept: Sequence[bool], iso: Sequence[int]
) -> dict[int, tuple[list[int], list[int]]]:
    """The curves of a loop that are no poles inside the domain -> those poles that they absorb before and after them.

    Of a pole's two neighbours a seam or another pole, which must stay on its side, is the last choice, and a curve along a side
    the second; with nothing to choose by, the loop starts with the curve that it started with.
    """
    count = len(inside)
    hosts = [k for k in range(count) if not inside[k]]
    if not hosts:
        raise InputError("a trim loop of poles alone")
    found: dict[int, tuple[list[int], list[int]]] = {k: ([], []) for k in hosts}
    for place, host in enumerate(hosts):
        following = hosts[(place + 1) % len(hosts)]
        cost = [(kept[k], iso[k] in BOUNDARY_ISO) for k in (host, following)]
        for step in range(1, (following - host - 1) % count + 1):
            k = (host + step) % count
            back = cost[0] < cost[1] or (cost[0] == cost[1] and k > host)
            found[host if back else following][1 if back else 0].append(k)
    return found


def _present(join: Array | None) -> list[Piece]:
    return [] if join is None else [join]


def _end(piece: Piece, place: int) -> Array:
    """The first (0) or the last (-1) point of a piece."""
    return piece.control_points()[place] if isinstance(piece, Nurbs) else piece[place]


def twin_sides(drawn: Sequence[DrawnTrim], surface: BSplineSurface) -> dict[int, int]:
    """Trims along one side of a closed surface that lie on edges of their own -> those that they meet across the seam.

    openNURBS wants both on one edge.
    """
    found: dict[int, int] = {}
    size = np.array([high - low for low, high in surface.domain])
    for axis, closed in enumerate((surface.closed_u, surface.closed_v)):
        sides = [
            [k for k, form in enumerate(drawn) if form.iso == side and not (form.item.seam or form.item.degenerate)]
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
    if not along.any():
        return np.array([start, end])
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
