"""Certified distance where at least one body is given by its signed distance: branch and bound over cells of the other.

A field f is 1-Lipschitz, so no point of its body lies in the ball around q with radius f(q). Over a cell with centre c,
f(c) - radius is a lower bound short by the cell's size. Seen from a point q far behind the cell, along the field's
gradient, the ball's surface is nearly flat, and

    f(x) >= f(q) - |x - q|,   the largest |x - q| over the hull of the corners being at a corner,

is short by the square of the size only. Any q gives a true bound; some are tried and the best is kept.

A field's body is the solid f <= 0; a B-spline body is its faces.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...spline.region import MIXED, OFF
from ..cells import WHOLE
from ..query import DistanceField, lower_bound
from .body import CellStore, SurfaceBody
from .interval import Goal, Search, Witness

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BEHIND = (4.0, 32.0)
"""How far behind a cell, in its radii, the balls' centres are tried; and once as far as the bodies are large."""

NOISE = 1e-13
"""Rounding of a signed distance, relative to the largest coordinate."""

ON_FIELD = 1e-9
"""A point counts as the field's where its distance is below this part of the field's own size."""

GROUP = 32
"""Patches opened at once, nearest first."""

MARCH = 24
"""Steps from a point towards a field's surface; exact distances need one."""


class PointField:
    """A point as a distance field: nothing is inside it."""

    def __init__(self, position: Array) -> None:
        self.position = np.asarray(position, dtype=np.float64).reshape(3)

    def distance(self, points: Array) -> Array:
        return np.asarray(np.linalg.norm(points - self.position, axis=1))

    def gradient(self, points: Array) -> Array:
        arm = points - self.position
        length = np.linalg.norm(arm, axis=1, keepdims=True)
        return np.where(length > 0, arm / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])

    def nearest(self, points: Array) -> Array:
        return np.broadcast_to(self.position, points.shape).copy()

    def box(self) -> Array:
        return np.stack([self.position, self.position])


def signed_distance(field: DistanceField, points: Array) -> Array:
    """The field at points (n, 3). Raises InputError where it is not a number."""
    return _numbers(field.distance(np.ascontiguousarray(points)))


def certain_distance(field: DistanceField, points: Array) -> Array:
    """What is certain of the field at points (n, 3): never farther from 0 than its distance, which some fields find by a
    search. Raises InputError where it is not a number."""
    return _numbers(lower_bound(field, np.ascontiguousarray(points)))


def _numbers(distances: Array) -> Array:
    out = np.asarray(distances, dtype=np.float64)
    if np.isnan(out).any():
        raise InputError("a distance to the tool is not a number", mend="check the tool's sizes, pose and formula")
    return out


def box_of(field: DistanceField) -> Array:
    """The field's box (2, 3). Raises InputError where it is not a number."""
    box = np.asarray(field.box(), dtype=np.float64)
    if np.isnan(box).any():
        raise InputError("the tool's box is not a number", mend="check the tool's sizes and pose")
    return box


def surface_field_distance(body: SurfaceBody, field: DistanceField, goal: Goal) -> Search:
    """The distance of a B-spline body's faces and a field's body."""
    search = Search(goal)
    store = CellStore(body)
    box = box_of(field)
    scale = float(np.abs(body.extents).max())
    finite = box[np.isfinite(box)]
    scale = max(scale, float(np.abs(finite).max(initial=0.0)))
    noise, far = (
        NOISE * scale,
        max(body.size, float(np.linalg.norm(box[1] - box[0])) if np.isfinite(box).all() else 0.0),
    )
    middle, half = body.extents.mean(axis=1), 0.5 * np.linalg.norm(body.extents[:, 1] - body.extents[:, 0], axis=1)
    apart = np.maximum(np.maximum(box[0] - body.extents[:, 1], body.extents[:, 0] - box[1]), 0.0)
    waiting = np.maximum(certain_distance(field, middle) - half, np.linalg.norm(apart, axis=1)) - noise
    order = np.argsort(waiting, kind="stable")
    waiting = np.maximum(waiting[order], 0.0)
    opened, cells, lower = 0, np.zeros(0, np.int64), np.zeros(0)
    while True:
        if (
            opened < len(order)
            and waiting[opened] < search.cutoff
            and (len(cells) == 0 or waiting[opened] <= lower.min())
        ):
            stop = min(opened + GROUP, len(order))
            fresh = np.concatenate([store.spans(int(k)) for k in order[opened:stop]])
            bounds = _lower(store, fresh, field, noise, far, np.zeros(len(fresh)), search)
            cells, lower, opened = np.concatenate([cells, fresh]), np.concatenate([lower, bounds]), stop
        keep = lower < search.cutoff
        search.settle(float(lower[~keep].min(initial=np.inf)))
        cells, lower = cells[keep], lower[keep]
        rest = float(waiting[opened]) if opened < len(order) else np.inf
        if rest >= search.cutoff:
            search.settle(rest)
            rest, opened = np.inf, len(order)
        search.bound(min(float(lower.min(initial=np.inf)), rest))
        if search.ended or (len(cells) == 0 and opened == len(order)):
            return search
        final = store.cut[cells] == WHOLE
        search.settle(float(lower[final].min(initial=np.inf)))
        cells, lower = cells[~final], lower[~final]
        if not len(cells):
            continue
        best = np.argsort(lower, kind="stable")[: max(1, search.left)]
        held, kept = np.setdiff1d(np.arange(len(cells)), best), np.sort(best)
        places = np.concatenate([cells[kept], cells[held]])
        bounds = np.concatenate([lower[kept], lower[held]])
        store.only(places)
        first, children = store.halve(np.arange(len(kept)))
        known = np.repeat(bounds[: len(kept)], np.diff(first))
        fresh = _lower(store, children, field, noise, far, known, search)
        cells = np.concatenate([np.arange(len(kept), len(places)), children])
        lower = np.concatenate([bounds[len(kept) :], fresh])


def _lower(
    store: CellStore, cells: Index, field: DistanceField, noise: float, far: float, known: Array, search: Search
) -> Array:
    """Lower bounds of the field's distance over cells, and what their corners say of the upper bound."""
    if not len(cells):
        return known
    search.pairs += len(cells)
    centre, radius = store.ball[cells, :3], store.ball[cells, 3]
    hull, grown = store.hull[cells], store.grown[cells]
    value = certain_distance(field, centre)
    lower = np.maximum(known, value - radius - noise)
    near = np.flatnonzero(lower < search.cutoff)
    if len(near):
        behind = field.gradient(np.ascontiguousarray(centre[near]))
        for t in [*(k * radius[near] for k in BEHIND), np.full(len(near), far)]:
            q = centre[near] + t[:, None] * behind
            reach = np.linalg.norm(hull[near] - q[:, None], axis=2).max(axis=1)
            bound = certain_distance(field, q) - reach - grown[near] - noise - 1e-15 * t
            lower[near] = np.maximum(lower[near], bound)
    _corners(store, cells[near], field, search)
    return np.maximum(lower, 0.0)


def _corners(store: CellStore, cells: Index, field: DistanceField, search: Search) -> None:
    """Upper bounds: the field at the corners that lie on the face; where none of a mixed cell does, at its border."""
    if not len(cells):
        return
    points = store.corners[cells].reshape(-1, 3)
    value = signed_distance(field, points)
    tried = 0
    for k in np.argsort(value, kind="stable").tolist():
        if value[k] >= search.high or tried == 6:
            return
        cell, corner = int(cells[k // 4]), k % 4
        r, face = store.rectangle[cell], int(store.patch[cell])
        uv = np.array([r[corner & 1], r[2 + (corner >> 1)]])
        point, width = points[k], 0.0
        if store.on[cell] == MIXED:
            region = store.body.region(face)
            assert region is not None
            place = int(region.locate(uv)[0])
            if place == OFF:
                tried += 1
                for chord, w, off in region.border_in(r):
                    _take(store, face, chord[0] + w * (chord[1] - chord[0]), off, field, search)
                continue
            width = region.width if place == MIXED else 0.0
        if not _take(store, face, uv, width, field, search, point):
            tried += 1


def _take(
    store: CellStore,
    face: int,
    uv: Array,
    width: float,
    field: DistanceField,
    search: Search,
    point: Array | None = None,
) -> bool:
    """Take in the point of a face at (u, v), known to a width of its border, where it is nearer to the field."""
    g = store.body.patch(face)
    surface = store.body.tool.grids[face].surface
    if point is None or width > 0.0:
        d = surface.with_control_points(store.body.tool.nets[face]).derivatives(uv[0], uv[1], 1)
        point = d[0, 0]
        region = store.body.region(face)
        if region is not None and width > 0.0:
            width *= float(np.linalg.norm(d[1, 0]) * region.size[0] + np.linalg.norm(d[0, 1]) * region.size[1])
    found = touch_point(field, point)
    if found is None:
        return False
    its, away = found
    if away + width + g.slack >= search.high:
        return False
    search.lower_high(away + width + g.slack, Witness(point.copy(), face, float(uv[0]), float(uv[1])), Witness(its))
    return True


def touch_point(field: DistanceField, point: Array) -> tuple[Array, float] | None:
    """A point of the field's body near a point, and how far it is: the point itself where that lies inside. None where
    none was found.

    Exact distances give the nearest one at once; fields that only bound the distance are followed down to their surface.
    """
    if signed_distance(field, point[None])[0] <= 0.0:
        return point, 0.0
    box = box_of(field)
    size = float(np.linalg.norm(box[1] - box[0])) if np.isfinite(box).all() else 1.0 + float(np.abs(point).max())
    near = ON_FIELD * size + NOISE * float(np.abs(point).max())
    at = np.asarray(field.nearest(point[None]), dtype=np.float64)
    if not np.isfinite(at).all():
        raise InputError("a nearest point of the tool is not a number", mend="check the tool's sizes and pose")
    for _ in range(MARCH):
        value = float(signed_distance(field, at)[0])
        if value <= near:
            return at[0], float(np.linalg.norm(at[0] - point)) + max(0.0, value)
        at = at - value * field.gradient(at)
    return None


def fields_distance(a: DistanceField, b: DistanceField, goal: Goal) -> Search:
    """The distance of the bodies of two fields, over a tree of boxes of the smaller one.

    With y on b's side of a box and q behind it, on the line through its centre c along b's gradient: a point x of a has
    |x - y| >= f_a(y), so that it lies no farther from q than where that ball leaves the box, and f_b(x) >= f_b(q) - |x -
    q|. Both balls are nearly flat, so the bound is short by the square of the box.
    """
    boxes = [box_of(a), box_of(b)]
    sizes = [float(np.linalg.norm(box[1] - box[0])) if np.isfinite(box).all() else np.inf for box in boxes]
    if not np.isfinite(sizes).any():
        raise InputError("two tools without end", mend="bound one of them: half-spaces have no size")
    search = Search(goal)
    swap = sizes[1] < sizes[0]
    if swap:
        a, b, boxes, sizes = b, a, boxes[::-1], sizes[::-1]
    box = boxes[0]
    noise = NOISE * float(np.abs(np.concatenate([k[np.isfinite(k)] for k in boxes])).max(initial=1e-300))
    far = sizes[1] if np.isfinite(sizes[1]) else sizes[0]
    pad = 1e-12 * sizes[0] + noise
    low, high = (box[0] - pad)[None], (box[1] + pad)[None]
    lower = np.zeros(1)
    while True:
        centre, radius = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1)
        inner = certain_distance(a, centre)
        here = inner <= radius + noise
        low, high, lower, centre, radius = low[here], high[here], lower[here], centre[here], radius[here]
        search.pairs += len(inner)
        if len(centre):
            lower = np.maximum(lower, _between(a, b, centre, radius, far, noise))
            _project(a, b, centre[np.argsort(lower, kind="stable")[:2]], search, swap)
        keep = lower < search.cutoff
        search.settle(float(lower[~keep].min(initial=np.inf)))
        low, high, lower, radius = low[keep], high[keep], lower[keep], radius[keep]
        search.bound(float(lower.min(initial=np.inf)))
        if search.ended or not len(low):
            return search
        final = radius <= pad
        search.settle(float(lower[final].min(initial=np.inf)))
        low, high, lower = low[~final], high[~final], lower[~final]
        axis = np.argmax(high - low, axis=1)
        i = np.arange(len(low))
        middle = 0.5 * (low[i, axis] + high[i, axis])
        upper_low, lower_high = low.copy(), high.copy()
        upper_low[i, axis], lower_high[i, axis] = middle, middle
        low, high = np.concatenate([low, upper_low]), np.concatenate([lower_high, high])
        lower = np.concatenate([lower, lower])


def _between(a: DistanceField, b: DistanceField, centre: Array, radius: Array, far: float, noise: float) -> Array:
    """Lower bounds of f_b over the part of a in balls around centre (n, 3) with radius (n,)."""
    value = certain_distance(b, centre)
    best = value - radius - noise
    normal = b.gradient(np.ascontiguousarray(centre))
    for behind in (4.0 * radius, 32.0 * radius, np.full(len(radius), far)):
        for ahead in (4.0 * radius, 32.0 * radius, np.full(len(radius), far)):
            q, y = centre + behind[:, None] * normal, centre - ahead[:, None] * normal
            ball = certain_distance(a, y) - noise
            # x = q - alpha normal + s: |x - y|^2 = (L - alpha)^2 + s^2 >= ball^2 on this side of y
            length, s2 = behind + ahead, radius * radius
            holds = (ball > 0.0) & (ball * ball > s2) & (ahead > radius)
            most = np.where(holds, length - np.sqrt(np.maximum(ball * ball - s2, 0.0)), behind + radius)
            most = np.clip(most, behind - radius, behind + radius)
            reach = np.sqrt(most * most + s2)
            best = np.maximum(best, certain_distance(b, q) - reach - 2.0 * noise)
    return np.maximum(best, 0.0)


def _project(a: DistanceField, b: DistanceField, starts: Array, search: Search, swap: bool) -> None:
    """Upper bounds: from points near a, back and forth between the nearest points of either."""
    for start in starts:
        found = touch_point(a, start)
        if found is None:
            continue
        x = found[0]
        # a start inside of a says nothing of a's surface, but it is a point of a
        for _ in range(12):
            its = touch_point(b, x)
            if its is None:
                break
            back = touch_point(a, its[0])
            witness = (Witness(x), Witness(its[0]))
            search.lower_high(its[1], *(witness[::-1] if swap else witness))
            if back is None or back[1] >= its[1] * (1 - 1e-9):
                break
            x = back[0]
