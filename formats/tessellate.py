"""Faces as triangles, for pictures only: the surface on a grid of its trims' box, cut along the trims."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from ..errors import CadsculptError
from ..patch import face_window
from ..record import Frame, PatchFrame
from ..spline.surface import BSplineSurface
from ..spline.trim import inside, loop_polyline
from .frame_mesh import FaceMesh, FrameMesher, triangles_of
from .part import Part

Array = NDArray[np.float64]

ROWS = 33
MOST_POINTS = 400_000
"""Of all faces of a part together: above this the faces get coarser grids."""


def outlines(surface: BSplineSurface, u: Array, v: Array) -> list[Array]:
    """The trim loops (k, 2) in coordinates of the grid u (m,) x v (n,): (i, j) is the vertex in row i, column j."""
    if surface.trims is None:
        return []
    rows, columns = np.arange(len(u), dtype=np.float64), np.arange(len(v), dtype=np.float64)
    return [
        np.stack([np.interp(chain[:, 0], u, rows), np.interp(chain[:, 1], v, columns)], axis=1)
        for chain in (loop_polyline(loop) for loop in surface.trims)
    ]


def face_mesh(name: str, surface: BSplineSurface, factor: float = 1.0, rows: int = ROWS) -> FaceMesh:
    """A trimmed surface as triangles; points times `factor`."""
    (u0, u1), (v0, v1) = face_window(surface)
    u, v = np.linspace(u0, u1, rows), np.linspace(v0, v1, rows)
    points = surface.evaluate(u[:, None], v) * factor
    nothing = np.zeros(points.shape[:2])
    mask = None if surface.trims is None else inside(surface, u, v)
    patch = PatchFrame(name, points, 0.0 * points, nothing, nothing > 0, nothing, mask)
    mesh = FrameMesher({name: outlines(surface, u, v)} if surface.trims else None).mesh(Frame(0, 0.0, (patch,), ()))
    return FaceMesh(name, mesh.points, triangles_of(mesh)[0])


def background(part: Part, without: Collection[int], factor: float = 1.0) -> tuple[list[FaceMesh], list[str]]:
    """All faces of a part but those numbered in `without`, as triangles; and a warning for each that could not be drawn."""
    chosen = [face for face in part.faces if face.number not in without]
    rows = int(np.clip(np.sqrt(MOST_POINTS / max(1, len(chosen))), 9, ROWS))
    meshes, warnings = [], []
    for face in chosen:
        try:
            meshes.append(face_mesh(face.name, face.surface, factor, rows))
        except (CadsculptError, ValueError) as error:
            warnings.append(f"face {face.name!r} is not in the pictures: {error}")
    return meshes, warnings
