"""Implicit tools (paper 4.9.1) as exact signed distances, so that a sphere test prunes whole cells.

Every shape stands in its own frame: centred at the origin with its axis along z, except the cone (apex at the origin,
opening upwards) and the half-space (everything above z = 0): a tool that comes down along -z touches with its tip.
Distances are negative inside, exact and therefore 1-Lipschitz; n is the unit outward normal of the shape at the point
nearest to x, and that point is x - d n.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..collide.detect import FieldTool
from ..errors import InputError
from ..jit import njit
from ..motion.pose import Pose

Array = NDArray[np.float64]

SPHERE, ELLIPSOID, CAPSULE, CYLINDER, CONE, BOX, TORUS, HALF_SPACE = range(8)


@dataclass(frozen=True, slots=True, eq=False)
class ImplicitTool:
    """A rigid solid with an exact signed distance, in the scene's length unit.

    kind : one of the shape numbers of this module. parameters : its sizes, as the constructors below list them;
    `rounding` rounds the edges of a box or cylinder without changing its outer size.
    """

    kind: int
    parameters: Array
    rounding: float = 0.0

    @classmethod
    def sphere(cls, radius: float) -> ImplicitTool:
        return cls._checked(SPHERE, [radius])

    @classmethod
    def ellipsoid(cls, radii: tuple[float, float, float]) -> ImplicitTool:
        return cls._checked(ELLIPSOID, list(radii))

    @classmethod
    def capsule(cls, radius: float, length: float) -> ImplicitTool:
        """`length` is the distance between the centres of the two half spheres."""
        return cls._checked(CAPSULE, [radius, length])

    @classmethod
    def cylinder(cls, radius: float, height: float, rounding: float = 0.0) -> ImplicitTool:
        return cls._checked(CYLINDER, [radius, height], rounding, min(radius, 0.5 * height))

    @classmethod
    def cone(cls, radius: float, height: float) -> ImplicitTool:
        """Apex at the origin, base of `radius` at z = `height`."""
        return cls._checked(CONE, [radius, height])

    @classmethod
    def box(cls, size: tuple[float, float, float], rounding: float = 0.0) -> ImplicitTool:
        return cls._checked(BOX, list(size), rounding, 0.5 * min(size))

    @classmethod
    def torus(cls, major_radius: float, minor_radius: float) -> ImplicitTool:
        return cls._checked(TORUS, [major_radius, minor_radius])

    @classmethod
    def half_space(cls) -> ImplicitTool:
        """Everything with z >= 0; its outward normal is -z."""
        return cls._checked(HALF_SPACE, [])

    @classmethod
    def _checked(cls, kind: int, sizes: list[float], rounding: float = 0.0, most: float = 0.0) -> ImplicitTool:
        parameters = np.array(sizes, dtype=np.float64)
        if not (np.isfinite(parameters).all() and (parameters > 0).all()):
            raise InputError(f"a tool of size {sizes}", mend="every size of a tool is a positive number")
        if not 0.0 <= rounding <= most:
            raise InputError(f"a rounding of {rounding:g}", mend=f"this shape takes 0 to {most:g}")
        return cls(kind, parameters, rounding)

    @property
    def box_corners(self) -> Array:
        """(2, 3): lower and upper corner in the tool's frame; infinite for a half-space."""
        p = self.parameters
        if self.kind == HALF_SPACE:
            return np.array([[-np.inf, -np.inf, 0.0], [np.inf, np.inf, np.inf]])
        if self.kind == CONE:
            return np.array([[-p[0], -p[0], 0.0], [p[0], p[0], p[1]]])
        half = {
            SPHERE: lambda: [p[0]] * 3,
            ELLIPSOID: lambda: list(p),
            CAPSULE: lambda: [p[0], p[0], 0.5 * p[1] + p[0]],
            CYLINDER: lambda: [p[0], p[0], 0.5 * p[1]],
            BOX: lambda: list(0.5 * p),
            TORUS: lambda: [p[0] + p[1], p[0] + p[1], p[1]],
        }[self.kind]()
        return np.array([[-h for h in half], half])

    @property
    def convex(self) -> bool:
        """What lies beyond the tangent plane of one of its points is clear of it."""
        return self.kind != TORUS

    def field(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (n,) and unit outward normal (n, 3) at points (n, 3) in the tool's frame."""
        distance = np.empty(len(points))
        normal = np.empty((len(points), 3))
        shape_field(self.kind, self.parameters, self.rounding, np.ascontiguousarray(points), distance, normal)
        return distance, normal

    def placed(self, pose: Pose) -> FieldTool:
        """The tool in the world, as the collision pipeline takes it."""
        return FieldTool(PlacedField(self, pose))


class Solid(Protocol):
    """What a tool with a signed distance offers in its own frame."""

    @property
    def box_corners(self) -> Array:
        """(2, 3): lower and upper corner of a box that holds it; may be infinite."""
        ...

    def field(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (n,) and unit outward normal (n, 3) at points (n, 3)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PlacedField:
    """A solid at a pose; implements `collide.detect.DistanceField`."""

    tool: Solid
    pose: Pose

    def distance(self, points: Array) -> Array:
        return self.tool.field(self.pose.to_tool(points))[0]

    def gradient(self, points: Array) -> Array:
        return self.pose.direction_to_world(self.tool.field(self.pose.to_tool(points))[1])

    def nearest(self, points: Array) -> Array:
        distance, normal = self.tool.field(self.pose.to_tool(points))
        return points - distance[:, None] * self.pose.direction_to_world(normal)

    def box(self) -> Array:
        corners = self.tool.box_corners
        if not np.isfinite(corners).all():
            return np.array([[-np.inf] * 3, [np.inf] * 3])
        centre, half = corners.mean(axis=0), 0.5 * (corners[1] - corners[0])
        middle, reach = self.pose.to_world(centre), np.abs(self.pose.rotation) @ half
        return np.array([middle - reach, middle + reach])


@njit
def shape_field(kind: int, p: Array, rounding: float, x: Array, d: Array, n: Array) -> None:
    """Signed distance d (m,) and outward normal n (m, 3) of a shape at points x (m, 3)."""
    for i in range(len(x)):
        px, py, pz = x[i, 0], x[i, 1], x[i, 2]
        if kind == SPHERE:
            length = np.sqrt(px * px + py * py + pz * pz)
            d[i] = length - p[0]
            _unit(px, py, pz, length, n[i])
        elif kind == CAPSULE:
            half = 0.5 * p[1]
            qz = pz - min(max(pz, -half), half)
            length = np.sqrt(px * px + py * py + qz * qz)
            d[i] = length - p[0]
            if length > 0.0:
                _unit(px, py, qz, length, n[i])
            else:
                n[i, 0], n[i, 1], n[i, 2] = 1.0, 0.0, 0.0
        elif kind == HALF_SPACE:
            d[i] = -pz
            n[i, 0], n[i, 1], n[i, 2] = 0.0, 0.0, -1.0
        elif kind == TORUS:
            r = np.sqrt(px * px + py * py)
            a = r - p[0]
            length = np.sqrt(a * a + pz * pz)
            d[i] = length - p[1]
            ca, sa = (a / length, pz / length) if length > 0.0 else (1.0, 0.0)
            cx, cy = (px / r, py / r) if r > 0.0 else (1.0, 0.0)
            n[i, 0], n[i, 1], n[i, 2] = ca * cx, ca * cy, sa
        elif kind == CYLINDER:
            r = np.sqrt(px * px + py * py)
            cx, cy = (px / r, py / r) if r > 0.0 else (1.0, 0.0)
            d[i], nr, nz = _rectangle(r, abs(pz), p[0] - rounding, 0.5 * p[1] - rounding)
            d[i] -= rounding
            n[i, 0], n[i, 1], n[i, 2] = nr * cx, nr * cy, nz * _sign(pz)
        elif kind == CONE:
            r = np.sqrt(px * px + py * py)
            cx, cy = (px / r, py / r) if r > 0.0 else (1.0, 0.0)
            d[i], nr, nz = _cone(r, pz, p[0], p[1])
            n[i, 0], n[i, 1], n[i, 2] = nr * cx, nr * cy, nz
        elif kind == BOX:
            _box(px, py, pz, p, rounding, i, d, n)
        else:
            _ellipsoid(px, py, pz, p, i, d, n)


@njit
def _unit(x: float, y: float, z: float, length: float, out: Array) -> None:
    if length > 0.0:
        out[0], out[1], out[2] = x / length, y / length, z / length
    else:
        out[0], out[1], out[2] = 0.0, 0.0, -1.0


@njit
def _sign(x: float) -> float:
    return 1.0 if x >= 0.0 else -1.0


@njit
def _rectangle(r: float, z: float, a: float, b: float) -> tuple[float, float, float]:
    """Distance and normal of the quarter rectangle [0, a] x [0, b] at r, z >= 0."""
    qr, qz = r - a, z - b
    if qr > 0.0 and qz > 0.0:
        length = np.sqrt(qr * qr + qz * qz)
        return length, qr / length, qz / length
    if qr > qz:
        return qr, 1.0, 0.0
    return qz, 0.0, 1.0


@njit
def _cone(r: float, z: float, radius: float, height: float) -> tuple[float, float, float]:
    """Distance and normal of the triangle (0, 0), (radius, height), (0, height) in the half plane r >= 0."""
    slant2 = radius * radius + height * height
    slant = np.sqrt(slant2)
    nr, nz = height / slant, -radius / slant  # outward normal of the side
    t = min(max((r * radius + z * height) / slant2, 0.0), 1.0)
    sr, sz = r - t * radius, z - t * height
    side = np.sqrt(sr * sr + sz * sz)
    cap_r = r - min(r, radius)
    cap_z = z - height
    cap = np.sqrt(cap_r * cap_r + cap_z * cap_z)
    inside = r * nr + z * nz <= 0.0 and z <= height
    if inside:
        if side <= cap:
            return -side, nr, nz
        return -cap, 0.0, 1.0
    if side <= cap:
        if t > 0.0 and t < 1.0:
            return side, nr, nz
        return side, sr / side, sz / side
    return cap, cap_r / cap, cap_z / cap


@njit
def _box(px: float, py: float, pz: float, size: Array, rounding: float, i: int, d: Array, n: Array) -> None:
    q0 = abs(px) - (0.5 * size[0] - rounding)
    q1 = abs(py) - (0.5 * size[1] - rounding)
    q2 = abs(pz) - (0.5 * size[2] - rounding)
    o0, o1, o2 = max(q0, 0.0), max(q1, 0.0), max(q2, 0.0)
    outside = np.sqrt(o0 * o0 + o1 * o1 + o2 * o2)
    if outside > 0.0:
        d[i] = outside - rounding
        n[i, 0] = o0 / outside * _sign(px)
        n[i, 1] = o1 / outside * _sign(py)
        n[i, 2] = o2 / outside * _sign(pz)
        return
    n[i, 0], n[i, 1], n[i, 2] = 0.0, 0.0, 0.0
    if q0 >= q1 and q0 >= q2:
        d[i] = q0 - rounding
        n[i, 0] = _sign(px)
    elif q1 >= q2:
        d[i] = q1 - rounding
        n[i, 1] = _sign(py)
    else:
        d[i] = q2 - rounding
        n[i, 2] = _sign(pz)


@njit
def _ellipsoid(px: float, py: float, pz: float, e: Array, i: int, d: Array, n: Array) -> None:
    """Eberly, "Distance from a point to an ellipsoid": the one root of g(t) = sum (e y / (t + e^2))^2 - 1 right of -min e^2.

    g is convex and falling there, so Newton from the left end never overshoots. The unknown is s = t + min e^2, so that
    nothing cancels for points near the plane of the shortest axis.
    """
    smallest = min(e[0], e[1], e[2])
    # a point on a plane of symmetry is nudged off it, by less than rounding, so that the root is always the nearest point
    tiny = 1e-15 * max(e[0], e[1], e[2])
    y0, y1, y2 = max(abs(px), tiny), max(abs(py), tiny), max(abs(pz), tiny)
    c0 = (e[0] - smallest) * (e[0] + smallest)
    c1 = (e[1] - smallest) * (e[1] + smallest)
    c2 = (e[2] - smallest) * (e[2] + smallest)
    s = max(e[0] * y0 - c0, e[1] * y1 - c1, e[2] * y2 - c2)
    for _ in range(100):
        a0, a1, a2 = s + c0, s + c1, s + c2
        r0, r1, r2 = e[0] * y0 / a0, e[1] * y1 / a1, e[2] * y2 / a2
        g = r0 * r0 + r1 * r1 + r2 * r2 - 1.0
        slope = -2.0 * (r0 * r0 / a0 + r1 * r1 / a1 + r2 * r2 / a2)
        step = g / slope
        if not g > 0.0 or s - step == s:
            break
        s -= step
    x0 = e[0] * e[0] * y0 / (s + c0)
    x1 = e[1] * e[1] * y1 / (s + c1)
    x2 = e[2] * e[2] * y2 / (s + c2)
    g0, g1, g2 = x0 / (e[0] * e[0]), x1 / (e[1] * e[1]), x2 / (e[2] * e[2])
    length = np.sqrt(g0 * g0 + g1 * g1 + g2 * g2)
    g0, g1, g2 = g0 / length, g1 / length, g2 / length
    d[i] = (y0 - x0) * g0 + (y1 - x1) * g1 + (y2 - x2) * g2
    n[i, 0], n[i, 1], n[i, 2] = g0 * _sign(px), g1 * _sign(py), g2 * _sign(pz)
