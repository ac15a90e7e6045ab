"""Surface Discretization (paper section 4.4): the grid of points that a patch can make, and the levels of detail over it.

`PatchGrid` holds all that does not depend on the control points; it is made once. `Workspace` holds what follows the
control points: points, spheres and bounds, each made only where something asks for it, by the sparse rows of the
transformation matrices (degree + 1 nonzeros each), and kept until the net changes. Kernels see both as one `Patch`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError
from ..jit import njit, njit_inline
from ..spline.matrices import TransformationMatrices, breakpoints, span_lengths
from ..spline.surface import BSplineSurface

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

ROUND_OFF = 64 * 2.0**-52
"""Rounding of an evaluated point relative to the largest coordinate: a few units in the last place per basis product."""

CLOSED = 1e-9
"""Edges and poles count as closed when they agree to this fraction of the net's size."""

DENSER = 2
"""A face that fills little of its surface gets at most this many times the rows that its resolution asks for."""


class Patch(NamedTuple):
    """What kernels see of one patch and its net.

    Cells: level 0 is the knot spans, level L > 0 the cells between the rows of stride strides[L - 1]. A cell is (L, ku, kv),
    its place in arrays over all cells offset[L] + ku * count[L, 1] + kv. Vertices are flat: i * n + j.
    """

    net: Array
    knots_u: Array
    knots_v: Array
    degree_u: int
    degree_v: int
    rational: bool
    wrap_u: bool
    wrap_v: bool
    poles: int
    flip: float
    u: Array
    v: Array
    first_u: Index
    first_v: Index
    rows_u: Array
    rows_v: Array
    span_u: Index
    span_v: Index
    row_u: Index
    row_v: Index
    child_u: Index
    child_v: Index
    count: Index
    offset: Index
    covers: Mask
    inside: Mask
    half: Array
    half_stamp: Index
    points: Array
    point_stamp: Index
    spheres: Array
    sphere_stamp: Index
    box: Array
    bounds: Array
    bounds_stamp: Index
    mark: Index
    slot: Index
    visit: Index
    depth: Array
    cell_area: Array
    area_stamp: Index
    tick: int
    slack: float
    paper: bool
    delta: float
    counters: Index


@dataclass(frozen=True, slots=True, eq=False)
class PatchGrid:
    """Everything about one patch that does not depend on the control points.

    surface : degrees, knots, weights, trims, outward; its control points are the rest net. matrices : the finest resolution.
    strides : the levels of detail, coarse to fine, ending in 1; the rows of a level are every stride-th row inside each knot
    span and all breakpoints. inside : (m, n), whether a grid vertex lies on the trimmed face, or None when all do.
    row_u (levels, m), child_u (levels, m) : per level (0: the spans) its rows, and for each cell the first of its children
    on the next level; likewise v. count (levels, 2), offset (levels + 1,) : cells along u and v, and where each level starts
    in arrays over all cells. covers : whether a cell holds a vertex of the face.
    """

    surface: BSplineSurface
    matrices: TransformationMatrices
    strides: tuple[int, ...]
    inside: Mask | None
    row_u: Index
    row_v: Index
    child_u: Index
    child_v: Index
    count: Index
    offset: Index
    covers: Mask
    on_face: Mask
    span_u: Index
    span_v: Index
    knots_u: Array
    knots_v: Array
    weights: Array

    @classmethod
    def of(cls, surface: BSplineSurface, resolution: int | tuple[int, int]) -> PatchGrid:
        """The grid with about `resolution` rows and columns (or (rows, columns)) over the face, at least one cell per span.

        Raises GeometryError when the trimmed face is so small that no vertex lies on it, or the resolution is below 2.
        """
        rows, columns = (resolution, resolution) if isinstance(resolution, int) else resolution
        if min(rows, columns) < 2:
            raise GeometryError(f"a collision resolution of {min(rows, columns)}", mend="2 rows are one cell")
        for _ in range(4):
            matrices = TransformationMatrices.of(surface, _cells(surface, 0, rows - 1), _cells(surface, 1, columns - 1))
            inside = _inside(surface, matrices)
            if inside is None or inside.any():
                return cls._with(surface, matrices, None if inside is None or inside.all() else inside)
            rows, columns = 2 * rows - 1, 2 * columns - 1
        raise GeometryError(
            "the trimmed face is too small for the collision grid: no vertex lies on it",
            where=surface.name or surface.provenance.entity or "surface",
            mend="raise the resolution or leave the face out",
        )

    @classmethod
    def _with(cls, surface: BSplineSurface, matrices: TransformationMatrices, inside: Mask | None) -> PatchGrid:
        starts = (matrices.span_start_u, matrices.span_start_v)
        most = max(int(np.diff(start).max()) for start in starts)
        strides = tuple(2**k for k in range(max(0, (most - 1).bit_length() - 1), -1, -1))
        tables = [_levels(start, strides) for start in starts]
        count = np.stack([tables[0][2], tables[1][2]], axis=1)
        offset = np.concatenate([[0], np.cumsum(count.prod(axis=1))])
        covers = np.ones(offset[-1], dtype=np.bool_)
        if inside is not None:
            before = np.zeros((inside.shape[0] + 1, inside.shape[1] + 1), dtype=np.int64)
            before[1:, 1:] = inside.cumsum(axis=0).cumsum(axis=1)
            for level, (cells_u, cells_v) in enumerate(count):
                a, b = tables[0][0][level, : cells_u + 1], tables[1][0][level, : cells_v + 1]
                held = before[a[1:] + 1] - before[a[:-1]]
                held = held[:, b[1:] + 1] - held[:, b[:-1]]
                covers[offset[level] : offset[level + 1]] = held.ravel() > 0
        return cls(
            surface=surface,
            matrices=matrices,
            strides=strides,
            inside=inside,
            row_u=tables[0][0],
            row_v=tables[1][0],
            child_u=tables[0][1],
            child_v=tables[1][1],
            count=count,
            offset=offset,
            covers=covers,
            on_face=np.ones(matrices.shape[0] * matrices.shape[1], dtype=np.bool_) if inside is None else inside.ravel(),
            span_u=_span_of_row(starts[0]),
            span_v=_span_of_row(starts[1]),
            knots_u=np.array(surface.knots_u),
            knots_v=np.array(surface.knots_v),
            weights=np.ones(surface.shape) if surface.weights is None else np.array(surface.weights),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n): rows and columns of the finest grid."""
        return self.matrices.shape


def _cells(surface: BSplineSurface, axis: int, total: int) -> Index:
    """Cells in each knot span: about `total` over the spans that the face reaches, by their length; one in each other."""
    knots, degree = ((surface.knots_u, surface.degree_u), (surface.knots_v, surface.degree_v))[axis]
    length = span_lengths(surface, axis)
    share = np.ones(len(length))
    if surface.trims is not None:
        from ..spline.trim import box

        low, high = (corner[axis] for corner in box(surface.trims))
        b = breakpoints(knots, degree)
        share = np.clip((np.minimum(b[1:], high) - np.maximum(b[:-1], low)) / np.diff(b), 0.0, 1.0)
        if not share.any():
            share[:] = 1.0
    reached = (length * share).sum()
    density = total / reached if reached > 0 else 0.0
    wanted = np.where(share > 0, length * density, 0.0)
    if wanted.sum() > DENSER * total:
        wanted *= DENSER * total / wanted.sum()
    return np.maximum(1, np.rint(wanted).astype(np.int64))


def _inside(surface: BSplineSurface, matrices: TransformationMatrices) -> Mask | None:
    if surface.trims is None:
        return None
    from ..spline.trim import inside

    return inside(surface, matrices.u, matrices.v)


def _levels(start: Index, strides: tuple[int, ...]) -> tuple[Index, Index, Index]:
    """Rows (levels, m), first child (levels, m) and number of cells (levels,) of the levels over spans start[i]..start[i+1]."""
    m = int(start[-1]) + 1
    rows = [start]
    for stride in strides:
        inner = [np.arange(a, b, stride) for a, b in zip(start[:-1], start[1:], strict=True)]
        rows.append(np.concatenate([*inner, [m - 1]]))
    table = np.zeros((len(rows), m), dtype=np.int64)
    child = np.zeros((len(rows), m), dtype=np.int64)
    for level, row in enumerate(rows):
        table[level, : len(row)] = row
        if level + 1 < len(rows):
            child[level, : len(row)] = np.searchsorted(rows[level + 1], row)
    return table, child, np.array([len(row) - 1 for row in rows])


def _span_of_row(start: Index) -> Index:
    """The span of the cell that begins at each row; of the last row, the last span."""
    return np.minimum(np.searchsorted(start, np.arange(start[-1] + 1), side="right") - 1, len(start) - 2)


@dataclass(slots=True, eq=False)
class Workspace:
    """What follows one patch's control points; one per patch and place where it is used, reused from step to step."""

    grid: PatchGrid
    counters: Index
    patch: Patch = field(init=False)
    extent: Array = field(init=False)
    _flags: Index = field(init=False)
    _mark: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        grid, (m, n), (r, s) = self.grid, self.grid.shape, self.grid.surface.shape
        cells, spans = int(grid.offset[-1]), (int(grid.count[0, 0]), int(grid.count[0, 1]))
        surface, matrices = grid.surface, grid.matrices
        zeros = lambda *shape: np.zeros(shape, dtype=np.int64)  # noqa: E731
        self.extent = np.full((2, 3), np.nan)
        self._flags = zeros(3)
        self.patch = Patch(
            net=np.full((r, s, 4), np.nan),
            knots_u=grid.knots_u, knots_v=grid.knots_v, degree_u=surface.degree_u, degree_v=surface.degree_v,
            rational=surface.rational, wrap_u=False, wrap_v=False, poles=0, flip=1.0 if surface.outward else -1.0,
            u=matrices.u, v=matrices.v, first_u=matrices.first_u, first_v=matrices.first_v,
            rows_u=matrices.rows_u, rows_v=matrices.rows_v, span_u=grid.span_u, span_v=grid.span_v,
            row_u=grid.row_u, row_v=grid.row_v, child_u=grid.child_u, child_v=grid.child_v,
            count=grid.count, offset=grid.offset, covers=grid.covers, inside=grid.on_face,
            half=np.empty((m, s, 4)), half_stamp=zeros(m), points=np.empty((m * n, 3)), point_stamp=zeros(m * n),
            spheres=np.empty((cells, 5)), sphere_stamp=zeros(cells), box=np.empty((spans[0] * spans[1], 6)),
            bounds=np.empty((*spans, 5)), bounds_stamp=zeros(*spans),
            mark=zeros(cells), slot=zeros(cells), visit=zeros(m * n), depth=np.empty(m * n),
            cell_area=np.empty(m * n), area_stamp=zeros(m * n),
            tick=0, slack=0.0, paper=False, delta=0.0, counters=self.counters,
        )  # fmt: skip

    def load(self, net: Array, *, paper: bool, delta: float) -> Patch:
        """The patch over control points net (r, s, 3). What was computed stays when they are the same as before.

        Raises GeometryError when a control point is not finite or the net has another shape.
        """
        net = np.ascontiguousarray(net, dtype=np.float64)
        patch = self.patch
        if net.shape != (*self.grid.surface.shape, 3):
            raise GeometryError(f"a net of shape {net.shape} for a surface of {self.grid.surface.shape} control points")
        if not net.flags.writeable:
            net = net.copy()  # one type of array for the kernels
        changed = load(
            net, self.grid.weights, patch.net, patch.rows_u, patch.first_u, patch.rows_v, patch.first_v,
            patch.row_u, patch.row_v, patch.count, patch.box, self.extent, self._flags,
        )  # fmt: skip
        if changed < 0:
            raise GeometryError("a control point is not finite", where=self.grid.surface.name or "surface")
        if changed or patch.tick == 0 or patch.paper != paper or patch.delta != delta:
            wrap_u, wrap_v, poles = (int(flag) for flag in self._flags)
            self.patch = patch._replace(
                wrap_u=bool(wrap_u), wrap_v=bool(wrap_v), poles=poles, tick=patch.tick + 1,
                slack=ROUND_OFF * float(np.abs(self.extent).max()), paper=paper, delta=delta,
            )  # fmt: skip
        return self.patch

    def new_mark(self) -> int:
        """A number that no entry of `mark` and `visit` holds yet."""
        self._mark += 2
        return self._mark


@njit
def grown(rows: Index) -> Index:
    """The same rows in an array twice as long."""
    longer = np.empty((2 * len(rows), rows.shape[1]), np.int64)
    for i in range(len(rows)):
        for c in range(rows.shape[1]):
            longer[i, c] = rows[i, c]
    return longer


@njit
def extent_of(net: Array, out: Array) -> None:
    """The axis-aligned box of a net (r, s, 3), into out (2, 3): NaN anywhere makes it NaN."""
    for c in range(3):
        out[0, c], out[1, c] = net[0, 0, c], net[0, 0, c]
    for i in range(net.shape[0]):
        for j in range(net.shape[1]):
            for c in range(3):
                x = net[i, j, c]
                if np.isnan(x):
                    out[:] = np.nan
                    return
                out[0, c] = min(out[0, c], x)
                out[1, c] = max(out[1, c], x)


@njit
def load(
    net: Array, weights: Array, target: Array, rows_u: Array, first_u: Index, rows_v: Array, first_v: Index,
    row_u: Index, row_v: Index, count: Index, box: Array, extent: Array, flags: Index,
) -> int:  # fmt: skip
    """Take in a net: homogeneous points, box, span boxes, closed directions and poles. 0: unchanged; 1: new; -1: not finite.

    box (spans, 6): low and high corner of each span's own (k+1)(l+1) control points. flags: closed in u, in v, poles (1, 2:
    first and last row of the grid; 4, 8: first and last column).
    """
    r, s = net.shape[0], net.shape[1]
    same = True
    for i in range(r):
        for j in range(s):
            w = weights[i, j]
            for c in range(3):
                x = w * net[i, j, c]
                same = same and target[i, j, c] == x
                target[i, j, c] = x
            target[i, j, 3] = w
    if same:
        return 0
    extent_of(net, extent)
    size = 0.0
    for c in range(3):
        if not (np.isfinite(extent[0, c]) and np.isfinite(extent[1, c])):
            target[:] = np.nan
            return -1
        size = max(size, extent[1, c] - extent[0, c])
    p, q = rows_u.shape[2], rows_v.shape[2]
    spans_u, spans_v = count[0, 0], count[0, 1]
    for a in range(spans_u):
        i0 = first_u[row_u[0, a]]
        for b in range(spans_v):
            j0 = first_v[row_v[0, b]]
            k = a * spans_v + b
            for c in range(3):
                low, high = net[i0, j0, c], net[i0, j0, c]
                for i in range(i0, i0 + p):
                    for j in range(j0, j0 + q):
                        low = min(low, net[i, j, c])
                        high = max(high, net[i, j, c])
                box[k, c], box[k, 3 + c] = low, high
    # the four edge curves, as control points of curves along the other direction
    flags[2] = 0
    edge = np.empty((2, max(r, s), 3))
    for direction in range(2):
        length = s if direction == 0 else r
        rows = rows_u if direction == 0 else rows_v
        first = first_u if direction == 0 else first_v
        for end in range(2):
            row = 0 if end == 0 else rows.shape[1] - 1
            for k in range(length):
                x, y, z, w = 0.0, 0.0, 0.0, 0.0
                for e in range(rows.shape[2]):
                    f = first[row] + e
                    i, j = (f, k) if direction == 0 else (k, f)
                    x += rows[0, row, e] * target[i, j, 0]
                    y += rows[0, row, e] * target[i, j, 1]
                    z += rows[0, row, e] * target[i, j, 2]
                    w += rows[0, row, e] * target[i, j, 3]
                edge[end, k, 0], edge[end, k, 1], edge[end, k, 2] = x / w, y / w, z / w
        closed = True
        for k in range(length):
            for c in range(3):
                closed = closed and abs(edge[0, k, c] - edge[1, k, c]) <= CLOSED * size
        flags[direction] = closed
        for end in range(2):
            pole = True
            for k in range(length):
                for c in range(3):
                    pole = pole and abs(edge[end, k, c] - edge[end, 0, c]) <= CLOSED * size
            if pole:
                flags[2] |= 1 << (2 * direction + end)
    return 1


@njit_inline
def canonical(i: int, j: int, m: int, n: int, wrap_u: bool, wrap_v: bool, poles: int) -> int:
    """The flat name of the vertex (i, j): one for both sides of a closed seam, one for a whole pole."""
    if wrap_u and i == m - 1:
        i = 0
    if wrap_v and j == n - 1:
        j = 0
    if poles != 0:
        if (poles & 1 and i == 0) or (poles & 2 and i == m - 1):
            j = 0
        if (poles & 4 and j == 0) or (poles & 8 and j == n - 1):
            i = 0
    return i * n + j


@njit
def make_points(g: Patch, names: Index, count: int) -> None:
    """The points of the vertices names[:count], each made once per net (paper eq. 2, one sparse row against one column)."""
    tick, n, s = g.tick, len(g.v), g.net.shape[1]
    net, half, half_stamp, points, stamp = g.net, g.half, g.half_stamp, g.points, g.point_stamp
    first_u, first_v, rows_u, rows_v = g.first_u, g.first_v, g.rows_u, g.rows_v
    order_u, order_v, rational = g.degree_u + 1, g.degree_v + 1, g.rational
    made = 0
    for t in range(count):
        k = names[t]
        if stamp[k] == tick:
            continue
        stamp[k] = tick
        made += 1
        i, j = k // n, k % n
        if half_stamp[i] != tick:
            # half[i]: the control points of the iso-curve u = u_i
            half_stamp[i] = tick
            f = first_u[i]
            e = rows_u[0, i, 0]
            for b in range(s):
                for c in range(4):
                    half[i, b, c] = e * net[f, b, c]
            for a in range(1, order_u):
                e = rows_u[0, i, a]
                for b in range(s):
                    for c in range(4):
                        half[i, b, c] += e * net[f + a, b, c]
        x, y, z, w = 0.0, 0.0, 0.0, 0.0
        f = first_v[j]
        for b in range(order_v):
            e = rows_v[0, j, b]
            x += e * half[i, f + b, 0]
            y += e * half[i, f + b, 1]
            z += e * half[i, f + b, 2]
            w += e * half[i, f + b, 3]
        if rational:
            x, y, z = x / w, y / w, z / w
        points[k, 0], points[k, 1], points[k, 2] = x, y, z
    g.counters[2] += made
