"""IGES entities in files made by hand, against closed formulas and against the CAD kernel; files out of shape; writing back."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from math import pi
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import BSpline

pytest.importorskip("OCP")

from cadsculpt.errors import InputError
from cadsculpt.formats import iges
from cadsculpt.formats.iges_curves import curves_of, segment_rows
from cadsculpt.formats.iges_patches import patch_of
from cadsculpt.formats.iges_records import parse
from cadsculpt.formats.iges_rewrite import Change, changed_text
from cadsculpt.formats.occt.shape import shape_of_surface
from cadsculpt.formats.patch_part import PatchPart
from cadsculpt.spline.refine import insert_knots
from cadsculpt.spline.surface import BSplineSurface

Array = NDArray[np.float64]

DEPENDENT = "00010000"
FLAT = "00010500"


class Drawing:
    """An IGES file, entity by entity."""

    def __init__(self, flag: object = 2, unit: str = "MM", separator: str = ",", terminator: str = ";") -> None:
        self.separator, self.terminator = separator, terminator
        self.entities: list[tuple[int, int, str, int, list[str], str]] = []
        self.header = [
            f"1H{separator}", f"1H{terminator}", "4Hpart", "8Hpart.igs", "4Hhand", "1H1", "32", "38", "6", "308", "15",
            "", "1.0", str(flag), f"{len(unit)}H{unit}" if unit else "", "1", "0.01", "15H20200202.020202", "1E-6", "100.",
            "2Hme", "4Hhome", "11", "0", "15H20200202.020202",
        ]  # fmt: skip

    def add(
        self, kind: int, *values: object, form: int = 0, status: str = "00000000", matrix: int = 0, label: str = ""
    ) -> int:
        """Add an entity; returns its place in the directory."""
        flat: list[object] = []
        for value in values:
            flat += list(np.ravel(value).tolist()) if isinstance(value, (list, tuple, np.ndarray)) else [value]
        parameters = [str(kind), *(value if isinstance(value, str) else repr(value) for value in flat)]
        self.entities.append((kind, form, status, matrix, parameters, label))
        return 2 * len(self.entities) - 1

    def text(self) -> str:
        out: list[str] = []

        def put(content: str, letter: str, number: int) -> None:
            out.append(f"{content:<72}{letter}{number:>7}")

        put("made by hand", "S", 1)
        header = self._wrapped(self.header, 72)
        for n, line in enumerate(header, 1):
            put(line, "G", n)
        lines: list[str] = []
        directory: list[str] = []
        for i, (kind, form, status, matrix, parameters, label) in enumerate(self.entities):
            own = self._wrapped(parameters, 64)
            first = [kind, len(lines) + 1, 0, 0, 0, 0, matrix, 0, status]
            second = [kind, 0, 0, len(own), form, "", "", label, 0]
            directory += ["".join(f"{field:>8}" for field in row) for row in (first, second)]
            lines += [f"{line:<64}{2 * i + 1:>8}" for line in own]
        for n, line in enumerate(directory, 1):
            put(line, "D", n)
        for n, line in enumerate(lines, 1):
            put(line, "P", n)
        put(f"S{1:>7}G{len(header):>7}D{len(directory):>7}P{len(lines):>7}", "T", 1)
        return "\n".join(out) + "\n"

    def _wrapped(self, parameters: Sequence[str], width: int) -> list[str]:
        lines, line = [], ""
        for i, parameter in enumerate(parameters):
            piece = parameter + (self.terminator if i == len(parameters) - 1 else self.separator)
            if len(line) + len(piece) > width:
                lines.append(line)
                line = ""
            line += piece
        return [*lines, line]

    # ------------------------------------------------------------- entities

    def line(self, a: Sequence[float], b: Sequence[float], status: str = DEPENDENT) -> int:
        return self.add(110, *map(float, (*a, *b)), status=status)

    def lines(self, points: Sequence[Sequence[float]], status: str = DEPENDENT) -> int:
        pieces = [self.line(a, b, status) for a, b in zip(points, [*points[1:], points[0]], strict=True)]
        return self.add(102, len(pieces), pieces, status=status)

    def bilinear(self, corners: Sequence[Sequence[float]], **options: object) -> int:
        """A 128 over the unit square; corners at (0, 0), (1, 0), (0, 1), (1, 1)."""
        ends = [0.0, 0.0, 1.0, 1.0]
        values = [
            1,
            1,
            1,
            1,
            0,
            0,
            1,
            0,
            0,
            *ends,
            *ends,
            *[1.0] * 4,
            *np.ravel(corners).astype(float).tolist(),
            0.0,
            1.0,
            0.0,
            1.0,
        ]
        return self.add(128, *values, **options)  # type: ignore[arg-type]

    def sheet(self, **options: object) -> int:
        """20 x 10 in the plane z = 0."""
        return self.bilinear([(0, 0, 0), (20, 0, 0), (0, 10, 0), (20, 10, 0)], **options)

    def spline(self, surface: BSplineSurface, **options: object) -> int:
        r, s = surface.shape
        weights = np.ones((r, s)) if surface.weights is None else surface.weights
        flags = [0, 0, int(surface.weights is None), 0, 0]
        (a, b), (c, d) = surface.domain
        net = surface.control_points.transpose(1, 0, 2)
        head = [r - 1, s - 1, surface.degree_u, surface.degree_v, *flags]
        return self.add(128, *head, surface.knots_u, surface.knots_v, weights.T, net, a, b, c, d, **options)  # type: ignore[arg-type]


def read(drawing: Drawing | str, folder: Path) -> iges.IgesPart:
    path = folder / "hand.igs"
    text = drawing if isinstance(drawing, str) else drawing.text()
    path.write_bytes(text.encode("latin-1"))
    return iges.read(path)


def area(part: iges.IgesPart) -> float:
    assert len(part.faces) == 1
    return part.faces[0].area


def own_area(drawing: Drawing) -> float:
    """Area of the only face by the reader that does without the kernel's."""
    file = parse(drawing.text())
    (entity,) = iges.faces_of(file)
    surface, _ = patch_of(file, entity)
    return PatchPart(Path("x"), "json", "mm", [surface]).faces[0].area


# --------------------------------------------------------------------- surfaces


def ruled(d: Drawing) -> None:
    d.add(118, d.line((0, 0, 0), (10, 0, 0)), d.line((0, 5, 0), (10, 5, 0)), 0, 0, form=1)


def ruled_crosswise(d: Drawing) -> None:
    """Its rulings cross in the middle: the integral of 50 |1 - 2 v|."""
    d.add(118, d.line((0, 0, 0), (10, 0, 0)), d.line((0, 5, 0), (10, 5, 0)), 1, 0, form=1)


def revolved_line(d: Drawing) -> None:
    d.add(120, d.line((0, 0, 0), (0, 0, 1)), d.line((3, 0, 0), (3, 0, 7)), 0.0, 2 * pi)


def revolved_part_of_a_turn(d: Drawing) -> None:
    d.add(120, d.line((0, 0, 0), (0, 0, 1)), d.line((3, 0, 0), (3, 0, 7)), 0.5, 2.0)


def cone(d: Drawing) -> None:
    d.add(120, d.line((0, 0, 0), (0, 0, 1)), d.line((3, 0, 0), (1, 0, 2)), 0.0, 2 * pi)


def tabulated_circle(d: Drawing) -> None:
    d.add(122, d.add(100, 0.0, 0.0, 0.0, 3.0, 0.0, 3.0, 0.0, status=DEPENDENT), 3.0, 0.0, 7.0)


def tabulated_aslant(d: Drawing) -> None:
    d.add(122, d.line((0, 0, 0), (4, 0, 0)), 1.0, 5.0, 2.0)


def bounded_plane(d: Drawing) -> None:
    d.add(108, 0.0, 0.0, 1.0, 2.0, d.lines([(0, 0, 2), (10, 0, 2), (10, 5, 2), (0, 5, 2)]), 0.0, 0.0, 0.0, 0.0, form=1)


def bounded_plane_round(d: Drawing) -> None:
    d.add(108, 0.0, 0.0, 1.0, 2.0, d.add(100, 2.0, 0.0, 0.0, 3.0, 0.0, 3.0, 0.0, status=DEPENDENT), *[0.0] * 4, form=1)


def offset_plane(d: Drawing) -> None:
    d.add(140, 0.0, 0.0, 1.0, 2.0, d.sheet(status=DEPENDENT))


def power_patches(d: Drawing) -> None:
    """Two patches of 114 along u, x = 2 u, y = 5 v, z = 3 u: a plane of 12 x 5 aslant."""

    def block(x0: float, x: float, y: float, z0: float, z: float) -> list[float]:
        value = np.zeros((3, 4, 4))  # power of v, power of u
        value[0, 0, :2] = x0, x
        value[1, 1, 0] = y
        value[2, 0, :2] = z0, z
        return value.ravel().tolist()

    nothing = [0.0] * 48
    d.add(
        114, 3, 1, 2, 1, 0.0, 2.0, 6.0, 0.0, 1.0,
        block(0, 2, 5, 0, 3), nothing, block(4, 2, 5, 6, 3), nothing,
    )  # fmt: skip


def bilinear_aslant(d: Drawing) -> None:
    d.bilinear([(0, 0, 0), (3, 0, 4), (0, 10, 0), (3, 10, 4)])


def quarter_cylinder(d: Drawing) -> None:
    w = 0.5**0.5
    net = np.array([[(3, 0, z), (3, 3, z), (0, 3, z)] for z in (0, 7)], float).transpose(1, 0, 2)
    weights = np.array([[1, 1], [w, w], [1, 1]])
    d.spline(BSplineSurface(net, np.array([0.0, 0, 0, 1, 1, 1]), np.array([0.0, 0, 1, 1]), 2, 1, weights))


FORMULAS: dict[str, tuple[Callable[[Drawing], None], float]] = {
    "118": (ruled, 50.0),
    "118 crosswise": (ruled_crosswise, 25.0),
    "120": (revolved_line, 2 * pi * 3 * 7),
    "120 in part": (revolved_part_of_a_turn, 1.5 * 3 * 7),
    "120 cone": (cone, pi * (3 + 1) * 8**0.5),
    "122": (tabulated_circle, 2 * pi * 3 * 7),
    "122 aslant": (tabulated_aslant, 4 * 29**0.5),
    "108": (bounded_plane, 50.0),
    "108 round": (bounded_plane_round, 9 * pi),
    "140": (offset_plane, 200.0),
    "114": (power_patches, 5 * (12**2 + 18**2) ** 0.5),
    "128": (bilinear_aslant, 50.0),
    "128 rational": (quarter_cylinder, 0.5 * pi * 3 * 7),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_areas_are_those_of_the_formulas(name: str, tmp_path: Path) -> None:
    build, wanted = FORMULAS[name]
    drawing = Drawing()
    build(drawing)
    assert area(read(drawing, tmp_path)) == pytest.approx(wanted, rel=1e-8)
    if name.startswith(("114", "128")):
        assert own_area(drawing) == pytest.approx(wanted, rel=1e-9)


def test_the_kernel_and_we_read_the_same_splines(tmp_path: Path) -> None:
    for build in (power_patches, bilinear_aslant, quarter_cylinder):
        drawing = Drawing()
        build(drawing)
        theirs = read(drawing, tmp_path).faces[0].surface
        file = parse(drawing.text())
        ours, _ = patch_of(file, iges.faces_of(file)[0])
        u, v = (np.linspace(*side, 9) for side in ours.domain)
        grid = np.meshgrid(u, v)
        np.testing.assert_allclose(theirs.evaluate(*grid), ours.evaluate(*grid), atol=1e-13)


# --------------------------------------------------------------------- trims

SQUARE = [(0.2, 0.2), (0.8, 0.2), (0.8, 0.7), (0.2, 0.7)]
HOLE = [(0.4, 0.3), (0.4, 0.5), (0.6, 0.5), (0.6, 0.3)]
TRIMMED = 20 * 10 * 0.6 * 0.5
HOLLOW = TRIMMED - 20 * 10 * 0.2 * 0.2


def in_space(points: Sequence[Sequence[float]]) -> list[tuple[float, float, float]]:
    return [(20 * u, 10 * v, 0.0) for u, v in points]


def on_surface(d: Drawing, surface: int, loop: Sequence[Sequence[float]], flat: str, space: bool) -> int:
    """142; flat is "yes", "no", "outside" (curves that leave the surface) or "elsewhere" (not where the others are)."""
    moved = {"outside": (5.0, 0.0), "elsewhere": (0.15, 0.1)}.get(flat, (0.0, 0.0))
    places = [(u + moved[0], v + moved[1], 0.0) for u, v in loop]
    plane = d.lines(places, FLAT) if flat != "no" else 0
    return d.add(142, 1, surface, plane, d.lines(in_space(loop)) if space else 0, 2 if space else 1, status=DEPENDENT)


@pytest.mark.parametrize(
    ("flat", "space"),
    [("yes", True), ("yes", False), ("no", True), ("outside", True), ("elsewhere", True)],
)
def test_trimmed_surfaces(flat: str, space: bool, tmp_path: Path) -> None:
    """144 with 142: what the parameter plane lacks, or has wrong, comes from the curves in space."""
    d = Drawing()
    surface = d.sheet(status=DEPENDENT)
    outer, inner = on_surface(d, surface, SQUARE, flat, space), on_surface(d, surface, HOLE, flat, space)
    d.add(144, surface, 1, 1, outer, inner)
    assert area(read(d, tmp_path)) == pytest.approx(HOLLOW, rel=1e-7)
    assert own_area(d) == pytest.approx(HOLLOW, rel=1e-6)
    file = parse(d.text())
    said = patch_of(file, iges.faces_of(file)[0])[1]
    assert bool(said) == (flat != "yes")


def test_a_hole_in_a_whole_surface(tmp_path: Path) -> None:
    d = Drawing()
    surface = d.sheet(status=DEPENDENT)
    d.add(144, surface, 0, 1, 0, on_surface(d, surface, HOLE, "yes", True))
    assert area(read(d, tmp_path)) == pytest.approx(200 - 8, rel=1e-7)
    assert own_area(d) == pytest.approx(200 - 8, rel=1e-7)


def bounded(d: Drawing, flat: bool) -> None:
    """143 with a 141 whose curves have their pieces in the parameter plane, or not."""
    surface = d.sheet(status=DEPENDENT)
    values: list[int] = []
    for a, b in zip(SQUARE, [*SQUARE[1:], SQUARE[0]], strict=True):
        (p, q), line = in_space([a, b]), d.line
        values += [line(p, q), 1, int(flat)]
        if flat:
            values.append(line((*a, 0), (*b, 0), FLAT))
    boundary = d.add(141, int(flat), 1 + int(flat), surface, 4, values, status=DEPENDENT)
    d.add(143, int(flat), surface, 1, boundary)


@pytest.mark.parametrize("flat", [True, False])
def test_bounded_surfaces(flat: bool, tmp_path: Path) -> None:
    d = Drawing()
    bounded(d, flat)
    assert area(read(d, tmp_path)) == pytest.approx(TRIMMED, rel=1e-7)
    assert own_area(d) == pytest.approx(TRIMMED, rel=1e-6)


def shell_of_two(d: Drawing, solid: bool = False) -> None:
    """510 twice in a 514: two rectangles, 20 x 10 and 20 x 5, at a right angle along an edge they share."""
    corners = np.array([(0, 0, 0), (20, 0, 0), (20, 10, 0), (0, 10, 0), (20, 0, 5), (0, 0, 5)], float)
    vertices = d.add(502, 6, corners, form=1, status=DEPENDENT)
    ends = [(1, 2), (2, 3), (3, 4), (4, 1), (2, 5), (5, 6), (6, 1)]
    curves = [d.line(corners[a - 1], corners[b - 1]) for a, b in ends]
    values = [[curve, vertices, a, vertices, b] for curve, (a, b) in zip(curves, ends, strict=True)]
    edges = d.add(504, 7, values, form=1, status=DEPENDENT)
    low = d.bilinear(corners[[0, 1, 3, 2]], status=DEPENDENT)
    high = d.bilinear(corners[[0, 1, 5, 4]], status=DEPENDENT)
    faces = []
    for surface, loop in ((low, [(1, 1), (2, 1), (3, 1), (4, 1)]), (high, [(1, 1), (5, 1), (6, 1), (7, 1)])):
        made = d.add(508, 4, [[0, edges, edge, way, 0] for edge, way in loop], form=1, status=DEPENDENT)
        faces.append(d.add(510, surface, 1, 1, made, form=1, status=DEPENDENT))
    d.add(514, 2, [[face, 1] for face in faces], form=2)


def test_shells_share_their_edges(tmp_path: Path) -> None:
    d = Drawing()
    shell_of_two(d)
    part = read(d, tmp_path)
    assert sorted(face.area for face in part.faces) == pytest.approx([100.0, 200.0], rel=1e-9)
    assert [{n for edge in face.edges for n in edge.neighbours} for face in part.faces] == [{2}, {1}]
    file = parse(d.text())
    areas = [PatchPart(Path("x"), "json", "mm", [patch_of(file, e)[0]]).faces[0].area for e in iges.faces_of(file)]
    assert areas == pytest.approx([200.0, 100.0], rel=1e-6)


# ------------------------------------------------------------- what the kernel lacks


def test_matrices_of_matrices_are_multiplied(tmp_path: Path) -> None:
    """A turn about z after a move along x, the one named by the other: the kernel alone takes the inner one only."""
    d = Drawing()
    turn = d.add(124, 0.0, -1.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    move = d.add(124, 1.0, 0.0, 0.0, 100.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, matrix=turn)
    d.sheet(matrix=move)
    part = read(d, tmp_path)
    np.testing.assert_allclose(part.faces[0].surface.control_points[1, 1], [5 - 10, 120, 0])
    assert any("multiplied" in line for line in part.warnings)
    file = parse(d.text())
    np.testing.assert_allclose(patch_of(file, file.entities[2])[0].control_points[1, 1], [-5, 120, 0])


def test_a_ring_of_matrices_is_an_error(tmp_path: Path) -> None:
    d = Drawing()
    d.add(124, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, matrix=1)
    d.sheet(matrix=1)
    with pytest.raises(InputError, match="refers to itself"):
        read(d, tmp_path)


UNITS = [
    (1, "IN", 25.4), (1, "INCH", 25.4), (2, "MM", 1), (3, "MM", 1), (3, "INCH", 25.4), (3, "millimeter", 1), (3, "dm", 100),
    (3, "YD", 914.4), (3, "FT", 304.8), (4, "FT", 304.8), (5, "MI", 1609344), (6, "M", 1000), (7, "KM", 1e6),
    (8, "MIL", 0.0254), (9, "UM", 1e-3), (10, "CM", 10), (11, "UIN", 2.54e-5), ("", "", 25.4), ("", "CM", 10), (12, "CM", 10),
    (0, "M", 1000),
]  # fmt: skip


@pytest.mark.parametrize(("flag", "name", "mm"), UNITS)
def test_every_unit(flag: object, name: str, mm: float, tmp_path: Path) -> None:
    d = Drawing(flag, name)
    d.sheet()
    part = read(d, tmp_path)
    np.testing.assert_allclose(part.faces[0].surface.control_points[1, 1], [20 * mm, 10 * mm, 0], rtol=1e-15)
    assert bool(part.warnings) == (flag in (12, 0))


@pytest.mark.parametrize(("flag", "name", "said"), [(3, "CUBIT", "not known"), (2, "INCH", "believed")])
def test_units_that_say_nothing_or_two_things(flag: int, name: str, said: str, tmp_path: Path) -> None:
    d = Drawing(flag, name)
    d.sheet()
    part = read(d, tmp_path)
    assert part.faces[0].surface.control_points[1, 1, 0] == 20.0
    assert any(said in line for line in part.warnings)


def test_a_spline_without_its_range(tmp_path: Path) -> None:
    d = Drawing()
    d.sheet()
    d.entities[0][4][-4:] = []
    part = read(d, tmp_path)
    assert area(part) == pytest.approx(200.0, rel=1e-12)
    assert any("last parameters" in line for line in part.warnings)


@pytest.mark.parametrize("style", ["1.D1", "1.0d+01", ".1E2", "10", "10."])
def test_numbers_in_every_style(style: str, tmp_path: Path) -> None:
    d = Drawing()
    d.sheet()
    values = d.entities[0][4]
    values[:] = [style if value == "10.0" else value for value in values]
    assert area(read(d, tmp_path)) == pytest.approx(200.0, rel=1e-12)


# ------------------------------------------------------------------ out of shape


def drawing_of_two() -> Drawing:
    d = Drawing()
    d.sheet(label="LOW")
    d.bilinear([(0, 0, 5), (20, 0, 5), (0, 10, 5), (20, 10, 9)], label="HIGH")
    return d


def spoilt(how: str) -> str:
    text = drawing_of_two().text()
    lines = text.splitlines()
    match how:
        case "no line ends":
            return "".join(lines)
        case "carriage returns":
            return "\r".join(lines)
        case "line numbers cut off":
            return "\n".join(line[:73] for line in lines)
        case "blanks taken out":
            return "\n".join(re.sub(" +", " ", line) if line[72] == "P" else line for line in lines)
        case "parameter lines in another order":
            first = next(i for i, line in enumerate(lines) if line[72] == "P")
            lines[first], lines[first + 1] = lines[first + 1], lines[first]
            return "\n".join(lines)
        case "wrong places in the directory":
            at = [i for i, line in enumerate(lines) if line[72] == "D"][2]
            lines[at] = lines[at][:8] + f"{2:>8}" + lines[at][16:]
            return "\n".join(lines)
        case "too few lines said":
            at = [i for i, line in enumerate(lines) if line[72] == "D"][1]
            lines[at] = lines[at][:24] + f"{1:>8}" + lines[at][32:]
            return "\n".join(lines)
        case "comments everywhere":
            return "\n".join(["a file", *lines[:3], "", "* remark", *lines[3:], "that was all; 1 2 3 P"])
        case "text longer than it says":
            return "\n".join(lines).replace("4Hpart", "2Hpart", 1)
        case "text shorter than it says":
            return "\n".join(lines).replace("4Hpart", "9Hpart", 1)
        case "unit's name longer than it says":
            return "\n".join(lines).replace("2HMM", "8HMM", 1)
    raise AssertionError(how)


SPOILT = [
    "no line ends", "carriage returns", "line numbers cut off", "blanks taken out", "parameter lines in another order",
    "wrong places in the directory", "too few lines said", "comments everywhere", "text longer than it says",
    "text shorter than it says", "unit's name longer than it says",
]  # fmt: skip


@pytest.mark.parametrize("how", SPOILT)
def test_files_out_of_shape_are_read(how: str, tmp_path: Path) -> None:
    sound = read(drawing_of_two(), tmp_path)
    part = read(spoilt(how), tmp_path)
    assert part.units == "mm"
    assert [face.name for face in part.faces] == [face.name for face in sound.faces] == ["LOW", "HIGH"]
    for face, other in zip(part.faces, sound.faces, strict=True):
        np.testing.assert_array_equal(face.surface.control_points, other.surface.control_points)
    assert bool(part.warnings) == (how not in ("carriage returns", "comments everywhere"))


@pytest.mark.parametrize("delimiters", ["/#", "|!", ":;", "_$"])
def test_other_delimiters(delimiters: str, tmp_path: Path) -> None:
    d = Drawing(separator=delimiters[0], terminator=delimiters[1])
    d.sheet()
    assert area(read(d, tmp_path)) == pytest.approx(200.0, rel=1e-12)


def test_a_blank_head(tmp_path: Path) -> None:
    d = Drawing()
    d.header = [""] * 25
    d.sheet()
    part = read(d, tmp_path)
    assert (part.units, area(part)) == ("in", pytest.approx(200 * 25.4**2))


@pytest.mark.parametrize(("letter", "form"), [("C", "compressed"), ("B", "binary")])
def test_forms_that_are_no_lines_are_refused_by_name(letter: str, form: str, tmp_path: Path) -> None:
    text = f"{'':<72}{letter}{1:>7}\n" + drawing_of_two().text()
    with pytest.raises(InputError, match=form):
        read(text, tmp_path)


def test_what_the_kernel_drops_is_read_here_and_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel is kept from one of the faces: it comes all the same, with its name, and a warning says how."""
    d = drawing_of_two()
    whole = read(d, tmp_path)
    looked_up = iges.text_of

    def without(file: object) -> str:
        made = parse(d.text())
        made.entities[0].fields[0] = made.entities[0].fields[10] = "     406"
        made.entities[0].parameters = ["406", "0"]
        return looked_up(made)

    monkeypatch.setattr(iges, "for_kernel", lambda file, unit: (file, []))
    monkeypatch.setattr(iges, "text_of", without)
    part = read(d, tmp_path)
    assert any("drops 1 of its 2 faces" in line for line in part.warnings)
    mine = part.faces["LOW"].surface
    np.testing.assert_array_equal(mine.control_points, whole.faces["LOW"].surface.control_points)
    assert len(part.faces) == 2


# ------------------------------------------------------------------------ curves


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_a_part_of_a_spline_is_the_spline(seed: int) -> None:
    """Against scipy: any degree, multiple knots, clamped or not."""
    rng = np.random.default_rng(seed)
    degree = int(rng.integers(1, 6))
    count = degree + 1 + int(rng.integers(0, 6))
    knots = np.sort(rng.choice(np.linspace(0, 1, 9), count + degree + 1))
    low, high = knots[degree], knots[count]
    if not low < high or np.unique(knots, return_counts=True)[1].max() > degree + 1:
        return
    points = rng.normal(size=(count, 3))
    a, b = np.sort(rng.uniform(low, high, 2))
    if b - a < 1e-3:
        return
    part, new = segment_rows(points, knots, degree, float(a), float(b))
    t = np.linspace(a, b, 23)[1:-1]
    np.testing.assert_allclose(BSpline(new, part, degree)(t), BSpline(knots, points, degree)(t), atol=1e-9)


def test_curves_of_every_kind() -> None:
    d = Drawing()
    d.add(100, 2.0, 1.0, 1.0, 1.0, 4.0, 4.0, 1.0, status=DEPENDENT)  # three quarters, radius 3, z = 2
    d.add(106, 2, 3, [(0.0, 0, 0), (1.0, 0, 0), (1.0, 1, 0)], form=12)
    d.add(
        112,
        3,
        1,
        3,
        2,
        0.0,
        1.0,
        3.0,
        [[1.0, 2, 0, 0], [0.0, 0, 1, 0], [0.0, 0, 0, 0]],
        [[3.0, 1, 0, 0], [1.0, 2, 0, 0], [0.0] * 4],
    )
    d.add(126, 2, 2, 0, 0, 1, 0, [0.0, 0, 0, 1, 1, 1], [1.0] * 3, [(0.0, 0, 0), (1.0, 2, 0), (2.0, 0, 0)], 0.25, 0.75)
    file = parse(d.text())
    (arc,) = curves_of(file, 1)
    radius = np.hypot(*(sampled(arc.control_points, arc.knots, 2, arc.weights)[:, :2] - 1).T)
    np.testing.assert_allclose(radius, 3.0)
    np.testing.assert_allclose(arc.control_points[[0, -1]], [(1, 4, 2), (4, 1, 2)])
    (line,) = curves_of(file, 3)
    np.testing.assert_array_equal(line.control_points[:, 0], [0, 1, 1])
    (cubic,) = curves_of(file, 5)
    points = sampled(cubic.control_points, cubic.knots, 3, None, np.array([0.5, 1.0, 2.0]))
    np.testing.assert_allclose(points, [(2, 0.25, 0), (3, 1, 0), (4, 3, 0)])
    (part,) = curves_of(file, 7)
    np.testing.assert_allclose(part.control_points[[0, -1], 0], [0.5, 1.5])


def sampled(points: Array, knots: Array, degree: int, weights: Array | None, t: Array | None = None) -> Array:
    w = np.ones(len(points)) if weights is None else weights
    t = np.linspace(knots[0], knots[-1], 31) if t is None else t
    values = BSpline(knots, np.column_stack([points * w[:, None], w]), degree)(t)
    return values[:, :3] / values[:, 3:]


# ------------------------------------------------------------------ writing back


def wavy(shift: float = 0.0) -> BSplineSurface:
    """7 x 6, bicubic, numbers that no short decimal holds."""
    rng = np.random.default_rng(3)
    knots = [np.concatenate([[0.0] * 4, np.linspace(0, 1, n - 2)[1:-1] + 1 / 97, [1.0] * 4]) for n in (7, 6)]
    x, y = np.meshgrid(np.linspace(0, 60, 7), np.linspace(0, 50, 6), indexing="ij")
    return BSplineSurface(np.stack([x, y, rng.random((7, 6)) / 3 + shift], axis=2), *knots, 3, 3)


def dented(surface: BSplineSurface, rows: slice, columns: slice, depth: float = 2.0) -> BSplineSurface:
    net = surface.control_points.copy()
    net[rows, columns, 2] -= depth
    return surface.with_control_points(net)


def file_of_three() -> Drawing:
    d = Drawing(1, "INCH")
    d.spline(wavy(), label="LOW")
    surface = d.spline(wavy(9.0), status=DEPENDENT)
    loop = d.lines([(*p, 0.0) for p in SQUARE], FLAT)
    corners = wavy(9.0).evaluate(*np.array([*SQUARE, SQUARE[0]]).T)
    sides = []
    for a, b in zip(corners[:-1], corners[1:], strict=True):
        sides.append(d.line(a, b))
    space = d.add(102, 4, sides, status=DEPENDENT)
    d.add(144, surface, 1, 0, d.add(142, 1, surface, loop, space, 1, status=DEPENDENT), label="MID")
    d.spline(wavy(18.0), label="HIGH")
    return d


def differing(before: str, after: str) -> list[int]:
    """Places of the entities whose parameters or directory entries differ; all other lines must be the same but for
    numbers."""
    a, b = parse(before), parse(after)
    assert (a.start, a.header, b.conforms, b.complete) == (b.start, b.header, True, True)
    assert len(a.entities) == len(b.entities)
    keep = [place for place in range(20) if place not in (1, 13)]
    return [
        one.pointer
        for one, other in zip(a.entities, b.entities, strict=True)
        if one.parameters != other.parameters or any(one.fields[k] != other.fields[k] for k in keep)
    ]


@pytest.mark.parametrize("finer", [False, True])
def test_one_face_sculpted_is_one_entity_changed(finer: bool, tmp_path: Path) -> None:
    d = file_of_three()
    part = read(d, tmp_path)
    surface = part.faces["LOW"].surface
    new = insert_knots(surface, [0.111, 0.456], [0.77]) if finer else surface
    new = dented(new, slice(3, 4), slice(2, 4))
    part.sculpt({part.faces["LOW"].number: new})
    part.write(tmp_path / "out.igs", "iges")
    text = (tmp_path / "out.igs").read_bytes().decode("latin-1")
    assert differing(d.text(), text) == [1]
    assert all(len(line) == 80 for line in text.splitlines())
    before, after = parse(d.text()).entities[0].parameters, parse(text).entities[0].parameters
    if not finer:
        # two control points, and of those the heights
        assert sum(x != y for x, y in zip(before, after, strict=True)) == 2
        same = sum(x == y for x, y in zip(d.text().splitlines(), text.splitlines(), strict=True))
        assert same >= len(text.splitlines()) - 2
    again = iges.read(tmp_path / "out.igs")
    np.testing.assert_allclose(again.faces["LOW"].surface.control_points, new.control_points, atol=1e-12)
    for name in ("MID", "HIGH"):
        np.testing.assert_array_equal(again.faces[name].surface.control_points, part.faces[name].surface.control_points)
    part.write(tmp_path / "twice.igs", "iges")
    assert (tmp_path / "twice.igs").read_bytes() == (tmp_path / "out.igs").read_bytes()


def test_a_border_that_moves_takes_its_curves_along(tmp_path: Path) -> None:
    d = file_of_three()
    part = read(d, tmp_path)
    new = dented(part.faces["MID"].surface, slice(0, 7), slice(0, 3))
    part.sculpt({part.faces["MID"].number: new})
    part.write(tmp_path / "out.igs", "iges")
    text = (tmp_path / "out.igs").read_text("latin-1")
    file = parse(text)
    changed = [file.at(pointer) for pointer in differing(d.text(), text)]
    assert [entity.type for entity in changed if entity] == [128, 126, 126, 126, 126]
    scale = 25.4
    for entity, (a, b) in zip(changed[1:], zip(SQUARE, [*SQUARE[1:], SQUARE[0]], strict=True), strict=True):
        assert entity is not None
        (curve,) = curves_of(file, entity.pointer)
        t = np.linspace(0, 1, 21)
        truth = new.evaluate(a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t)
        places = curve.knots[0] + t * (curve.knots[-1] - curve.knots[0])
        found = sampled(curve.control_points, curve.knots, curve.degree, curve.weights, places) * scale
        assert np.abs(found - truth).max() < 1e-6 * new.size
    again = iges.read(tmp_path / "out.igs")
    assert again.validity().valid
    assert again.faces["MID"].area == pytest.approx(part.faces["MID"].area, rel=1e-9)


def test_an_unsculpted_file_is_the_file_that_went_in(tmp_path: Path) -> None:
    text = file_of_three().text().replace("\n", "\r\n")
    read(text, tmp_path).write(tmp_path / "out.igs", "iges")
    assert (tmp_path / "out.igs").read_bytes() == text.encode()


def test_other_units_make_another_file(tmp_path: Path) -> None:
    """Where --units overrules the file it must not go out saying what was wrong."""
    path = tmp_path / "a.igs"
    path.write_text(file_of_three().text())
    iges.read(path, units="mm").write(tmp_path / "out.igs", "iges")
    again = iges.read(tmp_path / "out.igs")
    assert again.units == "mm"
    assert again.faces["LOW"].surface.control_points.max() == pytest.approx(60.0)


def test_a_matrix_is_undone_on_the_way_back(tmp_path: Path) -> None:
    d = Drawing()
    c, s = 0.6, 0.8
    turn = d.add(124, c, -s, 0.0, 10.0, s, c, 0.0, -3.0, 0.0, 0.0, 1.0, 7.0)
    d.spline(wavy(), matrix=turn)
    part = read(d, tmp_path)
    net = part.faces[0].surface.control_points.copy()
    net[3, 3] += [1.0, 2.0, 3.0]
    part.sculpt({1: part.faces[0].surface.with_control_points(net)})
    part.write(tmp_path / "out.igs", "iges")
    assert differing(d.text(), (tmp_path / "out.igs").read_text()) == [3]
    np.testing.assert_allclose(iges.read(tmp_path / "out.igs").faces[0].surface.control_points, net, atol=1e-12)


def test_what_has_no_control_points_is_written_anew_and_said(tmp_path: Path) -> None:
    d = Drawing()
    d.sheet(label="SHEET")
    revolved_part_of_a_turn(d)
    part = read(d, tmp_path)
    number = next(face.number for face in part.faces if face.kind != "bspline")
    surface = insert_knots(part.faces.number(number).surface, [1.0], [0.3, 0.5])
    part.sculpt({number: dented(surface, slice(2, 3), slice(1, 3), 0.1)})
    part.write(tmp_path / "out.igs", "iges")
    assert any("written anew" in line for line in part.warnings)
    again = iges.read(tmp_path / "out.igs")
    assert [face.area for face in again.faces] == pytest.approx([face.area for face in part.faces], rel=1e-8)


@given(st.data())
@settings(max_examples=25, deadline=None)
def test_any_entity_may_become_any_other(data: st.DataObject) -> None:
    """Longer, shorter, of another type: all other entities stay."""
    d = file_of_three()
    text = d.text()
    file = parse(text)
    pointer = data.draw(st.sampled_from([entity.pointer for entity in file.entities]))
    values = data.draw(st.lists(st.integers(-(10**8), 10**8).map(str), min_size=1, max_size=120))
    made = changed_text(text, file, {pointer: Change(406, 7, ["406", *values])})
    assert differing(text, made) == [pointer]
    back = parse(made).at(pointer)
    assert back is not None
    assert (back.type, back.parameters) == (406, ["406", *values])


def test_shapes_of_read_surfaces_are_faces() -> None:
    """The reader's own surfaces go into the kernel as they are."""
    d = Drawing()
    bounded(d, True)
    file = parse(d.text())
    surface, _ = patch_of(file, iges.faces_of(file)[0])
    assert not shape_of_surface(surface).IsNull()
