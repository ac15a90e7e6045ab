"""What acts during a step that is cut in pieces."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.collide.contacts import Contacts
from cadsculpt.motion.pose import Pose
from cadsculpt.reaction import StepActs


def contacts(tool: list[int], depth: list[float]) -> Contacts:
    n = len(tool)
    zeros, points, none = np.zeros(n, np.int64), np.zeros((n, 3)), np.full(n, np.nan)
    return Contacts(
        zeros, np.array(tool, np.int64), zeros, np.arange(n) * 1.0, np.zeros(n), points, points, np.array(depth), np.ones(n),
        points, zeros - 1, none, none,
    )  # fmt: skip


def test_each_tool_keeps_its_own_deepest_piece():
    """One tool is deepest early, the other late: both are remembered as they were then, in the fixed order."""
    acts, poses = StepActs(2, 1.0), [Pose(), Pose()]
    pieces = [([0, 1], [0.9, 0.1]), ([0, 1], [0.2, 0.3]), ([0], [0.05])]
    for k, (tool, depth) in enumerate(pieces):
        force = np.tile([0.0, 0.0, -float(k + 1)], (len(tool), 1))
        acts.add(contacts(tool, depth), force, np.array(depth), poses, poses, 0.25, 1e-3)
    assert acts.contacts.b.tolist() == [0, 1]
    assert acts.contacts.depth.tolist() == [0.9, 0.3]
    assert acts.depths.tolist() == [0.9, 0.3]
    assert acts.forces[:, 2].tolist() == [-1.0, -2.0]
    # the reaction is the impulse over the whole step
    assert acts.reaction(0).force[2] == pytest.approx(0.25 * (1 + 2 + 3))
    assert acts.reaction(1).force[2] == pytest.approx(0.25 * (1 + 2))
    assert acts.reaction(0).max_depth == 0.9


def test_nothing_that_acts_leaves_nothing():
    acts, poses = StepActs(1, 1.0), [Pose()]
    acts.add(contacts([0], [-0.5]), np.zeros((1, 3)), np.array([-0.4]), poses, poses, 1.0, 1e-3)
    assert len(acts.contacts) == 0
    assert acts.reaction(0).force.tolist() == [0.0, 0.0, 0.0]
