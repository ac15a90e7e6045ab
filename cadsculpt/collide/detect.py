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

from .contacts import ContactBuffer
from .field_contacts import field_contacts
from .grid import PatchGrid
from .point_contacts import point_contacts
from .query import (
    NO_CROSSINGS,
    BoundedField,
    Counters,
    Crossings,
    DetectCache,
    Detection,
    DetectOptions,
    DistanceField,
    FieldTool,
    PointTool,
    RigidSurfaceTool,
    Run,
    SurfaceTool,
    Undecided,
)
from .shape_contacts import shape_contacts
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
    "RigidSurfaceTool",
    "SurfaceTool",
    "Undecided",
    "detect",
]

Array = NDArray[np.float64]


def detect(
    grids: Sequence[PatchGrid],
    nets: Sequence[Array],
    tools: Sequence[FieldTool | PointTool | SurfaceTool | RigidSurfaceTool],
    options: DetectOptions,
    *,
    body: int = 0,
    cache: DetectCache | None = None,
    faces: Sequence[int] | None = None,
    others: Sequence[int] | None = None,
    into: ContactBuffer | None = None,
) -> Detection:
    """Contacts of one body's patches, over control points nets[i] (r, s, 3), with tools.

    In the result a is `body`, b the tool's place in `tools`, face the patch's in `grids`, or what `others` and `faces` say for
    them. into : a buffer, behind whose rows the contacts are put; those of the result are then a view of it, valid until
    the next detection into it, and nothing is allocated once it and the cache are warm. Raises GeometryError for control
    points, InputError for a tool, that are not finite.
    """
    cache = DetectCache() if cache is None else cache
    cache.counters[:] = 0
    out = ContactBuffer() if into is None else into
    start = out.count
    boxes = cache.boxes(-1, nets, "model")
    faces, others = range(len(grids)) if faces is None else faces, range(len(tools)) if others is None else others
    run = Run(grids, nets, options, cache, body, boxes, out, faces, others)
    crossings = []
    for index, tool in enumerate(tools):
        if isinstance(tool, FieldTool):
            if tool.shape is not None and not run.paper:
                shape_contacts(run, index, tool, tool.shape)
            else:
                field_contacts(run, index, tool)
        elif isinstance(tool, PointTool):
            point_contacts(run, index, tool)
        else:
            crossings += surface_contacts(run, index, tool)
    # they come in the order of tools and faces, each in that of (u, v), as a rule
    out.sort(start)
    counters = Counters(*cache.counters.tolist())
    contacts = out.view(start) if into is not None else out.view(start).copy()
    return Detection(
        contacts, counters, Crossings.joined(crossings) if crossings else NO_CROSSINGS, tuple(run.undecided)
    )
