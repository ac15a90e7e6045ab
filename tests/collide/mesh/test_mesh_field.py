"""Distances from meshes against brute force over all triangles by another formula, closed shapes, and what a distance
must satisfy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cadsculpt.collide.mesh.field import MeshField
from cadsculpt.collide.mesh.triangle_mesh import TriangleMesh
from cadsculpt.errors import GeometryError
from cadsculpt.formats.mesh import read_mesh
from cadsculpt.tools.implicit import ImplicitTool

from .test_mesh import cube, with_caps

trimesh = pytest.importorskip("trimesh")

Array = NDArray[np.float64]


def field_of(shape: trimesh.Trimesh) -> MeshField:
    return MeshField.of(TriangleMesh.of(shape.vertices, shape.faces))


def segment_distance(x: Array, a: Array, b: Array) -> Array:
    t = np.clip(((x - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1), 0.0, 1.0)
    return np.linalg.norm(x - a - t[..., None] * (b - a), axis=-1)


def brute_distance(mesh: TriangleMesh, points: Array) -> Array:
    """The least over all triangles: of the three edges, and of the plane where the foot has positive barycentrics."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    twice = (normal**2).sum(axis=1)
    best = np.full(len(points), np.inf)
    for start in range(0, len(points), 200):
        x = points[start : start + 200, None]
        inside = np.ones((x.shape[0], len(a)), np.bool_)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= (np.cross(q - p, x - p) * normal).sum(axis=2) > 0.0
        height = np.abs(((x - a) * normal).sum(axis=2)) / np.sqrt(twice)
        edges = np.minimum.reduce([segment_distance(x, p, q) for p, q in ((a, b), (b, c), (c, a))])
        best[start : start + 200] = np.where(inside, np.minimum(height, edges), edges).min(axis=1)
    return best


def winding(mesh: TriangleMesh, points: Array) -> Array:
    """How often the mesh goes round each point, from solid angles."""
    out = np.empty(len(points))
    for i, x in enumerate(points):
        a, b, c = (mesh.vertices[mesh.triangles[:, k]] - x for k in range(3))
        la, lb, lc = (np.linalg.norm(p, axis=1) for p in (a, b, c))
        top = (a * np.cross(b, c)).sum(axis=1)
        low = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        out[i] = np.arctan2(top, low).sum() / (2.0 * np.pi)
    return out


def around(mesh: TriangleMesh, count: int, seed: int) -> Array:
    """Points near faces, edges and vertices, on both sides, and in the box about the mesh."""
    rng = np.random.default_rng(seed)
    p = mesh.vertices[mesh.triangles[rng.integers(len(mesh.triangles), size=count)]]
    weights = rng.dirichlet([1.0, 1.0, 1.0], count)
    weights[: count // 3, 2] = 0.0  # on an edge
    weights[: count // 6, 1] = 0.0  # on a vertex
    weights /= weights.sum(axis=1, keepdims=True)
    size = np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    near = (weights[:, :, None] * p).sum(axis=1) + size * 10.0 ** rng.uniform(-5, -1, (count, 1)) * rng.normal(
        size=(count, 3)
    )
    low, high = mesh.box
    return np.concatenate([near, rng.uniform(low - 0.3 * size, high + 0.3 * size, (count // 2, 3))])


def star(seed: int) -> MeshField:
    """A ball with spikes: vertices and edges with acute angles of both kinds."""
    shape = trimesh.creation.icosphere(subdivisions=2)
    stretch = np.random.default_rng(seed).choice([0.2, 1.0, 4.0], len(shape.vertices))
    return MeshField.of(TriangleMesh.of(shape.vertices * stretch[:, None], shape.faces))


SHAPES = {
    "tetrahedron": lambda: MeshField.of(
        TriangleMesh.of([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, 0.05]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    ),
    "needle": lambda: field_of(trimesh.creation.cone(radius=0.01, height=3.0, sections=5)),
    "knife": lambda: field_of(trimesh.creation.cylinder(radius=1.0, height=1e-4, sections=40)),
    "ball": lambda: field_of(trimesh.creation.icosphere(subdivisions=3)),
    "torus": lambda: field_of(trimesh.creation.torus(2.0, 0.5, major_sections=24, minor_sections=12)),
    "star": lambda: star(3),
    "caps": lambda: MeshField.of(TriangleMesh.of(*with_caps(5))),
    "cavity": lambda: field_of(
        trimesh.util.concatenate([trimesh.creation.box((4, 4, 4)), trimesh.creation.icosphere(subdivisions=2)])
    ),
    "far away": lambda: MeshField.of(TriangleMesh.of(cube(0.0, 1.0)[0] + [1e6, -2e6, 3e6], cube(0.0, 1.0)[1])),
}  # fmt: skip


@pytest.fixture(scope="module", params=SHAPES.values(), ids=SHAPES.keys())
def field(request) -> MeshField:
    return request.param()


def rounding(field: MeshField) -> float:
    return 1e-15 * (field.tree.size + np.abs(field.mesh.vertices).max())


def test_distance_is_the_least_of_all_triangles(field):
    points = around(field.mesh, 600, 1)
    distance, _, foot = field.query(points)
    brute = brute_distance(field.mesh, points)
    np.testing.assert_allclose(np.abs(distance), brute, rtol=1e-12, atol=8 * rounding(field))
    np.testing.assert_allclose(np.linalg.norm(points - foot, axis=1), brute, rtol=1e-12, atol=8 * rounding(field))
    assert np.abs(field.distance(foot)).max() < 8 * rounding(field)


def test_inside_is_where_the_mesh_goes_round(field):
    points = around(field.mesh, 600, 2)
    distance = field.distance(points)
    clear = np.abs(distance) > 1e3 * rounding(field)
    turns = winding(field.mesh, points)[clear]
    sure = np.abs(turns - np.rint(turns)) < 1e-3
    assert sure.mean() > 0.99
    np.testing.assert_array_equal(distance[clear][sure] < 0.0, np.rint(turns[sure]) == 1)


def test_a_distance_is_lipschitz(field):
    points = around(field.mesh, 2000, 3)
    rng = np.random.default_rng(4)
    step = field.tree.size * 10.0 ** rng.uniform(-6, -1, (len(points), 1))
    other = points + step * rng.normal(size=points.shape)
    change = np.abs(field.distance(points) - field.distance(other))
    assert (change <= np.linalg.norm(points - other, axis=1) + 16 * rounding(field)).all()


def test_the_gradient_leads_to_the_foot(field):
    points = around(field.mesh, 600, 6)
    distance, normal, foot = field.query(points)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(points - distance[:, None] * normal, foot, atol=16 * rounding(field))
    on = field.query(foot)[1]  # on the surface itself: a face's normal, or the mean of those that meet
    assert np.isfinite(on).all()
    np.testing.assert_allclose(np.linalg.norm(on, axis=1), 1.0, rtol=1e-12)


def test_answers_do_not_depend_on_the_order_of_points(field):
    points = around(field.mesh, 600, 8)
    whole = field.query(points)
    order = np.random.default_rng(9).permutation(len(points))
    for one, other in zip(whole, field.query(points[order]), strict=True):
        np.testing.assert_array_equal(one[order], other)
    alone = [field.query(point)[0][0] for point in points[:100]]
    np.testing.assert_array_equal(whole[0][:100], alone)


def test_answers_do_not_depend_on_the_order_of_triangles(field):
    points = around(field.mesh, 400, 10)
    rng = np.random.default_rng(11)
    mesh = field.mesh
    place = rng.permutation(len(mesh.vertices))
    vertices = np.empty_like(mesh.vertices)
    vertices[place] = mesh.vertices
    triangles = place[mesh.triangles][rng.permutation(len(mesh.triangles))]
    turned = np.take_along_axis(triangles, (rng.integers(3, size=(len(triangles), 1)) + np.arange(3)) % 3, axis=1)
    other = MeshField.of(TriangleMesh.of(vertices, turned))
    np.testing.assert_allclose(other.distance(points), field.distance(points), rtol=1e-13, atol=8 * rounding(field))


def test_a_box_of_triangles_is_the_box():
    size = (1.0, 2.0, 0.6)
    vertices, triangles = cube(-0.5, 0.5)
    field = MeshField.of(TriangleMesh.of(vertices * size, triangles))
    points = np.random.default_rng(1).uniform(-2, 2, (20000, 3))
    corner = np.array(size) / 2
    points[:2000] = corner * np.random.default_rng(2).choice(
        [-1.0, 0.0, 1.0, 1.5], (2000, 3)
    )  # edges, corners, on faces
    distance, normal = ImplicitTool.box(size).field(points)
    np.testing.assert_allclose(field.distance(points), distance, rtol=0, atol=4e-16)
    clear = np.abs(distance) > 1e-3
    inner = np.sort(np.abs(points) - corner, axis=1)
    one_face = (inner[:, 2] - inner[:, 1] > 1e-9) & (points != 0.0).all(axis=1)
    single = clear & ((distance > 0) | one_face)
    np.testing.assert_allclose(field.gradient(points)[single], normal[single], atol=1e-12)


def test_a_ball_of_triangles_lies_between_two_balls():
    shape = trimesh.creation.icosphere(subdivisions=4)
    field = field_of(shape)
    inner = np.linalg.norm(shape.triangles_center, axis=1).min() * 0.9999  # chords cut the ball
    points = np.random.default_rng(3).normal(size=(5000, 3))
    radius = np.linalg.norm(points, axis=1)
    distance = field.distance(points)
    assert (distance >= radius - 1.0 - 1e-14).all()
    assert (distance <= radius - inner + 1e-14).all()


def test_one_triangle_is_open_and_unsigned():
    field = MeshField.of(TriangleMesh.of([[0.0, 0, 0], [3, 0, 0], [0, 4, 0]], [[0, 1, 2]]))
    assert not field.closed
    points = np.array([[1.0, 1, 2], [1, 1, -2], [-3, -4, 0], [1, 1, 0], [3, 4, 0]])
    distance, normal, foot = field.query(points)
    assert distance.tolist() == pytest.approx([2, 2, 5, 0, 2.4])
    assert normal[0].tolist() == [0, 0, 1]
    assert normal[1].tolist() == [0, 0, -1]
    assert foot[4].tolist() == pytest.approx([3 - 2.4 * 0.8, 4 - 2.4 * 0.6, 0])


@given(st.floats(-17, -1), st.floats(0.05, 0.95), st.integers(0, 2**32 - 1))
def test_slivers_are_as_exact_as_others(exponent, along, seed):
    """A triangle of height 10^exponent: the distance is that of its longest edge, to the height and to rounding."""
    height = 10.0**exponent
    rng = np.random.default_rng(seed)
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    a, b = np.zeros(3), frame[0]
    c = along * frame[0] + height * frame[1]
    try:
        field = MeshField.of(TriangleMesh.of([a, b, c], [[0, 1, 2]]))
    except GeometryError as error:
        assert "all its triangles are without area" in str(error)
        assert height < 1e-13
        return
    points = rng.normal(size=(50, 3))
    to_edge = segment_distance(points, a, b)
    distance = field.distance(points)
    assert (distance <= to_edge + 4e-16).all()
    assert (distance >= to_edge - height - 4e-16).all()


@pytest.mark.parametrize("scale", [1e-68, 1e-6, 1e6, 1e68])
def test_a_mesh_may_have_any_size(scale):
    field = star(5)
    scaled = MeshField.of(TriangleMesh.of(field.mesh.vertices, field.mesh.triangles, scale=scale))
    points = around(field.mesh, 300, 14)
    np.testing.assert_allclose(
        scaled.distance(scale * points), scale * field.distance(points), rtol=1e-9, atol=1e-14 * scale
    )


def test_nothing_is_near_a_point_that_is_not_finite():
    field = field_of(trimesh.creation.box())
    points = np.array([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 0], [0, 0, 1e200]])
    for answer in field.query(points):
        assert np.isnan(answer[[0, 1, 3]]).all()
        assert np.isfinite(answer[2]).all()


SOLIDS = ["cone_on_side", "fin0", "ktoolcav", "naca0012", "sphere_cutout", "torus_default_resolution", "sh1"]


@pytest.mark.corpus
@pytest.mark.parametrize("name", SOLIDS)
def test_real_meshes_against_trimesh(corpus: Path, name: str) -> None:
    mesh = read_mesh(corpus / "mesh" / f"{name}.stl")
    assert mesh.closed
    other = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    assert other.is_watertight
    assert mesh.volume == pytest.approx(other.volume, rel=1e-9)
    assert mesh.area == pytest.approx(other.area, rel=1e-9)
    field = MeshField.of(mesh)
    points = around(mesh, 120, 12)
    distance = field.distance(points)
    np.testing.assert_allclose(np.abs(distance), brute_distance(mesh, points), rtol=1e-9, atol=64 * rounding(field))
    clear = np.abs(distance) > 1e-9 * field.tree.size
    turns = np.rint(winding(mesh, points[clear]))
    np.testing.assert_array_equal(distance[clear] < 0.0, turns == 1)


@pytest.mark.corpus
def test_a_real_sheet_is_open(corpus: Path) -> None:
    mesh = read_mesh(corpus / "mesh" / "carpet2.stl")
    other = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    outline = trimesh.grouping.group_rows(other.edges_sorted, require_count=1)
    assert len(mesh.open_edges) == len(outline) == 252
    field = MeshField.of(mesh)
    points = around(mesh, 60, 13)
    np.testing.assert_allclose(
        field.distance(points), brute_distance(mesh, points), rtol=1e-9, atol=64 * rounding(field)
    )
