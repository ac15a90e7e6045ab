"""A [[tool]] of the scene: its shape and sizes, its motion, and what holds a deformable one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import inf
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, Tag

from .errors import InputError
from .scene_values import (
    Anchor,
    Corners,
    Count,
    Exponents,
    Faces,
    Flag,
    Name,
    NotNegative,
    PartShape,
    Positive,
    Shape,
    Sizes,
    Spacing,
    Text,
    Turn,
    Unit,
    Vector,
)
from .spec import LIST, WORD, Fault, Spec, by_type, entries, is_number, read, shown
from .tools.expression import Expression

CAM_SUFFIXES = (".ngc", ".nc", ".gcode", ".tap", ".cnc", ".apt", ".cls", ".ncl", ".aptsource")
"""Of the path files that [tool.path_options] are for: G-code, then APT."""


class PathRow(Spec):
    """Where the tool is at a time."""

    t: NotNegative = Field(description="time in s")
    at: Vector = Field(description="where the origin of the tool's frame is")
    turn: Turn = Field(default=(0.0, 0.0, 1.0, 0.0), description="turned about an axis: [x, y, z, degrees]")


class PathOptions(Spec):
    """How a G-code or APT file becomes a path; a CSV file says everything itself."""

    units: Unit | None = Field(
        default=None, description="of the lengths in a file that names none; the scene's when left out"
    )
    tolerance: Positive | None = Field(
        default=None, description="between an arc and its straight pieces, 0.01 mm when left out"
    )
    rapid: Positive | None = Field(
        default=None, description="speed of rapid moves, lengths per s; 100 mm/s when left out"
    )
    block_delete: Flag = Field(default=False, description="lines that begin with / are left out")
    kinematics: Literal["xyzac-trt", "xyzbc-trt", "xyzac-head", "xyzbc-head"] | None = Field(
        default=None, description="the machine's rotary axes, for files that turn them"
    )
    tip: Flag = Field(
        default=True, description="X, Y, Z are the tool's tip on the part; false when they are the machine's slides"
    )
    pivot: Vector = Field(
        default=(0.0, 0.0, 0.0), description="with tip = false: where a table's rotary axes cross, on the part"
    )
    reach: NotNegative = Field(default=0.0, description="with tip = false: from a head's rotary axes to the tool's tip")


SIZES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "point": ((), ("area",)),
    "sphere": (("radius",), ()),
    "ellipsoid": (("radii",), ()),
    "capsule": (("radius", "length"), ()),
    "cylinder": (("radius", "height"), ("rounding",)),
    "cone": (("radius", "height"), ()),
    "box": (("size",), ("rounding",)),
    "torus": (("major_radius", "minor_radius"), ()),
    "superquadric": (("radii", "exponents"), ()),
    "half_space": ((), ()),
    "formula": (("expression", "box"), ()),
    "union": (("part",), ()),
    "intersection": (("part",), ()),
    "difference": (("part",), ()),
    "surface": (("file",), ("file_units", "faces", "material", "thickness", "nodes", "layers", "hold")),
    "mesh": (("file",), ("file_units",)),
}
"""Per shape, the keys that it must have and those that it may have."""

SIZE_KEYS = tuple(dict.fromkeys(key for needed, free in SIZES.values() for key in needed + free))
COMPOSED = ("union", "intersection", "difference")
DEFORMABLE_KEYS = ("thickness", "nodes", "layers", "hold")


def _shape_conditions(schema: dict[str, Any]) -> None:
    """Tells editors which sizes belong to which shape."""
    _sizes_needed(schema, {"not": {"required": ["use"]}})
    schema["required"] = []
    schema["anyOf"] = [{"required": ["name", "shape"]}, {"required": ["use"]}]


def _part_conditions(schema: dict[str, Any]) -> None:
    """The same for a part."""
    _sizes_needed(schema, {})


def _sizes_needed(schema: dict[str, Any], unless: dict[str, Any]) -> None:
    possible = schema["properties"]["shape"]["enum"]
    schema["allOf"] = [
        {
            "if": {"properties": {"shape": {"const": shape}}, "required": ["shape"], **unless},
            "then": {"required": list(needed)},
        }
        for shape, (needed, _) in SIZES.items()
        if needed and shape in possible
    ]


class ShapeSpec(Spec):
    """A solid's shape and sizes.

    Shapes are centred at the origin of their frame with their axis along z. A cone has its apex there and opens
    towards +z; a half-space is everything above z = 0: a tool that comes down along -z touches with its tip.
    """

    shape: Shape = Field(description="the tool's form; its sizes depend on it")
    radius: Positive | None = Field(default=None, description="of a sphere, capsule, cylinder, or a cone's base")
    radii: Sizes | None = Field(default=None, description="of an ellipsoid or superquadric: along x, y, z")
    exponents: Exponents | None = Field(
        default=None, description="of a superquadric: [e1, e2], 0.1 to 2; 1 is round, near 0 square, 2 an octahedron"
    )
    length: Positive | None = Field(default=None, description="of a capsule: between the centres of its two ends")
    height: Positive | None = Field(default=None, description="of a cylinder or cone")
    size: Sizes | None = Field(default=None, description="of a box: whole length along x, y, z")
    rounding: NotNegative | None = Field(default=None, description="radius of the edges of a box or cylinder")
    major_radius: Positive | None = Field(
        default=None, description="of a torus: from its centre to the middle of the tube"
    )
    minor_radius: Positive | None = Field(default=None, description="of a torus: of the tube")
    expression: Text | None = Field(default=None, description="of a formula: in x, y, z; negative inside the tool")
    box: Corners | None = Field(
        default=None,
        description="of a formula: two corners of a box, the lower first; outside it the tool does not exist",
    )
    part: tuple[PartSpec, ...] | None = Field(
        default=None, description="of a union, intersection or difference: two or more [[tool.part]] tables"
    )

    @classmethod
    def faults(cls, given: Mapping[str, Any]) -> Iterator[Fault]:
        shape = given.get("shape")
        if isinstance(shape, str) and shape in SIZES:
            yield from _size_faults(shape, given)


class PartSpec(ShapeSpec):
    """A part of a composed tool: a shape, and where it stands in the tool's frame."""

    model_config = ConfigDict(json_schema_extra=_part_conditions)

    shape: PartShape = Field(description="the part's form; its sizes depend on it")
    at: Vector = Field(default=(0.0, 0.0, 0.0), description="where the origin of the part's frame is")
    turn: Turn = Field(default=(0.0, 0.0, 1.0, 0.0), description="turned about an axis: [x, y, z, degrees]")


class NamedTool(Spec):
    """A tool's name, and where its shape comes from."""

    name: Name = Field(description="the tool's name, unlike any other in the scene")
    use: Text | None = Field(
        default=None, description="a shipped tool or a .tool.toml file; what is written here overrides it"
    )


class ToolSpec(ShapeSpec, NamedTool):
    """A tool and its motion."""

    model_config = ConfigDict(json_schema_extra=_shape_conditions)

    area: Positive | None = Field(
        default=None, description="of a point: what its contact stands for, one node's share of the model when left out"
    )
    file: Text | None = Field(
        default=None, description="of a surface or mesh: its file, seen from the folder of this one"
    )
    file_units: Unit | None = Field(
        default=None, description="of its file's numbers: a mesh names none, then the scene's when left out"
    )
    faces: Faces | None = Field(default=None, description='of a surface: "all", or a list of names and numbers')
    material: Text | None = Field(default=None, description="of a surface: makes it deformable; rigid when left out")
    thickness: Positive | None = Field(default=None, description="of a deformable tool: depth of its material")
    nodes: Spacing | None = Field(
        default=None, description="of a deformable tool: spacing of its nodes, or how many [nu, nv]"
    )
    layers: Count | None = Field(default=None, description="of a deformable tool: cells through its thickness")
    hold: Anchor | None = Field(default=None, description="of a deformable tool: where it is held, as a model's anchor")
    control: Literal["position", "force"] = Field(default="position", description="what the path rules")
    force: Positive | None = Field(
        default=None, description='N along the direction of the path, with control = "force"'
    )
    direction: Vector | None = Field(
        default=None, description="where the force points, when not along the tool's way to its path: [x, y, z]"
    )
    path: (
        Annotated[
            Annotated[Text, Tag(WORD)] | Annotated[tuple[PathRow, ...], Field(min_length=1), Tag(LIST)],
            by_type("rows [[tool.path]] or the name of a file"),
        ]
        | None
    ) = Field(default=None, description="rows of time and place, or a file; left out when a program moves the tool")
    path_options: PathOptions | None = Field(
        default=None, description="of a path in a G-code or APT file: see [tool.path_options]"
    )

    @classmethod
    def faults(cls, given: Mapping[str, Any]) -> Iterator[Fault]:
        yield from super().faults(given)
        if given.get("control") == "force" and "force" not in given:
            yield Fault(("control",), 'force is missing (control = "force" needs the force in N)')
        for key in ("force", "direction"):
            if key in given and given.get("control", "position") == "position":
                yield Fault((key,), f'{key} needs control = "force"')
        if given.get("direction") in ([0, 0, 0], (0, 0, 0)):
            yield Fault(("direction",), "direction has no length (write where the force points, [0, 0, -1] say)")
        yield from _path_faults(entries(given, "path"))
        path = given.get("path")
        if given.get("path_options") is not None and not (
            isinstance(path, str) and path.lower().endswith(CAM_SUFFIXES)
        ):
            yield Fault(("path_options",), f"path_options belong to a path in a file ({', '.join(CAM_SUFFIXES)})")


def _size_faults(shape: str, given: Mapping[str, Any]) -> Iterator[Fault]:
    needed, free = SIZES[shape]
    a_shape = f"an {shape}" if shape[0] in "ei" else f"a {shape}"
    for key in needed:
        if key not in given:
            yield Fault((key,), f"{key} is missing ({a_shape} needs {' and '.join(needed)})")
    owners = {key: [s for s, (a, b) in SIZES.items() if key in a + b] for key in SIZE_KEYS}
    for key in SIZE_KEYS:
        if key in given and given[key] is not None and key not in needed + free:
            takes = f"which has {', '.join(needed + free)}" if needed + free else "which has no sizes"
            yield Fault((key,), f"{key} is no key of {a_shape}, {takes} ({key} belongs to: {', '.join(owners[key])})")
    if shape == "surface" and "material" in given:
        for key in ("thickness", "nodes"):
            if key not in given:
                yield Fault((key,), f"{key} is missing (a tool with a material is deformable and needs it)")
    elif shape == "surface":
        for key in DEFORMABLE_KEYS:
            if given.get(key) is not None:
                yield Fault((key,), f"{key} belongs to a deformable tool (give it a material)")
    if given.get("hold") == "none":
        yield Fault(("hold",), 'hold "none" leaves the tool without a hold (use base, edges, or a list of faces)')
    yield from _rounding_faults(shape, given)
    major, minor = given.get("major_radius"), given.get("minor_radius")
    if shape == "torus" and is_number(major) and is_number(minor) and 0 < major <= minor:
        yield Fault(("minor_radius",), f"minor_radius must be below major_radius {shown(major)}, not {shown(minor)}")
    corners = entries(given, "box")
    pairs: list[tuple[Any, Any]] = []
    if len(corners) == 2 and all(isinstance(corner, (list, tuple)) for corner in corners):
        pairs = list(zip(*corners, strict=False))
        if any(is_number(low) and is_number(high) and low >= high for low, high in pairs):
            yield Fault(("box",), "box must be [[x, y, z], [x, y, z]] with the lower corner first")
            pairs = []
    if shape == "formula" and isinstance(given.get("expression"), str) and given["expression"]:
        whole = len(pairs) == 3 and all(is_number(side) and abs(side) < inf for pair in pairs for side in pair)
        yield from _expression_faults(given["expression"], corners if whole else None)
    if shape in COMPOSED and isinstance(given.get("part"), (list, tuple)) and len(given["part"]) == 1:
        yield Fault(("part",), f"{a_shape} of one part (write two or more [[tool.part]] tables)")


def _expression_faults(expression: str, box: list[Any] | None) -> Iterator[Fault]:
    try:
        read = Expression.parse(expression)
    except InputError as error:
        yield Fault(("expression",), f"{error.what} ({error.mend})" if error.mend else error.what)
        return
    told = read.undefined(np.array(box, dtype=np.float64)) if box is not None else ""
    if told:
        yield Fault(("expression",), f"expression {told} (choose a smaller box, or another expression)")


def _rounding_faults(shape: str, given: Mapping[str, Any]) -> Iterator[Fault]:
    rounding = given.get("rounding")
    if not is_number(rounding):
        return
    sides: list[Any] = []
    if shape == "box" and isinstance(given.get("size"), (list, tuple)):
        sides = [0.5 * side for side in given["size"] if is_number(side)]
    elif shape == "cylinder" and is_number(given.get("radius")) and is_number(given.get("height")):
        sides = [given["radius"], 0.5 * given["height"]]
    if sides and 0 < min(sides) < rounding:
        limit = shown(min(sides))
        yield Fault(("rounding",), f"rounding must be at most {limit} for these sizes, not {shown(rounding)}")


def _path_faults(rows: list[Any]) -> Iterator[Fault]:
    latest = None
    for i, row in enumerate(rows):
        t = read(row, "t")
        if not is_number(t) or t < 0:
            continue  # a fault of its own
        if latest is not None and t <= latest:
            how = "goes back in time" if t < latest else "does not move on in time"
            yield Fault(("path", i, "t"), f"t {how}: {shown(t)} after {shown(latest)}")
        latest = t
