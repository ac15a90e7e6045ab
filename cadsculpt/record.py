"""What a run hands out while it goes: frames for pictures, loads per step, contacts, and the lattice at the end.

Plain data, made by the run and written by the formats. Lengths are in the scene's unit, everything else is SI.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .collide.contacts import Contacts

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class PatchFrame:
    """One sculpted patch at one moment, on its grid of m x n parameters.

    name : the face's name. points (m, n, 3) : where the surface is now. displacement (m, n, 3) : how far it has moved
    from its rest shape, so that `points - displacement` is the rest shape. pressure (m, n) [Pa] : contact pressure.
    contact (m, n) : touched by a tool now. stress (m, n) [Pa] : of the lattice below. inside (m, n) : the vertices that
    lie on the trimmed face, or None when the face is the whole grid.
    """

    name: str
    points: Array
    displacement: Array
    pressure: Array
    contact: Flags
    stress: Array
    inside: Flags | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ToolFrame:
    """One tool at one moment, posed, as a mesh for pictures: points (k, 3), triangles (f, 3).

    displacement (k, 3) : how far a deformable one is pressed out of its shape, so that `points - displacement` is the tool
    as it would be if it were rigid. None of a rigid one.
    """

    name: str
    points: Array
    triangles: Index
    displacement: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """All sculpted patches and all tools at the end of step `step`, at `time` [s]."""

    step: int
    time: float
    patches: tuple[PatchFrame, ...]
    tools: tuple[ToolFrame, ...]


@dataclass(frozen=True, slots=True, eq=False)
class StepRecord:
    """The loads of one step, one row a tool (nt tools, in the scene's order).

    force (nt, 3) [N], torque (nt, 3) [N m] : the reaction on the tool, the torque about its own origin.
    contact_area (nt,) [unit^2], max_depth (nt,) [unit] : deepest contact found in the step. max_penetration (nt,)
    [unit] : what is left of it when the step is over.
    """

    step: int
    time: float
    force: Array
    torque: Array
    contact_area: Array
    max_depth: Array
    max_penetration: Array


@dataclass(frozen=True, slots=True, eq=False)
class ContactRecord:
    """The contacts of one step and the force (n, 3) [N] of each on its body a."""

    step: int
    time: float
    contacts: Contacts
    force: Array


@dataclass(frozen=True, slots=True, eq=False)
class LatticeFrame:
    """The hexahedral lattice under one face, of a deformable tool where it is in the world.

    name : the face's, of a tool "tool: face".
    nodes (N, 3) : positions. hexahedra (M, 8) : node indices, in VTK's order. strain (N,) : largest spring strain at
    the node. plastic (N,) : largest plastic set at the node, as a strain. material (M,) : index of the cell's material.
    active (M,) : the cells that belong to the body; the others lie beyond the trims.
    """

    name: str
    nodes: Array
    hexahedra: Index
    strain: Array
    plastic: Array
    material: Index
    active: Flags
