"""What keeps a surface as smooth as it is when its control points move: across its seam, and across multiple knots.

A circle's arcs meet in double knots: smooth in space, though the net alone would let a kink form there. The displacement of a
rational surface is D = Q / W with Q = sum B_i B_j w_ij dP_ij and W = sum B_i B_j w_ij. All that is asked of D at a knot is
linear in Q, and where 1 / W changes across it alike for the whole length of it, separable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray

from .matrices import design_matrix
from .refit import sliver_ties
from .surface import BSplineSurface

Array = NDArray[np.float64]
Span = tuple[float, float]

SMOOTH = 1e-7
"""Derivatives on the two sides of a knot are equal within this part of their size: what files round off."""

HIGHEST = 4
"""Derivatives beyond this order are not kept equal: no eye and no milling cutter tells."""

ACROSS = 17
"""Places along a knot where the two sides are compared."""


@dataclass(frozen=True, slots=True)
class Joint:
    """A place along one direction where the surface is smoother than its knots make it, or closed.

    before, after : the parameter as the end of one piece and the start of the next; they differ at a seam. first, last : the
    orders of the derivatives that must be kept equal.
    """

    before: float
    after: float
    first: int
    last: int


def joints(surface: BSplineSurface, axis: int) -> tuple[Joint, ...]:
    """The joints of a surface along u (axis 0) or v (axis 1)."""
    knots, degree = _direction(surface, axis)
    low, high = surface.domain[axis]
    periodic = (surface.periodic_u, surface.periodic_v)[axis]
    found: list[Joint] = []
    inside = knots[(knots > low) & (knots < high)]
    for t, times in zip(*np.unique(inside, return_counts=True), strict=True):
        if times > 1:
            found.append(_joint(surface, axis, float(t), float(t), degree - int(times) + 1))
    if (surface.closed_u, surface.closed_v)[axis] and surface.shape[axis] > 2:
        # a periodic net is closed by itself, and as smooth as its knot there allows
        first = max(degree - int(np.count_nonzero(knots == low)) + 1, 0) if periodic else 0
        found.append(_joint(surface, axis, high, low, first))
    return tuple(joint for joint in found if joint.last >= joint.first)


def _joint(surface: BSplineSurface, axis: int, before: float, after: float, first: int) -> Joint:
    """The joint with the highest order, at most HIGHEST, to which the derivatives on its two sides agree."""
    degree = _direction(surface, axis)[1]
    most = min(degree - 1, HIGHEST)
    jets = [_space_jet(surface, axis, t, most, left=left) for t, left in ((before, True), (after, False))]
    span = surface.domain[axis][1] - surface.domain[axis][0]
    last = -1
    for k in range(most + 1):
        a, b = jets[0][k], jets[1][k]
        if np.abs(a - b).max() > SMOOTH * max(np.abs(a).max(), np.abs(b).max(), surface.size / span**k):
            break
        last = k
    weights = _weights_agree(surface, axis, before, after)
    return Joint(before, after, first, last if weights else -1)


def _weights_agree(surface: BSplineSurface, axis: int, before: float, after: float) -> bool:
    """W must agree on both sides, else Q cannot be the same for every parameter along the knot."""
    if surface.weights is None:
        return True
    w = np.moveaxis(surface.weights, axis, 0)
    knots, degree = _direction(surface, axis)
    a, b = (one_sided(knots, degree, t, 0, left=left)[0] @ w for t, left in ((before, True), (after, False)))
    return bool(np.allclose(a, b, rtol=1e-9))


def one_sided(knots: Array, degree: int, t: float, order: int, *, left: bool) -> Array:
    """Rows (order + 1, count): the derivatives of all basis functions at t, from the left or from the right."""
    place = np.array([t])
    if not left:
        return np.stack([design_matrix(knots, degree, place, k)[0] for k in range(order + 1)])
    # from the left is from the right on the line run backwards
    back = -knots[::-1]
    return np.stack([(-1.0) ** k * design_matrix(back, degree, -place, k)[0][::-1] for k in range(order + 1)])


def _weight_jet(surface: BSplineSurface, axis: int, t: float, order: int, *, left: bool) -> Array:
    """(order + 1, ACROSS): W and its derivatives across a knot, along it."""
    knots, degree = _direction(surface, axis)
    w = np.ones(surface.shape) if surface.weights is None else surface.weights
    along = _along(surface, axis)
    return one_sided(knots, degree, t, order, left=left) @ np.moveaxis(w, axis, 0) @ along.T


def _space_jet(surface: BSplineSurface, axis: int, t: float, order: int, *, left: bool) -> Array:
    """(order + 1, ACROSS, 3): the surface and its derivatives across a knot, along it."""
    knots, degree = _direction(surface, axis)
    w = np.ones(surface.shape) if surface.weights is None else surface.weights
    rows = one_sided(knots, degree, t, order, left=left)
    along = _along(surface, axis)
    net = np.moveaxis(surface.control_points * w[..., None], axis, 0)
    Q = np.einsum("kr,rsc,ns->knc", rows, net, along, optimize=True)
    W = _weight_jet(surface, axis, t, order, left=left)
    jet = np.zeros_like(Q)
    for k in range(order + 1):
        jet[k] = (Q[k] - sum(comb(k, j) * W[j][:, None] * jet[k - j] for j in range(1, k + 1))) / W[0][:, None]
    return jet


def _along(surface: BSplineSurface, axis: int) -> Array:
    knots, degree = _direction(surface, 1 - axis)
    return design_matrix(knots, degree, np.linspace(*surface.domain[1 - axis], ACROSS))


def _direction(surface: BSplineSurface, axis: int) -> tuple[Array, int]:
    return (surface.knots_u, surface.knots_v)[axis], (surface.degree_u, surface.degree_v)[axis]


def unknowns(surface: BSplineSurface, axis: int, slivers: Sequence[Span], kept: Sequence[Joint]) -> Array:
    """T (count, n): the rows of Q along `axis` are T times n rows that are free of each other.

    A row that is its own unknown has a single one in it. slivers : knot spans whose control points move as one. kept : the
    joints, of this surface or of one with fewer knots, that stay as smooth as they are.
    """
    count = surface.shape[axis]
    knots, degree = _direction(surface, axis)
    if (surface.periodic_u, surface.periodic_v)[axis]:
        fold = _of_ties(np.arange(count) % (count - degree))
    else:
        fold = _of_ties(sliver_ties(knots, degree, slivers))
    rows = [conditions(surface, axis, joint) for joint in kept]
    return fold @ _null_space(np.concatenate(rows) @ fold) if rows else fold


def _of_ties(tie: NDArray[np.int64]) -> Array:
    matrix = np.zeros((len(tie), int(tie.max()) + 1))
    matrix[np.arange(len(tie)), tie] = 1.0
    return matrix


def conditions(surface: BSplineSurface, axis: int, joint: Joint) -> Array:
    """Rows C (k, count) with C Q = 0 when D and its derivatives agree on both sides of a joint, as far as is separable."""
    knots, degree = _direction(surface, axis)
    sides = []
    for t, left in ((joint.before, True), (joint.after, False)):
        share = _reciprocal_jet(_weight_jet(surface, axis, t, joint.last, left=left))
        jets = one_sided(knots, degree, t, joint.last, left=left)
        sides.append([sum(comb(k, j) * share[k - j] * jets[j] for j in range(k + 1)) for k in range(len(share))])
    orders = range(joint.first, min(len(side) for side in sides))
    return np.array([sides[0][k] - sides[1][k] for k in orders]).reshape(-1, surface.shape[axis])


def _reciprocal_jet(jets: Array) -> list[float]:
    """(1 / W)^(k) / (1 / W) for k = 0, 1, ... as far as they do not change along the knot; jets (k, n) : of W."""
    ratios = jets / jets[0]
    result = [1.0]
    for k in range(1, len(jets)):
        if np.ptp(ratios[k]) > 1e-9 * max(float(np.abs(ratios[k]).max()), 1.0):
            break
        # Leibniz: the k-th derivative of W (1 / W) = 1 is zero
        result.append(-sum(comb(k, j) * float(ratios[j].mean()) * result[k - j] for j in range(1, k + 1)))
    return result


def _null_space(conditions: Array) -> Array:
    """N (count, n) with conditions @ N = 0: for each condition one row, the one that it says most of, follows the others."""
    c = conditions / np.maximum(np.abs(conditions).max(axis=1, keepdims=True), 1e-300)
    count = c.shape[1]
    pivots: list[int] = []
    rows: list[int] = []
    for k in range(len(c)):
        row = np.abs(c[k])
        row[pivots] = 0.0
        # of those that are as good the last: the end of a closed row follows its beginning
        pivot = count - 1 - int(np.argmax(row[::-1] >= (1.0 - 1e-9) * row.max()))
        if row[pivot] <= 1e-10:
            continue  # it follows from the others
        c[k] /= c[k, pivot]
        for other in range(len(c)):
            if other != k:
                c[other] -= c[other, pivot] * c[k]
                c[other, pivot] = 0.0
        pivots.append(pivot)
        rows.append(k)
    kept = np.setdiff1d(np.arange(count), pivots)
    result = np.zeros((count, len(kept)))
    result[kept, np.arange(len(kept))] = 1.0
    if pivots:
        result[pivots] = -c[rows][:, kept]
    return result
