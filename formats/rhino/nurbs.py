"""openNURBS' NURBS curves and surfaces in an archive (opennurbs_nurbscurve.cpp, opennurbs_nurbssurface.cpp)."""

from __future__ import annotations

import uuid
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from .archive import CLASS_DATA, Reader, Writer, class_chunk

Array = NDArray[np.float64]

NURBS_SURFACE = uuid.UUID("4ED7D4DE-E947-11d3-BFE5-0010830122F0")
NURBS_CURVE = uuid.UUID("4ED7D4DD-E947-11d3-BFE5-0010830122F0")


@dataclass(frozen=True, slots=True, eq=False)
class Nurbs:
    """A NURBS curve or surface as the archive has it: homogeneous control points, n + degree - 1 knots a direction.

    dimension is that of the space (2 for trim curves); points (n, ...) or (r, s, ...) with the weight last when
    rational.
    """

    dimension: int
    rational: bool
    degrees: tuple[int, ...]
    knots: tuple[Array, ...]
    points: Array

    def padded_knots(self, axis: int) -> Array:
        """The usual n + degree + 1 knots. The two that openNURBS leaves out have no influence inside the domain."""
        knots, degree = self.knots[axis], self.degrees[axis]
        low, high = knots[0], knots[-1]
        period = knots[-degree] - knots[degree - 1]
        if degree > 1 and low < knots[degree - 1] and high > knots[-degree]:
            low, high = knots[-2 * degree] - period, knots[2 * degree - 1] + period
            low, high = min(low, knots[0]), max(high, knots[-1])
        return np.concatenate([[low], knots, [high]])

    def control_points(self) -> Array:
        """Euclidean control points (..., dimension)."""
        return self.points[..., :-1] / self.points[..., -1:] if self.rational else self.points

    def weights(self) -> Array | None:
        return np.ascontiguousarray(self.points[..., -1]) if self.rational else None


def read_nurbs(reader: Reader, directions: int) -> Nurbs:
    """ON_NurbsCurve (1 direction) or ON_NurbsSurface (2) from the start of its class data."""
    if reader.byte() >> 4 != 1:
        raise InputError("a NURBS object of an unknown version", mend="save the file as an earlier 3DM version")
    dimension, rational = reader.integers(2)
    orders = reader.integers(directions)
    counts = reader.integers(directions)
    reader.raw(8 + 48)
    knots = tuple(reader.reals(reader.integer()) for _ in range(directions))
    size = dimension + bool(rational)
    total = reader.integer()
    if total != int(np.prod(counts)) or any(
        len(k) != n + order - 2 for k, n, order in zip(knots, counts, orders, strict=True)
    ):
        raise InputError("a NURBS object with the wrong number of knots or control points", mend="the file is damaged")
    points = reader.reals(total * size).reshape(*counts, size)
    return Nurbs(dimension, bool(rational), tuple(order - 1 for order in orders), knots, points)


def nurbs_chunk(nurbs: Nurbs, version: int, after: bytes = b"") -> bytes:
    """The TCODE_OPENNURBS_CLASS chunk of an ON_NurbsCurve or ON_NurbsSurface; `after` as in `class_chunk`."""
    body = Writer(version)
    body.begin(CLASS_DATA)
    curve = len(nurbs.degrees) == 1
    friendly = curve and version >= 60
    body.raw(b"\x11" if friendly else b"\x10")
    body.integers(nurbs.dimension, int(nurbs.rational))
    body.integers(*(degree + 1 for degree in nurbs.degrees))
    body.integers(*nurbs.points.shape[:-1])
    body.integers(0, 0)
    body.reals(np.array(EMPTY_BOX))
    for knots in nurbs.knots:
        body.integers(len(knots))
        body.reals(knots)
    body.integers(int(np.prod(nurbs.points.shape[:-1])))
    body.reals(nurbs.points)
    if friendly:
        body.raw(b"\x00")
    body.end()
    return class_chunk(NURBS_CURVE if curve else NURBS_SURFACE, body, after)


EMPTY_BOX = (1.0, 0.0, 0.0, -1.0, 0.0, 0.0)
"""How openNURBS writes the bounding box that nobody has computed."""
