"""Seconds of compilation, cold, of what a user starts first: `python benchmarks/compile.py --json`.

Each entry point runs in a process and a cache folder of its own, one after the other. Counted are CPU seconds inside
numba's compiler, so that a loaded machine changes little; `compilations` are kernels and signatures.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from typing import Any

SLOWEST = 8
"""Kernels named for each entry point."""

ENTRIES = {
    **{f"run, {kind} tool": f"warm_up(scene({kind!r}))" for kind in ("point", "sphere", "surface", "mesh")},
    "beside a run, surface tool": 'warm_beside(["surface"], "explicit")',
    "beside a collision": "warm_collision_beside()",
    "collide, apart": "collide(plate(), (plate(), Pose([0.0, 0.0, 3.0])))",
    "collide, crossing": "collide(plate(), (plate(), Pose.turned([0.0, 5.0, 0.0], [1.0, 0.0, 0.0], 1.0)))",
}
"""What is called for each."""


def compiled(call: str) -> dict[str, Any]:
    """Call one entry point in this process, and tell what was compiled."""
    import numpy as np
    from numba.core import event

    from cadsculpt.collision import collide
    from cadsculpt.motion.pose import Pose
    from cadsculpt.scene import Scene
    from cadsculpt.spline.surface import BSplineSurface
    from cadsculpt.warm import warm_beside, warm_collision_beside, warm_up

    class Events(event.Listener):  # type: ignore[misc]
        """Compilations are nested: one starts where another one needs its type."""

        def __init__(self) -> None:
            self.running: list[list[float]] = []
            self.own: dict[str, float] = defaultdict(float)
            self.count = 0

        def on_start(self, event: Any) -> None:
            self.running.append([time.process_time(), 0.0])

        def on_end(self, event: Any) -> None:
            start, within = self.running.pop()
            seconds = time.process_time() - start
            if self.running:
                self.running[-1][1] += seconds
            function = event.data["dispatcher"].py_func
            self.own[f"{function.__module__}.{function.__name__}"] += seconds - within
            self.count += 1

    def scene(kind: str) -> Scene:
        tool = {"name": kind, "shape": kind, **({"radius": 1.0} if kind == "sphere" else {})}
        if kind in ("surface", "mesh"):
            tool["file"] = "tool"
        model = {"name": "plate", "file": "plate", "thickness": 1.0, "nodes": 1.0, "material": "clay"}
        return Scene.model_validate({"units": "mm", "model": [model], "tool": [tool]})

    def plate() -> BSplineSurface:
        x = np.linspace(0.0, 10.0, 5)
        net = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((5, 5))], axis=-1)
        knots = np.array([0.0, 0, 0, 0, 0.5, 1, 1, 1, 1])
        return BSplineSurface(net, knots, knots, 3, 3)

    names = {
        "scene": scene, "plate": plate, "collide": collide, "Pose": Pose, "warm_up": warm_up,
        "warm_beside": warm_beside, "warm_collision_beside": warm_collision_beside,
    }  # fmt: skip
    events = Events()
    wall = time.perf_counter()
    with event.install_listener("numba:compile", events):
        eval(call, names)
    slowest = sorted(events.own, key=lambda name: -events.own[name])[:SLOWEST]
    return {
        "cpu_s": round(sum(events.own.values()), 2),
        "wall_s": round(time.perf_counter() - wall, 2),
        "compilations": events.count,
        "slowest": {name: round(events.own[name], 2) for name in slowest},
    }


def cold(call: str) -> dict[str, Any]:
    """The same in a new process with an empty cache."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, __file__, "--call", call]
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout, on one line")
    parser.add_argument("--only", choices=ENTRIES, action="append", help="this entry point alone; may be repeated")
    parser.add_argument("--call", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.call:
        print(json.dumps(compiled(chosen.call)))
        return
    results: dict[str, Any] = {"cores": os.cpu_count(), "load": round(os.getloadavg()[0], 2)}
    for name in chosen.only or ENTRIES:
        results[name] = cold(ENTRIES[name])
        print(f"{name}: {results[name]['cpu_s']} s", file=sys.stderr, flush=True)
    print(json.dumps(results, indent=None if chosen.json else 2))


if __name__ == "__main__":
    main()
