"""The tolerance that a file states is the gap that sculpted edges may have: read in mm, believed where it makes sense, told."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("OCP")

import rhino3dm
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox

from cadsculpt.export_seams import seams_of
from cadsculpt.formats import displacements, registry, step
from cadsculpt.formats.displace import displace
from cadsculpt.formats.iges_records import parse, text_of
from cadsculpt.formats.load import source_face
from cadsculpt.formats.occt.part import document_of_shapes
from cadsculpt.formats.part import Part
from cadsculpt.formats.stated_tolerance import stated_tolerance


def box(path: Path, format: str, units: str = "mm") -> str:
    """A box of 30 x 20 x 10 mm in a file; returns its text."""
    document_of_shapes([("box", BRepPrimAPI_MakeBox(30, 20, 10).Shape())], units).write(path, format)
    return path.read_text(encoding="latin-1")


def restated(text: str, value: str) -> str:
    """The STEP text with another uncertainty."""
    again, count = re.subn(r"(UNCERTAINTY_MEASURE_WITH_UNIT\(LENGTH_MEASURE\()[^)]*", rf"\g<1>{value}", text)
    assert count
    return again


def bounds_of(part: Part) -> set[tuple[float, str]]:
    """What the seams of a part may gape, and who says so."""
    faces = [source_face(part, face, "mm") for face in part.faces]
    return {(round(seam.tolerance, 12), seam.source) for seam in seams_of(faces)}


@pytest.mark.parametrize(("units", "mm"), [("mm", 1.0), ("in", 25.4), ("m", 1000.0)])
def test_step_states_it_in_its_unit(units: str, mm: float, tmp_path: Path) -> None:
    text = box(tmp_path / "a.step", "step", units)
    (tmp_path / "b.step").write_text(restated(text, f"{0.004 / mm:.12E}"))
    part = step.read(tmp_path / "b.step")
    assert part.tolerance_of(1) == pytest.approx(0.004, rel=1e-9)
    assert bounds_of(part) == {(0.004, "file")}
    # taken in another unit, it grows with the numbers
    again = step.read(tmp_path / "b.step", units="cm")
    assert again.tolerance_of(1) == pytest.approx(0.004 / mm * 10.0, rel=1e-9)


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ("0.", "is no distance"),
        ("-1.E-04", "is no distance"),
        ("0.1", "of the part"),
        ("1.E-16", "its numbers can tell"),
    ],
)
def test_nonsense_is_told_and_not_used(stated: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "a.step").write_text(restated(box(tmp_path / "a.step", "step"), stated))
    part = step.read(tmp_path / "a.step")
    assert {source for _, source in bounds_of(part)} == {"size"}
    [line] = [line for line in part.warnings if "the tolerance that the file states" in line]
    assert said in line
    assert "1e-7 of a face's size" in line


def test_a_face_has_the_uncertainty_of_its_own_representation(tmp_path: Path) -> None:
    """Two products in one file, with contexts of their own."""
    shapes = [(name, BRepPrimAPI_MakeBox(30, 20, 10).Shape()) for name in ("fine", "coarse")]
    document_of_shapes(shapes).write(tmp_path / "a.step", "step")
    text = (tmp_path / "a.step").read_text()
    numbers = iter(("2.E-05", "3.E-03"))
    count = len(re.findall("UNCERTAINTY_MEASURE_WITH_UNIT", text))
    assert count == 2
    text = re.sub(r"(UNCERTAINTY_MEASURE_WITH_UNIT\(LENGTH_MEASURE\()[^)]*", lambda m: m[1] + next(numbers), text)
    (tmp_path / "b.step").write_text(text)
    part = step.read(tmp_path / "b.step")
    assert len(part.faces) == 12
    assert [part.tolerance_of(n) for n in range(1, 13)] == pytest.approx([2e-5] * 6 + [3e-3] * 6)
    assert bounds_of(part) == {(2e-5, "file"), (3e-3, "file")}
    assert part.tolerance == pytest.approx(3e-3)


@pytest.mark.parametrize(("written", "mm"), [("2.D-3", 0.002), ("1.0E-4", 1e-4), ("", None), ("0.", 0.0)])
def test_iges_states_it_in_its_global_section(written: str, mm: float | None, tmp_path: Path) -> None:
    text = box(tmp_path / "a.igs", "iges")
    file = parse(text)
    file.header[18] = written
    (tmp_path / "b.igs").write_text(text_of(file), encoding="latin-1")
    part = registry.read(tmp_path / "b.igs")
    found = part.tolerance_of(1)
    assert found == (None if mm is None else pytest.approx(mm))
    sources = {source for _, source in bounds_of(part)}
    assert sources == ({"file"} if mm else {"size"})
    assert any("is no distance" in line for line in part.warnings) == (mm == 0.0)


def test_3dm_states_it_in_the_settings_and_on_edges(corpus: Path) -> None:
    seen = 0
    for name in ("v4_DinerMug.3dm", "v5_ring.3dm", "v7_my_trimmed_surface.3dm"):
        part = registry.read(corpus / "rhino" / name)
        truth = rhino3dm.File3dm.Read(str(corpus / "rhino" / name)).Settings.ModelAbsoluteTolerance
        assert part.tolerance_of(1) == pytest.approx(truth)
        value, doubt = stated_tolerance(part, part.faces[0])
        assert (value == 0.0) == bool(doubt) == (truth > 1e-3 * part.extent)
        for face in part.faces:
            if face.warning or not value:
                continue
            for edge, own in zip(source_face(part, face, "mm").edges, face.edges, strict=True):
                assert edge.tolerance == pytest.approx(max(own.tolerance, value))
                assert edge.stated == (own.tolerance <= value)
                seen += 1
    assert seen > 10


@pytest.mark.corpus
@pytest.mark.parametrize(
    ("name", "mm"), [("trj8_k1-pe-214.stp", 0.01364714205), ("Ventilator.stp", None), ("trj5_k1-al-214.stp", None)]
)
def test_real_files_state_what_their_text_says(name: str, mm: float | None, corpus: Path) -> None:
    text = (corpus / "step" / name).read_text(encoding="latin-1")
    part = step.read(corpus / "step" / name)
    said = {
        float(x)
        for x in re.findall(r"UNCERTAINTY_MEASURE_WITH_UNIT\s*\(\s*(?:LENGTH_MEASURE\s*\(\s*)?([^),\s]+)", text)
    }
    factor = 25.4 if "trj8" in name else 1.0 if part.units == "mm" else 10.0
    found = {part.tolerance_of(face.number) for face in part.faces}
    for value in found - {None}:
        assert min(abs(value - x * f) for x in said for f in (1.0, factor)) <= 1e-9 * value
    assert found - {None}
    if mm is not None:
        assert list(found) == [pytest.approx(mm)]


def test_the_gap_is_held_to_it_and_a_coarser_one_makes_smaller_nets(tmp_path: Path) -> None:
    """A dent over a box's corner: with 1e-7, with 2e-3, and with a tolerance of the user's own."""
    text = box(tmp_path / "a.step", "step")
    sizes = {}
    for stated, wanted in (("1.E-07", None), ("2.E-03", None), ("1.E-07", 1e-3)):
        (tmp_path / "b.step").write_text(restated(text, stated))
        part = step.read(tmp_path / "b.step")
        clouds = []
        for face in part.faces:
            (a, b), (c, d) = face.surface.domain
            u, v = (np.ravel(t) for t in np.meshgrid(*[np.linspace(0, 1, 31)] * 2))
            clouds.append(face.surface.evaluate(a + (b - a) * u, c + (d - c) * v))
        points = np.concatenate(clouds)
        dent = np.exp(-((points - [29, 19, 9]) ** 2).sum(axis=1) / 18)[:, None] * [0.3, -0.4, -1.0]
        told = displace(part, displacements.field_of(points, dent), tolerance=0.02, seam_tolerance=wanted)
        bound = wanted or float(stated)
        assert {seam.tolerance_from for seam in told.seams} == {"scene" if wanted else "file"}
        assert all(seam.gap <= seam.tolerance == pytest.approx(bound) for seam in told.seams)
        assert part.validity().valid
        sizes[stated, wanted] = sum(np.prod(face.surface.shape) for face in part.faces)
    assert sizes["2.E-03", None] <= sizes["1.E-07", None]
