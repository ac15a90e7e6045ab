"""The surfaces that go back to CAD: every sculpted face refitted, from the net as it was read, to the scene's tolerance.

A run collides with working nets that have knots wherever a tool may come. What leaves it has as few knots more than the
file's own as `refit.tolerance` asks for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .export_seams import seams_of
from .seam_fit import ExportedSeam, FaceMotion, fit_together, open_seams
from .session import Session
from .spline.adapt import Goal, ToleranceFit, judged
from .spline.net_fit import Given, NodeField, fit_net
from .spline.refine import missing_knots
from .spline.refit import RefitError
from .spline.surface import BSplineSurface

Array = NDArray[np.float64]


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
        if apart := open_seams(self.seams, unit):
            lines.append(apart)
        return lines


def export_fit(session: Session) -> Exported:
    """Refit every face of a session as it is now. Raises GeometryError when its nodes are not anywhere (not finite)."""
    model = session.model
    # those of tools come last, and go nowhere
    patches = [patch for patch in model.patches if patch.body < model.models]
    motions = [_motion(session, i) for i in range(len(patches))]
    refit = model.scene.refit
    seams = seams_of([patch.source for patch in patches], refit.seam_tolerance)
    made = fit_together(motions, seams, smooth=refit.continuity == "G1")
    faces = tuple(
        _face(session, i, fit, agreed=agreed)
        for i, (fit, agreed) in enumerate(zip(made.fits, made.agreed, strict=True))
    )
    return Exported(faces, made.seams)


def _motion(session: Session, index: int) -> FaceMotion:
    model, patch = session.model, session.model.patches[index]
    refit, read = model.scene.refit, patch.source.surface
    goal = Goal(refit.tolerance, model.refit_threshold, refit.max_control_points, refit.refine)
    field, working = node_field(session, index), missing_knots(read, patch.surface)

    def last() -> ToleranceFit:
        """The net of the run, which its nodes determine."""
        moved = patch.refit.fit(session.displacement(index), model.refit_threshold)
        every = Given(np.ones(patch.surface.shape, dtype=np.bool_), moved)
        return judged(fit_net(patch.surface, field, np.inf, lambda net: every), working, field, goal)

    return FaceMotion(patch.source, field, patch.hold, goal, working, last=last)


def _face(session: Session, index: int, fit: ToleranceFit, *, agreed: bool) -> ExportedFace:
    patch, refit = session.model.patches[index], session.model.scene.refit
    outcome: str = fit.outcome
    if fit.error.maximum > refit.tolerance:
        outcome = "seams" if agreed else fit.outcome if refit.refine else "refine"
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
