"""coordlog pack and unpack: many episode files, unchanged, in a few large ones; and back."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Jobs, Shard, json_flag
from coordlog.errors import EXIT_INTERRUPTED, EXIT_PARTIAL
from coordlog.parallel import shard as share

if TYPE_CHECKING:
    from coordlog.catalog.packing import Packed

MEGABYTE = 1_000_000


def pack(
    path: Annotated[list[Path], typer.Argument(help="Folders, packs, stores, manifests or files.")],
    out: Annotated[Path, typer.Option(help="Folder of the pack; one that is there grows.")],
    size: Annotated[
        int, typer.Option(min=1, help="Megabytes after which the next shard is begun.")
    ] = 256,
    shard: Shard = "",
    catalogue: Annotated[
        bool, typer.Option("--index/--no-index", help="Bring the pack's catalogue up to date.")
    ] = True,
    jobs: Jobs = "0",
    as_json: Annotated[bool, json_flag("what was packed")] = False,
) -> None:
    """Put whole episode files into large tar archives that every command reads like a folder.

    Files are not changed, and stay where they are. What the pack has already is not packed again,
    so the same command goes on where it stopped. Exit code 3 if files could not be used; each is
    named.

    Examples:

        coordlog pack logs/ --out PACK/

        coordlog check PACK/
    """
    from coordlog.catalog.asking import gathered
    from coordlog.catalog.packing import pack_files
    from coordlog.record.places import require_folder

    require_folder(out)
    files, left_out = _found(path)
    work = share(files, shard)
    with terminal.progress() as bar, terminal.interruptible() as interrupted:
        task = bar.add_task("packing", total=len(work), note="")
        done = pack_files(
            work,
            out,
            shard_bytes=size * MEGABYTE,
            tell=lambda: bar.update(task, advance=1),
            stop=lambda: bool(interrupted),
        )
    left_out += [f"skipped: {each}" for each in done.left_out]
    if catalogue and not interrupted:
        found = gathered([out], jobs=jobs, monitor=terminal.Watcher(), tell=False)
        left_out += [f"skipped: {path}: {why}" for path, why in found.skipped]
    _tell(done, f"{out}: {done.files:,} episodes packed", as_json=as_json)
    _finish(bool(interrupted), left_out)


def unpack(
    path: Annotated[list[Path], typer.Argument(help="Packs, or addresses of their shards.")],
    out: Annotated[Path, typer.Option(help="Folder for the files; nothing in it is replaced.")],
    as_json: Annotated[bool, json_flag("what was unpacked")] = False,
) -> None:
    """Give the episode files of packs back, byte for byte; also copies stores into a folder.

    Files that are there with the same bytes are left alone.

    Examples:

        coordlog unpack PACK/ --out logs/
    """
    from coordlog.catalog.packing import unpack_files
    from coordlog.record.places import require_folder

    require_folder(out)
    files, left_out = _found(path)
    with terminal.progress() as bar, terminal.interruptible() as interrupted:
        task = bar.add_task("unpacking", total=len(files), note="")
        done = unpack_files(
            files, out, tell=lambda: bar.update(task, advance=1), stop=lambda: bool(interrupted)
        )
    _tell(done, f"{out}: {done.files:,} episodes unpacked", as_json=as_json)
    _finish(bool(interrupted), left_out)


def _found(paths: Sequence[Path]) -> tuple[list[tuple[Path, str]], list[str]]:
    """Episodes and their names from what was named on, and what was left out."""
    from coordlog.record.addresses import name_within
    from coordlog.record.files import find_files, nothing_found

    files: list[tuple[Path, str]] = []
    left_out: list[str] = []
    for path in paths:
        found = find_files(path)
        if not found.paths:
            raise nothing_found([path], found)
        several = len(paths) > 1
        files += [(each, name_within(each, path, several=several)) for each in found.paths]
        left_out += [f"skipped: {each}" for each in found.left_out()]
    return files, left_out


def _tell(done: Packed, text: str, *, as_json: bool) -> None:
    if as_json:
        terminal.print_json(done._asdict())
        return
    there = f", {done.there:,} were there" if done.there else ""
    terminal.say(f"{text} ({terminal.megabytes(done.size)}){there}")


def _finish(interrupted: bool, left_out: list[str]) -> None:
    for reason in left_out:
        terminal.note(reason)
    if interrupted:
        terminal.note("interrupted; the same command goes on where it stopped")
        raise typer.Exit(EXIT_INTERRUPTED)
    if left_out:
        raise typer.Exit(EXIT_PARTIAL)
