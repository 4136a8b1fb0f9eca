"""The records of an MCAP file around its chunks: appending them with their indexes, and walking over them.

Layout of every file: magic, Header, metadata and attachments known at the start, chunks each followed by its message
indexes, the closing metadata, DataEnd with the CRC of everything so far, the summary, the footer, magic.

Source: MCAP specification, mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from functools import lru_cache
from io import BytesIO
from typing import NamedTuple

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from coordlog.errors import FormatError
from coordlog.record.chunk import COMPRESSION, RECORD_HEAD, Chunk

MAGIC = b"\x89MCAP0\r\n"
FOOTER = struct.Struct("<BQQQI")  # opcode, length, summary start, summary offset start, summary crc
DATA_END = struct.Struct("<BQI")  # opcode, length, crc of the data section
TAIL_SIZE = FOOTER.size + len(MAGIC)


class Span(NamedTuple):
    """Where a record's content lies; opcode and length are the nine bytes before `start`."""

    opcode: int
    start: int
    end: int


def walk(data: bytes | memoryview, start: int = len(MAGIC), stop: int | None = None) -> Iterator[Span]:
    """Every complete record from `start` on; ends silently before one that is cut off or passes `stop`."""
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


def unpack_metadata(content: memoryview) -> tuple[str, dict[str, str]]:
    """Name and string map of a metadata record.

    Raises:
        FormatError: if the record is not well formed.
    """
    name, at = _string(content, 0)
    (size,) = _unpack("<I", content, at)
    values, at = {}, at + 4
    if at + size != len(content):
        raise FormatError(f"metadata {name!r}: expected {len(content) - at} bytes of values, got {size}")
    while at < len(content):
        key, at = _string(content, at)
        values[key], at = _string(content, at)
    return name, values


def unpack_attachment(content: memoryview) -> tuple[str, bytes]:
    """Name and content of an attachment.

    Raises:
        FormatError: if the record is not well formed or its CRC differs.
    """
    name, at = _string(content, 16)  # after log time and create time
    _, at = _string(content, at)
    (size,) = _unpack("<Q", content, at)
    if at + 8 + size + 4 != len(content):
        raise FormatError(f"attachment {name!r}: expected {len(content) - at - 12} bytes, got {size}")
    (crc,) = _unpack("<I", content, len(content) - 4)
    if crc != zlib.crc32(content[:-4]):
        raise FormatError(f"attachment {name!r}: expected CRC {crc:08x}, got {zlib.crc32(content[:-4]):08x}")
    return name, bytes(content[at + 8 : -4])


@lru_cache(maxsize=64)
def unpack_definitions(records: bytes) -> tuple[tuple[Schema, ...], tuple[Channel, ...]]:
    """The schemas and channels among the records of a chunk's start or of a summary; the same few bytes in every file."""
    schemas, channels = [], []
    for span in walk(records, 0):
        stream = ReadDataStream(BytesIO(records[span.start : span.end]))
        if span.opcode == Opcode.SCHEMA:
            schemas.append(Schema.read(stream))
        elif span.opcode == Opcode.CHANNEL:
            channels.append(Channel.read(stream))
    return tuple(schemas), tuple(channels)


def _string(content: memoryview, at: int) -> tuple[str, int]:
    (size,) = _unpack("<I", content, at)
    end = at + 4 + size
    try:
        return str(content[at + 4 : end], "utf-8"), end
    except UnicodeDecodeError as error:
        raise FormatError(f"text that is not UTF-8: {error}") from None


def _unpack(form: str, content: memoryview, at: int) -> tuple[int, ...]:
    try:
        return struct.unpack_from(form, content, at)
    except struct.error:
        raise FormatError(f"record of {len(content)} bytes ends within a field") from None


class Container:
    """Appends records to a buffer that the owner drains to disk; remembers what the summary must say."""

    def __init__(self, library: str) -> None:
        self._pending: list[bytes] = []
        self._position = 0
        self._crc = 0
        self._definitions: dict[int, tuple[Schema, Channel]] = {}
        self._counts: dict[int, int] = {}
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._append(MAGIC)
        self._append(pack(Header(profile="", library=library)))

    def drain(self) -> bytes:
        """All bytes appended since the last call."""
        data, self._pending = b"".join(self._pending), []
        return data

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append a metadata record."""
        data = pack(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset=self._position, length=len(data), name=name))
        self._append(data)

    def add_attachment(self, name: str, content: bytes, *, media_type: str, log_time: int) -> None:
        """Append an attachment with its CRC."""
        data = pack(Attachment(create_time=0, log_time=log_time, name=name, media_type=media_type, data=content))
        self._attachments.append(
            AttachmentIndex(
                offset=self._position,
                length=len(data),
                log_time=log_time,
                create_time=0,
                data_size=len(content),
                name=name,
                media_type=media_type,
            )
        )
        self._append(data)

    def define(self, schema: Schema, channel: Channel) -> bytes:
        """The records that must stand in a chunk before the first message of a channel; empty if they already do."""
        if channel.id in self._definitions:
            return b""
        known = {schema.id for schema, _ in self._definitions.values()}
        self._definitions[channel.id] = (schema, channel)
        return (b"" if schema.id in known else pack(schema)) + pack(channel)

    def add_chunk(self, chunk: Chunk) -> None:
        """Append a chunk and its message indexes."""
        index_start = self._position + len(chunk.record)
        self._chunks.append(
            ChunkIndex(
                chunk_length=len(chunk.record),
                chunk_start_offset=self._position,
                compression=COMPRESSION,
                compressed_size=chunk.compressed_size,
                message_start_time=chunk.start,
                message_end_time=chunk.end,
                message_index_length=len(chunk.message_index),
                message_index_offsets={channel: index_start + offset for channel, offset in chunk.index_offset.items()},
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        for channel, count in chunk.counts.items():
            self._counts[channel] = self._counts.get(channel, 0) + count
        self._append(chunk.record)
        self._append(chunk.message_index)

    def finish(self) -> None:
        """Append the end of the data section, the summary, the footer and the closing magic."""
        self._append(pack(DataEnd(self._crc)))
        start, groups = self._position, self._summary_groups()
        summary, offsets = b"", b""
        for opcode, records in groups.items():
            group = b"".join(map(pack, records))
            if group:  # an offset to an empty group is an error to strict readers
                offsets += pack(SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(group)))
            summary += group
        footer = FOOTER.pack(Opcode.FOOTER, FOOTER.size - RECORD_HEAD.size, start, start + len(summary), 0)[:-4]
        crc = zlib.crc32(summary + offsets + footer)
        self._append(summary + offsets + footer + struct.pack("<I", crc) + MAGIC)

    def _summary_groups(self) -> dict[int, list[McapRecord]]:
        return {
            Opcode.SCHEMA: list({schema.id: schema for schema, _ in self._definitions.values()}.values()),
            Opcode.CHANNEL: [channel for _, channel in self._definitions.values()],
            Opcode.STATISTICS: [self._statistics()],
            Opcode.CHUNK_INDEX: list(self._chunks),
            Opcode.ATTACHMENT_INDEX: list(self._attachments),
            Opcode.METADATA_INDEX: list(self._metadata),
        }

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._definitions),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len({schema.id for schema, _ in self._definitions.values()}),
        )

    def _append(self, data: bytes) -> None:
        self._pending.append(data)
        self._position += len(data)
        self._crc = zlib.crc32(data, self._crc)
