"""Trim curves of faces to OCCT's 2D curves and back."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from OCP.Geom2d import Geom2d_BSplineCurve, Geom2d_Curve, Geom2d_Line, Geom2d_TrimmedCurve
from OCP.Geom2dConvert import Geom2dConvert

from ...spline.matrices import design_matrix
from ...spline.surface import TrimCurve, TrimLoop
from ..arcs import ArcParameter
from ..curve_fit import fit_curve
from .arrays import from_integers, from_points_2d, from_reals, integers, knots_and_multiplicities, points_2d, reals
from .curve import sample_trim, smooth_breaks, trim_derivatives

Array = NDArray[np.float64]


def trim_of_geom(curve: Geom2d_Curve, first: float, last: float, *, backward: bool = False) -> TrimCurve:
    """The part [first, last] of a 2D curve as a trim curve, run the other way when `backward`."""
    if isinstance(curve, Geom2d_Line):
        ends = [curve.Value(first), curve.Value(last)]
        poles = np.array([(p.X(), p.Y()) for p in ends])
        trim = TrimCurve(poles, np.array([first, first, last, last]), 1)
    else:
        spline = Geom2dConvert.CurveToBSplineCurve_s(Geom2d_TrimmedCurve(curve, first, last))
        if spline.IsPeriodic():
            spline.SetNotPeriodic()
        weights = None
        if spline.IsRational():
            weights = np.array([spline.Weight(i) for i in range(1, spline.NbPoles() + 1)])
        trim = TrimCurve(
            from_points_2d(spline.Poles()),
            np.repeat(from_reals(spline.Knots()), from_integers(spline.Multiplicities())),
            spline.Degree(),
            weights,
        )
    return reversed_trim(trim) if backward else trim


def reversed_trim(trim: TrimCurve) -> TrimCurve:
    """The same curve run the other way over the same parameter range."""
    knots = (trim.knots[0] + trim.knots[-1]) - trim.knots[::-1]
    return TrimCurve(
        np.ascontiguousarray(trim.control_points[::-1]),
        np.ascontiguousarray(knots),
        trim.degree,
        None if trim.weights is None else np.ascontiguousarray(trim.weights[::-1]),
    )


def geom_of_trim(trim: TrimCurve) -> Geom2d_BSplineCurve:
    """The Geom2d_BSplineCurve equal to a trim curve."""
    values, counts = knots_and_multiplicities(trim.knots)
    arguments: list[Any] = [points_2d(trim.control_points)]
    if trim.weights is not None:
        arguments.append(reals(trim.weights))
    return Geom2d_BSplineCurve(*arguments, reals(values), integers(counts), trim.degree)


def trim_domain(trim: TrimCurve) -> tuple[float, float]:
    """The parameter range of a trim curve."""
    return float(trim.knots[trim.degree]), float(trim.knots[-trim.degree - 1])


def moved_trim(trim: TrimCurve, shift: tuple[float, float]) -> TrimCurve:
    """The same curve, moved in the (u, v) plane."""
    return replace(trim, control_points=trim.control_points + np.array(shift))


def evaluate_trim(trim: TrimCurve, parameters: Array) -> Array:
    """(n, 2) points of a trim curve."""
    basis = design_matrix(trim.knots, trim.degree, parameters)
    if trim.weights is None:
        return basis @ trim.control_points
    homogeneous = basis @ np.column_stack([trim.control_points * trim.weights[:, None], trim.weights])
    return homogeneous[:, :2] / homogeneous[:, 2:]


def signed_area(loop: TrimLoop) -> float:
    """Area enclosed in the (u, v) plane: positive when the loop runs anticlockwise."""
    pieces = [evaluate_trim(curve, np.linspace(*trim_domain(curve), 17)[:-1]) for curve in loop.curves]
    u, v = np.concatenate(pieces).T
    return float(0.5 * np.sum(u * np.roll(v, -1) - np.roll(u, -1) * v))


def reversed_loop(loop: TrimLoop) -> TrimLoop:
    """The same loop run the other way."""
    return replace(loop, curves=tuple(reversed_trim(curve) for curve in reversed(loop.curves)))


def carried_trim(
    curve: Geom2d_Curve,
    first: float,
    last: float,
    map_u: ArcParameter | None,
    map_v: ArcParameter | None,
    scale: tuple[float, float],
    tolerance: float,
) -> TrimCurve:
    """A 2D curve over [first, last], carried to other surface parameters and still running at its own pace.

    scale: length on the surface, mm, of one unit of u and of v; `tolerance` is a length, mm.
    """
    ends = sample_trim(curve, np.array([first, 0.5 * (first + last), last]))
    moves_u, moves_v = np.abs(ends - ends[0]).max(axis=0) > 0.0
    if isinstance(curve, Geom2d_Line) and (map_u is None or not moves_u) and (map_v is None or not moves_v):
        poles = _carried(ends[[0, 2]], map_u, map_v)
        return TrimCurve(poles, np.array([first, first, last, last]), 1)
    breaks = smooth_breaks(curve, first, last)
    for axis, parameter in enumerate((map_u, map_v)):
        if parameter is not None:
            breaks = np.union1d(breaks, _crossings(curve, breaks, axis, parameter.angles))
    stretch = np.maximum(np.array(scale), 1e-12)
    nudge = 1e-11 * (last - first)

    def evaluate(t: Array, side: int) -> Array:
        data = trim_derivatives(curve, np.clip(t + side * nudge, first, last))
        data[:, 0] = sample_trim(curve, t)
        for axis, parameter in enumerate((map_u, map_v)):
            if parameter is not None:
                rates = parameter(data[:, 0, axis] + side * nudge * data[:, 1, axis])
                one, two = data[:, 1, axis].copy(), data[:, 2, axis].copy()
                data[:, 0, axis] = parameter(data[:, 0, axis])[:, 0]
                data[:, 1, axis] = rates[:, 1] * one
                data[:, 2, axis] = rates[:, 2] * one * one + rates[:, 1] * two
        return np.asarray(data * stretch, dtype=np.float64)

    poles, knots, _ = fit_curve(evaluate, breaks, tolerance)
    return TrimCurve(poles / stretch, knots, 5)


def _carried(uv: Array, map_u: ArcParameter | None, map_v: ArcParameter | None) -> Array:
    """Points (n, 2) in the other parameters."""
    out = uv.copy()
    for axis, parameter in enumerate((map_u, map_v)):
        if parameter is not None:
            out[:, axis] = parameter(uv[:, axis])[:, 0]
    return out


def _crossings(curve: Geom2d_Curve, breaks: Array, axis: int, values: Array) -> list[float]:
    """Parameters where one coordinate of a 2D curve passes one of `values`, by bisection between samples."""
    t = np.unique(np.concatenate([np.linspace(a, b, 9) for a, b in pairwise(breaks)]))
    x = sample_trim(curve, t)[:, axis]
    found = []
    for value in values.tolist():
        for i in np.flatnonzero((x[:-1] - value) * (x[1:] - value) < 0):
            low, high, sign = float(t[i]), float(t[i + 1]), float(np.sign(x[i] - value))
            for _ in range(60):
                middle = 0.5 * (low + high)
                if sign * (float(sample_trim(curve, np.array([middle]))[0, axis]) - value) > 0:
                    low = middle
                else:
                    high = middle
            found.append(0.5 * (low + high))
    return found
