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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, SimulationError
from ..jit import njit
from .forces import local_nodes, press, rub
from .lattice import Lattice
from .springs import SCRATCH_ROWS, fastest_stretch, highest_frequency, spring_forces

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SAFETY = 0.9
"""Share of the bound at rest that the automatic sub-step takes."""

CLOSEST = 0.97
"""Share of the bound as the lattice is now that the automatic sub-step may take before it is cut."""

CUT = 0.84
"""The automatic sub-step is that at rest times a power of this: a symplectic rule whose step followed every small
motion would gain energy."""

MOST_STRETCH = 0.5
"""A spring that changes by this share of its length within one sub-step moves faster than sound in the material
does."""


@dataclass(slots=True, eq=False)
class LatticeState:
    """What moves: x (N, 3) [L], velocity (N, 3) [L/s], rest_length (13, N) [L], which plastic flow changes.

    scratch : the kernel's working memory, no part of the state.
    """

    x: Array
    velocity: Array
    rest_length: Array
    scratch: Array

    @classmethod
    def at_rest(cls, lattice: Lattice) -> LatticeState:
        """The lattice as it was built."""
        return cls(
            lattice.nodes.copy(),
            np.zeros_like(lattice.nodes),
            lattice.rest_length.copy(),
            np.zeros((SCRATCH_ROWS, len(lattice.nodes) + 2)),
        )

    def copy(self) -> LatticeState:
        """A state of its own with the same values."""
        return LatticeState(self.x.copy(), self.velocity.copy(), self.rest_length.copy(), self.scratch.copy())


@dataclass(frozen=True, slots=True, eq=False)
class ContactLoad:
    """n contacts that act on one lattice during one step.

    nodes, weights (n, 4) : from `node_weights`. normal (n, 3) : out of the model. depth (n,) : at the start of the
    step, negative while the tool is still away [L]. area (n,) [L^2]. velocity (n, 3) : the tool's at the contact
    [L/s]. stiffness, damping (n,) : k_n [N/L^3] and c_n [N s/L^3]. friction (n,) : mu.
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


@dataclass(frozen=True, slots=True, eq=False)
class StepForces:
    """What a step did: per contact the mean_force and end_force (n, 3) on the model [N], and the depth (n,) at its
    end [L].

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

    From a bound of the highest frequency (springs.highest_frequency) and the damping; contacts do not enter it.
    Infinite for a lattice without a free node.
    """
    square = lattice.highest_frequency
    if state is not None:
        square = highest_frequency(
            lattice.segments, lattice.stiffness, state.rest_length, lattice.inverse_mass, state.x, state.scratch
        )
    drag = float((lattice.gamma * lattice.inverse_mass).max())
    bound = drag + math.sqrt(drag * drag + 4.0 * square)
    return safety * 4.0 / bound if bound > 0.0 else math.inf


def advance(
    lattice: Lattice,
    state: LatticeState,
    load: ContactLoad | None,
    dt: float,
    *,
    substep: float | None = None,
    external: Array | None = None,
) -> StepForces:
    """Integrate eq. 4 over dt seconds in equal sub-steps; `state` is changed in place.

    substep : the longest allowed, None for the automatic one, which is stable. external (N, 3) : further nodal forces
    [N], constant. During the step each contact's plane moves with its tool: depth(t) = depth + normal . (x_c(t) -
    x_c(0) - velocity t).

    Raises InputError for a substep that is not stable, naming the largest that is, and SimulationError when the lattice
    moves faster than sound or a number overflows; the state is then as it was.
    """
    if not (math.isfinite(dt) and dt > 0.0):
        raise InputError(f"a step of {dt} s", mend="a step takes a positive time")
    largest = stable_substep(lattice, state, safety=1.0)
    if not largest > 0.0:
        raise SimulationError(_NOT_FINITE, mend=_CALMER)
    if substep is not None and not 0.0 < substep <= largest:
        raise InputError(f"a sub-step of {substep:g} s", mend=f"the largest that is stable here is {largest:.4g} s")
    longest = substep
    if longest is None:
        longest = stable_substep(lattice)
        while longest > CLOSEST * largest:
            longest *= CUT
    count = max(1, math.ceil(dt / longest * (1.0 - 1e-12)))
    if load is None:
        load = NO_LOAD
    contacts = len(load.nodes)
    depth = np.array(load.depth, dtype=np.float64)
    mean_force, end_force = np.zeros((contacts, 3)), np.zeros((contacts, 3))
    rest_before = state.rest_length.copy() if lattice.plastic else None
    _advance(
        lattice.segments,
        lattice.stiffness,
        lattice.rest_length,
        lattice.yield_strain,
        lattice.hardening,
        lattice.plastic,
        lattice.inverse_mass,
        lattice.gamma,
        _NO_FORCE if external is None else np.ascontiguousarray(external, dtype=np.float64),
        state.x,
        state.velocity,
        state.rest_length,
        state.scratch,
        load.nodes,
        load.weights,
        load.normal,
        load.area,
        load.stiffness,
        load.damping,
        load.friction,
        load.velocity,
        depth,
        mean_force,
        end_force,
        dt / count,
        count,
    )
    nodes = len(lattice.nodes)
    velocity = np.ascontiguousarray(state.scratch[3:6, 1 : nodes + 1].T)
    max_speed = math.sqrt(float(np.einsum("nc,nc->n", velocity, velocity).max()))
    stretch = fastest_stretch(lattice.segments, lattice.stiffness, lattice.rest_length, velocity) * dt / count
    finite = bool(np.isfinite(max_speed) and np.isfinite(state.scratch[0:3]).all())
    if not (finite and stretch <= MOST_STRETCH):
        if rest_before is not None:
            state.rest_length[:] = rest_before
        raise SimulationError(_SUPERSONIC if finite else _NOT_FINITE, mend=_CALMER)
    state.x[:] = state.scratch[0:3, 1 : nodes + 1].T
    state.velocity[:] = velocity
    return StepForces(mean_force, end_force, depth, max_speed, dt / count, count)


_NOT_FINITE = "the lattice's positions are no longer finite"
_SUPERSONIC = "parts of the lattice move faster than sound does in the material"
_CALMER = "reduce the step, the tool's speed or the depth it presses to"

_NO_FORCE: Array = np.zeros((0, 3))
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


@njit
def _advance(
    segments: Index,
    stiffness: Array,
    initial_length: Array,
    yield_strain: Array,
    hardening: Array,
    plastic: bool,
    inverse_mass: Array,
    gamma: Array,
    external: Array,
    x0: Array,
    velocity0: Array,
    rest_length: Array,
    scratch: Array,
    nodes: Index,
    weights: Array,
    normal: Array,
    area: Array,
    contact_stiffness: Array,
    contact_damping: Array,
    friction: Array,
    tool: Array,
    depth: Array,
    mean_force: Array,
    end_force: Array,
    h: float,
    count: int,
) -> None:
    """`count` sub-steps of h seconds. The new positions and velocities are left in rows 0 to 2 and 3 to 5 of
    scratch.
    """
    size = len(inverse_mass)
    contacts = len(nodes)
    x, v, f, work = scratch[0:3], scratch[3:6], scratch[6:9], scratch[9:11]
    for a in range(3):
        x[a, 0] = x[a, size + 1] = 0.0
        for n in range(size):
            x[a, n + 1] = x0[n, a]
            v[a, n + 1] = velocity0[n, a]
    distinct, local = local_nodes(nodes, size)
    nodal, marks = np.empty((len(distinct), 12)), np.empty((contacts, 4), dtype=np.bool_)
    impulse, rubbing = np.empty((contacts, 4)), np.empty((contacts, 3))

    for _ in range(count):
        for a in range(3):
            f[a, :] = 0.0
        for n in range(len(external)):
            for a in range(3):
                f[a, n + 1] = external[n, a]
        spring_forces(segments, stiffness, initial_length, yield_strain, hardening, plastic, x, rest_length, f, work)
        for a in range(3):
            _accelerate(f[a, 1 : size + 1], gamma, inverse_mass, h, v[a, 1 : size + 1])
        if contacts:
            # f now holds the velocities before the sub-step
            press(
                distinct, local, weights, normal, area, contact_stiffness, contact_damping, tool, depth, inverse_mass,
                h, f, v, nodal, marks, impulse,
            )  # fmt: skip
            rub(distinct, local, normal, tool, friction, inverse_mass, impulse, v, nodal, rubbing)
        for a in range(3):
            _move(v[a], h, x[a])
        for c in range(contacts):
            total = impulse[c, 0] + impulse[c, 1] + impulse[c, 2] + impulse[c, 3]
            for a in range(3):
                relative = -tool[c, a]
                for k in range(4):
                    relative += weights[c, k] * v[a, nodes[c, k] + 1]
                depth[c] += h * relative * normal[c, a]
                end_force[c, a] = (rubbing[c, a] - total * normal[c, a]) / h
                mean_force[c, a] += end_force[c, a] / count


@njit
def _accelerate(force: Array, gamma: Array, inverse_mass: Array, h: float, velocity: Array) -> None:
    """Eq. 5 and 6; `force` is left with the velocity before. Nodes of inverse mass 0 keep theirs."""
    for n in range(len(velocity)):
        old = velocity[n]
        velocity[n] = old + h * inverse_mass[n] * (force[n] - gamma[n] * old)
        force[n] = old


@njit
def _move(velocity: Array, h: float, x: Array) -> None:
    """Eq. 7."""
    for n in range(len(x)):
        x[n] += h * velocity[n]
