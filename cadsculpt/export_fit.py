"""The surfaces that go back to CAD: every sculpted face refitted, from the net as it was read, to the scene's tolerance.

A run collides with working nets that have knots wherever a tool may come. What leaves it has as few knots more than the
file's own as `refit.tolerance` asks for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .errors import GeometryError
from .export_seams import Corner, agreed, corners_of, in_turn, lead_along, seams_of
from .model import Model
from .patch import Patch
from .session import Session
from .spline.adapt import Goal, ToleranceFit, fit_to_tolerance, judged
from .spline.between import denser
from .spline.follow import Following, Lead, edge_knots, follows
from .spline.net_fit import Given, NodeField, fit_net, still_sides
from .spline.refine import missing_knots
from .spline.refit import RefitError
from .spline.seam import RELATIVE, Seam, angle, gap
from .spline.surface import BSplineSurface

Array = NDArray[np.float64]


Knots = tuple[Array, Array]

MUCH = 1.1
"""A fit that closes its seams better is preferred to one that is nearer to the nodes by no more than this."""

FINER = 2
"""Where a face cannot follow another along their edge as nearly as it must, its nodes are made twice as many, so often."""

STRAYING = 2.0
"""A fit that strays between the nodes by more than this many tolerances is not taken if there is another."""


@dataclass(frozen=True, slots=True, eq=False)
class ExportedFace:
    """One sculpted face as it goes to CAD, in the scene's unit.

    surface : the face as read with `knots` (along u, along v) more and its control points moved by displacement (r, s, 3).
    error : distance of the surface from the lattice's nodes; between : what it strays from them in the middles between
    (`spline.adapt.between_nodes`). working : the same distance of the net that the run collided with, and its shape.
    outcome : "within" the tolerance, else what kept it from it: "limit", "nodes", "seams" (where neighbours differ) or
    "refine" (which the scene forbids).
    """

    name: str
    surface: BSplineSurface
    knots: tuple[Array, Array]
    displacement: Array
    read_shape: tuple[int, int]
    error: RefitError
    between: float
    outcome: str
    working: RefitError
    working_shape: tuple[int, int]


@dataclass(frozen=True, slots=True)
class ExportedSeam:
    """A common edge of two sculpted faces, or the seam of a closed one, as it goes to CAD.

    gap, angle : largest distance of the two sides and largest angle of their tangent planes (degrees), on the exported
    surfaces; as_read : the same on the file's. tolerance : the gap that the file lets it have.
    """

    faces: tuple[str, str]
    gap: float
    gap_as_read: float
    tolerance: float
    angle: float
    angle_as_read: float


@dataclass(frozen=True, slots=True, eq=False)
class Exported:
    """Everything that goes back to CAD, one face for each of the models' patches."""

    faces: tuple[ExportedFace, ...]
    seams: tuple[ExportedSeam, ...] = ()

    @property
    def seam_max_gap(self) -> float:
        """The largest gap of all seams; 0 where there is none."""
        return max((seam.gap for seam in self.seams), default=0.0)

    @property
    def error(self) -> RefitError:
        """Of all faces together: the largest distance, and the root mean square of the faces' own."""
        errors = [face.error for face in self.faces]
        if not errors:
            return RefitError(0.0, 0.0)
        return RefitError(
            max(error.maximum for error in errors), float(np.sqrt(np.mean([error.rms**2 for error in errors])))
        )

    def warnings(self, tolerance: float, unit: str) -> list[str]:
        """What the user should know of faces that are not as near to their nodes as they should be."""
        lines = [line for face in self.faces for line in _warnings(face, tolerance, unit)]
        open_ = [seam for seam in self.seams if seam.gap > max(seam.tolerance, 1.05 * seam.gap_as_read)]
        if open_:
            worst = max(open_, key=lambda seam: seam.gap)
            a, b = worst.faces
            others = f" ({len(open_)} edges are above their tolerance)" if len(open_) > 1 else ""
            lines.append(
                f"the faces {a!r} and {b!r} are up to {worst.gap:.3g} {unit} apart along their common edge, "
                f"above its tolerance {worst.tolerance:.3g} {unit}{others}"
            )
        return lines


def export_fit(session: Session) -> Exported:
    """Refit every face of a session as it is now. Raises GeometryError when its nodes are not anywhere (not finite)."""
    model = session.model
    # those of tools come last, and go nowhere
    patches = [patch for patch in model.patches if patch.body < model.models]
    smooth = model.scene.refit.continuity == "G1"
    seams, corners = seams_of(patches), corners_of(patches)
    measured = [node_field(session, i) for i in range(len(patches))]
    fields = agreed(patches, measured, seams, model.refit_threshold)
    fits: dict[int, ToleranceFit] = {}
    for i in in_turn(patches, seams):
        leads = _leads(i, patches, seams, corners, fits, smooth=smooth)
        fits[i] = _fitted(session, model, i, fields[i], leads)
    faces = tuple(_face(session, model, i, fits[i], measured[i]) for i in range(len(patches)))
    return Exported(faces, tuple(_seam(seam, patches, faces) for seam in seams))


def _leads(
    index: int,
    patches: Sequence[Patch],
    seams: Sequence[Seam],
    corners: Sequence[Corner],
    fits: Mapping[int, ToleranceFit],
    *,
    smooth: bool,
) -> tuple[Lead, ...]:
    """What a face must follow of the faces that are fitted already: along common edges, and at corners."""
    own, leads = patches[index].source.surface, list[Lead]()
    for seam in seams:
        for side in (seam, seam.swapped()):
            if side.b == index and side.a in fits and side.a != index:
                lead = fits[side.a].fit
                leads.append(lead_along(side, lead.surface, lead.displacement, own, smooth=smooth))
    for corner in corners:
        places = dict(corner.places)
        before = [i for i in places if i in fits and i != index]
        if index in places and before:
            lead = fits[before[0]].fit
            leads.append(Lead(places[index][None], lead.along(places[before[0]][None]), RELATIVE * own.size))
    return tuple(leads)


def _seam(seam: Seam, patches: Sequence[Patch], faces: Sequence[ExportedFace]) -> ExportedSeam:
    a, b = faces[seam.a], faces[seam.b]
    return ExportedSeam(
        faces=(a.name, b.name),
        gap=gap(seam, a.surface, b.surface),
        gap_as_read=seam.rest_gap,
        tolerance=seam.tolerance,
        angle=angle(seam, a.surface, b.surface),
        angle_as_read=seam.rest_angle,
    )


def _face(session: Session, model: Model, index: int, fit: ToleranceFit, measured: NodeField) -> ExportedFace:
    """The outcome of a face, judged by its own lattice whatever it was brought to agree with."""
    patch, refine = model.patches[index], model.scene.refit.refine
    goal = _goal(model)
    own = judged(fit.fit.against(measured), fit.knots, measured, goal, fit.outcome)
    outcome: str = own.outcome
    if own.error.maximum > goal.tolerance:
        outcome = "seams" if fit.outcome == "within" else fit.outcome if refine else "refine"
    fit = own
    return ExportedFace(
        name=patch.name,
        surface=fit.surface,
        knots=fit.knots,
        displacement=fit.fit.displacement,
        read_shape=patch.source.surface.shape,
        error=fit.error,
        between=fit.between,
        outcome=outcome,
        working=session.refit_error(index),
        working_shape=patch.surface.shape,
    )


def node_field(session: Session, index: int) -> NodeField:
    """The displacement of a patch's nodes; those that are material, outside its fixed regions, count."""
    patch = session.model.patches[index]
    read = patch.source.surface
    return NodeField.of(
        read,
        patch.u,
        patch.v,
        session.displacement(index),
        counted=patch.material_nodes & ~patch.hold.inside(patch.u, patch.v),
        closed=(read.closed_u, read.closed_v),
        slivers=patch.slivers,
    )


def _goal(model: Model) -> Goal:
    refit = model.scene.refit
    return Goal(refit.tolerance, model.refit_threshold, refit.max_control_points, refit.refine)


def _fitted(
    session: Session, model: Model, index: int, field: NodeField, leads: tuple[Lead, ...], finer: int = FINER
) -> ToleranceFit:
    goal, patch = _goal(model), model.patches[index]
    read = patch.source.surface
    still = still_sides(read, field, goal.threshold)
    following = Following(replace(patch.hold, curves=(*patch.hold.curves, *still)), leads)
    working = missing_knots(read, patch.surface)
    tries: list[tuple[Knots | None, Knots | None]] = [(None, None)]
    if goal.refine:
        # with the knots that the faces it follows have; where its nodes do not determine such a net, with fewer of them; and
        # with those of the run's own net, which they do determine
        along = [edge_knots(read, field, leads, goal.max_control_points, strict=strict) for strict in (False, True)]
        tries = [*((knots, None) for knots in along[: 2 if leads else 1]), (None, working)]
    fits = []
    for kept, start in tries:
        with suppress(GeometryError):
            fits.append(fit_to_tolerance(read, field, goal, constraint=following.given, kept=kept, start=start))
            if goal.refine and finer and not _closes(fits[-1], leads):
                # an edge may need knots closer than the nodes stand: their own interpolation says what is between
                return _fitted(session, model, index, denser(field, read.domain), leads, finer=finer - 1)
            if goal.refine and finer and fits[-1].outcome == "within" and fits[-1].between > goal.tolerance:
                return _calmed(session, model, index, field, leads, fits[-1])
            near = fits[-1].outcome == "within" and fits[-1].between <= STRAYING * goal.tolerance
            if near or fits[-1].outcome == "limit":
                return fits[-1]
    if not fits:
        moved = patch.refit.fit(session.displacement(index), model.refit_threshold)
        every = Given(np.ones(patch.surface.shape, dtype=np.bool_), moved)
        fits.append(judged(fit_net(patch.surface, field, np.inf, lambda net: every), working, field, goal))
    worst = [max(fit.error.maximum, fit.between) for fit in fits]
    return fits[next(k for k, off in enumerate(worst) if off <= MUCH * min(worst))]


def _calmed(
    session: Session, model: Model, index: int, field: NodeField, leads: tuple[Lead, ...], fit: ToleranceFit
) -> ToleranceFit:
    """A fit that strays between its nodes, or the one to twice as many, interpolated, if that strays less."""
    domain = model.patches[index].source.surface.domain
    other = _fitted(session, model, index, denser(field, domain), leads, finer=0)
    calmed = judged(other.fit.against(field), other.knots, field, _goal(model), other.outcome)
    worst = [max(each.error.maximum, each.between) for each in (calmed, fit)]
    return calmed if worst[0] < worst[1] else fit


def _closes(fit: ToleranceFit, leads: tuple[Lead, ...]) -> bool:
    return bool((fit.fit.lacking() <= 1.0).all()) and follows(fit.fit.surface, leads)


def _warnings(face: ExportedFace, tolerance: float, unit: str) -> list[str]:
    lines = []
    if face.outcome != "within":
        why = {
            "limit": "refit.max_control_points allows no finer net",
            "nodes": "its nodes, or what is held, allow no better",
            "seams": "the lattices of the faces beside it have moved otherwise",
            "refine": "refit.refine keeps the net as it was read",
        }[face.outcome]
        lines.append(
            f"the surface of face {face.name!r} is up to {face.error.maximum:.3g} {unit} away from its nodes, "
            f"above refit.tolerance {tolerance:.3g} {unit}: {why}"
        )
    elif face.between > tolerance:
        lines.append(
            f"the surface of face {face.name!r} strays up to {face.between:.3g} {unit} between its nodes "
            f"(use a smaller node spacing)"
        )
    return lines
