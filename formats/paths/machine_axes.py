"""Five-axis machines: from the rotary axes A or B and C to the tool as it stands on the part.

    xyzac-trt, xyzbc-trt      a tilting table (A about x, or B about y) carries a rotary table (C about z)
    xyzac-head, xyzbc-head    a head turns about z (C) and carries a tilting axis (A, or B)

A table turns the part, so the tool turns the other way as the part sees it: R = Rz(-C) Rx(-A) or Rz(-C) Ry(-B). A head
turns the tool: R = Rz(C) Rx(A) or Rz(C) Ry(B). The tool's own axis is R z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...motion.pose import rotation_matrix
from ...scene_tool import PathOptions

Array = NDArray[np.float64]

_X, _Y, _Z = np.eye(3)


@dataclass(frozen=True, slots=True)
class MachineAxes:
    """tilt : 3 for A, 4 for B, the place of the tilting axis in (x, y, z, a, b, c). table : the part turns, not the tool.

    tip : x, y, z are the tool's tip on the part; else the machine's slides, with `pivot` (3,) where a table's axes cross
    and `reach` from a head's axes to the tip, in the scene's unit.
    """

    tilt: int
    table: bool
    tip: bool = True
    pivot: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reach: float = 0.0

    @classmethod
    def of(cls, options: PathOptions) -> MachineAxes | None:
        """The machine that a scene names; None when it names none."""
        if options.kinematics is None:
            return None
        axes, kind = options.kinematics.split("-")
        return cls(3 if "a" in axes else 4, kind == "trt", options.tip, options.pivot, options.reach)

    def allows(self, index: int) -> bool:
        """Whether the machine has the axis of that place."""
        return index in (0, 1, 2, self.tilt, 5)

    def pose(self, place: Array) -> tuple[Array, Array]:
        """The tip (3,) and rotation (3, 3) of the tool on the part; place (6,): lengths and degrees."""
        tilt, turn = float(place[self.tilt]), float(place[5])
        sign = -1.0 if self.table else 1.0
        tilted = rotation_matrix(_X if self.tilt == 3 else _Y, sign * tilt)
        rotation = rotation_matrix(_Z, sign * turn) @ tilted
        at = np.array(place[:3])
        if self.tip:
            return at, rotation
        if self.table:
            pivot = np.array(self.pivot)
            return rotation @ (at - pivot) + pivot, rotation
        # with the head upright the slides say where the tip is
        return at + self.reach * (_Z - rotation @ _Z), rotation
