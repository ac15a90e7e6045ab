"""Rhino's 3DM files, all versions: Breps, surfaces and extrusions, in blocks too, sculpted back into the same file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import GeometryError, InputError
from ...spline.surface import BSplineSurface
from ...units import METRES_PER_UNIT, conversion
from ..part import Face, FaceEdge, Faces, Part, Validity
from ..patch_part import check_sculpted
from .archive import archive_version, check_archive, object_records
from .body import Body, Place
from .geometry import library
from .probe import ensure_survives
from .user_text import face_names, periodic_faces

if TYPE_CHECKING:
    from .shape import BodyShape

Array = NDArray[np.float64]

_UNITS = {
    "Microns": "um", "Millimeters": "mm", "Centimeters": "cm", "Decimeters": "dm", "Meters": "m", "Kilometers": "km",
    "Inches": "in", "Feet": "ft", "Yards": "yd", "Miles": "mi", "Mils": "mil", "Microinches": "uin",
}  # fmt: skip
_OTHER_UNITS = {
    "Angstroms": 1e-10, "Nanometers": 1e-9, "Dekameters": 10.0, "Hectometers": 100.0, "Megameters": 1e6,
    "Gigameters": 1e9, "PrinterPoints": 0.0254 / 72, "PrinterPicas": 0.0254 / 6, "NauticalMiles": 1852.0,
    "AstronomicalUnits": 1.495978707e11, "LightYears": 9.4607304725808e15, "Parsecs": 3.08567758149e16,
}  # fmt: skip


class RhinoFace(Face):
    """One face of a Brep, or a surface that stands alone."""

    def __init__(self, part: RhinoPart, body: Body, index: int, name: str) -> None:
        self._part, self._body, self._index = part, body, index
        self._edges: tuple[BSplineSurface, Sequence[FaceEdge]] | None = None
        self.number = body.first + index
        self.name = name
        self.warning = body.fault(index)
        self.kind = "other" if self.warning else body.form(index).kind
        self.trimmed = not body.untrimmed(index)

    @property
    def surface(self) -> BSplineSurface:
        if self.warning:
            raise GeometryError(self.warning, where=f"{self._part.path.name}, face {self.name}")
        return replace(self._body.surface(self._index), name=self.name)

    @property
    def area(self) -> float:
        from ..area import trimmed_area

        return trimmed_area(self.surface)

    @property
    def bbox(self) -> tuple[float, float, float, float, float, float]:
        from ..face_box import face_box

        made = self._part.shape_of(self._body)
        if self._index in made.lost:
            raise GeometryError(made.lost[self._index], where=f"{self._part.path.name}, face {self.name}")
        return face_box(made.faces[self._index])

    @property
    def edges(self) -> Sequence[FaceEdge]:
        if self.warning:
            return ()
        surface = self._body.surface(self._index)
        if self._edges is None or self._edges[0] is not surface:
            self._edges = surface, self._body.face_edges(self._index)
        return self._edges[1]


class RhinoPart(Part):
    """A 3DM file in memory: its bytes, and the bodies in it."""

    format = "3dm"

    def __init__(self, path: Path, data: bytes, model: Any, units: str | None = None) -> None:
        self.path = path
        self.warnings: list[str] = []
        self._data = data
        self._model = model
        self.units, self._scale = (units, conversion(units, "mm")) if units else self._read_units()
        self.bodies = self._read_bodies()
        self.faces = Faces(self._name_faces(), path.name)
        self._shapes: dict[int, BodyShape] = {}
        if not len(self.faces):
            self.warnings.append(f"no surfaces: the file holds {_inventory(model)}")

    # --------------------------------------------------------------- reading

    def _read_units(self) -> tuple[str, float]:
        name = str(self._model.Settings.ModelUnitSystem).rpartition(".")[2]
        if name in _UNITS:
            unit = _UNITS[name]
            return unit, METRES_PER_UNIT[unit] / METRES_PER_UNIT["mm"] if unit != "mm" else 1.0
        if name in _OTHER_UNITS:
            self.warnings.append(f"the file's unit is {name}; lengths are converted to mm")
            return "", _OTHER_UNITS[name] / METRES_PER_UNIT["mm"]
        why = "a unit of its own" if name == "CustomUnits" else "no length unit"
        self.warnings.append(f"the file has {why}: its numbers are taken as mm")
        return "", 1.0

    @property
    def tolerance(self) -> float | None:
        return float(self._model.Settings.ModelAbsoluteTolerance) * self._scale

    def _read_bodies(self) -> list[Body]:
        things = list(self._model.Objects)
        records = self._records(things)
        self._by_id = {str(thing.Attributes.Id): i for i, thing in enumerate(things)}
        self._placements: dict[int, int] = {}
        bodies: list[Body] = []
        taken: set[str] = set()
        number = 1
        for index, thing in enumerate(things):
            if thing.Attributes.IsInstanceDefinitionObject:
                continue
            for i, placement, block in self._placed(things, index, None, "", ()):
                made = _brep_of(things[i].Geometry)
                if made is None:
                    continue
                kind, brep = made
                self._placements[records[i]] = self._placements.get(records[i], 0) + 1
                name = _unique(self._object_name(things[i], i), taken)
                count = len(brep.Faces)
                names, periodic = (read(things[i].Attributes, count) for read in (face_names, periodic_faces))
                place = Place(
                    record=records[i],
                    kind=kind,
                    name=name,
                    file=self.path.name,
                    units=self.units,
                    scale=self._scale,
                    placement=placement,
                    block=block,
                    face_names=names,
                    periodic=periodic,
                )
                body = Body(place, brep, number)
                try:
                    number += len(body.brep.faces)
                except InputError as error:
                    raise InputError(error.what, where=f"{self.path}, object {i + 1}", mend=error.mend) from error
                bodies.append(body)
        return bodies

    def _records(self, things: Sequence[Any]) -> list[int]:
        """Which record of the file's object table each object is. Raises InputError when some could not be read."""
        if archive_version(self._data) == 1:
            return list(range(len(things)))
        records = object_records(self._data)
        if len(records) == len(things):
            return list(range(len(records)))
        identities = {record.identity(self._data): i for i, record in enumerate(records)}
        places = [identities.get(thing.Attributes.Id.bytes_le, -1) for thing in things]
        lost = sorted(set(range(len(records))) - set(places))
        if -1 in places or any(records[i].holds_surfaces for i in lost):
            raise InputError(
                f"{len(lost)} of its {len(records)} objects cannot be read",
                where=str(self.path),
                mend="the file is damaged: open it in Rhino and save it again",
            )
        self.warnings.append(f"{len(lost)} objects of unknown kinds are left alone")
        return places

    def _placed(
        self, things: Sequence[Any], index: int, placement: Array | None, block: str, above: tuple[str, ...]
    ) -> Iterator[tuple[int, Array | None, str]]:
        """An object, or all objects of the block that it places: (object, placement, block's name)."""
        geometry = things[index].Geometry
        if type(geometry).__name__ != "InstanceReference":
            yield index, placement, block
            return
        identity = str(geometry.ParentIdefId)
        definition = self._model.InstanceDefinitions.FindId(geometry.ParentIdefId)
        if definition is None or identity in above:
            self.warnings.append(f"object {index + 1} places a block that is not in the file")
            return
        here = _matrix(geometry.Xform)
        here = here if placement is None else placement @ here
        for inner in definition.GetObjectIds2():
            place = self._by_id.get(str(inner))
            if place is not None:
                yield from self._placed(things, place, here, definition.Name, (*above, identity))

    def _object_name(self, thing: Any, index: int) -> str:
        """The object's own name, else its layer's, else its number."""
        if thing.Attributes.Name:
            return str(thing.Attributes.Name)
        layer = thing.Attributes.LayerIndex
        if 0 <= layer < len(self._model.Layers):
            name = str(self._model.Layers[layer].Name or "")
            if name and not name.lower().startswith(("default", "layer 0")):
                return name
        return f"object {index + 1}"

    def _name_faces(self) -> list[RhinoFace]:
        taken: set[str] = set()
        return [
            RhinoFace(self, body, index, _unique(body.face_name(index), taken))
            for body in self.bodies
            for index in range(len(body.brep.faces))
        ]

    # ------------------------------------------------------------- sculpting

    def sculpt(self, surfaces: Mapping[int, BSplineSurface]) -> None:
        chosen: list[tuple[Body, int, BSplineSurface]] = []
        for number, surface in sorted(surfaces.items()):
            face = self.faces.number(number)
            body = next(b for b in self.bodies if b.first <= number < b.first + len(b.brep.faces))
            count = self._placements[body.place.record]
            if count > 1:
                raise InputError(
                    f"face {face.name} belongs to block {body.place.block!r}, which stands in the model {count} times",
                    where=str(self.path),
                    mend="explode the block in Rhino: sculpting one place would change all",
                )
            check_sculpted(surface, face.surface, str(self.path))
            own = body.read_surface(number - body.first)
            sculpted = replace(surface, trims=own.trims, outward=own.outward, name=own.name, provenance=own.provenance)
            chosen.append((body, number - body.first, sculpted))
        for body, index, surface in chosen:
            body.sculpted[index] = surface
        self._shapes.clear()
        self._warn_of_torn_edges({id(body): body for body, _, _ in chosen})

    def _warn_of_torn_edges(self, bodies: Mapping[int, Body]) -> None:
        from .follow import follow

        for body in bodies.values():
            torn = follow(body).torn
            if torn:
                self.warnings.append(
                    f"{body.place.name}: sculpted faces left edges that other faces hold ({len(torn)}), by up to "
                    f"{max(torn.values()):.3g} mm"
                )

    # ------------------------------------------------------------ OCCT's side

    def shape_of(self, body: Body) -> BodyShape:
        """The OCCT shell or solid of a body as it is now."""
        if body.first not in self._shapes:
            from ..occt.quiet import quiet
            from .follow import follow
            from .shape import shape_of_body

            with quiet():
                self._shapes[body.first] = shape_of_body(body, follow(body))
        return self._shapes[body.first]

    def validity(self) -> Validity:
        """What OCCT's checker says of the shells and solids, and openNURBS of its own objects."""
        from ..occt.quiet import quiet
        from ..occt.validity import validity_of
        from .write import sculpted_brep

        faults: list[str] = []
        shapes, faces = [], []
        for body in self.bodies:
            thing = sculpted_brep(body)
            if thing is None or not thing.IsValid:
                faults.append(f"{body.place.name}: openNURBS finds the object invalid")
            made = self.shape_of(body)
            faults += [f"face {body.first + i}: {why}" for i, why in made.lost.items()]
            shapes.append(made.shape)
            faces += [(body.first + i, face) for i, face in made.faces.items()]
        with quiet():
            kernel = validity_of(shapes, faces)
        return Validity(kernel.valid and not faults, (*faults, *kernel.faults))

    # --------------------------------------------------------------- writing

    def write(self, path: Path, format: str) -> None:
        from ..atomic import write_whole

        if format == "3dm":
            from .write import sculpted_file

            write_whole(path, sculpted_file(self._data, self.bodies))
        elif format == "json":
            from ..patch_json import write_surfaces

            write_surfaces(path, [face.surface for face in self.faces if not face.warning], "mm")
        else:
            from ..occt.part import document_of_shapes

            made = [(body, self.shape_of(body)) for body in self.bodies]
            lost = [self.faces.number(body.first + i).name for body, shape in made for i in shape.lost]
            if lost:
                self.warnings.append(f"not in {Path(path).name} ({len(lost)}): {', '.join(lost[:5])}")
            document_of_shapes(
                [(body.place.name, shape.shape) for body, shape in made if shape.faces],
                self.units,
                faces=[
                    (self.faces.number(body.first + i).name, face)
                    for body, shape in made
                    for i, face in shape.faces.items()
                ],
                path=self.path,
                format=format,
            ).write(path, format)

    @cached_property
    def version(self) -> int:
        """The archive version: 1 to 5, then 50, 60, 70, 80 for Rhino 5 to 8."""
        return archive_version(self._data)


def read(path: Path, *, units: str | None = None) -> RhinoPart:
    """Read a 3DM file. units : to take its numbers in, whatever the file says.

    Raises InputError when it is missing, empty, cut short or otherwise damaged, or not a 3DM file at all.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(error.strerror or "cannot be read", where=str(path), mend="check the name") from error
    if not data:
        raise InputError("the file is empty", where=str(path))
    try:
        check_archive(data)
        ensure_survives(data)
        model = library().File3dm.FromByteArray(data)
        if model is None:
            raise InputError("openNURBS cannot read it", mend="the file is damaged: open it in Rhino and save it again")
        return RhinoPart(path, data, model, units)
    except InputError as error:
        if error.where:
            raise
        raise InputError(error.what, where=str(path), mend=error.mend) from error


def _brep_of(geometry: Any) -> tuple[str, Any] | None:
    """(brep, surface or extrusion, rhino3dm's Brep of it); None for what has no surfaces."""
    rhino3dm = library()
    name = type(geometry).__name__
    if name == "Brep":
        return "brep", geometry
    if name == "Extrusion":
        brep = geometry.ToBrep(True)
        return None if brep is None else ("extrusion", brep)
    if isinstance(geometry, rhino3dm.Surface):
        brep = rhino3dm.Brep.TryConvertBrep(geometry)
        return None if brep is None else ("surface", brep)
    return None


def _unique(name: str, taken: set[str]) -> str:
    """The name, with a number behind it when it is taken already."""
    base, turn = name, 2
    while name in taken:
        name, turn = f"{base} ({turn})", turn + 1
    taken.add(name)
    return name


def _matrix(transform: Any) -> Array:
    """(4, 4) of a rhino3dm Transform."""
    return np.array([[getattr(transform, f"M{i}{j}") for j in range(4)] for i in range(4)], dtype=np.float64)


def _inventory(model: Any) -> str:
    """ "3 Curve, 1 Mesh": what a file without surfaces holds."""
    kinds: dict[str, int] = {}
    for thing in model.Objects:
        kind = type(thing.Geometry).__name__
        kinds[kind] = kinds.get(kind, 0) + 1
    return ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items())) or "no objects"


def write_part(part: Part, path: Path) -> None:
    """Write any part as a new 3DM file in mm, whole or not at all; a part read from a 3DM file goes back into that.

    What a 3DM file cannot hold is named in the part's warnings. Raises InputError when there is nothing to write or the
    file cannot be written.
    """
    if isinstance(part, RhinoPart):
        part.write(path, "3dm")
        return
    from ..atomic import write_whole
    from .new import new_file

    write_whole(path, new_file(part))
