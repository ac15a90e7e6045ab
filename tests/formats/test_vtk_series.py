"""The series as VTK itself reads it, and as our own reader does."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.formats.frame_mesh import FaceMesh, FrameMesh, FrameMesher
from cadsculpt.formats.vtk_series import (
    SeriesWriter,
    read_frame,
    read_part,
    read_series,
    write_frame,
    write_part,
)
from cadsculpt.record import Frame, ToolFrame

ARRAYS = (
    "points",
    "body",
    "displacement",
    "pressure",
    "contact",
    "stress",
    "connectivity",
    "offsets",
    "cell_body",
    "tool",
)


def same(a: FrameMesh, b: FrameMesh) -> bool:
    return (a.step, a.time, a.bodies) == (b.step, b.time, b.bodies) and all(
        np.array_equal(getattr(a, name), getattr(b, name)) and getattr(a, name).dtype == getattr(b, name).dtype
        for name in ARRAYS
    )


def folder_bytes(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


def test_vtk_reads_what_went_in(tmp_path: Path, pressed_panel: Callable[..., Any]) -> None:
    pyvista = pytest.importorskip("pyvista")
    panel = pressed_panel(31, 21, 4)
    with SeriesWriter(tmp_path, panel.outlines) as writer:
        meshes = [writer.add(frame) for frame in panel.frames]
    reader = pyvista.get_reader(str(tmp_path / "series.pvd"))
    assert reader.time_values == [frame.time for frame in panel.frames]
    for frame, mesh in zip(panel.frames, meshes, strict=True):
        reader.set_active_time_value(frame.time)
        (data,) = reader.read()
        assert np.array_equal(data.points, mesh.points)
        for name in ("displacement", "pressure", "stress", "contact"):
            assert np.array_equal(data.point_data[name], getattr(mesh, name)), name
        assert np.array_equal(data.cell_data["body"], mesh.cell_body)
        assert data.n_cells == len(mesh.offsets) - 1
        assert [list(data.get_cell(n).point_ids) for n in (0, data.n_cells - 1)] == [
            mesh.connectivity[mesh.offsets[n] : mesh.offsets[n + 1]].tolist() for n in (0, data.n_cells - 1)
        ]
        assert data.field_data["bodies"].tolist() == ["top", "thumb"]
        assert data.field_data["TimeValue"][0] == frame.time


def test_blocks_that_fill_exactly(tmp_path: Path) -> None:
    # 3 * 2^17 doubles are three whole blocks of 2^20 bytes: the partial block's size is zero then
    pyvista = pytest.importorskip("pyvista")
    count = 1 << 17
    points = np.random.default_rng(1).random((count, 3))
    triangles = np.arange(count - count % 3).reshape(-1, 3)
    mesh = FrameMesher().mesh(Frame(0, 0.0, (), (ToolFrame("cloud", points, triangles),)))
    write_frame(tmp_path / "f.vtp", mesh)
    assert np.array_equal(pyvista.read(tmp_path / "f.vtp").points, points)
    assert same(read_frame(tmp_path / "f.vtp"), mesh)


def test_our_reader_gives_back_every_bit(tmp_path: Path, pressed_panel: Callable[..., Any]) -> None:
    panel = pressed_panel(23, 17, 5)
    with SeriesWriter(tmp_path, panel.outlines) as writer:
        meshes = [writer.add(frame) for frame in panel.frames]
        writer.add_part(panel.background)
    series = read_series(tmp_path / "series.pvd")
    assert [time for time, _ in series] == [frame.time for frame in panel.frames]
    assert all(same(read_frame(path), mesh) for (_, path), mesh in zip(series, meshes, strict=True))
    part = read_part(tmp_path / "frames" / "part.vtp")
    assert [face.name for face in part] == [face.name for face in panel.background]
    for face, before in zip(part, panel.background, strict=True):
        assert np.array_equal(face.points[face.triangles], before.points[before.triangles])
    assert set(writer.files) == set(folder_bytes(tmp_path))


def test_two_writes_give_the_same_bytes(tmp_path: Path, pressed_panel: Callable[..., Any]) -> None:
    panel = pressed_panel(23, 17, 4)
    for name in ("a", "b"):
        with SeriesWriter(tmp_path / name, panel.outlines) as writer:
            for frame in panel.frames:
                writer.add(frame)
            writer.add_part(panel.background)
    assert folder_bytes(tmp_path / "a") == folder_bytes(tmp_path / "b")


def test_names_of_any_kind(tmp_path: Path) -> None:
    names = ['a "quoted" <face> & more', "Fläche 3", "面"]
    frame = Frame(0, 0.0, (), tuple(ToolFrame(name, np.eye(3), np.array([[0, 1, 2]])) for name in names))
    write_frame(tmp_path / "f.vtp", FrameMesher().mesh(frame))
    assert read_frame(tmp_path / "f.vtp").bodies == tuple(names)
    pyvista = pytest.importorskip("pyvista")
    assert pyvista.read(tmp_path / "f.vtp").n_cells == 3


def test_an_empty_frame_and_an_empty_series(tmp_path: Path) -> None:
    with SeriesWriter(tmp_path) as writer:
        mesh = writer.add(Frame(0, 0.0, (), ()))
    assert same(read_frame(tmp_path / "frames" / "frame_000000.vtp"), mesh)
    with SeriesWriter(tmp_path / "none"):
        pass
    assert read_series(tmp_path / "none" / "series.pvd") == []
    write_part(tmp_path / "part.vtp", [])
    assert read_part(tmp_path / "part.vtp") == []


def test_the_files_are_plain_xml(tmp_path: Path, pressed_panel: Callable[..., Any]) -> None:
    with SeriesWriter(tmp_path) as writer:
        writer.add(pressed_panel(9, 7, 1).frames[0])
    for path in tmp_path.rglob("*.*"):
        assert ElementTree.parse(path).getroot().tag == "VTKFile"


def test_an_interrupted_series_lists_what_is_there(tmp_path: Path, pressed_panel: Callable[..., Any]) -> None:
    frames = pressed_panel(9, 7, 3).frames
    with pytest.raises(AttributeError), SeriesWriter(tmp_path) as writer:
        [writer.add(frame) for frame in (frames[0], None, frames[1])]
    assert [path.name for _, path in read_series(tmp_path / "series.pvd")] == ["frame_000000.vtp"]
    # and goes on where it stopped
    with SeriesWriter(tmp_path, written=writer.entries) as again:
        for frame in frames[1:]:
            again.add(frame)
    with SeriesWriter(tmp_path / "at once") as whole:
        for frame in frames:
            whole.add(frame)
    assert again.files == whole.files
    once = folder_bytes(tmp_path / "at once")
    assert {name: (tmp_path / name).read_bytes() for name in once} == once


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("a file")
    with pytest.raises(InputError, match="cannot be written"):
        SeriesWriter(tmp_path / "run")


@pytest.mark.parametrize("left", [0, 10, 300, 1500, -40, -3])
def test_damaged_frames_are_refused(tmp_path: Path, pressed_panel: Callable[..., Any], left: int) -> None:
    path = tmp_path / "f.vtp"
    write_frame(path, FrameMesher().mesh(pressed_panel(9, 7, 1).frames[0]))
    path.write_bytes(path.read_bytes()[:left])
    with pytest.raises(InputError) as caught:
        read_frame(path)
    assert str(path) in str(caught.value)


def test_scrambled_data_is_refused(tmp_path: Path, pressed_panel: Callable[..., Any]) -> None:
    path = tmp_path / "f.vtp"
    write_frame(path, FrameMesher().mesh(pressed_panel(9, 7, 1).frames[0]))
    text = path.read_text()
    start = text.index("_", text.index("<AppendedData")) + 60
    path.write_text(text[:start] + text[start : start + 400][::-1] + text[start + 400 :])
    with pytest.raises(InputError):
        read_frame(path)


def test_other_files_are_refused(tmp_path: Path) -> None:
    write_part(tmp_path / "part.vtp", [FaceMesh("a", np.eye(3), np.array([[0, 1, 2]]))])
    for read, name in ((read_frame, "part.vtp"), (read_series, "part.vtp"), (read_part, "none.vtp")):
        with pytest.raises(InputError):
            read(tmp_path / name)
    assert os.listdir(tmp_path) == ["part.vtp"]
