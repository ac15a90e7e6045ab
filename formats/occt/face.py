"""A face of a STEP or IGES part: its surface as a B-spline, its trims, edges and measures, each made when asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from OCP.Bnd import Bnd_Box
from OCP.BRep import BRep_Tool
from OCP.BRepBndLib import BRepBndLib
from OCP.BRepGProp import BRepGProp
from OCP.BRepTools import BRepTools
from OCP.Geom import Geom_BezierSurface, Geom_BSplineSurface, Geom_Surface
from OCP.Geom2d import Geom2d_Curve
from OCP.GProp import GProp_GProps
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from ...errors import CadsculptError, GeometryError
from ...spline.surface import BSplineSurface, Provenance, TrimCurve
from ..area import trimmed_area
from ..part import Face, FaceEdge
from .analytic import Bounds, Conversion, convert, kind_of_geom
from .arrays import integers, reals
from .boundary import Boundary, boundary_of_face, is_whole_domain, placement, sample_edge
from .quiet import quiet
from .shape import basis_of_geom, surface_of_geom
from .tolerance import REVERSED
from .trim import carried_trim, reversed_trim, trim_of_geom

Array = NDArray[np.float64]

TRIM_TOLERANCE = 1e-8
"""Distance, mm, within which trim curves are carried over where a conversion changes the parameters."""


class OcctFace(Face):
    """A face of an `OcctPart`.

    shape : the kernel's face, placed and oriented as it stands in the part. neighbours : numbers of the faces on an edge.
    compare_area : told the number, the area and the kernel's own area, once the area is known. beside : gives the face's edges
    the neighbours that the kernel does not know of.
    """

    def __init__(
        self,
        shape: TopoDS_Face,
        number: int,
        name: str,
        provenance: Provenance,
        neighbours: Callable[[TopoDS_Edge], tuple[int, ...]],
        compare_area: Callable[[int, float, float], None],
        beside: Callable[[int, Sequence[FaceEdge]], Sequence[FaceEdge]] = lambda number, edges: edges,
    ) -> None:
        self.shape = shape
        self.number = number
        self.name = name
        self.provenance = provenance
        self._neighbours = neighbours
        self._beside = beside
        self._compare_area = compare_area
        self._kept: dict[str, Any] = {}

    def forget(self) -> None:
        """Drop what was computed: the kernel's face has changed."""
        self._kept.clear()

    def _once(self, key: str, make: Callable[[], Any]) -> Any:
        """What `make` gives, made once; an error is kept and raised again."""
        if key not in self._kept:
            try:
                with quiet():
                    self._kept[key] = make()
            except CadsculptError as error:
                self._kept[key] = error
            except Exception as error:
                self._kept[key] = GeometryError(f"the CAD kernel cannot take the face: {error}", where=self.where)
        value = self._kept[key]
        if isinstance(value, CadsculptError):
            raise value
        return value

    # ---------------------------------------------------------------- the kernel's

    @property
    def where(self) -> str:
        """File and face, for messages."""
        return f"{self.provenance.file} face {self.number}" + (f" {self.name!r}" if self.name else "")

    @property
    def geom(self) -> Geom_Surface:
        """The kernel's surface, in its own frame, without rectangular trimming."""
        return basis_of_geom(placement(self.shape)[0])

    @property
    def location(self) -> TopLoc_Location:
        """Where the kernel's surface is placed."""
        return placement(self.shape)[1]

    @property
    def outward(self) -> bool:
        """True when S_u x S_v points out of the material."""
        location = self.location
        mirrored = not location.IsIdentity() and location.Transformation().IsNegative()
        return bool((self.shape.Orientation() != REVERSED) != mirrored)

    @property
    def uv_bounds(self) -> Bounds:
        """The face's extent in the kernel's parameters."""
        return self._once("uv_bounds", lambda: BRepTools.UVBounds_s(self.shape))  # type: ignore[no-any-return]

    @property
    def kind(self) -> str:  # type: ignore[override]
        geom = placement(self.shape)[0]
        return "other" if geom is None else kind_of_geom(geom)

    @property
    def degree(self) -> tuple[int, int]:
        """Degrees in u and v, of the B-spline that an analytic kind becomes when it is none."""
        geom = self.geom
        if isinstance(geom, Geom_BSplineSurface | Geom_BezierSurface):
            return geom.UDegree(), geom.VDegree()
        return self.surface.degree_u, self.surface.degree_v

    @property
    def net(self) -> tuple[int, int]:
        """Number of control points along u and v (poles of the kernel where periodic)."""
        geom = self.geom
        if isinstance(geom, Geom_BSplineSurface | Geom_BezierSurface):
            return geom.NbUPoles(), geom.NbVPoles()
        return self.surface.shape

    # -------------------------------------------------------------------- surface

    @property
    def conversion(self) -> Conversion:
        """The B-spline surface without trims, and where the kernel's parameters went."""
        return self._once("conversion", self._convert)  # type: ignore[no-any-return]

    def _convert(self) -> Conversion:
        if placement(self.shape)[0] is None:
            raise GeometryError("has no surface", where=self.where, mend="repair the file in the CAD system")
        geom, location = self.geom, self.location
        transformation = None if location.IsIdentity() else location.Transformation()
        if isinstance(geom, Geom_BSplineSurface) and (geom.IsUPeriodic() or geom.IsVPeriodic()):
            geom, start = periodic_window(geom, self.uv_bounds)
            return Conversion(surface_of_geom(geom, transformation, start=start))
        try:
            return convert(geom, self.uv_bounds, transformation)
        except GeometryError as error:
            raise GeometryError(error.what, where=self.where, mend=error.mend) from error

    @property
    def boundary(self) -> Boundary:
        """The loops, on the B-spline surface."""
        return self._once("boundary", lambda: boundary_of_face(self.shape, self._carry()))  # type: ignore[no-any-return]

    def _carry(self) -> Callable[[Geom2d_Curve, float, float, bool], TrimCurve]:
        """How a 2D curve of the kernel becomes a trim curve of the B-spline surface."""
        made = self.conversion
        if made.map_u is None and made.map_v is None:
            return lambda curve, first, last, backward: trim_of_geom(curve, first, last, backward=backward)
        scale = parameter_scale(made.surface)

        def carry(curve: Geom2d_Curve, first: float, last: float, backward: bool) -> TrimCurve:
            trim = carried_trim(curve, first, last, made.map_u, made.map_v, scale, TRIM_TOLERANCE)
            return reversed_trim(trim) if backward else trim

        return carry

    @property
    def surface(self) -> BSplineSurface:
        return self._once("surface", self._make_surface)  # type: ignore[no-any-return]

    def _make_surface(self) -> BSplineSurface:
        made = self.conversion
        loops = self.boundary.trims()
        trims = None if is_whole_domain(made.surface, loops) else loops
        return replace(made.surface, trims=trims, outward=self.outward, name=self.name, provenance=self.provenance)

    @property
    def trimmed(self) -> bool:  # type: ignore[override]
        try:
            return self.surface.trims is not None
        except CadsculptError:
            return True

    @property
    def warning(self) -> str:  # type: ignore[override]
        try:
            note = self.conversion.note
            lost = self.boundary.lost
        except CadsculptError as error:
            return error.what
        lines = [note] if note else []
        if lost:
            lines.append(f"{lost} of its edges have no trim curve")
        return "; ".join(lines)

    # ------------------------------------------------------------------- measures

    @property
    def area(self) -> float:
        return float(self._once("area", self._measure_area))

    def _measure_area(self) -> float:
        kernel = self.kernel_area()
        try:
            area = trimmed_area(self.surface)
        except CadsculptError:
            return kernel
        self._compare_area(self.number, area, kernel)
        return area

    def kernel_area(self) -> float:
        """The area that the CAD kernel's own quadrature gives, mm2."""
        properties = GProp_GProps()
        BRepGProp.SurfaceProperties_s(self.shape, properties)
        return abs(float(properties.Mass()))

    @property
    def bbox(self) -> tuple[float, float, float, float, float, float]:
        return self._once("bbox", self._measure_bbox)  # type: ignore[no-any-return]

    def _measure_bbox(self) -> tuple[float, float, float, float, float, float]:
        box = Bnd_Box()
        BRepBndLib.AddOptimal_s(self.shape, box, False, False)
        if box.IsVoid():
            raise GeometryError("has no extent", where=self.where)
        low, high = box.CornerMin(), box.CornerMax()
        return low.X(), low.Y(), low.Z(), high.X(), high.Y(), high.Z()

    @property
    def edges(self) -> Sequence[FaceEdge]:
        return self._beside(self.number, self.own_edges())

    def own_edges(self) -> Sequence[FaceEdge]:
        """The edges with the neighbours that the kernel knows of."""
        return self._once("edges", self._sample_edges)  # type: ignore[no-any-return]

    def _sample_edges(self) -> tuple[FaceEdge, ...]:
        surface, found = self.conversion.surface, []
        for loop in self.boundary.loops:
            for item in loop:
                uv, points = sample_edge(surface, item.curve)
                others = tuple(n for n in self._neighbours(item.edge) if n != self.number)
                found.append(FaceEdge(uv, points, others, item.seam, item.degenerate, BRep_Tool.Tolerance_s(item.edge)))
        return tuple(found)


def parameter_scale(surface: BSplineSurface) -> tuple[float, float]:
    """Largest lengths on the surface, seen on a few places, of one unit of u and of v."""
    (u0, u1), (v0, v1) = surface.domain
    d = surface.derivatives(np.linspace(u0, u1, 7)[:, None], np.linspace(v0, v1, 7)[None, :], 1)
    return float(np.linalg.norm(d[1, 0], axis=-1).max()), float(np.linalg.norm(d[0, 1], axis=-1).max())


def periodic_window(
    geom: Geom_BSplineSurface, bounds: Bounds
) -> tuple[Geom_BSplineSurface, tuple[float | None, float | None]]:
    """Where to begin the domain of a periodic B-spline surface so that it holds the face.

    It begins at OCCT's own first knot where the face lies in that period, else at a knot before the face; when the face
    fits after no knot, one is inserted (in a copy) at the face's start.
    """
    start: list[float | None] = [None, None]
    for axis, periodic in enumerate((geom.IsUPeriodic(), geom.IsVPeriodic())):
        if not periodic:
            continue
        low, high = bounds[2 * axis], bounds[2 * axis + 1]
        knots = [geom.UKnot(i) for i in range(1, geom.NbUKnots() + 1)] if axis == 0 else []
        knots = knots or [geom.VKnot(i) for i in range(1, geom.NbVKnots() + 1)]
        period, slack = knots[-1] - knots[0], 1e-7 * (knots[-1] - knots[0])
        if low >= knots[0] - slack and high <= knots[-1] + slack:
            continue
        turns = np.floor((low - knots[0] + slack) / period)
        before = max(k for k in knots if k <= low - turns * period + slack) + turns * period
        if high <= before + period + slack:
            start[axis] = float(before)
            continue
        geom = geom.Copy()
        insert = geom.InsertUKnots if axis == 0 else geom.InsertVKnots
        insert(reals(np.array([low - turns * period])), integers(np.array([1])), 0.0, True)
        start[axis] = float(low)
    return geom, (start[0], start[1])
