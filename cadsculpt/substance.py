"""What a deformable body is made of, and where it is held: of a [[model]] or of a [[tool]]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from .errors import InputError
from .scene import ModelSpec, Zone
from .scene_tool import ToolSpec
from .scene_values import Anchor, Spacing

TOOL_LAYERS = 3
"""Cells through the thickness of a tool that does not say how many, as of a model."""


@dataclass(frozen=True, slots=True, eq=False)
class Substance:
    """The keys of a scene that a face's lattice is built from; lengths in the scene's unit.

    anchor : a tool's `hold`. edges : whether faces stay put where they meet others that are not of the body.
    outward : None where the file says it.
    """

    thickness: float
    nodes: Spacing
    layers: int
    material: str
    anchor: Anchor
    edges: Literal["held", "free"]
    zones: tuple[Zone, ...] = ()
    outward: bool | None = None

    @classmethod
    def of_model(cls, spec: ModelSpec) -> Substance | None:
        """That of a model; None for a rigid one."""
        if spec.rigid:
            return None
        if spec.thickness is None or spec.nodes is None or spec.material is None:
            raise InputError("a model of material needs thickness, nodes and material", where=f"model {spec.name!r}")
        return cls(
            spec.thickness, spec.nodes, spec.layers, spec.material, spec.anchor, spec.edges, spec.zones, spec.outward
        )

    @classmethod
    def of_tool(cls, spec: ToolSpec) -> Substance | None:
        """That of a tool; None for a rigid one. Where its faces meet others of its file there is nothing to stay with."""
        if spec.material is None:
            return None
        if spec.thickness is None or spec.nodes is None:
            raise InputError("a deformable tool needs thickness and nodes", where=f"tool {spec.name!r}")
        return cls(spec.thickness, spec.nodes, spec.layers or TOOL_LAYERS, spec.material, spec.hold or "base", "free")
