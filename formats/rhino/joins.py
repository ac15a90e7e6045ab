"""Trim curves whose ends do not meet, kept whole in a Brep that openNURBS takes.

openNURBS wants the trim curves of a loop to meet within 1e-10; those of other CAD systems meet within a length in space.
No end is moved. Such a curve becomes a piece of an ON_PolyCurve, and short curves lead from it to its neighbours, each
over JOIN of its parameter range: by that width they are known when the file is read, and left out again. A polycurve of the
curve alone says that a loop along the sides of the domain is a loop, and not the mere end of the surface.
Layout after the public openNURBS sources (opennurbs_polycurve.cpp).
"""

from __future__ import annotations

import uuid

import numpy as np
from numpy.typing import NDArray

from .archive import CLASS_DATA, Reader, Writer, class_chunk, class_record
from .nurbs import EMPTY_BOX, NURBS_CURVE, Nurbs, nurbs_chunk

Array = NDArray[np.float64]

POLYCURVE = uuid.UUID("4ED7D4E0-E947-11d3-BFE5-0010830122F0")

JOIN = 2.0**-10
"""Parameter range of a curve that joins, as a fraction of that of the curve that it leads to."""


def joined_chunk(
    curve: Nurbs, before: Array | None, after: Array | None, version: int, *, explicit: bool = False
) -> tuple[bytes, tuple[float, float]]:
    """The chunk of a clamped 2D curve and its domain, with the curves that join it to its neighbours.

    before, after : (m, 2) Bezier points from a neighbour's end to this curve's start, from its end to a neighbour's start;
    None for no such curve. explicit : as a polycurve in any case.
    """
    whole = nurbs_chunk(curve, version)
    low, high = float(curve.knots[0][0]), float(curve.knots[0][-1])
    if before is None and after is None and not explicit:
        return whole, (low, high)
    segments, breaks = [whole], [low, high]
    start, end = _outer(low, high)
    if before is not None:
        segments.insert(0, _bezier_chunk(before, start, low, version))
        breaks.insert(0, start)
    if after is not None:
        segments.append(_bezier_chunk(after, high, end, version))
        breaks.append(end)
    body = Writer(version)
    body.begin(CLASS_DATA)
    body.raw(b"\x10")
    body.integers(len(segments), 0, 0)
    body.reals(np.array(EMPTY_BOX))
    body.integers(len(breaks))
    body.reals(np.array(breaks))
    for segment in segments:
        body.whole(segment)
    body.end()
    return class_chunk(POLYCURVE, body), (breaks[0], breaks[-1])


def without_joins(chunk: bytes, domain: tuple[float, float], version: int) -> tuple[bytes, tuple[float, float]]:
    """The curve of `joined_chunk` and its own domain, when `chunk` over `domain` is one; else both as they are."""
    record = class_record(chunk, 0, len(chunk), version)
    if record.class_id != POLYCURVE:
        return chunk, domain
    reader = Reader(chunk, record.data.body, record.data.end - 4, version)
    reader.raw(1)
    (count, _, _) = reader.integers(3)
    reader.reals(6)
    breaks = reader.reals(reader.integer()).tolist()
    segments = [reader.chunk() for _ in range(count)]
    if count not in (1, 2, 3) or len(breaks) != count + 1 or domain != (breaks[0], breaks[-1]):
        return chunk, domain
    if any(class_record(chunk, s.start, s.end, version).class_id != NURBS_CURVE for s in segments):
        return chunk, domain
    for place in range(count):
        low, high = breaks[place], breaks[place + 1]
        start, end = _outer(low, high)
        expected = [start] * place + [low, high] + [end] * (count - 1 - place)
        if place < 2 and expected == breaks:
            own = segments[place]
            return chunk[own.start : own.end], (low, high)
    return chunk, domain


def _outer(low: float, high: float) -> tuple[float, float]:
    """Where the curves before and after one over [low, high] start and end."""
    width = JOIN * (high - low)
    return low - width, high + width


def _bezier_chunk(points: Array, low: float, high: float, version: int) -> bytes:
    degree = len(points) - 1
    return nurbs_chunk(Nurbs(2, False, (degree,), (np.repeat([low, high], degree),), points), version)
