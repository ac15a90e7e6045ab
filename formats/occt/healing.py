"""What the kernel mends on reading, and what it must leave alone."""

from __future__ import annotations

from typing import Any

from OCP.DE import DE_ShapeFixParameters
from OCP.TCollection import TCollection_AsciiString

_CUTS = (
    "FixSelfIntersectionMode",
    "FixSelfIntersectingEdgeMode",
    "FixIntersectingEdgesMode",
    "FixNonAdjacentIntersectingEdgesMode",
    "FixTailMode",
)
"""Where trim curves cross, or nearly do, the kernel cuts them off and moves their vertex."""

_BRIDGES = ("FixLackingMode",)
"""Where trim curves do not quite meet, the kernel puts short ones between them; in STEP, where edges that are points are not
written, it brings those back."""

_DEFAULTS = {
    "step": {"FixTailMode": "0"},
    "iges": {"CreateOpenSolidMode": "1", "FixTailMode": "-1", "MaxTailAngle": "-1"},
}
"""Where the readers' own values differ from each other."""


def set_healing(reader: Any, format: str, *, own: bool) -> None:
    """Tell a reader that has loaded a file how to mend it: as it does by itself, but for files that cadsculpt wrote.

    own : cadsculpt wrote the file, from a part that was read; its trim curves are not to be cut. The kernel keeps the
    values for the files to come, so that they are set for every one.
    """
    reader.SetShapeFixParameters(DE_ShapeFixParameters())
    values = reader.GetShapeFixParameters()
    left = _CUTS if format == "step" else _CUTS + _BRIDGES
    chosen = {**dict.fromkeys(_CUTS + _BRIDGES, "-1"), **_DEFAULTS[format], **(dict.fromkeys(left, "0") if own else {})}
    for name, value in chosen.items():
        values.Bind(TCollection_AsciiString(f"FixShape.{name}"), TCollection_AsciiString(value))
    reader.SetShapeFixParameters(values)
