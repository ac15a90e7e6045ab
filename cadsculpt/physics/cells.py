"""The cells of a lattice: their volumes and axes, and what each adds to the lattice's springs and masses."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..jit import njit
from .calibrate import COMPONENTS, OFFSETS, cofactors, fit_weights

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DEGENERATE = 1e-9
"""A spring shorter than this share of its cell's longest one joins two nodes of one point (the pole of a sphere)."""

_CORNERS: NDArray[np.int64] = np.array([(a, b, c) for a in (0, 1) for b in (0, 1) for c in (0, 1)], dtype=np.int64)


@njit
def hexahedron_volume(p: Array) -> float:
    """Volume of the trilinear hexahedron with corners p (8, 3), corner (a, b, c) at 4 a + 2 b + c; its sign is that of
    (a, b, c). Exact, with three determinants (Grandy 1997, Efficient computation of volume of hexahedral cells).
    """
    volume = 0.0
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        # differences across the cell: opposite corners of the faces that meet in corner 7 and in corner 0
        a1, b1, c1 = p[7, x] - p[4, x], p[7, y] - p[2, y], p[7, z] - p[1, z]
        b2, c2 = p[7, z] - p[2, z], p[7, y] - p[1, y]
        a3, b3, c3 = p[3, x] - p[0, x], p[5, y] - p[0, y], p[6, z] - p[0, z]
        b4, c4 = p[5, z] - p[0, z], p[6, y] - p[0, y]
        volume += (a1 + a3) * (b1 * c3 - b2 * c4)
        volume += a3 * ((b1 + b3) * c1 - (b2 + b4) * c2)
        volume += a1 * (b3 * (c1 + c3) - b4 * (c2 + c4))
    return volume / 12.0


@njit
def _axes(p: Array, frame: Array) -> None:
    """Orthonormal axes (3, 3), one a row, nearest to the mean edges of the cell: polar factor by Newton's iteration
    R <- (R + R^-T) / 2 (Higham 1986).
    """
    for axis in range(3):
        step = 4 >> axis
        length = 0.0
        for c in range(3):
            edge = 0.0
            for corner in range(8):
                edge += p[corner, c] if corner & step else -p[corner, c]
            frame[axis, c] = edge
            length += edge * edge
        for c in range(3):
            frame[axis, c] /= math.sqrt(length)
    inverse = np.empty((3, 3))
    for _ in range(30):
        cofactors(frame, inverse)
        determinant = frame[0, 0] * inverse[0, 0] + frame[0, 1] * inverse[0, 1] + frame[0, 2] * inverse[0, 2]
        change = 0.0
        for a in range(3):
            for c in range(3):
                moved = 0.5 * (frame[a, c] + inverse[a, c] / determinant)
                change = max(change, abs(moved - frame[a, c]))
                frame[a, c] = moved
        if change < 1e-12:
            break


@njit
def calibrate_cells(
    nodes: Array,
    shape: tuple[int, int, int],
    wrap: tuple[bool, bool],
    cell_active: NDArray[np.bool_],
    cell_material: NDArray[np.int64],
    modulus: Array,
    density: Array,
    yield_strain: Array,
    hardening: Array,
    drag: Array,
    stiffness: Array,
    spring_yield: Array,
    spring_hardening: Array,
    mass: Array,
    volume: Array,
    gamma: Array,
) -> None:
    """Add every active cell's springs, mass and damping to the lattice's arrays.

    nodes (N, 3) [L]; cell_active (cu, cv, cl), cell_material (cu, cv, cl); per material modulus [N/L^2], density [N
    s^2/L^4], yield_strain (of a spring), hardening, drag [1/s]. Adds to stiffness (13, N) [N/L], mass (N,), volume
    (N,) [L^3], gamma (N,); a spring shared by cells of several materials yields as the weakest of them.
    """
    nu, nv, nl = shape
    index = np.empty(8, dtype=np.int64)
    p = np.empty((8, 3))
    frame = np.empty((3, 3))
    w = np.empty(13)
    squares = np.empty((13, 4, 3))
    tensor = np.empty((13, 15))
    present = np.empty(13, dtype=np.bool_)
    pairs = np.empty((13, 4, 2), dtype=np.int64)
    lengths = np.empty((13, 4))
    n = np.empty(3)
    for i in range(cell_active.shape[0]):
        for j in range(cell_active.shape[1]):
            for k in range(cell_active.shape[2]):
                if not cell_active[i, j, k]:
                    continue
                for corner in range(8):
                    a = (i + _CORNERS[corner, 0]) % nu
                    b = (j + _CORNERS[corner, 1]) % nv
                    index[corner] = (a * nv + b) * nl + k + _CORNERS[corner, 2]
                    for c in range(3):
                        p[corner, c] = nodes[index[corner], c]
                cell_volume = abs(hexahedron_volume(p))
                _axes(p, frame)
                longest = 0.0
                for s in range(13):
                    count = 0
                    for corner in range(8):
                        end = 0
                        inside = True
                        for c in range(3):
                            to = _CORNERS[corner, c] + OFFSETS[s, c]
                            inside = inside and 0 <= to <= 1
                            end = 2 * end + to
                        if inside:
                            pairs[s, count, 0] = corner
                            pairs[s, count, 1] = end
                            length = 0.0
                            for c in range(3):
                                length += (p[end, c] - p[corner, c]) ** 2
                            lengths[s, count] = math.sqrt(length)
                            longest = max(longest, lengths[s, count])
                            count += 1
                    for copy in range(count, 4):
                        pairs[s, copy, 0] = -1
                for s in range(13):
                    count = 0
                    for m in range(15):
                        tensor[s, m] = 0.0
                    for copy in range(4):
                        for a in range(3):
                            squares[s, copy, a] = 0.0
                        if pairs[s, copy, 0] < 0 or lengths[s, copy] <= DEGENERATE * longest:
                            continue
                        count += 1
                        for a in range(3):
                            n[a] = 0.0
                            for c in range(3):
                                n[a] += frame[a, c] * (p[pairs[s, copy, 1], c] - p[pairs[s, copy, 0], c])
                            n[a] /= lengths[s, copy]
                            squares[s, copy, a] = n[a] * n[a]
                        for m in range(15):
                            tensor[s, m] += (
                                n[COMPONENTS[m, 0]] * n[COMPONENTS[m, 1]] * n[COMPONENTS[m, 2]] * n[COMPONENTS[m, 3]]
                            )
                    present[s] = count > 0
                    if count > 0:
                        for m in range(15):
                            tensor[s, m] /= count
                fit_weights(squares, tensor, present, w)
                material = cell_material[i, j, k]
                for s in range(13):
                    copies = 0
                    for copy in range(4):
                        if pairs[s, copy, 0] >= 0 and lengths[s, copy] > DEGENERATE * longest:
                            copies += 1
                    for copy in range(4):
                        if pairs[s, copy, 0] < 0:
                            continue
                        node = index[pairs[s, copy, 0]]
                        if lengths[s, copy] <= DEGENERATE * longest:
                            # two nodes of one point are tied as firmly as a cube's edge, and never yield
                            stiffness[s, node] += 0.1 * modulus[material] * cell_volume ** (1.0 / 3.0)
                            continue
                        share = w[s] * modulus[material] * cell_volume / (copies * lengths[s, copy] ** 2)
                        stiffness[s, node] += share
                        if share > 0.0 and yield_strain[material] < spring_yield[s, node]:
                            spring_yield[s, node] = yield_strain[material]
                            spring_hardening[s, node] = hardening[material]
                for corner in range(8):
                    node = index[corner]
                    volume[node] += cell_volume / 8.0
                    mass[node] += density[material] * cell_volume / 8.0
                    gamma[node] += drag[material] * density[material] * cell_volume / 8.0
