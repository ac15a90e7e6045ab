"""report.html: what a run found, in one file that needs no network.

Made from the run's folder alone, so that `run` and `report` write the same. Besides the result it shows the plots of
forces.csv, the pictures, and a 3D view of the series with a time slider, drawn by view.js without any library.
"""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...expect import Expectation
from ..atomic import write_whole
from ..camera import camera_for
from ..contacts_csv import ForceTable, read_forces
from ..frame_mesh import FaceMesh, FrameMesh, evenly
from ..pictures import CAPTIONS, PICTURE_FOLDER
from ..result_json import Result, read_result
from ..vtk_series import read_frame, read_part, read_series
from .plots import Plot, line_plot
from .view_data import MOST_FRAMES, view_data

IMAGE_TYPES = {".png": "image/png", ".gif": "image/gif"}


@dataclass(frozen=True, slots=True, eq=False)
class ReportImage:
    """A picture with its caption; data is the file's bytes, kind its media type."""

    caption: str
    data: bytes
    kind: str = "image/png"


def write_report(folder: str | os.PathLike[str]) -> Path:
    """Write report.html into a run's folder, from result.json, forces.csv, series.pvd and pictures/.

    Whatever of these but result.json is not there is left out. Raises InputError when the folder holds no result, a
    file in it is damaged, or the system refuses.
    """
    folder = Path(folder)
    if not (folder / "result.json").is_file():
        raise InputError(
            "not a run's folder: there is no result.json in it", where=str(folder), mend="name a run's folder"
        )
    result = read_result(folder / "result.json")
    forces = read_forces(folder / "forces.csv") if (folder / "forces.csv").is_file() else None
    series = read_series(folder / "series.pvd") if (folder / "series.pvd").is_file() else []
    frames = [read_frame(series[n][1]) for n in evenly(len(series), MOST_FRAMES)]
    part = folder / "frames" / "part.vtp"
    background = read_part(part) if part.is_file() else []
    path = folder / "report.html"
    write_whole(path, report_html(result, forces, frames, background, _images(folder / PICTURE_FOLDER)))
    return path


def report_html(
    result: Result,
    forces: ForceTable | None = None,
    frames: Sequence[FrameMesh] = (),
    background: Sequence[FaceMesh] = (),
    images: Sequence[ReportImage] = (),
) -> str:
    """The report as one HTML text."""
    import jinja2

    loader = jinja2.FunctionLoader(_template)
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    view = view_data(frames, background, result.units)
    if view is not None:
        view["camera"] = _camera(frames, background)
    held = sum(e.ok for e in result.expectations)
    return environment.get_template("report.html").render(
        result=result,
        held=held,
        summary=_summary(result),
        expectations=[(e, _measured(e, result.units)) for e in result.expectations],
        timing=_timing(result),
        plots=[plot for plot in _plots(result, forces) if plot is not None],
        images=[
            (image.caption, f"data:{image.kind};base64,{base64.b64encode(image.data).decode('ascii')}")
            for image in images
        ],
        view=None if view is None else _script_json(view),
        css=_template("report.css"),
        js=_template("view.js"),
    )


def _template(name: str) -> str:
    return resources.files(__package__ or "").joinpath(name).read_text(encoding="utf-8")


def _images(folder: Path) -> list[ReportImage]:
    images = []
    known = {stem: n for n, stem in enumerate(CAPTIONS)}
    files = sorted(folder.glob("*"), key=lambda file: (known.get(file.stem, len(known)), file.name))
    for file in files:
        if file.suffix in IMAGE_TYPES:
            try:
                data = file.read_bytes()
            except OSError as error:
                raise InputError(f"cannot be read: {error.strerror or error}", where=str(file)) from error
            caption = CAPTIONS.get(file.stem, file.stem.replace("_", " "))
            images.append(ReportImage(caption, data, IMAGE_TYPES[file.suffix]))
    return images


def _camera(frames: Sequence[FrameMesh], background: Sequence[FaceMesh]) -> list[float]:
    """The unit direction from the part to the camera."""
    corners = np.concatenate([np.zeros((0, 3, 3)), *(face.points[face.triangles] for face in background)])
    if not frames:
        return [0.36, -0.62, 0.7]
    camera = camera_for(frames[-1], corners)
    direction = camera.position - camera.focus
    return (direction / np.linalg.norm(direction)).tolist()  # type: ignore[no-any-return]


def _summary(result: Result) -> list[tuple[str, str, str]]:
    """(what, number, unit) in the order of the summary."""
    length, s = result.units, result.summary
    rows = [
        ("First contact", s.first_contact, "s"),
        ("Deepest contact", s.max_depth, length),
        ("Penetration left after a step", s.max_penetration, length),
        ("Largest force", s.max_force, "N"),
        ("Largest contact area", s.max_contact_area, f"{length}²"),
        ("Largest displacement", s.max_displacement, length),
        ("Refit error, largest", s.refit_max_error, length),
        ("Refit error, RMS", s.refit_rms_error, length),
    ]
    if result.seams:
        rows.append(("Gap along common edges, largest", s.seam_max_gap, length))
    return [
        (name, "none" if value is None else f"{value:.4g}", "" if value is None else unit) for name, value, unit in rows
    ]


def _measured(expectation: Expectation, units: str) -> tuple[str, str]:
    """The measured value as text, and the unit of a number."""
    value = expectation.measured
    if value is None:
        return "nothing", ""
    if isinstance(value, str | bool):
        return str(value), ""
    unit = {"first_contact": "s", "max_force": "N", "contact_area": f"{units}²"}.get(expectation.what, units)
    return f"{value:.6g}", unit


def _timing(result: Result) -> list[tuple[str, str]]:
    t = result.timing
    rows = [("Whole run", f"{t.total_s:.2f} s")]
    if t.compile_s:
        rows.append(("of it compiling", f"{t.compile_s:.2f} s"))
    steps = (("A step, median", t.median), ("99 of 100 steps within", t.p99), ("slowest step", t.max))
    rows += [(name, f"{value:.3g} ms") for name, value in steps if value is not None]
    return rows + [
        (f"{name.replace('_', ' ')}, median of a step", f"{value:.3g} ms") for name, value in t.phases_ms.items()
    ]


def _plots(result: Result, forces: ForceTable | None) -> list[Plot | None]:
    length = result.units
    plots: list[Plot | None] = []
    if forces is not None:
        of = [(tool, forces.tool == tool) for tool in forces.tools]
        size = np.linalg.norm(forces.force, axis=1)
        left = "left after the step"
        depths = [(tool, forces.time[rows], forces.max_depth[rows]) for tool, rows in of]
        rests = [
            (f"{tool}, {left}" if len(of) > 1 else left, forces.time[rows], forces.max_penetration[rows])
            for tool, rows in of
        ]
        plots += [
            line_plot(
                "Force on the tool",
                "Time [s]",
                "Force [N]",
                [(tool, forces.time[rows], size[rows]) for tool, rows in of],
            ),
            line_plot("Depth", "Time [s]", f"Depth [{length}]", depths + rests, dashed=[name for name, _, _ in rests]),
            line_plot(
                "Contact area",
                "Time [s]",
                f"Area [{length}²]",
                [(tool, forces.time[rows], forces.contact_area[rows]) for tool, rows in of],
            ),
        ]
    each = np.array(result.timing.each)
    steps = np.linspace(1.0, max(result.steps, 1), len(each)) if len(each) else each
    plots.append(line_plot("Time per step", "Step", "Time [ms]", [("step", steps, each)]))
    return plots


def _script_json(value: Any) -> str:
    """JSON that cannot end the script element it stands in."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
