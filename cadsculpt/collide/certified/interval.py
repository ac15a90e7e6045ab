"""A certified distance: what is asked, how far the search is, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError

Array = NDArray[np.float64]

BUDGET = 200_000
"""Pairs of cells (or cells) that a search looks at before it gives up: about a second."""


@dataclass(frozen=True, slots=True, eq=False)
class Witness:
    """One of the two points that attain the upper bound: point (3,), face and (u, v) on it; -1 and NaN where the body
    has none."""

    point: Array
    face: int = -1
    u: float = np.nan
    v: float = np.nan


@dataclass(frozen=True, slots=True, eq=False)
class DistanceInterval:
    """The true distance lies in [low, high].

    a, b : points of either body that are `high` apart at most, or None where no pair of points was asked for.
    decided : the interval is as narrow as was asked, or lies on one side of the threshold. exhausted : the budget ended
    the search; the interval is no less true. pairs : pairs of cells looked at.
    """

    low: float
    high: float
    a: Witness | None
    b: Witness | None
    decided: bool
    exhausted: bool
    pairs: int

    def narrowed(self, other: DistanceInterval) -> DistanceInterval:
        """What two searches for the same distance prove together; decided as the second one is."""
        best = self if self.high <= other.high else other
        return DistanceInterval(
            max(self.low, other.low), best.high, best.a, best.b, other.decided, other.exhausted,
            self.pairs + other.pairs,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Goal:
    """What ends a search: high - low <= tolerance; where a threshold is given, low above it or high not above it; or
    `budget` pairs of cells."""

    tolerance: float
    threshold: float | None = None
    budget: int = BUDGET

    def __post_init__(self) -> None:
        if not (np.isfinite(self.tolerance) and self.tolerance >= 0):
            raise InputError(f"a distance tolerance of {self.tolerance}", mend="give a number that is not negative")
        if self.threshold is not None and not (np.isfinite(self.threshold) and self.threshold >= 0):
            raise InputError(f"a distance threshold of {self.threshold}", mend="give a number that is not negative")
        if not self.budget >= 1:
            raise InputError(f"a budget of {self.budget} pairs", mend="give a positive number")

    @property
    def enough(self) -> float:
        """An upper bound this low ends a search."""
        return max(self.tolerance, self.threshold or 0.0)


@dataclass(slots=True, eq=False)
class Search:
    """Where a search stands. `settled` : the least lower bound of all that was put aside."""

    goal: Goal
    high: float = np.inf
    low: float = 0.0
    settled: float = np.inf
    a: Witness | None = None
    b: Witness | None = None
    pairs: int = 0
    turned: bool = field(default=False)

    @property
    def cutoff(self) -> float:
        """What has a lower bound of this or more need not be looked at."""
        cutoff = self.high - self.goal.tolerance
        if self.goal.threshold is not None and self.goal.threshold < cutoff:
            # above the threshold is all that is asked
            cutoff = np.nextafter(self.goal.threshold, np.inf)
        return float(cutoff)

    @property
    def left(self) -> int:
        """What is left of the budget."""
        return max(0, self.goal.budget - self.pairs)

    @property
    def ended(self) -> bool:
        """Nothing more is to be found out, or the budget is spent."""
        return self.decided or self.pairs >= self.goal.budget

    @property
    def decided(self) -> bool:
        """The interval is as narrow as was asked, or on one side of the threshold."""
        t = self.goal.threshold
        return self.high - self.low <= self.goal.tolerance or (t is not None and (self.low > t or self.high <= t))

    def lower_high(self, high: float, a: Witness | None, b: Witness | None) -> None:
        """Take in a pair of points, where they are nearer."""
        if not np.isfinite(high):
            raise InputError("a distance is not a number", mend="check the bodies for NaN")
        if high < self.high:
            self.high, self.a, self.b = high, a, b

    def settle(self, lower: float) -> None:
        """Put aside something with this lower bound."""
        self.settled = min(self.settled, lower)

    def bound(self, lower: float) -> None:
        """All that is not put aside is at least this far."""
        self.low = max(self.low, min(self.settled, lower, self.high))

    def interval(self, *, swapped: bool = False) -> DistanceInterval:
        """The answer."""
        a, b = (self.b, self.a) if swapped else (self.a, self.b)
        return DistanceInterval(self.low, self.high, a, b, self.decided, not self.decided, self.pairs)
