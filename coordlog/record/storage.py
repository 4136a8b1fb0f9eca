"""A file that appears under its name only when it is complete.

`PartFile` is appended to as NAME.part, then made durable and published as NAME. A name that is
taken is never taken over, whoever else writes into the folder at the same time. Whatever the file
system refuses becomes one StorageError.
"""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from coordlog.errors import StorageError

PART = ".part"
NO_TEXT = "its name is not UTF-8, which no log can refer to: rename the file or its folder"

_NO_HARD_LINKS = {errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK}


@contextmanager
def translated(path: str | os.PathLike[str], doing: str, advice: str = "") -> Iterator[None]:
    """Turn an OSError into a StorageError: what could not be done to which file, why, and what to
    do.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise StorageError(
            f"{path}: cannot {doing}: {reason}" + (f"; {advice}" if advice else "")
        ) from error


def is_text(path: str | os.PathLike[str]) -> bool:
    """Whether a path can be written down as UTF-8; names on disk may be any bytes."""
    try:
        os.fspath(path).encode()
    except UnicodeEncodeError:
        return False
    return True


class PartFile:
    """One file being written; closed, published or discarded exactly once."""

    def __init__(self, path: Path) -> None:
        """Create NAME.part.

        Raises:
            StorageError: if NAME or NAME.part exists, or the folder cannot be written to.
        """
        self.path, self.part = path, path.with_name(path.name + PART)
        if not is_text(path):
            raise StorageError(f"{path}: {NO_TEXT}")
        refuse_existing(path)
        refuse_existing(self.part)
        with translated(self.part, "create the file", "does the folder exist and allow writing?"):
            self._fd = os.open(
                self.part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666
            )
            lock(self._fd)

    def append(self, data: bytes) -> None:
        """Hand all bytes to the operating system: they survive a crash of this process.

        Raises:
            StorageError: if the file system refuses; what came before stays in NAME.part.
        """
        with self._kept("write"):
            view = memoryview(data)
            while view:
                view = view[os.write(self._fd, view) :]

    def publish(self) -> None:
        """Make the content durable, then give the file its name; an existing file is left alone.

        Raises:
            StorageError: if the name is taken by now, or the file system refuses; NAME.part stays.
        """
        with self._kept("publish the file"):
            os.fsync(self._fd)
            self.close()
            move_new(self.part, self.path)

    def close(self) -> None:
        """Let go of the file; NAME.part stays as it is. Closing twice is allowed."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    def discard(self) -> None:
        """Close and delete NAME.part."""
        self.close()
        with translated(self.part, "delete the file"):
            os.unlink(self.part)

    @contextmanager
    def _kept(self, doing: str) -> Iterator[None]:
        try:
            with translated(
                self.path,
                doing,
                f"what was recorded stays in {self.part}: `coordlog recover` reads it",
            ):
                yield
        except StorageError:
            self.close()
            raise


def lock(fd: int) -> bool:
    """Mark an open file as worked on, until it is closed or its holder dies.

    Returns:
        False if somebody else holds it; True too where the file system has no locks.
    """
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in (errno.EWOULDBLOCK, errno.EACCES, errno.EAGAIN)
    return True


@contextmanager
def locked(path: Path) -> Iterator[bool]:
    """Hold a file as long as the context lasts, and tell whether nobody else does.

    Raises:
        StorageError: if the file cannot be opened.
    """
    with translated(path, "read"):
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    try:
        yield lock(fd)
    finally:
        os.close(fd)


def discard_dead(path: Path, data: bytes) -> None:
    """Delete the NAME.part that a killed writer of these bytes left; a recording that was
    interrupted under that name is none.
    """
    part = path.with_name(path.name + PART)
    with suppress(StorageError, OSError), locked(part) as ours:
        if ours and (path.suffix != ".mcap" or data.startswith(part.read_bytes())):
            part.unlink()


def refuse_existing(path: Path) -> None:
    """Raise a StorageError if anything has this name."""
    if os.path.lexists(path):
        raise StorageError(
            f"{path}: the file exists and is not overwritten; choose another name or move it away"
        )


def move_new(source: Path, target: Path) -> None:
    """Rename within a folder, durably, and never over an existing file.

    The name is made with a hard link, which cannot replace anything. Where there are no hard links
    an empty file reserves the name first, and a crash at that very moment leaves it empty beside
    the intact source.

    Raises:
        OSError: if the target exists or the file system refuses; the source stays.
    """
    try:
        os.link(source, target)
        os.unlink(source)
    except OSError as error:
        if error.errno not in _NO_HARD_LINKS:
            raise
        os.close(os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC))
        os.replace(source, target)
    fd = os.open(target.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
