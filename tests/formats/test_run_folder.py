"""A run's folder: whole, resumable, never half-written, the same bytes twice."""

from __future__ import annotations

import errno
import json
import signal
from pathlib import Path

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.formats import patch_json, run_folder
from cadsculpt.formats.contacts_csv import ContactsWriter, read_contacts, read_forces
from cadsculpt.formats.run_folder import run_scene
from cadsculpt.formats.scene_toml import SceneFile
from cadsculpt.spline.surface import BSplineSurface

SCENE = """
schema = 1
name = "ball on plate"
units = "mm"
[[model]]
name = "plate"
file = "plate.json"
thickness = 4.0
nodes = 2.0
layers = 2
material = "clay"
[[tool]]
name = "ball"
shape = "sphere"
radius = 5.0
[[tool.path]]
t = 0.0
at = [10, 10, 5.2]
[[tool.path]]
t = 0.02
at = [10, 10, 4.2]
[[tool.path]]
t = 0.03
at = [10, 10, 5.5]
[solver]
step = 1e-3
resolution = 41
[output]
cad = ["step", "json"]
pictures = false
"""


@pytest.fixture
def scene(tmp_path) -> SceneFile:
    knots = np.array([0.0, 0, 0, 0, 20, 20, 20, 20])
    x = np.linspace(0, 20, 4)
    X, Y = np.meshgrid(x, x, indexing="ij")
    plate = BSplineSurface(np.stack([X, Y, 0 * X], axis=-1), knots, knots, 3, 3, name="plate")
    patch_json.write_surfaces(tmp_path / "plate.json", [plate], "mm")
    (tmp_path / "scene.toml").write_text(SCENE)
    return SceneFile.load(tmp_path / "scene.toml")


def test_everything_that_is_promised_is_there(scene, tmp_path):
    stages = []
    outcome = run_scene(scene, tmp_path / "run", on_progress=lambda p: stages.append(p.stage))
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert names == {
        "result.json", "surfaces.step", "surfaces.json", "series.pvd", "frames", "lattice.vtu", "contacts.csv",
        "forces.csv", "displacements.csv", "report.html",
    }  # fmt: skip
    assert list(dict.fromkeys(stages)) == ["compiling", "reading", "preparing", "running", "writing"]
    contacts, forces = read_contacts(tmp_path / "run" / "contacts.csv"), read_forces(tmp_path / "run" / "forces.csv")
    assert len(forces.step) == 30
    assert len(contacts.step) > 0
    # the tables balance: what the contacts do to the model, the tool feels the other way round
    for step in np.unique(contacts.step):
        total = contacts.force[contacts.step == step].sum(axis=0)
        np.testing.assert_allclose(forces.force[forces.step == step][0], -total, atol=1e-12)
    assert outcome.document["converged"]
    assert outcome.document["steps"] == 30


def test_two_runs_give_the_same_bytes(scene, tmp_path):
    for name in ("a", "b"):
        run_scene(scene, tmp_path / name)
    for path in sorted((tmp_path / "a").rglob("*")):
        if path.is_file() and path.name not in ("result.json", "report.html"):
            assert path.read_bytes() == (tmp_path / "b" / path.relative_to(tmp_path / "a")).read_bytes(), path.name
    a, b = (json.loads((tmp_path / name / "result.json").read_text()) for name in ("a", "b"))
    a.pop("timing"), b.pop("timing")
    assert a == b


def test_an_existing_folder_is_not_overwritten(scene, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "precious").write_text("x")
    with pytest.raises(InputError, match="--force"):
        run_scene(scene, tmp_path / "run")
    assert (tmp_path / "run" / "precious").exists()
    run_scene(scene, tmp_path / "run", force=True)
    assert not (tmp_path / "run" / "precious").exists()


def test_an_interrupted_run_goes_on_and_ends_the_same(scene, tmp_path, monkeypatch):
    run_scene(scene, tmp_path / "whole")
    monkeypatch.setattr(run_folder, "CHECKPOINT_SECONDS", 0.0)

    def interrupt(progress):
        if progress.stage == "running" and progress.done == 17:
            raise InputError("the caller gives up")

    with pytest.raises(InputError, match="gives up"):
        run_scene(scene, tmp_path / "cut", on_progress=interrupt)
    assert not (tmp_path / "cut").exists()
    assert (tmp_path / "cut.partial" / "checkpoint.npz").exists()
    with pytest.raises(InputError, match="--resume"):
        run_scene(scene, tmp_path / "cut")
    run_scene(scene, tmp_path / "cut", resume=True)
    assert not (tmp_path / "cut.partial").exists()
    for name in ("contacts.csv", "forces.csv", "surfaces.step", "surfaces.json", "series.pvd", "displacements.csv"):
        assert (tmp_path / "cut" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


def test_ctrl_c_waits_for_the_end_of_the_step(scene, tmp_path):
    """One Ctrl-C, long before the first checkpoint is due: nothing that was computed is lost."""
    run_scene(scene, tmp_path / "whole")

    def interrupt(progress):
        if progress.stage == "running" and progress.done == 12:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        run_scene(scene, tmp_path / "cut", on_progress=interrupt)
    seen = []
    run_scene(scene, tmp_path / "cut", resume=True, on_progress=lambda p: seen.append(p.done))
    assert next(done for done in seen if done) == 13
    for name in ("contacts.csv", "surfaces.json"):
        assert (tmp_path / "cut" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


def test_a_changed_scene_cannot_be_resumed(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(run_folder, "CHECKPOINT_SECONDS", 0.0)

    def interrupt(progress):
        if progress.done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_scene(scene, tmp_path / "run", on_progress=interrupt)
    scene.path.write_text(SCENE.replace("radius = 5.0", "radius = 5.1"))
    with pytest.raises(InputError, match="has changed"):
        run_scene(SceneFile.load(scene.path), tmp_path / "run", resume=True)


def test_nothing_to_resume(scene, tmp_path):
    with pytest.raises(InputError, match="no interrupted run"):
        run_scene(scene, tmp_path / "run", resume=True)


def test_a_full_disk_leaves_no_folder_and_can_be_resumed(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(run_folder, "CHECKPOINT_SECONDS", 0.0)

    def full(self, record):
        raise InputError(f"cannot be written: {errno.ENOSPC}", where="contacts.csv", mend="free some space")

    with monkeypatch.context() as patched:
        patched.setattr(ContactsWriter, "add", full)
        with pytest.raises(InputError, match="free some space"):
            run_scene(scene, tmp_path / "run")
    assert not (tmp_path / "run").exists()
    assert not (tmp_path / "run.partial" / "contacts.csv").exists()
    outcome = run_scene(scene, tmp_path / "run", resume=True)
    assert outcome.document["steps"] == 30
    assert (tmp_path / "run" / "contacts.csv").exists()


def test_a_tool_inside_the_part_is_named_before_anything_is_written(scene, tmp_path):
    scene.path.write_text(SCENE.replace("at = [10, 10, 5.2]", "at = [10, 10, 4.0]"))
    with pytest.raises(InputError, match="starts inside the part"):
        run_scene(SceneFile.load(scene.path), tmp_path / "run")
    assert not (tmp_path / "run").exists()
    assert not (tmp_path / "run.partial").exists()


def test_a_forced_sub_step_that_is_too_long_names_the_largest(scene, tmp_path):
    scene.path.write_text(SCENE.replace("step = 1e-3", "step = 1e-3\nsubstep = 9e-4"))
    with pytest.raises(InputError, match="largest that is stable"):
        run_scene(SceneFile.load(scene.path), tmp_path / "run")


def test_a_frame_is_written_for_every_time(scene, tmp_path):
    run_scene(scene, tmp_path / "run")
    text = Path(tmp_path / "run" / "series.pvd").read_text()
    frames = sorted((tmp_path / "run" / "frames").glob("frame_*.vtp"))
    assert text.count("<DataSet") == len(frames) >= 2
    assert 'timestep="0.0"' in text
