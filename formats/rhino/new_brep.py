"""The arrays of an ON_Brep from faces of the CAD kernel: edges and vertices shared, surfaces and trim curves as they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from OCP.BRep import BRep_Tool
from OCP.Geom import Geom_TrimmedCurve
from OCP.GeomConvert import GeomConvert
from OCP.TopExp import TopExp
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Shape, TopoDS_Vertex

from ...errors import InputError
from ...spline.surface import BSplineSurface
from ..occt.boundary import BoundaryEdge
from ..occt.curve import curve_net
from ..occt.tolerance import FORWARD, REVERSED
from .archive import BUFFER_VERSION
from .brep import BOUNDARY, INNER_LOOP, MATED, OUTER_LOOP, SEAM, SINGULAR, Brep, BrepFace, Edge, Loop, Trim, Vertex
from .geometry import curve_points
from .joins import joined_chunk
from .new_trims import TOUCHING, DrawnTrim, drawn_loop, twin_sides
from .nurbs import Nurbs, nurbs_chunk

Array = NDArray[np.float64]


@dataclass(eq=False)
class BrepBuilder:
    """Collects the arrays of an ON_Brep. Edges and vertices of the kernel are found again by identity.

    form : how a surface is written; moved : how far the trim curves of a face are from those given, as a
    fraction of the range, by the face's name, where they are not the same.
    """

    form: Callable[[BSplineSurface], Nurbs]
    curves2: list[bytes] = field(default_factory=list)
    curves3: list[bytes] = field(default_factory=list)
    surfaces: list[bytes] = field(default_factory=list)
    trims: list[Trim] = field(default_factory=list)
    loops: list[Loop] = field(default_factory=list)
    faces: list[BrepFace] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    moved: dict[str, float] = field(default_factory=dict)
    _vertices: list[tuple[TopoDS_Vertex, float]] = field(default_factory=list)
    _edges: list[tuple[TopoDS_Edge, tuple[float, float], tuple[int, int], float]] = field(default_factory=list)
    _edge_ends: list[Array] = field(default_factory=list)
    _same: list[tuple[int, int]] = field(default_factory=list)
    _places: dict[int, list[int]] = field(default_factory=dict)

    def add(
        self, surface: BSplineSurface, loops: Sequence[Sequence[BoundaryEdge]], outer: int, *, exact: bool = True
    ) -> None:
        """Add a face. exact=False : its trim curves may be moved a little (`drawn_loop`)."""
        face = len(self.faces)
        self.surfaces.append(nurbs_chunk(self.form(surface), BUFFER_VERSION))
        self.points.append(surface.control_points.reshape(-1, 3))
        made = []
        for k, items in sorted(enumerate(loops), key=lambda pair: pair[0] != outer):
            loop = len(self.loops)
            drawn = drawn_loop(items, surface, only=len(loops) == 1, exact=exact)
            twins = twin_sides(items, drawn, surface)
            trims = tuple(
                self._trim(item, form, surface, loop, items[twins[n]] if n in twins else None, n in twins.values())
                for n, (item, form) in enumerate(zip(items, drawn, strict=True))
            )
            self.loops.append(Loop(loop, trims, OUTER_LOOP if k == outer else INNER_LOOP, face))
            made.append(loop)
        self.faces.append(BrepFace(face, tuple(made), face, int(not surface.outward), 0))

    def _trim(
        self,
        item: BoundaryEdge,
        drawn: DrawnTrim,
        surface: BSplineSurface,
        loop: int,
        twin: BoundaryEdge | None,
        has_twin: bool,
    ) -> int:
        """Add a trim. twin : the one on the other side of the seam, whose edge it takes; has_twin : it is such a one."""
        index = len(self.trims)
        chunk, domain = joined_chunk(drawn.curve, drawn.before, drawn.after, BUFFER_VERSION, explicit=drawn.explicit)
        self.curves2.append(chunk)
        if drawn.moved:
            self.moved[surface.name] = max(drawn.moved, self.moved.get(surface.name, 0.0))
        backward = item.edge.Orientation() == REVERSED if twin is None else twin.edge.Orientation() != REVERSED
        if item.degenerate:
            corner = self._vertex(TopExp.FirstVertex_s(item.edge, True))
            edge, ends, kind = -1, (corner, corner), SINGULAR
        else:
            edge = self._edge(item.edge if twin is None else twin.edge)
            start, end = self._edges[edge][2]
            ends = (end, start) if backward else (start, end)
            if twin is not None:
                own = TopExp.FirstVertex_s(item.edge, True), TopExp.LastVertex_s(item.edge, True)
                self._same += zip(map(self._vertex, own), ends, strict=True)
            uv = drawn.ends
            self._reach(edge, surface.evaluate(uv[:, 0], uv[:, 1]), backward)
            kind = SEAM if item.seam or twin is not None or has_twin else BOUNDARY
        rest = np.array(domain).tobytes() + bytes(48)
        turned = int(backward and not item.degenerate)
        self.trims.append(Trim(index, index, domain, edge, ends, turned, kind, drawn.iso, loop, (0.0, 0.0), rest))
        return index

    def _edge(self, edge: TopoDS_Edge) -> int:
        for place in self._places.get(hash(edge), ()):
            if self._edges[place][0].IsSame(edge):
                return place
        first, last = BRep_Tool.Range_s(edge)
        curve = BRep_Tool.Curve_s(TopoDS.Edge(edge.Oriented(FORWARD)), 0.0, 0.0)
        if curve is None:
            raise InputError("an edge without a curve")
        spline = GeomConvert.CurveToBSplineCurve_s(Geom_TrimmedCurve(curve, first, last))
        if spline.IsPeriodic():
            spline.SetNotPeriodic()
        points, knots = curve_net(spline)
        if spline.IsRational():
            weights = np.array([spline.Weight(i) for i in range(1, spline.NbPoles() + 1)])
            points = np.concatenate([points * weights[:, None], weights[:, None]], axis=1)
        nurbs = Nurbs(3, spline.IsRational(), (spline.Degree(),), (knots[1:-1],), points)
        self.curves3.append(nurbs_chunk(nurbs, BUFFER_VERSION))
        forward = TopoDS.Edge(edge.Oriented(FORWARD))
        ends = self._vertex(TopExp.FirstVertex_s(forward)), self._vertex(TopExp.LastVertex_s(forward))
        domain = float(nurbs.knots[0][0]), float(nurbs.knots[0][-1])
        self._places.setdefault(hash(edge), []).append(len(self._edges))
        self._edge_ends.append(curve_points(nurbs, np.array(domain)))
        self._edges.append((edge, domain, ends, float(BRep_Tool.Tolerance_s(edge))))
        return len(self._edges) - 1

    def _reach(self, edge: int, ends: Array, backward: bool) -> None:
        """Raise an edge's tolerance to the distance of a trim's ends (2, 3) from its own."""
        known, domain, vertices, tolerance = self._edges[edge]
        spots = ends[::-1] if backward else ends
        gap = float(np.linalg.norm(spots - self._edge_ends[edge], axis=1).max())
        self._edges[edge] = known, domain, vertices, max(tolerance, 1.01 * gap)

    def _vertex(self, vertex: TopoDS_Shape) -> int:
        for place, (known, _) in enumerate(self._vertices):
            if known.IsSame(vertex):
                return place
        corner = TopoDS.Vertex(vertex)
        self._vertices.append((corner, float(BRep_Tool.Tolerance_s(corner))))
        return len(self._vertices) - 1

    def _merge_vertices(self) -> None:
        """Make one vertex of those at the ends of a closed edge, and on both sides of a seam, as openNURBS wants it."""
        one = list(range(len(self._vertices)))
        closed = [
            vertices
            for (_, _, vertices, _), spots in zip(self._edges, self._edge_ends, strict=True)
            if np.abs(spots[0] - spots[1]).max() <= TOUCHING[0]
        ]
        for pair in [*closed, *self._same]:
            low, high = sorted(one[vertex] for vertex in pair)
            one = [low if place == high else place for place in one]
        kept = sorted(set(one))
        place = {old: kept.index(one[old]) for old in range(len(one))}
        self._vertices = [self._vertices[old] for old in kept]
        self._edges = [(e, domain, (place[a], place[b]), tolerance) for e, domain, (a, b), tolerance in self._edges]
        self.trims = [replace(t, vertices=(place[t.vertices[0]], place[t.vertices[1]])) for t in self.trims]

    def brep(self) -> Brep:
        """The Brep of the faces that were added."""
        self._merge_vertices()
        on_edge: list[list[int]] = [[] for _ in self._edges]
        for trim in self.trims:
            if trim.edge >= 0:
                on_edge[trim.edge].append(trim.index)
        edges = [
            Edge(i, i, 0, domain, ends, tuple(on_edge[i]), tolerance, domain)
            for i, (_, domain, ends, tolerance) in enumerate(self._edges)
        ]
        at_vertex: list[list[int]] = [[] for _ in self._vertices]
        for edge in edges:
            for end in edge.vertices:
                at_vertex[end].append(edge.index)
        vertices = []
        for i, (corner, tolerance) in enumerate(self._vertices):
            p = BRep_Tool.Pnt_s(corner)
            vertices.append(Vertex(i, (p.X(), p.Y(), p.Z()), tuple(at_vertex[i]), tolerance))
        trims = [
            replace(trim, kind=MATED) if trim.kind == BOUNDARY and len(on_edge[trim.edge]) > 1 else trim
            for trim in self.trims
        ]
        cloud = np.concatenate(self.points)
        count = len(self.faces)
        return Brep(
            version=BUFFER_VERSION,
            minor=2,
            curves2=tuple(self.curves2),
            curves3=tuple(self.curves3),
            surfaces=tuple(self.surfaces),
            vertices=tuple(vertices),
            edges=tuple(edges),
            trims=tuple(trims),
            loops=tuple(self.loops),
            faces=tuple(self.faces),
            faces_minor=0,
            faces_rest=b"",
            box=(*cloud.min(axis=0).tolist(), *cloud.max(axis=0).tolist()),
            render_meshes=(None,) * count,
            analysis_meshes=(None,) * count,
            solid=bytes(4),
            region=b"",
        )
