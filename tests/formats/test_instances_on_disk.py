"""A part placed twice in a STEP file, sculpted by `cadsculpt run` in one place or in both; read with OpenCASCADE alone."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("OCP")

from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder
from OCP.collections import Sequence_TDF_Label
from OCP.Geom import Geom_BSplineSurface
from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
from OCP.GProp import GProp_GProps
from OCP.Quantity import Quantity_Color, Quantity_TOC_RGB
from OCP.STEPCAFControl import STEPCAFControl_Reader, STEPCAFControl_Writer
from OCP.STEPControl import STEPControl_StepModelType
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDF import TDF_AttributeIterator, TDF_Label
from OCP.TDocStd import TDocStd_Document
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Face, TopoDS_Shape
from OCP.XCAFDoc import (
    XCAFDoc_Area,
    XCAFDoc_Centroid,
    XCAFDoc_ColorSurf,
    XCAFDoc_DocumentTool,
    XCAFDoc_ShapeTool,
    XCAFDoc_Volume,
)

from cadsculpt.cli.main import run as command
from cadsculpt.formats.load import load
from cadsculpt.formats.scene_toml import SceneFile

RED, BLUE = (0.8, 0.1, 0.1), (0.1, 0.2, 0.9)
KEPT: list[TDocStd_Document] = []
"""Documents, which must outlive the labels and attributes in them."""
FAR = 100.0
"""Between the two places, mm; the second one is turned by a quarter as well."""


def measures(shape: TopoDS_Shape) -> tuple[float, float, np.ndarray]:
    """Volume, area and centroid."""
    solid, skin = GProp_GProps(), GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, solid, 1e-10, False)
    BRepGProp.SurfaceProperties_s(shape, skin, 1e-10)
    c = solid.CentreOfMass()
    return solid.Mass(), skin.Mass(), np.array([c.X(), c.Y(), c.Z()])


def place(x: float, degrees: float) -> TopLoc_Location:
    turn, move = gp_Trsf(), gp_Trsf()
    turn.SetRotation(gp_Ax1(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1)), np.radians(degrees))
    move.SetTranslation(gp_Vec(x, 0, 0))
    move.Multiply(turn)
    return TopLoc_Location(move)


def assembly(path: Path) -> None:
    """Blocks 30 x 20 x 10 at 0 and, turned, at FAR, and a pin: with names, colours, layers and validation properties."""
    document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
    KEPT.append(document)
    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    colours = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    layers = XCAFDoc_DocumentTool.LayerTool_s(document.Main())
    block, pin = BRepPrimAPI_MakeBox(30, 20, 10).Shape(), BRepPrimAPI_MakeCylinder(3, 25).Shape()
    labels = []
    for name, shape, colour, layer in (("block", block, RED, "soft"), ("pin", pin, BLUE, "hard")):
        label = shapes.AddShape(shape, False)
        TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))
        colours.SetColor(label, Quantity_Color(*colour, Quantity_TOC_RGB), XCAFDoc_ColorSurf)
        layers.SetLayer(label, TCollection_ExtendedString(layer))
        volume, area, centre = measures(shape)
        XCAFDoc_Volume.Set_s(label, volume)
        XCAFDoc_Area.Set_s(label, area)
        XCAFDoc_Centroid.Set_s(label, gp_Pnt(*centre))
        labels.append(label)
    pair = shapes.NewShape()
    TDataStd_Name.Set_s(pair, TCollection_ExtendedString("pair"))
    for label, where in (
        (labels[0], place(0, 0)), (labels[0], place(FAR, 90)), (labels[1], place(50, 0)),
    ):  # fmt: skip
        shapes.AddComponent(pair, label, where)
    shapes.UpdateAssemblies()
    writer = STEPCAFControl_Writer()
    for mode in ("Name", "Color", "Layer", "Props"):
        getattr(writer, f"Set{mode}Mode")(True)
    assert writer.Transfer(document, STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(str(path))


@dataclass
class Component:
    """A placed part as OpenCASCADE reads it."""

    path: tuple[str, ...]
    """The names of the products that it is in, from the outermost to its own."""
    shape: TopoDS_Shape
    colour: tuple[float, float, float] | None
    layers: list[str]
    volume: float | None
    area: float | None
    centroid: np.ndarray | None
    own: TopoDS_Shape
    """As it stands in its own file frame."""

    @property
    def surfaces(self) -> list[Any]:
        """What each face's surface is: its kind, and the poles of a spline."""
        found: list[Any] = []
        for face in faces_of(self.own):
            surface = BRep_Tool.Surface_s(face)
            if isinstance(surface, Geom_BSplineSurface):
                n, m = surface.NbUPoles(), surface.NbVPoles()
                found.append([surface.Pole(i + 1, j + 1).Coord() for i in range(n) for j in range(m)])
            else:
                found.append(surface.DynamicType().Name())
        return found

    @property
    def bumps(self) -> int:
        return sum(isinstance(surface, list) for surface in self.surfaces)


def faces_of(shape: TopoDS_Shape) -> list[TopoDS_Face]:
    explorer, found = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_FACE), []
    while explorer.More():
        found.append(TopoDS.Face(explorer.Current()))
        explorer.Next()
    return found


def components(path: Path) -> list[Component]:
    """The placed parts of a STEP file, in order, whatever depth they stand at."""
    document = TDocStd_Document(TCollection_ExtendedString("XmlXCAF"))
    KEPT.append(document)
    reader = STEPCAFControl_Reader()
    for mode in ("Name", "Color", "Layer", "Props"):
        getattr(reader, f"Set{mode}Mode")(True)
    reader.ReadFile(str(path))
    assert reader.Transfer(document)
    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    free = Sequence_TDF_Label()
    shapes.GetFreeShapes(free)
    found: list[Component] = []

    def walk(label: TDF_Label, where: TopLoc_Location, path: tuple[str, ...] = ()) -> None:
        path = (*path, of_kind(label, TDataStd_Name).Get().ToExtString())
        if not XCAFDoc_ShapeTool.IsAssembly_s(label):
            found.append(component(document, label, where, path))
            return
        below = Sequence_TDF_Label()
        XCAFDoc_ShapeTool.GetComponents_s(label, below)
        for i in range(1, below.Length() + 1):
            child, target = below.Value(i), TDF_Label()
            XCAFDoc_ShapeTool.GetReferredShape_s(child, target)
            walk(target, where.Multiplied(XCAFDoc_ShapeTool.GetLocation_s(child)), path)

    for i in range(1, free.Length() + 1):
        walk(free.Value(i), TopLoc_Location())
    return found


def of_kind(label: TDF_Label, kind: type) -> Any:
    attributes = TDF_AttributeIterator(label)
    while attributes.More():
        if isinstance(attributes.Value(), kind):
            return attributes.Value()
        attributes.Next()
    return None


def component(document: TDocStd_Document, label: TDF_Label, where: TopLoc_Location, path: tuple[str, ...]) -> Component:
    colours = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    layers = XCAFDoc_DocumentTool.LayerTool_s(document.Main())
    own = XCAFDoc_ShapeTool.GetShape_s(label)
    # (FindAttribute would put another handle into Python's object)
    volume, area, centre = (of_kind(label, kind) for kind in (XCAFDoc_Volume, XCAFDoc_Area, XCAFDoc_Centroid))
    colour = Quantity_Color()
    coloured = colours.GetColor_s(label, XCAFDoc_ColorSurf, colour) or colours.GetColor(own, XCAFDoc_ColorSurf, colour)
    if not coloured:  # styled face by face
        coloured = any(colours.GetColor(face, XCAFDoc_ColorSurf, colour) for face in faces_of(own))
    names = layers.GetLayers(label)
    point = None if centre is None else centre.Get()
    return Component(
        path=path,
        shape=own.Moved(where),
        colour=(colour.Red(), colour.Green(), colour.Blue()) if coloured else None,
        layers=[names.Value(i).ToExtString() for i in range(1, names.Length() + 1)] if names is not None else [],
        volume=None if volume is None else volume.Get(),
        area=None if area is None else area.Get(),
        centroid=None if point is None else np.array([point.X(), point.Y(), point.Z()]),
        own=own,
    )


SCENE = """
schema = 1
units = "mm"
{models}
{tools}
[solver]
step = 1e-3
resolution = 41
[refit]
tolerance = 0.02
[output]
cad = ["step"]
pictures = false
"""
MODEL = """
[[model]]
name = "{name}"
file = "pair.step"
faces = {faces}
instances = {instances}
thickness = 4.0
nodes = 1.0
layers = 2
material = "clay"
"""
TOOL = """
[[tool]]
name = "{name}"
shape = "sphere"
radius = 5.0
[[tool.path]]
t = 0.0
at = [{x}, {y}, 15.2]
[[tool.path]]
t = 0.02
at = [{x}, {y}, {to}]
"""
FIRST = TOOL.format(name="ball", x=14, y=11, to=14.1)
SECOND = TOOL.format(name="other", x=FAR - 11, y=14, to=13.8)


def pressed(folder: Path, models: str, tools: str) -> tuple[list[Component], list[Component], dict[str, Any]]:
    """The components before and after a run from the command line, and result.json."""
    assembly(folder / "pair.step")
    (folder / "scene.toml").write_text(SCENE.format(models=models, tools=tools))
    assert command(["run", str(folder / "scene.toml"), "-o", str(folder / "out"), "--quiet"]) == 0
    assert BRepCheck_Analyzer(whole(folder / "out" / "surfaces.step")).IsValid()
    return (
        components(folder / "pair.step"),
        components(folder / "out" / "surfaces.step"),
        json.loads((folder / "out" / "result.json").read_text()),
    )


def whole(path: Path) -> TopoDS_Shape:
    from OCP.TopoDS import TopoDS_Compound

    builder, compound = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(compound)
    for item in components(path):
        builder.Add(compound, item.shape)
    return compound


def top_face(folder: Path) -> str:
    """The label of the block's upper face within the component."""
    from cadsculpt.formats import step

    part = step.read(folder)
    [first, *_] = [i for i in part.instances if i.component == "block"]
    return next(
        label
        for label, number in zip(first.labels, first.faces, strict=True)
        if part.faces.number(number).bbox[2] > 9.0
    )


def dressed(before: list[Component], after: list[Component]) -> None:
    """Names, colours and layers of every component are what they were, wherever it stands."""
    assert [c.path for c in before] == [("pair", "block"), ("pair", "block"), ("pair", "pin")]
    assert [c.path for c in after] == [c.path for c in before]
    assert [c.layers for c in after] == [c.layers for c in before] == [["soft"], ["soft"], ["hard"]]
    for a, b in zip(before, after, strict=True):
        assert a.colour is not None
        assert b.colour == pytest.approx(a.colour, abs=1e-6)
    for item in after:
        volume, area, centre = measures(item.own)
        assert item.volume == pytest.approx(volume, rel=1e-6)
        assert item.area == pytest.approx(area, rel=1e-6)
        np.testing.assert_allclose(item.centroid, centre, atol=1e-5)


def test_one_place_changes_and_the_other_keeps_its_bytes(tmp_path: Path) -> None:
    assembly(tmp_path / "pair.step")
    face = top_face(tmp_path / "pair.step")
    model = MODEL.format(name="block", faces=[face], instances=["block_2"])
    before, after, result = pressed(tmp_path, model, SECOND)
    dressed(before, after)
    assert [c.bumps for c in after] == [0, 1, 0]
    assert after[0].surfaces == before[0].surfaces
    assert after[1].own.TShape() is not after[0].own.TShape()
    # the dent is where the ball was: under (FAR - 11, 14)
    volumes = [measures(c.shape)[0] for c in after]
    assert volumes[0] == pytest.approx(6000.0, rel=1e-9)
    assert volumes[1] < 5990.0
    assert result["summary"]["refit_max_error"] <= 0.02
    # every record of the file is there, and those of the first place with their bytes
    old = (tmp_path / "pair.step").read_text().split("DATA;")[1].split("ENDSEC;")[0]
    new = set((tmp_path / "out" / "surfaces.step").read_text().split("DATA;")[1].split(";\n"))
    kinds = ("CARTESIAN_POINT", "PLANE", "ADVANCED_FACE", "EDGE_CURVE", "CLOSED_SHELL", "MANIFOLD_SOLID", "LINE")
    geometry = [record for record in old.split(";\n") if any(f"{kind}(" in record for kind in kinds)]
    assert len(geometry) > 50
    assert not [record for record in geometry if record not in new]


@pytest.mark.parametrize("apart", [True, False])
def test_both_places_change_when_the_scene_says_both(apart: bool, tmp_path: Path) -> None:
    """Each its own dent where both are named; one dent in both where all places change alike."""
    assembly(tmp_path / "pair.step")
    face = top_face(tmp_path / "pair.step")
    if apart:
        models = MODEL.format(name="block", faces=[face], instances=["block_1", "block_2"])
        tools = FIRST + SECOND
    else:
        models = MODEL.format(name="block", faces=[f"block_1/{face}"], instances='"all"')
        tools = FIRST
    before, after, result = pressed(tmp_path, models, tools)
    dressed(before, after)
    assert [c.bumps for c in after] == [1, 1, 0]
    lost = [6000.0 - measures(c.shape)[0] for c in after[:2]]
    if apart:
        assert lost[1] > 1.3 * lost[0] > 5.0
        assert after[0].surfaces != after[1].surfaces
        assert len(result["faces"]) == 2
    else:
        assert lost[0] == pytest.approx(lost[1], rel=1e-12)
        assert lost[0] > 5.0
        assert any("placed several times" in line for line in result["warnings"])


def test_two_dents_in_one_shape_are_told_before_the_run_and_refused_after(tmp_path: Path, capsys: Any) -> None:
    assembly(tmp_path / "pair.step")
    face = top_face(tmp_path / "pair.step")
    both = [f"block_1/{face}", f"block_2/{face}"]
    model = MODEL.format(name="block", faces=both, instances='"all"')
    (tmp_path / "scene.toml").write_text(SCENE.format(models=model, tools=FIRST + SECOND))
    assert any("one face in two places" in line for line in load(SceneFile.load(tmp_path / "scene.toml")).warnings)
    assert command(["run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out"), "--quiet"]) == 2
    assert "name both places in the scene's instances" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.corpus
@pytest.mark.parametrize("places", [["NUT_5"], ["NUT_5", "NUT_2"]])
def test_nuts_of_a_real_assembly(places: list[str], corpus: Path, tmp_path: Path) -> None:
    """An assembly of assemblies in inches: the nuts that are named get a dent, all else is what it was."""
    from cadsculpt.formats import step

    source = corpus / "step" / "as1_pe_203.stp"
    part = step.read(source)
    models, tools = "", ""
    for name in places:
        [nut] = [i for i in part.instances if i.name == name]
        face = max((part.faces.number(n) for n in nut.faces), key=lambda f: f.area * (f.kind == "plane"))
        spot, normal, size = middle_of(face)
        label = nut.labels[nut.faces.index(face.number)]
        models += MODEL.format(name=name, faces=[label], instances=[name]).replace("pair.step", source.as_posix())
        models = models.replace("thickness = 4.0", f"thickness = {0.2 * size}").replace(
            "nodes = 1.0", f"nodes = {size / 25}"
        )
        at = [(spot + h * size * normal).round(9).tolist() for h in (0.151, 0.13)]
        tools += TOOL.format(name=f"ball {name}", x=0, y=0, to=0).replace("radius = 5.0", f"radius = {0.15 * size}")
        tools = tools.replace("[0, 0, 15.2]", str(at[0])).replace("[0, 0, 0]", str(at[1]))
    (tmp_path / "scene.toml").write_text(
        SCENE.format(models=models, tools=tools).replace("0.02\n[output]", "1.0\n[output]")
    )
    assert command(["run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out"), "--quiet"]) == 0
    before, after = components(source), components(tmp_path / "out" / "surfaces.step")
    assert [c.path for c in after] == [c.path for c in before]
    changed = [k for k, (a, b) in enumerate(zip(before, after, strict=True)) if a.surfaces != b.surfaces]
    assert len(changed) == len(places)
    assert all("NUT" in after[k].path for k in changed)
    for k, (a, b) in enumerate(zip(before, after, strict=True)):
        assert b.colour == a.colour
        assert b.layers == a.layers
        volume, area, centre = measures(b.own)
        if k in changed:
            assert b.bumps == 1
            assert volume < measures(a.own)[0]
        if b.volume is not None:
            assert b.volume == pytest.approx(volume, rel=1e-6)
            assert b.area == pytest.approx(area, rel=1e-6)
            np.testing.assert_allclose(b.centroid, centre, atol=1e-5 * area**0.5)


def middle_of(face: Any) -> tuple[np.ndarray, np.ndarray, float]:
    """A place well inside a flat face, its normal there, and the face's size."""
    from cadsculpt.spline.trim import inside

    surface = face.surface
    u, v = (np.linspace(a, b, 41) for a, b in surface.domain)
    on = np.pad(inside(surface, u, v), 1)
    depth = np.zeros(on.shape)
    while on.any():
        depth += on
        on = on & np.roll(on, 1, 0) & np.roll(on, -1, 0) & np.roll(on, 1, 1) & np.roll(on, -1, 1)
    i, j = np.unravel_index(depth[1:-1, 1:-1].argmax(), (41, 41))
    size = float(np.linalg.norm(np.ptp(surface.control_points.reshape(-1, 3), axis=0)))
    normal = surface.normal(u[i], v[j]) * (1.0 if surface.outward else -1.0)
    return surface.evaluate(u[i], v[j]), normal, size * depth.max() / 41
