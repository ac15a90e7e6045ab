"""Trim curves with more than themselves in a Brep that openNURBS takes: what joins them, and poles inside the domain.

openNURBS wants the trim curves of a loop to meet within 1e-10; those of other CAD systems meet within a length in space.
No end is moved. Such a curve becomes a piece of an ON_PolyCurve, and short curves lead from it to its neighbours, each
over JOIN of its parameter range: by that width they are known when the file is read, and left out again. A curve of no length
in space that runs along no side of the domain is no trim of openNURBS: it becomes a piece of its neighbour's polycurve, over
ABSORBED of its range and with the knots that it has, and is a trim curve of its own again when the file is read. A polycurve
of the curve alone says that a loop along the sides of the domain is a loop, and not the mere end of the surface.
Layout after the public openNURBS sources (opennurbs_polycurve.cpp).
"""

from __future__ import annotations

import uuid
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .archive import CLASS_DATA, Reader, Writer, class_chunk, class_record
from .nurbs import EMPTY_BOX, NURBS_CURVE, Nurbs, nurbs_chunk, read_nurbs

Array = NDArray[np.float64]
Piece = Nurbs | Array
"""A clamped 2D curve that was absorbed, or the (m, 2) Bezier points of a curve that joins."""

Part = tuple[bytes, tuple[float, float]]
"""The chunk of a curve, and its domain."""

POLYCURVE = uuid.UUID("4ED7D4E0-E947-11d3-BFE5-0010830122F0")

JOIN = 2.0**-10
"""Parameter range of a curve that joins, as a fraction of that of the curve that it leads to."""

ABSORBED = 2.0**-9
"""Parameter range of an absorbed curve, as a fraction of that of the curve that absorbs it."""


def joined_chunk(
    curve: Nurbs, before: Sequence[Piece], after: Sequence[Piece], version: int, *, explicit: bool = False
) -> Part:
    """The chunk of a clamped 2D curve and its domain, with the pieces that come before and after it in its polycurve.

    Each piece starts where the one before it ends. explicit : as a polycurve in any case.
    """
    whole = nurbs_chunk(curve, version)
    low, high = float(curve.knots[0][0]), float(curve.knots[0][-1])
    if not before and not after and not explicit:
        return whole, (low, high)
    segments, breaks = [whole], [low, high]
    for piece in reversed(before):
        start = breaks[0] - _share(piece) * (high - low)
        segments.insert(0, _piece_chunk(piece, start, breaks[0], version))
        breaks.insert(0, start)
    for piece in after:
        end = breaks[-1] + _share(piece) * (high - low)
        segments.append(_piece_chunk(piece, breaks[-1], end, version))
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


def without_joins(chunk: bytes, domain: tuple[float, float], version: int) -> Part:
    """The curve of `joined_chunk` and its own domain, when `chunk` over `domain` is one; else both as they are."""
    parts, own = parts_of(chunk, domain, version)
    return parts[own]


def parts_of(chunk: bytes, domain: tuple[float, float], version: int) -> tuple[list[Part], int]:
    """The curve of `joined_chunk` among those that it absorbed, in their order, and its place there.

    When `chunk` over `domain` is no such curve, it is the only one.
    """
    alone = [(chunk, domain)], 0
    record = class_record(chunk, 0, len(chunk), version)
    if record.class_id != POLYCURVE:
        return alone
    reader = Reader(chunk, record.data.body, record.data.end - 4, version)
    reader.raw(1)
    (count, _, _) = reader.integers(3)
    reader.reals(6)
    breaks = reader.reals(reader.integer()).tolist()
    segments = [reader.chunk() for _ in range(count)]
    if len(breaks) != count + 1 or domain != (breaks[0], breaks[-1]):
        return alone
    if any(class_record(chunk, s.start, s.end, version).class_id != NURBS_CURVE for s in segments):
        return alone
    for place in range(count):
        shares = _shares(breaks, place)
        if shares is None:
            continue
        parts: list[Part] = []
        own = 0
        for i, (segment, share) in enumerate(zip(segments, shares, strict=True)):
            piece = chunk[segment.start : segment.end]
            if i == place:
                own = len(parts)
                parts.append((piece, (breaks[i], breaks[i + 1])))
            elif share == ABSORBED:
                parts.append((piece, _domain(piece, version)))
        return parts, own
    return alone


def _shares(breaks: Sequence[float], place: int) -> list[float] | None:
    """What share of the segment at `place` each segment has, when all others are JOIN or ABSORBED of it; else None."""
    width = breaks[place + 1] - breaks[place]
    found = []
    for i, (start, end) in enumerate(zip(breaks[:-1], breaks[1:], strict=True)):
        for share in (1.0,) if i == place else (JOIN, ABSORBED):
            if i == place or (end - share * width == start if i < place else start + share * width == end):
                found.append(share)
                break
        else:
            return None
    return found


def _domain(chunk: bytes, version: int) -> tuple[float, float]:
    """The domain of a clamped ON_NurbsCurve."""
    record = class_record(chunk, 0, len(chunk), version)
    (knots,) = read_nurbs(Reader(chunk, record.data.body, record.data.end - 4, version), 1).knots
    return float(knots[0]), float(knots[-1])


def _share(piece: Piece) -> float:
    return ABSORBED if isinstance(piece, Nurbs) else JOIN


def _piece_chunk(piece: Piece, low: float, high: float, version: int) -> bytes:
    """An absorbed curve over the knots that it has, a joining one over [low, high]."""
    if isinstance(piece, Nurbs):
        return nurbs_chunk(piece, version)
    degree = len(piece) - 1
    return nurbs_chunk(Nurbs(2, False, (degree,), (np.repeat([low, high], degree),), piece), version)
