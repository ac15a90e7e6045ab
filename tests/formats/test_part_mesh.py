"""Parts as triangles: closed solids stay closed, areas and volumes are the part's, all formats read back."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cadsculpt.errors import InputError
from cadsculpt.formats import registry
from cadsculpt.formats.mesh import read_triangles
from cadsculpt.formats.part import Part
from cadsculpt.formats.part_mesh import mesh_of_part, write_part
from cadsculpt.formats.patch_part import PatchPart
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

FLAT = np.array([0.0, 0, 1, 1])


def mesh_of(part: Part, tolerance: float | None = None) -> trimesh.Trimesh:
    return trimesh.Trimesh(*mesh_of_part(part, tolerance), process=False)


def square(corner: list[float], u: list[float], v: list[float], name: str) -> BSplineSurface:
    o, a, b = (np.array(x, dtype=float) for x in (corner, u, v))
    return BSplineSurface(np.array([[o, o + b], [o + a, o + a + b]]), FLAT, FLAT, 1, 1, name=name)


def box() -> list[BSplineSurface]:
    """The unit cube as six squares that know nothing of each other, normals out."""
    x, y, z = ([1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0])
    o = [0.0, 0, 0]
    return [
        square(o, y, x, "bottom"), square(z, x, y, "top"), square(o, x, z, "front"),
        square(y, z, x, "back"), square(o, z, y, "left"), square(x, y, z, "right"),
    ]  # fmt: skip


def test_loose_patches_become_one_closed_mesh(tmp_path: Path) -> None:
    part = PatchPart(tmp_path / "box.json", "json", "in", box())
    mesh = mesh_of(part)
    assert mesh.is_watertight
    assert len(mesh.vertices) == 8
    assert mesh.volume == pytest.approx(25.4**3, rel=1e-12)  # mm, normals out
    for suffix in (".stl", ".obj", ".ply"):
        part.warnings.clear()
        write_part(part, tmp_path / f"box{suffix}")
        assert part.warnings == [f"{suffix[1:].upper()} has no length unit: the numbers are in in"]
        points, triangles = read_triangles(tmp_path / f"box{suffix}")
        assert len(triangles) == 12
        np.testing.assert_allclose([points.min(), points.max()], [0.0, 1.0], atol=1e-7)


def test_a_trimmed_patch_keeps_its_hole(tmp_path: Path) -> None:
    """An edge of the hole is a border, not a tear; the area is that of a square less a circle, from within."""
    corners = [(1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0)]
    hole = TrimCurve(
        0.5 + 0.25 * np.array(corners, dtype=float), np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4.0]), 2,
        np.array([1, math.sqrt(0.5)] * 4 + [1]),
    )  # fmt: skip
    rim = TrimCurve(np.array([(0.0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]), np.array([0.0, 0, 1, 2, 3, 4, 4]), 1)
    flat = square([0, 0, 0], [10, 0, 0], [0, 10, 0], "plate")
    trimmed = BSplineSurface(
        flat.control_points, FLAT, FLAT, 1, 1, name="plate", trims=(TrimLoop((rim,)), TrimLoop((hole,), False))
    )
    part = PatchPart(tmp_path / "plate.json", "json", "mm", [trimmed])
    mesh = mesh_of(part, 1e-3)
    assert part.warnings == []
    assert mesh.area == pytest.approx(100 - 6.25 * math.pi, abs=2 * math.pi * 2.5 * 1e-3)
    assert mesh.area > 100 - 6.25 * math.pi


@pytest.mark.corpus
@pytest.mark.parametrize(
    ("name", "volume"),
    [
        ("step/cube-mm.step", 1e9),
        ("step/cube-m.step", 1e9),
        ("step/bug30149_comb_bug.step", 24000.0),
        ("iges/OCC8842_cylinder_Ideas.igs", math.pi * 25**2 * 150),
        ("rhino/v4_Gear.3dm", None),
        ("step/sliced_cylinder.step", None),
    ],
)
def test_solids_are_watertight(corpus: Path, name: str, volume: float | None) -> None:
    """Formulas where there is one; areas from below, and nearer with a smaller tolerance."""
    part = registry.read(corpus / name)
    mesh = mesh_of(part)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    area = sum(face.area for face in part.faces)
    assert mesh.area == pytest.approx(area, rel=5e-3)
    assert mesh.volume > 0.0
    if volume is not None:
        assert mesh.volume == pytest.approx(volume, rel=5e-3)
    assert not any("torn" in warning or "meshed" in warning for warning in part.warnings)


@pytest.mark.corpus
def test_a_face_whose_triangles_are_wrong_is_said(corpus: Path) -> None:
    """The kernel's triangles cover more of this mug than its faces do, and the mesh is closed all the same."""
    part = registry.read(corpus / "rhino" / "v4_DinerMug.3dm")
    mesh = mesh_of(part)
    wrong = abs(mesh.area / sum(face.area for face in part.faces) - 1.0)
    assert any("another area" in warning for warning in part.warnings) == (wrong > 0.02)


def test_the_same_bytes_twice_and_nothing_for_nothing(tmp_path: Path) -> None:
    for name in ("a.stl", "b.stl"):
        write_part(PatchPart(tmp_path / "box.json", "json", "mm", box()), tmp_path / name)
    assert (tmp_path / "a.stl").read_bytes() == (tmp_path / "b.stl").read_bytes()
    with pytest.raises(InputError, match="no faces that can be meshed|no finite size"):
        mesh_of_part(PatchPart(tmp_path / "none.json", "json", "mm", []))
