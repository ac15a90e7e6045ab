"""How far two readings of one surface lie apart: control points, knots, weights, trims, each relative to its size."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cadsculpt.formats.occt.trim import evaluate_trim, reversed_trim, signed_area, trim_domain
from cadsculpt.formats.part import Face
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

Array = NDArray[np.float64]

SAME = 1e-9
"""Relative difference within which numbers are the same."""

AREA = 0.05
"""Loops whose areas differ by more than this share of the domain are not the same loops; finer differences are the curves'."""

FAR = 1e9
"""A difference that stands for "not the same kind of thing at all"."""


@dataclass(frozen=True, slots=True)
class Difference:
    """control_points, trims: relative to the surface's size; knots: to their range; weights: to the largest one.

    same_net: degrees and numbers of control points agree; where they do not, control_points compares points of the
    surfaces at equal parameters, and knots the domains. FAR stands where there is nothing to compare with.
    """

    control_points: float
    knots: float
    weights: float
    trims: float
    same_net: bool
    turned: bool = False
    """The second reading runs the other way in u or v; the rest is compared after it is turned back."""
    flipped: bool = False
    """The second reading has its outside on the other side."""
    weight_factor: float = 0.0
    """How far the common factor of all weights, which shapes nothing, is from 1; `weights` is without it."""
    outermost_knots: float = 0.0
    """Difference of the first and the last knots, which shape nothing; `knots` has them too where they are compared."""

    @property
    def same(self) -> bool:
        """Nothing differs by more than rounding."""
        return self.same_net and not self.flipped and self.largest <= SAME

    def causes(self) -> list[str]:
        """What differs, by name."""
        if not self.same_net:
            return ["net"]
        found = [name for name in ("control_points", "knots", "weights") if getattr(self, name) > SAME]
        if self.trims > SAME:
            found.append("trims" if self.trims < FAR / 2 else "trim loops")
        return found + ["side"] * self.flipped

    @property
    def largest(self) -> float:
        return max(self.control_points, self.knots, self.weights, self.trims)

    def as_dict(self) -> dict[str, object]:
        return asdict(self)


def difference(
    a: BSplineSurface,
    b: BSplineSurface,
    *,
    trims: bool = True,
    unit_range: bool = False,
    parameters: bool = True,
    sides: bool = True,
    outermost: bool = True,
) -> Difference:
    """How far `b` is from `a`. trims, sides : compare them. unit_range : b's parameters run from 0 to 1 instead of a's range.
    outermost : compare the first and the last knots too, which shape nothing.

    parameters : compare knots, and trims in (u, v) too; False for surfaces that were no splines, whose parameters the
    conversion chose.
    """
    if unit_range:
        b = _stretched(b, a)
    turns = [_difference(a, turned, trims, parameters, outermost, turned is not b) for turned in _turned(b)]
    found = min(turns, key=lambda found: (found.largest > SAME, found.turned, found.largest))
    return replace(found, flipped=sides and (a.outward != b.outward) != found.turned)


def _difference(
    a: BSplineSurface, b: BSplineSurface, trims: bool, parameters: bool, outermost: bool, turned: bool
) -> Difference:
    size = max(a.size, 1e-300)
    same = a.shape == b.shape and (a.degree_u, a.degree_v) == (b.degree_u, b.degree_v)
    if same:
        points = float(np.abs(a.control_points - b.control_points).max()) / size
        both = ((a.knots_u, b.knots_u), (a.knots_v, b.knots_v))
        ends = max(_knots(mine[[0, -1]], other[[0, -1]], np.ptp(mine)) for mine, other in both)
        knots = max(_knots(mine[1:-1], other[1:-1], np.ptp(mine)) for mine, other in both)
        knots = max(knots, ends) if outermost else knots
        weights, factor = _weights(a, b)
    else:
        u, v = (np.linspace(*bounds, 23) for bounds in a.domain)
        s, t = (np.linspace(*bounds, 23) for bounds in b.domain)
        points = float(np.abs(a.evaluate(u[:, None], v) - b.evaluate(s[:, None], t)).max()) / size
        knots = float(np.abs(np.subtract(a.domain, b.domain)).max()) / max(x[1] - x[0] for x in a.domain)
        weights = factor = ends = 0.0
    if points > 1e-6:
        return Difference(points, knots, weights, FAR if trims else 0.0, same, turned, False, factor, ends)
    return Difference(
        points,
        knots if parameters else 0.0,
        weights,
        _trims(a, b, parameters) / size if trims else 0.0,
        same,
        turned,
        weight_factor=factor,
        outermost_knots=ends if parameters else 0.0,
    )


def _turned(surface: BSplineSurface) -> Iterator[BSplineSurface]:
    """The surface, and the surface run the other way in u or in v: IGES has no other way to say which side is out."""
    yield surface
    for axis in (0, 1):
        yield _reversed(surface, axis)


def _reversed(surface: BSplineSurface, axis: int) -> BSplineSurface:
    low, high = surface.domain[axis]

    def curve(c: TrimCurve) -> TrimCurve:
        points = c.control_points.copy()
        points[:, axis] = low + high - points[:, axis]
        return replace(c, control_points=points)

    knots = (low + high) - (surface.knots_u, surface.knots_v)[axis][::-1]
    trims = surface.trims and tuple(replace(loop, curves=tuple(map(curve, loop.curves))) for loop in surface.trims)
    return replace(
        surface,
        control_points=np.ascontiguousarray(np.flip(surface.control_points, axis)),
        weights=None if surface.weights is None else np.ascontiguousarray(np.flip(surface.weights, axis)),
        trims=trims or None,
        **({"knots_u": knots} if axis == 0 else {"knots_v": knots}),
    )


def _knots(a: Array, b: Array, span: float) -> float:
    return float(np.abs(a - b).max() / span) if len(a) == len(b) else FAR


def _weights(a: BSplineSurface, b: BSplineSurface) -> tuple[float, float]:
    """The difference without the common factor of all weights, which changes nothing, and how far that is from 1."""
    wa = np.ones(a.shape) if a.weights is None else a.weights
    wb = np.ones(b.shape) if b.weights is None else b.weights
    return float(np.abs(wa / wa.max() - wb / wb.max()).max()), abs(float(wb.max() / wa.max()) - 1.0)


def _stretched(surface: BSplineSurface, like: BSplineSurface) -> BSplineSurface:
    """A surface whose parameters run from 0 to 1, over the domain of another."""
    (u0, u1), (v0, v1) = like.domain
    (s0, s1), (t0, t1) = surface.domain
    scale, start = np.array([(u1 - u0) / (s1 - s0), (v1 - v0) / (t1 - t0)]), np.array([s0, t0])
    origin = np.array([u0, v0])

    def curve(c: TrimCurve) -> TrimCurve:
        return replace(c, control_points=origin + (c.control_points - start) * scale)

    trims = surface.trims and tuple(replace(loop, curves=tuple(map(curve, loop.curves))) for loop in surface.trims)
    return replace(
        surface,
        knots_u=u0 + (surface.knots_u - s0) * scale[0],
        knots_v=v0 + (surface.knots_v - t0) * scale[1],
        trims=trims or None,
    )


# ------------------------------------------------------------------------- trims


def _trims(a: BSplineSurface, b: BSplineSurface, parameters: bool) -> float:
    """Largest distance between the trim curves of two surfaces, a length: in space, and in (u, v) scaled to lengths.

    Curves with the same knots and weights are compared by their control points, others at equal shares of their ranges, run
    either way; where that does not fit, because one runs at another pace or is cut elsewhere, places along each are compared
    with the nearest places of the other. Loops that enclose something else, or are outer where they were inner, are FAR.
    """
    if a.trims is None and b.trims is None:
        return 0.0
    if a.trims is None or b.trims is None or len(a.trims) != len(b.trims) or not _same_loops(a, b):
        return FAR * a.size
    mine, other = _curves(a.trims), _curves(b.trims)
    if len(mine) == len(other):
        here = [_along(a, curve, parameters) for curve in mine]
        there = [_along(b, curve, parameters) for curve in other]
        left, worst = set(range(len(there))), 0.0
        for curve, points in zip(mine, here, strict=True):
            apart = {k: min(_apart(points, there[k]), _apart(points, there[k][::-1])) for k in left}
            nearest = min(apart, key=lambda k: apart[k])
            left.remove(nearest)
            worst = max(worst, apart[nearest], _nets(a, curve, other[nearest]) if parameters else 0.0)
        if worst <= SAME * a.size:
            return worst
    return max(_off(a, mine, b, other, parameters), _off(b, other, a, mine, parameters))


def _same_loops(a: BSplineSurface, b: BSplineSurface) -> bool:
    """Whether the outer loops enclose the same areas of the domain, in size, and the inner ones too."""
    (u0, u1), (v0, v1) = a.domain

    def areas(surface: BSplineSurface, outer: bool) -> Array:
        found = [abs(signed_area(loop)) for loop in surface.trims or () if loop.outer == outer]
        return np.sort(found) / ((u1 - u0) * (v1 - v0))

    pairs = [(areas(a, outer), areas(b, outer)) for outer in (True, False)]
    return all(len(mine) == len(other) and np.allclose(mine, other, atol=AREA) for mine, other in pairs)


def _nets(surface: BSplineSurface, a: TrimCurve, b: TrimCurve) -> float:
    """How far the control points of two curves of one shape lie apart, as lengths; 0 for curves that are made otherwise."""
    (u0, u1), (v0, v1) = surface.domain
    size = np.array([u1 - u0, v1 - v0])
    found = []
    for curve in (b, reversed_trim(b)):
        if curve.degree != a.degree or curve.control_points.shape != a.control_points.shape:
            return 0.0
        wa, wb = (np.ones(len(c.control_points)) if c.weights is None else c.weights for c in (a, curve))
        knots = (a.knots - a.knots[0]) / np.ptp(a.knots), (curve.knots - curve.knots[0]) / np.ptp(curve.knots)
        if np.abs(knots[0] - knots[1]).max() <= SAME and np.abs(wa / wa.max() - wb / wb.max()).max() <= SAME:
            found.append(float((np.abs(a.control_points - curve.control_points) / size).max()) * surface.size)
    return min(found, default=0.0)


def _curves(trims: Sequence[TrimLoop]) -> list[TrimCurve]:
    return [curve for loop in trims for curve in loop.curves]


def _along(surface: BSplineSurface, curve: TrimCurve, parameters: bool, count: int = 33) -> Array:
    """(count, 3 or 5): points of the surface along a trim curve; with `parameters` (u, v) too, scaled to lengths."""
    return _placed(surface, evaluate_trim(curve, np.linspace(*trim_domain(curve), count)), parameters)


def _placed(surface: BSplineSurface, uv: Array, parameters: bool) -> Array:
    points: Array = surface.evaluate(uv[:, 0], uv[:, 1])
    if not parameters:
        return points
    (u0, u1), (v0, v1) = surface.domain
    return np.column_stack([points, (uv - [u0, v0]) / [u1 - u0, v1 - v0] * surface.size])


def _off(
    a: BSplineSurface, mine: Sequence[TrimCurve], b: BSplineSurface, other: Sequence[TrimCurve], parameters: bool
) -> float:
    """How far places along the trim curves of `a` are from those of `b`: Gauss-Newton along the nearest curve."""
    from scipy.spatial import cKDTree

    at = [
        np.union1d(np.linspace(*trim_domain(curve), 129), np.clip(curve.knots, *trim_domain(curve))) for curve in other
    ]
    samples = [_placed(b, evaluate_trim(curve, t), parameters) for curve, t in zip(other, at, strict=True)]
    owner = np.repeat(np.arange(len(other)), [len(t) for t in at])
    every, tree = np.concatenate(at), cKDTree(np.concatenate(samples))
    worst = 0.0
    for curve in mine:
        points = _along(a, curve, parameters, 25)
        distance, index = tree.query(points)
        for k in np.unique(owner[index]):
            rows = owner[index] == k
            low, high = trim_domain(other[k])
            t = every[index[rows]]
            h, best = 1e-6 * (high - low), distance[rows]
            for _ in range(10):
                here = _placed(b, evaluate_trim(other[k], t), parameters)
                ahead = np.clip(t + h, low, high)
                behind = np.clip(t - h, low, high)
                rate = (
                    _placed(b, evaluate_trim(other[k], ahead), parameters)
                    - _placed(b, evaluate_trim(other[k], behind), parameters)
                ) / np.maximum(ahead - behind, 1e-300)[:, None]
                away = points[rows] - here
                best = np.minimum(best, np.linalg.norm(away, axis=1))
                speed = np.maximum(np.einsum("ij,ij->i", rate, rate), 1e-300)
                t = np.clip(t + np.einsum("ij,ij->i", away, rate) / speed, low, high)
            worst = max(worst, float(best.max()))
    return worst


def _apart(a: Array, b: Array) -> float:
    return float(np.abs(a - b).max())


# ------------------------------------------------------------------ faces of parts


def pairs(first: Sequence[Face], second: Sequence[Face]) -> list[tuple[Face, Face | None]]:
    """Each face of one reading with its own in the other: by its name, else the nearest control net of those left."""
    by_name = {face.name: face for face in second}
    left = {face.number: face for face in second}
    found: dict[int, Face | None] = {}
    for face in first:
        other = by_name.get(face.name)
        if other is not None and other.number in left and _alike(face, other):
            found[face.number] = left.pop(other.number)
    places = {n: _middle(face) for n, face in left.items()}
    for face in first:
        if face.number in found:
            continue
        here = _middle(face)
        nearest = min(places, key=lambda n: float(np.abs(places[n] - here).max()), default=None)
        found[face.number] = left[nearest] if nearest is not None else None
        if nearest is not None:
            del places[nearest]
    return [(face, found[face.number]) for face in first]


def _alike(a: Face, b: Face) -> bool:
    return bool(np.abs(_middle(a) - _middle(b)).max() <= 1e-3 * max(a.surface.size, 1e-300))


def _middle(face: Face) -> Array:
    """(6,): mean and spread of the control points."""
    points = face.surface.control_points.reshape(-1, 3)
    return np.concatenate([points.mean(axis=0), points.std(axis=0)])
