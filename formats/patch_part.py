"""A part made of surfaces alone: what the files of spline libraries are, and any list of surfaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import GeometryError, InputError
from ..spline.surface import BSplineSurface
from ..units import conversion
from .loose_edges import edges_of_surface, join
from .part import Face, FaceEdge, Faces, Part, Validity


class PatchFace(Face):
    """One surface of a `PatchPart`."""

    kind = "bspline"

    def __init__(self, part: PatchPart, number: int, surface: BSplineSurface) -> None:
        self._part = part
        self.number = number
        self.name = surface.name
        self.trimmed = surface.trims is not None

    @property
    def surface(self) -> BSplineSurface:
        return self._part.surfaces[self.number - 1]

    @property
    def area(self) -> float:
        from .area import trimmed_area

        return trimmed_area(self.surface)

    @property
    def bbox(self) -> tuple[float, float, float, float, float, float]:
        from .face_box import face_box
        from .occt.quiet import quiet
        from .occt.shape import shape_of_surface

        with quiet():
            return face_box(shape_of_surface(self.surface))

    @property
    def edges(self) -> Sequence[FaceEdge]:
        here = edges_of_surface(self.surface)
        joined = self._part.edges_as_read()[self.number - 1]
        return [
            replace(edge, neighbours=other.neighbours, seam=other.seam)
            for edge, other in zip(here, joined, strict=True)
        ]


def check_sculpted(surface: BSplineSurface, read: BSplineSurface, where: str) -> None:
    """Raise GeometryError when `surface` cannot take the place of a face's surface `read`."""
    if (surface.degree_u, surface.degree_v) != (read.degree_u, read.degree_v) or surface.domain != read.domain:
        raise GeometryError(
            f"the sculpted surface of face {read.name} has other degrees or another parameter range", where=where
        )
    surface.validate()


class PatchPart(Part):
    """Surfaces without topology. `surfaces` are the faces' surfaces in mm; edges are joined where they run together."""

    def __init__(self, path: Path, format: str, units: str, surfaces: Sequence[BSplineSurface]) -> None:
        """surfaces : in `units` (mm when the file has none), every name once."""
        self.path = path
        self.format = format
        self.units = units
        self.warnings: list[str] = []
        self._scale = conversion(units or "mm", "mm")
        self._in_file = list(surfaces)
        self._read = [surface.scaled(self._scale) for surface in surfaces]
        self.surfaces = list(self._read)
        self.faces = Faces([PatchFace(self, n, surface) for n, surface in enumerate(surfaces, 1)], path.name)
        self._edges: list[list[FaceEdge]] | None = None

    def edges_as_read(self) -> list[list[FaceEdge]]:
        """The edges of every face as it was read, with their neighbours."""
        if self._edges is None:
            self._edges = join([edges_of_surface(surface) for surface in self._read])
        return self._edges

    def sculpt(self, surfaces: Mapping[int, BSplineSurface]) -> None:
        for number, surface in surfaces.items():
            check_sculpted(surface, self.faces.number(number).surface, str(self.path))
        for number, surface in surfaces.items():
            read = self._read[number - 1]
            self.surfaces[number - 1] = replace(
                surface, trims=read.trims, outward=read.outward, name=read.name, provenance=read.provenance
            )

    def validity(self) -> Validity:
        """OCCT's verdict on every face by itself."""
        from .occt.quiet import quiet
        from .occt.shape import shape_of_surface
        from .occt.validity import validity_of

        with quiet():
            shapes = [shape_of_surface(surface) for surface in self.surfaces]
            return validity_of(shapes, list(enumerate(shapes, 1)))

    def in_units(self) -> list[BSplineSurface]:
        """The surfaces as they are now in the file's unit; control points that did not change have the file's bits."""
        result = []
        for now, read, in_file in zip(self.surfaces, self._read, self._in_file, strict=True):
            if now is read:
                result.append(in_file)
                continue
            net = now.control_points / self._scale
            if now.shape == read.shape:
                net = np.where(now.control_points == read.control_points, in_file.control_points, net)
            result.append(now.with_control_points(net))
        return result

    def write(self, path: Path, format: str) -> None:
        if format == "json":
            if self.format == "geomdl":
                from .geomdl_json import write_surfaces as write_geomdl

                write_geomdl(path, self.in_units())
            else:
                from .patch_json import write_surfaces

                write_surfaces(path, self.in_units(), self.units or "mm")
        elif format == "3dm":
            from .rhino.part import write_part

            write_part(self, path)
        elif format in ("step", "iges"):
            self._write_through_kernel(path, format)
        else:
            raise InputError(f"cannot write {format!r}", where=str(path), mend="use step, iges, 3dm or json")

    def _write_through_kernel(self, path: Path, format: str) -> None:
        """Every surface as a shell of one face: faces that stand in no shell lose their names in STEP."""
        from OCP.BRep import BRep_Builder
        from OCP.TopoDS import TopoDS_Shell

        from .occt.part import document_of_shapes
        from .occt.quiet import quiet
        from .occt.shape import shape_of_surface

        shells, faces, builder = [], [], BRep_Builder()
        with quiet():
            for surface in self.surfaces:
                shell, face = TopoDS_Shell(), shape_of_surface(surface)
                builder.MakeShell(shell)
                builder.Add(shell, face)
                shells.append((surface.name, shell))
                faces.append((surface.name, face))
        document_of_shapes(shells, self.units, faces=faces, path=self.path, format=format).write(path, format)
