"""Any part as a new 3DM file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.formats import step
from cadsculpt.formats.patch_part import PatchPart
from cadsculpt.formats.rhino import part as rhino
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

rhino3dm = pytest.importorskip("rhino3dm")


@pytest.mark.corpus
def test_a_step_solid_becomes_one_solid_brep(corpus: Path, tmp_path: Path) -> None:
    part = step.read(corpus / "step" / "cube-mm.step")
    rhino.write_part(part, tmp_path / "cube.3dm")
    rhino.write_part(part, tmp_path / "again.3dm")
    assert (tmp_path / "cube.3dm").read_bytes() == (tmp_path / "again.3dm").read_bytes()
    (thing,) = rhino3dm.File3dm.Read(str(tmp_path / "cube.3dm")).Objects
    assert thing.Geometry.IsValid
    assert thing.Geometry.IsSolid
    back = rhino.read(tmp_path / "cube.3dm")
    assert len(back.faces) == 6
    assert back.validity().valid
    assert sum(f.area for f in back.faces) == pytest.approx(sum(f.area for f in part.faces))


@pytest.mark.corpus
def test_curved_trimmed_step_faces_keep_their_trims(corpus: Path, tmp_path: Path) -> None:
    part = step.read(corpus / "step" / "ec_exhaust-A.stp")
    rhino.write_part(part, tmp_path / "exhaust.3dm")
    back = rhino.read(tmp_path / "exhaust.3dm")
    assert len(back.faces) == len(part.faces)
    assert not any("3DM" in warning for warning in part.warnings)
    assert back.validity().valid
    assert sum(f.area for f in back.faces) == pytest.approx(sum(f.area for f in part.faces), rel=1e-6)
    left = [face.surface.control_points for face in back.faces]
    for face in part.faces:
        net = face.surface.control_points
        if face.surface.periodic_u or face.surface.periodic_v:  # 3DM has no periodic rational nets: clamped there
            continue
        place = next(i for i, n in enumerate(left) if n.shape == net.shape and np.abs(n - net).max() <= 1e-9)
        left.pop(place)


def test_what_opennurbs_refuses_is_told(tmp_path: Path) -> None:
    """A trim that does not close cannot bound a Brep: the surface is written whole, and the part says so."""
    corners = np.array([(0.2, 0.2), (0.8, 0.2), (0.5, 0.8)])
    sides = [(corners[0], corners[1]), (corners[1], corners[2]), (corners[2], corners[0] + 0.05)]
    flat = np.array([0.0, 0.0, 1.0, 1.0])
    loop = TrimLoop(tuple(TrimCurve(np.array(side), flat, 1) for side in sides))
    u, v = np.meshgrid([0.0, 10.0], [0.0, 10.0], indexing="ij")
    surface = BSplineSurface(np.stack([u, v, u * v / 10], axis=-1), flat, flat, 1, 1, trims=(loop,), name="open")
    part = PatchPart(tmp_path / "x.json", "json", "mm", [surface])
    rhino.write_part(part, tmp_path / "open.3dm")
    assert part.warnings == ["in the 3DM file without their trims (1): open"]
    back = rhino.read(tmp_path / "open.3dm")
    assert not back.faces["open"].trimmed
    assert np.array_equal(back.faces["open"].surface.control_points, surface.control_points)


def test_nothing_to_write(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing to write"):
        rhino.write_part(PatchPart(tmp_path / "x.json", "json", "mm", []), tmp_path / "none.3dm")
    assert list(tmp_path.iterdir()) == []
