"""Certified distance of any two bodies: an interval that holds it, and points that attain its upper end.

| bodies | search |
|---|---|
| B-spline, B-spline | pairs of cells (`surface_distance`) |
| B-spline, field or point | cells (`field_distance`) |
| mesh, mesh | pairs of triangles (`mesh_distance`), exact to rounding |
| field or point, field or point | a tree of boxes (`field_distance`) |

A B-spline body is its faces, a field the solid that it bounds. That one body lies inside another whose faces it does not
meet is for `proximity` to say.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ..mesh.distance import meshes_distance
from ..mesh.field import StandingMesh
from ..query import DistanceField, FieldTool, PointTool, SurfaceTool
from .body import GridCache, SurfaceBody
from .field_distance import PointField, box_of, fields_distance, surface_field_distance
from .interval import BUDGET, DistanceInterval, Goal
from .surface_distance import surface_distance

Array = NDArray[np.float64]
Body = FieldTool | PointTool | SurfaceTool

TOLERANCE = 1e-6
"""Width of the interval that is asked for, relative to the smaller body's size, where nothing else is."""


def distance(
    a: Body,
    b: Body,
    *,
    tolerance: float | None = None,
    threshold: float | None = None,
    budget: int = BUDGET,
    cache: GridCache | None = None,
) -> DistanceInterval:
    """The distance of two bodies, in [low, high].

    tolerance : width of the interval that is enough; None: TOLERANCE of the smaller body. threshold : the search ends as
    soon as the distance is known to be above it, or not above it. budget : pairs of cells looked at, at most; then the
    interval is wider and says `exhausted`. cache : what is reused between calls about the same grids.

    Raises GeometryError for control points, InputError for fields, that are not finite, and for two fields without end.
    """
    cache = GridCache() if cache is None else cache
    first, second = prepared(a, "first body", cache), prepared(b, "second body", cache)
    return between(first, second, tolerance=tolerance, threshold=threshold, budget=budget)


def between(
    first: SurfaceBody | DistanceField,
    second: SurfaceBody | DistanceField,
    *,
    tolerance: float | None = None,
    threshold: float | None = None,
    budget: int = BUDGET,
) -> DistanceInterval:
    """The distance of two bodies that are `prepared`; arguments as for `distance`."""
    if tolerance is None:
        tolerance = TOLERANCE * smaller_size([first, second])
    goal = Goal(tolerance, threshold, budget)
    if isinstance(first, SurfaceBody) and isinstance(second, SurfaceBody):
        return surface_distance(first, second, goal).interval()
    if isinstance(first, SurfaceBody) and not isinstance(second, SurfaceBody):
        return surface_field_distance(first, second, goal).interval()
    if isinstance(second, SurfaceBody) and not isinstance(first, SurfaceBody):
        return surface_field_distance(second, first, goal).interval(swapped=True)
    assert not isinstance(first, SurfaceBody)
    assert not isinstance(second, SurfaceBody)
    if isinstance(first, StandingMesh) and isinstance(second, StandingMesh):
        return meshes_distance(first.in_world(), second.in_world(), goal)
    return fields_distance(first, second, goal).interval()


def prepared(body: Body, whose: str, cache: GridCache) -> SurfaceBody | DistanceField:
    """A body as the searches take it. Raises GeometryError or InputError where it is not finite."""
    if isinstance(body, SurfaceTool):
        if not body.grids:
            raise InputError("a body without a face", where=whose)
        return SurfaceBody(body, whose, cache)
    if isinstance(body, PointTool):
        if not np.isfinite(body.position).all():
            raise InputError("a point's position is not finite", where=whose)
        return PointField(body.position)
    box_of(body.field)
    return body.field


def size_of(side: SurfaceBody | DistanceField) -> float:
    """Diagonal of a body's box; 0 for a point, infinite for a half-space."""
    if isinstance(side, SurfaceBody):
        return side.size
    box = box_of(side)
    return float(np.linalg.norm(box[1] - box[0])) if np.isfinite(box).all() else np.inf


def smaller_size(sides: list[SurfaceBody | DistanceField]) -> float:
    """Diagonal of the smaller body that is no point; of two points, how far from the origin they are."""
    sizes = [size for size in map(size_of, sides) if 0.0 < size < np.inf]
    if sizes:
        return min(sizes)
    places = [np.asarray(side.box()) for side in sides if not isinstance(side, SurfaceBody)]
    return max(1.0, *(float(np.abs(place[np.isfinite(place)]).max(initial=0.0)) for place in places), 0.0)
