"""Compile, or load from the cache, every kernel that a scene's run will need: a tiny run with the same kinds of tools.

Two processes share the work through the cache: `warm_up` compiles collision, `warm_beside` the lattice and continuous
collision. Each comes to what the other compiles when that is done.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .collide.detect import DetectOptions, PatchGrid, detect
from .collide.mesh.triangle_mesh import TriangleMesh
from .model import SourceBody, build_model
from .motion.motion import Motion
from .motion.path import ToolPath
from .motion.pose import Pose
from .patch import SourceFace
from .scene import Scene, ShapeSpec
from .session import Session
from .spline.surface import BSplineSurface
from .tools.make import make_tool
from .tools.superquadric import SuperquadricTool

Array = NDArray[np.float64]
LOW = {"point": -0.1, "sphere": 2.9, "surface": -0.1, "mesh": -0.1}
"""Heights at which the tools of each kind touch the plate."""


def kinds_of(scene: Scene) -> list[str]:
    """The kinds of tools, for which there are different kernels, that a scene has."""
    kinds = {tool.shape if tool.shape in LOW else "sphere" for tool in scene.tool}
    return sorted(kinds | {"surface"} if len(scene.model) > 1 else kinds)


def warm_up(scene: Scene, beside: Callable[[], object] = lambda: None) -> None:
    """Run two steps of a plate of four by four control points under the scene's kinds of tools.

    beside : waits for the process in which `warm_beside` runs, if there is one.
    """
    if any("superquadric" in _shapes(tool) for tool in scene.tool):
        SuperquadricTool.of((1.0, 1.0, 1.0), (1.0, 1.0)).field(np.zeros((1, 3)))
    kinds = kinds_of(scene)
    plate = _plate(10.0, 0.0)
    grid = PatchGrid.of(plate, 13)
    for spec in _tiny(kinds).tool:
        made = make_tool(spec, 2.0, 2.0, 13, [_plate(4.0, 0.2)], _tetrahedron(4.0) if spec.shape == "mesh" else None)
        low = Pose(np.array([5.0, 5.0, LOW[spec.shape]]))
        detect([grid], [plate.control_points], [made.placed(low)], DetectOptions())
    beside()
    session = _session(kinds, scene.solver.mode, scene.solver.integrator)
    for _ in range(2):
        session.step()
    session.refit_error(0)


def warm_beside(kinds: Sequence[str], integrator: str) -> None:
    """The kernels of the lattice and of continuous collision with the kinds of tools: for a second process."""
    _warm_lattice(integrator)
    session = _session(kinds, "certified", integrator)
    nets = session.state.control_points
    above = [Pose(pose.at + np.array([0.0, 0.0, 1.0]), pose.rotation) for pose in session.state.poses]
    motions = [Motion.between(a, b) for a, b in zip(above, session.state.poses, strict=True)]
    for body in range(1, len(session.model.bodies)):
        session.lookahead.meeting(nets, motions, 0, body)


def warm_collision_beside() -> None:
    """What two B-spline bodies need late or only where they meet: for a second process, beside one that collides them."""
    from .collide.certified.nearest_pair import nearest_pair
    from .collide.workspace import Spans

    u, rows, tally = np.array([0.0, 1.0]), np.zeros((1, 2), np.int64), np.ones((1, 2), np.int64)
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    net = np.ones((2, 2, 4))
    net[1, :, 0], net[:, 1, 1] = 2.0, 2.0
    first = np.zeros(2, np.int64)
    square = Spans(net, knots, knots, 1, 1, False, False, False, u, u, first, first, rows, rows, tally, 1e-15)
    free = np.full((2, 2), np.nan)
    nearest_pair(square, square, np.full(4, 0.5), free, free, np.empty((4, 3)))
    plate = _plate(10.0, 0.0)
    grid = PatchGrid.of(plate, 13)
    tool = make_tool(_tiny(["surface"]).tool[0], 2.0, 2.0, 13, [_plate(4.0, 0.2)])
    low = Pose(np.array([5.0, 5.0, LOW["surface"]]))
    detect([grid], [plate.control_points], [tool.placed(low)], DetectOptions())


def _tiny(kinds: Sequence[str], mode: str = "certified", integrator: str = "explicit") -> Scene:
    """A scene with one tool of each kind."""
    tools: list[dict[str, Any]] = [{"name": kind, "shape": kind} for kind in kinds]
    for tool in tools:
        if tool["shape"] == "sphere":
            tool["radius"] = 3.0
        if tool["shape"] in ("surface", "mesh"):
            tool["file"] = "plate"
    return Scene.model_validate(
        {
            "units": "mm",
            "model": [{"name": "plate", "file": "plate", "thickness": 2.0, "nodes": 2.0, "material": "clay"}],
            "tool": tools,
            "solver": {"resolution": 13, "mode": mode, "integrator": integrator, "step": 1e-4},
        }
    )


def _session(kinds: Sequence[str], mode: str, integrator: str) -> Session:
    """The tiny scene's session, its tools in touch with the plate."""
    paths = {kind: ToolPath.resting(Pose(np.array([5.0, 5.0, LOW[kind]]))) for kind in kinds}
    meshes = {"mesh": _tetrahedron(4.0)} if "mesh" in kinds else {}
    body = SourceBody("plate", (SourceFace(1, "plate", _plate(10.0, 0.0)),))
    return Session(build_model(_tiny(kinds, mode, integrator), [body], paths, {"surface": [_plate(4.0, 0.2)]}, meshes))


def _shapes(spec: ShapeSpec) -> set[str]:
    """The shapes of a tool and of its parts."""
    return {spec.shape}.union(*(_shapes(part) for part in spec.part or ()))


def _warm_lattice(integrator: str) -> None:
    """The lattice's kernels alone, so that nothing is compiled twice that the other process begins with."""
    from .physics.explicit import ContactLoad, LatticeState, advance
    from .physics.forces import contact_damping, contact_stiffness, node_weights
    from .physics.implicit import advance_implicit
    from .physics.lattice import build_lattice
    from .physics.material import PRESETS
    from .physics.measures import nodal_stress

    u = np.linspace(0.0, 1.0, 4)
    plane = 10.0 * np.stack([*np.meshgrid(u, u, indexing="ij"), np.zeros((4, 4))], axis=-1)
    clay = PRESETS["clay"]
    lattice = build_lattice(
        plane, np.broadcast_to([0.0, 0.0, -1.0], plane.shape), u, u,
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
    if integrator == "explicit":
        advance(lattice, state, load, 1e-4)
    else:
        advance_implicit(lattice, state, load, 1e-4)
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
