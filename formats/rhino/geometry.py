"""openNURBS geometry to B-spline surfaces and trim curves, and back.

Surfaces that are no NURBS (planes, revolutions, sums) are converted by openNURBS itself. On some of them the NURBS form
runs at another pace than the surface (an angle against a rational parameter); trim curves are carried over to the NURBS
form's parameters: exactly where they are straight along a parameter line, else by a spline within 1e-10 of the range.
"""

from __future__ import annotations

import base64
import importlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...spline.matrices import design_matrix
from ...spline.surface import BSplineSurface, Provenance, TrimCurve, TrimLoop
from ..curve_fit import fit_curve
from .archive import BUFFER_VERSION, Reader, class_record
from .nurbs import NURBS_CURVE, Nurbs, read_nurbs
from .seam import with_copies, without_copies

Array = NDArray[np.float64]

MAP_TOLERANCE = 1e-10
"""How far a trim curve may move when it is carried to another parametrisation, relative to the parameter range."""


# --------------------------------------------------------------------- objects


def library() -> Any:
    """rhino3dm, loaded when it is needed. Untyped: its stubs leave out half of what it has."""
    return importlib.import_module("rhino3dm")


def encoded(thing: Any) -> bytes:
    """The TCODE_OPENNURBS_CLASS chunk of a rhino3dm object, in a version 60 archive."""
    return base64.b64decode(thing.Encode()["data"])


def decoded(chunk: bytes) -> Any:
    """The rhino3dm object of such a chunk; None when rhino3dm cannot make one of it."""
    rhino3dm = library()
    form = rhino3dm.Point(rhino3dm.Point3d(0.0, 0.0, 0.0)).Encode()
    form["data"] = base64.b64encode(chunk).decode()
    return rhino3dm.CommonObject.Decode(form)


def nurbs_of(chunk: bytes, directions: int) -> Nurbs:
    """The ON_NurbsCurve (1 direction) or ON_NurbsSurface (2) in a chunk of a version 60 archive."""
    record = class_record(chunk, 0, len(chunk), BUFFER_VERSION)
    return read_nurbs(Reader(chunk, record.data.body, record.data.end - 4, BUFFER_VERSION), directions)


def curve_of(thing: Any) -> Nurbs:
    """The clamped NURBS form of any rhino3dm curve, over the curve's own domain."""
    form = thing.ToNurbsCurve()
    if form is None:
        raise InputError("a curve has no NURBS form")
    return clamped(nurbs_of(encoded(form), 1))


def part_of_curve(chunk: bytes, domain: tuple[float, float]) -> Nurbs:
    """The part of a curve (its chunk) over `domain`, as a clamped NURBS curve."""
    if class_record(chunk, 0, len(chunk), BUFFER_VERSION).class_id == NURBS_CURVE:
        curve = clamped(nurbs_of(chunk, 1))
        if (curve.knots[0][0], curve.knots[0][-1]) == domain:
            return curve
    thing = decoded(chunk)
    if thing is None:
        raise InputError("a curve of a kind that cannot be read")
    if domain != (thing.Domain.T0, thing.Domain.T1):
        thing = thing.Trim(*domain)
        if thing is None:
            raise InputError("a curve ends before the edge or trim that runs on it")
    return curve_of(thing)


def clamped(curve: Nurbs) -> Nurbs:
    """The same curve with full knots at both ends, as OCCT and trim loops want it."""
    points, knots = _clamped_rows(curve.points, curve.padded_knots(0), curve.degrees[0])
    return replace(curve, knots=(knots[1:-1],), points=points)


def clamped_surface(surface: Nurbs) -> Nurbs:
    """The same surface with full knots at both ends of both directions."""
    points, knots = surface.points, []
    for axis in (0, 1):
        rows = np.moveaxis(points, axis, 0)
        flat, padded = _clamped_rows(rows.reshape(len(rows), -1), surface.padded_knots(axis), surface.degrees[axis])
        points = np.moveaxis(flat.reshape(len(flat), *rows.shape[1:]), 0, axis)
        knots.append(padded[1:-1])
    return replace(surface, knots=tuple(knots), points=points)


def _clamped_rows(points: Array, knots: Array, degree: int) -> tuple[Array, Array]:
    """Knots inserted at the domain's ends, and what lies outside cut off. points (n, d), knots (n + degree + 1,)."""
    ends = knots[degree], knots[-degree - 1]
    if knots[1] == ends[0] and knots[-2] == ends[1]:
        return points, knots
    for t in ends:
        while (multiplicity := np.count_nonzero(knots == t)) < degree:
            span = int(np.searchsorted(knots, t, side="right")) - 1
            i = np.arange(span - degree + 1, span - multiplicity + 1)
            alpha = ((t - knots[i]) / (knots[i + degree] - knots[i]))[:, None]
            middle = (1.0 - alpha) * points[i - 1] + alpha * points[i]
            points = np.concatenate([points[: i[0]], middle, points[i[-1] :]])
            knots = np.insert(knots, span + 1, t)
    first = int(np.searchsorted(knots, ends[0], side="right")) - degree
    last = int(np.searchsorted(knots, ends[1], side="left")) + degree
    knots = np.concatenate([ends[:1], knots[first:last], ends[1:]])
    return points[first - 1 : last - degree], knots


# -------------------------------------------------------------------- surfaces


@dataclass(frozen=True, slots=True, eq=False)
class ParameterMap:
    """From a surface's own parameters to those of its NURBS form: u and v apart, each monotone.

    `kinks` are the inner knots (u, v) of the NURBS form in the surface's own parameters, where the map has kinks. A
    direction that both share has none and keeps its parameters bit for bit.
    """

    thing: Any
    domain: tuple[tuple[float, float], tuple[float, float]]
    kinks: tuple[Array, Array]
    shared: tuple[bool, bool]

    def __call__(self, uv: Array) -> Array:
        """(n, 2) -> (n, 2)."""
        found = [self.thing.GetNurbsFormParameterFromSurfaceParameter(u, v) for u, v in uv.tolist()]
        out = np.array([(place[-2], place[-1]) for place in found], dtype=np.float64).reshape(-1, 2)
        for axis, (low, high) in enumerate(self.domain):
            keep = self.shared[axis] | (uv[:, axis] == low) | (uv[:, axis] == high)
            out[keep, axis] = uv[keep, axis]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceForm:
    """A surface of the archive: its NURBS form, its kind, and the map to its parameters (None: the same)."""

    nurbs: Nurbs
    kind: str
    parameters: ParameterMap | None


def surface_form(chunk: bytes) -> SurfaceForm:
    """The NURBS form of any surface. Raises InputError when openNURBS has none for it."""
    thing = decoded(chunk)
    if thing is None:
        raise InputError("a surface of a kind that cannot be read")
    result = thing.ToNurbsSurface(0.0)
    if result is None or result[0] is None:
        raise InputError("a surface without a NURBS form", mend="convert it to NURBS in Rhino")
    form, accuracy = result
    across, along = thing.Domain(0), thing.Domain(1)
    domain = ((across.T0, across.T1), (along.T0, along.T1))
    nurbs = nurbs_of(encoded(form), 2)
    if accuracy == 1 or type(thing).__name__ == "NurbsSurface":
        return SurfaceForm(nurbs, kind_of(thing), None)
    return SurfaceForm(nurbs, kind_of(thing), _parameter_map(thing, nurbs, domain))


def _parameter_map(thing: Any, nurbs: Nurbs, domain: tuple[tuple[float, float], tuple[float, float]]) -> ParameterMap:
    corner = np.array([domain[0][0], domain[1][0]])
    bare = ParameterMap(thing, domain, (np.empty(0), np.empty(0)), (False, False))
    kinks, shared = [np.empty(0), np.empty(0)], [False, False]
    for axis, (low, high) in enumerate(domain):
        places = np.tile(corner, (33, 1))
        places[:, axis] = np.linspace(low, high, 33)
        shared[axis] = bool(np.abs(bare(places)[:, axis] - places[:, axis]).max() <= 1e-13 * (high - low))
        if not shared[axis]:
            knots = nurbs.knots[axis]
            places = np.tile(corner, (len(knots), 1))
            places[:, axis] = knots
            back = [thing.GetSurfaceParameterFromNurbsFormParameter(u, v)[axis - 2] for u, v in places.tolist()]
            kinks[axis] = np.unique([k for k in back if low < k < high])
    return ParameterMap(thing, domain, (kinks[0], kinks[1]), (shared[0], shared[1]))


def kind_of(thing: Any) -> str:
    """The kind of a rhino3dm surface in the words of `Face.kind`."""
    name = type(thing).__name__
    if name == "RevSurface":
        for kind, test in (
            ("cylinder", "IsCylinder"),
            ("cone", "IsCone"),
            ("sphere", "IsSphere"),
            ("torus", "IsTorus"),
        ):
            if getattr(thing, test)():
                return kind
        return "revolution"
    return {"NurbsSurface": "bspline", "PlaneSurface": "plane", "Extrusion": "extrusion"}.get(
        name, "plane" if thing.IsPlanar() else "other"
    )


def periodic_flag(points: Array, knots: Array, degree: int) -> bool:
    """Whether a direction (axis 0 of `points`) is stored unrolled: the last `degree` rows are the first ones."""
    count = len(points) - degree
    low, high = knots[degree], knots[-degree - 1]
    if degree < 2 or count < degree or not (knots[0] < low and knots[-1] > high):
        return False
    if not np.array_equal(points[:degree], points[count:]):
        return False
    steps = np.diff(knots)
    return bool(np.abs(steps[: 2 * degree] - steps[count:]).max() <= 1e-9 * (high - low)) if count else False


def surface_of(
    nurbs: Nurbs,
    scale: float,
    placement: Array | None,
    *,
    outward: bool,
    name: str,
    provenance: Provenance,
    trims: tuple[TrimLoop, ...] | None,
    periodic: str = "",
) -> BSplineSurface:
    """The surface in mm. `scale` turns the file's unit into mm, `placement` (4, 4) is in the file's unit.

    periodic : the directions that were written `without_copies`.
    """
    points = nurbs.control_points()
    if points.shape[2] != 3:
        raise InputError(f"a surface in {points.shape[2]} dimensions", where=name)
    points = moved(points, placement) * scale
    weights = nurbs.weights()
    if weights is not None and np.all(weights == weights[0, 0]):
        weights = None
    knots = [nurbs.padded_knots(0), nurbs.padded_knots(1)]
    whole = points if weights is None else np.concatenate([points, weights[..., None]], axis=2)
    for axis, direction in enumerate("uv"):
        if direction in periodic:
            rows, knots[axis] = with_copies(np.moveaxis(whole, axis, 0), knots[axis], nurbs.degrees[axis])
            whole = np.moveaxis(rows, 0, axis)
    flags = [periodic_flag(np.moveaxis(whole, axis, 0), knots[axis], nurbs.degrees[axis]) for axis in (0, 1)]
    surface = BSplineSurface(
        control_points=np.ascontiguousarray(whole[..., :3]),
        knots_u=knots[0],
        knots_v=knots[1],
        degree_u=nurbs.degrees[0],
        degree_v=nurbs.degrees[1],
        weights=None if weights is None else np.ascontiguousarray(whole[..., 3]),
        periodic_u=flags[0],
        periodic_v=flags[1],
        outward=outward,
        trims=trims,
        name=name,
        provenance=provenance,
    )
    surface.validate()
    return surface


def nurbs_of_surface(
    surface: BSplineSurface, scale: float, placement: Array | None, before: Nurbs, was: BSplineSurface
) -> Nurbs:
    """What the archive holds for a surface in mm: the inverse of `surface_of`.

    `was` is the surface in mm that was read from `before`: control points that are still the same keep the archive's
    bits.
    """
    whole, knots = without_copies(surface)
    old, _ = without_copies(was)
    points = moved(whole[..., :3] / scale, inverse(placement))
    if before.rational or surface.weights is not None:
        one = before.points[0, 0, -1] if before.rational else 1.0
        weights = np.full(whole.shape[:2], one) if surface.weights is None else whole[..., 3]
        points = np.concatenate([points * weights[..., None], weights[..., None]], axis=2)
    if points.shape == before.points.shape:
        same = (whole[..., :3] == old[..., :3]).all(axis=2)
        if surface.weights is not None and was.weights is not None:
            same &= whole[..., 3] == old[..., 3]
        points[same] = before.points[same]
    return Nurbs(
        3, points.shape[2] == 4, (surface.degree_u, surface.degree_v), (knots[0][1:-1], knots[1][1:-1]), points
    )


def moved(points: Array, placement: Array | None) -> Array:
    """Points (..., 3) under a 4 x 4 placement; untouched without one."""
    return points if placement is None else points @ placement[:3, :3].T + placement[:3, 3]


def inverse(placement: Array | None) -> Array | None:
    """The placement that undoes a placement."""
    return None if placement is None else np.asarray(np.linalg.inv(placement), dtype=np.float64)


# ----------------------------------------------------------------- trim curves


def trim_curve(curve: Nurbs, parameters: ParameterMap | None) -> TrimCurve:
    """A 2D NURBS curve as a trim curve, in the parameters of the surface's NURBS form."""
    if parameters is not None:
        return _carried(curve, parameters)
    weights = curve.weights()
    return TrimCurve(curve.control_points()[:, :2], curve.padded_knots(0), curve.degrees[0], weights)


def nurbs_of_trim(trim: TrimCurve) -> Nurbs:
    """The archive's form of a trim curve."""
    points = trim.control_points
    if trim.weights is not None:
        points = np.concatenate([points * trim.weights[:, None], trim.weights[:, None]], axis=1)
    return Nurbs(2, trim.weights is not None, (trim.degree,), (trim.knots[1:-1],), points)


def curve_points(curve: Nurbs, parameters: Array) -> Array:
    """(n, dimension) points of a NURBS curve."""
    points = design_matrix(curve.padded_knots(0), curve.degrees[0], parameters) @ curve.points
    return points[:, :-1] / points[:, -1:] if curve.rational else points


def _carried(curve: Nurbs, parameters: ParameterMap) -> TrimCurve:
    """A trim curve in other parameters: straight lines along a parameter stay straight, others are fitted."""
    knots = curve.padded_knots(0)
    control = curve.control_points()[:, :2]
    first, last = knots[curve.degrees[0]], knots[-curve.degrees[0] - 1]
    ends = parameters(control[[0, -1]])
    if (control == control[0]).all(axis=0).any():
        return TrimCurve(ends, np.array([first, first, last, last]), 1)
    size = np.array([high - low for low, high in parameters.domain])
    step = 1e-4 * (last - first)

    def values(t: Array, side: int) -> Array:
        """Value and two derivatives by five-point differences that stay on one side of a break."""
        reach = step if side == 1 else -step
        reach = np.where((t + 4 * reach > last) | (t + 4 * reach < first), -reach, reach)[:, None]
        places = np.clip(t[:, None] + reach * np.arange(5), first, last)
        c = parameters(curve_points(curve, places.ravel())).reshape(len(t), 5, 2) / size
        one = (-25 * c[:, 0] + 48 * c[:, 1] - 36 * c[:, 2] + 16 * c[:, 3] - 3 * c[:, 4]) / (12 * reach)
        two = (35 * c[:, 0] - 104 * c[:, 1] + 114 * c[:, 2] - 56 * c[:, 3] + 11 * c[:, 4]) / (12 * reach**2)
        return np.stack([c[:, 0], one, two], axis=1)

    breaks = np.unique(knots[(knots >= first) & (knots <= last)])
    crossings = _crossings(curve, parameters, first, last)
    apart = np.abs(crossings[:, None] - breaks).min(axis=1) > 1e-6 * (last - first)
    points, new_knots, _ = fit_curve(values, np.union1d(breaks, crossings[apart]), MAP_TOLERANCE)
    return TrimCurve(points * size, new_knots, 5)


def _crossings(curve: Nurbs, parameters: ParameterMap, first: float, last: float) -> Array:
    """Where a trim curve crosses a knot of the NURBS form: the map has a kink in its second derivative there."""
    t = np.linspace(first, last, 129)
    uv = curve_points(curve, t)[:, :2]
    found: list[Array] = []
    for axis in (0, 1):
        for value in parameters.kinks[axis]:
            sign = uv[:, axis] > value
            low, high = t[:-1][sign[:-1] != sign[1:]], t[1:][sign[:-1] != sign[1:]]
            up = curve_points(curve, high)[:, axis] > value if len(high) else np.empty(0, dtype=bool)
            for _ in range(60):
                if not len(low):
                    break
                middle = 0.5 * (low + high)
                above = (curve_points(curve, middle)[:, axis] > value) == up
                low, high = np.where(above, low, middle), np.where(above, middle, high)
            found.append(0.5 * (low + high))
    return np.concatenate(found) if found else np.empty(0)
