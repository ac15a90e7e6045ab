"""Arcs, curve fits, areas and the conversion of analytic surfaces, against closed formulas and the CAD kernel."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

pytest.importorskip("OCP")

from OCP.Geom import (
    Geom_BezierCurve,
    Geom_BSplineCurve,
    Geom_Circle,
    Geom_ConicalSurface,
    Geom_CylindricalSurface,
    Geom_Ellipse,
    Geom_Hyperbola,
    Geom_OffsetSurface,
    Geom_Parabola,
    Geom_Plane,
    Geom_SphericalSurface,
    Geom_SurfaceOfLinearExtrusion,
    Geom_SurfaceOfRevolution,
    Geom_ToroidalSurface,
)
from OCP.Geom2d import Geom2d_Circle, Geom2d_Line
from OCP.gp import gp_Ax1, gp_Ax2, gp_Ax2d, gp_Ax3, gp_Dir, gp_Dir2d, gp_Pnt, gp_Pnt2d, gp_Trsf

from cadsculpt.errors import GeometryError
from cadsculpt.formats.arcs import unit_arc
from cadsculpt.formats.area import trimmed_area
from cadsculpt.formats.curve_fit import fit_curve
from cadsculpt.formats.occt.analytic import convert, kind_of_geom
from cadsculpt.formats.occt.arrays import integers, points, reals
from cadsculpt.formats.occt.curve import sample_surface, sample_trim
from cadsculpt.formats.occt.shape import transformed
from cadsculpt.formats.occt.trim import carried_trim, evaluate_trim, reversed_trim, signed_area, trim_of_geom
from cadsculpt.spline.matrices import design_matrix
from cadsculpt.spline.surface import TrimCurve, TrimLoop

Array = NDArray[np.float64]

FRAME = gp_Ax3(gp_Pnt(1, 2, 3), gp_Dir(1, 2, 2), gp_Dir(0, 1, -1))


def left_handed() -> gp_Ax3:
    frame = gp_Ax3(gp_Pnt(1, 2, 3), gp_Dir(1, 2, 2), gp_Dir(0, 1, -1))
    frame.YReverse()
    return frame


def bezier() -> Geom_BezierCurve:
    return Geom_BezierCurve(points(np.array([[3.0, 0, 0], [4, 1, 0], [3.5, 1.5, 1], [4, 2, 2.0]])))


def spline() -> Geom_BSplineCurve:
    net = np.array([[3.0, 0, 0], [4, 1, 0], [3.5, 1.5, 1], [4, 2, 2.0], [3, 3, 2]])
    return Geom_BSplineCurve(points(net), reals(np.array([2.0, 3.5, 5.0])), integers(np.array([4, 1, 4])), 3)


def axis() -> gp_Ax1:
    return gp_Ax1(gp_Pnt(0, 0, 0), gp_Dir(0, 1, 1))


def conic(kind: type) -> object:
    place = gp_Ax2(gp_Pnt(9, 0, 5), gp_Dir(0, 0, 1))
    return kind(place, 2.0) if kind in (Geom_Circle, Geom_Parabola) else kind(place, 2.0, 1.0)


TURN = 2 * pi
SURFACES = [
    ("plane", Geom_Plane(FRAME), (-3, 2, 1, 7), 1e-14),
    ("cylinder", Geom_CylindricalSurface(FRAME, 3), (0.3, 5, -1, 4), 1e-14),
    ("cylinder", Geom_CylindricalSurface(left_handed(), 3), (0, TURN, -1, 4), 1e-14),
    ("cone", Geom_ConicalSurface(FRAME, 0.3, 2), (1, 3, 1, 4), 1e-14),
    ("sphere", Geom_SphericalSurface(FRAME, 2), (0, TURN, -pi / 2, pi / 2), 1e-14),
    ("torus", Geom_ToroidalSurface(left_handed(), 4, 1), (0, TURN, 1, 1 + TURN), 1e-14),
    ("revolution", Geom_SurfaceOfRevolution(bezier(), axis()), (0, 4, 0.2, 0.9), 1e-14),
    ("revolution", Geom_SurfaceOfRevolution(spline(), axis()), (0, TURN, 2.5, 4.5), 1e-14),
    ("revolution", Geom_SurfaceOfRevolution(conic(Geom_Parabola), axis()), (0, 4, 0.2, 0.9), 1e-14),
    ("revolution", Geom_SurfaceOfRevolution(conic(Geom_Hyperbola), axis()), (0, 4, 0.2, 0.9), 1e-7),
    ("extrusion", Geom_SurfaceOfLinearExtrusion(conic(Geom_Ellipse), gp_Dir(1, 1, 1)), (0, TURN, 0, 5), 1e-14),
    ("extrusion", Geom_SurfaceOfLinearExtrusion(spline(), gp_Dir(1, 1, 1)), (2, 5, -1, 5), 1e-14),
    ("offset", Geom_OffsetSurface(Geom_SurfaceOfLinearExtrusion(bezier(), gp_Dir(1, 1, 1)), 0.2), (0, 1, 0, 5), 2e-6),
]


@pytest.mark.parametrize(
    ("kind", "geom", "bounds", "tolerance"), SURFACES, ids=[f"{k}{i}" for i, (k, *_) in enumerate(SURFACES)]
)
def test_conversion_equals_the_kernel_point_by_point(kind, geom, bounds, tolerance):
    placement = gp_Trsf()
    placement.SetRotation(gp_Ax1(gp_Pnt(1, 1, 1), gp_Dir(1, 1, 0)), 0.7)
    made = convert(geom, bounds, placement)
    made.surface.validate()
    assert kind_of_geom(geom) == kind
    assert bool(made.note) == (tolerance > 1e-10)
    rng = np.random.default_rng(1)
    u, v = rng.uniform(bounds[0], bounds[1], 200), rng.uniform(bounds[2], bounds[3], 200)
    truth = transformed(sample_surface(geom, np.column_stack([u, v])), placement)
    new_u = u if made.map_u is None else made.map_u(u)[:, 0]
    new_v = v if made.map_v is None else made.map_v(v)[:, 0]
    np.testing.assert_allclose(made.surface.evaluate(new_u, new_v), truth, atol=tolerance * np.abs(truth).max())


def test_closed_analytic_surfaces_close_exactly():
    sphere = convert(Geom_SphericalSurface(FRAME, 2), (0, TURN, -pi / 2, pi / 2)).surface
    assert sphere.periodic_u
    assert not sphere.periodic_v
    assert (sphere.control_points[:2] == sphere.control_points[-2:]).all()
    torus = convert(Geom_ToroidalSurface(FRAME, 4, 1), (0, TURN, 1, 1 + TURN)).surface
    assert torus.periodic_u
    assert torus.periodic_v
    assert not convert(Geom_CylindricalSurface(FRAME, 3), (0.3, 5, -1, 4)).surface.periodic_u
    assert (np.ptp(sphere.control_points[:, 0], axis=0) == 0).all()


def test_a_surface_without_bounds_is_refused():
    with pytest.raises(GeometryError, match="not bounded"):
        convert(Geom_Plane(FRAME), (-2e100, 2e100, -1, 1))


@given(st.floats(-7, 7), st.floats(0.01, TURN))
@settings(max_examples=40, deadline=None)
def test_arc_is_the_circle_and_its_parameter_the_angle(start, width):
    arc = unit_arc(start, start + width)
    angle = np.linspace(start, start + width, 101)
    parameter = arc.parameter(angle)
    basis = design_matrix(arc.knots, 2, parameter[:, 0])
    weight = basis @ arc.weights
    circle = (basis @ (arc.points * arc.weights[:, None])) / weight[:, None]
    np.testing.assert_allclose(circle, np.column_stack([np.cos(angle), np.sin(angle)]), atol=1e-13)
    assert (np.diff(parameter[:, 0]) > 0).all()


def test_arc_parameter_derivatives():
    parameter = unit_arc(0.3, 1.4).parameter
    angle, h = np.linspace(0.4, 1.3, 11), 1e-5
    ahead, behind = parameter(angle + h), parameter(angle - h)
    np.testing.assert_allclose(parameter(angle)[:, 1], (ahead[:, 0] - behind[:, 0]) / (2 * h), rtol=1e-8)
    np.testing.assert_allclose(parameter(angle)[:, 2], (ahead[:, 1] - behind[:, 1]) / (2 * h), rtol=1e-6, atol=1e-8)


def test_fit_meets_its_tolerance_and_converges_with_the_sixth_power():
    def helix(t: Array, side: int) -> Array:
        return np.stack(
            [
                np.column_stack([np.cos(t), np.sin(t), t]),
                np.column_stack([-np.sin(t), np.cos(t), np.ones_like(t)]),
                np.column_stack([-np.cos(t), -np.sin(t), np.zeros_like(t)]),
            ],
            axis=1,
        )

    t = np.linspace(0, 10, 1999)
    for tolerance in (1e-4, 1e-7, 1e-10):
        net, knots, worst = fit_curve(helix, np.array([0.0, 10.0]), tolerance)
        gap = np.linalg.norm(design_matrix(knots, 5, t) @ net - helix(t, 0)[:, 0], axis=1).max()
        assert gap <= 1.05 * tolerance
        assert worst <= tolerance
    errors = []
    for pieces in (4, 8):
        net, knots, _ = fit_curve(helix, np.linspace(0, 10, pieces + 1), np.inf)
        errors.append(np.linalg.norm(design_matrix(knots, 5, t) @ net - helix(t, 0)[:, 0], axis=1).max())
    assert errors[0] / errors[1] > 45  # the sixth power would give 64


def rectangle(u0: float, u1: float, v0: float, v1: float, outer: bool = True) -> TrimLoop:
    corners = np.array([(u0, v0), (u1, v0), (u1, v1), (u0, v1)], dtype=float)
    knots = np.array([0.0, 0, 1, 1])
    return TrimLoop(tuple(TrimCurve(corners[[i, (i + 1) % 4]], knots, 1) for i in range(4)), outer)


@pytest.mark.parametrize(
    ("geom", "bounds", "area"),
    [
        (Geom_Plane(FRAME), (-3, 2, 1, 7), 30.0),
        (Geom_CylindricalSurface(FRAME, 3), (0.3, 5, -1, 4), 3 * 4.7 * 5),
        (Geom_SphericalSurface(FRAME, 2), (0, TURN, -pi / 2, pi / 2), 16 * pi),
        (Geom_ToroidalSurface(FRAME, 4, 1), (0, TURN, 1, 1 + TURN), 16 * pi * pi),
        (Geom_ConicalSurface(FRAME, 0.3, 2), (0, TURN, -2 / sin(0.3), 0), 4 * pi / sin(0.3)),
    ],
    ids=["plane", "cylinder", "sphere", "torus", "cone"],
)
def test_area_equals_the_closed_formula_with_and_without_trims(geom, bounds, area):
    surface = convert(geom, bounds).surface
    assert trimmed_area(surface) == pytest.approx(area, rel=1e-12)
    assert trimmed_area(replace(surface, trims=(rectangle(*bounds),))) == pytest.approx(area, rel=1e-12)


def test_area_with_a_round_hole():
    plate = convert(Geom_Plane(FRAME), (-3, 2, 1, 7)).surface
    hole = reversed_trim(trim_of_geom(Geom2d_Circle(gp_Ax2d(gp_Pnt2d(-0.5, 4), gp_Dir2d(1, 0)), 1.5), 0.0, TURN))
    loops = (rectangle(-3, 2, 1, 7), TrimLoop((hole,), False))
    assert signed_area(loops[0]) > 0 > signed_area(loops[1])
    assert trimmed_area(replace(plate, trims=loops)) == pytest.approx(30 - 2.25 * pi, rel=1e-12)


def test_area_of_a_spherical_cap():
    sphere = convert(Geom_SphericalSurface(FRAME, 2), (0, TURN, -pi / 2, pi / 2))
    low = float(sphere.map_v(np.array([0.4]))[0, 0])
    cap = replace(sphere.surface, trims=(rectangle(0, TURN, low, pi / 2),))
    assert trimmed_area(cap) == pytest.approx(2 * pi * 4 * (1 - sin(0.4)), rel=1e-11)


@pytest.mark.parametrize(
    ("curve", "first", "last"),
    [
        (Geom2d_Line(gp_Pnt2d(0.1, 1), gp_Dir2d(2, 1)), 0.0, 6.0),
        (Geom2d_Line(gp_Pnt2d(0.1, 1), gp_Dir2d(1, 0)), 0.0, 6.0),
        (Geom2d_Circle(gp_Ax2d(gp_Pnt2d(3, 3), gp_Dir2d(1, 0)), 2.5), 0.0, TURN),
    ],
    ids=["slanted", "along", "circle"],
)
def test_carried_trims_keep_their_pace(curve, first, last):
    angle = unit_arc(0, TURN).parameter
    trim = carried_trim(curve, first, last, angle, None, (3.0, 1.0), 1e-9)
    t = np.linspace(first, last, 777)
    truth = sample_trim(curve, t)
    truth[:, 0] = angle(truth[:, 0])[:, 0]
    np.testing.assert_allclose(evaluate_trim(trim, t), truth, atol=1e-9)


def test_trims_that_hold_the_angle_stay_straight():
    trim = carried_trim(
        Geom2d_Line(gp_Pnt2d(0.7, 1), gp_Dir2d(0, 1)), 0.0, 2.0, unit_arc(0, TURN).parameter, None, (1.0, 1.0), 1e-9
    )
    assert trim.degree == 1
    assert len(trim.control_points) == 2
    assert trim.control_points[0, 0] == trim.control_points[1, 0]
