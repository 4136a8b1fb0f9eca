"""What commands ask the catalogues of what was named, and what they tell them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coordlog.commands import terminal
from coordlog.errors import ConfigError
from coordlog.parallel import mapped

if TYPE_CHECKING:
    from coordlog.catalog.gather import Gathered
    from coordlog.catalog.rows import Job
    from coordlog.record.files import Files, Skipped

SAID = 20
"""Files left out that are printed."""


def gathered(
    paths: Sequence[Path], *, scan: bool = True, jobs: int | str = "0", tell: bool = True
) -> Gathered:
    """The episodes that some paths name; notes are printed, and with `tell` what is left out.

    Raises:
        StorageError: if a path does not exist.
    """
    from coordlog.catalog.gather import gather

    with terminal.progress() as bar:

        def run(
            function: Callable[[Job], list[dict[str, Any]]], work: Sequence[Job]
        ) -> Iterator[list[dict[str, Any]]]:
            total = sum(len(job.entries) for job in work)
            task = bar.add_task("describing new episodes", total=total, note="")
            for rows in mapped(function, work, jobs=jobs):
                bar.update(task, advance=len(rows))
                yield rows

        found = gather(paths, scan=scan, run=run)
    for note in found.notes:
        terminal.note(note)
    if tell:
        say_skipped(found.skipped)
    return found


def say_skipped(skipped: Sequence[Skipped]) -> None:
    """Name what was left out."""
    for path, reason in skipped[:SAID]:
        terminal.note(f"skipped: {path}: {reason}")
    if len(skipped) > SAID:
        terminal.note(f"skipped: {len(skipped) - SAID} more")


def chosen(paths: Sequence[Path], where: str, *, jobs: int | str = "0") -> Files:
    """The episodes that satisfy a condition, as a walk over folders would give them; what is
    broken is among the skipped.

    Raises:
        ConfigError: if it is no condition over the catalogue's columns, or nothing satisfies it.
        StorageError: if a path does not exist.
    """
    from coordlog.catalog.query import PATHS, ask
    from coordlog.record.files import Files

    found = gathered(paths, jobs=jobs, tell=False)
    rows = ask(PATHS, found.sources, where=where).column("path").to_pylist()
    kept = tuple(map(Path, dict.fromkeys(rows)))
    if not kept and (total := found.episodes().num_rows):
        raise ConfigError(f"--where: no episode of {total} satisfies: {where}")
    others = tuple(sorted(found.others.items()))
    return Files(kept, tuple(found.parts), tuple(found.skipped), others)


def catalogued(folder: Path, paths: Iterable[Path]) -> None:
    """Add episodes that were just written to the catalogue of their folder or pack; where none can
    be kept, whoever asks first describes them.
    """
    from coordlog.catalog.index import Catalog
    from coordlog.record.addresses import size_and_time
    from coordlog.record.places import Entry, is_url

    if is_url(folder):  # every file would be fetched again; the next question does that
        return
    entries = []
    for path in paths:
        stamp = size_and_time(path)
        if stamp is not None:
            entries.append(Entry(path.relative_to(folder).as_posix(), *stamp))
    if entries:
        Catalog(folder).add(entries)
