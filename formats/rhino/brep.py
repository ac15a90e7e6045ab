"""openNURBS' boundary representation (ON_Brep), read from an archive, changed in places, and written back.

Only what is changed is written anew: curves, surfaces and meshes that stay are kept as the bytes they were, so that a
Brep that nobody touched is written back byte for byte. Layout after the public openNURBS sources
(opennurbs_brep_io.cpp).
"""

from __future__ import annotations

import struct
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from .archive import ANONYMOUS, BREP, CLASS_DATA, Reader, Writer, class_chunk, class_record

Array = NDArray[np.float64]
R = TypeVar("R")

OUTER_LOOP, INNER_LOOP = 1, 2
BOUNDARY, MATED, SEAM, SINGULAR = 1, 2, 3, 4
"""ON_BrepTrim::TYPE of a trim on an edge of one face, of several, on both sides of a closed surface, and at a pole."""
BOUNDARY_ISO = (3, 4, 5, 6)
"""ON_Surface::ISO: the trim lies on the west, south, east or north side of the surface's domain."""


@dataclass(frozen=True, slots=True)
class Vertex:
    index: int
    point: tuple[float, float, float]
    edges: tuple[int, ...]
    tolerance: float


@dataclass(frozen=True, slots=True)
class Edge:
    """curve3 is the place in `Brep.curves3`; the edge runs over `proxy` of that curve, backwards when `backward`."""

    index: int
    curve3: int
    backward: int
    proxy: tuple[float, float]
    vertices: tuple[int, int]
    trims: tuple[int, ...]
    tolerance: float
    domain: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Trim:
    """curve2 is the place in `Brep.curves2`; the trim runs over `proxy` of it, backwards when `backward`.

    `reversed` tells that the loop runs against the edge there. `rest` are the bytes after the tolerances: the trim's
    own domain and direction (archives since June 2002) and tolerances of older versions.
    """

    index: int
    curve2: int
    proxy: tuple[float, float]
    edge: int
    vertices: tuple[int, int]
    reversed: int
    kind: int
    iso: int
    loop: int
    tolerance: tuple[float, float]
    rest: bytes

    @property
    def backward(self) -> bool:
        return self.rest[16] == 1


@dataclass(frozen=True, slots=True)
class Loop:
    index: int
    trims: tuple[int, ...]
    kind: int
    face: int


@dataclass(frozen=True, slots=True)
class BrepFace:
    index: int
    loops: tuple[int, ...]
    surface: int
    reversed: int
    material: int


@dataclass(frozen=True, slots=True)
class Brep:
    """An ON_Brep. curves2, curves3, surfaces and the meshes hold whole TCODE_OPENNURBS_CLASS chunks, or None.

    `version` is the archive's, `minor` the Brep chunk's 3.minor. box is the bounding box (6,). `faces_rest` are the
    bytes after the faces' records (identities, colours), `solid` the solid flag and `region` the region topology, as
    they were.
    """

    version: int
    minor: int
    curves2: tuple[bytes | None, ...]
    curves3: tuple[bytes | None, ...]
    surfaces: tuple[bytes | None, ...]
    vertices: tuple[Vertex, ...]
    edges: tuple[Edge, ...]
    trims: tuple[Trim, ...]
    loops: tuple[Loop, ...]
    faces: tuple[BrepFace, ...]
    faces_minor: int
    faces_rest: bytes
    box: tuple[float, ...]
    render_meshes: tuple[bytes | None, ...]
    analysis_meshes: tuple[bytes | None, ...]
    solid: bytes
    region: bytes


# ---------------------------------------------------------------------- reading


def read_brep(data: bytes, position: int, end: int, version: int) -> Brep:
    """The Brep whose TCODE_OPENNURBS_CLASS chunk starts at `position`.

    Raises InputError when it is not one of chunk version 3, which is every Brep written since Rhino 3.
    """
    record = class_record(data, position, end, version)
    if data[record.data.body] >> 4 != 3:
        raise InputError("a Brep of an old or unknown layout")
    with_domains = version >= 3
    try:
        return _read(data, record.data.body, record.data.end - 4, version, with_domains)
    except (InputError, struct.error):
        if not with_domains:
            raise
        return _read(data, record.data.body, record.data.end - 4, version, False)


def _read(data: bytes, position: int, end: int, version: int, with_domains: bool) -> Brep:
    """`with_domains`: edges carry their own domain (archives since June 2002)."""
    reader = Reader(data, position, end, version)
    minor = reader.byte() & 15
    curves2, curves3, surfaces = _objects(reader), _objects(reader), _objects(reader)
    vertices, _, _ = _records(reader, _vertex)
    edges, _, _ = _records(reader, _edge if with_domains else _short_edge)
    trims, _, _ = _records(reader, _trim)
    loops, _, _ = _records(reader, _loop)
    faces, faces_minor, faces_rest = _records(reader, _face, rest_allowed=True)
    box = tuple(reader.reals(6).tolist())
    render, analysis = (_meshes(reader, len(faces)) if minor >= 1 else (None,) * len(faces) for _ in range(2))
    solid = reader.raw(4) if minor >= 2 else b""
    region = reader.raw(reader.end - reader.position)
    return Brep(
        version=version,
        minor=minor,
        curves2=curves2,
        curves3=curves3,
        surfaces=surfaces,
        vertices=vertices,
        edges=edges,
        trims=trims,
        loops=loops,
        faces=faces,
        faces_minor=faces_minor,
        faces_rest=faces_rest,
        box=box,
        render_meshes=render,
        analysis_meshes=analysis,
        solid=solid,
        region=region,
    )


def _anonymous(reader: Reader) -> Reader:
    chunk = reader.chunk()
    if chunk.typecode != ANONYMOUS:
        raise InputError("a part of a Brep does not start where it should", mend="the file is damaged")
    return reader.inside(chunk)


def _objects(reader: Reader) -> tuple[bytes | None, ...]:
    """A curve or surface array."""
    inner = _anonymous(reader)
    if inner.byte() != 0x10:
        raise InputError("a Brep with an unknown kind of array")
    found: list[bytes | None] = []
    for _ in range(inner.integer()):
        if inner.integer():
            chunk = inner.chunk()
            found.append(inner.data[chunk.start : chunk.end])
        else:
            found.append(None)
    return tuple(found)


def _records(
    reader: Reader, read: Callable[[Reader], R], rest_allowed: bool = False
) -> tuple[tuple[R, ...], int, bytes]:
    """The records of a topology array, its minor version, and the bytes after the records."""
    inner = _anonymous(reader)
    layout = inner.byte()
    if layout >> 4 != 1:
        raise InputError("a Brep with an unknown kind of array")
    found = tuple(read(inner) for _ in range(inner.integer()))
    rest = inner.raw(inner.end - inner.position)
    if rest and not rest_allowed:
        raise InputError("a Brep's records are longer than they should be")
    return found, layout & 15, rest


def _meshes(reader: Reader, count: int) -> tuple[bytes | None, ...]:
    inner = _anonymous(reader)
    found: list[bytes | None] = []
    for _ in range(count):
        if inner.byte():
            chunk = inner.chunk()
            found.append(inner.data[chunk.start : chunk.end])
        else:
            found.append(None)
    return tuple(found)


def _pair(reader: Reader) -> tuple[float, float]:
    a, b = reader.reals(2).tolist()
    return a, b


def _two(reader: Reader) -> tuple[int, int]:
    a, b = reader.integers(2)
    return a, b


def _vertex(reader: Reader) -> Vertex:
    index = reader.integer()
    x, y, z = reader.reals(3).tolist()
    return Vertex(index, (x, y, z), reader.array(), float(reader.reals(1)[0]))


def _short_edge(reader: Reader) -> Edge:
    index, curve, backward = reader.integers(3)
    proxy = _pair(reader)
    vertices = _two(reader)
    return Edge(index, curve, backward, proxy, vertices, reader.array(), float(reader.reals(1)[0]), None)


def _edge(reader: Reader) -> Edge:
    edge = _short_edge(reader)
    return replace(edge, domain=_pair(reader))


def _trim(reader: Reader) -> Trim:
    index, curve = reader.integers(2)
    proxy = _pair(reader)
    edge = reader.integer()
    vertices = _two(reader)
    turned, kind, iso, loop = reader.integers(4)
    tolerance = _pair(reader)
    return Trim(index, curve, proxy, edge, vertices, turned, kind, iso, loop, tolerance, reader.raw(64))


def _loop(reader: Reader) -> Loop:
    index = reader.integer()
    trims = reader.array()
    kind, face = reader.integers(2)
    return Loop(index, trims, kind, face)


def _face(reader: Reader) -> BrepFace:
    index = reader.integer()
    loops = reader.array()
    surface, turned, material = reader.integers(3)
    return BrepFace(index, loops, surface, turned, material)


# ---------------------------------------------------------------------- writing


def brep_chunk(brep: Brep, after: bytes = b"", class_id: uuid.UUID = BREP) -> bytes:
    """The TCODE_OPENNURBS_CLASS chunk of a Brep; `after` are the chunks behind its data, user data for instance.

    Files of Rhino 3 to 5 name the class by older ids of the same layout.
    """
    writer = Writer(brep.version)
    writer.begin(CLASS_DATA)
    writer.raw(bytes([0x30 | brep.minor]))
    for array in (brep.curves2, brep.curves3, brep.surfaces):
        writer.begin(ANONYMOUS)
        writer.raw(b"\x10")
        writer.integers(len(array))
        for item in array:
            writer.integers(int(item is not None))
            if item is not None:
                writer.whole(item)
        writer.end()
    _write_records(writer, brep.vertices, _write_vertex)
    _write_records(writer, brep.edges, _write_edge)
    _write_records(writer, brep.trims, _write_trim)
    _write_records(writer, brep.loops, _write_loop)
    writer.begin(ANONYMOUS)
    writer.raw(bytes([0x10 | brep.faces_minor]))
    writer.integers(len(brep.faces))
    for face in brep.faces:
        writer.integers(face.index)
        writer.array(face.loops)
        writer.integers(face.surface, face.reversed, face.material)
    writer.raw(brep.faces_rest)
    writer.end()
    writer.reals(np.array(brep.box))
    if brep.minor >= 1:
        for meshes in (brep.render_meshes, brep.analysis_meshes):
            writer.begin(ANONYMOUS)
            for mesh in meshes:
                writer.raw(b"\x00" if mesh is None else b"\x01")
                if mesh is not None:
                    writer.whole(mesh)
            writer.end()
    writer.raw(brep.solid)
    if brep.region:
        writer.whole(brep.region)
    writer.end()
    return class_chunk(class_id, writer, after)


def _write_records(writer: Writer, records: Sequence[R], write: Callable[[Writer, R], None]) -> None:
    writer.begin(ANONYMOUS)
    writer.raw(b"\x10")
    writer.integers(len(records))
    for record in records:
        write(writer, record)
    writer.end()


def _write_vertex(writer: Writer, vertex: Vertex) -> None:
    writer.integers(vertex.index)
    writer.reals(np.array(vertex.point))
    writer.array(vertex.edges)
    writer.reals(np.array([vertex.tolerance]))


def _write_edge(writer: Writer, edge: Edge) -> None:
    writer.integers(edge.index, edge.curve3, edge.backward)
    writer.reals(np.array(edge.proxy))
    writer.integers(*edge.vertices)
    writer.array(edge.trims)
    writer.reals(np.array([edge.tolerance]))
    if edge.domain is not None:
        writer.reals(np.array(edge.domain))


def _write_trim(writer: Writer, trim: Trim) -> None:
    writer.integers(trim.index, trim.curve2)
    writer.reals(np.array(trim.proxy))
    writer.integers(trim.edge, *trim.vertices, trim.reversed, trim.kind, trim.iso, trim.loop)
    writer.reals(np.array(trim.tolerance))
    writer.raw(trim.rest)


def _write_loop(writer: Writer, loop: Loop) -> None:
    writer.integers(loop.index)
    writer.array(loop.trims)
    writer.integers(loop.kind, loop.face)
