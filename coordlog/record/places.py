"""Where bytes lie: a folder of this machine, or a prefix of an object store (`buckets`).

Both can say what there is, read a range of it, and create what was not there. Neither ever replaces
anything: of two writers of one name, one is told that it came second.
"""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from coordlog.errors import ConfigError, StorageError
from coordlog.record.storage import PartFile, discard_dead, translated

SCHEMES = {
    "s3": ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_REGION", "AWS_ENDPOINT_URL"),
    "gs": ("GOOGLE_APPLICATION_CREDENTIALS", "GOOGLE_SERVICE_ACCOUNT_KEY"),
    "az": ("AZURE_STORAGE_ACCOUNT_NAME", "AZURE_STORAGE_ACCOUNT_KEY"),
}
"""Object stores, and the environment variables that say where they are and who asks."""

_URL = re.compile(r"^(?P<scheme>s3|gs|az):/+(?P<rest>.*)$")


class MissingError(StorageError):
    """There is no such object."""


class Entry(NamedTuple):
    """One file of a place."""

    name: str
    """below the place, with slashes"""
    size: int
    """bytes"""
    mtime: int
    """ns since the epoch"""


class Place(Protocol):
    """What a pack or a catalogue needs of the folder or bucket that it lies in."""

    address: str

    def entries(self, below: str = "") -> list[Entry]:
        """Files that lie directly in a folder of it, by name; none where there is no such one."""

    def entry(self, name: str) -> Entry | None:
        """One file; None if there is none."""

    def read(self, name: str, start: int = 0, size: int | None = None) -> bytes:
        """A file, or a range of it, in one request."""

    def create(self, name: str, data: bytes) -> None:
        """Make a file, at once or not at all; a name that is taken is refused."""

    def remove(self, name: str) -> None:
        """Delete a file; none there is no error."""


class Folder:
    """A folder of this machine.

    Example:
        >>> Folder("logs").entries()  # doctest: +SKIP
        [Entry(name='a.mcap', size=51234, mtime=1700000000000000000)]
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.address = str(self.path)

    def entries(self, below: str = "") -> list[Entry]:
        """Files that lie directly in the folder, by name."""
        found = []
        try:
            with (
                translated(self.path / below, "read the folder"),
                os.scandir(self.path / below) as entries,
            ):
                for entry in entries:
                    if entry.is_file():
                        status = entry.stat()
                        name = f"{below}/{entry.name}" if below else entry.name
                        found.append(Entry(name, status.st_size, status.st_mtime_ns))
        except StorageError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                return []
            raise
        return sorted(found)

    def entry(self, name: str) -> Entry | None:
        """One file; None if there is none."""
        try:
            status = os.stat(self.path / name)
        except OSError:
            return None
        return Entry(name, status.st_size, status.st_mtime_ns)

    def read(self, name: str, start: int = 0, size: int | None = None) -> bytes:
        """A file, or a range of it.

        Raises:
            StorageError: if it cannot be read, or ends before the range does.
        """
        path = self.path / name
        with translated(path, "read"), path.open("rb", buffering=0) as stream:
            if start:
                stream.seek(start)
            data = _whole(stream, os.fstat(stream.fileno()).st_size - start, size)
        return require_whole(str(path), data, start, len(data) if size is None else size)

    def create(self, name: str, data: bytes) -> None:
        """Make a file, durably; see `storage.PartFile`. What a writer that was killed left of it is
        made anew.

        Raises:
            StorageError: if the name is taken, or the file system refuses; nothing is left then.
        """
        path = self.path / name
        with translated(path.parent, "make the folder"):
            path.parent.mkdir(parents=True, exist_ok=True)
        discard_dead(path, data)
        part = PartFile(path)
        try:
            part.append(data)
            part.publish()
        except StorageError as error:
            with suppress(StorageError):
                part.discard()
            reason = getattr(error.__cause__, "strerror", None) or str(error)
            raise StorageError(f"{path}: cannot write: {reason}") from error.__cause__
        finally:
            part.close()

    def remove(self, name: str) -> None:
        """Delete a file; none there is no error.

        Raises:
            StorageError: if the file system refuses.
        """
        with translated(self.path / name, "delete the file"):
            (self.path / name).unlink(missing_ok=True)


def require_whole(name: str, data: bytes, start: int, size: int) -> bytes:
    """The bytes of a range, if it is as long as was asked for.

    Raises:
        StorageError: if the file or object ended before.
    """
    if len(data) < size:
        raise StorageError(
            f"{name}: expected {size} bytes from byte {start} on, got {len(data)}: it was cut off"
        )
    return data


def _whole(stream: Any, left: int, size: int | None) -> bytes:
    """Up to `size` bytes of an unbuffered file, however short the single reads are."""
    wanted = left if size is None else min(size, left)
    data = stream.read(max(wanted, 0))
    while len(data) < wanted and (more := stream.read(wanted - len(data))):
        data += more
    return bytes(data)


def is_url(path: str | os.PathLike[str]) -> bool:
    """Whether an address is of an object store; `pathlib` may have taken a slash from it."""
    return _URL.match(os.fspath(path)) is not None


def split_url(path: str | os.PathLike[str]) -> tuple[str, str]:
    """Scheme and the rest of an object's address.

    Raises:
        ConfigError: if it is none.
    """
    found = _URL.match(os.fspath(path))
    if found is None or not found["rest"].strip("/"):
        choices = ", ".join(f"{scheme}://BUCKET/PREFIX" for scheme in SCHEMES)
        raise ConfigError(f"expected an address like {choices}, got {os.fspath(path)}")
    return found["scheme"], found["rest"]


def require_folder(path: str | os.PathLike[str], option: str = "--out") -> None:
    """Refuse an object store where only a folder will do.

    Raises:
        ConfigError: if the path is an address of one.
    """
    if is_url(path):
        got = "://".join(split_url(path))
        raise ConfigError(
            f"{option}: expected a folder of this machine, got {got}; only `coordlog record` writes"
            " into an object store"
        )
