"""Lengths in a STEP file's records: which unit holds where, the file's tolerance, the areas that its sender recorded."""

from __future__ import annotations

import re

from .step_records import StepRecords

_PREFIX = {
    "EXA": 1e18, "PETA": 1e15, "TERA": 1e12, "GIGA": 1e9, "MEGA": 1e6, "KILO": 1e3, "HECTO": 1e2, "DECA": 10.0,
    "DECI": 0.1, "CENTI": 1e-2, "MILLI": 1e-3, "MICRO": 1e-6, "NANO": 1e-9, "PICO": 1e-12, "FEMTO": 1e-15, "ATTO": 1e-18,
}  # fmt: skip
_NUMBER = rb"([-+]?[0-9.]+(?:[eE][-+]?\d+)?)"
_MEASURE = re.compile(
    rb"(?:LENGTH|AREA|VOLUME|POSITIVE_LENGTH)_MEASURE\s*\(\s*" + _NUMBER + rb"\s*\)"
    rb"|MEASURE_WITH_UNIT\s*\(\s*" + _NUMBER + rb"\s*,",
    re.IGNORECASE,
)
REPRESENTATION_CONTEXT = "GLOBAL_UNIT_ASSIGNED_CONTEXT"
UNCERTAINTY_CONTEXT = "GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT"


def measure(body: bytes) -> float | None:
    """The number in LENGTH_MEASURE(...), AREA_MEASURE(...) or VOLUME_MEASURE(...), or in a MEASURE_WITH_UNIT that does not
    say what it measures; None when there is none."""
    match = _MEASURE.search(body)
    return float(match[1] or match[2]) if match else None


def millimetres(records: StepRecords, unit: int) -> float | None:
    """How many mm one of a length unit is; None for what is no length unit."""
    body = records.body(unit)
    if b"LENGTH_UNIT" not in body.upper():
        return None
    si = re.search(rb"SI_UNIT\s*\(\s*(?:\.(\w+)\.|\$)\s*,\s*\.METRE\.\s*\)", body, re.IGNORECASE)
    if si:
        return (_PREFIX.get(si[1].decode().upper(), 1.0) if si[1] else 1.0) * 1000.0
    for reference in records.references(unit):
        number = measure(records.body(reference))
        if number is not None:
            for below in records.references(reference):
                factor = millimetres(records, below)
                if factor is not None:
                    return number * factor
    return None


def millimetres_of_context(records: StepRecords, context: int) -> float | None:
    """How many mm the lengths of a representation context are in; None when it names no length unit."""
    units = records.arguments(context, REPRESENTATION_CONTEXT)
    for unit in _references_of(units):
        factor = millimetres(records, unit)
        if factor is not None:
            return factor
    return None


def contexts_above(records: StepRecords, number: int) -> set[int]:
    """The unit contexts of the representations that hold a record, wherever below."""
    seen, left, found = {number}, [number], set()
    while left:
        for user in records.users(left.pop()):
            if user in seen:
                continue
            seen.add(user)
            contexts = [r for r in records.references(user) if records.is_a(r, REPRESENTATION_CONTEXT)]
            if contexts:
                found.update(contexts)  # a representation: what uses it is another's business
            else:
                left.append(user)
    return found


def millimetres_at(records: StepRecords, number: int) -> float | None:
    """How many mm the lengths of a geometric record are in; None when it is in no representation or in two that differ."""
    factors = {millimetres_of_context(records, context) for context in contexts_above(records, number)}
    return factors.pop() if len(factors) == 1 else None


def tolerance_at(records: StepRecords, number: int) -> float | None:
    """The distance that the representation of a geometric record calls exact, mm; the smallest where it is in several, the
    largest of the uncertainties of one; None when none says."""
    found = []
    for context in contexts_above(records, number):
        stated = _references_of(records.arguments(context, UNCERTAINTY_CONTEXT))
        values = [value for n in stated if (value := _uncertainty(records, n)) is not None]
        if values:
            found.append(max(values))
    return min(found, default=None)


def _uncertainty(records: StepRecords, number: int) -> float | None:
    """An UNCERTAINTY_MEASURE_WITH_UNIT in mm; None where it is no length."""
    value = measure(records.body(number))
    factors = [millimetres(records, unit) for unit in records.references(number)]
    return value * factors[0] if value is not None and factors and factors[0] is not None else None


def tolerance(records: StepRecords) -> float | None:
    """The distance that the file calls exact, mm: the largest of its UNCERTAINTY_MEASURE_WITH_UNIT; None without any."""
    every = [_uncertainty(records, number) for number in records.of_type("UNCERTAINTY_MEASURE_WITH_UNIT")]
    return max((value for value in every if value is not None), default=None)


def coordinates(records: StepRecords, point: int) -> list[float]:
    """The coordinates of a CARTESIAN_POINT, in the file's unit, or of a DIRECTION."""
    arguments = records.arguments(point)
    values = [float(text) for text in arguments[1].strip(b"() \r\n\t").split(b",")]
    return (values + [0.0, 0.0, 0.0])[:3]


def _references_of(arguments: list[bytes]) -> list[int]:
    return [int(n) for argument in arguments for n in re.findall(rb"#\s*(\d+)", argument)]
