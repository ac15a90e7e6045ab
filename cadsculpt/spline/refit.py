"""Refit of the control points to moved nodes (paper eq. 3).

The paper solves M = A_u P A_v^T for P by normal equations. Here the displacement of the nodes is fitted, by orthogonal
factors, with only those control points free whose support meets a node that moved: what did not move keeps its bits.

With fixed weights a rational surface stays linear and separable: for Q = w dP the data are W_kl D_kl, W = A_u w A_v^T.
Control points that are one point in space (the two sides of a seam, the repeats of a periodic net) are one unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

from ..errors import GeometryError
from ..jit import njit_in_place
from .matrices import design_matrix
from .surface import BSplineSurface

MOST_FACTORS = 32
"""Factorised windows that are remembered: nodes at the rim of a dent count as moved in one step and not in the next."""

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class RefitError:
    """Distance between the nodes and the refit surface, in the surface's unit."""

    maximum: float
    rms: float


@dataclass(slots=True, eq=False)
class Refit:
    """Least-squares refit of one patch on a fixed grid of node parameters; made once, solved every step.

    Attributes
    ----------
    A_u (m, r'), A_v (n, s') : basis at the node parameters, columns of tied control points added up.
    W (m, n) : denominator of the rational surface at the nodes; ones when not rational.
    free (r', s') : control points that may move.
    tie_u (r,), tie_v (s,) : the unknown that each control point row or column belongs to.
    """

    A_u: Array
    A_v: Array
    W: Array
    weights: Array
    free: Mask
    tie_u: NDArray[np.int64]
    tie_v: NDArray[np.int64]
    _factors: dict[tuple[int, int, int, int], _Factor] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls,
        surface: BSplineSurface,
        u: Array,
        v: Array,
        held: Mask | None = None,
        slivers: tuple[Sequence[tuple[float, float]], Sequence[tuple[float, float]]] = ((), ()),
    ) -> Refit:
        """Prepare the refit of `surface` to nodes at the grid u (m,) x v (n,).

        held (r, s): control points that must not move. slivers : knot spans along u and along v without nodes, whose
        control points move as one. A closed direction's nodes must not repeat the seam.
        Raises GeometryError naming the patch and the direction when the nodes do not determine the control points
        (the Schoenberg-Whitney condition).
        """
        tie_u = _joined(tied_rows(surface, 0), sliver_ties(surface.knots_u, surface.degree_u, slivers[0]))
        tie_v = _joined(tied_rows(surface, 1), sliver_ties(surface.knots_v, surface.degree_v, slivers[1]))
        free = np.ones((tie_u.max() + 1, tie_v.max() + 1), dtype=np.bool_)
        if held is not None:
            rows, columns = np.nonzero(held)
            free[tie_u[rows], tie_v[columns]] = False
        A_u = folded(design_matrix(surface.knots_u, surface.degree_u, u), tie_u)
        A_v = folded(design_matrix(surface.knots_v, surface.degree_v, v), tie_v)
        first_u = np.unique(tie_u, return_index=True)[1]
        first_v = np.unique(tie_v, return_index=True)[1]
        weights = np.ones(free.shape) if surface.weights is None else surface.weights[np.ix_(first_u, first_v)]
        W = np.ones((len(u), len(v))) if surface.weights is None else A_u @ weights @ A_v.T
        needed = (free.any(axis=1), free.any(axis=0))
        for label, matrix, use in (("u", A_u, needed[0]), ("v", A_v, needed[1])):
            if use.any() and np.linalg.matrix_rank(matrix[:, use]) < np.count_nonzero(use):
                raise GeometryError(
                    f"{matrix.shape[0]} nodes along {label} do not determine {np.count_nonzero(use)} control points",
                    where=surface.name or "surface",
                    mend="use a smaller node spacing",
                )
        return cls(A_u, A_v, W, weights, free, tie_u, tie_v)

    def fit(self, displacement: Array, threshold: float = 0.0, room: RefitRoom | None = None) -> Array:
        """Displacements (r, s, 3) of the control points for node displacements (m, n, 3).

        Only control points whose support meets a node that moved by more than `threshold` are free; the others get
        exactly zero. room : arrays to work in; the result is then one of them, and nothing is allocated while the
        control points that move stay the same and none among them is held.
        """
        room = RefitRoom.of(self) if room is None else room
        window = self.window(displacement, threshold, room)
        room.delta[...] = 0.0
        if window is not None:
            i0, i1, j0, j1 = window
            factor = self._factors.get(window)
            if factor is None:
                factor = self._factor(window)
                if len(self._factors) >= MOST_FACTORS:
                    self._factors.clear()
                self._factors[window] = factor
            rows, columns = factor.rows, factor.columns
            shape = rows.stop - rows.start, columns.stop - columns.start, 3
            data = shaped(room.data, shape)
            np.multiply(displacement[rows, columns], self.W[rows, columns, None], out=data)
            q = factor.solve(data, room)
            np.divide(q, self.weights[i0:i1, j0:j1, None], out=room.delta[i0:i1, j0:j1])
        np.take(room.delta, self.tie_u, axis=0, out=room.half, mode="clip")
        np.take(room.half, self.tie_v, axis=1, out=room.full, mode="clip")
        return room.full

    def surface_displacement(self, delta: Array) -> Array:
        """What control point displacements (r, s, 3) do to the surface at the nodes: (m, n, 3)."""
        first_u = np.unique(self.tie_u, return_index=True)[1]
        first_v = np.unique(self.tie_v, return_index=True)[1]
        q = delta[np.ix_(first_u, first_v)] * self.weights[..., None]
        moved: Array = np.einsum("mr,rsc,ns->mnc", self.A_u, q, self.A_v, optimize=True) / self.W[..., None]
        return moved

    def error(self, displacement: Array, delta: Array, counted: Mask | None = None) -> RefitError:
        """Distance between nodes and refit surface; counted (m, n) leaves out nodes that are not material."""
        distance = np.linalg.norm(displacement - self.surface_displacement(delta), axis=2)
        if counted is not None:
            distance = distance[counted]
        if distance.size == 0:
            return RefitError(0.0, 0.0)
        return RefitError(float(distance.max()), float(np.sqrt(np.mean(distance**2))))

    def window(
        self, displacement: Array, threshold: float, room: RefitRoom | None = None
    ) -> tuple[int, int, int, int] | None:
        """Index box [i0:i1, j0:j1] of the control points whose support meets a moved node; None when none moved."""
        room = RefitRoom.of(self) if room is None else room
        if not moved_box(displacement, threshold**2, room.reach_u, room.reach_v, room.box):
            return None
        i0, i1, j0, j1 = room.box.tolist()
        if room.all_free:
            return i0, i1, j0, j1
        inner = self.free[i0:i1, j0:j1]
        if not inner.any():
            return None
        rows, columns = np.flatnonzero(inner.any(axis=1)), np.flatnonzero(inner.any(axis=0))
        return i0 + int(rows[0]), i0 + int(rows[-1]) + 1, j0 + int(columns[0]), j0 + int(columns[-1]) + 1

    def _factor(self, window: tuple[int, int, int, int]) -> _Factor:
        i0, i1, j0, j1 = window
        A_u, A_v = self.A_u[:, i0:i1], self.A_v[:, j0:j1]
        rows = _touched(A_u)
        columns = _touched(A_v)
        A_u, A_v = A_u[rows], A_v[columns]
        free = self.free[i0:i1, j0:j1]
        if free.all():
            return _SeparableFactor(rows, columns, A_u, A_v)
        return _MaskedFactor(rows, columns, A_u, A_v, free)


@dataclass(slots=True, eq=False)
class RefitRoom:
    """Arrays that a refit works in, kept from step to step; not for two threads.

    reach_u (m, 2), reach_v (n, 2) : the first unknown in whose support each node lies, and the one behind the last.
    """

    all_free: bool
    reach_u: NDArray[np.int64]
    reach_v: NDArray[np.int64]
    box: NDArray[np.int64]
    data: Array
    rows: Array
    solved: Array
    delta: Array
    half: Array
    full: Array

    @classmethod
    def of(cls, refit: Refit) -> RefitRoom:
        (m, n), (r, s) = refit.W.shape, refit.free.shape
        return cls(
            bool(refit.free.all()), _reach(refit.A_u), _reach(refit.A_v), np.zeros(4, np.int64),
            np.empty(3 * m * n), np.empty(3 * r * n), np.empty(3 * r * s), np.empty((r, s, 3)),
            np.empty((len(refit.tie_u), s, 3)), np.empty((len(refit.tie_u), len(refit.tie_v), 3)),
        )  # fmt: skip


def shaped(numbers: Array, shape: tuple[int, int, int]) -> Array:
    """The first of these numbers as an array of this shape."""
    return numbers[: shape[0] * shape[1] * shape[2]].reshape(shape)


def _reach(matrix: Array) -> NDArray[np.int64]:
    used = matrix != 0.0
    return np.stack([used.argmax(axis=1), matrix.shape[1] - used[:, ::-1].argmax(axis=1)], axis=1)


@njit_in_place
def moved_box(
    displacement: Array, square: float, reach_u: NDArray[np.int64], reach_v: NDArray[np.int64], box: NDArray[np.int64]
) -> bool:
    """The box [i0, i1, j0, j1] of the unknowns in whose support nodes lie that moved by more than the root of `square`;
    False when none did."""
    box[0], box[1], box[2], box[3] = 2**62, 0, 2**62, 0
    for i in range(displacement.shape[0]):
        for j in range(displacement.shape[1]):
            x, y, z = displacement[i, j, 0], displacement[i, j, 1], displacement[i, j, 2]
            if x * x + y * y + z * z > square:
                box[0], box[1] = min(box[0], reach_u[i, 0]), max(box[1], reach_u[i, 1])
                box[2], box[3] = min(box[2], reach_v[j, 0]), max(box[3], reach_v[j, 1])
    return box[1] > 0


class _Factor(Protocol):
    """One factorised window: `solve` takes the weighted data of its rows and columns to Q."""

    rows: slice
    columns: slice

    def solve(self, data: Array, room: RefitRoom) -> Array: ...


class _SeparableFactor:
    """All control points of the window are free: two orthogonal factors, one per direction (eq. 3 without A^T A)."""

    def __init__(self, rows: slice, columns: slice, A_u: Array, A_v: Array) -> None:
        self.rows, self.columns = rows, columns
        self._pinv_u = _solver(A_u)
        self._pinv_v = _solver(A_v)

    def solve(self, data: Array, room: RefitRoom) -> Array:
        m, n, c = data.shape
        r, s = len(self._pinv_u), len(self._pinv_v)
        half, out = shaped(room.rows, (r, n, c)), shaped(room.solved, (r, s, c))
        np.matmul(self._pinv_u, data.reshape(m, n * c), out=half.reshape(r, n * c))
        np.matmul(self._pinv_v, half, out=out)
        return out


class _MaskedFactor:
    """Some control points inside the window are held: sparse normal equations, with iterative refinement."""

    def __init__(self, rows: slice, columns: slice, A_u: Array, A_v: Array, free: Mask) -> None:
        self.rows, self.columns = rows, columns
        self._A_u, self._A_v, self._free = A_u, A_v, free
        product = scipy.sparse.kron(
            scipy.sparse.csr_matrix(A_u.T @ A_u), scipy.sparse.csr_matrix(A_v.T @ A_v), format="csc"
        )
        index = np.flatnonzero(free.ravel())
        normal = product[index][:, index].tocsc()
        self._index = index
        self._lu = scipy.sparse.linalg.splu(
            normal, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )

    def solve(self, data: Array, room: RefitRoom) -> Array:
        q = np.zeros((*self._free.shape, 3))
        residual = data
        flat = q.reshape(-1, 3)
        for _ in range(2):  # the second pass takes back what squaring the condition number cost
            right = np.einsum("mr,mnc,ns->rsc", self._A_u, residual, self._A_v, optimize=True)
            flat[self._index] += self._lu.solve(np.ascontiguousarray(right.reshape(-1, 3)[self._index]))
            residual = data - np.einsum("mr,rsc,ns->mnc", self._A_u, q, self._A_v, optimize=True)
        return q


def held_control_points(surface: BSplineSurface, uv: Array, *, clearance: float = 1e-13) -> Mask:
    """Control points (r, s) that must not move if the surface is to stay where it is along the points uv (n, 2)."""
    (u0, u1), (v0, v1) = surface.domain
    held = np.zeros(surface.shape, dtype=np.bool_)
    basis_u = design_matrix(surface.knots_u, surface.degree_u, np.clip(uv[:, 0], u0, u1)) > clearance
    basis_v = design_matrix(surface.knots_v, surface.degree_v, np.clip(uv[:, 1], v0, v1)) > clearance
    for i in range(surface.shape[0]):
        held[i] = basis_v[basis_u[:, i]].any(axis=0)
    return held


def tied_rows(surface: BSplineSurface, axis: int) -> NDArray[np.int64]:
    """For each row of control points along `axis`, its unknown: rows that are one row in space share it."""
    count = surface.shape[axis]
    rows = np.arange(count)
    if (surface.periodic_u, surface.periodic_v)[axis]:
        return rows % (count - (surface.degree_u, surface.degree_v)[axis])
    first = np.take(surface.control_points, 0, axis)
    last = np.take(surface.control_points, count - 1, axis)
    same = np.abs(first - last).max() <= 1e-9 * max(surface.size, 1e-300)
    if surface.weights is not None:
        same = same and bool(
            np.allclose(np.take(surface.weights, 0, axis), np.take(surface.weights, count - 1, axis), rtol=1e-12)
        )
    if same and count > 2:
        rows[-1] = 0
    return rows


def sliver_ties(knots: Array, degree: int, slivers: Sequence[tuple[float, float]]) -> NDArray[np.int64]:
    """For each row of control points its unknown: rows whose Greville abscissae lie in one sliver share it."""
    count = len(knots) - degree - 1
    tie = np.arange(count)
    if not slivers:
        return tie
    greville = np.array([knots[i + 1 : i + degree + 1].mean() for i in range(count)])
    for low, high in slivers:
        index = np.flatnonzero((greville >= low) & (greville <= high))
        if len(index) > 1:
            tie[index] = tie[index[0]]
    return np.unique(tie, return_inverse=True)[1].astype(np.int64)


def _joined(first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows tied by either of two ties, by any chain of them: connected components, numbered in order."""
    both = first
    while True:
        before = both
        for tie in (first, second):
            lowest = np.full(tie.max() + 1, len(tie))
            np.minimum.at(lowest, tie, both)
            both = lowest[tie]
        if np.array_equal(both, before):
            return np.unique(both, return_inverse=True)[1].astype(np.int64)


def folded(matrix: Array, tie: NDArray[np.int64]) -> Array:
    """Columns of tied control points added up: (m, unknowns)."""
    result = np.zeros((len(matrix), tie.max() + 1))
    np.add.at(result.T, tie, matrix.T)
    return result


def _touched(matrix: Array) -> slice:
    rows = np.flatnonzero((matrix != 0.0).any(axis=1))
    return slice(int(rows[0]), int(rows[-1]) + 1)


def _solver(matrix: Array) -> Array:
    """The least-squares operator R^-1 Q^T (r, m) of a full-rank matrix (m, r)."""
    q, r = np.linalg.qr(matrix)
    return np.ascontiguousarray(scipy.linalg.solve_triangular(r, q.T))
