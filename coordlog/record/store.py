"""A store: episodes by name, wherever they lie.

Three kinds share one face: a folder of this machine, a pack, and a prefix of an object store.
`store_of` says which one an address is. A store lists its episodes, reads one, and takes one in
under a name that is free; it never replaces anything.
"""

from __future__ import annotations

import hashlib
import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Self

from coordlog.errors import StorageError
from coordlog.record.addresses import contents_of, is_pack, listed
from coordlog.record.buckets import Bucket
from coordlog.record.files import Files, find_files
from coordlog.record.pack_writer import SHARD_BYTES, PackWriter
from coordlog.record.packs import is_shard
from coordlog.record.places import Entry, is_url
from coordlog.record.recording import Recording
from coordlog.record.storage import move_new, refuse_existing, translated


class Store(ABC):
    """Episodes by name; a context manager, which finishes what was published."""

    address: str

    @abstractmethod
    def list(self) -> list[Entry]:
        """The episodes, by name."""

    @abstractmethod
    def path(self, name: str) -> Path:
        """The address of an episode, which goes wherever a path goes."""

    @abstractmethod
    def publish(self, name: str, part: Path) -> Path:
        """Take a whole episode file in under a new name; the file goes, its address is returned."""

    def read(self, name: str) -> bytes:
        """The bytes of an episode: one read, or one request.

        Raises:
            StorageError: if there is none, or it cannot be read.
        """
        return contents_of(self.path(name))

    def open(self, name: str) -> Recording:
        """An episode; nothing is read yet."""
        return Recording(self.path(name))

    def close(self) -> None:
        """Finish what was published."""
        return

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class LocalStore(Store):
    """A folder and the folders below it.

    Example:
        >>> store = LocalStore("logs")  # doctest: +SKIP
        >>> [entry.name for entry in store.list()]  # doctest: +SKIP
        ['a.mcap', 'b/c.mcap']
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)
        self.address = str(self.folder)

    def list(self) -> list[Entry]:
        """The episodes, by name.

        Raises:
            StorageError: if there is no such folder.
        """
        return [*self.entries(find_files(self.folder))]

    def entries(self, files: Files) -> Sequence[Entry]:
        """What a walk over the folder found, as entries."""
        start = 0 if self.folder == Path() else len(os.path.join(self.folder, ""))
        names = map(os.fspath, files.paths)
        return [Entry(name[start:], *files.stamps[name]) for name in names]

    def path(self, name: str) -> Path:
        """The path of an episode."""
        return self.folder / name

    def publish(self, name: str, part: Path) -> Path:
        """Give a file of the same file system its name in the store.

        Raises:
            StorageError: if the name is taken, or the file system refuses; the file stays.
        """
        path = self.path(name)
        refuse_existing(path)
        with translated(path, "publish the file", f"it stays as {part}"):
            path.parent.mkdir(parents=True, exist_ok=True)
            move_new(part, path)
        return path


class PackStore(Store):
    """A pack on this machine or in an object store; one of an object store cannot be added to.

    Example:
        >>> with PackStore("PACK") as store:  # doctest: +SKIP
        ...     store.publish("a.mcap", Path("spool/a.mcap"))
    """

    def __init__(self, address: str | os.PathLike[str], *, shard_bytes: int = SHARD_BYTES) -> None:
        self.address = os.fspath(address)
        self._shard_bytes = shard_bytes
        self._writer: PackWriter | None = None

    def list(self) -> list[Entry]:
        """The episodes, by shard and name.

        Raises:
            StorageError: if the pack cannot be read.
        """
        return listed(Path(self.address))

    def path(self, name: str) -> Path:
        """The address of an episode, its name as `list` gives it: PACK/SHARD/NAME."""
        return Path(self.address) / name

    def publish(self, name: str, part: Path) -> Path:
        """Append a file to the last shard, durably, then delete it; the same bytes under the same
        name are not appended again.

        Raises:
            StorageError: if the pack has the name, or the file system refuses; the file stays.
        """
        if is_url(self.address):
            raise StorageError(
                f"{self.address}: shards in an object store cannot grow: pack into a folder and"
                " copy it there"
            )
        if self._writer is None:
            self._writer = PackWriter(self.address, shard_bytes=self._shard_bytes)
        with translated(part, "read"):
            data, mtime = part.read_bytes(), int(part.stat().st_mtime)
        if self._writer.digest(name) == hashlib.sha256(data).hexdigest():
            path = self._writer.address(name)
        else:
            path = self._writer.append(name, data, mtime=mtime)
            self._writer.sync()
        with translated(part, "delete the file"):
            part.unlink()
        return path

    def close(self) -> None:
        """Close the shard that was written to."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


class ObjectStore(Store):
    """Episodes as objects below a prefix, such as s3://BUCKET/PREFIX.

    Example:
        >>> ObjectStore("s3://robots/logs").list()  # doctest: +SKIP
    """

    def __init__(self, url: str | os.PathLike[str]) -> None:
        self._bucket = Bucket(url)
        self.address = self._bucket.address

    def list(self) -> list[Entry]:
        """The episodes, by name; one request for each thousand.

        Raises:
            StorageError: if the store refuses or does not answer.
        """
        return listed(Path(self.address))

    def path(self, name: str) -> Path:
        """The address of an episode."""
        return Path(self.address) / name

    def publish(self, name: str, part: Path) -> Path:
        """Create an object out of a file, in one request, then delete the file.

        Raises:
            StorageError: if the name is taken, or the store refuses; the file stays.
        """
        with translated(part, "read"):
            data = part.read_bytes()
        self._bucket.create(name, data)
        with translated(part, "delete the file"):
            part.unlink()
        return self.path(name)


def store_of(address: str | os.PathLike[str]) -> Store:
    """The store at an address: a folder, a pack, or an object store's URL.

    Raises:
        ConfigError: if a URL is none that can be read, or its library is missing.
    """
    if not is_url(address):
        return PackStore(address) if is_pack(Path(address)) else LocalStore(address)
    bucket = Bucket(address)
    holds_pack = any(is_shard(entry.name) for entry in bucket.entries())
    return PackStore(address) if holds_pack else ObjectStore(address)
