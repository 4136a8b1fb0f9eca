"""Recording into a pack or an object store: parts stay on this machine until they are whole.

A recorder writes into a folder of its own, as ever; each file that it finishes is handed to the
store and goes from the folder. What a crash leaves in such a folder is published by the next
recording into the same store; a lock tells which folders are still written to.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Self

from coordlog.errors import ConfigError
from coordlog.monitor import Monitor
from coordlog.record.addresses import is_pack
from coordlog.record.files import find_files
from coordlog.record.places import is_url
from coordlog.record.storage import translated
from coordlog.record.store import PackStore, Store, store_of

if TYPE_CHECKING:
    from coordlog.record.recorder import Finished

FOLDER = ".spool"
LOCK = "lock"


class Spool:
    """A folder between a recorder and a store; a context manager that closes the store.

    Example:
        >>> with Spool(PackStore("PACK")) as spool:  # doctest: +SKIP
        ...     Recorder(env, spool.folder, finished=lambda item: spool.publish(item.path), …)
    """

    def __init__(self, store: Store) -> None:
        """Make the folder, and publish the finished files that dead recordings have left.

        Raises:
            StorageError: if the folder cannot be made, or the store refuses.
        """
        self.store = store
        self._whole = _folder(store.address)
        self.folder = self._whole / uuid.uuid4().hex[:8]
        with translated(self.folder, "make the folder"):
            self.folder.mkdir(parents=True)
        self._lock = _locked(self.folder)
        self.published: list[Path] = []
        """Addresses of finished files that earlier recordings had left."""
        self.unfinished: list[Path] = []
        """Part files that they left; `coordlog recover` makes episodes of them."""
        for folder in sorted(self._whole.iterdir()):
            if folder != self.folder and folder.is_dir():
                self._adopt(folder)

    def publish(self, path: Path) -> Path:
        """Hand a finished file to the store; its address there.

        Raises:
            StorageError: if the store has other bytes under its name, or refuses; the file stays.
        """
        return self.store.publish(path.name, path)

    def _adopt(self, folder: Path) -> None:
        """Publish what lies in a folder that nobody writes to any more."""
        lock = _locked(folder)
        if lock is None:
            return
        left = find_files(folder)
        self.published += [self.publish(path) for path in left.paths]
        self.unfinished += left.parts
        _remove(folder, lock)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.store.close()
        if self._lock is not None:
            _remove(self.folder, self._lock)


def _folder(address: str) -> Path:
    """In a pack's own folder; for an object store in the user's cache folder."""
    if not is_url(address):
        return Path(address) / FOLDER
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    name = hashlib.sha256(address.encode()).hexdigest()[:16]
    return cache / "coordlog" / "spool" / name


def _locked(folder: Path) -> int | None:
    """A lock on a folder that ends with this process; None if another process has it."""
    with translated(folder / LOCK, "lock the folder"):
        fd = os.open(folder / LOCK, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o666)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(fd)
        return None
    return fd


def _remove(folder: Path, lock: int) -> None:
    """Give a folder up, and delete it if nothing but the lock is in it."""
    if [path.name for path in folder.iterdir()] == [LOCK]:
        shutil.rmtree(folder, ignore_errors=True)
    os.close(lock)


class Sink:
    """What takes finished episodes; `folder` is where the recorder writes."""

    def __init__(self, folder: Path, spool: Spool | None) -> None:
        self.folder = folder
        self._spool = spool
        self.done: list[Finished] = []
        """Finished episodes, under the addresses where they are now."""
        self.size = 0
        """bytes"""

    def take(self, item: Finished) -> None:
        """Count a finished episode, and hand it on."""
        self.size += item.path.stat().st_size
        self.done.append(
            item._replace(path=self._spool.publish(item.path)) if self._spool else item
        )


@contextmanager
def sink_at(out: Path, monitor: Monitor, *, pack: bool = False) -> Iterator[Sink]:
    """The sink at an address: a folder, a pack, or an object store.

    Raises:
        ConfigError: if it is no folder for a pack.
        StorageError: if the store refuses.
    """
    if pack and is_url(out):
        raise ConfigError(f"--pack: expected a folder, got {out}; copy the shards there afterwards")
    if not (pack or is_url(out) or is_pack(out)):
        yield Sink(out, None)
        return
    with Spool(store_of(out) if is_url(out) else PackStore(out)) as spool:
        for path in spool.published:
            monitor.note(f"published what an earlier recording had left: {path}")
        for path in spool.unfinished:
            monitor.note(f"unfinished: {path}; `coordlog recover` makes an episode of it")
        yield Sink(spool.folder, spool)
