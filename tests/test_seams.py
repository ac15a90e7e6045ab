"""Faces of one body share the nodes of their common edges."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cadsculpt.model import Model, SourceBody, build_model
from cadsculpt.motion.path import ToolPath
from cadsculpt.patch import SourceEdge, SourceFace
from cadsculpt.scene import Scene
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface

LENGTH, WIDTH = 32.0, 16.0


def plate(low: float, high: float, name: str, *, turned: bool = False) -> BSplineSurface:
    """A flat bicubic plate over [low, high] x [0, WIDTH], parameters in mm; turned : v runs along x, and u against y."""
    spans = 4

    def knots(a: float, b: float) -> np.ndarray:
        return np.concatenate([np.full(3, a), np.linspace(a, b, spans + 1), np.full(3, b)])

    kx, ky = knots(low, high), knots(0.0, WIDTH)
    x, y = (np.array([k[i + 1 : i + 4].mean() for i in range(spans + 3)]) for k in (kx, ky))
    X, Y = np.meshgrid(x, y, indexing="ij")
    net = np.stack([X, Y, 0.0 * X], axis=-1)
    if turned:
        return BSplineSurface(net.transpose(1, 0, 2)[::-1], ky, kx, 3, 3, outward=True, name=name)
    return BSplineSurface(net, kx, ky, 3, 3, name=name)


def line(a: tuple[float, float], b: tuple[float, float]) -> np.ndarray:
    return np.array([a, b], dtype=np.float64)


def model_of(faces: list[SourceFace], at: tuple[float, float], **changes: Any) -> Model:
    rows = [{"t": t, "at": [*at, z]} for t, z in ((0.0, 9.0), (0.02, 7.8), (0.04, 7.8))]
    scene = Scene.model_validate(
        {
            "units": "mm",
            "model": [
                {"name": "m", "file": "m", "thickness": 4.0, "nodes": 2.0, "layers": 2, "material": "rubber"} | changes
            ],
            "tool": [{"name": "ball", "shape": "sphere", "radius": 9.0, "path": rows}],
            "solver": {"resolution": 61, "step": 1e-3, "max_penetration": 0.3},
            "refit": {"tolerance": 0.05},
        }
    )
    return build_model(scene, [SourceBody("m", tuple(faces))], {"ball": ToolPath.of_rows(scene.tool[0].path)})  # type: ignore[arg-type]


def halves(*, turned: bool = False) -> list[SourceFace]:
    """Two plates that meet at x = LENGTH / 2; of the second, turned or not, the edge runs the other way."""
    middle = 0.5 * LENGTH
    edge = line((WIDTH, middle), (0.0, middle)) if turned else line((middle, WIDTH), (middle, 0.0))
    return [
        SourceFace(
            1, "left", plate(0.0, middle, "left"), (SourceEdge(line((middle, 0.0), (middle, WIDTH)), ("right",)),)
        ),
        SourceFace(2, "right", plate(middle, LENGTH, "right", turned=turned), (SourceEdge(edge, ("left",)),)),
    ]


def pressed(model: Model) -> Session:
    session = Session(model)
    for k in range(model.steps):
        session.step(dt=model.step_length(k))
    return session


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("at", [(16.0, 8.0), (14.3, 7.1)])
def test_a_plate_of_two_faces_gives_way_as_a_plate_of_one(at, turned):
    whole = pressed(model_of([SourceFace(1, "all", plate(0.0, LENGTH, "all"))], at))
    model = model_of(halves(turned=turned), at)
    assert [group.patches for group in model.groups] == [(0, 1)]
    both = pressed(model)
    left, right, one = both.displacement(0), both.displacement(1), whole.displacement(0)
    if turned:
        right = right[::-1].transpose(1, 0, 2)
    assert -one[..., 2].min() > 1.0
    # the seam's nodes are one; beside it the two surfaces bend each for itself, by a twentieth of the dent
    np.testing.assert_allclose(left[-1], right[0], atol=1e-12)
    np.testing.assert_allclose(left, one[: len(left)], atol=0.08)
    np.testing.assert_allclose(right, one[-len(right) :], atol=0.08)
    force = [session.step()["ball"].force for session in (whole, both)]
    assert force[1] == pytest.approx(force[0], rel=0.03, abs=0.02 * force[0][2])


def test_faces_that_share_no_edge_are_apart():
    left, right = halves()
    model = model_of([left, SourceFace(2, "right", right.surface)], (16.0, 8.0))
    assert [group.patches for group in model.groups] == [(0,), (1,)]


def test_an_edge_between_two_faces_is_none_of_the_bodys_edges():
    left, right = halves()
    outer = SourceEdge(line((0.0, 0.0), (0.0, WIDTH)), ("side",))
    model = model_of([SourceFace(1, "left", left.surface, (*left.edges, outer)), right], (16.0, 8.0), anchor="edges")
    anchored = model.patches[0].lattice.anchored.reshape(model.patches[0].lattice.shape)
    assert anchored[0].all()
    assert not anchored[-1, 1:-1].any()
    assert model.patches[0].held[0].all()
    assert not model.patches[0].held[-1, 1:-1].any()


def corner(*, convex: bool) -> list[SourceFace]:
    """The plate on [0, 16] x [0, WIDTH], and another that goes down, or up, from its edge at x = 16."""
    flat = plate(0.0, 16.0, "flat")
    x, y, z = np.moveaxis(flat.control_points, -1, 0)
    net = np.stack([16.0 + z, y, -x if convex else x], axis=-1)
    # outwards is along x for the one that goes down, against it for the one that goes up
    side = BSplineSurface(net, flat.knots_u, flat.knots_v, 3, 3, outward=True, name="side")
    along = side.normal(8.0, 8.0)[0]
    side = BSplineSurface(net, flat.knots_u, flat.knots_v, 3, 3, outward=(along > 0) == convex, name="side")
    return [
        SourceFace(1, "flat", flat, (SourceEdge(line((16.0, 0.0), (16.0, WIDTH)), ("side",)),)),
        SourceFace(2, "side", side, (SourceEdge(line((0.0, 0.0), (0.0, WIDTH)), ("flat",)),)),
    ]


@pytest.mark.parametrize("convex", [True, False])
def test_an_edge_gives_way_where_the_material_does(convex):
    """Below a convex edge the base of one face would hold the skin of the other: it does not. In a concave corner, as on a
    plane, all of the base is held."""
    model = model_of(corner(convex=convex), (14.5, 8.0))
    flat, side = (patch.lattice.anchored.reshape(patch.lattice.shape)[..., -1] for patch in model.patches)
    assert flat[:-4].all()
    assert side[4:].all()
    assert flat[-1].any() != convex
    assert side[0].any() != convex
    smooth = model_of(halves(), (14.5, 8.0))
    assert all(patch.lattice.anchored.reshape(patch.lattice.shape)[..., -1].all() for patch in smooth.patches)
    if convex:
        session = pressed(model)
        edge = session.displacement(0)[-1]
        assert -edge[:, 2].min() > 0.5
        np.testing.assert_allclose(edge, session.displacement(1)[0], atol=1e-12)
