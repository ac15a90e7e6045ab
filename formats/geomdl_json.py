"""The JSON of NURBS-Python (geomdl 5), both ways.

Control points are one flat list, v fastest; the format has no units. A trim is a closed curve, or a "container" of
curves; "reversed" true keeps what is inside, false cuts it out, and where it is missing the direction tells:
anticlockwise keeps. Layout after geomdl/_exchange.py and geomdl/trimming.py.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import CadsculptError, GeometryError, InputError
from ..spline.surface import BSplineSurface, Provenance, TrimCurve, TrimLoop
from .json_text import load, numbers
from .loose_edges import boundary_curves
from .part import Part
from .patch_part import PatchPart

Array = NDArray[np.float64]

DELTA = 0.05
"""geomdl's own default sampling step."""


# ---------------------------------------------------------------------- reading


def read(path: Path, *, units: str | None = None) -> Part:
    """Read a NURBS-Python JSON file. Raises InputError naming the file, the place in it and the fault."""
    return part_of_document(load(Path(path)), Path(path), units=units)


def part_of_document(document: object, path: Path, *, units: str | None = None) -> Part:
    """The part of a parsed file; its numbers are in `units`, or taken as mm with a warning."""
    try:
        surfaces = surfaces_of_document(document, path.name)
    except CadsculptError as error:
        raise InputError(
            error.what, where=f"{path}{', ' + error.where if error.where else ''}", mend=error.mend
        ) from None
    part = PatchPart(path, "geomdl", units or "", surfaces)
    if units is None:
        part.warnings.append("a NURBS-Python file has no length unit: its numbers are taken as mm")
    return part


def surfaces_of_document(document: object, file: str) -> list[BSplineSurface]:
    """The surfaces of a parsed file. Raises InputError with the place in `where`."""
    shape = document.get("shape") if isinstance(document, dict) else None
    if not isinstance(shape, dict):
        raise InputError("this is no NURBS-Python JSON: the object 'shape' is missing")
    kind = shape.get("type")
    if kind != "surface":
        raise InputError(f"the shape is a {kind!r}, not a surface", where="shape.type", mend="export surfaces")
    data = shape.get("data")
    items = data if isinstance(data, list) else [data]
    if not items or not all(isinstance(item, dict) for item in items):
        raise InputError("the surfaces are missing", where="shape.data")
    count = shape.get("count", len(items))
    if count != len(items):
        raise InputError(f"{len(items)} surfaces, but the count says {count}", where="shape.count")
    surfaces: list[BSplineSurface] = []
    taken: set[str] = set()
    for i, item in enumerate(items):
        name = base = str(item.get("name") or f"surface {i + 1}")
        turn = 2
        while name in taken:
            name, turn = f"{base} ({turn})", turn + 1
        taken.add(name)
        where = f"shape.data[{i}]" if isinstance(data, list) else "shape.data"
        surfaces.append(_surface(item, where, name, file))
    return surfaces


def _surface(item: Mapping[str, Any], where: str, name: str, file: str) -> BSplineSurface:
    r, s = _whole(item, "size_u", where), _whole(item, "size_v", where)
    points, weights = _points(item, where, 3)
    if len(points) != r * s:
        raise InputError(f"{len(points)} control points for a net of {r} x {s}", where=f"{where}.control_points.points")
    surface = BSplineSurface(
        control_points=points.reshape(r, s, 3),
        knots_u=numbers(_need(item, "knotvector_u", where), f"{where}.knotvector_u", 1),
        knots_v=numbers(_need(item, "knotvector_v", where), f"{where}.knotvector_v", 1),
        degree_u=_whole(item, "degree_u", where),
        degree_v=_whole(item, "degree_v", where),
        weights=None if weights is None else weights.reshape(r, s),
        outward=not item.get("reversed", False),
        name=name,
        provenance=Provenance(file, where, ""),
    )
    try:
        surface.validate()
    except GeometryError as error:
        raise InputError(error.what, where=f"{where} {name!r}", mend=error.mend) from None
    if "trims" not in item:
        return surface
    trims = item["trims"]
    data = trims.get("data") if isinstance(trims, dict) else trims
    if not isinstance(data, list):
        raise InputError("a list of trim curves is needed", where=f"{where}.trims")
    loops = [_loop(trim, f"{where}.trims.data[{k}]") for k, trim in enumerate(data)]
    if not loops:
        return surface
    if not any(loop.outer for loop in loops):
        loops.insert(0, TrimLoop(tuple(boundary_curves(surface)), True))
    return replace(surface, trims=tuple(loops))


def _loop(trim: object, where: str) -> TrimLoop:
    """One trim, turned so that it runs anticlockwise around what it keeps and clockwise around a hole."""
    from .occt.trim import reversed_loop, signed_area

    if not isinstance(trim, dict):
        raise InputError("an object is needed", where=where)
    kind = trim.get("type", "spline")
    if kind == "container":
        curves = [_curve(curve, f"{where}.data[{k}]") for k, curve in enumerate(trim.get("data") or [])]
    else:
        curves = [_curve(trim, where)]
    if not curves:
        raise InputError("a trim without curves", where=where)
    loop = TrimLoop(tuple(curves), True)
    anticlockwise = signed_area(loop) > 0.0
    keeps = bool(trim["reversed"]) if trim.get("reversed") is not None else anticlockwise
    loop = TrimLoop(loop.curves, keeps)
    return loop if keeps == anticlockwise else reversed_loop(loop)


def _curve(item: object, where: str) -> TrimCurve:
    if not isinstance(item, dict):
        raise InputError("an object is needed", where=where)
    kind = item.get("type", "spline")
    if kind == "freeform":
        points = numbers(_need(item, "points", where), f"{where}.points", 2)[:, :2]
        t = np.arange(len(points), dtype=np.float64)
        return TrimCurve(points, np.concatenate([t[:1], t, t[-1:]]), 1)
    if kind != "spline":
        raise InputError(
            f"a trim curve of type {kind!r} is not known", where=where, mend="spline, freeform or container"
        )
    from .patch_json import check_curve

    points, weights = _points(item, where, 2)
    degree = _whole(item, "degree", where)
    knots = numbers(_need(item, "knotvector", where), f"{where}.knotvector", 1)
    curve = TrimCurve(points, knots, degree, weights)
    check_curve(curve, where)
    return curve


def _points(item: Mapping[str, Any], where: str, size: int) -> tuple[Array, Array | None]:
    """(points (n, size), weights (n,) or None when they are all 1)."""
    control = _need(item, "control_points", where)
    if not isinstance(control, dict):
        raise InputError("an object with 'points' is needed", where=f"{where}.control_points")
    here = f"{where}.control_points"
    points = numbers(_need(control, "points", here), f"{here}.points", 2, size)
    if control.get("weights") is None:
        return points, None
    weights = numbers(control["weights"], f"{here}.weights", 1)
    if len(weights) != len(points):
        raise InputError(f"{len(weights)} weights for {len(points)} control points", where=f"{here}.weights")
    return points, None if (weights == 1.0).all() else weights


def _need(item: Mapping[str, Any], key: str, where: str) -> Any:
    if key not in item:
        raise InputError(f"the key {key!r} is missing", where=where)
    return item[key]


def _whole(item: Mapping[str, Any], key: str, where: str) -> int:
    value = _need(item, key, where)
    if not isinstance(value, int) or isinstance(value, bool) or value < 1:
        raise InputError(f"{key} is {value!r}", where=where, mend="a whole number from 1 on")
    return value


# ---------------------------------------------------------------------- writing


def write_surfaces(path: Path, surfaces: Sequence[BSplineSurface]) -> None:
    """Write surfaces as NURBS-Python JSON, whole or not at all. The format has no units.

    NURBS-Python runs every knot vector from 0 to 1 when it reads and expects trims in that range, so a trimmed surface
    is written with knots and trims in it; knots of untrimmed surfaces stay as they are. Periodic directions stay
    unrolled.
    """
    from .atomic import write_whole

    write_whole(path, text_of_surfaces(surfaces))


def text_of_surfaces(surfaces: Sequence[BSplineSurface]) -> str:
    """The text of a NURBS-Python JSON file."""
    data = [_object_of_surface(surface) for surface in surfaces]
    document = {"shape": {"type": "surface", "count": len(data), "data": data}}
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def _object_of_surface(surface: BSplineSurface) -> dict[str, Any]:
    surface.validate()
    knots_u, knots_v = surface.knots_u, surface.knots_v
    if surface.trims is not None:
        knots_u, knots_v = (_unit(k, span) for k, span in zip((knots_u, knots_v), surface.domain, strict=True))
    r, s = surface.shape
    control: dict[str, Any] = {"points": surface.control_points.reshape(-1, 3).tolist()}
    if surface.weights is not None:
        control["weights"] = surface.weights.ravel().tolist()
    item: dict[str, Any] = {
        "type": "spline",
        "rational": surface.rational,
        "dimension": 3,
        "degree_u": surface.degree_u,
        "degree_v": surface.degree_v,
        "knotvector_u": knots_u.tolist(),
        "knotvector_v": knots_v.tolist(),
        "size_u": r,
        "size_v": s,
        "control_points": control,
        "delta": [DELTA, DELTA],
        "name": surface.name,
        "reversed": int(not surface.outward),
    }
    if surface.trims is not None:
        loops = [_object_of_loop(loop, surface) for loop in surface.trims]
        item["trims"] = {"count": len(loops), "data": loops}
    return item


def _unit(values: Array, span: tuple[float, float]) -> Array:
    low, high = span
    return values if span == (0.0, 1.0) else (values - low) / (high - low)


def _object_of_loop(loop: TrimLoop, surface: BSplineSurface) -> dict[str, Any]:
    curves = []
    for curve in loop.curves:
        uv = np.column_stack([_unit(curve.control_points[:, axis], surface.domain[axis]) for axis in (0, 1)])
        control: dict[str, Any] = {"points": uv.tolist()}
        if curve.weights is not None:
            control["weights"] = curve.weights.tolist()
        curves.append(
            {
                "type": "spline",
                "rational": curve.weights is not None,
                "dimension": 2,
                "degree": curve.degree,
                "knotvector": _unit(curve.knots, (float(curve.knots[0]), float(curve.knots[-1]))).tolist(),
                "control_points": control,
                "delta": DELTA,
            }
        )
    if len(curves) == 1:
        return {**curves[0], "reversed": int(loop.outer)}
    return {"type": "container", "count": len(curves), "data": curves, "reversed": int(loop.outer)}
