"""Folders of episodes smoothed into folders of episodes: plan, one job for each file, a summary.

Outputs that are there and would be made the same again are left alone; inputs are never touched.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from coordlog.errors import ConfigError, CoordlogError, SpecError, StorageError
from coordlog.parallel import mapped

if TYPE_CHECKING:
    from coordlog.episode import Episode, Json
    from coordlog.record.files import Files
    from coordlog.record.recording import Recording

TRANSFORM = "smooth"
SKIPPED = "skipped"
STATUSES = ("smoothed", "partly", "kept_raw", "raw_infeasible", SKIPPED)

DEFAULTS: Json = {"method": "local", "cutoff": "max", "max_deviation": None, "clearance": 0.005}
"""Options of a batch that are not given."""


class Job(NamedTuple):
    """One episode to smooth."""

    source: Path
    target: Path
    settings: Json
    """Options of `coordlog.smooth.smooth`; the lineage keeps them."""
    write: bool
    force: bool
    """Replace an output that was made with other settings or from another file."""


class Batch(NamedTuple):
    """What there is to do."""

    jobs: list[Job]
    files: Files
    """What else was found: parts that no writer has finished, and what could not be read."""

    def run(self, *, processes: int | str = 0) -> Iterator[Json]:
        """Rows of the report (see `smooth_file`), in the order of the jobs.

        Args:
            processes: 0 for one per core; or a cluster, see `parallel.mapped`.
        """
        return mapped(smooth_file, self.jobs, jobs=processes)


def plan(
    paths: Sequence[Path], out: Path, settings: Json, *, write: bool = True, force: bool = False
) -> Batch:
    """One job for every file.

    Args:
        paths: Episode files, or folders that are searched at any depth.
        out: Folder for the outputs, laid out as the input.
        settings: Options of `coordlog.smooth.smooth` that are not as in `DEFAULTS`.
        write: Write the outputs; without it, only smooth and execute.
        force: Replace outputs that were made with other settings or from other files.

    Raises:
        ConfigError: if an option is unknown or out of range, an output could come to lie among the
            inputs, or two inputs would give one output.
        StorageError: if a path does not exist.
        SpecError: if there is no episode.
        FormatError: if the only file is none.
    """
    from coordlog.record.files import Files, find_files, nothing_found
    from coordlog.record.reader import probe
    from coordlog.smooth.config import Config

    settings = DEFAULTS | settings
    Config.of(**settings)
    folders = sum(path.is_dir() for path in paths)
    work: dict[Path, Job] = {}
    files = Files((), (), (), ())
    for path in paths:
        _require_apart(path, out)
        found = find_files(path)
        files = Files(
            (),
            files.parts + found.parts,
            files.skipped + found.skipped,
            files.others + found.others,
        )
        for source in found.paths:
            below = source.relative_to(path) if path.is_dir() else Path(source.name)
            inside = folders > 1 and path.is_dir()
            target = out / (Path(path.resolve().name) / below if inside else below)
            if target in work and work[target].source.resolve() != source.resolve():
                raise ConfigError(
                    f"{source} and {work[target].source} would both become {target}; "
                    "smooth them into separate folders"
                )
            work[target] = Job(source, target, settings, write, force)
    if not work:
        raise nothing_found(paths, files)
    if len(paths) == 1 and paths[0].is_file():
        probe(paths[0])
    return Batch(list(work.values()), files)


def _require_apart(path: Path, out: Path) -> None:
    """Refuse an output folder among the inputs."""
    whole, here = out.resolve(), path.resolve()
    if here.is_dir() and (whole.is_relative_to(here) or here.is_relative_to(whole)):
        raise ConfigError(
            f"--out {out}: expected a folder apart from the input {path}, "
            "got one inside the other; logs are never changed in place"
        )
    if not here.is_dir() and here.is_relative_to(whole):
        raise ConfigError(
            f"--out {out}: expected a folder that does not hold the input {path}; "
            "logs are never changed in place"
        )


def smooth_file(job: Job) -> Json:
    """Smooth, execute and write one episode.

    What cannot be used is said in the row and never raised.

    Returns:
        One row of the report: source, target, status, reason, seconds of processor time, and
        `parameters` as the output's lineage has them.
    """
    if multiprocessing.parent_process() is not None:
        # The parent hears of Ctrl-C and lets this episode be finished.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    began = time.process_time()
    row: Json = {"source": str(job.source), "target": str(job.target), "resumed": False}
    try:
        parameters, resumed = _smoothed(job)
        row |= {
            "status": parameters["status"],
            "reason": parameters["reason"],
            "resumed": resumed,
            "parameters": parameters,
        }
    except CoordlogError as error:
        # Errors of what knows no files name none.
        named = str(job.source) in str(error)
        reason = str(error) if named else f"{job.source}: {error}"
        row |= {"status": SKIPPED, "reason": reason, "parameters": {}}
    return row | {"cpu": time.process_time() - began}


def _smoothed(job: Job) -> tuple[Json, bool]:
    """Parameters of the lineage, and whether the output was there already."""
    from coordlog.record.recording import Recording
    from coordlog.sim.foreign import TASK
    from coordlog.smooth.kinematic import smooth_observed
    from coordlog.smooth.recorded import smooth_episode

    recording = Recording(job.source)
    before = _made_before(job, recording.digest)
    if before is not None:
        return before, True
    if recording.result.aborted:
        raise StorageError(
            f"{job.source}: expected an episode that ended, got an aborted one "
            f"({recording.result.aborted}); nothing to smooth"
        )
    observed = recording.header.kind == "observed"
    if not observed and recording.header.task == TASK:
        raise SpecError(
            f"{job.source}: expected a joint path that position servos followed, got steps of "
            "another program's environment; `view`, `plot` and `export` take it"
        )
    transform = smooth_observed if observed else smooth_episode
    smoothed, parameters = transform(recording, job.settings)
    if job.write:
        _write(job, smoothed, recording)
    return parameters, False


def _made_before(job: Job, digest: str) -> Json | None:
    """Parameters of the output if it is there and is what would be made again.

    Raises:
        StorageError: if something else has its name, and it is not to be replaced.
    """
    from coordlog.record.reader import read_summary

    if not job.target.exists():
        return None
    lineage: Json = {"transform": ""}
    with suppress(CoordlogError):
        lineage = read_summary(job.target).header.lineage
    if (
        lineage["transform"] == TRANSFORM
        and lineage["parents"] == [digest]
        and lineage["parameters"]["settings"] == job.settings
    ):
        return dict(lineage["parameters"])
    ours = lineage["transform"] == TRANSFORM
    if job.force and ours:
        return None
    if ours:
        raise StorageError(
            f"{job.target}: the file exists and was made from another file or with other settings; "
            "choose another --out, or pass --force"
        )
    raise StorageError(
        f"{job.target}: the file exists and was not made by coordlog smooth; choose another --out"
    )


def _write(job: Job, episode: Episode, recording: Recording) -> None:
    """Write the output; a part file that a killed run left is removed first."""
    from coordlog.episode import MODEL_XML
    from coordlog.record.display import Shown
    from coordlog.record.storage import PART
    from coordlog.record.writer import write_episode
    from coordlog.sim.description import Description

    attached, shown = recording.attachments, None
    if MODEL_XML in attached:
        shown = Shown(Description(recording.model), recording.initial_state)
    try:
        job.target.parent.mkdir(parents=True, exist_ok=True)
        exists = job.target.exists()
        beside = job.target.with_name(f"new-{job.target.name}") if exists else job.target
        beside.with_name(beside.name + PART).unlink(missing_ok=True)
        write_episode(beside, episode, attachments=attached, display=True, shown=shown)
        if beside != job.target:
            os.replace(beside, job.target)
    except OSError as error:
        raise StorageError(f"{job.target}: cannot write: {error.strerror}") from error


def summary(rows: list[Json], batch: Batch, settings: Json, *, seconds: float) -> Json:
    """Counts, medians of the ratios after/before over what was made anew, and every row."""
    done = [row["parameters"] for row in rows if row["parameters"].get("steps_of", "log") != "log"]
    counts = Counter(row["status"] for row in rows)
    fresh = [row for row in rows if not row["resumed"] and row["status"] != SKIPPED]

    def ratio(name: str, *keys: str) -> float | None:
        return _median([_ratio(each, name, *keys) for each in done])

    return {
        "settings": settings,
        "wanted": len(batch.jobs),
        "episodes": len(rows),
        "statuses": {name: counts[name] for name in STATUSES if counts[name]},
        "resumed": sum(row["resumed"] for row in rows),
        "certified": sum(bool(row["parameters"].get("certified")) for row in rows),
        "median": {
            "jerk": ratio("", "jerk"),
            "acceleration": ratio("", "acceleration"),
            "torque_rate": ratio("torque", "rate"),
            "path_torque_rate": ratio("path_torque", "rate"),
            "torque_peak": ratio("torque", "peak"),
            "max_deviation": _median([each["after"]["max_deviation"] for each in done]),
            "cpu": _median([row["cpu"] for row in fresh]),
        },
        "cpu": sum(row["cpu"] for row in rows),
        "seconds": seconds,
        "rows": rows,
        "unfinished": [str(part) for part in batch.files.parts],
        "skipped": [f"{item.path}: {item.reason}" for item in batch.files.skipped],
    }


def _ratio(parameters: Json, section: str, key: str) -> float | None:
    """What a figure became, of what it was; None where either is not known."""
    figures = parameters.get(section) if section else parameters
    if not figures or not figures.get("before") or not figures.get("after"):
        return None
    before, after = figures["before"][key], figures["after"][key]
    return after / before if before and after is not None else None


def _median(values: list[float | None]) -> float | None:
    known = sorted(value for value in values if value is not None)
    if not known:
        return None
    middle = len(known) // 2
    return known[middle] if len(known) % 2 else (known[middle - 1] + known[middle]) / 2
