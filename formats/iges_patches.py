"""Patches of IGES files as B-spline surfaces by the standard's own tables, for those that the CAD kernel drops.

Read are B-spline surfaces (128) and parametric splines (114), by themselves, trimmed (144), bounded (143) or as faces of a
shell (510). Trim curves are those in the parameter plane, where they lie in it and on their curve in space; else the curve in
space is projected.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import CadsculptError, InputError
from ..spline.surface import BSplineSurface, Provenance, TrimCurve, TrimLoop
from .iges_curves import BEZIER_OF_POWERS, Curve, curves_of, reals_of, whole_of
from .iges_entities import spline_counts
from .iges_kernel import completed, matrix_of, matrix_pointer
from .iges_records import Entity, IgesFile
from .u_fastest import surface_of_rows

Array = NDArray[np.float64]

NEAR = 1e-3
"""How far a trim curve may lie from its curve in space, or its ends from each other, relative to the surface's size."""


def patch_of(file: IgesFile, entity: Entity) -> tuple[BSplineSurface, list[str]]:
    """The face of an entity (128, 114, 144, 143 or 510), lengths in the file's unit, and what had to be done for it.

    Raises InputError when its surface is of another kind or damaged.
    """
    if entity.type in (114, 128):
        return surface_of(file, entity), []
    place = {144: 1, 143: 2, 510: 1}.get(entity.type)
    under = file.at(whole_of(entity, place)) if place else None
    if under is None or under.type not in (114, 128):
        raise InputError(f"entity {entity.pointer} (type {entity.type}) has no spline surface")
    surface = surface_of(file, under)
    reader = {144: _loops_of_trimmed, 143: _loops_of_bounded, 510: _loops_of_face}[entity.type]
    try:
        loops, said = reader(file, entity, surface)
    except CadsculptError as error:
        return surface, [f"its trims cannot be read, the whole surface is there: {error.what}"]
    return replace(surface, trims=tuple(loops) or None), said


# -------------------------------------------------------------------- surfaces


def surface_of(file: IgesFile, entity: Entity) -> BSplineSurface:
    """The untrimmed surface of entity 128 or 114. Raises InputError when it is damaged."""
    surface = spline_of(entity) if entity.type == 128 else _parametric_spline(entity)
    matrix = matrix_of(file, matrix_pointer(entity))
    if np.array_equal(matrix, np.eye(4)):
        return surface
    return surface.with_control_points(surface.control_points @ matrix[:3, :3].T + matrix[:3, 3])


def spline_of(entity: Entity) -> BSplineSurface:
    """Entity 128 (section 4.23) where its matrix has not moved it. Raises InputError when it is damaged."""
    parameters = completed(entity.parameters) or entity.parameters
    counts = spline_counts(parameters)
    if counts is None:
        raise InputError(f"the degrees or counts of entity {entity.pointer} cannot be")
    (k1, k2), (m1, m2) = counts
    a, b, c = k1 + m1 + 2, k2 + m2 + 2, (k1 + 1) * (k2 + 1)
    values = reals_of(Entity(entity.pointer, entity.fields, parameters), 10, a + b + 4 * c)
    weights = values[a + b : a + b + c]
    return surface_of_rows(
        values[a + b + c :],
        None if (weights == weights[0]).all() else weights,
        (values[:a], values[a : a + b]),
        (m1, m2),
        name="",
        provenance=Provenance("", f"entity {entity.pointer}", ""),
        where=f"entity {entity.pointer}",
    )


def _parametric_spline(entity: Entity) -> BSplineSurface:
    """Entity 114 (section 4.16): bicubic power patches, each row of patches followed by one of zeros."""
    m, n = whole_of(entity, 3), whole_of(entity, 4)
    if not (0 < m <= 10_000 and 0 < n <= 10_000):
        raise InputError(f"{m} x {n} patches in entity {entity.pointer}")
    u, v = reals_of(entity, 5, m + 1), reals_of(entity, 6 + m, n + 1)
    hu, hv = np.diff(u), np.diff(v)
    if not ((hu > 0.0).all() and (hv > 0.0).all()):
        raise InputError(f"the breaks of entity {entity.pointer} do not ascend")
    size = 48 * ((m - 1) * (n + 1) + n)
    values = np.zeros(48 * m * (n + 1))
    values[:size] = reals_of(entity, 7 + m + n, size)
    powers = values.reshape(m, n + 1, 3, 4, 4)[:, :n]  # (patch u, patch v, xyz, power of v, power of u)
    exponent = np.arange(4)
    scaled = (
        powers * (hu[:, None] ** exponent)[:, None, None, None, :] * (hv[:, None] ** exponent)[None, :, None, :, None]
    )
    bezier = np.einsum("ap,bq,mndqp->mnabd", BEZIER_OF_POWERS, BEZIER_OF_POWERS, scaled)
    net = np.empty((3 * m + 1, 3 * n + 1, 3))
    for i in range(m):
        for j in range(n):
            net[3 * i : 3 * i + 4, 3 * j : 3 * j + 4] = bezier[i, j]
    knots_u, knots_v = (np.concatenate([t[:1], np.repeat(t, 3), t[-1:]]) for t in (u, v))
    return BSplineSurface(net, knots_u, knots_v, 3, 3)


# ----------------------------------------------------------------------- trims


def _loops_of_trimmed(file: IgesFile, entity: Entity, surface: BSplineSurface) -> tuple[list[TrimLoop], list[str]]:
    """Entity 144 (section 4.34): an outer curve on the surface (142), or the surface's border, and inner ones."""
    said: list[str] = []
    outer, count, first = whole_of(entity, 2), whole_of(entity, 3), whole_of(entity, 4)
    loops = []
    if outer:
        loops.append(TrimLoop(tuple(_on_surface(file, first, surface, said)), True))
    elif count:
        loops.append(_border(surface))
    loops += [TrimLoop(tuple(_on_surface(file, whole_of(entity, 5 + i), surface, said)), False) for i in range(count)]
    return loops, list(dict.fromkeys(said))


def _on_surface(file: IgesFile, pointer: int, surface: BSplineSurface, said: list[str]) -> list[TrimCurve]:
    """Entity 142 (section 4.32): a curve in the parameter plane, one in space, or both."""
    entity = file.at(pointer)
    if entity is None or entity.type != 142:
        raise InputError(f"entity {pointer} is no curve on a surface")
    flat, space = whole_of(entity, 3), whole_of(entity, 4)
    return _best(file, [flat] if flat else [], [(space, False)] if space else [], surface, said)


def _loops_of_bounded(file: IgesFile, entity: Entity, surface: BSplineSurface) -> tuple[list[TrimLoop], list[str]]:
    """Entity 143 (section 4.33): boundaries (141, section 4.31), each a list of curves in space with their pieces in the
    parameter plane."""
    said: list[str] = []
    loops: list[TrimLoop] = []
    for i in range(whole_of(entity, 3)):
        boundary = file.at(whole_of(entity, 4 + i))
        if boundary is None or boundary.type != 141:
            raise InputError(f"entity {entity.pointer} has no boundary in place {i + 1}")
        at, flat, space = 5, [], []
        for _ in range(whole_of(boundary, 4)):
            pieces = whole_of(boundary, at + 2)
            space.append((whole_of(boundary, at), whole_of(boundary, at + 1) == 2))
            flat += [whole_of(boundary, at + 3 + k) for k in range(pieces)]
            at += 3 + pieces
        loops.append(TrimLoop(tuple(_best(file, flat, space, surface, said)), not loops))
    return loops, list(dict.fromkeys(said))


def _loops_of_face(file: IgesFile, entity: Entity, surface: BSplineSurface) -> tuple[list[TrimLoop], list[str]]:
    """Entity 510 (section 4.150): loops (508) of edges that stand in edge lists (504)."""
    said: list[str] = []
    loops: list[TrimLoop] = []
    for i in range(whole_of(entity, 2)):
        loop = file.at(whole_of(entity, 4 + i))
        if loop is None or loop.type != 508:
            raise InputError(f"entity {entity.pointer} has no loop in place {i + 1}")
        at, flat, space = 2, [], []
        for _ in range(whole_of(loop, 1)):
            is_vertex, pointer, index = (whole_of(loop, at + k) for k in range(3))
            along, pieces = whole_of(loop, at + 3) == 1, whole_of(loop, at + 4)
            flat += [whole_of(loop, at + 6 + 2 * k) for k in range(pieces)]
            at += 5 + 2 * pieces
            if is_vertex:
                continue
            edges = file.at(pointer)
            if edges is None or edges.type != 504:
                raise InputError(f"the loop of entity {loop.pointer} has an edge that is none")
            space.append((whole_of(edges, 2 + 5 * (index - 1)), not along))
        loops.append(TrimLoop(tuple(_best(file, flat, space, surface, said)), not loops))
    return loops, list(dict.fromkeys(said))


def _border(surface: BSplineSurface) -> TrimLoop:
    """The surface's own border as a loop."""
    (a, b), (c, d) = surface.domain
    corners = np.array([(a, c), (b, c), (b, d), (a, d), (a, c)])
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    return TrimLoop(tuple(TrimCurve(corners[k : k + 2], knots, 1) for k in range(4)), True)


def _best(
    file: IgesFile, flat: list[int], space: list[tuple[int, bool]], surface: BSplineSurface, said: list[str]
) -> list[TrimCurve]:
    """The trim curves of one loop: those in the parameter plane where they are sound, else the curves in space, projected.

    flat : places of curves in the parameter plane. space : of curves in space, and whether they are run backwards.
    """
    fault = "there are no curves in the parameter plane"
    if flat:
        try:
            curves = [_flattened(curve) for pointer in flat for curve in curves_of(file, pointer)]
            fault = _fault(curves, surface)
            if not fault and space:
                fault = _strays(curves, [c for pointer, _ in space for c in curves_of(file, pointer)], surface)
        except InputError as error:
            fault = error.what
        if not fault:
            return curves
    if not space:
        raise InputError(fault)
    lines: list[Curve] = []
    for pointer, backwards in space:
        pieces = curves_of(file, pointer)
        lines += [_reversed(piece) for piece in reversed(pieces)] if backwards else pieces
    projected = _projected(lines, surface)
    still = _fault(projected, surface)
    if still:
        raise InputError(f"{fault}, and the curves in space give none: {still}")
    said.append(
        "trim curves were projected from the curves in space, as those in the parameter plane are missing or wrong"
    )
    return projected


def _flattened(curve: Curve) -> TrimCurve:
    return TrimCurve(np.ascontiguousarray(curve.control_points[:, :2]), curve.knots, curve.degree, curve.weights)


def _reversed(curve: Curve) -> Curve:
    knots = (curve.knots[0] + curve.knots[-1]) - curve.knots[::-1]
    return Curve(
        curve.control_points[::-1], knots, curve.degree, None if curve.weights is None else curve.weights[::-1]
    )


def _fault(curves: list[TrimCurve], surface: BSplineSurface) -> str:
    """What is wrong with a loop in the parameter plane; "" when nothing is."""
    (a, b), (c, d) = surface.domain
    extent = np.array([b - a, d - c])
    low, high = np.array([a, c]) - NEAR * extent, np.array([b, d]) + NEAR * extent
    closed = np.array([surface.closed_u, surface.closed_v])
    points = np.concatenate([curve.control_points[[0, -1]] for curve in curves]) if curves else np.zeros((0, 2))
    if not len(points):
        return "a loop without curves"
    if (((points < low) | (points > high)) & ~closed).any():
        return "a trim curve leaves the surface"
    ends = np.roll(points[1::2], 1, axis=0) - points[::2]
    ends = np.where(closed, ends - extent * np.round(ends / extent), ends)
    if (np.abs(ends) > 10.0 * NEAR * extent).any():
        jumps = surface.evaluate(*_clipped(points[::2], surface)) - surface.evaluate(
            *_clipped(np.roll(points[1::2], 1, axis=0), surface)
        )
        if (np.linalg.norm(jumps, axis=1) > NEAR * surface.size).any():
            return "the trim curves of a loop do not meet"
    return ""


def _clipped(uv: Array, surface: BSplineSurface) -> tuple[Array, Array]:
    (a, b), (c, d) = surface.domain
    return np.clip(uv[:, 0], a, b), np.clip(uv[:, 1], c, d)


def _strays(curves: list[TrimCurve], lines: list[Curve], surface: BSplineSurface) -> str:
    """Where the ends of trim curves lie off those of the curves in space; "" when they do not."""
    starts = np.array([curve.control_points[0] for curve in curves])
    corners = np.concatenate([line.control_points[[0, -1]] for line in lines])
    if len(starts) != len(lines):
        return ""
    points = surface.evaluate(*_clipped(starts, surface))
    distance = np.linalg.norm(points[:, None] - corners, axis=2).min(axis=1)
    return "a trim curve lies off its curve in space" if distance.max() > NEAR * surface.size else ""


def _projected(lines: list[Curve], surface: BSplineSurface) -> list[TrimCurve]:
    """Curves in space as trim curves of the surface that they lie on. Raises InputError when one has no projection."""
    from .occt.project import projected_curve

    found = []
    for line in lines:
        made = projected_curve(line.control_points, line.knots, line.degree, line.weights, surface)
        if made is None:
            raise InputError("a curve in space cannot be projected onto its surface")
        found.append(made)
    return found
