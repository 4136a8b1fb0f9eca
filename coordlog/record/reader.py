"""Episode files back to memory.

`read_episode` takes the file in one read, walks its records, expands and splits the chunks, and
decodes each topic with one `np.frombuffer`; every chunk's CRC is verified. `read_header`,
`read_result` and `read_summary` touch only the two ends. A file that is not a finished coordlog
episode is refused in one sentence that says what it is instead.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from coordlog.episode import Array, Episode, Header, Path, Result
from coordlog.errors import FormatError, TruncatedError
from coordlog.record.chunk import definitions, expand, indexed, split
from coordlog.record.messages import decode_contacts, decode_final, decode_path, decode_steps
from coordlog.record.metadata import (
    HEADER_RECORDS,
    RESULT,
    decode_header,
    decode_result,
    require_version,
)
from coordlog.record.opening import (
    File,
    load,
    naming,
    no_marker,
    opened,
    require_coordlog,
    summary_start,
    verify_summary,
)
from coordlog.record.records import (
    MAGIC,
    RECORD_HEAD,
    TAIL_SIZE,
    unpack_attachment,
    unpack_definitions,
    unpack_metadata,
    walk,
)
from coordlog.spec import CONTACTS, FINAL, KNOT, SPLINE, STEP

_HEAD = (
    1 << 16
)  # enough for the opening metadata of any robot we know; more is read where it is not


class Summary(NamedTuple):
    """What the two ends of a file say, without its messages."""

    header: Header
    result: Result
    size: int
    """bytes"""


@dataclass
class Contents:
    """The records of one file, expanded but not decoded; messages by topic."""

    metadata: dict[str, Mapping[str, str]] = field(default_factory=dict)
    messages: dict[str, list[bytes]] = field(default_factory=dict)
    topics: dict[int, str] = field(default_factory=dict)
    """topic of each channel defined so far"""

    def add_chunk(self, data: bytes) -> None:
        """Add all messages of an expanded chunk, and the channels that it defines."""
        for channel, records in split(data, self.define(data)).items():
            self._add(channel, records)

    def add_indexed(self, data: bytes, index: memoryview, topics: frozenset[str]) -> None:
        """Add the messages of one channel of an expanded chunk, given its message index, if it is
        on one of these topics.
        """
        if self.topics.get(int.from_bytes(index[:2], "little")) in topics:
            self._add(*indexed(data, index))

    def define(self, data: bytes) -> int:
        """Learn the channels that an expanded chunk defines; where its messages start."""
        records = definitions(data)
        self.topics |= {channel.id: channel.topic for channel in unpack_definitions(records)[1]}
        return len(records)

    def _add(self, channel: int, records: list[bytes]) -> None:
        if channel not in self.topics:
            raise FormatError(f"chunk: messages of an undefined channel {channel}")
        self.messages.setdefault(self.topics[channel], []).extend(records)


def read_header(path: File) -> Header:
    """The metadata an episode started with; of a part file too.

    Raises:
        FormatError: if the file is not a coordlog episode of a version this release reads.
    """
    with opened(path) as fd:
        return _header(fd)


def read_result(path: File) -> Result:
    """How a finished episode ended.

    Raises:
        TruncatedError: if there is no commit marker.
        FormatError: if the file is not a coordlog episode of a version this release reads.
    """
    return read_summary(path).result


def read_summary(path: File) -> Summary:
    """Header, result and size of a finished episode, from a few small reads at both ends of the
    file.

    Raises:
        TruncatedError: if there is no commit marker.
        FormatError: if the file is not a coordlog episode of a version this release reads.
    """
    with opened(path) as fd:
        header, size = _header(fd), os.fstat(fd).st_size
        start = summary_start(os.pread(fd, TAIL_SIZE, max(size - TAIL_SIZE, 0)), size)
        summary = memoryview(os.pread(fd, size - start, start))
        verify_summary(summary)
        for span in walk(summary, 0):
            offset, length = (
                _metadata_index(summary[span.start : span.end], RESULT)
                if span.opcode == Opcode.METADATA_INDEX
                else (0, 0)
            )
            if length:
                content = os.pread(fd, length, offset)[RECORD_HEAD.size :]
                return Summary(header, decode_result(unpack_metadata(content)[1]), size)
        raise TruncatedError(no_marker(size))


def probe(path: File) -> int:
    """Size in bytes of what looks like a finished episode, from one read at each end of the file.

    Raises:
        TruncatedError: if it does not end as a finished file.
        FormatError: if it is not a coordlog episode of a version this release reads.
    """
    with opened(path) as fd:
        size, head = os.fstat(fd).st_size, memoryview(os.pread(fd, 4096, 0))
        require_coordlog(head)
        summary_start(os.pread(fd, TAIL_SIZE, max(size - TAIL_SIZE, 0)), size)
        first = next((span for span in walk(head) if span.opcode == Opcode.METADATA), None)
        if first is None:
            _header(fd)
        else:
            require_version(unpack_metadata(bytes(head[first.start : first.end]))[1])
        return size


def read_episode(path: File, *, verify: bool = True) -> Episode:
    """A finished episode.

    Args:
        path: The file.
        verify: Refuse a chunk whose CRC differs; False decodes it all the same, to find out what is
            damaged.

    Raises:
        TruncatedError: if there is no commit marker.
        FormatError: if the file is foreign, damaged, or of a version this release does not read.
    """
    data = load(path)
    with naming(path):
        return decode(contents(data, verify=verify))


def read_attachments(path: File) -> dict[str, bytes]:
    """The attachments of an episode, finished or not, by name; CRCs verified.

    Raises:
        FormatError: if the file is not a coordlog episode, or an attachment is damaged.
    """
    data = load(path)
    with naming(path):
        return attachments_of(data)


def attachments_of(content: bytes) -> dict[str, bytes]:
    """The attachments in the bytes of a file, by name; CRCs verified.

    Raises:
        FormatError: if one is damaged.
    """
    data = memoryview(content)
    found = [
        unpack_attachment(data[span.start : span.end])
        for span in walk(data)
        if span.opcode == Opcode.ATTACHMENT
    ]
    return dict(found)


def contents(data: bytes, *, verify: bool = True, only: frozenset[str] | None = None) -> Contents:
    """The records of a finished file.

    Args:
        data: All of its bytes.
        verify: Refuse a chunk whose CRC differs.
        only: Look at these topics alone, found through the message indexes; their messages must be
            of one length.

    Raises:
        TruncatedError: if there is no commit marker.
        FormatError: if a record is damaged.
    """
    view, found, chunk, at = memoryview(data), Contents(), b"", len(MAGIC)
    stop = summary_start(view[-TAIL_SIZE:], len(data))
    for span in walk(view, stop=stop):
        content, at = view[span.start : span.end], span.end
        if span.opcode == Opcode.METADATA:
            name, values = unpack_metadata(bytes(content))
            found.metadata[name] = values
        elif span.opcode == Opcode.CHUNK:
            chunk = expand(content, verify=verify)
            if only is None:
                found.add_chunk(chunk)
            else:
                found.define(chunk)
        elif span.opcode == Opcode.MESSAGE_INDEX and only is not None:
            found.add_indexed(chunk, content, only)
    if at != stop:
        raise FormatError(
            f"the record at byte {at} is damaged; `coordlog recover` keeps what comes before it"
        )
    return found


def decode(found: Contents) -> Episode:
    """The episode out of a file's records.

    Raises:
        FormatError: if messages are missing, of another size, or not in order.
    """
    header = decode_header(found.metadata)
    if RESULT not in found.metadata:
        raise TruncatedError(
            "ends without its commit marker; recover what is complete with `coordlog recover`"
        )
    result = decode_result(found.metadata[RESULT])
    layout, messages = header.layout, found.messages
    steps = decode_steps(messages.get(STEP.topic, []), layout)
    final = decode_final(messages.get(FINAL.topic, []), layout)
    require_order(steps["step"], final["step"], np.array([result.length]))
    both = {
        item.name: np.concatenate([steps.pop(item.name), final[item.name]]) for item in FINAL.fields
    }
    columns: dict[str, Array] = {**steps, **both}
    del columns["step"]
    path: Path | None = None
    if KNOT.topic in messages and SPLINE.topic in messages:
        path = decode_path(messages[KNOT.topic], messages[SPLINE.topic], layout)
    contacts = decode_contacts(messages.get(CONTACTS.topic, []), layout)
    return Episode(header=header, result=result, contacts=contacts, path=path, **columns)


def require_order(steps: Array, finals: Array, lengths: Array) -> None:
    """Hold the step numbers of one or more episodes to 0, 1, … and their final states to the
    lengths.

    Raises:
        FormatError: naming the first step that is not the next one.
    """
    total = int(lengths.sum())
    if len(finals) != len(lengths) or (finals != lengths).any() or len(steps) != total:
        raise FormatError(
            f"expected {lengths.tolist()} steps and a final state, got {len(steps)} steps and final states {finals.tolist()}"
        )
    wanted = np.arange(total) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    if (steps != wanted).any():
        row = int(np.flatnonzero(steps != wanted)[0])
        raise FormatError(f"step: expected {wanted[row]}, got {steps[row]}")


def _header(fd: int) -> Header:
    for size in (_HEAD, os.fstat(fd).st_size):
        data = memoryview(os.pread(fd, size, 0))
        require_coordlog(data)
        records: dict[str, Mapping[str, str]] = {}
        for span in walk(data):
            if span.opcode == Opcode.METADATA:
                name, values = unpack_metadata(bytes(data[span.start : span.end]))
                records[name] = values
            elif records:
                return decode_header(records)
        if set(HEADER_RECORDS) <= set(records):
            return decode_header(records)
    raise TruncatedError("ends within its opening metadata: nothing to recover")


def _metadata_index(content: memoryview, name: str) -> tuple[int, int]:
    """Offset and length of a metadata record if this index entry is of that name, else zeros."""
    if bytes(content[20:]) != name.encode():
        return 0, 0
    return int.from_bytes(content[:8], "little"), int.from_bytes(content[8:16], "little")
