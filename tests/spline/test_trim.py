"""The inside of a trimmed face against closed formulas."""

from __future__ import annotations

import numpy as np

from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop
from cadsculpt.spline.trim import curve_points, inside


def polygon(points: list[tuple[float, float]], *, outer: bool = True) -> TrimLoop:
    closed = [*points, points[0]]
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    return TrimLoop(
        tuple(TrimCurve(np.array([a, b]), knots, 1) for a, b in zip(closed[:-1], closed[1:], strict=True)), outer
    )


def circle(centre: tuple[float, float], radius: float) -> TrimLoop:
    c, r, h = np.array(centre), radius, np.sqrt(0.5)
    corners = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]], dtype=float)
    knots = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4], dtype=float)
    return TrimLoop((TrimCurve(c + r * corners, knots, 2, np.array([1, h, 1, h, 1, h, 1, h, 1])),), outer=False)


def plate(trims: tuple[TrimLoop, ...] | None) -> BSplineSurface:
    x = np.array([0.0, 10.0])
    points = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((2, 2))], axis=-1)
    knots = np.array([0.0, 0.0, 10.0, 10.0])
    return BSplineSurface(points, knots, knots, 1, 1, trims=trims)


def test_a_square_with_a_round_hole():
    surface = plate((polygon([(1, 1), (9, 1), (9, 9), (1, 9)]), circle((5, 5), 2.0)))
    t = np.linspace(0, 10, 201) + 1e-4
    mask = inside(surface, t, t)
    x, y = np.meshgrid(t, t, indexing="ij")
    radius = np.hypot(x - 5, y - 5)
    expected = (x >= 1) & (x <= 9) & (y >= 1) & (y <= 9) & (radius > 2.0)
    near = np.abs(radius - 2.0) < 2e-2  # the circle is tested as chords
    np.testing.assert_array_equal(mask[~near], expected[~near])


def test_the_circle_is_a_circle():
    curve = circle((5, 5), 2.0).curves[0]
    points = curve_points(curve, np.linspace(0, 4, 99))
    np.testing.assert_allclose(np.hypot(*(points - 5).T), 2.0, rtol=1e-14)


def test_points_on_the_border_are_inside():
    surface = plate((polygon([(0, 0), (10, 0), (10, 10), (0, 10)]),))
    t = np.linspace(0, 10, 11)
    assert inside(surface, t, t).all()


def test_no_trims_means_the_whole_domain():
    assert inside(plate(None), np.linspace(0, 10, 5), np.linspace(0, 10, 4)).all()
