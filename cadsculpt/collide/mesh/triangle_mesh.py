"""A triangle mesh as a body: what it encloses, and what is wrong with it.

A mesh file is a heap of triangles. Vertices are joined where their coordinates are equal to the last bit, and nowhere
else: an STL stores every corner anew, and a tolerance would close what is open, or close up what is thin, without a word.
What can be mended without moving the surface is mended, and said; what cannot is said where a solid is needed. Whether a
mesh passes through itself is not looked at: where it does, inside and outside are those of the nearest triangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import GeometryError
from . import topology
from .tree import FARTHEST

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SMALLEST = 1e-70
"""A mesh no larger than this is refused: the squares of its areas could not be told from zero."""

HOLLOW = 1e-12
"""A volume below this fraction of area times size is none: two sheets back to back."""


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """Joined, consistently turned triangles.

    vertices (n, 3), all of them used. triangles (f, 3) : counter-clockwise seen from outside, none without area. edges
    (f, 3) : the edge from corner k to k + 1, numbered from 0. open_edges, branched_edges (k, 2) : vertices of the edges
    that one triangle alone has, and that more than two have. shells : number of connected pieces. closed : whether it
    bounds a solid. area [L^2]. volume [L^3] : of the solid; NaN where it is not closed. warnings : what was mended.
    """

    vertices: Array
    triangles: Index
    edges: Index
    open_edges: Index
    branched_edges: Index
    shells: int
    closed: bool
    area: float
    volume: float
    scale: float
    warnings: tuple[str, ...]

    @classmethod
    def of(cls, vertices: ArrayLike, triangles: ArrayLike, *, scale: float = 1.0) -> TriangleMesh:
        """Take a mesh of vertices (n, 3) and triangles (f, 3), in a file's numbers, times `scale`.

        Messages give coordinates as they were before. Raises GeometryError for an empty mesh, for coordinates and
        vertex numbers that are none, for a surface with one side only, and for triangles without area that cannot be
        mended.
        """
        points, faces = _arrays(vertices, triangles)
        points, faces = topology.joined(points, faces)
        warnings: list[str] = []
        faces = topology.without_repeats(faces, warnings)
        points, faces = topology.used(points * scale, faces)
        _check_size(points, scale)
        links = topology.links_of(faces)
        turned = topology.consistently_turned(points, faces, links, scale, warnings)
        mended = topology.mend_caps(points, turned, scale, warnings)
        if mended is not faces:
            whole = bool((links.uses > 1).all())
            points, faces = topology.used(points, mended)
            links = topology.links_of(faces)
            if whole and (links.uses == 1).any():
                edge = topology.place(points, links.ends[links.uses == 1][0], scale)
                raise GeometryError(
                    f"triangles without area that cannot be mended, near {edge}", mend=topology.WITHOUT_THEM
                )
        shell = topology.shells_of(faces, links)
        sound = links.balanced & (np.bincount(links.edges.ravel()) > 1)
        closed = np.ones(int(shell.max()) + 1, np.bool_)
        closed[shell[~sound[links.edges].all(axis=1)]] = False
        outward, volumes = topology.turned_outwards(points, faces, shell, closed, warnings)
        if outward is not faces:
            faces = outward
            links = topology.links_of(faces)
        area = float(topology.areas(points, faces).sum())
        low, high = points.min(axis=0), points.max(axis=0)
        solid = bool(closed.all()) and float(volumes.sum()) > HOLLOW * area * float(np.linalg.norm(high - low))
        branched = links.ends[links.uses > 2]
        if solid and len(branched):
            warnings.append(
                f"{_counted(len(branched), 'edge has', 'edges have')} more than two triangles "
                f"({topology.place(points, branched[0], scale)}): the solid touches itself there"
            )
        return cls(
            vertices=points,
            triangles=faces,
            edges=links.edges,
            open_edges=links.ends[links.uses == 1],
            branched_edges=branched,
            shells=len(closed),
            closed=solid,
            area=area,
            volume=float(volumes.sum()) if solid else float("nan"),
            scale=scale,
            warnings=tuple(warnings),
        )

    @property
    def box(self) -> Array:
        """(2, 3): low and high corner."""
        return np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def fault(self) -> str:
        """Why it bounds no solid, in the user's words; "" when it does."""
        if self.closed:
            return ""
        if len(self.open_edges):
            many = _counted(len(self.open_edges), "open edge", "open edges")
            first = topology.place(self.vertices, self.open_edges[0], self.scale)
            return f"the mesh is not watertight: it has {many}, the first {first}"
        if len(self.branched_edges):
            many = _counted(len(self.branched_edges), "edge", "edges")
            first = topology.place(self.vertices, self.branched_edges[0], self.scale)
            return f"more than two triangles meet at {many}, the first {first}"
        return "the mesh encloses no volume"

    def require_closed(self) -> None:
        """Raises GeometryError where the mesh bounds no solid, with what is wrong and where."""
        if not self.closed:
            raise GeometryError(
                self.fault,
                mend="close it in the program that made it; vertices are joined only where their coordinates are equal",
            )


def _arrays(vertices: ArrayLike, triangles: ArrayLike) -> tuple[Array, Index]:
    points = np.array(vertices, dtype=np.float64)
    faces = np.array(triangles, dtype=np.int64)
    if not faces.size:
        raise GeometryError("the mesh has no triangles", mend="export the mesh again")
    if points.ndim != 2 or points.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise GeometryError(f"a mesh of arrays {points.shape} and {faces.shape}", mend="give (n, 3) and (f, 3)")
    if faces.min() < 0 or faces.max() >= len(points):
        raise GeometryError("a triangle names a vertex that is not there", mend="export the mesh again")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise GeometryError(
            f"{_counted(len(bad), 'vertex is', 'vertices are')} not finite, the first is number {bad[0]}",
            mend="export the mesh again",
        )
    return points, faces


def _check_size(points: Array, scale: float) -> None:
    if not np.abs(points).max() < FARTHEST:
        raise GeometryError(f"a vertex is farther away than {FARTHEST / scale:g}", mend="export the mesh again")
    if not np.ptp(points, axis=0).max() > SMALLEST:
        raise GeometryError("the mesh has no size", mend="export the mesh again")


def _counted(count: int, one: str, many: str) -> str:
    return f"{count} {one if count == 1 else many}"
