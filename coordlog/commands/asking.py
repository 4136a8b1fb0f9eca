"""What `query`, `select` and `diff` have in common: the catalogues of what was named."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coordlog.commands import terminal
from coordlog.parallel import mapped

if TYPE_CHECKING:
    from coordlog.catalog.gather import Gathered
    from coordlog.catalog.rows import Job

SAID = 20
"""Files left out that are printed."""


def gathered(paths: Sequence[Path], *, scan: bool = True, jobs: str = "0") -> Gathered:
    """The episodes that some paths name; notes and what is left out are printed.

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
    for reason in found.left_out[:SAID]:
        terminal.note(f"skipped: {reason}")
    if len(found.left_out) > SAID:
        terminal.note(f"skipped: {len(found.left_out) - SAID} more")
    return found
