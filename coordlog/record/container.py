"""The records of an MCAP file around its chunks, appended in order with their indexes.

Layout of every file: magic, Header, metadata and attachments known at the start, chunks each
followed by its message indexes, the closing metadata, DataEnd with the CRC of everything so far,
the summary, the footer, magic. The closing metadata hold the CRCs of all that is before and after
them.

Source: MCAP specification, mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    ChunkIndex,
    DataEnd,
    Header,
    MetadataIndex,
    Statistics,
    SummaryOffset,
)

from coordlog.record.chunk import COMPRESSION, Chunk
from coordlog.record.records import DATA_END, FOOTER, MAGIC, RECORD_HEAD, pack, pack_metadata

PROFILE = "ros2"
"""MCAP's name for ros2msg schemas with CDR payloads; readers of ROS 2 bags ask for it."""


class Topic(NamedTuple):
    """A topic's channel: its id, and the packed records of the channel and its schema."""

    id: int
    schema: bytes
    channel: bytes


@dataclass
class Books:
    """What a data section holds, as far as its summary says so."""

    schemas: dict[bytes, None] = field(default_factory=dict)
    channels: dict[bytes, None] = field(default_factory=dict)
    """Packed records like the schemas: in order, each once."""
    counts: dict[int, int] = field(default_factory=dict)
    """Messages of each channel."""
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)

    def summary(self, start: int) -> tuple[bytes, bytes]:
        """The records of the summary that starts at a byte of the file, and the offsets that
        follow.
        """
        groups = {
            Opcode.SCHEMA: b"".join(self.schemas),
            Opcode.CHANNEL: b"".join(self.channels),
            Opcode.STATISTICS: pack(self._statistics()),
            Opcode.CHUNK_INDEX: b"".join(map(pack, self.chunks)),
            Opcode.ATTACHMENT_INDEX: b"".join(map(pack, self.attachments)),
            Opcode.METADATA_INDEX: b"".join(map(pack, self.metadata)),
        }
        summary, offsets = b"", b""
        for opcode, group in groups.items():
            if group:  # an offset to an empty group is an error to strict readers
                at = start + len(summary)
                offsets += pack(
                    SummaryOffset(group_opcode=opcode, group_start=at, group_length=len(group))
                )
            summary += group
        return summary, offsets

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self.chunks),
            message_count=sum(self.counts.values()),
            message_start_time=min((chunk.message_start_time for chunk in self.chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self.chunks), default=0),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )


class Container:
    """Appends records to a buffer that the owner drains to disk, and keeps the summary's books."""

    def __init__(self, library: str) -> None:
        self._pending: list[bytes] = []
        self._position = 0
        self._crc = 0
        self.books = Books()
        self._append(MAGIC)
        self._append(pack(Header(profile=PROFILE, library=library)))

    def drain(self) -> bytes:
        """All bytes appended since the last call."""
        data, self._pending = b"".join(self._pending), []
        return data

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append a metadata record."""
        data = pack_metadata(name, values)
        self.books.metadata.append(
            MetadataIndex(offset=self._position, length=len(data), name=name)
        )
        self._append(data)

    def add_attachment(self, name: str, content: bytes, *, media_type: str, log_time: int) -> None:
        """Append an attachment with its CRC."""
        data = pack(
            Attachment(
                create_time=0, log_time=log_time, name=name, media_type=media_type, data=content
            )
        )
        self.books.attachments.append(
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

    def define(self, topic: Topic) -> bytes:
        """The records that must stand in a chunk before the first message of a channel.

        Empty if they already do.
        """
        schema = b"" if topic.schema in self.books.schemas else topic.schema
        channel = b"" if topic.channel in self.books.channels else topic.channel
        self.books.schemas[topic.schema] = self.books.channels[topic.channel] = None
        return schema + channel

    def add_chunk(self, chunk: Chunk) -> None:
        """Append a chunk and its message indexes."""
        index_start = self._position + len(chunk.record)
        self.books.chunks.append(
            ChunkIndex(
                chunk_length=len(chunk.record),
                chunk_start_offset=self._position,
                compression=COMPRESSION,
                compressed_size=chunk.compressed_size,
                message_start_time=chunk.start,
                message_end_time=chunk.end,
                message_index_length=len(chunk.message_index),
                message_index_offsets={
                    channel: index_start + offset for channel, offset in chunk.index_offset.items()
                },
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        for channel, count in chunk.counts.items():
            self.books.counts[channel] = self.books.counts.get(channel, 0) + count
        self._append(chunk.record)
        self._append(chunk.message_index)

    def commit(self, name: str, marker: Callable[[int, int], Mapping[str, str]]) -> None:
        """Append the closing metadata, and `finish`.

        Args:
            name: Name of the record.
            marker: Makes it, of equal length each time, from the CRC-32 of all bytes before it and
                that of the summary.
        """
        before, size = self._crc, len(pack_metadata(name, marker(0, 0)))
        self.books.metadata.append(MetadataIndex(offset=self._position, length=size, name=name))
        summary, crc = self._summary(self._position + size + DATA_END.size)
        self._append(pack_metadata(name, marker(before, crc)))
        self._end(summary, crc)

    def finish(self) -> None:
        """Append the end of the data section, the summary, the footer and the closing magic."""
        self._end(*self._summary(self._position + DATA_END.size))

    def _end(self, summary: bytes, crc: int) -> None:
        self._append(pack(DataEnd(self._crc)))
        self._append(summary + struct.pack("<I", crc) + MAGIC)

    def _summary(self, start: int) -> tuple[bytes, int]:
        """The summary that starts at a byte of the file, up to its CRC, and that."""
        summary, offsets = self.books.summary(start)
        footer = FOOTER.pack(
            Opcode.FOOTER, FOOTER.size - RECORD_HEAD.size, start, start + len(summary), 0
        )[:-4]
        whole = summary + offsets + footer
        return whole, zlib.crc32(whole)

    def _append(self, data: bytes) -> None:
        self._pending.append(data)
        self._position += len(data)
        self._crc = zlib.crc32(data, self._crc)
