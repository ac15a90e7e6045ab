"""Frames as polygon meshes: areas, outlines and interpolation against closed formulas."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cadsculpt.formats.frame_mesh import (
    FrameMesh,
    FrameMesher,
    borders,
    evenly,
    normal_displacement,
    triangles_of,
)
from cadsculpt.record import Frame, PatchFrame, ToolFrame

TURN = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)


def flat_patch(rows: int, columns: int, inside: Any = None, **fields: Any) -> PatchFrame:
    """The unit square, its vertices in order of rows (x) and columns (y)."""
    x, y = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, columns), indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=2)
    none = np.zeros((rows, columns))
    given = {"displacement": np.zeros_like(points), "pressure": none, "contact": none > 0.0, "stress": none}
    return PatchFrame("square", points, inside=inside, **{**given, **fields})


def mesh_of(patch: PatchFrame, outlines: Any = None, tools: tuple[ToolFrame, ...] = ()) -> FrameMesh:
    return FrameMesher(outlines).mesh(Frame(3, 0.5, (patch,), tools))


def area(mesh: FrameMesh) -> float:
    corners, _ = triangles_of(mesh)
    p = mesh.points[corners]
    return float(0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum())


def disc(rows: int, columns: int, radius: float) -> tuple[Any, dict[str, list[Any]]]:
    """Vertices inside a disc in the middle of the square, and its outline in grid coordinates."""
    x, y = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, columns), indexing="ij")
    loop = np.stack([0.5 + radius * np.cos(TURN), 0.5 + radius * np.sin(TURN)], axis=1)
    return np.hypot(x - 0.5, y - 0.5) <= radius, {"square": [loop * [rows - 1, columns - 1]]}


def test_a_whole_patch_is_all_quadrilaterals() -> None:
    mesh = mesh_of(flat_patch(5, 4))
    assert len(mesh.points) == 20
    assert np.array_equal(np.diff(mesh.offsets), np.full(12, 4))
    assert area(mesh) == pytest.approx(1.0, abs=1e-14)


def test_polygons_turn_as_the_parameters_do() -> None:
    inside, outlines = disc(21, 17, 0.37)
    mesh = mesh_of(flat_patch(21, 17, inside), outlines)
    corners, _ = triangles_of(mesh)
    p = mesh.points[corners]
    assert (np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])[:, 2] >= 0.0).all()  # S_u x S_v is +z here


@pytest.mark.parametrize("hole", [False, True])
def test_an_outline_is_followed(hole: bool) -> None:
    rows, columns, radius = 41, 33, 0.313
    inside, outlines = disc(rows, columns, radius)
    mesh = mesh_of(flat_patch(rows, columns, inside ^ hole), outlines)
    circle = np.pi * radius**2
    assert area(mesh) == pytest.approx(
        1.0 - circle if hole else circle, rel=0, abs=2e-3 * circle
    )  # a polygon of chords
    # the border of the disc is one closed line on the circle
    edges = borders(triangles_of(mesh)[0])
    if not hole:
        assert (np.bincount(edges.reshape(-1))[np.unique(edges)] == 2).all()
        distance = np.hypot(*(mesh.points[np.unique(edges)][:, :2] - 0.5).T)
        assert distance == pytest.approx(np.full(len(distance), radius), abs=1e-5)


def test_the_outlined_area_converges_with_the_square_of_the_spacing() -> None:
    errors = []
    for n in (17, 33, 65, 129):
        inside, outlines = disc(n, n, 0.3127)
        errors.append(abs(area(mesh_of(flat_patch(n, n, inside), outlines)) - np.pi * 0.3127**2))
    assert errors[-1] < errors[0] / 32.0


def test_without_an_outline_only_vertices_of_the_face_are_drawn() -> None:
    inside, _ = disc(41, 33, 0.31)
    mesh = mesh_of(flat_patch(41, 33, inside))
    assert (np.hypot(*(mesh.points[:, :2] - 0.5).T) <= 0.31 + 1e-12).all()
    assert set(np.diff(mesh.offsets)) == {3, 4}
    assert 0.9 * np.pi * 0.31**2 < area(mesh) < np.pi * 0.31**2


@given(seed=st.integers(0, 10_000), cut=st.booleans())
def test_any_mask_gives_a_sound_mesh(seed: int, cut: bool) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(2, 8, 2)
    patch = flat_patch(int(rows), int(columns), rng.random((rows, columns)) < rng.random())
    mesh = mesh_of(patch, {"square": []} if cut else None)
    assert mesh.offsets[-1] == len(mesh.connectivity)
    assert np.array_equal(np.unique(mesh.connectivity), np.arange(len(mesh.points)))  # every point is used, none lacks
    corners, body = triangles_of(mesh)
    assert len(corners) == (np.diff(mesh.offsets) - 2).sum() == len(body)
    assert area(mesh) <= 1.0 + 1e-12


def test_fields_that_are_linear_stay_linear_at_the_cuts() -> None:
    rows, columns = 19, 23
    inside, outlines = disc(rows, columns, 0.4)
    x, y = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, columns), indexing="ij")
    patch = flat_patch(rows, columns, inside, pressure=2.0 * x - y, stress=3.0 * y)
    mesh = mesh_of(patch, outlines)
    assert mesh.pressure == pytest.approx(2.0 * mesh.points[:, 0] - mesh.points[:, 1], abs=1e-12)
    assert mesh.stress == pytest.approx(3.0 * mesh.points[:, 1], abs=1e-12)


def test_vertices_off_the_face_may_hold_anything() -> None:
    inside, _ = disc(31, 31, 0.3)
    pressure = np.where(inside, 1.0, np.nan)
    assert np.isfinite(mesh_of(flat_patch(31, 31, inside, pressure=pressure)).pressure).all()


def test_patches_and_tools_stand_side_by_side() -> None:
    tool = ToolFrame("ball", np.eye(3) + 2.0, np.array([[0, 1, 2]]))
    mesh = mesh_of(flat_patch(3, 3, pressure=np.ones((3, 3))), tools=(tool, tool))
    assert mesh.bodies == ("square", "ball", "ball")
    assert mesh.tool.tolist() == [False, True, True]
    assert np.bincount(mesh.body).tolist() == [9, 3, 3]
    assert np.bincount(mesh.cell_body).tolist() == [4, 1, 1]
    assert mesh.pressure[mesh.body > 0].max() == 0.0
    assert np.array_equal(mesh.points[mesh.body == 2], tool.points)
    assert (mesh.step, mesh.time) == (3, 0.5)


def test_an_empty_frame() -> None:
    mesh = FrameMesher().mesh(Frame(0, 0.0, (), ()))
    assert len(mesh.points) == 0
    assert mesh.offsets.tolist() == [0]
    assert len(triangles_of(mesh)[0]) == 0
    assert len(normal_displacement(mesh)) == 0


def test_displacement_along_the_normal() -> None:
    move = np.zeros((6, 7, 3))
    move[..., 0] = 5.0  # sliding along the plane does not count
    move[..., 2] = np.arange(42).reshape(6, 7) - 20.0
    patch = flat_patch(6, 7)
    moved = PatchFrame("square", patch.points + move, move, patch.pressure, patch.contact, patch.stress)
    assert normal_displacement(mesh_of(moved)) == pytest.approx(np.arange(42) - 20.0, abs=1e-12)


def test_the_connectivity_follows_the_mask(pressed_panel: Callable[..., Any]) -> None:
    mesher = FrameMesher()
    whole = mesher.mesh(Frame(0, 0.0, (flat_patch(9, 9),), ()))
    part = mesher.mesh(Frame(1, 0.1, (flat_patch(9, 9, disc(9, 9, 0.4)[0]),), ()))
    again = mesher.mesh(Frame(2, 0.2, (flat_patch(9, 9),), ()))
    assert len(part.points) < len(whole.points) == len(again.points)


def test_evenly() -> None:
    assert evenly(0, 5) == []
    assert evenly(3, 5) == [0, 1, 2]
    assert evenly(101, 5) == [0, 25, 50, 75, 100]
