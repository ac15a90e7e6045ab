"""Spring constants of a hexahedral cell from Young's modulus (method: a lattice of real material).

A cell of volume V whose springs s have stiffness k_s, length L_s and direction n_s stores, under any uniform strain,
the energy of the elasticity tensor

    C_abcd = (1 / V) sum_s k_s L_s^2 n_a n_b n_c n_d.

Central springs make C fully symmetric (Cauchy), so the isotropic material that they can be has Poisson's ratio 1/4:
C_1111 = 1.2 E, C_1122 = C_1212 = 0.4 E, the rest 0. The unknowns are the weights w_s = k_s L_s^2 / (V E), one for
each of the 13 directions of springs; parallel springs of a cell share their direction's weight evenly. On a cube the
answer is w = 0.4 for the three edges, 0.8 for the six face diagonals and 0 for the four body diagonals, that is k =
0.4 E a for edges and face diagonals, shared among neighbouring cells.

On other cells no w >= 0 meets all of C. The cell's weights minimise

    sum_a (E_a / E - 1)^2 + RATIO^2 |C / E - C_isotropic|^2 + BALANCE^2 |w - w_cube|^2,    w >= FLOOR w_cube

(|C| over the 15 independent components): Young's modulus along the cell's three axes first, Poisson's ratio and shear
second; the last term and the lower bound keep every class of springs in play, for a lattice without face diagonals
folds up like a paper bag. E_a is linearised (Gauss-Newton) and each linear problem solved by active sets. Young's
modulus then holds within 0.5 % up to cells of 1:6, while the ratio and the shear stiffness between a long and a short
axis fall with the aspect: central springs cannot do better.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..jit import njit

Array = NDArray[np.float64]

OFFSETS: NDArray[np.int64] = np.array(
    [
        (1, 0, 0), (0, 1, 0), (0, 0, 1),
        (1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1),
        (1, 1, 1), (1, 1, -1), (1, -1, 1), (1, -1, -1),
    ],
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
    [
        (0, 0, 0, 0), (1, 1, 1, 1), (2, 2, 2, 2), (0, 0, 1, 1), (0, 0, 2, 2), (1, 1, 2, 2),
        (0, 0, 0, 1), (0, 0, 0, 2), (1, 1, 1, 0), (1, 1, 1, 2), (2, 2, 2, 0), (2, 2, 2, 1),
        (0, 0, 1, 2), (1, 1, 0, 2), (2, 2, 0, 1),
    ],
    dtype=np.int64,
)  # fmt: skip
"""The 15 independent components of a fully symmetric fourth-order tensor."""

ISOTROPIC: Array = np.array([1.2] * 3 + [0.4] * 3 + [0.0] * 9)
"""Their values for E = 1 and Poisson's ratio 1/4."""


def spring_flow(yield_strain: float, hardening: float) -> tuple[float, float]:
    """Yield strain y and hardening g of every spring, so that a bar yields at `yield_strain` and hardens by
    `hardening`.

    Springs of different directions start to flow one after the other, so the bar's curve has a round knee; what is
    matched is the straight line after it, sigma / E = yield_strain + hardening (e - yield_strain). There, on cubes,
    all springs along and oblique to the load flow, with the tangent g and the offset (1 - g) y, while those across it
    are still elastic:

        hardening                      = 1.2 g - 0.32 g^2 / (1.2 + 0.4 g)
        (1 - hardening) yield_strain   = (1 - g) y (2 - 0.64 g / (1.2 + 0.4 g)).

    Without hardening y is half the yield strain. A material that hardens by its full modulus never yields.
    """
    if math.isinf(yield_strain) or hardening >= 1.0:
        return math.inf, 0.0
    b = 1.44 - 0.4 * hardening
    g = 2.4 * hardening / (b + math.sqrt(b * b + 0.768 * hardening))
    return (1.0 - hardening) * yield_strain / ((1.0 - g) * (2.0 - 0.64 * g / (1.2 + 0.4 * g))), g


@njit
def cofactors(m: Array, out: Array) -> None:
    """Cofactors of a 3 x 3 matrix: m^-T times its determinant."""
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            out[a, i] = m[b, j] * m[c, k] - m[b, k] * m[c, j]


@njit
def _minimise(hessian: Array, rhs: Array, low: Array, held: NDArray[np.bool_], factor: Array, w: Array) -> None:
    """Minimise w.H.w / 2 - rhs.w over w >= low (H positive definite), from the guess `held` of the bounds that hold.

    Active sets (Hintermueller, Ito, Kunisch 2002): solve for the free unknowns, hold those below their bound, free
    those that pull upwards. Where that does not settle, coordinate descent ends it. factor (13, 13) : workspace.
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
def fit_weights(squares: Array, tensor: Array, present: NDArray[np.bool_], w: Array) -> None:
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
        cofactors(c, compliance)
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
