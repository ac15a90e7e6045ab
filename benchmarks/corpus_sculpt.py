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
from corpus_check import READERS as FOREIGN
from corpus_check import faults, foreign
from corpus_compare import difference, pairs
from corpus_index import BALL, Entry
from corpus_read import SPLINES
from corpus_roundtrip import usable
from corpus_seams import distance, file_tolerance, seam_gap
from numpy.typing import NDArray

from cadsculpt.errors import CadsculptError
from cadsculpt.formats import registry
from cadsculpt.formats.load import Loaded, load
from cadsculpt.formats.new_scene import NewScene, new_scene
from cadsculpt.formats.part import Face, Part, Validity
from cadsculpt.formats.press import Wish
from cadsculpt.formats.scene_toml import SceneFile
from cadsculpt.run import RunResult, run
from cadsculpt.spline.surface import BSplineSurface
from cadsculpt.units import conversion

MOST_FACES = 4
"""Faces tried, the largest first."""

Array = NDArray[np.float64]

OWN = {"step": ".step", "iges": ".igs", "3dm": ".3dm", "json": ".json", "geomdl": ".json", "g2": ".g2", "gismo": ".xml"}

UNCHANGED = 1e-12
"""Relative difference up to which a face that was not sculpted is as it was: its numbers went through the file's unit."""


def sculpt_row(entry: Entry) -> dict[str, Any]:
    """sculpted, and what became of the part. `refused` says in one line why no scene could be made, `failed` why the run or
    the export of one did not come to its end, `skipped` that there is nothing to sculpt."""
    try:
        part = registry.read(entry.path)
    except CadsculptError:
        return {"skipped": "it cannot be read"}
    splines = [face for face in part.faces if face.kind in SPLINES]
    chosen = largest_faces(part)
    if not chosen:
        return {"refused": "none of its spline faces has a surface"} if splines else {"skipped": "no spline faces"}
    refused: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        for face in chosen:
            try:
                made = new_scene(entry.path, Path(folder) / "scene.toml", face=str(face.number), wish=Wish.quick(BALL))
            except CadsculptError as error:
                refused[face.name] = str(error).replace(str(entry.path), entry.name)
                continue
            about = {"face": face.name, "larger_refused": list(refused.values())}
            try:
                return {**about, **_sculpted(entry, made, Path(folder))}
            except CadsculptError as error:
                return {**about, "failed": str(error).replace(folder, "")}
    return {"refused": next(iter(refused.values()))}


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


def _sculpted(entry: Entry, made: NewScene, folder: Path) -> dict[str, Any]:
    scene_path = folder / "scene.toml"
    scene_path.write_text(made.text, encoding="utf-8")
    loaded = load(SceneFile.load(scene_path))
    result = run(loaded.model)
    if not result.converged:
        return {"failed": f"the run: {result.failure}"}
    ((path, part),) = loaded.parts.items()
    surfaces = loaded.sculpted(result.exported)[path]
    (number,) = surfaces
    before = Before(part, number)
    part.sculpt(surfaces)
    format = "json" if part.format == "geomdl" else part.format
    target, second = (folder / name / f"out{OWN[part.format]}" for name in ("first", "second"))
    for file in (target, second):
        file.parent.mkdir()
    registry.write_part(part, target, format)
    # the second time from the file on, so that nothing is left over from the first
    fresh = registry.read(path, units=loaded.scene.model[0].file_units)
    fresh.sculpt(surfaces)
    registry.write_part(fresh, second, format)
    again = registry.read(target, units=part.units or None)
    changed = before.changed(again.faces)
    face = before.found_again(again)
    return {
        "sculpted": True,
        "units": loaded.scene.units,
        "steps": result.session.state.step,
        "nodes": made.nodes,
        **_pressed(loaded, result, before.sculpted, face),
        **before.validity(again, entry.path, target),
        "untouched": len(before.others),
        "untouched_changed": len(changed),
        "changed_faces": changed[:5],
        **before.seams(again, face),
        "same_bytes": target.read_bytes() == second.read_bytes(),
        **_refit(loaded, result),
        "warnings": list(dict.fromkeys([*part.warnings, *result.warnings])),
    }


def _pressed(loaded: Loaded, result: RunResult, read: BSplineSurface, back: Face) -> dict[str, Any]:
    """Whether the ball touched, how large the dent is, and how far the surface that was read back is from the nodes.

    dent : the largest distance, mm, of a moved node from the face as it was, or of where it was from the face as it comes
    back; export_error : of a node from the face as it comes back.
    """
    session = result.session
    patch, mm = session.model.patches[0], conversion(loaded.scene.units, "mm")
    uv = np.stack(np.meshgrid(patch.u, patch.v, indexing="ij"), axis=2)
    rest = np.asarray(read.evaluate(patch.u[:, None], patch.v))
    nodes = rest + mm * np.asarray(session.displacement(0))
    counted = patch.material_nodes & ~patch.hold.inside(patch.u, patch.v)
    flat, still, at = nodes[counted], rest[counted], uv[counted]
    here = back.surface
    off = _distance(here, flat, at, same=here.domain == read.domain)
    # on a sharp ridge nodes go along one side: what was there before is then far from what is there now
    gone = _distance(here, still, at, same=here.domain == read.domain)
    dent = np.maximum(_distance(read, flat, at, same=True), gone)
    tolerance = mm * float(loaded.scene.refit.tolerance or 0.0)
    tool = loaded.scene.tool[0]
    return {
        "depth": result.summary.max_depth,
        "moved": result.summary.max_displacement,
        "touched": result.summary.first_contact is not None and result.summary.max_depth > 0.0,
        "ball_over_size": mm
        * float(tool.radius or 0.0)
        / max(float(np.linalg.norm(np.ptp(rest[counted], axis=0))), 1e-300),
        "dent": float(dent.max()),
        "dent_over_tolerance": float(dent.max()) / tolerance,
        "export_error": float(off.max()),
        "export_within": bool(off.max() <= tolerance + 1e-9 * read.size),
    }


def _distance(surface: BSplineSurface, points: Array, at: Array, *, same: bool) -> Array:
    """Distance (n,) of points (n, 3) from a surface: the nearer of what is found from a grid on and, where the parameters are
    the same, from `at` (n, 2) on. The way from a grid may end at a crease."""
    u, v = (np.linspace(*bounds, 257) for bounds in surface.domain)
    grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=2).reshape(-1, 2)
    found = distance(surface, points, grid, np.asarray(surface.evaluate(grid[:, 0], grid[:, 1])))
    if same:
        found = np.minimum(found, distance(surface, points, at, np.asarray(surface.evaluate(at[:, 0], at[:, 1]))))
    return found


def _refit(loaded: Loaded, result: RunResult) -> dict[str, Any]:
    """The refit's error beside its tolerance; beyond it, what the run's warnings say kept it from it."""
    error, tolerance = result.summary.refit_max_error, float(loaded.scene.refit.tolerance or 0.0)
    (face,) = result.exported.faces
    told = next((line for line in result.warnings if repr(face.name) in line and "above refit.tolerance" in line), "")
    return {
        "refit_error": error,
        "refit_tolerance": tolerance,
        "refit_within": error <= tolerance,
        "refit_outcome": face.outcome,
        "refit_strays": face.between > tolerance,
        "refit_ok": error <= tolerance or (face.outcome != "within" and bool(told)),
        "net": [list(face.read_shape), list(face.surface.shape)],
        **({"refit_refused": told} if told else {}),
    }


class Before:
    """What the part was before it was sculpted."""

    def __init__(self, part: Part, number: int) -> None:
        self.format = part.format
        self.faults = _faults_by_face(part.validity())
        self.number = number
        face = part.faces.number(number)
        self.sculpted, self.area = face.surface, face.area
        self.others = [_Kept(other) for other in usable(part.faces) if other.number != number]
        self.faces = len(part.faces)
        self.closed = (self.sculpted.closed_u, self.sculpted.closed_v)
        self.gap, self.tolerance = seam_gap(part, face, self.closed), file_tolerance(part)

    def found_again(self, again: Part) -> Face:
        """The sculpted face among those that come back: of that number, or, should the order be another, with its border.

        A copy of the face as it was, which some files hold, has that border too.
        """
        own = [face for face in usable(again.faces) if face.number == self.number]
        if own and len(again.faces) == self.faces and _far(own[0], self.sculpted) <= 1e-3 * self.sculpted.size:
            return own[0]
        return min(usable(again.faces), key=lambda face: _far(face, self.sculpted))

    def validity(self, again: Part, read: Path, written: Path) -> dict[str, Any]:
        """Whether no face is worse than it was: by OCCT's checker on what comes back, and by a foreign reader of the file."""
        found = _faults_by_face(again.validity())
        worse = [line for face, lines in found.items() if len(lines) > len(self.faults.get(face, ())) for line in lines]
        first, second = foreign(read, self.format), foreign(written, self.format)
        others = faults(first, second, self.area) if first and second else []
        return {
            "valid": not worse and not others,
            "valid_before": not self.faults,
            "new_faults": [*worse[:5], *(f"{FOREIGN[self.format]}: {line}" for line in others)],
            "checked_by": FOREIGN.get(self.format, "OCCT on what was read back"),
        }

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

    def seams(self, again: Part, face: Face) -> dict[str, Any]:
        """The gap along the sculpted face's edges after the export, and what is allowed: the file's tolerance, or what
        gaped before, seen at other places along the edges."""
        gap = seam_gap(again, face, self.closed)
        return {
            "seam_edges": gap.edges,
            "seam_edges_before": self.gap.edges,
            "seam_gap": gap.largest,
            "seam_gap_before": self.gap.largest,
            "seam_tolerance": self.tolerance,
            "seam_allowed": max(self.tolerance, 1.01 * self.gap.largest),
        }


def _faults_by_face(validity: Validity) -> dict[str, list[str]]:
    """The checker's lines by the face that they begin with; what is said of the whole part under ""."""
    found: dict[str, list[str]] = {}
    for line in validity.faults:
        face = line.split(":", 1)[0] if line.startswith("face ") else ""
        found.setdefault(face, []).append(line)
    return found


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
