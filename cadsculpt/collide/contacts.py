"""Contacts between bodies: a structure of arrays in a fixed order.

Conventions (everywhere in cadsculpt): contacts are listed (a, b) in the scene's order; a is the model, b the tool;
the normal points out of a's material; depth is positive when b is inside a; forces are those on a.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

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
