"""Outlines of tools for pictures: watertight, facing out, of the right volume, on the surface."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from cadsculpt.motion.pose import Pose
from cadsculpt.tools.composed import ComposedTool
from cadsculpt.tools.implicit import ImplicitTool
from cadsculpt.tools.outline import outline
from cadsculpt.tools.superquadric import SuperquadricTool

BOX, BALL = ImplicitTool.box((2.0, 2.0, 2.0)), ImplicitTool.sphere(0.8)


@pytest.mark.parametrize(
    ("tool", "volume"),
    [
        (SuperquadricTool.of((1.0, 2.0, 1.5), (1.0, 1.0)), 4 / 3 * np.pi * 3),
        (SuperquadricTool.of((1.0, 1.0, 1.0), (2.0, 2.0)), 4 / 3),
        (ComposedTool.formula("x*x + y*y + z*z - 1", ([-1.5] * 3, [1.5] * 3)), 4 / 3 * np.pi),
        (ComposedTool.formula("x - 3", ([-1.0] * 3, [1.0] * 3)), 8.0),
        (
            ComposedTool.difference([(BOX, Pose()), (BALL, Pose(np.array([0.0, 0.0, 1.0])))]),
            8 - 2 / 3 * np.pi * 0.8**3,
        ),
    ],
)
def test_it_is_closed_and_faces_out(tool, volume):
    points, triangles = outline(tool, scene_size=10.0)
    edges = Counter((int(a), int(b)) for t in triangles for a, b in zip(t, np.roll(t, -1), strict=True))
    assert max(edges.values()) == 1
    assert all((b, a) in edges for a, b in edges)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    assert (np.cross(a, b) * c).sum() / 6 == pytest.approx(volume, rel=0.01)
    np.testing.assert_allclose(tool.field(points)[0], 0.0, atol=1e-6)


def test_what_is_infinite_ends_with_the_picture():
    tool = ComposedTool.union([(ImplicitTool.half_space(), Pose()), (BALL, Pose())])
    points, triangles = outline(tool, scene_size=4.0)
    assert np.isfinite(points).all()
    assert len(triangles) > 100
    assert np.abs(points).max() < 4.0
