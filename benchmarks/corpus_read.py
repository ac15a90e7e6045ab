"""Reading one real file: does it come in, and is its area what others say?"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from corpus_index import Entry

from cadsculpt.errors import CadsculptError
from cadsculpt.formats import registry
from cadsculpt.formats.mesh import read_mesh
from cadsculpt.formats.part import Part
from cadsculpt.formats.paths import path_file
from cadsculpt.scene_tool import PathOptions

SPLINES = ("bspline", "bezier")

AGREES = 1e-3
"""Relative difference of two areas below which they agree."""


def read_row(entry: Entry) -> dict[str, Any]:
    """read_ok, what was read, and the areas. A file that is refused in one line has `refused` and no more."""
    try:
        if entry.kind == "ccd":
            return {"read_ok": True, **_queries(entry.path)}
        if entry.kind == "toolpath":
            return {"read_ok": True, **_toolpath(entry.path)}
        if entry.kind == "mesh":
            mesh = read_mesh(entry.path)
            return {
                "read_ok": True,
                "triangles": len(mesh.triangles),
                "closed": mesh.closed,
                "warnings": list(mesh.warnings),
            }
        return _part_row(entry)
    except CadsculptError as error:
        return {"read_ok": False, "refused": str(error).replace(str(entry.path), entry.name)}


def _part_row(entry: Entry) -> dict[str, Any]:
    part = registry.read(entry.path)
    area, lost = 0.0, 0
    for face in part.faces:
        try:
            area += face.area if math.isfinite(face.area) and face.area < 1e50 else 0.0
        except CadsculptError:
            lost += 1
    validity = part.validity()
    row: dict[str, Any] = {
        "read_ok": True,
        "format": part.format,
        "units": part.units,
        "faces": len(part.faces),
        "splines": sum(face.kind in SPLINES and not face.warning for face in part.faces),
        "faces_without_surface": lost,
        "area": area,
        "valid": validity.valid,
        "faults": len(validity.faults),
    }
    others = _other_areas(entry, part, area)
    if others:
        apart = {source: abs(area - other) / other for source, other in others.items()}
        row["areas"], row["area_differences"] = others, apart
        row["area_agrees"] = min(apart.values()) <= AGREES
        row["area_agrees_with_index"] = apart["index"] <= AGREES if "index" in apart else None
    if entry.faces is not None:
        row["faces_index"] = entry.faces
    row["warnings"] = list(dict.fromkeys(part.warnings))
    return row


def _other_areas(entry: Entry, part: Part, area: float) -> dict[str, float]:
    """Areas that are not ours, mm2: the index's reading, the file's own record, OpenCASCADE's quadrature made adaptive and,
    where `area` agrees with none of them, its mesh."""
    found = {} if not entry.area else {"index": entry.area}
    if part.recorded_area is not None:
        found["the file's own record"] = part.recorded_area[1]
    adaptive = _kernel_area(part, _adaptive)
    if adaptive > 0.0:
        found["OpenCASCADE, adaptive"] = adaptive
    if found and all(abs(area - other) > AGREES * other for other in found.values()):
        found["OpenCASCADE, triangulated"] = _kernel_area(part, _triangulated)
    return found


def _kernel_area(part: Part, measure: Callable[[Any], float]) -> float:
    """The sum of a measure of the CAD kernel over all faces."""
    from cadsculpt.formats.occt.face import OcctFace
    from cadsculpt.formats.occt.quiet import quiet
    from cadsculpt.formats.occt.shape import shape_of_surface

    total = 0.0
    with quiet():
        for face in part.faces:
            try:
                shape = face.shape if isinstance(face, OcctFace) else shape_of_surface(face.surface)
            except CadsculptError:
                continue
            one = measure(shape)
            total += one if one < 1e50 else 0.0
    return total


def _adaptive(shape: Any) -> float:
    """The index's reading was made with a fixed number of points, which is up to some percent off on long knot spans."""
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    properties = GProp_GProps()
    BRepGProp.SurfaceProperties_s(shape, properties, 1e-5)
    return abs(float(properties.Mass()))


def _triangulated(shape: Any) -> float:
    """The area of the kernel's fine triangles: its quadrature goes wrong on some trims, its mesh does not."""
    from OCP.BRep import BRep_Tool
    from OCP.BRepMesh import BRepMesh_IncrementalMesh
    from OCP.TopLoc import TopLoc_Location

    BRepMesh_IncrementalMesh(shape, 0.01, False, 0.05, False)
    mesh = BRep_Tool.Triangulation_s(shape, TopLoc_Location())
    if mesh is None:
        return 0.0
    points = np.array([mesh.Node(i).Coord() for i in range(1, mesh.NbNodes() + 1)])
    a, b, c = np.array([mesh.Triangle(i).Get() for i in range(1, mesh.NbTriangles() + 1)]).T - 1
    return float(0.5 * np.linalg.norm(np.cross(points[b] - points[a], points[c] - points[a]), axis=1).sum())


def _queries(path: Path) -> dict[str, Any]:
    from truth_ccd import read_queries

    points, truth = read_queries(path)
    return {"queries": len(points), "hits": int(truth.sum())}


def _toolpath(path: Path) -> dict[str, Any]:
    if path.suffix == ".expected":
        from corpus_toolpath import matches

        return matches(path)
    kinematics = re.search(r"boat-xyz(ac|bc)", path.name)
    options = PathOptions(kinematics=f"xyz{kinematics[1]}-trt") if kinematics else None  # type: ignore[arg-type]
    read = path_file.read(path, "mm", options)
    return {"rows": len(read.path.t), "seconds": float(read.path.t[-1])}
