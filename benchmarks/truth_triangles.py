"""Triangle against triangle: the engine's signs against separating axes in integers.

The truth asks nothing about orientations. Two triangles A and B meet exactly where the origin lies in the polytope
A - B, whose facets' normals are known: the triangles' normals and the cross products of their edges (of a flat A - B,
these turned into its plane). On lattice coordinates the axes are 64-bit integers without overflow. On other doubles a
floating-point pass decides where every gap is far above rounding, and Python's integers do where it is not: a double
is an integer times a power of two.

The relation of triangles scaled by 1e6 is, on a lattice, that of the triangles themselves, for the products are exact
doubles; so is that of triangles scaled by 2^-20. Scaling by 1e-6 rounds: the truth then is that of the rounded doubles.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadsculpt.collide.tri_tri import CROSSING, WORK, tri_tri
from cadsculpt.jit import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DISJOINT, TOUCHING, OVERLAP = 0, 1, 3
UNSURE = -1

LATTICE = 1024
"""Largest lattice coordinate: the axes' products stay below 96 LATTICE^4, far inside 64 bits."""

ROUNDING = 1e-12
"""A gap below this part of its terms' sizes is left to integers; a gap's own rounding is a thousand times smaller."""

SEGMENT = 1e-9
"""Two segments are one where their ends agree to this part of the triangles' size."""

ROUNDED = ("random", "shared point", "shared edge", "nearly flat")
"""Shapes on no lattice: a factor of 1e6 rounds them, and so they have their own truth there."""

SHAPES = (
    *ROUNDED[1:], "lattice", "plane lattice", "wide lattice", "vertex on face", "no area", "flat",
)  # fmt: skip


def tri_tri_truth(pairs: int = 1_000_000, seed: int = 2) -> dict[str, object]:
    """`pairs` pairs: half of them random doubles, half degenerate (SHAPES, in equal parts). Each pair also swapped with
    its vertices turned, scaled by 1e6, by 2^-20 and by 1e-6.

    tri_tri_wrong : pairs of which any of the five had a wrong relation. tri_tri_segment_wrong : pairs whose crossing
    segment was another one after swapping or scaling. tri_tri_kinds : how often each relation was the truth.
    """
    rng = np.random.default_rng(seed)
    wrong, moved, exact, kinds = 0, 0, 0, np.zeros(4, np.int64)
    half = pairs // 2
    parts = [("random", half), *((shape, -(-(pairs - half) // len(SHAPES))) for shape in SHAPES)]
    tested = 0
    for shape, count in parts:
        for start in range(0, count, 50_000):
            t = random_pairs(rng, shape, min(50_000, count - start))
            lattice = shape not in ROUNDED
            truth, asked = relations(t, integral=lattice)
            exact += asked
            small, asked = relations(t * 1e-6, integral=False)
            exact += asked
            turned = turn_and_swap(t, rng.integers(0, 6, (len(t), 2)), rng.random(len(t)) < 0.5)
            variants = ((t, truth, 1.0), (turned, truth, 1.0), (t * 2.0**-20, truth, 2.0**-20), (t * 1e-6, small, 1e-6))
            # a product with 1e6 is exact on the lattice; elsewhere it rounds, and has its own truth
            large, asked = (truth, 0) if lattice else relations(t * 1e6, integral=False)
            exact += asked
            bad, other = np.zeros(len(t), np.bool_), np.zeros(len(t), np.bool_)
            first = None
            for points, expected, scale in (*variants, (t * 1e6, large, 1e6)):
                found, segment = ours(np.ascontiguousarray(points))
                bad |= found != expected
                segment = segment / scale
                first = segment if first is None else first
                same = ends_apart(segment, first) <= SEGMENT * np.abs(t).max(axis=(1, 2))
                # triangles in one plane up to rounding have another segment, or none, when they are rounded again
                if shape != "nearly flat" or scale in (1.0, 2.0**-20):
                    other |= (found == CROSSING) & (truth == CROSSING) & ~same
            wrong, moved, tested = wrong + int(bad.sum()), moved + int(other.sum()), tested + len(t)
            kinds += np.bincount(truth, minlength=4)
    return {
        "tri_tri_tested": tested,
        "tri_tri_wrong": wrong,
        "tri_tri_segment_wrong": moved,
        "tri_tri_degenerate": tested - half,
        "tri_tri_checks": 5 * tested,
        "tri_tri_by_integers": exact,
        "tri_tri_kinds": dict(
            zip(("disjoint", "touching", "crossing", "coplanar_overlap"), kinds.tolist(), strict=True)
        ),
    }


# ------------------------------------------------------------------ the pairs


def random_pairs(rng: np.random.Generator, shape: str, count: int) -> Array:
    """(count, 6, 3): three vertices of one triangle, three of the other."""
    if shape == "random":
        t = rng.normal(size=(count, 6, 3)) * 10.0 ** rng.uniform(-2, 2, (count, 1, 1))
        # moved far from the origin, so that differences round
        return t + rng.normal(size=(count, 1, 3)) * 10.0 ** rng.uniform(-3, 3, (count, 1, 1))
    if shape == "lattice":
        return rng.integers(-2, 3, (count, 6, 3)).astype(float)
    if shape == "wide lattice":
        return rng.integers(-LATTICE, LATTICE + 1, (count, 6, 3)).astype(float)
    if shape == "plane lattice":
        t = rng.integers(-3, 4, (count, 6, 3))
        t[..., 2] = rng.integers(-2, 3, (count, 1)) * t[..., 0] + rng.integers(-2, 3, (count, 1)) * t[..., 1]
        return t.astype(float)
    if shape in ("shared point", "shared edge"):
        t = rng.normal(size=(count, 6, 3))
        t[:, 3] = t[:, 0]
        if shape == "shared edge":
            t[:, 4] = t[:, 1]
        else:
            # and a third of them with the point in the middle of an edge, as near as rounding allows
            third = rng.random(count) < 1 / 3
            t[third, 3] = 0.5 * (t[third, 0] + t[third, 1])
        return t
    if shape == "nearly flat":
        # the second triangle in the plane of the first, up to rounding
        t = rng.normal(size=(count, 6, 3))
        k = rng.normal(size=(count, 3, 2))
        t[:, 3:] = t[:, :1] + k[..., :1] * (t[:, 1:2] - t[:, :1]) + k[..., 1:] * (t[:, 2:3] - t[:, :1])
        return t
    if shape == "vertex on face":
        t = 8 * rng.integers(-8, 9, (count, 6, 3))
        weights = rng.multinomial(8, [1 / 3] * 3, size=count)
        t[:, 3] = (weights[..., None] * t[:, :3]).sum(axis=1) // 8
        return t.astype(float)
    t = rng.integers(-3, 4, (count, 6, 3))
    if shape == "no area":
        t[:, 5] = np.where(rng.random((count, 1)) < 0.5, t[:, 4], 2 * t[:, 4] - t[:, 3])
        both = rng.random(count) < 0.5
        t[both, 2] = 3 * t[both, 1] - 2 * t[both, 0]
        return t.astype(float)
    # flat: the second triangle in the plane of the first, with the first's own vertices and edges among its points
    k = rng.integers(-2, 4, (count, 3, 2))
    u, v = t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
    t[:, 3:] = t[:, None, 0] + k[..., :1] * u[:, None] + k[..., 1:] * v[:, None]
    return t.astype(float)


def turn_and_swap(t: Array, turns: Index, swapped: NDArray[np.bool_]) -> Array:
    """Each triangle's vertices in another order, and some pairs the other way round."""
    orders = np.array([[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]])
    rows = np.arange(len(t))[:, None]
    p, q = t[rows, orders[turns[:, 0]]], t[rows, 3 + orders[turns[:, 1]]]
    swap = swapped[:, None, None]
    return np.concatenate([np.where(swap, q, p), np.where(swap, p, q)], axis=1)


@njit
def ours(t: Array) -> tuple[Index, Array]:
    """The engine's relations (n,) and segments (n, 6)."""
    found, segments, work = np.empty(len(t), np.int64), np.empty((len(t), 6)), np.empty(WORK)
    for k in range(len(t)):
        found[k] = tri_tri(t[k], segments[k], work)
    return found, segments


def ends_apart(a: Array, b: Array) -> Array:
    """How far the ends of segments (n, 6) lie apart, whichever end comes first: (n,)."""
    turned = np.concatenate([b[:, 3:], b[:, :3]], axis=1)
    return np.minimum(np.abs(a - b).max(axis=1), np.abs(a - turned).max(axis=1))


# ------------------------------------------------------------------ the truth


def relations(t: Array, *, integral: bool) -> tuple[Index, int]:
    """The true relations (n,) of pairs (n, 6, 3), and how many of them took Python's integers."""
    if integral:
        assert np.abs(t).max() <= LATTICE
        assert (t == np.rint(t)).all()
        return np.asarray(axes_of_integers(t.astype(np.int64))), 0
    found = axes_of_doubles(np.ascontiguousarray(t))
    unsure = np.flatnonzero(found == UNSURE)
    for k in unsure.tolist():
        found[k] = relation_of_integers(as_integers(t[k]))
    return found, len(unsure)


def as_integers(t: Array) -> list[list[int]]:
    """The six points as integers, exactly, up to one power of two."""
    ratios = [[float(x).as_integer_ratio() for x in point] for point in t]
    common = max(denominator for point in ratios for _, denominator in point)
    return [[numerator * (common // denominator) for numerator, denominator in point] for point in ratios]


def relation_of_integers(t: Any) -> int:
    """The relation of six points with integer coordinates of any size (Python's own integers)."""

    def cross(a: Any, b: Any) -> Any:
        return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]

    def minus(a: Any, b: Any) -> Any:
        return [a[0] - b[0], a[1] - b[1], a[2] - b[2]]

    p, q = t[:3], t[3:]
    e = [minus(p[(i + 1) % 3], p[i]) for i in range(3)]
    f = [minus(q[(i + 1) % 3], q[i]) for i in range(3)]
    n, m = cross(e[0], e[1]), cross(f[0], f[1])
    axes = [axis for axis in (n, m, *(cross(x, y) for x in e for y in f)) if any(axis)]
    solid = any(any(cross(axes[0], axis)) for axis in axes[1:]) if axes else False
    if axes and not solid:
        # all in one direction: A - B is flat, and its sides lie in the plane across
        axes = [axes[0], *(cross(axes[0], x) for x in (*e, *f) if any(x))]
    elif not axes:
        # at most a line
        along = next((x for x in (*e, *f) if any(x)), None)
        apart = minus(q[0], p[0])
        if along is None:
            return DISJOINT if any(apart) else TOUCHING
        if any(cross(apart, along)):
            return DISJOINT
        axes = [along]
    proper = True
    for k, axis in enumerate(axes):
        low, high = zip(
            *(
                ((d := [x[0] * axis[0] + x[1] * axis[1] + x[2] * axis[2] for x in s]), (min(d), max(d)))[1]
                for s in (p, q)
            ),
            strict=True,
        )
        if high[0] < low[1] or high[1] < low[0]:
            return DISJOINT
        if not (solid or k > 0):
            continue  # the plane that both lie in
        proper = proper and high[0] > low[1] and high[1] > low[0]
    if not (proper and any(n) and any(m)):
        return TOUCHING
    return CROSSING if solid else OVERLAP


@njit
def cross3(a: Any, b: Any, out: Any) -> bool:
    """out = a x b; whether it is anything but zero."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return bool(out[0] != 0 or out[1] != 0 or out[2] != 0)


@njit
def span(t: Any, first: int, axis: Any) -> tuple[Any, Any]:
    """The least and the largest of three points along an axis."""
    low = t[first, 0] * axis[0] + t[first, 1] * axis[1] + t[first, 2] * axis[2]
    high = low
    for k in range(first + 1, first + 3):
        d = t[k, 0] * axis[0] + t[k, 1] * axis[1] + t[k, 2] * axis[2]
        low, high = min(low, d), max(high, d)
    return low, high


@njit
def axes_of_integers(pairs: Index) -> Index:
    """`relation_of_integers` in 64 bits, for coordinates up to LATTICE."""
    out = np.empty(len(pairs), np.int64)
    edges, normals = np.empty((6, 3), np.int64), np.empty((2, 3), np.int64)
    axes, turned = np.empty((12, 3), np.int64), np.empty(3, np.int64)
    for k in range(len(pairs)):
        t = pairs[k]
        for i in range(3):
            for c in range(3):
                edges[i, c] = t[(i + 1) % 3, c] - t[i, c]
                edges[3 + i, c] = t[3 + (i + 1) % 3, c] - t[3 + i, c]
        areas = cross3(edges[0], edges[1], normals[0])
        areas = cross3(edges[3], edges[4], normals[1]) and areas
        count = 0
        for i in range(11):
            if i < 2:
                axes[count] = normals[i]
                any_axis = axes[count, 0] != 0 or axes[count, 1] != 0 or axes[count, 2] != 0
            else:
                any_axis = cross3(edges[(i - 2) // 3], edges[3 + (i - 2) % 3], axes[count])
            count += any_axis
        solid = False
        for i in range(1, count):
            solid = solid or cross3(axes[0], axes[i], turned)
        start = 0
        if count > 0 and not solid:
            count, start = 1, 1
            for i in range(6):
                count += cross3(axes[0], edges[i], axes[count])
        elif count == 0:
            along = -1
            for i in range(6):
                if edges[i, 0] != 0 or edges[i, 1] != 0 or edges[i, 2] != 0:
                    along = i
            for c in range(3):
                turned[c] = t[3, c] - t[0, c]
            if along < 0:
                out[k] = 0 if turned[0] != 0 or turned[1] != 0 or turned[2] != 0 else 1
                continue
            if cross3(turned, edges[along], axes[0]):
                out[k] = 0
                continue
            axes[0] = edges[along]
            count = 1
        proper = areas
        relation = 1
        for i in range(count):
            low, high = span(t, 0, axes[i])
            low_q, high_q = span(t, 3, axes[i])
            if high < low_q or high_q < low:
                relation = 0
                break
            if i >= start:
                proper = proper and high > low_q and high_q > low
        if relation == 1 and proper:
            relation = 2 if solid else 3
        out[k] = relation
    return out


@njit
def axes_of_doubles(pairs: Array) -> Index:
    """The same in floating point, where every gap that decides is far above rounding; UNSURE elsewhere."""
    out = np.empty(len(pairs), np.int64)
    edges, axis = np.empty((6, 3)), np.empty(3)
    for k in range(len(pairs)):
        t = pairs[k]
        size = 0.0
        for i in range(6):
            for c in range(3):
                size = max(size, abs(t[i, c]))
        reach = 0.0
        for i in range(3):
            for c in range(3):
                edges[i, c] = t[(i + 1) % 3, c] - t[i, c]
                edges[3 + i, c] = t[3 + (i + 1) % 3, c] - t[3 + i, c]
                reach = max(reach, abs(edges[i, c]), abs(edges[3 + i, c]))
        relation, sure = 2, True
        doubt = ROUNDING * size * reach * reach
        for i in range(11):
            if i < 2:
                cross3(edges[3 * i], edges[3 * i + 1], axis)
            else:
                cross3(edges[(i - 2) // 3], edges[3 + (i - 2) % 3], axis)
            low, high = span(t, 0, axis)
            low_q, high_q = span(t, 3, axis)
            if high < low_q - doubt or high_q < low - doubt:
                relation, sure = 0, True
                break
            sure = sure and high > low_q + doubt and high_q > low + doubt
        # overlap beyond doubt along both normals means that neither is zero nor are they parallel
        out[k] = relation if sure else -1
    return out
