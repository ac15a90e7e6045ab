"""One real file through every format that is written, and back: what comes back, number for number."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from corpus_compare import FAR, SAME, Difference, difference, pairs
from corpus_index import Entry
from corpus_read import SPLINES

from cadsculpt.errors import CadsculptError
from cadsculpt.formats import registry
from cadsculpt.formats.geomdl_json import write_surfaces as write_geomdl
from cadsculpt.formats.part import Face, Part

TARGETS = {
    "step": ".step", "iges": ".igs", "3dm": ".3dm", "json": ".json", "geomdl": ".geomdl.json", "g2": ".g2", "gismo": ".xml",
}  # fmt: skip
"""Formats that are written and read, by their extensions."""

COMPARED = {
    "step": "control points, knots, weights, trims, sides, names",
    "iges": "control points, knots, weights, trims, sides, names",
    "3dm": "control points, knots but for the outermost, which it has not, weights, trims, sides, names",
    "json": "control points, knots, weights, trims, sides, names",
    "geomdl": "control points, knots, weights, sides, names; trims and knots of trimmed faces in a range from 0 to 1",
    "g2": "control points, knots, weights, trims; it has no names and no sides",
    "gismo": "control points, knots, weights, names; it has no trims and no sides",
}
"""What a format can keep, and so what is compared."""

SIDELESS = ("g2", "gismo")
"""Formats that do not say which side of a face is out."""


def roundtrip_row(entry: Entry) -> dict[str, Any]:
    """Per target format: the largest differences over the spline faces, and which faces came back otherwise or not at all."""
    try:
        part = registry.read(entry.path)
    except CadsculptError:
        return {"skipped": "it cannot be read"}
    first = usable(part.faces)
    if not any(face.kind in SPLINES for face in first):
        return {"skipped": "no spline faces"}
    row: dict[str, Any] = {"format": part.format}
    with tempfile.TemporaryDirectory() as folder:
        for target, suffix in TARGETS.items():
            path = Path(folder) / f"part{suffix}"
            try:
                again = through(part, path, target)
                row[target] = compared(first, usable(again.faces), target, keeps_names(part, target))
                row[target]["copied"] = path.read_bytes() == entry.path.read_bytes()
            except CadsculptError as error:
                row[target] = {"refused": str(error).replace(folder, "")}
    return row


def usable(faces: Sequence[Face]) -> list[Face]:
    """Faces whose surface can be had."""
    found = []
    for face in faces:
        try:
            face.surface.validate()
        except CadsculptError:
            continue
        found.append(face)
    return found


def through(part: Part, path: Path, target: str) -> Part:
    """Write a part as `convert` does, and read it again."""
    if target == "geomdl":
        write_geomdl(path, registry.surfaces_in_file_units(part))
    else:
        registry.write_part(part, path, target)
    nameless_unit = target in ("geomdl", "g2", "gismo")
    return registry.read(path, units=(part.units or "mm") if nameless_unit else None)


def error_of(apart: Difference) -> float:
    """The largest difference; 1 for a face whose net, loops or side are not the same at all."""
    return 1.0 if not apart.same_net or apart.flipped else min(apart.largest, 1.0)


def keeps_names(part: Part, target: str) -> bool:
    return target != "g2"


def compared(first: list[Face], second: list[Face], target: str, names: bool) -> dict[str, Any]:
    """The worst of all spline faces, and of the others apart."""
    spline: list[tuple[str, Difference]] = []
    other: list[tuple[str, Difference]] = []
    lost, renamed = [], []
    lost_splines = 0
    for face, again in pairs(first, second):
        if again is None:
            lost.append(face.name)
            lost_splines += face.kind in SPLINES
            continue
        stretched = target == "geomdl" and face.surface.trims is not None
        apart = difference(
            face.surface,
            again.surface,
            trims=target != "gismo",
            unit_range=stretched,
            parameters=face.kind in SPLINES,
            sides=target not in SIDELESS,
            outermost=target != "3dm",
        )
        (spline if face.kind in SPLINES else other).append((face.name, apart))
        if names and again.name != face.name:
            renamed.append(f"{face.name} -> {again.name}")
    result: dict[str, Any] = {
        "faces": len(first),
        "lost": len(lost),
        "lost_splines": lost_splines,
        "more": max(len(second) - (len(first) - len(lost)), 0),
        "renamed": len(renamed),
        "compared": COMPARED[target],
    }
    for label, found in (("spline", spline), ("analytic", other)):
        if not found:
            continue
        name = max(found, key=lambda item: error_of(item[1]))[0]
        result[label] = {
            "faces": len(found),
            "same": sum(apart.same for _, apart in found),
            "causes": dict(Counter(cause for _, apart in found for cause in apart.causes())),
            "error": max(error_of(apart) for _, apart in found),
            "rescaled_weights": sum(apart.weight_factor > SAME for _, apart in found),
            "other_outermost_knots": sum(apart.outermost_knots > SAME for _, apart in found),
            "turned": sum(apart.turned for _, apart in found),
            "same_net": sum(apart.same_net for _, apart in found),
            "control_points": max(apart.control_points for _, apart in found),
            "knots": max(apart.knots for _, apart in found),
            "weights": max(apart.weights for _, apart in found),
            "trims": max((apart.trims for _, apart in found if apart.trims < FAR / 2), default=0.0),
            "trims_otherwise": sum(apart.trims >= FAR / 2 for _, apart in found),
            "worst_face": name,
        }
    if lost:
        result["lost_faces"] = lost[:5]
    if renamed:
        result["renamed_faces"] = renamed[:5]
    return result
