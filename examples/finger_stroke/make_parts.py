"""Make saddle.igs (the part) and finger.json (the tool): a doubly curved sheet and the pad of a finger.

python make_parts.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cadsculpt.formats import patch_json, registry
from cadsculpt.spline.surface import BSplineSurface


def knots(count: int, degree: int, length: float) -> np.ndarray:
    """Clamped and uniform, so that the parameters run in mm."""
    inner = np.linspace(0.0, length, count - degree + 1)
    return np.concatenate([np.full(degree, 0.0), inner, np.full(degree, length)])


def greville(t: np.ndarray, degree: int) -> np.ndarray:
    return np.array([t[i + 1 : i + degree + 1].mean() for i in range(len(t) - degree - 1)])


def saddle() -> BSplineSurface:
    """90 x 60 mm: hollow along x, crowned along y."""
    u, v = knots(9, 3, 90.0), knots(7, 3, 60.0)
    X, Y = np.meshgrid(greville(u, 3) - 45.0, greville(v, 3) - 30.0, indexing="ij")
    Z = 9.0 * (X / 45.0) ** 2 - 6.0 * (Y / 30.0) ** 2
    return BSplineSurface(np.stack([X, Y, Z], axis=-1), u, v, 3, 3, name="saddle")


def finger() -> BSplineSurface:
    """The underside of a finger along x, tip at +x, lowest point at the origin, 13 mm wide; normals point down and out."""
    along, around = knots(9, 3, 34.0), knots(9, 3, 1.0)
    s = greville(along, 3) / 34.0
    angle = np.radians(115.0) * (2.0 * greville(around, 3) - 1.0)
    radius = 6.5 * (1.0 - 0.45 * np.clip((s - 0.55) / 0.45, 0, 1) ** 2)
    lift = 7.0 * np.clip((s - 0.5) / 0.5, 0, 1) ** 2 + 1.5 * np.clip((0.5 - s) / 0.5, 0, 1) ** 2
    x = np.broadcast_to((34.0 * s - 17.0)[:, None], (9, 9))
    y = radius[:, None] * np.sin(angle)
    z = (6.5 + lift)[:, None] - radius[:, None] * np.cos(angle)
    net = np.stack([x, y, z], axis=-1)
    net[..., 2] -= net[..., 2].min()
    return BSplineSurface(net, along, around, 3, 3, name="pad", outward=False)


if __name__ == "__main__":
    here = Path(__file__).parent
    part = here / "saddle.json"
    patch_json.write_surfaces(part, [saddle()], "mm")
    registry.write_part(registry.read(part), here / "saddle.igs", "iges")
    part.unlink()
    patch_json.write_surfaces(here / "finger.json", [finger()], "mm")
