"""The lattice and triangle meshes, in and out."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.formats.mesh import TRIANGLE_FORMATS, read_mesh, read_triangles, write_lattice, write_triangles
from cadsculpt.record import LatticeFrame


def block(name: str, x: float, active: list[bool]) -> LatticeFrame:
    """Cubes in a row along x; strain and plastic set tell the nodes apart."""
    count = len(active)
    nodes = np.array([[x + i, j, k] for i in range(count + 1) for j in (0.0, 1.0) for k in (0.0, 1.0)])
    cube = np.array([0, 4, 6, 2, 1, 5, 7, 3])
    hexahedra = np.array([cube + 4 * i for i in range(count)])
    n = len(nodes)
    return LatticeFrame(
        name, nodes, hexahedra, np.arange(n) / 100.0, np.arange(n) / 1e4, np.arange(count), np.array(active)
    )


def test_the_lattice_in_vtk(tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    write_lattice(
        tmp_path / "lattice.vtu", [block("top", 0.0, [True, True, False]), block("side", 10.0, [False, True])]
    )
    grid = pyvista.read(tmp_path / "lattice.vtu")
    assert grid.n_cells == 3
    assert grid.n_points == 12 + 8  # nodes that only idle cells have are left out
    assert grid.cell_data["material"].tolist() == [0, 1, 1]
    assert grid.cell_data["lattice"].tolist() == [0, 0, 1]
    assert grid.compute_cell_sizes().cell_data["Volume"] == pytest.approx([1.0, 1.0, 1.0])  # positive: VTK's own order
    assert np.array_equal(grid.point_data["strain"][:12], np.arange(12) / 100.0)
    assert np.array_equal(grid.point_data["plastic"][12:], np.arange(4, 12) / 1e4)


def test_the_lattice_is_byte_stable_and_may_be_empty(tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    for name in ("a.vtu", "b.vtu"):
        write_lattice(tmp_path / name, [block("top", 0.0, [True, False])])
    assert (tmp_path / "a.vtu").read_bytes() == (tmp_path / "b.vtu").read_bytes()
    write_lattice(tmp_path / "none.vtu", [])
    assert pyvista.read(tmp_path / "none.vtu").n_cells == 0


@pytest.mark.parametrize("suffix", sorted(TRIANGLE_FORMATS))
def test_triangles_come_back(tmp_path: Path, suffix: str) -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    write_triangles(tmp_path / f"tetra{suffix}", points, triangles)
    back_points, back = read_triangles(tmp_path / f"tetra{suffix}")
    assert np.array_equal(back_points[back], points[triangles])
    assert back.dtype == np.int64
    assert os.listdir(tmp_path) == [f"tetra{suffix}"]


def test_quadrilaterals_are_split(tmp_path: Path) -> None:
    (tmp_path / "q.obj").write_text("v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nf 1 2 3 4\n")
    points, triangles = read_triangles(tmp_path / "q.obj")
    p = points[triangles]
    assert np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum() / 2.0 == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.stl", b"", "no faces"),
        ("a.stl", b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0", "no faces"),
        ("a.stl", b"\0" * 80 + b"\x03\0\0\0" + b"\0" * 20, "no faces"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n", "no mesh can be read from this PLY"),
        ("a.obj", b"v 0 0 0\n", "no faces"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "not a finite number"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n", "no mesh can be read from this OBJ"),
        (
            "a.stl",
            b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n",
            "no faces",
        ),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n", "no mesh can be read from this OFF"),
        ("a.off", b"OFF\n# lost\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "3 of 3 vertices and 1 of 2 faces"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
            b"element face 2\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
            "1 of 2 faces",
        ),
        ("a.xyz", b"", "use .stl"),
    ],
)
def test_meshes_that_are_none(tmp_path: Path, name: str, content: bytes, said: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=said):
        read_triangles(tmp_path / name)


@pytest.mark.parametrize("suffix", sorted(TRIANGLE_FORMATS))
def test_a_mesh_cut_anywhere_is_one_line_or_open(tmp_path: Path, suffix: str) -> None:
    """A reader may take what there is of a text without counts: then the mesh is open."""
    points = np.array([[0.5, 0.0, 0.0], [1.0, 0.0, 0.25], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    write_triangles(tmp_path / f"whole{suffix}", points, triangles)
    whole = (tmp_path / f"whole{suffix}").read_bytes()
    assert read_mesh(tmp_path / f"whole{suffix}").closed
    cut = tmp_path / f"cut{suffix}"
    for length in range(0, len(whole) - 8, 7):
        cut.write_bytes(whole[:length])
        try:
            assert not read_mesh(cut).closed
        except InputError as error:
            assert str(cut) in str(error)
            assert "\n" not in str(error)


def test_a_mesh_comes_in_other_units_and_says_where_it_is_open_in_its_own(tmp_path: Path) -> None:
    points = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    write_triangles(tmp_path / "a.stl", points, triangles)
    assert read_mesh(tmp_path / "a.stl", 25.4).volume == pytest.approx(25.4**3)
    write_triangles(tmp_path / "b.ply", points, triangles[:3])
    fault = read_mesh(tmp_path / "b.ply", 25.4).fault
    assert "3 open edges, the first (3, 0, 0) to (0, 2, 0)" in fault


def test_a_missing_mesh(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        read_triangles(tmp_path / "none.stl")


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="make the folder first"):
        write_lattice(tmp_path / "missing" / "lattice.vtu", [block("top", 0.0, [True])])
    with pytest.raises(InputError, match="no mesh format"):
        write_triangles(tmp_path / "a.docx", np.eye(3), np.array([[0, 1, 2]]))
