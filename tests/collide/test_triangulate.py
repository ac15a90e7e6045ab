"""Meshes over cells of one or several levels have no holes."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from cadsculpt.collide.grid import PatchGrid
from cadsculpt.collide.triangulate import triangulate, whole_mesh
from cadsculpt.collide.workspace import Workspace


def _edges(triangles):
    count = Counter()
    for t in triangles:
        for k in range(3):
            a, b = t[k], t[(k + 1) % 3]
            count[(min(a, b), max(a, b))] += 1
            count[("directed", a, b)] += 1
    directed = {k: v for k, v in count.items() if k[0] == "directed"}
    return {k: v for k, v in count.items() if k[0] != "directed"}, directed


def _random_leaves(grid, rng, depth=0.6):
    """Cells of mixed levels that tile the patch: split at random."""
    last = len(grid.tally) - 1
    leaves, todo = [], [(0, a, b) for a in range(grid.tally[0, 0]) for b in range(grid.tally[0, 1])]
    while todo:
        level, a, b = todo.pop()
        if level == last or (level > 0 and rng.random() > depth):
            leaves.append((level, a, b))
            continue
        for c in range(grid.child_u[level, a], grid.child_u[level, a + 1]):
            for d in range(grid.child_v[level, b], grid.child_v[level, b + 1]):
                todo.append((level + 1, c, d))
    return np.array(leaves, dtype=np.int64)


def _triangulated(grid, net, cells):
    work = Workspace(grid, np.zeros(9, np.int64))
    g = work.load(net, paper=False, delta=0.0)
    triangles, first = triangulate(g, cells, len(cells), work.new_mark())
    return g, triangles, first


@pytest.mark.parametrize("seed", range(12))
def test_cells_of_mixed_levels_meet_without_cracks(shapes, seed):
    rng = np.random.default_rng(seed)
    surface = shapes.random_surface(rng, rational=bool(seed % 2))
    grid = PatchGrid.of(surface, (int(rng.integers(2, 40)), int(rng.integers(2, 40))))
    cells = _random_leaves(grid, rng)
    _, triangles, first = _triangulated(grid, surface.control_points, cells)
    m, n = grid.shape
    edges, directed = _edges(triangles)
    assert max(directed.values()) == 1  # consistently oriented
    for (a, b), count in edges.items():
        i, j = np.divmod([a, b], n)
        on_border = (i[0] == i[1] and i[0] in (0, m - 1)) or (j[0] == j[1] and j[0] in (0, n - 1))
        assert count == (1 if on_border else 2)
    # the border is the whole border of the patch, and in (u, v) every triangle turns the same way and they fill the
    # domain
    u, v = grid.matrices.u[triangles // n], grid.matrices.v[triangles % n]
    area = 0.5 * ((u[:, 1] - u[:, 0]) * (v[:, 2] - v[:, 0]) - (u[:, 2] - u[:, 0]) * (v[:, 1] - v[:, 0]))
    assert area.min() > 0
    (u0, u1), (v0, v1) = surface.domain
    assert area.sum() == pytest.approx((u1 - u0) * (v1 - v0))
    # each cell owns its own triangles, inside it
    for c, (level, ku, kv) in enumerate(cells):
        own = triangles[first[c] : first[c + 1]]
        assert len(own) >= 2
        assert own.min() // n >= grid.row_u[level, ku]
        assert own.max() // n <= grid.row_u[level, ku + 1]
        assert (own % n).min() >= grid.row_v[level, kv]
        assert (own % n).max() <= grid.row_v[level, kv + 1]


def test_a_window_has_the_windows_border(shapes):
    surface = shapes.plate()
    grid = PatchGrid.of(surface, 25)
    last = len(grid.tally) - 1
    cells = np.array([(last, a, b) for a in range(5, 12) for b in range(3, 9)], dtype=np.int64)
    _, triangles, _ = _triangulated(grid, surface.control_points, cells)
    edges, _ = _edges(triangles)
    border = {e for e, count in edges.items() if count == 1}
    n = grid.shape[1]
    expected = set()
    for a in range(5, 12):
        expected |= {(a * n + j, (a + 1) * n + j) for j in (3, 9)}
    for b in range(3, 9):
        expected |= {(i * n + b, i * n + b + 1) for i in (5, 12)}
    assert border == expected


@pytest.mark.parametrize(("kind", "euler"), [("cylinder", 0), ("ball", 2)])
def test_closed_surfaces_close(shapes, kind, euler):
    surface = getattr(shapes, kind)()
    grid = PatchGrid.of(surface, (33, 17))
    for seed in range(3):
        cells = _random_leaves(grid, np.random.default_rng(seed))
        _, triangles, _ = _triangulated(grid, surface.control_points, cells)
        edges, directed = _edges(triangles)
        assert max(directed.values()) == 1
        once = sum(count == 1 for count in edges.values())
        assert (once == 0) == (kind == "ball")
        # V - E + F: a sphere's is 2; a tube's is 0
        assert len(np.unique(triangles)) - len(edges) + len(triangles) == euler


def test_the_shorter_diagonal_is_the_locally_optimal_one(shapes):
    rng = np.random.default_rng(3)
    surface = shapes.random_surface(rng, bumps=0.9)
    grid = PatchGrid.of(surface, 15)
    points, triangles = whole_mesh(grid, surface.control_points)
    edges = {}
    for t in triangles:
        for k in range(3):
            edges.setdefault(frozenset((t[k], t[(k + 1) % 3])), []).append(t[(k + 2) % 3])
    n = grid.shape[1]
    checked = 0
    for edge, others in edges.items():
        a, b = edge
        if len(others) == 2 and a // n != b // n and a % n != b % n:
            checked += 1
            assert (
                np.linalg.norm(points[a] - points[b]) <= np.linalg.norm(points[others[0]] - points[others[1]]) + 1e-12
            )
    assert checked == (grid.shape[0] - 1) * (grid.shape[1] - 1)


def test_the_mesh_of_a_sphere_has_its_area(shapes):
    surface = shapes.ball(5.0)
    error = []
    for resolution in (17, 33, 65):
        points, triangles = whole_mesh(PatchGrid.of(surface, resolution), surface.control_points)
        a, b, c = (points[triangles[:, k]] for k in range(3))
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
        volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
        assert volume > 0  # oriented outwards
        error.append(4 * np.pi * 25 - area)
    assert all(0 < late < 0.3 * early for early, late in zip(error[:-1], error[1:], strict=True))
