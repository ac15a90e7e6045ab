"""Broad phase over many patches and tools: which boxes come near each other, before any hull is looked at (4.3).

`candidate_pairs` sweeps two sets of boxes along the axis on which they spread most: sorted by their low ends, each is
tested against those of the other set that begin before it ends. What is left out is apart along an axis. `Extents` keeps
the boxes of nets that have not changed, so that idle patches cost nothing but the question whether they are idle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import is_

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError
from ..jit import njit, njit_in_place, njit_inline_in_place
from .workspace import grown

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SWEEP_FROM = 1024
"""Up to this many pairs of boxes are tested one by one: sorting would cost more."""


def candidate_pairs(boxes_a: Array, boxes_b: Array, margin: float = 0.0) -> Index:
    """The pairs (k, 2) of boxes of a (n, 2, 3) and of b (m, 2, 3), low and high corners, that come within `margin` of
    each other along every axis, ordered by a, then by b.

    Boxes may be flat, points, or infinite; what touches is a pair. Raises GeometryError for a box that is not a number
    or a margin that is not a finite number of at least 0.
    """
    a, b = (np.ascontiguousarray(boxes, dtype=np.float64).reshape(-1, 2, 3) for boxes in (boxes_a, boxes_b))
    if np.isnan(a).any() or np.isnan(b).any():
        raise GeometryError("a box is not a number", where="broad phase")
    if not 0.0 <= margin < np.inf:
        raise GeometryError(f"a margin of {margin}", where="broad phase", mend="give a finite number of at least 0")
    if len(a) * len(b) <= SWEEP_FROM:
        return tested_pairs(a, b, margin)
    lows = np.concatenate([a[:, 0], b[:, 0]])
    finite = np.clip(lows, -1e300, 1e300)
    axis = int((finite.max(axis=0) - finite.min(axis=0)).argmax())
    order_a, order_b = (np.argsort(boxes[:, 0, axis], kind="stable") for boxes in (a, b))
    pairs = swept_pairs(a, b, margin, axis, order_a, order_b)
    return pairs[np.argsort(pairs[:, 0] * len(b) + pairs[:, 1])]


@njit_inline_in_place
def come_near(a: Array, i: int, b: Array, k: int, margin: float) -> bool:
    """Box i of a and box k of b come within `margin` along every axis."""
    return bool(
        a[i, 0, 0] <= b[k, 1, 0] + margin and b[k, 0, 0] <= a[i, 1, 0] + margin
        and a[i, 0, 1] <= b[k, 1, 1] + margin and b[k, 0, 1] <= a[i, 1, 1] + margin
        and a[i, 0, 2] <= b[k, 1, 2] + margin and b[k, 0, 2] <= a[i, 1, 2] + margin
    )  # fmt: skip


@njit
def tested_pairs(a: Array, b: Array, margin: float) -> Index:
    """The pairs of `candidate_pairs`, each box against each."""
    pairs = np.empty((64, 2), np.int64)
    count = 0
    for i in range(len(a)):
        for k in range(len(b)):
            if come_near(a, i, b, k, margin):
                if count == len(pairs):
                    pairs = grown(pairs)
                pairs[count, 0], pairs[count, 1] = i, k
                count += 1
    return pairs[:count]


@njit
def swept_pairs(a: Array, b: Array, margin: float, axis: int, order_a: Index, order_b: Index) -> Index:
    """The pairs of `candidate_pairs`, in the order in which a sweep along an axis finds them. order_a, order_b : the
    boxes by their low ends."""
    pairs = np.empty((256, 2), np.int64)
    count, i, k = 0, 0, 0
    while i < len(a) and k < len(b):
        # of the two boxes that begin next, the earlier meets what begins before it ends
        first = a[order_a[i], 0, axis] <= b[order_b[k], 0, axis]
        end = (a[order_a[i], 1, axis] if first else b[order_b[k], 1, axis]) + margin
        t = k if first else i
        while t < (len(b) if first else len(a)):
            p, q = (order_a[i], order_b[t]) if first else (order_a[t], order_b[k])
            if (b[q, 0, axis] if first else a[p, 0, axis]) > end:
                break
            if come_near(a, p, b, q, margin):
                if count == len(pairs):
                    pairs = grown(pairs)
                pairs[count, 0], pairs[count, 1] = p, q
                count += 1
            t += 1
        if first:
            i += 1
        else:
            k += 1
    return pairs[:count]


@njit
def near_box(boxes: Array, low: Array, high: Array, margin: float, diagonals: float) -> Index:
    """The boxes of (n, 2, 3) that come within the margin, and this share of their own diagonals, of the box from low to
    high along every axis."""
    out = np.empty(len(boxes), np.int64)
    return out[: fill_near(boxes, low, high, margin, diagonals, out)].copy()


@njit_in_place
def fill_near(boxes: Array, low: Array, high: Array, margin: float, diagonals: float, out: Index) -> int:
    """The boxes of `near_box` into out; how many they are."""
    count = 0
    for k in range(len(boxes)):
        reach = margin
        if diagonals > 0.0:
            x, y, z = (
                boxes[k, 1, 0] - boxes[k, 0, 0], boxes[k, 1, 1] - boxes[k, 0, 1], boxes[k, 1, 2] - boxes[k, 0, 2],
            )  # fmt: skip
            reach += diagonals * np.sqrt(x * x + y * y + z * z)
        meets = True
        for c in range(3):
            meets = meets and boxes[k, 0, c] <= high[c] + reach and boxes[k, 1, c] >= low[c] - reach
        if meets:
            out[count] = k
            count += 1
    return count


@dataclass(slots=True, eq=False)
class Extents:
    """The boxes (n, 2, 3) of a list of nets, kept from call to call.

    A net counts as unchanged when it is the very array of the call before and cannot have been written to: read-only,
    and not a view of another. All others are looked at again.
    """

    boxes: Array = field(default_factory=lambda: np.empty((0, 2, 3)))
    _known: list[Array | None] = field(default_factory=list)
    _numbers: Array = field(default_factory=lambda: np.empty(0))
    _starts: Index = field(default_factory=lambda: np.zeros(1, np.int64))
    _which: Index = field(default_factory=lambda: np.empty(0, np.int64))

    def of(self, nets: Sequence[Array], whose: str) -> Array:
        """The boxes of these nets. Raises GeometryError for one that is not finite."""
        if len(nets) != len(self._known):
            self.boxes, self._known = np.empty((len(nets), 2, 3)), [None] * len(nets)
            self._starts, self._which = np.zeros(len(nets) + 1, np.int64), np.empty(len(nets), np.int64)
        changed = [k for k, same in enumerate(map(is_, nets, self._known)) if not same]
        if not changed:
            return self.boxes
        end = 0
        for place, k in enumerate(changed):
            net, start, end = nets[k], end, end + nets[k].size
            if end > len(self._numbers):
                self._numbers = np.concatenate([self._numbers[:start], np.empty(2 * end - start)])
            self._numbers[start:end].reshape(net.shape)[...] = net
            self._starts[place + 1], self._which[place] = end, k
            self._known[k] = None if net.flags.writeable or net.base is not None else net
        wrong = fill_boxes_of(self._numbers, self._starts, self._which, len(changed), self.boxes)
        if wrong >= 0:
            self._known = [None] * len(nets)
            raise GeometryError("a control point is not finite", where=f"patch {wrong} of the {whose}")
        return self.boxes


def extents_of(nets: Sequence[Array], whose: str) -> Array:
    """The boxes (n, 2, 3) of nets. Raises GeometryError for one that is not finite."""
    return Extents().of(nets, whose)


@njit
def boxes_of(numbers: Array, starts: Index) -> Array:
    """Boxes (n, 2, 3) of nets whose coordinates x, y, z follow each other in numbers[starts[k]] to numbers[starts[k + 1]]:
    NaN anywhere makes one NaN."""
    out = np.empty((len(starts) - 1, 2, 3))
    fill_boxes_of(numbers, starts, np.arange(len(out)), len(out), out)
    return out


@njit_in_place
def fill_boxes_of(numbers: Array, starts: Index, which: Index, count: int, out: Array) -> int:
    """The boxes of `boxes_of` into the rows which[:count] of out; the first row that is not finite, or -1."""
    wrong = -1
    for k in range(count):
        for c in range(3):
            low, high = np.inf, -np.inf
            for t in range(starts[k] + c, starts[k + 1], 3):
                x = numbers[t]
                if np.isnan(x):
                    low, high = np.nan, np.nan
                    break
                low, high = min(low, x), max(high, x)
            out[which[k], 0, c], out[which[k], 1, c] = low, high
            if wrong < 0 and not (np.isfinite(low) and np.isfinite(high)):
                wrong = which[k]
    return wrong
