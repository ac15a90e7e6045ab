"""Bad input gives one clear error that says what and where, or a right answer; never a wrong one without a word."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadsculpt.collide.detect import DetectOptions, FieldTool, PatchGrid, PointTool, SurfaceTool, detect
from cadsculpt.errors import GeometryError, InputError
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop


def _contacts(grid, tool, **options):
    return detect([grid], [grid.surface.control_points], [tool], DetectOptions(**options)).contacts


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("mode", ["certified", "paper"])
def test_a_number_that_is_none_is_named_wherever_it_stands(shapes, bad, mode):
    surface = shapes.plate()
    grid = PatchGrid.of(surface, 9)
    far = surface.control_points.copy()
    far[0, 0, 2] = bad
    good = surface.control_points
    sphere = FieldTool(shapes.Sphere([5, 5, 0], 1.0))
    options = DetectOptions(mode=mode)
    with pytest.raises(GeometryError, match="not finite") as caught:
        detect([grid, grid], [good, far], [sphere], options)
    assert "1" in caught.value.where
    assert "model" in caught.value.where
    with pytest.raises(GeometryError, match="not finite") as caught:
        detect([grid], [good], [sphere, SurfaceTool((grid,), (far,))], options)
    assert "tool 1" in caught.value.where
    with pytest.raises(InputError) as caught:
        detect([grid], [good], [PointTool(np.array([0.0, bad, 0.0]), 1.0)], options)
    assert "tool 0" in caught.value.where
    for field in ("knots_u", "control_points", "weights"):
        values = np.array(np.ones(surface.shape) if field == "weights" else getattr(surface, field))
        values.flat[5] = bad
        with pytest.raises(GeometryError, match="finite") as caught:
            PatchGrid.of(replace(surface, **{field: values}, name="lid"), 9)
        assert caught.value.where == "lid"
    line = np.array([0.0, 0, 1, 1])
    loop = TrimLoop(
        (TrimCurve(np.array([[0, 0], [1, bad]]), line, 1), TrimCurve(np.array([[1, 1], [0.0, 0]]), line, 1))
    )
    with pytest.raises(GeometryError, match="trim curve") as caught:
        PatchGrid.of(replace(surface, trims=(loop,), name="lid"), 9)
    assert caught.value.where == "lid"


def test_a_field_that_is_not_a_number_somewhere_is_an_error_there(shapes):
    """Not only where the box is: a hole in the function's domain, met by some of the points."""

    class Torn(shapes.Sphere):
        def distance(self, points):
            d = super().distance(points)
            return np.where(points[:, 0] > 5.2, np.nan, d)

    grid = PatchGrid.of(shapes.plate(), 41)
    with pytest.raises(InputError, match="not a number") as caught:
        _contacts(grid, FieldTool(Torn([5, 5, 0], 1.0)))
    assert "tool 0" in caught.value.where


@pytest.mark.parametrize("weight", [0.0, -1.0])
def test_a_weight_at_or_below_zero_is_refused(shapes, weight):
    surface = shapes.plate()
    weights = np.ones(surface.shape)
    weights[2, 3] = weight
    with pytest.raises(GeometryError, match="weight is not positive") as caught:
        PatchGrid.of(replace(surface, weights=weights, name="lid"), 9)
    assert caught.value.where == "lid"


def test_a_knot_of_full_multiplicity_inside_is_a_crease_or_torn(shapes):
    """degree times: a roof, with contacts right on both sides of its ridge. Once more: torn, and refused."""
    knots = np.array([0, 0, 0, 0.5, 0.5, 1, 1, 1])
    at = np.array([0, 0.25, 0.5, 0.75, 1.0]) * 10
    x, y = np.meshgrid(at, at, indexing="ij")
    roof = BSplineSurface(np.stack([x, y, 2 - 0.4 * np.abs(x - 5)], axis=-1), knots, knots, 2, 2)
    for resolution in (4, 31):
        grid = PatchGrid.of(roof, resolution)
        for tool in (FieldTool(shapes.Sphere([5.0, 5.0, 2.4], 0.5)), _ball(shapes, [5.0, 5.0, 2.4], 0.5)):
            contacts = _contacts(grid, tool, tolerance=1e-3)
            assert contacts.depth.max() == pytest.approx(0.1, abs=0.02 if resolution < 9 else 2e-3)
            assert contacts.point[:, 2] == pytest.approx(2 - 0.4 * np.abs(contacts.point[:, 0] - 5), abs=1e-12)
            # as far down either side
            assert contacts.point[:, 0].mean() == pytest.approx(5.0, abs=0.02)
    torn = np.array([0, 0, 0, 0.5, 0.5, 0.5, 1, 1, 1])
    net = np.concatenate([roof.control_points[:3], roof.control_points[2:]])
    with pytest.raises(GeometryError, match="torn"):
        PatchGrid.of(BSplineSurface(net, torn, knots, 2, 2), 9)


def _ball(shapes, centre, radius):
    patch = shapes.ball(radius)
    return SurfaceTool((PatchGrid.of(patch, (33, 17)),), (patch.control_points + np.array(centre),))


def test_coincident_control_points_are_a_normal_case(shapes):
    """A corner collapsed, a row collapsed, an edge doubled: contacts are those of the points as they are."""
    plate = shapes.plate(10.0, 7, 3)
    corner, row, doubled = (plate.control_points.copy() for _ in range(3))
    corner[:2, :2] = corner[0, 0]
    row[0] = row[0, 3]
    doubled[:, 1] = doubled[:, 0]
    for net in (corner, row, doubled):
        grid = PatchGrid.of(plate.with_control_points(net), 41)
        # where the points coincide (not quite: in its very middle a ball has no nearest point)
        at = grid.surface.evaluate(0.0, 0.0) + [0.0, 0.0, 1e-3]
        for tool in (FieldTool(shapes.Sphere(at, 1.0)), _ball(shapes, at, 1.0)):
            contacts = _contacts(grid, tool)
            assert len(contacts) > 3
            for field in ("point", "normal", "depth", "area"):
                assert np.isfinite(getattr(contacts, field)).all()
            assert contacts.depth == pytest.approx(1.0 - np.linalg.norm(contacts.point - at, axis=1), abs=1e-9)
            rows = np.unique(np.column_stack([contacts.face, contacts.point]), axis=0)
            assert len(rows) == len(contacts)


def test_a_surface_shrunk_to_a_point_or_a_line_does_not_stop_the_rest(shapes):
    plate = shapes.plate(10.0)
    point, line = plate.control_points * 0 + [5.0, 5.0, 0.2], plate.control_points * [1.0, 0, 0] + [0, 5.0, 0.1]
    for net in (point, line):
        grid = PatchGrid.of(plate, 21)
        for tool in (FieldTool(shapes.Sphere([5.0, 5.0, 0.0], 1.0)), _ball(shapes, [5.0, 5.0, 0.0], 1.0)):
            contacts = detect([grid], [net], [tool], DetectOptions()).contacts
            assert np.isfinite(contacts.depth).all()
            assert np.isfinite(contacts.normal).all()
            truth = 1.0 - np.linalg.norm(contacts.point - [5.0, 5.0, 0.0], axis=1)
            assert len(contacts)
            assert contacts.depth == pytest.approx(truth, abs=1e-9)
