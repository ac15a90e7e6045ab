"""Where the nodes of the lattice stand in (u, v), and a net fine enough to follow them.

The nodes are independent of the points that collision uses (paper section 4.8). Along each direction every knot span is
cut into cells of equal length in space. Where a tool comes, knots are inserted (exactly: the shape does not change): at the
nodes for an odd degree, between them for an even one, few enough for the nodes to determine the net (Schoenberg and
Whitney 1953). The surface can then follow the nodes wherever they go. With fewer knots the lattice has motions that the
surface, and so the contact, does not see, and soft plastic material buckles into them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError, InputError
from ..spline.matrices import breakpoints, design_matrix
from ..spline.refine import insert_knots
from ..spline.refit import folded, sliver_ties
from ..spline.surface import BSplineSurface

Array = NDArray[np.float64]

Span = tuple[float, float]

SLIVER = 0.05
"""A knot span narrower than this share of the node spacing gets no node: its two sides move as one."""

MOST_NODES = 400_000
"""Nodes on one patch's surface; above this a lattice takes minutes a step and the spacing is surely a slip."""


HALVINGS = 6
"""Times that cells are halved for the nodes to determine the net."""

STRIDES = (1, 2, 3, 4, 6, 8)
"""Nodes per inserted knot, tried in this order until the net has few enough control points and is determined."""

WORST_CONDITION = 1e7
"""Condition number of a direction's basis above which a refit would amplify rounding to what a user could see."""


@dataclass(frozen=True, slots=True, eq=False)
class NodeGrid:
    """Node parameters u (nu,) and v (nv,) of one patch, and its surface with the knots that they need.

    wrap_u, wrap_v : the direction is closed; its last node is the first one, and is left out.
    window : ((u0, u1), (v0, v1)), the piece of the domain that carries nodes. slivers : knot spans, along u and along v,
    that are too narrow for a node.
    """

    surface: BSplineSurface
    u: Array
    v: Array
    wrap_u: bool
    wrap_v: bool
    window: tuple[tuple[float, float], tuple[float, float]]
    slivers: tuple[list[Span], list[Span]]


def node_grid(
    surface: BSplineSurface,
    spacing: tuple[float, float],
    *,
    window: tuple[tuple[float, float], tuple[float, float]] | None = None,
    refine: tuple[tuple[float, float], tuple[float, float]] | None = None,
    most_control_points: int = 20_000,
) -> NodeGrid:
    """Nodes about `spacing` apart (along u, along v; the surface's unit) and the refined surface.

    window : the piece of the domain to cover; None is all of it, and a closed direction is always covered whole.
    refine : the piece where knots are inserted, None for nowhere.

    Raises InputError when there would be more than MOST_NODES nodes, GeometryError when the net cannot be refined
    inside `most_control_points`.
    """
    whole = surface.domain
    closed = (surface.closed_u, surface.closed_v)
    asked = window or whole
    window = (whole[0] if closed[0] else asked[0], whole[1] if closed[1] else asked[1])
    # a cut window needs a net that can move inside it and stand still outside
    cut = [window[axis] != whole[axis] for axis in (0, 1)]
    for stride in STRIDES:
        nodes, knots, slivers = [], [], []
        for axis in (0, 1):
            region = window[axis] if cut[axis] else (refine[axis] if refine is not None else None)
            t, new, narrow = _along(surface, axis, spacing[axis], window, region, stride)
            nodes.append(t)
            knots.append(new)
            slivers.append(narrow)
        count = len(nodes[0]) * len(nodes[1])
        if count > MOST_NODES:
            raise InputError(
                f"{len(nodes[0])} x {len(nodes[1])} nodes on one face",
                where=surface.name,
                mend=f"choose a node spacing of {max(spacing) * (count / MOST_NODES) ** 0.5:.3g} or more",
            )
        r, s = surface.shape
        if (r + len(knots[0])) * (s + len(knots[1])) <= max(most_control_points, r * s):
            break
    else:
        raise GeometryError(
            f"a net that follows nodes {spacing[0]:g} x {spacing[1]:g} apart needs more than "
            f"{most_control_points} control points",
            where=surface.name,
            mend="raise the node spacing",
        )
    fine = insert_knots(surface, knots[0], knots[1])
    return NodeGrid(
        fine,
        nodes[0][:-1] if closed[0] else nodes[0],
        nodes[1][:-1] if closed[1] else nodes[1],
        closed[0],
        closed[1],
        window,
        (slivers[0], slivers[1]),
    )


def _along(
    surface: BSplineSurface,
    axis: int,
    spacing: float,
    window: tuple[tuple[float, float], tuple[float, float]],
    refine: tuple[float, float] | None,
    stride: int,
) -> tuple[Array, Array, list[Span]]:
    """Node parameters (n,) along one axis, ends included; the knots to insert, one for every `stride` nodes; the slivers."""
    degree = (surface.degree_u, surface.degree_v)[axis]
    knots = (surface.knots_u, surface.knots_v)[axis]
    low, high = window[axis]
    inner = breakpoints(knots, degree)
    borders = np.concatenate([[low], inner[(inner > low) & (inner < high)], [high]])
    pieces: list[Array] = [borders[:1]]
    slivers: list[Span] = []
    for a, b in zip(borders[:-1], borders[1:], strict=True):
        t, length = _mean_arc_length(surface, axis, a, b, window[1 - axis])
        if length[-1] < SLIVER * spacing and len(borders) > 2:
            # no node inside, and one for both its ends: cells that narrow would fold, and dictate the time step
            slivers.append((float(a), float(b)))
            if b == borders[-1]:
                pieces[-1] = np.array([b])
            continue
        cells = max(1, int(np.ceil(length[-1] / spacing - 1e-9)))
        # enough for the control points that the piece would have without its neighbours' help (Schoenberg and Whitney)
        cells = max(cells, -(-(_multiplicity(knots, degree, a) + _multiplicity(knots, degree, b)) // 2))
        if length[-1] > 0:
            inside = np.interp(np.linspace(0, length[-1], cells + 1)[1:-1], length, t)
        else:
            inside = np.linspace(a, b, cells + 1)[1:-1]
        pieces += [inside, np.array([b])]
    t = np.concatenate(pieces)
    periodic = (surface.periodic_u, surface.periodic_v)[axis]
    if refine is None:
        return _determined(knots, degree, t, slivers, periodic=periodic), np.zeros(0), slivers
    # a window's own ends become knots, so that supports end there
    ends = np.array(
        [x for x in (low, high) if surface.domain[axis][0] < x < surface.domain[axis][1] and x not in knots]
    )
    for every in [s for s in STRIDES if s >= stride]:
        added = np.union1d(_candidates(t, knots, degree, refine, every, open_ends=not periodic), ends)
        for a, b in slivers:
            added = added[(added < a) | (added > b)]
        if _is_determined(np.sort(np.concatenate([knots, added])), degree, t, slivers, periodic=periodic):
            return t, added, slivers
    return _determined(np.sort(np.concatenate([knots, ends])), degree, t, slivers, periodic=periodic), ends, slivers


def _multiplicity(knots: Array, degree: int, t: float) -> int:
    """How often t stands among the knots, at most `degree`; 1 for an end of a window that is no knot."""
    return max(1, min(degree, int(np.count_nonzero(knots == t))))


def _candidates(
    t: Array, knots: Array, degree: int, refine: tuple[float, float], stride: int, *, open_ends: bool
) -> Array:
    """Knots for interpolation at the nodes t: at every stride-th node for an odd degree, between nodes for an even one.

    At open ends of the domain the outermost (degree - 1) / 2 or degree / 2 of them are left out, as in "not a knot"
    interpolation: the net has then as many control points as there are nodes.
    """
    marks = t[1:-1] if degree % 2 else 0.5 * (t[1:] + t[:-1])
    drop = degree // 2
    if open_ends and drop:
        start, end = knots[degree], knots[-degree - 1]
        first = drop if t[0] == start else 0
        last = len(marks) - drop if t[-1] == end else len(marks)
        marks = marks[first:last]
    # a knot that the file brings takes the place of its nearest marks: of none but itself when it is simple and on a node
    values, counts = np.unique(knots[(knots > t[0]) & (knots < t[-1])], return_counts=True)
    for value, count in zip(values, counts, strict=True):
        spare = int(count) - degree % 2
        before, after = marks[marks < value], marks[marks > value]
        left = min(spare // 2, len(before))
        marks = np.setdiff1d(marks, np.concatenate([before[len(before) - left :], after[: spare - left]]))
    if stride > 1:
        marks = marks[stride // 2 :: stride]
    marks = marks[(marks >= refine[0]) & (marks <= refine[1])]
    return np.setdiff1d(marks, knots)


def _is_determined(knots: Array, degree: int, t: Array, slivers: list[Span], *, periodic: bool) -> bool:
    """Whether values at t determine every control point whose support they meet, and well. What reaches beyond the ends of a
    cut window is held, and the last control points of a periodic direction are the first ones."""
    basis = design_matrix(knots, degree, t)
    count = basis.shape[1]
    if t[0] > knots[degree]:
        basis[:, knots[:count] < t[0]] = 0.0
    if t[-1] < knots[-degree - 1]:
        basis[:, knots[degree + 1 :] > t[-1]] = 0.0
    wrapped = periodic and not slivers
    basis = folded(basis, np.arange(count) % (count - degree) if wrapped else sliver_ties(knots, degree, slivers))
    basis = basis[:, (basis != 0).any(axis=0)]
    if basis.shape[1] > basis.shape[0]:
        return False
    return bool(np.linalg.cond(basis) < WORST_CONDITION)


def _determined(knots: Array, degree: int, t: Array, slivers: list[Span], *, periodic: bool) -> Array:
    """The nodes t, with cells halved until they determine the net. Raises GeometryError when they never do: where knots stand
    by the hundred in less than a cell, what lies between the nodes is not known."""
    for _ in range(HALVINGS + 1):
        if _is_determined(knots, degree, t, slivers, periodic=periodic):
            return t
        t = np.sort(np.concatenate([t, 0.5 * (t[1:] + t[:-1])]))
    gaps = np.diff(breakpoints(knots, degree))
    raise GeometryError(
        f"its {len(gaps)} knot spans in one direction are so uneven, the longest {gaps.max() / gaps.min():.0e} times the "
        "shortest, that no nodes determine its control points",
        mend="remove the knots that do nothing: rebuild or simplify the surface in the CAD system",
    )


def _mean_arc_length(
    surface: BSplineSurface, axis: int, a: float, b: float, across: tuple[float, float]
) -> tuple[Array, Array]:
    """Parameters and mean arc length, over a few iso-curves, from a to b along `axis`."""
    t = np.linspace(a, b, 33)
    c = np.linspace(across[0], across[1], 9)
    points = surface.evaluate(t[:, None], c) if axis == 0 else surface.evaluate(c[None, :], t[:, None])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=2).mean(axis=1)
    return t, np.concatenate([[0.0], np.cumsum(steps)])
