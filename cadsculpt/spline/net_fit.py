"""Least-squares fit of node displacements on one net, some of whose control points are given (paper eq. 3).

The same equations as in `refit`, for nets that change while a fit looks for its knots: closed surfaces stay closed and
smooth, what lies beyond the nodes stays, control points may be given a displacement instead of none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

from ..errors import GeometryError
from .equations import Asked, displacement_along, equation_rows, places
from .joints import Joint, joints, unknowns
from .matrices import breakpoints, design_matrix
from .surface import BSplineSurface

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Span = tuple[float, float]
Window = tuple[Span, Span]

WORST_CONDITION = 100.0
"""Condition number of a direction's basis, over 4^degree, above which the nodes say too little of some control point, and
the surface would swing between them."""

FIRST = 3.0
"""What is asked along curves comes before the nodes, by this, where the tolerances are alike."""

SINGULAR = 1e13
"""Condition number above which a direction's basis has not full rank."""


@dataclass(frozen=True, slots=True, eq=False)
class NodeField:
    """What a refit follows: the displacement (m, n, 3) of nodes at u (m,) x v (n,).

    counted (m, n) : nodes that are material, whose distance is an error. closed : the direction is closed, and its last
    node, the first one again, is left out. slivers : knot spans without nodes, along u and along v.
    joints : where the surface must stay as smooth as it is, along u and along v.
    """

    u: Array
    v: Array
    displacement: Array
    counted: Mask
    closed: tuple[bool, bool]
    slivers: tuple[list[Span], list[Span]]
    joints: tuple[tuple[Joint, ...], tuple[Joint, ...]]

    @classmethod
    def of(
        cls,
        surface: BSplineSurface,
        u: Array,
        v: Array,
        displacement: Array,
        *,
        counted: Mask | None = None,
        closed: tuple[bool, bool] = (False, False),
        slivers: tuple[list[Span], list[Span]] | None = None,
    ) -> NodeField:
        """Nodes that cover a piece of the domain; beyond it the surface stays, which is said by nodes that do not move."""
        if displacement.shape != (len(u), len(v), 3) or not np.isfinite(displacement).all():
            raise GeometryError("displacements that are not finite, or not one a node", where=surface.name or "surface")
        counted = np.ones((len(u), len(v)), dtype=np.bool_) if counted is None else counted
        grid = [u, v]
        for axis in (0, 1):
            if closed[axis]:
                continue
            before, after = _beyond(surface, axis, grid[axis])
            grid[axis] = np.concatenate([before, grid[axis], after])
            pad = [(0, 0), (0, 0), (0, 0)]
            pad[axis] = (len(before), len(after))
            displacement = np.pad(displacement, pad)
            counted = np.pad(counted, pad[:2])
        smooth = joints(surface, 0), joints(surface, 1)
        return cls(grid[0], grid[1], displacement, counted, closed, slivers or ([], []), smooth)

    def moved(self, threshold: float) -> Mask:
        """Nodes (m, n) that moved by more than the threshold."""
        return np.einsum("mnc,mnc->mn", self.displacement, self.displacement) > threshold**2


def still_sides(surface: BSplineSurface, field: NodeField, threshold: float, depth: int = 1) -> list[Array]:
    """The sides of the domain, as chains uv (2, 2), on which there are nodes, of which none moved by more than the threshold,
    nor any in the first `depth` rows."""
    moved, corners = field.moved(threshold), np.array(surface.domain)
    found = []
    for axis in (0, 1):
        t = (field.u, field.v)[axis]
        for end, rows in ((0, range(depth)), (1, range(-depth, 0))):
            index = 0 if end == 0 else -1
            if field.closed[axis] or t[index] != corners[axis, end] or moved.take(rows, axis, mode="wrap").any():
                continue
            side = corners.T.copy()
            side[:, axis] = corners[axis, end]
            found.append(side)
    return found


def _beyond(surface: BSplineSurface, axis: int, t: Array) -> tuple[Array, Array]:
    """Parameters before and after those of the nodes: enough in each of the next knot spans to say what stays."""
    degree = (surface.degree_u, surface.degree_v)[axis]
    borders = breakpoints((surface.knots_u, surface.knots_v)[axis], degree)
    parts = []
    for ends in (np.concatenate([[-t[0]], -borders[borders < t[0]][::-1]]), [t[-1], *borders[borders > t[-1]]]):
        ends = np.array(ends[: degree + 2])
        share = np.arange(1, degree + 2) / (degree + 1)
        parts.append((ends[:-1, None] + np.diff(ends)[:, None] * share).ravel())
    return -parts[0][::-1], parts[1]


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """Control points (r, s) whose displacement (r, s, 3) is given, zero where it is None; and what is asked elsewhere, before
    the nodes, as well as the net can."""

    mask: Mask
    displacement: Array | None = None
    asked: tuple[Asked, ...] = ()


Constraint = Callable[[BSplineSurface], Given]
"""Says for a net which of its control points are given: it is asked anew for every net that is tried."""


@dataclass(frozen=True, slots=True, eq=False)
class NetFit:
    """The fit on one net.

    displacement (r, s, 3) : of the control points; exactly zero where nothing asks them to move. residual (m, n, 3) :
    what is left at the nodes. asked : what was asked along curves. window : [i0:i1, j0:j1] of the unknowns that were free,
    None when none was.
    A_u (m, r'), A_v (n, s') : basis of the unknowns at the nodes. W (m, n) : denominator of the rational surface there.
    """

    surface: BSplineSurface
    displacement: Array
    residual: Array
    asked: tuple[Asked, ...]
    window: tuple[int, int, int, int] | None
    A_u: Array
    A_v: Array
    W: Array

    @property
    def moved(self) -> BSplineSurface:
        """The surface with its control points moved; those that do not move keep their bits."""
        rest = self.surface.control_points
        return self.surface.with_control_points(np.where(self.displacement == 0.0, rest, rest + self.displacement))

    def at(self, u: Array, v: Array) -> Array:
        """Displacement of the surface at the grid u (m,) x v (n,): (m, n, 3)."""
        B_u = design_matrix(self.surface.knots_u, self.surface.degree_u, u)
        B_v = design_matrix(self.surface.knots_v, self.surface.degree_v, v)
        w = self.surface.weights
        if w is None:
            return sandwich(B_u, self.displacement, B_v)
        return sandwich(B_u, self.displacement * w[..., None], B_v) / (B_u @ w @ B_v.T)[..., None]

    def along(self, uv: Array, direction: Array | None = None) -> Array:
        """Displacement of the surface, or its derivative in a direction (n, 2) of (u, v), at uv (n, 2): (n, 3)."""
        return displacement_along(self.surface, self.displacement, uv, direction)

    def against(self, field: NodeField) -> NetFit:
        """The same fit with the residual that it leaves of another displacement of the same nodes."""
        moved = self.at(field.u, field.v)
        return replace(self, residual=field.displacement - moved)

    def lacking(self) -> Array:
        """How far the fit is from what is asked, over its tolerance, at every place where something is asked: (n,)."""
        parts = [np.zeros(0)]
        for item in self.asked:
            off = self.along(item.uv, item.direction) - item.value
            parts.append(np.linalg.norm(off, axis=1) / item.tolerance)
        return np.concatenate(parts)

    def split(self, field: NodeField) -> tuple[Array, Array]:
        """How far (m, n) the nodes' displacements are from what the net can follow along u alone, and along v alone."""
        data = field.displacement * self.W[..., None]
        if self.window is None:
            return (np.zeros(self.W.shape),) * 2
        i0, i1, j0, j1 = self.window
        along_u = data - project(self.A_u[:, i0:i1], data)
        along_v = data - np.swapaxes(project(self.A_v[:, j0:j1], np.swapaxes(data, 0, 1)), 0, 1)
        return np.linalg.norm(along_u, axis=2) / self.W, np.linalg.norm(along_v, axis=2) / self.W


def fit_net(
    surface: BSplineSurface,
    field: NodeField,
    threshold: float,
    constraint: Constraint | None,
    *,
    worst_condition: float | None = None,
    tolerance: float = 1.0,
) -> NetFit:
    """Fit the nodes on the net of `surface`; only control points whose support meets a moved node are free.

    tolerance : of the nodes; what is asked along curves weighs as much more as its own tolerance is narrower.

    Raises GeometryError naming the direction in which the nodes do not determine the control points.
    """
    T_u, T_v = (unknowns(surface, axis, field.slivers[axis], field.joints[axis]) for axis in (0, 1))
    A_u = _reduced(design_matrix(surface.knots_u, surface.degree_u, field.u), T_u)
    A_v = _reduced(design_matrix(surface.knots_v, surface.degree_v, field.v), T_v)
    w = np.ones(surface.shape) if surface.weights is None else surface.weights
    W = _plain(surface, field.u, field.v, w)
    given = constraint(surface) if constraint else Given(np.zeros(surface.shape, dtype=np.bool_))
    fixed = _reduced(_reduced(given.mask.astype(np.float64).T, np.abs(T_u)).T, np.abs(T_v)) > 0.0
    q = np.zeros((*fixed.shape, 3))
    moved = field.moved(threshold)
    data = field.displacement * W[..., None]
    if given.displacement is not None:
        rows, columns = _own_row(T_u), _own_row(T_v)
        asked = np.where(given.mask[..., None], given.displacement, 0.0) * w[..., None]
        q = np.where(fixed[..., None], asked[np.ix_(rows, columns)], 0.0)
        carried = sandwich(A_u, q, A_v)
        moved = moved | (np.linalg.norm(carried / W[..., None], axis=2) > threshold)
        data = data - carried
    window = _window(
        A_u, A_v, moved, fixed, [(_reduced(B_u, T_u), _reduced(B_v, T_v)) for B_u, B_v in places(surface, given.asked)]
    )
    if window is not None:
        i0, i1, j0, j1 = window
        for label, basis, degree in (
            ("u", A_u[:, i0:i1], surface.degree_u),
            ("v", A_v[:, j0:j1], surface.degree_v),
        ):
            if not _determined(basis, worst_condition or WORST_CONDITION * 4.0**degree):
                nodes = np.count_nonzero(basis.any(axis=1))
                raise GeometryError(
                    f"{nodes} nodes along {label} do not determine {basis.shape[1]} control points",
                    where=surface.name or "surface",
                    mend="use a smaller node spacing",
                )
        free = ~fixed[i0:i1, j0:j1]
        equations = _equations(surface, given.asked, (T_u, T_v), q, window, tolerance)
        q[i0:i1, j0:j1] += _solved(A_u[:, i0:i1], A_v[:, j0:j1], data, free, equations)
    whole = sandwich(T_u, q, T_v) / w[..., None] if q.shape != (*surface.shape, 3) else q / w[..., None]
    if given.displacement is not None:
        whole = np.where(given.mask[..., None], given.displacement, whole)
    residual = field.displacement - sandwich(A_u, q, A_v) / W[..., None]
    return NetFit(surface, whole, residual, given.asked, window, A_u, A_v, W)


def project(basis: Array, data: Array) -> Array:
    """The least-squares fit of data (m, n, 3) by the columns of `basis` (m, r) along its first axis: (m, n, 3)."""
    q, _ = np.linalg.qr(basis)
    m, n, c = data.shape
    return (q @ (q.T @ data.reshape(m, n * c))).reshape(m, n, c)


def sandwich(left: Array, tensor: Array, right: Array) -> Array:
    """left (m, r) . tensor (r, s, c) . right^T (s, n) -> (m, n, c)."""
    r, s, c = tensor.shape
    half = (left @ tensor.reshape(r, s * c)).reshape(-1, s, c)
    return np.matmul(right, half)


def _reduced(matrix: Array, T: Array) -> Array:
    """matrix @ T; unknowns that are the control points themselves are left as they are."""
    return matrix if T.shape[0] == T.shape[1] else matrix @ T


def _plain(surface: BSplineSurface, u: Array, v: Array, w: Array) -> Array:
    if surface.weights is None:
        return np.ones((len(u), len(v)))
    B_u = design_matrix(surface.knots_u, surface.degree_u, u)
    B_v = design_matrix(surface.knots_v, surface.degree_v, v)
    return B_u @ w @ B_v.T


def _own_row(T: Array) -> NDArray[np.int64]:
    """For each unknown the row that it is by itself."""
    single = (np.count_nonzero(T, axis=1) == 1) & (T.max(axis=1) == 1.0)
    return np.array([int(np.flatnonzero(single & (T[:, a] == 1.0))[0]) for a in range(T.shape[1])])


def _window(
    A_u: Array, A_v: Array, moved: Mask, fixed: Mask, met: list[tuple[Array, Array]]
) -> tuple[int, int, int, int] | None:
    """Index box of the unknowns whose support meets a moved node or a place where something is asked, as small as what is
    fixed allows."""
    met = [(A_u[moved.any(axis=1)], A_v[moved.any(axis=0)]), *met]
    i = np.flatnonzero(np.any([(basis != 0.0).any(axis=0) for basis, _ in met], axis=0))
    j = np.flatnonzero(np.any([(basis != 0.0).any(axis=0) for _, basis in met], axis=0))
    if not len(i) or not len(j):
        return None
    i0, i1, j0, j1 = int(i[0]), int(i[-1]) + 1, int(j[0]), int(j[-1]) + 1
    free = ~fixed[i0:i1, j0:j1]
    if not free.any():
        return None
    rows, columns = np.flatnonzero(free.any(axis=1)), np.flatnonzero(free.any(axis=0))
    return i0 + int(rows[0]), i0 + int(rows[-1]) + 1, j0 + int(columns[0]), j0 + int(columns[-1]) + 1


def _determined(basis: Array, worst: float) -> bool:
    if basis.shape[1] > np.count_nonzero(basis.any(axis=1)):
        return False
    return bool(np.linalg.cond(basis) < worst)


def _equations(
    surface: BSplineSurface,
    asked: tuple[Asked, ...],
    T: tuple[Array, Array],
    q: Array,
    window: tuple[int, int, int, int],
    tolerance: float,
) -> tuple[scipy.sparse.csr_matrix, Array] | None:
    """E and b of E x = b for the unknowns x of the window: what is asked beyond what q does already, weighted."""
    if not asked:
        return None
    lift = scipy.sparse.kron(scipy.sparse.csr_matrix(T[0]), scipy.sparse.csr_matrix(T[1]), format="csr")
    rows, values = [], []
    for item in asked:
        matrix = equation_rows(surface, item.uv, item.direction) @ lift
        weight = FIRST * tolerance / item.tolerance
        rows.append(scipy.sparse.diags(weight) @ matrix)
        values.append((item.value - matrix @ q.reshape(-1, 3)) * weight[:, None])
    i0, i1, j0, j1 = window
    columns = (np.arange(i0, i1)[:, None] * q.shape[1] + np.arange(j0, j1)).ravel()
    return scipy.sparse.vstack(rows, format="csc")[:, columns].tocsr(), np.concatenate(values)


def _solved(
    A_u: Array,
    A_v: Array,
    data: Array,
    free: Mask,
    equations: tuple[scipy.sparse.csr_matrix, Array] | None = None,
) -> Array:
    """Q (r, s, 3) that fits data (m, n, 3) best, zero where not free, and fulfils the equations as well as it can."""
    if free.all() and equations is None:
        half = _along(A_u, data)
        return np.swapaxes(_along(A_v, np.swapaxes(half, 0, 1)), 0, 1)
    index = np.flatnonzero(free.ravel())
    product = scipy.sparse.kron(
        scipy.sparse.csr_matrix(A_u.T @ A_u), scipy.sparse.csr_matrix(A_v.T @ A_v), format="csc"
    )
    normal = product[index][:, index].tocsc()
    if equations is not None:
        return _solved_with_equations(A_u, A_v, data, index, normal, *equations)
    factor = scipy.sparse.linalg.splu(
        normal, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    q = np.zeros((*free.shape, 3))
    flat = q.reshape(-1, 3)
    for _ in range(2):  # the second pass takes back what squaring the condition number cost
        residual = data - sandwich(A_u, q, A_v)
        right = sandwich(A_u.T, residual, A_v.T).reshape(-1, 3)
        flat[index] += factor.solve(np.ascontiguousarray(right[index]))
    return q


def _solved_with_equations(
    A_u: Array,
    A_v: Array,
    data: Array,
    index: NDArray[np.int64],
    normal: scipy.sparse.csc_matrix,
    rows: scipy.sparse.csr_matrix,
    values: Array,
) -> Array:
    """Least squares of nodes and weighted equations together, with multipliers: weights are not squared, and so not lost."""
    rows = rows.tocsc()[:, index]
    size = float(abs(normal).max())
    whole = scipy.sparse.bmat(
        [[normal / size, rows.T], [rows, -size * scipy.sparse.identity(rows.shape[0])]], format="csc"
    )
    factor = scipy.sparse.linalg.splu(whole)
    q = np.zeros((A_u.shape[1], A_v.shape[1], 3))
    flat = q.reshape(-1, 3)
    multipliers = np.zeros((rows.shape[0], 3))
    for _ in range(3):  # each pass takes back what rounding cost
        residual = data - sandwich(A_u, q, A_v)
        right = sandwich(A_u.T, residual, A_v.T).reshape(-1, 3)[index] / size - rows.T @ multipliers
        lacking = values - rows @ flat[index] + size * multipliers
        step = factor.solve(np.concatenate([right, lacking]))
        flat[index] += step[: len(index)]
        multipliers += step[len(index) :]
    return q


def _along(basis: Array, data: Array) -> Array:
    """Least squares along the first axis: basis (m, r), data (m, n, 3) -> (r, n, 3)."""
    q, r = np.linalg.qr(basis)
    m, n, c = data.shape
    return scipy.linalg.solve_triangular(r, q.T @ data.reshape(m, n * c)).reshape(-1, n, c)
