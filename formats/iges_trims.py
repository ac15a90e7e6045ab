"""The trim curves of an IGES file's faces on B-spline surfaces (128), from its entities 142, 141 and 508."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from OCP.collections import IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher
from OCP.Geom import Geom_BSplineSurface
from OCP.Geom2d import Geom2d_Curve
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from ..errors import CadsculptError
from ..spline.surface import TrimCurve
from .iges_curves import curves_of, whole_of
from .iges_patches import spline_of
from .iges_records import Entity, IgesFile
from .occt.clamped import Clamped, keep_clamped
from .occt.curve import sample_trim
from .occt.own_trims import Offered, keep_trims, spline_of_face
from .occt.shape import basis_of_geom
from .occt.tolerance import curves_on_faces
from .occt.trim import evaluate_trim, geom_of_trim, trim_domain
from .step_text import SYSTEM

Array = NDArray[np.float64]

_SURFACE_OF = {144: 1, 143: 2, 510: 1}
"""Where among the parameters of a bounded face its surface stands."""

_PLACES = np.linspace(0.0, 1.0, 7)
"""Where, along a trim curve, it is compared with those of the file to find its own."""

ALIKE = {False: 1e-2, True: 0.1}
"""How far the kernel's curve may lie from the file's at equal shares, as a share of the domain, and still be made of it; more
in files of ours, whose curves may run at another pace."""


@dataclass(frozen=True, slots=True, eq=False)
class _Flat:
    """A trim curve of the file, and places along it by equal shares of its parameter."""

    geom: Geom2d_Curve
    places: Array


def is_own(file: IgesFile) -> bool:
    """cadsculpt wrote the file."""
    return any(f"H{SYSTEM} " in text for text in file.header[4:5])


def keep_file_trims(file: IgesFile, faces: Mapping[int, TopoDS_Face]) -> None:
    """Give the faces just read, by their entities' places, the trim curves of their file, and closed surfaces its knots."""
    own = is_own(file)
    seen = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
    closed: list[Clamped] = []
    for pointer, face in faces.items():
        bare = face.Located(TopLoc_Location())
        geom = spline_of_face(face)
        entity = file.at(pointer)
        if seen.Contains(bare) or entity is None or geom is None:
            continue
        seen.Add(bare)
        place = _SURFACE_OF.get(entity.type, 0)
        try:
            under = file.at(whole_of(entity, place)) if place else entity
            if under is None or under.type != 128:
                continue
            surface = spline_of(under)
            flats = _flats(file, entity) if place else []
        except CadsculptError:
            continue
        if flats:

            def offers(
                edge: TopoDS_Edge, geom: Geom_BSplineSurface = geom, flats: list[_Flat] = flats
            ) -> list[Offered]:
                return _offers(edge, geom, flats, own)

            keep_trims(face, offers, 0.0)
        if geom.IsUPeriodic() or geom.IsVPeriodic():
            told = [text == "1" for text in under.parameters[8:10]]  # the file itself has them periodic
            closed.append(
                Clamped(
                    face,
                    _full(surface.knots_u, surface.degree_u) and not told[0],
                    _full(surface.knots_v, surface.degree_v) and not told[1],
                )
            )
    keep_clamped(closed)


def _full(knots: Array, degree: int) -> bool:
    """Knots are full at both ends; the outermost ones shape nothing, and OCCT writes others there."""
    return bool(knots[1] == knots[degree] and knots[-2] == knots[-degree - 1])


def _flats(file: IgesFile, entity: Entity) -> list[_Flat]:
    """All trim curves of a bounded face."""
    found: list[_Flat] = []
    for pointer in _flat_pointers(file, entity):
        for curve in curves_of(file, pointer):
            trim = TrimCurve(
                np.ascontiguousarray(curve.control_points[:, :2]), curve.knots, curve.degree, curve.weights
            )
            low, high = trim_domain(trim)
            found.append(_Flat(geom_of_trim(trim), evaluate_trim(trim, low + _PLACES * (high - low))))
    return found


def _flat_pointers(file: IgesFile, entity: Entity) -> list[int]:
    """The places of the curves in the parameter plane."""
    found: list[int] = []
    if entity.type == 144:
        first, count = whole_of(entity, 4), whole_of(entity, 3)
        for pointer in [first, *(whole_of(entity, 5 + i) for i in range(count))]:
            loop = file.at(pointer) if pointer else None
            if loop is not None and loop.type == 142 and whole_of(loop, 3):
                found.append(whole_of(loop, 3))
    elif entity.type == 143:
        for i in range(whole_of(entity, 3)):
            loop = file.at(whole_of(entity, 4 + i))
            if loop is None or loop.type != 141:
                continue
            at = 5
            for _ in range(whole_of(loop, 4)):
                pieces = whole_of(loop, at + 2)
                found += [whole_of(loop, at + 3 + k) for k in range(pieces)]
                at += 3 + pieces
    else:
        for i in range(whole_of(entity, 2)):
            loop = file.at(whole_of(entity, 4 + i))
            if loop is None or loop.type != 508:
                continue
            at = 2
            for _ in range(whole_of(loop, 1)):
                pieces = whole_of(loop, at + 4)
                found += [whole_of(loop, at + 6 + 2 * k) for k in range(pieces)]
                at += 5 + 2 * pieces
    return found


def _offers(edge: TopoDS_Edge, geom: Geom_BSplineSurface, flats: Sequence[_Flat], own: bool) -> list[Offered]:
    """The file's trim curves that the kernel's on this edge were made of: those that run nearest to them."""
    bounds = np.array(geom.Bounds()).reshape(2, 2)
    span = bounds[:, 1] - bounds[:, 0]
    period = np.where([geom.IsUPeriodic(), geom.IsVPeriodic()], span, 0.0)
    starts = np.array([flat.places for flat in flats])
    every = np.concatenate([starts, starts[:, ::-1]])  # either way
    found = []
    for held in curves_on_faces(edge):
        if basis_of_geom(held.surface) is not geom:
            continue
        away = sample_trim(held.curve, held.first + _PLACES * (held.last - held.first)) - every
        turns = np.round(away.mean(axis=1, keepdims=True) / span) * period
        apart = np.abs((away - turns) / span).max(axis=(1, 2))
        best = int(np.argmin(apart))
        if apart[best] >= ALIKE[own]:
            return []
        found.append(Offered(flats[best % len(flats)].geom, own))
    return found
