"""Tensor-product B-spline surfaces (paper section 3, eq. 1), rational or not, with their trim loops.

Conventions: parameters (u, v) and knots are the file's own and are never rescaled; control points are in the
unit named by whoever holds the surface. A periodic direction is stored unrolled: the last `degree` rows of control
points repeat the first ones, the knot vector is unclamped and the domain is [knots[degree], knots[-degree-1]], so
that evaluation needs no special case.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import GeometryError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class TrimCurve:
    """A B-spline curve in the (u, v) plane of a surface.

    control_points (n, 2), knots (n + degree + 1,), weights (n,) or None; domain [knots[degree], knots[-degree-1]].
    """

    control_points: Array
    knots: Array
    degree: int
    weights: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TrimLoop:
    """A closed chain of trim curves, head to tail. `outer` marks the boundary around the material."""

    curves: tuple[TrimCurve, ...]
    outer: bool = True


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a surface was read from: file name, entity in that file, length unit of that file."""

    file: str = ""
    entity: str = ""
    units: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class BSplineSurface:
    """S(u, v) = sum_ij B_ik(u) B_jl(v) w_ij P_ij / sum_ij B_ik(u) B_jl(v) w_ij (paper eq. 1; Piegl and Tiller, eq. 4.15).

    Attributes
    ----------
    control_points : (r, s, 3) float64, r along u and s along v.
    knots_u, knots_v : (r + degree_u + 1,), (s + degree_v + 1,), non-decreasing, any range.
    weights : (r, s), positive, or None when not rational.
    periodic_u, periodic_v : the direction is periodic; stored unrolled (module docstring).
    outward : True when S_u x S_v points out of the material.
    trims : loops in (u, v), or None when the whole domain is the face.
    """

    control_points: Array
    knots_u: Array
    knots_v: Array
    degree_u: int
    degree_v: int
    weights: Array | None = None
    periodic_u: bool = False
    periodic_v: bool = False
    outward: bool = True
    trims: tuple[TrimLoop, ...] | None = None
    name: str = ""
    provenance: Provenance = Provenance()

    def __post_init__(self) -> None:
        for field in ("control_points", "knots_u", "knots_v", "weights"):
            value = getattr(self, field)
            if value is not None:
                array = np.ascontiguousarray(value, dtype=np.float64)
                array.setflags(write=False)
                object.__setattr__(self, field, array)

    # ------------------------------------------------------------------ shape

    @property
    def shape(self) -> tuple[int, int]:
        """(r, s): number of control points along u and v."""
        return self.control_points.shape[0], self.control_points.shape[1]

    @property
    def rational(self) -> bool:
        return self.weights is not None

    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """((u_min, u_max), (v_min, v_max))."""
        ku, kv, p, q = self.knots_u, self.knots_v, self.degree_u, self.degree_v
        return (float(ku[p]), float(ku[-p - 1])), (float(kv[q]), float(kv[-q - 1]))

    @property
    def size(self) -> float:
        """Diagonal of the control points' box, in the surface's unit."""
        p = self.control_points.reshape(-1, 3)
        return float(np.linalg.norm(p.max(axis=0) - p.min(axis=0)))

    @property
    def closed_u(self) -> bool:
        """The edges u = u_min and u = u_max coincide (to 1e-9 of the size)."""
        return self.periodic_u or self._meets(0)

    @property
    def closed_v(self) -> bool:
        """The edges v = v_min and v = v_max coincide (to 1e-9 of the size)."""
        return self.periodic_v or self._meets(1)

    def _meets(self, axis: int) -> bool:
        from .matrices import design_matrix

        knots = (self.knots_u, self.knots_v)[axis]
        degree = (self.degree_u, self.degree_v)[axis]
        ends = design_matrix(knots, degree, np.array(self.domain[axis]))
        w = np.ones(self.shape) if self.weights is None else self.weights
        h = np.concatenate([self.control_points * w[..., None], w[..., None]], axis=2)
        edges = np.tensordot(ends, h, axes=(1, axis))
        points = edges[..., :3] / edges[..., 3:]
        return bool(np.abs(points[0] - points[1]).max() <= 1e-9 * max(self.size, 1e-300))

    # --------------------------------------------------------------- evaluate

    def evaluate(self, u: ArrayLike, v: ArrayLike) -> Array:
        """S(u, v); u and v broadcast against each other; returns (..., 3). NaN in gives NaN out."""
        return self.derivatives(u, v, 0)[0, 0]

    def derivatives(self, u: ArrayLike, v: ArrayLike, order: int = 1) -> Array:
        """All partial derivatives up to `order` (Piegl and Tiller, eq. 4.20).

        Returns (order + 1, order + 1, ..., 3); [a, b] is d^(a+b) S / du^a dv^b, entries with a + b > order are zero.
        """
        from .basis import surface_derivatives

        u, v = np.broadcast_arrays(np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64))
        out = surface_derivatives(
            self.control_points,
            _ones(self.shape) if self.weights is None else self.weights,
            self.weights is not None,
            self.knots_u,
            self.knots_v,
            self.degree_u,
            self.degree_v,
            np.ascontiguousarray(u).ravel(),
            np.ascontiguousarray(v).ravel(),
            order,
        )
        return np.moveaxis(out, 0, 2).reshape(order + 1, order + 1, *u.shape, 3)

    def normal(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Unit normal out of the material, (..., 3). NaN where the surface is singular (a degenerate pole)."""
        d = self.derivatives(u, v, 1)
        n = np.cross(d[1, 0], d[0, 1])
        length = np.linalg.norm(n, axis=-1, keepdims=True)
        with np.errstate(invalid="ignore", divide="ignore"):
            n = n / np.where(length > 0, length, np.nan)
        return n if self.outward else -n

    # ----------------------------------------------------------------- derive

    def with_control_points(self, control_points: Array) -> BSplineSurface:
        """The same surface over other control points; the array is copied."""
        return replace(self, control_points=np.array(control_points, dtype=np.float64))

    def scaled(self, factor: float) -> BSplineSurface:
        """Control points times `factor` (a change of unit); parameters and knots stay."""
        return self if factor == 1.0 else self.with_control_points(self.control_points * factor)

    def validate(self) -> None:
        """Raise GeometryError naming the first thing that makes this no B-spline surface."""
        r, s = self.shape
        where = self.name or self.provenance.entity or "surface"
        for label, knots, degree, count in (
            ("u", self.knots_u, self.degree_u, r),
            ("v", self.knots_v, self.degree_v, s),
        ):
            if degree < 1:
                raise GeometryError(f"degree {degree} in {label}", where=where, mend="degrees start at 1")
            if len(knots) != count + degree + 1:
                raise GeometryError(
                    f"{len(knots)} knots in {label} for {count} control points of degree {degree}",
                    where=where,
                    mend=f"{count + degree + 1} are needed",
                )
            if not np.isfinite(knots).all() or (np.diff(knots) < 0).any():
                raise GeometryError(f"knots in {label} are not finite and non-decreasing", where=where)
            if knots[degree] >= knots[count]:
                raise GeometryError(f"the parameter range in {label} is empty", where=where)
            inside = knots[(knots > knots[degree]) & (knots < knots[count])]
            if len(inside) and np.unique(inside, return_counts=True)[1].max() > degree:
                raise GeometryError(
                    f"an inner knot in {label} repeats more than {degree} times: the surface is torn there",
                    where=where,
                    mend="split the surface at that knot",
                )
        if self.control_points.shape[2:] != (3,):
            raise GeometryError(f"control points of shape {self.control_points.shape}", where=where, mend="(r, s, 3)")
        if not np.isfinite(self.control_points).all():
            raise GeometryError("a control point is not finite", where=where)
        if self.weights is not None:
            if self.weights.shape != (r, s):
                raise GeometryError(f"weights of shape {self.weights.shape}", where=where, mend=f"({r}, {s})")
            if not (np.isfinite(self.weights).all() and (self.weights > 0).all()):
                raise GeometryError("a weight is not positive and finite", where=where)
        for curve in (curve for loop in self.trims or () for curve in loop.curves):
            if not (np.isfinite(curve.control_points).all() and np.isfinite(curve.knots).all()):
                raise GeometryError("a trim curve has a number that is not finite", where=where)
            if curve.weights is not None and not (np.isfinite(curve.weights).all() and (curve.weights > 0).all()):
                raise GeometryError("a weight of a trim curve is not positive and finite", where=where)


def _ones(shape: tuple[int, int]) -> Array:
    """Weights of a surface that has none; read-only as those of others are: one type of array for the kernel."""
    weights = np.ones(shape)
    weights.flags.writeable = False
    return weights
