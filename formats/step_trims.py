"""The trim curves of a STEP file's faces on B-spline surfaces (ISO 10303-42: PCURVE), from its records."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from OCP.collections import IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher
from OCP.Geom2d import Geom2d_BSplineCurve, Geom2d_Curve, Geom2d_Line
from OCP.gp import gp_Dir2d, gp_Pnt2d
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Edge, TopoDS_Shape

from .occt.arrays import integers, points_2d, reals
from .occt.clamped import Clamped, keep_clamped
from .occt.document import faces_in
from .occt.own_trims import Offered, keep_trims, spline_of_face
from .step_entities import StepEntities
from .step_geometry import closed_flags
from .step_records import StepRecords, references
from .step_units import tolerance

Array = NDArray[np.float64]

FACES = ("ADVANCED_FACE", "FACE_SURFACE")
SURFACE_CURVES = ("SURFACE_CURVE", "SEAM_CURVE", "INTERSECTION_CURVE")


def keep_file_trims(shapes: Sequence[TopoDS_Shape], source: StepEntities, *, own: bool) -> None:
    """Give the faces of shapes just read the trim curves of their file, and closed surfaces the knots that it gives.

    own : cadsculpt wrote the file.
    """
    records = source.records
    exact, given = tolerance(records) or 0.0, bool(records.of_type("PCURVE"))
    seen = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
    closed: list[Clamped] = []
    for shape in shapes:
        for face in faces_in(shape):
            bare = face.Located(TopLoc_Location())
            if seen.Contains(bare):
                continue
            seen.Add(bare)
            geom = spline_of_face(face)
            surface = _surface(records, source.of_shape(face))
            if geom is None or not surface or closed_flags(records, surface) is None:
                continue  # no spline in the file: its parameters have units

            def offers(edge: TopoDS_Edge, surface: int = surface) -> list[Offered]:
                return _offers(records, source.of_shape(edge), surface, own)

            if given:
                keep_trims(face, offers, exact)
            if geom.IsUPeriodic() or geom.IsVPeriodic():
                closed.append(Clamped(face, *_full_ends(records, surface)))
    keep_clamped(closed)


def _surface(records: StepRecords, face: int) -> int:
    """The record of a face's surface, its own where it is a surface that stands by itself."""
    place = {**dict.fromkeys(FACES, 2), "CURVE_BOUNDED_SURFACE": 1}.get(records.type(face))
    return face if place is None else _reference(records.arguments(face)[place])


def _full_ends(records: StepRecords, surface: int) -> tuple[bool, bool]:
    """Whether the knots of a B-spline surface are full at their ends, in u and in v."""
    type = "B_SPLINE_SURFACE_WITH_KNOTS"
    whole = records.arguments(surface, type)
    if not whole:
        return False, False
    if records.type(surface) == type:
        degrees, counts = whole[1:3], whole[8:10]
    else:
        degrees, counts = records.arguments(surface, "B_SPLINE_SURFACE")[:2], whole[:2]
    return tuple(bool((_numbers(c)[[0, -1]] == int(d) + 1).all()) for c, d in zip(counts, degrees, strict=True))  # type: ignore[return-value]


def _offers(records: StepRecords, edge: int, surface: int, own: bool) -> list[Offered]:
    """The trim curves that an EDGE_CURVE has on a surface."""
    if records.type(edge) != "EDGE_CURVE":
        return []
    arguments = records.arguments(edge)
    number = _reference(arguments[3]) if len(arguments) > 3 else 0
    if records.type(number) not in SURFACE_CURVES or records.body(number).lstrip().startswith(b"("):
        return []
    inner = records.arguments(number)
    found = []
    for pcurve in references(inner[2]):
        parts = records.references(pcurve)
        if records.type(pcurve) != "PCURVE" or len(parts) < 2 or parts[0] != surface:
            continue
        flat = [n for n in records.references(parts[1]) if records.type(n) != "" and not _is_context(records, n)]
        curve = _curve(records, flat[0]) if flat else None
        if curve is None:
            return []
        found.append(Offered(curve, own))
    return found


def _is_context(records: StepRecords, number: int) -> bool:
    return "CONTEXT" in records.type(number) or records.is_a(number, "REPRESENTATION_CONTEXT")


def _curve(records: StepRecords, number: int) -> Geom2d_Curve | None:
    """A line or B-spline curve in the parameter plane; None for other kinds, and for what is none."""
    try:
        if records.type(number) == "LINE":
            return _line(records, number)
        return _spline(records, number)
    except (ValueError, IndexError, KeyError):
        return None
    except Exception:  # the kernel's own errors have no common base
        return None


def _line(records: StepRecords, number: int) -> Geom2d_Curve | None:
    point, vector = records.references(number)[:2]
    direction = records.references(vector)[0]
    if float(records.arguments(vector)[2]) != 1.0:
        return None
    (x, y), (a, b) = _pair(records, point), _pair(records, direction)
    return Geom2d_Line(gp_Pnt2d(x, y), gp_Dir2d(a, b))


def _spline(records: StepRecords, number: int) -> Geom2d_Curve | None:
    if not records.is_a(number, "B_SPLINE_CURVE_WITH_KNOTS"):
        return None
    whole = records.arguments(number, "B_SPLINE_CURVE_WITH_KNOTS")
    if records.type(number) == "B_SPLINE_CURVE_WITH_KNOTS":
        own, knots, weights = whole[1:6], whole[6:8], None
    else:
        own, knots = records.arguments(number, "B_SPLINE_CURVE"), whole[:2]
        rational = records.arguments(number, "RATIONAL_B_SPLINE_CURVE")
        weights = _numbers(rational[0]) if rational else None
    poles = np.array([_pair(records, n) for n in references(own[1])])
    arguments = [points_2d(poles)]
    if weights is not None:
        arguments.append(reals(weights))
    counts = _numbers(knots[0]).astype(np.int64)
    return Geom2d_BSplineCurve(*arguments, reals(_numbers(knots[1])), integers(counts), int(own[0]))


def _pair(records: StepRecords, number: int) -> tuple[float, float]:
    values = _numbers(records.arguments(number)[1])
    if len(values) != 2:
        raise ValueError(number)
    return float(values[0]), float(values[1])


def _numbers(text: bytes) -> Array:
    return np.array([float(item) for item in text.strip(b"() \r\n\t").split(b",")], dtype=np.float64)


def _reference(text: bytes) -> int:
    found = references(text)
    return found[0] if found else 0
