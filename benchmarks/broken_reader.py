"""Reads files that may be broken, one after the other, and tells what came of each: the process that may die of it.

One JSON object a line comes in, {"path": ..., "deep": ...}, one goes out. What libraries print goes to stderr.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import sys
import traceback
from pathlib import Path
from typing import Any

import numpy as np

from cadsculpt.errors import CadsculptError
from cadsculpt.formats import registry, tool_toml
from cadsculpt.formats.inspect import inspect_object
from cadsculpt.formats.mesh import TRIANGLE_FORMATS, read_mesh
from cadsculpt.formats.paths import path_file
from cadsculpt.formats.scene_toml import SceneFile
from cadsculpt.scene_tool import PathOptions
from cadsculpt.spline.surface import BSplineSurface


def outcome(path: Path, deep: bool) -> dict[str, Any]:
    """What reading a file gives: `read` with a digest, the number of things and the warnings, `error` or `internal`."""
    try:
        digest, count, warnings = content(path, deep)
    except CadsculptError as error:
        return {"outcome": "error", "message": str(error)}
    except Exception:
        return {"outcome": "internal", "message": traceback.format_exc()}
    return {"outcome": "read", "digest": digest, "count": count, "warnings": list(warnings)}


def content(path: Path, deep: bool) -> tuple[str, int, list[str]]:
    """A digest of what a file holds, how many surfaces, triangles or moves those are, and the reader's warnings."""
    digest = hashlib.sha256()
    if path.suffix.lower() in TRIANGLE_FORMATS:
        mesh = read_mesh(path)
        digest.update(mesh.vertices.tobytes() + mesh.triangles.tobytes())
        warnings = [*mesh.warnings, *([mesh.fault] if mesh.fault else [])]
        return digest.hexdigest(), len(mesh.triangles), warnings
    if path.suffix.lower() in path_file.SUFFIXES:
        kinematics = re.search(r"xyz(ac|bc)", path.name)
        read = path_file.read(
            path,
            "mm",
            PathOptions(kinematics=f"xyz{kinematics[1]}-trt") if kinematics else None,  # type: ignore[arg-type]
        )
        digest.update(read.path.t.tobytes() + read.path.at.tobytes() + read.path.rotation.tobytes())
        return digest.hexdigest(), len(read.path.t), list(read.warnings)
    if path.suffix.lower() == ".toml":
        return scene_content(path)
    part = registry.read(path)
    found = inspect_object(part)["warnings"] if deep else part.warnings
    unread = 0
    for face in part.faces:
        try:
            surface = face.surface
        except CadsculptError as error:
            unread += 1
            found = [*found, str(error)]
            continue
        for array in (surface.control_points, surface.knots_u, surface.knots_v, surface.weights):
            if array is not None:
                digest.update(np.ascontiguousarray(array).tobytes())
        for loop in surface.trims or ():
            for curve in loop.curves:
                digest.update(curve.control_points.tobytes() + curve.knots.tobytes())
    return digest.hexdigest(), len(part.faces) - unread, list(dict.fromkeys([*found, *part.warnings]))


def scene_content(path: Path) -> tuple[str, int, list[str]]:
    """The same of a scene, or of a tool's definition: the number of its tables or keys."""
    if path.name.endswith(tool_toml.SUFFIX):
        tool = tool_toml.read(path)
        return repr((tool.name, tool.units, tool.description, tool.keys)), len(tool.keys), list(tool.file.warnings)
    scene = SceneFile.load(path)
    return scene.model_dump_json(), len(scene.model) + len(scene.tool), list(scene.warnings)


def warm_up() -> None:
    """Compile what reading may need before the clock runs."""
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    flat = BSplineSurface(np.array([[[x, y, 0.0] for y in (0.0, 1.0)] for x in (0.0, 1.0)]), knots, knots, 1, 1)
    flat.derivatives(0.5, 0.5, 2)


def main() -> None:
    warm_up()
    if "--fork" in sys.argv:
        from broken_fork import fork_from_now_on

        fork_from_now_on()
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        asked = json.loads(line)
        print(json.dumps(outcome(Path(asked["path"]), asked["deep"])), file=answers, flush=True)


if __name__ == "__main__":
    main()
