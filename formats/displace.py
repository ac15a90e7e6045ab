"""A displacement field applied to a part, without any physics: faces near its points follow them, all else stays.

Where the points of the field are a whole grid of nodes on a face, as a run writes them, the face is fitted to those; else
to nodes of its own, at which the field is interpolated. The fit is the one of a run's export: to a stated tolerance, with as
few knots more as the nodes ask for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..errors import GeometryError, InputError
from ..patch import node_window
from ..physics.node_grid import node_grid
from ..spline.adapt import Goal, ToleranceFit, fit_to_tolerance
from ..spline.hold import Hold
from ..spline.matrices import span_parameters
from ..spline.net_fit import Given, NodeField
from ..spline.refine import missing_knots
from ..spline.refit import RefitError
from ..spline.surface import BSplineSurface
from ..spline.trim import inside
from .displacements import DisplacementField
from .load import sculptable
from .part import Face, Part

Array = NDArray[np.float64]
Span = tuple[float, float]

TOLERANCE = 1e-4
"""Of the refit, in sizes of the face, where none is given."""
STILL = 0.05
"""Nodes that move by less than this share of the tolerance do not move: their control points keep their bits."""
ON_FACE = 1e-6
"""Points nearer to a face, in its sizes, lie on it."""
FINER = 0.6
"""From one try to the next, of the node spacing, while the nodes do not determine the net."""
TRIES = 4
STRAYING = 2.0
"""Between the nodes, in tolerances, above which a net that follows every node is tried."""
SPARSE = 50
"""Places of the grid through all points, for each point, above which they are no grid."""
MOST_CONTROL_POINTS = 20_000
MOST_NODES = 100_000


@dataclass(frozen=True, slots=True)
class DisplacedFace:
    """What became of a face: its largest displacement and the distance between its nodes and the refit surface, mm.

    exact : the nodes are points of the field.
    """

    number: int
    name: str
    moved: float
    error: RefitError
    nodes: tuple[int, int]
    exact: bool


def displace(
    part: Part,
    field: DisplacementField,
    faces: Sequence[Face] | None = None,
    *,
    tolerance: float | None = None,
    on_face: Callable[[str], None] | None = None,
) -> list[DisplacedFace]:
    """Move the faces of a part along a field; returns those that moved.

    faces : that may move; all when left out. tolerance : mm between the nodes and the refit surface. What could not be met
    is in the part's warnings. Raises InputError when no point of the field is near the part, and nothing moves.
    """
    chosen = [face for face in (part.faces if faces is None else faces) if not face.warning]
    near = [(face, surface) for face in chosen for surface in [sculptable(part, face)] if _reaches(field, surface)]
    surfaces: dict[int, BSplineSurface] = {}
    found: list[DisplacedFace] = []
    moving = {face.number for face, _ in near}
    for face, surface in near:
        if on_face:
            on_face(face.name)
        made = _displaced(face, surface, field, moving, tolerance or TOLERANCE * surface.size)
        if made is None:
            continue
        surfaces[face.number], told = made
        found.append(told)
        limit = tolerance or TOLERANCE * surface.size
        if told.error.maximum > limit:
            part.warnings.append(
                f"face {face.name!r}: the refit keeps within {told.error.maximum:.3g} mm of its nodes, not {limit:.3g}"
            )
    if not near:
        low, high = field.points.min(axis=0), field.points.max(axis=0)
        raise InputError(
            f"no face is near the points, which lie from ({_xyz(low)}) to ({_xyz(high)}) mm",
            where=str(part.path),
            mend="are they in another unit, or is the reach too small?",
        )
    if not found:
        raise InputError("nothing moves: all displacements near its faces are zero", where=str(part.path))
    part.sculpt(surfaces)
    return found


def _xyz(point: Array) -> str:
    return ", ".join(f"{x:.4g}" for x in point)


def _reaches(field: DisplacementField, surface: BSplineSurface) -> bool:
    """Whether a point of the field may be near enough to a surface to move it."""
    net = surface.control_points.reshape(-1, 3)
    low, high = net.min(axis=0) - field.reach, net.max(axis=0) + field.reach
    return bool(((field.points >= low) & (field.points <= high)).all(axis=1).any())


def _displaced(
    face: Face, surface: BSplineSurface, field: DisplacementField, moving: set[int], tolerance: float
) -> tuple[BSplineSurface, DisplacedFace] | None:
    """The face's surface along the field, None when nothing of it moves."""
    window = node_window(surface)
    grid = _own_grid(surface, field, window)
    fit = None
    if grid is not None:
        fit = _fitted(face, surface, grid, moving, tolerance)
    exact, spacing = fit is not None, field.spacing
    for _ in range(0 if exact else TRIES):
        grid = _interpolated(surface, field, window, spacing)
        if grid is None or (fit := _fitted(face, surface, grid, moving, tolerance)):
            break
        spacing *= FINER
    if fit is None or grid is None:
        raise GeometryError(
            f"no net of its surface follows points {field.spacing:.3g} mm apart",
            where=face.name,
            mend="are they in another unit? Otherwise give fewer points",
        )
    most = float(np.linalg.norm(grid.moves, axis=2).max())
    if not most > STILL * tolerance:
        return None
    m, n = grid.moves.shape[:2]
    return fit.surface, DisplacedFace(face.number, face.name, most, fit.error, (m, n), exact)


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Nodes on a face.

    u (m,), v (n,) : their parameters. moves (m, n, 3) : displacements. slivers : the knot spans that have none. knots : that
    a net has more which follows every node. still : rectangles in which the surface stays.
    """

    u: Array
    v: Array
    moves: Array
    slivers: tuple[list[Span], list[Span]]
    knots: tuple[Array, Array]
    still: tuple[tuple[Span | None, Span | None], ...] = ()


def _fitted(
    face: Face, surface: BSplineSurface, grid: _Grid, moving: set[int], tolerance: float
) -> ToleranceFit | None:
    """The refit to the nodes; None where they do not determine the net that was read."""
    stays = [edge.uv for edge in face.edges if edge.degenerate or (not edge.seam and set(edge.neighbours) - moving)]
    hold = Hold(tuple(stays), boxes=grid.still)
    try:
        nodes = NodeField.of(
            surface,
            grid.u,
            grid.v,
            grid.moves,
            counted=inside(surface, grid.u, grid.v),
            closed=(surface.closed_u, surface.closed_v),
            slivers=grid.slivers,
        )
    except GeometryError:
        return None
    goal = Goal(tolerance, STILL * tolerance, MOST_CONTROL_POINTS)
    fits: list[ToleranceFit] = []
    for start in (None, grid.knots):
        # the net's own knots and few more; or, where the surface would swing between the nodes, those that follow them
        with suppress(GeometryError):
            fits.append(
                fit_to_tolerance(
                    surface, nodes, goal, constraint=lambda net: Given(hold.control_points(net)), start=start
                )
            )
            if fits[-1].outcome == "within" and fits[-1].between <= STRAYING * tolerance:
                break
    return min(fits, key=lambda fit: max(fit.error.maximum, fit.between), default=None)


def _interpolated(
    surface: BSplineSurface, field: DisplacementField, window: tuple[Span, Span], spacing: float
) -> _Grid | None:
    """Nodes of the face's own, with the field's displacements there; None where there would be too many."""
    try:
        nodes = node_grid(surface, (spacing, spacing), window=window, refine=window)
    except (InputError, GeometryError):
        return None
    places = surface.evaluate(nodes.u[:, None], nodes.v)
    moves = field.at(places.reshape(-1, 3)).reshape(places.shape)
    knots = missing_knots(surface, nodes.surface)
    return _Grid(nodes.u, nodes.v, moves, nodes.slivers, knots, _still(surface, nodes.u, nodes.v, moves))


def _still(surface: BSplineSurface, u: Array, v: Array, moves: Array) -> tuple[tuple[Span | None, Span | None], ...]:
    """The parts of the domain that lie beyond all nodes that move, and two nodes more."""
    moved = (moves != 0.0).any(axis=2)
    found: list[tuple[Span | None, Span | None]] = []
    for axis, t in ((0, u), (1, v)):
        if not moved.any() or (surface.closed_u, surface.closed_v)[axis]:
            continue
        places = np.flatnonzero(moved.any(axis=1 - axis))
        low, high = surface.domain[axis]
        for a, b in ((low, t[max(places[0] - 2, 0)]), (t[min(places[-1] + 2, len(t) - 1)], high)):
            if a < b:
                span = (float(a), float(b))
                found.append((span, None) if axis == 0 else (None, span))
    return tuple(found)


# ------------------------------------------------------------------ the field's own grid


def _own_grid(surface: BSplineSurface, field: DisplacementField, window: tuple[Span, Span]) -> _Grid | None:
    """The points of the field that lie on a surface, where they are a whole grid over the window; None where not."""
    tolerance = ON_FACE * surface.size
    net = surface.control_points.reshape(-1, 3)
    close = ((field.points >= net.min(axis=0) - tolerance) & (field.points <= net.max(axis=0) + tolerance)).all(axis=1)
    if not 16 <= np.count_nonzero(close) <= MOST_NODES:
        return None
    points, moves = field.points[close], field.moves[close]
    uv = feet(surface, points)
    on = np.linalg.norm(surface.evaluate(*uv.T) - points, axis=1) <= tolerance
    uv, moves = uv[on], moves[on]
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
    inside = (place_u[row] >= 0) & (place_v[column] >= 0)
    found[place_u[row[inside]], place_v[column[inside]]] = moves[inside]
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
        nodes = node_grid(surface, (spacing[0], spacing[1]), window=window, refine=window)
    except (InputError, GeometryError):
        return None
    return _Grid(u, v, found, nodes.slivers, missing_knots(surface, nodes.surface))


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
