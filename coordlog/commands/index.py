"""coordlog index: a catalogue of the episodes of a folder, a pack or a store."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Jobs, flag, json_flag
from coordlog.errors import EXIT_BAD_INPUT, EXIT_CHECK_FAILED, EXIT_PARTIAL, ConfigError
from coordlog.parallel import mapped

if TYPE_CHECKING:
    from coordlog.catalog.index import Catalog, Change, Mismatch
    from coordlog.catalog.rows import Job

SAID = 20
"""Broken files that are printed; --json has all."""


def index(
    path: Annotated[
        list[Path], typer.Argument(help="Folders, packs, or addresses such as s3://BUCKET/PREFIX.")
    ],
    compact: Annotated[bool, flag("--compact", "Merge the catalogue's files into one.")] = False,
    rebuild: Annotated[bool, flag("--rebuild", "Describe every file anew.")] = False,
    verify: Annotated[
        bool, flag("--verify", "Hash every file, whatever its size and time say.")
    ] = False,
    jobs: Jobs = "0",
    as_json: Annotated[bool, json_flag("what was found")] = False,
) -> None:
    """Bring the catalogue of a folder up to date: a row per episode, for `query` and `select`.

    Only files whose size or time have changed are read. The catalogue lies in `.catalog/` of the
    folder; deleting it costs only time. Exit code 3 if files are no sound episodes (named) or the
    catalogue could not be written, 1 if --verify finds other bytes than were catalogued.

    Examples:

        coordlog index logs/

        coordlog index PACK/ --verify
    """
    reports = [
        _bring(each, compact=compact, rebuild=rebuild, verify=verify, jobs=jobs, quiet=as_json)
        for each in path
    ]
    if as_json:
        terminal.print_json(reports)
    if any(report["mismatches"] for report in reports):
        raise typer.Exit(EXIT_CHECK_FAILED)
    if any(report["left_out"] for report in reports):
        some = any(report["episodes"] for report in reports)
        raise typer.Exit(EXIT_PARTIAL if some else EXIT_BAD_INPUT)
    if not all(report["kept"] for report in reports):
        raise typer.Exit(EXIT_PARTIAL)


def _bring(
    path: Path, *, compact: bool, rebuild: bool, verify: bool, jobs: str, quiet: bool
) -> dict[str, Any]:
    """Bring one catalogue up to date and say what came of it."""
    from coordlog.catalog.index import Catalog
    from coordlog.record.files import Files, Skipped, find_files, nothing_found
    from coordlog.record.places import is_url

    if path.is_file():
        raise ConfigError(f"{path}: expected a folder, a pack or an address, got a file")
    catalog = Catalog(path)
    files = Files((), ()) if is_url(path) else find_files(path)
    change = _update(catalog, path, rebuild=rebuild, jobs=jobs)
    wrong = catalog.verify() if verify else []
    if compact:
        catalog.compact()
    bad = catalog.broken()
    broken = [Skipped(catalog.store.path(name), why) for name, why in bad]
    files = files._replace(paths=(), skipped=(*files.skipped, *broken))
    count = catalog.episodes().num_rows
    for note in change.notes:
        terminal.note(note)
    if not quiet:
        _show(catalog.root, count, change, files.left_out(), wrong)
    if not count and not change.gone and not broken:
        raise nothing_found([path], files)
    return {
        "root": catalog.root,
        "episodes": count,
        **{name: getattr(change, name) for name in ("new", "changed", "gone", "kept")},
        "broken": dict(bad),
        "left_out": files.left_out(),
        "mismatches": [item._asdict() for item in wrong],
    }


def _update(catalog: Catalog, path: Path, *, rebuild: bool, jobs: str) -> Change:
    """Describe what is new under a progress bar."""
    with terminal.progress() as bar:
        task = bar.add_task(f"describing {path}", total=None, note="")

        def run(
            function: Callable[[Job], list[dict[str, Any]]], work: Sequence[Job]
        ) -> Iterator[list[dict[str, Any]]]:
            bar.update(task, total=sum(len(job.entries) for job in work))
            for rows in mapped(function, work, jobs=jobs):
                bar.update(task, advance=len(rows))
                yield rows

        return catalog.rebuild(run=run) if rebuild else catalog.refresh(run=run)


def _show(
    root: str,
    count: int,
    change: Change,
    left_out: list[str],
    wrong: list[Mismatch],
) -> None:
    terminal.say(
        f"{root}: {count:,} episodes; {change.new:,} new, {change.changed:,} changed,"
        f" {change.gone:,} gone",
    )
    for item in wrong:
        terminal.say(
            f"{item.path}: expected the sha256 {item.wanted[:12]}, got {item.got[:12]}: its bytes"
            " were changed",
            style="red",
        )
    for reason in left_out[:SAID]:
        terminal.note(f"skipped: {reason}")
    if len(left_out) > SAID:
        terminal.note(f"skipped: {len(left_out) - SAID} more; --json names them")
