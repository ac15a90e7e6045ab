"""A made-up run for the tests of what cadsculpt writes: a panel with a hole, pressed by an ellipsoid that slides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from cadsculpt.formats.frame_mesh import FaceMesh
from cadsculpt.record import Frame, PatchFrame, ToolFrame

Array = NDArray[np.float64]

LENGTH, WIDTH, THICK = 120.0, 80.0, 8.0
HOLE = (92.0, 40.0, 11.0)
RADII = np.array([9.0, 9.0, 15.0])


@dataclass(frozen=True)
class PressedPanel:
    """Frames in mm, the faces around the panel, and the hole's loop in grid coordinates."""

    frames: list[Frame]
    background: list[FaceMesh]
    outlines: dict[str, list[Array]]


@pytest.fixture(scope="session")
def pressed_panel() -> Callable[..., PressedPanel]:
    """Makes the run: `pressed_panel(rows=61, columns=41, count=12)`."""
    return make


def height(x: Array, y: Array) -> Array:
    return 9.0 * np.sin(np.pi * x / LENGTH) * (0.6 + 0.4 * np.sin(np.pi * y / WIDTH))


def make(rows: int = 61, columns: int = 41, count: int = 12) -> PressedPanel:
    x, y = np.meshgrid(np.linspace(0.0, LENGTH, rows), np.linspace(0.0, WIDTH, columns), indexing="ij")
    rest = np.stack([x, y, height(x, y)], axis=2)
    inside = (x - HOLE[0]) ** 2 + (y - HOLE[1]) ** 2 >= HOLE[2] ** 2
    lowest = np.zeros_like(x)
    frames = []
    for n in range(count):
        s = n / max(count - 1, 1)
        at = np.array([34.0 + 26.0 * max(0.0, min(1.0, (s - 0.35) / 0.45)), 40.0])
        press = 5.0 * min(1.0, s / 0.35) * (1.0 if s < 0.85 else 1.0 - (s - 0.85) / 0.08)
        centre = np.array([*at, float(height(at[:1], at[1:])[0]) + RADII[2] - press])
        q = ((x - centre[0]) / RADII[0]) ** 2 + ((y - centre[1]) / RADII[1]) ** 2
        below = centre[2] - RADII[2] * np.sqrt(np.maximum(1.0 - q, 0.0))
        # beyond the ellipsoid the surface follows softly, so that the rim is round
        push = -np.logaddexp(0.0, -(np.where(q < 1.0, below, np.inf) - rest[..., 2]) * 4.0) / 4.0
        contact = (push < lowest) & inside
        lowest = np.minimum(lowest, push)
        lip = 0.5 * np.exp(-(((np.sqrt(q) - 1.05) / 0.3) ** 2)) * (press > 0) * np.minimum(s / 0.35, 1.0)
        move = np.zeros_like(rest)
        move[..., 2] = 0.92 * lowest + np.where(lowest < 0.0, 0.0, 0.4 * lip)
        patch = PatchFrame(
            "top",
            rest + move,
            move,
            np.where(contact, -3.0e4 * push, 0.0),
            contact,
            2.0e4 * np.abs(move[..., 2]),
            inside,
        )
        frames.append(Frame(10 * n, 0.05 * n, (patch,), (_ellipsoid(centre),)))
    return PressedPanel(frames, _walls(), {"top": [_hole_in_grid(rows, columns)]})


def _ellipsoid(centre: Array) -> ToolFrame:
    m, n = 40, 60
    polar, around = np.meshgrid(np.linspace(0.0, np.pi, m), np.linspace(0.0, 2.0 * np.pi, n), indexing="ij")
    ball = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=2)
    return ToolFrame("thumb", (ball * RADII + centre).reshape(-1, 3), _grid_triangles(m, n))


def _grid_triangles(rows: int, columns: int) -> NDArray[np.int64]:
    flat = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = flat[:-1, :-1], flat[1:, :-1], flat[1:, 1:], flat[:-1, 1:]
    return np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])


def _strip(name: str, x: Array, y: Array) -> FaceMesh:
    upper = np.stack([x, y, height(x, y)], axis=1)
    lower = np.stack([x, y, np.full_like(x, -THICK)], axis=1)
    return FaceMesh(name, np.concatenate([upper, lower]), _grid_triangles(2, len(x)))


def _walls() -> list[FaceMesh]:
    along, across = np.linspace(0.0, LENGTH, 81), np.linspace(0.0, WIDTH, 61)
    turn = np.linspace(0.0, 2.0 * np.pi, 97)
    return [
        _strip("front", along, np.zeros_like(along)),
        _strip("back", along, np.full_like(along, WIDTH)),
        _strip("left", np.zeros_like(across), across),
        _strip("right", np.full_like(across, LENGTH), across),
        _strip("bore", HOLE[0] + HOLE[2] * np.cos(turn), HOLE[1] + HOLE[2] * np.sin(turn)),
    ]


def _hole_in_grid(rows: int, columns: int) -> Array:
    turn = np.linspace(0.0, 2.0 * np.pi, 256, endpoint=False)
    x, y = HOLE[0] + HOLE[2] * np.cos(turn), HOLE[1] + HOLE[2] * np.sin(turn)
    return np.stack([x / LENGTH * (rows - 1), y / WIDTH * (columns - 1)], axis=1)
