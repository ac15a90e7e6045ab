"""What goes back to CAD: refitted from the net as read, to the scene's tolerance, with what is held held, and errors told."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.export_fit import export_fit
from cadsculpt.model import SourceBody, build_model
from cadsculpt.motion.path import ToolPath
from cadsculpt.patch import SourceEdge, SourceFace
from cadsculpt.run import run
from cadsculpt.scene import Scene
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface

SIZE = 40.0


def plate(count: int = 6) -> BSplineSurface:
    """A flat bicubic plate over [0, 40] x [0, 40], parameters in mm."""
    knots = np.concatenate([np.zeros(4), np.linspace(0, SIZE, count - 2)[1:-1], np.full(4, SIZE)])
    x = np.array([knots[i + 1 : i + 4].mean() for i in range(count)])
    X, Y = np.meshgrid(x, x, indexing="ij")
    return BSplineSurface(np.stack([X, Y, 0 * X], axis=-1), knots, knots, 3, 3, name="plate")


def session_of(refit: dict | None = None, *, edges: tuple[SourceEdge, ...] = (), to: float = 7.0) -> Session:
    scene = Scene.model_validate(
        {
            "units": "mm",
            "model": [
                {"name": "plate", "file": "plate", "thickness": 6.0, "nodes": 1.0, "layers": 1, "material": "clay"}
            ],
            "tool": [
                {
                    "name": "ball",
                    "shape": "sphere",
                    "radius": 8.0,
                    "path": [{"t": 0.0, "at": [20.0, 20.0, 8.5]}, {"t": 0.02, "at": [20.0, 20.0, to]}],
                }
            ],
            "solver": {"resolution": 61, "step": 1e-3},
            "refit": {"tolerance": 0.02} | (refit or {}),
        }
    )
    paths = {tool.name: ToolPath.of_rows(tool.path) for tool in scene.tool}  # type: ignore[arg-type]
    return Session(build_model(scene, [SourceBody("plate", (SourceFace(1, "plate", plate(), edges),))], paths))


def push(session: Session, at: tuple[float, float], width: float, depth: float = 1.0) -> np.ndarray:
    """Move the surface nodes of the lattice by a Gaussian dent; returns the displacement (nu, nv, 3)."""
    patch = session.model.patches[0]
    g = np.exp(-((patch.u[:, None] - at[0]) ** 2 + (patch.v - at[1]) ** 2) / (2 * width**2))
    moved = np.zeros((*g.shape, 3))
    moved[..., 2] = -depth * np.where(g > 1e-3, g, 0.0)
    still = (patch.lattice.inverse_mass == 0.0).reshape(patch.lattice.shape)[:, :, 0]
    moved[still] = 0.0
    x = session.lattice(0).x.reshape(*patch.lattice.shape, 3)
    x[:, :, 0] += moved
    session._refit(session.state.poses)
    return moved


def test_the_net_is_as_small_as_the_tolerance_allows():
    shapes = []
    for tolerance in (0.1, 0.02, 0.002):
        session = session_of({"tolerance": tolerance})
        moved = push(session, (20, 20), 4.0)
        face = export_fit(session).faces[0]
        patch = session.model.patches[0]
        distance = (
            face.surface.evaluate(patch.u[:, None], patch.v) - plate().evaluate(patch.u[:, None], patch.v) - moved
        )
        assert np.linalg.norm(distance, axis=2).max() == pytest.approx(face.error.maximum, abs=1e-12)
        assert face.error.maximum <= tolerance
        assert face.outcome == "within"
        assert face.working == session.refit_error(0)
        shapes.append(face.surface.shape)
        # the working net has a knot at every node that the tool comes near
        assert 2 * np.prod(shapes[-1]) < np.prod(face.working_shape)
    assert np.prod(shapes[0]) < np.prod(shapes[1]) < np.prod(shapes[2])


def test_a_face_at_rest_is_the_file_s_own():
    face = export_fit(session_of()).faces[0]
    assert face.surface.shape == face.read_shape
    np.testing.assert_array_equal(face.surface.control_points, plate().control_points)
    assert face.error.maximum == 0.0


def test_without_refine_the_net_stays_and_the_warning_says_so():
    session = session_of({"refine": False})
    push(session, (20, 20), 4.0)
    exported = export_fit(session)
    face = exported.faces[0]
    assert face.surface.shape == (6, 6)
    assert face.error.maximum > 0.02
    [line] = exported.warnings(0.02, "mm")
    assert "refit.refine keeps the net" in line
    assert f"{face.error.maximum:.3g} mm" in line


def test_the_limit_is_kept_and_the_warning_says_so():
    session = session_of({"max_control_points": 60, "tolerance": 0.001})
    push(session, (20, 20), 4.0)
    exported = export_fit(session)
    assert np.prod(exported.faces[0].surface.shape) <= 60
    [line] = exported.warnings(0.001, "mm")
    assert "refit.max_control_points allows no finer net" in line


def test_a_fixed_region_stays_exactly_with_its_material():
    box = {"face": "plate", "u": [22.0, 30.0], "v": [0.0, 40.0]}
    session = session_of({"fixed": [box], "tolerance": 0.01})
    patch = session.model.patches[0]
    inside = (patch.u >= 22.0) & (patch.u <= 30.0)
    assert (patch.lattice.inverse_mass.reshape(patch.lattice.shape)[inside] == 0.0).all()
    push(session, (15, 20), 2.5)
    face = export_fit(session).faces[0]
    u, v = np.linspace(22, 30, 41), np.linspace(0, 40, 41)
    for surface in (face.surface, session.surface(0)):
        np.testing.assert_allclose(surface.evaluate(u[:, None], v), plate().evaluate(u[:, None], v), atol=1e-13)
    assert face.surface.evaluate(15, 20)[2] < -0.95
    for elsewhere in ({"face": "plat"}, {"face": 7}):
        with pytest.raises(InputError, match="no sculpted face"):
            session_of({"fixed": [elsewhere]})


@pytest.mark.parametrize("continuity", ["G0", "G1"])
def test_an_edge_that_another_face_holds_stays_and_its_tangents_too_if_asked(continuity):
    line = np.stack([np.full(50, SIZE), np.linspace(0, SIZE, 50)], axis=1)
    session = session_of({"continuity": continuity}, edges=(SourceEdge(line, neighbours=("side",)),))
    push(session, (34.0, 20), 4.0)
    face = export_fit(session).faces[0]
    v = np.linspace(0, SIZE, 101)
    end = np.full(101, SIZE)
    np.testing.assert_allclose(face.surface.evaluate(end, v), plate().evaluate(end, v), atol=1e-13)
    before, after = plate().normal(end, v), face.surface.normal(end, v)
    turned = np.degrees(np.arccos(np.clip(np.einsum("nc,nc->n", before, after), -1, 1))).max()
    assert (turned < 1e-5) if continuity == "G1" else (turned > 1.0)


def test_a_side_on_which_nothing_moved_stays_exactly():
    """Its control points would follow the nodes inside, if only by a part of the tolerance."""
    session = session_of({"tolerance": 0.1})
    push(session, (32.0, 20), 2.2)
    face = export_fit(session).faces[0]
    t, low, high = np.linspace(0, SIZE, 101), np.zeros(101), np.full(101, SIZE)
    for u, v in ((low, t), (high, t), (t, low), (t, high)):
        np.testing.assert_allclose(face.surface.evaluate(u, v), plate().evaluate(u, v), atol=1e-13)
    assert face.outcome == "within"
    assert face.surface.evaluate(32.0, 20.0)[2] < -0.85


def test_the_summary_is_of_the_exported_surfaces():
    result = run(session_of({"tolerance": 0.05}))
    assert result.converged
    assert result.summary.max_displacement > 0.5
    face = result.exported.faces[0]
    assert result.summary.refit_max_error == face.error.maximum
    assert face.working.maximum < face.error.maximum <= 0.05
    assert np.prod(face.read_shape) < np.prod(face.surface.shape) < np.prod(face.working_shape)
    assert not [line for line in result.warnings if "away from its nodes" in line]
