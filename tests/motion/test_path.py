"""Tool paths against scipy's rotations, finite differences and closed formulas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from cadsculpt.errors import InputError
from cadsculpt.motion.path import (
    ToolPath,
    quaternion,
    rotation_of,
    rotation_of_quaternion,
    rotation_to_axis,
    rotation_vector,
)
from cadsculpt.motion.pose import Pose, rotation_matrix


@dataclass
class Row:
    t: float
    at: tuple[float, float, float]
    turn: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 0.0)


def random_path(seed: int, n: int = 6) -> ToolPath:
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.1, 1.0, n))
    return ToolPath(t, rng.normal(size=(n, 3)), Rotation.random(n, rng=rng).as_matrix())


seeds = st.integers(0, 2**32 - 1)
vectors = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)


@given(seeds, st.floats(0, 1))
def test_orientation_is_the_slerp_of_scipy(seed: int, f: float) -> None:
    path = random_path(seed)
    t = path.t[0] + f * (path.t[-1] - path.t[0])
    expected = Slerp(path.t, Rotation.from_matrix(path.rotation))(t).as_matrix()
    np.testing.assert_allclose(path.pose(t).rotation, expected, atol=1e-9)


@given(seeds, st.floats(0, 1))
def test_place_is_linear_between_the_rows(seed: int, f: float) -> None:
    path = random_path(seed)
    t = path.t[0] + f * (path.t[-1] - path.t[0])
    expected = [np.interp(t, path.t, path.at[:, axis]) for axis in range(3)]
    np.testing.assert_allclose(path.pose(t).at, expected, atol=1e-12)


@given(seeds, st.integers(0, 4), st.floats(0.01, 0.98))
def test_velocity_is_the_derivative_of_the_pose(seed: int, i: int, f: float) -> None:
    path = random_path(seed)
    dt = path.t[i + 1] - path.t[i]
    t, h = path.t[i] + f * dt, 1e-3 * dt
    linear, angular = path.velocity(t)
    before, after = path.pose(t - h), path.pose(t + h)
    np.testing.assert_allclose((after.at - before.at) / (2 * h), linear, atol=1e-9 / h)
    turned = Rotation.from_matrix(after.rotation @ before.rotation.T).as_rotvec()
    np.testing.assert_allclose(turned / (2 * h), angular, atol=1e-9 / h)


@given(seeds, st.integers(0, 4))
def test_velocity_at_a_row_is_that_of_the_motion_after_it(seed: int, i: int) -> None:
    path = random_path(seed)
    for at_row, inside in zip(path.velocity(path.t[i]), path.velocity(path.t[i] + 1e-6), strict=True):
        np.testing.assert_array_equal(at_row, inside)


def test_waits_before_and_stays_after() -> None:
    path = random_path(1)
    for t, i in ((0.0, 0), (path.t[0], 0), (path.t[-1], -1), (1e9, -1)):
        np.testing.assert_array_equal(path.pose(t).at, path.at[i])
        np.testing.assert_array_equal(path.pose(t).rotation, path.rotation[i])
    for t in (path.t[0] - 1e-9, path.t[-1], path.t[-1] + 1.0):
        assert not np.any(path.velocity(t))


@given(seeds)
def test_rows_come_back_bit_for_bit(seed: int) -> None:
    path = random_path(seed)
    for i, t in enumerate(path.t):
        np.testing.assert_array_equal(path.pose(t).at, path.at[i])
        np.testing.assert_array_equal(path.pose(t).rotation, path.rotation[i])


@given(seeds, st.floats(-0.2, 1.2), st.floats(-0.2, 1.2))
def test_twist_takes_one_pose_to_the_other(seed: int, f: float, g: float) -> None:
    path = random_path(seed)
    t0, t1 = (path.t[0] + x * (path.t[-1] - path.t[0]) for x in (f, g))
    shift, spin = path.twist(t0, t1)
    start, end = path.pose(t0), path.pose(t1)
    np.testing.assert_allclose(start.at + shift, end.at, atol=1e-12)
    np.testing.assert_allclose(rotation_of(spin) @ start.rotation, end.rotation, atol=1e-9)


@given(seeds, st.integers(0, 4), st.floats(0, 1), st.floats(0, 1))
def test_within_a_segment_the_twist_is_the_velocity_times_the_time(seed: int, i: int, f: float, g: float) -> None:
    path = random_path(seed)
    dt = path.t[i + 1] - path.t[i]
    t0, t1 = path.t[i] + f * dt, (path.t[i + 1] if g == 1.0 else path.t[i] + g * dt)
    if t0 >= path.t[i + 1]:
        return
    shift, spin = path.twist(t0, t1)
    linear, angular = path.velocity(t0)
    np.testing.assert_allclose(shift, linear * (t1 - t0), atol=1e-12)
    np.testing.assert_allclose(spin, angular * (t1 - t0), atol=1e-12)


def test_half_a_turn_goes_about_the_axis_as_written_and_reaches_its_end() -> None:
    path = ToolPath.of_rows([Row(0.0, (0, 0, 0)), Row(1.0, (0, 0, 0), (0, 0, 1, 180))])
    np.testing.assert_allclose(path.pose(0.5).rotation, rotation_matrix(np.array([0.0, 0, 1]), 90), atol=1e-15)
    np.testing.assert_allclose(path.twist(0.0, 1.0)[1], [0, 0, np.pi], atol=1e-15)
    np.testing.assert_allclose(path.velocity(0.3)[1], [0, 0, np.pi], atol=1e-15)


def test_a_tool_that_does_not_turn_has_exactly_the_identity() -> None:
    path = ToolPath.of_rows([Row(0.0, (0, 0, 1)), Row(3.0, (0, 0, -1)), Row(4.0, (5, 0, -1))])
    for t in np.linspace(0, 4, 23):
        np.testing.assert_array_equal(path.pose(t).rotation, np.eye(3))
    assert path.length == 7.0
    assert path.duration == 4.0
    assert not path.at_rest


def test_at_rest() -> None:
    assert ToolPath.resting(Pose.turned([1, 2, 3], [0, 1, 0], 30)).at_rest
    assert ToolPath.of_rows([Row(0, (1, 1, 1)), Row(1, (1, 1, 1))]).at_rest
    assert not ToolPath.of_rows([Row(0, (1, 1, 1)), Row(1, (1, 1, 1), (1, 0, 0, 5))]).at_rest


@given(seeds, st.floats(1e-3, 1e3))
def test_scaling_moves_places_alone(seed: int, factor: float) -> None:
    path = random_path(seed)
    scaled = path.scaled(factor)
    np.testing.assert_allclose(scaled.at, path.at * factor)
    np.testing.assert_array_equal(scaled.t, path.t)
    np.testing.assert_array_equal(scaled.rotation, path.rotation)
    assert scaled.length == pytest.approx(path.length * factor)


def test_rows_between_are_strictly_between() -> None:
    path = ToolPath.of_rows([Row(t, (t, 0, 0)) for t in (0.0, 1.0, 2.0, 3.0)])
    np.testing.assert_array_equal(path.rows_between(1.0, 3.0), [2.0])
    assert len(path.rows_between(1.2, 1.8)) == 0


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([], "one row or more"),
        ([Row(0, (0, 0, 0)), Row(1, (0, 0, 0)), Row(0.5, (0, 0, 0))], "row 3 goes back in time: t = 0.5 after 1.0"),
        ([Row(0, (0, 0, 0)), Row(0, (1, 0, 0))], "row 2 goes back"),
        ([Row(-1, (0, 0, 0))], "before time 0"),
        ([Row(0, (0, 0, 0)), Row(1, (0, np.nan, 0))], "row 2 holds a number that is not finite"),
        ([Row(np.inf, (0, 0, 0))], "row 1 holds a number that is not finite"),
    ],
)
def test_a_path_that_cannot_be_is_refused(rows: list[Row], words: str) -> None:
    with pytest.raises(InputError, match=words.replace(".", r"\.")):
        ToolPath.of_rows(rows)


def test_what_is_no_rotation_is_refused() -> None:
    for matrix in (2.0 * np.eye(3), np.diag([1.0, 1.0, -1.0])):
        with pytest.raises(InputError, match="row 1 has no rotation"):
            ToolPath(np.zeros(1), np.zeros((1, 3)), matrix[None])
    with pytest.raises(InputError, match="no number"):
        random_path(0).pose(float("nan"))


@given(vectors, st.floats(-20, 1.6))
def test_exp_and_log_are_scipys(direction: np.ndarray, exponent: float) -> None:
    vector = direction * min(10.0**exponent, np.pi / 2)  # from 1e-20 to near half a turn
    matrix = rotation_of(vector)
    np.testing.assert_allclose(matrix, Rotation.from_rotvec(vector).as_matrix(), atol=4e-16)
    np.testing.assert_allclose(rotation_vector(matrix), vector, atol=4e-16)


@given(seeds)
def test_quaternions_are_scipys(seed: int) -> None:
    rotation = Rotation.random(rng=np.random.default_rng(seed))
    q = quaternion(rotation.as_matrix())
    expected = rotation.as_quat(canonical=True, scalar_first=True)
    np.testing.assert_allclose(q * np.sign(q @ expected), expected, atol=1e-14)
    assert q[0] >= 0.0
    np.testing.assert_allclose(rotation_of_quaternion(3.0 * q), rotation.as_matrix(), atol=1e-14)


@settings(max_examples=50)
@given(st.sampled_from(list(np.ndindex(3, 3, 3))), st.sampled_from([90, 180, 270, 180 + 1e-9, 180 - 1e-9]))
def test_quaternions_near_half_turns(axis: tuple[int, int, int], degrees: float) -> None:
    matrix = rotation_matrix(np.array(axis, dtype=float) - 1.0, degrees)
    np.testing.assert_allclose(rotation_of_quaternion(quaternion(matrix)), matrix, atol=1e-15)
    np.testing.assert_allclose(rotation_of(rotation_vector(matrix)), matrix, atol=1e-15)


@given(vectors)
def test_the_rotation_to_an_axis_is_the_smallest(axis: np.ndarray) -> None:
    length = np.linalg.norm(axis)
    if length < 1e-3:
        return
    rotation = rotation_to_axis(axis)
    np.testing.assert_allclose(rotation @ [0, 0, 1], axis / length, atol=1e-15)
    smallest = np.arccos(np.clip(axis[2] / length, -1, 1))
    assert np.linalg.norm(rotation_vector(rotation)) == pytest.approx(smallest, abs=1e-7)


def test_the_rotation_to_an_axis_that_points_down_is_about_x() -> None:
    np.testing.assert_array_equal(rotation_to_axis(np.array([0.0, 0.0, -2.0])), np.diag([1.0, -1.0, -1.0]))
    np.testing.assert_array_equal(rotation_to_axis(np.array([0.0, 0.0, 2.0])), np.eye(3))
