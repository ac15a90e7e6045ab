"""Trim curves and knots through STEP and IGES, number for number: lines, splines, arcs, holes, seams and poles."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

pytest.importorskip("OCP")

from OCP.IGESCAFControl import IGESCAFControl_Reader
from OCP.IGESControl import IGESControl_Controller
from OCP.TCollection import TCollection_AsciiString

from cadsculpt.formats import registry
from cadsculpt.formats.occt.healing import set_healing
from cadsculpt.formats.occt.trim import evaluate_trim, trim_domain
from cadsculpt.formats.part import Part
from cadsculpt.formats.patch_part import PatchPart
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

Array = NDArray[np.float64]

SUFFIX = {"step": ".step", "iges": ".igs"}
SAME = 1e-9
LINE = np.array([0.0, 0.0, 1.0, 1.0])
QUIET = settings(
    max_examples=8,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


# -------------------------------------------------------------------- faces


def surface(degree: tuple[int, int], rational: bool, trims: tuple[TrimLoop, ...] | None, seed: int) -> BSplineSurface:
    """A bumpy patch over [-1, 2] x [0, 5], with uneven knots."""
    rng = np.random.default_rng(seed)
    p, q = degree
    r, s = p + 3, q + 2
    inner_u, inner_v = np.sort(rng.uniform(-0.8, 1.8, r - p - 1)), np.sort(rng.uniform(0.5, 4.5, s - q - 1))
    knots_u = np.concatenate([np.full(p + 1, -1.0), inner_u, np.full(p + 1, 2.0)])
    knots_v = np.concatenate([np.zeros(q + 1), inner_v, np.full(q + 1, 5.0)])
    x, y = np.meshgrid(np.linspace(0, 60, r), np.linspace(0, 90, s), indexing="ij")
    net = np.stack([x, y, rng.uniform(-4, 4, (r, s))], axis=2)
    weights = rng.uniform(0.7, 1.4, (r, s)) if rational else None
    return BSplineSurface(net, knots_u, knots_v, p, q, weights, trims=trims, name="patch")


def straight(a: Array, b: Array) -> TrimCurve:
    return TrimCurve(np.array([a, b]), LINE, 1)


def side(kind: str, a: Array, b: Array, bulge: float) -> TrimCurve:
    """A curve from a to b: a line, a cubic with an inner knot, or an arc with a weight."""
    across = np.array([b[1] - a[1], a[0] - b[0]]) * bulge
    if kind == "line":
        return straight(a, b)
    if kind == "arc":
        knots = np.array([0.25, 0.25, 0.25, 1.75, 1.75, 1.75])
        return TrimCurve(np.array([a, 0.5 * (a + b) + across, b]), knots, 2, np.array([1.0, np.sqrt(0.5), 1.0]))
    inner = [a + (b - a) * share + across * lift for share, lift in ((0.2, 0.6), (0.45, 1.0), (0.8, -0.5))]
    knots = np.array([0.0, 0, 0, 0, 1 / 3, 1, 1, 1, 1])
    return TrimCurve(np.array([a, *inner, b]), knots, 3)


def polygon(kinds: list[str], corners: Array, bulge: float, outer: bool) -> TrimLoop:
    ends = zip(kinds, corners, np.roll(corners, -1, axis=0), strict=True)
    return TrimLoop(tuple(side(kind, a, b, bulge) for kind, a, b in ends), outer)


def circle(centre: tuple[float, float], radius: float, outer: bool = False) -> TrimLoop:
    """Four quarter circles, clockwise around a hole."""
    turn = np.array([(1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0)]) * radius + centre
    knots, weights = np.array([0.0, 0, 0, 1, 1, 1]), np.array([1.0, np.sqrt(0.5), 1.0])
    return TrimLoop(tuple(TrimCurve(turn[k : k + 3], knots, 2, weights) for k in (0, 2, 4, 6)), outer)


KINDS = st.sampled_from(["line", "spline", "arc"])


@st.composite
def trimmed_faces(draw: st.DrawFn) -> BSplineSurface:
    kinds = draw(st.lists(KINDS, min_size=4, max_size=6))
    turn = draw(st.floats(0.0, 1.0))
    angles = 2 * np.pi * (np.arange(len(kinds)) + turn) / len(kinds)
    corners = np.column_stack([0.5 + 1.2 * np.cos(angles), 2.5 + 2.0 * np.sin(angles)])
    loops = [polygon(kinds, corners, draw(st.floats(-0.1, 0.1)), True)]
    for centre in draw(st.sets(st.sampled_from([(0.2, 2.0), (0.8, 2.9), (0.5, 2.45)]), max_size=3)):
        loops.append(circle(centre, draw(st.floats(0.02, 0.12))))
    degree = draw(st.tuples(st.integers(1, 3), st.integers(1, 3)))
    return surface(degree, draw(st.booleans()), tuple(loops), draw(st.integers(0, 1000)))


def tube(trims: tuple[TrimLoop, ...] | None, pole: bool = False, smooth: bool = True) -> BSplineSurface:
    """Closed in u over [0, 4], clamped, rational: nine columns of a circle; with a pole where v begins."""
    turn = np.array([(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0)], dtype=np.float64)
    radii = np.array([0.0 if pole else 7.3, 11.1, 9.7, 12.9])
    heights = np.array([0.0, 0.1 if pole else 3.3, 21.7, 33.1])
    net = np.concatenate(
        [turn[:, None] * radii[:, None], np.broadcast_to(heights[:, None], (9, 4, 1))], axis=2, dtype=np.float64
    )
    weights = np.where(np.arange(9)[:, None] % 2, np.sqrt(0.5), 1.0) * np.ones(4)
    if not smooth:
        net[0, 1:], net[-1, 1:] = net[0, 1:] * [1.3, 1.0, 1.0], net[-1, 1:] * [1.3, 1.0, 1.0]
    knots_u = np.array([0.0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4])
    knots_v = np.array([0.0, 0, 0, 0, 1, 1, 1, 1])
    return BSplineSurface(net, knots_u, knots_v, 2, 3, weights, trims=trims, name="tube")


def belt(bulge: float) -> TrimLoop:
    """All around the tube between two curves, with the seam on both sides."""
    corners = np.array([(0.0, 0.3), (4.0, 0.3), (4.0, 0.8), (0.0, 0.8)])
    return polygon(["spline" if bulge else "line", "line", "arc" if bulge else "line", "line"], corners, bulge, True)


# ------------------------------------------------------------------ comparing


def through(part: Part, format: str, folder: Path) -> Part:
    """Written and read again; two writes give the same bytes."""
    path, twin = folder / f"part{SUFFIX[format]}", folder / "twin" / f"part{SUFFIX[format]}"
    twin.parent.mkdir(exist_ok=True)
    part.write(path, format)
    part.write(twin, format)
    assert path.read_bytes() == twin.read_bytes()
    return registry.read(path)


def same_net(a: BSplineSurface, b: BSplineSurface, *, exact: bool = True) -> None:
    """The same knots and control points; to rounding where the kernel made a rational surface periodic on the way."""
    np.testing.assert_array_equal(a.knots_u, b.knots_u)
    np.testing.assert_array_equal(a.knots_v, b.knots_v)
    assert (a.degree_u, a.degree_v, a.shape) == (b.degree_u, b.degree_v, b.shape)
    if exact:
        np.testing.assert_array_equal(a.control_points, b.control_points)
    np.testing.assert_allclose(a.control_points, b.control_points, rtol=0, atol=2e-15 * a.size)
    assert (a.weights is None) == (b.weights is None)
    if a.weights is not None and b.weights is not None:
        np.testing.assert_allclose(a.weights / a.weights.max(), b.weights / b.weights.max(), rtol=1e-15)


def same_trims(a: BSplineSurface, b: BSplineSurface) -> None:
    """Every curve of one has its own in the other, run either way: the same places at equal shares of the parameter."""
    assert (a.trims is None) == (b.trims is None)
    if a.trims is None or b.trims is None:
        return
    assert sorted(len(loop.curves) for loop in a.trims) == sorted(len(loop.curves) for loop in b.trims)
    span = np.subtract(*np.array(a.domain).T[::-1])
    left = [places(curve) / span for loop in b.trims for curve in loop.curves]
    for curve in (curve for loop in a.trims for curve in loop.curves):
        here = places(curve) / span
        apart = [min(np.abs(here - other).max(), np.abs(here - other[::-1]).max()) for other in left]
        best = int(np.argmin(apart))
        assert apart[best] <= SAME
        del left[best]


def places(curve: TrimCurve) -> Array:
    return evaluate_trim(curve, np.linspace(*trim_domain(curve), 13))


# -------------------------------------------------------------------- round trips


@pytest.mark.parametrize("format", SUFFIX)
@QUIET
@given(face=trimmed_faces(), units=st.sampled_from(["mm", "in"]))
def test_trims_come_back(format: str, face: BSplineSurface, units: str, tmp_path: Path) -> None:
    back = through(PatchPart(tmp_path / "x.json", "json", units, [face]), format, tmp_path)
    same_trims(face, back.faces[0].surface)
    np.testing.assert_array_equal(back.faces[0].surface.knots_u, face.knots_u)
    if units == "mm":
        same_net(face, back.faces[0].surface)


CLOSED: dict[str, Callable[[], BSplineSurface]] = {
    "tube": lambda: tube(None),
    "tube with a crease along its seam": lambda: tube(None, smooth=False),
    "cup": lambda: tube(None, pole=True),
    "tube with a hole": lambda: tube((belt(0.0), circle((1.3, 0.55), 0.08))),
    "belt": lambda: tube((belt(0.03),)),
    "window": lambda: tube((circle((2.2, 0.5), 0.2, outer=True),)),
    "window at the seam": lambda: tube(
        (polygon(["spline", "line", "arc", "line"], np.array([(0, 0.2), (1, 0.3), (1, 0.9), (0, 0.8)]), 0.05, True),)
    ),
}


@pytest.mark.parametrize("format", SUFFIX)
@pytest.mark.parametrize("name", CLOSED)
def test_closed_surfaces_stay_clamped(name: str, format: str, tmp_path: Path) -> None:
    face = CLOSED[name]()
    back = through(PatchPart(tmp_path / "x.json", "json", "mm", [face]), format, tmp_path)
    assert back.validity().valid, back.validity().faults
    found = back.faces[0].surface
    assert not found.periodic_u
    same_net(face, found, exact=False)
    same_trims(face, found)
    assert back.faces[0].area == pytest.approx(PatchPart(tmp_path, "json", "mm", [face]).faces[0].area, rel=1e-9)


@pytest.mark.parametrize("steps", [("step", "iges", "step"), ("iges", "step", "iges")])
def test_nothing_drifts_from_format_to_format(steps: tuple[str, ...], tmp_path: Path) -> None:
    kinds = ["spline", "arc", "line", "spline"]
    loops = (
        polygon(kinds, np.array([(-0.7, 0.4), (1.7, 0.6), (1.6, 4.4), (-0.8, 4.6)]), 0.08, True),
        circle((0.5, 2.5), 0.3),
    )
    face = surface((3, 2), True, loops, 5)
    part: Part = PatchPart(tmp_path / "x.json", "json", "mm", [face])
    for step in steps:
        part = registry.read(through(part, step, tmp_path).path)
        same_net(face, part.faces[0].surface)
        same_trims(face, part.faces[0].surface)


# ----------------------------------------------------------------- what is not believed


@pytest.mark.parametrize("system", ["cadsculpt", "another"])
@pytest.mark.parametrize("shift", [0.02, 0.3])
def test_a_trim_curve_that_strays_from_its_edge_is_not_believed(system: str, shift: float, tmp_path: Path) -> None:
    """Its control points moved in the text: the edge in space stays, and the kernel's own curve along it."""
    kinds = ["spline", "line", "line", "line"]
    loop = polygon(kinds, np.array([(-0.7, 0.4), (1.7, 0.4), (1.7, 4.4), (-0.7, 4.4)]), 0.05, True)
    face = surface((3, 2), False, (loop,), 3)
    PatchPart(tmp_path / "x.json", "json", "mm", [face]).write(tmp_path / "a.step", "step")
    text = (tmp_path / "a.step").read_text().replace("'cadsculpt ", f"'{system} ")
    points = loop.curves[0].control_points[1:-1]
    for u, v in points.tolist():
        pattern = rf"\(\s*{re.escape(repr(u))}\s*,\s*{re.escape(repr(v))}\s*\)"
        text, count = re.subn(pattern, f"({u!r},{v + shift!r})", text)
        assert count == 1
    (tmp_path / "b.step").write_text(text)
    found = registry.read(tmp_path / "b.step").faces[0]
    truth = face.evaluate(*places(loop.curves[0]).T)
    curves = [curve for each in found.surface.trims or () for curve in each.curves]
    lines = [found.surface.evaluate(*evaluate_trim(curve, np.linspace(*trim_domain(curve), 400)).T) for curve in curves]
    nearest = min(np.linalg.norm(truth[:, None] - line, axis=2).min(axis=1).max() for line in lines)
    assert nearest < 0.3  # the samples' own spacing; the shift is more than 0.35 mm


def test_the_kernel_mends_files_of_others_as_before(tmp_path: Path) -> None:
    """It keeps its values from one file to the next."""

    def value(own: bool) -> str:
        reader = IGESCAFControl_Reader()
        reader.ReadFile(str(tmp_path / "part.igs"))
        set_healing(reader, "iges", own=own)
        key = TCollection_AsciiString("FixShape.FixIntersectingEdgesMode")
        return str(reader.GetShapeFixParameters().Find(key).ToCString())

    PatchPart(tmp_path, "json", "mm", [tube(None)]).write(tmp_path / "part.igs", "iges")
    IGESControl_Controller.Init_s()
    assert [value(own) for own in (False, True, False)] == ["-1", "0", "-1"]


# ------------------------------------------------------------------------ real files

REAL = [
    ("iges/PRO20359-L1.igs", "step"),
    ("iges/PRO20360-T2.igs", "step"),
    ("iges/OCC8842_cylinder_Ideas.igs", "step"),
    ("step/trj4_k1_geo-ac-214.stp", "iges"),
    ("step/trj4_k1_geo-tu-214.stp", "iges"),
    ("spline/egg.xml", "step"),
    ("spline/sphere.g2", "iges"),
]


@pytest.mark.parametrize(("name", "format"), REAL)
def test_real_trims_come_back(name: str, format: str, corpus: Path, tmp_path: Path) -> None:
    part = registry.read(corpus / name)
    first = [face.surface for face in part.faces if face.kind == "bspline"]
    back = through(part, format, tmp_path)
    assert len(back.faces) == len(part.faces)
    for surface, face in zip(first, (face for face in back.faces if face.kind == "bspline"), strict=True):
        same_trims(surface, face.surface)
        assert face.surface.shape == surface.shape
