"""Random B-spline surfaces of every kind, and their evaluation without the engine: scipy's de Boor on homogeneous
points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from cadsculpt.spline.surface import BSplineSurface

Array = NDArray[np.float64]

MOST_DEGREE = 11


@dataclass(frozen=True, slots=True)
class Direction:
    """One parameter direction: its degree, its knots, how many control points, and whether these repeat."""

    degree: int
    knots: Array
    count: int
    periodic: bool


def random_direction(rng: np.random.Generator, most_degree: int = MOST_DEGREE, most_spans: int = 6) -> Direction:
    """Clamped, unclamped or periodic; inner knots that crowd, repeat up to the degree, and lie in any range."""
    degree = int(rng.integers(1, most_degree + 1))
    kind = rng.choice(["clamped", "clamped", "unclamped", "periodic"])
    steps = rng.uniform(0.05, 1.0, int(rng.integers(1, most_spans + 1)))
    if rng.random() < 0.2:
        steps[rng.integers(0, len(steps))] *= 1e-3
    breaks = np.concatenate([[0.0], np.cumsum(steps)])
    inner = [np.repeat(b, rng.integers(1, degree + 1) if rng.random() < 0.3 else 1) for b in breaks[1:-1]]
    start, scale = rng.uniform(-5, 5), 10.0 ** rng.uniform(-2, 3)
    if kind == "periodic":
        # at least degree + 1 intervals a period, so that the unrolled rows are the first ones again; and three, for two
        # make a sheet that lies on itself
        lacking = max(degree + 1, 3) - sum(map(len, inner)) - 1
        if lacking > 0:
            inner.append(rng.uniform(breaks[0], breaks[-1], lacking))
        period = np.sort(np.concatenate([breaks[:1], *inner]))
        length, n = breaks[-1], len(period)
        index = np.arange(-degree, n + degree + 1)
        knots = period[index % n] + length * (index // n)
        return Direction(degree, start + scale * knots, n + degree, True)
    ends = [np.full(degree + 1, breaks[0]), np.full(degree + 1, breaks[-1])]
    if kind == "unclamped":
        ends[0] = np.sort(np.append(breaks[0] - rng.uniform(0.05, 1.0, degree), breaks[0]))
        ends[1] = np.sort(np.append(breaks[-1] + rng.uniform(0.05, 1.0, degree), breaks[-1]))
    knots = np.concatenate([ends[0], *inner, ends[1]])
    return Direction(degree, start + scale * knots, len(knots) - degree - 1, False)


def random_net(rng: np.random.Generator, u: Direction, v: Direction, bumps: float) -> Array:
    """A sheet of about ten by ten whose control points stray; a periodic direction goes around an axis."""
    own = [d.count - d.degree if d.periodic else d.count for d in (u, v)]
    a, b = np.meshgrid(np.linspace(0, 1, own[0]), np.linspace(0, 1, own[1]), indexing="ij")
    turn = [2 * np.pi * np.arange(n) / n for n in own]
    around_u, around_v = np.meshgrid(turn[0], turn[1], indexing="ij")
    if u.periodic and v.periodic:
        ring = 4.0 + 2.0 * np.cos(around_v)
        net = np.stack([ring * np.cos(around_u), ring * np.sin(around_u), 2.0 * np.sin(around_v)], axis=-1)
    elif u.periodic:
        net = np.stack([4.0 * np.cos(around_u), 4.0 * np.sin(around_u), 10.0 * b], axis=-1)
    elif v.periodic:
        net = np.stack([10.0 * a, 4.0 * np.cos(around_v), 4.0 * np.sin(around_v)], axis=-1)
    else:
        net = np.stack([10.0 * a, 10.0 * b, np.zeros_like(a)], axis=-1)
    net = net + rng.normal(scale=bumps * 10.0 / max(own), size=net.shape) * [0.4, 0.4, 1.0]
    return unrolled(net, u, v)


def unrolled(net: Array, u: Direction, v: Direction) -> Array:
    """The net with the first rows again at the end of a periodic direction."""
    if u.periodic:
        net = np.concatenate([net, net[: u.degree]], axis=0)
    if v.periodic:
        net = np.concatenate([net, net[:, : v.degree]], axis=1)
    return np.ascontiguousarray(net)


def random_surface(
    rng: np.random.Generator, *, most_degree: int = MOST_DEGREE, most_spans: int = 6, bumps: float = 0.6
) -> BSplineSurface:
    """Any degrees, knots and weights, open or closed either way."""
    u, v = (random_direction(rng, most_degree, most_spans) for _ in range(2))
    net = random_net(rng, u, v, bumps)
    weights = None
    if rng.random() < 0.5:
        own = u.count - u.degree * u.periodic, v.count - v.degree * v.periodic
        weights = unrolled(rng.uniform(0.3, 3.0, own), u, v)
    return BSplineSurface(
        net, u.knots, v.knots, u.degree, v.degree, weights, u.periodic, v.periodic, bool(rng.random() < 0.5)
    )


def deformed(rng: np.random.Generator, surface: BSplineSurface, size: float = 1.0) -> Array:
    """The surface's net with some control points moved; the repeated rows of a periodic direction move alike."""
    shift = rng.normal(scale=size, size=surface.control_points.shape) * (rng.random((*surface.shape, 1)) < 0.4)
    if surface.periodic_u:
        shift[-surface.degree_u :] = shift[: surface.degree_u]
    if surface.periodic_v:
        shift[:, -surface.degree_v :] = shift[:, : surface.degree_v]
    return np.ascontiguousarray(surface.control_points + shift)


def homogeneous(surface: BSplineSurface, net: Array) -> Array:
    """(r, s, 4): w x, w y, w z, w."""
    w = np.ones(surface.shape) if surface.weights is None else surface.weights
    return np.concatenate([net * w[..., None], w[..., None]], axis=2)


def basis(knots: Array, degree: int, t: Array) -> Array:
    """All basis functions at t (m,): (m, count)."""
    return np.asarray(BSpline.design_matrix(t, knots, degree).toarray())


def points_on(surface: BSplineSurface, net: Array, u: Array, v: Array) -> Array:
    """S(u[i], v[j]) over the net: (len(u), len(v), 3)."""
    a, b = basis(surface.knots_u, surface.degree_u, u), basis(surface.knots_v, surface.degree_v, v)
    h = np.tensordot(a, homogeneous(surface, net), axes=(1, 0))
    h = np.matmul(b, h)
    return h[..., :3] / h[..., 3:]


def points_at(surface: BSplineSurface, net: Array, u: Array, v: Array) -> Array:
    """S(u[i], v[i]) over the net: (n, 3)."""
    a, b = basis(surface.knots_u, surface.degree_u, u), basis(surface.knots_v, surface.degree_v, v)
    h = np.einsum("ir,rsc,is->ic", a, homogeneous(surface, net), b, optimize=True)
    return np.asarray(h[:, :3] / h[:, 3:])


def points_in_cells(surface: BSplineSurface, net: Array, u: Array, v: Array) -> Array:
    """S(u[n, i], v[n, j]) over the net, cell by cell: (n, k, k, 3)."""
    cells, k = u.shape
    a = basis(surface.knots_u, surface.degree_u, u.ravel()).reshape(cells, k, -1)
    b = basis(surface.knots_v, surface.degree_v, v.ravel()).reshape(cells, k, -1)
    net4 = homogeneous(surface, net)
    h = np.tensordot(a, net4, axes=(2, 0))  # cells, k, s, 4
    h = np.einsum("nisc,njs->nijc", h, b, optimize=True)
    return np.asarray(h[..., :3] / h[..., 3:])
