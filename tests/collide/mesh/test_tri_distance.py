"""Triangle distances against a quadratic programme solved over all supports, in floats and in rational numbers."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import minimize

from cadsculpt.collide.mesh.tri_distance import triangle_distance
from cadsculpt.collide.tri_tri import Relation, triangle_relation
from cadsculpt.errors import GeometryError

Array = NDArray[np.float64]

SUPPORTS = [s for k in (1, 2, 3) for s in combinations(range(3), k)]


def solved(matrix: list[list[Fraction]], right: list[Fraction]) -> list[Fraction] | None:
    """Gauss without rounding; None where the matrix is singular."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    n = len(rows)
    for k in range(n):
        pivot = next((i for i in range(k, n) if rows[i][k] != 0), None)
        if pivot is None:
            return None
        rows[k], rows[pivot] = rows[pivot], rows[k]
        for i in range(n):
            if i != k and rows[i][k] != 0:
                f = rows[i][k] / rows[k][k]
                rows[i] = [x - f * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [rows[k][n] / rows[k][k] for k in range(n)]


def dot(a: list[Fraction], b: list[Fraction]) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def exact_distance2(p: Array, q: Array) -> Fraction:
    """The least |sum l_i p_i - sum m_j q_j|^2 over weights that are not negative and sum to one: of all supports whose
    affine hulls have one pair of nearest points, which lies in both. Others have a smaller support as good."""
    P, Q = ([[Fraction(float(x)) for x in row] for row in t] for t in (p, q))
    best = None
    for I in SUPPORTS:  # noqa: N806
        for J in SUPPORTS:  # noqa: N806
            w = [a - b for a, b in zip(P[I[0]], Q[J[0]], strict=True)]
            span = [[a - b for a, b in zip(P[i], P[I[0]], strict=True)] for i in I[1:]]
            span += [[a - b for a, b in zip(Q[J[0]], Q[j], strict=True)] for j in J[1:]]
            x = solved([[dot(a, b) for b in span] for a in span], [-dot(a, w) for a in span])
            if x is None:
                continue
            mine, its = x[: len(I) - 1], x[len(I) - 1 :]
            if min([*mine, *its, 1 - sum(mine), 1 - sum(its)], default=0) < 0:
                continue
            r = [w[c] + sum(s * e[c] for s, e in zip(x, span, strict=True)) for c in range(3)]
            value = dot(r, r)
            best = value if best is None else min(best, value)
    assert best is not None
    return best


def sampled(kind: str, rng: np.random.Generator) -> tuple[Array, Array]:
    p, q = rng.normal(size=(3, 3)), rng.normal(size=(3, 3)) + rng.normal(size=3)
    if kind == "lattice":
        p, q = rng.integers(-2, 3, (3, 3)).astype(float), rng.integers(-2, 3, (3, 3)).astype(float)
    elif kind == "coplanar":
        p[:, 2] = q[:, 2] = 0.5
    elif kind == "parallel":
        p = np.round(p, 2)
        q = p + np.round(rng.normal(size=3), 1)
    elif kind == "near":
        q = p[rng.permutation(3)] + 1e-6 * rng.normal(size=(3, 3))
    elif kind == "shared corner":
        q[0] = p[1]
    elif kind == "shared edge":
        q[:2] = p[:2]
    elif kind == "sliver":
        p[2] = 0.3 * p[0] + 0.7 * p[1] + 1e-12 * rng.normal(size=3)
    elif kind == "segments":
        p[2], q[1] = p[0], q[0]
    elif kind == "points":
        p[1] = p[2] = p[0]
        q[1] = q[0]
    elif kind == "crossed nearly parallel":
        turn = 10.0 ** rng.uniform(-12, -4)
        p = np.array([[-1.0, 0, 0], [1, 0, 0], [0, -1e-3, -1]])
        q = np.array([[-1.0, turn, 1e-9], [1.1, -turn, 1e-9], [0, 1e-3, 1]])
    elif kind == "far":
        p, q = 1e-3 * p, 1e3 * q
    return p, q


KINDS = ["any", "lattice", "coplanar", "parallel", "near", "shared corner", "shared edge", "sliver", "segments", "points",
         "crossed nearly parallel", "far"]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_against_rational_arithmetic(kind):
    rng = np.random.default_rng(KINDS.index(kind))
    for _ in range(12):
        p, q = sampled(kind, rng)
        found = triangle_distance(p, q)
        size = max(np.abs(p).max(), np.abs(q).max())
        assert found.distance == pytest.approx(float(exact_distance2(p, q)) ** 0.5, rel=1e-12, abs=16 * 2.0**-52 * size)
        a, b = found.points
        assert np.linalg.norm(a - b) == pytest.approx(found.distance, rel=1e-9, abs=64 * 2.0**-52 * size)
        for point, triangle in ((a, p), (b, q)):  # the points are the triangles' own
            assert triangle_distance(np.array([point] * 3), triangle).distance <= 64 * 2.0**-52 * size


@pytest.mark.parametrize("kind", KINDS)
def test_zero_is_said_where_they_meet_and_nowhere_else(kind):
    rng = np.random.default_rng(100 + KINDS.index(kind))
    for _ in range(300):
        p, q = sampled(kind, rng)
        meet = triangle_relation(p, q)[0] != Relation.DISJOINT
        distance = triangle_distance(p, q).distance
        assert distance == 0.0 if meet else distance >= 0.0
        assert triangle_distance(q, p).distance == pytest.approx(distance, rel=1e-12, abs=1e-14 * np.abs([p, q]).max())


def test_against_a_general_minimiser():
    rng = np.random.default_rng(4)
    for _ in range(25):
        p, q = sampled("any", rng)

        def gap2(x, p=p, q=q):
            r = p[0] + x[0] * (p[1] - p[0]) + x[1] * (p[2] - p[0]) - q[0] - x[2] * (q[1] - q[0]) - x[3] * (q[2] - q[0])
            return r @ r

        sums = [{"type": "ineq", "fun": lambda x, k=k: 1.0 - x[k] - x[k + 1]} for k in (0, 2)]
        least = minimize(
            gap2, [0.3] * 4, bounds=[(0, 1)] * 4, constraints=sums, options={"ftol": 1e-14, "maxiter": 300}
        ).fun
        distance = triangle_distance(p, q).distance
        assert distance <= np.sqrt(max(least, 0.0)) + 1e-9
        assert distance == pytest.approx(np.sqrt(max(least, 0.0)), abs=2e-4)


@given(st.integers(0, 2**32 - 1), st.sampled_from(KINDS))
def test_names_of_corners_and_moves_do_not_matter(seed, kind):
    rng = np.random.default_rng(seed)
    p, q = sampled(kind, rng)
    size = max(np.abs(p).max(), np.abs(q).max())
    distance = triangle_distance(p, q).distance
    for order in permutations(range(3)):
        assert triangle_distance(p[list(order)], q).distance == pytest.approx(distance, rel=1e-12, abs=1e-14 * size)
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    moved = triangle_distance(p @ frame.T + 1.0, q @ frame.T + 1.0).distance
    assert moved == pytest.approx(distance, rel=1e-9, abs=1e-13 * (size + 1.0))
    for scale in (1e-6, 1e6):
        assert triangle_distance(scale * p, scale * q).distance == pytest.approx(
            scale * distance, rel=1e-9, abs=1e-13 * scale * size
        )


def test_numbers_that_are_none():
    p = np.eye(3)
    for bad in (np.nan, np.inf):
        q = p.copy()
        q[1, 1] = bad
        with pytest.raises(GeometryError, match="finite"):
            triangle_distance(p, q)
