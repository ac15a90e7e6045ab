"""Make pad.step: the top of a foam pad, one flat B-spline face.

python make_pad.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cadsculpt.formats import patch_json, registry
from cadsculpt.spline.surface import BSplineSurface

SIZE = 50.0
"""Sides of the pad, mm."""


def pad() -> BSplineSurface:
    """50 x 50 mm in the plane z = 0, outward up, bicubic over 6 x 6 control points."""
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, SIZE, 4), np.full(3, SIZE)])
    x = np.array([knots[i + 1 : i + 4].mean() for i in range(6)]) - SIZE / 2
    X, Y = np.meshgrid(x, x, indexing="ij")
    return BSplineSurface(np.stack([X, Y, np.zeros_like(X)], axis=-1), knots, knots, 3, 3, name="pad")


if __name__ == "__main__":
    here = Path(__file__).parent
    part = here / "pad.json"
    patch_json.write_surfaces(part, [pad()], "mm")
    registry.write_part(registry.read(part), here / "pad.step", "step")
    part.unlink()
