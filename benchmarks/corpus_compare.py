"""How far two readings of one surface lie apart: control points, knots, weights, trims, each relative to its size."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cadsculpt.formats.occt.trim import evaluate_trim, trim_domain
from cadsculpt.formats.part import Face
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

Array = NDArray[np.float64]

SAME = 1e-9
"""Relative difference within which numbers are the same."""

FAR = 1e9
"""A difference that stands for "not the same kind of thing at all"."""


@dataclass(frozen=True, slots=True)
class Difference:
    """control_points, trims: relative to the surface's size; knots: to their range; weights: to the largest one.

    same_net: degrees and numbers of control points agree; where they do not, control_points compares points of the
    surfaces at equal parameters, and knots the domains.
    """

    control_points: float
    knots: float
    weights: float
    trims: float
    same_net: bool
    turned: bool = False
    """The second reading runs the other way in u or v; the rest is compared after it is turned back."""

    @property
    def largest(self) -> float:
        return max(self.control_points, self.knots, self.weights, self.trims)

    def as_dict(self) -> dict[str, object]:
        return asdict(self)


def difference(
    a: BSplineSurface, b: BSplineSurface, *, trims: bool = True, unit_range: bool = False, parameters: bool = True
) -> Difference:
    """How far `b` is from `a`. trims : compare them. unit_range : b's parameters run from 0 to 1 instead of a's range.

    parameters : compare knots, and trims in (u, v) too; False for surfaces that were no splines, whose parameters the
    conversion chose.
    """
    if unit_range:
        b = _stretched(b, a)
    turns = [_difference(a, turned, trims, parameters, turned is not b) for turned in _turned(b)]
    return min(turns, key=lambda found: (found.largest > SAME, found.turned, found.largest))


def _difference(a: BSplineSurface, b: BSplineSurface, trims: bool, parameters: bool, turned: bool) -> Difference:
    size = max(a.size, 1e-300)
    same = a.shape == b.shape and (a.degree_u, a.degree_v) == (b.degree_u, b.degree_v)
    if same:
        points = float(np.abs(a.control_points - b.control_points).max()) / size
        knots = max(_knots(a.knots_u, b.knots_u), _knots(a.knots_v, b.knots_v))
        weights = _weights(a, b)
    else:
        u, v = (np.linspace(*bounds, 23) for bounds in a.domain)
        s, t = (np.linspace(*bounds, 23) for bounds in b.domain)
        points = float(np.abs(a.evaluate(u[:, None], v) - b.evaluate(s[:, None], t)).max()) / size
        knots = float(np.abs(np.subtract(a.domain, b.domain)).max()) / max(x[1] - x[0] for x in a.domain)
        weights = 0.0
    if points > 1e-6:
        return Difference(points, knots, weights, FAR, same, turned)
    return Difference(
        points,
        knots if parameters else 0.0,
        weights,
        _trims(a, b, parameters) / size if trims else 0.0,
        same,
        turned,
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


def _knots(a: Array, b: Array) -> float:
    """The outermost knots shape nothing and are not compared: openNURBS does not store them."""
    if len(a) != len(b):
        return FAR
    return float(np.abs(a[1:-1] - b[1:-1]).max() / (a[-1] - a[0]))


def _weights(a: BSplineSurface, b: BSplineSurface) -> float:
    """A common factor of all weights changes nothing."""
    wa = np.ones(a.shape) if a.weights is None else a.weights / a.weights.max()
    wb = np.ones(b.shape) if b.weights is None else b.weights / b.weights.max()
    return float(np.abs(wa - wb).max())


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

    Curves are compared at equal shares of their ranges first, run either way; where that does not fit, because one runs
    at another pace or is cut elsewhere, places along each are compared with the nearest places of the other.
    """
    if a.trims is None and b.trims is None:
        return 0.0
    if a.trims is None or b.trims is None or len(a.trims) != len(b.trims):
        return FAR * a.size
    mine, other = _curves(a.trims), _curves(b.trims)
    if len(mine) == len(other):
        here = [_along(a, curve, parameters) for curve in mine]
        there = [_along(b, curve, parameters) for curve in other]
        left, worst = set(range(len(there))), 0.0
        for points in here:
            apart = {k: min(_apart(points, there[k]), _apart(points, there[k][::-1])) for k in left}
            nearest = min(apart, key=lambda k: apart[k])
            left.remove(nearest)
            worst = max(worst, apart[nearest])
        if worst <= SAME * a.size:
            return worst
    return max(_off(a, mine, b, other, parameters), _off(b, other, a, mine, parameters))


def _curves(trims: Sequence[TrimLoop]) -> list[TrimCurve]:
    return [curve for loop in trims for curve in loop.curves]


def _along(surface: BSplineSurface, curve: TrimCurve, parameters: bool, count: int = 9) -> Array:
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
