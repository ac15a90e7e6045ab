"""Explicit integration of the lattice (paper section 4.8, eq. 4 to 7) in sub-steps that are stable.

    m x'' + gamma x' + g = f                                                   (4)
    x''(t) = (f(t) - gamma x'(t) - g(t)) / m                                   (5)
    x'(t + h) = x'(t) + h x''(t)                                               (6)
    x(t + h) = x(t) + h x'(t + h)                                              (7)

(6) then (7) is the semi-implicit Euler rule, which keeps the energy of an undamped lattice bounded. It is stable while
h^2 omega^2 + 2 h gamma / m < 4 for every frequency omega. The contact forces in f are those at the sub-step's end
(forces.py), so that stiff contacts and friction do not shorten it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, SimulationError
from ..jit import njit_in_place
from .forces import local_nodes, press, rub
from .impulses import contact_rows, impel, meeting_nodes, touches
from .lattice import Lattice
from .rigid import ride
from .springs import fastest_stretch, spring_forces
from .stability import FRESH, FrequencyBound, farthest, highest_frequency
from .ties import gather, scatter
from .workspace import Workspace

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SAFETY = 0.82
"""Share of the bound at rest that the automatic sub-step takes. The bound is within a few percent of the limit itself; near
that the highest modes swing wide, and blows and friction are led by them."""

CLOSEST = 0.97
"""Share of the bound as the lattice is now that the automatic sub-step may take before it is cut."""

CUT = 0.9
"""The automatic sub-step is that at rest times a power of this: a symplectic rule whose step followed every small
motion would gain energy."""

MOST_STRETCH = 0.5
"""A spring that changes by this share of its length within one sub-step moves faster than sound in the material
does."""


@dataclass(slots=True, eq=False)
class LatticeState:
    """What moves: x (N, 3) [L], velocity (N, 3) [L/s], rest_length (13, N) [L], which plastic flow changes.

    bound : of the highest frequency, from which the length of sub-steps comes. workspace : the integrators' memory, no part
    of the state.
    """

    x: Array
    velocity: Array
    rest_length: Array
    bound: FrequencyBound
    workspace: Workspace = field(default_factory=Workspace, init=False)

    @classmethod
    def at_rest(cls, lattice: Lattice) -> LatticeState:
        """The lattice as it was built."""
        bound = FrequencyBound(lattice.highest_frequency, lattice.frequency_scale.copy(), lattice.nodes.copy())
        return cls(lattice.nodes.copy(), np.zeros_like(lattice.nodes), lattice.rest_length.copy(), bound)

    def copy(self) -> LatticeState:
        """A state of its own with the same values."""
        return LatticeState(self.x.copy(), self.velocity.copy(), self.rest_length.copy(), self.bound.copy())

    def arrays(self) -> dict[str, Array]:
        """The state as arrays by name, views where it can be."""
        bound = self.bound
        return {
            "x": self.x,
            "velocity": self.velocity,
            "rest_length": self.rest_length,
            "bound_square": np.array(bound.square),
            "bound_scale": bound.scale,
            "bound_seen": bound.seen,
        }

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, Array]) -> LatticeState:
        """The state that `arrays` gave, in copies. Raises KeyError."""
        x, velocity, rest, scale, seen = (
            np.array(arrays[name]) for name in ("x", "velocity", "rest_length", "bound_scale", "bound_seen")
        )
        return cls(x, velocity, rest, FrequencyBound(float(arrays["bound_square"]), scale, seen))


_NO_NODES: Index = np.zeros((0, 4), dtype=np.int64)
_NO_WEIGHTS: Array = np.zeros((0, 4))


@dataclass(frozen=True, slots=True, eq=False)
class ContactLoad:
    """n contacts that act on one lattice during one step.

    nodes, weights (n, 4) : from `node_weights`. normal (n, 3) : out of the model. depth (n,) : at the start of the
    step, negative while the tool is still away [L]. area (n,) [L^2]. velocity (n, 3) : the tool's at the contact
    [L/s]. stiffness, damping (n,) : k_n [N/L^3] and c_n [N s/L^3]. friction (n,) : mu.

    other_nodes, other_weights (n, 4) : the nodes of the same lattice (an assembly's) that carry the other side, and their
    weights; a contact whose other_weights are all 0 meets something rigid. Its velocity is then sum other_weights v + velocity.
    Both None: every contact meets something rigid.
    """

    nodes: Index
    weights: Array
    normal: Array
    depth: Array
    area: Array
    velocity: Array
    stiffness: Array
    damping: Array
    friction: Array
    other_nodes: Index | None = None
    other_weights: Array | None = None

    def others(self) -> tuple[Index, Array]:
        """other_nodes and other_weights, both (0, 4) where there are none."""
        if self.other_nodes is None or self.other_weights is None:
            return _NO_NODES, _NO_WEIGHTS
        return self.other_nodes, self.other_weights


@dataclass(frozen=True, slots=True, eq=False)
class StepForces:
    """What a step did: per contact the mean_force and end_force (n, 3) on the model [N], and the depth (n,) at its
    end [L]. The other side of a contact feels the exact opposite.

    The arrays of an explicit step are views of the state's workspace: they hold until its next step.

    max_speed : of any node at the end [L/s]. substep [s], substeps : how the step was cut.
    """

    mean_force: Array
    end_force: Array
    depth: Array
    max_speed: float
    substep: float
    substeps: int


def stable_substep(lattice: Lattice, state: LatticeState | None = None, *, safety: float = SAFETY) -> float:
    """The largest sub-step [s] for the lattice as it is in `state` (None: at rest), times `safety`.

    From a bound of the highest frequency (stability.py) and the damping; contacts do not enter it. Infinite for a lattice
    without a free node.
    """
    if state is None:
        return safety * _largest(lattice.highest_frequency, lattice.highest_drag)
    return safety * _largest(_bound(lattice, state).square, lattice.highest_drag)


def _largest(square: float, drag: float) -> float:
    """The largest stable sub-step [s] at a squared frequency and gamma / m."""
    bound = drag + math.sqrt(drag * drag + 4.0 * square)
    return 4.0 / bound if bound > 0.0 else math.inf


def _bound(lattice: Lattice, state: LatticeState) -> FrequencyBound:
    """The state's bound as long as no node has moved farther than FRESH, else the bound as it is now, in a copy."""
    if farthest(state.x, state.bound.seen) <= FRESH * lattice.shortest:
        return state.bound
    bound = state.bound.copy()
    _evaluate(lattice, state, bound)
    return bound


def _evaluate(lattice: Lattice, state: LatticeState, bound: FrequencyBound) -> None:
    """Bring a bound to where the lattice is now."""
    state.workspace.fit(lattice, 0)
    ties = lattice.ties
    bound.square = highest_frequency(
        lattice.segments, lattice.stiffness, state.rest_length, lattice.inverse_mass, state.x, bound.scale,
        state.workspace.scratch, ties.nodes, ties.start, ties.masters, ties.weights,
    )  # fmt: skip
    bound.seen[...] = state.x


def advance(
    lattice: Lattice,
    state: LatticeState,
    load: ContactLoad | None,
    dt: float,
    *,
    substep: float | None = None,
    external: Array | None = None,
    frame_velocity: Array | None = None,
) -> StepForces:
    """Integrate eq. 4 over dt seconds in equal sub-steps; `state` is changed in place.

    substep : the longest allowed, None for the automatic one, which is stable. external (N, 3) : further nodal forces
    [N], constant. During the step each contact's plane moves with its tool: depth(t) = depth + normal . (x_c(t) -
    x_c(0) - velocity t), and less by what a deformable other side moves.

    frame_velocity (N, 3) : the velocity [L/s] of the rigid body that carries each node, which gamma damps against; None
    where all that is held stands still. What nothing holds moves freely: gamma damps its deformation alone (rigid.py).

    Nothing is allocated once the workspace of the state has met as many contacts; the arrays returned are views of it.

    Raises InputError for a substep that is not stable, naming the largest that is, and SimulationError when the lattice
    moves faster than sound or a number overflows; the state is then as it was.
    """
    if not (math.isfinite(dt) and dt > 0.0):
        raise InputError(f"a step of {dt} s", mend="a step takes a positive time")
    if not farthest(state.x, state.bound.seen) <= FRESH * lattice.shortest:
        _evaluate(lattice, state, state.bound)
    largest = _largest(state.bound.square, lattice.highest_drag)
    if not largest > 0.0:
        raise SimulationError(_NOT_FINITE, mend=_CALMER)
    if substep is not None and not 0.0 < substep <= largest:
        raise InputError(f"a sub-step of {substep:g} s", mend=f"the largest that is stable here is {largest:.4g} s")
    longest = substep
    if longest is None:
        longest = stable_substep(lattice)
        while dt / _pieces(dt, longest) > CLOSEST * largest:
            longest *= CUT
    count = _pieces(dt, longest)
    if load is None:
        load = NO_LOAD
    contacts, work, ties = len(load.nodes), state.workspace, lattice.ties
    work.fit(lattice, contacts)
    other_nodes, other_weights = load.others()
    depth, mean_force, end_force = work.depth[:contacts], work.mean_force[:contacts], work.end_force[:contacts]
    depth[:] = load.depth
    outcome, max_speed = _advance(
        lattice.segments,
        lattice.stiffness,
        lattice.rest_length,
        lattice.yield_strain,
        lattice.hardening,
        lattice.plastic,
        lattice.inverse_mass,
        lattice.gamma,
        lattice.free,
        ties.row,
        ties.nodes,
        ties.start,
        ties.masters,
        ties.weights,
        _NO_FIELD if external is None else np.ascontiguousarray(external, dtype=np.float64),
        _NO_FIELD if frame_velocity is None else np.ascontiguousarray(frame_velocity, dtype=np.float64),
        state.x,
        state.velocity,
        state.rest_length,
        load.nodes,
        load.weights,
        other_nodes,
        other_weights,
        load.normal,
        load.area,
        load.stiffness,
        load.damping,
        load.friction,
        load.velocity,
        depth,
        mean_force,
        end_force,
        work.scratch,
        work.place,
        work.rest,
        work.rigid,
        work.distinct,
        work.local,
        work.impulse,
        work.marks,
        work.nodal,
        work.pressing,
        work.rubbing,
        work.mobility,
        work.start,
        work.node,
        work.local_rows,
        work.weight,
        work.moving,
        lattice.shortest,
        dt / count,
        count,
    )
    if outcome != _DONE:
        raise SimulationError(_SUPERSONIC if outcome == _TOO_FAST else _NOT_FINITE, mend=_CALMER)
    return StepForces(mean_force, end_force, depth, max_speed, dt / count, count)


def _pieces(dt: float, longest: float) -> int:
    """How many equal sub-steps, none longer than `longest`."""
    return max(1, math.ceil(dt / longest * (1.0 - 1e-12)))


_NOT_FINITE = "the lattice's positions are no longer finite"
_SUPERSONIC = "parts of the lattice move faster than sound does in the material"
_CALMER = "reduce the step, the tool's speed or the depth it presses to"
_DONE, _TOO_FAST, _LOST = 0, 1, 2

_NO_FIELD: Array = np.zeros((0, 3))
NO_LOAD = ContactLoad(
    np.zeros((0, 4), dtype=np.int64),
    np.zeros((0, 4)),
    np.zeros((0, 3)),
    np.zeros(0),
    np.zeros(0),
    np.zeros((0, 3)),
    np.zeros(0),
    np.zeros(0),
    np.zeros(0),
)


@njit_in_place
def _advance(
    segments: Index,
    stiffness: Array,
    initial_length: Array,
    yield_strain: Array,
    hardening: Array,
    plastic: bool,
    inverse_mass: Array,
    gamma: Array,
    free: Index,
    tie_row: Index,
    tied: Index,
    tie_start: Index,
    masters: Index,
    tie_weights: Array,
    external: Array,
    frame_velocity: Array,
    x0: Array,
    velocity0: Array,
    rest_length: Array,
    nodes: Index,
    weights: Array,
    other_nodes: Index,
    other_weights: Array,
    normal: Array,
    area: Array,
    contact_stiffness: Array,
    contact_damping: Array,
    friction: Array,
    tool: Array,
    depth: Array,
    mean_force: Array,
    end_force: Array,
    scratch: Array,
    place: Index,
    rest_before: Array,
    rigid: Array,
    distinct_space: Index,
    local_space: Index,
    impulse: Array,
    marks: NDArray[np.bool_],
    nodal_space: Array,
    pressing: Array,
    rubbing: Array,
    mobility: Array,
    start: Index,
    node: Index,
    local_rows: Index,
    weight: Array,
    moving_space: Array,
    shortest: float,
    h: float,
    count: int,
) -> tuple[int, float]:
    """`count` sub-steps of h seconds: how they ended (_DONE: with the new state in x0, velocity0 and rest_length) and the
    largest speed at the end.
    """
    size, contacts = len(inverse_mass), len(nodes)
    x, v, f, work = scratch[0:3], scratch[3:6], scratch[6:9], scratch[9:12]
    for a in range(3):
        x[a, 0] = x[a, size + 1] = v[a, 0] = v[a, size + 1] = 0.0
        for n in range(size):
            x[a, n + 1] = x0[n, a]
            v[a, n + 1] = velocity0[n, a]
    scatter(tied, tie_start, masters, tie_weights, v)
    if plastic:
        _copy(rest_length, rest_before)
    mean_force[:] = 0.0
    in_turns = len(other_nodes) > 0 or touches(nodes, tie_row)
    met = 0
    contact_rows(
        nodes, weights, other_nodes, other_weights, tie_row, tie_start, masters, tie_weights, start, node, weight
    )
    if in_turns:
        for c in range(contacts):
            # the first guess: what presses while nothing moves
            pressing[c] = h * area[c] * contact_stiffness[c] * max(0.0, depth[c])
            for a in range(3):
                rubbing[c, a] = 0.0
        met = meeting_nodes(start, node, contacts, place, distinct_space, local_rows)
    elif contacts:
        met = local_nodes(nodes, place, distinct_space, local_space)
    distinct, local, nodal = distinct_space[:met], local_space[:contacts], nodal_space[:met]
    moving = moving_space[:met]

    for _ in range(count):
        for a in range(3):
            f[a, :] = 0.0
        for n in range(len(external)):
            for a in range(3):
                f[a, n + 1] = external[n, a]
        spring_forces(segments, stiffness, initial_length, yield_strain, hardening, plastic, x, rest_length, f, work)
        for n in range(len(frame_velocity)):
            for a in range(3):
                f[a, n + 1] += gamma[n] * frame_velocity[n, a]
        ride(free, gamma, frame_velocity, x, v, f, rigid)
        gather(tied, tie_start, masters, tie_weights, f)
        for a in range(3):
            _accelerate(f[a, 1 : size + 1], gamma, inverse_mass, h, v[a, 1 : size + 1])
        if in_turns:
            impel(
                distinct, start, local_rows, weight, normal, area, contact_stiffness, contact_damping, friction, tool, depth,
                inverse_mass, h, v, pressing, rubbing, mobility, moving,
            )  # fmt: skip
        elif contacts:
            # f now holds the velocities before the sub-step
            press(
                distinct, local, weights, normal, area, contact_stiffness, contact_damping, tool, depth, inverse_mass,
                h, f, v, nodal, marks, impulse,
            )  # fmt: skip
            rub(distinct, local, normal, tool, friction, inverse_mass, impulse, v, nodal, rubbing)
        scatter(tied, tie_start, masters, tie_weights, v)
        for a in range(3):
            _move(v[a], h, x[a])
        for c in range(contacts):
            if not in_turns:
                pressing[c] = impulse[c, 0] + impulse[c, 1] + impulse[c, 2] + impulse[c, 3]
            for a in range(3):
                relative = -tool[c, a]
                for r in range(start[c], start[c + 1]):
                    relative += weight[r] * v[a, node[r] + 1]
                depth[c] += h * relative * normal[c, a]
                end_force[c, a] = (rubbing[c, a] - pressing[c] * normal[c, a]) / h
                mean_force[c, a] += end_force[c, a] / count

    square = 0.0
    finite = True
    for n in range(1, size + 1):
        square = max(square, v[0, n] * v[0, n] + v[1, n] * v[1, n] + v[2, n] * v[2, n])
        for a in range(3):
            finite = finite and math.isfinite(x[a, n]) and math.isfinite(v[a, n])
    finite = finite and square < math.inf
    # no spring stretches faster than its ends move, one against the other
    fast = 2.0 * math.sqrt(square) * h > MOST_STRETCH * shortest
    if not finite or (fast and fastest_stretch(segments, stiffness, initial_length, v) * h > MOST_STRETCH):
        if plastic:
            _copy(rest_before, rest_length)
        return _TOO_FAST if finite else _LOST, 0.0
    for n in range(size):
        for a in range(3):
            x0[n, a] = x[a, n + 1]
            velocity0[n, a] = v[a, n + 1]
    return _DONE, math.sqrt(square)


@njit_in_place
def _copy(source: Array, target: Array) -> None:
    # element by element: an assignment of arrays would bring numba's own error messages along, two seconds to compile
    for d in range(source.shape[0]):
        for n in range(source.shape[1]):
            target[d, n] = source[d, n]


@njit_in_place
def _accelerate(force: Array, gamma: Array, inverse_mass: Array, h: float, velocity: Array) -> None:
    """Eq. 5 and 6; `force` is left with the velocity before. Nodes of inverse mass 0 keep theirs."""
    for n in range(len(velocity)):
        old = velocity[n]
        velocity[n] = old + h * inverse_mass[n] * (force[n] - gamma[n] * old)
        force[n] = old


@njit_in_place
def _move(velocity: Array, h: float, x: Array) -> None:
    """Eq. 7."""
    for n in range(len(x)):
        x[n] += h * velocity[n]
