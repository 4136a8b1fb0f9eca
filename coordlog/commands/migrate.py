"""coordlog migrate: episodes of an older schema version, written anew in the present one."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Files, Jobs, json_flag
from coordlog.errors import EXIT_PARTIAL, CoordlogError, StorageError
from coordlog.parallel import mapped


class Done(NamedTuple):
    """What became of one file."""

    source: Path
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
    where it is not. Old files are never changed: the new ones name them in their lineage. Exit code
    3 if some could not be migrated; each is named.

    Examples:

        coordlog migrate logs/ --out migrated/
    """
    from coordlog.record.files import find_files

    pairs = [
        (name, out / (name.relative_to(root) if root.is_dir() else name.name))
        for root in path
        for name in find_files(root).paths
    ]
    if not pairs:
        raise StorageError(f"no episodes (.mcap) under {', '.join(map(str, path))}")
    done: list[Done] = []
    with terminal.progress() as bar:
        task = bar.add_task("migrating", total=len(pairs), note="")
        for answer in mapped(partial(migrate_one), pairs, jobs=jobs):
            done.append(answer)
            bar.update(task, advance=1)
    if as_json:
        terminal.print_json([item._asdict() | {"source": str(item.source)} for item in done])
    for item in done if not as_json else ():
        if item.reason:
            terminal.note(f"{item.source}: {item.reason}")
    made = sum(bool(item.target) for item in done)
    if not as_json:
        terminal.out.print(f"{made} of {len(done)} episodes migrated to {out}/", markup=False)
    if made < len(done):
        raise typer.Exit(EXIT_PARTIAL)


def migrate_one(pair: tuple[Path, Path]) -> Done:
    """Migrate one file; runs in a process of its own."""
    from coordlog.record.recording import Recording
    from coordlog.verify.migration import migrate as migrated

    source, target = pair
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        made = migrated(Recording(source), target)
    except (CoordlogError, OSError) as error:
        return Done(source, "", f"not migrated: {str(error).removeprefix(f'{source}: ')}")
    reason = f"written without ctrl and torque: {made.reason}" if made.reason else ""
    return Done(source, str(made.path), reason)
