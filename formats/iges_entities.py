"""Whether the entities of an IGES file are what they should be: enough to tell a damaged file before the kernel reads it.

Layouts after IGES 5.3, section 4: rational B-spline curve (126) and surface (128), and the pointers that composite curves,
curves on surfaces, bounded and trimmed surfaces and boundary representations hold.
"""

from __future__ import annotations

import math
from itertools import pairwise

from .iges_records import Entity, IgesFile

_GEOMETRY = set(range(100, 146)) - {132, 134, 136, 138}
"""Types whose parameters are all numbers."""

_COMPLETE_TO = {126: 0, 128: 0, 144: 5, 143: 4, 142: 6, 141: 5, 102: 2, 110: 7, 100: 8, 120: 5, 122: 5, 108: 5, 124: 13}
"""Least number of parameters, the type included; the splines have counts of their own."""

_POINTERS = {142: (2, 3, 4), 144: (1, 4), 120: (1, 2), 122: (1,), 186: (1,), 140: (5,)}
"""Places of parameters that must point into the directory (142's space curve may be missing)."""

_LISTS = {102: (1, 2, 1), 514: (1, 2, 2), 508: (1, 3, 5), 144: (3, 5, 1)}
"""Type: place of a count, place of the first pointer, step to the next."""


def damaged_entities(file: IgesFile) -> int:
    """How many entities have parameters missing, no numbers where numbers must be, or pointers into nowhere."""
    last = 2 * len(file.entities)
    return sum(not _sound(entity, last) for entity in file.entities)


def _sound(entity: Entity, last: int) -> bool:
    if entity.fields[0].strip() != entity.fields[10].strip():
        return False
    p, kind = entity.parameters, entity.type
    if not p or len(p) < _COMPLETE_TO.get(kind, 1):
        return False
    if kind in (126, 128):
        return _sound_spline(p)
    if kind in _GEOMETRY and not all(token == "" or number(token) is not None for token in p[:40]):
        return False
    places = list(_POINTERS.get(kind, ()))
    if kind in _LISTS:
        at, first, step = _LISTS[kind]
        count = _count(p, at)
        if count is None or first + step * (count - 1) >= len(p):
            return False
        if kind != 508:  # its list is of varying length
            places += range(first, first + step * count, step)
    return all(_points(p, place, last) for place in places)


def _points(p: list[str], place: int, last: int) -> bool:
    """A parameter is a directory entry's number, or 0 or empty for none."""
    if place >= len(p) or p[place] == "":
        return True
    try:
        value = abs(int(p[place]))
    except ValueError:
        return False
    return value == 0 or (value % 2 == 1 and value < last)


def _count(p: list[str], place: int) -> int | None:
    try:
        value = int(p[place]) if p[place] else 0
    except (ValueError, IndexError):
        return None
    return value if 0 <= value < 10**6 else None


def number(token: str) -> float | None:
    """A number as IGES writes it (1.5D-3 as well), None when it is none; an empty parameter is 0."""
    try:
        value = float(token.replace("D", "E").replace("d", "e")) if token else 0.0
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def spline_counts(p: list[str]) -> tuple[list[int], list[int]] | None:
    """Upper indices and degrees of a B-spline curve (one each) or surface (two each); None when they cannot be."""
    if not p:
        return None
    surface = p[0].strip() == "128"
    heads = [_count(p, i) for i in range(1, 5 if surface else 3)]
    if any(head is None for head in heads):
        return None
    numbers = [head for head in heads if head is not None]
    upper, degree = (numbers[:2], numbers[2:]) if surface else (numbers[:1], numbers[1:])
    return (upper, degree) if all(1 <= m <= k for k, m in zip(upper, degree, strict=True)) else None


def _sound_spline(p: list[str]) -> bool:
    """A B-spline curve or surface has as many knots, weights and points as its degrees ask, knots ascend, weights > 0.

    The parameter range at the end may be missing: it is that of the knots.
    """
    counts = spline_counts(p)
    if counts is None:
        return False
    upper, degree = counts
    surface = len(upper) == 2
    at = 10 if surface else 7
    lengths = [k + m + 2 for k, m in zip(upper, degree, strict=True)]
    poles = math.prod(k + 1 for k in upper)
    if len(p) < at + sum(lengths) + 4 * poles:
        return False
    values = [number(token) for token in p[at : at + sum(lengths) + 4 * poles + 2 * len(upper)]]
    if any(value is None for value in values):
        return False
    reals = [value for value in values if value is not None]
    begin = 0
    for length, m in zip(lengths, degree, strict=True):
        knots = reals[begin : begin + length]
        if any(b < a for a, b in pairwise(knots)) or knots[m] >= knots[-m - 1]:
            return False
        begin += length
    return all(weight > 0.0 for weight in reals[begin : begin + poles])


def creased_surfaces(file: IgesFile) -> int:
    """How many B-spline surfaces (128) have inner knots repeated as often as the degree, where they may have a crease."""
    return sum(entity.type == 128 and _creased(entity.parameters) for entity in file.entities)


def _creased(p: list[str]) -> bool:
    if not _sound_spline(p):
        return False
    upper, degree = [int(p[1]), int(p[2])], [int(p[3]), int(p[4])]
    begin = 10
    for k, m in zip(upper, degree, strict=True):
        knots = [number(token) for token in p[begin : begin + k + m + 2]]
        inner = knots[m + 1 : k + 1]
        if any(knots[m] != knot != knots[-m - 1] and inner.count(knot) >= m for knot in set(inner)):
            return True
        begin += k + m + 2
    return False
