"""Pictures of tool definitions: what `cadsculpt tools` lists, each seen obliquely from below, where it works."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..record import Frame
from ..scene import ToolSpec
from ..tools.make import Tool, make_tool
from ..tools.outline import outline
from ..tools.surface import SurfaceTool
from . import mesh, registry
from .atomic import cannot_write
from .frame_mesh import FaceMesh
from .pictures import Picture, draw
from .tool_toml import ToolDefinition

VIEW = (0.7, -1.0, -0.5)
"""From where tools are seen: most of them work downwards."""

ROWS = 121
"""Rows and columns of a surface tool in its picture."""

SIZE = 40.0
"""mm, for a tool without a size of its own: a point, a half-space."""


def draw_tools(
    definitions: Mapping[str, ToolDefinition], folder: str | os.PathLike[str]
) -> tuple[list[Path], list[str]]:
    """One PNG a tool, named as the tool, into a folder that is made. Returns the files, and a warning for each that could not
    be drawn. Raises InputError when the folder cannot be written to."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from error
    made, warnings = [], []
    for name, definition in definitions.items():
        points, triangles = outline(_tool(definition), scene_size=SIZE)
        # without its seams, where vertices of a closed surface stand twice, the tool shades smoothly
        joined, place = np.unique(np.round(points, 9), axis=0, return_inverse=True)
        body = FaceMesh(name, joined, place.reshape(-1)[triangles])
        path = folder / f"{name}.png"
        frame = Frame(0, 0.0, (), ())
        warnings += draw([frame], [Picture(path, view=VIEW, size=(640, 400), title=name)], [body])
        if path.exists():
            made.append(path)
    return made, warnings


def _tool(definition: ToolDefinition) -> Tool:
    """The tool in mm, in its own frame, at rest."""
    keys = definition.keys_in("mm")
    spec = ToolSpec.model_validate(keys)
    if spec.shape == "surface" and spec.file is not None:
        faces = registry.read(Path(spec.file)).faces.select(spec.faces or "all")
        return SurfaceTool.of([face.surface for face in faces], ROWS)
    solid = mesh.read_mesh(Path(spec.file), 1.0) if spec.shape == "mesh" and spec.file is not None else None
    return make_tool(spec, 1.0, 1.0, ROWS, (), solid)
