"""One step of `Session.step` in an outside loop: `python benchmarks/step.py --json`.

A plate of clay of 72.5 x 72.5 x 6 mm on a held base, its lattice of 30 x 30 x 3 nodes, goes through 1 ms a step under a tool
that the loop moves: it comes down, and then wanders over the middle of the plate at about 25 mm/s while it presses ever
deeper, so that it ploughs fresh clay at each pass and is in contact at every measured step. Each step is whole: collision,
contacts, forces, the lattice's sub-steps, refit. Two tools: a sphere of 8 mm (an implicit surface) and a thumb (a bicubic
B-spline surface, rigid).

`median_ms`, `p99_ms` : of the whole step, by the wall clock, after a warm-up. `share` : each phase's part of all time;
`rest` is what `Session.step` does beside its phases. `contacts` : least, median and most of a step. `substeps` : of the
lattice. `array_bytes` : the most array data that a warm step held at once beyond what was there before it (`step_memory`);
`object_bytes` : the same of all Python objects. One thread.

The collision grid has four cells for each spacing of the lattice's nodes; --resolution takes any other.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import os
import platform
import sys
from collections.abc import Callable
from time import perf_counter, process_time
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"  # before numpy comes in

import numpy as np
from step_memory import array_bytes, object_bytes

from cadsculpt.model import Model, SourceBody, build_model
from cadsculpt.motion.path import ToolPath
from cadsculpt.motion.pose import Pose
from cadsculpt.patch import SourceFace
from cadsculpt.scene import Scene
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface

SIDE, THICKNESS, NODES, LAYERS = 72.5, 6.0, 30, 2
RADIUS = 8.0
STEP = 1e-3
TOOLS = ("sphere", "surface")


def uniform(count: int, length: float) -> np.ndarray:
    """Clamped cubic knots on [0, length] for so many control points."""
    return np.concatenate([np.zeros(3), np.linspace(0.0, length, count - 2), np.full(3, length)])


def greville(knots: np.ndarray) -> np.ndarray:
    return np.array([knots[i + 1 : i + 4].mean() for i in range(len(knots) - 4)])


def plate() -> BSplineSurface:
    knots = uniform(4, SIDE)
    x = greville(knots)
    return BSplineSurface(np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((4, 4))], -1), knots, knots, 3, 3)


def thumb() -> BSplineSurface:
    """The pad of a thumb, 24 mm long and 15 mm wide, its lowest point at the origin; normals point down and out."""
    along, around = uniform(8, 24.0), uniform(9, 1.0)
    s = greville(along) / 24.0
    angle = np.radians(110.0) * (2.0 * greville(around) - 1.0)
    radius = 7.5 * (1.0 - 0.4 * np.abs(2.0 * s - 1.0) ** 2.5)
    lift = 6.0 * np.abs(2.0 * s - 1.0) ** 2
    x = np.broadcast_to((24.0 * s - 12.0)[:, None], (8, 9))
    y = radius[:, None] * np.sin(angle)
    z = (7.5 + lift)[:, None] - radius[:, None] * np.cos(angle)
    net = np.stack([x, y, z], axis=-1)
    lowest = BSplineSurface(net, along, around, 3, 3).evaluate(np.linspace(0, 24, 97)[:, None], 0.5)[..., 2].min()
    net = net - [0.0, 0.0, lowest]
    return BSplineSurface(net, along, around, 3, 3, name="thumb", outward=False)


def stroke(tool: str, t: float, duration: float) -> Pose:
    """Where the tool is at t [s]: down within 0.1 s, then a figure that fills a square of 24 x 24 mm, 1 to 3 mm deep."""
    run = max(0.0, t - 0.1)
    x = 0.5 * SIDE + 12.0 * np.sin(1.31 * run)
    y = 0.5 * SIDE + 12.0 * np.sin(2.0 * 0.83 * run + 0.3)
    depth = -0.5 + 1.5 * min(t / 0.1, 1.0) + 2.0 * run / duration
    if tool == "sphere":
        return Pose(np.array([x, y, RADIUS - depth]))
    return Pose.turned([x, y, -depth], (0.0, 0.0, 1.0), 20.0 * np.sin(0.7 * run))


def plate_and(tool: str, resolution: int, duration: float) -> Model:
    times = np.linspace(0.0, duration, 401)
    rows = [{"t": float(t), "at": stroke(tool, float(t), duration).at.tolist()} for t in times]
    shape: dict[str, Any] = {"shape": "sphere", "radius": RADIUS} if tool == "sphere" else {"shape": "surface"}
    if tool == "surface":
        shape["file"] = "thumb"
    scene = Scene.model_validate(
        {
            "units": "mm",
            "model": [
                {
                    "name": "plate",
                    "file": "plate",
                    "thickness": THICKNESS,
                    "nodes": [NODES, NODES],
                    "layers": LAYERS,
                    "material": "clay",
                }
            ],
            "tool": [{"name": "tool", "path": rows} | shape],
            "solver": {"resolution": resolution, "step": STEP},
        }
    )
    paths = {"tool": ToolPath.of_rows(scene.tool[0].path)}  # type: ignore[arg-type]
    surfaces = {"tool": [thumb()]} if tool == "surface" else None
    return build_model(scene, [SourceBody("plate", (SourceFace(1, "plate", plate()),))], paths, surfaces)


def measure(tool: str, steps: int, resolution: int, clock: Callable[[], float]) -> dict[str, object]:
    """One tool: the step's time and its phases, contacts and memory."""
    warm = 200
    duration = STEP * (warm + steps)
    model = plate_and(tool, resolution, duration)
    session = Session(model, clock)
    poses = [stroke(tool, STEP * (k + 1), duration) for k in range(warm + steps)]
    total, counts = np.zeros(steps), np.zeros(steps, np.int64)
    gc.collect()
    gc.freeze()
    for k, pose in enumerate(poses):
        start = clock()
        session.step({"tool": pose}, STEP)
        if k >= warm:
            total[k - warm] = clock() - start
            counts[k - warm] = len(session.contacts)
    phases = {name: np.array(seconds[warm:]) for name, seconds in session.timing.items()}
    phases["rest"] = total - sum(phases.values())
    more = iter([Pose(pose.at + [0.01 * k, 0.0, 0.0], pose.rotation) for k in range(1, 12)])

    def step() -> None:
        session.step({"tool": next(more)}, STEP)

    return {
        "tool": tool,
        "steps": steps,
        "median_ms": round(float(np.median(total)) * 1e3, 4),
        "p99_ms": round(float(np.quantile(total, 0.99)) * 1e3, 4),
        "worst_ms": round(float(total.max()) * 1e3, 4),
        "phase_median_ms": {name: round(float(np.median(t)) * 1e3, 4) for name, t in phases.items()},
        "share": {name: round(float(t.sum() / total.sum()), 4) for name, t in phases.items()},
        "contacts": [int(counts.min()), int(np.median(counts)), int(counts.max())],
        "steps_in_contact": int((counts > 0).sum()),
        "array_bytes": max(array_bytes(step) for _ in range(3)),
        "object_bytes": max(object_bytes(step) for _ in range(2)),
        "substeps": math.ceil(STEP / model.patches[0].substep),
        "nodes": list(model.patches[0].lattice.shape),
        "control_points": list(model.patches[0].surface.shape),
        "resolution": list(model.patches[0].grid.shape),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="One step of an outside loop, timed.")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout, on one line")
    parser.add_argument("--steps", type=int, default=10_000, help="measured steps of each tool (default 10000)")
    parser.add_argument("--resolution", type=int, default=4 * (NODES - 1) + 1, help="of the collision grids")
    parser.add_argument("--tool", choices=TOOLS, action="append", help="this tool alone")
    parser.add_argument("--clock", choices=("wall", "cpu"), default="wall", help="cpu: on a machine with other work")
    options = parser.parse_args()
    clock = process_time if options.clock == "cpu" else perf_counter
    result = {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "threads": 1,
        "clock": options.clock,
    }
    for tool in options.tool or TOOLS:
        print(f"{tool} ...", file=sys.stderr, flush=True)
        result[tool] = measure(tool, options.steps, options.resolution, clock)
    print(json.dumps(result, indent=None if options.json else 1))


if __name__ == "__main__":
    main()
