"""The bytes of a 3DM archive: what is not changed stays, what is damaged is told."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest

from cadsculpt.errors import CadsculptError, InputError
from cadsculpt.formats.rhino import part as rhino
from cadsculpt.formats.rhino.archive import (
    BREP_OBJECT_TYPE,
    Reader,
    archive_version,
    class_record,
    object_records,
    replace_objects,
)
from cadsculpt.formats.rhino.brep import brep_chunk, read_brep
from cadsculpt.formats.rhino.geometry import clamped, clamped_surface, curve_points, encoded
from cadsculpt.formats.rhino.nurbs import NURBS_CURVE, NURBS_SURFACE, Nurbs, nurbs_chunk, read_nurbs

rhino3dm = pytest.importorskip("rhino3dm")

FILES = [
    "TestClosestPoint", "v1_DeformCubes", "v1_Speeder", "v1_Terrain", "v1_UntrimmedSurfaces", "v2_DeformCubes",
    "v2_Flow2", "v2_HumanHead2", "v2_RhinoLogo", "v2_Smooth", "v2_Speeder", "v2_Terrain", "v2_UntrimmedSurfaces",
    "v2_my_surfaces", "v3_HumanHead2", "v3_Terrain", "v3_my_surfaces", "v4_DinerMug", "v4_Gear", "v5_extrusions",
    "v5_my_surfaces", "v5_rhino_logo", "v5_ring", "v7_my_surfaces", "v7_my_trimmed_surface",
]  # fmt: skip


def file(corpus: Path, name: str) -> Path:
    return corpus / "rhino" / f"{name}.3dm"


@pytest.mark.corpus
@pytest.mark.parametrize("name", FILES)
def test_what_is_not_changed_keeps_its_bytes(corpus: Path, name: str, tmp_path: Path) -> None:
    """Chunks, Breps, curves and surfaces, read and written again, are the same bytes, checksums included."""
    path = file(corpus, name)
    data = path.read_bytes()
    part = rhino.read(path)
    part.write(tmp_path / "same.3dm", "3dm")
    assert (tmp_path / "same.3dm").read_bytes() == data
    for body in part.bodies:
        whole = encoded(body.thing)
        assert brep_chunk(body.brep, whole[class_record(whole, 0, len(whole), 60).data.end :]) == whole
        items = [(c, 1) for c in (*body.brep.curves2, *body.brep.curves3)] + [(s, 2) for s in body.brep.surfaces]
        for chunk, directions in items:
            assert chunk is not None
            record = class_record(chunk, 0, len(chunk), 60)
            if record.class_id in (NURBS_CURVE, NURBS_SURFACE):
                nurbs = read_nurbs(Reader(chunk, record.data.body, record.data.end - 4, 60), directions)
                assert nurbs_chunk(nurbs, 60) == chunk
    version = archive_version(data)
    if version == 1:
        return
    assert replace_objects(data, {}) == data
    for record in object_records(data):
        if version >= 3 and record.type_chunk.value == BREP_OBJECT_TYPE:
            start, end = record.record.chunk.start, record.record.chunk.end
            brep = read_brep(data, start, end, version)
            after = data[record.record.data.end : end]
            assert brep_chunk(brep, after, record.record.class_id) == data[start:end]


def test_knots_that_opennurbs_leaves_out() -> None:
    """The two missing knots of a periodic vector continue its period; of a clamped one they repeat the ends."""
    period = np.array([0.0, 1.0, 1.5, 3.0, 3.5, 4.5, 6.0])  # one lap of length 6
    laps = np.concatenate([period[:-1] + 6.0 * k for k in range(-2, 4)])
    degree, count = 3, 6
    start = int(np.searchsorted(laps, 0.0)) - degree
    full = laps[start : start + count + 2 * degree + 1]
    points = np.tile(np.arange(6.0), 2)[: count + degree, None] * np.ones(3)
    curve = Nurbs(3, False, (degree,), (full[1:-1],), points)
    assert np.allclose(curve.padded_knots(0), full)
    flat = Nurbs(3, False, (2,), (np.array([0.0, 0.0, 1.0, 2.0, 2.0]),), points[:4])
    assert flat.padded_knots(0).tolist() == [0, 0, 0, 1, 2, 2, 2]


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_clamping_keeps_the_shape(degree: int) -> None:
    rng = np.random.default_rng(degree)
    count = 9
    knots = np.cumsum(rng.random(count + degree - 1) + 0.1)
    weights = 0.5 + rng.random((count, 1))
    points = np.concatenate([rng.random((count, 3)) * weights, weights], axis=1)
    curve = Nurbs(3, True, (degree,), (knots,), points)
    whole = clamped(curve)
    low, high = knots[degree - 1], knots[-degree]
    t = np.linspace(low, high, 101)
    assert np.allclose(curve_points(whole, t), curve_points(curve, t), rtol=0, atol=1e-13)
    padded = whole.padded_knots(0)
    assert (padded[: degree + 1] == low).all()
    assert (padded[-degree - 1 :] == high).all()
    assert len(padded) == len(whole.points) + degree + 1


def test_clamping_a_surface_keeps_its_other_direction() -> None:
    rng = np.random.default_rng(3)
    knots = np.arange(10.0), np.array([0.0, 0.0, 1.0, 2.0, 2.0])
    surface = Nurbs(3, False, (3, 2), knots, rng.random((8, 4, 3)))
    whole = clamped_surface(surface)
    assert np.array_equal(whole.knots[1], knots[1])
    for j in range(4):
        before = Nurbs(3, False, (3,), knots[:1], surface.points[:, j])
        after = Nurbs(3, False, (3,), whole.knots[:1], whole.points[:, j])
        t = np.linspace(2.0, 7.0, 31)
        assert np.allclose(curve_points(before, t), curve_points(after, t), atol=1e-13)


# --------------------------------------------------------------------- bad input


@pytest.mark.corpus
@pytest.mark.parametrize("name", ["v1_Terrain", "v2_Terrain", "v4_DinerMug", "v5_ring", "v7_my_trimmed_surface"])
def test_cut_short_at_every_tenth(corpus: Path, name: str, tmp_path: Path) -> None:
    data = file(corpus, name).read_bytes()
    path = tmp_path / "cut.3dm"
    for tenth in range(1, 10):
        path.write_bytes(data[: len(data) * tenth // 10])
        with pytest.raises(InputError) as caught:
            rhino.read(path)
        assert str(caught.value).startswith(str(path))
        assert "\n" not in str(caught.value)


@pytest.mark.corpus
@pytest.mark.parametrize("name", ["v2_Speeder", "v3_Terrain", "v7_my_trimmed_surface"])
def test_vandalised(corpus: Path, name: str, tmp_path: Path) -> None:
    """Bytes changed at random: one clear line, or a part; never another exception."""
    data = file(corpus, name).read_bytes()
    rng = np.random.default_rng(11)
    path = tmp_path / "bad.3dm"
    told: list[str] = []
    for _ in range(25):
        bad = bytearray(data)
        for place in rng.integers(0, len(data), rng.choice([1, 4, 40])):
            bad[place] = rng.integers(256)
        path.write_bytes(bad)
        try:
            part = rhino.read(path)
        except CadsculptError as error:
            told.append(str(error))
            continue
        assert all(np.isfinite(f.surface.control_points).all() for f in part.faces if not f.warning)
    assert len(told) > 10
    assert all(str(path) in line and "\n" not in line for line in told)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (b"Rhino, I presume", "no 3DM file"),
        (b"3D Geometry File Format      six", "version"),
        (b"3D Geometry File Format       70" + bytes(400), "breaks off"),
        (b"3D Geometry File Format       70" + b"\xff" * 400, "breaks off"),
    ],
)
def test_no_3dm_file(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "x.3dm").write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        rhino.read(tmp_path / "x.3dm")
    assert "x.3dm" in str(caught.value)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    for path in (tmp_path / "none.3dm", tmp_path):
        with pytest.raises(InputError, match=str(path)):
            rhino.read(path)


def test_file_without_surfaces_says_what_it_holds(tmp_path: Path) -> None:
    model = rhino3dm.File3dm()
    model.Settings.ModelUnitSystem = rhino3dm.UnitSystem.Meters
    model.Objects.AddPoint(rhino3dm.Point3d(1, 2, 3))
    (tmp_path / "point.3dm").write_bytes(base64.b64decode(model.Encode()))
    part = rhino.read(tmp_path / "point.3dm")
    assert len(part.faces) == 0
    assert part.units == "m"
    assert part.warnings == ["no surfaces: the file holds 1 Point"]
