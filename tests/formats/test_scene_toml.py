"""scene.toml: what is written reads back equal, every place has its line, and all faults are told at once."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cadsculpt.errors import SceneError
from cadsculpt.formats import schema, toml_file, tool_toml
from cadsculpt.formats.scene_toml import SceneFile, dump
from cadsculpt.scene import PathRow, Scene
from cadsculpt.units import METRES_PER_UNIT

GOOD = """\
schema = 1
name = "thumb press"
units = "mm"

[[model]]
name = "panel"
file = "panel.step"
faces = ["top"]
thickness = 3.0
nodes = 1.5
material = "clay"

[material.clay]
preset = "clay"
friction = 0.5

[[tool]]
name = "thumb"
shape = "ellipsoid"
radii = [8, 8, 14]
[[tool.path]]
t = 0.0
at = [0, 0, 20]
[[tool.path]]
t = 1.0
at = [0, 0, -4]
turn = [1, 0, 0, 15]

[solver]
step = 1e-3

[[expect]]
what = "first_contact"
pair = ["thumb", "panel"]
between = [0.70, 0.75]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "panel.step").touch()
    return tmp_path


def load(folder: Path, text: str) -> SceneFile:
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    return SceneFile.load(folder / "scene.toml")


def faults(folder: Path, text: str) -> list[str]:
    """The faults without the folder in front of their files."""
    with pytest.raises(SceneError) as caught:
        load(folder, text)
    assert "\n".join(caught.value.faults) == str(caught.value)
    return [fault.removeprefix(f"{folder}/") for fault in caught.value.faults]


def test_the_contracts_scene(folder: Path) -> None:
    scene = load(folder, GOOD)
    assert scene.name == "thumb press"
    assert scene.model[0].faces == ("top",)
    assert scene.material_of("clay").friction == 0.5
    assert scene.tool[0].radii == (8.0, 8.0, 14.0)
    assert scene.path == folder / "scene.toml"
    assert scene.sources() == [folder / "panel.step"]
    path = scene.tool_path("thumb")
    assert path is not None
    np.testing.assert_array_equal(path.pose(0.5).at, [0, 0, 8])
    with pytest.raises(KeyError):
        scene.tool_path("finger")


def test_files_are_found_from_anywhere_and_named_as_the_user_named_them(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "scene.toml").write_text(GOOD)
    monkeypatch.chdir(folder.parent)
    scene = SceneFile.load(f"{folder.name}/scene.toml")
    monkeypatch.chdir("/")
    assert scene.folder == folder
    assert scene.sources() == [folder / "panel.step"]
    assert scene.where("units") == f"{folder.name}/scene.toml:3"


def test_reading_a_scene_loads_nothing_heavy() -> None:
    code = (
        "import sys, cadsculpt.formats.scene_toml, cadsculpt.formats.schema as s; s.scene_schema(); print(*sys.modules)"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numba", "scipy", "vtk", "vtkmodules", "pyvista", "OCP"} & set(loaded)


def test_places_are_known_afterwards(folder: Path) -> None:
    scene = load(folder, GOOD)
    assert scene.where("model", 0, "faces") == f"{folder / 'scene.toml'}:8"
    assert scene.where("model", 0, "faces", 0) == f"{folder / 'scene.toml'}:8"
    assert scene.where("model", 0, "anchor") == f"{folder / 'scene.toml'}:5"
    assert scene.where("tool", 0, "path", 1, "at") == f"{folder / 'scene.toml'}:26"
    assert scene.where("refit") == f"{folder / 'scene.toml'}:1"


BAD = [
    # what stands in the good scene, what is put there instead, the one line that comes of it
    ('name = "thumb press"', 'nam = "thumb press"', "scene.toml:2: unknown key nam (did you mean name?)"),
    ('units = "mm"', 'units = "mn"', 'scene.toml:3: units "mn" is not known (use one of um, mm, cm, dm, m, km, in, ft'),
    ('units = "mm"', "", "scene.toml:1: units is missing"),
    ('"panel.step"', '"pannel.step"', 'scene.toml:7: model "panel": file "pannel.step" is not there'),
    ('"panel.step"', '"."', 'scene.toml:7: model "panel": file "." is a folder'),
    ("thickness = 3.0", "thickness = nan", 'scene.toml:9: model "panel": thickness must be a finite number, not nan'),
    ("thickness = 3.0", "thickness = -3.0", 'scene.toml:9: model "panel": thickness must be above 0, not -3.0'),
    ("thickness = 3.0", 'thickness = "3"', 'scene.toml:9: model "panel": thickness must be a number, not "3"'),
    ("thickness = 3.0\n", "", 'scene.toml:5: model "panel": thickness is missing'),
    (
        "thickness = 3.0",
        "thicknes = 3.0",
        'scene.toml:9: model "panel": unknown key thicknes (did you mean thickness?)',
    ),
    ("radii = [8", "radiii = [8", 'scene.toml:20: tool "thumb": unknown key radiii (did you mean radii?)'),
    ('material = "clay"', 'material = "clai"', 'scene.toml:11: model "panel": material "clai" is not known (did you'),
    ("friction = 0.5", "friction = inf", 'scene.toml:15: material "clay": friction must be a finite number, not inf'),
    (
        '"ellipsoid"',
        '"elipsoid"',
        'scene.toml:19: tool "thumb": shape "elipsoid" is not known (did you mean',
    ),
    ("radii = [8, 8, 14]", "radii = [8, 8,\n -14]", 'scene.toml:21: tool "thumb": number 3 of radii must be above 0'),
    ("t = 1.0", "t = -1.0", 'scene.toml:25: tool "thumb", path row 2: t must be at least 0, not -1.0'),
    ("t = 0.0", "t = 2.0", 'scene.toml:25: tool "thumb", path row 2: t goes back in time: 1.0 after 2.0'),
    ("at = [0, 0, -4]", "at = [0, 0]", 'scene.toml:26: tool "thumb", path row 2: at must be a list of 3 numbers'),
    ("[[tool]]", "[tool]", "scene.toml:17: tool must be a list, not a table (write [[tool]] with two brackets)"),
    ("step = 1e-3", "step = true", 'scene.toml:30: solver: step must be a number of seconds or "auto", not true'),
    ("step = 1e-3", "step = ", "scene.toml:30: not TOML: invalid value at column 8"),
    ("step = 1e-3", "step = 1\nstep = 2", "scene.toml:31: not TOML: a key or table is given twice"),
    (
        '"thumb", "panel"',
        '"thum", "panel"',
        'scene.toml:34: expect 1: pair names "thum", no body (did you mean thumb?)',
    ),
    ("between = [0.70, 0.75]", "", "scene.toml:32: expect 1: needs exactly one of between, at_most, at_least, equals"),
    ('what = "first_contact"', 'what = "touch"', 'scene.toml:33: expect 1: what "touch" is not known'),
]


@pytest.mark.parametrize(("old", "new", "line"), BAD)
def test_one_fault_is_one_line_with_its_place(folder: Path, old: str, new: str, line: str) -> None:
    assert old in GOOD
    (fault,) = faults(folder, GOOD.replace(old, new, 1))
    assert fault.startswith(line)


def test_a_size_of_another_shape_is_told_with_the_one_that_is_missing(folder: Path) -> None:
    found = faults(folder, GOOD.replace("radii = [8, 8, 14]", "radius = 8"))
    assert found[0].startswith('scene.toml:17: tool "thumb": radii is missing (an ellipsoid needs radii)')
    assert found[1].startswith('scene.toml:20: tool "thumb": radius is no key of an ellipsoid, which has radii')


def test_all_faults_come_at_once_in_the_order_of_the_file(folder: Path) -> None:
    text = GOOD
    told = [bad for bad in BAD if "not TOML" not in bad[2]]
    chosen = [bad for bad in told if "\n" not in bad[0] + bad[1] and bad[1]][::2]
    lines: dict[str, str] = {}
    for old, new, line in chosen:
        if old in text and line.split(":")[1] not in lines:
            text = text.replace(old, new, 1)
            lines[line.split(":")[1]] = line
    found = faults(folder, text)
    assert len(found) == len(lines) > 5
    for fault, (number, line) in zip(found, sorted(lines.items(), key=lambda item: int(item[0])), strict=True):
        assert fault.startswith(f"scene.toml:{number}: ")
        assert fault.split(": ")[-1][:10] in line or line in fault


def test_a_fault_is_one_line_whatever_the_names(folder: Path) -> None:
    text = GOOD.replace('"panel"', '"pa\\nnel"').replace(
        "[material.clay]", '"a\\tb" = 1\n["mat\\nter"]\n[material."x\\ny"]'
    )
    found = faults(folder, text.replace('preset = "clay"', 'preset = "cl\\ray"'))
    assert len(found) == 5
    assert all(fault.isprintable() for fault in found)


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (None, "scene.toml: there is no such file"),
        (b"", "scene.toml:1: units is missing"),
        (b"\xff\xfe", "scene.toml:1: is no UTF-8 text"),
        (b'units = "mm"\nname = "\xe4"\n', "scene.toml:2: is no UTF-8 text (save the file as UTF-8)"),
        (b"ISO-10303-21;\n", "scene.toml:1: not TOML: "),
        (b"a = " + b"[" * 5000, "scene.toml"),
    ],
)
def test_files_that_are_no_scene(folder: Path, content: bytes | None, line: str) -> None:
    if content is not None:
        (folder / "scene.toml").write_bytes(content)
    with pytest.raises(SceneError) as caught:
        SceneFile.load(folder / "scene.toml")
    assert caught.value.faults[0].removeprefix(f"{folder}/").startswith(line)
    with pytest.raises(SceneError, match="cannot be read"):
        SceneFile.load(folder)


def test_windows_line_ends_and_a_byte_order_mark(folder: Path) -> None:
    (folder / "scene.toml").write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    scene = SceneFile.load(folder / "scene.toml")
    assert scene.where("expect", 0, "between").endswith(":35")


# ---------------------------------------------------------------------- tools and paths of their own

USES = GOOD.replace('name = "thumb"\nshape = "ellipsoid"\nradii = [8, 8, 14]', 'use = "thumb"')


def test_a_tool_of_the_library(folder: Path) -> None:
    assert load(folder, USES).tool[0].radii == (8.0, 8.0, 14.0)
    assert load(folder, USES.replace('"mm"', '"m"')).tool[0].radii == (0.008, 0.008, 0.014)
    scene = load(folder, USES.replace('use = "thumb"', 'use = "ball"\nname = "thumb"\nradius = 2'))
    assert (scene.tool[0].name, scene.tool[0].radius) == ("thumb", 2.0)
    assert scene.sources() == [folder / "panel.step"]


def test_a_definition_of_the_users_own(folder: Path) -> None:
    (folder / "my.tool.toml").write_text('units = "cm"\nshape = "ellipsoid"\nradii = [1, 1, 2]\nname = "thumb"\n')
    scene = load(folder, USES.replace('use = "thumb"', 'use = "my.tool.toml"'))
    assert scene.tool[0].radii == (10.0, 10.0, 20.0)
    assert scene.sources() == [folder / "panel.step", folder / "my.tool.toml"]


@pytest.mark.parametrize(
    ("use", "line"),
    [
        ('use = "thum"', 'scene.toml:18: tool 1: use "thum" is no shipped tool (did you mean thumb?)'),
        ('use = "a/b.tool.toml"', 'scene.toml:18: tool 1: use "a/b.tool.toml" names no file'),
        ('use = "bad.tool.toml"', "bad.tool.toml:3: radius must be above 0, not -1"),
        ('use = "syntax.tool.toml"', "syntax.tool.toml:1: not TOML: "),
        ('use = "goo.tool.toml"', 'goo.tool.toml:2: material "goo" is not known'),
        ('use = "ball"\nname = "thumb"\nradius = -2', 'scene.toml:20: tool "thumb": radius must be above 0, not -2'),
        ('use = "ball"\nname = "thumb"\nsize = 2', "*"),
        ("use = 3", "*"),
    ],
)
def test_faults_of_tools_are_told_where_they_stand(folder: Path, use: str, line: str) -> None:
    (folder / "bad.tool.toml").write_text('shape = "sphere"\n\nradius = -1\n')
    (folder / "syntax.tool.toml").write_text("shape = \n")
    (folder / "f.step").touch()
    goo = 'shape = "surface"\nmaterial = "goo"\nfile = "f.step"\nthickness = 1\nnodes = 1\nname = "thumb"\n'
    (folder / "goo.tool.toml").write_text(goo)
    found = faults(folder, USES.replace('use = "thumb"', use))
    if line != "*":
        assert len(found) == 1
        assert found[0].startswith(line)


def test_a_faulty_definition_used_twice_is_told_once_and_the_rest_of_the_tool_still_checked(folder: Path) -> None:
    (folder / "bad.tool.toml").write_text('shape = "sphere"\nradius = -1\n')
    text = USES.replace('use = "thumb"', 'name = "thumb"\nuse = "bad.tool.toml"').replace("t = 1.0", "t = 0.0")
    found = faults(folder, text + '[[tool]]\nname = "two"\nuse = "bad.tool.toml"\n')
    assert len(found) == 2
    assert found[0] == "bad.tool.toml:2: radius must be above 0, not -1"
    assert found[1].endswith("path row 2: t does not move on in time: 0.0 after 0.0")


ROWS = GOOD[GOOD.index("[[tool.path]]") : GOOD.index("[solver]")]


def test_a_path_in_a_file(folder: Path) -> None:
    (folder / "press.csv").write_text("0,0,0,20\n1,0,0,-4\n")
    scene = load(folder, GOOD.replace(ROWS, 'path = "press.csv"\n'))
    path = scene.tool_path("thumb")
    assert path is not None
    assert path.length == 24.0
    assert scene.sources() == [folder / "panel.step", folder / "press.csv"]
    assert load(folder, GOOD.replace(ROWS, "")).tool_path("thumb") is None


def test_faults_of_path_files(folder: Path) -> None:
    (folder / "press.csv").write_text("0,0,0,20\n1,0,nan,-4\n0.5,0,0,0\n0.2,0,0,0\n")
    (folder / "press.dxf").write_text("0\n")
    assert faults(folder, GOOD.replace(ROWS, 'path = "press.csv"\n')) == [
        "press.csv:2: nan is not a finite number",
        "press.csv:4: t goes back in time: 0.2 after 0.5",
    ]
    (fault,) = faults(folder, GOOD.replace(ROWS, 'path = "press.dxf"\n'))
    assert fault.startswith('scene.toml:21: tool "thumb": path "press.dxf": tool paths of kind \'.dxf\' are not read')
    (fault,) = faults(folder, GOOD.replace(ROWS, 'path = "none.csv"\n'))
    assert fault == 'scene.toml:21: tool "thumb": path "none.csv" is not there'
    (fault,) = faults(folder, GOOD.replace(ROWS, 'path = "press.csv"\n' + ROWS))
    assert fault.startswith("scene.toml:22: not TOML: a key or table is given twice")


# ---------------------------------------------------------------------- writing

texts = st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=8)
words = st.text(st.characters(exclude_categories=("Cs",)), min_size=1, max_size=8)  # faces are named by other programs
positive = st.floats(1e-12, 1e12) | st.integers(1, 1000)
numbers = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-1000, 1000)
vectors = st.lists(numbers, min_size=3, max_size=3)
intervals = st.tuples(numbers, numbers).map(lambda pair: sorted(pair))
counts = st.lists(st.integers(2, 99), min_size=2, max_size=2)
boxes = st.fixed_dictionaries({"face": words | st.integers(1, 99)}, optional={"u": intervals, "v": intervals})
faces = st.just("all") | st.lists(words | st.integers(1, 9), min_size=1, max_size=3)
anchors = st.sampled_from(["base", "edges", "none"]) | st.lists(words | boxes, min_size=1, max_size=3)
sizes = st.lists(positive, min_size=3, max_size=3)
shapes = st.one_of(
    st.fixed_dictionaries({"shape": st.just("point")}, optional={"area": positive}),
    st.fixed_dictionaries({"shape": st.just("sphere"), "radius": positive}),
    st.fixed_dictionaries({"shape": st.just("ellipsoid"), "radii": sizes}),
    st.fixed_dictionaries({"shape": st.just("cylinder"), "radius": positive, "height": positive}),
    st.fixed_dictionaries({"shape": st.just("box"), "size": sizes, "rounding": st.just(0.0)}),
    st.fixed_dictionaries({"shape": st.just("half_space")}),
    st.fixed_dictionaries(
        {
            "shape": st.just("formula"),
            "expression": st.sampled_from(["x*x + y - 1", "max(abs(z), x)-0.5", "sin( 3*x ) - y"]),
            "box": st.just([[-1, -2, -3], [1, 2.5, 3]]),
        }
    ),
    st.fixed_dictionaries(
        {
            "shape": st.sampled_from(["union", "intersection", "difference"]),
            "part": st.lists(
                st.fixed_dictionaries(
                    {"shape": st.just("sphere"), "radius": positive},
                    optional={"at": vectors, "turn": st.lists(st.floats(0.1, 9), min_size=4, max_size=4)},
                )
                | st.just(
                    {
                        "shape": "union",
                        "part": [{"shape": "half_space"}, {"shape": "box", "size": [1, 2, 3], "at": [0, 0, 1.5]}],
                    }
                ),
                min_size=2,
                max_size=3,
            ),
        }
    ),
    st.fixed_dictionaries(
        {"shape": st.just("surface"), "file": st.just("part.step")},
        optional={"faces": faces},
    ),
    st.fixed_dictionaries(
        {"shape": st.just("surface"), "file": st.just("part.step"), "material": st.just("foam")}
        | {"thickness": positive, "nodes": positive | counts},
        optional={"hold": anchors.filter(lambda anchor: anchor != "none"), "layers": st.integers(1, 9)},
    ),
    st.fixed_dictionaries({"use": st.sampled_from(sorted(tool_toml.library()))}),
    st.fixed_dictionaries({"use": st.just("ball"), "radius": positive}),
    st.fixed_dictionaries({"use": st.just("punch"), "shape": st.just("sphere"), "radius": positive}),
)


@st.composite
def rows(draw: st.DrawFn) -> list[dict[str, Any]]:
    times = sorted(draw(st.sets(st.floats(0, 1e6), min_size=1, max_size=3)))
    turns = st.none() | st.lists(st.floats(0.1, 9), min_size=4, max_size=4)
    turned = [(t, draw(vectors), draw(turns)) for t in times]
    return [{"t": t, "at": at, **({"turn": turn} if turn else {})} for t, at, turn in turned]


@st.composite
def scenes(draw: st.DrawFn) -> dict[str, Any]:
    names = draw(st.lists(texts, min_size=3, max_size=5, unique=True))
    materials = st.fixed_dictionaries(
        {"youngs_modulus": positive, "density": positive},
        optional={"yield_strain": positive | st.just("none"), "friction": positive, "hardening": st.floats(0, 1)},
    ) | st.fixed_dictionaries(
        {"preset": st.sampled_from(["clay", "rubber", "sheet steel"])},
        optional={"density": positive, "yield_strain": positive | st.just("none"), "hardening": st.just(0.0)},
    )
    tables = draw(st.dictionaries(texts, materials, max_size=3))
    material = st.sampled_from([*tables, "clay", "foam", "aluminium"])
    zones = st.builds(lambda box, name: {**box, "material": name}, boxes, material)
    model = st.fixed_dictionaries(
        {"file": st.just("part.step"), "thickness": positive, "nodes": positive | counts, "material": material},
        optional={
            "faces": faces,
            "layers": st.integers(1, 9),
            "anchor": anchors,
            "edges": st.sampled_from(["held", "free"]),
            "zones": st.lists(zones, max_size=2),
            "outward": st.booleans(),
        },
    )
    tool = st.builds(
        lambda shape, path, force: {**shape, **path, **force},
        shapes,
        st.fixed_dictionaries({}, optional={"path": rows()}) | st.just({"path": "press.csv"}),
        st.just({}) | st.fixed_dictionaries({"control": st.just("force"), "force": positive}),
    )
    limits = st.one_of(
        st.fixed_dictionaries({"between": intervals}),
        st.fixed_dictionaries({"at_most": numbers}),
        st.fixed_dictionaries({"at_least": numbers}),
        st.fixed_dictionaries({"equals": numbers, "tolerance": positive}),
    ).map(lambda limit: {"what": "max_depth", **limit})
    verdicts = st.sampled_from(
        [{"what": "verdict", "never": "contact"}, {"what": "verdict", "equals": "touching", "pair": names[:2]}]
    )
    rest = st.fixed_dictionaries(
        {},
        optional={
            "name": texts,
            "expect": st.lists(limits | verdicts, max_size=3),
            "solver": st.fixed_dictionaries(
                {},
                optional={
                    "step": positive | st.just("auto"),
                    "resolution": st.integers(2, 999) | counts,
                    "tolerance": positive,
                    "mode": st.just("paper"),
                    "integrator": st.just("implicit"),
                },
            ),
            "refit": st.fixed_dictionaries({}, optional={"tolerance": positive, "refine": st.booleans()}),
            "output": st.fixed_dictionaries(
                {}, optional={"cad": st.just(["iges"]), "frames_per_second": positive, "pictures": st.booleans()}
            ),
        },
    )
    tools = [{"name": name, **draw(tool)} for name in names[1:]]
    held = {"anchor": "base"} if any("force" in each for each in tools) else {}
    return {
        "units": draw(st.sampled_from(sorted(METRES_PER_UNIT))),
        "material": tables,
        "model": [{"name": names[0], **draw(model), **held}],
        "tool": tools,
        **draw(rest),
    }


def test_a_path_of_a_machine(folder: Path) -> None:
    """Its lengths come in the scene's unit; its options are checked; its warnings are kept."""
    (folder / "press.ngc").write_text("G20 G0 X1 Z1\nG1 Z0 A90 F60\n")
    options = '[tool.path_options]\nkinematics = "xyzac-trt"\nrapid = 10\n'
    scene = load(folder, GOOD.replace(ROWS, 'path = "press.ngc"\n' + options))
    path = scene.tool_path("thumb")
    assert path is not None
    np.testing.assert_allclose(path.at[[0, -1]], [[25.4, 0, 25.4], [25.4, 0, 0]])
    np.testing.assert_allclose(path.rotation[-1] @ [0, 0, 1], [0, 1, 0], atol=1e-15)
    assert [line.split("press.ngc: ")[1] for line in scene.warnings] == [
        "ends without M2, M30 or %: it may have been cut off"
    ]
    assert load(folder, dump(scene)) == scene
    (fault,) = faults(folder, GOOD.replace(ROWS, 'path = "press.ngc"\n'))
    assert fault.startswith("press.ngc:2: the axis A turns, and no kinematics is given")
    (fault,) = [
        line
        for line in faults(folder, GOOD.replace(ROWS, 'path = "press.ngc"\n' + options.replace("ac-trt", "ac-tr")))
        if "scene.toml" in line
    ]
    assert "did you mean xyzac-trt" in fault
    (folder / "press.csv").write_text("0,0,0,20\n")
    (fault,) = faults(folder, GOOD.replace(ROWS, 'path = "press.csv"\n' + options))
    assert "path_options belong to a path in a file (.ngc" in fault


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(scenes())
def test_what_is_written_reads_back_equal(tmp_path_factory: pytest.TempPathFactory, data: dict[str, Any]) -> None:
    folder = tmp_path_factory.getbasetemp() / "round"
    folder.mkdir(exist_ok=True)
    (folder / "part.step").touch()
    (folder / "press.csv").write_text("0,0,0,1\n1,0,0,0\n")
    scene = SceneFile.of(data, folder / "scene.toml")
    text = dump(scene)
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    back = SceneFile.load(folder / "scene.toml")
    assert back == scene
    assert dump(back) == text
    assert all((tool.use is None) == ("use" not in given) for tool, given in zip(back.tool, data["tool"], strict=True))


def test_a_scene_in_the_making_may_stand_nowhere_yet(folder: Path) -> None:
    scene = SceneFile.of(tomllib.loads(GOOD), folder / "new.toml")
    assert scene.where("model", 0, "file") == f"{folder / 'new.toml'}"
    plain = Scene.model_validate(tomllib.loads(GOOD))
    assert load(folder, dump(plain)) == plain == scene
    with pytest.raises(SceneError) as caught:
        SceneFile.of({**tomllib.loads(GOOD), "units": "mn"}, folder / "new.toml")
    assert caught.value.faults[0].startswith(f"{folder / 'new.toml'}: units")


def test_each_key_is_explained_where_it_stands_first(folder: Path) -> None:
    text = dump(load(folder, GOOD))
    for key, field in PathRow.model_fields.items():
        explained = [
            line for line in text.splitlines() if line.startswith(f"{key} = ") and str(field.description) in line
        ]
        assert len(explained) == 1


# ---------------------------------------------------------------------- lines

TRICKY = '''
# [not.a.table]
a.b."c d" = 1
text = """
[also] = "not"  ""
key = 1 \\""" more"""""
'single''s' = 2
[t]
k = [ # first
  1, { p = "}]#", q.r = '"' }, [2,
  3], 1979-05-27 07:32:00 , """]
""", ]
[[m]]
[m.sub]
z = 1
[[m.rows]]
[[m.rows]]
"\\u0074" = 0
[[m]]
rows = [{t = 1},
        {t = 2}]
[ spaced . "out" ]
x = -inf
'''.replace("'single''s'", "'single\"s'")


def leaves(value: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    if place:
        yield place, value
    for key, inner in items:
        yield from leaves(inner, (*place, key))


def test_every_place_of_a_tricky_file_has_its_line() -> None:
    file = toml_file.parse(TRICKY, Path("tricky.toml"))
    assert {place for place, _ in leaves(file.data)} == set(file.lines) - {()}
    lines = TRICKY.split("\n")
    for place, value in leaves(file.data):
        if isinstance(place[-1], str) and not isinstance(value, dict):
            shown = {"t": "t", "c d": '"c d"', "r": "q.r"}.get(place[-1], place[-1])
            line = lines[file.lines[place] - 1]
            assert shown in line or "\\u0074" in line
    expected = {("m", 0): 13, ("m", 1): 19, ("m", 0, "rows", 1): 17, ("m", 1, "rows", 1): 21, ("t", "k", 2, 1): 11}
    assert {place: file.lines[place] for place in expected} == expected
    assert file.line(("spaced", "out", "x")) == 23
    assert file.line(("spaced", "out", "y", "z")) == 22
    assert file.line(("nowhere",)) == 1


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(scenes())
def test_every_place_of_a_written_scene_has_its_line(data: dict[str, Any]) -> None:
    text = dump(Scene.model_validate({**data, "tool": [{"name": "tool", "shape": "point"}], "expect": []}))
    file = toml_file.parse(text, Path("scene.toml"))
    lines = text.split("\n")
    for place, value in leaves(file.data):
        line = lines[file.lines[place] - 1]
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            assert repr(value) in line


# ---------------------------------------------------------------------- schemas


def test_schemas_name_every_key_and_no_null() -> None:
    scene = schema.scene_schema()
    assert "null" not in str(scene)
    assert set(scene["properties"]) == set(Scene.key_names())
    assert scene["$defs"]["ToolSpec"]["properties"]["radius"]["description"].startswith("of a sphere")
    assert "path" in scene["$defs"]["ToolSpec"]["properties"]
    tool = schema.tool_schema()
    assert not set(tool["properties"]) & set(tool_toml.MOTION)
    assert schema.result_schema()["properties"]["summary"]
