"""MCAP records as bytes: walking over them, packing and unpacking the few kinds that this package
handles itself.

Source: MCAP specification, mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from functools import lru_cache
from io import BytesIO
from types import MappingProxyType
from typing import NamedTuple

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, McapRecord, Schema

from coordlog.errors import FormatError

RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
MAGIC = b"\x89MCAP0\r\n"
FOOTER = struct.Struct("<BQQQI")  # opcode, length, summary start, summary offset start, summary crc
DATA_END = struct.Struct("<BQI")  # opcode, length, crc of the data section
TAIL_SIZE = FOOTER.size + len(MAGIC)
_size = struct.Struct("<I").unpack_from


class Span(NamedTuple):
    """Where a record's content lies; opcode and length are the nine bytes before `start`."""

    opcode: int
    start: int
    end: int


def walk(
    data: bytes | memoryview, start: int = len(MAGIC), stop: int | None = None
) -> Iterator[Span]:
    """Every complete record from `start` on.

    Ends silently before one that is cut off or passes `stop`.
    """
    at, stop = start, len(data) if stop is None else stop
    while at + RECORD_HEAD.size <= stop:
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        begin = at + RECORD_HEAD.size
        if opcode == 0 or length > stop - begin:
            return
        at = begin + length
        yield Span(opcode, begin, at)


def pack(record: McapRecord) -> bytes:
    """The bytes of one record, opcode and length included."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def pack_metadata(name: str, values: Mapping[str, str]) -> bytes:
    """The bytes of a metadata record, opcode and length included."""
    pairs = b"".join(_packed(text) for pair in values.items() for text in pair)
    content = _packed(name) + struct.pack("<I", len(pairs)) + pairs
    return RECORD_HEAD.pack(Opcode.METADATA, len(content)) + content


def unpack_header(content: bytes | memoryview) -> tuple[str, str]:
    """Profile and library of an MCAP header: what kind of file, and which program wrote it.

    Raises:
        FormatError: if the record is not well formed.
    """
    profile, at = _string(content, 0)
    return profile, _string(content, at)[0]


@lru_cache(maxsize=256)
def unpack_metadata(content: bytes) -> tuple[str, Mapping[str, str]]:
    """Name and string map of a metadata record; most of them are the same in every file of a run.

    Raises:
        FormatError: if the record is not well formed.
    """
    name, at = _string(content, 0)
    (size,) = _unpack("<I", content, at)
    texts, at, stop = [], at + 4, len(content)
    if at + size != stop:
        raise FormatError(f"metadata {name!r}: expected {stop - at} bytes of values, got {size}")
    while at < stop or (at == stop and len(texts) % 2):
        start = at + 4
        if start > stop:
            raise FormatError(f"record of {stop} bytes ends within a field")
        at = start + _size(content, at)[0]
        texts.append(content[start:at])
    if at != stop:
        raise FormatError(f"record of {stop} bytes ends within a field")
    try:
        values = [text.decode() for text in texts]
    except UnicodeDecodeError as error:
        raise FormatError(f"text that is not UTF-8: {error}") from None
    return name, MappingProxyType(dict(zip(values[::2], values[1::2], strict=True)))


def unpack_attachment(content: memoryview) -> tuple[str, bytes]:
    """Name and content of an attachment.

    Raises:
        FormatError: if the record is not well formed or its CRC differs.
    """
    name, at = _string(content, 16)  # after log time and create time
    _, at = _string(content, at)
    (size,) = _unpack("<Q", content, at)
    if at + 8 + size + 4 != len(content):
        raise FormatError(
            f"attachment {name!r}: expected {len(content) - at - 12} bytes, got {size}"
        )
    (crc,) = _unpack("<I", content, len(content) - 4)
    if crc and crc != zlib.crc32(content[:-4]):  # zero: none was written
        raise FormatError(
            f"attachment {name!r}: expected CRC {crc:08x}, got {zlib.crc32(content[:-4]):08x}"
        )
    return name, bytes(content[at + 8 : -4])


@lru_cache(maxsize=64)
def unpack_definitions(records: bytes) -> tuple[tuple[Schema, ...], tuple[Channel, ...]]:
    """The schemas and channels among the records of a chunk's start or of a summary.

    The same few bytes in every file.
    """
    schemas, channels = [], []
    for span in walk(records, 0):
        stream = ReadDataStream(BytesIO(records[span.start : span.end]))
        if span.opcode == Opcode.SCHEMA:
            schemas.append(Schema.read(stream))
        elif span.opcode == Opcode.CHANNEL:
            channels.append(Channel.read(stream))
    return tuple(schemas), tuple(channels)


def _packed(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _string(content: bytes | memoryview, at: int) -> tuple[str, int]:
    (size,) = _unpack("<I", content, at)
    end = at + 4 + size
    if end > len(content):
        raise FormatError(f"record of {len(content)} bytes ends within a field")
    try:
        return str(content[at + 4 : end], "utf-8"), end
    except UnicodeDecodeError as error:
        raise FormatError(f"text that is not UTF-8: {error}") from None


def _unpack(form: str, content: bytes | memoryview, at: int) -> tuple[int, ...]:
    try:
        return struct.unpack_from(form, content, at)
    except struct.error:
        raise FormatError(f"record of {len(content)} bytes ends within a field") from None
