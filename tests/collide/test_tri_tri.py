"""Triangle against triangle: the truth is rational arithmetic."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations, permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadsculpt.collide.tri_tri import Relation, triangle_relation
from cadsculpt.errors import GeometryError

# ------------------------------------------------------------------ the truth


def _exact(triangle):
    return [tuple(Fraction(float(x)) for x in point) for point in triangle]


def _sub(a, b):
    return tuple(x - y for x, y in zip(a, b, strict=True))


def _dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def _cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _normal(t):
    return _cross(_sub(t[1], t[0]), _sub(t[2], t[0]))


def _clip(points, value):
    """The convex hull of `points` (a polygon in order, a segment or a point) where value(point) >= 0."""
    out = []
    for a, b in zip(points, points[1:] + points[:1], strict=True):
        va, vb = value(a), value(b)
        if va >= 0:
            out.append(a)
        if (va > 0 > vb) or (va < 0 < vb):
            t = va / (va - vb)
            out.append(tuple(x + t * (y - x) for x, y in zip(a, b, strict=True)))
    return out


def _half_spaces(t):
    """The half-spaces whose common points are the triangle t: its plane from both sides, and its three edges."""
    n = _normal(t)
    spaces = [lambda x: _dot(n, _sub(x, t[0])), lambda x: -_dot(n, _sub(x, t[0]))]
    for i in range(3):
        m = _cross(n, _sub(t[(i + 1) % 3], t[i]))
        spaces.append(lambda x, m=m, p=t[i]: _dot(m, _sub(x, p)))
    return spaces


def _segments_meet(p, q):
    """Two triangles without area: their longest stretches as segments, solved exactly."""
    (a, b), (c, d) = ((min(t), max(t)) for t in (p, q))
    u, v, w = _sub(b, a), _sub(d, c), _sub(c, a)
    n = _cross(u, v)
    if any(n):
        if _dot(n, w) != 0:
            return False
        s, t = _dot(_cross(w, v), n) / _dot(n, n), _dot(_cross(w, u), n) / _dot(n, n)
        return 0 <= s <= 1 and 0 <= t <= 1
    long, other, start = (u, (c, d), a) if any(u) else (v, (a, b), c)
    if not any(long):
        return a == c
    if any(any(_cross(long, _sub(x, start))) for x in other):
        return False
    place = sorted(_dot(_sub(x, start), long) / _dot(long, long) for x in other)
    return place[0] <= 1 and place[1] >= 0


def _truth(p, q):
    p, q = _exact(p), _exact(q)
    np_, nq = _normal(p), _normal(q)
    if not any(np_) and not any(nq):
        return Relation.TOUCHING if _segments_meet(p, q) else Relation.DISJOINT
    if not any(nq):
        p, q, np_, nq = q, p, nq, np_
    common = p
    for space in _half_spaces(q):
        common = _clip(common, space) if common else common
    if not common:
        return Relation.DISJOINT
    if not any(np_):
        return Relation.TOUCHING
    if not any(_cross(np_, nq)):
        area = any(any(_cross(_sub(b, common[0]), _sub(c, common[0]))) for b, c in combinations(common, 2))
        return Relation.COPLANAR_OVERLAP if area else Relation.TOUCHING
    middle = tuple((x + y) / 2 for x, y in zip(min(common), max(common), strict=True))
    inside = min(common) != max(common)
    for t in (p, q):
        inside = inside and all(space(middle) > 0 for space in _half_spaces(t)[2:])
    return Relation.CROSSING if inside else Relation.TOUCHING


# ------------------------------------------------------------------ the pairs


def _pairs(kind, count, rng):
    for _ in range(count):
        if kind == "lattice":
            yield rng.integers(-2, 3, (2, 3, 3)).astype(float)
        elif kind == "plane lattice":
            pair = rng.integers(-3, 4, (2, 3, 3)).astype(float)
            pair[..., 2] = pair[..., :2].sum(axis=-1)
            yield pair
        elif kind == "random":
            yield rng.normal(size=(2, 3, 3))
        elif kind == "shared point":
            pair = rng.normal(size=(2, 3, 3))
            pair[1, 0] = pair[0, 0]
            yield pair
        elif kind == "shared edge":
            pair = rng.normal(size=(2, 3, 3))
            pair[1, :2] = pair[0, :2][:: rng.choice([-1, 1])]
            yield pair
        elif kind == "vertex on face":
            pair = rng.integers(-8, 9, (2, 3, 3)).astype(float)
            weights = rng.multinomial(8, [1 / 3] * 3) / 8.0
            pair[1, 0] = weights @ pair[0]
            yield pair
        elif kind == "nearly coplanar":
            pair = rng.normal(size=(2, 3, 3))
            a, b, c = pair[0]
            pair[1] = a + rng.normal(size=(3, 2)) @ np.stack([b - a, c - a])
            yield pair
        elif kind == "no area":
            pair = rng.integers(-2, 3, (2, 3, 3)).astype(float)
            pair[1, 2] = pair[1, rng.integers(0, 2)] if rng.random() < 0.5 else 2 * pair[1, 1] - pair[1, 0]
            if rng.random() < 0.5:
                pair[0, 2] = (pair[0, 0] + pair[0, 1]) / 2
            yield pair


KINDS = (
    "lattice",
    "plane lattice",
    "random",
    "shared point",
    "shared edge",
    "vertex on face",
    "nearly coplanar",
    "no area",
)


@pytest.mark.parametrize("kind", KINDS)
def test_relation_is_that_of_rational_arithmetic(kind):
    rng = np.random.default_rng(KINDS.index(kind))
    seen = set()
    for p, q in _pairs(kind, 120, rng):
        truth = _truth(p, q)
        seen.add(truth)
        assert triangle_relation(p, q)[0] is truth, (p, q)
        p, q = (p, q) if rng.random() < 0.5 else (q, p)
        p, q = p[rng.permutation(3)], q[rng.permutation(3)]
        assert triangle_relation(p, q)[0] is truth, (p, q)
        for factor in (1e-6, 1e6):
            assert triangle_relation(p * factor, q * factor)[0] is _truth(p * factor, q * factor)
    assert seen == {Relation.TOUCHING} if kind == "shared edge" else len(seen) > 1


def test_every_order_and_every_power_of_two_gives_one_answer():
    rng = np.random.default_rng(7)
    for kind in KINDS:
        for p, q in _pairs(kind, 6, rng):
            expected = triangle_relation(p, q)[0]
            for a in permutations(range(3)):
                for b in permutations(range(3)):
                    assert triangle_relation(p[list(a)], q[list(b)])[0] is expected
                    assert triangle_relation(q[list(b)], p[list(a)])[0] is expected
            for power in (-30, -20, 20, 30):
                assert triangle_relation(p * 2.0**power, q * 2.0**power)[0] is expected


@settings(max_examples=150, deadline=None)
@given(st.lists(st.integers(-2, 2), min_size=18, max_size=18))
def test_small_lattice_triangles(coordinates):
    p, q = np.array(coordinates, dtype=float).reshape(2, 3, 3)
    assert triangle_relation(p, q)[0] is _truth(p, q)


# ---------------------------------------------------------------- the segment


def test_known_relations():
    p = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    upright = np.array([[1.0, 1.0, -1.0], [1.0, 1.0, 1.0], [1.0, -1.0, 0.0]])
    relation, segment = triangle_relation(p, upright)
    assert relation is Relation.CROSSING
    assert np.allclose(sorted(segment.tolist()), [[1, 0, 0], [1, 1, 0]])
    relation, segment = triangle_relation(p, upright + [0.0, 0.0, 1.0])
    assert relation is Relation.TOUCHING
    assert np.array_equal(segment, [[1, 1, 0], [1, 1, 0]])
    assert triangle_relation(p, p + [0.0, 0.0, 1e-300])[0] is Relation.DISJOINT
    assert triangle_relation(p, p + [1.0, 1.0, 0.0]) == (Relation.COPLANAR_OVERLAP, None)
    assert triangle_relation(p, p + [4.0, 0.0, 0.0]) == (Relation.TOUCHING, None)
    assert triangle_relation(p, p + [4.1, 0.0, 0.0]) == (Relation.DISJOINT, None)


def test_the_segment_lies_in_both_triangles():
    rng = np.random.default_rng(11)
    crossings = 0
    for p, q in _pairs("random", 400, rng):
        relation, segment = triangle_relation(p, q)
        assert (segment is None) == (relation is Relation.DISJOINT)
        if segment is None:
            continue
        crossings += 1
        for t in (p, q):
            n = np.cross(t[1] - t[0], t[2] - t[0])
            scale = np.linalg.norm(n)
            for x in segment:
                assert abs((x - t[0]) @ n) <= 1e-12 * scale
                area = sum(np.linalg.norm(np.cross(t[i] - x, t[(i + 1) % 3] - x)) for i in range(3))
                assert area <= scale * (1 + 1e-9)
        # and it is the whole of it: a little beyond either end is outside of one of them
        d = segment[1] - segment[0]
        for x in (segment[0] - 1e-6 * d, segment[1] + 1e-6 * d):
            outside = False
            for t in (p, q):
                n = np.cross(t[1] - t[0], t[2] - t[0])
                area = sum(np.linalg.norm(np.cross(t[i] - x, t[(i + 1) % 3] - x)) for i in range(3))
                outside |= bool(area > np.linalg.norm(n) * (1 + 1e-12))
            assert outside
    assert crossings > 50


def test_numbers_that_are_not_finite_are_refused():
    p = np.eye(3)
    with pytest.raises(GeometryError):
        triangle_relation(p, np.full((3, 3), np.nan))
    with pytest.raises(GeometryError):
        triangle_relation(p, p + np.inf)
