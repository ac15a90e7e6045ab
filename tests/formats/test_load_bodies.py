"""Which bodies of a CAD file may meet, and which faces hang together."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cadsculpt.formats.load import load
from cadsculpt.formats.scene_toml import SceneFile
from cadsculpt.model import Model
from cadsculpt.session import Session

PANEL = Path(__file__).parents[2] / "examples" / "thumb_press"


def model_of(*models: dict[str, Any]) -> Model:
    body = {"file": "panel.step", "thickness": 1.5, "nodes": 4.0, "layers": 2, "material": "clay"}
    path = [{"t": 0.0, "at": [0.0, 0.0, 40.0]}, {"t": 1.0, "at": [0.0, 0.0, 30.0]}]
    values = {
        "units": "mm",
        "model": [body | model for model in models],
        "tool": [{"name": "ball", "shape": "sphere", "radius": 8.0, "path": path}],
        "solver": {"resolution": 41},
    }
    return load(SceneFile.of(values, PANEL / "scene.toml")).model


def test_faces_of_one_solid_never_meet_as_two_models():
    model = model_of({"name": "one", "faces": ["top"]}, {"name": "two", "faces": ["side4"]})
    assert list(zip(model.pairs.a.tolist(), model.pairs.b.tolist(), strict=True)) == [(0, 2), (1, 2)]
    assert [group.patches for group in model.groups] == [(0,), (1,)]


def test_faces_of_one_model_are_tied_where_they_meet():
    """The trimmed top of the panel, two of its sides and its hole: one group, tied along every common edge, and not to the
    side that is left out."""
    model = model_of({"name": "panel", "faces": ["top", "side4", "hole"]})
    assert [group.patches for group in model.groups] == [(0, 1, 2)]
    ties = model.groups[0].lattice.ties
    starts = model.groups[0].assembly.starts
    owners = {sum(node >= start for start in starts) - 1 for node in (*ties.nodes, *ties.masters)}
    assert owners == {0, 1, 2}
    apart = model_of({"name": "panel", "faces": ["top", "bottom"]})
    assert [len(group.patches) for group in apart.groups] == [1, 1]


def test_a_hand_is_one_tool_of_six_surfaces():
    """Each held at its base, none tied to another: they press the panel one by one, and together."""
    body = {"file": "panel.step", "faces": ["top"], "thickness": 1.5, "nodes": 6.0, "layers": 1, "material": "foam"}
    path = [{"t": 0.0, "at": [-80.0, 0.0, 22.0]}, {"t": 0.05, "at": [-80.0, 0.0, 15.5]}]
    values = {
        "units": "mm",
        "model": [body | {"name": "panel"}],
        "tool": [{"name": "hand", "use": "hand", "path": path}],
        "solver": {"resolution": 41, "step": 2.5e-3, "max_penetration": 0.5},
    }
    model = load(SceneFile.of(values, PANEL / "scene.toml")).model
    assert [patch.name for patch in model.patches[1:]] == ["palm", "index", "middle", "ring", "little", "thumb"]
    assert {patch.body for patch in model.patches[1:]} == {1}
    for patch in model.patches[1:]:
        anchored = patch.lattice.anchored.reshape(patch.lattice.shape)
        assert anchored[..., -1].all()
        assert not anchored[:, 2:-2, 0].any()
    assert [group.patches for group in model.groups] == [tuple(range(7))]
    session = Session(model)
    for _ in range(20):
        reaction = session.step()["hand"]
    fingers = {model.patches[1 + k].name for k in session.contacts.tool_face}
    assert "middle" in fingers
    assert reaction.force[2] > 0.0
    pressed = [float(abs(session.displacement(i)).max()) for i in range(1, 7)]
    assert max(pressed) > 0.05
    # what nothing touches keeps its shape, but for what trembles with the tool's first step
    assert all(moved < 0.01 for k, moved in enumerate(pressed) if model.patches[1 + k].name not in fingers)
