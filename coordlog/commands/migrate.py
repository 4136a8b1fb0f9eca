"""coordlog migrate: episodes of an older schema version, written anew in the present one."""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Files, Jobs, json_flag
from coordlog.errors import EXIT_BAD_INPUT, EXIT_PARTIAL, CoordlogError
from coordlog.parallel import mapped


class Done(NamedTuple):
    """What became of one file."""

    source: Path
    status: str
    """migrated, before (by an earlier run), present (of the present version), or failed"""
    target: str
    """The new file; "" if there is none."""
    reason: str
    """Why there is none, or why it is without actuators; "" if nothing is to be said."""


def migrate(
    path: Files,
    out: Annotated[Path, typer.Option(help="Folder of the new files; the old ones stay.")],
    jobs: Jobs = "0",
    as_json: Annotated[bool, json_flag("what became of each")] = False,
) -> None:
    """Write episodes of an older schema version as new files of the present one.

    What the present version logs besides is simulated again where that is exact, and left out
    where it is not. Old files are never changed: the new ones name them in their lineage. What is
    of the present version, or was migrated before, is left alone. Exit code 3 if some could not be
    migrated, each is named; 2 if none could.

    Examples:

        coordlog migrate logs/ --out migrated/
    """
    from coordlog.record.addresses import name_within
    from coordlog.record.files import find_files, nothing_found
    from coordlog.record.places import require_folder

    require_folder(out)
    given = [(root, find_files(root)) for root in path]
    pairs = [
        (name, out / name_within(name, root, several=False))
        for root, files in given
        for name in files.paths
    ]
    left_out = [reason for _, files in given for reason in files.left_out()]
    if not pairs:
        raise nothing_found(path, find_files(path))
    done: list[Done] = []
    with terminal.progress() as bar:
        task = bar.add_task("migrating", total=len(pairs), note="")
        for answer in mapped(partial(migrate_one), pairs, jobs=jobs):
            done.append(answer)
            bar.update(task, advance=1)
    if as_json:
        terminal.print_json([item._asdict() | {"source": str(item.source)} for item in done])
    else:
        _show(done, out)
    for reason in left_out:
        terminal.note(f"skipped: {reason}")
    failed = sum(item.status == "failed" for item in done)
    if failed == len(done):
        raise typer.Exit(EXIT_BAD_INPUT)
    if failed or left_out:
        raise typer.Exit(EXIT_PARTIAL)


def _show(done: list[Done], out: Path) -> None:
    for item in done:
        if item.reason:
            terminal.note(f"{item.source}: {item.reason}")
    counts = Counter(item.status for item in done)
    said = f"{counts['migrated']} of {len(done)} episodes migrated to {out}/"
    if counts["present"] + counts["before"] == len(done):
        said = f"nothing to do for {len(done)} episodes"
    if counts["present"]:
        said += f"; {counts['present']} of the present schema version already"
    if counts["before"]:
        said += f"; {counts['before']} migrated before"
    terminal.say(said)


def migrate_one(pair: tuple[Path, Path]) -> Done:
    """Migrate one file; runs in a process of its own."""
    from coordlog.record.recording import Recording
    from coordlog.verify.migration import migrate as migrated
    from coordlog.verify.migration import migrated_before, needs_none

    source, target = pair
    try:
        recording = Recording(source)
        if needs_none(recording):
            return Done(source, "present", "", "")
        if migrated_before(recording, target):
            return Done(source, "before", str(target), "")
        target.parent.mkdir(parents=True, exist_ok=True)
        made = migrated(recording, target)
    except (CoordlogError, OSError) as error:
        reason = f"not migrated: {str(error).removeprefix(f'{source}: ')}"
        return Done(source, "failed", "", reason)
    reason = f"written without ctrl and torque: {made.reason}" if made.reason else ""
    return Done(source, "migrated", str(made.path), reason)
