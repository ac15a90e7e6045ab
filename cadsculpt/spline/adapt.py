"""Refit to a stated tolerance: as few knots more than the file's own as the moved nodes ask for (paper eq. 3).

The displacement of the nodes is fitted on the net as it was read. Where the surface stays too far from its nodes, knots are
inserted: in u or v, whichever direction's own residual is the larger there, and never where the nodes would not determine
the control points (Schoenberg and Whitney 1953). Once the tolerance holds, knots that are not needed are taken out again, the
cheapest first: knot removal (Lyche and Moerken 1987; Tiller 1992), judged by the fit on the smaller net.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError
from .between import between_nodes
from .matrices import breakpoints, design_matrix
from .net_fit import SINGULAR, Constraint, NetFit, NodeField, fit_net, project
from .refine import SAME_KNOT, insert_knots
from .refit import RefitError
from .surface import BSplineSurface

Array = NDArray[np.float64]

Outcome = Literal["within", "limit", "nodes"]

SHARE = 0.3
"""Spans whose residual is at least this part of the worst one's get a knot in the same round."""

MOST_ROUNDS = 60
"""Rounds of insertion; each halves the worst spans, so that a span can be cut finer than any node spacing."""

CYCLES = 3
"""Where the limit of control points stops a fit, knots that do little there make room for others, so often."""

WORSE = 1.02
"""Where the tolerance cannot be met, knots that do less than this are taken out all the same."""

EDGE = 0.15
"""A knot keeps this part of its span away from the span's ends."""


@dataclass(frozen=True, slots=True)
class Goal:
    """How near a refit must come, and what it may take.

    tolerance : the largest distance of a counted node from the surface. threshold : nodes that moved less did not move.
    max_control_points : of the net. refine : False keeps the net as it was read.
    """

    tolerance: float
    threshold: float
    max_control_points: int
    refine: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class ToleranceFit:
    """A refit to tolerance.

    fit : on the last net. knots : the knots that were inserted along u and along v. error : distance of the surface from
    the nodes that count. between : how far the surface leaves, between the nodes, what is known of the displacement there.
    outcome : "within" the tolerance; else what kept the fit from it: the "limit" of control points, or the "nodes", which
    determine no finer net or are held apart from the surface.
    """

    fit: NetFit
    knots: tuple[Array, Array]
    error: RefitError
    between: float
    outcome: Outcome

    @property
    def surface(self) -> BSplineSurface:
        """The refit surface: the one that was read with these knots more, and its control points moved."""
        return self.fit.moved


def fit_to_tolerance(
    surface: BSplineSurface,
    field: NodeField,
    goal: Goal,
    *,
    constraint: Constraint | None = None,
    kept: tuple[Array, Array] | None = None,
    start: tuple[Array, Array] | None = None,
) -> ToleranceFit:
    """Fit the nodes' displacement on the net of `surface`, refined until no counted node is too far away.

    constraint : control points whose displacement is given, for any net. kept : knots (u, v) that are inserted first and
    never taken out. start : knots that are tried first and may be taken out.
    Raises GeometryError when the nodes do not determine the net that was read with the knots that are kept, or when that has
    more control points than it may.
    """
    none = np.zeros(0), np.zeros(0)
    search = _Search(surface, field, goal, constraint, kept or none)
    search.begin(_others(start, kept, surface.domain) if start and kept else start or none)
    if not goal.refine:
        return search.result()
    for _ in range(CYCLES):
        search.grow()
        search.limited = search.limited and search.worst > goal.tolerance
        search.allow()
        search.thin()
        search.merge()
        if not search.limited:
            break
    return search.result()


def _others(
    start: tuple[Array, Array], kept: tuple[Array, Array], domain: tuple[tuple[float, float], tuple[float, float]]
) -> tuple[Array, Array]:
    """Those knots of `start` that are not among `kept`, to rounding."""
    found = []
    for new, there, (low, high) in zip(start, kept, domain, strict=True):
        away = np.abs(new[:, None] - there).min(axis=1, initial=np.inf)
        found.append(new[away > SAME_KNOT * (high - low)])
    return found[0], found[1]


def judged(
    fit: NetFit, knots: tuple[Array, Array], field: NodeField, goal: Goal, else_: Outcome = "nodes"
) -> ToleranceFit:
    """What a fit with these knots is worth; else_ : its outcome where the tolerance does not hold."""
    error = node_error(fit, field)
    return ToleranceFit(
        fit, knots, error, between_nodes(fit, field), "within" if error.maximum <= goal.tolerance else else_
    )


@dataclass(slots=True, eq=False)
class _Search:
    """One search for knots.

    knots : inserted so far, beyond `kept`. fit : the fit with them; worst : its largest error; lacking : of what
    is asked along curves. allowed (m, n), swing, short : how far the nodes, what lies between them and what is asked may be off
    while knots are taken out. limited : a wanted knot found no room.
    """

    surface: BSplineSurface
    nodes: NodeField
    goal: Goal
    constraint: Constraint | None
    kept: tuple[Array, Array]
    knots: tuple[Array, Array] = (np.zeros(0), np.zeros(0))
    fit: NetFit = field(init=False)
    worst: float = np.inf
    lacking: Array = field(init=False)
    allowed: Array = field(init=False)
    swing: float = 0.0
    short: float = 1.0
    limited: bool = False

    def begin(self, start: tuple[Array, Array]) -> None:
        # a net as it was read is as good as it is
        read = not sum(len(knots) for knots in (*start, *self.kept))
        r, s = (self.surface.shape[k] + len(self.kept[k]) + len(start[k]) for k in (0, 1))
        if not read and r * s > self.goal.max_control_points:
            raise GeometryError(
                f"{r} x {s} control points, more than {self.goal.max_control_points}",
                where=self.surface.name or "surface",
                mend="raise refit.max_control_points",
            )
        self._take(start, self._fit(start, worst_condition=SINGULAR if read else None))

    def _fit(self, knots: tuple[Array, Array], worst_condition: float | None = None) -> NetFit:
        every = [np.sort(np.concatenate([self.kept[k], knots[k]])) for k in (0, 1)]
        net = insert_knots(self.surface, *every)
        return fit_net(
            net,
            self.nodes,
            self.goal.threshold,
            self.constraint,
            worst_condition=worst_condition,
            tolerance=self.goal.tolerance,
        )

    def _take(self, knots: tuple[Array, Array], fit: NetFit) -> None:
        self.knots, self.fit, self.worst = knots, fit, node_error(fit, self.nodes).maximum
        self.lacking = fit.lacking()

    def result(self) -> ToleranceFit:
        every = tuple(np.sort(np.concatenate([self.kept[k], self.knots[k]])) for k in (0, 1))
        return judged(self.fit, (every[0], every[1]), self.nodes, self.goal, "limit" if self.limited else "nodes")

    # -------------------------------------------------------------------- insert

    def grow(self) -> None:
        """Insert knots until the tolerance holds or no more can be."""
        self.limited = False
        idle = 0
        for _ in range(MOST_ROUNDS):
            near, lacking = self.worst <= self.goal.tolerance, float(self.lacking.max(initial=0.0))
            if (near and (lacking <= 1.0 or idle == 2)) or not self.insert():
                return
            # along a curve each halving of spans should help a lot: where it does not, the nodes end what can be had
            idle = idle + 1 if near and self.lacking.max(initial=0.0) > 0.5 * lacking else 0

    def insert(self) -> bool:
        """Insert knots where the residual is too large; False when none can be."""
        wanted = self._wanted()
        while wanted:
            chosen = [t for t in wanted if t[0] >= SHARE * wanted[0][0]]
            knots = self._within_limit(chosen)
            for trial in self._fewer(knots):
                fit = self._tried(trial)
                if fit is not None:
                    self._take(trial, fit)
                    return True
            wanted = [] if self.limited else wanted[len(chosen) :]
        return False

    def _wanted(self) -> list[tuple[float, int, float]]:
        """(residual, axis, knot) for each span where nodes are too far away, the worst first."""
        distance = np.where(self.nodes.counted, np.linalg.norm(self.fit.residual, axis=2), 0.0)
        off = distance > self.goal.tolerance
        along = self.fit.split(self.nodes)
        # a little for either direction: near control points that are given, neither may have a residual of its own
        parts = [part**2 + 1e-2 * distance**2 for part in along]
        share = parts[0] / np.maximum(parts[0] + parts[1], 1e-300)
        found: list[tuple[float, float, int]] = []
        for axis in (0, 1):
            score = np.where(off, distance * (share if axis == 0 else 1.0 - share), 0.0)
            score = score if axis == 0 else score.T
            t = (self.nodes.u, self.nodes.v)[axis]
            found += [(*item, axis) for item in self._spans(axis, t, score.max(axis=1), (score**2).sum(axis=1))]
        if not found:
            found = self._wanted_along_curves()
        return sorted(((size, axis, knot) for size, knot, axis in found), key=lambda item: (-item[0], item[1], item[2]))

    def _wanted_along_curves(self) -> list[tuple[float, float, int]]:
        """(residual, knot, axis) where a curve that is asked for is too far, in the direction of the spans it crosses."""
        net, found = self.fit.surface, []
        spans = [len(breakpoints(k, p)) - 1 for k, p in ((net.knots_u, net.degree_u), (net.knots_v, net.degree_v))]
        reach = np.diff(np.array(net.domain), axis=1)[:, 0]
        for item in self.fit.asked:
            if len(item.uv) < 2:
                continue
            off = np.linalg.norm(self.fit.along(item.uv, item.direction) - item.value, axis=1) / item.tolerance
            off = np.where(off > 1.0, off, 0.0)
            step = np.abs(np.gradient(item.uv, axis=0)) / reach * spans
            for axis in (0, 1):
                mine = np.where(step[:, axis] >= 0.5 * step[:, 1 - axis], off, 0.0)
                found += [(*spot, axis) for spot in self._spans(axis, item.uv[:, axis], mine, mine**2)]
        return found

    def _spans(self, axis: int, t: Array, most: Array, squared: Array) -> Iterator[tuple[float, float]]:
        """The largest residual of each knot span along an axis, with the knot that would halve it best; most, squared (n,) :
        the largest residual and the sum of its squares at the parameters t (n,)."""
        net = self.fit.surface
        borders = breakpoints((net.knots_u, net.knots_v)[axis], (net.degree_u, net.degree_v)[axis])
        nodes = (self.nodes.u, self.nodes.v)[axis]
        span = np.clip(np.searchsorted(borders, t, side="right") - 1, 0, len(borders) - 2)
        slack = SAME_KNOT * (borders[-1] - borders[0])
        room = [
            nodes[(nodes > a + slack) & (nodes < b - slack)] for a, b in zip(borders[:-1], borders[1:], strict=True)
        ]
        for k in np.unique(span[most > 0.0]):
            size = float(most[span == k].max())
            if not len(room[k]):
                # no knot fits here: one in a span beside it helps as well, if less
                for beside in (k - 1, k + 1):
                    if 0 <= beside < len(room) and len(room[beside]):
                        yield 0.5 * size, float(room[beside][len(room[beside]) // 2])
                continue
            a, b = borders[k], borders[k + 1]
            here = np.flatnonzero((span == k) & (squared > 0.0))
            here = here[np.argsort(t[here], kind="stable")]
            half = np.searchsorted(np.cumsum(squared[here]), 0.5 * squared[here].sum())
            knot = float(np.clip(t[here[half]], a + EDGE * (b - a), b - EDGE * (b - a)))
            if not ((nodes > a) & (nodes <= knot)).any() or not ((nodes > knot) & (nodes <= b)).any():
                knot = float(room[k][len(room[k]) // 2])
            yield size, knot

    def _within_limit(self, chosen: list[tuple[float, int, float]]) -> tuple[Array, Array]:
        """The knots so far and as many of the chosen ones, the worst first, as the limit of control points allows."""
        knots = [list(self.knots[0]), list(self.knots[1])]
        for _, axis, knot in chosen:
            if knot in knots[axis]:
                continue
            knots[axis].append(knot)
            r, s = (self.surface.shape[k] + len(self.kept[k]) + len(knots[k]) for k in (0, 1))
            if r * s > max(self.goal.max_control_points, self.surface.shape[0] * self.surface.shape[1]):
                knots[axis].pop()
                self.limited = True
        return np.sort(knots[0]), np.sort(knots[1])

    def _fewer(self, knots: tuple[Array, Array]) -> Iterator[tuple[Array, Array]]:
        """All the knots; where the nodes do not determine that net, those along one direction, then one at a time."""
        new = [np.setdiff1d(knots[k], self.knots[k]) for k in (0, 1)]
        if not len(new[0]) + len(new[1]):
            return
        yield knots
        if len(new[0]) and len(new[1]):
            yield knots[0], self.knots[1]
            yield self.knots[0], knots[1]
        if len(new[0]) + len(new[1]) > 1:
            for knot in new[0]:
                yield np.sort(np.append(self.knots[0], knot)), self.knots[1]
            for knot in new[1]:
                yield self.knots[0], np.sort(np.append(self.knots[1], knot))

    def _tried(self, knots: tuple[Array, Array]) -> NetFit | None:
        try:
            return self._fit(knots)
        except GeometryError:
            return None

    # ---------------------------------------------------------------------- thin

    def allow(self) -> None:
        """Note what taking knots out may not spoil: the tolerance where it holds, and what there is where it does not."""
        self.allowed = np.maximum(self.goal.tolerance, WORSE * np.linalg.norm(self.fit.residual, axis=2))
        self.swing = max(self.goal.tolerance, WORSE * between_nodes(self.fit, self.nodes))
        self.short = max(1.0, WORSE * float(self.lacking.max(initial=0.0)))

    def thin(self) -> None:
        """Take knots out, the cheapest first, as long as what is allowed holds."""
        needed: set[tuple[int, float]] = set()
        costs = self._costs()
        size = len(costs)
        while costs := [item for item in costs if item[1:] not in needed]:
            batch = costs[: max(1, size)]
            fit = self._tried(trial := self._without(batch))
            if fit is not None and self._holds(fit):
                self._take(trial, fit)
                costs, size = self._costs(), len(batch)
                continue
            if len(batch) == 1:
                needed.add(batch[0][1:])
            size = max(1, len(batch) // 2)

    def merge(self) -> None:
        """Put one knot in the middle of two neighbours in their place, as long as what is allowed holds."""
        tried: set[tuple[int, float, float]] = set()
        while True:
            pairs = sorted(
                (float(b - a), axis, float(a), float(b))
                for axis in (0, 1)
                for a, b in zip(self.knots[axis][:-1], self.knots[axis][1:], strict=True)
                if (axis, float(a), float(b)) not in tried
            )
            if not pairs:
                return
            _, axis, a, b = pairs[0]
            tried.add((axis, a, b))
            middle, slack = 0.5 * (a + b), SAME_KNOT * float(np.diff(self.surface.domain[axis])[0])
            if np.abs(self._net_knots(axis) - middle).min() <= slack:
                continue
            merged = np.sort(np.append(np.setdiff1d(self.knots[axis], [a, b]), middle))
            trial = (merged, self.knots[1]) if axis == 0 else (self.knots[0], merged)
            fit = self._tried(trial)
            if fit is not None and self._holds(fit):
                self._take(trial, fit)

    def _net_knots(self, axis: int) -> Array:
        return (self.fit.surface.knots_u, self.fit.surface.knots_v)[axis]

    def _holds(self, fit: NetFit) -> bool:
        distance = np.linalg.norm(fit.residual, axis=2)
        near = (distance <= self.allowed) | ~self.nodes.counted
        if not near.all() or fit.lacking().max(initial=0.0) > self.short:
            return False
        return between_nodes(fit, self.nodes) <= self.swing

    def _without(self, batch: list[tuple[float, int, float]]) -> tuple[Array, Array]:
        gone = [[knot for _, axis, knot in batch if axis == k] for k in (0, 1)]
        return np.setdiff1d(self.knots[0], gone[0]), np.setdiff1d(self.knots[1], gone[1])

    def _costs(self) -> list[tuple[float, int, float]]:
        """(cost, axis, knot) of the inserted knots: what the nodes lose when it goes, for each control point that goes."""
        fit, found = self.fit, []
        data = self.nodes.displacement * fit.W[..., None]
        for axis in (0, 1):
            net = fit.surface
            knots, degree = ((net.knots_u, net.degree_u), (net.knots_v, net.degree_v))[axis]
            t = (self.nodes.u, self.nodes.v)[axis]
            values = data if axis == 0 else np.swapaxes(data, 0, 1)
            counted = self.nodes.counted if axis == 0 else self.nodes.counted.T
            scale = fit.W if axis == 0 else fit.W.T
            now = project(_columns(knots, degree, t), values)
            for knot in self.knots[axis]:
                fewer = np.delete(knots, int(np.argmin(np.abs(knots - knot))))
                loss = np.linalg.norm(now - project(_columns(fewer, degree, t), values), axis=2) / scale
                found.append((float(loss[counted].max(initial=0.0)) / net.shape[1 - axis], axis, float(knot)))
        return sorted(found)


def _columns(knots: Array, degree: int, t: Array) -> Array:
    basis = design_matrix(knots, degree, t)
    return basis[:, basis.any(axis=0)]


def node_error(fit: NetFit, field: NodeField) -> RefitError:
    """Distance between the nodes that count and the surface of the fit."""
    distance = np.linalg.norm(fit.residual, axis=2)[field.counted]
    if not distance.size:
        return RefitError(0.0, 0.0)
    return RefitError(float(distance.max()), float(np.sqrt(np.mean(distance**2))))
