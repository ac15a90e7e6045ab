"""Files of every kind, cut off at each tenth and with bytes changed: an error in words or a warning, no crash, no hang.

A sample runs by default, all real files nightly; `python benchmarks/broken_files.py FOLDER` does the same by hand.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadsculpt.errors import CadsculptError
from cadsculpt.formats import geomdl_json, gismo, gotools, patch_json, registry
from cadsculpt.formats.iges_records import parse
from cadsculpt.formats.mesh import read_mesh, write_triangles
from cadsculpt.formats.patch_part import PatchPart
from cadsculpt.formats.paths import path_file
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"

FAULTS = {"crashed", "hung", "internal", "silent"}


@pytest.fixture(scope="module")
def broken() -> Iterator[ModuleType]:
    """The module of benchmarks/."""
    sys.path.insert(0, str(BENCHMARKS))
    try:
        yield importlib.import_module("broken_files")
    finally:
        sys.path.remove(str(BENCHMARKS))


@pytest.fixture(scope="module")
def reader(broken: ModuleType) -> Iterator[object]:
    made = broken.Reader()
    yield made
    made.close()


def patch(name: str = "patch", height: float = 0.0) -> BSplineSurface:
    """A trimmed rational patch, 40 x 30."""
    x, y = np.meshgrid(np.linspace(0, 40, 5), np.linspace(0, 30, 4), indexing="ij")
    net = np.stack([x, y, height + np.sin(x / 7) + y / 11], axis=2)
    knots_u, knots_v = np.array([0.0, 0, 0, 0, 1 / 3, 1, 1, 1, 1]), np.array([0.0, 0, 0, 0.5, 1, 1, 1])
    corners = [(0.1, 0.1), (0.9, 0.1), (0.9, 0.8), (0.1, 0.8), (0.1, 0.1)]
    line = np.array([0.0, 0, 1, 1])
    curves = tuple(TrimCurve(np.array([a, b]), line, 1) for a, b in zip(corners[:-1], corners[1:], strict=True))
    weights = 1.0 + 0.1 * np.cos(x)
    return BSplineSurface(net, knots_u, knots_v, 3, 2, weights, trims=(TrimLoop(curves),), name=name)


CUBE = (
    np.array([(x, y, z) for x in (0.0, 1.5) for y in (0.0, 1.5) for z in (0.0, 1.5)]),
    np.array(
        [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
        + [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    ),
)

MILLED = "%\nG21 G90 G17 F600\nG0 X0 Y0 Z5\nG1 Z-1.25\nG1 X10.5\nG2 X20.5 Y10 I0 J10\nG1 Y31.75\nG0 Z5\nM2\n%\n"
CLDATA = (
    "PARTNO/A\nUNITS/MM\nFEDRAT/600,MMPM\nGOTO/0,0,5\nGOTO/0,0,-1.25\nGOTO/10.5,0,-1.25\nGOTO/20.5,31.75,-1.25\nFINI\n"
)
TOOL = 'units = "mm"\ndescription = "an egg"\nshape = "ellipsoid"\nradii = [4.0, 4.5, 11.25]\n'
SCENE = """units = "mm"
[[model]]
name = "panel"
file = "made.toml"
thickness = 4.125
nodes = 2.5
material = "clay"
[[tool]]
name = "ball"
shape = "sphere"
path = [{ t = 0.0, at = [0.0, 0.0, 12.5] }, { t = 1.5, at = [0.0, 0.0, 8.25] }]
radius = 5.125
"""
TABLE = "t,x,y,z\n0,0,0,5\n1.5,0,0,-1.25\n2.5,10.5,0,-1.25\n3.25,20.5,31.75,-1.25\n"


def part() -> PatchPart:
    return PatchPart(Path("made"), "json", "mm", [patch(), patch("upper", 8.0)])


def text(content: str) -> Callable[[Path], None]:
    return lambda path: path.write_text(content) and None  # type: ignore[return-value]


MADE: dict[str, Callable[[Path], object]] = {
    ".step": lambda path: registry.write_part(part(), path, "step"),
    ".igs": lambda path: registry.write_part(part(), path, "iges"),
    ".3dm": lambda path: registry.write_part(part(), path, "3dm"),
    ".json": lambda path: patch_json.write_surfaces(path, part().surfaces, "mm"),
    ".geomdl.json": lambda path: geomdl_json.write_surfaces(path, part().surfaces),
    ".g2": lambda path: gotools.write_surfaces(path, part().surfaces),
    ".xml": lambda path: gismo.write_surfaces(path, part().surfaces),
    ".stl": lambda path: write_triangles(path, *CUBE),
    ".obj": lambda path: write_triangles(path, *CUBE),
    ".ply": lambda path: write_triangles(path, *CUBE),
    ".off": lambda path: write_triangles(path, *CUBE),
    ".ngc": text(MILLED),
    ".apt": text(CLDATA),
    ".csv": text(TABLE),
    ".toml": text(SCENE),
    ".tool.toml": text(TOOL),
}
"""A small file of every kind."""

SLOW = {".step", ".igs"}
"""Each copy is tried in a process of its own."""


def check(broken: ModuleType, reader: object, path: Path, damages: list[object]) -> None:
    rows = list(broken.sweep_file(path, damages, reader))
    assert rows[0]["verdict"] in ("read", "error"), rows[0]
    assert [row for row in rows if row["verdict"] in FAULTS] == []


@pytest.mark.parametrize("suffix", MADE)
def test_made_files_cut_off_and_changed(broken: ModuleType, reader: object, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"made{suffix}"
    MADE[suffix](path)
    tenths, flips = ([9], 0) if suffix in SLOW else (range(1, 10), 12)
    rows = list(broken.sweep_file(path, broken.truncations(tenths) + broken.flips(flips), reader))
    assert rows[0]["verdict"] == "read"
    assert [row for row in rows if row["verdict"] in FAULTS] == []


@pytest.mark.parametrize("suffix", [".csv", ".toml", ".tool.toml"])
def test_a_number_cut_in_two_is_told(broken: ModuleType, reader: object, suffix: str, tmp_path: Path) -> None:
    """What is left of the last line is a number too, and nothing but the missing line end tells."""
    path, cut = tmp_path / f"made{suffix}", tmp_path / "cut"
    MADE[suffix](path)
    whole = reader.read(path)  # type: ignore[attr-defined]
    data = path.read_bytes()
    shorter = data.rstrip(b"\n]").rstrip(b"0123456789") + (b"1]" if suffix == ".tool.toml" else b"1")
    cut.mkdir()
    (cut / path.name).write_bytes(shorter)
    found = reader.read(cut / path.name)  # type: ignore[attr-defined]
    assert found["outcome"] == "read"
    assert broken.judged(whole, found, cut=True) == "said"
    # the same with its line end is a file of its own
    (cut / path.name).write_bytes(shorter + b"\n")
    again = reader.read(cut / path.name)  # type: ignore[attr-defined]
    assert not any("cut off" in line for line in again["warnings"])


def test_a_warning_of_another_thing_does_not_tell_of_a_loss(broken: ModuleType) -> None:
    whole = {"digest": "a", "warnings": []}
    for line, verdict in (
        ("the part is 0.1 mm long; is the unit in?", "silent"),
        ("the area of its faces is 5 mm2, integrated exactly; OpenCASCADE's own quadrature gives 6", "silent"),
        ("the file breaks off before its end; what stands in it was read", "said"),
        ("the file holds 9 surfaces, 7 could be read", "said"),
    ):
        found = {"outcome": "read", "digest": "b", "warnings": [line]}
        assert broken.judged(whole, found, cut=True) == verdict, line


@pytest.mark.nightly
@pytest.mark.parametrize("suffix", SLOW)
def test_made_files_at_each_tenth(broken: ModuleType, reader: object, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"made{suffix}"
    MADE[suffix](path)
    check(broken, reader, path, broken.truncations() + broken.flips(40))


SAMPLE: dict[str, list[int]] = {
    "iges/bug27069_points-with-comments.igs": [],
    "rhino/v1_Terrain.3dm": [3, 8],
    "rhino/v5_extrusions.3dm": [6],
    "spline/surface.json": [2, 7],
    "spline/trimmed_sfs.g2": [4, 9],
    "spline/teapot.xml": [5],
    "toolpath/3D_Chips.ngc": [5],
    "toolpath/Dem-target1.apt": [4, 9],
    "mesh/fin0.stl": [5, 9],
}
"""A file, and the tenths it is cut at."""


@pytest.mark.corpus
@pytest.mark.parametrize("name", SAMPLE)
def test_real_files_cut_off(broken: ModuleType, reader: object, corpus: Path, name: str) -> None:
    check(broken, reader, corpus / name, broken.truncations(SAMPLE[name]))


@pytest.mark.corpus
@pytest.mark.nightly
@pytest.mark.parametrize("folder", ["iges", "mesh", "rhino", "spline", "step", "toolpath"])
def test_all_real_files_at_each_tenth(broken: ModuleType, corpus: Path, folder: str) -> None:
    rows = broken.sweep(broken.files_in([corpus / folder]), broken.truncations())
    assert rows
    assert [row for row in rows if row["verdict"] in FAULTS] == []


def test_the_harness_sees_what_it_looks_for(
    broken: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader that dies, one that hangs, one that fails unforeseen and one that keeps quiet."""
    stub = tmp_path / "stub.py"
    stub.write_text(
        "import json, os, sys, time\n"
        "for line in sys.stdin:\n"
        "    data = open(json.loads(line)['path'], 'rb').read() if 'none.igs' not in line else b''\n"
        "    if data == b'di': os.abort()\n"
        "    if data == b'ha': time.sleep(60)\n"
        "    kind = 'internal' if data == b'in' else 'read'\n"
        "    print(json.dumps({'outcome': kind, 'message': 'x', 'digest': data.decode(), 'count': 1, 'warnings': []}),"
        " flush=True)\n"
    )
    monkeypatch.setattr(broken, "READER", stub)
    made = broken.Reader(seconds=2.0)
    try:
        for content, verdict in (("die", "crashed"), ("hang", "hung"), ("ints", "internal"), ("well", "silent")):
            path = tmp_path / "file.bin"
            path.write_text(content)
            damage = broken.Damage(share=2 / len(content) if len(content) > 3 else 0.7)
            rows = list(broken.sweep_file(path, [damage], made))
            assert [row["verdict"] for row in rows] == ["read", verdict]
    finally:
        made.close()


# ----------------------------------------------------------------- text, in this process


def orderly(read: Callable[[Path], object], path: Path) -> None:
    """Reads, or says in one line or a line each what is wrong."""
    try:
        read(path)
    except CadsculptError as error:
        assert str(error).strip()


READERS: dict[str, Callable[[Path], object]] = {
    **dict.fromkeys((".json", ".geomdl.json", ".g2", ".xml"), registry.read),
    **dict.fromkeys((".stl", ".obj", ".ply", ".off"), read_mesh),
    **dict.fromkeys((".ngc", ".apt", ".csv"), path_file.read),
}

PIECES = st.sampled_from(
    [
        "",
        " ",
        "\n",
        "\0",
        "-",
        "1e999",
        "nan",
        "99999999999",
        "0",
        "-1",
        "{",
        "]",
        "<",
        ">",
        '"',
        ";",
        ",",
        "/",
        "#",
        "é",
        "1.",
        "%",
    ]
)


@pytest.mark.parametrize("suffix", READERS)
def test_text_with_anything_in_it(suffix: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("fuzz")
    path = folder / f"made{suffix}"
    MADE[suffix](path)
    data = path.read_bytes()

    @given(st.lists(st.tuples(st.floats(0, 1), st.integers(0, 6), PIECES), min_size=1, max_size=4))
    @settings(max_examples=40, deadline=None)
    def run(edits: list[tuple[float, int, str]]) -> None:
        spoilt = data
        for share, length, piece in edits:
            at = int(share * len(spoilt))
            spoilt = spoilt[:at] + piece.encode() + spoilt[at + length :]
        path.write_bytes(spoilt)
        orderly(READERS[suffix], path)

    run()


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_iges_records_with_anything_in_them(data: st.DataObject) -> None:
    """Any text is taken apart, or refused, without the kernel."""
    lines = sample_iges()
    for _ in range(data.draw(st.integers(1, 5))):
        at = data.draw(st.integers(0, len(lines) - 1))
        column = data.draw(st.integers(0, 79))
        lines[at] = lines[at][:column] + data.draw(PIECES) + lines[at][column + data.draw(st.integers(0, 9)) :]
    try:
        parse("\n".join(lines))
    except CadsculptError as error:
        assert str(error).strip()


_LINES: list[str] = []


def sample_iges() -> list[str]:
    if not _LINES:
        from cadsculpt.formats.iges_write import text_of_part
        from cadsculpt.formats.occt.part import document_of_shapes
        from cadsculpt.formats.occt.quiet import quiet
        from cadsculpt.formats.occt.shape import shape_of_surface

        with quiet():
            _LINES.extend(text_of_part(document_of_shapes([("a", shape_of_surface(patch()))]), "a.igs").splitlines())
    return list(_LINES)
