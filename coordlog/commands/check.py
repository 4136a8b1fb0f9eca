"""coordlog check: can every file be trusted, down to the last bit?"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Files, Jobs, Shard, json_flag
from coordlog.errors import EXIT_CHECK_FAILED, EXIT_PARTIAL

if TYPE_CHECKING:
    from coordlog.verify.finding import Finding

Level = Annotated[
    str,
    typer.Option(
        help="file: structure and CRCs. content: and values. replay: and the physics, bit for bit."
    ),
]


def check(
    path: Files,
    level: Level = "replay",
    jobs: Jobs = "0",
    shard: Shard = "",
    as_json: Annotated[bool, json_flag("the findings")] = False,
) -> None:
    """Prove that every episode is whole, consistent, and can be simulated again from its file
    alone.

    Exit code 1 if anything is found, 3 if a folder holds files that are no episodes (named and
    skipped).

    Examples:

        coordlog check logs/

        coordlog check logs/ --level content --json
    """
    from coordlog.verify.levels import check_logs

    began = time.perf_counter()
    checked = check_logs(path, level=level, share=shard, jobs=jobs, monitor=terminal.Watcher())
    report = {
        "level": level,
        "files": checked.files,
        "findings": [item._asdict() for item in checked.findings],
        "inexact": checked.inexact,
        "notes": checked.notes,
        "skipped": checked.skipped,
        "unfinished": checked.unfinished,
        "steps": checked.steps,
        "seconds": time.perf_counter() - began,
    }
    if as_json:
        terminal.print_json(report)
    else:
        _show(report, checked.findings)
    if checked.findings:
        raise typer.Exit(EXIT_CHECK_FAILED)
    if checked.skipped or checked.unfinished:
        raise typer.Exit(EXIT_PARTIAL)


def _show(report: dict[str, Any], findings: list[Finding]) -> None:
    from coordlog.verify.levels import left_out_lines

    for item in findings:
        terminal.say(item, style="red")
    left_out = left_out_lines(report["skipped"].values(), report["unfinished"])
    for note in (*left_out, *report["notes"]):
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
