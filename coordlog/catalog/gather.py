"""What the paths of a command line name, as sources of a query: folders, packs, stores, manifests,
files.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from coordlog.catalog.index import Catalog, Run, serial
from coordlog.catalog.query import Source
from coordlog.catalog.rows import COLUMNS, KEPT, Job, described, table_of
from coordlog.errors import StorageError
from coordlog.record import manifest
from coordlog.record.addresses import is_elsewhere, size_and_time
from coordlog.record.files import Files, Skipped, nothing_found
from coordlog.record.places import Entry, is_url


@dataclass
class Gathered:
    """Rows of everything that was named."""

    sources: list[Source] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """What was done about the catalogues."""
    left_out: list[str] = field(default_factory=list)
    """What is broken or gone, and why."""
    folders: list[str] = field(default_factory=list)
    """Folders, packs and stores that the episodes lie in."""
    files: Files = field(default_factory=lambda: Files((), ()))
    """What else lies in the folders."""
    is_empty: bool = True
    """Whether no episode was found."""


def gather(
    paths: Iterable[str | os.PathLike[str]], *, scan: bool = True, run: Run = serial
) -> Gathered:
    """Rows of the episodes that some paths name.

    Args:
        paths: Folders, packs, addresses of stores, manifests, files.
        scan: Look at the files first; False believes the catalogues.
        run: Maps over groups of new files.

    Raises:
        StorageError: if a path does not exist.
        SpecError: if the files were looked at, and none is an episode.
    """
    found, given = Gathered(), [Path(path) for path in paths]
    for path in given:
        if manifest.is_manifest(path):
            _manifest(path, found, scan=scan, run=run)
        elif _is_one(path):
            _file(path, found)
        else:
            _folder(str(path), found, scan=scan, run=run)
    if scan and found.is_empty and found.folders:
        raise nothing_found(given, found.files)
    return found


def _is_one(path: Path) -> bool:
    if is_elsewhere(path):
        return path.suffix == ".mcap"
    if not path.exists():
        raise StorageError(f"{path}: no such file or folder")
    return not path.is_dir()


def _folder(address: str, found: Gathered, *, scan: bool, run: Run) -> None:
    catalog = Catalog(address)
    if scan:
        change = catalog.refresh(run=run)
        found.notes += change.notes
        if change.new + change.changed + change.gone:
            found.notes.append(
                f"{catalog.root}: {change.new:,} new episodes, {change.changed:,} changed,"
                f" {change.gone:,} gone"
            )
    elif not catalog.parts():
        raise StorageError(f"{catalog.root}: has no catalogue yet: `coordlog index` makes one")
    if scan:
        broken = [Skipped(catalog.store.path(name), why) for name, why in catalog.broken()]
        files = catalog.files(skipped=broken)
        found.left_out += files.left_out()
        found.files = found.files.joined(files)
        found.is_empty &= len(broken) == catalog.rows().num_rows
    found.sources.append(Source(catalog.source(), catalog.root))
    found.folders.append(catalog.root)


def _file(path: Path, found: Gathered) -> None:
    status = size_and_time(path)
    if status is None:
        raise StorageError(f"{path}: no such file")
    row = table_of(described(Job("", (Entry(str(path), *status),))))
    why = row.column("error").to_pylist()[0]
    found.is_empty &= why is not None
    if why is not None:
        found.left_out.append(f"{path}: {why}")
        found.files = found.files.joined(Files((), (), (Skipped(path, why),)))
    found.sources.append(Source(row, ""))
    found.folders.append(str(path))


def _manifest(path: Path, found: Gathered, *, scan: bool, run: Run) -> None:
    """Rows of the catalogues that a manifest was selected from, in so far as it lists them."""
    chosen = manifest.read(path)
    folder = manifest.split_name(path)[0].parent
    inner = Gathered()
    for source in chosen.about.get("sources", []):
        where = Path(source) if is_url(source) else folder / source
        if is_elsewhere(where) or where.exists():
            inner_paths: Sequence[Path] = [where]
            part = gather(inner_paths, scan=scan, run=run)
            inner.sources += part.sources
            inner.notes += part.notes
            inner.folders += part.folders
    wanted = {each.digest: each for each in chosen.chosen}
    tables = [_listed(source, wanted) for source in inner.sources]
    rows = _first_of_each(pa.concat_tables(tables)) if tables else KEPT.empty_table()
    digests = rows.column("digest").to_pylist()
    for name in ("part", "label"):
        values = pa.array([getattr(wanted[digest], name) for digest in digests], pa.string())
        rows = rows.append_column(name, values)
    found.sources.append(Source(rows, ""))
    found.is_empty &= rows.num_rows == 0 and not chosen.chosen
    found.notes += inner.notes
    found.folders += inner.folders
    there = set(digests)
    found.left_out += [
        f"{each.path}: gone: no episode with the sha256 {each.digest[:12]} was found"
        for each in chosen.chosen
        if each.digest not in there
    ]


def _listed(source: Source, wanted: dict[str, manifest.Chosen]) -> pa.Table:
    """The rows of a source whose digests are wanted, their paths whole."""
    table = (
        pq.ParquetFile(source.rows).read() if isinstance(source.rows, Path) else source.rows
    ).select(KEPT.names)
    table = table.filter(pc.is_in(table.column("digest"), value_set=pa.array(wanted, pa.string())))
    if source.prefix:
        head = pa.scalar(source.prefix.rstrip("/"))
        whole = pc.binary_join_element_wise(head, table.column("path"), "/")
        table = table.set_column(0, COLUMNS.field("path"), whole)
    return table


def _first_of_each(rows: pa.Table) -> pa.Table:
    """One row of each digest: copies of a file are one episode."""
    seen: set[str] = set()
    keep = []
    for at, digest in enumerate(rows.column("digest").to_pylist()):
        if digest not in seen:
            seen.add(digest)
            keep.append(at)
    return rows.take(pa.array(keep, pa.int64()))
