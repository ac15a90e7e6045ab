"""Spring constants: Young's modulus of single cells of any shape, volumes, and the flow of springs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import brentq

from cadsculpt.physics.calibrate import spring_flow
from cadsculpt.physics.cells import hexahedron_volume
from cadsculpt.physics.lattice import Lattice, build_lattice
from cadsculpt.physics.material import Material

Array = NDArray[np.float64]


def stiffness_tensor(lattice: Lattice, springs: Any) -> Array:
    """(1 / V) sum k L^2 n n n n in units of E."""
    vector = lattice.nodes[springs.end] - lattice.nodes[springs.start]
    length = np.linalg.norm(vector, axis=1)
    n = vector / length[:, None]
    weight = lattice.stiffness[springs.direction, springs.start] * length**2
    return np.einsum("s,sa,sb,sc,sd->abcd", weight, n, n, n, n) / lattice.volume.sum() / (1e6 * 1e-6)


def moduli(c: Array) -> Array:
    """Young's moduli along x, y, z of a fully symmetric stiffness tensor, from its 6 x 6 Voigt matrix."""
    pairs = [(0, 0), (1, 1), (2, 2), (1, 2), (2, 0), (0, 1)]
    voigt = np.array([[c[a, b, d, e] for d, e in pairs] for a, b in pairs])
    return 1.0 / np.diag(np.linalg.inv(voigt))[:3]


def test_a_cube_has_the_balanced_answer(slab: Callable[..., Lattice], springs: Any) -> None:
    lattice = slab(4, 4, 3)
    inner = 0.4 * 1.0  # 0.4 E a, E = 1 N/mm^2
    node = (1 * 4 + 1) * 4 + 1
    assert lattice.stiffness[:9, node] == pytest.approx(inner, rel=1e-6)
    assert lattice.stiffness[9:, node] == pytest.approx(0.0, abs=1e-9)
    # an edge of the slab belongs to one cell of four, a face on its border to one of two
    assert lattice.stiffness[0, 0] == pytest.approx(inner / 4, rel=1e-6)
    assert lattice.stiffness[3, 0] == pytest.approx(inner / 2, rel=1e-6)
    c = stiffness_tensor(lattice, springs(lattice))
    assert c[0, 0, 0, 0] == pytest.approx(1.2, rel=1e-6)
    assert c[0, 0, 1, 1] == pytest.approx(0.4, rel=1e-6)
    assert c[0, 1, 0, 1] == pytest.approx(0.4, rel=1e-6)
    assert c[0, 0, 0, 1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    "steps", [(1, 1, 1.5), (1, 1, 2), (2, 2, 1), (1, 1, 3), (3, 3, 1), (1, 2, 3), (3, 1, 1), (1, 1, 6)]
)
def test_youngs_modulus_of_long_cells(
    slab: Callable[..., Lattice], springs: Any, steps: tuple[float, float, float]
) -> None:
    lattice = slab(2, 2, 1, steps=steps)
    assert moduli(stiffness_tensor(lattice, springs(lattice))) == pytest.approx(1.0, rel=0.005)
    # every edge and every face diagonal plays its part
    assert (lattice.stiffness[:9].max(axis=1) > 0.0).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_sheared_and_turned_cells(seed: int) -> None:
    """Young's modulus along the axes nearest to the cell's edges, for random cells in random positions."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    if np.linalg.det(turn) < 0:
        turn[0] = -turn[0]
    lengths = rng.uniform(1.0, 2.0, 3)
    shear = np.eye(3) + 0.3 * rng.uniform(-1, 1, (3, 3)) * (1 - np.eye(3))
    edges = (lengths[:, None] * shear) @ turn
    points = np.array([[[0, 0, 0], edges[1]], [edges[0], edges[0] + edges[1]]]) + rng.normal(size=3)
    thickness = float(np.linalg.norm(edges[2]))
    lattice = build_lattice(
        points,
        np.broadcast_to(edges[2] / thickness, (2, 2, 3)),
        [0.0, 1.0],
        [0.0, 1.0],
        thickness=thickness,
        layers=1,
        material=Material(1e6, 1000.0),
        metres_per_unit=1e-3,
    )
    assert lattice.volume.sum() == pytest.approx(abs(np.linalg.det(edges)), rel=1e-12)
    start, end, weights = [], [], []
    for d, (i, j, k) in enumerate(lattice.offsets):
        for n in np.flatnonzero(lattice.stiffness[d]):
            start.append(n)
            end.append(n + (i * 2 + j) * 2 + k)
            weights.append(lattice.stiffness[d, n])
    vector = lattice.nodes[end] - lattice.nodes[start]
    # the polar factor of the normalised edges, by singular values
    left, _, right = np.linalg.svd(edges / np.linalg.norm(edges, axis=1)[:, None])
    vector = vector @ (left @ right).T
    length = np.linalg.norm(vector, axis=1)
    n = vector / length[:, None]
    c = np.einsum("s,sa,sb,sc,sd->abcd", np.array(weights) * length**2, n, n, n, n) / lattice.volume.sum()
    strain_free = np.array([[c[a, a, b, b] for b in range(3)] for a in range(3)])
    assert 1.0 / np.diag(np.linalg.inv(strain_free)) == pytest.approx(1.0, rel=0.01)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_volume_of_a_hexahedron(seed: int) -> None:
    """Against 2 x 2 x 2 Gauss points, exact for the trilinear map's Jacobian."""
    rng = np.random.default_rng(seed)
    corners = np.array([(a, b, c) for a in (0, 1) for b in (0, 1) for c in (0, 1)], dtype=float)
    p = corners + 0.3 * rng.uniform(-1, 1, (8, 3))
    volume = 0.0
    for g in (corners - 0.5) / math.sqrt(3.0) + 0.5:
        shape = np.where(corners == 1.0, g, 1.0 - g)
        slope = np.where(corners == 1.0, 1.0, -1.0)
        gradient = np.stack([slope[:, a] * shape[:, (a + 1) % 3] * shape[:, (a + 2) % 3] for a in range(3)], axis=1)
        volume += np.linalg.det(p.T @ gradient) / 8.0
    assert hexahedron_volume(p) == pytest.approx(volume, rel=1e-12)


@pytest.mark.parametrize("hardening", [0.0, 0.02, 0.1, 0.5, 0.9])
def test_flow_of_springs_meets_its_equations(hardening: float) -> None:
    y, g = spring_flow(0.01, hardening)
    expected = (
        0.0 if hardening == 0.0 else brentq(lambda t: 1.2 * t - 0.32 * t * t / (1.2 + 0.4 * t) - hardening, 0.0, 1.0)
    )
    assert g == pytest.approx(expected, abs=1e-12)
    assert (1 - g) * y * (2 - 0.64 * g / (1.2 + 0.4 * g)) == pytest.approx((1 - hardening) * 0.01, rel=1e-12)
    assert spring_flow(math.inf, hardening) == (math.inf, 0.0)
    assert spring_flow(0.01, 1.0) == (math.inf, 0.0)
