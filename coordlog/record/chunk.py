"""Columns of one topic ↔ MCAP message records ↔ the chunk they are stored in.

A chunk here holds one block of control steps: first the definitions (schemas and channels) that it
is the first to use, then the messages of every topic in the order of their log time. Building one
costs a few NumPy calls per topic instead of a Python call per message.

Source: MCAP specification, mcap.dev/spec, records Message (0x05), Chunk (0x06) and Message Index
(0x07).
"""

from __future__ import annotations

import struct
import threading
import zlib
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.opcode import Opcode

from coordlog.episode import Array
from coordlog.errors import FormatError
from coordlog.record.cdr import Codec
from coordlog.record.records import RECORD_HEAD, walk

COMPRESSION, LEVEL = "zstd", -1
"""Mantissas of float64 states do not compress, whatever the effort: level 1 saves 3 % and takes
four times as long to expand."""

MAX_CHUNK = 1 << 30
"""Largest chunk we expand, in bytes: a damaged size must not exhaust the memory."""

_CHUNK_HEAD = struct.Struct("<QQQI")  # start time, end time, uncompressed size, uncompressed crc
_MESSAGE_HEAD = struct.Struct("<BQH")
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
_PREFIX = {
    "opcode": "u1",
    "length": "<u8",
    "channel": "<u2",
    "sequence": "<u4",
    "log_time": "<u8",
    "publish_time": "<u8",
}
PREFIX_SIZE = 31
_HEAD_DTYPE = np.dtype([*_PREFIX.items()])
_OPENING = np.dtype([("channel", "<u2"), ("size", "<u4")])
"""How a message index begins: entries follow."""

_local = threading.local()


class Rows:
    """Records of one length, side by side: copied all at once, and one by one only when asked."""

    def __init__(self, whole: Array) -> None:
        """Take (n,) entries of a type that is as long as a record."""
        self.whole, self.size = whole, whole.dtype.itemsize

    def __len__(self) -> int:
        return len(self.whole)

    def __iter__(self) -> Iterator[memoryview]:
        data = self.whole.view(np.uint8).data
        return (data[at : at + self.size] for at in range(0, len(data), self.size))

    def payloads(self) -> Array:
        """What follows the heads of the messages, (n, bytes)."""
        found: Array = self.whole.view(np.uint8).reshape(len(self), self.size)[:, PREFIX_SIZE:]
        return found


class Batch(NamedTuple):
    """Messages of one channel in the order of their log time: complete MCAP records."""

    channel: int
    log_time: Array  # (n,) uint64, ns
    records: Sequence[bytes | memoryview] | Rows


class Head(NamedTuple):
    """What stands before the compressed bytes of a chunk record."""

    start: int
    """log time of the first message"""
    end: int
    size: int
    """uncompressed"""
    crc: int
    """of the uncompressed bytes; 0 if none was written"""
    compression: bytes
    packed: memoryview


class Expanded(NamedTuple):
    """A chunk as it is read: its head, its content, and the message indexes that follow it."""

    head: Head
    data: bytes
    start: int
    """where the messages begin, after the definitions"""
    indexes: list[memoryview]


class Chunk(NamedTuple):
    """A chunk record, the message index records that follow it, and what the chunk index says about
    them.
    """

    record: bytes
    message_index: bytes
    index_offset: dict[int, int]  # channel → offset in `message_index`
    start: int
    end: int
    compressed_size: int
    uncompressed_size: int
    counts: dict[int, int]  # channel → messages


@lru_cache(maxsize=256)
def _record_dtype(codec: Codec) -> np.dtype[np.void]:
    return np.dtype([*_PREFIX.items(), ("payload", codec.dtype)])


def encode(
    codec: Codec, channel: int, *, log_time: Array, sequence: Array, columns: Mapping[str, Array]
) -> Batch:
    """Message records for n rows of columns; publish time is log time."""
    dtype, n = _record_dtype(codec), len(log_time)
    head = _MESSAGE_HEAD.pack(Opcode.MESSAGE, dtype.itemsize - RECORD_HEAD.size, channel)
    template = head.ljust(PREFIX_SIZE, b"\0") + codec.template
    rows = np.repeat(np.frombuffer(template, dtype), n)
    rows["sequence"], rows["log_time"], rows["publish_time"] = sequence, log_time, log_time
    codec.encode(rows["payload"], columns)
    return Batch(channel, log_time, Rows(rows))


def decode(codec: Codec, records: Sequence[bytes | memoryview]) -> tuple[Array, dict[str, Array]]:
    """Log times (n,) and columns of n message records of one topic.

    Raises:
        FormatError: if a record is not as long as the codec's, or a constant byte differs.
    """
    dtype, data = _record_dtype(codec), b"".join(records)
    wanted = dtype.itemsize - RECORD_HEAD.size
    others = set(map(len, records)) - {dtype.itemsize}
    rows = np.frombuffer(b"" if others else data, dtype)
    if others or (rows["length"] != wanted).any():
        got = next(iter(others)) - RECORD_HEAD.size if others else rows["length"].max()
        raise FormatError(
            f"{codec.name}: expected messages of {wanted} bytes for this robot, got one of {got}"
        )
    if ((rows["opcode"] != Opcode.MESSAGE) | (rows["channel"] != rows["channel"][:1])).any():
        raise FormatError(
            f"{codec.name}: expected messages of one channel, got other records between them"
        )
    return rows["log_time"].copy(), codec.decode(rows["payload"])


def compose(definitions: bytes, batches: Sequence[Batch]) -> Chunk:
    """One chunk out of the messages of several topics, interleaved by log time (equal times: in the
    order given).
    """
    times = np.concatenate([batch.log_time for batch in batches])
    order = np.argsort(times, kind="stable")
    sizes = np.concatenate([_sizes(batch.records) for batch in batches])
    offsets = np.empty(len(sizes), np.int64)
    offsets[order] = len(definitions) + np.cumsum(sizes[order]) - sizes[order]
    data = _placed(definitions, batches, offsets, len(definitions) + int(sizes.sum()))
    packed = _compressor().compress(data)
    start, end = int(times[order[0]]), int(times[order[-1]])
    head = (
        _CHUNK_HEAD.pack(start, end, len(data), zlib.crc32(data))
        + _string(COMPRESSION)
        + struct.pack("<Q", len(packed))
    )
    record = RECORD_HEAD.pack(Opcode.CHUNK, len(head) + len(packed)) + head + packed
    index, index_offset = _message_index(batches, offsets)
    return Chunk(
        record,
        index,
        index_offset,
        start,
        end,
        len(packed),
        len(data),
        {b.channel: len(b.records) for b in batches},
    )


def _sizes(records: Sequence[bytes | memoryview] | Rows) -> Array:
    if isinstance(records, Rows):
        return np.full(len(records), records.size)
    return np.fromiter(map(len, records), np.int64, len(records))


def _placed(definitions: bytes, batches: Sequence[Batch], offsets: Array, size: int) -> memoryview:
    """The content of a chunk: definitions, and every record where it belongs."""
    out = np.empty(size, np.uint8)
    data, first = out.data, 0
    data[: len(definitions)] = definitions
    for _, _, records in batches:
        where = offsets[first : first + len(records)]
        first += len(records)
        if isinstance(records, Rows):  # a place at each byte, of which those are taken
            kind = f"V{records.size}"
            every = np.ndarray((size - records.size + 1,), kind, data, strides=(1,))
            every[where] = records.whole.view(kind)
            continue
        for at, record in zip(where.tolist(), records, strict=True):
            data[at : at + len(record)] = record
    return data


def _message_index(batches: Sequence[Batch], offsets: Array) -> tuple[bytes, dict[int, int]]:
    index, index_offset, first = bytearray(), {}, 0
    for batch in batches:
        entries = np.empty(len(batch.records), _INDEX_ENTRY)
        entries["log_time"], entries["offset"] = (
            batch.log_time,
            offsets[first : first + len(entries)],
        )
        first += len(entries)
        index_offset[batch.channel] = len(index)
        index += (
            _INDEX_HEAD.pack(
                Opcode.MESSAGE_INDEX, 6 + entries.nbytes, batch.channel, entries.nbytes
            )
            + entries.tobytes()
        )
    return bytes(index), index_offset


def unpack_head(content: memoryview) -> Head:
    """A chunk record (given without opcode and length), not expanded yet.

    Raises:
        FormatError: if the record is not well formed.
    """
    try:
        start, end, size, crc = _CHUNK_HEAD.unpack_from(content)
        (name_length,) = struct.unpack_from("<I", content, _CHUNK_HEAD.size)
        at = _CHUNK_HEAD.size + 4 + name_length
        (stored,) = struct.unpack_from("<Q", content, at)
    except struct.error as error:
        raise FormatError(f"chunk: cannot be expanded: {error}") from None
    packed = content[at + 8 :]
    if stored != len(packed):
        raise FormatError(f"chunk: expected {len(packed)} bytes, got {stored}")
    return Head(start, end, size, crc, bytes(content[_CHUNK_HEAD.size + 4 : at]), packed)


def uncompressed_size(content: memoryview) -> int:
    """What a chunk record says that it expands to [bytes].

    Raises:
        FormatError: if the record is not well formed.
    """
    try:
        return int(_CHUNK_HEAD.unpack_from(content)[2])
    except struct.error as error:
        raise FormatError(f"chunk: cannot be expanded: {error}") from None


def expand(content: memoryview, *, verify: bool = True, room: int = MAX_CHUNK) -> bytes:
    """The uncompressed content of a chunk record (given without opcode and length).

    Args:
        content: The record.
        verify: Refuse a chunk whose CRC differs; a CRC of zero is one that was not written.
        room: Largest size that is expanded [bytes].

    Raises:
        FormatError: if it cannot be expanded, is larger than `room`, or its CRC differs.
    """
    head = unpack_head(content)
    if head.size > room:
        raise FormatError(
            f"chunk: says that it expands to {head.size} bytes, more than the {room} that are "
            "left for a file of this size"
        )
    try:
        data = _expanded(head.compression, head.packed, head.size)
    except (zstandard.ZstdError, RuntimeError) as error:
        raise FormatError(f"chunk: cannot be expanded: {error}") from None
    if len(data) != head.size:
        raise FormatError(
            f"chunk: expected {head.size} bytes uncompressed, got {len(data)} or more"
        )
    if verify and head.crc and zlib.crc32(data) != head.crc:
        raise FormatError(f"chunk: expected CRC {head.crc:08x}, got {zlib.crc32(data):08x}")
    return data


def has_crc(content: memoryview) -> bool:
    """Whether a chunk record carries the CRC of its content."""
    return bool(_CHUNK_HEAD.unpack_from(content)[3])


def _expanded(compression: bytes, packed: memoryview, size: int) -> bytes:
    """At most one byte more than `size` of what is packed."""
    if compression == COMPRESSION.encode():
        said = zstandard.frame_content_size(packed)
        if said not in (size, -1):
            raise FormatError(f"chunk: expected {size} bytes, its zstd frame says {said}")
        return _decompressor().decompress(packed, max_output_size=size + 1)
    if compression == b"lz4":
        return bytes(LZ4FrameDecompressor().decompress(bytes(packed), max_length=size + 1))
    if compression == b"":
        return bytes(packed)
    raise FormatError(f"chunk: expected zstd, lz4 or no compression, got {compression!r}")


def definitions(data: bytes) -> bytes:
    """The schema and channel records at the start of an expanded chunk."""
    end = 0
    for span in walk(data, 0):
        if span.opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
            break
        end = span.end
    return data[:end]


def split(data: bytes, start: int, defined: list[bytes] | None = None) -> dict[int, list[bytes]]:
    """The message records of an expanded chunk by channel.

    Args:
        data: The chunk.
        start: Where the definitions at its start end.
        defined: Takes the schema and channel records between messages; without it there must be
            none.

    Raises:
        FormatError: if anything else is in it, or the records do not fill the chunk exactly.
    """
    messages: dict[int, list[bytes]] = {}
    kinds: dict[
        bytes, tuple[list[bytes], int]
    ] = {}  # where records with this head go, and how long they are
    at, size = start, len(data)
    while at + _MESSAGE_HEAD.size <= size:
        head = data[at : at + _MESSAGE_HEAD.size]
        if head not in kinds:
            opcode, length, channel = _MESSAGE_HEAD.unpack(head)
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and defined is not None:
                defined.append(data[at : at + RECORD_HEAD.size + length])
                at += RECORD_HEAD.size + length
                continue
            if opcode != Opcode.MESSAGE:
                raise FormatError(f"chunk: unexpected record {opcode:#x} at byte {at}")
            kinds[head] = messages.setdefault(channel, []), RECORD_HEAD.size + length
        records, length = kinds[head]
        records.append(data[at : at + length])
        at += length
    if at != size:
        raise FormatError(f"chunk: its records end at byte {at} of {size}")
    return messages


def indexed(data: bytes, index: memoryview) -> tuple[int, list[bytes]]:
    """One channel and its message records in an expanded chunk, through its message index; for
    messages of equal length.

    Raises:
        FormatError: if the index points to something else; that every record is a message, `decode`
            verifies.
    """
    try:
        (channel,) = struct.unpack_from("<H", index)
        offsets = np.frombuffer(index[6:], _INDEX_ENTRY)["offset"].tolist()
        opcode, length, found = (
            _MESSAGE_HEAD.unpack_from(data, offsets[0]) if offsets else (Opcode.MESSAGE, 0, channel)
        )
    except (struct.error, ValueError, OverflowError) as error:
        raise FormatError(f"message index: {error}") from None
    if (opcode, found) != (Opcode.MESSAGE, channel):
        raise FormatError(
            f"message index: expected a message of channel {channel} at byte {offsets[0]}, got "
            "another record"
        )
    size = RECORD_HEAD.size + length
    return channel, [data[at : at + size] for at in offsets]


def tiled(chunks: Sequence[Expanded]) -> bool:
    """Whether the message indexes of some chunks say of each message where it is, whose it is and
    when it was logged, and the messages fill each chunk in the order of the log times that its head
    has: all of them at once. Of a chunk without messages, or in which definitions stand between
    messages, that is not said.
    """
    indexes = [index for chunk in chunks for index in chunk.indexes]
    if not all(chunk.indexes for chunk in chunks) or min(map(len, indexes)) < _OPENING.itemsize:
        return False
    head = np.frombuffer(b"".join(index[: _OPENING.itemsize] for index in indexes), _OPENING)
    sizes = np.array([len(index) - _OPENING.itemsize for index in indexes])
    whose = np.repeat(np.arange(len(chunks)), [len(chunk.indexes) for chunk in chunks])
    pairs = set(zip(whose.tolist(), head["channel"].tolist(), strict=True))
    if (sizes != head["size"]).any() or (sizes % _INDEX_ENTRY.itemsize).any():
        return False
    if len(pairs) < len(indexes):
        return False
    entries = np.frombuffer(b"".join(index[_OPENING.itemsize :] for index in indexes), _INDEX_ENTRY)
    counts = sizes // _INDEX_ENTRY.itemsize
    lengths = np.array([len(chunk.data) for chunk in chunks])
    of = np.repeat(whose, counts)  # the chunk of each message
    if not np.bincount(of, minlength=len(chunks)).all():
        return False
    if (entries["offset"] > np.maximum(lengths - PREFIX_SIZE, 0).astype("<u8")[of]).any():
        return False
    bases = np.cumsum(lengths) - lengths
    offsets = entries["offset"].astype(np.int64) + bases[of]
    rank = np.repeat(np.arange(len(indexes)), counts) * int(lengths.sum())
    if (np.diff(offsets + rank) <= 0).any():  # each index in the order of its messages
        return False
    order = np.argsort(offsets)
    begin, of, times = offsets[order], of[order], entries["log_time"][order]
    data = b"".join(chunk.data for chunk in chunks)
    every = len(data) - PREFIX_SIZE + 1  # a head at each byte, of which those are taken
    heads = np.ndarray((every,), _HEAD_DTYPE, data, strides=(1,))[begin]
    last = np.append(np.flatnonzero(np.diff(of)), len(of) - 1)
    first = np.append(0, last[:-1] + 1)
    ends = np.append(begin[1:], len(data))
    ends[last] = bases + lengths
    late = np.diff(times.astype(np.int64)) < 0
    late[last[:-1]] = False
    return bool(
        np.array_equal(begin[first], bases + [chunk.start for chunk in chunks])
        and np.array_equal(begin + RECORD_HEAD.size + heads["length"].astype(np.int64), ends)
        and (heads["opcode"] == Opcode.MESSAGE).all()
        and (heads["length"] >= PREFIX_SIZE - RECORD_HEAD.size).all()
        and np.array_equal(heads["channel"], np.repeat(head["channel"], counts)[order])
        and np.array_equal(heads["log_time"], times)
        and not late.any()
        and times[first].tolist() == [chunk.head.start for chunk in chunks]
        and times[last].tolist() == [chunk.head.end for chunk in chunks]
    )


def _string(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def _compressor() -> zstandard.ZstdCompressor:
    """One compressor per thread: they are costly to make and not safe to share."""
    if not hasattr(_local, "compressor"):
        _local.compressor = zstandard.ZstdCompressor(level=LEVEL)
    compressor: zstandard.ZstdCompressor = _local.compressor
    return compressor


def _decompressor() -> zstandard.ZstdDecompressor:
    if not hasattr(_local, "decompressor"):
        _local.decompressor = zstandard.ZstdDecompressor()
    decompressor: zstandard.ZstdDecompressor = _local.decompressor
    return decompressor
