"""Patches that are integrated as one lattice: the faces of a body that are tied, and all of bodies that may meet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .encounters import Pairs, together
from .motion.pose import Pose
from .patch import Patch
from .physics.assembly import Assembly, assemble
from .physics.explicit import LatticeState
from .physics.lattice import Lattice
from .physics.seams import seam_ties
from .physics.ties import Ties
from .seams import Seam, seams_between

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Patches (by their numbers in the model) whose lattices move as one `assembly`, in the same order."""

    patches: tuple[int, ...]
    assembly: Assembly

    @property
    def lattice(self) -> Lattice:
        return self.assembly.lattice

    def nodes_of(self, patch: int) -> slice:
        """The nodes of one of its patches in the assembly."""
        return self.assembly.nodes_of(self.patches.index(patch))

    def state_of(self, state: LatticeState, patch: int) -> LatticeState:
        """The state of one of its patches: views into the group's."""
        return self.assembly.part_state(state, self.patches.index(patch))


def group_patches(patches: Sequence[Patch], pairs: Pairs) -> tuple[Group, ...]:
    """Every patch in one group, in the order of their first patches. Patches of bodies that may meet are together, and those
    of one body that are tied along an edge."""
    seams = seams_between(patches)
    of_body: dict[int, list[int]] = {}
    for i, patch in enumerate(patches):
        of_body.setdefault(patch.body, []).append(i)
    joined = [(seam.first, seam.second) for seam in seams]
    for a, b, meet in zip(pairs.a.tolist(), pairs.b.tolist(), pairs.meet.tolist(), strict=True):
        if meet and a in of_body and b in of_body:
            both = [*of_body[a], *of_body[b]]
            joined += [(both[0], other) for other in both[1:]]
    return tuple(_grouped(patches, tuple(group), seams) for group in together(len(patches), joined))


def _grouped(patches: Sequence[Patch], group: tuple[int, ...], seams: Sequence[Seam]) -> Group:
    parts, place = [patches[i].lattice for i in group], {i: k for k, i in enumerate(group)}
    ties = [
        seam_ties(parts, place[seam.first], seam.uv_first, place[seam.second], seam.uv_second)
        for seam in seams
        if seam.first in place
    ]
    return Group(group, assemble(parts, Ties.joined(ties) if ties else None))


def placed_nodes(group: Group, patches: Sequence[Patch], frames: Mapping[int, Pose]) -> Array:
    """Where the nodes (N, 3) of a group are in the world when nothing is deformed. frames : of the bodies that have a frame of
    their own."""
    parts = []
    for i in group.patches:
        nodes, frame = patches[i].lattice.nodes, frames.get(patches[i].body)
        parts.append(nodes if frame is None else frame.to_world(nodes))
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
