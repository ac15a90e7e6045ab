"""Surface Discretization (paper section 4.4): points on a patch, made where something asks for them.

`Workspace` holds what follows the control points: points, spheres and bounds, each made only when it is wanted, by the
sparse rows of the transformation matrices (degree + 1 nonzeros each), and kept until the net changes. Kernels see it,
and the patch's grid, as one `Patch`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError
from ..jit import njit, njit_in_place, njit_inline, njit_inline_in_place
from .grid import PatchGrid

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

ROUND_OFF = 64 * 2.0**-52
"""Rounding of an evaluated point relative to the largest coordinate: a few units in the last place per basis
product."""

BOX = 13
"""Numbers of a cell's box and slab (`finest.fill_boxes`)."""

CLOSED = 1e-9
"""Edges and poles count as closed when they agree to this fraction of the net's size."""


class Tree(NamedTuple):
    """What kernels see of one patch's cells on all levels of detail; the fields are those of `Patch`."""

    tally: Index
    offset: Index
    row_u: Index
    row_v: Index
    child_u: Index
    child_v: Index
    covers: Mask
    spheres: Array
    mark: Index
    slot: Index


class Patch(NamedTuple):
    """What kernels see of one patch and its net.

    Cells: level 0 is the knot spans, level L > 0 the cells between the rows of stride strides[L - 1]. A cell is (L,
    ku, kv), its place in arrays over all cells offset[L] + ku * tally[L, 1] + kv. Vertices are flat: i * n + j.
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
    tally: Index
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
    bounds_stamp: Index  # the tick, or minus it where only S_UU and S_VV have been made
    mark: Index
    slot: Index
    visit: Index
    depth: Array
    cell_area: Array
    area_stamp: Index
    corners: Index
    wanted: Index
    ids: Index
    work: Array
    frames: Array
    terms: Array
    terms_stamp: Index
    tick: int
    slack: float
    paper: bool
    delta: float
    counters: Index


class Spans(NamedTuple):
    """What kernels see of one patch's net and knot spans alone; the fields are those of `Patch`.

    Every field costs a kernel compilation time and calls of it time, so that kernels take this where it is enough.
    """

    net: Array
    knots_u: Array
    knots_v: Array
    degree_u: int
    degree_v: int
    rational: bool
    wrap_u: bool
    wrap_v: bool
    u: Array
    v: Array
    first_u: Index
    first_v: Index
    row_u: Index
    row_v: Index
    tally: Index
    slack: float


class Room(NamedTuple):
    """What kernels work in beside a patch: room for all cells of its largest level, or all its vertices, whichever is more
    (n). Memory that nothing is written to is not taken from the machine.

    cells, children (n, 3), maybe (n, 6), names, hits (n,), distance (n,), points (n, 3), normals (n, 3).
    """

    cells: Index
    children: Index
    maybe: Index
    names: Index
    hits: Index
    distance: Array
    points: Array
    normals: Array


class Waves(NamedTuple):
    """What is found at vertices, wave by wave, in the order of `Room.names`: room for all of a patch's (n).

    place (n,) : where each vertex stands among them. queue, kept (n,) : which of them are contacts. group (n + 1,) : where
    groups of neighbours begin. best (n, 9), state, owner (n,) : of `closest.project`.
    """

    place: Index
    queue: Index
    kept: Index
    group: Index
    best: Array
    state: Index
    owner: Index


class Search(NamedTuple):
    """What a search for closest points on a patch works in: room for all cells of its largest level."""

    here: Index
    there: Index
    final: Index
    table: Array
    found: Array
    mine: Array
    h: Array
    scratch: Array
    centre: Array
    starts: Index
    stack: Index
    boxes: Array


@dataclass(slots=True, eq=False)
class Workspace:
    """What follows one patch's control points; one per patch and place where it is used, reused from step to step."""

    grid: PatchGrid
    counters: Index
    patch: Patch = field(init=False)
    extent: Array = field(init=False)
    _flags: Index = field(init=False)
    _net: Array = field(init=False)
    _rows: Array = field(init=False)
    _edge: Array = field(init=False)
    _mark: int = field(init=False, default=0)
    _boxes: tuple[Array, Index, Index] | None = field(init=False, default=None)
    _room: Room | None = field(init=False, default=None)
    _search: Search | None = field(init=False, default=None)
    _waves: Waves | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        grid, (m, n), (r, s) = self.grid, self.grid.shape, self.grid.surface.shape
        cells, spans = int(grid.offset[-1]), (int(grid.tally[0, 0]), int(grid.tally[0, 1]))
        surface, matrices = grid.surface, grid.matrices
        p, q = surface.degree_u, surface.degree_v
        most = max(cells, 1)  # of spheres made at once: cells of all levels, each made once
        self.extent = np.full((2, 3), np.nan)
        self._flags = _integers(3)
        self._net, self._rows, self._edge = np.empty((r, s, 3)), np.empty((r, spans[1], 6)), np.empty((2, max(r, s), 3))
        self.patch = Patch(
            net=np.full((r, s, 4), np.nan),
            knots_u=grid.knots_u, knots_v=grid.knots_v, degree_u=surface.degree_u, degree_v=surface.degree_v,
            rational=surface.rational, wrap_u=False, wrap_v=False, poles=0, flip=1.0 if surface.outward else -1.0,
            u=matrices.u, v=matrices.v, first_u=matrices.first_u, first_v=matrices.first_v,
            rows_u=matrices.rows_u, rows_v=matrices.rows_v, span_u=grid.span_u, span_v=grid.span_v,
            row_u=grid.row_u, row_v=grid.row_v, child_u=grid.child_u, child_v=grid.child_v,
            tally=grid.tally, offset=grid.offset, covers=grid.covers, inside=grid.on_face,
            half=np.empty((m, s, 4)), half_stamp=_integers(m), points=np.empty((m * n, 3)), point_stamp=_integers(m * n),
            spheres=np.empty((cells, 6)), sphere_stamp=_integers(cells), box=np.empty((spans[0] * spans[1], 6)),
            bounds=np.empty((*spans, 5)), bounds_stamp=_integers(*spans),
            mark=_integers(cells), slot=_integers(cells), visit=_integers(m * n), depth=np.empty(m * n),
            cell_area=np.empty(m * n), area_stamp=_integers(m * n),
            corners=np.empty(4 * most, np.int64), wanted=np.empty(most, np.int64), ids=_integers(4),
            work=np.empty((5, 8)), frames=grid.frames,
            terms=np.empty((r - p, s - q, (p + 1) * (q + 1), 4)), terms_stamp=_integers(r - p, s - q),
            tick=0, slack=0.0, paper=False, delta=0.0, counters=self.counters,
        )  # fmt: skip

    def load(self, net: Array, *, paper: bool, delta: float) -> Patch:
        """The patch over control points net (r, s, 3). What was computed stays when they are the same as before.

        Raises GeometryError when a control point is not finite or the net has another shape.
        """
        patch = self.patch
        if np.shape(net) != self._net.shape:
            raise GeometryError(
                f"a net of shape {np.shape(net)} for a surface of {self.grid.surface.shape} control points"
            )
        np.copyto(self._net, net)  # one type of array for the kernels
        changed = load(
            self._net, self.grid.weights, patch.net, patch.rows_u, patch.first_u, patch.rows_v, patch.first_v,
            patch.row_u, patch.row_v, patch.tally, patch.box, self.extent, self._flags, self._rows, self._edge,
        )  # fmt: skip
        if changed < 0:
            raise GeometryError("a control point is not finite", where=self.grid.surface.name or "surface")
        if changed or patch.tick == 0 or patch.paper != paper or patch.delta != delta:
            wrap_u, wrap_v, poles = (int(flag) for flag in self._flags)
            self.patch = patch._replace(
                wrap_u=bool(wrap_u), wrap_v=bool(wrap_v), poles=poles, tick=patch.tick + 1,
                slack=ROUND_OFF * max(map(abs, self.extent.flat)), paper=paper, delta=delta,
            )  # fmt: skip
        return self.patch

    @property
    def closed(self) -> bool:
        """The loaded patch has no border: each direction closes on itself or ends in two poles, and nothing is trimmed."""
        g = self.patch
        return self.grid.inside is None and (g.wrap_u or g.poles & 3 == 3) and (g.wrap_v or g.poles & 12 == 12)

    @property
    def boxes(self) -> tuple[Array, Index, Index]:
        """Boxes of the cells, the vertices at their corners, and the ticks at which they were made, for `finest`."""
        if self._boxes is None:
            cells = int(self.grid.offset[-1])
            self._boxes = np.empty((cells, BOX)), np.empty((cells, 4), np.int64), _integers(cells)
        return self._boxes

    @property
    def room(self) -> Room:
        """Room for kernels to work in, made when it is first asked for."""
        if self._room is None:
            n = max(int(self.grid.tally.prod(axis=1).max()), len(self.patch.visit))
            i, x = np.int64, np.float64
            self._room = Room(
                np.empty((n, 3), i), np.empty((n, 3), i), np.empty((n, 6), i), np.empty(n, i), np.empty(n, i),
                np.empty(n, x), np.empty((n, 3), x), np.empty((n, 3), x),
            )  # fmt: skip
        return self._room

    @property
    def waves(self) -> Waves:
        """Room for what is found at the vertices, made when it is first asked for."""
        if self._waves is None:
            n, i = len(self.patch.visit), np.int64
            self._waves = Waves(
                np.empty(n, i), np.empty(n, i), np.empty(n, i), np.empty(n + 1, i), np.empty((n, 9)), np.empty(n, i),
                np.empty(n, i),
            )  # fmt: skip
        return self._waves

    @property
    def search(self) -> Search:
        """Room for a search for closest points, made when it is first asked for."""
        if self._search is None:
            self._search = Search(*new_search(self.patch))
        return self._search

    def new_mark(self) -> int:
        """A number that no entry of `mark` and `visit` holds yet."""
        self._mark += 2
        return self._mark


def _integers(*shape: int) -> Index:
    return np.zeros(shape, dtype=np.int64)


@njit
def new_search(g: Patch) -> Search:
    """Room for a search for closest points on a patch. (Memory that is not written to is not taken from the machine.)"""
    most = 1
    for level in range(len(g.tally)):
        most = max(most, g.tally[level, 0] * g.tally[level, 1])
    columns = max(g.degree_u, g.degree_v) + 4
    return Search(
        np.empty((most, 3), np.int64), np.empty((most, 3), np.int64), np.empty((most, 3), np.int64), np.empty((most, 5)),
        np.empty(9), np.empty(9), np.empty((6, 4)), np.empty((9, columns)), np.empty(3), np.empty(16, np.int64),
        np.empty((most + 128, 6), np.int64), np.empty((2, 6)),
    )  # fmt: skip


@njit
def grown(rows: Index) -> Index:
    """The same rows in an array twice as long."""
    longer = np.empty((2 * len(rows), rows.shape[1]), np.int64)
    for i in range(len(rows)):
        for c in range(rows.shape[1]):
            longer[i, c] = rows[i, c]
    return longer


@njit
def longer(rows: Array) -> Array:
    """The same rows in an array twice as long."""
    out = np.empty((2 * len(rows), rows.shape[1]))
    for i in range(len(rows)):
        for c in range(rows.shape[1]):
            out[i, c] = rows[i, c]
    return out


@njit_in_place
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


@njit_in_place
def load(
    net: Array, weights: Array, target: Array, rows_u: Array, first_u: Index, rows_v: Array, first_v: Index,
    row_u: Index, row_v: Index, tally: Index, box: Array, extent: Array, flags: Index, rows: Array, edge: Array,
) -> int:  # fmt: skip
    """Take in a net: homogeneous points, box, span boxes, closed directions and poles. 0: unchanged; 1: new; -1: not
    finite.

    box (spans, 6): low and high corner of each span's own (k+1)(l+1) control points. flags: closed in u, in v, poles
    (1, 2: first and last row of the grid; 4, 8: first and last column). rows (r, spans of v, 6), edge (2, max(r, s), 3) :
    scratch.
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
    spans_u, spans_v = tally[0, 0], tally[0, 1]
    # along v first, then along u
    for b in range(spans_v):
        j0 = first_v[row_v[0, b]]
        for i in range(r):
            for c in range(3):
                low, high = net[i, j0, c], net[i, j0, c]
                for j in range(j0 + 1, j0 + q):
                    low, high = min(low, net[i, j, c]), max(high, net[i, j, c])
                rows[i, b, c], rows[i, b, 3 + c] = low, high
    for a in range(spans_u):
        i0 = first_u[row_u[0, a]]
        for b in range(spans_v):
            k = a * spans_v + b
            for c in range(3):
                low, high = rows[i0, b, c], rows[i0, b, 3 + c]
                for i in range(i0 + 1, i0 + p):
                    low, high = min(low, rows[i, b, c]), max(high, rows[i, b, 3 + c])
                box[k, c], box[k, 3 + c] = low, high
    # the four edge curves, as control points of curves along the other direction
    flags[2] = 0
    for direction in range(2):
        length = s if direction == 0 else r
        table = rows_u if direction == 0 else rows_v
        first = first_u if direction == 0 else first_v
        for end in range(2):
            row = 0 if end == 0 else table.shape[1] - 1
            for k in range(length):
                x, y, z, w = 0.0, 0.0, 0.0, 0.0
                for e in range(table.shape[2]):
                    f = first[row] + e
                    i, j = (f, k) if direction == 0 else (k, f)
                    x += table[0, row, e] * target[i, j, 0]
                    y += table[0, row, e] * target[i, j, 1]
                    z += table[0, row, e] * target[i, j, 2]
                    w += table[0, row, e] * target[i, j, 3]
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


def spans_of(g: Patch) -> Spans:
    """The net and the knot spans of a loaded patch."""
    return Spans(
        g.net, g.knots_u, g.knots_v, g.degree_u, g.degree_v, g.rational, g.wrap_u, g.wrap_v, g.u, g.v,
        g.first_u, g.first_v, g.row_u, g.row_v, g.tally, g.slack,
    )  # fmt: skip


@njit_inline
def tree_of(g: Patch) -> Tree:
    """The cells of a loaded patch."""
    return Tree(g.tally, g.offset, g.row_u, g.row_v, g.child_u, g.child_v, g.covers, g.spheres, g.mark, g.slot)


@njit_inline_in_place
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


@njit_in_place
def make_points(g: Patch, names: Index, count: int) -> None:
    """The points of the vertices names[:count], each made once per net (paper eq. 2, one sparse row against one
    column)."""
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
