"""IGES files written by the CAD kernel: the same bytes at any time in any process."""

from __future__ import annotations

import io
import re
from pathlib import Path

from OCP.IGESCAFControl import IGESCAFControl_Writer
from OCP.IGESControl import IGESControl_Controller
from OCP.IGESData import IGESData_IGESWriter
from OCP.Interface import Interface_Static
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS_Shape

from .._version import __version__
from ..errors import InputError
from .atomic import write_whole
from .iges_records import IgesFile, order_properties, parse, text_of
from .occt.own_trims import bounded
from .occt.part import OcctPart
from .occt.quiet import quiet
from .step_text import REAL_FORMAT, SYSTEM, step_real

_KERNEL_UNITS = {
    "um": "UM", "mm": "MM", "cm": "CM", "m": "M", "km": "KM", "in": "INCH", "ft": "FT", "mi": "MI", "mil": "MIL",
    "uin": "UIN",
}  # fmt: skip

DATE = "15H20000101.000000"
"""The header's dates: a clock would make every file different."""

_REAL = re.compile(r"-?\d\.\d{16}E[+-]\d+")


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
    take_back = bounded(face.shape for face in map(part.face, range(1, len(part.faces) + 1)))
    done = writer.Transfer(part.document)
    take_back()
    if not done:
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
    system = f"{SYSTEM} {__version__}"
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
