"""Sculpted surfaces go back into the kernel's part: valid, neighbours untouched, the same net after writing and reading."""

from __future__ import annotations

from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("OCP")

from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepPrimAPI import (
    BRepPrimAPI_MakeBox,
    BRepPrimAPI_MakeCone,
    BRepPrimAPI_MakeCylinder,
    BRepPrimAPI_MakeSphere,
    BRepPrimAPI_MakeTorus,
)
from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Compound

from cadsculpt.errors import InputError
from cadsculpt.formats import iges, step
from cadsculpt.formats.occt.part import OcctPart, document_of_shapes
from cadsculpt.formats.occt.shape import shape_of_surface
from cadsculpt.formats.occt.tolerance import edge_gap, edges_of
from cadsculpt.spline.refine import insert_knots
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

Array = NDArray[np.float64]


def panel(*, trimmed: bool = True) -> BSplineSurface:
    """A bent panel, 60 x 40 mm, with or without a straight trim inside its domain."""
    knots = np.array([0.0, 0, 0, 0, 1, 2, 3, 3, 3, 3])
    x, y = np.meshgrid(np.linspace(0, 60, 6), np.linspace(0, 40, 6), indexing="ij")
    net = np.stack([x, y, 5 * np.sin(x / 20) + 0.01 * y**2], axis=2)
    corners = np.array([(0.3, 0.4), (2.6, 0.4), (2.6, 2.7), (0.3, 2.7)])
    sides = [TrimCurve(corners[[i, (i + 1) % 4]], np.array([0.0, 0, 1, 1]), 1) for i in range(4)]
    return BSplineSurface(net, knots, knots, 3, 3, trims=(TrimLoop(tuple(sides)),) if trimmed else None)


def finer(surface: BSplineSurface, count: int = 5) -> BSplineSurface:
    """More knots, evenly, in both directions."""
    new = []
    for knots, (low, high) in zip((surface.knots_u, surface.knots_v), surface.domain, strict=True):
        values = low + (high - low) * (np.arange(count) + 0.61) / (count + 0.3)
        new.append([v for v in values if np.abs(knots - v).min() > 1e-6])
    return insert_knots(surface, *new)


def dented(surface: BSplineSurface, depth: float = 0.4) -> BSplineSurface:
    """Inner control points moved; two rows along every border stay, on a periodic direction the repeated rows follow."""
    net = np.array(surface.control_points)
    inner = [
        np.arange(degree, count - degree) if periodic else np.arange(2, count - 2)
        for count, degree, periodic in zip(
            surface.shape,
            (surface.degree_u, surface.degree_v),
            (surface.periodic_u, surface.periodic_v),
            strict=True,
        )
    ]
    net[np.ix_(*inner)] += depth * np.array([0.3, 0.2, -1.0])
    return surface.with_control_points(net)


def solid(kind: str) -> object:
    return {
        "plane": lambda: BRepPrimAPI_MakeBox(30, 20, 10),
        "cylinder": lambda: BRepPrimAPI_MakeCylinder(8, 20),
        "cone": lambda: BRepPrimAPI_MakeCone(8, 4, 20),
        "sphere": lambda: BRepPrimAPI_MakeSphere(10),
        "torus": lambda: BRepPrimAPI_MakeTorus(20, 5),
        "wedge": lambda: BRepPrimAPI_MakeCylinder(8, 20, 2.0),
    }[kind]().Shape()


def sculpt_one(part: OcctPart, kind: str) -> tuple[int, BSplineSurface]:
    face = max((face for face in part.faces if face.kind == kind), key=lambda face: face.area)
    new = dented(finer(face.surface))
    part.sculpt({face.number: new})
    return face.number, new


def reread(part: OcctPart, folder: Path, format: str) -> OcctPart:
    path = folder / ("out.step" if format == "step" else "out.igs")
    part.write(path, format)
    return (step if format == "step" else iges).read(path)


@pytest.mark.parametrize("format", ["step", "iges"])
@pytest.mark.parametrize("kind", ["plane", "cylinder", "cone", "sphere", "torus", "wedge"])
def test_analytic_faces_become_splines_when_sculpted(kind, format, tmp_path):
    part = document_of_shapes([(kind, solid(kind))])
    kinds = [face.kind for face in part.faces]
    areas = [face.area for face in part.faces]
    number, new = sculpt_one(part, "cylinder" if kind == "wedge" else kind)
    assert part.validity().valid, part.validity().faults
    assert part.warnings == []
    again = reread(part, tmp_path, format)
    assert again.validity().valid, again.validity().faults
    assert len(again.faces) == len(kinds)
    np.testing.assert_allclose(again.faces.number(number).surface.control_points, new.control_points, atol=1e-9)
    for n, (was, area) in enumerate(zip(kinds, areas, strict=True), 1):
        face = part.faces.number(n)
        assert face.kind == ("bspline" if n == number else was)
        if n != number:
            assert face.area == area
            assert again.faces.number(n).area == pytest.approx(area, rel=1e-9)


@pytest.mark.parametrize("format", ["step", "iges"])
def test_a_trimmed_spline_face_keeps_its_trims_and_edges_follow(format, tmp_path):
    part = document_of_shapes([("panel", shape_of_surface(panel()))])
    before = part.faces[0].surface
    new = dented(finer(before), 3.0)
    net = np.array(new.control_points)
    net[:, :3] += [0, 0, 1.5]  # the free edge moves as well
    new = new.with_control_points(net)
    part.sculpt({1: new})
    face = part.face(1)
    np.testing.assert_array_equal(face.surface.control_points, new.control_points)
    for old_loop, loop in zip(before.trims, face.surface.trims, strict=True):
        for a, b in zip(old_loop.curves, loop.curves, strict=True):
            np.testing.assert_array_equal(a.control_points, b.control_points)
    for edge in edges_of(face.shape):
        assert edge_gap(edge) <= BRep_Tool.Tolerance_s(edge) <= 2e-7
    for edge in face.edges:
        np.testing.assert_allclose(edge.points, new.evaluate(*edge.uv.T), atol=1e-9)
    assert part.validity().valid, part.validity().faults
    again = reread(part, tmp_path, format)
    assert again.validity().valid, again.validity().faults
    np.testing.assert_allclose(again.faces[0].surface.control_points, new.control_points, atol=1e-9)


def test_control_points_that_stay_keep_their_bits():
    part = document_of_shapes([("panel", shape_of_surface(panel()))])
    before = part.faces[0].surface
    net = np.array(before.control_points)
    net[2, 3] += [0, 0, -1.0]
    part.sculpt({1: before.with_control_points(net)})
    after = part.faces[0].surface
    same = np.ones(before.shape, dtype=bool)
    same[2, 3] = False
    np.testing.assert_array_equal(after.control_points[same], before.control_points[same])
    np.testing.assert_array_equal(after.control_points[2, 3], net[2, 3])
    np.testing.assert_array_equal(after.knots_u, before.knots_u)


def test_edges_that_did_not_move_keep_their_bits():
    part = document_of_shapes([("panel", shape_of_surface(panel(trimmed=False)))])
    before = [edge.points.copy() for edge in part.faces[0].edges]
    tolerances = [BRep_Tool.Tolerance_s(edge) for edge in edges_of(part.face(1).shape)]
    curves = [BRep_Tool.Curve_s(edge, 0.0, 1.0) for edge in edges_of(part.face(1).shape)]
    part.sculpt({1: dented(part.faces[0].surface, 2.0)})
    for old, edge in zip(before, part.faces[0].edges, strict=True):
        np.testing.assert_array_equal(old[[0, -1]], edge.points[[0, -1]])
    edges = edges_of(part.face(1).shape)
    assert tolerances == [BRep_Tool.Tolerance_s(edge) for edge in edges]
    assert all(BRep_Tool.Curve_s(edge, 0.0, 1.0) is curve for edge, curve in zip(edges, curves, strict=True))


def closed_tube() -> BSplineSurface:
    """A periodic tube in u: cubic, single knots, eight poles."""
    angle = 2 * pi * np.arange(8) / 8
    ring = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), 0 * angle])
    net = np.stack([ring + [0, 0, z] for z in (0.0, 5.0, 10.0, 15.0)], axis=1)
    net = np.concatenate([net, net[:3]])
    knots_v = np.array([0.0, 0, 0, 0, 1, 1, 1, 1])
    return BSplineSurface(net, np.arange(-3.0, 12.0), knots_v, 3, 3, periodic_u=True)


@pytest.mark.parametrize("format", ["step", "iges"])
def test_periodic_faces_are_sculpted_and_stay_periodic(format, tmp_path):
    part = document_of_shapes([("tube", shape_of_surface(closed_tube()))])
    surface = part.faces[0].surface
    assert surface.periodic_u
    new = dented(insert_knots(surface, [1.5, 6.25], [0.5]), 1.0)
    part.sculpt({1: new})
    after = part.faces[0].surface
    assert after.periodic_u
    np.testing.assert_allclose(after.control_points, new.control_points, atol=1e-12)
    assert part.validity().valid, part.validity().faults
    again = reread(part, tmp_path, format)
    assert again.validity().valid
    u, v = np.random.default_rng(0).uniform([0, 0], [8, 1], (200, 2)).T
    np.testing.assert_allclose(again.faces[0].surface.evaluate(u, v), new.evaluate(u, v), atol=1e-9)


def test_a_seam_that_opens_is_refused():
    part = document_of_shapes([("tube", shape_of_surface(closed_tube()))])
    surface = part.faces[0].surface
    net = np.array(surface.control_points)
    net[0] += [0, 0, 1]
    with pytest.raises(InputError, match="repeated control points"):
        part.sculpt({1: surface.with_control_points(net)})


def two_places(shape: object) -> TopoDS_Compound:
    """One shape placed twice, turned and moved."""
    builder, compound = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(compound)
    for turn, move in ((0.0, (0, 0, 0)), (0.8, (100, 20, -5))):
        place, shift = gp_Trsf(), gp_Trsf()
        place.SetRotation(gp_Ax1(gp_Pnt(1, 2, 3), gp_Dir(1, 1, 0)), turn)
        shift.SetTranslation(gp_Vec(*move))
        builder.Add(compound, shape.Located(TopLoc_Location(shift.Multiplied(place))))
    return compound


def test_a_part_placed_twice_shows_the_dent_twice():
    part = document_of_shapes([("pair", two_places(solid("plane")))])
    assert len(part.faces) == 12
    first, second = part.face(3), part.face(9)
    turn = second.shape.Location().Transformation()
    new = dented(finer(second.surface))
    part.sculpt({9: new})
    assert any("placed several times" in line and "face 3" in line for line in part.warnings)
    np.testing.assert_allclose(second.surface.control_points, new.control_points, atol=1e-12)
    moved = gp_Pnt(*first.surface.control_points[3, 3].tolist()).Transformed(turn)
    np.testing.assert_allclose((moved.X(), moved.Y(), moved.Z()), new.control_points[3, 3], atol=1e-12)
    assert part.validity().valid


def test_one_shape_cannot_take_two_dents():
    part = document_of_shapes([("pair", two_places(solid("plane")))])
    surfaces = {n: dented(finer(part.face(n).surface), depth) for n, depth in ((3, 0.2), (9, 0.4))}
    with pytest.raises(InputError, match="placed twice"):
        part.sculpt(surfaces)


def test_a_surface_shared_by_two_faces_is_parted_first():
    """Two faces on one surface of the kernel: only the sculpted one changes."""
    left, right = (replace(panel(), trims=(TrimLoop(tuple(_side(u0, u1))),)) for u0, u1 in ((0.2, 1.4), (1.6, 2.8)))
    a, b = shape_of_surface(left), shape_of_surface(right)
    geom, here = BRep_Tool.Surface_s(a), TopLoc_Location()
    builder = BRep_Builder()
    own = BRep_Tool.Surface_s(b)
    for edge in edges_of(b):
        curve = BRep_Tool.CurveOnSurface_s(edge, b, 0.0, 0.0)
        builder.UpdateEdge(edge, None, own, here, 1e-7)
        builder.UpdateEdge(edge, curve, geom, here, 1e-7)
    builder.UpdateFace(b, geom, here, 1e-7)
    part = document_of_shapes([("a", a), ("b", b)])
    assert part.face(1).geom is part.face(2).geom
    untouched = part.faces[1].surface
    new = dented(part.faces[0].surface, 2.0)
    part.sculpt({1: new})
    np.testing.assert_array_equal(part.faces[0].surface.control_points, new.control_points)
    np.testing.assert_array_equal(part.faces[1].surface.control_points, untouched.control_points)
    assert part.validity().valid, part.validity().faults


def _side(u0: float, u1: float) -> list[TrimCurve]:
    corners = np.array([(u0, 0.4), (u1, 0.4), (u1, 2.6), (u0, 2.6)])
    return [TrimCurve(corners[[i, (i + 1) % 4]], np.array([0.0, 0, 1, 1]), 1) for i in range(4)]


def test_a_shared_edge_stays_with_the_neighbour_and_a_warning_tells_the_gap():
    part = document_of_shapes([("box", solid("plane"))])
    face = part.faces[0]
    net = np.array(finer(face.surface).control_points)
    net += [0, 0, 0.5]
    neighbours = {n: part.faces.number(n).area for edge in face.edges for n in edge.neighbours}
    part.sculpt({1: finer(face.surface).with_control_points(net)})
    assert len([line for line in part.warnings if "leaves face" in line]) == len(neighbours) == 4
    assert all("0.5 mm" in line for line in part.warnings)
    assert all(part.faces.number(n).area == area for n, area in neighbours.items())


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda s: replace(s, degree_u=2, knots_u=s.knots_u[1:]), "degrees"),
        (lambda s: replace(s, knots_u=s.knots_u * 2), "parameter range"),
        (lambda s: replace(s, knots_u=np.where(s.knots_u == 1, 1.1, s.knots_u)), "lacks the face's knot 1"),
        (lambda s: replace(s, weights=np.ones(s.shape)), "weights"),
    ],
    ids=["degree", "range", "knot", "weights"],
)
def test_a_surface_that_is_not_the_faces_own_is_refused_before_anything_changes(spoil, message):
    part = document_of_shapes([("panel", shape_of_surface(panel()))])
    before = part.faces[0].surface
    with pytest.raises(InputError, match=message):
        part.sculpt({1: spoil(before)})
    np.testing.assert_array_equal(part.faces[0].surface.control_points, before.control_points)


def test_the_checker_sees_a_broken_face_and_names_it():
    part = document_of_shapes([("panel", shape_of_surface(panel()))])
    assert part.validity_as_read().valid
    edge = edges_of(part.face(1).shape)[0]
    curve = BRep_Tool.Curve_s(edge, 0.0, 1.0)
    curve.Translate(gp_Vec(0, 0, 1))
    verdict = part.validity()
    assert not verdict.valid
    assert any(fault.startswith("face 1: edge") and "1 mm apart" in fault for fault in verdict.faults)
    assert part.validity_as_read().valid


def test_neighbours_seams_and_poles_are_told():
    cylinder = document_of_shapes([("c", solid("cylinder"))])
    wall = next(face for face in cylinder.faces if face.kind == "cylinder")
    assert [edge.seam for edge in wall.edges].count(True) == 2
    rims = [edge for edge in wall.edges if not edge.seam]
    assert sorted(n for edge in rims for n in edge.neighbours) == sorted({1, 2, 3} - {wall.number})
    for edge in rims:
        np.testing.assert_allclose(np.hypot(edge.points[:, 0], edge.points[:, 1]), 8, atol=1e-7)
        assert len(edge.points) >= 64
    ball = document_of_shapes([("b", solid("sphere"))]).faces[0]
    poles = [edge for edge in ball.edges if edge.degenerate]
    assert len(poles) == 2
    assert all(np.ptp(edge.points, axis=0).max() < 1e-12 for edge in poles)
    assert ball.area == pytest.approx(400 * pi, rel=1e-12)
    assert ball.surface.trims is None
    np.testing.assert_allclose(ball.bbox, (-10, -10, -10, 10, 10, 10), atol=1e-6)


def test_normals_point_out_of_every_solid():
    for kind in ("plane", "cylinder", "cone", "sphere", "torus"):
        part = document_of_shapes([(kind, solid(kind))])
        boxes = np.array([face.bbox for face in part.faces])
        middle = 0.5 * (boxes[:, :3].min(axis=0) + boxes[:, 3:].max(axis=0))
        for face in part.faces:
            (a, b), (c, d) = face.surface.domain
            u, v = 0.37 * a + 0.63 * b, 0.4 * c + 0.6 * d
            point, normal = face.surface.evaluate(u, v), face.surface.normal(u, v)
            if kind == "torus":
                middle = np.array([*20 * point[:2] / np.hypot(*point[:2]), 0.0])
            assert normal @ (point - middle) > 0, (kind, face.number)
