"""Whether a file's summary says what its data section holds, and whether both follow our layout.

The summary that the data section deserves is built here from its records, and compared entry by
entry with the one that is there.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Generator, Iterator, Mapping, Sequence
from functools import lru_cache
from io import BytesIO
from itertools import zip_longest
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    McapRecord,
    Message,
    MessageIndex,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from coordlog.errors import FormatError, TruncatedError
from coordlog.record.chunk import Expanded, definitions, expand, tiled, unpack_head
from coordlog.record.container import Books
from coordlog.record.decoding import require_header
from coordlog.record.metadata import (
    EPISODE,
    HEADER_RECORDS,
    RESULT,
    decode_result,
    require_readable,
    vouched,
)
from coordlog.record.opening import no_marker
from coordlog.record.records import (
    FOOTER,
    RECORD_HEAD,
    TAIL_SIZE,
    Span,
    unpack_attachment,
    unpack_definitions,
    unpack_metadata,
    walk,
)
from coordlog.record.schema import MESSAGE_ENCODING, parsed, require_fields
from coordlog.spec import FINAL, STEP, V1_STEP
from coordlog.verify.finding import Problem

_TIMES, _SIZE = struct.Struct("<QQ"), struct.Struct("<I")
"""How an attachment record begins, and a string in it."""
TOGETHER = 1 << 24
"""Bytes of expanded chunks that are looked at together."""

_KINDS: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.STATISTICS: Statistics,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
}


def structure(data: bytes, start: int, before: Sequence[Span]) -> Iterator[Problem]:
    """What does not fit together in a file whose CRCs are right.

    Args:
        data: The file.
        start: Where its summary starts.
        before: The records of its data section.

    Raises:
        FormatError: if a record cannot be read, or the commit marker does not vouch for it.
    """
    ledger = _Ledger(data)
    yield from ledger.read(before)
    ledger.require_promised()
    summary, offsets = ledger.books.summary(start)
    (_, _, _, got, _) = FOOTER.unpack_from(data, len(data) - TAIL_SIZE)
    if got != start + len(summary):
        wanted = f"summary offsets at byte {start + len(summary)}"
        yield Problem(None, "footer", wanted, f"byte {got}")
    if data[start:-TAIL_SIZE] != summary + offsets:
        yield from _compared(summary + offsets, data[start:-TAIL_SIZE])


class _Ledger:
    """Reads the data section, checks each record against its neighbours, and keeps the books for
    the summary.
    """

    def __init__(self, data: bytes) -> None:
        self._data, self._view = data, memoryview(data)
        self.books = Books()
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._digests: dict[str, str] = {}
        self._records: dict[str, Mapping[str, str]] = {}
        self._expanded: list[Expanded] = []  # chunks that wait to be looked at together

    def read(self, spans: Sequence[Span]) -> Iterator[Problem]:
        """Go through the records of the data section."""
        last = 0
        for span in spans:
            last = span.opcode
            offset, length = span.start - RECORD_HEAD.size, span.end - span.start + RECORD_HEAD.size
            if span.opcode == Opcode.MESSAGE_INDEX:
                self._index(span, offset, length)
            elif span.opcode == Opcode.METADATA:
                name, values = unpack_metadata(bytes(self._view[span.start : span.end]))
                self._records[name] = values
                self.books.metadata.append(MetadataIndex(offset=offset, length=length, name=name))
            elif span.opcode == Opcode.ATTACHMENT:
                self._attachment(span, offset, length)
            elif span.opcode == Opcode.CHUNK:
                if sum(len(chunk.data) for chunk in self._expanded) > TOGETHER:
                    yield from self._close()
                yield from self._chunk(span, offset, length)
        yield from self._close()
        names = [index.name for index in self.books.metadata]
        if names != [*HEADER_RECORDS, RESULT] or last != Opcode.DATA_END:
            yield Problem(
                None,
                "metadata",
                f"{', '.join(HEADER_RECORDS)} first and {RESULT} last",
                ", ".join(names),
            )

    def require_promised(self) -> None:
        """Hold metadata, attachments and the numbers of messages to the commit marker.

        Raises:
            FormatError: naming the first that is not as it was written.
        """
        require_header(self._records)
        if RESULT not in self._records:
            raise TruncatedError(no_marker(len(self._data)))
        require_readable(self._records)
        decode_result(self._records[RESULT])
        promised = vouched(self._records)
        for name, wanted in promised.get("attachments", {}).items():
            if self._digests.get(name) != wanted:
                raise FormatError(f"attachment {name!r}: missing, or its digest is another")
        counts = {self._channels[id_].topic: count for id_, count in self.books.counts.items()}
        for topic, (count, _) in promised.get("messages", {}).items():
            if counts.get(topic, 0) != count:
                raise FormatError(
                    f"topic {topic}: expected {count} messages, got {counts.get(topic, 0)}"
                )

    def _attachment(self, span: Span, offset: int, length: int) -> None:
        content = self._view[span.start : span.end]
        name, data = unpack_attachment(content)
        log_time, create_time = _TIMES.unpack_from(content)
        at = _TIMES.size + 4 + len(name.encode())
        (size,) = _SIZE.unpack_from(content, at)
        self._digests[name] = hashlib.sha256(data).hexdigest()
        self.books.attachments.append(
            AttachmentIndex(
                offset=offset,
                length=length,
                log_time=log_time,
                create_time=create_time,
                data_size=len(data),
                name=name,
                media_type=str(content[at + 4 : at + 4 + size], "utf-8"),
            )
        )

    def _chunk(self, span: Span, offset: int, length: int) -> Iterator[Problem]:
        content = self._view[span.start : span.end]
        head, data = unpack_head(content), expand(content)
        start = definitions(data)
        yield from self._define(start)
        self._expanded.append(Expanded(head, data, len(start), []))
        self.books.chunks.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=offset,
                compression=head.compression.decode(),
                compressed_size=len(head.packed),
                message_start_time=head.start,
                message_end_time=head.end,
                message_index_length=0,
                message_index_offsets={},
                uncompressed_size=head.size,
            )
        )

    def _index(self, span: Span, offset: int, length: int) -> None:
        content = self._view[span.start : span.end]
        if self._expanded and len(content) >= 2:
            self._expanded[-1].indexes.append(content)
            channel = int.from_bytes(content[:2], "little")
            self.books.chunks[-1].message_index_offsets[channel] = offset
            self.books.chunks[-1].message_index_length += length

    def _close(self) -> Iterator[Problem]:
        """Hold the chunks before, their indexes and their heads to one another."""
        chunks, self._expanded = self._expanded, []
        if not chunks:
            return
        if not tiled(chunks):
            for chunk in chunks:  # rare: find out what it is, one message after the other
                yield from self._explained(chunk)
            return
        for index in (index for chunk in chunks for index in chunk.indexes):
            channel, count = int.from_bytes(index[:2], "little"), (len(index) - 6) // 16
            self.books.counts[channel] = self.books.counts.get(channel, 0) + count

    def _explained(self, chunk: Expanded) -> Iterator[Problem]:
        """What does not fit in one chunk, its indexes and its head."""
        found, said = yield from self._messages(chunk)
        yield from _unlike(chunk.indexes, found)
        wanted = (min(said, default=0), max(said, default=0))
        if (chunk.head.start, chunk.head.end) != wanted or said != sorted(said):
            yield Problem(
                None,
                "chunk",
                f"messages in order of log time, from {wanted[0]} to {wanted[1]}",
                f"from {chunk.head.start} to {chunk.head.end}",
            )

    def _messages(
        self, chunk: Expanded
    ) -> Generator[Problem, None, tuple[dict[int, list[tuple[int, int]]], list[int]]]:
        """Log time and offset of each message of a chunk by channel, and all log times, read one
        after the other.
        """
        found: dict[int, list[tuple[int, int]]] = {}
        times = []
        data = chunk.data
        for inner in walk(data, chunk.start):
            if inner.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                yield from self._define(data[inner.start - RECORD_HEAD.size : inner.end])
            else:
                message = Message.read(_stream(data, inner), inner.end - inner.start)
                times.append(message.log_time)
                entry = (message.log_time, inner.start - RECORD_HEAD.size)
                found.setdefault(message.channel_id, []).append(entry)
        for channel, entries in found.items():
            self.books.counts[channel] = self.books.counts.get(channel, 0) + len(entries)
        return found, times

    def _define(self, records: bytes) -> Iterator[Problem]:
        for kept, packed in zip(
            (self.books.schemas, self.books.channels), _raw(records), strict=True
        ):
            kept.update(packed)
        schemas, channels = unpack_definitions(records)
        version = self._records.get(EPISODE, {}).get("schema_version")
        for schema in schemas:
            self._schemas[schema.id] = schema
            try:
                _require_schema(schema.name, schema.encoding, schema.data, version == "1")
            except FormatError as error:
                yield Problem(None, f"schema {schema.name}", "one that can be read", str(error))
        for channel in channels:
            self._channels[channel.id] = channel
            encoding, schema_id = channel.message_encoding, channel.schema_id
            if encoding != MESSAGE_ENCODING or schema_id not in self._schemas:
                wanted = f"{MESSAGE_ENCODING}, and its schema before it"
                yield Problem(None, f"channel {channel.topic}", wanted, f"{channel}")


def _unlike(
    indexes: Sequence[memoryview], found: dict[int, list[tuple[int, int]]]
) -> Iterator[Problem]:
    """Message indexes that do not say what is in their chunk."""
    for content in indexes:
        index = MessageIndex.read(ReadDataStream(BytesIO(content)))
        wanted = found.pop(index.channel_id, [])
        if index.records != wanted:
            name = f"message index of channel {index.channel_id}"
            yield Problem(None, name, f"{wanted}", f"{index.records}")
    for channel in found:
        name = f"message index of channel {channel}"
        yield Problem(None, name, "one after its chunk", "none")


@lru_cache(maxsize=64)
def schemas_fit(records: bytes) -> bool:
    """Whether the schemas among some records of a file of the present version can be read, and are
    those that episodes are decoded by.
    """
    try:
        for schema in unpack_definitions(records)[0]:
            _require_schema(schema.name, schema.encoding, schema.data, False)
    except FormatError:
        return False
    return True


@lru_cache(maxsize=256)
def _require_schema(name: str, encoding: str, text: bytes, first: bool) -> None:
    """Hold a schema to being one that can be read, and those that every episode is decoded by to
    their fields, in the first version or in the present one.
    """
    columns = parsed(name, encoding, text)
    for message in (V1_STEP if first else STEP, FINAL):
        if message.name == name:
            require_fields(name, columns, message.fields)


@lru_cache(maxsize=64)
def _raw(records: bytes) -> tuple[dict[bytes, None], dict[bytes, None]]:
    """The schemas and the channels among some records, as they stand there: the same few bytes in
    every file.
    """
    kinds: dict[int, dict[bytes, None]] = {Opcode.SCHEMA: {}, Opcode.CHANNEL: {}}
    for span in walk(records, 0):
        kinds[span.opcode][records[span.start - RECORD_HEAD.size : span.end]] = None
    return kinds[Opcode.SCHEMA], kinds[Opcode.CHANNEL]


def _compared(wanted: bytes, got: bytes) -> Iterator[Problem]:
    """Records of a summary that are not those that the data section deserves, kind by kind."""
    ours, theirs = _by_kind(wanted), _by_kind(got)
    for kind, records in ours.items():
        for index, (a, b) in enumerate(zip_longest(records, theirs[kind])):
            if a != b:
                yield Problem(None, f"summary {kind.__name__} {index}", f"{a}", f"{b}")


def _by_kind(records: bytes) -> dict[Any, list[McapRecord]]:
    found: dict[Any, list[McapRecord]] = {kind: [] for kind in _KINDS.values()}
    for span in walk(records, 0):
        if span.opcode in _KINDS:
            kind = _KINDS[span.opcode]
            found[kind].append(kind.read(_stream(records, span)))
    return found


def _stream(data: bytes, span: Span) -> ReadDataStream:
    return ReadDataStream(BytesIO(data[span.start : span.end]))
