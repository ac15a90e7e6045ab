"""Make sheet.step (the part) and spiral.csv (the path): a small ball runs down a spiral and forms a cup into flat sheet.

python make_parts.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cadsculpt.formats import patch_json, registry
from cadsculpt.spline.surface import BSplineSurface

SIZE, BALL = 48.0, 6.0
"""Sides of the sheet and radius of the ball, mm."""

OUTER, INNER, DEPTH, TURNS = 11.0, 7.0, 2.0, 1.25
"""The spiral goes inwards from radius OUTER to INNER and down to DEPTH, mm, in so many turns."""

FEED, ROWS = 40.0, 61
"""mm/s along the spiral, and its rows."""


def sheet() -> BSplineSurface:
    """48 x 48 mm in the plane z = 0, outward up, bicubic over 8 x 8 control points."""
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, SIZE, 6), np.full(3, SIZE)])
    x = np.array([knots[i + 1 : i + 4].mean() for i in range(8)]) - SIZE / 2
    X, Y = np.meshgrid(x, x, indexing="ij")
    return BSplineSurface(np.stack([X, Y, np.zeros_like(X)], axis=-1), knots, knots, 3, 3, name="sheet")


def spiral() -> np.ndarray:
    """Rows t, x, y, z of the ball's centre: from above the sheet, down the spiral, and up again."""
    share = np.linspace(0.0, 1.0, ROWS)
    angle, radius = 2.0 * np.pi * TURNS * share, OUTER + (INNER - OUTER) * share
    at = np.stack([radius * np.cos(angle), radius * np.sin(angle), BALL - DEPTH * share], axis=1)
    at = np.concatenate([[at[0] + [0.0, 0.0, 0.5]], at, [at[-1] + [0.0, 0.0, 1.5]], [at[-1] + [0.0, 0.0, 4.0]]])
    way = np.linalg.norm(np.diff(at, axis=0), axis=1)
    return np.column_stack([np.concatenate([[0.0], np.cumsum(way) / FEED]), at])


if __name__ == "__main__":
    here = Path(__file__).parent
    part = here / "sheet.json"
    patch_json.write_surfaces(part, [sheet()], "mm")
    registry.write_part(registry.read(part), here / "sheet.step", "step")
    part.unlink()
    lines = ["t,x,y,z"] + [",".join(f"{value:.6g}" for value in row) for row in spiral()]
    (here / "spiral.csv").write_text("\n".join(lines) + "\n", newline="\n")
