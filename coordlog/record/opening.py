"""Opening a file as an episode: what is refused before a single message is looked at, and in which
words.
"""

from __future__ import annotations

import os
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mcap.opcode import Opcode

from coordlog.errors import FormatError, TruncatedError
from coordlog.record.addresses import fetch, is_elsewhere
from coordlog.record.records import FOOTER, MAGIC, TAIL_SIZE, Span, walk
from coordlog.record.storage import translated

File = str | os.PathLike[str]


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
    with naming(path), translated(Path(path), "read"):
        if is_elsewhere(path):
            with tempfile.TemporaryFile() as copy:
                copy.write(fetch(path))
                copy.flush()
                yield copy.fileno()
            return
        if os.path.isdir(path):
            raise FormatError("a folder, not an episode file; coordlog.open reads folders")
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
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
        data = os.pread(fd, size, 0)
        while len(data) < size and (more := os.pread(fd, size - len(data), len(data))):
            data += more
        require_coordlog(data)
        return data


def require_coordlog(data: bytes | memoryview) -> None:
    """Look at the first record of a file.

    Raises:
        FormatError: if it is empty, not MCAP, or another program's MCAP.
        TruncatedError: if it ends within its first record.
    """
    if not data:
        raise FormatError("the file is empty (0 bytes): not an episode")
    if len(data) < len(MAGIC) and MAGIC.startswith(data):
        raise TruncatedError(f"only {len(data)} bytes of an MCAP file: nothing to recover")
    if data[: len(MAGIC)] != MAGIC:
        raise FormatError("not an MCAP file; expected an episode written by coordlog")
    span = next(walk(data), Span(0, 0, 0))
    if span.opcode == 0:
        raise TruncatedError(f"only {len(data)} bytes of an MCAP file: nothing to recover")
    content = bytes(data[span.start : span.end])
    if span.opcode != Opcode.HEADER or b"coordlog/" not in content:
        text = content.decode("ascii", "replace").strip("\0")
        printable = "".join(letter if letter.isprintable() else " " for letter in text).strip()
        raise FormatError(
            f"an MCAP file, but not a coordlog episode: its header says '{printable}'"
        )


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
    got = zlib.crc32(summary[: len(summary) - len(MAGIC) - 4])
    if crc != got:
        raise FormatError(
            f"summary: expected CRC {crc:08x}, got {got:08x}; the steps may be intact: `coordlog recover` rewrites the file"
        )


def no_marker(size: int) -> str:
    """What to say about an unfinished file."""
    return f"ends after {size} bytes without its commit marker; recover what is complete with `coordlog recover`"
