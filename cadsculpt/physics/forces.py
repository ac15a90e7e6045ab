"""Contact forces and their way to the nodes (paper section 4.8, fig. 6).

A contact that stands for the area A of the surface, d deep in a tool that moves against it at the rate d', presses with

    p = A max(0, k_n d + c_n d')                                    along the inward normal, and rubs with
    |f| <= mu p                                                     against the slip (Coulomb).

k_n [N/L^3] and c_n [N s/L^3] are per area, so that the force does not depend on how finely the surface is sampled. The force
goes to the four nodes around (u, v) with bilinear weights.

Within a sub-step of h seconds the force is that at the sub-step's end, so that neither a stiff contact nor a small slip
shortens it. The pressure is linear in the velocity, p(v1) = p(v) + A (h k_n + c_n) n . (v1_c - v_c), and its slope acts on the
nodes as inertia, lumped:

    (m_i + L_i) (v1 - v) = h (f - gamma v - g) - h sum_c w_ci p_c(v) n_c,    L_i = sum_c w_ci h A_c (h k_n + c_n) n_c n_c.

At rest this is the exact balance of eq. 4; in motion it is stable whatever k_n and c_n are (the lumped L is not below the
consistent matrix, row by row), and summed over its four nodes a contact's impulse is exactly h p_c(v1). Friction then stops
the slip of every node in contact as far as the mu p of its contacts goes: Coulomb's law, with no slip to regularise it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..jit import njit
from .lattice import Lattice
from .material import Material

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STIFFNESS_RATIO = 20.0
"""k_n over E / spacing: a dent one node spacing wide is 20 times stiffer to the contact than to the material, so that the
residual penetration is about 5 % of the narrowest dents' depth and far less of wide ones'."""

PASSES = 2
DAMPING_RATIO = 0.5
"""c_n as a fraction of critical for the contact's own spring under half a cell's mass: a tool that lands does not bounce."""


def contact_stiffness(
    material: Material | Sequence[Material], thickness: float, spacing: float, metres_per_unit: float
) -> float:
    """k_n [N/L^3] for a surface of this material, with nodes `spacing` [L] apart on a lattice of this thickness [L].

    Of several materials (both bodies deform) the contact's springs stand one behind the other.
    """
    materials = [material] if isinstance(material, Material) else list(material)
    compliance = sum(1.0 / (m.youngs_modulus * metres_per_unit**2) for m in materials)
    return STIFFNESS_RATIO / (compliance * min(spacing, thickness))


def contact_damping(material: Material, stiffness: float, lattice: Lattice) -> float:
    """c_n [N s/L^3] that goes with k_n = stiffness [N/L^3] on a surface of this material."""
    mass = 0.5 * material.density * lattice.spacing * lattice.metres_per_unit**4
    return 2.0 * DAMPING_RATIO * math.sqrt(stiffness * mass)


def node_weights(lattice: Lattice, u: ArrayLike, v: ArrayLike) -> tuple[Index, Array]:
    """The four surface nodes around each (u, v) and their bilinear weights: indices (n, 4) and weights (n, 4) of sum 1.

    Around the seam in closed directions; outside the grid, those of its border. Nodes in no cell get weight 0 and the others
    share it; where all four are in no cell, the nearest surface node that is in one gets all. Raises InputError for (u, v)
    that are not finite.
    """
    u, v = np.atleast_1d(np.asarray(u, dtype=np.float64)), np.atleast_1d(np.asarray(v, dtype=np.float64))
    if not (np.isfinite(u).all() and np.isfinite(v).all()):
        raise InputError("a contact at parameters that are not finite")
    i0, i1, a = _between(lattice.u, lattice.period[0], u)
    j0, j1, b = _between(lattice.v, lattice.period[1], v)
    _, nv, nl = lattice.shape
    nodes = np.stack([(i * nv + j) * nl for i in (i0, i1) for j in (j0, j1)], axis=1)
    weights = np.stack([(1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b], axis=1)
    weights[~lattice.active[nodes]] = 0.0
    total = weights.sum(axis=1)
    for n in np.flatnonzero(total < 1e-12):
        nodes[n], weights[n], total[n] = _nearest_active(lattice, u[n], v[n]), (1.0, 0.0, 0.0, 0.0), 1.0
    return nodes, weights / total[:, None]


def _between(nodes: Array, period: float, t: Array) -> tuple[Index, Index, Array]:
    """Indices of the nodes before and after each t (m,), and how far between them it lies, 0 to 1."""
    ends = nodes
    if period > 0.0:
        ends = np.append(nodes, nodes[0] + period)
        t = nodes[0] + np.mod(t - nodes[0], period)
    i = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, len(ends) - 2)
    share = np.clip((t - ends[i]) / (ends[i + 1] - ends[i]), 0.0, 1.0)
    return i.astype(np.int64), ((i + 1) % len(nodes)).astype(np.int64), share


def _nearest_active(lattice: Lattice, u: float, v: float) -> int:
    """The active surface node nearest to (u, v), both measured in node steps."""
    nu, nv, nl = lattice.shape
    nodes = np.flatnonzero(lattice.active.reshape(nu, nv, nl)[:, :, 0])
    gaps = []
    for t, ends, period, index in ((u, lattice.u, lattice.period[0], nodes // nv), (v, lattice.v, lattice.period[1], nodes % nv)):
        before, _, share = _between(ends, period, np.array([t]))
        gap = np.abs(index - (before[0] + share[0]))
        gaps.append(np.minimum(gap, len(ends) - gap) if period > 0.0 else gap)
    return int(nodes[np.argmin(gaps[0] ** 2 + gaps[1] ** 2)]) * nl


@njit
def contact_pressure(depth: float, rate: float, stiffness: float, damping: float) -> float:
    """The contact law: pressure [N/L^2] at `depth` [L], positive inside, that grows at `rate` [L/s]. Never pulls."""
    return max(0.0, stiffness * depth + damping * rate)


@njit
def local_nodes(nodes: Index, size: int) -> tuple[Index, Index]:
    """The distinct nodes that contacts (n, 4) touch, in order of appearance, and where each contact finds its four there."""
    place = np.full(size, -1, dtype=np.int64)
    distinct = np.empty(nodes.size, dtype=np.int64)
    local = np.empty_like(nodes)
    count = 0
    for c in range(len(nodes)):
        for k in range(4):
            node = nodes[c, k]
            if place[node] < 0:
                place[node] = count
                distinct[count] = node
                count += 1
            local[c, k] = place[node]
    return distinct[:count].copy(), local


@njit
def mean_contact(local: Index, weights: Array, area: Array, vectors: Array, mean: Array) -> None:
    """mean (m, 3) : per node the mean of the contacts' vectors (n, 3), weighted by the area that they bring to it."""
    mean[:, :] = 0.0
    total = np.zeros(len(mean))
    for c in range(len(local)):
        for k in range(4):
            share = weights[c, k] * area[c]
            total[local[c, k]] += share
            for a in range(3):
                mean[local[c, k], a] += share * vectors[c, a]
    for n in range(len(mean)):
        if total[n] > 0.0:
            for a in range(3):
                mean[n, a] /= total[n]


@njit
def press(
    distinct: Index,
    local: Index,
    weights: Array,
    normal: Array,
    area: Array,
    stiffness: Array,
    damping: Array,
    tool: Array,
    depth: Array,
    inverse_mass: Array,
    h: float,
    before: Array,
    velocity: Array,
    inertia: Array,
    push: Array,
    vstar: Array,
    impulse: Array,
) -> None:
    """Normal contact forces of one sub-step, at its end: the nodes' velocities after them, and the impulses (n, 4) [N s].

    distinct (m,), local (n, 4) : from `local_nodes`. depth (n,) : at the start of the sub-step. before, velocity (3, N + 2)
    padded : at the start of the sub-step, and with all other forces applied; the latter is changed. inertia (m, 6) and
    push (m, 3) : workspace.
    """
    for sweep in range(PASSES):
        push[:, :] = 0.0
        inertia[:, :] = 0.0
        for c in range(len(local)):
            nx, ny, nz = normal[c, 0], normal[c, 1], normal[c, 2]
            gain = h * stiffness[c] + damping[c]
            base = stiffness[c] * depth[c] - gain * (tool[c, 0] * nx + tool[c, 1] * ny + tool[c, 2] * nz)
            for k in range(4):
                n = distinct[local[c, k]] + 1
                rate = before[0, n] * nx + before[1, n] * ny + before[2, n] * nz if sweep == 0 else velocity[0, n] * nx + velocity[1, n] * ny + velocity[2, n] * nz
                share = h * area[c] * weights[c, k]
                if base + gain * rate > 0.0:
                    impulse[c, k] = share
                    block = inertia[local[c, k]]
                    g = share * gain
                    block[0] += g * nx * nx
                    block[1] += g * ny * ny
                    block[2] += g * nz * nz
                    block[3] += g * nx * ny
                    block[4] += g * ny * nz
                    block[5] += g * nz * nx
                    push[local[c, k], 0] -= share * base * nx
                    push[local[c, k], 1] -= share * base * ny
                    push[local[c, k], 2] -= share * base * nz
                else:
                    impulse[c, k] = 0.0
        for m in range(len(distinct)):
            n = distinct[m] + 1
            w = inverse_mass[distinct[m]]
            # (m + L) v1 = m velocity + push
            if sweep == 0:
                vstar[m,0] = velocity[0, n]
                vstar[m,1] = velocity[1, n]
                vstar[m,2] = velocity[2, n]
            rx = vstar[m,0] + w * push[m, 0]
            ry = vstar[m,1] + w * push[m, 1]
            rz = vstar[m,2] + w * push[m, 2]
            xx, yy, zz = 1.0 + w * inertia[m, 0], 1.0 + w * inertia[m, 1], 1.0 + w * inertia[m, 2]
            xy, yz, zx = w * inertia[m, 3], w * inertia[m, 4], w * inertia[m, 5]
            cx, cy, cz = yy * zz - yz * yz, yz * zx - xy * zz, xy * yz - yy * zx
            determinant = xx * cx + xy * cy + zx * cz
            velocity[0, n] = (cx * rx + cy * ry + cz * rz) / determinant
            velocity[1, n] = (cy * rx + (xx * zz - zx * zx) * ry + (xy * zx - xx * yz) * rz) / determinant
            velocity[2, n] = (cz * rx + (xy * zx - xx * yz) * ry + (xx * yy - xy * xy) * rz) / determinant
    for c in range(len(local)):
        nx, ny, nz = normal[c, 0], normal[c, 1], normal[c, 2]
        gain = h * stiffness[c] + damping[c]
        base = stiffness[c] * depth[c] - gain * (tool[c, 0] * nx + tool[c, 1] * ny + tool[c, 2] * nz)
        for k in range(4):
            if impulse[c, k] > 0.0:
                n = distinct[local[c, k]] + 1
                rate = velocity[0, n] * nx + velocity[1, n] * ny + velocity[2, n] * nz
                impulse[c, k] *= base + gain * rate


@njit
def rub(
    distinct: Index,
    local: Index,
    weights: Array,
    friction: Array,
    impulse: Array,
    inverse_mass: Array,
    node_normal: Array,
    node_tool: Array,
    velocity: Array,
    capacity: Array,
    slip: Array,
    rubbing: Array,
) -> None:
    """Coulomb friction of one sub-step: stops the slip of every node in contact as far as mu times the normal impulses goes.

    impulse (n,) : of `press`. node_normal, node_tool (m, 3) : mean normal and tool velocity at each node. velocity (3, N + 2)
    padded is changed; rubbing (n, 3) receives the friction impulses of the contacts. capacity (m,), slip (m, 3) : workspace.
    """
    capacity[:] = 0.0
    for c in range(len(local)):
        for k in range(4):
            capacity[local[c, k]] += friction[c] * max(0.0, impulse[c, k])
    for m in range(len(distinct)):
        n = distinct[m] + 1
        w = inverse_mass[distinct[m]]
        along = length = 0.0
        for a in range(3):
            slip[m, a] = velocity[a, n] - node_tool[m, a]
            along += slip[m, a] * node_normal[m, a]
            length += node_normal[m, a] * node_normal[m, a]
        speed = 0.0
        for a in range(3):
            slip[m, a] -= along / length * node_normal[m, a] if length > 0.0 else 0.0
            speed += slip[m, a] * slip[m, a]
        speed = math.sqrt(speed)
        # impulse per unit of capacity and per unit of slip: 1 / speed, or what stops the node
        factor = 0.0
        if capacity[m] > 0.0 and speed > 0.0:
            factor = 1.0 / speed
            if w > 0.0:
                factor = min(factor, 1.0 / (w * capacity[m]))
        for a in range(3):
            slip[m, a] *= -factor
            velocity[a, n] += w * capacity[m] * slip[m, a]
    for c in range(len(local)):
        for a in range(3):
            rubbing[c, a] = 0.0
            for k in range(4):
                rubbing[c, a] += friction[c] * max(0.0, impulse[c, k]) * slip[local[c, k], a]
