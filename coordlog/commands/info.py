"""coordlog info: what is in these files?"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Files, Jobs, json_flag
from coordlog.errors import EXIT_PARTIAL, FormatError

if TYPE_CHECKING:
    from coordlog.catalog.summary import Row, Summary

MANY = 40
"""Longer tables are shortened unless --all asks for every row."""


def info(
    path: Files,
    every: Annotated[
        bool,
        typer.Option("--all", help=f"Every episode, however many; otherwise the first {MANY}."),
    ] = False,
    jobs: Jobs = "0",
    as_json: Annotated[bool, json_flag("rows and totals")] = False,
) -> None:
    """Show what episodes there are: new and changed files are read, the catalogue knows the others.

    Examples:

        coordlog info logs/

        coordlog info logs/table-train-s0-000003-1f2e3d4c.mcap --json
    """
    from coordlog.catalog.asking import gathered
    from coordlog.catalog.summary import summary as summed
    from coordlog.record.files import Files, nothing_found

    summary = summed(gathered(path, jobs=jobs, monitor=terminal.Watcher(), tell=False))
    if not summary.rows:
        if len(path) == 1 and [item.path for item in summary.skipped] == path:
            raise FormatError(f"{path[0]}: {summary.skipped[0].reason}")
        _name(summary)
        raise nothing_found(path, Files((), summary.parts, (), summary.others))
    if as_json:
        terminal.print_json(summary.to_json())
    else:
        _show(summary, every=every)
    if summary.skipped:
        raise typer.Exit(EXIT_PARTIAL)


def _show(summary: Summary, *, every: bool) -> None:
    shown = summary.rows if every else summary.rows[:MANY]
    columns = (
        "episode",
        "scene",
        "policy",
        "steps",
        "s",
        "return per arm",
        "success",
        "clean",
        "end",
        "size",
    )
    if shown:
        terminal.table(columns, [_cells(row) for row in shown], right=("steps", "s", "size"))
    if len(shown) < len(summary.rows):
        terminal.note(f"{len(summary.rows) - len(shown)} more; --all shows them")
    totals = summary.totals
    if totals.episodes:
        share = (
            f"success {totals.success / totals.episodes:.1%}, clean "
            f"{totals.clean / totals.episodes:.1%}, aborted {totals.aborted}"
        )
        scenes = ", ".join(f"{count} {name}" for name, count in totals.scenes.items())
        size = terminal.megabytes(totals.size)
        line = (
            f"{totals.episodes} episodes ({scenes}), {totals.steps:,} steps, "
            f"{totals.duration:,.0f} s simulated, {size}; {share}"
        )
        terminal.say(line)
    for row in shown:
        if row.parents:
            terminal.say(
                f"{Path(row.path).name}: {row.transform} of "
                f"{', '.join(parent[:12] for parent in row.parents)}"
            )
    _name(summary)
    if len(shown) == 1:
        _show_contacts(shown[0])


def _name(summary: Summary) -> None:
    """Name what was left out."""
    for item in summary.skipped:
        terminal.note(f"skipped: {item.path}: {item.reason}")
    for part in summary.parts:
        terminal.note(f"unfinished: {part}; `coordlog recover` makes an episode of it")


def _show_contacts(row: Row) -> None:
    """What touched what in an episode, the pair that did so longest first."""
    from collections import Counter

    from coordlog.record.reader import read_episode

    episode = read_episode(Path(row.path))
    names, contacts = episode.header.env.get("geoms", []), episode.contacts
    steps = Counter(zip(contacts["geom1"].tolist(), contacts["geom2"].tolist(), strict=True))
    for (one, other), count in steps.most_common(MANY):
        pair = (contacts["geom1"] == one) & (contacts["geom2"] == other)
        label = " – ".join(
            (names[g] if g < len(names) else "") or f"geom {g}" for g in (one, other)
        )
        depth = contacts["depth"][pair].max() * 1e3
        terminal.say(f"contact: {label} at {count} steps, {depth:.1f} mm deep at most")


def _cells(row: Row) -> list[object]:
    returns = "  ".join(
        f"{value:.1f}" if math.isfinite(value) else str(value) for value in row.returns.values()
    )
    end = row.aborted or ("terminated" if row.terminated else "truncated" if row.truncated else "-")
    yes = {True: "yes", False: "no"}
    name = Path(row.path).name
    size = terminal.megabytes(row.size)
    return [
        name,
        row.scene,
        row.policy,
        row.length,
        f"{row.duration:.1f}",
        returns,
        yes[row.success],
        yes[row.clean],
        end,
        size,
    ]
