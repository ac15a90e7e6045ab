"""From a scene's text and the surfaces of its files to a `Model`: everything precomputed, nothing that changes.

The engine opens no file. Whoever reads files hands over `SourceBody`s (the faces of a model, in the scene's unit, with the
edges where they meet other faces), the faces of surface tools, the meshes of mesh tools, and the tool paths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .collide.detect import DetectOptions
from .collide.mesh.triangle_mesh import TriangleMesh
from .encounters import Pairs, Party
from .errors import InputError
from .force_control import Push
from .groups import Group, group_patches
from .motion.boxes import EVERYWHERE, grown, seen_boxes, swept_boxes
from .motion.path import ToolPath
from .patch import Patch, RigidFace, SourceFace, build_patch, build_rigid_face, held_edges, mean_lengths
from .scene import Scene, ToolSpec
from .seams import with_free_creases
from .spline.surface import BSplineSurface
from .substance import Substance
from .tools.make import Tool, make_tool
from .tools.surface import SurfaceTool
from .units import metres_per_unit

Array = NDArray[np.float64]


STRIDE = 0.25
"""A tool that moves by less than this share of the thinnest material and the smallest tool meets, in the meantime, what it
was seen to approach at the start, and nothing else."""

STILL = 0.05
"""Nodes that moved by less than this share of the refit's tolerance did not move: their control points keep their bits."""


@dataclass(frozen=True, slots=True, eq=False)
class SourceBody:
    """The faces of one [[model]] that are to be sculpted, or met when it is rigid.

    solids : marks of the solids of its file that they belong to; models that share one never meet each other.
    """

    name: str
    faces: tuple[SourceFace, ...]
    solids: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True, eq=False)
class ToolBody:
    """A tool of the scene with its path. patches : numbers of its patches in the model; none of a rigid one."""

    name: str
    tool: Tool
    path: ToolPath
    patches: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Everything immutable of a scene, in the scene's length unit L; forces in N, time in s.

    bodies : names of the models, `models` of them, then of the tools: bodies are numbered in this order. patches : the faces
    that have a lattice, of models first, then of deformable tools. rigid_faces : those of rigid models; a face's number is its
    place among the patches, then among these. faces_of : per body the numbers of its faces, none of a rigid tool. free : bodies
    that nothing holds. pairs : of bodies that may meet. groups : of patches that are integrated as one.

    step : length of one step of a run, s. steps : how many make a whole run. refit_threshold : nodes that moved less count
    as not moved, L. size : diagonal of the models' box, L. ball : a centre and a
    radius, L, that hold the models however they are sculpted. stride : how far a tool may move while the contacts
    are those that were seen at the start, L. pushes : the tools under force control, by their place in `tools`.
    """

    scene: Scene
    metres_per_unit: float
    bodies: tuple[str, ...]
    models: int
    patches: tuple[Patch, ...]
    rigid_faces: tuple[RigidFace, ...]
    faces_of: tuple[tuple[int, ...], ...]
    free: frozenset[int]
    tools: tuple[ToolBody, ...]
    pairs: Pairs
    groups: tuple[Group, ...]
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

    def face(self, number: int) -> Patch | RigidFace:
        """A face by its number."""
        count = len(self.patches)
        return self.patches[number] if number < count else self.rigid_faces[number - count]

    @property
    def faces(self) -> tuple[Patch | RigidFace, ...]:
        """All faces in the order of their numbers."""
        return (*self.patches, *self.rigid_faces)

    def tool_of(self, body: int) -> int | None:
        """The place of a body among the tools; None for a model."""
        return body - self.models if body >= self.models else None


def build_model(
    scene: Scene,
    bodies: Sequence[SourceBody],
    paths: Mapping[str, ToolPath],
    tool_surfaces: Mapping[str, Sequence[BSplineSurface]] | None = None,
    tool_meshes: Mapping[str, TriangleMesh] | None = None,
    tool_faces: Mapping[str, Sequence[SourceFace]] | None = None,
) -> Model:
    """Precompute a scene (paper section 4.1, "pre-processing phase").

    tool_surfaces : of rigid surface tools. tool_faces : of deformable ones, in the tool's frame. Raises InputError or
    GeometryError naming the model, face or tool that cannot be used.
    """
    unit = metres_per_unit(scene.units)
    solver = scene.solver
    makings = _makings(scene, bodies, tool_faces or {}, paths)
    names = {each for body in bodies for face in body.faces for each in (face.name, face.number)}
    for box in scene.refit.fixed:
        if box.face is not None and box.face not in names:
            raise InputError(
                f"no sculpted face {box.face!r}", where="refit.fixed", mend="name one of the models' faces"
            )
    spacings = [min(min(spacing) for spacing in making.spacings) for making in makings if making.substance is not None]
    finest = min(spacings)
    deepest = max(making.substance.thickness for making in makings if making.substance is not None)
    surfaces, meshes = tool_surfaces or {}, tool_meshes or {}
    cell = _cell(bodies, solver.resolution) if solver.mode == "certified" else 0.0
    rigid = {
        spec.name: make_tool(
            spec, finest, deepest, solver.resolution, surfaces.get(spec.name, ()), meshes.get(spec.name), cell
        )
        for spec in scene.tool
        if spec.material is None
    }
    models = len(bodies)
    corners = [rigid[making.name].box_corners if making.name in rigid else making.corners() for making in makings]
    boxes = [
        EVERYWHERE if making.free else box[None] if making.path is None else swept_boxes(box, making.path)
        for making, box in zip(makings, corners, strict=True)
    ]
    pairs = Pairs.between(
        [
            Party(k < models, making.substance is not None, making.solids, grown(held, making.bulge))
            for k, (making, held) in enumerate(zip(makings, boxes, strict=True))
        ]
    )
    patches: list[Patch] = []
    rigid_faces: list[RigidFace] = []
    for k, making in enumerate(makings):
        meets = [boxes[j] for j in range(len(makings)) if pairs.index(k, j) is not None]
        swept = np.concatenate(meets) if meets else np.zeros((0, 2, 3))
        if making.free:
            swept = EVERYWHERE
        elif making.path is not None and making.substance is not None:
            swept = seen_boxes(swept, corners[k], making.path)
        made = making.built(scene, k, swept, unit)
        patches += [face for face in made if isinstance(face, Patch)]
        rigid_faces += [face for face in made if isinstance(face, RigidFace)]
    patches = with_free_creases(patches)
    everything: list[Patch | RigidFace] = [*patches, *rigid_faces]
    faces_of = tuple(tuple(n for n, face in enumerate(everything) if face.body == k) for k in range(len(makings)))
    tools = tuple(
        ToolBody(spec.name, rigid[spec.name], paths[spec.name])
        if spec.name in rigid
        else ToolBody(
            spec.name,
            SurfaceTool(tuple(patches[i].grid for i in faces_of[k]), patches[faces_of[k][0]].lattice.thickness),
            paths[spec.name],
            faces_of[k],
        )
        for k, spec in enumerate(scene.tool, start=models)
    )
    free = frozenset(
        k
        for k, making in enumerate(makings)
        if making.substance is not None and not any(patches[i].lattice.anchored.any() for i in faces_of[k])
    )
    for k in free:
        if k >= models:
            raise InputError(
                "nothing of it is held", where=f"tool {makings[k].name!r}", mend="name a hold that its faces have"
            )
        if solver.quasi_static:
            raise InputError(
                "a quasi-static body that nothing holds", where=f"model {makings[k].name!r}", mend="give it an anchor"
            )
    points = np.concatenate(
        [face.grid.surface.control_points.reshape(-1, 3) for face in everything if face.body < models]
    )
    step = _step(scene, tools, finest, patches)
    duration = max(tool.path.duration for tool in tools)
    return Model(
        scene=scene,
        metres_per_unit=unit,
        bodies=tuple(making.name for making in makings),
        models=models,
        patches=tuple(patches),
        rigid_faces=tuple(rigid_faces),
        faces_of=faces_of,
        free=free,
        tools=tools,
        pairs=pairs,
        groups=group_patches(patches, pairs),
        step=step,
        steps=max(1, int(np.ceil(duration / step - 1e-9))),
        options=DetectOptions(mode=solver.mode, tolerance=solver.tolerance, delta=float(np.radians(solver.delta))),
        refit_threshold=STILL * scene.refit.tolerance,
        size=float(np.linalg.norm(points.max(axis=0) - points.min(axis=0))),
        ball=(0.5 * (points.max(axis=0) + points.min(axis=0)), float(np.linalg.norm(np.ptp(points, axis=0)))),
        stride=STRIDE * _smallest([m.substance.thickness for m in makings if m.substance is not None], tools),
        pushes={i: _push(spec, paths[spec.name]) for i, spec in enumerate(scene.tool) if spec.control == "force"},
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Making:
    """A body on its way into the model. substance : None of a rigid one. path : None of a model. spacings : of the nodes
    on each of its faces."""

    name: str
    faces: tuple[SourceFace, ...]
    substance: Substance | None
    spacings: tuple[tuple[float, float], ...]
    solids: frozenset[str]
    outward: bool | None
    path: ToolPath | None

    @property
    def where(self) -> str:
        return f"{'model' if self.path is None else 'tool'} {self.name!r}"

    @property
    def free(self) -> bool:
        """Nothing holds it: it moves as a whole."""
        if self.substance is None or self.path is not None or self.substance.anchor != "none":
            return False
        return not any(held_edges(self.substance, face, self.siblings(face)) for face in self.faces)

    def siblings(self, face: SourceFace) -> frozenset[str]:
        """The names of its other faces."""
        return frozenset(other.name for other in self.faces if other is not face)

    def corners(self) -> Array:
        """The box (2, 3) of its control points, in its own frame."""
        points = np.concatenate([face.surface.control_points.reshape(-1, 3) for face in self.faces])
        return np.array([points.min(axis=0), points.max(axis=0)])

    @property
    def bulge(self) -> float:
        """How far it may come out of its box as it deforms."""
        return 0.0 if self.substance is None else self.substance.thickness

    def built(self, scene: Scene, body: int, swept: Array, unit: float) -> list[Patch | RigidFace]:
        """Its faces, prepared. swept : see `build_patch`."""
        made: list[Patch | RigidFace] = []
        for n, face in enumerate(self.faces):
            try:
                if self.substance is None:
                    made.append(build_rigid_face(scene, self.outward, body, face))
                else:
                    siblings = self.siblings(face)
                    made.append(build_patch(scene, self.substance, body, face, self.spacings[n], swept, unit, siblings))
            except InputError as error:
                raise type(error)(error.what, where=f"{self.where}, face {face.name!r}", mend=error.mend) from None
        return made


def _makings(
    scene: Scene,
    bodies: Sequence[SourceBody],
    tool_faces: Mapping[str, Sequence[SourceFace]],
    paths: Mapping[str, ToolPath],
) -> list[_Making]:
    """All bodies of the scene in their order."""
    made = []
    for model, body in zip(scene.model, bodies, strict=True):
        if not body.faces:
            raise InputError("no face to sculpt", where=f"model {model.name!r}", mend="name at least one face")
        substance = Substance.of_model(model)
        made.append(
            _Making(
                model.name, body.faces, substance, _spacings(substance, body.faces), body.solids, model.outward, None
            )
        )
    for tool in scene.tool:
        faces, substance = tuple(tool_faces.get(tool.name, ())), Substance.of_tool(tool)
        if substance is not None and not faces:
            raise InputError(
                "a surface tool without a surface",
                where=f"tool {tool.name!r}",
                mend="name a file with at least one face",
            )
        made.append(
            _Making(tool.name, faces, substance, _spacings(substance, faces), frozenset(), None, paths[tool.name])
        )
    return made


def _spacings(substance: Substance | None, faces: Sequence[SourceFace]) -> tuple[tuple[float, float], ...]:
    return () if substance is None else tuple(_spacing(substance, face) for face in faces)


def _cell(bodies: Sequence[SourceBody], resolution: int | tuple[int, int]) -> float:
    """The smallest mean cell of any face's collision grid, L."""
    rows = (resolution, resolution) if isinstance(resolution, int) else resolution
    lengths = [mean_lengths(face.surface) for body in bodies for face in body.faces]
    return min(length / (n - 1) for pair in lengths for length, n in zip(pair, rows, strict=True))


def _push(spec: ToolSpec, path: ToolPath) -> Push:
    try:
        return Push.of(spec.force or 0.0, spec.direction, path)
    except InputError as error:
        raise InputError(error.what, where=f"tool {spec.name!r}", mend=error.mend) from None


def _smallest(thicknesses: Sequence[float], tools: Sequence[ToolBody]) -> float:
    """The smallest size of anything that a tool could pass through or that could pass through it, L."""
    sizes = [float(side) for tool in tools for side in np.diff(tool.tool.box_corners, axis=0).ravel() if side > 0]
    return min([*thicknesses, *sizes])


def _spacing(substance: Substance, face: SourceFace) -> tuple[float, float]:
    """Node spacing along u and v; numbers of nodes are spread over the face's mean lengths."""
    if isinstance(substance.nodes, (int, float)):
        return float(substance.nodes), float(substance.nodes)
    lengths = mean_lengths(face.surface)
    return lengths[0] / (substance.nodes[0] - 1), lengths[1] / (substance.nodes[1] - 1)


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
