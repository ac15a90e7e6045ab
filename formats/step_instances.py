"""The instances of a STEP assembly: which faces stand in which place, and a place given a part of its own."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from typing import TYPE_CHECKING

from ..errors import InputError
from .part import Instance
from .step_assembly import CannotSeparateError, separate
from .step_entities import StepEntities
from .step_records import StepRecords
from .step_structure import Assembly, Placement, placements

if TYPE_CHECKING:
    from .occt.part import OcctPart


def instances_of(part: OcctPart, source: StepEntities, own_names: Sequence[str]) -> tuple[Instance, ...]:
    """The instances of a part that was read from `source`; none when it is no assembly, or its faces do not fit in.

    own_names : of the faces, as the file has them.
    """
    assembly = Assembly(source.records)
    if not assembly.occurrences:
        return ()
    records = [source.of_shape(part.face(face.number).shape) for face in part.faces]
    products = [assembly.of_item.get(record, 0) for record in records]
    if not all(products):
        return ()
    places = placements(assembly, set(products))
    by_product: dict[int, list[Placement]] = {}
    for place in places:
        by_product.setdefault(place.product, []).append(place)
    faces: dict[str, list[int]] = {place.name: [] for place in places}
    seen: dict[int, int] = {}
    for number, (record, product) in enumerate(zip(records, products, strict=True), 1):
        turn = seen.get(record, 0)
        seen[record] = turn + 1
        if turn >= len(by_product[product]):
            return ()
        faces[by_product[product][turn].name].append(number)
    return tuple(
        Instance(
            place.name, assembly.name(place.product), tuple(faces[place.name]), _labels(faces[place.name], own_names)
        )
        for place in places
        if faces[place.name]
    )


def _labels(numbers: Sequence[int], own_names: Sequence[str]) -> tuple[str, ...]:
    """What the faces are called within their component: their own name where it is the only one, else face1, face2, ..."""
    names = [own_names[number - 1] for number in numbers]
    return tuple(name if name and names.count(name) == 1 else f"face{place}" for place, name in enumerate(names, 1))


def separated(part: OcctPart, source: StepEntities | None, names: Sequence[str]) -> OcctPart:
    """The part read again from its file's text in which each of these instances has a product of its own.

    Raises InputError naming the instances there are, or why it cannot be done.
    """
    from .step import load

    known = {instance.name: instance for instance in part.instances}
    for name in names:
        if name not in known:
            close = get_close_matches(name, known, n=3, cutoff=0.5) or list(known)[:6]
            raise InputError(
                f"no instance named {name!r}", where=str(part.path),
                mend=f"its instances are {', '.join(close)}" if known else "it is no assembly: leave instances out",
            )  # fmt: skip
    assert source is not None
    records = StepRecords.of(source.records.data)
    try:
        for name in names:
            assembly = Assembly(records)
            place = next((p for p in _places(part, assembly) if p.name == name), None)
            if place is None:
                raise CannotSeparateError(f"its placements change with {name}")
            records = StepRecords.of(separate(records, place.path).text())
    except CannotSeparateError as error:
        raise InputError(f"instances of the assembly cannot be told apart: {error}", where=str(part.path)) from error
    again = load(part.path, units=part.units if part.relabelled else None, probing=True, data=records.text())
    _check(part, again, [known[name] for name in names])
    again.warnings = list(dict.fromkeys([*part.warnings, *again.warnings]))
    return again


def _places(part: OcctPart, assembly: Assembly) -> list[Placement]:
    """The placements of the products that the part's instances are of."""
    components = {instance.component for instance in part.instances}
    shaped = {product for product in assembly.paths if assembly.name(product) in components}
    with_faces = {product for item, product in assembly.of_item.items() if assembly.records.type(item) in _FACES}
    return placements(assembly, shaped & with_faces)


_FACES = ("ADVANCED_FACE", "FACE_SURFACE", "CURVE_BOUNDED_SURFACE", "B_SPLINE_SURFACE_WITH_KNOTS")


def _check(part: OcctPart, again: OcctPart, chosen: Sequence[Instance]) -> None:
    """The faces of the chosen instances, and no others, must have become shapes of their own."""
    apart = {number for instance in chosen for number in instance.faces}
    fault = len(again.faces) != len(part.faces)
    if not fault:
        shapes = [again.face(face.number).shape.TShape() for face in again.faces]
        for instance in chosen:
            for number in instance.faces:
                twins = {i for i, shape in enumerate(shapes, 1) if shape is shapes[number - 1]}
                fault = fault or bool(twins - {number})
        fault = fault or any(
            max(abs(a - b) for a, b in zip(part.face(n).bbox, again.face(n).bbox, strict=True)) > 1e-6 for n in apart
        )
    if fault:
        raise InputError(
            "instances of the assembly cannot be told apart", where=str(part.path), mend="sculpt all places"
        )
