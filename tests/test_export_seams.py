"""Faces that share an edge stay closed when both are sculpted, and tangent where they were, if asked; the gap is told."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from cadsculpt.export_fit import Exported, export_fit
from cadsculpt.export_seams import corners_of, in_turn, seams_of
from cadsculpt.model import SourceBody, build_model
from cadsculpt.motion.path import ToolPath
from cadsculpt.patch import SourceEdge, SourceFace
from cadsculpt.scene import Scene
from cadsculpt.session import Session
from cadsculpt.spline.surface import BSplineSurface, TrimCurve, TrimLoop

Array = np.ndarray
Field = Callable[[Array], Array]


def sheet(
    name: str,
    place: Callable[[Array, Array], Array],
    u: tuple[float, float],
    v: tuple[float, float],
    counts: tuple[int, int] = (6, 6),
    degree: int = 3,
    *,
    weights: Array | None = None,
) -> BSplineSurface:
    """A net whose control points are `place` at its Greville abscissae: exact for what is linear in (u, v)."""
    knots, greville = [], []
    for (low, high), count in zip((u, v), counts, strict=True):
        k = np.concatenate([np.full(degree, low), np.linspace(low, high, count - degree + 1), np.full(degree, high)])
        knots.append(k)
        greville.append(np.array([k[i + 1 : i + degree + 1].mean() for i in range(count)]))
    net = place(*np.meshgrid(*greville, indexing="ij"))
    return BSplineSurface(net, *knots, degree, degree, weights, name=name)


def flat(x: Array, y: Array) -> Array:
    return np.stack([x, y, 0 * x], axis=-1)


def sides(surface: BSplineSurface, neighbours: dict[str, tuple[str, ...]]) -> tuple[SourceEdge, ...]:
    """The four sides of an untrimmed face, those with a neighbour among them named "u0", "u1", "v0", "v1"."""
    (u0, u1), (v0, v1) = surface.domain
    ends = {
        "u0": [(u0, v0), (u0, v1)],
        "u1": [(u1, v1), (u1, v0)],
        "v0": [(u0, v0), (u1, v0)],
        "v1": [(u1, v1), (u0, v1)],
    }
    share = np.linspace(0, 1, 65)[:, None]
    return tuple(
        SourceEdge((1 - share) * np.array(a) + share * np.array(b), neighbours.get(side, ()), tolerance=1e-7)
        for side, (a, b) in ends.items()
    )


def session_of(faces: Sequence[SourceFace], nodes: float = 1.0, **refit: object) -> Session:
    scene = Scene.model_validate(
        {
            "units": "mm",
            "model": [
                {
                    "name": "part", "file": "part", "thickness": 4.0, "nodes": nodes, "layers": 1, "material": "clay",
                    "edges": "free",
                }
            ],
            "tool": [
                {
                    "name": "ball",
                    "shape": "sphere",
                    "radius": 8.0,
                    "path": [{"t": 0.0, "at": [20.0, 20.0, 60.0]}, {"t": 0.02, "at": [20.0, 20.0, 59.0]}],
                }
            ],
            "solver": {"resolution": 61, "step": 1e-3},
            "refit": {"tolerance": 0.01} | refit,
        }
    )  # fmt: skip
    paths = {tool.name: ToolPath.of_rows(tool.path) for tool in scene.tool}  # type: ignore[arg-type]
    return Session(build_model(scene, [SourceBody("part", tuple(faces))], paths))


def push(session: Session, field: Field, *, only: int | None = None) -> None:
    """Move every surface node by what `field` says of its place."""
    for i, patch in enumerate(session.model.patches):
        if only is None or i == only:
            x = session.lattice(i).x.reshape(*patch.lattice.shape, 3)
            x[:, :, 0] += field(patch.lattice.nodes.reshape(*patch.lattice.shape, 3)[:, :, 0])


def dent(at: tuple[float, float], width: float, depth: float = 1.0) -> Field:
    def field(points: Array) -> Array:
        g = np.exp(-((points[..., 0] - at[0]) ** 2 + (points[..., 1] - at[1]) ** 2) / (2 * width**2))
        return np.stack([0.2 * g, 0 * g, -depth * g], axis=-1)

    return field


def apart(a: BSplineSurface, b: BSplineSurface, uv_a: Array, uv_b: Array) -> float:
    return float(np.linalg.norm(a.evaluate(*uv_a.T) - b.evaluate(*uv_b.T), axis=1).max())


def two(**changes: object) -> list[SourceFace]:
    """Two plates that meet at x = 20, of other degrees across and other knots along."""
    a = sheet("left", flat, (0, 20), (0, 40), (6, 7))
    b = sheet("right", flat, (20, 40), (0, 40), (5, 9))
    return [
        SourceFace(1, "left", a, sides(a, {"u1": ("right",)})),
        SourceFace(2, "right", b, sides(b, {"u0": ("left",)})),
    ]


def four() -> list[SourceFace]:
    """Four plates around the corner (20, 20); one has its parameters the other way round."""
    spans = {"a": ((0, 20), (0, 20)), "b": ((20, 40), (0, 20)), "c": ((0, 20), (20, 40))}
    faces = []
    beside = {"a": {"u1": "b", "v1": "c"}, "b": {"u0": "a", "v1": "d"}, "c": {"v0": "a", "u1": "d"}}
    for number, (name, (u, v)) in enumerate(spans.items(), 1):
        surface = sheet(name, flat, u, v, (6 + number, 8 - number))
        faces.append(SourceFace(number, name, surface, sides(surface, {k: (n,) for k, n in beside[name].items()})))
    turned = sheet("d", lambda p, q: flat(40 - q, 40 - p), (0, 20), (0, 20), (7, 5))
    # u runs along -y, v along -x: u = 20 is y = 20 (face b), v = 20 is x = 20 (face c)
    faces.append(SourceFace(4, "d", turned, sides(turned, {"u1": ("b",), "v1": ("c",)})))
    return faces


def test_seams_are_found_point_by_point():
    for faces in (two(), four()):
        seams = seams_of(faces)
        assert len(seams) == (1 if len(faces) == 2 else 4)
        for seam in seams:
            a, b = faces[seam.a].surface, faces[seam.b].surface
            assert apart(a, b, seam.uv_a, seam.uv_b) <= 1e-12
            assert len(seam.uv_a) >= 200
            assert seam.tolerance == pytest.approx(max(1e-7 * max(a.size, b.size), 1e-7))
            assert seam.rest_angle < 1e-6
    corners = corners_of(faces)
    assert max(len(corner.places) for corner in corners) == 4
    assert sorted(in_turn(faces, seams)) == [0, 1, 2, 3]


@pytest.mark.parametrize("make", [two, four])
@pytest.mark.parametrize("continuity", ["G0", "G1"])
def test_a_dent_over_the_edges_leaves_them_closed(make, continuity):
    session = session_of(make(), continuity=continuity)
    push(session, dent((20.5, 19.0), 4.0))
    exported = export_fit(session)
    for face in exported.faces:
        assert face.outcome == "within", face.error
        assert np.prod(face.surface.shape) < np.prod(face.read_shape) * 12
    assert len(exported.seams) == len(make()) // 2 + (2 if len(make()) == 4 else 0)
    for seam in exported.seams:
        assert seam.gap <= 1e-12
        if continuity == "G1" and make is two:
            assert seam.angle <= 0.1
    assert exported.seam_max_gap == max(seam.gap for seam in exported.seams)
    assert exported.warnings(0.01, "mm") == []


def test_the_measured_gap_is_that_of_the_exported_surfaces():
    session = session_of(two())
    push(session, dent((20.0, 19.0), 4.0))
    a, b = (face.surface for face in export_fit(session).faces)
    y = np.linspace(0, 40, 1001)
    edge_a, edge_b = np.stack([np.full(1001, 20.0), y], axis=1), np.stack([np.full(1001, 20.0), y], axis=1)
    assert apart(a, b, edge_a, edge_b) <= 1e-12
    assert a.evaluate(20.0, 19.0)[2] == pytest.approx(-1.0, abs=0.02)


def test_lattices_that_went_apart_are_brought_together_and_it_is_told():
    session = session_of(two())
    push(session, dent((20.0, 20.0), 4.0), only=0)
    exported = export_fit(session)
    left = exported.faces[0]
    assert exported.seam_max_gap <= 1e-12
    assert left.surface.evaluate(20.0, 20.0)[2] == pytest.approx(-0.5, abs=0.05)
    assert left.outcome == "seams"
    # the error is that from the face's own lattice: half of the way
    assert left.error.maximum == pytest.approx(0.5 * np.hypot(1.0, 0.2), abs=0.05)
    assert any("have moved otherwise" in line for line in exported.warnings(0.01, "mm"))


def test_tangent_faces_stay_tangent():
    """A smooth crease-free roof over both plates, of unlike parameters: G0 may kink, G1 may not."""
    a = sheet("left", flat, (0, 20), (0, 40), (6, 7))
    b = sheet(
        "right", lambda p, q: flat(40 - 2 * p, 0.5 * q), (0, 10), (0, 80), (6, 8)
    )  # u runs back, at half the pace
    faces = [
        SourceFace(1, "left", a, sides(a, {"u1": ("right",)})),
        SourceFace(2, "right", b, sides(b, {"u1": ("left",)})),
    ]
    angles = {}
    for continuity in ("G0", "G1"):
        session = session_of(faces, continuity=continuity, tolerance=0.05)
        push(session, dent((22.0, 20.0), 5.0, 2.0))
        exported = export_fit(session)
        assert exported.seam_max_gap <= 1e-12
        assert [face.outcome for face in exported.faces] == ["within", "within"]
        angles[continuity] = exported.seams[0].angle
        # by hand, from the normals
        y = np.linspace(0, 40, 301)
        n_a = exported.faces[0].surface.normal(np.full(301, 20.0), y)
        n_b = exported.faces[1].surface.normal(np.full(301, 10.0), 2 * y)
        turned = np.degrees(np.arccos(np.clip(np.abs(np.einsum("nc,nc->n", n_a, n_b)), 0, 1)))
        assert exported.seams[0].angle == pytest.approx(turned.max(), abs=0.02)
    assert angles["G1"] <= 0.1
    assert angles["G0"] > 0.2


def test_a_rational_follower_takes_the_same_curve():
    rng = np.random.default_rng(0)
    faces = two()
    b = replace(faces[1].surface, weights=rng.uniform(0.7, 1.4, faces[1].surface.shape))
    # its boundary must still be the straight edge at the same pace: equal weights along it
    weights = b.weights.copy()
    weights[0] = 0.9
    b = replace(b, weights=weights)
    faces[1] = replace(faces[1], surface=b)
    session = session_of(faces, continuity="G1")
    push(session, dent((20.0, 20.0), 5.0))
    exported = export_fit(session)
    assert exported.seam_max_gap <= 1e-12
    assert exported.seams[0].angle <= 0.1


def three() -> list[SourceFace]:
    """A hexagon of three quadrilaterals around the corner (20, 20): no edge runs on into another there."""
    centre = np.array([20.0, 20.0])
    ring = [centre + 20 * np.array([np.cos(a), np.sin(a)]) for a in np.radians(np.arange(0, 360, 60))]
    beside = {"a": {"v0": "c", "u0": "b"}, "b": {"v0": "a", "u0": "c"}, "c": {"v0": "b", "u0": "a"}}
    faces = []
    for k, name in enumerate("abc"):
        p, q, r = (ring[(2 * k + i) % 6] for i in range(3))

        def place(x: Array, y: Array, p: Array = p, q: Array = q, r: Array = r) -> Array:
            s, t = x[..., None] / 20, y[..., None] / 20
            xy = (1 - s) * (1 - t) * centre + s * (1 - t) * p + s * t * q + (1 - s) * t * r
            return np.concatenate([xy, 0 * xy[..., :1]], axis=-1)

        surface = sheet(name, place, (0, 20), (0, 20), (6 + k, 7 - k))
        neighbours = {side: (other,) for side, other in beside[name].items()}
        faces.append(SourceFace(k + 1, name, surface, sides(surface, neighbours)))
    return faces


@pytest.mark.parametrize(("make", "at"), [(three, (20.5, 19.0)), (four, (22.0, 18.0))])
def test_tangent_faces_stay_tangent_up_to_their_corner(make, at):
    """Angles of the normals across every seam, closer and closer to the corner; the seams are closed there all the same."""
    faces = make()
    session = session_of(faces, continuity="G1")
    push(session, dent(at, 3.0, 1.5))
    exported = export_fit(session)
    assert [face.outcome for face in exported.faces] == ["within"] * len(faces)
    surfaces = [face.surface for face in exported.faces]
    met = 0
    for seam in seams_of(faces):
        ends = faces[seam.a].surface.evaluate(*seam.uv_a[[0, -1]].T)[:, :2]
        order = slice(None, None, 1 if np.linalg.norm(ends[0] - 20) < np.linalg.norm(ends[1] - 20) else -1)
        way = np.linspace(0, 1, len(seam.uv_a))
        near = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 400)])
        uv = [np.stack([np.interp(near, way, x[order, k]) for k in (0, 1)], axis=1) for x in (seam.uv_a, seam.uv_b)]
        a, b = (surfaces[i].normal(*x.T) for i, x in zip((seam.a, seam.b), uv, strict=True))
        turned = np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.abs(np.einsum("nc,nc->n", a, b))))
        assert seam.rest_angle <= 1e-5
        assert turned.max() <= 0.1
        gaps = np.linalg.norm(surfaces[seam.a].evaluate(*uv[0].T) - surfaces[seam.b].evaluate(*uv[1].T), axis=1)
        assert gaps.max() <= 1e-12
        met += 1
    assert met == len(faces)


def wavy(t: Array) -> Array:
    return 20 + 2.0 * np.sin(t / 6.0)


def trimmed_pair() -> list[SourceFace]:
    """Two plates larger than their faces, which meet along a curve that is no parameter line of either."""
    a = sheet("left", flat, (0, 28), (0, 40), (8, 8))
    b = sheet("right", lambda p, q: flat(40 - q, p), (0, 40), (0, 28), (7, 9))  # u along y, v along -x
    y = np.linspace(0, 40, 161)
    curve_a, curve_b = np.stack([wavy(y), y], axis=1), np.stack([y, 40 - wavy(y)], axis=1)

    def face(number: int, surface: BSplineSurface, curve: Array, corners: list, other: str) -> SourceFace:
        rest = np.array([curve[-1], *corners, curve[0]])
        loop = TrimLoop((polyline(curve), polyline(rest)))
        edges = (SourceEdge(curve, (other,), tolerance=1e-3), SourceEdge(rest, ()))
        return SourceFace(number, surface.name, replace(surface, trims=(loop,)), edges)

    return [
        face(1, a, curve_a, [(0.0, 40.0), (0.0, 0.0)], "right"),
        face(2, b, curve_b, [(40.0, 0.0), (0.0, 0.0)], "left"),
    ]


def polyline(points: Array) -> TrimCurve:
    t = np.arange(len(points), dtype=float)
    return TrimCurve(np.asarray(points, dtype=float), np.concatenate([[t[0]], t, [t[-1]]]), 1)


@pytest.mark.parametrize("continuity", ["G0", "G1"])
def test_faces_trimmed_along_a_common_curve_stay_closed(continuity):
    session = session_of(trimmed_pair(), continuity=continuity)
    push(session, dent((20.5, 19.0), 4.0))
    exported = export_fit(session)
    [seam] = exported.seams
    assert [face.outcome for face in exported.faces] == ["within", "within"]
    assert seam.gap <= 1e-3
    y = np.linspace(0, 40, 161)
    a, b = (face.surface for face in exported.faces)
    by_hand = apart(a, b, np.stack([wavy(y), y], axis=1), np.stack([y, 40 - wavy(y)], axis=1))
    assert by_hand <= seam.gap * 1.01 + 1e-12
    if continuity == "G1":
        assert seam.angle <= 0.5


def gap_of(exported: Exported) -> float:
    return exported.seam_max_gap


def test_a_gap_above_the_tolerance_is_told():
    faces = trimmed_pair()
    for k, face in enumerate(faces):
        faces[k] = replace(face, edges=(replace(face.edges[0], tolerance=1e-5), face.edges[1]))
    session = session_of(faces, refine=False)
    push(session, dent((20.5, 19.0), 2.5))
    exported = export_fit(session)
    assert gap_of(exported) > 1e-5
    [line] = [line for line in exported.warnings(0.01, "mm") if "apart" in line]
    assert f"{gap_of(exported):.3g} mm apart" in line
    assert "'left' and 'right'" in line
