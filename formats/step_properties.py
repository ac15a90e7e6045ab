"""Validation properties of a STEP file: the area, volume and centroid that the sending system wrote beside the geometry.

They let a reader see whether the part arrived whole. Where faces were sculpted they are brought up to date by what the
faces' own share changed, so that the sender's number stays the basis; those of other bodies are left alone.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from .occt.moments import Moments
from .step_records import StepRecords
from .step_text import step_real
from .step_units import REPRESENTATION_CONTEXT, measure, millimetres, millimetres_of_context

_FACES = ("ADVANCED_FACE", "FACE_SURFACE", "CURVE_BOUNDED_SURFACE")
_MEASURES = {b"AREA_MEASURE": "area", b"VOLUME_MEASURE": "volume"}
_NUMBER = rb"[-+]?[0-9.]+(?:[eE][-+]?\d+)?"


@dataclass(frozen=True, slots=True)
class Property:
    """One recorded number: `kind` area, volume or centroid; `item` its record, `value` as it stands there.

    scale : mm (mm2, mm3) per unit of the value. items : the shape that it is of, as records; faces : those of them that are
    faces.
    """

    kind: str
    item: int
    value: tuple[float, ...]
    scale: float
    items: frozenset[int]
    faces: frozenset[int]


def properties(records: StepRecords) -> list[Property]:
    """The areas, volumes and centroids of a file, in its order. Those whose unit or shape is not known are left out."""
    found = []
    for link in records.of_type("PROPERTY_DEFINITION_REPRESENTATION"):
        definition, representation = (records.references(link) + [0, 0])[:2]
        if not re.search(rb"'geometric.validation.property", records.body(definition), re.IGNORECASE):
            continue
        target = next(iter(records.references(definition)), 0)
        items = shape_items(records, target)
        faces = frozenset(n for n in items if records.type(n) in _FACES)
        for item in _items(records, representation):
            read = _read(records, item, representation)
            if read is not None:
                found.append(Property(*read, items, faces))
    return found


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


def shape_items(records: StepRecords, target: int) -> frozenset[int]:
    """All geometric records of the shape that a property is of: a product's, or that of one of its aspects."""
    holders = {target}
    if records.type(target) == "PRODUCT_DEFINITION":
        holders |= {user for user in records.users(target) if records.type(user) == "PRODUCT_DEFINITION_SHAPE"}
    holders |= {
        user for holder in set(holders) for user in records.users(holder) if records.type(user) == "PROPERTY_DEFINITION"
    }
    roots = []
    for holder in holders:
        for user in records.users(holder):
            if records.type(user) == "SHAPE_DEFINITION_REPRESENTATION":
                roots += records.references(user)[1:2]
    linked = set(roots)
    for root in roots:  # a product's shape may hang on it by a relationship of two representations
        for user in records.users(root):
            if records.type(user) == "SHAPE_REPRESENTATION_RELATIONSHIP":
                linked.update(r for r in records.references(user))
    return frozenset(records.below(linked, lambda n: records.is_a(n, REPRESENTATION_CONTEXT)))


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
    volumes = {p.items: p.value[0] * p.scale for p in touched if p.kind == "volume" and p.value[0] > 0.0}
    areas = {p.items: p.value[0] * p.scale for p in touched if p.kind == "area" and p.value[0] > 0.0}
    for item in touched:
        changed = item.faces & before.keys()
        area = sum(after[n].area - before[n].area for n in changed)
        volume = sum(after[n].volume - before[n].volume for n in changed)
        if item.kind == "area":
            new: tuple[float, ...] = (item.value[0] + area / item.scale,)
        elif item.kind == "volume":
            if item.value[0] <= 0.0:  # of a body that is no solid
                continue
            new = (item.value[0] + volume / item.scale,)
        else:
            old, change, by = (
                (volumes[item.items], volume, "volume_moments")
                if item.items in volumes
                else (areas.get(item.items, 0.0), area, "area_moments")
            )
            if old <= 0.0:
                told.append(f"the centroid #{item.item} is the sender's: no volume or area stands beside it")
                continue
            shift = [sum(getattr(after[n], by)[k] - getattr(before[n], by)[k] for n in changed) for k in range(3)]
            new = tuple(
                (c * item.scale * old + s) / (old + change) / item.scale for c, s in zip(item.value, shift, strict=True)
            )
        records.change(item.item, _with_numbers(records.body(item.item), item.kind, new))
    return told


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
