"""Nodes that follow others, so that several lattices move as one: the seams between the faces of one body.

A tied node has no motion of its own. Its velocity is the weighted mean of its masters',

    v_s = sum_k w_k v_k,    w_k >= 0,  sum_k w_k = 1,

its displacement therefore the same mean of theirs, and the forces on it go to them by the same weights. (Displacements are
tied, not positions: what is tied need not coincide. Where it does not, the gap keeps its direction while the body turns.) Its
mass goes to its masters too, so that momentum is kept exactly.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..jit import njit_in_place

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

LEAST_WEIGHT = 1e-9
"""Weights below this are rounding: the node does not follow such a master."""


@dataclass(frozen=True, slots=True, eq=False)
class Ties:
    """Ties as they are given: nodes (s,) follow masters (s, m) with weights (s, m) of sum 1.

    Nodes are numbered in the assembly: those of all parts, one part behind the other. Masters of weight 0 are none.
    """

    nodes: Index
    masters: Index
    weights: Array

    @classmethod
    def joined(cls, ties: Iterable[Ties]) -> Ties:
        """All of these, in this order; of ties that exclude each other the first counts."""
        ties = list(ties)
        width = max((tie.masters.shape[1] for tie in ties), default=1)
        count = sum(len(tie.nodes) for tie in ties)
        nodes, masters = np.zeros(count, dtype=np.int64), np.zeros((count, width), dtype=np.int64)
        weights, at = np.zeros((count, width)), 0
        for tie in ties:
            end, across = at + len(tie.nodes), tie.masters.shape[1]
            nodes[at:end] = tie.nodes
            masters[at:end, :across], weights[at:end, :across] = tie.masters, tie.weights
            at = end
        return cls(nodes, masters, weights)


@dataclass(frozen=True, slots=True, eq=False)
class TiedNodes:
    """Ties resolved: no master follows another node.

    nodes (s,) : increasing. start (s + 1,) : node s follows masters[start[s]:start[s + 1]] with these weights. row (N,) :
    a node's place in `nodes`, -1 of a node that follows none; of length 0 where nothing is tied. most : masters of any node.
    """

    row: Index
    nodes: Index
    start: Index
    masters: Index
    weights: Array
    most: int


def _of(*values: int) -> Index:
    return np.array(values, dtype=np.int64)


NO_TIES = TiedNodes(_of(), _of(), _of(0), _of(), np.zeros(0), 1)


def resolve(ties: Ties, active: Mask) -> TiedNodes:
    """Ties (given) to nodes that follow nothing else; active (N,) : nodes of at least one cell, only they are tied.

    Where a node is tied twice, as at a corner of three faces, what it coincides with follows the second tie's masters: all
    that meet there move as one. A second tie between two that lie beside nodes, not on them, is left out. What follows
    itself in the end is left out, so that every order of the ties gives a definite answer.

    Raises InputError for shapes, nodes or weights that are wrong.
    """
    count = len(active)
    _check(ties, count)
    if not len(ties.nodes):
        return NO_TIES
    following = _Following({}, {})
    for node, masters, weights in zip(ties.nodes, ties.masters, ties.weights, strict=True):
        mine = {int(m): float(w) for m, w in _merged(masters, weights) if w > LEAST_WEIGHT and active[m]}
        if active[node] and mine:
            following.tie(int(node), mine)
    nodes = sorted(following.masters)
    if not nodes:
        return NO_TIES
    rows = [sorted(following.masters[node].items()) for node in nodes]
    row = np.full(count, -1, dtype=np.int64)
    row[nodes] = np.arange(len(nodes))
    start = np.zeros(len(nodes) + 1, dtype=np.int64)
    start[1:] = np.cumsum([len(entries) for entries in rows])
    masters = np.array([m for entries in rows for m, _ in entries], dtype=np.int64)
    weights = np.array([w for entries in rows for _, w in entries])
    most = int(np.diff(start).max())
    return TiedNodes(row, np.array(nodes, dtype=np.int64), start, masters, weights, most)


def _check(ties: Ties, count: int) -> None:
    size = len(ties.nodes)
    if ties.masters.shape != ties.weights.shape or ties.masters.ndim != 2 or len(ties.masters) != size:
        raise InputError(f"ties of {size} nodes to masters {ties.masters.shape} with weights {ties.weights.shape}")
    for name, nodes in (("nodes", ties.nodes), ("masters", ties.masters)):
        if nodes.size and not (nodes.min() >= 0 and nodes.max() < count):
            raise InputError(f"the {name} of ties are not among the {count} nodes")
    if not (np.isfinite(ties.weights).all() and (ties.weights >= -LEAST_WEIGHT).all()):
        raise InputError("weights of ties must be finite and not negative")
    if size and np.abs(ties.weights.sum(axis=1) - 1.0).max() > 1e-6:
        raise InputError("the weights of a tie do not sum to 1")


def _merged(masters: Index, weights: Array) -> list[tuple[int, float]]:
    total: dict[int, float] = {}
    for m, w in zip(masters, weights, strict=True):
        total[int(m)] = total.get(int(m), 0.0) + float(w)
    return list(total.items())


@dataclass(slots=True)
class _Following:
    """Who follows whom while ties are resolved: masters of every tied node, none of which is tied; and the way back."""

    masters: dict[int, dict[int, float]]
    followers: dict[int, set[int]]

    def tie(self, node: int, to: dict[int, float]) -> None:
        """Let `node` follow `to`, or what it already coincides with."""
        to = self._at_last(to)
        mine = self.masters.get(node)
        if mine is None:
            self._follow(node, to)
        elif len(mine) == 1:
            self._follow(next(iter(mine)), to)
        elif len(to) == 1:
            self._follow(next(iter(to)), mine)

    def _at_last(self, to: dict[int, float]) -> dict[int, float]:
        found: dict[int, float] = {}
        for m, w in to.items():
            for end, share in self.masters.get(m, {m: 1.0}).items():
                found[end] = found.get(end, 0.0) + w * share
        total = sum(found.values())
        return {m: w / total for m, w in found.items() if w > LEAST_WEIGHT * total}

    def _follow(self, node: int, to: dict[int, float]) -> None:
        """`node`, which follows none yet, follows `to`, which do not either."""
        others = {m: w for m, w in to.items() if m != node}
        if not others:
            return
        # x = w x + the rest is x = the rest / (1 - w)
        total = sum(others.values())
        if total < LEAST_WEIGHT:
            return
        others = {m: w / total for m, w in others.items()}
        self.masters[node] = others
        for m in others:
            self.followers.setdefault(m, set()).add(node)
        for follower in sorted(self.followers.pop(node, ())):
            self.masters[follower] = self._at_last(self.masters[follower])
            for m in self.masters[follower]:
                self.followers.setdefault(m, set()).add(follower)


def condensed(values: Array, ties: TiedNodes) -> Array:
    """Nodal values (N, ...) such as masses and forces, those of tied nodes shared out to their masters; the sum stays."""
    values = values.copy()
    if len(ties.nodes):
        given = values[np.repeat(ties.nodes, np.diff(ties.start))]
        weights = ties.weights.reshape(-1, *(1,) * (values.ndim - 1))
        np.add.at(values, ties.masters, weights * given)
        values[ties.nodes] = 0.0
    return values


def carried(values: Array, ties: TiedNodes) -> Array:
    """Nodal displacements or velocities (N, 3), those of tied nodes replaced by the mean of their masters'."""
    if len(ties.nodes):
        values = values.copy()
        values[ties.nodes] = np.add.reduceat(ties.weights[:, None] * values[ties.masters], ties.start[:-1], axis=0)
    return values


def bodies(parts: Sequence[int], ties: TiedNodes) -> list[int]:
    """For parts that start at these nodes, the first part that each hangs together with through ties."""
    body = list(range(len(parts)))

    def root(k: int) -> int:
        while body[k] != k:
            k = body[k]
        return k

    starts = np.asarray(parts, dtype=np.int64)
    for s, node in enumerate(ties.nodes):
        for master in ties.masters[ties.start[s] : ties.start[s + 1]]:
            a, b = (root(int(np.searchsorted(starts, n, side="right")) - 1) for n in (node, master))
            body[max(a, b)] = min(a, b)
    return [root(k) for k in range(len(parts))]


@njit_in_place
def gather(nodes: Index, start: Index, masters: Index, weights: Array, f: Array) -> None:
    """Add the values of tied nodes in f (3, N + 2), padded, to their masters', and leave 0."""
    for s in range(len(nodes)):
        n = nodes[s] + 1
        for a in range(3):
            for e in range(start[s], start[s + 1]):
                f[a, masters[e] + 1] += weights[e] * f[a, n]
            f[a, n] = 0.0


@njit_in_place
def scatter(nodes: Index, start: Index, masters: Index, weights: Array, v: Array) -> None:
    """Give tied nodes in v (3, N + 2), padded, the mean of their masters' values."""
    for s in range(len(nodes)):
        for a in range(3):
            total = 0.0
            for e in range(start[s], start[s + 1]):
                total += weights[e] * v[a, masters[e] + 1]
            v[a, nodes[s] + 1] = total
