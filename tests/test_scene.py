"""The scene's language: what is taken, what is refused, and that every fault is told at once and in plain words."""

from __future__ import annotations

import copy
import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from cadsculpt.physics.material import PRESETS
from cadsculpt.scene import Scene, SolverSpec


def good() -> dict[str, Any]:
    return {
        "schema": 1,
        "name": "thumb press",
        "units": "mm",
        "model": [{"name": "panel", "file": "panel.step", "thickness": 3.0, "nodes": 1.5, "material": "clay"}],
        "tool": [
            {
                "name": "thumb",
                "shape": "ellipsoid",
                "radii": [8, 8, 14],
                "path": [{"t": 0, "at": [0, 0, 20]}, {"t": 1.0, "at": [0, 0, -4], "turn": [1, 0, 0, 15]}],
            }
        ],
    }


def faults_of(data: Any) -> list[tuple[tuple[str | int, ...], str]]:
    try:
        Scene.model_validate(data)
    except ValidationError as error:
        return [(detail["loc"], detail["msg"]) for detail in error.errors()]
    return []


def changed(place: tuple[str | int, ...], value: Any) -> dict[str, Any]:
    """The good scene with one value put, or taken away with `...`."""
    data = copy.deepcopy(good())
    at: Any = data
    for key, following in pairwise(place):
        if isinstance(at, dict) and key not in at:
            at[key] = [{}] if isinstance(following, int) else {}
        at = at[key]
    if value is ...:
        del at[place[-1]]
    else:
        at[place[-1]] = value
    return data


def test_the_smallest_scene_has_sensible_numbers() -> None:
    scene = Scene.model_validate(good())
    assert scene.solver.step == "auto"
    assert scene.solver.mode == "certified"
    assert scene.model[0].faces == "all"
    assert scene.model[0].anchor == "base"
    assert scene.model[0].edges == "held"
    assert scene.output.cad == ("step", "json")
    assert scene.tool[0].radii == (8.0, 8.0, 14.0)


@given(st.floats(1e-6, 1e6))
def test_lengths_left_out_follow_the_thickness_and_so_do_not_depend_on_the_unit(thickness: float) -> None:
    scene = Scene.model_validate(changed(("model", 0, "thickness"), thickness))
    assert scene.solver.tolerance == pytest.approx(thickness / 300)
    assert scene.solver.max_penetration == pytest.approx(thickness / 60)
    assert scene.refit.tolerance == pytest.approx(thickness / 150)
    written = Scene.model_validate({**good(), "solver": {"tolerance": 0.5}, "refit": {"tolerance": 0.25}})
    assert (written.solver.tolerance, written.refit.tolerance) == (0.5, 0.25)


BAD: list[tuple[tuple[str | int, ...], Any, tuple[str | int, ...], str]] = [
    # what is put where; the place of the fault; words of its sentence
    (("units",), ..., ("units",), "units is missing"),
    (("units",), "mmm", ("units",), 'units "mmm" is not known (use one of um, mm, cm,'),
    (("units",), 3, ("units",), "units must be the name of a length unit"),
    (("schema",), 2, ("schema",), "schema must be 1"),
    (("schema",), True, ("schema",), "schema must be 1"),
    (("solvr",), {}, ("solvr",), "unknown key solvr (did you mean solver?)"),
    (("model",), ..., ("model",), "model is missing (a scene has at least one [[model]])"),
    (("tool",), [], ("tool",), "tool is empty"),
    (("tool",), {"name": "x"}, ("tool",), "(write [[tool]] with two brackets)"),
    (("solver",), 5, ("solver",), "solver must be a table, not 5"),
    (("model", 0, "thicknes"), 3, ("model", 0, "thicknes"), "unknown key thicknes (did you mean thickness?)"),
    (("model", 0, "thickness"), ..., ("model", 0, "thickness"), "thickness is missing (how deep"),
    (("model", 0, "thickness"), -3.0, ("model", 0, "thickness"), "thickness must be above 0, not -3.0"),
    (("model", 0, "thickness"), 0, ("model", 0, "thickness"), "thickness must be above 0, not 0"),
    (("model", 0, "thickness"), math.nan, ("model", 0, "thickness"), "thickness must be a finite number, not nan"),
    (("model", 0, "thickness"), math.inf, ("model", 0, "thickness"), "thickness must be a finite number, not inf"),
    (("model", 0, "thickness"), "3", ("model", 0, "thickness"), 'thickness must be a number, not "3"'),
    (("model", 0, "thickness"), True, ("model", 0, "thickness"), "thickness must be a number, not true"),
    (("model", 0, "layers"), 2.0, ("model", 0, "layers"), "layers must be a whole number, not 2.0"),
    (("model", 0, "layers"), 0, ("model", 0, "layers"), "layers must be at least 1, not 0"),
    (("model", 0, "name"), "", ("model", 0, "name"), "name must not be empty"),
    (("model", 0, "name"), "a\nb", ("model", 0, "name"), "name must be one line"),
    (("model", 0, "name"), "thumb", ("tool", 0, "name"), 'name "thumb" is taken'),
    (("model", 0, "faces"), "top", ("model", 0, "faces"), '(use all, or a list: ["top"])'),
    (("model", 0, "faces"), [], ("model", 0, "faces"), "faces is empty"),
    (
        ("model", 0, "faces"),
        ["top", 1.5],
        ("model", 0, "faces", 1),
        "number 2 of faces must be a whole number, not 1.5",
    ),
    (("model", 0, "faces"), ["top", True], ("model", 0, "faces", 1), "a face's name or number, not true"),
    (("model", 0, "faces"), 3, ("model", 0, "faces"), 'faces must be "all" or a list of face names and numbers, not 3'),
    (("model", 0, "nodes"), [10, 1], ("model", 0, "nodes", 1), "number 2 of nodes must be at least 2, not 1"),
    (("model", 0, "nodes"), [10], ("model", 0, "nodes"), "nodes must be a list of 2 whole numbers, not a list of 1"),
    (
        ("model", 0, "anchor"),
        "rim",
        ("model", 0, "anchor"),
        'anchor "rim" is not known (use base, edges, none, or a list',
    ),
    (("model", 0, "anchor"), [{"face": "a", "u": [1, 0]}], ("model", 0, "anchor", 0, "u"), "u must be [low, high]"),
    (("model", 0, "anchor"), [{"fac": "a"}], ("model", 0, "anchor", 0, "fac"), "unknown key fac (did you mean face?)"),
    (("model", 0, "zones"), [{"material": "foam"}], ("model", 0, "zones", 0), "covers everything"),
    (
        ("model", 0, "zones"),
        [{"material": "fom", "u": [0, 1]}],
        ("model", 0, "zones", 0, "material"),
        'material "fom" is not known (did you mean foam?)',
    ),
    (("model", 0, "material"), "clai", ("model", 0, "material"), 'material "clai" is not known (did you mean clay?)'),
    (("model", 0, "outward"), 1, ("model", 0, "outward"), "outward must be true or false, not 1"),
    (("material",), {"x": {"density": 3}}, ("material", "x", "youngs_modulus"), "youngs_modulus is missing (Pa)"),
    (("material",), {"x": {"preset": "cley"}}, ("material", "x", "preset"), 'preset "cley" is not known'),
    (
        ("material",),
        {"clay": {"preset": "clay", "density": -1}},
        ("material", "clay", "density"),
        "density must be above 0, not -1",
    ),
    (("material",), {"x": {"preset": "clay", "yield_strain": "no"}}, ("material", "x", "yield_strain"), "yield_strain"),
    (("tool", 0, "shape"), ..., ("tool", 0, "shape"), "shape is missing"),
    (("tool", 0, "shape"), "elipsoid", ("tool", 0, "shape"), "is not known (did you mean ellipsoid?)"),
    (("tool", 0, "shape"), 3, ("tool", 0, "shape"), "shape must be point or sphere"),
    (("tool", 0, "radii"), ..., ("tool", 0, "radii"), "radii is missing (an ellipsoid needs radii)"),
    (("tool", 0, "radii"), [8, 8], ("tool", 0, "radii"), "radii must be a list of 3 numbers, not a list of 2"),
    (("tool", 0, "radii"), [8, -8, 3], ("tool", 0, "radii", 1), "number 2 of radii must be above 0, not -8"),
    (("tool", 0, "radius"), 3, ("tool", 0, "radius"), "radius is no key of an ellipsoid, which has radii"),
    (("tool", 0, "path"), [], ("tool", 0, "path"), "path is empty"),
    (("tool", 0, "path"), 7, ("tool", 0, "path"), "path must be rows [[tool.path]] or the name of a file, not 7"),
    (("tool", 0, "path", 1, "t"), 0, ("tool", 0, "path", 1, "t"), "t does not move on in time: 0 after 0"),
    (("tool", 0, "path", 0, "t"), 2.5, ("tool", 0, "path", 1, "t"), "t goes back in time: 1.0 after 2.5"),
    (("tool", 0, "path", 1, "t"), -1, ("tool", 0, "path", 1, "t"), "t must be at least 0, not -1"),
    (
        ("tool", 0, "path", 0, "at"),
        [0, math.nan, 0],
        ("tool", 0, "path", 0, "at", 1),
        "number 2 of at must be a finite",
    ),
    (("tool", 0, "path", 1, "turn"), [0, 0, 0, 9], ("tool", 0, "path", 1, "turn"), "turn has no axis"),
    (("tool", 0, "force"), 5, ("tool", 0, "force"), 'force needs control = "force"'),
    (("tool", 0, "control"), "force", ("tool", 0, "control"), "force is missing"),
    (("tool", 0, "direction"), [0, 0, -1], ("tool", 0, "direction"), 'direction needs control = "force"'),
    (
        ("solver",),
        {"tolerance": 0.1, "max_penetration": 0.01},
        ("solver", "max_penetration"),
        "max_penetration 0.01 cannot be seen with tolerance 0.1",
    ),
    (("solver", "step"), "quick", ("solver", "step"), 'step "quick" is not known (use one of auto)'),
    (("solver", "step"), 0, ("solver", "step"), "step must be above 0, not 0"),
    (("solver", "resolution"), 1, ("solver", "resolution"), "resolution must be at least 2, not 1"),
    (("solver",), {"step": 1e-3, "substep": 1e-2}, ("solver", "substep"), "substep must be at most step 0.001"),
    (("refit", "refine"), "yes", ("refit", "refine"), 'refine must be true or false, not "yes"'),
    (
        ("output", "cad"),
        ["step", "stp"],
        ("output", "cad", 1),
        'number 2 of cad "stp" is not known (did you mean step?)',
    ),
    (("output", "cad"), ["step", "step"], ("output", "cad", 1), 'cad names "step" twice'),
    (("expect", 0), {"what": "max_depth"}, ("expect", 0), "needs exactly one of between, at_most, at_least, equals or"),
    (("expect", 0), {"what": "max_depth", "at_most": 1, "at_least": 0}, ("expect", 0, "at_least"), "needs exactly one"),
    (("expect", 0), {"what": "max_dept", "at_most": 1}, ("expect", 0, "what"), "(did you mean max_depth?)"),
    (("expect", 0), {"what": "max_depth", "equals": 1}, ("expect", 0, "equals"), "tolerance is missing"),
    (("expect", 0), {"what": "max_depth", "equals": "deep"}, ("expect", 0, "equals"), "equals must be a number"),
    (("expect", 0), {"what": "max_depth", "between": [2, 1]}, ("expect", 0, "between"), "between must be [low, high]"),
    (("expect", 0), {"what": "max_depth", "never": "contact"}, ("expect", 0, "never"), "never is for"),
    (("expect", 0), {"what": "verdict", "at_most": 1}, ("expect", 0, "at_most"), "a verdict takes equals or never"),
    (("expect", 0), {"what": "verdict", "equals": "touch"}, ("expect", 0, "equals"), "(did you mean touching?)"),
    (
        ("expect", 0),
        {"what": "max_depth", "at_most": 1, "tolerance": 1},
        ("expect", 0, "tolerance"),
        "tolerance goes with equals",
    ),
    (
        ("expect", 0),
        {"what": "max_depth", "at_most": 1, "pair": ["thumb", "panl"]},
        ("expect", 0, "pair", 1),
        'pair names "panl", no body (did you mean panel?)',
    ),
    (
        ("expect", 0),
        {"what": "max_depth", "at_most": 1, "pair": ["thumb", "thumb"]},
        ("expect", 0, "pair"),
        "pair names one body twice",
    ),
]

each_bad = pytest.mark.parametrize(("place", "value", "where", "words"), BAD)


@each_bad
def test_one_fault_is_told_once_at_its_place(
    place: tuple[str | int, ...], value: Any, where: tuple[str | int, ...], words: str
) -> None:
    faults = faults_of(changed(place, value))
    assert len(faults) == 1, faults
    assert faults[0][0] == where
    assert words in faults[0][1]


def test_a_misspelt_key_is_not_missing_too() -> None:
    data = good()
    data["modl"] = data.pop("model")
    data["tool"][0]["radi"] = data["tool"][0].pop("radii")
    assert [words for _, words in faults_of(data)] == [
        "unknown key radi (did you mean radii?)",
        "unknown key modl (did you mean model?)",
    ]


TOOLS: list[dict[str, Any]] = [
    {"shape": "point"},
    {"shape": "point", "area": 0.5},
    {"shape": "sphere", "radius": 3},
    {"shape": "ellipsoid", "radii": [1, 2, 3]},
    {"shape": "capsule", "radius": 1, "length": 5},
    {"shape": "cylinder", "radius": 1, "height": 5, "rounding": 1},
    {"shape": "cone", "radius": 1, "height": 5},
    {"shape": "box", "size": [1, 2, 3], "rounding": 0.5},
    {"shape": "torus", "major_radius": 3, "minor_radius": 1},
    {"shape": "superquadric", "radii": [1, 2, 3], "exponents": [0.5, 1]},
    {"shape": "half_space"},
    {"shape": "formula", "expression": "x*x + y*y + z*z - 9", "box": [[-3, -3, -3], [3, 3, 3]]},
    {"shape": "union", "part": [{"shape": "sphere", "radius": 1}, {"shape": "cone", "radius": 1, "height": 2}]},
    {"shape": "surface", "file": "finger.step", "faces": [1, "tip"], "file_units": "in"},
    {"shape": "surface", "file": "finger.step", "material": "rubber", "thickness": 3, "nodes": 1, "hold": "base"},
    {"shape": "mesh", "file": "bone.stl", "file_units": "inch"},
]


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: str(tool["shape"]))
def test_every_shape_has_its_sizes_and_no_others(tool: dict[str, Any]) -> None:
    scene = Scene.model_validate({**good(), "tool": [{"name": "tool", **tool}]})
    assert scene.tool[0].shape == tool["shape"]
    others = {key: value for other in TOOLS for key, value in other.items() if key != "shape"}
    for key in set(others) - {key for same in TOOLS if same["shape"] == tool["shape"] for key in same}:
        (fault,) = faults_of({**good(), "tool": [{"name": "tool", **tool, key: others[key]}]})
        assert fault[0] == ("tool", 0, key)
        assert f"{key} is no key of a" in fault[1]


@pytest.mark.parametrize(
    ("tool", "key", "words"),
    [
        ({"shape": "box", "size": [1, 2, 3], "rounding": 0.6}, "rounding", "at most 0.5 for these sizes, not 0.6"),
        ({"shape": "cylinder", "radius": 2, "height": 2, "rounding": 1.5}, "rounding", "at most 1.0 for these sizes"),
        ({"shape": "torus", "major_radius": 1, "minor_radius": 2}, "minor_radius", "below major_radius 1, not 2"),
        ({"shape": "formula", "expression": "x", "box": [[0, 0, 0], [1, 0, 1]]}, "box", "lower corner first"),
        ({"shape": "surface", "file": "a.step", "hold": "base"}, "hold", "belongs to a deformable tool"),
        ({"shape": "difference", "part": [{"shape": "sphere", "radius": 1}]}, "part", "a difference of one part"),
        ({"shape": "intersection"}, "part", "part is missing (an intersection needs part)"),
    ],
)
def test_sizes_that_do_not_go_together(tool: dict[str, Any], key: str, words: str) -> None:
    (fault,) = faults_of({**good(), "tool": [{"name": "tool", **tool}]})
    assert fault[0] == ("tool", 0, key)
    assert words in fault[1]


BOX = [[-1, -1, -1], [1, 1, 1]]


@pytest.mark.parametrize(
    ("expression", "words"),
    [
        ("sqr(x) - 1", "unknown function sqr at column 1 (did you mean sqrt?)"),
        ("x + q", "unknown name q at column 5"),
        ("1/x", "is not a number everywhere in its box: division by zero near (0, 0, 0)"),
        ("x +", "invalid syntax"),
    ],
)
def test_a_faulty_formula_is_told_where_it_stands_even_in_a_part_of_a_part(expression: str, words: str) -> None:
    formula = {"shape": "formula", "expression": expression, "box": BOX}
    (fault,) = faults_of({**good(), "tool": [{"name": "tool", **formula}]})
    assert fault[0] == ("tool", 0, "expression")
    assert words in fault[1]
    ball = {"shape": "sphere", "radius": 1}
    nested = {"shape": "union", "part": [ball, {"shape": "intersection", "part": [formula, ball]}]}
    (fault,) = faults_of({**good(), "tool": [{"name": "tool", **nested}]})
    assert fault[0] == ("tool", 0, "part", 1, "part", 0, "expression")
    assert words in fault[1]


def test_every_fault_of_every_part_is_told_once() -> None:
    parts = [{"shape": "sphere"}, {"shape": "boxx", "at": [1, 2]}, {"shape": "superquadric", "radii": [1, 1, 1]}]
    parts[2]["exponents"] = [3, 0.05]
    faults = faults_of({**good(), "tool": [{"name": "tool", "shape": "union", "part": parts}]})
    assert [place[2:] for place, _ in faults] == [
        ("part", 0, "radius"), ("part", 1, "shape"), ("part", 1, "at"), ("part", 2, "exponents", 0),
        ("part", 2, "exponents", 1),
    ]  # fmt: skip
    assert "did you mean box?" in faults[1][1]


@each_bad
def test_faults_of_other_tables_are_told_beside_it(
    place: tuple[str | int, ...], value: Any, where: tuple[str | int, ...], words: str
) -> None:
    others = {"solver": {"step": 0}, "refit": {"refine": 1}, "output": {"pictures": 0}, "expect": [{"what": "verdict"}]}
    others.pop(str(place[0]), None)
    if place[0] == "tool":
        others["model"] = [{**good()["model"][0], "layers": 0}]
    faults = faults_of({**changed(place, value), **others})
    assert len(faults) == 1 + len(others), faults
    assert any(at == where and words in told for at, told in faults)


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.dates(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)
PLACES = [place for place, *_ in BAD if len(place) > 1 and place[0] not in ("expect",)]


@settings(max_examples=300)
@given(st.sampled_from(PLACES), anything)
def test_whatever_stands_there_no_fault_speaks_pydantic(place: tuple[str | int, ...], value: Any) -> None:
    for where, words in faults_of(changed(place, value)):
        assert "Input should" not in words
        assert words.isprintable()
        assert where[: min(len(where), 2)] == place[: min(len(where), 2)] or where[0] in ("expect", "tool", "model")


@given(anything)
def test_what_is_no_scene_is_refused(value: Any) -> None:
    with pytest.raises(ValidationError):
        Scene.model_validate(value)


def test_presets_are_the_physics_own() -> None:
    scene = Scene.model_validate(good())
    for name, material in PRESETS.items():
        assert scene.material_of(name) is material
    with pytest.raises(KeyError):
        scene.material_of("cheese")


def test_a_material_stands_upon_its_preset() -> None:
    tables = {
        "soft": {"preset": "clay", "youngs_modulus": 1e5},
        "spring": {"preset": "sheet steel", "yield_strain": "none"},
        "jelly": {"youngs_modulus": 1e4, "density": 1000, "hardening": 1},
    }
    scene = Scene.model_validate({**good(), "material": tables})
    soft = scene.material_of("soft")
    assert (soft.youngs_modulus, soft.density, soft.name) == (1e5, PRESETS["clay"].density, "soft")
    assert scene.material_of("spring").yield_strain == math.inf
    assert scene.material_of("jelly").yield_strain == math.inf
    assert scene.material_of("jelly").hardening == 1.0


def test_a_scene_does_not_change_and_is_equal_to_its_like() -> None:
    scene = Scene.model_validate(good())
    assert scene == Scene.model_validate(good())
    assert scene != Scene.model_validate(changed(("name",), "other"))
    with pytest.raises(ValidationError):
        scene.name = "other"
    assert scene != "thumb press"


def test_checked_parts_and_numpy_numbers_make_a_scene_too() -> None:
    scene = Scene.model_validate(good())
    again = Scene.model_validate({**good(), "model": scene.model, "tool": list(scene.tool), "solver": scene.solver})
    assert again == scene
    assert Scene.model_validate(changed(("model", 0, "thickness"), np.float64(3.0))) == scene
    with pytest.raises(ValidationError, match="is taken"):
        Scene.model_validate({**good(), "model": scene.model, "tool": [*scene.tool, *scene.tool]})
    assert SolverSpec.model_validate({"step": 0.5}).step == 0.5


def test_units_have_one_name() -> None:
    for written, name in (("inch", "in"), ("MM", "mm"), ("metre", "m")):
        assert Scene.model_validate(changed(("units",), written)).units == name


def test_lengths_left_out_go_with_those_given():
    """What may be left of an overlap is never less than what is seen of one."""
    for solver in ({"tolerance": 3.0}, {"max_penetration": 1e-4}, {}):
        given = good() | {"solver": solver}
        read = Scene.model_validate(given).solver
        assert 0 < read.tolerance <= read.max_penetration
        Scene.model_validate(given | {"solver": {"tolerance": read.tolerance, "max_penetration": read.max_penetration}})
