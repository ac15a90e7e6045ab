"""APT files: places and times against the statements' own numbers, circles against formulas, every fault with its line."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadsculpt.errors import InputError, SceneError
from cadsculpt.formats.paths import apt, path_file
from cadsculpt.motion.path import ToolPath
from cadsculpt.scene_tool import PathOptions


def path_of(text: str, units: str = "mm", **options: object) -> ToolPath:
    head = "" if "UNIT" in text else "UNITS/MM\n"
    read = apt.parse(head + text + "\nFINI\n", "p.apt", units, PathOptions.model_validate(options))
    assert read.warnings == ()
    return read.path


def fault(text: str) -> str:
    with pytest.raises(SceneError) as caught:
        apt.parse(text, "p.apt")
    (line,) = caught.value.faults
    return line


REAL = ["Dem-target1.apt", "Interface-glue.apt", "Top-light-cover.apt", "basemach.apt"]


@pytest.mark.corpus
@pytest.mark.parametrize("name", REAL)
def test_real_files(corpus: Path, name: str) -> None:
    """Every GOTO outside drilling is a place of the path, in its order; every hole is reached and drilled; arcs add little."""
    text = (corpus / "toolpath" / name).read_text()
    path = apt.read(corpus / "toolpath" / name).path
    assert (np.diff(path.t) > 0).all()
    places, holes, drilling, at = [], [], "", 0
    for line in text.splitlines():
        if line.startswith("CYCLE/"):
            drilling = line if "FEDTO" in line else ""
        found = re.fullmatch(r"GOTO/(\S+),(\S+),(\S+)", line)
        if found:
            place = [float(n) for n in found.groups()]
            if drilling:
                place[2] -= float(re.search(r"FEDTO,([\d.]+)", drilling)[1])  # type: ignore[index]
                holes.append(place)
            places.append(place)
    for place in places:
        near = np.flatnonzero((np.abs(path.at[at:] - place) <= 1e-9).all(axis=1))
        assert len(near), place
        at += int(near[0])
    assert holes
    low, high = path.at.min(axis=0), path.at.max(axis=0)
    centres = np.array(re.findall(r"CIRCLE/([^,]+),([^,]+),([^,]+)", text), dtype=float).reshape(-1, 3)
    whole = np.concatenate([np.array(places), centres])
    assert (low <= np.array(places).min(axis=0)).all()
    assert (high[:2] <= whole[:, :2].max(axis=0) + 20.0).all()
    assert low[2] == pytest.approx(np.array(places)[:, 2].min())


@pytest.mark.corpus
@pytest.mark.parametrize("name", REAL)
def test_cut_off_files_warn_or_are_refused(corpus: Path, name: str) -> None:
    text = (corpus / "toolpath" / name).read_text()
    for tenth in range(1, 10):
        try:
            read = apt.parse(text[: len(text) * tenth // 10], name)
        except InputError as error:
            assert name in str(error)
            continue
        assert any("cut off" in warning for warning in read.warnings)
        assert np.isfinite(read.path.at).all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 6.2), st.floats(1e-3, 0.3))
def test_a_circle_about_any_axis(seed: int, sweep: float, tolerance: float) -> None:
    """Right-handed about the axis that the record names, within the chord error, at the feed."""
    rng = np.random.default_rng(seed)
    axis, centre = rng.normal(size=3), rng.normal(size=3) * 10
    axis /= np.linalg.norm(axis)
    radial = np.cross(axis, rng.normal(size=3))
    radial *= rng.uniform(0.5, 30) / np.linalg.norm(radial)
    radius = float(np.linalg.norm(radial))

    def at(angle: float) -> np.ndarray:
        return centre + math.cos(angle) * radial + math.sin(angle) * np.cross(axis, radial)

    def numbers(*vectors: np.ndarray) -> str:
        return ",".join(f"{x:.13f}" for vector in vectors for x in vector)

    text = f"GOTO/{numbers(at(0))}\nFEDRAT/600,MMPM\nCIRCLE/{numbers(centre, axis)},{radius:.9f}\nGOTO/{numbers(at(sweep))}"
    path = path_of(text, tolerance=tolerance)
    assert path.duration == pytest.approx(radius * sweep / 10.0, rel=1e-9)
    for t, place in zip(path.t, path.at, strict=True):
        np.testing.assert_allclose(place, at(sweep * t / path.duration), atol=1e-8)
    middle = 0.5 * (path.at[1:] + path.at[:-1])
    assert (radius - np.linalg.norm(middle - centre, axis=1)).max() <= tolerance * (1 + 1e-6) + 1e-9


def test_circles_as_different_systems_write_them() -> None:
    """A record before the GOTO, a whole turn, MOVARC, and CATIA's way; a rapid move goes straight."""
    start = "GOTO/5,0,0\nFEDRAT/60,MMPM\n"
    quarter = path_of(start + "CIRCLE/0,0,0,0,0,1\nGOTO/0,5,0", tolerance=1e-4)
    assert quarter.length == pytest.approx(2.5 * math.pi, rel=1e-4)
    assert path_of(start + "CIRCLE/0,0,0,0,0,-1\nGOTO/0,5,0").length == pytest.approx(7.5 * math.pi, rel=2e-3)
    assert path_of(start + "CIRCLE/0,0,0,0,0,1\nGOTO/5,0,0").length == pytest.approx(10 * math.pi, rel=2e-3)
    nx = path_of(start + "MOVARC/0,0,0,0,0,1,5,ANGLE,90\nGOTO/0,5,0", tolerance=1e-4)
    catia = path_of(start + "INDIRV/0,1,0\nTLON,GOFWD/(CIRCLE/0,0,0,$\n5),ON,(LINE/0,0,0,$\n0,5,0)\n", tolerance=1e-4)
    np.testing.assert_allclose(nx.at, quarter.at)
    np.testing.assert_allclose(catia.at, quarter.at)
    assert path_of(start + "CIRCLE/0,0,0,0,0,1\nRAPID\nGOTO/0,5,0").length == pytest.approx(math.hypot(5, 5))


def test_feeds_units_and_waits() -> None:
    def lasts(text: str, units: str = "mm", **options: object) -> float:
        return path_of(text, units, **options).duration

    assert lasts("GOTO/0,0,0\nFEDRAT/600,MMPM\nGOTO/10,0,0") == pytest.approx(1.0)
    assert lasts("GOTO/0,0,0\nFEDRAT/MMPM,600\nGOTO/10,0,0") == pytest.approx(1.0)
    assert lasts("GOTO/0,0,0\nFEDRAT/600\nGOTO/10,0,0") == pytest.approx(1.0)
    assert lasts("UNITS/INCHES\nGOTO/0,0,0\nFEDRAT/60,IPM\nGOTO/1,0,0") == pytest.approx(1.0)
    assert lasts("UNITS/INCHES\nGOTO/0,0,0\nFEDRAT/60\nGOTO/1,0,0", "in") == pytest.approx(1.0)
    assert lasts("UNITS/INCHES\nGOTO/0,0,0\nFEDRAT/1524,MMPM\nGOTO/1,0,0", "m") == pytest.approx(1.0)
    assert lasts("SPINDL/600,RPM,CLW\nGOTO/0,0,0\nFEDRAT/0.5,MMPR\nGOTO/10,0,0") == pytest.approx(2.0)
    assert lasts("GOTO/0,0,0\nRAPID\nGOTO/10,0,0") == pytest.approx(0.1)
    assert lasts("GOTO/0,0,0\nRAPID\nGOTO/10,0,0", rapid=1) == pytest.approx(10.0)
    assert lasts("GOTO/0,0,0\nDELAY/2\nRAPID\nGOTO/10,0,0") == pytest.approx(2.1)
    # RAPID is for the next GOTO alone
    assert lasts("FROM/0,0,0\nFEDRAT/600,MMPM\nRAPID\nGOTO/10,0,0\nGOTO/20,0,0") == pytest.approx(1.1)
    np.testing.assert_allclose(path_of("UNITS/INCHES\nFROM/1,0,0\nRAPID\nGODLTA/0,0,1").at[-1], [25.4, 0, 25.4])
    np.testing.assert_allclose(apt.parse("GOTO/1,0,0\n", "p", "mm", PathOptions(units="in")).path.at, [[25.4, 0, 0]])


def test_tool_axes_become_rotations() -> None:
    path = path_of(
        "MULTAX/ON\nGOTO/0,0,0,0,0,1\nFEDRAT/60\nGOTO/10,0,0,0,0.6,0.8 $$ tilted\nTLAXIS/1,0,0\nGOTO/10,0,1\nGODLTA/2"
    )
    np.testing.assert_allclose(path.rotation[:, :, 2], [[0, 0, 1], [0, 0.6, 0.8], [1, 0, 0], [1, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(path.at[-1], [12, 0, 1])
    turned = path_of("GOTO/0,0,0,0,0,1\nFEDRAT/60\nGOTO/0,0,0,1,0,0")
    assert turned.duration == pytest.approx(1.5)  # 90 degrees at 60 a second


def test_a_drilled_hole() -> None:
    holes = "CYCLE/DRILL,FEDTO,5,MMPM,300,RAPTO,2,RTRCTO,20\nGOTO/10,0,1\nGOTO/20,0,1\nCYCLE/OFF\n"
    text = f"GOTO/0,0,50\n{holes}RAPID\nGOTO/0,0,50"
    path = path_of(text)
    expected = [[0, 0, 50], *([x, 0, z] for x in (10, 20) for z in (21, 3, -4, 21)), [0, 0, 50]]
    np.testing.assert_allclose(path.at, expected)
    assert path.t[3] - path.t[2] == pytest.approx(7 / 5)


def test_warnings_name_the_line() -> None:
    text = "GOTO/0,0,0\nNOVEL/1\nCYCLE/THREAD,1\nGOTO/5,0,0\nCYCLE/OFF\nLOADTL/1\nLOADTL/2\nCUTCOM/LEFT\n"
    text += "CSYS/1,0,0,5,0,1,0,0,0,0,1,0\n"
    read = apt.parse(text, "p.apt")
    assert len(read.path.t) == 1  # the hole of a cycle that is not read is no place of the tool
    assert read.warnings == (
        "p.apt: line 2: NOVEL is not known and passed over",
        "p.apt: line 3: CYCLE/THREAD is not read: its holes are left out",
        "p.apt: line 7: more than one tool is used: the path goes on with the scene's",
        "p.apt: line 8: CUTCOM is left to the machine: the path is the tool's as the file gives it",
        "p.apt: line 9: CSYS is another coordinate system than the file's own: places are taken as they stand",
        "p.apt: ends without FINI: it may have been cut off",
        "p.apt: names no unit (UNITS): its lengths are taken in mm",
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("GOTO/1,2\n", "1: GOTO needs 3 numbers, or 6 with the tool's axis, not '1,2'"),
        ("GOTO/1,2,x\n", "GOTO needs 3 numbers"),
        ("GOTO/1,2,1e999\n", "1e999 is not a finite number"),
        ("$$ a\nGOTO/1,$\n2\n", "2: GOTO needs 3 numbers"),
        ("GOTO/0,0,0,0,0,0\n", "the tool's axis has no length"),
        ("GOTO/0,0,0\nGOTO/1,0,0\n", "2: a move at a feed that is not set (write FEDRAT)"),
        ("FEDRAT/-1\n", "the feed is -1"),
        ("FEDRAT/MMPM\n", "FEDRAT without a number"),
        ("GOTO/0,0,0\nFEDRAT/1,IPR\nGOTO/1,0,0\n", "no spindle speed (write SPINDL)"),
        ("GODLTA/1,0,0\n", "GODLTA before any place is known"),
        ("UNITS/PARSEC\n", 'the unit "PARSEC" is not known'),
        ("CIRCLE/0,0,0,5\n", "CIRCLE needs its centre and axis, six numbers"),
        (
            "GOTO/5,0,0\nFEDRAT/1\nCIRCLE/0,0,0,0,0,1\nGOTO/0,9,0\n",
            "4: the circle's centre is 5 from where it begins and 9",
        ),
        ("TRANS/1,0,0\n", "moves the coordinates is not read"),
        ("GOTO/5,0,0\nTLON,GOFWD/PLANE1\n", "GOFWD is only read along a CIRCLE"),
        ("TLAXIS/NORMAL\n", "TLAXIS/NORMAL is not read"),
    ],
)
def test_a_faulty_statement_is_named(text: str, words: str) -> None:
    line = fault(text)
    assert line.startswith("p.apt:")
    assert words in line


def test_the_suffix_decides(tmp_path: Path) -> None:
    (tmp_path / "a.cls").write_text("UNITS/MM\nGOTO/1,2,3\nFINI\n")
    (tmp_path / "a.NC").write_text("G21 G0 X1 Y2 Z3\nM2\n")
    (tmp_path / "a.csv").write_text("0,1,2,3\n")
    for name in ("a.cls", "a.NC", "a.csv"):
        read = path_file.read(tmp_path / name)
        np.testing.assert_array_equal(read.path.at, [[1, 2, 3]])
        assert read.warnings == ()
    with pytest.raises(InputError, match=r"tool paths of kind '.dxf' are not read \(the kinds that are read: .csv"):
        path_file.read(tmp_path / "a.dxf")
    (tmp_path / "empty.apt").write_text("PARTNO/1\nFINI\n")
    with pytest.raises(InputError, match=r"empty.apt: holds no path"):
        path_file.read(tmp_path / "empty.apt")


@settings(max_examples=150, deadline=None)
@given(st.text(alphabet="GOTODLTACIRCLERAPIDFEDRAT/,.-0123456789$\n ", max_size=80))
def test_any_text_is_a_path_or_a_fault(text: str) -> None:
    try:
        path = apt.parse(text, "p.apt").path
    except InputError as error:
        assert "p.apt" in str(error)
    else:
        assert np.isfinite(path.at).all()
