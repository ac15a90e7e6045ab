"""The chunks of a 3DM archive: reading them, writing them, and changing one object of a file and nothing else.

A 3DM file is a 32-byte header with the archive version, then a tree of chunks: a typecode, a length (4 bytes up to
version 4, 8 bytes from version 50 on), a body, and, where the typecode says so, a CRC-32 of those bytes of the body
that stand in no chunk inside it. A typecode with the top bit set carries a value in place of a length and has no body.
Layout after the public openNURBS sources (opennurbs_3dm.h, opennurbs_archive.cpp).
"""

from __future__ import annotations

import struct
import uuid
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError

Array = NDArray[np.float64]

HEADER = b"3D Geometry File Format "
HEADER_SIZE = 32
BUFFER_VERSION = 60
"""Version of the archives in which rhino3dm encodes a single object."""

SHORT = 0x80000000
CRC = 0x8000
TABLE = 0x10000000
ANONYMOUS = 0x40008000
OBJECT_TABLE = 0x10000013
OBJECT_RECORD = 0x20008070
OBJECT_TYPE = 0x82000071
OBJECT_ATTRIBUTES = 0x02008072
CLASS = 0x00027FFA
CLASS_UUID = 0x0002FFFB
CLASS_DATA = 0x0002FFFC
CLASS_END = 0x80027FFF
END_OF_FILE = 0x00007FFF

BREP = uuid.UUID("60B5DBC5-E660-11d3-BFE4-0010830122F0")
BREP_OBJECT_TYPE = 0x10
SURFACE_OBJECT_TYPE = 0x8
EXTRUSION_OBJECT_TYPE = 0x40000000


@dataclass(frozen=True, slots=True)
class Chunk:
    """One chunk of `data`: its header at `start`, its body from `body` to `end` (with the CRC, when it has one)."""

    typecode: int
    value: int
    start: int
    body: int
    end: int


def length_size(version: int) -> int:
    """Bytes of a chunk's length in archives of this version."""
    return 4 if version < 50 else 8


def chunk_at(data: bytes, position: int, end: int, version: int) -> Chunk:
    """The chunk that starts at `position`. Raises InputError when it does not fit before `end`."""
    size = length_size(version)
    body = position + 4 + size
    if body > end:
        raise InputError(f"the data breaks off at byte {position}", mend="the file is damaged or cut short")
    (typecode,) = struct.unpack_from("<I", data, position)
    (value,) = struct.unpack_from("<i" if size == 4 else "<q", data, position + 4)
    if typecode & SHORT or (typecode == 0 and version == 1):
        return Chunk(typecode, value, position, body, body)
    if value < 0 or body + value > end:
        raise InputError(
            f"the data at byte {position} should be {value} bytes long and does not fit",
            mend="the file is damaged or cut short",
        )
    return Chunk(typecode, value, position, body, body + value)


def chunks(data: bytes, position: int, end: int, version: int) -> Iterator[Chunk]:
    """The chunks that lie side by side in data[position:end]."""
    while position < end:
        chunk = chunk_at(data, position, end, version)
        yield chunk
        position = chunk.end


def archive_version(data: bytes) -> int:
    """The archive version in a file's header. Raises InputError when these bytes are no 3DM file."""
    if data[: len(HEADER)] != HEADER:
        raise InputError("this is no 3DM file", mend="a 3DM file starts with '3D Geometry File Format'")
    try:
        return int(data[len(HEADER) : HEADER_SIZE])
    except ValueError:
        raise InputError("the 3DM header names no version", mend="the file is damaged") from None


# --------------------------------------------------------------------- writer


class Writer:
    """Builds chunks: `begin` and `end` nest, `raw` adds bytes of the open chunk, `whole` a finished chunk inside it."""

    def __init__(self, version: int) -> None:
        self.version = version
        self._open: list[tuple[int, bytearray, int]] = [(0, bytearray(), 0)]

    def begin(self, typecode: int) -> None:
        self._open.append((typecode, bytearray(), 0))

    def end(self) -> None:
        typecode, body, crc = self._open.pop()
        if typecode & CRC:
            body += struct.pack("<I", crc)
        self.whole(struct.pack("<I", typecode) + self._length(len(body)) + bytes(body))

    def short(self, typecode: int, value: int = 0) -> None:
        self.whole(struct.pack("<I", typecode) + self._length(value))

    def raw(self, data: bytes) -> None:
        typecode, body, crc = self._open[-1]
        self._open[-1] = (typecode, body + data, zlib.crc32(data, crc))

    def whole(self, chunk: bytes) -> None:
        typecode, body, crc = self._open[-1]
        self._open[-1] = (typecode, body + chunk, crc)

    def integers(self, *values: int) -> None:
        self.raw(struct.pack(f"<{len(values)}i", *values))

    def reals(self, values: Array) -> None:
        self.raw(np.ascontiguousarray(values, dtype="<f8").tobytes())

    def array(self, values: tuple[int, ...]) -> None:
        self.integers(len(values), *values)

    def finished(self) -> bytes:
        """The chunks written so far, all ended."""
        return bytes(self._open[-1][1])

    def _length(self, value: int) -> bytes:
        return struct.pack("<i" if length_size(self.version) == 4 else "<q", value)


class Reader:
    """Reads values one after the other from data[position:end]. Raises InputError when they run out."""

    def __init__(self, data: bytes, position: int, end: int, version: int) -> None:
        self.data, self.position, self.end, self.version = data, position, end, version

    def raw(self, count: int) -> bytes:
        if count < 0 or self.position + count > self.end:
            raise InputError("an object of the archive is shorter than it says", mend="the file is damaged")
        self.position += count
        return self.data[self.position - count : self.position]

    def byte(self) -> int:
        return self.raw(1)[0]

    def integer(self) -> int:
        return int.from_bytes(self.raw(4), "little", signed=True)

    def integers(self, count: int) -> tuple[int, ...]:
        return struct.unpack(f"<{count}i", self.raw(4 * count))

    def array(self) -> tuple[int, ...]:
        return self.integers(self.integer())

    def reals(self, count: int) -> Array:
        return np.frombuffer(self.raw(8 * count), dtype="<f8").astype(np.float64)

    def chunk(self) -> Chunk:
        chunk = chunk_at(self.data, self.position, self.end, self.version)
        self.position = chunk.end
        return chunk

    def inside(self, chunk: Chunk) -> Reader:
        """A reader of that chunk's body without its CRC."""
        return Reader(self.data, chunk.body, chunk.end - (4 if chunk.typecode & CRC else 0), self.version)


# --------------------------------------------------------------------- objects


@dataclass(frozen=True, slots=True)
class ClassRecord:
    """An openNURBS object in an archive: its class, the range of its data, and the chunk it stands in."""

    class_id: uuid.UUID
    chunk: Chunk
    data: Chunk


def class_record(data: bytes, position: int, end: int, version: int) -> ClassRecord:
    """The object whose TCODE_OPENNURBS_CLASS chunk starts at `position`."""
    chunk = chunk_at(data, position, end, version)
    if chunk.typecode != CLASS:
        raise InputError("an object of the archive does not start where it should", mend="the file is damaged")
    identity = chunk_at(data, chunk.body, chunk.end, version)
    class_id = uuid.UUID(bytes_le=data[identity.body : identity.body + 16])
    body = chunk_at(data, identity.end, chunk.end, version)
    if identity.typecode != CLASS_UUID or body.typecode != CLASS_DATA:
        raise InputError("an object of the archive has no class or no data", mend="the file is damaged")
    return ClassRecord(class_id, chunk, body)


def class_chunk(class_id: uuid.UUID, body: Writer, after: bytes = b"") -> bytes:
    """A TCODE_OPENNURBS_CLASS chunk around an object's data.

    `body` holds one finished TCODE_OPENNURBS_CLASS_DATA chunk; `after` are the chunks behind it in the object that it
    takes the place of: user data and the end mark.
    """
    writer = Writer(body.version)
    writer.begin(CLASS)
    writer.begin(CLASS_UUID)
    writer.raw(class_id.bytes_le)
    writer.end()
    writer.whole(body.finished())
    if after:
        writer.whole(after)
    else:
        writer.short(CLASS_END)
    writer.end()
    return writer.finished()


@dataclass(frozen=True, slots=True)
class ObjectRecord:
    """One record of the object table: the whole record, its type, and the object in it."""

    chunk: Chunk
    type_chunk: Chunk
    record: ClassRecord

    def identity(self, data: bytes) -> bytes:
        """The object's id (16 bytes): it leads its attributes in every version. Empty when there are no attributes."""
        version = archive_version(data)
        for chunk in chunks(data, self.record.chunk.end, self.chunk.end - 4, version):
            if chunk.typecode == OBJECT_ATTRIBUTES:
                return data[chunk.body + 1 : chunk.body + 17]
        return b""

    @property
    def holds_surfaces(self) -> bool:
        """Whether the record says that its object is a Brep, a surface or an extrusion."""
        return self.type_chunk.value in (BREP_OBJECT_TYPE, SURFACE_OBJECT_TYPE, EXTRUSION_OBJECT_TYPE)


def check_archive(data: bytes) -> None:
    """Raise InputError when the chunks of a file do not fit together, or its end is missing."""
    version = archive_version(data)
    total = 0
    for table in chunks(data, HEADER_SIZE, len(data), version):
        if table.typecode == END_OF_FILE and version > 1:
            total = int.from_bytes(data[table.body : table.body + length_size(version)], "little")
            break
        if table.typecode & TABLE and version > 1:
            for _ in chunks(data, table.body, table.end, version):
                pass
    if version > 1 and not 0 < total <= len(data):
        raise InputError("the end of the file is missing", mend="the file is damaged or cut short")


def object_records(data: bytes) -> list[ObjectRecord]:
    """The records of a file's object table, in the file's order. Version 1 files have none."""
    version = archive_version(data)
    records: list[ObjectRecord] = []
    for table in chunks(data, HEADER_SIZE, len(data), version):
        if table.typecode == END_OF_FILE:
            break
        if table.typecode != OBJECT_TABLE:
            continue
        for entry in chunks(data, table.body, table.end, version):
            if entry.typecode != OBJECT_RECORD:
                continue
            kind = chunk_at(data, entry.body, entry.end, version)
            records.append(ObjectRecord(entry, kind, class_record(data, kind.end, entry.end, version)))
    return records


def replace_objects(data: bytes, objects: dict[int, tuple[int | None, bytes]]) -> bytes:
    """The file with the objects of some records of its object table replaced, and every other byte as it was.

    objects : place in `object_records(data)` -> (new object type, or None to keep it; new TCODE_OPENNURBS_CLASS chunk).
    """
    version = archive_version(data)
    places = {record.chunk.start: i for i, record in enumerate(object_records(data))}
    records = object_records(data)
    out = bytearray(data[:HEADER_SIZE])
    for table in chunks(data, HEADER_SIZE, len(data), version):
        if table.typecode == OBJECT_TABLE:
            writer = Writer(version)
            writer.begin(OBJECT_TABLE)
            for entry in chunks(data, table.body, table.end, version):
                place = places.get(entry.start, -1)
                if place in objects:
                    writer.whole(_with_object(data, records[place], *objects[place], version))
                else:
                    writer.whole(data[entry.start : entry.end])
            writer.end()
            out += writer.finished()
        elif table.typecode == END_OF_FILE:
            size = length_size(version)
            total = len(out) + 4 + 2 * size
            out += data[table.start : table.body] + total.to_bytes(size, "little")
            out += data[table.body + size :]
            break
        else:
            out += data[table.start : table.end]
    return bytes(out)


def _with_object(data: bytes, place: ObjectRecord, kind: int | None, new: bytes, version: int) -> bytes:
    """An object record with another object in it; attributes, history and the rest stay."""
    writer = Writer(version)
    writer.begin(OBJECT_RECORD)
    if kind is None:
        writer.whole(data[place.type_chunk.start : place.type_chunk.end])
    else:
        writer.short(OBJECT_TYPE, kind)
    writer.whole(new)
    writer.whole(data[place.record.chunk.end : place.chunk.end - 4])
    writer.end()
    return writer.finished()
