"""Make pad.step: a block of foam whose upper face is slightly crowned.

python make_pad.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cadsculpt.formats import patch_json, registry
from cadsculpt.spline.surface import BSplineSurface

LENGTH, WIDTH, CROWN = 60.0, 44.0, 1.5


def clamped(count: int, length: float) -> np.ndarray:
    """Cubic and uniform, so that the parameters run in mm."""
    return np.concatenate([np.zeros(3), np.linspace(0.0, length, count - 2), np.full(3, length)])


def pad() -> BSplineSurface:
    """60 x 44 mm around the origin, its middle the highest, at z = 0."""
    u, v = clamped(8, LENGTH), clamped(7, WIDTH)
    X, Y = np.meshgrid(
        [u[i + 1 : i + 4].mean() - 0.5 * LENGTH for i in range(8)],
        [v[i + 1 : i + 4].mean() - 0.5 * WIDTH for i in range(7)],
        indexing="ij",
    )
    Z = -CROWN * ((2.0 * X / LENGTH) ** 2 + (2.0 * Y / WIDTH) ** 2)
    return BSplineSurface(np.stack([X, Y, Z], axis=-1), u, v, 3, 3, name="pad")


if __name__ == "__main__":
    here = Path(__file__).parent
    patch_json.write_surfaces(here / "pad.json", [pad()], "mm")
    registry.write_part(registry.read(here / "pad.json"), here / "pad.step", "step")
    (here / "pad.json").unlink()
