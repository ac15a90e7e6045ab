"""The nodes on a face that say how a displacement field moves it.

Where the points of the field are a whole grid on the face, as a run writes them, those; else nodes of the face's own, at
which the field is interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..errors import GeometryError, InputError
from ..patch import cells_on_face, nodes_of_cells
from ..physics.node_grid import node_grid
from ..spline.matrices import span_parameters
from ..spline.net_fit import NodeField
from ..spline.refine import missing_knots
from ..spline.surface import BSplineSurface
from .displacements import DisplacementField

Array = NDArray[np.float64]
Span = tuple[float, float]

ON_FACE = 1e-6
"""Points nearer to a face, in its sizes, lie on it."""
SPARSE = 50
"""Places of the grid through all points, for each point, above which they are no grid."""
MOST_NODES = 100_000
BEYOND = 3
"""Nodes beyond those that move, to which a net is made fine."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldNodes:
    """Nodes on a face.

    u (m,), v (n,) : their parameters. moves (m, n, 3) : displacements, mm. slivers : the knot spans that have none. knots :
    that a net has more which follows every node. points : numbers of the field's points that lie on the face, where those are
    the nodes; None where the field was interpolated.
    """

    u: Array
    v: Array
    moves: Array
    slivers: tuple[list[Span], list[Span]]
    knots: tuple[Array, Array]
    points: NDArray[np.int64] | None = None

    @property
    def most(self) -> float:
        """The largest displacement, mm."""
        return float(np.linalg.norm(self.moves, axis=2).max())

    def on(self, surface: BSplineSurface) -> NodeField:
        """The nodes as a refit of the face's surface takes them. Raises GeometryError where they are none that it takes."""
        closed = (surface.closed_u, surface.closed_v)
        counted = nodes_of_cells(cells_on_face(surface, self.u, self.v, wrap=closed), wrap=closed)
        return NodeField.of(surface, self.u, self.v, self.moves, counted=counted, closed=closed, slivers=self.slivers)


def interpolated_nodes(
    surface: BSplineSurface, field: DisplacementField, window: tuple[Span, Span], spacing: float
) -> FieldNodes | None:
    """Nodes of the face's own, with the field's displacements there; None where there would be too many."""
    try:
        nodes = node_grid(surface, (spacing, spacing), window=window, refine=window)
    except (InputError, GeometryError):
        return None
    places = surface.evaluate(nodes.u[:, None], nodes.v)
    moves = field.at(places.reshape(-1, 3)).reshape(places.shape)
    return FieldNodes(nodes.u, nodes.v, moves, nodes.slivers, missing_knots(surface, nodes.surface))


def own_nodes(surface: BSplineSurface, field: DisplacementField, window: tuple[Span, Span]) -> FieldNodes | None:
    """The points of the field that lie on a surface, where they are a whole grid over the window; None where not."""
    tolerance = ON_FACE * surface.size
    net = surface.control_points.reshape(-1, 3)
    close = ((field.points >= net.min(axis=0) - tolerance) & (field.points <= net.max(axis=0) + tolerance)).all(axis=1)
    if not 16 <= np.count_nonzero(close) <= MOST_NODES:
        return None
    number = np.flatnonzero(close)
    points = field.points[number]
    uv = feet(surface, points)
    on = np.linalg.norm(surface.evaluate(*uv.T) - points, axis=1) <= tolerance
    uv, number = uv[on], number[on]
    moves = field.moves[number]
    if len(uv) < 16:
        return None
    for axis, closed in enumerate((surface.closed_u, surface.closed_v)):
        low, high = surface.domain[axis]
        if closed:  # both sides of the seam are one place
            uv[high - uv[:, axis] <= 1e-6 * (high - low), axis] = low
    (u, row), (v, column) = (_values(uv[:, axis], surface.domain[axis]) for axis in (0, 1))
    if len(u) * len(v) > SPARSE * len(uv):
        return None
    full_u, full_v = _full(row, column)
    if full_u is None or full_v is None:
        return None
    found = np.full((len(full_u), len(full_v), 3), np.nan)
    place_u = np.full(len(u), -1)
    place_v = np.full(len(v), -1)
    place_u[full_u], place_v[full_v] = np.arange(len(full_u)), np.arange(len(full_v))
    kept = (place_u[row] >= 0) & (place_v[column] >= 0)
    found[place_u[row[kept]], place_v[column[kept]]] = moves[kept]
    if np.isnan(found).any() or min(found.shape[:2]) < 4:
        return None
    u, v = _snapped(u[full_u], surface.domain[0]), _snapped(v[full_v], surface.domain[1])
    for t, (low, high), closed in ((u, window[0], surface.closed_u), (v, window[1], surface.closed_v)):
        step = float(np.diff(t).max())
        if t[0] - low > 1e-6 * (high - low) or high - t[-1] > (1.5 * step if closed else 1e-6 * (high - low)):
            return None
    points = surface.evaluate(u[:, None], v)
    spacing = [float(np.median(np.linalg.norm(np.diff(points, axis=axis), axis=2))) for axis in (0, 1)]
    try:
        nodes = node_grid(surface, (spacing[0], spacing[1]), window=window, refine=_moved_window(u, v, found))
    except (InputError, GeometryError):
        return None
    return FieldNodes(u, v, found, nodes.slivers, missing_knots(surface, nodes.surface), number)


def _moved_window(u: Array, v: Array, moves: Array) -> tuple[Span, Span] | None:
    """The box of (u, v) around the nodes that move, and a few more, as a run has knots where its tools come; None where none
    does."""
    moved = (moves != 0.0).any(axis=2)
    if not moved.any():
        return None
    rows, columns = np.flatnonzero(moved.any(axis=1)), np.flatnonzero(moved.any(axis=0))
    return tuple(  # type: ignore[return-value]
        (float(t[max(places[0] - BEYOND, 0)]), float(t[min(places[-1] + BEYOND, len(t) - 1)]))
        for t, places in ((u, rows), (v, columns))
    )


def _values(t: Array, domain: tuple[float, float]) -> tuple[Array, NDArray[np.int64]]:
    """The different values among parameters, to rounding, and which of them each is."""
    order = np.argsort(t, kind="stable")
    steps = np.diff(t[order]) > 1e-6 * (domain[1] - domain[0])
    group = np.concatenate([[0], np.cumsum(steps)])
    which = np.empty(len(t), dtype=np.int64)
    which[order] = group
    return np.bincount(which, weights=t) / np.bincount(which), which


def _snapped(t: Array, domain: Span) -> Array:
    """Parameters with those at the domain's ends, to rounding, exactly there: what lies beyond the nodes stays."""
    low, high = domain
    near = 1e-6 * (high - low)
    return np.where(t - low <= near, low, np.where(high - t <= near, high, t))


def _full(
    row: NDArray[np.int64], column: NDArray[np.int64]
) -> tuple[NDArray[np.int64] | None, NDArray[np.int64] | None]:
    """Rows and columns that make a whole grid: those with fewest points are left out until all are full."""
    rows, columns = np.arange(row.max() + 1), np.arange(column.max() + 1)
    table = np.zeros((len(rows), len(columns)), dtype=np.bool_)
    table[row, column] = True
    while len(rows) and len(columns) and not table.all():
        thin_u, thin_v = table.mean(axis=1), table.mean(axis=0)
        if thin_u.min() <= thin_v.min():
            keep = thin_u > thin_u.min()
            table, rows = table[keep], rows[keep]
        else:
            keep = thin_v > thin_v.min()
            table, columns = table[:, keep], columns[keep]
    return (rows, columns) if len(rows) and len(columns) else (None, None)


def feet(surface: BSplineSurface, points: Array, steps: int = 12) -> Array:
    """Parameters (n, 2) of the places on a surface nearest to points (n, 3): from dense samples on by Gauss and Newton."""
    u, _ = span_parameters(surface.knots_u, surface.degree_u, max(2, 120 // surface.shape[0]))
    v, _ = span_parameters(surface.knots_v, surface.degree_v, max(2, 120 // surface.shape[1]))
    samples = surface.evaluate(u[:, None], v).reshape(-1, 3)
    nearest = KDTree(samples).query(points)[1]
    uv = np.column_stack([u[nearest // len(v)], v[nearest % len(v)]])
    low, high = np.array(surface.domain).T
    for _ in range(steps):
        d = surface.derivatives(uv[:, 0], uv[:, 1], 1)
        gap, a, b = points - d[0, 0], d[1, 0], d[0, 1]
        aa, ab, bb = (np.einsum("ni,ni->n", x, y) for x, y in ((a, a), (a, b), (b, b)))
        ga, gb = np.einsum("ni,ni->n", gap, a), np.einsum("ni,ni->n", gap, b)
        determinant = aa * bb - ab * ab
        safe = determinant > 1e-14 * aa * bb
        determinant = np.where(safe, determinant, 1.0)
        step = np.column_stack([bb * ga - ab * gb, aa * gb - ab * ga]) / determinant[:, None]
        uv = np.clip(uv + np.where(safe[:, None], step, 0.0), low, high)
    return uv
