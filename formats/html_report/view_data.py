"""The frames as the report's 3D view takes them: few vertices, whole numbers, base64.

Positions are quantised to 16 bits over the box of the scene, colours to 8 bits. Vertices that never move are stored
once; only the others are stored frame by frame. A mesh with more vertices than the view draws swiftly is thinned by
clustering: finely where something moved, coarsely elsewhere.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..frame_mesh import FaceMesh, FrameMesh, borders, evenly, normal_displacement, triangles_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_FRAMES = 60
MOST_VERTICES = 20_000
"""Of the sculpted faces; the background and the tools may have as many again between them."""
STEPS = 65_535


def view_data(frames: Sequence[FrameMesh], background: Sequence[FaceMesh], units: str) -> dict[str, Any] | None:
    """The object that view.js draws; None when there is nothing to draw.

    {"times": [s, ...], "low": [x, y, z], "scale": unit per step, "top": largest displacement, "units", "meshes":
    [{"kind": "patch"|"face"|"tool", "name", "count", "triangles", "lines", "rest", "moving", "frames", "colours"}]}:
    triangles and lines are uint32; rest and each of frames uint16 x, y, z; moving the uint32 numbers of the vertices
    that frames speak of; colours uint8 of those vertices; all base64, little-endian.
    """
    chosen = [frames[n] for n in evenly(len(frames), MOST_FRAMES)]
    bodies = _bodies(chosen)
    faces = [(face.points, face.triangles) for face in background if len(face.triangles)]
    clouds = [body["points"].reshape(-1, 3) for body in bodies] + [points for points, _ in faces]
    if not clouds:
        return None
    low = np.min([cloud.min(axis=0) for cloud in clouds], axis=0)
    high = np.max([cloud.max(axis=0) for cloud in clouds], axis=0)
    scale = float((high - low).max()) / STEPS or 1.0
    top = max((float(body["value"].max(initial=0.0)) for body in bodies), default=0.0)
    share = MOST_VERTICES / max(1, sum(body["points"].shape[1] for body in bodies if body["kind"] == "patch"))
    meshes = []
    for body in bodies:
        patch = body["kind"] == "patch"
        most = int(body["points"].shape[1] * share) if patch else MOST_VERTICES // 8
        moved = body["value"].max(axis=0) if patch else None
        kept, triangles = thinned(body["points"][0], body["triangles"], most, moved)
        points, value = body["points"][:, kept], body["value"][:, kept]
        meshes.append(_packed(body["kind"], body["name"], points, value / (top or 1.0), triangles, low, scale))
    share = MOST_VERTICES / max(1, sum(len(points) for points, _ in faces))
    for points, triangles in faces:
        kept, fewer = thinned(points, triangles, int(len(points) * share), None)
        meshes.append(_packed("face", "", points[None, kept], np.zeros((1, len(kept))), fewer, low, scale))
    return {
        "times": [frame.time for frame in chosen],
        "low": low.tolist(),
        "scale": scale,
        "top": top,
        "units": units,
        "meshes": meshes,
    }


def _bodies(frames: Sequence[FrameMesh]) -> list[dict[str, Any]]:
    """Per patch and tool: points (f, k, 3), value (f, k) and triangles of its own vertices.

    A body whose mesh changes its number of points on the way is drawn from the frames on where it has its last number.
    """
    if not frames:
        return []
    last = frames[-1]
    corners, of = triangles_of(last)
    values = [np.abs(normal_displacement(frame)) for frame in frames]
    bodies = []
    for number, name in enumerate(last.bodies):
        own = np.flatnonzero(last.body == number)
        triangles = corners[of == number]
        if not len(triangles):
            continue
        points, value = [], []
        for frame, of_frame in zip(frames, values, strict=True):
            mine = frame.body == (frame.bodies.index(name) if name in frame.bodies else -1)
            same = np.count_nonzero(mine) == len(own)
            points.append(frame.points[mine] if same else last.points[own])
            value.append(of_frame[mine] if same else np.zeros(len(own)))
        renumbered = np.zeros(len(last.points), np.int64)
        renumbered[own] = np.arange(len(own))
        kind = "tool" if last.tool[number] else "patch"
        bodies.append(
            {
                "kind": kind,
                "name": name,
                "points": np.stack(points),
                "value": np.stack(value),
                "triangles": renumbered[triangles],
            }
        )
    return bodies


def thinned(points: Array, triangles: Index, most: int, moved: Array | None) -> tuple[Index, Index]:
    """About `most` of the vertices (k,), and the triangles (f, 3) between them, numbered anew.

    Vertices in one box of a grid become one: one on the outline, where there is any, so that outlines keep their place.
    `moved` (n,) says where the boxes are four times finer.
    """
    if len(points) <= most or most < 4:
        used = np.unique(triangles)
        return used, np.searchsorted(used, triangles)
    low, extent = points.min(axis=0), float(np.ptp(points, axis=0).max()) or 1.0
    fine = np.zeros(len(points), np.bool_) if moved is None else moved > 0.02 * max(float(moved.max()), 1e-300)
    outline = np.zeros(len(points), np.bool_)
    outline[borders(triangles)] = True
    order = np.argsort(~outline, kind="stable")
    cells = float(np.sqrt(most))
    while True:
        box = np.floor((points - low) / extent * np.where(fine, 4.0 * cells, cells)[:, None]).astype(np.int64)
        keys, first, number = np.unique(
            np.column_stack([box, fine])[order], axis=0, return_index=True, return_inverse=True
        )
        if len(keys) <= most or cells < 1.0:
            break
        cells *= 0.85
    first = order[first]
    place = np.zeros(len(points), np.int64)
    place[order] = number.reshape(-1)
    corners = place[triangles]
    whole = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    corners = np.unique(corners[whole], axis=0) if whole.any() else corners[:0]
    used = np.unique(corners)
    return first[used].astype(np.int64), np.searchsorted(used, corners)


def _packed(
    kind: str, name: str, points: Array, value: Array, triangles: Index, low: Array, scale: float
) -> dict[str, Any]:
    steps = np.clip(np.round((points - low) / scale), 0, STEPS).astype("<u2")
    shade = np.clip(np.round(value * 255.0), 0, 255).astype("u1")
    moving = np.flatnonzero((steps != steps[0]).any(axis=(0, 2)) | (shade != 0).any(axis=0))
    lines = borders(triangles) if kind != "tool" else np.zeros((0, 2), np.int64)
    return {
        "kind": kind,
        "name": name,
        "count": points.shape[1],
        "triangles": _base64(triangles.astype("<u4")),
        "lines": _base64(lines.astype("<u4")),
        "rest": _base64(steps[0]),
        "moving": _base64(moving.astype("<u4")),
        "frames": [_base64(frame[moving]) for frame in steps] if len(moving) else [],
        "colours": [_base64(frame[moving]) for frame in shade] if len(moving) and kind == "patch" else [],
    }


def _base64(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
