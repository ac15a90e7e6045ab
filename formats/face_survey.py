"""Where on a face can a tool be pressed? A face sampled over the window that its lattice will cover.

Everything is in mm. For each sample inside the trims: how far the face's border is (`room`), and how large a ball may
touch it from outside before it touches anything else of the part (`free_radius`). For the whole window: the thickness
at which a lattice below it would fold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import CadsculptError
from ..patch import Window, face_window, node_window
from ..spline.matrices import breakpoints
from ..spline.surface import BSplineSurface
from ..spline.trim import inside, loop_polyline
from .part import Face, Part

Array = NDArray[np.float64]

SAMPLES = 49
"""Rows and columns of samples: about as dense as the nodes will be."""

COARSE, FINE = 13, 41
"""Rows and columns of samples on the other faces, and on those that make a good part of the whole."""

LARGEST = 1e9
"""mm; nothing that is larger is a part (readers give 1e100 to surfaces without an end)."""


@dataclass(frozen=True, slots=True, eq=False)
class Spot:
    """A place for a tool: parameters, point (3,), outward normal (3,), `room` to the border, `free_radius` above."""

    u: float
    v: float
    point: Array
    normal: Array
    room: float
    free_radius: float


@dataclass(frozen=True, slots=True, eq=False)
class FaceSurvey:
    """A face on a grid: u (m,), v (n,), points (m, n, 3), normals (m, n, 3), room (m, n), 0 outside the trims.

    lengths : mean lengths of the window along u and v. size : diagonal of the trimmed face's box. fold : thickness at
    which a lattice on this grid folds, inf where the face is flat or hollow. shortest : length of the shortest knot
    span in the window. spans : knot spans along u and v.
    """

    face: Face
    surface: BSplineSurface
    u: Array
    v: Array
    points: Array
    normals: Array
    room: Array
    lengths: tuple[float, float]
    size: float
    fold: float
    shortest: float
    spans: tuple[int, int]

    def spots(self, around: Array, most: int = 6) -> list[Spot]:
        """Places well inside the face, apart from each other, roomiest first. around (k, 3) : points of all faces."""
        left = np.where(np.isfinite(self.normals).all(axis=2), self.room, 0.0)
        found: list[Spot] = []
        cloud = np.concatenate([around, self.points[self.room > 0]])
        while len(found) < most and left.max() > 0.25 * self.room.max():
            i, j = np.unravel_index(int(np.argmax(left)), left.shape)
            point, normal, room = self.points[i, j], self.normals[i, j], float(left[i, j])
            free = free_radius(point, normal, cloud, nearest=1e-4 * room)
            found.append(Spot(float(self.u[i]), float(self.v[j]), point, normal, room, free))
            left = np.where(np.linalg.norm(self.points - point, axis=2) < 0.5 * room, 0.0, left)
        return found

    def near(self, spot: Spot, reach: float, count: int = 41) -> Array:
        """Points (k, 3) of the face, trimmed, densely over `reach` (mm) around a spot."""
        d = self.surface.derivatives(spot.u, spot.v, 1)
        ranges: list[Array] = []
        for middle, speed, window in ((spot.u, d[1, 0], self.u), (spot.v, d[0, 1], self.v)):
            half = reach / max(float(np.linalg.norm(speed)), 1e-300)
            ranges.append(np.linspace(max(window[0], middle - half), min(window[-1], middle + half), count))
        u, v = ranges
        points: Array = self.surface.evaluate(u[:, None], v)[inside(self.surface, u, v)]
        return points


def survey(face: Face) -> FaceSurvey:
    """Sample a face. Raises CadsculptError when its surface cannot be had or has no size."""
    surface = face.surface
    surface.validate()
    window = lattice_window(surface)
    u, v = (np.linspace(low, high, SAMPLES) for low, high in window)
    d = surface.derivatives(u[:, None], v, 1)
    points, normals = d[0, 0], surface.normal(u[:, None], v)
    mask = inside(surface, u, v)
    room = np.zeros(mask.shape)
    if mask.any():
        room[mask] = _distance(points[mask], border(face, surface))
    return FaceSurvey(
        face=face,
        surface=surface,
        u=u,
        v=v,
        points=points,
        normals=normals,
        room=room,
        lengths=(_mean_length(points, 0), _mean_length(points, 1)),
        size=float(np.linalg.norm(np.ptp(points[mask], axis=0))) if mask.any() else 0.0,
        fold=fold_thickness(points, normals),
        shortest=min(_shortest_span(surface, window, axis) for axis in (0, 1)),
        spans=(_spans(surface, window, 0), _spans(surface, window, 1)),
    )


def lattice_window(surface: BSplineSurface) -> Window:
    """The piece of the domain that gets nodes; a closed direction gets them all around."""
    (u, v), (whole_u, whole_v) = node_window(surface), surface.domain
    return (whole_u if surface.closed_u else u), (whole_v if surface.closed_v else v)


def border(face: Face, surface: BSplineSurface) -> Array:
    """Points (k, 3) along all that ends the face: its edges, seams and poles too, for there nodes are awkward."""
    chains = [np.asarray(edge.points) for edge in face.edges if len(edge.points)]
    if not chains:
        if surface.trims is not None:
            loops = [loop_polyline(loop) for loop in surface.trims]
            chains = [surface.evaluate(loop[:, 0], loop[:, 1]) for loop in loops]
        else:
            (u0, u1), (v0, v1) = surface.domain
            s, t = np.linspace(u0, u1, 65), np.linspace(v0, v1, 65)
            chains = [
                surface.evaluate(s, v0),
                surface.evaluate(s, v1),
                surface.evaluate(u0, t),
                surface.evaluate(u1, t),
            ]
    return np.concatenate([_dense(chain, 64) for chain in chains])


def free_radius(point: Array, normal: Array, cloud: Array, nearest: float) -> float:
    """Radius of the largest ball that touches `point` on the side of `normal` and holds no point of the cloud (k, 3).

    A ball of radius r at point + r n holds x when |x - point|^2 < 2 r n.(x - point) (Ma, Bae, Choi 2012).
    nearest : points within this distance are left out; they are the place itself, or that on a copy of the face.
    """
    to = cloud - point
    height, distance = to @ normal, np.einsum("kc,kc->k", to, to)
    above = (height > 0.0) & (distance > nearest**2)
    return float((distance[above] / (2.0 * height[above])).min(initial=np.inf))


def fold_thickness(points: Array, normals: Array) -> float:
    """Thickness at which neighbouring inward normals meet: the smallest |dS|^2 / (dS . dn), inf where none do."""
    reach = np.inf
    for axis in (0, 1):
        step, turn = np.diff(points, axis=axis), np.diff(normals, axis=axis)
        closing = np.einsum("ijc,ijc->ij", step, turn)
        length = np.einsum("ijc,ijc->ij", step, step)
        meets = closing > 1e-9 * np.sqrt(length)  # less is rounding on a straight line
        if meets.any():
            reach = min(reach, float((length[meets] / closing[meets]).min()))
    return reach


@dataclass(frozen=True, slots=True, eq=False)
class FaceSamples:
    """A face in a few points (k, 3), its edges among them; area is that of the sampled cells, mm2, about right."""

    points: Array
    area: float

    @property
    def size(self) -> float:
        """Diagonal of the points' box, 0 without points."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0))) if len(self.points) else 0.0


def part_samples(part: Part) -> dict[int, FaceSamples]:
    """The faces of a part by number, more points on the larger ones. Left out: faces whose surface cannot be had."""
    found: dict[int, FaceSamples] = {}
    for count in (COARSE, FINE):
        whole = max((samples.size for samples in found.values()), default=0.0)
        for face in part.faces:
            if count == FINE and (face.number not in found or found[face.number].size < 0.2 * whole):
                continue
            try:
                found[face.number] = _samples(face, count)
            except CadsculptError:
                continue
    return {number: samples for number, samples in found.items() if 0.0 < samples.size < LARGEST}


def _samples(face: Face, count: int) -> FaceSamples:
    surface = face.surface
    u, v = (np.linspace(low, high, count) for low, high in face_window(surface))
    points, mask = surface.evaluate(u[:, None], v), inside(surface, u, v)
    du, dv = np.diff(points, axis=0)[:, :-1], np.diff(points, axis=1)[:-1]
    cells = np.linalg.norm(np.cross(du, dv), axis=2)[mask[:-1, :-1]]
    every = np.concatenate([points[mask], *(np.asarray(edge.points) for edge in face.edges)])
    every = every[np.isfinite(every).all(axis=1)]
    return FaceSamples(every[np.abs(every).max(axis=1, initial=0.0) < LARGEST], float(np.nansum(cells)))


def _distance(points: Array, cloud: Array) -> Array:
    from scipy.spatial import cKDTree

    distance: Array = cKDTree(cloud).query(points)[0]
    return distance


def _dense(chain: Array, pieces: int) -> Array:
    """The polyline cut into about `pieces` steps of equal length or more, its own corners kept."""
    if len(chain) < 2:
        return chain
    steps = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    longest = steps.sum() / pieces
    parts: list[Array] = []
    for a, b, length in zip(chain[:-1], chain[1:], steps, strict=True):
        n = max(1, int(np.ceil(length / longest))) if longest > 0 else 1
        parts.append(a + (b - a) * (np.arange(n) / n)[:, None])
    return np.concatenate([*parts, chain[-1:]])


def _mean_length(points: Array, axis: int) -> float:
    return float(np.linalg.norm(np.diff(points, axis=axis), axis=2).sum(axis=axis).mean())


def _spans(surface: BSplineSurface, window: Window, axis: int) -> int:
    return len(_borders(surface, window, axis)) - 1


def _shortest_span(surface: BSplineSurface, window: Window, axis: int) -> float:
    """Mean length in space of the shortest knot span of the window along an axis."""
    borders = _borders(surface, window, axis)
    across = np.linspace(*window[1 - axis], 9)
    points = (
        surface.evaluate(borders[:, None], across) if axis == 0 else surface.evaluate(across[None, :], borders[:, None])
    )
    return float(np.linalg.norm(np.diff(points, axis=0), axis=2).mean(axis=1).min())


def _borders(surface: BSplineSurface, window: Window, axis: int) -> Array:
    low, high = window[axis]
    knots = breakpoints((surface.knots_u, surface.knots_v)[axis], (surface.degree_u, surface.degree_v)[axis])
    return np.concatenate([[low], knots[(knots > low) & (knots < high)], [high]])
