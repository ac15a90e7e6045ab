"""A frame as one polygon mesh: what the VTK series, the pictures and the report all draw.

A patch's grid becomes quadrilaterals where the face is whole. Along a trim there are two ways. When the outlines of the
face are known (its trim loops in grid coordinates), boundary cells are cut where the outline crosses the grid's lines,
so that a hole is round; new vertices are interpolated along the grid's edges. Otherwise only whole cells and those with
three vertices inside are drawn. The connectivity of a patch is made once and serves every frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..record import Frame, PatchFrame

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

Outlines = Mapping[str, Sequence[Array]]
"""Per patch, closed loops (k, 2) in grid coordinates: (i, j) is the vertex in row i and column j."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceMesh:
    """A face of the part that is not sculpted, for the background: points (k, 3), triangles (f, 3)."""

    name: str
    points: Array
    triangles: Index


@dataclass(frozen=True, slots=True, eq=False)
class FrameMesh:
    """One frame as polygons, patches first, then tools.

    bodies : the names; tool (nb,) : which of them are tools. points (k, 3); body (k,) : the body of each point.
    displacement (k, 3) : zero on rigid tools. pressure (k,) [Pa], contact (k,), stress (k,) [Pa] : zero on tools.
    Polygon c has the points
    connectivity[offsets[c]:offsets[c + 1]] and belongs to cell_body[c].
    """

    step: int
    time: float
    bodies: tuple[str, ...]
    tool: Flags
    points: Array
    body: Index
    displacement: Array
    pressure: Array
    contact: Flags
    stress: Array
    connectivity: Index
    offsets: Index
    cell_body: Index


@dataclass(frozen=True, slots=True, eq=False)
class _GridMesh:
    """Connectivity of a patch. Vertex n lies a fraction t[n] along the grid's edge from flat index a[n] to b[n]."""

    a: Index
    b: Index
    t: Array
    connectivity: Index
    offsets: Index

    def at(self, grid: Array) -> Array:
        """Values (m, n, ...) of the grid at the mesh's vertices."""
        flat = grid.reshape(grid.shape[0] * grid.shape[1], *grid.shape[2:])
        values: Array = np.array(flat[self.a])
        cut = np.flatnonzero(self.t)
        t = self.t[cut].reshape(-1, *(1,) * (flat.ndim - 1))
        values[cut] += t * (flat[self.b[cut]] - flat[self.a[cut]])
        return values

    def flags_at(self, grid: Flags) -> Flags:
        """Flags (m, n) of the nearer end of each vertex' edge; of the vertex inside, at a tie."""
        flat = grid.reshape(-1)
        return np.where(self.t <= 0.5, flat[self.a], flat[self.b])


class FrameMesher:
    """Turns frames into meshes, keeping the connectivity of each patch as long as its shape and mask stay."""

    def __init__(self, outlines: Outlines | None = None) -> None:
        self._outlines = outlines or {}
        self._grids: dict[str, tuple[Flags, _GridMesh]] = {}

    def mesh(self, frame: Frame) -> FrameMesh:
        """All patches and tools of a frame as one mesh."""
        grids = [self._grid(patch) for patch in frame.patches]
        patches = list(zip(frame.patches, grids, strict=True))
        tool_points = [np.asarray(tool.points, np.float64).reshape(-1, 3) for tool in frame.tools]
        nothing = [np.zeros(len(points)) for points in tool_points]
        points = [grid.at(patch.points) for patch, grid in patches] + tool_points
        sizes = [len(p) for p in points]
        first = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        corners = [grid.connectivity for grid in grids] + [tool.triangles.reshape(-1) for tool in frame.tools]
        lengths = [np.diff(grid.offsets) for grid in grids] + [np.full(len(tool.triangles), 3) for tool in frame.tools]
        count = len(points)
        return FrameMesh(
            step=frame.step,
            time=frame.time,
            bodies=tuple(patch.name for patch in frame.patches) + tuple(tool.name for tool in frame.tools),
            tool=np.arange(count) >= len(patches),
            points=_joined(points, (0, 3)),
            body=np.repeat(np.arange(count), sizes).astype(np.int64),
            displacement=_joined(
                [g.at(p.displacement) for p, g in patches]
                + [np.zeros((len(t.points), 3)) if t.displacement is None else t.displacement for t in frame.tools],
                (0, 3),
            ),
            pressure=_joined([g.at(p.pressure) for p, g in patches] + nothing, (0,)),
            contact=_joined([g.flags_at(p.contact).astype(float) for p, g in patches] + nothing, (0,)) > 0.0,
            stress=_joined([g.at(p.stress) for p, g in patches] + nothing, (0,)),
            connectivity=_joined([c + start for c, start in zip(corners, first, strict=False)], (0,)).astype(np.int64),
            offsets=np.concatenate([[0], np.cumsum(_joined(lengths, (0,)))]).astype(np.int64),
            cell_body=np.repeat(np.arange(count), [len(n) for n in lengths]).astype(np.int64),
        )

    def _grid(self, patch: PatchFrame) -> _GridMesh:
        rows, columns = patch.points.shape[:2]
        inside = np.ones((rows, columns), np.bool_) if patch.inside is None else patch.inside
        known = self._grids.get(patch.name)
        if known is not None and (known[0] is patch.inside or np.array_equal(known[0], inside)):
            return known[1]
        grid = _cut_grid(inside, self._outlines.get(patch.name))
        self._grids[patch.name] = (inside, grid)
        return grid


def triangles_of(mesh: FrameMesh) -> tuple[Index, Index]:
    """The polygons as triangle fans: corners (t, 3) and the body (t,) of each. Polygons are convex in (u, v)."""
    sides = np.diff(mesh.offsets)
    fans = np.maximum(sides - 2, 0)
    cell = np.repeat(np.arange(len(sides)), fans)
    within = np.arange(len(cell)) - np.repeat(np.cumsum(fans) - fans, fans)
    start = mesh.offsets[cell]
    corners = np.stack([start, start + within + 1, start + within + 2], axis=1)
    return mesh.connectivity[corners], mesh.cell_body[cell]


def normal_displacement(mesh: FrameMesh) -> Array:
    """Displacement (k,) along the rest shape's normal S_u x S_v, signed; zero on tools. Length unit of the mesh."""
    corners, body = triangles_of(mesh)
    corners = corners[~mesh.tool[body]]
    rest = mesh.points - mesh.displacement
    cross = np.cross(rest[corners[:, 1]] - rest[corners[:, 0]], rest[corners[:, 2]] - rest[corners[:, 0]])
    normals = np.zeros_like(rest)
    for corner in range(3):
        np.add.at(normals, corners[:, corner], cross)
    length = np.linalg.norm(normals, axis=1)
    along = np.einsum("ij,ij->i", mesh.displacement, normals)
    signed: Array = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
    return signed


def evenly(count: int, most: int) -> list[int]:
    """At most `most` of the numbers 0 to count - 1, evenly spread, first and last among them."""
    return sorted(set(np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist())) if count else []


def borders(triangles: Index) -> Index:
    """Edges (e, 2) that one triangle alone has: the outline of a face."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    single: Index = edges[count == 1]
    return single


def _joined(parts: Sequence[NDArray[np.generic]], empty: tuple[int, ...]) -> Array:
    return np.concatenate(parts) if parts else np.zeros(empty)  # type: ignore[return-value]


# Corners of a cell in order around it, and the grid's edge after each corner: (di, dj) of its first vertex, and the
# axis it runs along (0: to the next row, 1: to the next column).
_CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))
_EDGES = ((0, 0, 0), (1, 0, 1), (0, 1, 0), (0, 0, 1))


def _cut_grid(inside: Flags, outline: Sequence[Array] | None) -> _GridMesh:
    rows, columns = inside.shape
    flat = np.arange(rows * columns).reshape(rows, columns)
    corners = np.stack([flat[di : rows - 1 + di, dj : columns - 1 + dj] for di, dj in _CORNERS], axis=-1)
    held = inside.reshape(-1)[corners]
    count = held.sum(axis=-1)
    quads = corners[count == 4]
    if outline is None:
        partial = count == 3
        # the three corners that are inside, in their order around the cell
        loose = corners[partial][held[partial]].reshape(-1, 3)
        cut_a, cut_b, cut_t = np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
        polygons = [*loose.tolist()]
    else:
        polygons, cut_a, cut_b, cut_t = _cut_cells(inside, outline, np.argwhere((count > 0) & (count < 4)))
    # vertices in use, numbered anew: grid vertices in grid order, then the cuts in the order they were met
    total = rows * columns
    connectivity = np.concatenate([quads.reshape(-1), np.array([n for p in polygons for n in p], np.int64)])
    used = np.unique(connectivity)
    number = np.zeros(total + len(cut_a), np.int64)
    number[used] = np.arange(len(used))
    on_grid = used[used < total]
    sides = np.concatenate([np.full(len(quads), 4), np.array([len(p) for p in polygons], np.int64)])
    kept = used[used >= total] - total
    return _GridMesh(
        a=np.concatenate([on_grid, cut_a[kept]]),
        b=np.concatenate([on_grid, cut_b[kept]]),
        t=np.concatenate([np.zeros(len(on_grid)), cut_t[kept]]),
        connectivity=number[connectivity],
        offsets=np.concatenate([[0], np.cumsum(sides)]).astype(np.int64),
    )


def _cut_cells(
    inside: Flags, outline: Sequence[Array], cells: NDArray[np.intp]
) -> tuple[list[list[int]], Index, Index, Array]:
    """Polygons of the cells that a trim crosses, and the grid's edges a, b, t of the cut vertices.

    Cut vertices are numbered from rows * columns on; a is the end inside.
    """
    rows, columns = inside.shape
    crossings = _crossings(outline)
    cuts: dict[tuple[int, int, int], int] = {}
    ends: list[tuple[int, int, float]] = []

    def cut(i: int, j: int, axis: int) -> int:
        edge = (i, j, axis)
        if edge not in cuts:
            k, m = (i + 1, j) if axis == 0 else (i, j + 1)
            found = crossings.get(edge)
            if inside[i, j]:
                ends.append((i * columns + j, k * columns + m, min(found) if found else 0.5))
            else:
                ends.append((k * columns + m, i * columns + j, 1.0 - max(found) if found else 0.5))
            cuts[edge] = rows * columns + len(ends) - 1
        return cuts[edge]

    polygons = []
    for i, j in cells.tolist():
        held = [bool(inside[i + di, j + dj]) for di, dj in _CORNERS]
        polygon = []
        for corner, (di, dj) in enumerate(_CORNERS):
            if held[corner]:
                polygon.append((i + di) * columns + j + dj)
            if held[corner] != held[(corner + 1) % 4]:
                ei, ej, axis = _EDGES[corner]
                polygon.append(cut(i + ei, j + ej, axis))
        polygons.append(polygon)
    table = np.array(ends, np.float64).reshape(-1, 3)
    return polygons, table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2]


def _crossings(outline: Sequence[Array]) -> dict[tuple[int, int, int], list[float]]:
    """Where the loops cross the grid's edges: (i, j, axis) of an edge -> fractions along it."""
    found: dict[tuple[int, int, int], list[float]] = {}
    for loop in outline:
        closed = np.concatenate([loop, loop[:1]])
        for axis in (0, 1):
            # an edge that runs along `axis` lies on a line of constant index in the other direction
            across = closed[:, 1 - axis]
            along = closed[:, axis]
            for n in np.flatnonzero(np.floor(across[:-1]) != np.floor(across[1:])).tolist():
                low, high = sorted((across[n], across[n + 1]))
                for line in range(int(np.floor(low)) + 1, int(np.floor(high)) + 1):
                    s = (line - across[n]) / (across[n + 1] - across[n])
                    place = along[n] + s * (along[n + 1] - along[n])
                    cell = int(np.floor(place))
                    edge = (cell, line, 0) if axis == 0 else (line, cell, 1)
                    found.setdefault(edge, []).append(float(place - cell))
    return found
