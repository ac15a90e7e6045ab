"""STEP in and STEP out: what stands in the file comes back, bad files are one line, one part gives the same bytes."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from math import pi
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("OCP")

from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeTorus
from OCP.gp import gp_Trsf, gp_Vec
from OCP.Quantity import Quantity_Color, Quantity_NameOfColor
from OCP.TopLoc import TopLoc_Location
from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

from cadsculpt.errors import CadsculptError, InputError
from cadsculpt.formats import step
from cadsculpt.formats.occt.curve import sample_surface
from cadsculpt.formats.occt.document import set_name, shape_tool
from cadsculpt.formats.occt.part import OcctPart, document_of_shapes
from cadsculpt.formats.occt.shape import shape_of_surface
from cadsculpt.formats.occt.tolerance import placed
from cadsculpt.formats.step_text import facts_of, settled, step_real
from cadsculpt.spline.surface import BSplineSurface

Array = NDArray[np.float64]


def wave(seed: int = 0) -> BSplineSurface:
    """A rational patch with numbers that no short decimal holds."""
    rng = np.random.default_rng(seed)
    knots_u = np.array([0.0, 0, 0, 0, 1 / 3, 2 / 3, 2 / 3, 1, 1, 1, 1])
    knots_v = np.array([-2.0, -2, -2, 1 / 7, 5, 5, 5])
    x, y = np.meshgrid(np.arange(7.0), np.arange(4.0), indexing="ij")
    net = np.stack([x, y, rng.random((7, 4))], axis=2) * (40 / 3)
    return BSplineSurface(net, knots_u, knots_v, 3, 2, weights=0.5 + rng.random((7, 4)))


def coloured(part: OcctPart) -> OcctPart:
    """Colours on all faces, in several shades, so that the kernel's maps have something to mix up."""
    tool = XCAFDoc_DocumentTool.ColorTool_s(part.document.Main())
    names = [
        Quantity_NameOfColor.Quantity_NOC_RED,
        Quantity_NameOfColor.Quantity_NOC_GREEN,
        Quantity_NameOfColor.Quantity_NOC_BLUE1,
    ]
    for face in part.faces:
        colour = Quantity_Color(names[face.number % 3])
        tool.SetColor(part.face(face.number).shape, colour, XCAFDoc_ColorType.XCAFDoc_ColorSurf)
    return part


def sample_part() -> OcctPart:
    box, torus = BRepPrimAPI_MakeBox(30, 20, 10).Shape(), BRepPrimAPI_MakeTorus(20, 5).Shape()
    part = document_of_shapes(
        [("box", box), ("ring", torus), ("wave", shape_of_surface(wave()))],
        faces=[],
    )
    return coloured(part)


def assembly() -> OcctPart:
    """A pin placed three times."""
    part = document_of_shapes([("pin", BRepPrimAPI_MakeCylinder(2, 9).Shape())])
    tool = shape_tool(part.document)
    top = tool.NewShape()
    set_name(top, "rack")
    pin = tool.FindShape(part.shapes[0])
    for k in range(3):
        move = gp_Trsf()
        move.SetTranslation(gp_Vec(10 * k, k, -k))
        tool.AddComponent(top, pin, TopLoc_Location(move))
    tool.UpdateAssemblies()
    return OcctPart(part.document, Path("rack"), "step", "mm")


def same_net(a: BSplineSurface, b: BSplineSurface) -> None:
    for name in ("control_points", "knots_u", "knots_v", "weights"):
        left, right = getattr(a, name), getattr(b, name)
        assert (left is None) == (right is None)
        if left is not None:
            np.testing.assert_allclose(left, right, rtol=0, atol=1e-15 * np.abs(left).max())


# ------------------------------------------------------------------- round trip


def test_splines_come_back_to_the_last_bit(tmp_path):
    part = sample_part()
    part.write(tmp_path / "a.step", "step")
    again = step.read(tmp_path / "a.step")
    assert [face.kind for face in again.faces] == [face.kind for face in part.faces]
    surface = next(face for face in again.faces if face.kind == "bspline").surface
    same_net(wave(), surface)
    np.testing.assert_array_equal(surface.control_points, wave().control_points)
    assert again.validity().valid


@pytest.mark.parametrize("units", ["mm", "in", "cm", "m", "ft"])
def test_units_are_kept_and_lengths_are_mm(units, tmp_path):
    part = document_of_shapes([("wave", shape_of_surface(wave()))], units)
    part.write(tmp_path / "a.step", "step")
    again = step.read(tmp_path / "a.step")
    assert again.units == units
    np.testing.assert_allclose(again.faces[0].surface.control_points, wave().control_points, rtol=1e-14, atol=1e-13)


def test_the_units_can_be_overruled(tmp_path):
    document_of_shapes([("box", BRepPrimAPI_MakeBox(1, 2, 3).Shape())]).write(tmp_path / "a.step", "step")
    part = step.read(tmp_path / "a.step", units="inch")
    assert part.units == "in"
    assert sum(face.area for face in part.faces) == pytest.approx(22 * 25.4**2)
    part.write(tmp_path / "b.step", "step")
    again = step.read(tmp_path / "b.step")
    assert again.units == "in"
    assert sum(face.area for face in again.faces) == pytest.approx(22 * 25.4**2)


def test_assemblies_keep_their_placements_and_names(tmp_path):
    part = assembly()
    assert len(part.faces) == 9
    part.write(tmp_path / "a.step", "step")
    again = step.read(tmp_path / "a.step")
    assert len(again.faces) == 9
    for face, other in zip(part.faces, again.faces, strict=True):
        np.testing.assert_allclose(face.bbox, other.bbox, atol=1e-9)
    text = (tmp_path / "a.step").read_text()
    assert "'rack'" in text
    assert "'pin'" in text
    assert sum(face.area for face in again.faces) == pytest.approx(3 * (2 * pi * 2 * 9 + 2 * pi * 4))


def test_face_names_are_kept_and_made_unique(tmp_path):
    box = BRepPrimAPI_MakeBox(30, 20, 10).Shape()
    plain = document_of_shapes([("box", box)])
    assert [face.name for face in plain.faces] == [f"face{n}" for n in range(1, 7)]
    shapes = [plain.face(n).shape for n in range(1, 7)]
    part = document_of_shapes(
        [("box", box)], faces=[("top", shapes[5]), ("side", shapes[0]), ("side", shapes[1]), ("NONE", shapes[2])]
    )
    part.write(tmp_path / "a.step", "step")
    names = [face.name for face in step.read(tmp_path / "a.step").faces]
    assert names == ["side_1", "side_2", "face3", "face4", "face5", "top"]


def test_colours_are_kept(tmp_path):
    sample_part().write(tmp_path / "a.step", "step")
    again = step.read(tmp_path / "a.step")
    tool = XCAFDoc_DocumentTool.ColorTool_s(again.document.Main())
    assert all(tool.IsSet(again.face(face.number).shape, XCAFDoc_ColorType.XCAFDoc_ColorSurf) for face in again.faces)


@pytest.mark.parametrize("schema", ["AP203", "AP214IS", "AP242DIS"])
def test_the_application_protocol_is_kept(schema, tmp_path):
    part = sample_part()
    part.schema = schema
    part.write(tmp_path / "a.step", "step")
    assert step.read(tmp_path / "a.step").schema == schema


# -------------------------------------------------------------------- same bytes

SCRIPT = """
import sys
from pathlib import Path
from cadsculpt.formats import step
padding = [bytearray(k * 977) for k in range(int(sys.argv[3]))]
for _ in range(int(sys.argv[3])):
    step.read(Path(sys.argv[1])).write(Path(sys.argv[2]), "step")
"""


@pytest.mark.parametrize("schema", ["AP203", "AP214IS"])
def test_the_same_bytes_in_every_process(schema, tmp_path):
    """Whatever was read and written before, and wherever in memory things lie."""
    part = sample_part()
    part.schema = schema
    part.write(tmp_path / "a.step", "step")
    written = []
    for turns in (1, 3):
        out = tmp_path / "out.step"
        subprocess.run(
            [sys.executable, "-c", SCRIPT, str(tmp_path / "a.step"), str(out), str(turns)], check=True, env=os.environ
        )
        written.append(out.read_bytes())
    assert written[0] == written[1]


def test_writing_twice_gives_the_same_bytes_and_tells_no_time(tmp_path):
    part = assembly()
    part.write(tmp_path / "a.step", "step")
    first = (tmp_path / "a.step").read_bytes()
    part.write(tmp_path / "a.step", "step")
    assert (tmp_path / "a.step").read_bytes() == first
    assert re.findall(rb"\d{4}-\d{2}-\d{2}T", first) == [b"2000-01-01T"]
    assert re.findall(rb"NEXT_ASSEMBLY_USAGE_OCCURRENCE\('(\d+)'", first) == [b"1", b"2", b"3"]


def test_nothing_is_printed(capfd, tmp_path):
    sample_part().write(tmp_path / "a.step", "step")
    step.read(tmp_path / "a.step").validity()
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err == ""


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0."),
        (1.0, "1."),
        (-2.5, "-2.5"),
        (1e-7, "1.E-07"),
        (1.5e-300, "1.5E-300"),
        (1e22, "1.E+22"),
        (0.1, "0.1"),
    ],
)
def test_numbers_are_the_shortest_that_read_back(value, text):
    assert step_real(value) == text
    assert float(text) == value


def test_numbers_inside_strings_stay():
    name = b"'1.0000000000000000E+00 isn''t a number'"
    text = b"#1 = POINT(" + name + b",(1.0000000000000000E+00,-3.3333333333333331E-01));\n"
    assert settled(text) == b"#1 = POINT(" + name + b",(1.,-0.3333333333333333));\n"


# --------------------------------------------------------------------- bad input


@pytest.fixture
def sound(tmp_path) -> bytes:
    sample_part().write(tmp_path / "sound.step", "step")
    return (tmp_path / "sound.step").read_bytes()


def one_line(error: CadsculptError, path: Path) -> None:
    assert "\n" not in str(error)
    assert str(path) in str(error)


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "No such file"), (b"", "empty"), (b" \n\n", "empty"), (b"solid cube\nfacet normal", "no STEP file")],
    ids=["missing", "empty", "blank", "other"],
)
def test_files_that_are_none(content, message, tmp_path):
    path = tmp_path / "a.step"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        step.read(path)
    one_line(caught.value, path)


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        step.read(tmp_path)


def test_a_file_without_surfaces(tmp_path, sound):
    path = tmp_path / "a.step"
    path.write_bytes(sound[: sound.index(b"DATA;") + 6] + b"ENDSEC;\nEND-ISO-10303-21;\n")
    with pytest.raises(InputError, match="no surfaces|cannot read") as caught:
        step.read(path)
    one_line(caught.value, path)


@pytest.mark.parametrize("share", [0.02, 0.4, 0.9])
def test_a_truncated_file_is_an_error_or_read_with_a_warning(share, tmp_path, sound):
    path = tmp_path / "a.step"
    path.write_bytes(sound[: int(share * len(sound))])
    try:
        part = step.read(path)
    except InputError as error:
        one_line(error, path)
        assert "breaks off" in str(error) or "damaged" in str(error)
    else:
        assert any("breaks off" in line for line in part.warnings)


def test_a_vandalised_file_tells_what_was_lost(tmp_path, sound):
    faces = [m.start() for m in re.finditer(rb"#\d+ = ADVANCED_FACE\(", sound)]
    spoiled = bytearray(sound)
    spoiled[faces[0] : faces[0] + 30] = b"@" * 30
    path = tmp_path / "a.step"
    path.write_bytes(bytes(spoiled))
    try:
        part = step.read(path)
    except InputError as error:
        one_line(error, path)
        assert "damaged" in str(error)
    else:
        assert any("damaged" in line for line in part.warnings)
        assert len(part.faces) < len(faces)


def test_damage_is_seen_in_the_text(sound):
    assert facts_of(sound).damaged == 0
    assert facts_of(sound).complete
    assert facts_of(sound).faces == 8
    dangling = re.sub(rb"#\d+ = EDGE_LOOP\([^;]*;\n", b"", sound, count=1)
    assert facts_of(dangling).damaged >= 1
    unclosed = sound.replace(b"CARTESIAN_POINT('',(", b"CARTESIAN_POINT('',((", 1)
    assert facts_of(unclosed).damaged == 1


def test_a_folder_that_is_not_there_leaves_nothing(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        sample_part().write(tmp_path / "none" / "a.step", "step")
    assert list(tmp_path.iterdir()) == []


# ------------------------------------------------------------------- real files

FEW = [
    "trj7_c2-al-214.stp",
    "trj6_c1-id-214.stp",
    "bug22821_test.step",
    "trj9_io1-id-214.stp",
    "as1_pe_203.stp",
    "cube-m.step",
]


def readings(corpus: Path, folder: str) -> dict[str, tuple[int, float]]:
    """File: (faces, area in mm2) that another reader found, from the corpus's index."""
    text = (corpus / "INDEX.md").read_text()
    rows = re.findall(rf"^\| {folder}/(\S+) \|.*?\| (\d+); ([\d.]+);", text, flags=re.MULTILINE)
    return {name: (int(faces), float(area)) for name, faces, area in rows}


def check_reading(path: Path, part: OcctPart, faces: int, area: float) -> None:
    assert len(part.faces) == faces
    rng = np.random.default_rng(0)
    total = 0.0
    for number in range(1, faces + 1):
        face = part.face(number)
        total += face.area
        try:
            made, surface = face.conversion, face.surface
        except CadsculptError as error:
            assert face.warning == error.what  # noqa: PT017
            continue
        spline = face.kind in ("bspline", "bezier")
        (a, b), (c, d) = surface.domain if spline else (face.uv_bounds[:2], face.uv_bounds[2:])
        u, v = rng.uniform(a, b, 30), rng.uniform(c, d, 30)
        truth = placed(sample_surface(face.geom, np.column_stack([u, v])), face.location)
        new_u = u if made.map_u is None else made.map_u(u)[:, 0]
        new_v = v if made.map_v is None else made.map_v(v)[:, 0]
        allowed = 1e-10 if made.note else 1e-12
        scale = np.abs(surface.control_points).max()
        np.testing.assert_allclose(
            surface.evaluate(new_u, new_v), truth, rtol=0, atol=allowed * scale, err_msg=face.name
        )
    told = any("area" in line for line in part.warnings)
    # the index has what OCCT's quadrature gave on surfaces made periodic; a file's own record is better
    recorded = part.recorded_area
    truths = [area] if recorded is None else [area, recorded[1]]
    assert told or any(total == pytest.approx(truth, rel=1e-3) for truth in truths), path.name


def check_round_trip(part: OcctPart, again: OcctPart) -> None:
    assert len(again.faces) == len(part.faces)
    assert again.units == part.units
    assert again.validity().valid or not part.validity().valid
    order = [face.kind for face in part.faces] == [face.kind for face in again.faces]
    for face, other in zip(part.faces, again.faces, strict=True):
        if order and face.kind == "bspline":
            same_net(face.surface, other.surface)


@pytest.mark.corpus
@pytest.mark.parametrize("name", FEW)
def test_real_files(name, corpus, tmp_path):
    path = corpus / "step" / name
    part = step.read(path)
    check_reading(path, part, *readings(corpus, "step")[name])
    part.write(tmp_path / "a.step", "step")
    check_round_trip(part, step.read(tmp_path / "a.step"))


@pytest.mark.corpus
@pytest.mark.nightly
def test_all_real_files(corpus, tmp_path):
    for name, reading in readings(corpus, "step").items():
        part = step.read(corpus / "step" / name)
        check_reading(corpus / "step" / name, part, *reading)
        part.write(tmp_path / "a.step", "step")
        check_round_trip(part, step.read(tmp_path / "a.step"))


@pytest.mark.corpus
def test_a_vandalised_real_file(corpus):
    part = step.read(corpus / "step" / "bug32314_corrupted.stp")
    assert any("holds 82 faces, 79 could be read" in line for line in part.warnings)
    assert not part.validity().valid
    assert part.validity().faults[0].startswith("face 79")
