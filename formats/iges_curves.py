"""Curves of IGES files as B-splines, by the standard's own tables (IGES 5.3, sections 4.3 to 4.23).

Read are circular arcs (100), composites (102), polylines (106), lines (110), parametric splines (112) and B-splines (126).
Lengths are the file's; the matrices (124) that an entity names are applied.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..spline.matrices import breakpoints
from .arcs import unit_arc
from .iges_entities import number, spline_counts
from .iges_kernel import completed, matrix_of, matrix_pointer
from .iges_records import Entity, IgesFile

Array = NDArray[np.float64]

FULL_TURN = 2.0 * np.pi
DEEPEST = 20
"""Levels of composites within composites."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A clamped B-spline curve in space: control_points (n, 3), knots (n + degree + 1,), weights (n,) or None."""

    control_points: Array
    knots: Array
    degree: int
    weights: Array | None = None


def curves_of(file: IgesFile, pointer: int, depth: int = 0) -> list[Curve]:
    """The curve at `pointer`, head to tail in pieces where it is composed.

    Raises InputError for what is no curve, or of a kind that is not read here.
    """
    entity = file.at(pointer)
    if entity is None or depth > DEEPEST:
        raise InputError(f"entity {pointer} is no curve")
    if entity.type == 102:
        count = whole_of(entity, 1)
        pieces = [curves_of(file, whole_of(entity, 2 + i), depth + 1) for i in range(count)]
        made = [curve for piece in pieces for curve in piece]
    else:
        made = [_simple(entity)]
    matrix = matrix_of(file, matrix_pointer(entity))
    return made if np.array_equal(matrix, np.eye(4)) else [_moved(curve, matrix) for curve in made]


def _simple(entity: Entity) -> Curve:
    kinds = {100: _arc, 106: _polyline, 110: _line, 112: _parametric_spline, 126: _b_spline}
    if entity.type not in kinds:
        raise InputError(f"a curve of type {entity.type} is not read here")
    return kinds[entity.type](entity)


def _moved(curve: Curve, matrix: Array) -> Curve:
    points = curve.control_points @ matrix[:3, :3].T + matrix[:3, 3]
    return Curve(points, curve.knots, curve.degree, curve.weights)


# ---------------------------------------------------------------------- values


def whole_of(entity: Entity, place: int) -> int:
    """A whole number, 0 where it is left out. Raises InputError."""
    text = entity.parameters[place] if place < len(entity.parameters) else ""
    try:
        return int(text) if text else 0
    except ValueError:
        raise InputError(f"entity {entity.pointer}: {text[:30]!r} is no whole number") from None


def reals_of(entity: Entity, first: int, count: int) -> Array:
    """Numbers from a place on, 0 where they are left blank. Raises InputError for what is no number, or not there."""
    tokens = entity.parameters[first : first + count]
    values = [number(token) for token in tokens]
    if len(values) < count or any(value is None for value in values):
        raise InputError(f"entity {entity.pointer} (type {entity.type}) lacks numbers")
    return np.array(values, dtype=np.float64)


# ---------------------------------------------------------------------- curves


def _line(entity: Entity) -> Curve:
    return Curve(reals_of(entity, 1, 6).reshape(2, 3), np.array([0.0, 0.0, 1.0, 1.0]), 1)


def _arc(entity: Entity) -> Curve:
    z, cx, cy, x1, y1, x2, y2 = reals_of(entity, 1, 7)
    radius = np.hypot(x1 - cx, y1 - cy)
    start, stop = np.arctan2(y1 - cy, x1 - cx), np.arctan2(y2 - cy, x2 - cx)
    if not radius > 0.0:
        raise InputError(f"the arc of entity {entity.pointer} has no radius")
    if stop <= start + 1e-12:
        stop += FULL_TURN
    arc = unit_arc(float(start), float(stop))
    points = np.column_stack(
        [cx + radius * arc.points[:, 0], cy + radius * arc.points[:, 1], np.full(len(arc.points), z)]
    )
    return Curve(points, arc.knots, 2, arc.weights)


def _polyline(entity: Entity) -> Curve:
    kind, count = whole_of(entity, 1), whole_of(entity, 2)
    if kind == 1:
        z = reals_of(entity, 3, 1)[0]
        points = np.column_stack([reals_of(entity, 4, 2 * count).reshape(-1, 2), np.full(count, z)])
    elif kind in (2, 3):
        size = 3 * (kind - 1)
        points = reals_of(entity, 3, size * count).reshape(-1, size)[:, :3]
    else:
        raise InputError(f"a polyline of kind {kind} in entity {entity.pointer}")
    if entity.fields[14].strip() == "63":
        points = np.concatenate([points, points[:1]])
    if len(points) < 2:
        raise InputError(f"the polyline of entity {entity.pointer} has {len(points)} points")
    places = np.arange(len(points), dtype=np.float64)
    return Curve(points, np.concatenate([places[:1], places, places[-1:]]), 1)


def _parametric_spline(entity: Entity) -> Curve:
    """Entity 112: cubics a + b s + c s^2 + d s^3 over each span, s from its beginning."""
    count = whole_of(entity, 4)
    breaks = reals_of(entity, 5, count + 1)
    powers = reals_of(entity, 6 + count, 12 * count).reshape(count, 3, 4).transpose(0, 2, 1)
    step = np.diff(breaks)
    if not (step > 0.0).all():
        raise InputError(f"the breaks of entity {entity.pointer} do not ascend")
    bezier = np.einsum("bp,npd->nbd", BEZIER_OF_POWERS, powers * (step[:, None] ** np.arange(4))[:, :, None])
    points = np.concatenate([*(piece[:3] for piece in bezier), bezier[-1][3:]])
    return Curve(points, np.concatenate([breaks[:1], np.repeat(breaks, 3), breaks[-1:]]), 3)


BEZIER_OF_POWERS = np.array([[1.0, 0, 0, 0], [1.0, 1 / 3, 0, 0], [1.0, 2 / 3, 1 / 3, 0], [1.0, 1.0, 1.0, 1.0]])
"""Bezier points of a cubic from its powers of a parameter from 0 to 1."""


def _b_spline(entity: Entity) -> Curve:
    parameters = completed(entity.parameters) or entity.parameters
    counts = spline_counts(parameters)
    if counts is None:
        raise InputError(f"the degree or count of entity {entity.pointer} cannot be")
    (upper,), (degree,) = counts
    whole = Entity(entity.pointer, entity.fields, parameters)
    knots = reals_of(whole, 7, upper + degree + 2)
    weights = reals_of(whole, 9 + upper + degree, upper + 1)
    points = reals_of(whole, 10 + 2 * upper + degree, 3 * (upper + 1)).reshape(-1, 3)
    ends = reals_of(whole, 13 + 5 * upper + degree, 2)
    if (np.diff(knots) < 0.0).any() or not knots[degree] < knots[upper + 1] or not (weights > 0.0).all():
        raise InputError(f"the knots or weights of entity {entity.pointer} cannot be")
    curve = Curve(points, knots, degree, None if (weights == weights[0]).all() else weights)
    low, high = max(ends[0], knots[degree]), min(ends[1], knots[upper + 1])
    return segment(curve, float(low), float(high)) if low < high else segment(curve, *_domain(curve))


def _domain(curve: Curve) -> tuple[float, float]:
    return float(curve.knots[curve.degree]), float(curve.knots[-curve.degree - 1])


def segment(curve: Curve, low: float, high: float) -> Curve:
    """The part of a curve over [low, high], clamped."""
    points = curve.control_points
    if curve.weights is not None:
        points = np.column_stack([points * curve.weights[:, None], curve.weights])
    out, knots = segment_rows(points, curve.knots, curve.degree, low, high)
    if curve.weights is None:
        return Curve(out, knots, curve.degree)
    return Curve(out[:, :3] / out[:, 3:], knots, curve.degree, out[:, 3])


def segment_rows(points: Array, knots: Array, degree: int, low: float, high: float) -> tuple[Array, Array]:
    """Control points (n, d) and knots of the part of a curve over [low, high], clamped (blossoms; Piegl and Tiller, 5.2)."""
    p = degree
    if (knots[: p + 1] == low).all() and (knots[-p - 1 :] == high).all():
        return points, knots
    inner = knots[(knots > low) & (knots < high)]
    new = np.concatenate([np.full(p + 1, low), inner, np.full(p + 1, high)])
    breaks = breakpoints(new, p)
    made = []
    for i in range(len(new) - p - 1):
        span = np.flatnonzero((breaks[1:] > new[i]) & (breaks[:-1] < new[i + p + 1]))[0]
        middle = 0.5 * (breaks[span] + breaks[span + 1])
        j = int(np.searchsorted(knots, middle, side="right")) - 1
        made.append(_blossom(points[j - p : j + 1], knots[j - p + 1 : j + p + 1], new[i + 1 : i + p + 1]))
    return np.array(made), new


def _blossom(points: Array, knots: Array, arguments: Array) -> Array:
    """The blossom of one span: points (p + 1, d), the 2 p knots around it, p arguments."""
    d, p = points.copy(), len(arguments)
    for r in range(1, p + 1):
        for k in range(p, r - 1, -1):
            left, right = knots[k - 1], knots[k + p - r]
            a = (arguments[r - 1] - left) / (right - left)
            d[k] = (1.0 - a) * d[k - 1] + a * d[k]
    return d[p]
