"""The tables: exact round trips, fixed columns, and nothing half-written."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cadsculpt.collide.contacts import Contacts
from cadsculpt.errors import InputError
from cadsculpt.formats.contacts_csv import (
    ContactsWriter,
    ForcesWriter,
    read_contacts,
    read_displacements,
    read_forces,
    write_displacements,
)
from cadsculpt.record import ContactRecord, StepRecord

AWKWARD = st.one_of(
    st.floats(allow_nan=False),
    st.sampled_from([0.1, 1.0 / 3.0, 5e-324, 1.7976931348623157e308, -0.0, 123456789.12345679]),
)


def contacts(n: int, seed: int = 0) -> Contacts:
    rng = np.random.default_rng(seed)
    return Contacts(
        rng.integers(0, 2, n), rng.integers(2, 4, n), rng.integers(0, 3, n), rng.random(n), rng.random(n),
        rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), rng.random(n), rng.random(n), rng.normal(size=(n, 3)),
        rng.integers(0, 2, n), rng.random(n), rng.random(n),
    )  # fmt: skip


def add_many(writer: ContactsWriter) -> None:
    for step in range(100):
        writer.add(ContactRecord(step, 0.1, contacts(50), np.ones((50, 3))))


def test_contacts_come_back_bit_for_bit(tmp_path: Path) -> None:
    bodies, faces = ["panel", 'the "other", panel', "thumb", "ball"], ["top", "side 1", "rib,2"]
    rng = np.random.default_rng(5)
    steps = [ContactRecord(n, 0.1 * n, contacts(n, n), rng.normal(size=(n, 3))) for n in (3, 0, 5)]
    with ContactsWriter(tmp_path / "contacts.csv", bodies, faces) as writer:
        for record in steps:
            writer.add(record)
    table = read_contacts(tmp_path / "contacts.csv")
    joined = [record.contacts for record in steps]
    for name in ("u", "v", "point", "normal", "depth", "area"):
        assert np.array_equal(getattr(table, name), np.concatenate([getattr(c, name) for c in joined])), name
    assert np.array_equal(table.force, np.concatenate([record.force for record in steps]))
    assert table.a.tolist() == [bodies[i] for c in joined for i in c.a]
    assert table.b.tolist() == [bodies[i] for c in joined for i in c.b]
    assert table.face.tolist() == [faces[i] for c in joined for i in c.face]
    assert table.step.tolist() == [3] * 3 + [5] * 5
    assert table.time.tolist() == [0.1 * 3] * 3 + [0.1 * 5] * 5


def test_the_columns_are_the_promised_ones(tmp_path: Path) -> None:
    with ContactsWriter(tmp_path / "contacts.csv", ["m", "t"], ["f"]):
        pass
    with ForcesWriter(tmp_path / "forces.csv", ["t"]):
        pass
    write_displacements(tmp_path / "displacements.csv", np.zeros((0, 3)), np.zeros((0, 3)))
    assert (tmp_path / "contacts.csv").read_bytes() == b"step,time,a,b,face,u,v,x,y,z,nx,ny,nz,depth,area,fx,fy,fz\n"
    assert (
        tmp_path / "forces.csv"
    ).read_bytes() == b"step,time,tool,fx,fy,fz,tx,ty,tz,contact_area,max_depth,max_penetration\n"
    assert (tmp_path / "displacements.csv").read_bytes() == b"X,Y,Z,DX,DY,DZ\n"
    assert len(read_contacts(tmp_path / "contacts.csv").u) == 0
    assert read_forces(tmp_path / "forces.csv").tools == ()
    assert read_displacements(tmp_path / "displacements.csv")[0].shape == (0, 3)


def test_forces_come_back_bit_for_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    steps = [
        StepRecord(
            n, n / 7.0, rng.normal(size=(2, 3)), rng.normal(size=(2, 3)), rng.random(2), rng.random(2), rng.random(2)
        )
        for n in range(6)
    ]
    with ForcesWriter(tmp_path / "forces.csv", ["thumb", "ball"]) as writer:
        for record in steps:
            writer.add(record)
    table = read_forces(tmp_path / "forces.csv")
    assert table.tools == ("thumb", "ball")
    for name in ("force", "torque", "contact_area", "max_depth", "max_penetration"):
        assert np.array_equal(getattr(table, name), np.concatenate([getattr(s, name) for s in steps])), name
    # any CSV reader finds the same numbers in the same lines
    with open(tmp_path / "forces.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[3]["fy"]) == steps[1].force[1, 1]
    assert float(rows[3]["tz"]) == steps[1].torque[1, 2]


@given(values=hnp.arrays(np.float64, (4, 6), elements=AWKWARD))
def test_every_double_survives(tmp_path_factory: pytest.TempPathFactory, values: np.ndarray) -> None:
    path = tmp_path_factory.mktemp("csv") / "displacements.csv"
    write_displacements(path, values[:, :3], values[:, 3:])
    points, moves = read_displacements(path)
    assert np.hstack([points, moves]).tobytes() == values.tobytes()
    assert b"\r" not in path.read_bytes()


def test_grids_are_one_node_a_line(tmp_path: Path) -> None:
    grid = np.arange(24.0).reshape(2, 4, 3)
    write_displacements(tmp_path / "d.csv", grid, -grid)
    points, moves = read_displacements(tmp_path / "d.csv")
    assert np.array_equal(points, grid.reshape(-1, 3))
    assert np.array_equal(moves, -grid.reshape(-1, 3))


def test_two_writes_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        with ContactsWriter(tmp_path / name, ["m", "n", "s", "t"], ["f", "g", "h"]) as writer:
            writer.add(ContactRecord(1, 0.1, contacts(20), np.ones((20, 3))))
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_nothing_appears_before_the_end_or_after_a_fault(tmp_path: Path) -> None:
    with ForcesWriter(tmp_path / "forces.csv", ["t"]) as writer:
        writer.add(StepRecord(0, 0.0, np.ones((1, 3)), np.ones((1, 3)), np.ones(1), np.ones(1), np.ones(1)))
        assert not (tmp_path / "forces.csv").exists()
    with pytest.raises(RuntimeError), ForcesWriter(tmp_path / "other.csv", ["t"]):
        raise RuntimeError
    assert os.listdir(tmp_path) == ["forces.csv"]


def test_a_disk_that_fills_up_during_the_run(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    writer = ContactsWriter(tmp_path / "contacts.csv", ["m", "n", "s", "t"], ["f", "g", "h"])
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
    try:
        with pytest.raises(InputError) as caught:
            add_many(writer)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "contacts.csv" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the first line is not X,Y,Z"),
        ("X;Y;Z;DX;DY;DZ\n", "the first line is not X,Y,Z"),
        ("X,Y,Z,DX,DY,DZ\n1,2,3,4,5,6\n1,2,3\n", "line 3"),
        ("X,Y,Z,DX,DY,DZ\n1,2,3,4,5,six\n", "line 2"),
        ("X,Y,Z,DX,DY,DZ\n1,2,3,4,5,\xff\n", "not a CSV table"),
    ],
)
def test_tables_that_are_none(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "d.csv").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=said):
        read_displacements(tmp_path / "d.csv")


def test_a_missing_table(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_forces(tmp_path / "none.csv")
