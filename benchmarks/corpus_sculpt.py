"""One real file sculpted the way a user does it: a new scene, its run, the part written in its own format and read again.

The tool is a ball of 2 % of the size of the part's largest spline face, pressed into that face. Where no ball can be put
there, because something of the part is in the way, the next largest is taken, and so on for a few.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from corpus_compare import difference, pairs
from corpus_index import Entry
from corpus_read import SPLINES
from corpus_roundtrip import usable
from corpus_seams import file_tolerance, seam_gap

from cadsculpt.errors import CadsculptError
from cadsculpt.formats import registry
from cadsculpt.formats.load import Loaded, load
from cadsculpt.formats.new_scene import NewScene, new_scene
from cadsculpt.formats.part import Face, Part
from cadsculpt.formats.press import Wish
from cadsculpt.formats.scene_toml import SceneFile
from cadsculpt.run import RunResult, run

BALL = 0.02
"""Radius of the ball over the face's size."""

MOST_FACES = 4
"""Faces tried, the largest first."""

OWN = {"step": ".step", "iges": ".igs", "3dm": ".3dm", "json": ".json", "geomdl": ".json", "g2": ".g2", "gismo": ".xml"}

UNCHANGED = 1e-12
"""Relative difference up to which a face that was not sculpted is as it was: its numbers went through the file's unit."""


def sculpt_row(entry: Entry) -> dict[str, Any]:
    """sculpted, and what became of the part; `refused` says in one line why nothing could be sculpted."""
    try:
        part = registry.read(entry.path)
    except CadsculptError:
        return {"skipped": "it cannot be read"}
    chosen = largest_faces(part)
    if not chosen:
        return {"skipped": "no spline faces"}
    refused = ""
    with tempfile.TemporaryDirectory() as folder:
        for face in chosen:
            try:
                made = new_scene(entry.path, Path(folder) / "scene.toml", face=str(face.number), wish=Wish.quick(BALL))
            except CadsculptError as error:
                refused = refused or str(error).replace(str(entry.path), entry.name)
                continue
            try:
                return {"face": face.name, "largest": face is chosen[0], **_sculpted(made, Path(folder))}
            except CadsculptError as error:
                return {"refused": f"face {face.name}: {error}".replace(folder, "")}
    return {"refused": refused}


def largest_faces(part: Part) -> list[Face]:
    """The largest spline faces whose surface can be had."""
    areas = []
    for face in usable(part.faces):
        if face.kind in SPLINES:
            try:
                areas.append((face.area, face))
            except CadsculptError:
                continue
    sound = [(area, face) for area, face in areas if np.isfinite(area) and 0.0 < area < 1e50]
    return [face for _, face in sorted(sound, key=lambda item: -item[0])[:MOST_FACES]]


def _sculpted(made: NewScene, folder: Path) -> dict[str, Any]:
    scene_path = folder / "scene.toml"
    scene_path.write_text(made.text, encoding="utf-8")
    loaded = load(SceneFile.load(scene_path))
    result = run(loaded.model)
    if not result.converged:
        return {"refused": f"the run failed: {result.failure}"}
    ((path, part),) = loaded.parts.items()
    surfaces = loaded.sculpted(result.exported)[path]
    (number,) = surfaces
    before = Before.of(part, number)
    part.sculpt(surfaces)
    target = folder / f"out{OWN[part.format]}"
    registry.write_part(part, target, "json" if part.format == "geomdl" else part.format)
    first = target.read_bytes()
    registry.write_part(part, target, "json" if part.format == "geomdl" else part.format)
    again = registry.read(target, units=part.units or None)
    validity = again.validity()
    changed = before.changed(again.faces)
    gap, allowed = before.seams(again)
    return {
        "sculpted": True,
        "steps": result.session.state.step,
        "nodes": made.nodes,
        "depth": result.summary.max_depth,
        "moved": result.summary.max_displacement,
        "valid": validity.valid or len(validity.faults) <= before.faults,
        "new_faults": [fault for fault in validity.faults if fault not in before.fault_lines][:5],
        "valid_before": before.valid,
        "untouched": len(before.others),
        "untouched_changed": len(changed),
        "changed_faces": changed[:5],
        "seam_gap": gap,
        "seam_allowed": allowed,
        "same_bytes": first == target.read_bytes(),
        **_refit(loaded, result),
        "warnings": list(dict.fromkeys([*part.warnings, *result.warnings])),
    }


def _refit(loaded: Loaded, result: RunResult) -> dict[str, Any]:
    """The refit's error beside its tolerance; beyond it, what the run's warnings say kept it from it."""
    error, tolerance = result.summary.refit_max_error, float(loaded.scene.refit.tolerance or 0.0)
    (face,) = result.exported.faces
    told = next((line for line in result.warnings if "refit" in line), "")
    return {
        "refit_error": error,
        "refit_tolerance": tolerance,
        "refit_within": error <= tolerance,
        "refit_outcome": face.outcome,
        "refit_ok": error <= tolerance or (face.outcome != "within" and bool(told)),
        "net": [list(face.read_shape), list(face.surface.shape)],
        **({"refit_refused": told} if told else {}),
    }


class Before:
    """What the part was before it was sculpted."""

    def __init__(self, part: Part, number: int) -> None:
        validity = part.validity()
        self.valid, self.faults, self.fault_lines = validity.valid, len(validity.faults), set(validity.faults)
        self.number = number
        self.sculpted = part.faces.number(number).surface
        self.others = [_Kept(face) for face in usable(part.faces) if face.number != number]
        self.faces = len(part.faces)
        self.gap, self.tolerance = seam_gap(part, part.faces.number(number)), file_tolerance(part)

    @classmethod
    def of(cls, part: Part, number: int) -> Before:
        return cls(part, number)

    def changed(self, faces: Sequence[Face]) -> list[str]:
        """The faces, but for the sculpted one, that are not what they were, and how."""
        found = [f"{len(faces)} faces, there were {self.faces}"] if len(faces) != self.faces else []
        for face, again in pairs(self.others, usable(faces)):  # type: ignore[type-var]
            if again is None:
                found.append(f"{face.name}: lost")
                continue
            apart = difference(face.surface, again.surface, parameters=face.kind in SPLINES)
            if not apart.same_net or apart.largest > UNCHANGED:
                found.append(f"{face.name}: {apart.as_dict()}")
            elif face.name != again.name:
                found.append(f"{face.name}: now named {again.name}")
        return found

    def seams(self, again: Part) -> tuple[float, float]:
        """The gap along the sculpted face's edges after the export, and what is allowed: the file's tolerance, or what
        gaped before, seen at other places along the edges."""
        face = min(usable(again.faces), key=lambda f: _far(f, self.sculpted))
        return seam_gap(again, face), max(self.tolerance, 1.01 * self.gap)


class _Kept:
    """A face's number, name and surface, whatever becomes of its part."""

    def __init__(self, face: Face) -> None:
        self.number, self.name, self.surface, self.kind = face.number, face.name, face.surface, face.kind


def _far(face: Face, surface: Any) -> float:
    """How far a face's border is from that of a surface: the sculpted face keeps its trims."""
    own = face.surface
    if (own.degree_u, own.degree_v) != (surface.degree_u, surface.degree_v) or own.domain != surface.domain:
        return np.inf
    u, v = (np.linspace(*bounds, 9) for bounds in surface.domain)
    return float(np.linalg.norm(own.evaluate(u[:, None], v) - surface.evaluate(u[:, None], v), axis=2).mean())
