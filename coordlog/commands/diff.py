"""coordlog diff: how two sets of episodes differ."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Jobs, json_flag
from coordlog.errors import EXIT_CHECK_FAILED, EXIT_PARTIAL

if TYPE_CHECKING:
    from coordlog.catalog.selection import Difference

MANY = 20
"""Episodes of each kind that are printed; --json has all."""


def diff(
    a: Annotated[Path, typer.Argument(help="A folder, pack, store, manifest or file.")],
    b: Annotated[Path, typer.Argument(help="Another one.")],
    jobs: Jobs = "0",
    as_json: Annotated[bool, json_flag("the difference")] = False,
) -> None:
    """Compare two sets of episodes: which are in one alone, other settings, other figures.

    Episodes are the same if their files have the same sha256. Exit code 1 if the sets differ,
    3 if they do not and files, each named, could not be looked at.

    Examples:

        coordlog diff clean.manifest clean@1f2e3d4c5b6a.manifest

        coordlog diff logs/ PACK/
    """
    from coordlog.catalog.asking import gathered
    from coordlog.catalog.selection import difference

    watcher = terminal.Watcher()
    one, other = (gathered([each], jobs=jobs, monitor=watcher) for each in (a, b))
    found = difference(one, other)
    if as_json:
        terminal.print_json(asdict(found))
    else:
        _show(found, str(a), str(b))
    if found.only_a or found.only_b or found.moved:
        raise typer.Exit(EXIT_CHECK_FAILED)
    if one.skipped or other.skipped:
        raise typer.Exit(EXIT_PARTIAL)


def _show(found: Difference, a: str, b: str) -> None:
    lines = [f"{found.both:,} episodes in both"]
    for name, paths in ((a, found.only_a), (b, found.only_b)):
        lines.append(f"{len(paths):,} in {name} alone")
        lines += [f"  {path}" for path in paths[:MANY]]
        if len(paths) > MANY:
            lines.append(f"  … and {len(paths) - MANY:,} more")
    lines += [
        f"{digest[:12]}: {before or '-'} → {after or '-'}"
        for digest, before, after in found.moved[:MANY]
    ]
    for line in lines:
        terminal.say(line)
    for name, (before, after) in found.settings.items():
        text = f"{name}: {_listed(before)} → {_listed(after)}"
        terminal.say(text)
    rows = [
        (name, *("-" if value is None else f"{value:,.6g}" for value in values))
        for name, values in found.figures.items()
        if values != (None, None)
    ]
    terminal.table(("", a, b), rows, right=(a, b))


def _listed(values: list[object]) -> str:
    return ", ".join(map(str, values)) or "-"
