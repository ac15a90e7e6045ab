"""G+Smo's XML, both ways: TensorBSpline2 and TensorNurbs2 geometries, and the MultiPatch that gathers them.

Control points stand in rows, u (index 0) fastest, and are not multiplied by their weights. The format has no units, no trims
and no orientation; a geometry's `label` is its name. What a MultiPatch says of interfaces is not kept: G+Smo finds them anew.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..spline.surface import BSplineSurface, Provenance
from .part import Part
from .paths.path_text import text_of_file
from .u_fastest import rows_of_surface, surface_of_rows

Array = NDArray[np.float64]

PLAIN, RATIONAL = "TensorBSpline2", "TensorNurbs2"


# ---------------------------------------------------------------------- reading


def read(path: Path, *, units: str | None = None) -> Part:
    """Read a G+Smo file; its numbers are in `units`, or taken as mm with a warning.

    Geometries that are no surfaces are left out with a warning. Raises InputError naming the file, the geometry and the fault.
    """
    from .patch_part import PatchPart

    path = Path(path)
    surfaces, warnings = surfaces_of_text(text_of_file(path), str(path))
    part = PatchPart(path, "gismo", units or "", surfaces)
    part.warnings += warnings
    if units is None:
        part.warnings.append("a G+Smo file has no length unit: its numbers are taken as mm")
    return part


def surfaces_of_text(text: str, where: str) -> tuple[list[BSplineSurface], list[str]]:
    """The surfaces of a text, and warnings; `where` names it in errors. Raises InputError."""
    if re.search(r"<!(DOCTYPE|ENTITY)", text):
        raise InputError(
            "an XML file with definitions of its own is not read", where=where, mend="take the DOCTYPE out"
        )
    # some files have comments before the declaration, which XML does not allow
    text = re.sub(r"<\?xml[^>]*\?>", "", text, count=1)
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        line, column = error.position
        raise InputError(f"no XML: {error.msg}", where=f"{where}:{line}", mend=f"see column {column + 1}") from None
    surfaces: list[BSplineSurface] = []
    warnings: list[str] = []
    for number, item in enumerate(root.iter("Geometry"), 1):
        said = item.get("id")
        here = f"{where}, Geometry {said if said is not None else number}"
        kind = item.get("type")
        if kind not in (PLAIN, RATIONAL):
            warnings.append(f"Geometry {said or number} is a {kind} and left out")
            continue
        name = base = item.get("label") or f"surface {len(surfaces) + 1}"
        turn = 2
        while name in {surface.name for surface in surfaces}:
            name, turn = f"{base} ({turn})", turn + 1
        surfaces.append(_surface(item, kind == RATIONAL, name, here, Path(where).name))
    if not surfaces:
        kinds = "; ".join(warnings)
        raise InputError("there are no surfaces" + (f": {kinds}" if kinds else ""), where=where)
    return surfaces, warnings


def _surface(item: ElementTree.Element, rational: bool, name: str, where: str, file: str) -> BSplineSurface:
    bases = sorted(item.iter("Basis"), key=lambda basis: basis.get("index", ""))
    directions = [basis for basis in bases if basis.get("type") == "BSplineBasis"]
    if [basis.get("index") for basis in directions] != ["0", "1"]:
        raise InputError("two bases of type BSplineBasis, index 0 and 1, are needed", where=where)
    if any(basis.get("periodic") for basis in directions):
        raise InputError("a periodic basis is not read", where=where, mend="write it clamped")
    (knots_u, p), (knots_v, q) = (_knots(basis, where) for basis in directions)
    r, s = len(knots_u) - p - 1, len(knots_v) - q - 1
    coefs = item.find("coefs")
    if coefs is None:
        raise InputError("the coefs are missing", where=where)
    if coefs.get("geoDim") != "3":
        raise InputError(f"a surface in {coefs.get('geoDim')} dimensions, not 3", where=where)
    points = _numbers(coefs, where)
    if r < 1 or s < 1 or len(points) != 3 * r * s:
        raise InputError(f"{len(points)} numbers in coefs, not 3 for each of {r} x {s} control points", where=where)
    weights = None
    if rational:
        found = next(item.iter("weights"), None)
        if found is None:
            raise InputError("the weights are missing", where=where)
        weights = _numbers(found, where)
        if len(weights) != r * s:
            raise InputError(f"{len(weights)} weights for {r} x {s} control points", where=where)
    return surface_of_rows(
        points,
        weights,
        (knots_u, knots_v),
        (p, q),
        name=name,
        provenance=Provenance(file, where.rsplit(", ", 1)[1], ""),
        where=where,
    )


def _knots(basis: ElementTree.Element, where: str) -> tuple[Array, int]:
    vector = basis.find("KnotVector")
    if vector is None:
        raise InputError(f"the KnotVector of basis {basis.get('index')} is missing", where=where)
    degree = vector.get("degree", "")
    if not degree.isdecimal() or not 1 <= int(degree) <= 100:
        raise InputError(f"the degree of basis {basis.get('index')} is {degree!r}", where=where)
    return _numbers(vector, where), int(degree)


def _numbers(item: ElementTree.Element, where: str) -> Array:
    """The numbers in an element's text. Raises InputError for what is none, or not finite."""
    words = (item.text or "").split()
    try:
        values = np.array([float(word) for word in words], dtype=np.float64)
    except ValueError as error:
        raise InputError(f"in {item.tag}: {str(error)[:80]}", where=where) from None
    if not np.isfinite(values).all():
        bad = words[int(np.argmin(np.isfinite(values)))]
        raise InputError(f"in {item.tag}: {bad[:30]!r} is not a finite number", where=where)
    return values


# ---------------------------------------------------------------------- writing


def write_surfaces(path: Path, surfaces: Sequence[BSplineSurface]) -> None:
    """Write surfaces as G+Smo reads them, whole or not at all; of a trimmed one the whole surface."""
    from .atomic import write_whole

    write_whole(path, text_of_surfaces(surfaces))


def text_of_surfaces(surfaces: Sequence[BSplineSurface]) -> str:
    """The text of a G+Smo file: a geometry for each surface, and one MultiPatch of them all."""
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', "<xml>"]
    for number, surface in enumerate(surfaces):
        surface.validate()
        kind = RATIONAL if surface.rational else PLAIN
        label = f" label={quoteattr(surface.name)}" if surface.name else ""
        lines.append(f' <Geometry type="{kind}" id="{number}"{label}>')
        basis = ['<Basis type="TensorBSplineBasis2">']
        for index, (knots, degree) in enumerate(
            ((surface.knots_u, surface.degree_u), (surface.knots_v, surface.degree_v))
        ):
            basis += [
                f' <Basis type="BSplineBasis" index="{index}">',
                f'  <KnotVector degree="{degree}">{" ".join(map(repr, knots.tolist()))}</KnotVector>',
                " </Basis>",
            ]
        basis.append("</Basis>")
        net, row = rows_of_surface(surface)
        if row is not None:
            weights = "\n".join(map(repr, row.tolist()))
            basis = ['<Basis type="TensorNurbsBasis2">', *(f" {line}" for line in basis)]
            basis += [f" <weights>{weights}", "</weights>", "</Basis>"]
        lines += [f"  {line}" for line in basis]
        lines.append('  <coefs geoDim="3">' + "\n".join(" ".join(map(repr, point)) for point in net.tolist()))
        lines += ["</coefs>", " </Geometry>"]
    last = len(surfaces) - 1
    lines += [' <MultiPatch parDim="2" id="0">', f'  <patches type="id_range">0 {last}</patches>', " </MultiPatch>"]
    return "\n".join([*lines, "</xml>", ""])
