"""Implicit tools (paper 4.9.1) as exact signed distances, so that a sphere test prunes whole cells.

Every shape stands in its own frame: centred at the origin with its axis along z, except the cone (apex at the origin,
opening upwards) and the half-space (everything above z = 0): a tool that comes down along -z touches with its tip.
Distances are negative inside, exact and therefore 1-Lipschitz; n is the unit outward normal of the shape at the point
nearest to x, and that point is x - d n.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..collide.detect import FieldTool
from ..collide.shapes import (
    BOX,
    CAPSULE,
    CONE,
    CYLINDER,
    ELLIPSOID,
    HALF_SPACE,
    SPHERE,
    TORUS,
    PosedShape,
    shape_field,
)
from ..errors import InputError
from ..motion.pose import Pose

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ImplicitTool:
    """A rigid solid with an exact signed distance, in the scene's length unit.

    kind : one of the shape numbers of this module. parameters : its sizes, as the constructors below list them;
    `rounding` rounds the edges of a box or cylinder without changing its outer size. box_corners (2, 3) : lower and upper
    corner in the tool's frame; infinite for a half-space.
    """

    kind: int
    parameters: Array
    rounding: float = 0.0
    box_corners: Array = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "box_corners", self._corners())

    @classmethod
    def sphere(cls, radius: float) -> ImplicitTool:
        return cls._checked(SPHERE, [radius])

    @classmethod
    def ellipsoid(cls, radii: tuple[float, float, float]) -> ImplicitTool:
        return cls._checked(ELLIPSOID, list(radii))

    @classmethod
    def capsule(cls, radius: float, length: float) -> ImplicitTool:
        """`length` is the distance between the centres of the two half spheres."""
        return cls._checked(CAPSULE, [radius, length])

    @classmethod
    def cylinder(cls, radius: float, height: float, rounding: float = 0.0) -> ImplicitTool:
        return cls._checked(CYLINDER, [radius, height], rounding, min(radius, 0.5 * height))

    @classmethod
    def cone(cls, radius: float, height: float) -> ImplicitTool:
        """Apex at the origin, base of `radius` at z = `height`."""
        return cls._checked(CONE, [radius, height])

    @classmethod
    def box(cls, size: tuple[float, float, float], rounding: float = 0.0) -> ImplicitTool:
        return cls._checked(BOX, list(size), rounding, 0.5 * min(size))

    @classmethod
    def torus(cls, major_radius: float, minor_radius: float) -> ImplicitTool:
        return cls._checked(TORUS, [major_radius, minor_radius])

    @classmethod
    def half_space(cls) -> ImplicitTool:
        """Everything with z >= 0; its outward normal is -z."""
        return cls._checked(HALF_SPACE, [])

    @classmethod
    def _checked(cls, kind: int, sizes: list[float], rounding: float = 0.0, most: float = 0.0) -> ImplicitTool:
        parameters = np.array(sizes, dtype=np.float64)
        if not (np.isfinite(parameters).all() and (parameters > 0).all()):
            raise InputError(f"a tool of size {sizes}", mend="every size of a tool is a positive number")
        if not 0.0 <= rounding <= most:
            raise InputError(f"a rounding of {rounding:g}", mend=f"this shape takes 0 to {most:g}")
        return cls(kind, parameters, rounding)

    def _corners(self) -> Array:
        p = self.parameters
        if self.kind == HALF_SPACE:
            return np.array([[-np.inf, -np.inf, 0.0], [np.inf, np.inf, np.inf]])
        if self.kind == CONE:
            return np.array([[-p[0], -p[0], 0.0], [p[0], p[0], p[1]]])
        half = {
            SPHERE: lambda: [p[0]] * 3,
            ELLIPSOID: lambda: list(p),
            CAPSULE: lambda: [p[0], p[0], 0.5 * p[1] + p[0]],
            CYLINDER: lambda: [p[0], p[0], 0.5 * p[1]],
            BOX: lambda: list(0.5 * p),
            TORUS: lambda: [p[0] + p[1], p[0] + p[1], p[1]],
        }[self.kind]()
        return np.array([[-h for h in half], half])

    @property
    def convex(self) -> bool:
        """What lies beyond the tangent plane of one of its points is clear of it."""
        return self.kind != TORUS

    def field(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (n,) and unit outward normal (n, 3) at points (n, 3) in the tool's frame."""
        distance = np.empty(len(points))
        normal = np.empty((len(points), 3))
        shape_field(self.kind, self.parameters, self.rounding, np.ascontiguousarray(points), distance, normal)
        return distance, normal

    def placed(self, pose: Pose) -> FieldTool:
        """The tool in the world, as the collision pipeline takes it."""
        at, rotation = (np.ascontiguousarray(x, dtype=np.float64) for x in (pose.at, pose.rotation))
        shape = PosedShape(self.kind, self.parameters, self.rounding, self.box_corners, at, rotation)
        return FieldTool(PlacedField(self, pose), shape)


class Solid(Protocol):
    """What a tool with a signed distance offers in its own frame."""

    @property
    def box_corners(self) -> Array:
        """(2, 3): lower and upper corner of a box that holds it; may be infinite."""
        ...

    def field(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (n,) and unit outward normal (n, 3) at points (n, 3)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PlacedField:
    """A solid at a pose; implements `collide.detect.DistanceField`."""

    tool: Solid
    pose: Pose

    def distance(self, points: Array) -> Array:
        return self.tool.field(self.pose.to_tool(points))[0]

    def gradient(self, points: Array) -> Array:
        return self.pose.direction_to_world(self.tool.field(self.pose.to_tool(points))[1])

    def nearest(self, points: Array) -> Array:
        distance, normal = self.tool.field(self.pose.to_tool(points))
        return points - distance[:, None] * self.pose.direction_to_world(normal)

    def box(self) -> Array:
        corners = self.tool.box_corners
        if not np.isfinite(corners).all():
            return np.array([[-np.inf] * 3, [np.inf] * 3])
        return self.pose.box(corners)
