"""How large a tool may be at a spot of a face, how deep it may press, and the lattice that goes with it. In mm."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..motion.path import rotation_to_axis
from ..motion.pose import Pose
from ..tools.implicit import ImplicitTool
from .face_survey import FaceSurvey, Spot
from .part import Face

Array = NDArray[np.float64]

SHAPES = ("sphere", "ellipsoid", "capsule", "cylinder", "cone", "box", "torus", "point")
"""Tools that can be sized to a face. A half-space has no size, a surface, mesh or formula no usual one."""

SPLINES = ("bspline", "bezier")
PREFER_SPLINES = 8.0
"""A free-form face wins over another on which the dent would be up to this many times larger."""


@dataclass(frozen=True, slots=True)
class Wish:
    """What is asked of a press. radius : of the tool over the face's size at most, None for as large as fits.

    usual_nodes, most_nodes : on the face, about, as a rule and where the dent is small. steps : of the run, about.
    """

    radius: float | None = None
    usual_nodes: int = 4000
    most_nodes: int = 12000
    steps: int = 200

    @classmethod
    def quick(cls, radius: float | None = None) -> Wish:
        """A coarse lattice and few steps: a look in seconds."""
        return cls(radius, 900, 2500, 40)


DEEP = 0.05
"""How deep the tool presses, as a fraction of the face's size."""

THICK = 2.5
"""Thickness of the material over the depth of the press."""

MOST_LAYERS = 2
"""Cells through the thickness: each is higher than the press is deep, so that the topmost is not crushed flat alone."""

FLATTEST = 10.0
"""A cell is at most this many times wider than it is high."""


USUAL = Wish()


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """A tool above a spot of a face, in mm. scale : the radius of the ball that the tool fills, about.

    start, end : height of the tool's origin above the spot, along its normal, when the path begins and at its deepest.
    """

    survey: FaceSurvey
    spot: Spot
    scale: float
    depth: float
    start: float
    end: float
    thickness: float
    spacing: float
    score: float

    @property
    def layers(self) -> int:
        return int(np.clip(round(self.thickness / self.spacing), 1, MOST_LAYERS))

    @property
    def half_width(self) -> float:
        """Half the width of the dent that a ball makes."""
        return math.sqrt(max(2.0 * self.scale * self.depth - self.depth**2, 0.0))


def wanted(seen: FaceSurvey, spot: Spot, *, bold: bool, wish: Wish = USUAL) -> Press | None:
    """The tool and the press that a spot takes, not placed yet (start and end are 0).

    bold : as thick as the press asks for, wherever the survey says that a lattice on its samples would fold. None where
    nothing can be pressed, or where the lattice would have to be so thin that its cells are mere flakes.
    """
    scale = min(0.4 * spot.room, 0.7 * spot.free_radius)
    if wish.radius is not None:
        scale = min(scale, wish.radius * seen.size)
    limit = math.inf if bold else 0.65 * seen.fold / THICK
    depth = min(DEEP * min(seen.size, 3.0 * spot.room), 0.45 * scale, limit)
    if not depth > 0.0:
        return None
    thickness = THICK * depth
    sized = Press(seen, spot, scale, depth, 0.0, 0.0, thickness, 1.0, 0.0)
    spacing = _spacing(seen, sized.half_width, wish)
    if spacing > FLATTEST * thickness:
        return None
    return replace(sized, spacing=spacing, score=_score(seen, sized, spacing, wish))


def placed(press: Press, shape: str, around: Array) -> Press | None:
    """The press with a tool of this shape just above its spot, smaller if need be; None where none fits.

    around (k, 3) : points of the whole part, that the tool must not touch where its path begins.
    """
    seen, spot, scale, depth = press.survey, press.spot, press.scale, press.depth
    points = np.concatenate([around, seen.points[seen.room > 0.0], seen.near(spot, 3.0 * scale)])
    for _ in range(12):
        tool = tool_of(shape, scale)
        touch = touch_height(tool, spot, points)
        start = touch + 0.2 * scale
        if clearance(tool, spot, start, points) >= 0.05 * scale:
            return replace(press, scale=scale, depth=depth, start=start, end=touch - depth)
        scale *= 0.8
        depth = min(depth, 0.45 * scale)
    return None


def _spacing(seen: FaceSurvey, half_width: float, wish: Wish) -> float:
    """Node spacing: the shorter side in 40, or a third of the dent's half width where that is not enough."""
    area = math.prod(seen.lengths)
    usual = max(math.sqrt(area / wish.usual_nodes), min(seen.lengths) / 40.0)
    return max(math.sqrt(area / wish.most_nodes), min(usual, half_width / 3.0))


def _score(seen: FaceSurvey, press: Press, spacing: float, wish: Wish) -> float:
    """How good a dent this will be: its half width, less where nodes would not resolve it or would be many or slow."""
    resolved = min(1.0, press.half_width / (2.0 * spacing))
    nodes = math.prod(
        max(length / spacing, 2.0 * spans) for length, spans in zip(seen.lengths, seen.spans, strict=True)
    )
    # sub-steps follow the smallest cell, that of the shortest knot span
    smallest = min(spacing, 0.5 * seen.shortest, press.thickness / 2.0)
    slow = (nodes / wish.usual_nodes) * (press.thickness / smallest) / 10.0
    broken = 1.0 if np.isfinite(seen.normals).all() else 0.1
    return kind_factor(seen.face) * press.half_width * resolved**2 * broken / math.sqrt(max(1.0, slow))


def kind_factor(face: Face) -> float:
    """How much more a face of this kind is wanted than another."""
    return PREFER_SPLINES if face.kind in SPLINES else 1.0


def tool_of(shape: str, scale: float) -> ImplicitTool | None:
    """The tool as the engine makes it; None for a point."""
    sizes = sizes_of(shape, scale)
    rounding = sizes.get("rounding", 0.0)
    match shape:
        case "sphere":
            return ImplicitTool.sphere(sizes["radius"])
        case "ellipsoid":
            return ImplicitTool.ellipsoid(sizes["radii"])
        case "capsule":
            return ImplicitTool.capsule(sizes["radius"], sizes["length"])
        case "cylinder":
            return ImplicitTool.cylinder(sizes["radius"], sizes["height"], rounding)
        case "cone":
            return ImplicitTool.cone(sizes["radius"], sizes["height"])
        case "box":
            return ImplicitTool.box(sizes["size"], rounding)
        case "torus":
            return ImplicitTool.torus(sizes["major_radius"], sizes["minor_radius"])
    return None


def sizes_of(shape: str, scale: float) -> dict[str, Any]:
    """The sizes of a tool that fills a ball of radius `scale`, about; its tip or flat points along -z."""
    s = scale
    sizes: dict[str, dict[str, Any]] = {
        "sphere": {"radius": s},
        "ellipsoid": {"radii": [s, 0.7 * s, 1.3 * s]},
        "capsule": {"radius": 0.7 * s, "length": 1.2 * s},
        "cylinder": {"radius": 0.7 * s, "height": 1.5 * s, "rounding": 0.2 * s},
        "cone": {"radius": s, "height": 1.5 * s},
        "box": {"size": [1.2 * s, 1.0 * s, 1.5 * s], "rounding": 0.2 * s},
        "torus": {"major_radius": 0.7 * s, "minor_radius": 0.3 * s},
        "point": {},
    }
    return sizes[shape]


def clearance(tool: ImplicitTool | None, spot: Spot, height: float, points: Array) -> float:
    """Smallest distance of the tool, its origin `height` above the spot, to the points; negative inside."""
    pose = Pose(spot.point + height * spot.normal, rotation_to_axis(spot.normal))
    local = pose.to_tool(points)
    distance = np.linalg.norm(local, axis=1) if tool is None else tool.field(local)[0]
    return float(distance.min())


def touch_height(tool: ImplicitTool | None, spot: Spot, points: Array) -> float:
    """Height of the tool's origin above the spot at which it first touches the points, coming down along the normal."""
    if tool is None:
        return 0.0
    low, high = float(tool.box_corners[0, 2]), -float(tool.box_corners[0, 2])
    reach = float(np.linalg.norm(tool.box_corners, axis=1).max())
    near = points[np.linalg.norm(points - spot.point, axis=1) < 3.0 * reach]
    high = max(high, 0.0) + reach
    for _ in range(40):
        middle = 0.5 * (low + high)
        if clearance(tool, spot, middle, near) > 0.0:
            high = middle
        else:
            low = middle
    return high
