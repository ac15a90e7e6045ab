"""Triangles that hang together: joined vertices, edges, shells, and a consistent turn.

Half-edge 3 t + k runs from corner k of triangle t to the next.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import GeometryError
from ...jit import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

STRAIGHT = 2.0**-46
"""A triangle whose widest angle differs from a straight one by less (in radians) has no area: its corner lies on the
opposite edge as exactly as coordinates can say."""


WITHOUT_THEM = "leave such triangles out where the mesh is made"
NO_AREA = "all its triangles are without area"


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """edges (f, 3) : the edge of each half-edge. ends (e, 2) : its vertices, the lower number first. uses (e,) : its
    triangles. balanced (e,) : whether as many run along it as against it. partner (3 f,) : the other half of an edge
    that two triangles share, else -1. forward (3 f,) : whether the half-edge runs from the lower number to the higher."""

    edges: Index
    ends: Index
    uses: Index
    balanced: Mask
    partner: Index
    forward: Mask


def joined(points: Array, triangles: Index) -> tuple[Array, Index]:
    """Vertices of equal coordinates made one, in the order in which they first come."""
    points = points + 0.0  # -0.0 is 0.0
    first = np.empty(len(points), np.int64)
    count = join_equal(points.view(np.uint64).reshape(points.shape), first)
    kept = np.empty((count, 3))
    kept[first] = points
    return kept, first[triangles]


def used(points: Array, triangles: Index) -> tuple[Array, Index]:
    """Without the vertices that no triangle has."""
    has = np.zeros(len(points), np.bool_)
    has[triangles.ravel()] = True
    if has.all():
        return points, triangles
    return points[has], (np.cumsum(has) - 1)[triangles]


def without_repeats(triangles: Index, warnings: list[str]) -> Index:
    """Without triangles that have a corner twice (their neighbours meet where they were), or that stand there twice.

    Raises GeometryError when none is left.
    """
    a, b, c = triangles.T
    proper = (a != b) & (b != c) & (c != a)
    if not proper.all():
        warnings.append(f"{_triangles(int((~proper).sum()))} with two equal corners left out")
        triangles = triangles[proper]
    start = np.argmin(triangles, axis=1)
    rows = np.arange(len(triangles))[:, None]
    turned = triangles[rows, (start[:, None] + np.arange(3)) % 3]
    first = np.empty(len(turned), np.int64)
    join_equal(turned.view(np.uint64), first)
    again = np.zeros(len(turned), np.bool_)
    again[1:] = first[1:] <= np.maximum.accumulate(first)[:-1]  # new ones are numbered on
    if again.any():
        warnings.append(f"{_triangles(int(again.sum()))} that stand there twice left out")
        triangles = triangles[~again]
    if not len(triangles):
        raise GeometryError(NO_AREA, mend="export the mesh again")
    return np.ascontiguousarray(triangles)


def links_of(triangles: Index) -> Links:
    """Which triangles share which edges."""
    start, end = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()
    key = np.minimum(start, end) * (int(triangles.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    fresh = np.ones(len(key), np.bool_)
    fresh[1:] = key[order[1:]] != key[order[:-1]]
    number = np.cumsum(fresh) - 1
    edges = np.empty(len(key), np.int64)
    edges[order] = number
    first = order[fresh]
    uses = np.bincount(number)
    forward = start < end
    partner = np.full(len(key), -1, np.int64)
    one = np.flatnonzero(fresh)[uses == 2]
    partner[order[one]], partner[order[one + 1]] = order[one + 1], order[one]
    along = np.bincount(number, weights=forward[order])
    ends = np.stack([np.minimum(start, end)[first], np.maximum(start, end)[first]], axis=1)
    return Links(edges.reshape(-1, 3), ends, uses, 2 * along == uses, partner, forward)


def shells_of(triangles: Index, links: Links) -> Index:
    """The number of the shell of each triangle: what hangs together by edges that two triangles share."""
    shell, turn = np.empty(len(triangles), np.int64), np.zeros(len(triangles), np.bool_)
    spread(links.partner, links.forward, shell, turn)
    return shell


def consistently_turned(points: Array, triangles: Index, links: Links, scale: float, warnings: list[str]) -> Index:
    """The triangles, some of them turned over: neighbours run against each other along their edge, in every shell.

    Of the two ways of a shell that which turns fewer. Raises GeometryError for a surface with one side only.
    """
    shell, turn = np.empty(len(triangles), np.int64), np.zeros(len(triangles), np.bool_)
    torn = spread(links.partner, links.forward, shell, turn)
    if torn >= 0:
        raise GeometryError(
            f"the surface has one side only, like a Moebius strip ({place(points, triangles[torn // 3, :2], scale)})",
            mend="export the mesh again",
        )
    all_of, turned = np.bincount(shell), np.bincount(shell, weights=turn)
    turn ^= (2 * turned > all_of)[shell]
    if turn.any():
        warnings.append(f"{_triangles(int(turn.sum()))} turned over, to lie as their neighbours do")
        triangles = np.ascontiguousarray(np.where(turn[:, None], triangles[:, ::-1], triangles))
    return triangles


def mend_caps(points: Array, triangles: Index, scale: float, warnings: list[str]) -> Index:
    """Without triangles of no area: a corner on the opposite edge is made one of the triangle beyond that edge.

    The surface stays where it is and what is closed stays closed. Raises GeometryError where it cannot be done.
    """
    thin = _thin(points, triangles)
    flat = thin[_apex_sine(points, triangles[thin]) <= STRAIGHT]
    if not len(flat):
        return triangles
    faces = [tuple(row) for row in triangles.tolist()]
    gone = _back_to_back(faces, flat.tolist())
    at = {(row[k], row[(k + 1) % 3]): t for t, row in enumerate(faces) if t not in gone for k in range(3)}
    waiting = deque(flat.tolist())
    limit, stuck = 20 * len(waiting) + 100, 0
    while waiting:
        t = waiting.popleft()
        if t in gone or _apex_sine(points, np.array([faces[t]]))[0] > STRAIGHT:
            continue
        limit -= 1
        k = _longest(points, faces[t])
        a, c, b = (faces[t][(k + s) % 3] for s in range(3))  # b lies on the edge a c
        beyond = at.get((c, a))
        if at.get((a, c)) != t or limit < 0:
            beyond = t  # an edge of many triangles
        if beyond is None:  # on the border
            gone.add(t)
            for e in ((a, c), (c, b), (b, a)):
                at.pop(e, None)
            continue
        d = next((v for v in faces[beyond] if v != a and v != c), -1)
        blocked = beyond == t or d == b or (b, d) in at or (d, b) in at
        if blocked and stuck < len(waiting) and limit > 0:  # others may clear the way
            waiting.append(t)
            stuck += 1
            continue
        if blocked:
            raise GeometryError(
                f"{_triangles(len(flat))} without area, and {place(points, (a, c), scale)} it cannot be mended",
                mend=WITHOUT_THEM,
            )
        faces[t], faces[beyond] = (b, a, d), (d, c, b)
        stuck = 0
        del at[a, c], at[c, a]
        for s in (t, beyond):
            for m in range(3):
                at[faces[s][m], faces[s][(m + 1) % 3]] = s
            waiting.append(s)
    if len(gone) == len(faces):
        raise GeometryError(NO_AREA, mend="export the mesh again")
    warnings.append(f"{_triangles(len(flat))} without area mended: the surface is the same without them")
    return np.array([face for t, face in enumerate(faces) if t not in gone], np.int64).reshape(-1, 3)


def turned_outwards(
    points: Array, triangles: Index, shell: Index, closed: Mask, warnings: list[str]
) -> tuple[Index, Array]:
    """The triangles with every closed shell turned out of the material, and the shells' signed volumes (0 for open ones).

    A shell inside another closed one bounds a cavity, one inside that a solid again.
    """
    volumes = np.zeros(len(closed))
    np.add.at(volumes, shell, _volumes(points, triangles))
    volumes[~closed] = 0.0
    depth = np.zeros(len(closed), np.int64)
    if closed.sum() > 1:
        depth = _depths(points, triangles, shell, closed)
    wrong = closed & (np.where(depth % 2 == 0, volumes, -volumes) < 0.0)
    if wrong.any():
        if wrong.sum() == closed.sum():
            warnings.append("the mesh was inside out and is turned")
        else:
            warnings.append(f"{int(wrong.sum())} of {len(closed)} shells turned: solids outwards, cavities inwards")
        triangles = np.ascontiguousarray(np.where(wrong[shell][:, None], triangles[:, ::-1], triangles))
        volumes[wrong] *= -1.0
    return triangles, volumes


def areas(points: Array, triangles: Index) -> Array:
    """Areas (f,) of triangles."""
    p = points[triangles]
    return 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)


def place(points: Array, edge: ArrayLike, scale: float) -> str:
    """Where an edge is, in the file's numbers."""
    ends = points[np.asarray(edge)[:2]] / scale
    return " to ".join("(" + ", ".join(f"{x:.6g}" for x in end) + ")" for end in ends)


def _triangles(count: int) -> str:
    return "1 triangle" if count == 1 else f"{count} triangles"


def _volumes(points: Array, triangles: Index) -> Array:
    """Signed volumes (f,) of the tetrahedra on the middle of the mesh's box."""
    p = points[triangles] - 0.5 * (points.min(axis=0) + points.max(axis=0))
    return np.einsum("fi,fi->f", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6.0


def _thin(points: Array, triangles: Index) -> Index:
    """The triangles whose widest angle may be nearly straight, by a quick look."""
    p = points[triangles] / np.abs(points).max()
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    n, c = np.cross(a, b), b - a
    area2, aa, bb, cc = (np.einsum("fi,fi->f", x, x) for x in (n, a, b, c))
    return np.flatnonzero(area2 * np.maximum(np.maximum(aa, bb), cc) <= 1e-12 * (aa * bb * cc))


def _apex_sine(points: Array, triangles: Index) -> Array:
    """Sine (f,) of the widest angle."""
    p = points[triangles]
    e = p[:, [1, 2, 0]] - p
    size = np.abs(e).max(axis=2, keepdims=True)
    unit = e / size
    length = np.linalg.norm(unit, axis=2)
    unit /= length[:, :, None]
    k = np.argmax(length * size[:, :, 0], axis=1)  # the longest edge; the apex is between the two others
    rows = np.arange(len(p))
    return np.linalg.norm(np.cross(unit[rows, (k + 1) % 3], unit[rows, (k + 2) % 3]), axis=1)


def _back_to_back(faces: list[tuple[int, ...]], flat: list[int]) -> set[int]:
    """Pairs of flat triangles with the same corners the other way round: what they join meets without them."""
    gone: set[int] = set()
    seen: dict[tuple[int, ...], list[int]] = {}
    for t in flat:
        k = faces[t].index(min(faces[t]))
        a, b, c = (faces[t][(k + s) % 3] for s in range(3))
        others = seen.get((a, c, b))
        if others:
            gone |= {t, others.pop()}
        else:
            seen.setdefault((a, b, c), []).append(t)
    return gone


def _longest(points: Array, face: tuple[int, ...]) -> int:
    p = points[list(face)]
    return int(np.argmax(np.linalg.norm(p[[1, 2, 0]] - p, axis=1)))


def _depths(points: Array, triangles: Index, shell: Index, closed: Mask) -> Index:
    """How many other closed shells each shell lies in, by the solid angle that they fill."""
    count = len(closed)
    order = np.argsort(shell, kind="stable")
    starts = np.searchsorted(shell[order], np.arange(count + 1))
    p = points[triangles]
    low = np.minimum.reduceat(p[order].min(axis=1), starts[:-1])
    high = np.maximum.reduceat(p[order].max(axis=1), starts[:-1])
    depth = np.zeros(count, np.int64)
    for s in range(count):
        around = closed & (low <= low[s]).all(axis=1) & (high >= high[s]).all(axis=1)
        around[s] = False
        where = p[order[starts[s]]].mean(axis=0)
        for other in np.flatnonzero(around):
            mine = p[order[starts[other] : starts[other + 1]]]
            depth[s] += abs(_solid_angle(mine - where)) > 2.0 * np.pi
    return depth


def _solid_angle(p: Array) -> float:
    """The solid angle of triangles p (f, 3, 3) seen from the origin (van Oosterom and Strackee 1983)."""
    a, b, c = p[:, 0], p[:, 1], p[:, 2]
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    top = np.einsum("fi,fi->f", a, np.cross(b, c))
    dots = [np.einsum("fi,fi->f", x, y) for x, y in ((a, b), (b, c), (c, a))]
    return float(2.0 * np.arctan2(top, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb).sum())


@njit
def join_equal(bits: NDArray[np.uint64], first: Index) -> int:
    """first (n,): the number of each row of bits (n, 3), equal rows alike, numbered as they come. Returns how many."""
    size = 16
    while size < 2 * len(bits):
        size *= 2
    table = np.full(size, -1, np.int64)
    mask = np.uint64(size - 1)
    count = 0
    for i in range(len(bits)):
        h = np.uint64(0x9E3779B97F4A7C15)
        for c in range(3):
            h = (h ^ bits[i, c]) * np.uint64(0xBF58476D1CE4E5B9)
            h ^= h >> np.uint64(29)
        slot = h & mask
        while True:
            j = table[slot]
            if j < 0:
                table[slot] = i
                first[i] = count
                count += 1
                break
            if bits[j, 0] == bits[i, 0] and bits[j, 1] == bits[i, 1] and bits[j, 2] == bits[i, 2]:
                first[i] = first[j]
                break
            slot = (slot + np.uint64(1)) & mask
    return count


@njit
def spread(partner: Index, forward: Mask, shell: Index, turn: Mask) -> int:
    """Number the shells (f,), and mark the triangles that lie the other way round than the first of their shell.

    Returns a half-edge where that contradicts itself, or -1.
    """
    f = len(shell)
    for t in range(f):
        shell[t] = -1
        turn[t] = False
    stack = np.empty(f, np.int64)
    count, torn = 0, -1
    for seed in range(f):
        if shell[seed] >= 0:
            continue
        shell[seed] = count
        stack[0], top = seed, 1
        while top > 0:
            top -= 1
            t = stack[top]
            for h in range(3 * t, 3 * t + 3):
                other = partner[h]
                if other < 0:
                    continue
                o = other // 3
                turned = turn[t] ^ (forward[h] == forward[other])
                if shell[o] < 0:
                    shell[o], turn[o] = count, turned
                    stack[top] = o
                    top += 1
                elif turn[o] != turned and torn < 0:
                    torn = h
        count += 1
    return torn
