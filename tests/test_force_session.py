"""Force control in a session: what it pushes with, how deep it goes, and that it can be resumed."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from cadsculpt.force_control import FORCE_TOLERANCE
from cadsculpt.model import Model, SourceBody, build_model
from cadsculpt.motion.path import ToolPath
from cadsculpt.motion.pose import Pose
from cadsculpt.patch import SourceFace
from cadsculpt.run import Hooks, run
from cadsculpt.scene import Scene
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface

SIZE = 40.0
DOWN_AND_UP = ((0.0, (20, 20, 0.5)), (0.02, (20, 20, -3.0)), (0.04, (20, 20, -3.0)), (0.06, (20, 20, 1.0)))


def pushed(
    force: float = 5.0, rows=DOWN_AND_UP, tools: int = 1, anchor: str = "base", tool=None, **solver: object
) -> Model:
    """Foam 6 mm thick under flat punches 16 mm wide, whose lower faces are at their origins' heights."""
    knots = np.concatenate([np.zeros(4), [13.0, 27.0], np.full(4, SIZE)])
    x = np.array([knots[i + 1 : i + 4].mean() for i in range(6)])
    X, Y = np.meshgrid(x, x, indexing="ij")
    surface = BSplineSurface(np.stack([X, Y, 0 * X], axis=-1), knots, knots, 3, 3, name="pad")
    spec = tool or {"shape": "half_space"}
    scene = Scene.model_validate(
        {
            "units": "mm",
            "model": [
                {
                    "name": "pad", "file": "pad", "thickness": 6.0, "nodes": 4.0, "layers": 2, "material": "slick",
                    "anchor": anchor,
                }
            ],
            "material": {"slick": {"preset": "foam", "friction": 0.0, "damping": 1.0}},
            "tool": [
                {
                    "name": f"tool {i}", "control": "force", "force": force,
                    "path": [{"t": t, "at": [float(c) for c in at]} for t, at in rows],
                }
                | spec
                for i in range(tools)
            ],
            "solver": {"resolution": 41, "step": 1e-3, "max_penetration": 0.2} | solver,
        }
    )  # fmt: skip
    paths = {tool.name: ToolPath.of_rows(tool.path) for tool in scene.tool}  # type: ignore[arg-type]
    return build_model(scene, [SourceBody("pad", (SourceFace(1, "pad", surface),))], paths)


@pytest.mark.parametrize("solver", [{}, {"integrator": "implicit", "quasi_static": True}], ids=["explicit", "static"])
def test_a_plate_sinks_as_hooke_says(solver):
    force = 4.0
    session = Session(pushed(force, **solver))
    reactions = [session.step()["tool 0"].force[2] for _ in range(38)]
    assert max(reactions) <= force * (1 + FORCE_TOLERANCE)
    assert reactions[-1] == pytest.approx(force, rel=FORCE_TOLERANCE)
    sunk = -session.state.poses[0].at[2]
    # free sides and a held base: stiffer than a bar, softer than a layer that cannot spread (E (1-nu)/((1+nu)(1-2nu)) = 1.2 E)
    bar = force * 6.0 / (1e5 * 1e-6 * SIZE**2)
    assert bar / 1.2 * 0.98 < sunk < bar * 1.02
    for _ in range(22):
        session.step()
    assert session.state.poses[0].at[2] == 1.0
    assert np.abs(session.displacement(0)).max() < 0.1 * sunk


def test_two_tools_push_together():
    session = Session(pushed(2.0, tools=2))
    for _ in range(38):
        reactions = session.step()
    for reaction in reactions.values():
        assert reaction.force[2] == pytest.approx(2.0, rel=2 * FORCE_TOLERANCE)


def test_a_stroke_under_constant_load_follows_its_path_across():
    rows = ((0.0, (10, 20, 8.2)), (0.01, (10, 20, 5.0)), (0.03, (30, 20, 5.0)))
    session = Session(pushed(0.4, rows, tool={"shape": "sphere", "radius": 8.0, "direction": [0, 0, -1]}))
    for step in range(30):
        reaction = session.step()["tool 0"]
        assert session.state.poses[0].at[0] == pytest.approx(rows[0][1][0] + max(0, step - 9) * 1.0)
        if step > 12:
            assert reaction.force[2] == pytest.approx(0.4, rel=FORCE_TOLERANCE)
    assert 5.0 < session.state.poses[0].at[2] < 8.0


def test_an_outer_loop_sends_it():
    session = Session(pushed(4.0))
    for _ in range(30):
        reaction = session.step({"tool 0": Pose(np.array([20.0, 20.0, -2.0]))}, 1e-3)["tool 0"]
    assert reaction.force[2] == pytest.approx(4.0, rel=FORCE_TOLERANCE)
    assert session.state.poses[0].at[2] > -1.0


def test_it_goes_on_from_a_checkpoint_as_if_nothing_had_happened():
    kept: dict[str, np.ndarray] = {}

    def save(step, arrays):
        if step == 25:
            kept.update({key: np.array(value) for key, value in arrays().items()})

    whole = run(pushed(), hooks=Hooks(on_checkpoint=save))
    rest = run(pushed(), resume=kept)
    np.testing.assert_array_equal(whole.session.state.control_points[0], rest.session.state.control_points[0])
    np.testing.assert_array_equal(whole.history.force, rest.history.force)


def test_a_force_that_is_never_met_is_told():
    result = run(pushed(1000.0))
    assert any("met at most" in line and "1000 N" in line for line in result.warnings)
    assert not any("met at most" in line for line in run(pushed(1.0)).warnings)


def test_a_body_that_nothing_holds_cannot_push_back():
    with pytest.raises(ValidationError, match="nothing holds it against"):
        pushed(anchor="none")


def test_the_force_has_a_way_to_go():
    from cadsculpt.errors import InputError

    with pytest.raises(InputError, match="tool 'tool 0'.*does not move"):
        pushed(rows=((0.0, (20, 20, 1.0)),))
