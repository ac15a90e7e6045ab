"""Contacts whose other side moves too, and contacts at tied nodes: impulses found one after the other, in turns.

A contact c between a point of the model, sum_k w_k x_k, and one of another body, sum_k w'_k x_k, sees the relative velocity
u = sum_k w_k v_k - sum_k w'_k v_k - v_tool. In a sub-step of h seconds it gives the impulse

    J = h A max(0, k_n (d + h u.n) + c_n u.n),    |T| <= mu J  against the slip u - (u.n) n,

u being that at the sub-step's end (forces.py): minus J n + T on the one side, the exact opposite on the other, so that
momentum is kept to rounding. Without friction the J are the minimum of a strictly convex function, which has
1 / (h A (h k_n + c_n)) on its diagonal beside the inverse masses; projected Gauss-Seidel in a fixed order goes down to it from
any start, for any k_n and c_n (each contact in turn takes the impulse that is right while the others stand),

    J = max(0, h A (k_n d + (h k_n + c_n) u0.n) / (1 + h A (h k_n + c_n) / m)),    1 / m = sum_k w_k^2 / m_k,

u0 being u without J itself. Friction takes its turn with each: T is what stops the slip, cut to mu J. A sub-step begins with
the impulses of the one before.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..jit import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_SWEEPS = 100
"""Turns per sub-step. Contacts of one pair of nodes settle in a few, fields of them in ten to thirty."""

SWEEP_CHANGE = 1e-6
"""Share of the largest impulse: when none changes by more in a turn, the impulses have settled."""


@njit
def contact_rows(
    nodes: Index,
    weights: Array,
    other_nodes: Index,
    other_weights: Array,
    row: Index,
    tie_start: Index,
    masters: Index,
    tie_weights: Array,
    start: Index,
    node: Index,
    weight: Array,
) -> None:
    """Contacts as rows of nodes and weights: contact c moves with sum weight v of node[start[c]:start[c + 1]].

    nodes, weights, other_nodes, other_weights (n, 4) : of `ContactLoad`, the others' empty where there are none; theirs count
    negative. row, tie_start, masters, tie_weights : of `TiedNodes`; in place of a tied node stand its masters. start (>= n +
    1), node, weight : filled; a node appears once in a row.
    """
    end = 0
    for c in range(len(nodes)):
        first = end
        start[c] = first
        for side in range(2 if len(other_nodes) else 1):
            for k in range(4):
                n = nodes[c, k] if side == 0 else other_nodes[c, k]
                w = weights[c, k] if side == 0 else -other_weights[c, k]
                if w == 0.0:
                    continue
                s = row[n] if len(row) else -1
                if s < 0:
                    end = _add(first, end, n, w, node, weight)
                else:
                    for e in range(tie_start[s], tie_start[s + 1]):
                        end = _add(first, end, masters[e], w * tie_weights[e], node, weight)
    start[len(nodes)] = end


@njit
def _add(first: int, end: int, n: int, w: float, node: Index, weight: Array) -> int:
    for r in range(first, end):
        if node[r] == n:
            weight[r] += w
            return end
    node[end], weight[end] = n, w
    return end + 1


@njit
def touches(nodes: Index, row: Index) -> bool:
    """Some of these nodes (n, 4) are tied."""
    if len(row):
        for c in range(len(nodes)):
            for k in range(4):
                if row[nodes[c, k]] >= 0:
                    return True
    return False


@njit
def relative_velocity(
    c: int, start: Index, node: Index, weight: Array, tool: Array, velocity: Array, axis: int
) -> float:
    """One component of u of contact c; velocity (3, N + 2), padded."""
    total = -tool[c, axis]
    for r in range(start[c], start[c + 1]):
        total += weight[r] * velocity[axis, node[r] + 1]
    return total


@njit
def _kick(c: int, start: Index, node: Index, weight: Array, inverse_mass: Array, velocity: Array, p: Array) -> None:
    """Give the impulse p (3,) to the model at contact c, and its opposite to the other side."""
    for r in range(start[c], start[c + 1]):
        w = weight[r] * inverse_mass[node[r]]
        for a in range(3):
            velocity[a, node[r] + 1] += w * p[a]


@njit
def impel(
    start: Index,
    node: Index,
    weight: Array,
    normal: Array,
    area: Array,
    stiffness: Array,
    damping: Array,
    friction: Array,
    tool: Array,
    depth: Array,
    inverse_mass: Array,
    h: float,
    velocity: Array,
    impulse: Array,
    rubbing: Array,
    mobility: Array,
    kick: Array,
) -> int:
    """All impulses of one sub-step of h seconds; the number of turns taken.

    depth (n,) : at its start. velocity (3, N + 2), padded : with all other forces applied; changed. impulse (n,), rubbing (n,
    3) [N s] : those of the sub-step before, replaced; rubbing acts on the model. mobility (n,), kick (3,) : workspace.
    """
    contacts = len(normal)
    for c in range(contacts):
        mobility[c] = 0.0
        for r in range(start[c], start[c + 1]):
            mobility[c] += weight[r] * weight[r] * inverse_mass[node[r]]
        for a in range(3):
            kick[a] = rubbing[c, a] - impulse[c] * normal[c, a]
        _kick(c, start, node, weight, inverse_mass, velocity, kick)
    for sweep in range(MOST_SWEEPS):
        largest = change = 0.0
        for c in range(contacts):
            ux = relative_velocity(c, start, node, weight, tool, velocity, 0)
            uy = relative_velocity(c, start, node, weight, tool, velocity, 1)
            uz = relative_velocity(c, start, node, weight, tool, velocity, 2)
            nx, ny, nz = normal[c, 0], normal[c, 1], normal[c, 2]
            along = ux * nx + uy * ny + uz * nz
            ux, uy, uz = ux - along * nx, uy - along * ny, uz - along * nz
            slope = h * area[c] * (h * stiffness[c] + damping[c])
            without = along + mobility[c] * impulse[c]
            new = max(0.0, (h * area[c] * stiffness[c] * depth[c] + slope * without) / (1.0 + slope * mobility[c]))
            turn = new - impulse[c]
            impulse[c] = new
            tx = ty = tz = 0.0
            limit = friction[c] * new
            if limit > 0.0:
                tx, ty, tz = -ux, -uy, -uz
                if mobility[c] > 0.0:
                    tx = rubbing[c, 0] + tx / mobility[c]
                    ty = rubbing[c, 1] + ty / mobility[c]
                    tz = rubbing[c, 2] + tz / mobility[c]
                size = math.sqrt(tx * tx + ty * ty + tz * tz)
                # between two held bodies any slip has friction's full force
                if size > limit or (mobility[c] == 0.0 and size > 0.0):
                    tx, ty, tz = tx * limit / size, ty * limit / size, tz * limit / size
            kick[0], kick[1], kick[2] = tx - rubbing[c, 0], ty - rubbing[c, 1], tz - rubbing[c, 2]
            rubbing[c, 0], rubbing[c, 1], rubbing[c, 2] = tx, ty, tz
            change = max(change, abs(turn), abs(kick[0]), abs(kick[1]), abs(kick[2]))
            largest = max(largest, new)
            kick[0] -= turn * nx
            kick[1] -= turn * ny
            kick[2] -= turn * nz
            if change > 0.0:
                _kick(c, start, node, weight, inverse_mass, velocity, kick)
        if change <= SWEEP_CHANGE * largest:
            return sweep + 1
    return MOST_SWEEPS
