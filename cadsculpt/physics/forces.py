"""Contact forces and their way to the nodes (paper section 4.8, fig. 6).

A contact that stands for the area A of the surface, d deep in a tool that moves against it at the rate d', presses with

    p = A max(0, k_n d + c_n d')                                    along the inward normal, and rubs with
    |f| <= mu p                                                     against the slip (Coulomb).

k_n [N/L^3] and c_n [N s/L^3] are per area, so that the force does not depend on how finely the surface is sampled.
The force goes to the four nodes around (u, v) with bilinear weights.

Within a sub-step of h seconds the pressure is that at the sub-step's end, so that neither a stiff contact nor a small
slip shortens it. Each node feels the contact with its own velocity v_i,

    p_ci = max(0, k_n (d_c + h n.(v_i - v_tool)) + c_n n.(v_i - v_tool)),    F_i = - sum_c w_ci A_c p_ci n_c,

so that the nodes decouple: 3 x 3 equations (m_i + L_i) v_i = ..., L_i = sum h w A (h k_n + c_n) n n, after which the
depth d_c follows the interpolated velocity. Once the nodes are at rest that is the contact law above, to the letter;
in motion it is stable for any k_n and c_n, because L, with the weights lumped, is at least what the weights would
give. A contact's force is the sum of what it gave to its four nodes, so that forces on both sides balance. Friction
then stops the slip of each node in contact as far as mu times its pressure goes: Coulomb's law itself, with no slip
speed to regularise it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..jit import njit_in_place
from .lattice import Lattice, grid_shape
from .material import Material

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STIFFNESS_RATIO = 100.0
"""k_n over E / spacing: a dent one node spacing wide is 100 times stiffer to the contact than to the material, so
that the residual penetration is about 1 % of the narrowest dents' depth and far less of wide ones'."""

MOST_CORRECTIONS = 8
"""Corrections, per sub-step, of which parts of the contacts press: Newton's method on a convex function, done in two
or three."""

DAMPING_RATIO = 0.5
"""c_n as a fraction of critical for the contact's own spring under half a cell's mass: a tool that lands does not
bounce."""


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

    Around the seam in closed directions; outside the grid, those of its border. Nodes in no cell get weight 0 and the
    others share it; where all four are in no cell, the nearest surface node that is in one gets all. Raises
    InputError for (u, v) that are not finite, and for an assembly, which has no grid.
    """
    u, v = np.array(u, dtype=np.float64, ndmin=1), np.array(v, dtype=np.float64, ndmin=1)
    nodes, weights = np.empty((len(u), 4), np.int64), np.empty((len(u), 4))
    fill_node_weights(lattice, u, v, nodes, weights)
    return nodes, weights


def fill_node_weights(lattice: Lattice, u: Array, v: Array, nodes: Index, weights: Array) -> None:
    """The nodes and weights of `node_weights` into arrays (n, 4)."""
    _, nv, nl = grid_shape(lattice)
    lost = spread_weights(lattice.u, lattice.v, lattice.period, nv, nl, lattice.active, u, v, nodes, weights)
    if lost < 0:
        raise InputError("a contact at parameters that are not finite")
    for n in np.flatnonzero(nodes[:, 0] < 0) if lost else ():
        nodes[n], weights[n] = _nearest_active(lattice, u[n], v[n]), (1.0, 0.0, 0.0, 0.0)


def cells_around(lattice: Lattice, u: Array, v: Array) -> tuple[Index, Index]:
    """The cells (i, j) that (u, v) (n,) lie in, each (n,); those at the border for what lies outside the grid."""
    i, j = np.empty(len(u), np.int64), np.empty(len(v), np.int64)
    fill_cells(lattice.u, lattice.v, lattice.period, u, v, i, j)
    return i, j


@njit_in_place
def fill_cells(
    nodes_u: Array, nodes_v: Array, period: tuple[float, float], u: Array, v: Array, i: Index, j: Index
) -> None:
    """The cells of `cells_around` into i, j (n,)."""
    for c in range(len(u)):
        i[c], j[c] = _between(nodes_u, period[0], u[c])[0], _between(nodes_v, period[1], v[c])[0]


@njit_in_place
def spread_weights(
    nodes_u: Array, nodes_v: Array, period: tuple[float, float], nv: int, nl: int, active: NDArray[np.bool_],
    u: Array, v: Array, nodes: Index, weights: Array,
) -> int:  # fmt: skip
    """Nodes and weights of the places with an active node around them; the others get node -1, and are counted. -1 for a
    place that is not finite."""
    lost = 0
    for c in range(len(u)):
        if not (np.isfinite(u[c]) and np.isfinite(v[c])):
            return -1
        i0, i1, a = _between(nodes_u, period[0], u[c])
        j0, j1, b = _between(nodes_v, period[1], v[c])
        total = 0.0
        for k in range(4):
            i, s = (i0, 1.0 - a) if k < 2 else (i1, a)
            j, t = (j0, 1.0 - b) if k % 2 == 0 else (j1, b)
            nodes[c, k] = (i * nv + j) * nl
            weights[c, k] = s * t if active[nodes[c, k]] else 0.0
            total += weights[c, k]
        if total < 1e-12:
            nodes[c, 0] = -1
            lost += 1
            continue
        for k in range(4):
            weights[c, k] /= total
    return lost


@njit_in_place
def _between(nodes: Array, period: float, t: float) -> tuple[int, int, float]:
    """Indices of the nodes before and after t, and how far between them it lies, 0 to 1."""
    count = len(nodes)
    if period > 0.0:
        t = nodes[0] + (t - nodes[0]) % period
    low, high = 0, count if period > 0.0 else count - 1
    while high - low > 1:
        middle = (low + high) // 2
        if nodes[middle] <= t:
            low = middle
        else:
            high = middle
    end = nodes[low + 1] if low + 1 < count else nodes[0] + period
    return low, (low + 1) % count, min(max((t - nodes[low]) / (end - nodes[low]), 0.0), 1.0)


def _nearest_active(lattice: Lattice, u: float, v: float) -> int:
    """The active surface node nearest to (u, v), both measured in node steps."""
    nu, nv, nl = lattice.shape
    nodes = np.flatnonzero(lattice.active.reshape(nu, nv, nl)[:, :, 0])
    gaps = []
    for t, ends, period, index in (
        (u, lattice.u, lattice.period[0], nodes // nv),
        (v, lattice.v, lattice.period[1], nodes % nv),
    ):
        before, _, share = _between(ends, period, t)
        gap = np.abs(index - (before + share))
        gaps.append(np.minimum(gap, len(ends) - gap) if period > 0.0 else gap)
    return int(nodes[np.argmin(gaps[0] ** 2 + gaps[1] ** 2)]) * nl


@njit_in_place
def local_nodes(nodes: Index, place: Index, distinct: Index, local: Index) -> int:
    """The number of distinct nodes that contacts (n, 4) touch, in order of appearance in distinct (>= 4 n,), and where each
    contact finds its four there, local (>= n, 4). place (N,) : -1, and left so.
    """
    count = 0
    for c in range(len(nodes)):
        for k in range(4):
            node = nodes[c, k]
            if place[node] < 0:
                place[node] = count
                distinct[count] = node
                count += 1
            local[c, k] = place[node]
    for m in range(count):
        place[distinct[m]] = -1
    return count


@njit_in_place
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
    nodal: Array,
    marks: NDArray[np.bool_],
    impulse: Array,
) -> None:
    """Normal contact forces at the end of a sub-step of h seconds: the nodes' velocities after them, and the impulses.

    distinct (m,), local (n, 4) : from `local_nodes`. depth (n,) : at the start of the sub-step. before, velocity :
    (3, N + 2) padded, at the start of the sub-step, and with all other forces applied; the latter is changed.
    impulse (n, 4) [N s] is filled. nodal (m, 12), marks (n, 4) : workspace.
    """
    for m in range(len(distinct)):
        for a in range(3):
            nodal[m, 9 + a] = velocity[a, distinct[m] + 1]
    # the parts that press are first judged by the velocity before, then by those that come out, until nothing changes
    _mark(distinct, local, weights, normal, area, stiffness, damping, tool, depth, h, before, nodal, marks)
    for correction in range(MOST_CORRECTIONS + 1):
        _solve_nodes(distinct, inverse_mass, nodal, velocity)
        last = correction == MOST_CORRECTIONS
        if _settle(
            distinct, local, weights, normal, area, stiffness, damping, tool, depth, h, velocity, last, nodal, marks,
            impulse,
        ):  # fmt: skip
            break


@njit_in_place
def _mark(
    distinct: Index,
    local: Index,
    weights: Array,
    normal: Array,
    area: Array,
    stiffness: Array,
    damping: Array,
    tool: Array,
    depth: Array,
    h: float,
    velocity: Array,
    nodal: Array,
    marks: NDArray[np.bool_],
) -> None:
    """Mark the parts that press at `velocity`, and sum up L and b of theirs."""
    nodal[:, :9] = 0.0
    for c in range(len(local)):
        nx, ny, nz = normal[c, 0], normal[c, 1], normal[c, 2]
        slope = h * stiffness[c] + damping[c]
        # the pressure at the sub-step's end where the node stands still
        still = stiffness[c] * depth[c] - slope * (tool[c, 0] * nx + tool[c, 1] * ny + tool[c, 2] * nz)
        for k in range(4):
            n = distinct[local[c, k]] + 1
            marks[c, k] = still + slope * (velocity[0, n] * nx + velocity[1, n] * ny + velocity[2, n] * nz) > 0.0
            if marks[c, k]:
                _add_part(nodal, local[c, k], h * area[c] * weights[c, k], slope, still, nx, ny, nz)


@njit_in_place
def _settle(
    distinct: Index,
    local: Index,
    weights: Array,
    normal: Array,
    area: Array,
    stiffness: Array,
    damping: Array,
    tool: Array,
    depth: Array,
    h: float,
    velocity: Array,
    last: bool,
    nodal: Array,
    marks: NDArray[np.bool_],
    impulse: Array,
) -> bool:
    """Impulses (n, 4) of the marked parts at `velocity`; whether the right ones are marked.

    Those that are not are corrected, in marks, L and b, unless this is the `last` time.
    """
    settled = True
    for c in range(len(local)):
        nx, ny, nz = normal[c, 0], normal[c, 1], normal[c, 2]
        slope = h * stiffness[c] + damping[c]
        still = stiffness[c] * depth[c] - slope * (tool[c, 0] * nx + tool[c, 1] * ny + tool[c, 2] * nz)
        for k in range(4):
            n = distinct[local[c, k]] + 1
            share = h * area[c] * weights[c, k]
            pressure = still + slope * (velocity[0, n] * nx + velocity[1, n] * ny + velocity[2, n] * nz)
            impulse[c, k] = share * pressure if marks[c, k] else 0.0
            if not last and (pressure > 0.0) != marks[c, k]:
                settled = False
                marks[c, k] = not marks[c, k]
                _add_part(nodal, local[c, k], share if marks[c, k] else -share, slope, still, nx, ny, nz)
    return settled


@njit_in_place
def _add_part(nodal: Array, m: int, share: float, slope: float, still: float, nx: float, ny: float, nz: float) -> None:
    """Add share * slope * n n to L and -share * still * n to b of one node."""
    gx, gy, gz = share * slope * nx, share * slope * ny, share * slope * nz
    nodal[m, 0] += gx * nx
    nodal[m, 1] += gy * ny
    nodal[m, 2] += gz * nz
    nodal[m, 3] += gx * ny
    nodal[m, 4] += gy * nz
    nodal[m, 5] += gz * nx
    nodal[m, 6] -= share * still * nx
    nodal[m, 7] -= share * still * ny
    nodal[m, 8] -= share * still * nz


@njit_in_place
def _solve_nodes(distinct: Index, inverse_mass: Array, nodal: Array, velocity: Array) -> None:
    """(m + L) v = m v_free + b at every node by Cramer's rule; the matrix over m has no eigenvalue below 1."""
    for m in range(len(distinct)):
        n = distinct[m] + 1
        w = inverse_mass[distinct[m]]
        rx, ry, rz = nodal[m, 9] + w * nodal[m, 6], nodal[m, 10] + w * nodal[m, 7], nodal[m, 11] + w * nodal[m, 8]
        xx, yy, zz = 1.0 + w * nodal[m, 0], 1.0 + w * nodal[m, 1], 1.0 + w * nodal[m, 2]
        xy, yz, zx = w * nodal[m, 3], w * nodal[m, 4], w * nodal[m, 5]
        ax, ay, az = yy * zz - yz * yz, yz * zx - xy * zz, xy * yz - yy * zx
        bz = xy * zx - xx * yz
        determinant = xx * ax + xy * ay + zx * az
        velocity[0, n] = (ax * rx + ay * ry + az * rz) / determinant
        velocity[1, n] = (ay * rx + (xx * zz - zx * zx) * ry + bz * rz) / determinant
        velocity[2, n] = (az * rx + bz * ry + (xx * yy - xy * xy) * rz) / determinant


@njit_in_place
def rub(
    distinct: Index,
    local: Index,
    normal: Array,
    tool: Array,
    friction: Array,
    inverse_mass: Array,
    impulse: Array,
    velocity: Array,
    nodal: Array,
    rubbing: Array,
) -> None:
    """Coulomb friction of one sub-step: stops the slip of every node in contact as far as mu times its normal
    impulses goes.

    impulse (n, 4) : of `press`. velocity (3, N + 2) padded is changed; rubbing (n, 3) receives the contacts' friction
    impulses [N s]. nodal (m, 12) : workspace.
    """
    nodal[:, :7] = 0.0
    for c in range(len(local)):
        for k in range(4):
            limit = friction[c] * max(0.0, impulse[c, k])
            if limit == 0.0:
                continue
            m = local[c, k]
            nodal[m, 0] += limit
            for a in range(3):
                nodal[m, 1 + a] += limit * tool[c, a]
                nodal[m, 4 + a] += limit * normal[c, a]
    for m in range(len(distinct)):
        # where nothing presses there is no limit, and no friction
        limit = nodal[m, 0]
        if limit == 0.0:
            continue
        n = distinct[m] + 1
        w = inverse_mass[distinct[m]]
        along = length = 0.0
        for a in range(3):
            nodal[m, 1 + a] = velocity[a, n] - nodal[m, 1 + a] / limit
            along += nodal[m, 1 + a] * nodal[m, 4 + a]
            length += nodal[m, 4 + a] * nodal[m, 4 + a]
        speed = 0.0
        for a in range(3):
            nodal[m, 1 + a] -= along / length * nodal[m, 4 + a] if length > 0.0 else 0.0
            speed += nodal[m, 1 + a] * nodal[m, 1 + a]
        speed = math.sqrt(speed)
        # friction over its limit, per unit of slip: 1 / speed while the node slips, what stops it while it sticks
        factor = 0.0 if speed == 0.0 else (1.0 / speed if speed > w * limit else 1.0 / (w * limit))
        for a in range(3):
            nodal[m, 1 + a] *= -factor
            velocity[a, n] += w * limit * nodal[m, 1 + a]
    for c in range(len(local)):
        for a in range(3):
            rubbing[c, a] = 0.0
            for k in range(4):
                rubbing[c, a] += friction[c] * max(0.0, impulse[c, k]) * nodal[local[c, k], 1 + a]
