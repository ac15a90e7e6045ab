"""The trim curves that a file gives, put in the place of those that the kernel made of them.

Reading a file, OCCT projects an edge's curve in space anew, or brings the file's 2D curve to another pace, where the two do not
run together within its own precision. What the file gave is then lost. It is put back where it runs along the curve in space,
within the tolerance of the file or of the edge. Files that cadsculpt wrote hold the trim curves of a part that was read: they
are put back wherever they run near, and the tolerances of the edge and its vertices rise to what that takes.

Writing one, OCCT writes a trim curve whole, however little of it the edge takes: a reader finds the ends by the vertices, which
lie off the curve by as much as their tolerances say. `bounded` gives edges just their part of the curve.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray
from OCP.BRep import BRep_Builder, BRep_CurveOnClosedSurface, BRep_CurveOnSurface, BRep_Tool
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.collections import IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher
from OCP.Geom import Geom_BSplineSurface, Geom_Curve, Geom_Surface
from OCP.Geom2d import Geom2d_BSplineCurve, Geom2d_Curve, Geom2d_Line, Geom2d_TrimmedCurve
from OCP.gp import gp_Vec2d
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Face

from .arrays import reals
from .boundary import placement
from .curve import sample_curve, sample_surface, sample_trim
from .shape import basis_of_geom
from .tolerance import FORWARD, curve_of_edge, curves_on_faces, edges_of, placed, settle_edge, vertices_of_edge
from .trim import geom_of_trim, trim_of_geom

Array = NDArray[np.float64]

NEAR = 1e-3
"""How far a trim curve of a file of ours may lie from its edge's curve in space, relative to the surface's size."""

SAME_SIDE = 0.25
"""How far its ends may lie from the kernel's, as shares of the domain: on a closed surface both sides are one place."""

ROUNDING = 1e-13
"""Relative distance within which a vertex is at the end of its edge."""

_SHARES = np.linspace(0.0, 1.0, 23)
"""Where, along an edge, a trim curve is compared with the curve in space: as many places as OCCT's checker takes."""


@dataclass(frozen=True, slots=True, eq=False)
class Offered:
    """A trim curve that a file gives an edge.

    own : cadsculpt wrote it, so that it is the edge's true course, and begins and ends where the edge does, wherever the
    vertices are.
    """

    curve: Geom2d_Curve
    own: bool


Offers = Callable[[TopoDS_Edge], Sequence[Offered]]


def spline_of_face(face: TopoDS_Face) -> Geom_BSplineSurface | None:
    """The B-spline surface of a face, cut along its parameters or not; None for other kinds."""
    surface = placement(face)[0]
    geom = basis_of_geom(surface) if isinstance(surface, Geom_Surface) else None
    return geom if isinstance(geom, Geom_BSplineSurface) else None


def keep_trims(face: TopoDS_Face, offers: Offers, tolerance: float) -> int:
    """Give the edges of a face on a B-spline surface the trim curves that the file offers, where they are sound.

    tolerance : the distance that the file calls exact, mm. Returns how many edges got another curve. Nothing is changed
    where the checker would refuse a face that it took before.
    """
    geom = spline_of_face(face)
    if geom is None:
        return 0
    surface = placement(face)[0]
    assert isinstance(surface, Geom_Surface)
    plans = []
    size = 0.0
    for edge in edges_of(face):
        found = offers(edge)
        if not found:
            continue
        own = all(item.own for item in found)
        size = size or (_size(geom) if own else 0.0)
        reach = max(tolerance, NEAR * size) if own else tolerance
        ends = tuple(BRep_Tool.Range_s(edge))
        _set_range(edge, surface, found, reach)
        curves = _chosen(edge, geom, surface, found, reach)
        if curves is not None:
            plans.append(_Plan(_bare(edge), curves[0], curves[1], ends))
        elif not _covers(edge, surface):
            BRep_Builder().Range(_bare(edge), *ends, False)  # the kernel's own is cut there
    if not plans:
        return 0
    before = BRepCheck_Analyzer(face).IsValid()
    undo = [plan.put() for plan in plans]
    if before and not BRepCheck_Analyzer(face).IsValid():
        for take_back in undo:
            take_back()
        return 0
    return len(plans)


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """The trim curves that an edge gets, and the range that it had."""

    edge: TopoDS_Edge
    held: BRep_CurveOnSurface
    curves: tuple[Geom2d_Curve, ...]
    ends: tuple[float, ...]

    def put(self) -> Callable[[], None]:
        """Put the curves into the edge. Returns what takes them out again."""
        old = curves_of(self.held)
        tolerances = [(self.edge.TShape(), BRep_Tool.Tolerance_s(self.edge))]
        tolerances += [(vertex.TShape(), BRep_Tool.Tolerance_s(vertex)) for vertex, _ in vertices_of_edge(self.edge)]
        set_curves(self.held, self.curves)
        settle_edge(self.edge)

        def take_back() -> None:
            BRep_Builder().Range(self.edge, *self.ends, False)
            set_curves(self.held, old)
            for shape, value in tolerances:
                shape.Tolerance(value)

        return take_back


def curves_of(held: BRep_CurveOnSurface) -> tuple[Geom2d_Curve, ...]:
    """The trim curve of an edge on a surface, or the two of a seam."""
    return (held.PCurve(), held.PCurve2()) if isinstance(held, BRep_CurveOnClosedSurface) else (held.PCurve(),)


def set_curves(held: BRep_CurveOnSurface, curves: tuple[Geom2d_Curve, ...]) -> None:
    """Give an edge other trim curves on the surface."""
    held.PCurve(curves[0])
    if isinstance(held, BRep_CurveOnClosedSurface):
        held.PCurve2(curves[1])
    held.Update()


def _bare(edge: TopoDS_Edge) -> TopoDS_Edge:
    """The edge in its own frame."""
    return TopoDS.Edge(edge.Located(TopLoc_Location()).Oriented(FORWARD))


def _covers(edge: TopoDS_Edge, surface: Geom_Surface) -> bool:
    """The trim curves on a surface are as long as the edge."""
    first, last = BRep_Tool.Range_s(edge)
    mine = [c.curve for c in curves_on_faces(_bare(edge)) if c.surface is surface]
    return all(curve.FirstParameter() <= first and last <= curve.LastParameter() for curve in mine)


def _chosen(
    edge: TopoDS_Edge, geom: Geom_BSplineSurface, surface: Geom_Surface, offered: Sequence[Offered], reach: float
) -> tuple[BRep_CurveOnSurface, tuple[Geom2d_Curve, ...]] | None:
    """What to put into an edge, and where; None where it has that already, or the offer is not sound."""
    bare = _bare(edge)
    every = [item for item in bare.TShape().Curves() if isinstance(item, BRep_CurveOnSurface)]
    mine = [item for item in every if item.Surface() is surface]
    if len(mine) != 1:
        return None
    held = mine[0]
    old = curves_of(held)
    if len(offered) != len(old):
        return None
    if all(any(equal(item.curve, now) for item in offered) for now in old):
        return None
    first, last = held.First(), held.Last()
    domain = np.array(geom.Bounds()).reshape(2, 2)
    span = domain[:, 1] - domain[:, 0]
    t = first + _SHARES * (last - first)
    paced = {id(item): list(_at_pace(item.curve, first, last)) for item in offered}
    if all(any(_same(made, now, t, span) for item in offered for made in paced[id(item)]) for now in old):
        return None
    curve, place = curve_of_edge(bare)
    start, stop = BRep_Tool.Range_s(bare)
    truth = None if curve is None else placed(sample_curve(curve, start + _SHARES * (stop - start)), place)
    period = np.where([geom.IsUPeriodic(), geom.IsVPeriodic()], span, 0.0)
    near = max(reach, BRep_Tool.Tolerance_s(bare))
    pace = np.inf if all(item.own for item in offered) else near
    for order in permutations(offered):
        made = []
        for item, now in zip(order, old, strict=True):
            ends = sample_trim(now, t[[0, -1]])
            best, least = None, pace
            for candidate in paced[id(item)]:
                candidate = _turned(candidate, t[[0, -1]], ends, period)
                uv = sample_trim(candidate, t)
                if (np.abs(uv[[0, -1]] - ends) > SAME_SIDE * span).any():
                    continue
                points = placed(sample_surface(geom, uv), held.Location())
                expected = (
                    placed(sample_surface(geom, sample_trim(now, t)), held.Location()) if truth is None else truth
                )
                gaps = np.linalg.norm(points - expected, axis=1)
                if gaps.max() > least or gaps[[0, -1]].max() > near:
                    continue
                if gaps.max() > near and (truth is None or _aside(points, curve, place, start, stop) > near):
                    continue
                best, least = candidate, float(gaps.max())
            if best is None:
                break
            made.append(best)
        else:
            if all(_same(a, b, t, span) for a, b in zip(made, old, strict=True)):
                return None
            return held, tuple(made)
    return None


def _aside(points: Array, curve: Geom_Curve | None, place: TopLoc_Location, start: float, stop: float) -> float:
    """Largest distance of points from a curve in space, wherever on it."""
    line = placed(sample_curve(curve, np.linspace(start, stop, 401)), place)
    step = np.diff(line, axis=0)
    square = np.maximum((step * step).sum(axis=1), 1e-300)
    share = np.clip(((points[:, None] - line[:-1]) * step).sum(axis=2) / square, 0.0, 1.0)
    away = points[:, None] - line[:-1] - share[..., None] * step
    return float(np.sqrt((away * away).sum(axis=2)).min(axis=1).max())


def _set_range(edge: TopoDS_Edge, surface: Geom_Surface, offered: Sequence[Offered], reach: float) -> None:
    """Let an edge begin and end where the trim curves on a surface do, unless a vertex is too far from there."""
    bare = _bare(edge)
    splines = [item for item in offered if isinstance(item.curve, Geom2d_BSplineCurve)]
    curve, place = curve_of_edge(bare)
    now = tuple(BRep_Tool.Range_s(bare))
    ranges = {(item.curve.FirstParameter(), item.curve.LastParameter()) for item in splines}
    if curve is None or len(ranges) != 1 or ranges == {now} or len(splines) < len(offered):
        return
    ((low, high),) = ranges
    bounds = [(curve.FirstParameter(), curve.LastParameter())]
    others = [item.curve for item in curves_on_faces(bare) if item.surface is not surface]
    bounds += [(other.FirstParameter(), other.LastParameter()) for other in others]
    slack = 1e-9 * (high - low)
    if any(low < first - slack or high > last + slack for first, last in bounds):
        return
    low, high = max(low, *(first for first, _ in bounds)), min(high, *(last for _, last in bounds))
    for vertex, parameter in vertices_of_edge(bare):
        end = low if parameter == now[0] else high
        p = BRep_Tool.Pnt_s(vertex)
        spot = placed(sample_curve(curve, np.array([end])), place)[0]
        if np.linalg.norm(spot - [p.X(), p.Y(), p.Z()]) > max(reach, BRep_Tool.Tolerance_s(vertex)):
            return
    BRep_Builder().Range(bare, low, high, False)


def bounded(faces: Iterable[TopoDS_Face]) -> Callable[[], None]:
    """Give edges just their part of their trim curves on B-spline surfaces, where they begin or end at no end of it, and
    where a vertex lies off. Returns what takes it back."""
    undo: list[tuple[BRep_CurveOnSurface, tuple[Geom2d_Curve, ...]]] = []
    seen = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
    for face in faces:
        for edge in edges_of(face):
            bare = _bare(edge)
            if seen.Contains(bare):
                continue
            seen.Add(bare)
            for held in bare.TShape().Curves():
                if not isinstance(held, BRep_CurveOnSurface):
                    continue
                if not isinstance(basis_of_geom(held.Surface()), Geom_BSplineSurface):
                    continue
                old, first, last = curves_of(held), held.First(), held.Last()
                if not any(_is_longer(curve, first, last) for curve in old) and not _astray(bare):
                    continue
                undo.append((held, old))
                set_curves(held, tuple(geom_of_trim(trim_of_geom(curve, first, last)) for curve in old))

    def take_back() -> None:
        for held, old in undo:
            set_curves(held, old)

    return take_back


def _is_longer(curve: Geom2d_Curve, first: float, last: float) -> bool:
    if isinstance(curve, Geom2d_BSplineCurve):
        return curve.IsPeriodic() or (curve.FirstParameter(), curve.LastParameter()) != (first, last)
    return isinstance(curve, Geom2d_TrimmedCurve)


def _astray(edge: TopoDS_Edge) -> bool:
    """A vertex of the edge lies off the end of its curve in space."""
    curve, place = curve_of_edge(edge)
    if curve is None:
        return False
    for vertex, parameter in vertices_of_edge(edge):
        p = BRep_Tool.Pnt_s(vertex)
        spot, point = placed(sample_curve(curve, np.array([parameter])), place)[0], np.array([p.X(), p.Y(), p.Z()])
        if np.linalg.norm(spot - point) > ROUNDING * max(1.0, float(np.abs(point).max())):
            return True
    return False


def _size(geom: Geom_BSplineSurface) -> float:
    """Diagonal of a box around the poles."""
    points = np.array([(p.X(), p.Y(), p.Z()) for p in geom.Poles()])
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))


def _at_pace(curve: Geom2d_Curve, first: float, last: float) -> Iterator[Geom2d_Curve]:
    """A 2D curve as it may run over [first, last]: by its own parameter, or stretched from end to end, either way."""
    low, high = curve.FirstParameter(), curve.LastParameter()
    slack = 1e-9 * (last - first)
    if not isinstance(curve, Geom2d_BSplineCurve) or (low <= first + slack and high >= last - slack):
        yield curve
    if not isinstance(curve, Geom2d_BSplineCurve):
        return
    for backward in (False, True):
        if (low, high) == (first, last) and not backward:
            continue
        made = curve.Copy()
        if backward:
            made.Reverse()
        knots = np.array([made.Knot(i) for i in range(1, made.NbKnots() + 1)])
        share = (knots - knots[0]) / (knots[-1] - knots[0])
        knots = (1.0 - share) * first + share * last
        knots[0], knots[-1] = first, last
        if (np.diff(knots) > 0.0).all():
            made.SetKnots(reals(knots))
            yield made


def _turned(curve: Geom2d_Curve, t: Array, ends: Array, period: Array) -> Geom2d_Curve:
    """The curve brought by whole periods near where the kernel has it."""
    turns = np.zeros(2)
    periodic = period > 0.0
    turns[periodic] = np.round((ends - sample_trim(curve, t)).mean(axis=0)[periodic] / period[periodic])
    if not turns.any():
        return curve
    shift = turns * period
    return curve.Translated(gp_Vec2d(float(shift[0]), float(shift[1])))


def _same(a: Geom2d_Curve, b: Geom2d_Curve, t: Array, span: Array) -> bool:
    """The same curve: number for number, or a straight line to rounding."""
    if not (isinstance(a, Geom2d_BSplineCurve) and a.NbPoles() == 2 and isinstance(b, Geom2d_Line)):
        return equal(a, b)
    return bool((np.abs(sample_trim(a, t) - sample_trim(b, t)) <= ROUNDING * span).all())


def equal(a: Geom2d_Curve, b: Geom2d_Curve) -> bool:
    """The same curve, number for number."""
    if isinstance(a, Geom2d_Line) and isinstance(b, Geom2d_Line):
        return bool((sample_trim(a, np.array([0.0, 1.0])) == sample_trim(b, np.array([0.0, 1.0]))).all())
    if not (isinstance(a, Geom2d_BSplineCurve) and isinstance(b, Geom2d_BSplineCurve)):
        return False
    if (a.Degree(), a.NbPoles(), a.NbKnots(), a.IsRational()) != (b.Degree(), b.NbPoles(), b.NbKnots(), b.IsRational()):
        return False
    poles, knots = range(1, a.NbPoles() + 1), range(1, a.NbKnots() + 1)  # one by one: whole arrays take OCP long
    return (
        all(a.Knot(i) == b.Knot(i) and a.Multiplicity(i) == b.Multiplicity(i) for i in knots)
        and all((p := a.Pole(i)).X() == (q := b.Pole(i)).X() and p.Y() == q.Y() for i in poles)
        and (not a.IsRational() or all(a.Weight(i) == b.Weight(i) for i in poles))
    )
