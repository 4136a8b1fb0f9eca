"""coordlog smooth: logs whose motion is smoother, and proven no less safe."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coordlog.commands import terminal
from coordlog.commands.smoothing import SKIPPED, Job, smooth_file
from coordlog.errors import EXIT_INTERRUPTED, EXIT_PARTIAL, ConfigError, StorageError
from coordlog.parallel import mapped

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.record.files import Files, Skipped

STATUSES = ("smoothed", "partly", "kept_raw", "raw_infeasible", SKIPPED)
SAID = 20
"""Reasons that are printed; the report has all."""


def smooth(
    path: Annotated[
        list[Path], typer.Argument(help="Episode files, or folders that are searched at any depth.")
    ],
    out: Annotated[
        Path, typer.Option(help="Folder for the smoothed episodes, laid out as the input.")
    ],
    method: Annotated[
        str,
        typer.Option(help="local, shared, or paper (joint by joint, the knots alone deciding)."),
    ] = "local",
    cutoff: Annotated[
        float | None,
        typer.Option(
            help="Lowest cut-off; without it, as smooth as the rules allow.", metavar="HZ"
        ),
    ] = None,
    max_deviation: Annotated[
        float | None, typer.Option(help="Farthest a joint may go from the log.", metavar="RAD")
    ] = None,
    clearance: Annotated[
        float,
        typer.Option(help="Distance to keep from the scene and from other limbs.", metavar="M"),
    ] = 0.005,
    report: Annotated[
        Path | None,
        typer.Option(help="Write every figure of every episode to this JSON file.", metavar="FILE"),
    ] = None,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0 for one per core.")] = 0,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Smooth and execute, show the figures, write no episode."),
    ] = False,
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Replace outputs made with other settings or from other files."
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Smooth the joint paths of recorded episodes, execute them in the simulation, and record that
    as episodes.

    Every usable input gives one output of the same name: the execution, with knots and spline,
    where it is proven and no worse than the log; otherwise the log's own steps and the reason. The
    logs are never touched. Outputs that are there are not made again.

    Exit code 3 if an episode kept its own steps or an input could not be used; each is named.

    Examples:

        coordlog smooth logs/ --out smoothed/

        coordlog smooth logs/ --out smoothed/ --cutoff 2 --clearance 0.01 --report report.json
    """
    from coordlog.smooth.config import Config

    settings = {
        "method": method,
        "cutoff": "max" if cutoff is None else cutoff,
        "max_deviation": max_deviation,
        "clearance": clearance,
    }
    Config.of(**settings)
    if report is not None and report.exists() and not force:
        raise StorageError(
            f"{report}: the file exists and is not overwritten; choose another name, or pass --force"
        )
    work, files = _plan(path, out, settings, write=not dry_run, force=force)
    parts, left_out = files.parts, [f"{item.path}: {item.reason}" for item in files.skipped]
    rows: list[Json] = []
    began = time.perf_counter()
    with terminal.progress() as bar, terminal.interruptible() as interrupted:
        task = bar.add_task("smoothing", total=len(work), note="")
        for row in mapped(smooth_file, work, jobs=jobs):
            rows.append(row)
            counts = Counter(each["status"] for each in rows)
            bar.update(
                task,
                advance=1,
                note=", ".join(f"{counts[name]} {name}" for name in STATUSES if counts[name]),
            )
            if interrupted:
                break
    summary = _summary(rows, settings, wanted=len(work), seconds=time.perf_counter() - began)
    summary["unfinished"] = [str(part) for part in parts]
    summary["skipped"] = left_out
    if report is not None:
        _write_report(report, summary)
    if as_json:
        terminal.print_json(summary)
    else:
        _show(summary, out=None if dry_run else out)
    if interrupted:
        terminal.note(
            f"interrupted after {len(rows)} of {len(work)} episodes; the same command goes on where it stopped"
        )
        raise typer.Exit(EXIT_INTERRUPTED)
    if (
        parts
        or left_out
        or any(row["status"] == SKIPPED or row["parameters"]["steps_of"] == "log" for row in rows)
    ):
        raise typer.Exit(EXIT_PARTIAL)


def _plan(
    paths: Sequence[Path], out: Path, settings: Json, *, write: bool, force: bool
) -> tuple[list[Job], Files]:
    """One job for every file, and what else was found.

    Raises:
        ConfigError: if an output could come to lie among the inputs, or two inputs would give one
            output.
        StorageError: if a path does not exist.
        SpecError: if there is no episode.
        FormatError: if the only file is none.
    """
    from coordlog.record.files import Files, find_files, nothing_found
    from coordlog.record.reader import probe

    whole = out.resolve()
    folders = sum(path.is_dir() for path in paths)
    work: dict[Path, Job] = {}
    parts: list[Path] = []
    skipped: list[Skipped] = []
    others: list[tuple[str, int]] = []
    for path in paths:
        here = path.resolve()
        if here.is_dir() and (whole.is_relative_to(here) or here.is_relative_to(whole)):
            raise ConfigError(
                f"--out {out}: expected a folder apart from the input {path}, got one inside the other; logs are never changed in place"
            )
        if not here.is_dir() and here.is_relative_to(whole):
            raise ConfigError(
                f"--out {out}: expected a folder that does not hold the input {path}; logs are never changed in place"
            )
        found = find_files(path)
        parts += found.parts
        skipped += found.skipped
        others += found.others
        for source in found.paths:
            below = source.relative_to(path) if path.is_dir() else Path(source.name)
            target = out / (Path(here.name) / below if folders > 1 and path.is_dir() else below)
            if target in work and work[target].source.resolve() != source.resolve():
                raise ConfigError(
                    f"{source} and {work[target].source} would both become {target}; smooth them into separate folders"
                )
            work[target] = Job(source, target, settings, write, force)
    files = Files((), tuple(parts), tuple(skipped), tuple(others))
    if not work:
        raise nothing_found(paths, files)
    if len(paths) == 1 and paths[0].is_file():
        probe(paths[0])
    return list(work.values()), files


def _summary(rows: list[Json], settings: Json, *, wanted: int, seconds: float) -> Json:
    """Counts, medians of the ratios after/before over what was executed, and every row."""
    done = [row["parameters"] for row in rows if row["parameters"].get("steps_of") == "execution"]
    counts = Counter(row["status"] for row in rows)
    return {
        "settings": settings,
        "wanted": wanted,
        "episodes": len(rows),
        "statuses": {name: counts[name] for name in STATUSES if counts[name]},
        "resumed": sum(row["resumed"] for row in rows),
        "certified": sum(bool(row["parameters"].get("certified")) for row in rows),
        "median": {
            "jerk": _median(
                [_ratio(each["before"]["jerk"], each["after"]["jerk"]) for each in done]
            ),
            "acceleration": _median(
                [
                    _ratio(each["before"]["acceleration"], each["after"]["acceleration"])
                    for each in done
                ]
            ),
            "torque_rate": _median(
                [
                    _ratio(each["torque"]["before"]["rate"], each["torque"]["after"]["rate"])
                    for each in done
                ]
            ),
            "path_torque_rate": _median(
                [
                    _ratio(*(each["path_torque"][at]["rate"] for at in ("before", "after")))
                    for each in done
                    if "path_torque" in each
                ]
            ),
            "torque_peak": _median(
                [
                    _ratio(each["torque"]["before"]["peak"], each["torque"]["after"]["peak"])
                    for each in done
                ]
            ),
            "max_deviation": _median([each["after"]["max_deviation"] for each in done]),
            "cpu": _median(
                [row["cpu"] for row in rows if not row["resumed"] and row["status"] != SKIPPED]
            ),
        },
        "cpu": sum(row["cpu"] for row in rows),
        "seconds": seconds,
        "rows": rows,
    }


def _ratio(before: float, after: float) -> float | None:
    return after / before if before else None


def _median(values: list[float | None]) -> float | None:
    known = sorted(value for value in values if value is not None)
    middle = len(known) // 2
    return (
        None
        if not known
        else known[middle]
        if len(known) % 2
        else (known[middle - 1] + known[middle]) / 2
    )


def _write_report(report: Path, summary: Json) -> None:
    try:
        report.parent.mkdir(parents=True, exist_ok=True)
        report.write_text(
            json.dumps(summary, indent=2, ensure_ascii=False) + "\n", encoding="utf-8"
        )
    except OSError as error:
        raise StorageError(f"{report}: cannot write the report: {error.strerror}") from error


def _show(summary: dict[str, Any], *, out: Path | None) -> None:
    median = summary["median"]

    def share(name: str, what: str) -> str:
        return "-" if median[name] is None else f"{median[name]:.3g} ×   {what}"

    named = [row for row in summary["rows"] if row["reason"]]
    for row in named[:SAID]:
        terminal.note(
            f"{row['status']}: {row['reason']}"
            if row["status"] == SKIPPED
            else f"{row['status']}: {row['source']}: {row['reason']}"
        )
    if len(named) > SAID:
        terminal.note(f"{len(named) - SAID} more; --report FILE has them all")
    for reason in summary["skipped"]:
        terminal.note(f"skipped: {reason}")
    for name in summary["unfinished"]:
        terminal.note(f"unfinished: {name}; `coordlog recover` makes an episode of it")
    where = "nothing written (--dry-run)" if out is None else f"{out}/"
    statuses = ", ".join(f"{count} {name}" for name, count in summary["statuses"].items()) or "none"
    pairs = [
        ("episodes", f"{summary['episodes']} of {summary['wanted']}: {statuses}"),
        (
            "output",
            where + (f"; {summary['resumed']} were there already" if summary["resumed"] else ""),
        ),
        ("certified", f"{summary['certified']}   proven between samples too"),
        ("jerk", share("jerk", "the log's (median, rest-padded RMS)")),
        ("acceleration", share("acceleration", "the log's")),
        ("torque rate", share("torque_rate", "the log's, executed")),
        (
            "path's rate",
            share("path_torque_rate", "the log's, by inverse dynamics along the path alone"),
        ),
        ("peak torque", share("torque_peak", "the log's, executed")),
        (
            "deviation",
            "-"
            if median["max_deviation"] is None
            else f"{median['max_deviation']:.2f} rad from the log at most (median)",
        ),
        (
            "time",
            f"{summary['seconds']:.1f} s, {(median['cpu'] or 0.0) * 1e3:.0f} ms of processor time for an episode (median)",
        ),
    ]
    terminal.facts(pairs)
