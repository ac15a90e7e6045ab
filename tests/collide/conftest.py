"""Surfaces for the collision tests."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cadsculpt.spline.surface import BSplineSurface


def _clamped(degree, count, low=0.0, high=1.0, inner=None):
    if inner is None:
        inner = np.linspace(low, high, count - degree + 1)[1:-1]
    return np.concatenate([np.full(degree + 1, low), inner, np.full(degree + 1, high)])


def random_surface(rng, *, rational=False, size=10.0, bumps=0.6, most=5):
    """A bumpy sheet of random degrees and knots, about size x size, in the plane z = 0 before the bumps."""
    p, q = (int(x) for x in rng.integers(1, 6, 2))
    r, s = p + 1 + int(rng.integers(0, most)), q + 1 + int(rng.integers(0, most))
    u = _clamped(p, r, -1.0, 4.0, np.sort(rng.uniform(-0.8, 3.8, r - p - 1)))
    v = _clamped(q, s, 0.0, 0.5, np.sort(rng.uniform(0.02, 0.48, s - q - 1)))
    x, y = np.meshgrid(np.linspace(0, size, r), np.linspace(0, size, s), indexing="ij")
    net = np.stack([x, y, np.zeros((r, s))], axis=-1)
    net += rng.normal(scale=bumps * size / max(r, s), size=net.shape) * [0.3, 0.3, 1.0]
    return BSplineSurface(net, u, v, p, q, rng.uniform(0.3, 3.0, (r, s)) if rational else None)


def plate(size=10.0, count=6, degree=3, height=None, z=0.0):
    """A sheet over [0, size]^2; `height` (x, y) -> z moves its control points."""
    # control points at the Greville abscissae, so that x and y are linear in u and v
    knots = _clamped(degree, count)
    at = size * np.array([knots[i + 1 : i + degree + 1].mean() for i in range(count)])
    x, y = np.meshgrid(at, at, indexing="ij")
    return BSplineSurface(
        np.stack([x, y, np.full_like(x, z) if height is None else height(x, y) + z], axis=-1),
        knots,
        knots,
        degree,
        degree,
    )


def cylinder(radius=5.0, height=10.0, closed_clamped=True):
    """A whole cylinder about z, outward normal away from the axis: nine rational points around, or periodic cubic."""
    if closed_clamped:
        c = np.sqrt(0.5)
        around = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]]) * radius
        w = np.array([1, c, 1, c, 1, c, 1, c, 1])
        knots_u = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4]) * 0.25
        degree, periodic = 2, False
    else:
        # 12 control points around, unrolled by the degree; the curve is nearly a circle
        angle = 2 * np.pi * np.arange(15) / 12
        around = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * radius
        w, knots_u, degree, periodic = None, np.arange(19, dtype=float), 3, True
    z = np.linspace(0, height, 4)
    net = np.concatenate(
        [np.repeat(around[:, None], 4, axis=1), np.tile(z[None, :, None], (len(around), 1, 1))], axis=2
    )
    weights = None if w is None else np.repeat(w[:, None], 4, axis=1)
    return BSplineSurface(net, knots_u, _clamped(3, 4), degree, 3, weights, periodic_u=periodic)


def ball(radius=5.0, centre=(0.0, 0.0, 0.0)):
    """A whole sphere, exactly: rational, closed in u, poles at both ends of v."""
    c = np.sqrt(0.5)
    around = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]], dtype=float)
    wa = np.array([1, c, 1, c, 1, c, 1, c, 1])
    up = np.array([[0, -1], [1, -1], [1, 0], [1, 1], [0, 1]], dtype=float)
    wu = np.array([1, c, 1, c, 1])
    net = np.empty((9, 5, 3))
    net[..., :2] = around[:, None] * up[None, :, :1]
    net[..., 2] = up[None, :, 1]
    knots_u = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4.0])
    knots_v = np.array([0, 0, 0, 1, 1, 2, 2, 2.0])
    return BSplineSurface(radius * net + np.array(centre), knots_u, knots_v, 2, 2, wa[:, None] * wu[None, :])


def box(size=4.0, centre=(0.0, 0.0, 0.0)):
    """The six faces of a cube, each a bilinear patch with its normal outwards."""
    half, faces = 0.5 * size, []
    for axis in range(3):
        for side in (-1.0, 1.0):
            u, v = np.zeros(3), np.zeros(3)
            u[(axis + 1) % 3], v[(axis + 2) % 3] = half, half
            if side < 0:
                u, v = v, u
            n = np.zeros(3)
            n[axis] = side * half
            net = np.array([[n - u - v, n - u + v], [n + u - v, n + u + v]]) + np.array(centre)
            k = np.array([0.0, 0, 1, 1])
            faces.append(BSplineSurface(net, k, k, 1, 1))
    return faces


class Sphere:
    """An exact ball as a distance field."""

    def __init__(self, centre, radius):
        self.centre, self.radius = np.asarray(centre, dtype=float), radius

    def distance(self, points):
        return np.linalg.norm(points - self.centre, axis=1) - self.radius

    def gradient(self, points):
        arm = points - self.centre
        return arm / np.linalg.norm(arm, axis=1, keepdims=True)

    def nearest(self, points):
        return self.centre + self.radius * self.gradient(points)

    def box(self):
        return np.array([self.centre - self.radius, self.centre + self.radius])


@pytest.fixture(scope="session")
def shapes():
    """random_surface, plate, cylinder, ball, box (B-splines) and Sphere (a distance field)."""
    return SimpleNamespace(
        random_surface=random_surface, plate=plate, cylinder=cylinder, ball=ball, box=box, Sphere=Sphere
    )
