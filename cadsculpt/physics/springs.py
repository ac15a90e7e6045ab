"""The springs of a lattice: forces g of paper eq. 4, plastic flow, energy and the stiffest frequency.

Shared by both integrators. Kernels take positions as three padded rows: node n stands at index n + 1 of x[0], x[1],
x[2], because a run of springs (Lattice.segments) may look one node beyond the arrays. The loops over a run are short,
branchless and write one array each, so that the compiler turns them into vector instructions; `np.divide` divides
without the test for zero that would prevent it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..jit import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SCRATCH_ROWS = 13
"""Rows of N + 2 numbers that `highest_frequency` and the integrators work in."""

TINY = 1e-300
"""Added to squared lengths: springs between two nodes of one point have no direction, and no force either."""


SHORTEST, LONGEST = 0.4, 2.5
"""Plastic flow changes a spring's rest length to no less and no more than these multiples: clay that is dense, foil that is
drawn out. A cell squeezed to nothing would turn inside out."""

LEAST_TANGENT = 1e-3
"""Of a spring's stiffness: what a spring that flows without hardening keeps in the tangent, so that it can be solved."""


@njit
def _lengths(xa: Array, xb: Array, ya: Array, yb: Array, za: Array, zb: Array, length: Array) -> None:
    for m in range(len(length)):
        dx = xb[m] - xa[m]
        dy = yb[m] - ya[m]
        dz = zb[m] - za[m]
        length[m] = math.sqrt(dx * dx + dy * dy + dz * dz + TINY)


@njit
def _flow(length: Array, initial: Array, strain: Array, hardening: Array, rest: Array) -> None:
    """Return mapping in one dimension with linear kinematic hardening (Simo and Hughes 1998, box 1.5), per spring.

    With h the tangent modulus after yield over that before, the trial stress less the back stress, (L - L_p) - h / (1
    - h) (L_p - L_0), may not exceed y L_0; the rest length L_p moves by (1 - h) times the excess. Unloading is
    elastic.
    """
    for m in range(len(rest)):
        soft = 1.0 - hardening[m]
        trial = soft * length[m] - rest[m] + hardening[m] * initial[m]
        limit = soft * strain[m] * initial[m]
        over = trial - limit if trial > limit else (trial + limit if trial < -limit else 0.0)
        rest[m] = min(max(rest[m] + over, SHORTEST * initial[m]), LONGEST * initial[m])


@njit
def _tension(stiffness: Array, rest: Array, length: Array, q: Array) -> None:
    """Force per unit of the spring's vector: k (L - L_p) / L."""
    for m in range(len(q)):
        q[m] = stiffness[m] * np.divide(length[m] - rest[m], length[m])


@njit
def _pull(q: Array, start: Array, end: Array, force: Array) -> None:
    for m in range(len(q)):
        force[m] += q[m] * (end[m] - start[m])


@njit
def _push(q: Array, start: Array, end: Array, force: Array) -> None:
    for m in range(len(q)):
        force[m] -= q[m] * (end[m] - start[m])


@njit
def spring_forces(
    segments: Index,
    stiffness: Array,
    initial_length: Array,
    yield_strain: Array,
    hardening: Array,
    plastic: bool,
    x: Array,
    rest_length: Array,
    force: Array,
    work: Array,
) -> None:
    """Add the forces of all springs, -g of eq. 4, to force (3, N + 2) for positions x (3, N + 2), both padded.

    When `plastic`, springs strained beyond their yield flow first: rest_length (13, N) moves. work (2, >= longest run).
    """
    for row in range(len(segments)):
        d, start, stop, shift = segments[row]
        a, b = start + 1, stop + 1
        c, e = a + shift, b + shift
        length, q = work[0, : stop - start], work[1, : stop - start]
        rest = rest_length[d, start:stop]
        _lengths(x[0, a:b], x[0, c:e], x[1, a:b], x[1, c:e], x[2, a:b], x[2, c:e], length)
        if plastic:
            _flow(length, initial_length[d, start:stop], yield_strain[d, start:stop], hardening[d, start:stop], rest)
        _tension(stiffness[d, start:stop], rest, length, q)
        for axis in range(3):
            _pull(q, x[axis, a:b], x[axis, c:e], force[axis, a:b])
            _push(q, x[axis, a:b], x[axis, c:e], force[axis, c:e])


@njit
def spring_tangents(
    segments: Index,
    stiffness: Array,
    initial_length: Array,
    yield_strain: Array,
    hardening: Array,
    plastic: bool,
    definite: bool,
    x: Array,
    before: Array,
    trial: Array,
    flow: Array,
    rest_length: Array,
    force: Array,
    effort: Array,
    blocks: Array,
    work: Array,
) -> None:
    """What an implicit step needs at positions x (3, N + 2), padded: rest lengths after flow, forces and tangents.

    before (13, N) : rest lengths at the start; rest_length (13, N) receives those after return mapping. force (3, N +
    2), padded, is added to; effort (N + 2) too: the sum of |k (L - L_p)| of a node's springs. work (2, >= longest run).

    blocks (13, N, 6) receives the tangents H = k_t n n + side (1 - n n), side = k (L - L_p) / L, as xx, yy, zz, xy, yz,
    zx. When `definite`, side is cut off at 0: without what pushes compressed springs sideways no lattice is unstable.
    k_t is the tangent of the primal-dual method (Chan, Golub, Mulet 1999). With T the trial stress of `_flow`, in
    lengths, and y its limit, the spring's stress is y w, w = T / max(y, |T|); w is followed as an unknown of its own,

        k_t / k = hardening + (1 - hardening) y / max(y, |T|) (1 - w sign T)    while |T| > y,

    which is the consistent tangent once w is right, and stiffer while a spring that flowed the other way turns round:
    plain Newton iterations overshoot there by the ratio of the two stiffnesses. trial, flow (13, N) : T and w of the
    iteration before, replaced by the new ones unless `definite`, which asks about the same iteration; T is NaN at first.
    """
    for row in range(len(segments)):
        d, start, stop, shift = segments[row]
        a, b = start + 1, stop + 1
        c, e = a + shift, b + shift
        length = work[0, : stop - start]
        rest = rest_length[d, start:stop]
        for m in range(len(rest)):
            rest[m] = before[d, start + m]
        _lengths(x[0, a:b], x[0, c:e], x[1, a:b], x[1, c:e], x[2, a:b], x[2, c:e], length)
        if plastic:
            _flow(length, initial_length[d, start:stop], yield_strain[d, start:stop], hardening[d, start:stop], rest)
        for m in range(len(rest)):
            n = start + m
            k = stiffness[d, n]
            if k == 0.0:
                continue
            p, q = n + 1, n + 1 + shift
            along = k
            limit = (1.0 - hardening[d, n]) * yield_strain[d, n] * initial_length[d, n]
            if plastic and limit < math.inf:
                h = hardening[d, n]
                new = (1.0 - h) * length[m] - before[d, n] + h * initial_length[d, n]
                if not definite:
                    old, w = trial[d, n], new / limit
                    if abs(old) > limit:
                        turned = flow[d, n] if old > 0.0 else -flow[d, n]
                        w = (new - turned * (new - old)) / abs(old)
                    trial[d, n], flow[d, n] = new, min(max(w, -1.0), 1.0)
                w = flow[d, n] if new > 0.0 else -flow[d, n]
                clamped = not SHORTEST * initial_length[d, n] < rest[m] < LONGEST * initial_length[d, n]
                if abs(new) > limit and not clamped:
                    along *= h + (1.0 - h) * limit / abs(new) * (1.0 - w)
                    along = max(along, LEAST_TANGENT * k)
            tension = k * (length[m] - rest[m])
            side = tension / length[m]
            ux, uy, uz = x[0, q] - x[0, p], x[1, q] - x[1, p], x[2, q] - x[2, p]
            force[0, p] += side * ux
            force[1, p] += side * uy
            force[2, p] += side * uz
            force[0, q] -= side * ux
            force[1, q] -= side * uy
            force[2, q] -= side * uz
            effort[p] += abs(tension)
            effort[q] += abs(tension)
            if initial_length[d, n] <= 0.0 or length[m] * length[m] <= 2.0 * TINY:
                # two nodes of one point: tied in every direction alike
                blocks[d, n, 0] = blocks[d, n, 1] = blocks[d, n, 2] = k
                blocks[d, n, 3] = blocks[d, n, 4] = blocks[d, n, 5] = 0.0
                continue
            if definite and side < 0.0:
                side = 0.0
            along = (along - side) / (length[m] * length[m])
            blocks[d, n, 0] = along * ux * ux + side
            blocks[d, n, 1] = along * uy * uy + side
            blocks[d, n, 2] = along * uz * uz + side
            blocks[d, n, 3] = along * ux * uy
            blocks[d, n, 4] = along * uy * uz
            blocks[d, n, 5] = along * uz * ux


@njit
def spring_energy(segments: Index, stiffness: Array, x: Array, rest_length: Array) -> float:
    """Elastic energy, the sum of k (L - L_p)^2 / 2 [N L]; x (N, 3)."""
    energy = 0.0
    for row in range(len(segments)):
        d, start, stop, shift = segments[row]
        for n in range(start, stop):
            if stiffness[d, n] > 0.0:
                stretch = _distance(x, n, n + shift) - rest_length[d, n]
                energy += 0.5 * stiffness[d, n] * stretch * stretch
    return energy


@njit
def _distance(x: Array, a: int, b: int) -> float:
    return math.sqrt((x[b, 0] - x[a, 0]) ** 2 + (x[b, 1] - x[a, 1]) ** 2 + (x[b, 2] - x[a, 2]) ** 2)


@njit
def _tangent(stiffness: Array, rest: Array, length: Array, side: Array, along: Array) -> None:
    """H = side + along d d of springs with vector d: side = k max(0, 1 - L_p / L), along = (k - side) / L^2."""
    for m in range(len(side)):
        ratio = np.divide(rest[m], length[m])
        side[m] = stiffness[m] * (1.0 - ratio) if ratio < 1.0 else 0.0
        along[m] = np.divide(stiffness[m] - side[m], length[m] * length[m])


@njit
def _weigh(root_a: Array, root_b: Array, values: Array) -> None:
    for m in range(len(values)):
        values[m] *= root_a[m] + root_b[m]


@njit
def _add_square(along: Array, side: Array, start: Array, end: Array, total: Array) -> None:
    for m in range(len(total)):
        total[m] += along[m] * (end[m] - start[m]) * (end[m] - start[m]) + side[m]


@njit
def _add_product(along: Array, xa: Array, xb: Array, ya: Array, yb: Array, total: Array) -> None:
    for m in range(len(total)):
        total[m] += along[m] * (xb[m] - xa[m]) * (yb[m] - ya[m])


@njit
def highest_frequency(
    segments: Index,
    stiffness: Array,
    rest_length: Array,
    inverse_mass: Array,
    positions: Array,
    work: Array,
    tied: Index,
    start: Index,
    masters: Index,
    weights: Array,
) -> float:
    """An upper bound of the squared angular frequencies [1/s^2] of the lattice at positions (N, 3).

    A spring of tangent H between nodes a and b puts H / m_a on the diagonal of M^-1/2 K M^-1/2 and -H / sqrt(m_a m_b)
    beside it, so that no eigenvalue exceeds the largest one of any node's 3 x 3 matrix sum_s H (1 / m_a + 1 /
    sqrt(m_a m_b)) (Gershgorin by blocks); in a regular lattice's inside the bound is reached. A held node counts as
    infinitely heavy. H = k (n n + max(0, 1 - L_p / L) (1 - n n)): the parts of a compressed spring that push sideways
    only lower the frequency. work (SCRATCH_ROWS, N + 2).

    That bound is one of quadratic forms: u.K u <= sum_a u_a.D_a u_a, D_a = sum_s H (1 + sqrt(m_a / m_b)), for any positive
    m. A tied node's u_a = sum_k w_k u_k has u_a.D_a u_a <= sum_k w_k u_k.D_a u_k (Jensen), so that D_a goes to its masters
    by their weights, m_a being any number: that of the masters. tied, start, masters, weights : of `TiedNodes`.

    An eigenvalue of a symmetric 3 x 3 matrix is at most m + sqrt(2) s, m their mean and s their standard deviation.
    """
    size = len(inverse_mass)
    x, root = work[0:3], work[12]
    work[:, :] = 0.0
    for n in range(size):
        root[n + 1] = math.sqrt(inverse_mass[n])
        for axis in range(3):
            x[axis, n + 1] = positions[n, axis]
    for s in range(len(tied)):
        mass = 0.0
        for e in range(start[s], start[s + 1]):
            if inverse_mass[masters[e]] > 0.0:
                mass += weights[e] / inverse_mass[masters[e]]
        root[tied[s] + 1] = 1.0 / math.sqrt(mass) if mass > 0.0 else 0.0
    for row in range(len(segments)):
        d, first, stop, shift = segments[row]
        a, b = first + 1, stop + 1
        c, e = a + shift, b + shift
        length, side, along = work[9, : stop - first], work[10, : stop - first], work[11, : stop - first]
        _lengths(x[0, a:b], x[0, c:e], x[1, a:b], x[1, c:e], x[2, a:b], x[2, c:e], length)
        _tangent(stiffness[d, first:stop], rest_length[d, first:stop], length, side, along)
        _weigh(root[a:b], root[c:e], side)
        _weigh(root[a:b], root[c:e], along)
        for i in range(3):
            j = (i + 1) % 3
            for low, high in ((a, b), (c, e)):
                _add_square(along, side, x[i, a:b], x[i, c:e], work[3 + i, low:high])
                _add_product(along, x[i, a:b], x[i, c:e], x[j, a:b], x[j, c:e], work[6 + i, low:high])
    for s in range(len(tied)):
        if root[tied[s] + 1] > 0.0:
            for e in range(start[s], start[s + 1]):
                share = weights[e] * root[masters[e] + 1] / root[tied[s] + 1]
                for i in range(3, 9):
                    work[i, masters[e] + 1] += share * work[i, tied[s] + 1]
    worst = 0.0
    for n in range(size):
        if inverse_mass[n] > 0.0:
            xx, yy, zz = work[3, n + 1], work[4, n + 1], work[5, n + 1]
            xy, yz, zx = work[6, n + 1], work[7, n + 1], work[8, n + 1]
            mean = (xx + yy + zz) / 3.0
            square = (xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + yz * yz + zx * zx)) / 3.0
            bound = mean + math.sqrt(2.0 * max(0.0, square - mean * mean))
            worst = max(worst, bound * root[n + 1])
    return worst


@njit
def largest_drag(gamma: Array, inverse_mass: Array) -> float:
    """The largest gamma / m [1/s] of any node."""
    worst = 0.0
    for n in range(len(gamma)):
        worst = max(worst, gamma[n] * inverse_mass[n])
    return worst


@njit
def fastest_stretch(segments: Index, stiffness: Array, initial_length: Array, velocity: Array) -> float:
    """The largest |relative velocity of a spring's ends| / initial length [1/s]; velocity (3, N + 2), padded. Infinite for
    a NaN.
    """
    worst = 0.0
    for row in range(len(segments)):
        d, start, stop, shift = segments[row]
        for n in range(start, stop):
            if stiffness[d, n] > 0.0 and initial_length[d, n] > 0.0:
                a, b = n + 1, n + 1 + shift
                square = 0.0
                for axis in range(3):
                    square += (velocity[axis, b] - velocity[axis, a]) ** 2
                rate = math.sqrt(square) / initial_length[d, n]
                if not rate <= worst:
                    worst = rate if rate > worst else math.inf
    return worst
