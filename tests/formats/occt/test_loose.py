"""Faces that a file writes one by one and that lie edge to edge: which of their edges are one is seen in space."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cadsculpt.formats import registry
from cadsculpt.formats.occt.part import document_of_shapes
from cadsculpt.formats.occt.quiet import quiet
from cadsculpt.formats.occt.shape import shape_of_surface
from cadsculpt.spline.surface import BSplineSurface


def strip(left: float, lift: float = 0.0) -> BSplineSurface:
    """A curved strip 10 x 20 that begins at x = left; its left edge lifted in the middle."""
    x, y = np.meshgrid(np.linspace(0.0, 10.0, 5), np.linspace(0.0, 20.0, 5), indexing="ij")
    z = 0.02 * (y - 10.0) ** 2
    z[0, 2] += lift
    knots = np.array([0.0, 0, 0, 0, 0.5, 1, 1, 1, 1])
    return BSplineSurface(np.stack([x + left, y, z], axis=2), knots, knots, 3, 3)


def written(path: Path, *surfaces: BSplineSurface) -> Path:
    """A file of faces that the exporter did not sew."""
    with quiet():
        part = document_of_shapes([(f"f{n}", shape_of_surface(s)) for n, s in enumerate(surfaces, 1)])
        part.write(path, "iges" if path.suffix == ".igs" else "step")
    return path


@pytest.mark.parametrize("suffix", [".igs", ".step"])
def test_strips_side_by_side_are_neighbours(suffix: str, tmp_path: Path) -> None:
    part = registry.read(written(tmp_path / f"strips{suffix}", strip(0.0), strip(10.0), strip(40.0)))
    found = [[edge.neighbours for edge in face.edges if edge.neighbours] for face in part.faces]
    assert found == [[(2,)], [(1,)], []]
    for face, others in ((1, 2), (2, 1)):
        (edge,) = (edge for edge in part.faces.number(face).edges if edge.neighbours == (others,))
        np.testing.assert_allclose(edge.points[:, 0], 10.0, atol=1e-9)


def test_edges_that_run_apart_are_not_one(tmp_path: Path) -> None:
    part = registry.read(written(tmp_path / "apart.igs", strip(0.0), strip(10.0, lift=0.5)))
    assert not any(edge.neighbours for face in part.faces for edge in face.edges)
