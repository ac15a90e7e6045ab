"""Displacement fields in: read in any dress, exact at their points, nothing beyond; a run's own file brings its surfaces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cadsculpt.cli.main import run as command
from cadsculpt.errors import CadsculptError, InputError
from cadsculpt.formats import displacements, patch_json, registry
from cadsculpt.formats.contacts_csv import write_displacements
from cadsculpt.formats.displace import displace
from cadsculpt.formats.field_nodes import feet
from cadsculpt.formats.patch_part import PatchPart
from cadsculpt.formats.run_folder import run_scene
from cadsculpt.formats.scene_toml import SceneFile
from cadsculpt.spline.surface import BSplineSurface

Array = NDArray[np.float64]


def sheet(name: str = "top", y0: float = 0.0, crown: float = 0.0) -> BSplineSurface:
    """60 x 50, bicubic; flat, or crowned along x."""
    knots = [np.concatenate([[0.0] * 4, np.linspace(0, 1, n - 2)[1:-1], [1.0] * 4]) for n in (6, 5)]
    greville = [np.array([k[i + 1 : i + 4].mean() for i in range(n)]) for k, n in zip(knots, (6, 5), strict=True)]
    x, y = np.meshgrid(60 * greville[0], 50 * greville[1] + y0, indexing="ij")
    return BSplineSurface(np.stack([x, y, crown * np.sin(x / 20)], axis=2), *knots, 3, 3, name=name)


def dent(points: Array) -> Array:
    """3 mm deep around (28, 22)."""
    out = np.zeros_like(points)
    out[:, 2] = -3.0 * np.exp(-((points[:, 0] - 28) ** 2 + (points[:, 1] - 22) ** 2) / 60)
    return out


def part_of(*surfaces: BSplineSurface) -> PatchPart:
    return PatchPart(Path("made.json"), "json", "mm", list(surfaces))


def grid_of(surface: BSplineSurface, m: int, n: int) -> tuple[Array, Array, Array]:
    u, v = np.linspace(0, 1, m), np.linspace(0, 1, n)
    return u, v, surface.evaluate(u[:, None], v).reshape(-1, 3)


# ---------------------------------------------------------------------- reading

ROWS = np.array([[0.0, 0, 0, 0, 0, -1.5], [10.0, 0, 0, 0, 0, 0], [0.0, 1e1, 0, 0, 0.25, 0], [1.0, 1, 2, 3, 4, 5]])


@pytest.mark.parametrize(
    "text",
    [
        "X,Y,Z,DX,DY,DZ\n{rows}",
        "{rows}",
        "x,y,z,dx,dy,dz\r\n{rows}",
        "# from somewhere\n\n{rows}\n\n",
        "id,DX,DY,DZ,X,Y,Z,magnitude\n{swapped}",
    ],
)
@pytest.mark.parametrize("separator", [",", ";", "\t", " ", ", "])
def test_any_dress(text: str, separator: str, tmp_path: Path) -> None:
    rows = "\n".join(separator.join(map(repr, row)) for row in ROWS.tolist())
    swapped = "\n".join(separator.join(map(repr, [n, *row[3:], *row[:3], 0.5])) for n, row in enumerate(ROWS.tolist()))
    path = tmp_path / "d.csv"
    path.write_bytes(text.replace(",", separator).format(rows=rows, swapped=swapped).encode())
    field = displacements.read(path, "mm")
    np.testing.assert_array_equal(np.hstack([field.points, field.moves]), ROWS)
    np.testing.assert_allclose(displacements.read(path, "in").points, 25.4 * ROWS[:, :3], rtol=1e-15)


def test_a_runs_own_file(tmp_path: Path) -> None:
    write_displacements(tmp_path / "d.csv", ROWS[:, :3], ROWS[:, 3:])
    field = displacements.read(tmp_path / "d.csv")
    np.testing.assert_array_equal(field.moves, ROWS[:, 3:])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "holds no points"),
        ("X,Y,Z,DX,DY,DZ\n", "holds no points"),
        ("a,b,c\n1,2,3\n", "name X, Y, Z, DX, DY, DZ"),
        ("1,2,3,4,5\n", "has 5 numbers"),
        ("1,2,3,4,5,6\n1,2,3,4,5,nan\n", ":2: 'nan'"),
        ("1,2,3,4,5,6\n1,2,x,4,5,6\n", ":2: 'x'"),
        ("1,2,3,4,5,6\n1,2,3\n", ":2: has 3"),
        ("1,2,3,4,5,1e999\n", "name X"),
        ("X,Y,Z,DX,DY,DZ\n1,2,3,4,5\n", "has 5 numbers"),
        ("0,0,0,1,0,0\n0,0,0,2,0,0\n9,9,9,0,0,0\n", "moves in two ways"),
        ("0,0,0,1,0,0\n", "how far"),
    ],
)
def test_faults_by_their_lines(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "d.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        displacements.read(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)


@given(st.text(alphabet="XYZD0123456789.,;- e\n#na", max_size=200))
@settings(max_examples=80, deadline=None)
def test_any_text_is_read_or_refused(text: str) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "d.csv"
        path.write_text(text)
        try:
            field = displacements.read(path)
        except CadsculptError as error:
            assert str(error)
        else:
            assert np.isfinite(field.points).all()
            assert np.isfinite(field.moves).all()


# ------------------------------------------------------------------------ field


def test_exact_at_the_points_and_nothing_beyond_the_reach() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 50, (400, 3)) * [1, 1, 0.02]
    moves = rng.normal(size=(400, 3))
    field = displacements.field_of(points, moves)
    np.testing.assert_array_equal(field.at(points), moves)
    far = np.array([[200.0, 0, 0], [25, 25, 1.01 + field.reach], [-field.reach * 1.001, 25, 0]])
    np.testing.assert_array_equal(field.at(far), 0.0)
    whole = displacements.field_of(points, np.tile([1.0, -2.0, 0.5], (400, 1)))
    inside = rng.uniform(10, 40, (50, 3)) * [1, 1, 0.02]
    np.testing.assert_allclose(whole.at(inside), np.tile([1.0, -2.0, 0.5], (50, 1)), atol=1e-9)


def test_a_place_with_two_displacements_that_nearly_agree_has_their_mean() -> None:
    x, y = np.meshgrid(np.arange(0, 30, 1.5), np.arange(0, 30, 1.5))
    points = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    moves = dent(points)
    twice, again = np.concatenate([points, points[200:203], points[200:203]]), moves[200:203]
    near = displacements.field_of(twice, np.concatenate([moves, again + [0, 0, 0.03], again + [0, 0, -0.015]]))
    np.testing.assert_array_equal(near.points, points)
    np.testing.assert_allclose(near.moves[200:203], again + [0, 0, 0.005], atol=1e-12)
    np.testing.assert_array_equal(
        np.delete(near.moves, [200, 201, 202], axis=0), np.delete(moves, [200, 201, 202], axis=0)
    )
    with pytest.raises(InputError, match="moves in two ways"):
        displacements.field_of(twice, np.concatenate([moves, again + [0, 0, 0.3], again]))


def test_the_spacing_is_that_of_a_grid() -> None:
    x, y = np.meshgrid(np.arange(0, 30, 1.5), np.arange(0, 30, 1.5))
    points = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    assert displacements.field_of(points, 0 * points).spacing == pytest.approx(1.5, rel=0.05)


# -------------------------------------------------------------------- application


@pytest.mark.parametrize("crown", [0.0, 6.0])
def test_nodes_of_a_face_are_reproduced(crown: float) -> None:
    surface = sheet(crown=crown)
    u, v, points = grid_of(surface, 41, 35)
    part = part_of(surface)
    (told,) = displace(part, displacements.field_of(points, dent(points)), tolerance=1e-3).faces
    assert told.exact
    assert told.error.maximum <= 1e-3
    new = part.faces[0].surface
    assert np.abs(new.evaluate(u[:, None], v).reshape(-1, 3) - points - dent(points)).max() <= 1e-3
    assert told.moved == pytest.approx(np.abs(dent(points)).max())


def test_scattered_points_make_the_dent() -> None:
    surface = sheet(crown=6.0)
    rng = np.random.default_rng(1)
    points = surface.evaluate(*rng.random((2, 2500)))
    part = part_of(surface)
    (told,) = displace(part, displacements.field_of(points, dent(points)), tolerance=0.01).faces
    assert not told.exact
    _, _, places = grid_of(surface, 60, 60)
    u = v = np.linspace(0, 1, 60)
    found = part.faces[0].surface.evaluate(u[:, None], v).reshape(-1, 3)
    assert np.abs(found - places - dent(places)).max() < 0.02 * 3.0


def test_only_what_is_near_the_points_moves() -> None:
    """Data in a disc: control points away from it keep their bits, as does the face beside."""
    surface, other = sheet(), sheet("beside", 50.0)
    _, _, points = grid_of(surface, 121, 101)
    disc = points[np.hypot(points[:, 0] - 28, points[:, 1] - 22) < 15]
    part = part_of(surface, other)
    told = displace(part, displacements.field_of(disc, dent(disc)), tolerance=0.02)
    assert [face.name for face in told.faces] == ["top"]
    assert part.faces["beside"].surface is part._read[1]
    new = part.faces["top"].surface
    far = new.evaluate(np.linspace(0, 1, 50), 0.95)
    np.testing.assert_allclose(far[:, 2], 0.0, atol=1e-12)


def test_faces_that_are_not_asked_hold_their_edges() -> None:
    """A dent over a seam: both sides move along; with one side chosen the seam stays where the other is."""
    low, high = sheet("low"), sheet("high", 50.0)
    points = np.concatenate([grid_of(s, 41, 35)[2] for s in (low, high)])
    moves = np.zeros_like(points)
    moves[:, 2] = -2.0 * np.exp(-((points[:, 0] - 30) ** 2 + (points[:, 1] - 50) ** 2) / 80)
    both = part_of(low, high)
    displace(both, displacements.field_of(points, moves), tolerance=1e-3)
    t = np.linspace(0, 1, 41)
    seam = [both.faces["low"].surface.evaluate(t, 1.0), both.faces["high"].surface.evaluate(t, 0.0)]
    assert np.abs(seam[0] - seam[1]).max() < 2e-3
    assert seam[0][:, 2].min() < -1.9
    one = part_of(low, high)
    displace(one, displacements.field_of(points, moves), [one.faces["low"]])
    np.testing.assert_allclose(one.faces["low"].surface.evaluate(t, 1.0)[:, 2], 0.0, atol=1e-12)
    assert one.faces["low"].surface.evaluate(0.5, 0.9)[2] < -1.0
    np.testing.assert_array_equal(one.faces["high"].surface.control_points, high.control_points)


def test_points_elsewhere_and_fields_without_motion_are_errors() -> None:
    part = part_of(sheet())
    _, _, points = grid_of(sheet(), 9, 9)
    with pytest.raises(InputError, match="no face is near"):
        displace(part, displacements.field_of(points + 900, dent(points)))
    with pytest.raises(InputError, match="nothing moves"):
        displace(part, displacements.field_of(points, 0 * points))


@given(st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_feet_are_the_nearest_places(seed: int) -> None:
    rng = np.random.default_rng(seed)
    surface = sheet(crown=6.0)
    uv = rng.uniform(0.02, 0.98, (20, 2))
    points = surface.evaluate(*uv.T) + rng.uniform(-2, 2, (20, 1)) * surface.normal(*uv.T)
    np.testing.assert_allclose(feet(surface, points), uv, atol=1e-9)


# ------------------------------------------------------------------ a run's own file

SCENE = """
schema = 1
name = "ball on plate"
units = "mm"
[[model]]
name = "plate"
file = "plate.{format}"
thickness = 4.0
nodes = 1.5
layers = 2
material = "clay"
[[tool]]
name = "ball"
shape = "sphere"
radius = 5.0
[[tool.path]]
t = 0.0
at = [11, 9, 5.2]
[[tool.path]]
t = 0.02
at = [11, 9, 4.1]
[[tool.path]]
t = 0.03
at = [11, 9, 5.5]
[solver]
step = 1e-3
resolution = 41
[refit]
tolerance = 0.02
[output]
cad = ["{format}"]
pictures = false
"""


@pytest.mark.parametrize("format", ["json", "step"])
def test_a_runs_displacements_bring_its_surfaces(format: str, tmp_path: Path) -> None:
    knots = np.array([0.0, 0, 0, 0, 20, 20, 20, 20])
    x, y = np.meshgrid(np.linspace(0, 20, 4), np.linspace(0, 20, 4), indexing="ij")
    plate = BSplineSurface(np.stack([x, y, 0 * x], axis=2), knots, knots, 3, 3, name="plate")
    patch_json.write_surfaces(tmp_path / "plate.json", [plate], "mm")
    if format != "json":
        registry.write_part(registry.read(tmp_path / "plate.json"), tmp_path / f"plate.{format}", format)
    (tmp_path / "scene.toml").write_text(SCENE.format(format=format))
    run_scene(SceneFile.load(tmp_path / "scene.toml"), tmp_path / "run")
    out = tmp_path / f"moved.{format}"
    arguments = ["convert", str(tmp_path / f"plate.{format}"), str(out), "--refit", "0.02", "--quiet"]
    assert command([*arguments, "--displacements", str(tmp_path / "run" / "displacements.csv")]) == 0
    wanted = registry.read(tmp_path / "run" / f"surfaces.{format}").faces[0].surface
    found = registry.read(out).faces[0].surface
    u, v = (np.linspace(*side, 90) for side in wanted.domain)
    gap = np.linalg.norm(wanted.evaluate(u[:, None], v) - found.evaluate(u[:, None], v), axis=2).max()
    depth = np.abs(wanted.evaluate(u[:, None], v)[..., 2]).max()
    assert depth > 0.5
    assert gap <= 0.02


def test_a_plane_of_a_solid_gets_a_smooth_dent(tmp_path: Path) -> None:
    """Its bilinear patch is raised first; the other five faces of the box stay."""
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox

    from cadsculpt.formats.occt.part import document_of_shapes

    document_of_shapes([("box", BRepPrimAPI_MakeBox(60.0, 50.0, 10.0).Shape())]).write(tmp_path / "box.step", "step")
    part = registry.read(tmp_path / "box.step")
    x, y = (side.ravel() for side in np.meshgrid(np.linspace(2, 58, 45), np.linspace(2, 48, 41), indexing="ij"))
    points = np.column_stack([x, y, np.full(len(x), 10.0)])
    (told,) = displace(part, displacements.field_of(points, dent(points) ** 3 / 9.0), tolerance=0.01).faces
    new = part.faces.number(told.number).surface
    assert min(new.degree_u, new.degree_v) >= 3
    (a, b), (c, d) = new.domain
    heights = new.evaluate(np.linspace(a, b, 80)[:, None], np.linspace(c, d, 80))
    flat = heights.reshape(-1, 3)
    assert np.abs(flat[:, 2] - 10.0 - dent(flat)[:, 2] ** 3 / 9.0).max() < 0.15
    assert part.validity().valid
    assert sum(face.kind == "plane" for face in part.faces) == 5


def test_the_command_says_what_moved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    surface = sheet()
    patch_json.write_surfaces(tmp_path / "a.json", [surface, sheet("beside", 50.0)], "mm")
    _, _, points = grid_of(surface, 31, 31)
    write_displacements(tmp_path / "d.csv", points / 25.4, dent(points) / 25.4)
    arguments = [
        "convert",
        str(tmp_path / "a.json"),
        str(tmp_path / "b.json"),
        "--displacements",
        str(tmp_path / "d.csv"),
    ]
    assert command([*arguments, "--displacement-units", "in", "--displace", "top"]) == 0
    said = capsys.readouterr().err
    assert "top: moved by up to 2.9" in said
    assert "beside" not in said
    assert command([*arguments, "--force"]) == 2
    assert "another unit" in capsys.readouterr().err
    assert command(["convert", str(tmp_path / "a.json"), str(tmp_path / "c.json"), "--reach", "3"]) == 2
    assert "--displacements" in capsys.readouterr().err
