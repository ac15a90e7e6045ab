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

from ..jit import njit_in_place

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_SWEEPS = 20
"""Turns per sub-step. What has not settled by then goes on in the next sub-step, which begins where this one ends: every turn
brings the impulses nearer to what is right, and each of them acts on both sides alike."""

SWEEP_CHANGE = 1e-4
"""Share of the largest impulse: when none changes by more in a turn, the impulses have settled."""


@njit_in_place
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


@njit_in_place
def _add(first: int, end: int, n: int, w: float, node: Index, weight: Array) -> int:
    for r in range(first, end):
        if node[r] == n:
            weight[r] += w
            return end
    node[end], weight[end] = n, w
    return end + 1


@njit_in_place
def touches(nodes: Index, row: Index) -> bool:
    """Some of these nodes (n, 4) are tied."""
    if len(row):
        for c in range(len(nodes)):
            for k in range(4):
                if row[nodes[c, k]] >= 0:
                    return True
    return False


@njit_in_place
def meeting_nodes(start: Index, node: Index, contacts: int, place: Index, met: Index, local: Index) -> int:
    """The number of distinct nodes in the rows of so many contacts, in order of appearance in met, and where each entry of
    the rows finds its own there, local. place (N,) : -1, and left so.
    """
    count = 0
    for r in range(start[contacts]):
        n = node[r]
        if place[n] < 0:
            place[n] = count
            met[count] = n
            count += 1
        local[r] = place[n]
    for m in range(count):
        place[met[m]] = -1
    return count


@njit_in_place
def impel(
    met: Index,
    start: Index,
    local: Index,
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
    moving: Array,
) -> int:
    """All impulses of one sub-step of h seconds; the number of turns taken.

    met (m,), local : of `meeting_nodes`. depth (n,) : at the start. velocity (3, N + 2), padded : with all other forces
    applied; changed. impulse (n,), rubbing (n, 3) [N s] : a guess, replaced by what acts; rubbing acts on the model. mobility
    (n,), moving (m, 4) : workspace, the latter for velocities and inverse masses.
    """
    contacts = len(normal)
    for m in range(len(met)):
        for a in range(3):
            moving[m, a] = velocity[a, met[m] + 1]
        moving[m, 3] = inverse_mass[met[m]]
    for c in range(contacts):
        mobility[c] = 0.0
        for r in range(start[c], start[c + 1]):
            w = weight[r] * moving[local[r], 3]
            mobility[c] += weight[r] * w
            for a in range(3):
                moving[local[r], a] += w * (rubbing[c, a] - impulse[c] * normal[c, a])
    sweeps, settled = 0, False
    while sweeps < MOST_SWEEPS and not settled:
        sweeps += 1
        largest = change = 0.0
        for c in range(contacts):
            ux, uy, uz = -tool[c, 0], -tool[c, 1], -tool[c, 2]
            for r in range(start[c], start[c + 1]):
                m, w = local[r], weight[r]
                ux += w * moving[m, 0]
                uy += w * moving[m, 1]
                uz += w * moving[m, 2]
            nx, ny, nz = normal[c, 0], normal[c, 1], normal[c, 2]
            along = ux * nx + uy * ny + uz * nz
            slope = h * area[c] * (h * stiffness[c] + damping[c])
            without = along + mobility[c] * impulse[c]
            new = max(0.0, (h * area[c] * stiffness[c] * depth[c] + slope * without) / (1.0 + slope * mobility[c]))
            turn = new - impulse[c]
            impulse[c] = new
            px, py, pz = -turn * nx, -turn * ny, -turn * nz
            change = max(change, abs(turn))
            largest = max(largest, new)
            if friction[c] > 0.0 and (new > 0.0 or turn != 0.0):
                limit = friction[c] * new
                # what stops the slip; between two held bodies any slip has friction's full force
                held = mobility[c] == 0.0
                old, share = (0.0, 1.0) if held else (1.0, 1.0 / mobility[c])
                tx = old * rubbing[c, 0] - share * (ux - along * nx)
                ty = old * rubbing[c, 1] - share * (uy - along * ny)
                tz = old * rubbing[c, 2] - share * (uz - along * nz)
                size = math.sqrt(tx * tx + ty * ty + tz * tz)
                cut = limit / size if size > limit or (held and size > 0.0) else 1.0
                tx, ty, tz = cut * tx, cut * ty, cut * tz
                dx, dy, dz = tx - rubbing[c, 0], ty - rubbing[c, 1], tz - rubbing[c, 2]
                rubbing[c, 0], rubbing[c, 1], rubbing[c, 2] = tx, ty, tz
                change = max(change, abs(dx), abs(dy), abs(dz))
                px, py, pz = px + dx, py + dy, pz + dz
            if px != 0.0 or py != 0.0 or pz != 0.0:
                for r in range(start[c], start[c + 1]):
                    m = local[r]
                    w = weight[r] * moving[m, 3]
                    moving[m, 0] += w * px
                    moving[m, 1] += w * py
                    moving[m, 2] += w * pz
        settled = change <= SWEEP_CHANGE * largest
    for m in range(len(met)):
        for a in range(3):
            velocity[a, met[m] + 1] = moving[m, a]
    return sweeps
