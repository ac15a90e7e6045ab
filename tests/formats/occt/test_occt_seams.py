"""Neighbouring faces of a CAD part, all sculpted: the part that comes back is valid, and closed to its own tolerance."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("OCP")

from OCP.BRepAdaptor import BRepAdaptor_Curve
from OCP.BRepBuilderAPI import BRepBuilderAPI_Sewing
from OCP.BRepFilletAPI import BRepFilletAPI_MakeFillet
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeTorus
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Shape

from cadsculpt.export_fit import Exported, export_fit
from cadsculpt.formats import step
from cadsculpt.formats.load import Loaded, load
from cadsculpt.formats.occt.part import document_of_shapes
from cadsculpt.formats.occt.shape import shape_of_surface
from cadsculpt.formats.scene_toml import SceneFile
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface

SCENE = """
schema = 1
units = "mm"
[[model]]
name = "part"
file = "part.step"
thickness = 2.0
nodes = 1.0
layers = 1
material = "clay"
edges = "free"
[[tool]]
name = "ball"
shape = "sphere"
radius = 2.0
[[tool.path]]
t = 0
at = [0, 0, 200]
[[tool.path]]
t = 0.01
at = [0, 0, 199]
[refit]
tolerance = 0.01
continuity = "{continuity}"
"""


def two_sheets() -> TopoDS_Shape:
    """Two bent sheets sewn along x = 20, tangent there, with other knots along the edge."""

    def sheet(low: float, high: float, count: int) -> BSplineSurface:
        knots_u = np.concatenate([np.full(4, low), [0.5 * (low + high)], np.full(4, high)])
        knots_v = np.concatenate([np.full(4, 0.0), np.linspace(0, 30, count - 2)[1:-1], np.full(4, 30.0)])
        u = np.array([knots_u[i + 1 : i + 4].mean() for i in range(5)])
        v = np.array([knots_v[i + 1 : i + 4].mean() for i in range(count)])
        x, y = np.meshgrid(u, v, indexing="ij")
        return BSplineSurface(np.stack([x, y, 0.2 * x + 0 * y], axis=-1), knots_u, knots_v, 3, 3)

    sewing = BRepBuilderAPI_Sewing(1e-6)
    for surface in (sheet(0, 20, 6), sheet(20, 40, 9)):
        sewing.Add(shape_of_surface(surface))
    sewing.Perform()
    return sewing.SewedShape()


PARTS: dict[str, tuple[Callable[[], TopoDS_Shape], list[float], float]] = {
    "two sheets": (two_sheets, [20.5, 15, 4], 3.0),
    "box": (lambda: BRepPrimAPI_MakeBox(30, 20, 10).Shape(), [28, 18, 9], 4.0),
    "torus": (lambda: BRepPrimAPI_MakeTorus(12, 5).Shape(), [17, 0, 0], 3.0),
    "cylinder": (lambda: BRepPrimAPI_MakeCylinder(8, 20).Shape(), [8, 0, 12], 3.0),
}


def rounded_box() -> TopoDS_Shape:
    """A box with the three edges of one corner rounded: planes, cylinders, and a ball's piece with a pole."""
    box = BRepPrimAPI_MakeBox(60, 50, 40).Shape()
    fillet, rounded = BRepFilletAPI_MakeFillet(box), list[TopoDS_Edge]()
    explorer = TopExp_Explorer(box, TopAbs_ShapeEnum.TopAbs_EDGE)
    while explorer.More():
        edge = TopoDS.Edge(explorer.Current())
        curve = BRepAdaptor_Curve(edge)
        ends = np.array([curve.Value(t).Coord() for t in (curve.FirstParameter(), curve.LastParameter())])
        at_corner = np.abs(ends - [60, 50, 40]).max(axis=1).min() < 1e-9
        if at_corner and not any(edge.IsSame(other) for other in rounded):
            rounded.append(edge)
            fillet.Add(12.0, edge)
        explorer.Next()
    assert len(rounded) == 3
    return fillet.Shape()


def test_a_rounded_corner_stays_closed_and_tangent(tmp_path, monkeypatch):
    """A dent where a plane, two cylinders and a ball meet tangentially, away from the ball's pole."""
    monkeypatch.setitem(PARTS, "rounded", (rounded_box, [60, 38, 28], 3.0))
    monkeypatch.setattr(f"{__name__}.SCENE", SCENE.replace("nodes = 1.0", "nodes = 2.0").replace("0.01\n", "0.03\n"))
    loaded, exported = pressed(tmp_path, "rounded", "G1")
    smooth = [seam for seam in exported.seams if seam.angle_as_read < 0.1]
    assert len(smooth) == 9
    for seam in exported.seams:
        assert seam.gap <= seam.tolerance == pytest.approx(1e-7)
        assert seam.angle_as_read < 0.1 or seam.angle_as_read == pytest.approx(90.0, abs=0.1)
    assert max(seam.angle for seam in smooth) <= 0.1
    assert max(face.error.maximum for face in exported.faces) <= 0.05
    [(path, surfaces)] = loaded.sculpted(exported).items()
    part = loaded.parts[path]
    part.sculpt(surfaces)
    assert part.validity().valid, part.validity().faults


def pressed(folder: Path, name: str, continuity: str) -> tuple[Loaded, Exported]:
    """The part, every node of its faces moved by one smooth dent in space, and what goes back."""
    make, at, width = PARTS[name]
    document_of_shapes([("part", make())]).write(folder / "part.step", "step")
    (folder / "scene.toml").write_text(SCENE.format(continuity=continuity))
    loaded = load(SceneFile.load(folder / "scene.toml"))
    session = Session(loaded.model)
    for i, patch in enumerate(loaded.model.patches):
        x = session.lattice(i).x.reshape(*patch.lattice.shape, 3)
        nodes = patch.lattice.nodes.reshape(*patch.lattice.shape, 3)[:, :, 0]
        dent = np.exp(-((nodes - at) ** 2).sum(axis=-1) / (2 * width**2))
        x[:, :, 0] += dent[..., None] * [0.3, -0.4, -1.0]
    return loaded, export_fit(session)


@pytest.mark.parametrize("continuity", ["G0", "G1"])
@pytest.mark.parametrize("name", PARTS)
def test_the_part_comes_back_valid_and_closed(name, continuity, tmp_path):
    loaded, exported = pressed(tmp_path, name, continuity)
    assert [face.outcome for face in exported.faces] == ["within"] * len(exported.faces)
    assert {"two sheets": 1, "box": 12, "torus": 2, "cylinder": 3}[name] == len(exported.seams)
    for seam in exported.seams:
        assert seam.gap <= seam.tolerance
        if seam.angle_as_read < 0.1 and (continuity == "G1" or name != "two sheets"):
            assert seam.angle <= 0.1  # the seams of closed faces are smooth either way
    [(path, surfaces)] = loaded.sculpted(exported).items()
    part = loaded.parts[path]
    part.sculpt(surfaces)
    assert part.validity().valid, part.validity().faults
    assert not [line for line in part.warnings if "leaves face" in line]
    part.write(tmp_path / "out.step", "step")
    again = step.read(tmp_path / "out.step")
    assert again.validity().valid, again.validity().faults
    # no tolerance had to be raised by more than the faces' own gap
    assert max(edge.tolerance for face in again.faces for edge in face.edges) <= 1e-5
    for number, surface in surfaces.items():
        back = again.faces.number(number).surface
        assert back.shape == surface.shape
        np.testing.assert_allclose(back.control_points, surface.control_points, atol=1e-9)


def test_a_dent_in_a_plane_is_smooth_and_small(tmp_path):
    _, exported = pressed(tmp_path, "box", "G0")
    for face in exported.faces:
        assert (face.surface.degree_u, face.surface.degree_v) == (3, 3)
        assert np.prod(face.surface.shape) <= 80
