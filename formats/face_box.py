"""Tight bounding box of a face of the CAD kernel."""

from __future__ import annotations

from OCP.Bnd import Bnd_Box
from OCP.BRepBndLib import BRepBndLib
from OCP.TopoDS import TopoDS_Face

from .occt.quiet import quiet


def face_box(face: TopoDS_Face) -> tuple[float, float, float, float, float, float]:
    """xmin, ymin, zmin, xmax, ymax, zmax of a trimmed face, mm."""
    box = Bnd_Box()
    with quiet():
        BRepBndLib.AddOptimal_s(face, box, False, False)
    low, high = box.CornerMin(), box.CornerMax()
    return low.X(), low.Y(), low.Z(), high.X(), high.Y(), high.Z()
