"""NURBS-Python's JSON: its own example file, its conventions for trims, and every fault with its place."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BSpline

from cadsculpt.errors import InputError
from cadsculpt.formats import geomdl_json, patch_json
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

FLAT = [0.0, 0.0, 1.0, 1.0]


def sheet(trims: list[dict[str, Any]] | None = None, **changes: Any) -> dict[str, Any]:
    """A flat 2 x 3 net over a unit square, as geomdl writes it; None takes a key away."""
    surface: dict[str, Any] = {
        "type": "spline", "rational": False, "dimension": 3, "degree_u": 1, "degree_v": 2, "knotvector_u": FLAT,
        "knotvector_v": [0, 0, 0, 1, 1, 1], "size_u": 2, "size_v": 3, "delta": [0.05, 0.05],
        "control_points": {"points": [[u, v / 2, 0.0] for u in range(2) for v in range(3)]},
    }  # fmt: skip
    if trims is not None:
        surface["trims"] = {"count": len(trims), "data": trims}
    surface |= changes
    return {"shape": {"type": "surface", "count": 1, "data": [{k: v for k, v in surface.items() if v is not None}]}}


def ring(radius: float, sign: int = 1, **more: Any) -> dict[str, Any]:
    """A full circle around the middle of the square; sign -1 runs clockwise."""
    corners = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0)][::sign]
    return {
        "type": "spline", "degree": 2, "knotvector": [0, 0, 0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75, 1, 1, 1],
        "control_points": {
            "points": [[0.5 + radius * x, 0.5 + radius * y] for x, y in corners],
            "weights": [1, math.sqrt(0.5)] * 4 + [1],
        },
        **more,
    }  # fmt: skip


def part_of(tmp_path: Path, document: object) -> Any:
    (tmp_path / "g.json").write_text(json.dumps(document))
    return patch_json.read(tmp_path / "g.json")


@pytest.mark.corpus
def test_geomdls_own_example(corpus: Path, tmp_path: Path) -> None:
    """A cylinder; evaluated against scipy in homogeneous coordinates."""
    path = corpus / "spline" / "surface.json"
    part = patch_json.read(path)
    assert (part.format, part.units, len(part.faces)) == ("geomdl", "", 1)
    assert any("no length unit" in warning for warning in part.warnings)
    surface = part.faces[0].surface
    assert (surface.degree_u, surface.degree_v, surface.shape) == (1, 2, (2, 9))
    raw = json.loads(path.read_text())["shape"]["data"][0]
    points = np.array(raw["control_points"]["points"]).reshape(2, 9, 3)
    weights = np.array(raw["control_points"]["weights"]).reshape(2, 9)
    assert np.array_equal(surface.control_points, points)
    assert surface.weights is not None
    assert np.array_equal(surface.weights, weights)
    homogeneous = np.concatenate([points * weights[..., None], weights[..., None]], axis=2)
    u, v = np.linspace(0, 1, 13), np.linspace(0, 1, 29)
    along = BSpline(np.array(raw["knotvector_u"]), homogeneous, 1)(u)
    truth = BSpline(np.array(raw["knotvector_v"]), np.moveaxis(along, 1, 0), 2)(v)
    truth = np.moveaxis(truth[..., :3] / truth[..., 3:], 0, 1)
    assert np.abs(surface.evaluate(u[:, None], v) - truth).max() <= 1e-14
    assert part.faces[0].area == pytest.approx(2 * math.pi, rel=1e-4)  # its weights are rounded to 0.7071
    assert [edge.seam for edge in part.faces[0].edges] == [True, False, True, False]
    part.write(tmp_path / "back.json", "json")
    back = patch_json.read(tmp_path / "back.json")
    assert back.format == "geomdl"
    assert np.array_equal(back.faces[0].surface.control_points, points)
    assert np.array_equal(back.faces[0].surface.knots_v, surface.knots_v)


def test_control_points_run_along_v_first(tmp_path: Path) -> None:
    surface = part_of(tmp_path, sheet()).faces[0].surface
    assert surface.shape == (2, 3)
    assert np.allclose(surface.evaluate(0.25, 0.5), [0.25, 0.5, 0.0])


def test_one_surface_without_a_list(tmp_path: Path) -> None:
    document = sheet(name="deck")
    document["shape"]["data"] = document["shape"]["data"][0]
    assert part_of(tmp_path, document).faces["deck"].number == 1


@pytest.mark.parametrize(
    ("trims", "area"),
    [
        ([ring(0.25, -1)], 1 - math.pi / 16),  # clockwise: cut out of the whole
        ([ring(0.25, 1)], math.pi / 16),  # anticlockwise: what is inside stays
        ([ring(0.25, 1, reversed=0)], 1 - math.pi / 16),  # the sense goes before the direction
        ([ring(0.25, -1, reversed=1)], math.pi / 16),
        ([ring(0.4, 1, reversed=1), ring(0.25, 1, reversed=0)], math.pi * (0.16 - 0.0625)),
        ([{"type": "freeform", "points": [[0.2, 0.2], [0.2, 0.7], [0.7, 0.7], [0.2, 0.2]], "reversed": 0}], 1 - 0.125),
    ],
)
def test_trims_keep_or_cut(tmp_path: Path, trims: list[dict[str, Any]], area: float) -> None:
    part = part_of(tmp_path, sheet(trims))
    assert part.faces[0].trimmed
    assert part.faces[0].area == pytest.approx(area, rel=1e-6)
    assert part.validity().valid


def test_a_container_is_one_loop(tmp_path: Path) -> None:
    corners = [[0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75], [0.25, 0.25]]
    sides = [
        {"type": "spline", "degree": 1, "knotvector": FLAT, "control_points": {"points": corners[k : k + 2]}}
        for k in range(4)
    ]
    part = part_of(tmp_path, sheet([{"type": "container", "count": 4, "data": sides, "reversed": 1}]))
    (loop,) = part.faces[0].surface.trims
    assert len(loop.curves) == 4
    assert part.faces[0].area == pytest.approx(0.25)


def test_there_and_back(tmp_path: Path) -> None:
    """Knots and trims of a trimmed surface run from 0 to 1, as NURBS-Python runs them; the face is the same."""
    corners = np.array([(2.5, 11.0), (3.5, 11.0), (3.5, 13.0), (2.5, 13.0), (2.5, 11.0)])
    loop = TrimLoop(tuple(TrimCurve(corners[k : k + 2], np.array([0.0, 0, 5, 5]), 1) for k in range(4)))
    u, v = np.meshgrid([2.0, 4.0], [10.0, 14.0], indexing="ij")
    surface = BSplineSurface(
        np.stack([u, v, u * v], axis=-1), np.array([2.0, 2, 4, 4]), np.array([10.0, 10, 14, 14]), 1, 1,
        outward=False, trims=(loop,), name="saddle",
    )  # fmt: skip
    geomdl_json.write_surfaces(tmp_path / "t.json", [surface])
    part = patch_json.read(tmp_path / "t.json")
    back = part.faces["saddle"].surface
    assert back.domain == ((0.0, 1.0), (0.0, 1.0))
    assert not back.outward
    assert np.array_equal(back.control_points, surface.control_points)
    assert back.trims is not None
    assert back.trims[0].outer
    place = back.trims[0].curves[0].control_points[0]
    assert np.allclose(back.evaluate(*place), surface.evaluate(2.5, 11.0))
    untrimmed = BSplineSurface(surface.control_points, surface.knots_u, surface.knots_v, 1, 1, name="whole")
    geomdl_json.write_surfaces(tmp_path / "w.json", [untrimmed])
    assert patch_json.read(tmp_path / "w.json").faces[0].surface.domain == surface.domain


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"shape": 3}, "the object 'shape' is missing"),
        ({"shape": {"type": "curve", "data": [{}]}}, "'curve', not a surface"),
        ({"shape": {"type": "surface"}}, "the surfaces are missing"),
        ({"shape": {"type": "surface", "data": []}}, "the surfaces are missing"),
        ({"shape": {**sheet()["shape"], "count": 4}}, "1 surfaces, but the count says 4"),
        (sheet(degree_v=None), r"shape.data\[0\]: the key 'degree_v' is missing"),
        (sheet(degree_v="2"), "degree_v is '2'"),
        (sheet(size_u=4), "6 control points for a net of 4 x 3"),
        (sheet(knotvector_v=[0, 0, 1, 1]), "4 knots in v for 3 control points of degree 2"),
        (sheet(knotvector_v=[0, 0, 0, 1, 1, None]), "a list of numbers is needed"),
        (sheet(control_points={}), "the key 'points' is missing"),
        (sheet(control_points=[1]), "an object with 'points' is needed"),
        (sheet(control_points={"points": [[0, 0]] * 6}), "points of 3 numbers"),
        (sheet(control_points={"points": [[0, 0, 0]] * 5 + [[0, 0]]}), "points of 3 numbers"),
        (sheet(control_points={"points": [[0, 0, 0]] * 6, "weights": [1, 2]}), "2 weights for 6 control points"),
        (sheet(trims=[{"type": "analytic"}]), "'analytic' is not known"),
        (sheet(trims=[{"type": "container", "data": []}]), "a trim without curves"),
        (sheet(trims=[ring(0.2, knotvector=[0, 1])]), "2 knots for 9 control points"),
        (sheet(trims=[3]), "an object is needed"),  # type: ignore[list-item]
    ],
)
def test_every_fault_has_its_place(tmp_path: Path, document: object, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        part_of(tmp_path, document)
    assert "g.json" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_another_json_is_neither(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown key 'points'"):
        part_of(tmp_path, {"points": [1, 2, 3]})
