"""A run with a deformable tool and a rigid model: what its folder holds of the tool, twice and after an interruption."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest

from cadsculpt.formats import patch_json, run_folder
from cadsculpt.formats.contacts_csv import read_contacts, read_displacements, read_forces
from cadsculpt.formats.load import load
from cadsculpt.formats.run_folder import RunOutcome, run_scene
from cadsculpt.formats.scene_toml import SceneFile
from cadsculpt.formats.vtk_series import read_frame, read_series
from cadsculpt.frames import FrameMaker
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface

SCENE = """
schema = 1
name = "pad on plate"
units = "mm"
[[model]]
name = "plate"
file = "plate.json"
thickness = 4.0
nodes = 2.5
layers = 2
material = "clay"
[[model]]
name = "table"
file = "table.json"
rigid = true
[[tool]]
name = "soft / pad"
shape = "surface"
file = "pad.json"
material = "rubber"
thickness = 3.0
nodes = 2.0
layers = 2
[[tool.path]]
t = 0.0
at = [10, 10, 0.1]
[[tool.path]]
t = 0.01
at = [10, 10, -0.4]
turn = [0, 0, 1, 5]
[[tool.path]]
t = 0.02
at = [10, 10, 1]
turn = [0, 0, 1, 5]
[solver]
step = 1e-3
resolution = 41
max_penetration = 0.3
[output]
cad = ["json"]
pictures = false
frames_per_second = 500
[[expect]]
what = "max_force"
pair = ["plate", "soft / pad"]
at_least = 0.1
[[expect]]
what = "verdict"
pair = ["table", "soft / pad"]
equals = "clear"
"""


def sheet(size: float, corner: tuple[float, float, float], *, up: bool = True) -> BSplineSurface:
    knots = np.array([0.0, 0, 0, 0, 1, 2, 3, 3, 3, 3]) * size / 3.0
    t = np.array([knots[i + 1 : i + 4].mean() for i in range(6)])
    X, Y = np.meshgrid(t, t, indexing="ij")
    return BSplineSurface(
        np.stack([X, Y, 0 * X], axis=-1) + np.array(corner), knots, knots, 3, 3, outward=up, name="face"
    )


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> SceneFile:
    folder = tmp_path_factory.mktemp("scene")
    for name, surface in (
        ("plate", sheet(20.0, (0, 0, 0))),
        ("table", sheet(20.0, (0, 30, 0))),
        ("pad", sheet(8.0, (-4, -4, 0), up=False)),
    ):
        patch_json.write_surfaces(folder / f"{name}.json", [surface], "mm")
    (folder / "scene.toml").write_text(SCENE)
    return SceneFile.load(folder / "scene.toml")


@pytest.fixture(scope="module")
def outcome(scene, tmp_path_factory) -> tuple[Path, RunOutcome]:
    folder = tmp_path_factory.mktemp("runs") / "run"
    return folder, run_scene(scene, folder)


def test_the_folder_holds_the_tool_as_it_was_pressed(scene, outcome):
    folder, found = outcome
    assert found.result.ok
    session = found.result.session
    assert (folder / "displacements.soft-pad.csv").exists()
    rest, moved = read_displacements(folder / "displacements.soft-pad.csv")
    np.testing.assert_array_equal(moved, session.displacement(1).reshape(-1, 3))
    assert np.abs(rest[:, 2]).max() == 0.0  # in the tool's own frame
    # the models' table is the models' alone
    assert len(read_displacements(folder / "displacements.csv")[0]) == len(session.model.patches[0].lattice.nodes) / 3
    lattice = meshio.read(folder / "lattice.vtu")
    assert set(np.unique(lattice.cell_data["lattice"][0])) == {0, 1}
    contacts = read_contacts(folder / "contacts.csv")
    assert set(contacts.a) == {"plate"}
    assert set(contacts.b) == {"soft / pad"}
    forces = read_forces(folder / "forces.csv")
    for step in np.unique(contacts.step):
        total = contacts.force[contacts.step == step].sum(axis=0)
        np.testing.assert_allclose(forces.force[forces.step == step][0], -total, atol=1e-12)
    names = [entry["file"] for entry in found.document["outputs"]]
    assert {"displacements.csv", "displacements.soft-pad.csv"} <= set(names)
    # only what was sculpted goes into CAD, and the rigid table is not
    assert len(patch_json.read(folder / "surfaces.json").faces) == 1


def test_frames_show_the_tool_deformed(scene, outcome):
    folder, _ = outcome
    frames = [read_frame(path) for _, path in read_series(folder / "series.pvd")]
    assert frames[0].bodies == ("plate: face", "soft / pad")
    tool = frames[0].body == 1
    assert np.abs(frames[0].displacement[tool]).max() < 1e-9
    pressed = max(np.abs(frame.displacement[tool][:, 2]).max() for frame in frames)
    assert pressed > 0.1
    # less its displacement it is the rigid tool, where the path has it
    session = Session(load(scene).model)
    for frame in frames[::3]:
        pose = session.model.tools[0].path.pose(frame.time)
        rigid = pose.to_tool(frame.points[tool] - frame.displacement[tool])
        assert np.abs(rigid[:, 2]).max() < 1e-9
        assert np.abs(rigid[:, :2]).max() == pytest.approx(4.0, abs=1e-9)
    names = [lattice.name for lattice in FrameMaker.of(session).lattices()]
    assert names == ["plate: face", "soft / pad: face"]


def test_it_goes_on_after_an_interruption_and_ends_the_same(scene, outcome, tmp_path, monkeypatch):
    folder, _ = outcome
    monkeypatch.setattr(run_folder, "CHECKPOINT_SECONDS", 0.0)

    def interrupt(progress):
        if progress.stage == "running" and progress.done == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_scene(scene, tmp_path / "again", on_progress=interrupt)
    run_scene(scene, tmp_path / "again", resume=True)
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name not in ("result.json", "report.html"):
            assert path.read_bytes() == (tmp_path / "again" / path.relative_to(folder)).read_bytes(), path.name


def test_the_report_tells_of_every_pair(outcome):
    folder, _ = outcome
    text = (folder / "report.html").read_text()
    assert "soft / pad" in text
    assert "plate" in text
