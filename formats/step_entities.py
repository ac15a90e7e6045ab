"""Which record of a STEP file each face, edge and vertex of the kernel came from."""

from __future__ import annotations

from typing import Any

from OCP.collections import IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher
from OCP.STEPConstruct import STEPConstruct
from OCP.StepRepr import StepRepr_RepresentationItem
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Shape

from .step_records import StepRecords

_KINDS = (TopAbs_ShapeEnum.TopAbs_FACE, TopAbs_ShapeEnum.TopAbs_EDGE, TopAbs_ShapeEnum.TopAbs_VERTEX)


class StepEntities:
    """Records by shape, wherever the shape is placed, and the file's records."""

    def __init__(self, records: StepRecords) -> None:
        self.records = records
        self._index = IndexedMap_TopoDS_Shape_TopTools_ShapeMapHasher()
        self._numbers: list[int] = []

    @classmethod
    def of(cls, reader: Any, data: bytes) -> StepEntities | None:
        """Of a STEPControl_Reader that has transferred `data`; None when its entities are not the records in order."""
        model, process = reader.Model(), reader.WS().TransferReader().TransientProcess()
        made = cls(StepRecords.of(data))
        numbers = list(made.records.spans)
        more = model.NbEntities() - len(numbers)  # the kernel makes an entity of every reference to nowhere
        place = 0
        for number in numbers:
            place += 1
            while more > 0 and not made._fits(number, model.Value(place)):
                place, more = place + 1, more - 1
            if more < 0 or not made._fits(number, model.Value(place)):
                return None
            entity = model.Value(place)
            if isinstance(entity, StepRepr_RepresentationItem):
                shape = STEPConstruct.FindShape_s(process, entity)
                if shape is not None and not shape.IsNull() and shape.ShapeType() in _KINDS:
                    made._add(shape, number)
        return made

    def _fits(self, number: int, entity: Any) -> bool:
        """The entity is of the record's type. Records of several types, and entities that make no shape, are not told."""
        if not isinstance(entity, StepRepr_RepresentationItem) or self.records.body(number).lstrip().startswith(b"("):
            return True
        name = entity.DynamicType().Name().rpartition("_")[2].upper()
        return self.records.type(number).replace("_", "") == name

    def _add(self, shape: TopoDS_Shape, number: int) -> None:
        bare = shape.Located(TopLoc_Location())
        if not self._index.Contains(bare):
            self._index.Add(bare)
            self._numbers.append(number)

    def of_shape(self, shape: TopoDS_Shape) -> int:
        """The record of a shape, 0 when it has none of its own."""
        place = self._index.FindIndex(shape.Located(TopLoc_Location()))
        return self._numbers[place - 1] if place else 0
