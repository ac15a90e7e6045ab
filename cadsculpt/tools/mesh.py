"""A rigid tool given by a watertight triangle mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..collide.detect import FieldTool
from ..collide.mesh.field import MeshField
from ..collide.mesh.triangle_mesh import TriangleMesh
from ..motion.pose import Pose

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MeshTool:
    """A rigid solid inside a closed mesh, in the tool's frame and the scene's unit; exact to rounding, without any
    parameter of resolution."""

    rest: MeshField

    @classmethod
    def of(cls, mesh: TriangleMesh) -> MeshTool:
        """Build the tree over a mesh. Raises GeometryError for one that bounds no solid, saying where it is open."""
        mesh.require_closed()
        return cls(MeshField.of(mesh))

    @property
    def mesh(self) -> TriangleMesh:
        return self.rest.mesh

    @property
    def convex(self) -> bool:
        """Not known to be: what lies beyond a tangent plane may still meet it."""
        return False

    @property
    def box_corners(self) -> Array:
        """(2, 3): lower and upper corner in the tool's frame."""
        return self.mesh.box

    def placed(self, pose: Pose) -> FieldTool:
        """The tool in the world, as the collision pipeline takes it."""
        return FieldTool(PlacedMesh(self.rest, pose))


@dataclass(frozen=True, slots=True, eq=False)
class PlacedMesh:
    """A mesh at a pose, open or closed; implements `collide.detect.DistanceField` (an open one's is unsigned)."""

    rest: MeshField
    pose: Pose

    @property
    def closed(self) -> bool:
        """Whether distances are signed."""
        return self.rest.closed

    @property
    def vertices(self) -> Array:
        """(n, 3) in the world."""
        return self.pose.to_world(self.rest.mesh.vertices)

    @property
    def triangles(self) -> NDArray[np.int64]:
        """(f, 3), counter-clockwise seen from outside."""
        return self.rest.mesh.triangles

    def distance(self, points: Array) -> Array:
        return self.rest.distance(self.pose.to_tool(points))

    def gradient(self, points: Array) -> Array:
        return self.pose.direction_to_world(self.rest.gradient(self.pose.to_tool(points)))

    def nearest(self, points: Array) -> Array:
        return self.pose.to_world(self.rest.nearest(self.pose.to_tool(points)))

    def box(self) -> Array:
        return self.pose.box(self.rest.mesh.box)

    def in_world(self) -> MeshField:
        """The mesh where it stands, with a tree of its own."""
        return self.rest.moved(self.pose.rotation, self.pose.at)
