"""IGES files (versions up to 5.3), read by the CAD kernel; what it drops or misreads without a word is read here."""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path

from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.IGESCAFControl import IGESCAFControl_Reader
from OCP.IGESControl import IGESControl_Controller
from OCP.IGESData import IGESData_IGESEntity
from OCP.Interface import Interface_Static
from OCP.TDocStd import TDocStd_Document
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Face
from OCP.XSControl import XSControl_TransferReader

from ..errors import CadsculptError, InputError
from ..units import conversion, unit_name
from .iges_entities import creased_surfaces, damaged_entities
from .iges_kernel import for_kernel, unit_of
from .iges_part import IgesPart, Source
from .iges_patches import patch_of
from .iges_records import Entity, IgesFile, parse, text_of
from .iges_trims import is_own, keep_file_trims
from .occt.document import (
    METRES_PER_MM,
    FaceNames,
    add_shapes,
    count_faces,
    face_names,
    faces_in,
    free_shapes,
    name_faces,
    new_document,
    set_length_unit,
    wrong_entities,
)
from .occt.healing import set_healing
from .occt.probe import ensure_survives
from .occt.quiet import quiet
from .occt.shape import shape_of_surface

_BOUNDED = {143: 2, 144: 1, 510: 1}
"""Types of bounded faces, and where among their parameters the surface stands."""

_SURFACES = {114, 118, 120, 122, 128, 140, 190, 192, 194, 196, 198}
_FACES = {*_BOUNDED, *_SURFACES, 108}


def read(path: Path, *, units: str | None = None) -> IgesPart:
    """Read an IGES file. `units`: take its numbers to be in this unit, whatever the file says.

    Raises InputError, in one line, when the file is missing, empty, no IGES file, beyond reading or without surfaces.
    """
    return load(path, units=units)


def load(path: Path, *, units: str | None = None, probing: bool = False) -> IgesPart:
    """`read`; when not `probing`, a file that looks damaged is tried in another process first."""
    data = _content(path)
    try:
        file = parse(data.decode("latin-1"))
    except InputError as error:
        raise InputError(error.what, where=str(path), mend=error.mend) from None
    if not file.entities:
        raise InputError("this is no IGES file", where=str(path), mend="its lines have S, G, D and P in column 73")
    file.broken += damaged_entities(file)
    unit = unit_of(file)
    warnings = [*_set_right(file), *unit.said]
    made = for_kernel(file, unit)
    if made is not None:
        warnings += made[1]
    text = None if file.conforms and made is None else text_of(made[0] if made else file)
    document, name, factor = new_document(), unit.name, unit.kernel_factor
    if units is not None:
        name = unit_name(units)
        factor *= conversion(name, unit.name)
    names, dead, unknown = FaceNames(), "", 0
    places: dict[int, TopoDS_Face] = {}
    with quiet():
        try:
            tried = probing
            if not tried and (file.broken or file.disordered or not file.complete):
                ensure_survives(path, "iges", complete=file.complete)
                tried = True
            reader = _loaded(path, text, file)
            if not tried and wrong_entities(reader.WS().Model()):
                ensure_survives(path, "iges", complete=file.complete)
        except InputError as error:
            dead = error.what
        else:
            set_length_unit(document, METRES_PER_MM / factor)
            set_healing(reader, "iges", own=is_own(file))
            reader.Transfer(document)
            set_length_unit(document, METRES_PER_MM)
            unknown = _look_up(reader, document, owners_of(file), names, places)
            keep_file_trims(file, places)
        # a face of unknown origin may be any of those that are missing
        own = [] if unknown else _read_here(file, places, name, document, names)
        count = count_faces(free_shapes(document))
    if count == 0:
        raise InputError(dead or _nothing(file), where=str(path), mend=_mend(file))
    if dead:
        warnings.append(f"{dead}; what follows was read by cadsculpt's own reader")
    warnings += [*own, *_losses(file, count)]
    whole = units is None and not (dead or own or unknown or file.broken) and file.complete
    source = Source(
        data.decode("latin-1"), file, places, conversion(name, "mm"), whole and count == len(faces_of(file))
    )
    return IgesPart(document, path, name, source, warnings=warnings, names=names)


def _set_right(file: IgesFile) -> list[str]:
    """What is not as the standard wants it, and was put right or will be noticed elsewhere."""
    lines = [f"{what}; the file was set right" for what in file.mended]
    if file.disordered:
        lines.append(f"{file.disordered} of its lines are not numbered in their order; they were set right")
    if file.crowded:
        lines.append(
            f"{file.crowded} of its lines run into column 65, which the standard keeps blank; they were set right"
        )
    creased = creased_surfaces(file)
    if creased:
        lines.append(
            f"{creased} of its surfaces have knots of full multiplicity; areas are integrated exactly here, while"
            " OpenCASCADE's quadrature, which other readers show, can be 1 % off on such faces"
        )
    return lines


def _loaded(path: Path, text: str | None, file: IgesFile) -> IGESCAFControl_Reader:
    """The kernel's reader with the file, or with `text` in its place. Raises InputError when it takes neither."""
    IGESControl_Controller.Init_s()
    Interface_Static.SetIVal_s("read.iges.bspline.continuity", 0)
    reader = IGESCAFControl_Reader()
    for mode in ("Name", "Color", "Layer"):
        getattr(reader, f"Set{mode}Mode")(True)
    if _load(reader, path, text) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise InputError("the CAD kernel cannot read it", where=str(path), mend=_mend(file))
    return reader


def _read_here(
    file: IgesFile, places: dict[int, TopoDS_Face], unit: str, document: TDocStd_Document, names: FaceNames
) -> list[str]:
    """Put into the document the faces that the kernel dropped; returns what to say of them."""
    scale = conversion(unit, "mm")
    shapes: list[tuple[str, TopoDS_Face]] = []
    said: list[str] = []
    for entity in faces_of(file):
        if entity.pointer in places:
            continue
        try:
            surface, lines = patch_of(file, entity)
            shape = shape_of_surface(surface.scaled(scale))
        except CadsculptError:
            continue  # the count of faces tells
        except Exception:  # the kernel's own errors have no common base
            continue
        label = entity.fields[17].strip()
        shapes.append((label or f"entity {entity.pointer}", shape))
        places[entity.pointer] = shape
        names.add(shape, label)
        said += [f"entity {entity.pointer}: {line}" for line in lines]
    add_shapes(document, shapes)
    if shapes:
        said.insert(
            0,
            f"the CAD kernel drops {len(shapes)} of its {len(faces_of(file))} faces: they were read by cadsculpt's own"
            " reader",
        )
    return said


def _content(path: Path) -> bytes:
    """The file's bytes. Raises InputError when there are none."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", where=str(path)) from error
    if not data.strip():
        raise InputError("the file is empty", where=str(path), mend="export it again")
    return data


def _load(reader: IGESCAFControl_Reader, path: Path, text: str | None) -> IFSelect_ReturnStatus:
    """Let the kernel read the file, or `text` in its place: of IGES it reads files only, no streams."""
    if text is None:
        return reader.ReadFile(str(path))
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "part.igs"
        copy.write_bytes(text.encode("latin-1"))
        return reader.ReadFile(str(copy))


def faces_of(file: IgesFile) -> list[Entity]:
    """The entities that should each give a face: bounded surfaces, and surfaces that stand by themselves."""
    bounded = [entity for entity in file.entities if entity.type in _BOUNDED]
    used = owners_of(file)
    alone = [e for e in file.entities if e.type in _SURFACES and e.independent and e.pointer not in used]
    planes = [
        e for e in file.entities if e.type == 108 and e.independent and e.parameters[5:6] not in ([], ["0"], [""])
    ]
    return sorted([*bounded, *alone, *planes], key=lambda entity: entity.pointer)


def owners_of(file: IgesFile) -> dict[int, list[int]]:
    """The bounded faces of each surface that has some, by their places in the directory."""
    found: dict[int, list[int]] = {}
    for entity in file.entities:
        place = _BOUNDED.get(entity.type)
        if place is not None and place < len(entity.parameters) and entity.parameters[place].isdigit():
            found.setdefault(int(entity.parameters[place]), []).append(entity.pointer)
    return found


def _nothing(file: IgesFile) -> str:
    expected = len(faces_of(file))
    if expected:
        return f"none of its {expected} surfaces can be read"
    others = Counter(entity.type for entity in file.entities)
    what = ", ".join(f"{count} of type {kind}" for kind, count in others.most_common(3))
    return f"it holds no surfaces, only other entities ({what})"


def _mend(file: IgesFile) -> str:
    if not file.complete:
        return "the file breaks off before its end: export or copy it again"
    if file.broken:
        return f"{file.broken} of its entities are damaged: export it again"
    return "export surfaces or solids from the CAD system"


def _losses(file: IgesFile, count: int) -> list[str]:
    """What of the file did not arrive."""
    lines = []
    if not file.complete:
        lines.append("the file breaks off before its end; what stands in it was read")
    if file.broken:
        lines.append(f"{file.broken} entities of the file are damaged")
    expected = len(faces_of(file))
    if count < expected:
        lines.append(f"the file holds {expected} surfaces, {count} could be read")
    return lines


def _look_up(
    reader: IGESCAFControl_Reader,
    document: TDocStd_Document,
    owners: dict[int, list[int]],
    names: FaceNames,
    places: dict[int, TopoDS_Face],
) -> int:
    """Which entity each of the kernel's faces comes from, and its name, from properties and labels, where it has none.

    Returns how many faces are of unknown origin.
    """
    session = reader.WS()
    model, transfer = session.Model(), session.TransferReader()
    said = face_names(document)
    unknown, renamed = 0, []
    for shape in free_shapes(document):
        for face in faces_in(shape):
            entity = _origin(transfer, face)
            if entity is None:
                unknown += 1
            else:
                pointer = model.DNum(entity)
                # of a bounded surface without bounds the kernel names the surface
                pointer = next((p for p in owners.get(pointer, ()) if p not in places), pointer)
                places.setdefault(pointer, face)
                names.add(face, _name(entity))
            names.add(face, said.of(face))
            if names.of(face) != said.of(face):
                renamed.append((names.of(face), face))
    name_faces(document, renamed)
    return unknown


def _name(entity: IGESData_IGESEntity) -> str:
    """An entity's name, from its property or its label; "" when it has neither."""
    label = str(entity.ShortLabel().ToCString()).strip() if entity.HasShortLabel() else ""
    number = entity.SubScriptNumber() if entity.HasSubScriptNumber() else 0
    whole = f"{label}({number})" if number else label
    said = str(entity.NameValue().ToCString()).strip() if entity.HasName() else ""
    # the kernel makes a name of the label, with a (0) behind it where the label has no number
    return whole if label and said in ("", f"{label}({number})") else said


def _origin(transfer: XSControl_TransferReader, face: TopoDS_Face) -> IGESData_IGESEntity | None:
    """The entity that the kernel made a face of; None when it cannot tell."""
    bare = face.Located(TopLoc_Location())
    for mode in (1, 2):
        for shape in (face, bare):
            try:
                entity = transfer.EntityFromShapeResult(shape, mode)
            except Exception:  # the kernel looks up what is not there
                continue
            if entity is not None and entity.TypeNumber() in _FACES:
                return entity
    return None
