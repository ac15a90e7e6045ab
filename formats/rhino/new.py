"""Any part as a new 3DM file: faces that meet become Breps with shared edges, lone untrimmed ones surfaces."""

from __future__ import annotations

import base64
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from OCP.BRep import BRep_Tool
from OCP.Geom import Geom_TrimmedCurve
from OCP.GeomConvert import GeomConvert
from OCP.TopExp import TopExp
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Shape, TopoDS_Vertex

from ...errors import CadsculptError, InputError
from ...spline.surface import BSplineSurface, TrimCurve
from ..occt.boundary import BoundaryEdge
from ..occt.curve import curve_net
from ..occt.part import OcctPart
from ..occt.quiet import quiet
from ..occt.tolerance import FORWARD, REVERSED
from ..occt.trim import trim_domain
from ..part import Face, Part
from .archive import BUFFER_VERSION, HEADER_SIZE, Writer, chunks, length_size
from .brep import OUTER_LOOP, SEAM, SINGULAR, Brep, BrepFace, Edge, Loop, Trim, Vertex, brep_chunk
from .geometry import clamped_surface, curve_points, decoded, library, nurbs_of_trim
from .nurbs import Nurbs, nurbs_chunk

Array = NDArray[np.float64]

BOUNDARY, MATED = 1, 2
"""ON_BrepTrim::TYPE of a trim on an edge of one face, and of several."""
INNER_LOOP = 2

ON_LINE = 8.0 * 2.0**-26
"""A trim curve within this fraction of the range of a parameter line is that line (openNURBS' own bound)."""

MEETING = 0.01
"""Ends of trim curves further apart than this fraction of the range do not make a loop."""

ARCHIVE = 8
"""The 3DM version of new files."""

PROPERTIES_TABLE = 0x10000014
REVISION_HISTORY = 0x20008021


def new_file(part: Part) -> bytes:
    """The bytes of a 3DM file, in mm, with all faces of a part; the same part gives the same bytes.

    Faces that openNURBS does not take as a trimmed Brep are written untrimmed, and the part's warnings say which.
    Raises InputError when the part has no faces.
    """
    rhino3dm = library()
    model = rhino3dm.File3dm()
    model.Settings.ModelUnitSystem = rhino3dm.UnitSystem.Millimeters
    root = uuid.uuid5(uuid.NAMESPACE_OID, "cadsculpt")
    layer = rhino3dm.Layer()
    layer.Name = "Default"
    layer.Id = uuid.uuid5(root, "layer")  # one that openNURBS makes up has another identity in every run
    model.Layers.Add(layer)
    count = 0
    for name, thing in _things(part):
        attributes = rhino3dm.ObjectAttributes()
        attributes.Name = name
        attributes.LayerIndex = 0
        if isinstance(thing, rhino3dm.Brep):
            model.Objects.AddBrep(thing, attributes)
        else:
            model.Objects.AddSurface(thing, attributes)
        count += 1
    if not count:
        raise InputError("there is nothing to write", where=str(part.path), mend="the part has no faces")
    for i, entry in enumerate(model.Objects):
        entry.Attributes.Id = uuid.uuid5(root, f"object {i}")
    options = rhino3dm.File3dmWriteOptions()
    options.Version = ARCHIVE
    return _without_dates(base64.b64decode(model.Encode(options)))


def _without_dates(data: bytes) -> bytes:
    """The file without its revision history, which is a clock time."""
    version = int(data[24:HEADER_SIZE])
    out = bytearray(data[:HEADER_SIZE])
    for table in chunks(data, HEADER_SIZE, len(data), version):
        if table.typecode == PROPERTIES_TABLE:
            writer = Writer(version)
            writer.begin(PROPERTIES_TABLE)
            for entry in chunks(data, table.body, table.end, version):
                if entry.typecode != REVISION_HISTORY:
                    writer.whole(data[entry.start : entry.end])
            writer.end()
            out += writer.finished()
        else:
            out += data[table.start : table.end]
    size = length_size(version)
    out[-size:] = len(out).to_bytes(size, "little")
    return bytes(out)


def _things(part: Part) -> Iterator[tuple[str, Any]]:
    """(name, rhino3dm Brep or surface) for every object of the new file."""
    with quiet():
        kernel = part if isinstance(part, OcctPart) else _in_kernel(part)
    untrimmed: list[str] = []
    for group in _groups(kernel):
        surfaces: list[tuple[int, BSplineSurface]] = []
        for number in group:
            try:
                surfaces.append((number, kernel.faces.number(number).surface))
            except CadsculptError as error:
                part.warnings.append(f"face {kernel.faces.number(number).name} is not in the 3DM file: {error.what}")
        whole = _valid_brep(kernel, surfaces) if len(surfaces) > 1 else None
        if whole is not None:
            yield f"{surfaces[0][1].name} and {len(surfaces) - 1} more", whole
            continue
        for item in surfaces:
            surface = item[1]
            # a surface that stands alone has no other side than its own
            brep = None if surface.trims is None and surface.outward else _valid_brep(kernel, [item])
            if brep is not None:
                yield surface.name, brep
                continue
            alone = _valid_surface(surface)
            if alone is None:
                part.warnings.append(f"face {surface.name} is not in the 3DM file: openNURBS refuses its surface")
                continue
            if surface.trims is not None:
                untrimmed.append(surface.name)
            yield surface.name, alone
    if untrimmed:
        names = ", ".join(untrimmed[:5]) + (", ..." if len(untrimmed) > 5 else "")
        part.warnings.append(f"in the 3DM file without their trims ({len(untrimmed)}): {names}")


def _valid_surface(surface: BSplineSurface) -> Any:
    """rhino3dm's surface, its ends clamped where openNURBS insists; None when it refuses both."""
    nurbs = _nurbs(surface)
    for form in (nurbs, clamped_surface(nurbs)):
        thing = decoded(nurbs_chunk(form, BUFFER_VERSION))
        if thing is not None and thing.IsValid:
            return thing
    return None


def _in_kernel(part: Part) -> OcctPart:
    """The faces of any part in the CAD kernel, each by itself."""
    from ..occt.part import document_of_shapes
    from ..occt.shape import shape_of_surface

    faces: list[Face] = [face for face in part.faces if not face.warning]
    return document_of_shapes([(face.name, shape_of_surface(face.surface)) for face in faces], path=part.path)


def _groups(part: OcctPart) -> list[list[int]]:
    """Face numbers, those that hang together by edges in one list."""
    root = {face.number: face.number for face in part.faces}

    def find(number: int) -> int:
        while root[number] != number:
            root[number] = number = root[root[number]]
        return number

    for face in part.faces:
        try:
            loops = part.face(face.number).boundary.loops
        except CadsculptError:
            continue
        for item in (item for loop in loops for item in loop):
            for other in part.faces_on(item.edge):
                a, b = find(face.number), find(other)
                root[max(a, b)] = min(a, b)
    groups: dict[int, list[int]] = {}
    for number in root:
        groups.setdefault(find(number), []).append(number)
    return list(groups.values())


# ------------------------------------------------------------------------- Brep


def _valid_brep(part: OcctPart, surfaces: Sequence[tuple[int, BSplineSurface]]) -> Any:
    """rhino3dm's Brep of these faces, with closed ends clamped where openNURBS insists; None when it refuses it."""
    with quiet():
        for form in (_nurbs, lambda surface: clamped_surface(_nurbs(surface))):
            builder = _Builder(form)
            try:
                for number, surface in surfaces:
                    boundary = part.face(number).boundary
                    if boundary.lost or not boundary.loops:
                        return None
                    builder.add(surface, boundary.loops, boundary.outer)
            except CadsculptError:
                return None
            thing = decoded(brep_chunk(builder.brep()))
            if thing is not None and thing.IsValid:
                return thing
    return None


def _nurbs(surface: BSplineSurface) -> Nurbs:
    points = surface.control_points
    if surface.weights is not None:
        points = np.concatenate([points * surface.weights[..., None], surface.weights[..., None]], axis=2)
    degrees = surface.degree_u, surface.degree_v
    return Nurbs(3, surface.rational, degrees, (surface.knots_u[1:-1], surface.knots_v[1:-1]), points)


@dataclass(eq=False)
class _Builder:
    """Collects the arrays of an ON_Brep. Edges and vertices of the kernel are found again by identity.

    form : how a surface is written.
    """

    form: Callable[[BSplineSurface], Nurbs]
    curves2: list[bytes] = field(default_factory=list)
    curves3: list[bytes] = field(default_factory=list)
    surfaces: list[bytes] = field(default_factory=list)
    trims: list[Trim] = field(default_factory=list)
    loops: list[Loop] = field(default_factory=list)
    faces: list[BrepFace] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    _vertices: list[tuple[TopoDS_Vertex, float]] = field(default_factory=list)
    _edges: list[tuple[TopoDS_Edge, tuple[float, float], tuple[int, int], float]] = field(default_factory=list)
    _edge_ends: list[Array] = field(default_factory=list)
    _places: dict[int, list[int]] = field(default_factory=dict)

    def add(self, surface: BSplineSurface, loops: Sequence[Sequence[BoundaryEdge]], outer: int) -> None:
        face = len(self.faces)
        self.surfaces.append(nurbs_chunk(self.form(surface), BUFFER_VERSION))
        self.points.append(surface.control_points.reshape(-1, 3))
        made = []
        for k, items in sorted(enumerate(loops), key=lambda pair: pair[0] != outer):
            loop = len(self.loops)
            curves = _meeting([item.curve for item in items], surface)
            trims = tuple(self._trim(item, curve, surface, loop) for item, curve in zip(items, curves, strict=True))
            self.loops.append(Loop(loop, trims, OUTER_LOOP if k == outer else INNER_LOOP, face))
            made.append(loop)
        self.faces.append(BrepFace(face, tuple(made), face, int(not surface.outward), 0))

    def _trim(self, item: BoundaryEdge, curve: TrimCurve, surface: BSplineSurface, loop: int) -> int:
        index = len(self.trims)
        self.curves2.append(nurbs_chunk(nurbs_of_trim(curve), BUFFER_VERSION))
        backward = item.edge.Orientation() == REVERSED
        if item.degenerate:
            corner = self._vertex(TopExp.FirstVertex_s(item.edge, True))
            edge, ends, kind = -1, (corner, corner), SINGULAR
        else:
            edge = self._edge(item.edge)
            start, end = self._edges[edge][2]
            ends = (end, start) if backward else (start, end)
            uv = curve.control_points[[0, -1]]
            self._reach(edge, surface.evaluate(uv[:, 0], uv[:, 1]), backward)
            kind = SEAM if item.seam else BOUNDARY
        domain = trim_domain(curve)
        rest = np.array(domain).tobytes() + bytes(48)
        turned = int(backward and not item.degenerate)
        iso = _iso(curve, surface)
        self.trims.append(Trim(index, index, domain, edge, ends, turned, kind, iso, loop, (0.0, 0.0), rest))
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

    def brep(self) -> Brep:
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


def _meeting(curves: Sequence[TrimCurve], surface: BSplineSurface) -> list[TrimCurve]:
    """The curves of a loop, those along parameter lines made straight, with their ends moved together.

    openNURBS wants ends to meet within 1e-10. A corner takes the coordinate of a curve that runs along a parameter
    line, else the middle. Raises InputError when ends lie further apart than MEETING of the range.
    """
    straight = [_straight(curve, surface) for curve in curves]
    points = [np.array(curve.control_points) for curve in straight]
    size = np.array([high - low for low, high in surface.domain])
    held = [np.ptp(p, axis=0) == 0.0 for p in points]
    for k in range(len(points)):
        arriving, leaving = points[k - 1], points[k]
        a, b = arriving[-1].copy(), leaving[0].copy()
        if (np.abs(a - b) > MEETING * size).any():
            raise InputError("a trim loop does not close")
        corner = np.where(held[k - 1] & ~held[k], a, np.where(held[k] & ~held[k - 1], b, 0.5 * (a + b)))
        arriving[-1] = leaving[0] = corner
    return [replace(curve, control_points=p) for curve, p in zip(straight, points, strict=True)]


def _straight(curve: TrimCurve, surface: BSplineSurface) -> TrimCurve:
    """The curve, or the straight line between its ends where it runs along a parameter line."""
    points = curve.control_points
    width = np.ptp(points, axis=0)
    for axis, (low, high) in enumerate(surface.domain):
        near = ON_LINE * (high - low)
        if width[axis] <= 2 * near < width[1 - axis]:
            ends = points[[0, -1]]
            ends[:, axis] = next((side for side in (low, high) if abs(ends[0, axis] - side) <= near), ends[0, axis])
            first, last = trim_domain(curve)
            return TrimCurve(ends, np.array([first, first, last, last]), 1)
    return curve


def _iso(curve: TrimCurve, surface: BSplineSurface) -> int:
    """ON_Surface::ISO of a trim curve of `_meeting`.

    1 and 2 along a parameter line (u or v held), 3 to 6 on the west, south, east and north side of the domain, else 0.
    """
    if len(curve.control_points) > 2:
        return 0
    width = np.ptp(curve.control_points, axis=0)
    for axis, (low, high) in enumerate(surface.domain):
        near = ON_LINE * (high - low)
        if not width[axis] <= 2 * near < width[1 - axis]:
            continue
        x = curve.control_points[0, axis]
        if abs(x - low) <= near:
            return (3, 4)[axis]
        return (5, 6)[axis] if abs(x - high) <= near else axis + 1
    return 0
