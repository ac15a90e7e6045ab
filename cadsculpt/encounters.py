"""Which bodies may meet, and which of them have to be integrated as one.

Bodies are numbered in the scene's order, models before tools. A pair is (a, b): contacts lie on a's patches, and b is what is
found there, of any kind. Of two models, and of two tools of which the first has patches of material, a is the first; a model
comes before a tool.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .motion.boxes import overlap

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Party:
    """A body as pairs see it.

    model : else it is a tool. deformable : it has a lattice. solids : marks of the solids that its faces belong to; faces of
    one solid never meet. boxes (k, 2, 3) : in the world, they hold it for the whole run.
    """

    model: bool
    deformable: bool
    solids: frozenset[str]
    boxes: Array


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """The pairs that contacts are looked for between.

    a, b (n,) : bodies, sorted. meet (n,) : those that come so near each other on their paths that they may touch; a rigid
    tool may touch everything.
    """

    a: Index
    b: Index
    meet: Mask

    def __len__(self) -> int:
        return len(self.a)

    @classmethod
    def between(cls, parties: Sequence[Party]) -> Pairs:
        """All pairs of which one is deformable, and every model with every tool."""
        rows = []
        for i, first in enumerate(parties):
            for j, second in enumerate(parties[i + 1 :], start=i + 1):
                mixed = first.model != second.model
                if not mixed and not (first.deformable or second.deformable):
                    continue
                if not mixed and first.solids & second.solids:
                    continue
                # a rigid tool may have no patches: the contacts lie on the other one
                swap = not first.model and not first.deformable
                meet = (mixed and not second.deformable) or overlap(first.boxes, second.boxes)
                rows.append((j, i, meet) if swap else (i, j, meet))
        table = np.array(sorted(rows), np.int64).reshape(-1, 3)
        return cls(table[:, 0].copy(), table[:, 1].copy(), table[:, 2] != 0)

    def index(self, first: int, second: int) -> int | None:
        """The place of the pair of two bodies, whichever way round; None where nothing is looked for between them."""
        found = np.flatnonzero(((self.a == first) & (self.b == second)) | ((self.a == second) & (self.b == first)))
        return int(found[0]) if len(found) else None

    def places(self, a: Index, b: Index) -> Index:
        """The places of the pairs of contacts (n,) between bodies a and b (n,)."""
        width = int(max(self.a.max(initial=0), self.b.max(initial=0))) + 1
        return np.searchsorted(self.a * width + self.b, a * width + b).astype(np.int64)

    def of(self, body: int) -> Index:
        """The places of all pairs with a body."""
        return np.flatnonzero((self.a == body) | (self.b == body)).astype(np.int64)

    def others(self, body: int) -> list[int]:
        """The bodies that contacts on `body` are looked for with."""
        return [int(b) for b in self.b[(self.a == body) & self.meet]]

    def roaming(self, body: int) -> Pairs:
        """The same, with a body that may go anywhere."""
        return Pairs(self.a, self.b, self.meet | (self.a == body) | (self.b == body))


def together(count: int, joined: Sequence[tuple[int, int]]) -> list[list[int]]:
    """0 to count - 1 in groups of what hangs together by the pairs joined, each in order, the groups by their first."""
    root = list(range(count))

    def find(k: int) -> int:
        while root[k] != k:
            k = root[k]
        return k

    for i, j in joined:
        a, b = find(i), find(j)
        root[max(a, b)] = min(a, b)
    groups: dict[int, list[int]] = {}
    for k in range(count):
        groups.setdefault(find(k), []).append(k)
    return [groups[k] for k in sorted(groups)]
