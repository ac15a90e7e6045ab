"""result.json: what a run found, as one object. Everything in it but `timing` is the same in two runs, byte for byte.

`Result` holds the engine's `Summary` and `Expectation`s with the timing and the files; a `Case` is one case of a check.
A number that is not finite is written as null: JSON has no other word for it.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .._version import __version__
from ..errors import InputError
from ..expect import Expectation as Expectation
from ..expect import condition_in_words as condition_in_words
from ..export_fit import ExportedFace
from ..history import Summary
from ..seam_fit import ExportedSeam
from .atomic import write_whole

MOST_STEPS = 2000
"""At most this many step times are kept in `timing`; of longer runs, the slowest step of each stretch."""

NOT_HASHED = ("result.json", "report.html")
"""Files of a run's folder that are not among `outputs`: they hold the timings."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Wall-clock times: seconds for the whole, milliseconds a step.

    phases_ms : the median of each phase of a step. each : the steps one by one, for plots.
    """

    compile_s: float = 0.0
    total_s: float = 0.0
    median: float | None = None
    p99: float | None = None
    max: float | None = None
    phases_ms: Mapping[str, float] = field(default_factory=dict)
    each: tuple[float, ...] = ()

    @classmethod
    def of_steps(
        cls,
        step_ms: NDArray[np.float64] | Sequence[float],
        *,
        compile_s: float = 0.0,
        total_s: float = 0.0,
        phases_ms: Mapping[str, float] | None = None,
    ) -> Timing:
        """From the time of every step [ms]."""
        steps = np.asarray(step_ms, np.float64)
        phases = dict(phases_ms or {})
        if not len(steps):
            return cls(compile_s, total_s, phases_ms=phases)
        stretches = np.array_split(steps, min(len(steps), MOST_STEPS))
        return cls(
            compile_s,
            total_s,
            median=float(np.median(steps)),
            p99=float(np.percentile(steps, 99)),
            max=float(steps.max()),
            phases_ms=phases,
            each=tuple(round(float(stretch.max()), 4) for stretch in stretches),
        )


@dataclass(frozen=True, slots=True)
class FileHash:
    """A file by the name it is known under (forward slashes) and the SHA-256 of its bytes, in hexadecimal."""

    file: str
    sha256: str


@dataclass(frozen=True, slots=True)
class FaceFit:
    """The refit of one sculpted face: the net that went to CAD, beside the one as read and the one that the run used.

    outcome : "within" the tolerance, or what kept it from it: "limit", "nodes", "seams" or "refine".
    """

    name: str
    control_points: tuple[int, int]
    control_points_as_read: tuple[int, int]
    control_points_while_running: tuple[int, int]
    refit_max_error: float
    refit_rms_error: float
    refit_between_error: float
    max_error_while_running: float
    outcome: str

    @classmethod
    def of(cls, face: ExportedFace) -> FaceFit:
        return cls(
            face.name,
            face.surface.shape,
            face.read_shape,
            face.working_shape,
            face.error.maximum,
            face.error.rms,
            face.between,
            face.working.maximum,
            face.outcome,
        )


@dataclass(frozen=True, slots=True)
class Result:
    """A run's outcome; `time` [s] is the simulated time reached in `steps` steps."""

    scene: str
    units: str
    steps: int
    time: float
    converged: bool
    summary: Summary
    expectations: tuple[Expectation, ...] = ()
    timing: Timing = Timing()
    inputs: tuple[FileHash, ...] = ()
    outputs: tuple[FileHash, ...] = ()
    warnings: tuple[str, ...] = ()
    faces: tuple[FaceFit, ...] = ()
    seams: tuple[ExportedSeam, ...] = ()
    cadsculpt: str = __version__


@dataclass(frozen=True, slots=True)
class Case:
    """One case of a check: the file, its name, and what came of it. `message` says why, when the outcome is error."""

    file: str
    name: str
    outcome: Literal["passed", "failed", "error"]
    expectations: tuple[Expectation, ...] = ()
    message: str = ""
    seconds: float = 0.0


def result_object(result: Result) -> dict[str, Any]:
    """The object of result.json, keys in the promised order, files sorted by name."""
    timing = result.timing
    step_ms = {"median": timing.median, "p99": timing.p99, "max": timing.max, "each": list(timing.each)}
    return _finite_object(
        {
            "cadsculpt": result.cadsculpt,
            "scene": result.scene,
            "units": result.units,
            "steps": result.steps,
            "time": result.time,
            "converged": result.converged,
            "summary": asdict(result.summary),
            "expectations": [expectation_object(e) for e in result.expectations],
            "timing": {
                "compile_s": timing.compile_s,
                "total_s": timing.total_s,
                "step_ms": step_ms,
                "phases_ms": dict(timing.phases_ms),
            },
            "inputs": _sorted(result.inputs),
            "outputs": _sorted(result.outputs),
            "warnings": list(result.warnings),
            "faces": [asdict(face) for face in result.faces],
            "seams": [asdict(seam) for seam in result.seams],
        }
    )


def expectation_object(expectation: Expectation) -> dict[str, Any]:
    """{"what", "expected", "measured", "ok"}, and "pair" where there is one."""
    pair = {"pair": list(expectation.pair)} if expectation.pair else {}
    return _finite_object(
        {
            "what": expectation.what,
            **pair,
            "expected": dict(expectation.expected),
            "measured": expectation.measured,
            "ok": bool(expectation.ok),
        }
    )


def cases_object(cases: Sequence[Case]) -> dict[str, Any]:
    """The object of `check --json`."""
    return {
        "cases": [
            {
                "file": case.file,
                "name": case.name,
                "outcome": case.outcome,
                "expectations": [expectation_object(e) for e in case.expectations],
                **({"message": case.message} if case.message else {}),
            }
            for case in cases
        ],
        "passed": sum(case.outcome == "passed" for case in cases),
        "failed": sum(case.outcome == "failed" for case in cases),
        "errors": sum(case.outcome == "error" for case in cases),
    }


def json_text(value: Mapping[str, Any]) -> str:
    """JSON with two-space indents and a newline at the end; numbers keep all their digits."""
    return json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def write_result(path: str | os.PathLike[str], result: Result) -> None:
    """Write result.json, whole or not at all. Raises InputError when the system refuses."""
    write_whole(path, json_text(result_object(result)))


def read_result(path: str | os.PathLike[str]) -> Result:
    """Read result.json. Raises InputError when the file is missing or is no such object."""
    path = Path(path)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", where=str(path)) from error
    except ValueError as error:
        raise InputError(f"not a result of cadsculpt: {error}", where=str(path)) from error
    try:
        step_ms = data["timing"]["step_ms"]
        return Result(
            scene=str(data["scene"]),
            units=str(data["units"]),
            steps=int(data["steps"]),
            time=float(data["time"]),
            converged=bool(data["converged"]),
            summary=Summary(**{f.name: data["summary"].get(f.name) for f in fields(Summary)}),
            expectations=tuple(
                Expectation(e["what"], e["expected"], e["measured"], e["ok"], tuple(e.get("pair", ())))
                for e in data["expectations"]
            ),
            timing=Timing(
                data["timing"]["compile_s"],
                data["timing"]["total_s"],
                step_ms["median"],
                step_ms["p99"],
                step_ms["max"],
                data["timing"]["phases_ms"],
                tuple(step_ms.get("each", ())),
            ),
            inputs=tuple(FileHash(**entry) for entry in data["inputs"]),
            outputs=tuple(FileHash(**entry) for entry in data["outputs"]),
            warnings=tuple(data.get("warnings", ())),
            faces=tuple(FaceFit(**_tuples(entry)) for entry in data.get("faces", ())),
            seams=tuple(ExportedSeam(**_tuples(entry)) for entry in data.get("seams", ())),
            cadsculpt=str(data["cadsculpt"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        reason = f"no {error.args[0]!r} in it" if isinstance(error, KeyError) else str(error)
        raise InputError(f"not a result of cadsculpt: {reason}", where=str(path)) from error


def _tuples(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()}


def hashed(folder: str | os.PathLike[str], files: Iterable[str | os.PathLike[str]]) -> tuple[FileHash, ...]:
    """SHA-256 of files, named relative to `folder` (one that lies elsewhere keeps the name given), sorted by name.

    Files in NOT_HASHED are left out. Raises InputError when a file cannot be read.
    """
    folder = Path(folder)
    hashes = {}
    for file in files:
        path = folder / file
        name = (path.relative_to(folder) if path.is_relative_to(folder) else Path(file)).as_posix()
        if name in NOT_HASHED:
            continue
        try:
            with open(path, "rb") as stream:
                hashes[name] = FileHash(name, hashlib.file_digest(stream, "sha256").hexdigest())
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror or error}", where=str(path)) from error
    return tuple(hashes[name] for name in sorted(hashes))


def _sorted(files: Sequence[FileHash]) -> list[dict[str, str]]:
    return [asdict(entry) for entry in sorted(files, key=lambda entry: entry.file)]


def _finite_object(value: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _finite(item) for key, item in value.items()}


def _finite(value: Any) -> Any:
    """The same value with Python's own types, and None for every number that is not finite."""
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


_OPTIONAL_NUMBER = {"type": ["number", "null"]}
_SHAPE = {"type": "array", "items": {"type": "integer"}, "minItems": 2, "maxItems": 2}
_FILES = {
    "type": "array",
    "items": {
        "type": "object",
        "required": ["file", "sha256"],
        "properties": {"file": {"type": "string"}, "sha256": {"type": "string", "pattern": "^[0-9a-f]{64}$"}},
    },
}


def result_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of result.json."""
    return {
        "title": "cadsculpt result",
        "type": "object",
        "required": [f.name for f in fields(Result) if f.name not in ("warnings", "faces", "seams")],
        "properties": {
            "cadsculpt": {"type": "string", "description": "version that ran"},
            "scene": {"type": "string"},
            "units": {"type": "string", "description": "length unit of every length in the object"},
            "steps": {"type": "integer", "minimum": 0},
            "time": {"type": "number", "description": "simulated time reached, s"},
            "converged": {"type": "boolean"},
            "summary": {
                "type": "object",
                "required": [f.name for f in fields(Summary)],
                "properties": {f.name: _OPTIONAL_NUMBER for f in fields(Summary)},
            },
            "faces": {
                "type": "array",
                "description": "the refit of every sculpted face",
                "items": {
                    "type": "object",
                    "required": [f.name for f in fields(FaceFit)],
                    "properties": {
                        **dict.fromkeys([f.name for f in fields(FaceFit)], _OPTIONAL_NUMBER),
                        **dict.fromkeys([f.name for f in fields(FaceFit) if f.name.startswith("control")], _SHAPE),
                        "name": {"type": "string"},
                        "outcome": {"enum": ["within", "limit", "nodes", "seams", "refine"]},
                    },
                },
            },
            "seams": {
                "type": "array",
                "description": "common edges of sculpted faces, and the seams of closed ones; angles in degrees",
                "items": {
                    "type": "object",
                    "required": [f.name for f in fields(ExportedSeam)],
                    "properties": {
                        **dict.fromkeys([f.name for f in fields(ExportedSeam)], _OPTIONAL_NUMBER),
                        "faces": {"type": "array", "items": {"type": "string"}, "minItems": 2, "maxItems": 2},
                        "tolerance_from": {"enum": ["file", "edge", "size", "scene"]},
                    },
                },
            },
            "expectations": {
                "type": "array",
                "items": {
                    "type": "object",
                    "required": ["what", "expected", "measured", "ok"],
                    "properties": {
                        "what": {"type": "string"},
                        "pair": {"type": "array", "items": {"type": "string"}},
                        "expected": {"type": "object"},
                        "measured": {"type": ["number", "string", "boolean", "null"]},
                        "ok": {"type": "boolean"},
                    },
                },
            },
            "timing": {
                "type": "object",
                "required": ["compile_s", "total_s", "step_ms", "phases_ms"],
                "properties": {
                    "compile_s": {"type": "number"},
                    "total_s": {"type": "number"},
                    "step_ms": {
                        "type": "object",
                        "required": ["median", "p99", "max"],
                        "properties": {
                            "median": _OPTIONAL_NUMBER,
                            "p99": _OPTIONAL_NUMBER,
                            "max": _OPTIONAL_NUMBER,
                            "each": {"type": "array", "items": {"type": "number"}},
                        },
                    },
                    "phases_ms": {"type": "object", "additionalProperties": {"type": "number"}},
                },
            },
            "inputs": _FILES,
            "outputs": _FILES,
            "warnings": {"type": "array", "items": {"type": "string"}},
        },
    }
