"""One episode file smoothed into another: what `coordlog smooth` does to each of its inputs, in a
process of its own.
"""

from __future__ import annotations

import hashlib
import math
import multiprocessing
import os
import signal
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from coordlog.errors import CoordlogError, StorageError

if TYPE_CHECKING:
    from coordlog.episode import Array, Episode, Json
    from coordlog.kinematics.clearance import SceneChecker
    from coordlog.smooth.execute import Execution
    from coordlog.smooth.feasibility import DistanceChecker
    from coordlog.smooth.result import Result

TRANSFORM = "smooth"
"""The lineage's name for what is done here."""
SKIPPED, DONE = "skipped", "done before"
FASTER = 1.02
"""A path may be faster by this factor than the servo targets may move, or than the log's own
interpolant, whichever is faster: what the servos then lack they catch up with."""


class Job(NamedTuple):
    """One episode to smooth."""

    source: Path
    target: Path
    settings: Json
    """Options of `coordlog.smooth.smooth`; the lineage keeps them."""
    write: bool
    force: bool
    """Replace an output that was made with other settings or from another file."""


def smooth_file(job: Job) -> Json:
    """Smooth, execute and write one episode; what cannot be used is said in the row and never
    raised.

    Returns:
        One row of the report: source, target, status, reason, seconds of processor time, and
        `parameters` as the output's lineage has them.
    """
    if multiprocessing.parent_process() is not None:
        signal.signal(
            signal.SIGINT, signal.SIG_IGN
        )  # the parent hears of Ctrl-C and lets this episode be finished
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
        reason = (
            str(error) if str(job.source) in str(error) else f"{job.source}: {error}"
        )  # what knows no files names none
        row |= {"status": SKIPPED, "reason": reason, "parameters": {}}
    return row | {"cpu": time.process_time() - began}


def _smoothed(job: Job) -> tuple[Json, bool]:
    """Parameters of the lineage, and whether the output was there already."""
    from coordlog.record.reader import read_attachments, read_episode

    try:
        digest = hashlib.sha256(job.source.read_bytes()).hexdigest()
    except OSError as error:
        raise StorageError(f"{job.source}: cannot read the file: {error.strerror}") from error
    before = _made_before(job, digest)
    if before is not None:
        return before, True
    episode, attachments = read_episode(job.source), read_attachments(job.source)
    if episode.result.aborted:
        raise StorageError(
            f"{job.source}: expected an episode that ended, got an aborted one ({episode.result.aborted}); nothing to smooth"
        )
    smoothed, parameters = smooth_episode(
        episode, attachments, digest=digest, settings=job.settings
    )
    if job.write:
        _write(job, smoothed, attachments)
    return parameters, False


def smooth_episode(
    episode: Episode, attachments: dict[str, bytes], *, digest: str, settings: Json
) -> tuple[Episode, Json]:
    """The episode that takes the place of a raw one, and how it came about.

    Args:
        episode: The raw run.
        attachments: Of its file.
        digest: sha256 of its file.
        settings: Options of `coordlog.smooth.smooth`.

    Raises:
        FormatError: if the model or the first state is missing, damaged, or not the episode's.
    """
    import numpy as np

    from coordlog.episode import INITIAL_STATE
    from coordlog.kinematics.clearance import SceneChecker
    from coordlog.mjcf import load_attached
    from coordlog.sim.replay import Log, task_of
    from coordlog.smooth.execute import execute
    from coordlog.smooth.limits import Limits
    from coordlog.smooth.smoother import smooth

    checker = SceneChecker.of(episode, attachments)
    model = load_attached(attachments)
    log = Log.of(episode, model, np.frombuffer(attachments[INITIAL_STATE]))
    task = task_of(log)
    angles = episode.qpos[:, task.qpos_index]
    ends = "natural" if settings["method"] == "paper" else "soft"
    fastest = fastest_of(episode.time, angles, ends=ends)
    limits = Limits(
        task.limits[:, 0],
        task.limits[:, 1],
        speed=FASTER * np.maximum(task.speeds, fastest),
        pace=task.speeds,
    )
    # The checker is one by its methods: the simulation's room knows nothing of smoothing.
    result = smooth(
        episode.time,
        angles,
        cast("DistanceChecker", checker),
        limits=limits,
        joints=task.robot.action_joints,
        ends=ends,
        **settings,
    )
    execution = execute(log, result, episode)
    parameters = _parameters(episode, result, execution, settings, checker)
    return _episode(episode, result, execution, digest, parameters), parameters


def fastest_of(time: Array, angles: Array, *, ends: str = "soft") -> Array:
    """Largest speed of each joint along the interpolant of a log with these ends (`Config.ends`),
    (n_u,) [rad/s].
    """
    import numpy as np

    from coordlog.smooth.config import Config
    from coordlog.smooth.ease import grid_for

    config, weight = Config(ends=ends), np.ones(len(time))
    weight[[0, -1]] = np.inf
    still = np.zeros((2, angles.shape[1])) if config.clamped else None
    through = grid_for(time, config).fit(angles, lam=0.0, weight=weight, velocity=still)
    samples = np.linspace(time[0], time[-1], 8 * len(time))
    return np.asarray(np.abs(through(samples, 1)).max(axis=0))


def _episode(
    raw: Episode, result: Result, execution: Execution, digest: str, parameters: Json
) -> Episode:
    """The execution as an episode, or the raw run; either way with its lineage."""
    lineage = {"parents": [digest], "transform": TRANSFORM, "parameters": parameters}
    name = hashlib.sha256(f"{digest}/{TRANSFORM}/{parameters}".encode()).hexdigest()[:16]
    header = replace(raw.header, episode=raw.header.episode | {"id": name}, lineage=lineage)
    if execution.run is None:
        return replace(raw, header=header, path=None)
    policy = raw.header.policy | {"kind": f"{raw.header.policy['kind']}, smoothed"}
    columns = execution.run.columns
    ended = replace(
        raw.result,
        length=len(columns["action"]),
        returns=tuple(columns["reward"].sum(axis=0).tolist()),
    )
    return replace(
        raw,
        header=replace(header, policy=policy),
        result=ended,  # the writer computes it anew
        contacts=execution.run.contacts,
        path=result.path(),
        **columns,
    )


def _parameters(
    raw: Episode, result: Result, execution: Execution, settings: Json, checker: SceneChecker
) -> Json:
    """All that is worth knowing about one smoothing, JSON-able and the same at every run."""
    import numpy as np

    from coordlog.kinematics.clearance import NEAR
    from coordlog.smooth.load import PathLoad

    samples = np.linspace(raw.time[0], raw.time[-1], 2 * len(raw.time))
    apart = [
        checker.nearest(
            samples,
            np.stack([np.interp(samples, raw.time, q) for q in result.knots.position.T], axis=1),
        )
    ]
    apart.append(checker.nearest(samples, result.spline(samples)))
    joints = raw.header.env["action_joints"]
    rows = zip(joints, result.p.tolist(), result.lam.tolist(), result.cutoff.tolist(), strict=True)
    ran, violation = execution.run, result.violation
    length = len(raw) if ran is None else len(ran.columns["action"])
    before, after = (
        PathLoad.of(path, checker.inverse, result.knots.unit)._asdict()
        for path in (result.raw, result.spline)
    )
    margin = {"before": _number(before.pop("balance")), "after": _number(after.pop("balance"))}
    torques = {
        "before": execution.raw._asdict(),
        "after": execution.smoothed._asdict() if execution.smoothed else None,
    }
    return {
        "settings": settings,
        "status": execution.status,
        "reason": execution.reason,
        "steps_of": "log" if ran is None else "execution",
        "certified": bool(result.certified) and ran is not None,
        "violation": None
        if violation is None
        else {name: _number(value) for name, value in violation._asdict().items()},
        "joints": [
            {"name": name, "p": p, "lam": lam, "cutoff_hz": _number(hz)}
            for name, p, lam, hz in rows
        ],
        "before": {name: _number(value) for name, value in result.before._asdict().items()},
        "after": {name: _number(value) for name, value in result.after._asdict().items()},
        "clearance": {
            "before": _number(apart[0]),
            "after": _number(apart[1]),
            "measured_up_to": NEAR,
        },
        "torque": torques,
        "path_torque": {"before": before, "after": after},
        "zero_moment_margin": margin,
        "tracking_error": execution.away,
        "steps": {"before": len(raw), "after": length},
        "checks": result.checks,
        "slacks": result.slacks,
    }


def _number(value: Any) -> Any:
    """JSON has no infinity and no NaN: None stands for both."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
    if job.force and lineage["transform"] == TRANSFORM:
        return None
    what = (
        "made from another file or with other settings"
        if lineage["transform"] == TRANSFORM
        else "not made by coordlog smooth"
    )
    raise StorageError(
        f"{job.target}: the file exists and was {what}; choose another --out"
        + (", or pass --force" if "other" in what else "")
    )


def _write(job: Job, episode: Episode, attachments: dict[str, bytes]) -> None:
    """Write the output.

    A part file that a killed run left is only half of what is written now, and goes.
    """
    from coordlog.record.storage import PART
    from coordlog.record.writer import write_episode

    try:
        job.target.parent.mkdir(parents=True, exist_ok=True)
        beside = (
            job.target.with_name(f"new-{job.target.name}") if job.target.exists() else job.target
        )
        beside.with_name(beside.name + PART).unlink(missing_ok=True)
        write_episode(beside, episode, attachments=attachments, display=True)
        if beside != job.target:
            os.replace(beside, job.target)
    except OSError as error:
        raise StorageError(f"{job.target}: cannot write: {error.strerror}") from error
