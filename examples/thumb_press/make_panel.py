"""Make panel.step: a clay panel with a crowned B-spline top, rounded corners and a round hole, all faces named.

python make_panel.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.BRepAlgoAPI import BRepAlgoAPI_Common, BRepAlgoAPI_Cut
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
from OCP.BRepFilletAPI import BRepFilletAPI_MakeFillet
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeHalfSpace
from OCP.GeomAbs import GeomAbs_BSplineSurface, GeomAbs_Cylinder, GeomAbs_Plane
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_SOLID
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Face, TopoDS_Shape

from cadsculpt.formats.occt.part import document_of_shapes
from cadsculpt.formats.occt.shape import geom_of_surface
from cadsculpt.spline.surface import BSplineSurface

LENGTH, WIDTH, CORNER, HOLE = 100.0, 70.0, 10.0, 9.0
HOLE_AT = (32.0, 12.0)


def crown() -> BSplineSurface:
    """The top: bicubic, 8 x 6 control points over a rectangle larger than the panel, about 5 mm of crown."""
    knots_u = np.array([0, 0, 0, 0, 20, 40, 80, 100, 120, 120, 120, 120], dtype=float)
    knots_v = np.array([0, 0, 0, 0, 30, 60, 90, 90, 90, 90], dtype=float)
    x = np.array([knots_u[i + 1 : i + 4].mean() for i in range(8)]) - 60.0
    y = np.array([knots_v[j + 1 : j + 4].mean() for j in range(6)]) - 45.0
    X, Y = np.meshgrid(x, y, indexing="ij")
    Z = 14.0 - 4.0 * (X / 60.0) ** 2 - 3.0 * (Y / 45.0) ** 2 + 0.6 * np.sin(X / 17.0)
    return BSplineSurface(np.stack([X, Y, Z], axis=-1), knots_u, knots_v, 3, 3, name="top")


def panel() -> TopoDS_Shape:
    """A block with rounded corners and a hole, cut off by the crown."""
    block = BRepPrimAPI_MakeBox(gp_Pnt(-LENGTH / 2, -WIDTH / 2, 0), gp_Pnt(LENGTH / 2, WIDTH / 2, 30)).Shape()
    fillet = BRepFilletAPI_MakeFillet(block)
    edges = TopExp_Explorer(block, TopAbs_EDGE)
    seen: list[TopoDS_Shape] = []
    while edges.More():
        edge = TopoDS.Edge(edges.Current())
        if _vertical(edge) and not any(edge.IsSame(other) for other in seen):
            fillet.Add(CORNER, edge)
            seen.append(edge)
        edges.Next()
    drill = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(*HOLE_AT, -1), gp_Dir(0, 0, 1)), HOLE, 40).Shape()
    drilled = BRepAlgoAPI_Cut(fillet.Shape(), drill).Shape()
    face = BRepBuilderAPI_MakeFace(geom_of_surface(crown()), 1e-7).Face()
    below = BRepPrimAPI_MakeHalfSpace(face, gp_Pnt(0, 0, -100)).Solid()
    solid = BRepAlgoAPI_Common(drilled, below).Shape()
    return TopExp_Explorer(solid, TopAbs_SOLID).Current()


def _vertical(edge: TopoDS_Edge) -> bool:
    curve = BRepAdaptor_Curve(edge)
    a, b = curve.Value(curve.FirstParameter()), curve.Value(curve.LastParameter())
    return abs(a.Z() - b.Z()) > 1.0


def named_faces(shape: TopoDS_Shape) -> list[tuple[str, TopoDS_Face]]:
    """Every face with its name: top, bottom, hole, side1, side2, ..."""
    found, sides = [], 0
    faces = TopExp_Explorer(shape, TopAbs_FACE)
    while faces.More():
        face = TopoDS.Face(faces.Current())
        surface = BRepAdaptor_Surface(face)
        if surface.GetType() == GeomAbs_BSplineSurface:
            name = "top"
        elif surface.GetType() == GeomAbs_Cylinder and abs(surface.Cylinder().Radius() - HOLE) < 1e-6:
            name = "hole"
        elif surface.GetType() == GeomAbs_Plane and abs(surface.Plane().Axis().Direction().Z()) > 0.5:
            name = "bottom"
        else:
            sides += 1
            name = f"side{sides}"
        found.append((name, face))
        faces.Next()
    return found


if __name__ == "__main__":
    shape = panel()
    part = document_of_shapes([("panel", shape)], "mm", faces=named_faces(shape))
    part.write(Path(__file__).with_name("panel.step"), "step")
