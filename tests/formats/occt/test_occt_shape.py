"""B-spline surfaces to the CAD kernel and back, and faces made of them, against the kernel's evaluation and checker."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from math import pi

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("OCP")

from OCP.BRep import BRep_Tool
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.Geom import (
    Geom_CylindricalSurface,
    Geom_RectangularTrimmedSurface,
    Geom_SphericalSurface,
    Geom_ToroidalSurface,
)
from OCP.Geom2d import Geom2d_Circle, Geom2d_Line
from OCP.GeomConvert import GeomConvert
from OCP.gp import gp_Ax2d, gp_Ax3, gp_Dir2d, gp_Pnt2d
from OCP.GProp import GProp_GProps
from OCP.TopAbs import TopAbs_Orientation

from cadsculpt.errors import GeometryError
from cadsculpt.formats.area import trimmed_area
from cadsculpt.formats.occt.arrays import from_point_grid, integers, reals
from cadsculpt.formats.occt.curve import curve_on_surface, sample_curve, sample_surface, sample_trim
from cadsculpt.formats.occt.quiet import quiet
from cadsculpt.formats.occt.shape import geom_of_surface, shape_of_surface, surface_of_geom
from cadsculpt.formats.occt.tolerance import edge_gap, edges_of, vertex_gaps
from cadsculpt.formats.occt.trim import reversed_trim, trim_of_geom
from cadsculpt.spline.refine import insert_knots
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

Array = NDArray[np.float64]
TURN = 2 * pi


def patch(degree_u: int, degree_v: int, *, rational: bool = False, seed: int = 0) -> BSplineSurface:
    """A wavy patch over odd parameter ranges, with a double knot."""
    rng = np.random.default_rng(seed)

    def knots(degree: int) -> Array:
        inner = [1.5, 2.0, 2.0, 2.75] if degree > 1 else [1.5, 2.0, 2.75]
        return np.array([-1.0] * (degree + 1) + inner + [4.0] * (degree + 1))

    ku, kv = knots(degree_u), knots(degree_v)
    r, s = len(ku) - degree_u - 1, len(kv) - degree_v - 1
    x, y = np.meshgrid(np.arange(r, dtype=float), np.arange(s, dtype=float), indexing="ij")
    net = 10 * np.stack([x, y, rng.random((r, s))], axis=2)
    return BSplineSurface(net, ku, kv, degree_u, degree_v, weights=0.5 + rng.random((r, s)) if rational else None)


def periodic(kind: str) -> BSplineSurface:
    """A closed surface as the kernel makes it: periodic, with double knots at the seam."""
    frame = gp_Ax3()
    geom = {
        "torus": Geom_ToroidalSurface(frame, 3, 1),
        "tube": Geom_RectangularTrimmedSurface(Geom_CylindricalSurface(frame, 3), 0.0, 1.0, False),
        "ball": Geom_SphericalSurface(frame, 3),
    }[kind]
    return surface_of_geom(GeomConvert.SurfaceToBSplineSurface_s(geom))


def rectangle(surface: BSplineSurface, share: float = 0.0) -> TrimLoop:
    (a, b), (c, d) = surface.domain
    du, dv = share * (b - a), share * (d - c)
    corners = np.array([(a + du, c + dv), (b - du, c + dv), (b - du, d - dv), (a + du, d - dv)])
    knots = np.array([0.0, 0, 1, 1])
    return TrimLoop(tuple(TrimCurve(corners[[i, (i + 1) % 4]], knots, 1) for i in range(4)))


def area_of(face: object) -> float:
    properties = GProp_GProps()
    BRepGProp.SurfaceProperties_s(face, properties, 1e-8)
    return abs(float(properties.Mass()))


@pytest.mark.parametrize("degree", range(1, 12))
@pytest.mark.parametrize("rational", [False, True])
def test_the_kernel_evaluates_what_we_evaluate(degree, rational):
    surface = patch(degree, 12 - degree, rational=rational)
    geom = geom_of_surface(surface)
    rng = np.random.default_rng(3)
    u, v = rng.uniform(-1, 4, (2, 200))
    truth = sample_surface(geom, np.column_stack([u, v]))
    np.testing.assert_allclose(surface.evaluate(u, v), truth, atol=1e-12 * surface.size)
    back = surface_of_geom(geom)
    for name in ("control_points", "knots_u", "knots_v"):
        np.testing.assert_array_equal(getattr(back, name), getattr(surface, name))
    if rational:
        np.testing.assert_allclose(back.weights, surface.weights, rtol=1e-15)


@pytest.mark.parametrize("kind", ["torus", "tube", "ball"])
@pytest.mark.parametrize("refined", [False, True])
def test_periodic_surfaces_unroll_and_roll_up(kind, refined):
    geom = geom_of_surface(periodic(kind))
    assert geom.IsUPeriodic()
    if refined:
        geom.InsertUKnots(reals(np.array([0.3, 1.7, 5.0])), integers(np.array([1, 1, 2])))
    surface = surface_of_geom(geom)
    surface.validate()
    p = surface.degree_u
    assert surface.periodic_u
    np.testing.assert_array_equal(surface.control_points[-p:], surface.control_points[:p])
    (a, b), (c, d) = surface.domain
    u, v = np.random.default_rng(0).uniform([a, c], [b, d], (300, 2)).T
    np.testing.assert_allclose(surface.evaluate(u, v), sample_surface(geom, np.column_stack([u, v])), atol=1e-14)
    again = geom_of_surface(surface)
    assert again.IsUPeriodic()
    np.testing.assert_array_equal(from_point_grid(again.Poles()), from_point_grid(geom.Poles()))
    assert list(again.UMultiplicities()) == list(geom.UMultiplicities())


@pytest.mark.parametrize("start", [1.0, 2.1, 5.0, TURN, 8.0, -1.0])
def test_a_periodic_domain_may_begin_at_any_knot(start):
    geom = geom_of_surface(periodic("torus"))
    surface = surface_of_geom(geom, start=(start, None))
    surface.validate()
    a, b = surface.domain[0]
    assert a <= start + 1e-9 < b
    assert b - a == pytest.approx(TURN)
    u, v = np.random.default_rng(0).uniform([a, 0], [b, TURN], (200, 2)).T
    np.testing.assert_allclose(surface.evaluate(u, v), sample_surface(geom, np.column_stack([u, v])), atol=1e-13)


def test_a_refined_periodic_surface_is_taken_by_the_kernel():
    surface = insert_knots(periodic("torus"), [1.0, 3.0], [0.5])
    geom = geom_of_surface(surface)
    u, v = np.random.default_rng(0).uniform(0, TURN, (2, 200))
    np.testing.assert_allclose(surface.evaluate(u, v), sample_surface(geom, np.column_stack([u, v])), atol=1e-13)


def test_unclamped_knots_pass_through():
    net = patch(3, 3).control_points
    knots_u, knots_v = np.arange(net.shape[0] + 4.0), np.linspace(0, 1, net.shape[1] + 4)
    surface = BSplineSurface(net, knots_u, knots_v, 3, 3)
    back = surface_of_geom(geom_of_surface(surface))
    np.testing.assert_array_equal(back.knots_u, surface.knots_u)
    np.testing.assert_array_equal(back.control_points, surface.control_points)


def test_what_the_kernel_cannot_hold_is_one_clear_error():
    knots = np.concatenate([np.zeros(28), np.ones(28)])
    net = np.stack([*np.meshgrid(np.arange(28.0), np.arange(28.0), indexing="ij"), np.zeros((28, 28))], axis=2)
    with pytest.raises(GeometryError, match="kernel refuses"):
        geom_of_surface(BSplineSurface(net, knots, knots, 27, 27))


@pytest.mark.parametrize("outward", [True, False])
@pytest.mark.parametrize("trims", ["none", "border", "inside with a hole"])
def test_faces_are_valid_and_have_the_area(outward, trims):
    surface = patch(3, 2, rational=True)
    if trims == "border":
        surface = replace(surface, trims=(rectangle(surface),))
    elif trims != "none":
        hole = trim_of_geom(Geom2d_Circle(gp_Ax2d(gp_Pnt2d(1.5, 1.5), gp_Dir2d(1, 0)), 0.8), 0.0, TURN)
        # anticlockwise, as a hole should not run: it is turned
        surface = replace(surface, trims=(rectangle(surface, 0.1), TrimLoop((hole,), False)))
    face = shape_of_surface(replace(surface, outward=outward))
    assert BRepCheck_Analyzer(face).IsValid()
    assert (face.Orientation() == TopAbs_Orientation.TopAbs_FORWARD) == outward
    assert area_of(face) == pytest.approx(trimmed_area(surface), rel=1e-5)
    for edge in edges_of(face):
        assert edge_gap(edge) <= BRep_Tool.Tolerance_s(edge) <= 1.01e-7
        assert all(gap <= tolerance for gap, tolerance in vertex_gaps(edge))


@pytest.mark.parametrize("kind", ["torus", "tube", "ball"])
@pytest.mark.parametrize("trimmed", [False, True])
@pytest.mark.parametrize("rolled", [False, True])
def test_closed_surfaces_get_seams_and_poles(kind, trimmed, rolled):
    geom = geom_of_surface(periodic(kind))
    if not rolled:
        geom.SetUNotPeriodic()
        geom.SetVNotPeriodic()
    surface = surface_of_geom(geom)
    face = shape_of_surface(replace(surface, trims=(rectangle(surface),) if trimmed else None))
    assert BRepCheck_Analyzer(face).IsValid()
    assert any(BRep_Tool.IsClosed_s(edge, face) for edge in edges_of(face))
    exact = {"torus": 12 * pi**2, "tube": TURN * 3, "ball": 36 * pi}[kind]
    assert trimmed_area(surface) == pytest.approx(exact, rel=1e-10)
    assert area_of(face) == pytest.approx(exact, rel=1e-6)


def test_edges_run_on_their_surface_at_the_trims_pace():
    surface = patch(3, 3, rational=True)
    geom = geom_of_surface(surface)
    for curve, first, last, exact in (
        (Geom2d_Line(gp_Pnt2d(1.0, -1.0), gp_Dir2d(0, 1)), 0.0, 5.0, True),
        (Geom2d_Line(gp_Pnt2d(1.0, 4.0), gp_Dir2d(0, -1)), 0.2, 5.0, True),
        (Geom2d_Line(gp_Pnt2d(-1.0, -1.0), gp_Dir2d(1, 1)), 0.0, 7.0, False),
        (Geom2d_Circle(gp_Ax2d(gp_Pnt2d(1.5, 1.5), gp_Dir2d(1, 0)), 2.0), 0.0, TURN, False),
    ):
        made, worst = curve_on_surface(geom, curve, first, last, 2e-8)
        t = np.linspace(first, last, 999)
        truth = surface.evaluate(*sample_trim(curve, t).T)
        gap = np.linalg.norm(sample_curve(made, t) - truth, axis=1).max()
        assert gap <= (1e-12 * surface.size if exact else 2.2e-8)
        assert worst <= 2e-8


def test_reversed_trims_run_backwards():
    trim = TrimCurve(np.array([[0.0, 0], [1, 2], [3, 1]]), np.array([2.0, 2, 2, 5, 5, 5]), 2, np.array([1.0, 2, 1]))
    back = reversed_trim(reversed_trim(trim))
    np.testing.assert_array_equal(back.control_points, trim.control_points)
    np.testing.assert_allclose(back.knots, trim.knots)


def test_quiet_reaches_what_python_cannot(tmp_path):
    """Text written to the descriptor itself, as the kernel does, stays off; what comes before and after goes through."""
    script = (
        "import os\n"
        "from cadsculpt.formats.occt.quiet import quiet\n"
        "print('before')\n"
        "with quiet():\n"
        "    os.write(1, b'noise'); os.write(2, b'noise'); print('noise')\n"
        "    with quiet():\n"
        "        os.write(1, b'noise')\n"
        "    os.write(1, b'noise')\n"
        "print('after')\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, env=os.environ)
    assert done.stdout.split() == ["before", "after"]
    assert "noise" not in done.stderr


def test_quiet_gives_the_descriptors_back_after_an_error():
    before = os.fstat(1)
    with pytest.raises(ValueError, match="x"), quiet():
        raise ValueError("x")
    assert (os.fstat(1).st_dev, os.fstat(1).st_ino) == (before.st_dev, before.st_ino)
