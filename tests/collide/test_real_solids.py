"""Solids from real CAD files as tools, trimmed faces and all: inside and outside as OCCT's solid classifier says."""

from __future__ import annotations

import numpy as np
import pytest

from cadsculpt.collide.closest import closest_points
from cadsculpt.collide.detect import DetectOptions, FieldTool, SurfaceTool, detect
from cadsculpt.collide.grid import PatchGrid

pytestmark = pytest.mark.corpus


def _solid(path):
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import TopAbs_SOLID
    from OCP.TopExp import TopExp_Explorer

    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    return TopExp_Explorer(reader.OneShape(), TopAbs_SOLID).Current()


@pytest.mark.parametrize("name", ["cube-mm.step", "sliced_cylinder.step", "bug30149_comb_bug.step"])
def test_vertices_in_contact_are_those_inside_the_solid(corpus, shapes, name):
    from OCP.BRepClass3d import BRepClass3d_SolidClassifier
    from OCP.gp import gp_Pnt
    from OCP.TopAbs import TopAbs_IN

    from cadsculpt.formats.registry import read

    path = corpus / "step" / name
    grids = tuple(PatchGrid.of(face.surface, 25) for face in read(path).faces)
    tool = SurfaceTool(grids, tuple(grid.surface.control_points for grid in grids))
    points = np.concatenate([net.reshape(-1, 3) for net in tool.nets])
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high - low))
    classifier = BRepClass3d_SolidClassifier(_solid(path))
    for axis in range(3):
        sheet = shapes.plate(1.2 * float((high - low).max()), 4, 3)
        net = sheet.control_points
        net = np.roll(net - net.reshape(-1, 3).mean(axis=0), axis, axis=2)
        net = net + 0.5 * (low + high) + np.array([0.004, 0.002, 0.003]) * size
        grid = PatchGrid.of(sheet.with_control_points(net), 27)
        contacts = detect([grid], [grid.surface.control_points], [tool], DetectOptions(tolerance=1e-4 * size)).contacts
        vertices = grid.matrices.points(net).reshape(-1, 3)
        inside = []
        for x in vertices:
            classifier.Perform(gp_Pnt(*map(float, x)), 1e-7 * size)
            inside.append(classifier.State() == TopAbs_IN)
        found = {tuple(np.round(x / size, 9)) for x in contacts.point}
        assert {tuple(np.round(x / size, 9)) for x in vertices[inside]} == found
        assert len(found) > 10


@pytest.mark.parametrize(
    "name",
    ["step/ec_exhaust-A.stp", "iges/impeller.igs", "iges/BUC50025.igs", "rhino/v2_Terrain.3dm", "rhino/v5_ring.3dm"],
)
def test_real_faces_miss_nothing(corpus, shapes, name):
    from cadsculpt.formats.registry import read

    rng = np.random.default_rng(0)
    for face in read(corpus / name).faces[:8]:
        surface = face.surface
        grid = PatchGrid.of(surface, 41)
        points = grid.matrices.points(surface.control_points, surface.weights)
        on = np.ones(grid.shape, dtype=bool) if grid.inside is None else grid.inside
        size = surface.size
        for radius in (0.3 * size, 0.03 * size, 0.003 * size):
            i, j = np.argwhere(on)[rng.integers(on.sum())]
            ball = shapes.Sphere(points[i, j] + rng.normal(size=3) * radius * 0.5, radius)
            contacts = detect(
                [grid], [surface.control_points], [FieldTool(ball)], DetectOptions(tolerance=1e-4 * size)
            ).contacts
            inside = (ball.distance(points.reshape(-1, 3)).reshape(grid.shape) <= 0) & on
            found = {tuple(np.round(x / size, 7)) for x in contacts.point}
            assert {tuple(np.round(x / size, 7)) for x in points[inside]} <= found
        near = points[on][rng.integers(on.sum(), size=20)] + rng.normal(size=(20, 3)) * 0.05 * size
        closest = closest_points(grid, surface.control_points, near)
        nearest = np.linalg.norm(near[:, None] - points[on][None], axis=2).min(axis=1)
        assert (closest.distance <= nearest + 1e-9 * size).all()
