"""Opening a file as an episode: what is refused before a single message is looked at, and in which
words.

An episode is known by its `coordlog.` metadata records. In a file of our own layout they come
first; one that another MCAP tool has written again may hold them anywhere between its chunks.
"""

from __future__ import annotations

import os
import re
import stat
import tempfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from mcap.opcode import Opcode

from coordlog.errors import FormatError, StorageError, TruncatedError
from coordlog.record.addresses import fetch, is_elsewhere
from coordlog.record.records import (
    FOOTER,
    MAGIC,
    TAIL_SIZE,
    Span,
    unpack_header,
    unpack_metadata,
    walk,
)
from coordlog.record.storage import NO_TEXT, is_text, translated
from coordlog.strangers import recognise

File = str | os.PathLike[str]

OURS = "coordlog/"
"""How the library that coordlog writes into a file's header starts; a version follows."""
OF_A_BAG = "coordlog trajectory"
"""How the library reads in the header of a path beside its episode in a ROS 2 bag."""
PREFIX = "coordlog."
_MARK = re.compile(rb"coordlog\.(episode|env|policy|lineage|result)")
"""What both ends of an episode hold, whatever has befallen some of their bytes."""
HEAD = 1 << 16
"""Enough for the opening metadata of any robot we know; more is read where it is not."""
_ORDER = re.compile(rb"\x01(\x0c{0,3}|\x0c{4}\x09*(\x06\x07*)*(\x0c(\x0f.*)?)?)\Z", re.DOTALL)
"""Our records by opcode: header, four of metadata, attachments, chunks with their indexes, the
commit marker, the end of the data; or the start of such."""
BIG = 1 << 26
"""A file of more bytes than this is looked at before all of it is read."""


@contextmanager
def naming(path: File) -> Iterator[None]:
    """Put the file's name in front of what is wrong with it."""
    try:
        yield
    except FormatError as error:
        raise type(error)(f"{os.fspath(path)}: {error}") from None


@contextmanager
def opened(path: File) -> Iterator[int]:
    """A descriptor for reading; errors raised within the block name the file.

    Raises:
        FormatError: if the path is a folder.
        StorageError: if it cannot be read.
    """
    if not is_text(path):
        raise StorageError(f"{os.fspath(path)}: {NO_TEXT}")
    with naming(path), translated(path, "read"):
        if is_elsewhere(path):
            with tempfile.TemporaryFile() as copy:
                copy.write(fetch(path))
                copy.flush()
                yield copy.fileno()
            return
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # of a pipe: no wait
        try:
            mode = os.fstat(fd).st_mode
            if stat.S_ISDIR(mode):
                raise FormatError("a folder, not an episode file; coordlog.open reads folders")
            if not stat.S_ISREG(mode):
                raise FormatError("expected a file, got a pipe, a socket or a device")
            yield fd
        finally:
            os.close(fd)


def load(path: File) -> bytes:
    """All bytes of a coordlog file, finished or not.

    Raises:
        FormatError: if it is a folder, empty, not MCAP, or another program's MCAP.
        StorageError: if it cannot be read.
    """
    with opened(path) as fd:
        size = os.fstat(fd).st_size
        if size > BIG:
            require_coordlog(os.pread(fd, HEAD, 0), whole=False)
        data = read(fd, 0, size)
        require_coordlog(data)
        return data


def read(fd: int, start: int, stop: int) -> bytes:
    """The bytes of a file from `start` to `stop`, or to its end."""
    data = os.pread(fd, stop - start, start)
    while len(data) < stop - start and (
        more := os.pread(fd, stop - start - len(data), start + len(data))
    ):
        data += more
    return data


def writer_of(data: bytes | memoryview) -> str:
    """Which program wrote a file that starts like this, as its first record says; "" if that cannot
    be told.
    """
    span = next(walk(data), Span(0, 0, 0))
    if data[: len(MAGIC)] != MAGIC or span.opcode != Opcode.HEADER:
        return ""
    try:
        return unpack_header(data[span.start : span.end])[1]
    except FormatError:
        return ""


def is_own(data: bytes | memoryview, spans: Sequence[Span] | None = None) -> bool:
    """Whether a file that starts like this is of our own layout, as far as it goes: it says that
    coordlog wrote it, and its records come in our order. Other tools may keep the name.

    Args:
        data: The file, or its start.
        spans: Its records, where the caller has them.
    """
    spans = list(walk(data)) if spans is None else spans
    kinds = bytes(span.opcode for span in spans)
    if not writer_of(data).startswith(OURS) or not _ORDER.match(kinds):
        return False
    ends = [span for span in spans if span.opcode == Opcode.DATA_END]
    return not ends or any(data[ends[0].start : ends[0].end])  # a CRC of zero is none


def rewritten_by(data: bytes | memoryview) -> str:
    """The other program that wrote this episode's bytes anew; "" if coordlog did."""
    if is_own(data):
        return ""
    name = printable(writer_of(data))
    return "another MCAP tool" if name.startswith(OURS) else name or "an unknown program"


def looks_ours(path: File) -> bool:
    """Whether a file has been an episode, to judge by the marks that damage leaves: what coordlog
    writes at both ends of a file, and that it is not plainly something else.

    Raises:
        StorageError: if it cannot be read.
    """
    with opened(path) as fd:
        size = os.fstat(fd).st_size
        ends = read(fd, 0, HEAD) + read(fd, max(size - HEAD, 0), size)
    if not ends.startswith(MAGIC) and recognise(ends, texts=False):
        return False
    return writer_of(ends).startswith(OURS) or _MARK.search(ends) is not None


def require_coordlog(data: bytes | memoryview, *, whole: bool = True) -> None:
    """Look at how a file starts and, if another program wrote it, for an episode's metadata.

    Args:
        data: The file, or its start.
        whole: Whether it is all of the file.

    Raises:
        FormatError: if it is empty, not MCAP, or another program's MCAP.
        TruncatedError: if it ends within its first record.
    """
    if not data:
        raise FormatError("the file is empty (0 bytes): not an episode")
    if len(data) < len(MAGIC) and MAGIC.startswith(data):
        raise TruncatedError(f"only {len(data)} bytes of an MCAP file: nothing to recover")
    if data[: len(MAGIC)] != MAGIC:
        what = recognise(data)
        raise FormatError(
            f"not an MCAP file; expected an episode written by coordlog{what and ', got '}{what}"
        )
    span = next(walk(data), Span(0, 0, 0))
    if span.opcode == 0 and whole:
        raise TruncatedError(f"only {len(data)} bytes of an MCAP file: nothing to recover")
    if writer_of(data).startswith(OURS) or any(
        name.startswith(PREFIX) for name in _metadata_names(data)
    ):
        return
    if writer_of(data) == OF_A_BAG:
        raise FormatError(
            "the path of a smoothed episode as a JointTrajectory, as it lies beside the episode in "
            "a ROS 2 bag: not an episode itself"
        )
    if not whole and span.opcode == Opcode.HEADER and len(data) >= HEAD:
        return  # an episode's records may come further on
    said = printable(
        bytes(data[span.start : min(span.end, span.start + 200)]).decode("ascii", "replace")
    )
    raise FormatError(
        f"an MCAP file, but not a coordlog episode: its header says '{said}';"
        " `coordlog import` takes what ROS 2 wrote"
    )


def printable(text: str) -> str:
    """A text out of a file, without what would act on a terminal."""
    return "".join(letter if letter.isprintable() else " " for letter in text.strip("\0")).strip()


def _metadata_names(data: bytes | memoryview) -> Iterator[str]:
    for span in walk(data):
        if span.opcode == Opcode.METADATA:
            try:
                yield unpack_metadata(bytes(data[span.start : span.end]))[0]
            except FormatError:
                continue


def summary_start(tail: bytes | memoryview, size: int) -> int:
    """Where the data section ends and the summary starts, from the last TAIL_SIZE bytes of a file.

    Raises:
        TruncatedError: if the file does not end as a finished one.
    """
    if len(tail) == TAIL_SIZE and tail[FOOTER.size :] == MAGIC:
        opcode, length, start, _, _ = FOOTER.unpack_from(tail)
        if (
            opcode == Opcode.FOOTER
            and length == FOOTER.size - 9
            and len(MAGIC) <= start <= size - TAIL_SIZE
        ):
            return int(start)
    raise TruncatedError(no_marker(size))


def verify_summary(summary: memoryview) -> None:
    """Check the CRC of a summary section, given up to the end of the file.

    Raises:
        FormatError: if it differs.
    """
    crc = FOOTER.unpack_from(summary, len(summary) - TAIL_SIZE)[-1]
    if crc == 0:  # another tool wrote none
        return
    got = zlib.crc32(summary[: len(summary) - len(MAGIC) - 4])
    if crc != got:
        raise FormatError(
            f"summary: expected CRC {crc:08x}, got {got:08x}; the steps may be intact: `coordlog "
            "recover` rewrites the file"
        )


def no_marker(size: int) -> str:
    """What to say about an unfinished file."""
    return (
        f"ends after {size} bytes without its commit marker; recover what is complete with "
        "`coordlog recover`"
    )
