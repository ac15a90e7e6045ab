"""G-code: the canonical moves of another interpreter, closed formulas for arcs and times, a name for all that is refused."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cadsculpt.errors import InputError, SceneError
from cadsculpt.formats.paths import gcode, gcode_flow
from cadsculpt.formats.paths.gcode_moves import Move
from cadsculpt.formats.paths.gcode_words import Parameters, Reader
from cadsculpt.formats.paths.machine_axes import MachineAxes
from cadsculpt.motion.path import ToolPath
from cadsculpt.scene_tool import PathOptions

Array = NDArray[np.float64]
END = "\nM2\n"


def path_of(text: str, units: str = "mm", **options: object) -> ToolPath:
    return gcode.parse(text + END, "p.ngc", units, PathOptions.model_validate(options)).path


def moves_of(text: str) -> list[Move]:
    return gcode.canonical_moves(text + END, "p.ngc")[0]


def fault(text: str, **options: object) -> str:
    with pytest.raises(SceneError) as caught:
        gcode.parse(text, "p.ngc", "mm", PathOptions.model_validate(options))
    (line,) = caught.value.faults
    assert "\n" not in line
    return line


def machine_of(path: Path) -> PathOptions:
    return PathOptions(kinematics=f"{path.stem[5:]}-trt" if path.name.startswith("boat") else None)  # type: ignore[arg-type]


# ---------------------------------------------------------------------- truth


PROGRAMS = ("flowsnake", "good-arc.big.imperial", "good-arc.big.metric", "inside-corners")


@pytest.mark.corpus
@pytest.mark.parametrize("name", PROGRAMS)
def test_the_canonical_moves_are_those_of_another_interpreter(corpus: Path, name: str) -> None:
    """All moves, to the digits that are printed, with the feed and the unit that hold for them."""
    folder = corpus / "toolpath" / "expected"
    expected, feed, unit = [], 0.0, ""
    for line in (folder / f"{name}.ngc.expected").read_text().splitlines():
        call = re.search(r"([A-Z_0-9]+)\((.*)\)", line)
        if not call:
            continue
        if call[1] == "SET_FEED_RATE":
            feed = float(call[2])
        elif call[1] == "USE_LENGTH_UNITS" and expected == []:
            unit = {"CANON_UNITS_MM": "mm", "CANON_UNITS_INCHES": "in"}[call[2]]
        elif call[1] in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED", "ARC_FEED", "DWELL"):
            expected.append((call[1], [float(n) for n in call[2].split(",")], feed, unit))
    moves, warnings = gcode.canonical_moves((folder / f"{name}.ngc").read_text(), name)
    assert warnings == []
    assert len(moves) == len(expected) > 1
    for move, (call_name, numbers, held, in_unit) in zip(moves, expected, strict=True):
        ours, _, rest = move.canonical().rstrip(")").partition("(")
        assert ours == call_name
        np.testing.assert_allclose([float(n) for n in rest.split(",")], numbers, rtol=0, atol=1.0001e-4)
        assert (move.unit or "mm") == in_unit
        if move.kind in ("feed", "arc"):
            assert move.feed == held


FILES = {
    "3D_Chips.ngc": (r"{0}\[#<{0}scale>\*(-?[\d.]+)\]", 1.0),
    "arcspiral.ngc": (r"{0}(-?[\d.]+)", 25.4),
    "contour.ngc": (r"{0}(-?[\d.]+)", 25.4),
    "trochoidal.ngc": (r"{0}(-?[\d.]+)", 1.0),
    "wheels.ngc": (r"{0}(-?[\d.]+)", 1.0),
    "boat-xyzac.ngc": (r"{0}(-?[\d.]+)", 1.0),
    "boat-xyzbc.ngc": (r"{0}(-?[\d.]+)", 1.0),
}
ARC_RADIUS = {"arcspiral.ngc": 2.0 * 25.4, "boat-xyzac.ngc": 5.0}


@pytest.mark.corpus
@pytest.mark.parametrize("name", FILES)
def test_real_programs(corpus: Path, name: str) -> None:
    """Their places span what their words say; times run on; every move on straight lines and arcs is there."""
    file = corpus / "toolpath" / name
    path = gcode.read(file, "mm", machine_of(file)).path
    assert (np.diff(path.t) > 0).all()
    assert np.isfinite(path.at).all()
    text = re.sub(r"\([^)]*\)|;.*", "", file.read_text()).lower()
    pattern, factor = FILES[name]
    for axis, letter in enumerate("xyz"):
        words = np.array([float(n) for n in re.findall(pattern.format(letter), text)]) * factor
        low, high = path.at[:, axis].min(), path.at[:, axis].max()
        over = 2.0 * ARC_RADIUS.get(name, 0.0) if letter != "z" else 0.0
        assert words.min() - over - 1e-9 <= low <= min(words.min(), 0.0) + over + 1e-9
        assert max(words.max(), low) - 1e-9 <= high <= max(words.max(), 0.0) + over + 1e-9


@pytest.mark.corpus
@pytest.mark.parametrize("name", [*FILES, *(f"expected/{name}.ngc" for name in PROGRAMS)])
def test_cut_off_programs_warn_or_are_refused(corpus: Path, name: str) -> None:
    file = corpus / "toolpath" / name
    text = file.read_text()
    for tenth in range(1, 10):
        try:
            read = gcode.parse(text[: len(text) * tenth // 10], name, "mm", machine_of(file))
        except InputError as error:
            assert name in str(error)
            continue
        assert any("cut off" in warning for warning in read.warnings)
        assert np.isfinite(read.path.at).all()


@pytest.mark.corpus
def test_one_part_on_two_machines_is_one_path(corpus: Path) -> None:
    """The same cuts for a table that tilts about x and one that tilts about y: same tips, same tool axes.

    The two posts thin the points out differently, so that each cut's points are compared with the other's polyline.
    """
    cuts = []
    for name in ("xyzac", "xyzbc"):
        file = corpus / "toolpath" / f"boat-{name}.ngc"
        options = machine_of(file)
        axes = MachineAxes.of(options)
        assert axes is not None
        moves, _ = gcode.canonical_moves(file.read_text(), name, options)
        poses = [axes.pose(np.array(move.end)) for move in moves if move.inverse and move.kind == "feed"]
        cuts.append(np.array([np.concatenate([at, 10.0 * rotation[:, 2]]) for at, rotation in poses]))
    for here, there in (cuts, cuts[::-1]):
        start, way = there[:-1], np.diff(there, axis=0)
        share = np.einsum("nij,ij->ni", here[:, None] - start, way) / np.maximum(np.einsum("ij,ij->i", way, way), 1e-30)
        nearest = start + np.clip(share, 0.0, 1.0)[..., None] * way
        apart = np.linalg.norm(here[:, None] - nearest, axis=2).min(axis=1)
        assert np.median(apart) < 2e-3
        assert (apart < 0.02).mean() > 0.97
        assert apart.max() < 0.5
    assert len({tuple(np.round(cut[0], 3)) for cut in cuts}) == 1


# ---------------------------------------------------------------------- arcs


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from([17, 18, 19]),
    st.booleans(),
    st.floats(0.1, 50.0),
    st.floats(-3.1, 3.1),
    st.floats(0.05, 6.2),
    st.floats(-20.0, 20.0),
    st.integers(1, 3),
    st.floats(1e-3, 0.5),
)
def test_an_arc_lies_on_its_helix_within_the_chord_error(
    plane: int, clockwise: bool, radius: float, first: float, sweep: float, rise: float, turns: int, tolerance: float
) -> None:
    a, b, c = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}[plane]
    sign = -1.0 if clockwise else 1.0
    centre = np.array([3.0, -2.0, 5.0])
    start, end = np.zeros(3), np.zeros(3)
    start[[a, b]] = centre[[a, b]] + radius * np.array([math.cos(first), math.sin(first)])
    last = first + sign * sweep
    end[[a, b]] = centre[[a, b]] + radius * np.array([math.cos(last), math.sin(last)])
    end[c] = rise
    text = "G0 " + " ".join(f"{n}{x:.12f}" for n, x in zip("XYZ", start, strict=True))
    text += f"\nG{plane} G{2 if clockwise else 3} " + " ".join(f"{n}{x:.12f}" for n, x in zip("XYZ", end, strict=True))
    text += f" {'IJK'[a]}{centre[a] - start[a]:.12f} {'IJK'[b]}{centre[b] - start[b]:.12f} P{turns} F600"
    path = path_of(text, tolerance=tolerance)
    whole = sweep + math.tau * (turns - 1)
    angle = sign * whole * (path.t - path.t[0]) / (path.t[-1] - path.t[0]) + first
    np.testing.assert_allclose(path.at[:, a], centre[a] + radius * np.cos(angle), atol=1e-7)
    np.testing.assert_allclose(path.at[:, b], centre[b] + radius * np.sin(angle), atol=1e-7)
    np.testing.assert_allclose(path.at[:, c], rise * (path.t - path.t[0]) / (path.t[-1] - path.t[0]), atol=1e-7)
    middle = 0.5 * (path.at[:-1] + path.at[1:])
    sag = radius - np.hypot(middle[:, a] - centre[a], middle[:, b] - centre[b])
    assert sag.max() <= tolerance * (1 + 1e-6) + 1e-7
    assert path.duration == pytest.approx(math.hypot(radius * whole, rise) / 10.0, rel=1e-6)


def test_a_whole_circle_a_radius_and_a_centre() -> None:
    circle = path_of("G0 X5 Y0\nG2 I-5 F300", tolerance=1e-4)
    assert circle.length == pytest.approx(10 * math.pi, rel=1e-4)
    assert circle.at[1, 1] < 0.0  # clockwise
    by_centre = path_of("G0 X5\nG3 X0 Y5 I-5 F100")
    np.testing.assert_allclose(path_of("G0 X5\nG3 X0 Y5 R5 F100").at, by_centre.at, atol=1e-12)
    np.testing.assert_allclose(path_of("G0 X5\nG90.1 G3 X0 Y5 I0 J0 F100").at, by_centre.at, atol=1e-12)
    np.testing.assert_allclose(path_of("G0 X5\nG91 G3 X-5 Y5 R5 F100").at, by_centre.at, atol=1e-12)
    assert path_of("G0 X5\nG3 X0 Y5 R-5 F100").length == pytest.approx(15 * math.pi / 2, rel=2e-3)


# ----------------------------------------------------------------------- time


def test_feeds_become_times() -> None:
    def lasts(text: str, units: str = "mm", **options: object) -> float:
        return path_of(text, units, **options).duration

    assert lasts("G0 X0\nG1 X10 F600") == pytest.approx(1.0)
    assert lasts("G20 G0 X0\nG1 X10 F600") == pytest.approx(1.0)
    assert lasts("G20 G0 X0\nG1 X10 F600", "m") == pytest.approx(1.0)
    assert lasts("G0 X0\nG93 G1 X10 F30\nX11 F60") == pytest.approx(3.0)
    assert lasts("G0 X0\nS300 G95 G1 X10 F0.5") == pytest.approx(4.0)
    assert lasts("G0 X0\nG0 X10") == pytest.approx(0.1)
    assert lasts("G0 X0\nG0 X10", rapid=5) == pytest.approx(2.0)
    assert lasts("G20 G0 X0\nG0 X10", "in", rapid=5) == pytest.approx(2.0)
    assert lasts("G0 X0\nG4 P2.5\nG0 X10") == pytest.approx(2.6)
    assert lasts("G0 X0\nG0 X0\nG1 X0 F1\nG0 X10") == pytest.approx(0.1)
    assert lasts("G0 X0 A0\nG1 A90 F180", kinematics="xyzac-trt") == pytest.approx(30.0)
    assert "the feed is not set (write F)" in fault("G1 X1\n")
    assert "write F in every line with G93" in fault("G93 G1 X1 F1\nX2\n")
    assert "no spindle speed" in fault("G95 G1 X1 F1\n")


def test_where_a_path_begins() -> None:
    """Behind the first rapid moves, and not in the part where an axis has not been named yet."""
    np.testing.assert_array_equal(path_of("G0 X10 Y20\nG0 Z5\nG1 Z-1 F100").at, [[10, 20, 5], [10, 20, -1]])
    np.testing.assert_array_equal(path_of("G0 Z5\nG0 X10\nG1 X20 F100").at, [[10, 0, 5], [20, 0, 5]])
    np.testing.assert_array_equal(path_of("G1 X20 F100").at, [[0, 0, 0], [20, 0, 0]])


# ------------------------------------------------------------ modes and offsets


@pytest.mark.parametrize(
    ("text", "last"),
    [
        ("g0x1y2z3", [1, 2, 3]),
        ("N10 G0 X+1. Y.5 (z) ; w\n", [1, 0.5, 0]),
        ("G91 G0 X1\nX1 Y2\nG90 Y5", [2, 5, 0]),
        ("G20 G0 X1\nG21 Y1", [25.4, 1, 0]),
        ("G21 G0 X25.4\nG20 G91 X1", [50.8, 0, 0]),
        ("G0 X5\nG92 X0\nG0 X1", [6, 0, 0]),
        ("G0 X5\nG92 X0\nG92.1\nG0 X1", [1, 0, 0]),
        ("G0 X5\nG92 X0\nG92.2\nG0 X1\nG92.3\nG0 X1", [6, 0, 0]),
        ("G0 X5\nG92 X0\nG20 G0 X1", [30.4, 0, 0]),
        ("G10 L2 P2 X10 Y1\nG55 G0 X1", [11, 0, 0]),
        ("G10 L2 P2 X10\nG55 G0 X1\nG54 G0 Y1", [11, 1, 0]),
        ("G10 L2 P2 X10\nG55 G0 X1\nG53 G0 X1", [1, 0, 0]),
        ("G0 X3\nG10 L20 P1 X0\nG0 X1", [4, 0, 0]),
        ("G59.3 G0 X1", [1, 0, 0]),
        ("G43 H1 G0 Z5\nG49 Z4", [0, 0, 4]),
        ("G0 X1 M3 S100 T1 M6 M8\nM5 M9 G61\nG64 P.1 G40 G80", [1, 0, 0]),
        ("O1000\n:5\nG0 X1", [1, 0, 0]),
        ("G0 X1\nM2\nX9", [1, 0, 0]),
        ("%\nG0 X1\n%\nX9", [1, 0, 0]),
        ("/G0 X1\nG0 Y1", [1, 1, 0]),
    ],
)
def test_modes_and_offsets(text: str, last: list[float]) -> None:
    np.testing.assert_allclose(path_of(text).at[-1], last, atol=1e-12)


def test_warnings_name_the_line() -> None:
    read = gcode.parse("G56 G0 X1\nT1 M6\nT2 M6\nM120\nG28 Z0\n", "p.ngc", "mm")
    assert read.warnings == (
        "p.ngc: line 1: G56 has no offset in this file and is taken as G54's place",
        "p.ngc: line 3: more than one tool is used: the path goes on with the scene's",
        "p.ngc: line 4: M120 is the machine's own and passed over",
        "p.ngc: line 5: G28 goes home, which the file does not say where it is: left out",
        "p.ngc: ends without M2, M30 or %: it may have been cut off",
        "p.ngc: names no unit (G20, G21): its lengths are taken in mm",
    )
    assert gcode.parse("G0 X1\nM2", "p.ngc", "mm", PathOptions(units="in")).path.at[0, 0] == 25.4
    assert path_of("/G0 X1\nG0 Y1", block_delete=True).at[-1, 0] == 0.0


# ---------------------------------------------------------------- expressions


@st.composite
def expressions(draw: st.DrawFn, depth: int = 3) -> tuple[str, float]:
    """An expression in brackets throughout, and its value by Python."""
    if depth == 0 or draw(st.booleans()):
        value = round(draw(st.floats(-50, 50)), 3)
        return f"{value:.3f}", value
    kind = draw(st.sampled_from(["+", "-", "*", "gt", "and", "or", "abs", "sin", "sqrt", "fix", "fup", "minus"]))
    a, x = draw(expressions(depth - 1))
    if kind in ("abs", "sin", "sqrt", "fix", "fup", "minus"):
        value = {
            "abs": abs(x), "sin": math.sin(math.radians(x)), "sqrt": math.sqrt(abs(x)), "fix": float(math.floor(x)),
            "fup": float(math.ceil(x)), "minus": -x,
        }[kind]  # fmt: skip
        return (f"sqrt[abs[{a}]]" if kind == "sqrt" else f"-[{a}]" if kind == "minus" else f"{kind}[{a}]"), value
    b, y = draw(expressions(depth - 1))
    value = {
        "+": x + y, "-": x - y, "*": x * y, "gt": float(x > y), "and": float(bool(x) and bool(y)),
        "or": float(bool(x) or bool(y)),
    }[kind]  # fmt: skip
    return f"[[{a}]{kind}[{b}]]", value


@settings(max_examples=200, deadline=None)
@given(expressions())
def test_expressions_have_pythons_value(pair: tuple[str, float]) -> None:
    text, value = pair
    assert Reader(f"[{text}]", Parameters()).value() == pytest.approx(value, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("[2+3*4]", 14), ("[2**3**2]", 64), ("[10-4-3]", 3), ("[7mod4]", 3), ("[-7mod4]", 1), ("atan[1]/[-1]", 135),
        ("[1+2eq3]", 1), ("[1lt2and3lt4]", 1), ("round[2.5]", 3), ("round[-2.5]", -3), ("ln[exp[1]]", 1),
        ("acos[0.5]", 60), ("asin[0.5]", 30), ("tan[45]", 1), ("cos[60]", 0.5), ("[1xor1]", 0), ("[5ge5]", 1), ("[5le4]", 0),
        ("[5ne4]", 1), ("exists[#<no>]", 0), ("#5", 0), ("##1", 0),
    ],
)  # fmt: skip
def test_precedence_and_functions(text: str, value: float) -> None:
    parameters = Parameters()
    parameters.set(1, 7.0)
    assert Reader(text, parameters).value() == pytest.approx(value, abs=1e-12)


# --------------------------------------------------------------------- o-words


@pytest.mark.parametrize(
    ("text", "last"),
    [
        ("#1=3\n#<a>=[#1+1]\nG0 X#<a>", 4),
        ("#1=3\n#1=5 G0 X#1", 3),  # an assignment holds from the next line on
        ("#1=0\no1 while [#1 lt 5]\n#1=[#1+1]\no1 endwhile\nG0 X#1", 5),
        ("#1=0\no1 do\n#1=[#1+1]\no1 while [#1 lt 5]\nG0 X#1", 5),
        ("#1=0\no1 repeat [4]\n#1=[#1+2]\no1 endrepeat\nG0 X#1", 8),
        ("#1=0\no1 while [1]\n#1=[#1+1]\no2 if [#1 gt 6]\no1 break\no2 endif\no1 endwhile\nG0 X#1", 7),
        ("#1=0 #2=0\no1 repeat [6]\n#1=[#1+1]\no2 if [#1 mod 2]\no1 continue\no2 endif\n#2=[#2+#1]\no1 endrepeat\nG0 X#2", 12),
        ("o1 if [0]\nG0 X1\no1 elseif [1]\nG0 X2\no1 else\nG0 X3\no1 endif", 2),
        ("o1 if [0]\nG0 X1\no1 elseif [0]\nG0 X2\no1 else\nG0 X3\no1 endif", 3),
        ("o<f> sub\no1 if [#1 le 1]\no<f> return [1]\no1 endif\no<f> call [#1-1]\n"
         "o<f> return [#1*#<_value>]\no<f> endsub\no<f> call [5]\nG0 X#<_value>", 120),
        ("o9 sub\nG0 X#1 (Y)\n#1=9\no9 endsub\n#1=4\no9 call [6]\nG0 Y#1", 6),
        ("o9 sub\n#<a>=5\n#<_b>=2\no9 endsub\n#<a>=1\no9 call\nG0 X[#<a>+#<_b>]", 3),
    ],
)  # fmt: skip
def test_flow(text: str, last: float) -> None:
    assert path_of(text).at[-1, 0] == last


def test_programs_without_an_end_do_not_hang(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gcode_flow, "STEPS", 5000)
    assert "p.ngc:1: the program runs more than 5000 lines" in fault("o1 while [1]\no1 endwhile\n")
    assert "p.ngc:2: the program runs more than" in fault("o1 while [1]\nG91 G1 X1 F1\no1 endwhile\n")
    assert "calls in each other" in fault("o1 sub\no1 call\no1 endsub\no1 call\n")
    assert "brackets in each other" in fault("G0 X" + "[" * 500 + "1" + "]" * 500)
    assert "O-words in each other" in fault("".join(f"o{i} if [1]\n" for i in range(1, 200)))
    assert "pieces" in fault("G0 X1\nG3 I-1 P100000 F1\n", tolerance=1e-9)


# ---------------------------------------------------------------- compensation


@pytest.mark.parametrize("side", [1, -1])
def test_a_compensated_square_keeps_its_distance(side: int) -> None:
    """Around a square: the tool's middle is never nearer than its radius, outside with arcs, inside with corners."""
    text = (
        f"G20 G0 X-2 Y0\nG{41.1 if side > 0 else 42.1} D1\nG1 X0 Y0 F10\nY10\nX10\nY0\nX0\n"
        f"G40\nG1 X-2 Y{-2 if side > 0 else 2}"
    )
    moves = [move for move in moves_of(text) if 5 <= move.line <= 6]
    corners = np.array([(0, 0), (0, 10), (10, 10), (10, 0), (0, 0)], dtype=float)
    for move in moves:
        points = np.linspace(move.start[:2], move.end[:2], 50)
        if move.kind == "arc":
            angle = math.atan2(
                move.start[1] - move.centre[1], move.start[0] - move.centre[0]
            ) + move.sweep * np.linspace(0, 1, 50)
            radius = math.dist(move.start[:2], move.centre)
            points = np.array(move.centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        a, way = corners[:-1], np.diff(corners, axis=0)
        share = np.clip(np.einsum("nij,ij->ni", points[:, None] - a, way) / 100.0, 0, 1)
        apart = np.linalg.norm(points[:, None] - (a + share[..., None] * way), axis=2).min(axis=1)
        np.testing.assert_allclose(apart, 0.5, atol=1e-12)
    assert [move.kind for move in moves].count("arc") == (2 if side > 0 else 0)


def test_a_cutter_that_does_not_fit() -> None:
    assert "the cutter is larger than the arc" in fault("G41.1 D4\nG1 X10 F1\nG3 X10 Y2 J1\nG1 X0\nG40\n")
    assert "the cutter does not fit" in fault("G41.1 D4\nG1 X10 F1\nY1\nX0\nG40\n")
    assert "an arc begins the cutter compensation" in fault("G41.1 D4\nG3 X10 R20 F1\n")
    assert "G41.1 has no diameter (write it as D)" in fault("G41.1\n")


# ------------------------------------------------------------------- five axes


@settings(max_examples=50, deadline=None)
@given(
    st.sampled_from(["xyzac-trt", "xyzbc-trt", "xyzac-head", "xyzbc-head"]),
    st.floats(-120, 120),
    st.floats(-360, 360),
    st.tuples(*[st.floats(-50, 50)] * 3),
)
def test_rotary_axes_against_scipy(name: str, tilt: float, turn: float, place: tuple[float, float, float]) -> None:
    """The tool's axis, and with the machine's slides the tip: moving the part or the head brings it where the pose says."""
    axes = MachineAxes.of(PathOptions(kinematics=name, tip=False, pivot=(1, 2, 3), reach=7.0))  # type: ignore[arg-type]
    assert axes is not None
    at, rotation = axes.pose(np.array([*place, tilt, tilt, turn]))
    about = Rotation.from_rotvec(np.radians(tilt) * np.eye(3)[int("ac" not in name)])
    about_z = Rotation.from_rotvec([0, 0, np.radians(turn)])
    pivot = np.array([1.0, 2, 3])
    if name.endswith("trt"):
        carried = about * about_z  # the tilting table carries the rotary one, which carries the part
        np.testing.assert_allclose(carried.apply(at - pivot) + pivot, place, atol=1e-10)
        np.testing.assert_allclose(carried.apply(rotation[:, 2]), [0, 0, 1], atol=1e-12)
    else:
        head = about_z * about
        np.testing.assert_allclose(head.apply([0, 0, 1]), rotation[:, 2], atol=1e-12)
        np.testing.assert_allclose(at + 7.0 * rotation[:, 2], np.array(place) + [0, 0, 7.0], atol=1e-10)


def test_a_turn_goes_the_way_of_the_axes() -> None:
    """More than half a turn in one line, and the tip of a table that turns on its circle within the chord error."""
    path = path_of("G0 X0 Z5\nG1 C350 F1000", kinematics="xyzac-trt")
    assert np.linalg.norm(path.spin, axis=1).sum() == pytest.approx(np.radians(350), rel=1e-9)
    swing = path_of("G0 X20\nG1 C360 F1000", kinematics="xyzac-trt", tip=False, tolerance=0.01)
    middle = 0.5 * (swing.at[1:] + swing.at[:-1])
    assert np.linalg.norm(middle, axis=1).min() >= 20 - 0.01
    assert swing.length == pytest.approx(40 * math.pi, rel=1e-3)
    line = fault("G0 A10\n")
    assert line.startswith(
        'p.ngc:1: the axis A turns, and no kinematics is given (write path_options = { kinematics = "xyzac-trt"'
    )
    assert "the axis B turns, which the kinematics does not have" in fault("G0 B10\n", kinematics="xyzac-trt")
    path_of("G0 X1 A0 C0")


# --------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("G41 D1\n", "1: G41 is not read: cutter compensation from a tool table (write the tool's own path, or G41.1"),
        ("G0 X1\nG81 Z-1 R1\n", "2: G81 is not read: a canned cycle (write its moves out)"),
        ("G73 Z1\n", "G73 is not read: a canned cycle"),
        ("G38.2 Z1\n", "G38.2 is not read: probing"),
        ("G5 X1\n", "G5 is not read: cubic splines"),
        ("G33 Z1\n", "G33 is not read"),
        ("G7\n", "lathe diameters"),
        ("G12 X1\n", "1: G12 is not known"),
        ("M98 P1\n", "M98 is not read: it calls a program of another file"),
        ("G0 G1 X1\n", "G0 and G1 in one line"),
        ("G0 X1 X2\n", "the word X stands twice"),
        ("G0 U1\n", "the axis U is not known"),
        ("X1\n", "no motion is chosen"),
        ("G0 X\n", "a number is missing at the end of the line"),
        ("G0 X1 $\n", "no word begins with '$'"),
        ("G0 X[1/0]\n", "1 / 0 has no value"),
        ("G0 X[SQRT[-1]]\n", "SQRT[-1] has no value"),
        ("G0 X[10**400]\n", "10 ** 400 has no value"),
        ("G0 X[1+]\n", "a number is missing"),
        ("G0 X[1\n", "a bracket does not close"),
        ("G0 X#<a>\n", "#<a> is used before it is set"),
        ("#0=1\n", "there is no parameter #0"),
        ("G0 (comment\n", "the comment does not end"),
        ("o1 while [1]\nG0 X1\n", "1: o1 while has no endwhile"),
        ("o1 endif\n", "ends nothing"),
        ("o<x> call\n", "there is no sub o<x> in this file"),
        ("o1 twice\n", 'the O-word "twice" is not known'),
        ("G1 X5 F1\nG2 X0 Y0 R2\n", "2: an arc of radius 2 cannot reach over 5"),
        ("F1 G2 X1 Y1\n", "an arc without a centre or radius (write I and J, or R)"),
        ("F1 G2 X1 I3\n", "the arc begins 3 from its centre and ends 2 from it"),
        ("F1 G2 X2 I1 K1\n", "K is no centre in the plane G17"),
        ("F1 G2 X2 I1 P1.5\n", "an arc of P1.5 turns"),
        ("F-1\n", "the feed F-1 is negative"),
        ("G4 P-1\n", "G4 waits a negative time"),
        ("G10 L1 P1 Z1\n", "G10 L1 is not read: it changes a tool table"),
        ("G0 X1e5\n", "the word E is not known"),
        ("G0 X" + "9" * 400 + "\n", "a place is not finite"),
    ],
)
def test_what_is_refused_is_named(text: str, words: str) -> None:
    line = fault(text)
    assert line.startswith("p.ngc:")
    assert words in line


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "cannot be read: No such file"),
        (b"", "holds no path"),
        (b"(nothing)\nM2\n", "holds no path"),
        (b"G0 X1\0\n", "is no text: byte 5 is 0"),
    ],
)
def test_files_that_are_no_programs(tmp_path: Path, content: bytes | None, words: str) -> None:
    if content is not None:
        (tmp_path / "p.ngc").write_bytes(content)
    with pytest.raises(InputError) as caught:
        gcode.read(tmp_path / "p.ngc")
    assert words in str(caught.value)
    assert "p.ngc" in str(caught.value)


@settings(max_examples=200, deadline=None)
@given(st.text(alphabet="gGxyzijkrfpmon#<>[]=+-*/.0123456789 \n%;()", max_size=80))
def test_any_text_is_a_path_or_a_fault(text: str) -> None:
    try:
        path = gcode.parse(text, "p.ngc").path
    except InputError as error:
        assert "p.ngc" in str(error)
    else:
        assert np.isfinite(path.at).all()
