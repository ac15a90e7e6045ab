"""Sculpted faces back into the entities of the IGES file that they were read from."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..spline.refine import insert_knots, missing_knots
from ..spline.surface import BSplineSurface, TrimCurve
from .iges_curves import curves_of, segment_rows, whole_of
from .iges_entities import number
from .iges_kernel import matrix_of, matrix_pointer
from .iges_patches import NEAR, spline_of
from .iges_records import Entity, IgesFile
from .iges_rewrite import Change
from .part import FaceEdge
from .step_text import step_real
from .u_fastest import rows_of_surface

Array = NDArray[np.float64]

SAME = 1e-14
"""Relative difference below which control points count as not moved; clamping rounds them."""
STAYS = 1e-9
"""How far a border may move, relative to the surface's size, and still count as where it was."""


def changes_of_face(
    file: IgesFile,
    pointer: int,
    read: BSplineSurface,
    new: BSplineSurface,
    edges: tuple[FaceEdge, ...],
    scale: float,
) -> dict[int, Change]:
    """What becomes of which entities when the face at `pointer`, read as `read` (mm), is sculpted to `new`.

    edges : of the face as read. scale : mm that one unit of the file is. The surface's entity changes, and where the border
    moved the curves in space along it. Raises InputError when the file's entities cannot hold the result one by one.
    """
    entity = file.at(pointer)
    place = {128: 0, 144: 1, 143: 2, 510: 1}.get(entity.type if entity else 0)
    under = entity if place == 0 else file.at(whole_of(entity, place)) if entity is not None and place else None
    if entity is None or under is None or under.type != 128:
        raise InputError("its surface is of a kind that has no control points")
    if place and _uses(file, under.pointer) > 1:
        raise InputError("its surface is that of other faces as well")
    changes = {under.pointer: _surface(file, under, read, new, scale)}
    if place and _border_moves(read, new, edges):
        if entity.type != 144:
            raise InputError("its border moved, and other faces may hold it")
        changes |= _border(file, entity, read, new, scale)
    return changes


def _uses(file: IgesFile, pointer: int) -> int:
    """How many bounded faces have this surface."""
    place = {144: 1, 143: 2, 510: 1}
    return sum(
        e.type in place and e.parameters[place[e.type] : place[e.type] + 1] == [str(pointer)] for e in file.entities
    )


def _border_moves(read: BSplineSurface, new: BSplineSurface, edges: tuple[FaceEdge, ...]) -> bool:
    for edge in edges:
        u, v = edge.uv.T
        if np.abs(new.evaluate(u, v) - read.evaluate(u, v)).max() > STAYS * read.size:
            return True
    return False


def _surface(file: IgesFile, entity: Entity, read: BSplineSurface, new: BSplineSurface, scale: float) -> Change:
    """Entity 128 with the displacements of the sculpted face; what did not move keeps the file's own digits."""
    own, read, new = spline_of(entity), _clamped(read), _clamped(new)
    same = (own.degree_u, own.degree_v) == (read.degree_u, read.degree_v) and own.shape == read.shape
    if not same or not (np.array_equal(own.knots_u, read.knots_u) and np.array_equal(own.knots_v, read.knots_v)):
        raise InputError("the CAD kernel gave its surface other knots")
    fine, before = (insert_knots(surface, *missing_knots(surface, new)) for surface in (own, read))
    if before.shape != new.shape or fine.shape != new.shape:
        raise InputError("the sculpted surface has other knots than the file's with more of them")
    matrix = matrix_of(file, matrix_pointer(entity))[:3, :3]
    shift = np.linalg.solve(matrix, (new.control_points - before.control_points).reshape(-1, 3).T).T / scale
    shift = shift.reshape(*fine.shape, 3)
    moved = np.abs(shift) > SAME * read.size / scale
    net = np.where(moved, fine.control_points + shift, fine.control_points)
    old = entity.parameters
    if fine.shape == own.shape:
        count = own.shape[0] * own.shape[1]
        first = 10 + len(own.knots_u) + len(own.knots_v) + count
        parameters, places = list(old), moved.transpose(1, 0, 2).ravel()
        for k, value in enumerate(net.transpose(1, 0, 2).ravel().tolist()):
            if places[k]:
                parameters[first + k] = step_real(value)
        return Change(128, _form(entity), parameters)
    points, weights = rows_of_surface(fine.with_control_points(net))
    r, s = fine.shape
    told = own.weights is None and number(old[10 + len(own.knots_u) + len(own.knots_v)])
    values = np.full(r * s, told or 1.0) if weights is None else weights
    numbers = np.concatenate([fine.knots_u, fine.knots_v, values, points.ravel()])
    last = 10 + len(own.knots_u) + len(own.knots_v) + 4 * own.shape[0] * own.shape[1]
    head = ["128", str(r - 1), str(s - 1), *old[3:10]]
    return Change(128, _form(entity), [*head, *(step_real(x) for x in numbers.tolist()), *old[last:]])


def _clamped(surface: BSplineSurface) -> BSplineSurface:
    """The same surface with full knots at the ends of its periodic directions, as the file has it."""
    for axis, periodic in enumerate((surface.periodic_u, surface.periodic_v)):
        if not periodic:
            continue
        w = np.ones(surface.shape) if surface.weights is None else surface.weights
        rows = np.moveaxis(np.concatenate([surface.control_points * w[..., None], w[..., None]], axis=2), axis, 0)
        knots, degree = ((surface.knots_u, surface.degree_u), (surface.knots_v, surface.degree_v))[axis]
        flat, knots = segment_rows(rows.reshape(len(rows), -1), knots, degree, *surface.domain[axis])
        net = np.moveaxis(flat.reshape(len(flat), *rows.shape[1:]), 0, axis)
        weights = None if surface.weights is None else net[..., 3]
        label = "uv"[axis]
        changed: dict[str, Any] = {f"knots_{label}": knots, f"periodic_{label}": False}
        surface = replace(surface, control_points=net[..., :3] / net[..., 3:], weights=weights, **changed)
    return surface


def _form(entity: Entity) -> int:
    text = entity.fields[14].strip()
    return int(text) if text else 0


# ---------------------------------------------------------------------- border


def _border(
    file: IgesFile, entity: Entity, read: BSplineSurface, new: BSplineSurface, scale: float
) -> dict[int, Change]:
    """The curves in space of a trimmed surface (144), as they run on its new shape."""
    changes: dict[int, Change] = {}
    count = whole_of(entity, 3)
    for pointer in [whole_of(entity, 4), *(whole_of(entity, 5 + i) for i in range(count))]:
        boundary = file.at(pointer) if pointer else None
        if boundary is None:
            continue
        flat, space = whole_of(boundary, 3), whole_of(boundary, 4)
        if not space:
            continue
        if not flat:
            raise InputError("its border moved, and has no curve in the parameter plane")
        flats, spaces = _leaves(file, flat), _leaves(file, space)
        if len(flats) != len(spaces):
            raise InputError("its border moved, and is cut otherwise in space than in the parameter plane")
        for one, other in zip(flats, spaces, strict=True):
            changes[other] = _space_curve(file, one, other, read, new, scale)
    return changes


def _leaves(file: IgesFile, pointer: int) -> list[int]:
    """The places of the simple curves that a curve is composed of."""
    entity = file.at(pointer)
    if entity is None:
        raise InputError(f"entity {pointer} is not there")
    if entity.type != 102:
        return [pointer]
    if matrix_pointer(entity):
        raise InputError("its border is a composed curve with a matrix of its own")
    return [leaf for i in range(whole_of(entity, 1)) for leaf in _leaves(file, whole_of(entity, 2 + i))]


def _space_curve(
    file: IgesFile, flat: int, space: int, read: BSplineSurface, new: BSplineSurface, scale: float
) -> Change:
    from .occt.curve import curve_on_surface, spline_arrays
    from .occt.quiet import quiet
    from .occt.shape import geom_of_surface
    from .occt.trim import geom_of_trim, reversed_trim, trim_domain

    if _owners(file, space) > 1:
        raise InputError("its border moved, and others hold a curve of it")
    (piece,), (line,) = curves_of(file, flat), curves_of(file, space)
    trim = TrimCurve(np.ascontiguousarray(piece.control_points[:, :2]), piece.knots, piece.degree, piece.weights)
    (a, b), (c, d) = read.domain
    ends = np.clip(trim.control_points[[0, -1]], (a, c), (b, d))
    there = read.evaluate(*ends.T) / scale
    known = line.control_points[[0, -1]]
    gaps = [float(np.abs(there - known[::step]).max()) for step in (1, -1)]
    if min(gaps) > NEAR * read.size / scale:
        raise InputError("its border moved, and its curves in space do not match those in the parameter plane")
    if gaps[1] < gaps[0]:
        trim = reversed_trim(trim)
    with quiet():
        first, last = trim_domain(trim)
        curve, _ = curve_on_surface(geom_of_surface(new), geom_of_trim(trim), first, last, 1e-9 * new.size)
        points, knots, degree, weights = spline_arrays(curve, first, last)
    values = [*knots.tolist(), *(np.ones(len(points)) if weights is None else weights).tolist()]
    values += (points / scale).ravel().tolist() + [first, last, 0.0, 0.0, 0.0]
    closed = np.abs(points[0] - points[-1]).max() <= STAYS * new.size
    flags = ["0", str(int(closed)), str(int(weights is None)), "0"]
    return Change(126, 0, ["126", str(len(points) - 1), str(degree), *flags, *map(step_real, values)], placed=True)


def _owners(file: IgesFile, pointer: int) -> int:
    """How many composites and curves on surfaces hold a curve."""
    text = str(pointer)
    return sum(
        (e.type == 102 and text in e.parameters[2:])
        or (e.type == 142 and text in e.parameters[3:5])
        or (e.type == 141 and text in e.parameters[5:])
        or (e.type == 504 and text in e.parameters[2::5])
        for e in file.entities
    )
