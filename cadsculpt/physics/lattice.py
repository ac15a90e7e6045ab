"""The hexahedral mass-spring lattice at rest (paper section 4.8, fig. 7): nodes, springs, masses, anchors.

Conventions ----------- Lengths are in the scene's unit L, of `metres_per_unit` metres; forces are in N and times in
s. So that F [N] = m a with a in L/s^2, masses are m = kg * metres_per_unit. Stiffness is in N/L, stress and modulus
inside the engine in N/L^2 (= Pa * metres_per_unit^2), damping coefficients gamma in N s/L, energy in N L (= J /
metres_per_unit). Node (i, j, k) has the flat index (i * nv + j) * nl + k; i runs along u, j along v, k inward from
the surface (k = 0). Spring (d, n) runs from node n in direction OFFSETS[d]; where there is none, its stiffness is 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from .calibrate import OFFSETS, spring_flow
from .cells import calibrate_cells
from .fold import check_folds
from .material import Material
from .stability import largest_drag, least_bound
from .ties import NO_TIES, TiedNodes

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

CHUNK = 1024
"""Nodes that a pass over the springs takes at a time: their positions and forces stay in the first-level cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """The rest state of one lattice of N = nu * nv * nl nodes. Immutable; shapes and units as in the module's
    Conventions.

    shape : (nu, nv, nl), nl = layers + 1. wrap : the direction is closed, its last node is followed by its first. u
    (nu,), v (nv,) : parameters of the surface nodes. period : length of the domain of a closed direction. nodes (N,
    3) : rest positions. offsets (13, 3) : spring directions in node steps. stiffness (13, N), rest_length (13, N),
    yield_strain (13, N), hardening (13, N) : per spring; yield_strain is the spring's own, inf where elastic,
    hardening its tangent modulus after yield over that before, below 1. mass (N,), gamma (N,) : of eq. 4. volume (N,)
    : of the material that a node stands for [L^3]. anchored (N,) : nodes that keep the velocity they are given
    (none). active (N,) : nodes of at least one cell. inverse_mass (N,) : 0 for nodes that do not move freely.
    cell_active (cu, cv), cell_material (cu, cv, layers) : cells, index into the materials. thickness, spacing :
    thickness and edge of a cube of the mean cell's volume [L]. plastic : some spring can yield. right_handed : (u, v,
    inward) is. highest_frequency : an upper bound of the squared angular frequencies at rest [1/s^2], frequency_scale
    (N,) : what gives it (stability.py). highest_drag : the largest gamma / m [1/s]. shortest : spring [L]. segments (M, 4)
    : direction, start, stop, shift: runs of springs (d, n), n in [start, stop), that end at n + shift. ties : nodes that
    follow others (assembly.py). free (b, 3) : what nothing holds, as runs of nodes: body, first node, last node + 1, the
    runs of a body one behind the other. grids : first node, shape and wrap of each lattice that this one is assembled from
    (empty: of itself).
    """

    shape: tuple[int, int, int]
    wrap: tuple[bool, bool]
    u: Array
    v: Array
    period: tuple[float, float]
    nodes: Array
    offsets: Index
    stiffness: Array
    rest_length: Array
    yield_strain: Array
    hardening: Array
    mass: Array
    gamma: Array
    volume: Array
    anchored: Mask
    active: Mask
    inverse_mass: Array
    cell_active: Mask
    cell_material: Index
    thickness: float
    spacing: float
    plastic: bool
    right_handed: bool
    segments: Index
    highest_frequency: float
    frequency_scale: Array
    highest_drag: float
    shortest: float
    metres_per_unit: float
    ties: TiedNodes = NO_TIES
    free: Index = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    grids: tuple[tuple[int, tuple[int, int, int], tuple[bool, bool]], ...] = ()


def build_lattice(
    points: Array,
    inward: Array,
    u: ArrayLike,
    v: ArrayLike,
    *,
    thickness: float,
    layers: int,
    material: Material | Sequence[Material],
    cell_material: NDArray[np.integer] | None = None,
    wrap: tuple[bool, bool] = (False, False),
    period: tuple[float, float] | None = None,
    anchored: Mask | None = None,
    cell_active: Mask | None = None,
    metres_per_unit: float,
) -> Lattice:
    """The lattice below a surface: its node grid and `layers` copies of it inward over `thickness` [L].

    points (nu, nv, 3) : surface nodes. inward (nu, nv, 3) : unit normals into the material. u (nu,), v (nv,) : their
    parameters, increasing; a closed direction leaves out the node that repeats the first, and needs its `period`.
    material : one, or a list with cell_material (cu, cv) or (cu, cv, layers) holding each cell's index. anchored (nu,
    nv, layers + 1) : nodes that are held. cell_active (cu, cv) : columns of cells that exist, default all.

    Spring constants are calibrated cell by cell (calibrate.py, cells.py) and added up. The damping coefficient of eq.
    4 is

        gamma_i = 2 damping omega m_i,    omega = (pi / 2) sqrt(1.2 E / density) / thickness,

    the fraction of critical for the lowest thickness mode, a layer on a fixed base that stretches along its normal.
    It does not depend on the node spacing.

    Raises InputError for wrong shapes and numbers, and for a lattice that folds because the thickness exceeds the
    radius of curvature; it says where and which thickness would do.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    inward = np.ascontiguousarray(inward, dtype=np.float64)
    u = np.ascontiguousarray(u, dtype=np.float64)
    v = np.ascontiguousarray(v, dtype=np.float64)
    period = _checked_grid(points, inward, u, v, thickness, layers, wrap, period, metres_per_unit)
    nu, nv, nl = points.shape[0], points.shape[1], layers + 1
    cu, cv = nu if wrap[0] else nu - 1, nv if wrap[1] else nv - 1
    columns = _shaped(cell_active, (cu, cv), np.bool_, "cell_active", True)
    held = _shaped(anchored, (nu, nv, nl), np.bool_, "anchored", False).ravel()
    materials = [material] if isinstance(material, Material) else list(material)
    if cell_material is not None and np.ndim(cell_material) == 2:
        cell_material = np.repeat(np.asarray(cell_material)[:, :, None], layers, axis=2)
    of_cell = _shaped(cell_material, (cu, cv, layers), np.int64, "cell_material", 0)
    if not materials or of_cell.min() < 0 or of_cell.max() >= len(materials):
        raise InputError(f"cell_material names materials beyond the {len(materials)} given")
    if not columns.any():
        raise InputError("the lattice has no cell", mend="activate at least one cell")
    right_handed = check_folds(points, inward, u, v, thickness, wrap, columns)

    depth = thickness * (np.arange(nl) / layers)
    nodes = (points[:, :, None, :] + depth[:, None] * inward[:, :, None, :]).reshape(-1, 3)
    count = len(nodes)
    stiffness, hardening = np.zeros((13, count)), np.zeros((13, count))
    yield_strain = np.full((13, count), math.inf)
    mass, gamma, volume = np.zeros(count), np.zeros(count), np.zeros(count)
    flow = [spring_flow(m.yield_strain, m.hardening) for m in materials]
    speed = [math.sqrt(1.2 * m.youngs_modulus / m.density) / metres_per_unit for m in materials]
    calibrate_cells(
        nodes,
        (nu, nv, nl),
        wrap,
        np.ascontiguousarray(np.repeat(columns[:, :, None], layers, axis=2)),
        of_cell,
        np.array([m.youngs_modulus * metres_per_unit**2 for m in materials]),
        np.array([m.density * metres_per_unit**4 for m in materials]),
        np.array([y for y, _ in flow]),
        np.array([g for _, g in flow]),
        np.array([math.pi * m.damping * c / thickness for m, c in zip(materials, speed, strict=True)]),
        stiffness,
        yield_strain,
        hardening,
        mass,
        volume,
        gamma,
    )
    if not np.isfinite(stiffness).all():
        raise InputError("a cell of the lattice has no volume", mend="two rows of surface nodes must not coincide")
    segments = spring_segments((nu, nv, nl), wrap)
    rest_length = np.zeros((13, count))
    for d, start, stop, shift in segments:
        rest_length[d, start:stop] = spring_lengths(nodes, start, stop, shift)
    rest_length[stiffness == 0.0] = 0.0
    active = mass > 0.0
    inverse_mass = np.zeros(count)
    free = active & ~held
    inverse_mass[free] = 1.0 / mass[free]
    frequency, scale = least_bound(segments, stiffness, rest_length, inverse_mass, nodes, NO_TIES)
    return Lattice(
        shape=(nu, nv, nl),
        wrap=(bool(wrap[0]), bool(wrap[1])),
        u=u,
        v=v,
        period=period,
        nodes=nodes,
        offsets=OFFSETS,
        stiffness=stiffness,
        rest_length=rest_length,
        yield_strain=yield_strain,
        hardening=hardening,
        mass=mass,
        gamma=gamma,
        volume=volume,
        anchored=held,
        active=active,
        inverse_mass=inverse_mass,
        cell_active=columns,
        cell_material=of_cell,
        thickness=float(thickness),
        spacing=float(volume.sum() / (np.count_nonzero(columns) * layers)) ** (1.0 / 3.0),
        plastic=bool(np.isfinite(yield_strain).any()),
        right_handed=right_handed,
        segments=segments,
        highest_frequency=frequency,
        frequency_scale=scale,
        highest_drag=largest_drag(gamma, inverse_mass),
        shortest=float(rest_length[rest_length > 0.0].min(initial=math.inf)),
        metres_per_unit=float(metres_per_unit),
        free=np.array([] if (held & active).any() else [(0, 0, count)], dtype=np.int64).reshape(-1, 3),
    )


def spring_lengths(x: Array, start: int, stop: int, shift: int) -> Array:
    """Lengths of a run of springs (segments), for nodes at x (N, 3). Ends beyond the arrays belong to no spring: 0."""
    lengths = np.zeros(stop - start)
    low, high = max(start, -shift), min(stop, len(x) - shift)
    lengths[low - start : high - start] = np.linalg.norm(x[low + shift : high + shift] - x[low:high], axis=1)
    return lengths


def spring_segments(shape: tuple[int, int, int], wrap: tuple[bool, bool]) -> Index:
    """The springs as runs of constant shift: rows (direction, start, stop, shift), for the kernels.

    Runs are grouped by chunks of about CHUNK nodes (one row of nodes when v wraps), so that the kernels stay in
    cache. Nodes of a run that have no such spring (the last layer has none inward) have stiffness 0; their n + shift
    may lie one node beyond the arrays, which the kernels pad.
    """
    nu, nv, nl = shape
    row, count = nv * nl, nu * nv * nl
    rows = []
    chunk = row if wrap[1] else row * max(1, CHUNK // row)
    for low in range(0, count, chunk):
        high = min(low + chunk, count)
        for d, (di, dj, dk) in enumerate(OFFSETS):
            # the last row of nodes along u is followed by the first one, or by nothing
            last = count - row
            parts = [(low, min(high, last), 0), (max(low, last), high, -count)] if di else [(low, high, 0)]
            if di and not wrap[0]:
                parts.pop()
            for start, stop, turn_u in parts:
                if start >= stop:
                    continue
                shift = int((di * nv + dj) * nl + dk + turn_u)
                if dj == 0 or not wrap[1]:
                    if not wrap[1]:
                        stop = min(stop, count - (shift - dk))
                        start = max(start, -(shift - dk))
                    if start < stop:
                        rows.append((d, start, stop, shift))
                elif dj > 0:
                    rows.append((d, start, stop - nl, shift))
                    rows.append((d, stop - nl, stop, shift - row))
                else:
                    rows.append((d, start, start + nl, shift + row))
                    rows.append((d, start + nl, stop, shift))
    return np.array(rows, dtype=np.int64)


def grids(lattice: Lattice) -> tuple[tuple[int, tuple[int, int, int], tuple[bool, bool]], ...]:
    """`Lattice.grids`, the lattice's own where it is not assembled."""
    return lattice.grids or ((0, lattice.shape, lattice.wrap),)


def grid_shape(lattice: Lattice) -> tuple[int, int, int]:
    """`shape` of a lattice with a grid. Raises InputError for an assembly of several."""
    if not len(lattice.u):
        raise InputError("an assembly of lattices has no grid", mend="ask its parts one by one")
    return lattice.shape


def hexahedra(lattice: Lattice) -> Index:
    """Node indices (cu * cv * layers, 8) of all cells, C-ordered as `cell_material`, in VTK's order, volumes
    positive. Raises InputError for an assembly, which has no grid.
    """
    nu, nv, nl = grid_shape(lattice)
    i, j, k = np.meshgrid(*(np.arange(n) for n in lattice.cell_material.shape), indexing="ij")
    corners = []
    for dk in (0, 1):
        loop = [(0, 0), (1, 0), (1, 1), (0, 1)]
        for di, dj in loop if lattice.right_handed else [(b, a) for a, b in loop]:
            corners.append((((i + di) % nu) * nv + (j + dj) % nv) * nl + k + dk)
    return np.stack(corners, axis=-1).reshape(-1, 8).astype(np.int64)


def _checked_grid(
    points: Array,
    inward: Array,
    u: Array,
    v: Array,
    thickness: float,
    layers: int,
    wrap: tuple[bool, bool],
    period: tuple[float, float] | None,
    metres_per_unit: float,
) -> tuple[float, float]:
    """Check what `build_lattice` was given; returns the period of each direction, 0 where it is open."""
    if points.ndim != 3 or points.shape[2] != 3 or inward.shape != points.shape:
        raise InputError(f"points {points.shape} and inward {inward.shape} must both be (nu, nv, 3)")
    if u.shape != points.shape[:1] or v.shape != points.shape[1:2]:
        raise InputError(f"u {u.shape} and v {v.shape} do not belong to a {points.shape[0]} x {points.shape[1]} grid")
    for name, numbers in (("points", points), ("inward", inward), ("u", u), ("v", v)):
        if not np.isfinite(numbers).all():
            raise InputError(f"{name} holds a number that is not finite")
    if np.abs(np.linalg.norm(inward, axis=2) - 1.0).max() > 1e-6:
        raise InputError("the inward normals are not of length 1")
    for name, value in (("thickness", thickness), ("metres_per_unit", metres_per_unit)):
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"{name} is {value}", mend="it must be a positive number")
    if layers < 1:
        raise InputError(f"{layers} layers", mend="a lattice needs at least one")
    given = period or (0.0, 0.0)
    periods = []
    for axis, (name, t) in enumerate((("u", u), ("v", v))):
        if len(t) < (3 if wrap[axis] else 2):
            raise InputError(
                f"{len(t)} nodes along {name}", mend="a lattice needs two, and three around a closed direction"
            )
        if (np.diff(t) <= 0.0).any():
            raise InputError(f"the node parameters along {name} do not increase")
        if wrap[axis] and not given[axis] > t[-1] - t[0]:
            raise InputError(
                f"{name} is closed and its period is {given[axis]:g}",
                mend=f"it must exceed {t[-1] - t[0]:g}, its nodes' span",
            )
        periods.append(float(given[axis]) if wrap[axis] else 0.0)
    return periods[0], periods[1]


def _shaped(array: NDArray[Any] | None, shape: tuple[int, ...], dtype: type, name: str, default: int) -> NDArray[Any]:
    """`array` as a contiguous array of the dtype, checked to have the shape; filled with `default` when None."""
    if array is None:
        return np.full(shape, default, dtype=dtype)
    if np.shape(array) != shape:
        raise InputError(f"{name} is {np.shape(array)}", mend=f"it must be {shape}")
    return np.ascontiguousarray(array, dtype=dtype)
