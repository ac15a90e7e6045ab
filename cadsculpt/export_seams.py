"""Where the sculpted faces of a model meet: their common edges and corners, and displacements that agree there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .patch import SourceFace
from .spline.between import known_at
from .spline.equations import displacement_along
from .spline.follow import Lead, side_of
from .spline.net_fit import NodeField
from .spline.seam import RELATIVE, Bound, Seam, own_seam, seam_of
from .spline.surface import BSplineSurface

Array = NDArray[np.float64]

BLEND = 3.0
"""Where the lattices of two faces do not agree on their common edge, their nodes give way as far as so many node spacings."""

SWEEPS = 8
"""At a corner several seams pull at the same nodes: so often in turn brings them together."""

SMOOTH = 0.5
"""Degrees: faces whose normals differ by no more along their common edge are tangent there."""

TURN = 0.05
"""Degrees that a face may turn against the one that it follows, where they stay tangent."""

NEAR_POLE = 0.02
"""Where a face is narrower than this part of its widest along an edge, near a pole, its tangents may be off as if it were
not."""

NEARER = 0.8
"""How near a face must come to the one that it follows, in gaps that are allowed: the gap is seen between those places too."""

CORNER = 1e-6
"""Ends of edges nearer than this part of the faces' size are one corner."""


def seams_of(faces: Sequence[SourceFace], tolerance: float | None = None) -> tuple[Seam, ...]:
    """The common edges of faces, and the seams of closed ones. tolerance : how far apart they may be, whatever the file
    says."""
    wanted = None if tolerance is None else Bound(tolerance, "scene")
    found: list[Seam] = []
    for i, a in enumerate(faces):
        surface = a.surface
        for axis, closed in enumerate((surface.closed_u, surface.closed_v)):
            if closed and (surface.trims is None or any(edge.seam for edge in a.edges)):
                found.append(own_seam(i, surface, axis, wanted or _bound(a, a)))
        for j in range(i + 1, len(faces)):
            found += _between(i, a, j, faces[j], wanted)
    return tuple(found)


def _bound(a: SourceFace, b: SourceFace) -> Bound | None:
    """How far apart two faces (one and itself) may be along their common edge; None where nobody says."""
    edges = [
        edge
        for face, other in ((a, b), (b, a))
        for edge in face.edges
        if (edge.seam if a is b else other.name in edge.neighbours)
    ]
    own = max((edge.tolerance for edge in edges if not edge.stated), default=0.0)
    stated = min((edge.tolerance for edge in edges if edge.stated and edge.tolerance > 0.0), default=0.0)
    if stated >= own and stated > 0.0:
        return Bound(stated, "file")
    size = RELATIVE * max(a.surface.size, b.surface.size)
    return Bound(own, "edge") if own > size else None


def _between(i: int, a: SourceFace, j: int, b: SourceFace, wanted: Bound | None) -> list[Seam]:
    """The seams of two faces that name each other as neighbours."""
    edges_a = [edge.uv for edge in a.edges if b.name in edge.neighbours and not edge.degenerate]
    edges_b = [edge.uv for edge in b.edges if a.name in edge.neighbours and not edge.degenerate]
    if not edges_a or not edges_b:
        return []
    tolerance = wanted or _bound(a, b)
    first, second = a.surface, b.surface
    found = [seam_of(i, first, uv, j, second, edges_b, tolerance) for uv in edges_a]
    if not any(found):
        # an edge of the one may be a piece of one of the other
        found = [
            seam and seam.swapped() for seam in (seam_of(j, second, uv, i, first, edges_a, tolerance) for uv in edges_b)
        ]
    return [seam for seam in found if seam is not None]


def in_turn(faces: Sequence[SourceFace], seams: Sequence[Seam]) -> list[int]:
    """The order in which faces are fitted: those first that can only lead, then always one that follows as many as can be."""
    across = [0] * len(faces)
    beside: list[set[int]] = [set() for _ in faces]
    for seam in seams:
        if seam.a != seam.b:
            for here, there, uv in ((seam.a, seam.b, seam.uv_a), (seam.b, seam.a, seam.uv_b)):
                across[here] += side_of(faces[here].surface, uv) is None
                beside[here].add(there)
    order: list[int] = []
    while len(order) < len(faces):
        left = [i for i in range(len(faces)) if i not in order]
        order.append(max(left, key=lambda i: (len(beside[i].intersection(order)), across[i], -i)))
    return order


def agreed(
    faces: Sequence[SourceFace], fields: Sequence[NodeField], seams: Sequence[Seam], still: float
) -> list[NodeField]:
    """The displacements of the nodes, brought together where lattices that are not tied differ on a common edge by more
    than `still`: either side goes half the way, less and less over a few nodes."""
    fields = list(fields)
    met = [(s.swapped(), s)[k] for s in seams if s.a != s.b for k in (0, 1)]
    near = [_Reach.of(faces[s.a].surface, fields[s.a], s.uv_a) for s in met]
    for _ in range(SWEEPS):
        worst = 0.0
        for k in range(0, len(met), 2):
            a, b = met[k + 1].a, met[k + 1].b
            (here, near_here), (there, near_there) = (
                known_at(fields[i], faces[i].surface.domain, uv)
                for i, uv in ((a, met[k + 1].uv_a), (b, met[k + 1].uv_b))
            )
            jump = there - here
            length = np.linalg.norm(jump, axis=1)
            # what interpolation cannot know is no disagreement
            jump *= (np.maximum(length - near_here - near_there, 0.0) / np.maximum(length, 1e-300))[:, None]
            size = float(np.linalg.norm(jump, axis=1).max(initial=0.0))
            worst = max(worst, size)
            if size > still:
                fields[a] = near[k + 1].added(fields[a], 0.5 * jump)
                fields[b] = near[k].added(fields[b], -0.5 * jump)
        if worst <= still:
            break
    return fields


@dataclass(frozen=True, slots=True, eq=False)
class _Reach:
    """The nodes (rows, columns) near a seam: the place on it that is nearest to each, and its share of the jump there."""

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    place: NDArray[np.int64]
    share: Array

    @classmethod
    def of(cls, surface: BSplineSurface, field: NodeField, uv: Array) -> _Reach:
        nodes = surface.evaluate(field.u[:, None], field.v)
        spacing = float(np.median(np.concatenate([_steps(nodes, 0), _steps(nodes, 1)])))
        seam = surface.evaluate(uv[:, 0], uv[:, 1])
        low, high = seam.min(axis=0) - BLEND * spacing, seam.max(axis=0) + BLEND * spacing
        rows, columns = np.nonzero(((nodes >= low) & (nodes <= high)).all(axis=2))
        away = np.linalg.norm(nodes[rows, columns][:, None] - seam, axis=2)
        place = away.argmin(axis=1)
        x = np.clip(away.min(axis=1) / (BLEND * spacing), 0.0, 1.0)
        share = (1.0 - x) ** 2 * (1.0 + 2.0 * x)
        kept = share > 0.0
        return cls(rows[kept], columns[kept], place[kept], share[kept])

    def added(self, field: NodeField, jump: Array) -> NodeField:
        moved = field.displacement.copy()
        moved[self.rows, self.columns] += self.share[:, None] * jump[self.place]
        return replace(field, displacement=moved)


def _steps(nodes: Array, axis: int) -> Array:
    steps: Array = np.linalg.norm(np.diff(nodes, axis=axis), axis=2).ravel()
    return steps


def lead_along(
    seam: Seam, leader: BSplineSurface, displacement: Array, follower: BSplineSurface, tolerance: float, *, smooth: bool
) -> Lead:
    """What face seam.b must do to follow face seam.a, whose surface as read, over its final net, is `leader` and whose control
    points move by `displacement`.

    tolerance : of the refit; the edge comes no less near. smooth : keep the two tangent as well, where they were.
    """
    moved = displacement_along(leader, displacement, seam.uv_a)
    knots = np.zeros(0)
    side, own = side_of(follower, seam.uv_b), side_of(leader, seam.uv_a)
    if side is not None and own is not None:
        theirs, mine = seam.uv_a[:, 1 - own.axis], seam.uv_b[:, 1 - side.axis]
        order = np.argsort(theirs, kind="stable")
        low, high = leader.domain[1 - own.axis]
        inner = np.unique((leader.knots_u, leader.knots_v)[1 - own.axis])
        knots = np.interp(inner[(inner > low) & (inner < high)], theirs[order], mine[order])
    across = direction = slack = None
    if smooth and seam.rest_angle <= SMOOTH:
        direction = _across(follower, seam.uv_b)
        slope = follower.derivatives(seam.uv_b[:, 0], seam.uv_b[:, 1], 1)
        wanted = direction[:, :1] * slope[1, 0] + direction[:, 1:] * slope[0, 1]
        tangents = leader.derivatives(seam.uv_a[:, 0], seam.uv_a[:, 1], 1)
        basis = np.stack([tangents[1, 0], tangents[0, 1]], axis=2)
        along = np.stack([np.linalg.lstsq(m, x, rcond=1e-9)[0] for m, x in zip(basis, wanted, strict=True)])
        across = displacement_along(leader, displacement, seam.uv_a, along)
        length = np.linalg.norm(wanted, axis=1)
        slack = np.radians(TURN) * np.maximum(length, max(NEAR_POLE * float(length.max()), 1e-9 * follower.size))
    return Lead(seam.uv_b, moved, min(NEARER * seam.allowed, tolerance), across, direction, slack, knots)


def _across(surface: BSplineSurface, uv: Array) -> Array:
    """A direction (n, 2) of (u, v) across a chain uv (n, 2), of about the domain's size; along an axis where it runs along a
    side."""
    reach = np.diff(np.array(surface.domain), axis=1)[:, 0]
    side = side_of(surface, uv)
    if side is not None:
        direction = np.zeros_like(uv)
        direction[:, side.axis] = reach[side.axis]
        return direction
    along = np.gradient(uv, axis=0) / reach
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    return np.stack([-along[:, 1], along[:, 0]], axis=1) * reach


@dataclass(frozen=True, slots=True, eq=False)
class Corner:
    """A point where several faces meet: for each its number and the parameters (2,) there."""

    places: tuple[tuple[int, Array], ...]


def corners_of(faces: Sequence[SourceFace]) -> tuple[Corner, ...]:
    """The ends of the faces' edges that three or more faces have, or two without a common edge."""
    ends: list[tuple[int, Array, Array]] = []
    for i, face in enumerate(faces):
        for edge in face.edges:
            if not edge.degenerate:
                for uv in edge.uv[[0, -1]]:
                    ends.append((i, uv, face.surface.evaluate(*uv)))
    slack = CORNER * max((face.surface.size for face in faces), default=0.0)
    found: list[Corner] = []
    left = list(range(len(ends)))
    while left:
        first = left[0]
        here = [k for k in left if np.linalg.norm(ends[k][2] - ends[first][2]) <= slack]
        left = [k for k in left if k not in here]
        places = {ends[k][0]: ends[k][1] for k in reversed(here)}
        if len(places) > 1:
            found.append(Corner(tuple(sorted(places.items(), key=lambda place: place[0]))))
    return tuple(found)
