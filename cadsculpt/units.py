"""Length units. Everything but length is SI throughout (s, N, Pa, kg/m3)."""

from __future__ import annotations

from .errors import InputError

METRES_PER_UNIT: dict[str, float] = {
    "um": 1e-6,
    "mm": 1e-3,
    "cm": 1e-2,
    "dm": 1e-1,
    "m": 1.0,
    "km": 1e3,
    "in": 0.0254,
    "ft": 0.3048,
    "yd": 0.9144,
    "mi": 1609.344,
    "mil": 2.54e-5,
    "uin": 2.54e-8,
}

_ALIASES = {
    "micron": "um", "micrometre": "um", "micrometer": "um",
    "millimetre": "mm", "millimeter": "mm", "millimetres": "mm", "millimeters": "mm",
    "centimetre": "cm", "centimeter": "cm", "decimetre": "dm", "decimeter": "dm",
    "metre": "m", "meter": "m", "metres": "m", "meters": "m", "kilometre": "km", "kilometer": "km",
    "inch": "in", "inches": "in", "foot": "ft", "feet": "ft", "yard": "yd", "mile": "mi",
    "thou": "mil", "microinch": "uin",
}  # fmt: skip


def unit_name(text: str) -> str:
    """The canonical short name of a length unit ("inch", "IN" -> "in").

    Raises InputError when the unit is not known.
    """
    key = text.strip().lower()
    key = _ALIASES.get(key, key)
    if key not in METRES_PER_UNIT:
        raise InputError(f"unknown length unit {text!r}", mend=f"use one of {', '.join(METRES_PER_UNIT)}")
    return key


def metres_per_unit(unit: str) -> float:
    """How many metres one `unit` is. Raises InputError when the unit is not known."""
    return METRES_PER_UNIT[unit_name(unit)]


def conversion(source: str, target: str) -> float:
    """The factor that turns a length in `source` into one in `target`; exactly 1.0 when they are the same."""
    a, b = unit_name(source), unit_name(target)
    return 1.0 if a == b else METRES_PER_UNIT[a] / METRES_PER_UNIT[b]
