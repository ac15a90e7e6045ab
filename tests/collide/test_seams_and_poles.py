"""Closed surfaces have no seam in the contact, poles are points like others, and no contact comes twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadsculpt.collide.detect import DetectOptions, FieldTool, PatchGrid, PointTool, SurfaceTool, detect


def _contacts(grid, tool, net=None, **options):
    net = grid.surface.control_points if net is None else net
    return detect([grid], [net], [tool], DetectOptions(**options)).contacts


def _force(contacts):
    """What a spring of unit stiffness gives: the sum of area times depth against the normals."""
    return -(contacts.area * contacts.depth) @ contacts.normal


def _about_z(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def _distinct(contacts):
    rows = np.column_stack([contacts.a, contacts.b, contacts.face, contacts.point])
    return len(np.unique(rows, axis=0)) == len(rows)


@pytest.mark.parametrize("kind", ["exact", "periodic"])
@pytest.mark.parametrize("made_of", ["field", "patches"])
def test_the_force_turns_with_the_tool(shapes, kind, made_of):
    """A ball pressed into a tube, turned about the axis by what the tube's own symmetry allows: over the seam and not."""
    step = 90.0 if kind == "exact" else 30.0
    grid = PatchGrid.of(shapes.cylinder(5.0, 10.0, closed_clamped=kind == "exact"), (97, 33))
    forces, areas = [], []
    for turn in np.arange(4) * step:
        centre = _about_z(turn) @ [6.0, 0.4, 5.1]
        if made_of == "field":
            tool = FieldTool(shapes.Sphere(centre, 2.0))
        else:
            patch = shapes.ball(2.0)
            net = patch.control_points @ _about_z(turn).T + centre
            tool = SurfaceTool((PatchGrid.of(patch, (33, 17)),), (np.ascontiguousarray(net),))
        contacts = _contacts(grid, tool)
        assert _distinct(contacts)
        forces.append(_about_z(turn).T @ _force(contacts))
        areas.append(contacts.area.sum())
    assert areas == pytest.approx([areas[0]] * 4, rel=1e-9)
    assert np.array(forces) == pytest.approx(np.array([forces[0]] * 4), rel=1e-7, abs=1e-7)


def test_a_tool_on_the_seam_feels_no_side(shapes):
    """Right over the seam, where the grid is its own mirror image: the force has no part along the seam's tangent."""
    for surface in (shapes.cylinder(5.0, 10.0), shapes.cylinder(5.0, 10.0, closed_clamped=False)):
        grid = PatchGrid.of(surface, (97, 41))
        contacts = _contacts(grid, FieldTool(shapes.Sphere(1.2 * surface.evaluate(grid.matrices.u[0], 0.5), 2.0)))
        seam = np.isin(contacts.u, grid.matrices.u[[0, -1]])
        assert 0 < seam.sum() < len(contacts) / 3
        force, radial = _force(contacts), surface.normal(grid.matrices.u[0], 0.5)
        assert np.linalg.norm(force - (force @ radial) * radial) < 1e-9 * np.linalg.norm(force)


def test_a_pole_is_one_contact_with_a_normal(shapes):
    """All of the pole's row is one point: one contact, with the area of all cells that end there."""
    R, d = 5.0, 0.3
    for flip in (1.0, -1.0):
        grid = PatchGrid.of(shapes.ball(R), (65, 257))
        tool = shapes.Sphere([0, 0, flip * (R + 1.0 - d)], 1.0)
        contacts = _contacts(grid, FieldTool(tool))
        pole = np.flatnonzero(np.abs(contacts.point - [0, 0, flip * R]).max(axis=1) < 1e-9)
        assert len(pole) == 1
        assert contacts.depth[pole] == pytest.approx([d])
        assert contacts.normal[pole[0]] == pytest.approx([0, 0, flip], abs=1e-9)
        assert _distinct(contacts)
        # the two balls meet in a circle: the cap of the model below it
        height = R - (R**2 - 1.0 + (R + 1.0 - d) ** 2) / (2 * (R + 1.0 - d))
        assert contacts.area.sum() == pytest.approx(2 * np.pi * R * height, rel=0.1)
        assert np.abs(_force(contacts)[:2]).max() < 1e-9


def test_a_patch_tool_and_a_point_at_the_pole(shapes):
    R = 5.0
    grid = PatchGrid.of(shapes.ball(R), (65, 65))
    patch = replace(shapes.plate(4.0), outward=False)
    sheet = SurfaceTool((PatchGrid.of(patch, 17),), (patch.control_points + [-2.0, -2.0, R - 0.1],))
    contacts = _contacts(grid, sheet)
    pole = np.flatnonzero(np.abs(contacts.point - [0, 0, R]).max(axis=1) < 1e-9)
    assert len(pole) == 1
    assert contacts.depth[pole] == pytest.approx([0.1])
    assert contacts.normal[pole[0]] == pytest.approx([0, 0, 1], abs=1e-9)
    assert _distinct(contacts)
    for z in (R - 0.2, -R + 0.2):
        touch = _contacts(grid, PointTool(np.array([0.0, 0.0, z]), 1.0))
        assert touch.depth == pytest.approx([0.2], abs=1e-9)
        assert touch.normal[0] == pytest.approx([0, 0, np.sign(z)], abs=1e-5)
    # a ball of patches whose own pole is what touches
    contacts = _contacts(
        PatchGrid.of(shapes.plate(10.0), 21), SurfaceTool((PatchGrid.of(shapes.ball(2.0), (17, 17)),),
        (shapes.ball(2.0).control_points + [5.0, 5.0, 1.9],)), tolerance=1e-3
    )  # fmt: skip
    assert len(contacts) > 3
    arm = contacts.point - [5.0, 5.0, 1.9]
    assert contacts.depth == pytest.approx(2.0 - np.linalg.norm(arm, axis=1), abs=1e-9)
    assert contacts.normal == pytest.approx(-arm / np.linalg.norm(arm, axis=1)[:, None], abs=1e-5)


def test_no_contact_comes_twice(shapes):
    """Random sheets, tubes and balls against random tools, small and large, of one field, one patch and six."""
    rng = np.random.default_rng(3)
    found = 0
    for k in range(60):
        surface = (
            shapes.random_surface(rng, rational=bool(k % 2)),
            shapes.cylinder(5.0, 10.0, closed_clamped=bool(k % 2)),
            shapes.ball(5.0),
        )[k % 3]
        grid = PatchGrid.of(surface, (int(rng.integers(5, 40)), int(rng.integers(5, 40))))
        (u0, u1), (v0, v1) = surface.domain
        at = surface.evaluate(rng.choice([u0, rng.uniform(u0, u1)]), rng.choice([v0, rng.uniform(v0, v1)]))
        size = 10.0 ** rng.uniform(-1, 0.7)
        faces = [[shapes.ball(size, at)], shapes.box(1.5 * size, at)][k % 2]
        grids = tuple(PatchGrid.of(face, (9, 9)) for face in faces)
        tools = [FieldTool(shapes.Sphere(at, size)), SurfaceTool(grids, tuple(g.surface.control_points for g in grids))]
        contacts = detect([grid], [surface.control_points], tools, DetectOptions(tolerance=1e-3)).contacts
        found += len(contacts)
        assert _distinct(contacts)
        keys = np.column_stack([contacts.b, contacts.face, contacts.u, contacts.v])
        assert np.array_equal(keys, keys[np.lexsort(keys.T[::-1])])
    assert found > 1000


def test_a_print_between_the_vertices_comes_once_from_all_patches_of_a_tool(shapes):
    """A cube of six patches within one cell: its print has the area of one side, not of six."""
    grid = PatchGrid.of(shapes.plate(10.0), 4)
    faces = shapes.box(0.8, [4.95, 5.02, 0.0])
    grids = tuple(PatchGrid.of(face, 5) for face in faces)
    tool = SurfaceTool(grids, tuple(g.surface.control_points for g in grids))
    contacts = _contacts(grid, tool, tolerance=1e-3)
    assert _distinct(contacts)
    assert contacts.area.sum() == pytest.approx(0.64, rel=0.3)
