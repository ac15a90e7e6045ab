"""Do two bodies touch? The front of certified collision: any two surfaces, parts, solids, meshes or points.

result = cs.collide(cs.read("housing.step"), cs.read("lid.step"), clearance=0.5)
result.verdict, result.kind          # "clear", "contact" or "undecided"; "clear", "touching", "piercing", "contained"
result.distance.low, result.distance.high
result.contacts.point                # where, with (u, v) on both sides
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeAlias

import numpy as np

from .collide import detect
from .collide.certified.distance import Body
from .collide.certified.interval import BUDGET
from .collide.certified.proximity import Proximity, proximity
from .collide.grid import PatchGrid
from .collide.mesh.field import MeshField
from .collide.mesh.triangle_mesh import TriangleMesh
from .errors import GeometryError, InputError
from .motion.pose import Pose
from .spline.surface import BSplineSurface
from .tools.mesh import PlacedMesh

Collidable: TypeAlias = Any
"""A `BSplineSurface`; a part or a face as `read` gives them; several of these as one body; a tool (`ImplicitTool`,
`MeshTool`, `PointTool`, `SurfaceTool`, ...); a `TriangleMesh`; or (one of these, Pose)."""

RESOLUTION = 33
"""Rows and columns on which crossings are looked for; the distance does not depend on them."""

FINEST = 513
"""A face of which no grid of so many rows and columns has a vertex is refused."""


def collide(
    a: Collidable,
    b: Collidable,
    *,
    clearance: float = 0.0,
    tolerance: float | None = None,
    touch: float | None = None,
    resolution: int = RESOLUTION,
    budget: int = BUDGET,
) -> Proximity:
    """Whether a and b touch or come nearer than `clearance`, how they lie to each other, how far apart they are, and where.

    All lengths are in the unit of a and b (mm for parts). tolerance : how narrow the distance's interval is to be; None: a
    millionth of the smaller body. touch : what is nearer counts as touching; None: a millionth, too. budget : pairs of
    surface cells looked at before the answer is "undecided"; the interval is certified all the same.

    Raises InputError for what is no body, GeometryError for surfaces that cannot be taken (NaN, bad knots or weights).
    """
    first, second = (body_of(thing, resolution, whose) for thing, whose in ((a, "a"), (b, "b")))
    return proximity(first, second, clearance=clearance, tolerance=tolerance, touch=touch, budget=budget)


def body_of(thing: Collidable, resolution: int = RESOLUTION, whose: str = "body") -> Body:
    """What collision takes, of anything that it may be given. Raises as `collide` does, naming `whose`."""
    thing, pose = thing if _posed(thing) else (thing, Pose())
    if isinstance(thing, (detect.SurfaceTool, detect.FieldTool, detect.PointTool)):
        return thing
    if isinstance(thing, TriangleMesh):
        return detect.FieldTool(PlacedMesh(MeshField.of(thing), pose))
    if hasattr(thing, "placed"):
        placed: Body = thing.placed(pose)
        return placed
    surfaces = list(_surfaces(thing, whose))
    if not surfaces:
        raise InputError("no surface to collide", where=whose, mend="give a surface, a face, a part or a tool")
    grids = tuple(_grid(surface, resolution, whose) for surface in surfaces)
    return detect.SurfaceTool(grids, tuple(np.array(pose.to_world(surface.control_points)) for surface in surfaces))


def _posed(thing: Collidable) -> bool:
    return isinstance(thing, tuple) and len(thing) == 2 and isinstance(thing[1], Pose)


def _surfaces(thing: Collidable, whose: str) -> Iterable[BSplineSurface]:
    if isinstance(thing, BSplineSurface):
        yield thing
    elif hasattr(thing, "faces"):  # a part
        for face in thing.faces:
            yield from _surfaces(face, whose)
    elif hasattr(thing, "surface") and hasattr(thing, "number"):  # a face
        try:
            yield thing.surface
        except InputError as error:
            raise type(error)(error.what, where=f"{whose}, face {thing.name!r}", mend=error.mend) from None
    elif isinstance(thing, Iterable) and not isinstance(thing, (str, bytes)):
        for item in thing:
            yield from _surfaces(item, whose)
    else:
        mend = "read files first: cs.read(path)" if isinstance(thing, str) else "a surface, a face, a part or a tool"
        raise InputError(f"{thing!r:.60} is no body", where=whose, mend=mend)


def _grid(surface: BSplineSurface, resolution: int, whose: str) -> PatchGrid:
    surface.validate()
    while True:
        try:
            return PatchGrid.of(surface, resolution)
        except GeometryError as error:
            if resolution >= FINEST or surface.trims is None:
                name = f", face {surface.name!r}" if surface.name else ""
                raise GeometryError(error.what, where=f"{whose}{name}", mend=error.mend) from None
            resolution = 2 * resolution - 1
