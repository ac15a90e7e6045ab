"""The superquadric as an exact signed distance: N(x) <= 1 with nested p-norms, p = 2/e (Barr 1981).

N = ((|x/a|^p2 + |y/b|^p2)^(p1/p2) + |z/c|^p1)^(1/p1). For exponents e up to 2 it is a norm and the solid convex. By its
symmetry the nearest point lies in the octant of x, so that all is done there. Outside, the projection is unique: with
y + lambda grad N(y) = x, one unknown is left, found between bounds. Inside, several points may be nearest: those of a
grid of the octant that are nearer than their neighbours are improved by Newton's method on the surface, which only ever
comes nearer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..collide.detect import FieldTool
from ..errors import InputError
from ..jit import njit
from ..motion.pose import Pose
from .implicit import PlacedField

Array = NDArray[np.float64]

SMALLEST, LARGEST = 0.1, 2.0
"""Exponents that are taken: below, an edge is sharper than 1/14 of the size; above, the solid is not convex."""

GRID = 20
"""The octant's grid has this many rows and columns of cells."""


@dataclass(frozen=True, slots=True, eq=False)
class SuperquadricTool:
    """radii (3,) along x, y, z. exponents (2,): e1 along z and e2 around it; 1 is round, near 0 square, 2 an octahedron.

    seeds (GRID + 1, GRID + 1, 3) : points of the surface in the first octant.
    """

    radii: Array
    exponents: Array
    seeds: Array

    @classmethod
    def of(cls, radii: tuple[float, float, float], exponents: tuple[float, float]) -> SuperquadricTool:
        """Raises InputError for sizes that are not positive and exponents outside 0.1 to 2."""
        a, e = np.array(radii, dtype=np.float64), np.array(exponents, dtype=np.float64)
        if not (np.isfinite(a).all() and (a > 0).all()):
            raise InputError(f"a superquadric of radii {list(radii)}", mend="every size of a tool is a positive number")
        if not ((e >= SMALLEST) & (e <= LARGEST)).all():
            raise InputError(
                f"superquadric exponents {list(exponents)}",
                mend=f"use {SMALLEST:g} to {LARGEST:g}: above it the solid is not convex",
            )
        around, up = _quarter(e[1]), _quarter(e[0])
        seeds = np.empty((GRID + 1, GRID + 1, 3))
        seeds[..., 0] = a[0] * up[:, None, 0] * around[None, :, 0]
        seeds[..., 1] = a[1] * up[:, None, 0] * around[None, :, 1]
        seeds[..., 2] = a[2] * up[:, None, 1]
        return cls(a, e, seeds)

    @property
    def convex(self) -> bool:
        """What lies beyond the tangent plane of one of its points is clear of it."""
        return True

    @property
    def box_corners(self) -> Array:
        """(2, 3): lower and upper corner in the tool's frame."""
        return np.array([-self.radii, self.radii])

    def field(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (n,) and unit outward normal (n, 3) at points (n, 3) in the tool's frame."""
        d, n = np.empty(len(points)), np.empty((len(points), 3))
        superquadric_field(self.radii, 2.0 / self.exponents, self.seeds, np.ascontiguousarray(points), d, n)
        return d, n

    def placed(self, pose: Pose) -> FieldTool:
        """The tool in the world, as the collision pipeline takes it."""
        return FieldTool(PlacedField(self, pose))


def _quarter(e: float) -> Array:
    """GRID + 1 points of the curve x^(2/e) + y^(2/e) = 1, from (1, 0) to (0, 1): evenly by length and turning of the
    normal together, so that neither a flat side nor a corner is left bare."""
    t = np.linspace(0.0, 1.0, 4001)
    fine = np.concatenate([0.5 * t**4, 1.0 - 0.5 * t[::-1][1:] ** 4])
    c, s = np.cos(0.5 * np.pi * fine), np.sin(0.5 * np.pi * fine)
    c[-1] = s[0] = 0.0
    curve = np.stack([c**e, s**e], axis=1)
    normal = np.arctan2(s ** (2.0 - e), c ** (2.0 - e))
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    turn = np.abs(np.diff(normal))
    along = np.concatenate([[0.0], np.cumsum(length / length.sum() + turn / max(turn.sum(), 1e-12))])
    even = np.linspace(0.0, along[-1], GRID + 1)
    points = np.stack([np.interp(even, along, curve[:, k]) for k in (0, 1)], axis=1)
    p = 2.0 / e  # back onto the curve: the interpolation runs along chords
    scale: Array = (points**p).sum(axis=1) ** (1.0 / p)
    return points / scale[:, None]


@njit
def superquadric_field(a: Array, p: Array, seeds: Array, x: Array, d: Array, n: Array) -> None:
    """Signed distance d (m,) and outward normal n (m, 3) at points x (m, 3). p = 2 / exponents."""
    y, g, h, q = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty(3)
    best = np.empty(3)
    size = max(a[0], a[1], a[2])
    for i in range(len(x)):
        for c in range(3):
            q[c] = abs(x[i, c])
        if np.isnan(q[0] + q[1] + q[2]):
            d[i] = np.nan
            n[i, 0], n[i, 1], n[i, 2] = np.nan, np.nan, np.nan
            continue
        outside = norm_of(a, p, q) > 1.0
        if outside:
            _project(a, p, q, best)
        else:
            _nearest_inside(a, p, seeds, q, best, y, g, h)
        gap = np.sqrt((q[0] - best[0]) ** 2 + (q[1] - best[1]) ** 2 + (q[2] - best[2]) ** 2)
        d[i] = gap if outside else -gap
        if gap > 1e-7 * size:
            for c in range(3):
                g[c] = (q[c] - best[c]) / d[i]
        else:
            norm_gradient(a, p, best, g)
        length = np.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
        for c in range(3):
            n[i, c] = g[c] / length if x[i, c] >= 0.0 else -g[c] / length


@njit
def norm_of(a: Array, p: Array, y: Array) -> float:
    """N(y) for y >= 0, scaled by its largest term so that no power overflows."""
    s0, s1, s2 = y[0] / a[0], y[1] / a[1], y[2] / a[2]
    top = max(s0, s1)
    rho = top * ((s0 / top) ** p[1] + (s1 / top) ** p[1]) ** (1.0 / p[1]) if top > 0.0 else 0.0
    top = max(rho, s2)
    return top * ((rho / top) ** p[0] + (s2 / top) ** p[0]) ** (1.0 / p[0]) if top > 0.0 else 0.0


@njit
def norm_gradient(a: Array, p: Array, y: Array, g: Array) -> None:
    """Gradient of N at y >= 0, y != 0."""
    s0, s1, s2 = y[0] / a[0], y[1] / a[1], y[2] / a[2]
    top = max(s0, s1)
    rho = top * ((s0 / top) ** p[1] + (s1 / top) ** p[1]) ** (1.0 / p[1]) if top > 0.0 else 0.0
    top = max(rho, s2)
    size = top * ((rho / top) ** p[0] + (s2 / top) ** p[0]) ** (1.0 / p[0])
    outer = (rho / size) ** (p[0] - 1.0)
    g[0] = outer * (s0 / rho) ** (p[1] - 1.0) / a[0] if rho > 0.0 else 0.0
    g[1] = outer * (s1 / rho) ** (p[1] - 1.0) / a[1] if rho > 0.0 else 0.0
    g[2] = (s2 / size) ** (p[0] - 1.0) / a[2]


@njit
def _term(x: float, k: float, p: float) -> float:
    """The root y in [0, x] of y + k y^(p - 1) = x, k >= 0: Newton from the right on a convex function, in y or, below
    p = 2, in m = y^(p - 1)."""
    if x <= 0.0 or k <= 0.0:
        return max(x, 0.0)
    if p == 1.0:
        return max(x - k, 0.0)
    if p >= 2.0:
        y = min(x, (x / k) ** (1.0 / (p - 1.0)))
        for _ in range(60):
            power = y ** (p - 2.0)
            step = (y + k * power * y - x) / (1.0 + k * (p - 1.0) * power)
            y -= step
            if not step > 1e-16 * y:
                break
        return max(y, 0.0)
    s = 1.0 / (p - 1.0)
    m = min(x ** (p - 1.0), x / k)
    for _ in range(60):
        power = m ** (s - 1.0)
        step = (power * m + k * m - x) / (s * power + k)
        m -= step
        if not step > 1e-16 * m:
            break
    return min(max(m, 0.0) ** s, x)


@njit
def _excess(a: Array, p: Array, x: Array, mu: float, y: Array) -> float:
    """y for the multiplier mu of its first two coordinates; returns N(y) - 1, which falls through 0 at the projection."""
    y[0] = a[0] * _term(x[0] / a[0], mu / (a[0] * a[0]), p[1])
    y[1] = a[1] * _term(x[1] / a[1], mu / (a[1] * a[1]), p[1])
    s0, s1 = y[0] / a[0], y[1] / a[1]
    top = max(s0, s1)
    rho = top * ((s0 / top) ** p[1] + (s1 / top) ** p[1]) ** (1.0 / p[1]) if top > 0.0 else 0.0
    if rho > 0.0:
        lam = mu * rho ** (p[1] - p[0])
    else:
        lam = mu if p[1] == p[0] else (0.0 if p[1] > p[0] else np.inf)
    y[2] = a[2] * _term(x[2] / a[2], lam / (a[2] * a[2]), p[0]) if lam < np.inf else 0.0
    return norm_of(a, p, y) - 1.0


@njit
def _project(a: Array, p: Array, x: Array, y: Array) -> None:
    """The projection y of a point x >= 0 outside: the root in t = log mu, by false position kept between bounds."""
    if x[0] == 0.0 and x[1] == 0.0:
        y[0], y[1], y[2] = 0.0, 0.0, a[2]
        return
    size = max(a[0], a[1], a[2])
    low = np.log(size * size * 1e-3)
    f_low = _excess(a, p, x, np.exp(low), y)
    high, f_high, step = low, f_low, 2.0
    while f_low < 0.0 and low > -600.0:
        high, f_high = low, f_low
        low -= step
        step *= 2.0
        f_low = _excess(a, p, x, np.exp(low), y)
    while f_high > 0.0 and high < 600.0:
        low, f_low = high, f_high
        high += step
        step *= 2.0
        f_high = _excess(a, p, x, np.exp(high), y)
    if f_high > 0.0:  # the apex of e1 = 2, where the multiplier has no end
        y[0], y[1], y[2] = 0.0, 0.0, a[2]
        return
    last = 0
    for k in range(200):
        if f_low <= 0.0 or f_high >= 0.0 or high - low <= 1e-15 * max(abs(low), abs(high)):
            break
        t = (low * f_high - high * f_low) / (f_high - f_low) if k % 4 != 3 else 0.5 * (low + high)
        if not low < t < high:
            t = 0.5 * (low + high)
            if not low < t < high:
                break
        f = _excess(a, p, x, np.exp(t), y)
        if abs(f) < 1e-16:
            low, f_low = t, 0.0
            break
        # Illinois: an end that stays twice counts for half
        if f > 0.0:
            low, f_low = t, f
            f_high = 0.5 * f_high if last > 0 else f_high
            last = 1
        else:
            high, f_high = t, f
            f_low = 0.5 * f_low if last < 0 else f_low
            last = -1
    _excess(a, p, x, np.exp(high if f_high == 0.0 else low), y)
    size = norm_of(a, p, y)
    for c in range(3):
        y[c] /= size


@njit
def _nearest_inside(a: Array, p: Array, seeds: Array, x: Array, best: Array, y: Array, g: Array, h: Array) -> None:
    """The point of the surface nearest to x >= 0 inside: the grid's local minima, each improved."""
    rows = len(seeds)
    grid = np.empty((rows, rows))
    least = np.inf
    for i in range(rows):
        for j in range(rows):
            grid[i, j] = (seeds[i, j, 0] - x[0]) ** 2 + (seeds[i, j, 1] - x[1]) ** 2 + (seeds[i, j, 2] - x[2]) ** 2
            least = min(least, grid[i, j])
    reach = (np.sqrt(least) + 0.2 * max(a[0], a[1], a[2])) ** 2
    found = np.inf
    for i in range(rows):
        for j in range(rows):
            if grid[i, j] > reach:
                continue
            lowest = True
            for k in range(max(i - 1, 0), min(i + 2, rows)):
                for m in range(max(j - 1, 0), min(j + 2, rows)):
                    lowest = lowest and grid[i, j] <= grid[k, m]
            if lowest:
                for c in range(3):
                    y[c] = seeds[i, j, c]
                d2 = _improve(a, p, x, y, g, h)
                if d2 < found:
                    found = d2
                    for c in range(3):
                        best[c] = y[c]
    # nearly flat sides: the points of the surface straight above x along the axes
    s0, s1, s2 = x[0] / a[0], x[1] / a[1], x[2] / a[2]
    rho = (max(1.0 - s2 ** p[0], 0.0)) ** (1.0 / p[0])
    for k in range(3):
        y[0], y[1], y[2] = x[0], x[1], x[2]
        if k == 2:
            y[2] = a[2] * max(1.0 - (s0 ** p[1] + s1 ** p[1]) ** (p[0] / p[1]), 0.0) ** (1.0 / p[0])
        elif k == 0:
            y[0] = a[0] * max(rho ** p[1] - s1 ** p[1], 0.0) ** (1.0 / p[1])
        else:
            y[1] = a[1] * max(rho ** p[1] - s0 ** p[1], 0.0) ** (1.0 / p[1])
        scale = norm_of(a, p, y)
        if scale <= 0.0:
            continue
        for c in range(3):
            y[c] /= scale
        d2 = _improve(a, p, x, y, g, h)
        if d2 < found:
            found = d2
            for c in range(3):
                best[c] = y[c]


@njit
def _improve(a: Array, p: Array, x: Array, y: Array, g: Array, h: Array) -> float:
    """Newton's method on the surface for |y - x|^2 from y, radially back onto it; every step comes nearer. Returns it."""
    t, u, trial = np.empty(3), np.empty(3), np.empty(3)
    size = max(a[0], a[1], a[2])
    # below p = 2 the surface is bent without end on the planes of symmetry, where nothing inside has its nearest point
    # and every step ends by symmetry
    for c in range(3):
        if (p[0] < 2.0 or (p[1] < 2.0 and c < 2)) and y[c] < 1e-3 * a[c]:
            y[c] = 1e-3 * a[c]
    scale = norm_of(a, p, y)
    for c in range(3):
        y[c] /= scale
    d2 = (x[0] - y[0]) ** 2 + (x[1] - y[1]) ** 2 + (x[2] - y[2]) ** 2
    for _ in range(60):
        norm_gradient(a, p, y, g)
        _norm_hessian(a, p, y, h)
        g2 = g[0] * g[0] + g[1] * g[1] + g[2] * g[2]
        lam = ((x[0] - y[0]) * g[0] + (x[1] - y[1]) * g[1] + (x[2] - y[2]) * g[2]) / g2
        _tangents(g, np.sqrt(g2), t, u)
        gt, gu, tt, tu, uu = 0.0, 0.0, 1.0, 0.0, 1.0
        for c in range(3):
            gt += t[c] * (x[c] - y[c])
            gu += u[c] * (x[c] - y[c])
            for k in range(3):
                tt += lam * t[c] * h[c, k] * t[k]
                tu += lam * t[c] * h[c, k] * u[k]
                uu += lam * u[c] * h[c, k] * u[k]
        det = tt * uu - tu * tu
        st, su = gt, gu
        if tt > 1e-3 and det > 1e-3 * tt:
            st, su = (uu * gt - tu * gu) / det, (tt * gu - tu * gt) / det
        if st * st + su * su < 1e-28 * size * size:
            break
        share, nearer = 1.0, False
        for _ in range(40):
            for c in range(3):
                trial[c] = abs(y[c] + share * (st * t[c] + su * u[c]))
            scale = norm_of(a, p, trial)
            e2 = 0.0
            for c in range(3):
                trial[c] /= scale
                e2 += (x[c] - trial[c]) ** 2
            if e2 < d2:
                nearer = True
                break
            share *= 0.5
        if not nearer:
            break
        d2 = e2
        for c in range(3):
            y[c] = trial[c]
    return d2


@njit
def _tangents(g: Array, length: float, t: Array, u: Array) -> None:
    """Unit vectors t, u square to g and to each other."""
    k = 0
    for c in range(1, 3):
        if abs(g[c]) < abs(g[k]):
            k = c
    along = g[k] / length
    for c in range(3):
        t[c] = (1.0 if c == k else 0.0) - along * g[c] / length
    size = np.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
    for c in range(3):
        t[c] /= size
    u[0] = (g[1] * t[2] - g[2] * t[1]) / length
    u[1] = (g[2] * t[0] - g[0] * t[2]) / length
    u[2] = (g[0] * t[1] - g[1] * t[0]) / length


@njit
def _norm_hessian(a: Array, p: Array, y: Array, h: Array) -> None:
    """Second derivatives (3, 3) of N at y >= 0 with N(y) = 1; coordinates next to 0 count as 1e-9, where powers end."""
    s0, s1, s2 = max(y[0] / a[0], 1e-9), max(y[1] / a[1], 1e-9), max(y[2] / a[2], 1e-9)
    top = max(s0, s1)
    rho = top * ((s0 / top) ** p[1] + (s1 / top) ** p[1]) ** (1.0 / p[1])
    r0, r1 = (s0 / rho) ** (p[1] - 1.0), (s1 / rho) ** (p[1] - 1.0)
    m_r, m_z = rho ** (p[0] - 1.0), s2 ** (p[0] - 1.0)
    m_rr = (p[0] - 1.0) * (rho ** (p[0] - 2.0) - m_r * m_r)
    m_rz = -(p[0] - 1.0) * m_r * m_z
    m_zz = (p[0] - 1.0) * (s2 ** (p[0] - 2.0) - m_z * m_z)
    q = p[1] - 1.0
    h[0, 0] = (m_rr * r0 * r0 + m_r * q * ((s0 / rho) ** (p[1] - 2.0) - r0 * r0) / rho) / (a[0] * a[0])
    h[1, 1] = (m_rr * r1 * r1 + m_r * q * ((s1 / rho) ** (p[1] - 2.0) - r1 * r1) / rho) / (a[1] * a[1])
    h[0, 1] = (m_rr - m_r * q / rho) * r0 * r1 / (a[0] * a[1])
    h[0, 2], h[1, 2] = m_rz * r0 / (a[0] * a[2]), m_rz * r1 / (a[1] * a[2])
    h[2, 2] = m_zz / (a[2] * a[2])
    h[1, 0], h[2, 0], h[2, 1] = h[0, 1], h[0, 2], h[1, 2]
