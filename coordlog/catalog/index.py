"""A catalogue: a row per episode, kept in Parquet files beside the logs, never trusted against
them.

The files of a catalogue lie in `.catalog/` of what they describe. Each is written once, whole, and
named by a number and its checksum; a later one has the word about a path. Size and mtime of every
file decide whether its row holds; what is new or changed is read, what is gone is marked. Whatever
is damaged or of another edition is described anew. Deleting a catalogue costs only time.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from coordlog.catalog.rows import EMPTY, KEPT, Job, described, table_of, tombstones
from coordlog.errors import StorageError
from coordlog.parallel import batches
from coordlog.record.addresses import contents_of, place_at
from coordlog.record.files import CATALOG
from coordlog.record.places import Entry, Folder, Place
from coordlog.record.store import Store, store_of

EDITION = "3"
"""Files of another edition are described anew."""
GROUP = 64
"""Files that one process describes before it answers."""
MOST_PARTS = 32
"""A catalogue of more files than this is merged into one."""

_NAME = re.compile(r"^part-(\d{6,12})-([0-9a-f]{8})\.parquet$")

Run = Callable[
    [Callable[[Job], list[dict[str, Any]]], Sequence[Job]], Iterable[list[dict[str, Any]]]
]
"""Maps a function over jobs, on as many processes as it likes."""
Stamp = tuple[int, int]
"""Size and mtime [ns]."""


@dataclass(frozen=True)
class Change:
    """What a look at the files showed."""

    new: int
    changed: int
    gone: int
    notes: tuple[str, ...]
    """What was wrong with the catalogue, and what was done about it."""
    kept: bool
    """Whether the catalogue could be written."""


class Mismatch(NamedTuple):
    """A file whose bytes are not those that were catalogued, though its size and time are."""

    path: str
    wanted: str
    got: str


def serial(
    function: Callable[[Job], list[dict[str, Any]]], jobs: Sequence[Job]
) -> Iterator[list[dict[str, Any]]]:
    """A `Run` in this process."""
    return map(function, jobs)


class Catalog:
    """The catalogue of a folder, a pack or an object store's prefix.

    Example:
        >>> catalog = Catalog("logs")  # doctest: +SKIP
        >>> catalog.refresh()  # doctest: +SKIP
        >>> catalog.episodes().num_rows  # doctest: +SKIP
    """

    def __init__(self, address: str | os.PathLike[str]) -> None:
        """Look at nothing yet.

        Raises:
            ConfigError: if the address is none that can be read.
        """
        self.store: Store = store_of(address)
        self.root = self.store.address
        self._place: Place = place_at(self.root)
        self._rows: pa.Table | None = None
        self._notes: list[str] = []
        self._kept = True
        self._broken: list[str] = []

    def rows(self) -> pa.Table:
        """The newest row of every file, broken ones too; `KEPT`."""
        if self._rows is None:
            try:
                self._rows = newest(self._read(name) for name in self.parts())
            except StorageError:  # somebody else has compacted it between two reads
                self._rows = newest(self._read(name) for name in self.parts())
        return self._rows

    def source(self) -> pa.Table | Path:
        """The rows for a query that looks at a few columns: a table, or the file of a compact
        catalogue of this machine that nobody has read yet.
        """
        if self._rows is not None:
            return self._rows
        parts = self.parts()
        if len(parts) == 1 and isinstance(self._place, Folder):
            path = self._place.path / parts[0]
            with suppress(pa.ArrowException, OSError, ValueError):
                require_sound(parts[0], pa.memory_map(str(path)).read_buffer())
                return path
        return self.rows()

    def episodes(self) -> pa.Table:
        """The rows of sound episodes, by path."""
        rows = self.rows()
        return rows.filter(pc.is_null(rows.column("error")))

    def broken(self) -> list[tuple[str, str]]:
        """Paths of what is no sound episode, and why."""
        rows = self.rows()
        wrong = rows.filter(pc.is_valid(rows.column("error")))
        names, reasons = (wrong.column(name).to_pylist() for name in ("path", "error"))
        return list(zip(names, reasons, strict=True))

    def parts(self) -> list[str]:
        """Names of the files of the catalogue, oldest first."""
        try:
            names = [entry.name for entry in self._place.entries(CATALOG)]
        except StorageError:
            if not isinstance(self._place, Folder):
                raise
            return []  # it cannot be read: none is kept, and whoever writes says so
        return sorted(name for name in names if _NAME.match(name.split("/")[-1]))

    def refresh(
        self, entries: Iterable[Entry] | None = None, *, run: Run = serial, always: bool = True
    ) -> Change:
        """Look at the size and time of every file, and describe what is new or changed.

        Args:
            entries: All files that there are, where the caller has looked.
            run: Maps over groups of files.
            always: Keep what was found; False begins no catalogue for a few files: who only looks
                leaves nothing behind.

        Raises:
            StorageError: if the files cannot be listed.
        """
        found = self.store.list() if entries is None else entries
        listed = {entry.name: entry for entry in found}
        known = self._known()
        fresh = _others(listed.values(), known)
        gone = [name for name in known if name not in listed]
        changed = sum(entry.name in known for entry in fresh)
        keep = always or len(fresh) > GROUP or bool(self.parts())
        self._describe(fresh, gone, run=run, keep=keep)
        change = Change(
            len(fresh) - changed, changed, len(gone), tuple(self._notes), kept=self._kept
        )
        self._notes = []
        return change

    def add(self, entries: Iterable[Entry], *, run: Run = serial) -> None:
        """Describe some files, such as those just written, and look at no others."""
        self._describe(_others(entries, self._known()), [], run=run)

    def of(self, entries: Sequence[Entry], *, run: Run = serial) -> pa.Table:
        """The rows of some files, described first where that is needed; `KEPT`."""
        self.add(entries, run=run)
        names = pa.array([each.name for each in entries], pa.string())
        return self.rows().filter(pc.is_in(self.rows().column("path"), value_set=names))

    def verify(self) -> list[Mismatch]:
        """Hash every file; rows of those with other bytes are described anew."""
        rows = self.episodes()
        columns = (rows.column(name).to_pylist() for name in ("path", "digest", "size", "mtime"))
        wrong = []
        for name, wanted, size, mtime in zip(*columns, strict=True):
            got = hashlib.sha256(contents_of(self.store.path(name))).hexdigest()
            if got != wanted:
                wrong.append((Mismatch(name, wanted, got), Entry(name, size, mtime)))
        self._describe([entry for _, entry in wrong], [], run=serial)
        return [mismatch for mismatch, _ in wrong]

    def compact(self) -> None:
        """Write the newest rows as one file, then delete those that it replaces.

        Raises:
            StorageError: if the catalogue cannot be written.
        """
        parts = self.parts()
        if len(parts) > 1:
            self._write(newest(self._read(name) for name in parts))
            for name in parts:
                self._place.remove(name)

    def rebuild(self, *, run: Run = serial) -> Change:
        """Delete the catalogue and describe every file anew."""
        for name in self.parts():
            self._place.remove(name)
        self._rows = None
        return self.refresh(run=run)

    def _describe(
        self, fresh: Sequence[Entry], gone: Sequence[str], *, run: Run, keep: bool = True
    ) -> None:
        if not fresh and not gone and not self._broken:
            return
        below = self._described_below(fresh)
        rest = _others(fresh, _stamps(below))
        jobs = [Job(self.root, tuple(group)) for group in batches(rest, GROUP)]
        found = pa.concat_tables(map(table_of, run(described, jobs))) if jobs else table_of(())
        added = pa.concat_tables([below, found, tombstones(gone)]).sort_by("path")
        self._rows = newest([self.rows(), added])
        if not keep:
            return
        try:
            if len(added):
                self._write(added)
            for name in self._broken:
                self._place.remove(name)
            self._broken = []
            if len(self.parts()) > MOST_PARTS:
                self.compact()
        except StorageError as error:
            self._notes.append(f"the catalogue is not kept: {error}")
            self._kept = False

    def _described_below(self, fresh: Sequence[Entry]) -> pa.Table:
        """Rows that the catalogues of folders within this one have of some files."""
        if not isinstance(self._place, Folder):
            return EMPTY
        folders = {str(folder) for each in fresh for folder in PurePosixPath(each.name).parents}
        wanted = {each.name: (each.size, each.mtime) for each in fresh}
        tables = [EMPTY]
        for folder in sorted(folders - {"."}):
            if (self._place.path / folder / CATALOG).is_dir():
                rows = Catalog(self._place.path / folder).rows()
                names = [f"{folder}/{name}" for name in rows.column("path").to_pylist()]
                rows = rows.set_column(0, KEPT.field("path"), pa.array(names, pa.string()))
                same = [wanted.get(name) == stamp for name, stamp in _stamps(rows).items()]
                tables.append(rows.filter(pa.array(same, pa.bool_())))
        return newest(tables)

    def _known(self) -> dict[str, Stamp]:
        return _stamps(self.rows())

    def _write(self, rows: pa.Table) -> None:
        """Write one more file of the catalogue."""
        numbers = [int(name.split("-")[-2]) for name in self.parts()]
        about = {"coordlog_catalog": EDITION}
        sink = io.BytesIO()
        pq.write_table(rows.replace_schema_metadata(about), sink, compression="zstd")
        data = sink.getvalue()
        name = f"{CATALOG}/part-{max(numbers, default=0) + 1:06d}-{zlib.crc32(data):08x}.parquet"
        if self._place.entry(name) is None:  # somebody else has described the same
            self._place.create(name, data)

    def _read(self, name: str) -> pa.Table:
        """One file of the catalogue; an empty table for one that cannot be used."""
        try:
            return require_sound(name, self._place.read(name)).read().cast(KEPT)
        except (pa.ArrowException, OSError, ValueError) as error:
            self._notes.append(
                f"{self.root}/{name}: cannot be used and is written anew: "
                f"{str(error).splitlines()[0]}"
            )
            self._broken.append(name)
            return EMPTY


def require_sound(name: str, data: Any) -> pq.ParquetFile:
    """A file of a catalogue, if it is as it was written.

    Raises:
        ValueError: if it is of another edition, or its bytes are not those of its name.
        ArrowException: if it is no Parquet file.
    """
    found = _NAME.match(PurePosixPath(name).name)
    file = pq.ParquetFile(pa.BufferReader(data))
    edition = (file.schema_arrow.metadata or {}).get(b"coordlog_catalog", b"none").decode()
    if edition != EDITION:
        raise ValueError(f"it is of edition {edition}, this release writes {EDITION}")
    if found is None or zlib.crc32(data) != int(found[2], 16):
        raise ValueError("its bytes are not those that were written")
    return file


def _stamps(rows: pa.Table) -> dict[str, Stamp]:
    """Size and mtime of each file as the rows have them."""
    columns = (rows.column(name).to_pylist() for name in ("path", "size", "mtime"))
    return {path: (size, mtime) for path, size, mtime in zip(*columns, strict=True)}


def _others(entries: Iterable[Entry], known: Mapping[str, Stamp]) -> list[Entry]:
    """Those of another size or time than is known."""
    return [each for each in entries if known.get(each.name) != (each.size, each.mtime)]


def newest(parts: Iterable[pa.Table]) -> pa.Table:
    """The last row of every path, by path, without those that are gone.

    Args:
        parts: Tables of `KEPT`, oldest first.
    """
    tables = list(parts)
    if not tables:
        return EMPTY
    rows = pa.concat_tables(tables)
    if len(tables) > 1:
        codes = np.asarray(rows.column("path").combine_chunks().dictionary_encode().indices)
        last = np.zeros(codes.max(initial=-1) + 1, np.int64)
        last[codes] = np.arange(len(codes))
        rows = rows.take(pa.array(np.sort(last))).sort_by("path")
    if rows.column("gone").null_count < len(rows):
        rows = rows.filter(pc.is_null(rows.column("gone")))
    return rows
