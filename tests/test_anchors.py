"""Anchors of every kind: what is held stays to the bit, and nothing else does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cadsculpt.model import Model, SourceBody, build_model
from cadsculpt.motion.path import ToolPath
from cadsculpt.patch import SourceEdge, SourceFace
from cadsculpt.scene import Scene
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface

SIZE, NODES, LAYERS = 20.0, 2.0, 2
N = 11
"""Nodes along a side."""


def plate() -> BSplineSurface:
    """A flat bicubic square, parameters in mm."""
    knots = np.concatenate([np.full(3, 0.0), np.linspace(0.0, SIZE, 6), np.full(3, SIZE)])
    t = np.array([knots[i + 1 : i + 4].mean() for i in range(8)])
    X, Y = np.meshgrid(t, t, indexing="ij")
    return BSplineSurface(np.stack([X, Y, 0.0 * X], axis=-1), knots, knots, 3, 3, name="top")


def model_of(**keys: Any) -> Model:
    rows = [{"t": t, "at": [10.0, 10.0, z]} for t, z in ((0.0, 6.2), (0.01, 5.5))]
    body = {"name": "m", "file": "m", "thickness": 4.0, "nodes": NODES, "layers": LAYERS, "material": "rubber"}
    scene = Scene.model_validate(
        {
            "units": "mm",
            "model": [body | keys],
            "tool": [{"name": "ball", "shape": "sphere", "radius": 6.0, "path": rows}],
            "solver": {"resolution": 41, "step": 1e-3, "max_penetration": 0.5},
        }
    )
    corners = np.array([[0.0, 0], [SIZE, 0], [SIZE, SIZE], [0, SIZE], [0, 0]])
    names = ("front", "right", "back", "left")
    edges = tuple(SourceEdge(corners[k : k + 2], (name,)) for k, name in enumerate(names))
    face = SourceFace(1, "top", plate(), edges)
    return build_model(scene, [SourceBody("m", (face,))], {"ball": ToolPath.of_rows(scene.tool[0].path)})  # type: ignore[arg-type]


def nodes(held: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
    """(N, N, LAYERS + 1) by place along x, along y and layer, counted in nodes."""
    return held(*np.meshgrid(np.arange(N), np.arange(N), np.arange(LAYERS + 1), indexing="ij"))


def rim(i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """The nodes at the corners of the cells that the border runs along."""
    return (np.minimum(i, j) <= 1) | (np.maximum(i, j) >= N - 2)


KINDS: list[tuple[dict[str, Any], Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]]] = [
    ({"anchor": "base", "edges": "free"}, lambda i, j, k: k == LAYERS),
    ({"anchor": "base"}, lambda i, j, k: (k == LAYERS) | rim(i, j)),
    ({"anchor": "edges", "edges": "free"}, lambda i, j, k: rim(i, j)),
    ({"anchor": "none", "edges": "free"}, lambda i, j, k: i < 0),
    ({"anchor": "none"}, lambda i, j, k: rim(i, j)),
    ({"anchor": ["left"], "edges": "free"}, lambda i, j, k: i <= 1),
    ({"anchor": ["left", "back"], "edges": "free"}, lambda i, j, k: (i <= 1) | (j >= N - 2)),
    ({"anchor": [{"u": [0.0, 4.0]}], "edges": "free"}, lambda i, j, k: i <= 2),
    ({"anchor": [{"face": "top", "u": [15.9, 20.0], "v": [0.0, 6.0]}], "edges": "free"}, lambda i, j, k: (i >= 8) & (j <= 3)),
    ({"anchor": [{"face": 1, "v": [16.0, 20.0]}, "left"], "edges": "free"}, lambda i, j, k: (j >= 8) | (i <= 1)),
    ({"anchor": [{"face": "another", "v": [0.0, 20.0]}, "left"], "edges": "free"}, lambda i, j, k: i <= 1),
]  # fmt: skip


@pytest.mark.parametrize(("keys", "held"), KINDS, ids=[str(keys) for keys, _ in KINDS])
def test_what_is_held_stays_and_the_rest_gives_way(keys, held):
    model = model_of(**keys)
    lattice = model.patches[0].lattice
    expected = nodes(held).ravel()
    np.testing.assert_array_equal(lattice.anchored, expected)
    assert (model.free == {0}) == (not expected.any())
    session = Session(model)
    for _ in range(10):
        session.step()
    moved = session.lattice(0).x != lattice.nodes
    assert not moved[lattice.anchored].any()
    assert moved[~lattice.anchored].any(axis=1).mean() > 0.9
    assert session.displacement(0)[5, 5, 2] < -0.2
