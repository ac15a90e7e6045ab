"""Round numbers for the axes of plots and the scale bars of pictures."""

from __future__ import annotations

import math


def round_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten in [low, high], at most `most`; [low] when there is no range."""
    span = high - low
    if not span > 0.0 or not math.isfinite(span):
        return [low]
    power = 10.0 ** math.floor(math.log10(span / most))
    step = next(s * power for s in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if math.floor(span / (s * power)) + 1 <= most)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [n * step for n in range(first, last + 1)]


def tick_label(value: float) -> str:
    """A tick as people write it: no trailing zeros, no rounding dust."""
    return f"{value:.6g}"
