"""Where `coordlog record` puts its episodes: a folder, a pack, or an object store."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from coordlog.commands import terminal
from coordlog.commands.asking import catalogued
from coordlog.errors import ConfigError

if TYPE_CHECKING:
    from coordlog.record.recorder import Finished
    from coordlog.record.spool import Spool


class Sink:
    """What takes finished episodes; `folder` is where the recorder writes."""

    def __init__(self, folder: Path, spool: Spool | None) -> None:
        self.folder = folder
        self._spool = spool
        self.done: list[Finished] = []
        """Finished episodes, under the addresses where they are now."""
        self.size = 0
        """bytes"""

    @property
    def paths(self) -> list[Path]:
        """Where the finished episodes are now."""
        return [item.path for item in self.done]

    def take(self, item: Finished) -> None:
        """Count a finished episode, and hand it on."""
        self.size += item.path.stat().st_size
        self.done.append(
            item._replace(path=self._spool.publish(item.path)) if self._spool else item
        )


@contextmanager
def recording_into(out: Path, *, pack: bool) -> Iterator[Sink]:
    """The sink at an address.

    Raises:
        ConfigError: if it is no folder for a pack.
        StorageError: if the store refuses.
    """
    from coordlog.record.addresses import is_pack
    from coordlog.record.places import is_url
    from coordlog.record.spool import Spool
    from coordlog.record.store import PackStore, store_of

    if pack and is_url(out):
        raise ConfigError(f"--pack: expected a folder, got {out}; copy the shards there afterwards")
    if not (pack or is_url(out) or is_pack(out)):
        sink = Sink(out, None)
        yield sink
        catalogued(out, sink.paths)
        return
    with Spool(store_of(out) if is_url(out) else PackStore(out)) as spool:
        for path in spool.published:
            terminal.note(f"published what an earlier recording had left: {path}")
        for path in spool.unfinished:
            terminal.note(f"unfinished: {path}; `coordlog recover` makes an episode of it")
        sink = Sink(spool.folder, spool)
        yield sink
    catalogued(out, sink.paths)
