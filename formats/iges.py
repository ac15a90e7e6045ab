"""IGES files (versions up to 5.3), read and written by the CAD kernel."""

from __future__ import annotations

import io
import re
import tempfile
from collections import Counter
from pathlib import Path

from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.IGESCAFControl import IGESCAFControl_Reader, IGESCAFControl_Writer
from OCP.IGESControl import IGESControl_Controller
from OCP.IGESData import IGESData_IGESWriter
from OCP.Interface import Interface_Static
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS_Shape

from .._version import __version__
from ..errors import InputError
from ..units import conversion, unit_name
from .atomic import write_whole
from .iges_entities import creased_surfaces, damaged_entities
from .iges_records import IgesFile, order_properties, parse, text_of
from .occt.document import (
    METRES_PER_MM,
    FaceNames,
    count_faces,
    face_names,
    faces_in,
    free_shapes,
    new_document,
    set_length_unit,
    wrong_entities,
)
from .occt.part import OcctPart
from .occt.probe import ensure_survives
from .occt.quiet import quiet
from .step_text import REAL_FORMAT, step_real

UNIT_OF_FLAG = {1: "in", 2: "mm", 4: "ft", 5: "mi", 6: "m", 7: "km", 8: "mil", 9: "um", 10: "cm", 11: "uin"}
"""Length units by the global section's unit flag; flag 3 goes by the name."""

_KERNEL_UNITS = {
    "um": "UM", "mm": "MM", "cm": "CM", "m": "M", "km": "KM", "in": "INCH", "ft": "FT", "mi": "MI", "mil": "MIL",
    "uin": "UIN",
}  # fmt: skip

DATE = "15H20000101.000000"
"""The header's dates: a clock would make every file different."""

_BOUNDED = {143, 144, 510}
_SURFACES = {114, 118, 120, 122, 128, 140, 190, 192, 194, 196, 198}
_REAL = re.compile(r"-?\d\.\d{16}E[+-]\d+")


def read(path: Path, *, units: str | None = None) -> OcctPart:
    """Read an IGES file. `units`: take its numbers to be in this unit, whatever the file says.

    Raises InputError, in one line, when the file is missing, empty, no IGES file, beyond reading or without surfaces.
    """
    return load(path, units=units)


def load(path: Path, *, units: str | None = None, probing: bool = False) -> OcctPart:
    """`read`; when not `probing`, a file that looks damaged is tried in another process first."""
    data = _content(path)
    file = parse(data.decode("latin-1"))
    if not file.entities:
        raise InputError("this is no IGES file", where=str(path), mend="its lines have S, G, D and P in column 73")
    tried = probing
    file.broken += damaged_entities(file)
    if not tried and (file.broken or file.disordered or not file.complete):
        ensure_survives(path, "iges")
        tried = True
    warnings = []
    if file.crowded:
        warnings.append(
            f"{file.crowded} of its lines run into column 65, which the standard keeps blank; they were set right"
        )
    creased = creased_surfaces(file)
    if creased:
        warnings.append(
            f"{creased} of its surfaces have knots of full multiplicity; areas are integrated exactly here, while"
            " OpenCASCADE's quadrature, which other readers show, can be 1 % off on such faces"
        )
    with quiet():
        IGESControl_Controller.Init_s()
        Interface_Static.SetIVal_s("read.iges.bspline.continuity", 0)
        reader = IGESCAFControl_Reader()
        for mode in ("Name", "Color", "Layer"):
            getattr(reader, f"Set{mode}Mode")(True)
        status = _load(reader, path, text_of(file) if file.crowded else None)
        if status != IFSelect_ReturnStatus.IFSelect_RetDone:
            raise InputError("the CAD kernel cannot read it", where=str(path), mend=_mend(file))
        if not tried and wrong_entities(reader.WS().Model()):
            ensure_survives(path, "iges")
        unit, said = _unit_of(file)
        warnings += said
        factor = 1.0
        if units is not None:
            factor = conversion(unit_name(units), unit)
            unit = unit_name(units)
        document = new_document()
        set_length_unit(document, METRES_PER_MM / factor)
        done = reader.Transfer(document)
        set_length_unit(document, METRES_PER_MM)
        shapes = free_shapes(document)
        count = count_faces(shapes)
        if not done or count == 0:
            raise InputError(_nothing(file), where=str(path), mend=_mend(file))
        warnings += _losses(file, count)
        names = _names(reader, face_names(document))
    return OcctPart(document, path, "iges", unit, warnings=warnings, names=names)


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


def expected_faces(file: IgesFile) -> int:
    """How many faces a file should give: bounded surfaces, and surfaces that stand by themselves."""
    return sum(e.type in _BOUNDED or (e.type in _SURFACES and e.independent) for e in file.entities)


def _nothing(file: IgesFile) -> str:
    expected = expected_faces(file)
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
    if count < expected_faces(file):
        lines.append(f"the file holds {expected_faces(file)} surfaces, {count} could be read")
    return lines


def _unit_of(file: IgesFile) -> tuple[str, list[str]]:
    """The file's length unit from its global section, and what to say about it."""
    flag, name = [*file.header[13:15], "", ""][:2]
    number = int(flag) if flag.strip().isdigit() else (1 if not flag.strip() else 0)
    if number in UNIT_OF_FLAG:
        return UNIT_OF_FLAG[number], []
    text = re.sub(r"^\d+H", "", name)
    try:
        return unit_name(text), []
    except InputError:
        return "mm", [f"the file's length unit {text!r} (flag {flag!r}) is not known; its numbers are taken as mm"]


def _names(reader: IGESCAFControl_Reader, names: FaceNames) -> FaceNames:
    """Face names from the entities' name properties and labels, where the document has none."""
    session = reader.WS()
    model, transfer = session.Model(), session.TransferReader()
    for i in range(1, model.NbEntities() + 1):
        entity = model.Value(i)
        if entity.TypeNumber() not in _BOUNDED | _SURFACES:
            continue
        shape = transfer.ShapeResult(entity)
        if shape is None or shape.IsNull():
            continue
        faces = list(faces_in(shape))
        if len(faces) != 1:
            continue
        if entity.HasName():
            names.add(faces[0], entity.NameValue().ToCString())
        elif entity.HasShortLabel():
            label = entity.ShortLabel().ToCString().strip()
            number = entity.SubScriptNumber() if entity.HasSubScriptNumber() else 0
            names.add(faces[0], f"{label}_{number}" if label and number else label)
    return names


# ---------------------------------------------------------------------- writing


def write(part: OcctPart, path: Path) -> None:
    """Write a part as IGES 5.3 in its own unit, with names and colours.

    One part gives the same bytes at any time in any process. Raises InputError when it cannot be written; nothing is
    left behind then.
    """
    with quiet():
        text = text_of_part(part, path.name)
    write_whole(path, text.encode("latin-1", "replace"))


def text_of_part(part: OcctPart, name: str) -> str:
    """The IGES file of a part. `name` goes into the header."""
    IGESControl_Controller.Init_s()
    Interface_Static.SetCVal_s("write.iges.unit", _KERNEL_UNITS.get(part.units, "MM"))
    Interface_Static.SetIVal_s("write.iges.brep.mode", int(_has_solid(part.shape)))
    writer = IGESCAFControl_Writer()
    for mode in ("Name", "Color", "Layer"):
        getattr(writer, f"Set{mode}Mode")(True)
    if not writer.Transfer(part.document):
        raise InputError("the CAD kernel cannot write the part as IGES", where=str(part.path))
    writer.ComputeModel()
    sender = IGESData_IGESWriter(writer.Model())
    numbers = sender.FloatWriter()
    numbers.SetFormat(REAL_FORMAT)
    numbers.SetZeroSuppress(False)
    sender.SendModel(writer.Model().Protocol())
    stream = io.BytesIO()
    if not sender.Print(stream):
        raise InputError("the CAD kernel cannot write the part as IGES", where=str(part.path))
    return text_of(_settled(parse(stream.getvalue().decode("latin-1")), name))


def _settled(file: IgesFile, name: str) -> IgesFile:
    """The kernel's file with shortest exact numbers and a header that tells no time and no person."""
    for entity in file.entities:
        entity.parameters = [step_real(float(p)) if _REAL.fullmatch(p) else p for p in entity.parameters]
    order_properties(file)  # the kernel has them in the order of memory addresses
    system = f"cadsculpt {__version__}"
    header = {2: "cadsculpt part", 3: name, 4: system, 5: "Open CASCADE 8", 11: "", 20: "", 21: ""}
    for place, text in header.items():
        if place < len(file.header):
            file.header[place] = f"{len(text)}H{text}" if text else ""
    for place in (17, 24):
        if place < len(file.header):
            file.header[place] = DATE
    file.header = [step_real(float(p)) if _REAL.fullmatch(p) else p for p in file.header]
    return file


def _has_solid(shape: TopoDS_Shape) -> bool:
    return bool(TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_SOLID).More())
