"""Scenes that ask for the implicit integrator: accepted, kept when they fail, refused where they cannot be meant."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.model import Model, SourceBody, build_model
from cadsculpt.motion.path import ToolPath
from cadsculpt.patch import SourceFace
from cadsculpt.physics import implicit
from cadsculpt.run import run
from cadsculpt.scene import Scene
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface


def plate(at: float = 0.0) -> BSplineSurface:
    knots = np.array([0.0, 0, 0, 0, 0.5, 1, 1, 1, 1])
    x = np.linspace(0.0, 20.0, 5)
    net = np.stack([*np.meshgrid(x + at, x, indexing="ij"), np.zeros((5, 5))], axis=-1)
    return BSplineSurface(net, knots, knots, 3, 3, name=f"plate {at:g}")


def model_of(solver: dict[str, Any], *, faces: int = 1, depth: float = 1.0, **changes: Any) -> Model:
    """Plates of 20 x 20 mm side by side; a ball presses `depth` mm into the middle of the last one and lifts off."""
    middle = 20.0 * faces - 10.0
    path = [{"t": t, "at": [middle, 10.0, z]} for t, z in ((0.0, 5.2), (0.1, 5.0 - depth), (0.2, 5.5))]
    scene = Scene.model_validate(
        {
            "units": "mm",
            "model": [
                {"name": "plate", "file": "plate", "thickness": 4.0, "nodes": 2.0, "layers": 2, "material": "clay"}
                | changes
            ],
            "tool": [{"name": "ball", "shape": "sphere", "radius": 5.0, "path": path}],
            "solver": {"resolution": 61, "integrator": "implicit"} | solver,
        }
    )
    sources = tuple(SourceFace(i + 1, f"plate {i}", plate(20.0 * i)) for i in range(faces))
    return build_model(scene, [SourceBody("plate", sources)], {"ball": ToolPath.of_rows(scene.tool[0].path)})  # type: ignore[arg-type]


@pytest.mark.parametrize("material", ["clay", "sheet steel", "aluminium"])
@pytest.mark.parametrize("quasi_static", [False, True])
def test_any_material_takes_the_paths_own_steps(material: str, quasi_static: bool) -> None:
    model = model_of({"quasi_static": quasi_static}, material=material, depth=0.4)
    # a quarter of the spacing, however stiff the material
    assert model.step == pytest.approx(0.25 * 2.0 / 9.0, rel=0.2)
    result = run(model)
    assert result.converged
    assert result.summary.max_penetration < model.scene.solver.max_penetration
    assert 0.1 < -result.session.displacement(0)[..., 2].min() < 0.4


def test_a_run_that_does_not_converge_keeps_what_was_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    model = model_of({"step": 5e-3}, faces=2)
    session = Session(model)
    for _ in range(10):
        session.step()
    x = [lattice.x.copy() for lattice in session.state.lattices]
    net = [points.copy() for points in session.state.control_points]
    session.state.lattices[0].velocity[:] = (
        1e-3 * (model.patches[0].lattice.inverse_mass > 0)[:, None]
    )  # this one moves
    monkeypatch.setattr(implicit, "ITERATIONS", 1)
    result = run(session)
    assert not result.converged
    assert result.failure.startswith("step 11, face 'plate ")
    assert "did not converge" in result.failure
    assert "reduce the step" in result.failure
    assert session.state.step == 10
    for lattice, kept in zip(session.state.lattices, x, strict=True):
        np.testing.assert_array_equal(lattice.x, kept)
    for points, kept in zip(session.state.control_points, net, strict=True):
        np.testing.assert_array_equal(points, kept)


def test_a_run_says_where_it_left_too_much_penetration() -> None:
    result = run(model_of({"max_penetration": 1e-4, "step": 2e-3}))
    assert result.converged
    assert any("residual penetration up to" in line and "above max_penetration" in line for line in result.warnings)


def test_quasi_static_is_refused_where_it_cannot_be() -> None:
    with pytest.raises(InputError, match="'plate': a quasi-static body that nothing holds"):
        model_of({"quasi_static": True}, anchor="none")
    scene = json.loads(model_of({}).scene.model_dump_json(by_alias=True, exclude_none=True))
    scene["solver"] |= {"integrator": "explicit", "quasi_static": True}
    with pytest.raises(ValueError, match='quasi_static needs integrator = "implicit"'):
        Scene.model_validate(scene)


def test_an_explicit_substep_that_is_too_long_names_the_largest() -> None:
    session = Session(model_of({"integrator": "explicit", "step": 2e-3, "substep": 1e-3}))
    with pytest.raises(InputError, match="solver.substep.*the largest that is stable here is"):
        session.step()


@pytest.mark.parametrize(("key", "value"), [("thickness", 0.0), ("thickness", -1.0)])
def test_a_thickness_that_is_not_positive_is_named(key: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{key} must be above 0"):
        model_of({}, **{key: value})
