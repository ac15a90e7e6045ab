"""A Brep of a 3DM file as an OCCT shell or solid with shared edges, for STEP, IGES and the kernel's checker."""

from __future__ import annotations

from dataclasses import dataclass

from OCP.BRep import BRep_Builder
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Shape, TopoDS_Shell, TopoDS_Solid, TopoDS_Vertex

from ...errors import CadsculptError
from ...spline.surface import TrimCurve
from ..occt.shape import WireEdge, edge, face_with_wires, spline_curve, vertex
from ..occt.tolerance import CONFUSION, unify_parameters
from ..occt.trim import trim_domain
from .body import Body
from .brep import SINGULAR, Trim
from .follow import Followed, stretched


@dataclass(frozen=True, slots=True, eq=False)
class BodyShape:
    """shape : a solid when the body is closed, else a shell; faces : by their place in the body.

    lost : why the faces that are not in it are not.
    """

    shape: TopoDS_Shape
    faces: dict[int, TopoDS_Face]
    lost: dict[int, str]


def shape_of_body(body: Body, followed: Followed) -> BodyShape:
    """The body as it is now.

    Every edge and vertex is made once and shared. Surfaces, knots and control points pass through unchanged; only trim
    curves that run at another pace than their edge are given the edge's pace (within OCCT's confusion, 1e-7 mm).
    """
    brep = body.brep
    vertices: dict[int, TopoDS_Vertex] = {}
    edges: dict[int, tuple[TopoDS_Edge, tuple[float, float]]] = {}

    def corner(index: int) -> TopoDS_Vertex:
        if index not in vertices:
            point = followed.points[index] if index in followed.points else body.vertex_point(index)
            vertices[index] = vertex(point, CONFUSION)
        return vertices[index]

    def made_edge(index: int) -> tuple[TopoDS_Edge, tuple[float, float]]:
        if index not in edges:
            curve = followed.edges[index] if index in followed.edges else body.edge_curve(index)
            knots = curve.padded_knots(0)
            weights = curve.weights()
            geom = spline_curve(curve.control_points(), knots, curve.degrees[0], weights)
            domain = float(knots[0]), float(knots[-1])
            start, end = (corner(v) for v in brep.edges[index].vertices)
            edges[index] = edge(geom, *domain, start, end, CONFUSION), domain
        return edges[index]

    def piece(record: Trim) -> WireEdge:
        curve = body.trim(record.index)
        if record.edge < 0 or record.kind == SINGULAR:
            ends = (corner(v) for v in record.vertices)
            return WireEdge(edge(None, *trim_domain(curve), *ends), curve)
        made, domain = made_edge(record.edge)
        own = _paced(body.trim_toward_edge(record.index), domain)
        twin = _twin(body, record)
        if twin is None:
            return WireEdge(made, own, bool(record.reversed))
        other = _paced(body.trim_toward_edge(twin.index), domain)
        return WireEdge(made, *((other, True, own) if record.reversed else (own, False, other)))

    def pieces(record: Trim) -> list[WireEdge]:
        """The edge of a trim among the poles that it absorbed."""
        curves, own = body.trim_curves(record.index)
        found = []
        for place, curve in enumerate(curves):
            corners = (corner(record.vertices[int(place > own)]) for _ in range(2))
            found.append(piece(record) if place == own else WireEdge(edge(None, *trim_domain(curve), *corners), curve))
        return found

    faces: dict[int, TopoDS_Face] = {}
    lost: dict[int, str] = {}
    builder, shell = BRep_Builder(), TopoDS_Shell()
    builder.MakeShell(shell)
    for index, face in enumerate(brep.faces):
        try:
            surface = body.surface(index)
            wires = [[item for t in brep.loops[i].trims for item in pieces(brep.trims[t])] for i in face.loops]
            faces[index] = face_with_wires(surface, wires)
        except CadsculptError as error:
            lost[index] = error.what
            continue
        except Exception as error:  # the kernel's own errors have no common base
            lost[index] = f"the CAD kernel refuses the face: {error}"
            continue
        builder.Add(shell, faces[index])
    unify_parameters(shell)
    closed = bool(edges) and all(len(brep.edges[i].trims) == 2 for i in edges) and len(faces) == len(brep.faces)
    if not closed:
        return BodyShape(shell, faces, lost)
    shell.Closed(True)
    solid = TopoDS_Solid()
    builder.MakeSolid(solid)
    builder.Add(solid, shell)
    return BodyShape(solid, faces, lost)


def _twin(body: Body, record: Trim) -> Trim | None:
    """The trim on the other side of a seam: the same edge, the same face, run the other way."""
    for index in body.brep.edges[record.edge].trims:
        other = body.brep.trims[index]
        same_face = other.loop == record.loop or body.face_of_trim(other) == body.face_of_trim(record)
        if index != record.index and same_face:
            return other
    return None


def _paced(curve: TrimCurve, domain: tuple[float, float]) -> TrimCurve:
    """A trim curve run over the edge's parameter range."""
    return TrimCurve(curve.control_points, stretched(curve.knots, *domain), curve.degree, curve.weights)
