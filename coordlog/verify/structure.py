"""Whether a file's summary says what its data section holds, and whether both follow our layout.

The summary that the data section deserves is built here from its records, and compared entry by
entry with the one that is there.
"""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from itertools import zip_longest
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from coordlog.errors import FormatError
from coordlog.record.chunk import expand
from coordlog.record.metadata import HEADER_RECORDS, RESULT
from coordlog.record.records import FOOTER, RECORD_HEAD, TAIL_SIZE, Span, unpack_attachment, walk
from coordlog.record.schema import MESSAGE_ENCODING, parsed
from coordlog.verify.finding import Problem

_KINDS: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.STATISTICS: Statistics,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
}


def structure(data: bytes, start: int) -> Iterator[Problem]:
    """What does not fit together in a file whose CRCs are right.

    `start` is where its summary starts.
    """
    ledger = _Ledger(data)
    yield from ledger.read(start)
    actual: dict[int, list[McapRecord]] = {opcode: [] for opcode in _KINDS}
    spans = list(walk(data, start, len(data) - TAIL_SIZE))
    for span in spans:
        if span.opcode in actual:
            actual[span.opcode].append(_parse(_KINDS[span.opcode], data, span))
    wanted = ledger.summary() | {Opcode.SUMMARY_OFFSET: _groups(spans)}
    for opcode, records in wanted.items():
        yield from _compared(_KINDS[opcode].__name__, records, actual[opcode])
    offsets = next(
        (span.start - RECORD_HEAD.size for span in spans if span.opcode == Opcode.SUMMARY_OFFSET), 0
    )
    (_, _, _, got, _) = FOOTER.unpack_from(data, len(data) - TAIL_SIZE)
    if got != offsets:
        yield Problem(None, "footer", f"summary offsets at byte {offsets}", f"byte {got}")


class _Ledger:
    """Reads the data section, checks each record against its neighbours, and keeps the books for
    the summary.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: dict[int, int] = {}
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._indexes: dict[
            int, list[tuple[int, int]]
        ] = {}  # what the message indexes after the last chunk should hold

    def read(self, stop: int) -> Iterator[Problem]:
        """Go through the records up to `stop`."""
        last = 0
        for span in walk(self._data, stop=stop):
            last = span.opcode
            offset, length = span.start - RECORD_HEAD.size, span.end - span.start + RECORD_HEAD.size
            if span.opcode == Opcode.METADATA:
                name = _parse(Metadata, self._data, span).name
                self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))
            elif span.opcode == Opcode.ATTACHMENT:
                yield from self._attachment(span, offset, length)
            elif span.opcode == Opcode.CHUNK:
                yield from self._missing_indexes()
                yield from self._chunk(_parse(Chunk, self._data, span), span, offset, length)
            elif span.opcode == Opcode.MESSAGE_INDEX:
                yield from self._message_index(
                    _parse(MessageIndex, self._data, span), offset, length
                )
        yield from self._missing_indexes()
        names = [index.name for index in self._metadata]
        if names != [*HEADER_RECORDS, RESULT] or last != Opcode.DATA_END:
            yield Problem(
                None,
                "metadata",
                f"{', '.join(HEADER_RECORDS)} first and {RESULT} last",
                ", ".join(names),
            )

    def summary(self) -> dict[int, list[McapRecord]]:
        """The summary records that the data section deserves."""
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        return {
            Opcode.SCHEMA: list(self._schemas.values()),
            Opcode.CHANNEL: list(self._channels.values()),
            Opcode.STATISTICS: [statistics],
            Opcode.CHUNK_INDEX: list(self._chunks),
            Opcode.ATTACHMENT_INDEX: list(self._attachments),
            Opcode.METADATA_INDEX: list(self._metadata),
        }

    def _attachment(self, span: Span, offset: int, length: int) -> Iterator[Problem]:
        try:
            unpack_attachment(memoryview(self._data)[span.start : span.end])
        except FormatError as error:
            yield Problem(None, "attachment", "an intact record", str(error))
        record = _parse(Attachment, self._data, span)
        self._attachments.append(
            AttachmentIndex(
                offset=offset,
                length=length,
                log_time=record.log_time,
                create_time=record.create_time,
                data_size=len(record.data),
                name=record.name,
                media_type=record.media_type,
            )
        )

    def _chunk(self, chunk: Chunk, span: Span, offset: int, length: int) -> Iterator[Problem]:
        expanded = expand(memoryview(self._data)[span.start : span.end])
        times = []
        for inner in walk(expanded, 0):
            if inner.opcode == Opcode.SCHEMA:
                yield from self._define_schema(_parse(Schema, expanded, inner))
            elif inner.opcode == Opcode.CHANNEL:
                yield from self._define_channel(_parse(Channel, expanded, inner))
            else:
                message = Message.read(_stream(expanded, inner), inner.end - inner.start)
                times.append(message.log_time)
                self._indexes.setdefault(message.channel_id, []).append(
                    (message.log_time, inner.start - RECORD_HEAD.size)
                )
        wanted = (min(times, default=0), max(times, default=0))
        if (chunk.message_start_time, chunk.message_end_time) != wanted or times != sorted(times):
            yield Problem(
                None,
                "chunk",
                f"messages in order of log time, from {wanted[0]} to {wanted[1]}",
                f"{chunk}",
            )
        for channel, entries in self._indexes.items():
            self._counts[channel] = self._counts.get(channel, 0) + len(entries)
        self._chunks.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=offset,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                message_index_length=0,
                message_index_offsets={},
                uncompressed_size=len(expanded),
            )
        )

    def _message_index(self, index: MessageIndex, offset: int, length: int) -> Iterator[Problem]:
        wanted = self._indexes.pop(index.channel_id, [])
        if index.records != wanted:
            yield Problem(
                None,
                f"message index of channel {index.channel_id}",
                f"{wanted}",
                f"{index.records}",
            )
        if self._chunks:
            self._chunks[-1].message_index_offsets[index.channel_id] = offset
            self._chunks[-1].message_index_length += length

    def _missing_indexes(self) -> Iterator[Problem]:
        for channel in self._indexes:
            yield Problem(
                None, f"message index of channel {channel}", "one after its chunk", "none"
            )
        self._indexes.clear()

    def _define_schema(self, schema: Schema) -> Iterator[Problem]:
        self._schemas[schema.id] = schema
        try:  # of what is read the fields are compared where it is decoded
            parsed(schema.name, schema.encoding, schema.data)
        except FormatError as error:
            yield Problem(None, f"schema {schema.name}", "one that can be read", str(error))

    def _define_channel(self, channel: Channel) -> Iterator[Problem]:
        self._channels[channel.id] = channel
        if channel.message_encoding != MESSAGE_ENCODING or channel.schema_id not in self._schemas:
            yield Problem(
                None,
                f"channel {channel.topic}",
                f"{MESSAGE_ENCODING}, and its schema before it",
                f"{channel}",
            )


def _groups(spans: list[Span]) -> list[McapRecord]:
    """The summary offsets that the records of a summary deserve: one per run of equal records."""
    groups: list[SummaryOffset] = []
    for span in spans:
        if span.opcode == Opcode.SUMMARY_OFFSET:
            break
        length = span.end - span.start + RECORD_HEAD.size
        if not groups or groups[-1].group_opcode != span.opcode:
            groups.append(
                SummaryOffset(
                    group_opcode=span.opcode,
                    group_start=span.start - RECORD_HEAD.size,
                    group_length=0,
                )
            )
        groups[-1].group_length += length
    return list(groups)


def _compared(kind: str, wanted: list[McapRecord], got: list[McapRecord]) -> Iterator[Problem]:
    for index, (a, b) in enumerate(zip_longest(wanted, got)):
        if a != b:
            yield Problem(None, f"summary {kind} {index}", f"{a}", f"{b}")


def _parse(kind: Any, data: bytes, span: Span) -> Any:
    return kind.read(_stream(data, span))


def _stream(data: bytes, span: Span) -> ReadDataStream:
    return ReadDataStream(BytesIO(data[span.start : span.end]))
