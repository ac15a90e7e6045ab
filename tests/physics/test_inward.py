"""Directions into the material: the normals where they work, smoothed where the surface turns too sharply."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.physics.fold import check_folds
from cadsculpt.physics.inward import inward_directions


def ridge(radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A sheet bent over a ridge along y: points, outward normals (away from the bend's inside), u, v."""
    u, v = np.linspace(-20, 20, 81), np.linspace(0, 10, 11)
    slope = 0.6 * u / np.hypot(u, radius)
    z = -0.6 * (np.hypot(u, radius) - radius)
    points = np.stack(np.broadcast_arrays(u[:, None], v[None, :], z[:, None]), axis=-1).astype(float)
    normal = np.stack([slope, 0 * u, np.ones_like(u)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return points, np.repeat(normal[:, None, :], len(v), axis=1), u, v


def test_where_the_lattice_stands_the_normals_are_kept_to_the_bit():
    points, normals, u, v = ridge(20.0)
    inward = inward_directions(points, normals, u, v, thickness=5.0, wrap=(False, False))
    np.testing.assert_array_equal(inward, -normals)


def test_a_sharp_ridge_gets_directions_that_do_not_cross():
    points, normals, u, v = ridge(0.5)
    columns = np.ones((80, 10), dtype=bool)
    with pytest.raises(InputError):
        check_folds(points, -normals, u, v, 5.0, (False, False), columns)
    inward = inward_directions(points, normals, u, v, thickness=5.0, wrap=(False, False))
    check_folds(points, inward, u, v, 5.0, (False, False), columns)
    np.testing.assert_allclose(np.linalg.norm(inward, axis=2), 1.0, rtol=1e-12)
    # symmetric as the ridge is
    np.testing.assert_allclose(inward[::-1, :, 0], -inward[:, :, 0], atol=1e-9)


def test_a_missing_normal_comes_from_its_neighbours():
    points, normals, u, v = ridge(20.0)
    normals[40, 5] = np.nan
    inward = inward_directions(points, normals, u, v, thickness=2.0, wrap=(False, False))
    assert np.isfinite(inward).all()
    np.testing.assert_allclose(inward[40, 5], [0, 0, -1], atol=0.1)


def test_a_box_corner_gets_the_mean_of_its_sides():
    """A flat tube and its lid as one surface: on the lid's corners three sides meet, and no side's normal suits all."""
    long = np.linspace(0.0, 36.0, 27)
    ring = np.concatenate(
        [
            np.column_stack([long[:-1], np.zeros(26)]),
            [(36.0, 0.0)],
            np.column_stack([long[:0:-1], np.full(26, 0.9)]),
            [(0.0, 0.9)],
        ]
    )
    middle = np.array([18.0, 0.45])
    lid = [np.column_stack([middle + s * (ring - middle), np.zeros(len(ring))]) for s in (0.25, 0.5, 0.75, 0.9, 1.0)]
    walls = [np.column_stack([ring, np.full(len(ring), -z)]) for z in (1.0, 2.1, 3.2, 4.3, 5.4)]
    points = np.stack([*lid, *walls])
    # one-sided, as a surface with creases gives them: of the lid along its rim, of the wall that begins at each corner
    normals = np.zeros_like(points)
    normals[:5] = [0.0, 0.0, 1.0]
    sides = [(26, (0.0, -1.0, 0.0)), (1, (1.0, 0.0, 0.0)), (26, (0.0, 1.0, 0.0)), (1, (-1.0, 0.0, 0.0))]
    normals[5:] = np.concatenate([np.tile(normal, (count, 1)) for count, normal in sides])
    u, v = np.arange(10.0), np.arange(54.0)
    columns = np.ones((9, 54), dtype=bool)
    inward = inward_directions(points, normals, u, v, thickness=0.02, wrap=(False, True))
    check_folds(points, inward, u, v, 0.02, (False, True), columns)
    assert (inward[4, :, 2] < 0.0).all()  # on the rim downwards, whatever else
