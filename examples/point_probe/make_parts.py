"""Make dome.3dm (the part) and probe.csv (the path): a stylus touches a dome at fourteen places.

python make_parts.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cadsculpt.formats import patch_json, registry
from cadsculpt.spline.surface import BSplineSurface

PLACES = [(10.0 * i - 30.0, 12.0 * j - 6.0) for j in range(2) for i in range(7)]
"""(x, y) of the touches, mm."""

DEPTH, NEAR, DOWN, UP, OVER = 0.4, 1.0, 0.012, 0.008, 0.008
SAFE = 13.0
"""Height at which the stylus goes from place to place: above the whole dome, mm."""


def dome() -> BSplineSurface:
    """80 x 50 mm, crowned both ways, bicubic over 7 x 6 control points."""
    u = np.concatenate([np.zeros(3), np.linspace(0, 80, 5), np.full(3, 80.0)])
    v = np.concatenate([np.zeros(3), np.linspace(0, 50, 4), np.full(3, 50.0)])
    x = np.array([u[i + 1 : i + 4].mean() for i in range(7)]) - 40.0
    y = np.array([v[j + 1 : j + 4].mean() for j in range(6)]) - 25.0
    X, Y = np.meshgrid(x, y, indexing="ij")
    Z = 12.0 - 7.0 * (X / 40.0) ** 2 - 5.0 * (Y / 25.0) ** 2
    return BSplineSurface(np.stack([X, Y, Z], axis=-1), u, v, 3, 3, name="dome")


def height(surface: BSplineSurface, x: float, y: float) -> float:
    """z of the dome over (x, y): u and v run along x and y by the linear precision of B-splines."""
    return float(surface.evaluate(x + 40.0, y + 25.0)[2])


def rows(surface: BSplineSurface) -> list[tuple[float, float, float, float]]:
    """t, x, y, z: over each place, down into it, up again, over to the next."""
    t, path = 0.0, []
    for x, y in PLACES:
        z = height(surface, x, y)
        path += [(t, x, y, SAFE), (t + UP, x, y, z + NEAR), (t + UP + DOWN, x, y, z - DEPTH)]
        path.append((t + 2 * UP + DOWN, x, y, SAFE))
        t += 2 * UP + DOWN + OVER
    return path


if __name__ == "__main__":
    here = Path(__file__).parent
    part = here / "dome.json"
    patch_json.write_surfaces(part, [dome()], "mm")
    registry.write_part(registry.read(part), here / "dome.3dm", "3dm")
    part.unlink()
    lines = ["t,x,y,z"] + [",".join(f"{value:.6g}" for value in row) for row in rows(dome())]
    (here / "probe.csv").write_text("\n".join(lines) + "\n", newline="\n")
