"""Contacts between bodies: a structure of arrays in a fixed order.

Conventions (everywhere in cadsculpt): contacts are listed (a, b) in the scene's order; a is the model, b the tool;
the normal points out of a's material; depth is positive when b is inside a; forces are those on a.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..jit import njit_in_place

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


KEYS = ("v", "u", "face", "b", "a")
"""What contacts are sorted by, the last first."""


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """n points where two bodies touch or overlap, sorted by (a, b, face, u, v).

    a, b (n,) : indices of the bodies. face (n,) : index of a's patch. u, v (n,) : parameters on that patch.
    point (n, 3) : the point on a's surface. normal (n, 3) : unit, out of a's material.
    depth (n,) : how deep `point` lies inside b, along the normal. area (n,) : the piece of a's surface that the contact
    stands for, so that forces do not depend on the resolution. tool_point (n, 3) : the nearest point on b's surface.
    tool_face (n,), tool_u, tool_v (n,) : b's patch and the parameters of tool_point on it; -1 and NaN where b has none.
    """

    a: Index
    b: Index
    face: Index
    u: Array
    v: Array
    point: Array
    normal: Array
    depth: Array
    area: Array
    tool_point: Array
    tool_face: Index
    tool_u: Array
    tool_v: Array

    def __len__(self) -> int:
        return len(self.a)

    @classmethod
    def none(cls) -> Contacts:
        """No contact."""
        i, x, p = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3))
        return cls(i, i, i, x, x, p, p, x, x, p, i, x, x)

    @property
    def columns(self) -> Columns:
        """The arrays as kernels take them."""
        return Columns(*(getattr(self, name) for name in Columns._fields))

    def copy(self) -> Contacts:
        """The same in arrays of their own."""
        return Contacts(*(getattr(self, f.name).copy() for f in fields(self)))

    def chosen(self, which: Index | Mask) -> Contacts:
        """Some of them: those of a mask (n,), or these rows."""
        return Contacts(*(getattr(self, f.name)[which] for f in fields(self)))

    def with_faces(self, faces: Index) -> Contacts:
        """The same with face k renamed faces[k]."""
        return replace(self, face=faces[self.face])

    @classmethod
    def joined(cls, parts: list[Contacts]) -> Contacts:
        """All contacts of several sets, in the fixed order."""
        parts = [part for part in parts if len(part)]
        if not parts:
            return cls.none()
        columns = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)}
        order = np.lexsort([columns[key] for key in KEYS])
        return cls(**{key: np.ascontiguousarray(value[order]) for key, value in columns.items()})


class Columns(NamedTuple):
    """Room for contacts, as kernels see it; the fields are those of `Contacts`."""

    a: Index
    b: Index
    face: Index
    u: Array
    v: Array
    point: Array
    normal: Array
    depth: Array
    area: Array
    tool_point: Array
    tool_face: Index
    tool_u: Array
    tool_v: Array


def _columns(room: int) -> Columns:
    """Room for so many contacts; memory that nothing is written to is not taken from the machine."""

    def whole() -> Index:
        return np.empty(room, dtype=np.int64)

    def row() -> Array:
        return np.empty(room)

    def rows() -> Array:
        return np.empty((room, 3))

    return Columns(
        whole(), whole(), whole(), row(), row(), rows(), rows(), row(), row(), rows(), whole(), row(), row()
    )  # fmt: skip


@dataclass(slots=True, eq=False)
class ContactBuffer:
    """Contacts one behind the other, in arrays that are kept from step to step and only grow."""

    columns: Columns = field(default_factory=lambda: _columns(0))
    count: int = 0

    def reserve(self, more: int) -> Columns:
        """The columns with room for so many more rows behind those that are there."""
        if self.count + more > len(self.columns.a):
            longer = _columns(2 * (self.count + more))
            for old, new in zip(self.columns, longer, strict=True):
                new[: self.count] = old[: self.count]
            self.columns = longer
        return self.columns

    def append(self, contacts: Contacts) -> None:
        """Put these behind those that are there."""
        count = len(contacts)
        for f, column in zip(fields(contacts), self.reserve(count), strict=True):
            column[self.count : self.count + count] = getattr(contacts, f.name)
        self.count += count

    def view(self, start: int = 0) -> Contacts:
        """The rows from `start` on: valid until the buffer is written to again."""
        return Contacts(*(column[start : self.count] for column in self.columns))  # type: ignore[arg-type]

    def sort(self, start: int = 0) -> None:
        """Bring the rows from `start` on into the fixed order; nothing where they are."""
        if not sorted_rows(self.columns, start, self.count):
            rows = self.view(start)
            ordered = rows.chosen(np.lexsort([getattr(rows, key) for key in KEYS]))
            self.count = start
            self.append(ordered)


@njit_in_place
def sorted_rows(rows: Columns, start: int, stop: int) -> bool:
    """The rows from start to stop are in the order (a, b, face, u, v)."""
    a, b, face, u, v = rows.a, rows.b, rows.face, rows.u, rows.v
    for t in range(start + 1, stop):
        if a[t] != a[t - 1]:
            before = a[t - 1] < a[t]
        elif b[t] != b[t - 1]:
            before = b[t - 1] < b[t]
        elif face[t] != face[t - 1]:
            before = face[t - 1] < face[t]
        elif u[t] != u[t - 1]:
            before = u[t - 1] < u[t]
        else:
            before = v[t - 1] <= v[t]
        if not before:
            return False
    return True
