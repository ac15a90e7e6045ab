"""An IGES file as a part that goes back into the file it came from: one face sculpted changes that face's entity alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from OCP.TDocStd import TDocStd_Document
from OCP.TopoDS import TopoDS_Face

from ..errors import CadsculptError
from ..spline.surface import BSplineSurface
from .iges_kernel import resolution_of
from .iges_records import IgesFile
from .iges_rewrite import Change, changed_text
from .iges_sculpt import changes_of_face
from .occt.document import FaceNames
from .occt.part import OcctPart
from .part import FaceEdge


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """The file behind a part: its text, the text taken apart, the kernel's face of each entity, mm per unit.

    whole : all of the file is in the part, so that the file may take its place.
    """

    text: str
    file: IgesFile
    faces: Mapping[int, TopoDS_Face]
    scale: float
    whole: bool


class IgesPart(OcctPart):
    """A part read from an IGES file."""

    def __init__(
        self,
        document: TDocStd_Document,
        path: Path,
        units: str,
        source: Source,
        *,
        warnings: list[str],
        names: FaceNames,
    ) -> None:
        super().__init__(document, path, "iges", units, warnings=warnings, names=names)
        self._source = source
        origin = FaceNames()
        for pointer, face in source.faces.items():
            origin.add(face, str(pointer))
        self.entities = {face.number: int(origin.of(self.face(face.number).shape) or 0) for face in self.faces}
        """Number of a face -> its entity's place in the directory, 0 where it is not known."""
        self._read: dict[int, tuple[BSplineSurface, tuple[FaceEdge, ...]]] = {}
        self._now: dict[int, BSplineSurface] = {}

    def tolerance_of(self, number: int) -> float | None:
        found = resolution_of(self._source.file)
        return None if found is None else found * self._source.scale

    def sculpt(self, surfaces: Mapping[int, BSplineSurface]) -> None:
        for number in surfaces:
            if number not in self._read:
                face = self.face(number)
                self._read[number] = face.surface, tuple(face.edges)
        super().sculpt(surfaces)
        self._now.update(surfaces)

    def write(self, path: Path, format: str) -> None:
        text = self.text() if format == "iges" else None
        if text is None:
            super().write(path, format)
            return
        from .atomic import write_whole

        write_whole(path, text.encode("latin-1"))

    def text(self) -> str | None:
        """The file with the sculpted faces in their entities; None, and a warning, when it must be written anew."""
        source = self._source
        if not source.whole:
            return None
        changes: dict[int, Change] = {}
        for number, surface in sorted(self._now.items()):
            read, edges = self._read[number]
            face = self.faces.number(number).name
            try:
                changes |= changes_of_face(source.file, self.entities[number], read, surface, edges, source.scale)
            except CadsculptError as error:
                self._anew(f"face {face}: {error.what}")
                return None
        if not changes:
            return source.text
        try:
            return changed_text(source.text, source.file, changes)
        except CadsculptError as error:
            self._anew(error.what)
            return None

    def _anew(self, why: str) -> None:
        line = f"the whole file is written anew, not its changed entities alone: {why}"
        if line not in self.warnings:
            self.warnings.append(line)
