"""Several lattices as one: bodies that meet, and the faces of one body.

The kernels know nodes, and springs as runs of constant shift, not where a lattice ends. Lattices whose arrays stand one
behind the other are therefore one lattice; its nodes are numbered part by part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .explicit import LatticeState
from .lattice import Lattice
from .stability import FrequencyBound, largest_drag, least_bound
from .ties import NO_TIES, TiedNodes, Ties, bodies, condensed, resolve

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Assembly:
    """`parts` as one `lattice`, whose node starts[k] + n is node n of parts[k].

    Of one part without ties, `lattice` is that part itself. Of several it has no grid: shape (N, 1, 1), no u, v and cells; its
    `spacing` and `thickness` are the parts' smallest. Ask the parts for what needs a grid (`node_weights`, `hexahedra`).
    Tied nodes have neither mass nor damping of their own in `lattice` (their masters have it) but in their part.
    """

    lattice: Lattice
    parts: tuple[Lattice, ...]
    starts: tuple[int, ...]

    @property
    def ties(self) -> TiedNodes:
        """The nodes that follow others, resolved."""
        return self.lattice.ties

    def nodes_of(self, k: int) -> slice:
        """The nodes of part k in the assembly."""
        return slice(self.starts[k], self.starts[k] + len(self.parts[k].nodes))

    def part_state(self, state: LatticeState, k: int) -> LatticeState:
        """The state of part k: views into the assembly's, to read, measure and draw with parts[k]."""
        mine = self.nodes_of(k)
        bound = FrequencyBound(state.bound.square, state.bound.scale[mine], state.bound.seen[mine])
        return LatticeState(state.x[mine], state.velocity[mine], state.rest_length[:, mine], bound)


def assemble(parts: Sequence[Lattice], ties: Ties | None = None) -> Assembly:
    """One lattice of all parts. ties : nodes of theirs that follow others (`seam_ties`, `Ties.joined`).

    A tied node that is anchored anchors its masters, and one whose masters are all anchored is held by them: a seam is held
    on both sides or on none. Held nodes keep the velocity that they are given, tied ones get that of their masters: give all
    nodes that `lattice.anchored` names theirs.

    Raises InputError for no part, parts in different units, and ties that are wrong.
    """
    parts = tuple(parts)
    if not parts:
        raise InputError("an assembly of no lattice")
    units = {part.metres_per_unit for part in parts}
    if len(units) > 1:
        raise InputError(f"lattices in different units: {', '.join(f'{u:g} m' for u in sorted(units))}")
    ends = np.cumsum([len(part.nodes) for part in parts])
    starts = tuple(int(n) for n in (0, *ends[:-1]))
    active = np.concatenate([part.active for part in parts])
    tied = NO_TIES if ties is None else resolve(ties, active)
    if len(parts) == 1 and tied is NO_TIES:
        return Assembly(parts[0], parts, starts)

    count = int(ends[-1])
    anchored = np.concatenate([part.anchored for part in parts])
    if len(tied.nodes):
        # the longest way from one tie to the next is one step: masters follow nothing
        held = np.repeat(anchored[tied.nodes], np.diff(tied.start))
        anchored[tied.masters[held]] = True
    mass = condensed(np.concatenate([part.mass for part in parts]), tied)
    inverse_mass = np.zeros(count)
    free = active & ~anchored & (mass > 0.0)
    inverse_mass[free] = 1.0 / mass[free]
    lattice = replace(
        parts[0],
        shape=(count, 1, 1),
        wrap=(False, False),
        u=np.zeros(0),
        v=np.zeros(0),
        period=(0.0, 0.0),
        anchored=anchored,
        active=active,
        mass=mass,
        gamma=condensed(np.concatenate([part.gamma for part in parts]), tied),
        inverse_mass=inverse_mass,
        cell_active=np.zeros((0, 0), dtype=np.bool_),
        cell_material=np.zeros((0, 0, 0), dtype=np.int64),
        thickness=min(part.thickness for part in parts),
        spacing=min(part.spacing for part in parts),
        plastic=any(part.plastic for part in parts),
        right_handed=all(part.right_handed for part in parts),
        segments=np.concatenate(
            [part.segments + np.array([0, n, n, 0]) for part, n in zip(parts, starts, strict=True)]
        ),
        highest_frequency=math.nan,
        ties=tied,
        grids=tuple((n, part.shape, part.wrap) for n, part in zip(starts, parts, strict=True)),
        free=_free_bodies(starts, count, tied, anchored & active),
        nodes=np.concatenate([part.nodes for part in parts]),
        volume=np.concatenate([part.volume for part in parts]),
        stiffness=np.concatenate([part.stiffness for part in parts], axis=1),
        rest_length=np.concatenate([part.rest_length for part in parts], axis=1),
        yield_strain=np.concatenate([part.yield_strain for part in parts], axis=1),
        hardening=np.concatenate([part.hardening for part in parts], axis=1),
    )
    if len(tied.nodes):
        square, scale = least_bound(
            lattice.segments, lattice.stiffness, lattice.rest_length, inverse_mass, lattice.nodes, tied
        )
    else:
        square = max(part.highest_frequency for part in parts)
        scale = np.concatenate([part.frequency_scale for part in parts])
    lattice = replace(
        lattice,
        highest_frequency=square,
        frequency_scale=scale,
        highest_drag=largest_drag(lattice.gamma, inverse_mass),
        shortest=min(part.shortest for part in parts),
    )
    return Assembly(lattice, parts, starts)


def _free_bodies(starts: Sequence[int], count: int, tied: TiedNodes, held: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Lattice.free of parts that start at these nodes, of `count` nodes together."""
    of_part = bodies(starts, tied)
    ranges = list(zip(of_part, starts, [*starts[1:], count], strict=True))
    anchored = {body for body, start, stop in ranges if held[start:stop].any()}
    rows = [row for row in ranges if row[0] not in anchored]
    return np.array(sorted(rows), dtype=np.int64).reshape(-1, 3)
