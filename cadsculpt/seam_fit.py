"""Faces refitted together: each to a tolerance of its nodes, one after the other, so that common edges stay closed.

A face whose neighbours are fitted already follows them along the edges and at the corners that they share.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .errors import GeometryError
from .export_seams import Corner, agreed, corners_of, in_turn, lead_along
from .patch import SourceFace
from .spline.adapt import Goal, ToleranceFit, fit_to_tolerance, judged
from .spline.between import denser
from .spline.follow import Following, Lead, corner_point, edge_knots, follows_with_its_knots, off_lead, side_of
from .spline.hold import Hold
from .spline.net_fit import NodeField, still_sides
from .spline.seam import RELATIVE, Seam, Source, angle, gap
from .spline.surface import BSplineSurface

Array = NDArray[np.float64]

Knots = tuple[Array, Array]

MUCH = 1.1
"""A fit that closes its seams better is preferred to one that is nearer to the nodes by no more than this."""

FINER = 5
"""Where a face cannot follow another along their edge as nearly as it must, its nodes are made twice as many, so often."""

HELPS = 0.7
"""Where more nodes do not bring a face nearer to those that it follows than this part of how far it was, more do not help."""

STILL_ROWS = 3
"""Rows of nodes along a side that must all be still, for its tangents to be held."""

MEETS = 1e-6
"""A corner this near to an edge, as a part of the domain, lies on it."""

MANY = 400
"""Nodes along a side, fewer of which would keep the knots with which it follows another face away from where they do most."""

STRAYING = 2.0
"""A fit that strays between the nodes by more than this many tolerances is not taken if there is another."""

GROWN = 1.05
"""A gap that the file has itself may come back this much larger."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceMotion:
    """A face and how its nodes move.

    source : the face as read. field : the displacement of its nodes. hold : what of it stays where it is. goal : of its
    refit. working : knots (u, v) of a net that follows every node. flat : sides along which its tangents stay as well, where no
    other face asks otherwise. last : the fit to take where the nodes determine none;
    without it that is an error.
    """

    source: SourceFace
    field: NodeField
    hold: Hold
    goal: Goal
    working: Knots
    flat: tuple[Array, ...] = ()
    last: Callable[[], ToleranceFit] | None = None


@dataclass(frozen=True, slots=True)
class ExportedSeam:
    """A common edge of two sculpted faces, or the seam of a closed one, as it goes to CAD.

    gap, angle : largest distance of the two sides and largest angle of their tangent planes (degrees), on the exported
    surfaces; as_read : the same on the file's. tolerance : the gap that it may have; tolerance_from : who says so, the
    "file", its "edge", the "scene", or nobody, and then it is a part of the faces' "size".
    """

    faces: tuple[str, str]
    gap: float
    gap_as_read: float
    tolerance: float
    angle: float
    angle_as_read: float
    tolerance_from: Source = "size"

    @property
    def open(self) -> bool:
        """Whether it is farther apart than the file lets it be, and than it was."""
        return self.gap > max(self.tolerance, GROWN * self.gap_as_read)

    @classmethod
    def of(cls, seam: Seam, faces: Sequence[SourceFace], surfaces: Sequence[BSplineSurface]) -> ExportedSeam:
        a, b = surfaces[seam.a], surfaces[seam.b]
        return cls(
            faces=(faces[seam.a].name, faces[seam.b].name),
            gap=gap(seam, a, b),
            gap_as_read=seam.rest_gap,
            tolerance=seam.tolerance,
            angle=angle(seam, a, b),
            angle_as_read=seam.rest_angle,
            tolerance_from=seam.source,
        )


_WHOSE = {
    "file": "the file's tolerance",
    "edge": "the edge's tolerance",
    "scene": "refit.seam_tolerance",
    "size": "1e-7 of their size,",
}


def open_seams(seams: Sequence[ExportedSeam], unit: str) -> str:
    """What to say of the seams that are open, "" where none is."""
    found = [seam for seam in seams if seam.open]
    if not found:
        return ""
    worst = max(found, key=lambda seam: seam.gap)
    a, b = worst.faces
    others = f" ({len(found)} edges are above their tolerance)" if len(found) > 1 else ""
    return (
        f"the faces {a!r} and {b!r} are up to {worst.gap:.3g} {unit} apart along their common edge, "
        f"above {_WHOSE[worst.tolerance_from]} {worst.tolerance:.3g} {unit}{others}"
    )


@dataclass(frozen=True, slots=True, eq=False)
class JointFit:
    """The fits of faces, one for each, and their seams. Each fit is judged by the face's own nodes, whatever it was brought
    to agree with; `agreed` tells which were within their tolerance of what they agreed on."""

    fits: tuple[ToleranceFit, ...]
    agreed: tuple[bool, ...]
    seams: tuple[ExportedSeam, ...]


def fit_together(motions: Sequence[FaceMotion], seams: Sequence[Seam], *, smooth: bool) -> JointFit:
    """Fit faces so that they stay together along their common edges; smooth : and tangent where they were.

    seams : of the faces, as `seams_of` finds them.

    Raises GeometryError naming a face whose nodes determine no net.
    """
    faces = [motion.source for motion in motions]
    corners = corners_of(faces)
    still = min((motion.goal.threshold for motion in motions), default=0.0)
    fields = agreed(faces, [motion.field for motion in motions], seams, still)
    motions = [_with_still_sides(motion, field, smooth=smooth) for motion, field in zip(motions, fields, strict=True)]
    fits: dict[int, ToleranceFit] = {}
    for i in in_turn(faces, seams):
        fits[i] = _fitted(
            motions[i], fields[i], _leads(i, faces, seams, corners, fits, motions[i].goal.tolerance, smooth=smooth)
        )
    own = [
        judged(fits[i].fit.against(motion.field), fits[i].knots, motion.field, motion.goal, fits[i].outcome)
        for i, motion in enumerate(motions)
    ]
    surfaces = [fit.surface for fit in own]
    return JointFit(
        tuple(own),
        tuple(fits[i].outcome == "within" for i in range(len(motions))),
        tuple(ExportedSeam.of(seam, faces, surfaces) for seam in seams),
    )


def _with_still_sides(motion: FaceMotion, field: NodeField, *, smooth: bool) -> FaceMotion:
    """The motion with the sides held on which no node moved; smooth : with their tangents, where none beside them moved.
    Two faces that follow one another tangentially would lean apart where their edge ends on such sides."""
    surface, threshold, hold = motion.source.surface, motion.goal.threshold, motion.hold
    still = still_sides(surface, field, threshold)
    flat = still_sides(surface, field, threshold, STILL_ROWS) if smooth else []
    return replace(motion, hold=replace(hold, curves=(*hold.curves, *still)), flat=tuple(flat))


def _leads(
    index: int,
    faces: Sequence[SourceFace],
    seams: Sequence[Seam],
    corners: Sequence[Corner],
    fits: Mapping[int, ToleranceFit],
    tolerance: float,
    *,
    smooth: bool,
) -> tuple[Lead, ...]:
    """What a face must follow of the faces that are fitted already: along common edges, and at corners."""
    own, leads = faces[index].surface, list[Lead]()
    for seam in seams:
        for side in (seam, seam.swapped()):
            if side.b == index and side.a in fits and side.a != index:
                lead = fits[side.a].fit
                leads.append(lead_along(side, lead.surface, lead.displacement, own, tolerance, smooth=smooth))
    for corner in corners:
        places = dict(corner.places)
        before = [i for i in places if i in fits and i != index]
        if index in places and before:
            # an edge that it follows ends here as well: only a control point that is the corner is given twice
            if _met(own, leads, places[index]) and corner_point(own, places[index][None]) is None:
                continue
            lead = fits[before[0]].fit
            leads.append(Lead(places[index][None], lead.along(places[before[0]][None]), RELATIVE * own.size))
    return tuple(leads)


def _met(surface: BSplineSurface, leads: Sequence[Lead], uv: Array) -> bool:
    """Whether an edge that is followed runs through a place uv (2,)."""
    reach = np.diff(np.array(surface.domain), axis=1)[:, 0]
    return any(bool((np.abs(lead.uv - uv) <= MEETS * reach).all(axis=1).any()) for lead in leads if len(lead.uv) > 1)


def _fitted(
    motion: FaceMotion, field: NodeField, leads: tuple[Lead, ...], finer: int = FINER, before: float = np.inf
) -> ToleranceFit:
    """The fit of a face. finer : how often its nodes may still be made more; before : how far it was off its leads when they
    were fewer."""
    goal, read = motion.goal, motion.source.surface
    following = Following(motion.hold, leads, motion.flat)
    if goal.refine and finer and (axes := _sparse(read, field, leads)):
        return _fitted(motion, denser(field, read.domain, axes), leads, finer=finer - 1)
    tries: list[tuple[Knots | None, Knots | None]] = [(None, None)]
    if goal.refine:
        # with the knots that the faces it follows have; where its nodes do not determine such a net, with fewer of them; and
        # with those of a net that follows every node, which they do determine
        along = [edge_knots(read, field, leads, goal.max_control_points, strict=strict) for strict in (False, True)]
        tries = [*((knots, None) for knots in along[: 2 if leads else 1]), (None, motion.working)]
    fits: list[ToleranceFit] = []
    for kept, start in tries:
        with suppress(GeometryError):
            fits.append(fit_to_tolerance(read, field, goal, constraint=following.given, kept=kept, start=start))
            off = _off(fits[-1], leads)
            if goal.refine and finer and 1.0 < off <= HELPS * before:
                # an edge may need knots closer than the nodes stand: their own interpolation says what is between
                dense = denser(field, read.domain, _along(read, leads))
                other = _fitted(motion, dense, leads, finer=finer - 1, before=off)
                return other if _off(other, leads) < off else fits[-1]
            if goal.refine and finer and fits[-1].outcome == "within" and fits[-1].between > goal.tolerance:
                return _calmed(motion, field, leads, fits[-1])
            near = fits[-1].outcome == "within" and fits[-1].between <= STRAYING * goal.tolerance
            if off <= 1.0 and (near or fits[-1].outcome == "limit"):
                return fits[-1]
    if not fits:
        if motion.last is None:
            raise GeometryError(
                "its nodes determine no net", where=motion.source.name, mend="use a smaller node spacing"
            )
        return motion.last()
    # closed edges come first
    gaps = [max(_off(fit, leads), 1.0) for fit in fits]
    fits = [fit for fit, off in zip(fits, gaps, strict=True) if off <= MUCH * min(gaps)]
    worst = [max(fit.error.maximum, fit.between) for fit in fits]
    return fits[next(k for k, off in enumerate(worst) if off <= MUCH * min(worst))]


def _sparse(surface: BSplineSurface, field: NodeField, leads: Sequence[Lead]) -> set[int]:
    """The directions of sides that need knots beyond those of their leads, and have few nodes."""
    axes: set[int] = set()
    for lead in leads:
        side = side_of(surface, lead.uv)
        if (
            side is not None
            and len((field.u, field.v)[1 - side.axis]) < MANY
            and not follows_with_its_knots(surface, lead)
        ):
            axes.add(1 - side.axis)
    return axes


def _along(surface: BSplineSurface, leads: Sequence[Lead]) -> set[int]:
    """The directions in which a face must be fine to follow its leads: along its sides, or both."""
    axes: set[int] = set()
    for lead in leads:
        if len(lead.uv) > 1:
            side = side_of(surface, lead.uv)
            axes |= {0, 1} if side is None else {1 - side.axis}
    return axes or {0, 1}


def _calmed(motion: FaceMotion, field: NodeField, leads: tuple[Lead, ...], fit: ToleranceFit) -> ToleranceFit:
    """A fit that strays between its nodes, or the one to twice as many, interpolated, if that strays less."""
    other = _fitted(motion, denser(field, motion.source.surface.domain), leads, finer=0)
    calmed = judged(other.fit.against(field), other.knots, field, motion.goal, other.outcome)
    worst = [max(each.error.maximum, each.between) for each in (calmed, fit)]
    return calmed if worst[0] < worst[1] else fit


def _off(fit: ToleranceFit, leads: tuple[Lead, ...]) -> float:
    """How far a fit is from what its leads ask, over their tolerances."""
    return max((float(off_lead(fit.fit.surface, fit.fit.displacement, lead).max()) for lead in leads), default=0.0)
