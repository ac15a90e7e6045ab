"""What a patch's grid of points and its levels of detail need, made once: nothing here depends on the control
points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError
from ..spline.basis import design_rows
from ..spline.matrices import TransformationMatrices, breakpoints, span_lengths
from ..spline.region import BORDER, OFF, ON, Region
from ..spline.surface import BSplineSurface

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

WITHIN = 1e-6
"""A trim that runs along a cell's border, to this part of the cell, does not cut it: most faces end where their surface
does."""

WHOLE = 0.7
"""A face that fills more than this part of its surface's domain has it cut evenly: nothing would be gained."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchGrid:
    """Everything about one patch that does not depend on the control points.

    surface : degrees, knots, weights, trims, outward; its control points are the rest net. matrices : the finest
    resolution. strides : the levels of detail, coarse to fine, ending in 1; the rows of a level are every stride-th
    row inside each knot span and all breakpoints. inside : (m, n), whether a grid vertex lies on the trimmed face;
    region : the face in (u, v); pieces (m - 1, n - 1) : whether a finest cell lies off it, on it or across its border;
    all three None when all of the surface is the face. row_u (levels, m), child_u (levels, m) : per level (0: the
    spans) its rows, and for each cell the first of its children on the next level; likewise v. tally (levels, 2),
    offset (levels + 1,) : cells along u and v, and where each level starts in arrays over all cells. covers : whether a
    cell holds a piece of the face, with or without a vertex in it. spans (k, 3) : the cells of level 0 that do.
    frames (2, spans, 2 + (degree + 1)^2) : for every interval of knots along u and v its middle, 2 over its length, and the
    matrix from its control points to Taylor's series about the middle in parts of half the length.
    """

    surface: BSplineSurface
    matrices: TransformationMatrices
    strides: tuple[int, ...]
    inside: Mask | None
    region: Region | None
    pieces: Index | None
    row_u: Index
    row_v: Index
    child_u: Index
    child_v: Index
    tally: Index
    offset: Index
    covers: Mask
    spans: Index
    on_face: Mask
    span_u: Index
    span_v: Index
    knots_u: Array
    knots_v: Array
    weights: Array
    frames: Array

    @classmethod
    def of(cls, surface: BSplineSurface, resolution: int | tuple[int, int]) -> PatchGrid:
        """The grid with about `resolution` rows and columns (or (rows, columns)) over the face, at least one cell per
        span.

        Raises GeometryError when the surface is none (`validate`), when the trimmed face is so small that no vertex lies
        on it, or when the resolution is below 2.
        """
        surface.validate()
        rows, columns = (resolution, resolution) if isinstance(resolution, int) else resolution
        if min(rows, columns) < 2:
            raise GeometryError(f"a collision resolution of {min(rows, columns)}", mend="2 rows are one cell")
        region = Region.of(surface)
        for _ in range(4):
            matrices = _matrices(surface, (rows - 1, columns - 1))
            if region is None:
                return cls._with(surface, matrices)
            pieces = _pieces(region, matrices)
            if (pieces == ON).all():
                return cls._with(surface, matrices)
            inside = _inside(region, pieces, matrices)
            if inside.any():
                return cls._with(surface, matrices, inside, region, pieces)
            rows, columns = 2 * rows - 1, 2 * columns - 1
        raise GeometryError(
            "the trimmed face is too small for the collision grid: no vertex lies on it",
            where=surface.name or surface.provenance.entity or "surface",
            mend="raise the resolution or leave the face out",
        )

    @classmethod
    def _with(
        cls,
        surface: BSplineSurface,
        matrices: TransformationMatrices,
        inside: Mask | None = None,
        region: Region | None = None,
        pieces: Index | None = None,
    ) -> PatchGrid:
        starts = (matrices.span_start_u, matrices.span_start_v)
        most = max(int(np.diff(start).max()) for start in starts)
        # the coarsest level cuts the largest spans in two; the spans themselves are the level above it
        strides = tuple(2**k for k in range(max(0, (most - 1).bit_length() - 1), -1, -1))
        tables = [_levels(start, strides) for start in starts]
        tally = np.stack([tables[0][2], tables[1][2]], axis=1)
        offset = np.concatenate([[0], np.cumsum(tally.prod(axis=1))])
        covers = np.ones(offset[-1], dtype=np.bool_)
        if pieces is not None:
            before = np.zeros(matrices.shape, dtype=np.int64)
            before[1:, 1:] = (pieces != OFF).cumsum(axis=0).cumsum(axis=1)
            for level, (cells_u, cells_v) in enumerate(tally):
                a, b = tables[0][0][level, : cells_u + 1], tables[1][0][level, : cells_v + 1]
                covers[offset[level] : offset[level + 1]] = (np.diff(np.diff(before[np.ix_(a, b)], axis=0)) > 0).ravel()
        return cls(
            surface=surface,
            matrices=matrices,
            strides=strides,
            inside=inside,
            region=region,
            pieces=pieces,
            row_u=tables[0][0],
            row_v=tables[1][0],
            child_u=tables[0][1],
            child_v=tables[1][1],
            tally=tally,
            offset=offset,
            covers=covers,
            spans=np.array(
                [(0, k // tally[0, 1], k % tally[0, 1]) for k in np.flatnonzero(covers[: offset[1]])], np.int64
            ),
            on_face=np.ones(matrices.shape[0] * matrices.shape[1], dtype=np.bool_)
            if inside is None
            else inside.ravel(),
            span_u=_span_of_row(starts[0]),
            span_v=_span_of_row(starts[1]),
            knots_u=np.array(surface.knots_u),
            knots_v=np.array(surface.knots_v),
            weights=np.ones(surface.shape) if surface.weights is None else np.array(surface.weights),
            frames=_frames(surface),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n): rows and columns of the finest grid."""
        return self.matrices.shape


def _matrices(surface: BSplineSurface, cells: tuple[int, int]) -> TransformationMatrices:
    """The transformation matrices with about this many cells along u and v over the face.

    Where the face fills its surface, each knot span is cut evenly. Where it does not (a face cut out of a sheet that
    runs on for kilometres), its window is, and what lies beyond gets one cell a span.
    """
    parts = []
    for axis, (knots, degree) in enumerate(((surface.knots_u, surface.degree_u), (surface.knots_v, surface.degree_v))):
        t, start = _rows(surface, axis, cells[axis])
        count = len(knots) - degree - 1
        first, rows = np.empty(len(t), dtype=np.int64), np.empty((3, len(t), degree + 1))
        design_rows(knots, degree, count, t, 2, first, rows)
        dense = np.zeros((2, len(t), count))
        for k in range(2):
            np.put_along_axis(dense[k], first[:, None] + np.arange(degree + 1), rows[k], axis=1)
        parts.append((t, start, first, rows, dense))
    (u, su, fu, ru, du), (v, sv, fv, rv, dv) = parts
    return TransformationMatrices(u, v, du[0], dv[0], du[1], dv[1], fu, fv, ru, rv, su, sv)


def _frames(surface: BSplineSurface) -> Array:
    """The `frames` of `PatchGrid`; of an interval without length, zeros."""
    r, s = surface.shape
    p, q = surface.degree_u, surface.degree_v
    out = np.zeros((2, max(r - p, s - q), 2 + (max(p, q) + 1) ** 2))
    for axis, (knots, degree, count) in enumerate(((surface.knots_u, p, r), (surface.knots_v, q, s))):
        low, high = knots[degree:count], knots[degree + 1 : count + 1]
        long = np.flatnonzero(high > low)
        middle, half = 0.5 * (low[long] + high[long]), 0.5 * (high[long] - low[long])
        first, rows = np.empty(len(long), dtype=np.int64), np.empty((degree + 1, len(long), degree + 1))
        design_rows(knots, degree, count, middle, degree, first, rows)
        scale = np.cumprod(np.concatenate([np.ones((1, len(long))), half / np.arange(1, degree + 1)[:, None]]), axis=0)
        out[axis, long, 0], out[axis, long, 1] = middle, 1.0 / half
        out[axis, long, 2 : 2 + (degree + 1) ** 2] = (
            (rows * scale[:, :, None]).transpose(1, 0, 2).reshape(len(long), -1)
        )
    return out


def _rows(surface: BSplineSurface, axis: int, total: int) -> tuple[Array, Index]:
    """Parameters (m,) of the grid's rows along an axis, breakpoints among them, and the row where each span starts."""
    knots, degree = ((surface.knots_u, surface.degree_u), (surface.knots_v, surface.degree_v))[axis]
    b = breakpoints(knots, degree)
    low, high = b[0], b[-1]
    if surface.trims is not None:
        from ..spline.trim import box

        face = [float(corner[axis]) for corner in box(surface.trims)]
        # a row beyond either end, so that the face's edge runs through cells
        beyond = (face[1] - face[0]) / total
        low, high = max(low, face[0] - beyond), min(high, face[1] + beyond)
        if not high > low or high - low > WHOLE * (b[-1] - b[0]):
            low, high = b[0], b[-1]
    reached = np.clip((np.minimum(b[1:], high) - np.maximum(b[:-1], low)) / np.diff(b), 0.0, 1.0)
    length = span_lengths(surface, axis) * reached
    wanted = length * (total / length.sum()) if length.sum() > 0 else total * reached / reached.sum()
    pieces = []
    for k, cells in enumerate(np.maximum(1, np.rint(wanted).astype(np.int64))):
        start, end = max(b[k], low), min(b[k + 1], high)
        inner = start + (end - start) * (np.arange(cells) / cells) if end > start else b[k : k + 1]
        if start > b[k] and end > start:
            inner = np.concatenate([b[k : k + 1], inner])
        if b[k + 1] > end > start:
            inner = np.concatenate([inner, [end]])
        pieces.append(inner)
    starts = np.concatenate([[0], np.cumsum([len(piece) for piece in pieces])])
    return np.concatenate([*pieces, b[-1:]]), starts


def _pieces(region: Region, matrices: TransformationMatrices) -> Index:
    """OFF, ON or MIXED for every finest cell: (m - 1, n - 1)."""
    ends = []
    for t, size in ((matrices.u, region.size[0]), (matrices.v, region.size[1])):
        within = np.minimum(WITHIN * np.diff(t) + BORDER * size, 0.25 * np.diff(t))
        ends.append((t[:-1] + within, t[1:] - within))
    (u0, u1), (v0, v1) = ends
    rectangles = np.empty((len(u0), len(v0), 4))
    rectangles[..., 0], rectangles[..., 1] = u0[:, None], u1[:, None]
    rectangles[..., 2], rectangles[..., 3] = v0, v1
    return region.classify(rectangles.reshape(-1, 4)).reshape(len(u0), len(v0))


def _inside(region: Region, pieces: Index, matrices: TransformationMatrices) -> Mask:
    """Which vertices lie on the face or its border: (m, n)."""
    on = np.zeros(matrices.shape, dtype=np.bool_)
    on[:-1, :-1] = pieces == ON
    for shift_u, shift_v in ((1, 0), (0, 1), (1, 1)):
        on[shift_u : len(on) + shift_u - 1, shift_v : on.shape[1] + shift_v - 1] |= pieces == ON
    i, j = np.nonzero(~on)
    on[i, j] = region.locate(np.stack([matrices.u[i], matrices.v[j]], axis=1)) != OFF
    return on


def _levels(start: Index, strides: tuple[int, ...]) -> tuple[Index, Index, Index]:
    """Rows (levels, m), first child (levels, m) and number of cells (levels,) of the levels over spans
    start[i]..start[i+1]."""
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
