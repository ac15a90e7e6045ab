"""No tool passes through a part between two looks, however far it moves within one step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cadsculpt.collide.mesh.triangle_mesh import TriangleMesh
from cadsculpt.errors import SimulationError
from cadsculpt.model import Model, SourceBody, build_model
from cadsculpt.motion.path import ToolPath
from cadsculpt.motion.pose import Pose
from cadsculpt.patch import SourceFace
from cadsculpt.run import run
from cadsculpt.scene import Scene
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface

SIZE, THICKNESS = 20.0, 2.0
TOOLS: dict[str, dict[str, Any]] = {
    "point": {"shape": "point"},
    "sphere": {"shape": "sphere", "radius": 3.0},
    "surface": {"shape": "surface", "file": "cap"},
    "mesh": {"shape": "mesh", "file": "wedge"},
    "half space": {"shape": "half_space"},
}
TIP = {"point": 0.0, "sphere": 3.0, "surface": 0.0, "mesh": 0.0}
"""How far above its lowest point the origin of each tool lies."""

WEDGE = TriangleMesh.of(
    np.array([[0.0, 0, 0], [3, -3, 4], [3, 3, 4], [-3, 3, 4], [-3, -3, 4]]),
    np.array([[0, 1, 4], [0, 2, 1], [0, 3, 2], [0, 4, 3], [1, 2, 3], [1, 3, 4]]),
)
"""A pyramid on its tip."""


def sheet(size: float, dome: float, corner: tuple[float, float], *, outward: bool = True) -> BSplineSurface:
    """A bicubic sheet over a square, `dome` (x^2 + y^2) / size above its plane."""
    knots = np.array([0.0, 0, 0, 0, 0.5, 1, 1, 1, 1])
    t = size * np.array([knots[i + 1 : i + 4].mean() for i in range(5)])
    X, Y = np.meshgrid(t + corner[0], t + corner[1], indexing="ij")
    Z = dome * (X**2 + Y**2) / size
    return BSplineSurface(np.stack([X, Y, Z], axis=-1), knots, knots, 3, 3, outward=outward)


def model_of(kind: str, rows: list[tuple[float, list[float]]], step: float = 1e-3) -> Model:
    tool = {"name": "tool", **TOOLS[kind], "path": [{"t": t, "at": [float(c) for c in at]} for t, at in rows]}
    plate = {"name": "plate", "file": "plate", "thickness": THICKNESS, "nodes": 2.0, "layers": 1, "material": "foam"}
    scene = Scene.model_validate(
        {
            "units": "mm",
            "model": [plate],
            "tool": [tool],
            "solver": {"resolution": 41, "step": step, "max_penetration": 0.5},
        }
    )
    face = SourceFace(1, "plate", sheet(SIZE, 0.0, (0.0, 0.0)))
    paths = {t.name: ToolPath.of_rows(t.path) for t in scene.tool}  # type: ignore[arg-type]
    cap = sheet(6.0, 2.0, (-3.0, -3.0), outward=False)
    cap = cap.with_control_points(cap.control_points - [0.0, 0.0, cap.evaluate(0.5, 0.5)[2]])  # its tip in the origin
    return build_model(scene, [SourceBody("plate", (face,))], paths, {"tool": [cap]}, {"tool": WEDGE})


@pytest.mark.parametrize("kind", TIP)
@pytest.mark.parametrize("height", [30.0, 3000.0, 3e7])
def test_a_tool_that_crosses_the_whole_part_in_one_step_is_caught(kind, height):
    """From far above to far below within one step: in contact at the time that its speed says. The material takes the
    blow, or the run ends with one line and says when they met; it never goes on as if nothing had been in the way."""
    tip, seconds = TIP[kind], 0.06
    result = run(model_of(kind, [(0.0, [10.3, 9.8, height + tip]), (seconds, [10.3, 9.8, tip - height])], seconds))
    # to a stride's hundred-thousandth, and to the rounding of poses so far away
    assert result.summary.first_contact == pytest.approx(0.5 * seconds, abs=2e-5 * seconds / height + 1e-14)
    if result.converged:
        # how deep depends on how far the plate is thrown, which is chaotic
        assert result.summary.max_depth > 0.1
        # a shot leaves no time for an impulse that could be seen
        assert height > 30.0 or result.summary.max_force > 0
        assert height > 30.0 or result.summary.max_displacement > 0
    else:
        assert "faster than sound" in result.failure


@pytest.mark.parametrize("kind", TIP)
def test_a_tool_that_passes_beside_the_part_touches_nothing(kind):
    """Within a hair of the plate's border and never over it: no contact, and the plate as it was, bit for bit."""
    beside = -0.01 - {"point": 0.0, "sphere": 3.0, "surface": 3.0, "mesh": 3.0}[kind]
    session = Session(model_of(kind, [(0.0, [beside, 10, 50]), (1e-3, [beside, 10, -50])]))
    session.step()
    assert np.isnan(session.state.touched[0])
    assert len(session.contacts) == 0
    assert (session.state.control_points[0] == session.model.patches[0].surface.control_points).all()


def test_a_path_that_goes_in_and_out_within_one_step_is_followed():
    """The step's two ends are both far away; only its inner rows touch."""
    rows = [(0.0, [10, 10, 60]), (0.01, [10, 10, 2.5]), (0.02, [10, 10, 60])]
    session = Session(model_of("sphere", rows, step=0.02))
    session.step()
    # 60 to 2.5 in 10 ms: at a height of 3 after 57 / 57.5 of them
    assert session.state.touched[0] == pytest.approx(0.01 * 57.0 / 57.5, rel=1e-3)
    fine = Session(model_of("sphere", rows, step=1e-4))
    while fine.state.time < 0.02 - 1e-9:
        fine.step()
    assert fine.state.touched[0] == pytest.approx(session.state.touched[0], rel=1e-3)


def test_first_contact_does_not_depend_on_the_step():
    rows = [(0.0, [10, 10, 5.0]), (0.02, [10, 10, 2.9]), (0.03, [10, 10, 5.0])]
    times = [run(model_of("sphere", rows, step=step)).summary.first_contact for step in (5e-3, 1e-3, 2.3e-4)]
    assert times == pytest.approx([0.02 * 2.0 / 2.1] * 3, rel=1e-3)


def test_a_tool_moved_by_a_program_is_followed_too():
    session = Session(model_of("sphere", [(0.0, [10, 10, 40])]))
    reaction = session.step({"tool": Pose(np.array([10.0, 10.0, 2.0]))}, dt=0.02)["tool"]
    assert session.state.touched[0] == pytest.approx(0.02 * 37.0 / 38.0, rel=1e-3)
    assert reaction.force[2] > 0


def test_a_steps_pieces_make_the_same_as_steps_of_their_own():
    """A press in one long step ends with nearly the dent of the same press in a hundred short ones."""
    rows = [(0.0, [10, 10, 3.2]), (0.01, [10, 10, 2.0])]
    dents = []
    for step in (0.01, 1e-4):
        session = Session(model_of("sphere", rows, step=step))
        while session.state.time < 0.01 - 1e-9:
            session.step()
        dents.append(session.displacement(0)[..., 2].min())
    assert dents[1] < -0.5
    assert dents[0] == pytest.approx(dents[1], rel=0.1)


def test_a_step_that_slides_through_the_material_without_end_is_refused(monkeypatch):
    """A tool without an end never leaves the plate: one line that says how far it goes and what step would do."""
    monkeypatch.setattr("cadsculpt.session.MOST_PIECES", 20)
    session = Session(model_of("half space", [(0.0, [10, 10, -0.05]), (1.0, [10, 10, -0.05])]))
    with pytest.raises(SimulationError, match=r"a tool moves \S+ mm within one step .*take a step of at most"):
        session.step({"tool": Pose(np.array([1e3, 10.0, -0.05]))}, dt=1e-2)
