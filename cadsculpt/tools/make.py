"""A tool from its [[tool]] table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..collide.mesh.triangle_mesh import TriangleMesh
from ..errors import InputError
from ..motion.pose import Pose
from ..scene import ShapeSpec, ToolSpec
from ..spline.surface import BSplineSurface
from .composed import ComposedTool
from .implicit import ImplicitTool
from .mesh import MeshTool
from .point import PointTool
from .superquadric import SuperquadricTool
from .surface import SurfaceTool

Array = NDArray[np.float64]
Body = ImplicitTool | SuperquadricTool | ComposedTool
"""A tool with a signed distance."""

Tool = Body | MeshTool | PointTool | SurfaceTool


def make_tool(
    spec: ToolSpec,
    spacing: float,
    thickness: float,
    resolution: int | tuple[int, int],
    surfaces: Sequence[BSplineSurface],
    mesh: TriangleMesh | None = None,
    cell: float = 0.0,
) -> Tool:
    """The rigid tool that a [[tool]] table describes.

    spacing : the finest node spacing; a point stands for one node's cell. thickness : the greatest of any material; below it
    a point is out of it. surfaces, mesh : what the file of a surface or mesh tool holds, in the scene's unit.
    cell : of a surface tool, how fine its grid may be (`SurfaceTool.of`).
    """
    where = f"tool {spec.name!r}"
    try:
        match spec.shape:
            case "point":
                return PointTool(spec.area or spacing**2, thickness)
            case "surface":
                return SurfaceTool.of(list(surfaces), resolution, cell)
            case "mesh":
                if mesh is None:
                    raise InputError("a mesh tool needs a file", mend='write file = "..."')
                return MeshTool.of(mesh)
        return make_body(spec)
    except InputError as error:
        inner = f", {error.where}" if error.where else ""
        raise type(error)(error.what, where=where + inner, mend=error.mend) from None


def make_body(spec: ShapeSpec) -> Body:
    """The solid that a table of a shape and its sizes describes, a part of a composed tool for one."""
    match spec.shape:
        case "sphere":
            return ImplicitTool.sphere(_size(spec, "radius"))
        case "ellipsoid":
            return ImplicitTool.ellipsoid(_sizes(spec, "radii"))
        case "capsule":
            return ImplicitTool.capsule(_size(spec, "radius"), _size(spec, "length"))
        case "cylinder":
            return ImplicitTool.cylinder(_size(spec, "radius"), _size(spec, "height"), spec.rounding or 0.0)
        case "cone":
            return ImplicitTool.cone(_size(spec, "radius"), _size(spec, "height"))
        case "box":
            return ImplicitTool.box(_sizes(spec, "size"), spec.rounding or 0.0)
        case "torus":
            return ImplicitTool.torus(_size(spec, "major_radius"), _size(spec, "minor_radius"))
        case "superquadric":
            return SuperquadricTool.of(_sizes(spec, "radii"), _given(spec, "exponents"))
        case "half_space":
            return ImplicitTool.half_space()
        case "formula":
            return ComposedTool.formula(_given(spec, "expression"), _given(spec, "box"))
        case "union":
            return ComposedTool.union(_parts(spec))
        case "intersection":
            return ComposedTool.intersection(_parts(spec))
        case "difference":
            return ComposedTool.difference(_parts(spec))
    raise InputError(f"a {spec.shape} is no solid with a formula", mend="use a sphere, box, torus, ...")


def _parts(spec: ShapeSpec) -> list[tuple[Body, Pose]]:
    parts: list[tuple[Body, Pose]] = []
    for number, part in enumerate(spec.part or (), start=1):
        try:
            parts.append((make_body(part), Pose.turned(part.at, part.turn[:3], part.turn[3])))
        except InputError as error:
            inner = f", {error.where}" if error.where else ""
            raise InputError(error.what, where=f"part {number}{inner}", mend=error.mend) from None
    return parts


def _given(spec: ShapeSpec, key: str) -> Any:
    value = getattr(spec, key)
    if value is None:
        raise InputError(f"a {spec.shape} needs {key}", mend=f"write {key} = ...")
    return value


def _size(spec: ShapeSpec, key: str) -> float:
    return float(_given(spec, key))


def _sizes(spec: ShapeSpec, key: str) -> tuple[float, float, float]:
    value = _given(spec, key)
    return float(value[0]), float(value[1]), float(value[2])
