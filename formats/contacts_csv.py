"""The tables of a run: contacts.csv, forces.csv and displacements.csv, written and read.

Numbers are written by `repr`: the shortest text that reads back to the same bits. Lines end in a newline on every
system, so that two runs give the same bytes. Names that hold a comma or a quote are quoted as CSV does it.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..record import ContactRecord, StepRecord
from .atomic import WholeFile

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CONTACT_COLUMNS = [
    "step", "time", "a", "b", "face", "u", "v", "x", "y", "z", "nx", "ny", "nz", "depth", "area", "fx", "fy", "fz",
]  # fmt: skip
FORCE_COLUMNS = [
    "step", "time", "tool", "fx", "fy", "fz", "tx", "ty", "tz", "contact_area", "max_depth", "max_penetration",
]  # fmt: skip
DISPLACEMENT_COLUMNS = ["X", "Y", "Z", "DX", "DY", "DZ"]


class _Table:
    """A CSV file that grows row by row and appears under its name when it is closed without an exception."""

    def __init__(self, path: str | os.PathLike[str], columns: Sequence[str]) -> None:
        self._file = WholeFile(path)
        self._rows([columns])

    def _rows(self, rows: Iterable[Sequence[Any]]) -> None:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        self._file.write(text.getvalue())

    def close(self) -> None:
        """Give the file its name."""
        self._file.commit()

    def abandon(self) -> None:
        """Leave nothing of the file."""
        self._file.abandon()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()


class ContactsWriter(_Table):
    """contacts.csv, appended to step by step.

    bodies, faces : the names that the numbers Contacts.a and .b, and .face stand for.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        bodies: Sequence[str],
        faces: Sequence[str],
    ) -> None:
        self._bodies = tuple(bodies)
        self._faces = tuple(faces)
        super().__init__(path, CONTACT_COLUMNS)

    def add(self, record: ContactRecord) -> None:
        """Append the contacts of a step, in their order. Raises InputError when the system refuses."""
        contacts = record.contacts
        names = (
            [self._bodies[body] for body in contacts.a.tolist()],
            [self._bodies[body] for body in contacts.b.tolist()],
            [self._faces[face] for face in contacts.face.tolist()],
        )
        numbers = np.column_stack(
            [contacts.u, contacts.v, contacts.point, contacts.normal, contacts.depth, contacts.area, record.force]
        ).tolist()
        when = (record.step, record.time)
        self._rows((*when, *of, *values) for *of, values in zip(*names, numbers, strict=True))


class ForcesWriter(_Table):
    """forces.csv, appended to step by step: one line a tool, the reaction on it in N and N m."""

    def __init__(self, path: str | os.PathLike[str], tools: Sequence[str]) -> None:
        self._tools = tuple(tools)
        super().__init__(path, FORCE_COLUMNS)

    def add(self, record: StepRecord) -> None:
        """Append a step. Raises InputError when the system refuses."""
        numbers = np.column_stack(
            [record.force, record.torque, record.contact_area, record.max_depth, record.max_penetration]
        ).tolist()
        when = (record.step, record.time)
        self._rows((*when, tool, *values) for tool, values in zip(self._tools, numbers, strict=True))


def write_displacements(path: str | os.PathLike[str], points: Array, displacements: Array) -> None:
    """Write displacements.csv: a line a node, where it was at rest and how far it moved; both (n, 3)."""
    table = _Table(path, DISPLACEMENT_COLUMNS)
    with table:
        table._rows(np.hstack([np.reshape(points, (-1, 3)), np.reshape(displacements, (-1, 3))]).tolist())


@dataclass(frozen=True, slots=True, eq=False)
class ContactTable:
    """contacts.csv read back: n rows; names are objects of str, vectors (n, 3)."""

    step: Index
    time: Array
    a: NDArray[np.object_]
    b: NDArray[np.object_]
    face: NDArray[np.object_]
    u: Array
    v: Array
    point: Array
    normal: Array
    depth: Array
    area: Array
    force: Array


@dataclass(frozen=True, slots=True, eq=False)
class ForceTable:
    """forces.csv read back: a row a step and tool; vectors (n, 3)."""

    step: Index
    time: Array
    tool: NDArray[np.object_]
    force: Array
    torque: Array
    contact_area: Array
    max_depth: Array
    max_penetration: Array

    @property
    def tools(self) -> tuple[str, ...]:
        """The tools, in the order of their first row."""
        return tuple(dict.fromkeys(self.tool.tolist()))


def read_contacts(path: str | os.PathLike[str]) -> ContactTable:
    """Read contacts.csv. Raises InputError naming the line when it is not such a table."""
    names, x = _read(path, CONTACT_COLUMNS, text=("a", "b", "face"))
    a, b, face = names
    return ContactTable(
        x[:, 0].astype(np.int64), x[:, 1], a, b, face, x[:, 2], x[:, 3], x[:, 4:7], x[:, 7:10], x[:, 10], x[:, 11],
        x[:, 12:15],
    )  # fmt: skip


def read_forces(path: str | os.PathLike[str]) -> ForceTable:
    """Read forces.csv. Raises InputError naming the line when it is not such a table."""
    (tool,), x = _read(path, FORCE_COLUMNS, text=("tool",))
    return ForceTable(x[:, 0].astype(np.int64), x[:, 1], tool, x[:, 2:5], x[:, 5:8], x[:, 8], x[:, 9], x[:, 10])


def read_displacements(path: str | os.PathLike[str]) -> tuple[Array, Array]:
    """Points (n, 3) and displacements (n, 3) of displacements.csv. Raises InputError when it is not such a table."""
    _, x = _read(path, DISPLACEMENT_COLUMNS, text=())
    return x[:, :3], x[:, 3:]


def _read(
    path: str | os.PathLike[str], columns: Sequence[str], text: Sequence[str]
) -> tuple[list[NDArray[np.object_]], Array]:
    """The text columns, and all others as numbers (n, ...), in the order of the file."""
    path = Path(path)
    at = [columns.index(name) for name in text]
    numeric = [n for n in range(len(columns)) if n not in at]
    names: list[list[str]] = [[] for _ in at]
    numbers: list[list[float]] = []
    try:
        with open(path, encoding="utf-8", newline="") as file:
            reader = csv.reader(file)
            if next(reader, None) != list(columns):
                raise InputError(f"the first line is not {','.join(columns)}", where=str(path))
            for row in reader:
                try:
                    if len(row) != len(columns):
                        raise ValueError(f"{len(row)} values, {len(columns)} expected")
                    numbers.append([float(row[n]) for n in numeric])
                except ValueError as error:
                    raise InputError(str(error), where=f"{path}, line {reader.line_num}") from error
                for column, n in zip(names, at, strict=True):
                    column.append(row[n])
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", where=str(path)) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"not a CSV table: {error}", where=str(path)) from error
    return [np.array(column, object) for column in names], np.array(numbers, np.float64).reshape(-1, len(numeric))
