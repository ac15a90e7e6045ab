"""One rigid motion within a step."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.motion.motion import Motion
from cadsculpt.motion.path import ToolPath, rotation_of
from cadsculpt.motion.pose import Pose


def _random(seed):
    rng = np.random.default_rng(seed)
    start = Pose(rng.normal(size=3), rotation_of(rng.normal(size=3)))
    return rng, Motion(start, rng.normal(size=3), rng.normal(scale=3.0, size=3))


@pytest.mark.parametrize("seed", range(5))
def test_points_at_their_own_times_are_those_of_the_pose(seed):
    rng, motion = _random(seed)
    points, s = rng.normal(size=(20, 3)), rng.uniform(size=20)
    local = motion.to_tool(points, s)
    for x, y, t in zip(points, local, s, strict=True):
        np.testing.assert_allclose(y, motion.pose(t).to_tool(x), atol=1e-12)
        np.testing.assert_allclose(
            motion.to_world(y[None], np.array([t]))[0], motion.pose(t).direction_to_world(y), atol=1e-12
        )


@pytest.mark.parametrize("seed", range(5))
def test_speed_and_arc_are_bounds(seed):
    rng, motion = _random(seed)
    x = rng.normal(size=3)
    radius = float(np.linalg.norm(x))
    times = np.sort(rng.uniform(size=200))
    places = np.array([motion.pose(t).to_world(x) for t in times])
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)
    assert speeds.max() <= motion.speed(radius) * (1 + 1e-9)
    for s0, s1 in ((0.0, 1.0), (0.2, 0.3), (0.5, 0.51)):
        a, b = motion.pose(s0).to_world(x), motion.pose(s1).to_world(x)
        for f in np.linspace(0, 1, 20):
            chord = (1 - f) * a + f * b
            off = np.linalg.norm(motion.pose(s0 + f * (s1 - s0)).to_world(x) - chord)
            assert off <= motion.arc(radius, s0, s1) + 1e-12
    # and no wilder than that: on a small turn about an axis through the side, the bound is reached in the middle
    turn = Motion(Pose(), np.zeros(3), np.array([0.0, 0.0, 0.01]))
    ends = [turn.pose(s).to_world(np.array([2.0, 0, 0])) for s in (0.0, 0.5, 1.0)]
    assert np.linalg.norm(ends[1] - 0.5 * (ends[0] + ends[2])) == pytest.approx(turn.arc(2.0, 0, 1), rel=1e-4)


def test_it_is_the_paths_own():
    path = ToolPath(
        np.array([0.0, 2.0]), np.array([[0.0, 1, 2], [3, 4, 8]]),
        np.array([np.eye(3), rotation_of(np.array([0.3, 1.0, -0.4]))]),
    )  # fmt: skip
    motion = Motion.of_path(path, 0.5, 1.7)
    for s in (0.0, 0.3, 1.0):
        pose, own = motion.pose(s), path.pose(0.5 + 1.2 * s)
        np.testing.assert_allclose(pose.at, own.at, atol=1e-12)
        np.testing.assert_allclose(pose.rotation, own.rotation, atol=1e-12)
    between = Motion.between(path.pose(0.5), path.pose(1.7))
    np.testing.assert_allclose(between.rotation, motion.rotation, atol=1e-12)
    np.testing.assert_allclose(between.displacement, motion.displacement, atol=1e-12)


def test_bad_numbers_are_errors():
    for bad in (np.nan, np.inf):
        with pytest.raises(InputError, match="not finite"):
            Motion(Pose(), np.array([bad, 0, 0]))
        with pytest.raises(InputError, match="not finite"):
            Motion(Pose(), np.zeros(3), np.array([0, bad, 0]))
        with pytest.raises(InputError, match="not finite"):
            Motion(Pose(np.array([bad, 0, 0])))


@pytest.mark.parametrize("seed", range(5))
def test_the_box_of_a_posed_box_holds_its_corners_and_no_more(seed):
    rng, motion = _random(seed)
    corners = np.sort(rng.normal(size=(2, 3)), axis=0)
    all_eight = np.stack(np.meshgrid(*corners.T, indexing="ij"), axis=-1).reshape(-1, 3)
    world = motion.start.to_world(all_eight)
    np.testing.assert_allclose(motion.start.box(corners), [world.min(axis=0), world.max(axis=0)], atol=1e-12)
