"""3D curves of trim curves on a surface, at the trim curve's own parameter (what OCCT calls "same parameter")."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from OCP.Geom import Geom_BSplineCurve, Geom_BSplineSurface, Geom_Curve, Geom_Surface, Geom_TrimmedCurve
from OCP.Geom2d import Geom2d_BezierCurve, Geom2d_BSplineCurve, Geom2d_Curve, Geom2d_Line, Geom2d_TrimmedCurve
from OCP.GeomAdaptor import GeomAdaptor_Surface
from OCP.GeomConvert import GeomConvert
from OCP.gp import gp_Pnt, gp_Pnt2d, gp_Vec, gp_Vec2d

from ..curve_fit import Curve, fit_curve
from .arrays import from_integers, from_points, from_reals, integers, knots_and_multiplicities, points, reals

Array = NDArray[np.float64]

_NUDGE = 1e-11
"""Derivatives at a break are taken this fraction of the range to one side of it."""


def basis_of_curve(curve: Geom2d_Curve) -> Geom2d_Curve:
    """The curve behind any trimming."""
    while isinstance(curve, Geom2d_TrimmedCurve):
        curve = curve.BasisCurve()
    return curve


def sample_trim(curve: Geom2d_Curve, parameters: Array) -> Array:
    """(n, 2) points of a 2D curve."""
    out = np.empty((len(parameters), 2))
    p = gp_Pnt2d()
    for i, t in enumerate(parameters.tolist()):
        curve.D0(t, p)
        out[i] = p.X(), p.Y()
    return out


def sample_surface(geom: Geom_Surface, uv: Array) -> Array:
    """(n, 3) points of a surface, in its own frame."""
    out = np.empty((len(uv), 3))
    p = gp_Pnt()
    for i, (u, v) in enumerate(uv.tolist()):
        geom.D0(u, v, p)
        out[i] = p.X(), p.Y(), p.Z()
    return out


def sample_curve(curve: Geom_Curve, parameters: Array) -> Array:
    """(n, 3) points of a curve, in its own frame."""
    out = np.empty((len(parameters), 3))
    p = gp_Pnt()
    for i, t in enumerate(parameters.tolist()):
        curve.D0(t, p)
        out[i] = p.X(), p.Y(), p.Z()
    return out


def smooth_breaks(curve: Geom2d_Curve, first: float, last: float) -> Array:
    """first, last and the knots between them: where a 2D curve may have a jump in a derivative."""
    basis = basis_of_curve(curve)
    inner: list[float] = []
    if isinstance(basis, Geom2d_BSplineCurve):
        knots = from_reals(basis.Knots())
        inner = [float(k) for k in knots if first < k < last]
        if basis.IsPeriodic():
            period = knots[-1] - knots[0]
            inner = [float(k + i * period) for i in range(-2, 3) for k in knots if first < k + i * period < last]
    return np.unique(np.array([first, *inner, last]))


def trim_derivatives(curve: Geom2d_Curve, parameters: Array) -> Array:
    """(n, 3, 2): value, first and second derivative of a 2D curve."""
    out = np.empty((len(parameters), 3, 2))
    p, d1, d2 = gp_Pnt2d(), gp_Vec2d(), gp_Vec2d()
    for i, t in enumerate(parameters.tolist()):
        curve.D2(t, p, d1, d2)
        out[i] = (p.X(), p.Y()), (d1.X(), d1.Y()), (d2.X(), d2.Y())
    return out


def _image(geom: Geom_Surface, curve: Geom2d_Curve, first: float, last: float) -> Curve:
    """The curve t -> S(c(t)) with two derivatives, by the chain rule."""
    surface = GeomAdaptor_Surface(geom)
    nudge = _NUDGE * (last - first)

    def evaluate(t: Array, side: int) -> Array:
        out = np.zeros((len(t), 3, 3))
        out[:, 0] = sample_surface(geom, sample_trim(curve, t))
        if side == 0:
            return out
        trim = trim_derivatives(curve, np.clip(t + side * nudge, first, last))
        p, su, sv, suu, svv, suv = gp_Pnt(), gp_Vec(), gp_Vec(), gp_Vec(), gp_Vec(), gp_Vec()
        for i in range(len(t)):
            (u, v), (du, dv), (ddu, ddv) = trim[i].tolist()
            surface.D2(u, v, p, su, sv, suu, svv, suv)
            s_u, s_v = np.array([su.X(), su.Y(), su.Z()]), np.array([sv.X(), sv.Y(), sv.Z()])
            s_uu, s_vv = np.array([suu.X(), suu.Y(), suu.Z()]), np.array([svv.X(), svv.Y(), svv.Z()])
            s_uv = np.array([suv.X(), suv.Y(), suv.Z()])
            out[i, 1] = s_u * du + s_v * dv
            out[i, 2] = s_uu * du * du + 2 * s_uv * du * dv + s_vv * dv * dv + s_u * ddu + s_v * ddv
        return out

    return evaluate


def _isoline(curve: Geom2d_Curve) -> tuple[str, float, float, float] | None:
    """("u" or "v" held, its value, offset, rate) when the other parameter is offset + rate t along the whole curve."""
    basis = basis_of_curve(curve)
    if isinstance(basis, Geom2d_Line):
        p, d = basis.Location(), basis.Direction()
        line = (p.X(), p.Y(), d.X(), d.Y())
    elif isinstance(basis, Geom2d_BezierCurve | Geom2d_BSplineCurve) and basis.Degree() == 1 and basis.NbPoles() == 2:
        if basis.IsRational() or (isinstance(basis, Geom2d_BSplineCurve) and basis.IsPeriodic()):
            return None
        a, b = basis.Pole(1), basis.Pole(2)
        t0, t1 = basis.FirstParameter(), basis.LastParameter()
        du, dv = (b.X() - a.X()) / (t1 - t0), (b.Y() - a.Y()) / (t1 - t0)
        line = (a.X() - du * t0, a.Y() - dv * t0, du, dv)
    else:
        return None
    u, v, du, dv = line
    if du == 0.0 and dv != 0.0:
        return "u", u, v, dv
    if dv == 0.0 and du != 0.0:
        return "v", v, u, du
    return None


def _iso_curve(geom: Geom_BSplineSurface, held: str, value: float, offset: float, rate: float) -> Geom_Curve | None:
    """The iso-parametric curve of a B-spline surface with its parameter mapped to t = (parameter - offset) / rate."""
    iso = geom.UIso(value) if held == "u" else geom.VIso(value)
    if not isinstance(iso, Geom_BSplineCurve):
        return None
    iso = iso.Copy()
    if rate < 0:
        ends = iso.FirstParameter() + iso.LastParameter()
        iso.Reverse()  # the parameter becomes ends - parameter
        offset, rate = ends - offset, -rate
    iso.SetKnots(reals((from_reals(iso.Knots()) - offset) / rate))
    return iso


def curve_on_surface(
    geom: Geom_Surface, curve: Geom2d_Curve, first: float, last: float, tolerance: float
) -> tuple[Geom_Curve, float]:
    """The 3D curve of `curve` over [first, last] on `geom`, in the surface's frame, and its largest distance from it.

    Isoparametric lines of a B-spline surface come out exactly; all else within `tolerance` where floating point allows.
    """
    iso = _isoline(curve) if isinstance(geom, Geom_BSplineSurface) else None
    if iso is not None:
        result = _iso_curve(geom, *iso)
        if result is not None:
            t = np.linspace(first, last, 33)
            gap = np.linalg.norm(sample_curve(result, t) - sample_surface(geom, sample_trim(curve, t)), axis=1).max()
            if gap <= tolerance:
                return result, float(gap)
    poles, knots, worst = fit_curve(_image(geom, curve, first, last), smooth_breaks(curve, first, last), tolerance)
    values, counts = knots_and_multiplicities(knots)
    return Geom_BSplineCurve(points(poles), reals(values), integers(counts), 5), worst


def curve_net(curve: Geom_BSplineCurve) -> tuple[Array, Array]:
    """(poles (n, 3), flat knots) of a B-spline curve."""
    return from_points(curve.Poles()), np.repeat(from_reals(curve.Knots()), from_integers(curve.Multiplicities()))


def spline_arrays(curve: Geom_Curve, first: float, last: float) -> tuple[Array, Array, int, Array | None]:
    """Control points (n, 3), flat knots, degree and weights or None of the part [first, last] of a curve."""
    spline = GeomConvert.CurveToBSplineCurve_s(Geom_TrimmedCurve(curve, first, last))
    if spline.IsPeriodic():
        spline.SetNotPeriodic()
    points = np.array([(p.X(), p.Y(), p.Z()) for p in (spline.Pole(i) for i in range(1, spline.NbPoles() + 1))])
    weights = None
    if spline.IsRational():
        weights = np.array([spline.Weight(i) for i in range(1, spline.NbPoles() + 1)])
    knots = np.repeat(from_reals(spline.Knots()), from_integers(spline.Multiplicities()))
    return points, knots, spline.Degree(), weights
