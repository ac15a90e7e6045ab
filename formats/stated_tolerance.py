"""What a file calls exact: the uncertainty, resolution or tolerance that it states for a face's geometry, where it means one.

STEP states it in the context of each representation (UNCERTAINTY_MEASURE_WITH_UNIT), IGES in its 19th global parameter, 3DM in
the model's settings. Sculpted faces may be as far apart along their common edges, and no farther.
"""

from __future__ import annotations

import math

from .part import Face, Part

LARGEST = 1e-3
"""Of the part: a larger one would let edges gape."""

SMALLEST = 1e-14
"""Of the part: what coordinates of double precision tell apart."""


def stated_tolerance(part: Part, face: Face) -> tuple[float, str]:
    """The distance, mm, within which the file takes two points of a face for one, and what to say where that makes no sense.

    0 where the file states none, or none to believe.
    """
    value = part.tolerance_of(face.number)
    if value is None:
        return 0.0, ""
    size = part.extent
    if math.isfinite(value) and SMALLEST * size <= value <= LARGEST * size and value > 0.0:
        return value, ""
    why = (
        "is no distance"
        if not (math.isfinite(value) and value > 0.0)
        else f"is more than {LARGEST:g} of the part"
        if value > LARGEST * size
        else "is less than its numbers can tell"
    )
    said = f"the tolerance that the file states, {value:.3g} mm, {why}: sculpted edges are held to the tolerances of its edges"
    return 0.0, f"{said}, or 1e-7 of a face's size"
