"""B-spline surfaces and trim curves to OCCT's geometry and back, and faces made of them.

Lengths are whatever the caller's are (mm in a `Part`); parameters and knots pass through unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
from OCP.collections import Array2_double
from OCP.Geom import (
    Geom_BezierSurface,
    Geom_BSplineCurve,
    Geom_BSplineSurface,
    Geom_Curve,
    Geom_RectangularTrimmedSurface,
    Geom_Surface,
)
from OCP.GeomAbs import GeomAbs_Shape
from OCP.gp import gp_Pnt, gp_Trsf
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Face, TopoDS_Vertex, TopoDS_Wire

from ...errors import GeometryError
from ...spline.surface import BSplineSurface, Provenance, TrimCurve, TrimLoop
from .arrays import (
    from_integers,
    from_point_grid,
    from_real_grid,
    from_reals,
    integers,
    knots_and_multiplicities,
    point_grid,
    points,
    real_grid,
    reals,
)
from .curve import curve_on_surface
from .tolerance import CONFUSION, FORWARD, REVERSED, settle_tolerances
from .trim import evaluate_trim, geom_of_trim, moved_trim, reversed_loop, signed_area, trim_domain

Array = NDArray[np.float64]


# ---------------------------------------------------------------------- knots


def unrolled_knots(
    values: Array, multiplicities: NDArray[np.int64], degree: int, periodic: bool, start: float | None = None
) -> tuple[Array, int]:
    """The flat knot vector of OCCT's distinct knots, and which of OCCT's poles its first control point is.

    A periodic direction of n poles is unrolled as `spline.surface` has it, into n + 2 degree + 1 knots with
    knots[i + n] = knots[i] + period: knots[degree] is the last copy of the last knot at or before `start` (by default
    OCCT's first knot), in whatever turn that is.
    """
    if not periodic:
        return np.repeat(values, multiplicities), 0
    first, count = int(multiplicities[0]), int(multiplicities[:-1].sum())
    period = values[-1] - values[0]
    turns, knot = 0, 0
    if start is not None:
        slack = 1e-9 * period
        turns = int(np.floor((start - values[0] + slack) / period))
        knot = int(np.searchsorted(values[:-1], start - turns * period + slack, side="right")) - 1
    pole = int(multiplicities[1 : knot + 1].sum())
    cycle = np.repeat(values[:-1], multiplicities[:-1])
    turn, place = np.divmod(np.arange(count + 2 * degree + 1) - degree + first - 1 + pole, count)
    turn += turns
    knots = cycle[place] + turn * period
    knots[(turn == 1) & (place < first)] = values[-1]
    return np.asarray(knots, dtype=np.float64), pole


def periodic_knots(knots: Array, degree: int) -> tuple[Array, NDArray[np.int64], int]:
    """OCCT's distinct knots and multiplicities of an unrolled periodic knot vector, and the row of its first pole."""
    count = len(knots) - 2 * degree - 1
    low, high = knots[degree], knots[degree + count]
    later = int((knots[degree + 1 :] == low).sum())
    values, multiplicities = knots_and_multiplicities(knots[(knots >= low) & (knots < high)])
    first = max(int((knots == low).sum()), int((knots == high).sum()))
    multiplicities[0] = first
    return np.append(values, high), np.append(multiplicities, first), later


# -------------------------------------------------------------------- surface


def basis_of_geom(geom: Geom_Surface) -> Geom_Surface:
    """The surface behind any rectangular trimming."""
    while isinstance(geom, Geom_RectangularTrimmedSurface):
        geom = geom.BasisSurface()
    return geom


def surface_of_geom(
    geom: Geom_Surface,
    transformation: gp_Trsf | None = None,
    *,
    outward: bool = True,
    trims: tuple[TrimLoop, ...] | None = None,
    name: str = "",
    provenance: Provenance | None = None,
    start: tuple[float | None, float | None] = (None, None),
) -> BSplineSurface:
    """The B-spline surface that a Geom_BSplineSurface or Geom_BezierSurface is: knots, weights, poles and all.

    The poles are moved by `transformation` (a face's placement). Rectangular trimming is ignored: it belongs to the
    trims. `start` is where the domain of a periodic direction begins (`unrolled_knots`).
    Raises GeometryError for other kinds (`analytic` converts those).
    """
    geom = basis_of_geom(geom)
    if isinstance(geom, Geom_BSplineSurface):
        degree_u, degree_v = geom.UDegree(), geom.VDegree()
        periodic_u, periodic_v = geom.IsUPeriodic(), geom.IsVPeriodic()
        values, counts = from_reals(geom.UKnots()), from_integers(geom.UMultiplicities())
        knots_u, first_u = unrolled_knots(values, counts, degree_u, periodic_u, start[0])
        values, counts = from_reals(geom.VKnots()), from_integers(geom.VMultiplicities())
        knots_v, first_v = unrolled_knots(values, counts, degree_v, periodic_v, start[1])
    elif isinstance(geom, Geom_BezierSurface):
        degree_u, degree_v, periodic_u, periodic_v = geom.UDegree(), geom.VDegree(), False, False
        first_u = first_v = 0
        knots_u = np.repeat([0.0, 1.0], degree_u + 1)
        knots_v = np.repeat([0.0, 1.0], degree_v + 1)
    else:
        raise GeometryError(f"{type(geom).__name__} is no spline surface", where=name)
    net = from_point_grid(geom.Poles())
    rational = geom.IsURational() or geom.IsVRational()
    weights = None
    if rational:
        filled = Array2_double(1, geom.NbUPoles(), 1, geom.NbVPoles())
        geom.Weights(filled)  # the form without argument hands out OCCT's own memory
        weights = from_real_grid(filled)
    if transformation is not None:
        net = transformed(net, transformation)
    rows = (np.arange(len(knots_u) - degree_u - 1) + first_u) % net.shape[0]
    columns = (np.arange(len(knots_v) - degree_v - 1) + first_v) % net.shape[1]
    grid = np.ix_(rows, columns)
    return BSplineSurface(
        control_points=net[grid],
        knots_u=knots_u,
        knots_v=knots_v,
        degree_u=degree_u,
        degree_v=degree_v,
        weights=None if weights is None else weights[grid],
        periodic_u=periodic_u,
        periodic_v=periodic_v,
        outward=outward,
        trims=trims,
        name=name,
        provenance=provenance or Provenance(),
    )


def transformed(net: Array, transformation: gp_Trsf) -> Array:
    """Points (..., 3) moved by OCCT's own arithmetic, so that they equal what OCCT evaluates on the placed face."""
    out = np.empty_like(net)
    flat, moved = net.reshape(-1, 3), out.reshape(-1, 3)
    for i, (x, y, z) in enumerate(flat.tolist()):
        p = gp_Pnt(x, y, z)
        p.Transform(transformation)
        moved[i] = p.X(), p.Y(), p.Z()
    return out


def pole_grid(surface: BSplineSurface) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which rows and columns of the (unrolled) net are OCCT's poles, in OCCT's order."""
    r, s = surface.shape
    if surface.periodic_u:
        count = r - surface.degree_u
        rows = (np.arange(count) + periodic_knots(surface.knots_u, surface.degree_u)[2]) % count
    else:
        rows = np.arange(r)
    if surface.periodic_v:
        count = s - surface.degree_v
        columns = (np.arange(count) + periodic_knots(surface.knots_v, surface.degree_v)[2]) % count
    else:
        columns = np.arange(s)
    return rows, columns


def geom_of_surface(surface: BSplineSurface) -> Geom_BSplineSurface:
    """The Geom_BSplineSurface equal to `surface`; periodic directions are rolled up again.

    Raises GeometryError when OCCT cannot hold it (degree above 25, knots that coincide in floating point).
    """
    surface.validate()
    knots: list[tuple[Array, NDArray[np.int64]]] = []
    for vector, degree, periodic in (
        (surface.knots_u, surface.degree_u, surface.periodic_u),
        (surface.knots_v, surface.degree_v, surface.periodic_v),
    ):
        values, counts = periodic_knots(vector, degree)[:2] if periodic else knots_and_multiplicities(vector)
        knots.append((values, counts))
    grid = np.ix_(*pole_grid(surface))
    arguments: list[Any] = [point_grid(surface.control_points[grid])]
    if surface.weights is not None:
        arguments.append(real_grid(surface.weights[grid]))
    (u, mu), (v, mv) = knots
    try:
        return Geom_BSplineSurface(
            *arguments,
            reals(u),
            reals(v),
            integers(mu),
            integers(mv),
            surface.degree_u,
            surface.degree_v,
            surface.periodic_u,
            surface.periodic_v,
        )
    except Exception as error:
        raise GeometryError(
            f"the CAD kernel refuses the surface: {error}", where=surface.name or "surface", mend="degrees up to 25"
        ) from error


# ---------------------------------------------------------------------- faces


@dataclass(frozen=True, slots=True, eq=False)
class WireEdge:
    """One edge in a face's loop: the shared edge, its trim curve on this face, and whether the loop runs against the edge.

    `curve` is parametrised like the edge (its own direction, not the loop's); where the parameters of the two differ,
    `unify_parameters` mends it. A seam carries `opposite`, its trim curve on the other side of the closed surface (used
    where the loop runs against the edge), and stands in the loop twice.
    """

    edge: TopoDS_Edge
    curve: TrimCurve
    backward: bool = False
    opposite: TrimCurve | None = None


def vertex(point: Array, tolerance: float = CONFUSION) -> TopoDS_Vertex:
    """A vertex at point (3,)."""
    result = TopoDS_Vertex()
    BRep_Builder().MakeVertex(result, gp_Pnt(*map(float, point)), tolerance)
    return result


def spline_curve(control_points: Array, knots: Array, degree: int, weights: Array | None = None) -> Geom_BSplineCurve:
    """A 3D B-spline curve of control points (n, 3) and a flat knot vector (n + degree + 1,)."""
    values, counts = knots_and_multiplicities(knots)
    arguments: list[Any] = [points(control_points)]
    if weights is not None:
        arguments.append(reals(weights))
    return Geom_BSplineCurve(*arguments, reals(values), integers(counts), degree)


def edge(
    curve: Geom_Curve | None,
    first: float,
    last: float,
    start: TopoDS_Vertex,
    end: TopoDS_Vertex,
    tolerance: float = CONFUSION,
) -> TopoDS_Edge:
    """The edge [first, last] of a 3D curve between two vertices; a degenerate edge (a pole) when there is no curve."""
    builder, result = BRep_Builder(), TopoDS_Edge()
    if curve is None:
        builder.MakeEdge(result)
        builder.Degenerated(result, True)
        builder.UpdateEdge(result, tolerance)
    else:
        builder.MakeEdge(result, curve, tolerance)
    builder.Add(result, start.Oriented(FORWARD))
    builder.Add(result, end.Oriented(REVERSED))
    builder.Range(result, first, last)
    return result


def face_with_wires(surface: BSplineSurface, wires: Sequence[Sequence[WireEdge]]) -> TopoDS_Face:
    """A face of `surface` bounded by loops of (shared) edges; the loops run anticlockwise around the material in (u, v).

    The surface's own trims are not looked at. A face whose surface is not `outward` comes back reversed.
    """
    builder, face, here = BRep_Builder(), TopoDS_Face(), TopLoc_Location()
    geom = geom_of_surface(surface)
    builder.MakeFace(face, geom, here, CONFUSION)
    for loop in wires:
        wire = TopoDS_Wire()
        builder.MakeWire(wire)
        seen: list[TopoDS_Edge] = []
        for item in loop:
            if not any(item.edge.IsSame(other) for other in seen):
                seen.append(item.edge)
                _attach(builder, item, geom)
            builder.Add(wire, item.edge.Oriented(REVERSED if item.backward else FORWARD))
        wire.Closed(True)
        builder.Add(face, wire)
    return face if surface.outward else TopoDS.Face(face.Reversed())


def _attach(builder: BRep_Builder, item: WireEdge, geom: Geom_Surface) -> None:
    """Give an edge its trim curve (two on a seam) on a surface."""
    here, tolerance = TopLoc_Location(), BRep_Tool.Tolerance_s(item.edge)
    curve = geom_of_trim(item.curve)
    if item.opposite is None:
        builder.UpdateEdge(item.edge, curve, geom, here, tolerance)
    else:
        builder.UpdateEdge(item.edge, curve, geom_of_trim(item.opposite), geom, here, tolerance)
        builder.Continuity(item.edge, geom, geom, here, here, GeomAbs_Shape.GeomAbs_C0)
    first, last = trim_domain(item.curve)
    builder.Range(item.edge, geom, here, first, last)
    if (first, last) != tuple(BRep_Tool.Range_s(item.edge)):
        builder.SameRange(item.edge, False)
        builder.SameParameter(item.edge, False)


def shape_of_surface(surface: BSplineSurface) -> TopoDS_Face:
    """The face that a surface with its trims is: trim curves as edges with 3D curves, seams and poles made out.

    Loops are turned so that they run anticlockwise around the material; the face is reversed when the surface is not
    `outward`. Raises GeometryError when the kernel refuses the surface.
    """
    if surface.trims is None:
        face = BRepBuilderAPI_MakeFace(geom_of_surface(surface), CONFUSION).Face()
        return face if surface.outward else TopoDS.Face(face.Reversed())
    loops = []
    for loop in surface.trims:
        loops.append(loop if (signed_area(loop) >= 0) == loop.outer else reversed_loop(loop))
    face = face_with_wires(surface, _wires_of_loops(surface, loops))
    settle_tolerances(face)
    return face


def _wires_of_loops(surface: BSplineSurface, loops: Sequence[TrimLoop]) -> list[list[WireEdge]]:
    """Edges along the loops of one face, corners shared, both sides of a seam one edge."""
    geom = geom_of_surface(surface)
    tolerance = max(0.2 * CONFUSION, 1e-12 * surface.size)
    corners: list[tuple[Array, TopoDS_Vertex]] = []
    wires: list[list[WireEdge]] = []
    shifts = _closing_shifts(surface)
    for loop in loops:
        ends = np.array([evaluate_trim(c, np.array(trim_domain(c))) for c in loop.curves])  # (n, 2 ends, 2)
        spots = surface.evaluate(ends[..., 0], ends[..., 1])
        here = []
        for k in range(len(loop.curves)):
            arriving, leaving = spots[k - 1, 1], spots[k, 0]
            here.append(_corner(corners, 0.5 * (arriving + leaving), float(np.linalg.norm(arriving - leaving))))
        wire: list[WireEdge] = []
        for k, curve in enumerate(loop.curves):
            seam = next((i for i, item in enumerate(wire) if _is_seam(item.curve, curve, shifts)), None)
            if seam is not None:
                item = replace(wire[seam], opposite=moved_trim(wire[seam].curve, _seam_shift(wire[seam].curve, curve)))
                wire[seam] = item
                wire.append(replace(item, backward=True))
                continue
            first, last = trim_domain(curve)
            start, end = here[k], here[(k + 1) % len(here)]
            places = surface.evaluate(*evaluate_trim(curve, np.linspace(first, last, 9)).T)
            if start.IsSame(end) and np.abs(places - places[0]).max() <= CONFUSION:
                wire.append(WireEdge(edge(None, first, last, start, end), curve))
                continue
            curve_3d, gap = curve_on_surface(geom, geom_of_trim(curve), first, last, tolerance)
            made = edge(curve_3d, first, last, start, end, max(CONFUSION, 1.05 * gap))
            wire.append(WireEdge(made, curve))
        wires.append(wire)
    return wires


def _corner(corners: list[tuple[Array, TopoDS_Vertex]], point: Array, gap: float) -> TopoDS_Vertex:
    """The vertex at a point, one that is there already or a new one; `gap` is the distance its tolerance must cover."""
    for place, known in corners:
        if np.linalg.norm(place - point) <= CONFUSION:
            return known
    made = vertex(point, max(CONFUSION, 0.51 * gap))
    corners.append((point, made))
    return made


def _closing_shifts(surface: BSplineSurface) -> list[tuple[float, float]]:
    """The moves in (u, v) that bring one side of a closed surface onto the other."""
    (u0, u1), (v0, v1) = surface.domain
    shifts = []
    if surface.closed_u:
        shifts += [(u1 - u0, 0.0), (u0 - u1, 0.0)]
    if surface.closed_v:
        shifts += [(0.0, v1 - v0), (0.0, v0 - v1)]
    return shifts


def _seam_shift(curve: TrimCurve, other: TrimCurve) -> tuple[float, float]:
    """The move from the start of `curve` to the end of `other`, which runs back on the other side."""
    start = evaluate_trim(curve, np.array(trim_domain(curve)[:1]))[0]
    end = evaluate_trim(other, np.array(trim_domain(other)[1:]))[0]
    return float(end[0] - start[0]), float(end[1] - start[1])


def _is_seam(curve: TrimCurve, other: TrimCurve, shifts: Sequence[tuple[float, float]]) -> bool:
    """True when `other` is `curve` run backwards on the other side of the closed surface."""
    if not shifts:
        return False
    move = np.array(_seam_shift(curve, other))
    scale = max(abs(x) for shift in shifts for x in shift)
    if min(np.abs(move - np.array(shift)).max() for shift in shifts) > 1e-7 * scale:
        return False
    there = evaluate_trim(curve, np.linspace(*trim_domain(curve), 9))
    back = evaluate_trim(other, np.linspace(*trim_domain(other), 9))[::-1]
    return bool(np.abs(there + move - back).max() <= 1e-6 * scale)
