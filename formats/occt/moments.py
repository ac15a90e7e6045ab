"""What one face adds to the area, the volume and the centroid of the body that it bounds."""

from __future__ import annotations

from dataclasses import dataclass

from OCP.BRepGProp import BRepGProp_Domain, BRepGProp_Face, BRepGProp_Sinert, BRepGProp_Vinert
from OCP.gp import gp_Pnt
from OCP.GProp import GProp_GProps
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS

from .face import OcctFace

_FINE = 1e-7
"""Relative error that the kernel's adaptive quadrature may leave."""

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Moments:
    """area, mm2; volume, mm3, of the cone from the face to the origin of the part's own frame, signed as the face is
    turned; and the first moments of both, mm3 and mm4."""

    area: float
    volume: float
    area_moments: Vector
    volume_moments: Vector


def moments_of(face: OcctFace) -> Moments:
    """The moments of a face, in the frame of the part that it belongs to, wherever that is placed."""
    shape = TopoDS.Face(face.shape.Located(TopLoc_Location()))
    origin, found = gp_Pnt(0.0, 0.0, 0.0), BRepGProp_Face(shape)
    flat = BRepGProp_Sinert(found, BRepGProp_Domain(shape), origin, _FINE)
    solid = BRepGProp_Vinert(found, BRepGProp_Domain(shape), origin, origin, _FINE)
    return Moments(face.area, float(solid.Mass()), _first(flat), _first(solid))


def _first(properties: GProp_GProps) -> Vector:
    mass, centre = float(properties.Mass()), properties.CentreOfMass()
    return mass * centre.X(), mass * centre.Y(), mass * centre.Z()
