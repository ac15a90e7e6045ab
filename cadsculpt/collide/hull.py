"""Bounding Volume (paper section 4.3): convex hulls of control points; and the window in (u, v) that they leave (4.4).

A surface with positive weights lies in the hull of its control points, and over one knot span in the hull of that
span's own (k+1)(l+1) control points. Whether two hulls are apart needs no facets: the farthest control points along a
direction are the hull's, so `apart` (GJK) works on the nets as they are, after every change, flat and collinear nets
included. It answers "apart" only with a direction in hand whose gap exceeds the rounding, so a doubt costs time and
never a contact.

The paper takes the parameters of the hull's vertices (control points) where the hulls' facets meet as the window's
limits, and misses contacts there. The certified window is every knot span whose own control points' box meets the
other body's. `paper_window` is the paper's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..jit import njit, njit_in_place
from ..spline.surface import BSplineSurface
from .workspace import Patch

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

GJK_STEPS = 40
"""Steps after which two hulls that GJK could not part count as meeting; smooth nets take 5 to 15."""


@dataclass(frozen=True, slots=True, eq=False)
class Hull:
    """The convex hull of points: indices of its vertices (k,) and of its facets (f, 3), and its dimension 0 to 3.

    A flat hull's facets are a fan over its polygon, a segment's is (a, b, b), a point's (a, a, a).
    """

    vertices: Index
    facets: Index
    dimension: int


def convex_hull(points: Array) -> Hull:
    """The hull of points (n, 3) by the Quickhull algorithm (Barber, Dobkin, Huhdanpaa 1996; scipy).

    Flat and collinear nets are normal cases: points thinner than rounding in a direction are taken as flat in it.
    """
    from scipy.spatial import ConvexHull, QhullError

    centred = points - points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(centred, full_matrices=False)
    largest = np.abs(points).max(initial=0.0)
    dimension = int((sizes > 1e-12 * max(float(sizes[0]), float(largest))).sum())
    while dimension > 1:
        try:
            hull = ConvexHull(centred if dimension == 3 else centred @ axes[:dimension].T)
        except QhullError:
            dimension -= 1
            continue
        vertices = np.array(hull.vertices, dtype=np.int64)
        if dimension == 3:
            return Hull(np.sort(vertices), np.array(hull.simplices, dtype=np.int64), 3)
        first = np.full(len(vertices) - 2, vertices[0])
        return Hull(np.sort(vertices), np.stack([first, vertices[1:-1], vertices[2:]], axis=1), 2)
    if dimension == 1:
        along = centred @ axes[0]
        a, b = int(along.argmin()), int(along.argmax())
        return Hull(np.array([a, b]), np.array([[a, b, b]]), 1)
    return Hull(np.zeros(1, np.int64), np.zeros((1, 3), np.int64), 0)


@njit_in_place
def farthest(points: Array, x: float, y: float, z: float) -> int:
    """The support of a hull: the point (of (n, >= 3)) farthest along a direction; the first of equals."""
    best, at = -np.inf, 0
    for i in range(len(points)):
        value = points[i, 0] * x + points[i, 1] * y + points[i, 2] * z
        if value > best:
            best, at = value, i
    return at


@njit
def apart(a: Array, b: Array, axis: Array, gap: float) -> bool:
    """Whether the hulls of a (n, 3) and b (m, 3) are proved to be more than `gap` apart.

    axis (3,) : a direction to try first, from b to a; takes the last one found, to be remembered for the next step.
    Source: Gilbert, Johnson, Keerthi (1988), the distance of the origin from the hull of differences a - b.
    """
    simplex = np.empty((4, 3))
    weights = np.empty(4)
    size = 0
    largest = 0.0
    for i in range(len(a)):
        largest = max(largest, abs(a[i, 0]), abs(a[i, 1]), abs(a[i, 2]))
    for i in range(len(b)):
        largest = max(largest, abs(b[i, 0]), abs(b[i, 1]), abs(b[i, 2]))
    noise = 1e-14 * largest
    x, y, z = axis[0], axis[1], axis[2]
    if not x * x + y * y + z * z > 0.0:
        x, y, z = a[0, 0] - b[0, 0], a[0, 1] - b[0, 1], a[0, 2] - b[0, 2]
    for _ in range(GJK_STEPS):
        length = np.sqrt(x * x + y * y + z * z)
        if not length > noise:
            return False
        x, y, z = x / length, y / length, z / length
        i, j = farthest(a, -x, -y, -z), farthest(b, x, y, z)
        dx, dy, dz = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]
        reach = dx * x + dy * y + dz * z
        if reach > gap + noise:
            axis[0], axis[1], axis[2] = x, y, z
            return True
        # no nearer than the simplex already is: the distance is found, and it is not above the gap
        if size > 0 and reach >= length - 1e-10 * length - noise:
            axis[0], axis[1], axis[2] = x, y, z
            return False
        simplex[size, 0], simplex[size, 1], simplex[size, 2] = dx, dy, dz
        size = nearest_in_simplex(simplex, size + 1, weights)
        if size == 4:
            return False
        x, y, z = 0.0, 0.0, 0.0
        for k in range(size):
            x += weights[k] * simplex[k, 0]
            y += weights[k] * simplex[k, 1]
            z += weights[k] * simplex[k, 2]
    return False


@njit
def nearest_in_simplex(s: Array, size: int, weights: Array) -> int:
    """Keep the corners (and their weights) of the face of s[:size] that holds its point nearest to the origin.

    Every face is tried: the one whose own nearest point has positive weights and is nearest. Returns the corners left.
    """
    best = np.inf
    best_face = 0
    found = np.zeros(4)
    trial = np.zeros(4)
    corner = np.empty(4, np.int64)
    matrix = np.empty((3, 4))
    for face in range(1, 1 << size):
        k = 0
        for i in range(size):
            if face & (1 << i):
                corner[k] = i
                k += 1
        # minimise |s_0 + sum t_i (s_i - s_0)|^2: normal equations of at most three unknowns, by elimination
        o = corner[0]
        for i in range(k - 1):
            for j in range(k - 1):
                matrix[i, j] = 0.0
                for c in range(3):
                    matrix[i, j] += (s[corner[i + 1], c] - s[o, c]) * (s[corner[j + 1], c] - s[o, c])
            matrix[i, 3] = 0.0
            for c in range(3):
                matrix[i, 3] -= (s[corner[i + 1], c] - s[o, c]) * s[o, c]
        regular = True
        for i in range(k - 1):
            pivot = matrix[i, i]
            regular = regular and pivot > 1e-300
            for j in range(i + 1, k - 1):
                f = matrix[j, i] / pivot if regular else 0.0
                for c in range(i, k - 1):
                    matrix[j, c] -= f * matrix[i, c]
                matrix[j, 3] -= f * matrix[i, 3]
        if not regular:
            continue
        trial[0] = 1.0
        positive = True
        for i in range(k - 2, -1, -1):
            value = matrix[i, 3]
            for j in range(i + 1, k - 1):
                value -= matrix[i, j] * trial[j + 1]
            trial[i + 1] = value / matrix[i, i]
            trial[0] -= trial[i + 1]
            positive = positive and trial[i + 1] >= 0.0
        if not (positive and trial[0] >= 0.0):
            continue
        d = 0.0
        for c in range(3):
            x = 0.0
            for i in range(k):
                x += trial[i] * s[corner[i], c]
            d += x * x
        if d < best:
            best, best_face = d, face
            for i in range(k):
                found[i] = trial[i]
    k = 0
    for i in range(size):
        if best_face & (1 << i):
            for c in range(3):
                s[k, c] = s[i, c]
            weights[k] = found[k]
            k += 1
    return k


@njit
def span_pairs(box_a: Array, covers_a: Mask, box_b: Array, covers_b: Mask, margin: float, pairs: Index) -> int:
    """Window (paper 4.4): the pairs of knot spans whose own control points' boxes (spans, 6) come within `margin`, into
    pairs (n, 2).

    Returns how many there are; only as many as fit are written.
    """
    # the box of each body's spans that come near the other's whole box
    low_a, high_a = whole(box_a)
    low_b, high_b = whole(box_b)
    near_b = np.empty(len(box_b), np.int64)
    count_b = 0
    for k in range(len(box_b)):
        if covers_b[k] and near(box_b, k, low_a, high_a, margin):
            near_b[count_b] = k
            count_b += 1
    count = 0
    for k in range(len(box_a)):
        if not (covers_a[k] and near(box_a, k, low_b, high_b, margin)):
            continue
        for t in range(count_b):
            l = near_b[t]
            if near(box_a, k, box_b[l, 0:3], box_b[l, 3:6], margin):
                if count < len(pairs):
                    pairs[count, 0], pairs[count, 1] = k, l
                count += 1
    return count


@njit
def whole(box: Array) -> tuple[Array, Array]:
    """Low and high corner of all boxes (n, 6)."""
    low, high = box[0, 0:3].copy(), box[0, 3:6].copy()
    for k in range(1, len(box)):
        for c in range(3):
            low[c] = min(low[c], box[k, c])
            high[c] = max(high[c], box[k, 3 + c])
    return low, high


@njit_in_place
def near(box: Array, k: int, low: Array, high: Array, margin: float) -> bool:
    """Box k comes within `margin` of the box from low to high, along each axis."""
    meets = True
    for c in range(3):
        meets = meets and box[k, c] <= high[c] + margin and box[k, 3 + c] >= low[c] - margin
    return meets


def greville(knots: Array, degree: int) -> Array:
    """The parameter associated with each control point: the mean of its inner knots (Piegl and Tiller, section
    9.2.1)."""
    count = len(knots) - degree - 1
    return np.array([knots[i + 1 : i + degree + 1].mean() for i in range(count)])


def paper_window(surface: BSplineSurface, patch: Patch, facet_meets: Callable[[Array], Mask], within: bool) -> Mask:
    """The paper's window (4.4), one flag per knot span: from u_min to u_max, v_min to v_max of the control points of
    facets that meet the other body.

    facet_meets : tells for facets (f, 3, 3) which ones meet it. within : the other body lies inside the hull and meets
    no facet, or the hull lies inside the other body; the whole surface is the window then.
    """
    net = patch.net[..., :3] / patch.net[..., 3:]
    hull = convex_hull(net.reshape(-1, 3))
    meets = facet_meets(net.reshape(-1, 3)[hull.facets])
    spans = np.zeros((patch.tally[0, 0], patch.tally[0, 1]), dtype=np.bool_)
    if not meets.any():
        spans[:] = within
        return spans.ravel()
    i, j = np.unravel_index(np.unique(hull.facets[meets]), net.shape[:2])
    limits = []
    for knots, degree, at, t, rows, count in (
        (surface.knots_u, surface.degree_u, i, patch.u, patch.row_u, patch.tally[0, 0]),
        (surface.knots_v, surface.degree_v, j, patch.v, patch.row_v, patch.tally[0, 1]),
    ):
        parameter = greville(knots, degree)[at]
        border = t[rows[0, : count + 1]]
        limits.append((border[1:] >= parameter.min()) & (border[:-1] <= parameter.max()))
    spans[np.ix_(limits[0], limits[1])] = True
    return spans.ravel()
