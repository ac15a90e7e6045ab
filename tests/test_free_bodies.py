"""Bodies that nothing holds: they keep their momentum, move as a whole, and meet other models."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.model import Model, SourceBody, build_model
from cadsculpt.motion.path import ToolPath
from cadsculpt.motion.pose import Pose
from cadsculpt.patch import SourceFace
from cadsculpt.run import run
from cadsculpt.scene import Scene
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface

STUFF = {"youngs_modulus": 3.0e5, "density": 1000.0, "damping": 1.0, "friction": 0.0}


def sheet(size: float, at: tuple[float, float, float], *, up: bool = True, dome: float = 0.0) -> BSplineSurface:
    knots = np.array([0.0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1])
    t = size * (np.array([knots[i + 1 : i + 4].mean() for i in range(7)]) - 0.5)
    X, Y = np.meshgrid(t, t, indexing="ij")
    Z = (1.0 if up else -1.0) * dome * (1.0 - (X**2 + Y**2) / (0.5 * size) ** 2)
    net = np.stack([X, Y, Z], axis=-1) + np.array(at)
    return BSplineSurface(net, knots, knots, 3, 3, outward=up)


def ball(radius: float, at: tuple[float, float, float]) -> BSplineSurface:
    """A whole ball, nearly: bicubic, periodic around y, with poles at both ends along y."""
    around, along = 16, 13
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, along - 2), np.ones(3)])
    angle = 2.0 * np.pi * (np.arange(around + 3) % around) / around
    tilt = np.pi * np.array([knots[i + 1 : i + 4].mean() for i in range(along)])
    ring = np.sin(tilt) * radius
    net = np.stack(
        [
            ring * np.cos(angle)[:, None],
            np.tile(-radius * np.cos(tilt), (around + 3, 1)),
            ring * np.sin(angle)[:, None],
        ],
        axis=-1,
    )
    u = np.arange(-3.0, around + 4.0) / around
    surface = BSplineSurface(net + np.array(at), u, knots, 3, 3, periodic_u=True)
    outside = surface.evaluate(0.25, 0.5) - np.array(at)
    return surface if outside @ surface.normal(0.25, 0.5) > 0 else BSplineSurface(
        net + np.array(at), u, knots, 3, 3, periodic_u=True, outward=False
    )  # fmt: skip


def model_of(
    models: list[tuple[BSplineSurface, dict[str, Any]]],
    rows: list[tuple[float, list[float]]],
    tool: dict[str, Any] | None = None,
    **solver: Any,
) -> Model:
    """Models of one surface each, and a ball of 5 mm, or another tool, on a path."""
    body = {"thickness": 3.0, "nodes": 2.0, "layers": 2, "material": "stuff"}
    path = [{"t": t, "at": [float(c) for c in at]} for t, at in rows]
    scene = Scene.model_validate(
        {
            "units": "mm",
            "material": {"stuff": STUFF},
            "model": [{"name": f"model {i}", "file": "none"} | body | keys for i, (_, keys) in enumerate(models)],
            "tool": [{"name": "ball", "path": path} | (tool or {"shape": "sphere", "radius": 5.0})],
            "solver": {"resolution": 21, "step": 1e-3, "max_penetration": 0.5} | solver,
            "refit": {"tolerance": 0.05},
        }
    )
    bodies = [SourceBody(f"model {i}", (SourceFace(1, "face", surface),)) for i, (surface, _) in enumerate(models)]
    return build_model(scene, bodies, {"ball": ToolPath.of_rows(scene.tool[0].path)})  # type: ignore[arg-type]


FREE = {"anchor": "none"}
AWAY = [(0.0, [0, 0, 100]), (0.1, [0, 0, 101])]


def test_what_a_tool_gives_a_free_body_is_its_momentum():
    """An off-centre push sets it moving and turning: the impulse of the reaction is the body's momentum, and stays."""
    model = model_of([(sheet(16.0, (0, 0, 0)), FREE)], [(0.0, [3, 1, 5.2]), (0.02, [3, 1, 4.0]), (0.03, [3, 1, 30.0])])
    assert model.free == {0}
    session = Session(model)
    impulse = np.zeros(3)
    momentum = []
    mass = model.patches[0].lattice.mass
    for _ in range(60):
        impulse -= session.step(dt=1e-3)["ball"].force * 1e-3
        momentum.append(mass @ session.lattice(0).velocity)
    assert np.abs(impulse[2]) > 1e-8
    np.testing.assert_allclose(momentum[-1], impulse, rtol=1e-6, atol=1e-6 * np.abs(impulse).max())
    np.testing.assert_allclose(momentum[-1], momentum[35], rtol=1e-9, atol=1e-9 * np.abs(impulse).max())
    # it has moved and turned, and its surface with it, though hardly bent any more
    net = session.state.control_points[0]
    assert np.abs(net - model.patches[0].surface.control_points).max() > 1.0
    assert session.refit_error(0).maximum < 0.02


def test_moving_as_a_whole_deforms_nothing():
    """Far away and turned by a large angle, the net is the rest net turned, to rounding."""
    for surface in (sheet(16.0, (5, 3, 0), dome=2.0), ball(6.0, (5, 3, 0))):
        model = model_of([(surface, FREE)], AWAY)
        session = Session(model)
        pose = Pose.turned([40.0, -20.0, 7.0], (1.0, 2.0, -0.5), 110.0)
        state, patch = session.state.lattices[0], model.patches[0]
        state.x[:] = pose.to_world(patch.lattice.nodes)
        session.step(dt=1e-6)
        np.testing.assert_allclose(
            session.state.control_points[0], pose.to_world(patch.surface.control_points), atol=1e-9
        )
        assert session.refit_error(0).maximum < 1e-9
        # and back: the bits of the file
        state.x[:], state.velocity[:] = patch.lattice.nodes, 0.0
        session.step(dt=1e-6)
        np.testing.assert_array_equal(session.state.control_points[0], patch.surface.control_points)


def test_a_thrown_body_meets_another_model():
    """Thrown down at 100 mm/s from 1 mm above: they meet after 10 ms, it gives its momentum to the anchored one, and comes
    back."""
    low, high = sheet(24.0, (0, 0, 0)), sheet(12.0, (0, 0, 1.0), up=False)
    scene_pair = model_of([(low, {}), (high, FREE)], AWAY)
    assert scene_pair.pairs.a.tolist() == [0, 0, 1]
    assert scene_pair.pairs.b.tolist() == [1, 2, 2]
    assert [group.patches for group in scene_pair.groups] == [(0, 1)]
    session = Session(scene_pair)
    session.lattice(1).velocity[:] = [0.0, 0.0, -100.0]
    mass = scene_pair.patches[1].lattice.mass
    before = mass @ session.lattice(1).velocity
    result = run(session)
    assert result.converged
    pair = scene_pair.pairs.index(1, 0)
    assert result.history.first_contact(pair) == pytest.approx(0.010, abs=1.1e-3)
    assert result.history.greatest("penetration", pair) < 0.5
    impulse = result.history.force[:, pair].sum() * 1e-3
    after = mass @ session.lattice(1).velocity
    # (the depth of the contact is felt along the normal alone: all impulses are upwards)
    assert after[2] - before[2] == pytest.approx(impulse, rel=1e-3)
    assert 0.0 < after[2] < -before[2]
    assert np.abs(session.displacement(0)).max() < 1.0
    assert result.summary.first_contact == result.history.first_contact(pair)


def test_a_ball_between_a_tool_and_a_plate_is_pressed_alike_from_both_sides():
    model = model_of(
        [(sheet(24.0, (0, 0, 0)), {}), (ball(6.0, (0, 0, 5.9)), FREE)],
        [(0.0, [0, 0, 12.0]), (0.03, [0, 0, 11.0]), (0.15, [0, 0, 11.0])],
        {"shape": "half_space"},
    )
    session = Session(model)
    plate, pressed = [], []
    for k in range(model.steps):
        reaction = session.step(dt=model.step_length(k))["ball"]
        contacts = session.contacts
        below = contacts.b == 1
        on_plate, on_ball = session.forces[below].sum(axis=0), session.forces[~below].sum(axis=0)
        np.testing.assert_allclose(on_ball, -reaction.force, atol=1e-12)
        plate.append(on_plate[2])
        pressed.append(on_ball[2])
    assert set(zip(contacts.a.tolist(), contacts.b.tolist(), strict=True)) == {(0, 1), (1, 2)}
    # what the tool presses with goes through the ball into the plate; the ball trembles between them
    last = model.steps // 4
    assert np.mean(plate[-last:]) < -0.01
    assert np.mean(plate[-last:]) == pytest.approx(np.mean(pressed[-last:]), rel=0.02)


def test_nothing_holds_a_quasi_static_body():
    with pytest.raises(InputError, match="a quasi-static body that nothing holds"):
        model_of([(sheet(16.0, (0, 0, 0)), FREE)], AWAY, integrator="implicit", quasi_static=True)


def test_models_that_start_inside_each_other_are_refused():
    model = model_of([(sheet(24.0, (0, 0, 0)), {}), (sheet(12.0, (0, 0, -1.0), up=False), {})], AWAY)
    with pytest.raises(InputError, match="the part 'model 0' starts inside the part 'model 1', 1 mm deep"):
        run(model)
