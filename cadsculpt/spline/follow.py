"""A face that follows another along their common edge: the displacement there is given, not found.

Where the edge is a whole side of the face's domain, its boundary row of control points is solved once, for the other face's
own curve, and the fit inside takes it (for G1 the next row too): the seam is closed to rounding where the net has the other
face's knots, and to the fit of the curve where it has not. Elsewhere the displacement is asked for along the edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .equations import Asked, displacement_along
from .hold import Hold
from .joints import joints, unknowns
from .matrices import breakpoints, design_matrix
from .net_fit import Given, NodeField
from .refine import SAME_KNOT, insert_knots
from .surface import BSplineSurface

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ON_SIDE = 1e-7
"""An edge this near to a side of the domain, as a part of the domain, is that side."""

MOST_ROUNDS = 40

HALVINGS = 8
"""Times that the spans beside a corner are halved where two tangents meet there."""

FIRMLY = 1e6
"""How much more what is given of a row weighs than what it is fitted to."""

MOST_PIECES = 4
"""A span is cut into no more pieces at once."""

LEAST = 1e-4
"""A span that is off by a smaller share of the tolerance is taken for one that is off by this: rounding is no curvature."""

SURE = 0.8
"""How near a curve must come by its own knots, in tolerances: those that the nodes ask for later change it a little."""

SPREADS = 16
"""Tries to follow with knots that are spread."""

LARGER = 1.05
"""Where knots were too few the next try has more, by this beyond what their order of convergence asks for."""


@dataclass(frozen=True, slots=True, eq=False)
class Lead:
    """What a face must do along an edge, or at a point.

    uv (n, 2) : places on the face, in order along the edge. displacement (n, 3) : of the leading face there. tolerance : how
    near the face must come. across (n, 3), slack (n,) : the derivative, in the direction (n, 2) of (u, v), that keeps the faces
    tangent, and how near it must come; None when that is not asked. knots (k,) : where the leading face's curve has knots, as
    parameters along the following face's side.
    """

    uv: Array
    displacement: Array
    tolerance: float
    across: Array | None = None
    direction: Array | None = None
    slack: Array | None = None
    knots: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, slots=True)
class Side:
    """A side of the domain: the end (0 or 1) of `axis` that an edge runs along."""

    axis: int
    end: int


def side_of(surface: BSplineSurface, uv: Array) -> Side | None:
    """The side that a chain uv (n, 2) runs along from corner to corner, if there the boundary row alone is the boundary."""
    if len(uv) < 2:
        return None
    for axis in (0, 1):
        low, high = surface.domain[axis]
        first, last = surface.domain[1 - axis]
        t = uv[:, 1 - axis]
        whole = np.ptp(t) >= (1.0 - ON_SIDE) * (last - first)
        for end, place in enumerate((low, high)):
            if whole and np.abs(uv[:, axis] - place).max() <= ON_SIDE * (high - low) and _clamped(surface, axis, end):
                return Side(axis, end)
    return None


def _clamped(surface: BSplineSurface, axis: int, end: int) -> bool:
    """Whether the surface at this end of its domain is a curve of its boundary row alone."""
    if (surface.periodic_u, surface.periodic_v)[axis]:
        return False
    knots = (surface.knots_u, surface.knots_v)[axis]
    degree = (surface.degree_u, surface.degree_v)[axis]
    ends = knots[: degree + 1] if end == 0 else knots[-degree - 1 :]
    return bool(ends[0] == ends[-1]) or (knots[1] == knots[degree] if end == 0 else knots[-2] == knots[-degree - 1])


@dataclass(frozen=True, slots=True, eq=False)
class Following:
    """All that is given of a face's fit: what is held, what it follows, and the sides along which its tangents stay where no
    edge asks otherwise."""

    hold: Hold
    leads: tuple[Lead, ...]
    flat: tuple[Array, ...] = ()

    def given(self, net: BSplineSurface) -> Given:
        """For a net, the control points that are given and what is asked of the others."""
        held = self.hold.control_points(net)
        values, mask = side_values(net, self.leads, held, self.flat)
        asked: list[Asked] = []
        for lead in self.leads:
            if side_of(net, lead.uv) is None and corner_point(net, lead.uv) is None:
                asked.append(Asked(lead.uv, lead.displacement, np.full(len(lead.uv), lead.tolerance)))
                if lead.across is not None and lead.direction is not None and lead.slack is not None:
                    asked.append(Asked(lead.uv, lead.across, lead.slack, lead.direction))
        return Given(mask, values if self.leads else None, tuple(asked))


def side_values(
    net: BSplineSurface, leads: Sequence[Lead], held: Mask | None = None, flat: Sequence[Array] = ()
) -> tuple[Array, Mask]:
    """The displacements (r, s, 3) of the control points on sides and corners that leads give, and of those that are held, and
    which those are (r, s).

    The edges come first, so that they stay closed wherever two meet; then the tangents stay along the sides `flat`; those
    across the edges take what is left, and where two of these give one control point, beside a corner, their mean.
    """
    mask = np.zeros(net.shape, dtype=np.bool_) if held is None else held.copy()
    values, times = np.zeros((*net.shape, 3)), np.zeros(net.shape)
    sides = [(side, lead) for lead in leads if (side := side_of(net, lead.uv)) is not None]
    for side, lead in sides:
        _share(values, times, mask, _row(net, side, 0), _edge_row(net, side, lead))
    for lead in leads:
        if side_of(net, lead.uv) is None and (corner := corner_point(net, lead.uv)) is not None:
            _share(values, times, mask, corner, lead.displacement[0])
    if held is not None:
        values[held] = 0.0
    for chain in flat:
        if (side := side_of(net, chain)) is not None and net.shape[side.axis] > 2:
            mask[_row(net, side, 1)] = True
    known, edges = mask.copy(), values.copy()
    times[:] = 0.0
    for side, lead in sides:
        if lead.across is None or net.shape[side.axis] < 3:
            continue
        index, fixed = _row(net, side, 1), known[_row(net, side, 1)]
        row = _tangent_row(net, side, lead, edges[_row(net, side, 0)], fixed, edges[index])
        _share(values, times, mask, index, row)
    values[known] = edges[known]
    return values, mask


def _share(values: Array, times: Array, mask: Mask, index: tuple[int | slice, ...], row: Array) -> None:
    """Give control points a displacement; where several are given, their mean."""
    times[index] += 1.0
    values[index] += (row - values[index]) / (times[index][..., None] if np.ndim(times[index]) else times[index])
    mask[index] = True


def _row(net: BSplineSurface, side: Side, depth: int) -> tuple[int | slice, ...]:
    place = depth if side.end == 0 else net.shape[side.axis] - 1 - depth
    return (place, slice(None)) if side.axis == 0 else (slice(None), place)


def corner_point(net: BSplineSurface, uv: Array) -> tuple[int, int] | None:
    """The control point that is the surface at a single place uv (1, 2), if it is a corner of a clamped domain."""
    if len(uv) != 1:
        return None
    index = []
    for axis in (0, 1):
        low, high = net.domain[axis]
        ends = [e for e, t in enumerate((low, high)) if abs(uv[0, axis] - t) <= ON_SIDE * (high - low)]
        if not ends or not _clamped(net, axis, ends[0]):
            return None
        index.append(0 if ends[0] == 0 else net.shape[axis] - 1)
    return index[0], index[1]


def boundary_rows(net: BSplineSurface, side: Side, lead: Lead) -> list[Array]:
    """Displacements (count, 3) of the boundary row for which its curve is nearest to the lead's, and of the next row."""
    rows = [_edge_row(net, side, lead)]
    if lead.across is not None and net.shape[side.axis] > 2:
        rows.append(_tangent_row(net, side, lead, rows[0]))
    return rows


def _side_bases(net: BSplineSurface, side: Side, lead: Lead) -> tuple[Array, Array, Array, Array, Array]:
    """Along a side: the basis (n, count) at the lead's places and its slope, the lift T of the free rows, and the weights of
    the boundary row and of the next."""
    along = 1 - side.axis
    knots, degree = _direction(net, along)
    t = np.clip(lead.uv[:, along], *net.domain[along])
    weights = np.ones(net.shape) if net.weights is None else net.weights
    w = np.moveaxis(weights, side.axis, 0)
    end, step = (0, 1) if side.end == 0 else (-1, -1)
    T = unknowns(net, along, [], joints(net, along))
    return design_matrix(knots, degree, t), design_matrix(knots, degree, t, 1), T, w[end], w[end + step]


def _edge_row(net: BSplineSurface, side: Side, lead: Lead) -> Array:
    """The boundary row for which its curve is nearest to the lead's."""
    basis, _, T, w0, _ = _side_bases(net, side, lead)
    W = basis @ w0
    return T @ _fitted(basis @ T, lead.displacement * W[:, None]) / w0[:, None]


def _tangent_row(
    net: BSplineSurface,
    side: Side,
    lead: Lead,
    edge: Array,
    fixed: Mask | None = None,
    known: Array | None = None,
) -> Array:
    """The row behind a boundary row `edge` (count, 3) for which the slope across it is nearest to the lead's; fixed : control
    points of it that have the displacements `known` (count, 3)."""
    assert lead.across is not None
    assert lead.direction is not None
    axis, along = side.axis, 1 - side.axis
    basis, slope, T, w0, w1 = _side_bases(net, side, lead)
    end, step = (0, 1) if side.end == 0 else (-1, -1)
    q0, W = edge * w0[:, None], basis @ w0
    # D = Q / W; across the edge only the two outermost rows have a slope
    across_knots, across_degree = _direction(net, axis)
    slopes = design_matrix(across_knots, across_degree, np.array([net.domain[axis][side.end]]), 1)[0]
    s0, s1 = float(slopes[end]), float(slopes[end + step])
    D = (basis @ q0) / W[:, None]
    D_along = (slope @ q0 - D * (slope @ w0)[:, None]) / W[:, None]
    a, b = lead.direction[:, axis, None], lead.direction[:, along, None]
    wanted = (lead.across - b * D_along) / a
    W_across = s0 * W + s1 * (basis @ w1)
    values = (wanted * W[:, None] + D * W_across[:, None] - s0 * (basis @ q0)) / s1
    matrix = basis @ T
    if fixed is not None and known is not None and fixed.any():
        matrix = np.concatenate([matrix, FIRMLY * T[fixed]])
        values = np.concatenate([values, FIRMLY * known[fixed] * w1[fixed, None]])
    return T @ _fitted(matrix, values) / w1[:, None]


def _off(net: BSplineSurface, side: Side, lead: Lead) -> Array:
    """How far the rows of a side are from what the lead asks, over its tolerance, at its places: (n,)."""
    values = np.zeros((*net.shape, 3))
    for depth, row in enumerate(boundary_rows(net, side, lead)):
        values[_row(net, side, depth)] = row
    return off_lead(net, values, lead)


def off_lead(net: BSplineSurface, displacement: Array, lead: Lead) -> Array:
    """How far displacements (r, s, 3) of the control points are from what a lead asks, over its tolerance, at its places."""
    apart = displacement_along(net, displacement, lead.uv) - lead.displacement
    away = np.sqrt(np.einsum("nc,nc->n", apart, apart)) / lead.tolerance
    if lead.across is None or lead.direction is None or lead.slack is None:
        return away
    turned = displacement_along(net, displacement, lead.uv, lead.direction) - lead.across
    return np.maximum(away, np.sqrt(np.einsum("nc,nc->n", turned, turned)) / lead.slack)


def _fitted(basis: Array, values: Array) -> Array:
    return np.asarray(np.linalg.lstsq(basis, values, rcond=1e-12)[0], dtype=np.float64)


def _direction(net: BSplineSurface, axis: int) -> tuple[Array, int]:
    return (net.knots_u, net.knots_v)[axis], (net.degree_u, net.degree_v)[axis]


def edge_knots(
    surface: BSplineSurface, field: NodeField, leads: Sequence[Lead], most_control_points: int, *, strict: bool = False
) -> tuple[Array, Array]:
    """The knots (u, v) that a face needs along its sides to follow its leads: theirs, and more until it is near enough.

    Those that are not the leads' own have a node of `field` on either side: the nodes must determine the rows inside as well.
    strict : so must all.
    """
    found = [np.zeros(0), np.zeros(0)]
    for lead in leads:
        side = side_of(surface, lead.uv)
        if side is None:
            continue
        along = 1 - side.axis
        nodes = (field.u, field.v)[along]
        theirs = _joined(surface, along, found[along], np.sort(lead.knots), nodes if strict else None)
        most = most_control_points // (surface.shape[1 - along] + len(found[1 - along])) - surface.shape[along]
        search = _EdgeSearch(surface, side, lead, nodes, found[1 - along], theirs, most)
        found[along] = search.found()
    if any(lead.across is not None for lead in leads):
        found = _beside_corners(surface, field, leads, found, most_control_points)
    return found[0], found[1]


def _beside_corners(
    surface: BSplineSurface, field: NodeField, leads: Sequence[Lead], found: list[Array], most_control_points: int
) -> list[Array]:
    """More knots beside the corners where two sides ask their tangents of one control point: it reaches no farther then."""
    sides = [
        (side, lead) for lead in leads if (side := side_of(surface, lead.uv)) is not None and lead.across is not None
    ]
    corners = {(a.end, b.end) for a, _ in sides for b, _ in sides if a.axis == 1 and b.axis == 0}
    # (the side of axis 1 is at an end of v and runs along u; the corner is at the ends of both)
    before = np.inf
    for _ in range(HALVINGS if corners else 0):
        net = insert_knots(surface, *found)
        values, _ = side_values(net, leads)
        worst = max(float(off_lead(net, values, lead).max()) for _, lead in sides)
        if worst <= 1.0 or worst > 0.9 * before:
            break
        before, more = worst, list(found)
        for v_end, u_end in sorted(corners):
            for axis, end in ((0, u_end), (1, v_end)):
                borders = breakpoints(*_direction(net, axis))
                a, b = borders[:2] if end == 0 else borders[-2:]
                nodes = (field.u, field.v)[axis]
                more[axis] = _joined(surface, axis, more[axis], np.array([0.5 * (a + b)]), nodes)
        shape = [surface.shape[k] + len(more[k]) for k in (0, 1)]
        if shape[0] * shape[1] > most_control_points or all(len(m) == len(f) for m, f in zip(more, found, strict=True)):
            break
        found = more
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _EdgeSearch:
    """A search for the knots along a side with which it follows a lead: `known`, and no more than `most`.

    across : the knots of the other direction. nodes : parameters along the side, one of which must be on either side of a knot.
    """

    surface: BSplineSurface
    side: Side
    lead: Lead
    nodes: Array
    across: Array
    known: Array
    most: int

    @property
    def along(self) -> int:
        return 1 - self.side.axis

    def found(self) -> Array:
        """Spans that are too far off are cut until none is; then the knots are spread so that all are off alike."""
        knots, off = self.known, self._off(self.known)
        idle = 0
        for _ in range(MOST_ROUNDS):
            if off.max() <= SURE or idle > 1:
                break
            more = self._joined(knots, self._cuts(knots, off))
            if len(more) == len(knots) or len(more) > self.most:
                break
            before, knots, off = float(off.max()), more, self._off(more)
            # where cutting does not help the curve is none that this net has: what is left is told as a gap
            idle = idle + 1 if off.max() > 0.5 * before else 0
        return self._spread(knots, off / SURE) if off.max() <= SURE else knots

    def _net(self, knots: Array) -> BSplineSurface:
        return insert_knots(self.surface, *((knots, self.across) if self.along == 0 else (self.across, knots)))

    def _off(self, knots: Array) -> Array:
        return _off(self._net(knots), self.side, self.lead)

    def _joined(self, knots: Array, wanted: Array) -> Array:
        return _joined(self.surface, self.along, knots, wanted, self.nodes)

    def _spans(self, knots: Array, off: Array) -> tuple[Array, Array]:
        """The borders of the net's spans, and how far each is off."""
        borders = np.union1d(breakpoints(*_direction(self.surface, self.along)), knots)
        t = np.clip(self.lead.uv[:, self.along], *self.surface.domain[self.along])
        span = np.clip(np.searchsorted(borders, t, side="right") - 1, 0, len(borders) - 2)
        worst = np.zeros(len(borders) - 1)
        np.maximum.at(worst, span, off)
        return borders, worst

    def _cuts(self, knots: Array, off: Array) -> Array:
        """Where to cut the spans that are too far off, in two, or in as many as their order of convergence asks for."""
        borders, worst = self._spans(knots, off)
        order = _direction(self.surface, self.along)[1] + 1
        cuts: list[float] = []
        for k in np.flatnonzero(worst > SURE):
            pieces = int(np.clip(np.ceil(worst[k] ** (1.0 / order)), 2, MOST_PIECES))
            cuts += list(np.linspace(borders[k], borders[k + 1], pieces + 1)[1:-1])
        return np.array(cuts)

    def _spread(self, knots: Array, off: Array) -> Array:
        """As few knots as can be beside those that are known: each span takes an equal share of what the curve asks for there
        (de Boor 1974), which grows where a try was too far off; those there are where no try has fewer."""
        order = _direction(self.surface, self.along)[1] + 1
        fixed = np.union1d(breakpoints(*_direction(self.surface, self.along)), self.known)
        borders, worst = self._spans(knots, off)
        asked = np.maximum(worst, LEAST) ** (1.0 / order)
        for _ in range(SPREADS):
            need = np.concatenate([[0.0], np.cumsum(asked)])
            ends = np.interp(fixed, borders, need)
            wanted: list[float] = []
            for low, high in zip(ends[:-1], ends[1:], strict=True):
                pieces = max(1, int(np.ceil(high - low)))
                wanted += list(np.interp(low + (high - low) * np.arange(1, pieces) / pieces, need, borders))
            fewer = self._joined(self.known, self._at_nodes(np.array(wanted)))
            if len(fewer) >= len(knots):
                break
            now = self._off(fewer) / SURE
            if now.max() <= 1.0:
                return fewer
            ends, worst = self._spans(fewer, now)
            # a span of the try holds several of those that what is asked is known of
            first, last = (np.searchsorted(ends, borders[:-1], "right") - 1, np.searchsorted(ends, borders[1:], "left"))
            here = np.array([worst[i:j].max() for i, j in zip(first, last, strict=True)])
            asked *= np.where(here > 1.0, LARGER * here ** (1.0 / order), 1.0)
        return knots

    def _at_nodes(self, wanted: Array) -> Array:
        """The nodes nearest to ascending places, each once: knots at nodes have one on either side."""
        nearest = np.abs(wanted[:, None] - self.nodes).argmin(axis=1)
        step = np.arange(len(nearest))
        apart = np.maximum.accumulate(nearest - step) + step
        return self.nodes[apart[apart < len(self.nodes)]]


def follows(net: BSplineSurface, leads: Sequence[Lead]) -> bool:
    """Whether the net can do along its sides what its leads ask, all together."""
    values, _ = side_values(net, leads)
    return all(bool((off_lead(net, values, lead) <= 1.0).all()) for lead in leads if side_of(net, lead.uv) is not None)


def follows_with_its_knots(surface: BSplineSurface, lead: Lead) -> bool:
    """Whether a face follows a lead along one of its sides with the leading face's knots alone."""
    side = side_of(surface, lead.uv)
    if side is None:
        return False
    none = np.zeros(0)
    knots = _joined(surface, 1 - side.axis, none, np.sort(lead.knots), None)
    net = insert_knots(surface, *((knots, none) if side.axis == 1 else (none, knots)))
    return bool((_off(net, side, lead) <= 1.0).all())


def _joined(surface: BSplineSurface, axis: int, known: Array, wanted: Array, nodes: Array | None) -> Array:
    """The known knots and those of the wanted ones that are no knots yet with a node on either side."""
    low, high = surface.domain[axis]
    own = breakpoints(*_direction(surface, axis))
    slack = SAME_KNOT * (high - low)
    result = list(known)
    for t in wanted:
        borders = np.sort(np.concatenate([own, result]))
        if not low + slack < t < high - slack or np.abs(borders - t).min() <= slack:
            continue
        k = int(np.searchsorted(borders, t))
        a, b = borders[k - 1], borders[k]
        if nodes is None or (((nodes > a) & (nodes <= t)).any() and ((nodes > t) & (nodes <= b)).any()):
            result.append(float(t))
    return np.sort(result)
