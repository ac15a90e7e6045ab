"""Distances of meshes against all pairs of triangles, and against closed shapes."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.collide.certified.distance import distance
from cadsculpt.collide.certified.proximity import proximity
from cadsculpt.collide.detect import FieldTool
from cadsculpt.collide.mesh.distance import MeshDistance, mesh_distance
from cadsculpt.collide.mesh.field import MeshField
from cadsculpt.collide.mesh.tri_distance import triangle_distance
from cadsculpt.collide.mesh.triangle_mesh import TriangleMesh
from cadsculpt.motion.pose import Pose, rotation_matrix
from cadsculpt.tools.mesh import MeshTool, PlacedMesh

from .test_mesh import cube

trimesh = pytest.importorskip("trimesh")


def field_of(shape: trimesh.Trimesh) -> MeshField:
    return MeshField.of(TriangleMesh.of(shape.vertices, shape.faces))


def brute(a: MeshField, b: MeshField) -> float:
    mine, its = (f.mesh.vertices[f.mesh.triangles] for f in (a, b))
    return min(triangle_distance(p, q).distance for p in mine for q in its)


def checked(a: MeshField, b: MeshField) -> MeshDistance:
    found = mesh_distance(a, b)
    back = mesh_distance(b, a)
    assert back.low <= found.high
    assert found.low <= back.high
    for point, field, index in zip(found.points, (a, b), found.triangles, strict=True):
        assert np.abs(field.distance(point[None])[0]) <= 1e-13 * field.tree.size + 1e-15 * np.abs(point).max()
        corners = field.mesh.vertices[field.mesh.triangles[index]]
        assert triangle_distance(corners, [point] * 3).distance <= 1e-13 * field.tree.size + 1e-15 * np.abs(point).max()
    assert found.low <= np.linalg.norm(found.points[0] - found.points[1]) + 1e-14
    return found


def test_against_all_pairs():
    rng = np.random.default_rng(1)
    shapes = [
        trimesh.creation.icosphere(subdivisions=1),
        trimesh.creation.torus(1.0, 0.3, major_sections=8, minor_sections=5),
        trimesh.creation.cone(0.5, 2.0, sections=9),
        trimesh.creation.box((1, 2, 0.1)),
    ]
    met = 0
    for k in range(16):
        a = field_of(shapes[k % 4])
        turned = rotation_matrix(rng.normal(size=3), rng.uniform(0, 360))
        b = field_of(shapes[rng.integers(4)]).moved(turned, rng.normal(size=3) * (0.8 if k % 3 == 0 else 2.0))
        truth = brute(a, b)
        found = checked(a, b)
        assert found.low <= truth <= found.high
        assert found.high - found.low < 1e-12
        assert (found.high == 0.0) == (truth == 0.0)
        met += truth == 0.0
    assert 2 <= met <= 14


@pytest.mark.parametrize("gap", [1.0, 1e-3, 1e-9, 0.0])
def test_boxes_corner_to_corner_and_face_to_face(gap):
    low = MeshField.of(TriangleMesh.of(*cube(0.0, 1.0)))
    vertices, triangles = cube(0.0, 1.0)
    for shift in ([1.0 + gap, 0.25, 0.5], [1.0 + gap, 1.0 + gap, 0.5], [1.0 + gap, 1.0 + gap, 1.0 + gap]):
        other = MeshField.of(TriangleMesh.of(vertices + shift, triangles))
        found = checked(low, other)
        exact = np.linalg.norm(np.maximum(np.min(other.mesh.vertices, axis=0) - 1.0, 0.0))
        assert found.low <= exact <= found.high
        assert (found.high == 0.0) == (gap == 0.0)


def test_a_ball_in_a_box_has_the_distance_of_the_surfaces():
    ball, box = field_of(trimesh.creation.icosphere(subdivisions=3)), field_of(trimesh.creation.box((6, 8, 10)))
    found = checked(ball, box)
    assert found.low <= 2.0 <= found.high  # a vertex of the ball stands on each axis
    assert (box.distance(ball.mesh.vertices) < 0.0).all()


def test_an_open_mesh_has_a_distance():
    sheet = MeshField.of(TriangleMesh.of([[0.0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0]], [[0, 1, 2], [0, 2, 3]]))
    ball = field_of(trimesh.creation.icosphere(subdivisions=2)).moved(np.eye(3), np.array([4.0, 5.0, 1.25]))
    found = checked(sheet, ball)
    assert found.low <= 0.25 <= found.high
    assert mesh_distance(sheet, ball.moved(np.eye(3), np.array([0.0, 0.0, -1.0]))).high == 0.0


def test_a_placed_mesh_is_a_field():
    tool = MeshTool.of(TriangleMesh.of(*cube(-1.0, 1.0)))
    pose = Pose.turned([3.0, -1.0, 2.0], [1, 2, 3], 50)
    placed = tool.placed(pose).field
    points = np.random.default_rng(3).normal(size=(300, 3)) * 2 + pose.at
    distance, normal, foot = tool.rest.query(pose.to_tool(points))
    np.testing.assert_array_equal(placed.distance(points), distance)
    np.testing.assert_allclose(placed.gradient(points), pose.direction_to_world(normal), atol=1e-15)
    np.testing.assert_allclose(placed.nearest(points), pose.to_world(foot), atol=1e-14)
    moved = tool.rest.moved(pose.rotation, pose.at)
    np.testing.assert_allclose(moved.distance(points), distance, atol=1e-14)
    np.testing.assert_allclose(placed.box(), moved.box(), atol=1e-15)
    assert placed.closed
    np.testing.assert_allclose(placed.vertices, moved.mesh.vertices, atol=1e-15)


def placed(shape: trimesh.Trimesh, *at: float, turn: float = 0.0) -> FieldTool:
    pose = Pose.turned(at, [1, 2, 3], turn)
    return MeshTool.of(TriangleMesh.of(shape.vertices, shape.faces)).placed(pose)


@pytest.mark.parametrize(
    ("at", "verdict", "kind", "gap"),
    [
        ((5.5, 0.5, 0.0), "clear", "clear", 1.5),
        ((4.0, 0.5, 0.25), "contact", "touching", 0.0),
        ((3.7, 0.5, 0.25), "contact", "piercing", 0.0),
        ((0.5, 0.5, 0.25), "contact", "contained", 0.0),
    ],
)
def test_proximity_of_meshes_is_that_of_their_triangles(at, verdict, kind, gap):
    large, ball = placed(trimesh.creation.box((6, 8, 10)), 0, 0, 0), placed(trimesh.creation.icosphere(2), *at)
    for a, b in ((large, ball), (ball, large)):
        found = proximity(a, b)
        assert (found.verdict, found.kind) == (verdict, kind)
        assert found.distance.low <= gap + 1e-15 <= found.distance.high + 2e-15
        assert found.distance.high - found.distance.low < 1e-12
        assert not found.distance.exhausted


def test_distance_of_placed_meshes_against_all_pairs():
    rng = np.random.default_rng(4)
    torus, cone = trimesh.creation.torus(1.0, 0.3, 8, 5), trimesh.creation.cone(0.5, 2.0, sections=9)
    for _ in range(4):
        a, b = placed(torus, 0, 0, 0, turn=rng.uniform(0, 360)), placed(cone, *rng.normal(size=3) * 2.5, turn=40)
        found = distance(a, b, tolerance=0.0)
        truth = brute(a.field.in_world(), b.field.in_world())
        assert found.low <= truth <= found.high
        assert found.high - found.low < 1e-12
        assert np.linalg.norm(found.a.point - found.b.point) == pytest.approx(truth, abs=1e-12)


def test_a_lump_of_many_inside_a_mesh_counts():
    box, far = trimesh.creation.box((4, 4, 4)), trimesh.creation.icosphere(1)
    lumps = trimesh.util.concatenate(
        [far.copy().apply_translation([9, 0, 0]), far.copy().apply_translation([0.2, 0, 0])]
    )
    for a, b in ((placed(box, 0, 0, 0), placed(lumps, 0, 0, 0)), (placed(lumps, 0, 0, 0), placed(box, 0, 0, 0))):
        assert distance(a, b).high == 0.0


def test_nothing_lies_inside_an_open_mesh():
    box = trimesh.creation.box((4, 4, 4))
    bin_ = trimesh.Trimesh(box.vertices, box.faces[:-2], process=False)
    field = PlacedMesh(MeshField.of(TriangleMesh.of(bin_.vertices, bin_.faces)), Pose(np.zeros(3)))
    found = proximity(FieldTool(field), placed(trimesh.creation.icosphere(1), 0.1, 0, 0))
    assert (found.verdict, found.kind) == ("clear", "clear")
    assert 0.85 <= found.distance.low <= found.distance.high < 1.2


@pytest.mark.corpus
def test_real_meshes_side_by_side(corpus):
    from cadsculpt.formats.mesh import read_mesh

    torus, cavity = (
        MeshField.of(read_mesh(corpus / "mesh" / n)) for n in ("torus_default_resolution.stl", "ktoolcav.stl")
    )
    low, high = torus.box()
    beside = cavity.moved(np.eye(3), np.array([high[0] + 1.0 - cavity.box()[0, 0], 0.0, 0.0]))
    found = checked(torus, beside)
    assert found.low >= 1.0 - 1e-9
    sampled = np.abs(beside.distance(torus.mesh.vertices)).min(), np.abs(torus.distance(beside.mesh.vertices)).min()
    assert found.low <= min(sampled)
    same = mesh_distance(torus, torus.moved(np.eye(3), np.array([0.1 * (high - low)[0], 0.0, 0.0])))
    assert same.high == 0.0
