"""report.html: complete, offline, safe against what a scene may contain, and true to the numbers."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadsculpt.errors import InputError
from cadsculpt.expect import Expectation
from cadsculpt.formats.contacts_csv import ForcesWriter, ForceTable
from cadsculpt.formats.frame_mesh import FrameMesher, borders, normal_displacement, triangles_of
from cadsculpt.formats.html_report.plots import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, line_plot
from cadsculpt.formats.html_report.report import ReportImage, report_html, write_report
from cadsculpt.formats.html_report.view_data import MOST_VERTICES, thinned, view_data
from cadsculpt.formats.result_json import FileHash, Result, Timing, write_result
from cadsculpt.formats.vtk_series import SeriesWriter
from cadsculpt.history import Summary
from cadsculpt.record import StepRecord

VOID = {"meta", "link", "input", "img", "line", "path", "polyline"}
PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


NOTHING = Summary(None, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Page(HTMLParser):
    """Checks that tags close in order; keeps the text, the attributes and the script data."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.data: dict[str, Any] | None = None
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            if self.tags[-1][1].get("id") == "view-data":
                self.data = json.loads(data)
        elif not self.open or self.open[-1] != "style":
            self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))


def result(**changes: Any) -> Result:
    given: dict[str, Any] = {
        "scene": "thumb press",
        "units": "mm",
        "steps": 20,
        "time": 0.5,
        "converged": True,
        "summary": Summary(0.1, 4.6, 0.01, 12.5, 33.0, 4.61, 1e-3, 1e-4),
        "expectations": (
            Expectation("first_contact", {"between": [0.05, 0.2]}, 0.1, True, ("thumb", "panel")),
            Expectation("max_depth", {"at_most": 4.0}, 4.6, False),
        ),
        "timing": Timing.of_steps(np.linspace(1.0, 2.0, 20), total_s=3.25, phases_ms={"cull": 4.5}),
        "outputs": (FileHash("contacts.csv", "0" * 64),),
    }
    return Result(**{**given, **changes})


def forces(count: int = 20) -> ForceTable:
    time = np.linspace(0.0, 0.5, count)
    one, three = np.ones(count), np.ones((count, 3))
    return ForceTable(
        np.arange(count), time, np.array(["thumb"] * count, object), three * time[:, None], three, one, one, one
    )


def test_the_whole_report(pressed_panel: Callable[..., Any]) -> None:
    panel = pressed_panel(31, 21, 4)
    meshes = [FrameMesher(panel.outlines).mesh(frame) for frame in panel.frames]
    html = report_html(result(), forces(), meshes, panel.background, [ReportImage("The dent", PNG)])
    page = Page(html)
    for words in ("thumb press", "1 of 2 expectations hold", "between 0.05 and 0.2", "at most 4", "✓ holds", "✗ fails"):
        assert words in page.text
    for title in (
        "Force on the tool",
        "Depth",
        "Contact area",
        "Time per step",
        "Force [N]",
        "Depth [mm]",
        "Area [mm²]",
    ):
        assert title in page.text
    images = [attrs["src"] for tag, attrs in page.tags if tag == "img"]
    assert images == ["data:image/png;base64," + base64.b64encode(PNG).decode()]
    assert sum(tag == "canvas" for tag, _ in page.tags) == 1
    assert page.data is not None
    assert len(page.data["times"]) == 4


def test_nothing_is_fetched(pressed_panel: Callable[..., Any]) -> None:
    panel = pressed_panel(15, 11, 2)
    meshes = [FrameMesher().mesh(frame) for frame in panel.frames]
    html = report_html(result(), forces(), meshes, panel.background, [ReportImage("a", PNG)])
    assert not re.search(
        r"https?:|//[a-z]+\.[a-z]|@import|\burl\(|fetch\(|XMLHttpRequest|\bimport\s*\(|WebSocket", html
    )
    for tag, attrs in Page(html).tags:
        for name in ("src", "href", "action", "data", "poster", "srcset"):
            assert (attrs.get(name) or "data:").startswith("data:"), (tag, attrs)
    assert "default-src 'none'" in html


def test_names_cannot_break_out(pressed_panel: Callable[..., Any]) -> None:
    evil = "</script><script>alert(1)</script><b>\"'&"
    panel = pressed_panel(9, 7, 1)
    mesh = FrameMesher().mesh(panel.frames[0])
    fields = {name: getattr(mesh, name) for name in mesh.__slots__}
    mesh = type(mesh)(**{**fields, "bodies": (evil, evil)})
    html = report_html(
        result(
            scene=evil,
            warnings=(evil,),
            expectations=(Expectation("verdict", {"equals": evil}, evil, False, (evil, evil)),),
        ),
        None,
        [mesh],
        (),
        [ReportImage(evil, PNG)],
    )
    page = Page(html)
    assert sum(tag == "script" for tag, _ in page.tags) == 2
    assert sum(tag == "b" for tag, _ in page.tags) == 2  # the two ends of the colour scale
    assert page.data is not None
    assert page.data["meshes"][0]["name"] == evil


def test_a_report_of_nearly_nothing() -> None:
    page = Page(report_html(result(expectations=(), converged=False, timing=Timing(), outputs=(), summary=NOTHING)))
    assert "did not converge" in page.text
    assert not any(tag in ("canvas", "svg", "img", "script") for tag, _ in page.tags)


def test_from_a_runs_folder(tmp_path: Path, pressed_panel: Callable[..., Any]) -> None:
    panel = pressed_panel(21, 15, 3)
    with SeriesWriter(tmp_path, panel.outlines) as series:
        for frame in panel.frames:
            series.add(frame)
        series.add_part(panel.background)
    with ForcesWriter(tmp_path / "forces.csv", ["thumb"]) as writer:
        writer.add(StepRecord(0, 0.0, np.ones((1, 3)), np.ones((1, 3)), np.ones(1), np.ones(1), np.ones(1)))
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "dent.png").write_bytes(PNG)
    (tmp_path / "pictures" / "notes.txt").write_text("not a picture")
    write_result(tmp_path / "result.json", result())
    assert write_report(tmp_path) == tmp_path / "report.html"
    first = (tmp_path / "report.html").read_bytes()
    page = Page(first.decode())
    assert page.data is not None
    assert [mesh["kind"] for mesh in page.data["meshes"]] == ["patch", "tool", *["face"] * 5]
    assert "The dent from near" in page.text
    write_report(tmp_path)
    assert (tmp_path / "report.html").read_bytes() == first


def test_a_folder_without_a_result(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no result\.json"):
        write_report(tmp_path)


def decoded(packed: dict[str, Any], frame: int, low: Any, scale: float) -> tuple[Any, Any, Any]:
    """Points, shades and triangles as view.js makes them."""

    def array(text: str, kind: str) -> Any:
        return np.frombuffer(base64.b64decode(text), kind)

    steps = array(packed["rest"], "<u2").reshape(-1, 3).copy()
    shade = np.zeros(len(steps), np.uint8)
    moving = array(packed["moving"], "<u4")
    if packed["frames"]:
        steps[moving] = array(packed["frames"][frame], "<u2").reshape(-1, 3)
    if packed["colours"]:
        shade[moving] = array(packed["colours"][frame], "u1")
    assert packed["count"] == len(steps)
    return steps * scale + low, shade, array(packed["triangles"], "<u4").reshape(-1, 3)


def test_the_view_holds_the_frames(pressed_panel: Callable[..., Any]) -> None:
    panel = pressed_panel(31, 21, 5)
    meshes = [FrameMesher(panel.outlines).mesh(frame) for frame in panel.frames]
    data = view_data(meshes, panel.background, "mm")
    assert data is not None
    json.dumps(data, allow_nan=False)
    values = [np.abs(normal_displacement(mesh)) for mesh in meshes]
    assert data["top"] == max(value.max() for value in values)
    for number, packed in enumerate(data["meshes"][:2]):
        for n, mesh in enumerate(meshes):
            own = mesh.body == number
            points, shade, triangles = decoded(packed, n, np.array(data["low"]), data["scale"])
            assert np.abs(points - mesh.points[own]).max() <= 0.5001 * data["scale"]
            assert np.abs(shade / 255.0 * data["top"] - values[n][own]).max() <= 0.51 * data["top"] / 255.0
            corners, body = triangles_of(mesh)
            assert np.array_equal(triangles, corners[body == number] - np.flatnonzero(own)[0])
    assert data["scale"] == pytest.approx(120.0 / 65535, rel=0.3)


def test_large_meshes_are_thinned() -> None:
    n = 200
    x, y = np.meshgrid(np.linspace(0.0, 10.0, n), np.linspace(0.0, 10.0, n), indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=2).reshape(-1, 3)
    flat = np.arange(n * n).reshape(n, n)
    a, b, c, d = (q.reshape(-1) for q in (flat[:-1, :-1], flat[1:, :-1], flat[1:, 1:], flat[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    moved = (np.hypot(points[:, 0] - 5.0, points[:, 1] - 5.0) < 1.0).astype(float)
    kept, fewer = thinned(points, triangles, 5000, moved)
    assert 1000 < len(kept) <= 5000
    assert fewer.max() == len(kept) - 1
    p = points[kept][fewer]
    area = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum()
    assert area == pytest.approx(100.0, rel=0.01)
    assert moved[kept].mean() > 2.0 * moved.mean()  # finer where something moved
    edge = points[kept][np.unique(borders(fewer))]
    assert (np.minimum(edge, 10.0 - edge)[:, :2].min(axis=1) < 1e-9).mean() > 0.95  # the outline keeps its place
    same, all_of_them = thinned(points, triangles, n * n, None)
    assert np.array_equal(points[same][all_of_them], points[triangles])
    assert MOST_VERTICES > 1000


def test_a_plot_puts_points_where_the_axes_say() -> None:
    plot = line_plot("t", "x", "y", [("a", np.array([0.0, 10.0]), np.array([0.0, 5.0]))])
    assert plot is not None
    first, last = ([float(v) for v in pair.split(",")] for pair in plot.lines[0].paths[0].split())
    assert first == pytest.approx([LEFT, HEIGHT - BOTTOM], abs=0.1)
    assert last[0] == pytest.approx(WIDTH - RIGHT, abs=0.1)
    assert last[1] > TOP
    x_of, y_of = ({label: at for at, label in ticks} for ticks in (plot.x_ticks, plot.y_ticks))
    assert x_of["10"] == pytest.approx(last[0], abs=0.1)
    assert y_of["5"] == pytest.approx(last[1], abs=0.1)


def test_plots_keep_peaks_and_show_gaps() -> None:
    x = np.arange(100_000.0)
    y = np.zeros(100_000)
    y[54_321] = 7.0
    y[10_000:20_000] = np.nan
    plot = line_plot("t", "x", "y", [("a", x, y)])
    assert plot is not None
    points = [tuple(map(float, pair.split(","))) for path in plot.lines[0].paths for pair in path.split()]
    assert len(points) < 2000
    top = {label: at for at, label in plot.y_ticks}
    assert min(at for _, at in points) <= top["6"]
    assert line_plot("t", "x", "y", [("a", x, np.full_like(x, np.nan))]) is None
    assert line_plot("t", "x", "y", []) is None
    assert line_plot("t", "x", "y", [("a", np.array([1.0]), np.array([0.0]))]) is not None


def test_gaps_are_not_bridged() -> None:
    y = np.array([1.0, 2.0, np.nan, 3.0, 4.0])
    plot = line_plot("t", "x", "y", [("a", np.arange(5.0), y)])
    assert plot is not None
    assert len(plot.lines[0].paths) == 2


@pytest.mark.nightly  # the view draws a draft first, and a busy machine may be caught at it
def test_the_view_runs_in_a_browser(tmp_path: Path, pressed_panel: Callable[..., Any]) -> None:
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        pytest.skip("no Chromium here: view.js was not run")
    panel = pressed_panel(31, 21, 4)
    meshes = [FrameMesher(panel.outlines).mesh(frame) for frame in panel.frames]
    html = report_html(result(), forces(), meshes, panel.background)
    probe = """<script>
      const canvas = document.getElementById("canvas"), slider = document.getElementById("time");
      const data = () => canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
      const sums = [];
      const look = async () => {
        await new Promise((done) => setTimeout(done, 500));
        sums.push(data().reduce((a, b) => a + b, 0));
      };
      (async () => {
        await look();
        slider.value = "0";
        slider.dispatchEvent(new Event("input"));
        await look();
        canvas.dispatchEvent(new WheelEvent("wheel", { deltaY: -200, cancelable: true }));
        await look();
        canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft", cancelable: true }));
        await look();
        document.getElementById("reset").click();
        await look();
        document.title = "SUMS " + JSON.stringify(sums);
      })();
      addEventListener("error", (event) => { document.title = "FAULT " + event.message; });
    </script>"""
    (tmp_path / "report.html").write_text(html.replace("</body>", probe + "</body>"), encoding="utf-8")
    done = subprocess.run(
        [
            browser, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            f"--user-data-dir={tmp_path / 'profile'}", "--window-size=900,1200", "--virtual-time-budget=20000",
            "--enable-logging=stderr", "--dump-dom", (tmp_path / "report.html").as_uri(),
        ],
        capture_output=True, text=True, timeout=90, check=False,
    )  # fmt: skip
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line and "willReadFrequently" not in line]
    assert said == []  # the probe itself reads pixels back, which Chromium remarks on
    found = re.search(r"<title>(.*?)</title>", done.stdout)
    assert found is not None
    assert found[1].startswith("SUMS"), found[1]
    last, first, nearer, turned, reset = json.loads(found[1][5:])
    assert min(last, first, nearer, turned) > 0
    assert len({last, first, nearer, turned}) == 4
    assert reset == first  # the same view gives the same pixels
