"""Validation properties of a STEP file: the area, volume and centroid that the sending system wrote beside the geometry.

They let a reader see whether the part arrived whole. Where faces were sculpted they are brought up to date by what the
faces' own share changed, so that the sender's number stays the basis; those of other bodies are left alone.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .occt.moments import Moments
from .step_records import StepRecords
from .step_structure import Assembly, shape_items
from .step_text import step_real
from .step_units import REPRESENTATION_CONTEXT, measure, millimetres, millimetres_of_context

Array = NDArray[np.float64]

_FACES = ("ADVANCED_FACE", "FACE_SURFACE", "CURVE_BOUNDED_SURFACE")
_MEASURES = {b"AREA_MEASURE": "area", b"VOLUME_MEASURE": "volume"}
_NUMBER = rb"[-+]?[0-9.]+(?:[eE][-+]?\d+)?"


@dataclass(frozen=True, slots=True, eq=False)
class Property:
    """One recorded number: `kind` area, volume or centroid; `item` its record, `value` as it stands there.

    scale : mm (mm2, mm3) per unit of the value. product : the product definition that it is of; placed : the
    occurrence, where it is of the product in its place, else 0. parts : the faces that it
    covers, as records, with the matrices (4, 4) of the places that they have in it, in mm.
    """

    kind: str
    item: int
    value: tuple[float, ...]
    scale: float
    product: int
    placed: int
    parts: tuple[tuple[frozenset[int], Array], ...]

    @property
    def faces(self) -> frozenset[int]:
        """All faces that it covers."""
        return frozenset().union(*(faces for faces, _ in self.parts))


def properties(records: StepRecords) -> list[Property]:
    """The areas, volumes and centroids of a file, in its order. Those whose unit or shape is not known are left out."""
    found: list[Property] = []
    assembly = Assembly(records)
    for link in records.of_type("PROPERTY_DEFINITION_REPRESENTATION"):
        definition, representation = (records.references(link) + [0, 0])[:2]
        if not re.search(rb"'geometric.validation.property", records.body(definition), re.IGNORECASE):
            continue
        target = next(iter(records.references(definition)), 0)
        read = [r for r in (_read(records, item, representation) for item in _items(records, representation)) if r]
        if read:
            found += [Property(*item, *_covered(assembly, target)) for item in read]
    return found


def _covered(assembly: Assembly, target: int) -> tuple[int, int, tuple[tuple[frozenset[int], Array], ...]]:
    """The product that a property's target is, or is of, where it is placed, and the faces in it with their places."""
    records = assembly.records
    of = next(iter(records.references(target)), 0) if records.type(target) != "PRODUCT_DEFINITION" else target
    placed = of if of in assembly.occurrences else 0
    if placed:  # a product where it is placed
        product = assembly.occurrences[of][1]
        places = [(n, assembly.matrix(of) @ matrix) for n, matrix in assembly.below(product)]
    elif of in assembly.paths:
        product, places = of, list(assembly.below(of))
    else:  # an aspect: some of a product's shape
        product = next((n for n in records.below([target]) if n in assembly.paths), 0)
        return product, 0, ((_faces(records, shape_items(records, target)), np.eye(4)),)
    return product, placed, tuple((_faces(records, assembly.items(n)), matrix) for n, matrix in places)


def _faces(records: StepRecords, items: frozenset[int]) -> frozenset[int]:
    return frozenset(n for n in items if records.type(n) in _FACES)


def _items(records: StepRecords, representation: int) -> list[int]:
    """The items of a REPRESENTATION."""
    arguments = records.arguments(representation)
    return [int(n) for n in re.findall(rb"#\s*(\d+)", arguments[1])] if len(arguments) > 1 else []


def _read(records: StepRecords, item: int, representation: int) -> tuple[str, int, tuple[float, ...], float] | None:
    """(kind, item, value, scale) of an item; None when it is no measure."""
    body = records.body(item)
    if records.type(item) == "CARTESIAN_POINT":
        context = next((r for r in records.references(representation) if records.is_a(r, REPRESENTATION_CONTEXT)), 0)
        factor = millimetres_of_context(records, context)
        place = tuple(float(x) for x in re.findall(_NUMBER, records.arguments(item)[1]))
        return ("centroid", item, place, factor) if factor and len(place) == 3 else None
    for word, kind in _MEASURES.items():
        if word in body.upper():
            value = measure(body)
            unit = _unit(records, item)
            if value is not None and unit is not None:
                return kind, item, (value,), unit ** (2 if kind == "area" else 3)
    return None


def _unit(records: StepRecords, item: int) -> float | None:
    """mm per length unit behind an item's area or volume unit; None when there is none."""
    for unit in records.references(item):
        for element in [unit, *records.references(unit)]:
            for length in [element, *records.references(element)]:
                factor = millimetres(records, length)
                if factor is not None:
                    return factor
    return None


def whole_area(records: StepRecords, faces: set[int]) -> float | None:
    """The recorded area of exactly these faces, mm2; the sum where each face has its own. None when none is recorded."""
    areas = [p for p in properties(records) if p.kind == "area" and p.faces and p.value[0] > 0.0]
    for item in areas:
        if item.faces == faces:
            return item.value[0] * item.scale
    single = {next(iter(p.faces)): p.value[0] * p.scale for p in areas if len(p.faces) == 1}
    return sum(single.values()) if faces and faces <= single.keys() else None


# ------------------------------------------------------------------------ updating


def update(records: StepRecords, before: Mapping[int, Moments], after: Mapping[int, Moments]) -> list[str]:
    """Bring the properties of the bodies with sculpted faces up to date: the faces' moments by their records, before and
    after. Returns what could not be."""
    every = properties(records)
    told: list[str] = []
    touched = [p for p in every if p.faces & before.keys()]
    sizes = {
        (p.product, p.faces, p.kind): p.value[0] * p.scale for p in touched if p.kind != "centroid" and p.value[0] > 0.0
    }
    for item in touched:
        area = volume = 0.0
        area_shift, volume_shift = np.zeros(3), np.zeros(3)
        for faces, matrix in item.parts:
            for n in faces & before.keys():
                old, new = before[n], after[n]
                area += new.area - old.area
                volume += new.volume - old.volume
                area_shift += _placed(matrix, new.area_moments, new.area) - _placed(matrix, old.area_moments, old.area)
                volume_shift += _placed(matrix, new.volume_moments, new.volume)
                volume_shift -= _placed(matrix, old.volume_moments, old.volume)
        if item.kind == "centroid":
            key = (item.product, item.faces)
            whole, change, shift = sizes.get((*key, "volume"), 0.0), volume, volume_shift
            if whole <= 0.0:
                whole, change, shift = sizes.get((*key, "area"), 0.0), area, area_shift
            if whole <= 0.0:
                told.append(f"the recorded centroid #{item.item} is the sender's: no volume or area stands beside it")
                continue
            moved = (np.array(item.value) * item.scale * whole + shift) / (whole + change) / item.scale
            value = tuple(float(x) for x in moved)
        elif item.value[0] > 0.0:  # a volume of 0 is that of a body that is no solid
            value = (item.value[0] + (area if item.kind == "area" else volume) / item.scale,)
        else:
            continue
        records.change(item.item, _with_numbers(records.body(item.item), item.kind, value))
    return told


def _placed(matrix: Array, moments: tuple[float, float, float], size: float) -> Array:
    """First moments seen from another frame: of a body of this size, area or volume, placed by a matrix."""
    return np.asarray(matrix[:3, :3] @ np.array(moments) + size * matrix[:3, 3], dtype=np.float64)


def _with_numbers(body: bytes, kind: str, value: tuple[float, ...]) -> bytes:
    """The record with other numbers."""
    if kind == "centroid":
        text = b",".join(step_real(x).encode() for x in value)
        return re.sub(rb"\(\s*" + rb"\s*,\s*".join([_NUMBER] * 3) + rb"\s*\)", b"(" + text + b")", body, count=1)
    return re.sub(
        rb"((?:AREA|VOLUME)_MEASURE\s*\(\s*)" + _NUMBER,
        lambda m: m[1] + step_real(value[0]).encode(),
        body,
        count=1,
        flags=re.IGNORECASE,
    )
