"""The heart: a session steps a plate under a ball, and a run loops over it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.model import Model, SourceBody, build_model
from cadsculpt.motion.path import ToolPath
from cadsculpt.motion.pose import Pose
from cadsculpt.patch import SourceEdge, SourceFace
from cadsculpt.run import Hooks, run
from cadsculpt.scene import Scene
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

SIZE = 40.0


def plate(*, rational: bool = False, trims: tuple[TrimLoop, ...] | None = None) -> BSplineSurface:
    """A flat bicubic plate over [0, 40] x [0, 40], parameters in mm."""
    knots = np.concatenate([np.zeros(4), [13.0, 27.0], np.full(4, SIZE)])
    x = np.array([knots[i + 1 : i + 4].mean() for i in range(6)])
    X, Y = np.meshgrid(x, x, indexing="ij")
    weights = np.full((6, 6), 0.7) if rational else None
    return BSplineSurface(np.stack([X, Y, 0 * X], axis=-1), knots, knots, 3, 3, weights, name="plate", trims=trims)


def model_of(
    *,
    material: str = "clay",
    rows: list[tuple[float, list[float]]] | None = None,
    surface: BSplineSurface | None = None,
    edges: tuple[SourceEdge, ...] = (),
    units: str = "mm",
    **changes: object,
) -> Model:
    rows = rows or [(0.0, [20, 20, 8.5]), (0.03, [20, 20, 6.5]), (0.05, [20, 20, 9.0]), (0.08, [20, 20, 9.0])]
    scene = Scene.model_validate(
        {
            "units": units,
            "model": [
                {"name": "plate", "file": "plate", "thickness": 6.0, "nodes": 2.0, "layers": 2, "material": material}
                | changes
            ],
            "tool": [
                {
                    "name": "ball",
                    "shape": "sphere",
                    "radius": 8.0,
                    "path": [{"t": t, "at": [float(c) for c in at]} for t, at in rows],
                }
            ],
            "solver": {"resolution": 61, "step": 1e-3, "max_penetration": 0.2},
            "refit": {"tolerance": 0.05},
        }
    )
    face = SourceFace(1, "plate", surface or plate(), edges)
    paths = {tool.name: ToolPath.of_rows(tool.path) for tool in scene.tool}  # type: ignore[arg-type]
    return build_model(scene, [SourceBody("plate", (face,))], paths)


def test_the_reaction_balances_the_contact_forces():
    session = Session(model_of())
    for _ in range(25):
        reaction = session.step()["ball"]
    assert len(session.contacts) > 3
    np.testing.assert_allclose(reaction.force, -session.forces.sum(axis=0), atol=1e-12 * np.abs(session.forces).sum())
    assert reaction.force[2] > 0  # the plate pushes the ball up
    assert abs(reaction.force[0]) < 1e-6 * reaction.force[2]  # and nowhere else: the press is symmetric
    assert reaction.contact_area > 0
    assert reaction.max_penetration < 0.2


def test_torque_is_about_the_tools_origin():
    rows = [(0.0, [20, 20, 8.5]), (0.03, [20, 20, 6.5]), (0.06, [26, 20, 6.5])]
    session = Session(model_of(rows=rows))
    for _ in range(45):
        reaction = session.step()["ball"]
    # pressure on a ball goes through its centre; only friction, at 8 mm from it and below it, turns it about y
    assert reaction.force[0] < 0
    normal = np.einsum("nc,nc->n", session.forces, session.contacts.normal)
    friction = session.forces - normal[:, None] * session.contacts.normal
    assert 0 < reaction.torque[1] <= 8e-3 * np.abs(friction).sum() * 1.01
    assert reaction.torque[1] == pytest.approx(8e-3 * friction[:, 0].sum(), rel=0.1)


def test_clay_keeps_the_dent_and_rubber_does_not():
    kept, sprung = (run(model_of(material=material)) for material in ("clay", "rubber"))
    for result in (kept, sprung):
        assert result.converged
        assert result.summary.max_displacement > 1.0
    deepest = [result.session.displacement(0)[..., 2].min() for result in (kept, sprung)]
    assert deepest[0] < -0.5
    assert abs(deepest[1]) < 0.05
    nodes = kept.session.displacement(0)[..., 2]
    patch = kept.session.model.patches[0]
    i, j = np.unravel_index(nodes.argmin(), nodes.shape)
    assert patch.u[i] == pytest.approx(20.0, abs=2.0)
    assert patch.v[j] == pytest.approx(20.0, abs=2.0)


def test_first_contact_is_when_the_ball_arrives():
    result = run(model_of())
    # 8.5 to 6.5 in 0.03 s: at 8.0 after 7.5 ms
    assert result.summary.first_contact == pytest.approx(0.0075, abs=1.1e-3)


def test_control_points_away_from_the_dent_keep_their_bits():
    result = run(model_of(rows=[(0.0, [20, 20, 8.5]), (0.03, [20, 20, 7.5]), (0.06, [20, 20, 9.0])]))
    patch = result.session.model.patches[0]
    net, rest = result.session.state.control_points[0], patch.surface.control_points
    moved = (net != rest).any(axis=2)
    assert moved.any()
    assert not moved.all()
    assert not moved[[0, -1]].any()
    assert not moved[:, [0, -1]].any()
    assert result.summary.refit_max_error < 0.05


@pytest.mark.parametrize("rational", [False, True])
def test_a_held_edge_stays_exactly_where_it_was(rational):
    line = np.stack([np.full(50, 26.0), np.linspace(0, SIZE, 50)], axis=1)
    edge = SourceEdge(line, neighbours=("side",))
    model = model_of(surface=plate(rational=rational), edges=(edge,))
    result = run(model)
    before, after = model.patches[0].surface, result.session.surface(0)
    v = np.linspace(0, SIZE, 201)
    np.testing.assert_array_equal(after.evaluate(26.0, v), before.evaluate(26.0, v))
    assert np.abs(after.evaluate(20.0, 20.0) - before.evaluate(20.0, 20.0)).max() > 0.3


def test_no_contact_in_a_hole():
    t = np.linspace(0, 2 * np.pi, 41)
    corners = np.stack([20 + 7 * np.cos(t), 20 + 7 * np.sin(t)], axis=1)
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    hole = TrimLoop(tuple(TrimCurve(corners[i : i + 2], knots, 1) for i in range(40)), outer=False)
    square = np.array([[0.0, 0], [SIZE, 0], [SIZE, SIZE], [0, SIZE], [0, 0]])
    outer = TrimLoop(tuple(TrimCurve(square[i : i + 2], knots, 1) for i in range(4)))
    rows = [(0.0, [20, 20, 8.5]), (0.04, [20, 20, 4.5])]
    model = model_of(surface=plate(trims=(outer, hole)), rows=rows)
    session = Session(model)
    radius = []
    for _ in range(model.steps):
        session.step()
        radius += list(np.hypot(session.contacts.u - 20, session.contacts.v - 20))
    # a ball of radius 8 sunk by 3.5 mm is 6.6 mm wide at z = 0: it goes through the hole without touching
    assert radius == []


def test_two_runs_are_the_same_to_the_bit():
    first, second = run(model_of()), run(model_of())
    np.testing.assert_array_equal(first.session.state.control_points[0], second.session.state.control_points[0])
    np.testing.assert_array_equal(first.history.force, second.history.force)


def test_a_run_resumed_from_a_checkpoint_ends_the_same():
    kept: dict[str, np.ndarray] = {}

    def save(step, arrays):
        if step == 20:
            kept.update({key: np.array(value) for key, value in arrays().items()})

    whole = run(model_of(), hooks=Hooks(on_checkpoint=save))
    rest = run(model_of(), resume=kept)
    np.testing.assert_array_equal(whole.session.state.control_points[0], rest.session.state.control_points[0])
    np.testing.assert_array_equal(whole.history.depth, rest.history.depth)
    assert whole.summary == rest.summary


def test_a_checkpoint_of_another_scene_is_refused():
    session = Session(model_of())
    with pytest.raises(InputError, match="another scene"):
        Session(model_of(nodes=3.0)).restore(session.arrays())


def test_a_tool_that_starts_inside_is_named():
    with pytest.raises(InputError, match="'ball' starts inside the part 'plate'"):
        run(model_of(rows=[(0.0, [20, 20, 5.0]), (0.01, [20, 20, 5.0])]))


def test_an_outer_loop_may_move_the_tools():
    session = Session(model_of())
    for z in np.linspace(8.5, 7.0, 15):
        reaction = session.step({"ball": Pose(np.array([20.0, 20.0, z]))}, dt=1e-3)
    assert reaction["ball"].force[2] > 0
    with pytest.raises(InputError, match="no tool named 'bal'"):
        session.step({"bal": Pose()})
    with pytest.raises(InputError, match="positive time"):
        session.step(dt=0.0)


def test_the_unit_does_not_change_the_physics():
    """The same plate in mm and in inches: forces in N agree."""
    mm = run(model_of())
    inch = 25.4
    rows = [
        (t, [c / inch for c in at]) for t, at in [(0.0, [20, 20, 8.5]), (0.03, [20, 20, 6.5]), (0.05, [20, 20, 9.0])]
    ]
    scene = model_of(rows=[(t, [20.0 * 0, 0, 0]) for t, _ in rows]).scene  # the mm scene's text, to be changed
    data = json.loads(scene.model_dump_json(by_alias=True, exclude_none=True))
    data["units"] = "in"
    data["model"][0] |= {"thickness": 6.0 / inch, "nodes": 2.0 / inch}
    data["tool"][0] |= {"radius": 8.0 / inch, "path": [{"t": t, "at": at} for t, at in rows]}
    data["solver"] |= {"max_penetration": 0.2 / inch, "tolerance": scene.solver.tolerance / inch}
    data["refit"] |= {"tolerance": 0.05 / inch}
    other = Scene.model_validate(data)
    face = SourceFace(1, "plate", plate().scaled(1 / inch))
    model = build_model(other, [SourceBody("plate", (face,))], {"ball": ToolPath.of_rows(other.tool[0].path)})
    result = run(model)
    assert result.summary.max_force == pytest.approx(mm.summary.max_force, rel=1e-6)
    assert result.summary.max_displacement * inch == pytest.approx(mm.summary.max_displacement, rel=1e-6)
