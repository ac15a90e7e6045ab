"""Trimmed faces touch only where the face is, and everywhere where it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadsculpt.collide.detect import DetectOptions, FieldTool, PatchGrid, PointTool, SurfaceTool, detect
from cadsculpt.errors import GeometryError
from cadsculpt.spline.region import OFF
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

LINE = np.array([0.0, 0, 1, 1])
RIM = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]


def _loop(corners, outer=True):
    ends = zip(corners, [*corners[1:], corners[0]], strict=True)
    return TrimLoop(tuple(TrimCurve(np.array([a, b], dtype=float), LINE, 1) for a, b in ends), outer)


def _touch(grid, tool, tolerance=1e-3):
    return detect([grid], [grid.surface.control_points], [FieldTool(tool)], DetectOptions(tolerance=tolerance)).contacts


def _comb(shapes, low, high):
    """Half a plate of 10 x 10, and a tooth from x = 4 to 9.5, between y = 10 low and 10 high."""
    chain = [(0, 0), (0.4, 0), (0.4, low), (0.95, low), (0.95, high), (0.4, high), (0.4, 1), (0, 1)]
    return replace(shapes.plate(10.0), trims=(_loop(chain),))


def test_a_sliver_between_the_rows_of_the_grid_is_touched_and_its_sides_are_not(shapes):
    grid = PatchGrid.of(_comb(shapes, 0.512, 0.524), 11)
    vertices = np.argwhere(grid.inside)
    assert grid.matrices.u[vertices[:, 0]].max() < 0.5  # none on the tooth
    on, beside, beyond = (
        _touch(grid, shapes.Sphere(c, 0.3)) for c in ([7.3, 5.18, 0.2], [7.3, 5.7, 0.2], [9.9, 5.18, 0.2])
    )
    assert len(on)
    assert len(beside) == len(beyond) == 0
    assert on.point[:, 1].min() >= 5.12 - 1e-9
    assert on.point[:, 1].max() <= 5.24 + 1e-9
    # the chord of the print, of 2 sqrt(0.09 - 0.04), times the tooth's width
    assert on.area.sum() == pytest.approx(0.447 * 0.12, rel=0.3)


def test_a_sliver_is_found_beside_a_large_part_of_the_tool_off_the_face(shapes):
    """Hundreds of sub-cells in the tool but off the face: they are no contacts, and they do not end the search."""
    grid = PatchGrid.of(_comb(shapes, 0.5555, 0.5565), 6)
    contacts = _touch(grid, shapes.Sphere([7.3, 4.9, 0.1], 0.8), 1e-4)
    assert len(contacts)
    assert np.abs(contacts.point[:, 1] - 5.56).max() <= 0.005 + 1e-9


def test_a_hole_inside_one_cell_is_a_hole(shapes):
    hole = [(0.47, 0.47), (0.53, 0.47), (0.53, 0.53), (0.47, 0.53)]
    grid = PatchGrid.of(replace(shapes.plate(10.0), trims=(_loop(RIM), _loop(hole, False))), 11)
    assert grid.inside.all(), grid.matrices.u
    assert len(_touch(grid, shapes.Sphere([5.0, 5.0, 0.05], 0.1))) == 0
    assert len(_touch(grid, shapes.Sphere([4.58, 5.0, 0.05], 0.08))) > 0
    point = PointTool(np.array([5.0, 5.0, -0.05]), 1.0)
    assert len(detect([grid], [grid.surface.control_points], [point], DetectOptions()).contacts) == 0


def test_a_hole_that_is_exactly_one_cell_is_a_hole(shapes):
    rows = PatchGrid.of(shapes.plate(10.0), 11).matrices.u
    a, b = rows[4], rows[5]
    grid = PatchGrid.of(
        replace(shapes.plate(10.0), trims=(_loop(RIM), _loop([(a, a), (b, a), (b, b), (a, b)], False))), 11
    )
    assert grid.pieces[4, 4] == OFF
    middle = 5 * (a + b)
    assert len(_touch(grid, shapes.Sphere([middle, middle, 0.05], 0.1))) == 0


def test_trims_along_the_whole_border_trim_nothing(shapes):
    grid = PatchGrid.of(replace(shapes.plate(10.0), trims=(_loop(RIM),)), 11)
    assert grid.inside is None
    assert grid.region is None


def test_a_face_without_a_vertex_raises_the_resolution_or_says_so(shapes):
    strip = [(0.3, 0.51), (0.7, 0.51), (0.7, 0.53), (0.3, 0.53)]
    grid = PatchGrid.of(replace(shapes.plate(10.0), trims=(_loop(strip),)), 5)
    assert grid.inside.any()
    contacts = _touch(grid, shapes.Sphere([5, 5.2, 1.0], 2.0))
    assert len(contacts)
    assert np.abs(contacts.point[:, 1] - 5.2).max() <= 0.1 + 1e-9
    hair = [(0.1, 0.13), (0.9, 0.87), (0.9, 0.870001), (0.1, 0.130001)]
    with pytest.raises(GeometryError, match="too small for the collision grid"):
        PatchGrid.of(replace(shapes.plate(10.0), name="hair", trims=(_loop(hair),)), 5)


def test_a_narrow_domain_does_not_widen_the_border(shapes):
    """u in a millionth, v in a thousand: what counts as on the border is measured along each."""
    sheet = shapes.plate(10.0)
    sheet = replace(sheet, knots_u=sheet.knots_u * 1e-6, knots_v=sheet.knots_v * 1e3)
    corners = [(0.4e-6, 400.0), (0.6e-6, 400.0), (0.6e-6, 600.0), (0.4e-6, 600.0)]
    face = replace(sheet, trims=(_loop(corners),))
    from cadsculpt.spline.trim import inside

    assert inside(face, np.array([0.3e-6, 0.5e-6, 0.7e-6]), np.array([500.0])).ravel().tolist() == [False, True, False]
    contacts = _touch(PatchGrid.of(face, 41), shapes.Sphere([5, 5, 0], 30.0))
    assert contacts.point[:, 0].min() >= 4.0 - 1e-6
    assert contacts.point[:, 0].max() <= 6.0 + 1e-6


# ------------------------------------------------------------------ solids of trimmed faces

PROFILE = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2.0]])


def _bracket():
    """An L, one unit high, cut out of eight planes that run on through it."""
    wide = np.array([-1.0, 3.0])

    def planar(origin, a, b, corners):
        net = np.array([[origin + x * a + y * b for y in wide] for x in wide])
        return BSplineSurface(net, LINE, LINE, 1, 1, trims=(_loop([tuple((c + 1.0) / 4.0) for c in corners]),))

    x, y, z = np.eye(3)
    faces = [planar(0 * z, y, x, PROFILE[:, ::-1]), planar(z, x, y, PROFILE)]
    for p, q in zip(PROFILE, np.roll(PROFILE, -1, axis=0), strict=True):
        d = (q - p) / np.linalg.norm(q - p)
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * [np.linalg.norm(q - p), 1.0]
        faces.append(planar(np.array([*p, 0.0]), np.array([*d, 0.0]), z, corners))
    return faces


def _signed(x):
    """Signed distance from the L, positive inside: the nearest part of its eight faces, and the side by two boxes."""
    inside = np.zeros(len(x), bool)
    best = np.full(len(x), np.inf)
    for low, high in (([0, 0, 0], [2, 1, 1]), ([0, 0, 0], [1, 2, 1])):
        inside |= ((x >= low) & (x <= high)).all(axis=1)
    for p, q in zip(PROFILE, np.roll(PROFILE, -1, axis=0), strict=True):
        t = np.clip(((x[:, :2] - p) @ (q - p)) / ((q - p) @ (q - p)), 0, 1)
        flat = np.linalg.norm(x[:, :2] - p - t[:, None] * (q - p), axis=1)
        best = np.minimum(best, np.hypot(flat, x[:, 2] - np.clip(x[:, 2], 0, 1)))
    lids = np.zeros(len(x), bool)
    for high in ([2, 1], [1, 2]):
        lids |= ((x[:, :2] >= 0) & (x[:, :2] <= high)).all(axis=1)
    best = np.where(lids, np.minimum(best, np.minimum(np.abs(x[:, 2]), np.abs(x[:, 2] - 1))), best)
    return np.where(inside, best, -best)


def test_a_reentrant_edge_has_one_inside(shapes):
    """Behind the edge the planes of both its faces run on through the body: no point there is nearest to them."""
    grids = tuple(PatchGrid.of(face, 9) for face in _bracket())
    rng = np.random.default_rng(0)
    sheet = shapes.plate(3.0, height=lambda x, y: 0.2 * np.sin(2 * x + y), z=0.5)
    grid, place = PatchGrid.of(sheet, 31), np.array([1.013, 0.987, 0.5])
    for turn in (np.eye(3), np.linalg.qr(rng.normal(size=(3, 3)))[0]):
        turn = turn * np.linalg.det(turn)
        nets = tuple(np.ascontiguousarray((g.surface.control_points - 0.5) @ turn.T + place) for g in grids)
        contacts = detect([grid], [sheet.control_points], [SurfaceTool(grids, nets)], DetectOptions()).contacts
        points = grid.matrices.points(sheet.control_points).reshape(-1, 3)
        depth = _signed((points - place) @ turn + 0.5)
        assert len(contacts) == (depth >= 0).sum() > 50
        assert contacts.depth == pytest.approx(_signed((contacts.point - place) @ turn + 0.5), abs=1e-6)


def test_a_point_in_a_solid_of_trimmed_faces(shapes):
    grids = [PatchGrid.of(face, 9) for face in _bracket()]
    nets = [grid.surface.control_points for grid in grids]
    x = np.random.default_rng(1).uniform(-0.2, 2.2, (150, 3)) * [1, 1, 0.5]
    depth = _signed(x)
    for position, d in zip(x, depth, strict=True):
        contacts = detect(grids, nets, [PointTool(position, 1.0)], DetectOptions()).contacts
        assert contacts.depth == pytest.approx([d] if d >= 0 else [], abs=1e-6)
