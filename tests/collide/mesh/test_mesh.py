"""What is wrong with a mesh is said or mended, and what it encloses is known in closed form."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from cadsculpt.collide.mesh.triangle_mesh import TriangleMesh
from cadsculpt.errors import GeometryError

TETRA = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
OUTWARD = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def cube(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (8, 3) and triangles (12, 3), turned outwards."""
    vertices = np.array(list(product((low, high), repeat=3)))
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return vertices, np.array([[q[a], q[b], q[c]] for q in quads for a, b, c in ((0, 1, 2), (0, 2, 3))])


def together(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0] + [len(v) for v, _ in parts[:-1]])
    return np.concatenate([v for v, _ in parts]), np.concatenate(
        [t + s for (_, t), s in zip(parts, starts, strict=True)]
    )


def soup(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every corner anew, as an STL has it."""
    return vertices[triangles].reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)


def warnings_of(mesh: TriangleMesh, *said: str) -> None:
    assert len(mesh.warnings) == len(said), mesh.warnings
    for line, words in zip(mesh.warnings, said, strict=True):
        assert words in line


@pytest.mark.parametrize("scale", [1.0, 25.4, 1e-6])
def test_a_soup_of_corners_is_joined(scale):
    mesh = TriangleMesh.of(*soup(*cube(-1.0, 2.0)), scale=scale)
    assert (len(mesh.vertices), len(mesh.triangles), mesh.shells) == (8, 12, 1)
    assert mesh.closed
    assert mesh.warnings == ()
    assert mesh.volume == pytest.approx(27.0 * scale**3, rel=1e-14)
    assert mesh.area == pytest.approx(54.0 * scale**2, rel=1e-14)
    assert len(mesh.edges) == 12
    assert mesh.edges.max() == 17  # Euler: 18 edges


def test_only_equal_vertices_are_joined():
    vertices, triangles = soup(*cube(0.0, 1.0))
    vertices[0] += 1e-15
    mesh = TriangleMesh.of(vertices, triangles)
    assert not mesh.closed
    with pytest.raises(GeometryError, match=r"not watertight: it has \d+ open edges, the first \("):
        mesh.require_closed()


def test_minus_zero_is_zero():
    vertices, triangles = soup(*cube(0.0, 1.0))
    vertices[vertices == 0.0] *= np.where(np.arange((vertices == 0.0).sum()) % 2, 1.0, -1.0)
    assert TriangleMesh.of(vertices, triangles).closed


def test_an_open_mesh_says_how_many_edges_and_where_in_the_files_numbers():
    vertices, triangles = cube(0.0, 2.0)
    mesh = TriangleMesh.of(vertices, triangles[1:], scale=10.0)
    assert len(mesh.open_edges) == 3
    assert np.isnan(mesh.volume)
    ends = [" to ".join("(" + ", ".join(f"{x:g}" for x in vertices[v]) + ")" for v in pair) for pair in
            ((0, 1), (1, 3), (0, 3))]  # fmt: skip
    with pytest.raises(GeometryError, match="3 open edges") as error:
        mesh.require_closed()
    assert any(end in str(error.value) for end in ends)
    assert "\n" not in str(error.value)


def test_an_inside_out_mesh_is_turned():
    vertices, triangles = cube(0.0, 2.0)
    mesh = TriangleMesh.of(vertices, triangles[:, ::-1])
    assert mesh.volume == pytest.approx(8.0)
    warnings_of(mesh, "inside out")


def test_triangles_that_lie_the_wrong_way_round_are_turned_over():
    vertices, triangles = cube(0.0, 2.0)
    rng = np.random.default_rng(2)
    for count in (1, 3, 6):
        wrong = triangles.copy()
        which = rng.choice(12, count, replace=False)
        wrong[which] = wrong[which][:, ::-1]
        mesh = TriangleMesh.of(vertices, wrong)
        assert mesh.volume == pytest.approx(8.0)
        assert f"{count} triangle" in mesh.warnings[0]
        assert sorted(map(sorted, mesh.triangles.tolist())) == sorted(map(sorted, triangles.tolist()))


def test_a_shell_in_a_shell_is_a_cavity_whichever_way_it_is_turned():
    outer, inner, core = cube(-3.0, 3.0), cube(-2.0, 2.0), cube(-1.0, 1.0)
    for turns in product((1, -1), repeat=3):
        parts = [(v, t[:, ::turn]) for (v, t), turn in zip((inner, outer, core), turns, strict=True)]
        mesh = TriangleMesh.of(*together(*parts))
        assert mesh.shells == 3
        assert mesh.volume == pytest.approx(216.0 - 64.0 + 8.0)
    apart = together(cube(0.0, 1.0), (cube(2.0, 3.0)[0], cube(2.0, 3.0)[1][:, ::-1]))
    mesh = TriangleMesh.of(*apart)
    assert mesh.volume == pytest.approx(2.0)
    warnings_of(mesh, "1 of 2 shells turned")


def test_two_cubes_on_one_edge_are_a_solid():
    vertices, triangles = cube(0.0, 1.0)
    mesh = TriangleMesh.of(*together((vertices, triangles), (vertices + [1.0, 1.0, 0.0], triangles)))
    assert mesh.closed
    assert len(mesh.branched_edges) == 1
    warnings_of(mesh, "1 edge has more than two triangles")
    assert mesh.volume == pytest.approx(2.0)


def test_a_wall_inside_is_no_solid():
    """Two cubes with a common face that both have: four triangles an edge are fine, three (the wall once) are not."""
    vertices, triangles = cube(0.0, 1.0)
    joined = together((vertices, triangles), (vertices + [1.0, 0.0, 0.0], triangles))
    corners = joined[0][joined[1]]
    wall = (corners[:, :, 0] == 1.0).all(axis=1)
    keep = ~wall
    assert TriangleMesh.of(joined[0], joined[1][keep]).volume == pytest.approx(2.0)
    keep[np.flatnonzero(wall)[:2]] = True
    mesh = TriangleMesh.of(joined[0], joined[1][keep])
    assert not mesh.closed
    with pytest.raises(GeometryError, match="more than two triangles meet at 4 edges, the first"):
        mesh.require_closed()


def test_a_moebius_strip_has_one_side():
    n = 9
    angle = 2 * np.pi * np.arange(n) / n
    across = np.stack([np.cos(angle / 2) * np.cos(angle), np.cos(angle / 2) * np.sin(angle), np.sin(angle / 2)], axis=1)
    middle = 3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vertices = np.concatenate([middle - across, middle + across])
    a, b = np.arange(n), np.arange(n) + n
    a2, b2 = np.append(a[1:], b[0]), np.append(b[1:], a[0])
    triangles = np.concatenate([np.stack([a, b, b2], axis=1), np.stack([a, b2, a2], axis=1)])
    with pytest.raises(GeometryError, match="one side only"):
        TriangleMesh.of(vertices, triangles)


def test_a_sheet_back_to_back_encloses_nothing():
    mesh = TriangleMesh.of(TETRA, [[0, 1, 2], [0, 2, 1]])
    with pytest.raises(GeometryError, match="encloses no volume"):
        mesh.require_closed()


def test_repeated_triangles_are_left_out():
    vertices, triangles = cube(0.0, 2.0)
    mesh = TriangleMesh.of(vertices, np.concatenate([triangles, np.roll(triangles, 1, axis=1)]))
    assert mesh.closed
    warnings_of(mesh, "12 triangles that stand there twice")


def test_triangles_with_two_equal_corners_are_left_out():
    vertices, triangles = soup(*cube(0.0, 2.0))
    extra = np.array([[0.0, 0, 0], [2, 0, 0], [2, 0, 0]])
    mesh = TriangleMesh.of(np.concatenate([vertices, extra]), np.concatenate([triangles, [[36, 37, 38]]]))
    assert mesh.closed
    warnings_of(mesh, "1 triangle with two equal corners")


def with_caps(count: int) -> tuple[np.ndarray, np.ndarray]:
    """A tetrahedron; along its edge from 1 to 2 lie `count` vertices, and the triangles between are flat."""
    inner = TETRA[1] + (TETRA[2] - TETRA[1]) * (np.arange(1, count + 1) / (count + 1))[:, None]
    chain = [1, *range(4, 4 + count), 2]
    fan = [[1, b, a] for a, b in zip(chain[1:-1], chain[2:], strict=True)]  # flat, from one end to the next two
    side = [[3, a, b] for a, b in zip(chain[:-1], chain[1:], strict=True)]
    return np.concatenate([TETRA, inner]), np.array([*OUTWARD[:3].tolist(), *fan, *side])


@pytest.mark.parametrize("count", [1, 3, 7])
@pytest.mark.parametrize("scale", [1.0, 25.4])
def test_triangles_without_area_are_mended(count, scale):
    vertices, triangles = with_caps(count)
    mesh = TriangleMesh.of(vertices, triangles, scale=scale)
    assert mesh.closed
    assert mesh.volume == pytest.approx(scale**3 / 6.0)
    p = mesh.vertices[mesh.triangles]
    assert (np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) > 1e-3 * scale**2).all()
    warnings_of(mesh, f"{count} triangle")
    assert len(mesh.triangles) == len(triangles)


def with_many_caps(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """A cube; edges of some triangles are cut, and a flat triangle fills the gap to what has the whole edge. Flat ones are
    cut again, corners come to lie on others, edges get more than two triangles."""
    vertices, triangles = cube(-1.0, 1.0)
    points, faces = list(vertices), [tuple(t) for t in triangles.tolist()]
    for _ in range(count):
        i = int(rng.integers(len(faces)))
        a, b, c = faces[i]
        points.append(points[a] + rng.choice([0.25, 0.5, 0.75]) * (points[b] - points[a]))
        m = len(points) - 1
        faces[i] = (a, m, c)
        faces += [(m, b, c), (a, b, m)]
    return np.array(points), np.array(faces)


def test_what_is_closed_stays_closed_when_flat_triangles_are_mended():
    mended = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        vertices, triangles = with_many_caps(rng, int(rng.integers(1, 30)))
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        try:
            mesh = TriangleMesh.of(vertices @ turn.T, triangles, scale=25.4)
        except GeometryError as error:
            assert "cannot be mended" in str(error)
            continue
        mended += 1
        assert mesh.closed
        assert mesh.volume == pytest.approx(8.0 * 25.4**3)
        assert mesh.area == pytest.approx(24.0 * 25.4**2)
    assert mended >= 40


def test_any_heap_of_triangles_is_a_mesh_or_one_line():
    for seed in range(400):
        rng = np.random.default_rng(seed)
        count = rng.integers(1, 9)
        vertices = rng.integers(0, rng.integers(2, 4), (count, 3)).astype(float)
        try:
            mesh = TriangleMesh.of(vertices, rng.integers(0, count, (rng.integers(1, 14), 3)))
        except GeometryError as error:
            assert "\n" not in str(error)
            continue
        p = mesh.vertices[mesh.triangles]
        assert (np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) > 1e-6).all()
        assert mesh.closed == (mesh.fault == "")
        assert not mesh.closed or mesh.volume > 0.0


def test_a_flat_triangle_on_a_border_is_left_out():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0]])
    mesh = TriangleMesh.of(vertices, [[0, 1, 3], [1, 2, 3], [0, 2, 1]])
    assert len(mesh.triangles) == 2
    assert len(mesh.open_edges) == 4
    warnings_of(mesh, "1 triangle without area")


@pytest.mark.parametrize(
    ("vertices", "triangles", "said"),
    [
        (TETRA, np.zeros((0, 3), int), "no triangles"),
        (np.zeros((0, 3)), np.zeros((0, 3), int), "no triangles"),
        (np.where(np.arange(12).reshape(4, 3) == 4, np.nan, TETRA), OUTWARD, "1 vertex is not finite, the first is number 1"),
        (np.where(np.arange(12).reshape(4, 3) > 4, np.inf, TETRA), OUTWARD, "3 vertices are not finite"),
        (TETRA, [[0, 1, 4]], "a vertex that is not there"),
        (TETRA, [[0, 1, -1]], "a vertex that is not there"),
        (TETRA[:, :2], OUTWARD, "arrays"),
        (TETRA, [[0, 1, 1]], "all its triangles are without area"),
        (TETRA * 1e120, OUTWARD, "farther away"),
        (TETRA * 1e-120, OUTWARD, "no size"),
    ],
)  # fmt: skip
def test_what_is_no_mesh(vertices, triangles, said):
    with pytest.raises(GeometryError, match=said) as error:
        TriangleMesh.of(vertices, triangles)
    assert "\n" not in str(error.value)


def test_the_order_of_vertices_and_triangles_does_not_matter():
    vertices, triangles = together(cube(0.0, 1.0), cube(3.0, 4.0))
    rng = np.random.default_rng(7)
    for _ in range(5):
        place = rng.permutation(len(vertices))
        moved = np.empty_like(vertices)
        moved[place] = vertices
        mesh = TriangleMesh.of(moved, place[triangles][rng.permutation(len(triangles))])
        assert (mesh.shells, mesh.closed, mesh.warnings) == (2, True, ())
        assert mesh.volume == pytest.approx(2.0)
