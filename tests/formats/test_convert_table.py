"""The table in docs/commands.md of what each format keeps, cell by cell: what it says is so, and what it denies is lost."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("OCP")

from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox
from OCP.collections import Sequence_TDF_Label
from OCP.gp import gp_Trsf, gp_Vec
from OCP.Quantity import Quantity_Color, Quantity_TOC_RGB
from OCP.TopLoc import TopLoc_Location
from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool, XCAFDoc_ShapeTool

from cadsculpt.cli.main import run as command
from cadsculpt.formats import patch_json, registry
from cadsculpt.formats.mesh import read_mesh
from cadsculpt.formats.occt.document import METRES_PER_MM, labels, new_document, set_length_unit, shape_tool
from cadsculpt.formats.occt.part import OcctPart, document_of_shapes
from cadsculpt.formats.part import Part
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

Array = NDArray[np.float64]

DOCS = Path(__file__).parents[2] / "docs" / "commands.md"

TARGETS = {
    "STEP": ".step",
    "IGES": ".igs",
    "Rhino 3DM": ".3dm",
    "patch JSON": ".json",
    "NURBS-Python JSON": ".geomdl.json",
    "GoTools": ".g2",
    "G+Smo XML": ".xml",
}


def table() -> dict[str, dict[str, str]]:
    """Format -> column -> what the cell says."""
    lines = DOCS.read_text(encoding="utf-8").split("## convert")[1].split("\n## ")[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")]
    head = next(row for row in rows if row[0] == "format")
    return {
        row[0]: dict(zip(head[1:], row[1:], strict=True))
        for row in rows
        if len(row) == len(head) and row[0] != "format"
    }


CELLS = [
    (name, column)
    for name in TARGETS
    for column in (
        "units",
        "names",
        "trims",
        "weights",
        "knots",
        "orientation",
        "solids",
        "assemblies",
        "colours, layers",
    )
]


def patch(
    name: str, *, weights: bool = False, trims: bool = False, outward: bool = True, shift: float = 0.0
) -> BSplineSurface:
    """Degrees 3 x 2 over odd knots, with digits that no short decimal holds."""
    knots_u, knots_v = np.array([-1.0, -1, -1, -1, 1 / 3, 2.1, 7, 7, 7, 7]), np.array([0.0, 0, 0, 1 / 7, 1, 1, 1])
    x, y = np.meshgrid(np.arange(6.0), np.arange(4.0), indexing="ij")
    net = np.stack([x * 17 / 3 + shift, y * 19 / 7, np.sin(x) + y / 3], axis=2)
    w = 1.0 + 0.3 * np.cos(x + y) if weights else None
    loops = None
    if trims:
        corners = [(0.0, 0.2), (5.0, 0.2), (5.0, 0.7), (0.0, 0.7), (0.0, 0.2)]
        line = np.array([0.0, 0, 1, 1])
        loops = (TrimLoop(tuple(TrimCurve(np.array(c), line, 1) for c in zip(corners[:-1], corners[1:], strict=True))),)
    return BSplineSurface(net, knots_u, knots_v, 3, 2, w, outward=outward, trims=loops, name=name)


def converted(surfaces: list[BSplineSurface], suffix: str, folder: Path, units: str = "mm") -> Part:
    source, target = folder / "in.json", folder / f"out{suffix}"
    patch_json.write_surfaces(source, surfaces, units)
    assert command(["convert", str(source), str(target), "--quiet"]) == 0
    return registry.read(target, units=None)


def same_weights(a: BSplineSurface, b: BSplineSurface) -> bool:
    if a.weights is None or b.weights is None:
        return a.weights is None and b.weights is None
    return bool(np.allclose(a.weights / a.weights[0, 0], b.weights / b.weights[0, 0], rtol=1e-14))


def keeps_units(suffix: str, folder: Path) -> bool:
    part = converted([patch("a")], suffix, folder, "in")
    net = part.faces[0].surface.control_points
    if part.units:
        np.testing.assert_allclose(net, 25.4 * patch("a").control_points, rtol=1e-14, atol=1e-12)
        return True
    np.testing.assert_allclose(net, patch("a").control_points, rtol=1e-14, atol=1e-12)  # the file's numbers, as if mm
    return False


def keeps_names(suffix: str, folder: Path) -> bool:
    part = converted([patch("crown"), patch("skirt", shift=90.0)], suffix, folder)
    return [face.name for face in part.faces] == ["crown", "skirt"]


def keeps_trims(suffix: str, folder: Path) -> bool:
    part = converted([patch("a", trims=True)], suffix, folder)
    truth = registry.read(folder / "in.json").faces[0].area
    face = part.faces[0]
    kept = face.trimmed
    assert (abs(face.area - truth) <= 1e-6 * truth) == kept
    return kept


def keeps_weights(suffix: str, folder: Path) -> bool:
    surface = patch("a", weights=True)
    back = converted([surface], suffix, folder).faces[0].surface
    return back.rational and same_weights(back, surface)


def keeps_orientation(suffix: str, folder: Path) -> bool:
    """Two faces that look opposite ways still do, the one where it did."""
    pair = [patch("a"), patch("b", outward=False, shift=90.0)]
    part = converted(pair, suffix, folder)
    found = []
    for face, surface in zip(part.faces, pair, strict=True):
        (a, b), (c, d) = face.surface.domain
        normal = face.surface.normal(0.5 * (a + b), 0.5 * (c + d))
        truth = surface.normal(3.0, 0.5)
        assert abs(abs(normal @ truth) - 1.0) < 1e-9
        found.append(bool(normal @ truth > 0))
    return all(found)


def keeps_colours(suffix: str, folder: Path) -> str:
    """A STEP file's red box, and what a file of its own format brings is in that format's own tests."""
    part = document_of_shapes([("box", BRepPrimAPI_MakeBox(30.0, 20.0, 10.0).Shape())])
    colours = XCAFDoc_DocumentTool.ColorTool_s(part.document.Main())
    paint = Quantity_Color(0.9, 0.1, 0.1, Quantity_TOC_RGB)
    colours.SetColor(part.shapes[0], paint, XCAFDoc_ColorType.XCAFDoc_ColorSurf)
    part.write(folder / "red.step", "step")
    target = folder / f"out{suffix}"
    assert command(["convert", str(folder / "red.step"), str(target), "--quiet"]) == 0
    back = registry.read(target)
    if not isinstance(back, OcctPart):
        return "from 3DM" if suffix == ".3dm" else "no"
    tool = XCAFDoc_DocumentTool.ColorTool_s(back.document.Main())
    found = Quantity_Color()
    shapes = [*back.shapes, *(back.face(face.number).shape for face in back.faces)]
    kinds = (XCAFDoc_ColorType.XCAFDoc_ColorSurf, XCAFDoc_ColorType.XCAFDoc_ColorGen)
    red = any(
        tool.GetColor(shape, kind, found) and found.Red() > 2 * found.Blue() for shape in shapes for kind in kinds
    )
    return "from STEP and IGES" if red else "no"


def keeps_solids(suffix: str, folder: Path) -> bool:
    """All six faces of a box still know their neighbours, by shared edges and not by chance."""
    document_of_shapes([("box", BRepPrimAPI_MakeBox(30.0, 20.0, 10.0).Shape())]).write(folder / "box.step", "step")
    target = folder / f"out{suffix}"
    assert command(["convert", str(folder / "box.step"), str(target), "--quiet"]) == 0
    back = registry.read(target)
    assert len(back.faces) == 6
    if type(back).__name__ == "PatchPart":
        return False  # surfaces alone: edges are joined where they run together
    return all(len({n for edge in face.edges for n in edge.neighbours}) == 4 for face in back.faces)


def keeps_assemblies(suffix: str, folder: Path) -> str:
    """One box placed twice: an assembly still, or two boxes where they stood."""
    document = new_document()
    set_length_unit(document, METRES_PER_MM)
    tool = shape_tool(document)
    box = tool.AddShape(BRepPrimAPI_MakeBox(30.0, 20.0, 10.0).Shape(), False)
    assembly = tool.NewShape()
    for shift in (0.0, 100.0):
        place = gp_Trsf()
        place.SetTranslation(gp_Vec(shift, 0.0, 0.0))
        tool.AddComponent(assembly, box, TopLoc_Location(place))
    tool.UpdateAssemblies()
    OcctPart(document, folder / "two.step", "step", "mm").write(folder / "two.step", "step")
    target = folder / f"out{suffix}"
    assert command(["convert", str(folder / "two.step"), str(target), "--quiet"]) == 0
    back = registry.read(target)
    assert len(back.faces) == 12
    centres = sorted(0.5 * (face.bbox[0] + face.bbox[3]) for face in back.faces)
    np.testing.assert_allclose(centres, [0.0, *[15.0] * 4, 30.0, 100.0, *[115.0] * 4, 130.0], atol=1e-5)
    if not isinstance(back, OcctPart):
        return "as placed parts" if type(back).__name__ == "RhinoPart" else "as placed faces"
    sequence = Sequence_TDF_Label()
    shape_tool(back.document).GetFreeShapes(sequence)
    still = any(XCAFDoc_ShapeTool.IsAssembly_s(label) for label in labels(sequence))
    return "yes" if still else "as placed parts"


def keeps_knots(suffix: str, folder: Path) -> str:
    """Degrees, knots and control points bit for bit, trimmed or not."""
    same = []
    for trims in (False, True):
        here = folder / str(trims)
        here.mkdir()
        surface = patch("a", trims=trims)
        back = converted([surface], suffix, here).faces[0].surface
        assert (back.degree_u, back.degree_v) == (3, 2)
        assert back.shape == surface.shape
        assert np.abs(back.control_points - surface.control_points).max() <= 1e-12
        knots = np.array_equal(back.knots_u, surface.knots_u) and np.array_equal(back.knots_v, surface.knots_v)
        same.append(knots and np.array_equal(back.control_points, surface.control_points))
    return "yes" if all(same) else "untrimmed" if same[0] else "no"


KEEPS: dict[str, Callable[[str, Path], bool | str]] = {
    "units": keeps_units,
    "names": keeps_names,
    "trims": keeps_trims,
    "weights": keeps_weights,
    "orientation": keeps_orientation,
    "solids": keeps_solids,
    "knots": keeps_knots,
    "assemblies": keeps_assemblies,
    "colours, layers": keeps_colours,
}


@pytest.mark.parametrize(("name", "column"), CELLS)
def test_the_cell_is_true(name: str, column: str, tmp_path: Path) -> None:
    kept = KEEPS[column](TARGETS[name], tmp_path)
    assert table()[name][column] == (kept if isinstance(kept, str) else "yes" if kept else "no")


def test_every_column_and_row_is_tested() -> None:
    rows = table()
    assert set(rows) == {*TARGETS, "triangles, out only"}
    assert {column for row in rows.values() for column in row} == {"extensions", *KEEPS}
    for name, suffix in TARGETS.items():
        assert f"`{suffix}`" in rows[name]["extensions"]


def test_what_is_lost_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    patch_json.write_surfaces(tmp_path / "in.json", [patch("a", trims=True)], "in")
    for suffix, words in ((".g2", "no length unit"), (".xml", "no trims"), (".stl", "no length unit")):
        assert command(["convert", str(tmp_path / "in.json"), str(tmp_path / f"out{suffix}"), "--quiet"]) == 0
        assert words in capsys.readouterr().err


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply"])
def test_the_row_of_triangles(suffix: str, tmp_path: Path) -> None:
    """Trims as edges, solids as closed meshes, turned outwards, within the tolerance; numbers in the file's unit."""
    row = table()["triangles, out only"]
    assert (row["units"], row["names"], row["trims"], row["weights"]) == ("no", "no", "as edges", "as shape")
    assert (row["orientation"], row["solids"]) == ("yes", "as closed meshes")
    assert f"`{suffix}`" in row["extensions"]
    part = document_of_shapes([("box", BRepPrimAPI_MakeBox(30.0, 20.0, 10.0).Shape())], "cm")
    part.write(tmp_path / "box.step", "step")
    assert command(["convert", str(tmp_path / "box.step"), str(tmp_path / f"box{suffix}"), "--quiet"]) == 0
    mesh = read_mesh(tmp_path / f"box{suffix}")
    assert mesh.closed
    assert mesh.volume == pytest.approx(6.0, rel=1e-6)
    surface = replace(patch("a", weights=True), trims=patch("a", trims=True).trims)
    patch_json.write_surfaces(tmp_path / "in.json", [surface], "mm")
    assert (
        command(["convert", str(tmp_path / "in.json"), str(tmp_path / f"a{suffix}"), "--tolerance", "0.001", "--quiet"])
        == 0
    )
    area = read_mesh(tmp_path / f"a{suffix}").area
    assert area == pytest.approx(registry.read(tmp_path / "in.json").faces[0].area, rel=1e-3)


def test_a_file_becomes_every_other_and_comes_back(tmp_path: Path) -> None:
    """From each format to each: the same surfaces, within rounding, and the trims that both can hold."""
    surfaces = [patch("a", weights=True), patch("b", shift=90.0)]
    first: dict[str, Path] = {}
    patch_json.write_surfaces(tmp_path / "in.json", surfaces, "mm")
    for suffix in TARGETS.values():
        first[suffix] = tmp_path / f"one{suffix}"
        assert command(["convert", str(tmp_path / "in.json"), str(first[suffix]), "--quiet"]) == 0
    for source in first.values():
        for suffix in TARGETS.values():
            target = tmp_path / f"two{suffix}"
            arguments = ["convert", str(source), str(target), "--units", "mm", "--force", "--quiet"]
            assert command(arguments) == 0
            back = registry.read(target, units="mm")
            assert len(back.faces) == 2
            for face, surface in zip(back.faces, surfaces, strict=True):
                found = face.surface
                (a, b), (c, d) = found.domain
                s, t = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9))
                truth = surface.evaluate(-1 + 8 * s, t)
                points = found.evaluate(a + (b - a) * s, c + (d - c) * t)
                assert np.abs(points - truth).max() <= 1e-9 * surface.size, (source.name, target.name)
                assert same_weights(found, surface)


def test_patterns_of_the_docs_name_the_tested_options() -> None:
    text = DOCS.read_text(encoding="utf-8").split("## convert")[1].split("\n## ")[0]
    for option in ("--displacements", "--displace", "--displacement-units", "--reach", "--refit"):
        assert re.search(rf"`{option}\b", text)
