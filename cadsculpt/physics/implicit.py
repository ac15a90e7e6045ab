"""Implicit integration of the lattice (paper section 4.8, eq. 4) for stiff material and long steps.

Backward Euler takes all forces at the step's end,

    m (v - v0) / h + gamma v + g(x) = f(x, v),    v = (x - x0) / h,

and its quasi-static limit leaves the first two terms out: the lattice is at rest in every step. Springs flow by return
mapping from the rest lengths at the step's start. A contact of area A presses and rubs as in forces.py, at the
interpolated point itself,

    p = A max(0, k_n d + c_n d'),    f_t = -mu p t / |t|,

t being its slip along the tool within the step, |t| measured as sqrt(t^2 + s^2) with s = SLIP of the node spacing, so that
the force has a derivative: a contact that sticks creeps by less than that in a step.

Newton's method solves for x. Flow and friction, which turn round at a limit, are solved by the primal-dual method (Chan,
Golub, Mulet 1999, A nonlinear primal-dual method for total variation): the spring's stress and the direction of friction are
followed as unknowns of their own, eliminated from the linear system. Plain Newton iterations overshoot there by the ratio
of the stiffness below the limit to that beyond it, a thousand and more; these do not, and become Newton's at the end, with
the exact tangent of springs, flow, pressure and sliding. Only the change of friction with the pressure is left out, which
would make the matrix unsymmetric. Where K is not positive definite (a plate about to buckle) the sideways push of
compressed springs is left out too (Teran et al. 2005, Robust quasistatic finite elements and flesh simulation). A
correction is shortened until the work of the residual along it does not turn over.

Converged means: the residual is at most RESIDUAL of the forces at work, and the last correction, before it was shortened,
at most CORRECTION of the node spacing. What does not converge in ITERATIONS is tried in halves, down to 1 / 2^HALVINGS of
the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, SimulationError
from .coarse import CoarseSpace
from .explicit import MOST_STRETCH, NO_LOAD, ContactLoad, LatticeState, StepForces
from .impulses import contact_rows, touches
from .lattice import Lattice
from .numbering import Numbering
from .rigid import body_modes, rigid_flight
from .springs import fastest_stretch, spring_tangents
from .tangent import Tangent, banded, one_blas_thread, solve
from .ties import carried, condensed

Array = NDArray[np.float64]
Index = NDArray[np.int64]

RESIDUAL = 1e-6
"""Residual, over the forces at work (2-norms over the nodes), at which a step has converged: 1e-6 of a force is less than any
of the model's own errors."""

CORRECTION = 1e-5
"""Share of the node spacing that the last correction may move a node by."""

ROUNDING = 1e-13
"""Residual, over the forces that stretch every spring by its length, that is rounding: a lattice at rest has converged."""

ITERATIONS = 60
"""Corrections per sub-step; elastic steps take 3 to 8, contact with friction and flow 10 to 25, metals more."""

HALVINGS = 6
"""How often a step that does not converge is cut in two."""

SHORTENINGS = 8
"""How often one correction is shortened."""

FARTHEST = 0.3
"""Of the shortest spring: how far one correction may move a node. Springs must not turn over on the way."""

SLIP = 1e-6
"""Of the node spacing: the slip within a step at which friction has reached 0.7 of its limit (0.995 at ten times that). Far
less than any motion that matters; the primal-dual method takes no more iterations for it than for a hundred times that."""


def advance_implicit(
    lattice: Lattice,
    state: LatticeState,
    load: ContactLoad | None,
    dt: float,
    *,
    quasi_static: bool = False,
    substep: float | None = None,
    external: Array | None = None,
    frame_velocity: Array | None = None,
) -> StepForces:
    """Integrate eq. 4 over dt seconds by backward Euler; `state` is changed in place.

    quasi_static : inertia and damping left out; a velocity is then the displacement over the time. substep : the longest
    allowed, None for dt. external (N, 3) : further nodal forces [N], constant. Held nodes keep the velocity they are
    given, contact planes move, and gamma damps against frame_velocity (N, 3), as in `explicit.advance`.

    Raises InputError for a time that is not positive and for a quasi-static lattice that nothing holds, SimulationError
    when it does not converge; the state is then as it was.
    """
    if not (math.isfinite(dt) and dt > 0.0):
        raise InputError(f"a step of {dt} s", mend="a step takes a positive time")
    if substep is not None and not substep > 0.0:
        raise InputError(f"a sub-step of {substep:g} s", mend="it must be a positive number")
    if quasi_static and len(lattice.free):
        raise InputError("a quasi-static body that nothing holds", mend="anchor it, or leave quasi_static out")
    load = NO_LOAD if load is None else load
    if not (np.isfinite(state.x).all() and np.isfinite(state.velocity).all()):
        raise SimulationError("the lattice's positions are no longer finite", mend=_CALMER)
    count = 1 if substep is None else max(1, math.ceil(dt / substep * (1.0 - 1e-12)))
    nodes = _both_sides(lattice, load)[0]
    numbering = Numbering.of(lattice, nodes, state.x)
    coarse = None if banded(numbering) else CoarseSpace.of(lattice, numbering.place, nodes)
    now = state.copy()
    now.workspace = state.workspace
    now.velocity = carried(now.velocity, lattice.ties)
    depth = np.array(load.depth, dtype=np.float64)
    mean_force = end_force = np.zeros((len(depth), 3))
    finest = 2**HALVINGS
    done, size, steps = 0, finest, 0  # in units of the finest sub-step
    while done < count * finest:
        h = dt / count * size / finest
        problem = _Problem.at(
            lattice, now, load, depth, h, quasi_static=quasi_static, external=external, frame_velocity=frame_velocity
        )
        try:
            with one_blas_thread():
                found = _newton(problem, numbering, coarse)
        except _NoConvergenceError as failure:
            if size == 1:
                raise SimulationError(
                    f"the implicit step of {dt:.3g} s did not converge: in a sub-step of {h:.3g} s the residual was "
                    f"{failure.ratio:.2g} of the forces at work after {failure.iterations} iterations",
                    mend=_CALMER,
                ) from None
            size //= 2
            continue
        moved = problem.moves.copy()
        moved[lattice.ties.nodes] = True
        now.velocity[moved] = ((found.x - now.x) / h)[moved]
        now.x, now.rest_length = found.x, found.rest_length
        depth, end_force = found.depth, found.contact_force
        mean_force = mean_force + (h / dt) * end_force
        done, steps = done + size, steps + 1
        if size < finest and done % (2 * size) == 0:
            size *= 2
    for mine, new in zip(
        (state.x, state.velocity, state.rest_length), (now.x, now.velocity, now.rest_length), strict=True
    ):
        mine[:] = new
    max_speed = math.sqrt(float(np.einsum("nc,nc->n", state.velocity, state.velocity).max()))
    return StepForces(mean_force, end_force, depth, max_speed, dt / steps, steps)


_CALMER = "reduce the step, the tool's speed or the depth it presses to"


def _both_sides(lattice: Lattice, load: ContactLoad) -> tuple[Index, Array]:
    """Nodes and weights (n, w) whose weighted mean velocity is that of the model against a deformable other side: the
    others' count negative, masters stand in place of tied nodes.
    """
    other_nodes, other_weights = load.others()
    ties = lattice.ties
    if not len(other_nodes) and not touches(load.nodes, ties.row):
        return load.nodes, load.weights
    count, most = len(load.nodes), 8 * ties.most
    start, node = np.zeros(count + 1, dtype=np.int64), np.zeros(most * count, dtype=np.int64)
    weight = np.zeros(most * count)
    contact_rows(
        load.nodes, load.weights, other_nodes, other_weights, ties.row, ties.start, ties.masters, ties.weights,
        start, node, weight,
    )  # fmt: skip
    lengths = np.diff(start)
    nodes = np.repeat(load.nodes[:, :1], lengths.max(initial=1), axis=1)
    if len(ties.nodes):
        # what stands in a place that is not filled has no weight; it must not be tied
        nodes[lengths > 0] = node[start[:-1][lengths > 0], None]
    weights = np.zeros(nodes.shape)
    filled = np.arange(nodes.shape[1]) < lengths[:, None]
    nodes[filled], weights[filled] = node[: start[-1]], weight[: start[-1]]
    return nodes, weights


class _NoConvergenceError(Exception):
    """Newton's method gave up: the residual over the forces at work, after how many iterations."""

    def __init__(self, ratio: float, iterations: int) -> None:
        super().__init__()
        self.ratio, self.iterations = ratio, iterations


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """One sub-step of h seconds from `start`: what does not change while it is solved.

    nodes, weights (n, w) : of `_both_sides`. depth (n,) : at its start. inertia, drag (N,) : m / h and gamma (0 when
    quasi-static). first (N, 3) : where Newton's method begins: start.x, held nodes where they end, free bodies where they
    fly to. moves (N,) : the free nodes. rounding : force [N] that is rounding. reach, slip : FARTHEST and SLIP in L.
    frame (N, 3) : what drag acts against; less what it would do to free bodies as a whole, by modes and core (`Tangent`).
    """

    lattice: Lattice
    start: LatticeState
    load: ContactLoad
    nodes: Index
    weights: Array
    depth: Array
    h: float
    inertia: Array
    drag: Array
    damping: Array
    external: Array
    first: Array
    moves: NDArray[np.bool_]
    rounding: float
    reach: float
    slip: float
    frame: Array
    modes: Array
    core: Array

    @classmethod
    def at(
        cls,
        lattice: Lattice,
        start: LatticeState,
        load: ContactLoad,
        depth: Array,
        h: float,
        *,
        quasi_static: bool,
        external: Array | None = None,
        frame_velocity: Array | None = None,
    ) -> _Problem:
        start.workspace.fit(lattice, 0)
        moves = lattice.inverse_mass > 0.0
        going = np.where((lattice.anchored & lattice.active)[:, None], start.velocity, 0.0)
        none = np.zeros(len(start.x))
        frame = np.zeros_like(start.x)
        if frame_velocity is not None and not quasi_static:
            frame[:] = frame_velocity
        nodes, weights = _both_sides(lattice, load)
        modes, core = np.zeros((0, *start.x.shape)), np.zeros((0, 0))
        if not quasi_static and len(lattice.free):
            flight = rigid_flight(lattice.free, lattice.mass, start.x, start.velocity, h)
            modes, core = body_modes(lattice.free, lattice.gamma, start.x + 0.5 * h * flight)
            core /= h
            going[lattice.active] += flight[lattice.active]
        for _, a, b in lattice.free:
            frame[a:b] = 0.0
        springs = lattice.stiffness > 0.0
        real = springs & (lattice.rest_length > 1e-6 * lattice.spacing)
        pull = lattice.stiffness * lattice.rest_length
        return cls(
            lattice,
            start,
            load,
            nodes,
            weights,
            depth,
            h,
            none if quasi_static else lattice.mass / h,
            none if quasi_static else lattice.gamma,
            np.zeros(len(depth)) if quasi_static else load.damping,
            np.zeros_like(start.x) if external is None else np.asarray(external, dtype=np.float64),
            start.x + h * carried(going, lattice.ties),
            moves,
            ROUNDING * float(np.linalg.norm(pull)),
            FARTHEST * float(lattice.rest_length[real].min(initial=math.inf)),
            SLIP * lattice.spacing,
            frame,
            modes,
            core,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Duals:
    """The unknowns of the primal-dual method: trial, flow (13, N) of the springs (spring_tangents), and rubbing (n, 3), the
    directions of friction, at most of length 1.
    """

    trial: Array
    flow: Array
    rubbing: Array

    def moved(self, problem: _Problem, before: Array, after: Array) -> _Duals:
        """Those after a correction from nodes at `before` to `after` (N, 3); those of the springs are a copy, still to be
        moved.
        """
        slip, new = (_motion(problem, x)[1] for x in (before, after))
        length = np.sqrt(np.einsum("nc,nc->n", slip, slip) + problem.slip**2)
        rubbing = new - self.rubbing * (np.einsum("nc,nc->n", slip, new - slip) / length)[:, None]
        rubbing /= np.maximum(length, np.linalg.norm(rubbing, axis=1))[:, None]
        return _Duals(self.trial.copy(), self.flow.copy(), rubbing)


@dataclass(frozen=True, slots=True, eq=False)
class _Balance:
    """The forces at positions x (N, 3): residual (N, 3) of the free nodes, its norm over that of the forces at work."""

    x: Array
    rest_length: Array
    residual: Array
    ratio: float
    depth: Array
    contact_force: Array
    tangent: Tangent
    duals: _Duals


def _newton(problem: _Problem, numbering: Numbering, coarse: CoarseSpace | None) -> _Balance:
    """Solve one sub-step. Raises _NoConvergenceError."""
    lattice = problem.lattice
    springs = lattice.stiffness.shape if lattice.plastic else (0, 0)
    duals = _Duals(np.full(springs, math.nan), np.zeros(springs), np.zeros_like(problem.load.normal))
    now = _balance(problem, problem.first, duals)
    correction = math.inf
    for iteration in range(ITERATIONS):
        if now.ratio == 0.0 or (now.ratio <= RESIDUAL and correction <= CORRECTION * lattice.spacing):
            moved = np.zeros((3, len(now.x) + 2))
            moved[:, 1:-1] = (now.x - problem.start.x).T
            if fastest_stretch(lattice.segments, lattice.stiffness, lattice.rest_length, moved) > MOST_STRETCH:
                raise _NoConvergenceError(now.ratio, iteration)
            return now
        if not math.isfinite(now.ratio):
            raise _NoConvergenceError(now.ratio, iteration)
        d = solve(lattice, numbering, now.tangent, now.residual, coarse)
        if d is None:
            safe = _balance(problem, now.x, now.duals, definite=True)
            d = solve(lattice, numbering, safe.tangent, now.residual, coarse)
        if d is None:
            raise _NoConvergenceError(now.ratio, iteration + 1)
        farthest = math.sqrt(float(np.einsum("nc,nc->n", d, d).max()))
        share = min(1.0, problem.reach / farthest) if farthest > 0.0 else 1.0
        work = float(np.vdot(now.residual, d))
        for _ in range(SHORTENINGS):
            x = now.x + share * d
            after = _balance(problem, x, now.duals.moved(problem, now.x, x))
            turned = float(np.vdot(after.residual, d))
            if turned >= -0.5 * work:
                break
            # where the work along d would be nothing, were it linear
            share *= min(max(work / (work - turned), 0.1), 0.7)
        now, correction = after, farthest
    raise _NoConvergenceError(now.ratio, ITERATIONS)


def _balance(problem: _Problem, x: Array, duals: _Duals, *, definite: bool = False) -> _Balance:
    """Forces, residual and tangent at x (N, 3)."""
    lattice, start, h = problem.lattice, problem.start, problem.h
    count = len(x)
    padded, force = np.zeros((3, count + 2)), np.zeros((3, count + 2))
    padded[:, 1:-1] = x.T
    effort, blocks = np.zeros(count + 2), np.zeros((13, count, 6))
    rest = np.empty_like(start.rest_length)
    rest[:] = start.rest_length
    spring_tangents(
        lattice.segments,
        lattice.stiffness,
        lattice.rest_length,
        lattice.yield_strain,
        lattice.hardening,
        lattice.plastic,
        definite,
        padded,
        start.rest_length,
        duals.trial,
        duals.flow,
        rest,
        force,
        effort,
        blocks,
        start.workspace.scratch[9:11],
    )
    velocity = (x - start.x) / h
    inertial = problem.inertia[:, None] * (velocity - start.velocity)
    inertial += problem.drag[:, None] * (velocity - problem.frame)
    if len(problem.modes):
        modes = problem.modes.reshape(len(problem.modes), -1)
        inertial -= h * (modes.T @ (problem.core @ (modes @ velocity.ravel()))).reshape(-1, 3)
    residual = force[:, 1:-1].T + problem.external - inertial
    work = effort[1:-1] + np.linalg.norm(problem.external, axis=1) + np.linalg.norm(inertial, axis=1)
    if len(lattice.ties.nodes):
        residual, work = condensed(residual, lattice.ties), condensed(work, lattice.ties)
    depth, contact_force, stiffness = _contact(problem, x, duals.rubbing)
    if len(depth):
        np.add.at(residual, problem.nodes, problem.weights[:, :, None] * contact_force[:, None, :])
        np.add.at(work, problem.nodes, np.abs(problem.weights) * np.linalg.norm(contact_force, axis=1)[:, None])
    residual[~problem.moves] = 0.0
    size = float(np.linalg.norm(residual))
    at_work = float(np.linalg.norm(work[problem.moves]))
    ratio = 0.0 if size <= problem.rounding else size / at_work
    tangent = Tangent(
        blocks,
        problem.inertia / h + problem.drag / h,
        problem.nodes,
        problem.weights,
        stiffness,
        problem.modes,
        problem.core,
    )
    return _Balance(x, rest, residual, ratio, depth, contact_force, tangent, duals)


def _motion(problem: _Problem, x: Array) -> tuple[Array, Array]:
    """How far the contacts have sunk along their normals (n,), and slipped along their tools (n, 3), with nodes at x."""
    load = problem.load
    moved = np.einsum("nk,nkc->nc", problem.weights, (x - problem.start.x)[problem.nodes]) - problem.h * load.velocity
    sunk = np.einsum("nc,nc->n", moved, load.normal)
    return sunk, moved - sunk[:, None] * load.normal


def _contact(problem: _Problem, x: Array, rubbing: Array) -> tuple[Array, Array, Array]:
    """Depths (n,), forces (n, 3) on the model and their stiffness (n, 3, 3) of all contacts with nodes at x (N, 3)."""
    load, normal, h = problem.load, problem.load.normal, problem.h
    sunk, slip = _motion(problem, x)
    depth = problem.depth + sunk
    press = load.area * (load.stiffness * depth + problem.damping * sunk / h)
    slope = np.where(press > 0.0, load.area * (load.stiffness + problem.damping / h), 0.0)
    press = np.maximum(press, 0.0)
    force = -press[:, None] * normal
    stiffness = slope[:, None, None] * normal[:, :, None] * normal[:, None, :]
    length = np.sqrt(np.einsum("nc,nc->n", slip, slip) + problem.slip**2)
    drag = load.friction * press / length
    flat = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    bent = rubbing[:, :, None] * slip[:, None, :] / length[:, None, None]
    stiffness += drag[:, None, None] * (flat - 0.5 * (bent + bent.transpose(0, 2, 1)))
    return depth, force - drag[:, None] * slip, stiffness
