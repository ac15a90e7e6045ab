"""Do two bodies touch? The verdict, how they lie to each other, how far apart they are, and where."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from .body import GridCache, SurfaceBody
from .classify import Kind, kind_of_meeting
from .distance import Body, between, prepared, smaller_size
from .interval import BUDGET, DistanceInterval
from .meeting import Side, field_meets, normals, surfaces_meet, witness_pair
from .pairs import SurfacePairs
from .solid import contains, is_solid

Array = NDArray[np.float64]
Verdict = Literal["clear", "contact", "undecided"]

TOUCH = 1e-6
"""Bodies nearer than this part of the smaller one's size touch: neighbouring faces of a CAD part, whose common edge each
gives by a curve of its own, are no farther apart."""

ROUNDING = 1e-12
"""The least touch tolerance, relative to the largest coordinate."""


@dataclass(frozen=True, slots=True, eq=False)
class Proximity:
    """verdict : "clear", "contact", or "undecided" where the budget ended first. kind : "clear", "touching", "piercing"
    or "contained"; a contact of kind "clear" is nearer than the clearance but apart. distance : the interval. touch,
    clearance : the lengths that decided. contacts : where; none for a clear pair."""

    verdict: Verdict
    kind: Kind
    distance: DistanceInterval
    touch: float
    clearance: float
    contacts: SurfacePairs


def proximity(
    a: Body,
    b: Body,
    *,
    clearance: float = 0.0,
    tolerance: float | None = None,
    touch: float | None = None,
    budget: int = BUDGET,
    cache: GridCache | None = None,
) -> Proximity:
    """The verdict on two bodies.

    clearance : "clear" means farther apart than this. tolerance, budget : of the distance, as for `distance`. touch : what
    is nearer meets; None: TOUCH of the smaller body. Solids (`is_solid`) count with their inside: one inside another is a
    contact at distance 0, whatever its boundary is away from the other's.

    Raises GeometryError or InputError for bodies that are not finite.
    """
    if not (np.isfinite(clearance) and clearance >= 0):
        raise InputError(f"a clearance of {clearance}", mend="give a length that is not negative")
    cache = GridCache() if cache is None else cache
    one, two = prepared(a, "first body", cache), prepared(b, "second body", cache)
    least = ROUNDING * max(_reach(one), _reach(two))
    if touch is None:
        touch = TOUCH * smaller_size([one, two])
    elif not (np.isfinite(touch) and touch >= 0):
        raise InputError(f"a touch tolerance of {touch}", mend="give a length that is not negative")
    touch = max(touch, least)
    limit = max(touch, clearance)
    found = between(one, two, tolerance=tolerance, budget=budget)
    if found.low <= limit < found.high and not found.exhausted:
        # the interval is as narrow as was asked, and lies across the limit
        found = found.narrowed(between(one, two, tolerance=least, threshold=limit, budget=budget))
    within = (contains(one, two, touch), contains(two, one, touch)) if found.low > touch else (False, False)
    if any(within):
        return Proximity("contact", "contained", replace(found, low=0.0, high=0.0, decided=True, exhausted=False), touch,
                         clearance, _closest(one, two, found, found.high))  # fmt: skip
    if None in within and found.low > limit:
        return Proximity("undecided", "clear", replace(found, low=0.0, decided=False), touch, clearance,
                         _closest(one, two, found, -found.high))  # fmt: skip
    if found.low > limit:
        return Proximity("clear", "clear", found, touch, clearance, SurfacePairs.none())
    if found.high > limit:
        return Proximity("undecided", "clear", found, touch, clearance, _closest(one, two, found, -found.high))
    if found.high > touch:
        return Proximity("contact", "clear", found, touch, clearance, _closest(one, two, found, -found.high))
    pairs = _meeting(one, two, touch)
    closest = _closest(one, two, found, 0.0)
    solid = is_solid(one), is_solid(two)
    kind = kind_of_meeting(one, two, solid, SurfacePairs.joined([pairs, closest]), touch)
    return Proximity("contact", kind, found, touch, clearance, pairs if len(pairs) else closest)


def separation(
    a: Body,
    b: Body,
    *,
    tolerance: float | None = None,
    threshold: float | None = None,
    budget: int = BUDGET,
    cache: GridCache | None = None,
) -> DistanceInterval:
    """The distance of two bodies as solids where they are: 0 where one lies inside the other. Arguments as for
    `distance`."""
    cache = GridCache() if cache is None else cache
    one, two = prepared(a, "first body", cache), prepared(b, "second body", cache)
    found = between(one, two, tolerance=tolerance, threshold=threshold, budget=budget)
    least = ROUNDING * max(_reach(one), _reach(two))
    for outer, inner in ((one, two), (two, one)):
        within = contains(outer, inner, least) if found.low > least else False
        if within:
            return replace(found, low=0.0, high=0.0)
        if within is None:
            return replace(found, low=0.0, decided=False)
    return found


def _meeting(a: Side, b: Side, touch: float) -> SurfacePairs:
    if isinstance(a, SurfaceBody) and isinstance(b, SurfaceBody):
        return surfaces_meet(a, b, touch)
    if isinstance(a, SurfaceBody) and not isinstance(b, SurfaceBody):
        return field_meets(a, b)
    if isinstance(b, SurfaceBody) and not isinstance(a, SurfaceBody):
        pairs = field_meets(b, a)
        out = normals(a, np.full(len(pairs), -1), pairs.u_b, pairs.v_b, pairs.other, pairs.point)
        return pairs.swapped(out)
    return SurfacePairs.none()


def _closest(a: Side, b: Side, found: DistanceInterval, depth: float) -> SurfacePairs:
    """The pair of points that attains the upper bound."""
    if found.a is None or found.b is None:
        return SurfacePairs.none()
    return witness_pair(a, b, found.a, found.b, depth)


def _reach(side: Side) -> float:
    """The largest coordinate of a body."""
    box = side.extents if isinstance(side, SurfaceBody) else np.asarray(side.box())
    return float(np.abs(box[np.isfinite(box)]).max(initial=1e-300))
