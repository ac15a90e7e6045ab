"""What others say of a file that was written: the CAD kernel's plain readers, openNURBS; none of cadsculpt's reading.

A file that only cadsculpt reads well would pass every comparison that cadsculpt makes. Here the file as it was and the
file as it is written go through the same foreign reader, and the second must come out no worse.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

SAME_AREA = 1e-6
"""Relative difference up to which a face that was not sculpted has the area that it had."""

OWN_AREA = 0.2
"""The same for knowing the sculpted face among those whose area has changed: a kernel's quadrature can be some percent off."""

READERS = {"step": "OCCT's STEP reader", "iges": "OCCT's IGES reader", "3dm": "openNURBS"}
"""Who looks at which format."""


@dataclass(frozen=True, slots=True)
class Foreign:
    """A file in another's eyes: how many faces (or objects), how many of them are faulty, and the faces' areas, mm2."""

    count: int
    faulty: int
    areas: tuple[float, ...] = ()


def foreign(path: Path, format: str) -> Foreign | None:
    """A file as another program reads it; None for formats that no other program here reads."""
    if format in ("step", "iges"):
        return _kernel(path, format)
    if format == "3dm":
        return _open_nurbs(path)
    return None


def faults(before: Foreign, after: Foreign, sculpted_area: float) -> list[str]:
    """What is worse than before. sculpted_area : mm2, of the face that was sculpted, as it was."""
    found = []
    if after.count < before.count:
        found.append(f"{after.count} faces are read, there were {before.count}")
    if after.faulty > before.faulty:
        found.append(f"{after.faulty} faces are faulty, there were {before.faulty}")
    gone = unmatched(before.areas, after.areas)
    own = min(gone, key=lambda area: abs(area - sculpted_area), default=0.0)
    if _same(own, sculpted_area, OWN_AREA):  # as often as it is placed
        gone = [area for area in gone if not _same(area, own, SAME_AREA)]
    if gone:
        found.append(f"{len(gone)} other faces have another area: {', '.join(f'{area:.9g}' for area in gone[:3])} mm2")
    return found


def unmatched(before: tuple[float, ...], after: tuple[float, ...]) -> list[float]:
    """The areas of `before` that are not among those of `after`, each taken once."""
    left, gone = sorted(after), []
    for area in sorted(before):
        place = next((k for k, other in enumerate(left) if _same(area, other, SAME_AREA)), None)
        if place is None:
            gone.append(area)
        else:
            del left[place]
    return gone


def _same(a: float, b: float, tolerance: float) -> bool:
    return abs(a - b) <= tolerance * max(abs(a), abs(b))


def _kernel(path: Path, format: str) -> Foreign:
    from OCP.BRep import BRep_Tool
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.IGESControl import IGESControl_Reader
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    from cadsculpt.formats.occt.quiet import quiet

    areas: list[float] = []
    faulty = 0
    with quiet():
        reader = STEPControl_Reader() if format == "step" else IGESControl_Reader()
        if reader.ReadFile(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
            return Foreign(0, 0)
        reader.TransferRoots()
        shape = reader.OneShape()
        if shape is None or shape.IsNull():
            return Foreign(0, 0)
        analyzer = BRepCheck_Analyzer(shape)
        explorer = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_FACE)
        while explorer.More():
            face = TopoDS.Face(explorer.Current())
            faulty += not analyzer.IsValid(face) or BRep_Tool.Surface_s(face) is None
            properties = GProp_GProps()
            BRepGProp.SurfaceProperties_s(face, properties)
            areas.append(abs(float(properties.Mass())))
            explorer.Next()
        if not faulty and not analyzer.IsValid():
            faulty = 1  # a shell or a solid
    return Foreign(len(areas), faulty, tuple(areas))


def _open_nurbs(path: Path) -> Foreign:
    import rhino3dm

    model: Any = rhino3dm.File3dm.Read(str(path))
    if model is None:
        return Foreign(0, 0)
    objects = [item.Geometry for item in model.Objects]
    return Foreign(len(objects), sum(not geometry.IsValid for geometry in objects))
