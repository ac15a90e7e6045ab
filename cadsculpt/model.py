"""From a scene's text and the surfaces of its files to a `Model`: everything precomputed, nothing that changes.

The engine opens no file. Whoever reads files hands over `SourceBody`s (the faces to be sculpted, in the scene's unit, with
the edges where they meet other faces), the surfaces of surface tools, the meshes of mesh tools, and the tool paths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .collide.detect import DetectOptions
from .collide.mesh.triangle_mesh import TriangleMesh
from .errors import InputError
from .force_control import Push
from .motion.path import ToolPath
from .patch import Patch, SourceFace, build_patch, mean_lengths
from .scene import ModelSpec, Scene, ToolSpec
from .spline.surface import BSplineSurface
from .tools.make import Tool, make_tool
from .units import metres_per_unit

Array = NDArray[np.float64]


STRIDE = 0.25
"""A tool that moves by less than this share of the thinnest material and the smallest tool meets, in the meantime, what it
was seen to approach at the start, and nothing else."""

STILL = 0.05
"""Nodes that moved by less than this share of the refit's tolerance did not move: their control points keep their bits."""


@dataclass(frozen=True, slots=True, eq=False)
class SourceBody:
    """The faces of one [[model]] that are to be sculpted."""

    name: str
    faces: tuple[SourceFace, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ToolBody:
    """A tool of the scene with its path."""

    name: str
    tool: Tool
    path: ToolPath


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Everything immutable of a scene, in the scene's length unit L; forces in N, time in s.

    step : length of one step of a run, s. steps : how many make a whole run. refit_threshold : nodes that moved less count
    as not moved, L. size : diagonal of the sculpted faces' box, L. ball : a centre and a
    radius, L, that hold these faces however they are sculpted. stride : how far a tool may move while the contacts
    are those that were seen at the start, L. pushes : the tools under force control, by their place in `tools`.
    """

    scene: Scene
    metres_per_unit: float
    bodies: tuple[str, ...]
    patches: tuple[Patch, ...]
    tools: tuple[ToolBody, ...]
    step: float
    steps: int
    options: DetectOptions
    refit_threshold: float
    size: float
    ball: tuple[Array, float]
    stride: float
    pushes: Mapping[int, Push]

    def step_length(self, step: int) -> float:
        """Length of step number `step` (from 0) in s; the last one ends where the longest path ends."""
        duration = max(tool.path.duration for tool in self.tools)
        return self.step if step < self.steps - 1 else max(duration - step * self.step, 1e-3 * self.step)


def build_model(
    scene: Scene,
    bodies: Sequence[SourceBody],
    paths: Mapping[str, ToolPath],
    tool_surfaces: Mapping[str, Sequence[BSplineSurface]] | None = None,
    tool_meshes: Mapping[str, TriangleMesh] | None = None,
) -> Model:
    """Precompute a scene (paper section 4.1, "pre-processing phase").

    Raises InputError or GeometryError naming the model, face or tool that cannot be used.
    """
    unit = metres_per_unit(scene.units)
    solver = scene.solver
    for spec, body in zip(scene.model, bodies, strict=True):
        if not body.faces:
            raise InputError("no face to sculpt", where=f"model {spec.name!r}", mend="name at least one face")
        if solver.quasi_static and spec.anchor == "none":
            raise InputError(
                "a quasi-static body that nothing holds", where=f"model {spec.name!r}", mend="give it an anchor"
            )
    faces = [
        (spec, index, face, _spacing(spec, face))
        for index, (spec, body) in enumerate(zip(scene.model, bodies, strict=True))
        for face in body.faces
    ]
    finest = min(min(spacing) for *_, spacing in faces)
    deepest = max(spec.thickness for spec in scene.model)
    surfaces, meshes = tool_surfaces or {}, tool_meshes or {}
    tools = tuple(
        ToolBody(
            spec.name,
            make_tool(spec, finest, deepest, solver.resolution, surfaces.get(spec.name, ()), meshes.get(spec.name)),
            paths[spec.name],
        )
        for spec in scene.tool
    )
    swept = np.concatenate([swept_boxes(tool) for tool in tools])
    patches = tuple(_built(scene, spec, index, face, spacing, swept, unit) for spec, index, face, spacing in faces)
    points = np.concatenate([patch.surface.control_points.reshape(-1, 3) for patch in patches])
    step = _step(scene, tools, finest, patches)
    duration = max(tool.path.duration for tool in tools)
    return Model(
        scene=scene,
        metres_per_unit=unit,
        bodies=tuple(body.name for body in bodies),
        patches=patches,
        tools=tools,
        step=step,
        steps=max(1, int(np.ceil(duration / step - 1e-9))),
        options=DetectOptions(mode=solver.mode, tolerance=solver.tolerance, delta=float(np.radians(solver.delta))),
        refit_threshold=STILL * scene.refit.tolerance,
        size=float(np.linalg.norm(points.max(axis=0) - points.min(axis=0))),
        ball=(0.5 * (points.max(axis=0) + points.min(axis=0)), float(np.linalg.norm(np.ptp(points, axis=0)))),
        stride=STRIDE * _smallest([spec.thickness for spec in scene.model], tools),
        pushes={i: _push(spec, paths[spec.name]) for i, spec in enumerate(scene.tool) if spec.control == "force"},
    )


def _push(spec: ToolSpec, path: ToolPath) -> Push:
    try:
        return Push.of(spec.force or 0.0, spec.direction, path)
    except InputError as error:
        raise InputError(error.what, where=f"tool {spec.name!r}", mend=error.mend) from None


def _smallest(thicknesses: Sequence[float], tools: Sequence[ToolBody]) -> float:
    """The smallest size of anything that a tool could pass through or that could pass through it, L."""
    sizes = [float(side) for tool in tools for side in np.diff(tool.tool.box_corners, axis=0).ravel() if side > 0]
    return min([*thicknesses, *sizes])


def _built(
    scene: Scene,
    spec: ModelSpec,
    index: int,
    face: SourceFace,
    spacing: tuple[float, float],
    swept: Array,
    unit: float,
) -> Patch:
    try:
        return build_patch(scene, spec, index, face, spacing, swept, unit)
    except InputError as error:
        raise type(error)(error.what, where=f"model {spec.name!r}, face {face.name!r}", mend=error.mend) from None


def swept_boxes(tool: ToolBody, samples: int = 256) -> Array:
    """Boxes (k, 2, 3) in the world that together hold the tool along its path."""
    path = tool.path
    times = np.unique(np.concatenate([path.t, np.linspace(path.t[0], path.t[-1], samples)]))
    low, high = tool.tool.box_corners
    if not np.isfinite([low, high]).all():
        return np.array([[[-np.inf] * 3, [np.inf] * 3]])
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    boxes = []
    for t in times:
        pose = path.pose(float(t))
        middle, reach = pose.to_world(centre), np.abs(pose.rotation) @ half
        boxes.append([middle - reach, middle + reach])
    ends = np.array(boxes)
    # between two samples the tool is inside the box of both
    joined = np.stack([np.minimum(ends[:-1, 0], ends[1:, 0]), np.maximum(ends[:-1, 1], ends[1:, 1])], axis=1)
    return joined if len(joined) else ends


def _spacing(spec: ModelSpec, face: SourceFace) -> tuple[float, float]:
    """Node spacing along u and v; numbers of nodes are spread over the face's mean lengths."""
    if isinstance(spec.nodes, (int, float)):
        return float(spec.nodes), float(spec.nodes)
    lengths = mean_lengths(face.surface)
    return lengths[0] / (spec.nodes[0] - 1), lengths[1] / (spec.nodes[1] - 1)


def _step(scene: Scene, tools: Sequence[ToolBody], spacing: float, patches: Sequence[Patch]) -> float:
    """The length of one step: the scene's, or for "auto" the time in which no tool moves more than a tenth of the spacing.

    An implicit step costs far more than a collision check, and keeps its contacts' planes: a quarter of the spacing.
    """
    if not isinstance(scene.solver.step, str):
        return float(scene.solver.step)
    fastest = max(_top_speed(tool) for tool in tools)
    stable = min(patch.substep for patch in patches)
    duration = max(tool.path.duration for tool in tools)
    share = 0.25 if scene.solver.integrator == "implicit" else 0.1
    step = share * spacing / fastest if fastest > 0 else duration
    return float(min(max(step, stable), max(duration, stable)))


def _top_speed(tool: ToolBody) -> float:
    """The highest speed of any point of the tool along its path, L/s."""
    corners = tool.tool.box_corners
    reach = float(np.linalg.norm(corners, axis=1).max()) if np.isfinite(corners).all() else 0.0
    speeds = [0.0]
    for t in tool.path.t:
        linear, angular = tool.path.velocity(float(t))
        speeds.append(float(np.linalg.norm(linear) + reach * np.linalg.norm(angular)))
    return max(speeds)
