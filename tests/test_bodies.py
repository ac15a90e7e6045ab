"""Bodies of every kind against each other: deformable and rigid tools and models, in any pair."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.model import Model, SourceBody, build_model
from cadsculpt.motion.path import ToolPath
from cadsculpt.motion.pose import Pose
from cadsculpt.patch import SourceFace
from cadsculpt.run import run
from cadsculpt.scene import ExpectSpec, Scene
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface

STUFF = {"youngs_modulus": 1.0e5, "density": 1000.0, "damping": 1.0, "friction": 0.0}
DEEP, NODES = 4.0, 2.0


def sheet(size: float, *, up: bool = True, dome: float = 0.0, name: str = "face") -> BSplineSurface:
    """A bicubic square around the z axis at z = 0; its normal points up, or down. dome : how far its middle stands out."""
    knots = np.array([0.0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1])
    t = size * (np.array([knots[i + 1 : i + 4].mean() for i in range(7)]) - 0.5)
    X, Y = np.meshgrid(t, t, indexing="ij")
    Z = (1.0 if up else -1.0) * dome * (1.0 - (X**2 + Y**2) / (0.5 * size) ** 2)
    return BSplineSurface(np.stack([X, Y, Z], axis=-1), knots, knots, 3, 3, outward=up, name=name)


def moved(surface: BSplineSurface, by: list[float]) -> BSplineSurface:
    return surface.with_control_points(surface.control_points + np.array(by))


def model_of(
    models: list[tuple[BSplineSurface, dict[str, Any]]],
    tools: list[tuple[BSplineSurface | None, dict[str, Any]]],
    stuff: dict[str, Any] = STUFF,
    **solver: Any,
) -> Model:
    """Models and tools, each of one surface and with further keys; a tool without one has a shape of its own."""
    body = {"thickness": DEEP, "nodes": NODES, "layers": 2, "material": "stuff"}
    scene = Scene.model_validate(
        {
            "units": "mm",
            "material": {"stuff": stuff},
            "model": [
                {"name": f"model {i}", "file": "none"} | ({} if keys.get("rigid") else body) | keys
                for i, (_, keys) in enumerate(models)
            ],
            "tool": [
                {"name": f"tool {i}"} | ({} if surface is None else {"shape": "surface", "file": "none"}) | keys
                for i, (surface, keys) in enumerate(tools)
            ],
            "solver": {"resolution": 21, "step": 1e-3, "max_penetration": 0.5} | solver,
            "refit": {"tolerance": 0.05},
        }
    )
    paths = {tool.name: ToolPath.of_rows(tool.path) for tool in scene.tool}  # type: ignore[arg-type]
    faces = {
        tool.name: [SourceFace(1, surface.name, surface)]
        for tool, (surface, _) in zip(scene.tool, tools, strict=True)
        if surface is not None
    }
    bodies = [
        SourceBody(spec.name, (SourceFace(1, surface.name, surface),))
        for spec, (surface, _) in zip(scene.model, models, strict=True)
    ]
    rigid = {name: [face.surface for face in found] for name, found in faces.items()}
    return build_model(scene, bodies, paths, rigid, None, faces)


def rows(*places: tuple[float, float, float, float], turn: tuple[float, ...] = ()) -> list[dict[str, Any]]:
    return [{"t": t, "at": [x, y, z]} | ({"turn": list(turn)} if turn and t > 0 else {}) for t, x, y, z in places]


SOFT = {"material": "stuff", "thickness": DEEP, "nodes": NODES, "layers": 2}
PRESS = rows((0.0, 0, 0, 0.2), (0.06, 0, 0, -0.4), (0.12, 0, 0, -0.4))


def settled(model: Model) -> Session:
    session = Session(model)
    for k in range(model.steps):
        session.step(dt=model.step_length(k))
    return session


def test_a_deformable_tool_presses_a_rigid_model_as_a_layer_on_its_base_does():
    """A flat pad, held by its back, against a rigid plane: between the modulus of a free bar and that of a confined layer,
    1.2 E at a Poisson's ratio of 1/4."""
    model = model_of([(sheet(40.0), {"rigid": True})], [(sheet(16.0, up=False), {**SOFT, "path": PRESS})])
    assert [patch.body for patch in model.patches] == [1]
    assert len(model.rigid_faces) == 1
    session = settled(model)
    pressed = session.displacement(0)[..., 2]
    assert pressed == pytest.approx(0.4, abs=0.02)
    force = session.step()["tool 0"].force
    strain = pressed.mean() / DEEP
    bar = STUFF["youngs_modulus"] * 1e-6 * 16.0**2 * strain  # type: ignore[operator]
    assert bar < force[2] < 1.2 * bar
    assert np.abs(force[:2]).max() < 1e-3 * force[2]
    # nothing of the rigid model moves: there is nothing to fit
    assert len(session.state.control_points) == 1


def test_it_does_not_matter_which_of_two_bodies_is_the_tool():
    """A soft pad on a rigid plane, and a rigid plane on a soft pad: one force."""
    soft, hard = sheet(16.0, up=False, dome=1.0), sheet(40.0)
    first = model_of([(hard, {"rigid": True})], [(soft, {**SOFT, "path": PRESS})], resolution=41)
    flat, pad = sheet(40.0, up=False), sheet(16.0, dome=1.0)
    second = model_of([(pad, {})], [(flat, {"path": PRESS})], resolution=41)
    force = []
    for model, lift in ((first, 1.0), (second, 1.0)):
        path = model.tools[0].path
        session = Session(model)
        for k in range(1, 101):
            pose = path.pose(1e-3 * k)
            reaction = session.step({"tool 0": Pose(pose.at + [0.0, 0.0, lift])}, 1e-3)["tool 0"]
        force.append(reaction.force[2])
    assert force[0] > 0.05
    assert force[1] == pytest.approx(force[0], rel=0.03)


def test_two_equal_bodies_give_way_by_half_each():
    model = model_of([(sheet(16.0, dome=1.0), {})], [(sheet(16.0, up=False, dome=1.0), {**SOFT, "path": PRESS})])
    session = Session(model)
    assert [group.patches for group in model.groups] == [(0, 1)]
    path, touching = model.tools[0].path, 2.0 * sheet(16.0, dome=1.0).evaluate(0.5, 0.5)[2]
    for k in range(1, 101):
        session.step({"tool 0": Pose(path.pose(1e-3 * k).at + [0.0, 0.0, touching])}, 1e-3)
    mine, its = session.displacement(0), session.displacement(1)
    left = float(session.depths.max())
    assert -mine[..., 2].min() == pytest.approx(0.2, abs=0.03)
    assert its[..., 2].max() == pytest.approx(-mine[..., 2].min(), rel=0.02)
    assert its[..., 2].max() - mine[..., 2].min() + left == pytest.approx(0.4, abs=0.03)
    # the force on the one is the force on the other
    reaction = session.step({"tool 0": session.state.poses[0]}, 1e-3)["tool 0"]
    np.testing.assert_allclose(reaction.force, -session.forces.sum(axis=0), atol=1e-12 * np.abs(session.forces).sum())


def test_a_tool_that_flies_and_turns_keeps_its_shape():
    """Held nodes go where the path leads them and the others have its velocity from the start: nothing deforms, and the net
    keeps its bits."""
    path = rows((0.0, 0, 0, 50), (0.05, 10, 5, 50))
    model = model_of([(sheet(16.0), {})], [(sheet(16.0, up=False), {**SOFT, "path": path})])
    session = settled(model)
    assert np.abs(session.displacement(1)).max() < 1e-9
    np.testing.assert_array_equal(session.state.control_points[1], model.patches[1].surface.control_points)
    # turning swings the outside outwards by omega^2 r / (E / density / thickness), far below a thousandth of the size
    path = rows((0.0, 0, 0, 50), (0.5, 10, 5, 50), turn=(0.0, 1.0, 0.0, 90.0))
    session = settled(model_of([(sheet(16.0), {})], [(sheet(16.0, up=False), {**SOFT, "path": path})], step=1e-2))
    assert np.abs(session.displacement(1)).max() < 5e-3
    x, rest = session.lattice(1).x, session.model.patches[1].lattice.nodes
    np.testing.assert_allclose(x, session.state.poses[0].to_world(rest), atol=5e-3)


def test_one_answer_from_every_integrator():
    """At rest after the press the explicit, the implicit and the quasi-static tool are one."""
    found = []
    for solver in ({}, {"integrator": "implicit"}, {"integrator": "implicit", "quasi_static": True}):
        step = 1e-3 if not solver else 0.02
        tool = {**SOFT, "path": rows((0.0, 0, 0, 0.1), (0.06, 0, 0, -0.4), (0.12, 0, 0, -0.4))}
        model = model_of([(sheet(40.0), {"rigid": True})], [(sheet(16.0, up=False), tool)], step=step, **solver)
        session = settled(model)
        found.append((session.step()["tool 0"].force[2], session.displacement(0)))
    force = [f for f, _ in found]
    assert force == pytest.approx([force[0]] * 3, rel=0.01)
    for _, displacement in found[1:]:
        np.testing.assert_allclose(displacement, found[0][1], atol=0.01)


def test_a_soft_tool_is_pushed_with_a_force():
    tool = {**SOFT, "path": rows((0.0, 0, 0, 0.1), (0.1, 0, 0, -1.0)), "control": "force", "force": 1.0}
    session = Session(model_of([(sheet(40.0), {"rigid": True})], [(sheet(16.0, up=False), tool)], step=2e-3))
    for _ in range(45):
        reaction = session.step()["tool 0"]
    assert reaction.force[2] == pytest.approx(1.0, rel=0.01)
    # E A strain, within what the sides hold back
    strain = session.displacement(0)[..., 2].mean() / DEEP
    assert 1.0 < 1.0 / (0.1 * 16.0**2 * strain) < 1.2


def test_a_tool_of_plastic_material_keeps_a_set():
    """Pressed beyond its yield strain and lifted: the set is the strain less what springs back, by linear hardening."""
    stuff = STUFF | {"yield_strain": 0.02, "hardening": 0.2}
    path = rows((0.0, 0, 0, 0.1), (0.06, 0, 0, -0.4), (0.10, 0, 0, -0.4), (0.14, 0, 0, 5.0), (0.2, 0, 0, 5.0))
    session = settled(
        model_of([(sheet(40.0), {"rigid": True})], [(sheet(16.0, up=False), {**SOFT, "path": path})], stuff=stuff)
    )
    assert len(session.contacts) == 0
    left = session.displacement(0)[..., 2]
    # sigma / E = yield + hardening (strain - yield) is what springs back
    expected = DEEP * (0.1 - (0.02 + 0.2 * (0.1 - 0.02)))
    assert left[3:-3, 3:-3].mean() == pytest.approx(expected, rel=0.15)


def test_two_tools_of_which_one_is_soft_press_each_other():
    path = rows((0.0, 0, 0, 30), (0.3, 0, 0, 30))
    ball = {"shape": "sphere", "radius": 6.0, "path": rows((0.0, 0, 0, 23.9), (0.05, 0, 0, 24.4), (0.3, 0, 0, 24.4))}
    tools = [(None, ball), (sheet(16.0, up=False), {**SOFT, "path": path})]
    model = model_of([(sheet(16.0), {"rigid": True})], tools)
    # contacts lie on the soft one, though it comes second
    assert list(zip(model.pairs.a.tolist(), model.pairs.b.tolist(), strict=True)) == [(0, 1), (0, 2), (2, 1)]
    session = Session(model)
    for _ in range(120):
        reaction = session.step()
    assert set(session.contacts.a.tolist()) == {2}
    assert reaction["tool 1"].force[2] > 0.01
    np.testing.assert_allclose(reaction["tool 0"].force, -reaction["tool 1"].force, atol=1e-12)
    assert session.displacement(0)[..., 2].max() == pytest.approx(0.4, abs=0.03)


def test_only_what_may_meet_is_integrated_together():
    near = rows((0.0, 0, 0, 5), (0.1, 0, 0, 3))
    far = rows((0.0, 200, 0, 5), (0.1, 200, 0, 3))
    soft = sheet(16.0, up=False)
    tools = [(soft, {**SOFT, "path": near}), (soft, {**SOFT, "path": far})]
    model = model_of([(sheet(16.0), {})], tools)
    assert [group.patches for group in model.groups] == [(0, 1), (2,)]
    assert model.pairs.a.tolist() == [0, 0, 1]
    assert model.pairs.b.tolist() == [1, 2, 2]
    assert model.pairs.meet.tolist() == [True, False, False]
    # a program may take it anywhere
    session = Session(model)
    session.step({"tool 1": Pose(np.array([150.0, 0.0, 5.0]))}, 1e-3)
    assert [len(state.x) for state in session.state.lattices] == [3 * len(model.patches[0].lattice.nodes)]
    assert np.abs(session.lattice(2).x[model.patches[2].lattice.anchored][:, 0].mean() - 150.0) < 1e-9


def test_a_run_goes_on_from_its_arrays():
    model = model_of([(sheet(16.0, dome=1.0), {})], [(sheet(16.0, up=False), {**SOFT, "path": PRESS})])
    whole, first = Session(model), Session(model)
    poses = [Pose(np.array([0.0, 0.0, 1.2 - 0.02 * k])) for k in range(20)]
    for pose in poses:
        whole.step({"tool 0": pose}, 1e-3)
    for pose in poses[:10]:
        first.step({"tool 0": pose}, 1e-3)
    again = Session(model)
    again.restore({key: np.array(value) for key, value in first.arrays().items()})
    for pose in poses[10:]:
        again.step({"tool 0": pose}, 1e-3)
    assert len(whole.contacts) > 0
    for a, b in zip(whole.arrays().items(), again.arrays().items(), strict=True):
        assert a[0] == b[0]
        np.testing.assert_array_equal(a[1], b[1])


def test_what_a_tool_lacks_is_said_with_its_name():
    knots = np.linspace(-0.375, 1.375, 15)
    angle = 2.0 * np.pi * np.arange(11) / 8.0
    ring = 3.0 * np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=1)
    net = ring[:, None] + np.array([0.0, 1.0, 0.0]) * np.arange(0.0, 20.0, 5.0)[:, None]
    ends = np.array([0.0, 0, 0, 0, 1, 1, 1, 1])
    bent = BSplineSurface(net, knots, ends, 3, 3, periodic_u=True, outward=False, name="tip")
    with pytest.raises(InputError, match=r"tool 'tool 0', face 'tip': a thickness of .* folds the lattice"):
        model_of([(sheet(16.0), {"rigid": True})], [(bent, {**SOFT, "path": PRESS})])
    nowhere = {**SOFT, "hold": [{"u": [2.0, 3.0]}], "path": PRESS}
    with pytest.raises(InputError, match="tool 'tool 0': nothing of it is held"):
        model_of([(sheet(16.0), {"rigid": True})], [(sheet(16.0, up=False), nowhere)])


@pytest.mark.parametrize(
    ("model", "tool", "fault"),
    [
        ({"rigid": True, "thickness": 3.0}, {"shape": "point"}, "thickness belongs to a model of material"),
        ({"rigid": True}, {"shape": "point"}, "nothing deforms"),
        ({"ridgid": True}, {"shape": "point"}, "did you mean rigid"),
        ({}, {"shape": "point"}, "thickness is missing"),
        (
            {"rigid": True},
            {"shape": "surface", "file": "f", "material": "foam", "thickness": 1.0, "nodes": 1.0, "hold": "none"},
            'hold "none" leaves the tool without a hold',
        ),
    ],
)
def test_rigid_models_in_scenes(model, tool, fault):
    with pytest.raises(ValueError, match=fault):
        Scene.model_validate(
            {"units": "mm", "model": [{"name": "m", "file": "f"} | model], "tool": [{"name": "t"} | tool]}
        )


def test_an_expectation_of_a_pair_that_never_meets_is_refused():
    point: tuple[None, dict[str, Any]] = (None, {"shape": "point", "path": PRESS})
    model = model_of([(sheet(16.0), {})], [point, point])
    asked = ExpectSpec(what="max_force", pair=("tool 0", "tool 1"), at_most=1.0)
    with pytest.raises(InputError, match="no contact is ever looked for between 'tool 0' and 'tool 1'"):
        run(replace(model, scene=model.scene.model_copy(update={"expect": (asked,)})))
