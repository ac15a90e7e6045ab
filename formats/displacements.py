"""Displacement fields in files: points and how far they move, as a run writes them and as morphing tools take them.

    X,Y,Z,DX,DY,DZ
    12.5,0,3.25,0,0,-0.125

One point a line, in any order; commas, semicolons, tabs or blanks between the numbers; the first line may name the columns,
and then others may stand beside them. Lengths are in a unit that the file does not name.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ..errors import InputError, SceneError
from ..units import conversion
from .contacts_csv import DISPLACEMENT_COLUMNS
from .cut_off import unended
from .paths.path_text import text_of_file

Array = NDArray[np.float64]

LISTED_FAULTS = 10
"""Faults of one file that are told."""

NEIGHBOURS = 40
"""Points that the displacement of a place is interpolated from."""

SAME_PLACE = 1e-9
"""Of the size of all points: nearer ones are one point, which cannot move in two ways."""

AGREEING = 0.02
"""Of the largest displacement: one place has several that differ by no more where faces meet whose nodes a run ties by
interpolation, or not at all, as at a corner."""

REACH = 4.0
"""How far from the points something moves, in spacings, where nobody says it: scattered points leave holes two wide."""

AROUND = 6
"""Neighbours of a point whose distance tells the spacing, scattered or in a grid."""


@dataclass(frozen=True, slots=True, eq=False)
class DisplacementField:
    """points (n, 3) and their displacements (n, 3), in mm; spacing : of a grid with as many points.

    reach : places farther from every point stay where they are; from half of it on displacements fade.
    warnings : what its file gave to say.
    """

    points: Array
    moves: Array
    spacing: float
    reach: float
    warnings: tuple[str, ...] = ()

    def scaled(self, factor: float) -> DisplacementField:
        """All lengths times `factor`."""
        return replace(
            self,
            points=self.points * factor,
            moves=self.moves * factor,
            spacing=self.spacing * factor,
            reach=self.reach * factor,
        )

    def at(self, places: Array) -> Array:
        """Displacements (m, 3) of places (m, 3).

        At the points themselves what the file says, between them interpolated by radial basis functions; outside it fades.
        """
        moving = np.linalg.norm(self.moves, axis=1) > 0.0
        out = np.zeros_like(places)
        if not moving.any():
            return out
        tree = KDTree(self.points)
        distance, nearest = tree.query(places)
        close = distance < self.reach
        out[distance == 0.0] = self.moves[nearest[distance == 0.0]]
        # where nothing around moves nothing is interpolated
        around = KDTree(self.points[moving]).query(places)[0] < self.reach + 6.0 * self.spacing
        wanted = close & around & (distance > 0.0)
        if wanted.any():
            count = min(NEIGHBOURS, len(self.points))
            smooth = RBFInterpolator(self.points, self.moves, neighbors=count, kernel="linear")
            fade = np.clip(2.0 * distance[wanted] / self.reach - 1.0, 0.0, 1.0)
            out[wanted] = smooth(places[wanted]) * (1.0 - fade**2 * (3.0 - 2.0 * fade))[:, None]
        return out


def read(path: str | os.PathLike[str], units: str = "mm", *, reach: float | None = None) -> DisplacementField:
    """Read a displacement field. units : of the file's numbers. reach : in mm; REACH spacings when left out.

    Raises InputError for a file that cannot be read or holds no points, SceneError with a line for every faulty one.
    """
    path = Path(path)
    rows, faults = [], []
    columns: list[int] | None = None
    text = text_of_file(path)
    for number, words in _lines(text):
        if columns is None and any(_real(word) is None for word in words):
            columns = _columns(words, f"{path}:{number}")
            continue
        columns = columns or list(range(6))
        values = [_real(words[k]) if k < len(words) else None for k in columns]
        if len(columns) == 6 == max(columns) + 1 and len(words) != 6:
            faults.append(f"{path}:{number}: has {len(words)} numbers, not X,Y,Z,DX,DY,DZ")
        elif any(value is None for value in values):
            faults.append(f"{path}:{number}: {_bad(words, columns)} is not a finite number")
        else:
            rows.append(values)
    if faults:
        more = len(faults) - LISTED_FAULTS
        raise SceneError(faults[:LISTED_FAULTS] + ([f"{path}: and {more} faults more"] if more > 0 else []))
    if not rows:
        raise InputError("it holds no points", where=str(path), mend="one line of X,Y,Z,DX,DY,DZ a point")
    numbers = np.array(rows, dtype=np.float64) * conversion(units, "mm")
    field = field_of(numbers[:, :3], numbers[:, 3:], where=str(path), reach=reach)
    return replace(field, warnings=unended(text))


def field_of(points: Array, moves: Array, *, where: str = "", reach: float | None = None) -> DisplacementField:
    """The field of points (n, 3) and displacements (n, 3) in mm, each place once: with the mean where it has several.

    Raises InputError when a place moves in two ways.
    """
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    tree = KDTree(points)
    pairs = tree.query_pairs(SAME_PLACE * max(size, 1e-300), output_type="ndarray")
    if len(pairs):
        apart = np.linalg.norm(moves[pairs[:, 0]] - moves[pairs[:, 1]], axis=1)
        worst = int(apart.argmax())
        if apart[worst] > AGREEING * max(float(np.abs(moves).max()), 1e-300):
            x, y, z = points[pairs[worst, 0]].tolist()
            raise InputError(
                f"the point ({x:g}, {y:g}, {z:g}) mm moves in two ways", where=where, mend="keep one of them"
            )
        links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
        place = connected_components(links, directed=False)[1]
        _, first = np.unique(place, return_index=True)
        count = np.bincount(place)[:, None]
        points = points[first]
        moves = np.stack([np.bincount(place, moves[:, k]) for k in range(3)], axis=1) / count
        order = np.argsort(first)  # as in the file
        points, moves = points[order], moves[order]
        tree = KDTree(points)
    around = min(AROUND, len(points) - 1)
    spacing = 0.0
    if around:
        spacing = float(np.median(tree.query(points, k=[around + 1])[0])) * math.sqrt(math.pi / max(around, 4))
    if reach is None:
        reach = REACH * spacing
    if not reach > 0.0:
        raise InputError(
            "one point alone does not say how far its displacement reaches", where=where, mend="give a reach"
        )
    return DisplacementField(points, moves, spacing or 0.5 * reach, reach)


def _lines(text: str) -> Iterator[tuple[int, list[str]]]:
    """Number and words of every line that is neither empty nor a comment."""
    for number, line in enumerate(text.splitlines(), 1):
        line = line.split("#", 1)[0].strip()
        if line:
            words = re.split("[,;\t]", line) if re.search("[,;\t]", line) else line.split()
            yield number, [word.strip().strip('"') for word in words]


def _columns(words: list[str], where: str) -> list[int]:
    """Places of the six columns among the names of the first line. Raises InputError naming those that are missing."""
    names = [word.upper() for word in words]
    missing = [name for name in DISPLACEMENT_COLUMNS if name not in names]
    if missing:
        raise InputError(
            f"{', '.join(words)[:60]} are neither six numbers nor the names of columns", where=where,
            mend=f"name {', '.join(missing)} as well, or leave the names out",
        )  # fmt: skip
    return [names.index(name) for name in DISPLACEMENT_COLUMNS]


def _real(word: str) -> float | None:
    try:
        value = float(word) if "_" not in word else math.nan
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _bad(words: list[str], columns: list[int]) -> str:
    """The first of a line's words that should be a number and is none."""
    for k in columns:
        if k >= len(words):
            return "a number that is missing"
        if _real(words[k]) is None:
            return repr(words[k][:30])
    return ""
