"""The springs of a lattice: forces g of paper eq. 4, plastic flow and energy.

Shared by both integrators. Kernels take positions as three padded rows: node n stands at index n + 1 of x[0], x[1],
x[2], because a run of springs (Lattice.segments) may look one node beyond the arrays. The loops over a run are short,
branchless and write one array each, so that the compiler turns them into vector instructions; `np.divide` divides
without the test for zero that would prevent it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..jit import njit_in_place

Array = NDArray[np.float64]
Index = NDArray[np.int64]

TINY = 1e-300
"""Added to squared lengths: springs between two nodes of one point have no direction, and no force either."""


SHORTEST, LONGEST = 0.4, 2.5
"""Plastic flow changes a spring's rest length to no less and no more than these multiples: clay that is dense, foil that is
drawn out. A cell squeezed to nothing would turn inside out."""

LEAST_TANGENT = 1e-3
"""Of a spring's stiffness: what a spring that flows without hardening keeps in the tangent, so that it can be solved."""


@njit_in_place
def _lengths(xa: Array, xb: Array, ya: Array, yb: Array, za: Array, zb: Array, length: Array) -> None:
    for m in range(len(length)):
        dx = xb[m] - xa[m]
        dy = yb[m] - ya[m]
        dz = zb[m] - za[m]
        length[m] = math.sqrt(dx * dx + dy * dy + dz * dz + TINY)


@njit_in_place
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


@njit_in_place
def _pulls(
    xa: Array, xb: Array, ya: Array, yb: Array, za: Array, zb: Array, stiffness: Array, rest: Array,
    px: Array, py: Array, pz: Array,
) -> None:  # fmt: skip
    """The forces of a run of springs on their first nodes: k (L - L_p) along the spring."""
    for m in range(len(rest)):
        dx = xb[m] - xa[m]
        dy = yb[m] - ya[m]
        dz = zb[m] - za[m]
        length = math.sqrt(dx * dx + dy * dy + dz * dz + TINY)
        q = stiffness[m] * np.divide(length - rest[m], length)
        px[m] = q * dx
        py[m] = q * dy
        pz[m] = q * dz


@njit_in_place
def _flowing_pulls(
    xa: Array, xb: Array, ya: Array, yb: Array, za: Array, zb: Array, stiffness: Array, rest: Array,
    initial: Array, strain: Array, hardening: Array, px: Array, py: Array, pz: Array,
) -> None:  # fmt: skip
    """`_flow` and `_pulls` in one pass: what both take from memory is most of their time."""
    for m in range(len(rest)):
        dx = xb[m] - xa[m]
        dy = yb[m] - ya[m]
        dz = zb[m] - za[m]
        length = math.sqrt(dx * dx + dy * dy + dz * dz + TINY)
        soft = 1.0 - hardening[m]
        trial = soft * length - rest[m] + hardening[m] * initial[m]
        limit = soft * strain[m] * initial[m]
        over = trial - limit if trial > limit else (trial + limit if trial < -limit else 0.0)
        now = min(max(rest[m] + over, SHORTEST * initial[m]), LONGEST * initial[m])
        rest[m] = now
        q = stiffness[m] * np.divide(length - now, length)
        px[m] = q * dx
        py[m] = q * dy
        pz[m] = q * dz


@njit_in_place
def add_three(fx: Array, fy: Array, fz: Array, px: Array, py: Array, pz: Array) -> None:
    for m in range(len(fx)):
        fx[m] += px[m]
        fy[m] += py[m]
        fz[m] += pz[m]


@njit_in_place
def _subtract(fx: Array, fy: Array, fz: Array, px: Array, py: Array, pz: Array) -> None:
    for m in range(len(fx)):
        fx[m] -= px[m]
        fy[m] -= py[m]
        fz[m] -= pz[m]


@njit_in_place
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

    When `plastic`, springs strained beyond their yield flow first: rest_length (13, N) moves. work (3, >= longest run).
    """
    for row in range(len(segments)):
        d, start, stop, shift = segments[row]
        a, b = start + 1, stop + 1
        c, e = a + shift, b + shift
        px, py, pz = work[0, : stop - start], work[1, : stop - start], work[2, : stop - start]
        if plastic:
            _flowing_pulls(
                x[0, a:b], x[0, c:e], x[1, a:b], x[1, c:e], x[2, a:b], x[2, c:e],
                stiffness[d, start:stop], rest_length[d, start:stop],
                initial_length[d, start:stop], yield_strain[d, start:stop], hardening[d, start:stop], px, py, pz,
            )  # fmt: skip
        else:
            _pulls(
                x[0, a:b], x[0, c:e], x[1, a:b], x[1, c:e], x[2, a:b], x[2, c:e],
                stiffness[d, start:stop], rest_length[d, start:stop], px, py, pz,
            )  # fmt: skip
        add_three(force[0, a:b], force[1, a:b], force[2, a:b], px, py, pz)
        _subtract(force[0, c:e], force[1, c:e], force[2, c:e], px, py, pz)


@njit_in_place
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


@njit_in_place
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


@njit_in_place
def _distance(x: Array, a: int, b: int) -> float:
    return math.sqrt((x[b, 0] - x[a, 0]) ** 2 + (x[b, 1] - x[a, 1]) ** 2 + (x[b, 2] - x[a, 2]) ** 2)


@njit_in_place
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
