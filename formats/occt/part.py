"""A part held by the CAD kernel: what a STEP or IGES file becomes, and what is written as one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from OCP.Bnd import Bnd_Box
from OCP.BRep import BRep_Builder
from OCP.BRepBndLib import BRepBndLib
from OCP.collections import IndexedDataMap_TopoDS_Shape_List_TopoDS_Shape_TopTools_ShapeMapHasher
from OCP.TDocStd import TDocStd_Document
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp
from OCP.TopoDS import TopoDS_Compound, TopoDS_Edge, TopoDS_Face, TopoDS_Shape

from ...errors import InputError
from ...spline.surface import BSplineSurface, Provenance
from ...units import unit_name
from ..part import FaceEdge, Faces, Instance, Part, Validity
from . import document as occt_document
from .face import OcctFace
from .follow import Moved
from .loose import LooseEdges
from .moments import Moments, moments_of
from .quiet import quiet
from .validity import validity_of

if TYPE_CHECKING:
    from ..step_entities import StepEntities

_AREA_LINE = "the area of its faces"

LARGE = 1e4
"""mm; a part that seems larger is looked at more closely."""

WORTH_SAYING = 5e-4
"""Relative difference between the exact area and the CAD kernel's that is told."""


class OcctPart(Part):
    """A part whose shapes live in a document of the CAD kernel, in mm.

    `schema` is the application protocol of a STEP file ("AP203", "AP214IS", "AP242DIS"), "" otherwise. `source` are a STEP
    file's records and which of them the shapes came from; None where the file's text cannot be written again.
    `unit_factor`: how many of the units that it says one is in which its numbers were taken.
    """

    def __init__(
        self,
        document: TDocStd_Document,
        path: Path,
        format: str,
        units: str,
        *,
        warnings: Sequence[str] = (),
        schema: str = "",
        source: StepEntities | None = None,
        unit_factor: float = 1.0,
        names: occt_document.FaceNames | None = None,
    ) -> None:
        self.document = document
        self.path = path
        self.format = format
        self.units = units
        self.schema = schema
        self.warnings = list(warnings)
        with quiet():
            self.shapes = occt_document.free_shapes(document)
            self.shape = _compound(self.shapes)
            self._number = _Numbers(self.shape)
            names = names or occt_document.face_names(document)
            found = list(occt_document.faces_in(self.shape))
            self._own_names = [names.of(face) for face in found]
            unique = _unique_names(self._own_names)
        faces = [
            OcctFace(
                face,
                n,
                name,
                Provenance(path.name, name, units),
                self._number.faces_on,
                self._compare_area,
                self._beside,
            )
            for n, (face, name) in enumerate(zip(found, unique, strict=True), 1)
        ]
        self._loose = LooseEdges([(face.number, face.own_edges) for face in faces], self._number.any_shared)
        self.faces = Faces(faces, str(path), lambda: self.instances)
        self._number.count(found)
        self._instances: tuple[Instance, ...] | None = None
        self._places: dict[int, tuple[int, ...]] | None = None
        self._as_read: Validity | None = None
        self._areas: dict[int, tuple[float, float]] = {}
        self.source = source
        self.unit_factor = unit_factor
        self.sculpted: set[int] = set()
        """Numbers of the faces that were sculpted."""
        self.before: dict[int, Moments] = {}
        """What the sculpted faces added to the part before."""
        self.moved = Moved()
        """The edges and vertices that followed them."""

    @property
    def relabelled(self) -> bool:
        """Whether its numbers were taken in another unit than it says."""
        return self.unit_factor != 1.0

    @property
    def instances(self) -> Sequence[Instance]:
        if self._instances is None:
            from ..step_instances import instances_of

            self._instances = () if self.source is None else instances_of(self, self.source, self._own_names)
        return self._instances

    def separated(self, instances: Sequence[str]) -> Part:
        from ..step_instances import separated

        return separated(self, self.source, instances)

    def twins(self, number: int) -> tuple[int, ...]:
        if self._places is None:
            shapes = [self.face(face.number).shape.TShape() for face in self.faces]
            by_shape: dict[int, list[int]] = {}
            for n, shape in enumerate(shapes, 1):
                by_shape.setdefault(id(shape), []).append(n)
            self._places = {n: tuple(group) for group in by_shape.values() for n in group}
        return tuple(n for n in self._places[number] if n != number)

    @cached_property
    def extent(self) -> float:
        box, close = Bnd_Box(), Bnd_Box()
        with quiet():
            BRepBndLib.Add_s(self.shape, box, False)
            rough = _longest_side(box)
            if rough <= LARGE:
                return rough
            BRepBndLib.AddOptimal_s(self.shape, close, False, False)  # surfaces may reach far beyond their trims
        return _longest_side(close)

    @property
    def tolerance(self) -> float | None:
        from ..step_units import tolerance

        return None if self.source is None else tolerance(self.source.records)

    def tolerance_of(self, number: int) -> float | None:
        from ..step_units import tolerance_at

        if self.source is None:
            return None
        record = self.source.of_shape(self.face(number).shape)
        found = tolerance_at(self.source.records, record) if record else None
        return None if found is None else found * self.unit_factor

    @property
    def recorded_area(self) -> tuple[float, float] | None:
        from ..step_properties import whole_area

        if self.source is None:
            return None
        recorded = whole_area(
            self.source.records, {self.source.of_shape(self.face(f.number).shape) for f in self.faces}
        )
        if recorded is None:
            return None
        with quiet():
            return sum(self.face(face.number).kernel_area() for face in self.faces), recorded

    def face(self, number: int) -> OcctFace:
        """The face of that number, with what the kernel knows of it."""
        face = self.faces.number(number)
        assert isinstance(face, OcctFace)
        return face

    def sculpt(self, surfaces: Mapping[int, BSplineSurface]) -> None:
        from .sculpt import sculpt

        self.validity_as_read()
        with quiet():
            for number in surfaces:
                if number not in self.before:
                    self.before[number] = moments_of(self.face(number))
            self.moved += sculpt(self, surfaces)
        self.sculpted.update(surfaces)
        self._areas.clear()

    def validity(self) -> Validity:
        with quiet():
            return validity_of(self.shapes, [(face.number, self.face(face.number).shape) for face in self.faces])

    def validity_as_read(self) -> Validity:
        """The verdict on the part before it was first sculpted: some files are invalid from the start."""
        if self._as_read is None:
            self._as_read = self.validity()
        return self._as_read

    def write(self, path: Path, format: str) -> None:
        if format == "step":
            from ..step import write

            write(self, path)
        elif format == "iges":
            from ..iges_write import write as write_iges

            write_iges(self, path)
        else:
            from ..registry import write_part

            write_part(self, path, format)

    def _beside(self, number: int, edges: Sequence[FaceEdge]) -> Sequence[FaceEdge]:
        return self._loose.beside(number, edges)

    def _compare_area(self, number: int, area: float, kernel: float) -> None:
        """Say in one line of the warnings where the kernel's own quadrature gives another area than ours."""
        self._areas[number] = (area, kernel)
        total, other = (sum(column) for column in zip(*self._areas.values(), strict=True))
        self.warnings[:] = [line for line in self.warnings if not line.startswith(_AREA_LINE)]
        if abs(total - other) > WORTH_SAYING * total:
            self.warnings.append(
                f"{_AREA_LINE} is {total:.6g} mm2, integrated exactly; OpenCASCADE's own quadrature, which other readers"
                f" show, gives {other:.6g}"
            )

    def faces_on(self, edge: TopoDS_Edge) -> tuple[int, ...]:
        """Numbers of the faces that an edge (as placed in the part) bounds."""
        return self._number.faces_on(edge)


def _longest_side(box: Bnd_Box) -> float:
    """0 for a box without end."""
    if box.IsVoid() or box.IsOpen():
        return 0.0
    low, high = box.CornerMin(), box.CornerMax()
    return float(max(high.X() - low.X(), high.Y() - low.Y(), high.Z() - low.Z()))


class _Numbers:
    """Which faces an edge bounds. The map is made when first asked for."""

    def __init__(self, shape: TopoDS_Shape) -> None:
        self._shape = shape
        self._faces: list[TopoDS_Face] = []
        self._on_edge: IndexedDataMap_TopoDS_Shape_List_TopoDS_Shape_TopTools_ShapeMapHasher | None = None
        self._by_hash: dict[int, list[int]] = {}

    def count(self, faces: Sequence[TopoDS_Face]) -> None:
        """Take the faces in the order of their numbers."""
        self._faces = list(faces)
        for number, face in enumerate(faces, 1):
            self._by_hash.setdefault(hash(face), []).append(number)

    def number(self, face: TopoDS_Shape) -> int:
        """The number of a face, 0 when it is none of the part's."""
        for number in self._by_hash.get(hash(face), ()):
            if self._faces[number - 1].IsSame(face):
                return number
        return 0

    def faces_on(self, edge: TopoDS_Edge) -> tuple[int, ...]:
        """Numbers of the faces that an edge bounds, ascending."""
        known = self._edges()
        if not known.Contains(edge):
            return ()
        return tuple(sorted({self.number(face) for face in known.FindFromKey(edge)} - {0}))

    def any_shared(self) -> bool:
        """Whether any edge bounds two faces."""
        known = self._edges()
        return any(
            len({self.number(face) for face in known.FindFromIndex(i)} - {0}) > 1 for i in range(1, known.Extent() + 1)
        )

    def _edges(self) -> IndexedDataMap_TopoDS_Shape_List_TopoDS_Shape_TopTools_ShapeMapHasher:
        if self._on_edge is None:
            self._on_edge = IndexedDataMap_TopoDS_Shape_List_TopoDS_Shape_TopTools_ShapeMapHasher()
            TopExp.MapShapesAndAncestors_s(
                self._shape, TopAbs_ShapeEnum.TopAbs_EDGE, TopAbs_ShapeEnum.TopAbs_FACE, self._on_edge
            )
        return self._on_edge


def _compound(shapes: Sequence[TopoDS_Shape]) -> TopoDS_Compound:
    builder, compound = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(compound)
    for shape in shapes:
        builder.Add(compound, shape)
    return compound


def _unique_names(names: Sequence[str]) -> list[str]:
    """Every face's name once: a name that several share is followed by the face's number; "face12" where there is none."""
    count = Counter(names)
    taken = {name for name in names if name and count[name] == 1}
    result = []
    for number, name in enumerate(names, 1):
        if name and count[name] == 1:
            result.append(name)
            continue
        unique = f"{name}_{number}" if name else f"face{number}"
        while unique in taken:
            unique += "_"
        taken.add(unique)
        result.append(unique)
    return result


def document_of_shapes(
    shapes: Sequence[tuple[str, TopoDS_Shape]],
    units: str = "mm",
    *,
    faces: Sequence[tuple[str, TopoDS_Face]] = (),
    path: Path | None = None,
    format: str = "step",
) -> OcctPart:
    """A part of named shapes in mm, to be written as STEP or IGES in `units`.

    shapes : (name, shape): faces, shells, solids or compounds. faces : (name, face) for faces inside them.
    Raises InputError when there is no shape or the unit is not known.
    """
    if not shapes:
        raise InputError("there is nothing to write", where=str(path or ""), mend="the part has no faces")
    with quiet():
        document = occt_document.new_document()
        occt_document.set_length_unit(document, occt_document.METRES_PER_MM)
        occt_document.add_shapes(document, shapes)
        occt_document.name_faces(document, faces)
    return OcctPart(document, path or Path(), format, unit_name(units or "mm"))
