"""The memory that the integrators work in: kept with a lattice's state, so that a step allocates nothing once warm."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .lattice import Lattice
from .stability import SCRATCH_ROWS

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def _numbers(*shape: int) -> Array:
    return np.zeros(shape)


@dataclass(slots=True, eq=False)
class Workspace:
    """Arrays of N nodes, and of n contacts with some to spare; no part of the state. What a step returns are views of them.

    scratch (SCRATCH_ROWS, N + 2). place (N,) : -1. rest (13, N) : rest lengths at the step's start, of plastic lattices alone.
    rigid (16,) : of `rigid.ride`. distinct : of both kinds of contact. local, impulse, marks (n, 4), nodal (4 n, 12) : of
    `forces.press`. pressing (n,), rubbing (n, 3), mobility (n,), start (n + 1,), node, local_rows, weight, moving : of
    `impulses.impel`. depth (n,), mean_force, end_force (n, 3) : the outcome.
    """

    scratch: Array = field(default_factory=lambda: _numbers(SCRATCH_ROWS, 0))
    place: Index = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    rest: Array = field(default_factory=lambda: _numbers(13, 0))
    rigid: Array = field(default_factory=lambda: _numbers(16))
    distinct: Index = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    local: Index = field(default_factory=lambda: np.zeros((0, 4), dtype=np.int64))
    impulse: Array = field(default_factory=lambda: _numbers(0, 4))
    marks: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 4), dtype=np.bool_))
    nodal: Array = field(default_factory=lambda: _numbers(0, 12))
    pressing: Array = field(default_factory=lambda: _numbers(0))
    rubbing: Array = field(default_factory=lambda: _numbers(0, 3))
    mobility: Array = field(default_factory=lambda: _numbers(0))
    start: Index = field(default_factory=lambda: np.zeros(1, dtype=np.int64))
    node: Index = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    local_rows: Index = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    weight: Array = field(default_factory=lambda: _numbers(0))
    moving: Array = field(default_factory=lambda: _numbers(0, 4))
    depth: Array = field(default_factory=lambda: _numbers(0))
    mean_force: Array = field(default_factory=lambda: _numbers(0, 3))
    end_force: Array = field(default_factory=lambda: _numbers(0, 3))

    def fit(self, lattice: Lattice, contacts: int) -> None:
        """Make room for a lattice and so many contacts; nothing happens where there is enough."""
        nodes = len(lattice.nodes)
        if self.scratch.shape[1] != nodes + 2:
            self.scratch = np.zeros((SCRATCH_ROWS, nodes + 2))
            self.place = np.full(nodes, -1, dtype=np.int64)
            self.rest = np.zeros((13, nodes if lattice.plastic else 0))
        # in place of a tied node stand its masters
        fan = 8 * lattice.ties.most
        if contacts > len(self.depth) or fan * contacts > len(self.node):
            self._grow(max(contacts, 2 * len(self.depth)), fan)

    def _grow(self, contacts: int, fan: int) -> None:
        self.distinct, self.nodal = np.zeros(fan * contacts, dtype=np.int64), np.zeros((4 * contacts, 12))
        self.local, self.impulse = np.zeros((contacts, 4), dtype=np.int64), np.zeros((contacts, 4))
        self.marks = np.zeros((contacts, 4), dtype=np.bool_)
        self.pressing, self.mobility, self.depth = np.zeros(contacts), np.zeros(contacts), np.zeros(contacts)
        self.rubbing, self.mean_force, self.end_force = (np.zeros((contacts, 3)) for _ in range(3))
        self.start = np.zeros(contacts + 1, dtype=np.int64)
        self.node, self.local_rows = (np.zeros(fan * contacts, dtype=np.int64) for _ in range(2))
        self.weight, self.moving = np.zeros(fan * contacts), np.zeros((fan * contacts, 4))
