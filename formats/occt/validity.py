"""The kernel's checker on a part, its findings in words."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from OCP.BRep import BRep_Tool
from OCP.BRepCheck import BRepCheck_Analyzer, BRepCheck_Face, BRepCheck_Shell, BRepCheck_Status, BRepCheck_Wire
from OCP.collections import IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Face, TopoDS_Shape, TopoDS_Wire

from ..part import Validity
from .tolerance import edge_gap, vertex_gaps

MOST_FAULTS = 40
"""Faults told one by one; the rest are counted."""


def validity_of(shapes: Sequence[TopoDS_Shape], faces: Sequence[tuple[int, TopoDS_Face]]) -> Validity:
    """The checker's verdict on shapes; faces (number, face) are those that the faults speak of."""
    faults: list[str] = []
    valid = True
    for shape in shapes:
        analyzer = BRepCheck_Analyzer(shape)
        if analyzer.IsValid():
            continue
        valid = False
        inside = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
        TopExp.MapShapes_s(shape, TopAbs_ShapeEnum.TopAbs_FACE, inside)
        bad = [(number, face) for number, face in faces if inside.Contains(face) and not analyzer.IsValid(face)]
        for number, face in bad:
            faults += [f"face {number}: {text}" for text in _face_faults(analyzer, face)]
        if not bad:
            faults += _whole_faults(analyzer, shape)
    unique = list(dict.fromkeys(faults))
    if len(unique) > MOST_FAULTS:
        unique = [*unique[:MOST_FAULTS], f"and {len(unique) - MOST_FAULTS} more"]
    if not valid and not unique:
        unique = ["the checker refuses the part without naming a fault"]
    return Validity(valid, tuple(unique))


def _face_faults(analyzer: BRepCheck_Analyzer, face: TopoDS_Face) -> list[str]:
    """What is wrong with a face that the checker refuses."""
    if BRep_Tool.Surface_s(face) is None:
        return ["it has no surface"]
    found: list[str] = []
    for n, edge in enumerate(_inside(face, TopAbs_ShapeEnum.TopAbs_EDGE), 1):
        found += [f"edge {n}: {text}" for text in _edge_faults(TopoDS.Edge(edge), not analyzer.IsValid(edge))]
    for n, wire in enumerate(_inside(face, TopAbs_ShapeEnum.TopAbs_WIRE), 1):
        found += [f"loop {n}: {text}" for text in _wire_faults(TopoDS.Wire(wire), face)]
    check = BRepCheck_Face(face)
    for status in (check.IntersectWires(), check.ClassifyWires(), check.OrientationOfWires()):
        found += _words(status)
    return found or ["the checker refuses it"]


def _edge_faults(edge: TopoDS_Edge, refused: bool) -> Iterator[str]:
    gap, tolerance = edge_gap(edge), BRep_Tool.Tolerance_s(edge)
    if gap > tolerance:
        yield f"its curves lie {gap:.2g} mm apart, its tolerance is {tolerance:.2g}"
    elif refused:
        yield "the checker refuses it"
    for distance, tolerance in vertex_gaps(edge):
        if distance > tolerance:
            yield f"a vertex lies {distance:.2g} mm off, its tolerance is {tolerance:.2g}"


def _wire_faults(wire: TopoDS_Wire, face: TopoDS_Face) -> list[str]:
    check = BRepCheck_Wire(wire)
    statuses = [check.Closed(), check.Closed2d(face), check.Orientation(face)]
    if not _words(statuses[0]):
        statuses.append(check.SelfIntersect(face, TopoDS_Edge(), TopoDS_Edge()))
    return [text for status in statuses for text in _words(status)]


def _whole_faults(analyzer: BRepCheck_Analyzer, shape: TopoDS_Shape) -> list[str]:
    """What is wrong where every face by itself is right."""
    found: list[str] = []
    for n, shell in enumerate(_inside(shape, TopAbs_ShapeEnum.TopAbs_SHELL), 1):
        if not analyzer.IsValid(shell):
            check = BRepCheck_Shell(TopoDS.Shell(shell))
            texts = [*_words(check.Closed()), *_words(check.Orientation())]
            found += [f"shell {n}: {text}" for text in texts or ["the checker refuses it"]]
    for n, edge in enumerate(_inside(shape, TopAbs_ShapeEnum.TopAbs_EDGE), 1):
        if not analyzer.IsValid(edge):
            found += [f"edge {n} of the part: {text}" for text in _edge_faults(TopoDS.Edge(edge), True)]
    for n, solid in enumerate(_inside(shape, TopAbs_ShapeEnum.TopAbs_SOLID), 1):
        if not found and not analyzer.IsValid(solid):
            found.append(f"solid {n}: the checker refuses it")
    return found


def _inside(shape: TopoDS_Shape, kind: TopAbs_ShapeEnum) -> list[TopoDS_Shape]:
    """The distinct parts of a kind in a shape."""
    found = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
    TopExp.MapShapes_s(shape, kind, found)
    return [found.FindKey(i) for i in range(1, found.Extent() + 1)]


def _words(status: BRepCheck_Status) -> list[str]:
    """BRepCheck_SelfIntersectingWire -> ["self intersecting wire"]; nothing for no error."""
    if status == BRepCheck_Status.BRepCheck_NoError:
        return []
    return [re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", status.name.removeprefix("BRepCheck_")).lower()]
