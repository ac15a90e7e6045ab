"""Single meshes in and out: the lattice as .vtu, triangle meshes as STL, OBJ, PLY and OFF.

meshio writes them and trimesh reads them (meshio's STL reader never ends on a truncated file); vertices are never
merged or reordered. Importing this module loads neither.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..collide.mesh.triangle_mesh import TriangleMesh
from ..errors import GeometryError, InputError
from ..record import LatticeFrame
from .atomic import whole_path

Array = NDArray[np.float64]
Index = NDArray[np.int64]

TRIANGLE_FORMATS = {".stl": "stl", ".obj": "obj", ".ply": "ply", ".off": "off"}
"""Suffixes and the libraries' names for them."""


def write_lattice(path: str | os.PathLike[str], lattices: Sequence[LatticeFrame]) -> None:
    """Write lattices.vtu: point data strain and plastic, cell data material and lattice (which of them).

    Only active hexahedra are written, and the nodes that they use. Raises InputError when the system refuses.
    """
    import meshio

    nodes, cells, strain, plastic, material, which = [], [], [], [], [], []
    first = 0
    for number, lattice in enumerate(lattices):
        active = lattice.hexahedra[lattice.active]
        used, corners = np.unique(active, return_inverse=True)
        cells.append(corners.reshape(-1, 8) + first)
        nodes.append(lattice.nodes[used])
        strain.append(lattice.strain[used])
        plastic.append(lattice.plastic[used])
        material.append(lattice.material[lattice.active])
        which.append(np.full(len(active), number))
        first += len(used)
    mesh = meshio.Mesh(
        np.concatenate(nodes) if nodes else np.zeros((0, 3)),
        [("hexahedron", np.concatenate(cells).astype(np.int64) if cells else np.zeros((0, 8), np.int64))],
        point_data={"strain": _flat(strain, np.float64), "plastic": _flat(plastic, np.float64)},
        cell_data={"material": [_flat(material, np.int64)], "lattice": [_flat(which, np.int64)]},
    )
    with whole_path(path) as temporary:
        meshio.write(temporary, mesh, file_format="vtu")


def write_triangles(path: str | os.PathLike[str], points: Array, triangles: Index) -> None:
    """Write a triangle mesh; the suffix chooses the format. points (k, 3), triangles (f, 3).

    Raises InputError for a suffix that is none of TRIANGLE_FORMATS, and when the system refuses.
    """
    import meshio

    path = Path(path)
    name = _format_of(path)
    mesh = meshio.Mesh(np.asarray(points, np.float64), [("triangle", np.asarray(triangles, np.int64))])
    options: dict[str, Any] = {"binary": True} if name in ("stl", "ply") else {}
    with whole_path(path) as temporary:
        meshio.write(temporary, mesh, file_format=name, **options)


def read_triangles(path: str | os.PathLike[str]) -> tuple[Array, Index]:
    """Points (k, 3) and triangles (f, 3) of a mesh file; polygons are split, and nothing is merged, not even in an STL.

    Raises InputError when the file cannot be read, holds no faces, or holds a coordinate that is not a finite number.
    """
    import trimesh

    path = Path(path)
    name = _format_of(path)
    try:
        with open(path, "rb") as file:
            mesh = trimesh.load_mesh(file, file_type=name, process=False)
            points = np.array(mesh.vertices, np.float64).reshape(-1, 3)
            triangles = np.array(mesh.faces, np.int64).reshape(-1, 3)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", where=str(path)) from error
    except Exception as error:  # trimesh's readers raise whatever the text made them raise
        what = f"no mesh can be read from this {name.upper()} file"
        raise InputError(what, where=str(path), mend="export it again") from error
    if not len(triangles):
        raise InputError("the mesh has no faces", where=str(path), mend="export the mesh again")
    promised = _promised(path, name)
    if len(points) < promised[0] or len(triangles) < promised[1]:
        held = f"{len(points)} of {promised[0]} vertices and {len(triangles)} of {promised[1]} faces"
        raise InputError(f"the file ends early: it holds {held}", where=str(path), mend="export the mesh again")
    if not np.isfinite(points).all():
        raise InputError("a vertex is not a finite number", where=str(path), mend="export the mesh again")
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise InputError("a face names a vertex that is not there", where=str(path), mend="export the mesh again")
    return points, triangles


def read_mesh(path: str | os.PathLike[str], scale: float = 1.0) -> TriangleMesh:
    """The mesh of a file, its numbers times `scale`, joined and checked.

    Raises InputError when the file cannot be read, GeometryError when what it holds is no surface.
    """
    points, triangles = read_triangles(path)
    try:
        return TriangleMesh.of(points, triangles, scale=scale)
    except GeometryError as error:
        raise GeometryError(error.what, where=str(path), mend=error.mend) from None


def _promised(path: Path, name: str) -> tuple[int, int]:
    """How many vertices and faces the head of a PLY or OFF file promises: their readers take what there is."""
    with open(path, "rb") as file:
        head = file.read(65536).decode("latin-1")
    if name == "ply":
        counts = [re.search(rf"^element {what} (\d+)", head, re.MULTILINE) for what in ("vertex", "face")]
        return int(counts[0].group(1)) if counts[0] else 0, int(counts[1].group(1)) if counts[1] else 0
    if name == "off":
        numbers = re.match(r"\s*OFF\s+(?:#.*\s+)*(\d+)\s+(\d+)", head)
        return (int(numbers.group(1)), int(numbers.group(2))) if numbers else (0, 0)
    return 0, 0


def _format_of(path: Path) -> str:
    name = TRIANGLE_FORMATS.get(path.suffix.lower())
    if name is None:
        raise InputError(
            f"no mesh format is known by the suffix {path.suffix!r}",
            where=str(path),
            mend=f"use {', '.join(TRIANGLE_FORMATS)}",
        )
    return name


def _flat(parts: list[NDArray[Any]], dtype: type[np.generic]) -> NDArray[Any]:
    return np.concatenate(parts).astype(dtype) if parts else np.zeros(0, dtype)
