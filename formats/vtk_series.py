"""The surface over time for ParaView: series.pvd, and one frames/*.vtp a frame (VTK XML PolyData).

A frame holds every patch and tool. Point data: displacement, pressure [Pa], contact, stress [Pa], and body; cell data:
body; field data: bodies (the names, by number), tool (1 for a tool), step, TimeValue [s]. Arrays are appended, zlib
compressed and base64 coded, in an order that never changes: the same frames give the same bytes. The writer is our own
because VTK's needs VTK at run time and does not say when the disk is full.
"""

from __future__ import annotations

import base64
import os
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..record import Frame
from .atomic import WholeFile, cannot_write, write_whole
from .frame_mesh import FaceMesh, FrameMesh, FrameMesher, Outlines

_TYPES: dict[str, np.dtype[Any]] = {
    "Float64": np.dtype("<f8"),
    "Float32": np.dtype("<f4"),
    "Int64": np.dtype("<i8"),
    "Int32": np.dtype("<i4"),
    "UInt8": np.dtype("u1"),
}
_TYPE_NAMES = {dtype.str: name for name, dtype in _TYPES.items()}
_BLOCK = 1 << 20
"""Bytes that are compressed together; VTK reads any size."""

_HEADER = (
    '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64" '
    'compressor="vtkZLibDataCompressor">'
)

Arrays = Mapping[str, NDArray[Any]]


class SeriesWriter:
    """Writes a series into a run's folder, one frame at a time.

    `outlines` gives the trim loops of patches in grid coordinates, where they are known (see frame_mesh). Every file is
    whole or absent; series.pvd lists the frames that are there when the writer is closed, also after an exception. A
    writer that goes on with an interrupted series takes its `entries` as `written`.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        outlines: Outlines | None = None,
        *,
        written: Sequence[tuple[float, str]] = (),
    ) -> None:
        self.folder = Path(folder)
        self.entries: list[tuple[float, str]] = list(written)
        """Time [s] and file of every frame so far."""
        self.files: list[str] = [name for _, name in written]
        """Everything written so far, relative to the folder, with forward slashes."""
        self._mesher = FrameMesher(outlines)
        self._encoder = _Encoder()
        self._closed = False
        try:
            (self.folder / "frames").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise cannot_write(self.folder / "frames", error) from error

    def add(self, frame: Frame) -> FrameMesh:
        """Write a frame; returns it as the mesh that was written. Raises InputError when the system refuses."""
        mesh = self._mesher.mesh(frame)
        name = f"frames/frame_{len(self.entries):06d}.vtp"
        write_frame(self.folder / name, mesh, self._encoder)
        self.entries.append((frame.time, name))
        self.files.append(name)
        return mesh

    def add_part(self, faces: Sequence[FaceMesh]) -> None:
        """Write the faces that are not sculpted, once, as frames/part.vtp: the background of pictures."""
        write_part(self.folder / "frames" / "part.vtp", faces)
        self.files.append("frames/part.vtp")

    def close(self) -> None:
        """Write series.pvd."""
        if self._closed:
            return
        self._closed = True
        lines = [f'    <DataSet timestep="{time!r}" part="0" file="{name}"/>' for time, name in self.entries]
        head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="1.0" byte_order="LittleEndian">\n'
        body = "\n".join(["  <Collection>", *lines, "  </Collection>"])
        write_whole(self.folder / "series.pvd", f"{head}{body}\n</VTKFile>\n")
        self.files.append("series.pvd")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except InputError:
            if kind is None:
                raise


def write_frame(path: str | os.PathLike[str], mesh: FrameMesh, encoder: _Encoder | None = None) -> None:
    """Write one frame as .vtp, whole or not at all."""
    points: dict[str, NDArray[Any]] = {
        "displacement": mesh.displacement,
        "pressure": mesh.pressure,
        "contact": mesh.contact.astype(np.uint8),
        "stress": mesh.stress,
        "body": mesh.body.astype(np.int32),
    }
    field: dict[str, NDArray[Any] | tuple[str, ...]] = {
        "TimeValue": np.array([mesh.time]),
        "step": np.array([mesh.step], np.int64),
        "bodies": mesh.bodies,
        "tool": mesh.tool.astype(np.uint8),
    }
    cells = {"body": mesh.cell_body.astype(np.int32)}
    _write_polydata(
        Path(path), mesh.points, mesh.connectivity, mesh.offsets, points, cells, field, encoder or _Encoder()
    )


def write_part(path: str | os.PathLike[str], faces: Sequence[FaceMesh]) -> None:
    """Write triangle meshes as one .vtp with a `body` cell array and their names, whole or not at all."""
    sizes = [len(face.points) for face in faces]
    first = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    counts = [len(face.triangles) for face in faces]
    corners = [face.triangles.reshape(-1) + start for face, start in zip(faces, first, strict=False)]
    _write_polydata(
        Path(path),
        np.concatenate([np.zeros((0, 3)), *(face.points for face in faces)]),
        np.concatenate([np.zeros(0, np.int64), *corners]),
        np.arange(0, 3 * sum(counts) + 1, 3),
        point_data={},
        cell_data={"body": np.repeat(np.arange(len(faces)), counts).astype(np.int32)},
        field_data={"bodies": tuple(face.name for face in faces)},
        encoder=_Encoder(),
    )


def read_series(path: str | os.PathLike[str]) -> list[tuple[float, Path]]:
    """The times [s] and frame files of a series.pvd. Raises InputError when it is not one."""
    path = Path(path)
    root = _parsed(path, "Collection")
    try:
        return [(float(e.attrib["timestep"]), path.parent / e.attrib["file"]) for e in root.iter("DataSet")]
    except (KeyError, ValueError) as error:
        raise InputError("not a series of frames", where=str(path), mend="run the scene again") from error


def read_frame(path: str | os.PathLike[str]) -> FrameMesh:
    """A frame as `write_frame` wrote it. Raises InputError when the file is not such a frame."""
    path = Path(path)
    arrays = _read_polydata(path)
    try:
        return FrameMesh(
            step=int(arrays["step"][0]),
            time=float(arrays["TimeValue"][0]),
            bodies=tuple(arrays["bodies"].tolist()),
            tool=arrays["tool"].astype(np.bool_),
            points=arrays["Points"].reshape(-1, 3),
            body=arrays["body of point"].astype(np.int64),
            displacement=arrays["displacement"].reshape(-1, 3),
            pressure=arrays["pressure"],
            contact=arrays["contact"].astype(np.bool_),
            stress=arrays["stress"],
            connectivity=arrays["connectivity"].astype(np.int64),
            offsets=np.concatenate([[0], arrays["offsets"]]).astype(np.int64),
            cell_body=arrays["body"].astype(np.int64),
        )
    except KeyError as error:
        raise InputError(f"not a frame of cadsculpt: no array {error.args[0]}", where=str(path)) from error


def read_part(path: str | os.PathLike[str]) -> list[FaceMesh]:
    """The faces that `write_part` wrote. Raises InputError when the file is not such a part."""
    path = Path(path)
    arrays = _read_polydata(path)
    try:
        triangles = arrays["connectivity"].astype(np.int64).reshape(-1, 3)
        points = arrays["Points"].reshape(-1, 3)
        faces = []
        for number, name in enumerate(arrays["bodies"].tolist()):
            own = triangles[arrays["body"] == number]
            used, corners = np.unique(own, return_inverse=True)
            faces.append(FaceMesh(name, points[used], corners.reshape(-1, 3).astype(np.int64)))
        return faces
    except (KeyError, ValueError) as error:
        raise InputError("not a part of cadsculpt", where=str(path)) from error


class _Encoder:
    """Encodes arrays; one that has not changed since the last file is not compressed again."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[bytes, bytes]] = {}

    def encode(self, key: str, raw: bytes) -> bytes:
        """VTK's compressed block layout: base64(header) + base64(blocks)."""
        known = self._last.get(key)
        if known is not None and known[0] == raw:
            return known[1]
        blocks = [zlib.compress(raw[start : start + _BLOCK], 1) for start in range(0, len(raw), _BLOCK)]
        header = np.array([len(blocks), _BLOCK, len(raw) % _BLOCK, *map(len, blocks)], "<u8")
        coded = base64.b64encode(header.tobytes()) + base64.b64encode(b"".join(blocks))
        self._last[key] = (raw, coded)
        return coded


def _write_polydata(
    path: Path,
    points: NDArray[np.float64],
    connectivity: NDArray[np.int64],
    offsets: NDArray[np.int64],
    point_data: Arrays,
    cell_data: Arrays,
    field_data: Mapping[str, NDArray[Any] | tuple[str, ...]],
    encoder: _Encoder,
) -> None:
    chunks: list[bytes] = []
    size = 0

    def array(section: str, name: str, values: NDArray[Any] | tuple[str, ...], tuples: bool = False) -> str:
        nonlocal size
        if isinstance(values, tuple):
            kind, extra, tag = "String", f' NumberOfTuples="{len(values)}"', "Array"
            raw = b"".join(text.encode() + b"\0" for text in values)
        else:
            little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
            kind, tag, raw = _TYPE_NAMES[little.dtype.str], "DataArray", little.tobytes()
            extra = f' NumberOfComponents="{values.shape[1]}"' if values.ndim > 1 else ""
            extra += f' NumberOfTuples="{len(values)}"' if tuples else ""
        coded = encoder.encode(f"{section}/{name}", raw)
        chunks.append(coded)
        at, size = size, size + len(coded)
        return f'<{tag} type="{kind}" Name={quoteattr(name)}{extra} format="appended" offset="{at}"/>'

    cells = len(offsets) - 1
    lines = ['<?xml version="1.0"?>', _HEADER, "<PolyData>", "<FieldData>"]
    lines += [array("field", name, values, tuples=True) for name, values in field_data.items()]
    counts = f'NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="{cells}"'
    lines += ["</FieldData>", f'<Piece NumberOfPoints="{len(points)}" {counts}>']
    lines += ['<PointData Vectors="displacement">' if "displacement" in point_data else "<PointData>"]
    lines += [array("point", name, values) for name, values in point_data.items()]
    lines += ["</PointData>", "<CellData>"]
    lines += [array("cell", name, values) for name, values in cell_data.items()]
    lines += ["</CellData>", "<Points>", array("points", "Points", points), "</Points>", "<Polys>"]
    lines += [array("polys", "connectivity", connectivity.astype(np.int32))]
    lines += [array("polys", "offsets", offsets[1:].astype(np.int32)), "</Polys>", "</Piece>", "</PolyData>"]
    with WholeFile(path) as file:
        file.write("\n".join([*lines, '<AppendedData encoding="base64">', "_"]))
        for chunk in chunks:
            file.write(chunk)
        file.write("\n</AppendedData>\n</VTKFile>\n")


def _parsed(path: Path, kind: str) -> ElementTree.Element:
    try:
        root = ElementTree.parse(path).getroot()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", where=str(path)) from error
    except ElementTree.ParseError as error:
        raise InputError(f"not a VTK XML file: {error}", where=str(path), mend="run the scene again") from error
    if root.tag != "VTKFile" or root.get("type") != kind:
        raise InputError(f"not a VTK {kind} file", where=str(path), mend="name a file of a run's folder")
    return root


def _read_polydata(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays by name as this module writes them; the point array `body` is called "body of point"."""
    root = _parsed(path, "PolyData")
    arrays: dict[str, NDArray[Any]] = {}
    try:
        data = (root.findtext("AppendedData") or "").strip()[1:]
        for section in ("FieldData", "PointData", "CellData", "Points", "Polys"):
            for element in next(root.iter(section)):
                raw = _decoded(data, int(element.attrib["offset"]))
                name = element.attrib["Name"]
                if element.attrib["type"] == "String":
                    values = np.array([text.decode() for text in raw.split(b"\0")[:-1]], object)
                else:
                    values = np.frombuffer(raw, _TYPES[element.attrib["type"]])
                arrays["body of point" if (section, name) == ("PointData", "body") else name] = values
    except (StopIteration, KeyError, ValueError, IndexError, zlib.error) as error:
        raise InputError("a damaged frame", where=str(path), mend="run the scene again") from error
    return arrays


def _decoded(data: str, at: int) -> bytes:
    (count,) = np.frombuffer(base64.b64decode(data[at : at + 12])[:8], "<u8")
    header_size = 8 * (3 + int(count))
    coded = 4 * ((header_size + 2) // 3)
    sizes = np.frombuffer(base64.b64decode(data[at : at + coded])[:header_size], "<u8")[3:]
    start = at + coded
    blocks = base64.b64decode(data[start : start + 4 * ((int(sizes.sum()) + 2) // 3)])
    ends = np.cumsum(sizes).tolist()
    return b"".join(zlib.decompress(blocks[e - int(s) : e]) for e, s in zip(ends, sizes, strict=True))
