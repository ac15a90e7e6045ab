"""Sculpted surfaces put into the part that was read: the kernel's own surfaces get the new poles, in place.

A B-spline face keeps its surface: knots are inserted and poles set. Other kinds get a B-spline surface in the place of the
old one, and their edges trim curves on it. Faces, edges and vertices stay the same topological shapes, so that names,
colours, layers and neighbours stay too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepTools import BRepTools
from OCP.Geom import Geom_BSplineSurface, Geom_Surface
from OCP.Geom2d import Geom2d_Curve
from OCP.gp import gp_Pnt
from OCP.TopoDS import TopoDS, TopoDS_Edge

from ...errors import GeometryError, InputError
from ...spline.surface import BSplineSurface
from .arrays import from_integers, from_reals, integers, knots_and_multiplicities, reals
from .boundary import pcurve, placement
from .face import TRIM_TOLERANCE, OcctFace, parameter_scale, periodic_window
from .follow import Gaps, Moved, follow
from .shape import geom_of_surface, periodic_knots, surface_of_geom, transformed, unrolled_knots
from .tolerance import FORWARD, REVERSED, edges_of
from .trim import carried_trim, geom_of_trim

if TYPE_CHECKING:
    from .part import OcctPart

Array = NDArray[np.float64]

SAME = 1e-9
"""Relative difference below which knots, weights and repeated control points are the same."""


def sculpt(part: OcctPart, surfaces: Mapping[int, BSplineSurface]) -> Moved:
    """Give the faces with these numbers their sculpted surfaces; edges and vertices follow.

    Returns those that moved. Raises InputError or GeometryError, before anything is changed, for a surface that does not
    belong to its face.
    """
    faces = {number: part.face(number) for number in sorted(surfaces)}
    for number, face in faces.items():
        _check(face, surfaces[number])
    every = [part.face(face.number) for face in part.faces]
    shapes = [face.shape.TShape() for face in every]
    geoms = [face.geom if placement(face.shape)[0] is not None else None for face in every]
    chosen = _one_per_shape(faces, surfaces, shapes)
    for number in chosen:
        twins = part.twins(number)
        if twins:
            others = ", ".join(map(str, twins[:6])) + (", ..." if len(twins) > 6 else "")
            part.warnings.append(
                f"face {number} is placed several times: its new shape shows in face {others} as well"
                " (name its instance, in the scene's instances or with --instance, to change one place)"
            )
    before = Gaps([faces[number] for number in chosen])
    for number in chosen:
        face, surface = faces[number], surfaces[number]
        geom = geoms[number - 1]
        sharing = [i for i, other in enumerate(geoms) if other is geom and shapes[i] is not shapes[number - 1]]
        if not isinstance(geom, Geom_BSplineSurface):
            _replace(face, geom_of_surface(_brought_home(surface, face)), shares=bool(sharing))
        else:
            if sharing:
                own = geom.Copy()
                _replace(face, own, shares=True)
                geoms[number - 1] = geom = own
            _set_poles(face, geom, surface)
        BRepTools.Clean_s(face.shape)
    for face in every:
        face.forget()
    return follow(part, [faces[number] for number in chosen], before)


# ------------------------------------------------------------------------ checks


def _check(face: OcctFace, surface: BSplineSurface) -> None:
    """The sculpted surface must be the face's own, with more knots and other control points."""
    surface.validate()
    own = face.surface
    where = face.where
    spline = isinstance(face.geom, Geom_BSplineSurface)
    higher = surface.degree_u >= own.degree_u and surface.degree_v >= own.degree_v
    # what becomes a spline only now may be one of a higher degree
    if (surface.degree_u, surface.degree_v) != (own.degree_u, own.degree_v) and (spline or not higher):
        raise InputError(
            f"the sculpted surface has degrees {surface.degree_u} x {surface.degree_v}", where=where,
            mend=f"the face has {own.degree_u} x {own.degree_v}",
        )  # fmt: skip
    if (surface.periodic_u, surface.periodic_v) != (own.periodic_u, own.periodic_v):
        raise InputError("the sculpted surface is periodic where the face is not, or not where it is", where=where)
    if surface.rational != own.rational:
        raise InputError("the sculpted surface has weights where the face has none, or none where it has", where=where)
    for label, new, old, domain in (
        ("u", surface.knots_u, own.knots_u, (surface.domain[0], own.domain[0])),
        ("v", surface.knots_v, own.knots_v, (surface.domain[1], own.domain[1])),
    ):
        slack = SAME * (old[-1] - old[0])
        if np.abs(np.subtract(*domain)).max() > slack:
            raise InputError(f"the sculpted surface has another parameter range in {label}", where=where)
        values, counts = knots_and_multiplicities(old[(old >= domain[1][0]) & (old <= domain[1][1])])
        lacking = [v for v, c in zip(values, counts, strict=True) if (np.abs(new - v) <= slack).sum() < c]
        if lacking:
            raise InputError(f"the sculpted surface lacks the face's knot {lacking[0]:g} in {label}", where=where)


def _one_per_shape(
    faces: Mapping[int, OcctFace], surfaces: Mapping[int, BSplineSurface], shapes: list[object]
) -> list[int]:
    """Of faces that are one shape placed several times, one; their surfaces must agree."""
    chosen: list[int] = []
    for number in faces:
        same = next((n for n in chosen if shapes[n - 1] is shapes[number - 1]), None)
        if same is None:
            chosen.append(number)
            continue
        a, b = (_brought_home(surfaces[n], faces[n]) for n in (same, number))
        if a.shape != b.shape or np.abs(a.control_points - b.control_points).max() > SAME * max(a.size, 1.0):
            raise InputError(
                f"faces {same} and {number} are one face placed twice and cannot take two different shapes",
                where=str(faces[number].provenance.file),
                mend="name both places in the scene's instances, or with --instance, or sculpt one of them",
            )
    return chosen


# ---------------------------------------------------------------------- surfaces


def _brought_home(surface: BSplineSurface, face: OcctFace) -> BSplineSurface:
    """The surface in the frame of the kernel's surface, before the face was placed."""
    location = face.location
    if location.IsIdentity():
        return surface
    back = location.Inverted().Transformation()
    return surface.with_control_points(transformed(surface.control_points, back))


def _set_poles(face: OcctFace, geom: Geom_BSplineSurface, surface: BSplineSurface) -> None:
    """Insert the knots that the sculpted surface has more, and set the poles that differ."""
    _, start = periodic_window(geom, face.uv_bounds)
    for axis, (knots, degree, periodic) in enumerate(
        (
            (surface.knots_u, surface.degree_u, surface.periodic_u),
            (surface.knots_v, surface.degree_v, surface.periodic_v),
        )
    ):
        _insert(geom, axis, knots, degree, periodic)
    location = face.location
    placed = None if location.IsIdentity() else location.Transformation()
    now = surface_of_geom(geom, placed, start=start)
    if now.shape != surface.shape:
        raise GeometryError(
            f"the kernel's net became {now.shape[0]} x {now.shape[1]}, the sculpted one is"
            f" {surface.shape[0]} x {surface.shape[1]}",
            where=face.where,
        )
    if surface.weights is not None and now.weights is not None:
        scale = now.weights.max() / surface.weights.max()
        if np.abs(surface.weights * scale - now.weights).max() > SAME * now.weights.max():
            raise InputError("the sculpted surface has other weights than the face", where=face.where)
    rows = _first_copies(surface.shape[0], geom.NbUPoles())
    columns = _first_copies(surface.shape[1], geom.NbVPoles())
    net, old = surface.control_points, now.control_points
    folded = net[np.ix_(rows, columns)]
    if np.abs(folded - net).max() > SAME * max(surface.size, 1.0):
        raise InputError("the repeated control points of a periodic direction differ", where=face.where)
    poles = net if placed is None else transformed(net, location.Inverted().Transformation())
    first_u, first_v = _first_pole(geom, start)
    for i in range(geom.NbUPoles()):
        for j in range(geom.NbVPoles()):
            if (net[i, j] != old[i, j]).any():
                x, y, z = poles[i, j].tolist()
                geom.SetPole((i + first_u) % geom.NbUPoles() + 1, (j + first_v) % geom.NbVPoles() + 1, gp_Pnt(x, y, z))


def _first_copies(count: int, poles: int) -> NDArray[np.int64]:
    """Row numbers of an unrolled net; those from `poles` on repeat the first."""
    return np.arange(count) % poles


def _first_pole(geom: Geom_BSplineSurface, start: tuple[float | None, float | None]) -> tuple[int, int]:
    """Which of the kernel's poles (from 0) the first control point is."""
    u = unrolled_knots(
        from_reals(geom.UKnots()), from_integers(geom.UMultiplicities()), geom.UDegree(), geom.IsUPeriodic(), start[0]
    )[1]
    v = unrolled_knots(
        from_reals(geom.VKnots()), from_integers(geom.VMultiplicities()), geom.VDegree(), geom.IsVPeriodic(), start[1]
    )[1]
    return u, v


def _insert(geom: Geom_BSplineSurface, axis: int, knots: Array, degree: int, periodic: bool) -> None:
    """Raise the kernel's knots in one direction to the values and multiplicities of a flat knot vector."""
    low, high = knots[degree], knots[-degree - 1]
    if periodic:
        values, counts = periodic_knots(knots, degree)[:2]
        first = geom.UKnot(1) if axis == 0 else geom.VKnot(1)
        period = high - low
        turned = values[:-1] - np.floor((values[:-1] - first) / period + SAME) * period
        order = np.argsort(turned)
        values, counts = turned[order], counts[:-1][order]
    else:
        values, counts = knots_and_multiplicities(knots[(knots > low) & (knots < high)])
    if len(values) == 0:
        return
    count = geom.NbUKnots() if axis == 0 else geom.NbVKnots()
    there = np.array([geom.UKnot(i) if axis == 0 else geom.VKnot(i) for i in range(1, count + 1)])
    times = np.array([geom.UMultiplicity(i) if axis == 0 else geom.VMultiplicity(i) for i in range(1, count + 1)])
    nearest = np.abs(values[:, None] - there).argmin(axis=1)
    known = np.abs(there[nearest] - values) <= SAME * (high - low)
    values = np.where(known, there[nearest], values)
    more = ~known | (counts > times[nearest])
    if periodic:
        more &= (values > there[0]) & (values < there[-1])
    if more.any():
        insert = geom.InsertUKnots if axis == 0 else geom.InsertVKnots
        insert(reals(values[more]), integers(counts[more]), 0.0, False)


# ------------------------------------------------------------ another surface in place


def _replace(face: OcctFace, geom: Geom_BSplineSurface, *, shares: bool) -> None:
    """Put a B-spline surface into a face, and trim curves on it onto its edges.

    shares : other faces keep the old surface, and their edges the old trim curves.
    """
    builder = BRep_Builder()
    old, location = placement(face.shape)
    assert isinstance(old, Geom_Surface)
    carry = _pace_keeper(face)
    forward = TopoDS.Face(face.shape.Oriented(FORWARD))
    curves: list[tuple[TopoDS_Edge, list[Geom2d_Curve], float, float]] = []
    for edge in edges_of(forward):
        sides = [TopoDS.Edge(edge.Oriented(FORWARD))]
        if BRep_Tool.IsClosed_s(edge, forward):
            sides.append(TopoDS.Edge(edge.Oriented(REVERSED)))
        found = [pcurve(side, forward) for side in sides]
        if found[0][0] is not None:
            curves.append((sides[0], [carry(c, a, b) for c, a, b in found if c is not None], found[0][1], found[0][2]))
    tolerance = BRep_Tool.Tolerance_s(face.shape)
    builder.UpdateFace(face.shape, geom, location, tolerance)
    for edge, made, first, last in curves:
        near = BRep_Tool.Tolerance_s(edge)
        if not shares:
            if len(made) == 2:
                builder.UpdateEdge(edge, None, None, old, location, near)
            else:
                builder.UpdateEdge(edge, None, old, location, near)
        if len(made) == 2:
            builder.UpdateEdge(edge, made[0], made[1], geom, location, near)
        else:
            builder.UpdateEdge(edge, made[0], geom, location, near)
        builder.Range(edge, geom, location, first, last)


def _pace_keeper(face: OcctFace) -> Callable[[Geom2d_Curve, float, float], Geom2d_Curve]:
    """How a 2D curve of the old surface becomes one of the new, at the same pace."""
    made = face.conversion
    if made.map_u is None and made.map_v is None:
        return lambda curve, first, last: curve
    scale = parameter_scale(made.surface)

    def carry(curve: Geom2d_Curve, first: float, last: float) -> Geom2d_Curve:
        return geom_of_trim(carried_trim(curve, first, last, made.map_u, made.map_v, scale, TRIM_TOLERANCE))

    return carry
