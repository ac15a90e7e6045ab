"""Make finger.json and hand.json, the shipped tools of B-spline surfaces.

python make_tools.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cadsculpt.formats import patch_json
from cadsculpt.motion.pose import Pose
from cadsculpt.spline.surface import BSplineSurface

Array = NDArray[np.float64]

AROUND = 16
"""Control points around a finger, and twice as many around the palm."""

NAIL = 50.0
"""Degrees by which a finger's end pole is turned up from its axis: to where the nail is, away from what the finger touches."""


def clamped(count: int, degree: int) -> Array:
    """Uniform over [0, 1]."""
    return np.concatenate([np.zeros(degree), np.linspace(0.0, 1.0, count - degree + 1), np.ones(degree)])


def rings(name: str, points: Array) -> BSplineSurface:
    """A closed surface, u around and v along, from control points (rings, around, 3): bicubic, its first and last ring a
    pole."""
    along, around = points.shape[:2]
    net = np.concatenate([points, points[:, :3]], axis=1).transpose(1, 0, 2)  # periodic: the first three again
    u = np.arange(-3.0, around + 4.0) / around
    return BSplineSurface(net, u, clamped(along, 3), 3, 3, periodic_u=True, name=name)


def finger(name: str, length: float, width: float, height: float) -> BSplineSurface:
    """A finger along x: its tip, a half ellipsoid `width` across and `height` high, has its middle at the origin, its root is
    `length` behind. v runs from the root to the nail, u around. Rings are plane sections of it that turn towards the nail."""
    scale = np.array([0.5 * width, 0.5 * width, 0.5 * height])
    back = -2.0 * length / width
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND

    def ring(above: tuple[float, float], below: tuple[float, float]) -> Array:
        """The section of a capsule of radius 1 from (back, 0, 0) to the origin through two points (x, z) of its outline."""
        high, low = (np.array([x, 0.0, z]) for x, z in (above, below))
        start, up = 0.5 * (high + low), (high - low) / np.linalg.norm(high - low)
        way = np.cos(angle)[:, None] * [0.0, 1.0, 0.0] + np.sin(angle)[:, None] * up
        near, far = np.zeros(AROUND), np.full(AROUND, 2.0 - 2.0 * back)
        for _ in range(60):
            middle = 0.5 * (near + far)
            at = start + middle[:, None] * way
            axis = np.stack([np.clip(at[:, 0], back, 0.0), *np.zeros((2, AROUND))], axis=1)
            inside = np.linalg.norm(at - axis, axis=1) < 1.0
            near, far = np.where(inside, middle, near), np.where(inside, far, middle)
        return start + 0.5 * (near + far)[:, None] * way

    def tip(degrees: float) -> tuple[float, float]:
        return float(np.cos(np.radians(degrees))), float(np.sin(np.radians(degrees)))

    def pole(at: tuple[float, float], up: tuple[float, float], radius: float) -> Array:
        """A small ring in the plane that touches the pole, and the pole for radius 0."""
        circle = np.cos(angle)[:, None] * [0.0, 1.0, 0.0] + np.sin(angle)[:, None] * [up[0], 0.0, up[1]]
        return np.array([at[0], 0.0, at[1]]) + radius * circle

    root, nail, rise = (back - 1.0, 0.0), tip(NAIL), tip(NAIL + 90.0)
    found = [pole(root, (0.0, 1.0), radius) for radius in (0.0, 0.5)]
    found += [ring((back + x, np.sqrt(1.0 - x * x)), (back + x, -np.sqrt(1.0 - x * x))) for x in (-0.6, -0.1)]
    straight = [back + 0.75, *np.linspace(back + 1.5, -1.8, 4)]
    found += [ring((x, 1.0), (x, -1.0)) for x in straight]
    found += [
        ring((-1.35, 1.0), (-1.0, -1.0)),
        ring((-1.0, 1.0), (-0.35, -1.0)),
        ring((-0.7, 1.0), tip(-68.0)),
        ring((-0.4, 1.0), tip(-40.0)),
        ring((-0.1, 1.0), tip(-10.0)),
        ring(tip(80.0), tip(18.0)),
    ]
    found += [pole(nail, rise, radius) for radius in (0.3, 0.0)]
    return rings(name, np.array(found) * scale)


def palm(name: str, length: float, width: float, height: float) -> BSplineSurface:
    """A rounded slab along x, its middle at the origin."""
    angle = 2.0 * np.pi * np.arange(2 * AROUND) / (2 * AROUND)
    c, s = np.cos(angle), np.sin(angle)
    # a superellipse: flat above and below, round at the sides
    outline = np.stack([np.sign(c) * np.abs(c) ** 0.6, np.sign(s) * np.abs(s) ** 0.6], axis=1)
    found = []
    for x, grow in zip(
        (-1.0, -1.0, -0.98, -0.9, -0.72, -0.4, 0.0, 0.4, 0.72, 0.9, 0.98, 1.0, 1.0),
        (0.0, 0.3, 0.62, 0.86, 0.97, 1.0, 1.0, 1.0, 0.97, 0.86, 0.62, 0.3, 0.0),
        strict=True,
    ):
        ring = np.zeros((2 * AROUND, 3))
        ring[:, 0] = 0.5 * length * x
        ring[:, 1:] = grow * outline * [0.5 * width, 0.5 * height]
        found.append(ring)
    return rings(name, np.array(found))


def placed(surface: BSplineSurface, at: tuple[float, float, float], down: float, aside: float) -> BSplineSurface:
    """A finger whose root is at a place, its tip bent `down` and turned `aside`, degrees."""
    root = np.array([surface.control_points[:, 0, 0].min(), 0.0, 0.0])
    bent = Pose.turned(np.zeros(3), (0.0, 1.0, 0.0), down)
    turned = bent.then(Pose.turned(np.array(at), (0.0, 0.0, 1.0), aside))
    return surface.with_control_points(turned.to_world(surface.control_points - root))


def hand() -> list[BSplineSurface]:
    """A right hand, palm down, fingers along x: the middle of its palm lies on the origin, the thumb points to +y."""
    flat = palm("palm", 88.0, 82.0, 26.0)
    surfaces = [flat.with_control_points(flat.control_points + [0.0, 0.0, 13.0])]
    for name, size, y, aside in (
        ("index", (54.0, 16.0, 14.0), 29.0, 4.0),
        ("middle", (61.0, 16.5, 14.5), 9.5, 1.0),
        ("ring", (55.0, 15.5, 13.5), -10.0, -3.0),
        ("little", (41.0, 13.5, 12.0), -28.5, -8.0),
    ):
        surfaces.append(placed(finger(name, *size), (45.0, y, 15.0), 11.0, aside))
    surfaces.append(placed(finger("thumb", 44.0, 18.5, 16.0), (-6.0, 48.0, 12.0), 8.0, 40.0))
    return surfaces


if __name__ == "__main__":
    here = Path(__file__).parent
    patch_json.write_surfaces(here / "finger.json", [finger("finger", 40.0, 16.0, 14.0)], "mm")
    patch_json.write_surfaces(here / "hand.json", hand(), "mm")
