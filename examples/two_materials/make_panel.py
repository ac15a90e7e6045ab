"""Make panel.3dm: a crowned panel, the same on both sides of its middle.

python make_panel.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cadsculpt.formats import patch_json, registry
from cadsculpt.spline.surface import BSplineSurface

LENGTH, WIDTH = 100.0, 50.0
"""Sides of the panel, mm: u runs along the length from 0 to 100, v across from 0 to 50."""


def clamped(count: int, length: float) -> np.ndarray:
    """Cubic, uniform, so that the parameters run in mm."""
    return np.concatenate([np.zeros(3), np.linspace(0.0, length, count - 2), np.full(3, length)])


def panel() -> BSplineSurface:
    """100 x 50 mm, outward up, crowned along its length: 4 mm higher in the middle."""
    u, v = clamped(9, LENGTH), clamped(6, WIDTH)
    x = np.array([u[i + 1 : i + 4].mean() for i in range(9)]) - LENGTH / 2
    y = np.array([v[j + 1 : j + 4].mean() for j in range(6)]) - WIDTH / 2
    X, Y = np.meshgrid(x, y, indexing="ij")
    Z = 4.0 - 4.0 * (X / 50.0) ** 2
    return BSplineSurface(np.stack([X, Y, Z], axis=-1), u, v, 3, 3, name="panel")


if __name__ == "__main__":
    here = Path(__file__).parent
    part = here / "panel.json"
    patch_json.write_surfaces(part, [panel()], "mm")
    registry.write_part(registry.read(part), here / "panel.3dm", "3dm")
    part.unlink()
