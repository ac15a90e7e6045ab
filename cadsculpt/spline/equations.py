"""What a fit is asked along curves across a net, as linear equations of its control points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from .matrices import design_matrix
from .surface import BSplineSurface

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """What the displacement must be along a curve across the net: value (n, 3) at uv (n, 2).

    direction (n, 2) : it is the derivative in this direction of (u, v) that must be so, not the displacement itself.
    tolerance (n,) : how near it must come, each place by itself.
    """

    uv: Array
    value: Array
    tolerance: Array
    direction: Array | None = None


def displacement_along(
    surface: BSplineSurface, displacement: Array, uv: Array, direction: Array | None = None
) -> Array:
    """What control point displacements (r, s, 3) do to the surface at uv (n, 2), or the derivative of that in a direction
    (n, 2) of (u, v): (n, 3)."""
    w = np.ones(surface.shape) if surface.weights is None else surface.weights
    weighted = (displacement * w[..., None]).reshape(-1, 3)
    result: Array = equation_rows(surface, uv, direction) @ weighted
    return result


def equation_rows(surface: BSplineSurface, uv: Array, direction: Array | None) -> scipy.sparse.csr_matrix:
    """Rows (n, r s) that take Q to the displacement at uv, or to its derivative in a direction."""
    low, high = np.array(surface.domain).T
    place = np.clip(uv, low, high)
    jets = [
        [scipy.sparse.csr_matrix(design_matrix(knots, degree, place[:, axis], k)) for k in (0, 1)]
        for axis, (knots, degree) in enumerate(
            ((surface.knots_u, surface.degree_u), (surface.knots_v, surface.degree_v))
        )
    ]
    w = np.ones(surface.shape[0] * surface.shape[1]) if surface.weights is None else surface.weights.ravel()
    plain = _row_products(jets[0][0], jets[1][0])
    W = plain @ w
    if direction is None:
        return scipy.sparse.diags(1.0 / W) @ plain
    along = scipy.sparse.diags(direction[:, 0]) @ _row_products(jets[0][1], jets[1][0])
    along = along + scipy.sparse.diags(direction[:, 1]) @ _row_products(jets[0][0], jets[1][1])
    return scipy.sparse.diags(1.0 / W) @ along - scipy.sparse.diags((along @ w) / W**2) @ plain


def _row_products(a: scipy.sparse.csr_matrix, b: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
    """Row by row the products of all entries of a (n, r) with all of b (n, s): (n, r s)."""
    n, s = a.shape[0], b.shape[1]
    a, b = a.tocoo(), b.tocsr()
    counts = np.diff(b.indptr)[a.row]
    rows = np.repeat(a.row, counts)
    inner = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    place = np.repeat(b.indptr[a.row], counts) + inner
    columns = np.repeat(a.col.astype(np.int64), counts) * s + b.indices[place]
    values = np.repeat(a.data, counts) * b.data[place]
    return scipy.sparse.csr_matrix((values, (rows, columns)), shape=(n, a.shape[1] * s))


def places(surface: BSplineSurface, asked: Sequence[Asked]) -> list[tuple[Array, Array]]:
    """Bases along u and along v at the places where something is asked."""
    low, high = np.array(surface.domain).T
    found = []
    for item in asked:
        place = np.clip(item.uv, low, high)
        found.append(
            (
                design_matrix(surface.knots_u, surface.degree_u, place[:, 0]),
                design_matrix(surface.knots_v, surface.degree_v, place[:, 1]),
            )
        )
    return found
