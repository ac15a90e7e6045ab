"""Examples that need no file: a part made by formulas, written as patch JSON, and a scene for it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..spline.surface import BSplineSurface

Array = NDArray[np.float64]

LENGTH, WIDTH = 120.0, 80.0
"""Sides of the panel, mm."""

PART = "panel.json"
SCENE = "scene.toml"


@dataclass(frozen=True, slots=True)
class Demo:
    """An example: what it shows, and the [[tool]] table of its scene."""

    name: str
    about: str
    tool: Callable[[], dict[str, Any]]
    expect: tuple[dict[str, Any], ...]


def panel() -> BSplineSurface:
    """A doubly curved bicubic panel, 120 mm x 80 mm, outward up: curved one way along and the other way across."""
    r, s, degree = 10, 8, 3
    knots_u, knots_v = _clamped(r, degree, LENGTH), _clamped(s, degree, WIDTH)
    x, y = _greville(knots_u, degree), _greville(knots_v, degree)
    net = np.stack(np.broadcast_arrays(x[:, None], y[None, :], height(x[:, None], y[None, :])), axis=2)
    return BSplineSurface(net, knots_u, knots_v, degree, degree, name="panel")


def height(x: Array, y: Array) -> Array:
    """Height of the control net over the plane."""
    return 14.0 * np.sin(math.pi * x / LENGTH) - 5.0 * np.cos(2.0 * math.pi * (y / WIDTH - 0.5)) * (x / LENGTH)


def surface_point(x: float, y: float) -> tuple[Array, Array]:
    """The point of the panel above (x, y), which are its parameters as well, and the normal there."""
    surface = panel()
    return surface.evaluate(x, y), surface.normal(x, y)


def _press() -> dict[str, Any]:
    point, normal = surface_point(48.0, 40.0)
    rows = [(0.0, 3.0), (0.25, -4.0), (0.3, -4.0), (0.4, 3.0)]
    radius = 12.0
    path = [{"t": t, "at": _rounded(point + (radius + h) * normal)} for t, h in rows]
    return {"name": "ball", "shape": "sphere", "radius": radius, "path": path}


def _stroke() -> dict[str, Any]:
    radius, path = 9.0, []
    for i, x in enumerate(np.linspace(30.0, 88.0, 9)):
        point, normal = surface_point(float(x), 40.0)
        depth = 2.0 if i == 0 else -3.0
        path.append({"t": round(0.06 * i, 6), "at": _rounded(point + (radius + depth) * normal)})
    point, normal = surface_point(88.0, 40.0)
    path.append({"t": 0.56, "at": _rounded(point + (radius + 3.0) * normal)})
    return {"name": "thumb", "shape": "capsule", "radius": radius, "length": 12.0, "path": _upright(path, radius, 12.0)}


def _probe() -> dict[str, Any]:
    path, t = [], 0.0
    for x, y in ((30.0, 25.0), (60.0, 55.0), (90.0, 30.0)):
        point, normal = surface_point(x, y)
        for wait, h in ((0.0, 4.0), (0.08, -1.5), (0.04, 4.0)):
            t = round(t + wait, 6)
            path.append({"t": t, "at": _rounded(point + h * normal)})
        t = round(t + 0.12, 6)
    return {"name": "stylus", "shape": "point", "path": path}


DEMOS = {
    demo.name: demo
    for demo in (
        Demo(
            "press",
            "a ball is pressed into a doubly curved clay panel and taken away: the dent stays",
            _press,
            ({"what": "verdict", "equals": "contact"}, {"what": "max_displacement", "between": [3.0, 5.0]}),
        ),
        Demo(
            "stroke",
            "a blunt thumb presses into the panel and strokes along it: a furrow stays",
            _stroke,
            ({"what": "verdict", "equals": "contact"}, {"what": "max_displacement", "at_least": 1.0}),
        ),
        Demo(
            "probe",
            "a stylus touches the panel at three places",
            _probe,
            ({"what": "verdict", "equals": "contact"}, {"what": "first_contact", "between": [0.0, 0.1]}),
        ),
    )
}
"""The examples by name; the first is the one to start with."""


def demo_named(name: str) -> Demo:
    """The example of that name. Raises InputError when there is none."""
    if name not in DEMOS:
        raise InputError(f"no demo named {name!r}", mend=f"use one of {', '.join(DEMOS)}")
    return DEMOS[name]


def write_demo(demo: Demo, folder: Path) -> Path:
    """Write the example's part and scene into a folder that exists. Returns the scene's path."""
    from .atomic import write_whole
    from .patch_json import write_surfaces
    from .scene_toml import SceneFile, dump

    write_surfaces(folder / PART, [panel()], "mm")
    scene = SceneFile.of(_values(demo), folder / SCENE)
    write_whole(folder / SCENE, dump(scene))
    return folder / SCENE


def _values(demo: Demo) -> dict[str, Any]:
    model = {
        "name": "panel", "file": PART, "faces": "all", "thickness": 12.0, "nodes": 2.5, "layers": 2,
        "anchor": "base", "material": "clay",
    }  # fmt: skip
    return {
        "schema": 1,
        "name": f"demo {demo.name}",
        "units": "mm",
        "model": [model],
        "tool": [demo.tool()],
        "solver": {"step": "auto"},
        "output": {"cad": ["json"]},
        "expect": [dict(entry) for entry in demo.expect],
    }


def _upright(path: list[dict[str, Any]], radius: float, length: float) -> list[dict[str, Any]]:
    """The path of a capsule's middle from that of the middle of its lower end: it stands along z."""
    return [{**row, "at": [row["at"][0], row["at"][1], round(row["at"][2] + 0.5 * length, 6)]} for row in path]


def _clamped(count: int, degree: int, end: float) -> Array:
    inner = np.linspace(0.0, end, count - degree + 1)
    return np.concatenate([np.zeros(degree), inner, np.full(degree, end)])


def _greville(knots: Array, degree: int) -> Array:
    """Control points at the averages of their knots, so that x and y are the parameters themselves."""
    count = len(knots) - degree - 1
    return np.array([knots[i + 1 : i + degree + 1].mean() for i in range(count)])


def _rounded(point: Array) -> list[float]:
    return [round(float(x), 6) for x in point]
