"""Nothing is missed, and nothing made up: random pairs of bodies against dense brute force.

Brute force evaluates the model densely with scipy, all over and once more around the place that the tool is aimed at,
and asks plain formulas how deep these points lie in the tool and whether they lie on the trimmed face. A scene where a
point surely on the face lies deeper than the scene's tolerance and `detect` finds no contact is missed. A contact whose
point is not on the surface, not on the face or not in the tool is a false one: formulas and scipy tell that of every
row, however fine the samples are.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from truth_solids import SHAPES, SURFACES, Solid, ball, cube, random_closed, random_implicit, random_turn, ring
from truth_surfaces import deformed, points_at, points_on, random_surface
from truth_tools import COMPOSED, MESHES, random_composed, random_mesh, random_superquadric
from truth_trims import KINDS, Face, trimmed, whole

from cadsculpt.collide.contacts import Contacts
from cadsculpt.collide.detect import DetectOptions, FieldTool, PatchGrid, PointTool, SurfaceTool, detect
from cadsculpt.errors import GeometryError
from cadsculpt.motion.pose import Pose
from cadsculpt.spline.surface import BSplineSurface

Array = NDArray[np.float64]

DENSE, LOCAL = 90, 41
"""Samples along either direction: over a whole patch, and around the aim."""

CLEAR = 1e-7
"""A contact may lie this far outside the tool, or off the surface, relative to the scene's size of ten."""

Tool = FieldTool | PointTool | SurfaceTool
Depth = Callable[[Array], Array]


@dataclass(slots=True)
class Model:
    """A body: its faces with their grids and nets, and dense samples of each, made once per net."""

    faces: list[Face]
    grids: list[PatchGrid]
    nets: list[Array]
    depth: Depth | None = None
    name: str = ""
    samples: list[tuple[Array, Array, Array]] = field(default_factory=list)

    def sampled(self, k: int, u: Array, v: Array) -> tuple[Array, Array]:
        """Points (m, n, 3) of face k, and which of them are surely on it."""
        face = self.faces[k]
        return points_on(face.surface, self.nets[k], u, v), face.value(u[:, None], v[None]) > face.doubt

    def dense(self, rng: np.random.Generator) -> None:
        """Samples all over, at random places between the rows of any grid."""
        self.samples = []
        for k, face in enumerate(self.faces):
            u, v = (jittered(rng, low, high, DENSE) for low, high in face.surface.domain)
            self.samples.append((u, v, self.sampled(k, u, v)[0]))


@dataclass(frozen=True, slots=True)
class Scene:
    """One pair of bodies. deepest : of the points surely on the face. tolerance : what may be missed. untrue (contacts)
    -> how many rows are not true."""

    tool: Tool
    tolerance: float
    deepest: float
    untrue: Callable[[Contacts], int]
    kind: str


def scenes_truth(scenes: int = 10_000, seed: int = 3, per_model: int = 8) -> dict[str, object]:
    """`scenes` scenes, `per_model` of one body, which is deformed between them.

    scenes_touching : with a point deeper than the tolerance. missed, missed_paper_mode : of these, those where a tool that
    touches has no contact. false_contacts : rows that are not true; false_contacts_paper_mode : the same. duplicates :
    rows with the tool, the face and the point of another. scenes_refused : faces for which the engine says that no grid
    finds them. scenes_undecided : the engine says that it may have missed something. scenes_wrong : where to look.
    """
    total: Counter[str] = Counter()
    paper: Counter[str] = Counter()
    tools: Counter[str] = Counter()
    faces: Counter[str] = Counter()
    wrong: list[str] = []
    body = -1
    while total["tested"] < scenes:
        # a body's scenes are the same whatever came before: what is wrong with one can be looked at alone
        body += 1
        rng = np.random.default_rng([seed, body])
        try:
            model = random_model(rng)
        except GeometryError as error:
            if "too small for the collision grid" not in error.what:
                raise
            total["refused"] += 1
            continue
        for place, together in enumerate(random_scenes(rng, model, min(per_model, scenes - total["tested"]))):
            total["tested"] += 1
            total["several tools"] += len(together) > 1
            tools.update(scene.kind for scene in together)
            faces[model.name] += 1
            tolerance = max(scene.tolerance for scene in together)
            touching = [scene.deepest > tolerance for scene in together]
            total["touching"] += any(touching)
            for mode in ("certified", "paper"):
                options = DetectOptions(mode=mode, tolerance=tolerance)  # type: ignore[arg-type]
                found = detect(model.grids, model.nets, [scene.tool for scene in together], options)
                own = [found.contacts.chosen(found.contacts.b == k) for k in range(len(together))]
                untrue = sum(scene.untrue(rows) for scene, rows in zip(together, own, strict=True))
                lost = [
                    scene.kind for scene, rows, touches in zip(together, own, touching, strict=True)
                    if touches and not len(rows)
                ]  # fmt: skip
                total[f"untrue {mode}"] += untrue
                total[f"missed {mode}"] += bool(lost)
                if mode == "paper":
                    paper.update(lost)
                    continue
                again = duplicates(found.contacts)
                total["duplicates"] += again
                total["undecided"] += bool(found.undecided)
                if untrue or lost or again:
                    wrong.append(
                        f"body {body}, {model.name}, scene {place}: missed {lost}, {untrue} false rows, {again} again"
                    )
                    print(wrong[-1], file=sys.stderr, flush=True)
            if total["tested"] % 1000 == 0:
                print(f"scenes: {total['tested']}, {total['missed certified']} missed", file=sys.stderr, flush=True)
    return {
        "scenes_tested": total["tested"],
        "scenes_touching": total["touching"],
        "scenes_refused": total["refused"],
        "scenes_undecided": total["undecided"],
        "scenes_several_tools": total["several tools"],
        "missed": total["missed certified"],
        "missed_paper_mode": total["missed paper"],
        "missed_paper_mode_tools": dict(paper),
        "false_contacts": total["untrue certified"],
        "false_contacts_paper_mode": total["untrue paper"],
        "duplicate_contacts": total["duplicates"],
        "scenes_wrong": wrong,
        "scenes_tools": dict(tools),
        "scenes_faces": dict(faces),
    }


def duplicates(contacts: Contacts) -> int:
    """Rows whose body, tool, face and point are those of another."""
    rows = np.column_stack([contacts.a, contacts.b, contacts.face, contacts.point])
    return len(rows) - len(np.unique(rows, axis=0))


# ------------------------------------------------------------------ bodies


def jittered(rng: np.random.Generator, low: float, high: float, count: int) -> Array:
    """`count` parameters from end to end, at random between."""
    inner = (np.arange(1, count - 1) + rng.uniform(-0.4, 0.4, count - 2)) / (count - 1)
    return np.concatenate([[low], low + (high - low) * inner, [high]])


def random_model(rng: np.random.Generator) -> Model:
    """A surface of any kind, in a third of the cases trimmed; or an exact ball, ring or cube."""
    resolution = int(rng.integers(3, 40)), int(rng.integers(3, 40))
    if rng.random() < 0.25:
        name = str(rng.choice(["ball", "cube", "ring"]))
        size = rng.uniform(2, 6)
        patches = {
            "ball": lambda: [ball(size)],
            "cube": lambda: cube(2 * size),
            "ring": lambda: [ring(size, 0.4 * size)],
        }
        depth: dict[str, Depth] = {
            "ball": lambda x: size - np.linalg.norm(x, axis=1),
            "cube": lambda x: size - np.abs(x).max(axis=1),
            "ring": lambda x: 0.4 * size - np.hypot(np.hypot(x[:, 0], x[:, 1]) - size, x[:, 2]),
        }
        faces = [whole(patch) for patch in patches[name]()]
        pose = Pose(rng.normal(size=3), random_turn(rng))
        nets = [np.ascontiguousarray(pose.to_world(face.surface.control_points)) for face in faces]
        grids = [PatchGrid.of(face.surface, resolution) for face in faces]
        return Model(faces, grids, nets, lambda x: depth[name](pose.to_tool(x)), name)
    surface = random_surface(rng, most_degree=5, most_spans=5, bumps=rng.choice([0.3, 1.0, 3.0]))
    face, name = whole(surface), "surface"
    if not (surface.periodic_u or surface.periodic_v) and rng.random() < 0.45:
        name = str(rng.choice(KINDS))
        face = trimmed(rng, surface, name)
    return Model([face], [PatchGrid.of(face.surface, resolution)], [surface.control_points], None, name)


def random_scenes(rng: np.random.Generator, model: Model, count: int) -> Iterator[list[Scene]]:
    """Scenes with one body: implicit tools of every shape, superquadrics, composed solids and formulas, meshes, closed and
    open B-spline tools, points in solids; in one of twelve several tools at once."""
    shares = {"implicit": 45.0, "surface": 18.0, "superquadric": 6.0, "mesh": 9.0, "composed": 2.0}
    if model.depth is not None:
        shares["point"] = 20.0
    elif model.name == "surface":
        shares["sheet"] = 20.0
    families, share = list(shares), np.array(list(shares.values()))
    for k in range(count):
        if k % 4 == 0:
            if k and model.depth is None:
                model.nets = [deformed(rng, face.surface, 0.5) for face in model.faces]
            model.dense(rng)
        together = 1 if rng.random() < 0.92 else int(rng.integers(2, 4))
        chosen = rng.choice(families, size=together, p=share / share.sum()).tolist()
        yield [SCENES.get(family, solid_scene)(rng, model, family) for family in chosen]


# ------------------------------------------------------------------ scenes


def aim(rng: np.random.Generator, model: Model) -> tuple[int, float, float, Array, Array, Array, Array]:
    """A place on the model: face, u, v, point, S_u and S_v (by differences) and a unit normal; mostly on the face."""
    k = int(rng.integers(len(model.faces)))
    face, (u, v, points) = model.faces[k], model.samples[k]
    i, j = int(rng.integers(1, len(u) - 1)), int(rng.integers(1, len(v) - 1))
    value = face.value(u[1:-1, None], v[None, 1:-1])
    on = np.argwhere(value > face.doubt)
    if len(on) and rng.random() < 0.85:
        if face.doubt and rng.random() < 0.5:
            # near the trim
            on = on[np.argsort(value[tuple(on.T)])[: max(1, len(on) // 4)]]
        i, j = (on[rng.integers(len(on))] + 1).tolist()
    s_u = (points[i + 1, j] - points[i - 1, j]) / (u[i + 1] - u[i - 1])
    s_v = (points[i, j + 1] - points[i, j - 1]) / (v[j + 1] - v[j - 1])
    n = np.cross(s_u, s_v)
    length = np.linalg.norm(n)
    n = n / length if length > 0 else np.array([0, 0, 1.0])
    return k, float(u[i]), float(v[j]), points[i, j], s_u, s_v, n


def deepest_point(
    rng: np.random.Generator,
    model: Model,
    place: tuple[int, float, float, Array, Array, Array, Array],
    reach: float,
    f: Depth,
) -> float:
    """The largest value of f over samples surely on the model: all of them, and finer ones within `reach` of a place."""
    best = -np.inf
    for k, (u, v, points) in enumerate(model.samples):
        on = model.faces[k].value(u[:, None], v[None]) > model.faces[k].doubt
        if on.any():
            best = max(best, float(f(points[on]).max()))
    k, u0, v0, _, s_u, s_v, _ = place
    around = []
    for t, speed, (low, high) in (
        (u0, s_u, model.faces[k].surface.domain[0]),
        (v0, s_v, model.faces[k].surface.domain[1]),
    ):
        half = min(reach / max(float(np.linalg.norm(speed)), 1e-12), high - low)
        around.append(jittered(rng, max(low, t - half), min(high, t + half), LOCAL))
    points, on = model.sampled(k, *around)
    return max(best, float(f(points[on]).max())) if on.any() else best


def solid_scene(rng: np.random.Generator, model: Model, family: str) -> Scene:
    """A solid aimed at a place of the model: grazing, overlapping, or piercing; from much below a cell to the whole."""
    size = 10.0 ** rng.uniform(-1.7, 0.8)
    tolerance = 10.0 ** rng.uniform(-3.5, -1.5)
    solid = random_solid(rng, family, size)
    size = solid.size
    place = aim(rng, model)
    point, normal = place[3], place[6] * rng.choice([-1.0, 1.0])
    turn = random_turn(rng)

    def pose_at(away: float) -> Pose:
        return Pose(point + away * normal - turn @ solid.anchor, turn)

    manner = rng.choice(["graze", "graze", "overlap", "pierce"])
    if manner == "graze":
        # just so deep that the aimed-at point lies a few tolerances inside, or outside
        wanted = tolerance * rng.uniform(-3, 6)
        low, high = 0.0, 4.0 * size + 10 * tolerance
        for _ in range(50):
            middle = 0.5 * (low + high)
            inside = float(solid.depth(pose_at(middle).to_tool(point[None]))[0]) > wanted
            low, high = (middle, high) if inside else (low, middle)
        pose = pose_at(low)
    else:
        pose = pose_at(size * float(rng.normal(scale=0.5)) if manner == "overlap" else 0.0)
    depth: Depth = lambda x: solid.depth(pose.to_tool(x))  # noqa: E731
    deepest = deepest_point(rng, model, place, 1.5 * size, depth)
    tool = solid.placed(pose)
    return Scene(tool, tolerance, deepest, lambda c: untrue_rows(model, c, depth), f"{family} {solid.name}")


def random_solid(rng: np.random.Generator, family: str, size: float) -> Solid:
    match family:
        case "implicit":
            return random_implicit(rng, str(rng.choice(SHAPES)), size)
        case "superquadric":
            return random_superquadric(rng, size)
        case "mesh":
            return random_mesh(rng, str(rng.choice(MESHES)), size)
        case "composed":
            return random_composed(rng, str(rng.choice(COMPOSED)))
    return random_closed(rng, str(rng.choice(SURFACES)), size)


def untrue_rows(model: Model, contacts: Contacts, depth: Depth) -> int:
    """Contacts not on the surface at their (u, v), off the face, or outside the tool."""
    wrong = 0
    for k, face in enumerate(model.faces):
        mine = contacts.face == k
        if not mine.any():
            continue
        u, v, x = contacts.u[mine], contacts.v[mine], contacts.point[mine]
        away = np.linalg.norm(points_at(face.surface, model.nets[k], u, v) - x, axis=1)
        true = (away <= 10 * CLEAR) & (depth(x) >= -10 * CLEAR) & (face.value(u, v) >= -face.doubt)
        wrong += int((~true).sum())
    return wrong


def point_scene(rng: np.random.Generator, model: Model, family: str) -> Scene:
    """A point near the surface of a solid, or anywhere."""
    place = aim(rng, model)
    inside = model.depth
    assert inside is not None
    x = place[3] + place[6] * rng.normal() * 10.0 ** rng.uniform(-6, 0.5)
    if rng.random() < 0.2:
        x = place[3] + rng.normal(size=3) * 3
    depth = float(inside(x[None])[0])

    def untrue(contacts: Contacts) -> int:
        return len(contacts) if depth < -10 * CLEAR or len(contacts) > 1 else 0

    return Scene(PointTool(x, 1.0), 1e-5, depth, untrue, family)


def sheet_scene(rng: np.random.Generator, model: Model, family: str) -> Scene:
    """An open sheet, z = h(x, y) in its own frame, that the model may pierce or cut. Contact is certain where the model
    goes from its front to its back well inside the border."""
    size = 10.0 ** rng.uniform(-0.5, 0.8)
    tolerance = 10.0 ** rng.uniform(-3.5, -2)
    knots = np.concatenate([np.zeros(4), [0.5], np.ones(4)])
    at = np.array([knots[i + 1 : i + 4].mean() for i in range(5)])
    height = rng.normal(scale=0.08, size=(5, 5)) * size
    net = np.empty((5, 5, 3))
    net[..., 0], net[..., 1], net[..., 2] = size * (at[:, None] - 0.5), size * (at[None] - 0.5), height
    grid = PatchGrid.of(BSplineSurface(net, knots, knots, 3, 3), (int(rng.integers(5, 25)), int(rng.integers(5, 25))))
    place = aim(rng, model)
    pose = Pose(place[3] + place[6] * size * rng.normal(scale=0.1), random_turn(rng))
    rows = BSpline(knots, height, 3)

    def behind(x: Array) -> tuple[Array, Array]:
        """How far points lie behind the sheet, along its z, and how far inside its border."""
        local = pose.to_tool(x)
        s = np.clip(local[:, :2] / size + 0.5, 0, 1)
        own = np.asarray(rows(s[:, 0]))
        b = BSpline.design_matrix(s[:, 1], knots, 3).toarray()
        return (own * b).sum(axis=1) - local[:, 2], 0.5 * size - np.abs(local[:, :2]).max(axis=1)

    deepest = -np.inf
    for _, _, points in model.samples:
        shape = points.shape[:2]
        f, border = (x.reshape(shape) for x in behind(points.reshape(-1, 3)))
        inner = border > 0.15 * size
        for a, b in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
            short = np.linalg.norm(points[a] - points[b], axis=2) < 0.1 * size
            through = inner[a] & inner[b] & short & (np.minimum(f[a], f[b]) < 0)
            if through.any():
                deepest = max(deepest, 0.5 * float(np.maximum(f[a], f[b])[through].max()))

    def untrue(contacts: Contacts) -> int:
        if not len(contacts):
            return 0
        f, border = behind(contacts.point)
        face = model.faces[0]
        away = np.linalg.norm(points_at(face.surface, model.nets[0], contacts.u, contacts.v) - contacts.point, axis=1)
        return int(((away > 10 * CLEAR) | ((f < -10 * CLEAR) & (border > 0))).sum())

    tool = SurfaceTool((grid,), (np.ascontiguousarray(pose.to_world(net)),))
    return Scene(tool, tolerance, deepest, untrue, family)


SCENES = {"point": point_scene, "sheet": sheet_scene}
"""How scenes are made that are not those of a solid."""
