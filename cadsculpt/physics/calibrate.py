"""Spring constants of a hexahedral cell from Young's modulus (method: a lattice of real material).

A cell of volume V whose springs s have stiffness k_s, length L_s and direction n_s stores, under any uniform strain, the
energy of the elasticity tensor

    C_abcd = (1 / V) sum_s k_s L_s^2 n_a n_b n_c n_d.

Central springs make C fully symmetric (Cauchy), so the isotropic material that they can be has Poisson's ratio 1/4:
C_1111 = 1.2 E, C_1122 = C_1212 = 0.4 E, the rest 0. The unknowns are the weights w_s = k_s L_s^2 / (V E), one for each of
the 13 directions of springs; parallel springs of a cell share their direction's weight evenly. On a cube the answer is
w = 0.4 for the three edges, 0.8 for the six face diagonals and 0 for the four body diagonals, that is k = 0.4 E a for edges
and face diagonals, shared among neighbouring cells.

On other cells no w >= 0 meets all of C. The cell's weights minimise

    sum_a (E_a / E - 1)^2 + RATIO^2 |C / E - C_isotropic|^2 + BALANCE^2 |w - w_cube|^2,    w >= FLOOR w_cube

(|C| over the 15 independent components): Young's modulus along the cell's three axes first, Poisson's ratio and shear
second; the last term and the lower bound keep every class of springs in play, for a lattice without face diagonals folds
up like a paper bag. E_a is linearised (Gauss-Newton) and each linear problem solved by active sets. Young's modulus
then holds within 0.5 % up to cells of 1:6, while the ratio and the shear stiffness between a long and a short axis fall
with the aspect: central springs cannot do better.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..jit import njit

Array = NDArray[np.float64]

OFFSETS: NDArray[np.int64] = np.array(
    [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
    + [(1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1)]
    + [(1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1)],
    dtype=np.int64,
)  # fmt: skip
"""The 13 spring directions in node steps (u, v, layer): 3 edges, 6 face diagonals, 4 body diagonals."""

CUBE_WEIGHTS: Array = np.array([0.4] * 3 + [0.8] * 6 + [0.0] * 4)
"""w of a cube: 0.4 E a on edges and face diagonals, none on body diagonals."""

RATIO = 0.1
"""Weight of Poisson's ratio and shear against Young's modulus: ten times less."""

BALANCE = 0.02
"""Weight of the preference for the cube's answer: too small to move E by 0.5 %, enough to make the answer unique."""

FLOOR = 0.2
"""No edge and no face diagonal falls below this share of its weight on a cube."""

COMPONENTS: NDArray[np.int64] = np.array(
    [(0, 0, 0, 0), (1, 1, 1, 1), (2, 2, 2, 2), (0, 0, 1, 1), (0, 0, 2, 2), (1, 1, 2, 2)]
    + [(0, 0, 0, 1), (0, 0, 0, 2), (1, 1, 1, 0), (1, 1, 1, 2), (2, 2, 2, 0), (2, 2, 2, 1)]
    + [(0, 0, 1, 2), (1, 1, 0, 2), (2, 2, 0, 1)],
    dtype=np.int64,
)  # fmt: skip
"""The 15 independent components of a fully symmetric fourth-order tensor."""

ISOTROPIC: Array = np.array([1.2] * 3 + [0.4] * 3 + [0.0] * 9)
"""Their values for E = 1 and Poisson's ratio 1/4."""

DEGENERATE = 1e-9
"""A spring shorter than this share of its cell's longest one joins two nodes of one point (the pole of a sphere)."""

def spring_flow(yield_strain: float, hardening: float) -> tuple[float, float]:
    """Yield strain y and hardening g of every spring, so that a bar yields at `yield_strain` and hardens by `hardening`.

    Springs of different directions start to flow one after the other, so the bar's curve has a round knee; what is matched is
    the straight line after it, sigma / E = yield_strain + hardening (e - yield_strain). There, on cubes, all springs along and
    oblique to the load flow, with the tangent g and the offset (1 - g) y, while those across it are still elastic:

        hardening                      = 1.2 g - 0.32 g^2 / (1.2 + 0.4 g)
        (1 - hardening) yield_strain   = (1 - g) y (2 - 0.64 g / (1.2 + 0.4 g)).

    Without hardening y is half the yield strain. A material that hardens by its full modulus never yields.
    """
    if math.isinf(yield_strain) or hardening >= 1.0:
        return math.inf, 0.0
    b = 1.44 - 0.4 * hardening
    g = 2.4 * hardening / (b + math.sqrt(b * b + 0.768 * hardening))
    return (1.0 - hardening) * yield_strain / ((1.0 - g) * (2.0 - 0.64 * g / (1.2 + 0.4 * g))), g


_CORNERS: NDArray[np.int64] = np.array([(a, b, c) for a in (0, 1) for b in (0, 1) for c in (0, 1)], dtype=np.int64)


@njit
def hexahedron_volume(p: Array) -> float:
    """Volume of the trilinear hexahedron with corners p (8, 3), corner (a, b, c) at 4 a + 2 b + c; its sign is that of
    (a, b, c). Exact, with three determinants (Grandy 1997, Efficient computation of volume of hexahedral cells).
    """
    volume = 0.0
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        # differences across the cell: opposite corners of the faces that meet in corner 7 and in corner 0
        a1, b1, c1 = p[7, x] - p[4, x], p[7, y] - p[2, y], p[7, z] - p[1, z]
        b2, c2 = p[7, z] - p[2, z], p[7, y] - p[1, y]
        a3, b3, c3 = p[3, x] - p[0, x], p[5, y] - p[0, y], p[6, z] - p[0, z]
        b4, c4 = p[5, z] - p[0, z], p[6, y] - p[0, y]
        volume += (a1 + a3) * (b1 * c3 - b2 * c4)
        volume += a3 * ((b1 + b3) * c1 - (b2 + b4) * c2)
        volume += a1 * (b3 * (c1 + c3) - b4 * (c2 + c4))
    return volume / 12.0


@njit
def _axes(p: Array, frame: Array) -> None:
    """Orthonormal axes (3, 3), one a row, nearest to the mean edges of the cell: polar factor by Newton's iteration
    R <- (R + R^-T) / 2 (Higham 1986).
    """
    for axis in range(3):
        step = 4 >> axis
        length = 0.0
        for c in range(3):
            edge = 0.0
            for corner in range(8):
                edge += p[corner, c] if corner & step else -p[corner, c]
            frame[axis, c] = edge
            length += edge * edge
        for c in range(3):
            frame[axis, c] /= math.sqrt(length)
    inverse = np.empty((3, 3))
    for _ in range(30):
        _cofactors(frame, inverse)
        determinant = frame[0, 0] * inverse[0, 0] + frame[0, 1] * inverse[0, 1] + frame[0, 2] * inverse[0, 2]
        change = 0.0
        for a in range(3):
            for c in range(3):
                moved = 0.5 * (frame[a, c] + inverse[a, c] / determinant)
                change = max(change, abs(moved - frame[a, c]))
                frame[a, c] = moved
        if change < 1e-12:
            break


@njit
def _cofactors(m: Array, out: Array) -> None:
    """Cofactors of a 3 x 3 matrix: m^-T times its determinant."""
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            out[a, i] = m[b, j] * m[c, k] - m[b, k] * m[c, j]


@njit
def _minimise(hessian: Array, rhs: Array, low: Array, held: NDArray[np.bool_], factor: Array, w: Array) -> None:
    """Minimise w.H.w / 2 - rhs.w over w >= low (H positive definite), from the guess `held` of the bounds that hold.

    Active sets (Hintermueller, Ito, Kunisch 2002): solve for the free unknowns, hold those below their bound, free those that
    pull upwards. Where that does not settle, coordinate descent ends it. factor (13, 13) : workspace.
    """
    size = len(w)
    for _ in range(12):
        _solve_free(hessian, rhs, low, held, factor, w)
        settled = True
        for s in range(size):
            if held[s]:
                gradient = -rhs[s]
                for t in range(size):
                    gradient += hessian[s, t] * w[t]
                if gradient < 0.0:
                    held[s] = False
                    settled = False
            elif w[s] < low[s]:
                held[s] = True
                settled = False
        if settled:
            return
    for s in range(size):
        w[s] = max(w[s], low[s])
    for _ in range(1000):
        change = 0.0
        for s in range(size):
            residual = rhs[s]
            for t in range(size):
                residual -= hessian[s, t] * w[t]
            moved = max(low[s], w[s] + residual / hessian[s, s])
            change = max(change, abs(moved - w[s]))
            w[s] = moved
        if change < 1e-8:
            break


@njit
def _solve_free(hessian: Array, rhs: Array, low: Array, held: NDArray[np.bool_], factor: Array, w: Array) -> None:
    """Cholesky solution of the free unknowns, the others at their bounds (rows and columns of the unit matrix)."""
    size = len(w)
    for s in range(size):
        total = low[s] if held[s] else rhs[s]
        for t in range(size):
            factor[s, t] = hessian[s, t] if not (held[s] or held[t]) else (1.0 if s == t else 0.0)
            if held[t] and not held[s]:
                total -= hessian[s, t] * low[t]
        w[s] = total
    for s in range(size):
        for t in range(s + 1):
            total = factor[s, t]
            for r in range(t):
                total -= factor[s, r] * factor[t, r]
            factor[s, t] = math.sqrt(total) if s == t else total / factor[t, t]
        total = w[s]
        for r in range(s):
            total -= factor[s, r] * w[r]
        w[s] = total / factor[s, s]
    for s in range(size - 1, -1, -1):
        total = w[s]
        for r in range(s + 1, size):
            total -= factor[r, s] * w[r]
        w[s] = total / factor[s, s]


@njit
def _fit(squares: Array, tensor: Array, present: NDArray[np.bool_], w: Array) -> None:
    """The weights w (13,) of one cell.

    squares (13, k, 3) : n_a^2 along the cell's axes of up to k parallel springs. tensor (13, 15) : mean of n n n n.
    """
    normal = np.empty((13, 13))
    hessian = np.empty((13, 13))
    rhs = np.empty(13)
    base = np.empty(13)
    low = np.empty(13)
    young = np.empty((3, 13))
    c = np.empty((3, 3))
    compliance = np.empty((3, 3))
    factor = np.empty((13, 13))
    held = np.empty(13, dtype=np.bool_)
    previous = np.empty(13)
    for s in range(13):
        # a class that the cell does not have (collapsed to a point) stays at nothing
        low[s] = FLOOR * CUBE_WEIGHTS[s] if present[s] else 0.0
        w[s] = CUBE_WEIGHTS[s] if present[s] else 0.0
        held[s] = not present[s]
        previous[s] = w[s]
        base[s] = BALANCE * BALANCE * w[s]
        for t in range(13):
            total = BALANCE * BALANCE if s == t else 0.0
            for m in range(15):
                total += RATIO * RATIO * tensor[s, m] * tensor[t, m]
            normal[s, t] = total
        for m in range(15):
            base[s] += RATIO * RATIO * tensor[s, m] * ISOTROPIC[m]
    for _ in range(12):
        for a in range(3):
            for b in range(3):
                total = 0.0
                for s in range(13):
                    # COMPONENTS holds C_aabb at a + b + 2 for a != b
                    total += w[s] * tensor[s, a if a == b else a + b + 2]
                c[a, b] = total
        _cofactors(c, compliance)
        determinant = c[0, 0] * compliance[0, 0] + c[0, 1] * compliance[0, 1] + c[0, 2] * compliance[0, 2]
        for s in range(13):
            rhs[s] = base[s]
            for t in range(13):
                hessian[s, t] = normal[s, t]
        for a in range(3):
            # unit stress along a gives the strain compliance[a] / determinant; dE_a = E_a^2 strain.dC.strain
            modulus = determinant / compliance[a, a]
            value = 1.0 - modulus
            for s in range(13):
                total = 0.0
                count = 0
                for k in range(squares.shape[1]):
                    strain = 0.0
                    for b in range(3):
                        strain += squares[s, k, b] * compliance[a, b] / compliance[a, a]
                    if squares[s, k, 0] + squares[s, k, 1] + squares[s, k, 2] > 0.0:
                        total += strain * strain
                        count += 1
                young[a, s] = total / count if count > 0 else 0.0
                value += young[a, s] * w[s]
            for s in range(13):
                rhs[s] += young[a, s] * value
                for t in range(13):
                    hessian[s, t] += young[a, s] * young[a, t]
        _minimise(hessian, rhs, low, held, factor, w)
        change = 0.0
        for s in range(13):
            change = max(change, abs(w[s] - previous[s]))
            previous[s] = w[s]
        if change < 1e-6:
            break


@njit
def calibrate_cells(
    nodes: Array,
    shape: tuple[int, int, int],
    wrap: tuple[bool, bool],
    cell_active: NDArray[np.bool_],
    cell_material: NDArray[np.int64],
    modulus: Array,
    density: Array,
    yield_strain: Array,
    hardening: Array,
    drag: Array,
    stiffness: Array,
    spring_yield: Array,
    spring_hardening: Array,
    mass: Array,
    volume: Array,
    gamma: Array,
) -> None:
    """Add every active cell's springs, mass and damping to the lattice's arrays.

    nodes (N, 3) [L]; cell_active (cu, cv, cl), cell_material (cu, cv, cl); per material modulus [N/L^2], density
    [N s^2/L^4], yield_strain (of a spring), hardening, drag [1/s]. Adds to stiffness (13, N) [N/L], mass (N,), volume (N,)
    [L^3], gamma (N,); a spring shared by cells of several materials yields as the weakest of them.
    """
    nu, nv, nl = shape
    index = np.empty(8, dtype=np.int64)
    p = np.empty((8, 3))
    frame = np.empty((3, 3))
    w = np.empty(13)
    squares = np.empty((13, 4, 3))
    tensor = np.empty((13, 15))
    present = np.empty(13, dtype=np.bool_)
    pairs = np.empty((13, 4, 2), dtype=np.int64)
    lengths = np.empty((13, 4))
    n = np.empty(3)
    for i in range(cell_active.shape[0]):
        for j in range(cell_active.shape[1]):
            for k in range(cell_active.shape[2]):
                if not cell_active[i, j, k]:
                    continue
                for corner in range(8):
                    a = (i + _CORNERS[corner, 0]) % nu
                    b = (j + _CORNERS[corner, 1]) % nv
                    index[corner] = (a * nv + b) * nl + k + _CORNERS[corner, 2]
                    for c in range(3):
                        p[corner, c] = nodes[index[corner], c]
                cell_volume = abs(hexahedron_volume(p))
                _axes(p, frame)
                longest = 0.0
                for s in range(13):
                    count = 0
                    for corner in range(8):
                        end = 0
                        inside = True
                        for c in range(3):
                            to = _CORNERS[corner, c] + OFFSETS[s, c]
                            inside = inside and 0 <= to <= 1
                            end = 2 * end + to
                        if inside:
                            pairs[s, count, 0] = corner
                            pairs[s, count, 1] = end
                            length = 0.0
                            for c in range(3):
                                length += (p[end, c] - p[corner, c]) ** 2
                            lengths[s, count] = math.sqrt(length)
                            longest = max(longest, lengths[s, count])
                            count += 1
                    for copy in range(count, 4):
                        pairs[s, copy, 0] = -1
                for s in range(13):
                    count = 0
                    for m in range(15):
                        tensor[s, m] = 0.0
                    for copy in range(4):
                        for a in range(3):
                            squares[s, copy, a] = 0.0
                        if pairs[s, copy, 0] < 0 or lengths[s, copy] <= DEGENERATE * longest:
                            continue
                        count += 1
                        for a in range(3):
                            n[a] = 0.0
                            for c in range(3):
                                n[a] += frame[a, c] * (p[pairs[s, copy, 1], c] - p[pairs[s, copy, 0], c])
                            n[a] /= lengths[s, copy]
                            squares[s, copy, a] = n[a] * n[a]
                        for m in range(15):
                            tensor[s, m] += (
                                n[COMPONENTS[m, 0]] * n[COMPONENTS[m, 1]] * n[COMPONENTS[m, 2]] * n[COMPONENTS[m, 3]]
                            )
                    present[s] = count > 0
                    if count > 0:
                        for m in range(15):
                            tensor[s, m] /= count
                _fit(squares, tensor, present, w)
                material = cell_material[i, j, k]
                for s in range(13):
                    copies = 0
                    for copy in range(4):
                        if pairs[s, copy, 0] >= 0 and lengths[s, copy] > DEGENERATE * longest:
                            copies += 1
                    for copy in range(4):
                        if pairs[s, copy, 0] < 0:
                            continue
                        node = index[pairs[s, copy, 0]]
                        if lengths[s, copy] <= DEGENERATE * longest:
                            # two nodes of one point are tied as firmly as a cube's edge, and never yield
                            stiffness[s, node] += 0.1 * modulus[material] * cell_volume ** (1.0 / 3.0)
                            continue
                        share = w[s] * modulus[material] * cell_volume / (copies * lengths[s, copy] ** 2)
                        stiffness[s, node] += share
                        if share > 0.0 and yield_strain[material] < spring_yield[s, node]:
                            spring_yield[s, node] = yield_strain[material]
                            spring_hardening[s, node] = hardening[material]
                for corner in range(8):
                    node = index[corner]
                    volume[node] += cell_volume / 8.0
                    mass[node] += density[material] * cell_volume / 8.0
                    gamma[node] += drag[material] * density[material] * cell_volume / 8.0
