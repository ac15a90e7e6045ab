"""The collision pipeline in the paper's order (sections 4.1 to 4.7, 4.9): cull, window, spheres, triangles, contacts.

| tool | pipeline |
|---|---|
| surface (4.3 to 4.7) | hulls, window on both sides, spheres of both refined together, triangles, triangle tests, contacts |
| implicit (4.9.1) | box, window, spheres against its distance, contacts at the vertices |
| point (4.9.2) | box, spheres of the model that the point is nearest to, the closest point in what is left |

`mode="paper"` leaves out what goes beyond the paper: the sag in the spheres' radii, the conservative window, contacts of
tools smaller than a cell, containment. Conventions: see `contacts`. Depth is positive inside; the normal points out of the
model.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .contacts import Contacts
from .field_contacts import field_contacts
from .grid import PatchGrid
from .point_contacts import point_contacts
from .query import (
    BoundedField,
    Counters,
    Crossings,
    DetectCache,
    Detection,
    DetectOptions,
    DistanceField,
    FieldTool,
    PointTool,
    Run,
    SurfaceTool,
    Undecided,
)
from .surface_contacts import surface_contacts

__all__ = [
    "BoundedField",
    "Counters",
    "Crossings",
    "DetectCache",
    "DetectOptions",
    "Detection",
    "DistanceField",
    "FieldTool",
    "PatchGrid",
    "PointTool",
    "SurfaceTool",
    "Undecided",
    "detect",
]

Array = NDArray[np.float64]


def detect(
    grids: Sequence[PatchGrid],
    nets: Sequence[Array],
    tools: Sequence[FieldTool | PointTool | SurfaceTool],
    options: DetectOptions,
    *,
    body: int = 0,
    cache: DetectCache | None = None,
) -> Detection:
    """Contacts of one body's patches, over control points nets[i] (r, s, 3), with tools.

    In the result a is `body`, b the tool's place in `tools`, face the patch's in `grids`. Raises GeometryError for
    control points, InputError for a tool, that are not finite.
    """
    cache = DetectCache() if cache is None else cache
    cache.counters[:] = 0
    run = Run(grids, nets, options, cache, body, cache.boxes(-1, nets, "model"))
    contacts, crossings = [], []
    for index, tool in enumerate(tools):
        if isinstance(tool, FieldTool):
            contacts += field_contacts(run, index, tool)
        elif isinstance(tool, PointTool):
            contacts += point_contacts(run, index, tool)
        else:
            found, crossed = surface_contacts(run, index, tool)
            contacts += found
            crossings += crossed
    # parts come in the order of tools and faces, each in that of (u, v): one alone needs no sorting
    joined = contacts[0] if len(contacts) == 1 else Contacts.joined(contacts)
    counters = Counters(*(int(c) for c in cache.counters))
    return Detection(joined, counters, Crossings.joined(crossings), tuple(run.undecided))
