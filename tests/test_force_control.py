"""Tools pushed with a force: against springs of known stiffness, and in whole scenes against the formula."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadsculpt.errors import InputError, SimulationError
from cadsculpt.force_control import FORCE_TOLERANCE, Push, PushMemory, find_poses
from cadsculpt.motion.path import ToolPath
from cadsculpt.motion.pose import Pose

DOWN = np.array([0.0, 0.0, -1.0])


def path(*heights: float) -> ToolPath:
    n = len(heights)
    at = np.array([[0.0, 0.0, z] for z in heights])
    return ToolPath(np.arange(n, dtype=float), at, np.tile(np.eye(3), (n, 1, 1)))


def pressed(force: float, law, steps: int = 300, dt: float = 0.01, heights=(5.0, -5.0), direction=None):
    """A tool sent along z against a law R(z) [N]: its heights, and the number of trials of each step."""
    way = path(*heights)
    push = Push.of(force, direction, way)
    memory, pose = PushMemory.of(1), way.pose(0.0)
    z, trials = [], []
    for step in range(steps):
        tried = []

        def trial(poses, tried=tried):
            tried.append(poses[0])
            return np.array([[0.0, 0.0, law(poses[0].at[2])]])

        find_poses({0: push}, memory, [pose], [way.pose((step + 1) * dt)], dt, trial)
        pose = tried[-1]
        z.append(pose.at[2])
        trials.append(len(tried))
    return np.array(z), trials


@settings(max_examples=60, deadline=None)
@given(st.floats(-2, 6), st.floats(0.01, 100))
def test_a_spring_is_pressed_by_force_over_stiffness(log_stiffness, force):
    stiffness = 10.0**log_stiffness
    z, trials = pressed(force, lambda z: stiffness * max(0.0, -z))
    rest = force / stiffness
    if rest < 4.9:
        assert z[-1] == pytest.approx(-rest, rel=2 * FORCE_TOLERANCE)
        assert max(trials) <= 30
        assert np.mean(trials) < 4
    else:
        assert z[-1] == -5.0  # the path ends before the force is met
    # free, it follows its path to the bit
    assert z[10] == path(5.0, -5.0).pose(0.11).at[2]


def test_it_goes_no_faster_than_its_path():
    # a wall that gives way at once after two seconds would let it jump
    z, _ = pressed(1.0, lambda z: 10.0 if z < 0.0 else 0.0, steps=80)
    assert z[-1] == pytest.approx(0.0, abs=1e-6)
    way = path(5.0, -5.0)
    push, memory = Push.of(1.0, None, way), PushMemory.of(1)
    pose = Pose(np.array([0.0, 0.0, 0.0]))
    seen = []
    find_poses(
        {0: push},
        memory,
        [pose],
        [Pose(np.array([0, 0, -5.0]))],
        0.01,
        lambda p: (seen.append(p[0]), np.zeros((1, 3)))[1],
    )
    assert seen[-1].at[2] == pytest.approx(-0.1)


def test_it_lifts_off_when_its_path_does():
    z, _ = pressed(2.0, lambda z: 4.0 * max(0.0, -z), heights=(1.0, -3.0, 5.0), steps=200)
    assert z.min() == pytest.approx(-0.5, rel=1e-2)
    assert z[-1] == 5.0


def test_material_that_pushes_harder_moves_it_back():
    way = path(0.0, -3.0)
    push, memory = Push.of(1.0, None, way), PushMemory.of(1)
    seen = []

    def trial(poses):
        seen.append(poses[0].at[2])
        return np.array([[0.0, 0.0, 10.0 * max(0.0, -poses[0].at[2])]])

    find_poses({0: push}, memory, [Pose(np.array([0.0, 0.0, -0.11]))], [way.pose(0.9)], 0.1, trial)
    assert seen[-1] == pytest.approx(-0.1, rel=1e-2)


def test_across_its_direction_it_follows_its_path():
    push = Push(1.0, DOWN, 10.0)
    memory = PushMemory.of(1)
    seen = []

    def trial(poses):
        seen.append(poses[0].at)
        return np.array([[3.0, 0.0, 2.0 * max(0.0, -poses[0].at[2])]])

    target = Pose(np.array([7.0, -2.0, -4.0]), Pose.turned([0, 0, 0], [1, 0, 0], 20.0).rotation)
    find_poses({0: push}, memory, [Pose(np.array([6.5, -2.0, -0.4]))], [target], 0.1, trial)
    np.testing.assert_allclose(seen[-1], [7.0, -2.0, -0.5], atol=2e-3)


def test_two_tools_on_one_spring_bed_share_it():
    # each sinks under itself and, less, under the other
    pushes = {0: Push(1.0, DOWN, 1.0), 1: Push(3.0, DOWN, 1.0)}
    matrix = np.array([[5.0, 1.5], [1.5, 8.0]])
    memory, poses = PushMemory.of(2), [Pose(), Pose(np.array([9.0, 0, 0]))]
    for _ in range(100):
        last = []

        def trial(tried, last=last):
            last[:] = tried
            sunk = np.array([-pose.at[2] for pose in tried])
            force = np.zeros((2, 3))
            force[:, 2] = matrix @ sunk
            return force

        targets = [Pose(np.array([pose.at[0], 0, -5.0])) for pose in poses]
        find_poses(pushes, memory, poses, targets, 0.05, trial)
        poses = list(last)
    sunk = [-pose.at[2] for pose in poses]
    np.testing.assert_allclose(matrix @ sunk, [1.0, 3.0], rtol=FORCE_TOLERANCE * 1.01)


def test_paths_that_lead_nowhere_are_refused():
    with pytest.raises(InputError, match="does not move"):
        Push.of(1.0, None, path(1.0))
    with pytest.raises(InputError, match="never moves along its direction"):
        Push.of(1.0, [0, 0, 1], path(1.0, -1.0))
    with pytest.raises(InputError, match="no length"):
        Push.of(1.0, [0, 0, 0], path(1.0, -1.0))


def test_a_reaction_without_a_root_is_said():
    flip = [0]

    def trial(poses):
        flip[0] += 1
        return np.array([[0.0, 0.0, np.nan]])

    with pytest.raises(SimulationError, match="does not find"):
        find_poses({0: Push(1.0, DOWN, 1.0)}, PushMemory.of(1), [Pose()], [Pose(DOWN)], 0.1, trial)
