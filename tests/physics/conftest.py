"""Lattices to test: slabs of any cells, single springs, and the linear algebra to compare them with."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.sparse as sp
from numpy.typing import NDArray

from cadsculpt.physics import implicit
from cadsculpt.physics.calibrate import OFFSETS
from cadsculpt.physics.explicit import ContactLoad
from cadsculpt.physics.lattice import Lattice, build_lattice, spring_segments
from cadsculpt.physics.material import Material
from cadsculpt.physics.stability import largest_drag, least_bound
from cadsculpt.physics.ties import NO_TIES

Array = NDArray[np.float64]
MM = 1e-3


@pytest.fixture(scope="session")
def slab() -> Callable[..., Lattice]:
    """slab(nodes along u, along v, layers, steps=(a, b, c), material=..., move=...) : a slab in mm, surface at z =
    0.
    """

    def make(
        nu: int,
        nv: int,
        layers: int,
        *,
        steps: tuple[float, float, float] = (1.0, 1.0, 1.0),
        material: Material | list[Material] | None = None,
        move: Callable[[Array], Array] | None = None,
        base: bool = False,
        **options: object,
    ) -> Lattice:
        x, y = np.meshgrid(np.arange(nu) * steps[0], np.arange(nv) * steps[1], indexing="ij")
        points = np.stack([x, y, np.zeros_like(x)], axis=-1)
        inward = np.zeros_like(points)
        inward[..., 2] = -1.0
        if move is not None:
            points = move(points)
        if base:
            options["anchored"] = np.zeros((nu, nv, layers + 1), dtype=bool)
            options["anchored"][:, :, -1] = True  # type: ignore[index]
        return build_lattice(
            points,
            inward,
            np.arange(nu, dtype=float),
            np.arange(nv, dtype=float),
            thickness=layers * steps[2],
            layers=layers,
            material=material or Material(1e6, 1000.0, damping=0.0),
            metres_per_unit=MM,
            **options,  # type: ignore[arg-type]
        )

    return make


@pytest.fixture(scope="session")
def chain() -> Callable[..., Lattice]:
    """chain(masses, stiffnesses, ...) : point masses in a row along u, one unit apart, joined by single springs."""

    def make(
        masses: list[float],
        stiffness: list[float],
        *,
        yield_strain: float = np.inf,
        hardening: float = 0.0,
        gamma: float = 0.0,
        held: tuple[int, ...] = (0,),
    ) -> Lattice:
        n = len(masses)
        nodes = np.zeros((n, 3))
        nodes[:, 0] = np.arange(n)
        springs, lengths = np.zeros((13, n)), np.zeros((13, n))
        springs[0, : n - 1] = stiffness
        lengths[0, : n - 1] = 1.0
        mass = np.array(masses, dtype=float)
        anchored = np.isin(np.arange(n), held)
        inverse_mass = np.where(anchored, 0.0, 1.0 / mass)
        segments = spring_segments((n, 1, 1), (False, False))
        frequency, scale = least_bound(segments, springs, lengths, inverse_mass, nodes, NO_TIES)
        return Lattice(
            shape=(n, 1, 1),
            wrap=(False, False),
            u=np.arange(n, dtype=float),
            v=np.zeros(1),
            period=(0.0, 0.0),
            nodes=nodes,
            offsets=OFFSETS,
            stiffness=springs,
            rest_length=lengths,
            yield_strain=np.where(springs > 0.0, yield_strain, np.inf),
            hardening=np.full((13, n), hardening),
            mass=mass,
            gamma=gamma * mass,
            volume=np.ones(n),
            anchored=anchored,
            active=np.ones(n, dtype=bool),
            inverse_mass=inverse_mass,
            cell_active=np.zeros((n - 1, 0), dtype=bool),
            cell_material=np.zeros((n - 1, 0, 0), dtype=np.int64),
            thickness=1.0,
            spacing=1.0,
            plastic=bool(np.isfinite(yield_strain)),
            right_handed=True,
            segments=segments,
            highest_frequency=frequency,
            frequency_scale=scale,
            highest_drag=largest_drag(gamma * mass, inverse_mass),
            shortest=1.0,
            metres_per_unit=MM,
            free=np.array([] if held else [(0, 0, n)], dtype=np.int64).reshape(-1, 3),
        )

    return make


@dataclass(frozen=True)
class Springs:
    """The springs of a lattice, found from its offsets and wrapping alone (not from its segments)."""

    start: NDArray[np.int64]
    end: NDArray[np.int64]
    direction: NDArray[np.int64]


@pytest.fixture(scope="session")
def springs() -> Callable[[Lattice], Springs]:
    def find(lattice: Lattice) -> Springs:
        nu, nv, nl = lattice.shape
        starts, ends, directions = [], [], []
        for d, (di, dj, dk) in enumerate(lattice.offsets):
            n = np.flatnonzero(lattice.stiffness[d] > 0.0)
            i, j, k = n // (nv * nl) + di, n // nl % nv + dj, n % nl + dk
            assert ((k >= 0) & (k < nl)).all()
            assert lattice.wrap[0] or ((i >= 0) & (i < nu)).all()
            assert lattice.wrap[1] or ((j >= 0) & (j < nv)).all()
            starts.append(n)
            ends.append(((i % nu) * nv + j % nv) * nl + k)
            directions.append(np.full(len(n), d))
        return Springs(np.concatenate(starts), np.concatenate(ends), np.concatenate(directions))

    return find


@pytest.fixture(scope="session")
def tangent(springs: Callable[[Lattice], Springs]) -> Callable[..., sp.csc_matrix]:
    """tangent(lattice, x) : the (3N, 3N) stiffness matrix at positions x, assembled spring by spring."""

    def assemble(lattice: Lattice, x: Array | None = None) -> sp.csc_matrix:
        x = lattice.nodes if x is None else x
        s = springs(lattice)
        vector = x[s.end] - x[s.start]
        length = np.linalg.norm(vector, axis=1)
        n = vector / length[:, None]
        k = lattice.stiffness[s.direction, s.start]
        side = k * (1.0 - lattice.rest_length[s.direction, s.start] / length)
        blocks = (k - side)[:, None, None] * n[:, :, None] * n[:, None, :] + side[:, None, None] * np.eye(3)
        rows, columns, values = [], [], []
        for a, b, sign in ((s.start, s.start, 1), (s.end, s.end, 1), (s.start, s.end, -1), (s.end, s.start, -1)):
            rows.append(np.broadcast_to(3 * a[:, None, None] + np.arange(3)[:, None], blocks.shape).ravel())
            columns.append(np.broadcast_to(3 * b[:, None, None] + np.arange(3), blocks.shape).ravel())
            values.append((sign * blocks).ravel())
        size = 3 * len(x)
        return sp.csc_matrix(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(size, size)
        )

    return assemble


@pytest.fixture(scope="session")
def contact() -> Callable[..., ContactLoad]:
    """contact(nodes, weights, depth=..., ...) : a load of n like contacts, arrays or scalars for the rest."""

    def make(
        nodes: NDArray[np.int64],
        weights: Array,
        *,
        depth: float | Array = 0.0,
        normal: tuple[float, float, float] = (0.0, 0.0, 1.0),
        velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
        area: float = 1.0,
        stiffness: float = 1.0,
        damping: float = 0.0,
        friction: float = 0.0,
    ) -> ContactLoad:
        n = len(nodes)

        def column(value: float | Array) -> Array:
            return np.array(np.broadcast_to(value, n), dtype=float)

        return ContactLoad(
            nodes=np.ascontiguousarray(nodes, dtype=np.int64),
            weights=np.ascontiguousarray(weights, dtype=float),
            normal=np.tile(np.array(normal, dtype=float), (n, 1)),
            depth=column(depth),
            area=column(area),
            velocity=np.tile(np.array(velocity, dtype=float), (n, 1)),
            stiffness=column(stiffness),
            damping=column(damping),
            friction=column(friction),
        )

    return make


@pytest.fixture(scope="session")
def residual_along() -> Callable[..., Array]:
    """residual_along(problem, x, d, duals) : the derivative of an implicit step's residual along d at x, by differences."""

    def derivative(problem: implicit._Problem, x: Array, d: Array, duals: implicit._Duals) -> Array:
        small = 1e-6 / np.abs(d).max()
        ahead, behind = (implicit._balance(problem, x + sign * small * d, duals).residual for sign in (1.0, -1.0))
        return (ahead - behind) / (2 * small)

    return derivative


@pytest.fixture(scope="session")
def on_a_bonded_layer() -> Callable[[float], float]:
    """on_a_bonded_layer(a / h) : the force of a rigid sphere on a layer of thickness h, bonded to a rigid base, over Hertz's;
    a = sqrt(R d), Poisson's ratio 1/4 (Dimitriadis et al. 2002, eq. 11).
    """

    def factor(chi: float) -> float:
        ratio = 0.25
        a = -(1.2876 - 1.4678 * ratio + 1.3442 * ratio**2) / (1 - ratio)
        b = (0.6387 - 1.0277 * ratio + 1.5164 * ratio**2) / (1 - ratio)
        return (
            1
            - 2 * a / math.pi * chi
            + 4 * (a / math.pi * chi) ** 2
            - 8 / math.pi**3 * (a**3 + 4 * math.pi**2 / 15 * b) * chi**3
            + 16 * a / math.pi**4 * (a**3 + 3 * math.pi**2 / 5 * b) * chi**4
        )

    return factor
