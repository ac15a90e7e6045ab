"""A step works in memory that is kept: nothing on its way allocates, and what the caller was given stays apart from it."""

from __future__ import annotations

import ast
import inspect
import textwrap

import numpy as np
import pytest

from cadsculpt import plain_loads, reaction, step_workspace
from cadsculpt.collide import broad, contacts, shape_contacts, shapes, spheres, surface_rows, workspace
from cadsculpt.collide.contacts import ContactBuffer, Contacts
from cadsculpt.collide.detect import DetectOptions, RigidSurfaceTool, SurfaceTool, detect
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.motion.pose import Pose
from cadsculpt.physics import forces
from cadsculpt.spline import refit
from cadsculpt.spline.surface import BSplineSurface

KERNELS = [
    workspace.load, broad.fill_near, broad.fill_boxes_of, shapes.world_box, shapes.into_frame, shape_contacts.shape_rows,
    surface_rows.surface_rows, contacts.sorted_rows, reaction.sum_acts, reaction.keep_acting, plain_loads.all_rigid,
    plain_loads.carried, plain_loads.gather, plain_loads.by_material, plain_loads.scatter, plain_loads.at_rest,
    forces.spread_weights, forces.fill_cells, refit.moved_box, step_workspace.farthest, step_workspace.moved_net,
    step_workspace.any_untouched,
]  # fmt: skip
"""The kernels that a step calls from collision to refit; that of the lattices has tests of its own."""

ALLOCATING = {
    "empty",
    "zeros",
    "ones",
    "full",
    "copy",
    "empty_like",
    "zeros_like",
    "array",
    "arange",
    "concatenate",
    "grown",
}


def _called(kernel):
    """The kernel's tree, and those kernels that it calls."""
    function = kernel.py_func
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    names = {n.func.id for n in ast.walk(tree) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}
    return tree, [function.__globals__[n] for n in names if hasattr(function.__globals__.get(n), "py_func")]


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.py_func.__name__)
def test_no_kernel_on_the_way_allocates(kernel):
    # (what the paper's mode alone asks)
    seen, waiting = {spheres.normals_agree.py_func}, [kernel]
    while waiting:
        one = waiting.pop()
        if one.py_func in seen:
            continue
        seen.add(one.py_func)
        tree, called = _called(one)
        waiting += called
        for node in ast.walk(tree):
            if isinstance(node, ast.Call):
                name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                assert name not in ALLOCATING, f"{one.py_func.__name__} calls {name}"


def _plate(bump: float = 0.0) -> BSplineSurface:
    knots = np.array([0.0, 0, 0, 0, 0.5, 1, 1, 1, 1])
    x = np.linspace(0.0, 10.0, 5)
    X, Y = np.meshgrid(x, x, indexing="ij")
    return BSplineSurface(np.stack([X, Y, bump * np.sin(X) * np.cos(Y)], axis=-1), knots, knots, 3, 3)


def _dome() -> BSplineSurface:
    """z = 0.15 (x^2 + y^2), its lowest point at the origin, out of it downwards."""
    knots = np.array([0.0, 0, 0, 1, 1, 1])
    x, square = np.array([-3.0, 0.0, 3.0]), 0.15 * np.array([9.0, -9.0, 9.0])
    X, Y = np.meshgrid(x, x, indexing="ij")
    return BSplineSurface(np.stack([X, Y, square[:, None] + square], axis=-1), knots, knots, 2, 2, outward=False)


@pytest.mark.parametrize("seed", range(4))
def test_a_tool_in_its_own_frame_has_the_contacts_of_the_same_tool_in_the_world(seed):
    rng = np.random.default_rng(seed)
    model, tool = _plate(0.2), _dome()
    grid, its = PatchGrid.of(model, 41), PatchGrid.of(tool, 25)
    pose = Pose.turned([5.0 + rng.normal(), 5.0 + rng.normal(), -0.3], rng.normal(size=3), 20.0)
    world = SurfaceTool((its,), (np.ascontiguousarray(pose.to_world(tool.control_points)),))
    rigid = RigidSurfaceTool((its,), (tool.control_points,), pose.at, pose.rotation)
    options = DetectOptions(margin=0.05)
    a, b = (detect([grid], [model.control_points], [t], options).contacts for t in (world, rigid))
    assert len(a) == len(b) > 10
    for name in ("u", "v", "point", "normal", "depth", "area", "tool_point", "tool_u", "tool_v"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-7, err_msg=name)
    np.testing.assert_allclose(a.depth, b.depth, atol=1e-12)


def test_all_vertices_below_a_dome_are_found():
    """Against the formula: the depth at a vertex of the plate below the dome, by dense search."""
    model, tool = _plate(), _dome()
    grid, its = PatchGrid.of(model, 61), PatchGrid.of(tool, 25)
    depth = 0.5
    net = tool.control_points + [5.1, 4.9, -depth]
    found = detect([grid], [model.control_points], [SurfaceTool((its,), (net,))], DetectOptions()).contacts
    points = grid.matrices.points(model.control_points).reshape(-1, 3)
    height = 0.15 * ((points[:, 0] - 5.1) ** 2 + (points[:, 1] - 4.9) ** 2) - depth
    assert len(found) == (height <= 0).sum() > 50
    t = np.linspace(0, 2.5, 20001)
    rho = np.hypot(found.point[:, 0] - 5.1, found.point[:, 1] - 4.9)
    near = np.array([np.hypot(t - r, 0.15 * t * t - depth).min() for r in rho])
    np.testing.assert_allclose(found.depth, near, atol=1e-6)


def _some(n: int, tool: int = 0) -> Contacts:
    i, x, p = np.full(n, 0), np.arange(n, dtype=float), np.zeros((n, 3))
    return Contacts(i, i + tool, i, x, x, p, p, x, x, p, i, x, x)


def test_a_buffer_keeps_what_it_held_as_it_grows_and_sorts():
    buffer = ContactBuffer()
    buffer.append(_some(3, tool=1))
    buffer.append(_some(200))
    buffer.sort()
    rows = buffer.view()
    assert rows.b.tolist() == [0] * 200 + [1] * 3
    assert rows.u.tolist() == [*range(200), 0, 1, 2]
    kept = rows.copy()
    buffer.count = 0
    buffer.append(_some(5, tool=7))
    assert kept.b[0] == 0
    assert rows.b[0] == 7
