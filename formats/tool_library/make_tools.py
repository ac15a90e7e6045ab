"""Make finger.json and hand.json, the shipped tools of B-spline surfaces.

python make_tools.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from cadsculpt.formats import patch_json
from cadsculpt.motion.pose import Pose
from cadsculpt.spline.surface import BSplineSurface

Array = NDArray[np.float64]

NAIL = 0.0
"""How far behind the tip's middle a finger's end pole is, in half widths: where its nail is, away from what it touches."""

TURNING = (
    (-1.8, -1.8),
    (-1.5, -1.1),
    (-1.27, -0.4),
    (-1.07, 0.3),
    (-0.88, 0.95),
    (-0.7, 1.55),
    (-0.5, 2.15),
    (-0.3, 2.65),
)
"""Where the rings of a finger cut its outline, above and below, as they turn towards the nail: lengths along it from where the
tip begins, in half widths."""


def clamped(count: int, degree: int) -> Array:
    """Uniform over [0, 1]."""
    return np.concatenate([np.zeros(degree), np.linspace(0.0, 1.0, count - degree + 1), np.ones(degree)])


def greville(knots: Array, count: int) -> Array:
    return np.array([knots[i + 1 : i + 4].mean() for i in range(count)])


def rings(name: str, points: Array) -> BSplineSurface:
    """A closed surface, u around and v along, from control points (rings, around, 3): bicubic, its first and last ring a
    pole."""
    along, around = points.shape[:2]
    net = np.concatenate([points, points[:, :3]], axis=1).transpose(1, 0, 2)  # periodic: the first three again
    u = np.arange(-3.0, around + 4.0) / around
    return BSplineSurface(net, u, clamped(along, 3), 3, 3, periodic_u=True, name=name)


def finger(name: str, length: float, width: float, height: float, span: float) -> BSplineSurface:
    """A finger along x: its tip, a half ellipsoid `width` across and `height` high, has its middle at the origin, its root is
    `length` behind. v runs from the root to the nail, u around, knots about `span` apart. Rings are plane sections of it."""
    scale = np.array([0.5 * width, 0.5 * width, 0.5 * height])
    back, quarter = -2.0 * length / width, 0.5 * np.pi
    angle = circle(round(np.pi * (width + height) / 2.0 / span))

    def outline(q: float, side: float) -> Array:
        """A capsule of radius 1 from (back, 0, 0) to the origin at y = 0, at the length q from its root, above or below."""
        if q < quarter:
            return np.array([back - np.cos(q), 0.0, side * np.sin(q)])
        q -= quarter - back
        if q < 0.0:
            return np.array([q, 0.0, side])
        round_tip = min(q, np.pi)
        return np.array([np.sin(round_tip) - (q - round_tip), 0.0, side * np.cos(round_tip)])

    def section(high: Array, low: Array) -> Array:
        start, up = 0.5 * (high + low), (high - low) / np.linalg.norm(high - low)
        way = np.cos(angle)[:, None] * [0.0, 1.0, 0.0] + np.sin(angle)[:, None] * up
        near, far = np.zeros(len(angle)), np.full(len(angle), 2.0 - 2.0 * back)
        for _ in range(60):
            middle = 0.5 * (near + far)
            at = start + middle[:, None] * way
            axis = np.stack([np.clip(at[:, 0], back, 0.0), *np.zeros((2, len(at)))], axis=1)
            inside = np.linalg.norm(at - axis, axis=1) < 1.0
            near, far = np.where(inside, middle, near), np.where(inside, far, middle)
        return start + 0.5 * (near + far)[:, None] * way

    tip = quarter - back
    table = np.array([(-tip, -tip), (back, back), *TURNING, (-NAIL, np.pi + NAIL)]) + tip
    way = np.concatenate([[0.0], np.cumsum(np.diff(table, axis=0).mean(axis=1))])
    count = round(way[-1] * 0.5 * width / span) + 3
    share = way[-1] * greville(clamped(count, 3), count)
    above, below = PchipInterpolator(way, table)(share).T
    found = [section(outline(q, 1.0), outline(p, -1.0)) for q, p in zip(above[1:-1], below[1:-1], strict=True)]
    nail, rise = outline(above[-1], 1.0), np.array([-1.0, 0.0, 0.0])
    # beside a pole the ring lies in the plane that touches it
    for place, pole, up, step in (
        (0, outline(0.0, 1.0), np.array([0.0, 0.0, 1.0]), share[1]),
        (-1, nail, rise, share[1]),
    ):
        found[place] = pole + step * (np.cos(angle)[:, None] * [0.0, 1.0, 0.0] + np.sin(angle)[:, None] * up)
        found.insert(0 if place == 0 else len(found), np.broadcast_to(pole, found[place].shape))
    return rings(name, np.array(found) * scale)


def circle(count: int) -> Array:
    return 2.0 * np.pi * np.arange(count) / count


def palm(name: str, length: float, width: float, height: float, span: float) -> BSplineSurface:
    """A rounded slab along x, its middle at the origin: flat above and below, round at the sides. Knots about `span` apart."""

    def corner(angle: Array) -> Array:
        """A superellipse."""
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([np.sign(c) * np.abs(c) ** 0.5, np.sign(s) * np.abs(s) ** 0.5], axis=-1)

    def even(points: Array, parts: int) -> Array:
        """Points on a polyline at equal lengths."""
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        return np.stack([np.interp(np.linspace(0.0, way[-1], parts), way, c) for c in points.T], axis=1)

    half = 0.5 * np.array([length, width, height])
    closed = corner(np.linspace(0.0, 2.0 * np.pi, 2001)) * half[1:]
    outline = even(closed, round((2.0 * width + 2.0 * height) / span) + 1)[:-1]
    profile = even(corner(np.linspace(-np.pi, 0.0, 2001)) * half[[0, 1]], round((length + width) / span) + 1)
    found = []
    for n, (x, y) in enumerate(profile):
        # the height of a section falls less than its width does
        shrink = np.array([y / half[1], -(np.abs(y / half[1]) ** 0.6)])
        ring = np.zeros((len(outline), 3))
        ring[:, 0], ring[:, 1:] = x, -outline * shrink if 0 < n < len(profile) - 1 else 0.0
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
    flat = palm("palm", 88.0, 82.0, 26.0, 4.0)
    surfaces = [flat.with_control_points(flat.control_points + [0.0, 0.0, 13.0])]
    for name, size, y, aside in (
        ("index", (54.0, 16.0, 14.0), 29.0, 4.0),
        ("middle", (61.0, 16.5, 14.5), 9.5, 1.0),
        ("ring", (55.0, 15.5, 13.5), -10.0, -3.0),
        ("little", (41.0, 13.5, 12.0), -28.5, -8.0),
    ):
        surfaces.append(placed(finger(name, *size, 3.2), (45.0, y, 15.0), 11.0, aside))
    surfaces.append(placed(finger("thumb", 44.0, 18.5, 16.0, 3.2), (-6.0, 48.0, 12.0), 8.0, 40.0))
    return surfaces


if __name__ == "__main__":
    here = Path(__file__).parent
    patch_json.write_surfaces(here / "finger.json", [finger("finger", 40.0, 16.0, 14.0, 2.4)], "mm")
    patch_json.write_surfaces(here / "hand.json", hand(), "mm")
