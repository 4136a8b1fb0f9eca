"""coordlog check: can every file be trusted, down to the last bit?"""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from coordlog.commands import terminal
from coordlog.errors import EXIT_CHECK_FAILED, EXIT_PARTIAL, FormatError, TruncatedError, unknown
from coordlog.parallel import batches, mapped

if TYPE_CHECKING:
    from coordlog.episode import Array, Json
    from coordlog.verify.finding import Finding

LEVELS = ("file", "content", "replay")
BATCH = 32
"""Files that are replayed together: one simulation each."""


class Checked(NamedTuple):
    """What checking some files showed."""

    findings: list[Finding]
    inexact: dict[str, str]
    files: int
    steps: int


def check(
    path: Annotated[
        list[Path], typer.Argument(help="Files, or folders that are searched at any depth.")
    ],
    level: Annotated[
        str,
        typer.Option(
            help="file: structure and CRCs. content: and values. replay: and the physics, bit for bit."
        ),
    ] = "replay",
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0 for one per core.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Prove that every episode is whole, consistent, and can be simulated again from its file
    alone.

    Exit code 1 if anything is found, 3 if a folder holds files that are no episodes (named and
    skipped).

    Examples:

        coordlog check logs/

        coordlog check logs/ --level content --json
    """
    from coordlog.record.dataset import find_files

    if level not in LEVELS:
        raise unknown("level", level, LEVELS)
    files = find_files(path)
    paths, skipped, findings = _recognised(
        list(files.paths), alone={item for item in path if item.is_file()}
    )
    inexact: dict[str, str] = {}
    began, steps = time.perf_counter(), 0
    with terminal.progress() as bar:
        task = bar.add_task(f"checking ({level})", total=len(paths), note="")
        for answer in mapped(partial(check_files, level=level), batches(paths, BATCH), jobs=jobs):
            findings += answer.findings
            inexact |= answer.inexact
            steps += answer.steps
            bar.update(
                task, advance=answer.files, note=f"{len(findings)} findings" if findings else ""
            )
    seconds = time.perf_counter() - began
    report = {
        "level": level,
        "files": len(paths),
        "findings": [item._asdict() for item in findings],
        "inexact": inexact,
        "skipped": {str(name): reason for name, reason in skipped.items()},
        "unfinished": [str(name) for name in files.parts],
        "steps": steps,
        "seconds": seconds,
    }
    if as_json:
        terminal.print_json(report)
    else:
        _show(report, findings)
    if findings:
        raise typer.Exit(EXIT_CHECK_FAILED)
    if skipped or files.parts:
        raise typer.Exit(EXIT_PARTIAL)


def check_files(paths: list[Path], *, level: str) -> Checked:
    """Check some files at a level; runs in a process of its own."""
    from coordlog.verify.file import check as check_one

    findings = [
        item
        for path in paths
        for item in check_one(
            path, level="file" if level == "file" else "content", rewards=logged_rewards
        )
    ]
    if level != "replay":
        return Checked(findings, {}, len(paths), 0)
    from coordlog.verify.physics import check_replay

    damaged = {item.path for item in findings if item.level == "file"}
    replays = check_replay([path for path in paths if str(path) not in damaged])
    return Checked(findings + replays.findings, replays.inexact, len(paths), replays.steps)


def logged_rewards(
    distance: Array,
    boundary: Array,
    goal: Array,
    collision: Array,
    instability: Array,
    constants: Json,
) -> Array:
    """The reward equation with the constants of a log, (T, k)."""
    from coordlog.config import build
    from coordlog.tasks.config import RewardConfig
    from coordlog.tasks.reach.reward import Flags, rewards

    return rewards(
        distance,
        Flags(boundary, goal, collision, instability),
        build(RewardConfig, constants),
    )


def _recognised(
    paths: list[Path], *, alone: set[Path]
) -> tuple[list[Path], dict[Path, str], list[Finding]]:
    """Files that look like episodes, files that do not, and findings for episodes that are cut off.

    Raises:
        FormatError: if a file that was named itself is no episode.
    """
    from coordlog.record.reader import probe
    from coordlog.verify.finding import Finding

    known: list[Path] = []
    skipped: dict[Path, str] = {}
    findings: list[Finding] = []
    for path in paths:
        try:
            probe(path)
            known.append(path)
        except TruncatedError as error:
            findings.append(
                Finding(str(path), "file", None, "file", "a finished episode", str(error))
            )
        except FormatError as error:
            if path in alone:
                raise
            skipped[path] = str(error)
    return known, skipped, findings


def _show(report: dict[str, Any], findings: list[Finding]) -> None:
    for item in findings:
        terminal.out.print(str(item), style="red", highlight=False, markup=False, soft_wrap=True)
    for reason in report["skipped"].values():
        terminal.note(f"skipped: {reason}")
    for name in report["unfinished"]:
        terminal.note(f"unfinished: {name}; `coordlog recover` makes an episode of it")
    for reason in sorted(set(report["inexact"].values())):
        terminal.note(f"bits not compared, only values within tolerances: {reason}")
    files, steps = report["files"], report["steps"]
    did = (
        f"{steps:,} steps simulated again and compared"
        if report["level"] == "replay"
        else f"checked at level {report['level']}"
    )
    verdict = (
        "[bold green]all sound[/bold green]"
        if not findings
        else f"[bold red]{len(findings)} findings[/bold red]"
    )
    terminal.out.print(
        f"{files} episodes, {did} in {report['seconds']:.1f} s: {verdict}", highlight=False
    )
