"""The coarse space of conjugate gradients: its matrix by brute force, and how few iterations it leaves."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cadsculpt.physics import coarse, tangent
from cadsculpt.physics.assembly import assemble
from cadsculpt.physics.coarse import CoarseSpace
from cadsculpt.physics.explicit import LatticeState
from cadsculpt.physics.forces import node_weights
from cadsculpt.physics.implicit import advance_implicit
from cadsculpt.physics.lattice import Lattice, build_lattice
from cadsculpt.physics.material import Material
from cadsculpt.physics.numbering import Numbering, pieces
from cadsculpt.physics.tangent import Tangent, solve
from cadsculpt.physics.ties import Ties

Array = NDArray[np.float64]


def tube(nu: int, nv: int, layers: int, *, closed_v: bool = False) -> Lattice:
    """A tube closed around u, or a torus."""
    a, b = 2 * math.pi * np.arange(nu) / nu, 2 * math.pi * np.arange(nv) / nv
    out = np.stack([np.cos(a), np.sin(a), 0 * a], axis=1)[:, None] * np.ones((1, nv, 1))
    points = 8.0 * out
    if closed_v:
        out = out * np.cos(b)[None, :, None] + np.array([0, 0, 1.0]) * np.sin(b)[None, :, None]
        points = points + 3.0 * out
    else:
        points[..., 2] = 2.0 * np.arange(nv)
    anchored = np.zeros((nu, nv, layers + 1), dtype=bool)
    anchored[0, 0] = anchored[nu // 2, nv - 1] = True
    return build_lattice(
        points, -out, a, b, thickness=2.0, layers=layers, material=Material(1e6, 1000.0), wrap=(True, closed_v),
        period=(2 * math.pi, 2 * math.pi if closed_v else 0.0), anchored=anchored, metres_per_unit=1e-3,
    )  # fmt: skip


def lattices(slab: Callable[..., Lattice]) -> dict[str, Lattice]:
    edges = np.zeros((9, 6, 4), dtype=bool)
    edges[[0, -1]] = True
    cells = np.ones((8, 5), dtype=bool)
    cells[:3, :2] = False
    plate = slab(9, 6, 3, anchored=edges, cell_active=cells)
    # unlike nodes, some masters held
    other = slab(7, 5, 2)
    last = np.flatnonzero((plate.nodes[:, 1] == 5.0) & (plate.nodes[:, 2] == 0.0))[1:7]
    ties = Ties(216 + 3 * 5 * np.arange(6), np.stack([last, last + 4], axis=1), np.tile([0.7, 0.3], (6, 1)))
    return {
        "slab": slab(6, 11, 2, base=True),
        "holes and edges": plate,
        "tube": tube(11, 6, 2),
        "torus": tube(10, 9, 1, closed_v=True),
        "tied": assemble([plate, other], ties).lattice,
    }


@pytest.mark.parametrize("name", ["slab", "holes and edges", "tube", "torus", "tied"])
def test_the_coarse_matrix_is_that_of_the_lattice(slab: Callable[..., Lattice], name: str) -> None:
    """P^T K P, K put together spring by spring and contact by contact: from it, P (P^T K P)^-1 P^T."""
    rng = np.random.default_rng(0)
    lattice = lattices(slab)[name]
    size = len(lattice.nodes)
    root = rng.normal(size=(13, size, 3, 3))
    full = np.einsum("dnab,dncb->dnac", root, root)
    blocks = np.stack([full[..., a, b] for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))], axis=-1)
    diagonal = rng.uniform(0.1, 1, size)
    free = lattice.inverse_mass > 0.0
    nodes, weights = rng.choice(np.flatnonzero(free), (5, 8)), rng.normal(size=(5, 8))
    contact = np.einsum("cab,cdb->cad", *[rng.normal(size=(5, 3, 3))] * 2)
    contact = 0.5 * (contact + contact.transpose(0, 2, 1))
    K = np.kron(np.diag(diagonal * free), np.eye(3))
    for d, start, stop, shift in lattice.segments:
        for n in range(start, stop):
            if lattice.stiffness[d, n] > 0.0:
                pair = [*range(3 * n, 3 * n + 3), *range(3 * (n + shift), 3 * (n + shift) + 3)]
                K[np.ix_(pair, pair)] += np.kron([[1, -1], [-1, 1]], full[d, n])
    T = np.diag(free.astype(float))
    for s, node in enumerate(lattice.ties.nodes):
        entries = slice(lattice.ties.start[s], lattice.ties.start[s + 1])
        for master, weight in zip(lattice.ties.masters[entries], lattice.ties.weights[entries], strict=True):
            T[node, master] = weight * free[master]
    for c in range(5):
        row = np.zeros(size)
        np.add.at(row, nodes[c], weights[c])
        K += np.kron(np.outer(row, row), contact[c])
    numbering = Numbering.of(lattice, nodes)
    for step in (2, 3, 4, 64):
        space = CoarseSpace.stepping(lattice, numbering.place, nodes, pieces(lattice, nodes), step)
        P = space.spread.toarray()
        assert P[free].sum(axis=1) == pytest.approx(1.0)
        assert not P[~free].any()
        used = space.place >= 0
        if step < 4:
            assert used.sum() < free.sum()
        TP = np.kron(T @ P[:, used], np.eye(3))
        A = TP.T @ K @ TP
        A += coarse.LEAST_PIVOT * np.diag(np.diag(A))
        r = np.where(free[:, None], rng.normal(size=(size, 3)), 0.0)
        P3 = np.kron(P[:, used], np.eye(3))
        expected = (P3 @ np.linalg.solve(A, P3.T @ r.ravel())).reshape(-1, 3)
        smooth = space.inverse(lattice, blocks, diagonal, nodes, weights, contact)
        assert smooth is not None
        assert smooth(r) == pytest.approx(expected, rel=1e-6, abs=1e-7 * np.abs(expected).max())


def test_iterations_do_not_grow_with_the_plate(slab: Callable[..., Lattice], monkeypatch: pytest.MonkeyPatch) -> None:
    """Plates held at their edges and pushed in the middle: products with K for one solution, ten times the nodes."""
    monkeypatch.setattr(tangent, "LARGEST_BAND", 0.0)
    multiply, products = tangent._multiply, [0]

    def counted(*args: Any) -> Any:
        products[0] += 1
        return multiply(*args)

    monkeypatch.setattr(tangent, "_multiply", counted)
    counts = []
    for n in (15, 47):
        edges = np.zeros((n, n, 3), dtype=bool)
        edges[[0, -1]] = edges[:, [0, -1]] = True
        lattice = slab(n, n, 2, anchored=edges)
        force = np.zeros_like(lattice.nodes)
        force[(n // 2 * n + n // 2) * 3, 2] = -1e-3
        products[0] = 0
        state = LatticeState.at_rest(lattice)
        result = advance_implicit(lattice, state, None, 1.0, quasi_static=True, external=force)
        assert result.substeps == 1
        counts.append(products[0])
    assert counts[1] < 2 * counts[0]
    assert counts[1] < 100


def test_gradients_agree_with_the_band_where_bodies_meet(
    slab: Callable[..., Lattice], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Contact in 8 nodes of two parts."""
    rng = np.random.default_rng(1)
    pair = assemble([slab(12, 9, 2, base=True), slab(10, 9, 3, base=True)])
    lattice = pair.lattice
    nodes, weights = node_weights(pair.parts[0], rng.uniform(0, 9, 60), rng.uniform(0, 8, 60))
    others, other_weights = node_weights(pair.parts[1], rng.uniform(0, 9, 60), rng.uniform(0, 8, 60))
    nodes = np.concatenate([nodes, others + pair.starts[1]], axis=1)
    weights = np.concatenate([weights, -other_weights], axis=1)
    normal = rng.normal(size=(60, 3))
    stiffness = 30.0 * normal[:, :, None] * normal[:, None, :]
    edges = lattice.nodes[:, None] - lattice.nodes[None, :1]
    assert edges.any()
    blocks = np.zeros((13, len(lattice.nodes), 6))
    blocks[:, :, :3] = lattice.stiffness[:, :, None]
    K = Tangent(blocks, np.full(len(lattice.nodes), 1e-3), nodes, weights, stiffness)
    right = np.where(lattice.inverse_mass[:, None] > 0, rng.normal(size=lattice.nodes.shape), 0.0)
    numbering = Numbering.of(lattice, nodes)
    direct = solve(lattice, numbering, K, right)
    monkeypatch.setattr(tangent, "LARGEST_BAND", 0.0)
    monkeypatch.setattr(tangent, "CG_TOLERANCE", 1e-10)
    found = solve(lattice, numbering, K, right)
    assert direct is not None
    assert found is not None
    assert found == pytest.approx(direct, abs=1e-7 * np.abs(direct).max())
