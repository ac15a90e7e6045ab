"""Periodic surfaces whose period begins before their face: where a face reaches over the first knot, a kernel that writes it
takes the surface, and its trim curves with it, a period on. `begun` moves the beginning, and nothing has to go on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from OCP.Geom import Geom_BSplineSurface

from .arrays import reals
from .face import OcctFace, periodic_window

Array = NDArray[np.float64]

Starts = tuple[float | None, float | None]


@dataclass(frozen=True, slots=True, eq=False)
class _Axis:
    """One direction of a surface that the kernel holds."""

    knots: Callable[[], Array]
    set_knots: Callable[[Array], None]
    set_origin: Callable[[int], None]

    def begin(self, start: float) -> Callable[[], None]:
        """Let the period begin at the last knot at or before `start`, turns of it apart. Returns what takes that back."""
        old = self.knots()
        period, slack = old[-1] - old[0], 1e-9 * (old[-1] - old[0])
        turns = float(np.floor((start - old[0] + slack) / period))
        first = int(np.searchsorted(old[:-1], start - turns * period + slack, side="right")) - 1
        if first:
            self.set_origin(first + 1)
        # the same sums as those of the surface that was read
        self.set_knots(np.concatenate([old[first:-1] + turns * period, old[: first + 1] + (turns + 1.0) * period]))

        def take_back() -> None:
            if first:
                self.set_origin(len(old) - first)
            self.set_knots(old)

        return take_back


def begun(faces: Iterable[OcctFace]) -> Callable[[], None]:
    """Let the periodic B-spline surfaces of faces begin where the faces' own domains do. Returns what takes it back.

    Left alone is a surface that several faces share which want it to begin at different places.
    """
    wanted: list[tuple[Geom_BSplineSurface, Starts]] = []
    for face in faces:
        geom = face.geom
        if not isinstance(geom, Geom_BSplineSurface) or not (geom.IsUPeriodic() or geom.IsVPeriodic()):
            continue
        start = periodic_window(geom, face.uv_bounds)[1]
        known = next((k for k, (other, _) in enumerate(wanted) if other is geom), None)
        if known is None:
            wanted.append((geom, start))
        elif wanted[known][1] != start:
            wanted[known] = geom, (None, None)
    undo = [
        axis.begin(start)
        for geom, starts in wanted
        for axis, start in zip(_axes(geom), starts, strict=True)
        if start is not None
    ]

    def take_back() -> None:
        for step in reversed(undo):
            step()

    return take_back


def _axes(geom: Geom_BSplineSurface) -> tuple[_Axis, _Axis]:
    return (
        _Axis(
            lambda: np.array([geom.UKnot(i) for i in range(1, geom.NbUKnots() + 1)]),
            lambda knots: geom.SetUKnots(reals(knots)),
            geom.SetUOrigin,
        ),
        _Axis(
            lambda: np.array([geom.VKnot(i) for i in range(1, geom.NbVKnots() + 1)]),
            lambda knots: geom.SetVKnots(reals(knots)),
            geom.SetVOrigin,
        ),
    )
