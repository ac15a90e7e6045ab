"""A mesh as a tool: what it takes, how it is drawn, and that a box of triangles presses like the box."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cadsculpt.collide.detect import DetectOptions, PatchGrid, detect
from cadsculpt.collide.mesh.triangle_mesh import TriangleMesh
from cadsculpt.errors import GeometryError, InputError
from cadsculpt.formats.scene_toml import SceneFile
from cadsculpt.motion.pose import Pose
from cadsculpt.spline.surface import BSplineSurface
from cadsculpt.tools.implicit import ImplicitTool
from cadsculpt.tools.mesh import MeshTool
from cadsculpt.tools.outline import outline

trimesh = pytest.importorskip("trimesh")

CASES = Path(__file__).parents[1] / "cases"


def box(size: float) -> tuple[np.ndarray, np.ndarray]:
    shape = trimesh.creation.box((size, size, size))
    return shape.vertices, shape.faces


def test_an_open_mesh_is_no_tool():
    vertices, triangles = box(2.0)
    with pytest.raises(GeometryError, match="not watertight: it has 3 open edges"):
        MeshTool.of(TriangleMesh.of(vertices, triangles[1:]))


def test_its_picture_is_the_mesh():
    vertices, triangles = box(2.0)
    tool = MeshTool.of(TriangleMesh.of(vertices, triangles))
    points, faces = outline(tool, scene_size=1.0)
    p = points[faces]
    assert np.einsum("fi,fi->", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6.0 == pytest.approx(8.0)  # outwards
    np.testing.assert_array_equal(tool.box_corners, [[-1, -1, -1], [1, 1, 1]])


@pytest.mark.parametrize(
    "pose", [Pose.turned([5, 5, 0.9], [1, 0.3, 0], 20), Pose.turned([4.3, 5.2, 0.6], [0, 0, 1], 33)]
)
def test_a_box_of_triangles_meets_a_patch_as_the_box_does(pose):
    x = np.linspace(0.0, 10.0, 5)
    X, Y = np.meshgrid(x, x, indexing="ij")
    knots = np.array([0.0, 0, 0, 0, 0.5, 1, 1, 1, 1])
    surface = BSplineSurface(np.stack([X, Y, 0.1 * np.sin(X + Y)], axis=-1), knots, knots, 3, 3)
    grid = PatchGrid.of(surface, 61)
    tools = [MeshTool.of(TriangleMesh.of(*box(2.0))), ImplicitTool.box((2.0, 2.0, 2.0))]
    found, truth = (
        detect([grid], [surface.control_points], [tool.placed(pose)], DetectOptions(margin=0.05)).contacts
        for tool in tools
    )
    assert len(truth) > 20
    np.testing.assert_array_equal(found.u, truth.u)
    np.testing.assert_array_equal(found.v, truth.v)
    np.testing.assert_allclose(found.depth, truth.depth, atol=1e-14)
    np.testing.assert_allclose(found.area, truth.area, rtol=1e-12)
    lengths = np.linalg.norm(found.point - found.tool_point, axis=1)
    np.testing.assert_allclose(lengths, np.abs(found.depth), atol=1e-14)


def test_a_place_that_is_no_number_is_an_error():
    tool = MeshTool.of(TriangleMesh.of(*box(2.0)))
    x = np.linspace(0.0, 1.0, 2)
    X, Y = np.meshgrid(x, x, indexing="ij")
    knots = np.array([0.0, 0, 1, 1])
    surface = BSplineSurface(np.stack([X, Y, 0 * X], axis=-1), knots, knots, 1, 1)
    nowhere = Pose(np.array([0.0, np.nan, 0.0]))
    with pytest.raises(InputError):
        detect([PatchGrid.of(surface, 5)], [surface.control_points], [tool.placed(nowhere)], DetectOptions())


def test_a_scene_with_a_mesh_is_built_in_its_units(tmp_path):
    model = SceneFile.load(CASES / "mesh_punch.toml").build()
    low, high = model.tools[0].tool.box_corners
    np.testing.assert_allclose(high - low, [16.0, 8.0 * np.sqrt(3.0), 10.0], rtol=1e-11)


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        (lambda text: text[: len(text) // 2], "no faces"),
        (
            lambda text: text.replace("vertex 0.8", "vertex 0.9", 1),
            r"hexagon_cm.stl: the mesh is not watertight: it has 4 ",
        ),
        (lambda text: "", "no faces"),
    ],
    ids=["half", "moved corner", "empty"],
)
def test_a_bad_mesh_is_one_line(tmp_path, broken, said, capsys):
    from cadsculpt.cli.main import run as cadsculpt

    (tmp_path / "parts").mkdir()
    for name in ("mesh_punch.toml", "parts/plate.json", "parts/hexagon_cm.stl"):
        (tmp_path / name).write_text((CASES / name).read_text())
    stl = tmp_path / "parts" / "hexagon_cm.stl"
    text = stl.read_text()
    stl.write_text(broken(text))
    with pytest.raises(InputError, match=said):
        SceneFile.load(tmp_path / "mesh_punch.toml").build()
    assert cadsculpt(["run", str(tmp_path / "mesh_punch.toml"), "-o", str(tmp_path / "out"), "--quiet"]) == 2
    said_lines = capsys.readouterr().err
    assert said_lines.count("\n") == 1, said_lines
