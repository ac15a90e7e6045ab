"""cadsculpt's patch JSON: surfaces with their units, knots, weights and trims, nothing rescaled, back bit for bit.

    {"format": "cadsculpt-patches", "version": 1, "units": "mm",
     "surfaces": [{"name": ..., "degree_u": 3, "degree_v": 3, "knots_u": [...], "knots_v": [...],
                   "control_points": [[[x, y, z], ...v], ...u], "weights": [[...]],
                   "periodic_u": false, "periodic_v": false, "outward": true,
                   "trims": [{"outer": true, "curves": [{"degree": 1, "knots": [...],
                              "control_points": [[u, v], ...], "weights": [...]}]}],
                   "source": {"file": ..., "entity": ...}}]}

A JSON file of NURBS-Python (geomdl) is read through `geomdl_json`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import CadsculptError, InputError
from ..spline.surface import BSplineSurface, Provenance, TrimCurve, TrimLoop
from ..units import METRES_PER_UNIT, unit_name
from .json_text import load, numbers
from .part import Part

Array = NDArray[np.float64]

FORMAT = "cadsculpt-patches"
VERSION = 1

_TOP = {"format", "version", "units", "surfaces"}
_SURFACE = {
    "name", "degree_u", "degree_v", "knots_u", "knots_v", "control_points", "weights", "periodic_u", "periodic_v",
    "outward", "trims", "source",
}  # fmt: skip
_CURVE = {"degree", "knots", "control_points", "weights"}


# ---------------------------------------------------------------------- reading


def read(path: Path, *, units: str | None = None) -> Part:
    """Read a patch JSON file, or one of NURBS-Python. units : to take the numbers in, whatever the file says.

    Raises InputError naming the file, the place in it and the fault, for whatever is wrong.
    """
    path = Path(path)
    document = load(path)
    if isinstance(document, dict) and "shape" in document and "format" not in document:
        from .geomdl_json import part_of_document

        return part_of_document(document, path, units=units)
    from .patch_part import PatchPart

    try:
        said, surfaces = surfaces_of_document(document, path.name)
    except CadsculptError as error:
        raise InputError(
            error.what, where=f"{path}{', ' + error.where if error.where else ''}", mend=error.mend
        ) from None
    return PatchPart(path, "json", units or said, surfaces)


def surfaces_of_document(document: object, file: str) -> tuple[str, list[BSplineSurface]]:
    """The unit and the surfaces, in that unit, of a parsed patch JSON. Raises InputError with the place in `where`."""
    top = _object(document, "", _TOP)
    if _need(top, "format", "") != FORMAT:
        raise InputError(f"the format is {top['format']!r}, not {FORMAT!r}", where="format")
    if _need(top, "version", "") != VERSION:
        raise InputError(
            f"version {top['version']!r} is not known", where="version", mend="this program knows version 1"
        )
    units = _need(top, "units", "")
    if not isinstance(units, str):
        raise InputError(f"the unit is {units!r}", where="units", mend=f"use one of {', '.join(METRES_PER_UNIT)}")
    units = unit_name(units)
    items = _list(_need(top, "surfaces", ""), "surfaces")
    if not items:
        raise InputError("there are no surfaces", where="surfaces")
    surfaces: list[BSplineSurface] = []
    names: dict[str, int] = {}
    for i, item in enumerate(items):
        surface = _surface(item, f"surfaces[{i}]", f"surface {i + 1}", file, units)
        if surface.name in names:
            raise InputError(
                f"the name {surface.name!r} is taken by surfaces[{names[surface.name]}]",
                where=f"surfaces[{i}].name",
                mend="every surface needs its own",
            )
        names[surface.name] = i
        surfaces.append(surface)
    return units, surfaces


def _surface(value: object, where: str, name: str, file: str, units: str) -> BSplineSurface:
    item = _object(value, where, _SURFACE)
    name = _text(item.get("name", name), f"{where}.name")
    if not name:
        raise InputError("the name is empty", where=f"{where}.name", mend="leave it out, or give one")
    source = _object(item.get("source") or {}, f"{where}.source", {"file", "entity"})
    trims = item.get("trims")
    weights = item.get("weights")
    surface = BSplineSurface(
        control_points=numbers(_need(item, "control_points", where), f"{where}.control_points", 3, 3),
        knots_u=numbers(_need(item, "knots_u", where), f"{where}.knots_u", 1),
        knots_v=numbers(_need(item, "knots_v", where), f"{where}.knots_v", 1),
        degree_u=_integer(_need(item, "degree_u", where), f"{where}.degree_u"),
        degree_v=_integer(_need(item, "degree_v", where), f"{where}.degree_v"),
        weights=None if weights is None else numbers(weights, f"{where}.weights", 2),
        periodic_u=_flag(item.get("periodic_u", False), f"{where}.periodic_u"),
        periodic_v=_flag(item.get("periodic_v", False), f"{where}.periodic_v"),
        outward=_flag(item.get("outward", True), f"{where}.outward"),
        trims=None if trims is None else tuple(_loops(trims, f"{where}.trims")),
        name=name,
        provenance=Provenance(
            _text(source.get("file", file), f"{where}.source.file"),
            _text(source.get("entity", where), f"{where}.source.entity"),
            units,
        ),
    )
    try:
        surface.validate()
    except CadsculptError as error:
        raise InputError(error.what, where=f"{where} {name!r}", mend=error.mend) from None
    for axis, periodic in enumerate((surface.periodic_u, surface.periodic_v)):
        degree = (surface.degree_u, surface.degree_v)[axis]
        net = np.moveaxis(surface.control_points, axis, 0)
        if periodic and np.abs(net[:degree] - net[-degree:]).max() > 1e-9 * surface.size:
            label = "uv"[axis]
            raise InputError(
                f"the direction {label} is periodic, but its last {degree} rows of control points are not its first",
                where=f"{where}.periodic_{label}",
                mend="a periodic direction is stored unrolled",
            )
    return surface


def _loops(value: object, where: str) -> list[TrimLoop]:
    loops = []
    for i, item in enumerate(_list(value, where)):
        here = f"{where}[{i}]"
        loop = _object(item, here, {"outer", "curves"})
        curves = _list(_need(loop, "curves", here), f"{here}.curves")
        if not curves:
            raise InputError("a trim loop without curves", where=f"{here}.curves")
        made = [_curve(curve, f"{here}.curves[{k}]") for k, curve in enumerate(curves)]
        loops.append(TrimLoop(tuple(made), _flag(_need(loop, "outer", here), f"{here}.outer")))
    if not loops:
        raise InputError(
            "there are no trim loops", where=where, mend="leave trims out when the whole domain is the face"
        )
    return loops


def _curve(value: object, where: str) -> TrimCurve:
    item = _object(value, where, _CURVE)
    weights = item.get("weights")
    curve = TrimCurve(
        control_points=numbers(_need(item, "control_points", where), f"{where}.control_points", 2, 2),
        knots=numbers(_need(item, "knots", where), f"{where}.knots", 1),
        degree=_integer(_need(item, "degree", where), f"{where}.degree"),
        weights=None if weights is None else numbers(weights, f"{where}.weights", 1),
    )
    check_curve(curve, where)
    return curve


def check_curve(curve: TrimCurve, where: str) -> None:
    """Raise InputError when this is no B-spline curve."""
    count, needed = len(curve.control_points), len(curve.control_points) + curve.degree + 1
    if curve.degree < 1:
        raise InputError(f"degree {curve.degree}", where=where, mend="degrees start at 1")
    if len(curve.knots) != needed:
        raise InputError(
            f"{len(curve.knots)} knots for {count} control points of degree {curve.degree}",
            where=f"{where}.knots",
            mend=f"{needed} are needed",
        )
    if (np.diff(curve.knots) < 0).any() or not curve.knots[curve.degree] < curve.knots[count]:
        raise InputError("the knots do not ascend, or span nothing", where=f"{where}.knots")
    if curve.weights is not None and (curve.weights.shape != (count,) or not (curve.weights > 0).all()):
        raise InputError(f"{count} positive weights are needed", where=f"{where}.weights")


# ----------------------------------------------------------------------- values


def _object(value: object, where: str, known: set[str]) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"an object is needed, not {_what(value)}", where=where)
    for key in value:
        if key not in known:
            close = get_close_matches(key, known, n=1)
            mend = f"did you mean {close[0]!r}?" if close else f"known are {', '.join(sorted(known))}"
            raise InputError(f"unknown key {key!r}", where=where, mend=mend)
    return value


def _need(item: Mapping[str, Any], key: str, where: str) -> Any:
    if key not in item:
        raise InputError(f"the key {key!r} is missing", where=where)
    return item[key]


def _list(value: object, where: str) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(f"a list is needed, not {_what(value)}", where=where)
    return value


def _text(value: object, where: str) -> str:
    if not isinstance(value, str):
        raise InputError(f"text is needed, not {_what(value)}", where=where)
    return value


def _flag(value: object, where: str) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"true or false is needed, not {_what(value)}", where=where)
    return value


def _integer(value: object, where: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise InputError(f"a whole number is needed, not {_what(value)}", where=where)
    return value


def _what(value: object) -> str:
    if value is None:
        return "null"
    words = {dict: "an object", list: "a list", str: f"the text {value!r}", bool: str(value).lower()}
    return words.get(type(value), str(value))[:60]


# ---------------------------------------------------------------------- writing


def write_surfaces(path: Path, surfaces: Sequence[BSplineSurface], units: str) -> None:
    """Write surfaces whose lengths are in `units` as patch JSON, whole or not at all.

    Numbers are written with as many digits as bring the same bits back. Surfaces without a name, or with one that is
    taken, get one. Raises InputError when the file cannot be written.
    """
    from .atomic import write_whole

    write_whole(path, text_of_surfaces(surfaces, units))


def text_of_surfaces(surfaces: Sequence[BSplineSurface], units: str) -> str:
    """The text of a patch JSON file."""
    taken: set[str] = set()
    items = []
    for i, surface in enumerate(surfaces, 1):
        name = base = surface.name or f"surface {i}"
        turn = 2
        while name in taken:
            name, turn = f"{base} ({turn})", turn + 1
        taken.add(name)
        items.append(object_of_surface(replace(surface, name=name)))
    head = {"format": FORMAT, "version": VERSION, "units": unit_name(units)}
    lines = [f" {json.dumps(key)}: {json.dumps(value)}," for key, value in head.items()]
    blocks = [
        "  {" + ",\n   ".join(f"{json.dumps(k)}: {json.dumps(v, allow_nan=False)}" for k, v in item.items()) + "}"
        for item in items
    ]
    return "{\n" + "\n".join(lines) + '\n "surfaces": [\n' + ",\n".join(blocks) + "\n ]\n}\n"


def object_of_surface(surface: BSplineSurface) -> dict[str, Any]:
    """The JSON object of one surface."""
    surface.validate()
    item: dict[str, Any] = {
        "name": surface.name,
        "degree_u": surface.degree_u,
        "degree_v": surface.degree_v,
        "knots_u": surface.knots_u.tolist(),
        "knots_v": surface.knots_v.tolist(),
        "control_points": surface.control_points.tolist(),
    }
    if surface.weights is not None:
        item["weights"] = surface.weights.tolist()
    item |= {"periodic_u": surface.periodic_u, "periodic_v": surface.periodic_v, "outward": surface.outward}
    if surface.trims is not None:
        item["trims"] = [
            {"outer": loop.outer, "curves": [_object_of_curve(curve) for curve in loop.curves]}
            for loop in surface.trims
        ]
    item["source"] = {"file": surface.provenance.file, "entity": surface.provenance.entity}
    return item


def _object_of_curve(curve: TrimCurve) -> dict[str, Any]:
    item: dict[str, Any] = {
        "degree": curve.degree,
        "knots": curve.knots.tolist(),
        "control_points": curve.control_points.tolist(),
    }
    if curve.weights is not None:
        item["weights"] = curve.weights.tolist()
    return item


# ----------------------------------------------------------------------- schema


def schema() -> dict[str, Any]:
    """The JSON Schema (2020-12) of a patch JSON file."""
    number = {"type": "number"}
    series = {"type": "array", "items": number, "minItems": 1}

    def points(size: int) -> dict[str, Any]:
        return {"type": "array", "items": number, "minItems": size, "maxItems": size}

    def record(required: list[str], properties: dict[str, Any]) -> dict[str, Any]:
        return {"type": "object", "required": required, "properties": properties, "additionalProperties": False}

    degree = {"type": "integer", "minimum": 1}
    positive = {"type": "array", "items": {"type": "number", "exclusiveMinimum": 0}, "minItems": 1}
    curve = record(
        ["degree", "knots", "control_points"],
        {
            "degree": degree,
            "knots": series,
            "control_points": {"type": "array", "items": points(2), "minItems": 2},
            "weights": {"anyOf": [positive, {"type": "null"}]},
        },
    )
    loop = record(
        ["outer", "curves"],
        {"outer": {"type": "boolean"}, "curves": {"type": "array", "items": curve, "minItems": 1}},
    )
    surface = record(
        ["degree_u", "degree_v", "knots_u", "knots_v", "control_points"],
        {
            "name": {"type": "string", "minLength": 1},
            "degree_u": degree,
            "degree_v": degree,
            "knots_u": series,
            "knots_v": series,
            "control_points": {
                "type": "array",
                "items": {"type": "array", "items": points(3), "minItems": 2},
                "minItems": 2,
            },
            "weights": {"anyOf": [{"type": "array", "items": positive}, {"type": "null"}]},
            "periodic_u": {"type": "boolean", "default": False},
            "periodic_v": {"type": "boolean", "default": False},
            "outward": {"type": "boolean", "default": True, "description": "S_u x S_v points out of the material"},
            "trims": {"anyOf": [{"type": "array", "items": loop, "minItems": 1}, {"type": "null"}]},
            "source": record([], {"file": {"type": "string"}, "entity": {"type": "string"}}),
        },
    )
    return {
        "title": "cadsculpt patches",
        **record(
            ["format", "version", "units", "surfaces"],
            {
                "format": {"const": FORMAT},
                "version": {"const": VERSION},
                "units": {"enum": sorted(METRES_PER_UNIT)},
                "surfaces": {"type": "array", "items": surface, "minItems": 1},
            },
        ),
    }
