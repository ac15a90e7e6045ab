"""Tools made of pieces: a formula within its box, and unions, intersections and differences of other tools.

The sign is that of the composed function. `bound` prunes: it never exceeds the distance to the surface. `field` finds the
nearest point itself. Of a union of exact distances it is as a rule the nearest point of one part; where it is not, and for
formulas, points spread over the surface tell which pieces are near, and Newton's method finds the nearest point of each
of these, of the edges where two of them meet and of the corners of three, among which the nearest that lies on the solid is
taken. Every answer is a point of the surface: too far at worst, never made up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..collide.detect import FieldTool
from ..errors import InputError
from ..motion.pose import Pose
from .cover import Cover, make_cover
from .expression import Expression
from .implicit import ImplicitTool, PlacedField
from .newton import DONE, nearest_on
from .pieces import Piece, Tree, formula_pieces, solid_pieces
from .superquadric import SuperquadricTool

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

ON = 1e-10
"""A point lies on the surface when the function there is below this share of the size."""

NEAR = 4
"""Pieces around a point of the surface that are looked at: with four, a corner of four is found whatever its shape."""


AROUND = 24
"""Points of the surface that are looked at around the nearest one, for a second start."""


@dataclass(frozen=True, slots=True, eq=False)
class Leaf:
    """A part of a composed solid with a distance of its own: where it stands, and its first piece."""

    tool: ImplicitTool | SuperquadricTool
    pose: Pose

    def field(self, points: Array) -> tuple[Array, Array]:
        """Its signed distance and normal."""
        d, n = self.tool.field(self.pose.to_tool(points))
        return d, self.pose.direction_to_world(n)


@dataclass(frozen=True, slots=True, eq=False)
class Seeds:
    """Points (n, 3) of the surface, the piece (n,) that each lies on, its normal (n, 3), and the pieces near it
    (n, NEAR), its own first, -1 where there are fewer."""

    points: Array
    piece: Index
    normal: Array
    near: Index
    tree: cKDTree


@dataclass(frozen=True, slots=True, eq=False)
class ComposedTool:
    """A solid made of smooth pieces. Made by `formula`, `union`, `intersection` and `difference`.

    leaves, leaf_tree : the parts with exact distances, and how they are joined; None where one is a formula.
    size : the longest side of the box around the finite part of the surface.
    """

    pieces: tuple[Piece, ...]
    tree: Tree
    leaves: tuple[Leaf, ...]
    leaf_tree: Tree | None
    corners: Array
    cover: Cover
    seeds: Seeds
    size: float

    @classmethod
    def formula(cls, expression: str, box: tuple[Sequence[float], Sequence[float]]) -> ComposedTool:
        """The part of the box where the expression in x, y, z is negative.

        Raises InputError for an expression that cannot be read, has a pole in the box, or is nowhere negative there.
        """
        corners = np.array(box, dtype=np.float64)
        if not (np.isfinite(corners).all() and (corners[0] < corners[1]).all()):
            raise InputError("a formula's box without inside", mend="give the lower corner first")
        read = Expression.parse(expression)
        told = read.undefined(corners)
        if told:
            raise InputError(f"the expression {told}", mend="choose a smaller box, or another expression")
        pieces, tree = formula_pieces(read, corners)
        return cls._made(pieces, tree, (), None, corners, "the expression is nowhere negative in its box")

    @classmethod
    def union(cls, parts: Sequence[tuple[ImplicitTool | SuperquadricTool | ComposedTool, Pose]]) -> ComposedTool:
        """What lies in any of the parts."""
        return cls._joined("union", parts)

    @classmethod
    def intersection(cls, parts: Sequence[tuple[ImplicitTool | SuperquadricTool | ComposedTool, Pose]]) -> ComposedTool:
        """What lies in all parts. Raises InputError where they have nothing in common."""
        return cls._joined("intersection", parts)

    @classmethod
    def difference(cls, parts: Sequence[tuple[ImplicitTool | SuperquadricTool | ComposedTool, Pose]]) -> ComposedTool:
        """The first part less the others. Raises InputError where nothing is left."""
        return cls._joined("difference", parts)

    @classmethod
    def _joined(
        cls, how: str, parts: Sequence[tuple[ImplicitTool | SuperquadricTool | ComposedTool, Pose]]
    ) -> ComposedTool:
        if len(parts) < 2:
            raise InputError(f"a {how} of {len(parts)} parts", mend="give it two or more")
        pieces: list[Piece] = []
        leaves: list[Leaf] = []
        trees: list[Tree] = []
        leaf_trees: list[Tree | None] = []
        boxes: list[Array] = []
        for tool, pose in parts:
            if isinstance(tool, ComposedTool):
                its, tree, inner, leaf_tree = tool.pieces, tool.tree, tool.leaves, tool.leaf_tree
                own = [Leaf(leaf.tool, leaf.pose.then(pose)) for leaf in inner]
            else:
                found, tree = solid_pieces(tool)
                its, own, leaf_tree = tuple(found), [Leaf(tool, pose)], Tree("max", (0,))
            trees.append(tree.moved(len(pieces)))
            leaf_trees.append(None if leaf_tree is None else leaf_tree.moved(len(leaves)))
            pieces += [piece.placed(pose) for piece in its]
            leaves += own
            boxes.append(_box_at(tool.box_corners, pose))
        known = [tree for tree in leaf_trees if tree is not None]
        all_known = len(known) == len(parts)
        corners = _joined_box(how, boxes)
        nothing = {
            "intersection": "the parts have nothing in common",
            "difference": "nothing is left of the first part",
        }
        return cls._made(
            pieces, _joined_tree(how, trees), leaves, _joined_tree(how, known) if all_known else None, corners,
            nothing.get(how, "the parts are empty"),
        )  # fmt: skip

    @classmethod
    def _made(
        cls,
        pieces: Sequence[Piece],
        tree: Tree,
        leaves: Sequence[Leaf],
        leaf_tree: Tree | None,
        corners: Array,
        nothing: str,
    ) -> ComposedTool:
        if (corners[0] > corners[1]).any():
            raise InputError(f"nothing inside: {nothing}")
        finite = _finite(corners, pieces)
        size = float((finite[1] - finite[0]).max())
        around = np.array([finite[0] - 1e-6 * size, finite[1] + 1e-6 * size])
        spans = _spans(pieces, tree)
        cover = make_cover(spans, around)
        if cover.empty:
            raise InputError(f"nothing inside: {nothing}")
        size = float((cover.corners[1] - cover.corners[0]).max())
        seeds = _seeds(pieces, tree, cover, size)
        inside = cover.known is not None
        if not inside:
            for step in (1e-2, 1e-4, 1e-6, 1e-8):
                inner = seeds.points - step * size * seeds.normal
                inside = inside or bool((_value(pieces, tree, np.concatenate([inner, cover.centres])) < 0).any())
        if not inside:
            raise InputError(f"nothing inside: {nothing}")
        box = np.where(np.isfinite(corners), np.clip(cover.corners, corners[0], corners[1]), corners)
        return cls(tuple(pieces), tree, tuple(leaves), leaf_tree, box, cover, seeds, size)

    @property
    def convex(self) -> bool:
        """Not known to be: what lies beyond a tangent plane may still meet it."""
        return False

    @property
    def box_corners(self) -> Array:
        """(2, 3): lower and upper corner in the tool's frame; may be infinite."""
        return self.corners

    def value(self, points: Array) -> Array:
        """A function (n,) whose sign is exact, negative inside; not a distance."""
        return _value(self.pieces, self.tree, points)

    def bound(self, points: Array) -> Array:
        """Signed (n,); nowhere farther from 0 than the distance to the surface, and 1-Lipschitz."""
        if self.leaf_tree is not None:
            return self.leaf_tree.value([leaf.field(points)[0] for leaf in self.leaves])[0]
        near = self.cover.clearance(points)
        low: Array = np.where(self.value(points) < 0, -np.maximum(near, 1e-300), near)
        return low

    def field(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (n,) and unit outward normal (n, 3) at points (n, 3) in the tool's frame."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        value, which, sign = _decided(self.pieces, self.tree, points)
        distance, normal, foot = (
            np.full(len(points), np.inf),
            np.zeros((len(points), 3)),
            np.full((len(points), 3), np.nan),
        )
        left = np.isfinite(points).all(axis=1)
        if self.leaf_tree is not None:
            left &= ~self._of_one_part(points, distance, foot)
        rows = np.flatnonzero(left)
        if len(rows):
            self._search(points[rows], which[rows], rows, distance, foot)
        # on the surface the normal is that of the piece that decides, off it the way to the nearest point
        inward = value < 0
        way = (points - foot) * np.where(inward, -1.0, 1.0)[:, None]
        length = np.linalg.norm(way, axis=1)
        close = ~(length > 1e-7 * self.size)
        normal = way / np.where(close, 1.0, length)[:, None]
        for k in np.unique(which[close]):
            mine = np.flatnonzero(close & (which == k))
            gradient = self.pieces[k].level(foot[mine])[1] * sign[mine, None]
            steep = np.linalg.norm(gradient, axis=1)
            normal[mine] = gradient / np.where(steep > 0, steep, 1.0)[:, None]
        bad = ~np.isfinite(points).all(axis=1)
        distance[bad], normal[bad] = np.nan, np.nan
        return np.where(inward, -distance, distance), normal

    def placed(self, pose: Pose) -> FieldTool:
        """The tool in the world, as the collision pipeline takes it."""
        return FieldTool(PlacedSolid(self, pose))

    # ------------------------------------------------------------------ nearest points

    def _of_one_part(self, points: Array, distance: Array, foot: Array) -> Mask:
        """Fills in nearest points of single parts that lie on the solid's surface. True where one is as near as `bound`
        says that any may be: there is no nearer one."""
        assert self.leaf_tree is not None
        fields = [leaf.field(points) for leaf in self.leaves]
        low = np.abs(self.leaf_tree.value([d for d, _ in fields])[0])
        done = np.zeros(len(points), dtype=np.bool_)
        for d, n in fields:
            y = points - d[:, None] * n
            gap = np.abs(d)
            rows = np.flatnonzero(gap < distance)
            rows = rows[self._on_surface(y[rows])]
            distance[rows], foot[rows] = gap[rows], y[rows]
            done[rows] |= gap[rows] <= low[rows] + 1e-12 * self.size
        return done

    def _on_surface(self, points: Array) -> Mask:
        """Which of the points (n, 3) lie on the surface of the composed solid."""
        return _on(self.pieces, self.tree, points, ON * self.size)

    def _search(self, x: Array, active: Index, rows: Index, distance: Array, foot: Array) -> None:
        """Nearest points by Newton's method from the points of the surface around; where it ends on none that is nearer
        than these, as on a crease within one piece, by creeping."""
        seeds, found = self.seeds, distance[rows]
        best = foot[rows]
        every = np.arange(len(x))
        known = np.full(len(x), -1.0)
        if len(seeds.points):
            k = min(AROUND, len(seeds.points))
            gap, index = seeds.tree.query(x, k=k)
            gap, index = gap.reshape(len(x), -1), index.reshape(len(x), -1)
            nearer = gap[:, 0] < found
            found = np.where(nearer, gap[:, 0], found)
            best = np.where(nearer[:, None], seeds.points[index[:, 0]], best)
            known = np.where(nearer, gap[:, 0], known)
            self._try(x, every, seeds.points[index[:, 0]], seeds.near[index[:, 0]], found, best)
            # a second start where some of the points around lie on another piece, face another way or are far apart
            first = index[:, :1]
            apart = np.linalg.norm(seeds.points[index] - seeds.points[first], axis=2) > 4.0 * self.cover.radius
            turned = (seeds.normal[index] * seeds.normal[first]).sum(axis=2) < 0.5
            other = (seeds.piece[index] != seeds.piece[first]) | turned | apart
            some = np.flatnonzero(other.any(axis=1))
            start = index[some, other[some].argmax(axis=1)]
            self._try(x, some, seeds.points[start], seeds.near[start], found, best)
        # what no point of the surface stands for: from the point itself
        alone = np.flatnonzero(found > self.cover.clearance(x) + 2.0 * self.cover.radius)
        self._try(x, alone, x[alone], active[alone, None], found, best)
        creased = np.flatnonzero((known > 0) & (found >= known - DONE * self.size) & (found > ON * self.size))
        if len(creased):
            found[creased], best[creased] = self._creep(x[creased], found[creased], best[creased])
        distance[rows], foot[rows] = found, best

    def _creep(self, x: Array, gap: Array, y: Array) -> tuple[Array, Array]:
        """From points y of the surface at distances gap to nearer ones, by signs alone: where the end of a ray of that
        length, turned a little, is on the other side, the surface is nearer along it."""
        gap, ray = gap.copy(), (y - x) / gap[:, None]
        side = self.value(x) < 0
        turn = np.full(len(x), 2.0 * self.cover.radius) / gap
        for k in range(64):
            t = np.cross(ray, np.eye(3)[np.abs(ray).argmin(axis=1)])
            t /= np.linalg.norm(t, axis=1)[:, None]
            u = np.cross(ray, t)
            angle = 2.4 * k + 0.25 * np.pi * np.arange(8)
            rays = ray[:, None] + turn[:, None, None] * (
                np.cos(angle)[:, None] * t[:, None] + np.sin(angle)[:, None] * u[:, None]
            )
            rays /= np.linalg.norm(rays, axis=2)[..., None]
            ends = x[:, None] + (gap * (1.0 - 1e-13))[:, None, None] * rays
            crossed = (self.value(ends.reshape(-1, 3)) < 0).reshape(-1, 8) != side[:, None]
            some = np.flatnonzero(crossed.any(axis=1))
            wide = gap[some] * (1.0 - np.minimum(4.0 * turn[some], 1.0))
            turn *= 0.65
            if not len(some):
                continue
            turn[some] *= 2.0
            ray[some] = rays[some, crossed[some].argmax(axis=1)]
            clear = (self.value(x[some] + wide[:, None] * ray[some]) < 0) == side[some]
            low, high = np.where(clear, wide, 0.0), gap[some].copy()
            for _ in range(16):
                middle = 0.5 * (low + high)
                over = (self.value(x[some] + middle[:, None] * ray[some]) < 0) != side[some]
                low, high = np.where(over, low, middle), np.where(over, middle, high)
            gap[some] = high
        return gap, x + gap[:, None] * ray

    def _try(self, x: Array, rows: Index, start: Array, near: Index, found: Array, best: Array) -> None:
        """The nearest points of the pieces `near` (n, k), of their edges and corners, from `start` (n, 3)."""
        count = near.shape[1]
        for several in (1, 2, 3):
            for chosen in combinations(range(count), several):
                active = near[:, chosen]
                some = np.flatnonzero((active >= 0).all(axis=1))
                if not len(some):
                    continue
                y, settled = nearest_on(
                    self.pieces, x[rows[some]], start[some], active[some], self.cover.radius, self.size
                )
                gap = np.linalg.norm(y - x[rows[some]], axis=1)
                mine = rows[some]
                better = np.flatnonzero(settled & (gap < found[mine]))
                better = better[self._on_surface(y[better])]
                found[mine[better]], best[mine[better]] = gap[better], y[better]


@dataclass(frozen=True, slots=True, eq=False)
class PlacedSolid(PlacedField):
    """A composed tool at a pose; implements `collide.query.BoundedField`."""

    tool: ComposedTool

    def bound(self, points: Array) -> Array:
        """A lower bound of the distance, signed."""
        return self.tool.bound(self.pose.to_tool(points))


def _decided(pieces: Sequence[Piece], tree: Tree, points: Array) -> tuple[Array, Index, Array]:
    return tree.value([piece.level(points)[0] for piece in pieces])


def _value(pieces: Sequence[Piece], tree: Tree, points: Array) -> Array:
    return _decided(pieces, tree, points)[0]


def _on(pieces: Sequence[Piece], tree: Tree, points: Array, slack: float) -> Mask:
    if not len(points):
        return np.zeros(0, dtype=np.bool_)
    values = []
    for piece in pieces:
        value, gradient = piece.level(points)
        if not piece.distance:
            steep = np.linalg.norm(gradient, axis=1)
            value = np.where(steep > 0, value / np.where(steep > 0, steep, 1.0), value)
        values.append(value)
    on: Mask = np.abs(tree.value(values)[0]) <= slack
    return on


def _spans(pieces: Sequence[Piece], tree: Tree) -> Callable[[Array, Array], tuple[Array, Array]]:
    def spans(centre: Array, half: Array) -> tuple[Array, Array]:
        return tree.bounds([piece.span(centre, half) for piece in pieces])

    return spans


def _seeds(pieces: Sequence[Piece], tree: Tree, cover: Cover, size: float) -> Seeds:
    """Points of the surface in or next to the boxes of its cover, for each piece that comes near a box."""
    points, names, normals = [np.zeros((0, 3))], [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    reach = cover.radius
    for k, piece in enumerate(pieces):
        low, high = piece.span(cover.centres, np.broadcast_to(1.5 * cover.half, cover.centres.shape))
        start = cover.centres[(low <= 0) & (high >= 0)]
        y, _ = nearest_on(pieces, start, start, np.full((len(start), 1), k), reach, size)
        y = y[np.linalg.norm(y - start, axis=1) <= 1.5 * reach]
        y = y[_on(pieces, tree, y, ON * size)]
        gradient = piece.level(y)[1]
        steep = np.linalg.norm(gradient, axis=1)
        points.append(y[steep > 0])
        names.append(np.full(int((steep > 0).sum()), k, dtype=np.int64))
        # a piece that is taken away faces the other way
        turn = _side(tree, k)
        normals.append(turn * gradient[steep > 0] / steep[steep > 0, None])
    if not all(piece.distance for piece in pieces):
        y, decided, out = _sign_changes(pieces, tree, cover)
        points.append(y)
        names.append(decided)
        normals.append(out)
    at, piece_of, normal = np.concatenate(points), np.concatenate(names), np.concatenate(normals)
    near = np.full((len(at), NEAR), -1, dtype=np.int64)
    if not len(at):
        return Seeds(at, piece_of, normal, near, cKDTree(np.zeros((1, 3))))
    near[:, 0] = piece_of
    nearest = cKDTree(at)
    filled = np.ones(len(at), dtype=np.int64)
    for k in np.unique(piece_of):
        gap = cKDTree(at[piece_of == k]).query(at, distance_upper_bound=2.5 * reach)[0]
        rows = np.flatnonzero(np.isfinite(gap) & (piece_of != k) & (filled < NEAR))
        near[rows, filled[rows]] = k
        filled[rows] += 1
    return Seeds(at, piece_of, normal, near, nearest)


def _sign_changes(pieces: Sequence[Piece], tree: Tree, cover: Cover) -> tuple[Array, Index, Array]:
    """A point of the surface in each box whose corners have both signs, by bisection: where a formula has no gradient on
    its surface, nothing else finds it. The normal is only the way from inside to outside."""
    shift = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * cover.half
    corners = cover.centres[:, None] + shift
    solid = (_value(pieces, tree, corners.reshape(-1, 3)) < 0).reshape(-1, 8)
    some = np.flatnonzero(solid.any(axis=1) & ~solid.all(axis=1))
    a, b = corners[some, solid[some].argmax(axis=1)], corners[some, (~solid[some]).argmax(axis=1)]
    out = b - a
    for _ in range(52):
        middle = 0.5 * (a + b)
        within = (_value(pieces, tree, middle) < 0)[:, None]
        a, b = np.where(within, middle, a), np.where(within, b, middle)
    return b, _decided(pieces, tree, b)[1], out / np.maximum(np.linalg.norm(out, axis=1), 1e-300)[:, None]


def _side(tree: Tree, piece: int) -> float:
    """1 where the piece is part of the solid, -1 where it is taken away."""
    for item in tree.items:
        if isinstance(item, Tree):
            inner = _side(item, piece)
            if inner:
                return tree.sign * inner
        elif item == piece:
            return tree.sign
    return 0.0


def _joined_tree(how: str, trees: Sequence[Tree]) -> Tree:
    if how == "union":
        return Tree("min", tuple(trees))
    return Tree("max", (trees[0], *(tree.turned() if how == "difference" else tree for tree in trees[1:])))


def _joined_box(how: str, boxes: Sequence[Array]) -> Array:
    if how == "union":
        return np.array([np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)])
    if how == "intersection":
        return np.array([np.max([box[0] for box in boxes], axis=0), np.min([box[1] for box in boxes], axis=0)])
    return boxes[0].copy()


def _box_at(corners: Array, pose: Pose) -> Array:
    """The box of a box at a pose; infinite sides make it infinite where they point."""
    if np.isfinite(corners).all():
        return pose.box(corners)
    low, high = pose.at.copy(), pose.at.copy()
    for i in range(3):
        for j in range(3):
            r = pose.rotation[i, j]
            if r != 0.0:
                ends = sorted([r * corners[0, j], r * corners[1, j]])
                low[i], high[i] = low[i] + ends[0], high[i] + ends[1]
    return np.array([low, high])


def _finite(corners: Array, pieces: Sequence[Piece]) -> Array:
    """A finite box in which the surface is covered: where a side is infinite, a unit beyond the finite ones."""
    known = corners[np.isfinite(corners)]
    reach = 2.0 * float(np.abs(known).max(initial=0.5))
    return np.where(np.isfinite(corners), corners, np.array([[-reach], [reach]]))
