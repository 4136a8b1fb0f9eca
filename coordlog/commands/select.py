"""coordlog select: a list of episodes, to be used where a folder is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Jobs, flag, json_flag
from coordlog.errors import EXIT_PARTIAL, ConfigError

if TYPE_CHECKING:
    from coordlog.record.manifest import Manifest


def select(
    path: Annotated[
        list[Path],
        typer.Argument(help="Folders, packs, stores, manifests, files; several are merged."),
    ],
    out: Annotated[Path, typer.Option(help="The manifest to write.", metavar="NAME.manifest")],
    where: Annotated[
        str, typer.Option(help='Which episodes, in SQL: "clean and length < 90".')
    ] = "",
    minus: Annotated[
        list[Path] | None, typer.Option(help="Manifests whose episodes are left out.")
    ] = None,
    unique: Annotated[
        str, typer.Option(help="Of episodes equal in these columns keep the first: goal,policy.")
    ] = "",
    split: Annotated[
        str,
        typer.Option(help="Divide them: 0.8,0.1,0.1 into train, validation, test; or a=.5,b=.5."),
    ] = "",
    by: Annotated[str, typer.Option(help="Column whose equal values stay in one part.")] = "goal",
    seed: Annotated[int, typer.Option(help="Another seed divides otherwise.")] = 0,
    label: Annotated[str | None, typer.Option(help="A label for all of them.")] = None,
    force: Annotated[
        bool, flag("--force", "Write the next version; the one before stays, NAME@HASH.")
    ] = False,
    jobs: Jobs = "0",
    as_json: Annotated[bool, json_flag("what was selected")] = False,
) -> None:
    """List episodes by the sha256 of their files: drop, merge, divide, relabel without touching
    one.

    The manifest goes wherever a folder goes, and NAME.manifest:PART is one part of it. Its hash
    depends on what is in it alone. Exit code 3 if files could not be used, or episodes are gone.

    Examples:

        coordlog select logs/ --where clean --split 0.8,0.1,0.1 --by goal --out clean.manifest

        coordlog select a.manifest b.manifest --minus bad.manifest --out both.manifest

        coordlog train --from clean.manifest:train
    """
    from coordlog.catalog.asking import gathered
    from coordlog.catalog.selection import Split
    from coordlog.catalog.selection import select as chosen
    from coordlog.record import manifest

    if out.suffix != manifest.SUFFIX:
        raise ConfigError(f"--out: expected a name that ends in {manifest.SUFFIX}, got {out}")
    how = Split.parse(split, by=by, seed=seed) if split else None
    found = gathered(path, jobs=jobs, monitor=terminal.Watcher())
    lists = [manifest.read(each) for each in minus or []]
    made = chosen(found, where=where, minus=lists, unique=unique, split=how, label=label, out=out)
    if not made.chosen:
        raise ConfigError(f"--where: no episode satisfies: {where or 'what was asked for'}")
    written = manifest.write(out, made, force=force)
    _show(out, written, as_json)
    if found.skipped:
        raise typer.Exit(EXIT_PARTIAL)


def _show(out: Path, written: Manifest, as_json: bool) -> None:
    count = len(written.chosen)
    if as_json:
        said = {"manifest": str(out), "hash": written.hash, "version": written.version}
        terminal.print_json(said | {"episodes": count, "parts": written.parts})
        return
    parts = ", ".join(f"{count:,} {name}" for name, count in written.parts.items() if name)
    terminal.say(
        f"{out}: {count:,} episodes{f' ({parts})' if parts else ''}, version"
        f" {written.version}, {written.hash[:12]}",
    )
