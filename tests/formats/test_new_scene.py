"""`new`: where a tool goes, how large it is, and that the scene it writes can be run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cadsculpt.cli import new as cli_new
from cadsculpt.cli.main import run as cadsculpt
from cadsculpt.errors import InputError
from cadsculpt.formats import patch_json
from cadsculpt.formats.demo_parts import panel
from cadsculpt.formats.face_survey import FaceSurvey, Spot, fold_thickness, free_radius, part_samples, survey
from cadsculpt.formats.new_scene import _turn, new_scene
from cadsculpt.formats.part import Face, FaceEdge, Faces
from cadsculpt.formats.press import SHAPES, Press, Wish, placed, sizes_of, tool_of, touch_height, wanted
from cadsculpt.formats.scene_toml import SceneFile
from cadsculpt.motion.path import rotation_to_axis
from cadsculpt.motion.pose import Pose
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

Array = NDArray[np.float64]


class SurfaceFace(Face):
    """A face that is a surface, with no edges but its trims."""

    kind, trimmed = "bspline", False

    def __init__(self, number: int, surface: BSplineSurface) -> None:
        self.number, self.name, self._surface = number, f"face {number}", surface

    @property
    def surface(self) -> BSplineSurface:
        return self._surface

    @property
    def area(self) -> float:
        raise AssertionError("not needed")

    @property
    def bbox(self) -> tuple[float, float, float, float, float, float]:
        raise AssertionError("not needed")

    @property
    def edges(self) -> Sequence[FaceEdge]:
        return ()


class Surfaces:
    """As much of a part as the survey looks at."""

    def __init__(self, *surfaces: BSplineSurface) -> None:
        self.faces = Faces([SurfaceFace(i + 1, s) for i, s in enumerate(surfaces)], "made up")


def rectangle(a: float, b: float, z: float = 0.0, hole: float = 0.0) -> BSplineSurface:
    """A flat rectangle a x b, outward up, with a square hole of that half width in its middle."""
    x, y = np.meshgrid([0.0, a], [0.0, b], indexing="ij")
    net = np.stack([x, y, np.full_like(x, z)], axis=2)
    trims = (
        _square(0.0, 0.0, a, b),
        _square(0.5 * a - hole, 0.5 * b - hole, 0.5 * a + hole, 0.5 * b + hole, outer=False),
    )
    return BSplineSurface(
        net, np.array([0.0, 0.0, a, a]), np.array([0.0, 0.0, b, b]), 1, 1, trims=trims if hole else None
    )


def _square(x0: float, y0: float, x1: float, y1: float, outer: bool = True) -> TrimLoop:
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    return TrimLoop(tuple(TrimCurve(corners[i : i + 2], knots, 1) for i in range(4)), outer)


def half_cylinder(radius: float, length: float, outward: bool = True) -> BSplineSurface:
    """Two rational quarter circles about the x axis, z >= 0, exactly; outward is away from the axis."""
    w = math.sqrt(0.5)
    profile = radius * np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [-1.0, 1.0], [-1.0, 0.0]])
    net = np.zeros((5, 2, 3))
    net[:, :, 1:], net[:, 1, 0] = profile[:, None], length
    weights = np.array([1.0, w, 1.0, w, 1.0])[:, None] * np.ones(2)
    # S_u x S_v points away from the axis: u runs from +y over +z to -y, v along x
    knots = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    return BSplineSurface(net, knots, np.array([0.0, 0.0, 1.0, 1.0]), 2, 1, weights=weights, outward=outward)


def press_at(seen: FaceSurvey, spot: Spot, shape: str, around: Array) -> Press | None:
    press = wanted(seen, spot, bold=False)
    return None if press is None else placed(press, shape, around)


def test_a_wish_limits_the_tool_and_coarsens_the_lattice() -> None:
    seen = survey(SurfaceFace(1, rectangle(300.0, 200.0)))
    spot = seen.spots(np.zeros((0, 3)))[0]
    usual, small, quick = (wanted(seen, spot, bold=False, wish=wish) for wish in (Wish(), Wish(0.02), Wish.quick(0.02)))
    assert usual is not None
    assert small is not None
    assert quick is not None
    assert small.scale == quick.scale == pytest.approx(0.02 * seen.size)
    assert small.scale < 0.5 * usual.scale
    assert quick.spacing > 1.5 * small.spacing


# ------------------------------------------------------------------ the survey


def test_the_cylinder_of_these_tests_points_outward() -> None:
    points = half_cylinder(2.0, 5.0).normal(np.linspace(0.1, 1.9, 7), 0.5)
    assert (points[:, 2] > 0.0).all()


def test_a_lattice_below_a_cylinder_folds_at_its_radius() -> None:
    for outward, fold in ((True, 3.0), (False, np.inf)):
        surface = half_cylinder(3.0, 10.0, outward)
        u, v = np.linspace(0.0, 2.0, 33), np.linspace(0.0, 1.0, 5)
        found = fold_thickness(surface.evaluate(u[:, None], v), surface.normal(u[:, None], v))
        assert found == pytest.approx(fold, rel=1e-9)


def test_the_room_in_a_rectangle_is_half_its_width_and_the_place_its_middle() -> None:
    seen = survey(SurfaceFace(1, rectangle(100.0, 40.0)))
    spot = seen.spots(np.zeros((0, 3)))[0]
    assert spot.room == pytest.approx(20.0, rel=0.05)
    assert abs(spot.point[1] - 20.0) < 1.5
    assert spot.normal == pytest.approx([0.0, 0.0, 1.0])
    assert spot.free_radius == np.inf
    assert seen.lengths == pytest.approx((100.0, 40.0))


def test_the_place_keeps_away_from_a_hole() -> None:
    for spot in survey(SurfaceFace(1, rectangle(60.0, 60.0, hole=10.0))).spots(np.zeros((0, 3))):
        x, y = np.abs(spot.point[:2] - 30.0)
        assert max(x, y) > 10.0
        wall, hole = 30.0 - max(x, y), max(x, y) - 10.0
        assert spot.room == pytest.approx(min(wall, np.hypot(max(x - 10.0, 0), max(y - 10.0, 0))), abs=0.6)
        assert hole > 0


@given(st.floats(0.5, 20.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
@settings(max_examples=30, deadline=None)
def test_the_free_ball_inside_a_cylinder_has_its_radius(radius: float, a: float, b: float) -> None:
    surface = half_cylinder(radius, 4.0 * radius, outward=False)
    u, v = 1.0 + 0.4 * a, 0.5 + 0.4 * b
    cloud = surface.evaluate(np.linspace(0.0, 2.0, 101)[:, None], np.linspace(0.0, 1.0, 41)).reshape(-1, 3)
    found = free_radius(surface.evaluate(u, v), surface.normal(u, v), cloud, 1e-3 * radius)
    # the ball that touches both sides of a half pipe is the pipe's own; samples can only let it grow a little
    assert radius * (1.0 - 1e-5) <= found <= 1.02 * radius


def test_a_copy_of_the_face_does_not_take_its_room() -> None:
    copy = survey(SurfaceFace(2, rectangle(100.0, 40.0, z=1e-12))).points.reshape(-1, 3)
    for spot in survey(SurfaceFace(1, rectangle(100.0, 40.0))).spots(copy):
        assert spot.free_radius > 1e6


def test_a_wall_above_the_face_limits_thetool_of() -> None:
    part = Surfaces(rectangle(100.0, 100.0), rectangle(100.0, 100.0, z=6.0))
    around = np.concatenate([samples.points for samples in part_samples(part).values()])  # type: ignore[arg-type]
    seen = survey(part.faces[0])
    spot = seen.spots(around)[0]
    assert spot.free_radius == pytest.approx(3.0, rel=0.1)
    for shape in SHAPES:
        press = press_at(seen, spot, shape, around)
        assert press is not None
        tool = tool_of(shape, press.scale)
        top = 0.0 if tool is None else float(tool.box_corners[1, 2])
        assert press.start + top < 6.0


# ---------------------------------------------------------------------- the tool


@pytest.mark.parametrize("shape", SHAPES)
def test_a_tool_touches_a_plane_with_its_lowest_point(shape: str) -> None:
    spot = Spot(0.5, 0.5, np.array([1.0, 2.0, 3.0]), np.array([0.6, 0.0, 0.8]), 10.0, np.inf)
    tool = tool_of(shape, 2.0)
    across = np.array([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0]])
    s = np.linspace(-6.0, 6.0, 121)
    points = spot.point + s[:, None, None] * across[0] + s[None, :, None] * across[1]
    height = touch_height(tool, spot, points.reshape(-1, 3))
    lowest = 0.0 if tool is None else -float(tool.box_corners[0, 2])
    assert height == pytest.approx(lowest, abs=0.02)


@pytest.mark.parametrize("shape", [shape for shape in SHAPES if shape != "point"])
def test_a_tool_fills_the_ball_it_was_sized_for(shape: str) -> None:
    tool = tool_of(shape, 2.0)
    assert tool is not None
    half = 0.5 * np.ptp(tool.box_corners, axis=0)
    assert half.max() <= 2.0 * 1.31
    assert half.max() >= 2.0 * 0.7
    assert all(np.min(value) > 0 for value in sizes_of(shape, 2.0).values())


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda n: np.linalg.norm(n) > 0.1))
@settings(max_examples=50, deadline=None)
def test_the_turn_of_the_scene_points_the_tool_along_the_normal(n: tuple[float, float, float]) -> None:
    normal = np.array(n) / np.linalg.norm(n)
    turn = _turn(normal)
    pose = Pose() if turn is None else Pose.turned(np.zeros(3), turn[:3], turn[3])
    assert pose.rotation[:, 2] == pytest.approx(normal, abs=1e-6)
    assert pose.rotation == pytest.approx(rotation_to_axis(normal), abs=1e-6)


@given(st.sampled_from([1e-4, 1e-2, 1e3, 1e5]))
@settings(max_examples=4, deadline=None)
def test_the_press_does_not_depend_on_the_unit(factor: float) -> None:
    presses = []
    for surface in (panel(), panel().scaled(factor)):
        seen = survey(SurfaceFace(1, surface))
        press = press_at(seen, seen.spots(np.zeros((0, 3)))[0], "sphere", np.zeros((0, 3)))
        assert press is not None
        presses.append(press)
    small, large = presses
    for name in ("scale", "depth", "start", "end", "thickness", "spacing", "score"):
        assert getattr(large, name) == pytest.approx(factor * getattr(small, name), rel=1e-6), name
    assert large.layers == small.layers


def test_the_press_is_sensible_on_a_panel() -> None:
    seen = survey(SurfaceFace(1, panel()))
    spot = seen.spots(np.zeros((0, 3)))[0]
    press = press_at(seen, spot, "sphere", np.zeros((0, 3)))
    assert press is not None
    assert 0.15 * 80.0 / 2 < press.scale <= 0.25 * 80.0
    assert press.depth == pytest.approx(0.05 * seen.size, rel=0.2)
    assert press.thickness == pytest.approx(2.5 * press.depth)
    assert press.thickness < seen.fold
    assert press.start > press.scale > press.end
    assert press.half_width > 3.0 * press.spacing


# ---------------------------------------------------------------- the whole scene


@pytest.fixture
def panel_file(tmp_path: Path) -> Path:
    from cadsculpt.formats.patch_json import write_surfaces

    (tmp_path / "parts").mkdir()
    write_surfaces(tmp_path / "parts" / "panel.json", [panel()], "mm")
    return tmp_path / "parts" / "panel.json"


def test_the_scene_reads_back_and_names_its_part_from_its_own_folder(
    panel_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenes").mkdir()
    assert cadsculpt(["new", "parts/panel.json", "-o", "scenes/press.toml", "--tool", "ellipsoid"]) == 0
    assert "cadsculpt run scenes/press.toml" in capsys.readouterr().out
    scene = SceneFile.load("scenes/press.toml")
    assert scene.model[0].file == "../parts/panel.json"
    assert scene.tool[0].shape == "ellipsoid"
    assert scene.output.cad == ("json",)
    assert scene.solver.step == "auto"
    before = (tmp_path / "scenes" / "press.toml").read_bytes()
    assert cadsculpt(["new", "parts/panel.json", "-o", "scenes/press.toml"]) == 2
    assert "--force" in capsys.readouterr().err
    assert (tmp_path / "scenes" / "press.toml").read_bytes() == before
    assert cadsculpt(["new", "parts/panel.json", "-o", "scenes/press.toml", "--force"]) == 0


@pytest.mark.parametrize("shape", SHAPES)
def test_every_tool_starts_outside_and_reaches_the_face(shape: str, panel_file: Path, tmp_path: Path) -> None:
    from cadsculpt.formats.load import load
    from cadsculpt.session import Session

    made = new_scene(panel_file, tmp_path / "scene.toml", shape=shape)
    session = Session(load(made.scene).model)
    assert len(session.detect().contacts) == 0
    path = session.model.tools[0].path
    contacts = session.detect([path.pose(float(path.t[1]))]).contacts
    assert contacts.depth.max() > 0.3 * made.depth
    assert 50 <= made.steps <= 500


def test_a_face_that_is_not_there_and_a_shape_that_cannot_be_placed(panel_file: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no face named 'pannel'"):
        new_scene(panel_file, tmp_path / "s.toml", face="pannel")
    with pytest.raises(InputError, match="no face number 7"):
        new_scene(panel_file, tmp_path / "s.toml", face="7")
    with pytest.raises(InputError, match="half_space"):
        new_scene(panel_file, tmp_path / "s.toml", shape="half_space")
    assert not (tmp_path / "s.toml").exists()


def test_the_command_offers_what_can_be_placed() -> None:
    assert cli_new.SHAPES == SHAPES


def test_a_sheet_with_a_narrow_curl_gets_a_lattice_that_is_thin_enough(tmp_path: Path) -> None:
    """The curl's radius allows flakes at most; a lattice whose directions are smoothed there stands when it is thinner."""
    turn = np.linspace(0.0, 3.0, 6)[1:]
    x = np.concatenate([np.linspace(0.0, 60.0, 8), 60.0 + 0.2 * np.sin(turn)])
    z = np.concatenate([np.zeros(8), -0.2 * (1.0 - np.cos(turn))])
    net = np.stack(np.broadcast_arrays(x[:, None], np.linspace(0.0, 30.0, 4), z[:, None]), axis=2)
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, len(x) - 2), np.ones(3)])
    curl = BSplineSurface(net, knots, np.array([0.0, 0, 0, 0, 1, 1, 1, 1]), 3, 3)
    patch_json.write_surfaces(tmp_path / "curl.json", [curl], "mm")
    made = new_scene(tmp_path / "curl.json", tmp_path / "scene.toml", wish=Wish.quick(0.02))
    assert 0.0 < made.depth <= made.scene.model[0].thickness
    assert made.nodes < 5_000


@pytest.mark.corpus
@pytest.mark.parametrize(
    "name", ["step/trj7_c2-al-214.stp", "iges/BUC50025.igs", "rhino/v2_Terrain.3dm", "step/bm2_ec_t4-A.stp"]
)
def test_real_parts_get_a_scene_that_presses_a_free_form_face(corpus: Path, name: str, tmp_path: Path) -> None:
    made = new_scene(corpus / name, tmp_path / "scene.toml")
    assert made.face.kind in ("bspline", "bezier")
    assert made.scene.units == {"step/bm2_ec_t4-A.stp": "m"}.get(name, "mm")
    assert 50 <= made.steps <= 500
    assert made.nodes < 20_000


@pytest.mark.corpus
def test_a_face_that_bends_sharply_gets_a_thinner_lattice(corpus: Path, tmp_path: Path) -> None:
    made = new_scene(corpus / "iges" / "PRO19800.igs", tmp_path / "scene.toml")
    assert made.depth < 0.5 * made.scene.model[0].thickness
