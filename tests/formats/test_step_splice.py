"""A STEP part goes back into the text of its file: what was not sculpted keeps its bytes, what was reads back as written."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("OCP")

from OCP.BRepGProp import BRepGProp
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder
from OCP.gp import gp_Trsf, gp_Vec
from OCP.GProp import GProp_GProps
from OCP.TopLoc import TopLoc_Location

from cadsculpt.errors import InputError
from cadsculpt.formats import registry, step
from cadsculpt.formats.instances import chosen_faces, named_instances
from cadsculpt.formats.occt.document import set_name, shape_tool
from cadsculpt.formats.occt.moments import moments_of
from cadsculpt.formats.occt.part import OcctPart, document_of_shapes
from cadsculpt.formats.occt.shape import shape_of_surface
from cadsculpt.formats.part import Face, Part
from cadsculpt.formats.step_properties import properties
from cadsculpt.formats.step_records import StepRecords, references, renumbered, split_arguments
from cadsculpt.formats.step_structure import Assembly
from cadsculpt.formats.step_units import millimetres_at, tolerance
from cadsculpt.scene import ModelSpec, Scene
from cadsculpt.spline.refine import insert_knots
from cadsculpt.spline.surface import BSplineSurface

Array = NDArray[np.float64]


def sheet(name: str = "sheet") -> BSplineSurface:
    """A bent patch with numbers that no short decimal holds."""
    x, y = np.meshgrid(np.linspace(0, 1, 6), np.linspace(0, 1, 5), indexing="ij")
    net = np.stack([x, y, 0.2 * np.sin(3 * x) * y], axis=2) * (100 / 3)
    knots_u = np.array([0.0, 0, 0, 0, 0.3, 0.7, 1, 1, 1, 1])
    return BSplineSurface(net, knots_u, np.array([0.0, 0, 0, 0.3, 0.6, 1, 1, 1]), 3, 2, name=name)


def dented(surface: BSplineSurface, depth: float) -> BSplineSurface:
    """The middle of a surface pushed along z, its border as it was."""
    fine = surface
    for _ in range(2):
        u, v = (np.unique(k[p : len(k) - p]) for k, p in ((fine.knots_u, fine.degree_u), (fine.knots_v, fine.degree_v)))
        fine = insert_knots(fine, 0.5 * (u[1:] + u[:-1]), 0.5 * (v[1:] + v[:-1]))
    net = fine.control_points.copy()
    r, s = fine.shape
    net[r // 3 : r - r // 3, s // 3 : s - s // 3, 2] -= depth
    return fine.with_control_points(net)


def two_sheets(path: Path, units: str = "mm") -> OcctPart:
    """Two patches apart, one of which will be sculpted, read from a file."""
    moved = sheet("other")
    moved = moved.with_control_points(moved.control_points + [100.0, 0, 0])
    shapes = [("a", shape_of_surface(sheet())), ("b", shape_of_surface(moved))]
    document_of_shapes(shapes, units).write(path, "step")
    return step.read(path)


def changed_records(before: bytes, after: bytes) -> set[int]:
    old, new = StepRecords.of(before), StepRecords.of(after)
    assert set(old.spans) <= set(new.spans)
    return {n for n in old.spans if old.body(n) != new.body(n)}


# ---------------------------------------------------------------------------- text


@pytest.mark.parametrize("units", ["mm", "in", "m"])
def test_only_the_sculpted_surface_changes(units, tmp_path):
    part = two_sheets(tmp_path / "a.step", units)
    before = (tmp_path / "a.step").read_bytes()
    goal = dented(part.faces[0].surface, 3.0)
    part.sculpt({1: goal})
    part.write(tmp_path / "b.step", "step")
    after = (tmp_path / "b.step").read_bytes()
    changed = changed_records(before, after)
    assert {StepRecords.of(before).type(n) for n in changed} == {"B_SPLINE_SURFACE_WITH_KNOTS"}
    assert len(changed) == 1
    again = step.read(tmp_path / "b.step")
    np.testing.assert_allclose(again.faces[0].surface.control_points, goal.control_points, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(again.faces[0].surface.knots_u, goal.knots_u)
    np.testing.assert_array_equal(again.faces[1].surface.control_points, part.faces[1].surface.control_points)
    assert again.validity().valid
    assert not any("anew" in line for line in part.warnings)
    part.write(tmp_path / "c.step", "step")
    assert (tmp_path / "c.step").read_bytes() == after


def test_a_part_that_was_not_sculpted_is_the_file(tmp_path):
    part = two_sheets(tmp_path / "a.step")
    part.write(tmp_path / "b.step", "step")
    assert (tmp_path / "b.step").read_bytes() == (tmp_path / "a.step").read_bytes()


def test_points_that_stayed_are_used_again(tmp_path):
    part = two_sheets(tmp_path / "a.step", "in")
    net = part.faces[0].surface.control_points.copy()
    net[2, 2, 2] -= 1.0
    part.sculpt({1: part.faces[0].surface.with_control_points(net)})
    part.write(tmp_path / "b.step", "step")
    before, after = (StepRecords.of((tmp_path / f"{name}.step").read_bytes()) for name in "ab")
    (new,) = set(after.spans) - set(before.spans)
    assert after.type(new) == "CARTESIAN_POINT"


def test_a_plane_becomes_a_spline_and_its_edges_stay(tmp_path):
    document_of_shapes([("box", BRepPrimAPI_MakeBox(30, 20, 10).Shape())]).write(tmp_path / "a.step", "step")
    part = step.read(tmp_path / "a.step")
    top = max(part.faces, key=lambda face: face.bbox[2])
    part.sculpt({top.number: dented(top.surface, 1.0)})
    part.write(tmp_path / "b.step", "step")
    again = step.read(tmp_path / "b.step")
    assert [face.kind for face in again.faces].count("bspline") == 1
    assert again.validity().valid
    types = {StepRecords.of((tmp_path / "a.step").read_bytes()).type(n) for n in changed_records(
        (tmp_path / "a.step").read_bytes(), (tmp_path / "b.step").read_bytes())}  # fmt: skip
    assert types == {"ADVANCED_FACE"}
    assert volume(again) == pytest.approx(volume(part), rel=1e-9)
    assert volume(again) != pytest.approx(6000.0, rel=1e-4)


def test_a_free_edge_that_moves_is_moved_in_the_text(tmp_path):
    shapes = [("a", shape_of_surface(sheet()))]
    document_of_shapes(shapes).write(tmp_path / "a.step", "step")
    part = step.read(tmp_path / "a.step")
    net = part.faces[0].surface.control_points.copy()
    net[:2, :, 2] += 2.0
    goal = part.faces[0].surface.with_control_points(net)
    part.sculpt({1: goal})
    assert part.moved.edges
    part.write(tmp_path / "b.step", "step")
    again = step.read(tmp_path / "b.step")
    assert not any("anew" in line for line in part.warnings)
    assert again.validity().valid
    assert again.faces[0].area == pytest.approx(part.faces[0].area, rel=1e-9)
    corners = np.array([edge.points[0] for edge in again.faces[0].edges])
    for corner in goal.control_points[[0, 0, -1, -1], [0, -1, 0, -1]]:
        assert np.abs(corners - corner).max(axis=1).min() < 1e-9


def test_a_file_that_lost_faces_is_not_written_as_it_was(tmp_path):
    two_sheets(tmp_path / "a.step")
    data = (tmp_path / "a.step").read_bytes()
    (tmp_path / "a.step").write_bytes(re.sub(rb"#\d+ = ADVANCED_FACE\([^;]*;\r?\n", b"", data, count=1))
    part = step.read(tmp_path / "a.step")
    assert len(part.faces) == 1
    assert part.source is None
    part.write(tmp_path / "b.step", "step")
    assert len(step.read(tmp_path / "b.step").faces) == 1
    assert b"= ADVANCED_FACE" in (tmp_path / "b.step").read_bytes()
    assert not any("damaged" in line for line in step.read(tmp_path / "b.step").warnings)


def test_records_of_odd_texts():
    data = (
        b"ISO-10303-21;\nHEADER;FILE_NAME('MATRA-DATAVISION','DATA;');ENDSEC;\nDATA;\n"
        b"#1=A('it''s; #9',#2); /* #3=NO(); */ #2 = ( B( (#1 ,#4),3.) C('x') );\n#4=D($,(),*);\nENDSEC;\nEND-ISO-10303-21;\n"
    )
    records = StepRecords.of(data)
    assert list(records.spans) == [1, 2, 4]
    assert records.type(2) == "B"
    assert records.is_a(2, "C")
    assert records.references(1) == [2]
    assert records.arguments(1) == [b"'it''s; #9'", b"#2"]
    assert records.arguments(2, "C") == [b"'x'"]
    assert records.users(4) == [2]
    assert records.below([1]) == {1, 2, 4}
    assert records.text() == data
    records.change(4, b"E()")
    assert records.add(b"F(#4)") == 5
    assert records.text() == data.replace(b"D($,(),*)", b"E()").replace(b"ENDSEC;\nEND", b"#5=F(#4);\nENDSEC;\nEND")
    assert renumbered(b"A('#1',#1,#12)", {1: 7}) == b"A('#1',#7,#12)"
    assert references(b"('#1',#3,(#4))") == [3, 4]
    assert split_arguments(b"F('a,b',(1,2),$)", 1) == [b"'a,b'", b"(1,2)", b"$"]


# ---------------------------------------------------------------------- properties


def volume(part: Part) -> float:
    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(part.shape, properties, 1e-9, False)  # type: ignore[attr-defined]
    return float(properties.Mass())


def test_moments_of_all_faces_are_those_of_the_solid(tmp_path):
    document_of_shapes([("can", BRepPrimAPI_MakeCylinder(3, 7).Shape())]).write(tmp_path / "a.step", "step")
    part = step.read(tmp_path / "a.step")
    every = [moments_of(part.face(face.number)) for face in part.faces]
    assert sum(m.volume for m in every) == pytest.approx(np.pi * 9 * 7, rel=1e-9)
    assert sum(m.volume_moments[2] for m in every) / (np.pi * 9 * 7) == pytest.approx(3.5, rel=1e-9)
    assert sum(m.area for m in every) == pytest.approx(2 * np.pi * 3 * 7 + 2 * np.pi * 9, rel=1e-9)


RECORDED = b"""#9001=PROPERTY_DEFINITION('geometric_validation_property','area',#%d);
#9002=PROPERTY_DEFINITION_REPRESENTATION(#9001,#9003);
#9003=REPRESENTATION('surface area',(#9004),#%d);
#9004=MEASURE_REPRESENTATION_ITEM('surface area measure',AREA_MEASURE(%r),#9005);
#9005=DERIVED_UNIT((#9006));
#9006=DERIVED_UNIT_ELEMENT(#%d,2.);
#9011=PROPERTY_DEFINITION('geometric_validation_property','volume',#%d);
#9012=PROPERTY_DEFINITION_REPRESENTATION(#9011,#9013);
#9013=REPRESENTATION('volume',(#9014),#%d);
#9014=MEASURE_REPRESENTATION_ITEM('volume measure',VOLUME_MEASURE(%r),#9015);
#9015=DERIVED_UNIT((#9016));
#9016=DERIVED_UNIT_ELEMENT(#%d,3.);
#9021=PROPERTY_DEFINITION('geometric_validation_property','centroid',#%d);
#9022=PROPERTY_DEFINITION_REPRESENTATION(#9021,#9023);
#9023=REPRESENTATION('centroid',(#9024),#%d);
#9024=CARTESIAN_POINT('centre point',(%r,%r,%r));
"""


def test_validation_properties_follow_in_the_files_unit(tmp_path):
    """Of a box of inches, its top pressed in: the recorded numbers become those of the solid as it is."""
    box = BRepPrimAPI_MakeBox(50.8, 25.4, 25.4).Shape()
    document_of_shapes([("box", box)], "in").write(tmp_path / "a.step", "step")
    data = (tmp_path / "a.step").read_bytes()
    records = StepRecords.of(data)
    (shape,) = records.of_type("PRODUCT_DEFINITION_SHAPE")
    context = next(n for n in records.numbers() if records.is_a(n, "GLOBAL_UNIT_ASSIGNED_CONTEXT"))
    inch = next(
        n for n in records.numbers() if records.is_a(n, "CONVERSION_BASED_UNIT") and records.is_a(n, "LENGTH_UNIT")
    )
    numbers = (shape, context, 10.0, inch, shape, context, 2.0, inch, shape, context, 1.0, 0.5, 0.5)
    (tmp_path / "a.step").write_bytes(data.replace(b"ENDSEC;\nEND-ISO", RECORDED % numbers + b"ENDSEC;\nEND-ISO"))
    part = step.read(tmp_path / "a.step")
    assert part.recorded_area == pytest.approx((10 * 25.4**2, 10 * 25.4**2))
    top = max(part.faces, key=lambda face: face.bbox[2])
    part.sculpt({top.number: dented(top.surface, 5.0)})
    part.write(tmp_path / "b.step", "step")
    again = step.read(tmp_path / "b.step")
    found = {p.kind: p for p in properties(StepRecords.of((tmp_path / "b.step").read_bytes()))}
    truth = GProp_GProps()
    BRepGProp.VolumeProperties_s(again.shape, truth, 1e-9, False)
    centre = truth.CentreOfMass()
    assert found["volume"].value[0] == pytest.approx(truth.Mass() / 25.4**3, rel=1e-7)
    assert found["volume"].value[0] < 1.99
    assert found["area"].value[0] == pytest.approx(sum(face.area for face in again.faces) / 25.4**2, rel=1e-7)
    assert found["centroid"].value == pytest.approx([c / 25.4 for c in (centre.X(), centre.Y(), centre.Z())], rel=1e-6)
    assert found["centroid"].value[2] < 0.499


# -------------------------------------------------------------------- assemblies


def rack(path: Path) -> OcctPart:
    """A frame placed twice, each with a pin placed twice and a plate; read from its file."""
    part = document_of_shapes(
        [("pin", BRepPrimAPI_MakeCylinder(2, 9).Shape()), ("plate", shape_of_surface(sheet("plate")))]
    )
    tool = shape_tool(part.document)
    pin, plate = (tool.FindShape(shape) for shape in part.shapes)
    frame, top = tool.NewShape(), tool.NewShape()
    set_name(frame, "frame")
    set_name(top, "rack")

    def place(x: float, y: float) -> TopLoc_Location:
        move = gp_Trsf()
        move.SetTranslation(gp_Vec(x, y, 0))
        return TopLoc_Location(move)

    tool.AddComponent(frame, pin, place(0, 50))
    tool.AddComponent(frame, pin, place(20, 50))
    tool.AddComponent(frame, plate, place(0, 0))
    tool.AddComponent(top, frame, place(0, 0))
    tool.AddComponent(top, frame, place(200, 0))
    tool.UpdateAssemblies()
    OcctPart(part.document, Path("rack"), "step", "mm").write(path, "step")
    return step.read(path)


def test_instances_are_named_and_counted(tmp_path):
    part = rack(tmp_path / "a.step")
    assert [(i.name, i.component, len(i.faces)) for i in part.instances] == [
        ("pin_1", "pin", 3), ("pin_2", "pin", 3), ("plate_1", "plate", 1),
        ("pin_3", "pin", 3), ("pin_4", "pin", 3), ("plate_2", "plate", 1),
    ]  # fmt: skip
    assert sorted(n for i in part.instances for n in i.faces) == list(range(1, 15))
    assert part.faces["plate_2/face1"].bbox[0] == pytest.approx(200.0)
    with pytest.raises(InputError, match="no face named 'plate_3/face1'"):
        part.faces["plate_3/face1"]


def test_all_places_change_alike(tmp_path):
    part = rack(tmp_path / "a.step")
    one, two = (part.faces[f"plate_{k}/face1"] for k in (1, 2))
    goal = dented(two.surface, 2.0)
    part.sculpt({two.number: goal})
    part.write(tmp_path / "b.step", "step")
    again = step.read(tmp_path / "b.step")
    shift = np.array([200.0, 0, 0])
    for number, net in ((one.number, goal.control_points - shift), (two.number, goal.control_points)):
        np.testing.assert_allclose(again.faces.number(number).surface.control_points, net, rtol=0, atol=1e-12)
    assert len(changed_records(*((tmp_path / f"{n}.step").read_bytes() for n in "ab"))) == 1


def test_one_place_alone_has_its_own_copy(tmp_path):
    whole = rack(tmp_path / "a.step")
    part = whole.separated(["plate_2"])
    assert [i.name for i in part.instances] == [i.name for i in whole.instances]
    two = part.faces["plate_2/face1"]
    goal = dented(two.surface, 2.0)
    part.sculpt({two.number: goal})
    part.write(tmp_path / "b.step", "step")
    again = step.read(tmp_path / "b.step")
    for face, was in zip(again.faces, whole.faces, strict=True):
        net = goal.control_points if face.number == two.number else was.surface.control_points
        np.testing.assert_allclose(face.surface.control_points, net, rtol=0, atol=1e-12)
        assert face.name.rpartition("_")[0] == was.name.rpartition("_")[0] or face.name == was.name
    text = (tmp_path / "b.step").read_text()
    assert len(re.findall(r"= ?PRODUCT\(", text)) == 4 + 2  # the plate, and the frame that it is in
    part.write(tmp_path / "c.step", "step")
    assert (tmp_path / "c.step").read_text() == text
    with pytest.raises(InputError, match="no instance named 'plate_9'") as caught:
        whole.separated(["plate_9"])
    assert "plate_2" in str(caught.value)


def test_a_part_without_instances_says_so(tmp_path):
    part = two_sheets(tmp_path / "a.step")
    assert part.instances == ()
    with pytest.raises(InputError, match="no instance named"):
        part.separated(["a"])


def test_loose_faces_keep_their_names_on_the_way_from_iges(tmp_path):
    named = [(name, shape_of_surface(sheet())) for name in ("roof", "floor")]
    document_of_shapes(named, faces=named, format="iges").write(tmp_path / "a.igs", "iges")
    registry.write_part(registry.read(tmp_path / "a.igs"), tmp_path / "b.step", "step")
    assert [face.name for face in step.read(tmp_path / "b.step").faces] == ["roof", "floor"]


# ------------------------------------------------------------------------ real files


def largest(part: Part) -> Face:
    return max((f for f in part.faces if f.kind in ("bspline", "bezier")), key=lambda f: f.area)


@pytest.mark.corpus
@pytest.mark.parametrize("name", ["trj7_c2-ac-214.stp", "trj6_c1-id-214.stp", "splinecage.stp", "trj5_k1-al-214.stp"])
def test_real_files_keep_their_text(name, corpus, tmp_path):
    part = step.read(corpus / "step" / name)
    face = largest(part)
    fine = dented(face.surface, 0.0)
    net = fine.control_points.copy()
    r, s = fine.shape
    net[r // 2, s // 2] += 0.01 * face.surface.normal(*(0.5 * (a + b) for a, b in face.surface.domain)) * fine.size
    part.sculpt({face.number: fine.with_control_points(net)})
    part.write(tmp_path / "b.step", "step")
    assert not any("anew" in line for line in part.warnings), part.warnings
    before, after = (corpus / "step" / name).read_bytes(), (tmp_path / "b.step").read_bytes()
    old = StepRecords.of(before)
    changed = {old.type(n) for n in changed_records(before, after)}
    assert changed <= {
        "B_SPLINE_SURFACE_WITH_KNOTS", "BOUNDED_SURFACE", "QUASI_UNIFORM_SURFACE", "MEASURE_REPRESENTATION_ITEM",
        "CARTESIAN_POINT",
    }  # fmt: skip
    assert len(changed_records(before, after)) <= 4
    again = step.read(tmp_path / "b.step")
    assert len(again.faces) == len(part.faces)


@pytest.mark.corpus
def test_an_assembly_in_an_assembly_gives_one_nut_its_own(corpus, tmp_path):
    whole = step.read(corpus / "step" / "as1_pe_203.stp")
    assert [i.name for i in whole.instances if i.component == "NUT"] == [f"NUT_{k}" for k in range(1, 9)]
    part = whole.separated(["NUT_5"])
    face = next(f for f in part.faces.select([f"NUT_5/face{k}" for k in range(1, 9)]) if f.kind == "plane")
    flat = face.surface
    net = dented(replace(flat, trims=None), 0.0).control_points
    goal = dented(flat, 0.0)
    bent = net + 0.02 * flat.size * flat.normal(*(0.5 * (a + b) for a, b in flat.domain)) * np.pad(
        np.ones((2, 2)), ((1, goal.shape[0] - 3), (1, goal.shape[1] - 3))
    )[..., None]  # fmt: skip
    part.sculpt({face.number: goal.with_control_points(bent)})
    part.write(tmp_path / "b.step", "step")
    again = step.read(tmp_path / "b.step")
    changed = [f.number for f in whole.faces if again.faces.number(f.number).kind != f.kind]
    assert changed == [face.number]
    assert len(again.instances) == len(whole.instances)


@pytest.mark.corpus
def test_units_and_tolerance_of_real_files(corpus):
    records = StepRecords.of((corpus / "step" / "trj8_k1-pe-214.stp").read_bytes())
    assert tolerance(records) == pytest.approx(0.01364714205)
    (face, *_) = records.of_type("ADVANCED_FACE")
    assert millimetres_at(records, face) == 25.4
    found = {p.kind: p for p in properties(records)}
    assert found["area"].value[0] * found["area"].scale == pytest.approx(9.085990470547 * 645.16)
    assert len(found["volume"].faces) == 52


@pytest.mark.corpus
def test_places_are_those_that_the_sender_recorded(corpus):
    """Recorded centroids of placed parts are their own, moved by the placement's matrix; an assembly's area is that of its
    parts."""
    records = StepRecords.of((corpus / "step" / "as1_pe_203.stp").read_bytes())
    assembly = Assembly(records)
    every = properties(records)
    own = {p.product: p for p in every if p.kind == "centroid" and not p.placed}
    placed = [p for p in every if p.kind == "centroid" and p.placed]
    assert len(placed) == 13
    for item in placed:
        centre = np.array([*own[item.product].value, 1.0]) * [25.4, 25.4, 25.4, 1.0]
        moved = assembly.matrix(item.placed) @ centre
        np.testing.assert_allclose(moved[:3], np.array(item.value) * 25.4, rtol=0, atol=1e-7)
    areas = {p.product: p.value[0] for p in every if p.kind == "area"}
    parts = {n: a for n, a in areas.items() if len(list(assembly.below(n))) == 1}
    assert len(parts) == 5
    for product, area in areas.items():
        total = sum(parts.get(inner, 0.0) for inner, _ in assembly.below(product))
        assert total == pytest.approx(area, rel=1e-9)


@pytest.mark.corpus
def test_properties_of_the_assemblies_around_a_part_follow(corpus, tmp_path):
    """A nut gets a dent in one place: the recorded area, volume and centroid of every assembly above become the kernel's."""
    part = step.read(corpus / "step" / "as1_pe_203.stp").separated(["NUT_5"])
    faces = part.faces.select([f"NUT_5/face{k}" for k in range(1, 9)])
    face = max((f for f in faces if f.kind == "plane" and len(f.surface.trims or "x") == 1), key=lambda f: f.area)
    goal = dented(face.surface, 0.0)
    net = goal.control_points.copy()
    middle = tuple(slice(n // 2 - 1, n // 2 + 1) for n in goal.shape)
    net[middle] += 0.1 * goal.size * goal.normal(*(0.5 * (a + b) for a, b in goal.domain))
    part.sculpt({face.number: goal.with_control_points(net)})
    part.write(tmp_path / "b.step", "step")
    assert not any("anew" in line for line in part.warnings)
    before = {(p.kind, p.item): p for p in properties(part.source.records)}
    after = properties(StepRecords.of((tmp_path / "b.step").read_bytes()))
    again = step.read(tmp_path / "b.step")
    truth, was = GProp_GProps(), GProp_GProps()
    BRepGProp.VolumeProperties_s(again.shape, truth, 1e-9, False)
    BRepGProp.VolumeProperties_s(step.read(corpus / "step" / "as1_pe_203.stp").shape, was, 1e-9, False)
    (root,) = [p for p in after if p.kind == "volume" and len(p.parts) > 15]
    change = (root.value[0] - before["volume", root.item].value[0]) * root.scale
    assert change == pytest.approx(truth.Mass() - was.Mass(), rel=1e-4)
    assert abs(change) > 1.0
    changed = {before[p.kind, p.item].product for p in after if before[p.kind, p.item].value != p.value}
    names = sorted(Assembly(part.source.records).name(product) for product in changed)
    assert names == ["AS1_PE_ASM", "L_BRACKET_ASSEMBLY_ASM", "NUT", "NUT_BOLT_ASSEMBLY_ASM"]
    centre = next(p for p in after if p.kind == "centroid" and p.product == root.product and not p.placed)
    shift = (np.array(centre.value) - before["centroid", centre.item].value) * 25.4
    a, b = truth.CentreOfMass(), was.CentreOfMass()
    np.testing.assert_allclose(shift, [a.X() - b.X(), a.Y() - b.Y(), a.Z() - b.Z()], rtol=0.02, atol=1e-6)


def spec(**keys: object) -> ModelSpec:
    return ModelSpec.model_validate(
        {"name": "m", "file": "a.step", "thickness": 1.0, "nodes": 1.0, "material": "clay", **keys}
    )


def test_a_scene_names_faces_of_instances(tmp_path):
    part = rack(tmp_path / "a.step")
    everything = [face.number for face in part.faces]
    pin = next(i for i in part.instances if i.name == "pin_3")

    def numbers(**keys: object) -> list[int]:
        return [face.number for face in chosen_faces(part, spec(**keys).faces, spec(**keys).instances)]

    assert numbers() == everything
    assert numbers(faces=["pin_3/face2"]) == [pin.faces[1]]
    assert numbers(instances=["pin_3"]) == list(pin.faces)
    assert numbers(instances=["pin_3", "plate_1"], faces=["face1"]) == sorted(
        i.faces[0] for i in part.instances if i.name in ("pin_3", "plate_1")
    )
    with pytest.raises(InputError, match="no face 'lid' in pin_3"):
        numbers(instances=["pin_3"], faces=["lid"])
    scene = Scene.model_validate({
        "units": "mm", "tool": [{"name": "t", "shape": "point"}],
        "model": [spec(instances=["pin_3", "pin_1"]).model_dump(), spec(name="n", instances=["pin_1"]).model_dump()],
    })  # fmt: skip
    assert named_instances(scene, tmp_path) == {(tmp_path / "a.step").resolve(): ["pin_3", "pin_1"]}
