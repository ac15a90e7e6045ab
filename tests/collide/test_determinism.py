"""The same bytes in two runs, and from one thread or two: kernels release the GIL and share nothing but their input."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from threading import Barrier

import numpy as np
import pytest

from cadsculpt.collide.crossing import crossings
from cadsculpt.collide.detect import DetectCache, DetectOptions, FieldTool, PointTool, SurfaceTool, detect
from cadsculpt.collide.grid import PatchGrid

BODIES = 4
STEPS = 2


def _bytes(result):
    return b"".join(np.ascontiguousarray(getattr(result, f.name)).tobytes() for f in fields(result))


@pytest.fixture(scope="module")
def scene(shapes):
    """Bodies of two patches each, over grids that all share, with a net for every step; and tools of every kind."""
    rng = np.random.default_rng(11)
    sheets = [shapes.plate(10.0, 8, 3), shapes.random_surface(rng, rational=True)]
    grids = [PatchGrid.of(sheet, 33) for sheet in sheets]
    nets = [
        [
            [sheet.control_points + 0.1 * rng.normal(size=sheet.control_points.shape) for sheet in sheets]
            for _ in range(STEPS)
        ]
        for _ in range(BODIES)
    ]
    box, ball = shapes.box(3.0, [5.0, 5.0, 1.0]), shapes.ball(2.0, [3.0, 6.0, 1.2])
    tools = [
        FieldTool(shapes.Sphere([6.0, 4.0, 1.0], 1.5)),
        SurfaceTool(tuple(PatchGrid.of(s, 9) for s in box), tuple(s.control_points for s in box)),
        SurfaceTool((PatchGrid.of(ball, (17, 9)),), (ball.control_points,)),
        PointTool(np.array([2.0, 2.0, -0.1]), 0.1),
    ]
    return grids, nets, tools


def _run(scene, body, start=None):
    """All steps of one body with a cache of its own: the bytes of each step's contacts and crossings."""
    grids, nets, tools = scene
    if start is not None:
        start.wait()
    cache, out = DetectCache(), []
    for net in nets[body]:
        found = detect(grids, net, tools, DetectOptions(margin=0.05), body=body, cache=cache)
        assert len(found.contacts) > 0
        assert len(found.crossings) > 0
        pairs = crossings(SurfaceTool(tuple(grids), tuple(net)), tools[1], cache)
        out.append(_bytes(found.contacts) + _bytes(found.crossings) + _bytes(pairs))
    return out


def test_two_runs_give_the_same_bytes(scene):
    assert _run(scene, 0) == _run(scene, 0)


def test_one_thread_or_two_give_the_same_bytes(scene):
    alone = [_run(scene, body) for body in range(BODIES)]
    for threads in (1, 2):
        start = Barrier(threads)  # of two bodies side by side, both begin at once
        with ThreadPoolExecutor(threads) as pool:
            together = list(pool.map(lambda body, start=start: _run(scene, body, start), range(BODIES)))
        assert together == alone


def test_an_old_cache_gives_the_same_bytes_as_a_new_one(scene):
    """After other nets, other steps and other tools have been through it."""
    grids, nets, tools = scene
    cache = DetectCache()
    for body in range(2):
        for net in nets[body]:
            used = detect(grids, net, tools, DetectOptions(), cache=cache)
            new = detect(grids, net, tools, DetectOptions())
            assert _bytes(used.contacts) == _bytes(new.contacts)
            assert _bytes(used.crossings) == _bytes(new.crossings)
