"""Where bytes lie: a folder of this machine, or a prefix of an object store.

Both can say what there is, read a range of it, and create what was not there. Neither ever replaces
anything: of two writers of one name, one is told that it came second.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from coordlog.errors import ConfigError, StorageError
from coordlog.record.storage import PartFile, translated

SCHEMES = {"s3": "AWS", "gs": "GOOGLE", "az": "AZURE"}
"""Object stores, and how the environment variables begin that their credentials are read from."""

_URL = re.compile(r"^(?P<scheme>s3|gs|az):/+(?P<rest>.*)$")
_TIMEOUTS: dict[str, Any] = {"connect_timeout": "5s", "timeout": "120s"}
_RETRIES: Any = {
    "max_retries": 5,
    "retry_timeout": timedelta(seconds=30),
    "backoff": {
        "init_backoff": timedelta(milliseconds=100),
        "max_backoff": timedelta(seconds=2),
        "base": 2,
    },
}


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
        """Files that lie directly in a folder of it, by name; none where there is no such folder."""

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
        return _require_whole(str(path), data, start, len(data) if size is None else size)

    def create(self, name: str, data: bytes) -> None:
        """Make a file, durably; see `storage.PartFile`.

        Raises:
            StorageError: if the name is taken, or the file system refuses.
        """
        path = self.path / name
        with translated(path.parent, "make the folder"):
            path.parent.mkdir(parents=True, exist_ok=True)
        part = PartFile(path)
        try:
            part.append(data)
            part.publish()
        except BaseException:
            part.close()
            raise

    def remove(self, name: str) -> None:
        """Delete a file; none there is no error.

        Raises:
            StorageError: if the file system refuses.
        """
        with translated(self.path / name, "delete the file"):
            (self.path / name).unlink(missing_ok=True)


def _require_whole(name: str, data: bytes, start: int, size: int) -> bytes:
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


class Bucket:
    """A prefix of an object store, such as s3://BUCKET/PREFIX; gs and az likewise.

    Credentials come from the environment's standard places alone (AWS_ACCESS_KEY_ID and so on). An
    object is read in one request and created in one, on the condition that there is none.

    Example:
        >>> Bucket("s3://robots/logs").read("a.mcap")  # doctest: +SKIP
    """

    def __init__(self, url: str | os.PathLike[str]) -> None:
        """Connect to nothing yet.

        Raises:
            ConfigError: if the address or the environment is not what the library wants.
        """
        scheme, rest = split_url(url)
        self.address = f"{scheme}://{rest}".rstrip("/")
        self._variables = SCHEMES[scheme]
        from obstore.exceptions import BaseError
        from obstore.store import from_url

        try:
            self._store = from_url(
                self.address,
                client_options=_options(),
                retry_config=_RETRIES,
            )
        except (BaseError, ValueError) as error:
            raise ConfigError(f"{self.address}: {_brief(error)}") from None

    def entries(self, below: str = "") -> list[Entry]:
        """Objects directly below a prefix, by name, in one request for each thousand."""
        import obstore

        with self._translated(below or self.address, "list"):
            found = obstore.list_with_delimiter(self._store, below or None)["objects"]
        return sorted(map(_entry, found))

    def everything(self) -> list[Entry]:
        """All objects below the prefix, at any depth, by name."""
        import obstore

        with self._translated(self.address, "list"):
            return sorted(_entry(meta) for batch in obstore.list(self._store) for meta in batch)

    def entry(self, name: str) -> Entry | None:
        """One object; None if there is none."""
        import obstore

        try:
            with self._translated(name, "look at"):
                return _entry(obstore.head(self._store, name))
        except MissingError:
            return None

    def read(self, name: str, start: int = 0, size: int | None = None) -> bytes:
        """An object, or a range of it, in one request.

        Raises:
            StorageError: if there is none, or the store refuses or does not answer.
        """
        import obstore

        with self._translated(name, "read"):
            if size is None and not start:
                return bytes(obstore.get(self._store, name).bytes())
            if size is None:
                reply = obstore.get(self._store, name, options={"range": {"offset": start}})
                return bytes(reply.bytes())
            data = bytes(obstore.get_range(self._store, name, start=start, length=size))
        return _require_whole(f"{self.address}/{name}", data, start, size)

    def create(self, name: str, data: bytes) -> None:
        """Make an object in one request, unless there is another one of that name.

        A request whose answer was lost is sent again, and then finds its own work: the same bytes
        under the name are no clash.

        Raises:
            StorageError: if the name is taken, or the store refuses or does not answer.
        """
        import obstore
        from obstore.exceptions import AlreadyExistsError

        with self._translated(name, "create"):
            try:
                obstore.put(self._store, name, data, mode="create", use_multipart=False)
            except AlreadyExistsError:
                if self.read(name) != data:
                    raise

    def remove(self, name: str) -> None:
        """Delete an object; none there is no error.

        Raises:
            StorageError: if the store refuses or does not answer.
        """
        import obstore

        with self._translated(name, "delete"):
            obstore.delete(self._store, name)

    @contextmanager
    def _translated(self, name: str, doing: str) -> Iterator[None]:
        """Turn what the store says into one sentence: which object, what it said, what to set."""
        from obstore.exceptions import AlreadyExistsError, BaseError, NotFoundError

        where = name if name.startswith(self.address) else f"{self.address}/{name}"
        try:
            yield
        except AlreadyExistsError:
            raise StorageError(
                f"{where}: the object exists and is not overwritten; choose another name"
            ) from None
        except (NotFoundError, FileNotFoundError):
            raise MissingError(f"{where}: no such object or bucket") from None
        except (BaseError, OSError) as error:
            raise StorageError(
                f"{where}: cannot {doing}: {_brief(error)}; the store's address and credentials"
                f" are read from {self._variables}_… in the environment"
            ) from None


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
        raise ConfigError(
            f"{option}: expected a folder of this machine, got {os.fspath(path)}; only `coordlog"
            " record` writes into an object store"
        )


def _entry(meta: Any) -> Entry:
    return Entry(meta["path"], meta["size"], int(meta["last_modified"].timestamp() * 1e6) * 1000)


def _options() -> Any:
    """Timeouts; without TLS only where the environment names an endpoint without it."""
    names = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT")
    plain = any(os.environ.get(name, "").startswith("http://") for name in names)
    return {**_TIMEOUTS, "allow_http": plain}


def _brief(error: BaseException) -> str:
    """The first line of what a store said, without its inner workings."""
    text = " ".join(str(error).split("\n\nDebug source")[0].split())
    return text if len(text) <= 300 else f"{text[:300]} …"
