"""coordlog check: can every file be trusted, down to the last bit?"""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coordlog.commands import terminal
from coordlog.errors import (
    EXIT_CHECK_FAILED,
    EXIT_PARTIAL,
    CoordlogError,
    FormatError,
    StorageError,
    TruncatedError,
    unknown,
)
from coordlog.parallel import JOBS_HELP, SHARD_HELP, batches, mapped
from coordlog.parallel import shard as share

if TYPE_CHECKING:
    from collections.abc import Iterable

    from coordlog.verify.finding import Finding

BATCH = 32
"""Files that are replayed together: one simulation each."""


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
    jobs: Annotated[str, typer.Option(help=JOBS_HELP)] = "0",
    shard: Annotated[str, typer.Option(help=SHARD_HELP, metavar="I/N")] = "",
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
    from coordlog.record.files import find_files, nothing_found
    from coordlog.verify.levels import LEVELS, check_files

    if level not in LEVELS:
        raise unknown("level", level, LEVELS)
    files = find_files(path)
    files = files._replace(paths=tuple(share(files.paths, shard)))
    paths, skipped, findings = _recognised(
        list(files.paths), alone=path[0] if len(path) == 1 else None
    )
    left_out = {item.path: f"{item.path}: {item.reason}" for item in files.skipped} | skipped
    if not paths and not findings:  # a proof that looked at nothing is none
        _name(left_out.values(), files.parts)
        raise nothing_found(path, files._replace(skipped=()))
    inexact: dict[str, str] = {}
    notes: list[str] = []
    began, steps = time.perf_counter(), 0
    with terminal.progress() as bar:
        task = bar.add_task(f"checking ({level})", total=len(paths), note="")
        for answer in mapped(partial(check_files, level=level), batches(paths, BATCH), jobs=jobs):
            findings += answer.findings
            inexact |= answer.inexact
            notes += answer.notes
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
        "notes": notes,
        "skipped": {str(name): reason for name, reason in left_out.items()},
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
    if left_out or files.parts:
        raise typer.Exit(EXIT_PARTIAL)


def _recognised(
    paths: list[Path], *, alone: Path | None
) -> tuple[list[Path], dict[Path, str], list[Finding]]:
    """Files that look like episodes, files that do not, and findings for episodes that are cut off.

    Raises:
        FormatError: if the only file that was named is no episode.
    """
    from coordlog.record.reader import probe

    known: list[Path] = []
    skipped: dict[Path, str] = {}
    findings: list[Finding] = []
    for path in paths:
        try:
            probe(path)
            known.append(path)
        except TruncatedError as error:
            findings.append(_unusable(path, error))
        except (FormatError, StorageError) as error:
            if path == alone:
                raise
            skipped[path] = str(error)
    return known, skipped, findings


def _unusable(path: Path, error: CoordlogError) -> Finding:
    from coordlog.verify.finding import Finding

    return Finding(str(path), "file", None, "file", "a finished episode", str(error))


def _name(skipped: Iterable[str], parts: Iterable[object]) -> None:
    """Name what was left out."""
    for reason in skipped:
        terminal.note(f"skipped: {reason}")
    for name in parts:
        terminal.note(f"unfinished: {name}; `coordlog recover` makes an episode of it")


def _show(report: dict[str, Any], findings: list[Finding]) -> None:
    for item in findings:
        terminal.say(item, style="red")
    _name(report["skipped"].values(), report["unfinished"])
    for note in report["notes"]:
        terminal.note(note)
    reasons = sorted(set(report["inexact"].values()))
    observed = sum(reason.startswith("observed") for reason in reasons)
    for reason in reasons:
        near = "" if reason.startswith("observed") else "bits not compared, only values near: "
        terminal.note(near + reason)
    files, steps = report["files"], report["steps"]
    did = (
        f"{steps:,} steps simulated again and compared"
        if report["level"] == "replay"
        else f"checked at level {report['level']}"
    )
    verdict = f"{len(findings)} findings" if findings else "all sound"
    if observed:
        verdict = f"{len(findings)} findings; {observed} observed, whose physics nobody can prove"
    terminal.say(
        f"{files} episodes, {did} in {report['seconds']:.1f} s: {verdict}",
        style="bold red" if findings else "bold green",
    )
