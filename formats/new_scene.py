"""`cadsculpt new`: a scene for a part that nobody has described yet.

Picks the face on which a tool can make the best dent, a place well inside it, a tool that fits there, how deep it may
press, and the lattice, times and outputs that go with it; then builds the scene and lets the engine confirm that the
tool starts outside and reaches the face. Geometry is in mm here; the scene is written in the file's own unit.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import CadsculptError, InputError
from ..jit import first_compilation
from ..physics.material import PRESETS
from ..units import conversion, metres_per_unit, unit_name
from . import registry
from .face_survey import FaceSamples, FaceSurvey, Spot, part_samples, survey
from .load import Loaded, load
from .part import Face, Part
from .press import SHAPES, USUAL, Press, Wish, kind_factor, placed, sizes_of, wanted
from .scene_toml import SceneFile, dump

Array = NDArray[np.float64]

MOST_SURVEYS = 40
"""Faces looked at closely, the most promising first."""

MOST_BUILDS = 12
"""Places tried before giving up."""

MOST_FOLDS = 4
"""Faces on which a lattice may fold before thinner ones are tried."""

THINNINGS = 8
"""Times that a lattice which folds is made thinner."""

FOLDS = "folds the lattice"
"""What the engine says of a lattice that is too thick for its face."""

CROSSINGS = 60.0
"""How often a wave crosses the thickness during a run: enough for the press to be quasi-static."""

MATERIAL = "clay"


@dataclass(frozen=True, slots=True, eq=False)
class NewScene:
    """The scene, its TOML, and what the user should be told. depth : of the press, in the scene's unit."""

    scene: SceneFile
    text: str
    face: Face
    depth: float
    nodes: int
    steps: int
    warnings: tuple[str, ...]


def new_scene(
    path: Path,
    out: Path,
    *,
    shape: str = "sphere",
    face: str | None = None,
    wish: Wish = USUAL,
    units: str | None = None,
    on_progress: Callable[[str], None] | None = None,
) -> NewScene:
    """A scene for the part at `path`, to be written to `out` (nothing is written here).

    face : name or number of the face to press, any when None. wish : how large the tool and how fine the lattice is to
    be. units : length unit of the file's numbers, whatever it says. on_progress : told in a few words what is being done.
    Raises InputError when the part has no face on which this tool can press.
    """
    if shape not in SHAPES:
        raise InputError(f"no {shape!r} to put above a face", mend=f"use one of {', '.join(SHAPES)}")
    tell = on_progress or (lambda words: None)
    first = ", compiling the kernels, once on this machine" if first_compilation() else ""
    tell(f"reading {path.name}")
    part = registry.read(path, units=units)
    chosen = _chosen(part, face)
    tell("looking for a place")
    failures: list[str] = []
    samples = part_samples(part)
    around = np.concatenate([np.zeros((0, 3)), *(entry.points for entry in samples.values())])
    surveys = _surveys(chosen, samples, around, failures, wish)
    unfit: set[int] = set()
    # as thick as the press asks for; as thick as cannot fold; and, where that were mere flakes, thinner until it stands
    for bold, attempts in ((True, 1), (False, THINNINGS), (True, THINNINGS)):
        folded: set[int] = set()
        builds = 0
        for sized in sorted(_presses(surveys, bold, wish), key=lambda press: -press.score):
            face_name, number = sized.survey.face.name, sized.survey.face.number
            if number in unfit | folded or builds == MOST_BUILDS or len(folded) == MOST_FOLDS:
                continue
            press = placed(sized, shape, around)
            if press is None:
                failures.append(f"face {face_name!r}: there is no room above it")
                continue
            builds += 1
            tell(f"building the scene on face {face_name!r}{first}")
            try:
                made = _confirmed(press, shape, part, path, out, wish.steps, units, attempts=attempts)
            except CadsculptError as error:
                (folded if FOLDS in error.what else unfit).add(number)
                failures.append(f"face {face_name!r}: {error.what}")
                continue
            if isinstance(made, NewScene):
                return made
            failures.append(f"face {face_name!r}: {made}")
    why = f": {failures[-1]}" if failures else ""
    mend = "choose another face with --face, or a smaller tool in a scene of your own" if part.faces else ""
    raise InputError(f"no face on which a {shape} can press{why}", where=str(path), mend=mend)


# ------------------------------------------------------------------------- where


def _chosen(part: Part, face: str | None) -> list[Face]:
    if not len(part.faces):
        raise InputError("the file has no faces", where=str(part.path), mend="a part needs at least one surface")
    if face is None:
        return list(part.faces)
    named = face in {f.name for f in part.faces}
    return [part.faces.number(int(face)) if face.isdecimal() and not named else part.faces.named(face)]


def _surveys(
    faces: Sequence[Face], samples: Mapping[int, FaceSamples], around: Array, failures: list[str], wish: Wish
) -> list[tuple[FaceSurvey, list[Spot]]]:
    """Faces and their spots, surveyed from the most promising on, until no other can be better."""
    ranked = sorted(((_promise(face, samples.get(face.number)), face) for face in faces), key=lambda entry: -entry[0])
    best, found = 0.0, []
    for promise, face in ranked[:MOST_SURVEYS]:
        if (promise <= 0.0 and len(faces) > 1) or promise < best:
            break
        try:
            seen = survey(face)
        except CadsculptError as error:
            failures.append(f"face {face.name!r}: {error}")
            continue
        spots = seen.spots(around)
        presses = [p for p in (wanted(seen, spot, bold=False, wish=wish) for spot in spots) if p is not None]
        if not presses:
            sharp = seen.fold < 0.1 * seen.size
            why = f"it bends with a radius of {seen.fold:.3g} mm" if sharp else "it is too narrow"
            failures.append(f"face {face.name!r}: {why}")
        best = max([best, *(press.score for press in presses)])
        found.append((seen, spots))
    return found


def _presses(surveys: Sequence[tuple[FaceSurvey, list[Spot]]], bold: bool, wish: Wish) -> Iterator[Press]:
    for seen, spots in surveys:
        for spot in spots:
            press = wanted(seen, spot, bold=bold, wish=wish)
            if press is not None:
                yield press


def _promise(face: Face, samples: FaceSamples | None) -> float:
    """The score that a face cannot exceed: a dent is narrower than a quarter of the square with the face's area."""
    return kind_factor(face) * min(0.25 * math.sqrt(samples.area), samples.size) if samples else 0.0


# ------------------------------------------------------------------ as a scene


def _confirmed(
    press: Press, shape: str, part: Part, path: Path, out: Path, steps: int, units: str | None, *, attempts: int
) -> NewScene | str:
    """The scene, once the engine has built it and found the tool outside at first and in the face at last.

    Returns what is wrong with this place when another place on the same face may do. Raises CadsculptError when the
    face cannot be sculpted; a lattice that folds gets thinner before that, so that there are so many attempts.
    """
    for attempt in range(attempts):
        try:
            scene = SceneFile.of(_values(press, shape, part, path, out, steps, units), out)
            loaded = load(scene)
            break
        except InputError as error:
            if FOLDS not in error.what or attempt == attempts - 1:
                raise
            press = _thinner(press)
    fault = _fault(loaded, press.depth * conversion("mm", scene.units))
    if fault:
        return fault
    patch = loaded.model.patches[0]
    nodes = len(patch.u) * len(patch.v)
    depth = press.depth * conversion("mm", scene.units)
    return NewScene(scene, dump(scene), press.survey.face, depth, nodes, loaded.model.steps, tuple(part.warnings))


def _thinner(press: Press) -> Press:
    depth = 0.6 * press.depth
    return replace(press, thickness=0.6 * press.thickness, depth=depth, end=press.end + press.depth - depth)


def _fault(loaded: Loaded, pressed: float) -> str:
    """Why the engine cannot take this scene, "" when it can. pressed : depth of the press, in the scene's unit."""
    from ..run import refuse_tools_inside
    from ..session import Session

    session = Session(loaded.model)
    try:
        refuse_tools_inside(session)
    except InputError as error:
        return error.what
    path = loaded.model.tools[0].path
    contacts = session.detect([path.pose(float(path.t[1]))]).contacts
    depth = float(contacts.depth.max(initial=0.0))
    return "" if depth > 0.3 * pressed else "the tool does not reach it"


def _values(
    press: Press, shape: str, part: Part, path: Path, out: Path, steps: int, file_units: str | None
) -> dict[str, Any]:
    """The scene's values, lengths in the file's unit."""
    units = part.units or "mm"
    factor = conversion("mm", units)
    spot, face = press.spot, press.survey.face

    def length(value: float) -> float:
        return significant(value * factor)

    def height(value: float) -> list[float]:
        # so many decimals that rounding moves the tool by less than a thousandth of its size
        decimals = 4 - math.floor(math.log10(press.scale * factor))
        return [round(float(x), max(decimals, 0)) for x in (spot.point + value * spot.normal) * factor]

    times = _times(press, metres_per_unit("mm"), steps)
    heights = (press.start, press.end, press.end, press.start)
    turn = _turn(spot.normal) if shape != "sphere" else None
    rows = [{"t": t, "at": height(h), **({"turn": turn} if turn else {})} for t, h in zip(times, heights, strict=True)]
    usable = face.name.isprintable() and face.name == face.name.strip() and face.name != ""
    sizes = {
        key: [length(item) for item in value] if isinstance(value, list) else length(value)
        for key, value in sizes_of(shape, press.scale).items()
    }
    own = {"step": ["step", "json"], "iges": ["iges", "json"], "3dm": ["3dm", "step", "json"]}
    return {
        "schema": 1,
        "name": path.stem if path.stem.isprintable() and path.stem.strip() == path.stem else "scene",
        "units": units,
        "model": [
            {
                "name": "part",
                "file": _relative(path, out),
                **({"file_units": unit_name(file_units)} if file_units else {}),
                "faces": [face.name if usable else face.number],
                "thickness": length(press.thickness),
                "nodes": length(press.spacing),
                "layers": press.layers,
                "anchor": "base",
                "material": MATERIAL,
            }
        ],
        "tool": [{"name": shape, "shape": shape, **sizes, "path": rows}],
        "solver": {"step": "auto", "resolution": _resolution(press)},
        "refit": {"tolerance": length(press.depth / 40.0)},
        "output": {"cad": own.get(part.format, ["json"]), "frames_per_second": significant(40.0 / times[-1], 2)},
    }


def _times(press: Press, metres: float, steps: int) -> tuple[float, float, float, float]:
    """Times in s: start, deepest, still deepest, back. Slow against waves through the thickness, in about `steps`."""
    clay = PRESETS[MATERIAL]
    speed = math.sqrt(clay.youngs_modulus / clay.density) / metres
    duration = significant(CROSSINGS * press.thickness / speed, 2)
    # an automatic step takes the fastest part of the path a tenth of the spacing further
    lift = min(max((press.start - press.end) / (0.1 * press.spacing * steps), 0.1), 0.4)
    return (
        0.0,
        round_to(0.85 * (1.0 - lift) * duration, duration),
        round_to((1.0 - lift) * duration, duration),
        duration,
    )


def _resolution(press: Press) -> list[int]:
    """Rows and columns of the collision grid: a dozen or more across the dent."""
    surface = press.survey.surface
    counts = []
    for axis, length in enumerate(press.survey.lengths):
        window = (press.survey.u, press.survey.v)[axis]
        low, high = surface.domain[axis]
        whole = length * (high - low) / float(window[-1] - window[0])
        counts.append(int(np.clip(math.ceil(6.0 * whole / press.half_width) + 1, 101, 801)))
    return counts


def _turn(normal: Array) -> list[float] | None:
    """Axis and degrees that turn the tool's z to the normal; None when they are the same."""
    x, y, z = (float(c) for c in normal)
    degrees = math.degrees(math.atan2(math.hypot(x, y), z))
    if degrees < 1e-6:
        return None
    length = math.hypot(x, y)
    axis = (-y / length, x / length) if length > 0.0 else (1.0, 0.0)
    return [round(axis[0], 9), round(axis[1], 9), 0.0, round(degrees, 6)]


def _relative(path: Path, out: Path) -> str:
    """The part's file as seen from the scene's folder; its full name on another drive."""
    try:
        return Path(os.path.relpath(path.resolve(), out.resolve().parent)).as_posix()
    except ValueError:
        return path.resolve().as_posix()


def significant(value: float, digits: int = 4) -> float:
    """The value with so many significant digits."""
    return float(f"{value:.{digits}g}")


def round_to(value: float, whole: float) -> float:
    """The value with three digits of `whole`."""
    return round(value, 2 - math.floor(math.log10(whole)))
