"""The distance of a triangle mesh, built once: `collide.query.DistanceField` where the mesh stands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .build import build
from .tree import MeshTree, nearest_points, pseudo_normals
from .triangle_mesh import TriangleMesh

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MeshField:
    """The distance from a mesh: signed where it is closed, else never negative, in the mesh's own frame."""

    mesh: TriangleMesh
    tree: MeshTree

    @classmethod
    def of(cls, mesh: TriangleMesh) -> MeshField:
        """Build the tree over a mesh's triangles."""
        f = len(mesh.triangles)
        order, corner = np.empty(f, np.int64), np.empty((f, 3), np.int64)
        box, child, frame = np.empty((max(1, f - 1), 12)), np.empty((max(1, f - 1), 2), np.int64), np.empty((f, 16))
        nodes = build(mesh.vertices, mesh.triangles, order, box, child, frame, corner)
        first = np.argmax(mesh.triangles[order] == corner[:, :1], axis=1)
        low, high = mesh.box
        tree = MeshTree(
            box=box[:nodes].copy(),
            child=child[:nodes].copy(),
            frame=frame,
            corner=corner,
            edge=np.take_along_axis(mesh.edges[order], (first[:, None] + np.arange(3)) % 3, axis=1),
            name=order,
            vertices=np.ascontiguousarray(mesh.vertices),
            edge_normal=np.zeros((int(mesh.edges.max()) + 1, 3)),
            vertex_normal=np.zeros((len(mesh.vertices), 3)),
            centre=0.5 * (low + high),
            size=float(np.linalg.norm(high - low)),
            signed=mesh.closed,
        )
        pseudo_normals(tree)
        return cls(mesh, tree)

    @property
    def closed(self) -> bool:
        """Whether distances are signed."""
        return self.mesh.closed

    def query(self, points: ArrayLike) -> tuple[Array, Array, Array]:
        """Distance (n,), unit normal (n, 3) and nearest point (n, 3) for points (n, 3). NaN for points that are not
        finite."""
        points = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
        distance, normal, foot = np.empty(len(points)), np.empty(points.shape), np.empty(points.shape)
        nearest_points(self.tree, points, distance, normal, foot)
        return distance, normal, foot

    def distance(self, points: Array) -> Array:
        """Distance (n,), negative inside a closed mesh."""
        return self.query(points)[0]

    def gradient(self, points: Array) -> Array:
        """Unit normal (n, 3) at the nearest point; on an edge or a vertex, the direction from there."""
        return self.query(points)[1]

    def nearest(self, points: Array) -> Array:
        """The nearest points (n, 3) of the mesh."""
        return self.query(points)[2]

    def box(self) -> Array:
        """Low and high corner (2, 3)."""
        return self.mesh.box

    def in_world(self) -> MeshField:
        """Itself: its own frame is the world's."""
        return self

    def moved(self, rotation: Array, at: Array) -> MeshField:
        """The mesh turned and moved, x -> rotation @ x + at, with a tree of its own: for distances to other meshes."""
        vertices = np.ascontiguousarray(self.mesh.vertices @ rotation.T + at)
        return MeshField.of(replace(self.mesh, vertices=vertices))


@runtime_checkable
class StandingMesh(Protocol):
    """A field that is a mesh somewhere: its triangles can be had where they stand."""

    def in_world(self) -> MeshField:
        """The mesh in the world's frame."""
        ...
