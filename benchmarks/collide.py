"""A deforming patch against a rigid tool, step by step: cadsculpt beside mesh engines, on the same triangles.

A bicubic patch over 10 x 10 control points, bent another way at each step, and a rigid bicubic dome of 4,096 triangles
that lies in it over two percent of its area; both turned, so that nothing lies along an axis, and the patch sheared, so that
the shorter diagonal of a cell, on which cadsculpt cuts it, stays the same one and all engines have one mesh. Each step
every engine takes in the new shape and finds all pairs of triangles that meet. Engines take turns within a step, in one
process, on one thread, after a warm-up. What each is given free:

- mesh engines (coal, fcl, Warp): the evaluated vertices (`evaluate_ms`), which cadsculpt makes for itself;
- coal: filling its vector of vertices from Python (`coal_fill_ms`); `coal_ms` is refit and collide alone;
- fcl: python-fcl has no update of vertices, so it builds its tree again.

Pairs are compared at every step with the exact ones of CGAL (through libigl). `contacts_ms` is cadsculpt's whole
detection at the same step, contact points on the true surfaces included. An engine that is not installed is left out
with a warning, and null stands in its place: `pip install cadsculpt[bench]`.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import platform
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from importlib import import_module
from time import perf_counter, process_time
from types import ModuleType
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"  # before numpy comes in

import numpy as np
from numpy.typing import NDArray

from cadsculpt.collide.crossing import crossings
from cadsculpt.collide.detect import DetectCache, DetectOptions, SurfaceTool, detect
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.collide.triangulate import whole_mesh
from cadsculpt.spline.surface import BSplineSurface

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Pairs = set[tuple[int, int]]

CELLS = (64, 128, 256)
SPANS = np.array([9, 9, 9, 10, 9, 9, 9])
"""Seven knot spans, so long that 64, 128 and 256 cells fall on them evenly."""
TURN = np.array([[0.48, -0.64, 0.60], [0.80, 0.60, 0.0], [-0.36, 0.48, 0.80]])
SHEAR = 0.1
DEPTH = 0.0128
WARM_UP = 3

clock: Callable[[], float] = perf_counter
"""The timer in use: wall time, or with `--clock cpu` this process's own, for a machine that others use as well."""


def patch() -> BSplineSurface:
    """The flat sheet of 10 x 10 control points and of area 1, before it is bent and turned."""
    knots = np.concatenate([np.zeros(4), np.cumsum(SPANS)[:-1] / SPANS.sum(), np.ones(4)])
    at = np.array([knots[i + 1 : i + 4].mean() for i in range(10)])
    x, y = np.meshgrid(at, at, indexing="ij")
    return BSplineSurface(np.stack([x + SHEAR * (y - 0.5), y, np.zeros_like(x)], axis=-1), knots, knots, 3, 3)


def bent(sheet: BSplineSurface, steps: int) -> list[Array]:
    """Another smooth bending for each step, about a hundredth of the sheet's length."""
    rng = np.random.default_rng(20)
    x, y = sheet.control_points[..., 0], sheet.control_points[..., 1]
    nets = []
    for _ in range(steps):
        (f, g), (a, b) = rng.uniform(2.0, 6.0, 2), rng.uniform(0.0, 6.0, 2)
        height = 0.01 * (np.sin(f * x + a) * np.cos(g * y + b) - np.sin(0.52 * f + a) * np.cos(0.47 * g + b))
        net = np.stack([x, y, height], axis=-1) @ TURN.T
        net.flags.writeable = False
        nets.append(net)
    return nets


def dome() -> BSplineSurface:
    """z = 2 (x^2 + y^2) over [-0.2, 0.2]^2, exactly: a fingertip of radius 0.25, sunk into the sheet."""
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, 5), np.ones(3)])
    t = 0.4 * (knots - 0.5)
    inner = [t[i + 1 : i + 4] for i in range(7)]
    first = np.array([k.mean() for k in inner])
    square = np.array([(k[0] * k[1] + k[0] * k[2] + k[1] * k[2]) / 3 for k in inner])
    x, y = np.meshgrid(first, first, indexing="ij")
    net = np.stack([x + 0.52, y + 0.47, 2.0 * (square[:, None] + square[None, :]) - DEPTH], axis=-1)
    return BSplineSurface(net @ TURN.T, knots, knots, 3, 3, outward=False)


@dataclass
class Mesh:
    """Triangles (t, 3) over vertices (n, 3)."""

    points: Array
    triangles: Index


@dataclass
class Answer:
    """Seconds of update and collision, seconds set apart, and how to read the pairs (patch's, tool's triangle)."""

    seconds: float
    apart: float
    pairs: Callable[[], Pairs]


Engine = Callable[[Array, Array], Answer]
"""Takes the patch's net and its evaluated vertices."""


def cadsculpt_engine(grid: PatchGrid, tool: SurfaceTool, mesh: Mesh, tool_mesh: Mesh) -> Engine:
    """The window of the two surfaces alone; vertices are made where the tool is."""
    cache = DetectCache()
    places = [
        {tuple(sorted(t)): k for k, t in enumerate(m.triangles.tolist())} for m in (mesh, tool_mesh)
    ]  # fmt: skip

    def step(net: Array, points: Array) -> Answer:
        start = clock()
        found = crossings(SurfaceTool((grid,), (net,)), tool, cache)
        seconds = clock() - start

        def pairs() -> Pairs:
            sides = (found.model_triangle.tolist(), found.tool_triangle.tolist())
            return {(places[0][tuple(sorted(s))], places[1][tuple(sorted(t))]) for s, t in zip(*sides, strict=True)}

        return Answer(seconds, 0.0, pairs)

    return step


def coal_engine(coal: ModuleType, mesh: Mesh, tool: Mesh) -> Engine:
    """Boxes along the triangles (OBB), refitted bottom up; double precision."""

    def vector(points: Array) -> Any:
        v = coal.StdVec_Vec3s()
        v.extend(list(points))
        return v

    def model(m: Mesh) -> Any:
        tree = coal.BVHModelOBB()
        tree.beginModel(len(m.triangles), len(m.points))
        faces = coal.StdVec_Triangle()
        faces.extend([coal.Triangle(*t) for t in m.triangles.tolist()])
        tree.addSubModel(vector(m.points), faces)
        tree.endModel()
        tree.computeLocalAABB()
        return tree

    mine, its, here = model(mesh), model(tool), coal.Transform3s()
    request = coal.CollisionRequest()
    request.num_max_contacts = 10**6

    def step(net: Array, points: Array) -> Answer:
        start = clock()
        v = vector(points)
        filled = clock()
        mine.beginReplaceModel()
        mine.replaceSubModel(v)
        mine.endReplaceModel(True, True)
        mine.computeLocalAABB()
        result = coal.CollisionResult()
        coal.collide(mine, here, its, here, request, result)
        end = clock()
        return Answer(end - filled, filled - start, lambda: {(c.b1, c.b2) for c in result.getContacts()})

    return step


def fcl_engine(fcl: ModuleType, mesh: Mesh, tool: Mesh) -> Engine:
    """A tree built anew at each step."""

    def model(points: Array, triangles: Index) -> Any:
        tree = fcl.BVHModel()
        tree.beginModel(len(triangles), len(points))
        tree.addSubModel(points, triangles)
        tree.endModel()
        return tree

    still = fcl.Transform()
    its = fcl.CollisionObject(model(tool.points, tool.triangles), still)

    def step(net: Array, points: Array) -> Answer:
        start = clock()
        mine = fcl.CollisionObject(model(points, mesh.triangles), still)
        result = fcl.CollisionResult()
        fcl.collide(mine, its, fcl.CollisionRequest(num_max_contacts=10**6, enable_contact=True), result)
        end = clock()
        return Answer(end - start, 0.0, lambda: {(c.b1, c.b2) for c in result.contacts})

    return step


def warp_engine(wp: ModuleType, mesh: Mesh, tool: Mesh) -> Engine:
    """A tree of boxes refitted on the CPU, each of the tool's triangles asked against it; single precision."""
    wp.init()
    from warp_pairs import meeting

    points = wp.array(mesh.points.astype(np.float32), dtype=wp.vec3, device="cpu")
    shape = wp.Mesh(points, wp.array(mesh.triangles.astype(np.int32).ravel(), dtype=wp.int32, device="cpu"))
    corners = wp.array(tool.points.astype(np.float32), dtype=wp.vec3, device="cpu")
    faces = wp.array(tool.triangles.astype(np.int32), dtype=wp.int32, device="cpu")
    out = wp.zeros((100_000, 2), dtype=wp.int32, device="cpu")
    count = wp.zeros(1, dtype=wp.int32, device="cpu")

    def step(net: Array, vertices: Array) -> Answer:
        start = clock()
        points.assign(vertices.astype(np.float32))
        shape.refit()
        count.zero_()
        wp.launch(meeting, dim=len(tool.triangles), inputs=[shape.id, corners, faces, count, out], device="cpu")
        found = int(count.numpy()[0])
        end = clock()
        return Answer(end - start, 0.0, lambda: {(int(s), int(t)) for s, t in out.numpy()[:found]})

    return step


def exact_pairs(cgal: ModuleType, mesh: Mesh, tool: Mesh) -> Pairs:
    """All pairs of triangles that meet, in exact arithmetic."""
    found = cgal.intersect_other(mesh.points, mesh.triangles, tool.points, tool.triangles, detect_only=True)[0]
    return {(int(s), int(t)) for s, t in found}


def installed(module: str, package: str) -> ModuleType | None:
    """A rival, or None with a line that says so."""
    try:
        return import_module(module)
    except ImportError as error:
        print(f"NOT MEASURED: {package} is not installed ({error})", file=sys.stderr)
        return None


def measure(cells: int, steps: int, rivals: dict[str, ModuleType | None]) -> dict[str, Any]:
    """One size of patch: medians and 95th percentiles in milliseconds, pairs and how they compare."""
    sheet, tip = patch(), dome()
    grid, tip_grid = PatchGrid.of(sheet, cells + 1), PatchGrid.of(tip, (65, 33))
    tool = SurfaceTool((tip_grid,), (tip.control_points,))
    nets = bent(sheet, WARM_UP + steps)
    mesh, tool_mesh = Mesh(*whole_mesh(grid, nets[0])), Mesh(*whole_mesh(tip_grid, tip.control_points))
    engines = {"cadsculpt": cadsculpt_engine(grid, tool, mesh, tool_mesh)}
    for name, make in (("coal", coal_engine), ("warp", warp_engine), ("fcl", fcl_engine)):
        module = rivals[name]
        if module is not None:
            engines[name] = make(module, mesh, tool_mesh)
    took: dict[str, list[float]] = {name: [] for name in (*engines, "evaluate", "coal_fill", "contacts")}
    equal = dict.fromkeys(engines, True)
    wrong = dict.fromkeys(engines, 0)
    counts, areas = [], []
    cache = DetectCache()
    for k, net in enumerate(nets):
        start = clock()
        grid.matrices.points(net)
        evaluated = clock() - start
        now = Mesh(*whole_mesh(grid, net))
        if not np.array_equal(now.triangles, mesh.triangles):
            raise RuntimeError("the diagonals have changed: the engines would not have one mesh")
        answers = {}
        gc.collect()
        gc.disable()
        for name, step in engines.items():
            answers[name] = step(net, now.points)
        start = clock()
        contacts = detect([grid], [net], [tool], DetectOptions(), cache=cache).contacts
        detected = clock() - start
        gc.enable()
        if k < WARM_UP:
            continue
        for name, answer in answers.items():
            took[name].append(answer.seconds)
        took["evaluate"].append(evaluated)
        took["coal_fill"].append(answers["coal"].apart if "coal" in answers else np.nan)
        took["contacts"].append(detected)
        areas.append(float(contacts.area.sum()))
        counts.append(len(answers["cadsculpt"].pairs()))
        if rivals["cgal"] is not None:
            truth = exact_pairs(rivals["cgal"], now, tool_mesh)
            for name, answer in answers.items():
                difference = len(answer.pairs() ^ truth)
                equal[name] = equal[name] and difference == 0
                wrong[name] += difference
    exact = rivals["cgal"] is not None
    case: dict[str, Any] = {
        "triangles": len(mesh.triangles),
        "tool_triangles": len(tool_mesh.triangles),
        "steps": steps,
        "contact_area": float(np.median(areas)),
        "pairs": int(np.median(counts)),
        "pairs_equal": equal["cadsculpt"] if exact else None,
    }
    for name in ("cadsculpt", "coal", "warp", "fcl", "coal_fill", "evaluate", "contacts"):
        seconds = np.array(took.get(name, [np.nan]))
        known = np.isfinite(seconds).all()
        case[f"{name}_ms"] = round(float(np.median(seconds)) * 1e3, 4) if known else None
        case[f"{name}_p95_ms"] = round(float(np.quantile(seconds, 0.95)) * 1e3, 4) if known else None
    for name in ("coal", "warp", "fcl"):
        there = name in engines
        case[f"{name}_over_cadsculpt"] = round(case[f"{name}_ms"] / case["cadsculpt_ms"], 2) if there else None
        case[f"{name}_pairs_equal"] = equal[name] if there and exact else None
        case[f"{name}_pairs_wrong"] = wrong[name] if there and exact else None
    return case


def main() -> None:
    parser = argparse.ArgumentParser(description="Collision of a deforming patch beside mesh engines.")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.add_argument("--steps", type=int, default=40, help="measured steps of each size (default 40)")
    parser.add_argument("--clock", choices=("wall", "cpu"), default="wall", help="cpu: on a machine with other work")
    options = parser.parse_args()
    global clock
    clock = process_time if options.clock == "cpu" else perf_counter
    rivals = {
        "coal": installed("coal", "coal"),
        "warp": installed("warp", "warp-lang"),
        "fcl": installed("fcl", "python-fcl"),
        "cgal": installed("igl.copyleft.cgal", "libigl"),
    }
    with redirect_stdout(sys.stderr):  # where Warp says hello
        cases = [measure(cells, options.steps, rivals) for cells in CELLS]
    result = {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "threads": 1,
        "clock": options.clock,
        "cases": cases,
    }
    if options.json:
        print(json.dumps(result, indent=1))
        return
    columns = ("cadsculpt", "coal", "coal_fill", "warp", "fcl", "evaluate", "contacts")
    print("triangles " + "".join(f"{name:>12}" for name in columns) + "   pairs  equal  (ms, medians)")
    for case in cases:
        cells = (case[f"{name}_ms"] for name in columns)
        print(
            f"{case['triangles']:9d} "
            + "".join(f"{'-' if ms is None else format(ms, '.3f'):>12}" for ms in cells)
            + f"{case['pairs']:8d}  {case['pairs_equal']}"
        )


if __name__ == "__main__":
    main()
