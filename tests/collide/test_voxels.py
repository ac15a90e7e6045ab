"""Voxels about a tool that keeps its shape: what they tell is true, and does not depend on what was asked before."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.collide.closest import closest_points
from cadsculpt.collide.detect import DetectCache, DetectOptions, RigidSurfaceTool, detect
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.collide.newton import DISTANCE, POINT
from cadsculpt.collide.voxels import feet, voxels_about
from cadsculpt.collide.workspace import Workspace
from cadsculpt.motion.pose import Pose


def _loaded(surface, resolution=17):
    grid = PatchGrid.of(surface, resolution)
    work = Workspace(grid, np.zeros(16, np.int64))
    return work, work.load(surface.control_points, paper=False, delta=0.0)


def _feet(work, patch, voxels, points):
    best, state = np.full((len(points), 9), np.inf), np.zeros(len(points), np.int64)
    feet(patch, voxels, work.search, points, np.inf, best, state)
    return best, state


@pytest.mark.parametrize("seed", range(4))
def test_they_find_the_closest_points_in_any_order_and_after_they_were_forgotten(shapes, seed):
    rng = np.random.default_rng(seed)
    surface = shapes.random_surface(rng, rational=bool(seed % 2))
    work, patch = _loaded(surface)
    # some points lie beyond all voxels
    points = rng.uniform([-4, -4, -6], [14, 14, 6], (400, 3))
    truth = closest_points(work.grid, surface.control_points, points)
    cells = int(work.grid.offset[-1])
    full = voxels_about(work.extent, 0.8, cells)
    small = voxels_about(work.extent, 0.8, cells)._replace(names=np.zeros(40, np.int64))
    for voxels in (full, small):
        best, _ = _feet(work, patch, voxels, points)
        assert best[:, DISTANCE] == pytest.approx(truth.distance, rel=1e-9, abs=1e-12)
        assert np.linalg.norm(points - best[:, POINT : POINT + 3], axis=1) == pytest.approx(truth.distance, rel=1e-9)
    order = rng.permutation(len(points))
    again, _ = _feet(work, patch, voxels_about(work.extent, 0.8, cells), points[order])
    assert again[:, DISTANCE] == pytest.approx(truth.distance[order], rel=1e-9, abs=1e-12)
    # each voxel's own middle and distance, against dense samples: nothing of the surface is nearer
    rows = int(full.used[0])
    assert rows > 100
    (u0, u1), (v0, v1) = surface.domain
    dense = surface.evaluate(np.linspace(u0, u1, 160)[:, None], np.linspace(v0, v1, 160)).reshape(-1, 3)
    for k in range(0, rows, 17):
        ijk = np.array(np.unravel_index(full.names[k], full.counts))
        middle = full.low + (ijk + 0.5) * full.edge
        assert full.foot[k, 0] <= np.linalg.norm(dense - middle, axis=1).min() + 1e-12
        assert np.linalg.norm(surface.evaluate(full.foot[k, 1], full.foot[k, 2]) - middle) == pytest.approx(
            full.foot[k, 0]
        )


def test_contacts_are_the_same_bytes_whatever_was_asked_before(shapes):
    rng = np.random.default_rng(7)
    plate = shapes.plate(10.0, 8, 3, height=lambda x, y: 0.3 * np.sin(x) * np.cos(0.7 * y))
    tool = shapes.plate(4.0, 5, 3, height=lambda x, y: 0.15 * ((x - 2) ** 2 + (y - 2) ** 2))
    grid, its = PatchGrid.of(plate, 49), PatchGrid.of(tool, 17)
    used, found = DetectCache(), 0
    for _ in range(12):
        pose = Pose.turned([*rng.uniform(1, 5, 2), rng.uniform(-0.6, 0.4)], rng.normal(size=3), rng.uniform(0, 30))
        rigid = RigidSurfaceTool((its,), (tool.control_points,), pose.at, pose.rotation)
        options = DetectOptions(margin=0.05)
        kept = detect([grid], [plate.control_points], [rigid], options, cache=used).contacts
        fresh = detect([grid], [plate.control_points], [rigid], options, cache=DetectCache()).contacts
        found += len(fresh)
        for name in ("u", "v", "point", "normal", "depth", "area", "tool_point"):
            assert getattr(kept, name).tobytes() == getattr(fresh, name).tobytes()
    assert found > 300
