"""A displacement field applied to a part, without any physics: faces near its points follow them, all else stays.

The fit is the one of a run's export: to a stated tolerance of the nodes, with as few knots more as they ask for, and closed
along the edges of faces that move together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError, InputError
from ..export_seams import seams_of
from ..patch import SourceFace, hold_of, node_window
from ..seam_fit import ExportedSeam, FaceMotion, fit_together, open_seams
from ..spline.adapt import Goal
from ..spline.net_fit import SINGULAR, Given, NodeField, fit_net
from ..spline.refit import RefitError
from ..spline.seam import Seam
from ..spline.surface import BSplineSurface
from .displacements import DisplacementField
from .field_nodes import FieldNodes, interpolated_nodes, own_nodes
from .load import source_face
from .part import Face, Part

Array = NDArray[np.float64]
Span = tuple[float, float]
Box = tuple[Span | None, Span | None]

TOLERANCE = 1e-4
"""Of the refit, in sizes of the face, where none is given."""
STILL = 0.05
"""Nodes that move by less than this share of the tolerance do not move: their control points keep their bits."""
FINER = 0.6
"""From one try to the next, of the node spacing, while the nodes do not determine the net."""
TRIES = 4
MARGIN = 2
"""Nodes beyond all that move, from which on an interpolated face stays."""
MOST_CONTROL_POINTS = 20_000


@dataclass(frozen=True, slots=True)
class DisplacedFace:
    """What became of a face: its largest displacement and the distance between its nodes and the refit surface, mm.

    exact : the nodes are points of the field.
    """

    number: int
    name: str
    moved: float
    error: RefitError
    nodes: tuple[int, int]
    exact: bool


@dataclass(frozen=True, slots=True)
class Displaced:
    """The faces that moved, and how well those that share an edge meet there; lengths in mm."""

    faces: tuple[DisplacedFace, ...]
    seams: tuple[ExportedSeam, ...]


def displace(
    part: Part,
    field: DisplacementField,
    faces: Sequence[Face] | None = None,
    *,
    among: Sequence[Face] | None = None,
    tolerance: float | None = None,
    continuity: str = "G0",
    seam_tolerance: float | None = None,
    on_face: Callable[[str], None] | None = None,
) -> Displaced:
    """Move the faces of a part along a field.

    faces : that may move; when left out all (those of `among`) that are near its points, but for those that are near only to
    the nodes of others. tolerance : mm between the nodes and the refit surface; what could not be met is in the part's
    warnings. continuity : "G1" keeps faces tangent where they were, those that stay as well. seam_tolerance : mm that faces
    may be apart along a common edge; what the file states when left out.

    Raises InputError when no point of the field is near the part, and nothing moves; GeometryError naming the faces whose
    common edge would open, and then nothing has changed.
    """
    movable = [_Movable.of(part, face, tolerance) for face in (faces or among or part.faces) if not face.warning]
    near = [one for one in movable if _reaches(field, one.surface)]
    if not near:
        low, high = field.points.min(axis=0), field.points.max(axis=0)
        raise InputError(
            f"no face is near the points, which lie from ({_xyz(low)}) to ({_xyz(high)}) mm",
            where=str(part.path),
            mend="are they in another unit, or is the reach too small?",
        )
    smooth = continuity == "G1"
    grids = [own_nodes(one.surface, field, node_window(one.surface)) for one in near]
    if faces is None:
        near, grids = _near_by_themselves(field, near, grids)
    moving = {one.source.name for one in near}
    motions, nodes = list[FaceMotion](), list[FieldNodes]()
    for one, grid in zip(near, grids, strict=True):
        if on_face:
            on_face(one.source.name)
        found, motion = _motion(one, field, grid, moving, smooth=smooth)
        nodes.append(found)
        motions.append(motion)
    sources = [motion.source for motion in motions]
    seams = seams_of(sources, seam_tolerance)
    motions = _kept_still(motions, nodes, seams)
    made = fit_together(motions, seams, smooth=smooth)
    if apart := open_seams(made.seams, "mm"):
        raise GeometryError(
            apart, where=str(part.path), mend="give more points along it, a smaller --refit, or move one of them alone"
        )
    surfaces: dict[int, BSplineSurface] = {}
    told: list[DisplacedFace] = []
    for one, found, fit in zip(near, nodes, made.fits, strict=True):
        if not (fit.fit.displacement != 0.0).any():
            continue
        surfaces[one.source.number] = fit.surface
        shape = found.moves.shape
        told.append(
            DisplacedFace(
                one.source.number,
                one.source.name,
                found.most,
                fit.error,
                (shape[0], shape[1]),
                found.points is not None,
            )
        )
        if fit.error.maximum > one.tolerance:
            part.warnings.append(
                f"face {one.source.name!r}: the refit keeps within {fit.error.maximum:.3g} mm of its nodes, "
                f"not {one.tolerance:.3g}"
            )
    if not told:
        raise InputError("nothing moves: all displacements near its faces are zero", where=str(part.path))
    part.sculpt(surfaces)
    moved = {face.name for face in told}
    return Displaced(tuple(told), tuple(seam for seam in made.seams if moved.intersection(seam.faces)))


def _xyz(point: Array) -> str:
    return ", ".join(f"{x:.4g}" for x in point)


@dataclass(frozen=True, slots=True, eq=False)
class _Movable:
    """A face that may move, and the tolerance of its refit, mm."""

    source: SourceFace
    tolerance: float

    @classmethod
    def of(cls, part: Part, face: Face, tolerance: float | None) -> _Movable:
        source = source_face(part, face, "mm")
        return cls(source, tolerance or TOLERANCE * source.surface.size)

    @property
    def surface(self) -> BSplineSurface:
        return self.source.surface


def _reaches(field: DisplacementField, surface: BSplineSurface) -> bool:
    """Whether a point of the field may be near enough to a surface to move it."""
    return bool(_close(field, surface).any())


def _close(field: DisplacementField, surface: BSplineSurface) -> NDArray[np.bool_]:
    """The points of the field that may be near enough to a surface to move it."""
    net = surface.control_points.reshape(-1, 3)
    low, high = net.min(axis=0) - field.reach, net.max(axis=0) + field.reach
    return np.asarray(((field.points >= low) & (field.points <= high)).all(axis=1))


def _near_by_themselves(
    field: DisplacementField, near: Sequence[_Movable], grids: Sequence[FieldNodes | None]
) -> tuple[list[_Movable], list[FieldNodes | None]]:
    """Those faces that have nodes of their own in the field, or are near to points that are no other face's nodes."""
    nodes = np.zeros(len(field.points), dtype=np.bool_)
    for grid in grids:
        if grid is not None and grid.points is not None:
            nodes[grid.points] = True
    kept = [
        (one, grid)
        for one, grid in zip(near, grids, strict=True)
        if grid is not None or (_close(field, one.surface) & ~nodes).any()
    ]
    return [one for one, _ in kept], [grid for _, grid in kept]


def _motion(
    one: _Movable, field: DisplacementField, grid: FieldNodes | None, moving: set[str], *, smooth: bool
) -> tuple[FieldNodes, FaceMotion]:
    """The nodes of a face along the field, and what its refit is to do; its own grid, where that determines its net."""
    source, surface = one.source, one.surface
    held = [edge for edge in source.edges if not edge.seam and not edge.degenerate and set(edge.neighbours) - moving]
    goal = Goal(one.tolerance, STILL * one.tolerance, MOST_CONTROL_POINTS)
    hold = hold_of(source, held, smooth=smooth)
    window, spacing = node_window(surface), field.spacing
    for attempt in range(TRIES + 1):
        nodes = grid if attempt == 0 else interpolated_nodes(surface, field, window, spacing)
        if attempt:
            spacing *= FINER
            if nodes is None:
                break
        if nodes is None:
            continue
        motion = _determined(source, nodes, goal, lambda net: Given(hold.control_points(net)))
        if motion is not None:
            return nodes, FaceMotion(source, motion, hold, goal, nodes.knots)
    raise GeometryError(
        f"no net of its surface follows points {field.spacing:.3g} mm apart",
        where=source.name,
        mend="are they in another unit? Otherwise give fewer points",
    )


def _determined(
    source: SourceFace, nodes: FieldNodes, goal: Goal, given: Callable[[BSplineSurface], Given]
) -> NodeField | None:
    """The nodes' displacements; None where they do not determine the net that was read."""
    try:
        field = nodes.on(source.surface)
        fit_net(source.surface, field, goal.threshold, given, worst_condition=SINGULAR)
    except GeometryError:
        return None
    return field


# ------------------------------------------------------------------ what stays


def _kept_still(motions: Sequence[FaceMotion], nodes: Sequence[FieldNodes], seams: Sequence[Seam]) -> list[FaceMotion]:
    """Faces at whose nodes the field was interpolated stay beyond all that moves; along common edges both sides alike."""
    free = [_moving_box(motion.source.surface, found) for motion, found in zip(motions, nodes, strict=True)]
    sides = [side for seam in seams for side in (seam, seam.swapped())]
    for _ in range(2 * len(motions)):
        before = [box.copy() for box in free]
        for side in sides:
            whole, box = np.array(motions[side.a].source.surface.domain).T, free[side.a]
            slack = 1e-9 * (whole[1] - whole[0])
            above = (side.uv_a > box[0] + slack) | ((box[0] <= whole[0]) & (side.uv_a <= whole[0] + slack))
            below = (side.uv_a < box[1] - slack) | ((box[1] >= whole[1]) & (side.uv_a >= whole[1] - slack))
            within = (above & below).all(axis=1)
            within |= np.append(within[1:], False) | np.insert(within[:-1], 0, False)
            if within.any():
                there = side.uv_b[within]
                free[side.b][0] = np.minimum(free[side.b][0], there.min(axis=0))
                free[side.b][1] = np.maximum(free[side.b][1], there.max(axis=0))
        if all((a == b).all() for a, b in zip(before, free, strict=True)):
            break
    return [
        replace(motion, hold=replace(motion.hold, boxes=_beyond(motion.source.surface, box)))
        for motion, box in zip(motions, free, strict=True)
    ]


def _moving_box(surface: BSplineSurface, nodes: FieldNodes) -> Array:
    """The least and the largest (u, v), (2, 2), between which the face may move, the other way round where it does not; nodes
    of the field itself say so all over it."""
    box = np.array(surface.domain).T
    if nodes.points is not None:
        return box
    moved = (nodes.moves != 0.0).any(axis=2)
    for axis, t in ((0, nodes.u), (1, nodes.v)):
        if (surface.closed_u, surface.closed_v)[axis]:
            continue
        places = np.flatnonzero(moved.any(axis=1 - axis))
        if not len(places):
            box[:, axis] = box[::-1, axis].copy()
            continue
        if places[0] >= MARGIN:
            box[0, axis] = t[places[0] - MARGIN]
        if places[-1] + MARGIN < len(t):
            box[1, axis] = t[places[-1] + MARGIN]
    return box


def _beyond(surface: BSplineSurface, box: Array) -> tuple[Box, ...]:
    """The parts of the domain that lie beyond a box of it on one side."""
    found: list[Box] = []
    for axis, (low, high) in enumerate(surface.domain):
        for a, b in ((low, float(box[0, axis])), (float(box[1, axis]), high)):
            if a < b:
                found.append(((a, b), None) if axis == 0 else (None, (a, b)))
    return tuple(found)
