"""What a CAD file is to the rest of cadsculpt: a `Part` with numbered faces, that takes sculpted surfaces back.

Every reader returns a `Part`; the registry decides which. Lengths of a part are always mm, whatever the file's unit
(`Part.units` names it), because that is what `inspect` promises; parameters (u, v) and knots are the file's own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..spline.surface import BSplineSurface

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FaceEdge:
    """One edge of a face, sampled along its trim curve.

    uv (n, 2) parameters on the face's surface, points (n, 3) in mm at the same places; `neighbours` are the numbers of the
    other faces that share the edge (empty for a free edge). A seam is the edge where a closed surface meets itself; a
    degenerate edge is a pole, one point in space. `tolerance` : how far apart the file lets its faces be there, mm; 0 when it
    does not say.
    """

    uv: Array
    points: Array
    neighbours: tuple[int, ...] = ()
    seam: bool = False
    degenerate: bool = False
    tolerance: float = 0.0


class Face(ABC):
    """One face of a part. `number` counts from 1 in the part's order; `name` is unique in the part."""

    number: int
    name: str
    kind: str
    """bspline, bezier, plane, cylinder, cone, sphere, torus, revolution, extrusion, offset or other."""
    trimmed: bool
    """False when the face is its surface's whole domain."""
    warning: str = ""
    """Why the surface is not available, when it is not."""

    @property
    @abstractmethod
    def surface(self) -> BSplineSurface:
        """The face's surface in mm, trims and orientation set. Analytic kinds are converted to an equal B-spline."""

    @property
    @abstractmethod
    def area(self) -> float:
        """Area of the trimmed face, mm2."""

    @property
    @abstractmethod
    def bbox(self) -> tuple[float, float, float, float, float, float]:
        """xmin, ymin, zmin, xmax, ymax, zmax of the trimmed face, mm."""

    @property
    @abstractmethod
    def edges(self) -> Sequence[FaceEdge]:
        """The face's edges, all loops."""


@dataclass(frozen=True, slots=True)
class Instance:
    """A component of an assembly in one of its places. faces : the numbers of its faces; labels : what they are called
    within the component, in the same order."""

    name: str
    component: str
    faces: tuple[int, ...]
    labels: tuple[str, ...]


class Faces(Sequence[Face]):
    """The faces of a part: by position (`faces[0]`), by name (`faces["top"]`) or by number (`faces.number(1)`).

    A face of an assembly has a second name, that of its instance and that within the component (`faces["bolt_2/head"]`).
    """

    def __init__(
        self, faces: Sequence[Face], where: str, instances: Callable[[], Sequence[Instance]] = lambda: ()
    ) -> None:
        self._faces = tuple(faces)
        self._where = where
        self._instances = instances
        self._by_name = {face.name: face for face in self._faces}

    def __len__(self) -> int:
        return len(self._faces)

    def __iter__(self) -> Iterator[Face]:
        return iter(self._faces)

    def __getitem__(self, key: int | slice | str) -> Face:  # type: ignore[override]
        if isinstance(key, str):
            return self.named(key)
        return self._faces[key]  # type: ignore[return-value]

    def named(self, name: str) -> Face:
        """The face of that name. Raises InputError with the nearest names when there is none."""
        if name in self._by_name:
            return self._by_name[name]
        if "/" in name:
            for instance in self._instances():
                for label, number in zip(instance.labels, instance.faces, strict=True):
                    if name == f"{instance.name}/{label}":
                        return self._faces[number - 1]
        close = get_close_matches(name, self._by_name, n=3, cutoff=0.5)
        known = ", ".join(list(self._by_name)[:6]) + (", ..." if len(self._by_name) > 6 else "")
        mend = (
            f"did you mean {' or '.join(close)}?"
            if close
            else f"its {len(self)} faces are {known}"
            if len(self)
            else ""
        )
        raise InputError(f"no face named {name!r}", where=self._where, mend=mend or "the part has no faces")

    def number(self, number: int) -> Face:
        """The face of that number, counted from 1. Raises InputError when there is none."""
        if not 1 <= number <= len(self._faces):
            raise InputError(f"no face number {number}", where=self._where, mend=f"it has faces 1 to {len(self)}")
        return self._faces[number - 1]

    def select(self, which: str | Sequence[str | int]) -> list[Face]:
        """The faces a scene names: "all", or a list of names and numbers; each once, in the part's order."""
        if isinstance(which, str):
            return list(self._faces) if which == "all" else [self.named(which)]
        chosen = {(self.number(w) if isinstance(w, int) else self.named(w)).number for w in which}
        return [face for face in self._faces if face.number in chosen]


@dataclass(frozen=True, slots=True)
class Validity:
    """The verdict of the CAD kernel's own checker on a part."""

    valid: bool
    faults: tuple[str, ...] = field(default=())


class Part(ABC):
    """A CAD file in memory."""

    path: Path
    format: str
    """step, iges, 3dm, json, geomdl, g2 or gismo."""
    units: str
    """The length unit of the file ("mm", "in", ...), "" when the file has none."""
    faces: Faces
    warnings: list[str]

    @property
    def instances(self) -> Sequence[Instance]:
        """The components of an assembly, each place by itself, in the order of their faces; empty for a single part."""
        return ()

    def separated(self, instances: Sequence[str]) -> Part:
        """The part with a shape of its own for each of these instances, so that sculpting them changes no other place.

        Faces keep their numbers. Raises InputError for a name that no instance has, or where it cannot be done.
        """
        raise InputError("the part has no instances", where=str(self.path), mend="leave instances out")

    def twins(self, number: int) -> tuple[int, ...]:
        """The numbers of the other faces that are this one in another place: they can only change alike."""
        return ()

    @cached_property
    def extent(self) -> float:
        """Longest side of a box around the part as read, mm, about right: from the control points. 0 without surfaces."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for face in self.faces:
            if not face.warning:
                points = face.surface.control_points.reshape(-1, 3)
                low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
        return float((high - low).max()) if np.isfinite(low).all() else 0.0

    @property
    def tolerance(self) -> float | None:
        """The distance, mm, below which the file takes two points for one; None when it does not say."""
        return None

    def tolerance_of(self, number: int) -> float | None:
        """The same of the face with that number alone, as its part of the file says, sense or not."""
        return self.tolerance

    @property
    def recorded_area(self) -> tuple[float, float] | None:
        """The area of the part's geometry and the one that the file records beside it, mm2; None when it records none."""
        return None

    @abstractmethod
    def sculpt(self, surfaces: Mapping[int, BSplineSurface]) -> None:
        """Put sculpted surfaces (mm) in the place of those of the faces with these numbers.

        Each surface has the degrees and trims of `faces.number(n).surface`, a knot vector that contains that surface's
        knots, and a shape that differs from it by the control points. All other faces stay exactly as they are; edges and
        vertices of the sculpted faces follow, tolerances are raised only where they must be.
        """

    @abstractmethod
    def validity(self) -> Validity:
        """What the CAD kernel's checker says of the part as it is now."""

    @abstractmethod
    def write(self, path: Path, format: str) -> None:
        """Write the whole part as `format` (step, iges, 3dm, json), whole or not at all, byte-stable.

        Raises InputError naming the reason when the format cannot hold the part or the disk is full.
        """
