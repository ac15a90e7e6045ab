"""The scene: what is sculpted, with what, how, and what is expected. Text only: no arrays, no files.

Key for key the TOML of `scene.toml`. Lengths are in the scene's `units`, everything else SI, angles in degrees.
`Scene.model_validate(dict)` reports every fault at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from math import inf
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import ConfigDict, Field, ModelWrapValidatorHandler, model_validator

from .physics.material import PRESETS, Material
from .scene_tool import PartSpec, PathRow, ShapeSpec, ToolSpec
from .scene_values import (
    Anchor,
    CadFormat,
    Count,
    FaceBox,
    Faces,
    Flag,
    Instances,
    Interval,
    Name,
    Names,
    NotNegative,
    Number,
    Positive,
    Preset,
    Resolution,
    Schema,
    Spacing,
    Step,
    Text,
    Unit,
    Value,
    Verdict,
    Yield,
)
from .spec import Fault, Spec, entries, is_number, mend, read, shown

__all__ = [
    "ExpectSpec",
    "FaceBox",
    "MaterialSpec",
    "ModelSpec",
    "OutputSpec",
    "PartSpec",
    "PathRow",
    "RefitSpec",
    "Scene",
    "ShapeSpec",
    "SolverSpec",
    "ToolSpec",
    "Zone",
]


class Zone(FaceBox):
    """A region of another material."""

    material: Text = Field(description="name of the zone's material")


MATERIAL_KEYS = ("thickness", "nodes", "layers", "anchor", "edges", "material", "zones")
"""What a model of material has, and a rigid one does not."""

NEEDED_KEYS = ("thickness", "nodes", "material")


def _material_unless_rigid(schema: dict[str, Any]) -> None:
    """Tells editors that a rigid model needs no material."""
    schema["if"] = {"properties": {"rigid": {"const": True}}, "required": ["rigid"]}
    schema["else"] = {"required": list(NEEDED_KEYS)}


class ModelSpec(Spec):
    """A part whose faces are sculpted, or a rigid one that deformable tools and models meet."""

    model_config = ConfigDict(json_schema_extra=_material_unless_rigid)

    name: Name = Field(description="the model's name, unlike any other in the scene")
    file: Text = Field(description="its CAD file, seen from the scene's folder")
    file_units: Unit | None = Field(
        default=None,
        description="of the numbers in a file that names none or the wrong one; what it says when left out",
    )
    faces: Faces = Field(
        default="all", description='"all", or a list of names and numbers; other faces stay as they are'
    )
    instances: Instances = Field(
        default="all",
        description='of an assembly: "all" places of a component change alike, or a list of those that do ["bolt_2"]',
    )
    rigid: Flag = Field(
        default=False, description="true when it keeps its shape: it has no material, and nothing of it is sculpted"
    )
    thickness: Positive | None = Field(default=None, description="how deep the material goes below the surface")
    nodes: Spacing | None = Field(
        default=None, description="spacing of the lattice's nodes, or how many [nu, nv] on each face"
    )
    layers: Count = Field(default=3, description="cells of the lattice through the thickness")
    anchor: Anchor = Field(
        default="base", description='what is held: "base", "edges", "none", or a list of faces and {face, u, v}'
    )
    edges: Literal["held", "free"] = Field(
        default="held", description="a sculpted face where it meets faces that are not"
    )
    material: Text | None = Field(default=None, description="a preset, or the name of a [material.NAME] table")
    zones: tuple[Zone, ...] = Field(default=(), description="regions of other materials")
    outward: Flag | None = Field(
        default=None, description="true when S_u x S_v points out of the material, as the file says when left out"
    )

    @classmethod
    def faults(cls, given: Mapping[str, Any]) -> Iterator[Fault]:
        if given.get("rigid") is True:
            for key in MATERIAL_KEYS:
                if given.get(key) not in (None, cls.model_fields[key].default):
                    yield Fault((key,), f"{key} belongs to a model of material (leave out rigid, or {key})")
            return
        for key in NEEDED_KEYS:
            if given.get(key) is None:
                yield Fault((key,), f"{key} is missing ({cls.model_fields[key].description})")


def _preset_or_numbers(schema: dict[str, Any]) -> None:
    """Tells editors that a preset stands for the numbers."""
    schema["anyOf"] = [{"required": schema.pop("required")}, {"required": ["preset"]}]


class MaterialSpec(Spec):
    """What a body is made of."""

    model_config = ConfigDict(json_schema_extra=_preset_or_numbers)

    preset: Preset | None = Field(default=None, description="the material whose numbers stand where none is written")
    youngs_modulus: Positive = Field(description="Pa")
    density: Positive = Field(description="kg/m3")
    damping: NotNegative = Field(default=0.1, description="fraction of critical")
    yield_strain: Yield = Field(
        default="none", description='strain where it starts to keep its shape, "none" when elastic'
    )
    hardening: Annotated[NotNegative, Field(le=1)] = Field(
        default=0.0, description="slope beyond the yield strain, as a fraction of the elastic one"
    )
    friction: NotNegative = Field(default=0.3, description="Coulomb's coefficient against any other body")

    @model_validator(mode="before")
    @classmethod
    def _upon_its_preset(cls, given: Any) -> Any:
        if not isinstance(given, dict) or "preset" not in given:
            return given
        preset = given["preset"]
        # an unknown preset is one fault; the numbers that it would have given are not missing too
        return {**preset_numbers(preset if isinstance(preset, str) and preset in PRESETS else "clay"), **given}


def preset_numbers(preset: str) -> dict[str, Any]:
    """The keys of a [material.NAME] table that a preset stands for. KeyError when there is none of that name."""
    numbers = {field.name: getattr(PRESETS[preset], field.name) for field in fields(Material) if field.name != "name"}
    return {key: "none" if value == inf else value for key, value in numbers.items()}


LEFT_OUT: Any = None
"""A length that the scene fills when it is made: only it knows the thickness that the length follows from."""


class SolverSpec(Spec):
    """How the simulation is computed. Lengths left out follow from the thinnest material."""

    integrator: Literal["explicit", "implicit"] = Field(default="explicit", description="how time is integrated")
    quasi_static: Flag = Field(
        default=False, description="true when inertia and damping are left out (implicit): every step ends at rest"
    )
    step: Step = Field(default="auto", description='s between collision checks, or "auto"')
    substep: Positive | None = Field(
        default=None, description="s of one step of the lattice, the stable one when left out"
    )
    resolution: Resolution = Field(default=201, description="finest rows and columns per patch, or [nu, nv]")
    tolerance: Positive = Field(
        default=LEFT_OUT, description="of contacts and distances, 1/300 of the thickness when left out"
    )
    max_penetration: Positive = Field(
        default=LEFT_OUT, description="left after a step, 1/60 of the thickness when left out"
    )
    mode: Literal["certified", "paper"] = Field(
        default="certified", description="bounds that miss nothing, or the paper's"
    )
    delta: NotNegative = Field(default=1.0, description="degrees between normals below which the paper adds no points")

    @classmethod
    def faults(cls, given: Mapping[str, Any]) -> Iterator[Fault]:
        step, substep = given.get("step"), given.get("substep")
        if is_number(step) and is_number(substep) and substep > step > 0:
            yield Fault(("substep",), f"substep must be at most step {shown(step)}, not {shown(substep)}")
        tolerance, left = given.get("tolerance"), given.get("max_penetration")
        if is_number(tolerance) and is_number(left) and 0 < left < tolerance:
            yield Fault(
                ("max_penetration",),
                f"max_penetration {shown(left)} cannot be seen with tolerance {shown(tolerance)} (make tolerance smaller)",
            )
        if given.get("quasi_static") is True and given.get("integrator") != "implicit":
            yield Fault(("quasi_static",), 'quasi_static needs integrator = "implicit"')


class RefitSpec(Spec):
    """How the sculpted surfaces are fitted."""

    tolerance: Positive = Field(
        default=LEFT_OUT, description="of the surface to its nodes, 1/150 of the thickness when left out"
    )
    refine: Flag = Field(default=True, description="knots are inserted where the tolerance asks for it")
    max_control_points: Count = Field(default=10000, description="of one face")
    fixed: tuple[FaceBox, ...] = Field(
        default=(), description="regions { face, u, v } that stay as they are, their material too"
    )
    continuity: Literal["G0", "G1"] = Field(
        default="G0", description="of faces that share an edge: closed, or tangent as well where they were"
    )
    seam_tolerance: Positive | None = Field(
        default=None, description="how far faces may be apart along an edge, what the file states when left out"
    )


class OutputSpec(Spec):
    """What a run writes."""

    cad: tuple[CadFormat, ...] = Field(
        default=("step", "json"), description="formats of the part: step, iges, 3dm, json"
    )
    frames_per_second: Positive = Field(default=30.0, description="of the series over time")
    pictures: Flag = Field(default=True, description="of the result, in the report")

    @classmethod
    def faults(cls, given: Mapping[str, Any]) -> Iterator[Fault]:
        formats = entries(given, "cad")
        for i, name in enumerate(formats):
            if name in formats[:i]:
                yield Fault(("cad", i), f"cad names {shown(name)} twice")


TESTS = ("between", "at_most", "at_least", "equals", "never")


class ExpectSpec(Spec):
    """One number or verdict that must come out."""

    what: Literal[
        "verdict", "clearance", "first_contact", "max_depth", "max_force", "contact_area", "max_displacement",
        "refit_error", "residual_penetration",
    ] = Field(description="what is measured")  # fmt: skip
    pair: Names | None = Field(default=None, description="the two bodies, every model with every tool when left out")
    between: Interval | None = Field(default=None, description="[low, high]")
    at_most: Number | None = Field(default=None, description="upper limit")
    at_least: Number | None = Field(default=None, description="lower limit")
    equals: Value | None = Field(default=None, description="a number with a tolerance, or a verdict")
    tolerance: NotNegative | None = Field(default=None, description="of equals")
    never: Verdict | None = Field(default=None, description="the verdict that must not come at any time")

    @classmethod
    def faults(cls, given: Mapping[str, Any]) -> Iterator[Fault]:
        what, written = given.get("what"), [key for key in TESTS if given.get(key) is not None]
        if len(written) != 1:
            listing = f"{', '.join(TESTS[:-1])} or {TESTS[-1]}"
            yield Fault(tuple(written[1:2]), f"needs exactly one of {listing}")
            return
        key, value = written[0], given[written[0]]
        if what == "verdict":
            if key not in ("equals", "never"):
                yield Fault((key,), f"{key} compares numbers, a verdict takes equals or never")
            elif key == "equals" and (not isinstance(value, str) or value not in get_args(Verdict)):
                yield Fault((key,), f"{key} {shown(value)} is no verdict {mend(str(value), get_args(Verdict))}")
        elif key == "never" and (what != "first_contact" or value != "contact"):
            yield Fault((key,), 'never is for what = "verdict", or never = "contact" for what = "first_contact"')
        elif key == "equals" and isinstance(value, str):
            yield Fault((key,), f"equals must be a number for what = {shown(what)}, not {shown(value)}")
        elif key == "equals" and "tolerance" not in given:
            yield Fault((key,), "tolerance is missing (equals needs one: no two computed numbers are the same)")
        if "tolerance" in given and (key != "equals" or what == "verdict"):
            yield Fault(("tolerance",), "tolerance goes with equals and a number")
        if "pair" in given and what in ("refit_error", "max_displacement"):
            yield Fault(("pair",), f"pair does not go with {what}, which is of the whole scene")


class Scene(Spec):
    """Everything that a run needs but the files it names."""

    schema_version: Schema = Field(default=1, alias="schema", description="version of this language")
    name: Name = Field(default="scene", description="a title for reports")
    units: Unit = Field(description='of all lengths here: "mm", "m", "in", ...; everything else is SI')
    model: tuple[ModelSpec, ...] = Field(min_length=1, description="a scene has at least one [[model]]")
    material: dict[str, MaterialSpec] = Field(default_factory=dict, description="materials by name")
    tool: tuple[ToolSpec, ...] = Field(min_length=1, description="a scene has at least one [[tool]]")
    solver: SolverSpec = Field(default_factory=SolverSpec, description="how it is computed")
    refit: RefitSpec = Field(default_factory=RefitSpec, description="how the surfaces are fitted")
    output: OutputSpec = Field(default_factory=OutputSpec, description="what is written")
    expect: tuple[ExpectSpec, ...] = Field(default=(), description="what is asserted of the result")

    def __eq__(self, other: object) -> bool:
        """Scenes are equal when they say the same, wherever they were read from."""
        return isinstance(other, Scene) and self.model_dump() == other.model_dump()

    __hash__ = None  # type: ignore[assignment]

    def material_of(self, name: str) -> Material:
        """The material of that name: a table of the scene, else a preset. KeyError for a name that is neither."""
        if name not in self.material:
            return PRESETS[name]
        numbers = self.material[name].model_dump(exclude={"preset"})
        return Material(**{key: inf if value == "none" else value for key, value in numbers.items()}, name=name)

    @model_validator(mode="wrap")
    @classmethod
    def _fill_lengths(cls, given: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Lengths of solver and refit that were left out, from the one length that every scene knows."""
        scene = handler(given)
        given_lengths = [model.thickness for model in scene.model] + [tool.thickness for tool in scene.tool]
        thickness = min(length for length in given_lengths if length is not None)
        if scene.solver.tolerance is None or scene.solver.max_penetration is None:
            tolerance, left = scene.solver.tolerance, scene.solver.max_penetration
            # an overlap smaller than the tolerance cannot be seen
            lengths = {
                "tolerance": tolerance or min(thickness / 300.0, left or thickness),
                "max_penetration": left or max(thickness / 60.0, tolerance or 0.0),
            }
            scene.__dict__["solver"] = scene.solver.model_copy(update=lengths)
        if scene.refit.tolerance is None:
            scene.__dict__["refit"] = scene.refit.model_copy(update={"tolerance": thickness / 150.0})
        return scene

    @classmethod
    def faults(cls, given: Mapping[str, Any]) -> Iterator[Fault]:
        names: list[str] = []
        for kind in ("model", "tool"):
            for i, body in enumerate(entries(given, kind)):
                name = read(body, "name")
                if isinstance(name, str):
                    if name in names:
                        yield Fault((kind, i, "name"), f"name {shown(name)} is taken (every body has its own)")
                    names.append(name)
        if not any(_may_deform(given)):
            yield Fault(("model",), "nothing deforms (leave out rigid, or give a surface tool a material)")
        tables = given.get("material")
        materials = dict.fromkeys([*(tables if isinstance(tables, dict) else ()), *PRESETS])
        for place, material in _materials_named(given):
            if isinstance(material, str) and material not in materials:
                yield Fault(place, f"material {shown(material)} is not known {mend(material, materials)}")
        if any(read(tool, "control") == "force" for tool in entries(given, "tool")):
            for i, model in enumerate(entries(given, "model")):
                if read(model, "anchor") == "none":
                    yield Fault(
                        ("model", i, "anchor"),
                        'nothing holds it against the tools under control = "force" (use "base")',
                    )
        for i, expect in enumerate(entries(given, "expect")):
            pair = read(expect, "pair")
            if not isinstance(pair, (list, tuple)) or len(pair) != 2 or not {"model", "tool"} <= set(given):
                continue
            for j, name in enumerate(pair):
                if isinstance(name, str) and name and name not in names:
                    yield Fault(("expect", i, "pair", j), f"pair names {shown(name)}, no body {mend(name, names)}")
            if pair[0] == pair[1]:
                yield Fault(("expect", i, "pair"), "pair names one body twice")


def _may_deform(given: Mapping[str, Any]) -> Iterator[bool]:
    """Per body whether it is, or may be meant to be, of material."""
    models, tools = entries(given, "model"), entries(given, "tool")
    yield from (read(model, "rigid") is not True for model in models)
    yield from (read(tool, "material") is not None for tool in tools)
    yield not models


def _materials_named(given: Mapping[str, Any]) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    for i, model in enumerate(entries(given, "model")):
        yield ("model", i, "material"), read(model, "material")
        for j, zone in enumerate(entries(model, "zones")):
            yield ("model", i, "zones", j, "material"), read(zone, "material")
    for i, tool in enumerate(entries(given, "tool")):
        yield ("tool", i, "material"), read(tool, "material")
