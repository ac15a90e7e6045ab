"""Conservative advancement over pairs of moving cells: the kernels of `sweep`.

A cell's four corners and its sag move linearly in s, because control points do. For any fixed direction the gap between
two cells (the least advance of one's corners before the other's, less both sags) is then a concave, piecewise linear
function of s: where it is positive at two times it is so between them, and the time at which it ends is had in closed
form. Each pair of cells waits in a queue at the time until which it is proved apart. The earliest one is looked at there: a
better direction takes it further, or, where the cells are large against the gap, the larger one is halved. Two small cells
that come within the tolerance are the contact. (Mirtich, "Timewarp rigid body simulation", SIGGRAPH 2000, keeps pairs of
bodies in such a queue; here they are cells.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...jit import njit, njit_inline
from ...spline.region import MIXED, OFF, ON, classify
from ..cells import ACROSS_U, WHOLE, make_cells
from ..workspace import Spans
from .swept_boxes import Span, overlap

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CLEAR, CONTACT, ROOM, SPENT = range(4)
"""What `advance` answers: apart to the end; a contact; an array is full, call again with longer ones; the budget is
spent."""

UNKNOWN, NONE = -1, -2
"""Instead of a cell's first child: not halved yet; too narrow to be halved."""

NEAR = 0.25
"""A pair whose gap is smaller than this part of the larger cell is refined, others are advanced. Tried: from 0.1 to 1 the
work changes by less than a third."""

DIRECTIONS = 9


class Side(NamedTuple):
    """The cells of one moving patch, those of its knot spans first.

    rectangle (n, 4) : u0, u1, v0, v1. first, last (n, 4, 3) and sag_first, sag_last (n,) : corners and sag at the ends of
    the motion. child (n,) : the first of two children. on (n,) : `region` codes. cut (n,) : `cells` codes. centre (n, 3),
    radius (n,) : not used, written by `make_cells`. made (1,) : cells made.
    """

    rectangle: Array
    first: Array
    last: Array
    sag_first: Array
    sag_last: Array
    child: Index
    on: Index
    cut: Index
    centre: Array
    radius: Array
    made: Index


class Queue(NamedTuple):
    """A binary heap of pairs of cells: key (n,) orders them, then size (n,), smaller first, so that among pairs of one
    time the finest comes first; until (n,) : proved apart to there; a, b (n,) : the cells. tally (2,) : pairs waiting,
    pairs looked at."""

    key: Array
    size: Array
    until: Array
    a: Index
    b: Index
    tally: Index


class Trim(NamedTuple):
    """What `region.classify` takes; trimmed : False for a whole face."""

    trimmed: bool
    chords: Array
    deviation: Array
    box: Array
    shifts: Array
    low: Array
    size: Array


# ---------------------------------------------------------------- cells


@njit
def fill(g0: Spans, g1: Spans, still: bool, trim: Trim, side: Side, start: int, end: int) -> None:
    """Corners and sags of the cells start to end, whose rectangles stand there already."""
    rectangle, on = side.rectangle[start:end], side.on[start:end]
    if trim.trimmed:
        classify(trim.chords, trim.deviation, trim.box, trim.shifts, trim.low, trim.size, rectangle, on)
    else:
        on[:] = ON
    first, last, sag_first, sag_last = (
        side.first[start:end], side.last[start:end], side.sag_first[start:end], side.sag_last[start:end],
    )  # fmt: skip
    centre, radius, cut = side.centre[start:end], side.radius[start:end], side.cut[start:end]
    make_cells(g0, rectangle, on, first, sag_first, centre, radius, cut)
    if still:
        # (numba compiles the text of an error message for an assignment of one slice to another: three seconds)
        for k in range(len(first)):
            sag_last[k] = sag_first[k]
            for e in range(4):
                for c in range(3):
                    last[k, e, c] = first[k, e, c]
    else:
        make_cells(g1, rectangle, on, last, sag_last, centre, radius, cut)
    side.child[start:end] = UNKNOWN
    side.made[0] = end


@njit
def halve(g0: Spans, g1: Spans, still: bool, trim: Trim, side: Side, k: int) -> bool:
    """Make the two children of cell k; False where it is too narrow to have any. There must be room for them."""
    if side.cut[k] == WHOLE:
        side.child[k] = NONE
        return False
    n = side.made[0]
    side.child[k] = n
    for c in range(4):
        side.rectangle[n, c] = side.rectangle[k, c]
        side.rectangle[n + 1, c] = side.rectangle[k, c]
    low = 0 if side.cut[k] == ACROSS_U else 2
    middle = 0.5 * (side.rectangle[k, low] + side.rectangle[k, low + 1])
    side.rectangle[n, low + 1], side.rectangle[n + 1, low] = middle, middle
    fill(g0, g1, still, trim, side, n, n + 2)
    return True


@njit_inline
def length(c: Array, i: int, j: int) -> float:
    """Distance of corners i and j of c (4, 3)."""
    x, y, z = c[i, 0] - c[j, 0], c[i, 1] - c[j, 1], c[i, 2] - c[j, 2]
    return float(np.sqrt(x * x + y * y + z * z))


@njit_inline
def place(side: Side, k: int, time: Span, s: float, out: Array) -> float:
    """The corners of cell k at s, into out (4, 3); returns its sag there."""
    f = (s - time.low) / (time.high - time.low)
    for i in range(4):
        for c in range(3):
            out[i, c] = (1.0 - f) * side.first[k, i, c] + f * side.last[k, i, c]
    return (1.0 - f) * side.sag_first[k] + f * side.sag_last[k]


# ---------------------------------------------------------------- queue


@njit
def push(queue: Queue, key: float, size: float, until: float, a: int, b: int) -> None:
    """Add a pair; there must be room."""
    i = queue.tally[0]
    queue.tally[0] += 1
    while i > 0:
        j = (i - 1) // 2
        if queue.key[j] < key or (queue.key[j] == key and queue.size[j] <= size):
            break
        move(queue, j, i)
        i = j
    queue.key[i], queue.size[i], queue.until[i], queue.a[i], queue.b[i] = key, size, until, a, b


@njit
def drop_first(queue: Queue) -> None:
    """Take the first pair away."""
    n = queue.tally[0] - 1
    queue.tally[0] = n
    if n == 0:
        return
    key, size = queue.key[n], queue.size[n]
    i = 0
    while True:
        j = 2 * i + 1
        if j >= n:
            break
        if j + 1 < n and before(queue, j + 1, j):
            j += 1
        if key < queue.key[j] or (key == queue.key[j] and size <= queue.size[j]):
            break
        move(queue, j, i)
        i = j
    move(queue, n, i)


@njit_inline
def before(queue: Queue, i: int, j: int) -> bool:
    return bool(queue.key[i] < queue.key[j] or (queue.key[i] == queue.key[j] and queue.size[i] < queue.size[j]))


@njit_inline
def move(queue: Queue, source: int, target: int) -> None:
    queue.key[target], queue.size[target], queue.until[target] = (
        queue.key[source],
        queue.size[source],
        queue.until[source],
    )
    queue.a[target], queue.b[target] = queue.a[source], queue.b[source]


@njit
def seed(
    a0: Array, a1: Array, on_a: Index, at: Span, b0: Array, b1: Array, on_b: Index, bt: Span,
    pad: float, s0: float, s1: float, step: float, queue: Queue,
) -> int:  # fmt: skip
    """Fill the queue with the pairs of knot spans whose moving boxes (rows of a0 to a1, of b0 to b1) meet from s0 to s1.

    Returns how many there are; where that is more than the queue holds, call again with a longer one.
    """
    queue.tally[0] = 0
    n = 0
    for i in range(len(a0)):
        if on_a[i] == OFF:
            continue
        for j in range(len(b0)):
            if on_b[j] == OFF:
                continue
            t = overlap(a0, a1, at, b0, b1, bt, i, j, pad, s0, s1)
            if t < s1:
                n += 1
                if n <= len(queue.key):
                    t = max(s0, t - 1e-12 * (s1 - s0))
                    push(queue, np.floor(t / step), np.inf, t, i, j)
    return n


# ---------------------------------------------------------------- pairs


@njit
def advance(
    g0: Spans, g1: Spans, still_a: bool, trim_a: Trim, a: Side, at: Span,
    h0: Spans, h1: Spans, still_b: bool, trim_b: Trim, b: Side, bt: Span,
    pad: float, near: float, s1: float, step: float, budget: int, queue: Queue, found: Array, where: Index,
) -> int:  # fmt: skip
    """Work the queue off. Returns CLEAR when every pair is apart up to s1.

    pad : added to the sags: rounding, and how far turning points leave their chords. near : distance that is a contact.
    step : a stretch of time in which nothing moves by more than a part of it; pairs within one are looked at finest
    first. found (2,) : on return the time until which all is apart, and that at which a contact is seen. where (2,) :
    the two cells of the contact, or of the pair that the budget was spent on.
    """
    p0, p1, q0, q1 = np.empty((4, 3)), np.empty((4, 3)), np.empty((4, 3)), np.empty((4, 3))
    d, best = np.empty((DIRECTIONS, 3)), np.empty(2)
    while queue.tally[0] > 0:
        s, i, j = queue.until[0], queue.a[0], queue.b[0]
        where[0], where[1] = i, j
        if queue.tally[1] >= budget:
            found[0], found[1] = earliest(queue), np.inf
            return SPENT
        if queue.tally[0] + 2 > len(queue.key) or a.made[0] + 2 > len(a.child) or b.made[0] + 2 > len(b.child):
            return ROOM
        queue.tally[1] += 1
        sag_a, sag_b = place(a, i, at, s, p0), place(b, j, bt, s, q0)
        last_a, last_b = place(a, i, at, s1, p1), place(b, j, bt, s1, q1)
        thick0, thick1 = sag_a + sag_b + pad, last_a + last_b + pad
        directions(p0, p1, q0, q1, d)
        separate(p0, p1, q0, q1, thick0, thick1, d, best)
        gap, part = best[0], best[1]
        if part >= 1.0:
            drop_first(queue)
            continue
        until = s + part * (s1 - s) if part > 0.0 else s
        size_a = max(length(p0, 3, 0), length(p0, 2, 1)) + 2.0 * sag_a
        size_b = max(length(q0, 3, 0), length(q0, 2, 1)) + 2.0 * sag_b
        small = max(size_a, size_b) <= 0.25 * near
        if gap <= near and (small or (a.on[i] != MIXED and b.on[j] != MIXED)):
            together = np.inf
            for e in range(4):
                for f in range(4):
                    x, y, z = p0[e, 0] - q0[f, 0], p0[e, 1] - q0[f, 1], p0[e, 2] - q0[f, 2]
                    together = min(together, x * x + y * y + z * z)
            if np.sqrt(together) <= near:
                found[0], found[1] = earliest(queue), s
                return CONTACT
        if gap > NEAR * max(size_a, size_b) and until > s:
            drop_first(queue)
            push(queue, np.floor(until / step), max(size_a, size_b), until, i, j)
            continue
        # the larger one is halved, the other where that is too narrow already
        split_a = size_a >= size_b
        for _ in range(2):
            if split_a:
                divided = a.child[i] >= 0 or (a.child[i] == UNKNOWN and halve(g0, g1, still_a, trim_a, a, i))
            else:
                divided = b.child[j] >= 0 or (b.child[j] == UNKNOWN and halve(h0, h1, still_b, trim_b, b, j))
            if divided:
                break
            split_a = not split_a
        if not divided:
            # as fine as parameters go: nothing tells the two apart
            if until > s:
                drop_first(queue)
                push(queue, np.floor(until / step), max(size_a, size_b), until, i, j)
                continue
            found[0], found[1] = earliest(queue), s
            return CONTACT
        drop_first(queue)
        for k in range(2):
            if split_a:
                child = a.child[i] + k
                if a.on[child] != OFF:
                    push(queue, np.floor(until / step), 0.5 * size_a + size_b, until, child, j)
            else:
                child = b.child[j] + k
                if b.on[child] != OFF:
                    push(queue, np.floor(until / step), size_a + 0.5 * size_b, until, i, child)
    found[0], found[1] = s1, np.inf
    return CLEAR


@njit
def earliest(queue: Queue) -> float:
    """The time until which every pair is apart."""
    least = np.inf
    for k in range(queue.tally[0]):
        least = min(least, queue.until[k])
    return least


@njit
def directions(p0: Array, p1: Array, q0: Array, q1: Array, d: Array) -> None:
    """Unit vectors, or zeros, along which two cells of corners p, q may be apart: from middle to middle, the same across
    the motion, between the nearest corners, the two normals, and across pairs of edges."""
    mx, vx = np.empty(3), np.empty(3)
    vv, mv = 0.0, 0.0
    for c in range(3):
        mx[c] = 0.25 * ((q0[0, c] + q0[1, c] + q0[2, c] + q0[3, c]) - (p0[0, c] + p0[1, c] + p0[2, c] + p0[3, c]))
        vx[c] = (
            0.25 * ((q1[0, c] + q1[1, c] + q1[2, c] + q1[3, c]) - (p1[0, c] + p1[1, c] + p1[2, c] + p1[3, c])) - mx[c]
        )
        vv += vx[c] * vx[c]
        mv += mx[c] * vx[c]
    nearest, e, f = np.inf, 0, 0
    for k in range(16):
        x, y, z = (
            q0[k & 3, 0] - p0[k >> 2, 0],
            q0[k & 3, 1] - p0[k >> 2, 1],
            q0[k & 3, 2] - p0[k >> 2, 2],
        )
        if x * x + y * y + z * z < nearest:
            nearest, e, f = x * x + y * y + z * z, k >> 2, k & 3
    for c in range(3):
        d[0, c] = mx[c]
        d[1, c] = mx[c] - (mv / vv * vx[c] if vv > 0.0 else 0.0)
        d[2, c] = q0[f, c] - p0[e, c]
    edge = np.empty((4, 3))
    for c in range(3):
        edge[0, c] = (p0[1, c] - p0[0, c]) + (p0[3, c] - p0[2, c])
        edge[1, c] = (p0[2, c] - p0[0, c]) + (p0[3, c] - p0[1, c])
        edge[2, c] = (q0[1, c] - q0[0, c]) + (q0[3, c] - q0[2, c])
        edge[3, c] = (q0[2, c] - q0[0, c]) + (q0[3, c] - q0[1, c])
    for k in range(6):
        x, y = (0, 2, 0, 0, 1, 1)[k], (1, 3, 2, 3, 2, 3)[k]
        for c in range(3):
            d[3 + k, c] = edge[x, c - 2] * edge[y, c - 1] - edge[x, c - 1] * edge[y, c - 2]
    for k in range(DIRECTIONS):
        size, side = 0.0, 0.0
        for c in range(3):
            size = max(size, abs(d[k, c]))
        if not size > 0.0:
            continue
        # scaled first: squares of large numbers overflow, of small ones vanish
        total = 0.0
        for c in range(3):
            d[k, c] /= size
            total += d[k, c] * d[k, c]
            side += d[k, c] * mx[c]
        total = np.sqrt(total) if side >= 0.0 else -np.sqrt(total)
        for c in range(3):
            d[k, c] /= total


@njit
def separate(p0: Array, p1: Array, q0: Array, q1: Array, thick0: float, thick1: float, d: Array, best: Array) -> None:
    """best (2,) : the largest gap at the start over directions d, and the largest part of the motion from p0, q0 to p1, q1
    that one of them proves free of contact (1: all of it)."""
    best[0], best[1] = -np.inf, 0.0
    a, b = np.empty((2, 4)), np.empty((2, 4))
    for k in range(len(d)):
        x, y, z = d[k, 0], d[k, 1], d[k, 2]
        for e in range(4):
            a[0, e] = x * p0[e, 0] + y * p0[e, 1] + z * p0[e, 2]
            a[1, e] = x * p1[e, 0] + y * p1[e, 1] + z * p1[e, 2]
            b[0, e] = x * q0[e, 0] + y * q0[e, 1] + z * q0[e, 2]
            b[1, e] = x * q1[e, 0] + y * q1[e, 1] + z * q1[e, 2]
        gap = min(b[0, 0], b[0, 1], b[0, 2], b[0, 3]) - max(a[0, 0], a[0, 1], a[0, 2], a[0, 3]) - thick0
        best[0] = max(best[0], gap)
        if not gap > 0.0:
            continue
        part = 1.0
        for e in range(4):
            for f in range(4):
                end = b[1, f] - a[1, e] - thick1
                if end <= 0.0:
                    start = b[0, f] - a[0, e] - thick0
                    part = min(part, start / (start - end))
        if part > best[1]:
            best[1] = part
            if part >= 1.0:
                return
