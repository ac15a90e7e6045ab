"""A whole part as triangles, for STL, OBJ and PLY: the trimmed faces, without cracks where they share an edge.

The CAD kernel cuts every edge once, and both faces at it take its points: a closed solid becomes a watertight mesh. Faces that
come without topology are sewn first, where their edges run together.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from OCP.Bnd import Bnd_Box
from OCP.BRep import BRep_Tool
from OCP.BRepBndLib import BRepBndLib
from OCP.BRepBuilderAPI import BRepBuilderAPI_Sewing
from OCP.BRepGProp import BRepGProp
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.GProp import GProp_GProps
from OCP.Poly import Poly_Triangulation
from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
from OCP.TopExp import TopExp, TopExp_Explorer
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Face, TopoDS_Shape
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..errors import CadsculptError, InputError
from ..units import conversion
from .loose_edges import MEETING
from .mesh import write_triangles
from .occt.document import faces_in
from .occt.part import OcctPart
from .occt.quiet import quiet
from .occt.shape import shape_of_surface
from .part import Part
from .patch_part import PatchPart
from .rhino.part import RhinoPart

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FINENESS = 1e-3
"""Chord error as a fraction of the part's size, where none is given."""
ANGLE = 0.3
"""rad between neighbouring chords, so that small fillets keep their shape."""
AREA = 0.03
"""Of a face's area that its triangles may lack or have too much before it is said."""


def write_part(part: Part, path: Path, tolerance: float | None = None) -> None:
    """Write a part as triangles in the unit of its file; the suffix chooses the format.

    tolerance : mm between the faces and the triangles. Faces without triangles are named in the part's warnings. Raises
    InputError when there are none at all, or the file cannot be written.
    """
    points, triangles = mesh_of_part(part, tolerance)
    write_triangles(path, points * conversion("mm", part.units or "mm"), triangles)
    part.warnings.append(
        f"{path.suffix.lower()[1:].upper()} has no length unit: the numbers are in {part.units or 'mm'}"
    )


def mesh_of_part(part: Part, tolerance: float | None = None) -> tuple[Array, Index]:
    """Points (k, 3) in mm and triangles (f, 3), anticlockwise as seen from outside. Raises as `write_part` does."""
    with quiet():
        shapes = _shapes_of(part)
        if not shapes:
            raise InputError("the part has no faces that can be meshed", where=str(part.path))
        size = max(_size(shape) for shape in shapes)
        if not (0.0 < size < 1e50):
            raise InputError("the part has no finite size", where=str(part.path))
        mesher = _Mesher()
        for shape in shapes:
            BRepMesh_IncrementalMesh(shape, tolerance or FINENESS * size, False, ANGLE, False)
            mesher.add(shape)
    if mesher.without:
        part.warnings.append(f"{mesher.without} faces could not be meshed and are left out")
    if mesher.wrong:
        part.warnings.append(
            f"the triangles of {mesher.wrong} faces have another area than the faces, by more than {AREA:.0%}: look at them"
        )
    points, triangles, torn = mesher.joined()
    if torn:
        part.warnings.append(f"the mesh is torn at {torn} edges of triangles where the part is not")
    if not len(triangles):
        raise InputError("no face of the part could be meshed", where=str(part.path))
    return points, triangles


def _shapes_of(part: Part) -> list[TopoDS_Shape]:
    """The part's shapes in mm, faces joined where they share edges."""
    if isinstance(part, OcctPart):
        return list(part.shapes)
    if isinstance(part, RhinoPart):
        return [part.shape_of(body).shape for body in part.bodies]
    surfaces = part.surfaces if isinstance(part, PatchPart) else [face.surface for face in part.faces]
    sewing = BRepBuilderAPI_Sewing(MEETING * max((surface.size for surface in surfaces), default=1.0))
    for surface in surfaces:
        try:
            sewing.Add(shape_of_surface(surface))
        except CadsculptError as error:
            part.warnings.append(f"face {surface.name!r} is left out: {error.what}")
    sewing.Perform()
    return [sewing.SewedShape()]


def _size(shape: TopoDS_Shape) -> float:
    """Diagonal of the box around a shape's edges, mm; a face's own box may be that of a surface without end."""
    box = Bnd_Box()
    edges = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_EDGE)
    while edges.More():
        BRepBndLib.Add_s(edges.Current(), box, False)
        edges.Next()
    return 0.0 if box.IsVoid() else float(np.sqrt(box.SquareExtent()))


@dataclass(slots=True)
class _Known:
    """An edge or corner, the points that the first face has there, and how many faces' borders it is part of."""

    shape: TopoDS_Shape
    points: list[int]
    uses: int = 1


class _Mesher:
    """Triangles of face after face, and which of their points are one because an edge or a corner is."""

    def __init__(self) -> None:
        self.without = 0
        self.wrong = 0
        self._points: list[Array] = []
        self._triangles: list[Index] = []
        self._count = 0
        self._same: list[tuple[int, int]] = []
        self._on: dict[int, list[_Known]] = {}

    def add(self, shape: TopoDS_Shape) -> None:
        for face in faces_in(shape):
            place = TopLoc_Location()
            mesh = BRep_Tool.Triangulation_s(face, place)
            if mesh is None or mesh.NbTriangles() == 0:
                self.without += 1
                continue
            self._add_face(face, mesh, place)

    def joined(self) -> tuple[Array, Index, int]:
        """All points, each once; the triangles less those that ran along an edge; how many edges of triangles have one
        triangle alone though no border of the part runs there."""
        if not self._points:
            return np.zeros((0, 3)), np.zeros((0, 3), np.int64), 0
        pairs = np.array(self._same, dtype=np.int64).reshape(-1, 2)
        links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(self._count, self._count))
        _, group = connected_components(links, directed=False)
        roots = np.unique(group, return_index=True)[1][group]
        triangles = roots[np.concatenate(self._triangles)]
        a, b, c = triangles.T
        triangles = triangles[(a != b) & (b != c) & (c != a)]
        sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
        different, uses = np.unique(sides, axis=0, return_counts=True)
        alone = {(int(a), int(b)) for a, b in different[uses == 1]}
        for known in (known for kept in self._on.values() for known in kept):
            if known.uses == 1:
                ends = roots[known.points]
                alone -= {(int(min(a, b)), int(max(a, b))) for a, b in zip(ends[:-1], ends[1:], strict=True)}
        used, corners = np.unique(triangles, return_inverse=True)
        return np.concatenate(self._points)[used], corners.reshape(-1, 3).astype(np.int64), len(alone)

    def _add_face(self, face: TopoDS_Face, mesh: Poly_Triangulation, place: TopLoc_Location) -> None:
        move = place.Transformation()
        nodes = [mesh.Node(i).Transformed(move) for i in range(1, mesh.NbNodes() + 1)]
        corners = np.array([mesh.Triangle(i).Get() for i in range(1, mesh.NbTriangles() + 1)], dtype=np.int64) - 1
        if face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED:
            corners = corners[:, ::-1]
        first = self._count
        points = np.array([(p.X(), p.Y(), p.Z()) for p in nodes])
        a, b, c = (points[corner] for corner in corners.T)
        area, kernel = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()), GProp_GProps()
        BRepGProp.SurfaceProperties_s(face, kernel, 1e-3)
        self.wrong += abs(area - kernel.Mass()) > AREA * abs(kernel.Mass())
        self._points.append(points)
        self._triangles.append(corners + first)
        self._count += len(nodes)
        edges = TopExp_Explorer(face, TopAbs_ShapeEnum.TopAbs_EDGE)
        while edges.More():
            edge = TopoDS.Edge(edges.Current())
            line = BRep_Tool.PolygonOnTriangulation_s(edge, mesh, place)
            if line is not None:
                self._join(edge, [first + line.Node(i) - 1 for i in range(1, line.NbNodes() + 1)])
            edges.Next()

    def _join(self, edge: TopoDS_Edge, points: list[int]) -> None:
        """Points along an edge are those that another face, or the other side of a seam, has there; ends are corners."""
        if BRep_Tool.Degenerated_s(edge):
            self._same += [(points[0], other) for other in points[1:]]
        else:
            self._meet(edge, points)
        for vertex, point in ((TopExp.FirstVertex_s(edge), points[0]), (TopExp.LastVertex_s(edge), points[-1])):
            if not vertex.IsNull():
                self._meet(vertex, [point])

    def _meet(self, shape: TopoDS_Shape, points: list[int]) -> None:
        """Join the points with those that the edge or corner in this place has already, or keep them for the next."""
        kept = self._on.setdefault(hash(shape), [])
        for known in kept:
            if known.shape.IsSame(shape):
                known.uses += 1
                if len(known.points) == len(points):
                    self._same += zip(known.points, points, strict=True)
                return
        kept.append(_Known(shape, points))
