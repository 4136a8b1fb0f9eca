"""Episode files back to memory.

`read_episode` takes the file in one read and decodes each topic with one `np.frombuffer`, by the
fields that the file's own schema declares; every chunk's CRC is verified. `read_header`
and `read_summary` touch only the two ends. A file that is not a finished coordlog
episode is refused in one sentence that says what it is instead.

What is handed out has been vouched for: the metadata by the digests of the commit marker (of
version 1 by the CRC of the data section), the messages by the CRCs of their chunks or, where
another tool wrote those, of the commit marker.
"""

from __future__ import annotations

import hashlib
import os
import zlib
from collections.abc import Mapping
from typing import NamedTuple

from mcap.opcode import Opcode

from coordlog.episode import Episode, Header, Result
from coordlog.errors import FormatError, TruncatedError
from coordlog.record.contents import MOST, Contents, contents, require_crc
from coordlog.record.decoding import decode, require_header
from coordlog.record.metadata import (
    EPISODE,
    HEADER_RECORDS,
    RESULT,
    decode_header,
    decode_result,
    require_version,
    vouched,
)
from coordlog.record.opening import (
    HEAD,
    File,
    is_own,
    load,
    naming,
    no_marker,
    opened,
    read,
    require_coordlog,
    summary_start,
    verify_summary,
)
from coordlog.record.records import (
    DATA_END,
    RECORD_HEAD,
    TAIL_SIZE,
    unpack_attachment,
    unpack_metadata,
    walk,
)

Records = Mapping[str, Mapping[str, str]]


class Summary(NamedTuple):
    """What the two ends of a file say, without its messages."""

    header: Header
    result: Result
    size: int
    """bytes"""


def read_header(path: File) -> Header:
    """The metadata an episode started with; of a part file too.

    Raises:
        FormatError: if the file is not a coordlog episode of a version this release reads.
    """
    with opened(path) as fd:
        records = _opening(fd, read(fd, 0, HEAD))
        if not set(HEADER_RECORDS) <= set(records):
            raise TruncatedError("ends within its opening metadata: nothing to recover")
        return decode_header(records)


def read_summary(path: File) -> Summary:
    """Header, result and size of a finished episode, from a few small reads at both ends of the
    file; vouched for by the commit marker (a file of version 1 is read whole, for its CRC, and one
    that another tool wrote is decoded whole).

    Raises:
        TruncatedError: if there is no commit marker.
        FormatError: if the file is not a coordlog episode of a version this release reads, or its
            metadata are not what was written.
    """
    with opened(path) as fd:
        records, size = _ends(fd, between=True)
        return Summary(decode_header(records), decode_result(records[RESULT]), size)


def probe(path: File) -> int:
    """Size in bytes of what is a finished episode as far as both its ends tell.

    Raises:
        TruncatedError: if it does not end as a finished file.
        FormatError: as `read_summary`, but for what lies between the ends.
    """
    with opened(path) as fd:
        records, size = _ends(fd)
        decode_header(records)
        decode_result(records[RESULT])
        return size


def _ends(fd: int, *, between: bool = False) -> tuple[Records, int]:
    """The metadata records of a finished file, vouched for, and its size; with `between`, what
    another tool wrote is decoded whole.
    """
    size = os.fstat(fd).st_size
    head = read(fd, 0, HEAD)
    require_coordlog(head, whole=size <= HEAD)
    own = is_own(head)
    if own and size > HEAD:
        records = _opening(fd, head)
        start = summary_start(read(fd, max(size - TAIL_SIZE, 0), size), size)
        summary = memoryview(read(fd, start, size))
        verify_summary(summary)
        records |= _marker(fd, summary)
    else:
        data = head if size <= HEAD else _whole(fd, size)
        records = metadata(data)
        require_header(records)
        require_version(records[EPISODE])
        if own:
            start = summary_start(data[-TAIL_SIZE:], size)
            verify_summary(memoryview(data)[start:])
        elif between and RESULT in records:  # its ends say nothing of what lies between them
            decode(contents(data))
    require_header(records)
    require_version(records[EPISODE])
    if RESULT not in records:
        raise TruncatedError(no_marker(size))
    if not vouched(records) and own:
        _verify_data(fd, start)
    return records, size


def _whole(fd: int, size: int) -> bytes:
    if size > MOST:
        raise FormatError(f"an MCAP file of {size} bytes that coordlog did not write")
    return read(fd, 0, size)


def metadata(data: bytes | memoryview) -> dict[str, Mapping[str, str]]:
    """Every metadata record of a file, as it stands there.

    Raises:
        FormatError: if one is not well formed, or there are two of coordlog's with one name.
    """
    found, view = Contents(), memoryview(data)
    for span in walk(view):
        if span.opcode == Opcode.METADATA:
            found.add_metadata(*unpack_metadata(bytes(view[span.start : span.end])))
    return found.metadata


def _marker(fd: int, summary: memoryview) -> dict[str, Mapping[str, str]]:
    """The commit marker, found through the summary; nothing if there is none."""
    for span in walk(summary, 0):
        if span.opcode == Opcode.METADATA_INDEX:
            offset, length = _metadata_index(summary[span.start : span.end], RESULT)
            if length:
                content = read(fd, offset, offset + length)[RECORD_HEAD.size :]
                return {RESULT: unpack_metadata(content)[1]}
    return {}


def _verify_data(fd: int, start: int) -> None:
    """Hold a data section that ends before `start` to its CRC."""
    crc, at, stop = 0, 0, start - DATA_END.size
    while at < stop and (data := os.pread(fd, min(stop - at, 1 << 20), at)):
        crc, at = zlib.crc32(data, crc), at + len(data)
    require_crc(os.pread(fd, DATA_END.size, stop), crc)


def _opening(fd: int, head: bytes) -> dict[str, Mapping[str, str]]:
    """The metadata records that open a file; of one that another tool wrote, all there are."""
    size = os.fstat(fd).st_size
    if not is_own(head):
        data = head if size <= len(head) else _whole(fd, size)
        require_coordlog(data)
        return metadata(data)
    for data in (head, b""):
        view = memoryview(data or read(fd, 0, size))
        require_coordlog(view)
        records: dict[str, Mapping[str, str]] = {}
        for span in walk(view):
            if span.opcode == Opcode.METADATA:
                name, values = unpack_metadata(bytes(view[span.start : span.end]))
                records[name] = values
            elif records:
                return records
        if set(HEADER_RECORDS) <= set(records):
            return records
    return records


def read_episode(path: File, *, verify: bool = True) -> Episode:
    """A finished episode.

    Args:
        path: The file.
        verify: Refuse what no CRC or digest vouches for; False decodes it all the same, to find
            out what is damaged.

    Raises:
        TruncatedError: if there is no commit marker.
        FormatError: if the file is foreign, damaged, or of a version this release does not read.
    """
    data = load(path)
    with naming(path):
        return decode(contents(data, verify=verify), verify=verify)


def read_attachments(path: File) -> dict[str, bytes]:
    """The attachments of an episode, finished or not, by name; CRCs verified, and digests where
    the commit marker has them.

    Raises:
        FormatError: if the file is not a coordlog episode, or an attachment is damaged.
    """
    data = load(path)
    with naming(path):
        return attachments(data)


def attachments(data: bytes) -> dict[str, bytes]:
    """The attachments of a file, given its bytes; see `read_attachments`.

    Raises:
        FormatError: if one is damaged, or missing though the commit marker names it.
    """
    view, found = memoryview(data), {}
    for span in walk(view):
        if span.opcode == Opcode.ATTACHMENT:
            name, content = unpack_attachment(view[span.start : span.end])
            found[name] = content
    records = metadata(data)
    if RESULT in records:
        for name, wanted in vouched(records).get("attachments", {}).items():
            if name not in found:
                raise FormatError(f"attachment {name!r} missing: the commit marker names it")
            if hashlib.sha256(found[name]).hexdigest() != wanted:
                raise FormatError(f"attachment {name!r}: damaged: its digest is another")
    return found


def _metadata_index(content: memoryview, name: str) -> tuple[int, int]:
    """Offset and length of a metadata record if this index entry is of that name, else zeros."""
    if bytes(content[20:]) != name.encode():
        return 0, 0
    return int.from_bytes(content[:8], "little"), int.from_bytes(content[8:16], "little")
