"""IGES in and out: the file's own nets, crowded lines set right, bad files in one line, the same bytes every time."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

pytest.importorskip("OCP")

from OCP.BRep import BRep_Builder
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.IGESCAFControl import IGESCAFControl_Reader
from OCP.TopoDS import TopoDS_Compound, TopoDS_Shell

from cadsculpt.errors import CadsculptError, InputError
from cadsculpt.formats import iges
from cadsculpt.formats.iges_entities import creased_surfaces, damaged_entities, number
from cadsculpt.formats.iges_kernel import UNIT_OF_FLAG
from cadsculpt.formats.iges_records import IgesFile, parse, text_of, tokens
from cadsculpt.formats.iges_write import DATE
from cadsculpt.formats.iges_write import write as write_by_kernel
from cadsculpt.formats.occt.curve import sample_surface
from cadsculpt.formats.occt.document import faces_in, free_shapes, new_document
from cadsculpt.formats.occt.part import OcctPart, document_of_shapes
from cadsculpt.formats.occt.shape import shape_of_surface
from cadsculpt.formats.occt.tolerance import placed
from cadsculpt.spline.surface import BSplineSurface
from cadsculpt.units import conversion

Array = NDArray[np.float64]


def wave() -> BSplineSurface:
    """A rational patch with numbers that no short decimal holds, and a crease."""
    rng = np.random.default_rng(0)
    knots_u = np.array([0.0, 0, 0, 0, 1 / 3, 2 / 3, 2 / 3, 2 / 3, 1, 1, 1, 1])
    knots_v = np.array([-2.0, -2, -2, 1 / 7, 5, 5, 5])
    x, y = np.meshgrid(np.arange(8.0), np.arange(4.0), indexing="ij")
    net = np.stack([x, y, rng.random((8, 4))], axis=2) * (40 / 3)
    return BSplineSurface(net, knots_u, knots_v, 3, 2, weights=0.5 + rng.random((8, 4)))


def sample_part(units: str = "mm") -> OcctPart:
    return document_of_shapes(
        [("wave", shape_of_surface(wave())), ("pin", BRepPrimAPI_MakeCylinder(4, 9).Shape())], units
    )


@pytest.fixture
def sound(tmp_path) -> str:
    sample_part().write(tmp_path / "sound.igs", "iges")
    return (tmp_path / "sound.igs").read_text()


def surface_of_entity(parameters: list[str], scale: float) -> BSplineSurface:
    """Entity 128 read by the standard's own table (IGES 5.3, section 4.23), apart from all readers."""
    k1, k2, m1, m2 = (int(p) for p in parameters[1:5])
    values = np.array([number(p) for p in parameters[10:]])
    a, b, c = k1 + m1 + 2, k2 + m2 + 2, (k1 + 1) * (k2 + 1)
    weights = values[a + b : a + b + c].reshape(k2 + 1, k1 + 1).T
    net = values[a + b + c : a + b + 4 * c].reshape(k2 + 1, k1 + 1, 3).transpose(1, 0, 2) * scale
    same = (weights == weights[0, 0]).all()
    return BSplineSurface(net, values[:a], values[a : a + b], m1, m2, weights=None if same else weights)


def same_surface(a: BSplineSurface, b: BSplineSurface) -> bool:
    """Equal knots and nets; weights up to a common factor."""
    if a.shape != b.shape or not np.array_equal(a.knots_u, b.knots_u) or not np.array_equal(a.knots_v, b.knots_v):
        return False
    scale = np.abs(a.control_points).max()
    if a.rational != b.rational or np.abs(a.control_points - b.control_points).max() > 1e-14 * scale:
        return False
    return not a.rational or np.allclose(a.weights / a.weights.max(), b.weights / b.weights.max(), rtol=1e-14)


# ------------------------------------------------------------------------ records


def test_tokens_know_strings_and_delimiters():
    assert tokens("1H,,1H;,7HA,B;C D,,3.5D-2,  12 ;rest") == ["1H,", "1H;", "7HA,B;C D", "", "3.5D-2", "12"]
    assert tokens("1,,2;") == ["1", "", "2"]
    assert tokens("1/2/3#", "/", "#") == ["1", "2", "3"]


@given(
    st.lists(st.one_of(st.integers(-(10**9), 10**9).map(str), st.text("AB,;H0 ", max_size=90)), min_size=1, max_size=60)
)
@settings(max_examples=60, deadline=None)
def test_records_come_back(parameters):
    strings = [p if re.fullmatch(r"-?\d+", p) else f"{len(p)}H{p}" for p in parameters]
    file = IgesFile(start=["start"], header=["1H,", "1H;", "4Hname"], complete=True)
    from cadsculpt.formats.iges_records import Entity

    fields = [
        "402",
        "1",
        "0",
        "0",
        "0",
        "0",
        "0",
        "0",
        "00000000",
        "",
        "402",
        "0",
        "0",
        "1",
        "7",
        "",
        "",
        "LABEL",
        "3",
        "",
    ]
    file.entities = [Entity(1, fields, ["402", *strings]), Entity(3, list(fields), ["402", "5"])]
    text = text_of(file)
    assert all(len(line) == 80 for line in text.splitlines())
    again = parse(text)
    assert again.complete
    assert again.disordered == again.broken == again.crowded == 0
    assert [entity.parameters for entity in again.entities] == [entity.parameters for entity in file.entities]
    assert again.header == file.header


@pytest.mark.parametrize(
    ("text", "value"), [("1.5D-3", 1.5e-3), ("1.E2", 100.0), ("", 0.0), ("7", 7.0), ("nan", None), ("x", None)]
)
def test_numbers_as_iges_writes_them(text, value):
    assert number(text) == value


# --------------------------------------------------------------------- round trip


@pytest.mark.parametrize("units", ["mm", "in", "cm", "m"])
def test_splines_come_back_with_their_units(units, tmp_path):
    part = document_of_shapes([("wave", shape_of_surface(wave()))], units)
    part.write(tmp_path / "a.igs", "iges")
    again = iges.read(tmp_path / "a.igs")
    assert again.units == units
    surface = again.faces[0].surface
    np.testing.assert_allclose(surface.control_points, wave().control_points, rtol=1e-14, atol=1e-13)
    np.testing.assert_array_equal(surface.knots_u, wave().knots_u)
    if units == "mm":
        np.testing.assert_array_equal(surface.control_points, wave().control_points)
    assert again.validity().valid


def test_solids_stay_solids(tmp_path):
    part = document_of_shapes([("box", BRepPrimAPI_MakeBox(30, 20, 10).Shape())])
    part.write(tmp_path / "a.igs", "iges")
    again = iges.read(tmp_path / "a.igs")
    assert len(again.faces) == 6
    assert all(len({n for edge in face.edges for n in edge.neighbours}) == 4 for face in again.faces)


def test_the_units_can_be_overruled(tmp_path):
    sample_part().write(tmp_path / "a.igs", "iges")
    part = iges.read(tmp_path / "a.igs", units="in")
    assert part.units == "in"
    np.testing.assert_allclose(
        part.faces[0].surface.control_points, 25.4 * wave().control_points, rtol=1e-14, atol=1e-12
    )


def test_the_text_is_the_net(sound):
    """The numbers that stand in the written file, read by the standard's table, are the surface."""
    entity = next(entity for entity in parse(sound).entities if entity.type == 128)
    assert same_surface(surface_of_entity(entity.parameters, 1.0), wave())


SCRIPT = """
import sys
from pathlib import Path
from cadsculpt.formats import iges, iges_write
for _ in range(int(sys.argv[3])):
    iges_write.write(iges.read(Path(sys.argv[1])), Path(sys.argv[2]))
"""


def test_the_same_bytes_in_every_process_and_no_clock(tmp_path):
    sample_part().write(tmp_path / "a.igs", "iges")
    written = []
    for turns in (1, 3):
        out = tmp_path / "out.igs"
        command = [sys.executable, "-c", SCRIPT, str(tmp_path / "a.igs"), str(out), str(turns)]
        subprocess.run(command, check=True, env=os.environ)
        written.append(out.read_bytes())
    assert written[0] == written[1]
    header = parse(written[0].decode()).header
    assert header[17] == header[24] == DATE
    assert header[20] == header[21] == ""


def test_nothing_is_printed(capfd, tmp_path):
    sample_part().write(tmp_path / "a.igs", "iges")
    iges.read(tmp_path / "a.igs").validity()
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


# --------------------------------------------------------------------- odd files


def crowded(text: str) -> str:
    """The same file with every parameter line's last delimiter in column 65, as some exporters write."""
    file = parse(text)
    entity = next(entity for entity in file.entities if entity.type == 128)
    lines = []
    for line in text.splitlines():
        if line[72] == "P" and line[64:72].strip() == str(entity.pointer) and line[:64].rstrip().endswith(","):
            line = line[:64].rstrip()[:-1].rjust(64) + "," + f"{entity.pointer:>7}" + line[72:]
        lines.append(line)
    return "\n".join(lines) + "\n"


def test_lines_that_run_into_column_65_are_set_right(tmp_path, sound):
    path = tmp_path / "crowded.igs"
    path.write_text(crowded(sound))
    part = iges.read(path)
    assert any("column 65" in line for line in part.warnings)
    assert len(part.faces) == len(iges.read(tmp_path / "sound.igs").faces)
    np.testing.assert_array_equal(part.faces[0].surface.control_points, wave().control_points)


def test_comments_after_the_data_do_no_harm(tmp_path, sound):
    path = tmp_path / "comments.igs"
    path.write_text(sound + "made with love\n\n* and more\n")
    np.testing.assert_array_equal(iges.read(path).faces[0].surface.control_points, wave().control_points)


def test_creases_are_counted(sound):
    assert creased_surfaces(parse(sound)) == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "No such file"), (b"", "empty"), (b"solid cube\n" * 40, "no IGES file")],
    ids=["missing", "empty", "other"],
)
def test_files_that_are_none(content, message, tmp_path):
    path = tmp_path / "a.igs"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        iges.read(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_file_without_surfaces(tmp_path, sound):
    file = parse(sound)
    file.entities = [entity for entity in file.entities if entity.type == 110][:3]
    assert file.entities
    for place, entity in enumerate(file.entities):
        entity.pointer = 2 * place + 1
        entity.fields[8] = "00000000"
    path = tmp_path / "lines.igs"
    path.write_text(text_of(file))
    with pytest.raises(InputError, match=r"no surfaces, only other entities \(3 of type 110\)"):
        iges.read(path)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_truncated_file_is_an_error_or_read_with_a_warning(share, tmp_path, sound):
    path = tmp_path / "a.igs"
    path.write_text(sound[: int(share * len(sound))])
    try:
        part = iges.read(path)
    except InputError as error:
        assert "\n" not in str(error)
        assert str(path) in str(error)
    else:
        assert any("breaks off" in line for line in part.warnings)


def test_damage_is_seen_in_the_records(sound):
    assert damaged_entities(parse(sound)) == 0
    for spoil in (
        lambda p: p.pop(),
        lambda p: p.__setitem__(12, "zero"),
        lambda p: p.__setitem__(16, "-9."),
        lambda p: p.__setitem__(1, "4000"),
    ):
        file = parse(sound)
        entity = next(entity for entity in file.entities if entity.type == 128)
        spoil(entity.parameters)
        while spoil is not None and len(entity.parameters) > 120:
            entity.parameters.pop()
            if damaged_entities(file):
                break
        assert damaged_entities(file) == 1
    shuffled = sound.splitlines()
    at = next(i for i, line in enumerate(shuffled) if line[72] == "P")
    shuffled[at], shuffled[at + 1] = shuffled[at + 1], shuffled[at]
    assert parse("\n".join(shuffled)).disordered > 0


# ------------------------------------------------------------------- real files

FEW = [
    "BUC50025.igs",
    "PRO20359-L5.igs",
    "OCC8842_cone_CATIA.igs",
    "cube_10x10mm.igs",
    "bug22566_test_Bad.igs",
    "surf114.igs",
]
CROWDED = {"c172.igs": 6, "sweep.igs": 4, "as_wing.igs": 4, "wing.igs": 4}


def readings(corpus: Path) -> dict[str, tuple[int, float]]:
    """File: (faces, area in mm2) that another reader found, from the corpus's index."""
    rows = re.findall(r"^\| iges/(\S+) \|.*?\| (\d+); ([\d.]+);", (corpus / "INDEX.md").read_text(), flags=re.MULTILINE)
    return {name: (int(faces), float(area)) for name, faces, area in rows}


def check_file(path: Path, faces: int, area: float, folder: Path) -> None:
    part = iges.read(path)
    assert len(part.faces) == faces
    total = sum(face.area for face in part.faces)
    assert any("area" in line for line in part.warnings) or total == pytest.approx(area, rel=1e-3)
    rng = np.random.default_rng(0)
    for n in range(1, faces + 1):
        face = part.face(n)
        made, surface = face.conversion, face.surface
        spline = face.kind == "bspline"
        (a, b), (c, d) = surface.domain if spline else (face.uv_bounds[:2], face.uv_bounds[2:])
        u, v = rng.uniform(a, b, 30), rng.uniform(c, d, 30)
        truth = placed(sample_surface(face.geom, np.column_stack([u, v])), face.location)
        new_u = u if made.map_u is None else made.map_u(u)[:, 0]
        new_v = v if made.map_v is None else made.map_v(v)[:, 0]
        scale = (1e-10 if made.note else 1e-12) * np.abs(surface.control_points).max()
        np.testing.assert_allclose(surface.evaluate(new_u, new_v), truth, rtol=0, atol=scale)
    write_by_kernel(part, folder / "a.igs")
    again = iges.read(folder / "a.igs")
    assert len(again.faces) == faces
    assert again.validity().valid or not part.validity().valid
    for face, other in zip(part.faces, again.faces, strict=True):
        if face.kind == "bspline":
            assert same_surface(face.surface, other.surface)


def own_surfaces(path: Path) -> list[BSplineSurface]:
    """Every entity 128 of a file by the standard's table, in mm, where no matrix moves it."""
    file = parse(path.read_text("latin-1"))
    scale = conversion(UNIT_OF_FLAG[int(file.header[13])], "mm")
    found = [e for e in file.entities if e.type == 128 and e.fields[6].strip() in ("", "0")]
    return [surface_of_entity(e.parameters, scale) for e in found]


@pytest.mark.corpus
@pytest.mark.parametrize("name", FEW)
def test_real_files(name, corpus, tmp_path):
    check_file(corpus / "iges" / name, *readings(corpus)[name], tmp_path)


@pytest.mark.corpus
@pytest.mark.nightly
def test_all_real_files(corpus, tmp_path):
    for name, (faces, area) in readings(corpus).items():
        path = corpus / "iges" / name
        if name in CROWDED:
            continue
        if faces == 0:
            with pytest.raises(CadsculptError, match="no surfaces"):
                iges.read(path)
        else:
            check_file(path, faces, area, tmp_path)


@pytest.mark.corpus
@pytest.mark.parametrize("name", CROWDED)
def test_files_that_the_kernel_alone_drops(name, corpus):
    path = corpus / "iges" / name
    part = iges.read(path)
    own = own_surfaces(path)
    assert len(part.faces) == len(own) == CROWDED[name]
    assert all(same_surface(face.surface, surface) for face, surface in zip(part.faces, own, strict=True))


@pytest.mark.corpus
@pytest.mark.parametrize("name", ["BUC50025.igs", "PRO20359-L1.igs", "example_45_faces.iges", "hammer.iges"])
def test_nets_are_the_files_own(name, corpus):
    """Not one control point, knot or weight of the file is altered on the way."""
    path = corpus / "iges" / name
    part, own = iges.read(path), own_surfaces(path)
    assert own
    for face in part.faces:
        assert any(same_surface(face.surface, surface) for surface in own), face.name


# ---------------------------------------------------------------------- names of faces


NAMES = ["TOP", "a name of more than eight letters", "", "Fläche 4, links; rechts", "底面", "TOP"]
"""Of the six faces of a box: one of none, two of one name, delimiters, and letters that the standard does not have."""


def named_box(units: str = "mm") -> OcctPart:
    box = BRepPrimAPI_MakeBox(3, 4, 5).Shape()
    faces = list(zip(NAMES, faces_in(box), strict=True))
    return document_of_shapes([("block", box)], units, faces=[(name, face) for name, face in faces if name])


def by_place(part: OcctPart) -> list[tuple[list[float], str]]:
    """Middle of every face, and its name."""
    return [(np.mean(np.reshape(face.bbox, (2, 3)), axis=0).round(9).tolist(), face.name) for face in part.faces]


def names_in_records(path: Path) -> list[str]:
    """The names that bounded faces point to, read by the standard's own table (IGES 5.3, section 2.2.4.5.2)."""
    file = parse(path.read_text("latin-1"))
    found = []
    for entity in file.entities:
        if entity.type != 510:
            continue
        p = entity.parameters
        rest = p[4 + int(p[2]) :]
        assert rest[:2] == ["0", "1"] or not rest
        owned = file.at(int(rest[2])) if rest else None
        assert owned is None or (owned.type, owned.fields[14].strip(), owned.parameters[1]) == (406, "15", "1")
        text = owned.parameters[2] if owned is not None else "0H"
        count, _, letters = text.partition("H")
        assert len(letters) == int(count)
        found.append(letters)
    return found


@pytest.mark.parametrize("units", ["mm", "in"])
def test_names_of_faces_in_solids_come_back(units: str, tmp_path: Path) -> None:
    part = named_box(units)
    part.write(tmp_path / "box.igs", "iges")
    back = iges.read(tmp_path / "box.igs")
    assert len(back.shapes) == 1
    assert [shape.ShapeType() for shape in back.shapes] == [shape.ShapeType() for shape in part.shapes]
    assert list(back.own_names) == list(part.own_names) == NAMES
    assert by_place(back) == by_place(part)
    letters = [name.encode().decode("latin-1") for name in NAMES]
    assert sorted(names_in_records(tmp_path / "box.igs")) == sorted(letters)
    back.write(tmp_path / "again.igs", "iges")
    assert (tmp_path / "again.igs").read_bytes() == (tmp_path / "box.igs").read_bytes()


def test_other_readers_see_the_names(tmp_path: Path) -> None:
    """The kernel's own reader takes the file without a complaint, with the names on the faces' entities."""
    named_box().write(tmp_path / "box.igs", "iges")
    reader = IGESCAFControl_Reader()
    reader.SetNameMode(True)
    assert reader.ReadFile(str(tmp_path / "box.igs")) == IFSelect_ReturnStatus.IFSelect_RetDone
    model = reader.WS().Model()
    assert not any(model.IsErrorEntity(i) for i in range(1, model.NbEntities() + 1))
    named = [model.Value(i) for i in range(1, model.NbEntities() + 1) if model.Value(i).TypeNumber() == 510]
    assert [entity.NameValue().ToCString() for entity in named if entity.HasName()] == [name for name in NAMES if name]
    document = new_document()
    assert reader.Transfer(document)
    (shape,) = free_shapes(document)
    assert len(list(faces_in(shape))) == len(NAMES)


def test_names_outlast_another_order(tmp_path: Path) -> None:
    """A loose face before a solid: IGES has solids first, and a face without a name, or of a shared one, keeps its handle."""
    box, sheet = BRepPrimAPI_MakeBox(3, 4, 5).Shape(), shape_of_surface(wave())
    builder, both = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(both)
    for shape in (sheet, box):
        builder.Add(both, shape)
    named = [(name, face) for name, face in zip(NAMES, faces_in(box), strict=True) if name]
    part = document_of_shapes([("both", both)], faces=named)
    assert part.faces[0].kind == "bspline"
    part.write(tmp_path / "both.igs", "iges")
    back = iges.read(tmp_path / "both.igs")
    assert back.faces[0].kind != "bspline"
    assert sorted(by_place(back)) == sorted(by_place(part))


def test_a_face_without_a_name_does_not_take_that_of_its_shell(tmp_path: Path) -> None:
    """The kernel writes a shell of one face as that face, and calls it by the shell's name."""
    builder, shells = BRep_Builder(), []
    for move in (0.0, 100.0):
        net = wave().control_points + [0.0, move, 0.0]
        shell = TopoDS_Shell()
        builder.MakeShell(shell)
        builder.Add(shell, shape_of_surface(wave().with_control_points(net)))
        shells.append(shell)
    part = document_of_shapes([("SHELL A", shells[0]), ("SHELL B", shells[1])])
    assert [face.name for face in part.faces] == ["face1", "face2"]
    part.write(tmp_path / "shells.igs", "iges")
    assert [face.name for face in iges.read(tmp_path / "shells.igs").faces] == ["face1", "face2"]
