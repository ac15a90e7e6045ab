"""From a scene file to a `Model`: reads the parts, the tools' surfaces and the paths that the scene names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..collide.mesh.triangle_mesh import TriangleMesh
from ..encounters import together
from ..errors import CadsculptError, GeometryError, InputError
from ..export_fit import Exported
from ..model import Model, SourceBody, build_model
from ..motion.path import ToolPath
from ..patch import SourceEdge, SourceFace
from ..scene import ToolSpec
from ..spline.elevate import elevated
from ..spline.refine import insert_knots
from ..spline.surface import BSplineSurface
from ..units import conversion
from . import mesh, registry
from .instances import chosen_faces, named_instances
from .part import Face, Part
from .scene_toml import SceneFile
from .stated_tolerance import stated_tolerance

SPLINES = ("bspline", "bezier")
SMOOTH_DEGREE = 3


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """A scene with its files read.

    parts : the CAD files of models, by resolved path; faces : for each of the models' patches its part's path and face number.
    warnings : what the readers had to say.
    """

    scene: SceneFile
    model: Model
    parts: dict[Path, Part]
    faces: tuple[tuple[Path, int], ...]
    warnings: tuple[str, ...]

    def sculpted(self, exported: Exported) -> dict[Path, dict[int, BSplineSurface]]:
        """Per part the sculpted surfaces (mm) of its faces: the face as read, with knots added and control points moved.

        Control points that do not move keep the bits of the file.
        """
        to_mm = conversion(self.scene.units, "mm")
        result: dict[Path, dict[int, BSplineSurface]] = {path: {} for path, _ in self.faces}
        for index, (path, number) in enumerate(self.faces):
            face = exported.faces[index]
            fine = insert_knots(sculptable(self.parts[path], self.parts[path].faces.number(number)), *face.knots)
            moved = face.displacement
            net = np.where(moved == 0.0, fine.control_points, fine.control_points + moved * to_mm)
            result[path][number] = fine.with_control_points(net)
        return result


def load(scene: SceneFile, on_file: Callable[[str], None] | None = None) -> Loaded:
    """Read everything a scene names and build its model.

    on_file : told the name of each file before it is read. Raises InputError or GeometryError naming what cannot be used.
    """
    parts: dict[Path, Part] = {}
    units_of: dict[Path, str | None] = {}
    read: dict[Path, int] = {}
    apart = named_instances(scene, scene.folder)
    warnings: list[str] = list(scene.warnings)

    def part_of(name: str, units: str | None = None) -> tuple[Path, Part]:
        path = (scene.folder / name).resolve()
        if units_of.setdefault(path, units) != units:
            raise InputError(
                "one file is taken in two units", where=str(path), mend="write the same file_units wherever"
            )
        if path not in parts:
            if on_file:
                on_file(path.name)
            parts[path] = registry.read(path, units=units)
            if path in apart:
                parts[path] = parts[path].separated(apart[path])
            read[path] = len(parts[path].warnings)
            warnings.extend(f"{path.name}: {line}" for line in parts[path].warnings)
        return path, parts[path]

    bodies, faces, used = list[SourceBody](), list[tuple[Path, int]](), list[tuple[Path, int]]()
    for index, spec in enumerate(scene.model):
        path, part = part_of(spec.file, spec.file_units)
        try:
            chosen = chosen_faces(part, spec.faces, spec.instances)
        except InputError as error:
            raise InputError(
                f"model {spec.name!r}: {path.name} has {error.what}",
                where=scene.where("model", index, "faces"),
                mend=error.mend,
            ) from None
        taken = [face.name for face in chosen if (path, face.number) in used]
        if taken:
            raise InputError(
                f"face {taken[0]!r} of {path.name} belongs to two models",
                where=f"model {spec.name!r}",
                mend="name each face once",
            )
        if not spec.rigid:
            warnings += _alike(path, part, chosen)
        solid = _solids(part)
        bodies.append(
            SourceBody(
                spec.name,
                tuple(source_face(part, face, scene.units) for face in chosen),
                frozenset(f"{path}#{solid[face.number]}" for face in chosen),
            )
        )
        used += [(path, face.number) for face in chosen]
        if not spec.rigid:
            faces += [(path, face.number) for face in chosen]
    tool_faces = {spec.name: _tool_faces(spec, scene, part_of) for spec in scene.tool if spec.shape == "surface"}
    meshes: dict[str, TriangleMesh] = {}
    for tool in scene.tool:
        if tool.shape == "mesh" and tool.file is not None:
            file = scene.folder / tool.file
            if on_file:
                on_file(file.name)
            meshes[tool.name] = _tool_mesh(tool, file, scene.units)
            warnings += [f"{file.name}: {line}" for line in meshes[tool.name].warnings]
    paths = {spec.name: _path(scene, spec.name) for spec in scene.tool}
    rigid = {
        spec.name: [face.surface for face in tool_faces[spec.name]] for spec in scene.tool if spec.name in tool_faces
    }
    model = build_model(scene, bodies, paths, rigid, meshes, tool_faces)
    models = {path for path, _ in used}
    warnings += [f"{path.name}: {line}" for path, part in parts.items() for line in part.warnings[read[path] :]]
    return Loaded(
        scene, model, {path: part for path, part in parts.items() if path in models}, tuple(faces), tuple(warnings)
    )


def _alike(path: Path, part: Part, chosen: Sequence[Face]) -> list[str]:
    """A warning where two of the chosen faces are one in two places."""
    numbers = {face.number for face in chosen}
    for face in chosen:
        if both := numbers.intersection(part.twins(face.number)):
            other = part.faces.number(min(both))
            return [
                f"{path.name}: the faces {face.name!r} and {other.name!r} are one face in two places, which can only take the "
                "same shape; to let them differ name the places in instances"
            ]
    return []


def _solids(part: Part) -> dict[int, int]:
    """Per face the lowest number of those that it hangs together with over common edges."""
    numbers = [face.number for face in part.faces]
    place = {number: k for k, number in enumerate(numbers)}
    edges = [(place[face.number], place[n]) for face in part.faces for edge in face.edges for n in edge.neighbours]
    return {numbers[k]: numbers[group[0]] for group in together(len(numbers), edges) for k in group}


def sculptable(part: Part, face: Face) -> BSplineSurface:
    """The surface (mm) that is sculpted: the face's own. Planes, cylinders and their like, of degree 1 and 2, become splines of
    the CAD kernel anyway: they are raised to SMOOTH_DEGREE first, so that a dent in them is smooth, with far fewer control
    points."""
    if part.format not in ("step", "iges") or face.kind in SPLINES:
        return face.surface
    return elevated(face.surface, SMOOTH_DEGREE, SMOOTH_DEGREE)


def source_face(part: Part, face: Face, units: str) -> SourceFace:
    """A face of a part as the engine takes it, in `units`. Raises InputError naming a face that has no surface."""
    try:
        surface = sculptable(part, face).scaled(conversion("mm", units))
    except CadsculptError as error:
        raise InputError(error.what, where=f"{part.path.name}, face {face.name!r}", mend=error.mend) from None
    if face.warning:
        part.warnings.append(f"face {face.name!r}: {face.warning}")
    stated, doubt = stated_tolerance(part, face)
    if doubt and doubt not in part.warnings:
        part.warnings.append(doubt)
    # a 3DM file states the tolerance of each edge as well; those of other formats' edges are the kernel's
    edges = tuple(
        SourceEdge(
            edge.uv,
            tuple(part.faces.number(n).name for n in edge.neighbours),
            edge.seam,
            edge.degenerate,
            (edge.tolerance if own else stated) * conversion("mm", units),
            not own,
        )
        for edge in face.edges
        for own in [not stated or (part.format == "3dm" and edge.tolerance > stated)]
    )
    return SourceFace(face.number, face.name, surface, edges)


def _tool_faces(
    spec: ToolSpec, scene: SceneFile, part_of: Callable[[str, str | None], tuple[Path, Part]]
) -> list[SourceFace]:
    if spec.file is None:
        raise InputError("a surface tool needs a file", where=f"tool {spec.name!r}", mend='write file = "..."')
    _, part = part_of(spec.file, spec.file_units)
    return [source_face(part, face, scene.units) for face in part.faces.select(spec.faces or "all")]


def _tool_mesh(spec: ToolSpec, file: Path, units: str) -> TriangleMesh:
    found = mesh.read_mesh(file, conversion(spec.file_units or units, units))
    try:
        found.require_closed()
    except GeometryError as error:
        raise GeometryError(error.what, where=f"tool {spec.name!r}: {file}", mend=error.mend) from None
    return found


def _path(scene: SceneFile, name: str) -> ToolPath:
    path = scene.tool_path(name)
    if path is None:
        raise InputError("it has no path", where=f"tool {name!r}", mend="write [[tool.path]] rows or path = FILE")
    return path
