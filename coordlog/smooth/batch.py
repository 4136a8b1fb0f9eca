"""Folders of episodes smoothed into folders of episodes: plan, one job for each file, a report.

Outputs that are there and would be made the same again are left alone; inputs are never touched.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from coordlog.errors import ConfigError, CoordlogError, SpecError, StorageError
from coordlog.monitor import Monitor
from coordlog.parallel import mapped, shard
from coordlog.smooth.report import SKIPPED, STATUSES, summary

if TYPE_CHECKING:
    from coordlog.episode import Episode, Json
    from coordlog.record.files import Files
    from coordlog.record.recording import Recording

TRANSFORM = "smooth"

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


def smooth_logs(
    paths: Sequence[Path],
    out: Path,
    settings: Json,
    *,
    write: bool = True,
    force: bool = False,
    share: str = "",
    jobs: int | str = 0,
    monitor: Monitor | None = None,
) -> Json:
    """Smooth every episode of some logs, in the order of their names, and report
    (`report.summary`).

    Args:
        paths: Episode files, or folders that are searched at any depth.
        out: Folder for the outputs, laid out as the input.
        settings: Options of `coordlog.smooth.smooth` that are not as in `DEFAULTS`.
        write: Write the outputs; without it, only smooth and execute.
        force: Replace outputs that were made with other settings or from other files.
        share: "I/N": the I-th of N equal shares of the episodes; "" for all.
        jobs: Processes, 0 for one per core; or a cluster, see `parallel.mapped`.
        monitor: Hears of progress, and may ask to stop; what is done by then is reported.

    Raises:
        CoordlogError: as `plan`.
    """
    batch = plan(paths, out, settings, write=write, force=force)
    batch = batch._replace(jobs=list(shard(batch.jobs, share)))
    began = time.perf_counter()
    heard = Monitor() if monitor is None else monitor
    rows: list[Json] = []
    with heard.progress("smoothing", len(batch.jobs)) as progress:
        for row in mapped(smooth_file, batch.jobs, jobs=jobs):
            rows.append(row)
            counts = Counter(each["status"] for each in rows)
            said = (f"{counts[name]} {name}" for name in STATUSES if counts[name])
            progress.advance(1, ", ".join(said))
            if heard.stopped:
                break
    return summary(
        rows,
        DEFAULTS | settings,
        batch.files,
        wanted=len(batch.jobs),
        seconds=time.perf_counter() - began,
    )


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
    from coordlog.record.addresses import is_single, name_within
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
            target = out / name_within(source, path, several=folders > 1)
            if target in work and work[target].source.resolve() != source.resolve():
                raise ConfigError(
                    f"{source} and {work[target].source} would both become {target}; "
                    "smooth them into separate folders"
                )
            work[target] = Job(source, target, settings, write, force)
    if not work:
        raise nothing_found(paths, files)
    if len(paths) == 1 and is_single(paths[0]):
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
    from coordlog.mjcf import worn_by
    from coordlog.record.beside import copy_beside
    from coordlog.record.display import Shown
    from coordlog.record.storage import PART
    from coordlog.record.writer import write_episode
    from coordlog.sim.description import Description

    attached, shown = recording.attachments, None
    if MODEL_XML in attached:
        shown = Shown(Description(recording.model), recording.initial_state)
    try:
        job.target.parent.mkdir(parents=True, exist_ok=True)
        copy_beside(recording.source, job.target.parent, worn_by(attached))
        exists = job.target.exists()
        beside = job.target.with_name(f"new-{job.target.name}") if exists else job.target
        beside.with_name(beside.name + PART).unlink(missing_ok=True)
        write_episode(beside, episode, attachments=attached, display=True, shown=shown)
        if beside != job.target:
            os.replace(beside, job.target)
    except OSError as error:
        raise StorageError(f"{job.target}: cannot write: {error.strerror}") from error
