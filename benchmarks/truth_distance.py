"""Certified distance intervals against OpenCASCADE's extrema: random surface pairs, and trimmed faces of real parts.

A pair counts against us when OpenCASCADE's distance lies outside our interval and OpenCASCADE is not shown wrong: by two
points of the surfaces, evaluated here, that are nearer than it says; or by its own points not lying on the faces.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from cadsculpt.collide.certified.distance import distance
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.collide.query import PointTool, SurfaceTool
from cadsculpt.errors import CadsculptError
from cadsculpt.spline.surface import BSplineSurface

Array = NDArray[np.float64]

PARTS = ("trj4_k1_geo-ac-214.stp", "trj8_k1-hc-214.stp", "as1_pe_203.stp")
"""Files of the corpus' folder `step` whose trimmed faces are paired."""

TRIMMED = 48
"""Pairs of trimmed faces, where there is a corpus."""

BUDGET = 30_000
"""Pairs of cells for one interval: rim against rim of trimmed faces would take many more for the last digits."""

ALLOWANCE = 1e-6
"""What OpenCASCADE's own tolerances leave open, as a part of the pair's size (its confusion is 1e-7 on top)."""

PATIENCE = 10.0
"""Seconds that OpenCASCADE has for a pair; then another pair takes its place."""

PROGRESS = 20
"""Pairs between two lines of progress."""


def random_surface(rng: np.random.Generator) -> BSplineSurface:
    """A bumpy sheet about 10 x 10 of degree 1 to 4, rational in every other case."""
    nets, knots = [], []
    p, q = (int(x) for x in rng.integers(1, 5, 2))
    r, s = p + 1 + int(rng.integers(0, 4)), q + 1 + int(rng.integers(0, 4))
    for degree, count in ((p, r), (q, s)):
        inner = np.sort(rng.uniform(0.1, 0.9, count - degree - 1))
        knots.append(np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)]))
    nets = np.stack(np.meshgrid(np.linspace(0, 10, r), np.linspace(0, 10, s), indexing="ij"), axis=-1)
    net = np.concatenate([nets, np.zeros((r, s, 1))], axis=2) + rng.normal(scale=6.0 / max(r, s), size=(r, s, 3)) * 0.5
    weights = rng.uniform(0.4, 2.5, (r, s)) if rng.random() < 0.5 else None
    return BSplineSurface(net, knots[0], knots[1], p, q, weights)


def turned(rng: np.random.Generator, points: Array, shift: Array) -> Array:
    """Points turned at random about their middle, then moved."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    if np.linalg.det(q) < 0:
        q[:, 0] *= -1.0
    middle = points.reshape(-1, 3).mean(axis=0)
    moved: Array = (points - middle) @ q.T + middle + shift
    return moved


def random_pairs(rng: np.random.Generator) -> Iterator[tuple[str, BSplineSurface, BSplineSurface]]:
    """Apart, near, touching and crossing, in turn, without end."""
    for kind in cycle(("apart", "near", "touching", "crossing")):
        a, b = random_surface(rng), random_surface(rng)
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        middle = a.control_points.mean(axis=(0, 1)) - b.control_points.mean(axis=(0, 1))
        if kind == "crossing":
            b = b.with_control_points(turned(rng, b.control_points, middle + 0.5 * direction))
        else:
            b = b.with_control_points(turned(rng, b.control_points, middle + 14.0 * direction))
        if kind in ("near", "touching"):
            # along the closest pair, until the gap is small, or nothing
            found = distance(tool(a), tool(b), tolerance=1e-9, budget=100_000)
            if found.a is not None and found.b is not None:
                way = found.a.point - found.b.point
                left = 10.0 ** rng.uniform(-5, -1) if kind == "near" else 0.0
                length = float(np.linalg.norm(way))
                b = b.with_control_points(b.control_points + way * max(0.0, 1.0 - left / max(length, 1e-300)))
        yield kind, a, b


def trimmed_pairs(rng: np.random.Generator) -> Iterator[tuple[str, BSplineSurface, BSplineSurface]]:
    """Faces of the corpus' parts, one of each pair turned and moved so that they are apart, near or crossing; without
    end, or empty without a corpus."""
    corpus = os.environ.get("CADSCULPT_CORPUS")
    if not corpus:
        return
    from cadsculpt.formats.registry import read

    faces: list[BSplineSurface] = []
    for name in PARTS:
        path = Path(corpus) / "step" / name
        if not path.exists():
            continue
        part = read(path)
        mine = []
        for face in part.faces:
            try:
                surface = face.surface
                if surface.trims is not None and face.kind in ("bspline", "bezier", "cylinder", "plane", "cone"):
                    PatchGrid.of(surface, 5)
                    mine.append(surface)
            except CadsculptError:
                continue
            if len(mine) == 24:
                break
        faces += mine
    while faces:
        a, b = (faces[int(k)] for k in rng.integers(0, len(faces), 2))
        # faces of one size, about each other: nothing is learnt from a screw beside a wing
        box_a, box_b = (face_box(s) for s in (a, b))
        size_a, size_b = (float(np.linalg.norm(box[1] - box[0])) for box in (box_a, box_b))
        if not (size_a > 0 and size_b > 0):
            continue
        net = (b.control_points - box_b.mean(axis=0)) * (size_a / size_b) + box_a.mean(axis=0)
        direction = rng.normal(size=3)
        direction *= rng.choice([0.2, 0.5, 1.0]) * size_a / np.linalg.norm(direction)
        yield "trimmed", a, replace(b, control_points=turned(rng, net, direction))


def face_box(surface: BSplineSurface) -> Array:
    """(2, 3): the box of a face, by its grid's vertices."""
    grid = PatchGrid.of(surface, 9)
    points = grid.matrices.points(np.array(surface.control_points), surface.weights)
    points = points[grid.inside] if grid.inside is not None else points.reshape(-1, 3)
    return np.array([points.min(axis=0), points.max(axis=0)])


def tool(surface: BSplineSurface) -> SurfaceTool:
    """A surface as a body."""
    return SurfaceTool((PatchGrid.of(surface, 5),), (np.array(surface.control_points),))


def occt_distance(a: BSplineSurface, b: BSplineSurface) -> tuple[float, Array, Array] | None:
    """OpenCASCADE's distance of two faces, and its two points; None where it gives up."""
    from OCP.BRepExtrema import BRepExtrema_DistShapeShape

    from cadsculpt.formats.occt.shape import shape_of_surface

    found = BRepExtrema_DistShapeShape(shape_of_surface(a), shape_of_surface(b))
    if not found.IsDone() or found.NbSolution() < 1:
        return None
    points = [np.array([p.X(), p.Y(), p.Z()]) for p in (found.PointOnShape1(1), found.PointOnShape2(1))]
    return float(found.Value()), points[0], points[1]


def answer(ask: Connection) -> None:
    """Answer pairs of faces with OpenCASCADE's distance, until the other end closes."""
    while True:
        try:
            a, b = ask.recv()
        except EOFError:
            return
        try:
            ask.send(occt_distance(a, b))
        except Exception as error:  # whatever OpenCASCADE raises is no distance
            print(f"OpenCASCADE: {error}", file=sys.stderr, flush=True)
            ask.send(None)


class Occt:
    """OpenCASCADE in a process of its own, which is ended and begun again where it does not answer in time."""

    def __init__(self) -> None:
        self._child: Any = None
        self._ask: Any = None

    def distance(self, a: BSplineSurface, b: BSplineSurface) -> tuple[float, Array, Array] | None:
        """As `occt_distance`; None too where it takes longer than PATIENCE, or its process ends."""
        if self._child is None:
            own = multiprocessing.get_context("spawn")
            self._ask, its = own.Pipe()
            self._child = own.Process(target=answer, args=(its,))
            self._child.start()
            its.close()
            # importing takes longer than a pair
            self._ask.send((FLAT, FLAT))
            if not self._ask.poll(60.0):
                raise SystemExit("OpenCASCADE did not start within a minute")
            self._ask.recv()
        try:
            self._ask.send((a, b))
            if self._ask.poll(PATIENCE):
                found: tuple[float, Array, Array] | None = self._ask.recv()
                return found
        except (EOFError, OSError):
            pass
        self.close()
        return None

    def close(self) -> None:
        """End the process."""
        if self._child is not None:
            self._ask.close()
            self._child.kill()
            self._child.join()
            self._child = None


FLAT = BSplineSurface(
    np.stack([*np.meshgrid([0.0, 1.0], [0.0, 1.0], indexing="ij"), np.zeros((2, 2))], axis=-1),
    np.array([0.0, 0.0, 1.0, 1.0]), np.array([0.0, 0.0, 1.0, 1.0]), 1, 1,
)  # fmt: skip
"""A square, to ask for a first answer."""


def off_face(surface: BSplineSurface, point: Array) -> float:
    """How far a point is from a face, at least: by a dense grid of vertices on it, less what a cell hides, or by how far it is
    from the whole surface."""
    grid = PatchGrid.of(surface, 200)
    points = grid.matrices.points(np.array(surface.control_points), surface.weights)
    cell = max(
        float(np.linalg.norm(np.diff(points, axis=0), axis=2).max()),
        float(np.linalg.norm(np.diff(points, axis=1), axis=2).max()),
    )
    face = points[grid.inside] if grid.inside is not None else points.reshape(-1, 3)
    least = float(np.linalg.norm(face - point, axis=1).min()) - 2.0 * cell
    # or from the whole surface: least squares from the nearest vertices, and the certified bound has to say so too
    names = np.argsort(np.linalg.norm(points.reshape(-1, 3) - point, axis=1))[:5]
    starts = np.stack([grid.matrices.u[names // points.shape[1]], grid.matrices.v[names % points.shape[1]]], axis=1)
    low, high = np.array(surface.domain).T
    away = min(
        float(
            np.linalg.norm(least_squares(lambda x: surface.evaluate(*x) - point, x, bounds=(low, high), xtol=1e-15).fun)
        )
        for x in np.clip(starts, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
    )
    bound = distance(tool(replace(surface, trims=None)), PointTool(point, 1.0), tolerance=1e-9).low
    return max(least, min(away, bound))


def distance_truth(seed: int = 1, pairs: int = 200) -> dict[str, Any]:
    """Compare intervals with OpenCASCADE over this many pairs, trimmed faces among them where there is a corpus.

    Keys: distance_pairs, distance_trimmed, distance_outside_interval, distance_outside and distance_occt_wrong (one line
    each), distance_occt_failed (pairs without an answer from OpenCASCADE, replaced by others), distance_widest (relative
    to the pair's size), distance_exhausted, distance_seconds and distance_occt_seconds.
    """
    rng = np.random.default_rng(seed)
    result: dict[str, Any] = {
        "distance_pairs": 0, "distance_trimmed": 0, "distance_outside_interval": 0, "distance_outside": [],
        "distance_occt_wrong": [], "distance_occt_failed": 0, "distance_widest": 0.0, "distance_exhausted": 0,
        "distance_seconds": 0.0, "distance_occt_seconds": 0.0,
    }  # fmt: skip
    trimmed = 0
    occt = Occt()
    try:
        for kind, a, b in trimmed_pairs(rng):
            if trimmed == min(TRIMMED, pairs // 2):
                break
            trimmed += compare(kind, a, b, occt, result)
        for kind, a, b in random_pairs(rng):
            if result["distance_pairs"] >= pairs:
                break
            compare(kind, a, b, occt, result)
    finally:
        occt.close()
    return result


def compare(kind: str, a: BSplineSurface, b: BSplineSurface, occt: Occt, result: dict[str, Any]) -> bool:
    """Compare one pair, and enter it in the result; False where OpenCASCADE gives no distance."""
    size = max(float(np.linalg.norm(np.ptp(face_box(s), axis=0))) for s in (a, b))
    start = time.perf_counter()
    theirs = occt.distance(a, b)
    result["distance_occt_seconds"] += time.perf_counter() - start
    if theirs is None:
        result["distance_occt_failed"] += 1
        print(f"distance: no answer from OpenCASCADE ({kind})", file=sys.stderr, flush=True)
        return False
    start = time.perf_counter()
    ours = distance(tool(a), tool(b), budget=BUDGET)
    took = time.perf_counter() - start
    result["distance_seconds"] += took
    number = result["distance_pairs"]
    result["distance_pairs"] += 1
    result["distance_trimmed"] += kind == "trimmed"
    result["distance_exhausted"] += ours.exhausted
    width = (ours.high - ours.low) / size
    result["distance_widest"] = max(result["distance_widest"], width)
    if result["distance_pairs"] % PROGRESS == 0:
        print(f"distance: {result['distance_pairs']} pairs", file=sys.stderr, flush=True)
    value, p, q = theirs
    allowed = ALLOWANCE * size + 2e-7
    if ours.low - allowed <= value <= ours.high + allowed:
        return True
    line = f"pair {number} ({kind}): [{ours.low:.9g}, {ours.high:.9g}], OpenCASCADE {value:.9g}"
    if value > ours.high and ours.a is not None and ours.b is not None:
        nearer = float(np.linalg.norm(a.evaluate(ours.a.u, ours.a.v) - b.evaluate(ours.b.u, ours.b.v)))
        if nearer < value - allowed and on(a, ours.a.u, ours.a.v) and on(b, ours.b.u, ours.b.v):
            result["distance_occt_wrong"].append(f"{line}; two points are {nearer:.9g} apart")
            return True
    if value < ours.low:
        away = max(off_face(a, p), off_face(b, q))
        if away > allowed:
            result["distance_occt_wrong"].append(f"{line}; its point is {away:.3g} off the face")
            return True
    print(f"distance: outside: {line}", file=sys.stderr, flush=True)
    result["distance_outside_interval"] += 1
    result["distance_outside"].append(line)
    return True


def on(surface: BSplineSurface, u: float, v: float) -> bool:
    """Whether (u, v) lies on the face, by an even-odd count over a fine polygon of its trims; on the border counts."""
    if surface.trims is None:
        return True
    from cadsculpt.spline.trim import curve_points

    (u0, u1), (v0, v1) = surface.domain
    chains = []
    for loop in surface.trims:
        parts = []
        for curve in loop.curves:
            t = np.linspace(curve.knots[curve.degree], curve.knots[-curve.degree - 1], 4000)
            parts.append((curve_points(curve, t) - [u0, v0]) / [u1 - u0, v1 - v0])
        chain = np.concatenate(parts)
        chains.append(np.stack([chain, np.roll(chain, -1, axis=0)], axis=1))
    lines = np.concatenate(chains)
    at = (np.array([u, v]) - [u0, v0]) / [u1 - u0, v1 - v0]
    for s in (0, 1, -1) if surface.closed_u else (0,):
        for t in (0, 1, -1) if surface.closed_v else (0,):
            x = at + [s, t]
            d = lines[:, 1] - lines[:, 0]
            length = np.einsum("ij,ij->i", d, d)
            w = np.clip(np.einsum("ij,ij->i", x - lines[:, 0], d) / np.where(length > 0, length, 1), 0, 1)
            if np.linalg.norm(lines[:, 0] + w[:, None] * d - x, axis=1).min() < 1e-6:
                return True
            up = (lines[:, 0, 1] > x[1]) != (lines[:, 1, 1] > x[1])
            with np.errstate(divide="ignore", invalid="ignore"):
                cross = lines[:, 0, 0] + (x[1] - lines[:, 0, 1]) / d[:, 1] * d[:, 0]
            if int((up & (cross > x[0])).sum()) % 2:
                return True
    return False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pairs", type=int, default=200)
    arguments = parser.parse_args()
    print(json.dumps(distance_truth(arguments.seed, arguments.pairs), indent=2))


if __name__ == "__main__":
    main()
