"""Curves in space as trim curves of the surface that they lie on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from OCP.GeomProjLib import GeomProjLib

from ...spline.surface import BSplineSurface, TrimCurve
from .quiet import quiet
from .shape import geom_of_surface, spline_curve
from .trim import evaluate_trim, trim_of_geom

Array = NDArray[np.float64]

FINENESS = 1e-7
"""Of the projection, relative to the surface's size."""
NEAR = 1e-3
"""How far the image may lie from the curve, relative to the surface's size: the sender's own accuracy."""


def projected_curve(
    control_points: Array, knots: Array, degree: int, weights: Array | None, surface: BSplineSurface
) -> TrimCurve | None:
    """The trim curve along which a B-spline curve in space runs on `surface`; None when it does not lie on it."""
    with quiet():
        curve = spline_curve(control_points, knots, degree, weights)
        first, last = float(knots[degree]), float(knots[-degree - 1])
        try:
            flat = GeomProjLib.Curve2d_s(curve, first, last, geom_of_surface(surface), FINENESS * surface.size)
        except Exception:  # the kernel's own errors have no common base
            return None
        if flat is None:
            return None
        trim = trim_of_geom(flat, max(first, flat.FirstParameter()), min(last, flat.LastParameter()))
        t = np.linspace(first, last, 17)
        truth = np.array([(p.X(), p.Y(), p.Z()) for p in (curve.Value(float(x)) for x in t)])
    (a, b), (c, d) = surface.domain
    uv = evaluate_trim(trim, t)
    points = surface.evaluate(np.clip(uv[:, 0], a, b), np.clip(uv[:, 1], c, d))
    return trim if np.linalg.norm(points - truth, axis=1).max() <= NEAR * surface.size else None
