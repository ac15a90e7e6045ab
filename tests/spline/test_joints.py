"""The seam of a closed surface stays closed, and it and multiple knots as smooth as they were, whatever the nodes do there."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.spline.adapt import Goal, fit_to_tolerance
from cadsculpt.spline.joints import Joint, joints, unknowns
from cadsculpt.spline.net_fit import NodeField, fit_net
from cadsculpt.spline.surface import BSplineSurface

Array = np.ndarray


def clamped_tube(degree: int = 3, spans: int = 8, *, periodic: bool = False) -> BSplineSurface:
    """A tube that is C^(degree - 1) all around: a periodic net, or the same surface with its ends clamped."""
    count = spans + degree
    angle = 2 * np.pi * np.arange(count) / spans
    z = np.linspace(0, 10, 6)
    net = np.stack(
        [np.broadcast_to(f, (6, count)).T for f in (5 * np.cos(angle), 5 * np.sin(angle), 0 * angle)], axis=-1
    )
    net = net + np.stack([0 * z, 0 * z, z], axis=-1)
    knots_u = np.arange(-degree, spans + degree + 1, dtype=float)
    knots_v = np.concatenate([np.zeros(3), [3.0, 5.0, 7.0], np.full(3, 10.0)])
    tube = BSplineSurface(net, knots_u, knots_v, degree, 2, periodic_u=True)
    if periodic:
        return tube
    from scipy.interpolate import BSpline, make_lsq_spline

    clamped = np.concatenate([np.zeros(degree), np.arange(spans + 1.0), np.full(degree, float(spans))])
    t = np.linspace(0, spans, 40 * spans)
    values = BSpline(knots_u, net.reshape(count, -1), degree)(t)
    points = make_lsq_spline(t, values, clamped, degree).c.reshape(-1, 6, 3)
    points[-1] = points[0]
    return BSplineSurface(points, clamped, knots_v, degree, 2)


def circle_tube() -> BSplineSurface:
    """An exact cylinder: four rational arcs, C0 in the net and C1 in space at every joint."""
    corners = np.array([(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0)], dtype=float)
    weight = np.where(np.arange(9) % 2, np.sqrt(0.5), 1.0)
    z = np.linspace(0, 10, 5)
    net = np.zeros((9, 5, 3))
    net[..., :2] = 5 * corners[:, None]
    net[..., 2] = z
    knots_u = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4], dtype=float)
    knots_v = np.array([0, 0, 0, 0, 5, 10, 10, 10, 10], dtype=float)
    return BSplineSurface(net, knots_u, knots_v, 2, 3, np.broadcast_to(weight[:, None], (9, 5)).copy())


def push_across_the_seam(surface: BSplineSurface, u: Array, v: Array, depth: float = 0.5) -> Array:
    """A smooth dent towards the axis around the middle of the seam."""
    low, high = surface.domain[0]
    angle = 2 * np.pi * (u - low) / (high - low)
    g = np.exp(-(np.sin(angle / 2 - 0.05)[:, None] ** 2) / 0.05 - ((v - 5.0) / 2.0) ** 2)
    points = surface.evaluate(u[:, None], v) * [1, 1, 0]
    return -depth * np.where(g > 1e-4, g, 0.0)[..., None] * points / np.linalg.norm(points, axis=2)[..., None]


def jets(surface: BSplineSurface, order: int) -> tuple[Array, Array]:
    v = np.linspace(*surface.domain[1], 33)
    low, high = surface.domain[0]
    a, b = (surface.derivatives(np.full(33, t), v, order) for t in (low, high))
    return a[: order + 1, 0], b[: order + 1, 0]


CASES = {
    "periodic cubic": (lambda: clamped_tube(periodic=True), 2),
    "periodic quintic": (lambda: clamped_tube(5, periodic=True), 4),
    "clamped quadratic": (lambda: clamped_tube(2), 1),
    "clamped cubic": (clamped_tube, 2),
    "clamped quartic": (lambda: clamped_tube(4), 3),
    "rational arcs": (circle_tube, 1),
}


@pytest.mark.parametrize("name", CASES)
def test_a_dent_over_the_seam_stays_closed_and_smooth(name):
    make, order = CASES[name]
    surface = make()
    assert surface.closed_u
    assert [joint.last for joint in joints(surface, 0) if joint.before != joint.after] in ([order], [])
    u, v = np.linspace(*surface.domain[0], 81)[:-1], np.linspace(0, 10, 41)
    field = NodeField.of(surface, u, v, push_across_the_seam(surface, u, v), closed=(True, False))
    fit = fit_to_tolerance(surface, field, Goal(5e-3, 1e-4, 5000))
    assert fit.outcome == "within"
    moved = fit.surface
    distance = moved.evaluate(u[:, None], v) - surface.evaluate(u[:, None], v) - field.displacement
    assert np.linalg.norm(distance, axis=2).max() <= 5e-3
    before, after = jets(surface, order), jets(moved, order)
    assert np.linalg.norm(after[0][0] - before[0][0], axis=1).max() > 0.2  # the seam did move
    assert np.abs(after[0][0] - after[1][0]).max() <= 1e-14
    for k in range(1, order + 1):
        scale = np.abs(after[0][k]).max()
        assert np.abs(after[0][k] - after[1][k]).max() <= 1e-9 * scale + 2 * np.abs(before[0][k] - before[1][k]).max()


def test_a_crease_at_the_seam_may_stay_a_crease():
    tube = clamped_tube()
    net = tube.control_points.copy()
    net[1] *= [1.2, 1.2, 1.0]
    creased = tube.with_control_points(net)
    assert creased.closed_u
    assert joints(creased, 0) == (Joint(8.0, 0.0, 0, 0),)
    assert joints(tube, 0) == (Joint(8.0, 0.0, 0, 2),)
    # closed is all that is asked: one row fewer
    assert unknowns(creased, 0, [], joints(creased, 0)).shape == (creased.shape[0], creased.shape[0] - 1)
    assert unknowns(tube, 0, [], joints(tube, 0)).shape == (tube.shape[0], tube.shape[0] - 3)


def test_the_fit_is_the_best_of_all_that_stay_smooth():
    """The clamped net's fit is the periodic net's: both are least squares over the same periodic splines."""
    periodic, clamped = clamped_tube(periodic=True), clamped_tube()
    u, v = np.linspace(0, 8, 41)[:-1], np.linspace(0, 10, 21)
    field = push_across_the_seam(periodic, u, v)
    fits = []
    for surface in (periodic, clamped):
        nodes = NodeField.of(surface, u, v, field, closed=(True, False))
        fits.append(fit_net(surface, nodes, 0.0, None).at(np.linspace(0, 8, 100), v))
    np.testing.assert_allclose(fits[0], fits[1], atol=1e-12)


def test_an_open_surface_has_as_many_unknowns_as_control_points():
    surface = circle_tube()
    np.testing.assert_array_equal(unknowns(surface, 1, [], ()), np.eye(5))
    halves = unknowns(surface, 1, [(4.9, 5.1)], ())
    assert halves.shape == (5, 5)
    assert unknowns(surface, 1, [(1.0, 9.0)], ()).shape == (5, 3)


def test_arcs_that_meet_smoothly_do_so_after_a_dent():
    """Double knots of a circle: no kink forms at them, at the seam or elsewhere."""
    surface = circle_tube()
    found = joints(surface, 0)
    assert [(joint.before, joint.after, joint.first, joint.last) for joint in found] == [
        (1.0, 1.0, 1, 1), (2.0, 2.0, 1, 1), (3.0, 3.0, 1, 1), (4.0, 0.0, 0, 1)
    ]  # fmt: skip
    u, v = np.linspace(0, 4, 81)[:-1], np.linspace(0, 10, 41)
    for shift in (0.0, 1.0):  # over the seam, over a knot inside
        field = push_across_the_seam(surface, u - shift, v)
        angle = np.pi / 2 * shift
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        nodes = NodeField.of(surface, u, v, field @ turn.T if shift else field, closed=(True, False))
        fit = fit_to_tolerance(surface, nodes, Goal(5e-3, 1e-4, 5000))
        assert fit.outcome == "within"
        z = np.linspace(0, 10, 41)
        for knot in (0.0, 1.0, 2.0, 3.0):
            before = fit.surface.normal(np.full(41, (knot or 4.0) - 1e-9), z)
            after = fit.surface.normal(np.full(41, knot + (1e-9 if knot else 0.0)), z)
            turned = np.degrees(np.arccos(np.clip(np.einsum("nc,nc->n", before, after), -1, 1)))
            assert turned.max() < 1e-4
