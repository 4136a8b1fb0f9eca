"""coordlog smooth: logs whose motion is smoother, and proven no less safe."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from coordlog.commands import terminal
from coordlog.commands.options import Episodes, Jobs, Shard, flag, json_flag
from coordlog.errors import EXIT_BAD_INPUT, EXIT_INTERRUPTED, EXIT_PARTIAL, StorageError

if TYPE_CHECKING:
    from coordlog.episode import Json

SAID = 20
"""Reasons that are printed; the report has all."""


Out = Annotated[Path, typer.Option(help="Folder for the smoothed episodes, laid out as the input.")]
Method = Annotated[
    str, typer.Option(help="local, shared, or paper (joint by joint, the knots alone deciding).")
]
Cutoff = Annotated[
    float | None,
    typer.Option(help="Lowest cut-off; without it, as smooth as the rules allow.", metavar="HZ"),
]
MaxDeviation = Annotated[
    float | None,
    typer.Option(help="Farthest a joint may go from the log: rad, m for slides.", metavar="RAD"),
]
Clearance = Annotated[
    float, typer.Option(help="Distance to keep from the scene and from other limbs.", metavar="M")
]
Report = Annotated[
    Path | None,
    typer.Option(help="Write every figure of every episode to this JSON file.", metavar="FILE"),
]
DryRun = Annotated[
    bool, flag("--dry-run", "Smooth and execute, show the figures, write no episode.")
]
Force = Annotated[
    bool, flag("--force", "Replace outputs made with other settings or from other files.")
]


def smooth(
    path: Episodes,
    out: Out,
    method: Method = "local",
    cutoff: Cutoff = None,
    max_deviation: MaxDeviation = None,
    clearance: Clearance = 0.005,
    report: Report = None,
    jobs: Jobs = "0",
    shard: Shard = "",
    dry_run: DryRun = False,
    force: Force = False,
    as_json: Annotated[bool, json_flag("the report")] = False,
) -> None:
    """Smooth the joint paths of recorded episodes, execute them in the simulation, and record that
    as episodes.

    Every usable input gives one output of the same name: the execution, with knots and spline,
    where it is proven and no worse than the log; otherwise the log's own steps and the reason. The
    logs are never touched. Outputs that are there are not made again.

    Exit code 3 if an episode kept its own steps or an input could not be used, each is named; 2 if
    none could.

    Examples:

        coordlog smooth logs/ --out smoothed/

        coordlog smooth logs/ --out smoothed/ --cutoff 2 --clearance 0.01 --report report.json
    """
    from coordlog.api.smoothing import smooth_logs
    from coordlog.record.places import require_folder

    require_folder(out)
    settings = {
        "method": method,
        "cutoff": "max" if cutoff is None else cutoff,
        "max_deviation": max_deviation,
        "clearance": clearance,
    }
    if report is not None and report.exists() and not force:
        said = "the file exists and is not overwritten; choose another name, or pass --force"
        raise StorageError(f"{report}: {said}")
    how: Json = {"write": not dry_run, "force": force, "share": shard, "jobs": jobs}
    with terminal.interruptible() as monitor:
        found = smooth_logs(path, out, settings, **how, monitor=monitor)
    if report is not None:
        _write_report(report, found)
    if as_json:
        terminal.print_json(found)
    else:
        _show(found, out=None if dry_run else out)
    _end(found, interrupted=monitor.stopped)


def _end(found: Json, *, interrupted: bool) -> None:
    """The exit code of what became of the episodes."""
    from coordlog.smooth.report import SKIPPED

    rows = found["rows"]
    if interrupted:
        terminal.note(
            f"interrupted after {found['episodes']} of {found['wanted']} episodes; "
            "the same command goes on where it stopped"
        )
        raise typer.Exit(EXIT_INTERRUPTED)
    if rows and all(row["status"] == SKIPPED for row in rows):
        raise typer.Exit(EXIT_BAD_INPUT)
    kept = [row for row in rows if row["parameters"].get("steps_of", "log") == "log"]
    if found["unfinished"] or found["skipped"] or kept:
        raise typer.Exit(EXIT_PARTIAL)


def _write_report(report: Path, summary: Json) -> None:
    try:
        report.parent.mkdir(parents=True, exist_ok=True)
        report.write_text(
            json.dumps(summary, indent=2, ensure_ascii=False) + "\n", encoding="utf-8"
        )
    except OSError as error:
        raise StorageError(f"{report}: cannot write the report: {error.strerror}") from error


def _show(summary: Json, *, out: Path | None) -> None:
    median = summary["median"]

    def share(name: str, what: str) -> str:
        return "-" if median[name] is None else f"{median[name]:.3g} ×   {what}"

    _name_reasons(summary)
    where = "nothing written (--dry-run)" if out is None else f"{out}/"
    statuses = ", ".join(f"{count} {name}" for name, count in summary["statuses"].items()) or "none"
    resumed = f"; {summary['resumed']} were there already" if summary["resumed"] else ""
    away, cpu = median["max_deviation"], (median["cpu"] or 0.0) * 1e3
    terminal.facts(
        [
            ("episodes", f"{summary['episodes']} of {summary['wanted']}: {statuses}"),
            ("output", where + resumed),
            ("certified", f"{summary['certified']}   proven between samples too"),
            ("jerk", share("jerk", "the log's (median, rest-padded RMS)")),
            ("acceleration", share("acceleration", "the log's")),
            ("torque rate", share("torque_rate", "the log's, executed")),
            ("path's rate", share("path_torque_rate", "the log's, by inverse dynamics")),
            ("peak torque", share("torque_peak", "the log's, executed")),
            (
                "deviation",
                "-" if away is None else f"{away:.2f} rad or m from the log at most (median)",
            ),
            ("time", f"{summary['seconds']:.1f} s, {cpu:.0f} ms of processor time for an episode"),
        ]
    )


def _name_reasons(summary: Json) -> None:
    """What was not simply smoothed, each with its reason, the first twenty."""
    from coordlog.smooth.report import SKIPPED

    named = [row for row in summary["rows"] if row["reason"]]
    for row in named[:SAID]:
        source = "" if row["status"] == SKIPPED else f"{row['source']}: "
        terminal.note(f"{row['status']}: {source}{row['reason']}")
    if len(named) > SAID:
        terminal.note(f"{len(named) - SAID} more; --report FILE has them all")
    for reason in summary["skipped"]:
        terminal.note(f"skipped: {reason}")
    for name in summary["unfinished"]:
        terminal.note(f"unfinished: {name}; `coordlog recover` makes an episode of it")
