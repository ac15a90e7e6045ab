"""Patch JSON: bit for bit both ways, every fault with its place, areas and neighbours against closed formulas."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadsculpt.errors import CadsculptError, InputError
from cadsculpt.formats import patch_json, step
from cadsculpt.formats.json_text import load
from cadsculpt.formats.rhino import part as rhino
from cadsculpt.spline.refine import insert_knots
from cadsculpt.spline.surface import BSplineSurface, Provenance, TrimCurve, TrimLoop

FLAT = np.array([0.0, 0.0, 1.0, 1.0])


def plane(size: float = 10.0, name: str = "plane", trims: tuple[TrimLoop, ...] | None = None) -> BSplineSurface:
    x, y = np.meshgrid([0.0, size], [0.0, size], indexing="ij")
    return BSplineSurface(np.stack([x, y, 0 * x], axis=-1), FLAT, FLAT, 1, 1, trims=trims, name=name)


def circle(centre: tuple[float, float], radius: float, clockwise: bool = False) -> TrimCurve:
    """A full circle in (u, v), rational of degree 2."""
    corners = np.array([(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0)], dtype=float)
    if clockwise:
        corners = corners[::-1]
    knots = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4], dtype=float)
    weights = np.array([1, math.sqrt(0.5)] * 4 + [1])
    return TrimCurve(np.array(centre) + radius * corners, knots, 2, weights)


def square(low: float, high: float) -> tuple[TrimCurve, ...]:
    corners = np.array([(low, low), (high, low), (high, high), (low, high), (low, low)])
    return tuple(TrimCurve(corners[k : k + 2], FLAT, 1) for k in range(4))


def panel(name: str = "panel") -> BSplineSurface:
    """A square of side 8 with a round hole of radius 2."""
    return plane(10.0, name, (TrimLoop(square(0.1, 0.9)), TrimLoop((circle((0.5, 0.5), 0.2, True),), False)))


def cylinder(radius: float = 3.0, height: float = 7.0, name: str = "tube") -> BSplineSurface:
    curve = circle((0.0, 0.0), radius)
    assert curve.weights is not None
    ring = np.column_stack([curve.control_points, np.zeros(9)])
    net = np.stack([ring, ring + np.array([0.0, 0.0, height])], axis=1)
    weights = np.repeat(curve.weights[:, None], 2, axis=1)
    return BSplineSurface(net, curve.knots, FLAT, 2, 1, weights=weights, name=name)


def cube(size: float = 4.0) -> list[BSplineSurface]:
    """Six planes with outward normals."""
    sides = []
    for axis in range(3):
        for end in (0.0, size):
            u, v = np.meshgrid([0.0, size], [0.0, size], indexing="ij")
            net = np.empty((2, 2, 3))
            net[..., axis] = end
            net[..., (axis + 1) % 3], net[..., (axis + 2) % 3] = (u, v) if end else (v, u)
            sides.append(BSplineSurface(net, FLAT, FLAT, 1, 1, name=f"side {len(sides) + 1}"))
    return sides


def assert_same(a: BSplineSurface, b: BSplineSurface) -> None:
    """Equal bit for bit, trims too."""
    for field in ("control_points", "knots_u", "knots_v", "weights"):
        x, y = getattr(a, field), getattr(b, field)
        assert (x is None) == (y is None)
        assert x is None or np.array_equal(x, y)
    for field in ("degree_u", "degree_v", "periodic_u", "periodic_v", "outward", "name"):
        assert getattr(a, field) == getattr(b, field)
    assert (a.trims is None) == (b.trims is None)
    for loop, other in zip(a.trims or (), b.trims or (), strict=True):
        assert loop.outer == other.outer
        for curve, twin in zip(loop.curves, other.curves, strict=True):
            assert curve.degree == twin.degree
            assert np.array_equal(curve.control_points, twin.control_points)
            assert np.array_equal(curve.knots, twin.knots)
            assert (curve.weights is None) == (twin.weights is None)
            assert curve.weights is None or np.array_equal(curve.weights, twin.weights)  # type: ignore[arg-type]


# --------------------------------------------------------------------- bit for bit

finite = st.floats(-1e9, 1e9, allow_nan=False)


@st.composite
def surfaces(draw: st.DrawFn) -> BSplineSurface:
    shape, degree, knots = [], [], []
    for _ in range(2):
        p = draw(st.integers(1, 4))
        n = p + 1 + draw(st.integers(0, 3))
        inner = sorted(draw(st.lists(st.floats(-3.0, 5.0), min_size=n - p - 1, max_size=n - p - 1, unique=True)))
        low, high = min([*inner, 0.0]) - draw(st.floats(0.1, 4)), max([*inner, 0.0]) + draw(st.floats(0.1, 4))
        shape.append(n)
        degree.append(p)
        knots.append(np.array([low] * (p + 1) + inner + [high] * (p + 1)))
    count = shape[0] * shape[1]
    net = np.array(draw(st.lists(finite, min_size=3 * count, max_size=3 * count))).reshape(*shape, 3)
    weights = None
    if draw(st.booleans()):
        weights = np.array(draw(st.lists(st.floats(1e-3, 1e3), min_size=count, max_size=count))).reshape(*shape)
    trims = panel().trims if draw(st.booleans()) else None
    source = Provenance("part.stp", "face 7", "")
    return BSplineSurface(
        net, knots[0], knots[1], degree[0], degree[1], weights, outward=draw(st.booleans()), trims=trims,
        name=draw(st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), min_size=1)), provenance=source,
    )  # fmt: skip


@given(st.lists(surfaces(), min_size=1, max_size=3, unique_by=lambda s: s.name))
@settings(max_examples=40, deadline=None)
def test_text_brings_the_same_bits_back(made: list[BSplineSurface]) -> None:
    units, back = patch_json.surfaces_of_document(json.loads(patch_json.text_of_surfaces(made, "inch")), "x.json")
    assert units == "in"
    for a, b in zip(made, back, strict=True):
        assert_same(a, b)
        assert b.provenance == Provenance("part.stp", "face 7", "in")


def test_a_part_in_mm_is_the_file_and_back(tmp_path: Path) -> None:
    patch_json.write_surfaces(tmp_path / "a.json", [panel(), cylinder()], "mm")
    part = patch_json.read(tmp_path / "a.json")
    assert (part.format, part.units, [f.name for f in part.faces]) == ("json", "mm", ["panel", "tube"])
    assert_same(part.faces[0].surface, panel())
    part.write(tmp_path / "b.json", "json")
    back = patch_json.read(tmp_path / "b.json")
    for face, made in zip(back.faces, (panel(), cylinder()), strict=True):
        assert_same(face.surface, made)
    back.write(tmp_path / "c.json", "json")
    assert (tmp_path / "c.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_another_unit_is_mm_in_memory_and_itself_in_the_file(tmp_path: Path) -> None:
    """0.1 in has no exact double in mm; what was not sculpted is written with the bits it had."""
    tenth = plane(0.1)
    patch_json.write_surfaces(tmp_path / "inch.json", [tenth, plane(0.3, "other")], "in")
    part = patch_json.read(tmp_path / "inch.json")
    assert part.faces[0].surface.control_points[1, 1, 0] == pytest.approx(2.54, rel=1e-15)
    fine = insert_knots(part.faces[1].surface, [0.5], [0.5])
    net = fine.control_points.copy()
    net[1, 1, 2] = 25.4
    part.sculpt({2: fine.with_control_points(net)})
    part.write(tmp_path / "back.json", "json")
    units, (first, second) = patch_json.surfaces_of_document(load(tmp_path / "back.json"), "back.json")
    assert units == "in"
    assert np.array_equal(first.control_points, tenth.control_points)
    assert second.control_points[1, 1, 2] == pytest.approx(1.0, rel=1e-15)
    same = part.faces[0].surface
    raised = same.control_points.copy()
    raised[0, 0, 2] = 1.0
    part.sculpt({1: same.with_control_points(raised)})
    part.write(tmp_path / "again.json", "json")
    first = patch_json.surfaces_of_document(load(tmp_path / "again.json"), "again.json")[1][0]
    assert np.array_equal(first.control_points[..., :2], tenth.control_points[..., :2])
    assert first.control_points[0, 0, 2] == pytest.approx(1 / 25.4)


def test_a_periodic_surface_stays_periodic(tmp_path: Path) -> None:
    angle = np.arange(9) * (2 * np.pi / 6)
    net = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)[:, None] + np.array([[0, 0, 0], [0, 0, 1.0]])
    net[6:] = net[:3]
    tube = BSplineSurface(net, np.arange(13.0), FLAT, 3, 1, periodic_u=True, name="tube")
    patch_json.write_surfaces(tmp_path / "p.json", [tube], "mm")
    back = patch_json.read(tmp_path / "p.json").faces[0].surface
    assert back.periodic_u
    assert back.closed_u
    assert_same(back, tube)
    net = net.copy()
    net[8, 0, 0] += 0.1
    with pytest.raises(CadsculptError, match="periodic"):
        patch_json.surfaces_of_document(
            json.loads(patch_json.text_of_surfaces([tube.with_control_points(net)], "mm")), "p.json"
        )


def test_names_are_given_and_made_unique(tmp_path: Path) -> None:
    made = [plane(name=""), plane(name="a"), plane(name="a")]
    patch_json.write_surfaces(tmp_path / "n.json", made, "mm")
    assert [face.name for face in patch_json.read(tmp_path / "n.json").faces] == ["surface 1", "a", "a (2)"]


# ------------------------------------------------------------------------ measures


def test_measures_of_a_panel_with_a_hole(tmp_path: Path) -> None:
    patch_json.write_surfaces(tmp_path / "m.json", [panel(), cylinder()], "cm")
    flat, tube = patch_json.read(tmp_path / "m.json").faces
    assert flat.trimmed
    assert not tube.trimmed
    assert flat.area == pytest.approx(100 * (64 - math.pi * 4), rel=1e-9)
    assert tube.area == pytest.approx(100 * 2 * math.pi * 3 * 7, rel=1e-9)
    assert flat.bbox == pytest.approx((10, 10, 0, 90, 90, 0), abs=1e-3)
    assert tube.bbox == pytest.approx((-30, -30, 0, 30, 30, 70), abs=1e-3)


def test_a_cubes_sides_know_each_other(tmp_path: Path) -> None:
    patch_json.write_surfaces(tmp_path / "cube.json", cube(), "mm")
    part = patch_json.read(tmp_path / "cube.json")
    for face in part.faces:
        opposite = face.number + 1 if face.number % 2 else face.number - 1
        found = [edge.neighbours for edge in face.edges]
        assert all(len(n) == 1 for n in found)
        assert {n for edge in found for n in edge} == set(range(1, 7)) - {face.number, opposite}
    assert part.validity().valid


def test_seams_and_poles_are_told(tmp_path: Path) -> None:
    tube = cylinder()
    net = tube.control_points.copy()
    net[:, 1, :2] = 0.0
    cone = replace(tube.with_control_points(net), name="cone")
    patch_json.write_surfaces(tmp_path / "s.json", [tube, cone], "mm")
    part = patch_json.read(tmp_path / "s.json")
    assert [edge.seam for edge in part.faces["tube"].edges] == [False, True, False, True]
    assert [edge.degenerate for edge in part.faces["cone"].edges] == [False, False, True, False]
    assert part.faces["tube"].edges[0].neighbours == (2,)  # both stand on the same circle
    assert part.faces["tube"].edges[2].neighbours == ()
    for face in part.faces:
        for edge in face.edges:
            assert np.array_equal(face.surface.evaluate(edge.uv[:, 0], edge.uv[:, 1]), edge.points)


@pytest.mark.parametrize("format", ["step", "3dm"])
def test_other_formats_hold_the_same_nets(tmp_path: Path, format: str) -> None:
    patch_json.write_surfaces(tmp_path / "x.json", [panel(), *cube()], "mm")
    part = patch_json.read(tmp_path / "x.json")
    path = tmp_path / f"x.{format}"
    part.write(path, format)
    back = step.read(path) if format == "step" else rhino.read(path)
    assert not part.warnings
    assert back.validity().valid
    for face in part.faces:
        other = back.faces.named(face.name)
        assert np.abs(other.surface.control_points - face.surface.control_points).max() <= 1e-9
        assert other.area == pytest.approx(face.area)
        assert other.trimmed == face.trimmed


def test_sculpting_follows_the_rules(tmp_path: Path) -> None:
    patch_json.write_surfaces(tmp_path / "r.json", [panel()], "mm")
    part = patch_json.read(tmp_path / "r.json")
    with pytest.raises(InputError, match="no face number 2"):
        part.sculpt({2: panel()})
    with pytest.raises(CadsculptError, match="other degrees"):
        part.sculpt({1: cylinder()})
    fine = insert_knots(panel(), [0.5], [0.5])
    net = fine.control_points.copy()
    net[1, 1, 2] = -1.0
    part.sculpt({1: replace(fine.with_control_points(net), trims=None, name="wrong")})
    assert part.faces[0].surface.trims is not None
    assert part.faces[0].surface.name == "panel"
    assert part.validity().valid


# ---------------------------------------------------------------------- bad input


def document(**changes: Any) -> dict[str, Any]:
    """A good document with some keys of its first surface changed; None takes a key away."""
    made: dict[str, Any] = json.loads(patch_json.text_of_surfaces([panel(), cylinder()], "mm"))
    for key, value in changes.items():
        target = made if key in ("format", "version", "units", "surfaces") else made["surfaces"][0]
        if value is None:
            del target[key]
        else:
            target[key] = value
    return made


def trim(**changes: Any) -> list[dict[str, Any]]:
    curve = {"degree": 1, "knots": [0, 0, 1, 1], "control_points": [[0, 0], [1, 0]], **changes}
    return [{"outer": True, "curves": [{k: v for k, v in curve.items() if v is not None}]}]


FAULTS = [
    (document(format=None), "the key 'format' is missing"),
    (document(format="other"), "'other', not 'cadsculpt-patches'"),
    (document(version=2), "version 2 is not known"),
    (document(units=None), "the key 'units' is missing"),
    (document(units="furlong"), "unknown length unit 'furlong'"),
    (document(units=3), "the unit is 3"),
    (document(surfaces=[]), "there are no surfaces"),
    (document(surfaces={}), "surfaces: a list is needed, not an object"),
    (document(surfaces=[7]), r"surfaces\[0\]: an object is needed, not 7"),
    (document(degree_u=None), r"surfaces\[0\]: the key 'degree_u' is missing"),
    (document(degree_u=1.5), r"surfaces\[0\].degree_u: a whole number"),
    (document(degree_u=True), "a whole number"),
    (document(degree_u=0), "degree 0 in u"),
    (document(knots_u=[0, 0, 1]), "3 knots in u for 2 control points of degree 1"),
    (document(knots_u=[0, 1, 0, 1]), "not finite and non-decreasing"),
    (document(knots_v=[0, 0, 0, 0]), "the parameter range in v is empty"),
    (document(knots_v="0 0 1 1"), r"surfaces\[0\].knots_v: a list of numbers is needed"),
    (document(knots_v=["0", "0", "1", "1"]), "a list of numbers is needed"),
    (document(control_points=[[[0, 0, 0]], [[1, 0, 0], [1, 1, 0]]]), "every row as long as the others"),
    (document(control_points=[[[0, 0], [0, 1]], [[1, 0], [1, 1]]]), "a list of lists of points of 3 numbers"),
    (document(control_points=[[[0, 0, 0], [0, 1, None]], [[1, 0, 0], [1, 1, 0]]]), "points of 3 numbers"),
    (document(control_points=[[[0, 0, 0], [0, 1, 10**400]], [[1, 0, 0], [1, 1, 0]]]), "points of 3 numbers"),
    (document(control_points=[]), "points of 3 numbers"),
    (document(weights=[[1, 1], [1, 0]]), "a weight is not positive"),
    (document(weights=[[1, 1, 1], [1, 1, 1]]), r"weights of shape \(2, 3\)"),
    (document(outward="yes"), "true or false is needed, not the text 'yes'"),
    (document(periodic_u=True), "periodic"),
    (document(name=""), "the name is empty"),
    (document(name="tube"), r"surfaces\[1\].name: the name 'tube' is taken by surfaces\[0\]"),
    (document(weigths=[]), r"unknown key 'weigths' \(did you mean 'weights'\?\)"),
    (document(trims=[]), "there are no trim loops"),
    (document(trims=[{"outer": True, "curves": []}]), "a trim loop without curves"),
    (document(trims=[{"curves": []}]), r"trims\[0\]"),
    (document(trims=trim(knots=[0, 1])), r"trims\[0\].curves\[0\].knots: 2 knots for 2 control points"),
    (document(trims=trim(knots=[0, 0, 0, 0])), "span nothing"),
    (document(trims=trim(degree=0)), "degree 0"),
    (document(trims=trim(weights=[1])), "2 positive weights are needed"),
    (document(trims=trim(control_points=[[0, 0, 0], [1, 0, 0]])), "a list of points of 2 numbers"),
    (document(trims=trim(degree=None)), "the key 'degree' is missing"),
    ([1, 2], "an object is needed, not a list"),
    ("patches", "an object is needed, not the text 'patches'"),
]


@pytest.mark.parametrize(("content", "words"), FAULTS)
def test_every_fault_is_one_line_with_its_place(tmp_path: Path, content: object, words: str) -> None:
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=words) as caught:
        patch_json.read(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "the file is empty"),
        (b" \n ", "the file is empty"),
        (b'{"format": "cadsculpt-patches",\n "version": }', "line 2, column 13: no JSON"),
        (b'{"version": NaN}', "NaN is not finite"),
        (b'{"version": -Infinity}', "-Infinity is not finite"),
        (b'{"a": 1, "a": 2}', "'a' stands twice"),
        (b"\xff\xfe{}", "byte 1 is no UTF-8"),
        (b"ISO-10303-21;", "line 1, column 1: no JSON"),
        (b"[" * 100000, "nested too deeply"),
        (b'{"version": 1' + b"0" * 5000 + b"}", "digits|version"),
    ],
)
def test_no_json(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        patch_json.read(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_cut_short_at_every_tenth(tmp_path: Path) -> None:
    text = patch_json.text_of_surfaces([panel(), cylinder()], "mm")
    for tenth in range(10):
        (tmp_path / "cut.json").write_text(text[: len(text) * tenth // 10])
        with pytest.raises(InputError):
            patch_json.read(tmp_path / "cut.json")
    with pytest.raises(InputError, match=r"none\.json"):
        patch_json.read(tmp_path / "none.json")


def test_nothing_half_written(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        patch_json.write_surfaces(tmp_path / "no" / "such" / "folder.json", [plane()], "mm")
    bad = plane().with_control_points(np.full((2, 2, 3), np.nan))
    with pytest.raises(CadsculptError):
        patch_json.write_surfaces(tmp_path / "nan.json", [bad], "mm")
    assert list(tmp_path.iterdir()) == []


# ------------------------------------------------------------------------- schema


def fits(value: Any, schema: dict[str, Any]) -> bool:
    """Whether a value fits a JSON Schema of the few words that ours uses."""
    known = {"title", "default", "description"}
    checks = {
        "const": lambda x: value == x,
        "enum": lambda x: value in x,
        "anyOf": lambda x: any(fits(value, s) for s in x),
        "type": lambda x: (
            isinstance(
                value,
                {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None)}.get(x, int | float),
            )
            and not (x in ("number", "integer") and isinstance(value, bool))
            and not (x == "integer" and not isinstance(value, int))
        ),
        "required": lambda x: not isinstance(value, dict) or all(k in value for k in x),
        "properties": lambda x: (
            not isinstance(value, dict) or all(fits(value[k], s) for k, s in x.items() if k in value)
        ),
        "additionalProperties": lambda x: not isinstance(value, dict) or x or set(value) <= set(schema["properties"]),
        "items": lambda x: not isinstance(value, list) or all(fits(v, x) for v in value),
        "minItems": lambda x: not isinstance(value, list) or len(value) >= x,
        "maxItems": lambda x: not isinstance(value, list) or len(value) <= x,
        "minLength": lambda x: not isinstance(value, str) or len(value) >= x,
        "minimum": lambda x: value >= x,
        "exclusiveMinimum": lambda x: value > x,
    }
    ordered = sorted(schema, key=lambda word: word != "type")
    return all(word in known or bool(checks[word](schema[word])) for word in ordered)


def test_the_schema_takes_what_is_written() -> None:
    schema = patch_json.schema()
    assert fits(document(), schema)
    assert fits(json.loads(patch_json.text_of_surfaces(cube(), "ft")), schema)


@pytest.mark.parametrize(
    "bad",
    [
        document(units=None), document(units="furlong"), document(version=2), document(degree_u=0),
        document(degree_u=1.5), document(weigths=[]), document(control_points=[[[0, 0], [0, 1]], [[1, 0], [1, 1]]]),
        document(trims=trim(degree=None)), document(trims=[{"outer": True, "curves": []}]), document(surfaces=[]),
        document(weights=[[1, 1], [1, 0]]), document(name=""), document(outward="yes"),
    ],
)  # fmt: skip
def test_the_schema_finds_what_the_reader_finds(bad: dict[str, Any]) -> None:
    assert not fits(bad, patch_json.schema())
    with pytest.raises(CadsculptError):
        patch_json.surfaces_of_document(bad, "bad.json")
