"""The motion of a body as a whole, against which eq. 4's gamma does not act: damping belongs to deformation.

Of a free body, gamma damps what is left of the velocities when the rigid motion nearest to them is taken away, nearest in the
sum of gamma |v - V - omega x r|^2. The damping forces then have neither a sum nor a moment, whatever the materials: momentum
and angular momentum stay, and a body that is thrown does not slow down.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit_in_place

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROUND = 1e-12
"""Of the moment of inertia, added to it: about the line that all nodes stand on a body does not turn."""


def rigid_motion(weights: Array, x: Array, velocity: Array) -> tuple[Array, Array, Array]:
    """Centre (3,) [L], velocity of the centre (3,) [L/s] and angular velocity (3,) [1/s] of nodes (N, 3) that move on average
    as a rigid body does, weighted with weights (N,): with masses, the body's momentum over its mass and its angular
    momentum over its moment of inertia.
    """
    total = float(weights.sum())
    centre = weights @ x / total
    mean = weights @ velocity / total
    r = x - centre
    moment = weights @ np.cross(r, velocity)
    inertia = -np.einsum("n,na,nb->ab", weights, r, r)
    inertia += np.eye(3) * -float(np.trace(inertia))
    inertia += np.eye(3) * (ROUND * float(np.trace(inertia)) + 1e-300)
    return centre, mean, np.linalg.solve(inertia, moment)


def free_bodies(free: Index) -> list[Index]:
    """The nodes of every free body. free (b, 3) : of `Lattice`."""
    return [
        np.concatenate([np.arange(start, stop) for _, start, stop in free[free[:, 0] == body]])
        for body in np.unique(free[:, 0])
    ]


def rigid_flight(free: Index, mass: Array, x: Array, velocity: Array, h: float) -> Array:
    """Displacements over h seconds (N, 3), over h, of free bodies that fly on as they do on average; 0 on what is held.

    A body turns by Cayley's rotation about its centre, whose chords omega x (r0 + r1) / 2 are those of a rigid body: of what
    flies freely it is the implicit step itself.
    """
    flight = np.zeros_like(x)
    for body in free_bodies(free):
        centre, mean, spin = rigid_motion(mass[body], x[body], velocity[body])
        # omega x, as a matrix on row vectors
        turn = np.cross(spin, np.eye(3))
        middle = np.linalg.solve(np.eye(3) - 0.5 * h * turn.T, (x[body] - centre).T).T
        flight[body] = mean + middle @ turn
    return flight


def body_modes(free: Index, gamma: Array, x: Array) -> tuple[Array, Array]:
    """Modes (r, N, 3) and core (r, r) so that the sum modes^T core modes v is gamma times the rigid motions nearest to v, at
    positions x (N, 3), 0 on what is held. (An implicit step's chords are rigid at the middle of its way, `rigid_flight`.)
    """
    bodies = [body for body in free_bodies(free) if gamma[body].any()]
    modes, core = np.zeros((6 * len(bodies), *x.shape)), np.zeros((6 * len(bodies), 6 * len(bodies)))
    for k, body in enumerate(bodies):
        r = x[body] - gamma[body] @ x[body] / gamma[body].sum()
        # lengths and angles alike
        r = r / max(float(np.linalg.norm(r, axis=1).max()), 1e-300)
        motions = np.concatenate(
            [np.broadcast_to(axis, r.shape)[None] for axis in np.eye(3)]
            + [np.cross(axis, r)[None] for axis in np.eye(3)]
        )
        weighed = gamma[body, None] * motions
        rows = slice(6 * k, 6 * k + 6)
        modes[rows, body] = weighed
        core[rows, rows] = np.linalg.pinv(np.einsum("anc,bnc->ab", motions, weighed), rcond=ROUND, hermitian=True)
    return modes, core


@njit_in_place
def _body_motion(free: Index, first: int, last: int, weight: Array, x: Array, v: Array, out: Array) -> bool:
    """`rigid_motion` of the nodes in rows first to last of free, x and v (3, N + 2) padded: into out[0:9]. False without
    weight.
    """
    out[:] = 0.0
    total = 0.0
    for row in range(first, last):
        for n in range(free[row, 1], free[row, 2]):
            total += weight[n]
            for a in range(3):
                out[a] += weight[n] * x[a, n + 1]
                out[3 + a] += weight[n] * v[a, n + 1]
    if total == 0.0:
        return False
    for a in range(6):
        out[a] /= total
    mx = my = mz = xx = yy = zz = xy = yz = zx = 0.0
    for row in range(first, last):
        for n in range(free[row, 1], free[row, 2]):
            w = weight[n]
            rx, ry, rz = x[0, n + 1] - out[0], x[1, n + 1] - out[1], x[2, n + 1] - out[2]
            vx, vy, vz = v[0, n + 1] - out[3], v[1, n + 1] - out[4], v[2, n + 1] - out[5]
            mx += w * (ry * vz - rz * vy)
            my += w * (rz * vx - rx * vz)
            mz += w * (rx * vy - ry * vx)
            xx += w * (ry * ry + rz * rz)
            yy += w * (rz * rz + rx * rx)
            zz += w * (rx * rx + ry * ry)
            xy -= w * rx * ry
            yz -= w * ry * rz
            zx -= w * rz * rx
    small = ROUND * (xx + yy + zz)
    xx, yy, zz = xx + small, yy + small, zz + small
    ax, ay, az = yy * zz - yz * yz, yz * zx - xy * zz, xy * yz - yy * zx
    bz = xy * zx - xx * yz
    determinant = xx * ax + xy * ay + zx * az
    if determinant > 0.0:
        out[6] = (ax * mx + ay * my + az * mz) / determinant
        out[7] = (ay * mx + (xx * zz - zx * zx) * my + bz * mz) / determinant
        out[8] = (az * mx + bz * my + (xx * yy - xy * xy) * mz) / determinant
    return True


@njit_in_place
def ride(free: Index, gamma: Array, frame_velocity: Array, x: Array, v: Array, force: Array, out: Array) -> None:
    """Add gamma times the rigid motion of its body to the force on every free node, so that damping acts on the rest.

    free (b, 3) : of `Lattice`. x, v, force (3, N + 2), padded. frame_velocity (N, 3) or empty : what has been added already,
    and is taken away. out (>= 9,) : workspace.
    """
    first = 0
    while first < len(free):
        last = first + 1
        while last < len(free) and free[last, 0] == free[first, 0]:
            last += 1
        if _body_motion(free, first, last, gamma, x, v, out):
            for row in range(first, last):
                for n in range(free[row, 1], free[row, 2]):
                    rx, ry, rz = x[0, n + 1] - out[0], x[1, n + 1] - out[1], x[2, n + 1] - out[2]
                    force[0, n + 1] += gamma[n] * (out[3] + out[7] * rz - out[8] * ry)
                    force[1, n + 1] += gamma[n] * (out[4] + out[8] * rx - out[6] * rz)
                    force[2, n + 1] += gamma[n] * (out[5] + out[6] * ry - out[7] * rx)
                    if len(frame_velocity):
                        for a in range(3):
                            force[a, n + 1] -= gamma[n] * frame_velocity[n, a]
        first = last
