"""What a run remembers, and whether expectations hold."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.collide.contacts import Contacts
from cadsculpt.expect import condition_in_words
from cadsculpt.history import History


def contacts(a: list[int], b: list[int], depth: list[float], area: list[float]) -> Contacts:
    n = len(a)
    points = np.zeros((n, 3))
    return Contacts(
        np.array(a), np.array(b), np.zeros(n, np.int64), np.arange(n) * 1.0, np.zeros(n), points, points,
        np.array(depth), np.array(area), points, np.full(n, -1), np.full(n, np.nan), np.full(n, np.nan),
    )  # fmt: skip


@pytest.fixture
def history() -> History:
    history = History.empty(2)
    nothing = np.full(2, np.nan)
    none = np.zeros(0, np.int64)
    history.add(0.1, none, Contacts.none(), np.zeros((0, 3)), np.zeros(0), np.array([3.0, np.nan]), nothing)
    history.add(
        0.2,
        np.array([0, 0, 1]),
        contacts([0, 0, 0], [0, 0, 1], [0.1, 0.3, -0.2], [1.0, 2.0, 5.0]),
        np.array([[0, 0, -3.0], [0, 4.0, 0], [0, 0, 0]]),
        np.array([0.05, 0.2, -0.1]),
        np.array([0.0, np.nan]),
        np.array([0.15, np.nan]),
    )
    history.add(
        0.3,
        np.array([1]),
        contacts([0], [1], [0.4], [2.5]),
        np.array([[0, 0, -1.0]]),
        np.array([0.6]),
        nothing,
        np.array([0.15, 0.25]),
    )
    return history


def test_values_per_pair(history):
    assert history.first_contact() == 0.15
    assert history.first_contact(0) == 0.15
    assert history.first_contact(1) == 0.25
    assert History.empty(2).first_contact(1) is None
    assert history.greatest("force", 0) == 5.0
    assert history.greatest("depth", 0) == 0.3
    assert history.greatest("penetration") == 0.6
    assert history.greatest("area", 0) == 3.0
    assert history.greatest("area", 1) == 2.5
    assert history.smallest_clearance(0) == 0.0


def test_steps_that_stay_too_deep_are_listed_as_ranges(history):
    assert history.too_deep(0.1) == [(2, 3, 0.6)]
    assert history.too_deep(0.5) == [(3, 3, 0.6)]
    assert history.too_deep(1.0) == []


def test_a_history_survives_as_arrays(history):
    again = History.of_arrays(history.arrays())
    np.testing.assert_array_equal(again.depth, history.depth)
    np.testing.assert_array_equal(again.time, history.time)


@pytest.mark.parametrize(
    ("expected", "words"),
    [
        ({"between": [0.7, 0.75]}, "between 0.7 and 0.75"),
        ({"at_most": 3.0}, "at most 3"),
        ({"equals": 2.0, "tolerance": 0.1}, "equals 2 (within 0.1)"),
        ({"never": "contact"}, "never contact"),
    ],
)
def test_conditions_in_words(expected, words):
    assert condition_in_words(expected) == words
