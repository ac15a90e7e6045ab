"""The triangles that cross are those of CGAL's exact kernel, through libigl (extra `bench`), on the same vertices.

Ten pairs of patches, at the finest level. Where the two differ, rational arithmetic says who is right.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from truth_solids import ball, ring
from truth_triangles import DISJOINT, as_integers, relation_of_integers

from cadsculpt.collide.crossing import crossings
from cadsculpt.collide.detect import PatchGrid, SurfaceTool
from cadsculpt.collide.triangulate import whole_mesh
from cadsculpt.spline.surface import BSplineSurface

Array = NDArray[np.float64]
Pair = tuple[tuple[int, ...], tuple[int, ...]]

NO_CONTACT = "no contact"


def pairs_truth() -> dict[str, object]:
    """pairs_equal_exact : the crossing pairs of all scenes are CGAL's: none in NO_CONTACT, and some in each other.
    pairs_scenes : per scene ours, theirs, and how many of the pairs in which they differ are right on either
    side. None of it where libigl is missing."""
    try:
        from igl.copyleft.cgal import intersect_other
    except ImportError:
        print("pairs: libigl is not installed (extra bench): crossing pairs were not compared", file=sys.stderr)
        return {"pairs_equal_exact": None}
    scenes, equal = [], True
    for name, a, b in pairs():
        grids = [PatchGrid.of(a, 21), PatchGrid.of(b, 17)]
        found = crossings(*(SurfaceTool((grid,), (grid.surface.control_points,)) for grid in grids))
        mine = [named(x, y) for x, y in zip(found.model_triangle, found.tool_triangle, strict=True)]
        (v, f), (t, g) = (mesh(grid) for grid in grids)
        meets = np.asarray(intersect_other(v, f, t, g, detect_only=True)[0]).reshape(-1, 2)
        theirs = {named(f[i], g[j]) for i, j in meets}
        points = v, t
        differ = {
            "ours only": [meet_exactly(points, pair) for pair in sorted(set(mine) - theirs)],
            "CGAL only": [not meet_exactly(points, pair) for pair in sorted(theirs - set(mine))],
        }
        same = set(mine) == theirs and len(mine) == len(theirs) and (len(mine) == 0) == (name == NO_CONTACT)
        equal &= same
        scenes.append(
            {
                "scene": name, "pairs": len(mine), "cgal": len(theirs), "equal": same, "repeated": len(mine) - len(set(mine)),
                **{key: len(value) for key, value in differ.items()},
                "ours right": sum(map(sum, differ.values())),
            }
        )  # fmt: skip
    return {"pairs_equal_exact": equal, "pairs_scenes": scenes}


def named(p: NDArray[np.int64], q: NDArray[np.int64]) -> Pair:
    """A pair of triangles by its vertices, whatever their order."""
    return tuple(sorted(int(k) for k in p)), tuple(sorted(int(k) for k in q))


def mesh(grid: PatchGrid) -> tuple[Array, NDArray[np.int64]]:
    """Vertices and triangles of the finest level; vertices that no triangle uses are put where one is."""
    points, triangles = whole_mesh(grid, grid.surface.control_points)
    used = points[triangles[0, 0]]
    return np.where(np.isnan(points), used, points), triangles.astype(np.int64)


def meet_exactly(points: tuple[Array, Array], pair: Pair) -> bool:
    """Whether two triangles have a common point, by Python's integers."""
    p, q = pair
    six = np.concatenate([points[0][list(p)], points[1][list(q)]])
    return relation_of_integers(as_integers(six)) != DISJOINT


# ------------------------------------------------------------------ the scenes


def sheet(rng: np.random.Generator | None, count: int = 6, size: float = 4.0, bumps: float = 0.5) -> BSplineSurface:
    """A bicubic sheet over [0, size]^2 about the plane z = 0, its rows evenly spaced; exactly in it without a
    generator."""
    knots = np.concatenate([np.zeros(4), np.arange(1, count - 3) / (count - 3), np.ones(4)])
    at = size * np.array([knots[i + 1 : i + 4].mean() for i in range(count)])
    x, y = np.meshgrid(at, at, indexing="ij")
    z = np.zeros_like(x) if rng is None else rng.normal(scale=bumps, size=x.shape)
    return BSplineSurface(np.stack([x, y, z], axis=-1), knots, knots, 3, 3)


def moved(surface: BSplineSurface, by: tuple[float, float, float], turn: Array | None = None) -> BSplineSurface:
    net = surface.control_points if turn is None else surface.control_points @ turn.T
    return surface.with_control_points(net + np.array(by))


def pairs() -> Iterator[tuple[str, BSplineSurface, BSplineSurface]]:
    rng = np.random.default_rng(4)
    upright = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    a, b = sheet(rng), moved(sheet(rng), (0.7, 0.3, 0.1))
    yield "generic", a, b
    yield "scaled by 1e-3", a.scaled(1e-3), b.scaled(1e-3)
    # a flat sheet through the middle of another: edges on edges, vertices on vertices
    yield "symmetric", sheet(None), moved(sheet(None), (0.0, 2.0, -2.0), upright)
    yield "coplanar overlap", sheet(None), moved(sheet(None), (1.0, 0.5, 0.0))
    yield NO_CONTACT, a, moved(b, (0.0, 0.0, 9.0))
    # edge on edge, in a plane
    yield "touching", sheet(None), moved(sheet(None), (4.0, 0.0, 0.0))
    yield "deep", a, moved(sheet(rng, bumps=1.5), (0.0, 0.0, -0.2))
    yield "closed torus", ring(2.0, 0.7), moved(ring(2.0, 0.7), (1.0, 0.0, 0.0), upright)
    thin = a.with_control_points(a.control_points * [1.0, 1.0, 1e-5])
    yield "thin", thin, b.with_control_points(b.control_points * [1.0, 1.0, 1e-5])
    # a ball with poles, whose equator lies in the sheet's plane
    yield "mixed", sheet(None), moved(ball(1.5), (2.0, 2.0, 0.0))
