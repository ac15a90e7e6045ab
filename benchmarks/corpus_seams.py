"""How far the faces of a part gape where they share an edge, and how far its file allows them to."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadsculpt.formats.part import Face, Part
from cadsculpt.spline.surface import BSplineSurface
from cadsculpt.units import conversion

Array = NDArray[np.float64]

USUAL = 1e-6
"""Tolerance over the part's size where a file names none."""


def seam_gap(part: Part, face: Face) -> float:
    """The largest distance, mm, from a face's edges to the surfaces of the faces that share them."""
    worst = 0.0
    for edge in face.edges:
        if edge.degenerate or edge.seam:
            continue
        for number in edge.neighbours:
            other = part.faces.number(number)
            theirs = [e for e in other.edges if face.number in e.neighbours and len(e.points)]
            if theirs:
                start = np.concatenate([np.asarray(e.uv) for e in theirs])
                cloud = np.concatenate([np.asarray(e.points) for e in theirs])
                worst = max(worst, float(distance(other.surface, np.asarray(edge.points), start, cloud).max()))
    return worst


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
