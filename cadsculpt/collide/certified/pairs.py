"""Where two bodies meet, on the true surfaces: a structure of arrays in a fixed order."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePairs:
    """n pairs of points of two bodies, sorted by (face_a, u_a, v_a, face_b, u_b, v_b, point).

    face_a, face_b (n,) : patches, -1 where the body has none; u_a, v_a, u_b, v_b (n,) : parameters on them, NaN there.
    point, other (n, 3) : the points of a and of b. normal (n, 3) : unit, out of a's material. depth (n,) : positive
    where b is inside a; minus the distance where they are apart; 0 on the curves in which they cross.
    """

    face_a: Index
    u_a: Array
    v_a: Array
    face_b: Index
    u_b: Array
    v_b: Array
    point: Array
    other: Array
    normal: Array
    depth: Array

    def __len__(self) -> int:
        return len(self.face_a)

    @classmethod
    def none(cls) -> SurfacePairs:
        """No pair."""
        i, x, p = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3))
        return cls(i, x, x, i, x, x, p, p, p, x)

    @classmethod
    def joined(cls, parts: list[SurfacePairs]) -> SurfacePairs:
        """All pairs of several sets, one after the other."""
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))

    def ordered(self) -> SurfacePairs:
        """The same pairs in the fixed order."""
        keys: list[Array | Index] = [self.point[:, 2], self.point[:, 1], self.point[:, 0]]
        keys += [self.v_b, self.u_b, self.face_b, self.v_a, self.u_a, self.face_a]
        return self.chosen(np.lexsort(keys))

    def chosen(self, which: Index) -> SurfacePairs:
        """Some of the pairs."""
        return SurfacePairs(*(np.ascontiguousarray(getattr(self, f.name)[which]) for f in fields(self)))

    def swapped(self, normal: Array) -> SurfacePairs:
        """The same pairs seen from b, with b's normals (n, 3); in b's order."""
        return SurfacePairs(
            self.face_b, self.u_b, self.v_b, self.face_a, self.u_a, self.v_a, self.other, self.point, normal, self.depth
        ).ordered()

    def apart(self, gap: float) -> SurfacePairs:
        """Without pairs nearer than `gap` to one that comes before: those of neighbouring triangles, of both sides of a
        seam, of all that meets in a pole."""
        if len(self) < 2:
            return self
        from scipy.spatial import cKDTree

        near = cKDTree(self.point).query_pairs(gap, output_type="ndarray")
        gone = np.zeros(len(self), dtype=np.bool_)
        near = near[np.lexsort((near[:, 1], near[:, 0]))]
        for i, j in near.tolist():
            if not gone[i]:
                gone[j] = True
        return self.chosen(np.flatnonzero(~gone))
