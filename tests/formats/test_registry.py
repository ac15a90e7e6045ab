"""Readers are chosen by content, writers by name; units can be overridden."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.formats import registry
from cadsculpt.formats.patch_json import write_surfaces
from cadsculpt.spline.surface import BSplineSurface


@pytest.fixture
def plate() -> BSplineSurface:
    knots = np.array([0.0, 0, 0, 1, 1, 1])
    X, Y = np.meshgrid([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], indexing="ij")
    return BSplineSurface(np.stack([X, Y, X * Y], axis=-1), knots, knots, 2, 2, name="plate")


@pytest.mark.parametrize(("format", "suffix"), [("step", ".stp"), ("iges", ".igs"), ("3dm", ".3dm"), ("json", ".json")])
def test_every_format_from_every_format(plate, tmp_path, format, suffix):
    write_surfaces(tmp_path / "a.json", [plate], "mm")
    part = registry.read(tmp_path / "a.json")
    first = tmp_path / f"b{suffix}"
    registry.write_part(part, first, format)
    again = registry.read(first)
    assert again.format == format
    assert len(again.faces) == 1
    for other in ("step", "iges", "3dm", "json"):
        second = tmp_path / f"c-{other}"
        registry.write_part(registry.read(first), second, other)
        surface = registry.read(second).faces[0].surface
        np.testing.assert_allclose(surface.control_points, plate.control_points, atol=1e-12)


def test_the_content_decides_and_the_name_is_mentioned(plate, tmp_path):
    write_surfaces(tmp_path / "a.json", [plate], "mm")
    registry.write_part(registry.read(tmp_path / "a.json"), tmp_path / "wrong.igs", "step")
    part = registry.read(tmp_path / "wrong.igs")
    assert part.format == "step"
    assert any("its name says IGES, but it is a STEP file" in line for line in part.warnings)


@pytest.mark.parametrize("suffix", [".json", ".3dm", ".step", ".igs"])
def test_units_can_be_overridden(plate, tmp_path, suffix):
    write_surfaces(tmp_path / "a.json", [plate], "mm")
    path = tmp_path / f"b{suffix}"
    registry.write_part(registry.read(tmp_path / "a.json"), path, registry.SUFFIXES[suffix])
    inch = registry.read(path, units="inch")
    assert inch.units == "in"
    np.testing.assert_allclose(inch.faces[0].surface.control_points, 25.4 * plate.control_points, rtol=1e-12)
    with pytest.raises(InputError, match="unknown length unit"):
        registry.read(path, units="furlong")


def test_what_is_no_cad_file(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("hello")
    with pytest.raises(InputError, match="no CAD file that cadsculpt reads"):
        registry.read(path)
    with pytest.raises(InputError, match=r"missing\.step"):
        registry.read(tmp_path / "missing.step")


@pytest.mark.parametrize("suffix", [".step", ".igs", ".3dm", ".json"])
def test_empty_and_nonsense_files_are_one_line(tmp_path, suffix):
    for content in (b"", b"nonsense\n", b"\x00" * 300):
        path = Path(tmp_path / f"x{suffix}")
        path.write_bytes(content)
        with pytest.raises(InputError) as error:
            registry.read(path)
        assert "\n" not in str(error.value)
        assert path.name in str(error.value)
