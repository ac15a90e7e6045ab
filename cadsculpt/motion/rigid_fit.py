"""The rigid motion nearest to a cloud of points that has moved."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .pose import Pose

Array = NDArray[np.float64]


def nearest_pose(rest: Array, now: Array, weights: Array) -> Pose:
    """The pose that takes points rest (n, 3) nearest to now (n, 3), in the sum of squares weighted by weights (n,).

    By the singular values of their correlation (Kabsch 1976, A solution for the best rotation to relate two sets of
    vectors); of a reflection, the nearest rotation.
    """
    share = weights / weights.sum()
    before, after = share @ rest, share @ now
    u, _, vt = np.linalg.svd((rest - before).T @ (share[:, None] * (now - after)))
    flip = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt)) or 1.0])
    rotation = (vt.T * flip) @ u.T
    return Pose(after - rotation @ before, rotation)
