"""How fast a lattice can oscillate, and so how long an explicit sub-step may be."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..jit import njit_in_place, njit_inline_in_place
from .springs import TINY, add_three
from .ties import TiedNodes

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SCRATCH_ROWS = 16
"""Rows of N + 2 numbers that `highest_frequency` and the integrators work in."""

LEAST_SCALE = 1e-3
"""Of the largest: a node that is left out of the fast oscillations now may come into them later."""

ENOUGH, MOST_TURNS = 1e-3, 64
"""A bound that falls by no more than this share in one turn of the iteration is as good as the least; and no more turns than
this."""

FRESH = 0.02
"""A bound is evaluated again when a node has moved by this share of the shortest spring since."""


@dataclass(slots=True, eq=False)
class FrequencyBound:
    """What is known of a lattice's highest frequency: no part of its motion, but of what decides on the length of sub-steps.

    square : an upper bound of the squared angular frequencies [1/s^2] at the positions `seen` (N, 3). scale (N,) : of
    `highest_frequency`, which each evaluation improves.
    """

    square: float
    scale: Array
    seen: Array

    def copy(self) -> FrequencyBound:
        """One of its own with the same values."""
        return replace(self, scale=self.scale.copy(), seen=self.seen.copy())


def least_bound(
    segments: Index, stiffness: Array, rest_length: Array, inverse_mass: Array, nodes: Array, ties: TiedNodes
) -> tuple[float, Array]:
    """The least bound of `highest_frequency` at nodes (N, 3), and the scale (N,) that gives it."""
    scale, work = np.ones(len(nodes)), np.empty((SCRATCH_ROWS, len(nodes) + 2))
    free = inverse_mass > 0.0
    scale[free] = np.sqrt(inverse_mass[free] / inverse_mass.max())
    square, best = math.inf, scale
    for _ in range(MOST_TURNS):
        used = scale.copy()
        now = highest_frequency(
            segments, stiffness, rest_length, inverse_mass, nodes, scale, work,
            ties.nodes, ties.start, ties.masters, ties.weights,
        )  # fmt: skip
        enough = not now < square * (1.0 - ENOUGH)
        if now < square:
            square, best = now, used
        if enough:
            break
    return square, best


@njit_in_place
def _tangents(
    xa: Array, xb: Array, ya: Array, yb: Array, za: Array, zb: Array, stiffness: Array, rest: Array,
    scale_a: Array, scale_b: Array, xx: Array, yy: Array, zz: Array, xy: Array, yz: Array, zx: Array,
) -> None:  # fmt: skip
    """(z_a + z_b) H of a run of springs with vector d: H = side + along d d, side = k max(0, 1 - L_p / L), along = (k - side)
    / L^2."""
    for m in range(len(rest)):
        dx = xb[m] - xa[m]
        dy = yb[m] - ya[m]
        dz = zb[m] - za[m]
        square = dx * dx + dy * dy + dz * dz + TINY
        ratio = np.divide(rest[m], math.sqrt(square))
        both = scale_a[m] + scale_b[m]
        side = stiffness[m] * (1.0 - ratio) if ratio < 1.0 else 0.0
        along = both * np.divide(stiffness[m] - side, square)
        side *= both
        xx[m] = along * dx * dx + side
        yy[m] = along * dy * dy + side
        zz[m] = along * dz * dz + side
        xy[m] = along * dx * dy
        yz[m] = along * dy * dz
        zx[m] = along * dz * dx


@njit_in_place
def highest_frequency(
    segments: Index,
    stiffness: Array,
    rest_length: Array,
    inverse_mass: Array,
    positions: Array,
    scale: Array,
    work: Array,
    tied: Index,
    start: Index,
    masters: Index,
    weights: Array,
) -> float:
    """An upper bound of the squared angular frequencies [1/s^2] of the lattice at positions (N, 3).

    For any positive z_n and a spring of tangent H between nodes a and b,

        (u_a - u_b).H (u_a - u_b) <= (1 + z_b / z_a) u_a.H u_a + (1 + z_a / z_b) u_b.H u_b,

    so that u.K u <= sum_a u_a.D_a u_a, D_a = sum_s H (z_a + z_b) / z_a, and no eigenvalue of M^-1 K exceeds the largest one
    of any node's 3 x 3 matrix D_a / m_a (Gershgorin's circles by blocks, scaled). A held node counts as z = 0. H = k (n n +
    max(0, 1 - L_p / L) (1 - n n)): the parts of a compressed spring that push sideways only lower the frequency.

    scale (N,) : z. It is replaced by z_a times the eigenvalue at a, which is Collatz's and Wielandt's iteration for the
    least such bound: evaluations at the same positions fall, to within a few percent of the frequency itself. work
    (SCRATCH_ROWS, N + 2).

    A tied node's u_a = sum_k w_k u_k has u_a.D_a u_a <= sum_k w_k u_k.D_a u_k (Jensen), so that D_a goes to its masters by
    their weights; its z is their mean. tied, start, masters, weights : of `TiedNodes`.

    """
    size = len(inverse_mass)
    x, z = work[0:3], work[15]
    for n in range(size + 2):
        for i in range(3, 9):
            work[i, n] = 0.0
    z[0] = z[size + 1] = 0.0
    for axis in range(3):
        x[axis, 0] = x[axis, size + 1] = 0.0
    for n in range(size):
        z[n + 1] = scale[n] if inverse_mass[n] > 0.0 else 0.0
        for axis in range(3):
            x[axis, n + 1] = positions[n, axis]
    for s in range(len(tied)):
        for e in range(start[s], start[s + 1]):
            z[tied[s] + 1] += weights[e] * z[masters[e] + 1]
    for row in range(len(segments)):
        d, first, stop, shift = segments[row]
        a, b = first + 1, stop + 1
        c, e, count = a + shift, b + shift, stop - first
        xx, yy, zz, xy, yz, zx = (
            work[9, :count], work[10, :count], work[11, :count], work[12, :count], work[13, :count], work[14, :count],
        )  # fmt: skip
        _tangents(
            x[0, a:b], x[0, c:e], x[1, a:b], x[1, c:e], x[2, a:b], x[2, c:e],
            stiffness[d, first:stop], rest_length[d, first:stop], z[a:b], z[c:e], xx, yy, zz, xy, yz, zx,
        )  # fmt: skip
        for low, high in ((a, b), (c, e)):
            add_three(work[3, low:high], work[4, low:high], work[5, low:high], xx, yy, zz)
            add_three(work[6, low:high], work[7, low:high], work[8, low:high], xy, yz, zx)
    for s in range(len(tied)):
        for e in range(start[s], start[s + 1] if z[tied[s] + 1] > 0.0 else start[s]):
            share = weights[e] * z[masters[e] + 1] / z[tied[s] + 1]
            for i in range(3, 9):
                work[i, masters[e] + 1] += share * work[i, tied[s] + 1]
    worst, most, fresh = 0.0, 0.0, work[9]
    for n in range(size):
        if inverse_mass[n] > 0.0:
            p, q, r = work[3, n + 1], work[4, n + 1], work[5, n + 1]
            f, g, h = work[6, n + 1], work[7, n + 1], work[8, n + 1]
            value = _largest_eigenvalue(p, q, r, f, g, h) * inverse_mass[n]
            if not value < math.inf:
                return math.inf
            fresh[n], most, worst = value, max(most, value), max(worst, value / z[n + 1])
    for n in range(size):
        scale[n] = max(fresh[n] / most, LEAST_SCALE) if inverse_mass[n] > 0.0 and most > 0.0 else 1.0
    return worst


@njit_inline_in_place
def _largest_eigenvalue(xx: float, yy: float, zz: float, xy: float, yz: float, zx: float) -> float:
    """Of a symmetric 3 x 3 matrix, from above: its characteristic polynomial has real roots alone, so that Newton's steps from
    a place above the largest one stay above it. They begin at m + sqrt(2) s, m and s the eigenvalues' mean and standard
    deviation."""
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    half = 0.5 * (a * a + b * b + c * c) + xy * xy + yz * yz + zx * zx
    if not half > 0.0:
        return mean
    determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * zx) + zx * (xy * yz - b * zx)
    root = math.sqrt(4.0 / 3.0 * half)
    for _ in range(4):
        root -= max(0.0, (root * root - half) * root - determinant) / (3.0 * root * root - half)
    return mean + root


@njit_in_place
def largest_drag(gamma: Array, inverse_mass: Array) -> float:
    """The largest gamma / m [1/s] of any node."""
    worst = 0.0
    for n in range(len(gamma)):
        worst = max(worst, gamma[n] * inverse_mass[n])
    return worst


@njit_in_place
def farthest(x: Array, seen: Array) -> float:
    """The largest distance between nodes x (N, 3) and where they were seen; infinite for a NaN."""
    square = 0.0
    for n in range(len(x)):
        a, b, c = x[n, 0] - seen[n, 0], x[n, 1] - seen[n, 1], x[n, 2] - seen[n, 2]
        away = a * a + b * b + c * c
        if not away <= square:
            square = away if away > square else math.inf
    return math.sqrt(square)
