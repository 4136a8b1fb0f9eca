"""The records of one file: what it holds, before it is decoded.

A file of our own layout is walked by its chunks; of one that another MCAP tool has written again
everything is taken as it comes: definitions and messages between chunks or without any, lz4 or no
compression, CRCs that are absent, records in another order. What all chunks of a file say they
expand to is bounded by the file's own size before one of them is expanded.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field

from mcap.opcode import Opcode

from coordlog.errors import FormatError, TruncatedError
from coordlog.record.chunk import (
    definitions,
    expand,
    has_crc,
    indexed,
    split,
    uncompressed_size,
)
from coordlog.record.messages import Stream
from coordlog.record.metadata import EPISODE, RESULT
from coordlog.record.opening import PREFIX, is_own, no_marker, summary_start
from coordlog.record.records import (
    DATA_END,
    MAGIC,
    RECORD_HEAD,
    TAIL_SIZE,
    Span,
    unpack_definitions,
    unpack_metadata,
    walk,
)
from coordlog.record.schema import parsed
from coordlog.spec import FINAL, STEP, TASK_TOPIC

MOST = 1 << 31
"""Bytes that all chunks of a file may expand to."""
RATIO, SPARE = 200, 1 << 26
"""They may expand to so many times the file's own size, and some more: states do not compress."""


@dataclass
class Contents:
    """The records of one file, expanded but not decoded; messages by topic."""

    metadata: dict[str, Mapping[str, str]] = field(default_factory=dict)
    messages: dict[str, list[bytes]] = field(default_factory=dict)
    topics: dict[int, str] = field(default_factory=dict)
    """topic of each channel defined so far"""
    schemas: dict[int, tuple[str, str, bytes]] = field(default_factory=dict)
    """name, encoding and text of each schema defined so far"""
    declared: dict[str, int] = field(default_factory=dict)
    """schema of each topic"""
    own: bool = True
    """Whether the file is of our own layout."""
    sure: bool = True
    """Whether every chunk had a CRC."""

    def add_chunk(self, data: bytes) -> None:
        """Add all messages of an expanded chunk, and the channels that it defines."""
        between: list[bytes] = []
        messages = split(data, self.define(data), between)
        self.learn(b"".join(between))
        for channel, records in messages.items():
            self._add(channel, records)

    def add_indexed(self, data: bytes, index: memoryview) -> None:
        """Add the messages of one channel of an expanded chunk, given its message index, if its
        topic is one of rows (`is_of_rows`).
        """
        if is_of_rows(self.topics.get(int.from_bytes(index[:2], "little"), "")):
            self._add(*indexed(data, index))

    def add_message(self, record: bytes) -> None:
        """Add a message that stands outside any chunk."""
        start = RECORD_HEAD.size
        self._add(int.from_bytes(record[start : start + 2], "little"), [record])
        self.sure = False

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record.

        Raises:
            FormatError: if there is another one of coordlog's with that name.
        """
        if name.startswith(PREFIX) and self.metadata.get(name, values) != values:
            raise FormatError(
                f"metadata {name}: two records that differ: files of several episodes in one; "
                "take the files it was merged from"
            )
        self.metadata[name] = values

    def define(self, data: bytes) -> int:
        """Learn the channels that an expanded chunk defines; where its messages start."""
        records = definitions(data)
        self.learn(records)
        return len(records)

    def learn(self, records: bytes) -> None:
        """Learn the channels and schemas that some records define."""
        schemas, channels = unpack_definitions(records)
        for schema in schemas:
            self.schemas[schema.id] = (schema.name, schema.encoding, schema.data)
        for channel in channels:
            self.topics[channel.id] = channel.topic
            self.declared[channel.topic] = channel.schema_id

    def stream(self, topic: str) -> Stream:
        """The messages of a topic and the fields that its schema declares; of a file that another
        tool wrote in the order of their log time.

        Raises:
            FormatError: if the schema is missing, or cannot be read.
        """
        records = self.messages.get(topic, [])
        if not records:
            return Stream((), [])
        schema = self.schemas.get(self.declared[topic])
        if schema is None:
            raise FormatError(f"topic {topic}: its schema is missing")
        if not self.own:
            records = _by_time(records)
        return Stream(parsed(*schema), records)

    def _add(self, channel: int, records: list[bytes]) -> None:
        if channel not in self.topics:
            raise FormatError(f"chunk: messages of an undefined channel {channel}")
        self.messages.setdefault(self.topics[channel], []).extend(records)


def _by_time(records: list[bytes]) -> list[bytes]:
    """Records in the order of their log time, of one channel id."""
    start = RECORD_HEAD.size
    channel = records[0][start : start + 2]
    return [
        record if record[start : start + 2] == channel else _on(record, channel)
        for record in sorted(records, key=lambda record: record[start + 6 : start + 14][::-1])
    ]


def _on(record: bytes, channel: bytes) -> bytes:
    return record[: RECORD_HEAD.size] + channel + record[RECORD_HEAD.size + 2 :]


def is_of_rows(topic: str) -> bool:
    """Whether a topic holds columns of steps: the core's, the final state, or a task's."""
    return topic in (STEP.topic, FINAL.topic) or topic.startswith(TASK_TOPIC)


def contents(data: bytes, *, verify: bool = True, rows: bool = False) -> Contents:
    """The records of a finished file.

    Args:
        data: All of its bytes.
        verify: Refuse a chunk whose CRC differs, and metadata of version 1 that the CRC of the
            data section does not vouch for.
        rows: Look only at the topics that hold columns of steps, found through the message
            indexes. Of a file that another tool wrote everything is looked at.

    Raises:
        TruncatedError: if there is no commit marker.
        FormatError: if a record is damaged, or the file would expand to more than its size allows.
    """
    view = memoryview(data)
    spans = list(walk(view))
    own = is_own(data, spans)
    found = Contents(own=own)
    stop = summary_start(view[-TAIL_SIZE:], len(data)) if own else len(data)
    require_room(view, spans)
    chunk, at = b"", len(MAGIC)
    for span in spans:
        if span.end > stop:
            break
        content, at = view[span.start : span.end], span.end
        if span.opcode == Opcode.METADATA:
            found.add_metadata(*unpack_metadata(bytes(content)))
        elif span.opcode == Opcode.CHUNK:
            chunk = expand(content, verify=verify)
            found.sure &= has_crc(content)
            if not rows or not own:
                found.add_chunk(chunk)
            else:
                found.define(chunk)
        elif span.opcode == Opcode.MESSAGE_INDEX and rows and own:
            found.add_indexed(chunk, content)
        elif span.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            found.learn(bytes(view[span.start - RECORD_HEAD.size : span.end]))
        elif span.opcode == Opcode.MESSAGE:
            found.add_message(bytes(view[span.start - RECORD_HEAD.size : span.end]))
        elif span.opcode == Opcode.DATA_END and not own:
            stop = at
            break
    if at != stop:
        if not own and RESULT not in found.metadata:
            raise TruncatedError(no_marker(len(data)))
        raise FormatError(
            f"the record at byte {at} is damaged; `coordlog recover` keeps what comes before it"
        )
    if verify and own and found.metadata.get(EPISODE, {}).get("schema_version") == "1":
        end = stop - DATA_END.size
        require_crc(view[end:stop], zlib.crc32(view[:end]))
    return found


def room_of(size: int) -> int:
    """Bytes that all chunks of a file of `size` bytes may expand to."""
    return min(MOST, size * RATIO + SPARE)


def require_room(view: memoryview, spans: list[Span]) -> None:
    """Hold what all chunks of a file say that they expand to to its size, before one of them is.

    Raises:
        FormatError: if that is more than an episode can be.
    """
    room = room_of(len(view))
    chunks = (view[span.start : span.end] for span in spans if span.opcode == Opcode.CHUNK)
    total = sum(map(uncompressed_size, chunks))
    if total > room:
        raise FormatError(
            f"chunks that expand to {total} bytes, in a file of {len(view)}: expected at most "
            f"{room}; not an episode"
        )


def require_crc(data_end: bytes | memoryview, got: int) -> None:
    """Hold what a data section's last record says its CRC is to what it is.

    Raises:
        FormatError: if it is another.
    """
    opcode, _, crc = DATA_END.unpack(data_end)
    if opcode != Opcode.DATA_END or crc != got:
        raise FormatError(
            f"data section: expected CRC {crc:08x}, got {got:08x}: a bit of the metadata or of a "
            "message is wrong; `coordlog check` says which, `coordlog recover` may put it back"
        )
