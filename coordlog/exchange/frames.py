"""The serialized messages of one topic of a ROS 2 bag, as bytes side by side.

Messages of one length become the rows of one array: an MCAP chunk is cut by its message indexes in
a few NumPy calls, instead of a Python call per message.

Source: MCAP specification, mcap.dev/spec; rosbag2_storage_sqlite3.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from numpy.lib.stride_tricks import sliding_window_view

from coordlog.episode import Array
from coordlog.errors import FormatError
from coordlog.record.chunk import expand
from coordlog.record.records import MAGIC, walk

_INDEX = np.dtype([("time", "<u8"), ("offset", "<u8")])
BATCH = 512
"""Rows that are taken from sqlite3 at a time: few enough to stay in the processor's cache."""
_HEAD = 9 + 22
"""Bytes of a message record before its payload: opcode, length, channel, sequence, two times."""


class Part(NamedTuple):
    """Some messages of a topic as they were written: few enough to stay in the cache."""

    times: Array
    """(n,) int64: log times [ns]"""
    groups: list[tuple[Array, Array]]
    """places (m,) and bytes (m, length) uint8 of the messages of one length"""


def of_files(files: Sequence[Path], topic: str) -> Iterator[Part]:
    """Read a topic from the files of a bag, MCAP or sqlite3, in the order in which it was written.

    Sorted by their times, the messages of a clock that was set back would be mixed.

    Raises:
        FormatError: if a file is damaged, or compresses its messages one by one.
    """
    for file in files:
        yield from (_sqlite3 if file.suffix.lower() == ".db3" else _mcap)(file, topic)


def _mcap(file: Path, topic: str) -> Iterator[Part]:
    try:
        with file.open("rb") as stream:
            summary = make_reader(stream).get_summary()
    except (McapError, OSError, EOFError) as error:
        raise FormatError(f"{file}: not an MCAP file that can be read: {error}") from error
    if summary is None:
        raise FormatError(
            f"{file}: ends without its summary: it was cut off; `mcap recover` mends it"
        )
    channels = {item.id for item in summary.channels.values() if item.topic == topic}
    found = 0
    for part in _parts(file, channels):
        found += len(part.times)
        yield part
    if summary.statistics is not None:
        counts = summary.statistics.channel_message_counts
        wanted = sum(count for channel, count in counts.items() if channel in channels)
        if found != wanted:
            raise FormatError(
                f"{file}: {topic}: expected {wanted} messages, as its summary says, got {found}: "
                "`mcap recover` writes it anew"
            )


def _parts(file: Path, channels: set[int]) -> Iterator[Part]:
    """The messages of some channels: of a chunk at once through its indexes, if it has any."""
    view = memoryview(file.read_bytes())
    chunk = b""
    indexes: list[memoryview] = []
    alone: list[tuple[int, bytes]] = []  # messages without an index
    for span in walk(view, len(MAGIC)):
        content = view[span.start : span.end]
        if span.opcode == Opcode.MESSAGE_INDEX:
            indexes.append(content)
            continue
        if chunk and indexes:
            own = [each[6:] for each in indexes if _channel(each) in channels]
            if own:
                yield _indexed(file, chunk, own)
        elif chunk:
            inside = (chunk[s.start : s.end] for s in walk(chunk, 0) if s.opcode == Opcode.MESSAGE)
            alone += (_message(each) for each in inside if _channel(each) in channels)
        chunk, indexes = b"", []
        if span.opcode == Opcode.MESSAGE and _channel(content) in channels:
            alone.append(_message(content))
        elif alone:
            yield _side_by_side(alone)
            alone = []
        if span.opcode == Opcode.CHUNK:
            chunk = _expanded(file, content)


def _channel(content: bytes | memoryview) -> int:
    return int.from_bytes(content[:2], "little")


def _message(content: bytes | memoryview) -> tuple[int, bytes]:
    """Log time and payload of a message record."""
    return int.from_bytes(content[6:14], "little"), bytes(content[22:])


def _expanded(file: Path, content: memoryview) -> bytes:
    try:
        return expand(content, verify=True)
    except FormatError as error:
        raise FormatError(f"{file}: {error}") from error


def _indexed(file: Path, chunk: bytes, indexes: Sequence[memoryview]) -> Part:
    """The messages that message indexes point at, in the order in which they stand.

    Indexes may be sorted by time, and there is one for each publisher.
    """
    if any(len(index) % _INDEX.itemsize for index in indexes):
        raise FormatError(f"{file}: a message index that ends within an entry")
    entries = np.frombuffer(b"".join(indexes), _INDEX)
    entries = entries[np.argsort(entries["offset"], kind="stable")]
    data = np.frombuffer(chunk, np.uint8)
    offsets = entries["offset"].astype(np.int64)
    if len(offsets) and offsets.max() + _HEAD > len(data):
        raise FormatError(f"{file}: a message index points beyond its chunk")
    heads = sliding_window_view(data, 8)[offsets + 1]
    sizes = np.ascontiguousarray(heads).view("<u8")[:, 0].astype(np.int64) - 22
    if len(sizes) and ((sizes < 0).any() or (offsets + _HEAD + sizes > len(data)).any()):
        raise FormatError(f"{file}: a message that is longer than its chunk")
    groups = [
        (places, sliding_window_view(data, size)[offsets[places] + _HEAD])
        for size, places in _by_size(sizes)
    ]
    return Part(entries["time"].astype(np.int64), groups)


def _sqlite3(file: Path, topic: str) -> Iterator[Part]:
    require_whole(file)
    try:
        connection = sqlite3.connect(f"file:{file}?mode=ro&immutable=1", uri=True)
    except sqlite3.Error as error:
        raise FormatError(f"{file}: {error}") from error
    try:
        connection.execute(f"pragma mmap_size = {file.stat().st_size}")
        rows = connection.execute(
            "select timestamp, data from messages where topic_id in "
            "(select id from topics where name = ?) order by id",
            (topic,),
        )
        while found := rows.fetchmany(BATCH):
            yield _side_by_side(found)
    except (sqlite3.Error, TypeError, ValueError, OverflowError) as error:
        raise FormatError(f"{file}: not an sqlite3 bag that can be read: {error}") from error
    finally:
        connection.close()


def _side_by_side(rows: Sequence[tuple[int, bytes]]) -> Part:
    """Messages that came one by one, those of one length together."""
    times, payloads = zip(*rows, strict=True)
    sizes = np.fromiter(map(len, payloads), np.int64, len(payloads))
    groups = []
    for size, places in _by_size(sizes):
        joined = b"".join([payloads[i] for i in places.tolist()])
        groups.append((places, np.frombuffer(joined, np.uint8).reshape(len(places), size)))
    return Part(np.array(times, np.int64), groups)


def require_whole(file: Path) -> None:
    """Hold an MCAP or sqlite3 file to be there to its end; other files are let through.

    SQLite opens a file that was cut off and gives the rows that are left: look at its size.

    Raises:
        FormatError: if it is empty, of another kind, or was cut off.
    """
    if file.suffix not in (".mcap", ".db3") or not file.is_file():
        return
    with file.open("rb") as stream:
        head = stream.read(100)
        stream.seek(max(file.stat().st_size - len(MAGIC), 0))
        tail = stream.read()
    if not head:
        raise FormatError(f"{file}: the file is empty")
    if file.suffix == ".mcap":
        if not head.startswith(MAGIC):
            raise FormatError(f"{file}: expected an MCAP file, got one that begins otherwise")
        if tail != MAGIC or file.stat().st_size < 2 * len(MAGIC):
            raise FormatError(
                f"{file}: ends without MCAP's closing bytes: it was cut off; `mcap recover` mends "
                "it"
            )
        return
    if not head.startswith(b"SQLite format 3\0"):
        raise FormatError(
            f"{file}: expected an sqlite3 file, got one that begins otherwise: another kind, or "
            "encrypted"
        )
    page = int.from_bytes(head[16:18], "big")
    wanted = (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big")
    size = file.stat().st_size
    if len(head) < 100 or size < wanted:
        raise FormatError(f"{file}: expected {wanted} bytes, got {size}: the file was cut off")


def _by_size(sizes: Array) -> Iterator[tuple[int, Array]]:
    for size in np.unique(sizes).tolist():
        yield int(size), np.flatnonzero(sizes == size)
