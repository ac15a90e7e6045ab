"""Displacements over the edges of faces: closed as after a run, the same shape as the run's own, or refused by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("OCP")

from OCP.BRepBuilderAPI import BRepBuilderAPI_Sewing
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder
from OCP.gp import gp_Trsf, gp_Vec
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Shape

from cadsculpt.cli.main import run as command
from cadsculpt.errors import GeometryError
from cadsculpt.formats import displacements, step
from cadsculpt.formats.displace import displace
from cadsculpt.formats.occt.document import set_name, shape_tool
from cadsculpt.formats.occt.part import OcctPart, document_of_shapes
from cadsculpt.formats.occt.shape import shape_of_surface
from cadsculpt.formats.part import Part
from cadsculpt.formats.run_folder import run_scene
from cadsculpt.formats.scene_toml import SceneFile
from cadsculpt.spline.seam import closest
from cadsculpt.spline.surface import BSplineSurface

Array = NDArray[np.float64]


def sheet(low: float, high: float, count: int) -> BSplineSurface:
    """A piece, from x = low to high, of one bent sheet 30 wide."""
    knots_u = np.concatenate([np.full(4, low), [0.5 * (low + high)], np.full(4, high)])
    knots_v = np.concatenate([np.full(4, 0.0), np.linspace(0, 30, count - 2)[1:-1], np.full(4, 30.0)])
    u = np.array([knots_u[i + 1 : i + 4].mean() for i in range(5)])
    v = np.array([knots_v[i + 1 : i + 4].mean() for i in range(count)])
    x, y = np.meshgrid(u, v, indexing="ij")
    return BSplineSurface(np.stack([x, y, 0.2 * x + 0 * y], axis=-1), knots_u, knots_v, 3, 3)


def two_sheets() -> TopoDS_Shape:
    """Two sheets sewn along x = 20, with other knots along the edge."""
    sewing = BRepBuilderAPI_Sewing(1e-6)
    for surface in (sheet(0, 20, 6), sheet(20, 40, 9)):
        sewing.Add(shape_of_surface(surface))
    sewing.Perform()
    return sewing.SewedShape()


def written(path: Path, shape: TopoDS_Shape) -> Part:
    document_of_shapes([("part", shape)]).write(path, "step")
    return step.read(path)


def rim(points: Array, at: Array, width: float) -> Array:
    dent = np.exp(-((points - at) ** 2).sum(axis=1) / (2 * width**2))
    return dent[:, None] * [0.3, -0.4, -1.0]


SHAPES: dict[str, tuple[Callable[[], TopoDS_Shape], list[float], float]] = {
    "two sheets": (two_sheets, [20.5, 15, 4], 3.0),
    "box": (lambda: BRepPrimAPI_MakeBox(30, 20, 10).Shape(), [28, 18, 9], 4.0),
    "cylinder": (lambda: BRepPrimAPI_MakeCylinder(8, 20).Shape(), [8, 0, 18], 3.0),
}


def apart(part: Part) -> float:
    """The largest distance of a face's edges from the neighbours that share them, by the surfaces alone."""
    worst = 0.0
    for face in part.faces:
        for edge in face.edges:
            here = face.surface.evaluate(*edge.uv.T)
            for number in edge.neighbours:
                other = part.faces.number(number)
                starts = [e for e in other.edges if face.number in e.neighbours]
                away = []
                for start in starts:
                    nearest = np.linalg.norm(here[:, None] - start.points, axis=2).argmin(axis=1)
                    uv = closest(other.surface, here, start.uv[nearest])
                    away.append(np.linalg.norm(other.surface.evaluate(*uv.T) - here, axis=1))
                worst = max(worst, float(np.min(away, axis=0).max()))
    return worst


@pytest.mark.parametrize("scattered", [False, True])
@pytest.mark.parametrize("name", SHAPES)
def test_a_field_over_edges_leaves_them_closed(name: str, scattered: bool, tmp_path: Path) -> None:
    make, at, width = SHAPES[name]
    part = written(tmp_path / "a.step", make())
    before = apart(part)
    rng = np.random.default_rng(0)
    clouds = []
    for face in part.faces:
        (a, b), (c, d) = face.surface.domain
        n = 31
        u, v = (rng.uniform(0, 1, n * n) for _ in "uv") if scattered else np.meshgrid(*[np.linspace(0, 1, n)] * 2)
        clouds.append(face.surface.evaluate(a + (b - a) * np.ravel(u), c + (d - c) * np.ravel(v)))
    points = np.concatenate(clouds)
    field = displacements.field_of(points, rim(points, np.array(at), width))
    told = displace(part, field, tolerance=0.02)
    assert len(told.faces) >= 2
    assert {s.faces for s in told.seams if s.faces[0] != s.faces[1]}
    for seam in told.seams:
        assert seam.gap <= max(seam.tolerance, 1.05 * seam.gap_as_read)
    assert max(face.error.maximum for face in told.faces) <= 0.02
    largest = max(seam.tolerance for seam in told.seams)
    assert apart(part) <= max(1.5 * largest, before)
    assert part.validity().valid
    assert not [line for line in part.warnings if "leaves face" in line]


def test_an_edge_that_would_open_is_refused_and_nothing_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With hardly more than the nets as read the side cannot follow the lid."""
    make, at, width = SHAPES["cylinder"]
    part = written(tmp_path / "a.step", make())
    clouds = []
    for face in part.faces:
        (a, b), (c, d) = face.surface.domain
        u, v = (np.ravel(t) for t in np.meshgrid(*[np.linspace(0, 1, 41)] * 2))
        clouds.append(face.surface.evaluate(a + (b - a) * u, c + (d - c) * v))
    points = np.concatenate(clouds)
    field = displacements.field_of(points, rim(points, np.array(at), width))
    nets = [face.surface.control_points.copy() for face in part.faces]
    monkeypatch.setattr("cadsculpt.formats.displace.MOST_CONTROL_POINTS", 100)
    with pytest.raises(
        GeometryError, match=r"the faces '.*' and '.*' are up to .* mm apart .*, above the file's tolerance 1e-07 mm"
    ):
        displace(part, field, tolerance=0.05)
    for face, net in zip(part.faces, nets, strict=True):
        np.testing.assert_array_equal(face.surface.control_points, net)


# ------------------------------------------------------------------ a run's own file

SCENE = """
schema = 1
units = "mm"
[[model]]
name = "part"
file = "part.step"
thickness = 3.0
nodes = 1.0
layers = 2
material = "clay"
edges = "free"
{model}
[[tool]]
name = "ball"
shape = "sphere"
radius = 4.0
[[tool.path]]
t = 0.0
at = {start}
[[tool.path]]
t = 0.02
at = {end}
[solver]
step = 1e-3
resolution = 41
[refit]
tolerance = 0.02
continuity = "{continuity}"
[output]
cad = ["step"]
pictures = false
"""


def both_ways(folder: Path, *, options: list[str], **scene: object) -> tuple[Part, Part, Part]:
    """The part as read, after a run, and moved by the run's displacements."""
    defaults = {"model": "", "continuity": "G0"}
    (folder / "scene.toml").write_text(SCENE.format(**(defaults | scene)))
    run_scene(SceneFile.load(folder / "scene.toml"), folder / "run")
    arguments = ["convert", str(folder / "part.step"), str(folder / "moved.step"), "--refit", "0.02", "--quiet"]
    assert command([*arguments, "--displacements", str(folder / "run" / "displacements.csv"), *options]) == 0
    return tuple(step.read(folder / name) for name in ("part.step", "run/surfaces.step", "moved.step"))  # type: ignore


def differences(wanted: Part, found: Part) -> list[float]:
    """Per face the largest distance of the same (u, v)."""
    result = []
    for a, b in zip(wanted.faces, found.faces, strict=True):
        u, v = (np.linspace(*side, 60) for side in a.surface.domain)
        gap = a.surface.evaluate(u[:, None], v) - b.surface.evaluate(u[:, None], v)
        result.append(float(np.linalg.norm(gap, axis=2).max()))
    return result


@pytest.mark.parametrize("continuity", ["G0", "G1"])
def test_a_run_over_an_edge_and_its_displacements_make_the_same_shape(continuity: str, tmp_path: Path) -> None:
    written(tmp_path / "part.step", two_sheets())
    options = ["--continuity", continuity]
    read, run, moved = both_ways(
        tmp_path, options=options, start=[20.5, 15, 8.4], end=[20.5, 15, 7.4], continuity=continuity
    )
    assert min(differences(read, run)) > 0.3
    assert max(differences(run, moved)) <= 0.02
    assert apart(moved) <= 1e-5


def two_places(path: Path) -> None:
    """An assembly: the two sewn sheets in two places, 100 mm apart."""
    part = document_of_shapes([("plate", two_sheets())])
    tool = shape_tool(part.document)
    plate, pair = tool.FindShape(part.shapes[0]), tool.NewShape()
    set_name(pair, "pair")
    for x in (0.0, 100.0):
        move = gp_Trsf()
        move.SetTranslation(gp_Vec(x, 0.0, 0.0))
        tool.AddComponent(pair, plate, TopLoc_Location(move))
    tool.UpdateAssemblies()
    OcctPart(part.document, Path("pair"), "step", "mm").write(path, "step")


@pytest.mark.parametrize("places", [["plate_2"], "all"])
def test_an_instance_moves_alone_if_it_is_named(places: list[str] | str, tmp_path: Path) -> None:
    two_places(tmp_path / "part.step")
    part = step.read(tmp_path / "part.step")
    assert [(i.name, len(i.faces)) for i in part.instances] == [("plate_1", 2), ("plate_2", 2)]
    second = [part.faces.number(n).name for n in part.instances[1].faces]
    model = f"faces = {second}" if places == "all" else f"instances = {places}"
    options = [] if places == "all" else ["--instance", "plate_2"]
    read, run, moved = both_ways(tmp_path, options=options, model=model, start=[120.5, 15, 8.4], end=[120.5, 15, 7.4])
    assert max(differences(run, moved)) <= 0.02
    changed = differences(read, moved)
    assert min(changed[n - 1] for n in part.instances[1].faces) > 0.3
    first = max(changed[n - 1] for n in part.instances[0].faces)
    assert first > 0.3 if places == "all" else first == 0.0
    assert apart(moved) <= 1e-5
