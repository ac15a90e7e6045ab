"""Where to look from, so that the dent is seen: from the tool's side, obliquely, past what stands in the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .frame_mesh import FrameMesh, triangles_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]

VIEW_ANGLE = 24.0
"""Full vertical angle of the camera in degrees: a long lens, that does not distort a part."""

FILLED = 0.92
"""The share of the picture's height and width, less the room kept free below, that the subject fills."""

FOOT = 0.16
"""The share of the height that is kept free at the bottom, for the scalar bar."""

MOST_BLOCKERS = 60_000
"""At most this many triangles are tried for what stands in the way."""


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A perspective camera: position, focus (3,) in the picture's middle, up (3,)."""

    position: Array
    focus: Array
    up: Array


def camera_for(
    mesh: FrameMesh,
    background: Array,
    *,
    view: Literal["part", "dent"] | tuple[float, float, float] = "part",
    aspect: float = 1.6,
    moved: Array | None = None,
    tools: Array | None = None,
) -> Camera:
    """A camera on a frame.

    background (t, 3, 3) : corners of the triangles of the part's other faces. view : the whole part, the dent from
    near, or the whole part seen from a given direction. aspect : the picture's width over its height.
    moved (k,) : how much each vertex matters; the length of its displacement when left out, its contact flag when
    nothing moved.
    tools (n, 3) : points of tools that should be in the picture too, as far as they are near the part.
    """
    patch = ~mesh.tool[mesh.body]
    shape = np.concatenate([mesh.points[patch], background.reshape(-1, 3)])
    if not len(shape):
        shape = mesh.points if len(mesh.points) else np.zeros((1, 3))
    low, high = shape.min(axis=0), shape.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)) or 1.0
    weight = _weights(mesh, patch, moved)
    if weight is None:
        dent, out = middle, np.array([0.0, 0.0, 1.0])
    else:
        dent, out = np.average(mesh.points, axis=0, weights=weight), _outward(mesh, weight)
    if isinstance(view, tuple):
        length = float(np.linalg.norm(view))
        direction = np.asarray(view, np.float64) / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    else:
        corners, body = triangles_of(mesh)
        direction = _oblique(out, dent, half, np.concatenate([mesh.points[corners[~mesh.tool[body]]], background]))
    near = [shape] if tools is None else [shape, tools[np.linalg.norm(tools - middle, axis=1) < 1.4 * half]]
    if view == "dent" and weight is not None:
        felt = mesh.points[weight > 0.0]
        reach = max(2.2 * float(np.linalg.norm(felt - dent, axis=1).max()), 1e-3 * half)
        around = shape[np.linalg.norm(shape - dent, axis=1) < reach]
        near = [around, felt]
    return _fitted(np.concatenate(near), direction, aspect)


def _fitted(subject: Array, direction: Array, aspect: float) -> Camera:
    """The camera nearest to the subject (n, 3) that has all of it in the picture, above the foot."""
    world_up = np.array([0.0, 0.0, 1.0]) if abs(direction[2]) < 0.94 else np.array([0.0, 1.0, 0.0])
    right = np.cross(world_up, direction)
    right /= np.linalg.norm(right)
    up = np.cross(direction, right)
    middle = 0.5 * (subject.min(axis=0) + subject.max(axis=0))
    x, y, z = ((subject - middle) @ axis for axis in (right, up, direction))
    half_height = np.tan(np.radians(0.5 * VIEW_ANGLE))
    tall, wide = half_height * FILLED * (1.0 - FOOT), half_height * aspect * FILLED
    cx = cy = 0.0
    distance = 1e-6 + float(np.ptp(z))
    for _ in range(4):  # the middle as seen in perspective moves a little with the distance
        distance = max(float((np.abs(x - cx) / wide + z).max()), float((np.abs(y - cy) / tall + z).max()), 1e-9)
        seen_x, seen_y = x / (distance - z).clip(1e-12), y / (distance - z).clip(1e-12)
        cx = 0.5 * float(seen_x.min() + seen_x.max()) * distance
        cy = 0.5 * float(seen_y.min() + seen_y.max()) * distance
    distance = max(float((np.abs(x - cx) / wide + z).max()), float((np.abs(y - cy) / tall + z).max()), 1e-9)
    focus = middle + cx * right + (cy - FOOT * half_height * distance) * up
    return Camera(focus + distance * direction, focus, up)


def _weights(mesh: FrameMesh, patch: NDArray[np.bool_], moved: Array | None) -> Array | None:
    """What the camera looks at; None when nothing stands out."""
    for weight in (np.linalg.norm(mesh.displacement, axis=1) if moved is None else moved, mesh.contact.astype(float)):
        weight = np.where(patch, weight, 0.0)
        if len(weight) and weight.max() > 0.0:
            return np.where(weight > 0.3 * weight.max(), weight, 0.0)
    return None


def _outward(mesh: FrameMesh, weight: Array) -> Array:
    """Mean normal of the rest shape at the dent, on the side that the surface was pushed away from."""
    corners, body = triangles_of(mesh)
    corners = corners[~mesh.tool[body]]
    rest = mesh.points - mesh.displacement
    cross = np.cross(rest[corners[:, 1]] - rest[corners[:, 0]], rest[corners[:, 2]] - rest[corners[:, 0]])
    normal: Array = (cross * weight[corners].mean(axis=1)[:, None]).sum(axis=0)
    length = float(np.linalg.norm(normal))
    if length == 0.0:
        return np.array([0.0, 0.0, 1.0])
    normal /= length
    pushed = float(np.average(mesh.displacement, axis=0, weights=weight) @ normal)
    if pushed == 0.0 and mesh.tool.any():
        dent = np.average(mesh.points, axis=0, weights=weight)
        pushed = -float((mesh.points[mesh.tool[mesh.body]].mean(axis=0) - dent) @ normal)
    return -normal if pushed > 0.0 else normal


def _oblique(out: Array, dent: Array, half: float, blockers: Array) -> Array:
    """A unit direction from the dent to the camera: oblique, and where the fewest faces are in between."""
    out = out / np.linalg.norm(out)
    # sideways: to the front left, as drawings show parts, made tangent to the surface
    side = np.array([-0.45, -1.0, 0.35])
    side -= (side @ out) * out
    if np.linalg.norm(side) < 0.2:
        side = np.array([1.0, 0.0, 0.3]) - (np.array([1.0, 0.0, 0.3]) @ out) * out
    side /= np.linalg.norm(side)
    other = np.cross(out, side)
    candidates: list[Array] = []
    for elevation in (48.0, 64.0, 80.0):
        for azimuth in (0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0):
            e, a = np.radians(elevation), np.radians(azimuth)
            candidates.append(np.sin(e) * out + np.cos(e) * (np.cos(a) * side + np.sin(a) * other))
    blockers = blockers[:: len(blockers) // MOST_BLOCKERS + 1]
    start = dent + 0.01 * half * out
    blocked = [_hits(start, direction, blockers) for direction in candidates]
    return candidates[int(np.argmin(blocked))]


def _hits(start: Array, direction: Array, triangles: Array) -> int:
    """How many triangles (t, 3, 3) a ray meets (Moeller, Trumbore 1997)."""
    if not len(triangles):
        return 0
    a = triangles[:, 0]
    e1, e2 = triangles[:, 1] - a, triangles[:, 2] - a
    p = np.cross(direction, e2)
    det = np.einsum("ij,ij->i", e1, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = start - a
        u = np.einsum("ij,ij->i", s, p) / det
        q = np.cross(s, e1)
        v = q @ direction / det
        t = np.einsum("ij,ij->i", e2, q) / det
        return int(np.count_nonzero((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0)))
