"""Boxes that hold a body along its path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .path import ToolPath
from .pose import Pose

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SAMPLES = 256
"""Places along a path at which a body's box is taken."""

EVERYWHERE: Array = np.array([[[-np.inf] * 3, [np.inf] * 3]])
"""The box (1, 2, 3) of a body that may be anywhere."""


def sample_times(path: ToolPath, samples: int = SAMPLES) -> Array:
    """The rows of a path and times in between, s."""
    return np.unique(np.concatenate([path.t, np.linspace(path.t[0], path.t[-1], samples)]))


def swept_boxes(corners: Array, path: ToolPath) -> Array:
    """Boxes (k, 2, 3) in the world that together hold a body of the box (2, 3), in its own frame, along its path."""
    if not np.isfinite(corners).all():
        return EVERYWHERE
    ends = np.array([path.pose(float(t)).box(corners) for t in sample_times(path)])
    # between two samples the body is inside the box of both
    joined = np.stack([np.minimum(ends[:-1, 0], ends[1:, 0]), np.maximum(ends[:-1, 1], ends[1:, 1])], axis=1)
    return joined if len(joined) else ends


def seen_boxes(boxes: Array, corners: Array, path: ToolPath, samples: int = 64) -> Array:
    """Boxes (k, 2, 3) in the frame of a body of the box `corners` (2, 3) that hold, as it moves along its path, what it meets
    of the world's boxes (n, 2, 3)."""
    found = []
    times = sample_times(path, samples)
    places = [path.pose(float(t)) for t in times]
    for before, after in zip(places, places[1:] or places, strict=False):
        low, high = np.array([before.box(corners), after.box(corners)]).transpose(1, 0, 2)
        low, high = low.min(axis=0), high.max(axis=0)
        # what the boxes share with that of the body is where it may be touched
        cut = np.stack([np.maximum(boxes[:, 0], low), np.minimum(boxes[:, 1], high)], axis=1)
        for box in cut[(cut[:, 0] <= cut[:, 1]).all(axis=1)]:
            for pose in (before, after):
                found.append(Pose(-pose.rotation.T @ pose.at, pose.rotation.T).box(box))
    return np.array(found).reshape(-1, 2, 3)


def overlap(a: Array, b: Array) -> bool:
    """Whether any box of a (n, 2, 3) meets any of b (m, 2, 3)."""
    apart = (a[:, None, 0] > b[None, :, 1]) | (b[None, :, 0] > a[:, None, 1])
    return bool((~apart.any(axis=2)).any())


def grown(boxes: Array, by: float) -> Array:
    """Boxes (n, 2, 3), larger by a length on every side."""
    return boxes + np.array([[-by], [by]])
