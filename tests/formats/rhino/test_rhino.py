"""3DM files: what rhino3dm itself says of them, and what OCCT's checker says of what we make of them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cadsculpt.errors import CadsculptError, InputError
from cadsculpt.formats import step
from cadsculpt.formats.part import Face
from cadsculpt.formats.rhino import part as rhino
from cadsculpt.formats.rhino.archive import OBJECT_TABLE, archive_version, chunks, object_records
from cadsculpt.formats.rhino.geometry import curve_points, encoded
from cadsculpt.spline.refine import insert_knots
from cadsculpt.spline.surface import BSplineSurface

rhino3dm = pytest.importorskip("rhino3dm")

FILES = [
    "TestClosestPoint", "v1_DeformCubes", "v1_Speeder", "v1_Terrain", "v1_UntrimmedSurfaces", "v2_DeformCubes",
    "v2_Flow2", "v2_HumanHead2", "v2_RhinoLogo", "v2_Smooth", "v2_Speeder", "v2_Terrain", "v2_UntrimmedSurfaces",
    "v2_my_surfaces", "v3_HumanHead2", "v3_Terrain", "v3_my_surfaces", "v4_DinerMug", "v4_Gear", "v5_extrusions",
    "v5_my_surfaces", "v5_rhino_logo", "v5_ring", "v7_my_surfaces", "v7_my_trimmed_surface",
]  # fmt: skip

SCULPTED = [
    "v1_Terrain",
    "v2_Terrain",
    "v3_Terrain",
    "v4_DinerMug",
    "v5_extrusions",
    "v5_ring",
    "v7_my_trimmed_surface",
]
"""One of each: version 1; Rhino 2's Breps; in place; a revolution; an extrusion; version 50; a plane in version 70."""


def file(corpus: Path, name: str) -> Path:
    return corpus / "rhino" / f"{name}.3dm"


def refined(surface: BSplineSurface, pieces: int = 8) -> BSplineSurface:
    """The same surface with knots all over its domain."""
    new = []
    for knots, (low, high) in zip((surface.knots_u, surface.knots_v), surface.domain, strict=True):
        places = np.linspace(low, high, pieces + 1)[1:-1] + 1e-3 * (high - low)
        new.append([t for t in places if np.abs(knots - t).min() > 1e-6 * (high - low)])
    return insert_knots(surface, *new)


def dented(surface: BSplineSurface, depth: float = 0.05) -> BSplineSurface:
    """A finer net for the surface, with a few control points in its middle pushed along the normal."""
    fine = refined(surface)
    net = fine.control_points.copy()
    rows, columns = (
        slice(max(n // 2 - 1, p + 1), min(n // 2 + 2, n - p - 1))
        for n, p in zip(fine.shape, degrees(fine), strict=True)
    )
    middle = [0.5 * (low + high) for low, high in surface.domain]
    net[rows, columns] += depth * surface.size * surface.normal(*middle)
    return fine.with_control_points(net)


def degrees(surface: BSplineSurface) -> tuple[int, int]:
    return surface.degree_u, surface.degree_v


def attributes(thing: object) -> dict[str, object]:
    """What rhino3dm tells of an object beside its geometry."""
    a = thing.Attributes  # type: ignore[attr-defined]
    names = (
        "Name",
        "LayerIndex",
        "ObjectColor",
        "ColorSource",
        "MaterialIndex",
        "Mode",
        "Visible",
        "WireDensity",
        "Url",
    )
    return {name: getattr(a, name) for name in names}


# ---------------------------------------------------------------------- reading


@pytest.mark.corpus
@pytest.mark.parametrize("name", FILES)
def test_faces_are_those_of_the_index(corpus: Path, name: str) -> None:
    line = next(row for row in (corpus / "INDEX.md").read_text().splitlines() if row.startswith(f"| rhino/{name}.3dm"))
    match = re.search(r"\| (\d+) surfaces", line)
    assert match is not None
    part = rhino.read(file(corpus, name))
    assert len(part.faces) == int(match[1])
    assert len({face.name for face in part.faces}) == len(part.faces)
    assert not any(face.warning for face in part.faces)
    assert part.units == ("" if "unit None" in line else "mm")
    assert any("no length unit" in warning for warning in part.warnings) == ("unit None" in line)


@pytest.mark.corpus
@pytest.mark.parametrize("name", FILES)
def test_surfaces_are_rhino3dms(corpus: Path, name: str) -> None:
    """Same points at the same parameters, and trim curves on the surface where Rhino has its edges."""
    rng = np.random.default_rng(7)
    for body in rhino.read(file(corpus, name)).bodies:
        for index in range(len(body.brep.faces))[:12]:
            surface, form = body.read_surface(index), body.form(index)
            truth = body.thing.Surfaces[body.brep.faces[index].surface]
            uv = np.array([truth.Domain(axis).T0 + rng.random(20) * _length(truth, axis) for axis in (0, 1)]).T
            here = uv if form.parameters is None else form.parameters(uv)
            points = np.array([_xyz(truth.PointAt(u, v)) for u, v in uv.tolist()])
            assert np.abs(surface.evaluate(*here.T) - points).max() <= 1e-12 * surface.size
            for trim in body.trims_of_face(index):
                if trim.edge < 0:
                    continue
                ends = body.trim(trim.index).control_points[[0, -1]]
                edge = body.thing.Edges[trim.edge]
                truth_ends = np.array([_xyz(edge.PointAtStart), _xyz(edge.PointAtEnd)])
                if trim.reversed:
                    truth_ends = truth_ends[::-1]
                gap = np.linalg.norm(surface.evaluate(*ends.T) - truth_ends, axis=1).max()
                assert gap <= max(5e-3 * surface.size, 1.01 * body.brep.edges[trim.edge].tolerance)


def _length(surface: object, axis: int) -> float:
    domain = surface.Domain(axis)  # type: ignore[attr-defined]
    return float(domain.T1 - domain.T0)


def _xyz(point: object) -> tuple[float, float, float]:
    return point.X, point.Y, point.Z  # type: ignore[attr-defined]


@pytest.mark.corpus
def test_trims_follow_the_nurbs_form_of_a_revolution(corpus: Path) -> None:
    """A trim curve carried to the NURBS form's parameters runs where it ran on the surface of revolution."""
    from cadsculpt.formats.rhino.geometry import part_of_curve

    body = rhino.read(file(corpus, "v4_DinerMug")).bodies[0]
    assert body.form(0).kind == "revolution"
    surface = body.read_surface(0)
    truth = body.thing.Surfaces[body.brep.faces[0].surface]
    for trim in body.trims_of_face(0):
        chunk = body.brep.curves2[trim.curve2]
        assert chunk is not None
        own = part_of_curve(chunk, trim.proxy)
        carried = body.trim(trim.index)
        t = np.linspace(*trim.proxy, 41)
        points = np.array([_xyz(truth.PointAt(u, v)) for u, v in curve_points(own, t).tolist()])
        if len(carried.control_points) == 2:  # a parameter line: only the ends keep their pace
            t, points = t[[0, -1]], points[[0, -1]]
        from cadsculpt.formats.occt.trim import evaluate_trim

        uv = evaluate_trim(carried, t)
        assert np.abs(surface.evaluate(*uv.T) - points).max() <= 1e-9 * surface.size


@pytest.mark.corpus
@pytest.mark.parametrize("name", ["TestClosestPoint", "v1_UntrimmedSurfaces", "v4_Gear", "v5_ring"])
def test_shells_are_valid_and_neighbours_mutual(corpus: Path, name: str) -> None:
    part = rhino.read(file(corpus, name))
    assert part.validity().valid
    assert all(np.isfinite(face.area) and face.area > 0 for face in part.faces)
    edges = {face.number: face.edges for face in part.faces}
    neighbours = {number: {n for edge in found for n in edge.neighbours} for number, found in edges.items()}
    for face in part.faces:
        surface = face.surface
        for edge in edges[face.number]:
            assert np.array_equal(surface.evaluate(edge.uv[:, 0], edge.uv[:, 1]), edge.points)
        assert face.number not in neighbours[face.number]
        assert all(face.number in neighbours[other] for other in neighbours[face.number])


@pytest.mark.corpus
def test_area_is_that_of_the_render_meshes(corpus: Path) -> None:
    """Rhino's own meshes, inscribed, bound the areas from a little below."""
    part = rhino.read(file(corpus, "v4_DinerMug"))
    body = part.bodies[0]
    for index, face in enumerate(part.faces):
        mesh = body.thing.Faces[index].GetMesh(rhino3dm.MeshType.Render)
        vertices = np.array([_xyz(p) for p in mesh.Vertices])
        quads = np.array([list(corners) for corners in mesh.Faces])
        area = 0.0
        for i, j in ((1, 2), (2, 3)):
            a, b = (vertices[quads[:, k]] - vertices[quads[:, 0]] for k in (i, j))
            area += 0.5 * np.linalg.norm(np.cross(a, b), axis=1).sum()
        assert face.area == pytest.approx(area, rel=5e-3)


# -------------------------------------------------------------------- sculpting


@pytest.mark.corpus
@pytest.mark.parametrize("name", SCULPTED)
def test_sculpted_back_into_the_same_file(corpus: Path, name: str, tmp_path: Path) -> None:
    path, out = file(corpus, name), tmp_path / "sculpted.3dm"
    part = rhino.read(path)
    face = max(part.faces, key=lambda f: f.area)
    new = dented(face.surface)
    others = {f.number: f.surface for f in part.faces if f.number != face.number}
    record = next(b.place.record for b in part.bodies if b.first <= face.number < b.first + len(b.brep.faces))
    assert part.validity().valid
    part.sculpt({face.number: new})
    assert part.validity().valid
    assert np.array_equal(face.surface.control_points, new.control_points)
    part.write(out, "3dm")
    again = tmp_path / "again.3dm"
    part.write(again, "3dm")
    assert again.read_bytes() == out.read_bytes()

    back = rhino.read(out)
    assert [f.name for f in back.faces] == [f.name for f in part.faces]
    assert back.validity().valid
    got = back.faces.number(face.number).surface
    assert np.abs(got.control_points - new.control_points).max() <= 1e-9
    assert np.array_equal(got.knots_u, new.knots_u)
    assert np.array_equal(got.knots_v, new.knots_v)
    for number, surface in others.items():
        same = back.faces.number(number).surface
        assert np.array_equal(same.control_points, surface.control_points)
        assert np.array_equal(same.knots_u, surface.knots_u)

    was, now = rhino3dm.File3dm.Read(str(path)), rhino3dm.File3dm.Read(str(out))
    assert all(thing.Geometry.IsValid for thing in now.Objects)
    assert [layer.Name for layer in now.Layers] == [layer.Name for layer in was.Layers]
    assert len(now.Objects) == len(was.Objects)
    for i, (a, b) in enumerate(zip(was.Objects, now.Objects, strict=True)):
        assert attributes(a) == attributes(b)
        if i != record:
            assert encoded(a.Geometry) == encoded(b.Geometry)
    if was.ArchiveVersion > 1:
        assert_rest_untouched(path.read_bytes(), out.read_bytes(), record)


def assert_rest_untouched(was: bytes, now: bytes, record: int) -> None:
    """Every table but the objects', every other object and this one's attributes are the same bytes."""
    version = archive_version(was)
    tables = [list(chunks(data, 32, len(data), version)) for data in (was, now)]
    assert [c.typecode for c in tables[0]] == [c.typecode for c in tables[1]]
    for a, b in zip(*(t[:-1] for t in tables), strict=True):
        if a.typecode != OBJECT_TABLE:
            assert was[a.start : a.end] == now[b.start : b.end]
    assert int.from_bytes(now[tables[1][-1].body : tables[1][-1].end], "little") == len(now)
    for i, (a, b) in enumerate(zip(object_records(was), object_records(now), strict=True)):
        start = (a.chunk.start, b.chunk.start) if i != record else (a.record.chunk.end, b.record.chunk.end)
        if i == record:
            assert was[start[0] : a.chunk.end] == now[start[1] : b.chunk.end]
        else:
            assert was[a.chunk.start : a.chunk.end] == now[b.chunk.start : b.chunk.end]


@pytest.mark.parametrize("version", [3, 4, 5, 6, 7, 8])
def test_what_has_no_surface_is_left_as_it_is(version: int, tmp_path: Path) -> None:
    """Meshes, points, curves, SubDs and text beside the face that is sculpted: the same bytes, on the same layers."""
    model = rhino3dm.File3dm()
    model.Settings.ModelUnitSystem = rhino3dm.UnitSystem.Centimeters
    for name, colour in (("bodies", (200, 10, 10, 255)), ("meshes", (10, 200, 10, 255))):
        layer = rhino3dm.Layer()
        layer.Name, layer.Color = name, colour
        model.Layers.Add(layer)
    mesh = rhino3dm.Mesh()
    for x, y, z in ((0, 0, 0), (4, 0, 0), (0, 4, 1)):
        mesh.Vertices.Add(x, y, z)
    mesh.Faces.AddFace(0, 1, 2)
    attributes_of = {}
    for name, layer_index in (("sheet", 0), ("net", 1)):
        attributes_of[name] = rhino3dm.ObjectAttributes()
        attributes_of[name].Name, attributes_of[name].LayerIndex = name, layer_index
    sheet = rhino3dm.NurbsSurface.Create(3, False, 4, 4, 6, 6)
    for i in range(6):
        for j in range(6):
            sheet.Points[i, j] = rhino3dm.Point4d(2.0 * i, 3.0 * j, 0.1 * i * j, 1.0)
    for knots in (sheet.KnotsU, sheet.KnotsV):
        knots.CreateUniformKnots(1.0)
    model.Objects.AddMesh(mesh, attributes_of["net"])
    model.Objects.AddSurface(sheet, attributes_of["sheet"])
    model.Objects.AddPoint(rhino3dm.Point3d(1, 2, 3))
    model.Objects.AddLine(rhino3dm.Point3d(0, 0, 0), rhino3dm.Point3d(1, 1, 1))
    if version >= 7:
        model.Objects.Add(rhino3dm.SubD(), rhino3dm.ObjectAttributes())
    path, out = tmp_path / "mixed.3dm", tmp_path / "out.3dm"
    assert model.Write(str(path), version)

    part = rhino.read(path)
    assert part.units == "cm"
    (face,) = part.faces
    assert face.name == "sheet"
    new = dented(face.surface)
    part.sculpt({1: new})
    part.write(out, "3dm")
    was, now = path.read_bytes(), out.read_bytes()
    record = next(i for i, r in enumerate(object_records(was)) if r.holds_surfaces)
    assert_rest_untouched(was, now, record)
    back = rhino.read(out)
    assert np.abs(back.faces[0].surface.control_points - new.control_points).max() <= 1e-9
    read = rhino3dm.File3dm.Read(str(out))
    assert [(layer.Name, layer.Color) for layer in read.Layers] == [
        (layer.Name, layer.Color) for layer in rhino3dm.File3dm.Read(str(path)).Layers
    ]


@pytest.mark.corpus
@pytest.mark.parametrize("name", ["v2_Terrain", "v5_ring", "v4_DinerMug"])
def test_sculpted_part_as_step(corpus: Path, name: str, tmp_path: Path) -> None:
    part = rhino.read(file(corpus, name))
    face = max((f for f in part.faces if f.kind == "bspline"), key=lambda f: f.area)
    part.sculpt({face.number: dented(face.surface, 0.02)})
    part.write(tmp_path / "part.step", "step")
    back = step.read(tmp_path / "part.step")
    assert len(back.faces) == len(part.faces)
    assert back.validity().valid
    for ours in part.faces:
        theirs: Face = back.faces.named(ours.name)
        a, b = ours.surface, theirs.surface
        assert np.allclose(a.domain, b.domain, rtol=0, atol=1e-12)
        if a.closed_u or a.closed_v:  # OCCT's reader rolls closed surfaces up: the same points by other control points
            u, v = (np.linspace(low, high, 17) for low, high in a.domain)
            assert np.abs(a.evaluate(u[:, None], v) - b.evaluate(u[:, None], v)).max() <= 1e-9
        else:
            assert np.abs(a.control_points - b.control_points).max() <= 1e-9
            assert np.abs(a.knots_u - b.knots_u).max() <= 1e-9


@pytest.mark.corpus
def test_stale_meshes_go_and_others_stay(corpus: Path, tmp_path: Path) -> None:
    part = rhino.read(file(corpus, "v5_ring"))
    before = part.bodies[0].brep.render_meshes
    assert all(before)
    part.sculpt({20: dented(part.faces.number(20).surface, 0.01)})
    part.write(tmp_path / "ring.3dm", "3dm")
    after = rhino.read(tmp_path / "ring.3dm").bodies[0].brep.render_meshes
    assert after[19] is None
    assert [m for i, m in enumerate(after) if i != 19] == [m for i, m in enumerate(before) if i != 19]


def box_file(path: Path) -> None:
    """A closed box of six planes, and a point that has nothing to do with it."""
    model = rhino3dm.File3dm()
    model.Settings.ModelUnitSystem = rhino3dm.UnitSystem.Millimeters
    corner = rhino3dm.BoundingBox(rhino3dm.Point3d(0, 0, 0), rhino3dm.Point3d(20, 30, 10))
    attributes = rhino3dm.ObjectAttributes()
    attributes.Name = "box"
    model.Objects.AddBrep(rhino3dm.Brep.CreateFromBoundingBox(corner), attributes)
    model.Objects.AddPoint(rhino3dm.Point3d(5, 5, 5))
    model.Write(str(path), 7)


def bulged(surface: BSplineSurface) -> BSplineSurface:
    """Control points moved by a field of space that is linear along a box's edges: faces that met still meet."""
    fine = refined(refined(surface))
    fine = refined(fine, 16)
    p = fine.control_points
    field = np.zeros_like(p)
    field[..., 2] = (p[..., 0] / 20) * (p[..., 2] / 10)
    return fine.with_control_points(p + field)


def test_edges_follow_when_all_their_faces_are_sculpted(tmp_path: Path) -> None:
    box_file(tmp_path / "box.3dm")
    part = rhino.read(tmp_path / "box.3dm")
    assert len(part.faces) == 6
    part.sculpt({face.number: bulged(face.surface) for face in part.faces})
    assert not part.warnings
    part.write(tmp_path / "bulged.3dm", "3dm")
    back = rhino.read(tmp_path / "bulged.3dm")
    assert back.validity().valid
    body = back.bodies[0]
    assert body.thing.IsValid
    assert body.thing.IsSolid
    moved = 0
    for edge in body.brep.edges:
        curve = body.thing.Edges[edge.index]
        for trim in edge.trims:
            surface = body.surface(body.face_of_trim(body.brep.trims[trim]))
            uv = body.trim_toward_edge(trim).control_points[[0, -1]]
            ends = np.array([_xyz(curve.PointAtStart), _xyz(curve.PointAtEnd)])
            assert np.abs(surface.evaluate(*uv.T) - ends).max() <= 1e-9
        middle = np.array(_xyz(curve.PointAt(0.5 * (curve.Domain.T0 + curve.Domain.T1))))
        moved += bool(middle[2] not in (0.0, 5.0, 10.0))
    assert moved >= 4
    assert body.brep.box[5] == pytest.approx(11.0)
    for vertex in body.brep.vertices:
        z = 10.0 + vertex.point[0] / 20 if vertex.point[2] > 5 else 0.0
        assert vertex.point[2] == pytest.approx(z, abs=1e-12)


def test_an_edge_that_another_face_holds_stays_and_is_told(tmp_path: Path) -> None:
    box_file(tmp_path / "box.3dm")
    part = rhino.read(tmp_path / "box.3dm")
    top = max(part.faces, key=lambda face: face.bbox[2])
    fine = refined(top.surface)
    net = fine.control_points.copy()
    net[0] += [0.0, 0.0, 0.5]
    part.sculpt({top.number: fine.with_control_points(net)})
    assert any("hold (3), by up to 0.5 mm" in warning for warning in part.warnings)
    part.write(tmp_path / "torn.3dm", "3dm")
    tolerances = [edge.tolerance for edge in rhino.read(tmp_path / "torn.3dm").bodies[0].brep.edges]
    assert max(tolerances) == pytest.approx(0.5)


def test_free_border_of_a_surface_moves(tmp_path: Path) -> None:
    """A sheet Brep whose border is pushed: edges and corners go along, and OCCT agrees."""
    net = np.stack([*np.meshgrid(np.arange(5.0), np.arange(6.0), indexing="ij"), np.zeros((5, 6))], axis=-1)
    surface = rhino3dm.NurbsSurface.Create(3, False, 4, 4, 5, 6)
    for (i, j), point in ((ij, net[ij]) for ij in np.ndindex(5, 6)):
        surface.Points[(i, j)] = rhino3dm.Point4d(*point, 1.0)
    for knots, count in ((surface.KnotsU, 5), (surface.KnotsV, 6)):
        knots.CreateUniformKnots(1.0)
        assert len(knots) == count + 2
    model = rhino3dm.File3dm()
    model.Settings.ModelUnitSystem = rhino3dm.UnitSystem.Millimeters
    model.Objects.AddBrep(rhino3dm.Brep.CreateFromSurface(surface), None)
    model.Write(str(tmp_path / "sheet.3dm"), 6)
    part = rhino.read(tmp_path / "sheet.3dm")
    read = part.faces[0].surface
    moved = read.control_points.copy()
    moved[0, :, 2] += np.linspace(0.5, 1.5, 6)
    part.sculpt({1: read.with_control_points(moved)})
    assert part.validity().valid
    part.write(tmp_path / "moved.3dm", "3dm")
    body = rhino.read(tmp_path / "moved.3dm").bodies[0]
    assert body.thing.IsValid
    heights = sorted(vertex.point[2] for vertex in body.brep.vertices)
    assert heights == pytest.approx([0.0, 0.0, 0.5, 1.5])
    assert all(edge.tolerance <= 1e-6 for edge in body.brep.edges)


# ------------------------------------------------------------------ blocks, units


def block_file(path: Path, *placements: object) -> None:
    """A block of a rational sheet and a cylinder, in inches, placed at each transform."""
    surface = rhino3dm.NurbsSurface.Create(3, True, 3, 4, 5, 6)
    for i, j in np.ndindex(5, 6):
        w = 1 + 0.1 * i * j
        surface.Points[(i, j)] = rhino3dm.Point4d(i * w, j * w, 0.3 * np.sin(i + j) * w, w)
    for knots, values in ((surface.KnotsU, [0, 0, 1, 2, 3, 3]), (surface.KnotsV, [0, 0, 0, 1.5, 2, 4, 4, 4])):
        for i, value in enumerate(values):
            knots[i] = value
    axis = rhino3dm.Circle(rhino3dm.Point3d(0, 0, 0), 2.0)
    cylinder = rhino3dm.Brep.CreateFromCylinder(rhino3dm.Cylinder(axis, 5.0), True, True)
    model = rhino3dm.File3dm()
    model.Settings.ModelUnitSystem = rhino3dm.UnitSystem.Inches
    named = rhino3dm.ObjectAttributes()
    named.Name = "skin"
    model.InstanceDefinitions.Add(
        "handle", "", "", "", rhino3dm.Point3d(0, 0, 0),
        (rhino3dm.Brep.CreateFromSurface(surface), cylinder), (named, rhino3dm.ObjectAttributes()),
    )  # fmt: skip
    identity = model.InstanceDefinitions[0].Id
    for placement in placements:
        model.Objects.AddInstanceObject(rhino3dm.InstanceReference(identity, placement), rhino3dm.ObjectAttributes())
    model.Write(str(path), 7)


def turned() -> object:
    return rhino3dm.Transform.Rotation(0.5, rhino3dm.Vector3d(1, 1, 0), rhino3dm.Point3d(1, 0, 0))


def test_blocks_stand_where_they_are_placed_and_take_the_sculpting_back(tmp_path: Path) -> None:
    block_file(tmp_path / "block.3dm", turned())
    part = rhino.read(tmp_path / "block.3dm")
    assert part.units == "in"
    assert [face.kind for face in part.faces] == ["bspline", "cylinder", "bspline", "bspline"]
    skin = part.faces["skin"]
    transform = np.array([[getattr(turned(), f"M{i}{j}") for j in range(4)] for i in range(4)])
    corner = 25.4 * (transform @ np.array([0.0, 0.0, 0.0, 1.0]))[:3]
    assert np.allclose(skin.surface.control_points[0, 0], corner, atol=1e-12)
    assert part.faces[1].area == pytest.approx(2 * np.pi * 2 * 5 * 25.4**2, rel=1e-9)
    skinned, round_ = dented(skin.surface), dented(part.faces[1].surface, 0.01)
    part.sculpt({skin.number: skinned, 2: round_})
    part.write(tmp_path / "sculpted.3dm", "3dm")
    back = rhino.read(tmp_path / "sculpted.3dm")
    assert back.validity().valid
    assert np.abs(back.faces["skin"].surface.control_points - skinned.control_points).max() <= 1e-9
    assert np.abs(back.faces[1].surface.control_points - round_.control_points).max() <= 1e-9
    assert np.array_equal(back.faces[2].surface.control_points, part.faces[2].surface.control_points)


def test_a_block_placed_twice_is_not_sculpted_behind_the_users_back(tmp_path: Path) -> None:
    mirror = rhino3dm.Transform.Mirror(rhino3dm.Point3d(0, 0, 0), rhino3dm.Vector3d(0, 0, 1))
    block_file(tmp_path / "twice.3dm", turned(), mirror)
    part = rhino.read(tmp_path / "twice.3dm")
    assert len(part.faces) == 8
    assert part.validity().valid
    one, two = part.faces[1], part.faces[5]
    assert one.area == pytest.approx(two.area, rel=1e-12)
    for face, centre in ((one, None), (two, np.array([0.0, 0.0, -2.5 * 25.4]))):
        (u0, u1), (v0, v1) = face.surface.domain
        place = face.surface.evaluate(0.3 * u0 + 0.7 * u1, 0.5 * (v0 + v1))
        normal = face.surface.normal(0.3 * u0 + 0.7 * u1, 0.5 * (v0 + v1))
        if centre is not None:  # mirrored, the normal still points out of the cylinder
            assert normal @ (place - centre) > 0
    with pytest.raises(InputError, match="'handle', which stands in the model 2 times"):
        part.sculpt({1: part.faces[0].surface})


@pytest.mark.corpus
def test_sculpting_with_another_degree_is_refused(corpus: Path) -> None:
    part = rhino.read(file(corpus, "v7_my_surfaces"))
    surface = part.faces[0].surface
    other = BSplineSurface(np.zeros((2, 2, 3)), np.array([0.0, 0, 1, 1]), np.array([0.0, 0, 1, 1]), 1, 1)
    assert surface.degree_u != 1
    with pytest.raises(CadsculptError, match="other degrees"):
        part.sculpt({1: other})
