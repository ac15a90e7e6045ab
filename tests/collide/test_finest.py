"""All crossing pairs of two finest meshes: those of every triangle against every other, and of the contacts' pipeline."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadsculpt.collide.crossing import crossings
from cadsculpt.collide.detect import DetectCache, DetectOptions, SurfaceTool, detect
from cadsculpt.collide.grid import PatchGrid
from cadsculpt.collide.tri_tri import Relation, triangle_relation
from cadsculpt.collide.triangulate import whole_mesh
from cadsculpt.errors import GeometryError
from cadsculpt.spline.surface import TrimCurve, TrimLoop


def _body(*surfaces, resolution=14):
    grids = tuple(PatchGrid.of(s, resolution) for s in surfaces)
    return SurfaceTool(grids, tuple(np.array(s.control_points) for s in surfaces))


def _brute(a, b):
    """{(triangle of a, triangle of b): relation} over all pairs of the whole meshes, trimmed parts left out."""
    (p, s), (q, t) = (whole_mesh(body.grids[0], body.nets[0]) for body in (a, b))
    s, t = (tri[body.grids[0].on_face[tri].any(axis=1)] for body, tri in ((a, s), (b, t)))
    near = (p[s].min(axis=1)[:, None] <= q[t].max(axis=1)).all(axis=2)
    near &= (p[s].max(axis=1)[:, None] >= q[t].min(axis=1)).all(axis=2)
    out = {}
    for i, k in np.argwhere(near):
        relation, _ = triangle_relation(p[s[i]], q[t[k]])
        if relation is not Relation.DISJOINT:
            out[(*s[i].tolist(), *t[k].tolist())] = relation
    return out


def _pairs(found):
    return {
        (*x, *y): Relation(r)
        for x, y, r in zip(found.model_triangle.tolist(), found.tool_triangle.tolist(), found.relation, strict=True)
    }


def _unordered(found):
    sides = (found.face, found.tool_face, np.sort(found.model_triangle), np.sort(found.tool_triangle), found.relation)
    return {tuple(row) for row in np.column_stack(sides).tolist()}


@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e6])
@pytest.mark.parametrize("seed", range(4))
def test_all_pairs_of_the_whole_meshes_and_no_other(shapes, seed, scale):
    rng = np.random.default_rng(seed)
    a, b = (shapes.random_surface(rng, rational=k == seed % 2).scaled(scale) for k in range(2))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    b = b.with_control_points((b.control_points - 5.0 * scale) @ (turn if seed > 1 else np.eye(3)) + 5.1 * scale)
    mine, its = _body(a), _body(b, resolution=11)
    found = crossings(mine, its)
    expected = _brute(mine, its)
    assert len(expected) > 10
    assert _pairs(found) == expected
    assert len(found) == len(expected)


def test_degenerate_scenes(shapes):
    """Coplanar sheets, the same sheet twice, sheets that share an edge, lattice points on lattice lines; poles and seams."""
    flat = shapes.plate(4.0, 4, 3)
    ball = shapes.ball(1.5, [2.0, 2.0, 0.0])
    shifted = flat.with_control_points(flat.control_points + [2.0, 0.0, 0.0])
    upright = flat.with_control_points(flat.control_points[..., [0, 2, 1]])
    cube = shapes.box(2.0, [2.0, 2.0, 0.0])[0]  # exactly flat, and cut to the finest all the same
    for a, b in (
        (cube, flat),
        (cube, ball),
        (flat, shifted),
        (flat, flat),
        (flat, upright),
        (flat, ball),
        (ball, flat),
        (ball, ball),
    ):
        mine, its = _body(a, resolution=7), _body(b, resolution=7)
        expected = _brute(mine, its)
        assert len(expected) > 5
        assert _pairs(crossings(mine, its)) == expected


def test_sheets_that_run_side_by_side(shapes):
    """Close everywhere and nowhere crossing; then by one rounding apart, and by none."""
    wave = shapes.plate(10.0, 9, 3, height=lambda x, y: np.sin(x) * np.cos(y))
    mine = _body(wave, resolution=41)
    above = SurfaceTool(mine.grids, (wave.control_points + [0.0, 0.0, 1e-9],))
    assert len(crossings(mine, above)) == 0
    assert len(crossings(mine, mine)) > 2 * 40 * 40
    flat = _body(shapes.plate(1.0, 4, 3, z=1.0), resolution=9)
    up = flat.nets[0].copy()
    up[..., 2] = np.nextafter(1.0, 2.0)
    points, _ = whole_mesh(flat.grids[0], up)
    truth = _brute(flat, SurfaceTool(flat.grids, (up,)))
    assert _pairs(crossings(flat, SurfaceTool(flat.grids, (up,)))) == truth
    assert np.isfinite(points).all()


def test_the_contacts_pipeline_finds_the_same_pairs(shapes):
    """Tolerance 0 and nothing exactly flat, so that it refines everywhere; several patches on both sides, nets that
    change, one cache for all."""
    wave = shapes.plate(10.0, 8, 3, height=lambda x, y: 0.4 * np.sin(x + y))
    mine = _body(wave, shapes.plate(10.0, 6, 3, z=0.3), resolution=41)
    its = _body(shapes.ball(1.5, [3.0, 6.0, 1.0]), shapes.ball(2.0, [6.0, 3.0, 0.5]), resolution=(17, 9))
    rng = np.random.default_rng(3)
    cache, other = DetectCache(), DetectCache()
    for _ in range(3):
        nets = tuple(net + 0.05 * rng.normal(size=net.shape) for net in mine.nets)
        found = crossings(SurfaceTool(mine.grids, nets), its, cache)
        truth = detect(mine.grids, nets, [its], DetectOptions(), cache=other).crossings
        assert len(found) == len(truth) > 50
        assert _unordered(found) == _unordered(truth)
        # in order: patches, then cells of a, then of b
        places = np.column_stack([found.face, found.tool_face])
        assert np.array_equal(places, places[np.lexsort(places.T[::-1])])
        assert len(np.unique(places, axis=0)) > 3


def test_a_trimmed_face_crosses_only_where_it_is(shapes):
    line = np.array([0.0, 0, 1, 1])
    corners = [(0.3, 0.3), (0.7, 0.3), (0.7, 0.7), (0.3, 0.7)]
    loop = TrimLoop(
        tuple(TrimCurve(np.array(ends), line, 1) for ends in zip(corners, corners[1:] + corners[:1], strict=True))
    )
    sheet = replace(shapes.plate(10.0), trims=(loop,))
    mine, its = _body(sheet, resolution=21), _body(shapes.ball(3.0, [5.0, 5.0, 1.0]), resolution=15)
    found = _pairs(crossings(mine, its))
    assert found == _brute(mine, its)
    whole = _pairs(crossings(_body(shapes.plate(10.0), resolution=21), its))
    assert 0 < len(found) < len(whole)


def test_segments_lie_in_both_triangles(shapes):
    rng = np.random.default_rng(8)
    a, b = (shapes.random_surface(rng) for _ in range(2))
    mine, its = _body(a), _body(b.with_control_points(b.control_points + [0.3, 0.2, 0.1]))
    found = crossings(mine, its)
    crossing = found.relation == Relation.CROSSING
    assert crossing.sum() > 10
    for body, triangles in ((mine, found.model_triangle), (its, found.tool_triangle)):
        points, _ = whole_mesh(body.grids[0], body.nets[0])
        p = points[triangles[crossing]]
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        off = np.einsum("nek,nk->ne", found.segment[crossing] - p[:, :1], normal)
        assert np.abs(off).max() < 1e-9


def test_bodies_apart_and_bad_nets(shapes):
    mine, far = _body(shapes.plate(1.0)), _body(shapes.plate(1.0, z=9.0))
    assert len(crossings(mine, far)) == 0
    spoilt = mine.nets[0].copy()
    spoilt[0, 0, 0] = np.nan
    with pytest.raises(GeometryError, match="patch 0 of the first body"):
        crossings(SurfaceTool(mine.grids, (spoilt,)), far)
    with pytest.raises(GeometryError, match="patch 0 of the second body"):
        crossings(far, SurfaceTool(mine.grids, (spoilt,)))
