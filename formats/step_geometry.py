"""The kernel's B-spline surfaces and curves as STEP records, in the file's unit, with the shortest exact numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray
from OCP.Geom import Geom_BSplineCurve, Geom_BSplineSurface
from scipy.spatial import cKDTree

from .step_records import StepRecords, references
from .step_text import step_real
from .step_units import coordinates

Array = NDArray[np.float64]

SAME = 4e-16
"""Relative difference below which a point is the one that stands in the file: it went to mm and back."""


class PointPool:
    """CARTESIAN_POINT records: those that stand in the file are used again, the others are added."""

    def __init__(self, records: StepRecords, scale: float, known: Iterable[int] = ()) -> None:
        """scale : mm per unit of the file. known : the points that the geometry had."""
        self._records, self._scale = records, scale
        self._numbers = [n for n in dict.fromkeys(known) if records.type(n) == "CARTESIAN_POINT"]
        places = np.array([coordinates(records, n) for n in self._numbers], dtype=np.float64).reshape(-1, 3)
        self._places = places * scale
        self._tree = cKDTree(self._places) if len(places) else None

    def number(self, point: Array) -> int:
        """The record of a point (3,), mm."""
        if self._tree is not None:
            distance, index = self._tree.query(point)
            if distance <= SAME * max(1e-300, float(np.abs(point).max())) * 3.0:
                return self._numbers[int(index)]
        return self._records.add(b"CARTESIAN_POINT('',(%s))" % _reals(point / self._scale))


def surface_body(geom: Geom_BSplineSurface, points: PointPool, name: bytes, flags: tuple[bytes, bytes]) -> bytes:
    """The text of a B-spline surface; `flags` say whether it is closed in u and in v."""
    geom = geom.Copy()
    if geom.IsUPeriodic():
        geom.SetUNotPeriodic()
    if geom.IsVPeriodic():
        geom.SetVNotPeriodic()
    rows, columns = range(1, geom.NbUPoles() + 1), range(1, geom.NbVPoles() + 1)
    net = b",".join(b"(%s)" % b",".join(b"#%d" % points.number(_point(geom.Pole(i, j))) for j in columns) for i in rows)
    shape = b"%d,%d,(%s),.UNSPECIFIED.,%s,%s,.F." % (geom.UDegree(), geom.VDegree(), net, *flags)
    knots = b"(%s),(%s),(%s),(%s),.UNSPECIFIED." % (
        _integers(geom.UMultiplicity, geom.NbUKnots()),
        _integers(geom.VMultiplicity, geom.NbVKnots()),
        _reals(geom.UKnot(k) for k in range(1, geom.NbUKnots() + 1)),
        _reals(geom.VKnot(k) for k in range(1, geom.NbVKnots() + 1)),
    )
    if not (geom.IsURational() or geom.IsVRational()):
        return b"B_SPLINE_SURFACE_WITH_KNOTS(%s,%s,%s)" % (name, shape, knots)
    weights = b",".join(b"(%s)" % _reals(geom.Weight(i, j) for j in columns) for i in rows)
    return (
        b"(BOUNDED_SURFACE()B_SPLINE_SURFACE(%s)B_SPLINE_SURFACE_WITH_KNOTS(%s)GEOMETRIC_REPRESENTATION_ITEM()"
        b"RATIONAL_B_SPLINE_SURFACE((%s))REPRESENTATION_ITEM(%s)SURFACE())" % (shape, knots, weights, name)
    )


def curve_body(curve: Geom_BSplineCurve, points: PointPool) -> bytes:
    """The text of a B-spline curve in space."""
    curve = curve.Copy()
    if curve.IsPeriodic():
        curve.SetNotPeriodic()
    poles = b",".join(b"#%d" % points.number(_point(curve.Pole(i))) for i in range(1, curve.NbPoles() + 1))
    shape = b"%d,(%s),.UNSPECIFIED.,%s,.F." % (curve.Degree(), poles, b".T." if curve.IsClosed() else b".F.")
    knots = b"(%s),(%s),.UNSPECIFIED." % (
        _integers(curve.Multiplicity, curve.NbKnots()),
        _reals(curve.Knot(k) for k in range(1, curve.NbKnots() + 1)),
    )
    if not curve.IsRational():
        return b"B_SPLINE_CURVE_WITH_KNOTS('',%s,%s)" % (shape, knots)
    weights = _reals(curve.Weight(i) for i in range(1, curve.NbPoles() + 1))
    return (
        b"(BOUNDED_CURVE()B_SPLINE_CURVE(%s)B_SPLINE_CURVE_WITH_KNOTS(%s)CURVE()GEOMETRIC_REPRESENTATION_ITEM()"
        b"RATIONAL_B_SPLINE_CURVE((%s))REPRESENTATION_ITEM(''))" % (shape, knots, weights)
    )


def closed_flags(records: StepRecords, surface: int) -> tuple[bytes, bytes] | None:
    """The u_closed and v_closed flags of a B-spline surface's record; None for another kind of record."""
    for type in ("B_SPLINE_SURFACE", "B_SPLINE_SURFACE_WITH_KNOTS", "BEZIER_SURFACE", "UNIFORM_SURFACE",
                 "QUASI_UNIFORM_SURFACE"):  # fmt: skip
        arguments = records.arguments(surface, type)
        named = bool(arguments) and arguments[0].startswith((b"'", b"$"))
        if len(arguments) >= 6 + named and arguments[2 + named].startswith(b"("):
            return arguments[4 + named], arguments[5 + named]
    return None


def own_points(records: StepRecords, number: int) -> list[int]:
    """The points that a spline's record names."""
    return [n for n in references(records.body(number)) if records.type(n) == "CARTESIAN_POINT"]


def _point(point: object) -> Array:
    return np.array([point.X(), point.Y(), point.Z()])  # type: ignore[attr-defined]


def _reals(values: Iterable[float]) -> bytes:
    return b",".join(step_real(float(value)).encode() for value in values)


def _integers(value: Callable[[int], int], count: int) -> bytes:
    return b",".join(b"%d" % value(k) for k in range(1, count + 1))
