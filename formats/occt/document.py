"""The kernel's document (XDE): shapes with names, colours, layers and placements, and what can be asked of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from OCP.collections import IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher, Sequence_TDF_Label
from OCP.Interface import Interface_InterfaceModel
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDF import TDF_AttributeIterator, TDF_Label
from OCP.TDocStd import TDocStd_Document
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp, TopExp_Explorer
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Face, TopoDS_Shape
from OCP.XCAFDoc import XCAFDoc_DocumentTool, XCAFDoc_ShapeTool

METRES_PER_MM = 1e-3

_SHAPE_TYPES = ("StepGeom_", "StepShape_", "IGESGeom_", "IGESSolid_", "IGESData_")
_HARMLESS = ("not a quoted String", "Seam Curve with twice the same geom")

NAMELESS = {"", "NONE", "NO NAME", "UNKNOWN", "$"}
"""Names, in capitals, that say nothing."""


def new_document() -> TDocStd_Document:
    """An empty document, of no application: it goes when Python's last reference goes."""
    document = TDocStd_Document(TCollection_ExtendedString("BinXCAF"))
    XCAFDoc_DocumentTool.Set_s(document.Main(), False)
    return document


def shape_tool(document: TDocStd_Document) -> XCAFDoc_ShapeTool:
    """The tool that knows the document's shapes."""
    return XCAFDoc_DocumentTool.ShapeTool_s(document.Main())


def set_length_unit(document: TDocStd_Document, metres: float) -> None:
    """Say how many metres one unit of the document's coordinates is."""
    XCAFDoc_DocumentTool.SetLengthUnit_s(document, metres)


def labels(sequence: Any) -> list[TDF_Label]:
    """A sequence of labels as a list."""
    return [sequence.Value(i) for i in range(1, sequence.Length() + 1)]


def wrong_entities(model: Interface_InterfaceModel) -> int:
    """How many entities of geometry and topology, of a file just loaded, the kernel found to hold the wrong things.

    Names that are no strings and the like are common in sound files and do no harm; they are not counted.
    """
    count = 0
    for i in range(1, model.NbEntities() + 1):
        if model.IsErrorEntity(i) and model.Value(i).DynamicType().Name().startswith(_SHAPE_TYPES):
            check = model.Check(i, True)
            fails = [check.CFail(k) for k in range(1, check.NbFails() + 1)]
            count += not fails or any(not _harmless(fail) for fail in fails)
    return count


def _harmless(fail: str) -> bool:
    """True for a complaint that says nothing about the shape."""
    return any(text in fail for text in _HARMLESS)


def free_shapes(document: TDocStd_Document) -> list[TopoDS_Shape]:
    """The top-level shapes, assemblies put together with their placements."""
    found = Sequence_TDF_Label()
    shape_tool(document).GetFreeShapes(found)
    return [XCAFDoc_ShapeTool.GetShape_s(label) for label in labels(found)]


def label_name(label: TDF_Label) -> str:
    """The name that stands on a label, "" when there is none."""
    attributes = TDF_AttributeIterator(label)
    while attributes.More():
        attribute = attributes.Value()
        if isinstance(attribute, TDataStd_Name):
            return str(attribute.Get().ToExtString())
        attributes.Next()
    return ""


def set_name(label: TDF_Label, name: str) -> None:
    """Put a name on a label."""
    TDataStd_Name.Set_s(label, TCollection_ExtendedString(name, True))


def faces_in(shape: TopoDS_Shape) -> Iterator[TopoDS_Face]:
    """The faces of a shape as they stand in it, in the kernel's order."""
    explorer = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_FACE)
    while explorer.More():
        yield TopoDS.Face(explorer.Current())
        explorer.Next()


def count_faces(shapes: Sequence[TopoDS_Shape]) -> int:
    """How many different faces shapes have, wherever and how often they are placed."""
    found = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
    for shape in shapes:
        for face in faces_in(shape):
            found.Add(face.Located(TopLoc_Location()))
    return int(found.Extent())


class FaceNames:
    """Names of faces, wherever the face is placed."""

    def __init__(self) -> None:
        self._index = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
        self._names: list[str] = []

    def add(self, face: TopoDS_Shape, name: str) -> None:
        """Name a face, unless it has one."""
        if name.strip().upper() in NAMELESS:
            return
        bare = face.Located(TopLoc_Location())
        if self._index.Contains(bare):
            return
        self._index.Add(bare)
        self._names.append(name.strip())

    def of(self, face: TopoDS_Shape) -> str:
        """The name of a face, "" when it has none."""
        place = self._index.FindIndex(face.Located(TopLoc_Location()))
        return self._names[place - 1] if place else ""


def face_names(document: TDocStd_Document) -> FaceNames:
    """The names that stand on the document's faces; a free face has that of its own shape."""
    names = FaceNames()
    every = Sequence_TDF_Label()
    shape_tool(document).GetShapes(every)
    for label in labels(every):
        subshapes = Sequence_TDF_Label()
        XCAFDoc_ShapeTool.GetSubShapes_s(label, subshapes)
        for item in [*labels(subshapes), label]:
            shape = XCAFDoc_ShapeTool.GetShape_s(item)
            if not shape.IsNull() and shape.ShapeType() == TopAbs_ShapeEnum.TopAbs_FACE:
                names.add(shape, label_name(item))
    return names


def add_shapes(document: TDocStd_Document, shapes: Sequence[tuple[str, TopoDS_Shape]]) -> None:
    """Add named shapes to a document; faces named inside them come by `name_faces`."""
    tool = shape_tool(document)
    for name, shape in shapes:
        label = tool.AddShape(shape, False)
        set_name(label, name)


def name_faces(document: TDocStd_Document, named: Sequence[tuple[str, TopoDS_Face]]) -> None:
    """Put names on faces inside the document's shapes."""
    tool = shape_tool(document)
    found = Sequence_TDF_Label()
    tool.GetFreeShapes(found)
    for label in labels(found):
        inside = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
        TopExp.MapShapes_s(XCAFDoc_ShapeTool.GetShape_s(label), TopAbs_ShapeEnum.TopAbs_FACE, inside)
        for name, face in named:
            if not inside.Contains(face):
                continue
            if XCAFDoc_ShapeTool.GetShape_s(label).IsSame(face):
                set_name(label, name)
            else:
                set_name(tool.AddSubShape(label, face), name)
