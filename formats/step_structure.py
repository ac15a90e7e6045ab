"""The product structure of a STEP file's records: which shape is whose, and which product is placed where."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .step_records import StepRecords
from .step_units import REPRESENTATION_CONTEXT, coordinates, millimetres_at

Array = NDArray[np.float64]

PLACED = "NEXT_ASSEMBLY_USAGE_OCCURRENCE"

Path = tuple[int, ...]
"""The occurrences that lead from a root of the assembly to a product."""


def shape_items(records: StepRecords, target: int) -> frozenset[int]:
    """All geometric records of the shape that a property is of: a product's, or that of one of its aspects."""
    linked = shape_representations(records, target)
    return frozenset(records.below(linked, lambda n: records.is_a(n, REPRESENTATION_CONTEXT)))


def shape_representations(records: StepRecords, target: int) -> set[int]:
    """The representations of the shape of a product definition, its shape, or an aspect of it."""
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
    return linked


@dataclass(eq=False)
class Assembly:
    """The product structure of a file: product definitions, by NEXT_ASSEMBLY_USAGE_OCCURRENCE placed in one another."""

    records: StepRecords

    @cached_property
    def occurrences(self) -> dict[int, tuple[int, int]]:
        """Occurrence: (the product definition that it is in, the one that it places)."""
        found = {}
        for number in self.records.of_type(PLACED):
            ends = [r for r in self.records.references(number) if self.records.type(r).startswith("PRODUCT_DEFINITION")]
            if len(ends) >= 2:
                found[number] = ends[0], ends[1]
        return found

    @cached_property
    def paths(self) -> dict[int, list[Path]]:
        """All ways to every product definition, in the order of the assembly."""
        children: dict[int, list[int]] = {}
        for number, (parent, _) in self.occurrences.items():
            children.setdefault(parent, []).append(number)
        found: dict[int, list[Path]] = {}

        def walk(product: int, path: Path) -> None:
            found.setdefault(product, []).append(path)
            for number in children.get(product, ()):
                if number not in path:
                    walk(self.occurrences[number][1], (*path, number))

        placed = {child for _, child in self.occurrences.values()}
        for product in self.records.of_type("PRODUCT_DEFINITION", "PRODUCT_DEFINITION_WITH_ASSOCIATED_DOCUMENTS"):
            if product not in placed:
                walk(product, ())
        return found

    def below(self, product: int) -> Iterator[tuple[int, Array]]:
        """A product and all products placed in it, each with the matrix (4, 4), in mm, from its frame to that of the first."""
        yield product, np.eye(4)
        for number, (parent, child) in self.occurrences.items():
            if parent == product:
                placed = self.matrix(number)
                for inner, matrix in self.below(child):
                    yield inner, placed @ matrix

    def matrix(self, occurrence: int) -> Array:
        """(4, 4), in mm: from the frame of the placed product to that of the one it is in; the identity where the file does
        not say."""
        own = self.representations.get(self.occurrences[occurrence][1], frozenset())
        for shape in self.records.users(occurrence):
            for placement in self.records.users(shape):
                if self.records.type(placement) != "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION":
                    continue
                relation = self.records.references(placement)[0]
                ends = self.records.references(relation)
                for number in ends:
                    if self.records.type(number) == "ITEM_DEFINED_TRANSFORMATION":
                        first, second = (_frame(self.records, n) for n in self.records.references(number)[:2])
                        forward = ends[0] in own
                        return second @ _inverse(first) if forward else first @ _inverse(second)
        return np.eye(4)

    @cached_property
    def representations(self) -> dict[int, frozenset[int]]:
        """The shape representations of every product definition, those that they are related to included."""
        return {product: frozenset(shape_representations(self.records, product)) for product in self.paths}

    def name(self, product: int) -> str:
        """The name of a product definition's product, its id where it has none."""
        for formation in self.records.references(product):
            for below in self.records.references(formation):
                if self.records.type(below) == "PRODUCT":
                    texts = [a.strip(b"'").decode("latin-1") for a in self.records.arguments(below)[:2]]
                    return next((text for text in reversed(texts) if text.strip() and text != "$"), "part")
        return "part"

    def items(self, product: int) -> frozenset[int]:
        """The geometric records of a product's own shape."""
        if product not in self._items:
            self._items[product] = shape_items(self.records, product)
        return self._items[product]

    @cached_property
    def _items(self) -> dict[int, frozenset[int]]:
        return {}

    @cached_property
    def of_item(self) -> dict[int, int]:
        """The product definition that each geometric record belongs to."""
        return {item: product for product in self.paths for item in self.items(product)}


@dataclass(frozen=True, slots=True)
class Placement:
    """A product with a shape of its own, in one place: its name, followed by a number where it has several places."""

    name: str
    product: int
    path: Path


def placements(assembly: Assembly, with_shape: set[int]) -> list[Placement]:
    """Where the products with a shape are placed, those of one name counted in the order of the assembly."""
    every = sorted(
        ((path, product) for product, paths in assembly.paths.items() if product in with_shape for path in paths),
        key=lambda item: _order(assembly, item[0]),
    )
    names = [assembly.name(product) for _, product in every]
    seen: dict[str, int] = {}
    found = []
    for (path, product), name in zip(every, names, strict=True):
        seen[name] = seen.get(name, 0) + 1
        found.append(Placement(f"{name}_{seen[name]}" if names.count(name) > 1 else name, product, path))
    return found


def _order(assembly: Assembly, path: Path) -> tuple[int, ...]:
    """Where its occurrences stand in the file: paths in this order are those of a walk through the assembly."""
    places = {number: place for place, number in enumerate(assembly.occurrences)}
    return tuple(places[number] for number in path)


def _frame(records: StepRecords, number: int) -> Array:
    """(4, 4), in mm, of an AXIS2_PLACEMENT_3D: its axes as columns, made perpendicular as the standard says."""
    point, *directions = records.references(number)
    made = np.eye(4)
    made[:3, 3] = np.array(coordinates(records, point)) * (millimetres_at(records, number) or 1.0)
    arguments = records.arguments(number)
    given = [argument.startswith(b"#") for argument in arguments[2:4]]
    rest = [np.array(coordinates(records, n)) for n in directions]
    z = rest.pop(0) if given[:1] == [True] else np.array([0.0, 0, 1])
    z = z / np.linalg.norm(z)
    x = rest.pop(0) if given[1:2] == [True] else np.array([1.0, 0, 0])
    x = x - (x @ z) * z
    if np.linalg.norm(x) < 1e-12:
        x = np.array([0.0, 1, 0]) - z[1] * z
    x = x / np.linalg.norm(x)
    made[:3, 0], made[:3, 1], made[:3, 2] = x, np.cross(z, x), z
    return made


def _inverse(frame: Array) -> Array:
    made = np.eye(4)
    made[:3, :3] = frame[:3, :3].T
    made[:3, 3] = -frame[:3, :3].T @ frame[:3, 3]
    return made


def name_single_faces(records: StepRecords) -> None:
    """Give the only face of a product the product's name where it has none: that of a loose face would get lost."""
    assembly = Assembly(records)
    own: dict[int, list[int]] = {}
    for item, product in assembly.of_item.items():
        if records.type(item) == "ADVANCED_FACE":
            own.setdefault(product, []).append(item)
    for product, faces in own.items():
        arguments = records.arguments(faces[0])
        if len(faces) == 1 and arguments[0] == b"''":
            arguments[0] = b"'%s'" % assembly.name(product).encode("latin-1")
            records.change(faces[0], b"ADVANCED_FACE(%s)" % b",".join(arguments))
