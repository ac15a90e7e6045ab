"""Contacts between the vertices of the finest grid: found, or said not to have been looked for to the end."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from cadsculpt.collide import quadrature
from cadsculpt.collide.detect import DetectOptions, FieldTool, detect
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.errors import InputError
from cadsculpt.spline.surface import TrimCurve, TrimLoop


@dataclass(frozen=True)
class Pressed:
    """A half-space that comes within `gap` of the plane z = 0 from below, with a ball on it."""

    gap: float
    centre: np.ndarray
    radius: float

    def distance(self, points):
        return np.minimum(points[:, 2] + self.gap, np.linalg.norm(points - self.centre, axis=1) - self.radius)

    def gradient(self, points):
        out = points - self.centre
        return out / np.linalg.norm(out, axis=1)[:, None]

    def nearest(self, points):
        return self.centre + self.radius * self.gradient(points)

    def box(self):
        return np.array([[-np.inf] * 3, [np.inf] * 3])


def _found(tool, plate, tolerance, margin=0.0):
    grid = PatchGrid.of(plate, 2)
    return detect([grid], [plate.control_points], [FieldTool(tool)], DetectOptions(tolerance=tolerance, margin=margin))


@pytest.fixture
def plate(shapes):
    """One cell of ten by ten."""
    return shapes.plate(10.0, 2, 1)


NOWHERE = np.array([5.0, 5.0, -5.0])


def test_a_small_tool_is_found_though_all_of_the_face_is_near_another(plate):
    """More parts than are cut at a time come within their own size of the tool until they are as small as the ball."""
    rng = np.random.default_rng(1)
    for _ in range(2):
        centre = np.append(rng.uniform(0.5, 9.5, 2), 0.0)
        found = _found(Pressed(1e-4, centre, 0.02), plate, 0.004)
        assert len(found.contacts)
        assert np.linalg.norm(found.contacts.point - centre, axis=1).max() <= 0.02
        assert (found.contacts.depth > 0).all()


def test_what_was_not_looked_for_to_the_end_is_said(plate, monkeypatch):
    near = Pressed(1e-4, NOWHERE, 0.1)
    assert _found(near, plate, 0.05).undecided == ()
    assert _found(Pressed(0.02, NOWHERE, 0.1), plate, 0.004, margin=0.01).undecided == ()
    for most in (4, 16):
        monkeypatch.setattr(quadrature, "MOST_SUBCELLS", most * 4096)
        monkeypatch.setattr(quadrature, "ROUND", 4096)
        found = _found(near, plate, 1e-4)
        assert len(found.contacts) == 0
        (lack,) = found.undecided
        assert (lack.body, lack.tool, lack.face) == (0, 0, 0)
        assert 1e-4 < lack.depth < 0.2
        # nothing deeper than what is said can be missed
        rng = np.random.default_rng(most)
        for _ in range(5):
            centre = np.append(rng.uniform(0.5, 9.5, 2), 0.0)
            assert len(_found(Pressed(1e-4, centre, 1.01 * lack.depth), plate, 1e-4).contacts)


def test_half_as_long_a_search_leaves_more_undecided(plate, monkeypatch):
    depth = []
    for most in (2, 8, 32):
        monkeypatch.setattr(quadrature, "MOST_SUBCELLS", most * 4096)
        monkeypatch.setattr(quadrature, "ROUND", 4096)
        depth.append(_found(Pressed(1e-4, NOWHERE, 0.1), plate, 1e-4).undecided[0].depth)
    assert depth[0] > 1.5 * depth[1] > 2.25 * depth[2]


def test_a_strip_thinner_than_the_tolerance_is_found(plate):
    """The ball reaches deep through a face that no middle of a part of the tolerance's size lies on."""
    line = np.array([0.0, 0, 1, 1])
    for angle in (0.1, 0.7, 1.3):
        # (the rest of the face is a corner far away)
        along = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-along[1], along[0]])
        middle = np.array([0.4871, 0.5313])
        corners = middle + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ np.stack([0.3 * along, 2e-4 * across])
        corner = np.array([[0, 0], [0.05, 0], [0, 0.05]])
        loops = (
            TrimLoop(tuple(TrimCurve(np.array([p, q]), line, 1) for p, q in pairwise([*ring, ring[0]])))
            for ring in (corners, corner)
        )
        strip = replace(plate, trims=tuple(loops))
        centre = np.append(10 * (middle + 0.2 * along), 0.0)
        found = _found(Pressed(5.0, centre, 0.06), strip, 0.05)
        assert len(found.contacts)
        away = (found.contacts.point[:, :2] - 10 * middle) @ across
        assert np.abs(away).max() <= 2.001e-3


def test_a_field_that_is_not_a_number_between_the_vertices_is_an_error(plate):
    class Hollow(Pressed):
        def distance(self, points):
            out = super().distance(points)
            return np.where(np.linalg.norm(points - [5, 5, 0], axis=1) < 1.0, np.nan, out)

    with pytest.raises(InputError, match="not a number"):
        _found(Hollow(1.0, NOWHERE, 0.1), plate, 0.01)
