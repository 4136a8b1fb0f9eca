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
_HEAD = 9 + 22
"""Bytes of a message record before its payload: opcode, length, channel, sequence, two times."""


class Frames(NamedTuple):
    """All messages of a topic in the order of their log times."""

    times: Array
    """(n,) int64 ns"""
    groups: list[tuple[Array, Array]]
    """places (m,) and bytes (m, length) uint8 of the messages of one length"""


def of_files(files: Sequence[Path], topic: str) -> Frames:
    """Read a topic from the files of a bag, MCAP or sqlite3.

    Raises:
        FormatError: if a file is damaged, or compresses its messages one by one.
    """
    times: list[Array] = []
    rows: list[tuple[Array, Array]] = []
    count = 0
    for file in files:
        read = _sqlite3 if file.suffix == ".db3" else _mcap
        for own, groups in read(file, topic):
            times.append(own)
            rows += [(places + count, data) for places, data in groups]
            count += len(own)
    whole = np.concatenate(times) if times else np.zeros(0, np.int64)
    rank = np.empty(count, np.int64)
    rank[np.argsort(whole, kind="stable")] = np.arange(count)
    merged: dict[int, list[tuple[Array, Array]]] = {}
    for places, data in rows:
        merged.setdefault(data.shape[1], []).append((places, data))
    if len(rows) == 1:
        return Frames(np.sort(whole), [(rank[rows[0][0]], rows[0][1])])
    groups = [
        (rank[np.concatenate([each[0] for each in parts])], np.concatenate([e[1] for e in parts]))
        for parts in merged.values()
    ]
    return Frames(np.sort(whole), groups)


_Part = tuple[Array, list[tuple[Array, Array]]]


def _mcap(file: Path, topic: str) -> Iterator[_Part]:
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
    view = memoryview(file.read_bytes())
    chunk = b""
    for span in walk(view, len(MAGIC)):
        content = view[span.start : span.end]
        if span.opcode == Opcode.CHUNK:
            chunk = expand(content, verify=True)
        elif span.opcode == Opcode.MESSAGE_INDEX:
            if int.from_bytes(content[:2], "little") in channels:
                yield _indexed(file, chunk, content)
        elif span.opcode == Opcode.MESSAGE and int.from_bytes(content[:2], "little") in channels:
            time = np.array([int.from_bytes(content[6:14], "little")], np.int64)
            payload = np.frombuffer(content[22:], np.uint8)[None]
            yield time, [(np.zeros(1, np.int64), payload)]


def _indexed(file: Path, chunk: bytes, content: memoryview) -> _Part:
    """The messages that a message index points at."""
    entries = np.frombuffer(content[6:], _INDEX)
    data = np.frombuffer(chunk, np.uint8)
    offsets = entries["offset"].astype(np.int64)
    if len(offsets) and offsets.max() + _HEAD > len(data):
        raise FormatError(f"{file}: a message index points beyond its chunk")
    heads = sliding_window_view(data, 8)[offsets + 1]
    sizes = np.ascontiguousarray(heads).view("<u8")[:, 0].astype(np.int64) - 22
    if len(sizes) and ((sizes < 0).any() or (offsets + _HEAD + sizes > len(data)).any()):
        raise FormatError(f"{file}: a message that is longer than its chunk")
    return entries["time"].astype(np.int64), [
        (places, sliding_window_view(data, size)[offsets[places] + _HEAD])
        for size, places in _by_size(sizes)
    ]


def _sqlite3(file: Path, topic: str) -> Iterator[_Part]:
    require_whole(file)
    try:
        connection = sqlite3.connect(f"file:{file}?mode=ro&immutable=1", uri=True)
    except sqlite3.Error as error:
        raise FormatError(f"{file}: {error}") from error
    try:
        ids = connection.execute("select id from topics where name = ?", (topic,)).fetchall()
        query = "select timestamp, data from messages where topic_id = ?"
        found = [row for one in ids for row in connection.execute(query, one).fetchall()]
    except sqlite3.Error as error:
        raise FormatError(f"{file}: not an sqlite3 bag that can be read: {error}") from error
    finally:
        connection.close()
    sizes = np.array([len(data) for _, data in found], np.int64)
    groups = []
    for size, places in _by_size(sizes):
        joined = b"".join(found[i][1] for i in places.tolist())
        groups.append((places, np.frombuffer(joined, np.uint8).reshape(len(places), size)))
    yield np.array([time for time, _ in found], np.int64), groups


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
