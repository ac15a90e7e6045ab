"""A sphere holds its cell: random cells of all levels against dense samples of the surface inside them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from truth_surfaces import deformed, points_in_cells, random_surface

from cadsculpt.collide.grid import PatchGrid
from cadsculpt.collide.spheres import make_spheres
from cadsculpt.collide.workspace import Workspace

SAMPLES = 7
"""Samples along either side of a cell: its corners, and between them at random."""


def spheres_truth(cells: int = 100_000, seed: int = 1, per_net: int = 200) -> dict[str, object]:
    """At least `cells` cells, `per_net` of one net; of each surface the net as it is and twice deformed.

    spheres_outside : cells with a sample outside their sphere. spheres_outside_paper : the same of the paper's.
    spheres_worst : how far the farthest sample reaches, in radii.
    """
    rng = np.random.default_rng(seed)
    tested, outside, paper, worst = 0, 0, 0, 0.0
    degrees, kinds = set(), dict.fromkeys(("rational", "periodic", "deformed"), 0)
    while tested < cells:
        surface = random_surface(rng, bumps=rng.choice([0.3, 1.0, 3.0]))
        grid = PatchGrid.of(surface, (int(rng.integers(4, 30)), int(rng.integers(4, 30))))
        # one workspace for all nets of the surface: its bounds have to follow
        works = [Workspace(grid, np.zeros(16, np.int64)) for _ in range(2)]
        degrees |= {surface.degree_u, surface.degree_v}
        for step in range(3):
            net = surface.control_points if step == 0 else deformed(rng, surface)
            chosen = random_cells(rng, grid, per_net)
            points = points_in_cells(surface, net, *samples(rng, grid, chosen))
            away = []
            for work, mode in zip(works, (False, True), strict=True):
                g = work.load(net, paper=mode, delta=0.0)
                centre, radius = make_spheres(g, chosen, len(chosen))
                reach = np.linalg.norm(points - centre[:, None, None], axis=3).max(axis=(1, 2))
                # NaN is outside
                away.append(~(reach <= radius))
                if not mode:
                    worst = max(worst, float((reach / radius).max()))
            outside, paper = outside + int(away[0].sum()), paper + int(away[1].sum())
            tested += len(chosen)
            kinds["rational"] += len(chosen) * surface.rational
            kinds["periodic"] += len(chosen) * (surface.periodic_u or surface.periodic_v)
            kinds["deformed"] += len(chosen) * (step > 0)
    return {
        "spheres_tested": tested,
        "spheres_outside": outside,
        "spheres_outside_paper": paper,
        "spheres_worst": worst,
        "spheres_samples": tested * SAMPLES**2,
        "spheres_degrees": sorted(degrees),
        **{f"spheres_{name}": count for name, count in kinds.items()},
    }


def random_cells(rng: np.random.Generator, grid: PatchGrid, count: int) -> NDArray[np.int64]:
    """Cells (n, 3) (level, ku, kv), as many of each level as it has, up to an even share."""
    out = []
    share = -(-count // len(grid.tally))
    for level, (across_u, across_v) in enumerate(grid.tally.tolist()):
        chosen = rng.permutation(across_u * across_v)[:share]
        out.append(np.stack([np.full(len(chosen), level), chosen // across_v, chosen % across_v], axis=1))
    return np.concatenate(out).astype(np.int64)


def samples(
    rng: np.random.Generator, grid: PatchGrid, cells: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Parameters u and v (n, SAMPLES) inside the cells, ends included."""
    level, out = cells[:, 0], []
    for t, rows, k in ((grid.matrices.u, grid.row_u, cells[:, 1]), (grid.matrices.v, grid.row_v, cells[:, 2])):
        low, high = t[rows[level, k]], t[rows[level, k + 1]]
        part = np.concatenate([[0.0], np.sort(rng.random(SAMPLES - 2)), [1.0]])
        out.append(np.clip(low[:, None] + part * (high - low)[:, None], low[:, None], high[:, None]))
    return out[0], out[1]
