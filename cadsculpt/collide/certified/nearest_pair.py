"""The closest pair of points of two surfaces, near a start: Newton in both surfaces' parameters at once.

Both points may be free, or held on a straight piece of their (u, v) plane: a chord of a trimmed face's border.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...jit import njit
from ..newton import approach, inside
from ..workspace import Spans

Array = NDArray[np.float64]

STEPS = 60
"""Steps at most; 4 to 8 for a closest pair that is not degenerate, a few more where two surfaces meet in a curve."""


@njit
def nearest_pair(g: Spans, h: Spans, x: Array, chord_a: Array, chord_b: Array, out: Array) -> float:
    """The local closest pair of two patches from the start x (4,) = u, v, u, v; x becomes its parameters, out (2, 3) its
    points, out[2] the speeds |S_u|, |S_v| of the first, out[3] those of the second: (4, 3). Returns the distance.

    chord_a, chord_b (2, 2) : where finite, the ends of a chord in (u, v) that holds the point; x then gives its start
    as the part of the chord (0 to 1) in x[0] or x[2].

    Levenberg and Marquardt's steps with the full Hessian; parameters on a border that the gradient pushes outwards are
    held there.
    """
    most = max(g.degree_u, g.degree_v, h.degree_u, h.degree_v) + 4
    scratch = np.empty((9, most))
    da, db = np.empty((6, 4)), np.empty((6, 4))
    low, high = np.zeros(4), np.ones(4)
    wrap = np.zeros(4, np.bool_)
    fixed = np.zeros(4, np.bool_)
    held_a, held_b = np.isfinite(chord_a[0, 0]), np.isfinite(chord_b[0, 0])
    if held_a:
        fixed[1] = True
    else:
        low[0], high[0], wrap[0] = g.u[0], g.u[len(g.u) - 1], g.wrap_u
        low[1], high[1], wrap[1] = g.v[0], g.v[len(g.v) - 1], g.wrap_v
    if held_b:
        fixed[3] = True
    else:
        low[2], high[2], wrap[2] = h.u[0], h.u[len(h.u) - 1], h.wrap_u
        low[3], high[3], wrap[3] = h.v[0], h.v[len(h.v) - 1], h.wrap_v
    jac = np.zeros((4, 3))
    hess, mat = np.zeros((4, 4)), np.zeros((4, 5))
    grad, trial = np.zeros(4), x.copy()
    held = np.zeros(4, np.bool_)
    slack = g.slack + h.slack
    f = residual(g, h, x, chord_a, chord_b, held_a, held_b, da, db, scratch)
    damping = 1e-3
    for _ in range(STEPS):
        gradient(da, db, chord_a, chord_b, held_a, held_b, jac, hess, grad)
        off = 0.0
        for i in range(4):
            held[i] = fixed[i] or (
                not wrap[i] and ((x[i] <= low[i] and grad[i] > 0.0) or (x[i] >= high[i] and grad[i] < 0.0))
            )
            if not held[i]:
                speed = np.sqrt(jac[i, 0] ** 2 + jac[i, 1] ** 2 + jac[i, 2] ** 2)
                off = max(off, abs(grad[i]) / max(speed, 1e-300))
        if off <= slack or f <= slack * slack:
            break
        moved = False
        while damping < 1e12:
            # (H + damping diag(J J^T)) step = -grad over what is not held, by elimination
            for i in range(4):
                for j in range(4):
                    mat[i, j] = 0.0 if held[i] or held[j] else hess[i, j]
                speed2 = jac[i, 0] ** 2 + jac[i, 1] ** 2 + jac[i, 2] ** 2
                mat[i, i] += 1.0 if held[i] else damping * speed2 + 1e-300
                mat[i, 4] = 0.0 if held[i] else -grad[i]
            if solved(mat):
                step = 0.0
                for i in range(4):
                    trial[i] = inside(x[i] + mat[i, 4], low[i], high[i], wrap[i])
                    speed = np.sqrt(jac[i, 0] ** 2 + jac[i, 1] ** 2 + jac[i, 2] ** 2)
                    step = max(step, speed * abs(mat[i, 4]))
                fn = residual(g, h, trial, chord_a, chord_b, held_a, held_b, da, db, scratch)
                if fn < f:
                    moved = True
                    break
                if step <= slack:
                    break
            damping *= 10.0
        if not moved:
            break
        for i in range(4):
            x[i] = trial[i]
        f = fn
        damping = max(0.1 * damping, 1e-12)
    f = residual(g, h, x, chord_a, chord_b, held_a, held_b, da, db, scratch)
    for c in range(3):
        out[0, c], out[1, c] = da[0, c], db[0, c]
    for k in range(2):
        out[2, k] = np.sqrt(da[1 + k, 0] ** 2 + da[1 + k, 1] ** 2 + da[1 + k, 2] ** 2)
        out[3, k] = np.sqrt(db[1 + k, 0] ** 2 + db[1 + k, 1] ** 2 + db[1 + k, 2] ** 2)
    if held_a:
        w = x[0]
        x[0], x[1] = (
            chord_a[0, 0] + w * (chord_a[1, 0] - chord_a[0, 0]),
            chord_a[0, 1] + w * (chord_a[1, 1] - chord_a[0, 1]),
        )
    if held_b:
        w = x[2]
        x[2], x[3] = (
            chord_b[0, 0] + w * (chord_b[1, 0] - chord_b[0, 0]),
            chord_b[0, 1] + w * (chord_b[1, 1] - chord_b[0, 1]),
        )
    return float(np.sqrt(f))


@njit
def residual(
    g: Spans, h: Spans, x: Array, chord_a: Array, chord_b: Array, held_a: bool, held_b: bool, da: Array, db: Array,
    scratch: Array,
) -> float:  # fmt: skip
    """Derivatives of both surfaces at x into da, db (6, 4) (`newton.approach`), and the squared distance of the points."""
    u, v = x[0], x[1]
    if held_a:
        u = chord_a[0, 0] + x[0] * (chord_a[1, 0] - chord_a[0, 0])
        v = chord_a[0, 1] + x[0] * (chord_a[1, 1] - chord_a[0, 1])
    approach(g.net, g.knots_u, g.knots_v, g.degree_u, g.degree_v, g.rational, u, v, 0.0, 0.0, 0.0, da, scratch)
    u, v = x[2], x[3]
    if held_b:
        u = chord_b[0, 0] + x[2] * (chord_b[1, 0] - chord_b[0, 0])
        v = chord_b[0, 1] + x[2] * (chord_b[1, 1] - chord_b[0, 1])
    return approach(
        h.net, h.knots_u, h.knots_v, h.degree_u, h.degree_v, h.rational, u, v, da[0, 0], da[0, 1], da[0, 2], db, scratch
    )


@njit
def gradient(
    da: Array, db: Array, chord_a: Array, chord_b: Array, held_a: bool, held_b: bool, jac: Array, hess: Array,
    grad: Array,
) -> None:  # fmt: skip
    """Rows of the Jacobian of A - B (4, 3), gradient (4,) and Hessian (4, 4) of half the squared distance."""
    for i in range(4):
        for j in range(4):
            hess[i, j] = 0.0
    for side in range(2):
        d = da if side == 0 else db
        chord = chord_a if side == 0 else chord_b
        sign = 1.0 if side == 0 else -1.0
        held = held_a if side == 0 else held_b
        o = 2 * side
        du, dv = chord[1, 0] - chord[0, 0], chord[1, 1] - chord[0, 1]
        for c in range(3):
            r = da[0, c] - db[0, c]
            if held:
                jac[o, c], jac[o + 1, c] = sign * (du * d[1, c] + dv * d[2, c]), 0.0
                hess[o, o] += sign * r * (du * du * d[3, c] + 2.0 * du * dv * d[4, c] + dv * dv * d[5, c])
            else:
                jac[o, c], jac[o + 1, c] = sign * d[1, c], sign * d[2, c]
                hess[o, o] += sign * r * d[3, c]
                hess[o, o + 1] += sign * r * d[4, c]
                hess[o + 1, o + 1] += sign * r * d[5, c]
        hess[o + 1, o] = hess[o, o + 1]
    for i in range(4):
        grad[i] = 0.0
        for c in range(3):
            grad[i] += jac[i, c] * (da[0, c] - db[0, c])
        for j in range(4):
            for c in range(3):
                hess[i, j] += jac[i, c] * jac[j, c]


@njit
def solved(mat: Array) -> bool:
    """Solve the symmetric system mat[:, :4] x = mat[:, 4] in place, x into mat[:, 4]; False where it is not positive
    definite."""
    for i in range(4):
        pivot = mat[i, i]
        if not pivot > 0.0:
            return False
        for j in range(i + 1, 4):
            e = mat[j, i] / pivot
            for c in range(i, 5):
                mat[j, c] -= e * mat[i, c]
    for i in range(3, -1, -1):
        for j in range(i + 1, 4):
            mat[i, 4] -= mat[i, j] * mat[j, 4]
        mat[i, 4] /= mat[i, i]
    return True
