"""How far the faces of a part gape where they share an edge, and how far its file allows them to."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadsculpt.errors import CadsculptError
from cadsculpt.formats.loose_edges import join
from cadsculpt.formats.part import Face, FaceEdge, Part
from cadsculpt.spline.surface import BSplineSurface
from cadsculpt.units import conversion

Array = NDArray[np.float64]

USUAL = 1e-6
"""Tolerance over the part's size where a file names none."""


@dataclass(frozen=True, slots=True)
class Gap:
    """The largest distance, mm, from a face's edges to the faces that share them, and how many edges those are."""

    largest: float
    edges: int


def seam_gap(part: Part, face: Face, closed: tuple[bool, bool]) -> Gap:
    """How far a face's edges are from the surfaces of the faces that share them, and its own two sides where it is, or was,
    closed (along u, along v)."""
    edges = edges_by_face(part)
    worst, count = 0.0, 0
    for edge in edges[face.number]:
        if edge.degenerate or edge.seam:
            continue
        for number in edge.neighbours:
            theirs = [e for e in edges.get(number, ()) if face.number in e.neighbours and len(e.points)]
            if theirs:
                start = np.concatenate([np.asarray(e.uv) for e in theirs])
                cloud = np.concatenate([np.asarray(e.points) for e in theirs])
                other = part.faces.number(number)
                worst = max(worst, float(distance(other.surface, np.asarray(edge.points), start, cloud).max()))
                count += 1
    for gap in closing_gaps(face.surface, closed):
        worst, count = max(worst, gap), count + 1
    return Gap(worst, count)


def closing_gaps(surface: BSplineSurface, closed: tuple[bool, bool]) -> Iterator[float]:
    """For each direction in which a surface is closed, how far its two ends are apart."""
    (u0, u1), (v0, v1) = surface.domain
    u, v = np.linspace(u0, u1, 129), np.linspace(v0, v1, 129)
    if closed[0]:
        yield float(np.linalg.norm(surface.evaluate(u0, v) - surface.evaluate(u1, v), axis=-1).max())
    if closed[1]:
        yield float(np.linalg.norm(surface.evaluate(u, v0) - surface.evaluate(u, v1), axis=-1).max())


def edges_by_face(part: Part) -> dict[int, list[FaceEdge]]:
    """The edges of every face. Where the file does not say which of them are one, those that run together are."""
    edges: dict[int, list[FaceEdge]] = {}
    for face in part.faces:
        try:
            edges[face.number] = [edge for edge in face.edges if len(edge.points)]
        except CadsculptError:
            edges[face.number] = []
    if any(edge.neighbours for own in edges.values() for edge in own):
        return edges
    numbers = list(edges)
    joined = join([edges[number] for number in numbers])
    return {
        number: [replace(e, neighbours=tuple(numbers[k - 1] for k in e.neighbours)) for e in own]
        for number, own in zip(numbers, joined, strict=True)
    }


def distance(surface: BSplineSurface, points: Array, uv: Array, cloud: Array) -> Array:
    """Distance (n,) of points (n, 3) to a surface, by Gauss-Newton from the nearest of the places uv (m, 2), which are
    the points cloud (m, 3)."""
    from scipy.spatial import cKDTree

    near, index = cKDTree(cloud).query(points)
    place = uv[index].copy()
    low, high = np.array(surface.domain).T
    best = np.asarray(near, dtype=np.float64)
    for _ in range(12):
        d = surface.derivatives(place[:, 0], place[:, 1], 1)
        away = points - d[0, 0]
        best = np.minimum(best, np.linalg.norm(away, axis=1))
        jacobian = np.stack([d[1, 0], d[0, 1]], axis=2)
        normal = np.einsum("nki,nkj->nij", jacobian, jacobian)
        normal += 1e-14 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-300 * np.eye(2)
        step = np.linalg.solve(normal, np.einsum("nki,nk->ni", jacobian, away)[..., None])[..., 0]
        place = np.clip(place + np.nan_to_num(step), low, high)
    return best


def file_tolerance(part: Part) -> float:
    """The distance, mm, below which the part's file says that two points are one."""
    scale = conversion(part.units or "mm", "mm")
    size = _size(part)
    if part.format == "step":
        found = re.findall(
            rb"UNCERTAINTY_MEASURE_WITH_UNIT\s*\(\s*LENGTH_MEASURE\s*\(\s*([0-9.eE+-]+)", part.path.read_bytes()
        )
        if found:
            return max(float(x) for x in found) * scale
    if part.format == "iges":
        from cadsculpt.formats.iges_records import parse

        header = parse(part.path.read_bytes().decode("latin-1")).header
        try:
            return max(float(header[18].replace("D", "E")) * scale, USUAL * size)
        except (IndexError, ValueError):
            pass
    if part.format == "3dm":
        model: Any = getattr(part, "_model", None)
        if model is not None and model.Settings.ModelAbsoluteTolerance > 0.0:
            return float(model.Settings.ModelAbsoluteTolerance) * scale
    return USUAL * size


def _size(part: Part) -> float:
    boxes = np.array([face.bbox for face in part.faces if not face.warning])
    if not len(boxes):
        return 1.0
    return float(np.linalg.norm(boxes[:, 3:].max(axis=0) - boxes[:, :3].min(axis=0)))
