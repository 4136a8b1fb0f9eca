"""What commands ask the catalogues of what was named, and what they tell them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from coordlog.catalog.gather import Gathered, gather
from coordlog.catalog.index import Catalog
from coordlog.catalog.query import PATHS, ask
from coordlog.catalog.rows import Job
from coordlog.errors import ConfigError
from coordlog.monitor import Monitor
from coordlog.parallel import mapped
from coordlog.record.addresses import size_and_time
from coordlog.record.files import Files
from coordlog.record.places import Entry, is_url

SAID = 20
"""Files left out that are named."""


def gathered(
    paths: Sequence[Path],
    *,
    scan: bool = True,
    jobs: int | str = 0,
    monitor: Monitor | None = None,
    tell: bool = True,
) -> Gathered:
    """The episodes that some paths name.

    Args:
        paths: Folders, packs, stores, manifests, files.
        scan: Look at the files first; False believes the catalogues.
        jobs: Who describes new files, see `parallel.mapped`.
        monitor: Hears of progress, of what was done about catalogues, and with `tell` of what is
            left out.
        tell: Name what is left out.

    Raises:
        StorageError: if a path does not exist.
    """
    heard = Monitor() if monitor is None else monitor

    def run(
        function: Callable[[Job], list[dict[str, Any]]], work: Sequence[Job]
    ) -> Iterator[list[dict[str, Any]]]:
        total = sum(len(job.entries) for job in work)
        with heard.progress("describing new episodes", total) as progress:
            for rows in mapped(function, work, jobs=jobs):
                progress.advance(len(rows))
                yield rows

    found = gather(paths, scan=scan, run=run)
    for note in found.notes:
        heard.note(note)
    if tell:
        for path, reason in found.skipped[:SAID]:
            heard.note(f"skipped: {path}: {reason}")
        if len(found.skipped) > SAID:
            heard.note(f"skipped: {len(found.skipped) - SAID} more")
    return found


def chosen(
    paths: Sequence[Path], where: str, *, jobs: int | str = 0, monitor: Monitor | None = None
) -> Files:
    """The episodes that satisfy a condition, as a walk over folders would give them; what is
    broken is among the skipped.

    Raises:
        ConfigError: if it is no condition over the catalogue's columns, or nothing satisfies it.
        StorageError: if a path does not exist.
    """
    found = gathered(paths, jobs=jobs, monitor=monitor, tell=False)
    rows = ask(PATHS, found.sources, where=where).column("path").to_pylist()
    kept = tuple(map(Path, dict.fromkeys(rows)))
    if not kept and (total := found.episodes().num_rows):
        raise ConfigError(f"--where: no episode of {total} satisfies: {where}")
    others = tuple(sorted(found.others.items()))
    return Files(kept, tuple(found.parts), tuple(found.skipped), others)


def scenes(folders: Sequence[Path], files: Files) -> list[str]:
    """Scenes of files, as far as catalogues know them that are there; nothing is read for it."""
    known: set[str] = set()
    for folder in folders:
        if folder.is_dir() and (catalog := Catalog(folder)).parts():
            rows = catalog.episodes()
            columns = (rows.column(each).to_pylist() for each in ("path", "scene", "size", "mtime"))
            for name, scene, *stamp in zip(*columns, strict=True):
                if files.stamps.get(os.path.join(folder, name)) == tuple(stamp):
                    known.add(scene)
    return sorted(known)


def catalogued(folder: Path, paths: Iterable[Path]) -> None:
    """Add episodes that were just written to the catalogue of their folder or pack; where none can
    be kept, whoever asks first describes them.
    """
    if is_url(folder):  # every file would be fetched again; the next question does that
        return
    entries = []
    for path in paths:
        stamp = size_and_time(path)
        if stamp is not None:
            entries.append(Entry(path.relative_to(folder).as_posix(), *stamp))
    if entries:
        Catalog(folder).add(entries)
