"""Compile, or load from the cache, every kernel that a scene's run will need: a tiny run with the same kinds of tools."""

from __future__ import annotations

from typing import Any

import numpy as np

from .collide.detect import DetectOptions, PatchGrid, detect
from .collide.mesh import TriangleMesh
from .model import SourceBody, build_model
from .motion.path import ToolPath
from .motion.pose import Pose
from .patch import SourceFace
from .scene import Scene, ShapeSpec
from .session import Session
from .spline.surface import BSplineSurface
from .tools.make import make_tool
from .tools.superquadric import SuperquadricTool


def warm_up(scene: Scene) -> None:
    """Run two steps of a plate of four by four control points under the scene's kinds of tools."""
    kinds = {t.shape if t.shape in ("point", "surface", "mesh") else "sphere" for t in scene.tool}
    tools: list[dict[str, Any]] = [{"name": kind, "shape": kind} for kind in sorted(kinds)]
    for tool in tools:
        if tool["shape"] == "sphere":
            tool["radius"] = 3.0
        if tool["shape"] in ("surface", "mesh"):
            tool["file"] = "plate"
    tiny = Scene.model_validate(
        {
            "units": "mm",
            "model": [{"name": "plate", "file": "plate", "thickness": 2.0, "nodes": 2.0, "material": "clay"}],
            "tool": tools,
            "solver": {
                "resolution": 13,
                "mode": scene.solver.mode,
                "integrator": scene.solver.integrator,
                "step": 1e-4,
            },
        }
    )
    if any("superquadric" in _shapes(tool) for tool in scene.tool):
        SuperquadricTool.of((1.0, 1.0, 1.0), (1.0, 1.0)).field(np.zeros((1, 3)))
    low = {"point": -0.1, "sphere": 2.9, "surface": -0.1, "mesh": -0.1}
    paths = {kind: ToolPath.resting(Pose(np.array([5.0, 5.0, low[kind]]))) for kind in kinds}
    plate = _plate(10.0, 0.0)
    # collision first: a second process may be at work on the lattice's kernels meanwhile
    grid = PatchGrid.of(plate, 13)
    meshes = {"mesh": _tetrahedron(4.0)} if "mesh" in kinds else {}
    for spec in tiny.tool:
        made = make_tool(spec, 2.0, 2.0, 13, [_plate(4.0, 0.2)], meshes.get(spec.name))
        detect([grid], [plate.control_points], [made.placed(paths[spec.name].pose(0.0))], DetectOptions())
    body = SourceBody("plate", (SourceFace(1, "plate", plate),))
    session = Session(build_model(tiny, [body], paths, {"surface": [_plate(4.0, 0.2)]}, meshes))
    for _ in range(2):
        session.step()
    session.refit_error(0)


def _shapes(spec: ShapeSpec) -> set[str]:
    """The shapes of a tool and of its parts."""
    return {spec.shape}.union(*(_shapes(part) for part in spec.part or ()))


def warm_physics() -> None:
    """The lattice's kernels alone: for a second process, beside one that compiles the rest."""
    from .physics.explicit import ContactLoad, LatticeState, advance
    from .physics.forces import contact_damping, contact_stiffness, node_weights
    from .physics.lattice import build_lattice
    from .physics.material import PRESETS
    from .physics.measures import nodal_stress

    u = np.linspace(0.0, 1.0, 4)
    plate = _plate(10.0, 0.0)
    clay = PRESETS["clay"]
    lattice = build_lattice(
        plate.evaluate(u[:, None], u), -plate.normal(u[:, None], u), u, u,
        thickness=2.0, layers=2, material=[clay, clay], metres_per_unit=1e-3,
    )  # fmt: skip
    state = LatticeState.at_rest(lattice)
    stiffness = contact_stiffness(clay, 2.0, 2.0, 1e-3)
    nodes, weights = node_weights(lattice, [0.5], [0.5])
    one = np.ones(1)
    load = ContactLoad(
        nodes, weights, np.array([[0.0, 0.0, 1.0]]), 0.1 * one, one, np.zeros((1, 3)),
        stiffness * one, contact_damping(clay, stiffness, lattice) * one, 0.4 * one,
    )  # fmt: skip
    advance(lattice, state, load, 1e-4)
    nodal_stress(lattice, state)


def _plate(size: float, dome: float) -> BSplineSurface:
    x = np.linspace(0.0, size, 5)
    X, Y = np.meshgrid(x, x, indexing="ij")
    Z = dome * ((X / size - 0.5) ** 2 + (Y / size - 0.5) ** 2)
    knots = np.array([0.0, 0, 0, 0, 0.5, 1, 1, 1, 1])
    shift = np.array([0.0, 0.0, 0.0]) if dome == 0.0 else np.array([-0.5 * size, -0.5 * size, 0.0])
    return BSplineSurface(np.stack([X, Y, Z], axis=-1) + shift, knots, knots, 3, 3, outward=dome == 0.0)


def _tetrahedron(size: float) -> TriangleMesh:
    corners = size * np.array([[0.0, 0, 0], [-1, 0, 2], [1, -1, 2], [1, 1, 2]])
    return TriangleMesh.of(corners, [[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]])
