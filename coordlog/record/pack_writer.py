"""Writing packs: episode files appended to shards on this machine (what those are: `packs`)."""

from __future__ import annotations

import errno
import hashlib
import os
import tarfile
from pathlib import Path
from typing import Self

from coordlog.errors import StorageError
from coordlog.record.packs import (
    BLOCK,
    INDEX,
    SHARD,
    Member,
    Pack,
    encode_index,
    is_shard,
    members_of,
)
from coordlog.record.places import Folder
from coordlog.record.storage import translated

SHARD_BYTES = 256_000_000
"""A shard is closed as soon as it is at least this large."""

_SYNC_BYTES = 32_000_000  # written between two fsyncs


class PackWriter:
    """Appends episode files to a pack on this machine; a context manager.

    A member is appended in one write: a crash loses at most the one being written. Shards are
    closed at `shard_bytes`; a shard of another writer is never touched.

    Example:
        >>> with PackWriter("PACK") as pack:  # doctest: +SKIP
        ...     pack.append("a.mcap", data, mtime=1_700_000_000)
    """

    def __init__(self, path: str | os.PathLike[str], *, shard_bytes: int = SHARD_BYTES) -> None:
        """Make the folder.

        Raises:
            StorageError: if it cannot be made.
        """
        self.path = Path(path)
        self._shard_bytes = shard_bytes
        with translated(self.path, "make the folder"):
            self.path.mkdir(parents=True, exist_ok=True)
        self._fd = -1
        self._shard = Path()
        self._members: list[Member] = []
        self._at, self._synced = 0, 0
        self._pack = Pack(Folder(self.path))
        self._digests = {
            member.name: (shard, member.digest) for shard, member in members_of(self._pack)
        }

    def digest(self, name: str) -> str | None:
        """The sha256 of a member that the pack has; None if it has none of that name."""
        if name not in self._digests:
            return None
        shard, digest = self._digests[name]
        return digest or hashlib.sha256(self._pack.read(shard, name)).hexdigest()

    def address(self, name: str) -> Path:
        """Where a member of the pack is found."""
        return self.path / self._digests[name][0] / name

    def append(self, name: str, data: bytes, *, mtime: int) -> Path:
        """Append one file; the address under which it is found.

        Raises:
            StorageError: if the pack has a member of that name, or the file system refuses.
        """
        if name in self._digests:
            raise StorageError(
                f"{self.path}: the pack has a member {name} and replaces none; choose another name"
            )
        head = _head(name, len(data), mtime)
        if self._fd < 0:
            self._begin()
        padding = bytes(-len(data) % BLOCK)
        with translated(self._shard, "write", "what was packed before is intact"):
            try:
                _write_all(self._fd, b"".join((head, data, padding)))
            except OSError:
                os.ftruncate(self._fd, self._at)  # half a member is none
                raise
        digest = hashlib.sha256(data).hexdigest()
        self._members.append(Member(self._at + len(head), len(data), digest, mtime, name))
        self._digests[name] = (self._shard.name, digest)
        self._at += len(head) + len(data) + len(padding)
        address = self._shard / name
        if self._at >= self._shard_bytes:
            self._finish()
        elif self._at - self._synced >= _SYNC_BYTES:
            self.sync()
        return address

    def sync(self) -> None:
        """Make durable what was appended."""
        if self._fd >= 0:
            with translated(self._shard, "write"):
                os.fsync(self._fd)
            self._synced = self._at

    def close(self) -> None:
        """Close the last shard and write its index."""
        if self._fd >= 0:
            self._finish()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _begin(self) -> None:
        """Make the next shard, whatever other writers make at the same time."""
        numbers = [
            int(name.removeprefix("shard-").removesuffix(SHARD))
            for name in os.listdir(self.path)
            if is_shard(name)
        ]
        number = max(numbers, default=-1) + 1
        while True:
            self._shard = self.path / f"shard-{number:06d}{SHARD}"
            try:
                with translated(self._shard, "create the file"):
                    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC
                    self._fd = os.open(self._shard, flags, 0o666)
                break
            except StorageError as error:
                if getattr(error.__cause__, "errno", 0) != errno.EEXIST:
                    raise
                number += 1
        self._members, self._at, self._synced = [], 0, 0

    def _finish(self) -> None:
        with translated(self._shard, "write"):
            _write_all(self._fd, bytes(2 * BLOCK))  # how a tar archive ends
            os.fsync(self._fd)
            os.close(self._fd)
        self._fd = -1
        name = self._shard.name.removesuffix(SHARD) + INDEX
        Folder(self.path).create(name, encode_index(self._members))


def fits(name: str) -> bool:
    """Whether a pack can hold a member of this name: relative, and of one line."""
    return not ("\n" in name or "\0" in name or name.startswith("/"))


def _head(name: str, size: int, mtime: int) -> bytes:
    """The tar header of a file, the same for the same file whoever packs it."""
    if not fits(name):
        raise StorageError(f"{name!r}: a member's name must be relative and of one line")
    info = tarfile.TarInfo(name)
    info.size, info.mtime = size, mtime
    return info.tobuf(tarfile.PAX_FORMAT)


def _write_all(fd: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(fd, view) :]
