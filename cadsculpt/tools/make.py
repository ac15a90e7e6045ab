"""A tool from its [[tool]] table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..scene import ToolSpec
from ..spline.surface import BSplineSurface
from .implicit import ImplicitTool
from .point import PointTool
from .surface import SurfaceTool

Array = NDArray[np.float64]
Tool = ImplicitTool | PointTool | SurfaceTool


def make_tool(
    spec: ToolSpec,
    spacing: float,
    thickness: float,
    resolution: int | tuple[int, int],
    surfaces: Sequence[BSplineSurface],
) -> Tool:
    """The tool that a [[tool]] table describes. `spacing` is the finest node spacing: a point stands for one node's cell;
    `thickness` the greatest of any material: below it a point is out of it."""
    where = f"tool {spec.name!r}"
    if spec.material is not None:
        raise InputError(
            "a deformable tool cannot be run yet", where=where, mend="leave its material out: it is rigid then"
        )
    if spec.control != "position":
        raise InputError(f"control = {spec.control!r} cannot be run yet", where=where, mend='use control = "position"')
    try:
        match spec.shape:
            case "point":
                return PointTool(spec.area or spacing**2, thickness)
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
            case "half_space":
                return ImplicitTool.half_space()
            case "surface":
                return SurfaceTool.of(list(surfaces), resolution)
    except InputError as error:
        raise InputError(error.what, where=where, mend=error.mend) from None
    raise InputError(
        f"shape {spec.shape!r} cannot be run yet",
        where=where,
        mend="use point, sphere, ellipsoid, capsule, cylinder, cone, box, torus, half_space or surface",
    )


def _size(spec: ToolSpec, key: str) -> float:
    value = getattr(spec, key)
    if value is None:
        raise InputError(f"a {spec.shape} needs {key}", mend=f"write {key} = ...")
    return float(value)


def _sizes(spec: ToolSpec, key: str) -> tuple[float, float, float]:
    value = getattr(spec, key)
    if value is None:
        raise InputError(f"a {spec.shape} needs {key}", mend=f"write {key} = [x, y, z]")
    return float(value[0]), float(value[1]), float(value[2])
