"""Trimmed faces: which part of the parameter plane is material."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..jit import njit
from .matrices import design_matrix, span_parameters
from .surface import BSplineSurface, TrimCurve, TrimLoop

Array = NDArray[np.float64]


def curve_points(curve: TrimCurve, t: ArrayLike) -> Array:
    """Points (..., 2) of a trim curve at parameters t."""
    t = np.asarray(t, dtype=np.float64)
    basis = design_matrix(curve.knots, curve.degree, t.ravel())
    if curve.weights is None:
        return (basis @ curve.control_points).reshape(*t.shape, 2)
    w = basis @ curve.weights
    points: Array = (basis @ (curve.control_points * curve.weights[:, None])) / w[:, None]
    return points.reshape(*t.shape, 2)


def polyline(curve: TrimCurve, per_span: int = 16) -> Array:
    """Points (n, 2) along a trim curve, `per_span` chords a knot span (one for a straight line)."""
    pieces = 1 if curve.degree == 1 else per_span
    t, _ = span_parameters(curve.knots, curve.degree, pieces)
    return curve_points(curve, t)


def loop_polyline(loop: TrimLoop, per_span: int = 16) -> Array:
    """The loop as one closed chain (n, 2), first point repeated at the end."""
    points = np.concatenate([polyline(curve, per_span) for curve in loop.curves])
    return np.concatenate([points, points[:1]])


def box(loops: Sequence[TrimLoop]) -> tuple[Array, Array]:
    """Lower and upper corner (2,) of all loops' curves."""
    points = np.concatenate([loop_polyline(loop) for loop in loops])
    return points.min(axis=0), points.max(axis=0)


def inside(surface: BSplineSurface, u: Array, v: Array) -> NDArray[np.bool_]:
    """Whether the grid points (u[i], v[j]) lie on the trimmed face: (len(u), len(v)).

    Even-odd rule over all loops, whatever their orientation; on a closed surface the images one period away count too,
    because exporters let trim curves run over the seam. A point on a loop counts as inside.
    """
    u = np.ascontiguousarray(u, dtype=np.float64)
    v = np.ascontiguousarray(v, dtype=np.float64)
    if surface.trims is None:
        return np.ones((len(u), len(v)), dtype=np.bool_)
    segments = []
    for loop in surface.trims:
        chain = loop_polyline(loop)
        segments.append(np.concatenate([chain[:-1], chain[1:]], axis=1))
    lines = np.ascontiguousarray(np.concatenate(segments))
    (u0, u1), (v0, v1) = surface.domain
    result = np.zeros((len(u), len(v)), dtype=np.bool_)
    on_u, on_v = 1e-9 * (u1 - u0), 1e-9 * (v1 - v0)
    for shift_u in (0.0, u1 - u0, u0 - u1) if surface.closed_u else (0.0,):
        for shift_v in (0.0, v1 - v0, v0 - v1) if surface.closed_v else (0.0,):
            result |= _even_odd(lines, u + shift_u, v + shift_v, on_u, on_v)
    return result


@njit
def _even_odd(lines: Array, u: Array, v: Array, on_u: float, on_v: float) -> NDArray[np.bool_]:
    """Even-odd parity of each (u[i], v[j]) against segments (k, 4); points within on_u, on_v of a segment are inside.

    One sweep per column v[j]: the sorted crossings of the line v = v[j] give the parity of every u.
    """
    m, n, k = len(u), len(v), len(lines)
    result = np.zeros((m, n), dtype=np.bool_)
    cross = np.empty(k)
    for j in range(n):
        count = 0
        for s in range(k):
            a = lines[s, 1]
            b = lines[s, 3]
            if (a > v[j]) != (b > v[j]):
                cross[count] = lines[s, 0] + (v[j] - a) / (b - a) * (lines[s, 2] - lines[s, 0])
                count += 1
        hits = np.sort(cross[:count])
        for i in range(m):
            below = np.searchsorted(hits, u[i])
            result[i, j] = below % 2 == 1
            if not result[i, j]:
                for c in range(max(0, below - 1), min(count, below + 1)):
                    if abs(hits[c] - u[i]) <= on_u:
                        result[i, j] = True
        # horizontal pieces of the boundary make no crossing: a point on one of them is inside as well
        for s in range(k):
            if abs(lines[s, 1] - v[j]) <= on_v and abs(lines[s, 3] - v[j]) <= on_v:
                low = min(lines[s, 0], lines[s, 2]) - on_u
                high = max(lines[s, 0], lines[s, 2]) + on_u
                for i in range(m):
                    if low <= u[i] <= high:
                        result[i, j] = True
    return result
