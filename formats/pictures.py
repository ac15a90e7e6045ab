"""Pictures and animations of frames, rendered off screen in a process of its own.

A graphics driver can crash, hang or be missing; a run must not notice. So the drawing happens in a child process with a
time limit (`python -m cadsculpt.formats.pictures_draw`), and what goes wrong comes back as a warning of one line. VTK
finds its way without a display (EGL); when that fails, software rendering (OSMesa) is tried.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..record import Frame
from .atomic import write_whole
from .camera import VIEW_ANGLE, Camera, camera_for
from .frame_mesh import FaceMesh, FrameMesh, FrameMesher, Outlines, borders, evenly, normal_displacement, triangles_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]

What = Literal["displacement", "pressure", "contact"]
View = Literal["part", "dent"] | tuple[float, float, float]

PICTURE_FOLDER = "pictures"
"""In a run's folder; the report shows every picture that it finds there."""

CAPTIONS = {
    "part": "The part after the run, coloured by how far it moved along its normal",
    "dent": "The dent from near",
    "deepest": "The dent when it was deepest",
    "pressure": "Contact pressure when it was highest",
    "film": "The whole run",
}
"""What the report says below the pictures of these names, in its order."""

TIME_LIMIT = 120.0
"""Seconds that one call of `draw` may take."""

MOST_FILM_FRAMES = 90

SPRUNG_BACK = 0.7
"""A dent of which less than this share is left at the end is shown at its deepest, too."""


@dataclass(frozen=True, slots=True)
class Picture:
    """One PNG: frame number `frame` (negative ones count from the end), coloured by `what`, in pixels `size`.

    view : the whole "part", the "dent" from near, or a direction towards the camera.
    """

    path: str | os.PathLike[str]
    frame: int = -1
    what: What = "displacement"
    view: View = "part"
    size: tuple[int, int] = (1280, 800)
    tools: bool = True
    title: str = ""


@dataclass(frozen=True, slots=True)
class Film:
    """One animated GIF of all frames, of which at most MOST_FILM_FRAMES are drawn, evenly chosen."""

    path: str | os.PathLike[str]
    what: What = "displacement"
    view: View = "part"
    size: tuple[int, int] = (800, 500)
    frames_per_second: float = 20.0
    title: str = ""


def render(
    frames: Sequence[Frame | FrameMesh],
    path: str | os.PathLike[str],
    *,
    what: What = "displacement",
    view: View = "part",
    size: tuple[int, int] = (1280, 800),
    background: Sequence[FaceMesh] = (),
    units: str = "mm",
    outlines: Outlines | None = None,
) -> list[str]:
    """Draw the last of the frames as a PNG. Returns warnings; the picture is there when there are none."""
    return draw(frames, [Picture(path, what=what, view=view, size=size)], background, units=units, outlines=outlines)


def animate(
    frames: Sequence[Frame | FrameMesh],
    path: str | os.PathLike[str],
    *,
    what: What = "displacement",
    view: View = "part",
    size: tuple[int, int] = (800, 500),
    frames_per_second: float = 20.0,
    background: Sequence[FaceMesh] = (),
    units: str = "mm",
    outlines: Outlines | None = None,
) -> list[str]:
    """Draw all frames as an animated GIF. Returns warnings; the file is there when there are none."""
    film = Film(path, what=what, view=view, size=size, frames_per_second=frames_per_second)
    return draw(frames, [film], background, units=units, outlines=outlines)


def draw(
    frames: Sequence[Frame | FrameMesh],
    wanted: Sequence[Picture | Film],
    background: Sequence[FaceMesh] = (),
    *,
    units: str = "mm",
    outlines: Outlines | None = None,
    time_limit: float = TIME_LIMIT,
) -> list[str]:
    """Draw several pictures and films in one child process.

    `background` are the part's other faces. Without frames the background alone is drawn. Returns warnings, one line
    each, for what could not be drawn; never raises for a fault of the graphics. Raises InputError when a picture cannot
    be written where it should go.
    """
    if not wanted:
        return []
    mesher = FrameMesher(outlines)
    meshes = [mesher.mesh(frame) if isinstance(frame, Frame) else frame for frame in frames] or [_EMPTY]
    with tempfile.TemporaryDirectory(prefix="cadsculpt-") as name:
        folder = Path(name)
        try:
            _write_job(folder / "job.npz", meshes, wanted, background, units)
        except OSError as error:
            return [f"no pictures: the job could not be written ({error.strerror or error})"]
        fault = _run(folder, time_limit)
        warnings = []
        for number, order in enumerate(wanted):
            made = folder / f"{number}{'.gif' if isinstance(order, Film) else '.png'}"
            if made.exists():
                write_whole(order.path, made.read_bytes())
            else:
                warnings.append(f"no picture {Path(order.path).name}: {fault or 'the renderer made none'}")
        return warnings


def _run(folder: Path, time_limit: float) -> str:
    """Run the child, once more in software if it fails. Returns what went wrong, "" when nothing did."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "PYTHONWARNINGS": "ignore"}
    command = [sys.executable, "-m", "cadsculpt.formats.pictures_draw", str(folder / "job.npz")]
    fault = ""
    for window in ("", "vtkOSOpenGLRenderWindow"):
        if window:
            environment["VTK_DEFAULT_OPENGL_WINDOW"] = window
        try:
            done = subprocess.run(
                command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, timeout=time_limit, check=False
            )
        except subprocess.TimeoutExpired:
            return f"rendering took longer than {time_limit:g} s"
        except OSError as error:
            return f"the renderer could not be started ({error.strerror or error})"
        if done.returncode == 0:
            return ""
        if not fault:
            said = done.stderr.decode(errors="replace").strip().splitlines()
            fault = f"the renderer stopped with code {done.returncode}" + (f" ({said[-1].strip()})" if said else "")
    return fault


def run_pictures(folder: str | os.PathLike[str], frames: Sequence[Frame | FrameMesh]) -> list[Picture]:
    """The pictures that a run puts into its folder: the part and the dent at the end, the dent at its deepest where
    the material has sprung back since, and the pressure at its highest."""
    into = Path(folder) / PICTURE_FOLDER
    pictures = [Picture(into / "part.png"), Picture(into / "dent.png", view="dent")]
    moved = [_moved(frame) for frame in frames]
    if any(moved) and moved[-1] < SPRUNG_BACK * max(moved):
        pictures.append(Picture(into / "deepest.png", frame=int(np.argmax(moved)), view="dent"))
    load = [_load(frame) for frame in frames]
    if any(load):
        highest = int(np.argmax(load))
        pictures.append(Picture(into / "pressure.png", frame=highest, what="pressure", view="dent"))
    return pictures


def _moved(frame: Frame | FrameMesh) -> float:
    """The largest displacement of any patch."""
    if isinstance(frame, FrameMesh):
        parts = [frame.displacement[~frame.tool[frame.body]]]
    else:
        parts = [patch.displacement for patch in frame.patches]
    return max((float(np.linalg.norm(part, axis=-1).max(initial=0.0)) for part in parts), default=0.0)


def _load(frame: Frame | FrameMesh) -> float:
    if isinstance(frame, FrameMesh):
        return float(frame.pressure.sum())
    return sum(float(patch.pressure.sum()) for patch in frame.patches)


# --------------------------------------------------------------------------- the job


@dataclass(frozen=True, slots=True, eq=False)
class _Field:
    """A scalar per frame with what the scalar bar says."""

    values: list[Array]
    title: str
    top: float


def _write_job(
    path: Path,
    meshes: Sequence[FrameMesh],
    wanted: Sequence[Picture | Film],
    background: Sequence[FaceMesh],
    units: str,
) -> None:
    arrays: dict[str, NDArray[Any]] = {}
    points, triangles, edges = _one_mesh(background)
    arrays["part_points"], arrays["part_triangles"], arrays["part_edges"] = points, triangles, edges
    corners = points[triangles]
    fields: dict[str, _Field] = {}
    drawn: set[int] = set()
    orders = []
    for order in wanted:
        if order.what not in fields:
            fields[order.what] = _field(meshes, order.what, units)
        field = fields[order.what]
        if isinstance(order, Film):
            chosen = evenly(len(meshes), MOST_FILM_FRAMES)
        else:
            chosen = [range(len(meshes))[order.frame]]
        drawn.update(chosen)
        camera = _camera(meshes, chosen, corners, order)
        for frame in chosen:
            arrays[f"{order.what}{frame}"] = field.values[frame].astype(np.float32)
        orders.append(
            {
                "film": isinstance(order, Film),
                "frames": chosen,
                "what": order.what,
                "size": list(order.size),
                "title": order.title,
                "bar": field.title,
                "top": field.top if field.top > 0.0 else 1.0,
                "tools": order.tools if isinstance(order, Picture) else True,
                "frames_per_second": order.frames_per_second if isinstance(order, Film) else 0.0,
                "camera": {
                    "position": camera.position.tolist(),
                    "focus": camera.focus.tolist(),
                    "up": camera.up.tolist(),
                    "angle": VIEW_ANGLE,
                },
            }
        )
    tool_count = []
    for frame in sorted(drawn):
        mesh = meshes[frame]
        tools = np.flatnonzero(mesh.tool).tolist()
        triangles, body = triangles_of(mesh)
        patch = ~mesh.tool[body]
        arrays[f"points{frame}"] = mesh.points
        arrays[f"patch{frame}"] = triangles[patch]
        arrays[f"edges{frame}"] = np.concatenate(
            [np.zeros((0, 2), np.int64), *(borders(triangles[body == b]) for b in np.flatnonzero(~mesh.tool))]
        )
        for number, b in enumerate(tools):
            arrays[f"tool{frame}_{number}"] = triangles[body == b]
        tool_count.append(len(tools))
    job = {
        "orders": orders,
        "tools": max(tool_count, default=0),
        "times": {str(frame): meshes[frame].time for frame in sorted(drawn)},
    }
    arrays["job"] = np.frombuffer(json.dumps(job).encode(), np.uint8)
    np.savez(path, **arrays)  # type: ignore[arg-type]


def _camera(meshes: Sequence[FrameMesh], chosen: Sequence[int], background: Array, order: Picture | Film) -> Camera:
    """A film's camera stands still: it looks at what moved in any frame, and where the tools come along."""
    last = meshes[chosen[-1]]
    tools = np.concatenate([meshes[n].points[meshes[n].tool[meshes[n].body]] for n in chosen])
    moved = None
    if all(len(meshes[n].points) == len(last.points) for n in chosen):
        moved = np.max([np.linalg.norm(meshes[n].displacement, axis=1) for n in chosen], axis=0)
        moved[last.tool[last.body]] = 0.0
    aspect = order.size[0] / order.size[1]
    return camera_for(last, background, view=order.view, aspect=aspect, moved=moved, tools=tools)


def _field(meshes: Sequence[FrameMesh], what: What, units: str) -> _Field:
    if what == "displacement":
        values = [np.abs(normal_displacement(mesh)) for mesh in meshes]
        title, scale = f"Displacement along the normal [{units}]", 1.0
    elif what == "pressure":
        values = [mesh.pressure for mesh in meshes]
        largest = max((float(v.max(initial=0.0)) for v in values), default=0.0)
        name, scale = next((n, s) for n, s in _PRESSURES if largest >= s or s == 1.0)
        title = f"Contact pressure [{name}]"
    else:
        values = [mesh.contact.astype(np.float64) for mesh in meshes]
        return _Field(values, "", 1.0)
    values = [v / scale for v in values]
    return _Field(values, title, max((float(v.max(initial=0.0)) for v in values), default=0.0))


_PRESSURES = (("GPa", 1e9), ("MPa", 1e6), ("kPa", 1e3), ("Pa", 1.0))


def _one_mesh(background: Sequence[FaceMesh]) -> tuple[Array, Index, Index]:
    """All faces as one mesh, which is quicker to draw: points, triangles and the borders of the faces.

    Each face keeps its own points, so that shading is smooth within a face and breaks between faces.
    """
    points, triangles, edges = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], [np.zeros((0, 2), np.int64)]
    first = 0
    for face in background:
        own_points, own = _joined_corners(face)
        points.append(own_points)
        triangles.append(own + first)
        edges.append(borders(own) + first)
        first += len(own_points)
    return np.concatenate(points), np.concatenate(triangles), np.concatenate(edges)


def _joined_corners(face: FaceMesh) -> tuple[Array, Index]:
    """The face with equal points made one, so that normals are smooth and only real borders count as borders."""
    points, number = np.unique(face.points, axis=0, return_inverse=True)
    triangles = number.reshape(-1)[face.triangles]
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return points, triangles[whole].astype(np.int64)


_NOTHING = np.zeros(0)
_EMPTY = FrameMesh(
    0, 0.0, (), np.zeros(0, np.bool_), np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros((0, 3)), _NOTHING,
    np.zeros(0, np.bool_), _NOTHING, np.zeros(0, np.int64), np.zeros(1, np.int64), np.zeros(0, np.int64),
)  # fmt: skip
