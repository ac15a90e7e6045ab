"""A run's folder: everything that `cadsculpt run` leaves behind, whole or resumable.

While it goes, a run writes into `<folder>.partial`: frames as they come, the records of the steps in pieces, and now and
then a checkpoint. When all is there the folder gets its name. A run that is interrupted, or meets a full disk, leaves the
partial folder, and `resume=True` goes on from its last checkpoint.
"""

from __future__ import annotations

import hashlib
import re
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..collide.contacts import Contacts
from ..errors import CadsculptError, InputError
from ..frames import FrameMaker
from ..record import ContactRecord, Frame, StepRecord
from ..run import Hooks, RunResult, run
from ..session import Session
from ..spline.surface import BSplineSurface
from ..units import conversion
from . import patch_json, registry
from .atomic import cannot_write, whole_path
from .compile_beside import compile_beside
from .contacts_csv import ContactsWriter, ForcesWriter, write_displacements
from .frame_mesh import FaceMesh
from .html_report.report import write_report
from .load import Loaded, load
from .mesh import write_lattice
from .pictures import PICTURE_FOLDER, draw, run_pictures
from .result_json import FaceFit, Result, Timing, hashed, result_object, write_result
from .scene_toml import SceneFile
from .tessellate import background, outlines
from .vtk_series import SeriesWriter, read_frame

Array = NDArray[np.float64]

CHECKPOINT_SECONDS = 10.0
SUFFIX = {"step": ".step", "iges": ".igs", "3dm": ".3dm", "json": ".json"}


@dataclass(frozen=True, slots=True)
class Progress:
    """What a run is doing: stage is reading, compiling, preparing, running, writing or pictures; `done` of `total` steps."""

    stage: str
    done: int = 0
    total: int = 0
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class RunOutcome:
    """A finished run: the engine's result, the object of result.json, the folder, and what the user should know."""

    result: RunResult
    document: dict[str, Any]
    folder: Path
    warnings: tuple[str, ...]


def run_scene(
    scene: SceneFile,
    folder: Path,
    *,
    force: bool = False,
    resume: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> RunOutcome:
    """Run a scene and write its folder.

    Raises InputError when the folder exists and `force` is not set, when nothing is there to resume, for a scene that
    cannot be built, and when the disk is full; in the last case the partial folder stays for `resume`.
    """
    tell = on_progress or (lambda progress: None)
    started = time.perf_counter()
    partial = folder.with_name(folder.name + ".partial")
    _make_room(folder, partial, force=force, resume=resume)
    compile_s = _compile(scene, tell)
    loaded = load(scene, on_file=lambda name: tell(Progress("reading", note=name)))
    tell(Progress("preparing"))
    writing = _Writing(partial, loaded, _scene_hash(scene), resumed=resume)
    try:
        state = writing.open()
        session = Session(loaded.model, clock=time.perf_counter)
        writing.start(session)
        with _deferred_interrupt() as interrupted:

            def progress(done: int, total: int) -> None:
                tell(Progress("running", done, total))

            def checkpoint(step: int, arrays: Callable[[], dict[str, Array]]) -> None:
                writing.checkpoint(arrays, now=interrupted())
                if interrupted():
                    raise KeyboardInterrupt

            hooks = Hooks(writing.step, writing.frame, progress, checkpoint)
            result = run(session, hooks=hooks, resume=state)
        document = _finish(writing, scene, result, compile_s, started, tell)
    except BaseException:
        writing.give_up()
        raise
    writing.finish(folder, force=force)
    return RunOutcome(result, result_object(document), folder, document.warnings)


def _finish(
    writing: _Writing,
    scene: SceneFile,
    result: RunResult,
    compile_s: float,
    started: float,
    tell: Callable[[Progress], None],
) -> Result:
    """Write everything that a finished run leaves behind."""
    tell(Progress("writing"))
    session = result.session
    warnings = [*writing.loaded.warnings, *result.warnings, *writing.results(result)]
    if scene.output.pictures:
        tell(Progress("pictures"))
        warnings += writing.pictures()
    timing = session.timing
    document = Result(
        scene=scene.name,
        units=scene.units,
        steps=session.state.step,
        time=session.state.time,
        converged=result.converged,
        summary=result.summary,
        faces=tuple(FaceFit.of(face) for face in result.exported.faces),
        seams=result.exported.seams,
        expectations=result.expectations,
        timing=Timing.of_steps(
            1e3 * np.sum(list(timing.values()), axis=0),
            compile_s=compile_s,
            total_s=time.perf_counter() - started,
            phases_ms={phase: float(1e3 * np.median(seconds)) for phase, seconds in timing.items() if seconds},
        ),
        inputs=hashed(scene.folder, [scene.path, *scene.sources()]),
        outputs=hashed(writing.folder, writing.files),
        warnings=tuple(dict.fromkeys([*warnings, *([result.failure] if result.failure else [])])),
    )
    write_result(writing.folder / "result.json", document)
    write_report(writing.folder)
    return document


@contextmanager
def _deferred_interrupt() -> Iterator[Callable[[], bool]]:
    """While a run steps, the first Ctrl-C waits for the end of the step, so that a checkpoint can be written.

    Yields a function that tells whether there was one. A second Ctrl-C stops at once. Outside the main thread signals
    are left alone.
    """
    seen = [False]
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    before = signal.getsignal(signal.SIGINT)

    def note(number: int, frame: object) -> None:
        seen[0] = True
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, note)
    try:
        yield lambda: seen[0]
    finally:
        signal.signal(signal.SIGINT, before)


def _make_room(folder: Path, partial: Path, *, force: bool, resume: bool) -> None:
    if folder.exists() and not force:
        raise InputError(
            "it exists", where=str(folder), mend="choose another folder with -o, or overwrite it with --force"
        )
    if resume and not (partial / "checkpoint.npz").exists():
        raise InputError("there is no interrupted run to resume", where=str(partial), mend="run it without --resume")
    if partial.exists() and not resume:
        if not force:
            raise InputError(
                "an interrupted run lies here",
                where=str(partial),
                mend="go on with --resume, or start again with --force",
            )
        shutil.rmtree(partial, ignore_errors=True)


def _compile(scene: SceneFile, tell: Callable[[Progress], None]) -> float:
    """Compile or load the kernels, apart from the steps, so that step times mean something."""
    started = time.perf_counter()
    from ..jit import first_compilation

    compiling = Progress("compiling", note="first run on this machine: compiling the kernels, once")
    tell(compiling if first_compilation() else Progress("compiling"))
    from ..warm import kinds_of, warm_beside, warm_up

    # compiling keeps one core busy for most of a minute: a second process takes a half
    with compile_beside(warm_beside, kinds_of(scene), scene.solver.integrator, tell=lambda: tell(compiling)) as beside:
        warm_up(scene, beside.wait)
    return time.perf_counter() - started


def _scene_hash(scene: SceneFile) -> str:
    digest = hashlib.sha256()
    for path in [scene.path, *scene.sources()]:
        digest.update(path.read_bytes())
    return digest.hexdigest()


@dataclass(slots=True, eq=False)
class _Writing:
    """The partial folder of one run."""

    folder: Path
    loaded: Loaded
    scene_hash: str
    resumed: bool
    _steps: list[StepRecord] = field(default_factory=list)
    _contacts: list[ContactRecord] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    _frames: list[tuple[float, str]] = field(default_factory=list)
    _saved: int = 0
    _last: float = field(default_factory=time.perf_counter)
    stepped: bool = False
    """All steps are done: the state is whole, whatever fails from here on."""
    _latest: Callable[[], dict[str, Array]] | None = None
    _series: SeriesWriter | None = None
    _background: list[FaceMesh] = field(default_factory=list)
    _outlines: dict[str, list[Array]] = field(default_factory=dict)

    # ------------------------------------------------------------ while running

    def open(self) -> dict[str, Array] | None:
        """Make the folder, or read the checkpoint of an interrupted run."""
        try:
            (self.folder / "spool").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise cannot_write(self.folder, error) from error
        return self._read_checkpoint() if self.resumed else None

    def start(self, session: Session) -> None:
        """Open the series, and draw the faces that stay as they are into it once."""
        maker = FrameMaker.of(session)
        for name, patch, (u, v) in zip(maker.names, session.model.patches, maker.parameters(), strict=False):
            if patch.surface.trims is not None:
                self._outlines[name] = outlines(patch.surface, u, v)
        self._series = SeriesWriter(self.folder, self._outlines, written=self._frames)
        to_scene = conversion("mm", self.loaded.scene.units)
        for path, part in self.loaded.parts.items():
            sculpted = {number for where, number in self.loaded.faces if where == path}
            meshes, _ = background(part, sculpted, to_scene)
            self._background += meshes
        if self._background:
            self._series.add_part(self._background)

    def step(self, step: StepRecord, contacts: ContactRecord) -> None:
        self._steps.append(step)
        self._contacts.append(contacts)

    def frame(self, frame: Frame) -> None:
        assert self._series is not None
        self._series.add(frame)

    def checkpoint(self, arrays: Callable[[], dict[str, Array]], *, now: bool = False) -> None:
        """Every few seconds, or now: the records since the last time, then the state that they lead to."""
        self._latest = arrays
        if not now and time.perf_counter() - self._last < CHECKPOINT_SECONDS:
            return
        self._last = time.perf_counter()
        self._spool()
        assert self._series is not None
        entries = self._series.entries
        with whole_path(self.folder / "checkpoint.npz") as path:
            np.savez(
                path,
                scene_hash=np.array(self.scene_hash),
                saved=np.array(self._saved),
                frame_times=np.array([t for t, _ in entries]),
                frame_names=np.array([name for _, name in entries], dtype=str),
                **arrays(),  # type: ignore[arg-type]
            )

    def _read_checkpoint(self) -> dict[str, Array]:
        with np.load(self.folder / "checkpoint.npz") as stored:
            arrays = dict(stored)
        if str(arrays.pop("scene_hash")) != self.scene_hash:
            raise InputError(
                "the scene or one of its files has changed since the run was interrupted",
                where=str(self.folder),
                mend="start again with --force",
            )
        self._saved = int(arrays.pop("saved"))
        self._frames = list(zip(arrays.pop("frame_times").tolist(), arrays.pop("frame_names").tolist(), strict=True))
        return arrays

    def _spool(self) -> None:
        """Write the records that are in memory as one piece, and let go of them."""
        if not self._steps:
            return
        columns: dict[str, Any] = {
            f"step_{name}": np.array([getattr(record, name) for record in self._steps]) for name in StepRecord.__slots__
        }
        columns["count"] = np.array([len(record.contacts) for record in self._contacts])
        for name in Contacts.__slots__:
            columns[f"contact_{name}"] = np.concatenate([getattr(r.contacts, name) for r in self._contacts])
        columns["contact_force"] = np.concatenate([record.force for record in self._contacts])
        with whole_path(self.folder / "spool" / f"{self._saved:06d}.npz") as path:
            np.savez(path, **columns)
        self._saved += 1
        self._steps.clear()
        self._contacts.clear()

    def give_up(self) -> None:
        """After a failure: keep what `resume` can go on from, and nothing else."""
        if self.stepped and self._latest is not None:
            with suppress(CadsculptError, OSError):
                self.checkpoint(self._latest, now=True)
        if not (self.folder / "checkpoint.npz").exists():
            shutil.rmtree(self.folder, ignore_errors=True)

    # ------------------------------------------------------------ when it is over

    def results(self, result: RunResult) -> list[str]:
        """Tables, lattice, CAD files. Returns warnings."""
        self.stepped = True
        self._spool()
        model = self.loaded.model
        tools = [tool.name for tool in model.tools]
        with (
            ContactsWriter(self.folder / "contacts.csv", model.bodies, [face.name for face in model.faces]) as contacts,
            ForcesWriter(self.folder / "forces.csv", tools) as forces,
        ):
            for piece in range(self._saved):
                for step, touched in _unspooled(self.folder / "spool" / f"{piece:06d}.npz"):
                    forces.add(step)
                    contacts.add(touched)
        self.files += ["contacts.csv", "forces.csv"]
        models = [i for i, patch in enumerate(model.patches) if patch.body < model.models]
        self._displacements(result.session, "displacements.csv", models)
        for tool in model.tools:
            if tool.patches:
                name = f"displacements.{_file_name(tool.name)}.csv"
                if name in self.files:  # of another tool, whose name differs in signs that no file has
                    name = f"displacements.{_file_name(tool.name)}-{model.tools.index(tool) + 1}.csv"
                self._displacements(result.session, name, tool.patches)
        write_lattice(self.folder / "lattice.vtu", FrameMaker.of(result.session).lattices())
        assert self._series is not None
        self._series.close()
        self.files += ["lattice.vtu", *self._series.files]
        return self._cad(result)

    def _displacements(self, session: Session, name: str, patches: Sequence[int]) -> None:
        """A table of the surface nodes of some patches: at rest and how far they moved, a tool's in the tool's frame."""
        rest, moved = [np.zeros((0, 3))], [np.zeros((0, 3))]
        for i in patches:
            lattice = session.model.patches[i].lattice
            rest.append(lattice.nodes.reshape(*lattice.shape, 3)[:, :, 0].reshape(-1, 3))
            moved.append(session.displacement(i).reshape(-1, 3))
        write_displacements(self.folder / name, np.concatenate(rest), np.concatenate(moved))
        self.files.append(name)

    def _cad(self, result: RunResult) -> list[str]:
        """The parts with the sculpted faces in place, in every format that the scene asks for."""
        warnings: list[str] = []
        sculpted = self.loaded.sculpted(result.exported)
        several = len(sculpted) > 1
        nets: list[BSplineSurface] = []
        for path, surfaces in sculpted.items():
            part = self.loaded.parts[path]
            before = len(part.warnings)
            was_valid = part.validity()
            part.sculpt(surfaces)
            now = part.validity()
            if not now.valid and len(now.faults) > len(was_valid.faults):
                new = [fault for fault in now.faults if fault not in was_valid.faults]
                warnings.append(f"{path.name}: the CAD kernel finds fault with the result: {'; '.join(new[:3])}")
            stem = f"surfaces.{path.stem}" if several else "surfaces"
            for format in self.loaded.scene.output.cad:
                if format == "json":
                    continue
                registry.write_part(part, self.folder / (stem + SUFFIX[format]), format)
                self.files.append(stem + SUFFIX[format])
            warnings += [f"{path.name}: {line}" for line in part.warnings[before:]]
            nets += [surface for _, surface in sorted(surfaces.items())]
        if "json" in self.loaded.scene.output.cad and nets:
            patch_json.write_surfaces(self.folder / "surfaces.json", nets, "mm")
            self.files.append("surfaces.json")
        return warnings

    def pictures(self) -> list[str]:
        """Draw the pictures of the run. Returns a warning for each that could not be drawn."""
        assert self._series is not None
        entries = self._series.entries
        frames = [read_frame(self.folder / name) for _, name in entries]
        wanted = run_pictures(self.folder, frames)
        (self.folder / PICTURE_FOLDER).mkdir(exist_ok=True)
        warnings = draw(frames, wanted, self._background, units=self.loaded.scene.units, outlines=self._outlines)
        made = [Path(picture.path) for picture in wanted if Path(picture.path).exists()]
        self.files += [path.relative_to(self.folder).as_posix() for path in made]
        return warnings

    def finish(self, folder: Path, *, force: bool) -> None:
        """Drop what only a resumed run would need and give the folder its name."""
        try:
            shutil.rmtree(self.folder / "spool", ignore_errors=True)
            (self.folder / "checkpoint.npz").unlink(missing_ok=True)
            if folder.exists() and force:
                shutil.rmtree(folder)
            self.folder.replace(folder)
        except OSError as error:
            raise cannot_write(folder, error) from error


def _file_name(name: str) -> str:
    """A tool's name as a file can be called."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-") or "tool"


def _unspooled(path: Path) -> list[tuple[StepRecord, ContactRecord]]:
    with np.load(path) as stored:
        columns = dict(stored)
    ends = np.concatenate([[0], np.cumsum(columns["count"])])
    records = []
    for row in range(len(columns["count"])):
        step = StepRecord(**{name: columns[f"step_{name}"][row] for name in StepRecord.__slots__})
        step = StepRecord(int(step.step), float(step.time), *(getattr(step, n) for n in StepRecord.__slots__[2:]))
        cut = slice(ends[row], ends[row + 1])
        contacts = Contacts(**{name: columns[f"contact_{name}"][cut] for name in Contacts.__slots__})
        records.append((step, ContactRecord(step.step, step.time, contacts, columns["contact_force"][cut])))
    return records
