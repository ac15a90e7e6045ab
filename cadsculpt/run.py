"""A run: the loop over a `Session` along the scripted tool paths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .collide.certified.body import GridCache
from .collide.certified.proximity import separation
from .errors import InputError, SimulationError
from .expect import Expectation, evaluate, pair_index
from .export_fit import Exported, export_fit
from .force_control import FORCE_TOLERANCE
from .frames import FrameMaker
from .history import History, Summary
from .model import Model
from .record import ContactRecord, Frame, StepRecord
from .session import Buildable, Session
from .spline.surface import BSplineSurface

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """What a run leaves behind.

    exported : the sculpted faces as they go back to CAD. converged : False when the simulation became unstable; `failure` says
    how, and everything up to that step is kept.
    warnings : what the user should know, step ranges of residual penetration above the scene's limit among them.
    """

    session: Session
    history: History
    summary: Summary
    exported: Exported
    expectations: tuple[Expectation, ...]
    converged: bool
    failure: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Converged, and every expectation holds."""
        return self.converged and all(expectation.ok for expectation in self.expectations)


@dataclass(slots=True)
class Hooks:
    """Calls a run makes while it goes; all optional.

    on_step : after every step. on_frame : at the scene's frame rate, first and last included. on_progress : (step, steps).
    on_checkpoint : after every step, with a function that collects the arrays to resume from, should the caller want them.
    """

    on_step: Callable[[StepRecord, ContactRecord], None] | None = None
    on_frame: Callable[[Frame], None] | None = None
    on_progress: Callable[[int, int], None] | None = None
    on_checkpoint: Callable[[int, Callable[[], dict[str, Array]]], None] | None = None


@dataclass(slots=True)
class _Clearance:
    """Which pairs' distance the expectations ask for, and the smallest so far: (pairs,)."""

    wanted: NDArray[np.bool_]
    smallest: Array
    cache: GridCache = field(default_factory=GridCache)

    @classmethod
    def of(cls, model: Model, history: History) -> _Clearance:
        wanted = np.zeros(len(model.pairs), dtype=np.bool_)
        for spec in model.scene.expect:
            pair = pair_index(spec, model)
            if spec.what == "clearance":
                wanted[slice(None) if pair is None else pair] = True
        before = np.where(np.isnan(history.clearance), np.inf, history.clearance)
        return cls(wanted, before.min(axis=0, initial=np.inf))

    def measure(self, session: Session) -> Array:
        """Certified lower bounds of the distances asked for, NaN elsewhere: (pairs,). One that is not the smallest
        so far is only known to be above it."""
        model = session.model
        distance = np.full(self.wanted.shape, np.nan)
        for pair in np.flatnonzero(self.wanted):
            part, placed = session.placed(int(model.pairs.a[pair])), session.placed(int(model.pairs.b[pair]))
            least, tolerance = float(self.smallest[pair]), model.options.tolerance or None
            found = separation(part, placed, tolerance=tolerance, threshold=min(least, model.size), cache=self.cache)
            if found.low <= least:
                # never more clearance than is certain
                found = separation(part, placed, tolerance=tolerance, cache=self.cache)
                self.smallest[pair] = min(least, found.low)
            distance[pair] = found.low
        return distance


@dataclass(slots=True, eq=False)
class _Farthest:
    """How far the models' surfaces have moved from their rest shape, on the grids that collision uses."""

    rest: list[Array]
    _net: list[Array | None] = field(default_factory=list)

    def moved(self, session: Session) -> float:
        """Largest displacement of any surface now; a net that is as it was is not looked at again."""
        result = 0.0
        self._net = self._net or [None] * len(self.rest)
        for i, (patch, rest) in enumerate(zip(session.model.patches, self.rest, strict=True)):
            if patch.body >= session.model.models:
                continue
            net = session.state.control_points[i]
            seen = self._net[i]
            if seen is not None and np.array_equal(net, seen):
                continue
            self._net[i] = np.array(net)  # its memory is used again
            distance = np.linalg.norm(patch.grid.matrices.points(net, patch.surface.weights) - rest, axis=2)
            if patch.grid.inside is not None:
                distance = distance[patch.grid.inside]
            result = max(result, float(distance.max(initial=0.0)))
        return result


def _net(surface: BSplineSurface) -> tuple[Array, Array | None]:
    return surface.control_points, surface.weights


def run(
    source: Session | Model | Buildable,
    *,
    hooks: Hooks | None = None,
    on_frame: Callable[[Frame], None] | None = None,
    resume: dict[str, Array] | None = None,
) -> RunResult:
    """Run a scene to the end of its tool paths.

    source : a scene, its model, or a session at its start (with a clock, say). resume : arrays of a checkpoint.
    Raises InputError when a tool starts inside a part. An unstable simulation ends the run with `converged` False.
    """
    hooks = hooks or Hooks(on_frame=on_frame)
    session = source if isinstance(source, Session) else Session(source)
    model = session.model
    history = History.empty(len(model.pairs))
    if resume is not None:
        session.restore(resume)
        history = History.of_arrays(resume)
    else:
        refuse_tools_inside(session)
    clearance = _Clearance.of(model, history)
    farthest = _Farthest([patch.grid.matrices.points(*_net(patch.surface)) for patch in model.patches])
    frames = FrameMaker.of(session) if hooks.on_frame else None
    every = max(1, round(1.0 / (model.scene.output.frames_per_second * model.step)))
    if frames and hooks.on_frame and resume is None:
        hooks.on_frame(frames.frame())
    failure = ""
    while session.state.step < model.steps:
        try:
            reactions = session.step(dt=model.step_length(session.state.step))
        except SimulationError as error:
            failure = str(error)
            history.touched = np.array(session.state.touched)
            break
        state = session.state
        contacts = session.contacts
        history.add(
            state.time,
            model.pairs.places(contacts.a, contacts.b),
            contacts,
            session.forces,
            session.depths,
            clearance.measure(session),
            state.touched,
        )
        history.max_displacement = max(history.max_displacement, farthest.moved(session))
        if hooks.on_step:
            each = [reactions[tool.name] for tool in model.tools]
            record = StepRecord(
                state.step,
                state.time,
                np.array([r.force for r in each]),
                np.array([r.torque for r in each]),
                np.array([r.contact_area for r in each]),
                np.array([r.max_depth for r in each]),
                np.array([r.max_penetration for r in each]),
            )
            hooks.on_step(record, ContactRecord(state.step, state.time, session.contacts.copy(), session.forces.copy()))
        if frames and hooks.on_frame and (state.step % every == 0 or state.step == model.steps):
            hooks.on_frame(frames.frame())
        if hooks.on_progress:
            hooks.on_progress(state.step, model.steps)
        if hooks.on_checkpoint:
            hooks.on_checkpoint(state.step, lambda: {**session.arrays(), **history.arrays()})
    exported = export_fit(session)
    summary = summarise(history, exported)
    return RunResult(
        session=session,
        history=history,
        summary=summary,
        exported=exported,
        expectations=evaluate(model, history, summary),
        converged=not failure,
        failure=failure,
        warnings=tuple(_warnings(session, history, summary, exported)),
    )


def refuse_tools_inside(session: Session) -> None:
    """Raise InputError when a body starts deeper in another than the scene lets it stay."""
    model = session.model
    contacts = session.detect().contacts
    if len(contacts) and contacts.depth.max() > model.scene.solver.max_penetration:
        worst = int(np.argmax(contacts.depth))
        first, second = int(contacts.a[worst]), int(contacts.b[worst])
        tool = second >= model.models
        one, other = (second, first) if tool else (first, second)
        raise InputError(
            f"{named(model, one)} starts inside {named(model, other)}, {contacts.depth[worst]:.4g} {model.scene.units} deep",
            where=model.scene.name,
            mend="let its path start outside" if tool else "move one of the two in its file",
        )


def named(model: Model, body: int) -> str:
    """A body in words: "the tool 'thumb'"."""
    return f"the {'part' if body < model.models else 'tool'} {model.bodies[body]!r}"


def summarise(history: History, exported: Exported) -> Summary:
    """The numbers of result.json."""
    return Summary(
        first_contact=history.first_contact(),
        max_depth=history.greatest("depth"),
        max_penetration=history.greatest("penetration"),
        max_force=history.greatest("force"),
        max_contact_area=history.greatest("area"),
        max_displacement=history.max_displacement,
        refit_max_error=exported.error.maximum,
        refit_rms_error=exported.error.rms,
        seam_max_gap=exported.seam_max_gap,
    )


def _warnings(session: Session, history: History, summary: Summary, exported: Exported) -> list[str]:
    model = session.model
    unit = model.scene.units
    lines = []
    for (body, other), depth in sorted(session.undecided.items()):
        lines.append(
            f"{named(model, other)} came so near {named(model, body)} between its grid's vertices "
            f"that a contact up to {depth:.3g} {unit} deep may have been missed (raise solver.resolution or solver.tolerance)"
        )
    limit = model.scene.solver.max_penetration
    for first, last, worst in history.too_deep(limit):
        steps = f"step {first}" if first == last else f"steps {first} to {last}"
        lines.append(
            f"{steps}: residual penetration up to {worst:.3g} {unit}, above max_penetration {limit:.3g} {unit}"
        )
    for tool, push in model.pushes.items():
        met = history.greatest("force", model.pairs.of(model.models + tool))
        if 0.0 < met < (1.0 - 2.0 * FORCE_TOLERANCE) * push.force:
            lines.append(
                f"the tool {model.tools[tool].name!r} met at most {met:.4g} N of its {push.force:g} N: its path ends, or turns "
                "back, before the material resists with more"
            )
    lines += exported.warnings(model.scene.refit.tolerance, unit)
    if summary.first_contact is None:
        lines.append("no tool touched a part")
    return lines
