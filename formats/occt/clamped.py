"""Closed surfaces as their file has them: clamped, where OCCT made them periodic on reading.

OCCT drops one copy of the end knots of a closed B-spline surface and the control points that stand twice. Both come back as
they were; trim curves that it moved by whole periods go back into the domain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from OCP.BRep import BRep_CurveOnSurface
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.Geom import Geom_BSplineSurface, Geom_Surface
from OCP.Geom2d import Geom2d_Curve
from OCP.gp import gp_Vec2d
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Face, TopoDS_Iterator, TopoDS_Shape

from .boundary import placement
from .curve import sample_trim, smooth_breaks
from .own_trims import curves_of, set_curves
from .shape import basis_of_geom
from .tolerance import FORWARD

Array = NDArray[np.float64]

SLACK = 1e-7
"""How far a trim curve may lie outside of the domain, as a share of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Clamped:
    """A face, and in which directions the file has its surface with full knots at the ends."""

    face: TopoDS_Face
    u: bool
    v: bool


def keep_clamped(faces: Sequence[Clamped]) -> int:
    """Unroll the periodic surfaces of faces that their file has clamped. Returns how many surfaces were.

    Faces that share a surface are unrolled together. One that runs over its seam keeps all of them periodic.
    """
    groups: list[tuple[Geom_Surface, list[Clamped]]] = []
    for item in faces:
        surface = placement(item.face)[0]
        if not isinstance(surface, Geom_Surface):
            continue
        known = next((group for other, group in groups if other is surface), None)
        if known is None:
            groups.append((surface, [item]))
        else:
            known.append(item)
    return sum(_unroll(surface, group) for surface, group in groups)


def _unroll(surface: Geom_Surface, group: Sequence[Clamped]) -> bool:
    geom = basis_of_geom(surface)  # the basis of a surface cut along its parameters is changed in place
    if not isinstance(geom, Geom_BSplineSurface):
        return False
    axes = (
        geom.IsUPeriodic() and all(item.u for item in group),
        geom.IsVPeriodic() and all(item.v for item in group),
    )
    if not any(axes):
        return False
    shifts: list[tuple[BRep_CurveOnSurface, tuple[float, float]]] = []
    for item in group:
        for wire in _parts(item.face):
            if wire.ShapeType() != TopAbs_ShapeEnum.TopAbs_WIRE:
                continue
            held = _held(wire, surface)
            shift = _shift(held, geom, axes)
            if shift is None:
                return False
            for curve in held:
                known = next((s for c, s in shifts if c is curve), None)
                if known is None:
                    shifts.append((curve, shift))
                elif known != shift:
                    return False
    sound = [BRepCheck_Analyzer(item.face).IsValid() for item in group]
    old = [(held, curves_of(held)) for held, _ in shifts]
    _clamp(geom, axes)
    for held, shift in shifts:
        set_curves(held, tuple(_moved(curve, shift) for curve in curves_of(held)))
    if all(BRepCheck_Analyzer(item.face).IsValid() for item, good in zip(group, sound, strict=True) if good):
        return True
    if axes[0]:
        geom.SetUPeriodic()
    if axes[1]:
        geom.SetVPeriodic()
    for held, curves in old:
        set_curves(held, curves)
    return False


def _clamp(geom: Geom_BSplineSurface, axes: tuple[bool, bool]) -> None:
    """Unroll periodic directions, with full knots at the ends."""
    if axes[0]:
        geom.SetUNotPeriodic()
    if axes[1]:
        geom.SetVNotPeriodic()
    rows, columns = range(1, geom.NbUPoles() + 1), range(1, geom.NbVPoles() + 1)
    net = [(i, j, geom.Pole(i, j), geom.Weight(i, j)) for i in rows for j in columns]
    rational = geom.IsURational() or geom.IsVRational()
    geom.Segment(*geom.Bounds())  # the ends have as many knots as the degree so far
    if (geom.NbUPoles(), geom.NbVPoles()) != (len(rows), len(columns)):
        return
    for i, j, pole, weight in net:  # inserting the last of the knots moves nothing, but rounds
        if rational:
            geom.SetPole(i, j, pole, weight)
        else:
            geom.SetPole(i, j, pole)


def _parts(shape: TopoDS_Shape) -> list[TopoDS_Shape]:
    iterator, found = TopoDS_Iterator(shape), []
    while iterator.More():
        found.append(iterator.Value())
        iterator.Next()
    return found


def _held(wire: TopoDS_Shape, surface: Geom_Surface) -> list[BRep_CurveOnSurface]:
    """What the edges of a loop hold of the surface, each once."""
    found: list[BRep_CurveOnSurface] = []
    for part in _parts(wire):
        edge: TopoDS_Edge = TopoDS.Edge(part.Located(TopLoc_Location()).Oriented(FORWARD))
        for item in edge.TShape().Curves():
            mine = isinstance(item, BRep_CurveOnSurface) and item.Surface() is surface
            if mine and not any(item is other for other in found):
                found.append(item)
    return found


def _shift(
    held: Sequence[BRep_CurveOnSurface], geom: Geom_BSplineSurface, axes: tuple[bool, bool]
) -> tuple[float, float] | None:
    """What brings a loop into the domain by whole periods; None when it is longer than the domain, or lies across its end."""
    places = [
        sample_trim(curve, np.union1d(np.linspace(c.First(), c.Last(), 9), smooth_breaks(curve, c.First(), c.Last())))
        for c in held
        for curve in curves_of(c)
    ]
    if not places:
        return 0.0, 0.0
    points = np.concatenate(places)
    made = [0.0, 0.0]
    for axis, (low, high) in enumerate(np.array(geom.Bounds()).reshape(2, 2).tolist()):
        if not axes[axis]:
            continue
        period, slack = high - low, SLACK * (high - low)
        first, last = points[:, axis].min(), points[:, axis].max()
        turns = np.floor((first - low + slack) / period)
        if last - turns * period > high + slack:
            return None
        made[axis] = float(-turns * period)
    return made[0], made[1]


def _moved(curve: Geom2d_Curve, shift: tuple[float, float]) -> Geom2d_Curve:
    return curve if shift == (0.0, 0.0) else curve.Translated(gp_Vec2d(*shift))
