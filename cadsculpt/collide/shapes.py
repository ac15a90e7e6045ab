"""The shapes whose signed distance is a formula (paper section 4.9.1), as kernels know them.

Each stands in its own frame: centred at the origin with its axis along z, except the cone (apex at the origin, opening
upwards) and the half-space (everything above z = 0). Distances are negative inside, exact and therefore 1-Lipschitz; n is
the unit outward normal of the shape at the point nearest to x, and that point is x - d n.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..jit import njit_in_place

Array = NDArray[np.float64]

SPHERE, ELLIPSOID, CAPSULE, CYLINDER, CONE, BOX, TORUS, HALF_SPACE = range(8)


@dataclass(frozen=True, slots=True, eq=False)
class PosedShape:
    """A shape where it stands: its kind and sizes, its box (2, 3) in its own frame (may be infinite), and the frame:
    x_world = rotation @ x + at."""

    kind: int
    parameters: Array
    rounding: float
    corners: Array
    at: Array
    rotation: Array


@njit_in_place
def world_box(corners: Array, at: Array, rotation: Array, out: Array) -> bool:
    """The box (2, 3) in the world of a box in a frame, infinite where that is; whether it is a number."""
    finite, known = True, True
    for c in range(3):
        finite = finite and np.isfinite(corners[0, c]) and np.isfinite(corners[1, c])
    for i in range(3):
        if not finite:
            out[0, i], out[1, i] = -np.inf, np.inf
            known = known and not np.isnan(at[i])
            continue
        middle, half = at[i], 0.0
        for c in range(3):
            middle += rotation[i, c] * 0.5 * (corners[0, c] + corners[1, c])
            half += abs(rotation[i, c]) * 0.5 * (corners[1, c] - corners[0, c])
        out[0, i], out[1, i] = middle - half, middle + half
        known = known and not np.isnan(middle) and not np.isnan(half)
    return known


@njit_in_place
def into_frame(points: Array, at: Array, rotation: Array) -> None:
    """Points (r, s, 3) of the world, in place, into the frame x_world = rotation @ x + at."""
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            x, y, z = points[i, j, 0] - at[0], points[i, j, 1] - at[1], points[i, j, 2] - at[2]
            for c in range(3):
                points[i, j, c] = x * rotation[0, c] + y * rotation[1, c] + z * rotation[2, c]


@njit_in_place
def world_field(
    kind: int, parameters: Array, rounding: float, at: Array, rotation: Array, x: Array, d: Array, n: Array
) -> None:
    """Signed distance d (m,) and outward normal n (m, 3) of a posed shape at points x (m, 3) of the world, which are left
    in the shape's frame."""
    for t in range(len(x)):
        px, py, pz = x[t, 0] - at[0], x[t, 1] - at[1], x[t, 2] - at[2]
        for c in range(3):
            x[t, c] = px * rotation[0, c] + py * rotation[1, c] + pz * rotation[2, c]
    shape_field(kind, parameters, rounding, x, d, n)
    for t in range(len(x)):
        px, py, pz = n[t, 0], n[t, 1], n[t, 2]
        for c in range(3):
            n[t, c] = rotation[c, 0] * px + rotation[c, 1] * py + rotation[c, 2] * pz


@njit_in_place
def shape_field(kind: int, p: Array, rounding: float, x: Array, d: Array, n: Array) -> None:
    """Signed distance d (m,) and outward normal n (m, 3) of a shape at points x (m, 3)."""
    for i in range(len(x)):
        px, py, pz = x[i, 0], x[i, 1], x[i, 2]
        if kind == SPHERE:
            length = np.sqrt(px * px + py * py + pz * pz)
            d[i] = length - p[0]
            _unit(px, py, pz, length, n[i])
        elif kind == CAPSULE:
            half = 0.5 * p[1]
            qz = pz - min(max(pz, -half), half)
            length = np.sqrt(px * px + py * py + qz * qz)
            d[i] = length - p[0]
            if length > 0.0:
                _unit(px, py, qz, length, n[i])
            else:
                n[i, 0], n[i, 1], n[i, 2] = 1.0, 0.0, 0.0
        elif kind == HALF_SPACE:
            d[i] = -pz
            n[i, 0], n[i, 1], n[i, 2] = 0.0, 0.0, -1.0
        elif kind == TORUS:
            r = np.sqrt(px * px + py * py)
            a = r - p[0]
            length = np.sqrt(a * a + pz * pz)
            d[i] = length - p[1]
            ca, sa = (a / length, pz / length) if length > 0.0 else (1.0, 0.0)
            cx, cy = (px / r, py / r) if r > 0.0 else (1.0, 0.0)
            n[i, 0], n[i, 1], n[i, 2] = ca * cx, ca * cy, sa
        elif kind == CYLINDER:
            r = np.sqrt(px * px + py * py)
            cx, cy = (px / r, py / r) if r > 0.0 else (1.0, 0.0)
            d[i], nr, nz = _rectangle(r, abs(pz), p[0] - rounding, 0.5 * p[1] - rounding)
            d[i] -= rounding
            n[i, 0], n[i, 1], n[i, 2] = nr * cx, nr * cy, nz * _sign(pz)
        elif kind == CONE:
            r = np.sqrt(px * px + py * py)
            cx, cy = (px / r, py / r) if r > 0.0 else (1.0, 0.0)
            d[i], nr, nz = _cone(r, pz, p[0], p[1])
            n[i, 0], n[i, 1], n[i, 2] = nr * cx, nr * cy, nz
        elif kind == BOX:
            _box(px, py, pz, p, rounding, i, d, n)
        else:
            _ellipsoid(px, py, pz, p, i, d, n)


@njit_in_place
def _unit(x: float, y: float, z: float, length: float, out: Array) -> None:
    if length > 0.0:
        out[0], out[1], out[2] = x / length, y / length, z / length
    else:
        out[0], out[1], out[2] = 0.0, 0.0, -1.0


@njit_in_place
def _sign(x: float) -> float:
    return 1.0 if x >= 0.0 else -1.0


@njit_in_place
def _rectangle(r: float, z: float, a: float, b: float) -> tuple[float, float, float]:
    """Distance and normal of the quarter rectangle [0, a] x [0, b] at r, z >= 0."""
    qr, qz = r - a, z - b
    if qr > 0.0 and qz > 0.0:
        length = np.sqrt(qr * qr + qz * qz)
        return length, qr / length, qz / length
    if qr > qz:
        return qr, 1.0, 0.0
    return qz, 0.0, 1.0


@njit_in_place
def _cone(r: float, z: float, radius: float, height: float) -> tuple[float, float, float]:
    """Distance and normal of the triangle (0, 0), (radius, height), (0, height) in the half plane r >= 0."""
    slant2 = radius * radius + height * height
    slant = np.sqrt(slant2)
    nr, nz = height / slant, -radius / slant  # outward normal of the side
    t = min(max((r * radius + z * height) / slant2, 0.0), 1.0)
    sr, sz = r - t * radius, z - t * height
    side = np.sqrt(sr * sr + sz * sz)
    cap_r = r - min(r, radius)
    cap_z = z - height
    cap = np.sqrt(cap_r * cap_r + cap_z * cap_z)
    inside = r * nr + z * nz <= 0.0 and z <= height
    if inside:
        if side <= cap:
            return -side, nr, nz
        return -cap, 0.0, 1.0
    if side <= cap:
        if t > 0.0 and t < 1.0:
            return side, nr, nz
        return side, sr / side, sz / side
    return cap, cap_r / cap, cap_z / cap


@njit_in_place
def _box(px: float, py: float, pz: float, size: Array, rounding: float, i: int, d: Array, n: Array) -> None:
    q0 = abs(px) - (0.5 * size[0] - rounding)
    q1 = abs(py) - (0.5 * size[1] - rounding)
    q2 = abs(pz) - (0.5 * size[2] - rounding)
    o0, o1, o2 = max(q0, 0.0), max(q1, 0.0), max(q2, 0.0)
    outside = np.sqrt(o0 * o0 + o1 * o1 + o2 * o2)
    if outside > 0.0:
        d[i] = outside - rounding
        n[i, 0] = o0 / outside * _sign(px)
        n[i, 1] = o1 / outside * _sign(py)
        n[i, 2] = o2 / outside * _sign(pz)
        return
    n[i, 0], n[i, 1], n[i, 2] = 0.0, 0.0, 0.0
    if q0 >= q1 and q0 >= q2:
        d[i] = q0 - rounding
        n[i, 0] = _sign(px)
    elif q1 >= q2:
        d[i] = q1 - rounding
        n[i, 1] = _sign(py)
    else:
        d[i] = q2 - rounding
        n[i, 2] = _sign(pz)


@njit_in_place
def _ellipsoid(px: float, py: float, pz: float, e: Array, i: int, d: Array, n: Array) -> None:
    """Eberly, "Distance from a point to an ellipsoid": the one root of g(t) = sum (e y / (t + e^2))^2 - 1 right of -min e^2.

    g is convex and falling there, so Newton from the left end never overshoots. The unknown is s = t + min e^2, so that
    nothing cancels for points near the plane of the shortest axis.
    """
    smallest = min(e[0], e[1], e[2])
    # a point on a plane of symmetry is nudged off it, by less than rounding, so that the root is always the nearest point
    tiny = 1e-15 * max(e[0], e[1], e[2])
    y0, y1, y2 = max(abs(px), tiny), max(abs(py), tiny), max(abs(pz), tiny)
    c0 = (e[0] - smallest) * (e[0] + smallest)
    c1 = (e[1] - smallest) * (e[1] + smallest)
    c2 = (e[2] - smallest) * (e[2] + smallest)
    s = max(e[0] * y0 - c0, e[1] * y1 - c1, e[2] * y2 - c2)
    for _ in range(100):
        a0, a1, a2 = s + c0, s + c1, s + c2
        r0, r1, r2 = e[0] * y0 / a0, e[1] * y1 / a1, e[2] * y2 / a2
        g = r0 * r0 + r1 * r1 + r2 * r2 - 1.0
        slope = -2.0 * (r0 * r0 / a0 + r1 * r1 / a1 + r2 * r2 / a2)
        step = g / slope
        if not g > 0.0 or s - step == s:
            break
        s -= step
    x0 = e[0] * e[0] * y0 / (s + c0)
    x1 = e[1] * e[1] * y1 / (s + c1)
    x2 = e[2] * e[2] * y2 / (s + c2)
    g0, g1, g2 = x0 / (e[0] * e[0]), x1 / (e[1] * e[1]), x2 / (e[2] * e[2])
    length = np.sqrt(g0 * g0 + g1 * g1 + g2 * g2)
    g0, g1, g2 = g0 / length, g1 / length, g2 / length
    d[i] = (y0 - x0) * g0 + (y1 - x1) * g1 + (y2 - x2) * g2
    n[i, 0], n[i, 1], n[i, 2] = g0 * _sign(px), g1 * _sign(py), g2 * _sign(pz)
