"""Pictures: the camera sees the dent, what is drawn is there, and no fault of the graphics reaches the run."""

from __future__ import annotations

import ctypes.util
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cadsculpt.errors import InputError
from cadsculpt.formats.axis import round_ticks, tick_label
from cadsculpt.formats.camera import FOOT, VIEW_ANGLE, Camera, camera_for
from cadsculpt.formats.frame_mesh import FrameMesher
from cadsculpt.formats.pictures import CAPTIONS, Film, Picture, animate, draw, render, run_pictures
from cadsculpt.formats.pictures_draw import SCALE, colour_scale
from cadsculpt.record import Frame, PatchFrame, ToolFrame


def drawn(warnings: Sequence[str]) -> None:
    """Fails on warnings, but skips on a machine that has no OpenGL library at all."""
    if warnings and not any(ctypes.util.find_library(name) for name in ("EGL", "OSMesa", "GL", "opengl32", "OpenGL")):
        pytest.skip(f"this machine has no OpenGL library, so no picture was drawn: {warnings[0]}")
    assert list(warnings) == []


def pixels(path: Path) -> Any:
    from PIL import Image

    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def reddish(image: Any) -> Any:
    """Pixels of the upper half of the colour scale; the scale bar at the foot is left out."""
    image = image[: int(0.84 * len(image))]
    return (image[..., 0] - image[..., 2] > 70) & (image[..., 0] > 60)


def in_picture(camera: Camera, points: Any, aspect: float) -> Any:
    """Points (n, 3) in the picture: x and y from -1 (left, bottom) to 1 (right, top)."""
    back = (camera.position - camera.focus) / np.linalg.norm(camera.position - camera.focus)
    right = np.cross(camera.up, back)
    right /= np.linalg.norm(right)
    relative = points - camera.position
    scale = np.tan(np.radians(0.5 * VIEW_ANGLE)) * -(relative @ back)
    return np.stack([relative @ right / scale / aspect, relative @ np.cross(back, right) / scale], axis=1)


def tilted(panel: Any, seed: int) -> tuple[list[Frame], Any]:
    """The panel turned and moved in space, and the turn (3, 3)."""
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    frames = []
    for frame in panel.frames:
        patches = tuple(
            PatchFrame(p.name, p.points @ turn.T, p.displacement @ turn.T, p.pressure, p.contact, p.stress, p.inside)
            for p in frame.patches
        )
        tools = tuple(ToolFrame(t.name, t.points @ turn.T, t.triangles) for t in frame.tools)
        frames.append(Frame(frame.step, frame.time, patches, tools))
    return frames, turn


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("view", ["part", "dent"])
def test_the_camera_is_on_the_tools_side_and_sees_everything(
    pressed_panel: Callable[..., Any], seed: int, view: Any
) -> None:
    frames, turn = tilted(pressed_panel(41, 31, 3), seed)
    mesh = FrameMesher().mesh(frames[-1])
    camera = camera_for(mesh, np.zeros((0, 3, 3)), view=view, aspect=1.6)
    direction = (camera.position - camera.focus) / np.linalg.norm(camera.position - camera.focus)
    assert direction @ turn[:, 2] > 0.5  # the tool pressed from there
    assert direction @ turn[:, 2] < 0.999
    patch = ~mesh.tool[mesh.body]
    depth = np.linalg.norm(mesh.displacement, axis=1)
    subject = mesh.points[patch] if view == "part" else mesh.points[depth > 0.3 * depth.max()]
    seen = in_picture(camera, subject, 1.6)
    assert np.abs(seen).max() <= 1.0
    assert seen[:, 1].min() >= -1.0 + 2.0 * FOOT * 0.9  # above the scale bar
    assert np.ptp(seen, axis=0).max() > (1.2 if view == "part" else 0.5)  # and not lost in a large picture


def test_the_camera_looks_past_what_stands_in_the_way(pressed_panel: Callable[..., Any]) -> None:
    mesh = FrameMesher().mesh(pressed_panel(41, 31, 3).frames[-1])
    free = camera_for(mesh, np.zeros((0, 3, 3)))
    wall_middle = 0.5 * (free.position + free.focus)
    back = free.position - free.focus
    a, b = np.cross(back, free.up), np.cross(np.cross(back, free.up), back)
    a, b = 60.0 * a / np.linalg.norm(a), 60.0 * b / np.linalg.norm(b)
    # a wall near the part, on the line of sight
    wall_middle = free.focus + 60.0 * back / np.linalg.norm(back)
    wall = np.array([[wall_middle - a - b, wall_middle + a - b, wall_middle + 2.0 * b]])
    other = camera_for(mesh, wall)
    turned = (other.position - other.focus) / np.linalg.norm(other.position - other.focus)
    assert turned @ back / np.linalg.norm(back) < 0.95


@pytest.mark.parametrize("frames", [[], [Frame(0, 0.0, (), ())]])
def test_nothing_to_look_at(frames: list[Frame]) -> None:
    for frame in frames:
        camera = camera_for(FrameMesher().mesh(frame), np.zeros((0, 3, 3)))
        assert np.isfinite(camera.position).all()
        assert np.linalg.norm(camera.position - camera.focus) > 0.0


def test_pictures_and_a_film(
    tmp_path: Path, pressed_panel: Callable[..., Any], capfd: pytest.CaptureFixture[str]
) -> None:
    from PIL import Image

    panel = pressed_panel(41, 31, 4)
    wanted = [
        Picture(tmp_path / "part.png", size=(480, 320), tools=False),
        Picture(tmp_path / "start.png", frame=0, size=(480, 320), what="contact", tools=False),
        Picture(tmp_path / "again.png", size=(480, 320), tools=False),
        Film(tmp_path / "film.gif", size=(240, 160)),
    ]
    drawn(draw(panel.frames, wanted, panel.background, outlines=panel.outlines))
    assert capfd.readouterr() == ("", "")
    assert sorted(os.listdir(tmp_path)) == ["again.png", "film.gif", "part.png", "start.png"]
    image = pixels(tmp_path / "part.png")
    assert image.shape == (320, 480, 3)
    red = reddish(image)
    assert 0.002 < red.mean() < 0.2
    # the dent is where the camera says it is
    mesh = FrameMesher(panel.outlines).mesh(panel.frames[-1])
    corners = np.concatenate([face.points[face.triangles] for face in panel.background])
    camera = camera_for(mesh, corners, aspect=1.5)
    deep = mesh.points[np.argsort(np.linalg.norm(mesh.displacement, axis=1))[-50:]]
    x, y = in_picture(camera, deep, 1.5).mean(axis=0)
    row, column = (np.mean(axis) for axis in np.nonzero(red))
    assert (column / 240.0 - 1.0, 1.0 - row / 160.0) == pytest.approx((x, y), abs=0.12)
    assert (tmp_path / "part.png").read_bytes() == (tmp_path / "again.png").read_bytes()
    film = Image.open(tmp_path / "film.gif")
    assert (film.n_frames, film.size) == (4, (240, 160))


def test_the_film_moves(tmp_path: Path, pressed_panel: Callable[..., Any]) -> None:
    from PIL import Image

    panel = pressed_panel(31, 21, 3)
    drawn(animate(panel.frames, tmp_path / "film.gif", size=(240, 160)))
    film = Image.open(tmp_path / "film.gif")
    counts = []
    for n in range(3):
        film.seek(n)
        counts.append(int(reddish(np.asarray(film.convert("RGB")).astype(int)).sum()))
    assert counts[0] < 0.3 * counts[1] < counts[2]


def test_the_background_alone(tmp_path: Path, pressed_panel: Callable[..., Any]) -> None:
    drawn(render([], tmp_path / "part.png", size=(200, 150), background=pressed_panel(9, 7, 1).background))
    assert (pixels(tmp_path / "part.png") < 200).all(axis=2).mean() > 0.02


def test_a_renderer_that_crashes_is_a_warning(
    tmp_path: Path, pressed_panel: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    script = tmp_path / "python"
    script.write_text(f"#!{sys.executable}\nimport os, sys\nprint('no driver', file=sys.stderr)\nos.abort()\n")
    script.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(script))
    (warning,) = render(pressed_panel(9, 7, 1).frames, tmp_path / "a.png")
    assert "a.png" in warning
    assert "no driver" in warning
    assert "\n" not in warning
    assert not (tmp_path / "a.png").exists()


def test_a_renderer_that_hangs_is_a_warning(
    tmp_path: Path, pressed_panel: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    script = tmp_path / "python"
    script.write_text(f"#!{sys.executable}\nimport time\ntime.sleep(60)\n")
    script.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(script))
    (warning,) = draw(pressed_panel(9, 7, 1).frames, [Picture(tmp_path / "a.png")], time_limit=0.5)
    assert "longer than 0.5 s" in warning


def test_a_renderer_that_is_not_there_is_a_warning(
    tmp_path: Path, pressed_panel: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.executable", str(tmp_path / "none"))
    assert len(render(pressed_panel(9, 7, 1).frames, tmp_path / "a.png")) == 1


def test_a_place_that_cannot_be_written(tmp_path: Path, pressed_panel: Callable[..., Any]) -> None:
    with pytest.raises(InputError, match="make the folder first"):
        drawn(render(pressed_panel(9, 7, 1).frames, tmp_path / "none" / "a.png", size=(60, 40)))


def test_the_pictures_of_a_run(tmp_path: Path, pressed_panel: Callable[..., Any]) -> None:
    frames = pressed_panel(21, 15, 8).frames
    pictures = run_pictures(tmp_path, frames)
    assert [Path(p.path).name for p in pictures] == ["part.png", "dent.png", "pressure.png"]
    assert {Path(p.path).stem for p in pictures} <= set(CAPTIONS)
    loads = [frame.patches[0].pressure.sum() for frame in frames]
    assert pictures[2].frame == int(np.argmax(loads))
    assert len(run_pictures(tmp_path, [])) == 2


def test_what_sprang_back_is_shown_at_its_deepest(tmp_path: Path, pressed_panel: Callable[..., Any]) -> None:
    frames = pressed_panel(21, 15, 8).frames
    deep = int(np.argmax([np.abs(frame.patches[0].displacement).max() for frame in frames]))
    back = [*frames, frames[0]]
    (shown,) = [p for p in run_pictures(tmp_path, back) if Path(p.path).stem == "deepest"]
    assert shown.frame == deep
    assert shown.view == "dent"


def test_the_scale_darkens_all_the_way() -> None:
    colours = colour_scale().astype(float)
    light = colours @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(light) <= 1.5).all()
    assert light[0] > 200.0
    assert light[-1] < 40.0
    assert len(SCALE) == 6


@given(low=st.floats(-1e9, 1e9), span=st.floats(1e-9, 1e9).filter(lambda s: s > 0.0), most=st.integers(2, 12))
def test_ticks_are_round_few_and_inside(low: float, span: float, most: int) -> None:
    high = low + span
    ticks = round_ticks(low, high, most)
    assert len(ticks) <= most + 1
    slack = 1e-6 * (high - low) + 4e-16 * max(abs(low), abs(high))
    assert all(low - slack <= tick <= high + slack for tick in ticks)
    steps = np.diff(ticks)
    if len(steps):
        mantissa = float(f"{steps[0]:.3e}".split("e")[0])
        assert min(abs(mantissa - m) for m in (1.0, 2.0, 5.0, 10.0)) < 1e-2 or span < 1e-9 * abs(low)
    assert tick_label(0.30000000000000004) == "0.3"
