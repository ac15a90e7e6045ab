"""The closest point of a surface to a point, near a start: Newton in (u, v)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..jit import njit_in_place
from ..spline.basis import find_span

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PROPER, BORDER = 1, 2
"""What `newton` found: a point where the surface is orthogonal to the connecting line (or a crease, or a pole); a
point on an open border that the connecting line does not meet orthogonally."""

DISTANCE, POINT, NORMAL, U, V = 0, 1, 4, 7, 8
"""Places in a result (9,); POINT and NORMAL (S_u x S_v, unit) are three each."""

ROUGH = 0.1
"""Angle between connecting line and normal at which a point that is clearly outside is told apart well enough; its
distance is then given as the normal's part of the connecting line, which is less than one percent short."""

TAYLOR = 1e-6
"""A last step below this part of a knot span is not evaluated again: what it leaves out is its cube."""

NEWTON_STEPS = 32
"""Newton takes 3 to 6 steps from a neighbouring grid point; creases of the surface stop it and go to `compass`."""

SPOKES = 32
"""Directions out of a pole that are tried for one that leads nearer."""


@njit_in_place
def newton(
    net: Array, knots_u: Array, knots_v: Array, p: int, q: int, rational: bool, wrap_u: bool, wrap_v: bool, poles: int,
    slack: float, beyond: float, x: float, y: float, z: float, found: Array, h: Array,
    scratch: Array, frames: Array, terms: Array, stamp: Index, tick: int,
) -> int:  # fmt: skip
    """The local closest point to (x, y, z) from the start (u, v) in found[U], found[V]; fills `found`, returns its
    kind.

    h (6, 4), scratch (9, >= max(p, q) + 4) : to work in; frames, terms, stamp, tick : of `polynomial`.
    Positive or negative `beyond`: points farther than this on the side of +- S_u x S_v need no exact answer.

    Newton on |S - x|^2 / 2 with the full Hessian where it is positive, else Gauss and Newton's, halved until the
    distance falls; parameters on a border that the gradient pushes outwards are held there.
    """
    u0, u1 = knots_u[p], knots_u[len(knots_u) - p - 1]
    v0, v1 = knots_v[q], knots_v[len(knots_v) - q - 1]
    u, v = found[U], found[V]
    tolerance = 4.0 * slack
    f = polynomial(net, knots_u, knots_v, p, q, rational, scratch, frames, terms, stamp, tick, u, v, x, y, z, h)
    converged, open_border, left = False, False, 0
    # pieces per parameter: the third derivatives over a step of this relative size are below rounding
    span_u, span_v = (net.shape[0] - p) * p / (u1 - u0), (net.shape[1] - q) * q / (v1 - v0)
    for _ in range(NEWTON_STEPS):
        rx, ry, rz = h[0, 0] - x, h[0, 1] - y, h[0, 2] - z
        gu = rx * h[1, 0] + ry * h[1, 1] + rz * h[1, 2]
        gv = rx * h[2, 0] + ry * h[2, 1] + rz * h[2, 2]
        uu = h[1, 0] * h[1, 0] + h[1, 1] * h[1, 1] + h[1, 2] * h[1, 2]
        uv = h[1, 0] * h[2, 0] + h[1, 1] * h[2, 1] + h[1, 2] * h[2, 2]
        vv = h[2, 0] * h[2, 0] + h[2, 1] * h[2, 1] + h[2, 2] * h[2, 2]
        held_u = not wrap_u and ((u <= u0 and gu > 0.0) or (u >= u1 and gu < 0.0))
        held_v = not wrap_v and ((v <= v0 and gv > 0.0) or (v >= v1 and gv < 0.0))
        # tangential parts of the connecting line, as lengths
        off_u, off_v = abs(gu) / np.sqrt(max(uu, 1e-300)), abs(gv) / np.sqrt(max(vv, 1e-300))
        oblique = 1e-6 * np.sqrt(f) + tolerance
        open_border = (held_u and off_u > oblique and not poles & (1 if u <= u0 else 2)) or (
            held_v and off_v > oblique and not poles & (4 if v <= v0 else 8)
        )
        if (held_u or off_u <= tolerance) and (held_v or off_v <= tolerance):
            if left < 2 and poles != 0 and (u <= u0 or u >= u1 or v <= v0 or v >= v1):
                # at rest at a pole: in this direction only, perhaps
                left += 1
                un, vn = off_pole(
                    net,
                    knots_u,
                    knots_v,
                    p,
                    q,
                    rational,
                    poles,
                    u,
                    v,
                    f,
                    x,
                    y,
                    z,
                    h,
                    scratch,
                    frames,
                    terms,
                    stamp,
                    tick,
                )
                fn = polynomial(
                    net, knots_u, knots_v, p, q, rational, scratch, frames, terms, stamp, tick, un, vn, x, y, z, h
                )
                if fn < f:
                    u, v, f = un, vn, fn
                    continue
            converged = True
            break
        # (near a pole one tangent is rounding, and so would be the side)
        length_u, length_v = uu * (u1 - u0) ** 2, vv * (v1 - v0) ** 2
        regular = length_u > 1e-8 * length_v and length_v > 1e-8 * length_u
        if regular and f > beyond * beyond and off_u * off_u + off_v * off_v < ROUGH * ROUGH * f:
            nx, ny, nz = cross(h)
            if (rx * nx + ry * ny + rz * nz) * beyond < 0.0:
                f -= off_u * off_u + off_v * off_v
                converged = True
                break
        a = uu + rx * h[3, 0] + ry * h[3, 1] + rz * h[3, 2]
        b = uv + rx * h[4, 0] + ry * h[4, 1] + rz * h[4, 2]
        c = vv + rx * h[5, 0] + ry * h[5, 1] + rz * h[5, 2]
        if not (a > 1e-6 * uu and c > 1e-6 * vv and a * c - b * b > 1e-6 * a * c):
            a, b, c = uu, uv, vv
        det = a * c - b * b
        du, dv = 0.0, 0.0
        if not (held_u or held_v) and det > 1e-12 * a * c:
            du, dv = (b * gv - c * gu) / det, (b * gu - a * gv) / det
            # a step that leaves at a border where it already is: along the border instead
            if not wrap_u and ((u <= u0 and du < 0.0) or (u >= u1 and du > 0.0)):
                held_u = True
            elif not wrap_v and ((v <= v0 and dv < 0.0) or (v >= v1 and dv > 0.0)):
                held_v = True
        else:
            du, dv = -gu / max(a, 1e-300), -gv / max(c, 1e-300)
        if held_u:
            du, dv = 0.0, -gv / max(c, 1e-300)
        if held_v:
            du, dv = (0.0 if held_u else -gu / max(a, 1e-300)), 0.0
        if abs(du) * span_u <= TAYLOR and abs(dv) * span_v <= TAYLOR and rests_inside(u, du, v, dv, u0, u1, v0, v1):
            # so near that the third derivatives do not matter: the surface there by Taylor's formula
            u, v, f = u + du, v + dv, 0.0
            for k in range(3):
                h[0, k] += (
                    h[1, k] * du + h[2, k] * dv + 0.5 * (h[3, k] * du * du + h[5, k] * dv * dv) + h[4, k] * du * dv
                )
                h[1, k] += h[3, k] * du + h[4, k] * dv
                h[2, k] += h[4, k] * du + h[5, k] * dv
                f += (h[0, k] - (x if k == 0 else (y if k == 1 else z))) ** 2
            converged = True
            break
        noise = 2.0 * slack * np.sqrt(f) + slack * slack
        step, better = 1.0, False
        while step > 1e-9:
            un, vn = inside(u + step * du, u0, u1, wrap_u), inside(v + step * dv, v0, v1, wrap_v)
            fn = polynomial(
                net, knots_u, knots_v, p, q, rational, scratch, frames, terms, stamp, tick, un, vn, x, y, z, h
            )
            if fn <= f + noise:
                better = True
                break
            step *= 0.5
        if not better:
            break
        small = abs(du) * np.sqrt(uu) <= tolerance and abs(dv) * np.sqrt(vv) <= tolerance
        u, v, f = un, vn, fn
        if small:
            converged = True
            break
    if not converged:
        u, v = compass(
            net, knots_u, knots_v, p, q, rational, wrap_u, wrap_v, tolerance, u, v, x, y, z, h, scratch, frames, terms, stamp,
            tick,
        )  # fmt: skip
        f = polynomial(net, knots_u, knots_v, p, q, rational, scratch, frames, terms, stamp, tick, u, v, x, y, z, h)
    found[DISTANCE], found[U], found[V] = np.sqrt(f), u, v
    for k in range(3):
        found[POINT + k] = h[0, k]
    # the normal; at a pole, that of a point a little inside
    for attempt in range(3):
        nx, ny, nz = cross(h)
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        uu = h[1, 0] * h[1, 0] + h[1, 1] * h[1, 1] + h[1, 2] * h[1, 2]
        vv = h[2, 0] * h[2, 0] + h[2, 1] * h[2, 1] + h[2, 2] * h[2, 2]
        if length > 1e-9 * (uu * (u1 - u0) / (v1 - v0) + vv * (v1 - v0) / (u1 - u0)):
            break
        nudge = 1e-6 if attempt == 0 else 1e-3
        un, vn = u + nudge * (0.5 * (u0 + u1) - u), v + nudge * (0.5 * (v0 + v1) - v)
        polynomial(net, knots_u, knots_v, p, q, rational, scratch, frames, terms, stamp, tick, un, vn, x, y, z, h)
    for k in range(3):
        found[NORMAL + k] = (nx, ny, nz)[k] / length if length > 0.0 else 0.0
    return BORDER if open_border else PROPER


@njit_in_place
def off_pole(
    net: Array, knots_u: Array, knots_v: Array, p: int, q: int, rational: bool, poles: int, u: float, v: float, f: float,
    x: float, y: float, z: float, h: Array, scratch: Array, frames: Array, terms: Array, stamp: Index, tick: int,
) -> tuple[float, float]:  # fmt: skip
    """From a point on a pole, at the squared distance f, to one beside it that is nearer: (u, v) itself where it is on no
    pole or no direction leads nearer.

    At a pole all parameters of its edge are one point, and the derivative across the edge turns with them: that Newton
    rests there says nothing of the other directions.
    """
    u0, u1 = knots_u[p], knots_u[len(knots_u) - p - 1]
    v0, v1 = knots_v[q], knots_v[len(knots_v) - q - 1]
    for bit in (1, 2, 4, 8):
        along_v = bit < 4
        t, end = (u, u0 if bit == 1 else u1) if along_v else (v, v0 if bit == 4 else v1)
        if not poles & bit or t != end:
            continue
        low, high = (v0, v1) if along_v else (u0, u1)
        best, at, step = 0.0, 0.0, 0.0
        across = 1 if along_v else 2
        for k in range(SPOKES):
            s = low + (k + 0.5) / SPOKES * (high - low)
            un, vn = (u, s) if along_v else (s, v)
            polynomial(net, knots_u, knots_v, p, q, rational, scratch, frames, terms, stamp, tick, un, vn, x, y, z, h)
            slope, speed2 = 0.0, 0.0
            for c in range(3):
                slope += (h[0, c] - (x if c == 0 else (y if c == 1 else z))) * h[across, c]
                speed2 += h[across, c] * h[across, c]
            inward = slope if bit == 1 or bit == 4 else -slope
            if speed2 > 0.0 and inward / np.sqrt(speed2) < best:
                best, at, step = inward / np.sqrt(speed2), s, -slope / speed2
        if not best < 0.0:
            continue
        most = 0.25 * ((u1 - u0) if along_v else (v1 - v0))
        step = min(max(step, -most), most)
        for _ in range(40):
            un, vn = (u + step, at) if along_v else (at, v + step)
            if (
                polynomial(
                    net, knots_u, knots_v, p, q, rational, scratch, frames, terms, stamp, tick, un, vn, x, y, z, h
                )
                < f
            ):
                return un, vn
            step *= 0.5
    return u, v


@njit_in_place
def cross(h: Array) -> tuple[float, float, float]:
    """S_u x S_v of h (6, 4)."""
    return (
        h[1, 1] * h[2, 2] - h[1, 2] * h[2, 1],
        h[1, 2] * h[2, 0] - h[1, 0] * h[2, 2],
        h[1, 0] * h[2, 1] - h[1, 1] * h[2, 0],
    )


@njit_in_place
def rests_inside(u: float, du: float, v: float, dv: float, u0: float, u1: float, v0: float, v1: float) -> bool:
    """The step ends inside the domain."""
    return u + du >= u0 and u + du <= u1 and v + dv >= v0 and v + dv <= v1


@njit_in_place
def inside(t: float, low: float, high: float, wrap: bool) -> float:
    """t brought back into [low, high]: around a closed direction, else to the border."""
    if t >= low and t <= high:
        return t
    if wrap:
        return low + (t - low) % (high - low)
    return low if t < low else high


@njit_in_place
def compass(
    net: Array, knots_u: Array, knots_v: Array, p: int, q: int, rational: bool, wrap_u: bool, wrap_v: bool,
    tolerance: float, u: float, v: float, x: float, y: float, z: float, h: Array,
    scratch: Array, frames: Array, terms: Array, stamp: Index, tick: int,
) -> tuple[float, float]:  # fmt: skip
    """Downhill by trial steps in eight directions, halved when none helps: where a crease denies Newton its
    derivatives."""
    u0, u1 = knots_u[p], knots_u[len(knots_u) - p - 1]
    v0, v1 = knots_v[q], knots_v[len(knots_v) - q - 1]
    f = polynomial(net, knots_u, knots_v, p, q, rational, scratch, frames, terms, stamp, tick, u, v, x, y, z, h)
    speed_u = np.sqrt(h[1, 0] * h[1, 0] + h[1, 1] * h[1, 1] + h[1, 2] * h[1, 2])
    speed_v = np.sqrt(h[2, 0] * h[2, 0] + h[2, 1] * h[2, 1] + h[2, 2] * h[2, 2])
    su, sv = 1e-2 * (u1 - u0), 1e-2 * (v1 - v0)
    for _ in range(400):
        if (su * speed_u <= tolerance and sv * speed_v <= tolerance) or su <= 1e-15 * (u1 - u0):
            break
        best_u, best_v, best_f = u, v, f
        for k in range(9):
            un, vn = inside(u + (k // 3 - 1) * su, u0, u1, wrap_u), inside(v + (k % 3 - 1) * sv, v0, v1, wrap_v)
            fn = polynomial(
                net, knots_u, knots_v, p, q, rational, scratch, frames, terms, stamp, tick, un, vn, x, y, z, h
            )
            if fn < best_f:
                best_u, best_v, best_f = un, vn, fn
        if best_f < f:
            u, v, f = best_u, best_v, best_f
        else:
            su, sv = 0.5 * su, 0.5 * sv
    return u, v


@njit_in_place
def polynomial(
    net: Array, knots_u: Array, knots_v: Array, p: int, q: int, rational: bool, scratch: Array, frames: Array, terms: Array,
    stamp: Index, tick: int, u: float, v: float, x: float, y: float, z: float, h: Array,
) -> float:  # fmt: skip
    """What `approach` gives, by Taylor's series about the middle of the knot span that holds (u, v): a fourth of its time.

    frames (2, spans, ...) : `grid.PatchGrid.frames`. terms (spans along u, along v, (p + 1) (q + 1), 4) : the series of each
    span, made where stamp (spans along u, along v) is not `tick`. On the border of the domain, where a pole's derivatives are
    zero to the last bit, `approach` itself.
    """
    if u <= knots_u[p] or v <= knots_v[q] or u >= knots_u[len(knots_u) - p - 1] or v >= knots_v[len(knots_v) - q - 1]:
        return approach(net, knots_u, knots_v, p, q, rational, u, v, x, y, z, h, scratch)
    a, b = find_span(knots_u, p, net.shape[0], u) - p, find_span(knots_v, q, net.shape[1], v) - q
    if stamp[a, b] != tick:
        stamp[a, b] = tick
        expand(net, p, q, frames, a, b, terms)
    su, sv = frames[0, a, 1], frames[1, b, 1]
    s, t = (u - frames[0, a, 0]) * su, (v - frames[1, b, 0]) * sv
    for c in range(4 if rational else 3):
        # values, and first and half the second derivatives, by Horner's rule along v, then along u
        s0, su1, suu, sv1, suv, svv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(p, -1, -1):
            f0, f1, f2 = 0.0, 0.0, 0.0
            for j in range(i * (q + 1) + q, i * (q + 1) - 1, -1):
                f2 = f2 * t + f1
                f1 = f1 * t + f0
                f0 = f0 * t + terms[a, b, j, c]
            suu = suu * s + su1
            su1 = su1 * s + s0
            s0 = s0 * s + f0
            suv = suv * s + sv1
            sv1 = sv1 * s + f1
            svv = svv * s + f2
        h[0, c], h[1, c], h[2, c] = s0, su1 * su, sv1 * sv
        h[3, c], h[4, c], h[5, c] = 2.0 * suu * su * su, suv * su * sv, 2.0 * svv * sv * sv
    if rational:
        quotient(h)
    rx, ry, rz = h[0, 0] - x, h[0, 1] - y, h[0, 2] - z
    return float(rx * rx + ry * ry + rz * rz)


@njit_in_place
def expand(net: Array, p: int, q: int, frames: Array, a: int, b: int, terms: Array) -> None:
    """Taylor's series of the span (a, b) about its middle, in parts of half the span, into terms[a, b]."""
    for i in range(p + 1):
        for j in range(q + 1):
            for c in range(4):
                total = 0.0
                for k in range(p + 1):
                    along = 0.0
                    for l in range(q + 1):
                        along += frames[1, b, 2 + j * (q + 1) + l] * net[a + k, b + l, c]
                    total += frames[0, a, 2 + i * (p + 1) + k] * along
                terms[a, b, i * (q + 1) + j, c] = total


@njit_in_place
def quotient(h: Array) -> None:
    """From w S and its derivatives in h (6, 4), those of w in column 3, to S and its derivatives."""
    w, wu, wv, wuu, wuv, wvv = h[0, 3], h[1, 3], h[2, 3], h[3, 3], h[4, 3], h[5, 3]
    for c in range(3):
        h[0, c] /= w
        h[1, c] = (h[1, c] - wu * h[0, c]) / w
        h[2, c] = (h[2, c] - wv * h[0, c]) / w
        h[3, c] = (h[3, c] - 2.0 * wu * h[1, c] - wuu * h[0, c]) / w
        h[4, c] = (h[4, c] - wu * h[2, c] - wv * h[1, c] - wuv * h[0, c]) / w
        h[5, c] = (h[5, c] - 2.0 * wv * h[2, c] - wvv * h[0, c]) / w


@njit_in_place
def approach(
    net: Array, knots_u: Array, knots_v: Array, p: int, q: int, rational: bool, u: float, v: float,
    x: float, y: float, z: float, h: Array, scratch: Array,
) -> float:  # fmt: skip
    """S, S_u, S_v, S_uu, S_uv, S_vv at (u, v) into h (6, 4), and the squared distance of S from (x, y, z).

    scratch (9, >= max(p, q) + 4). Allocates nothing.
    """
    iu = find_span(knots_u, p, net.shape[0], u)
    iv = find_span(knots_v, q, net.shape[1], v)
    basis_2(knots_u, p, iu, u, scratch, 0)
    basis_2(knots_v, q, iv, v, scratch, 3)
    for k in range(6):
        for c in range(4):
            h[k, c] = 0.0
    for b in range(q + 1):
        d0, d1, d2 = scratch[3, b], scratch[4, b], scratch[5, b]
        for c in range(4):
            s0, s1, s2 = 0.0, 0.0, 0.0
            for a in range(p + 1):
                e = net[iu - p + a, iv - q + b, c]
                s0 += scratch[0, a] * e
                s1 += scratch[1, a] * e
                s2 += scratch[2, a] * e
            h[0, c] += d0 * s0
            h[1, c] += d0 * s1
            h[2, c] += d1 * s0
            h[3, c] += d0 * s2
            h[4, c] += d1 * s1
            h[5, c] += d2 * s0
    if rational:
        quotient(h)
    rx, ry, rz = h[0, 0] - x, h[0, 1] - y, h[0, 2] - z
    return float(rx * rx + ry * ry + rz * rz)


@njit_in_place
def basis_2(knots: Array, p: int, span: int, t: float, scratch: Array, row: int) -> None:
    """The p + 1 nonzero basis functions and their first two derivatives into scratch[row : row + 3] (Piegl and Tiller,
    eq. 2.7); scratch[6:9] is used on the way. The same numbers as `basis.basis_derivatives`, without allocating."""
    for k in range(p + 1):
        for order in range(3):
            scratch[row + order, k] = 0.0
        scratch[6, k] = 0.0
        scratch[7, k] = 0.0
        scratch[8, k] = 0.0
    # scratch[row]: the functions of degree d; scratch[6], [7]: those of degree p - 2 and p - 1
    scratch[row, 0] = 1.0
    for d in range(1, p + 1):
        if d == p - 1:
            for k in range(d):
                scratch[6, k] = scratch[row, k]
        if d == p:
            for k in range(d):
                scratch[7, k] = scratch[row, k]
        saved = 0.0
        for k in range(d):
            right, left = knots[span + k + 1] - t, t - knots[span + 1 - d + k]
            part = scratch[row, k] / (right + left)
            scratch[row, k] = saved + right * part
            saved = left * part
        scratch[row, d] = saved
    # scratch[8]: first derivatives of the functions of degree p - 1
    if p > 1:
        for k in range(p):
            i = span - p + 1 + k
            left = scratch[6, k - 1] / (knots[i + p - 1] - knots[i]) if k > 0 else 0.0
            right = scratch[6, k] / (knots[i + p] - knots[i + 1]) if k < p - 1 else 0.0
            scratch[8, k] = (p - 1) * (left - right)
    for k in range(p + 1):
        i = span - p + k
        left = 1.0 / (knots[i + p] - knots[i]) if k > 0 else 0.0
        right = 1.0 / (knots[i + p + 1] - knots[i + 1]) if k < p else 0.0
        before, after = (scratch[7, k - 1], scratch[8, k - 1]) if k > 0 else (0.0, 0.0)
        scratch[row + 1, k] = p * (before * left - scratch[7, k] * right)
        scratch[row + 2, k] = p * (after * left - scratch[8, k] * right)
