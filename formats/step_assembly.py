"""A placement in a STEP file's records given a product of its own.

A part that is placed twice stands in the file once. To sculpt it in one place, that placement gets a copy of the product:
its shape, names, colours, layers and properties; where the product's own assembly is placed several times too, that gets one
before. Only the records of the copies are new, and those that say which product is placed.
"""

from __future__ import annotations

import re

from .step_records import StepRecords, renumbered
from .step_structure import PLACED, Assembly, Path
from .step_units import REPRESENTATION_CONTEXT

_STYLED = ("STYLED_ITEM", "OVER_RIDING_STYLED_ITEM")
_LISTS = re.compile(
    r"CC_DESIGN_|APPLIED_.*_ASSIGNMENT|PRODUCT_RELATED_PRODUCT_CATEGORY|PRESENTATION_LAYER_ASSIGNMENT"
    r"|MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION|DRAUGHTING_MODEL|INVISIBILITY"
)
"""Records that list what they hold for: a copy is listed behind what it is a copy of."""


class CannotSeparateError(Exception):
    """Why a placement cannot get a product of its own."""


def separate(records: StepRecords, path: Path) -> StepRecords:
    """The records with a product of its own at the end of a path, and at every placement on the way that is not the only
    one. Raises CannotSeparateError."""
    path = tuple(path)
    for level in range(len(path)):
        assembly = Assembly(records)
        _, product = assembly.occurrences[path[level]]
        uses = [n for n, (_, child) in assembly.occurrences.items() if child == product]
        if len(uses) == 1:
            continue
        copies = _copy(records, product)
        _redirect(records, path[level], product, copies)
        path = (*path[: level + 1], *(copies.get(number, number) for number in path[level + 1 :]))
        records = StepRecords.of(records.text())
    return records


def _copy(records: StepRecords, product: int) -> dict[int, int]:
    """Copy a product with all that is its own. Returns the copies' numbers."""
    own = _owned(records, product)
    order = sorted(own)
    numbers = dict(zip(order, range(records.next_number, records.next_number + len(order)), strict=True))
    for number in order:
        body = renumbered(records.body(number), numbers)
        if records.type(number) == "PRODUCT":
            body = re.sub(rb"'((?:[^']|'')*)'", rb"'\1 sculpted'", body, count=1)  # its id must be its own
        if records.type(number) == PLACED:
            body = re.sub(rb"'((?:[^']|'')*)'", rb"'\1 sculpted'", body, count=1)
        records.add(body)
    _list_copies(records, numbers)
    return numbers


def _owned(records: StepRecords, product: int) -> set[int]:
    """What belongs to a product alone: itself, its shape, the placements in it, its properties and styles."""

    def elsewhere(number: int) -> bool:
        return records.is_a(number, REPRESENTATION_CONTEXT)

    own = {product}
    for formation in records.references(product):
        if records.type(formation).startswith("PRODUCT_DEFINITION_FORMATION"):
            own.add(formation)
            own |= {n for n in records.references(formation) if records.type(n) == "PRODUCT"}
    placements = {n for n in records.of_type(PLACED) if product in records.references(n)[:1]}
    own |= placements
    shapes = {
        n for p in (product, *placements) for n in records.users(p) if records.type(n) == "PRODUCT_DEFINITION_SHAPE"
    }
    own |= shapes
    whole = {n for n in shapes if product in records.references(n)}
    representations: set[int] = set()
    for shape in whole:
        for user in records.users(shape):
            if records.type(user) == "SHAPE_DEFINITION_REPRESENTATION":
                own.add(user)
                representations.update(records.references(user)[1:2])
    for representation in set(representations):
        for user in records.users(representation):
            if records.type(user) == "SHAPE_REPRESENTATION_RELATIONSHIP":
                own.add(user)
                representations.update(n for n in records.references(user))
            if records.type(user) == "REPRESENTATION_MAP":
                raise CannotSeparateError("the assembly is written with mapped items")
    geometry = records.below(representations, elsewhere)
    own |= {n for n in geometry if not elsewhere(n)}
    for shape in shapes - whole:  # where the placements in it are
        for user in records.users(shape):
            if records.type(user) == "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION":
                own.add(user)
                relation = records.references(user)[0]
                own.add(relation)
                own |= {n for n in records.references(relation) if records.type(n) == "ITEM_DEFINED_TRANSFORMATION"}
    own |= _attached(records, own, whole | {product})
    return {n for n in own if n in records}


def _attached(records: StepRecords, own: set[int], whole: set[int]) -> set[int]:
    """Properties of the product and styles of its items."""
    found: set[int] = set()
    aspects = {n for w in whole for n in records.users(w) if records.type(n) == "SHAPE_ASPECT"}
    found |= aspects
    for holder in whole | aspects:
        for definition in records.users(holder):
            if records.type(definition) != "PROPERTY_DEFINITION":
                continue
            found.add(definition)
            for link in records.users(definition):
                if records.type(link) in ("PROPERTY_DEFINITION_REPRESENTATION", "SHAPE_DEFINITION_REPRESENTATION"):
                    found.add(link)
                    for representation in records.references(link)[1:]:
                        found |= {
                            n
                            for n in records.below([representation], lambda k: records.is_a(k, REPRESENTATION_CONTEXT))
                            if not records.is_a(n, REPRESENTATION_CONTEXT) and b"UNIT" not in records.body(n)[:60]
                        }
    for item in list(own):
        found |= {n for n in records.users(item) if records.type(n) in _STYLED and item in records.references(n)[-2:]}
    return found


def _list_copies(records: StepRecords, numbers: dict[int, int]) -> None:
    """Name the copies wherever the originals are listed: layers, styles, categories, approvals."""
    holders = {user for number in numbers for user in records.users(number)} - numbers.keys()
    for holder in sorted(holders):
        if not _LISTS.match(records.type(holder)):
            continue
        body = re.sub(
            rb"'(?:[^']|'')*'|#\s*(\d+)",
            lambda m: m[0] + (b",#%d" % numbers[int(m[1])] if m[1] and int(m[1]) in numbers else b""),
            records.body(holder),
        )
        records.change(holder, body)


def _redirect(records: StepRecords, occurrence: int, product: int, copies: dict[int, int]) -> None:
    """Let an occurrence place the copy of a product."""
    records.change(occurrence, renumbered(records.body(occurrence), {product: copies[product]}))
    shapes = [n for n in records.users(occurrence) if records.type(n) == "PRODUCT_DEFINITION_SHAPE"]
    placements = [
        n for shape in shapes for n in records.users(shape)
        if records.type(n) == "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION"
    ]  # fmt: skip
    if not placements:
        raise CannotSeparateError(f"the placement #{occurrence} has no CONTEXT_DEPENDENT_SHAPE_REPRESENTATION")
    for placement in placements:
        relation = records.references(placement)[0]
        moved = dict(copies)
        for number in records.references(relation):
            if records.type(number) == "ITEM_DEFINED_TRANSFORMATION":
                moved[number] = records.add(renumbered(records.body(number), copies))
        new = records.add(renumbered(records.body(relation), moved))
        records.change(placement, renumbered(records.body(placement), {relation: new}))
