"""Which part of a rectangle in (u, v) belongs to a trimmed face, with certainty.

`trim.inside` answers for points and chords. Here every chord knows how far its curve may leave it, so that a rectangle
that no chord comes near, by that much, lies wholly on the face or wholly off it; all others are mixed, and a piece of
the face is never given away however small it is against the rectangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..jit import njit, njit_in_place
from .bounds import S_UU, derivative_bounds
from .surface import BSplineSurface, TrimCurve
from .trim import curve_points

Array = NDArray[np.float64]
Index = NDArray[np.int64]

OFF, ON, MIXED = 0, 1, 2
"""A rectangle lies wholly off the face, wholly on it, or the face's border (or what cannot be told from it) meets it."""

DEVIATION = 2e-8
"""How far a chord may leave its trim curve, as a part of the face's extent: the border is known to this width."""

CHORDS = 2048
"""Most chords for a span of a trim curve, or a part of one; where they do not reach DEVIATION, the border is as wide as
they leave it."""

MANY, PARTS = 64, 16
"""A span of a trim curve that would take more chords than MANY is looked at in so many parts."""

BORDER = 1e-9
"""A point this near to a chord is on the border, as a part of the face's extent: what files round off."""

SMALL = 1e-5
"""Faces narrower than this part of the domain are taken for that wide: below is rounding."""

LEAF = 4
"""Chords in one leaf of the tree of boxes over them."""


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """The trimmed face of a surface, in coordinates in which the box of its trims is the unit square: on a surface that is
    far larger than the face, both ways or one way, the border is as sharp as on any other.

    chords (k, 4) : s0, t0, s1, t1. deviation (k,) : how far the curve leaves each. box (nodes, 4) : low s, low t, high
    s, high t of a complete binary tree over leaves of LEAF chords, deviations included. shifts (m, 2) : images of a
    point that count too, one period away on closed surfaces. domain (2, 2) : low and high of the surface's. width : the
    largest deviation, with BORDER.
    """

    chords: Array
    deviation: Array
    box: Array
    shifts: Array
    low: Array
    size: Array
    domain: Array
    width: float

    @classmethod
    def of(cls, surface: BSplineSurface) -> Region | None:
        """The region of a surface's trim loops, or None where the whole domain is the face."""
        if surface.trims is None:
            return None
        (u0, u1), (v0, v1) = surface.domain
        whole = np.array([u1 - u0, v1 - v0])
        net = np.concatenate([curve.control_points for loop in surface.trims for curve in loop.curves])
        low, size = net.min(axis=0), np.maximum(np.ptp(net, axis=0), SMALL * whole)
        domain = (np.array([[u0, v0], [u1, v1]]) - low) / size
        period = whole / size
        # what is lost where a parameter far from zero is brought into the unit square
        lost = 2e-16 * float((np.abs([[u0, v0], [u1, v1]]) / size).max())
        chords, deviation = [np.zeros((0, 4))], [np.zeros(0)]
        for loop in surface.trims:
            parts = [_chain(curve, low, size) for curve in loop.curves]
            for k, (points, off) in enumerate(parts):
                chords.append(np.concatenate([points[:-1], points[1:]], axis=1))
                deviation.append(off + lost)
                # where two curves do not quite meet, a chord joins them
                following = parts[(k + 1) % len(parts)][0]
                chords.append(np.concatenate([points[-1:], following[:1]], axis=1))
                deviation.append(np.full(1, lost))
        lines, off = np.ascontiguousarray(np.concatenate(chords)), np.concatenate(deviation)
        shifts = [
            (s * period[0], t * period[1])
            for s in ((0.0, 1.0, -1.0) if surface.closed_u else (0.0,))
            for t in ((0.0, 1.0, -1.0) if surface.closed_v else (0.0,))
        ]
        width = float(off.max(initial=0.0)) + BORDER
        return cls(lines, off, _tree(lines, off), np.array(shifts), low, size, domain, width)

    def classify(self, rectangles: Array) -> Index:
        """OFF, ON or MIXED for rectangles (n, 4): u0, u1, v0, v1. Conservative: OFF and ON are certain."""
        out = np.empty(len(rectangles), np.int64)
        classify(
            self.chords, self.deviation, self.box, self.shifts, self.low, self.size,
            np.ascontiguousarray(rectangles, dtype=np.float64), out,
        )  # fmt: skip
        return out

    def locate(self, uv: Array) -> Index:
        """OFF, ON or MIXED (on the border, to `width`) for points uv (n, 2)."""
        uv = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
        on = BORDER * self.size
        return self.classify(np.stack([uv[:, 0] - on[0], uv[:, 0] + on[0], uv[:, 1] - on[1], uv[:, 1] + on[1]], axis=1))

    def border_in(self, rectangle: Array, most: int = 3) -> list[tuple[Array, float, float]]:
        """Chords (2, 2) in (u, v), cut off at the domain, that run through a rectangle (4,): at most `most`, spread over
        all that do. Each with its middle in the rectangle, as a part of the chord, and its curve's deviation."""
        found: list[tuple[Array, float, float]] = []
        for shift in self.shifts:
            r = np.array([(rectangle[:2] - self.low[0]) / self.size[0], (rectangle[2:] - self.low[1]) / self.size[1]])
            r += shift[:, None]
            a, b = self.chords[:, :2], self.chords[:, 2:]
            off = self.deviation[:, None]
            near = ((np.minimum(a, b) <= r[:, 1] + off) & (np.maximum(a, b) >= r[:, 0] - off)).all(axis=1)
            parts = []
            where = np.flatnonzero(near)
            if len(where) > 4 * most:
                # boxes that meet are not chords that do: a few more than are wanted
                where = where[np.linspace(0, len(where) - 1, 4 * most).astype(np.int64)]
            for k in where:
                wide = float(self.deviation[k]) * np.array([-1.0, 1.0])
                inner = _clip(a[k], b[k], r + wide)
                whole = _clip(a[k], b[k], self.domain.T + shift[:, None] + wide)
                if inner is None or whole is None:
                    continue
                ends = a[k] + np.outer(whole, b[k] - a[k])
                middle = (0.5 * (inner[0] + inner[1]) - whole[0]) / max(whole[1] - whole[0], 1e-300)
                chord = self.low + np.clip(ends - shift, *self.domain) * self.size
                parts.append((chord, float(np.clip(middle, 0.0, 1.0)), float(self.deviation[k])))
            found += parts
        if len(found) > most:
            found = [found[int((k + 0.5) * len(found) / most)] for k in range(most)]
        return found


def _clip(a: Array, b: Array, box: Array) -> tuple[float, float] | None:
    """Between which parts of the way from a to b (2,) one is inside a box (2, 2), low and high by axis; None if never."""
    low, high = 0.0, 1.0
    for c in range(2):
        d = b[c] - a[c]
        if d == 0.0:
            if not box[c, 0] <= a[c] <= box[c, 1]:
                return None
            continue
        t0, t1 = sorted(((box[c, 0] - a[c]) / d, (box[c, 1] - a[c]) / d))
        low, high = max(low, float(t0)), min(high, float(t1))
    return (low, high) if low <= high else None


def _chain(curve: TrimCurve, low: Array, size: Array) -> tuple[Array, Array]:
    """Points (n + 1, 2) of a trim curve in the unit square, and how far it leaves each of the n chords between them."""
    from .matrices import span_parameters
    from .refine import insert_knots

    net = np.zeros((len(curve.control_points), 2, 3))
    net[:, :, :2] = ((curve.control_points - low) / size)[:, None]
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    weights = None if curve.weights is None else np.repeat(curve.weights[:, None], 2, axis=1)
    # the curve as a surface that does not depend on its second parameter: one bound on second derivatives for both
    surface = BSplineSurface(net, curve.knots, knots, curve.degree, 1, weights)
    for first in (True, False):
        edges, _ = span_parameters(surface.knots_u, curve.degree, 1)
        length = np.diff(edges)
        bent = derivative_bounds(surface)[:, 0, S_UU] if curve.degree > 1 else np.zeros(len(length))
        wanted = np.ceil(length * np.sqrt(bent / (8.0 * DEVIATION)))
        if not (first and (wanted > MANY).any()):
            break
        # what bends at one end of a span, or only in its control points, bends less in most of its parts
        inner = edges[:-1, None] + length[:, None] * np.arange(1, PARTS) / PARTS
        surface = insert_knots(surface, knots_u=inner[wanted > MANY].ravel())
    pieces = np.clip(wanted, 1, CHORDS).astype(np.int64)
    t, _ = span_parameters(surface.knots_u, curve.degree, pieces)
    off = np.repeat((length / pieces) ** 2 * bent / 8.0, pieces)
    points = (curve_points(curve, t) - low) / size
    return points, off * (1.0 + 1e-9) + 1e-15 * np.abs(points).max(initial=1.0)


def _tree(lines: Array, off: Array) -> Array:
    """Boxes (2 n - 1, 4) of a complete binary tree over n leaves, the root first, the children of k at 2 k + 1, 2 k + 2."""
    leaves = 1
    while leaves * LEAF < len(lines):
        leaves *= 2
    box = np.empty((2 * leaves - 1, 4))
    box[:, :2], box[:, 2:] = np.inf, -np.inf
    lows = np.minimum(lines[:, :2], lines[:, 2:]) - off[:, None]
    highs = np.maximum(lines[:, :2], lines[:, 2:]) + off[:, None]
    at = leaves - 1 + np.arange(len(lines)) // LEAF
    np.minimum.at(box[:, :2], at, lows)
    np.maximum.at(box[:, 2:], at, highs)
    while leaves > 1:
        leaves //= 2
        here = np.arange(leaves - 1, 2 * leaves - 1)
        box[here, :2] = np.minimum(box[2 * here + 1, :2], box[2 * here + 2, :2])
        box[here, 2:] = np.maximum(box[2 * here + 1, 2:], box[2 * here + 2, 2:])
    return box


@njit
def classify(
    chords: Array, deviation: Array, box: Array, shifts: Array, low: Array, size: Array, rectangles: Array, out: Index
) -> None:
    """OFF, ON or MIXED of rectangles (n, 4) in (u, v), into out (n,)."""
    stack = np.empty(128, np.int64)
    for k in range(len(rectangles)):
        out[k] = OFF
        for m in range(len(shifts)):
            s0 = (rectangles[k, 0] - low[0]) / size[0] + shifts[m, 0]
            s1 = (rectangles[k, 1] - low[0]) / size[0] + shifts[m, 0]
            t0 = (rectangles[k, 2] - low[1]) / size[1] + shifts[m, 1]
            t1 = (rectangles[k, 3] - low[1]) / size[1] + shifts[m, 1]
            if border_meets(chords, deviation, box, s0, s1, t0, t1, stack):
                out[k] = MIXED
                break
            if odd(chords, box, 0.5 * (s0 + s1), 0.5 * (t0 + t1), stack):
                out[k] = ON


@njit_in_place
def border_meets(
    chords: Array, deviation: Array, box: Array, s0: float, s1: float, t0: float, t1: float, stack: Index
) -> bool:
    """Whether a chord comes as near to the rectangle as its deviation."""
    leaves = (len(box) + 1) // 2
    stack[0] = 0
    top = 1
    while top > 0:
        top -= 1
        k = stack[top]
        if box[k, 0] > s1 or box[k, 2] < s0 or box[k, 1] > t1 or box[k, 3] < t0:
            continue
        if k < leaves - 1:
            stack[top], stack[top + 1] = 2 * k + 1, 2 * k + 2
            top += 2
            continue
        first = (k - leaves + 1) * LEAF
        for i in range(first, min(first + LEAF, len(chords))):
            d = deviation[i]
            a, b, c, e = chords[i, 0], chords[i, 1], chords[i, 2], chords[i, 3]
            if min(a, c) > s1 + d or max(a, c) < s0 - d or min(b, e) > t1 + d or max(b, e) < t0 - d:
                continue
            # the line's own direction as separating axis, with the rectangle grown by the deviation
            nx, ny = b - e, c - a
            middle = nx * (0.5 * (s0 + s1) - a) + ny * (0.5 * (t0 + t1) - b)
            reach = abs(nx) * (0.5 * (s1 - s0) + d) + abs(ny) * (0.5 * (t1 - t0) + d)
            if abs(middle) <= reach * (1.0 + 1e-12) + 1e-30:
                return True
    return False


@njit_in_place
def odd(chords: Array, box: Array, s: float, t: float, stack: Index) -> bool:
    """Even-odd rule: the chords that cross the ray from (s, t) towards larger s are odd in number."""
    leaves = (len(box) + 1) // 2
    stack[0] = 0
    top, count = 1, 0
    while top > 0:
        top -= 1
        k = stack[top]
        if box[k, 2] < s or box[k, 1] > t or box[k, 3] < t:
            continue
        if k < leaves - 1:
            stack[top], stack[top + 1] = 2 * k + 1, 2 * k + 2
            top += 2
            continue
        first = (k - leaves + 1) * LEAF
        for i in range(first, min(first + LEAF, len(chords))):
            b, e = chords[i, 1], chords[i, 3]
            if (b > t) != (e > t) and chords[i, 0] + (t - b) / (e - b) * (chords[i, 2] - chords[i, 0]) > s:
                count += 1
    return count % 2 == 1
