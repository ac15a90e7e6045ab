"""One Brep, surface or extrusion of a 3DM file where it stands in the model: its faces in mm, their trims and edges."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import CadsculptError, InputError
from ...spline.surface import BSplineSurface, Provenance, TrimCurve, TrimLoop
from ..occt.trim import reversed_trim
from ..part import FaceEdge
from .archive import BUFFER_VERSION
from .brep import BOUNDARY_ISO, OUTER_LOOP, SEAM, SINGULAR, Brep, Trim, read_brep
from .geometry import SurfaceForm, curve_of, encoded, moved, part_of_curve, surface_form, surface_of, trim_curve
from .joins import without_joins
from .nurbs import Nurbs

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a body comes from and stands.

    record : its place in the file's object table; kind : brep, surface or extrusion; name : of its faces;
    scale : mm per unit of the file; placement : (4, 4) of the block it stands in, in the file's unit, or None;
    block : the name of that block, "" outside blocks; face_names, periodic : what the object's user text says of its faces
    (`user_text`), empty where it says nothing.
    """

    record: int
    kind: str
    name: str
    file: str
    units: str
    scale: float
    placement: Array | None = None
    block: str = ""
    face_names: tuple[str, ...] = ()
    periodic: tuple[str, ...] = ()


@dataclass(eq=False)
class Body:
    """A Brep in mm. `thing` is rhino3dm's Brep; `first` the number of the body's first face in the part.

    `sculpted` holds the surfaces that have taken the place of those read, by face of this body.
    """

    place: Place
    thing: Any
    first: int
    sculpted: dict[int, BSplineSurface] = field(default_factory=dict)

    @cached_property
    def brep(self) -> Brep:
        chunk = encoded(self.thing)
        return read_brep(chunk, 0, len(chunk), BUFFER_VERSION)

    def __post_init__(self) -> None:
        self._forms: dict[int, SurfaceForm] = {}
        self._surfaces: dict[int, BSplineSurface] = {}
        self._trims: dict[int, TrimCurve] = {}

    # -------------------------------------------------------------- surfaces

    def face_name(self, face: int) -> str:
        if self.place.face_names:
            return self.place.face_names[face]
        return self.place.name if len(self.brep.faces) == 1 else f"{self.place.name} face {face + 1}"

    def form(self, face: int) -> SurfaceForm:
        """The NURBS form of a face's surface. Raises InputError when there is none."""
        index = self.brep.faces[face].surface
        if index not in self._forms:
            chunk = self.brep.surfaces[index] if 0 <= index < len(self.brep.surfaces) else None
            if chunk is None:
                raise InputError("a face without a surface", where=self.face_name(face), mend="repair it in Rhino")
            self._forms[index] = surface_form(chunk)
        return self._forms[index]

    def untrimmed(self, face: int) -> bool:
        """True when the face is its surface's whole domain: one loop along the domain's sides."""
        loops = [self.brep.loops[i] for i in self.brep.faces[face].loops]
        if len(loops) != 1 or not all(self.brep.trims[t].iso in BOUNDARY_ISO for t in loops[0].trims):
            return False
        for record in (self.brep.trims[t] for t in loops[0].trims):
            chunk = self.brep.curves2[record.curve2]
            if chunk is not None and without_joins(chunk, record.proxy, BUFFER_VERSION)[0] != chunk:
                return False
        return True

    def read_surface(self, face: int) -> BSplineSurface:
        """The surface of a face as it was read, mm."""
        if face not in self._surfaces:
            record = self.brep.faces[face]
            entity = f"object {self.place.record + 1}, face {face + 1}"
            surface = surface_of(
                self.form(face).nurbs,
                self.place.scale,
                self.place.placement,
                outward=bool(record.reversed) == self._mirrored,
                name=self.face_name(face),
                provenance=Provenance(self.place.file, entity, self.place.units),
                trims=None if self.untrimmed(face) else self._loops(face),
                periodic=self.place.periodic[face] if self.place.periodic else "",
            )
            self._surfaces[face] = surface
        return self._surfaces[face]

    @property
    def _mirrored(self) -> bool:
        """A placement that mirrors turns every normal around."""
        placement = self.place.placement
        return placement is not None and bool(np.linalg.det(placement[:3, :3]) < 0)

    def surface(self, face: int) -> BSplineSurface:
        """The surface of a face as it is now, mm."""
        return self.sculpted.get(face) or self.read_surface(face)

    def _loops(self, face: int) -> tuple[TrimLoop, ...]:
        loops = [self.brep.loops[i] for i in self.brep.faces[face].loops]
        return tuple(TrimLoop(tuple(self.trim(t) for t in loop.trims), loop.kind == OUTER_LOOP) for loop in loops)

    # ----------------------------------------------------------------- trims

    def face_of_trim(self, trim: Trim) -> int:
        return self.brep.loops[trim.loop].face

    def trim(self, index: int) -> TrimCurve:
        """A trim curve in the loop's direction, in the parameters of the face's surface."""
        if index not in self._trims:
            record = self.brep.trims[index]
            chunk = self.brep.curves2[record.curve2] if 0 <= record.curve2 < len(self.brep.curves2) else None
            if chunk is None:
                raise InputError("a trim without a curve", where=self.place.name, mend="repair it in Rhino")
            own = part_of_curve(*without_joins(chunk, record.proxy, BUFFER_VERSION))
            curve = trim_curve(own, self.form(self.face_of_trim(record)).parameters)
            self._trims[index] = reversed_trim(curve) if record.backward else curve
        return self._trims[index]

    def trims_of_face(self, face: int) -> list[Trim]:
        return [self.brep.trims[t] for i in self.brep.faces[face].loops for t in self.brep.loops[i].trims]

    def trim_toward_edge(self, index: int) -> TrimCurve:
        """A trim curve in the direction of its edge."""
        curve = self.trim(index)
        return reversed_trim(curve) if self.brep.trims[index].reversed else curve

    # ----------------------------------------------------------------- edges

    def edge_curve(self, index: int) -> Nurbs:
        """The 3D curve of an edge as it was read, mm, over the edge's domain."""
        curve = curve_of(self.thing.Edges[index])
        points = moved(curve.control_points(), self.place.placement) * self.place.scale
        weights = curve.weights()
        if weights is not None:
            points = np.concatenate([points * weights[:, None], weights[:, None]], axis=1)
        return Nurbs(3, curve.rational, curve.degrees, curve.knots, points)

    def vertex_point(self, index: int) -> Array:
        """A vertex as it was read, mm."""
        return moved(np.array(self.brep.vertices[index].point), self.place.placement) * self.place.scale

    def neighbours(self, trim: Trim) -> tuple[int, ...]:
        """Numbers in the part of the other faces that share a trim's edge."""
        if trim.edge < 0:
            return ()
        own = self.face_of_trim(trim)
        others = {self.face_of_trim(self.brep.trims[t]) for t in self.brep.edges[trim.edge].trims}
        return tuple(self.first + face for face in sorted(others - {own}))

    def face_edges(self, face: int) -> list[FaceEdge]:
        """The edges of a face as it is now, loop by loop, each side of a seam once."""
        from ..occt.boundary import sample_edge

        surface = self.surface(face)
        edges = []
        for record in self.trims_of_face(face):
            uv, points = sample_edge(surface, self.trim(record.index))
            seam, pole = record.kind == SEAM, record.kind == SINGULAR
            # an unset tolerance is a huge negative number
            tolerance = 0.0 if record.edge < 0 else max(self.brep.edges[record.edge].tolerance * self.place.scale, 0.0)
            edges.append(FaceEdge(uv, points, self.neighbours(record), seam, pole, tolerance))
        return edges

    def fault(self, face: int) -> str:
        """Why the surface of a face is not available, "" when it is."""
        try:
            self.read_surface(face)
        except CadsculptError as error:
            return error.what
        return ""
