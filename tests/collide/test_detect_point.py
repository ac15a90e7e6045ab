"""Point-based tools (paper 4.9.2)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadsculpt.collide.detect import DetectOptions, PointTool, detect
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.errors import InputError
from cadsculpt.spline.surface import TrimCurve, TrimLoop


def _touch(grids, position, options=None, **more):
    nets = [grid.surface.control_points for grid in grids]
    return detect(
        grids, nets, [PointTool(np.array(position, dtype=float), 0.25, **more)], options or DetectOptions()
    ).contacts


def test_a_point_in_a_ball_is_as_deep_as_it_is_below_the_surface(shapes):
    grid = PatchGrid.of(shapes.ball(5.0), (33, 17))
    rng = np.random.default_rng(0)
    for x in rng.normal(size=(40, 3)) * 3:
        r = np.linalg.norm(x)
        contacts = _touch([grid], x)
        assert len(contacts) == (r <= 5.0)
        if len(contacts):
            assert contacts.depth[0] == pytest.approx(5.0 - r, abs=1e-9)
            assert contacts.normal[0] == pytest.approx(x / r, abs=1e-6)
            assert contacts.point[0] == pytest.approx(5 * x / r, abs=1e-6)
            assert contacts.area[0] == 0.25
            assert contacts.tool_point[0] == pytest.approx(x)
            u, v = contacts.u[0], contacts.v[0]
            assert grid.surface.evaluate(u, v) == pytest.approx(contacts.point[0], abs=1e-9)


def test_a_cube_of_six_faces_gives_one_contact_with_the_nearest(shapes):
    grids = [PatchGrid.of(s, 5) for s in shapes.box(4.0)]
    rng = np.random.default_rng(1)
    for x in rng.uniform(-3, 3, (80, 3)):
        contacts = _touch(grids, x)
        inside = np.abs(x).max() < 2
        assert len(contacts) == inside
        if inside:
            assert contacts.depth[0] == pytest.approx(2 - np.abs(x).max())
            assert contacts.normal[0] == pytest.approx(np.eye(3)[np.abs(x).argmax()] * np.sign(x[np.abs(x).argmax()]))
    # just outside an edge and a corner, watched within a margin
    for x in ([2.1, 2.1, 0], [2.1, 2.1, 2.1], [2.1, 0.3, 0.1]):
        contacts = _touch(grids, x, DetectOptions(margin=0.5))
        assert contacts.depth == pytest.approx([-np.linalg.norm(np.maximum(np.abs(x) - 2.0, 0))])


def test_an_open_sheet_holds_a_point_only_in_front_of_its_face_and_within_reach(shapes):
    grid = PatchGrid.of(shapes.plate(10.0), 33)
    assert _touch([grid], [5, 5, -0.3]).depth == pytest.approx([0.3])
    assert len(_touch([grid], [5, 5, 0.3])) == 0
    assert _touch([grid], [5, 5, 0.3], DetectOptions(margin=0.5)).depth == pytest.approx([-0.3])
    assert len(_touch([grid], [5, 5, -3], reach=2.0)) == 0
    assert len(_touch([grid], [5, 5, -3], reach=4.0)) == 1
    assert len(_touch([grid], [-1, 5, -0.3])) == 0  # beyond the border


def test_a_hole_is_a_hole(shapes):
    line = np.array([0.0, 0, 1, 1])
    corners = [(0.4, 0.4), (0.6, 0.4), (0.6, 0.6), (0.4, 0.6)]
    rim = [(0, 0), (1, 0), (1, 1), (0, 1)]

    def loop(points, outer):
        curves = tuple(
            TrimCurve(np.array([a, b], dtype=float), line, 1)
            for a, b in zip(points, points[1:] + points[:1], strict=True)
        )
        return TrimLoop(curves, outer)

    surface = replace(shapes.plate(10.0), trims=(loop(rim, True), loop(corners, False)))
    grid = PatchGrid.of(surface, 51)
    assert len(_touch([grid], [5, 5, -0.1])) == 0
    assert len(_touch([grid], [3.9, 5, -0.1])) == 1
    assert len(_touch([grid], [4.1, 5, -0.1])) == 0


def test_the_papers_spheres_hold_shallow_points_only(shapes):
    grid = PatchGrid.of(shapes.plate(10.0), 51)
    paper = DetectOptions(mode="paper")
    assert len(_touch([grid], [5.02, 5.01, -0.05], paper)) == 1
    assert len(_touch([grid], [5.02, 5.01, -2.0], paper)) == 0
    assert len(_touch([grid], [5.02, 5.01, -2.0])) == 1


def test_a_point_that_is_not_a_number_is_refused(shapes):
    with pytest.raises(InputError):
        _touch([PatchGrid.of(shapes.plate(), 9)], [np.nan, 0, 0])
