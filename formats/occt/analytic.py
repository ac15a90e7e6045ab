"""Planes, cylinders, cones, spheres, tori, surfaces of revolution and extrusion as equal B-splines; offsets as near ones.

A surface of revolution is the product of a rational quadratic arc and its profile, so that the conversion is exact and
it is known in closed form where each of the kernel's parameters goes (`arcs.ArcParameter`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from OCP.Geom import (
    Geom_BezierCurve,
    Geom_BezierSurface,
    Geom_BSplineCurve,
    Geom_BSplineSurface,
    Geom_Circle,
    Geom_ConicalSurface,
    Geom_Curve,
    Geom_CylindricalSurface,
    Geom_Ellipse,
    Geom_Line,
    Geom_OffsetSurface,
    Geom_Parabola,
    Geom_Plane,
    Geom_RectangularTrimmedSurface,
    Geom_SphericalSurface,
    Geom_Surface,
    Geom_SurfaceOfLinearExtrusion,
    Geom_SurfaceOfRevolution,
    Geom_ToroidalSurface,
    Geom_TrimmedCurve,
)
from OCP.GeomAbs import GeomAbs_Shape
from OCP.GeomConvert import GeomConvert, GeomConvert_ApproxSurface
from OCP.gp import gp_Ax3, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec

from ...errors import GeometryError
from ...spline.surface import BSplineSurface
from ..arcs import FULL_TURN, ArcParameter, UnitArc, unit_arc
from ..curve_fit import fit_curve
from .arrays import from_integers, from_points, from_reals, knots_and_multiplicities
from .shape import basis_of_geom, surface_of_geom, transformed, unrolled_knots

Array = NDArray[np.float64]
Bounds = tuple[float, float, float, float]
"""u_min, u_max, v_min, v_max."""

APPROXIMATION = 1e-6
"""Distance, mm, within which surfaces and curves that no B-spline equals are approximated."""

_KINDS: dict[type, str] = {
    Geom_BSplineSurface: "bspline",
    Geom_BezierSurface: "bezier",
    Geom_Plane: "plane",
    Geom_CylindricalSurface: "cylinder",
    Geom_ConicalSurface: "cone",
    Geom_SphericalSurface: "sphere",
    Geom_ToroidalSurface: "torus",
    Geom_SurfaceOfRevolution: "revolution",
    Geom_SurfaceOfLinearExtrusion: "extrusion",
    Geom_OffsetSurface: "offset",
}


@dataclass(frozen=True, slots=True, eq=False)
class Conversion:
    """A B-spline surface made from another kind, and where the parameters went.

    map_u, map_v: None where the parameter is the same. `note` says what is not exact, "" when all is.
    """

    surface: BSplineSurface
    map_u: ArcParameter | None = None
    map_v: ArcParameter | None = None
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class _Spline:
    """A curve as a B-spline: poles (n, 3), weights, knots, degree, where its parameter went, what is not exact."""

    poles: Array
    weights: Array
    knots: Array
    degree: int
    parameter: ArcParameter | None = None
    note: str = ""


def kind_of_geom(geom: Geom_Surface) -> str:
    """bspline, bezier, plane, cylinder, cone, sphere, torus, revolution, extrusion, offset or other."""
    return _KINDS.get(type(basis_of_geom(geom)), "other")


def convert(geom: Geom_Surface, bounds: Bounds, transformation: gp_Trsf | None = None) -> Conversion:
    """The B-spline surface equal to `geom` over `bounds` (the whole of it when it is a spline already).

    Raises GeometryError when the bounds are not finite or the kernel cannot approximate the surface.
    """
    geom = basis_of_geom(geom)
    if isinstance(geom, Geom_BSplineSurface | Geom_BezierSurface):
        return Conversion(surface_of_geom(geom, transformation))
    u0, u1, v0, v1 = bounds
    if not np.isfinite(bounds).all() or max(map(abs, bounds)) >= 1e100 or u1 <= u0 or v1 <= v0:
        raise GeometryError("the face is not bounded", mend="trim it in the CAD system")
    if abs(u1 - u0 - FULL_TURN) < 1e-7 and geom.IsUPeriodic():
        u1 = u0 + FULL_TURN
    if isinstance(geom, Geom_Plane):
        made = _plane(geom, u0, u1, v0, v1)
    elif isinstance(geom, Geom_SurfaceOfLinearExtrusion):
        made = _extrusion(geom, u0, u1, v0, v1)
    elif isinstance(geom, Geom_CylindricalSurface | Geom_ConicalSurface):
        made = _turned(geom.Position(), unit_arc(u0, u1), _straight_profile(geom, v0, v1))
    elif isinstance(geom, Geom_SphericalSurface):
        made = _turned(geom.Position(), unit_arc(u0, u1), _round_profile(0.0, geom.Radius(), v0, v1))
    elif isinstance(geom, Geom_ToroidalSurface):
        if abs(v1 - v0 - FULL_TURN) < 1e-7:
            v1 = v0 + FULL_TURN
        profile = _round_profile(geom.MajorRadius(), geom.MinorRadius(), v0, v1)
        made = _turned(geom.Position(), unit_arc(u0, u1), profile)
    elif isinstance(geom, Geom_SurfaceOfRevolution):
        made = _revolution(geom, u0, u1, v0, v1)
    else:
        made = _approximated(geom, u0, u1, v0, v1)
    surface = _closed_up(_closed_up(made.surface, 0), 1) if not made.note else made.surface
    if transformation is not None:
        surface = replace(surface, control_points=transformed(surface.control_points, transformation))
    return replace(made, surface=surface)


def _closed_up(surface: BSplineSurface, axis: int) -> BSplineSurface:
    """Make a direction periodic whose first and last control points are the same, so that its seam cannot open.

    It is also what the kernel makes of a closed surface when it reads one from STEP.
    """
    degree = (surface.degree_u, surface.degree_v)[axis]
    net = np.moveaxis(surface.control_points, axis, 0)
    weights = None if surface.weights is None else np.moveaxis(surface.weights, axis, 0)
    count = len(net) - 1
    gap = float(np.abs(net[0] - net[-1]).max())
    if count < 2 or gap > 1e-14 * surface.size or (weights is not None and (weights[0] != weights[-1]).any()):
        return surface
    values, counts = knots_and_multiplicities((surface.knots_u, surface.knots_v)[axis])
    counts[[0, -1]] = degree
    knots, _ = unrolled_knots(values, counts, degree, True)
    rows = np.arange(count + degree) % count
    closed = replace(
        surface,
        control_points=np.moveaxis(net[rows], 0, axis),
        weights=None if weights is None else np.moveaxis(weights[rows], 0, axis),
    )
    if axis == 0:
        return replace(closed, knots_u=knots, periodic_u=True)
    return replace(closed, knots_v=knots, periodic_v=True)


def _vector(item: gp_Pnt | gp_Vec | gp_Dir) -> Array:
    return np.array([item.X(), item.Y(), item.Z()])


def _plane(geom: Geom_Plane, u0: float, u1: float, v0: float, v1: float) -> Conversion:
    frame = geom.Position()
    origin, x, y = map(_vector, (frame.Location(), frame.XDirection(), frame.YDirection()))
    net = np.array([[origin + u * x + v * y for v in (v0, v1)] for u in (u0, u1)])
    return Conversion(BSplineSurface(net, np.array([u0, u0, u1, u1]), np.array([v0, v0, v1, v1]), 1, 1))


def _extrusion(geom: Geom_SurfaceOfLinearExtrusion, u0: float, u1: float, v0: float, v1: float) -> Conversion:
    curve = _spline(geom.BasisCurve(), u0, u1)
    direction = _vector(geom.Direction())
    net = np.stack([curve.poles + v0 * direction, curve.poles + v1 * direction], axis=1)
    weights = np.column_stack([curve.weights, curve.weights])
    surface = BSplineSurface(
        net, curve.knots, np.array([v0, v0, v1, v1]), curve.degree, 1, None if (weights == 1).all() else weights
    )
    return Conversion(surface, map_u=curve.parameter, note=curve.note)


def _straight_profile(geom: Geom_CylindricalSurface | Geom_ConicalSurface, v0: float, v1: float) -> _Spline:
    """A line (radius, 0, height)."""
    if isinstance(geom, Geom_CylindricalSurface):
        radius, outward, upward = geom.Radius(), 0.0, 1.0
    else:
        radius, outward, upward = geom.RefRadius(), np.sin(geom.SemiAngle()), np.cos(geom.SemiAngle())
    poles = np.array([[radius + v * outward, 0.0, v * upward] for v in (v0, v1)])
    return _Spline(poles, np.ones(2), np.array([v0, v0, v1, v1]), 1)


def _round_profile(major: float, radius: float, v0: float, v1: float) -> _Spline:
    """An arc (major + radius cos v, 0, radius sin v)."""
    arc = unit_arc(v0, v1)
    poles = np.zeros((len(arc.points), 3))
    poles[:, 0] = major + radius * arc.points[:, 0]
    poles[:, 2] = radius * arc.points[:, 1]
    return _Spline(poles, arc.weights, arc.knots, 2, arc.parameter)


def _turned(frame: gp_Ax3, arc: UnitArc, profile: _Spline) -> Conversion:
    """A profile (x, y, z) in a frame turned about its z axis through an arc; u is the angle, v runs along the profile."""
    cosine, sine = arc.points[:, 0, None], arc.points[:, 1, None]
    x, y, z = profile.poles.T
    along_x, along_y = x * cosine - y * sine, x * sine + y * cosine
    origin, ex, ey, ez = map(_vector, (frame.Location(), frame.XDirection(), frame.YDirection(), frame.Direction()))
    net = origin + along_x[..., None] * ex + along_y[..., None] * ey + (z + 0.0 * cosine)[..., None] * ez
    surface = BSplineSurface(
        net, arc.knots, profile.knots, 2, profile.degree, arc.weights[:, None] * profile.weights[None, :]
    )
    return Conversion(surface, arc.parameter, profile.parameter, profile.note)


def _revolution(geom: Geom_SurfaceOfRevolution, u0: float, u1: float, v0: float, v1: float) -> Conversion:
    axis = geom.Axis()
    frame = gp_Ax3(axis.Location(), axis.Direction())
    origin, ex, ey, ez = map(_vector, (frame.Location(), frame.XDirection(), frame.YDirection(), frame.Direction()))
    profile = _spline(geom.BasisCurve(), v0, v1)
    local = (profile.poles - origin) @ np.column_stack([ex, ey, ez])
    local[np.hypot(local[:, 0], local[:, 1]) < 1e-12 * max(1.0, float(np.abs(local).max())), :2] = 0.0
    return _turned(frame, unit_arc(u0, u1), replace(profile, poles=local))


def _spline(curve: Geom_Curve, first: float, last: float) -> _Spline:
    """The part [first, last] of a curve as a B-spline."""
    while isinstance(curve, Geom_TrimmedCurve):
        curve = curve.BasisCurve()
    if isinstance(curve, Geom_Line):
        ends = np.array([_vector(curve.Value(t)) for t in (first, last)])
        return _Spline(ends, np.ones(2), np.array([first, first, last, last]), 1)
    if isinstance(curve, Geom_Circle | Geom_Ellipse):
        if abs(last - first - FULL_TURN) < 1e-7:
            last = first + FULL_TURN
        arc = unit_arc(first, last)
        round_curve = isinstance(curve, Geom_Circle)
        a, b = (curve.Radius(), curve.Radius()) if round_curve else (curve.MajorRadius(), curve.MinorRadius())
        frame = curve.Position()
        x, y = _vector(frame.XDirection()), _vector(frame.YDirection())
        poles = _vector(frame.Location()) + a * arc.points[:, :1] * x + b * arc.points[:, 1:] * y
        return _Spline(poles, arc.weights, arc.knots, 2, arc.parameter)
    if isinstance(curve, Geom_BSplineCurve | Geom_BezierCurve | Geom_Parabola):
        if isinstance(curve, Geom_BezierCurve):
            curve = GeomConvert.CurveToBSplineCurve_s(curve)
        inside = isinstance(curve, Geom_BSplineCurve) and not curve.IsPeriodic()
        whole = inside and first <= curve.FirstParameter() + 1e-12 and last >= curve.LastParameter() - 1e-12
        spline = GeomConvert.CurveToBSplineCurve_s(curve if whole else Geom_TrimmedCurve(curve, first, last))
        if spline.IsPeriodic():
            spline.SetNotPeriodic()
        knots = np.repeat(from_reals(spline.Knots()), from_integers(spline.Multiplicities()))
        weights = np.array([spline.Weight(i) for i in range(1, spline.NbPoles() + 1)])
        return _Spline(from_points(spline.Poles()), weights, knots, spline.Degree())
    return _fitted(curve, first, last)


def _fitted(curve: Geom_Curve, first: float, last: float) -> _Spline:
    """A curve that no B-spline equals (hyperbola, offset), approximated at its own parameter."""
    nudge = 1e-11 * (last - first)

    def evaluate(t: Array, side: int) -> Array:
        out = np.empty((len(t), 3, 3))
        p, d1, d2 = gp_Pnt(), gp_Vec(), gp_Vec()
        for i, place in enumerate(np.clip(t + side * nudge, first, last).tolist()):
            curve.D2(place, p, d1, d2)
            out[i] = _vector(p), _vector(d1), _vector(d2)
        return out

    poles, knots, worst = fit_curve(evaluate, np.linspace(first, last, 5), 0.1 * APPROXIMATION)
    return _Spline(poles, np.ones(len(poles)), knots, 5, None, f"its curve is approximated within {worst:.1g} mm")


def _approximated(geom: Geom_Surface, u0: float, u1: float, v0: float, v1: float) -> Conversion:
    """An offset surface, or any other that no B-spline equals, at its own parameters."""
    window = Geom_RectangularTrimmedSurface(geom, u0, u1, v0, v1)
    c1 = GeomAbs_Shape.GeomAbs_C1
    for tolerance in (APPROXIMATION, 1e-5, 1e-4, 1e-3):
        fit = GeomConvert_ApproxSurface(window, tolerance, c1, c1, 14, 14, 400, 1)
        if fit.HasResult() and fit.MaxError() <= 10 * tolerance:
            note = f"approximated by a B-spline within {max(fit.MaxError(), 1e-12):.1g} mm"
            return Conversion(surface_of_geom(fit.Surface()), note=note)
    raise GeometryError("no B-spline comes within 0.001 mm of the surface", mend="convert it in the CAD system")
