"""What is known of a displacement between the nodes that carry it.

Bilinear and bicubic interpolation (Hermite's, with the slopes of parabolas through three nodes) differ by about as much as
either may be wrong: the displacement is known to within that difference.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .net_fit import NetFit, NodeField, Span

Array = NDArray[np.float64]


def between_nodes(fit: NetFit, field: NodeField) -> float:
    """How far the surface leaves, in the middles between nodes, what is known of the displacement there.

    Known is the bicubic interpolation of the nodes (slopes of parabolas through three), and that to within its difference
    from the bilinear one; what the surface is away beyond that difference counts.
    """
    u, linear_u, cubic_u = _middles(field.u, fit.surface.domain[0], closed=field.closed[0])
    v, linear_v, cubic_v = _middles(field.v, fit.surface.domain[1], closed=field.closed[1])
    whole = linear_u @ field.counted.astype(np.float64) @ linear_v.T > 1.0 - 1e-9
    if not whole.any():
        return 0.0
    cubic = np.einsum("am,mnc,bn->abc", cubic_u, field.displacement, cubic_v, optimize=True)
    linear = np.einsum("am,mnc,bn->abc", linear_u, field.displacement, linear_v, optimize=True)
    away = np.linalg.norm(fit.at(u, v) - cubic, axis=2) - np.linalg.norm(cubic - linear, axis=2)
    return float(np.maximum(away[whole], 0.0).max(initial=0.0))


def denser(field: NodeField, domain: tuple[Span, Span], axes: Iterable[int] = (0, 1)) -> NodeField:
    """The field with a node more in the middle between any two along the axes, on the bicubic interpolation; these count for
    nothing."""
    moved, counted, grid = field.displacement, field.counted, [field.u, field.v]
    for axis in sorted(axes):
        places, _, cubic = _middles(grid[axis], domain[axis], closed=field.closed[axis])
        moved = np.moveaxis(np.tensordot(cubic, np.moveaxis(moved, axis, 0), axes=1), 0, axis)
        own = np.isin(places, grid[axis])
        spread = np.zeros((len(places), *np.moveaxis(counted, axis, 0).shape[1:]), dtype=np.bool_)
        spread[own] = np.moveaxis(counted, axis, 0)
        counted = np.moveaxis(spread, 0, axis)
        grid[axis] = places
    return replace(field, u=grid[0], v=grid[1], displacement=np.ascontiguousarray(moved), counted=counted)


def _middles(t: Array, domain: tuple[float, float], *, closed: bool) -> tuple[Array, Array, Array]:
    """Nodes and the middles between them, and the matrices that interpolate there: linear, and cubic."""
    period = domain[1] - domain[0] if closed else None
    ends = np.append(t, t[0] + period) if period is not None else t
    places = np.sort(np.concatenate([t, 0.5 * (ends[1:] + ends[:-1])]))
    return places, *interpolation(t, places, period)


def known_at(
    field: NodeField, domain: tuple[tuple[float, float], tuple[float, float]], uv: Array
) -> tuple[Array, Array]:
    """The displacement (n, 3) at uv (n, 2) by bicubic interpolation, and to within what it is known there (n,)."""
    parts = [
        interpolation(t, x, limits[1] - limits[0] if closed else None)
        for t, x, limits, closed in zip((field.u, field.v), uv.T, domain, field.closed, strict=True)
    ]
    linear, cubic = (
        np.einsum("am,mnc,an->ac", parts[0][k], field.displacement, parts[1][k], optimize=True) for k in (0, 1)
    )
    return cubic, np.linalg.norm(cubic - linear, axis=1)


def interpolation(t: Array, x: Array, period: float | None = None) -> tuple[Array, Array]:
    """Matrices (k, m) that take values at the nodes t (m,) to places x (k,): linear, and cubic. period : the nodes repeat."""
    count = len(t)
    fold = np.eye(count)
    far = t
    if period is not None:
        index = np.arange(-2, count + 3)
        far = t[index % count] + period * (index // count)
        fold = np.eye(count)[index % count]
    step = np.diff(far)
    slope = np.zeros((len(far), len(far)))
    for i in range(1, len(far) - 1):
        a, b = step[i - 1], step[i]
        slope[i, i - 1 : i + 2] = -b / (a * (a + b)), (b - a) / (a * b), a / (b * (a + b))
    slope[0, :2], slope[-1, -2:] = (-1.0 / step[0], 1.0 / step[0]), (-1.0 / step[-1], 1.0 / step[-1])
    if len(far) > 2:
        # the same parabola at its own end
        slope[0], slope[-1] = 2.0 * slope[0] - slope[1], 2.0 * slope[-1] - slope[-2]
    k = np.clip(np.searchsorted(far, x, side="right") - 1, 0, len(far) - 2)
    h = step[k][:, None]
    s = np.clip((x - far[k]) / step[k], 0.0, 1.0)[:, None]
    eye = np.eye(len(far))
    linear = (1.0 - s) * eye[k] + s * eye[k + 1]
    cubic = (1.0 - s) ** 2 * ((1.0 + 2.0 * s) * eye[k] + s * h * slope[k])
    cubic = cubic + s**2 * ((3.0 - 2.0 * s) * eye[k + 1] - (1.0 - s) * h * slope[k + 1])
    return linear @ fold, cubic @ fold
