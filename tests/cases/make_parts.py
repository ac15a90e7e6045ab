"""Make the parts of the cases in parts/: a flat plate, a paraboloid dome, a trimmed plate, a tool surface and a tool mesh.

python make_parts.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cadsculpt.formats import patch_json
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

ROUND = np.sqrt(0.5)


def quadratic(
    size: float, a: float, b: float, *, trims: tuple[TrimLoop, ...] | None = None, name: str
) -> BSplineSurface:
    """z = -a x^2 - b y^2 exactly, over [-size/2, size/2]^2; u and v are x and y."""
    h = 0.5 * size
    knots = np.array([-h, -h, -h, h, h, h])
    t = np.array([-h, 0.0, h])  # Greville
    square = np.array([h * h, -h * h, h * h])  # the control values of t^2
    X, Y = np.meshgrid(t, t, indexing="ij")
    Z = -a * square[:, None] - b * square[None, :]
    return BSplineSurface(np.stack([X, Y, Z + 0 * X], axis=-1), knots, knots, 2, 2, trims=trims, name=name)


def circle(radius: float) -> TrimLoop:
    corners = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0]], dtype=float)
    knots = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4], dtype=float)
    weights = np.array([1, ROUND, 1, ROUND, 1, ROUND, 1, ROUND, 1])
    return TrimLoop((TrimCurve(radius * corners, knots, 2, weights),), outer=False)


def square(size: float) -> TrimLoop:
    h = 0.5 * size
    corners = np.array([[-h, -h], [h, -h], [h, h], [-h, h], [-h, -h]])
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    return TrimLoop(tuple(TrimCurve(corners[i : i + 2], knots, 1) for i in range(4)))


def parts() -> dict[str, BSplineSurface]:
    return {
        "plate": quadratic(40.0, 0.0, 0.0, name="plate"),
        "dome": quadratic(40.0, 0.01, 0.01, name="dome"),
        "holed": quadratic(40.0, 0.0, 0.0, trims=(square(40.0), circle(8.0)), name="holed"),
        "pad": BSplineSurface(
            **{
                **{key: getattr(quadratic(12.0, -0.05, -0.03, name="pad"), key) for key in (
                    "control_points", "knots_u", "knots_v", "degree_u", "degree_v", "name")},
                "outward": False,
            }
        ),
    }  # fmt: skip


def hexagon(radius: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """A prism with a corner on the x axis, its lower face at z = 0: vertices (14, 3), triangles (24, 3)."""
    angle = np.radians(60.0 * np.arange(6))
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * angle], axis=1)
    vertices = np.concatenate([ring, ring + [0.0, 0.0, height], [[0.0, 0.0, 0.0], [0.0, 0.0, height]]])
    a, b = np.arange(6), (np.arange(6) + 1) % 6
    sides = [(a, b, b + 6), (a, b + 6, a + 6), (b, a, 12 + 0 * a), (a + 6, b + 6, 13 + 0 * a)]
    return vertices, np.concatenate([np.stack(corners, axis=1) for corners in sides])


def ascii_stl(vertices: np.ndarray, triangles: np.ndarray) -> str:
    lines = ["solid hexagon"]
    for corners in vertices[triangles]:
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        lines.append("facet normal " + " ".join(f"{x:.6g}" for x in normal / np.linalg.norm(normal) + 0.0))
        lines += [" outer loop", *("  vertex " + " ".join(f"{x:.12g}" for x in p + 0.0) for p in corners)]
        lines += [" endloop", "endfacet"]
    return "\n".join([*lines, "endsolid hexagon", ""])


if __name__ == "__main__":
    (Path(__file__).with_name("parts") / "hexagon_cm.stl").write_text(ascii_stl(*hexagon(0.8, 1.0)))
    for name, surface in parts().items():
        patch_json.write_surfaces(Path(__file__).with_name("parts") / f"{name}.json", [surface], "mm")
