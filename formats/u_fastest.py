"""Nets that stand in a file as one row of points, u fastest: GoTools, G+Smo and IGES write them so."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError, InputError
from ..spline.surface import BSplineSurface, Provenance

Array = NDArray[np.float64]


def surface_of_rows(
    points: Array,
    weights: Array | None,
    knots: tuple[Array, Array],
    degrees: tuple[int, int],
    *,
    name: str,
    provenance: Provenance,
    where: str,
) -> BSplineSurface:
    """The surface of a net in rows: points (r s, 3) or (3 r s,), weights (r s,) or None, u fastest.

    Raises InputError at `where` when this is no B-spline surface.
    """
    r, s = (len(k) - p - 1 for k, p in zip(knots, degrees, strict=True))
    surface = BSplineSurface(
        control_points=points.reshape(s, r, 3).transpose(1, 0, 2),
        knots_u=knots[0],
        knots_v=knots[1],
        degree_u=degrees[0],
        degree_v=degrees[1],
        weights=None if weights is None else weights.reshape(s, r).T,
        name=name,
        provenance=provenance,
    )
    try:
        surface.validate()
    except GeometryError as error:
        raise InputError(error.what, where=where, mend=error.mend) from None
    return surface


def rows_of_surface(surface: BSplineSurface) -> tuple[Array, Array | None]:
    """The net of a surface in rows, u fastest: points (r s, 3) and weights (r s,) or None."""
    weights = None if surface.weights is None else surface.weights.T.ravel()
    return surface.control_points.transpose(1, 0, 2).reshape(-1, 3), weights
