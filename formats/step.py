"""STEP files (ISO 10303-21: AP203, AP214, AP242), read and written by the CAD kernel."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
from OCP.collections import Sequence_TCollection_AsciiString
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.Interface import Interface_Static
from OCP.STEPCAFControl import STEPCAFControl_Controller, STEPCAFControl_Reader, STEPCAFControl_Writer
from OCP.STEPControl import STEPControl_StepModelType
from OCP.StepData import StepData_StepWriter
from OCP.TCollection import TCollection_HAsciiString

from .._version import __version__
from ..errors import InputError
from ..units import conversion, unit_name
from .atomic import write_whole
from .occt.document import (
    METRES_PER_MM,
    count_faces,
    face_names,
    free_shapes,
    new_document,
    set_length_unit,
    wrong_entities,
)
from .occt.face import OcctFace
from .occt.healing import set_healing
from .occt.moments import moments_of
from .occt.own_trims import bounded
from .occt.part import OcctPart
from .occt.probe import ensure_survives
from .occt.quiet import quiet
from .step_entities import StepEntities
from .step_properties import update
from .step_records import StepRecords
from .step_splice import CannotSpliceError, splice
from .step_structure import name_single_faces
from .step_text import REAL_FORMAT, SYSTEM, TIME_STAMP, StepFacts, facts_of, settled
from .step_trims import keep_file_trims

_KERNEL_UNITS = {
    "um": "UM", "mm": "MM", "cm": "CM", "m": "M", "km": "KM", "in": "INCH", "ft": "FT", "mi": "MILE", "mil": "MIL",
    "uin": "UIN",
}  # fmt: skip
"""Length units that the kernel writes, by its own names."""


SAME_SURFACE = 1e-10
"""Relative to its size, how near a sculpted surface must read back to what was written."""

SAME_AREA = 1e-4
"""Relative difference up to which the area of a sculpted face that reads back is the same: its edges may be projected
anew."""


def read(path: Path, *, units: str | None = None) -> OcctPart:
    """Read a STEP file. `units`: take its numbers to be in this unit, whatever the file says.

    Raises InputError, in one line, when the file is missing, empty, no STEP file, beyond reading or without faces.
    """
    return load(path, units=units)


def load(path: Path, *, units: str | None = None, probing: bool = False, data: bytes | None = None) -> OcctPart:
    """`read`; when not `probing`, a file that looks damaged is tried in another process first.

    data : the file's text, when it is not to be read from `path`.
    """
    data = _content(path) if data is None else data
    facts = facts_of(data)
    tried = probing
    if not tried and (facts.damaged or not facts.complete):
        ensure_survives(path, "step", complete=facts.complete)
        tried = True
    with quiet():
        STEPCAFControl_Controller.Init_s()
        Interface_Static.SetIVal_s("read.stepcaf.subshapes.name", 1)
        reader = STEPCAFControl_Reader()
        for mode in ("Name", "Color", "Layer", "Props", "Mat"):
            getattr(reader, f"Set{mode}Mode")(True)
        status = reader.ReadStream(path.name, io.BytesIO(data))
        if status != IFSelect_ReturnStatus.IFSelect_RetDone:
            raise InputError("the CAD kernel cannot read it", where=str(path), mend=_mend(facts))
        wrong = wrong_entities(reader.ChangeReader().Model())
        if wrong and not tried:
            ensure_survives(path, "step", complete=True)
        unit, warnings = _unit_of(reader)
        document = new_document()
        factor = 1.0
        if units is not None:
            factor = conversion(unit_name(units), unit)
            unit = unit_name(units)
        set_length_unit(document, METRES_PER_MM / factor)
        set_healing(reader.ChangeReader(), "step", own=facts.own)
        done = reader.Transfer(document)
        set_length_unit(document, METRES_PER_MM)
        shapes = free_shapes(document)
        count = count_faces(shapes)
        if not done or count == 0:
            what = f"none of its {facts.faces} faces can be read" if facts.faces else "it holds no surfaces"
            raise InputError(what, where=str(path), mend=_mend(facts))
        warnings += _losses(facts, wrong, count)
        names = face_names(document)
        sound = facts.complete and (
            not facts.damaged or not wrong
        )  # damage elsewhere than in the shape is kept as it is
        source = StepEntities.of(reader.ChangeReader(), data) if sound else None
        if source is not None:
            keep_file_trims(shapes, source, own=facts.own)
    return OcctPart(document, path, "step", unit, warnings=warnings, schema=facts.schema, source=source,
                    unit_factor=factor, names=names)  # fmt: skip


def _content(path: Path) -> bytes:
    """The file's bytes. Raises InputError when they cannot be those of a STEP file."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", where=str(path)) from error
    if not data.strip():
        raise InputError("the file is empty", where=str(path), mend="export it again")
    if b"ISO-10303-21" not in data[:4096].upper():
        raise InputError("this is no STEP file", where=str(path), mend="a STEP file begins with ISO-10303-21;")
    return data


def _mend(facts: StepFacts) -> str:
    """What the user can do about a file that gives no faces."""
    if not facts.complete:
        return "the file breaks off before its end: export or copy it again"
    if facts.damaged:
        return f"{facts.damaged} of its entities are damaged: export it again"
    return "export surfaces or solids from the CAD system"


def _losses(facts: StepFacts, wrong: int, count: int) -> list[str]:
    """What of the file did not arrive."""
    lines = []
    if not facts.complete:
        lines.append("the file breaks off before its end; what stands in it was read")
    if facts.damaged:
        lines.append(f"{facts.damaged} entities of the file are damaged or refer to entities that are not there")
    elif wrong:
        lines.append(f"{wrong} entities of the file are not what the standard asks; the CAD kernel took what it could")
    if count < facts.faces:
        lines.append(f"the file holds {facts.faces} faces, {count} could be read")
    return lines


def _unit_of(reader: STEPCAFControl_Reader) -> tuple[str, list[str]]:
    """The file's length unit, and what to say about it."""
    lengths, angles, solid_angles = (Sequence_TCollection_AsciiString() for _ in range(3))
    reader.ChangeReader().FileUnits(lengths, angles, solid_angles)
    found: list[str] = []
    unknown: list[str] = []
    for i in range(1, lengths.Length() + 1):
        text = lengths.Value(i).ToCString()
        try:
            name = unit_name(text)
        except InputError:
            unknown.append(text)
            continue
        if name not in found:
            found.append(name)
    warnings = []
    if len(found) > 1:
        warnings.append(f"the file mixes the length units {', '.join(found)}; all were brought to mm")
    if unknown:
        warnings.append(f"the file's length unit {unknown[0]!r} is not known by name; lengths were brought to mm")
    return (found[0] if found else "mm"), warnings


def write(part: OcctPart, path: Path) -> None:
    """Write a part as STEP in its own unit and application protocol, with names, colours, layers and placements.

    A part that was read from a STEP file goes back into that file's text, where only what was sculpted changes; a warning
    says when that cannot be and the kernel writes it anew. One part gives the same bytes at any time in any process.
    Raises InputError when it cannot be written; nothing is left behind then.
    """
    data = None
    if part.source is not None and not part.relabelled:
        try:
            data = spliced_text(part, part.source)
        except CannotSpliceError as error:
            part.warnings.append(f"{path.name} is written anew, with what the CAD kernel knows of the file: {error}")
    if data is None:
        with quiet():
            data = text_of(part, path.name)
    write_whole(path, data)


def spliced_text(part: OcctPart, source: StepEntities) -> bytes:
    """The text of the file that the part was read from, with the sculpted faces in it.

    Raises CannotSpliceError where the text cannot take them, or does not read back as the part is.
    """
    if not part.sculpted:
        return source.records.data
    faces = [part.face(number) for number in sorted(part.sculpted)]
    with quiet():
        records = splice(source, faces, part.moved.edges, part.moved.vertices)
        numbers = {source.of_shape(face.shape): face.number for face in faces}
        before = {record: part.before[number] for record, number in numbers.items()}
        after = {record: moments_of(part.face(number)) for record, number in numbers.items()}
        told = update(records, before, after)
    data = records.text()
    try:
        again = load(part.path, probing=True, data=data)
    except InputError as error:
        raise CannotSpliceError(f"its text with the sculpted faces cannot be read: {error.what}") from error
    if len(again.faces) != len(part.faces):
        raise CannotSpliceError("its text with the sculpted faces reads back as other faces")
    for face in faces:
        _compare(face, again.face(face.number))
    if part.validity().valid and not again.validity().valid:
        raise CannotSpliceError("its text with the sculpted faces reads back as a faulty part")
    part.warnings += [line for line in told if line not in part.warnings]
    return data


def _compare(face: OcctFace, again: OcctFace) -> None:
    """Raise CannotSpliceError when a face that was read back is not what was written."""
    here, there = face.surface, again.surface
    u, v = (np.linspace(*bounds, 17) for bounds in here.domain)
    slack = SAME_SURFACE * max(here.size, 1e-300)
    same = np.abs(np.subtract(here.domain, there.domain)).max() <= 1e-9 * max(high - low for low, high in here.domain)
    if not same or np.abs(here.evaluate(u[:, None], v) - there.evaluate(u[:, None], v)).max() > slack:
        raise CannotSpliceError(f"face {face.number} reads back otherwise than it was written")
    if abs(face.area - again.area) > SAME_AREA * face.area:
        raise CannotSpliceError(f"face {face.number} reads back with another border")


def text_of(part: OcctPart, name: str) -> bytes:
    """The STEP file of a part. `name` goes into the header."""
    STEPCAFControl_Controller.Init_s()
    Interface_Static.SetCVal_s("write.step.unit", _KERNEL_UNITS.get(part.units, "MM"))
    Interface_Static.SetCVal_s("write.step.schema", part.schema or "AP214IS")
    Interface_Static.SetIVal_s("write.stepcaf.subshapes.name", 1)
    Interface_Static.SetCVal_s("write.step.product.name", "part")
    writer = STEPCAFControl_Writer()
    for mode in ("Name", "Color", "Layer", "Material"):
        getattr(writer, f"Set{mode}Mode")(True)
    writer.SetPropsMode(not part.sculpted)  # areas and volumes of the sender are no longer true
    take_back = bounded(face.shape for face in map(part.face, range(1, len(part.faces) + 1)))
    done = writer.Transfer(part.document, STEPControl_StepModelType.STEPControl_AsIs)
    take_back()
    if not done:
        raise InputError("the CAD kernel cannot write the part as STEP", where=str(part.path))
    model = writer.ChangeWriter().Model()
    header = APIHeaderSection_MakeHeader(model)
    header.SetName(TCollection_HAsciiString(name))
    header.SetTimeStamp(TCollection_HAsciiString(TIME_STAMP))
    header.SetAuthorValue(1, TCollection_HAsciiString(""))
    header.SetOrganizationValue(1, TCollection_HAsciiString(""))
    header.SetPreprocessorVersion(TCollection_HAsciiString("Open CASCADE 8"))
    header.SetOriginatingSystem(TCollection_HAsciiString(f"{SYSTEM} {__version__}"))
    header.SetDescriptionValue(1, TCollection_HAsciiString("cadsculpt part"))
    sender = StepData_StepWriter(model)
    numbers = sender.FloatWriter()
    numbers.SetFormat(REAL_FORMAT)
    numbers.SetZeroSuppress(False)
    sender.SendModel(writer.ChangeWriter().WS().Protocol())
    stream = io.BytesIO()
    if not sender.Print(stream):
        raise InputError("the CAD kernel cannot write the part as STEP", where=str(part.path))
    data = settled(stream.getvalue())
    if part.format == "step":
        return data
    records = StepRecords.of(data)
    name_single_faces(records)
    return records.text()
