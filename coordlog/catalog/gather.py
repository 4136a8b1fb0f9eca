"""What the paths of a command line name, as rows of catalogues: folders, packs, stores, manifests,
files.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from coordlog.catalog.index import GROUP, Catalog, Run, serial
from coordlog.catalog.query import Source
from coordlog.catalog.rows import COLUMNS, EMPTY, KEPT, Job, described, table_of
from coordlog.errors import StorageError
from coordlog.parallel import batches
from coordlog.record import manifest
from coordlog.record.addresses import is_elsewhere, is_single, size_and_time
from coordlog.record.files import Files, Skipped, find_files, nothing_found
from coordlog.record.places import Entry, is_url
from coordlog.record.store import LocalStore

FEW = 64
"""So many files, named one by one, are described without asking their folder's catalogue."""


@dataclass
class Gathered:
    """Rows of everything that was named."""

    sources: list[Source] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """What was done about the catalogues."""
    skipped: list[Skipped] = field(default_factory=list)
    """What is broken or gone, and why."""
    parts: list[Path] = field(default_factory=list)
    """Unfinished episodes."""
    others: Counter[str] = field(default_factory=Counter)
    """Kinds of logs of other programs, and how many of each."""
    folders: list[str] = field(default_factory=list)
    """Folders, packs and stores that the episodes lie in."""

    def episodes(self) -> pa.Table:
        """The rows of all sound episodes, each path once and whole; `KEPT`."""
        rows = pa.concat_tables([EMPTY, *map(whole, self.sources)])
        return _first_of_each(rows.filter(pc.is_null(rows.column("error"))), "path")


def gather(
    paths: Iterable[str | os.PathLike[str]],
    *,
    scan: bool = True,
    run: Run = serial,
    nothing: bool = False,
) -> Gathered:
    """Rows of the episodes that some paths name; a file that several name comes once.

    Args:
        paths: Folders, packs, addresses of stores, manifests, files.
        scan: Look at the files first; False believes the catalogues.
        run: Maps over groups of new files.
        nothing: Whether nothing may be found.

    Raises:
        StorageError: if a path does not exist.
        SpecError: if the files were looked at, none is an episode, and that is not allowed.
    """
    found, files, lists = Gathered(), list[Path](), list[Path]()
    given = [Path(path) for path in paths]
    for path in given:
        if manifest.is_manifest(path):
            lists.append(path)
        elif is_single(path):
            files.append(path)
        else:
            _folder(path, found, scan=scan, run=run)
    _files(files, found, run=run)
    if len(found.sources) > 1:
        found.sources = _once(found.sources)
    for path in lists:
        _manifest(path, found, scan=scan, run=run)
    if not nothing and scan and not lists and not any(map(_is_used, found.sources)):
        others = tuple(sorted(found.others.items()))
        raise nothing_found(given, Files((), tuple(found.parts), tuple(found.skipped), others))
    return found


def _is_used(source: Source) -> bool:
    """Whether a source has an episode."""
    if isinstance(source.rows, Path):
        return True
    return bool(source.rows.column("error").null_count)


def _folder(path: Path, found: Gathered, *, scan: bool, run: Run) -> None:
    catalog = Catalog(path)
    if not scan and not catalog.parts():
        raise StorageError(f"{catalog.root}: has no catalogue yet: `coordlog index` makes one")
    if scan:
        entries = None
        if not is_url(path):
            files = find_files(path)
            found.skipped += files.skipped
            found.parts += files.parts
            found.others.update(dict(files.others))
            if isinstance(catalog.store, LocalStore):
                entries = catalog.store.entries(files)
        change = catalog.refresh(entries, run=run, always=False)
        found.notes += change.notes
        found.skipped += [Skipped(catalog.store.path(name), why) for name, why in catalog.broken()]
    found.sources.append(Source(catalog.source(), catalog.root))
    found.folders.append(catalog.root)


def _files(paths: Sequence[Path], found: Gathered, *, run: Run) -> None:
    """Files that were named one by one: of many the catalogues of their folders are asked."""
    if not paths:
        return
    here = find_files(paths)
    found.skipped += here.skipped
    found.others.update(dict(here.others))
    alone: list[Entry] = []
    within: dict[str, list[Entry]] = {}
    for path in here.paths:
        stamp = here.stamps.get(os.fspath(path)) or size_and_time(path)
        if stamp is None:
            raise StorageError(f"{path}: no such file")
        if len(here.paths) <= FEW or is_elsewhere(path):
            alone.append(Entry(os.fspath(path), *stamp))
        else:
            within.setdefault(os.fspath(path.parent), []).append(Entry(path.name, *stamp))
    jobs = [Job("", tuple(group)) for group in batches(alone, GROUP)]
    sources = [Source(table_of(row for rows in run(described, jobs) for row in rows), "")]
    for folder, entries in within.items():
        sources.append(Source(Catalog(folder).of(entries, run=run), folder))
    for rows in map(whole, sources):
        wrong = rows.filter(pc.is_valid(rows.column("error")))
        columns = (wrong.column(name).to_pylist() for name in ("path", "error"))
        found.skipped += [Skipped(Path(name), why) for name, why in zip(*columns, strict=True)]
    found.sources += sources
    found.folders += map(str, here.paths)


def _manifest(path: Path, found: Gathered, *, scan: bool, run: Run) -> None:
    """Rows of the catalogues that a manifest was selected from, in so far as it lists them."""
    chosen = manifest.read(path)
    folder = manifest.split_name(path)[0].parent
    inner = Gathered()
    for source in chosen.about.get("sources", []):
        where = Path(source) if is_url(source) else folder / source
        if is_elsewhere(where) or where.exists():
            part = gather([where], scan=scan, run=run, nothing=True)
            inner.sources += part.sources
            inner.notes += part.notes
            inner.folders += part.folders
    wanted = {each.digest: each for each in chosen.chosen}
    tables = [_listed(source, wanted) for source in inner.sources]
    rows = pa.concat_tables([EMPTY, *tables])
    rows = _first_of_each(rows, "digest").sort_by("digest")
    digests = rows.column("digest").to_pylist()
    for name in ("part", "label"):
        values = pa.array([getattr(wanted[digest], name) for digest in digests], pa.string())
        rows = rows.append_column(name, values)
    found.sources.append(Source(rows, ""))
    found.notes += inner.notes
    found.folders += inner.folders
    there = set(digests)
    found.skipped += [
        Skipped(Path(each.path), f"gone: no episode with the sha256 {each.digest[:12]} was found")
        for each in chosen.chosen
        if each.digest not in there
    ]


def _listed(source: Source, wanted: dict[str, manifest.Chosen]) -> pa.Table:
    """The rows of a source whose digests are wanted, their paths whole."""
    rows = whole(source)
    return rows.filter(pc.is_in(rows.column("digest"), value_set=pa.array(wanted, pa.string())))


def whole(source: Source) -> pa.Table:
    """The rows of a source, their paths whole; `KEPT`."""
    rows = source.rows
    table = (pq.ParquetFile(rows).read() if isinstance(rows, Path) else rows).select(KEPT.names)
    table = table.cast(KEPT)
    if source.prefix:
        head = source.prefix.rstrip("/") + "/"  # a scalar or an array of Python's loads pandas
        paths = pc.utf8_replace_slice(table.column("path"), 0, 0, head)
        table = table.set_column(0, COLUMNS.field("path"), paths)
    return table


def _once(sources: Sequence[Source]) -> list[Source]:
    """Each real file once, by whatever names it is reached."""
    seen: set[object] = set()
    kept = []
    for rows in map(whole, sources):
        new = []
        for path in rows.column("path").to_pylist():
            key = _identity(path)
            new.append(key not in seen)
            seen.add(key)
        kept.append(Source(rows.filter(pa.array(new, pa.bool_())), ""))
    return kept


def _identity(path: str) -> object:
    try:
        status = os.stat(path)
    except OSError:  # elsewhere
        return path
    return status.st_dev, status.st_ino


def _first_of_each(rows: pa.Table, column: str) -> pa.Table:
    """One row of each value: copies of a file are one episode."""
    seen: set[str] = set()
    keep = []
    for at, value in enumerate(rows.column(column).to_pylist()):
        if value not in seen:
            seen.add(value)
            keep.append(at)
    return rows if len(keep) == len(rows) else rows.take(pa.array(keep, pa.int64()))
