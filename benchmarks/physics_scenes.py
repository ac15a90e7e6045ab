"""Truths of whole scenes: force and resolution, explicit and implicit, what penetration is left, what a step allocates."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from step_memory import array_bytes, object_bytes

from cadsculpt.formats.scene_toml import SceneFile
from cadsculpt.model import Model, SourceBody, build_model
from cadsculpt.motion.path import ToolPath
from cadsculpt.motion.pose import Pose
from cadsculpt.patch import SourceFace
from cadsculpt.run import RunResult, run
from cadsculpt.scene import Scene
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface

EXAMPLES = Path(__file__).parents[1] / "examples"


def pressed_plate(
    size: float = 40.0, nodes: float = 2.0, layers: int = 2, material: str = "clay", slower: float = 1.0, **solver: Any
) -> Model:
    """A flat plate, 6 mm of clay on a held base; a ball of 8 mm presses 1.5 mm into its middle and lifts off again.

    At 67 mm/s; slower : this many times, in as many steps.
    """
    knots = np.concatenate([np.zeros(4), [size / 3, 2 * size / 3], np.full(4, size)])
    x = np.array([knots[i + 1 : i + 4].mean() for i in range(6)])
    net = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((6, 6))], axis=-1)
    middle = size / 2
    path = [(slower * t, z) for t, z in ((0.0, 8.5), (0.03, 6.5), (0.05, 9.0), (0.08, 9.0))]
    scene = Scene.model_validate(
        {
            "units": "mm",
            "model": [
                {
                    "name": "plate",
                    "file": "plate",
                    "thickness": 6.0,
                    "nodes": nodes,
                    "layers": layers,
                    "material": material,
                }
            ],
            "tool": [
                {
                    "name": "ball",
                    "shape": "sphere",
                    "radius": 8.0,
                    "path": [{"t": t, "at": [middle, middle, z]} for t, z in path],
                }
            ],
            "solver": {"resolution": 61, "step": slower * 1e-3, "max_penetration": 0.2} | solver,
            "refit": {"tolerance": 0.05},
        }
    )
    surface = BSplineSurface(net, knots, knots, 3, 3, name="plate")
    paths = {tool.name: ToolPath.of_rows(tool.path) for tool in scene.tool}  # type: ignore[arg-type]
    return build_model(scene, [SourceBody("plate", (SourceFace(1, "plate", surface),))], paths)


def dent(result: RunResult) -> np.ndarray:
    """How far the surface nodes have moved (nu, nv, 3) [mm]. Raises RuntimeError for a run that came to no end."""
    if not result.converged:
        raise RuntimeError(result.failure)
    return result.session.displacement(0)


def resolution_truth(resolutions: tuple[int, ...] = (61, 121, 241, 481), **plate: Any) -> dict[str, object]:
    """force_resolution_change: of the ball's force in the deepest steps, for each doubling of the collision resolution."""
    forces = []
    for resolution in resolutions:
        session = Session(pressed_plate(integrator="implicit", resolution=resolution, **plate))
        force = []
        for step in range(30):
            reaction = session.step()["ball"]
            if step >= 25:
                force.append(reaction.force[2])
        forces.append(float(np.mean(force)))
    return {"force_resolution_change": [abs(b / a - 1.0) for a, b in zip(forces[:-1], forces[1:], strict=True)]}


def shape_truth(**plate: Any) -> dict[str, object]:
    """explicit_vs_implicit_final_shape: the largest distance between their nodes after the press, over the dent's depth.

    Pressed at 17 mm/s. ..._fast : at 67 mm/s, where the explicit rule's waves, which long steps do not follow, leave their
    mark in the clay. ..._quasi_static : the quasi-static limit, at 17 mm/s.
    """
    result: dict[str, object] = {}
    explicit = {slower: dent(run(pressed_plate(slower=slower, **plate))) for slower in (4.0, 1.0)}
    for name, slower, options in (("", 4.0, {}), ("_fast", 1.0, {}), ("_quasi_static", 4.0, {"quasi_static": True})):
        other = dent(run(pressed_plate(slower=slower, integrator="implicit", **options, **plate)))
        apart = np.linalg.norm(other - explicit[slower], axis=2).max()
        result[f"explicit_vs_implicit_final_shape{name}"] = float(
            apart / np.linalg.norm(explicit[slower], axis=2).max()
        )
    return result


def penetration_truth() -> dict[str, object]:
    """residual_penetration: of every example, over its scene's limit, and whether all stay within it."""
    shares = {}
    for path in sorted(EXAMPLES.glob("*/scene.toml")):
        print(f"  {path.parent.name} ...", file=sys.stderr, flush=True)
        result = run(SceneFile.load(path))
        if not result.converged:
            raise RuntimeError(f"{path.parent.name}: {result.failure}")
        limit = result.session.model.scene.solver.max_penetration
        shares[path.parent.name] = float(result.summary.max_penetration / limit)
    return {"residual_penetration": shares, "residual_penetration_held": max(shares.values()) <= 1.0}


def allocation_truth(warm: int = 30, steps: int = 3, **plate: Any) -> dict[str, object]:
    """zero_allocation: in a warm explicit step of an outside loop, the tool in contact and moving, at no time is any byte of
    array data alive that was not there before the step (peak array bytes == 0). Views and small Python objects have no array
    data; how much they are at once is told beside: object_bytes.

    Seen through numpy's domain of tracemalloc, between every two instructions of Python's in the step. Numba's allocator is
    not in it: that the kernels on the way work in room they are given is what tests/test_step_workspace.py shows.
    """
    model = pressed_plate(**plate)
    session, path = Session(model), model.tools[0].path
    poses = [path.pose(model.step * (k + 1)) for k in range(warm)]
    # then to and fro, still pressing, until the control points that move are ones that have moved together before: a refit of
    # others has to be prepared first
    poses += [Pose(poses[-1].at + [0.1 * np.sin(k * np.pi / 3.0), 0.0, -0.05]) for k in range(1, warm + 4 * steps + 1)]
    ahead = iter(poses)

    touching = []

    def step() -> None:
        session.step({"ball": next(ahead)}, model.step)
        touching.append(len(session.contacts) > 0)

    for _ in range(2 * warm):
        step()
    touching.clear()
    arrays = max(array_bytes(step) for _ in range(steps))
    objects = max(object_bytes(step) for _ in range(steps))
    return {
        "zero_allocation": arrays == 0 and all(touching),
        "array_bytes": arrays,
        "object_bytes": objects,
    }
