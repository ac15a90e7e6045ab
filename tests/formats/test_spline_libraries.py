"""GoTools .g2 and G+Smo XML: their own files against scipy, round trips bit for bit, every fault with its place."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from cadsculpt.errors import InputError
from cadsculpt.formats import gismo, gotools, patch_json, registry
from cadsculpt.formats.patch_part import PatchPart
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

KNOTS = np.array([0.0, 0, 1, 1])


def same(a: BSplineSurface, b: BSplineSurface) -> bool:
    """Bit for bit."""
    arrays = [(a.control_points, b.control_points), (a.knots_u, b.knots_u), (a.knots_v, b.knots_v)]
    assert (a.weights is None) == (b.weights is None)
    if a.weights is not None and b.weights is not None:
        arrays.append((a.weights, b.weights))
    return (a.degree_u, a.degree_v) == (b.degree_u, b.degree_v) and all(np.array_equal(x, y) for x, y in arrays)


@st.composite
def surfaces(draw: st.DrawFn) -> BSplineSurface:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    sides = []
    for _ in range(2):
        degree = int(rng.integers(1, 5))
        count = degree + 1 + int(rng.integers(0, 4))
        inner = np.sort(rng.normal(size=count - degree - 1))
        low, high = (inner.min() - 0.3, inner.max() + 0.7) if len(inner) else (-0.3, 0.7)
        sides.append((count, degree, np.concatenate([[low] * (degree + 1), inner, [high] * (degree + 1)])))
    (r, p, knots_u), (s, q, knots_v) = sides
    weights = np.exp(rng.normal(size=(r, s))) if draw(st.booleans()) else None
    scale = 10.0 ** rng.integers(-6, 7)
    return BSplineSurface(rng.normal(size=(r, s, 3)) * scale, knots_u, knots_v, p, q, weights, name="patch")


@settings(max_examples=60, deadline=None)
@given(surfaces())
def test_what_is_written_reads_back_bit_for_bit(surface: BSplineSurface) -> None:
    (back,) = gotools.surfaces_of_text(gotools.text_of_surfaces([surface]), "a.g2")
    assert same(back, surface)
    (back,), warnings = gismo.surfaces_of_text(gismo.text_of_surfaces([surface]), "a.xml")
    assert same(back, surface)
    assert back.name == "patch"
    assert warnings == []


def test_products_that_no_double_brings_back() -> None:
    """w x rounded and divided by w is not always x: then more digits stand there, and some such exist."""
    rng = np.random.default_rng(1)
    longer = 0
    for x, weight in rng.uniform(0.1, 10, (2000, 2)).tolist():
        word = gotools._product(x, weight)
        longer += len(word) > 20
        assert gotools._quotient(float(word), word, weight) == x
        assert float(word) == pytest.approx(x * weight, rel=1e-15)
    assert longer > 20


REAL = {
    "sphere.g2": (1, "sphere of radius 1"),
    "spline_surface_1.g2": (1, ""),
    "surface.g2": (1, ""),
    "teapot.g2": (32, ""),
    "trimmed_sfs.g2": (8, ""),
    "car_shell1.xml": (8, ""),
    "egg.xml": (1, ""),
    "teapot.xml": (32, ""),
    "torus_u4p.xml": (4, "torus of radii 2 and 1"),
    "wine_glass.xml": (1, ""),
}


@pytest.mark.corpus
@pytest.mark.parametrize("name", REAL)
def test_real_files(corpus: Path, tmp_path: Path, name: str) -> None:
    """As many surfaces as the file has, each as scipy evaluates it; there and back through every spline format."""
    path = corpus / "spline" / name
    part = registry.read(path)
    assert part.format == ("g2" if name.endswith("g2") else "gismo")
    assert len(part.faces) == REAL[name][0]
    assert any("no length unit" in warning for warning in part.warnings)
    read = [face.surface for face in part.faces]
    for surface in read:
        weights = np.ones(surface.shape) if surface.weights is None else surface.weights
        net = np.concatenate([surface.control_points * weights[..., None], weights[..., None]], axis=2)
        u, v = (np.linspace(*span, 7) for span in surface.domain)
        along = BSpline(surface.knots_u, net, surface.degree_u)(u)
        truth = np.moveaxis(BSpline(surface.knots_v, np.moveaxis(along, 1, 0), surface.degree_v)(v), 0, 1)
        np.testing.assert_allclose(
            surface.evaluate(u[:, None], v), truth[..., :3] / truth[..., 3:], atol=1e-12 * max(surface.size, 1)
        )
    for suffix in ("g2", "xml", "json"):
        registry.write_part(part, tmp_path / f"a.{suffix}", registry.SUFFIXES[f".{suffix}"])
        back = registry.read(tmp_path / f"a.{suffix}")
        assert all(same(a, face.surface) for a, face in zip(read, back.faces, strict=True))
    again = registry.read(path)
    registry.write_part(again, tmp_path / "b.g2", "g2")
    assert (tmp_path / "a.g2").read_bytes() == (tmp_path / "b.g2").read_bytes()


@pytest.mark.corpus
def test_shapes_with_a_formula(corpus: Path) -> None:
    """The control points stand in the right order and are, or are not, multiplied by their weights."""
    (sphere,) = registry.read(corpus / "spline" / "sphere.g2").faces
    u, v = (np.linspace(*span, 23) for span in sphere.surface.domain)
    np.testing.assert_allclose(np.linalg.norm(sphere.surface.evaluate(u[:, None], v), axis=2), 1.0, atol=2e-6)
    for face in registry.read(corpus / "spline" / "torus_u4p.xml").faces:
        u, v = (np.linspace(*span, 23) for span in face.surface.domain)
        x, y, z = np.moveaxis(face.surface.evaluate(u[:, None], v), 2, 0)
        tube = np.hypot(np.hypot(x, y) - 2.0, z)
        np.testing.assert_allclose(tube, 1.0, atol=1e-12)


@pytest.mark.corpus
def test_bounded_surfaces_are_trimmed(corpus: Path, tmp_path: Path) -> None:
    """Triangles and four-sided pieces of a box: areas by the polygon of the loop's corners where all sides are straight."""
    part = registry.read(corpus / "spline" / "trimmed_sfs.g2")
    assert all(face.trimmed for face in part.faces)
    registry.write_part(part, tmp_path / "a.g2", "g2")
    back = registry.read(tmp_path / "a.g2")
    straight = 0
    for face, other in zip(part.faces, back.faces, strict=True):
        loops = face.surface.trims
        assert loops is not None
        corners = np.concatenate([loop.curves[k].control_points[:1] for loop in loops for k in range(len(loop.curves))])
        ends = np.concatenate([curve.control_points[-1:] for loop in loops for curve in loop.curves])
        np.testing.assert_allclose(np.roll(ends, 1, axis=0), corners, atol=1e-6)
        bends = max(
            float(np.abs(np.linalg.matrix_rank(c.control_points - c.control_points[0], tol=1e-9) - 1))
            for loop in loops
            for c in loop.curves
        )
        if bends == 0.0 and len(loops) == 1:
            straight += 1
            points = face.surface.evaluate(*corners.T)
            triangles = np.cross(points[1:-1] - points[0], points[2:] - points[0])
            area = 0.5 * float(np.linalg.norm(triangles.sum(axis=0)))
            assert face.area == pytest.approx(area, rel=1e-6)
        assert other.area == face.area
        assert [c.control_points.tolist() for loop in loops for c in loop.curves] == [
            c.control_points.tolist() for loop in other.surface.trims or () for c in loop.curves
        ]
    assert straight >= 4


def test_units_override_and_warnings(tmp_path: Path) -> None:
    """No unit: mm with a warning, or what --units says; a written file says in which unit its numbers are."""
    square = BSplineSurface(np.array([[[0.0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]]), KNOTS, KNOTS, 1, 1, name="a")
    hole = np.array([(0.4, 0.4), (0.4, 0.6), (0.6, 0.6), (0.6, 0.4), (0.4, 0.4)])
    rim = np.array([(0.0, 0), (1, 0), (1, 1), (0, 1), (0, 0)])
    loops = [
        TrimLoop((TrimCurve(p, np.array([0.0, 0, 1, 2, 3, 4, 4]), 1),), outer)
        for p, outer in ((rim, True), (hole, False))
    ]
    trimmed = BSplineSurface(square.control_points, KNOTS, KNOTS, 1, 1, trims=tuple(loops), name="b")
    part = PatchPart(tmp_path / "p.json", "json", "in", [square, trimmed])
    registry.write_part(part, tmp_path / "a.g2", "g2")
    assert part.warnings == ["GoTools g2 has no length unit: the numbers are in in"]
    part.warnings.clear()
    registry.write_part(part, tmp_path / "a.xml", "gismo")
    assert part.warnings[1:] == ["G+Smo XML has no trims: written as whole surfaces are b"]
    inches = registry.read(tmp_path / "a.g2", units="in")
    assert inches.warnings == []
    assert inches.faces[0].area == pytest.approx(25.4**2)
    assert inches.faces[1].area == pytest.approx(0.96 * 25.4**2)
    assert [loop.outer for loop in inches.faces[1].surface.trims or ()] == [True, False]
    assert registry.read(tmp_path / "a.xml").faces["b"].area == pytest.approx(1.0)
    (tmp_path / "a.xml").rename(tmp_path / "a.step")
    assert registry.read(tmp_path / "a.step").warnings[-1] == "its name says STEP, but it is a G+Smo XML file"
    registry.write_part(inches, tmp_path / "a.json", "json")
    _, back = patch_json.surfaces_of_document(patch_json.load(tmp_path / "a.json"), "a.json")
    assert len(back) == 2


@pytest.mark.corpus
@pytest.mark.parametrize("name", REAL)
def test_cut_off_files_are_refused(corpus: Path, tmp_path: Path, name: str) -> None:
    data = (corpus / "spline" / name).read_bytes()
    for tenth in range(1, 10):
        path = tmp_path / name
        path.write_bytes(data[: len(data) * tenth // 10])
        with pytest.raises(InputError) as caught:
            registry.read(path)
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)


SURFACE = "200 1 0 0\n3 0\n2 2\n0 0 1 1\n2 2\n0 0 1 1\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n"


def test_a_second_object_and_a_colour() -> None:
    text = SURFACE.replace("200 1 0 0", "200 1 0 4 255 0 0 255") + "\n" + SURFACE
    one, two = gotools.surfaces_of_text(text, "a.g2")
    assert same(one, two)
    np.testing.assert_array_equal(one.control_points[1, 0], [1, 0, 0])
    assert (one.name, two.name) == ("surface 1", "surface 2")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "there are no surfaces"),
        ("100 1 0 0\n3 0\n2 2\n0 0 1 1\n0 0 0\n1 0 0\n", "a.g2:1: a spline curve is not read"),
        ("260 1 0 0\n", "a cylinder is not read"),
        ("700 1 0 0\n", "a spline volume is not read"),
        ("210 1 0 0\n250\n", "a.g2:2: a bounded plane is not read"),
        (SURFACE[:-4], "the file ends where a control point should stand (it may have been cut off)"),
        (SURFACE.replace("1 1 0\n", "1 nan 0\n"), "a.g2:10: 'nan' is not a finite number where a control point"),
        (SURFACE.replace("1 1 0\n", "1 x 0\n"), "a.g2:10: 'x' is not a finite number"),
        (SURFACE.replace("3 0\n2 2", "3 0\n2 3"), "a.g2:3: 2 control points for order 3"),
        (SURFACE.replace("3 0\n2 2", "3 0\n2 1.5"), "1.5 cannot be the order"),
        (SURFACE.replace("3 0\n2 2", "3 0\n1e9 2"), "1e+09 cannot be the number of control points"),
        (SURFACE.replace("3 0\n2", "2 0\n2", 1), "a surface in 2 dimensions, not 3"),
        (SURFACE.replace("0 0 1 1", "0 1 0 1", 1), "knots in u are not finite and non-decreasing"),
        (SURFACE.replace("3 0", "3 1", 1).replace("0 0 0\n", "0 0 0 -1\n"), "the weight -1 is not positive"),
    ],
)
def test_faults_of_a_g2_file(text: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        gotools.surfaces_of_text(text, "a.g2")
    assert words in str(caught.value)


GEOMETRY = gismo.text_of_surfaces(gotools.surfaces_of_text(SURFACE, "a.g2"))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("TensorBSpline2", "THBSpline2", "there are no surfaces: Geometry 0 is a THBSpline2 and left out"),
        ('geoDim="3"', 'geoDim="2"', "a.xml, Geometry 0: a surface in 2 dimensions"),
        ("coefs", "points", "Geometry 0: the coefs are missing"),
        ('degree="1"', 'degree="x"', "the degree of basis 0 is 'x'"),
        ('index="1"', 'index="2"', "two bases of type BSplineBasis"),
        ("1.0 1.0 0.0", "1.0 inf 0.0", "in coefs: 'inf' is not a finite number"),
        ("1.0 1.0 0.0", "1.0 a 0.0", "in coefs: could not convert"),
        ("1.0 1.0 0.0", "1.0 1.0", "11 numbers in coefs, not 3 for each of 2 x 2"),
        ("TensorBSpline2", "TensorNurbs2", "the weights are missing"),
        ("<xml>", "<xml><open>", "a.xml:"),
        ("<xml>", "<!DOCTYPE x><xml>", "an XML file with definitions of its own is not read"),
    ],
)
def test_faults_of_a_gismo_file(old: str, new: str, words: str) -> None:
    assert old in GEOMETRY
    with pytest.raises(InputError) as caught:
        gismo.surfaces_of_text(re.sub(re.escape(old), new, GEOMETRY), "a.xml")
    assert words in str(caught.value)
