"""The child process of pictures.py: reads a job, draws with VTK through pyvista, writes 0.png, 1.gif, ... beside it."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .axis import round_ticks, tick_label

Array = NDArray[Any]

FACE = "#c4cad3"
TOOL = "#2f6fb3"
EDGE = "#39424e"
INK = "#1f2933"
CONTACT = "#d1382b"
SCALE = ("#dde1e6", "#fde3a7", "#f9a64a", "#e4572e", "#b3142f", "#5c0a33")
"""From not moved to most: the grey of the part, then darker and redder, so that it also reads in black and white."""


def colour_scale(count: int = 256) -> Array:
    """(count, 3) uint8, interpolated between the colours of SCALE."""
    stops = np.array([_rgb(colour) for colour in SCALE], np.float64)
    at = np.linspace(0.0, len(stops) - 1.0, count)
    channels = [np.interp(at, np.arange(len(stops)), stop) for stop in stops.T]
    return np.stack(channels, axis=1).round().astype(np.uint8)


def main(path: Path) -> None:
    """Draw everything that the job asks for."""
    import pyvista

    pyvista.OFF_SCREEN = True
    with np.load(path) as data:
        arrays = dict(data.items())
    job = json.loads(arrays["job"].tobytes())
    for number, order in enumerate(job["orders"]):
        target = path.with_name(f"{number}{'.gif' if order['film'] else '.png'}")
        drawing = _Drawing(pyvista, arrays, job, order)
        try:
            shots = [_finished(drawing.shot(n), order, job["times"][str(n)]) for n in order["frames"]]
            if order["film"]:
                _save_film(shots, target, order["frames_per_second"])
            else:
                shots[0].save(target)
        finally:
            drawing.plotter.close()


class _Drawing:
    """A plotter with the part in it, whose patches and tools follow the frames.

    Everything is drawn twice as large as asked for, and shrunk: that smooths edges with every driver.
    """

    def __init__(self, pyvista: Any, arrays: dict[str, Array], job: dict[str, Any], order: dict[str, Any]) -> None:
        self.pyvista, self.arrays, self.order = pyvista, arrays, order
        self.tools = job["tools"] if order["tools"] else 0
        self.plotter = pyvista.Plotter(off_screen=True, window_size=[2 * n for n in order["size"]], lighting="none")
        self.plotter.set_background("white")
        self._light()
        part = self._surface(arrays["part_points"], arrays["part_triangles"])
        if part is not None:
            self.plotter.add_mesh(part, color=FACE, render=False, **_MATERIAL)
            self._edges("part", arrays["part_points"], arrays["part_edges"])
        camera = order["camera"]
        self.plotter.camera_position = [camera["position"], camera["focus"], camera["up"]]
        self.plotter.camera.view_angle = camera["angle"]

    def shot(self, frame: int) -> Array:
        """Draw one frame; pixels (2 height, 2 width, 3)."""
        order, arrays = self.order, self.arrays
        points = arrays[f"points{frame}"]
        patch = self._surface(points, arrays[f"patch{frame}"])
        if patch is not None:
            patch.point_data["value"] = arrays[f"{order['what']}{frame}"][patch.point_data["used"]]
            self._patch(patch)
            self._edges("patch", points, arrays[f"edges{frame}"])
        for number in range(self.tools):
            name = f"tool{number}"
            tool = self._surface(points, arrays.get(f"tool{frame}_{number}", np.zeros((0, 3), np.int64)))
            if tool is None:
                self.plotter.remove_actor(name, render=False)
            else:
                self.plotter.add_mesh(
                    tool, name=name, color=TOOL, opacity=0.4, culling="back", render=False, **_MATERIAL
                )
        self.plotter.renderer.ResetCameraClippingRange()
        self.plotter.render_window.Render()  # pyvista renders by itself for the first screenshot only
        return np.asarray(self.plotter.screenshot(None, return_img=True))

    def _patch(self, patch: Any) -> None:
        flags = self.order["what"] == "contact"
        colours = np.array([_rgb(SCALE[0]), _rgb(CONTACT)], np.uint8) if flags else colour_scale()
        table = self.pyvista.LookupTable(values=np.column_stack([colours, np.full(len(colours), 255, np.uint8)]))
        table.scalar_range = (0.0, self.order["top"])
        self.plotter.add_mesh(
            patch,
            name="patch",
            scalars="value",
            cmap=table,
            clim=(0.0, self.order["top"]),
            interpolate_before_map=True,
            show_scalar_bar=False,
            render=False,
            **_MATERIAL,
        )

    def _surface(self, points: Array, triangles: Array) -> Any:
        if not len(triangles):
            return None
        used, corners = np.unique(triangles, return_inverse=True)
        mesh = self.pyvista.PolyData.from_regular_faces(points[used], corners.reshape(-1, 3))
        mesh.point_data["used"] = used
        return mesh.compute_normals(cell_normals=False, consistent_normals=True, split_vertices=False)

    def _edges(self, name: str, points: Array, edges: Array) -> None:
        if not len(edges):
            return
        lines = np.column_stack([np.full(len(edges), 2), edges]).reshape(-1)
        mesh = self.pyvista.PolyData(points, lines=lines)
        self.plotter.add_mesh(mesh, name=f"{name} edges", color=EDGE, line_width=2.5, lighting=False, render=False)

    def _light(self) -> None:
        # a key light low from the left, that shows dents by their shading; a soft fill; and a little from behind
        for position, intensity in (((-1.3, 1.3, 0.8), 0.82), ((0.5, -0.9, 1.1), 0.6), ((0.6, 1.4, -0.4), 0.16)):
            light = self.pyvista.Light(position=position, intensity=intensity, light_type="camera light")
            self.plotter.add_light(light)


_MATERIAL = {"ambient": 0.27, "diffuse": 0.9, "specular": 0.15, "specular_power": 20.0, "smooth_shading": True}


def _rgb(colour: str) -> list[int]:
    return [int(colour[i : i + 2], 16) for i in (1, 3, 5)]


def _finished(pixels: Array, order: dict[str, Any], time: float) -> Any:
    """The shot shrunk to its size, with title, time and scale written on it."""
    from PIL import Image, ImageDraw, ImageFont

    width, height = order["size"]
    image = Image.fromarray(pixels).resize((width, height), Image.Resampling.BOX).convert("RGBA")
    layer = Image.new("RGBA", image.size, (255, 255, 255, 0))
    pen = ImageDraw.Draw(layer)
    font_size = max(10.0, height / 42)
    font = ImageFont.load_default(font_size)
    margin = height // 40
    text = f"{order['title']}  t = {time:.3f} s".strip() if order["film"] else order["title"]
    pen.text((margin, margin), text, INK, font)
    if not order["bar"]:
        return Image.alpha_composite(image, layer).convert("RGB")
    length, thick = round(0.36 * width), max(8, height // 50)
    x, y = (width - length) // 2, round(0.935 * height)
    above = round(1.5 * font_size)
    frame = (x - 2 * margin, y - above - margin // 2, x + length + 2 * margin, height - margin // 4)
    pen.rounded_rectangle(frame, margin, (255, 255, 255, 215))
    if order["what"] == "contact":
        for start, colour, name in ((x + length // 6, SCALE[0], "free"), (x + length // 2, CONTACT, "in contact")):
            pen.rectangle((start, y, start + 2 * thick, y + thick), colour, EDGE)
            pen.text((start + 2 * thick + margin // 2, y + thick / 2), name, INK, font, anchor="lm")
    else:
        for column, colour in enumerate(colour_scale(length)):
            pen.line((x + column, y, x + column, y + thick), (*colour.tolist(), 255))
        pen.rectangle((x, y, x + length, y + thick), None, EDGE)
        pen.text((width / 2, y - above / 2), order["bar"], INK, font, anchor="mm")
        for value in round_ticks(0.0, order["top"]):
            at = x + round(value / order["top"] * length)
            pen.line((at, y + thick, at, y + thick + thick // 3), EDGE)
            pen.text((at, y + 1.5 * thick), tick_label(value), INK, font, anchor="mt")
    return Image.alpha_composite(image, layer).convert("RGB")


def _save_film(images: list[Any], target: Path, frames_per_second: float) -> None:
    from PIL import Image

    palette = images[-1].quantize(colors=255, method=Image.Quantize.MEDIANCUT)
    indexed = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    step = max(20, round(1000.0 / frames_per_second))
    durations = [step] * (len(indexed) - 1) + [1200]
    indexed[0].save(target, save_all=True, append_images=indexed[1:], duration=durations, loop=0, optimize=False)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
