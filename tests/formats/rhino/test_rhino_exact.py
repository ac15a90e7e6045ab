"""What goes into a new 3DM file comes out of it: trim curves digit for digit, names, seams; and openNURBS takes the file."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cadsculpt.formats import iges, step
from cadsculpt.formats.occt.shape import unrolled_knots
from cadsculpt.formats.part import Part
from cadsculpt.formats.patch_part import PatchPart
from cadsculpt.formats.rhino import part as rhino
from cadsculpt.formats.rhino.archive import BUFFER_VERSION, object_records
from cadsculpt.formats.rhino.joins import joined_chunk, without_joins
from cadsculpt.formats.rhino.nurbs import Nurbs
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

rhino3dm = pytest.importorskip("rhino3dm")

Array = NDArray[np.float64]
LINE = np.array([0.0, 0.0, 1.0, 1.0])


def sheet(name: str = "sheet", *, weights: bool = False, low: float = -1.0, high: float = 7.0) -> BSplineSurface:
    """A wavy sheet over [low, high] x [0, 1], degrees 3 x 2."""
    inner = np.array([0.2, 0.55]) * (high - low) + low
    knots_u, knots_v = np.concatenate([[low] * 4, inner, [high] * 4]), np.array([0.0, 0, 0, 1 / 7, 1, 1, 1])
    x, y = np.meshgrid(np.arange(6.0), np.arange(4.0), indexing="ij")
    net = np.stack([x * 17 / 3, y * 19 / 7, np.sin(x) + y / 3], axis=2)
    return BSplineSurface(net, knots_u, knots_v, 3, 2, 1.0 + 0.3 * np.cos(x + y) if weights else None, name=name)


@st.composite
def loops(draw: st.DrawFn, surface: BSplineSurface, middle: Array, reach: float, outer: bool) -> TrimLoop:
    """Curves of any degree around `middle`, whose ends miss each other by up to 1e-3 of the range; shares of it."""
    corners = draw(st.integers(1, 5))
    seed = draw(st.integers(0, 2**32 - 1))
    gap = draw(st.sampled_from([0.0, 1e-16, 2e-10, 2.4e-10, 1e-9, 1e-7, 1e-5, 1e-3]))
    rng = np.random.default_rng(seed)
    low = np.array([bound[0] for bound in surface.domain])
    size = np.array([bound[1] - bound[0] for bound in surface.domain])
    turn = 1.0 if outer else -1.0
    curves = []
    for k in range(corners):
        degree = int(rng.integers(1, 4))
        count = degree + 1 + int(rng.integers(corners < 3, 4)) + 2 * (corners < 3)
        angle = turn * 2 * np.pi * (k + np.linspace(0.0, 1.0, count)) / corners
        ray = reach * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        ray[1:-1] *= rng.uniform(0.85, 1.0, (count - 2, 1))
        points = low + size * (middle + ray)
        points[-1] += gap * size * rng.uniform(-1.0, 1.0, 2)
        start = rng.uniform(-3.0, 3.0)
        inner = np.sort(rng.uniform(0.1, 0.9, count - degree - 1))
        knots = start + rng.uniform(0.1, 9.0) * np.concatenate([[0.0] * (degree + 1), inner, [1.0] * (degree + 1)])
        weights = rng.uniform(0.5, 2.0, count) if rng.random() < 0.4 else None
        curves.append(TrimCurve(points, knots, degree, weights))
    return TrimLoop(tuple(curves), outer)


@st.composite
def trimmed(draw: st.DrawFn, name: str) -> BSplineSurface:
    surface = sheet(name, weights=draw(st.booleans()), low=draw(st.sampled_from([-1.0, 0.0, 250.0])), high=300.0)
    found = [draw(loops(surface, np.array([0.45, 0.5]), 0.4, True))]
    if draw(st.booleans()):
        found.append(draw(loops(surface, np.array([0.45, 0.5]), 0.2, False)))
    return replace(surface, trims=tuple(found), outward=draw(st.booleans()))


def through(part: Part, folder: Path) -> rhino.RhinoPart:
    """Written twice, the same bytes; read by rhino3dm, every object valid; and read again."""
    rhino.write_part(part, folder / "a.3dm")
    rhino.write_part(part, folder / "b.3dm")
    assert (folder / "a.3dm").read_bytes() == (folder / "b.3dm").read_bytes()
    model = rhino3dm.File3dm.Read(str(folder / "a.3dm"))
    assert len(model.Objects) > 0
    for thing in model.Objects:
        assert thing.Geometry.IsValid
        if isinstance(thing.Geometry, rhino3dm.Brep):
            assert all(edge.IsValid and edge.Domain.T0 < edge.Domain.T1 for edge in thing.Geometry.Edges)
    return rhino.read(folder / "a.3dm")


def same_trims(a: BSplineSurface, b: BSplineSurface) -> None:
    """Loop for loop and curve for curve; weighted coordinates are divided again and may lose their last bit."""
    assert (a.trims is None) == (b.trims is None)
    if a.trims is None or b.trims is None:
        return
    assert [loop.outer for loop in a.trims] == [loop.outer for loop in b.trims]
    for mine, other in zip(a.trims, b.trims, strict=True):
        for curve, again in zip(mine.curves, other.curves, strict=True):
            assert curve.degree == again.degree
            np.testing.assert_array_equal(again.knots, curve.knots)
            if curve.weights is None:
                assert again.weights is None
                np.testing.assert_array_equal(again.control_points, curve.control_points)
            else:
                np.testing.assert_array_equal(again.weights, curve.weights)
                np.testing.assert_allclose(again.control_points, curve.control_points, rtol=4e-16, atol=1e-300)


def same_net(a: BSplineSurface, b: BSplineSurface) -> None:
    assert (a.degree_u, a.degree_v, a.shape, a.periodic_u, a.periodic_v) == (
        b.degree_u,
        b.degree_v,
        b.shape,
        b.periodic_u,
        b.periodic_v,
    )
    for mine, other in ((a.knots_u, b.knots_u), (a.knots_v, b.knots_v)):
        np.testing.assert_allclose(other[1:-1], mine[1:-1], rtol=1e-15, atol=1e-15 * np.abs(mine).max())
    if a.weights is None:
        np.testing.assert_array_equal(b.control_points, a.control_points)
    else:
        np.testing.assert_array_equal(b.weights, a.weights)
        np.testing.assert_allclose(b.control_points, a.control_points, rtol=4e-16, atol=1e-300)


# ------------------------------------------------------------------------ trims


@settings(max_examples=10, deadline=None)
@given(st.data())
def test_trims_come_back_digit_for_digit(data: st.DataObject) -> None:
    surfaces = [data.draw(trimmed("one")), data.draw(trimmed("zwei ×"))]
    with tempfile.TemporaryDirectory() as folder:
        part = PatchPart(Path(folder) / "x.json", "json", "mm", surfaces)
        back = through(part, Path(folder))
        assert part.warnings == [], part.warnings
        for surface in surfaces:
            face = back.faces[surface.name]
            assert face.surface.outward == surface.outward
            same_net(surface, face.surface)
            same_trims(surface, face.surface)


@settings(max_examples=20, deadline=None)
@given(
    st.sampled_from([0.0, 1e-12, 2e-8, 1.1e-7, 1.3e-7, 1e-6]),
    st.sampled_from([0.0, 0.1, 0.3]),
    st.sampled_from([-1.0, 1e3]),
    st.integers(0, 2**32 - 1),
)
def test_lines_near_parameter_lines_are_not_moved(off: float, inside: float, low: float, seed: int) -> None:
    """openNURBS has its own rule of what runs along a side, and refuses a Brep that says otherwise: ours is the same."""
    rng = np.random.default_rng(seed)
    surface = sheet(low=low, high=low + 8.0)
    corners = np.array([(inside, inside), (1 - inside, inside), (1 - inside, 1 - inside), (inside, 1 - inside)])
    size = np.array([8.0, 1.0])
    places = np.array([low, 0.0]) + size * corners
    curves = []
    for k in range(4):
        ends = np.array([places[k], places[(k + 1) % 4]])
        degree = int(rng.integers(1, 4))
        points = ends[0] + np.linspace(0.0, 1.0, degree + 1)[:, None] * (ends[1] - ends[0])
        points += off * size * rng.uniform(-1.0, 1.0, points.shape) * (rng.random() < 0.7)
        points = np.clip(points, places.min(axis=0), places.max(axis=0)) if inside == 0.0 else points
        curves.append(TrimCurve(points, np.repeat([0.0, 1.0], degree + 1), degree))
    surface = replace(surface, trims=(TrimLoop(tuple(curves)),))
    with tempfile.TemporaryDirectory() as folder:
        part = PatchPart(Path(folder) / "x.json", "json", "mm", [surface])
        back = through(part, Path(folder))
        assert part.warnings == []
        same_trims(surface, back.faces[0].surface)


def test_a_loop_along_the_sides_is_still_a_loop(tmp_path: Path) -> None:
    """Trims along the border of the domain are not the same as no trims: both come back as they were."""
    corners = np.array([(-1.0, 0.0), (7.0, 0.0), (7.0, 1.0), (-1.0, 1.0)])
    sides = [TrimCurve(corners[[k, (k + 1) % 4]], LINE, 1) for k in range(4)]
    surfaces = [replace(sheet("loop"), trims=(TrimLoop(tuple(sides)),)), replace(sheet("whole"), outward=False)]
    back = through(PatchPart(tmp_path / "x.json", "json", "mm", surfaces), tmp_path)
    for surface in surfaces:
        same_trims(surface, back.faces[surface.name].surface)


def test_only_our_own_lines_are_left_out() -> None:
    """A polycurve of another program stays whole, whatever its pieces."""
    curve = Nurbs(2, False, (1,), (np.array([2.0, 5.0]),), np.array([(0.0, 0.0), (1.0, 1.0)]))
    before, after = np.array([(-0.1, 0.0), (0.0, 0.0)]), np.array([(1.0, 1.0), (1.1, 1.1), (1.0, 1.2)])
    chunk, domain = joined_chunk(curve, before, after, BUFFER_VERSION)
    plain, own = joined_chunk(curve, None, None, BUFFER_VERSION)
    assert without_joins(chunk, domain, BUFFER_VERSION) == (plain, own)
    assert own == (2.0, 5.0)
    part_of_it = (2.5, domain[1])
    assert without_joins(chunk, part_of_it, BUFFER_VERSION) == (chunk, part_of_it)
    at = chunk.index(np.float64(domain[0]).tobytes())
    other = chunk[:at] + np.float64(domain[0] - 0.5).tobytes() + chunk[at + 8 :]
    there = (domain[0] - 0.5, domain[1])
    assert without_joins(other, there, BUFFER_VERSION) == (other, there)


# ------------------------------------------------------------------------ seams


def tube(multiplicity: int, *, rational: bool, degree: int = 3) -> BSplineSurface:
    """A closed tube, periodic in u, whose seam's knot has this multiplicity."""
    values = np.array([0.0, 1.0, 2.5, 3.0, 4.0])
    counts = np.array([multiplicity, 1, 1, 1, multiplicity])
    knots, first = unrolled_knots(values, counts, degree, True)
    rows = len(knots) - degree - 1
    poles = int(counts[:-1].sum())
    angle = 2 * np.pi * np.arange(poles) / poles
    place = (np.arange(rows) + first) % poles
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)[place] * 11 / 3
    heights = np.array([0.0, 7 / 3, 5.0])
    net = np.stack([np.concatenate([ring, np.full((rows, 1), z)], axis=1) for z in heights], axis=1)
    weights = None
    if rational:
        weights = np.repeat((1.0 + 0.2 * np.cos(3 * angle))[place][:, None], 3, axis=1)
    flat = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    return BSplineSurface(net, knots, flat, degree, 2, weights, periodic_u=True, name=f"tube {multiplicity}")


@pytest.mark.parametrize("rational", [False, True])
@pytest.mark.parametrize("multiplicity", [1, 2, 3])
@pytest.mark.parametrize("outward", [False, True])
def test_periodic_surfaces_keep_their_rows(multiplicity: int, rational: bool, outward: bool, tmp_path: Path) -> None:
    """As a surface of its own (outward) and in a Brep; a sculpted one goes back into the file and comes out again."""
    surface = replace(tube(multiplicity, rational=rational), outward=outward)
    back = through(PatchPart(tmp_path / "x.json", "json", "mm", [surface]), tmp_path)
    found = back.faces[0].surface
    same_net(surface, found)
    assert found.outward == outward
    higher = found.with_control_points(found.control_points + [0.0, 0.0, 1.25])
    back.sculpt({1: higher})
    back.write(tmp_path / "sculpted.3dm", "3dm")
    again = rhino.read(tmp_path / "sculpted.3dm")
    same_net(higher, again.faces[0].surface)
    assert again.validity().valid


# ------------------------------------------------------------------------ names


def box() -> Part:
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox

    from cadsculpt.formats.occt.document import faces_in
    from cadsculpt.formats.occt.part import document_of_shapes

    shape = BRepPrimAPI_MakeBox(30.0, 20.0, 10.0).Shape()
    names = ["top", " side with blanks ", "Fläche №3", "\U0001f600", "face 5", "a/b=c;\n\t"]
    return document_of_shapes([("box", shape)], faces=list(zip(names, faces_in(shape), strict=True)))


def test_faces_of_a_solid_keep_their_names(tmp_path: Path) -> None:
    part = box()
    names = [face.name for face in part.faces]
    assert len(set(names)) == 6
    back = through(part, tmp_path)
    assert [face.name for face in back.faces] == names
    again = through(back, tmp_path)
    assert [face.name for face in again.faces] == names


def test_names_that_are_not_those_of_all_faces_are_not_looked_at(tmp_path: Path) -> None:
    rhino.write_part(box(), tmp_path / "box.3dm")
    model = rhino3dm.File3dm.Read(str(tmp_path / "box.3dm"))
    for thing in model.Objects:
        thing.Attributes.SetUserString("face 7", "one too many")
    model.Write(str(tmp_path / "other.3dm"), 8)
    base = model.Objects[0].Attributes.Name
    assert [face.name for face in rhino.read(tmp_path / "other.3dm").faces] == [f"{base} face {i}" for i in range(1, 7)]


def test_an_edge_that_closes_between_two_vertices_has_one(tmp_path: Path) -> None:
    """Some systems end a circle in another vertex than it starts, at the same place; openNURBS refuses that."""
    from OCP.Geom import Geom_Circle
    from OCP.gp import gp_Ax2

    from cadsculpt.formats.occt.part import document_of_shapes
    from cadsculpt.formats.occt.shape import WireEdge, edge, face_with_wires, vertex

    u, v = np.meshgrid([-9.0, 9.0], [-9.0, 9.0], indexing="ij")
    flat = BSplineSurface(np.stack([u, v, 0 * u], axis=2), LINE * 18 - 9, LINE * 18 - 9, 1, 1, name="disc")
    half = np.sqrt(0.5)
    ring = np.array([(5, 0), (5, 5), (0, 5), (-5, 5), (-5, 0), (-5, -5), (0, -5), (5, -5), (5, 0)], dtype=float)
    knots = np.repeat(np.linspace(0.0, 2.0 * np.pi, 5), [3, 2, 2, 2, 3])
    curve = TrimCurve(ring, knots, 2, np.array([1, half, 1, half, 1, half, 1, half, 1]))
    start, end = (vertex(np.array([5.0, 0.0, 0.0])) for _ in range(2))
    made = edge(Geom_Circle(gp_Ax2(), 5.0), 0.0, 2.0 * np.pi, start, end)
    part = document_of_shapes([("disc", face_with_wires(flat, [[WireEdge(made, curve)]]))])
    back = through(part, tmp_path)
    assert not any("3DM" in warning for warning in part.warnings)
    same_trims(part.faces[0].surface, back.faces[0].surface)
    assert back.faces[0].area == pytest.approx(25.0 * np.pi, rel=1e-9)


# ------------------------------------------------------------------- real files


REAL = [
    "step/bug25013_25013faces.stp",
    "step/trj4_k1_geo-tu-214.stp",
    "step/trj4_k1_top-id-214.stp",
    "step/trj4_k1_geo-md-203.stp",
    "iges/PRO20360-T4.igs",
    "iges/OCC8842_cylinder_Ideas.igs",
    "iges/example_45_faces.iges",
]
"""Ends that do not meet, lines a little off a parameter line, seams bent at a corner, seams of two edges, full
multiplicity at seams, holes."""


@pytest.mark.corpus
@pytest.mark.parametrize("name", REAL)
def test_real_faces_come_back_digit_for_digit(corpus: Path, tmp_path: Path, name: str) -> None:
    part = (iges if name.startswith("iges") else step).read(corpus / name)
    back = through(part, tmp_path)
    assert not any("3DM" in warning for warning in part.warnings)
    assert sorted(face.name for face in back.faces) == sorted(face.name for face in part.faces)
    for face in part.faces:
        if face.warning:
            continue
        found = back.faces[face.name].surface
        same_net(face.surface, found)
        same_trims(face.surface, found)
        assert found.outward == face.surface.outward
    assert len(object_records((tmp_path / "a.3dm").read_bytes())) <= len(part.faces)
